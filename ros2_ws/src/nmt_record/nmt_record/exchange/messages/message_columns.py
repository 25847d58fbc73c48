"""Numbers of messages as columns: each is called as the message that holds it calls it.

A message type is looked at once. What may differ from message to message (lengths of arrays, names of their elements,
what a message calls itself) is its layout; messages of one layout are read by one list of getters.
"""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np

from nmt_core.messages.named_elements import distinct, label_fields, naming_sequences

MOST_ELEMENTS = 64
"""Of an array whose elements are columns of their own; a longer one may hold samples one after the other."""
_MOST_SAMPLES = 65_536  # of an array that may hold samples
_MOST_LAYOUTS = 1024
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_LEFT_OUT = re.compile(r"(.*_)?covariance$|layout$")
_SECONDS = re.compile(r"(.*?)_?(sec|secs|seconds|s)$")
_NANOSECONDS = ("nanosec", "nanosecs", "nsec", "nsecs", "nanoseconds", "ns")
_TEXTS = ("string", "wstring")


@dataclass(frozen=True)
class Column:
    """A number of a layout.

    Attributes:
        name: as columns are called.
        field: the same without what messages call things, for what a field means.
        stamp: name of the stamp that it has; empty = none.
        array: path of the array whose element it is; empty = none, or its elements have names.
    """

    name: str
    field: str
    stamp: str
    array: str = ""


@dataclass(eq=False)
class Layout:
    """Messages of one topic that hold the same things, and what they hold.

    Attributes:
        label: what the messages call themselves; empty = nothing.
        columns: of :attr:`values`, in order.
        stamps: names of the columns of :attr:`times`.
        shapes: of arrays whose elements have no names: sizes and labels of their dimensions.
        numbers: position of each message among those of its topic.
        logged: time of reception of each, ns.
        values: a row for each message.
        times: a row of stamps for each message, ns.
    """

    label: str
    columns: list[Column]
    stamps: list[str]
    shapes: dict[str, tuple[tuple[str, int], ...]]
    readers: list[Callable[[Any], Any]]
    stamp_readers: list[Callable[[Any], int]]
    numbers: array[int] = field(default_factory=lambda: array("q"))
    logged: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))
    times: array[int] = field(default_factory=lambda: array("q"))


@dataclass(frozen=True)
class _Sequence:
    """An array of a message: of numbers, or of messages of a structure."""

    path: str
    structure: _Structure | None
    naming: tuple[str, ...]
    fixed: bool
    layout: bool


@dataclass(frozen=True)
class _Structure:
    """What a message type holds; nested messages are part of the one that holds them.

    Attributes:
        numbers: paths.
        sequences: arrays.
        labels: paths of possible names of the message.
        stamps: paths of stamps, and of pairs of seconds and nanoseconds.
        is_pair: a key and a value that is a text.
    """

    numbers: tuple[str, ...]
    sequences: tuple[_Sequence, ...]
    labels: tuple[str, ...]
    stamps: tuple[tuple[str, str, str], ...]
    is_pair: bool


def structure_of(definitions: Any, kind: str, prefix: str = "", above: tuple[str, ...] = ()) -> _Structure:
    """The structure of a message type.

    Args:
        definitions: fields by type, as a ``rosbags`` type store has them.
        kind: message type.
    """
    from rosbags.interfaces import Nodetype

    numbers: list[str] = []
    sequences: list[_Sequence] = []
    stamps: list[tuple[str, str, str]] = []
    texts: list[str] = []
    integers: list[str] = []
    found: list[tuple[str, str, Any, bool]] = []
    nested_labels: list[str] = []
    items = definitions[kind][1]
    for name, (node, detail) in items:
        path = f"{prefix}{name}"
        if _LEFT_OUT.match(name):
            continue
        if node == Nodetype.BASE:
            base = detail[0]
            if base in _TEXTS:
                texts.append(name)
            elif base not in ("bool", "octet", "char"):
                numbers.append(path)
                if "int" in base:
                    integers.append(name)
        elif node == Nodetype.NAME:
            if detail in _TIMES:
                stamps.append((path, f"{path}.sec", f"{path}.nanosec"))
            elif detail not in above:
                inner = structure_of(definitions, detail, f"{path}.", (*above, kind))
                if name == "header" and detail.endswith("/Header"):
                    nested_labels += [f"{path}.frame_id"]
                    stamps += inner.stamps
                    continue
                numbers += inner.numbers
                sequences += inner.sequences
                stamps += inner.stamps
        else:
            (element, inner_detail), size = detail
            found.append((name, path, (element, inner_detail), node == Nodetype.ARRAY and size > 0))
    nested = len(sequences)  # arrays of nested messages, whose elements an array of this one may name
    names = {name for name, *_ in found}
    texts_of = [name for name, _, (node, detail), _ in found if node == Nodetype.BASE and detail[0] in _TEXTS]
    integer_arrays = [name for name, _, (node, detail), _ in found if node == Nodetype.BASE and "int" in detail[0]]
    naming = naming_sequences(texts_of, integer_arrays)
    outer = tuple(f"{prefix}{name}" for name in naming if name in names)
    sequences[:nested] = [replace(one, naming=(*one.naming, *outer)) for one in sequences[:nested]]
    has_layout = any(name == "layout" for name, _ in items)
    for name, path, (node, detail), fixed in found:
        others = tuple(f"{prefix}{other}" for other in naming if other != name and other in names)
        if node == Nodetype.BASE and detail[0] not in (*_TEXTS, "bool", "octet", "char") and name not in naming:
            sequences.append(_Sequence(path, None, others, fixed, has_layout and name == "data"))
        elif node == Nodetype.NAME and detail not in _TIMES and detail not in above:
            sequences.append(
                _Sequence(path, structure_of(definitions, detail, "", (*above, kind)), others, fixed, False)
            )
    stamps += _pairs(numbers, prefix)
    labels = [f"{prefix}{name}" for name in label_fields([*texts, *(n for n in integers if n.endswith("id"))])]
    fields = {name for name, _ in items}
    return _Structure(
        tuple(numbers), tuple(sequences), (*labels, *nested_labels), tuple(stamps),
        fields == {"key", "value"} and set(texts) == fields,
    )  # fmt: skip


