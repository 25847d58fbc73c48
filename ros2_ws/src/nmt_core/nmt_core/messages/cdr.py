"""Serialised messages by the fields in their files: XCDR version 1, little endian, as Fast DDS and every bag have it.

Every primitive is aligned to its own size, counted from the end of the four-byte encapsulation header; texts and
sequences begin with a count, texts end with a zero byte. What stands behind the last field means nothing: rclpy leaves
some bytes there when a sequence of ``float64`` is empty.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, Generic, TypeVar

import numpy as np

from nmt_core.messages.message_files import find_message_file, message_fields

ENCAPSULATION = b"\x00\x01\x00\x00"
BASE = len(ENCAPSULATION)
COUNT = struct.Struct("<I")
STAMP = struct.Struct("<iI")
_MAX_SECONDS = 2**31 - 1
_NUMBERS = {
    "bool": struct.Struct("<?"),
    "uint8": struct.Struct("<B"),
    "uint32": struct.Struct("<I"),
    "uint64": struct.Struct("<Q"),
    "float64": struct.Struct("<d"),
}
_ITEMS: dict[str, np.dtype[Any]] = {"uint32[]": np.dtype("<u4"), "float64[]": np.dtype("<f8")}
TIME = "builtin_interfaces/Time"

Record = TypeVar("Record")


def aligned(position: int, size: int) -> int:
    """Next position with the alignment of ``size``, counted from the end of the encapsulation header."""
    return BASE + -(-(position - BASE) // size) * size


def bench_stamp(sample: int, sample_rate: float) -> tuple[int, int]:
    """Bench time of a sample as seconds and nanoseconds, at most what a ROS time can hold."""
    seconds = int(sample / sample_rate)
    if seconds > _MAX_SECONDS:
        return _MAX_SECONDS, 999_999_999
    return seconds, min(999_999_999, round((sample - seconds * sample_rate) / sample_rate * 1e9))


def bench_time_ns(sample: int, sample_rate: float) -> int:
    """Bench time of a sample, ns, as messages have it; 0 without a sampling rate."""
    if not sample_rate > 0.0:
        return 0
    seconds, nanoseconds = bench_stamp(sample, sample_rate)
    return seconds * 1_000_000_000 + nanoseconds


def string_bytes(text: str) -> bytes:
    """A text with its count and its final zero."""
    data = text.encode()
    return COUNT.pack(len(data) + 1) + data + b"\x00"


def read_string(raw: bytes, position: int) -> tuple[str, int]:
    """The text at an aligned position, and the position after it; ValueError if it runs past the end."""
    (length,) = COUNT.unpack_from(raw, position)
    end = position + 4 + length
    if end > len(raw):
        raise ValueError("a text runs past the end of the message")
    return raw[position + 4 : end - 1].decode(), end


def check_encapsulation(raw: bytes) -> None:
    """Refuse (ValueError) what is not little-endian XCDR1."""
    if raw[:2] != ENCAPSULATION[:2]:
        raise ValueError("the message is not little-endian XCDR1")


class MessageCodec(Generic[Record]):
    """Bytes of one type of message of the bench, to and from its record. A stamp is a time in ns, ``time_ns``.

    Args:
        name: of the message; the fields are those of ``nmt_msgs/msg/<name>.msg``.
        record: its type; attributes are named as the fields.
        kinds: what the record has in place of the number or array of a field.
        make: makes a record of the values by field, where they are not the record's own.
        otherwise: values of the fields that the record has in another form.

    Attributes:
        name: of the message.
        fields: name and type of each field in order.
    """

    def __init__(
        self,
        name: str,
        record: type[Record],
        kinds: Mapping[str, Callable[[Any], Any]] | None = None,
        *,
        make: Callable[[dict[str, Any]], Record] | None = None,
        otherwise: Callable[[Record], Mapping[str, Any]] | None = None,
    ) -> None:
        self.name = name
        self.fields = message_fields(find_message_file(f"nmt_msgs/msg/{name}").read_text(encoding="utf-8"))
        self._stretches = _stretches(self.fields)
        self._kinds = tuple((kinds or {}).items())
        self._record: Callable[..., Record] = record
        self._make = make
        self._otherwise = otherwise
        attributes = ((field, "time_ns" if field == "stamp" else field) for field, _ in self.fields)
        self._plain = tuple(pair for pair in attributes if pair[1] in record.__annotations__)

    def write(self, record: Record) -> bytes:
        """The serialised message.

        Raises:
            ValueError: a value that its field cannot hold.
        """
        values = {field: getattr(record, attribute) for field, attribute in self._plain}
        if self._otherwise is not None:
            values.update(self._otherwise(record))
        return self.pack(values)

    def pack(self, values: Mapping[str, Any]) -> bytes:
        """The serialised message of field values by name.

        Raises:
            ValueError: as :meth:`write`.
        """
        buffer = bytearray(ENCAPSULATION)
        try:
            for names, kinds in self._stretches:
                if kinds[0] in _NUMBERS:
                    layout = _layout(kinds, (len(buffer) - BASE) % 8)
                    buffer += layout.pack(*[values[name] for name in names])
                else:
                    append(buffer, kinds[0], values[names[0]])
        except (struct.error, OverflowError, TypeError):
            return self._pack_each(values)  # says which field it is
        return bytes(buffer)

    def _pack_each(self, values: Mapping[str, Any]) -> bytes:
        buffer = bytearray(ENCAPSULATION)
        for name, kind in self.fields:
            try:
                append(buffer, kind, values[name])
            except (struct.error, OverflowError, TypeError) as error:
                raise ValueError(f"{self.name}.{name} cannot be {values[name]!r}: {error}") from error
        return bytes(buffer)

    def read(self, raw: bytes) -> Record:
        """The record of a serialised message.

        Raises:
            ValueError: the bytes are not a whole message, or a number stands for nothing known.
            BenchError: no such kind of test.
        """
        values = self.values(raw)
        if "stamp" in values:
            values["time_ns"] = values.pop("stamp")
        for name, kind in self._kinds:
            values[name] = kind(values[name])
        return self._record(**values) if self._make is None else self._make(values)

    def values(self, raw: bytes) -> dict[str, Any]:
        """Field values of a serialised message by name, as plain numbers, texts, tuples and arrays.

        Raises:
            ValueError: the bytes are not a whole message.
        """
        check_encapsulation(raw)
        values: dict[str, Any] = {}
        position = BASE
        try:
            for names, kinds in self._stretches:
                if kinds[0] in _NUMBERS:
                    layout = _layout(kinds, (position - BASE) % 8)
                    values.update(zip(names, layout.unpack_from(raw, position), strict=True))
                    position += layout.size
                else:
                    values[names[0]], position = take(raw, position, kinds[0])
        except (struct.error, UnicodeDecodeError, ValueError) as error:
            raise ValueError(f"the message is not a whole {self.name}: {error}") from error
        return values


def _stretches(fields: tuple[tuple[str, str], ...]) -> tuple[tuple[tuple[str, ...], tuple[str, ...]], ...]:
    """Names and types of the fields: numbers that follow each other together, everything else by itself."""
    stretches: list[tuple[list[str], list[str]]] = []
    for name, kind in fields:
        if kind in _NUMBERS and stretches and stretches[-1][1][0] in _NUMBERS:
            stretches[-1][0].append(name)
            stretches[-1][1].append(kind)
        else:
            stretches.append(([name], [kind]))
    return tuple((tuple(names), tuple(kinds)) for names, kinds in stretches)


@lru_cache(maxsize=256)
def _layout(kinds: tuple[str, ...], offset: int) -> struct.Struct:
    """Numbers that follow each other, with their padding; ``offset``: of the first position, modulo 8."""
    text, position = "<", offset
    for kind in kinds:
        number = _NUMBERS[kind]
        padding = -position % number.size
        text += f"{padding}x{number.format[1:]}" if padding else number.format[1:]
        position += padding + number.size
    return struct.Struct(text)


def append(buffer: bytearray, kind: str, value: Any) -> None:
    """Serialise a value of a type behind what is there, aligned."""
    number = _NUMBERS.get(kind)
    if number is not None:
        pad(buffer, number.size)
        buffer.extend(number.pack(value))
    elif kind == "string":
        pad(buffer, 4)
        buffer.extend(string_bytes(value))
    elif kind == TIME:
        pad(buffer, 4)
        buffer.extend(STAMP.pack(*divmod(int(value), 1_000_000_000)))
    else:
        items = np.ascontiguousarray(value, dtype=_ITEMS[kind])
        pad(buffer, 4)
        buffer.extend(COUNT.pack(items.size))
        if items.size:
            pad(buffer, items.itemsize)
            buffer.extend(items.tobytes())


def take(raw: bytes, position: int, kind: str) -> tuple[Any, int]:
    """The value of a type at a position, which is aligned first, and the position after it."""
    number = _NUMBERS.get(kind)
    if number is not None:
        position = aligned(position, number.size)
        return number.unpack_from(raw, position)[0], position + number.size
    position = aligned(position, 4)
    if kind == "string":
        return read_string(raw, position)
    if kind == TIME:
        seconds, nanoseconds = STAMP.unpack_from(raw, position)
        return seconds * 1_000_000_000 + nanoseconds, position + STAMP.size
    (count,) = COUNT.unpack_from(raw, position)
    position += COUNT.size
    if not count:
        return (() if kind == "uint32[]" else np.empty(0)), position
    item = _ITEMS[kind]
    position = aligned(position, item.itemsize)
    end = position + count * item.itemsize
    if end > len(raw):
        raise ValueError("a sequence runs past the end of the message")
    items = np.frombuffer(raw, item, count, position)
    return (tuple(items.tolist()) if kind == "uint32[]" else items.astype(np.float64)), end


def pad(buffer: bytearray, size: int) -> int:
    """Fill up to the alignment of ``size``; returns the position reached."""
    buffer.extend(bytes(aligned(len(buffer), size) - len(buffer)))
    return len(buffer)


def read_stamp(raw: bytes) -> int:
    """Nanoseconds of a serialised message whose first field is a ``Time`` or a ``Header``.

    Raises:
        ValueError: not little-endian XCDR1, or too short.
    """
    check_encapsulation(raw)
    try:
        seconds, nanoseconds = STAMP.unpack_from(raw, BASE)
    except struct.error as error:
        raise ValueError("the message is too short for a stamp") from error
    return int(seconds) * 1_000_000_000 + int(nanoseconds)
