"""Only phase resonance windows are extracted while a test runs; other kinds are left to their own analysis."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from nmt_core.linear_description import LinearDescription
from nmt_core.test_kind import TestKind
from nmt_core.wire import LoopStatus, write_status
from nmt_extract.extractor import Extractor
from nmt_extract.message_feed import MessageFeed
from nmt_extract.modal_point import Status

LINEAR = LinearDescription("test", 2, 0, (2,), (139.0,), (0.01,), ((1.0,),), 1.0, 140.0, 0.02, 0.04)
ACQUIRING, LOST = 2, 4
OLD = {}


def points(fields: dict[str, int]) -> list[Status]:
    """Status of the points of a level that locks for a window without samples, and of one that does not lock."""
    extractor = Extractor(LINEAR)
    feed = MessageFeed(extractor)
    for index in range(2):
        feed.decoded["level"](SimpleNamespace(index=index, amplitude=0.3, control=1, **fields))
    window = {"window_first_sample": 300, "window_samples": 1000, "window_periods": 20}
    event = {"level_index": 0, "level": 0.3, "level_unit": "V", "sample": 299, "frequency_hz": 22.0, "phase_error": 0.0}
    feed.decoded["lock"](SimpleNamespace(**event, **window, **fields))
    for sample, state in ((2000, ACQUIRING), (3000, LOST)):
        feed.raw["frequency"](write_status(LoopStatus(sample, 1, 2, state, 22.0, 0.0, 1.0, 1.0, "m", 0.1), 1000.0))
    return [point.status for point in extractor.finish()]


@pytest.mark.parametrize("fields", [OLD, {"test": 0}, {"test": 1}])
def test_phase_resonance_gives_points(fields):
    assert sorted(points(fields)) == sorted([Status.NOT_LOCKED, Status.REJECTED])


@pytest.mark.parametrize("kind", [*(kind for kind in TestKind if not kind.gives_modal_points), 77])
def test_other_kinds_give_none(kind):
    assert points({"test": int(kind)}) == []
