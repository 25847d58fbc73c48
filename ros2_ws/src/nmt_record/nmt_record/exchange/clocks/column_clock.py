"""The clock of imported data: what the file and its sidecar say of it, judged against each other.

A file may tell its clock in several ways: a step or a rate in its header, a column of times or of stamps, and the
sidecar may give a rate. Each is known to its digits. Those that agree within them are one clock, of which the finest is
used; those that contradict each other are named, and the sidecar says which it is (``clock``).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from decimal import Decimal

import numpy as np
from numpy.typing import NDArray

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_record.exchange.clocks.time_columns import TIME_NAME, day_numbers, unit_of_word
from nmt_record.exchange.sidecar.import_sidecar import Sidecar
from nmt_record.exchange.source_table import ClockQuestionError, SourceTable, split_name
from nmt_record.exchange.unit_table import TIME_UNITS, other_factor, plain_unit, quantity_of_unit, unit_in_name

# Steps may scatter by this share (rounded or jittering time stamps); above it they are another clock's.
_STEP_TOLERANCE = 0.3
_LARGEST_LOSS = 0.05
_SAME_RATE = 1e-3
_NOTED_DIFFERENCE = 2e-5
_EXACT = 1e-8  # relative: a rate known to that is exact
_COARSE = 0.2  # of a step: stamps rounded more coarsely do not say which sample they belong to
_MOST_LOST = 1.0  # rows that a counter misses, in those that are there
_RISING = 0.8  # share of rising steps of a column that is a clock, faulty or not
_SLOW = 20.0  # Hz: below it a time without a unit may be one in ms, or a number of samples
_FAST = 1e5  # Hz: above it one in hours or minutes
_GROUP = re.compile(r"(?:DataGroup|DGM?|ChannelGroup|CG|Group)_?\d+_", re.I)
"""What asammdf and others write before the names of the channels of a group."""
_EPOCH = (1e9, 5e9)  # s since 1970: 2001 to 2128


@dataclass
class Clock:
    """Where the rows of a table are on a grid of equal steps.

    Attributes:
        sample_rate: Hz.
        start: time of the first row on the file's time axis, s.
        samples: length of the grid.
        rows: index on the grid of each row; None = row k is sample k.
        notes: sentences on what was found.
        std: relative standard uncertainty of the rate by the digits of the file; 0 = as given.
    """

    sample_rate: float
    start: float
    samples: int
    rows: np.ndarray | None = None
    notes: list[str] = field(default_factory=list)
    std: float = 0.0

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


@dataclass(frozen=True)
class _Claim:
    """A rate that something says, and by how much it may be off by its digits.

    Attributes:
        key: what the sidecar's ``clock`` calls it: sample_rate, header or column.
        words: who says it.
        rate: Hz.
        spread: largest relative error by the digits.
    """

    key: str
    words: str
    rate: float
    spread: float

    def agrees(self, other: _Claim) -> bool:
        return abs(math.log(self.rate / other.rate)) <= self.spread + other.spread + _NOTED_DIFFERENCE


def find_clock(table: SourceTable, sidecar: Sidecar, place: str) -> Clock:
    """Sampling rate and grid of a table.

    Args:
        table: the data.
        sidecar: may name the rate, a time column or both, and which to believe where the file contradicts itself.
        place: of the sidecar, for messages.

    Raises:
        BenchError: no clock, two clocks, a time column that jumps back or is uneven, or clocks that contradict each
            other.
    """
    given = None
    if sidecar.sample_rate is not None:
        given = _Claim("sample_rate", "sample_rate of the sidecar", sidecar.sample_rate, _digits(sidecar.sample_rate))
    if table.judged:
        return _judged_clock(table, given, sidecar, place)
    header = _header_claim(table, place)
    axis = _time_axis(table, sidecar, place)
    notes: list[str] = []
    column = None if axis is None else _column_claim(table, axis)
    given, header, column = _settled(given, header, column, table, sidecar, place, notes)
    if column is None:
        axis = None
    if axis is None:
        clock = _stated_clock(table, given, header, place)
    else:
        fine = header if header is not None and column is not None and header.spread <= column.spread else None
        stated = given or fine
        _refuse_unknown_unit(axis, column, stated, table, place)
        clock = _measured_clock(table, axis, None if stated is None else stated.rate)
    clock.notes = [*notes, *clock.notes]
    if "first_sample" in sidecar.model_fields_set:
        # Six digits of a time axis do not name a late sample.
        start = sidecar.first_sample / clock.sample_rate
        if axis is not None or table.start is not None:
            _check_first_sample(clock, start, sidecar, place)
        clock.start = start
    return clock


def _judged_clock(table: SourceTable, given: _Claim | None, sidecar: Sidecar, place: str) -> Clock:
    """The clock that a bag's reader has found, next to a rate that the sidecar gives."""
    assert table.step is not None
    measured = 1.0 / table.step
    spread = max(_SAME_RATE, 5.0 * table.step_std)
    if given is not None and sidecar.clock != "sample_rate" and abs(given.rate / measured - 1.0) > spread:
        raise BenchError(
            f"{place}: sample_rate is {given.rate:g} Hz, but the {table.judged} of {table.file} give {measured:.6g} "
            "Hz; which of the two is it? Correct sample_rate, or say 'clock: sample_rate'."
        )
    rate = given.rate if given is not None else _shortest(measured, max(1e-9, table.step_std))
    clock = Clock(rate, table.start or 0.0, table.rows)
    if given is None:
        clock.std = table.step_std if table.step_std > _EXACT else 0.0
        clock.notes.append(f"The sampling rate is {rate:.10g} Hz by the {table.judged} of {table.file}.")
    if "first_sample" in sidecar.model_fields_set:
        clock.start = sidecar.first_sample / rate
    return clock


