"""How large a gap is in engineering terms, and whether that matters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri, ndtr

from nmt_core.numerics.arrays import BoolArray, FloatArray
from nmt_core.text.number_words import significant
from nmt_diagnose.inference.candidate_starts import at_zero, strength_parameter
from nmt_diagnose.inference.explanations import FittedExplanation
from nmt_diagnose.inference.fitting import Data, predicted
from nmt_diagnose.inference.noise import sigma_of
from nmt_diagnose.measurements.locked_windows.locked_windows import LockedWindows
from nmt_diagnose.observations.observables import Observations, Part
from nmt_diagnose.thresholds import THRESHOLDS

_KINDS: dict[str, tuple[Part, ...]] = {
    "frequency": (Part.LOG_FREQUENCY,),
    "damping": (Part.DAMPING,),
    "response": (Part.LOG_MAGNITUDE, Part.PHASE, Part.PHASE_ERROR, Part.SAMPLE),
    "harmonics": (Part.REAL, Part.IMAG),
}
_PERCENT = 100.0


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
        """The size in words, beside the size that matters by kind."""
        parts = ", ".join(f"{_PERCENT * value:.2g} % of {SIZE_NAMES[kind]}" for kind, value in self.values.items())
        if matters(self, wanted):
            size = f" of up to {parts}" if parts else ""
            return f"The recordings hint at a difference{size}, which lies within their noise and tolerances."
        return f"The recordings show a difference beyond their noise that is smaller than what matters: {parts}."


SIZE_NAMES = {
    "frequency": "the frequency",
    "damping": "the damping",
    "response": "a response",
    "harmonics": "the fundamental in harmonics",
}


def measured_size(data: Data, found: FittedExplanation) -> Size:
    """How far an explanation lies from itself without its effects, at the level or line where they differ most."""
    fitted = found.fit
    without = predicted(data, fitted.parametrisation, without_strength(found), fitted.prediction)
    if without is None:  # it has no solution without them
        return Size({}, True)
    return change_size(data, data.forward.difference(fitted.prediction.values, without.values))


@dataclass(frozen=True)
class Objection:
    """More than noise in a group of rows, a parameter of the model where nobody believes it, or an imitation.

    Attributes:
        group: test and kind of row; name of the parameter; empty of an imitation.
        kind: kind of what matters; empty of a parameter and an imitation.
        size: relative, what noise makes taken off; of a parameter standard deviations of its prior.
    """

    group: str
    kind: str
    size: float

    @property
    def sentence(self) -> str:
        """What speaks against an explanation as the whole of a gap, without a full stop."""
        if not self.group:
            return "two laws together can imitate one that the library lacks"
        consequence = ", so something unnamed acts too"
        if not self.kind:
            return f"it takes {self.group} {self.size:.1f} standard deviations from what is believed of it{consequence}"
        size = f"{significant(_PERCENT * self.size, 2)} % of {SIZE_NAMES[self.kind]}"
        return f"{size} ({self.group}) remain that it does not explain{consequence}"


IMITATION = Objection("", "", 0.0)
"""Two laws of the structure, which take the shape of a third."""


def left_over(
    data: Data, found: FittedExplanation, wanted: Mapping[str, float], loop: bool = False
) -> tuple[Objection, ...]:
    """What an explanation leaves that is more than noise and matters, the largest beside what matters first.

    A group counts where its scale is larger than its prior allows (Fisher's F, Bonferroni) and where what is left
    beyond the noise of its rows, at some level or tenth of the lines, is as large as what matters. Where a loop truly
    stood is an input of the model: it speaks against its controller and nothing else.

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
        kind = next((k for k, parts in _KINDS.items() if np.isin(rows.part[selected], parts).any()), "")
        if not kind:
            continue
        keys = np.stack([rows.channel[selected], _band(rows.level[selected], rows.test[selected])])
        _, block = np.unique(keys, axis=1, return_inverse=True)
        block, residual = block.ravel(), raw[selected]
        count = np.bincount(block).astype(np.float64)
        beyond = np.bincount(block, residual**2 - 1.0)
        beyond = np.where(beyond > THRESHOLDS.verdict.excess_sigmas * np.sqrt(2.0 * count), beyond, 0.0)
        unit = np.abs(data.observations.values[selected]) if kind == "damping" else np.ones(residual.size)
        sizes = np.sqrt(beyond / np.maximum(np.bincount(block, (unit / data.sigma[selected]) ** 2), 1e-300))
        if np.any(rows.part[selected] == Part.SAMPLE):
            sizes = sizes / max(float(np.sqrt(np.mean(data.observations.values[selected] ** 2))), 1e-300)
        size = float(sizes.max())
        if size > 0.0 and size >= wanted.get(kind, 0.0):
            result.append(Objection(groups.names[number], kind, size))
    return tuple(sorted(result, key=lambda left: -left.size / max(wanted.get(left.kind, 0.0), 1e-300)))


def left_without_size(data: Data, found: FittedExplanation) -> bool:
    """Whether lines of the mains, steps, limits or lost samples are left that stand out."""
    sized = np.isin(data.observations.rows.part, [part for parts in _KINDS.values() for part in parts])
    left = np.abs(data.residual(found.fit.prediction.values, found.fit.errors.chain)[data.used & ~sized])
    return bool(left.max(initial=0.0) > THRESHOLDS.verdict.visible_sigmas)


def implausible_parameters(data: Data, found: FittedExplanation) -> tuple[tuple[Objection, ...], float]:
    """The model's own parameter furthest from what is believed of it, where that is improbable (Bonferroni).

    Beyond some value a parameter may do nothing more, such as the damping of modes that do not show at all: what does
    not matter where it goes back to what is credible is no objection.

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
        if not _matters(data, change, data.observations.matters):
            return (), 1.0
    return (Objection(parameters[worst].name, "", float(theta[worst])),), chance


def needed(
    data: Data, found: FittedExplanation, simpler: Sequence[FittedExplanation], wanted: Mapping[str, float]
) -> FittedExplanation:
    """An explanation with those of its effects marked as small that it does not need.

    Args:
        data: what was fitted.
        found: the explanation.
        simpler: fits that may have some of its effects only, the model alone among them.
        wanted: what matters, by kind.
    """
    found = replace(found, small=_ordinary(data, found))
    causes = set(found.fitted.causes)
    parts = [less for less in simpler if set(less.fitted.causes) < causes]
    for less in sorted(parts, key=lambda part: (len(part.candidates), -part.fit.log_evidence)):
        if not worth(data, found, less, wanted):
            kept = less.fitted.causes
            small = (k for k, candidate in enumerate(found.candidates) if candidate.cause not in kept)
            return replace(found, small=found.small | frozenset(small))
    return found


def _ordinary(data: Data, found: FittedExplanation) -> frozenset[int]:
    """Effects that are no larger than in an ordinary measuring chain."""
    if not data.tolerances.any():
        return found.small
    within = set(found.small)
    for number, candidate in enumerate(found.candidates):
        if candidate.effect.ordinary > 0.0:
            values = found.fit.parametrisation.values(found.fit.theta, number)
            largest = THRESHOLDS.comparison.credible_sigmas * candidate.effect.ordinary
            if abs(values[strength_parameter(candidate).name]) <= largest:
                within.add(number)
    return frozenset(within)


def worth(data: Data, more: FittedExplanation, less: FittedExplanation, wanted: Mapping[str, float]) -> bool:
    """Whether an explanation with more effects than another is needed beside it.

    It is where the other leaves more than noise that matters and its predictions differ by what matters, or where the
    other is that near only by parameters or a measuring chain that nobody believes and this one is not.
    """
    added = [candidate for candidate in more.candidates if candidate.cause not in less.fitted.causes]
    loop = any(candidate.site.location.kind == "controller" for candidate in added)
    if left_over(data, less, wanted, loop) or left_without_size(data, less):
        return _apart(data, more, less, wanted)
    return relieves(data, more, less, wanted)


def relieves(data: Data, more: FittedExplanation, less: FittedExplanation, wanted: Mapping[str, float]) -> bool:
    """Whether model and measuring chain return to what is believed of them by effects that matter.

    Errors of 3 standard deviations that share one reason are credible one by one and not together.
    """
    if tension(data, less) - tension(data, more) <= relief_that_counts(data, less):
        return False
    return matters(measured_size(data, more), wanted)


def tension(data: Data, found: FittedExplanation) -> float:
    """How far a fit takes parameters of the model and errors of the chain from what is believed of them, −2 ln p."""
    believed = _believed(data, found)
    return float(believed @ believed)


def relief_that_counts(data: Data, found: FittedExplanation) -> float:
    """Fall of the tension of a fit by one effect more that is no chance: χ² of one degree of freedom, Bonferroni."""
    count = _believed(data, found).size
    return float(chdtri(1, THRESHOLDS.comparison.incredible_probability / max(count, 1)))


def _believed(data: Data, found: FittedExplanation) -> FloatArray:
    """Parameters of the model and errors of the chain that have a tolerance, in standard deviations of that."""
    parameters = found.fit.theta[: len(found.fit.parametrisation.calibration)]
    return np.concatenate([parameters, found.fit.errors.chain[data.tolerances]])


def leaves_something(data: Data, found: FittedExplanation, wanted: Mapping[str, float], loop: bool = False) -> bool:
    """Whether a fit leaves more than noise that matters, or asks of model and chain what nobody believes.

    Arguments as of :func:`left_over`.
    """
    if left_over(data, found, wanted, loop) or left_without_size(data, found):
        return True
    return strained(data, found, wanted) < THRESHOLDS.comparison.incredible_probability


def strained(data: Data, found: FittedExplanation, wanted: Mapping[str, float]) -> float:
    """Probability that a parameter of the model or an error of the chain that matters is as far off (Bonferroni)."""
    fitted, chain = found.fit, found.fit.errors.chain
    parameters = np.abs(fitted.theta[: len(fitted.parametrisation.calibration)])
    far = np.flatnonzero((np.abs(chain) > THRESHOLDS.comparison.credible_sigmas) & data.tolerances)
    moved = (data.chain + data.added) * chain
    farthest = max(
        [
            float(parameters.max(initial=0.0)),
            *(abs(float(chain[j])) for j in far if _matters(data, moved[:, j], wanted)),
        ]
    )
    return min(1.0, (parameters.size + chain.size) * 2.0 * float(ndtr(-farthest)))


def _matters(data: Data, change: FloatArray, wanted: Mapping[str, float]) -> bool:
    return matters(change_size(data, change), wanted)


def _apart(data: Data, more: FittedExplanation, less: FittedExplanation, wanted: Mapping[str, float]) -> bool:
    """Whether the predictions of two fits differ by what matters."""
    return _matters(data, data.forward.difference(more.fit.errors.values, less.fit.errors.values), wanted)


def change_size(data: Data, change: FloatArray) -> Size:
    """Size of a change of the rows of a fit, (m,), in their own units; see `size_of_change`."""
    return size_of_change(data.observations, data.used, data.sigma, change)


def size_of_change(observations: Observations, used: BoolArray, sigma: FloatArray, change: FloatArray) -> Size:
    """Size of a change of the rows, (m,), in their own units.

    Rows of a level or tenth of the lines count together, each as surely as it is known: a line where hardly anything is
    left of a response tells little. Samples of a record count by the rms of all of them.

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
    for kind, parts in _KINDS.items():
        selected = used & np.isin(rows.part, parts)
        known |= selected
        if not selected.any():
            continue
        relative_change = np.abs(change[selected])
        keys = np.stack([rows.test[selected], rows.channel[selected], _band(rows.level[selected], rows.test[selected])])
        if kind == "damping":
            relative_change = relative_change / np.maximum(np.abs(measured[selected]), 1e-12)
        _, group = np.unique(keys, axis=1, return_inverse=True)
        group = group.ravel()
        weight = sigma[selected] ** -2.0
        squares = np.bincount(group, weight * relative_change**2) / np.bincount(group, weight)
        records = rows.part[selected] == Part.SAMPLE
        if records.any():
            mean_squares = np.bincount(group, np.where(records, measured[selected] ** 2, 0.0)) / np.bincount(group)
            squares = np.where(mean_squares > 0.0, squares / np.maximum(mean_squares, 1e-300), squares)
        values[kind] = float(np.sqrt(np.max(squares)))
    unsized = used & ~known
    return Size(values, bool(np.any(np.abs(change[unsized] / sigma[unsized]) > THRESHOLDS.verdict.visible_sigmas)))


def without_strength(found: FittedExplanation) -> FloatArray:
    """θ of an explanation with the effects that it needs at zero strength, all of them where it needs none."""
    theta = found.fit.theta.copy()
    for number in found.stated or range(len(found.candidates)):
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
    return size.other or any(value >= wanted.get(kind, 0.0) for kind, value in size.values.items())


def large_lines(observations: Observations, wanted: float) -> BoolArray:
    """Lines of the mains, (m,), of channels where they are a share of the fundamental in the median level.

    Args:
        observations: what was read.
        wanted: that share.
    """
    rows = observations.rows
    lines = np.flatnonzero(rows.part == Part.LINE)
    share = np.full(lines.size, np.inf)
    for number, row in enumerate(lines):
        test = observations.tests[rows.test[row]]
        fundamentals = test.levels[rows.level[row]].fundamentals if isinstance(test, LockedWindows) else ()
        if fundamentals and fundamentals[rows.channel[row]] > 0.0:
            share[number] = observations.values[row] / fundamentals[rows.channel[row]]
    large = np.zeros(len(rows), dtype=bool)
    keys = np.stack([rows.test[lines], rows.channel[lines], np.round(rows.frequency_hz[lines]).astype(np.int64)])
    for key in np.unique(keys, axis=1).T:
        same = np.all(keys == key[:, None], axis=0)
        large[lines[same]] = np.median(share[same]) >= wanted
    return large


def stands_out(observations: Observations, which: BoolArray) -> bool:
    """Whether rows, (m,), that a model without effects predicts to be zero stand out of noise and tolerances."""
    sizes = np.abs(observations.values[which]) / sigma_of(observations)[which]
    return bool(sizes.max(initial=0.0) > THRESHOLDS.comparison.credible_sigmas)
