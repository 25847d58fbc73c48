"""What the lines above the numbers of a text say: names, units, clock, scale of counts."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation

from nmt_core.errors import BenchError
from nmt_record.exchange.source_table import Scaling, split_name
from nmt_record.exchange.text.text_form import TextForm
from nmt_record.exchange.unit_table import is_known_unit, plain_unit

_STAMP = re.compile(r"\d[-./:]\d")  # a date or a time of day is not a unit
_HEAD_NUMBER = r"(?:\s*[\[(]\s*(?P<before>[^\])]*)[\])])?[\s:=;,\"]*(?P<number>\d[\d.,]*(?:[eE][-+]?\d+)?)\s*[;,\"]?\s*"
_HEAD_RATE = re.compile(rf"(?:sampl\w*[ _-]*(?:rate|freq\w*)|abtastrate|\bfs\b){_HEAD_NUMBER}(?P<after>[kM]?Hz)?", re.I)
_HEAD_STEP = re.compile(
    r"(?:sampl\w*[ _-]*(?:interval|period|time)|time[ _-]*(?:step|increment)|delta[ _-]?[tx]|\bdt\b)"
    rf"{_HEAD_NUMBER}(?P<after>ms|us|µs|ns|s)?\b",
    re.I,
)
_SIGNED = r"[\s:=;,\"]*(?P<number>[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?)\s*(?P<unit>[^\s;,\"]*)"
_SCALE = re.compile(
    rf"(?:\bscale(?:[ _-]*factor)?|\bresolution|\blsb(?:[ _-]*(?:size|value))?|\bcalibration[ _-]*factor)"
    rf"(?:\s*[\[(](?P<before>[^\])]*)[\])])?{_SIGNED}",
    re.I,
)
_OFFSET = re.compile(rf"\b(?:zero[ _-]*)?offset(?:\s*[\[(](?P<before>[^\])]*)[\])])?{_SIGNED}", re.I)
_PER_COUNT = re.compile(r"(.+?)\s*(?:/|per\s*)\s*(?:counts?|lsb|bits?|digits?)$", re.I)
_COUNTS = re.compile(r"(?:counts?|lsb|bits?|digits?)$", re.I)
# Powers of ten.
_HEAD_UNITS = {"hz": 0, "khz": 3, "mhz": 6, "s": 0, "sec": 0, "ms": -3, "us": -6, "µs": -6, "ns": -9}
# Without a unit, what is not a likely rate or step in Hz or s is one in another unit.
_LEAST_RATE, LARGEST_STEP = 200.0, 0.05
_SCOPE_STEP = re.compile(r"(?:x?[ _-]?increment|t[ _-]?inc|delta[ _-]?[tx]|dt)$", re.I)
_SCOPE_START = re.compile(r"(?:x?[ _-]?(?:start|origin)|t[ _-]?0|t[ _-]?start)$", re.I)
_NUMBERS_OF_ROWS = re.compile(r"(?:sequence|sample|index|point|no|nr|number|x|#)s?\.?$", re.I)


@dataclass
class Heading:
    """Names and units of the columns, and what stands next to them.

    Attributes:
        names, units: of each column.
        step, start: of an oscilloscope's clock that stands in columns of its own, s; None if it does not.
        empty: columns that hold only such a clock.
        counter: column that numbers the rows; −1 if none.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    step: float | None = None
    start: float | None = None
    empty: tuple[int, ...] = ()
    counter: int = -1


def clock_of_heading(lines: Sequence[str]) -> tuple[float | None, float | None]:
    """Sampling rate (Hz) and step (s) that the lines above the numbers state; None if none does, or several."""
    found: tuple[list[float], list[float]] = ([], [])
    for line in lines:
        for numbers, pattern in zip(found, (_HEAD_RATE, _HEAD_STEP), strict=True):
            match = pattern.search(line)
            value = None if match is None else _stated_number(match)
            likely = value is not None and (value >= _LEAST_RATE if numbers is found[0] else value <= LARGEST_STEP)
            if match is not None and value is not None and (likely or match["before"] or match["after"]):
                numbers.append(value)
            if match is not None:
                break
    rate, step = (numbers[0] if len(set(numbers)) == 1 and numbers[0] > 0.0 else None for numbers in found)
    return rate, step


def _stated_number(match: re.Match[str]) -> float | None:
    """A number with its unit in Hz or s; None where a comma may be one of thousands or the unit is not known."""
    text, unit = match["number"].rstrip(".,"), (match["before"] or match["after"] or "").strip().lower()
    if re.fullmatch(r"\d{1,3}([.,]\d{3})+", text) or (unit and unit not in _HEAD_UNITS):
        return None
    try:
        # By the decimal power, so that its digits stay those of the file.
        return float(Decimal(text.replace(",", ".")).scaleb(_HEAD_UNITS.get(unit, 0)))
    except InvalidOperation:
        return None


