"""Drift of the resonance between sweeps: what is taken for it, and what it hides no more."""

from __future__ import annotations

import numpy as np
import pytest
from diagnose.test_stepped_sine import (
    CUBIC,
    KNOWN,
    first_order,
    observations_of,
    oscillator,
    predicted,
    swept,
    withheld,
)

from nmt_diagnose.inference.chain_errors import sweep_directions
from nmt_diagnose.inference.diagnose import diagnose_observations
from nmt_diagnose.inference.diagnosis import Verdict
from nmt_diagnose.inference.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.inference.sweep_drift import sweep_drift
from nmt_diagnose.observations.conditions import SteppedSineTest
from nmt_diagnose.observations.measuring_chain import table_chain
from nmt_diagnose.observations.observables import Observations
from nmt_diagnose.observations.stepped_table_observations import jumps_of
from nmt_diagnose.twin.forward import Forward

DRIFT = 4e-4


def drifting(drift: float, seed: int = 3, directions: tuple[int, ...] = (1, -1)) -> Observations:
    """Sweeps of a Duffing oscillator in closed form; the whole frequency axis of each is off by a part of its own."""
    random = np.random.default_rng(seed)
    hz = np.linspace(47.0, 57.0, 30)
    tests = []
    for force in (0.3, 0.6, 1.0, 1.6) if len(directions) > 1 else (0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.3, 1.6):
        for direction in directions:
            shift = 1.0 + drift * random.standard_normal()
            exact = np.array([first_order(f / shift, force)[-1 if direction > 0 else 0] for f in hz])
            noise = random.standard_normal((2, hz.size))
            noisy = exact * np.exp(5e-3 * (noise[0] + 1j * noise[1]))
            keep = np.ones(hz.size, dtype=bool)
            for jump in jumps_of(noisy):
                keep[[jump, jump + 1]] = False
            tests.append(swept(hz[keep], force, noisy[keep], direction))
    found = observations_of(tests)
    return Observations(
        found.tests, found.rows, found.values, found.std, found.floor, chains=(table_chain(),) * len(tests)
    )  # fmt: skip


def found_drift(observations: Observations) -> float:
    rig = oscillator(CUBIC)
    forward = Forward(observations.tests, observations.rows)
    prediction = forward.predict(rig)
    difference = Problem(observations, forward).difference(prediction.values)
    return sweep_drift(observations, difference, sweep_directions(observations, rig, prediction))


def test_direction_is_the_slope_of_the_response() -> None:
    observations = drifting(0.0)
    forward = Forward(observations.tests, observations.rows)
    rig = oscillator(CUBIC)
    columns = sweep_directions(observations, rig, forward.predict(rig))
    test = observations.tests[0]
    assert isinstance(test, SteppedSineTest)
    # By whole predictions of lines that lie a little higher, which is a resonance that lies a little lower.
    step = 1e-5
    moved = SteppedSineTest(**{**vars(test), "lines_hz": test.lines_hz * (1.0 - step)})
    slope = np.log(predicted(rig, moved) / predicted(rig, test)) / step
    mine = observations.rows.test == 0
    expected = np.concatenate([slope.real, slope.imag])
    assert columns[mine, 0] == pytest.approx(expected, rel=0.02, abs=0.02 * float(np.abs(expected).max()))
    assert not columns[~mine, 0].any()


@pytest.mark.parametrize("directions", [(1, -1), (1,)])
def test_drift_is_estimated(directions: tuple[int, ...]) -> None:
    many = [found_drift(drifting(DRIFT, seed, directions)) for seed in range(6)]
    # From four differences, or six about neighbours: each is known to a factor of two at best.
    assert 0.5 * DRIFT < float(np.median(many)) < 2.0 * DRIFT


@pytest.mark.parametrize("directions", [(1, -1), (1,)])
def test_noise_is_no_drift(directions: tuple[int, ...]) -> None:
    assert [found_drift(drifting(0.0, seed, directions)) for seed in range(4)] == [0.0] * 4


@pytest.mark.campaign
def test_a_drifting_rig_is_still_a_cubic_one() -> None:
    settings = DiagnosisSettings(withheld=withheld(KNOWN), look_ahead=False)
    found = diagnose_observations(oscillator(), drifting(DRIFT), settings).diagnosis
    assert found.verdict is Verdict.EFFECT
    assert found.ranking[0].effect == "cubic_stiffness"
    k = found.ranking[0].parameters["k"]
    assert abs(k.value - CUBIC) < 3.0 * k.std
