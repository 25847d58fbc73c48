"""One notation of numbers for people, on pages, in consoles and in the sentences of JSON files."""

from __future__ import annotations

import math
from collections.abc import Iterable

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_MOST_DECIMALS = 3


def power_of_ten(exponent: int) -> str:
    """``10⁻³`` for -3, empty for 0."""
    return "" if exponent == 0 else "10" + str(exponent).translate(_SUPERSCRIPT)


def plain(value: float, decimals: int) -> str:
    """Fixed-point text with a true minus sign; an em dash for a value that is not finite."""
    # Adding 0 takes the sign from a zero.
    return f"{round(value, decimals) + 0.0:.{decimals}f}".replace("-", "−") if math.isfinite(value) else "—"


def significant(value: float, digits: int = 4) -> str:
    """Text with a number of significant digits, as ``9.1·10⁻⁵``; an em dash for a value that is not finite.

    Whole numbers below ten thousand stand in full, whatever the number of digits: ``10``, not ``1·10¹``.
    """
    if not math.isfinite(value):
        return "—"
    text = f"{value:.{digits}g}"
    if "e+" in text and abs(float(text)) < 1e4:
        return plain(float(text), 0)
    mantissa, _, exponent = text.replace("-", "−").partition("e")
    return f"{mantissa}·{power_of_ten(int(exponent.replace('−', '-')))}" if exponent else mantissa


_SMALLER = {
    "kg": ((1e-4, 1e6, "mg"), (0.1, 1e3, "g")),
    "m": ((1e-5, 1e6, "µm"), (0.01, 1e3, "mm")),
    "s": ((1e-4, 1e6, "µs"), (0.1, 1e3, "ms")),
}
"""Units of small values: below which size, factor, unit."""


def value_text(value: float, std: float, unit: str = "") -> str:
    """``(2.00 ± 0.27)·10⁶ N/m³``: two digits of the uncertainty, a common power of ten where it saves zeros.

    Small masses, lengths and times are in g, mm, ms and so on.
    """
    if not math.isfinite(value):
        return "—"
    known = math.isfinite(std) and std > 0.0
    size = max(abs(value), std) if known else abs(value)
    for largest, factor, smaller in _SMALLER.get(unit, ()):
        if 0.0 < size < largest:
            return value_text(value * factor, std * factor, smaller)
    tail = "" if unit in ("", "1") else f" {unit}"
    exponent = math.floor(math.log10(size)) if size > 0.0 else 0
    exponent = 0 if -3 <= exponent < 5 else 3 * math.floor(exponent / 3)
    scale = 10.0**exponent
    if not known:
        return significant(value / scale, 5) + (f"·{power_of_ten(exponent)}" if exponent else "") + tail
    decimals = max(0, min(9, 1 - math.floor(math.log10(std / scale))))
    text = f"{plain(value / scale, decimals)} ± {plain(std / scale, decimals)}"
    return (f"({text})·{power_of_ten(exponent)}" if exponent else text) + tail


def level_list(indices: Iterable[int]) -> str:
    """``levels 1, 3 and 21 to 40`` for indices from 0 on; ``no level`` without any."""
    numbers = sorted({index + 1 for index in indices})
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    texts = [
        text
        for first, last in runs
        for text in ([f"{first} to {last}"] if last - first > 1 else map(str, range(first, last + 1)))
    ]
    if not texts:
        return "no level"
    head = ", ".join(texts[:-1])
    return f"level{'s' if len(numbers) > 1 else ''} {f'{head} and ' if head else ''}{texts[-1]}"


def percent(share: float, digits: int = 0) -> str:
    """A share as percent; an em dash where it is not known."""
    return f"{plain(100.0 * share, digits)} %" if math.isfinite(share) else "—"


def share_with_interval(value: float, low: float, high: float) -> tuple[str, str]:
    """A share and its interval in percent, with as many decimals as the ends need to differ: ``92 %``, ``89 to 94 %``.

    Args:
        value: the share.
        low: lower end of the interval; NaN = not known.
        high: upper end.

    Returns:
        Text of the share; text of the interval, empty where it is not known or its ends do not differ in a thousandth
        of a percent.
    """
    if not (math.isfinite(low) and math.isfinite(high)):
        return percent(value), ""
    for digits in range(_MOST_DECIMALS + 1):
        ends = percent(low, digits), percent(high, digits)
        if ends[0] != ends[1]:
            return percent(value, digits), f"{ends[0][:-2]} to {ends[1]}"
    return percent(value), ""
