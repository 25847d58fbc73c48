"""Nonlinear subspace identification against closed forms of an oscillator, and what its study makes of results."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, resample_poly, sosfilt

from nmt_core.errors import BenchError
from nmt_report.svg import figure_style
from nmt_rig.model.assembly import assemble, displacement_output
from nmt_rig.model.chain import lumped_chain
from nmt_rig.model.local_elements.springs import CubicSpring
from nmt_rig.model.time_integration import TimeIntegrator
from nmt_study import identification, nonlinear_subspace
from nmt_study.nonlinear_subspace import PolynomialStateSpace, Recording, identify

RATE, FINE = 500.0, 10
MASS, DAMPER, SPRING, CUBIC = 1.0, 0.8, (2.0 * np.pi * 20.0) ** 2, 4e9
PLACE = np.array([1.0])


def recorded(rms: float, seconds: float, seed: int) -> Recording:
    """A Duffing oscillator under noise from 8 to 50 Hz, integrated in fine steps by other code than is tested."""
    fine = RATE * FINE
    noise = np.random.default_rng(seed).standard_normal(round(seconds * RATE))
    band = sosfilt(butter(4, [8.0, 50.0], "band", fs=RATE, output="sos"), noise)
    force = resample_poly(rms * band / band.std(), FINE, 1)
    structure = lumped_chain([MASS], [], None, [SPRING], [DAMPER])
    system = assemble(structure, [CubicSpring(np.array([1.0]), CUBIC)], 1)
    motion = TimeIntegrator(system, fine, [displacement_output(system, 1)]).advance(np.append(force, 0.0))
    return Recording(force[::FINE], motion[:, ::FINE])


@pytest.fixture(scope="module")
def model() -> PolynomialStateSpace:
    return identify([recorded(0.3, 10.0, 1), recorded(2.0, 10.0, 2)], PLACE, (2, 3), 4, RATE)


def test_the_linear_mode_is_that_of_the_oscillator(model: PolynomialStateSpace) -> None:
    s = RATE * np.log(model.poles)
    lowest = s[np.argmin(np.abs(s))]
    assert abs(lowest) == pytest.approx(math.sqrt(SPRING / MASS), rel=1e-3)
    assert -lowest.real / abs(lowest) == pytest.approx(DAMPER / (2.0 * math.sqrt(SPRING * MASS)), rel=0.1)


def test_its_phase_resonance_is_the_backbone_of_a_duffing_oscillator(model: PolynomialStateSpace) -> None:
    """ω² = k + ¾ k₃ A² to first order, and the force balances the damper: F = c ω A."""
    amplitudes = np.geomspace(1e-5, 7e-4, 6)
    found = model.phase_resonance(amplitudes, 0, math.sqrt(SPRING / MASS), 5)
    expected = np.sqrt((SPRING + 0.75 * CUBIC * amplitudes**2) / MASS)
    np.testing.assert_allclose(found[:, 0], expected, rtol=2e-3)
    np.testing.assert_allclose(found[:, 1], DAMPER * expected * amplitudes, rtol=0.15)
    np.testing.assert_allclose(np.hypot(found[:, 2], found[:, 3]), amplitudes, rtol=1e-2)


def test_it_predicts_a_recording_that_it_has_not_seen(model: PolynomialStateSpace) -> None:
    fresh = recorded(1.0, 6.0, 3)
    predicted = model.simulate(fresh.force)
    linear = identify([recorded(0.3, 10.0, 1), recorded(2.0, 10.0, 2)], PLACE, (), 4, RATE).simulate(fresh.force)
    scale = float(fresh.outputs.std())
    assert float((predicted - fresh.outputs).std()) < 0.3 * scale
    assert float((predicted - fresh.outputs).std()) < 0.7 * float((linear - fresh.outputs).std())


def test_a_motion_without_bound_ends_in_no_number(model: PolynomialStateSpace) -> None:
    assert np.isnan(model.simulate(np.full(2000, 1e6))[0, -1])


def test_what_cannot_be_identified_is_refused() -> None:
    short = Recording(np.ones(50), np.ones((1, 50)))
    with pytest.raises(BenchError, match="too short"):
        identify([short], PLACE, (3,), 4, RATE)


def result(structure: str, off: float) -> dict[str, Any]:
    """A result whose subspace model is off by a share, and whose diagnosis is right."""
    case = next(case for case in identification.cases(False) if case.labels["structure"] == structure)
    q = np.geomspace(*nonlinear_subspace.AMPLITUDES, 5)
    reference = {"modal_amplitude": q.tolist(), "omega_rad_s": [120.0] * 5, "damping_ratio": [0.01] * 5}
    wrong = {
        "modal_amplitude": [*q[:4].tolist(), None],
        "omega_rad_s": [*[120.0 * (1.0 + 0.1 * off)] * 4, None],
        "damping_ratio": [*[0.01 * (1.0 + off)] * 4, None],
    }
    methods = {"subspace": {**wrong, "sweep_error": None}, "diagnosis": {**reference, "sweep_error": 0.01}}
    extra = {"reference": reference, "methods": methods, "told": "the diagnosis says effect (cubic_stiffness)."}
    return {"case": case.to_mapping(), "extra": extra, "levels": []}


def test_errors_are_those_at_the_amplitudes_that_were_found() -> None:
    results = [result("cubic", 0.02), result("friction", 0.4)]
    np.testing.assert_allclose(identification.errors(results[0], "subspace"), [[0.002] * 4, [0.02] * 4], rtol=1e-9)
    assert identification.errors(results[0], "diagnosis").shape == (2, 5)
    with figure_style():
        output = identification.show(results)
    assert [finding.holds for finding in output.findings] == [True, True, False, True]
    assert [row[6] for row in output.tables[0].rows] == ["4 of 5", "5 of 5"] * 2
    assert len(output.figures) == 1
