"""A threshold of the diagnosis at another value: in a test, or in a whole run of pytest (``-p moved_threshold``)."""

from __future__ import annotations

import ast
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from nmt_core.threshold import thresholds_of
from nmt_diagnose.thresholds import THRESHOLDS

MOVED = "NMT_MOVED_THRESHOLD"
"""Variable of the environment: dotted path, ``=`` and value."""


def set_threshold(path: str, value: Any) -> Any:
    """Put a threshold, such as ``fits.most_steps``, to another value; gives the one before."""
    (record, name) = next((record, entry.name) for known, record, entry in thresholds_of(THRESHOLDS) if known == path)
    before = getattr(record, name)
    object.__setattr__(record, name, value)
    return before


@contextmanager
def moved_threshold(path: str, value: Any) -> Iterator[None]:
    """A threshold at another value."""
    before = set_threshold(path, value)
    try:
        yield
    finally:
        set_threshold(path, before)


def moves(value: Any) -> list[Any]:
    """Values by which a threshold is moved: twice, half, ten times and a tenth; of whole numbers the next ones."""
    if isinstance(value, int):
        return [value // 2, 2 * value + 1, 8 * value]
    if isinstance(value, float):
        return [2.0 * value, 0.5 * value, 10.0 * value, 0.1 * value]
    return [tuple(2 * item for item in value), value[:1], tuple(type(item)(0.25 * item) for item in value)]


def pytest_configure() -> None:
    """Move the threshold that the environment names."""
    path, _, value = os.environ.get(MOVED, "").partition("=")
    if path:
        set_threshold(path, ast.literal_eval(value))
