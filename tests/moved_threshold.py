"""A threshold of the diagnosis at another value."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from nmt_core.threshold import thresholds_of
from nmt_diagnose.thresholds import THRESHOLDS


@contextmanager
def moved_threshold(path: str, value: Any) -> Iterator[None]:
    """The threshold of a dotted path, such as ``fits.most_steps``, at another value."""
    (record, name) = next((record, entry.name) for known, record, entry in thresholds_of(THRESHOLDS) if known == path)
    before = getattr(record, name)
    object.__setattr__(record, name, value)
    try:
        yield
    finally:
        object.__setattr__(record, name, before)
