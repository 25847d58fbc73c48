"""Derivatives of poles in closed form beside differences of eigenvalues of the system as the bench assembles it."""

from __future__ import annotations

import numpy as np
import pytest
from diagnose.predicted_tests import chain, noise_test
from diagnose.test_structure_kinds import matrices, modal
from scipy.linalg import solve_triangular
from tiers import with_quick

from nmt_diagnose.effects.calibration import calibration_parameters, mode_factors
from nmt_diagnose.effects.library import candidates
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.fit.low_level_modes import LowLevelModes, Modes
from nmt_diagnose.fit.pole_slopes import PoleSlopes, RestingMatrices
from nmt_diagnose.measurements.measurement import RowTable, joined
from nmt_diagnose.prediction.operating_range import operating_range
from nmt_rig.rig import Rig, load_rig
from nmt_rig.rig_model import build_system

STEP = 4e-3
LINEAR = ("linear_spring", "viscous_damping", "mass", "stiffness", "damping", "structural", "clamp", "sensor_mass")


def free_beam() -> Rig:
    """A suspended beam that a force drives, its two lowest modes a hundredth of the third, and close together."""
    structure = {
        "kind": "beam", "boundary": "free-free", "length_m": 1.0, "width_m": 0.03, "height_m": 0.008,
        "youngs_modulus_pa": 2.05e11, "density_kg_m3": 7850.0, "elements": 6, "stiffness_damping_s": 6e-5,
        "suspension_stiffness_n_m": 900.0, "suspension_damping_ns_m": 0.6,
        "added_masses": [{"point": 3, "mass_kg": 0.1}], "loss_factor": 0.002,
    }  # fmt: skip
    return chain(structure=structure, exciter={"kind": "force", "point": 2})


RIGS = {
    "beam": lambda: load_rig("beam"),
    "free beam": free_beam,
    "chain": chain,
    "modes": modal,
    "matrices": matrices,
    "table": lambda: chain(exciter={"kind": "shaking_table", "point": 1, "acceleration_per_volt_m_s2": 2.0}),
}


def poles_of(rig: Rig) -> np.ndarray:
    """Eigenvalues with positive imaginary part, rad/s, of the assembled system of first order, mass-normalised."""
    system = build_system(rig)
    m, n = system.mechanical_size, system.size
    stiffness, damping = system.sticking_stiffness(), system.resting_damping()
    factor = np.linalg.cholesky(system.mass[:m, :m])
    state = np.zeros((n + m, n + m))
    state[:m, m : 2 * m] = np.eye(m)
    for place, matrix in ((slice(0, m), stiffness[:m, :m]), (slice(m, 2 * m), damping[:m, :m])):
        state[m : 2 * m, place] = -solve_triangular(factor, solve_triangular(factor, matrix, lower=True).T, lower=True)
    state[m : 2 * m, 2 * m :] = -solve_triangular(factor, stiffness[:m, m:], lower=True)
    inverse = np.linalg.inv(damping[m:, m:])
    for place, matrix in ((slice(0, m), stiffness[m:, :m]), (slice(m, 2 * m), damping[m:, :m])):
        state[2 * m :, place] = -inverse @ solve_triangular(factor, matrix.T, lower=True).T
    state[2 * m :, 2 * m :] = -inverse @ stiffness[m:, m:]
    values = np.linalg.eigvals(state)
    return np.asarray(values[values.imag > 0.0])


def shifted(rig: Rig, test, number: int) -> LowLevelModes:
    """Modes that were measured a little beside those of the rig."""
    modes = LowLevelModes(joined([RowTable().observations(test)]), rig)
    found = modes.modes(rig, test)
    assert found is not None
    assert found.poles.size >= number
    which = np.arange(number)
    modes.tests = [(test, Modes(found.poles[which] * (1.01 + 0.002j), found.shapes[which]), which)]
    return modes


def parametrisations(rig: Rig, test) -> list[Parametrisation]:
    parameters = (*calibration_parameters(rig), *mode_factors(rig, 5.0, 1000.0))
    added = [c for c in candidates(rig, operating_range(rig, [test])) if c.label.startswith(LINEAR)]
    return [Parametrisation(rig, parameters), *(Parametrisation(rig, (), (candidate,)) for candidate in added)]


