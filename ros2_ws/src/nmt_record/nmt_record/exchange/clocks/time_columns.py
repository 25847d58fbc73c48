"""Columns that together or after a correction are a clock: seconds next to nanoseconds, counters that begin again, day
numbers, rows that stand newest first."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_record.exchange.source_table import SourceTable, split_name

TIME_NAME = re.compile(
    r"(time|t|zeit|timestamps?|seconds|date[ /_-]?time|elapsed([ _]time)?|zeitstempel|stamp|x_value|uhrzeit|datum|date|"
    r"datenum|micros|millis|nanos|hours|minutes|days)(\.?\d+)?([_ ].*)?$",
    re.I,
)
_WORD_UNITS = {
    "seconds": "s", "micros": "us", "millis": "ms", "nanos": "ns", "hours": "h", "minutes": "min", "days": "d",
    "datenum": "d",
}  # fmt: skip
_SECONDS = re.compile(r"(.*?)(seconds|secs|sec)$", re.I)
_FRACTION = re.compile(
    r"(.*?)(?:(nanoseconds|nanosecs?|nanos|nsecs?)|(microseconds|usecs?|micros)|(milliseconds|msecs?|millis))$", re.I
)
_COUNTERS = (2.0**16, 2.0**24, 2.0**31, 2.0**32)
_ROUNDS_OF_A_DAY = (3600.0, 43200.0, 86400.0)  # of stamps without a date: mm:ss, twelve hours, a day
_DAYS = ((25_569.0, 73_051.0), (719_529.0, 767_011.0))
"""Days of 1970 to 2100 as spreadsheets and MATLAB count them."""
_FASTEST = 1e-6  # a column of such numbers in smaller steps would be a clock of more than 1 MHz
_FEWEST_UNITED, _FEWEST_BETWEEN = 100, 5
_ON_GRID = 5e-3  # of a step
_DAILY = 1.0 / 1440.0  # a minute as a day number


def unit_of_word(name: str) -> str:
    """Unit of a clock that its whole name tells, such as micros; empty if none."""
    return _WORD_UNITS.get(name.lower(), "")


def day_numbers(name: str, column: FloatArray) -> bool | None:
    """Whether a column without a unit counts days as spreadsheets or MATLAB do; None = it may be."""
    if column.size < 3 or not np.isfinite(column[0]):
        return False
    if not any(low <= column[0] < high for low, high in _DAYS):
        return False
    steps = np.diff(column)
    step = float(np.nanmedian(steps))
    if not 0.0 < step < _DAILY and not (step == 0.0 and np.nanmax(steps) < _DAILY):
        return False
    return True if step < _FASTEST or re.match(r"dat|excel|serial|matlab", name, re.I) else None


def clocks_joined(table: SourceTable, time: str | int | None = None) -> SourceTable:
    """A table whose clocks are one column each that rises: what is said of it goes into its notes.

    Args:
        table: as read.
        time: the column that the sidecar calls the time.
    """
    table = _seconds_with_fractions(table)
    clocks = [index for index, name in enumerate(table.names) if index in table.stamps or TIME_NAME.match(_bare(name))]
    if time is not None and not isinstance(time, int):
        clocks += [index for index, name in enumerate(table.names) if name == time and index not in clocks]
    elif isinstance(time, int) and 0 < time <= len(table.columns) and time - 1 not in clocks:
        clocks.append(time - 1)
    for index in clocks:
        _count_on(table, index)
    return _of_one_clock(_oldest_first(table, clocks), clocks)


def _bare(name: str) -> str:
    return split_name(name)[0].strip()


def _seconds_with_fractions(table: SourceTable) -> SourceTable:
    """Seconds of a column of whole ones and of one with their fractions, in the place of the first."""
    columns, stamps, parts = list(table.columns), list(table.stamps), list(table.parts)
    for index, name in enumerate(table.names):
        seconds_name = _SECONDS.match(_bare(name))
        if seconds_name is None or _FRACTION.match(_bare(name)):
            continue
        for other, other_name in enumerate(table.names):
            found = _FRACTION.match(_bare(other_name))
            if found is None or found[1].lower() != seconds_name[1].lower():
                continue
            digits = 9 if found[2] else 6 if found[3] else 3
            seconds, fractions = columns[index], columns[other]
            if not (_whole(seconds) and _whole(fractions)) or float(np.nanmax(fractions)) >= 10.0**digits:
                continue
            columns[index] = (seconds - seconds[0]) + fractions * 10.0**-digits
            stamps.append(index)
            parts.append(other)
            table.notes.append(
                f"Columns {name} and {other_name} of {table.file} are seconds and fractions of a stamp; together they "
                "were read as the time, in seconds after the first whole one."
            )
            break
    return dataclasses.replace(table, columns=tuple(columns), stamps=tuple(sorted(set(stamps))), parts=tuple(parts))


def _whole(column: FloatArray) -> bool:
    return bool(np.isfinite(column).all() and (column >= 0.0).all() and (column == np.round(column)).all())


def _count_on(table: SourceTable, index: int) -> None:
    """A counter that began again goes on, in place."""
    column = table.columns[index]
    steps = np.diff(column)
    if column.size < 3 or not np.isfinite(column).all():
        return
    back = np.flatnonzero(steps < 0.0)
    if not back.size or back.size > 0.01 * steps.size:
        return
    typical = float(np.median(steps))
    if index in table.stamps:
        rounds: Sequence[float] = _ROUNDS_OF_A_DAY
    elif (column == np.round(column)).all():
        rounds = _COUNTERS
    else:
        return
    largest = max(10.0 * typical, float(np.percentile(steps, 99)))
    for period in rounds:
        if column.max() < period and ((steps[back] + period > 0.0) & (steps[back] + period <= largest)).all():
            added = np.zeros(column.size)
            added[back + 1] = period
            table.columns[index].flat[:] = column + np.cumsum(added)
            counted = "the time of day" if index in table.stamps else f"the counter of {period:.0f}"
            table.notes.append(
                f"Column {table.names[index] or index + 1} of {table.file} begins again {back.size} times (first at "
                f"{table.place(int(back[0]) + 1)}), as {counted} does; it was read as going on."
            )
            return


def _oldest_first(table: SourceTable, clocks: Sequence[int]) -> SourceTable:
    """The rows in the order of time, where every clock falls from the first row to the last."""
    known = [table.columns[index] for index in clocks if np.isfinite(table.columns[index]).sum() > 2]
    if not known or not all(_falls(column) for column in known):
        return table
    turned = table.reversed()
    for index in turned.stamps:
        turned.columns[index].flat[:] = turned.columns[index] - turned.columns[index][0]
    turned.notes.append(f"The rows of {table.file} stand newest first; they were read in the order of time.")
    return turned


def _of_one_clock(table: SourceTable, clocks: Sequence[int]) -> SourceTable:
    """The rows of an even clock, where those of another one stand between them: groups of two rates in one table, with
    values between their samples interpolated (asammdf, writing without a raster)."""
    if len(clocks) != 1 or table.rows < _FEWEST_UNITED or clocks[0] in table.parts:
        return table
    time = table.columns[clocks[0]]
    steps = np.diff(time)
    if not np.isfinite(time).all() or not (steps > 0.0).all():
        return table
    step, start = float(np.median(steps)), 0.0
    phases = np.angle(np.exp(2j * np.pi * (time[:_FEWEST_UNITED] - time[0]) / step))
    start = float(time[0] + phases[np.argmax(_neighbours(phases))] / (2.0 * np.pi) * step)
    for count in [_FEWEST_UNITED * 2**k for k in range(1 + int(np.log2(table.rows / _FEWEST_UNITED)))] + [table.rows]:
        # Rounding of the stamps moves the step, more and more from row to row.
        places = (time[:count] - start) / step
        near = np.abs(places - np.round(places)) < 10.0 * _ON_GRID
        if near.sum() > 2:
            step, start = np.polyfit(np.round(places[near]), time[:count][near], 1).tolist()
    places = (time - start) / step
    on_grid = np.abs(places - np.round(places)) < _ON_GRID
    numbers = np.round(places[on_grid])
    between = np.abs(places - np.round(places))[~on_grid]
    if (
        not _FEWEST_BETWEEN <= between.size <= on_grid.sum()
        or not (np.diff(numbers) == 1.0).all()
        or float(np.median(between)) < 10.0 * _ON_GRID
    ):
        return table
    rows, line_of = np.flatnonzero(on_grid), table.lines
    table.notes.append(
        f"{between.size} rows of {table.file} stand at instants of another clock between those of an even one of "
        f"{1.0 / step:.6g} Hz, as where groups of two rates were written into one table; they were left out, and what "
        "was recorded by the other clock is interpolated."
    )
    return dataclasses.replace(
        table,
        columns=tuple(np.ascontiguousarray(column[on_grid]) for column in table.columns),
        lines=None if line_of is None else lambda row: line_of(int(rows[row])),
        breaks=tuple(sorted({int(np.searchsorted(rows, row)) for row in table.breaks})),
    )


def _neighbours(angles: FloatArray) -> FloatArray:
    """How many of angles (rad) lie within a hundredth of a turn behind each."""
    order = np.sort(angles)
    return np.asarray(np.searchsorted(order, angles + 0.02 * np.pi, "right") - np.searchsorted(order, angles, "left"))


def _falls(column: FloatArray) -> bool:
    steps = np.diff(column[np.isfinite(column)])
    return bool(steps.size and (steps <= 0.0).all() and (steps < 0.0).any())
