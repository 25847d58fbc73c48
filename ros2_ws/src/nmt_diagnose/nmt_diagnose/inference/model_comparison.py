"""The comparison of explanations: scan all candidates, fit the promising ones, add a second where one leaves more.

Everything is judged on the same rows. The model without effect, its own parameters re-fitted, always competes.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from itertools import count

import numpy as np

from nmt_core.arrays import BoolArray, FloatArray
from nmt_diagnose.effects.effect import Candidate
from nmt_diagnose.effects.placement import Explanation
from nmt_diagnose.inference.candidate_starts import (
    at_strength,
    at_zero,
    other_shapes,
    starts_of,
    strength_parameter,
)
from nmt_diagnose.inference.explanation_fits import ExplanationFits
from nmt_diagnose.inference.fit import Fit
from nmt_diagnose.inference.fitted_model import (
    FittedModel,
    best_by_effect,
    rms_left,
    united,
    without_member,
)
from nmt_diagnose.inference.other_points import at_other_points
from nmt_diagnose.inference.physical_limits import beyond_limits, incredible
from nmt_diagnose.inference.progress import Told
from nmt_diagnose.inference.scan import Direction, Score, scores
from nmt_diagnose.inference.workers import Workers

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
# Rms of what one explanation leaves, over that of the best, from which its refits need not reach an optimum.
_BEHIND = 4.0
# Candidates whose directions are found in one piece of work.
_TOGETHER = 16


class ModelComparison:
    """Compares explanations of one set of observations.

    Args:
        fits: fits them.
        progress: called with a sentence as the work goes on.
        workers: processes that share the work; None = this one alone.
    """

    def __init__(
        self,
        fits: ExplanationFits,
        progress: Callable[[str], None] | None = None,
        workers: Workers | None = None,
    ) -> None:
        self.fits = fits
        self.workers = Workers() if workers is None else workers
        self._progress = progress or _silent
        self._found: dict[str, float] = {}
        # Explanations that started again from the parameters as given and came no further.
        self._in_vain: set[Explanation] = set()
        # The best explanations whose effect was tried at all other points.
        self._spread_from: set[Explanation] = set()
        self._plain_directions: list[Direction] = []

    def started(self, wanted: Sequence[tuple[int, FloatArray]]) -> list[FittedModel]:
        """Candidates of given numbers alone, fitted from all parameters, shape (n,); those without fit are left out."""
        return [found for found in self.workers.map(_started, self.fits, wanted) if found is not None]

    def added_at(self, base: FittedModel, starts: Sequence[tuple[int, float]]) -> list[FittedModel]:
        """Candidates of given numbers, each fitted from a strength on top of a model; best first."""
        wanted = []
        for number, strength in starts:
            candidate = self.fits.candidates[number]
            start = at_strength(candidate, starts_of(candidate)[0], strength)
            direction = Direction(number, start, np.zeros(self.fits.problem.size), strength_parameter(candidate).signed)
            wanted.append((base, Score(direction, strength, 0.0, 0.0, 0.0)))
        added = [found for found in self._all_added(wanted) if found is not None]
        return sorted(added, key=lambda found: -found.fit.log_evidence)

    def restarted(self, null: FittedModel, others: Sequence[FittedModel]) -> FittedModel:
        """The model without effect fitted again from where the best others stand, if that is better.

        Far from the model as given the first fit may stop in a fold of its own; then anything else looks better.
        """
        best = null
        for found in self.workers.map(_restarted_from, (self.fits, null), others):
            if found is not None and found.log_evidence > best.fit.log_evidence + 0.5:
                best = FittedModel((), found)
        return best

    def scan(self, base: FittedModel) -> list[Score]:
        """Score all candidates on top of a fitted model, best first.

        A weak effect bends the directions of the others so little that those of the model without effect serve again.
        """
        if base.candidates and self._plain_directions and base.sigmas < self.fits.settings.weak:
            kept = [d for d in self._plain_directions if not _has(base, self.fits.candidates[d.candidate])]
            return scores(base.fit, kept, len(self.fits.calibration))
        found = self.directions(base)
        if not base.candidates:
            self._plain_directions = found
            self._found.clear()
        return scores(base.fit, found, len(self.fits.calibration))

    def directions(self, base: FittedModel) -> list[Direction]:
        """Directions of all candidates that the fitted model does not have yet."""
        numbers = [k for k, candidate in enumerate(self.fits.candidates) if not _has(base, candidate)]
        starts = {k: starts_of(self.fits.candidates[k]) for k in numbers}
        pieces: list[tuple[list[int], list[FloatArray]]] = []
        for turn in range(max((len(values) for values in starts.values()), default=0)):
            chosen = [k for k in numbers if len(starts[k]) > turn]
            for first in range(0, len(chosen), _TOGETHER):
                own = chosen[first : first + _TOGETHER]
                pieces.append((own, [starts[k][turn] for k in own]))
        return [found for piece in self.workers.map(_directions_of, (self.fits, base), pieces) for found in piece]

    def all_refits(self, wanted: Sequence[tuple[FittedModel, BoolArray]]) -> list[FittedModel | None]:
        """``refit`` of several explanations to rows of their own."""
        least = min((rms_left(own) for own, _ in wanted), default=0.0)
        items = [(own, used, bool(own.candidates) and rms_left(own) > _BEHIND * least) for own, used in wanted]
        return self.workers.map(_refitted, self.fits, items, weight=_labour)

    def singles(
        self, base: FittedModel, found: Sequence[Score], known: Sequence[FittedModel] = ()
    ) -> list[FittedModel]:
        """Fit the candidates that promise most, best evidence first.

        Args:
            base: what they are added to.
            found: scores, best first.
            known: fits of candidates to the same rows under other noise or from elsewhere; the best go on from there.
        """
        settings = self.fits.settings
        chosen: dict[tuple[str, str], list[Score]] = {}
        best = found[0].gain if found else 0.0
        going = self._going_on(known)
        # What is known to explain the gap leaves no room for what explains a small part of it.
        known_gain = 2.0 * max((own.fit.log_evidence - base.fit.log_evidence for own in going), default=0.0)
        least = max(settings.least_gain, min(best - settings.behind, settings.share * best), _ENOUGH * known_gain)
        for score in found:
            if score.gain < least:
                break
            effect = self.fits.candidates[score.direction.candidate].effect
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
        continued = self.workers.map(_continued, self.fits, known[:_CARRIED])
        return [own for own in continued if own is not None]

    def _all_added(self, wanted: Sequence[tuple[FittedModel, Score]]) -> list[FittedModel | None]:
        """Candidates fitted on top of fitted models; None where the model cannot be solved with one."""

        begun = count()

        def told(item: tuple[FittedModel, Score]) -> None:
            base, score = item
            name = self.fits.candidates[score.direction.candidate].label
            what = f"fitting {base.explanation.label} with {name}" if base.candidates else f"fitting {name}"
            self._progress(Told(what, next(begun), len(wanted)))

        return self.workers.map(_added, self.fits, wanted, told)

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
            alone = self.fits.without(pair, weakest)
            if alone is not None and alone.fit.log_evidence > known + 0.5:
                better = [own for own in better if own.explanation != alone.explanation] + [alone]
        return sorted(better, key=lambda own: -own.fit.log_evidence), kept

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
        if leader.fit.log_evidence < alone + 0.5 * self.fits.settings.pair_gain:
            return found
        return found + self._partners_of([_member(leader, 1)], {*skipped, *(own.explanation for own in found)})

    def _partners_of(
        self, heads: Sequence[tuple[Candidate, float]], skipped: Collection[Explanation]
    ) -> list[FittedModel]:
        """Effects, each with the spread of its strength, with all of the other kind at the same point."""
        wanted: dict[Explanation, tuple[tuple[Candidate, ...], tuple[float, ...], FloatArray]] = {}
        for own, spread in heads:
            for other in self.fits.candidates:
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
        found = self.workers.map(_approached_together, self.fits, list(wanted.values()))
        return [own for own in found if own is not None]

    def _settled(self, fitted_models: list[FittedModel]) -> list[FittedModel]:
        """Those near the best fitted to the end with sensitivities of their own, best evidence first.

        Sensitivities carried over from another fit lead to nearly the right estimate only.
        """
        ordered = sorted(fitted_models, key=lambda fitted_model: -fitted_model.fit.log_evidence)
        if not ordered:
            return []
        limit = ordered[0].fit.log_evidence - self.fits.settings.close
        near = [own for own in ordered[: self.fits.settings.settled] if own.fit.log_evidence >= limit]
        self._progress(Told(f"fitting the best {len(near)} to the end", ranking=self._standing(ordered)))
        ended = sorted(self.workers.map(_ended, self.fits, near), key=lambda own: -own.fit.log_evidence)
        # Starting again takes longest, and the last of them would have to overtake all others by it.
        stuck = [
            number
            for number, own in enumerate(ended[:_RESTARTED])
            if self.fits.wants_restart(own.fit) and own.explanation not in self._in_vain
        ]
        again = self.workers.map(_polished, self.fits, [ended[number] for number in stuck])
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
                chosen = [(own, theta) for theta in starts[first : first + _AT_ONCE]]
                tried = self.workers.map(_reshaped, self.fits, chosen)
                for trial in tried:
                    if trial is not None and trial.fit.log_evidence > best.fit.log_evidence + 0.5:
                        best = trial
                if rms_left(best) <= _LEAVES:
                    break
            if best is not own:
                better[own.explanation] = best
        # Starting again takes longest; what another shape left far behind the best need not.
        most = max((own.fit.log_evidence for own in (*found, *better.values())), default=0.0)
        limit = most - self.fits.settings.close
        near = [own for own in better.values() if own.fit.log_evidence >= limit]
        far = [own for own in better.values() if own.fit.log_evidence < limit]
        again = [*self.workers.map(_polished, self.fits, near), *self.workers.map(_ended, self.fits, far)]
        ended = {own.explanation: own for own in again}
        kept = [own for own in found if own.explanation not in ended]
        return sorted((*ended.values(), *kept), key=lambda fitted_model: -fitted_model.fit.log_evidence)

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
        settings = self.fits.settings
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
                second = self.fits.candidates[score.direction.candidate]
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


def _restarted_from(shared: tuple[ExplanationFits, FittedModel], other: FittedModel) -> Fit | None:
    fits, null = shared
    return fits.null_from(null, other)


def _directions_of(
    shared: tuple[ExplanationFits, FittedModel], piece: tuple[list[int], list[FloatArray]]
) -> list[Direction]:
    fits, base = shared
    return fits.directions(base, *piece)


def _added(fits: ExplanationFits, item: tuple[FittedModel, Score]) -> FittedModel | None:
    return fits.add(*item)


def _approached_together(
    fits: ExplanationFits, item: tuple[tuple[Candidate, ...], tuple[float, ...], FloatArray]
) -> FittedModel | None:
    return fits.together(*item)


def _started(fits: ExplanationFits, item: tuple[int, FloatArray]) -> FittedModel | None:
    return fits.started(*item)


def _continued(fits: ExplanationFits, fitted_model: FittedModel) -> FittedModel | None:
    return fits.gone_on(fitted_model)


def _polished(fits: ExplanationFits, fitted_model: FittedModel) -> FittedModel:
    return fits.polished(fitted_model)


def _ended(fits: ExplanationFits, fitted_model: FittedModel) -> FittedModel:
    return fits.polished(fitted_model, restarts=False)


def _reshaped(fits: ExplanationFits, item: tuple[FittedModel, FloatArray]) -> FittedModel | None:
    return fits.from_shape(*item)


def _refitted(fits: ExplanationFits, item: tuple[FittedModel, BoolArray, bool]) -> FittedModel | None:
    return fits.refit(*item)


def _labour(item: tuple[FittedModel, BoolArray, bool]) -> float:
    """How much work a refit is likely to be: those that have not reached an optimum go on longest."""
    fitted_model, used, _ = item
    return fitted_model.fit.theta.size * float(used.sum()) * (1.0 if fitted_model.fit.converged else 10.0)


def _silent(_: str) -> None:
    """Report nothing."""
