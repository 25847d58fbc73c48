"""The common misfit: how far a model that lacks nothing may be off, the same way in neighbouring levels and lines.

A thousand rows of one recording are not a thousand independent witnesses of the model: mesh, laws of damping, mounting
and calibration make it smoothly wrong everywhere. The rows of one kind, channel and order have the covariance

    s² (D + M K M),    K_ij = exp(−(x_i − x_j)² / 2ℓ²),

D the noise with a small independent part of the misfit, M the size of the misfit, x the logarithm of level or
frequency (Kennedy and O'Hagan, J. R. Stat. Soc. B 63 (2001) 425). Its size is a share of the limit that matters; s is
the scale that each group of rows learns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from nmt_core.numerics.arrays import BoolArray, FloatArray, IntArray
from nmt_diagnose.measurements.measurement import Observations, occupied_band
from nmt_diagnose.observations.observables import Natural, Part, parts_where, with_natural
from nmt_diagnose.thresholds import THRESHOLDS

_SMALLEST = 1e-6  # share of an eigenvalue's largest below which it is rounding


@dataclass(frozen=True)
class Misfit:
    """Standard deviations of the misfit of each row before scales, (m,) each.

    Attributes:
        common: what neighbours share.
        independent: what they do not.
        records: rows of each channel of a record, (n,), and what they share, a column for each band and phase, (n, r):
            a model is off in a response by a complex factor that is smooth over frequency.
    """

    common: FloatArray
    independent: FloatArray
    records: tuple[tuple[IntArray, FloatArray], ...] = ()


def misfit_of(observations: Observations) -> Misfit:
    """Misfit of each row; none where the bench's own simulator measured without tolerances."""
    rows = observations.rows
    size = np.zeros(len(rows))
    for kind, size_that_matters in observations.matters.items():
        selected = rows_of_kind(observations, kind)
        of_value = np.isin(rows.part[selected], with_natural(Natural.VALUE))
        size[selected] = size_that_matters * np.where(of_value, np.abs(observations.values[selected]), 1.0)
    chains = (*observations.chains, *[None] * len(observations.tests))
    exact = [number for number, test in enumerate(observations.tests) if chains[number] is None and not test.reduced]
    size[np.isin(rows.test, exact)] = 0.0
    common, records = THRESHOLDS.misfit.shared_share * size, []
    response = THRESHOLDS.misfit.shared_share * observations.matters.get("response", 0.0)
    for number, test in enumerate(observations.tests):
        if test.record is None or number in exact or not test.record.responses.size or response == 0.0:
            continue
        for channel, samples in enumerate(test.record.responses):
            own = (rows.test == number) & (rows.channel == channel) & (rows.part == Part.SAMPLE)
            index = np.flatnonzero(own)
            if index.size > 1:
                rate = test.record.sample_rate / test.record.head_stride
                at = np.round((rows.time_s[index] - test.record.start_s) * rate).astype(np.int64)
                shared = response * _in_bands(samples, rate)[:, at.clip(0, samples.size - 1)].T
                common[index] = np.sqrt(np.sum(shared**2, axis=1))
                records.append((index, shared))
    return Misfit(common, THRESHOLDS.misfit.independent_share * size, tuple(records))


def _in_bands(samples: FloatArray, rate: float) -> FloatArray:
    """A response in bands of frequency that overlap, as it is and a quarter of a period later, (2 bands, n).

    Factors of unit variance of the bands make one factor over frequency with the covariance of neighbouring lines.
    """
    length, size = THRESHOLDS.misfit.line_length, next_fast_len(2 * samples.size, real=True)
    lines = rfft(samples - samples.mean(), size)
    hertz = rfftfreq(size, 1.0 / rate)
    low, high = occupied_band(samples, rate)
    middles = np.arange(np.log(max(low, hertz[1])) - 2.0 * length, np.log(high) + 2.0 * length, length)
    apart = (np.log(np.maximum(hertz, hertz[1]))[None, :] - middles[:, None]) / length
    weights = (2.0 / np.pi) ** 0.25 * np.exp(-(apart**2))
    return np.concatenate([irfft(phase * weights * lines, size, axis=1)[:, : samples.size] for phase in (1.0, 1j)])


def rows_of_kind(observations: Observations, kind: str) -> BoolArray:
    """Rows of a kind in which a model may be smoothly off, (m,)."""
    parts = parts_where(lambda facts: facts.smooth and facts.matters == kind)
    return np.asarray(np.isin(observations.rows.part, parts))


