"""Two exciters, two modes 2 % apart: envelopes of the modes, shakers that resist, latency, noise, wrong shapes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.vocabulary import Quantity
from nmt_pll.force_control.force_controller import ForceController, ForceSetup, integral_rate
from nmt_pll.force_control.force_per_volt import fundamental_gain, start_ratios, table_from_json, table_of
from nmt_pll.force_control.mode_shape_targets import ModeShapeTargets, generalised_pbmif

OMEGA = 2 * np.pi * np.array([100.0, 102.0])
ZETA = np.array([0.003, 0.004])
SHAPES = np.array([[0.45, 0.55], [0.6, -0.4], [0.4, 0.5], [0.52, -0.5]])  # points 1 to 4
PER_VOLT, RESISTANCE = 5.0, 90.0  # N/V and N s/m of a shaker
CUTOFF, BLOCK, STEPS = 94.0, 0.005, 12


def forces_per_volt(frequency_hz):
    """F = a V − z v of both shakers with the structure's mobility at their points."""
    omega = 2 * np.pi * np.atleast_1d(frequency_hz)[:, None]
    mobility = 1j * omega / (OMEGA**2 - omega**2 + 2j * ZETA * OMEGA * omega)
    matrices = np.einsum("ik,fk,jk->fij", SHAPES[:2], mobility, SHAPES[:2])
    return PER_VOLT * np.linalg.inv(np.eye(2) + RESISTANCE * matrices)


def described(mode, shapes=SHAPES):
    frequencies = np.linspace(50.0, 400.0, 3501)
    rows = [
        (frequency, *np.column_stack([matrix.ravel().real, matrix.ravel().imag]).ravel())
        for frequency, matrix in zip(frequencies, forces_per_volt(frequencies), strict=True)
    ]
    return LinearDescription(
        "model", 1, mode, (1, 2, 3, 4), tuple(OMEGA), tuple(ZETA), tuple(map(tuple, shapes)), shapes[0, mode],
        OMEGA[mode], 0.03, 0.04, exciter_points=(1, 2), exciter_force_rows=tuple(map(tuple, rows)),
    )  # fmt: skip


class Envelopes:
    """Complex velocities of the modes at the excitation frequency, driven by shakers; what the filter sees of them."""

    def __init__(self, omega, damping=ZETA, latency=0, noise=0.0, seed=1):
        self.omega = omega
        self.modes = np.zeros(2, complex)
        self.filtered = np.zeros(6, complex)
        # Steps of a block by one matrix for modes, what is filtered and voltages, of which each step is linear.
        share = BLOCK / STEPS
        at_rest = -np.diag(damping * OMEGA + 1j * (omega - OMEGA)) - 0.5 * RESISTANCE * SHAPES[:2].T @ SHAPES[:2]
        moved = np.hstack([np.eye(2) + share * at_rest, np.zeros((2, 6)), 0.5 * share * PER_VOLT * SHAPES[:2].T])
        force = np.hstack([-RESISTANCE * SHAPES[:2], np.zeros((2, 6)), PER_VOLT * np.eye(2)])
        filtered = CUTOFF * share * np.vstack([force, SHAPES @ moved])
        filtered[:, 2:8] += (1.0 - CUTOFF * share) * np.eye(6)
        step = np.vstack([moved, filtered, np.eye(2, 10, 8)])
        self.steps = np.linalg.matrix_power(step, STEPS)[:8]
        self.waiting = [np.array([1.0, 0.0j])] * (latency + 1)
        self.noise, self.random = noise, np.random.default_rng(seed)

    def block(self, ratios):
        self.waiting.append(ratios.copy())
        voltage = self.waiting.pop(0)
        moved = self.steps @ np.concatenate([self.modes, self.filtered, voltage])
        self.modes, self.filtered = moved[:2], moved[2:]
        scatter = self.noise * np.abs(self.filtered) * (self.random.standard_normal((2, 6)).T @ [1.0, 1j])
        return self.filtered[:2] + scatter[:2], self.filtered[2:] + scatter[2:]


