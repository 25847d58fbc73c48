"""The search for explanations in one pass: score test, least squares of the best, other places, one second effect.

The score test says of every candidate how far the cost falls to first order, parameters and chain following. The best
effects at their best places are then fitted from there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from scipy.optimize import brentq

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.effects.calibration import CalibrationParameter
from nmt_diagnose.effects.effect import Candidate
from nmt_diagnose.effects.location import Cause, Explanation
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.effects.structure_effects import MISSING_MODE
from nmt_diagnose.fit.best_fit import StartName, best_fit, evidence, spread_at, spread_of
from nmt_diagnose.fit.candidate_starts import at_strength, at_zero, starts_of, strength_parameter, strength_position
from nmt_diagnose.fit.explanations import FittedExplanation, Score, best_by_effect, best_of
from nmt_diagnose.fit.fitting import (
    FIRST_LOOK,
    Data,
    FitError,
    FitResult,
    Metric,
    Start,
    best_chain_errors,
    fit,
    predicted,
)
from nmt_diagnose.fit.low_level_modes import LowLevelModes
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig

# Times that a fit which has not converged is continued.
_CONTINUATIONS = 3
# Little, and more than rounding.
_SIDE_BY_SIDE = 4  # effects of which pairs are fitted together
_INITIAL_STRENGTH = 0.01
_STARTS = 4  # of a candidate

Progress = Callable[[str], None]
"""Is called with what is being done, a sentence."""
WEAKER_SHARE = 0.3
"""Of the strength of a start from which the model has no solution."""


def promise_evidence(scores: Sequence[Score]) -> bool:
    """Whether the score test promises an effect that is reported although what it explains is less than matters."""
    return bool(scores) and 0.5 * scores[0].gain >= THRESHOLDS.verdict.sure_log_evidence


class Search:
    """Finds explanations of a gap.

    Args:
        data: what fits work on.
        rig: the model as given.
        parameters: of the model, delays of the chain among them.
        candidates: effects at their places.
        tell: called with a sentence as the work goes on.

    Attributes:
        lost: causes of which a fit on top of the model alone was begun and came to nothing.
    """

    def __init__(
        self,
        data: Data,
        rig: Rig,
        parameters: Sequence[CalibrationParameter],
        candidates: Sequence[Candidate],
        tell: Progress = lambda _: None,
    ) -> None:
        self.data, self.rig, self.tell = data, rig, tell
        self.parameters, self.candidates = tuple(parameters), tuple(candidates)
        self.lost: set[Cause] = set()

    def parametrisation(self, candidates: Sequence[Candidate] = (), spreads: Sequence[float] = ()) -> Parametrisation:
        """Parameters of the model and of some effects."""
        return Parametrisation(self.rig, self.parameters, tuple(candidates), tuple(spreads))

    def scores(self, base: FittedExplanation, known: Sequence[Score] = ()) -> list[Score]:
        """All candidates on top of a fit, the best first.

        Args:
            base: the fit.
            known: scores on top of another fit, what candidates change being taken from there; empty = it is computed.
        """
        if not known:
            self.tell(f"scanning {len(self.candidates)} candidates")
        taken = base.explanation.causes
        found = [
            (score.candidate, score.origin, score.column, score.signed)
            for score in known
            if score.origin is not None
            and not any(cause.same_but_for_form(self.candidates[score.candidate].cause) for cause in taken)
        ] or self._columns(base)
        if not found:
            return []
        fitted, data = base.fit, self.data
        metric, precision = self._metric(base)
        projected, base_coefficients = metric.project(np.column_stack([column for _, _, column, _ in found]))
        now = np.concatenate([fitted.theta, fitted.errors.chain])
        left, counts, groups = fitted.errors.residual, data.counts, data.groups
        before = groups.cost(fitted.errors.squares, counts)
        result = []
        for k, (number, start, column, signed) in enumerate(found):
            vector, follow, weights, strength = projected[:, k], base_coefficients[:, k], fitted.errors.weights, 0.0
            # What the strength takes off the priors of parameters and chain counts as what it takes off the residual.
            pull, stiff = float(follow @ (precision * now)), float(follow @ (precision * follow))
            square = float(vector @ (weights * vector)) + stiff
            if not square > 1e-12:
                continue
            reach = math.sqrt(square)
            for _ in range(4):
                square = float(vector @ (weights * vector)) + stiff
                strength = (float(vector @ (weights * left)) + pull) / square
                if strength < 0.0 and not signed:
                    strength = 0.0
                squares = groups.sums((left - strength * vector) ** 2)
                weights = groups.weights(squares, counts)[groups.of]
            gain = before - groups.cost(squares, counts) + 2.0 * strength * pull - strength**2 * stiff
            instead = self.instead_of_chain_error(fitted, column)
            if instead is not None and instead[1] > gain and (signed or instead[0] > 0.0):
                strength, gain = instead
            position = strength_position(self.candidates[number])
            own_start = at_strength(self.candidates[number], start, start[position] or strength)
            result.append(Score(number, own_start, gain, reach, column, signed, start))
        return sorted(result, key=lambda score: -score.gain)

    def _metric(self, base: FittedExplanation) -> tuple[Metric, FloatArray]:
        """Projection that takes out parameters and chain of a fit, and the precision of their priors, (n,)."""
        fitted = base.fit
        chain = fitted.errors.slopes
        # The prior of a strength must not hold back what the data say: it would look like something else.
        prior = fitted.parametrisation.prior_std.copy()
        prior[len(self.parameters) :] *= 1e3
        precision = np.concatenate([prior**-2.0, np.ones(chain.shape[1])])
        return Metric(np.column_stack([fitted.jacobian, chain]), precision, fitted.errors.weights), precision

    def reported_from(self, base: FittedExplanation, scores: Sequence[Score]) -> list[float]:
        """Smallest strengths at which effects would be reported, had they acted in addition to a fit.

        A group of rows that estimates its own noise takes a small effect for noise: its cost falls more slowly than
        with the square of the strength. The priors of strength and shape parameters cost evidence; a margin is kept
        for chance.

        Args:
            base: the fit.
            scores: of the effects on top of it.

        Returns:
            Strengths in the units of θ, one for each score.
        """
        if not scores:
            return []
        fitted, groups, counts = base.fit, self.data.groups, self.data.counts
        metric, precision = self._metric(base)
        projected, follow = metric.project(np.column_stack([score.column for score in scores]))
        before, limits = groups.cost(fitted.errors.squares, counts), THRESHOLDS.verdict
        stiff = np.sum(follow * (precision[:, None] * follow), axis=0)

        def lacks(strength: float, number: int, least: float) -> float:
            squares = fitted.errors.squares + strength**2 * groups.sums(projected[:, number] ** 2)
            return groups.cost(squares, counts) + strength**2 * float(stiff[number]) - before - least

        found = []
        for number, score in enumerate(scores):
            shapes = len(self.candidates[score.candidate].effect.parameters) - 1
            prior = math.log(max(THRESHOLDS.fits.strength_std * score.reach, 1.0)) + shapes
            least = (math.sqrt(2.0 * (limits.sure_log_evidence + prior)) + limits.chance_sigmas) ** 2
            high = math.sqrt(least) / score.reach
            while lacks(high, number, least) < 0.0:
                high *= 2.0
            found.append(float(brentq(lacks, 0.0, high, args=(number, least), rtol=1e-3)))
        return found

    def instead_of_chain_error(self, fitted: FitResult, column: FloatArray) -> tuple[float, float] | None:
        """Strength of an effect that does what an incredible error of the chain does now, and what that saves.

        Far from rest, as for a delay of a good part of a turn, the change to first order leads away from it.
        """
        errors, size = fitted.errors, float(np.linalg.norm(column))
        for j in np.flatnonzero(np.abs(errors.chain) > THRESHOLDS.comparison.credible_sigmas):
            slope = errors.slopes[:, j]
            along = float(slope @ column)
            if abs(along) > THRESHOLDS.search.alike_cosine * size * float(np.linalg.norm(slope)):
                return float(errors.chain[j]) * along / size**2, float(errors.chain[j]) ** 2
        return None

    def _columns(self, base: FittedExplanation) -> list[tuple[int, FloatArray, FloatArray, bool]]:
        """Number, start, column and whether either sign, of all candidates that the fit does not have yet."""
        data, fitted = self.data, base.fit
        taken = base.explanation.causes
        pieces = [
            (number, start)
            for number, candidate in enumerate(self.candidates)
            if not any(cause.same_but_for_form(candidate.cause) for cause in taken)
            for start in starts_of(candidate)
        ]
        smooth = [(n, s) for n, s in pieces if s[strength_position(self.candidates[n])] == 0.0]
        other = [(n, s) for n, s in pieces if s[strength_position(self.candidates[n])] != 0.0]
        result = []
        turns: dict[int, list[FloatArray]] = {}
        for number, start in smooth:
            turns.setdefault(number, []).append(start)
        for turn in range(max((len(starts) for starts in turns.values()), default=0)):
            chosen = [(n, starts[turn]) for n, starts in turns.items() if len(starts) > turn]
            for (number, start), column in zip(chosen, self._slopes(base, chosen), strict=True):
                candidate = self.candidates[number]
                parameter = strength_parameter(candidate)
                if parameter.even and not np.linalg.norm(column) > THRESHOLDS.search.first_order_sigmas:
                    other.append((number, at_strength(candidate, start, parameter.even)))
                elif np.any(column != 0.0):
                    result.append((number, start, column, candidate.signed(parameter)))
        for number, start in other:
            candidate = self.candidates[number]
            parametrisation = self.parametrisation((*base.candidates, candidate), fitted.parametrisation.spreads)
            moved = predicted(data, parametrisation, np.concatenate([fitted.theta, start]), fitted.prediction)
            if moved is None:
                continue
            parameter = strength_parameter(candidate)
            errors = fitted.errors.chain
            change = fitted.errors.residual - data.difference(moved.values, errors)
            column = change / float(start[strength_position(candidate)])
            # An effect without a first-order change is proportional to the square: the same for either sign.
            result.append((number, start, column, candidate.signed(parameter) and not parameter.even))
        return result

    def _slopes(self, base: FittedExplanation, chosen: Sequence[tuple[int, FloatArray]]) -> list[FloatArray]:
        """Derivatives of the rows over strengths at zero, over σ; zeros where the model cannot be solved."""
        added = [self.candidates[number] for number, _ in chosen]
        parametrisation = self.parametrisation((*base.candidates, *added), base.fit.parametrisation.spreads)
        theta = np.concatenate([base.fit.theta, *[at_zero(c, s) for c, (_, s) in zip(added, chosen, strict=True)]])
        offset, which = base.fit.theta.size, []
        for candidate in added:
            which.append(offset + strength_position(candidate))
            offset += len(candidate.effect.parameters)
        try:
            columns = self.data.forward.jacobian(parametrisation, theta, base.fit.prediction, which)
        except (BenchError, ValueError, ArithmeticError, np.linalg.LinAlgError):
            if len(chosen) == 1:
                return [np.zeros(self.data.sigma.size)]
            # One that the model cannot be solved with must not take the others along.
            return [column for one in chosen for column in self._slopes(base, [one])]
        return list(self.data.slopes(columns, base.fit.errors.values).T)

    def best(
        self,
        parametrisation: Parametrisation,
        starts: Sequence[Start],
        known: FittedExplanation | None = None,
        widen: bool = False,
        value: Callable[[FitResult], float] = evidence,
        enough: Callable[[FitResult], bool] = lambda _: False,
    ) -> FittedExplanation | None:
        """An explanation fitted from the best of some starts, or the one that is known where none is better.

        Returns:
            None where the model cannot be solved at any of them; arguments as of :func:`best_fit`.
        """
        standing = None if known is None else known.fit
        try:
            found = best_fit(self.data, parametrisation, starts, standing, value, enough, widen)
        except FitError:
            return None
        return known if found is standing else FittedExplanation(parametrisation.candidates, found)

    def with_added(
        self,
        base: FittedExplanation,
        score: Score,
        lost: float = THRESHOLDS.search.lost_cost_rise,
        name: StartName = StartName.SCORE,
    ) -> FittedExplanation | None:
        """A candidate fitted on top of a fit; None where the model cannot be solved with it."""
        candidate, fitted = self.candidates[score.candidate], base.fit
        known = [fitted.parametrisation.spread(k) for k in range(len(base.candidates))]
        # A strength that its prior holds back would be taken for noise.
        parametrisation = self.parametrisation(
            (*base.candidates, candidate), (*known, spread_at(candidate, score.start))
        )
        strength = score.start[strength_position(candidate)]
        starts = [
            Start(
                of_share,
                np.concatenate([fitted.theta, at_strength(candidate, score.start, share * strength)]),
                fitted,
                fitted.theta.size,
                effort=FIRST_LOOK,
            )
            for of_share, share in ((name, 1.0), (name.weaker, WEAKER_SHARE))
        ]
        found = self.best(parametrisation, starts, enough=lambda _: True, widen=True)
        # Worse than without it: the fit has lost its way.
        if found is None or found.fit.cost > fitted.cost + lost:
            if not base.candidates:
                self.lost.add(candidate.cause)
            return None
        return found

    def refit(self, found: FittedExplanation) -> FittedExplanation:
        """The same explanation fitted to this search's data from where it stands.

        Where it cannot be fitted to them its evidence, which is of other data, counts nothing; that of the model alone
        stands.
        """
        fitted = found.fit
        try:
            for _ in range(1 + _CONTINUATIONS):
                fitted = fit(self.data, fitted.parametrisation, Start(fitted.start, fitted.theta, fitted))
                if fitted.converged:
                    break
        except FitError:
            if fitted is found.fit and found.candidates:
                fitted = replace(fitted, log_evidence=-math.inf)
        return FittedExplanation(found.candidates, fitted)

    def in_reach(self, found: Sequence[FittedExplanation]) -> tuple[list[FittedExplanation], list[FittedExplanation]]:
        """Explanations, the best first, that are not far behind the best, and the others."""
        least = found[0].fit.log_evidence - THRESHOLDS.search.far_behind_log_evidence
        near = [explanation for explanation in found if explanation.fit.log_evidence > least][
            : THRESHOLDS.search.finalists
        ]
        return near, list(found[len(near) :])

    def refit_all(self, found: Sequence[FittedExplanation]) -> list[FittedExplanation]:
        """Explanations fitted again, the best first; rivals also from the model's parameters of the best."""
        fitted = sorted((self.refit(explanation) for explanation in found), key=lambda it: -it.fit.log_evidence)
        leader = self.refitted_from_model(fitted[0])
        rivals = [self.from_parameters_of(leader, rival) for rival in fitted[1:]]
        return sorted([leader, *rivals], key=lambda it: -it.fit.log_evidence)

    def other_laws(
        self, leader: FittedExplanation, far: Sequence[FittedExplanation]
    ) -> tuple[list[FittedExplanation], list[FittedExplanation]]:
        """Explanations far behind the best that one other law at its place makes, fitted from its parameters.

        Returns:
            Those that are not far behind any more, the best first, and all others as they were.
        """
        least = leader.fit.log_evidence - THRESHOLDS.search.far_behind_log_evidence
        near, others = [], []
        for explanation in far:
            at_its_place = set(explanation.explanation.locations) <= set(leader.explanation.locations)
            if len(explanation.candidates) == 1 and at_its_place:
                moved = self.from_parameters_of(leader, self.refit(explanation))
                if moved.fit.log_evidence > least:
                    near.append(moved)
                    continue
            others.append(explanation)
        return near, others

    def from_parameters_of(self, leader: FittedExplanation, rival: FittedExplanation) -> FittedExplanation:
        """A rival fitted again from the model's parameters of the leader where its own are others; the better fit."""
        count, theta = len(self.parameters), rival.fit.theta.copy()
        if np.max(np.abs(theta[:count] - leader.fit.theta[:count]), initial=0.0) < THRESHOLDS.search.other_parameters:
            return rival
        theta[:count] = leader.fit.theta[:count]
        moved = Start(StartName.LEADER, theta, leader.fit)
        return self.best(rival.fit.parametrisation, [moved], rival) or rival

    def chosen(
        self, base: FittedExplanation, scores: Sequence[Score], effects: int, places: int, least: float
    ) -> list[Score]:
        """The best effects at their best places, one start each.

        Effects that change the rows alike, such as two laws of damping, count as one of ``effects``.
        """
        result: list[Score] = []
        by_effect: dict[str, list[Score]] = {}
        ways: list[FloatArray] = []
        weights = np.sqrt(base.fit.errors.weights)
        for score in scores:
            if score.gain < least:
                break
            candidate = self.candidates[score.candidate]
            if candidate.effect.name not in by_effect:
                way = weights * score.column
                way = way / max(float(np.linalg.norm(way)), 1e-300)
                if all(abs(float(way @ other)) < THRESHOLDS.search.alike_cosine for other in ways):
                    if len(ways) == effects:
                        continue
                    ways.append(way)
            of_effect = by_effect.setdefault(candidate.effect.name, [])
            if len(of_effect) < places and all(
                score.candidate != chosen_before.candidate for chosen_before in of_effect
            ):
                of_effect.append(score)
                result.append(score)
        return result

    @property
    def of_missing_modes(self) -> bool:
        """Whether there are no candidates but modes that the model lacks: they bring the measured ones themselves."""
        return all(candidate.effect.name == MISSING_MODE for candidate in self.candidates)

    def singles(
        self,
        null: FittedExplanation,
        scores: Sequence[Score],
        passed: Collection[Explanation] = (),
    ) -> list[FittedExplanation]:
        """Explanations by one effect, the best first.

        Args:
            null: the model alone.
            scores: of all candidates, the best first.
            passed: explanations that need no fit; places have been compared where there are any.
        """
        wanted = self.chosen(
            null,
            scores,
            THRESHOLDS.search.first_effects,
            THRESHOLDS.search.first_locations,
            THRESHOLDS.search.least_cost_fall,
        )
        wanted = [score for score in wanted if Explanation((self.candidates[score.candidate].cause,)) not in passed]
        self.tell(f"fitting {len(wanted)} explanations")
        found = self._added(null, [score for score in wanted if not self._adds_a_mode(score.candidate)])
        # To first order on the model alone many places do the same to the rows; fitted they differ.
        likely = {
            score.candidate: score
            for score in reversed(scores)
            if score.gain > THRESHOLDS.search.other_locations_share * scores[0].gain
        }
        known = {explanation.explanation for explanation in found}
        for best in best_by_effect(found)[: 0 if passed else THRESHOLDS.search.pair_heads]:
            for number in likely:
                other = self.candidates[number]
                if self._adds_a_mode(number):
                    continue
                if other.effect.name in best.effects and Explanation((other.cause,)) not in known:
                    moved = self._exchanged(best, other, likely)
                    found += [] if moved is None else [moved]
        found = best_of([*found, *self.missing_modes(null)])
        if found and not found[0].fit.converged:
            # What has not arrived takes a second effect for the rest of its way.
            found[0] = self.refit(found[0])
        return best_of(found)

    def _adds_a_mode(self, number: int) -> bool:
        return self.candidates[number].effect.name == MISSING_MODE

    def missing_modes(self, null: FittedExplanation) -> list[FittedExplanation]:
        """Explanations by a mode that the model lacks, fitted from the model as given; the best first.

        Its own parameters have been bent towards a resonance that they cannot make: nothing leads back from there.
        """
        data, zero = self.data, np.zeros(len(self.parameters))
        ranked = []
        for number, candidate in enumerate(self.candidates):
            if not self._adds_a_mode(number):
                continue
            for begun in starts_of(candidate):
                theta = np.concatenate([zero, begun])
                values = predicted(data, self.parametrisation((candidate,)), theta, None)
                if values is not None:
                    ranked.append((best_chain_errors(data, values.values).cost, number, theta))
        best: dict[int, FloatArray] = {}
        for _, number, theta in sorted(ranked, key=lambda it: it[0]):
            best.setdefault(number, theta)
        found = []
        for number, theta in list(best.items())[: THRESHOLDS.search.missing_mode_fits]:
            candidate = self.candidates[number]
            spread = spread_at(candidate, theta[zero.size :])
            starts = [Start(StartName.GIVEN, theta, effort=FIRST_LOOK)]
            fitted = self.best(self.parametrisation((candidate,), (spread,)), starts, widen=True)
            if fitted is not None and fitted.fit.cost < null.fit.cost:
                found.append(fitted)
        return best_of(found)

    def _exchanged(
        self, found: FittedExplanation, other: Candidate, likely: Mapping[int, Score]
    ) -> FittedExplanation | None:
        """An explanation by one effect with the effect at another place, from where it stands.

        Its strength is to the one here as both promise on top of the model alone.
        """
        here, there = (likely.get(self.candidates.index(c)) for c in (found.candidates[0], other))
        theta, position = found.fit.theta.copy(), len(self.parameters) + strength_position(other)
        if here is not None and there is not None:
            theta[position] *= there.start[strength_position(other)] / here.start[strength_position(other)]
        parametrisation = self.parametrisation((other,), (spread_of(float(theta[position])),))
        moved = Start(StartName.ELSEWHERE, theta, found.fit, len(self.parameters), effort=FIRST_LOOK)
        return self.best(parametrisation, [moved], widen=True)

    def pairs(
        self, singles: Sequence[FittedExplanation], known: Sequence[FittedExplanation] = ()
    ) -> list[FittedExplanation]:
        """Second effects on top of the best explanations by one effect that leave something, the best first.

        Args:
            singles: explanations, the best first.
            known: those among which heads have been chosen before.
        """
        found: list[FittedExplanation] = []
        scores: list[Score] = []
        before = {explanation.explanation for explanation in best_by_effect(known)[: THRESHOLDS.search.pair_heads]}
        # A search that begins at the laws of held levels has explanations by two effects already.
        heads = [explanation for explanation in singles if len(explanation.candidates) == 1]
        for single in best_by_effect(heads)[: THRESHOLDS.search.pair_heads]:
            if single.explanation in before:
                continue
            # Rivals make the same motion, about which an effect does the same.
            scores = self.scores(single, scores)
            if self.leaves_noise_only(single) and not (self.of_records and promise_evidence(scores)):
                continue
            wanted = self.chosen(
                single, scores, THRESHOLDS.search.second_effects, 1, THRESHOLDS.search.second_cost_fall
            )
            found += self._from_other_starts(single, self._added(single, wanted), scores)
        return best_of(found)

    def side_by_side(
        self, singles: Sequence[FittedExplanation], modes: LowLevelModes | None = None
    ) -> list[FittedExplanation]:
        """Two of the effects that explain most alone, together, from what each is alone; the best first.

        Alone each bends the model's parameters, about which the other promises nothing.

        Args:
            singles: explanations, the best first.
            modes: that are measured at low level, where the model's are far from them.
        """
        heads = [each for each in best_by_effect(singles) if len(each.candidates) == 1][:_SIDE_BY_SIDE]
        found = []
        for pair in combinations(heads, 2):
            spreads = tuple(each.fit.parametrisation.spread(0) for each in pair)
            strengths = [each.fit.theta[len(self.parameters) :] for each in pair]
            parametrisation = self.parametrisation(tuple(each.candidates[0] for each in pair), spreads)
            name, theta = StartName.GIVEN, np.concatenate([np.zeros(len(self.parameters)), *strengths])
            if modes is not None:
                name, theta = StartName.MODES, modes.start(parametrisation, theta)[0]
            found.append(self.best(parametrisation, [Start(name, theta)], widen=True))
        return best_of([explanation for explanation in found if explanation is not None])

    def pruned(self, found: Sequence[FittedExplanation]) -> list[FittedExplanation]:
        """What explanations by two effects are without a member that says nothing; only what beats its own whole.

        A first effect may stand in for one that its fit did not reach from rest, and lead there.
        """
        result = []
        for pair in found:
            weak = [k for k in range(len(pair.candidates)) if pair.strength(k) < THRESHOLDS.search.weak_sigmas]
            if len(pair.candidates) != 2 or len(weak) != 1:
                continue
            kept = 1 - weak[0]
            fitted = pair.fit.parametrisation
            parametrisation = self.parametrisation((pair.candidates[kept],), (fitted.spread(kept),))
            theta = np.concatenate([pair.fit.theta[: len(self.parameters)], pair.fit.theta[fitted.index_of(kept)]])
            alone = self.best(parametrisation, [Start(StartName.ALONE, theta, pair.fit)])
            if alone is not None and alone.fit.log_evidence > pair.fit.log_evidence:
                result.append(alone)
        return sorted(result, key=lambda pair: -pair.fit.log_evidence)

    def with_small_effects(
        self, leading: FittedExplanation, others: Sequence[FittedExplanation]
    ) -> list[FittedExplanation]:
        """Other explanations that state an effect, with all small effects of the leading one, fitted to the end."""
        known = {explanation.fitted for explanation in others}
        found = []
        for other in (explanation for explanation in others if explanation.stated):
            both: FittedExplanation | None = other
            for k in sorted(leading.small):
                candidate = leading.candidates[k]
                if both is None or candidate.cause in both.fitted.causes:
                    continue
                start = leading.fit.theta[leading.fit.parametrisation.index_of(k)]
                initial = Score(self.candidates.index(candidate), start, math.nan, math.nan, np.zeros(0))
                both = self.with_added(both, initial, name=StartName.SMALL)
            if both is not None and both.fitted not in known:
                found.append(both)
                known.add(both.fitted)
        return [self.refit(explanation) for explanation in found]

    def fitted(self, base: FittedExplanation, wanted: Sequence[Score]) -> list[FittedExplanation]:
        """Candidates fitted on top of a fit from where the score test puts them, the best first."""
        return self._added(base, [score for score in wanted if score.gain > THRESHOLDS.search.least_cost_fall])

    def _added(self, base: FittedExplanation, wanted: Sequence[Score]) -> list[FittedExplanation]:
        found = [self.with_added(base, score) for score in wanted]
        return best_of([explanation for explanation in found if explanation is not None])

    def _from_other_starts(
        self, base: FittedExplanation, found: Sequence[FittedExplanation], scores: Sequence[Score]
    ) -> list[FittedExplanation]:
        """Explanations by a candidate on top of a fit, the best fitted to the end.

        Where that leaves more than noise, it is fitted from the other starts of its candidate, too: a stiff contact
        that sticks or slides everywhere, for example, leads nowhere.
        """
        if not found:
            return []
        best = self.refit(found[0])
        others: list[Score] = []
        if self.exceeds_noise(best.fit):
            number = self.candidates.index(best.candidates[-1])
            others = [score for score in scores if score.candidate == number][1:_STARTS]
        return [best, *found[1:], *self._added(base, others)]

    def from_modes(self, modes: LowLevelModes) -> list[FittedExplanation]:
        """Explanations by one effect, fitted from where the model's modes are the measured ones; the best first."""
        # The model alone may have been bent towards resonances that it cannot make.
        parametrisation, theta = self.parametrisation(), np.zeros(len(self.parameters))
        begun = [
            (
                self.parametrisation((candidate,)),
                np.concatenate([theta, at_strength(candidate, first, _INITIAL_STRENGTH)]),
            )
            for candidate in self.candidates
            for first in starts_of(candidate)[:1]
        ]
        left = modes.promises(parametrisation, theta, begun)
        # What shifts a mode by many times what is asked of it promises little to first order: each effect has its turn.
        of_effect: dict[str, int] = {}
        promising = []
        for number in np.argsort(left):
            name = begun[number][0].candidates[0].effect.name
            of_effect[name] = of_effect.get(name, 0) + 1
            if math.isfinite(left[number]) and of_effect[name] <= THRESHOLDS.search.first_locations:
                promising.append(begun[number])
        solved = [(wider, *modes.start(wider, values)) for wider, values in promising]
        solved = sorted(solved, key=lambda it: it[2])[
            : THRESHOLDS.search.first_effects * THRESHOLDS.search.first_locations
        ]
        found = [self.best(wider, [Start(StartName.MODES, values)], widen=True) for wider, values, _ in solved]
        return best_of([explanation for explanation in found if explanation is not None])

    @property
    def of_records(self) -> bool:
        """Whether all rows are samples, whose standard deviation is their noise.

        That of windows and lines also bounds errors of the model's form, which the evidence takes for an effect.
        """
        return all(test.record is not None for test in self.data.observations.tests)

    def leaves_noise_only(self, found: FittedExplanation) -> bool:
        """Whether a fit leaves noise only and bends neither parameters nor measuring chain: nothing asks for more."""
        theta, errors = found.fit.theta[: len(self.parameters)], found.fit.errors
        pulls = np.abs(np.concatenate([theta, errors.chain]))
        return not self.data.excess(errors).any() and bool(np.all(pulls < THRESHOLDS.comparison.credible_sigmas))

    def exceeds_noise(self, found: FitResult) -> bool:
        """Whether a fit leaves so much in any group of rows that its parameters are bent by what is missing."""
        learnt = np.isfinite(self.data.groups.degrees)
        scales = np.sqrt(found.errors.squares / np.maximum(self.data.counts, 1.0))
        return bool(np.any(learnt & (scales > THRESHOLDS.search.noise_scale)))

    def refitted_from_model(self, found: FittedExplanation) -> FittedExplanation:
        """An explanation fitted again from the model as given where its fit leaves too much; the better of the two."""
        if not self.exceeds_noise(found.fit):
            return found
        theta = found.fit.theta.copy()
        theta[: len(self.parameters)] = 0.0
        afar = Start(StartName.GIVEN, theta, coarse=True)
        return self.best(found.fit.parametrisation, [afar], found, widen=True) or found
