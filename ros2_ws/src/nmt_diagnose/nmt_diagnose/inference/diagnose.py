"""The whole diagnosis: from bags and a rig file to a verdict."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.blocks import FloatArray
from nmt_core.errors import BenchError
from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.effects.library import candidates as library_candidates
from nmt_diagnose.effects.placement import Explanation, joined
from nmt_diagnose.evidence.conditions import RecordTest
from nmt_diagnose.evidence.observables import Evidence
from nmt_diagnose.evidence.read_evidence import read_evidence
from nmt_diagnose.inference.chain_errors import with_chain_errors
from nmt_diagnose.inference.confidence import Confidence, confidence, confidence_digest
from nmt_diagnose.inference.contest import Contender, Contest, ContestSettings
from nmt_diagnose.inference.diagnosis import (
    Diagnosis,
    Gap,
    NextTest,
    PlaceShare,
    Ranked,
    Recalibrated,
    Share,
    Value,
    Verdict,
)
from nmt_diagnose.inference.fit import FitError
from nmt_diagnose.inference.gap import Closed, rms
from nmt_diagnose.inference.generic_source import SourceScore
from nmt_diagnose.inference.held_out import splits
from nmt_diagnose.inference.held_out_contest import HeldOut, Refits
from nmt_diagnose.inference.hypotheses import NULL
from nmt_diagnose.inference.judgement import ExplanationClass, Judgement, judge, with_held_out, with_share_left
from nmt_diagnose.inference.lock_noise import lock_nuisances
from nmt_diagnose.inference.next_test import next_tests
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.inference.residual_map import per_observable, residual_map
from nmt_diagnose.inference.residual_tests import residual_tests
from nmt_diagnose.inference.scatter import scatter_floor
from nmt_diagnose.inference.sentences import sentences
from nmt_diagnose.inference.sources import generic_sources, places
from nmt_diagnose.inference.warnings import warned
from nmt_diagnose.twin.forward import Forward
from nmt_diagnose.twin.operating_range import operating_range
from nmt_rig.rig import Rig, load_rig

Progress = Callable[[str], None]
_RANKED = 8
_JUDGED = 3
_HELPS = 2.0
_CHANCE = 1.0
# ln of the evidence from which an effect moves the solution so far that errors of the measuring chain act otherwise.
_MOVES = 50.0
_SECOND = 8.0  # ln of what a second effect costs in prior, among some hundred candidates


@dataclass(frozen=True)
class DiagnosisSettings:
    """How a diagnosis goes about.

    Attributes:
        withheld: effects that are left out of the library.
        contest: how far the contest of explanations goes.
        seed: of the bootstrap.
        look_ahead: whether tests that would decide between what is left are sought.
        hold_out: names of tests (or of their bags) that no fit sees and the gap is judged by; empty = levels and whole
            tests in turn.
    """

    withheld: tuple[str, ...] = ()
    contest: ContestSettings = field(default_factory=ContestSettings)
    seed: int = 0
    look_ahead: bool = True
    hold_out: tuple[str, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """A diagnosis and what a report draws.

    Attributes:
        diagnosis: the result.
        evidence: the real side.
        given: the model as given.
        model: the model with its parameters re-fitted and the accepted effect added; the given one where there is no
            gap.
        as_given, refitted, final: observables of the given model, of the re-fitted one and of ``model``, (m,).
    """

    diagnosis: Diagnosis
    evidence: Evidence
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
) -> Outcome:
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
    evidence = read_evidence(bags, rig, floor_bags, progress=progress)
    return diagnose_evidence(rig, evidence, settings, progress, bool(floor_bags))


def diagnose_evidence(
    rig: Rig,
    evidence: Evidence,
    settings: DiagnosisSettings | None = None,
    progress: Progress | None = None,
    repeated: bool = False,
) -> Outcome:
    """Diagnose evidence that has been read already; see :func:`diagnose_bags`.

    ``repeated`` says that its uncertainties contain the differences of repeats.

    Raises:
        BenchError: the model has no solution for any of the evidence.
    """
    return _Diagnoser(rig, evidence, settings or DiagnosisSettings(), progress or (lambda _: None), repeated).run()


class _Diagnoser:
    def __init__(
        self, rig: Rig, evidence: Evidence, settings: DiagnosisSettings, progress: Progress, repeated: bool
    ) -> None:
        self.rig, self.evidence, self.settings, self.progress = rig, evidence, settings, progress
        self.repeated = repeated
        self.confidence: Confidence = confidence()
        self.splits = splits(evidence, settings.hold_out)
        self.forward = Forward(evidence.tests, evidence.rows)
        self.given = self.forward.predict(rig)
        nuisances = lock_nuisances(evidence, rig, self.given)
        self.plain = Problem(evidence, self.forward, nuisances)
        self.problem = with_chain_errors(self.plain, rig, self.given)
        self.evidence = self.problem.evidence
        self.candidates = library_candidates(
            rig, operating_range(rig, evidence.tests, evidence=evidence), settings.withheld
        )
        self.contest = self._contest()

    def _contest(self) -> Contest:
        return Contest(
            self.problem,
            self.rig,
            calibration_parameters(self.rig),
            self.candidates,
            _affordable(self.settings.contest, self.evidence),
            self.progress,
            self.splits[0].fitted if self.settings.hold_out else None,
        )

    def run(self) -> Outcome:
        self.progress("re-fitting the model's own parameters")
        given = self.given
        try:
            null = self.contest.polished(self.contest.null())
        except FitError as error:
            raise BenchError(f"The model cannot be compared with the evidence: {error}.") from error
        self.progress(f"scanning {len(self.candidates)} candidates")
        scan = self.contest.scan(null)
        singles = self.contest.singles(null, scan)
        better = self.contest.restarted(null, singles[:2])
        if better is not null:
            self.progress("starting anew from a better fit of the model")
            null = better
            scan = self.contest.scan(null)
            singles = self.contest.singles(null, scan)
        if self.problem.shared is not None and self._retraced(null, singles):
            null = self.contest.polished(self.contest.null())
            scan = self.contest.scan(null)
            singles = self.contest.singles(null, scan)
        singles, pairs = self.contest.pruned(singles, self.contest.pairs(singles))
        self.progress("weighing the explanations")
        rig = null.fit.parametrisation.rig(null.fit.theta)
        found = places(self.forward, rig, null.fit.prediction, self.problem)
        sources = generic_sources(null.fit, found)
        top = self._most_promising(null, singles, pairs)
        leftovers = generic_sources(top.fit, found, null.fit.theta.size) if top is not None else []
        left = (top or null).fit
        chance = min((test.p_holm for test in residual_tests(self.evidence, left.residual, left.used)), default=1.0)
        judgement = judge(null, singles, pairs, sources, leftovers, self.candidates, self.confidence, top, chance)
        as_given = self.problem.residual(given)
        held = self._held(null, [group.head for group in judgement.classes[:_JUDGED]])
        heads = [group.head.explanation for group in judgement.classes[:_JUDGED]]
        shares = {explanation: held.closed(explanation) for explanation in heads}
        judgement = with_held_out(judgement, held.worse(shares, 1.0 - self.confidence.explained))
        best_share = shares.get(judgement.classes[0].head.explanation) if judgement.classes else None
        if best_share is not None and best_share.low > 0.9 and best_share.value >= self.confidence.explained:
            judgement = with_share_left(judgement, min(max(1.0 - best_share.value, 0.0), 1.0))
        accepted = self._accepted(judgement, shares)
        verdict = self._verdict(judgement, accepted, self._recalibrated(null, as_given, held))
        best = self.contest.polished(accepted.head) if accepted is not None and verdict is Verdict.EFFECT else null
        gap = self._gap(verdict, null, best, as_given, held)
        ranking = self._ranking(judgement, shares)
        where = self._where(judgement, sources, verdict)
        self.progress("looking for the test that would decide")
        ahead = self._next(judgement, verdict, null)
        calibration = self._calibration(best)
        tests = residual_tests(self.evidence, best.fit.residual, best.fit.used)
        final = null if verdict is not Verdict.EFFECT else best
        model = self.rig if verdict is Verdict.NONE else final.fit.parametrisation.rig(final.fit.theta)
        warnings = warned(verdict, best, calibration, gap)
        diagnosis = Diagnosis(
            verdict=verdict,
            sentences=(*sentences(verdict, where, ranking, judgement.classes, gap, ahead, calibration), *warnings),
            where=where,
            ranking=ranking,
            probabilities=judgement.by_label,
            gap=gap,
            next_test=ahead,
            calibration=calibration,
            inputs=self._inputs(),
            notes=self.evidence.notes + tuple(given.reasons),
            residual_map=residual_map(self.evidence, as_given, null.fit.residual, best.fit.residual),
            residual_tests=tuple(test.to_mapping() for test in tests),
            candidates=tuple(self._candidate(contender, null) for contender in [null, *singles, *pairs]),
            features=self._features(judgement, null, singles, pairs, scan, sources, leftovers, as_given, chance),
            warnings=warnings,
        )
        return Outcome(
            diagnosis,
            self.evidence,
            self.rig,
            model,
            given.values,
            null.fit.prediction.values,
            final.fit.prediction.values,
        )

    def _retraced(self, null: Contender, singles: Sequence[Contender]) -> bool:
        """Whether errors of the measuring chain and scatter were traced anew, about the best explanation so far."""
        moves = bool(singles) and singles[0].fit.log_evidence > null.fit.log_evidence + _MOVES
        near = singles[0].fit if moves else null.fit
        scatter = scatter_floor(self.evidence, self.plain.difference(near.prediction.values))
        if not moves and not scatter.any():
            return False
        self.progress("tracing errors of the measuring chain about the best explanation")
        moved = near.parametrisation.rig(near.theta)
        self.problem = with_chain_errors(self.plain, moved, near.prediction, scatter)
        self.evidence = self.problem.evidence
        self.contest = self._contest()
        return True

    def _most_promising(
        self, null: Contender, singles: Sequence[Contender], pairs: Sequence[Contender]
    ) -> Contender | None:
        """The explanation to look behind; None where none beats the plain model: then there is nothing behind it."""
        if not singles or singles[0].fit.log_evidence <= null.fit.log_evidence + _HELPS:
            return None
        second = pairs and pairs[0].fit.log_evidence > singles[0].fit.log_evidence + _SECOND
        return pairs[0] if second else singles[0]

    # -- judging -------------------------------------------------------------------------------------------------

    def _held(self, null: Contender, heads: Sequence[Contender]) -> HeldOut:
        """Everything that competes to the end, re-fitted without what each split holds out."""
        found: list[Refits] = []
        for split in self.splits:
            if self.settings.hold_out:
                found.append((split, null, {head.explanation: head for head in heads}))
                continue  # no fit has seen it
            base = self.contest.refit(null, split.fitted)
            if base is not None:
                tops = {head.explanation: self.contest.refit(head, split.fitted) for head in heads}
                found.append((split, base, tops))
        return HeldOut(self.evidence, found, self.settings.seed, self.repeated)

    def _accepted(self, judgement: Judgement, shares: dict[Explanation, Closed]) -> ExplanationClass | None:
        """The most probable explanation that predicts held-out data no worse than the model without it.

        A little worse by chance is not worse: the blocks that are held out tell how much chance there is.
        """
        for group in judgement.classes[:_JUDGED]:
            share = shares.get(group.head.explanation)
            if share is None or not math.isfinite(share.gain) or share.gain >= -_CHANCE:
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
        if accepted is None:
            return Verdict.UNKNOWN
        return Verdict.UNKNOWN if given_gap > self.confidence.unknown else Verdict.EFFECT

    def _recalibrated(self, null: Contender, as_given: FloatArray, held: HeldOut) -> bool:
        """Whether re-fitting the model's own parameters closed a gap that was there, also on data that no fit saw."""
        used = null.fit.used & np.isfinite(as_given)
        fall = float(as_given[used] @ as_given[used]) - null.fit.chi_square - null.fit.penalty
        unseen = held.closed(null.explanation, as_given).gain
        return fall > self.confidence.recalibration and not unseen < 0.0

    def _gap(self, verdict: Verdict, null: Contender, best: Contender, as_given: FloatArray, held: HeldOut) -> Gap:
        given = verdict is Verdict.CALIBRATION
        whole = held.closed(best.explanation, as_given if given else None)
        rows, start, after = held.pooled(null, best, as_given if given else None)
        # Without a split that tells the explanation, by the fits themselves.
        judged = math.isfinite(whole.before)
        return Gap(
            whole.before if judged else rms(null.fit.residual[rows]),
            whole.after if judged else rms(best.fit.residual[rows]),
            whole.floor,
            rms(as_given[rows] / held.scale(rows)),
            whole.value,
            whole.low,
            whole.high,
            per_observable(self.evidence, start, after, rows),
            held.splits,
        )

    # -- telling -------------------------------------------------------------------------------------------------

    def _ranking(self, judgement: Judgement, shares: dict[Explanation, Closed]) -> tuple[Ranked, ...]:
        result = []
        for group in judgement.classes[:_RANKED]:
            head = group.head
            placements = head.explanation.placements
            share = shares.get(head.explanation)
            result.append(
                Ranked(
                    effect=joined(cause.effect for cause in head.explanation.causes),
                    place=head.explanation.kinds,
                    detail=joined(placement.detail for placement in placements if placement.detail),
                    probability=group.probability,
                    equivalents=tuple(joined(effects) for effects in group.effects[1:]),
                    parameters=_parameters(head),
                    closed=Share(share.value, share.low, share.high) if share else Share(*[math.nan] * 3),
                    sigmas=head.sigmas,
                    converged=head.fit.converged,
                )
            )
        return tuple(result)

    def _where(self, judgement: Judgement, sources: Sequence[SourceScore], verdict: Verdict) -> tuple[PlaceShare, ...]:
        if verdict in (Verdict.NONE, Verdict.CALIBRATION):
            return ()
        by_place: dict[str, float] = {}
        details: dict[str, dict[str, float]] = {}
        for placement, p in judgement.places.items():
            kind, own = placement.kind, details.setdefault(placement.kind, {})
            by_place[kind] = by_place.get(kind, 0.0) + p
            own[placement.detail] = own.get(placement.detail, 0.0) + p
        explained: dict[str, float] = {}
        for source in sources:
            size = max(0.0, source.explained - source.freedom)
            kind = source.placement.kind
            explained[kind] = max(explained.get(kind, 0.0), size)
        weights = {place: explained.get(place, 0.0) * p for place, p in by_place.items()}
        total = sum(weights.values())
        return tuple(
            PlaceShare(place, _likeliest(details[place]), weights[place] / total if total > 0.0 else p, p)
            for place, p in sorted(by_place.items(), key=lambda item: -item[1])
            if p > 0.005
        )

    def _calibration(self, best: Contender) -> tuple[Recalibrated, ...]:
        parametrisation = best.fit.parametrisation
        result = []
        for k, parameter in enumerate(parametrisation.calibration):
            theta, std = float(best.fit.theta[k]), float(best.fit.std[k])
            value = parameter.at(theta)
            result.append(
                Recalibrated(
                    parameter.name,
                    parameter.value,
                    value,
                    abs(value + parameter.offset) * parameter.std * std * best.fit.scatter,
                    parameter.unit,
                    parameter.std,
                    theta / std if std > 0.0 else 0.0,
                )
            )
        return tuple(result)

    def _next(self, judgement: Judgement, verdict: Verdict, null: Contender) -> tuple[NextTest, ...]:
        if not self.settings.look_ahead or verdict in (Verdict.NONE, Verdict.CALIBRATION):
            return ()
        return next_tests(self.rig, self.evidence, null, judgement.classes, self.contest, none=judgement.none)

    def _inputs(self) -> dict[str, Any]:
        tests = []
        for number, test in enumerate(self.evidence.tests):
            mine = self.evidence.rows.test == number
            tests.append(
                {
                    "name": test.name,
                    "kind": type(test).__name__,
                    "drive_point": test.drive_point,
                    "levels": int(np.unique(self.evidence.rows.level[mine]).size),
                    "observables": int(mine.sum()),
                }
            )
        return {
            "bags": [{"path": path, "sha256": digest} for path, digest in self.evidence.inputs],
            "tests": tests,
            "held_out": [split.name for split in self.splits],
            "model": self.rig.name,
            "withheld": list(self.settings.withheld),
            "seed": self.settings.seed,
            "confidence_sha256": confidence_digest(),
        }

    def _candidate(self, contender: Contender, null: Contender) -> dict[str, Any]:
        return {
            "label": contender.explanation.label,
            "effect": joined(contender.effects) or NULL,
            "place": contender.explanation.kinds,
            "chi_square": contender.fit.chi_square,
            "penalty": contender.fit.penalty,
            "rows": int(contender.fit.used.sum()),
            "parameters": int(contender.fit.theta.size - null.fit.theta.size),
            "log_evidence": contender.fit.log_evidence - null.fit.log_evidence,
            "sigmas": contender.sigmas,
            "converged": contender.fit.converged,
        }

    def _features(
        self,
        judgement: Judgement,
        null: Contender,
        singles: Sequence[Contender],
        pairs: Sequence[Contender],
        scan: Sequence[Any],
        sources: Sequence[SourceScore],
        leftovers: Sequence[SourceScore],
        as_given: FloatArray,
        chance: float,
    ) -> dict[str, float]:
        """Numbers from which verdicts follow; baselines are trained on them."""
        used = null.fit.used & np.isfinite(as_given)
        best = singles[0].fit if singles else null.fit
        found = {
            "rows": float(null.fit.used.sum()),
            "chi_square_given": float(as_given[used] @ as_given[used]),
            "chi_square_null": null.fit.chi_square,
            "penalty_null": null.fit.penalty,
            "chi_square_best": best.chi_square,
            "log_evidence_best": best.log_evidence - null.fit.log_evidence,
            "log_evidence_second": singles[1].fit.log_evidence - null.fit.log_evidence if len(singles) > 1 else 0.0,
            "log_evidence_pair": pairs[0].fit.log_evidence - null.fit.log_evidence if pairs else 0.0,
            "scan_best": scan[0].gain if scan else 0.0,
            "source_best": max((source.gain for source in sources), default=0.0),
            "leftover_best": max((source.gain for source in leftovers), default=0.0),
            "none": judgement.none,
            "unknown": judgement.unknown,
            "chance": chance,
            **{f"sign:{name}": value for name, value in judgement.signs.items()},
        }
        for name in dict.fromkeys(self.candidates[score.direction.candidate].effect.name for score in scan):
            gains = [s.gain for s in scan if self.candidates[s.direction.candidate].effect.name == name]
            found[f"scan:{name}"] = max(gains)
        for source in sources:
            key = f"source:{source.placement.kind}"
            found[key] = max(found.get(key, -math.inf), source.gain)
        return found