def _pairs(numbers: list[str], prefix: str) -> list[tuple[str, str, str]]:
    """Seconds and nanoseconds next to each other are one stamp; they are taken out of the numbers."""
    result = []
    for path in list(numbers):
        name = path.removeprefix(prefix)
        match = _SECONDS.match(name)
        if "." in name or match is None:
            continue
        for end in _NANOSECONDS:
            other = next((f"{prefix}{match[1]}{joint}{end}" for joint in ("", "_") if
                          f"{prefix}{match[1]}{joint}{end}" in numbers), None)  # fmt: skip
            if other is not None and path in numbers:
                numbers.remove(path)
                numbers.remove(other)
                result.append((path, path, other))
                break
    return result


class TopicReader:
    """Takes the messages of one topic and sorts them by what they hold.

    Args:
        structure: of the type.
        elements: what the sidecar says of arrays without names; of bytes the numbers that they are made of.
    """

    def __init__(self, structure: _Structure, elements: str = "") -> None:
        self._structure = structure
        self._byte_type = byte_type(elements)
        self.bytes: dict[str, int] = {}
        """Arrays of bytes that are no columns, and their lengths."""
        self._layouts: dict[tuple[Hashable, Hashable], Layout] = {}
        self._labels = [attrgetter(path) for path in structure.labels]
        self._key = _key_of(replace(structure, labels=()))
        self.count = 0
        self.is_anonymous = False
        """Names are other ones in each message, so that they name nothing that could be a column."""

    @property
    def layouts(self) -> list[Layout]:
        """Of the messages so far, in the order in which they came first."""
        return list(self._layouts.values())

    @property
    def has_numbers(self) -> bool:
        """Whether the type may hold any."""
        return _may_hold_numbers(self._structure)

    def _forget_labels(self) -> None:
        """What a message calls itself counts no longer, where each one calls itself otherwise."""
        merged: dict[tuple[Hashable, Hashable], Layout] = {}
        for (_, key), layout in self._layouts.items():
            first = merged.setdefault(((), key), layout)
            if first is not layout:
                first.label = ""
                for name in ("numbers", "logged", "values", "times"):
                    getattr(first, name).extend(getattr(layout, name))
        self._labels = []
        self._layouts = merged
        self.is_anonymous = len(merged) > _MOST_LAYOUTS // 2

    def add(self, message: Any, logged: int) -> None:
        """Take a message that was received at a time (ns)."""
        if self.is_anonymous:
            return
        labels = tuple([get(message) for get in self._labels])
        key = labels, self._key(message)
        layout = self._layouts.get(key)
        if layout is None:
            layout = self._layouts[key] = _layout_of(self._structure, message, self._byte_type, self.bytes)
            if len(self._layouts) > _MOST_LAYOUTS:
                self._forget_labels()
                layout = self._layouts[(), key[1]]
        for read in layout.readers:
            layout.values.extend(read(message))
        for read_stamp in layout.stamp_readers:
            layout.times.append(read_stamp(message))
        layout.numbers.append(self.count)
        layout.logged.append(logged)
        self.count += 1


def _may_hold_numbers(structure: _Structure) -> bool:
    return structure.is_pair or bool(structure.numbers) or any(
        one.structure is None or _may_hold_numbers(one.structure) for one in structure.sequences
    )  # fmt: skip