class Whitening:
    """Takes residuals over their standard deviations to independent ones of standard deviation 1.

    The symmetric root of the inverse correlation: a row stays as near to itself as can be.

    Args:
        observations: the real side.
        share: variance that neighbours share over the whole of each row, (m,).
        which: rows that take part, (m,).
        records: as of :class:`Misfit`, over the standard deviations of the rows.
    """

    def __init__(
        self,
        observations: Observations,
        share: FloatArray,
        which: BoolArray,
        records: Sequence[tuple[IntArray, FloatArray]] = (),
    ) -> None:
        by_size: dict[int, list[IntArray]] = {}
        self._records = [_Factored.of(index[which[index]], columns[which[index]]) for index, columns in records]
        for course in series_of(observations, which & (share > 0.0)):
            by_size.setdefault(course.size, []).append(course)
        where = where_of(observations)
        self._blocks: list[tuple[IntArray, FloatArray, FloatArray]] = []
        for size, members in by_size.items():
            if size < 2:
                continue
            index = np.array(members)
            x, root = where[index], np.sqrt(share[index])
            apart = x[:, :, None] - x[:, None, :]
            correlation = np.exp(-0.5 * apart**2) * root[:, :, None] * root[:, None, :]
            diagonal = np.arange(size)
            correlation[:, diagonal, diagonal] = 1.0
            values, vectors = np.linalg.eigh(correlation)
            size_of = np.sqrt(np.maximum(values, _SMALLEST * values[:, -1:]))[:, None, :]
            turned = np.swapaxes(vectors, 1, 2)
            self._blocks.append((index, (vectors / size_of) @ turned, (vectors * size_of) @ turned))

    def __call__(self, columns: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Columns (m,) or (m, n) over standard deviations, whitened; into ``out``, which may be the columns."""
        result = columns.copy() if out is None else out
        for index, root, _ in self._blocks:
            block = columns[index]
            result[index] = np.einsum("sij,sj->si", root, block) if columns.ndim == 1 else np.matmul(root, block)
        for factored in self._records:
            result[factored.index] = factored.whitened(columns[factored.index])
        return result

    def back(self, residual: FloatArray) -> FloatArray:
        """A whitened residual (m,) row by row over standard deviations again."""
        result = residual.copy()
        for index, _, root in self._blocks:
            result[index] = np.einsum("sij,sj->si", root, residual[index])
        for factored in self._records:
            result[factored.index] = factored.back(residual[factored.index])
        return result


@dataclass(frozen=True)
class _Factored:
    """Correlation of many rows as a diagonal and a few columns: D + B Bᵀ, its diagonal 1.

    Attributes:
        index: of the rows, (n,).
        alone: root of D, (n,).
        along: orthonormal columns that span B over that root, (n, r).
        size: standard deviations along these, (r,).
    """

    index: IntArray
    alone: FloatArray
    along: FloatArray
    size: FloatArray

    @classmethod
    def of(cls, index: IntArray, columns: FloatArray) -> _Factored:
        """Of rows and what they share over their standard deviations, (n, r)."""
        alone = np.sqrt(np.maximum(1.0 - np.sum(columns**2, axis=1), _SMALLEST))
        along, sizes, _ = np.linalg.svd(columns / alone[:, None], full_matrices=False)
        return cls(index, alone, along, np.sqrt(1.0 + sizes**2))

    def whitened(self, columns: FloatArray) -> FloatArray:
        """Columns (n,) or (n, k) as independent ones."""
        over = (columns.T / self.alone).T
        return np.asarray(over - (self.along * (1.0 - 1.0 / self.size)) @ (self.along.T @ over))

    def back(self, residual: FloatArray) -> FloatArray:
        """An independent residual (n,) row by row again."""
        return np.asarray(self.alone * (residual + (self.along * (self.size - 1.0)) @ (self.along.T @ residual)))


def series_of(observations: Observations, which: BoolArray) -> list[IntArray]:
    """Rows of one test, part, channel and order, for all of them."""
    rows = observations.rows
    selected = np.flatnonzero(which)
    if not selected.size:
        return []
    keys = np.stack([rows.test[selected], rows.part[selected], rows.channel[selected], rows.harmonic[selected]])
    _, group = np.unique(keys, axis=1, return_inverse=True)
    order = np.argsort(group.ravel(), kind="stable")
    ends = np.flatnonzero(np.diff(group.ravel()[order])) + 1
    return [selected[piece] for piece in np.split(order, ends)]


def where_of(observations: Observations) -> FloatArray:
    """Logarithm of level or frequency over the length that a misfit keeps, (m,)."""
    rows = observations.rows
    lines = [n for n, test in enumerate(observations.tests) if test.lines is not None]
    by_line = np.isin(rows.test, lines)
    with np.errstate(invalid="ignore", divide="ignore"):
        line = np.log(np.maximum(rows.frequency_hz, 1e-300)) / THRESHOLDS.misfit.line_length
        level = np.log(np.maximum(np.abs(rows.amplitude), 1e-300)) / THRESHOLDS.misfit.level_length
    return np.nan_to_num(np.where(by_line, line, level))


def least_scale(groups: IntArray, count: int, share: FloatArray) -> FloatArray:
    """Least squared scale of each group, (K,): rows are never surer than their misfit lets them be.

    Args:
        groups: group of each row, (m,).
        count: groups K.
        share: variance of the misfit over the whole of each row, (m,).
    """
    rows = np.maximum(np.bincount(groups, minlength=count), 1)
    return np.asarray(np.bincount(groups, share, minlength=count) / rows)