def _affordable(settings: ContestSettings, evidence: Evidence) -> ContestSettings:
    """A record is stepped through sample by sample, a hundred times as dear as a locked level: fewer fits."""
    if not any(isinstance(test, RecordTest) for test in evidence.tests):
        return settings
    return replace(
        settings,
        finalists=min(settings.finalists, 4),
        placements=min(settings.placements, 1),
        first_of_pairs=min(settings.first_of_pairs, 1),
        settled=min(settings.settled, 3),
        rounds=min(settings.rounds, 2),
        restarts=False,
    )


def _likeliest(details: dict[str, float]) -> str:
    """The likeliest detail of a place, or several where one is hardly less likely than the other."""
    best = max(details.values())
    return joined(sorted(what for what, p in details.items() if what and p > 0.6 * best))


def _parameters(contender: Contender) -> dict[str, Value]:
    """Reported parameters of a contender with standard uncertainties, carried through by differences."""
    parametrisation = contender.fit.parametrisation
    theta, std = contender.fit.theta, contender.fit.std
    result: dict[str, Value] = {}
    several = len(contender.candidates) > 1
    for index, candidate in enumerate(contender.candidates):
        own = parametrisation.index_of(index)
        for name, (value, unit) in parametrisation.reported(theta, index).items():
            variance = 0.0
            for k in range(own.start, own.stop):
                moved = theta.copy()
                moved[k] += 0.1 * std[k]
                change = parametrisation.reported(moved, index)[name][0] - value
                variance += (10.0 * change) ** 2 if math.isfinite(change) else math.inf
            result[f"{candidate.label}.{name}" if several else name] = Value(
                value, math.sqrt(variance) * contender.fit.scatter, unit
            )
    return result
