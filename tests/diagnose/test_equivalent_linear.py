"""Forces under Gaussian motion: their equivalents against closed forms, and against oscillators that are simulated."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from nmt_core.messages.blocks import Quantity
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.random_responses import RandomResponses
from nmt_diagnose.observations.observables import Part, Rows
from nmt_diagnose.prediction.equivalent_linear import equivalents
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.prediction.rig_tables import local_tables
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.local_elements.contacts import TwoSidedGap, UnilateralStop
from nmt_rig.model.local_elements.dampers import AmplitudeDamper, PowerLawDamper, QuadraticDrag
from nmt_rig.model.local_elements.element import LocalElement
from nmt_rig.model.local_elements.friction import Jenkins
from nmt_rig.model.local_elements.springs import CubicSpring, QuinticSpring
from nmt_rig.rig import Rig

ALONG = np.ones(1)
X, V = 2e-4, 0.3
"""Rms of displacement, m, and of velocity, m/s."""


def _of(element: LocalElement) -> tuple[float, float]:
    tables = local_tables([[element]], FourierBasis.up_to(1), None)
    stiffness, damping = equivalents(tables, np.array([X]), np.array([V]))
    return float(stiffness[0]), float(damping[0])


def _power(c: float, p: float) -> float:
    """E[c |v|^(p+1)] / σ²."""
    return float(c * V ** (p - 1.0) * 2.0 ** (0.5 * (p + 1.0)) * math.gamma(0.5 * p + 1.0) / math.sqrt(math.pi))


def _in_contact(gap: float) -> float:
    return 0.5 * math.erfc(gap / X / math.sqrt(2.0))


@pytest.mark.parametrize(
    ("element", "stiffness", "damping"),
    [
        (CubicSpring(ALONG, 3e8), 3.0 * 3e8 * X**2, 0.0),
        (QuinticSpring(ALONG, 5e15), 15.0 * 5e15 * X**4, 0.0),
        (QuadraticDrag(ALONG, 4.0), 0.0, 2.0 * 4.0 * V * math.sqrt(2.0 / math.pi)),
        (PowerLawDamper(ALONG, 0.7, 1.5), 0.0, _power(0.7, 1.5)),
        (PowerLawDamper(ALONG, 0.7, 3.0), 0.0, _power(0.7, 3.0)),
        (AmplitudeDamper(ALONG, 2e5), 0.0, 2e5 * X**2),
        (UnilateralStop(ALONG, 1e5, 1e-4), 1e5 * _in_contact(1e-4), 0.0),
        (TwoSidedGap(ALONG, 1e5, 3e-4), 2e5 * _in_contact(3e-4), 0.0),
        (Jenkins(ALONG, 1e4, 1e3), 1e4, 0.0),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, LocalElement) else "",
)
def test_equivalents_in_closed_form(element: LocalElement, stiffness: float, damping: float) -> None:
    found = _of(element)
    assert found[0] == pytest.approx(stiffness, rel=2e-3, abs=1e-9 * 1e4)
    assert found[1] == pytest.approx(damping, rel=2e-3, abs=1e-9)


def test_a_slider_that_always_slips_dissipates_as_coulomb_friction_does() -> None:
    slip = 0.5
    _, damping = _of(Jenkins(ALONG, 1e9, slip))
    # 4 μN A a cycle, over π ω A² in the mean: E[A] / E[A²] of Rayleigh's distribution.
    expected = 4.0 * slip / math.pi * math.sqrt(math.pi / 2.0) / (2.0 * X) * X / V
    assert damping == pytest.approx(expected, rel=2e-2)


FREQUENCY, MASS, RATIO = 20.0, 1.0, 0.02


def _rig(element: dict[str, Any]) -> Rig:
    omega = 2.0 * math.pi * FREQUENCY
    structure = {
        "kind": "chain",
        "masses_kg": [MASS],
        "springs_n_m": [],
        "dampers_ns_m": [],
        "ground_springs_n_m": [MASS * omega**2],
        "ground_dampers_ns_m": [2.0 * RATIO * omega * MASS],
    }
    return Rig.model_validate(
        {
            "name": "one_mass",
            "sample_rate_hz": 1000.0,
            "structure": structure,
            "exciter": {"kind": "force", "point": 1, "newton_per_volt": 1.0},
            "sensors": [{"quantity": "force", "point": "drive"}, {"quantity": "displacement", "point": 1}],
            "local_elements": [element],
        }
    )


def _force(element: dict[str, Any], x: NDArray[Any], v: NDArray[Any]) -> NDArray[Any]:
    if element["kind"] == "cubic_spring":
        return np.asarray(element["stiffness_n_m3"] * x**3)
    return np.asarray(element["coefficient_n_sp_mp"] * np.abs(v) ** element["exponent"] * np.sign(v))


def _simulated(element: dict[str, Any], rms: float, lines: NDArray[Any]) -> NDArray[Any]:
    """Response to a random force with all lines of 1/T up to 60 Hz, by Runge-Kutta steps of 64 realisations."""
    omega, period, steps, count = 2.0 * math.pi * FREQUENCY, 20.0, 20_000, 64
    generator = np.random.default_rng(8)
    spectrum = np.zeros((count, steps + 1), dtype=np.complex128)
    driven = slice(1, int(60.0 * period))
    spectrum[:, driven] = np.exp(2j * np.pi * generator.random((count, spectrum[0, driven].size)))
    force = np.fft.irfft(spectrum, 2 * steps, axis=1)
    force *= rms / force.std(axis=1, keepdims=True)
    h = period / steps

    def slope(x: NDArray[Any], v: NDArray[Any], f: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        return v, f - omega**2 * x - 2.0 * RATIO * omega * v - _force(element, x, v)

    x, v = np.zeros(count), np.zeros(count)
    record = np.empty((count, steps))
    for _ in range(2):  # the first period settles
        for k in range(steps):
            f0, f1, f2 = force[:, 2 * k], force[:, 2 * k + 1], force[:, (2 * k + 2) % (2 * steps)]
            record[:, k] = x
            a = slope(x, v, f0)
            b = slope(x + 0.5 * h * a[0], v + 0.5 * h * a[1], f1)
            c = slope(x + 0.5 * h * b[0], v + 0.5 * h * b[1], f1)
            d = slope(x + h * c[0], v + h * c[1], f2)
            x = x + h / 6.0 * (a[0] + 2.0 * b[0] + 2.0 * c[0] + d[0])
            v = v + h / 6.0 * (a[1] + 2.0 * b[1] + 2.0 * c[1] + d[1])
    response, drive = np.fft.rfft(record, axis=1), np.fft.rfft(force[:, ::2], axis=1)
    bins = np.round(lines * period).astype(int)
    near = bins[:, np.newaxis] + np.arange(-2, 3)
    cross = np.sum(response[:, near] * np.conj(drive[:, near]), axis=(0, 2))
    return np.asarray(cross / np.sum(np.abs(drive[:, near]) ** 2, axis=(0, 2)))


def _predicted(rig: Rig, lines: NDArray[Any], drive: float, others: dict[int, float] | None = None) -> NDArray[Any]:
    """Response at point 1 to the exciter there, driven with this rms; ``others`` are points and rms of further ones."""
    point, count = MeasuredChannel("x1", Quantity.DISPLACEMENT, 1), lines.size
    beside = {"resting_points": tuple(others or ()), "other_rms": tuple((others or {}).values())}
    test = RandomResponses("random", 1, (point,), "voltage", lines, 0.05, "none", drive, 0.0, 20.0, **beside)
    own = np.tile(np.arange(count), 2)
    zero = np.zeros(2 * count, dtype=np.int64)
    part = np.repeat([int(Part.LOG_MAGNITUDE), int(Part.PHASE)], count)
    flat = np.zeros(2 * count)
    rows = Rows(zero, own, zero, zero - 1, part, np.tile(lines, 2), flat, flat)
    values = Forward((test,), rows).predict(rig).values
    return np.asarray(np.exp(values[:count] + 1j * values[count:]))


@pytest.mark.parametrize(
    ("element", "moves"),
    [
        ({"kind": "cubic_spring", "point": 1, "stiffness_n_m3": 2e9}, 0.1),
        pytest.param(
            {"kind": "power_law_damper", "point": 1, "coefficient_n_sp_mp": 20.0, "exponent": 1.5}, 0.2,
            marks=pytest.mark.campaign,
        ),
    ],
    ids=["cubic", "power law"],
)  # fmt: skip
def test_a_random_response_of_a_nonlinear_oscillator(element: dict[str, Any], moves: float) -> None:
    lines = np.concatenate([np.arange(8.0, 18.0, 1.0), np.arange(18.0, 23.0, 0.25), np.arange(23.0, 40.0, 1.0)])
    rms = 1.0
    rig = _rig(element)
    # The force has lines up to 60 Hz; the test's lines hold their share of it.
    drive = rms * math.sqrt((lines[-1] - lines[0]) / 60.0)
    simulated, found, resting = (
        _simulated(element, rms, lines),
        _predicted(rig, lines, drive),
        _predicted(rig, lines, 0.0),
    )
    scale = np.max(np.abs(simulated))
    assert np.max(np.abs(found - simulated)) < 0.06 * scale
    assert np.max(np.abs(resting - simulated)) > (0.06 + moves) * scale


def _halves(points: tuple[int, ...]) -> Rig:
    """Two halves of a mass, linked as good as rigidly, on a hardening spring, with an exciter at each of the points."""
    exciters = [{"kind": "force", "point": point, "newton_per_volt": 1.0} for point in points]
    structure = {
        "kind": "chain", "masses_kg": [0.5, 0.5], "springs_n_m": [1e9], "dampers_ns_m": [0.0],
        "ground_springs_n_m": [0.5 * (2.0 * math.pi * FREQUENCY) ** 2] * 2, "ground_dampers_ns_m": [2.5] * 2,
    }  # fmt: skip
    return Rig.model_validate(
        {
            "name": "halves",
            "sample_rate_hz": 1000.0,
            "structure": structure,
            **({"exciter": exciters[0]} if len(points) == 1 else {"exciters": exciters}),
            "sensors": [{"quantity": "force", "point": point} for point in points]
            + [{"quantity": "displacement", "point": 1}],
            "local_elements": [{"kind": "cubic_spring", "point": 1, "stiffness_n_m3": 2e9}],
        }
    )


def test_two_exciters_move_a_body_as_one_of_their_power() -> None:
    lines = np.linspace(15.0, 30.0, 31)
    one, resting = (_predicted(_halves((1,)), lines, drive) for drive in (0.5, 0.0))
    both = _predicted(_halves((1, 2)), lines, 0.3, {2: 0.4})
    np.testing.assert_allclose(both, one, rtol=1e-4)
    assert np.abs(resting / one - 1.0).max() > 0.3
    np.testing.assert_allclose(_predicted(_halves((1, 2)), lines, 0.5, {2: 0.0}), one, rtol=1e-4)
