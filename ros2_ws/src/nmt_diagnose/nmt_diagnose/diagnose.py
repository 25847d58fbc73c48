"""The whole diagnosis: from bags and a rig file to a verdict."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from nmt_core.numerics.arrays import BoolArray, FloatArray
from nmt_core.text.number_words import percent
from nmt_diagnose.ahead.next_tests import next_levels, next_tests, other_sensors
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.effects.library import library
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.fit.candidate_starts import at_strength
from nmt_diagnose.fit.explanations import FittedExplanation, Score
from nmt_diagnose.fit.fitting import Data
from nmt_diagnose.ledger.credible_answers import credible_answers
from nmt_diagnose.ledger.diagnosis import (
    DetectableEffect,
    Diagnosis,
    Gap,
    NextTest,
    PlaceShare,
    Ranked,
    Recalibrated,
    Remainder,
    Value,
    Verdict,
)
from nmt_diagnose.ledger.gap import closed, over_splits, rms
from nmt_diagnose.ledger.held_out import HeldOut, named_tests, splits
from nmt_diagnose.ledger.judgement import Judgement, judged
from nmt_diagnose.ledger.ledger import ledger_of
from nmt_diagnose.ledger.plain_look import by_channel
from nmt_diagnose.ledger.rules import GAP, NEEDED, WITHIN
from nmt_diagnose.ledger.size import implausible_chain, large_lines, measured_size
from nmt_diagnose.ledger.warnings import frequencies_alone, warned, without_observables
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.observations.read_observations import read_observations
from nmt_diagnose.say.law_sentences import law_sentences, led_by_law
from nmt_diagnose.say.remainder import remainder
from nmt_diagnose.say.residual_map import per_observable, residual_map
from nmt_diagnose.say.residual_tests import residual_tests
from nmt_diagnose.say.result_rows import (
    calibration_rows,
    candidate_row,
    inputs,
    is_located,
    parameters,
    place_rows,
    ranked_rows,
    too_small_row,
)
from nmt_diagnose.say.sentences import UNITS_FIRST, likeness, relieving, sentences, too_small
from nmt_diagnose.search.findings import find
from nmt_diagnose.search.memory import Memory
from nmt_diagnose.search.search import Progress, Search
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig, load_rig

# Most lines of a random test: neighbouring ones show the same.
_RANDOM_LINES = 160


@dataclass(frozen=True)
class DiagnosisOutcome:
    """A diagnosis and what a report draws.

    Attributes:
        diagnosis: the result.
        observations: the real side, its uncertainties those that were learnt.
        initial_model: the model as given.
        model: the model with its parameters re-fitted and the accepted effect added; the given one without a gap.
        as_given, refitted, final: observables of the initial model, of the re-fitted one and of ``model``, (m,).
        detectable: computes ``Diagnosis.visible``, where that was put off.
        other: the model that competed with ``model``, from the law or from the explanation; None without one.
    """

    diagnosis: Diagnosis
    observations: Observations
    initial_model: Rig
    model: Rig
    as_given: FloatArray
    refitted: FloatArray
    final: FloatArray
    detectable: Callable[[], tuple[DetectableEffect, ...]] | None = None
    other: Rig | None = None

    def completed(self) -> DiagnosisOutcome:
        """The outcome with what was put off."""
        if self.detectable is None:
            return self
        return replace(self, diagnosis=replace(self.diagnosis, visible=self.detectable()), detectable=None)


MAINS_HUM = "mains_hum"
FAR_BEHIND = "far behind the best"


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


def _detectable(
    search: Search, base: FittedExplanation, scores: Sequence[Score], rig: Rig
) -> tuple[DetectableEffect, ...]:
    """Smallest strength of each effect on top of a fit that would be reported, at the place where it shows first."""
    strongest: dict[str, Score] = {}
    for score in scores:
        name = search.candidates[score.candidate].effect.name
        if score.reach > 0.0 and (name not in strongest or score.reach > strongest[name].reach):
            strongest[name] = score
    result = []
    weakest = search.reported_from(base, list(strongest.values()))
    for (name, score), strength in sorted(zip(strongest.items(), weakest, strict=True)):
        if strength > THRESHOLDS.verdict.largest_strength:
            continue  # as of x⁵ in a motion of nanometres
        candidate = search.candidates[score.candidate]
        theta = at_strength(candidate, score.start, strength)
        reported = Parametrisation(rig, (), (candidate,)).reported(theta, 0)
        values = {key: Value(value, math.nan, unit) for key, (value, unit) in reported.items()}
        location = candidate.site.location
        result.append(DetectableEffect(name, location.kind, location.detail, values))
    return tuple(result)


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
    if outcome.diagnosis.verdict.gap or not large.any():
        return outcome
    others = tuple(effect.name for effect in library() if effect.name != MAINS_HUM)
    alone = _diagnosed(rig, observations, replace(settings, withheld=(*settings.withheld, *others)), tell, ~hum | large)
    if not alone.diagnosis.verdict.gap:
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
    ways = splits(observations, settings.hold_out)
    findings = find(rig, observations, settings, tell, compared, memory)
    data, null = findings.data, findings.null
    tell("predicting what was held out")
    finite = np.all([np.isfinite(explanation.fit.prediction.values) for explanation in (null, *findings.named)], axis=0)
    finite &= np.isfinite(findings.as_given.values) & named_tests(observations, settings.hold_out) & compared
    everything = replace(data, used=data.used | finite)
    held_out = HeldOut(data, everything, ways, null, findings.as_given.values, settings.seed)
    judgement = judged(findings, held_out, settings)
    verdict, comparison = judgement.verdict, judgement.comparison
    left = _left(judgement, held_out)
    gap, remains = _gap(judgement, held_out, left)
    reported = judgement.nearest is not None
    located = reported if verdict is not Verdict.UNKNOWN else is_located(gap, judgement.law)
    where = place_rows(comparison, findings.sources) if located else ()
    ranking = ranked_rows(data, comparison, judgement.shares, judgement.partial) if reported else ()
    demanded = None if verdict.gap else too_small_row(data, null, findings.named, comparison, held_out.closed)
    small = None if demanded is None else demanded[0]
    if demanded is not None and verdict is Verdict.NONE:
        gap = replace(gap, after=demanded[1] if math.isfinite(demanded[1]) else gap.after)
    calibration = calibration_rows(judgement.best)
    if small is not None and comparison.small is not None and verdict is Verdict.NONE:
        calibration = calibration_rows(comparison.small)  # without it parameters stand in for it
    unexplained = remainder(left.observations, gap, remains) if reported else None
    answer = ReportedGap(where, ranking, calibration, gap, unexplained, small)
    ahead = _ahead(rig, judgement, left.observations, settings)
    text, warnings, where = _sentences(judgement, answer, ahead, observations, settings)
    law = judgement.law

    def detectable() -> tuple[DetectableEffect, ...]:
        return _detectable(findings.search, findings.scored, findings.scores(), rig)

    diagnosis = Diagnosis(
        verdict=verdict,
        sentences=(*text, *warnings),
        where=where,
        ranking=ranking,
        probabilities=dict(comparison.by_label),
        gap=gap,
        next_test=ahead.tests,
        calibration=calibration,
        inputs=inputs(observations, rig, ways, settings),
        notes=observations.notes + tuple(findings.as_given.reasons),
        residual_map=residual_map(left.observations, left.as_given, left.before, left.after),
        residual_tests=tuple(test.to_mapping() for test in residual_tests(left.observations, left.after, left.rows)),
        candidates=(
            *(candidate_row(explanation, null, data) for explanation in (null, *findings.named)),
            *(candidate_row(each.found, each.model_alone, data, FAR_BEHIND) for each in findings.left_out),
        ),
        features={
            "feature:log_odds": comparison.log_odds,
            "cost_given": findings.as_given_errors.cost,
            "cost_null": null.fit.cost,
            "cost_best": judgement.reported.fit.cost,
            **{f"rms:{name}": value for name, value in _learnt_scales(data, judgement.reported).items()},
        },
        warnings=warnings,
        remainder=answer.remainder,
        visible=detectable() if settings.look_ahead and not settings.put_off_detectable else (),
        adequate=judgement.adequate,
        law=law,
        law_leads=judgement.law_leads,
        next_levels=ahead.levels,
        other_sensors=ahead.sensors,
        answers=credible_answers(verdict, judgement.adequate, ranking, comparison.by_label),
        ledger=ledger_of(judgement),
        too_small=small,
    )
    model, other = judgement.written
    return DiagnosisOutcome(
        diagnosis, left.observations, rig, model, findings.as_given_errors.values, null.fit.errors.values,
        judgement.best.fit.errors.values, detectable if settings.look_ahead and settings.put_off_detectable else None,
        other,
    )  # fmt: skip


@dataclass(frozen=True)
class ModelResiduals:
    """What models leave of all rows, in standard deviations of the noise.

    Attributes:
        observations: the real side, its uncertainties those that were learnt.
        as_given, before, after: by the model as given, by the model alone, and by what is reported, (m,).
        rows: that are judged, (m,).
    """

    observations: Observations
    as_given: FloatArray
    before: FloatArray
    after: FloatArray
    rows: BoolArray


def _left(judgement: Judgement, held_out: HeldOut) -> ModelResiduals:
    data, reported = judgement.findings.data, judgement.reported
    scale = reported.scale(judgement.verdict.gap)
    as_given, before, after = (
        held_out.residual(values) * scale
        for values in (held_out.as_given, held_out.null.fit.prediction.values, reported.fit.prediction.values)
    )
    scaled = replace(data.observations, std=data.sigma / scale, floor=np.zeros_like(data.sigma))
    return ModelResiduals(scaled, as_given, before, after, held_out.everything.used)


def _gap(judgement: Judgement, held_out: HeldOut, left: ModelResiduals) -> tuple[Gap, FloatArray]:
    """The gap, and the residual of each row, (m,): on held-out data where they judge it, else on all rows."""
    calibration, nearest = judgement.verdict is Verdict.CALIBRATION, judgement.nearest
    pairs = held_out.recalibrated() if calibration else held_out.pairs(nearest.head) if nearest is not None else []
    share = closed(held_out.everything.observations, pairs, held_out.seed)
    predicted = math.isfinite(share.before)
    judged = pairs if predicted else [(left.as_given if calibration else left.before, left.after, left.rows)]
    gap = Gap(
        before=share.before if predicted else rms(judged[0][0][left.rows]),
        after=share.after if predicted else rms(left.after[left.rows]),
        floor=1.0,
        as_given=rms(np.concatenate([left.as_given[rows] for _, _, rows in judged])),
        closed=share.value,
        low=share.low,
        high=share.high,
        per_observable=per_observable(left.observations, judged),
        held_out=tuple(split.words(held_out.everything.observations) for split in held_out.splits) if predicted else (),
    )
    return gap, over_splits([(after, rows) for _, after, rows in judged])


@dataclass(frozen=True)
class NextSteps:
    """What to measure next.

    Attributes:
        tests: that would decide between the remaining explanations.
        levels: of the plan that would add information; None where they were not computed.
        sensors: at other places.
    """

    tests: tuple[NextTest, ...] = ()
    levels: NextTest | None = None
    sensors: tuple[NextTest, ...] = ()


def _ahead(rig: Rig, judgement: Judgement, scaled: Observations, settings: DiagnosisSettings) -> NextSteps:
    if not settings.look_ahead:
        return NextSteps()
    findings, comparison = judgement.findings, judgement.comparison
    null, names, gap = findings.null, findings.data.chain_names, judgement.verdict.gap
    tests: tuple[NextTest, ...] = ()
    if judgement.nearest is not None:
        tests = next_tests(
            rig, scaled, null, comparison, bool(settings.plan), names, settings.command, further=settings.other_kinds
        )
    if not settings.plan:
        return NextSteps(tests)
    levels = next_levels(
        rig, scaled, null, comparison, settings.plan, findings.search, findings.scores, gap, settings.command
    )
    known = tests or (levels is not None and not levels.tells_little)
    if known or judgement.named is None:
        return NextSteps(tests, levels)
    return NextSteps(tests, levels, other_sensors(rig, scaled, null, comparison, settings.plan, names))


@dataclass(frozen=True)
class ReportedGap:
    """What is reported of the gap, as numbers.

    Attributes:
        where: places.
        ranking: explanations.
        calibration: the model's own parameters.
        gap: before and after.
        remainder: the part of the gap that is not explained; None where nothing is reported.
        too_small: an effect that acts and does not matter; None without one.
    """

    where: tuple[PlaceShare, ...]
    ranking: tuple[Ranked, ...]
    calibration: tuple[Recalibrated, ...]
    gap: Gap
    remainder: Remainder | None
    too_small: Ranked | None


def _sentences(
    judgement: Judgement, answer: ReportedGap, ahead: NextSteps, observations: Observations, settings: DiagnosisSettings
) -> tuple[tuple[str, ...], tuple[str, ...], tuple[PlaceShare, ...]]:
    """Sentences of the answer, warnings, and the places that are reported."""
    findings, verdict, leader, named = judgement.findings, judgement.verdict, judgement.leader, judgement.named
    members = named.members if named is not None else ()
    warnings = warned(verdict, judgement.best, answer.calibration, answer.gap, members)
    warnings += without_observables(observations)
    found, row = None if verdict.gap else judgement.comparison.small, answer.too_small
    size = None if found is None else measured_size(findings.data, found)
    text = sentences(
        verdict,
        answer.where,
        answer.ranking,
        leader.head.explanation if leader is not None else None,
        answer.gap,
        ahead.tests,
        answer.calibration,
        answer.remainder,
        leader.objections if leader is not None else (),
        "" if found is None or size is None or row is None else too_small(found.fitted, row, size.words),
    )
    if found is not None and size is not None and row is None:
        like = likeness(found.fitted, parameters(findings.data, found))
        text = (*text, f"{size.sentence(settings.matters)} {like}")
    if verdict in (Verdict.NONE, Verdict.CALIBRATION):
        text = (
            *text,
            *implausible_chain(findings.data, findings.null, settings.matters),
            *frequencies_alone(observations),
        )
    if judgement.named is not None:
        text = (*text, *_relieving(findings.data, judgement.best))
    from_law = law_sentences(judgement.law, judgement.law_is_written)
    if judgement.law is not None and judgement.law_leads:
        text = led_by_law(from_law, text, judgement.law, answer.where)
    else:
        text = (*text, *from_law)
    if verdict is Verdict.UNKNOWN and not GAP(judgement.alone).passed:
        share_of_signal, whose = findings.unexplained
        contradicts = f"The model leaves {percent(share_of_signal)} of {whose}, which is not noise."
        if findings.contradiction is not None and share_of_signal < THRESHOLDS.verdict.unexplained_share:
            contradicts = f"Of the model alone {findings.contradiction.sentence}."
        begins = 1 if judgement.law is not None and judgement.law_leads else 0
        text = (*text[:begins], contradicts, *text[begins:])
    if findings.factors:
        turned = by_channel(findings.factors)
        named_factors = (found.sentence for found in turned)
        text = (*named_factors, UNITS_FIRST)
        return text, (), tuple(found.place for found in turned)
    if findings.inadequate:
        text = (*findings.inadequate, "Effects are judged once the model has the modes of the recordings.", *text[1:2])
    return text, warnings, answer.where


def _relieving(data: Data, best: FittedExplanation) -> tuple[str, ...]:
    """Sentences on effects of an explanation that only move model and chain back to their priors."""
    every = range(len(best.candidates))
    only = [
        replace(best, small=frozenset(every) - {number})
        for number in sorted(best.small)
        if number in best.comparisons
        and NEEDED(best.comparisons[number]).passed
        and not WITHIN(best.comparisons[number]).passed
    ]
    return tuple(relieving(explanation.explanation, parameters(data, explanation)) for explanation in only)


def _learnt_scales(data: Data, found: FittedExplanation) -> dict[str, float]:
    """Learnt scale of each group of rows: its rms in the stated noise."""
    values = np.sqrt(found.fit.errors.squares / np.maximum(data.counts, 1.0))
    return dict(zip(data.groups.names, map(float, values), strict=True))