def _key_of(structure: _Structure) -> Callable[[Any], Hashable]:
    """What tells messages of one type apart: names, lengths of arrays, dimensions."""
    parts: list[Callable[[Any], Hashable]] = [attrgetter(path) for path in structure.labels]
    for one in structure.sequences:
        if one.structure is not None:
            parts.append(_inner_key(attrgetter(one.path), _key_of(one.structure)))
        elif not one.fixed:
            parts.append(_length(attrgetter(one.path)))
        parts += [_names(attrgetter(path)) for path in one.naming]
        if one.layout:
            parts.append(partial(_dimensions, path=one.path))
    if len(parts) == 1:
        return parts[0]
    return lambda message: tuple([part(message) for part in parts])


def _inner_key(fetch: Callable[[Any], Any], key: Callable[[Any], Hashable]) -> Callable[[Any], Hashable]:
    return lambda message: tuple([key(item) for item in fetch(message)])


def _length(fetch: Callable[[Any], Any]) -> Callable[[Any], Hashable]:
    return lambda message: len(fetch(message))


def _names(fetch: Callable[[Any], Any]) -> Callable[[Any], Hashable]:
    return lambda message: tuple(fetch(message))


def _dimensions(message: Any, path: str) -> tuple[tuple[str, int], ...]:
    head = path.rpartition(".")[0]
    layout = attrgetter(f"{head}.layout" if head else "layout")(message)
    return tuple((str(one.label).strip(), int(one.size)) for one in layout.dim)


def _label_of(structure: _Structure, message: Any) -> str:
    return next((label for path in structure.labels if (label := str(attrgetter(path)(message)).strip())), "")


@dataclass
class _Draft:
    """A layout that is being made."""

    columns: list[Column] = field(default_factory=list)
    stamps: list[str] = field(default_factory=list)
    shapes: dict[str, tuple[tuple[str, int], ...]] = field(default_factory=dict)
    readers: list[Callable[[Any], Any]] = field(default_factory=list)
    stamp_readers: list[Callable[[Any], int]] = field(default_factory=list)
    byte_type: np.dtype[Any] | None = None
    bytes: dict[str, int] = field(default_factory=dict)


def byte_type(elements: str) -> np.dtype[Any] | None:
    """Numbers that bytes are made of, by ``bytes int16`` or ``bytes int16 big`` of a sidecar; None without."""
    words = elements.split()
    if len(words) < 2 or words[0] != "bytes":
        return None
    return np.dtype(words[1]).newbyteorder(">" if words[2:] == ["big"] else "<")


def _layout_of(
    structure: _Structure, message: Any, of_bytes: np.dtype[Any] | None, byte_arrays: dict[str, int]
) -> Layout:
    draft = _Draft(byte_type=of_bytes, bytes=byte_arrays)
    if structure.is_pair:
        draft.columns.append(Column("value", "value", ""))
        draft.readers.append(_text_reader(_itself))
    else:
        _describe(structure, message, "", "", "", _itself, draft)
    label = _label_of(structure, message)
    dimensions = next(iter(draft.shapes.values()), ())
    if not label and len(dimensions) == 1 and len(draft.shapes) == 1 and not is_time_label(dimensions[0][0]):
        label = dimensions[0][0]
    return Layout(label, draft.columns, draft.stamps, draft.shapes, draft.readers, draft.stamp_readers)


def _itself(message: Any) -> Any:
    return message


def _describe(
    structure: _Structure, message: Any, prefix: str, bare: str, stamp: str, get: Callable[[Any], Any], draft: _Draft
) -> None:
    """Columns and readers of a message or of an element of one.

    Args:
        message: an example.
        prefix, bare: of names of columns, and of fields.
        stamp: that of the message which holds this one.
        get: fetches this message from the topic's.
    """
    for path, seconds, nanoseconds in structure.stamps:
        draft.stamps.append(f"{prefix}{path}")
        draft.stamp_readers.append(_stamp_reader(get, seconds, nanoseconds))
    stamp = f"{prefix}{structure.stamps[0][0]}" if structure.stamps else stamp
    if structure.numbers:
        fetch = attrgetter(*structure.numbers)
        draft.readers.append(_scalar_reader(get, fetch, len(structure.numbers)))
        draft.columns += [Column(f"{prefix}{path}", f"{bare}{path}", stamp) for path in structure.numbers]
    for one in structure.sequences:
        items = attrgetter(one.path)(message)
        labels = _labels(one, message, items)
        if one.structure is not None:
            for number, item in enumerate(items[:MOST_ELEMENTS]):
                name = labels[number] if labels else str(number + 1)
                fetch_item = _item_reader(get, one.path, number)
                inner, bare_inner = f"{prefix}{one.path}.{name}", f"{bare}{one.path}"
                if one.structure.is_pair:
                    draft.columns.append(Column(inner if labels else f"{inner}.value", bare_inner, stamp))
                    draft.readers.append(_text_reader(fetch_item))
                else:
                    _describe(one.structure, item, f"{inner}.", f"{bare_inner}.", stamp, fetch_item, draft)
        elif _is_bytes(items) and draft.byte_type is not None and len(items) >= draft.byte_type.itemsize:
            count = len(items) // draft.byte_type.itemsize
            path = f"{prefix}{one.path}"
            draft.shapes[path] = ()
            draft.columns += [Column(f"{path}.{n + 1}", f"{bare}{one.path}", stamp, path) for n in range(count)]
            draft.readers.append(_bytes_reader(get, one.path, draft.byte_type, count))
        elif _is_bytes(items) and len(items) > MOST_ELEMENTS:
            draft.bytes[f"{prefix}{one.path}"] = len(items)
        elif 0 < len(items) <= _limit(items):
            array_path = "" if labels else f"{prefix}{one.path}"
            if array_path:
                draft.shapes[array_path] = _dimensions(message, one.path) if one.layout else ()
            names = labels or [str(number + 1) for number in range(len(items))]
            draft.columns += [
                Column(f"{prefix}{one.path}.{name}", f"{bare}{one.path}", stamp, array_path) for name in names
            ]
            draft.readers.append(_array_reader(get, one.path))


