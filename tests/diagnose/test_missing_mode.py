"""A mode that the model lacks is one more degree of freedom, with its place, where responses show its resonance."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_diagnose.diagnose import diagnose_bags
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.effects.effect import Candidate
from nmt_diagnose.effects.library import library
from nmt_diagnose.effects.location import Location
from nmt_diagnose.effects.operating_range import LackingMode, OperatingRange
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.fit.best_fit import StartName
from nmt_diagnose.fit.candidate_starts import starts_of
from nmt_diagnose.fit.fitting import Start
from nmt_diagnose.fit.low_level_modes import Modes, measured_modes, more_modes, moved, side_by_side
from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_diagnose.prediction.operating_range import operating_range, receptances
from nmt_diagnose.search import search as searching
from nmt_laboratories.structures_with_more_modes import ATTACHED, HEAVIER, TRANSMISSION, MoreModes, recorded
from nmt_rig.rig import Rig, load_rig, validate_rig
from nmt_rig.rig_file import RigDocument
from nmt_rig.rig_model import build_structure

# The oscillator of 30 % of the mass that moves at its point, its frequency between the first two modes.
ROW = MoreModes(
    (1.2, 0.8, 1.0), (90e3, 110e3), (60e3, 0.0, 0.0), 2e-5, ATTACHED, 2, 0.1, 45.0, 0.01, 1, 1.0, 0.004
)  # fmt: skip
HANGING = replace(ROW, kind=TRANSMISSION, mass=0.25)
BAND = (15.0, 90.0)


def rig_of(structure: MoreModes, **more: object) -> Rig:
    values = {
        "name": "row",
        "structure": {
            "kind": "chain", "masses_kg": list(structure.masses), "springs_n_m": list(structure.springs),
            "ground_springs_n_m": list(structure.ground),
            "dampers_ns_m": [structure.damping * value for value in structure.springs],
            "ground_dampers_ns_m": [structure.damping * value for value in structure.ground], **more,
        },
        "exciter": {"kind": "force", "point": structure.driven},
        "sensors": [{"quantity": "force", "point": "drive"}, {"quantity": "acceleration", "point": 1}],
        "extraction": {"quantity": "acceleration", "linear_modes": 1},
    }  # fmt: skip
    return validate_rig(RigDocument("test", values, {}))


def poles_of(structure: MoreModes) -> np.ndarray:
    """Of the truth's matrices, rad/s, ascending."""
    m, c, k = structure.matrices()
    n = len(m)
    state = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(m, k), -np.linalg.solve(m, c)]])
    values = np.linalg.eigvals(state)
    values = values[values.imag > 0.0]
    return values[np.argsort(values.imag)]


def lacking(rig: Rig, pole: complex) -> OperatingRange:
    mode = LackingMode(pole, BAND, receptances(rig, pole, ideal_force=True))
    return replace(operating_range(rig, []), lacking=(mode,))


def test_an_oscillator_is_one_more_degree_of_freedom():
    """Responses are those of matrices that were written down for the whole."""
    rig = rig_of(ROW, oscillators=[{"point": 2, "mass_kg": 0.1, "frequency_hz": 45.0, "damping_ratio": 0.01}])
    built, (m, c, k) = build_structure(rig), ROW.matrices()
    for found, expected in ((built.mass, m), (built.damping, c), (built.stiffness, k)):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-9)
    assert built.point_numbers == (1, 2, 3)


def test_the_base_moves_its_mass_too():
    """Of a free body on a moving base the load is that of all masses."""
    rig = load_rig("beam", ["structure.oscillators=[{point: 4, mass_kg: 0.01, frequency_hz: 40}]"])
    loaded, plain = build_structure(rig), build_structure(load_rig("beam"))
    np.testing.assert_allclose(loaded.base_load, np.append(plain.base_load, 0.01))


def test_damping_factors_are_those_of_the_modes_without_it():
    oscillator = {"point": 2, "mass_kg": 0.1, "frequency_hz": 45.0, "damping_ratio": 0.01}
    plain, both = (
        rig_of(ROW, damping_factors=[3.0, 1.0]),
        rig_of(ROW, damping_factors=[3.0, 1.0], oscillators=[oscillator]),
    )
    change = build_structure(both).damping[:3, :3] - build_structure(plain).damping
    expected = np.zeros((3, 3))
    expected[1, 1] = 2.0 * 0.01 * 2.0 * np.pi * 45.0 * 0.1
    np.testing.assert_allclose(change, expected, atol=1e-9)


