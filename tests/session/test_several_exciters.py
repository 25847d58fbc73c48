"""Whole tests with two exciters beside nonlinear modes from a harmonic balance that shares no code with the bench.

The frame has two modes 2 % apart and a joint in both; on the beam a joint of 20 kN/m moves the harmonics of two modes.
"""

from __future__ import annotations

import numpy as np
import pytest
from tiers import with_quick

from nmt_core.vocabulary import PointStatus
from nmt_extract.offline import extract_bag
from nmt_laboratories.epmc_by_receptance import nonlinear_modes
from nmt_rig.model.linear_modes import sticking_modes
from nmt_rig.rig_model import build_resting_elements, build_structure
from nmt_session import Session, plan_test

# The paper's lower noise: of forces in N²/Hz, and what its noise of displacements is in accelerations at 100 Hz.
NOISE = [
    *(f"sensors.{row}.noise_psd=2e-9" for row in (0, 1)),
    *(f"sensors.{row}.noise_psd=7e-5" for row in (2, 3, 4, 5)),
    *(f"sensors.{row}.noise_correlation_time_s=1e-5" for row in range(6)),
]


def measured(rig, levels, overrides=(), out=None, periods=30, **settings):
    plan = plan_test(rig, levels, overrides=list(overrides), window_periods=periods, **settings)
    with Session(plan, out, record=out is not None) as session:
        return plan, session.run()


class Witness:
    """Nonlinear modes of a rig with one friction element, by their amplitude."""

    def __init__(self, rig, mode, highest=15):
        structure = build_structure(rig)
        linear = sticking_modes(structure, build_resting_elements(rig, structure), 4)
        joint = rig.local_elements[0]
        onset = joint.slip_force_n / joint.tangential_stiffness_n_m
        modes = nonlinear_modes(
            structure.mass, structure.damping, structure.stiffness, structure.selector(joint.point),
            joint.tangential_stiffness_n_m, joint.slip_force_n, onset * np.geomspace(0.5, 30.0, 80),
            (linear.frequencies[mode - 1], linear.damping_ratios[mode - 1]), highest,
        )  # fmt: skip
        self.amplitude = np.log([mode.amplitude for mode in modes])
        self.rows = np.array(
            [
                [mode.omega, mode.damping_ratio, *(structure.selector(p) @ mode.shape for p in structure.point_numbers)]
                for mode in modes
            ]
        )
        self.points = structure.point_numbers

    def errors(self, point):
        """Relative errors of ω̃ and δ̃, and the MAC of the shapes."""
        at = max(np.log(point.modal_amplitude), self.amplitude[0])
        omega, damping, *shape = (
            np.interp(at, self.amplitude, row.real) + 1j * np.interp(at, self.amplitude, row.imag)
            for row in self.rows.T
        )
        expected = np.array([shape[self.points.index(number)] for number in point.points])
        found = point.normalised_shape
        mac = abs(np.vdot(expected, found)) ** 2 / (np.vdot(expected, expected) * np.vdot(found, found)).real
        return point.omega_rad_s / omega.real - 1.0, point.damping_ratio / damping.real - 1.0, mac


@pytest.mark.parametrize(("mode", "latency"), with_quick([(1, 0), (2, 0), (1, 1), (1, 3), (2, 3)], (1, 0)))
def test_both_modes_of_the_frame_are_isolated(mode, latency):
    plan, result = measured("frame", [2.0, 4.0, 12.0], [f"test.mode={mode}"], latency_blocks=latency)
    witness = Witness(plan.rig, mode)
    for point in result.points:
        assert point.status is PointStatus.OK
        omega, damping, mac = witness.errors(point)
        assert abs(omega) < 2e-4
        assert abs(damping) < 0.01
        assert mac > 0.999
        assert point.pbmif > 0.999


@pytest.mark.campaign
def test_one_exciter_does_not_isolate_it_and_its_pbmif_does_not_see_it():
    plan, result = measured("frame", [6.0], exciter=2)
    (point,) = result.points
    omega, damping, mac = Witness(plan.rig, 1).errors(point)
    assert mac < 0.99
    assert point.pbmif > 0.99
    assert max(abs(omega) / 2e-4, abs(damping) / 0.01) > 1.0


@pytest.mark.campaign
@pytest.mark.parametrize("mode", [1, 2])
def test_noise_leaves_the_mode_isolated(mode):
    plan, result = measured("frame", [4.0, 12.0], [f"test.mode={mode}", *NOISE], periods=100)
    witness = Witness(plan.rig, mode)
    for point in result.points:
        omega, damping, mac = witness.errors(point)
        assert abs(omega) < 5e-4
        assert abs(damping) < 0.02
        assert mac > 0.999


@pytest.mark.campaign
def test_the_beam_with_the_harmonics_of_two_modes():
    plan, result = measured("beam_two_shakers", [0.5, 3.0])
    witness = Witness(plan.rig, 1, highest=25)
    for point in result.points:
        assert abs(witness.errors(point)[1]) < 0.03
        assert point.harmonics_control == 9


def test_the_recording_gives_the_same_points_bit_for_bit(tmp_path):
    _, result = measured("frame", [2.0], out=tmp_path, periods=20)
    again = extract_bag(tmp_path / "bag")
    assert [mine.identical(theirs) for mine, theirs in zip(result.points, again.points, strict=True)] == [True]
    (point,) = again.points
    assert point.exciter_points == (1, 2)
    assert point.exciter_forces.shape == (2 * (point.harmonics + 1),)