def _is_bytes(items: Any) -> bool:
    kind = getattr(items, "dtype", None)
    return kind is not None and kind.itemsize == 1


def _bytes_reader(get: Callable[[Any], Any], path: str, kind: np.dtype[Any], count: int) -> Callable[[Any], Any]:
    fetch = attrgetter(path)

    def read(message: Any) -> Any:
        raw = np.ascontiguousarray(fetch(get(message))).tobytes()[: count * kind.itemsize]
        return np.frombuffer(raw, dtype=kind).astype(np.float64).tolist()

    return read


def _limit(items: Any) -> int:
    """Bytes of a picture are no samples."""
    return MOST_ELEMENTS if _is_bytes(items) else _MOST_SAMPLES


def _labels(one: _Sequence, message: Any, items: Sequence[Any]) -> list[str] | None:
    """Names of the elements of an array; None where they are counted."""
    for path in one.naming:
        names = attrgetter(path)(message)
        if len(names) == len(items) and (labels := distinct(list(names))):
            return labels
    if one.layout:
        dimensions = _dimensions(message, one.path)
        product = math.prod(size for _, size in dimensions)
        if len(dimensions) == len(items) > 1 and product != len(items):
            return distinct([label for label, _ in dimensions])
    if one.structure is None:
        return None
    for path in one.structure.labels:
        if labels := distinct([attrgetter(path)(item) for item in items]):
            return labels
    return None


_TIME_LABEL = re.compile(r"(n_?)?(samples?|time|times|t|n|rows?|frames?|block|points?|length|scans?)$", re.I)


def is_time_label(label: str) -> bool:
    """Whether a dimension of an array is one of samples by its label."""
    return bool(_TIME_LABEL.match(label.strip()))


def _stamp_reader(get: Callable[[Any], Any], seconds: str, nanoseconds: str) -> Callable[[Any], int]:
    fetch = attrgetter(seconds, nanoseconds)

    def read(message: Any) -> int:
        before, behind = fetch(get(message))
        return int(before) * 10**9 + int(behind)

    return read


def _scalar_reader(get: Callable[[Any], Any], fetch: Callable[[Any], Any], count: int) -> Callable[[Any], Any]:
    if get is _itself and count > 1:
        return fetch
    if count == 1:
        return lambda message: (fetch(get(message)),)
    return lambda message: fetch(get(message))


def _array_reader(get: Callable[[Any], Any], path: str) -> Callable[[Any], Any]:
    fetch = attrgetter(path)

    def read(message: Any) -> Any:
        items = fetch(get(message))
        return items.tolist() if isinstance(items, np.ndarray) else items

    return read


def _item_reader(get: Callable[[Any], Any], path: str, number: int) -> Callable[[Any], Any]:
    fetch = attrgetter(path)
    return lambda message: fetch(get(message))[number]


def _text_reader(get: Callable[[Any], Any]) -> Callable[[Any], tuple[float]]:
    def read(message: Any) -> tuple[float]:
        try:
            return (float(get(message).value),)
        except ValueError:
            return (math.nan,)

    return read


def columns_by_name(layouts: Sequence[Layout], labelled: bool) -> Iterator[tuple[str, Column, int, int]]:
    """All columns of a topic: full name, column, layout and position in it.

    Args:
        layouts: of the topic.
        labelled: what messages call themselves is part of the name.
    """
    for number, layout in enumerate(layouts):
        head = f"{layout.label}." if labelled and layout.label else ""
        for position, column in enumerate(layout.columns):
            yield head + column.name, column, number, position