def test_an_oscillator_at_no_point_is_refused():
    with pytest.raises(BenchError, match=r"structure\.oscillators\.0\.point is 9, but the structure has points 1 to 3"):
        rig_of(ROW, oscillators=[{"point": 9, "mass_kg": 0.1, "frequency_hz": 45.0}])


@pytest.mark.parametrize("truth", [ROW, HANGING], ids=["attached", "transmission"])
def test_a_start_has_the_pole_of_the_responses(truth: MoreModes):
    """Whatever the mass, frequency and damping that a fit begins with give the model the pole that it lacks."""
    rig = rig_of(replace(truth, kind=""))
    pole = complex(poles_of(truth)[1])
    operating = lacking(rig, pole)
    effect = [each for each in library() if each.name == "missing_mode"][truth.kind == TRANSMISSION]
    sites = {site.point: site for site in effect.sites(rig, operating)}
    begun = sites[2].begun
    shares = [start["m"] / (100.0 * operating.typical_mass(2)) for start in begun]
    assert set(np.round(shares, 9)) <= {0.01, 0.03, 0.1, 0.3, 1.0}
    assert len(begun) >= 2
    assert min(start["zeta"] for start in begun) >= 1e-4
    undamped = effect.sites(rig, lacking(rig, 1j * abs(pole)))
    assert min(start["zeta"] for site in undamped for start in site.begun) == 1e-4
    candidate = Candidate(effect, sites[2])
    parametrisation = Parametrisation(rig, (), (candidate,))
    for theta, start in zip(starts_of(candidate), begun, strict=True):
        assert parametrisation.values(theta, 0) == pytest.approx(start)
        changed = build_structure(parametrisation.rig(theta))
        there = pole * (pole * changed.mass + changed.damping) + changed.stiffness
        least = np.linalg.svd(there, compute_uv=False)
        if start["zeta"] > 1e-4:
            assert least[-1] < 1e-9 * least[0]


def test_its_frequency_stays_within_the_band_that_shows_it():
    rig = rig_of(replace(ROW, kind=""))
    effect = next(each for each in library() if each.name == "missing_mode")
    site = next(site for site in effect.sites(rig, lacking(rig, complex(poles_of(ROW)[1]))) if site.point == 2)
    for hertz, kept in ((1.0, BAND[0]), (45.0, 45.0), (500.0, BAND[1])):
        changed = effect.apply(rig, site, {"m": 0.1, "f": hertz, "zeta": 0.01})
        assert changed.structure.oscillators[0].frequency_hz == kept


def test_a_damping_that_noise_turned_is_the_least():
    """Of a pole with less damping than the model's own modes would give it."""
    rig = rig_of(replace(ROW, kind=""))
    effect = next(each for each in library() if each.name == "missing_mode")
    (site,) = (site for site in effect.sites(rig, lacking(rig, 2j * np.pi * 47.0)) if site.point == 2)
    assert {start["zeta"] for start in site.begun} == {1e-4}


LINES_HZ = np.linspace(20.0, 80.0, 300)


def term(hertz: float) -> np.ndarray:
    """Response of one mode at the lines."""
    s, pole = 2j * np.pi * LINES_HZ, 2.0 * np.pi * hertz * (1j - 0.01)
    return np.asarray(2.0 * hertz / (s**2 - 2.0 * pole.real * s + abs(pole) ** 2))


def test_a_small_mass_on_a_spring_is_a_resonance():
    """A third of each response at its frequency: less than a mode of the model has, and there all the same."""
    strong = [term(30.0) + sign * term(70.0) for sign in (1.0, -1.0)]
    middle = np.argmin(np.abs(LINES_HZ - 48.0))
    responses = np.array([two + 0.4j * two[middle] / term(48.0)[middle] * term(48.0) for two in strong])
    assert measured_modes(LINES_HZ, responses, 2).poles.size == 2
    found = measured_modes(LINES_HZ, responses, 2, local=True)
    np.testing.assert_allclose(found.frequencies_hz, [30.0, 48.0, 70.0], rtol=1e-2)


