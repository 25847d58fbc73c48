"""Nonlinear modes of the self-excited rigs against a second harmonic balance, averaging, and motion in time."""

from __future__ import annotations

import numpy as np
import pytest
from independent import self_excited_modes as witness
from tiers import with_quick

from nmt_rig.reference import compute_reference
from nmt_rig.rig import load_rig

# m√kg; the limit cycles are within, and beyond the belt's speed a few are enough.
AMPLITUDES = {
    "van_der_pol": np.linspace(0.3e-3, 7e-3, 12),
    "subcritical": np.linspace(0.4e-3, 8e-3, 12),
    "belt": np.array([0.5, 1.0, 1.8, 2.4, 2.8, 3.2, 3.4, 3.5, 3.55, 3.6, 3.65, 3.7]) * 1e-3,
}


@pytest.mark.parametrize("name", with_quick(list(AMPLITUDES), "van_der_pol"))
def test_backbones_with_a_damping_ratio_of_either_sign(name: str) -> None:
    q = AMPLITUDES[name]
    reference = compute_reference(load_rig(name), 15, q)
    omega, damping = witness.nonlinear_mode(getattr(witness, name)(), q)
    np.testing.assert_allclose(reference.omega_rad_s, omega, rtol=2e-6)
    np.testing.assert_allclose(reference.damping_ratio, damping, atol=2e-6)
    assert damping.min() < -0.005 < 0.005 < damping.max()


def test_van_der_pol_by_averaging() -> None:
    """δ̃ = -ζ ω₀/ω̃ (1 - q²/q_c²) and ω̃² = ω₀² + ¾ k₃ q²/m², of one harmonic alone."""
    q = np.linspace(0.5e-3, 7e-3, 9)
    reference = compute_reference(load_rig("van_der_pol"), 1, q)
    omega = np.sqrt(15791.4 + 0.75 * 5.0e7 * q**2)
    np.testing.assert_allclose(reference.omega_rad_s, omega, rtol=1e-9)
    np.testing.assert_allclose(reference.damping_ratio, 7.54 * ((q / 5e-3) ** 2 - 1.0) / omega, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "start", "low", "high"),
    with_quick(
        [("van_der_pol", 1e-3, 4e-3, 6e-3), ("subcritical", 4e-3, 6e-3, 8e-3), ("belt", 3.2e-3, 3.2e-3, 4e-3)],
        ("van_der_pol", 1e-3, 4e-3, 6e-3),
        ("subcritical", 4e-3, 6e-3, 8e-3),
    ),
)
def test_the_free_motion_settles_where_the_damping_ratio_is_zero(
    name: str, start: float, low: float, high: float
) -> None:
    q = np.linspace(low, high, 30)
    reference = compute_reference(load_rig(name), 15, q)
    assert reference.damping_ratio[0] < 0.0 < reference.damping_ratio[-1]
    expected = float(np.interp(0.0, reference.damping_ratio, q))
    settled, omega = witness.limit_cycle(getattr(witness, name)(), start)
    assert settled == pytest.approx(expected, rel=1e-3)
    assert omega == pytest.approx(float(np.interp(expected, q, reference.omega_rad_s)), rel=1e-4)


def test_a_small_motion_of_the_subcritical_rig_dies_away_and_a_large_one_does_not() -> None:
    """The unstable limit cycle between them is where the damping ratio falls through zero."""
    q = np.linspace(1.5e-3, 3e-3, 30)
    reference = compute_reference(load_rig("subcritical"), 15, q)
    edge = float(np.interp(0.0, -reference.damping_ratio, q))
    model = witness.subcritical()
    shape = 0.8 * edge / float(np.sqrt(model.mass.sum()))
    assert witness.limit_cycle(model, shape)[0] < 0.2 * edge
    assert witness.limit_cycle(model, 1.25 * shape / 0.8)[0] > 2.0 * edge