def _header_claim(table: SourceTable, place: str) -> _Claim | None:
    step = rate = None
    if table.step is not None:
        step = _Claim(
            "header",
            f"the step {table.step:.9g} s in the header of {table.file}",
            1.0 / table.step,
            _digits(table.step),
        )
    if table.sample_rate is not None:
        own = table.sample_rate
        rate = _Claim("header", f"the rate {own:.9g} Hz in the header of {table.file}", own, min(_digits(own), 1e-6))
    if step is not None and rate is not None and not step.agrees(rate):
        raise BenchError(
            f"{table.file} has two clocks that contradict each other: {_text(step)}, but {_text(rate)}; correct one of "
            f"them in the file, or leave both out and give sample_rate in {place}."
        )
    return rate or step


def _digits(value: float) -> float:
    """Largest relative error of a number as it is written; one that is a whole number of Hz, or of them a second, is
    taken as it is."""
    if abs(value - round(value)) < 1e-9 * value or abs(1.0 / value - round(1.0 / value)) < 1e-9 / value:
        return 1e-9
    exponent = Decimal(repr(value)).as_tuple().exponent
    return min(max(0.5 * 10.0 ** int(exponent) / value, 1e-9), 6e-3)


def _column_claim(table: SourceTable, axis: _Axis) -> _Claim:
    """What the time column says of the rate; of one that must be refused anyway, nothing."""
    time, words = axis.time, f"{axis.name} of {table.file}"
    if time.shape[0] < 3 or not np.isfinite(time).all() or not time[-1] > time[0]:
        return _Claim("column", words, 1.0, math.inf)
    steps = np.diff(time)
    count, span = steps.size, float(time[-1] - time[0])
    coarse = axis.quantum > _COARSE * float(np.median(steps)) and _shows_rounding(axis, steps)
    if coarse or not (steps > 0.0).all():
        return _Claim("column", words, count / span, min((1.0 + axis.quantum * count / span) / count + 0.05, 0.3))
    typical = float(np.median(steps))
    rounding = axis.quantum / typical if _shows_rounding(axis, steps) else 0.0
    return _Claim("column", words, 1.0 / typical, max(_SAME_RATE, rounding))


def _shows_rounding(axis: _Axis, steps: FloatArray) -> bool:
    """Whether steps differ by the rounding of their stamps; equal ones are a multiple of it."""
    return float(np.ptp(steps)) > 0.5 * axis.quantum


