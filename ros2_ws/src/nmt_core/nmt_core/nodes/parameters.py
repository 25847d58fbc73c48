"""Declarative parameter tables: one table a node, from which descriptors, checks and documentation come."""

from __future__ import annotations

import ast
import math
from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.text.text_table import entries

ParameterValue = bool | int | float | str | list[float] | list[int] | list[str]


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a node.

    Attributes:
        name: ROS parameter name.
        default: default value; its type is the type of the parameter. Lists need at least one element of their type
            (ROS cannot tell the type of an empty list).
        unit: unit of the value, empty where it has none.
        description: one sentence.
        low, high: inclusive bounds of a number or of every element of a list; None = unbounded.
        choices: allowed strings; empty = any.
    """

    name: str
    default: ParameterValue
    unit: str
    description: str
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()

    def check(self, value: Any, owner: str) -> ParameterValue:
        """Return ``value`` in the parameter's type.

        Args:
            value: what the user gave.
            owner: name of the node, for the message.

        Raises:
            BenchError: wrong type, not finite, out of bounds or not one of the choices.
        """
        where = f"Parameter '{self.name}' of {owner}"
        if isinstance(self.default, list):
            if isinstance(value, str) or not isinstance(value, Sequence | array):
                raise BenchError(f"{where} must be a list, got {value!r}.")
            kind = type(self.default[0])
            value = [_of_kind(item, kind, where) for item in value]
        else:
            value = _of_kind(value, type(self.default), where)
        numbers = value if isinstance(value, list) else [value]
        for number in numbers:
            if isinstance(number, bool) or not isinstance(number, int | float):
                continue
            if not math.isfinite(number):
                raise BenchError(f"{where} must be finite, got {number!r}.")
            if self.low is not None and number < self.low:
                raise BenchError(f"{where} must be at least {self.low:g}{self._unit()}, got {number:g}.")
            if self.high is not None and number > self.high:
                raise BenchError(f"{where} must be at most {self.high:g}{self._unit()}, got {number:g}.")
        if self.choices and value not in self.choices:
            raise BenchError(f"{where} must be one of {', '.join(self.choices)}, got {value!r}.")
        return value  # type: ignore[no-any-return]

    def _unit(self) -> str:
        return f" {self.unit}" if self.unit else ""


def parameter_table(table: str) -> tuple[Parameter, ...]:
    """Parameters from a table that says a line each: name, default, unit, range or choices, two spaces, description. ::

    ramp =0.5 (s) 0.0..  Half-cosine between levels.
    pacing =lockstep lockstep|realtime  What paces the run.
    topics =["force"]  Indented lines go on with the description.
    """
    found = []
    for head, description in entries(table):
        name, default, *marks = head.split(" ")
        settings: dict[str, Any] = {"unit": ""}
        for mark in marks:
            if mark.startswith("("):
                settings["unit"] = mark[1:-1]
            elif ".." in mark:
                ends = zip(("low", "high"), mark.split(".."), strict=True)
                settings |= {end: ast.literal_eval(number) for end, number in ends if number}
            else:
                settings["choices"] = tuple(mark.split("|"))
        found.append(Parameter(name, _literal(default[1:]), description=description, **settings))
    return tuple(found)


def _literal(text: str) -> ParameterValue:
    """The value that a text writes as Python does, or the text itself."""
    try:
        value: ParameterValue = ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return text
    return value


def _of_kind(value: Any, kind: type, where: str) -> Any:
    """``value`` if it is of a kind; whole numbers pass for floats, truth values for nothing else."""
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise BenchError(f"{where} must be of type {kind.__name__}, got {value!r}.")
    return value


def check_values(table: Sequence[Parameter], values: Mapping[str, Any], owner: str) -> dict[str, ParameterValue]:
    """Complete and check a set of values against a table.

    Args:
        table: the node's parameters.
        values: given values by name.
        owner: name of the node, for messages.

    Returns:
        Every parameter of the table with its value.

    Raises:
        BenchError: unknown name, or a value that :meth:`Parameter.check` refuses.
    """
    known = {parameter.name for parameter in table}
    for name in values:
        if name not in known:
            raise BenchError(f"Parameter '{name}' is not known to {owner}; it knows {', '.join(sorted(known))}.")
    return {item.name: item.check(values.get(item.name, item.default), owner) for item in table}


def markdown_table(table: Iterable[Parameter]) -> str:
    """The parameters as a Markdown table for the reference documentation."""
    lines = ["| parameter | default | unit | range | meaning |", "|---|---|---|---|---|"]
    for item in table:
        low = "" if item.low is None else f"≥ {item.low:g}"
        high = "" if item.high is None else f"≤ {item.high:g}"
        bounds = ", ".join(item.choices) or " ".join(part for part in (low, high) if part)
        lines.append(f"| `{item.name}` | `{item.default!r}` | {item.unit} | {bounds} | {item.description} |")
    return "\n".join(lines)
