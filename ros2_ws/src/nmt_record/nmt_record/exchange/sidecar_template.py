"""A sidecar to start from, by what a file of data itself tells: columns, clock, quantities, units, kind of test."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import MOTIONS, QUANTITIES
from nmt_record.exchange import uff
from nmt_record.exchange.import_checks import hinted_quantity, looks_like_counts
from nmt_record.exchange.import_clock import (
    Clock,
    ClockQuestionError,
    bare_name,
    find_clock,
    is_clock,
    quantum_of,
    time_unit_of,
)
from nmt_record.exchange.import_sidecar import Sidecar
from nmt_record.exchange.import_table import SourceTable, kind_of, read_table
from nmt_record.exchange.imported_run import check_proposal
from nmt_record.exchange.ros_bag_table import bag_tables, is_bag
from nmt_record.exchange.unit_table import (
    coordinate_of_unit,
    measured_quantity,
    plain_unit,
    quantity_of_unit,
    unit_in_name,
)

_FREQUENCY = re.compile(r"(f|fr?eq(uency)?)(_?hz)?|hz|hertz", re.I)
# In this order: a damping ratio is no magnitude.
_MEMBERS = {
    "damping_ratio": r"damp(ing)?(_?ratio)?|zeta|delta",
    "real": r"re(al)?(_?part)?",
    "imag": r"im(ag)?(inary)?(_?part)?",
    "magnitude": r"(\w+_)?(mag(nitude)?|abs(olute)?|modulus|ratio)(_\w+)?",
    "phase": r"(pha(se)?|phi|arg(ument)?)(_?(deg(rees)?|rad))?",
    "amplitude": r"amp(l|litude)?|level|disp(lacement)?|acc(eleration)?|a|q",
    "force_n": r"force|load|f_?n",
}
_LETTER = re.compile(r"([faxvui])_?(\d*)", re.I)
_DECAYED = 0.8  # rms of the last fifth over that of the first
_ASK = "'?'"
_MOST_CHANNELS = 64
_CLOCK_ANSWERS = {
    "sample_rate": "Hz", "clock": "header or column; of a bag header or log", "time_unit": "s, ms, us, ns or min",
    "stretch": "a number from 1", "elements": "samples or channels",
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
    head.append("# rig: my_rig.yaml        # the rig file that it is a test of, beside this file")
    if is_bag(path):
        return tuple(_warned(text, path) for table in bag_tables(path) for text in _texts(table, list(head)))
    if kind_of(path) == "uff" and all(f.function_type == uff.FREQUENCY_RESPONSE for f in uff.read_uff(path)):
        lines = ["segments:", f"  - {{kind: frf, unit: {_ASK}}}   # unit of the responses, such as m/s^2/N or g/N"]
        return ("\n".join([*head, *lines]) + "\n",)
    table = read_table(path)
    texts = _texts(table, head)
    return tuple(_checked(text, path) for text in texts)


def _checked(text: str, path: Path) -> str:
    """A proposal that the import takes, or that asks.

    Raises:
        BenchError: the import would refuse it, as it says.
    """
    if _ASK not in text:
        check_proposal(text, path.with_suffix(".yaml"))
    return text


def _warned(text: str, path: Path) -> str:
    """A proposal for one topic of a bag; what the import would refuse in it does not close the others."""
    try:
        return _checked(text, path)
    except BenchError as error:
        return f"# As it stands, the import refuses this: {error}\n{text}"


def _texts(table: SourceTable, head: list[str]) -> tuple[str, ...]:
    head += [f"# {note}" for note in table.notes]
    every = range(len(table.names))
    if table.judged:
        return ("\n".join([*head, *_signal_lines(table, [], every)]) + "\n",)
    time = [i for i in every if is_clock(table, i)]
    named = [i for i in every if _FREQUENCY.fullmatch(bare_name(table, i) or "-")]
    named = named or [i for i in every if plain_unit(table.units[i]) in ("Hz", "kHz") if not time]
    if named and not time and len(table.columns) > 1 and bool((table.columns[named[0]] >= 0.0).all()):
        lines = _held_lines(table, named) or _table_lines(table, named[0])
        return ("\n".join([*head, *lines]) + "\n",)
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


def _held_lines(table: SourceTable, frequencies: Sequence[int]) -> list[str]:
    """Amplitudes and phases of a response at held levels, one segment each; empty where the table is another one."""
    lines: list[str] = []
    used = list(frequencies)
    for index, name in enumerate(table.names):
        if index in frequencies or index in used:
            continue
        prefix = "" if table.lines else name.rpartition(".")[0]
        own = [i for i in range(len(table.names)) if not prefix or table.names[i].startswith(prefix + ".")]
        frequency = next((i for i in frequencies if i in own), None)
        bare, quantity = bare_name(table, index), quantity_of_unit(table.units[index])
        moves = quantity in MOTIONS and not _is_phase(table, index)
        if frequency is None or not (moves or re.fullmatch(_MEMBERS["amplitude"], bare, re.I)):
            continue
        later = [i for i in own if i > index and i not in used]
        phase = later[0] if later and _is_phase(table, later[0]) else None
        if phase is None:
            return []
        used += [index, phase]
        held = next((v for k, v in table.constants.items() if prefix and re.fullmatch(
            re.escape(prefix) + r"\.(force|level)", k, re.I)), None)  # fmt: skip
        columns = {"frequency_hz": frequency, "magnitude": index, "phase": phase}
        named = ", ".join(f"{member}: {_column(table, column)}" for member, column in columns.items())
        unit = table.units[index] if moves else f"{_ASK}   # of the response, such as mm or m/s"
        level = _ASK if held is None else f"{held:g}"
        rising = bool((np.diff(table.columns[frequency]) > 0.0).all())
        lines += [
            "  - kind: frf",
            f"    columns: {{{named}}}",
            f"    unit: {unit}",
            f"    level: {level}            # what was held while the frequency was stepped",
            "    level_unit: N         # guessed; of a force, a motion or a voltage: N, g, mm, V",
            f"    amplitudes: {_ASK}       # of response and level: peak or rms",
            *([f"    direction: {'up' if rising else 'down'}         # by the order of the rows"]),
            *_phase_lines(table, phase, quantity),
            "    point: 1              # guessed",
            "    drive_point: 1        # guessed",
        ]
    return ["segments:", *lines] if lines else []


def _is_phase(table: SourceTable, index: int) -> bool:
    return bool(re.match(rf"({_MEMBERS['phase']})(?![a-z])", bare_name(table, index), re.I))


_MIDWAY_DEG = {motion: 90.0 * (order - 1) for motion, order in MOTIONS.items()}


def _phase_lines(table: SourceTable, index: int, quantity: Quantity) -> list[str]:
    """Unit, sense and offset of a phase over a resonance at the drive point."""
    values = table.columns[index]
    degrees = plain_unit(table.units[index]) == "deg" or float(np.nanmax(np.abs(values))) > 7.0
    lines = (
        [] if plain_unit(table.units[index]) else [f"    units: {{phase: {'deg' if degrees else 'rad'}}}   # guessed"]
    )
    turn = np.unwrap(np.radians(values) if degrees else values)
    ends = np.degrees([np.median(turn[: turn.size // 20 + 1]), np.median(turn[-(turn.size // 20) - 1 :])])
    if abs(ends[1] - ends[0]) < 90.0:
        return lines
    lag = ends[1] > ends[0]
    if lag:
        lines.append("    conjugate: true       # guessed: the phase rises, so it is a lag")
    if quantity in _MIDWAY_DEG:
        midway = -ends.mean() if lag else ends.mean()
        shift = (_MIDWAY_DEG[quantity] - midway + 180.0) % 360.0 - 180.0
        if abs(shift) > 10.0:
            why = f"guessed: midway a {quantity.name.lower()} at the drive point has {_MIDWAY_DEG[quantity]:g} deg"
            lines.append(f"    phase_shift_deg: {shift:.1f}   # {why}")
    return lines


def _quoted(name: str) -> str:
    """A name as YAML takes it."""
    return name if re.fullmatch(r"[A-Za-z_][\w.]*", name) and name.lower() not in ("y", "n", "yes", "no", "on", "off",
                                                                                  "true", "false", "null") else (
        "'" + name.replace("'", "''") + "'"
    )  # fmt: skip


def _column(table: SourceTable, index: int) -> str:
    name = table.names[index]
    return _quoted(name) if name and table.names.count(name) == 1 else str(index + 1)


def _table_lines(table: SourceTable, frequency: int) -> list[str]:
    """A backbone or frequency responses."""
    named: dict[str, int] = {"frequency_hz": frequency}
    for member, words in _MEMBERS.items():
        for index in range(len(table.names)):
            if index not in named.values() and re.fullmatch(words, bare_name(table, index), re.I):
                named[member] = index
                break
    groups = [{"real", "imag"}, {"magnitude", "phase"}]
    if "damping_ratio" not in named:  # with one it is a backbone
        groups.append({"magnitude"})
    kept = next((group for group in groups if group <= set(named)), None)
    if kept is not None:
        kind, members = "frf", ["frequency_hz", *sorted(kept, reverse=True)]
        unit = f"{_ASK}   # of the response, such as m/s^2/N, g/N, or g/g over the acceleration of a base"
    else:
        kind, members = (
            "backbone",
            ["frequency_hz", "amplitude", *(["damping_ratio"] if "damping_ratio" in named else [])],
        )
        rest = [i for i in range(len(table.names)) if i not in named.values()]
        named.setdefault("amplitude", named.get("magnitude", rest[0] if rest else 1 - frequency))
        own = table.units[named["amplitude"]]
        unit = (
            own
            if quantity_of_unit(own) is not Quantity.UNKNOWN
            else f"{_ASK}   # of the amplitude, such as mm or m/s^2"
        )
    columns = ", ".join(f"{member}: {_column(table, named[member])}" for member in members)
    lines = ["segments:", f"  - kind: {kind}", f"    columns: {{{columns}}}", f"    unit: {unit}"]
    if "phase" in members and float(np.nanmax(np.abs(table.columns[named["phase"]]))) > 7.0:
        lines.append("    units: {phase: deg}   # guessed, because it exceeds a turn in rad")
    if "damping_ratio" in members and float(np.nanmax(table.columns[named["damping_ratio"]])) > 0.3:
        lines.append("    units: {damping_ratio: '%'}   # guessed, because it is large for a ratio")
    if kind == "backbone":
        lines.append(f"    amplitudes: {_ASK}       # peak or rms")
    lines += ["    # point: 1               # of the response", "    # drive_point: 1         # of the force"]
    if kind == "frf":
        lines += [
            "    # level: 0.5             # amplitude that was held while the frequency was stepped",
            "    # level_unit: N          # of a force, a motion or a voltage: N, g, mm, V",
        ]
        if "force_n" in named:
            lines.append(f"    # per: {_column(table, named['force_n'])}   # divide the response by this column")
    return lines


def _signal_lines(table: SourceTable, time: Sequence[int], columns: Sequence[int]) -> list[str]:
    """Channels over time."""
    lines, clock = _clock_lines(table, time, columns)
    rate = None if clock is None else clock.sample_rate
    start = 0.0 if clock is None else clock.start
    channels = [i for i in columns if i not in time][:_MOST_CHANNELS]
    guesses = {index: _guess(table, index) for index in channels}
    # Volts are the drive's or a sensor's; which, a name may say.
    kept = [i for i in channels if guesses[i].quantity != "voltage" or _is_drive(bare_name(table, i))] or channels
    if table.names[channels[0]].startswith("/"):  # messages have many fields that nobody fills
        kept = [i for i in kept if np.nanmax(table.columns[i]) > np.nanmin(table.columns[i])] or kept
    kept = [i for i in kept if not any(_same(table.columns[i], table.columns[j]) for j in kept if j < i)]
    lines.append("channels:")
    taken: set[tuple[Quantity | str, int]] = set()
    for index in channels:
        guess, values = guesses[index], table.columns[index]
        point, measured = guess.point, guess.quantity and measured_quantity(guess.quantity)
        if table.judged and not guess.quantity:
            point = 1  # whatever it measures, no other channel measures the same there
        while (measured, point) in taken:
            point += 1
        mark = "  - " if index in kept else "  # - "
        if index in kept:
            taken.add((measured, point))
        words = [
            f"column: {_column(table, index)}",
            f"quantity: {guess.quantity or _ASK}",
            f"unit: {guess.unit or _ASK}",
            *([f"scale: {_ASK}"] if looks_like_counts(values[np.isfinite(values)]) else []),
            *([f"scale: {guess.scale:.9g}"] if guess.scale != 1.0 else []),
            *([f"point: {point}"] if point else []),
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
        why = why or ("; the model's coordinate is then in rad or a strain" if coordinate_of_unit(guess.unit) else "")
        lines.append(f"{mark}{{{', '.join(words)}}}   # from {np.nanmin(values):.4g} to {np.nanmax(values):.4g}{why}")
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
    begin, until = "0", _ASK
    if rate:
        stop = start + rows / rate
        if hit:
            kind, start = "ring_down", start + hit / rate
        elif kind == "ring_down":
            stop = min(stop, start + max(_moving(values) for _, values in channels) / rate)
        begin, until = _time_text(start, rate), _time_text(stop, rate)
    why = "; what follows the hit. With the hit it is a record of force and response" if hit else ""
    return f"  - {{kind: {kind}, start: {begin}, stop: {until}}}   # guessed{why}"


def _clock_lines(table: SourceTable, time: Sequence[int], columns: Sequence[int]) -> tuple[list[str], Clock | None]:
    """Lines on the clock, and the clock as the import will find it; None where the sidecar must be completed."""
    if table.question is not None:
        sentence, key = table.question
        return [f"# {sentence}", f"{key}: {_ASK}          # {_CLOCK_ANSWERS[key]}"], None
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
        lines.append(f"time: {_column(table, time[0])}")
        unit = time_unit_of(table, time[0])
        if unit not in ("", "s"):
            values["time_unit"] = unit
            lines.append(f"time_unit: {unit}")
    try:
        clock = find_clock(table, Sidecar.model_validate(values), "this sidecar")
    except ClockQuestionError as question:
        if question.key != "sample_rate":
            lines.append(f"# {question}")
        return [*lines, f"{question.key}: {_ASK}          # {_CLOCK_ANSWERS[question.key]}"], None
    unsure = bool(time) and not own_header and not time_unit_of(table, time[0]) and table.abscissa is None
    if unsure and (not named or clock.sample_rate < _DOUBTFUL):
        told = f"# seconds would be {clock.sample_rate:.6g} Hz; s, ms, us, ns or min"
        return [*lines, f"time_unit: {_ASK}        {told}"], None
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
    if len(forces) != 1 or _kind([pair for pair in channels if pair[0] != "force"]) != "ring_down":
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
    if not unit and quantity is Quantity.UNKNOWN:
        name, unit = unit_in_name(name)
    letter = _LETTER.fullmatch(name)
    digits = re.search(r"(\d+)$", name)
    point = int(digits.group(1)) if digits and 0 < len(digits.group(1)) < 4 and name != digits.group(1) else 1
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
    if quantity is Quantity.UNKNOWN and not table.fields:
        quantity = hinted_quantity(name, point)
    if quantity is Quantity.UNKNOWN and letter and not table.fields:
        quantity = QUANTITIES[letter.group(1).lower()]
    placed = quantity not in (Quantity.UNKNOWN, Quantity.VOLTAGE, Quantity.CURRENT)
    known = "" if quantity is Quantity.UNKNOWN else quantity.name.lower()
    return _Guess(coordinate_of_unit(unit) or known, unit, point if placed else 0)


def _kind(channels: Sequence[tuple[str, FloatArray]]) -> str:
    """A decay if there are responses only and the last fifth is smaller than the first."""
    if any(quantity in ("force", "voltage", "current") for quantity, _ in channels) or not channels:
        return "record"
    fifth = max(1, channels[0][1].size // 5)
    sizes = [(np.nanstd(values[:fifth]), np.nanstd(values[-fifth:])) for _, values in channels]
    return "ring_down" if all(last < _DECAYED * first for first, last in sizes) else "record"


def no_sidecar(path: Path) -> BenchError:
    """What to say where data are given in place of a sidecar, or a sidecar is not there."""
    if path.is_file() or is_bag(path):
        what = f"{path} is a file of data; an import needs a sidecar that says what its columns are"
        return BenchError(f"{what}: './nmt import --init {path}' writes one to start from.")
    return BenchError(
        f"There is no sidecar {path}; it says what the columns of the data are: './nmt import --init FILE' writes one "
        "for a file of data."
    )