def _settled(
    given: _Claim | None,
    header: _Claim | None,
    column: _Claim | None,
    table: SourceTable,
    sidecar: Sidecar,
    place: str,
    notes: list[str],
) -> tuple[_Claim | None, _Claim | None, _Claim | None]:
    """The claims that count, by what the sidecar says or by what agrees.

    Raises:
        BenchError: the file contradicts itself or the sidecar.
    """
    claims = {claim.key: claim for claim in (given, header, column) if claim is not None}
    if sidecar.clock is not None:
        if sidecar.clock not in claims:
            there = ", ".join(claims) or "none"
            raise BenchError(
                f"{place}: clock is {sidecar.clock}, but there is no such clock of {table.file}; it has: {there}."
            )
        kept = claims[sidecar.clock]
        others = [claim for key, claim in claims.items() if key != kept.key and not claim.agrees(kept)]
        for claim in others:
            notes.append(f"{_text(claim)} contradicts the sidecar's clock ({_text(kept)}); the first is not used.")
        claims = {kept.key: kept}
    elif header is not None and given is not None and not header.agrees(given):
        if column is not None and column.agrees(given):
            notes.append(f"{_text(header)} contradicts sample_rate and {column.words}, and is not used.")
            claims.pop("header")
        else:
            itself = " itself" if table.step is None else ""
            raise BenchError(
                f"{place}: sample_rate is {given.rate:g} Hz, but {table.file}{itself} says {header.rate:.6g} Hz; which "
                "of the two is it? Correct sample_rate, or say 'clock: sample_rate'."
            )
    elif header is not None and column is not None and not header.agrees(column):
        if given is None:
            raise ClockQuestionError(
                f"{table.file} has two clocks that contradict each other: {_text(header)}, but {_text(column)}. Which "
                f"is it? Say 'clock: header' or 'clock: column' in {place}, or give sample_rate.",
                "clock",
            )
        notes.append(f"{_text(column)} contradicts sample_rate and {header.words}, and is not used.")
        claims.pop("column")
    return claims.get("sample_rate"), claims.get("header"), claims.get("column")


def _text(claim: _Claim) -> str:
    return f"{claim.words} says {claim.rate:.6g} Hz"


def _refuse_unknown_unit(
    axis: _Axis, column: _Claim | None, stated: _Claim | None, table: SourceTable, place: str
) -> None:
    """A slow clock without a unit may be in ms or count samples."""
    if axis.sure or stated is not None or column is None or math.isinf(column.spread):
        return
    if _SLOW <= column.rate <= _FAST:
        return
    raise ClockQuestionError(
        f"{axis.name} of {table.file} goes in steps of {1.0 / column.rate:.6g} and says no unit: seconds, ms or "
        f"numbers of samples? Give 'time_unit: s' (or {', '.join(TIME_UNITS[1:])}), or sample_rate and 'clock: "
        f"sample_rate', in {place}.",
        "time_unit",
    )


def _check_first_sample(clock: Clock, start: float, sidecar: Sidecar, place: str) -> None:
    if abs(clock.start - start) > max(0.51 / clock.sample_rate, 1e-5 * abs(start)):
        raise BenchError(
            f"{place}: first_sample is {sidecar.first_sample} ({start:.6g} s), but the time axis begins at "
            f"{clock.start:.6g} s."
        )


def _stated_clock(table: SourceTable, given: _Claim | None, header: _Claim | None, place: str) -> Clock:
    if header is not None and table.step is not None and table.sample_rate is None:
        if given is not None:
            return Clock(given.rate, table.start or 0.0, table.rows)
        clock = Clock(_shortest(header.rate, max(1e-5, table.step_std)), table.start or 0.0, table.rows)
        if table.step_std > 0.0:
            clock.std = table.step_std
        elif header.spread > _NOTED_DIFFERENCE:
            clock.std = header.spread / math.sqrt(3.0)
            clock.notes.append(
                f"{header.words[:1].upper()}{header.words[1:]} has few digits: the sampling rate is known to "
                f"{100.0 * header.spread:.2g} % only, and so are frequencies; give sample_rate if it is known better."
            )
        return clock
    stated = given or header
    if stated is None:
        raise ClockQuestionError(
            f"{place}: give sample_rate: … in Hz or time: … with the name of the time column of {table.file}.",
            "sample_rate",
        )
    if table.breaks:
        raise BenchError(
            f"The header of {table.file} is repeated before {table.place(table.breaks[0])} and there is no time column "
            "to tell whether samples are missing there; split the file or add the time column."
        )
    clock = Clock(stated.rate, table.start or 0.0, table.rows)
    counter = next((index for index in range(len(table.names)) if is_packet_counter(table, index)), None)
    if counter is not None:
        places = np.concatenate(([0], np.cumsum(_counted(table.columns[counter])))).astype(np.int64)
        missing = int(places[-1]) + 1 - table.rows
        gaps = np.flatnonzero(np.diff(places) > 1)
        if missing:
            clock.samples, clock.rows = int(places[-1]) + 1, places
            clock.notes.append(
                f"{missing} samples are missing at {gaps.size} places (first after {table.place(int(gaps[0]))}) by the "
                f"counter {table.names[counter]}; they are marked as missing and windows over them will be rejected."
            )
    return clock


