"""Fields of records of thresholds: a value with its unit, its reason, and the test that fails when it moves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import Field, field, fields, is_dataclass
from typing import Any, TypeVar

T = TypeVar("T")


def threshold(value: T, unit: str, reason: str, test: str) -> T:
    """A field of a frozen dataclass of thresholds.

    Args:
        value: the threshold.
        unit: its unit; "1" = a number or a ratio, "σ" = standard deviations of the noise.
        reason: why it is as large as that.
        test: node of the test that fails when the value moves, from the root of the repository.
    """
    return field(default=value, metadata={"unit": unit, "reason": reason, "test": test})


def thresholds_of(record: Any, path: str = "") -> Iterator[tuple[str, Any, Field[Any]]]:
    """Dotted path, record that holds it, and field of every threshold of a record and of the records within it.

    Args:
        record: an instance of a dataclass.
        path: of the record.
    """
    for entry in fields(record):
        value = getattr(record, entry.name)
        name = f"{path}.{entry.name}" if path else entry.name
        if is_dataclass(value):
            yield from thresholds_of(value, name)
        else:
            yield name, record, entry
