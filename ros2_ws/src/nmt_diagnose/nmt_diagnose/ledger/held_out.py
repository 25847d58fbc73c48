"""What is kept out of a fit to judge it, and how explanations predict it.

Held out are interleaved levels, the highest two levels, and whole tests.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import BoolArray, FloatArray
from nmt_diagnose.fit.explanations import FittedExplanation
from nmt_diagnose.fit.fitting import REFIT, Data, FitError, Metric, Start, best_chain_errors, fit
from nmt_diagnose.ledger.gap import ClosedShare, Pair, closed, no_worse_than_silence, rms
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.thresholds import THRESHOLDS

_NO_BETTER = 0.9
"""Standard uncertainty over that of its prior from which on rows do not determine a parameter."""


# Tests or levels that a text lists.
_LISTED = 8


@dataclass(frozen=True)
class Split:
    """One way to hold data out.

    Attributes:
        name: what is held out, for people.
        fitted: rows to fit, shape (m,).
        held_out: rows to judge by, shape (m,).
    """

    name: str
    fitted: BoolArray
    held_out: BoolArray

    def words(self, observations: Observations) -> str:
        """The name, followed by the tests or levels that it holds where the name does not say which."""
        rows, parts = observations.rows, []
        for number, test in enumerate(observations.tests):
            levels, every = (np.unique(rows.level[(rows.test == number) & of]) for of in (self.held_out, True))
            if 0 < levels.size < every.size:
                numbers = _listed([str(each + 1) for each in np.searchsorted(every, levels)])
                parts.append(f"levels {numbers} of {every.size} of {test.name}")
            elif levels.size:
                parts.append(test.name)
        return self.name if self.name.startswith("the test ") else f"{self.name} ({_listed(parts)})"


def _listed(items: Sequence[str]) -> str:
    more = len(items) - _LISTED
    return ", ".join(items[:_LISTED]) + (f" and {more} more" if more > 0 else "")


def named_tests(observations: Observations, names: Sequence[str]) -> BoolArray:
    """Rows of the tests of some names; a bag's name stands for all tests of the bag, shape (m,).

    Raises:
        BenchError: no test has such a name, or no test remains to be fitted.
    """
    found = np.zeros(len(observations.rows), dtype=bool)
    for name in names:
        test_name = PurePath(name).name
        numbers = [
            k
            for k, t in enumerate(observations.tests)
            if t.name == test_name or re.fullmatch(rf"{re.escape(test_name)} \d+", t.name)
        ]
        selected = np.isin(observations.rows.test, numbers)
        if not selected.any():
            known = ", ".join(test.name for test in observations.tests)
            raise BenchError(f"No test {name} with observables can be held out; the tests are {known}.")
        found |= selected
    if names and found.all():
        raise BenchError("Every test is held out, so there is nothing to fit; hold fewer of them out.")
    return found


def splits(observations: Observations, hold_out: Sequence[str] = ()) -> list[Split]:
    """The splits that a set of observations allows; empty if it is too small to hold anything out.

    Args:
        observations: the real side.
        hold_out: tests to hold out, and nothing else.

    Raises:
        BenchError: a test to hold out that is not there.
    """
    if hold_out:
        selected = named_tests(observations, hold_out)
        return [Split(" and ".join(f"the test {PurePath(name).name}" for name in hold_out), ~selected, selected)]
    rows = observations.rows
    # Where a channel is clipped is read off the few windows that reach the level; no other window predicts it. Nor do
    # the samples that are lost in one window predict those in others.
    limits = np.isin(rows.part, (Part.LIMIT, Part.REPEATS))
    result = []
    odd = np.zeros(len(rows), dtype=bool)
    top = np.zeros(len(rows), dtype=bool)
    for number, test in enumerate(observations.tests):
        selected = rows.test == number
        if not test.series.interleaved or not selected.any():
            continue
        levels = np.unique(rows.level[selected])
        if levels.size < THRESHOLDS.verdict.held_out_fewest_levels:
            continue
        odd |= selected & np.isin(rows.level, levels[1::2])
        if test.series.rising:
            by_amplitude = {level: float(np.max(rows.amplitude[selected & (rows.level == level)])) for level in levels}
            highest = sorted(levels, key=lambda level: by_amplitude[level])[-2:]
            top |= selected & np.isin(rows.level, highest)
    swept = _swept(observations)
    for group in swept:
        amplitudes = sorted({level for _, level in group})
        odd |= np.isin(rows.test, [number for number, level in group if level in amplitudes[1::2]])
        upper = amplitudes[-1:] if len(amplitudes) < THRESHOLDS.verdict.held_out_fewest_for_two else amplitudes[-2:]
        top |= np.isin(rows.test, [number for number, level in group if level in upper])
    if odd.any():
        result.append(Split("every second level", ~odd, odd))
    if top.any():
        result.append(Split("the highest levels" if swept else "the highest two levels", ~top, top))
    together = [[number for number, _ in group] for group in swept]
    alone = [[number] for number in range(len(observations.tests)) if not any(number in group for group in together)]
    present = [numbers for numbers in (*alone, *together) if np.any(np.isin(rows.test, numbers))]
    if len(present) > 1:
        for numbers in present:
            selected = np.isin(rows.test, numbers)
            names = observations.tests[numbers[0]].name
            if len(numbers) > 1:
                names = f"{names} and {len(numbers) - 1} more levels of it"
            result.append(Split(f"the test {names}", ~selected, selected))
    return [Split(split.name, split.fitted | limits, split.held_out & ~limits) for split in result]


def _swept(observations: Observations) -> list[list[tuple[int, float]]]:
    """Tests that are one frequency response at several held amplitudes: number and level of each, group by group."""
    groups: dict[object, list[tuple[int, float]]] = {}
    for number, test in enumerate(observations.tests):
        selected = observations.rows.test == number
        key = None if test.lines is None else test.lines.sweep_key
        if key is not None and selected.any():
            level = float(f"{np.median(observations.rows.amplitude[selected]):.3g}")
            groups.setdefault(key, []).append((number, level))
    return [
        g for g in groups.values() if len({level for _, level in g}) >= THRESHOLDS.verdict.held_out_fewest_responses
    ]


@dataclass(frozen=True)
class Refit:
    """What a fit to some rows says of all.

    Attributes:
        residual: of all rows over σ, (m,).
        std: uncertainty of its prediction over σ, (m,).
        is_open: it leaves a parameter open that all rows move beyond its prior: it knows it no better than that.
    """

    residual: FloatArray
    std: FloatArray
    is_open: bool


class HeldOut:
    """What explanations leave of rows that their fits did not see, each split of each explanation fitted once.

    Args:
        fitted: what the fits worked on.
        everything: the same with what was held out from all of them.
        splits: ways to hold rows out.
        null: the model alone.
        as_given: values of the model as given, (m,).
        seed: of the bootstrap.
    """

    def __init__(
        self,
        fitted: Data,
        everything: Data,
        splits: Sequence[Split],
        null: FittedExplanation,
        as_given: FloatArray,
        seed: int,
    ) -> None:
        self.fitted, self.everything, self.splits = fitted, everything, tuple(splits)
        self.null, self.as_given, self.seed = null, as_given, seed
        self._known: dict[tuple[int, int], Refit | None] = {}

    def residual(self, values: FloatArray) -> FloatArray:
        """What values of a model, (m,), leave of all rows over σ by the best errors of the chain, (m,)."""
        return best_chain_errors(self.everything, values).residual

    def closed(self, best: FittedExplanation, than: FittedExplanation | None = None) -> ClosedShare:
        """How much of the gap an explanation closes on rows that its fit did not see.

        Args:
            best: the explanation.
            than: what leaves the gap, of which all counts, its noise too; None = the model alone, above the noise.
        """
        floor = 1.0 if than is None else 0.0
        return closed(self.everything.observations, self.pairs(best, than), self.seed, floor)

    def pairs(self, best: FittedExplanation, than: FittedExplanation | None = None) -> list[Pair]:
        """Residuals of the model alone and of an explanation on rows that neither fit saw, one pair for each split.

        A split whose fit leaves open what the explanation does to the rows held out says nothing of it, nor does one
        from which the model alone knows less of them than what it is off by.

        Args:
            best: the explanation.
            than: in place of the model alone.
        """
        scale, data, first = best.scale(), self.everything, self.null if than is None else than
        fits = [
            best_chain_errors(data, found.fit.prediction.values, found.fit.errors).residual for found in (first, best)
        ]
        change = (fits[1] - fits[0]) * scale
        pairs: list[Pair] = []
        for split in self.splits:
            rows = split.held_out & data.used
            before, after = (self.refitted(found, split) for found in (first, best))
            if before is None or after is None or not rows.any():
                continue
            uncertain = after.std * scale
            if rms(before.std[rows]) > rms(before.residual[rows]):
                continue
            if rms(uncertain[rows]) <= THRESHOLDS.verdict.open_prediction_share * rms(change[rows]):
                silent = no_worse_than_silence(data.observations, before.residual, data.sigma)
                pairs.append((silent * scale, after.residual * scale / np.hypot(1.0, uncertain), rows))
        return pairs

    def closed_by(self, values_after: Callable[[Split], FloatArray | None], scale: FloatArray) -> ClosedShare:
        """How much of the gap that the model alone leaves other values close on rows held out.

        Args:
            values_after: values of a model, (m,), by what is known without the rows that a split holds out; None = it
                says nothing of that split.
            scale: noise of all rows, (m,).
        """
        data, pairs = self.everything, []
        for split in self.splits:
            rows, before = split.held_out & data.used, self.refitted(self.null, split)
            if before is None or not rows.any() or rms(before.std[rows]) > rms(before.residual[rows]):
                continue
            values = values_after(split)
            if values is None:
                continue
            silent = no_worse_than_silence(data.observations, before.residual, data.sigma)
            pairs.append((silent * scale, self.residual(values) * scale, rows & np.isfinite(values)))
        return closed(data.observations, pairs, self.seed)

    def recalibrated(self) -> list[Pair]:
        """Residuals of the model as given and with its own parameters re-fitted to other rows, as :meth:`pairs`.

        A split whose fit leaves open what they do to the rows held out says nothing of it.
        """
        scale, data = self.null.scale(gap=False), self.everything
        before = no_worse_than_silence(data.observations, self.residual(self.as_given), data.sigma) * scale
        pairs: list[Pair] = []
        for split in self.splits:
            after, rows = self.refitted(self.null, split), split.held_out & data.used
            if after is not None and not after.is_open:
                pairs.append((before, after.residual * scale / np.hypot(1.0, after.std * scale), rows))
        return pairs

    def refitted(self, found: FittedExplanation, split: Split) -> Refit | None:
        """An explanation fitted to the rows of a split; None where the model has no solution there."""
        key = id(found), id(split)
        if key not in self._known:
            self._known[key] = refit(self.fitted, self.everything, found, split)
        return self._known[key]


def refit(fitted: Data, everything: Data, found: FittedExplanation, split: Split) -> Refit | None:
    """An explanation fitted to some rows.

    The rig is predicted. The state of the measuring chain in the other rows is determined by those rows themselves.
    """
    before = found.fit
    part = replace(fitted, used=fitted.used & split.fitted)
    start = Start(before.start, before.theta, before, before.theta.size, effort=REFIT)
    try:
        again = fit(part, before.parametrisation, start)
    except FitError:
        return None
    left = best_chain_errors(everything, again.prediction.values, before.errors).residual
    chain = Metric(before.errors.slopes, np.ones(before.errors.chain.size), before.errors.weights)
    slopes = chain.project(before.jacobian)[0]
    prior = before.parametrisation.prior_std
    is_open = bool(np.any((again.std > _NO_BETTER * prior) & (np.abs(before.theta) > prior)))
    return Refit(left, np.sqrt(np.einsum("mi,ij,mj->m", slopes, again.covariance, slopes)), is_open)