_PACKETS = re.compile(
    r"(packet|frame|sample|message|msg|seq\w*|data)?[ _]?(counter|count|cnt|seq|sequence|index|idx|number|no|nr)\.?$",
    re.I,
)
_COUNTER_SIZES = (2.0**8, 2.0**16, 2.0**32)


def is_packet_counter(table: SourceTable, index: int) -> bool:
    """Whether a column counts what was sent, once for each row, so that its steps tell what is missing."""
    values = table.columns[index]
    if table.judged or not _PACKETS.match(bare_name(table, index).strip()) or values.size < 16:
        return False
    if not np.isfinite(values).all() or not np.array_equal(values, np.round(values)) or values.min() < 0.0:
        return False
    steps = _counted(values)
    # Without a step of one in most rows it counts something else.
    return bool(steps.min() >= 1.0 and (steps == 1.0).mean() > 0.5 and steps.sum() < (1.0 + _MOST_LOST) * steps.size)


def _counted(values: FloatArray) -> FloatArray:
    """Steps of a counter, over its end."""
    steps = np.diff(values)
    size = next((size for size in _COUNTER_SIZES if values.max() < size), _COUNTER_SIZES[-1])
    return np.asarray(np.where(steps < 0.0, steps + size, steps), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class _Axis:
    """A column of times.

    Attributes:
        time: s.
        name: for messages.
        quantum: to which its values are rounded, s.
        sure: its unit is known.
    """

    time: FloatArray
    name: str
    quantum: float
    sure: bool


def _time_axis(table: SourceTable, sidecar: Sidecar, place: str) -> _Axis | None:
    used = {table.index(channel.column, place) for channel in sidecar.channels}
    candidates = [
        index for index, name in enumerate(table.names) if index not in used and name and is_clock(table, index)
    ]
    if sidecar.time is not None:
        chosen = table.index(sidecar.time, f"{place}: time")
        if chosen in used:
            raise BenchError(f"{place}: column {sidecar.time} is named as time and as a channel; it can only be one.")
    elif table.abscissa is not None:
        return _Axis(table.abscissa, "the time axis", quantum_of(table.abscissa), True)
    elif len(candidates) == 1 or (candidates and _equal_columns(table, candidates, sidecar, place)):
        chosen = candidates[0]
    elif candidates:
        raise BenchError(_two_clocks(table, candidates))
    else:
        return None
    others = [index for index in candidates if index != chosen]
    if others and not _equal_columns(table, [chosen, *others], sidecar, place):
        raise BenchError(_two_clocks(table, [chosen, *others]))
    if sidecar.clock in ("sample_rate", "header") and unit_in_doubt(table, chosen):
        return None
    unit = _time_unit(table, chosen, sidecar, place)
    factor = other_factor("time", unit, f"{place}: time")
    column = table.columns[chosen]
    quantum = quantum_of(column)
    if unit == "d":  # dates, as stamps: from the first on, with all digits that they have
        column = column - column[0]
    sure = bool(time_unit_of(table, chosen)) or "time_unit" in sidecar.model_fields_set
    name = f"column {table.names[chosen] or chosen + 1}"
    return _Axis(column * factor, name, quantum * factor, sure)


def quantum_of(values: FloatArray) -> float:
    """Power of ten to which all values are rounded, or the finest that floating point lets one see; 0 below 1e-9."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return 0.0
    largest = float(np.abs(finite).max())
    for digits in range(10):
        scaled = finite * 10.0**digits
        noise = 4.0 * np.finfo(np.float64).eps * largest * 10.0**digits
        if noise > 0.1:
            return 10.0**-digits  # finer roundings cannot be told from those of floating point
        if np.abs(scaled - np.round(scaled)).max() <= max(1e-6, noise):
            return float(10.0**-digits)
    return 0.0


def bare_name(table: SourceTable, index: int) -> str:
    """Name of a column without its unit; of a member of a struct, or of a group of channels, the last part."""
    name = split_name(table.names[index])[0].strip()
    last = _GROUP.sub("", name.rpartition(".")[2])
    return name if table.lines or last.isdigit() else last


def is_clock(table: SourceTable, index: int) -> bool:
    """Whether a column is a clock by its name or its stamps, and not by its unit or its course something else."""
    if index in table.stamps:
        return True
    if table.judged or index in table.parts:
        return False
    other = quantity_of_unit(table.units[index]) is not Quantity.UNKNOWN
    return not other and _names_time(bare_name(table, index), table.columns[index])


def _names_time(name: str, column: FloatArray) -> bool:
    """Whether a column is a clock by its name; t1 may be a temperature too, unless it only rises."""
    found = TIME_NAME.match(name)
    if not found:
        return False
    steps = np.diff(column)
    known = steps[np.isfinite(steps)]
    if known.size and float((known >= 0.0).mean()) < _RISING:
        return False  # time_data may be data over time
    return not (found[1].lower() == "t" and found[3]) or bool((steps > 0.0).all())


def time_unit_of(table: SourceTable, index: int) -> str:
    """Unit of a time column by its brackets, its name or, since 1970, its size; empty if nothing tells it."""
    if index in table.stamps:
        return "s"
    stated = plain_unit(table.units[index])
    if stated in TIME_UNITS or stated.lower() in TIME_UNITS:
        return stated if stated in TIME_UNITS else stated.lower()
    name = bare_name(table, index).strip()
    unit = unit_of_word(name) or unit_in_name(name, time=True)[1]
    if unit and name.lower() not in ("s", "min"):
        return unit
    first = table.columns[index][0] if table.rows else math.nan
    for unit, factor in (("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
        if _EPOCH[0] <= first / factor < _EPOCH[1]:
            return unit
    return "d" if table.rows and day_numbers(name, table.columns[index]) else ""


def unit_in_doubt(table: SourceTable, index: int) -> str:
    """Why the unit of a time column must be asked for although it has the size of a clock's; empty if it need not."""
    name = bare_name(table, index).strip()
    if index in table.stamps or time_unit_of(table, index):
        return ""
    if table.units[index]:
        return f"has the unit '{table.units[index]}', which is none of a time"
    if table.rows and day_numbers(name, table.columns[index]) is None:
        return f"begins with {table.columns[index][0]:.10g}, which may be a number of days"
    return ""


def _time_unit(table: SourceTable, chosen: int, sidecar: Sidecar, place: str) -> str:
    own = time_unit_of(table, chosen)
    if "time_unit" not in sidecar.model_fields_set:
        doubt = unit_in_doubt(table, chosen)
        if doubt:
            raise ClockQuestionError(
                f"Column {table.names[chosen] or chosen + 1} of {table.file} {doubt}; give time_unit "
                f"({', '.join(TIME_UNITS)}; d are days), or sample_rate and 'clock: sample_rate', in {place}.",
                "time_unit",
            )
        return own or "s"
    if own and own != sidecar.time_unit:
        raise BenchError(
            f"{place}: time_unit is {sidecar.time_unit}, but {table.file} says {own}; correct one of them."
        )
    return sidecar.time_unit


def _equal_columns(table: SourceTable, columns: list[int], sidecar: Sidecar, place: str) -> bool:
    """Whether columns of times are one clock within their digits."""
    first = columns[0]

    def seconds(index: int) -> tuple[FloatArray, float]:
        unit = time_unit_of(table, index) or _time_unit(table, first, sidecar, place)
        factor = other_factor("time", unit, f"{place}: time")
        return table.columns[index] * factor, quantum_of(table.columns[index]) * factor

    head, quantum = seconds(first)
    for other in columns[1:]:
        time, own = seconds(other)
        apart = np.abs((time - time[0]) - (head - head[0]))
        same = np.isfinite(time) == np.isfinite(head)
        if not same.all() or not (apart[np.isfinite(apart)] <= 1.01 * max(quantum, own) + 1e-12).all():
            return False
    return True


def _two_clocks(table: SourceTable, columns: list[int]) -> str:
    names = " and ".join(table.names[index] for index in columns[:2])
    return (
        f"{table.file} has two clocks, the columns {names}; bring the channels to one clock or import them one by one."
    )


def _measured_clock(table: SourceTable, axis: _Axis, stated: float | None) -> Clock:
    time, name = axis.time, axis.name
    if time.shape[0] < 3:
        raise BenchError(f"{table.file} has {time.shape[0]} rows; a recording needs at least three.")
    if not np.isfinite(time).all():
        row = int(np.argmin(np.isfinite(time)))
        raise BenchError(
            f"The time is missing at {table.place(row)}; every row needs one, or give sample_rate and "
            "'clock: sample_rate'."
        )
    steps = np.diff(time)
    even = _rounded_stamps(table, axis, steps, stated)
    if even is not None:
        return even
    if not (steps > 0.0).all():
        sentence = _not_ascending(table, time, steps, name)
        if stated is None and not (steps < 0.0).any():
            raise ClockQuestionError(sentence, "sample_rate")
        raise BenchError(sentence)
    step = 1.0 / stated if stated is not None else float(np.median(steps))
    typical = float(np.median(steps))
    if stated is not None and abs(typical * stated - 1.0) > _STEP_TOLERANCE:
        raise BenchError(
            f"sample_rate is {stated:g} Hz, but {name} of {table.file} goes in steps of {typical:.6g} s "
            f"({1.0 / typical:.6g} Hz); correct one of them (unit of the time?), or say "
            "'clock: sample_rate'."
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
            "even clock (two clocks in one table, or a gap that is not a whole number of samples); split the file "
            "there."
        )
    return _grid(table, time, index, fitted, stated, missing, name)


def _rounded_stamps(table: SourceTable, axis: _Axis, steps: FloatArray, stated: float | None) -> Clock | None:
    """The clock of stamps that are rounded so coarsely that steps say nothing; None where they are finer, or no such.

    They are checked against the rate: none is further from an even clock than its rounding.
    """
    time, count = axis.time, axis.time.shape[0] - 1
    span = float(time[-1] - time[0])
    if not span > 0.0 or (steps < 0.0).any() or not axis.quantum > _COARSE * span / count:
        return None
    if not _shows_rounding(axis, steps):
        return None
    if stated is None and not (steps > 0.0).all():
        return None
    rate = stated if stated is not None else count / span
    away = time - time[0] - np.arange(count + 1) / rate
    # The first stamp is rounded, too.
    if float(np.ptp(away)) > 2.01 * axis.quantum:
        return None
    uncertainty = axis.quantum / span
    told = f"{axis.name[:1].upper()}{axis.name[1:]} of {table.file} is rounded to {axis.quantum:.3g} s"
    if stated is not None:
        note = f"{told}, too coarse for {rate:.6g} Hz; it agrees with that rate and was used for nothing else."
        return Clock(rate, float(time[0]), table.rows, None, [note])
    rate = _shortest(rate, uncertainty)
    note = (
        f"{told}: the sampling rate is {rate:.6g} Hz to {100.0 * uncertainty:.2g} %; give sample_rate if it is known."
    )
    return Clock(rate, float(time[0]), table.rows, None, [note], uncertainty / math.sqrt(3.0))


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
    std = 0.0 if stated is not None or uncertainty < _NOTED_DIFFERENCE else uncertainty / math.sqrt(3.0)
    if missing:
        return Clock(rate, float(time[0]), int(index[-1]) + 1, index, notes, std)
    return Clock(rate, float(time[0]), table.rows, None, notes, std)


def _not_ascending(table: SourceTable, time: FloatArray, steps: FloatArray, name: str) -> str:
    row = int(np.argmax(steps <= 0.0))
    where = table.place(row + 1)
    if steps[row] < 0.0:
        return (
            f"{name} of {table.file} jumps back from {time[row]:.9g} to {time[row + 1]:.9g} at {where}: two recordings "
            "or two clocks in one table; split the file there."
        )
    return (
        f"{name} of {table.file} stands still at {where} ({time[row]:.9g} twice); write it with more digits, or give "
        "sample_rate: the column is then only checked."
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
