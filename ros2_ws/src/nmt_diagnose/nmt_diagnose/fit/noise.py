"""The noise of the observations: what the recordings show of each row, and one learnt scale per test and kind of row.

A row has the standard deviation that its recording shows. How right that is, is learnt: the rows of one kind in one
test share an unknown scale s, and s² has an inverse-gamma prior about 1. Marginalised in closed form the rows of a
group are Student-distributed,

    −2 ln p = (ν + n) ln(1 + χ² / ν),    χ² = Σ (e/σ)²,

so a scale goes down as well as up, and the scales of the alternatives are part of their evidence. It goes down no
further than the misfit of the model allows (misfit.py): from there on the cost is linear in χ².
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import BoolArray, FloatArray, IntArray
from nmt_core.tolerances import TOLERANCES
from nmt_diagnose.fit.misfit import least_scale
from nmt_diagnose.measurements.measurement import Measurement, Observations
from nmt_diagnose.observations.observables import FUNDAMENTAL, Part
from nmt_diagnose.thresholds import THRESHOLDS


@dataclass(frozen=True)
class Groups:
    """Rows that share a scale.

    Attributes:
        of: group of each row, shape (m,).
        names: of the groups, (K,).
        degrees: ν of the prior of each, (K,); infinite where the scale is known to be 1.
        least: least s² of each, (K,).
        rank: of each row's level among those of its test, the lowest 0, (m,); −1 where a test has no levels.
    """

    of: IntArray
    names: tuple[str, ...]
    degrees: FloatArray
    least: FloatArray
    rank: IntArray | None = None

    def sums(self, squares: FloatArray) -> FloatArray:
        """Sum over each group, (K,), of values (m,)."""
        return np.asarray(np.bincount(self.of, squares, len(self.names)), dtype=np.float64)

    def products(self, columns: FloatArray) -> FloatArray:
        """Products of columns (m, r) with each other over each group, (K, r, r)."""
        order = np.argsort(self.of, kind="stable")
        pieces = np.split(columns[order], np.searchsorted(self.of[order], np.arange(1, len(self.names))))
        return np.array([piece.T @ piece for piece in pieces])

    def counts(self, used: BoolArray) -> FloatArray:
        """Rows of each group, (K,)."""
        return self.sums(used.astype(np.float64))

    def cost(self, squares: FloatArray, counts: FloatArray) -> float:
        """−2 ln p of groups with sums of squares χ², (K,), up to a constant of the rows."""
        nu = np.where(np.isfinite(self.degrees), self.degrees, 1.0)
        total = nu + counts
        bend = np.maximum(self.least * total - nu, 0.0)  # χ² below which the scale stays at its least
        beyond = np.maximum(squares, bend)
        student = total * np.log1p(beyond / nu) - total * (beyond - squares) / (nu + beyond)
        return float(np.sum(np.where(np.isfinite(self.degrees), student, squares)))

    def tails(self, squares: FloatArray, counts: FloatArray) -> FloatArray:
        """Probability by its prior that each learnt scale is as large (Fisher's F), (K,); NaN where none is learnt."""
        learnt = np.isfinite(self.degrees) & (counts > 0.0)
        result = np.full(self.degrees.size, np.nan)
        result[learnt] = fdtrc(counts[learnt], self.degrees[learnt], squares[learnt] / counts[learnt])
        return result

    def trends(self, residual: FloatArray, used: BoolArray) -> FloatArray:
        """Probability that the lowest or the highest levels of a group exceed its others by so much by chance, (K,).

        Noise is alike at all levels, so the other levels give its size; what a model lacks acts from some level on, or
        up to it (Fisher's F for each number of levels at either end, Bonferroni).

        Args:
            residual: over standard deviations, (m,).
            used: rows that are compared, (m,).

        Returns:
            Probabilities; NaN of groups without a learnt scale and of tests with too few levels.
        """
        result = np.full(self.degrees.size, np.nan)
        if self.rank is None:
            return result
        ranked = used & (self.rank >= 0)
        for group in np.unique(self.of[ranked]):
            selected = ranked & (self.of == group)
            rank = np.unique(self.rank[selected], return_inverse=True)[1]
            levels = int(rank.max()) + 1
            if not np.isfinite(self.degrees[group]) or levels < THRESHOLDS.comparison.fewest_levels_of_trend:
                continue
            squares, counts = np.bincount(rank, residual[selected] ** 2), np.bincount(rank)
            ends = (np.cumsum(squares), np.cumsum(counts)), (np.cumsum(squares[::-1]), np.cumsum(counts[::-1]))
            nu = self.degrees[group]
            tails = []
            for sums, numbers in ends:
                sums, numbers = sums[: levels // 2], numbers[: levels // 2]
                degrees = nu + counts.sum() - numbers
                others = np.maximum((nu + squares.sum() - sums) / degrees, self.least[group])
                tails.append(fdtrc(numbers, degrees, sums / numbers / others))
            result[group] = min(1.0, float(np.min(tails)) * 2.0 * (levels // 2))
        return result

    def weights(self, squares: FloatArray, counts: FloatArray) -> FloatArray:
        """1/s² of each group, (K,): most probable given its squares."""
        nu = np.where(np.isfinite(self.degrees), self.degrees, 1.0)
        scales = np.maximum((nu + squares) / (nu + counts), self.least)
        return np.where(np.isfinite(self.degrees), 1.0 / scales, 1.0)


def beyond_noise(tails: FloatArray) -> BoolArray:
    """Which of some tests are failed by more than chance (Bonferroni), (n,).

    Args:
        tails: probability of each, (n,); NaN where there is none.
    """
    count = max(1, int(np.sum(np.isfinite(tails))))
    return np.asarray(np.nan_to_num(tails, nan=1.0) * count < THRESHOLDS.comparison.noise_probability)


def chance_of(tails: FloatArray) -> float:
    """Probability that some test is failed as much as the worst (Bonferroni); argument as of :func:`beyond_noise`."""
    finite = tails[np.isfinite(tails)]
    return float(min(1.0, finite.min() * finite.size)) if finite.size else 1.0


def _rank_of(observations: Observations) -> IntArray:
    """Rank of each row's level among the amplitudes of its test, (m,); −1 where a test has none."""
    rows = observations.rows
    result = np.full(len(rows), -1, dtype=np.int64)
    for number, test in enumerate(observations.tests):
        if not test.series.ranked:
            continue
        selected = rows.test == number
        levels, index = np.unique(rows.level[selected], return_inverse=True)
        amplitudes = np.zeros(levels.size)
        np.maximum.at(amplitudes, index.ravel(), np.nan_to_num(np.abs(rows.amplitude[selected])))
        result[selected] = np.argsort(np.argsort(amplitudes, kind="stable"))[index.ravel()]
    return result


def groups_of(observations: Observations, share: FloatArray) -> Groups:
    """Groups of rows by test and kind: frequency, damping, fundamental, harmonics, lines of a response.

    Args:
        observations: the real side.
        share: variance of the misfit of each row over the whole, (m,).
    """
    rows = observations.rows
    names: dict[str, int] = {}
    of = np.zeros(len(rows), dtype=np.int64)
    known: dict[int, bool] = {}
    for index in range(len(rows)):
        test = observations.tests[rows.test[index]]
        part = Part(int(rows.part[index]))
        kind = _kind(test, part, int(rows.channel[index]))
        name = f"{test.name}: {kind}"
        of[index] = names.setdefault(name, len(names))
        known[int(of[index])] = not part.facts.excited
    degrees = np.array([np.inf if known[k] else THRESHOLDS.fits.scale_degrees_of_freedom for k in range(len(names))])
    return Groups(of, tuple(names), degrees, least_scale(of, len(names), share), _rank_of(observations))


def _kind(test: Measurement, part: Part, channel: int) -> str:
    if part in FUNDAMENTAL and test.lines is not None and test.lines.noise_group:
        return f"{test.lines.noise_group} {test.channels[channel].name}"
    if part is Part.SAMPLE:
        return f"{part.facts.noise} of {test.channels[channel].name}"
    # Phases of all responses of a window are off together where the loop stood elsewhere, that of the force hardly.
    force = part.facts.half and channel >= 0 and test.channels[channel].quantity is Quantity.FORCE
    return f"{part.facts.noise}{' of the force' if force else ''}"


def sigma_of(observations: Observations) -> FloatArray:
    """Standard deviation of each row as its recording shows it, with what the loop may hold, shape (m,)."""
    sigma = observations.sigma.copy()
    rows = observations.rows
    for number, chain in enumerate(observations.chains):
        if chain is None:
            continue
        selected = rows.test == number
        held = selected & (rows.part == Part.PHASE_ERROR)
        sigma[held] = np.hypot(sigma[held], math.radians(TOLERANCES.lock_phase_deg))
        for channel in np.unique(rows.channel[selected & (rows.part == Part.LINE)]):
            sizes = channel_sizes(observations, number, int(channel))
            lines = selected & (rows.channel == channel) & (rows.part == Part.LINE)
            if sizes.size:
                sigma[lines] = np.hypot(sigma[lines], chain.mains * float(sizes.max()))
    return sigma


def channel_sizes(observations: Observations, number: int, channel: int) -> FloatArray:
    """Amplitudes of a channel's fundamental in a test, in the channel's unit; empty where no row holds them."""
    rows, test = observations.rows, observations.tests[number]
    theirs = (rows.test == number) & (rows.channel == channel)
    if test.given_channel is not None and test.channels[channel] is test.given_channel:
        return np.asarray(rows.amplitude[theirs & (rows.part == Part.LOG_FREQUENCY)])
    return np.asarray(np.exp(observations.values[theirs & (rows.part == Part.LOG_MAGNITUDE)]))