def test_a_mode_of_two_channels_is_local_and_one_of_a_single_channel_is_noise():
    """Of six channels; the others do not know it."""
    plain = [term(30.0) + sign * term(70.0) for sign in (1.0, -1.0, 1.0, -1.0, 1.0, -1.0)]
    for channels, hertz in ((2, [30.0, 48.0, 70.0]), (1, [30.0, 70.0])):
        responses = np.array([two + (0.3 * term(48.0) if k < channels else 0.0) for k, two in enumerate(plain)])
        found = measured_modes(LINES_HZ, responses, 2, local=True)
        np.testing.assert_allclose(found.frequencies_hz, hertz, rtol=1e-2)
        assert measured_modes(LINES_HZ, responses, 2).poles.size == 2


def test_the_nearest_places_are_fitted(monkeypatch: pytest.MonkeyPatch):
    """Of ten places the eight whose start leaves the least, each from the model as given."""
    rig = rig_of(replace(ROW, kind=""))
    effect = next(each for each in library() if each.name == "missing_mode")
    (site,) = (site for site in effect.sites(rig, lacking(rig, complex(poles_of(ROW)[1]))) if site.point == 2)
    places = [Candidate(effect, replace(site, location=Location.at("structure", point))) for point in range(1, 11)]
    fitted = []

    def predicted(_: object, parametrisation: Parametrisation, *__: object) -> SimpleNamespace:
        return SimpleNamespace(values=parametrisation.candidates[0].site.location.detail)

    def best(self: object, parametrisation: Parametrisation, starts: list[Start], **_: object) -> None:
        (start,) = starts
        assert start.name == StartName.GIVEN
        fitted.append(parametrisation.candidates[0].site.location.detail)

    monkeypatch.setattr(searching, "predicted", predicted)
    monkeypatch.setattr(searching, "best_chain_errors", lambda _, label: SimpleNamespace(cost=abs(int(label) - 4.2)))
    monkeypatch.setattr(searching.Search, "best", best)
    search: Any = searching.Search(SimpleNamespace(), rig, (), places)  # type: ignore[arg-type]
    assert search.missing_modes(None) == []
    assert fitted == ["4", "5", "3", "6", "2", "7", "1", "8"]


def more(found: list[float], model: list[float], which: list[int], narrow: int = -1) -> bool:
    """Whether there are more modes; of the model's ``narrow`` one the lines are wider apart than its resonance."""

    def at(hertz: list[float]) -> Modes:
        dampings = np.where(np.arange(len(hertz)) == narrow, 1e-4, 0.01)
        return Modes(2.0 * np.pi * np.array(hertz) * (1j - dampings), np.eye(len(hertz), dtype=np.complex128))

    return more_modes(at(found), at(model), np.arange(*BAND, 0.5), np.array(which))


def test_what_moves_modes_adds_none():
    assert more([20.0, 45.0, 60.0], [22.0, 61.0], [0, -1, 1])
    assert not more([20.0, 45.0, 60.0], [22.0, 50.0, 70.0], [0, 1, 2])
    assert not more([20.0, 60.0, 89.0], [22.0, 62.0, 95.0], [0, 1, -1])


def test_a_mode_far_away_that_is_alike_has_moved():
    """The first has moved by a third of an octave and more; the second is like none that is left."""
    poles = 2.0j * np.pi * np.array([40.0, 200.0])
    found = Modes(poles, np.array([[1.0, 2.0], [1.0, 0.0]], dtype=complex))
    model = Modes(2.0j * np.pi * np.array([20.0, 100.0]), np.array([[1.0, 2.1], [0.0, 1.0]], dtype=complex))
    np.testing.assert_array_equal(moved(found, model, found.likeness(model), np.array([-1, -1])), [0, -1])
    np.testing.assert_array_equal(moved(found, model, found.likeness(model), np.array([0, -1])), [0, -1])


