"""Dates and times of day in the columns of a text, and what turns them into seconds."""

from __future__ import annotations

import datetime
import re
from collections.abc import Callable, Sequence
from decimal import Decimal

from nmt_core.errors import BenchError
from nmt_record.exchange.unit_table import TIME_UNITS, other_factor, plain_unit

_DATE = r"\d{1,4}[-./]\d{1,2}[-./]\d{1,4}|\d{1,2}[- ][A-Za-z]{3,4}[- .]\d{2,4}"
_CLOCK = (
    r"(?:(?P<hour>\d{1,2}):)?(?P<minute>\d{1,2}):(?P<second>\d{2})(?:[.,:](?P<part>\d+))?"
    r"\s*(?P<half>[AaPp]\.?[Mm]\.?)?\s*(?P<zone>Z|UTC|[-+]\d{2}:?\d{2})?$"
)
_STAMP = re.compile(rf"(?:(?P<date>{_DATE})[T_ ]\s*)?{_CLOCK}")
_DURATION = re.compile(r"(?P<number>[-+]?\d+(?:[.,]\d*)?(?:[eE][-+]?\d+)?)\s*(?P<unit>[mµun]?s|[a-z]{2,12}|h|d)$")
"""As MATLAB writes it: 0.002 sec."""
_DATE_ALONE = re.compile(rf"(?:{_DATE})$")
_DATE_AND_TIME = re.compile(r"(\d{4}-\d{2}-\d{2}|\d{2}\.\d{2}\.\d{4}|\d{1,2}/\d{1,2}/\d{4}) +(?=\d{1,2}:\d{2}:\d{2})")
_TIME_AND_HALF = re.compile(r"(:\d{2}(?:[.,:]\d+)?) +([AaPp]\.?[Mm]\b)")
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")


def joined_stamps(text: str) -> str:
    """A text in which date, time of day and AM or PM of a stamp are not parted by spaces."""
    if ":" not in text[:65536]:
        return text
    return _TIME_AND_HALF.sub(r"\1\2", _DATE_AND_TIME.sub(r"\1T", text))


def _duration(cell: str) -> str | None:
    """Seconds of a number with its unit of time, with all its digits; None if the cell is none."""
    found = _DURATION.match(cell)
    unit = plain_unit(found["unit"]) if found is not None else ""
    if found is None or unit not in TIME_UNITS:
        return None
    return format(Decimal(found["number"].replace(",", ".")) * Decimal(repr(other_factor("time", unit, cell))), "f")


def is_stamp(cell: str) -> bool:
    """Whether a cell is a time of day, with a date or without, mm:ss only with fractions of a second, or a duration."""
    if ":" not in cell:
        return cell[:1].isdigit() and _duration(cell) is not None
    found = _STAMP.match(cell)
    return found is not None and (found["hour"] is not None or found["part"] is not None)


def is_date(cell: str) -> bool:
    """Whether a cell is a date alone."""
    return _DATE_ALONE.match(cell) is not None


def has_date(cell: str) -> bool:
    """Whether a stamp has a date."""
    found = _STAMP.match(cell)
    return found is not None and found["date"] is not None


class StampReader:
    """Seconds of the stamps of one file.

    Args:
        name: of the file, for messages.
        line_of: line of each row.
    """

    def __init__(self, name: str, line_of: Callable[[int], int]) -> None:
        self._name, self._line_of = name, line_of
        self._zone: str | None = None
        self._days: dict[str, int] = {}

    def seconds(self, cell: str, row: int, date: str = "") -> str | None:
        """Seconds as a text with all digits of the stamp; None if it is none.

        Args:
            cell: the stamp.
            row: of it.
            date: of it, where that stands in a column of its own.

        Raises:
            BenchError: its zone differs from the first one's.
        """
        found = _STAMP.match(cell)
        if found is None:
            return _duration(cell)
        zone = found["zone"] or ""
        self._zone = zone if self._zone is None else self._zone
        if zone != self._zone:
            raise BenchError(
                f"{self._name} line {self._line_of(row)}: the time zone changes from '{self._zone or 'none'}' to "
                f"'{zone or 'none'}'; write all stamps in one zone."
            )
        hour = int(found["hour"] or 0)
        if found["half"]:
            hour = hour % 12 + (12 if found["half"][0] in "Pp" else 0)
        minutes = self._day(found["date"] or date) * 86400 + hour * 3600 + int(found["minute"]) * 60
        return f"{minutes + int(found['second'])}.{found['part'] or '0'}"

    def _day(self, date: str) -> int:
        """Number of a date, from the first of the file on; one that cannot be told counts as the next one where it
        changes."""
        if date not in self._days:
            number = _ordinal(date)
            if number is None:
                self._days[date] = max(self._days.values(), default=-1) + 1
            else:
                self._days.setdefault("first", number)
                self._days[date] = number - self._days["first"]
        return self._days[date]


def _ordinal(date: str) -> int | None:
    plain = re.fullmatch(r"(\d{4})[-/.](\d{1,2})[-/.](\d{1,2})", date)
    behind = re.fullmatch(r"(\d{1,2})\.(\d{1,2})\.(\d{4})", date)
    named = re.fullmatch(r"(\d{1,2})[- ]([A-Za-z]{3,4})[- .](\d{2,4})", date)
    if named and named[2][:3].lower() in _MONTHS:
        year = int(named[3]) + (2000 if len(named[3]) == 2 else 0)
        parts: tuple[int, ...] | None = (year, _MONTHS.index(named[2][:3].lower()) + 1, int(named[1]))
    elif plain or behind:
        parts = tuple(map(int, plain.groups() if plain else behind.groups()[::-1] if behind else ()))
    else:
        parts = None
    try:
        return None if parts is None else datetime.date(*parts).toordinal()
    except ValueError:
        return None


def date_columns(cells: Sequence[str]) -> dict[int, int]:
    """Column of a date for each column of times of day without one, in a row of cells."""
    dates = [i for i, cell in enumerate(cells) if is_date(cell)]
    times = [i for i, cell in enumerate(cells) if is_stamp(cell) and not has_date(cell)]
    if len(dates) != 1:
        return {}
    return dict.fromkeys(times, dates[0])
