"""Numbers for people: common power of ten for a column, value ± standard uncertainty, durations, sizes."""

from __future__ import annotations

import math
from collections.abc import Iterable

from nmt_core.text.number_words import plain, power_of_ten, significant

__all__ = [
    "concise",
    "decimals_of",
    "duration",
    "engineering_exponent",
    "file_size",
    "plain",
    "power_of_ten",
    "significant",
    "uncertain",
]

_NARROW_SPACE = "\u202f"


def engineering_exponent(values: Iterable[float]) -> int:
    """Exponent, a multiple of 3, that brings the largest finite magnitude into [1, 1000); 0 if none."""
    largest = max((abs(v) for v in values if math.isfinite(v)), default=0.0)
    return 3 * math.floor(math.log10(largest) / 3.0) if largest > 0.0 else 0


def decimals_of(std: float, digits: int = 2) -> int | None:
    """Decimal places that show ``std`` with ``digits`` significant digits; None if ``std`` is not usable."""
    if not math.isfinite(std) or std <= 0.0:
        return None
    return max(0, min(12, digits - 1 - math.floor(math.log10(std))))


def uncertain(value: float, std: float, fallback_decimals: int = 4, most_decimals: int = 6) -> str:
    """``value ± std`` rounded to two significant digits of the standard uncertainty.

    Args:
        value: the value in the unit to print.
        std: its standard uncertainty in the same unit; NaN or 0 = not known.
        fallback_decimals: decimal places without an uncertainty.
        most_decimals: limit; a smaller uncertainty is printed with a power of ten.

    Returns:
        The text; an em dash for a value that is not finite.
    """
    if not math.isfinite(value):
        return "—"
    decimals = decimals_of(std)
    if decimals is None:
        return plain(value, fallback_decimals)
    if decimals > most_decimals and std < 0.5 * 10.0**-most_decimals:
        return f"{plain(value, most_decimals)} ± {significant(std, 1)}"
    decimals = min(decimals, most_decimals)
    return f"{plain(value, decimals)} ± {std:.{decimals}f}"


def concise(value: float, std: float, fallback_decimals: int = 4, most_decimals: int = 6) -> str:
    """``1.2345(67)``: the value, and in brackets its standard uncertainty in units of the last digits.

    Arguments as for :func:`uncertain`.
    """
    value_text, _, std_text = uncertain(value, std, fallback_decimals, most_decimals).partition(" ± ")
    if not std_text:
        return value_text
    if "·" in std_text:
        return f"{value_text}(<1)"
    whole, _, fraction = std_text.partition(".")
    digits = fraction.lstrip("0") if whole == "0" else std_text
    return f"{value_text}({digits or '0'})"


def duration(seconds: float) -> str:
    """``12.3 s``, ``4 min 05 s`` or ``1 h 02 min``."""
    if not math.isfinite(seconds):
        return "—"
    if seconds < 60.0:
        return f"{seconds:.1f}{_NARROW_SPACE}s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes}{_NARROW_SPACE}min {rest:02d}{_NARROW_SPACE}s"
    return f"{minutes // 60}{_NARROW_SPACE}h {minutes % 60:02d}{_NARROW_SPACE}min"


def file_size(count: int) -> str:
    """Size of a file in B, kB, MB or GB (powers of 1000)."""
    size = float(count)
    for unit in ("B", "kB", "MB"):
        if size < 1000.0:
            return f"{size:.0f}{_NARROW_SPACE}{unit}" if unit == "B" else f"{size:.1f}{_NARROW_SPACE}{unit}"
        size /= 1000.0
    return f"{size:.2f}{_NARROW_SPACE}GB"
