"""The comparison of explanations: scan all candidates, fit the promising ones, add a second where one leaves more.

Everything is judged on the same rows. The model without effect, its own parameters re-fitted, always competes.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np

from nmt_core.arrays import BoolArray, FloatArray
from nmt_core.errors import BenchError
from nmt_diagnose.effects.calibration import CalibrationParameter
from nmt_diagnose.effects.effect import Candidate
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.effects.placement import Explanation
from nmt_diagnose.inference.candidate_starts import (
    at_strength,
    at_zero,
    other_shapes,
    starts_of,
    strength_parameter,
    strength_position,
)
from nmt_diagnose.inference.fit import STEPS, Fit, FitError, fit
from nmt_diagnose.inference.fitted_model import (
    FittedModel,
    best_by_effect,
    held_back,
    is_incredible,
    refitted_whole,
    rms_left,
    united,
    wider_spread,
    without_member,
)
from nmt_diagnose.inference.level_climb import climbed
from nmt_diagnose.inference.other_points import at_other_points
from nmt_diagnose.inference.physical_limits import beyond_limits, incredible
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.inference.progress import Told
from nmt_diagnose.inference.scan import Direction, Score, scores
from nmt_diagnose.inference.workers import Workers
from nmt_rig.rig import Rig

# Sensitivities of a first fit of a candidate; those that come near the best are fitted to the end.
_REFRESHES = 3
# Strength in standard deviations below which a member of a pair does nothing.
_NOTHING = 1.0
# Below this it is fitted without that member, too: fits of the other alone may have stopped on the way to it.
_DOUBTED = 5.0
# Standard deviations beyond what physics allows from which an effect is not built upon.
_BEYOND = 3.0
# Rms of what a fit leaves, in standard deviations, from which it is tried from other shapes, and how many of the best.
_LEAVES, _RESHAPED = 1.5, 2
_AT_ONCE = 2  # other shapes
_RESTARTED = 2  # explanations, the best ones
# Known explanations that go on under other noise; share of what the best of them explains that a scan has to promise.
_CARRIED, _ENOUGH = 3, 0.5
# Standard deviations by which a strength of one scale has to show to first order.
_SHOWN = 1.0
# Rms of what one explanation leaves, over that of the best, from which its refits need not reach an optimum, and the
# steps that they make.
_BEHIND, _HOPELESS_STEPS = 4.0, 4
# Candidates whose directions are found in one piece of work.
_TOGETHER = 16


@dataclass(frozen=True)
class ComparisonSettings:
    """How far the comparison goes.

    Attributes:
        finalists: most effects that are fitted.
        placements: most placements (and starting shapes) of one effect that are fitted.
        least_gain: fall of χ² in the scan below which a candidate is not worth a fit.
        behind: fall of χ² in the scan by which a candidate may lie behind the best and still be fitted.
        share: share of the best fall from which a candidate is fitted all the same: the larger a gap, the less a linear
            scan can rank.
        first_of_pairs: best single explanations that get a second effect tried.
        second_of_pairs: second effects fitted for each.
        partners: best elastic or dissipative effects that are tried with all of the other kind; 0 = none.
        pair_gain: fall of χ² in the second scan from which a pair is tried.
        weak: strength in standard deviations up to which an effect leaves the directions of others as they are.
        settled: most explanations that are fitted to the end.
        close: logarithm of evidence by which one may lie behind the best to be fitted to the end.
        rounds: most times that a fit goes on which has not reached its optimum.
        restarts: whether one that has not reached it then starts again from the parameters as given.
    """

    finalists: int = 8
    placements: int = 2
    least_gain: float = 6.0
    behind: float = 60.0
    share: float = 0.05
    first_of_pairs: int = 3
    second_of_pairs: int = 3
    partners: int = 0
    pair_gain: float = 14.0
    weak: float = 30.0
    settled: int = 6
    close: float = 60.0
    rounds: int = 4
    restarts: bool = True


class ModelComparison:
    """Fits explanations of one set of observations.

    Args:
        problem: observations and model.
        rig: the model as given.
        calibration: parameters of the model that are free.
        candidates: effects at their places.
        settings: how far to go.
        progress: called with a sentence as the work goes on.
        rows: rows that fits may use, shape (m,); None = all.
        workers: processes that share the work; None = this one alone.
    """

    def __init__(
        self,
        problem: Problem,
        rig: Rig,
        calibration: tuple[CalibrationParameter, ...],
        candidates: tuple[Candidate, ...],
        settings: ComparisonSettings | None = None,
        progress: Callable[[str], None] | None = None,
        rows: BoolArray | None = None,
        workers: Workers | None = None,
    ) -> None:
        self.problem = problem
        self.rows = rows
        self.rig = rig
        self.calibration = calibration
        self.candidates = candidates
        self.settings = settings or ComparisonSettings()
        self._progress = progress or _silent
        self._found: dict[str, float] = {}
        # Explanations that started again from the parameters as given and came no further.
        self._in_vain: set[Explanation] = set()
        # The best explanations whose effect was tried at all other points.
        self._spread_from: set[Explanation] = set()
        self._plain_directions: list[Direction] = []
        self.workers = Workers() if workers is None else workers

    def __getstate__(self) -> dict[str, Any]:
        """What another process needs to fit; it asks nobody for help and reports no progress."""
        return {**self.__dict__, "_progress": _silent, "_plain_directions": [], "workers": None}

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

    def started(self, wanted: Sequence[tuple[int, FloatArray]]) -> list[FittedModel]:
        """Candidates of given numbers alone, fitted from all parameters, shape (n,); those without fit are left out."""
        return [found for found in self.workers.map(_started, self, wanted) if found is not None]

    def _started(self, number: int, theta: FloatArray) -> FittedModel | None:
        candidate = self.candidates[number]
        parametrisation = Parametrisation(self.rig, self.calibration, (candidate,))
        try:
            found = fit(self.problem, parametrisation, theta, self.rows, exact=False, refreshes=2 * _REFRESHES)
            return FittedModel((candidate,), self._widened(found, self.rows))
        except (BenchError, ValueError, ArithmeticError, np.linalg.LinAlgError):
            return None  # no rig, or no solution, at the start

    def added_at(self, base: FittedModel, starts: Sequence[tuple[int, float]]) -> list[FittedModel]:
        """Candidates of given numbers, each fitted from a strength on top of a model; best first."""
        wanted = []
        for number, strength in starts:
            candidate = self.candidates[number]
            start = at_strength(candidate, starts_of(candidate)[0], strength)
            direction = Direction(number, start, np.zeros(self.problem.size), strength_parameter(candidate).signed)
            wanted.append((base, Score(direction, strength, 0.0, 0.0, 0.0)))
        added = [found for found in self._all_added(wanted) if found is not None]
        return sorted(added, key=lambda found: -found.fit.log_evidence)

    def _used(self, rows: BoolArray | None) -> BoolArray | None:
        return self.rows if rows is None else rows

    def restarted(self, null: FittedModel, others: Sequence[FittedModel]) -> FittedModel:
        """The model without effect fitted again from where the best others stand, if that is better.

        Far from the model as given the first fit may stop in a fold of its own; then anything else looks better.
        """
        best = null
        for found in self.workers.map(_restarted_from, (self, null), others):
            if found is not None and found.log_evidence > best.fit.log_evidence + 0.5:
                best = FittedModel((), found)
        return best

    def _from(self, null: FittedModel, other: FittedModel) -> Fit | None:
        start = other.fit.theta[: len(self.calibration)]
        try:
            return fit(self.problem, null.fit.parametrisation, start, None, other.fit.prediction)
        except FitError:
            return None

    def scan(self, base: FittedModel) -> list[Score]:
        """Score all candidates on top of a fitted model, best first.

        A weak effect bends the directions of the others so little that those of the model without effect serve again.
        """
        if base.candidates and self._plain_directions and base.sigmas < self.settings.weak:
            kept = [d for d in self._plain_directions if not _has(base, self.candidates[d.candidate])]
            return scores(base.fit, kept, len(self.calibration))
        found = self.directions(base)
        if not base.candidates:
            self._plain_directions = found
            self._found.clear()
        return scores(base.fit, found, len(self.calibration))

    def directions(self, base: FittedModel) -> list[Direction]:
        """Directions of all candidates that the fitted model does not have yet."""
        numbers = [k for k, candidate in enumerate(self.candidates) if not _has(base, candidate)]
        starts = {k: starts_of(self.candidates[k]) for k in numbers}
        pieces: list[tuple[list[int], list[FloatArray]]] = []
        for turn in range(max((len(values) for values in starts.values()), default=0)):
            chosen = [k for k in numbers if len(starts[k]) > turn]
            for first in range(0, len(chosen), _TOGETHER):
                own = chosen[first : first + _TOGETHER]
                pieces.append((own, [starts[k][turn] for k in own]))
        return [found for piece in self.workers.map(_directions_of, (self, base), pieces) for found in piece]

    def _directions(self, base: FittedModel, chosen: list[int], wanted: list[FloatArray]) -> list[Direction]:
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
        if restarts and self._wants_restart(best):
            best = self._restarted(best)
        return FittedModel(fitted_model.candidates, best, fitted_model.score)

    def _wants_restart(self, found: Fit) -> bool:
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

    def all_refits(self, wanted: Sequence[tuple[FittedModel, BoolArray]]) -> list[FittedModel | None]:
        """``refit`` of several explanations to rows of their own."""
        least = min((rms_left(own) for own, _ in wanted), default=0.0)
        items = [(own, used, bool(own.candidates) and rms_left(own) > _BEHIND * least) for own, used in wanted]
        return self.workers.map(_refitted, self, items, weight=_labour)

    def singles(
        self, base: FittedModel, found: Sequence[Score], known: Sequence[FittedModel] = ()
    ) -> list[FittedModel]:
        """Fit the candidates that promise most, best evidence first.

        Args:
            base: what they are added to.
            found: scores, best first.
            known: fits of candidates to the same rows under other noise or from elsewhere; the best go on from there.
        """
        settings = self.settings
        chosen: dict[tuple[str, str], list[Score]] = {}
        best = found[0].gain if found else 0.0
        going = self._going_on(known)
        # What is known to explain the gap leaves no room for what explains a small part of it.
        known_gain = 2.0 * max((own.fit.log_evidence - base.fit.log_evidence for own in going), default=0.0)
        least = max(settings.least_gain, min(best - settings.behind, settings.share * best), _ENOUGH * known_gain)
        for score in found:
            if score.gain < least:
                break
            effect = self.candidates[score.direction.candidate].effect
            names = {name for name, _ in chosen}
            if effect.name not in names and len(names) == settings.finalists:
                continue
            mine = chosen.setdefault((effect.name, effect.form), [])
            if len(mine) < settings.placements:
                mine.append(score)
        every = [score for group in chosen.values() for score in group]
        added = [own for own in self._all_added([(base, score) for score in every]) if own is not None]
        singles = self._with_other_shapes(self._settled(united(added, going)))
        return self._with_other_points(base, singles)

    def _with_other_points(self, base: FittedModel, singles: list[FittedModel]) -> list[FittedModel]:
        """The same explanations, and the best one's effect at all other points, started from it; best first."""
        if not singles or singles[0].explanation in self._spread_from:
            return singles
        self._spread_from.add(singles[0].explanation)
        better = united(singles, at_other_points(self, base, singles))
        return singles if better is singles else self._settled(better)

    def _going_on(self, known: Sequence[FittedModel]) -> list[FittedModel]:
        """The best known explanations gone on from where they stand."""
        continued = self.workers.map(_continued, self, known[:_CARRIED])
        return [own for own in continued if own is not None]

    def _gone_on(self, fitted_model: FittedModel) -> FittedModel | None:
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

    def _all_added(self, wanted: Sequence[tuple[FittedModel, Score]]) -> list[FittedModel | None]:
        """Candidates fitted on top of fitted models; None where the model cannot be solved with one."""

        begun = count()

        def told(item: tuple[FittedModel, Score]) -> None:
            base, score = item
            name = self.candidates[score.direction.candidate].label
            what = f"fitting {base.explanation.label} with {name}" if base.candidates else f"fitting {name}"
            self._progress(Told(what, next(begun), len(wanted)))

        return self.workers.map(_added, self, wanted, told)

    def pruned(
        self, singles: Sequence[FittedModel], pairs: Sequence[FittedModel]
    ) -> tuple[list[FittedModel], list[FittedModel]]:
        """Singles and pairs without members that do nothing, best evidence first.

        A pair with a member at zero says nothing but that its other member can be fitted better: the single one goes
        on from there. With a weak member it may say the same, which the evidence of both decides.
        """
        kept: list[FittedModel] = []
        better = list(singles)
        for pair in pairs:
            weakest = min(range(len(pair.candidates)), key=pair.strength)
            if pair.strength(weakest) >= _NOTHING:
                kept.append(pair)
            if pair.strength(weakest) >= _DOUBTED:
                continue
            rest = Explanation(tuple(candidate.cause for candidate in without_member(pair, weakest)))
            known = max((own.fit.log_evidence for own in better if own.explanation == rest), default=-np.inf)
            if pair.strength(weakest) >= _NOTHING and known > pair.fit.log_evidence - _DOUBTED**2:
                continue  # as good as without the member it can be
            alone = self._without(pair, weakest)
            if alone is not None and alone.fit.log_evidence > known + 0.5:
                better = [own for own in better if own.explanation != alone.explanation] + [alone]
        return sorted(better, key=lambda own: -own.fit.log_evidence), kept

    def _without(self, fitted_model: FittedModel, member: int) -> FittedModel | None:
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

    def _with_partners(self, singles: Sequence[FittedModel], skipped: Collection[Explanation]) -> list[FittedModel]:
        """Elastic effects with dissipative ones at the same point and the other way round.

        A structure that stretches or yields mostly has both. Each alone is fitted in vain by what the other does, and a
        scan about that fit need not show the other; both are fitted together, from the model as given. The partner
        of the best such pair, if both are needed, is then tried with all of the other kind: which of those is the best
        alone says little.
        """
        found = self._partners_of([_member(single, 0) for single in singles], skipped)
        if not found:
            return []
        leader = max(found, key=lambda own: own.fit.log_evidence)
        alone = max(single.fit.log_evidence for single in singles)
        if leader.fit.log_evidence < alone + 0.5 * self.settings.pair_gain:
            return found
        return found + self._partners_of([_member(leader, 1)], {*skipped, *(own.explanation for own in found)})

    def _partners_of(
        self, heads: Sequence[tuple[Candidate, float]], skipped: Collection[Explanation]
    ) -> list[FittedModel]:
        """Effects, each with the spread of its strength, with all of the other kind at the same point."""
        wanted: dict[Explanation, tuple[tuple[Candidate, ...], tuple[float, ...], FloatArray]] = {}
        for own, spread in heads:
            for other in self.candidates:
                if {own.effect.force, other.effect.force} != {"elastic", "dissipative"}:
                    continue
                if (own.site.point, own.site.other_point) != (other.site.point, other.site.other_point):
                    continue
                start = np.concatenate([at_zero(own, starts_of(own)[0]), at_zero(other, starts_of(other)[0])])
                both = Explanation((own.cause, other.cause))
                if both not in skipped:
                    wanted.setdefault(both, ((own, other), (spread, 1.0), start))
        if not wanted:
            return []
        self._progress(f"fitting {len(wanted)} pairs of stiffness and damping")
        found = self.workers.map(_approached_together, self, list(wanted.values()))
        return [own for own in found if own is not None]

    def _together(
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

    def _settled(self, fitted_models: list[FittedModel]) -> list[FittedModel]:
        """Those near the best fitted to the end with sensitivities of their own, best evidence first.

        Sensitivities carried over from another fit lead to nearly the right estimate only.
        """
        ordered = sorted(fitted_models, key=lambda fitted_model: -fitted_model.fit.log_evidence)
        if not ordered:
            return []
        limit = ordered[0].fit.log_evidence - self.settings.close
        near = [own for own in ordered[: self.settings.settled] if own.fit.log_evidence >= limit]
        self._progress(Told(f"fitting the best {len(near)} to the end", ranking=self._standing(ordered)))
        ended = sorted(self.workers.map(_ended, self, near), key=lambda own: -own.fit.log_evidence)
        # Starting again takes longest, and the last of them would have to overtake all others by it.
        stuck = [
            number
            for number, own in enumerate(ended[:_RESTARTED])
            if self._wants_restart(own.fit) and own.explanation not in self._in_vain
        ]
        again = self.workers.map(_polished, self, [ended[number] for number in stuck])
        for number, own in zip(stuck, again, strict=True):
            if own.fit.log_evidence <= ended[number].fit.log_evidence + 0.5:
                self._in_vain.add(own.explanation)
            ended[number] = own
        result = sorted(ended + ordered[len(near) :], key=lambda fitted_model: -fitted_model.fit.log_evidence)
        self._progress(Told(f"so far the best is {result[0].explanation.label}", ranking=self._standing(result)))
        return result

    def _with_other_shapes(self, found: list[FittedModel]) -> list[FittedModel]:
        """The same explanations, the best of them tried from other shapes where they leave more than noise.

        A shape that lies beyond what was measured (a slip displacement that no amplitude reaches) changes nothing: the
        fit has no slope there that would lead it back.
        """
        better: dict[Explanation, FittedModel] = {}
        for own in best_by_effect(found)[:_RESHAPED]:
            starts = other_shapes(own) if rms_left(own) > _LEAVES else []
            if starts:
                self._progress(Told(f"trying {own.explanation.label} from other shapes"))
            best = own
            # A few at a time, as many for any number of processes: a full explanation needs no more of them.
            for first in range(0, len(starts), _AT_ONCE):
                tried = self.workers.map(_reshaped, self, [(own, theta) for theta in starts[first : first + _AT_ONCE]])
                for trial in tried:
                    if trial is not None and trial.fit.log_evidence > best.fit.log_evidence + 0.5:
                        best = trial
                if rms_left(best) <= _LEAVES:
                    break
            if best is not own:
                better[own.explanation] = best
        # Starting again takes longest; what another shape left far behind the best need not.
        limit = max((own.fit.log_evidence for own in (*found, *better.values())), default=0.0) - self.settings.close
        near = [own for own in better.values() if own.fit.log_evidence >= limit]
        far = [own for own in better.values() if own.fit.log_evidence < limit]
        again = [*self.workers.map(_polished, self, near), *self.workers.map(_ended, self, far)]
        ended = {own.explanation: own for own in again}
        kept = [own for own in found if own.explanation not in ended]
        return sorted((*ended.values(), *kept), key=lambda fitted_model: -fitted_model.fit.log_evidence)

    def _from_shape(self, fitted_model: FittedModel, theta: FloatArray) -> FittedModel | None:
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

    def _standing(self, found: Sequence[FittedModel]) -> list[tuple[str, float]]:
        """All explanations since the last scan of the model itself, and how far each lies behind the best."""
        self._found.update((own.explanation.label, own.fit.log_evidence) for own in found)
        best = max(self._found.values())
        return sorted(((label, best - own) for label, own in self._found.items()), key=lambda item: item[1])

    def pairs(self, singles: Sequence[FittedModel], known: Sequence[FittedModel] = ()) -> list[FittedModel]:
        """Second effects on top of the best single ones, best evidence first.

        Args:
            singles: explanations by one effect, best first.
            known: pairs fitted before, as for :meth:`singles`.
        """
        settings = self.settings
        result: list[FittedModel] = []
        best = singles[0].fit.log_evidence if singles else 0.0
        heads: set[str] = set()
        possible = [single for single in singles if beyond_limits(single.candidates, single.fit) <= _BEYOND]
        going = self._going_on(known)
        if settings.partners:
            skipped = {own.explanation for own in known}
            smooth = [single for single in best_by_effect(possible) if single.candidates[0].effect.force]
            result = self._with_partners(smooth[: settings.partners], skipped)
        tried = {own.explanation for own in (*result, *going)}
        best = max([best, *(own.fit.log_evidence for own in (*result, *going))])
        for rank, single in enumerate(best_by_effect(possible)[: settings.first_of_pairs]):
            found = self.scan(single)
            if rank == 0 and (not found or found[0].gain < settings.pair_gain):
                break  # the best single explanation leaves nothing for a second one
            wanted: list[Score] = []
            for score in found:
                if (
                    score.gain < settings.pair_gain
                    or len(wanted) == settings.second_of_pairs
                    or _hopeless(single, score, best)
                ):
                    break
                second = self.candidates[score.direction.candidate]
                if second.effect.name in heads:
                    continue  # tried already, the other way round
                if incredible(second, score):
                    continue
                pair = Explanation((*single.explanation.causes, second.cause))
                if pair not in tried:
                    tried.add(pair)
                    wanted.append(score)
            # All at once; what is hopeless beside those before it does not count.
            fitted = self._all_added([(single, score) for score in wanted])
            for score, fitted_model in zip(wanted, fitted, strict=True):
                if _hopeless(single, score, best):
                    break
                if fitted_model is not None:
                    result.append(fitted_model)
                    best = max(best, fitted_model.fit.log_evidence)
            heads.update(single.effects)
        return self._settled(united(result, going))


def _has(fitted_model: FittedModel, candidate: Candidate) -> bool:
    """Whether an explanation has the effect of a candidate at its place, in whatever form."""
    return any(cause.same_but_for_form(candidate.cause) for cause in fitted_model.explanation.causes)


def _member(fitted_model: FittedModel, member: int) -> tuple[Candidate, float]:
    """One effect of an explanation, and the spread of its strength."""
    return fitted_model.candidates[member], fitted_model.fit.parametrisation.spread(member)


def _hopeless(single: FittedModel, score: Score, best: float) -> bool:
    """Even what the scan promises would not make a pair better than the best explanation."""
    return single.fit.log_evidence + 0.5 * score.gain < best


def _restarted_from(shared: tuple[ModelComparison, FittedModel], other: FittedModel) -> Fit | None:
    comparison, null = shared
    return comparison._from(null, other)


def _directions_of(
    shared: tuple[ModelComparison, FittedModel], piece: tuple[list[int], list[FloatArray]]
) -> list[Direction]:
    comparison, base = shared
    return comparison._directions(base, *piece)


def _added(comparison: ModelComparison, item: tuple[FittedModel, Score]) -> FittedModel | None:
    return comparison.add(*item)


def _approached_together(
    comparison: ModelComparison, item: tuple[tuple[Candidate, ...], tuple[float, ...], FloatArray]
) -> FittedModel | None:
    return comparison._together(*item)


def _started(comparison: ModelComparison, item: tuple[int, FloatArray]) -> FittedModel | None:
    return comparison._started(*item)


def _continued(comparison: ModelComparison, fitted_model: FittedModel) -> FittedModel | None:
    return comparison._gone_on(fitted_model)


def _polished(comparison: ModelComparison, fitted_model: FittedModel) -> FittedModel:
    return comparison.polished(fitted_model)


def _ended(comparison: ModelComparison, fitted_model: FittedModel) -> FittedModel:
    return comparison.polished(fitted_model, restarts=False)


def _reshaped(comparison: ModelComparison, item: tuple[FittedModel, FloatArray]) -> FittedModel | None:
    return comparison._from_shape(*item)


def _refitted(comparison: ModelComparison, item: tuple[FittedModel, BoolArray, bool]) -> FittedModel | None:
    return comparison.refit(*item)


def _labour(item: tuple[FittedModel, BoolArray, bool]) -> float:
    """How much work a refit is likely to be: those that have not reached an optimum go on longest."""
    fitted_model, used, _ = item
    return fitted_model.fit.theta.size * float(used.sum()) * (1.0 if fitted_model.fit.converged else 10.0)


def _silent(_: str) -> None:
    """Report nothing."""
