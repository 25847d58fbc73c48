"""Thresholds of the loops: each states unit and reason; how many name the test that fails when they move."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from moved_threshold import moves, notices

from nmt_core.threshold import thresholds_of
from nmt_pll.thresholds import THRESHOLDS

ROOT = Path(__file__).resolve().parents[2]
ENTRIES = {path: (getattr(record, entry.name), entry) for path, record, entry in thresholds_of(THRESHOLDS)}
WITHOUT_TEST = 12
"""How many have no such test yet. The number is put down when a test is written, and never up."""


@pytest.mark.parametrize("path", ENTRIES)
def test_a_threshold_states_unit_and_reason(path: str) -> None:
    value, entry = ENTRIES[path]
    reason = entry.metadata["reason"]
    assert entry.metadata["unit"]
    assert len(reason.split()) >= 4, reason
    assert reason[0].isupper(), reason
    assert reason.endswith("."), reason
    assert isinstance(value, int | float | tuple)


def test_the_tests_of_thresholds_exist_and_get_no_fewer() -> None:
    tests = [entry.metadata["test"] for _, entry in ENTRIES.values()]
    for file, _, name in (test.partition("::") for test in tests if test):
        assert re.search(rf"def {re.escape(name.split('[')[0])}\b", (ROOT / file).read_text()), (file, name)
    assert sum(not test for test in tests) <= WITHOUT_TEST


@pytest.mark.campaign
@pytest.mark.parametrize("path", [path for path, (_, entry) in ENTRIES.items() if entry.metadata["test"]])
def test_any_threshold_that_moves_is_noticed(path: str) -> None:
    value, entry = ENTRIES[path]
    assert any(notices(f"pll.{path}", moved, entry.metadata["test"]) for moved in moves(value))


def test_no_constant_of_a_loop_stands_beside_them() -> None:
    """Numbers at the left margin of the rooms of nmt_pll, but for what is no threshold."""
    allowed = {"_BUNDLE_WAIT_S", "_END_WAIT_S", "FEWEST_BLOCKS"}
    found = set()
    for path in (ROOT / "ros2_ws/src/nmt_pll/nmt_pll").rglob("*.py"):
        found |= set(re.findall(r"^(_?[A-Z][A-Z_0-9]+)(?:: \w+)? = \(?-?[\d.]", path.read_text(), re.MULTILINE))
    assert found - allowed == set()
