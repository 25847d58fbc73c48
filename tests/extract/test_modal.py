from __future__ import annotations

import math

import numpy as np
import pytest
from extract.synthetic import (
    FREQUENCY,
    OMEGA,
    RATE,
    SETTINGS,
    SHAPES,
    Stream,
    extract,
    in_phase_case,
    linear_description,
    lock_event,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from nmt_core.messages.blocks import Quantity
from nmt_core.messages.modal_point import ANGLES, EVALUATED
from nmt_core.vocabulary import PointStatus
from nmt_extract.extraction_settings import ExtractionSettings
from nmt_extract.modal.quantities import estimated_mass

SAMPLES = round(12 * RATE / FREQUENCY)
LOCK = lock_event(100, SAMPLES, 12)
TOTAL = SAMPLES + 400


def pure(force, shape, **changes):
    return Stream([0, force], [[0, x] for x in shape], samples=TOTAL, **changes)


def test_one_degree_of_freedom_at_resonance_gives_its_damping_exactly():
    """m ẍ + d ẋ + k x = F: at ω₀ the response is F / (i d ω₀), whatever the extraction thinks."""
    mass, zeta = 0.37, 0.0123
    damper = 2.0 * zeta * OMEGA * mass
    force = 0.8
    response = force / (1j * damper * OMEGA)
    linear = linear_description(
        np.array([[1.0 / math.sqrt(mass)]] * 1), points=(2,), frequencies_rad_s=(OMEGA,), damping_ratios=(zeta,)
    )
    point = extract(pure(force, [response] * 4), LOCK, linear)
    assert point.status is PointStatus.OK
    assert point.damping_ratio == pytest.approx(zeta, rel=1e-11)
    assert point.self_excitation == pytest.approx(2.0 * zeta * OMEGA, rel=1e-11)
    assert point.modal_amplitude == pytest.approx(abs(response) * math.sqrt(mass), rel=1e-12)
    assert point.active_power == pytest.approx(0.5 * damper * OMEGA**2 * abs(response) ** 2, rel=1e-11)
    assert point.force_n == pytest.approx(force, rel=1e-12)
    assert point.omega_rad_s == pytest.approx(OMEGA, rel=1e-13)
    assert point.pbmif == pytest.approx(1.0, abs=1e-12)
    assert abs(point.phase_error) < 1e-11


def test_the_exciter_feeding_the_structure_counts_positive():
    force, shape = in_phase_case()
    assert extract(pure(force, shape), LOCK).active_power > 0.0
    drained = extract(pure(-force, shape), LOCK)
    assert drained.status is PointStatus.REJECTED
    assert "-180.0°" in drained.reason or "180.0°" in drained.reason
    assert "would feed the exciter" in drained.reason


def test_phase_error_is_the_lead_of_force_over_velocity():
    force, shape = in_phase_case()
    point = extract(pure(force * np.exp(0.1j), shape), LOCK)
    assert point.phase_error == pytest.approx(0.1, abs=1e-11)
    assert point.pbmif == pytest.approx(math.cos(0.1), abs=1e-11)


def test_two_modes_against_the_power_balance_of_the_modes():
    """Single-point force on a two-mode structure with the phase resonance of the drive point.

    Witness: receptances, and dissipation summed over the modes, neither of which uses M_exp or the force.
    """
    omegas, zetas = np.array([OMEGA * 1.001, 4.1 * OMEGA]), np.array([0.02, 0.05])
    force = 2.0
    modal = SHAPES[0] * force / (omegas**2 - OMEGA**2 + 2j * zetas * omegas * OMEGA)
    shape = SHAPES @ modal
    dissipated = (0.5 * OMEGA**2 * 2.0 * zetas * omegas * np.abs(modal) ** 2).sum()
    amplitude = math.sqrt((np.abs(modal) ** 2).sum())
    point = extract(pure(force, shape), LOCK)
    assert point.modal_amplitude == pytest.approx(amplitude, rel=1e-11)
    assert point.active_power == pytest.approx(dissipated, rel=1e-10)
    assert point.damping_ratio == pytest.approx(dissipated / (OMEGA**3 * amplitude**2), rel=1e-10)
    expected = modal / amplitude * np.exp(-1j * np.angle(modal[0]))
    np.testing.assert_allclose(point.participation, expected, atol=1e-11)
    np.testing.assert_allclose(point.normalised_shape, SHAPES @ expected, atol=1e-10)
    correlation = abs(SHAPES[:, 0] @ shape) ** 2 / (SHAPES[:, 0] @ SHAPES[:, 0] * np.vdot(shape, shape).real)
    assert point.mac == pytest.approx(correlation, rel=1e-12)


def test_estimated_mass_is_the_mass_seen_by_the_modes():
    """For a complete set of modes M_exp is M itself; otherwise Φᵀ M_exp Φ = 1."""
    random = np.random.default_rng(0)
    half = random.normal(size=(4, 4))
    mass = half @ half.T + 4.0 * np.eye(4)
    stiffness = np.diag([1.0, 5.0, 9.0, 20.0])
    lower = np.linalg.cholesky(mass)
    inverse = np.linalg.inv(lower)
    shapes = inverse.T @ np.linalg.eigh(inverse @ stiffness @ inverse.T)[1]
    np.testing.assert_allclose(estimated_mass(shapes), mass, rtol=1e-10)
    np.testing.assert_allclose(SHAPES.T @ estimated_mass(SHAPES) @ SHAPES, np.eye(2), atol=1e-12)


@given(st.floats(0.5, 2.0))
@settings(max_examples=15, deadline=None)
def test_scaled_shapes_multiply_damping_by_kappa_squared(kappa):
    """Paper, section 3.3: κΦ divides q by κ and multiplies δ̃ by κ²."""
    force, shape = in_phase_case()
    point = extract(pure(force, shape), LOCK, linear_description(kappa * SHAPES))
    assert point.damping_ratio == pytest.approx(0.012 * kappa**2, rel=1e-10)
    assert point.modal_amplitude == pytest.approx(1e-3 / kappa, rel=1e-10)
    assert point.mac == pytest.approx(1.0, abs=1e-12)


@given(st.floats(0.01, 100.0))
@settings(max_examples=15, deadline=None)
def test_powers_scale_with_the_square_of_the_level(scale):
    force, shape = in_phase_case()
    point = extract(pure(scale * force, scale * shape), LOCK)
    assert point.damping_ratio == pytest.approx(0.012, rel=1e-10)
    assert point.modal_amplitude == pytest.approx(scale * 1e-3, rel=1e-10)
    assert point.active_power == pytest.approx(scale**2 * 0.5 * abs(force * OMEGA * shape[0]), rel=1e-10)
    assert point.apparent_power == pytest.approx(point.active_power, rel=1e-10)


RICH_FORCE = np.array([0.3, 1.5j, 0.2, 0.1 - 0.05j])
RICH_SHAPE = np.array([[1e-5, x, 0.05 * x * 1j, 0.02 * x, 0.004 * x] for x in SHAPES[:, 0] * 1e-3])
FIELDS = ("frequency_hz", *(name for name in EVALUATED if name not in ANGLES))


@given(shift=st.floats(-10.0, 10.0))
@settings(max_examples=20, deadline=None)
def test_nothing_depends_on_the_time_origin(shift):
    """The oscillator's phase at the first sample is arbitrary, and so is the time origin of a record."""
    still = extract(Stream(RICH_FORCE, RICH_SHAPE, samples=TOTAL), LOCK)
    moved = Stream(RICH_FORCE, RICH_SHAPE, samples=TOTAL, start_cycles=shift)
    # The same motion seen from an oscillator that is ahead: harmonic n of the record turns by n times the
    # shift.
    point = extract(moved, LOCK)
    for name in FIELDS:
        assert getattr(point, name) == pytest.approx(getattr(still, name), rel=1e-9), name
    for name in ("force_harmonics", "shape_harmonics", "normalised_shape", "participation"):
        scale = np.nanmax(np.abs(getattr(still, name)))
        np.testing.assert_allclose(getattr(point, name), getattr(still, name), atol=1e-9 * scale)
    turned = np.exp(-1j * 0.7 * np.arange(5))
    other = extract(Stream(RICH_FORCE * turned[:4], RICH_SHAPE * turned, samples=TOTAL), LOCK)
    np.testing.assert_allclose(other.force_harmonics, still.force_harmonics, atol=1e-9)


@given(size=st.sampled_from([1, 40, 50, 100, 200]), first=st.integers(0, 300))
@settings(max_examples=12, deadline=None)
def test_block_boundaries_do_not_matter(size, first):
    stream = Stream(RICH_FORCE, RICH_SHAPE, samples=TOTAL)
    lock = lock_event(first, SAMPLES, 12)
    whole, cut = extract(stream, lock), extract(stream, lock, size=size)
    for name in FIELDS:
        assert getattr(cut, name) == pytest.approx(getattr(whole, name), rel=1e-11), name


def test_block_boundaries_do_not_change_a_bit_when_the_phase_is_fitted():
    stream = Stream(RICH_FORCE, RICH_SHAPE, samples=TOTAL, known_phase=False, noise=0.01)
    assert extract(stream, LOCK).identical(extract(stream, LOCK, size=40))


def test_indicators_of_rich_signals_against_time_integrals():
    """PBMIF and γ from the power integrals over one finely sampled period (paper, eqs. for P and S)."""
    time = np.arange(4000) / 4000.0
    rotation = np.exp(2j * np.pi * np.outer(np.arange(5), time))
    derivative = 1j * OMEGA * np.arange(5)[:, np.newaxis]
    force = (RICH_FORCE[1:, np.newaxis] * rotation[1:4]).sum(axis=0).real
    velocity = (derivative * RICH_SHAPE[0][:, np.newaxis] * rotation).sum(axis=0).real
    acceleration = (derivative**2 * RICH_SHAPE[0][:, np.newaxis] * rotation).sum(axis=0).real
    apparent = math.sqrt((velocity**2).mean() * (force**2).mean())
    point = extract(Stream(RICH_FORCE, RICH_SHAPE, samples=TOTAL), LOCK)
    assert point.apparent_power == pytest.approx(apparent, rel=1e-9)
    assert point.pbmif == pytest.approx(abs((velocity * force).mean()) / apparent, rel=1e-9)
    fundamental = abs(RICH_FORCE[1]) / math.sqrt(2.0)
    assert point.gamma_force == pytest.approx(fundamental / math.sqrt((force**2).mean()), rel=1e-9)
    first = OMEGA**2 * abs(RICH_SHAPE[0, 1]) / math.sqrt(2.0)
    assert point.gamma_acceleration == pytest.approx(first / math.sqrt((acceleration**2).mean()), rel=1e-9)


@pytest.mark.parametrize("quantity", [Quantity.VELOCITY, Quantity.ACCELERATION])
def test_other_sensors_give_the_same_point(quantity):
    order = 1 if quantity is Quantity.VELOCITY else 2
    derived = RICH_SHAPE * (1j * OMEGA * np.arange(5)) ** order
    settings_ = ExtractionSettings(topics=("force", quantity.topic))
    expected = extract(Stream(RICH_FORCE, RICH_SHAPE, samples=TOTAL), LOCK)
    point = extract(Stream(RICH_FORCE, derived, samples=TOTAL, quantity=quantity), LOCK, settings=settings_)
    for name in FIELDS:
        assert getattr(point, name) == pytest.approx(getattr(expected, name), rel=1e-9), name
    np.testing.assert_allclose(point.shape_harmonics[1:], expected.shape_harmonics[1:], atol=1e-13)
    assert np.isnan(point.shape_harmonics[0]).all()


def test_harmonics_are_limited_by_the_sampling_rate():
    frequency = 900.0
    stream = Stream([0, 1j], [[0, 1e-6]] * 4, samples=2000, frequencies=(frequency,))
    point = extract(stream, lock_event(0, 1000, 90, frequency_hz=frequency))
    assert point.harmonics == 5
    assert point.force_harmonics.shape == (6,)
    assert point.shape_harmonics.shape == (6, 4)


@pytest.mark.parametrize(
    ("linear", "reason"),
    [
        (linear_description(points=(2, 4, 5, 7)), "No kind of response sensor covers all points"),
        (linear_description(drive_point=3), "names point 3 as drive point"),
    ],
)
def test_sensors_that_do_not_fit_are_named(linear, reason):
    force, shape = in_phase_case()
    point = extract(pure(force, shape), LOCK, linear)
    assert point.status is PointStatus.REJECTED
    assert reason in point.reason
    assert math.isnan(point.damping_ratio)


def test_silence_is_rejected():
    point = extract(pure(0.0, np.zeros(4)), LOCK)
    assert point.status is PointStatus.REJECTED
    assert "f2 is dead" in point.reason


def test_numbers_that_do_not_depend_on_who_asks():
    stream = Stream(RICH_FORCE, RICH_SHAPE, samples=TOTAL, noise=0.02)
    first = extract(stream, LOCK, settings=SETTINGS)
    assert all(extract(stream, LOCK, settings=SETTINGS).identical(first) for _ in range(3))
