"""The whole diagnosis: from bags and a rig file to a verdict."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import BoolArray, FloatArray
from nmt_diagnose.ahead.next_tests import next_levels, next_tests, other_sensors
from nmt_diagnose.chain.chain_columns import SharedDelay, shared_delays
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.effects.calibration import CalibrationParameter, calibration_parameters, mode_dampings
from nmt_diagnose.effects.library import candidates as library_candidates
from nmt_diagnose.effects.library import library
from nmt_diagnose.effects.location import Explanation
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.fit.best_fit import StartName, best_fit, from_believed, likelihood
from nmt_diagnose.fit.candidate_starts import at_strength
from nmt_diagnose.fit.explanations import FittedExplanation, LeftOut, Score, best_of, leaves_noise_only
from nmt_diagnose.fit.fitting import (
    REFIT,
    ChainErrors,
    Data,
    FitError,
    FitResult,
    Metric,
    Start,
    best_chain_errors,
    data_about,
    fit,
)
from nmt_diagnose.fit.low_level_modes import LowLevelModes
from nmt_diagnose.law.law_elements import with_law
from nmt_diagnose.law.reading import LawReading
from nmt_diagnose.ledger.comparison import (
    Comparison,
    Hypotheses,
    by_plain_effect,
    misfit,
    sources,
)
from nmt_diagnose.ledger.credible_answers import credible_answers
from nmt_diagnose.ledger.diagnosis import DetectableEffect, Diagnosis, Gap, NextTest, Value, Verdict
from nmt_diagnose.ledger.gap import ClosedShare, closed, no_worse_than_silence, rms
from nmt_diagnose.ledger.held_out import Split, named_tests, splits
from nmt_diagnose.ledger.ledger import Decided, ledger_of
from nmt_diagnose.ledger.plain_look import Factor, factors, share_left
from nmt_diagnose.ledger.row import Facts
from nmt_diagnose.ledger.rules import GAP, verdict_of
from nmt_diagnose.ledger.size import (
    change_size,
    large_lines,
    leaves_something,
    measured_size,
    needed,
    over,
    relief_that_counts,
    stands_out,
)
from nmt_diagnose.ledger.warnings import warned, without_observables
from nmt_diagnose.observations.observables import Observations, Part
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.observations.read_observations import read_observations
from nmt_diagnose.prediction.forward import Forward, Prediction, traced
from nmt_diagnose.prediction.operating_range import operating_range
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.say.law_sentences import law_sentences
from nmt_diagnose.say.remainder import remainder
from nmt_diagnose.say.residual_map import per_observable, residual_map
from nmt_diagnose.say.residual_tests import residual_tests
from nmt_diagnose.say.result_rows import (
    calibration_rows,
    candidate_row,
    inputs,
    parameters,
    place_rows,
    ranked_rows,
)
from nmt_diagnose.say.sentences import likeness, sentences
from nmt_diagnose.search.law_starts import law_of, with_laws
from nmt_diagnose.search.memory import Memory
from nmt_diagnose.search.progress import Progress
from nmt_diagnose.search.search import Search
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig, load_rig

# Times that the measuring chain is taken anew about the model's fit: it is linear, and the second round starts near.
_CHAIN_ROUNDS = 2
# Order of the solution that shows what the harmonic balance leaves out: three times as many leave 2 % of it.
_FINE_HARMONICS = 27
# Most lines of a random test: neighbouring ones show the same.
_RANDOM_LINES = 160


@dataclass(frozen=True)
class DiagnosisOutcome:
    """A diagnosis and what a report draws.

    Attributes:
        diagnosis: the result.
        observations: the real side, its uncertainties those that were learnt.
        initial_model: the model as given.
        model: the model with its parameters re-fitted and the accepted effect added; the given one where there is no
            gap.
        as_given, refitted, final: observables of the initial model, of the re-fitted one and of ``model``, (m,).
        detectable: computes ``Diagnosis.visible``, where that was put off.
    """

    diagnosis: Diagnosis
    observations: Observations
    initial_model: Rig
    model: Rig
    as_given: FloatArray
    refitted: FloatArray
    final: FloatArray
    detectable: Callable[[], tuple[DetectableEffect, ...]] | None = None

    def completed(self) -> DiagnosisOutcome:
        """The outcome with what was put off."""
        if self.detectable is None:
            return self
        return replace(self, diagnosis=replace(self.diagnosis, visible=self.detectable()), detectable=None)


MAINS_HUM = "mains_hum"
FAR_BEHIND = "far behind the best"
_NO_BETTER = 0.9
"""Standard uncertainty over that of a prior from which rows tell nothing of a parameter."""


@dataclass(frozen=True)
class Standing:
    """How far the search has come.

    Attributes:
        search: fits explanations, under the noise and the errors of the chain about the best of them.
        null: the model alone.
        named: explanations that compete, the best first.
        left_out: explanations that were fitted and do not compete.
        elsewhere: of these, those with effects of a competitor, with how much more each leaves.
    """

    search: Search
    null: FittedExplanation
    named: tuple[FittedExplanation, ...]
    left_out: tuple[LeftOut, ...] = ()
    elsewhere: tuple[tuple[FittedExplanation, float], ...] = ()


@dataclass(frozen=True)
class Findings:
    """What the comparison of explanations rests on.

    Attributes:
        data: rows, noise and chain, about the best explanation.
        search: fits explanations to them.
        as_given: prediction of the model as given.
        null: the model alone.
        named: explanations by one and two effects, the best first.
        hypotheses: the competition.
        comparison: probabilities.
        sources: what something unnamed at each place would explain beside the model alone.
        inadequate: what the model has to be corrected for before effects can be told.
        factors: channels that were recorded at another scale or sign.
        doubtful: modes that the model may lack, of which nothing is left that matters.
        left_out: explanations that were fitted and do not compete.
        law: of the local force that the model lacks, read from held levels; None where that was not looked for.
        scanned: scores of all candidates on top of the model alone; empty where nothing was looked for.
        scores: computes those of the candidates on top of the best explanation, of the model alone where there is no
            gap.
    """

    data: Data
    search: Search
    as_given: Prediction
    null: FittedExplanation
    named: tuple[FittedExplanation, ...]
    hypotheses: Hypotheses
    comparison: Comparison
    sources: dict[str, float]
    inadequate: tuple[str, ...] = ()
    factors: tuple[Factor, ...] = ()
    doubtful: tuple[str, ...] = ()
    left_out: tuple[LeftOut, ...] = ()
    law: LawReading | None = None
    scanned: tuple[Score, ...] = ()
    scores: Callable[[], tuple[Score, ...]] = tuple

    @property
    def unexplained(self) -> tuple[float, str]:
        """Largest share of its signal that a channel leaves beyond noise by the model alone, and whose it is."""
        return share_left(self.data.observations, self.null.fit.errors.values, self.data.used)


def diagnose_bags(
    model: Path | str | Rig,
    bags: Sequence[Path | str],
    floor_bags: Sequence[Path | str] = (),
    settings: DiagnosisSettings | None = None,
    progress: Progress | None = None,
    memory: Memory | None = None,
) -> DiagnosisOutcome:
    """Diagnose the gap between a rig file and bags of the real side.

    Args:
        model: rig file, its name, or a loaded rig.
        bags: runs or imports of the real side.
        floor_bags: repeats of tests among ``bags``.
        settings: None = defaults.
        progress: called with a sentence as the work goes on.
        memory: of earlier diagnoses of the same model and rig; takes what this one leaves.

    Raises:
        BenchError: bags or rig cannot be used, with a sentence.
    """
    rig = model if isinstance(model, Rig) else load_rig(str(model), vibrating=False)
    settings = settings or DiagnosisSettings()
    observations = observed(rig, bags, floor_bags, settings, progress, memory)
    return diagnose_observations(rig, observations, settings, progress, memory)


def observed(
    rig: Rig,
    bags: Sequence[Path | str],
    floor_bags: Sequence[Path | str] = (),
    settings: DiagnosisSettings | None = None,
    progress: Progress | None = None,
    memory: Memory | None = None,
) -> Observations:
    """Rows of the bags with the noise that they show; arguments as for :func:`diagnose_bags`."""
    settings = settings or DiagnosisSettings()
    reading = ObservationSettings(calibration=settings.calibration, lines=_RANDOM_LINES)
    readings = None if memory is None else memory.readings
    found = read_observations(bags, rig, floor_bags, reading, progress, settings.allow_own_model, readings)
    return replace(found, matters=dict(settings.matters))


def find(
    rig: Rig,
    observations: Observations,
    settings: DiagnosisSettings,
    tell: Progress = lambda _: None,
    compared: BoolArray | None = None,
    memory: Memory | None = None,
) -> Findings:
    """Fit and compare all explanations.

    Args:
        rig: the model.
        observations: the real side.
        settings: of the diagnosis.
        tell: called with a sentence as the work goes on.
        compared: rows that take part, (m,); None = all.
        memory: of earlier diagnoses; takes what this one leaves.

    Raises:
        BenchError: the model has no solution for any of the observations.
    """
    parameters = free_parameters(rig, observations)
    tell("re-fitting the model's own parameters")
    fitted = ~named_tests(observations, settings.hold_out)
    if compared is not None:
        fitted &= compared
    modes = LowLevelModes(observations, rig)
    observations, as_given, null, data = model_alone(rig, observations, parameters, fitted, modes)
    operating = operating_range(rig, observations.tests, observations=observations)
    beyond_effects = modes.disordered or modes.lacking(
        data, null.fit, THRESHOLDS.modes.certain_sigmas, THRESHOLDS.modes.certain_channel_share
    )
    scales = factors(observations, as_given.values, null.fit.prediction.values, fitted)
    candidates = () if beyond_effects or scales else library_candidates(rig, operating, settings.withheld)
    search = Search(data, rig, parameters, candidates, tell)
    scores = cache(partial(search.scores, null))
    law: LawReading | None = None
    standing = Standing(search, null, ())

    def relieved() -> bool:
        return max((score.relief for score in scores()), default=0.0) > relief_that_counts(search.data, null)

    gap = leaves_something(data, null, settings.matters, loop=True) or relieved()
    settled = False
    if gap:
        begun, passed = list[FittedExplanation](), frozenset[Explanation]()
        if memory is not None:
            begun = memory.begun(search, null, lambda it: _noise_only(rig, observations, search.data, it))
        if begun and memory is not None:
            passed = memory.far | {it.fitted for it in begun}
        else:
            law = None if beyond_effects or scales else law_of(rig, observations.take(fitted))
            begun = with_laws(search, null, law)
        if passed and memory is not None and memory.searched:
            # What leaves noise only of a large gap needs no candidate that was not fitted when it was found.
            far = THRESHOLDS.search.far_behind_log_evidence
            settled = begun[0].fit.log_evidence - null.fit.log_evidence > 2.0 * far
        singles = begun if settled else _singles(search, null, scores(), begun, modes, rig, passed)
        standing = _about_best(standing, rig, observations, singles)
        pairs = _pairs(standing)
        if pairs and pairs[0].fit.log_evidence > standing.named[0].fit.log_evidence:
            standing = _about_best(standing, rig, observations, [*standing.named, *pairs])
        else:
            standing = _competing(standing, [*standing.named, *pairs])
    else:  # one fit tells what a difference that does not matter looks like
        standing = _about_best(standing, rig, observations, search.fitted(null, scores()[:1]))
    first_null, search, null, named = null, standing.search, standing.null, list(standing.named)
    data = search.data
    named = [needed(data, explanation, [null, *named], settings.matters) for explanation in named]
    leading = Hypotheses(data, null, named, candidates, [], []).best
    if leading is not None and leading.small:
        # What is small is so beside every cause: rivals get it, too.
        more = search.with_small(leading, named)
        named += [needed(data, explanation, [null, *named], settings.matters) for explanation in more]
    beside = sources(data, null, len(parameters))
    best_named = Hypotheses(data, null, named, candidates, beside, []).best
    behind = sources(data, best_named, len(parameters)) if best_named is not None else []
    hypotheses = Hypotheses(data, null, named, candidates, beside, behind, standing.elsewhere)
    comparison = hypotheses.compared()
    explained: dict[str, float] = {}
    for source in beside:
        explained[source.location.kind] = max(explained.get(source.location.kind, 0.0), source.explained)
    best = best_named if best_named is not None and comparison.log_odds > THRESHOLDS.verdict.alarm_log_odds else null
    for location in best.explanation.locations:
        explained[location.kind] = max(explained.get(location.kind, 0.0), null.fit.cost - best.fit.cost)
    unmoved = best is first_null  # since the scan

    @cache
    def beside_best() -> tuple[Score, ...]:
        return tuple(scores() if unmoved else search.scores(best, scores()))

    if memory is not None:
        memory.keep(named, [it.found for it in standing.left_out], gap)
    lacking = modes.lacking(data, best.fit)
    return Findings(
        data, search, as_given, null, tuple(named), hypotheses, comparison, explained, (*modes.disordered, *lacking),
        scales,
        tuple(sentence for sentence in modes.sentences if sentence not in lacking), standing.left_out, law,
        () if settled else tuple(scores()), beside_best,
    )  # fmt: skip


def _noise_only(rig: Rig, observations: Observations, data: Data, found: FittedExplanation) -> bool:
    """Whether an explanation leaves noise only, if need be once the chain is taken about it and not about the model."""
    if leaves_noise_only(data, found):
        return True
    near = about(rig, observations, found.fit, data.used)
    again = Search(near, rig, (), ()).best(
        found.fit.parametrisation, [Start(found.fit.start, found.fit.theta, found.fit)]
    )
    return again is not None and leaves_noise_only(near, again)


def _singles(
    search: Search,
    null: FittedExplanation,
    scores: Sequence[Score],
    begun: Sequence[FittedExplanation],
    modes: LowLevelModes,
    rig: Rig,
    passed: Collection[Explanation] = (),
) -> list[FittedExplanation]:
    """Explanations by one effect and those that were begun, the best first; those that are passed need no fit."""
    singles = best_of([*begun, *search.singles(null, scores, passed)])
    if modes.far_from(rig) and modes.exceed_priors(null.fit.parametrisation, null.fit.theta):
        search.tell("bringing the modes of explanations to the measured ones")
        singles = best_of([*singles, *search.from_modes(null, modes)])
    return singles


def _pairs(standing: Standing) -> list[FittedExplanation]:
    """Explanations by two effects, and by one that a pair led to its optimum; the best first."""
    search, singles = standing.search, standing.named
    search.tell("looking for second effects")
    # What one of them has not reached yet would decide which of them are left out.
    pairs = best_of([search.again(pair) for pair in search.pairs(singles)])
    reached = search.pruned(pairs)
    if reached and reached[0].fit.log_evidence > singles[0].fit.log_evidence:
        before = {explanation.explanation for explanation in pairs}
        pairs += [it for it in search.pairs(reached, singles) if it.explanation not in before]
    return best_of([*reached, *pairs])


def _about_best(
    standing: Standing, rig: Rig, observations: Observations, found: Sequence[FittedExplanation]
) -> Standing:
    """Explanations that compete, fitted under the noise and the errors of the chain about the best of them."""
    named = best_of(found)
    if not named or named[0].fit.log_evidence <= standing.null.fit.log_evidence:
        return replace(standing, named=tuple(named))
    before = standing.search
    data = about(rig, observations, named[0].fit, before.data.used)
    search = Search(data, rig, before.parameters, before.candidates, before.tell)
    search.lost |= before.lost
    near, far = search.in_reach(named)
    elsewhere = _lags(near, far)
    # What two effects do together is judged beside what one of them does.
    members = [it for it in far if set(it.fitted.causes) < set(named[0].fitted.causes)][:1]
    near, far = search.all_again([*near, *members]), [it for it in far if it not in members]
    # An effect that does nothing may have led the model's own parameters on to their optimum.
    null = search.from_parameters_of(near[0], search.again(standing.null))
    more, far = search.other_laws(near[0], far)
    left_out = _left_out(standing.null, far, named, near)
    named = [*near, *more]
    # A second effect that says nothing may have led the first on to its optimum.
    named = best_of([*named, *search.pruned(named)])
    return Standing(search, null, tuple(named), (*standing.left_out, *left_out), (*standing.elsewhere, *elsewhere))


def _competing(standing: Standing, found: Sequence[FittedExplanation]) -> Standing:
    """Explanations that are not far behind the best, fitted to the end."""
    search, named = standing.search, best_of(found)
    if not named:
        return standing
    near, far = search.in_reach(named)
    done = set(map(id, standing.named))
    near = [it if id(it) in done else search.again(it) for it in near]
    left_out = _left_out(standing.null, far, named, near)
    return replace(
        standing,
        named=tuple(best_of([*near, *search.pruned(near)])),
        left_out=(*standing.left_out, *left_out),
        elsewhere=(*standing.elsewhere, *_lags(near, far)),
    )


def _left_out(
    null: FittedExplanation,
    far: Sequence[FittedExplanation],
    found: Sequence[FittedExplanation],
    kept: Sequence[object],
) -> list[LeftOut]:
    """Explanations that do not compete, with how far they lie behind the best of those that were found."""
    first, most = found[0].fit.log_evidence, math.inf
    if len(kept) >= THRESHOLDS.search.finalists:
        most = first - found[THRESHOLDS.search.finalists - 1].fit.log_evidence
    return [LeftOut(it, null, first - it.fit.log_evidence, most) for it in far]


def _lags(near: Sequence[FittedExplanation], far: Sequence[FittedExplanation]) -> list[tuple[FittedExplanation, float]]:
    """Explanations that are far behind, with how much more each leaves than the best of its effects."""
    best = {found.effects: found for found in reversed(near)}
    result = []
    for found in far:
        if found.effects in best:
            weights = best[found.effects].fit.errors.weights
            result.append((found, misfit(found, weights) - misfit(best[found.effects], weights)))
    return result


def free_parameters(rig: Rig, observations: Observations) -> tuple[CalibrationParameter, ...]:
    """Parameters that are free in every explanation: of the model, damping of its modes, delays of its sensors."""
    return (
        *calibration_parameters(rig),
        *mode_dampings(rig, *_band(observations)),
        *shared_delays(observations, rig),
    )


def _band(observations: Observations) -> tuple[float, float]:
    """Lowest and highest frequency of all rows, Hz; empty where none has one."""
    known = observations.rows.frequency_hz
    known = known[np.isfinite(known) & (known > 0.0)]
    return (float(known.min()), float(known.max())) if known.size else (1.0, 0.0)


def model_alone(
    rig: Rig,
    observations: Observations,
    parameters: Sequence[CalibrationParameter],
    fitted: BoolArray,
    modes: LowLevelModes,
) -> tuple[Observations, Prediction, FittedExplanation, Data]:
    """The model alone: first by logarithms, then with its chain about where it stands.

    Args:
        rig: the model.
        observations: the real side.
        parameters: those of the model and its chain that are free.
        fitted: rows that are compared, (m,).
        modes: of the observations.

    Returns:
        Observations with the error of the solver, prediction of the model as given, its fit, and what that worked on.

    Raises:
        BenchError: the model has no solution for most of the observations.
    """
    try:
        as_given = Forward(observations.tests, observations.rows).predict(rig)
        observations = replace(observations, tests=traced(observations.tests, as_given))
        as_given = Forward(observations.tests, observations.rows).predict(rig, as_given)
        used = np.isfinite(as_given.values) & fitted
        if used.sum() < THRESHOLDS.fits.least_solved_share * fitted.sum():
            raise FitError("it has no solution for most of the observables")
        observations = _with_solver_error(observations, rig, as_given)
        parametrisation = Parametrisation(rig, tuple(parameters))
        data = data_about(observations, rig, as_given, used, logarithms=True)
        starts = [Start(StartName.GIVEN, parametrisation.zero, as_given)]
        if modes.far_from(rig):
            starts.append(Start(StartName.MODES, modes.start(parametrisation, parametrisation.zero)[0]))
        found = best_fit(data, parametrisation, starts, value=likelihood)
        for _ in range(_CHAIN_ROUNDS):
            data = about(rig, observations, found, used)
            found = from_believed(data, fit(data, parametrisation, Start(found.start, found.theta, found)))
    except (FitError, ArithmeticError, np.linalg.LinAlgError) as error:
        raise BenchError(f"The model cannot be compared with the observations: {error}.") from error
    return data.observations, as_given, FittedExplanation((), found), data


def _with_solver_error(observations: Observations, rig: Rig, as_given: Prediction) -> Observations:
    """The observations with what harmonics that the harmonic balance leaves out change, as part of their floor."""
    fine = Forward(observations.tests, observations.rows, PredictionSettings(harmonics=_FINE_HARMONICS))
    change = np.abs(np.nan_to_num(fine.difference(fine.predict(rig).values, as_given.values)))
    return replace(observations, floor=np.hypot(observations.floor, change))


def _detectable(search: Search, scores: Sequence[Score], rig: Rig) -> tuple[DetectableEffect, ...]:
    """The weakest that each effect could be and still show by five standard deviations, where it shows first."""
    strongest: dict[str, Score] = {}
    for score in scores:
        name = search.candidates[score.candidate].effect.name
        if score.reach > 0.0 and (name not in strongest or score.reach > strongest[name].reach):
            strongest[name] = score
    result = []
    for name, score in sorted(strongest.items()):
        candidate = search.candidates[score.candidate]
        theta = at_strength(candidate, score.start, THRESHOLDS.verdict.visible_sigmas / score.reach)
        reported = Parametrisation(rig, (), (candidate,)).reported(theta, 0)
        values = {key: Value(value, math.nan, unit) for key, (value, unit) in reported.items()}
        location = candidate.site.location
        result.append(DetectableEffect(name, location.kind, location.detail, values))
    return tuple(result)


def about(rig: Rig, observations: Observations, near: FitResult, used: BoolArray) -> Data:
    """What fits work on, noise of measured amplitudes and errors of the chain about a fit."""
    observations = replace(observations, tests=traced(observations.tests, near.prediction))
    fitted_rig = near.parametrisation.rig(near.theta)
    prediction = Forward(observations.tests, observations.rows).predict(fitted_rig, near.prediction)
    return data_about(observations, fitted_rig, prediction, used & np.isfinite(prediction.values))


def diagnose_observations(
    rig: Rig,
    observations: Observations,
    settings: DiagnosisSettings | None = None,
    progress: Progress | None = None,
    memory: Memory | None = None,
) -> DiagnosisOutcome:
    """Diagnose observations that have been read already; see :func:`diagnose_bags`.

    Lines of the mains depend on nothing but the hum of their channel. They are left out where causes compete: a sum of
    independent evidence orders causes by their own part. Where no cause is found, those that are as large as harmonics
    that matter are judged alone.

    Raises:
        BenchError: the model has no solution for most of the observations.
    """
    settings, tell = settings or DiagnosisSettings(), progress or (lambda _: None)
    if observations.turns:
        rig = rig.model_copy(update={"coordinate": "angle"})
    observations = replace(observations, matters=dict(settings.matters))
    hum = observations.rows.part == Part.LINE
    outcome = _diagnosed(rig, observations, settings, tell, ~hum, memory)
    large = large_lines(observations, settings.matters.get("harmonics", 0.0))
    if outcome.diagnosis.verdict in (Verdict.EFFECT, Verdict.UNKNOWN) or not stands_out(observations, large):
        return outcome
    others = tuple(effect.name for effect in library() if effect.name != MAINS_HUM)
    alone = _diagnosed(rig, observations, replace(settings, withheld=(*settings.withheld, *others)), tell, ~hum | large)
    if alone.diagnosis.verdict not in (Verdict.EFFECT, Verdict.UNKNOWN):
        return outcome
    stated_inputs = {**alone.diagnosis.inputs, "withheld": list(settings.withheld)}
    return replace(alone, diagnosis=replace(alone.diagnosis, inputs=stated_inputs))


def _diagnosed(
    rig: Rig,
    observations: Observations,
    settings: DiagnosisSettings,
    tell: Progress,
    compared: BoolArray,
    memory: Memory | None = None,
) -> DiagnosisOutcome:
    """Diagnosis of those rows that are compared, (m,)."""
    held_out_splits = splits(observations, settings.hold_out)
    findings = find(rig, observations, settings, tell, compared, memory)
    data, null, comparison = findings.data, findings.null, findings.comparison
    tell("predicting what was held out")
    as_given_errors = best_chain_errors(data, findings.as_given.values)
    held_out = named_tests(observations, settings.hold_out) & compared
    finite = np.all(
        [np.isfinite(explanation_fit.fit.prediction.values) for explanation_fit in (null, *findings.named)], axis=0
    )
    all_data = replace(data, used=data.used | (held_out & finite & np.isfinite(findings.as_given.values)))
    refits = HeldOut(findings.data, all_data, held_out_splits)
    shares = {
        explanation_fit.head.explanation: _closed(findings, refits, explanation_fit.head, settings.seed)
        for explanation_fit in comparison.to_judge()
    }
    comparison = by_plain_effect(comparison, shares)
    leader = comparison.classes[0] if comparison.classes else None
    share = None if leader is None else shares[leader.head.explanation]
    alone = _alone(findings, as_given_errors, settings)
    rival = max(comparison.unknown, comparison.none)
    verdict = verdict_of(alone, None if leader is None else leader.facts(share, rival))
    named = leader if verdict is Verdict.EFFECT else None
    adequate = verdict is not Verdict.UNKNOWN and (named is None or named.adequate)
    # What nothing in the library explains is told with the part that it does explain.
    nearest = leader if verdict in (Verdict.EFFECT, Verdict.UNKNOWN) else None
    best = named.head if named is not None else null
    reported_fit = nearest.head if nearest is not None else null
    scale = scale_of(reported_fit, verdict in (Verdict.EFFECT, Verdict.UNKNOWN))
    as_given, before, after = (
        best_chain_errors(all_data, values).residual * scale
        for values in (findings.as_given.values, null.fit.prediction.values, reported_fit.fit.prediction.values)
    )
    scaled = replace(data.observations, std=data.sigma / scale, floor=np.zeros_like(data.sigma))
    rows = all_data.used
    reported_share = share if nearest is not None else None
    if verdict is Verdict.CALIBRATION:
        reported_share = _recalibrated(findings, refits, settings.seed)
    gap = Gap(
        before=reported_share.before
        if reported_share is not None and math.isfinite(reported_share.before)
        else rms((as_given if verdict is Verdict.CALIBRATION else before)[rows]),
        after=reported_share.after
        if reported_share is not None and math.isfinite(reported_share.after)
        else rms(after[rows]),
        floor=1.0,
        as_given=rms(as_given[rows]),
        closed=reported_share.value if reported_share is not None else math.nan,
        low=reported_share.low if reported_share is not None else math.nan,
        high=reported_share.high if reported_share is not None else math.nan,
        per_observable=per_observable(scaled, before, after, rows),
        held_out=tuple(split.name for split in held_out_splits),
    )
    left_over_gap = remainder(scaled, gap, after, rows) if nearest is not None else None
    where = place_rows(comparison, findings.sources) if nearest is not None or verdict is Verdict.UNKNOWN else ()
    partial = verdict is Verdict.EFFECT and not adequate
    ranking = ranked_rows(data, comparison, shares, partial) if nearest is not None else ()
    calibration = calibration_rows(best)
    proposed_tests: tuple[NextTest, ...] = ()
    if settings.look_ahead and nearest is not None:
        proposed_tests = next_tests(
            rig, scaled, null, comparison, bool(settings.plan), data.chain_names, settings.command,
            further=settings.other_kinds,
        )  # fmt: skip
    levels = None
    if settings.look_ahead and settings.plan:
        gap_is_there = verdict in (Verdict.EFFECT, Verdict.UNKNOWN)
        levels = next_levels(
            rig, scaled, null, comparison, settings.plan, findings.search, findings.scores, gap_is_there,
            settings.command,
        )  # fmt: skip
    left = (*proposed_tests, *(() if levels is None or levels.tells_little else (levels,)))
    sensors: tuple[NextTest, ...] = ()
    if settings.look_ahead and settings.plan and verdict is Verdict.EFFECT and not left:
        sensors = other_sensors(rig, scaled, null, comparison, settings.plan, data.chain_names)
    warnings = warned(verdict, best, calibration, gap, named.members if named is not None else ())
    warnings += tuple(f"{sentence.rstrip('.')}; nothing of it is left that matters." for sentence in findings.doubtful)
    warnings += without_observables(observations)
    explanation = leader.head.explanation if leader is not None else None

    def detectable() -> tuple[DetectableEffect, ...]:
        return _detectable(findings.search, findings.scores(), rig)

    text = sentences(
        verdict,
        where,
        ranking,
        explanation,
        gap,
        proposed_tests,
        calibration,
        left_over_gap,
        leader.objections if leader is not None else (),
    )
    if comparison.small is not None and verdict in (Verdict.NONE, Verdict.CALIBRATION):
        size = measured_size(data, comparison.small)
        like = likeness(comparison.small.fitted, parameters(data, comparison.small))
        text = (*text, f"{size.sentence(settings.matters)} {like}")
    untold = findings.inadequate or findings.factors
    law = findings.law if partial or (verdict is Verdict.UNKNOWN and not untold) else None
    text = (*text, *law_sentences(law, verdict is Verdict.UNKNOWN))
    if verdict is Verdict.UNKNOWN and not GAP(alone).passed:
        share_of_signal, whose = findings.unexplained
        text = (f"The model leaves {100.0 * share_of_signal:.2g} % of the signal of {whose}, which is no noise.", *text)
    if findings.factors:
        named_factors = (found.sentence for found in findings.factors)
        text, warnings = (*named_factors, "Effects are judged once units and signs of the recording are right."), ()
        where = tuple(found.place for found in findings.factors)
    elif findings.inadequate:
        text = (*findings.inadequate, "Effects are judged once the model has the modes of the recordings.", *text[1:2])
    diagnosis = Diagnosis(
        verdict=verdict,
        sentences=(*text, *warnings),
        where=where,
        ranking=ranking,
        probabilities=dict(comparison.by_label),
        gap=gap,
        next_test=proposed_tests,
        calibration=calibration,
        inputs=inputs(observations, rig, held_out_splits, settings),
        notes=observations.notes + tuple(findings.as_given.reasons),
        residual_map=residual_map(scaled, as_given, before, after),
        residual_tests=tuple(test.to_mapping() for test in residual_tests(scaled, after, rows)),
        candidates=(
            *(candidate_row(explanation_fit, null, data) for explanation_fit in (null, *findings.named)),
            *(candidate_row(it.found, it.beside, data, FAR_BEHIND) for it in findings.left_out),
        ),
        features={
            "feature:log_odds": comparison.log_odds,
            "cost_given": as_given_errors.cost,
            "cost_null": null.fit.cost,
            "cost_best": reported_fit.fit.cost,
            **{f"rms:{name}": value for name, value in _learnt_scales(data, reported_fit).items()},
        },
        warnings=warnings,
        remainder=left_over_gap,
        visible=detectable() if settings.look_ahead and not settings.put_off_detectable else (),
        adequate=adequate,
        law=law,
        next_levels=levels,
        other_sensors=sensors,
        answers=credible_answers(verdict, adequate, ranking, comparison.by_label),
        ledger=ledger_of(
            Decided(
                findings.search,
                null,
                findings.named,
                findings.left_out,
                findings.hypotheses,
                comparison,
                shares,
                alone,
                verdict,
                findings.scanned,
            )
        ),
    )
    model = rig if verdict is Verdict.NONE else _rig_of(best, len(calibration))
    if verdict is Verdict.UNKNOWN and law is not None and law.is_stated:
        model = with_law(rig, law)
    return DiagnosisOutcome(
        diagnosis, scaled, rig, model, as_given_errors.values, null.fit.errors.values, best.fit.errors.values,
        detectable if settings.look_ahead and settings.put_off_detectable else None,
    )  # fmt: skip


def scale_of(found: FittedExplanation, gap: bool = True) -> FloatArray:
    """What residuals over σ are multiplied by to be in standard deviations of the noise, (m,).

    Where there is a gap, what an explanation leaves of it makes the scale that it learns larger, and is no noise.
    """
    weights = found.fit.errors.weights
    return np.asarray(np.sqrt(np.maximum(weights, 1.0) if gap else weights))


def _learnt_scales(data: Data, found: FittedExplanation) -> dict[str, float]:
    """Learnt scale of each group of rows: its rms in the stated noise."""
    values = np.sqrt(found.fit.errors.squares / np.maximum(data.counts, 1.0))
    return dict(zip(data.groups.names, map(float, values), strict=True))


def _rig_of(found: FittedExplanation, model_parameters: int) -> Rig:
    """The rig of an explanation; what belongs to the measuring chain stays as given."""
    theta = found.fit.theta.copy()
    parameters = found.fit.parametrisation.calibration
    for k, parameter in enumerate(parameters):
        if k >= model_parameters:
            assert isinstance(parameter, SharedDelay)
            theta[k] = 0.0
    return found.fit.parametrisation.rig(theta)


def _alone(findings: Findings, as_given_errors: ChainErrors, settings: DiagnosisSettings) -> Facts:
    """What the rules ask of the model alone: whether there is a gap, and what re-fitting its own parameters does."""
    data, null = findings.data, findings.null
    fall = (as_given_errors.cost - null.fit.cost) / THRESHOLDS.verdict.recalibration_cost_fall
    facts = Facts(
        log_odds=findings.comparison.log_odds,
        modes=len(findings.inadequate),
        factors=len(findings.factors),
        left=findings.unexplained[0] / THRESHOLDS.verdict.unexplained_share,
        left_without=fall,
    )
    if fall < 1.0:
        return facts
    count = sum(not isinstance(parameter, SharedDelay) for parameter in null.fit.parametrisation.calibration)
    try:
        values = data.forward.predict(_rig_of(null, count), null.fit.prediction).values
    except BenchError:
        return replace(facts, change=math.inf)
    size = change_size(data, data.forward.difference(values, findings.as_given.values))
    return replace(facts, change=over(size, settings.matters))


def _closed(findings: Findings, refits: HeldOut, best: FittedExplanation, seed: int) -> ClosedShare:
    """How much of the gap an explanation closes on rows that its fit did not see.

    A split whose fit leaves open what the explanation does to the rows held out says nothing of it, nor does one from
    which the model alone knows less of them than what it is off by.
    """
    null, scale, data = findings.null, scale_of(best), refits.all_data
    fits = [
        best_chain_errors(data, explanation.fit.prediction.values, explanation.fit.errors).residual
        for explanation in (null, best)
    ]
    change = (fits[1] - fits[0]) * scale
    pairs = []
    for split in refits.splits:
        rows = split.held_out & data.used
        before, after = (refits.residual(explanation, split) for explanation in (null, best))
        if before is None or after is None or not rows.any():
            continue
        uncertain = after[1] * scale
        if rms(before[1][rows]) > rms(before[0][rows]):
            continue
        if rms(uncertain[rows]) <= THRESHOLDS.verdict.open_prediction_share * rms(change[rows]):
            silent = no_worse_than_silence(data.observations, before[0], data.sigma)
            pairs.append((silent * scale, after[0] * scale / np.hypot(1.0, uncertain), rows))
    return closed(data.observations, pairs, seed)


def _recalibrated(findings: Findings, refits: HeldOut, seed: int) -> ClosedShare:
    """How much of the gap to the model as given its own parameters close on rows that their fit did not see.

    A split whose fit leaves open what they do to the rows held out says nothing of it.
    """
    null, scale, data = findings.null, scale_of(findings.null, False), refits.all_data
    as_given_residual = best_chain_errors(data, findings.as_given.values).residual
    as_given_residual = no_worse_than_silence(data.observations, as_given_residual, data.sigma) * scale
    pairs = []
    for split in refits.splits:
        after, rows = refits.residual(null, split), split.held_out & data.used
        if after is not None and not after[2]:
            pairs.append((as_given_residual, after[0] * scale / np.hypot(1.0, after[1] * scale), rows))
    return closed(data.observations, pairs, seed)


class HeldOut:
    """What explanations leave of rows that their fits did not see, each split of each explanation fitted once.

    Args:
        fitted: what the fits worked on.
        all_data: the same with what was held out from all of them.
        splits: ways to hold rows out.
    """

    def __init__(self, fitted: Data, all_data: Data, splits: Sequence[Split]) -> None:
        self.fitted, self.all_data, self.splits = fitted, all_data, tuple(splits)
        self._known: dict[tuple[int, int], tuple[FloatArray, FloatArray, bool] | None] = {}

    def residual(self, found: FittedExplanation, split: Split) -> tuple[FloatArray, FloatArray, bool] | None:
        """As of `_held_out_residual`."""
        key = id(found), id(split)
        if key not in self._known:
            self._known[key] = _held_out_residual(self.fitted, self.all_data, found, split)
        return self._known[key]


def _held_out_residual(
    fitted: Data, all_data: Data, found: FittedExplanation, split: Split
) -> tuple[FloatArray, FloatArray, bool] | None:
    """Residual of all rows by a fit to some, uncertainty of its prediction, over σ, and whether it leaves any open.

    It leaves open a parameter that all rows move beyond its prior and that it knows no better than that.

    What is predicted is the rig; how the measuring chain was when the rest was measured, those rows tell themselves.
    """
    part = replace(fitted, used=fitted.used & split.fitted)
    fitted_before = found.fit
    try:
        from_all = Start(
            fitted_before.start, fitted_before.theta, fitted_before, fitted_before.theta.size, effort=REFIT
        )
        refit = fit(part, fitted_before.parametrisation, from_all)
    except FitError:
        return None
    left = best_chain_errors(all_data, refit.prediction.values, fitted_before.errors).residual
    chain = Metric(fitted_before.errors.slopes, np.ones(fitted_before.errors.chain.size), fitted_before.errors.weights)
    slopes = chain.project(fitted_before.jacobian)[0]
    prior = fitted_before.parametrisation.prior_std
    unknown = refit.std > _NO_BETTER * prior
    is_open = bool(np.any(unknown & (np.abs(fitted_before.theta) > prior)))
    return left, np.sqrt(np.einsum("mi,ij,mj->m", slopes, refit.covariance, slopes)), is_open
