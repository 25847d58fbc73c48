"""Tables that others have reduced: backbones and frequency responses, on their way into a bag and out of it."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmt_core.errors import BenchError
from nmt_core.files.hardened import json_value
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_record.bag.bag_reader import Bag
from nmt_record.exchange.import_table import kind_of, read_table
from nmt_record.exchange.reduced.uff_observables import (
    frequency_responses,
    of_one_axis,
    response_values,
    stated_unit,
)
from nmt_record.exchange.sidecar.import_sidecar import TableKind, TableSection
from nmt_record.exchange.source_table import SourceTable, split_name, split_order
from nmt_record.exchange.unit_table import (
    REFERENCE_UNITS,
    decibels,
    factor_to_si,
    inverse_unit,
    other_factor,
    plain_unit,
    quantity_of_unit,
    response_over_reference,
    response_unit,
    si_unit_of,
    unit_size,
)

OBSERVABLES_TOPIC = "observables"
OBSERVABLES_TYPE = "std_msgs/msg/String"
FORMAT = "nmt observable table 1"
_STORED = (
    "kind", "name", "source", "quantity", "level", "level_unit", "point", "drive_point", "reference", "held",
    "direction", "noise", "units",
)  # fmt: skip

_REQUIRED: dict[str, tuple[str, ...]] = {
    TableKind.BACKBONE: ("frequency_hz", "amplitude"),
    TableKind.FRF: ("frequency_hz",),
}
_OPTIONAL: dict[str, tuple[str, ...]] = {
    TableKind.BACKBONE: ("damping_ratio", "loss_factor", "quality_factor", "level", "force_n", "phase"),
    TableKind.FRF: ("real", "imag", "magnitude", "phase", "level", "force_n", "coherence"),
}
_PEAKED = 3.0  # largest value over the usual one
_RESPONSES = ("real", "imag", "magnitude", "real_std", "imag_std", "magnitude_std")
_KINDS = {
    "frequency_hz": "frequency",
    "damping_ratio": "ratio",
    "loss_factor": "ratio",
    "phase": "phase",
    "coherence": "ratio",
}


@dataclass(frozen=True, eq=False)
class ObservableTable:
    """One table in SI units.

    Attributes:
        kind: what it is.
        columns: name -> values, all of one length. Backbone: frequency_hz, amplitude, and as far as given
            damping_ratio, level, force_n, phase; frf: frequency_hz, real, imag (magnitude alone with an unknown
            phase), and as far as given level, force_n (N, measured at each line), coherence.
            ``<name>_std`` is a standard uncertainty.
        units: name -> unit, SI (Hz for frequencies).
        quantity: of the response; UNKNOWN for a modal amplitude.
        level: of the whole table; NaN if not given.
        level_unit: its unit.
        point: point of the response; 0 = not given.
        drive_point: point of the force; 0 = not given.
        name: what it was called.
        source: file it came from.
        reference: what frequency responses are divided by: ``force``, ``base`` (acceleration of a shaking table) or
            ``voltage``.
        held: what had the level's amplitude while the frequency was stepped: one of these or ``response``; empty = by
            the unit of the level.
        direction: ``up`` or ``down``, the way the frequency was stepped; empty = not known.
        noise: relative standard uncertainty of every line; NaN if not given.
        dataset: number in a universal file; 0 = of none.
    """

    kind: TableKind
    columns: dict[str, FloatArray]
    units: dict[str, str]
    quantity: Quantity = Quantity.UNKNOWN
    level: float = math.nan
    level_unit: str = ""
    point: int = 0
    drive_point: int = 0
    name: str = ""
    source: str = ""
    notes: tuple[str, ...] = field(default=())
    reference: str = "force"
    held: str = ""
    direction: str = ""
    noise: float = math.nan
    dataset: int = 0

    @property
    def rows(self) -> int:
        """Number of rows."""
        return int(self.columns["frequency_hz"].shape[0])

    @property
    def turns(self) -> bool:
        """Whether the response is an angle or a derivative of one."""
        return any(unit.startswith("rad") for name, unit in self.units.items() if name in (*_RESPONSES, "amplitude"))

    def column(self, name: str) -> FloatArray:
        """Values of a column, (rows,); NaN where there is none."""
        return self.columns.get(name, np.full(self.rows, math.nan))

    @property
    def phase_known(self) -> bool:
        """Whether the frequency responses have a phase."""
        return "real" in self.columns

    @property
    def responses(self) -> NDArray[np.complex128]:
        """Frequency responses, shape (rows,); magnitudes where the phase is not known."""
        if not self.phase_known:
            return self.columns["magnitude"].astype(np.complex128)
        return np.asarray(self.columns["real"] + 1j * self.columns["imag"], dtype=np.complex128)

    def to_json(self) -> str:
        """As it is stored in a bag; NaN becomes null."""
        values: dict[str, Any] = {"format": FORMAT, **{name: getattr(self, name) for name in _STORED}}
        values["quantity"] = self.quantity.name.lower()
        values |= {name: None for name in ("level", "noise") if math.isnan(values[name])}
        values["columns"] = {
            key: [float(value) if math.isfinite(value) else None for value in column]
            for key, column in self.columns.items()
        }
        return json.dumps(values)

    @classmethod
    def from_json(cls, text: str) -> ObservableTable:
        """The inverse of :meth:`to_json`.

        Raises:
            BenchError: not such a text.
        """
        try:
            values: Mapping[str, Any] = json_value(text, "An observable table", bounded=False)
            if values["format"] != FORMAT:
                raise ValueError(f"format {values['format']}")
            columns = {key: np.array(list(column), dtype=np.float64) for key, column in values["columns"].items()}
            level, noise = (math.nan if v is None else float(v) for v in (values["level"], values.get("noise")))
            return cls(
                TableKind(values["kind"]), columns, dict(values["units"]), Quantity[values["quantity"].upper()], level,
                values["level_unit"], int(values["point"]), int(values["drive_point"]), values["name"],
                values["source"], reference=values.get("reference", "force"), held=values.get("held", ""),
                direction=values.get("direction", ""), noise=noise,
            )  # fmt: skip
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
            raise BenchError(
                f"A table on topic '{OBSERVABLES_TOPIC}' is not of the form '{FORMAT}': {error}."
            ) from error


def observable_tables(bag: Bag) -> list[ObservableTable]:
    """Tables of others in an imported bag, in the order of its sidecar; empty for recordings.

    Raises:
        BenchError: the bag is damaged or a table in it is malformed.
    """
    return [ObservableTable.from_json(message.data) for _, _, message in bag.messages([OBSERVABLES_TOPIC])]


def read_observables(section: TableSection, path: Path, place: str) -> list[ObservableTable]:
    """Read the table that a sidecar's segment names; a UFF file gives one for each frequency response in it.

    Args:
        section: what the columns are.
        path: the file.
        place: of the segment in the sidecar, for messages.

    Raises:
        BenchError: the file or a column is missing, malformed, without unit or implausible.
    """
    if section.kind == TableKind.BACKBONE and (section.per is not None or section.conjugate):
        raise BenchError(f"{place}: 'per' and 'conjugate' belong to a table of kind frf; take them out.")
    if section.scale == 0.0:
        raise BenchError(f"{place}: the scale is zero; give the factor or leave it out.")
    if kind_of(path) == "uff":
        return _from_uff(section, path, place)
    table = read_table(path, [*section.columns.values(), *([] if section.per is None else [section.per])])
    columns = _columns(section, table, place)
    units = {name: "Hz" if name.startswith("frequency") else "1" for name in columns}
    quantity, reference = Quantity.UNKNOWN, "force"
    notes = list(table.notes)
    _check_amplitudes(section, table, place)
    if section.kind == TableKind.BACKBONE:
        columns = _with_damping_ratio(columns)
        quantity, factor, unit = _amplitude_unit(section, table, place)
        factor *= _peak(section)
        for name in ("amplitude", "amplitude_std"):
            if name in columns:
                columns[name], units[name] = columns[name] * factor * abs(section.scale), unit
    else:
        columns = _linear(section, columns, table, place, notes)
        unit = _stated_unit(section, table, place, "real", "magnitude")
        inverse = inverse_unit(unit)
        unit = inverse or unit
        if section.per is not None and quantity_of_unit(unit) is not Quantity.UNKNOWN:
            unit = f"{unit}/N"
        held = 1.0
        if quantity_of_unit(unit) is not Quantity.UNKNOWN:
            if section.level is None or not section.level > 0.0 or not section.level_unit:
                raise BenchError(
                    f"{place}: {unit} is a response, not a response per force; give the level and level_unit that were "
                    "held, or the unit of the quotient, such as m/s^2/N."
                )
            held, unit = section.level, f"{unit}/{section.level_unit}"
        quantity, factor, reference = response_over_reference(unit, place)
        factor *= section.scale / held
        columns = _complex(section, columns, table, place)
        if inverse:
            columns = _reciprocal(columns, table, place)
            notes.append(
                f"{table.file} holds forces per motion; the reciprocal was taken, which is the response to one force "
                "where no other one acts."
            )
        if section.per is not None:
            columns = _divided(section, columns, table, reference, unit, place)
        if section.conjugate:
            if "imag" not in columns:
                raise BenchError(f"{place}: a magnitude without phase has no conjugate; take 'conjugate' out.")
            columns["imag"] = -columns["imag"]
        if section.phase_shift_deg and "imag" in columns:
            turned = (columns["real"] + 1j * columns["imag"]) * np.exp(1j * math.radians(section.phase_shift_deg))
            columns["real"], columns["imag"] = turned.real, turned.imag
        if "magnitude" in columns:
            factor = abs(factor)
            notes.append(f"{place}: {table.file} has no phase; magnitudes alone are compared.")
        unit = si_unit_of(unit) or f"{quantity.unit}/{REFERENCE_UNITS[reference]}"
        for name in _RESPONSES:
            if name in columns:
                own = abs(factor) if name.endswith("_std") else factor
                columns[name], units[name] = columns[name] * own, unit
    units = {name: units.get(name, "1") for name in columns}
    level, level_factor, level_unit = _level(section, place)
    if "level" in columns:
        columns["level"], units["level"] = columns["level"] * level_factor, level_unit or "1"
    if "phase" in units:
        units["phase"] = "rad"
    if "force_n" in units:
        units["force_n"] = "N"
    _plausible(columns, table, place)
    if section.kind == TableKind.FRF:
        columns = _without_still_line(_without_mirror(columns, table.file, notes), table.file, notes)
    return [
        _table(
            section, columns, units, quantity, path.name, tuple(notes), level=level, level_unit=level_unit,
            reference=reference,
        )
    ]  # fmt: skip


def _reciprocal(columns: dict[str, FloatArray], table: SourceTable, place: str) -> dict[str, FloatArray]:
    """Responses of which the file has one over each; an uncertainty stays the same share."""
    given = columns["magnitude"] if "magnitude" in columns else columns["real"] + 1j * columns["imag"]
    size = np.abs(given)
    if not (size > 0.0).all():
        raise BenchError(f"{place}: a force per motion is zero at {table.place(int(np.argmin(size)))}; leave it out.")
    result = {name: values / size**2 if name in _RESPONSES else values for name, values in columns.items()}
    if "imag" in result:
        result["imag"] = -result["imag"]
    return result


def _divided(
    section: TableSection, columns: dict[str, FloatArray], table: SourceTable, reference: str, unit: str, place: str
) -> dict[str, FloatArray]:
    """Response columns over the one that ``per`` names; a force is kept, in N."""
    assert section.per is not None
    divisor = table.columns[table.index(section.per, f"{place}: per")]
    good = np.isfinite(divisor) & (divisor > 0.0)
    if not good.all():
        row = int(np.argmin(good))
        raise BenchError(
            f"{place}: column {section.per} is {divisor[row]:g} at {table.place(row)}; an amplitude that responses are "
            "divided by is positive."
        )
    # Each column may hold another kind of amplitude by its heading.
    kinds = [
        amplitudes_by_name(table.names[table.index(column, place)])
        for column in (section.columns.get("magnitude", "magnitude"), section.per)
        if column != "magnitude" or "magnitude" in table.names
    ]
    factor = _PEAK[kinds[0]] / _PEAK[kinds[1]] if len(kinds) == 2 and all(kinds) else 1.0
    result = {name: factor * values / divisor if name in _RESPONSES else values for name, values in columns.items()}
    if reference == "force" and "force_n" not in result:
        below = plain_unit(unit).rpartition("/")[2]
        result["force_n"] = divisor * factor_to_si(Quantity.FORCE, below, f"{place}: per")
    return result


_PEAK = {"peak": 1.0, "rms": math.sqrt(2.0), "peak_to_peak": 0.5}


def _peak(section: TableSection) -> float:
    """Peak over what the file gives as amplitude."""
    return _PEAK[section.amplitudes]


def _level(section: TableSection, place: str) -> tuple[float, float, str]:
    """Level of the whole table in SI units (NaN if not given), factor of a column of levels, and the SI unit."""
    factor, unit = 1.0, ""
    if section.level_unit:
        quantity = quantity_of_unit(section.level_unit)
        if quantity is Quantity.UNKNOWN or quantity is Quantity.CURRENT:
            raise BenchError(
                f"{place}: the unit of the level, '{section.level_unit}', is not known; use one of a force, a motion "
                "or a voltage, such as N, g, m/s^2, mm or V."
            )
        factor, unit = factor_to_si(quantity, section.level_unit, f"{place}: level"), si_unit_of(section.level_unit)
    factor *= _peak(section)
    return math.nan if section.level is None else section.level * factor, factor, unit


def _table(
    section: TableSection,
    columns: dict[str, FloatArray],
    units: dict[str, str],
    quantity: Quantity,
    source: str,
    notes: tuple[str, ...] = (),
    **values: Any,
) -> ObservableTable:
    values = {"point": section.point, "drive_point": section.drive_point, "name": section.name, **values}
    noise = math.nan if section.noise is None else 0.01 * section.noise
    return ObservableTable(
        TableKind(section.kind), columns, units, quantity, source=source, notes=notes, held=section.held or "",
        direction=section.direction or "", noise=noise, **values,
    )  # fmt: skip


# Columns that say their unit in their name.
_SPEED = re.compile(r"(rot(ation(al)?)?[ _.]?)?(speed|drehzahl|rpm|revs?)([ _.].*)?|n|turns", re.I)
_WITH_UNIT = {"phase": ("phase_deg", "deg"), "phase_std": ("phase_deg_std", "deg")}


def _known(kind: str) -> list[str]:
    names = [*_REQUIRED[kind], *_OPTIONAL[kind]]
    return [*names, *(f"{name}_std" for name in names)]


def _columns(section: TableSection, table: SourceTable, place: str) -> dict[str, FloatArray]:
    known = _known(section.kind)
    for group, what in ((section.columns, "columns"), (section.units, "units")):
        wrong = [name for name in group if name not in known]
        if wrong:
            raise BenchError(
                f"{place}: {what} names '{wrong[0]}', which a {section.kind} does not have; it has {', '.join(known)}."
            )
    found: dict[str, FloatArray] = {}
    names = [split_name(name)[0] for name in table.names]
    for name in known:
        unit_of_name = ""
        if name in section.columns:
            index = table.index(section.columns[name], f"{place}: {name}")
        elif name in names:
            index = table.index(name, place)
        elif name in _WITH_UNIT and _WITH_UNIT[name][0] in names:
            index = names.index(_WITH_UNIT[name][0])
            unit_of_name = _WITH_UNIT[name][1]
        elif name in _REQUIRED[section.kind]:
            has = ", ".join(filter(None, table.names)) or "no names"
            raise BenchError(
                f"{place}: {table.file} has no column {name} (it has {has}); name it under 'columns: {{{name}: …}}'."
            )
        else:
            continue
        base = name.removesuffix("_std")
        if _KINDS.get(base) == "ratio" and percent_by_name(table.names[index]):
            unit_of_name = "%"
        values = table.columns[index]
        if base in _KINDS:
            default = {"frequency": "Hz", "ratio": "1", "phase": "rad"}[_KINDS[base]]
            own = plain_unit(table.units[index] or unit_of_name) if table.units[index] or unit_of_name else ""
            given = section.units.get(name, section.units.get(base, ""))
            if given and own and plain_unit(given) != own:
                raise BenchError(
                    f"{place}: {name} has the unit {own} by {table.file}, but {given} by the sidecar; correct one."
                )
            unit = given or own or default
            values = values * other_factor(_KINDS[base], unit, f"{place}: {name}")
            if _KINDS[base] == "frequency":
                values = values * _order(section, table, index, plain_unit(unit), place)
        found[name] = values
    return found


def _order(section: TableSection, table: SourceTable, frequency: int, unit: str, place: str) -> float:
    """Periods of the response in a turn, of a table over a speed of rotation.

    Raises:
        BenchError: a heading names an order, and the sidecar another one or none.
    """
    chosen = [table.index(column, place) for column in section.columns.values()]
    headings = [table.names[i] for i in chosen or range(len(table.names)) if i != frequency]
    named = {number: name for name in headings if (number := split_order(name)[1]) is not None}
    turns = unit == "rpm" or bool(_SPEED.fullmatch(split_name(table.names[frequency])[0].strip()))
    if section.order is None and turns and set(named) - {1.0}:
        number, name = next(item for item in named.items() if item[0] != 1.0)
        raise BenchError(
            f"{place}: column {name} of {table.file} is order {number:g} of a rotation, so that its frequency is "
            f"{number:g} times the speed; say 'order: {number:g}', or 'order: 1' if the column "
            f"{table.names[frequency]} is the frequency of the response already."
        )
    if section.order is not None and section.order != 1.0 and len(named) == 1 and section.order not in named:
        raise BenchError(
            f"{place}: column {next(iter(named.values()))} of {table.file} is order {next(iter(named)):g} by its "
            f"heading, but {section.order:g} by the sidecar; correct one."
        )
    return section.order or 1.0


def _check_amplitudes(section: TableSection, table: SourceTable, place: str) -> None:
    """Names such as disp_pp or acc_rms tell what kind of amplitude a column holds.

    Raises:
        BenchError: one does, and the sidecar says nothing.
    """
    member = "amplitude" if section.kind == TableKind.BACKBONE else "magnitude"
    if "amplitudes" in section.model_fields_set or section.columns.get(member) is None:
        return
    name = table.names[table.index(section.columns[member], place)]
    hinted = amplitudes_by_name(name)
    if section.per is not None and hinted and amplitudes_by_name(table.names[table.index(section.per, place)]):
        return  # of both by their headings
    if hinted not in ("", "peak"):
        raise BenchError(
            f"{place}: column {name} of {table.file} is called {hinted.replace('_', ' ')}; say 'amplitudes: {hinted}', "
            "or 'amplitudes: peak' if the name misleads."
        )


def amplitudes_by_name(name: str) -> str:
    """``peak_to_peak``, ``rms`` or ``peak`` as far as a column's name tells; else empty."""
    words = re.split(r"[\s_\-/\[\](){},.]+", name.lower())
    joined = " ".join(words)
    if re.search(r"\b(pp|p2p|pkpk|pk pk|p p|peak to peak|peak2peak|pp?k to pp?k)\b", joined):
        return "peak_to_peak"
    if "rms" in words or "eff" in words:
        return "rms"
    return "peak" if {"peak", "pk", "0pk", "0p"} & set(words) else ""


