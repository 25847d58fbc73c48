"""Parameters of nodes: what ROS descriptors, checks and documentation are made from; see `nmt_core.settings`."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from nmt_core.errors import BenchError

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

    def renamed(self, name: str) -> Parameter:
        """The same under another name."""
        return replace(self, name=name)

    def _unit(self) -> str:
        return f" {self.unit}" if self.unit else ""


def _of_kind(value: Any, kind: type, where: str) -> Any:
    """``value`` if it is of a kind; whole numbers pass for floats, truth values for nothing else."""
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise BenchError(f"{where} must be of type {kind.__name__}, got {value!r}.")
    return value


def markdown_list(table: Iterable[Parameter]) -> str:
    """The parameters as a Markdown list for the reference documentation."""
    lines = []
    for item in table:
        low = "" if item.low is None else f"≥ {item.low:g}"
        high = "" if item.high is None else f"≤ {item.high:g}"
        bounds = " ".join(filter(None, (" or ".join(item.choices), low, high)))
        facts = ", ".join(filter(None, (f"`{item.default!r}`", item.unit, bounds)))
        lines.append(f"* `{item.name}` ({facts}): {item.description}")
    return "\n".join(lines)
