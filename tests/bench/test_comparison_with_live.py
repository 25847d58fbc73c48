"""What `extract` says of live results: equal only where they are there, and first what is missing."""

from __future__ import annotations

from dataclasses import replace

from nmt_bench.commands.extract_command import comparison_with_live
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.messages.records import LockEvent
from nmt_extract.modal.point import rejected_point


def points(count: int) -> list[ModalPoint]:
    locks = [LockEvent(index, 0.1, "V", 100, 20.0, 0.0, 100, 500, 10) for index in range(count)]
    return [rejected_point(lock, 1000.0, "as an example") for lock in locks]


def test_equal_is_said_of_whole_results_only() -> None:
    assert comparison_with_live(points(3), points(3)) == (
        "Equal to the live results bit for bit (3 of 3 levels compared)."
    )
    assert comparison_with_live(points(4), points(2)) == (
        "There are no live results of levels 3 and 4 (2 of 4 levels). The other 2 are equal to them bit for bit."
    )
    assert (
        comparison_with_live(points(3), points(4)[3:]) == "There are no live results of levels 1 to 3 (3 of 3 levels)."
    )


def test_what_is_missing_comes_before_what_differs() -> None:
    live = [replace(points(1)[0], frequency_hz=1.0)]
    assert comparison_with_live(points(2), live).startswith(
        "There are no live results of level 2 (1 of 2 levels). Level 1 differs"
    )
