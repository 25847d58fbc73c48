"""Phase-resonant single-point responses and the extraction from them."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_rig.model.assembly import assemble
from nmt_rig.model.epmc import epmc_backbone
from nmt_rig.model.forced_response import ForcedProblem
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.linear_modes import sticking_modes
from nmt_rig.model.phase_resonance import estimated_mass, extract_mode, linear_phase_resonance, phase_resonant_backbone

BASIS = FourierBasis.up_to(7)
SENSORS = (2, 4, 5, 6)


@pytest.fixture(scope="module")
def modes(beam, joint):
    return sticking_modes(beam, joint, 2)


@pytest.fixture(scope="module")
def shapes(modes):
    return modes.shapes[[modes.points.index(point) for point in SENSORS]]


@pytest.fixture(scope="module")
def tested(beam, joint, shaker, modes, shapes):
    """Drive point -> (problem, backbone, extracted mode)."""
    result = {}
    for point in (2, 4):
        problem = ForcedProblem(assemble(beam, joint, point, shaker), BASIS, float(modes.frequencies[0]))
        backbone = phase_resonant_backbone(problem, np.geomspace(0.05, 12.0, 25))
        result[point] = (problem, backbone, extract_mode(problem, backbone.responses, SENSORS, shapes, beam.mass))
    return result


@pytest.mark.parametrize("point", [2, 4])
def test_fundamental_force_leads_the_displacement_by_a_quarter_period(tested, point: int) -> None:
    problem, backbone, _ = tested[point]
    drive = problem.system.points[point]
    phases = [np.angle(item.force[1] / item.unknowns[1, drive]) for item in backbone.responses]
    np.testing.assert_allclose(phases, 0.5 * np.pi, atol=1e-9)
    assert backbone.single_valued


@pytest.mark.parametrize("point", [2, 4])
def test_low_levels_give_the_linear_mode(tested, beam, joint, point: int) -> None:
    mode = tested[point][2]
    linear = epmc_backbone(beam, joint, np.array([1e-7, 1e-6]))
    assert mode.omega_rad_s[0] == pytest.approx(linear.omega_rad_s[0], rel=2e-4)
    assert mode.damping_ratio[0] == pytest.approx(linear.damping_ratio[0], rel=2e-3)
    assert mode.pbmif[0] == pytest.approx(1.0, abs=1e-9)
    assert mode.gamma_force[0] == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("point", [2, 4])
def test_extraction_meets_the_epmc_away_from_the_onset_of_slip(tested, beam, joint, point: int) -> None:
    mode = tested[point][2]
    exact = epmc_backbone(beam, joint, mode.modal_amplitude)
    settled = (mode.modal_amplitude < 1.4e-4) | (mode.modal_amplitude > 3.2e-4)
    assert settled.sum() > 15
    assert np.abs(mode.omega_rad_s / exact.omega_rad_s - 1.0).max() < 3e-3
    np.testing.assert_allclose(mode.damping_ratio[settled], exact.damping_ratio[settled], rtol=0.02)


def test_truncation_of_the_estimated_mass_vanishes_with_more_modes(tested, beam, joint) -> None:
    problem, backbone, _ = tested[4]
    modes = sticking_modes(beam, joint, 4)
    rows = [modes.points.index(point) for point in SENSORS]
    errors = []
    for count in (1, 2, 3, 4):
        mode = extract_mode(problem, backbone.responses, SENSORS, modes.shapes[rows, :count], beam.mass)
        errors.append(np.abs(mode.modal_amplitude / mode.full_modal_amplitude - 1.0).max())
        # δ̃ goes with 1 / q²: both come from the same power.
        ratio = mode.damping_ratio * mode.modal_amplitude**2
        np.testing.assert_allclose(ratio, mode.exact_damping_ratio * mode.full_modal_amplitude**2, rtol=1e-12)
    assert errors == sorted(errors, reverse=True)
    assert errors[1] < 1.5e-3  # the two modes that a test of this beam uses
    assert errors[3] < 1e-4


def test_first_mode_dominates(tested) -> None:
    mode = tested[4][2]
    np.testing.assert_allclose(np.abs(mode.participation[:, 0]), 1.0, atol=2e-3)
    assert np.abs(mode.participation[:, 1]).max() < 0.05


def test_quality_indicators_fall_when_harmonics_appear(tested) -> None:
    mode = tested[4][2]
    assert mode.pbmif.min() < 0.98
    assert np.all(mode.pbmif <= 1.0 + 1e-12)
    # All power enters with the fundamental up to what the harmonics carry back.
    assert mode.gamma_force.min() < mode.gamma_acceleration.min()


def test_higher_force_harmonics_grow_towards_the_free_end(beam, joint, shaker, modes, shapes) -> None:
    contents = []
    for point in (4, 5, 6):
        problem = ForcedProblem(assemble(beam, joint, point, shaker), BASIS, float(modes.frequencies[0]))
        backbone = phase_resonant_backbone(problem, np.geomspace(0.05, 12.0, 8))
        mode = extract_mode(problem, backbone.responses, SENSORS, shapes, beam.mass)
        contents.append(mode.gamma_force.min())
    assert contents == sorted(contents, reverse=True)


def test_estimated_mass_makes_the_linear_shapes_orthonormal(shapes) -> None:
    np.testing.assert_allclose(shapes.T @ estimated_mass(shapes) @ shapes, np.eye(2), atol=1e-10)


def test_linear_phase_resonance_is_that_of_the_structure_alone(beam, joint, shaker, modes) -> None:
    reference = float(modes.frequencies[0])
    attached = ForcedProblem(assemble(beam, joint, 4, shaker), BASIS, reference)
    bare = ForcedProblem(assemble(beam, joint, 4), BASIS, reference)
    # Force at the drive point over displacement there: the exciter cancels.
    assert linear_phase_resonance(attached) == pytest.approx(linear_phase_resonance(bare), rel=1e-8)


def test_drive_without_phase_resonance_is_refused(beam, shaker) -> None:
    from nmt_rig.model.local_elements.friction import Jenkins

    elements = [Jenkins(beam.direction(2), 5e4, 1.0)]
    reference = float(sticking_modes(beam, elements, 2).frequencies[1])
    problem = ForcedProblem(assemble(beam, elements, 6, shaker), BASIS, reference)
    with pytest.raises(BenchError, match="near a node"):
        phase_resonant_backbone(problem, [1e-4, 1e-3])


def test_levels_beyond_a_fold_are_refused_or_left_out(beam, shaker) -> None:
    from nmt_rig.model.local_elements.friction import Jenkins

    elements = [Jenkins(beam.direction(2), 8e3, 1.0)]
    reference = float(sticking_modes(beam, elements, 2).frequencies[1])
    problem = ForcedProblem(assemble(beam, elements, 6, shaker), BASIS, reference)
    with pytest.raises(BenchError, match="folds back"):
        phase_resonant_backbone(problem, [1e-3, 1.0, 10.0])
    backbone = phase_resonant_backbone(problem, [1e-3, 1.0, 10.0], skip_unreached=True)
    assert [item.drive_amplitude for item in backbone.responses] == pytest.approx([1e-3, 1.0])
    assert not backbone.single_valued


def test_refusals(beam, tested, shapes) -> None:
    problem, backbone, _ = tested[4]
    with pytest.raises(BenchError, match="ascending"):
        phase_resonant_backbone(problem, [2.0, 1.0])
    with pytest.raises(BenchError, match="one row of shapes"):
        extract_mode(problem, backbone.responses, (2, 4), shapes, beam.mass)
