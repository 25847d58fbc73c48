"""What an explanation asks of model and measuring chain: incredible parameters, errors that an effect stands in for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from diagnose.predicted_observations import chain, observations_of_model, real
from moved_threshold import moved_threshold
from scipy.stats import chi2, norm

from nmt_diagnose.diagnose import diagnose_observations
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.effects.library import candidates, effect_named
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.fit.candidate_starts import at_strength
from nmt_diagnose.fit.explanations import FittedExplanation, Score
from nmt_diagnose.fit.fitting import best_chain_errors
from nmt_diagnose.fit.low_level_modes import LowLevelModes
from nmt_diagnose.fit.model_alone import free_parameters, model_alone
from nmt_diagnose.fit.own_chain import OwnChains
from nmt_diagnose.ledger import size
from nmt_diagnose.ledger.diagnosis import Ranked, Verdict
from nmt_diagnose.ledger.rules import OF_EFFECTS, WITHIN, pass_all
from nmt_diagnose.ledger.size import (
    Objection,
    Size,
    compared_with_simpler,
    contradiction,
    implausible_chain,
    implausible_parameters,
    largest_left,
    leaves_something,
    left_over,
    left_within_belief,
    needed,
    prior_misfit,
    relief,
)
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.prediction.operating_range import operating_range
from nmt_diagnose.search.search import Search
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig, ShakingTableSection

MODEL = chain()


def searched(truth: Rig, wandering: float = 0.0) -> tuple[Search, FittedExplanation]:
    """The search on recordings of a rig, and the fit of the model alone."""
    found = observations_of_model(truth, seed=3, drives=(0.1, 0.2, 0.4, 0.8, 1.6))
    phases = np.flatnonzero(found.rows.part == Part.PHASE_ERROR)
    values = found.values.copy()
    values[phases] += wandering * (-1.0) ** np.arange(phases.size)
    observations = replace(found, values=values, chains=tuple(MeasuringChain() for _ in found.tests))
    parameters = free_parameters(MODEL, observations)
    everything = np.ones(len(observations.rows), dtype=bool)
    modes = LowLevelModes(observations, MODEL)
    _, _, null, data = model_alone(MODEL, observations, parameters, everything, modes)
    library = candidates(MODEL, operating_range(MODEL, observations.tests, observations=observations))
    return Search(data, MODEL, parameters, library), null


@cache
def searched_model() -> tuple[Search, FittedExplanation]:
    """Without an error."""
    return searched(MODEL)


NEVER = ("frequency", "damping", "response", "harmonics")


def moved(found: FittedExplanation, to: float) -> FittedExplanation:
    theta = np.zeros_like(found.fit.theta)
    theta[1] = to
    return FittedExplanation((), replace(found.fit, theta=theta))


def test_a_parameter_that_nobody_believes_is_named_with_its_distance() -> None:
    search, null = searched_model()
    count = len(null.fit.parametrisation.calibration)
    edge = float(norm.isf(THRESHOLDS.comparison.incredible_probability / (2.0 * count)))  # Bonferroni
    assert edge > THRESHOLDS.comparison.credible_sigmas - 0.5
    assert implausible_parameters(search.data, moved(null, 0.99 * edge))[0] == ()
    (left,), chance = implausible_parameters(search.data, moved(null, -1.01 * edge))
    assert left.group == null.fit.parametrisation.calibration[1].name
    assert left.size == pytest.approx(1.01 * edge)
    assert 0.0 < chance < THRESHOLDS.comparison.incredible_probability
    assert "standard deviations from its prior value" in left.sentence
    # Where it goes back to what is credible without a change that matters, it says nothing.
    never = replace(search.data, observations=replace(search.data.observations, matters=dict.fromkeys(NEVER, 1e9)))
    assert implausible_parameters(never, moved(null, -1.01 * edge)) == ((), 1.0)


def test_two_effects_are_fitted_together_from_what_each_is_alone() -> None:
    library = searched_model()[0]
    first, second = (
        next(c for c in library.candidates if c.effect.name == name and c.cause.location.points == (point,))
        for name, point in (("quadratic_stiffness", 2), ("cubic_stiffness", 1))
    )
    size = len(library.parameters)
    strengths = np.concatenate([np.zeros(size), [2.0, 2.0]])
    search, null = searched(library.parametrisation((first, second)).rig(strengths))
    wanted = [score for score in search.scores(null) if search.candidates[score.candidate].cause in
              (first.cause, second.cause)]  # fmt: skip
    singles = search.fitted(null, wanted)
    assert {single.effects for single in singles} == {("quadratic_stiffness",), ("cubic_stiffness",)}
    (both,) = search.side_by_side(singles)
    assert set(both.effects) == {"quadratic_stiffness", "cubic_stiffness"}
    assert search.leaves_noise_only(both)
    assert both.fit.log_evidence > singles[0].fit.log_evidence + 10.0


def test_an_effect_stands_in_for_an_error_of_the_chain_that_nobody_believes() -> None:
    search, null = searched_model()
    errors = null.fit.errors
    position = search.data.chain_names.index("delay x1")
    slope = errors.slopes[:, position]

    def taken(sigmas: float, column: np.ndarray) -> tuple[float, float] | None:
        own = np.zeros_like(errors.chain)
        own[position] = sigmas
        return search.instead_of_chain_error(replace(null.fit, errors=replace(errors, chain=own)), column)

    assert taken(20.0, -2.0 * slope) == pytest.approx((-10.0, 400.0))
    assert taken(-20.0, 0.5 * slope) == pytest.approx((-40.0, 400.0))
    assert taken(0.9 * THRESHOLDS.comparison.credible_sigmas, slope) is None
    other = np.random.default_rng(1).standard_normal(slope.size)
    assert taken(20.0, other) is None


def with_gains(gain: float) -> Rig:
    """The model with all accelerometers louder."""
    sensors = [it.model_dump() for it in MODEL.sensors]
    return real(MODEL, sensors=[{**it, "gain": gain} if it["quantity"] == "acceleration" else it for it in sensors])


def test_an_error_of_the_chain_counts_where_rows_leave_what_matters_without_it() -> None:
    """A gain of 2.7 % where 1 % is assumed is told as that; one of 20 % leaves rows without it."""
    wanted = DiagnosisSettings().matters
    search, null = searched(with_gains(1.06))
    assert not leaves_something(search.data, null, wanted)
    (sentence,) = implausible_chain(search.data, null, wanted)
    assert "gain " in sentence
    assert "% of a response" in sentence
    assert implausible_chain(searched_model()[0].data, searched_model()[1], wanted) == ()
    search, null = searched(with_gains(1.2))
    assert largest_left(search.data, null, wanted) < 1.0
    assert left_within_belief(search.data, null, wanted) > 1.0
    assert leaves_something(search.data, null, wanted)


def test_what_brings_a_chain_back_to_what_is_believed_is_no_effect_but_its_own_error_is() -> None:
    """Gains of 6 %, six of their tolerances: no law stands in for them, and they are told as gains."""
    search, null = searched(with_gains(1.06))
    wanted = DiagnosisSettings().matters
    scores = search.scores(null)
    gains = [score for score in scores if "gain" in search.candidates[score.candidate].effect.name]
    louder = search.with_added(null, gains[0])
    assert louder is not None
    assert left_within_belief(search.data, null, wanted) < 1.0
    assert WITHIN(compared_with_simpler(search.data, louder, null, wanted)).passed
    laws = [score for score in scores if search.candidates[score.candidate].effect.name == "cubic_stiffness"]
    stiffer = search.with_added(null, laws[0])
    assert stiffer is not None
    assert needed(search.data, stiffer, [null], wanted).stated == ()


def test_an_effect_is_needed_where_the_fit_without_it_leaves_something_that_matters() -> None:
    spring = {"kind": "cubic_spring", "point": 2, "stiffness_n_m3": 2e8}
    search, null = searched(real(MODEL, local_elements=[spring]))
    cubic = search.singles(null, search.scores(null))[0]
    wanted = DiagnosisSettings().matters
    assert cubic.effects == ("cubic_stiffness",)
    assert needed(search.data, cubic, [null], wanted).stated == (0,)
    never = dict.fromkeys(wanted, 1e9)
    small = needed(search.data, cubic, [null], never)
    assert (small.stated, small.explanation, small.fitted) == ((), null.explanation, cubic.fitted)
    both = FittedExplanation((*cubic.candidates, cubic.candidates[0]), cubic.fit)
    assert needed(search.data, both, [null], wanted).stated == (0, 1)


def test_a_chain_about_an_effect_does_not_stand_in_for_it() -> None:
    """Without the effect the model is judged beside a measuring chain about itself."""
    spring = {"kind": "cubic_spring", "point": 2, "stiffness_n_m3": 2e8}
    search, null = searched(real(MODEL, local_elements=[spring]))
    cubic = search.singles(null, search.scores(null))[0]
    wanted = DiagnosisSettings().matters
    imitated = replace(
        null,
        fit=replace(
            null.fit, prediction=cubic.fit.prediction, errors=cubic.fit.errors, log_evidence=cubic.fit.log_evidence
        ),
    )
    assert needed(search.data, cubic, [imitated], wanted).stated == ()
    own_chain = OwnChains(MODEL, search.data.observations, search.data, cubic.fitted)
    data, alone = own_chain(imitated)
    assert largest_left(data, alone, wanted) > 1.0
    assert own_chain(imitated)[1] is alone
    assert needed(search.data, cubic, [imitated], wanted, own_chain).stated == (0,)
    assert own_chain(cubic)[1] is cubic


def test_evidence_demands_an_effect_although_re_fitted_parameters_leave_less_than_matters() -> None:
    """What the fit without it leaves is small in either case; the evidence of the rows parts them."""
    spring = {"kind": "cubic_spring", "point": 2, "stiffness_n_m3": 2e8}
    search, null = searched(real(MODEL, local_elements=[spring]))
    cubic = search.singles(null, search.scores(null))[0]
    wanted = DiagnosisSettings().matters

    def stated(rise: float, wanted: Mapping[str, float]) -> tuple[int, ...]:
        alike = replace(
            null.fit,
            prediction=cubic.fit.prediction,
            errors=cubic.fit.errors,
            log_evidence=cubic.fit.log_evidence - rise,
        )
        return needed(search.data, cubic, [replace(null, fit=alike)], wanted).stated

    assert (stated(29.0, wanted), stated(31.0, wanted)) == ((), (0,))
    assert stated(1000.0, dict.fromkeys(wanted, 1e9)) == ()  # it is there and does not matter


def test_no_effect_is_needed_where_the_model_alone_lies_within_the_noise() -> None:
    search, null = searched_model()
    wanted = DiagnosisSettings().matters
    assert not leaves_something(search.data, null, wanted)
    for found in [it for score in search.scores(null)[:3] if (it := search.with_added(null, score)) is not None]:
        assert needed(search.data, found, [null], wanted).stated == ()


def test_errors_that_share_a_reason_count_together() -> None:
    search, null = searched(real(MODEL, local_elements=[{"kind": "cubic_spring", "point": 2, "stiffness_n_m3": 2e8}]))
    cubic = search.singles(null, search.scores(null))[0]
    wanted = DiagnosisSettings().matters

    def strained_by(found: FittedExplanation, sigmas: float) -> FittedExplanation:
        chain = np.zeros_like(found.fit.errors.chain)
        chain[:4] = sigmas
        errors = replace(found.fit.errors, chain=chain)
        return FittedExplanation(
            found.candidates, replace(found.fit, theta=np.zeros_like(null.fit.theta), errors=errors)
        )

    count = len(null.fit.parametrisation.calibration) + null.fit.errors.chain.size
    edge = float(np.sqrt(chi2.isf(THRESHOLDS.comparison.incredible_probability / count, 1) / 4.0))
    assert edge < THRESHOLDS.comparison.credible_sigmas  # each of the four alone is believed
    theta = cubic.fit.theta.copy()
    theta[:-1] = 0.0
    errors = replace(cubic.fit.errors, chain=np.zeros_like(cubic.fit.errors.chain))
    free = FittedExplanation(cubic.candidates, replace(cubic.fit, theta=theta, errors=errors))
    assert prior_misfit(search.data, strained_by(null, 2.0)) == pytest.approx(16.0)
    # Of the state in which a record begins nobody believes anything before.
    begins = tuple(f"start {k} of a record" for k in range(4))
    record = replace(search.data, chain_names=(*begins, *search.data.chain_names[4:]))
    assert prior_misfit(record, strained_by(null, 2.0)) == 0.0
    assert pass_all(OF_EFFECTS, relief(search.data, free, strained_by(null, 1.01 * edge), wanted))
    assert not pass_all(OF_EFFECTS, relief(search.data, free, strained_by(null, 0.99 * edge), wanted))
    small = relief(search.data, free, strained_by(null, 1.01 * edge), dict.fromkeys(wanted, 1e9))
    assert not pass_all(OF_EFFECTS, small)


def test_a_rival_is_fitted_again_from_the_parameters_of_the_leader() -> None:
    search, null = searched_model()

    def lost_by(distance: float) -> FittedExplanation:
        """The model alone with a parameter elsewhere, said to be far worse."""
        theta = null.fit.theta.copy()
        theta[1] += distance
        return FittedExplanation((), replace(null.fit, theta=theta, log_evidence=null.fit.log_evidence - 100.0))

    near, far = lost_by(0.99), lost_by(1.01)
    assert search.from_parameters_of(null, near) is near
    found = search.from_parameters_of(null, far)
    assert found.fit.theta[1] == pytest.approx(null.fit.theta[1], abs=0.1)
    assert found.fit.log_evidence == pytest.approx(null.fit.log_evidence, abs=0.1)


def test_what_was_fitted_to_other_data_is_fitted_anew_before_it_competes() -> None:
    """Evidence of fewer rows is larger by itself; an explanation that cannot be fitted any more has none."""
    spring = {"kind": "cubic_spring", "point": 2, "stiffness_n_m3": 2e8}
    search, null = searched(real(MODEL, local_elements=[spring]))
    scores = {search.candidates[it.candidate].cause.label: it for it in search.scores(null)}
    leader, other = (search.with_added(null, scores[f"{law}_stiffness@2"]) for law in ("cubic", "quintic"))
    assert leader is not None
    assert other is not None
    used = np.zeros(len(search.data.used), dtype=bool)
    used[::2] = True
    part = Search(replace(search.data, used=search.data.used & used), search.rig, search.parameters, search.candidates)
    before = part.refit(other)
    assert before.fit.log_evidence > other.fit.log_evidence + 100.0
    near, far = search.other_laws(search.refit(leader), [before])
    found = [it for it in (*near, *far) if it.fit is not before.fit]
    assert all(it.fit.log_evidence == pytest.approx(search.refit(other).fit.log_evidence, abs=1.0) for it in found)
    assert all(it.fit is not before.fit for it in near)

    nowhere = replace(other.fit, theta=np.full_like(other.fit.theta, np.nan))
    assert search.refit(FittedExplanation(other.candidates, nowhere)).fit.log_evidence == -np.inf


def test_no_third_effect_is_looked_for_beside_two_laws() -> None:
    search, null = searched_model()
    cubic, friction = (
        next(c for c in search.candidates if c.effect.name == name)
        for name in ("cubic_stiffness", "second_friction_contact")
    )
    assert search.pairs([FittedExplanation((cubic, friction), null.fit)]) == []
    assert all(len(it.candidates) == 2 for it in search.pairs([FittedExplanation((cubic,), null.fit)]))


def test_no_stinger_is_on_a_shaking_table() -> None:
    table = MODEL.model_copy(update={"exciter": ShakingTableSection(kind="shaking_table", point=2)})
    operating = operating_range(MODEL, searched_model()[0].data.observations.tests)
    stinger = effect_named("stinger_stiffness")
    assert stinger.sites(MODEL, operating)
    assert not stinger.sites(table, operating)


def test_where_a_loop_stood_speaks_against_its_controller_alone() -> None:
    search, null = searched(MODEL, wandering=0.2)
    wanted = DiagnosisSettings().matters
    assert left_over(search.data, null, wanted) == ()
    (left,) = left_over(search.data, null, wanted, loop=True)
    assert left.group.endswith("phase of the loop")
    assert left.size == pytest.approx(0.2, rel=0.3)
    assert not leaves_something(search.data, null, wanted)
    assert leaves_something(search.data, null, wanted, loop=True)


@pytest.mark.parametrize(
    ("size", "words"),
    [
        (Size({"response": 0.07}, False), "hint at a difference of up to 7 % of a response, which lies within"),
        (Size({}, True), "hint at a difference, which lies within"),
        (Size({"response": 0.01}, False), "smaller than what matters: 1 % of a response"),
    ],
)
def test_a_difference_is_told_as_small_only_where_it_is_smaller_than_what_matters(size: Size, words: str) -> None:
    assert words in size.sentence(DiagnosisSettings().matters)


@cache
def weakest_of_each() -> dict[str, tuple[Rig, Rig]]:
    """Rigs with a third of the weakest of each effect that recordings of the model would show, and with that."""
    search, null = searched_model()
    strongest: dict[str, Score] = {}
    for score in search.scores(null):
        name = search.candidates[score.candidate].effect.name
        if name not in strongest or score.reach > strongest[name].reach:
            strongest[name] = score
    rigs = {}
    for name in WEAK:
        score = strongest[name]
        candidate, (strength,) = search.candidates[score.candidate], search.reported_from(null, [score])
        effect = Parametrisation(MODEL, (), (candidate,))
        third, weakest = (at_strength(candidate, score.start, share * strength) for share in (0.3, 1.0))
        rigs[name] = effect.rig(third), effect.rig(weakest)
    return rigs


WEAK = {"force_factor_asymmetric": {"force_factor_asymmetric"}, "amplitude_damping": {"amplitude_damping"}}


@pytest.mark.campaign
@pytest.mark.parametrize("name", WEAK)
def test_the_weakest_that_would_show_is_reported(name: str) -> None:
    """Whether it matters or not; a third of it is not."""
    third, weakest = weakest_of_each()[name]

    def reported(rig: Rig) -> Ranked | None:
        found = observations_of_model(rig, seed=5, drives=(0.1, 0.2, 0.4, 0.8, 1.6))
        found = replace(found, chains=tuple(MeasuringChain() for _ in found.tests))
        diagnosis = diagnose_observations(MODEL, found, DiagnosisSettings(look_ahead=False)).diagnosis
        small = diagnosis.too_small
        if small is not None:
            assert diagnosis.verdict is Verdict.NONE
            assert any(sentence.startswith("The model lacks ") for sentence in diagnosis.sentences)
        return diagnosis.ranking[0] if diagnosis.verdict is Verdict.EFFECT else small

    row = reported(weakest)
    assert row is not None
    assert {row.effect, *row.equivalents} <= WEAK[name]
    assert reported(third) is None


def test_what_lines_leave_is_no_noise_however_much_they_scatter() -> None:
    """A resonance that the model lacks is far beyond the noise that each line brings, and neighbours differ by it."""
    search, null = searched_model()
    observations, wanted = search.data.observations, DiagnosisSettings().matters
    rows, values = observations.rows, observations.values.copy()
    lines = np.flatnonzero((rows.test == 1) & (rows.part == Part.LOG_MAGNITUDE) & (rows.channel == 1))
    values[lines] += 0.3 * (-1.0) ** np.arange(lines.size)
    data = replace(search.data, observations=replace(observations, values=values))
    errors = best_chain_errors(data, null.fit.prediction.values)
    scattered = FittedExplanation((), replace(null.fit, errors=errors))
    assert contradiction(data, scattered, wanted) is not None
    with moved_threshold("verdict.credible_noise_scale", 1e3):
        assert contradiction(data, scattered, wanted) is None


def test_what_a_law_takes_of_unseen_samples_is_no_noise_of_theirs(monkeypatch: pytest.MonkeyPatch) -> None:
    search, null = searched_model()
    observations, wanted = search.data.observations, DiagnosisSettings().matters
    rows = replace(observations.rows, part=np.full(len(observations.rows), Part.SAMPLE))
    values = null.fit.prediction.values + 20.0 * search.data.sigma * (-1.0) ** np.arange(len(rows))
    data = replace(search.data, observations=replace(observations, values=values, rows=rows))
    left = FittedExplanation((), replace(null.fit, errors=best_chain_errors(data, null.fit.prediction.values)))
    monkeypatch.setattr(size, "left_over", lambda *_: (Objection("samples", "response", 0.5),))
    assert contradiction(data, left, wanted) is None
    assert contradiction(data, left, wanted, noise=1.0) is not None


def test_what_a_sensor_adds_and_does_not_matter_is_not_what_the_model_lacks() -> None:
    found = observations_of_model(MODEL, seed=3, drives=(0.1, 0.2, 0.4, 0.8, 1.6))
    late = (found.rows.channel == 2) & (found.rows.part == Part.PHASE)
    values = found.values - np.where(late, 4e-5 * 2.0 * np.pi * found.rows.frequency_hz, 0.0)
    diagnosis = diagnose_observations(
        MODEL, replace(found, values=values), DiagnosisSettings(look_ahead=False)
    ).diagnosis
    assert diagnosis.verdict in (Verdict.NONE, Verdict.CALIBRATION)
    assert diagnosis.too_small is None
    assert not any("The model lacks" in sentence for sentence in diagnosis.sentences)


@pytest.mark.parametrize("share", [0.4, 0.004])
def test_what_two_levels_leave_is_no_noise_however_large_its_learnt_scale(share: float) -> None:
    """Two levels have no neighbours that would show how much they scatter; what does not matter is no objection."""
    found = observations_of_model(MODEL, seed=5, drives=(0.8, 1.6))
    parameters = free_parameters(MODEL, found)
    used = np.ones(len(found.rows), bool)
    observations, _, null, data = model_alone(MODEL, found, parameters, used, LowLevelModes(found, MODEL))
    rows, values = observations.rows, observations.values.copy()
    values[(rows.test == 0) & (rows.part == Part.LOG_MAGNITUDE) & (rows.harmonic == 1) & (rows.level == 1)] += share
    data = replace(data, observations=replace(observations, values=values))
    errors = best_chain_errors(data, null.fit.prediction.values)
    left = FittedExplanation((), replace(null.fit, errors=errors))
    assert (contradiction(data, left, DiagnosisSettings().matters) is not None) == (share > 0.1)
