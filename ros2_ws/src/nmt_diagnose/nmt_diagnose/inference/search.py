"""The search for explanations of a gap, and for what the measuring chain did to the observations."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from nmt_core.arrays import FloatArray
from nmt_core.errors import BenchError
from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.effects.library import candidates as library_candidates
from nmt_diagnose.inference.chain_errors import chain_errors, sweep_directions, with_chain_errors, with_shared
from nmt_diagnose.inference.comparison_settings import ComparisonSettings
from nmt_diagnose.inference.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.inference.discrepancy import elsewhere, measured_elsewhere, smooth_errors
from nmt_diagnose.inference.explanation_fits import ExplanationFits
from nmt_diagnose.inference.first_explanations import first_explanations
from nmt_diagnose.inference.fit import Fit, FitError, fit
from nmt_diagnose.inference.fitted_model import FittedModel, rms_left
from nmt_diagnose.inference.held_images import (
    ImageOptions,
    image_options,
    may_hold_images,
    same_images,
    with_detected_images,
)
from nmt_diagnose.inference.held_out import Split
from nmt_diagnose.inference.lock_noise import lock_nuisances
from nmt_diagnose.inference.model_comparison import ModelComparison
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.inference.progress import Progress
from nmt_diagnose.inference.sampling_moment import NEAR_STEPS, WIDE_STEPS, with_better_moment
from nmt_diagnose.inference.scan import Score
from nmt_diagnose.inference.scatter import scatter_floor
from nmt_diagnose.inference.sweep_drift import sweep_drift
from nmt_diagnose.inference.true_phase import LEAST_CHANGE, at_true_phases, chain_share, phase_offset, with_phases_of
from nmt_diagnose.inference.workers import Workers
from nmt_diagnose.observations.conditions import BackboneTable, RandomTest, RecordTest, RingDownTest, SteppedSineTest
from nmt_diagnose.observations.observables import Observations, Part
from nmt_diagnose.twin.forward import Forward, Prediction, traced
from nmt_diagnose.twin.operating_range import operating_range
from nmt_rig.rig import Rig

# Most times that the moment at which a held random test was sampled is corrected.
_MOMENTS = 8
# ln of the evidence from which an effect moves the solution so far that errors of the measuring chain act otherwise.
_MOVES = 50.0
_OF_OBSERVATIONS = ("forward", "given", "plain", "problem", "observations", "judged", "comparison", "_undetected")
_GOOD = 1.5  # rms of residuals of a model that may tell whether images of a held drive are there
# ln of how much too large the noise of images that are part of the model may be.
_AMPLE = 0.3
_FALL = 10.0  # of χ² and penalty: what another description of held drives and phases must be worth
_PHASES = 6  # most times that the phases of locked windows are corrected
_TRACED, _SETTLED = 12, 0.3  # most times that they are traced anew, and change in standard deviations that ends it
_SECONDS = 6
# Leading elastic or dissipative effects that are tried with all of the other kind.
_PARTNERS = 1


class Search:
    """Finds explanations of a gap: what the observations are taken for, and what is fitted to them.

    The fits tell what the measuring chain did (images of a held drive, phases at lock, scatter), and that changes what
    is fitted; so both are found in turns.

    Args:
        rig: the model as given.
        observations: the real side.
        settings: of the diagnosis.
        splits: what is held out in turn.
        progress: called with a sentence as the work goes on.
        workers: processes that share the work.

    Attributes:
        observations: the real side as it came to be taken.
        forward: predicts its observables.
        given: prediction of the model as given.
        plain: problem without errors of the measuring chain.
        problem: the problem that explanations are fitted to.
        judged: the problem that gaps are counted in; in that of the fits smooth errors of the model may be noise.
        candidates: effects at their places.
        comparison: fits and compares explanations.
    """

    def __init__(
        self,
        rig: Rig,
        observations: Observations,
        settings: DiagnosisSettings,
        splits: Sequence[Split],
        progress: Progress,
        workers: Workers,
    ) -> None:
        self.rig, self.observations, self.settings, self.progress = rig, observations, settings, progress
        self._splits, self._workers = splits, workers
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
        fits = ExplanationFits(
            self.problem,
            self.rig,
            calibration_parameters(self.rig),
            self.candidates,
            _affordable(self.settings.comparison, self.observations),
            self._splits[0].fitted if self.settings.hold_out else None,
        )
        return ModelComparison(fits, self.progress, self._workers)

    def run(self) -> tuple[FittedModel, list[Score], list[FittedModel], list[FittedModel]]:
        """The model alone, the scan about it, and explanations by one and by two effects, best first.

        Whatever changes on the way, the model alone or the noise, explanations that were good go on from where they
        stand: a scan about a solution that is wrong by many times the noise need not lead to them again.

        Raises:
            BenchError: the model has no solution for any of the observations.
        """
        self.progress("re-fitting the model's own parameters")
        try:
            null = self.comparison.fits.polished(self.comparison.fits.null())
        except FitError as error:
            raise BenchError(f"The model cannot be compared with the observations: {error}.") from error
        # At other phases than they were told locked windows contradict a random test, with images or without.
        null = self._with_true_phases(self._with_detected_images(self._with_true_phases(null)))
        self.progress(f"scanning {len(self.candidates)} candidates")
        known = first_explanations(self.comparison, null)
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
            null = self.comparison.fits.polished(self.comparison.fits.null())
            scan = self.comparison.scan(null)
            singles = self.comparison.singles(null, scan, singles)
        singles, pairs = self.comparison.pruned(singles, self.comparison.pairs(singles, pairs))
        if self._amplitudes_measured and self._leads(pairs, singles) and self._retraced(null, pairs):
            null = self.comparison.fits.polished(self.comparison.fits.null())
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
        if not elsewhere(self.observations):
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
        first, passed = near, [near.theta]
        for _ in range(_TRACED if self._amplitudes_measured else 0):
            # Near folds the noise of measured amplitudes depends much on the solution that it is propagated about.
            try:
                near = fit(self.problem, near.parametrisation, near.theta, near.used, near.prediction)
            except FitError:
                break
            # It may also go in a circle.
            if min(float(np.max(np.abs(near.theta - was) / near.std, initial=0.0)) for was in passed) < _SETTLED:
                break
            passed.append(near.theta)
            drift = self._drift(near, self.plain.difference(near.prediction.values))
            self._trace(near, scatter, drift, columns)
        if near is not first:
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
                null = self._under(observations, null, near=True)
        return null

    def _better_of(self, found: ImageOptions, null: FittedModel) -> FittedModel:
        """The model alone under the observations, with images or without, that it fits better, if it fits one well.

        If it does not, the more credible observations count where that is clear, and those before where it is not.
        """
        before, fits, states, densities = self.plain.observations, [], [], []
        for option in found.options:
            fits.append(self._with_better_moment(self._under_other(option, null)))
            states.append(self._state())
            images = any(isinstance(t, RandomTest) and t.sampled_at is not None for t in option.tests)
            ample = _AMPLE * float(fits[-1].fit.used.sum()) if images else 0.0
            densities.append(self._density(fits[-1].fit) + ample)
        best = int(np.argmax(densities))
        if not rms_left(fits[best]) < _GOOD:
            if not found.sure:
                return self._under(before, null, near=True)
            self._return_to(states[0])
            return self.comparison.fits.polished(max(self.comparison.fits.null(), fits[0], key=_evidence))
        self._return_to(states[best])
        return fits[best]

    def _density(self, found: Fit) -> float:
        """ln of the probability density of what was recorded, by a fit to it as it is described now.

        Other descriptions of a held drive have other noise, and images may be off by more than what is not there: less
        is left over it. Stated noise may be wrong by one factor for all rows.
        """
        rows, left = float(found.used.sum()), _objective(found)
        scaled = 0.5 * left - 0.5 * rows * (1.0 + math.log(max(left, 1.0) / rows))
        return found.log_evidence + scaled - self.problem.log_volume(found.used)

    def _state(self) -> dict[str, Any]:
        """What taking other observations changes."""
        return {name: getattr(self, name) for name in _OF_OBSERVATIONS}

    def _return_to(self, state: Mapping[str, Any]) -> None:
        for name, value in state.items():
            setattr(self, name, value)

    def _with_better_moment(self, null: FittedModel) -> FittedModel:
        """The model alone where held random tests are taken as sampled at the moment that leaves least.

        Moments near the first one are tried first; others count where the model then suits the recordings better.
        """
        null = self._with_moments(null, NEAR_STEPS)
        before = self._state()
        found = self._with_moments(null, WIDE_STEPS, most=1)
        if found is null:
            return null
        found = self._with_moments(found, NEAR_STEPS)
        if _objective(found.fit) < _objective(null.fit) - _FALL:
            return found
        self._return_to(before)
        return null

    def _with_moments(self, null: FittedModel, steps: FloatArray, most: int = _MOMENTS) -> FittedModel:
        """The model alone at the best moments within some steps; itself where none is better."""
        for _ in range(most):
            moved = with_better_moment(self.problem, null.fit, steps)
            if moved is None:
                break
            null = self._under(moved, null, near=True)
        return null

    def _with_true_phases(self, null: FittedModel) -> FittedModel:
        """The model alone where locked windows are predicted at the phases that it tells together with the chain.

        Where the model suits the recordings less then, it did not tell them.
        """
        before = self._state()
        _, moved = self._at_true_phases(null.fit)
        if not moved:
            return null
        self.judged, self.comparison = self.problem, self._comparison()
        found = self.comparison.fits.polished(self.comparison.fits.null())
        if _objective(found.fit) > _objective(null.fit) + _FALL:
            self._return_to(before)
            return null
        return found

    def _at_true_phases(self, near: Fit) -> tuple[Fit, bool]:
        """A fit with the locked windows at the phases that it tells, if it is good; whether they moved."""
        moved = False
        for _ in range(_PHASES if elsewhere(self.observations) else 0):
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
            corrected = None
            with suppress(FitError):
                corrected = fit(self.problem, near.parametrisation, near.theta, near.used, prediction)
            if corrected is None or _objective(corrected) > _objective(near) + _FALL:
                self.forward, self.given, self.plain, self.problem, self.observations = kept
                break
            near, moved = corrected, True
            self._undetected = with_phases_of(self._undetected, found)
        return near, moved

    def _with_images_of(self, leader: FittedModel) -> Fit:
        """The fit of an explanation after random tests showed, about it, whether images of a held drive are in them.

        The model alone may be so far off that it takes what an effect does for images. Noise of either description may
        be too large, so another one has to be clearly more probable.
        """
        near = leader.fit
        options = [
            option
            for option in with_detected_images(self._undetected, near.parametrisation.rig(near.theta))
            if not same_images(option, self.plain.observations)
        ]
        best, most = near, self._density(near)
        kept = self.forward, self.given, self.plain, self.problem, self.observations
        for option in options:
            self._observe(option)
            prediction = self.forward.predict(near.parametrisation.rig(near.theta), near.prediction)
            self._trace(replace(near, prediction=prediction), np.zeros(len(self.observations.rows)), 0.0)
            with suppress(FitError):
                found = fit(self.problem, near.parametrisation, near.theta, near.used, prediction)
                if self._density(found) > most + _AMPLE * float(found.used.sum()):
                    best, most = found, self._density(found)
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
        return self.comparison.fits.polished(self.comparison.fits.null(start=null.fit if near else None))

    def _under_other(self, observations: Observations, null: FittedModel) -> FittedModel:
        """The same from the parameters as given and from where the model stands, whichever is better.

        Where neither is near, what is tried is not what is missing, and no climb over the levels is worth its time.
        """
        near = self._under(observations, null, near=True)
        with suppress(FitError):
            return max(near, self.comparison.fits.null(climbs=False), key=_evidence)
        return near

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

    def _trace(
        self, near: Fit, scatter: FloatArray, drift: float, known: FloatArray | None = None
    ) -> tuple[Problem, FloatArray]:
        """Noise of measured amplitudes and errors of the measuring chain as they act about a fit: see chain_errors.

        What errors of the chain do changes little with the solution: where they are ``known`` about a similar fit, only
        the noise is new.
        """
        self.observations = self.plain.observations
        self.plain = self._plain(near.prediction, self.plain.offset)
        moved = near.parametrisation.rig(near.theta)
        noisy, columns = chain_errors(self.plain, moved, near.prediction, scatter, drift, known)
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


def _objective(found: Fit) -> float:
    """What a fit makes least, χ² and penalty of the parameters."""
    return found.chi_square + found.penalty


def _evidence(found: FittedModel) -> float:
    return found.fit.log_evidence


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
