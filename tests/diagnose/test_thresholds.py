"""Every threshold of the diagnosis states its unit, its reason and the test that fails when it moves."""

from __future__ import annotations

import re

import pytest
from moved_threshold import ROOT, moves, notices

from nmt_core.threshold import thresholds_of
from nmt_diagnose.thresholds import THRESHOLDS

ENTRIES = {path: (getattr(record, entry.name), entry) for path, record, entry in thresholds_of(THRESHOLDS)}


@pytest.mark.parametrize("path", ENTRIES)
def test_a_threshold_states_unit_and_reason(path: str) -> None:
    value, entry = ENTRIES[path]
    assert entry.metadata["unit"]
    reason = entry.metadata["reason"]
    assert len(reason.split()) >= 4, reason
    assert reason[0].isupper(), reason
    assert reason.endswith("."), reason
    assert isinstance(value, int | float | tuple)


def test_the_tests_of_thresholds_exist() -> None:
    for path in ENTRIES:
        file, _, name = ENTRIES[path][1].metadata["test"].partition("::")
        assert (ROOT / file).is_file(), path
        assert re.search(rf"def {re.escape(name.split('[')[0].split('::')[-1])}\b", (ROOT / file).read_text()), path


@pytest.mark.campaign
@pytest.mark.parametrize("path", ENTRIES)
def test_a_threshold_that_moves_is_noticed(path: str) -> None:
    """One of the moved values makes its test fail."""
    value, entry = ENTRIES[path]
    assert any(notices(path, moved, entry.metadata["test"]) for moved in moves(value))
