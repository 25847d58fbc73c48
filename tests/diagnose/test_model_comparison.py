"""The comparison of explanations, on observations that the twin made with noise: the truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.twin_observations import chain, observations_of_twin, real

from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.effects.library import candidates, library
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.inference.explanation_fits import ExplanationFits
from nmt_diagnose.inference.fit import fit
from nmt_diagnose.inference.fitted_model import FittedModel
from nmt_diagnose.inference.level_climb import climbed
from nmt_diagnose.inference.model_comparison import ModelComparison
from nmt_diagnose.inference.other_points import at_other_points
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.observations.observables import Observations
from nmt_diagnose.twin.forward import Forward
from nmt_diagnose.twin.operating_range import operating_range

MODEL = chain()
LEVELS = (0.1, 0.4, 0.8, 1.6)
KNOWN = ("air_drag", "cubic_stiffness", "phase_offset")
CUBIC = {"kind": "cubic_spring", "point": 2, "stiffness_n_m3": 2.0e8}
OFFSET = 0.03


def comparison(observations: Observations, known: tuple[str, ...] = KNOWN) -> ModelComparison:
    withheld = tuple(effect.name for effect in library() if effect.name not in known)
    problem = Problem(observations, Forward(observations.tests, observations.rows))  # type: ignore[arg-type]
    found = candidates(MODEL, operating_range(MODEL, observations.tests), withheld)
    return ModelComparison(ExplanationFits(problem, MODEL, calibration_parameters(MODEL), found))


@pytest.fixture(scope="module")
def hardening() -> Observations:
    return observations_of_twin(real(MODEL, local_elements=[CUBIC]), seed=1, drives=LEVELS)


def test_the_right_effect_at_the_right_place_wins_with_the_right_size(hardening: Observations) -> None:
    own = comparison(hardening)
    null = own.fits.null()
    scan = own.scan(null)
    assert own.fits.candidates[scan[0].direction.candidate].label == "cubic_stiffness@2"
    first, *others = own.singles(null, scan)
    assert first.explanation.label == "cubic_stiffness@2"
    assert 0.6 < first.fit.chi_square / first.fit.used.sum() < 1.2
    value = first.fit.parametrisation.reported(first.fit.theta, 0)["k"][0]
    relative = first.fit.std[-1] / first.fit.theta[-1]
    assert abs(value / CUBIC["stiffness_n_m3"] - 1.0) < 4.0 * relative
    assert first.sigmas == pytest.approx(1.0 / relative)
    assert all(
        first.fit.log_evidence > other.fit.log_evidence + 10.0
        for other in others
        if 2 not in other.explanation.placements[0].points
    )
    # What is right leaves nothing for a second effect.
    assert all(pair.fit.log_evidence < first.fit.log_evidence + 3.0 for pair in own.pairs([first, *others]))


def test_the_effect_is_found_at_its_point_from_another_one(hardening: Observations) -> None:
    own = comparison(hardening)
    null = own.fits.null()
    number = {candidate.label: k for k, candidate in enumerate(own.fits.candidates)}
    (elsewhere,) = own.added_at(null, [(number["cubic_stiffness@1"], 1.0)])
    own.fits = replace(own.fits, settings=replace(own.fits.settings, close=1e6))
    found = {single.explanation.label: single for single in at_other_points(own, null, [elsewhere])}
    assert set(found) == {
        candidate.label for candidate in own.fits.candidates if candidate.effect.name == "cubic_stiffness"
    } - {"cubic_stiffness@1"}
    direct = own.singles(null, own.scan(null))[0]
    assert found["cubic_stiffness@2"].fit.log_evidence == pytest.approx(direct.fit.log_evidence, abs=0.5)
    # An effect that explains little, or acts in the loop, leads nowhere.
    assert at_other_points(own, elsewhere, [elsewhere]) == []
    (loop,) = own.added_at(null, [(number["phase_offset"], 0.01)])
    assert at_other_points(own, null, [loop]) == []


def test_without_its_entry_nothing_fits(hardening: Observations) -> None:
    own = comparison(hardening, ("air_drag", "phase_offset"))
    null = own.fits.null()
    for single in own.singles(null, own.scan(null)):
        assert "cubic_stiffness" not in single.effects
        assert single.fit.chi_square > 1.5 * single.fit.used.sum()


def test_two_effects_are_found_as_a_pair() -> None:
    truth = real(MODEL, local_elements=[CUBIC], pll={"phase_offset_rad": OFFSET})
    own = comparison(observations_of_twin(truth, seed=2, drives=LEVELS))
    null = own.fits.null()
    singles = own.singles(null, own.scan(null))
    best = own.pairs(singles)[0]
    assert {candidate.label for candidate in best.candidates} == {"cubic_stiffness@2", "phase_offset"}
    assert best.fit.log_evidence > singles[0].fit.log_evidence + 20.0
    offset = best.fit.parametrisation.reported(best.fit.theta, [c.label for c in best.candidates].index("phase_offset"))
    assert next(iter(offset.values()))[0] == pytest.approx(OFFSET, abs=0.006)


def test_a_shifted_parameter_leaves_nothing_to_explain() -> None:
    shifted = real(MODEL, exciter={"resistance_ohm": 3.0 * 1.04})
    own = comparison(observations_of_twin(shifted, seed=3, drives=LEVELS))
    null = own.fits.null()
    names = null.fit.parametrisation.names
    k = names.index("exciter.resistance_ohm")
    assert null.fit.theta[k] == pytest.approx(np.log(1.04) / 0.03, abs=4.0 * null.fit.std[k])
    assert null.fit.chi_square / null.fit.used.sum() == pytest.approx(1.0, abs=0.15)
    for single in own.singles(null, own.scan(null)):
        assert single.fit.log_evidence < null.fit.log_evidence + 3.0


def test_climbing_over_the_levels_ends_where_a_fit_of_all_does() -> None:
    shifted = real(MODEL, exciter={"resistance_ohm": 3.0 * 1.06})
    own = comparison(observations_of_twin(shifted, seed=4, drives=LEVELS))
    null = own.fits.null().fit
    found = climbed(own.fits.problem, null.parametrisation, None, null.parametrisation.zero)
    assert found.used.sum() == null.used.sum()
    assert found.log_evidence == pytest.approx(null.log_evidence, abs=0.5)
    np.testing.assert_allclose(found.theta, null.theta, atol=0.2)


def test_a_pair_with_a_member_at_zero_is_no_pair() -> None:
    truth = real(MODEL, local_elements=[{"kind": "cubic_spring", "point": 2, "stiffness_n_m3": 2e8}])
    own = comparison(observations_of_twin(truth, seed=7, drives=LEVELS))
    null = own.fits.null()
    singles = own.singles(null, own.scan(null))
    idle = next(s for s in own.scan(singles[0]) if own.fits.candidates[s.direction.candidate].label == "phase_offset")
    pair = own.fits.add(singles[0], idle)
    assert pair is not None
    assert pair.strength(1) < 1.0
    # A single fit that had stopped early takes over what the pair found.
    early = replace(singles[0], fit=replace(singles[0].fit, log_evidence=singles[0].fit.log_evidence - 5.0))
    better, kept = own.pruned([early, *singles[1:]], [pair])
    assert kept == []
    assert better[0].explanation == singles[0].explanation
    assert better[0].fit.log_evidence == pytest.approx(singles[0].fit.log_evidence, abs=0.5)
    assert len(better) == len(singles)
    assert own.pruned(singles, [pair])[0][0] is singles[0]


def test_a_single_fit_that_stopped_far_away_goes_on_from_a_pair_with_a_weak_member() -> None:
    truth = real(
        MODEL, local_elements=[{"kind": "cubic_spring", "point": 2, "stiffness_n_m3": 2e8}],
        pll={"phase_offset_rad": 0.1 * OFFSET},
    )  # fmt: skip
    own = comparison(observations_of_twin(truth, seed=7, drives=LEVELS))
    null = own.fits.null()
    singles = own.singles(null, own.scan(null))
    weak = next(s for s in own.scan(singles[0]) if own.fits.candidates[s.direction.candidate].label == "phase_offset")
    pair = own.fits.add(singles[0], weak)
    assert pair is not None
    assert 1.0 < pair.strength(1) < 5.0
    # The pair stays, and beside it stands what its strong member explains alone, wherever that fit had stopped.
    far = replace(singles[0], fit=replace(singles[0].fit, log_evidence=singles[0].fit.log_evidence - 1e4))
    better, kept = own.pruned([far, *singles[1:]], [pair])
    assert kept == [pair]
    assert better[0].explanation == singles[0].explanation
    assert better[0].fit.log_evidence == pytest.approx(singles[0].fit.log_evidence, abs=0.5)
    # One that had not stopped stays as it is.
    assert own.pruned(singles, [pair])[0][0] is singles[0]


@pytest.mark.campaign
def test_a_strong_stop_is_fitted_to_its_optimum() -> None:
    """Gap and stiffness bend the model's own parameters first; the truth is reached from the parameters as given."""
    stop = {"kind": "two_sided_gap", "point": 2, "stiffness_n_m": 20000.0, "gap_m": 1.5e-4}
    observations = observations_of_twin(real(MODEL, local_elements=[stop]), seed=8, drives=LEVELS)
    own = comparison(observations, ("two_sided_gap",))
    null = own.fits.null()
    best = own.singles(null, own.scan(null))[0]
    assert best.candidates[0].label == "two_sided_gap@2"
    assert best.fit.converged
    assert best.fit.chi_square < 1.3 * best.fit.used.sum()
    reported = best.fit.parametrisation.reported(best.fit.theta, 0)
    gap_std = reported["gap"][0] * best.fit.std[best.fit.parametrisation.index_of(0)][1]
    assert reported["gap"][0] == pytest.approx(1.5e-4, abs=4.0 * gap_std)


