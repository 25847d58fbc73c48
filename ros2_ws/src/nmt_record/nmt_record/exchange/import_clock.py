"""The clock of imported data: from a time column or a stated rate to samples at equal steps, or a refusal."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nmt_core.arrays import FloatArray
from nmt_core.blocks import Quantity
from nmt_core.errors import BenchError
from nmt_record.exchange.import_sidecar import Sidecar
from nmt_record.exchange.import_table import SourceTable, split_name
from nmt_record.exchange.unit_table import other_factor, plain_unit, quantity_of_unit

_TIME_NAME = re.compile(r"(time|t|zeit|timestamp|seconds)(\.?\d+)?([_ ].*)?$", re.I)
# Steps may scatter by this share (rounded or jittering time stamps); above it they are another clock's.
_STEP_TOLERANCE = 0.3
_LARGEST_LOSS = 0.05
_SAME_RATE = 1e-3
_NOTED_DIFFERENCE = 2e-5


@dataclass
class Clock:
    """Where the rows of a table are on a grid of equal steps.

    Attributes:
        sample_rate: Hz.
        start: time of the first row on the file's time axis, s.
        samples: length of the grid.
        rows: index on the grid of each row; None = row k is sample k.
        notes: sentences on what was found.
    """

    sample_rate: float
    start: float
    samples: int
    rows: np.ndarray | None = None
    notes: list[str] = field(default_factory=list)

    def spread(self, column: FloatArray) -> FloatArray:
        """A column on the grid, NaN where samples are missing."""
        if self.rows is None:
            return column
        result = np.full(self.samples, np.nan)
        result[self.rows] = column
        return result

    def sample(self, time: float) -> int:
        """Sample on the grid nearest to a time of the file's axis."""
        return round((time - self.start) * self.sample_rate)


def find_clock(table: SourceTable, sidecar: Sidecar, place: str) -> Clock:
    """Sampling rate and grid of a table.

    Args:
        table: the data.
        sidecar: names the rate, a time column or both; they must agree.
        place: of the sidecar, for messages.

    Raises:
        BenchError: no clock, two clocks, a time column that jumps back or is uneven, or one that contradicts the rate.
    """
    stated = sidecar.sample_rate
    if table.sample_rate is not None:
        if stated is not None and abs(table.sample_rate / stated - 1.0) > 1e-9:
            raise BenchError(
                f"{place}: sample_rate is {stated:g} Hz, but {table.file} itself says {table.sample_rate:g} Hz; which?"
            )
        stated = stated or table.sample_rate
    time, name = _time_axis(table, sidecar, place)
    clock = _stated_clock(table, stated, sidecar, place) if time is None else _measured_clock(table, time, name, stated)
    if "first_sample" in sidecar.model_fields_set:
        # Six digits of a time axis do not name a late sample.
        start = sidecar.first_sample / clock.sample_rate
        if time is not None or table.start is not None:
            _check_first_sample(clock, start, sidecar, place)
        clock.start = start
    return clock


def _check_first_sample(clock: Clock, start: float, sidecar: Sidecar, place: str) -> None:
    if abs(clock.start - start) > max(0.51 / clock.sample_rate, 1e-5 * abs(start)):
        raise BenchError(
            f"{place}: first_sample is {sidecar.first_sample} ({start:.6g} s), but the time axis begins at "
            f"{clock.start:.6g} s."
        )


def _stated_clock(table: SourceTable, stated: float | None, sidecar: Sidecar, place: str) -> Clock:
    if table.step is not None:
        own = 1.0 / table.step
        if stated is not None and abs(stated / own - 1.0) > _NOTED_DIFFERENCE:
            raise BenchError(
                f"{place}: sample_rate is {stated:g} Hz, but {table.file} says {own:.6g} Hz; which of the two is it?"
            )
        rate = stated or _shortest(own, 1e-5)
        return Clock(rate, table.start or 0.0, table.rows)
    if stated is None:
        raise BenchError(
            f"{place}: give sample_rate: … in Hz or time: … with the name of the time column of {table.file}."
        )
    if table.breaks:
        raise BenchError(
            f"The header of {table.file} is repeated before {table.place(table.breaks[0])} and there is no time column "
            "to tell whether samples are missing there; split the file or add the time column."
        )
    return Clock(stated, 0.0, table.rows)


