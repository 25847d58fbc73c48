"""Plans of excitation levels: parsing, spacing and direction."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np

from nmt_core.errors import BenchError

DIRECTIONS = ("up", "down", "both")
SPACINGS = ("geometric", "linear")
MAX_LEVELS = 1000

_DECIMAL_COMMA = re.compile(r"(?<![\d.])0,\d|\d,\d+:|:\d+,\d")
_SYNTAX = "write 'a:b:n' for n levels from a to b in geometric steps, 'a:b:n:linear' for equal steps, or a list 'a,b,c'"


def parse_levels(text: str) -> list[float]:
    """Levels from the command line's notation.

    Args:
        text: ``a:b:n`` (geometric), ``a:b:n:linear``, ``a:b:n:geometric`` or ``a,b,c``.

    Returns:
        Levels in the order given, in the unit of the test (volts unless the rig says otherwise).

    Raises:
        BenchError: the text is not a plan, or a level is not positive and finite.
    """
    where = f"Levels '{text}'"
    if _DECIMAL_COMMA.search(text):
        raise BenchError(
            f"{where}: decimals have a point, as in 0.5; a comma separates levels, and none of them is zero."
        )
    if ":" in text:
        parts = [part.strip() for part in text.split(":")]
        if len(parts) not in (3, 4) or (len(parts) == 4 and parts[3] not in SPACINGS):
            raise BenchError(f"{where} are not a plan: {_SYNTAX}.")
        first, last = (_number(part, where) for part in parts[:2])
        # Longer numbers are too large anyway, and some digits ('²') are no decimal ones.
        if not parts[2].isdecimal() or len(parts[2]) > 9 or not 1 <= int(parts[2]) <= MAX_LEVELS:
            raise BenchError(f"{where}: the number of levels must be a whole number from 1 to {MAX_LEVELS}.")
        return spaced_levels(first, last, int(parts[2]), parts[3] if len(parts) == 4 else "geometric")
    levels = [_number(part, where) for part in text.split(",")]
    return check_levels(levels, where)


def _number(text: str, where: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise BenchError(f"{where}: '{text.strip()}' is not a number; {_SYNTAX}.") from None


def spaced_levels(first: float, last: float, count: int, spacing: str = "geometric") -> list[float]:
    """``count`` levels from ``first`` to ``last``, both included exactly.

    Raises:
        BenchError: a level is not positive and finite, or the spacing is unknown.
    """
    check_levels([first, last], "Levels")
    if spacing not in SPACINGS:
        raise BenchError(f"Spacing '{spacing}' is not known; use {' or '.join(SPACINGS)}.")
    if count == 1:
        return [first]
    space = np.geomspace if spacing == "geometric" else np.linspace
    levels = [float(level) for level in space(first, last, count)]
    levels[0], levels[-1] = first, last
    return levels


def check_levels(levels: Sequence[float], where: str) -> list[float]:
    """The levels as a list.

    Raises:
        BenchError: none, too many, or one that is not positive and finite.
    """
    if not levels or len(levels) > MAX_LEVELS:
        raise BenchError(f"{where}: a plan needs 1 to {MAX_LEVELS} levels, got {len(levels)}.")
    for level in levels:
        if not (math.isfinite(level) and level > 0):
            raise BenchError(f"{where}: every level must be positive and finite, got {level}.")
    return list(levels)


def directed(levels: Sequence[float], direction: str) -> list[float]:
    """The plan run up, down, or up and then down again (the turning level once).

    Raises:
        BenchError: unknown direction.
    """
    up = sorted(levels)
    if direction == "up":
        return up
    if direction == "down":
        return up[::-1]
    if direction == "both":
        return up + up[-2::-1]
    raise BenchError(f"Direction '{direction}' is not known; use {', '.join(DIRECTIONS)}.")
