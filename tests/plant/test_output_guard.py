"""Guard of the final samples: against the definitions of its two limits, sample by sample."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_plant.safety.output_guard import OutputGuard, default_slew

RATE = 10_000.0


def test_what_keeps_the_limits_passes_as_the_same_array() -> None:
    guard = OutputGuard(RATE, 2.0, default_slew(2.0, RATE))
    for first in range(0, 2000, 200):
        wanted = 2.0 * np.sin(2 * np.pi * 0.09 * (first + np.arange(201)))
        assert guard.block(wanted, 200) is wanted
    assert guard.spread == 0
    assert not guard.held


def test_a_step_takes_as_many_samples_as_the_slew_limit_says() -> None:
    guard = OutputGuard(RATE, 10.0, slew=5_000.0)  # 0.5 V a sample
    out = guard.block(np.full(20, 4.2))
    np.testing.assert_allclose(out[:9], [0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.2], atol=1e-12)
    assert np.all(out[8:] == 4.2)
    assert guard.spread == 8
    down = guard.block(np.full(20, -0.3))
    np.testing.assert_allclose(down[:10], [3.7, 3.2, 2.7, 2.2, 1.7, 1.2, 0.7, 0.2, -0.3, -0.3], atol=1e-12)


@pytest.mark.parametrize("wrong", [5.001, -7.0, 1e300, np.inf, -np.inf, np.nan])
def test_a_sample_beyond_the_limit_is_not_put_out_and_the_ramp_begins_there(wrong: float) -> None:
    guard = OutputGuard(RATE, 5.0, ramp=0.01)
    wanted = np.full(200, 3.0)
    wanted[37] = wrong
    out = guard.block(wanted)
    assert np.all(out[:37] == 3.0)
    expected = 1.5 * (1.0 + np.cos(np.pi * np.arange(1, 101) / 100.0))
    np.testing.assert_allclose(out[37:137], expected, atol=1e-12)
    assert not out[137:].any()
    assert guard.violation is not None
    assert guard.violation[0] == 37
    assert guard.held
    assert not guard.block(np.full(50, 1.0)).any()
    guard.release()
    assert np.all(guard.block(np.full(50, 1.0)) == 1.0)


def test_the_ramp_goes_on_over_blocks_of_any_length() -> None:
    whole = OutputGuard(RATE, 5.0, 20_000.0, ramp=0.013)
    parts = OutputGuard(RATE, 5.0, 20_000.0, ramp=0.013)
    rng = np.random.default_rng(3)
    wanted = rng.uniform(-5.2, 5.2, 600)
    together = whole.block(wanted)
    pieces = [parts.block(wanted[a:b]) for a, b in ((0, 7), (7, 8), (8, 200), (200, 600))]
    np.testing.assert_array_equal(np.concatenate(pieces), together)


def test_a_ramp_shorter_than_the_slew_limit_allows_is_lengthened() -> None:
    guard = OutputGuard(RATE, 5.0, slew=1_000.0, ramp=0.0)
    guard.block(np.linspace(0.0, 4.0, 60))
    out = guard.block(np.r_[np.full(10, 4.0), 9.0, np.full(400, 4.0)])
    change = np.abs(np.diff(out))
    assert change.max() <= 0.1 * (1 + 1e-12)
    assert out[-1] == 0.0


def test_the_shorter_of_two_ramps_to_zero_counts() -> None:
    guard = OutputGuard(RATE, 5.0, ramp=0.01)
    guard.block(np.full(9, 4.0))
    guard.to_zero(3600.0)
    assert guard.block(np.zeros(100)).min() > 3.99
    guard.to_zero()
    present = guard.last
    out = guard.block(np.zeros(60))
    np.testing.assert_allclose(out, 0.5 * present * (1.0 + np.cos(np.pi * np.arange(1, 61) / 100.0)), atol=1e-12)
    guard.to_zero()
    assert guard.block(np.zeros(50))[39] == pytest.approx(0.0, abs=1e-12), "the same again does not start over"


def test_the_preview_is_limited_but_decides_nothing() -> None:
    guard = OutputGuard(RATE, 5.0, ramp=0.01)
    wanted = np.full(11, 3.0)
    wanted[10] = 6.0
    out = guard.block(wanted, 10)
    assert abs(out[10]) <= 5.0
    assert guard.violation is None
    assert not guard.held
    assert guard.last == 3.0
    assert np.all(guard.block(np.full(11, 2.0), 10) == 2.0)


def test_no_sequence_of_samples_passes_either_limit() -> None:
    rng = np.random.default_rng(11)
    for _ in range(200):
        limit, slew = rng.uniform(0.1, 50.0), 10 ** rng.uniform(1.0, 6.0)
        guard = OutputGuard(RATE, limit, slew, ramp=float(rng.choice([0.0, 0.001, 0.1])))
        before = 0.0
        for _ in range(6):
            wanted = limit * rng.uniform(-1.1, 1.1, rng.integers(1, 90))
            if rng.random() < 0.2:
                wanted[rng.integers(wanted.size)] = rng.choice([np.nan, np.inf, 1e308])
            out = guard.block(wanted)
            assert np.isfinite(out).all()
            assert np.abs(out).max() <= limit
            assert np.abs(np.diff(np.r_[before, out])).max() <= slew / RATE * (1 + 1e-9) + 1e-15 * limit
            before = out[-1]
            if rng.random() < 0.3:
                guard.release()


def test_reaches_zero_says_whether_the_next_sample_can_be_zero() -> None:
    guard = OutputGuard(RATE, 5.0, slew=10_000.0, ramp=0.001)
    guard.block(np.full(9, 4.0))
    while not guard.reaches_zero:
        assert guard.block(np.zeros(1))[0] != 0.0
    assert guard.block(np.zeros(1))[0] == 0.0
    guard.block(np.full(9, 4.0))
    guard.to_zero(0.001)
    while not guard.reaches_zero:
        assert guard.block(np.zeros(1))[0] != 0.0
    assert guard.block(np.zeros(1))[0] == 0.0


@pytest.mark.parametrize("keys", [{"limit": 0.0}, {"limit": np.nan}, {"slew": -1.0}, {"ramp": -0.1}, {"ramp": np.inf}])
def test_a_limit_that_is_none_is_refused(keys: dict[str, float]) -> None:
    with pytest.raises(BenchError, match="output guard"):
        OutputGuard(RATE, **keys)


def test_the_default_slew_is_that_of_a_full_sine_at_a_tenth_of_the_sample_rate() -> None:
    sine = 7.0 * np.sin(2 * np.pi * 0.1 * np.arange(100_000) + 0.123456)
    brute = max(
        np.abs(np.diff(7.0 * np.sin(2 * np.pi * 0.1 * np.arange(50) + p))).max() for p in np.linspace(0, 7, 9999)
    )
    assert default_slew(7.0, RATE) / RATE == pytest.approx(brute, rel=1e-6)
    assert np.abs(np.diff(sine)).max() <= default_slew(7.0, RATE) / RATE
