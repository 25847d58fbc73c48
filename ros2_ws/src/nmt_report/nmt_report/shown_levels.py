"""Which levels a figure shows, so that a page of a thousand levels is drawn as fast and read as well as one of ten."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

MOST_CURVES = 24
"""Levels with a curve or bars of their own; more cannot be distinguished."""

MOST_MARKS = 200
"""Levels with marks or hover texts of their own: they are then some 4 points apart on a page."""

MOST_PANELS = 12
"""Levels whose signals have a panel of their own."""

Item = TypeVar("Item")


def spread_evenly(items: Sequence[Item], most: int) -> list[Item]:
    """At most ``most`` items, spread evenly, the first and last among them; ``most`` is 2 or more."""
    if len(items) <= most:
        return list(items)
    # Half of an odd number of steps is rounded up: no item comes twice.
    steps, last = most - 1, len(items) - 1
    return [items[(2 * step * last + steps) // (2 * steps)] for step in range(most)]


def shown_note(shown: int, total: int) -> str:
    """A sentence for the caption with a space before it; empty where all levels are shown."""
    return f" {shown} of {total} levels are shown." if shown < total else ""
