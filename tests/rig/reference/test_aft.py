"""Local forces of periodic motions against closed forms, dense sampling and finite differences."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from scipy.special import gamma

from nmt_core.errors import BenchError
from nmt_rig.model.aft import LocalForces, forces_alone
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.local_elements.contacts import AnyContact, TwoSidedGap, UnilateralStop
from nmt_rig.model.local_elements.dampers import (
    AmplitudeDamper,
    AnyDamper,
    EddyBrake,
    LinearDamper,
    PolynomialDamper,
    PowerLawDamper,
    QuadraticDrag,
)
from nmt_rig.model.local_elements.element import LocalElement
from nmt_rig.model.local_elements.friction import AnyFriction, Jenkins, StribeckBelt, TanhFriction, WeakeningFriction
from nmt_rig.model.local_elements.springs import AnySpring, CubicSpring, LinearSpring, QuadraticSpring, QuinticSpring

D = np.array([1.0])
OMEGA = 3.0


def pure_cosine(basis: FourierBasis, amplitude: float) -> np.ndarray:
    w = np.zeros((1, basis.size))
    w[0, basis.offsets[basis.fundamental]] = amplitude
    return w


def harmonic(basis: FourierBasis, force: np.ndarray, order: int) -> complex:
    return complex(basis.to_complex(force)[0, list(basis.orders).index(order)])


def sampled_play(w: np.ndarray, stiffness: float, limit: float) -> np.ndarray:
    """Jenkins force by a plain time march over two periods; the second one is periodic."""
    g, previous = 0.0, 0.0
    march = np.concatenate((np.linspace(0.0, w[0], 50), w, w))
    forces = []
    for value in march:
        g = float(np.clip(g + stiffness * (value - previous), -limit, limit))
        previous = value
        forces.append(g)
    return np.array(forces[-w.size :])


@pytest.mark.parametrize("amplitude", [1.001, 1.5, 4.0, 300.0])
def test_jenkins_fundamental_is_the_describing_function(amplitude: float) -> None:
    stiffness, limit = 2.0, 2.0
    basis = FourierBasis.up_to(7)
    force, _, _ = LocalForces.gather([Jenkins(D, stiffness, limit)], basis).forces(pure_cosine(basis, amplitude), OMEGA)
    reach = limit / stiffness
    turn = np.arccos(1.0 - 2.0 * reach / amplitude)
    in_phase = stiffness * amplitude / np.pi * (turn - 0.5 * np.sin(2.0 * turn))
    dissipated = 4.0 * limit * (amplitude - reach)
    fundamental = harmonic(basis, force, 1)
    assert fundamental.real == pytest.approx(in_phase, rel=1e-12)
    assert np.pi * amplitude * fundamental.imag == pytest.approx(dissipated, rel=1e-12)


def test_sticking_jenkins_is_a_linear_spring() -> None:
    basis = FourierBasis.up_to(5)
    w = pure_cosine(basis, 0.99)
    force, derivative, _ = LocalForces.gather([Jenkins(D, 2.0, 2.0)], basis).forces(w, OMEGA)
    np.testing.assert_allclose(force, 2.0 * w, atol=1e-15)
    np.testing.assert_allclose(derivative[0], 2.0 * np.eye(basis.size), atol=1e-14)


def test_jenkins_harmonics_of_a_motion_with_many_turning_points_against_dense_sampling() -> None:
    basis = FourierBasis.up_to(9)
    w = np.zeros((1, basis.size))
    w[0, basis.offsets[1]], w[0, basis.offsets[3] + 1], w[0, basis.offsets[5]] = 1.0, 0.6, 0.35
    w[0, 0] = 0.2
    force, _, _ = LocalForces.gather([Jenkins(D, 3.0, 0.7)], basis).forces(w, OMEGA)
    errors = []
    for samples in (2**13, 2**15):
        g = sampled_play(basis.sampled(samples) @ w[0], 3.0, 0.7)
        # Trapezoidal sums of the sampled force; its switches are off by a fraction of a sample.
        expected = np.array([2.0 * np.mean(g * column) for column in basis.sampled(samples).T])
        expected[0] *= 0.5
        errors.append(np.abs(force[0] - expected).max())
    assert errors[1] < 1e-7
    assert errors[1] < errors[0] / 8.0


def test_parallel_jenkins_elements_share_one_coordinate_and_add_up() -> None:
    basis = FourierBasis.up_to(7)
    elements = [Jenkins(D, k, 0.5) for k in (0.4, 1.0, 3.0)]
    together = LocalForces.gather(elements, basis)
    w = pure_cosine(basis, 0.9)
    assert together.coordinates == 1
    single = sum(LocalForces.gather([element], basis).forces(w, OMEGA)[0] for element in elements)
    np.testing.assert_allclose(together.forces(w, OMEGA)[0], single, atol=1e-14)


def test_smooth_springs_against_closed_forms() -> None:
    basis = FourierBasis.up_to(5)
    a = 1.3
    w = pure_cosine(basis, a)

    def force(element: LocalElement, order: int) -> complex:
        return harmonic(basis, LocalForces.gather([element], basis).forces(w, OMEGA)[0], order)

    assert force(CubicSpring(D, 2.0), 1) == pytest.approx(1.5 * a**3, rel=1e-13)
    assert force(CubicSpring(D, 2.0), 3) == pytest.approx(0.5 * a**3, rel=1e-13)
    assert force(QuinticSpring(D, 2.0), 5) == pytest.approx(a**5 / 8.0, rel=1e-12)
    assert force(QuadraticSpring(D, 2.0), 0) == pytest.approx(a**2, rel=1e-13)
    assert force(LinearSpring(D, 2.0), 1) == pytest.approx(2.0 * a, rel=1e-13)
    assert force(LinearDamper(D, 2.0), 1) == pytest.approx(2j * OMEGA * a, rel=1e-13)
    assert force(QuadraticDrag(D, 2.0), 1) == pytest.approx(2j * (OMEGA * a) ** 2 * 8.0 / (3.0 * np.pi), rel=1e-6)


@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.0, 2.7, 5.0])
def test_energy_that_dampers_take_a_cycle(exponent: float) -> None:
    """Of w = a cos θ: π/4 c ω a⁴ for c w² ẇ; c ωᵖ aᵖ⁺¹ ∫|sin θ|ᵖ⁺¹ dθ for c |ẇ|ᵖ, 2√π Γ(p/2 + 1)/Γ(p/2 + 3/2)."""
    basis = FourierBasis.up_to(5)
    a = 0.8

    def dissipated(element: LocalElement) -> float:
        force = LocalForces.gather([element], basis).forces(pure_cosine(basis, a), OMEGA)[0]
        return float(np.pi * a * harmonic(basis, force, 1).imag)

    assert dissipated(AmplitudeDamper(D, 2.5)) == pytest.approx(np.pi / 4 * 2.5 * OMEGA * a**4, rel=1e-13)
    polynomial = np.pi * OMEGA * a**2 * (-0.4 + 2.5 / 4.0 * a**2 + 1.2 / 8.0 * a**4)
    assert dissipated(PolynomialDamper(D, -0.4, 2.5, 1.2)) == pytest.approx(polynomial, rel=1e-13)
    integral = 2.0 * np.sqrt(np.pi) * gamma(0.5 * exponent + 1.0) / gamma(0.5 * exponent + 1.5)
    expected = 2.5 * OMEGA**exponent * a ** (exponent + 1.0) * integral
    assert dissipated(PowerLawDamper(D, 2.5, exponent)) == pytest.approx(expected, rel=1e-6)
    third = LocalForces.gather([AmplitudeDamper(D, 2.5)], basis).forces(pure_cosine(basis, a), OMEGA)[0]
    assert harmonic(basis, third, 3) == pytest.approx(0.25j * 2.5 * OMEGA * a**3, rel=1e-13)


def test_stops_against_closed_forms() -> None:
    basis = FourierBasis.up_to(3)
    a, gap, k = 2.0, 0.7, 5.0
    opening = np.arccos(gap / a)
    half = k * a / np.pi * (opening - 0.5 * np.sin(2.0 * opening))
    mean = k / np.pi * (a * np.sin(opening) - gap * opening)
    one = LocalForces.gather([UnilateralStop(D, k, gap)], basis).forces(pure_cosine(basis, a), OMEGA)[0]
    two = LocalForces.gather([TwoSidedGap(D, k, gap)], basis).forces(pure_cosine(basis, a), OMEGA)[0]
    assert harmonic(basis, one, 0) == pytest.approx(mean, rel=1e-12)
    assert harmonic(basis, one, 1) == pytest.approx(half, rel=1e-12)
    assert abs(harmonic(basis, two, 0)) < 1e-14
    assert harmonic(basis, two, 1) == pytest.approx(2.0 * half, rel=1e-12)


def test_preloaded_stop_in_full_contact_is_a_spring_with_an_offset() -> None:
    basis = FourierBasis.up_to(3)
    force = LocalForces.gather([UnilateralStop(D, 5.0, -3.0)], basis).forces(pure_cosine(basis, 2.0), OMEGA)[0]
    assert harmonic(basis, force, 0) == pytest.approx(15.0, rel=1e-13)
    assert harmonic(basis, force, 1) == pytest.approx(10.0, rel=1e-13)


DIFFERENTIATED: dict[str, list[LocalElement]] = {
    "jenkins": [Jenkins(D, 3.0, 0.7)],
    "two jenkins": [Jenkins(D, 3.0, 0.7), Jenkins(D, 1.0, 0.9)],
    "stops": [UnilateralStop(D, 4.0, 0.3), TwoSidedGap(D, 2.0, 0.1)],
    "springs": [LinearSpring(D, 1.0), CubicSpring(D, 2.0), QuinticSpring(D, 1.0), QuadraticSpring(D, 0.5)],
    "drag": [QuadraticDrag(D, 1.5), LinearDamper(D, 0.3)],
    "tanh": [TanhFriction(D, 1.0, 0.5), WeakeningFriction(D, 0.6, 0.5, 0.8)],
    "dampers": [AmplitudeDamper(D, 1.5), PowerLawDamper(D, 0.7, 2.6)],
    "brake": [EddyBrake(D, 1.5, 0.7)],
    "self-excited": [PolynomialDamper(D, -0.5, 1.5, 0.3), StribeckBelt(D, 0.4, 1.0, 4.0, 1.5)],
}


def test_every_local_element_that_harmonic_balance_covers_is_differentiated() -> None:
    sections = get_args(AnySpring | AnyDamper | AnyFriction | AnyContact)
    covered = {section.element for section in sections if not section.without_harmonic_balance}
    assert {type(element) for elements in DIFFERENTIATED.values() for element in elements} == covered


@pytest.mark.parametrize("elements", DIFFERENTIATED.values(), ids=DIFFERENTIATED)
@pytest.mark.parametrize("odd_only", [False, True])
def test_derivatives_against_finite_differences(elements: list[LocalElement], odd_only: bool) -> None:
    basis = FourierBasis.up_to(7, odd_only)
    local = LocalForces.gather(elements, basis)
    rng = np.random.default_rng(3)
    # A dominant fundamental with harmonics: several pieces, hysteretic memory, mean value.
    w = 0.12 * rng.normal(size=(1, basis.size))
    w[0, basis.offsets[basis.fundamental]] += 1.0
    _, derivative, by_frequency = local.forces(w, OMEGA)
    step = 1e-6
    numeric = np.empty((basis.size, basis.size))
    for k in range(basis.size):
        ahead, behind = w.copy(), w.copy()
        ahead[0, k] += step
        behind[0, k] -= step
        numeric[:, k] = (local.forces(ahead, OMEGA)[0][0] - local.forces(behind, OMEGA)[0][0]) / (2 * step)
    np.testing.assert_allclose(derivative[0], numeric, atol=2e-6 * np.abs(derivative).max())
    numeric_frequency = (local.forces(w, OMEGA + step)[0] - local.forces(w, OMEGA - step)[0]) / (2 * step)
    np.testing.assert_allclose(by_frequency, numeric_frequency, atol=1e-7)


def with_samples(local: LocalForces, samples: int) -> LocalForces:
    """The same elements with another number of samples per period."""
    values, slopes = local.basis.sampled(samples), local.basis.sampled_slope(samples)
    return replace(local, samples=samples, values=values, slopes=slopes)


def sampling_error(local: LocalForces, displacement: np.ndarray) -> float:
    """Largest change of the coefficients with four times the samples, relative to the largest."""
    coarse = local.forces(displacement, OMEGA)[0]
    fine = with_samples(local, 4 * local.samples).forces(displacement, OMEGA)[0]
    return float(np.max(np.abs(fine - coarse)) / np.max(np.abs(fine)))


@pytest.mark.parametrize(
    ("element", "bound"),
    [
        (Jenkins(D, 3.0, 0.7), 0.0),
        (UnilateralStop(D, 3.0, 0.2), 0.0),
        (QuinticSpring(D, 3.0), 1e-13),
        (QuadraticDrag(D, 3.0), 1e-6),
        (AmplitudeDamper(D, 3.0), 1e-13),
        (PowerLawDamper(D, 3.0, 1.5), 1e-6),
        (TanhFriction(D, 3.0, 0.1), 1e-6),
        (WeakeningFriction(D, 3.0, 0.1, 0.3), 1e-6),
        (PolynomialDamper(D, -1.0, 2.0, 3.0), 1e-13),
        (StribeckBelt(D, 1.0, 3.0, 1.5, 2.0), 1e-6),
    ],
)
def test_sampling_error_stays_below_one_in_a_million(element: LocalElement, bound: float) -> None:
    basis = FourierBasis.up_to(7)
    w = pure_cosine(basis, 1.0)
    w[0, basis.offsets[3]] = 0.1
    assert sampling_error(LocalForces.gather([element], basis), w) <= bound


def test_coarse_sampling_of_a_smooth_element_is_seen() -> None:
    basis = FourierBasis.up_to(7)
    local = with_samples(LocalForces.gather([TanhFriction(D, 1.0, 0.02)], basis), 64)
    assert sampling_error(local, pure_cosine(basis, 1.0)) > 1e-4


def test_constant_displacement_gives_the_constant_force() -> None:
    basis = FourierBasis.up_to(3)
    w = np.zeros((1, basis.size))
    w[0, 0] = 2.0
    force = LocalForces.gather([Jenkins(D, 3.0, 0.7), UnilateralStop(D, 1.0, 0.5)], basis).forces(w, OMEGA)[0]
    assert force[0, 0] == pytest.approx(0.7 + 1.5, rel=1e-12)
    np.testing.assert_allclose(force[0, 1:], 0.0, atol=1e-13)


def test_basis_round_trip_and_refusals() -> None:
    basis = FourierBasis.up_to(5)
    coefficients = np.random.default_rng(0).normal(size=(2, basis.size))
    np.testing.assert_allclose(basis.to_real(basis.to_complex(coefficients)), coefficients)
    with pytest.raises(BenchError, match="at least 1"):
        FourierBasis.up_to(0)
    with pytest.raises(BenchError, match="contain 1"):
        FourierBasis.of([0, 2])
    with pytest.raises(BenchError, match="needs a local element"):
        LocalForces.gather([], basis)


def test_forces_alone_are_those_with_derivatives() -> None:
    """Two coordinates: slipping, stopped and smooth elements beside each other, and smooth ones alone."""
    basis = FourierBasis.up_to(5)
    one, two = np.array([1.0, 0.0]), np.array([0.0, 1.0])
    elements: list[LocalElement] = [
        Jenkins(one, 2.0, 1.0), Jenkins(one, 1.0, 0.2), TwoSidedGap(one, 3.0, 0.4), CubicSpring(one, 0.7),
        PowerLawDamper(two, 0.5, 1.4), QuadraticDrag(two, 0.3),
    ]  # fmt: skip
    gathered = LocalForces.gather(elements, basis)
    w = np.random.default_rng(3).standard_normal((2, basis.size))
    forces, derivative, _ = gathered.forces(w, OMEGA)
    assert np.all(np.any(derivative != 0.0, axis=(1, 2)))
    np.testing.assert_array_equal(forces_alone(w, OMEGA, gathered.tables), forces)
