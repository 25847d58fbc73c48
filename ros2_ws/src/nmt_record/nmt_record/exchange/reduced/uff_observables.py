"""Frequency responses of universal files, by what each dataset says of its axes, units and directions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.vocabulary import MOTIONS
from nmt_record.exchange.arrays import uff
from nmt_record.exchange.sidecar.import_sidecar import TableSection
from nmt_record.exchange.unit_table import (
    is_quotient,
    other_factor,
    plain_unit,
    quantity_of_unit,
    response_over_reference,
    unit_size,
)

_AXES = ("x", "y", "z", "rx", "ry", "rz")
_FORCES = (0, uff.GENERAL, uff.FORCE, 9)


def stated_unit(function: uff.UffFunction) -> str:
    """Unit of a frequency response by the axes of its dataset; empty where they do not tell it."""
    above, below = function.ordinate_axis.unit, function.denominator_axis.unit
    if is_quotient(above):
        return above.strip()
    if quantity_of_unit(above) in MOTIONS and quantity_of_unit(below) is Quantity.FORCE:
        upper = plain_unit(above)
        return f"({upper})/{plain_unit(below)}" if "/" in upper else f"{upper}/{plain_unit(below)}"
    return ""


def frequency_responses(path: Path) -> list[uff.UffFunction]:
    """The datasets of function type 4."""
    return [function for function in uff.read_uff(path) if function.function_type == uff.FREQUENCY_RESPONSE]


def of_one_axis(functions: Sequence[uff.UffFunction], axis: str | None, where: str) -> list[uff.UffFunction]:
    """Frequency responses in which every node moves in one direction, which is what a point of a model does.

    Args:
        functions: of a file.
        axis: that the sidecar chooses, None where it does not.
        where: the segment is, for messages.

    Raises:
        BenchError: a node has several directions, and the sidecar chooses none or one that leaves none.
    """
    chosen = list(functions)
    if axis is not None:
        number = 1 + _AXES.index(axis)
        moved = {f.reference_node for f in functions if abs(f.reference_direction) == number}
        moved |= {f.response_node for f in functions if abs(f.response_direction) == number}
        chosen = [
            f
            for f in functions
            if abs(f.response_direction) in (0, number)
            and (abs(f.reference_direction) in (0, number) or f.reference_node not in moved)
        ]
        if not chosen:
            raise BenchError(f"{where}: it has no response in {axis.upper()}; correct 'axis'.")
    found: dict[int, set[int]] = {}
    for function in chosen:
        for node, direction in (
            (function.response_node, function.response_direction),
            (function.reference_node, function.reference_direction),
        ):
            if direction:
                found.setdefault(node, set()).add(abs(direction))
    for node, directions in found.items():
        if len(directions) > 1:
            names = [
                _AXES[number - 1].upper() if number <= len(_AXES) else str(number) for number in sorted(directions)
            ]
            raise BenchError(
                f"{where}: point {node} has directions {' and '.join(names)}, and a point of the model is one of them; "
                f"say 'axis: {names[-1].lower()}' (or another one) to take responses and forces in that direction."
            )
    return chosen


def response_values(
    section: TableSection, function: uff.UffFunction, where: str, notes: list[str]
) -> tuple[Quantity, np.ndarray, np.ndarray]:
    """Quantity, frequencies (Hz) and responses (SI units) of one dataset.

    Args:
        section: what the sidecar says.
        function: the dataset.
        where: it is, for messages.
        notes: where sentences go.

    Raises:
        BenchError: no unit, one that contradicts the file, no response over a force, or values that are not finite.
    """
    unit = _unit(section, function, where)
    quantity, factor, _ = response_over_reference(unit, where, force_only=True)
    quantity_of_axis = uff.QUANTITIES.get(function.ordinate_axis.data_type)
    if quantity_of_axis in MOTIONS and quantity_of_axis is not quantity:
        raise BenchError(f"{where} holds {quantity_of_axis.name.lower()} per force, but the sidecar says {unit}.")
    if function.denominator_axis.data_type not in _FORCES:
        raise BenchError(f"{where} is not referred to a force; leave it out.")
    if function.abscissa_axis.data_type == uff.TIME:
        raise BenchError(f"{where} is a frequency response over time by its abscissa; export it again.")
    sign = _sign(section, function, where, notes)
    values = np.asarray(function.values, dtype=np.complex128) * (factor * section.scale * sign)
    values = values.conj() if section.conjugate else values
    if not np.isfinite(values).all() or not np.isfinite(function.x).all():
        raise BenchError(f"{where} holds values that are not finite; export it again.")
    return quantity, function.x * _frequency_factor(function, where, notes), values


def _unit(section: TableSection, function: uff.UffFunction, where: str) -> str:
    heading = stated_unit(function)
    if not section.unit:
        return heading
    if "scale" in section.model_fields_set:
        return section.unit
    # Where the dataset does not tell the whole quotient, the axis of the response may tell its half.
    by_file, by_sidecar = heading, section.unit
    if not heading and section.unit.endswith("/N"):
        by_file, by_sidecar = function.ordinate_axis.unit, section.unit.removesuffix("/N")
    theirs, stated = unit_size(by_file), unit_size(by_sidecar)
    known = theirs is not None and stated is not None and theirs[0] is stated[0]
    if known and theirs is not None and stated is not None and not math.isclose(stated[1], theirs[1], rel_tol=1e-9):
        raise BenchError(
            f"{where} is in {by_file} by the file, but in {section.unit} by the sidecar; correct one of them (without "
            "'unit' it is the file's), or state 'scale: 1' if the file is wrong."
        )
    return section.unit


def _sign(section: TableSection, function: uff.UffFunction, where: str, notes: list[str]) -> int:
    if section.turned is not None:
        stated = -1 if function.response_node in section.turned else 1
        if stated != function.direction_sign:
            notes.append(f"{where} has the directions {function.direction_words}; the sidecar says sign {stated}.")
        return stated
    if function.direction_sign < 0:
        if section.scale < 0.0:
            raise BenchError(
                f"{where} points the other way by its directions ({function.direction_words}), and scale is negative, "
                f"too; say 'turned: [{function.response_node}]' if both turn it, 'turned: []' if the scale alone does."
            )
        notes.append(f"{where} points the other way ({function.direction_words}); its values were turned.")
    return function.direction_sign


def _frequency_factor(function: uff.UffFunction, where: str, notes: list[str]) -> float:
    unit = plain_unit(function.abscissa_axis.unit)
    if unit in ("NONE", "1", "", "Hz", "s"):
        return 1.0
    factor = other_factor("frequency", unit, f"{where}: its abscissa")
    notes.append(f"The abscissa of {where.rpartition(': ')[2]} is in {unit}.")
    return factor