def _time_axis(table: SourceTable, sidecar: Sidecar, place: str) -> tuple[FloatArray | None, str]:
    if table.abscissa is not None:
        return table.abscissa, "the time axis"
    used = {table.index(channel.column, place) for channel in sidecar.channels}
    candidates = [
        index for index, name in enumerate(table.names) if index not in used and name and is_clock(table, index)
    ]
    if sidecar.time is not None:
        chosen = table.index(sidecar.time, f"{place}: time")
        if chosen in used:
            raise BenchError(f"{place}: column {sidecar.time} is named as time and as a channel; it can only be one.")
    elif len(candidates) == 1 or (candidates and _equal_columns(table, candidates)):
        chosen = candidates[0]
    elif candidates:
        raise BenchError(_two_clocks(table, candidates))
    else:
        return None, ""
    others = [index for index in candidates if index != chosen]
    if others and not _equal_columns(table, [chosen, *others]):
        raise BenchError(_two_clocks(table, [chosen, *others]))
    factor = other_factor("time", _time_unit(table, chosen, sidecar, place), f"{place}: time")
    return table.columns[chosen] * factor, f"column {table.names[chosen] or chosen + 1}"


def bare_name(table: SourceTable, index: int) -> str:
    """Name of a column without its unit; of a member of a struct the last part."""
    name = split_name(table.names[index])[0].strip()
    last = name.rpartition(".")[2]
    return name if table.lines or last.isdigit() else last


def is_clock(table: SourceTable, index: int) -> bool:
    """Whether a column is a clock by its name, and not by its unit something else ("Time Signal" in m/s)."""
    other = quantity_of_unit(table.units[index]) is not Quantity.UNKNOWN
    return not other and _names_time(bare_name(table, index), table.columns[index])


def _names_time(name: str, column: FloatArray) -> bool:
    """Whether a column is a clock by its name; t1 may be a temperature too, unless it only rises."""
    found = _TIME_NAME.match(name)
    if not found:
        return False
    return not (found[1].lower() == "t" and found[2]) or bool((np.diff(column) > 0.0).all())


def _time_unit(table: SourceTable, chosen: int, sidecar: Sidecar, place: str) -> str:
    own = plain_unit(table.units[chosen]) if table.units[chosen] else ""
    if "time_unit" not in sidecar.model_fields_set:
        return own or "s"
    if own and own != sidecar.time_unit:
        raise BenchError(
            f"{place}: time_unit is {sidecar.time_unit}, but {table.file} says {own}; correct one of them."
        )
    return sidecar.time_unit


def _equal_columns(table: SourceTable, columns: list[int]) -> bool:
    return all(np.array_equal(table.columns[columns[0]], table.columns[other], equal_nan=True) for other in columns[1:])


def _two_clocks(table: SourceTable, columns: list[int]) -> str:
    names = " and ".join(table.names[index] for index in columns[:2])
    return (
        f"{table.file} has two clocks, the columns {names}; bring the channels to one clock or import them one by one."
    )


def _measured_clock(table: SourceTable, time: FloatArray, name: str, stated: float | None) -> Clock:
    if time.shape[0] < 3:
        raise BenchError(f"{table.file} has {time.shape[0]} rows; a recording needs at least three.")
    if not np.isfinite(time).all():
        row = int(np.argmin(np.isfinite(time)))
        raise BenchError(
            f"The time is missing at {table.place(row)}; every row needs one, or give sample_rate and leave time out."
        )
    steps = np.diff(time)
    if not (steps > 0.0).all():
        raise BenchError(_not_ascending(table, time, steps, name))
    step = 1.0 / stated if stated is not None else float(np.median(steps))
    typical = float(np.median(steps))
    if stated is not None and abs(typical * stated - 1.0) > _STEP_TOLERANCE:
        raise BenchError(
            f"sample_rate is {stated:g} Hz, but {name} of {table.file} goes in steps of {typical:.6g} s "
            f"({1.0 / typical:.6g} Hz); correct one of them (unit of the time?)."
        )
    whole = np.round(steps / step)
    missing = int(np.maximum(whole - 1.0, 0.0).sum())
    uneven = np.abs(steps / step - whole) > _STEP_TOLERANCE
    if missing > _LARGEST_LOSS * time.shape[0] or uneven.any():
        raise BenchError(_uneven(table, time, steps, step, whole, uneven, name))
    whole = np.maximum(whole, 1.0)
    index = np.concatenate(([0], np.cumsum(whole))).astype(np.int64)
    fitted = float((time[-1] - time[0]) / index[-1])
    drift = time - time[0] - index * fitted
    worst = int(np.argmax(np.abs(drift)))
    if abs(drift[worst]) > max(0.6 * step, 1e-6 * (time[-1] - time[0])):
        raise BenchError(
            f"The rate changes within {table.file}: at {table.place(worst)} {name} is {abs(drift[worst]):.3g} s off an "
            "even clock (two clocks in one table, or a gap that is no whole number of samples); split the file there."
        )
    return _grid(table, time, index, fitted, stated, missing, name)


