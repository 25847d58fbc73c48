"""The whole diagnosis: from bags and a rig file to a verdict."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nmt_core.arrays import FloatArray
from nmt_diagnose.effects.placement import Explanation
from nmt_diagnose.inference.confidence import Confidence, confidence
from nmt_diagnose.inference.diagnosis import (
    Diagnosis,
    Gap,
    LeftOut,
    NextTest,
    Remainder,
    Verdict,
)
from nmt_diagnose.inference.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.inference.discrepancy import elsewhere
from nmt_diagnose.inference.fit import Fit
from nmt_diagnose.inference.fitted_model import FittedModel, rms_left
from nmt_diagnose.inference.gap import Closed, rms
from nmt_diagnose.inference.held_out import splits
from nmt_diagnose.inference.held_out_comparison import HeldOut, Refits
from nmt_diagnose.inference.judgement import (
    ExplanationClass,
    Judgement,
    judge,
    with_held_out,
    with_prior_conflict,
    with_share_left,
    with_share_unexplained,
)
from nmt_diagnose.inference.leave_one_out import contradiction, left_out, recordings
from nmt_diagnose.inference.next_test import next_tests
from nmt_diagnose.inference.prior_conflict import prior_conflict
from nmt_diagnose.inference.progress import Progress
from nmt_diagnose.inference.remainder import remainder
from nmt_diagnose.inference.residual_map import per_observable, residual_map
from nmt_diagnose.inference.residual_tests import residual_tests
from nmt_diagnose.inference.result_tables import (
    candidate_entry,
    feature_table,
    inputs,
    place_shares,
    ranked,
    recalibrated,
)
from nmt_diagnose.inference.search import Search
from nmt_diagnose.inference.sentences import sentences
from nmt_diagnose.inference.sources import generic_sources, places
from nmt_diagnose.inference.warnings import warned, without_observables
from nmt_diagnose.inference.workers import Workers
from nmt_diagnose.observations.observables import Observations
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.observations.read_observations import read_observations
from nmt_rig.rig import Rig, load_rig

_JUDGED = 3
# Probability of something unnamed from which other than the nearest explanations are not fitted to held-out data.
_HARDLY_NAMED = 0.97
_HELPS = 2.0
_CHANCE = 1.0
# Share of the gap of a laboratory's tests that a named effect may leave, and by how many times as much its interval may
# fall short.
_REMAINDER, _UNSURE = 0.15, 3.0
# Gap over the noise (rms) from which what is left of it is a share of the effect rather than an effect of its own.
_STRONG = 10.0
# From here on the share of it that an explanation closes says whether that is what the gap is made of.
_CLEAR = 2.0
_SECOND = 8.0  # ln of what a second effect costs in prior, among some hundred candidates


@dataclass(frozen=True)
class DiagnosisOutcome:
    """A diagnosis and what a report draws.

    Attributes:
        diagnosis: the result.
        observations: the real side.
        given: the model as given.
        model: the model with its parameters re-fitted and the accepted effect added; the given one where there is no
            gap.
        as_given, refitted, final: observables of the given model, of the re-fitted one and of ``model``, (m,).
    """

    diagnosis: Diagnosis
    observations: Observations
    given: Rig
    model: Rig
    as_given: FloatArray
    refitted: FloatArray
    final: FloatArray


def diagnose_bags(
    model: Path | str | Rig,
    bags: Sequence[Path | str],
    floor_bags: Sequence[Path | str] = (),
    settings: DiagnosisSettings | None = None,
    progress: Progress | None = None,
) -> DiagnosisOutcome:
    """Diagnose the gap between a rig file and bags of the real side.

    Args:
        model: rig file, its name, or a loaded rig.
        bags: runs or imports of the real side.
        floor_bags: repeats of tests among ``bags``.
        settings: None = defaults.
        progress: called with a sentence as the work goes on.

    Raises:
        BenchError: bags or rig cannot be used, with a sentence.
    """
    rig = model if isinstance(model, Rig) else load_rig(str(model))
    settings = settings or DiagnosisSettings()
    if settings.method == "measured":
        from nmt_diagnose.core.measured import diagnose_measured

        return diagnose_measured(rig, bags, floor_bags, settings, progress or (lambda _: None))
    # The other processes start while the bags are read.
    with Workers(settings.jobs) as workers:
        reading = ObservationSettings(calibration=settings.calibration)
        observations = read_observations(bags, rig, floor_bags, reading, progress, settings.allow_own_model)
        return _Diagnoser(rig, observations, settings, progress or (lambda _: None), bool(floor_bags), workers).run()


def diagnose_observations(
    rig: Rig,
    observations: Observations,
    settings: DiagnosisSettings | None = None,
    progress: Progress | None = None,
    repeated: bool = False,
) -> DiagnosisOutcome:
    """Diagnose observations that have been read already; see :func:`diagnose_bags`.

    ``repeated`` says that its uncertainties contain the differences of repeats.

    Raises:
        BenchError: the model has no solution for any of the observations.
    """
    settings = settings or DiagnosisSettings()
    with Workers(settings.jobs) as workers:
        return _Diagnoser(rig, observations, settings, progress or (lambda _: None), repeated, workers).run()


class _Diagnoser:
    def __init__(
        self,
        rig: Rig,
        observations: Observations,
        settings: DiagnosisSettings,
        progress: Progress,
        repeated: bool,
        workers: Workers,
    ) -> None:
        self.rig, self.observations, self.settings, self.progress = rig, observations, settings, progress
        self.repeated, self.workers = repeated, workers
        # Refits of the model and of the best explanations, by the rows that they were fitted to.
        self._known: dict[bytes, list[FittedModel | None]] = {}
        self.confidence: Confidence = confidence()
        self.splits = splits(observations, settings.hold_out)

    def run(self) -> DiagnosisOutcome:
        search = Search(self.rig, self.observations, self.settings, self.splits, self.progress, self.workers)
        null, scan, singles, pairs = search.run()
        self.observations, self.given = search.observations, search.given
        self.problem, self.judged, self.comparison = search.problem, search.judged, search.comparison
        self.progress("weighing the explanations")
        rig = null.fit.parametrisation.rig(null.fit.theta)
        found = places(search.forward, rig, null.fit.prediction, self.problem, self.workers)
        sources = generic_sources(null.fit, found)
        top = self._most_promising(null, singles, pairs)
        leftovers = generic_sources(top.fit, found, null.fit.theta.size) if top is not None else []
        left = (top or null).fit
        chance = min((test.p_holm for test in residual_tests(self.observations, left.residual, left.used)), default=1.0)
        judgement = judge(null, singles, pairs, sources, leftovers, search.candidates, self.confidence, top, chance)
        as_given = self.judged.residual(self.given)
        judged = [group.head for group in judgement.classes[: 1 if judgement.unknown > _HARDLY_NAMED else _JUDGED]]
        held = self._held(null, judged)
        without = self._left_out(null, judged)
        shares = {head.explanation: held.closed(head.explanation) for head in judged}
        judgement = with_held_out(judgement, held.worse(shares, 1.0 - self.confidence.explained))
        best_share = shares.get(judgement.classes[0].head.explanation) if judgement.classes else None
        tolerated = self._tolerated(best_share)
        mostly = best_share is not None and best_share.low > 1.0 - _UNSURE * tolerated
        if best_share is not None and mostly and best_share.value >= 1.0 - tolerated:
            judgement = with_share_left(judgement, min(max(1.0 - best_share.value, 0.0), 1.0))
        elif best_share is not None and best_share.before > _CLEAR * max(best_share.floor, 1.0):
            judgement = with_share_unexplained(judgement, min(max(1.0 - best_share.high, 0.0), 1.0))
        judgement = with_prior_conflict(judgement, prior_conflict(null), self.confidence)
        accepted = self._accepted(judgement, shares)
        verdict = self._verdict(judgement, accepted, self._recalibrated(null, as_given, held))
        named = accepted if verdict is Verdict.EFFECT else None
        best = null if named is None else self.comparison.fits.polished(named.head)
        gap, rest = self._gap(verdict, null, best, as_given, held, judgement.strained)
        ranking = ranked(judgement, shares, self.problem)
        where = place_shares(judgement, sources, verdict)
        self.progress("looking for the test that would decide")
        ahead = self._next(judgement, verdict, null)
        calibration = recalibrated(best, self.problem)
        tests = residual_tests(self.observations, best.fit.residual, best.fit.used)
        final = null if verdict is not Verdict.EFFECT else best
        model = self.rig if verdict is Verdict.NONE else final.fit.parametrisation.rig(final.fit.theta)
        leader = judgement.classes[0].head.explanation if judgement.classes else None
        warnings = warned(verdict, best, calibration, gap, accepted.members if accepted is not None else ())
        together = min(rms_left(own) for own in (null, *judged))
        warnings += tuple(filter(None, [contradiction(without, together)]))
        warnings += without_observables(self.observations)
        diagnosis = Diagnosis(
            verdict=verdict,
            sentences=(
                *sentences(verdict, where, ranking, leader, gap, ahead, calibration, rest, judgement.strained),
                *warnings,
            ),
            where=where,
            ranking=ranking,
            probabilities=judgement.by_label,
            gap=gap,
            next_test=ahead,
            calibration=calibration,
            inputs=inputs(self.observations, self.rig, self.splits, self.settings),
            notes=self.observations.notes + tuple(self.given.reasons),
            residual_map=residual_map(self.observations, as_given, self._left(null.fit), self._left(best.fit)),
            residual_tests=tuple(test.to_mapping() for test in tests),
            candidates=tuple(candidate_entry(fitted_model, null) for fitted_model in [null, *singles, *pairs]),
            features=feature_table(
                judgement, null, singles, pairs, scan, sources, leftovers, as_given, chance, search.candidates
            ),
            warnings=warnings,
            remainder=rest,
            left_out=without,
        )
        return DiagnosisOutcome(
            diagnosis,
            self.observations,
            self.rig,
            model,
            self.given.values,
            null.fit.prediction.values,
            final.fit.prediction.values,
        )

    def _most_promising(
        self, null: FittedModel, singles: Sequence[FittedModel], pairs: Sequence[FittedModel]
    ) -> FittedModel | None:
        """The explanation to look behind; None where none beats the plain model: then there is nothing behind it."""
        if not singles or singles[0].fit.log_evidence <= null.fit.log_evidence + _HELPS:
            return None
        second = pairs and pairs[0].fit.log_evidence > singles[0].fit.log_evidence + _SECOND
        return pairs[0] if second else singles[0]

    def _held(self, null: FittedModel, heads: Sequence[FittedModel]) -> HeldOut:
        """Everything that competes to the end, re-fitted without what each split holds out."""
        judged = None if self.judged is self.problem else self.judged
        if self.settings.hold_out:  # no fit has seen it
            own = {head.explanation: head for head in heads}
            unseen: list[Refits] = [(split, null, own) for split in self.splits]
            return HeldOut(self.observations, unseen, self.settings.seed, self.repeated, judged)
        found: list[Refits] = []
        wanted = [(own, split.fitted) for split in self.splits for own in (null, *heads)]
        refits = self.comparison.all_refits(wanted)
        self._known = {
            split.fitted.tobytes(): refits[number * (len(heads) + 1) :][: len(heads) + 1]
            for number, split in enumerate(self.splits)
        }
        for split in self.splits:
            base, *tops = self._known[split.fitted.tobytes()]
            if base is not None:
                found.append((split, base, {head.explanation: top for head, top in zip(heads, tops, strict=True)}))
        return HeldOut(self.observations, found, self.settings.seed, self.repeated, judged)

    def _left_out(self, null: FittedModel, heads: Sequence[FittedModel]) -> tuple[LeftOut, ...]:
        """What the other recordings say without each; splits by whole tests have most of the fits already."""
        found = recordings(self.observations)
        if len(found) < 2 or self.settings.hold_out:
            return ()
        missing = [recording for recording in found if (~recording.rows).tobytes() not in self._known]
        wanted = [(own, ~recording.rows) for recording in missing for own in (null, *heads)]
        refits = self.comparison.all_refits(wanted)
        for number, recording in enumerate(missing):
            self._known[(~recording.rows).tobytes()] = refits[number * (len(heads) + 1) :][: len(heads) + 1]
        each = [left_out(recording, self._known[(~recording.rows).tobytes()]) for recording in found]
        return tuple(item for item in each if item is not None)

    def _accepted(self, judgement: Judgement, shares: dict[Explanation, Closed]) -> ExplanationClass | None:
        """The most probable explanation that predicts held-out data no worse than the model without it.

        A little worse by chance is not worse: the blocks that are held out tell how much chance there is. Nor is what
        is worse by a small share of the gap: where held-out data hardly show it, any difference is that.
        """
        for group in judgement.classes[:_JUDGED]:
            share = shares.get(group.head.explanation)
            if share is None or not math.isfinite(share.gain) or share.gain >= -_CHANCE:
                return group
            if share.value >= self.confidence.explained - 1.0:
                return group
        return None

    def _verdict(
        self,
        judgement: Judgement,
        accepted: ExplanationClass | None,
        recalibrated: bool,
    ) -> Verdict:
        if judgement.log_odds < self.confidence.alarm:
            return Verdict.CALIBRATION if recalibrated else Verdict.NONE
        given_gap = judgement.unknown / max(1e-300, 1.0 - judgement.none)
        if accepted is None or judgement.unknown > accepted.probability:
            return Verdict.UNKNOWN
        return Verdict.UNKNOWN if given_gap > self.confidence.unknown else Verdict.EFFECT

    def _recalibrated(self, null: FittedModel, as_given: FloatArray, held: HeldOut) -> bool:
        """Whether re-fitting the model's own parameters closed a gap that was there, also on data that no fit saw."""
        start = self.problem.residual(self.given)
        used = null.fit.used & np.isfinite(start)
        fall = float(start[used] @ start[used]) - null.fit.chi_square - null.fit.penalty
        unseen = held.closed(null.explanation, as_given).gain
        return fall > self.confidence.recalibration and not unseen < 0.0

    def _gap(
        self,
        verdict: Verdict,
        null: FittedModel,
        best: FittedModel,
        as_given: FloatArray,
        held: HeldOut,
        strained: bool,
    ) -> tuple[Gap, Remainder | None]:
        """The gap, and what an accepted explanation, or the model's own parameters, leave of it."""
        given = verdict is Verdict.CALIBRATION or (verdict is Verdict.UNKNOWN and strained)
        whole = held.closed(best.explanation, as_given if given else None)
        rows, start, after = held.pooled(null, best, as_given if given else None)
        before, left = whole.before, whole.after
        if not math.isfinite(before):  # no split tells the explanation: by the fits themselves
            start, after = self._left(null.fit), self._left(best.fit)
            before, left = rms(start[rows]), rms(after[rows])
        gap = Gap(
            before,
            left,
            whole.floor,
            rms(as_given[rows] / held.scale(rows)),
            whole.value,
            whole.low,
            whole.high,
            per_observable(self.observations, start, after, rows),
            held.splits,
        )
        return gap, remainder(self.observations, gap, after, rows) if verdict is Verdict.EFFECT else None

    def _tolerated(self, share: Closed | None) -> float:
        """Share of the gap that an explanation may leave and still be what the gap is made of.

        A laboratory's rig differs from its model by more than one thing, which a gap far beyond the noise shows; the
        bench's own simulator only as it was told.
        """
        strict = 1.0 - self.confidence.explained
        if share is None or not share.before > _STRONG * max(share.floor, 1.0):
            return strict
        return max(_REMAINDER, strict) if elsewhere(self.observations) else strict

    def _left(self, found: Fit) -> FloatArray:
        """Residual of a fit as the gap counts it, smooth errors of the model included, shape (m,)."""
        return found.residual if self.judged is self.problem else self.judged.residual(found.prediction)

    def _next(self, judgement: Judgement, verdict: Verdict, null: FittedModel) -> tuple[NextTest, ...]:
        if not self.settings.look_ahead or verdict in (Verdict.NONE, Verdict.CALIBRATION):
            return ()
        return next_tests(self.rig, self.observations, null, judgement.classes, self.workers, none=judgement.none)
