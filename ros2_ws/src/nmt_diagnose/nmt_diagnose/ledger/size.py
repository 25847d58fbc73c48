"""How large a gap is in engineering terms, and whether that matters."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import lsq_linear
from scipy.special import chdtrc, chdtri, ndtr

from nmt_core.numerics.arrays import BoolArray, FloatArray
from nmt_core.text.number_words import significant
from nmt_diagnose.fit.candidate_starts import at_zero, strength_parameter
from nmt_diagnose.fit.explanations import FittedExplanation
from nmt_diagnose.fit.fitting import Data, FitResult, chain_errors_at, predicted
from nmt_diagnose.fit.noise import channel_sizes, sigma_of
from nmt_diagnose.ledger.row import Facts
from nmt_diagnose.ledger.row_scatter import row_scatter
from nmt_diagnose.ledger.rules import LEFT, MATTERS, NEEDED, OF_EFFECTS, WITHIN, pass_all
from nmt_diagnose.measurements.measurement import Observations, is_broad_band, locked_levels
from nmt_diagnose.observations.observables import Natural, Part, parts_where, with_natural
from nmt_diagnose.prediction.rig_parts import same_motion
from nmt_diagnose.thresholds import THRESHOLDS

_PERCENT = 100.0
_SENSORS = ("response_sensor", "force_sensor")
# Of an implausible chain, the furthest first.
_NAMED_ERRORS = 3


@dataclass(frozen=True)
class Size:
    """Largest change that an explanation makes in each kind of observable, relative.

    Attributes:
        values: by kind of ``MATTERS``; kinds without rows are left out.
        other: it changes rows that have no such size, such as lines of the mains, so that they show it.
    """

    values: Mapping[str, float]
    other: bool

    def sentence(self, wanted: Mapping[str, float]) -> str:
        """Sentence on the size, which depends on the limits that matter by kind."""
        if matters(self, wanted):
            size = f" of up to {self.words}" if self.values else ""
            return f"The recordings hint at a difference{size}, which lies within their noise and tolerances."
        return f"The recordings show a difference beyond their noise that is smaller than what matters: {self.words}."

    @property
    def words(self) -> str:
        """The size by kind of observable."""
        return ", ".join(f"{_PERCENT * value:.2g} % of {SIZE_NAMES[kind]}" for kind, value in self.values.items())


SIZE_NAMES = {
    "frequency": "the frequency",
    "damping": "the damping",
    "response": "a response",
    "harmonics": "the fundamental in harmonics",
}


def _parts_of(kind: str) -> tuple[Part, ...]:
    """Row parts whose size is judged as one kind."""
    return parts_where(lambda facts: facts.matters == kind)


def measured_size(data: Data, found: FittedExplanation, members: Sequence[int] = ()) -> Size:
    """How far an explanation lies from itself without its effects, at the level or line where they differ most.

    Args:
        data: what was fitted.
        found: the explanation.
        members: numbers of the effects that are taken away; empty = as :func:`without_strength`.
    """
    fitted = found.fit
    without = predicted(data, fitted.parametrisation, without_strength(found, members), fitted.prediction)
    if without is None:  # it has no solution without them
        return Size({}, True)
    return change_size(data, data.forward.difference(fitted.prediction.values, without.values))


@dataclass(frozen=True)
class Objection:
    """Residual beyond noise in a group of rows, an implausible parameter of the model, or an imitation.

    Attributes:
        group: test and kind of row; name of the parameter; empty of an imitation.
        kind: kind of the size that matters; empty for a parameter and an imitation.
        size: relative, what noise makes taken off; of a parameter standard deviations of its prior.
        over: size over what matters.
    """

    group: str
    kind: str
    size: float
    over: float = math.inf

    @property
    def sentence(self) -> str:
        """What speaks against an explanation as the whole of a gap, without a full stop."""
        if not self.group:
            return "two laws together can imitate one that the library lacks"
        consequence = ", so something unnamed acts too"
        if not self.kind:
            return f"it takes {self.group} {self.size:.1f} standard deviations from its prior value{consequence}"
        size = f"{significant(_PERCENT * self.size, 2)} % of {SIZE_NAMES[self.kind]}"
        return f"{size} ({self.group}) remain that it does not explain{consequence}"


IMITATION = Objection("", "", 0.0)
"""Two laws of the structure, which take the shape of a third."""


def left_over(
    data: Data, found: FittedExplanation, wanted: Mapping[str, float], loop: bool = False
) -> tuple[Objection, ...]:
    """Groups whose residual exceeds noise and matters, the largest over its limit first.

    Arguments as of :func:`left_sizes`.
    """
    return tuple(left for left in left_sizes(data, found, wanted, loop) if not LEFT(Facts(left=left.over)).passed)


def left_sizes(
    data: Data, found: FittedExplanation, wanted: Mapping[str, float], loop: bool = False
) -> tuple[Objection, ...]:
    """Groups whose residual exceeds noise, the largest over its limit first.

    A group counts where its scale is larger than its prior allows (Fisher's F, Bonferroni). Its size is the residual
    beyond the noise of its rows at some level or tenth of the lines. The phase where a loop truly stood is an input of
    the model: its residual speaks against the controller and nothing else.

    Args:
        data: what was fitted.
        found: the explanation.
        wanted: what matters, by kind.
        loop: whether the phases that loops held count.
    """
    errors, groups, rows = found.fit.errors, data.groups, data.observations.rows
    result = []
    raw = data.residual(found.fit.prediction.values, errors.chain)
    for number in np.flatnonzero(data.excess(errors)):
        selected = data.used & (groups.of == number)
        if not loop and np.all(rows.part[selected] == Part.PHASE_ERROR):
            continue
        kind = next((kind for kind in SIZE_NAMES if np.isin(rows.part[selected], _parts_of(kind)).any()), "")
        if not kind:
            continue
        keys = np.stack([rows.channel[selected], _band(rows.level[selected], rows.test[selected])])
        _, block = np.unique(keys, axis=1, return_inverse=True)
        block, residual = block.ravel(), raw[selected]
        count = np.bincount(block).astype(np.float64)
        beyond = np.bincount(block, residual**2 - 1.0)
        beyond = np.where(beyond > THRESHOLDS.verdict.excess_sigmas * np.sqrt(2.0 * count), beyond, 0.0)
        natural = Part(int(rows.part[selected][0])).facts.natural
        unit = np.abs(data.observations.values[selected]) if natural is Natural.VALUE else np.ones(residual.size)
        sizes = np.sqrt(beyond / np.maximum(np.bincount(block, (unit / data.sigma[selected]) ** 2), 1e-300))
        if natural is Natural.RMS:
            sizes = sizes / max(float(np.sqrt(np.mean(data.observations.values[selected] ** 2))), 1e-300)
        size = float(sizes.max())
        if size > 0.0:
            result.append(Objection(groups.names[number], kind, size, _over(size, wanted.get(kind, 0.0))))
    return tuple(sorted(result, key=lambda left: -left.size / max(wanted.get(left.kind, 0.0), 1e-300)))


def largest_left(data: Data, found: FittedExplanation, wanted: Mapping[str, float], loop: bool = False) -> float:
    """Largest that an explanation leaves beyond noise, over what matters; arguments as of :func:`left_sizes`.

    Lines of the mains, steps, limits and lost samples count over what stands out.
    """
    sized = np.isin(data.observations.rows.part, parts_where(lambda facts: bool(facts.matters)))
    other = np.abs(data.residual(found.fit.prediction.values, found.fit.errors.chain)[data.used & ~sized])
    stands_out = float(other.max(initial=0.0)) / THRESHOLDS.verdict.visible_sigmas
    return max([stands_out, *(left.over for left in left_sizes(data, found, wanted, loop))])


def contradiction(
    data: Data, found: FittedExplanation, wanted: Mapping[str, float], noise: float = math.inf
) -> Objection | None:
    """The largest residual that matters, if the whole residual is visibly more than noise; or None.

    Such a residual forbids the verdict "no gap", however probable that came out. The learnt scale may have absorbed a
    misfit, so the noise is limited to the scatter of neighbouring rows. Arguments as of :func:`left_over`.

    Args:
        noise: largest scale of the noise of samples, as a law leaves it of rows that it was not read from.
    """
    errors = found.fit.errors
    rows, groups = data.observations.rows, data.groups.of
    largest = row_scatter(data.observations, errors.values, data.sigma).largest_scale(groups, len(data.counts))
    # Each line of a recorded random test brings the noise of its own neighbourhood, each window its own.
    recorded = [is_broad_band(test) and np.ptp(test.span_s or (0.0,)) > 0.0 for test in data.observations.tests]
    known = np.array(recorded)[rows.test] | (np.isinf(largest)[groups] & (rows.part != Part.SAMPLE))
    limited = np.unique(groups[data.used & known])
    largest[limited] = np.minimum(largest[limited], THRESHOLDS.verdict.credible_noise_scale**2)
    samples = np.unique(groups[data.used & (rows.part == Part.SAMPLE)])
    largest[samples] = np.minimum(largest[samples], max(noise, 1.0) ** 2)
    weights = np.maximum(errors.weights, 1.0 / largest[groups])
    left = (errors.residual * np.sqrt(weights))[data.used]
    if not left.size or float(np.sqrt(np.mean(left**2))) <= THRESHOLDS.verdict.left_over_scale:
        return None
    return next(iter(left_over(data, found, wanted)), None)


def implausible_parameters(data: Data, found: FittedExplanation) -> tuple[tuple[Objection, ...], float]:
    """The model's own parameter furthest from its prior mean, where that is improbable (Bonferroni).

    Beyond some value a parameter may have no further influence, such as the damping of modes that do not show at all.
    A parameter whose return to a plausible value changes nothing that matters is not objected to.

    Returns:
        None or one, and the probability that any of them is as far.
    """
    parameters = found.fit.parametrisation.calibration
    if not parameters:
        return (), 1.0
    theta = np.abs(found.fit.theta[: len(parameters)])
    worst = int(np.argmax(theta))
    chance = min(1.0, len(parameters) * 2.0 * float(ndtr(-theta[worst])))
    if chance >= THRESHOLDS.comparison.incredible_probability:
        return (), chance
    credible = found.fit.theta.copy()
    credible[worst] = math.copysign(THRESHOLDS.comparison.credible_sigmas, credible[worst])
    there = predicted(data, found.fit.parametrisation, credible, found.fit.prediction)
    if there is not None:
        change = data.forward.difference(found.fit.prediction.values, there.values)
        if not matters(change_size(data, change), data.observations.matters):
            return (), 1.0
    return (Objection(parameters[worst].name, "", float(theta[worst])),), chance


OwnChain = Callable[[FittedExplanation], tuple[Data, FittedExplanation]]
"""Rows and chain about an explanation, and its fit to them."""


def needed(
    data: Data,
    found: FittedExplanation,
    simpler: Sequence[FittedExplanation],
    wanted: Mapping[str, float],
    own_chain: OwnChain | None = None,
) -> FittedExplanation:
    """An explanation with those of its effects marked as small that it does not need.

    Args:
        data: what was fitted.
        found: the explanation.
        simpler: fits that may have some of its effects only, the model alone among them.
        wanted: what matters, by kind.
        own_chain: of simpler ones; None = they have the chain of ``data``.
    """
    causes, small, facts = set(found.fitted.causes), set(found.small), _beyond_ordinary(data, found)
    small |= {number for number, of_effect in facts.items() if not NEEDED(of_effect).passed}
    parts = [less for less in simpler if set(less.fitted.causes) < causes]
    for less in sorted(parts, key=lambda part: (len(part.candidates), -part.fit.log_evidence)):
        comparison = compared_with_simpler(data, found, less, wanted, own_chain)
        added = {k for k, candidate in enumerate(found.candidates) if candidate.cause not in less.fitted.causes}
        if not pass_all(OF_EFFECTS, comparison):
            small |= added
            facts |= dict.fromkeys(added, comparison)
            break
        facts |= dict.fromkeys(added - facts.keys(), comparison)
    # With an effect that is not needed the others may look necessary: they are judged without it.
    kept = {candidate.cause: k for k, candidate in enumerate(found.candidates) if k not in small}
    alone = [less for less in parts if small and set(less.fitted.causes) == set(kept)]
    if kept and alone:
        best = needed(data, max(alone, key=lambda less: less.fit.log_evidence), simpler, wanted, own_chain)
        own = {kept[candidate.cause]: k for k, candidate in enumerate(best.candidates)}
        small |= {number for number, k in own.items() if k in best.small}
        facts |= {number: best.comparisons[k] for number, k in own.items() if k in best.comparisons}
    return replace(found, small=frozenset(small), comparisons=facts)


def _beyond_ordinary(data: Data, found: FittedExplanation) -> dict[int, Facts]:
    """How much larger effects are than in an ordinary measuring chain, of those that every chain has; by number."""
    result: dict[int, Facts] = {}
    if not data.tolerances.any():
        return result
    for number, candidate in enumerate(found.candidates):
        if candidate.effect.ordinary > 0.0:
            values = found.fit.parametrisation.values(found.fit.theta, number)
            largest = THRESHOLDS.comparison.credible_sigmas * candidate.effect.ordinary
            result[number] = Facts(left_without=abs(values[strength_parameter(candidate).name]) / largest)
    return result


def compared_with_simpler(
    data: Data,
    more: FittedExplanation,
    less: FittedExplanation,
    wanted: Mapping[str, float],
    own_chain: OwnChain | None = None,
) -> Facts:
    """What the additional effects of an explanation do, as rules ask for it.

    The simpler explanation leaves a residual beyond noise that matters, and the predictions differ. Or it fits only by
    implausible parameters or an implausible measuring chain, and leaves such a residual without these. An effect of a
    sensor, such as its gain, is itself the finding on the chain. An effect that the evidence demands is present, even
    where refitted parameters leave little residual in its place: whether it matters is the size of its own change.
    """
    numbers = _added(more, less)
    loop = any(more.candidates[k].site.location.kind == "controller" for k in numbers)
    left, of_less, alone = largest_left(data, less, wanted, loop), data, less
    if left < 1.0 and own_chain is not None:
        of_less, alone = own_chain(less)
        left = largest_left(of_less, alone, wanted, loop)
    evidence = more.fit.log_evidence - max(less.fit.log_evidence, alone.fit.log_evidence)
    share = evidence / THRESHOLDS.verdict.sure_log_evidence
    if left >= 1.0 or share >= 1.0:
        between = data.forward.difference(more.fit.errors.values, alone.fit.errors.values)
        change = over(change_size(data, between), wanted) if left >= 1.0 else 0.0
        # Refitted parameters and errors of the chain may take the place of an effect that the evidence demands.
        if change < 1.0 <= share:
            change = max(change, over(measured_size(data, more, numbers), wanted))
        return Facts(left_without=max(left, share), change=change)
    relieved = relief(data, more, less, wanted)
    if relieved.left_without < max(left, 1.0):
        return replace(relieved, left_without=max(left, relieved.left_without))
    if all(more.candidates[k].site.location.kind in _SENSORS for k in numbers):
        return relieved
    return replace(relieved, left_within=left_within_belief(of_less, alone, wanted, loop))


def is_demanded(found: FittedExplanation, null: FittedExplanation) -> bool:
    """Whether the evidence demands the effects of an explanation, however little these change.

    What a sensor adds to its channel and not to the motion is a question of its calibration and never demanded.
    """
    sensors = [k for k, candidate in enumerate(found.candidates) if candidate.site.location.kind in _SENSORS]
    rig = found.fit.parametrisation.rig(found.fit.theta) if sensors else None
    if rig is not None and any(
        same_motion(rig, found.fit.parametrisation.rig(without_strength(found, (number,)))) for number in sensors
    ):
        return False
    needs = (found.comparisons.get(number, Facts(left_without=0.0)) for number in range(len(found.candidates)))
    surely = found.fit.log_evidence - null.fit.log_evidence >= THRESHOLDS.verdict.sure_log_evidence
    return surely and all(pass_all((NEEDED, WITHIN), facts) for facts in needs)


def relief(data: Data, more: FittedExplanation, less: FittedExplanation, wanted: Mapping[str, float]) -> Facts:
    """By how much effects move model and measuring chain back to their priors, and whether the effects matter.

    Several errors of 3 standard deviations with one cause are plausible one by one and not together.
    """
    fall = (prior_misfit(data, less) - prior_misfit(data, more)) / relief_that_counts(data, less)
    change = math.nan if fall < 1.0 else over(measured_size(data, more, _added(more, less)), wanted)
    return Facts(left_without=fall, change=change)


def _added(more: FittedExplanation, less: FittedExplanation) -> tuple[int, ...]:
    """Numbers of the effects that an explanation has and another lacks."""
    return tuple(k for k, candidate in enumerate(more.candidates) if candidate.cause not in less.fitted.causes)


def prior_misfit(data: Data, found: FittedExplanation) -> float:
    """Prior misfit of a fit: squared distance of model parameters and chain errors from their priors, −2 ln p."""
    believed = _believed(data, found)
    return float(believed @ believed)


def relief_that_counts(data: Data, found: FittedExplanation) -> float:
    """Smallest significant drop of the prior misfit by one added effect: χ², 1 degree of freedom, Bonferroni."""
    count = _believed(data, found).size
    return float(chdtri(1, THRESHOLDS.comparison.incredible_probability / max(count, 1)))


def furthest_chain_error(data: Data, found: FittedExplanation) -> float:
    """The largest error of the measuring chain, in tolerances; 0 where nothing has one."""
    return float(np.abs(found.fit.errors.chain[np.flatnonzero(data.tolerances)]).max(initial=0.0))


def implausible_chain(data: Data, found: FittedExplanation, wanted: Mapping[str, float]) -> tuple[str, ...]:
    """A sentence on errors of the measuring chain that are implausible together; else none.

    Each is named with its distance in tolerances and, where it changes what has a size, with what it does there.
    """
    errors = found.fit.errors.chain
    believed = np.flatnonzero(data.tolerances)
    if not believed.size:
        return ()
    squares = errors[believed] ** 2
    chance = float(chdtrc(believed.size, squares.sum()))
    furthest = min(1.0, believed.size * 2.0 * float(ndtr(-math.sqrt(squares.max(initial=0.0)))))
    if min(chance, furthest) >= THRESHOLDS.comparison.incredible_probability:
        return ()
    parts = []
    for j in believed[np.argsort(-squares)][:_NAMED_ERRORS]:
        size = change_size(data, (data.chain + data.added)[:, j] * errors[j])
        kind = max(size.values, key=lambda kind: _over(size.values[kind], wanted.get(kind, 0.0)), default="")
        does = f" ({significant(_PERCENT * size.values[kind], 2)} % of {SIZE_NAMES[kind]})" if kind else ""
        parts.append(f"{data.chain_names[j]} {abs(float(errors[j])):.1f} tolerances{does}")
    return (
        f"The errors of the measuring chain are implausible: {', '.join(parts)}; nothing is left that matters "
        "where it stays within three, so no effect is claimed for it.",
    )


def _believed(data: Data, found: FittedExplanation) -> FloatArray:
    """Parameters of the model and errors of the chain that have a tolerance, in standard deviations of that."""
    parameters = found.fit.theta[: len(found.fit.parametrisation.calibration)]
    return np.concatenate([parameters, found.fit.errors.chain[data.tolerances]])


def leaves_something(data: Data, found: FittedExplanation, wanted: Mapping[str, float], loop: bool = False) -> bool:
    """Whether a fit leaves more than noise that matters, or would with model and chain held within their priors.

    Arguments as of :func:`left_over`.
    """
    if largest_left(data, found, wanted, loop) >= 1.0:
        return True
    return left_within_belief(data, found, wanted, loop) >= 1.0


def left_within_belief(data: Data, found: FittedExplanation, wanted: Mapping[str, float], loop: bool = False) -> float:
    """The residual of a fit with model and chain held within their priors, over what matters.

    Arguments as of :func:`left_over`.
    """
    key = id(found.fit), loop, tuple(wanted.items())
    if key not in data.known:
        within = within_belief(data, found.fit)
        held = None if within is None else FittedExplanation(found.candidates, within)
        data.known[key] = math.inf if held is None else largest_left(data, held, wanted, loop)
    return data.known[key]


def change_size(data: Data, change: FloatArray) -> Size:
    """Size of a change of the rows of a fit, (m,), in their own units; see `size_of_change`."""
    return size_of_change(data.observations, data.used, data.sigma, change)


def size_of_change(observations: Observations, used: BoolArray, sigma: FloatArray, change: FloatArray) -> Size:
    """Size of a change of the rows, (m,), in their own units.

    Rows of a level or tenth of the lines count together, each weighted by its certainty: a line of a response that is
    nearly zero carries little information. Samples of a record count by the rms of all of them.

    Args:
        observations: the rows and their values.
        used: rows that count, (m,).
        sigma: uncertainties, (m,).
        change: of the values, (m,).
    """
    rows, measured = observations.rows, observations.values
    change = np.nan_to_num(change)
    values: dict[str, float] = {}
    known = np.zeros(len(rows), dtype=bool)
    for kind in SIZE_NAMES:
        selected = used & np.isin(rows.part, _parts_of(kind))
        known |= selected
        if not selected.any():
            continue
        relative_change = np.abs(change[selected])
        keys = np.stack([rows.test[selected], rows.channel[selected], _band(rows.level[selected], rows.test[selected])])
        of_value = np.isin(rows.part[selected], with_natural(Natural.VALUE))
        relative_change = relative_change / np.where(of_value, np.maximum(np.abs(measured[selected]), 1e-12), 1.0)
        _, group = np.unique(keys, axis=1, return_inverse=True)
        group = group.ravel()
        weight = sigma[selected] ** -2.0
        squares = np.bincount(group, weight * relative_change**2) / np.bincount(group, weight)
        records = np.isin(rows.part[selected], with_natural(Natural.RMS))
        if records.any():
            mean_squares = np.bincount(group, np.where(records, measured[selected] ** 2, 0.0)) / np.bincount(group)
            squares = np.where(mean_squares > 0.0, squares / np.maximum(mean_squares, 1e-300), squares)
        values[kind] = float(np.sqrt(np.max(squares)))
    unsized = used & ~known
    return Size(values, bool(np.any(np.abs(change[unsized] / sigma[unsized]) > THRESHOLDS.verdict.visible_sigmas)))


def without_strength(found: FittedExplanation, members: Sequence[int] = ()) -> FloatArray:
    """θ of an explanation with some effects at zero strength: ``members``, else those it needs, else all."""
    theta = found.fit.theta.copy()
    for number in members or found.stated or range(len(found.candidates)):
        candidate = found.candidates[number]
        selected = found.fit.parametrisation.index_of(number)
        theta[selected] = at_zero(candidate, theta[selected])
    return theta


def _band(level: np.ndarray, test: np.ndarray) -> np.ndarray:
    """Levels, or tenths of many lines."""
    result = level.copy()
    for number in np.unique(test):
        selected = test == number
        most = int(level[selected].max()) + 1
        if most > THRESHOLDS.verdict.many_levels:
            result[selected] = level[selected] * 10 // most
    return result


def matters(size: Size, wanted: Mapping[str, float]) -> bool:
    """Whether any kind of observable changes by as much as matters; what has no size always does."""
    return MATTERS(Facts(change=over(size, wanted))).passed


def over(size: Size, wanted: Mapping[str, float]) -> float:
    """Largest change of any kind of observable over what matters of it."""
    if size.other:
        return math.inf
    return max((_over(value, wanted.get(kind, 0.0)) for kind, value in size.values.items()), default=0.0)


def _over(size: float, wanted: float) -> float:
    return size / wanted if wanted > 0.0 else math.inf


def large_lines(observations: Observations, wanted: float) -> BoolArray:
    """Lines of the mains, (m,), of channels where they are a share of the fundamental in the median level.

    None where no line stands out of noise and tolerances.

    Args:
        observations: what was read.
        wanted: that share.
    """
    rows = observations.rows
    lines = np.flatnonzero(rows.part == Part.LINE)
    share = np.full(lines.size, np.inf)
    for number, row in enumerate(lines):
        test = observations.tests[rows.test[row]]
        levels = locked_levels([test])
        sizes = levels[rows.level[row]].fundamentals[rows.channel[row] :][:1] if levels else ()
        sizes = sizes or channel_sizes(observations, int(rows.test[row]), int(rows.channel[row]))
        if len(sizes) and (size := float(np.median(sizes))) > 0.0:
            share[number] = observations.values[row] / size
    large = np.zeros(len(rows), dtype=bool)
    keys = np.stack([rows.test[lines], rows.channel[lines], np.round(rows.frequency_hz[lines]).astype(np.int64)])
    for key in np.unique(keys, axis=1).T:
        same = np.all(keys == key[:, None], axis=0)
        large[lines[same]] = np.median(share[same]) >= wanted
    sizes = np.abs(observations.values[large]) / sigma_of(observations)[large]
    large &= bool(sizes.max(initial=0.0) > THRESHOLDS.comparison.credible_sigmas)
    return large


def within_belief(data: Data, fitted: FitResult) -> FitResult | None:
    """A fit with the model's parameters and the chain's tolerances within three standard deviations of their priors.

    A fit takes a gain of 1 % to 2.5 % and a spring five standard deviations away where that saves more than it costs.
    No row counts as more certain than its stated noise: a smaller learnt scale may not move parameters away from their
    priors. The limits are found with the derivatives of the fit.

    Args:
        data: what was fitted.
        fitted: its parameters of effects stay free.

    Returns:
        The fit itself where it keeps the limits; None where the model has no solution within them.
    """
    limit, errors, count = THRESHOLDS.comparison.credible_sigmas, fitted.errors, fitted.theta.size
    now = np.concatenate([fitted.theta, errors.chain])
    model = np.arange(count) < len(fitted.parametrisation.calibration)
    held = np.concatenate([model, data.tolerances])
    if not np.any(np.abs(now[held]) > limit):
        return fitted
    columns = np.column_stack([fitted.jacobian, errors.slopes])
    weights = np.minimum(errors.weights, 1.0)
    precision = np.concatenate([fitted.parametrisation.prior_std**-2.0, np.ones(errors.chain.size)])
    root = cholesky(columns.T @ (weights[:, None] * columns) + np.diag(precision), lower=True)
    gradient = columns.T @ (weights * errors.residual) - precision * now
    low, high = (np.where(held, side * limit - now, side * np.inf) for side in (-1.0, 1.0))
    step = lsq_linear(root.T, solve_triangular(root, gradient, lower=True), (low, high)).x
    theta, chain = np.split(now + step, [count])
    prediction = predicted(data, fitted.parametrisation, theta, fitted.prediction)
    if prediction is None:
        return None
    return replace(fitted, theta=theta, prediction=prediction, errors=chain_errors_at(data, prediction.values, chain))