def scaling_of_heading(lines: Sequence[str], name: str) -> tuple[Scaling, str] | None:
    """Scale and offset of counts that the lines above the numbers state once, and the unit behind them."""
    scales = [match for line in lines if (match := _SCALE.search(line))]
    offsets = [match for line in lines if (match := _OFFSET.search(line))]
    if len(scales) != 1 or len(offsets) > 1 or not float(scales[0]["number"]) > 0.0:
        return None
    unit = (scales[0]["before"] or scales[0]["unit"]).strip()
    counted = _PER_COUNT.match(unit)
    if counted is None or not is_known_unit(counted[1]):
        return None
    zero = offset = 0.0
    if offsets:
        counted_in = (offsets[0]["before"] or offsets[0]["unit"]).strip()
        if _COUNTS.match(counted_in):
            zero = float(offsets[0]["number"])
        elif plain_unit(counted_in) == plain_unit(counted[1]):
            offset = float(offsets[0]["number"])
        else:
            return None
    scale = float(scales[0]["number"])
    return Scaling(scale, zero, offset, words=f"the heading of {name}"), counted[1].strip()


def heading_of(heads: list[list[str]], width: int, form: TextForm, name: str, notes: list[str]) -> Heading:
    """Names and units of the columns by the lines above the numbers.

    Raises:
        BenchError: as many names as columns are not there.
    """
    # Empty cells at the end of a heading are no columns.
    trimmed = [cells[:width] if len(cells) > width and not any(cells[width:]) else cells for cells in heads[-3:]]
    fitting = [cells for cells in trimmed if len(cells) == width]
    if heads and not fitting and len(heads[-1]) > 1:
        hint = ""
        if form.delimiter == "," and len(heads[-1]) * 2 >= width > len(heads[-1]):
            hint = " (decimal commas in a comma-separated file? save it with ; as separator or with decimal points)"
        raise BenchError(f"{name} has {len(heads[-1])} column names but {width} values in its first row{hint}.")
    if not fitting:
        return Heading(("",) * width, ("",) * width)
    scope = _scope_heading(fitting, form)
    if scope is not None:
        return scope
    titles = len(fitting) - 1
    if len(fitting) > 1 and (all(map(_is_unit, fitting[-1])) or not all(fitting[-1])):
        titles -= 1
    names, units = list(fitting[titles]), ["" if _STAMP.search(split_name(cell)[1]) else split_name(cell)[1]
                                           for cell in fitting[titles]]  # fmt: skip
    for below in fitting[titles + 1 :]:
        if all(map(_is_unit, below)):
            units = [cell.strip("[](){} ") or unit for cell, unit in zip(below, units, strict=True)]
            notes.append(
                f"The second line of the heading of {name} was read as units ({', '.join(filter(None, units))})."
            )
            continue
        labels, present = [], ""
        for cell in below:
            present = re.sub(r"[\[({].*", "", cell).strip(" :") if cell else present
            labels.append(present)
        names = [f"{split_name(title)[0]} {label}".strip() for title, label in zip(names, labels, strict=True)]
        listed = ", ".join(dict.fromkeys(filter(None, labels)))
        notes.append(f"The second line of the heading of {name} was read as what the columns belong to ({listed}).")
    return Heading(tuple(names), tuple(units))


def _is_unit(cell: str) -> bool:
    plain = plain_unit(cell.strip("[](){} "))
    return not plain or plain == "1" or is_known_unit(plain)


def _scope_heading(fitting: list[list[str]], form: TextForm) -> Heading | None:
    """Heading of an oscilloscope's table: names, and below them units with the clock in the places of its names."""
    if len(fitting) < 2:
        return None
    titles, below = fitting[-2], fitting[-1]
    stated = {i: float(form.plain(cell)) for i, cell in enumerate(below) if form.is_number(cell)}
    steps = [value for i, value in stated.items() if _SCOPE_STEP.match(titles[i])]
    starts = [value for i, value in stated.items() if _SCOPE_START.match(titles[i])]
    if len(steps) != 1 or not steps[0] > 0.0:
        return None
    units = tuple(cell if i not in stated and is_known_unit(cell) else "" for i, cell in enumerate(below))
    numbered = [i for i, title in enumerate(titles) if _NUMBERS_OF_ROWS.match(title) and i not in stated]
    return Heading(
        tuple(titles), units, steps[0], starts[0] if starts else 0.0,
        tuple(i for i, title in enumerate(titles) if i in stated or not title), numbered[0] if numbered else -1,
    )  # fmt: skip
