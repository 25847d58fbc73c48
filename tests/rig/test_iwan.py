"""The discretised Iwan joint against the closed forms of its distribution."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_rig.model.chain import lumped_chain
from nmt_rig.model.local_elements.friction import Jenkins
from nmt_rig.model.local_elements.iwan import IwanSection
from nmt_rig.model.local_elements.springs import LinearSpring
from nmt_rig.rig import load_rig
from nmt_rig.rig_model import build_elements, build_structure
from nmt_rig.slipping_reference import softened


def iwan(stiffness, slip_force, exponent=0.0, ratio=0.0, onset=0.0, sliders=12, partition="stiffness"):
    return IwanSection.model_construct(
        tangential_stiffness_n_m=stiffness,
        slip_force_n=slip_force,
        exponent=exponent,
        stiffness_ratio=ratio,
        onset_ratio=onset,
        sliders=sliders,
        partition=partition,
    )


def monotonic_force(joint: IwanSection, displacement: float) -> float:
    """Force on the virgin curve: each slider gives the smaller of spring and slip force."""
    stiffness, limits = joint.slider_table()
    return float(np.minimum(stiffness * displacement, stiffness * limits).sum())


def cycle_work(joint: IwanSection, amplitude: float) -> float:
    stiffness, limits = joint.slider_table()
    return float((4.0 * stiffness * limits * np.maximum(amplitude - limits, 0.0)).sum())


@pytest.mark.parametrize(("exponent", "ratio", "onset"), [(-0.5, 0.0, 0.0), (0.4, 1.5, 0.0), (-0.9, 0.3, 0.05)])
def test_stiffness_and_slip_force_are_met_with_any_number_of_sliders(exponent, ratio, onset):
    for sliders in (1, 7, 40):
        joint = iwan(3e6, 120.0, exponent, ratio, onset, sliders)
        stiffness, limits = joint.slider_table()
        assert stiffness.sum() == pytest.approx(3e6, rel=1e-12)
        assert (stiffness * limits).sum() == pytest.approx(120.0, rel=1e-12)
        assert len(stiffness) == sliders + (ratio > 0.0)
        assert np.all(np.diff(limits) > 0.0)
        assert limits[0] > onset * joint.largest_slip_displacement
        assert limits[-1] <= joint.largest_slip_displacement


@pytest.mark.parametrize(("exponent", "ratio", "onset"), [(-0.5, 0.0, 0.0), (0.4, 1.5, 0.0), (-0.9, 0.3, 0.05)])
def test_parts_of_equal_ratio_meet_stiffness_and_slip_force_as_well(exponent, ratio, onset):
    for sliders in (1, 2, 40):
        joint = iwan(3e6, 120.0, exponent, ratio, onset, sliders, partition="ratio")
        stiffness, limits = joint.slider_table()
        assert stiffness.sum() == pytest.approx(3e6, rel=1e-12)
        assert (stiffness * limits).sum() == pytest.approx(120.0, rel=1e-12)
        assert len(stiffness) == sliders + (ratio > 0.0)
        assert np.all(np.diff(limits) > 0.0)
        assert limits[0] > onset * joint.largest_slip_displacement


def test_parts_of_equal_ratio_are_smooth_at_all_amplitudes():
    """Work of a cycle against ∫₀ᵃ 4 φ (a − φ) ρ dφ = 4 R a^(χ+3) / ((χ+2)(χ+3)), over two decades."""
    chi = -0.5
    largest, worst = 1.0, {}
    for partition in ("ratio", "stiffness"):
        joint = iwan(1.0, (chi + 1.0) / (chi + 2.0), chi, sliders=120, partition=partition)
        assert joint.largest_slip_displacement == pytest.approx(largest)
        amplitudes = np.geomspace(0.01, 1.0, 400)
        exact = 4.0 * (chi + 1.0) * amplitudes ** (chi + 3.0) / ((chi + 2.0) * (chi + 3.0))
        found = np.array([cycle_work(joint, a) for a in amplitudes])
        worst[partition] = np.max(np.abs(found / exact - 1.0))
    assert worst["ratio"] < 2.5e-3
    assert worst["stiffness"] > 6e-3


def test_largest_slip_displacement_is_segalmans():
    joint = iwan(2e6, 50.0, -0.3, 0.8)
    assert joint.largest_slip_displacement == pytest.approx(50.0 * 1.8 / (2e6 * (0.8 + 0.7 / 1.7)), rel=1e-12)


def test_virgin_curve_is_that_of_the_distribution():
    """F(u) = ∫₀ᵘ φ ρ dφ + u ∫ᵤ ρ dφ; for a power law from zero it is K_T u - R u^(χ+2) / ((χ+1)(χ+2))."""
    chi = -0.4
    joint = iwan(1e6, 10.0, chi, sliders=400)
    largest = joint.largest_slip_displacement
    factor = 1e6 * (chi + 1.0) / largest ** (chi + 1.0)
    for part in (0.05, 0.3, 0.9):
        u = part * largest
        expected = 1e6 * u - factor * u ** (chi + 2.0) / ((chi + 1.0) * (chi + 2.0))
        assert monotonic_force(joint, u) == pytest.approx(expected, rel=2e-5)


def test_work_of_a_cycle_grows_with_the_power_three_plus_chi():
    for chi in (-0.6, 0.0, 0.5):
        joint = iwan(1e6, 10.0, chi, sliders=2000)
        low, high = 0.2 * joint.largest_slip_displacement, 0.4 * joint.largest_slip_displacement
        slope = np.log2(cycle_work(joint, high) / cycle_work(joint, low))
        assert slope == pytest.approx(3.0 + chi, abs=0.01)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"tangential_stiffness_n_m": 0.0}, "tangential_stiffness"),
        ({"slip_force_n": -1.0}, "slip_force"),
        ({"exponent": -1.0}, "exponent"),
        ({"onset_ratio": 1.0}, "onset_ratio"),
        ({"stiffness_ratio": -0.1}, "stiffness_ratio"),
        ({"sliders": 0}, "sliders"),
        ({"remaining_stiffness_n_m": np.nan}, "remaining_stiffness"),
    ],
)
def test_senseless_parameters_are_refused(changes, says):
    with pytest.raises(ValueError, match=says):
        IwanSection.model_construct(
            **{"kind": "iwan", "point": 1, "tangential_stiffness_n_m": 1.0, "slip_force_n": 1.0, **changes}
        ).elements(lumped_chain([1.0], []))


def test_a_rig_gets_jenkins_elements_and_the_remaining_spring():
    rig = load_rig("joint_resonator")
    elements = build_elements(rig, build_structure(rig))
    assert [type(element) for element in elements].count(Jenkins) == 18
    assert [type(element) for element in elements].count(LinearSpring) == 1
    assert sum(element.linear_stiffness for element in elements) == pytest.approx(20.7594e6, rel=1e-12)
    for element in elements:
        assert element.direction == pytest.approx([0.0, -1.0, 1.0])
    assert softened(rig, 0.5).local_elements[0].tangential_stiffness_n_m == 2.75e6


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("local_elements.joint.exponent=-1.2", "must be greater than -1"),
        ("local_elements.joint.sliders=0", "must be at least 1"),
        ("local_elements.joint.onset_ratio=1.0", "onset_ratio"),
        ("extraction.hysteresis.free_point=2", "three different points"),
        ("extraction.hysteresis.free_point=4", "points 1 to 3"),
        ("extraction.hysteresis.free_mass_kg=0", "must be positive"),
    ],
)
def test_wrong_joints_and_layouts_are_refused_by_the_rig_file(override, says):
    with pytest.raises(BenchError, match=says):
        load_rig("joint_resonator", [override])


def test_a_mass_without_sensor_has_no_loop(tmp_path):
    text = """
name: chain
structure: {kind: chain, masses_kg: [1.0, 1.0, 1.0], springs_n_m: [1.0e6, 1.0e6], ground_springs_n_m: [10.0, 0.0, 0.0]}
exciter: {kind: force, point: 1}
sensors: [{quantity: force, point: drive}, {quantity: acceleration, point: 1}, {quantity: acceleration, point: 2}]
extraction:
  quantity: acceleration
  hysteresis: {excited_point: 1, middle_point: 2, free_point: 3, excited_mass_kg: 1.0, free_mass_kg: 1.0}
"""
    path = tmp_path / "chain.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BenchError, match="free_point is 3, where there is no acceleration sensor"):
        load_rig(path)
