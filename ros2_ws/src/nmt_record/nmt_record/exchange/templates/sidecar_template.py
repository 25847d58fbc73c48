"""A sidecar to start from, by what a file of data itself tells: columns, clock, quantities, units, kind of test."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import QUANTITIES, TestKind
from nmt_record.exchange.arrays import uff
from nmt_record.exchange.clocks.column_clock import (
    Clock,
    bare_name,
    find_clock,
    is_clock,
    is_packet_counter,
    quantum_of,
    time_unit_of,
)
from nmt_record.exchange.import_table import kind_of, read_table
from nmt_record.exchange.imports.imported_run import check_proposal
from nmt_record.exchange.judgement.channel_checks import hinted_quantity, looks_like_counts
from nmt_record.exchange.judgement.column_faults import sign_bit, value_codes, wrap_of_counts
from nmt_record.exchange.messages.ros_bag_table import bag_tables, is_bag
from nmt_record.exchange.reduced.uff_observables import frequency_responses
from nmt_record.exchange.sidecar.import_sidecar import Sidecar
from nmt_record.exchange.source_table import ClockQuestionError, SourceTable
from nmt_record.exchange.templates.table_template import (
    ASK,
    column_of,
    frequency_columns,
    quoted,
    table_proposal,
    uff_lines,
)
from nmt_record.exchange.unit_table import (
    coordinate_of_unit,
    is_channel_unit,
    measured_quantity,
    plain_unit,
    quantity_of_unit,
    unit_in_name,
)

_LETTER = re.compile(r"([faxvui])_?(\d*)", re.I)
_DECAYED = 0.8  # rms of the last fifth over that of the first
_MOST_CHANNELS = 64
_CLOCK_ANSWERS = {
    "sample_rate": "Hz", "clock": "header or column; of a bag header or log", "time_unit": "s, ms, us, ns, min, h or d",
    "stretch": "a number from 1", "elements": "samples, channels or interleaved 2",
}  # fmt: skip
_DOUBTFUL = 200.0  # Hz: a time without a unit that gives less may be one in ms of a faster recording


def sidecar_templates(path: Path) -> tuple[str, ...]:
    """Texts of sidecars for a file, one for each recording in it; what cannot be guessed is a question mark that the
    import refuses.

    Args:
        path: the data.

    Raises:
        BenchError: the file is not there, of another kind, or malformed.
    """
    head = [f"# A sidecar for {path.name}; check every line, above all what was guessed.", f"file: {path.name}"]
    head.append("# rig: my_rig.yaml        # the rig file of the specimen, next to this file")
    if is_bag(path):
        return tuple(_warned(text, path) for table in bag_tables(path) for text in _texts(table, list(head)))
    if kind_of(path) == "uff" and (responses := frequency_responses(path)):
        others = [f for f in uff.read_uff(path) if f.function_type != uff.FREQUENCY_RESPONSE]
        if all(f.function_type not in (0, uff.TIME_RESPONSE) for f in others):
            kinds = sorted({uff.FUNCTION_NAMES.get(f.function_type, f"type {f.function_type}") for f in others})
            head += [f"# {path.name} also holds {', '.join(kinds)}; they are left out."] if others else []
            return (_checked("\n".join([*head, *uff_lines(responses)]) + "\n", path),)
    table = read_table(path)
    texts = _texts(table, head)
    return tuple(_checked(text, path) for text in texts)


def _checked(text: str, path: Path) -> str:
    """A proposal that the import takes, or that asks.

    Raises:
        BenchError: the data themselves are refused, whatever a sidecar says.
    """
    while not any(ASK in line for line in text.splitlines() if not line.lstrip().startswith("#")):
        sidecar = path.with_suffix(".yaml")
        try:
            check_proposal(text, sidecar)
            return text
        except BenchError as refusal:
            text = _asking(text, str(refusal), sidecar.name) or _raised(refusal)
    return text


def _warned(text: str, path: Path) -> str:
    """A proposal for one topic of a bag; what the import would refuse in it does not close the others."""
    try:
        return _checked(text, path)
    except BenchError as error:
        return f"# As it stands, the import refuses this: {error}\n{text}"


def _raised(refusal: BenchError) -> str:
    raise refusal


def _asking(text: str, sentence: str, name: str) -> str:
    """The proposal with a question at each refusal of the import; empty where that is not a part of it.

    The key that is asked is the one that the refusal names, else quantity, unit or columns of the entry.
    """
    found = re.search(rf"{re.escape(name)} line (\d+)", sentence)
    lines = text.splitlines()
    if found is None or not 0 < int(found[1]) <= len(lines):
        return ""
    place = int(found[1]) - 1
    keys = [key for key in re.findall(r"'(\w+): [^']*'", sentence) if key not in ("kind", "file")]
    for key in dict.fromkeys([*keys, "quantity", "unit", "columns"]):
        for number in range(place, min(place + 6, len(lines))):
            value = rf"\b{key}: ('[^']*'|{{[^}}]*}}|\[[^\]]*\]|[^,}}#]+?)(?=\s*(?:[,}}#]|$))"
            asked = re.sub(value, f"{key}: {ASK}", lines[number], count=1)
            if asked != lines[number] or (number > place and lines[number].lstrip().startswith("- ")):
                break
        else:
            asked, number = "", place
        if asked and asked != lines[number]:
            lines[number] = asked
        elif key not in keys:
            continue
        elif "}" in lines[place]:
            lines[place] = re.sub(r"\}(?=[^}]*$)", f", {key}: {ASK}}}", lines[place], count=1)
        else:
            lines.insert(place + 1, f"    {key}: {ASK}")
        lines.insert(place, f"# {sentence}")
        return "\n".join(lines) + "\n"
    return ""


def _texts(table: SourceTable, head: list[str]) -> tuple[str, ...]:
    head += [f"# {note}" for note in table.notes]
    every = range(len(table.names))
    if table.judged:
        return ("\n".join([*head, *_signal_lines(table, [], every)]) + "\n",)
    time = [i for i in every if is_clock(table, i)]
    named = frequency_columns(table, time)
    if named:
        return ("\n".join([*head, *table_proposal(table, named)]) + "\n",)
    groups: dict[str, list[int]] = {}
    for index in every:
        groups.setdefault(table.names[index].rpartition(".")[0], []).append(index)
    clocks = {name: next((i for i in own if i in time or _even(table, i)), None) for name, own in groups.items()}
    if len(groups) > 1 and not table.lines and None not in clocks.values() and min(map(len, groups.values())) > 1:
        recordings = [(own, [clocks[name]]) for name, own in groups.items()]
    else:
        unnamed = [i for i in every if not time and (not table.lines or not any(table.names)) and _even(table, i)][:1]
        recordings = [(list(every), list(time or unnamed))]
    return tuple(
        "\n".join([*head, *_signal_lines(table, [i for i in clock if i is not None], own)]) + "\n"
        for own, clock in recordings
    )


def _even(table: SourceTable, index: int) -> bool:
    """Whether a column without a name rises by equal steps, as a clock does."""
    values = table.columns[index]
    steps = np.diff(values)
    nameless = not table.names[index] or bare_name(table, index).rpartition(".")[2].isdigit()
    if (
        not nameless
        or steps.size < 3
        or not np.isfinite(steps).all()
        or not (steps.min() >= 0.0 and values[-1] > values[0])
    ):
        return False
    line = np.linspace(values[0], values[-1], values.size)
    return bool(np.abs(values - line).max() <= max(1.01 * quantum_of(values), 1e-3 * steps.mean()))


def _signal_lines(table: SourceTable, time: Sequence[int], columns: Sequence[int]) -> list[str]:
    """Channels over time."""
    columns = [
        i
        for i in columns
        if i in time
        or not (i in table.parts or _is_empty(table, i) or _numbers_rows(table, i) or is_packet_counter(table, i))
    ]
    lines, clock = _clock_lines(table, time, columns)
    rate = None if clock is None else clock.sample_rate
    start = 0.0 if clock is None else clock.start
    channels = [i for i in columns if i not in time][:_MOST_CHANNELS]
    codes = {index: value_codes(table.columns[index]) for index in channels}
    table = dataclasses.replace(table, columns=tuple(
        np.where(codes[i], np.nan, column) if i in codes and codes[i].any() else column
        for i, column in enumerate(table.columns)
    ))  # fmt: skip
    guesses = {index: _guess(table, index) for index in channels}
    # Volts are the drive's or a sensor's; which, a name may say.
    kept = [i for i in channels if guesses[i].quantity != "voltage" or _is_drive(bare_name(table, i))]
    if not kept:
        guesses = {index: _Guess(point=1) for index in channels}
        kept = channels
    if table.names[channels[0]].startswith("/"):  # messages have many unused fields
        kept = [i for i in kept if np.nanmax(table.columns[i]) > np.nanmin(table.columns[i])] or kept
    kept = [i for i in kept if not any(_same(table.columns[i], table.columns[j]) for j in kept if j < i)]
    lines.append("channels:")
    taken: set[tuple[Quantity | str, int]] = set()
    for index in channels:
        guess, values, scaling = guesses[index], table.columns[index], table.scalings[index]
        signed = sign_bit(values)
        begins_again = None if signed or guess.quantity in ("angle", "displacement") else wrap_of_counts(values)
        point, measured = guess.point, guess.quantity and measured_quantity(guess.quantity)
        if table.judged and not guess.quantity:
            point = 1  # whatever it measures, no other channel measures the same there
        asked = table.points[index] < 0
        while (measured, point) in taken and not asked:
            point += 1
        mark = "  - " if index in kept else "  # - "
        if index in kept and not asked:
            taken.add((measured, point))
        words = [
            f"column: {column_of(table, index)}",
            f"quantity: {guess.quantity or ASK}",
            f"unit: {quoted(guess.unit) if guess.unit else ASK}",
            *([f"scale: {ASK}"] if not scaling.has_scale and looks_like_counts(values[np.isfinite(values)]) else []),
            *([f"scale: {guess.scale:.9g}"] if guess.scale != 1.0 else []),
            *(["sign: -1"] if scaling.sign < 0 else []),
            *([f"wrap: {ASK}"] if begins_again is not None else []),
            *([f"sign_bit: {signed}"] if signed else []),
            *([f"point: {ASK}"] if asked else [f"point: {point}"] if point else []),
        ]
        still = not np.nanmax(values) > np.nanmin(values)
        twice = any(_same(values, table.columns[other]) for other in kept if other < index)
        left_out = (
            "; it does not move"
            if still
            else "; the same numbers as another"
            if twice
            else "; volts of what? as a channel it needs quantity, unit and scale"
        )
        why = "" if index in kept else left_out
        why += f"; scale {scaling.scale:g} by {scaling.words}" if scaling.has_scale else ""
        why += f"; by {scaling.words}" if scaling.sign < 0 else ""
        why += f"; without {int(codes[index].sum())} codes of no value" if codes[index].any() else ""
        if begins_again is not None:
            why += f"; it jumps by {begins_again.period:.0f}: wrap of numbers without their sign or of a counter, or 0"
        why += f"; guessed: sign and magnitude, bit {signed} is the sign" if signed else ""
        why += _CURRENT if guess.quantity == "current" else ""
        why += _unknown_unit(table, index) if not guess.unit else ""
        why = why or ("; the model's coordinate is then in rad or a strain" if coordinate_of_unit(guess.unit) else "")
        lines.append(f"{mark}{{{', '.join(words)}}}   # from {np.nanmin(values):.4g} to {np.nanmax(values):.4g}{why}")
    if any(
        table.names[i].endswith(".y") and table.names[i][:-1] + "x" in map(table.names.__getitem__, kept) for i in kept
    ):
        lines.append(
            "# x, y and z of one sensor are one point in three directions; a point of the model is one direction."
        )
    lines.append("segments:")
    rows = table.rows if clock is None else clock.samples
    for first, last in (table.stretches if rate else ()) or ((0, rows),):
        pairs = [(guesses[index].quantity, table.columns[index][first:last]) for index in kept]
        lines.append(_segment_line(pairs, start + (first / rate if rate else 0.0), last - first, rate))
    lines.append("    # kinds: phase_resonance, stepped_sine (with window: [begin, end]), random, ring_down, record")
    return lines


def _same(first: FloatArray, second: FloatArray) -> bool:
    """Whether two columns hold the same numbers, which the import takes for one that was exported twice."""
    return bool(np.nanmax(first) > np.nanmin(first)) and np.array_equal(first, second, equal_nan=True)


def _filled(values: FloatArray) -> FloatArray:
    """Values with straight lines over what is missing."""
    good = np.isfinite(values)
    if good.all():
        return values
    places = np.arange(values.size)
    return np.asarray(np.interp(places, places[good], values[good]), dtype=np.float64)


def _segment_line(channels: Sequence[tuple[str, FloatArray]], start: float, rows: int, rate: float | None) -> str:
    """What was probably done in a stretch of the data that begins at a time (s)."""
    channels = [(quantity, _filled(values)) for quantity, values in channels if np.isfinite(values).any()]
    kind, hit = _kind(channels), _end_of_hit(channels) if rate else 0
    begin, until = "0", ASK
    if rate:
        stop = start + rows / rate
        if hit:
            kind, start = TestKind.RING_DOWN, start + hit / rate
        elif kind is TestKind.RING_DOWN:
            stop = min(stop, start + max(_moving(values) for _, values in channels) / rate)
        begin, until = _time_text(start, rate), _time_text(stop, rate)
    why = "; what follows the hit. With the hit it is a record of force and response" if hit else ""
    return f"  - {{kind: {kind.label}, start: {begin}, stop: {until}}}   # guessed{why}"


def _is_empty(table: SourceTable, index: int) -> bool:
    return not np.isfinite(table.columns[index]).any()


def _numbers_rows(table: SourceTable, index: int) -> bool:
    """Whether a column only counts the rows."""
    values = table.columns[index]
    counts = values.size > 3 and bool((np.diff(values) == 1.0).all()) and values[0] in (0.0, 1.0)
    return counts and _COUNTER.fullmatch(bare_name(table, index)) is not None and len(table.names) > 1


def _unknown_unit(table: SourceTable, index: int) -> str:
    own = table.units[index]
    if _TEMPERATURE.fullmatch(own.strip("[]() ")):
        return f"; the file says '{own}': a strength may follow it as quantity: voltage, unit: V, with such a sensor"
    return f"; the file says '{own}'" if own else ""


def _clock_lines(table: SourceTable, time: Sequence[int], columns: Sequence[int]) -> tuple[list[str], Clock | None]:
    """Lines on the clock, and the clock as the import will find it; None where the sidecar must be completed."""
    if table.question is not None:
        sentence, key = table.question
        return [f"# {sentence}", f"{key}: {ASK}          # {_CLOCK_ANSWERS[key]}"], None
    others = [index for index in columns if index not in time]
    named = not time or bool(table.names[time[0]])
    if not others:
        raise BenchError(f"{table.file} has a clock and no channels; name the file with the data.")
    values: dict[str, Any] = {
        "file": table.file,
        "channels": [{"column": index + 1, "quantity": "force", "unit": "N", "point": index} for index in others],
    }
    lines = []
    own_header = table.step is not None and bool(time) and table.names[time[0]].startswith("X_Value")
    if time and not own_header:
        values["time"] = time[0] + 1
        lines.append(f"time: {column_of(table, time[0])}")
        unit = time_unit_of(table, time[0])
        if unit not in ("", "s"):
            values["time_unit"] = unit
            lines.append(f"time_unit: {unit}")
    try:
        clock = find_clock(table, Sidecar.model_validate(values), "this sidecar")
    except ClockQuestionError as question:
        if question.key != "sample_rate":
            lines.append(f"# {question}")
        return [*lines, f"{question.key}: {ASK}          # {_CLOCK_ANSWERS[question.key]}"], None
    unsure = bool(time) and not own_header and not time_unit_of(table, time[0]) and table.abscissa is None
    if unsure and (not named or clock.sample_rate < _DOUBTFUL):
        told = f"# seconds would be {clock.sample_rate:.6g} Hz; s, ms, us, ns, min, h or d"
        return [*lines, f"time_unit: {ASK}        {told}"], None
    by = table.judged or "the file"
    by = "the time column" if time and not own_header else by
    lines.append(f"# sample_rate: {clock.sample_rate:.10g}     # Hz, by {by}")
    return lines, clock


def _time_text(value: float, rate: float) -> str:
    """A time with the fewest digits that name the sample."""
    for digits in range(3, 18):
        text = f"{value:.{digits}g}"
        if abs(float(text) - value) < 0.05 / rate:
            return text
    return repr(value)


def _end_of_hit(channels: Sequence[tuple[str, FloatArray]]) -> int:
    """Samples until a force that is there for a moment only is over; 0 where there is none, or no response."""
    forces = [values for quantity, values in channels if quantity == "force"]
    if len(forces) != 1 or _kind([pair for pair in channels if pair[0] != "force"]) is not TestKind.RING_DOWN:
        return 0
    values = np.abs(forces[0] - np.nanmedian(forces[0]))
    noise = 1.4826 * float(np.nanmedian(values))
    acting = np.flatnonzero(values > max(0.01 * float(np.nanmax(values)), 8.0 * noise))
    is_hit = acting.size and acting[-1] < 0.2 * values.size and acting[-1] - acting[0] < 0.05 * values.size
    return int(acting[-1]) + 2 if is_hit else 0


def _moving(values: FloatArray) -> int:
    """Samples until a decay is at rest, within five standard deviations of a last fifth that decays no more."""
    fifth = max(2, values.size // 5)
    early, late = (float(np.nanstd(part)) for part in np.array_split(values[-fifth:], 2))
    above = np.flatnonzero(np.abs(values - np.nanmean(values[-fifth:])) > 5.0 * late)
    return int(above[-1]) + 1 if early < 1.4 * late and above.size else values.size


def _is_drive(name: str) -> bool:
    return bool(_LETTER.fullmatch(name) or re.search(r"drive|volt|input|source|signal|excit|\bu\b", name, re.I))


_CURRENT = "; with force_factor: … (N per A) it stands where a force does"
_TEMPERATURE = re.compile(r"°?\s*(deg\.?\s*)?[CKF]|℃|℉|celsius|kelvin", re.I)
_COUNTER = re.compile(r"(x|n|no|nr|number|index|idx|sample|samples|sequence|seq|point|count|scan|row|#)\.?", re.I)


@dataclass(frozen=True)
class _Guess:
    quantity: str = ""
    unit: str = ""
    point: int = 0
    scale: float = 1.0


_SENSITIVITY = re.compile(r"([\d.]+)\s*(m?V)\s*/\s*\(?([a-zA-Zµ²/^0-9]+)")


def _guess(table: SourceTable, index: int) -> _Guess:
    """Quantity, unit and point of a column; empty and 0 where nothing tells them."""
    name, unit, quantity = bare_name(table, index), table.units[index], table.quantities[index]
    if table.fields:  # what somebody called a thing says not what it measures
        name = table.fields[index].rpartition(".")[2]
    unit = unit if is_channel_unit(unit) else ""
    if not unit and quantity is Quantity.UNKNOWN:
        name, unit = unit_in_name(name)
    letter = _LETTER.fullmatch(name)
    digits = re.search(r"(\d+)$", name)
    point = int(digits.group(1)) if digits and 0 < len(digits.group(1)) < 4 and name != digits.group(1) else 1
    point = max(table.points[index], 0) or point
    found = _SENSITIVITY.search(table.names[index])
    if found and plain_unit(unit) in ("V", "mV", "") and float(found[1]) > 0.0:
        sensor = quantity_of_unit(found[3])
        if sensor is not Quantity.UNKNOWN:
            volts = 1e-3 if plain_unit(unit) == "mV" else 1.0
            return _Guess(
                sensor.name.lower(), found[3], 1, volts / float(found[1]) * (1e3 if found[2] == "mV" else 1.0)
            )
    if quantity is Quantity.UNKNOWN:
        quantity = quantity_of_unit(unit) if unit else Quantity.UNKNOWN
    # Of a message: names of joints are no letters of quantities.
    field = bool(table.fields) or table.names[index].startswith("/")
    if quantity is Quantity.UNKNOWN:
        quantity = hinted_quantity(name, 0 if field else point)
    if quantity is Quantity.UNKNOWN and letter and not field:
        quantity = QUANTITIES[letter.group(1).lower()]
    placed = quantity not in (Quantity.UNKNOWN, Quantity.VOLTAGE, Quantity.CURRENT)
    known = "" if quantity is Quantity.UNKNOWN else quantity.name.lower()
    return _Guess(coordinate_of_unit(unit) or known, unit, point if placed else 0)


def _kind(channels: Sequence[tuple[str, FloatArray]]) -> TestKind:
    """A decay if there are responses only and the last fifth is smaller than the first."""
    if any(quantity in ("force", "voltage", "current") for quantity, _ in channels) or not channels:
        return TestKind.RECORD
    fifth = max(1, channels[0][1].size // 5)
    sizes = [(np.nanstd(values[:fifth]), np.nanstd(values[-fifth:])) for _, values in channels]
    return TestKind.RING_DOWN if all(last < _DECAYED * first for first, last in sizes) else TestKind.RECORD


def no_sidecar(path: Path) -> BenchError:
    """What to say where data are given in place of a sidecar, or a sidecar is not there."""
    if path.is_file() or is_bag(path):
        what = f"{path} is a file of data; an import needs a sidecar that says what its columns are"
        return BenchError(f"{what}: './nmt import --init {path}' writes one to start from.")
    return BenchError(
        f"There is no sidecar {path}; it says what the columns of the data are: './nmt import --init FILE' writes one "
        "for a file of data."
    )