@pytest.mark.parametrize("name", RIGS)
def test_slopes_of_poles_are_differences_of_eigenvalues(name: str) -> None:
    rig = RIGS[name]()
    test, _ = noise_test(rig, 5.0, 60.0, 12, reference="force" if name == "table" else "voltage")
    number = {"beam": 3, "free beam": 4}.get(name, 2)
    moved = 0
    for parametrisation in parametrisations(rig, test):
        theta = np.where(np.isfinite(parametrisation.lower), 0.05, 0.02) * np.ones(parametrisation.size)
        here = parametrisation.rig(theta)
        modes = shifted(here, test, number)
        poles = modes.modes(here, test).poles[:number]
        slopes = modes.jacobian(parametrisation, theta)[parametrisation.size :]
        for column in range(parametrisation.size):
            logarithms = []
            for steps in (-2.0, -1.0, 1.0, 2.0):
                other = theta.copy()
                other[column] += steps * STEP
                every = poles_of(parametrisation.rig(other))
                near = every[np.argmin(np.abs(every[None, :] - poles[:, None]), axis=1)]
                logarithms.append([np.log(np.abs(near)), np.log(-near.real / np.abs(near))])
            # Of fourth order in the step, which must not drown in the rounding of eigenvalues.
            frequency, damping = np.einsum("i,ijk->jk", np.array([1.0, -8.0, 8.0, -1.0]), logarithms) / (12.0 * STEP)
            label = parametrisation.names[column]
            np.testing.assert_allclose(-1e-3 * slopes[:number, column], frequency, rtol=5e-4, atol=2e-6, err_msg=label)
            np.testing.assert_allclose(-0.1 * slopes[number:, column], damping, rtol=1e-3, atol=5e-6, err_msg=label)
            moved += bool(np.any(np.abs(frequency) > 1e-6))
    assert moved >= 2


@pytest.mark.parametrize("name", with_quick(["beam", "free beam", "chain"], "chain"))
def test_slopes_of_the_residual_are_its_differences(name: str) -> None:
    """With the clock, sensors and everything else that is not a matter of the system."""
    rig = RIGS[name]()
    test, _ = noise_test(rig, 5.0, 60.0, 12)
    modes = shifted(rig, test, 2)
    for candidate in candidates(rig, operating_range(rig, [test])):
        parametrisation = Parametrisation(rig, (), (candidate,))
        theta = np.full(parametrisation.size, 0.05)
        slopes = modes.jacobian(parametrisation, theta)
        for column in range(theta.size):
            up, down = theta.copy(), theta.copy()
            up[column] += STEP
            down[column] -= STEP
            ends = [modes.residual(parametrisation, place) for place in (up, down)]
            if any(np.any(np.abs(end) > 999.0) for end in ends):
                continue
            np.testing.assert_allclose(
                slopes[:, column], (ends[0] - ends[1]) / (2.0 * STEP), rtol=2e-3, atol=2e-3, err_msg=candidate.label
            )


def test_two_modes_of_one_frequency_move_apart_by_what_tells_them_apart() -> None:
    """Two equal oscillators on one mass each: each pole by its own spring, and by a hundredth of its neighbour's."""
    mass, damping, stiffness = np.eye(2), 0.2 * np.eye(2), 100.0 * np.diag([1.0, 1.0 + 1e-5])
    poles = np.array([-0.1 + 1j * np.sqrt(100.0 * (1.0 + 1e-5 * k) - 0.01) for k in range(2)])
    slopes = PoleSlopes(RestingMatrices(mass, damping, stiffness), poles)
    zero = np.zeros((2, 2))
    for k in range(2):
        change = zero.copy()
        change[k, k] = 1.0
        expected = np.zeros(2, dtype=complex)
        expected[k] = 0.5j / poles[k].imag
        np.testing.assert_allclose(slopes.along(RestingMatrices(zero, zero, change)), expected, atol=1e-9)