def _grid(
    table: SourceTable,
    time: FloatArray,
    index: np.ndarray,
    fitted: float,
    stated: float | None,
    missing: int,
    name: str,
) -> Clock:
    notes = []
    # Rounded time stamps scatter about the even clock by as much as their ends may be off.
    scatter = float(np.abs(time - time[0] - index * fitted).max())
    uncertainty = 2.0 * scatter / float(time[-1] - time[0]) + 1e-12
    rate = stated if stated is not None else _shortest(1.0 / fitted, uncertainty)
    difference = abs(rate * fitted - 1.0)
    if difference > _SAME_RATE + uncertainty:
        raise BenchError(
            f"sample_rate is {rate:g} Hz, but {name} of {table.file} gives {1.0 / fitted:.8g} Hz; correct one of them."
        )
    if difference > _NOTED_DIFFERENCE + uncertainty:
        notes.append(f"The time of {table.file} gives {1.0 / fitted:.8g} Hz, {rate:g} Hz was stated and is used.")
    if stated is None:
        notes.append(f"The sampling rate is {rate:.10g} Hz by {name} of {table.file}.")
    if missing:
        places = np.flatnonzero(np.diff(index) > 1)
        notes.append(
            f"{missing} samples are missing at {len(places)} places (first after {table.place(int(places[0]))}); "
            "they are marked as missing and windows over them will be rejected."
        )
        return Clock(rate, float(time[0]), int(index[-1]) + 1, index, notes)
    return Clock(rate, float(time[0]), table.rows, None, notes)


def _not_ascending(table: SourceTable, time: FloatArray, steps: FloatArray, name: str) -> str:
    row = int(np.argmax(steps <= 0.0))
    where = table.place(row + 1)
    if steps[row] < 0.0:
        return (
            f"{name} of {table.file} jumps back from {time[row]:.9g} to {time[row + 1]:.9g} at {where}: two recordings "
            "or two clocks in one table; split the file there."
        )
    return (
        f"{name} of {table.file} stands still at {where} ({time[row]:.9g} twice); write it with more digits, or leave "
        "it out and give sample_rate."
    )


def _uneven(
    table: SourceTable,
    time: FloatArray,
    steps: FloatArray,
    step: float,
    whole: FloatArray,
    uneven: NDArray[np.bool_],
    name: str,
) -> str:
    bad = uneven | (whole > 1.0)
    first = int(np.argmax(bad))
    half = steps.shape[0] // 2
    early, late = float(np.median(steps[:half])), float(np.median(steps[half:]))
    if abs(early / late - 1.0) > 0.01:
        what = f"steps of {early:.6g} s first and of {late:.6g} s later"
    else:
        place, count = table.place(first + 1), int(bad.sum())
        what = f"a step of {steps[first]:.6g} s at {place} among steps of {step:.6g} s, {count} such in all"
    return (
        f"{name} of {table.file} is not uniform: {what} (two clocks or rates in one table); resample it to one rate or "
        "split it."
    )


def _shortest(value: float, tolerance: float) -> float:
    """The number with the fewest digits within a relative tolerance."""
    for digits in range(1, 16):
        short = float(f"{value:.{digits}g}")
        if abs(short / value - 1.0) <= tolerance:
            return short
    return value
