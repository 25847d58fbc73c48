"""The channel table of the topic bridge: which numbers of which messages are which channels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.files.yaml_document import YamlDocument, read_document
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.named_elements import NamedField
from nmt_core.vocabulary import ROTATION_UNITS

_QUANTITIES = {
    **{quantity.topic: (quantity, quantity.unit) for quantity in Quantity if quantity is not Quantity.UNKNOWN},
    **{
        name: (quantity, unit)
        for name, (quantity, unit) in zip(
            ("torque", "angle", "angular_velocity", "angular_acceleration"), ROTATION_UNITS.items(), strict=True
        )
    },
}
"""By the name in a table: quantity of the channel on the bench, and SI unit. An angle stands where a motion does."""
_KEYS = ("topic", "type", "field", "quantity", "point", "scale", "delay_s", "name")


@dataclass(frozen=True)
class BridgeChannel:
    """One line of the channel table.

    Attributes:
        topic: with its slash.
        kind: message type, ``package/msg/Name``.
        field: path of the number in the message, as a column of an imported bag: ``linear_acceleration.z``,
            ``data.1``, ``position.elbow``.
        quantity: what it measures.
        unit: SI unit: that of a rotation where it turns.
        point: measurement point; 0 = none.
        scale: factor of the values to the SI unit of the quantity.
        delay: by which the stamps are late, s.
        name: of the channel.
    """

    topic: str
    kind: str
    field: str
    quantity: Quantity
    unit: str
    point: int
    scale: float
    delay: float
    name: str

    def value(self, message: Any) -> float:
        """The number in a message, in SI units; NaN where the message has none."""
        try:
            return self.getter.value(message) * self.scale
        except (AttributeError, LookupError, TypeError, ValueError):
            return math.nan

    def lack(self, message: Any) -> str:
        """Why a message has no such number; empty if it has."""
        try:
            self.getter.value(message)
        except LookupError as error:
            return str(error.args[0])
        except (AttributeError, TypeError, ValueError) as error:
            return str(error)
        return ""

    @cached_property
    def getter(self) -> NamedField:
        """What fetches the number."""
        return NamedField(self.field)


@dataclass(frozen=True)
class BridgeTable:
    """The channel table.

    Attributes:
        sample_rate: of the grid, Hz.
        block_samples: samples of a block.
        channels: at least one.
        clock: header (stamps of the messages, where they have some) or arrival.
    """

    sample_rate: float
    block_samples: int
    channels: tuple[BridgeChannel, ...]
    clock: str = "header"

    @property
    def topics(self) -> dict[str, str]:
        """Message type by topic."""
        return {channel.topic: channel.kind for channel in self.channels}


def read_channel_table(path: Path) -> BridgeTable:
    """Read a channel table.

    Raises:
        BenchError: not there, or the first thing that is wrong in it, with its line.
    """
    document = read_document(path, "channel table", "sample_rate and channels")
    values = document.values
    for key in values:
        if key not in ("sample_rate", "block_samples", "clock", "channels"):
            raise BenchError(f"{document.place((key,))}: '{key}' is not known; there are sample_rate, block_samples, "
                             "clock, channels.")  # fmt: skip
    clock = values.get("clock", "header")
    if clock not in ("header", "arrival"):
        raise BenchError(f"{document.place(('clock',))}: clock must be header or arrival, got {clock!r}.")
    rate = _number(document, ("sample_rate",), values.get("sample_rate"), 0.1, 1e6)
    block = _number(document, ("block_samples",), values.get("block_samples", max(16, round(0.05 * rate))), 8, 1e6)
    sections = values.get("channels")
    if not isinstance(sections, list) or not sections:
        raise BenchError(f"{document.place(('channels',))}: channels must list at least one topic and field.")
    channels = tuple(_channel(document, number, section) for number, section in enumerate(sections))
    kinds: dict[str, str] = {}
    for number, channel in enumerate(channels):
        if kinds.setdefault(channel.topic, channel.kind) != channel.kind:
            raise BenchError(f"{document.place(('channels', number))}: topic {channel.topic} has two types.")
        other_unit = next(
            (each_channel.unit for each_channel in channels[:number] if each_channel.quantity is channel.quantity),
            channel.unit,
        )
        if other_unit != channel.unit:
            raise BenchError(
                f"{document.place(('channels', number))}: {channel.name} in {channel.unit} and channels in "
                f"{other_unit} would share the topic {channel.quantity.topic}, which has one unit; leave one out."
            )
        if channel.name in (other.name for other in channels[:number]):
            raise BenchError(f"{document.place(('channels', number))}: two channels are named {channel.name}.")
    return BridgeTable(rate, round(block), channels, clock)


def _number(document: YamlDocument, path: tuple[str | int, ...], value: Any, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise BenchError(f"{document.place(path)}: {path[-1]} must be a number in {low:g}..{high:g}, got {value!r}.")
    return float(value)


def _channel(document: YamlDocument, number: int, section: Any) -> BridgeChannel:
    path: tuple[str | int, ...] = ("channels", number)
    place = document.place(path)
    if not isinstance(section, dict):
        raise BenchError(f"{place}: a channel needs topic, type, field and quantity.")
    for key in section:
        if key not in _KEYS:
            raise BenchError(f"{place}: '{key}' is not known; a channel has {', '.join(_KEYS)}.")
    missing = [key for key in _KEYS[:4] if not isinstance(section.get(key), str)]
    if missing:
        raise BenchError(f"{place}: '{missing[0]}' of the channel is missing or no text.")
    parts = section["type"].split("/")
    if len(parts) != 3 or parts[1] != "msg" or not all(parts):
        raise BenchError(f"{place}: type must be written as package/msg/Name, got '{section['type']}'.")
    if section["quantity"] not in _QUANTITIES:
        raise BenchError(f"{place}: quantity must be one of {', '.join(_QUANTITIES)}, got '{section['quantity']}'.")
    quantity, unit = _QUANTITIES[section["quantity"]]
    point = _number(document, (*path, "point"), section.get("point", 0), 0, 10_000)
    return BridgeChannel(
        "/" + section["topic"].lstrip("/"),
        section["type"],
        section["field"],
        quantity,
        unit,
        round(point),
        _number(document, (*path, "scale"), section.get("scale", 1.0), -1e12, 1e12),
        _number(document, (*path, "delay_s"), section.get("delay_s", 0.0), -10.0, 10.0),
        str(section.get("name") or quantity.letter + (str(round(point)) if point else "")),
    )
