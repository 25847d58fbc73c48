"""Only phase resonance windows are extracted while a test runs; other kinds are left to their own analysis."""

from __future__ import annotations

import pytest

from nmt_core.kinds import KINDS
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.records import LevelCommand, LockEvent, LoopStatus
from nmt_core.messages.wire import LEVEL, LOCK_EVENT, write_status
from nmt_core.vocabulary import LoopState, PointStatus, TestKind
from nmt_extract.extractor import Extractor
from nmt_extract.message_feed import MessageFeed

LINEAR = LinearDescription("test", 2, 0, (2,), (139.0,), (0.01,), ((1.0,),), 1.0, 140.0, 0.02, 0.04)
EVENT = LockEvent(0, 0.3, "V", 299, 22.0, 0.0, 300, 1000, 20)
KIND_IN_LEVEL = 4 + 64  # after the time-out; the kind of test and five numbers follow
KIND_IN_LOCK_EVENT = 80  # after the window


def level(index: int, kind: int) -> bytes:
    """A serialised level."""
    raw = bytearray(LEVEL.write(LevelCommand(index + 1, index, 0.3, 0, 0.1)))
    assert raw[KIND_IN_LEVEL] == TestKind.PHASE_RESONANCE
    raw[KIND_IN_LEVEL] = kind
    return bytes(raw)


def lock(kind: int) -> bytes:
    """A serialised lock event."""
    raw = bytearray(LOCK_EVENT.write(EVENT))
    assert raw[KIND_IN_LOCK_EVENT] == TestKind.PHASE_RESONANCE
    raw[KIND_IN_LOCK_EVENT] = kind
    return bytes(raw)


def points(kind: int) -> list[PointStatus]:
    """Status of the points of a level that locks for a window without samples, and of one that does not lock."""
    extractor = Extractor(LINEAR)
    feed = MessageFeed(extractor)
    for index in range(2):
        feed.callbacks["level"](level(index, kind))
    feed.callbacks["lock"](lock(kind))
    for sample, state in ((2000, LoopState.ACQUIRING), (3000, LoopState.LOCK_LOST)):
        feed.callbacks["frequency"](
            write_status(LoopStatus(sample, 1, 2, state, 22.0, 0.0, 1.0, 1.0, "m", 0.1), 1000.0)
        )
    assert feed.malformed == 0
    return [point.status for point in extractor.finish()]


@pytest.mark.parametrize("kind", [0, 1])
def test_phase_resonance_gives_points(kind):
    assert sorted(points(kind)) == sorted([PointStatus.NOT_LOCKED, PointStatus.REJECTED])


@pytest.mark.parametrize("kind", [*(number for number, kind in KINDS.items() if not kind.gives_modal_points), 77])
def test_other_kinds_give_none(kind):
    assert points(int(kind)) == []