def test_a_fit_beyond_what_was_measured_is_tried_from_other_shapes() -> None:
    """A gap that no amplitude closes changes nothing: a fit that stands there has no slope to come back by."""
    gap, stiffness = 2.0e-4, 4.0e3
    spring = {"kind": "two_sided_gap", "point": 2, "stiffness_n_m": stiffness, "gap_m": gap}
    own = comparison(
        observations_of_twin(real(MODEL, local_elements=[spring]), seed=4, drives=LEVELS), ("two_sided_gap",)
    )
    candidate = next(c for c in own.fits.candidates if c.label == "two_sided_gap@2")
    parametrisation = Parametrisation(MODEL, own.fits.calibration, (candidate,))
    theta = np.zeros(parametrisation.size)
    names = [parameter.name for parameter in candidate.effect.parameters]
    place = parametrisation.index_of(0).start
    theta[place + names.index("k")], theta[place + names.index("gap")] = 0.5, 6.0
    stuck = FittedModel((candidate,), fit(own.fits.problem, parametrisation, theta))
    assert stuck.fit.chi_square / stuck.fit.used.sum() > 4.0
    (found,) = own._with_other_shapes([stuck])
    assert found.fit.chi_square / found.fit.used.sum() < 1.3
    reported = found.fit.parametrisation.reported(found.fit.theta, 0)
    assert reported["gap"][0] == pytest.approx(gap, rel=0.1)
    assert own._with_other_shapes([found]) == [found]


def test_an_explanation_that_two_fits_share_is_replaced_by_a_better_one(
    hardening: Observations, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a pair becomes without the member that does nothing is known already, fitted from two other starts."""
    own = comparison(hardening)
    null = own.fits.null()
    (single, *_) = own.singles(null, own.scan(null))
    worse, worst = (
        replace(single, fit=replace(single.fit, theta=single.fit.theta + less, log_evidence=-less))
        for less in (1e8, 2e8)
    )
    pair = replace(single)
    monkeypatch.setattr(FittedModel, "strength", lambda _self, _member: 0.0)
    monkeypatch.setattr(ExplanationFits, "without", lambda _self, _pair, _member: single)
    kept, pairs = own.pruned([worse, worst, null], [pair])
    assert pairs == []
    assert [each is single for each in kept].count(True) == 1
    assert [each.explanation for each in kept].count(single.explanation) == 1
    assert any(each is null for each in kept)
