"""Columns of time data in universal files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_record.exchange.arrays import uff
from nmt_record.exchange.source_table import AS_IT_IS, Scaling, SourceTable
from nmt_record.exchange.unit_table import TIME_UNITS, other_factor, plain_unit, quantity_of_unit


def read_uff_table(path: Path) -> SourceTable:
    """Time responses of a universal file.

    Raises:
        BenchError: none, several clocks or lengths, or the file is damaged.
    """
    name = path.name
    functions = uff.read_uff(path)
    times = [f for f in functions if f.function_type in (0, uff.TIME_RESPONSE) and not np.iscomplexobj(f.values)]
    times = [f for f in times if f.abscissa_axis.data_type in (0, 1, uff.TIME)]
    notes = []
    if not times:
        kinds = sorted({uff.FUNCTION_NAMES.get(f.function_type, f"type {f.function_type}") for f in functions})
        raise BenchError(
            f"{name} holds no time data but {', '.join(kinds)}; export time responses (frequency responses "
            "belong into a segment of 'kind: frf')."
        )
    if len(times) < len(functions):
        others = [f for f in functions if f not in times]
        kinds = sorted({uff.FUNCTION_NAMES.get(f.function_type, f"type {f.function_type}") for f in others})
        notes.append(f"{name} also holds {', '.join(kinds)} ({len(others)} datasets); they were left out.")
    head = times[0]
    for function in times[1:]:
        if function.values.shape != head.values.shape:
            raise BenchError(
                f"Datasets {head.number} and {function.number} of {name} have {head.values.shape[0]} and "
                f"{function.values.shape[0]} values; one recording has equal lengths."
            )
        if not np.allclose(function.x[[0, -1]], head.x[[0, -1]], rtol=1e-5, atol=1e-12):
            raise BenchError(
                f"Datasets {head.number} and {function.number} of {name} have different time axes (two clocks); "
                "import them one by one."
            )
    for function in times:
        if np.isinf(function.values).any():
            raise BenchError(f"Dataset {function.number} of {name} holds infinite values; export it again.")
    if head.abscissa is None and not head.abscissa_increment > 0.0:
        raise BenchError(
            f"Dataset {head.number} of {name} has the time step {head.abscissa_increment:g} s; export it again."
        )
    factor = _abscissa_factor(head, name, notes)
    units = tuple("" if f.ordinate_axis.unit.upper() == "NONE" else f.ordinate_axis.unit for f in times)
    return SourceTable(
        name,
        tuple(f.name for f in times),
        tuple(np.ascontiguousarray(f.values, dtype=np.float64) for f in times),
        tuple(unit if quantity_of_unit(unit) is not Quantity.UNKNOWN else "" for unit in units),
        tuple(uff.QUANTITIES.get(f.ordinate_axis.data_type, Quantity.UNKNOWN) for f in times),
        notes,
        start=None if head.abscissa is not None else head.abscissa_minimum * factor,
        step=None if head.abscissa is not None else head.abscissa_increment * factor,
        abscissa=None if head.abscissa is None else head.abscissa * factor,
        scalings=tuple(_scaling(function, name) for function in times),
        points=_points(times, name, notes),
    )


def _points(times: Sequence[uff.UffFunction], name: str, notes: list[str]) -> tuple[int, ...]:
    """Node of each channel; −1 where channels of one quantity have several directions there."""
    found: dict[tuple[int, int], set[int]] = {}
    for function in times:
        key = function.response_node, function.ordinate_axis.data_type
        found.setdefault(key, set()).add(abs(function.response_direction))
    several = sorted({node for (node, _), directions in found.items() if len(directions - {0}) > 1})
    if several:
        notes.append(
            f"Point{'s' if len(several) > 1 else ''} {', '.join(map(str, several))} of {name} have channels in several "
            "directions; a point of the model is one direction, and the sidecar says which channel it is."
        )
    return tuple(-1 if f.response_node in several and f.response_direction else f.response_node for f in times)


def _scaling(function: uff.UffFunction, name: str) -> Scaling:
    words = f"the direction {function.direction_words} of dataset {function.number} of {name}"
    return Scaling(sign=-1, words=words) if function.direction_sign < 0 else AS_IT_IS


def _abscissa_factor(head: uff.UffFunction, name: str, notes: list[str]) -> float:
    """Factor of the time axis to s."""
    unit = plain_unit(head.abscissa_axis.unit)
    if unit not in TIME_UNITS or unit == "s":
        return 1.0
    notes.append(f"The time axis of {name} is in {unit}.")
    return other_factor("time", unit, name)
