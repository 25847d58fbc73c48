"""Errors of a finite-element model's form as effects and as parameters of the model, by the names of its regions."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from diagnose.predicted_tests import chain, level, locked
from scipy.linalg import eigvalsh

from nmt_core.errors import BenchError
from nmt_core.tolerances import MODEL_PRIORS
from nmt_diagnose.effects.calibration import calibration_parameters, mode_factors
from nmt_diagnose.effects.library import candidates
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.effects.rig_edit import with_value
from nmt_diagnose.fit.model_alone import own_and_modes
from nmt_diagnose.prediction.operating_range import operating_range
from nmt_rig.model.packed_matrix import packed, unpacked
from nmt_rig.rig import Rig
from nmt_rig.rig_model import build_structure

# Two masses on a foot: ground - 900 - foot - 400 - 1.0 kg - 250 - 0.5 kg; the foot is held and has no mass to speak of.
SPRING, FOOT, STEM = 250.0, 900.0, 400.0
MASSES = (1.0, 0.5)
LINK = SPRING * np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
TIP = np.diag([0.0, MASSES[1], 0.0])


def rig_of(**regions) -> Rig:
    """The chain's rig with the masses by their matrices; ``regions`` changes keys of a region."""
    stiffness = LINK + STEM * np.array([[1.0, 0.0, -1.0], [0.0, 0.0, 0.0], [-1.0, 0.0, 1.0]])
    mass = np.diag([*MASSES, 1e-6])
    sections = {
        "link": {"nodes": [1, 2], "stiffness_n_m": packed(LINK)},
        "tip": {"nodes": [2], "mass_kg": packed(TIP), "moved_kg": MASSES[1]},
        "foot": {"nodes": [3], "held": True, "translation_rows": [2]},
    }  # fmt: skip
    section = {
        "kind": "matrices", "points_at": [{"point": 1, "row": 0}, {"point": 2, "row": 1}],
        "mass_kg": mass.tolist(), "stiffness_n_m": stiffness.tolist(), "damping_ns_m": (1e-4 * stiffness).tolist(),
        "regions": {name: keys | regions.get(name, {}) for name, keys in sections.items()},
    }  # fmt: skip
    return chain(structure=section, local_elements=[])


def squares(rig: Rig) -> np.ndarray:
    structure = build_structure(rig)
    return eigvalsh(structure.stiffness, structure.mass)[:2]


def exact(link=SPRING, tip=MASSES[1], foot=math.inf) -> np.ndarray:
    """ω² of the two masses by hand; foot and stem are springs in series."""
    ground = STEM if math.isinf(foot) else STEM * foot / (STEM + foot)
    root = np.sqrt([MASSES[0], tip])
    stiffness = np.array([[ground + link, -link], [-link, link]])
    return np.linalg.eigvalsh(stiffness / np.outer(root, root))


def region_candidates(rig: Rig):
    test, _ = locked(rig, [level(1.0, 2.5)], "x1")
    found = candidates(rig, operating_range(rig, [test]))
    return {c.label: c for c in found if c.site.location.detail.split(" ")[0] in ("link", "tip", "foot")}


def test_a_region_is_a_candidate_where_it_has_a_matrix():
    found = region_candidates(rig_of())
    assert set(found) == {"local_stiffness@link", "local_mass@tip", "clamp_compliance@foot lateral"}
    site = found["local_stiffness@link"].site
    assert site.scales == {"change": 0.05}
    assert site.limits == {"change": pytest.approx(math.log(20.0))}
    assert not region_candidates(chain())


CHANGES = {
    "local_stiffness@link": (-0.3, {"link": SPRING * math.exp(-0.3)}, "factor", math.exp(-0.3), "1"),
    "local_mass@tip": (0.2, {"tip": MASSES[1] * math.exp(0.2)}, "m", MASSES[1] * math.expm1(0.2), "kg"),
    "clamp_compliance@foot lateral": (1.0 / FOOT, {"foot": FOOT}, "k", FOOT, "N/m"),
}


@pytest.mark.parametrize(("label", "expected"), CHANGES.items(), ids=CHANGES)
def test_an_effect_of_a_region_is_what_it_says(label, expected):
    value, truth, name, reported, unit = expected
    candidate = region_candidates(rig_of())[label]
    parametrisation = Parametrisation(rig_of(), (), (candidate,))
    (parameter,) = candidate.effect.parameters
    theta = np.array([value / candidate.site.scales[parameter.name]])
    np.testing.assert_allclose(squares(parametrisation.rig(theta)), exact(**truth), rtol=1e-4)
    found, word = parametrisation.reported(theta, 0)[name]
    assert found == pytest.approx(reported)
    assert word == unit
    np.testing.assert_allclose(squares(rig_of()), exact(), rtol=1e-9)


