"""Predictions of the law of records for parts that its strengths do not know, and its residuals on all parts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.law.record_search import RecordLaw, RecordSearch
from nmt_diagnose.law.sampled_records import SampledRecords

_LINE = 1500  # points of the law's line
_LAGS = 40
_LONGEST = 0.3  # lag over the length of a part


@dataclass(frozen=True)
class RecordCheck:
    """A check of a law on one record.

    Attributes:
        record: name of the test.
        time_s: of the rows of the part of the largest motion, from the begin of the record, s.
        measured: missing force at these, corrected for errors of chain and model that the other parts determine, N.
        std: standard uncertainty of each, N.
        line_s, line: time and force of the law whose strengths are those of the other parts, N.
        lags_s: distances of rows, s.
        without, with_law: autocorrelation at these of the residuals of all parts.
        band: two standard deviations of it where rows are independent.
    """

    record: str
    time_s: tuple[float, ...]
    measured: tuple[float, ...]
    std: float
    line_s: tuple[float, ...]
    line: tuple[float, ...]
    lags_s: tuple[float, ...]
    without: tuple[float, ...]
    with_law: tuple[float, ...]
    band: float


def check_of(search: RecordSearch, best: RecordLaw) -> RecordCheck:
    """The law of records without the part of the largest motion, against it.

    Args:
        search: of the law.
        best: the law.
    """
    records, out = search.records, search.records.count - 1
    terms = [term for block in best.blocks for term in block.terms]
    errors, strengths = search.without(best.blocks, [out])
    number, part = records.part_of[out]
    record = records.records[number]
    corrected = search.problem.target[out] - search.problem.nuisance[out] @ errors
    at, measured, std = record.force_at(part, corrected)
    rate = record.rate
    dense = np.arange(at[0], at[-1] + 1, max(1, (at[-1] - at[0]) // _LINE))
    force = np.sum([c * record.force(term) for term, c in zip(terms, strengths, strict=True)], axis=0)
    # A preload is not part of a law: the measured force takes the mean of the law's line.
    measured = measured + np.mean(force[at] - measured)
    left = best.fit.corrected - records.columns(terms) @ best.fit.coefficients
    lags, without = autocorrelation(records, search.null.fit.corrected)
    _, with_law = autocorrelation(records, left)
    return RecordCheck(
        record.test.name, tuple(at / rate), tuple(measured), std, tuple(dense / rate),
        tuple(force[dense]), tuple(lags), tuple(without), tuple(with_law),
        2.0 / float(np.sqrt(sum(rows.size for _, rows, _ in records.series()))),
    )  # fmt: skip


def autocorrelation(records: SampledRecords[Any], left: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lags (s) and the autocorrelation at them of whitened rows (P, M), by products of pairs sorted by distance.

    Rows are in step with nothing, so that their pairs have all distances (Gaster and Roberts, J. Inst. Math. Appl. 15
    (1975) 195).
    """
    series = records.series()
    times = [time_s for _, _, time_s in series]
    step = max(float(np.median([np.ptp(time_s) / max(time_s.size - 1, 1) for time_s in times])), 1e-12)
    count = max(2, min(_LAGS, int(_LONGEST * min(float(np.ptp(time_s)) for time_s in times) / step)))
    sums, pairs, squares, rows = np.zeros(count), np.zeros(count), 0.0, 0
    for number, where, time_s in series:
        values = left[number, where] - left[number, where].mean()
        slots = np.round(np.abs(time_s[:, np.newaxis] - time_s) / step).astype(int)
        within = slots < count
        sums += np.bincount(slots[within], np.outer(values, values)[within], count)
        pairs += np.bincount(slots[within], minlength=count)
        squares, rows = squares + float(values @ values), rows + values.size
    found = sums / np.maximum(pairs, 1.0) * rows / max(squares, 1e-300)
    found[0] = 1.0
    return np.asarray(step * np.arange(count)), found
