"""A sidecar to start from, by what a file of data itself tells: columns, clock, quantities, units, kind of test."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from nmt_core.arrays import FloatArray
from nmt_core.blocks import Quantity
from nmt_core.errors import BenchError
from nmt_record import uff
from nmt_record.import_checks import hinted_quantity
from nmt_record.import_clock import bare_name, names_time
from nmt_record.import_table import SourceTable, kind_of, read_table
from nmt_record.unit_table import quantity_of_unit

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
_LETTERS = {
    "f": Quantity.FORCE, "a": Quantity.ACCELERATION, "x": Quantity.DISPLACEMENT, "v": Quantity.VELOCITY,
    "u": Quantity.VOLTAGE, "i": Quantity.CURRENT,
}  # fmt: skip
_DECAYED = 0.2  # rms of the last fifth over that of the first
_ASK = "'?'"
_MOST_CHANNELS = 64


def sidecar_template(path: Path) -> str:
    """Text of a sidecar for a file; what cannot be guessed is a question mark that the import refuses.

    Args:
        path: the data.

    Raises:
        BenchError: the file is not there, of another kind, or malformed.
    """
    head = [f"# A sidecar for {path.name}; check every line, above all what was guessed.", f"file: {path.name}"]
    head.append("# rig: my_rig.yaml        # the rig file that it is a test of, beside this file")
    if kind_of(path) == "uff" and all(f.function_type == uff.FREQUENCY_RESPONSE for f in uff.read_uff(path)):
        lines = ["segments:", f"  - {{kind: frf, unit: {_ASK}}}   # unit of the responses, such as m/s^2/N or g/N"]
        return "\n".join([*head, *lines]) + "\n"
    table = read_table(path)
    head += [f"# {note}" for note in table.notes]
    frequency = next((i for i in range(len(table.names)) if _FREQUENCY.fullmatch(bare_name(table, i) or "-")), None)
    time = [i for i in range(len(table.names)) if names_time(bare_name(table, i), table.columns[i])]
    rising = frequency is not None and bool((table.columns[frequency] >= 0.0).all())
    if frequency is not None and rising and not time and len(table.columns) > 1:
        return "\n".join([*head, *_table_lines(table, frequency)]) + "\n"
    return "\n".join([*head, *_signal_lines(table, time)]) + "\n"


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
    lines += ["    # point: 1               # of the response", "    # drive_point: 1         # of the force"]
    if kind == "frf":
        lines += [
            "    # level: 0.5             # amplitude that was held while the frequency was stepped",
            "    # level_unit: N          # of a force, a motion or a voltage: N, g, mm, V",
        ]
        if "force_n" in named:
            lines.append(f"    # per: {_column(table, named['force_n'])}   # divide the response by this column")
    return lines


def _signal_lines(table: SourceTable, time: Sequence[int]) -> list[str]:
    """Channels over time."""
    lines, rate, start = [], table.sample_rate, table.start or 0.0
    clock = table.abscissa if table.abscissa is not None else (table.columns[time[0]] if time else None)
    if time:
        lines.append(f"time: {_column(table, time[0])}")
    if clock is not None and clock.size > 1:
        step = float(np.nanmedian(np.diff(clock)))
        rate, start = (1.0 / step if step > 0.0 else None), float(clock[0])
        lines.append(f"# sample_rate: {rate:.6g}     # Hz, by the time column" if rate else "# time stands still?")
    elif table.step:
        rate = 1.0 / table.step
        lines.append(f"# sample_rate: {rate:.6g}     # Hz, by the file")
    elif rate:
        lines.append(f"# sample_rate: {rate:.6g}     # Hz, by the file")
    else:
        lines.append(f"sample_rate: {_ASK}          # Hz")
    channels = [i for i in range(len(table.columns)) if i not in time][:_MOST_CHANNELS]
    guesses = [_guess(table, index) for index in channels]
    lines.append("channels:")
    for index, (quantity, unit, point) in zip(channels, guesses, strict=True):
        values = table.columns[index]
        where = f", point: {point}" if point else ""
        lines.append(
            f"  - {{column: {_column(table, index)}, quantity: {quantity or _ASK}, unit: {unit or _ASK}{where}}}"
            f"   # from {np.nanmin(values):.4g} to {np.nanmax(values):.4g}"
        )
    stop = start + table.rows / rate if rate else 0.0
    kind = _kind([(quantity, table.columns[index]) for index, (quantity, _, _) in zip(channels, guesses, strict=True)])
    until = f"{np.nextafter(stop, 0.0):.12g}" if rate else _ASK
    lines += [
        "segments:",
        f"  - {{kind: {kind}, start: {start:.12g}, stop: {until}}}   # guessed",
        "    # kinds: phase_resonance, stepped_sine (with window: [begin, end]), random, ring_down, record",
    ]
    return lines


def _guess(table: SourceTable, index: int) -> tuple[str, str, int]:
    """Quantity, unit and point of a column; empty and 0 where nothing tells them."""
    name, unit, quantity = bare_name(table, index), table.units[index], table.quantities[index]
    letter = _LETTER.fullmatch(name)
    digits = re.search(r"(\d+)$", name)
    point = int(digits.group(1)) if digits and len(digits.group(1)) < 4 else 1
    if quantity is Quantity.UNKNOWN:
        quantity = quantity_of_unit(unit) if unit else Quantity.UNKNOWN
    if quantity is Quantity.UNKNOWN:
        quantity = hinted_quantity(name, point)
    if quantity is Quantity.UNKNOWN and letter:
        quantity = _LETTERS[letter.group(1).lower()]
    placed = quantity not in (Quantity.UNKNOWN, Quantity.VOLTAGE, Quantity.CURRENT)
    return "" if quantity is Quantity.UNKNOWN else quantity.name.lower(), unit, point if placed else 0


def _kind(channels: Sequence[tuple[str, FloatArray]]) -> str:
    """A decay if there are responses only and the last fifth is much smaller than the first."""
    if any(quantity in ("force", "voltage", "current", "") for quantity, _ in channels) or not channels:
        return "record"
    fifth = max(1, channels[0][1].size // 5)
    sizes = [(np.nanstd(values[:fifth]), np.nanstd(values[-fifth:])) for _, values in channels]
    return "ring_down" if all(last < _DECAYED * first for first, last in sizes) else "record"


def no_sidecar(path: Path) -> BenchError:
    """What to say where data are given in place of a sidecar, or a sidecar is not there."""
    if path.is_file():
        what = f"{path} is a file of data; an import needs a sidecar that says what its columns are"
        return BenchError(f"{what}: './nmt import --init {path}' writes one to start from.")
    return BenchError(
        f"There is no sidecar {path}; it says what the columns of the data are: './nmt import --init FILE' writes one "
        "for a file of data."
    )
