"""Proposals for tables that others have reduced: which columns are a backbone or frequency responses."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.vocabulary import MOTIONS
from nmt_record.exchange.arrays import uff
from nmt_record.exchange.clocks.column_clock import bare_name
from nmt_record.exchange.reduced.observables import amplitudes_by_name, percent_by_name
from nmt_record.exchange.reduced.uff_observables import stated_unit
from nmt_record.exchange.source_table import SourceTable, split_order
from nmt_record.exchange.unit_table import (
    decibels,
    inverse_unit,
    is_known_unit,
    is_quotient,
    plain_unit,
    quantity_of_unit,
    unit_in_name,
)

ASK = "'?'"

_FREQUENCY = re.compile(r"(f|fr?eq(uency)?|frequenz)([ _]?(hz|khz))?|hz|hertz", re.I)
# Also quantities of time data: they count only with responses, or with a unit of frequency.
_TURNING = re.compile(r"omega|ω|w|(circular|angular)[ _]freq(uency)?|speed|rpm|drehzahl|f.*", re.I)
FREQUENCY_UNITS = ("Hz", "kHz", "mHz", "rad/s", "rpm")
_SPEED = re.compile(r"(rotation(al)?[ _])?(speed|rpm|drehzahl|revs?)([ _]?(rpm|mean|avg))?", re.I)
_SUFFIX = r"([ _]?\(.*\))?"
# In this order: a damping ratio is not a magnitude.
_MEMBERS = {
    "damping_ratio": r"damp(ing)?([ _]?ratio)?([ _]?(percent|pct|%))?|zeta([ _]?(percent|pct|%))?|delta",
    "loss_factor": r"loss([ _]?factor)?|eta",
    "quality_factor": r"quality([ _]?factor)?|q[ _-]?factor",
    "real": rf"(\w+[ _])?re(al)?([ _]?part)?{_SUFFIX}",
    "imag": rf"(\w+[ _])?im(ag)?(inary)?([ _]?part)?{_SUFFIX}",
    "magnitude": rf"(\w+[ _])?(mag(nitude)?|abs(olute)?|modulus|ratio|gain)([ _]\w+)?{_SUFFIX}|\|.*\|",
    "phase": rf"(\w+[ _])?(pha(se)?|phi|arg(ument)?)([ _]?lag)?([ _]?(deg(rees)?|rad))?{_SUFFIX}",
    "amplitude": r"(amp(l|litude)?|disp(lacement)?|acc(eleration)?|vel(ocity)?)([ _].*)?|level|a|q",
    "force_n": r"force|load|f_?n",
}


def column_of(table: SourceTable, index: int) -> str:
    """A column as a sidecar names it: by its name, or by its number where that is not the only one of it."""
    name = table.names[index]
    return quoted(name) if name and table.names.count(name) == 1 else str(index + 1)


def quoted(name: str) -> str:
    """A name or a unit as YAML takes it."""
    plain = re.fullmatch(r"[A-Za-z_µ°][\w.]*|[A-Za-zµ°(][\w./^*²³()·-]*", name)
    word = name.lower() in ("y", "n", "yes", "no", "on", "off", "true", "false", "null")
    return name if plain and not word else "'" + name.replace("'", "''") + "'"


def uff_lines(functions: Sequence[uff.UffFunction]) -> list[str]:
    """Frequency responses of a universal file, with the unit that it states."""
    units = [stated_unit(function) for function in functions]
    turned = sorted({function.response_node for function in functions if function.direction_sign < 0})
    lines = ["segments:"]
    if not all(units):
        lines.append(f"  - {{kind: frf, unit: {ASK}}}   # unit of the responses, such as m/s^2/N or g/N")
    elif len(set(units)) == 1:
        lines.append(f"  - {{kind: frf, unit: {quoted(units[0])}}}   # by the file")
    else:
        lines.append(f"  - {{kind: frf}}   # units by the file: {', '.join(sorted(set(units)))}")
    if not all(np.iscomplexobj(function.values) for function in functions):
        lines[-1] = lines[-1].replace("}", f", ordinate: {ASK}}}", 1)
        lines.append("    # real numbers: 'ordinate: magnitude' if they are magnitudes; else export complex values")
    if turned:
        points = ", ".join(map(str, turned))
        lines.append(
            f"    # negative directions at point {points}: values are turned; 'turned: []' takes them as they are"
        )
    return lines


def frequency_columns(table: SourceTable, time: Sequence[int]) -> list[int]:
    """Columns of frequencies of a table of reduced data; none where it is one over time."""
    every = [i for i in range(len(table.names)) if i not in table.parts]
    if time or len(every) < 2:
        return []
    units = [plain_unit(table.units[i]) for i in range(len(table.names))]
    names = [bare_name(table, i) or "-" for i in range(len(table.names))]
    named = [i for i in every if _FREQUENCY.fullmatch(names[i]) and (not table.units[i] or units[i] in FREQUENCY_UNITS)]
    if not named:
        named = [i for i in every if units[i] in ("Hz", "kHz", "mHz")]
    if not named:
        responses = sum(_member_of(table, i) in ("real", "imag", "magnitude", "phase") for i in every)
        by_unit = [i for i in every if units[i] in FREQUENCY_UNITS and _TURNING.fullmatch(names[i])]
        named = by_unit[:1] if responses >= 2 else []
    if not named and any(split_order(table.names[i])[1] for i in every):
        named = [i for i in every if _SPEED.fullmatch(names[i]) or units[i] == "rpm"][:1]
    return named if named and bool((table.columns[named[0]] >= 0.0).all()) else []


def _member_of(table: SourceTable, index: int) -> str:
    name = bare_name(table, index) or "-"
    name, order = split_order(name)
    if order is not None and not name:
        name = "amplitude"
    if name == "Q":
        return "quality_factor"
    member = next((member for member, words in _MEMBERS.items() if re.fullmatch(words, name, re.I)), "")
    # A quotient is a response, whatever its name.
    return "magnitude" if member not in ("real", "imag") and is_quotient(table.units[index]) else member


def table_proposal(table: SourceTable, frequencies: Sequence[int]) -> list[str]:
    """Lines of the segments of a table of reduced data; of one of orders over a speed, a segment for each order."""
    orders = _orders(table, frequencies)
    if orders:
        lines: list[str] = []
        for number, columns in orders.items():
            others = [i for i in range(len(table.names)) if i not in columns and i not in frequencies]
            part = replace(table, parts=tuple(sorted({*table.parts, *others})))
            found = _table_lines(part, frequencies[0])
            speed = plain_unit(table.units[frequencies[0]]) == "rpm"
            keys = [] if speed else ["    units: {frequency_hz: rpm}   # guessed"]
            keys.append(f"    order: {number:g}              # by the heading: the frequency is order × speed")
            kind = f"  - kind: {ASK}   # frf of what a level held, or backbone" if "backbone" in found[1] else found[1]
            lines += [kind, found[2], *keys, *found[3:]]
        return ["segments:", *lines]
    return (
        _held_lines(table, frequencies) or _matrix_lines(table, frequencies[0]) or _table_lines(table, frequencies[0])
    )


def _orders(table: SourceTable, frequencies: Sequence[int]) -> dict[float, list[int]]:
    """Columns of each order of a rotation; one without an order belongs to the one before it. Empty without orders."""
    found: dict[float, list[int]] = {}
    present: float | None = None
    if not frequencies or plain_unit(table.units[frequencies[0]]) not in ("rpm", "1", ""):
        return {}
    if not table.units[frequencies[0]] and not _SPEED.fullmatch(bare_name(table, frequencies[0])):
        return {}
    for index, name in enumerate(table.names):
        if index in frequencies or index in table.parts:
            continue
        present = split_order(name)[1] or present
        if present is not None:
            found.setdefault(present, []).append(index)
    return found


def _matrix_lines(table: SourceTable, frequency: int) -> list[str]:
    """Responses of an array of lines × outputs × inputs, one segment each; empty where there is none."""
    lines: list[str] = []
    for name in table.names:
        found = re.fullmatch(r"(.*?)((?:\.\d+){0,2})\.real", name)
        if found is None or f"{found[1]}{found[2]}.imag" not in table.names:
            continue
        stem, numbers = found[1] + found[2], [int(n) for n in found[2].split(".") if n]
        point, drive = (*numbers, 1, 1)[:2]
        lines += [
            "  - kind: frf",
            f"    columns: {{frequency_hz: {column_of(table, frequency)}, real: {quoted(stem + '.real')}, imag: "
            f"{quoted(stem + '.imag')}}}",
            f"    unit: {ASK}   # of the response, such as m/s^2/N or g/N",
            f"    point: {point}              # guessed: lines × outputs × inputs",
            f"    drive_point: {drive}        # guessed",
        ]
    return ["segments:", *lines] if lines else []


def _held_lines(table: SourceTable, frequencies: Sequence[int]) -> list[str]:
    """Amplitudes and phases of a response at held levels, one segment each; empty where the table is another one."""
    lines: list[str] = []
    used = list(frequencies)
    for index, name in enumerate(table.names):
        if index in frequencies or index in used:
            continue
        prefix = "" if table.lines else name.rpartition(".")[0]
        group = [i for i in range(len(table.names)) if not prefix or table.names[i].startswith(prefix + ".")]
        frequency = next((i for i in frequencies if i in group), None)
        bare, quantity = bare_name(table, index), quantity_of_unit(table.units[index])
        moves = quantity in MOTIONS and not _is_phase(table, index)
        if is_quotient(table.units[index]):
            return []  # over a force already
        if frequency is None or not (moves or re.fullmatch(_MEMBERS["amplitude"], bare, re.I)):
            continue
        later = [i for i in group if i > index and i not in used]
        phase = later[0] if later and _is_phase(table, later[0]) else None
        if phase is None:
            return _ratio_lines(table, frequency, index, later)
        used += [index, phase]
        held = next((v for k, v in table.constants.items() if prefix and re.fullmatch(
            re.escape(prefix) + r"\.(force|level)", k, re.I)), None)  # fmt: skip
        columns = {"frequency_hz": frequency, "magnitude": index, "phase": phase}
        named = ", ".join(f"{member}: {column_of(table, column)}" for member, column in columns.items())
        unit = quoted(table.units[index]) if moves else f"{ASK}   # of the response, such as mm or m/s"
        level = ASK if held is None else f"{held:g}"
        rising = bool((np.diff(table.columns[frequency]) > 0.0).all())
        lines += [
            "  - kind: frf",
            f"    columns: {{{named}}}",
            f"    unit: {unit}",
            f"    level: {level}            # what was held while the frequency was stepped",
            "    level_unit: N         # guessed; of a force, a motion or a voltage: N, g, mm, V",
            f"    amplitudes: {ASK}       # of response and level: peak, rms or peak_to_peak",
            *([f"    direction: {'up' if rising else 'down'}         # by the order of the rows"]),
            *_phase_lines(table, phase, quantity),
            "    point: 1              # guessed",
            "    drive_point: 1        # guessed",
        ]
    return ["segments:", *lines] if lines else []


def _ratio_lines(table: SourceTable, frequency: int, held: int, later: Sequence[int]) -> list[str]:
    """A response with the held quantity, as a vibration controller reports them; empty for another table."""
    if len(later) != 2 or not _is_phase(table, later[1]):
        return []
    response, phase = later
    units = [plain_unit(table.units[index]) for index in (response, held)]
    if quantity_of_unit(units[0]) not in MOTIONS or not is_quotient("/".join(units)):
        return []
    kinds = [amplitudes_by_name(table.names[index]) for index in (response, held)]
    lines = [
        "segments:",
        "  - kind: frf",
        f"    columns: {{frequency_hz: {column_of(table, frequency)}, magnitude: {column_of(table, response)}, "
        f"phase: {column_of(table, phase)}}}",
        f"    unit: {quoted('/'.join(units))}   # by the headings",
        f"    per: {column_of(table, held)}   # guessed: what was held",
        *_phase_lines(table, phase, Quantity.UNKNOWN),
        "    point: 1              # guessed",
    ]
    if all(kinds):
        lines.append(f"    # by their headings the response is {kinds[0]} and what was held {kinds[1]}")
    return lines


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


def _table_lines(table: SourceTable, frequency: int) -> list[str]:
    """A backbone or frequency responses."""
    named = _members(table, frequency)
    groups = [{"real", "imag"}, {"magnitude", "phase"}]
    if not {"damping_ratio", "loss_factor", "quality_factor"} & set(named):  # with one it is a backbone
        groups.append({"magnitude"})
    kept = next((group for group in groups if group <= set(named)), None)
    lines = _response_lines(table, named, kept) if kept is not None else _backbone_lines(table, named)
    lines += ["    # point: 1               # of the response", "    # drive_point: 1         # of the force"]
    if kept is not None:
        lines += [
            "    # level: 0.5             # amplitude that was held while the frequency was stepped",
            "    # level_unit: N          # of a force, a motion or a voltage: N, g, mm, V",
        ]
        if "force_n" in named:
            lines.append(f"    # per: {column_of(table, named['force_n'])}   # divide the response by this column")
    return lines


def _members(table: SourceTable, frequency: int) -> dict[str, int]:
    """The first column of each member of a table."""
    named: dict[str, int] = {"frequency_hz": frequency}
    every = [i for i in range(len(table.names)) if i != frequency and i not in table.parts]
    for index in every:
        if (member := _member_of(table, index)) and member not in named:
            named[member] = index
    amplitude = named.get("amplitude")
    if amplitude is not None and "magnitude" not in named and "phase" in named:
        unit = table.units[amplitude]
        if is_quotient(unit) or decibels(unit) is not None:
            named["magnitude"] = named.pop("amplitude")
    return named


def _columns_line(table: SourceTable, named: dict[str, int], members: Sequence[str]) -> str:
    columns = ", ".join(
        f"{member}: {column_of(table, named[member]) if member in named else ASK}" for member in members
    )
    return f"    columns: {{{columns}}}"


def _response_lines(table: SourceTable, named: dict[str, int], kept: set[str]) -> list[str]:
    members = ["frequency_hz", *sorted(kept, reverse=True)]
    size = named["real" if "real" in kept else "magnitude"]
    reference = decibels(table.units[size])
    unit = table.units[size] if reference is None else reference
    in_db = reference is not None or re.search(r"[ _]db$", table.names[size], re.I) is not None
    asked = "that 0 dB refer to" if in_db else "of the response"
    if is_quotient(unit):
        unit_line = f"    unit: {quoted(unit)}   # by the heading"
    elif inverse_unit(unit):
        unit_line = f"    unit: {quoted(unit)}   # by the heading: force per motion, whose reciprocal is taken"
    else:
        unit_line = f"    unit: {ASK}   # {asked}, such as m/s^2/N, g/N, or g/g over the acceleration of a base"
    lines = ["segments:", "  - kind: frf", _columns_line(table, named, members), unit_line]
    unstated = "phase" in members and not is_known_unit(table.units[named["phase"]])
    if unstated and float(np.nanmax(np.abs(table.columns[named["phase"]]))) > 7.0:
        lines.append("    units: {phase: deg}   # guessed, because it exceeds a turn in rad")
    if "phase" in members and re.search(r"lag", table.names[named["phase"]], re.I):
        lines.append("    conjugate: true       # guessed: its name says that the phase is a lag")
    return lines


def _backbone_lines(table: SourceTable, named: dict[str, int]) -> list[str]:
    dampings = [member for member in ("damping_ratio", "loss_factor", "quality_factor") if member in named][:1]
    if "amplitude" not in named and "magnitude" in named:
        named["amplitude"] = named["magnitude"]
    unit = kind = ""
    if "amplitude" in named:
        index = named["amplitude"]
        unit = table.units[index] or unit_in_name(bare_name(table, index))[1]
        kind = amplitudes_by_name(table.names[index])
    moves = quantity_of_unit(unit) in MOTIONS
    lines = [
        "segments:",
        "  - kind: backbone",
        _columns_line(table, named, ["frequency_hz", "amplitude", *dampings]),
        f"    unit: {quoted(unit) if moves else f'{ASK}   # of the amplitude, such as mm or m/s^2'}",
    ]
    for damping in dampings:
        large = float(np.nanmax(table.columns[named[damping]])) > 0.3 and not percent_by_name(
            table.names[named[damping]]
        )
        if damping == "damping_ratio" and large and plain_unit(table.units[named[damping]]) != "%":
            lines.append("    units: {damping_ratio: '%'}   # guessed, because it is large for a ratio")
    lines.append(f"    amplitudes: {kind or ASK}       # peak, rms or peak_to_peak" + ("; by its name" if kind else ""))
    return lines
