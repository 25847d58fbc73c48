"""What a message itself calls the elements of its arrays: joints, frames, keys.

A message names elements in one of two ways: by a sequence of names that runs with others (``name`` and ``position``
of a JointState), or by a field of each element (``child_frame_id`` of a transform, ``key`` of a pair). The place of an
element may change from message to message; its name does not.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, cast

import numpy as np

_SEQUENCE_NAME = re.compile(r"(.*_)?(names?|keys?|labels?|ids?|channels?|joints?|axes|axis)$")
_LABELS = tuple(
    re.compile(pattern)
    for pattern in (r"child_frame_id$", r"name$", r".*_name$", r"key$", r"label$", r"id$", r".*_id$")
)


def naming_sequences(texts: Iterable[str], numbers: Iterable[str] = ()) -> tuple[str, ...]:
    """Sequences of a message that may name the elements of its others, the likeliest first.

    Args:
        texts: names of its sequences of texts.
        numbers: names of its sequences of whole numbers.
    """
    texts = list(texts)
    likely = [name for name in texts if _SEQUENCE_NAME.match(name)]
    ids = [name for name in numbers if re.match(r"(.*_)?ids?$", name)]
    return (*likely, *(texts if len(texts) == 1 and not likely else []), *ids)


def label_fields(fields: Iterable[str]) -> tuple[str, ...]:
    """Fields of a message that may name it among others, the likeliest first.

    Args:
        fields: its texts and whole numbers; of the latter only numbers of things, such as ``id``, count.
    """
    fields = list(fields)
    return tuple(name for pattern in _LABELS for name in fields if pattern.match(name))


def distinct(labels: Sequence[Any]) -> list[str] | None:
    """Labels as texts; None where one is empty or stands twice, so that they name nothing."""
    texts = [str(label).strip() for label in labels]
    return texts if texts and all(texts) and len(set(texts)) == len(texts) else None


def number_of(value: Any) -> float:
    """A number, or the number that a text is.

    Raises:
        TypeError: neither.
        ValueError: a text that is none.
    """
    if isinstance(value, bool):
        return float(value)
    return float(value)


class NamedField:
    """A number of a message by its path, as the columns of imported bags are called.

    Args:
        path: such as ``linear_acceleration.z``, ``data.2`` (elements count from 1), ``position.elbow`` or
            ``transforms.base.transform.translation.x``.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self._parts = path.split(".")

    def value(self, message: Any) -> float:
        """The number.

        Raises:
            LookupError, AttributeError, TypeError, ValueError: this message has none.
        """
        return number_of(_found(message, None, "", self._parts))


def _found(value: Any, parent: Any, field: str, parts: Sequence[str]) -> Any:
    """What a path leads to from a value; a name may have dots of its own."""
    if not parts:
        return value if not _is_sequence(value) else _none(field)
    if not _is_sequence(value):
        if _is_pair(value):
            return _found(value.value, value, "value", parts)
        return _found(getattr(value, parts[0]), value, parts[0], parts[1:])
    labels = labels_of(parent, field, value)
    for length in range(len(parts), 0, -1):
        label = ".".join(parts[:length])
        if labels is not None and label in labels:
            element = value[labels.index(label)]
            left = parts[length:]
            return element.value if not left and hasattr(element, "value") else _found(element, value, field, left)
    if labels is None and parts[0].isdigit() and 0 < int(parts[0]) <= len(value):
        return _found(value[int(parts[0]) - 1], value, field, parts[1:])
    there = labels if labels is not None else [str(number + 1) for number in range(len(value))]
    raise LookupError(f"{field} has no element {'.'.join(parts)}; it has {', '.join(there[:8]) or 'none'}")


def _none(field: str) -> Any:
    raise LookupError(f"{field} is an array; name one of its elements")


def _is_pair(value: Any) -> bool:
    return False if value is None else set(_fields(value)) == {"key", "value"}


def _is_sequence(value: Any) -> bool:
    return not isinstance(value, str | bytes) and hasattr(value, "__len__") and hasattr(value, "__getitem__")


@lru_cache(maxsize=256)
def _fields_of(kind: Hashable) -> tuple[str, ...]:
    types = getattr(kind, "get_fields_and_field_types", None)
    return tuple(types()) if types is not None else ()


def _fields(message: Any) -> Sequence[str]:
    return _fields_of(cast(Hashable, type(message))) or [
        name for name in getattr(message, "__dict__", {}) if not name.startswith("_")
    ]


def labels_of(parent: Any, field: str, items: Any) -> list[str] | None:
    """Names of the elements of a sequence by their message; None where it has none, so that they are counted.

    Args:
        parent: the message that holds it.
        field: name of the sequence.
        items: the sequence.
    """
    if not len(items):
        return None
    for labels in _candidates(parent, field, items):
        names = distinct(labels)
        if names is not None:
            return names
    return None


def _candidates(parent: Any, field: str, items: Any) -> Iterator[Sequence[Any]]:
    """What may name the elements of a sequence, the likeliest first."""
    if parent is not None and not _is_sequence(parent):
        texts, numbers = [], []
        for name in _fields(parent):
            other = getattr(parent, name)
            if name == field or not _is_sequence(other) or len(other) != len(items):
                continue
            if all(isinstance(item, str) for item in other):
                texts.append(name)
            elif isinstance(other[0], int | np.integer):
                numbers.append(name)
        for name in naming_sequences(texts, numbers):
            yield getattr(parent, name)
    for name in label_fields(_fields(items[0])):
        labels = [getattr(item, name) for item in items]
        if all(isinstance(label, str | int | np.integer) for label in labels):
            yield labels


_ARRAY = re.compile(r"sequence<(?P<inner>[^,>]+)(, *\d+)?>$|(?P<element>.+)\[\d*\]$")
_NO_NUMBER = re.compile(r"(w?string|boolean|octet)(<.*>)?$")


def what_a_type_lacks(path: str, kind: str, fields_of: Callable[[str], Mapping[str, str]]) -> str:
    """A clause on why no message of a type has a number at a path; empty where one may.

    Args:
        path: as :class:`NamedField` takes it.
        kind: message type, ``package/msg/Name``.
        fields_of: gives the types of the fields of a message type, as ``get_fields_and_field_types`` does.
    """
    return _lack(path.split("."), kind, fields_of)


def _lack(parts: Sequence[str], kind: str, fields_of: Callable[[str], Mapping[str, str]]) -> str:
    fields = fields_of(kind)
    if set(fields) == {"key", "value"} and not parts:
        return ""
    if not parts or parts[0] not in fields:
        what = f"no field '{parts[0]}'" if parts else "no number of its own"
        return f"{kind} has {what}; it has {', '.join(fields)}"
    name, left = parts[0], parts[1:]
    described = fields[name]
    array = _ARRAY.match(described)
    if array is None:
        if "/" in described:
            return _lack(left, _full(described), fields_of)
        if left or _NO_NUMBER.match(described):
            why = f"has no '{left[0]}'" if left else "is not a number"
            return f"field '{name}' of {kind} is a {described} and {why}"
        return ""
    element = array["inner"] or array["element"]
    if not left:
        return f"field '{name}' of {kind} is an array; name one of its elements, such as {name}.1 or {name}.joint_name"
    if "/" not in element:
        return f"field '{name}' of {kind} is an array of texts" if _NO_NUMBER.match(element) else ""
    lacks = [_lack(left[length:], _full(element), fields_of) for length in range(1, len(left) + 1)]
    return "" if "" in lacks else lacks[0]


def _full(kind: str) -> str:
    package, _, name = kind.rpartition("/")
    return f"{package.removesuffix('/msg')}/msg/{name}"
