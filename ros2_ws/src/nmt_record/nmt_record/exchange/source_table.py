"""Columns of numbers as they are in a file, with what the file itself says of them."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_record.exchange.unit_table import is_known_unit

_UNIT_BEHIND = (
    re.compile(r"(.+?)\s+/\s*(\S.*)$"),
    re.compile(r"(t|time|zeit|f|freq\w*)/(\S+)$", re.I),
    re.compile(r"(.+?)\s+in\s+(\S+)$"),
    re.compile(r"(.+?)\s*,\s*(\S+)$"),
)
_OPENING = {"]": "[", ")": "(", "}": "{"}


class ClockQuestionError(BenchError):
    """What the sidecar must say of the clock.

    Attributes:
        key: of the sidecar.
    """

    def __init__(self, sentence: str, key: str) -> None:
        super().__init__(sentence)
        self.key = key


@dataclass(frozen=True)
class Scaling:
    """What the file says its numbers must undergo before their unit applies: ``sign (scale (value - zero) + offset)``.

    Attributes:
        scale: factor.
        zero: number that stands for nothing, in counts.
        offset: added after the factor.
        sign: −1 where the direction of the sensor is negative.
        words: who says it, for messages.
    """

    scale: float = 1.0
    zero: float = 0.0
    offset: float = 0.0
    sign: int = 1
    words: str = ""

    @property
    def has_scale(self) -> bool:
        """Whether anything but a sign is stated."""
        return (self.scale, self.zero, self.offset) != (1.0, 0.0, 0.0)


AS_IT_IS = Scaling()


@dataclass(eq=False)
class SourceTable:
    """Columns as they are in the file.

    Attributes:
        file: name of the file, for messages.
        names: of the columns; empty where they have none.
        columns: numbers, NaN where the file has none; all of one length.
        units: what the file itself says, empty if nothing.
        quantities: what the file itself says, ``UNKNOWN`` if nothing.
        notes: sentences on what was fixed.
        start: abscissa of the first row, if the file states an even one.
        step: its increment.
        step_std: relative standard uncertainty of it, where its digits do not tell.
        abscissa: the file's uneven abscissa (UFF).
        sample_rate: what the file itself says (NPZ), Hz.
        lines: line of each row in the file; None = not a text file.
        breaks: rows before which the header was repeated.
        stamps: columns that were written as dates or times of day; they hold seconds.
        constants: single numbers next to the columns (MATLAB).
        scalings: what the file says of the scale and the sign of each column.
        points: of each column by the file; 0 = not stated, −1 = to be asked.
        parts: columns that are no channels: dates and fractions of a stamp, numbers of the rows.
        judged: words for the clock that its reader has judged already (a bag); no column is another one.
        question: what the sidecar must say of that clock: sentence and key; None = it is clear.
        fields: bare names of columns whose names hold what somebody called a thing, for what they mean.
        stretches: first row and row after the last one of each stretch, where recording paused.
    """

    file: str
    names: tuple[str, ...]
    columns: tuple[FloatArray, ...]
    units: tuple[str, ...] = ()
    quantities: tuple[Quantity, ...] = ()
    notes: list[str] = field(default_factory=list)
    start: float | None = None
    step: float | None = None
    step_std: float = 0.0
    abscissa: FloatArray | None = None
    sample_rate: float | None = None
    lines: Callable[[int], int] | None = None
    breaks: tuple[int, ...] = ()
    stamps: tuple[int, ...] = ()
    constants: dict[str, float] = field(default_factory=dict)
    scalings: tuple[Scaling, ...] = ()
    points: tuple[int, ...] = ()
    parts: tuple[int, ...] = ()
    judged: str = ""
    question: tuple[str, str] | None = None
    fields: tuple[str, ...] = ()
    stretches: tuple[tuple[int, int], ...] = ()

    def __post_init__(self) -> None:
        self.units = self.units or ("",) * len(self.columns)
        self.quantities = self.quantities or (Quantity.UNKNOWN,) * len(self.columns)
        self.points = self.points or (0,) * len(self.columns)
        self.scalings = self.scalings or (AS_IT_IS,) * len(self.columns)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return int(self.columns[0].shape[0])

    def recorded(self, column: FloatArray) -> FloatArray:
        """A column without the rows of pauses between stretches."""
        if len(self.stretches) < 2:
            return column
        return np.concatenate([column[first:stop] for first, stop in self.stretches])

    def place(self, row: int) -> str:
        """Where a row is, for messages."""
        return f"line {self.lines(row)} of {self.file}" if self.lines else f"sample {row} of {self.file}"

    def index(self, column: str | int, where: str) -> int:
        """Position of a column given by name or by number from 1.

        Raises:
            BenchError: there is none, or more than one of that name.
        """
        if isinstance(column, int):
            if not 1 <= column <= len(self.columns):
                raise BenchError(
                    f"{where}: {self.file} has {len(self.columns)} columns, so there is no column {column}."
                )
            return column - 1
        for candidates in (self.names, tuple(split_name(name)[0] for name in self.names)):
            found = [index for index, name in enumerate(candidates) if name == column]
            if len(found) > 1:
                raise BenchError(
                    f"{where}: {self.file} has {len(found)} columns named {column} (numbers "
                    f"{', '.join(str(i + 1) for i in found)}); give the number of the one that is meant."
                )
            if found:
                return found[0]
        named = [name for name in self.names if name]
        has = (
            ", ".join(named[:20]) + (", …" if len(named) > 20 else "") if named else "no names, so give numbers from 1"
        )
        raise BenchError(f"{where}: {self.file} has no column {column}; it has {has}.")

    def reversed(self) -> SourceTable:
        """The same with the last row first."""
        last, line_of = self.rows - 1, self.lines
        return dataclasses.replace(
            self,
            columns=tuple(np.ascontiguousarray(column[::-1]) for column in self.columns),
            lines=None if line_of is None else lambda row: line_of(last - row),
            breaks=tuple(sorted(self.rows - row for row in self.breaks)),
        )


def split_name(name: str) -> tuple[str, str]:
    """Name of a column and the unit that its heading states, empty if there is none.

    Units stand in brackets behind the name, or, as far as they are known ones, behind a slash (``a / m/s²``), a comma
    or the word *in*.
    """
    text = name.strip()
    if text and text[-1] in _OPENING and (begin := _bracket(text)) > 0:
        return re.sub(r"\s+/$", "", text[:begin].rstrip()), text[begin + 1 : -1].strip()
    for pattern in _UNIT_BEHIND:
        match = pattern.match(text)
        if match and is_known_unit(match[2]):
            return match[1].strip(), match[2].strip()
    return name, ""


_ORDER_NUMBER = r"(?P<{}>\d{{1,3}}(?:[.,]\d{{1,3}})?)"
_ORDER = re.compile(
    rf"\b(?:order|ordnung|ord)[ _.:=-]*{_ORDER_NUMBER.format('behind')}(?![\d])"
    rf"|(?<![\d.,A-Za-z]){_ORDER_NUMBER.format('before')}(?:\.|st|nd|rd|th)?[ _-]*(?:order|ordnung|ord)(?![a-z])"
    rf"|(?<![\d.,A-Za-z]){_ORDER_NUMBER.format('times')} ?[x×](?![A-Za-z\d])",
    re.I,
)


def split_order(name: str) -> tuple[str, float | None]:
    """Name of a column without the order of a rotation that it names, and that order; None where it names none."""
    found = _ORDER.search(name.replace("_", " "))
    if found is None:
        return name, None
    number = float((found["behind"] or found["before"] or found["times"]).replace(",", "."))
    return (name[: found.start()] + name[found.end() :]).strip(" _-.,:"), number if number > 0.0 else None


def _bracket(text: str) -> int:
    """Where the bracket that ends a text was opened; −1 if nowhere."""
    depth: list[str] = []
    for place in range(len(text) - 1, -1, -1):
        letter = text[place]
        if letter in _OPENING:
            depth.append(_OPENING[letter])
        elif depth and letter == depth[-1]:
            depth.pop()
            if not depth:
                return place
    return -1