class Law:
    """Targets of one mode and the controller of two exciters, as the loop puts them together."""

    def __init__(self, mode, shapes=SHAPES, latency=0, tolerance=0.003, mac_limit=0.8, pbmif_limit=0.9, **setup):
        linear = described(mode, shapes)
        known = table_of(linear.exciter_force_rows, 2)
        how = ForceSetup(1, CUTOFF, BLOCK, latency, (1.5 + latency) * BLOCK, 20, tolerance=tolerance, **setup)
        rate = integral_rate(CUTOFF, how.dead_time)
        self.targets = ModeShapeTargets(linear, False, rate, 20, mac_limit, pbmif_limit)
        ratios, frequency = self.targets.linear_ratios, linear.frequency_hz
        start = start_ratios(known, frequency, self.targets.linear_forces)
        gain = fundamental_gain(known, frequency, rate, ratios)
        self.controller = ForceController(how, known, start, gain)

    @property
    def terms(self):
        return self.controller.terms

    @property
    def obstacle(self):
        return self.controller.obstacle or self.targets.obstacle

    def update(self, force, velocity, frequency_hz):
        target = self.targets.targets(force, velocity, Quantity.VELOCITY, BLOCK)
        self.controller.update(force, velocity[:, 0].tolist(), frequency_hz, 1.0, target)
        self.controller.fit(1.0, frequency_hz)


def settle(control, plant, seconds=12.0):
    for _ in range(round(seconds / BLOCK)):
        force, velocity = plant.block(control.terms[:, 0])
        control.update(force[:, None], velocity[:, None], plant.omega / (2 * np.pi))
    return force, velocity


def mac(shape, mode):
    return abs(SHAPES[:, mode] @ shape) ** 2 / ((np.abs(shape) ** 2).sum() * (SHAPES[:, mode] ** 2).sum())


@pytest.mark.parametrize("mode", [0, 1])
@pytest.mark.parametrize("latency", with_quick([0, 1, 3], 3))
def test_one_mode_is_isolated(mode, latency):
    control, plant = Law(mode, latency=latency), Envelopes(OMEGA[mode], latency=latency)
    control.terms[1, 0] = 0.0  # from the first exciter alone
    force, shape = settle(control, plant)
    assert mac(shape, mode) > 0.999999
    assert control.obstacle == ""
    # Every force is in phase with its velocity, and they are as the mode asks for.
    phases = np.angle(force * shape[:2].conj())
    assert np.abs(phases).max() < math.radians(0.5)
    wanted = np.linalg.solve(SHAPES[:2].T, np.eye(2)[mode])
    np.testing.assert_allclose(force[1] / force[0], wanted[1] / wanted[0], rtol=0.01)


@pytest.mark.parametrize("mode", [0, 1])
def test_one_exciter_alone_does_not_isolate_it(mode):
    plant = Envelopes(OMEGA[mode])
    for _ in range(2000):
        _, shape = plant.block(np.array([1.0, 0.0]))
    assert mac(shape, mode) < 0.95


