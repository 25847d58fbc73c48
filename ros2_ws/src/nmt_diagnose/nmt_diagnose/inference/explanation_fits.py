"""Fits of explanations to one set of observations: of the model alone, of effects on top, to the end, to other rows.

Nothing here knows what is worth a fit; that is the comparison's (model_comparison.py). Workers get a copy of it.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from nmt_core.arrays import BoolArray, FloatArray
from nmt_core.errors import BenchError
from nmt_diagnose.effects.calibration import CalibrationParameter
from nmt_diagnose.effects.effect import Candidate
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.inference.candidate_starts import (
    at_strength,
    at_zero,
    strength_parameter,
    strength_position,
)
from nmt_diagnose.inference.comparison_settings import ComparisonSettings
from nmt_diagnose.inference.fit import STEPS, Fit, FitError, fit
from nmt_diagnose.inference.fitted_model import (
    FittedModel,
    held_back,
    is_incredible,
    refitted_whole,
    wider_spread,
    without_member,
)
from nmt_diagnose.inference.level_climb import climbed
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.inference.scan import Direction, Score
from nmt_rig.rig import Rig

# Sensitivities of a first fit of a candidate; those that come near the best are fitted to the end.
_REFRESHES = 3
# Standard deviations by which a strength of one scale has to show to first order.
_SHOWN = 1.0
# Steps of a refit that need not reach an optimum.
_HOPELESS_STEPS = 4


@dataclass(frozen=True, eq=False)
class ExplanationFits:
    """Fits of explanations of one set of observations.

    Attributes:
        problem: observations and model.
        rig: the model as given.
        calibration: parameters of the model that are free.
        candidates: effects at their places.
        settings: how far fits go.
        rows: rows that they may use, shape (m,); None = all.
    """

    problem: Problem
    rig: Rig
    calibration: tuple[CalibrationParameter, ...]
    candidates: tuple[Candidate, ...]
    settings: ComparisonSettings = field(default_factory=ComparisonSettings)
    rows: BoolArray | None = None

    def null(self, used: BoolArray | None = None, start: Fit | None = None, climbs: bool = True) -> FittedModel:
        """The model with its own parameters re-fitted.

        Args:
            used: rows, shape (m,); None = those of the comparison.
            start: a fit of it to nearly the same; None = the model as given.
            climbs: whether a fit from there that ends where nobody believes it climbs over the levels.

        Raises:
            FitError: the model as given has no solution for any observable.
        """
        parametrisation = Parametrisation(self.rig, self.calibration)
        rows = self._used(used)
        if start is None:
            best = fit(self.problem, parametrisation, parametrisation.zero, rows)
        else:
            near = self.problem.forward.predict(parametrisation.rig(start.theta), start.prediction)
            best = fit(self.problem, parametrisation, start.theta, rows, near)
        if climbs and start is None and is_incredible(best):
            with suppress(FitError):
                again = climbed(self.problem, parametrisation, rows, parametrisation.zero)
                best = max(best, again, key=lambda found: found.log_evidence)
        return FittedModel((), best)

    def started(self, number: int, theta: FloatArray) -> FittedModel | None:
        """A candidate alone, fitted from all parameters, shape (n,); None where that fails."""
        candidate = self.candidates[number]
        parametrisation = Parametrisation(self.rig, self.calibration, (candidate,))
        try:
            found = fit(self.problem, parametrisation, theta, self.rows, exact=False, refreshes=2 * _REFRESHES)
            return FittedModel((candidate,), self._widened(found, self.rows))
        except (BenchError, ValueError, ArithmeticError, np.linalg.LinAlgError):
            return None  # no rig, or no solution, at the start

    def null_from(self, null: FittedModel, other: FittedModel) -> Fit | None:
        """The model without effect fitted from the parameters that it has in an explanation; None where that fails."""
        start = other.fit.theta[: len(self.calibration)]
        try:
            return fit(self.problem, null.fit.parametrisation, start, None, other.fit.prediction)
        except FitError:
            return None

    def _used(self, rows: BoolArray | None) -> BoolArray | None:
        return self.rows if rows is None else rows

    def directions(self, base: FittedModel, chosen: list[int], wanted: list[FloatArray]) -> list[Direction]:
        """Directions of candidates at one start each: derivatives at zero strength, differences where those vanish."""
        starts = list(wanted)
        added = tuple(self.candidates[k] for k in chosen)
        parametrisation = Parametrisation(self.rig, self.calibration, base.candidates + added)
        first = base.fit.theta.size
        theta = np.concatenate(
            [base.fit.theta, *[at_zero(self.candidates[k], s) for k, s in zip(chosen, starts, strict=True)]]
        )
        offset, columns = first, []
        for k in chosen:
            columns.append(offset + strength_position(self.candidates[k]))
            offset += len(self.candidates[k].effect.parameters)
        smooth = [i for i, start in enumerate(starts) if start[strength_position(self.candidates[chosen[i]])] == 0.0]
        result: list[Direction] = []
        shown: set[int] = set()
        if smooth:
            which = [columns[i] for i in smooth]
            jacobian = self.problem.whitened(
                self.problem.forward.jacobian(parametrisation, theta, base.fit.prediction, which)
            )
            for position, i in enumerate(smooth):
                parameter, column = strength_parameter(self.candidates[chosen[i]]), jacobian[:, position]
                if parameter.even and not np.linalg.norm(np.nan_to_num(column)) > _SHOWN:
                    starts[i] = at_strength(self.candidates[chosen[i]], starts[i], parameter.even)
                else:
                    shown.add(i)
                    result.append(Direction(chosen[i], starts[i], column, parameter.signed))
        plain = base.fit.parametrisation.rig(base.fit.theta)
        for i in sorted(set(range(len(chosen))) - shown):
            start = starts[i]
            strength = float(start[strength_position(self.candidates[chosen[i]])])
            own = Parametrisation(self.rig, self.calibration, (*base.candidates, self.candidates[chosen[i]]))
            try:
                rig = own.rig(np.concatenate([base.fit.theta, start]))
                moved = self.problem.forward.predict(rig, base.fit.prediction, plain)
            except (BenchError, ValueError, ArithmeticError, np.linalg.LinAlgError):
                continue  # no rig there
            change = base.fit.residual - self.problem.residual(moved)
            parameter = strength_parameter(self.candidates[chosen[i]])
            # What does not show to first order goes with the square: the same way for either sign.
            signed = parameter.signed and not parameter.even
            result.append(Direction(chosen[i], start, change / strength, signed))
        return result

    def add(self, base: FittedModel, score: Score, used: BoolArray | None = None) -> FittedModel | None:
        """Fit a candidate on top of a fitted model; None where the model cannot be solved with it."""
        candidate = self.candidates[score.direction.candidate]
        spreads = tuple(base.fit.parametrisation.spread(index) for index in range(len(base.candidates)))
        parametrisation = Parametrisation(self.rig, self.calibration, (*base.candidates, candidate), spreads)
        start = np.array(score.direction.start, dtype=np.float64)
        position = strength_position(candidate)
        if start[position] == 0.0:
            # Half of what the scan says: a step too far may leave the range where the level has a solution.
            limit = 2.0 * parametrisation.prior_std[base.fit.theta.size + position]
            start[position] = np.clip(0.5 * score.strength, -limit, limit)
        theta = np.concatenate([base.fit.theta, start])
        own = range(base.fit.theta.size, theta.size)
        try:
            rig = parametrisation.rig(theta)
            prediction = self.problem.forward.predict(rig, base.fit.prediction)
            columns = self.problem.forward.jacobian(parametrisation, theta, prediction, own)
            added = np.nan_to_num(self.problem.whitened(columns), posinf=0.0, neginf=0.0)
            jacobian = np.column_stack([base.fit.jacobian, added])
            rows = self._used(used)
            result = fit(
                self.problem, parametrisation, theta, rows, prediction, jacobian, exact=False, refreshes=_REFRESHES
            )
            result = self._widened(result, rows)
        except (BenchError, ValueError, ArithmeticError, np.linalg.LinAlgError):
            return None  # no rig, or no solution, at the start
        if used is None and np.any(base.fit.used & ~result.used):
            return None  # with rows left out that the others have to explain no evidence compares
        return FittedModel((*base.candidates, candidate), result, score)

    def _widened(self, found: Fit, rows: BoolArray | None) -> Fit:
        """The fit with the part of its strengths' prior that makes it most probable.

        Where the prior holds a strength back, the next wider part is tried, which is less probable beforehand.
        """
        while True:
            own = found.parametrisation
            spreads = tuple(
                wider_spread(own.spread(index)) if held_back(found, index) else own.spread(index)
                for index in range(len(own.candidates))
            )
            if spreads == tuple(own.spread(index) for index in range(len(own.candidates))):
                return found
            wider = replace(own, spreads=spreads)
            trial = fit(
                self.problem, wider, found.theta, rows, found.prediction, found.jacobian,
                exact=False, refreshes=_REFRESHES,
            )  # fmt: skip
            if trial.log_evidence <= found.log_evidence:
                return found
            found = trial

    def polished(self, fitted_model: FittedModel, restarts: bool = True) -> FittedModel:
        """The same fit with sensitivities at its estimate, for uncertainties that are reported.

        One that stops before its optimum goes on from where it stands, as long as that helps.

        Args:
            fitted_model: the fit.
            restarts: False = it does not start again from the parameters as given.
        """
        best = self._finished(fitted_model.fit)
        try:
            wider = self._widened(best, best.used)
        except FitError:
            wider = best
        if wider is not best:
            best = self._finished(wider)
        if restarts and self.wants_restart(best):
            best = self._restarted(best)
        return FittedModel(fitted_model.candidates, best, fitted_model.score)

    def wants_restart(self, found: Fit) -> bool:
        """Whether a fit stands where no step leads on, or where nobody believes its parameters."""
        stuck = not found.converged or is_incredible(found)
        return self.settings.restarts and bool(found.parametrisation.candidates) and stuck

    def _finished(self, best: Fit, rounds: int | None = None) -> Fit:
        """The fit gone on with from where it stands, as long as it has not reached its optimum and that helps."""
        for _ in range(self.settings.rounds if rounds is None else rounds):
            try:
                result = fit(
                    self.problem, best.parametrisation, best.theta, best.used, best.prediction,
                    known=self._sensitivities(best),
                )  # fmt: skip
            except FitError:
                break
            helped = result.log_evidence > best.log_evidence + 0.5
            best = result
            if result.converged or not helped:
                break
        return best

    def _sensitivities(self, found: Fit) -> FloatArray | None:
        """Sensitivities of a fit where they are those at its estimate, and whitened by the noise as it counts now."""
        same = found.fresh and np.array_equal(self.problem.residual(found.prediction), found.residual, equal_nan=True)
        return found.jacobian if same else None

    def _restarted(self, best: Fit) -> Fit:
        """The best of a fit and of fits of the same explanation from the model as it was given.

        A strong effect bends the model's own parameters before it is named, often into a valley that no step leads out
        of. From the parameters as given the effect is approached again, with all levels at once and level by level.
        """
        own, rows = best.parametrisation, best.used
        start = np.where(np.arange(best.theta.size) < len(own.calibration), 0.0, best.theta)
        for climbs in (False, True):
            try:
                near = climbed(self.problem, own, rows, start) if climbs else fit(self.problem, own, start, rows)
                found = self._finished(near)
            except FitError:
                continue
            if np.any(rows & ~found.used):
                continue  # with rows left out no evidence compares
            if found.log_evidence > best.log_evidence:
                best = found
        return best

    def refit(self, fitted_model: FittedModel, used: BoolArray, hopeless: bool = False) -> FittedModel | None:
        """The same explanation fitted to other rows; None where that fails.

        Args:
            fitted_model: the explanation.
            used: the rows, shape (m,).
            hopeless: it is so far behind that no optimum among these rows would help it.
        """
        start = fitted_model.fit
        try:
            result = fit(
                self.problem, start.parametrisation, start.theta, used, start.prediction, start.jacobian,
                steps=_HOPELESS_STEPS if hopeless else STEPS, exact=False, refreshes=_REFRESHES,
                known=self._sensitivities(start),
            )  # fmt: skip
        except FitError:
            return None
        # One that has not reached its optimum with all rows need not reach that of some of them.
        rounds = 0 if hopeless else self.settings.rounds if start.converged else 1
        if not result.converged:
            result = self._finished(result, rounds)
        return FittedModel(fitted_model.candidates, result, fitted_model.score)

    def gone_on(self, fitted_model: FittedModel) -> FittedModel | None:
        """A known explanation fitted from where it stands; None where that fails."""
        before = fitted_model.fit
        try:
            found = fit(
                self.problem, before.parametrisation, before.theta, before.used, before.prediction,
                known=self._sensitivities(before),
            )  # fmt: skip
        except FitError:
            return None
        return refitted_whole(fitted_model, found)

    def without(self, fitted_model: FittedModel, member: int) -> FittedModel | None:
        """The explanation fitted without one of its effects, from where it stands; None where that fails."""
        before = fitted_model.fit
        rest = without_member(fitted_model, member)
        spreads = tuple(before.parametrisation.spread(k) for k in range(len(fitted_model.candidates)) if k != member)
        parametrisation = Parametrisation(self.rig, self.calibration, rest, spreads)
        theta = np.delete(before.theta, np.r_[before.parametrisation.index_of(member)])
        try:
            found = fit(self.problem, parametrisation, theta, before.used, before.prediction)
        except FitError:
            return None
        return FittedModel(rest, found, fitted_model.score)

    def together(
        self, candidates: tuple[Candidate, ...], spreads: tuple[float, ...], start: FloatArray
    ) -> FittedModel | None:
        """Effects fitted together from the model as given; None where that fails or leaves rows out."""
        parametrisation = Parametrisation(self.rig, self.calibration, candidates, spreads)
        theta = np.concatenate([np.zeros(len(self.calibration)), start])
        try:
            found = fit(self.problem, parametrisation, theta, self.rows, exact=False, refreshes=2 * _REFRESHES)
            found = self._widened(found, self.rows)
        except FitError:
            return None
        wanted = self.problem.size if self.rows is None else int(self.rows.sum())
        return FittedModel(candidates, found) if int(found.used.sum()) == wanted else None

    def from_shape(self, fitted_model: FittedModel, theta: FloatArray) -> FittedModel | None:
        """An explanation fitted from other parameters; None where that fails or leaves rows out."""
        before = fitted_model.fit
        try:
            found = fit(
                self.problem, before.parametrisation, theta, before.used, before.prediction, exact=False,
                refreshes=_REFRESHES,
            )  # fmt: skip
        except FitError:
            return None
        return refitted_whole(fitted_model, found)