def test_a_mode_that_lines_cannot_show_does_not_count():
    """Two resonances beside a model of two, one of which is too narrow; unless one of the resonances is that."""
    assert more([45.0, 60.0], [22.0, 61.0], [-1, 1], narrow=0)
    assert not more([45.0, 60.0], [22.0, 61.0], [-1, 1])
    assert not more([22.0, 60.0], [22.0, 61.0], [0, 1], narrow=0)


def test_modes_of_several_tests_stand_side_by_side():
    """Each test has its channels; the second has lost a pole to rounding, next to critical damping."""
    poles = np.array([-0.1 + 10.0j, -0.2 + 20.0j, -400.0 + 1e-3j])
    shapes = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]], dtype=complex)
    several = side_by_side([Modes(poles, shapes), Modes(poles[:2] * (1.0 + 1e-9), 10.0 * shapes[:2, :1])])
    np.testing.assert_array_equal(several.poles, poles)
    np.testing.assert_array_equal(several.shapes[:2], [[1.0, 2.0, 10.0], [3.0, 4.0, 30.0]])
    np.testing.assert_array_equal(several.shapes[2, :2], [5.0, 6.0])
    none = Modes(poles[:0], shapes[:0])
    assert side_by_side([none, none]).shapes.shape == (0, 4)


@pytest.mark.court(said="missing mode")
@pytest.mark.parametrize("truth", with_quick([ROW, HANGING], ROW), ids=["attached", "transmission"])
def test_a_mode_that_the_model_lacks_has_its_place_frequency_and_mass(tmp_path: Path, truth: MoreModes):
    rig, bag = recorded(truth, tmp_path, np.random.default_rng(3))
    found = diagnose_bags(rig, [bag], settings=DiagnosisSettings(jobs=1, look_ahead=False)).diagnosis
    assert found.verdict is Verdict.EFFECT
    first = found.ranking[0]
    assert (first.effect, first.detail) == ("missing_mode", "2")
    assert first.parameters["f"].value == pytest.approx(truth.frequency_hz, rel=0.02)
    assert first.parameters["m"].value == pytest.approx(truth.mass, rel=0.05)
    assert first.parameters["zeta"].value == pytest.approx(truth.ratio, rel=0.3)


@pytest.mark.campaign
@pytest.mark.court(not_said="missing mode")
@pytest.mark.parametrize("truth", [replace(ROW, kind=HEAVIER), replace(ROW, kind="", off=1.15)])
def test_resonances_that_moved_are_no_mode_that_the_model_lacks(tmp_path: Path, truth: MoreModes):
    """By many of their widths: by a mass fixed to a point, and by springs that are all softer than the model's."""
    rig, bag = recorded(truth, tmp_path, np.random.default_rng(4))
    found = diagnose_bags(rig, [bag], settings=DiagnosisSettings(jobs=1, look_ahead=False)).diagnosis
    assert "missing_mode" not in {each.effect for each in found.ranking}
    if truth.kind == HEAVIER:
        assert (found.ranking[0].effect, found.ranking[0].detail) == ("added_mass", "2")
        assert found.ranking[0].parameters["m"].value == pytest.approx(truth.mass, rel=0.1)


def test_noise_makes_no_mode_and_one_quiet_channel_shows_one() -> None:
    """Displacements are noise from 60 Hz on; an accelerometer shows a small mode at 150 Hz that they cannot show."""
    lines = np.linspace(8.0, 300.0, 300)
    rng = np.random.default_rng(8)
    modes = ((20.0, 1.0), (50.0, 1.0), (150.0, 0.3))
    motion = sum(size / (f**2 - lines**2 + 0.02j * f * lines) for f, size in modes)
    responses = np.vstack([*(motion for _ in range(4)), -(lines**2) * motion])
    noise = np.vstack(
        [*(np.clip(np.abs(motion[40]) / np.abs(motion), 1e-3, 0.2) for _ in range(4)), np.full(300, 1e-3)]
    )
    scatter = rng.standard_normal(responses.shape) + 1j * rng.standard_normal(responses.shape)
    found = measured_modes(lines, responses * (1.0 + noise * scatter), 2, local=True, noise=noise)
    np.testing.assert_allclose(found.frequencies_hz, [20.0, 50.0, 150.0], rtol=2e-3)