@pytest.mark.parametrize("mode", [0, 1])
def test_shapes_that_are_wrong_by_5_percent_do_little(mode):
    wrong = SHAPES * (1.0 + 0.05 * np.array([[1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [-1.0, -1.0]]))
    _, shape = settle(Law(mode, wrong), Envelopes(OMEGA[mode]))
    assert mac(shape, mode) > 0.999


def test_initial_ratios_are_those_of_the_linear_test():
    control, plant = Law(0), Envelopes(OMEGA[0])
    for _ in range(2000):
        force, shape = plant.block(control.terms[:, 0])
    assert mac(shape, 0) > 0.9999
    assert np.abs(np.angle(force * shape[:2].conj())).max() < math.radians(1.0)


def test_it_stays_where_the_other_mode_is_damped_less():
    """ξ of the target is beyond the damping of the other mode, which a force ξ M ẋ at once would drive up."""
    damping = np.array([0.02, 0.004])
    control, plant = Law(0), Envelopes(OMEGA[0], damping)
    control.terms[1, 0] *= 0.5
    _, shape = settle(control, plant)
    assert mac(shape, 0) > 0.999999


def test_noise_keeps_neither_from_settling_nor_from_the_mode():
    control, plant = Law(0), Envelopes(OMEGA[0], noise=0.01)
    _, shape = settle(control, plant)
    assert control.obstacle == ""
    assert mac(shape, 0) > 0.999


def test_what_is_not_settled_is_named():
    control, plant = Law(0), Envelopes(OMEGA[0])
    control.terms[1, 0] = 0.0
    assert "for a dwell" in control.obstacle
    settle(control, plant, 0.15)
    assert "force of exciter 2" in control.obstacle
    settle(control, plant)
    strict = Law(0, mac_limit=1.0, pbmif_limit=1.0, tolerance=1.0)
    strict.terms[:] = 1.0
    settle(strict, Envelopes(OMEGA[0]), 0.3)
    assert "MAC" in strict.obstacle


def test_voltages_stay_below_their_limit():
    control, plant = Law(0, voltage_limit=1.2), Envelopes(OMEGA[0])
    control.terms[1, 0] = 3.0
    settle(control, plant, 1.0)
    assert np.abs(control.terms).max() <= 1.2
    assert control.terms[0, 0] == 1.0


def test_generalised_pbmif_is_the_usual_one_for_one_exciter_and_1_where_each_is_in_phase():
    force, velocity = np.array([[1.0 + 0.2j, 0.1j]]), np.array([[2.0, 0.05 - 0.1j]])
    usual = abs((force * velocity.conj()).real.sum()) / np.sqrt(
        (np.abs(force) ** 2).sum() * (np.abs(velocity) ** 2).sum()
    )
    assert generalised_pbmif(force, velocity) == pytest.approx(usual)
    both = np.array([[1.0 + 1.0j], [0.3 - 0.1j]])
    assert generalised_pbmif(both * [[2.0], [7.0]], both) == pytest.approx(1.0)
    assert generalised_pbmif(both * [[2.0], [7.0j]], both) < 0.99


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"exciter_points": (1, 5)}, "no response is measured at point 5"),
        ({"frequencies_rad_s": (600.0,), "damping_ratios": (0.1,), "shapes": ((1.0,),) * 4}, "as many modes"),
    ],
)
def test_a_description_that_does_not_say_enough_is_refused(change, words):
    linear = replace(described(0), **change)
    with pytest.raises(BenchError, match=words):
        ModeShapeTargets(linear, False, 1.0, 20)


def test_rows_of_another_length_are_refused():
    with pytest.raises(BenchError, match="rows of 9 finite numbers"):
        table_from_json("[[1, 2, 3]]", 2)
    table = table_from_json("[[100, 1, 0, 0, 0, 0, 0, 1, 0], [200, 3, 0, 0, 0, 0, 0, 1, 1]]", 2)
    np.testing.assert_allclose(table(np.array([150.0, 200.0])), [[[2, 0], [0, 1 + 0.5j]], [[3, 0], [0, 1 + 1j]]])
    assert np.isnan(table(np.array([99.0, 300.0]))).all()


def test_gains_of_the_fundamental_need_what_is_beside_the_resonance():
    unknown = table_of((), 2)
    ratios = np.array([1.0, 0.5 + 0j])
    with pytest.raises(BenchError, match="need their force per volt near 100 Hz"):
        fundamental_gain(unknown, 100.0, 5.0, ratios)
    np.testing.assert_array_equal(start_ratios(unknown, 100.0, np.array([1.0, 2.0])), [1.0, 0.0])
    # Of two forces per volt that do not depend on frequency: at κ/2π beside the resonance κ/|ν| is one.
    constant = lambda f: np.broadcast_to(np.array([[3.0, 0.5], [0.2, 2.0j]]), (f.size, 2, 2))  # noqa: E731
    gain = fundamental_gain(constant, 100.0, 5.0, ratios)
    np.testing.assert_allclose(gain, [1.0, 1j * abs(2.0j - 0.25)], rtol=1e-9)
    voltages = np.linalg.inv([[3.0, 0.5], [0.2, 2.0j]]) @ [3.2, 2.2]
    np.testing.assert_allclose(start_ratios(constant, 100.0, np.array([3.2, 2.2])), voltages / voltages[0])
