"""The whole diagnosis: from bags and a rig file to a verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.blocks import FloatArray
from nmt_core.errors import BenchError
from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.effects.library import candidates as library_candidates
from nmt_diagnose.effects.placement import Explanation, joined
from nmt_diagnose.inference.chain_errors import chain_errors, sweep_directions, with_chain_errors, with_shared
from nmt_diagnose.inference.confidence import Confidence, confidence, confidence_digest
from nmt_diagnose.inference.diagnosis import (
    Diagnosis,
    Gap,
    LeftOut,
    NextTest,
    PlaceShare,
    Ranked,
    Recalibrated,
    Remainder,
    Share,
    Value,
    Verdict,
)
from nmt_diagnose.inference.discrepancy import measured_elsewhere, smooth_errors
from nmt_diagnose.inference.fit import Fit, FitError, fit
from nmt_diagnose.inference.fitted_model import FittedModel, rms_left
from nmt_diagnose.inference.gap import Closed, rms
from nmt_diagnose.inference.generic_source import SourceScore
from nmt_diagnose.inference.held_images import (
    ImageOptions,
    image_options,
    may_hold_images,
    same_images,
    with_detected_images,
)
from nmt_diagnose.inference.held_out import splits
from nmt_diagnose.inference.held_out_comparison import HeldOut, Refits
from nmt_diagnose.inference.hypotheses import NULL
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
from nmt_diagnose.inference.lock_noise import lock_nuisances
from nmt_diagnose.inference.model_comparison import ComparisonSettings, ModelComparison
from nmt_diagnose.inference.motion_scale import covariance_with_scale
from nmt_diagnose.inference.next_test import next_tests
from nmt_diagnose.inference.prior_conflict import prior_conflict
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.inference.progress import Progress
from nmt_diagnose.inference.remainder import remainder
from nmt_diagnose.inference.residual_map import per_observable, residual_map
from nmt_diagnose.inference.residual_tests import residual_tests
from nmt_diagnose.inference.sampling_moment import with_better_moment
from nmt_diagnose.inference.scan import Score
from nmt_diagnose.inference.scatter import scatter_floor
from nmt_diagnose.inference.sentences import sentences
from nmt_diagnose.inference.sources import generic_sources, places
from nmt_diagnose.inference.sweep_drift import sweep_drift
from nmt_diagnose.inference.true_phase import LEAST_CHANGE, at_true_phases, chain_share, phase_offset, with_phases_of
from nmt_diagnose.inference.warnings import warned
from nmt_diagnose.inference.workers import Workers
from nmt_diagnose.observations.conditions import BackboneTable, RecordTest, RingDownTest, SteppedSineTest
from nmt_diagnose.observations.observables import Observations, Part
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.observations.read_observations import read_observations
from nmt_diagnose.twin.forward import Forward, Prediction, traced
from nmt_diagnose.twin.operating_range import operating_range
from nmt_record.calibration_file import CalibrationSheet
from nmt_rig.rig import Rig, load_rig

# Most times that the moment at which a held random test was sampled is corrected.
_MOMENTS = 8
_RANKED = 8
_JUDGED = 3
# Probability of something unnamed from which other than the nearest explanations are not fitted to held-out data.
_HARDLY_NAMED = 0.97
_HELPS = 2.0
_CHANCE = 1.0
# ln of the evidence from which an effect moves the solution so far that errors of the measuring chain act otherwise.
_MOVES = 50.0
_OF_OBSERVATIONS = ("forward", "given", "plain", "problem", "observations", "judged", "comparison")
_GOOD = 1.5  # rms of residuals of a model that may tell whether images of a held drive are there
_PHASES = 3  # most times that the phases of locked windows are corrected
_NOISE = 1.05  # rms of residuals that may be noise
_TRACED, _SETTLED = 3, 0.3  # most times that they are traced anew, and change in standard deviations that ends it
# Share of the gap of a laboratory's tests that a named effect may leave, and by how many times as much its interval may
# fall short.
_REMAINDER, _UNSURE = 0.15, 3.0
_SECONDS = 6
# Leading elastic or dissipative effects that are tried with all of the other kind.
_PARTNERS = 1
# Gap over the noise (rms) from which what is left of it is a share of the effect rather than an effect of its own.
_STRONG = 10.0
# From here on the share of it that an explanation closes says whether that is what the gap is made of.
_CLEAR = 2.0
_SECOND = 8.0  # ln of what a second effect costs in prior, among some hundred candidates


@dataclass(frozen=True)
class DiagnosisSettings:
    """How a diagnosis goes about.

    Attributes:
        withheld: effects that are left out of the library.
        comparison: how far the comparison of explanations goes.
        seed: of the bootstrap.
        look_ahead: whether tests that would decide between what is left are sought.
        hold_out: names of tests (or of their bags) that no fit sees and the gap is judged by; empty = levels and whole
            tests in turn.
        jobs: processes that share the work; the result is the same for any number.
        allow_own_model: take recordings that the model itself made for a real side, too.
        calibration: sheet of the measuring chain of the real side; None = what its bags say.
    """

    withheld: tuple[str, ...] = ()
    comparison: ComparisonSettings = field(default_factory=ComparisonSettings)
    seed: int = 0
    look_ahead: bool = True
    hold_out: tuple[str, ...] = ()
    jobs: int = 1
    allow_own_model: bool = False
    calibration: CalibrationSheet | None = None


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
        self.forward = Forward(observations.tests, observations.rows)
        self.given = self.forward.predict(rig)
        self.plain = self._plain(self.given)
        self._undetected = self.plain.observations
        self.problem = with_chain_errors(self.plain, rig, self.given)
        self.judged = self.problem
        self.observations = self.problem.observations
        self.candidates = library_candidates(
            rig, operating_range(rig, observations.tests, observations=observations), settings.withheld
        )
        self.comparison = self._comparison()

    @property
    def elsewhere(self) -> bool:
        """Whether any test was not made by the bench's own simulator."""
        return any(measured_elsewhere(self.observations, number) for number in range(len(self.observations.tests)))

    def _plain(self, near: Prediction, offset: FloatArray | None = None) -> Problem:
        """Observations and model, with the noise of measured amplitudes propagated about a solution."""
        tests = traced(self.observations.tests, near)
        if any(new is not old for new, old in zip(tests, self.observations.tests, strict=True)):
            self.observations = replace(self.observations, tests=tests)
            self.forward = Forward(tests, self.observations.rows)
            self.given = self.forward.predict(self.rig, near if near is self.given else self.given)
        noise = lock_nuisances(self.observations, self.rig, self.given)
        return Problem(self.observations, self.forward, noise, offset=offset)

    def _comparison(self) -> ModelComparison:
        return ModelComparison(
            self.problem,
            self.rig,
            calibration_parameters(self.rig),
            self.candidates,
            _affordable(self.settings.comparison, self.observations),
            self.progress,
            self.splits[0].fitted if self.settings.hold_out else None,
            self.workers,
        )

    def run(self) -> DiagnosisOutcome:
        null, scan, singles, pairs = self._searched()
        given = self.given
        self.progress("weighing the explanations")
        rig = null.fit.parametrisation.rig(null.fit.theta)
        found = places(self.forward, rig, null.fit.prediction, self.problem, self.workers)
        sources = generic_sources(null.fit, found)
        top = self._most_promising(null, singles, pairs)
        leftovers = generic_sources(top.fit, found, null.fit.theta.size) if top is not None else []
        left = (top or null).fit
        chance = min((test.p_holm for test in residual_tests(self.observations, left.residual, left.used)), default=1.0)
        judgement = judge(null, singles, pairs, sources, leftovers, self.candidates, self.confidence, top, chance)
        as_given = self.judged.residual(given)
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
        best = self.comparison.polished(accepted.head) if accepted is not None and verdict is Verdict.EFFECT else null
        gap, rest = self._gap(verdict, null, best, as_given, held, judgement.strained)
        ranking = self._ranking(judgement, shares)
        where = self._where(judgement, sources, verdict)
        self.progress("looking for the test that would decide")
        ahead = self._next(judgement, verdict, null)
        calibration = self._calibration(best)
        tests = residual_tests(self.observations, best.fit.residual, best.fit.used)
        final = null if verdict is not Verdict.EFFECT else best
        model = self.rig if verdict is Verdict.NONE else final.fit.parametrisation.rig(final.fit.theta)
        warnings = warned(verdict, best, calibration, gap, accepted.members if accepted is not None else ())
        together = min(rms_left(own) for own in (null, *judged))
        warnings += tuple(filter(None, [contradiction(without, together)]))
        diagnosis = Diagnosis(
            verdict=verdict,
            sentences=(
                *sentences(
                    verdict, where, ranking, judgement.classes, gap, ahead, calibration, rest, judgement.strained
                ),
                *warnings,
            ),
            where=where,
            ranking=ranking,
            probabilities=judgement.by_label,
            gap=gap,
            next_test=ahead,
            calibration=calibration,
            inputs=self._inputs(),
            notes=self.observations.notes + tuple(given.reasons),
            residual_map=residual_map(self.observations, as_given, self._left(null.fit), self._left(best.fit)),
            residual_tests=tuple(test.to_mapping() for test in tests),
            candidates=tuple(self._candidate(fitted_model, null) for fitted_model in [null, *singles, *pairs]),
            features=self._features(judgement, null, singles, pairs, scan, sources, leftovers, as_given, chance),
            warnings=warnings,
            remainder=rest,
            left_out=without,
        )
        return DiagnosisOutcome(
            diagnosis,
            self.observations,
            self.rig,
            model,
            given.values,
            null.fit.prediction.values,
            final.fit.prediction.values,
        )

    def _searched(self) -> tuple[FittedModel, list[Score], list[FittedModel], list[FittedModel]]:
        """The model alone, the scan about it, and explanations by one and by two effects, best first.

        Whatever changes on the way, the model alone or the noise, explanations that were good go on from where they
        stand: a scan about a solution that is wrong by many times the noise need not lead to them again.

        Raises:
            BenchError: the model has no solution for any of the observations.
        """
        self.progress("re-fitting the model's own parameters")
        try:
            null = self.comparison.polished(self.comparison.null())
        except FitError as error:
            raise BenchError(f"The model cannot be compared with the observations: {error}.") from error
        # At other phases than they were told locked windows contradict a random test, with images or without.
        null = self._with_true_phases(self._with_detected_images(self._with_true_phases(null)))
        self.progress(f"scanning {len(self.candidates)} candidates")
        known = self.comparison.from_below(null)
        scan = self.comparison.scan(null)
        singles, pairs = self.comparison.singles(null, scan, known), list[FittedModel]()
        better = self.comparison.restarted(null, singles[:2])
        if better is not null:
            self.progress("starting anew from a better fit of the model")
            null = better
            scan = self.comparison.scan(null)
            singles = self.comparison.singles(null, scan, singles)
        if self._amplitudes_measured:
            # The noise is traced about the best explanation: a wrong one would hide the right one behind its noise.
            singles, pairs = self.comparison.pruned(singles, self.comparison.pairs(singles))
        if self._retraced(null, self._leaders(singles, pairs)):
            null = self.comparison.polished(self.comparison.null())
            scan = self.comparison.scan(null)
            singles = self.comparison.singles(null, scan, singles)
        singles, pairs = self.comparison.pruned(singles, self.comparison.pairs(singles, pairs))
        if self._amplitudes_measured and self._leads(pairs, singles) and self._retraced(null, pairs):
            null = self.comparison.polished(self.comparison.null())
            scan = self.comparison.scan(null)
            singles = self.comparison.singles(null, scan, singles)
            singles, pairs = self.comparison.pruned(singles, self.comparison.pairs(singles, pairs))
        return null, scan, singles, pairs

    def _leaders(self, singles: Sequence[FittedModel], pairs: Sequence[FittedModel]) -> Sequence[FittedModel]:
        """The explanations by two effects where they lead, else those by one."""
        return pairs if pairs and singles and self._leads(pairs, singles) else singles

    def _retraced(self, null: FittedModel, singles: Sequence[FittedModel]) -> bool:
        """Whether errors of measuring chain and model and scatter were traced anew, about the best explanation so far.

        What the model of a strong effect is off by smoothly is noise to the comparison, and part of the stated gap.
        """
        if not self.elsewhere:
            return False
        moves = bool(singles) and singles[0].fit.log_evidence > null.fit.log_evidence + _MOVES
        near = self._with_images_of(singles[0]) if moves else null.fit
        near, stood = self._at_true_phases(near)
        difference = self.plain.difference(near.prediction.values)
        scatter = scatter_floor(self.observations, difference)
        drift = self._drift(near, difference)
        if not moves and not stood and not scatter.any() and drift == 0.0:
            return False
        self.progress("tracing errors of the measuring chain and of the best explanation")
        noisy, columns = self._trace(near, scatter, drift)
        for _ in range(_TRACED if self._amplitudes_measured else 0):
            # Near folds the noise of measured amplitudes depends much on the solution that it is propagated about.
            try:
                after = fit(self.problem, near.parametrisation, near.theta, near.used, near.prediction)
            except FitError:
                break
            settled = float(np.max(np.abs(after.theta - near.theta) / after.std, initial=0.0)) < _SETTLED
            near = after
            if settled:
                break
            drift = self._drift(near, self.plain.difference(near.prediction.values))
            noisy, columns = self._trace(near, scatter, drift)
        difference = self.plain.difference(near.prediction.values)
        smooth = np.zeros((len(self.observations.rows), 0))
        if moves:
            smooth = smooth_errors(self.observations, difference, self._done_by(near))
        if self.problem.shared is None and not scatter.any() and not smooth.any():
            return False
        self.judged = self.problem
        if smooth.any():
            self.problem = with_shared(noisy, np.hstack([columns, smooth]))
        self.comparison = self._comparison()
        return True

    def _with_detected_images(self, null: FittedModel) -> FittedModel:
        """The model alone after random tests showed whether images of a held drive are in them."""
        for last in (False, True):
            observations = self.plain.observations
            if not any(
                may_hold_images(test, own) for test, own in zip(observations.tests, observations.chains, strict=False)
            ):
                return null
            found = image_options(observations, null.fit.parametrisation.rig(null.fit.theta))
            if found.options and (found.sure or last):
                null = self._better_of(found, null)
            elif not last:
                # The nearer the model is, the clearer they show it.
                null = self._under(observations, null)
        return null

    def _better_of(self, found: ImageOptions, null: FittedModel) -> FittedModel:
        """The model alone under the observations, with images or without, that it fits better, if it fits one well.

        If it does not, the more credible observations count where that is clear, and those before where it is not.
        """
        before, fits, states = self.plain.observations, [], []
        for option in found.options:
            fits.append(self._with_better_moment(self._under(option, null)))
            states.append(self._state())
        best = int(np.argmax([own.fit.log_evidence for own in fits]))
        if not rms_left(fits[best]) < _GOOD:
            if not found.sure:
                return self._under(before, null)
            best = 0
        self._return_to(states[best])
        return fits[best]

    def _state(self) -> dict[str, Any]:
        """What taking other observations changes."""
        return {name: getattr(self, name) for name in _OF_OBSERVATIONS}

    def _return_to(self, state: Mapping[str, Any]) -> None:
        for name, value in state.items():
            setattr(self, name, value)

    def _with_better_moment(self, null: FittedModel) -> FittedModel:
        """The model alone where held random tests are taken as sampled at the moment that leaves least."""
        for _ in range(_MOMENTS):
            moved = with_better_moment(self.problem, null.fit)
            if moved is None:
                break
            null = self._under(moved, null, near=True)
        return null

    def _with_true_phases(self, null: FittedModel) -> FittedModel:
        """The model alone where locked windows are predicted at the phases that it tells together with the chain."""
        _, moved = self._at_true_phases(null.fit)
        if not moved:
            return null
        self.judged, self.comparison = self.problem, self._comparison()
        return self.comparison.polished(self.comparison.null())

    def _at_true_phases(self, near: Fit) -> tuple[Fit, bool]:
        """A fit with the locked windows at the phases that it tells, if it is good; whether they moved."""
        moved = False
        for _ in range(_PHASES if self.elsewhere else 0):
            if near.chi_square > _GOOD**2 * max(1, int(near.used.sum())):
                break
            rig = near.parametrisation.rig(near.theta)
            noisy, columns = chain_errors(self.plain, rig, near.prediction)
            share = chain_share(noisy, columns, self.plain.difference(near.prediction.values))
            found, change = at_true_phases(self.plain.observations, rig, near.prediction, share)
            if change < LEAST_CHANGE:
                break
            kept = self.forward, self.given, self.plain, self.problem, self.observations
            self._observe(found)
            prediction = self.forward.predict(rig, near.prediction)
            self.plain = replace(self.plain, offset=phase_offset(found, rig, prediction))
            self._trace(replace(near, prediction=prediction), np.zeros(len(found.rows)), 0.0)
            try:
                near = fit(self.problem, near.parametrisation, near.theta, near.used, prediction)
            except FitError:
                self.forward, self.given, self.plain, self.problem, self.observations = kept
                break
            moved = True
            self._undetected = with_phases_of(self._undetected, found)
        return near, moved

    def _with_images_of(self, leader: FittedModel) -> Fit:
        """The fit of an explanation after random tests showed, about it, whether images of a held drive are in them.

        The model alone may be so far off that it takes what an effect does for images. What is left of the fit must not
        grow by it, or be noise.
        """
        near = leader.fit
        options = [
            option
            for option in with_detected_images(self._undetected, near.parametrisation.rig(near.theta))
            if not same_images(option, self.plain.observations)
        ]
        best, least = near, max(rms_left(leader), _NOISE)
        kept = self.forward, self.given, self.plain, self.problem, self.observations
        for option in options:
            self._observe(option)
            prediction = self.forward.predict(near.parametrisation.rig(near.theta), near.prediction)
            self._trace(replace(near, prediction=prediction), np.zeros(len(self.observations.rows)), 0.0)
            with suppress(FitError):
                found = fit(self.problem, near.parametrisation, near.theta, near.used, prediction)
                left = rms_left(replace(leader, fit=found))
                if left <= least:
                    best, least = found, left
                    kept = self.forward, self.given, self.plain, self.problem, self.observations
        self.forward, self.given, self.plain, self.problem, self.observations = kept
        return best

    def _observe(self, observations: Observations) -> None:
        """Take other conditions of the tests for the real side."""
        self.forward = Forward(observations.tests, observations.rows)
        self.given = self.forward.predict(self.rig, self.given)
        self.plain = replace(self.plain, observations=observations, forward=self.forward)

    def _under(self, observations: Observations, null: FittedModel, near: bool = False) -> FittedModel:
        """The model alone, re-fitted to observations of other chains, its errors traced about what it was.

        Where it is ``near`` the new optimum the fit goes on from it.
        """
        self._observe(observations)
        self._trace(null.fit, np.zeros(len(observations.rows)), 0.0)
        self.judged, self.comparison = self.problem, self._comparison()
        return self.comparison.polished(self.comparison.null(start=null.fit if near else None))

    @property
    def _amplitudes_measured(self) -> bool:
        """Whether noise is propagated by the solution: frequency responses at held amplitudes."""
        return any(isinstance(test, SteppedSineTest) for test in self.observations.tests)

    @staticmethod
    def _leads(pairs: Sequence[FittedModel], singles: Sequence[FittedModel]) -> bool:
        """Whether two effects move the solution far from that of one."""
        return bool(pairs) and pairs[0].fit.log_evidence > singles[0].fit.log_evidence + _MOVES

    def _drift(self, near: Fit, difference: FloatArray) -> float:
        """Relative standard deviation of the resonance from sweep to sweep, about a fit."""
        rig = near.parametrisation.rig(near.theta)
        observations = self.plain.observations
        return sweep_drift(observations, difference, sweep_directions(observations, rig, near.prediction))

    def _trace(self, near: Fit, scatter: FloatArray, drift: float) -> tuple[Problem, FloatArray]:
        """Noise of measured amplitudes and errors of the measuring chain as they act about a fit: see chain_errors."""
        self.observations = self.plain.observations
        self.plain = self._plain(near.prediction, self.plain.offset)
        moved = near.parametrisation.rig(near.theta)
        noisy, columns = chain_errors(self.plain, moved, near.prediction, scatter, drift)
        self.problem = with_shared(noisy, columns)
        self.observations = self.problem.observations
        return noisy, columns

    def _done_by(self, found: Fit) -> FloatArray:
        """What the effects of a fit do to the observables, the model's own parameters as they are, shape (m,)."""
        own = found.parametrisation
        theta = found.theta[: len(own.calibration)]
        bare = replace(own, candidates=(), spreads=())
        without = self.forward.predict(bare.rig(theta), found.prediction)
        return np.asarray(self.forward.difference(found.prediction.values, without.values))

    def _most_promising(
        self, null: FittedModel, singles: Sequence[FittedModel], pairs: Sequence[FittedModel]
    ) -> FittedModel | None:
        """The explanation to look behind; None where none beats the plain model: then there is nothing behind it."""
        if not singles or singles[0].fit.log_evidence <= null.fit.log_evidence + _HELPS:
            return None
        second = pairs and pairs[0].fit.log_evidence > singles[0].fit.log_evidence + _SECOND
        return pairs[0] if second else singles[0]

    # -- judging -------------------------------------------------------------------------------------------------

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
        # Without a split that tells the explanation, by the fits themselves.
        judged = math.isfinite(whole.before)
        gap = Gap(
            whole.before if judged else rms(self._left(null.fit)[rows]),
            whole.after if judged else rms(self._left(best.fit)[rows]),
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
        return max(_REMAINDER, strict) if self.elsewhere else strict

    def _left(self, found: Fit) -> FloatArray:
        """Residual of a fit as the gap counts it, smooth errors of the model included, shape (m,)."""
        return found.residual if self.judged is self.problem else self.judged.residual(found.prediction)

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
                    parameters=_parameters(head, covariance_with_scale(self.problem, head.fit)),
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
            size = max(0.0, source.explained - source.degrees_of_freedom)
            kind = source.placement.kind
            explained[kind] = max(explained.get(kind, 0.0), size)
        weights = {place: explained.get(place, 0.0) * p for place, p in by_place.items()}
        total = sum(weights.values())
        return tuple(
            PlaceShare(place, _likeliest(details[place]), weights[place] / total if total > 0.0 else p, p)
            for place, p in sorted(by_place.items(), key=lambda item: -item[1])
            if p > 0.005
        )

    def _calibration(self, best: FittedModel) -> tuple[Recalibrated, ...]:
        parametrisation = best.fit.parametrisation
        whole = np.sqrt(np.diag(covariance_with_scale(self.problem, best.fit)))
        result = []
        for k, parameter in enumerate(parametrisation.calibration):
            theta, std = float(best.fit.theta[k]), float(whole[k])
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

    def _next(self, judgement: Judgement, verdict: Verdict, null: FittedModel) -> tuple[NextTest, ...]:
        if not self.settings.look_ahead or verdict in (Verdict.NONE, Verdict.CALIBRATION):
            return ()
        return next_tests(self.rig, self.observations, null, judgement.classes, self.workers, none=judgement.none)

    def _inputs(self) -> dict[str, Any]:
        tests = []
        for number, test in enumerate(self.observations.tests):
            mine = self.observations.rows.test == number
            tests.append(
                {
                    "name": test.name,
                    "kind": type(test).__name__,
                    "drive_point": test.drive_point,
                    "levels": int(np.unique(self.observations.rows.level[mine]).size),
                    "observables": int(mine.sum()),
                }
            )
        return {
            "bags": [
                {"path": path, "sha256": digest, **({} if origin is None else {"origin": origin.to_mapping()})}
                for (path, digest), origin in zip_longest(self.observations.inputs, self.observations.origins)
            ],
            "tests": tests,
            "held_out": [split.name for split in self.splits],
            "model": self.rig.name,
            "withheld": list(self.settings.withheld),
            "seed": self.settings.seed,
            "confidence_sha256": confidence_digest(),
        }

    def _candidate(self, fitted_model: FittedModel, null: FittedModel) -> dict[str, Any]:
        return {
            "label": fitted_model.explanation.label,
            "effect": joined(fitted_model.effects) or NULL,
            "place": fitted_model.explanation.kinds,
            "chi_square": fitted_model.fit.chi_square,
            "penalty": fitted_model.fit.penalty,
            "rows": int(fitted_model.fit.used.sum()),
            "parameters": int(fitted_model.fit.theta.size - null.fit.theta.size),
            "log_evidence": fitted_model.fit.log_evidence - null.fit.log_evidence,
            "sigmas": fitted_model.sigmas,
            "converged": fitted_model.fit.converged,
        }

    def _features(
        self,
        judgement: Judgement,
        null: FittedModel,
        singles: Sequence[FittedModel],
        pairs: Sequence[FittedModel],
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
            "prior_conflict": prior_conflict(null),
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
            **{f"feature:{name}": value for name, value in judgement.features.items()},
        }
        for name in dict.fromkeys(self.candidates[score.direction.candidate].effect.name for score in scan):
            gains = [s.gain for s in scan if self.candidates[s.direction.candidate].effect.name == name]
            found[f"scan:{name}"] = max(gains)
        for source in sources:
            key = f"source:{source.placement.kind}"
            found[key] = max(found.get(key, -math.inf), source.gain)
        return found


def _affordable(settings: ComparisonSettings, observations: Observations) -> ComparisonSettings:
    """A record is stepped through sample by sample, a hundred times as dear as a locked level: fewer fits.

    Frequency responses at held amplitudes tell stiffness and damping apart, and rigs have both: more second effects.
    """
    if any(isinstance(test, SteppedSineTest) for test in observations.tests):
        settings = replace(settings, second_of_pairs=max(settings.second_of_pairs, _SECONDS))
    if any(_shows_damping(observations, number) for number in range(len(observations.tests))):
        settings = replace(settings, partners=max(settings.partners, _PARTNERS))
    if not any(isinstance(test, RecordTest) for test in observations.tests):
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


def _shows_damping(observations: Observations, number: int) -> bool:
    """Whether a laboratory's test tells stiffness and damping over the amplitude, and little else."""
    if not measured_elsewhere(observations, number):
        return False
    if isinstance(observations.tests[number], BackboneTable):
        return bool(np.any((observations.rows.test == number) & (observations.rows.part == Part.DAMPING)))
    return isinstance(observations.tests[number], SteppedSineTest | RingDownTest)


def _likeliest(details: dict[str, float]) -> str:
    """The likeliest detail of a place, or several where one is hardly less likely than the other."""
    best = max(details.values())
    return joined(sorted(what for what, p in details.items() if what and p > 0.6 * best))


def _parameters(fitted_model: FittedModel, whole: FloatArray) -> dict[str, Value]:
    """Reported parameters of a fitted model with standard uncertainties, carried through to first order (GUM, 5.2).

    Args:
        fitted_model: the explanation.
        whole: covariance of its fit, shape (n, n).
    """
    parametrisation = fitted_model.fit.parametrisation
    theta, std = fitted_model.fit.theta, fitted_model.fit.std
    result: dict[str, Value] = {}
    several = len(fitted_model.candidates) > 1
    for index, candidate in enumerate(fitted_model.candidates):
        own = parametrisation.index_of(index)
        covariance = whole[own, own]
        for name, (value, unit) in parametrisation.reported(theta, index).items():
            slopes = np.empty(own.stop - own.start)
            for position, k in enumerate(range(own.start, own.stop)):
                moved = theta.copy()
                moved[k] += 0.1 * std[k]
                slopes[position] = (parametrisation.reported(moved, index)[name][0] - value) / (0.1 * std[k])
            # Parameters of one effect go together: a softer joint that slips earlier does nearly the same.
            variance = float(slopes @ covariance @ slopes) if np.all(np.isfinite(slopes)) else math.inf
            result[f"{candidate.label}.{name}" if several else name] = Value(
                value, math.sqrt(max(variance, 0.0)) * fitted_model.fit.scatter, unit
            )
    return result