def test_the_mass_of_a_region_has_the_factor_of_all_masses():
    candidate = region_candidates(rig_of())["local_mass@tip"]
    heavier = with_value(rig_of(), ("structure", "mass_factor"), 1.1)
    theta = np.array([0.2 / candidate.site.scales["change"]])
    found, _ = Parametrisation(heavier, (), (candidate,)).reported(theta, 0)["m"]
    assert found == pytest.approx(1.1 * MASSES[1] * math.expm1(0.2))


def test_a_support_that_turns_has_the_units_of_a_rotation():
    rig = rig_of(foot={"translation_rows": [], "rotation_rows": [2]})
    candidate = region_candidates(rig)["clamp_compliance@foot rotation"]
    parametrisation = Parametrisation(rig, (), (candidate,))
    theta = np.array([1.0 / FOOT / candidate.site.scales["compliance"]])
    found, word = parametrisation.reported(theta, 0)["k"]
    assert (found, word) == (pytest.approx(FOOT), "N m/rad")
    np.testing.assert_allclose(squares(parametrisation.rig(theta)), exact(foot=FOOT), rtol=1e-4)


def test_the_scale_of_a_support_lowers_the_mode_by_one_percent():
    """To first order; the mode under the motion is the first."""
    candidate = region_candidates(rig_of())["clamp_compliance@foot lateral"]
    scale = candidate.site.scales["compliance"]
    small = Parametrisation(rig_of(), (), (candidate,)).rig(np.array([0.01]))
    assert 1.0 - math.sqrt(squares(small)[0] / exact()[0]) == pytest.approx(1e-4, rel=0.02)
    assert scale > 0.0


def test_a_stated_uncertainty_makes_a_parameter_of_the_model():
    known = rig_of(link={"stiffness_std": 0.1}, foot={"compliance_m_n": 1.0 / FOOT})
    parameters = {p.name: p for p in calibration_parameters(known)}
    link = parameters["structure.regions.link.stiffness_factor"]
    assert (link.std, link.value) == (0.1, 1.0)
    np.testing.assert_allclose(
        squares(link.apply(known, 1.0)), exact(link=SPRING * math.exp(0.1), foot=FOOT), rtol=1e-4
    )
    foot = parameters["structure.regions.foot.compliance_m_n"]
    assert (foot.std, foot.unit, foot.place) == (MODEL_PRIORS["compliance_m_n"].std, "m/N", "boundary")
    assert "clamp_compliance@foot lateral" not in region_candidates(known)
    assert not any("regions" in p.name for p in calibration_parameters(rig_of()))


def test_each_mode_of_a_finite_element_model_has_its_own_error_of_mesh():
    rig = rig_of()
    factors = mode_factors(rig, 1.0, 10.0)
    frequencies = [p for p in factors if p.path[-1] == "frequency_factors"]
    assert [p.mode for p in frequencies] == [0, 1]
    assert {p.std for p in frequencies} == {MODEL_PRIORS["frequency_factors"].std}
    moved = frequencies[1].apply(rig, 2.0)
    np.testing.assert_allclose(squares(moved), exact() * np.array([1.0, math.exp(4e-3)]), rtol=1e-9)


def test_a_damping_matrix_has_factors_of_modes_instead_of_one():
    rig = rig_of()
    test, _ = locked(rig, [level(1.0, 2.5)], "x1")
    observations = SimpleNamespace(rows=SimpleNamespace(frequency_hz=np.array([1.0, 10.0])), tests=(test,))
    names = [p.name for p in mode_factors(rig, 1.0, 10.0)]
    assert "structure.damping_factors.0" in names
    assert "structure.damping_factor" in [p.name for p in calibration_parameters(rig)]
    free = [p.name for p in own_and_modes(rig, observations)]
    assert set(names) < set(free)
    assert "structure.damping_factor" not in free


def test_a_matrix_travels_as_one_text():
    matrix = np.array([[2.0, -1.0, 0.1], [-1.0, 3.0, 0.0], [0.1, 0.0, 4.0]])
    np.testing.assert_array_equal(unpacked(packed(matrix)), matrix)
    for text in ("", "AAAA", "no matrix", packed(np.array([[math.nan]]))):
        with pytest.raises(ValueError, match="it is not a packed matrix"):
            unpacked(text)


WRONG = {
    "a matrix of another size": ({"link": {"stiffness_n_m": packed(np.eye(2))}}, "has 2 rows, the structure 3"),
    "a row that is not there": ({"foot": {"translation_rows": [3]}}, "holds a row that is not one of 0 to 2"),
    "a point that is held": ({"foot": {"translation_rows": [1]}}, "row 1 is a point's and held by a region"),
    "a factor of nothing": ({"tip": {"stiffness_factor": 2.0}}, "stiffness_factor needs a stiffness of its own"),
    "a compliance of nothing": ({"tip": {"compliance_m_n": 2.0}}, "compliance_m_n needs translations that it holds"),
}


@pytest.mark.parametrize(("regions", "says"), WRONG.values(), ids=WRONG)
def test_regions_that_do_not_fit_the_matrices_are_named(regions, says):
    with pytest.raises(BenchError, match=says):
        rig_of(**regions)
