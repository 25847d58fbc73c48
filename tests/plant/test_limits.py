"""Limits of what is measured: levels of channels, rms, warnings, prediction, open loop, drive maximum."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_core.messages.blocks import Quantity, SampleBlock
from nmt_plant.safety.limits import PREDICTION_FACTOR, ChannelLimit, LimitGuard, OpenLoop

RATE = 1000.0
NAMES = ("a1", "a2")


def block(rows: np.ndarray, first: int = 0, quantity: Quantity = Quantity.ACCELERATION) -> SampleBlock:
    return SampleBlock(first, RATE, quantity, quantity.unit, NAMES[: len(rows)], (1, 2)[: len(rows)], np.asarray(rows))


def flat(one: float, two: float, first: int = 0, samples: int = 10) -> SampleBlock:
    return block(np.array([[one] * samples, [two] * samples]), first)


def test_a_level_of_one_channel_leaves_the_others_alone() -> None:
    guard = LimitGuard({}, [ChannelLimit("a2", abort_peak=2.0)])
    assert not guard.check([flat(100.0, 2.0)])
    assert guard.check([flat(0.0, -2.5, first=10)])
    assert guard.reason == "acceleration limit: a2 reached -2.5 m/s^2 at sample 10, limit 2 m/s^2"


def test_the_smaller_of_channel_and_quantity_counts() -> None:
    for of_quantity, of_channel in ((3.0, 2.0), (2.0, 3.0)):
        guard = LimitGuard({Quantity.ACCELERATION: of_quantity}, [ChannelLimit("a1", abort_peak=of_channel)])
        assert not guard.check([flat(2.0, 0.0)])
        assert guard.check([flat(2.1, 0.0)])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_violates_every_level(value: float) -> None:
    rows = np.zeros((2, 10))
    rows[1, 4] = value
    for channel in (ChannelLimit("a2", abort_peak=1.0), ChannelLimit("a2", abort_rms=1.0)):
        assert LimitGuard({}, [channel]).check([block(rows)])
    assert LimitGuard({Quantity.ACCELERATION: 1.0}).check([block(rows)])


def test_the_rms_follows_its_time_constant() -> None:
    """Mean square of a constant a after t: a² (1 - exp(-t / τ)); it passes the level c at t = -τ log(1 - c²/a²)."""
    guard = LimitGuard({}, [ChannelLimit("a1", abort_rms=1.0)], rms_time=0.5)
    crossing = -0.5 * np.log(1.0 - 1.0 / 1.5**2)
    first = 0
    while not guard.check([flat(1.5, 0.0, first)]):
        first += 10
    assert (first + 10) / RATE == pytest.approx(crossing, abs=0.01)
    assert (first + 10) / RATE >= crossing
    assert "m/s^2 rms at sample" in guard.reason


def test_warnings_do_not_trip_and_say_when_first() -> None:
    guard = LimitGuard({Quantity.ACCELERATION: 10.0}, [ChannelLimit("a2", warning_peak=3.0)], warning_share=0.8)
    assert not guard.check([flat(7.9, 2.9)])
    assert not guard.warnings
    assert not guard.check([flat(8.1, 3.1, first=10)])
    assert not guard.check([flat(9.0, 3.5, first=20)])
    assert sorted(guard.warnings) == ["a1 peak", "a2 peak"]
    assert "warning level of 8 m/s^2 peak with 8.1 m/s^2 in the block from sample 10" in guard.warnings["a1 peak"]
    assert "warning level of 3 m/s^2 peak with 3.1" in guard.warnings["a2 peak"]
    assert guard.margins == pytest.approx({"a1": 0.9, "a2": 0.35})


def test_growth_of_the_drive_is_predicted_in_proportion() -> None:
    def guard() -> LimitGuard:
        made = LimitGuard({Quantity.ACCELERATION: 10.0})
        assert not made.check([flat(1.0, 0.5)], 0.0)
        assert not made.predict(2.0), "no drive yet, so no gain"
        assert not made.check([flat(5.0, 0.5, first=10)], 2.0)
        return made

    # One part of a1 was there without the drive; 4 of 2 V, so 2 per volt.
    just = 2.0 + (PREDICTION_FACTOR * 10.0 - 5.0) / 2.0
    assert not guard().predict(just - 0.01)
    tripped = guard()
    assert tripped.predict(just + 0.01)
    assert "a1 would reach about 12.52 m/s^2 in the block from sample 20 with a drive of 5.76 V" in tripped.reason
    assert not guard().predict(1.9), "a drive that falls predicts nothing"


def test_ringing_belongs_to_the_drive_that_there_was() -> None:
    """A level ends, and the last block of its ramp has a thousandth of its drive: 5 of 2 V are no 5 of 2 mV."""

    def guard(seconds: float) -> LimitGuard:
        made = LimitGuard({Quantity.ACCELERATION: 10.0})
        assert not made.check([flat(5.0, 0.0)], 2.0)
        for block in range(1, 2 + round(seconds * RATE / 10)):
            assert not made.check([flat(5.0, 0.0, 10 * block)], 2e-3)
        return made

    assert not guard(0.0).predict(2.0)
    assert guard(0.0).predict(6.0), "what is more than ever is predicted in proportion"
    assert guard(10.0).predict(2.0), "no ringing lasts so long: the drive of now does it"


def test_no_response_to_the_drive_is_an_open_loop() -> None:
    guard = LimitGuard({}, open_loops=[OpenLoop("a2", least=0.1, drive=0.5, seconds=0.05)])
    for n in range(20):
        assert not guard.check([flat(9.0, 0.0, 10 * n)], 0.4), "drive too small"
    for n in range(4):
        assert not guard.check([flat(9.0, 0.0, 10 * n)], 0.6)
    assert not guard.check([flat(9.0, 0.2)], 0.6), "a response"
    for n in range(4):
        assert not guard.check([flat(9.0, 0.0, 10 * n)], 0.6)
    assert guard.check([flat(9.0, 0.0, 40)], 0.6)
    assert guard.reason.startswith("open loop: a2 stayed below 0.1 m/s^2 for 0.05 s up to sample 49")


def test_the_drive_maximum_ends_a_test() -> None:
    guard = LimitGuard({}, drive_maximum=2.0)
    assert not guard.check([flat(0.0, 0.0)], 2.0)
    assert guard.check([flat(0.0, 0.0, 10)], 2.01)
    assert guard.reason.startswith("drive maximum: the drive's amplitude reached 2.01 V in the block from sample 10")


def test_the_first_violation_latches_until_reset() -> None:
    guard = LimitGuard({Quantity.ACCELERATION: 1.0})
    assert guard.check([flat(0.0, 2.0)])
    reason = guard.reason
    assert guard.check([flat(5.0, 0.0, 10)])
    assert guard.reason == reason
    guard.reset()
    assert not guard.check([flat(0.5, 0.5, 20)])


def test_a_block_with_lost_samples_does_not_end_the_prediction() -> None:
    guard = LimitGuard({}, [ChannelLimit("a1", abort_peak=2.0)])
    assert not guard.check([flat(1.0, 0.0)], drive=1.0)
    assert not guard.check([], drive=1.0)
    assert guard.predict(2.0 * PREDICTION_FACTOR + 0.1)
