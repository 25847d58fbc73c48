"""Watchdog of the drive: it trips with the block that is one too many, not later, and only while the drive is on."""

from __future__ import annotations

import pytest

from nmt_plant.safety.watchdog import DriveWatchdog


@pytest.mark.parametrize("blocks", [1, 3, 10])
def test_it_trips_with_the_last_block_that_may_pass(blocks: int) -> None:
    watchdog = DriveWatchdog(blocks)
    for _ in range(3):
        watchdog.command()
        assert [watchdog.block(True) for _ in range(blocks)] == [False] * (blocks - 1) + [True]
    assert watchdog.block(False), "a drive that went to zero by it stays there"
    watchdog.command()
    assert not watchdog.tripped


def test_a_drive_at_zero_and_a_watchdog_that_is_off_never_trip() -> None:
    at_zero, off = DriveWatchdog(3), DriveWatchdog(0)
    assert not any(at_zero.block(False) for _ in range(100))
    assert not any(off.block(True) for _ in range(100))
    assert [at_zero.block(True) for _ in range(3)] == [False, False, True]