def percent_by_name(name: str) -> bool:
    """Whether a column's name ends as zeta_percent does."""
    return re.search(r"[ _]?(percent|pct|%)$", name.strip(), re.I) is not None


def _with_damping_ratio(columns: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Loss factor (2 ζ) or quality factor (1/(2 ζ)) as damping ratio."""
    result = {name: v for name, v in columns.items() if name.split("_std")[0] not in ("loss_factor", "quality_factor")}
    if "damping_ratio" in columns:
        return result
    if "loss_factor" in columns:
        result["damping_ratio"] = 0.5 * columns["loss_factor"]
        if "loss_factor_std" in columns:
            result["damping_ratio_std"] = 0.5 * columns["loss_factor_std"]
    elif "quality_factor" in columns:
        with np.errstate(divide="ignore"):
            result["damping_ratio"] = 0.5 / columns["quality_factor"]
        if "quality_factor_std" in columns:
            relative = columns["quality_factor_std"] / columns["quality_factor"]
            result["damping_ratio_std"] = result["damping_ratio"] * relative
    return result


def _linear(
    section: TableSection, columns: dict[str, FloatArray], table: SourceTable, place: str, notes: list[str]
) -> dict[str, FloatArray]:
    """Columns whose magnitudes are no dB any more."""
    if "magnitude" not in columns:
        return columns
    heading = decibels(_heading(table, section, "magnitude"))
    stated = section.units.get("magnitude", "")
    if stated and (decibels(stated) is None) != (heading is None) and heading is not None:
        notes.append(f"{place}: {table.file} has magnitudes in dB by its heading; the sidecar says {stated}.")
    if (decibels(stated) if stated else heading) is None:
        return columns
    result = {**columns, "magnitude": 10.0 ** (columns["magnitude"] / 20.0)}
    if "magnitude_std" in columns:
        result["magnitude_std"] = result["magnitude"] * columns["magnitude_std"] * math.log(10.0) / 20.0
    notes.append(f"Magnitudes of {table.file} are in dB (20 log of the amplitude); they were read so.")
    return result


def _heading(table: SourceTable, section: TableSection, member: str) -> str:
    """Unit of a column by its heading or the end of its name."""
    column = section.columns.get(member, member)
    index = column - 1 if isinstance(column, int) else next(
        (i for i, name in enumerate(table.names) if column in (name, split_name(name)[0])), None
    )  # fmt: skip
    if index is None or not 0 <= index < len(table.names):
        return ""
    name = table.names[index]
    return table.units[index] or ("dB" if re.search(r"[ _]db$", name, re.I) else "")


def _stated_unit(section: TableSection, table: SourceTable, place: str, *members: str) -> str:
    """Unit by the sidecar, else by the heading of one of the columns.

    Raises:
        BenchError: both say one, and they differ.
    """
    stated = ""
    for member in members:
        heading = _heading(table, section, member)
        reference = decibels(heading)
        stated = stated or (heading if reference is None else reference)
    if not section.unit:
        return stated
    if inverse_unit(stated) and not inverse_unit(section.unit) and "scale" not in section.model_fields_set:
        raise BenchError(
            f"{place}: by its heading {table.file} has {stated}, a force per motion, not {section.unit}; say "
            f"'unit: {plain_unit(stated)}' (the reciprocal is then taken), or 'scale: 1' if the heading is wrong."
        )
    theirs, sidecar = unit_size(stated), unit_size(section.unit)
    alone = sidecar is not None and theirs is not None and sidecar[2:] != theirs[2:] and section.per is not None
    if theirs is None or sidecar is None or alone or "scale" in section.model_fields_set:
        return section.unit
    if sidecar[0] is not theirs[0] or sidecar[2] != theirs[2] or not math.isclose(sidecar[1], theirs[1], rel_tol=1e-9):
        raise BenchError(
            f"{place}: the responses of {table.file} are in {stated} by its heading, in {section.unit} by the sidecar; "
            "correct one of them, or state 'scale: 1' if the heading is wrong."
        )
    return section.unit


def _own_unit(table: SourceTable, section: TableSection, *names: str) -> str:
    for name in names:
        for index, column in enumerate(table.names):
            if split_name(column)[0] == section.columns.get(name, name) and table.units[index]:
                return table.units[index]
    return ""


def _amplitude_unit(section: TableSection, table: SourceTable, place: str) -> tuple[Quantity, float, str]:
    text = _stated_unit(section, table, place, "amplitude")
    if "kg" in plain_unit(text):
        return Quantity.UNKNOWN, other_factor("modal amplitude", text, place), "m*sqrt(kg)"
    quantity, factor = response_unit(text, place)
    return quantity, factor, si_unit_of(text)


def _complex(
    section: TableSection, columns: dict[str, FloatArray], table: SourceTable, place: str
) -> dict[str, FloatArray]:
    """Real and imaginary part from what the table has; the magnitude alone where that is all."""
    plain = {"real", "imag"} <= set(columns)
    polar = "magnitude" in columns and ("phase" in columns or not plain)
    if polar == plain:
        what = "both real and imag and magnitude and phase" if polar else "neither real and imag nor magnitude"
        has = ", ".join(filter(None, table.names)) or "no names"
        raise BenchError(
            f"{place}: {table.file} has {what} (its columns are {has}); one of the two is needed, magnitude with phase "
            "as far as that is known; name columns that are called otherwise, columns: {magnitude: …}."
        )
    # A response that peaks is nowhere real on both sides of its resonance.
    real = columns["real"] if plain and not columns["imag"].any() else np.zeros(0)
    if real.size and (real >= 0.0).all() and real.max() > _PEAKED * np.median(real):
        raise BenchError(
            f"{place}: the imaginary part is zero throughout and the real part never negative: magnitudes without a "
            "phase? Then say columns: {magnitude: …} instead of real and imag."
        )
    if plain:
        return {name: values for name, values in columns.items() if not name.startswith("magnitude")}
    if (columns["magnitude"] < 0.0).any():
        row = int(np.argmax(columns["magnitude"] < 0.0))
        raise BenchError(
            f"{place}: the magnitude is negative at {table.place(row)}; if it is in dB, say units: {{magnitude: dB}}."
        )
    if "phase" not in columns:
        return columns
    named = "phase" not in section.columns and "phase" not in (split_name(name)[0] for name in table.names)
    unstated = not named and "phase" not in section.units and not _own_unit(table, section, "phase")
    if unstated and np.nanmax(np.abs(columns["phase"])) > 7.0:
        raise BenchError(
            f"{place}: the phase reaches {np.nanmax(np.abs(columns['phase'])):.4g}, more than a turn in rad; say "
            "units: {phase: deg} or {phase: rad}."
        )
    response = columns["magnitude"] * np.exp(1j * columns["phase"])
    result = {name: values for name, values in columns.items() if name.split("_std")[0] not in ("magnitude", "phase")}
    result["real"], result["imag"] = response.real, response.imag
    if "magnitude_std" in columns:
        # Standard uncertainty of a circular scatter of that size.
        result["real_std"] = result["imag_std"] = columns["magnitude_std"]
    return result


def _without_still_line(columns: dict[str, FloatArray], file: str, notes: list[str]) -> dict[str, FloatArray]:
    """Columns without lines at 0 Hz, which hold offsets of sensors and no vibration."""
    moving = columns["frequency_hz"] > 0.0
    if moving.all():
        return columns
    notes.append(f"The line at 0 Hz of {file} is not vibration (offsets of sensors); it was left out.")
    return {name: np.ascontiguousarray(values[moving]) for name, values in columns.items()}


def _without_mirror(columns: dict[str, FloatArray], file: str, notes: list[str]) -> dict[str, FloatArray]:
    """Columns without the upper half of a whole transform, which mirrors the lower one and was not measured."""
    frequency = columns["frequency_hz"]
    response = columns["real"] + 1j * columns["imag"] if "real" in columns else columns["magnitude"]
    steps = np.diff(frequency)
    if frequency.size < 16 or not (steps > 0.0).all() or float(np.ptp(steps)) > 1e-3 * float(steps.mean()):
        return columns
    first = 1 if frequency[0] < 0.5 * steps[0] else 0
    lines = response[first:]
    size = float(np.abs(lines).max())
    if (
        not size > 0.0
        or np.abs(lines - lines[::-1].conj()).max() > 1e-6 * size
        or float(np.ptp(np.abs(lines))) < 1e-6 * size
    ):
        return columns
    kept = np.arange(frequency.size) < first + (lines.size + 1) // 2
    notes.append(
        f"The responses of {file} above {frequency[kept][-1]:.6g} Hz mirror those below, as the upper half of a whole "
        "transform does; they were left out."
    )
    return {name: np.ascontiguousarray(values[kept]) for name, values in columns.items()}


def _plausible(columns: dict[str, FloatArray], table: SourceTable, place: str) -> None:
    if not columns["frequency_hz"].size:
        raise BenchError(f"{place}: {table.file} has no rows.")
    for name, values in columns.items():
        bad = ~np.isfinite(values)
        if name in ("frequency_hz", "amplitude", "real", "imag", "magnitude") and bad.any():
            raise BenchError(f"{place}: {name} is missing at {table.place(int(np.argmax(bad)))}; leave such rows out.")
        if name.endswith("_std") and (values < 0.0).any():
            raise BenchError(f"{place}: {name} is negative at {table.place(int(np.argmax(values < 0.0)))}.")
    if (columns["frequency_hz"] < 0.0).any() or not (columns["frequency_hz"] > 0.0).any():
        raise BenchError(f"{place}: frequency_hz must be positive, got {columns['frequency_hz'].min():g}.")
    if "amplitude" in columns and not (columns["amplitude"] > 0.0).all():
        row = int(np.argmin(columns["amplitude"] > 0.0))
        raise BenchError(f"{place}: the amplitude is not positive at {table.place(row)}.")
    damping = columns.get("damping_ratio")
    if damping is not None and (np.nanmax(damping) > 1.0 or np.nanmin(damping) < -1.0):
        raise BenchError(
            f"{place}: damping_ratio reaches {np.nanmax(damping):.3g}; if it is in percent say units: "
            f"{{damping_ratio: '%'}}."
        )


def _from_uff(section: TableSection, path: Path, place: str) -> list[ObservableTable]:
    if section.kind != TableKind.FRF:
        raise BenchError(f"{place}: {path.name} is a universal file; only 'kind: frf' is read from those.")
    functions = frequency_responses(path)
    if not functions:
        raise BenchError(f"{place}: {path.name} has no frequency response (function type 4).")
    tables = []
    level, _, level_unit = _level(section, place)
    for function in of_one_axis(functions, section.axis, f"{place}: {path.name}"):
        notes: list[str] = []
        where = f"{place}: dataset {function.number} of {path.name}"
        quantity, frequency, values = response_values(section, function, where, notes)
        columns = {"frequency_hz": frequency, "real": values.real, "imag": values.imag}
        if not np.iscomplexobj(function.values):
            if section.ordinate is None:
                raise BenchError(
                    f"{where} is a frequency response of real numbers: magnitudes without a phase? Then say 'ordinate: "
                    "magnitude'; else export complex values."
                )
            columns = {"frequency_hz": frequency, "magnitude": np.abs(values)}
        if (frequency > 0.0).any():
            columns = _without_still_line(columns, path.name, notes)
        unit = si_unit_of(section.unit or stated_unit(function))
        units = {name: "Hz" if name == "frequency_hz" else unit for name in columns}
        table = _table(
            section, columns, units, quantity, path.name, tuple(notes), point=function.response_node,
            drive_point=function.reference_node, name=function.name or section.name, level=level, level_unit=level_unit,
            dataset=function.number,
        )  # fmt: skip
        tables.append(table)
    return tables
