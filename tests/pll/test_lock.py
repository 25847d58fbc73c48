"""Dwell statistics, lock criteria and the state machine."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from nmt_core.vocabulary import LoopState
from nmt_pll.detection.lock import Dwell, DwellStatistics, LockCriteria, LockStateMachine

CORRELATION = 4.0


def filled(phase, frequency=None, amplitude=None, correlation=CORRELATION):
    length = len(phase)
    dwell = Dwell(length, correlation)
    frequency = np.full(length, 20.0) if frequency is None else frequency
    amplitude = np.full(length, 1e-4) if amplitude is None else amplitude
    for values in zip(phase, frequency, amplitude, strict=True):
        assert not dwell.full
        dwell.add(*values)
    assert dwell.full
    return dwell


def filtered_noise(rng, length, correlation=CORRELATION):
    """Noise behind a low-pass, variance 1, as the adaptive filter leaves it."""
    neighbour = math.exp(-2.0 / correlation)
    values = np.empty(length)
    values[0] = rng.standard_normal()
    for k in range(1, length):
        values[k] = neighbour * values[k - 1] + math.sqrt(1 - neighbour**2) * rng.standard_normal()
    return values


@given(st.integers(4, 60), st.integers(0, 2**32 - 1), st.integers(0, 150))
@settings(deadline=None)
def test_statistics_are_those_of_a_straight_line_fit(length, seed, surplus):
    rng = np.random.default_rng(seed)
    values = rng.standard_normal((3, length + surplus)) + np.array([[0.0], [20.0], [10.0]])
    dwell = Dwell(length, CORRELATION)
    for column in values.T:
        dwell.add(*column)
    s = dwell.statistics()
    place = np.linspace(-0.5, 0.5, length)
    slopes, means, residuals = [], [], []
    for row in values[:, surplus:]:
        slope, mean = np.polyfit(place, row, 1)
        slopes.append(slope)
        means.append(mean)
        residuals.append(row - slope * place - mean)
    assert s.mean == pytest.approx(means[0], abs=1e-12)
    assert s.scatter == pytest.approx(math.sqrt(residuals[0] @ residuals[0] / (length - 2)), rel=1e-9)
    assert s.frequency_drift == pytest.approx(slopes[1] / means[1], abs=1e-12)
    assert s.amplitude_drift == pytest.approx(slopes[2] / means[2], abs=1e-12)


def test_uncertainties_are_those_seen_in_many_dwells():
    rng = np.random.default_rng(4)
    found = []
    for _ in range(1500):
        phase, frequency, amplitude = (filtered_noise(rng, 24) for _ in range(3))
        dwell = filled(0.02 * phase, 20.0 + 0.01 * frequency, 1.0 + 0.03 * amplitude)
        found.append(dwell.statistics())
    for value, claimed in (
        ("mean", "mean_std"),
        ("frequency_drift", "frequency_drift_std"),
        ("amplitude_drift", "amplitude_drift_std"),
    ):
        seen = np.std([getattr(s, value) for s in found])
        said = np.mean([getattr(s, claimed) for s in found])
        # Counting independent values by the correlation time is a rule of thumb.
        assert said == pytest.approx(seen, rel=0.35), value
    assert np.mean([s.noise for s in found]) == pytest.approx(0.02, rel=0.05)


@pytest.mark.parametrize("correlation", [0.5, 1.0, 5.0, 20.0])
def test_noise_is_found_at_any_correlation(correlation):
    rng = np.random.default_rng(5)
    levels = [
        filled(0.1 * filtered_noise(rng, 400, correlation), correlation=correlation).statistics().noise
        for _ in range(20)
    ]
    assert np.mean(levels) == pytest.approx(0.1, rel=0.05)


def test_a_swing_is_not_noise():
    swing = 0.1 * np.sin(2 * np.pi * np.arange(24) / 40)
    s = filled(swing).statistics()
    assert s.scatter > 0.01
    assert s.noise < 0.03 * 0.1
    assert s.mean_std < 0.002


def test_a_dwell_forgets():
    dwell = filled([0.5] * 6)
    dwell.clear()
    assert not dwell.full
    for _ in range(6):
        dwell.add(0.1, 20.0, 1.0)
    assert dwell.full
    assert dwell.statistics().mean == pytest.approx(0.1)


def test_a_dwell_has_at_least_four_values():
    assert Dwell(1, 1.0).length == 4


CRITERIA = LockCriteria(
    phase_tolerance=math.radians(0.2),
    frequency_tolerance=1e-4,
    amplitude_tolerance=2e-3,
    scatter_limit=math.radians(10.0),
    unlock_tolerance=math.radians(10.0),
)
QUIET = np.zeros(24)
PLACE = np.linspace(-0.5, 0.5, 24)


def test_a_steady_loop_is_locked():
    assert CRITERIA.locked(filled(QUIET).statistics())


@pytest.mark.parametrize(
    ("phase", "frequency", "amplitude", "obstacle"),
    [
        (math.radians(0.19), 0.0, 0.0, ""),
        (math.radians(0.21), 0.0, 0.0, "mean phase error 0.21 deg"),
        (-math.radians(0.21), 0.0, 0.0, "mean phase error -0.21 deg"),
        (0.0, 0.9e-4, 0.0, ""),
        (0.0, 1.1e-4, 0.0, "the frequency drifts by 0.011 % over the dwell"),
        (0.0, -1.1e-4, 0.0, "the frequency drifts by -0.011 % over the dwell"),
        (0.0, 0.0, 1.9e-3, ""),
        (0.0, 0.0, 2.1e-3, "the response drifts by 0.21 % over the dwell"),
        (0.0, 0.0, -2.1e-3, "the response drifts by -0.21 % over the dwell"),
    ],
)
def test_each_tolerance_counts(phase, frequency, amplitude, obstacle):
    s = filled(QUIET + phase, 20.0 * (1 + frequency * PLACE), 3.0 * (1 + amplitude * PLACE)).statistics()
    assert CRITERIA.obstacle(s) == obstacle
    assert CRITERIA.locked(s) is (not obstacle)


def test_a_controlled_amplitude_must_have_reached_its_target():
    s = filled(QUIET).statistics()
    assert CRITERIA.locked(s, 3.9e-3)
    assert CRITERIA.locked(s, -3.9e-3)
    assert CRITERIA.obstacle(s, -4.1e-3) == "the controlled amplitude is -0.41 % off its target"
    assert not CRITERIA.locked(s, 4.1e-3)


def test_noise_does_not_keep_a_steady_loop_from_locking():
    rng = np.random.default_rng(6)
    locked = [
        CRITERIA.locked(
            filled(
                math.radians(3.0) * filtered_noise(rng, 24),
                20.0 * (1 + 2e-3 * filtered_noise(rng, 24)),
                1.0 + 0.02 * filtered_noise(rng, 24),
            ).statistics()
        )
        for _ in range(200)
    ]
    assert np.mean(locked) > 0.6


def test_too_much_noise_is_not_excused():
    rng = np.random.default_rng(7)
    for _ in range(50):
        s = filled(math.radians(25.0) * filtered_noise(rng, 24)).statistics()
        if s.scatter > CRITERIA.scatter_limit:
            assert not CRITERIA.locked(s)


@given(st.floats(math.radians(3.0), math.radians(60.0)), st.floats(0.0, 2 * math.pi), st.floats(15.0, 60.0))
@settings(deadline=None)
def test_a_swinging_loop_is_not_locked_when_its_mean_passes_zero(size, phase, period):
    swing = size * np.sin(2 * np.pi * np.arange(24) / period + phase)
    swing -= swing.mean()
    s = filled(swing).statistics()
    if s.scatter > math.radians(1.2):
        assert not CRITERIA.locked(s)


def statistics(mean=0.0, scatter=0.0, mean_std=0.0):
    return DwellStatistics(mean, mean_std, scatter, 0.0, 0.0, 0.0, 0.0, 0.0)


def test_a_lock_is_kept_within_wider_bounds_than_it_is_won_with():
    for mean in (0.3, 5.0, 9.9, -9.9):
        assert CRITERIA.lost(statistics(math.radians(mean))) == ""
        assert not CRITERIA.locked(statistics(math.radians(mean)))
    assert CRITERIA.lost(statistics(scatter=math.radians(19.0))) == ""


def test_noise_of_the_mean_is_no_lost_lock():
    noisy = math.radians(2.0)
    assert CRITERIA.lost(statistics(math.radians(13.9), mean_std=noisy)) == ""
    assert "exceeds 14.00 deg" in CRITERIA.lost(statistics(math.radians(14.1), mean_std=noisy))


@pytest.mark.parametrize("sign", [1, -1])
def test_a_lock_is_lost_with_a_reason(sign):
    reason = CRITERIA.lost(statistics(sign * math.radians(10.1)))
    assert reason == f"mean phase error {sign * 10.1:.2f} deg exceeds 10.00 deg"
    assert CRITERIA.lost(statistics(scatter=math.radians(20.5))) == "phase scatter 20.5 deg exceeds 20.0 deg"


ALLOWED = {
    "fix": {LoopState.ACQUIRING, LoopState.LOCKED, LoopState.LOCK_LOST},
    "acquire": set(LoopState) - {LoopState.UNKNOWN},
    "lock": {LoopState.ACQUIRING},
    "lose": {LoopState.ACQUIRING, LoopState.LOCKED},
}
TARGET = {"fix": LoopState.FIXED, "acquire": LoopState.ACQUIRING, "lock": LoopState.LOCKED, "lose": LoopState.LOCK_LOST}


def reach(state: LoopState) -> LockStateMachine:
    machine = LockStateMachine()
    way = {
        LoopState.FIXED: [],
        LoopState.ACQUIRING: ["acquire"],
        LoopState.LOCKED: ["acquire", "lock"],
        LoopState.LOCK_LOST: ["acquire", "lose"],
    }[state]
    for call in way:
        getattr(machine, call)(1, "before")
    machine.take_transition()
    return machine


@pytest.mark.parametrize("call", ALLOWED)
@pytest.mark.parametrize("state", list(LoopState)[1:])
def test_every_transition_has_its_sample_and_reason(call, state):
    machine = reach(state)
    if state in ALLOWED[call]:
        getattr(machine, call)(4711, "why")
        transition = machine.take_transition()
        assert (transition.sample, transition.state, transition.reason) == (4711, TARGET[call], "why")
        assert machine.state == TARGET[call]
    elif call == "lock":
        with pytest.raises(RuntimeError, match=f"cannot lock from {state.name}"):
            machine.lock(4711, "why")
        assert machine.state == state
    else:
        getattr(machine, call)(4711, "why")
        assert machine.state == state
        assert machine.take_transition() is None


def test_a_transition_is_told_once():
    machine = reach(LoopState.FIXED)
    machine.acquire(3, "why")
    assert machine.take_transition() is not None
    assert machine.take_transition() is None


class LatchedLoss(RuleBasedStateMachine):
    """However it is driven, only a new level or the end of excitation leaves LOCK_LOST."""

    def __init__(self):
        super().__init__()
        self.machine = LockStateMachine()
        self.latched = False

    @rule()
    def acquire(self):
        self.machine.acquire(0, "level")
        self.latched = False

    @rule()
    def fix(self):
        self.machine.fix(0, "zero")
        self.latched = False

    @precondition(lambda self: self.machine.state == LoopState.ACQUIRING)
    @rule()
    def lock(self):
        self.machine.lock(0, "locked")

    @rule()
    def lose(self):
        self.latched = self.machine.state in (LoopState.ACQUIRING, LoopState.LOCKED) or self.latched
        self.machine.lose(0, "lost")

    @invariant()
    def a_loss_is_latched(self):
        assert (self.machine.state == LoopState.LOCK_LOST) is self.latched


TestLatchedLoss = LatchedLoss.TestCase
TestLatchedLoss.settings = settings(max_examples=30, stateful_step_count=20, deadline=None)
