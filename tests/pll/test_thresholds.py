"""Thresholds of the loops: each states unit, reason and the test that fails when it moves."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from moved_threshold import moves, notices

from nmt_core.threshold import thresholds_of
from nmt_pll.thresholds import THRESHOLDS

ROOT = Path(__file__).resolve().parents[2]
ENTRIES = {path: (getattr(record, entry.name), entry) for path, record, entry in thresholds_of(THRESHOLDS)}


@pytest.mark.parametrize("path", ENTRIES)
def test_a_threshold_states_unit_and_reason(path: str) -> None:
    value, entry = ENTRIES[path]
    reason = entry.metadata["reason"]
    assert entry.metadata["unit"]
    assert len(reason.split()) >= 4, reason
    assert reason[0].isupper(), reason
    assert reason.endswith("."), reason
    assert isinstance(value, int | float | tuple)


def test_each_threshold_names_a_test_that_exists() -> None:
    for path, (_, entry) in ENTRIES.items():
        assert entry.metadata["test"], path
        file, _, name = entry.metadata["test"].partition("::")
        assert re.search(rf"def {re.escape(name.split('[')[0])}\b", (ROOT / file).read_text()), (file, name)


@pytest.mark.campaign
@pytest.mark.parametrize("path", ENTRIES)
def test_any_threshold_that_moves_is_noticed(path: str) -> None:
    value, entry = ENTRIES[path]
    assert any(notices(f"pll.{path}", moved, entry.metadata["test"]) for moved in moves(value))


def test_no_constant_of_a_loop_stands_beside_them() -> None:
    """Numbers at the left margin of the rooms of nmt_pll, but for what is not a threshold."""
    allowed = {"_BUNDLE_WAIT_S", "_END_WAIT_S", "FEWEST_BLOCKS"}
    found = set()
    for path in (ROOT / "ros2_ws/src/nmt_pll/nmt_pll").rglob("*.py"):
        found |= set(re.findall(r"^(_?[A-Z][A-Z_0-9]+)(?:: \w+)? = \(?-?[\d.]", path.read_text(), re.MULTILINE))
    assert found - allowed == set()
