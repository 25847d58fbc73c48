"""Columns of numbers from CSV, NPZ, MATLAB, HDF5, UFF, LVM and TDMS files: what is not certain is refused by line."""

from __future__ import annotations

import datetime
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmt_core.errors import BenchError
from nmt_core.files.hardened import LARGEST_TABLE, open_regular, read_arrays
from nmt_core.files.mat_file import MAT5, is_hdf5, read_mat
from nmt_core.files.universal_file import is_universal_file
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_record.exchange import uff
from nmt_record.exchange.unit_table import plain_unit, quantity_of_unit

LARGEST_DATA = 2**29  # bytes of a file of columns
_MOST_COLUMNS = 64  # of one matrix

_SUFFIXES = {
    ".csv": "csv", ".txt": "csv", ".tsv": "csv", ".dat": "csv", ".asc": "csv",
    ".npz": "npz",
    ".mat": "mat", ".h5": "mat", ".hdf5": "mat",
    ".lvm": "lvm", ".tdms": "tdms",
    ".uff": "uff", ".unv": "uff", ".uf": "uff", ".ufb": "uff", ".58": "uff",
}  # fmt: skip
_FOREIGN = (
    (b"PK\x03\x04", "a zip archive or spreadsheet", "save the table as CSV"),
    (b"\xd0\xcf\x11\xe0", "an old spreadsheet", "save the table as CSV"),
    (b"\x93NUMPY", "a single NumPy array", "save the columns with numpy.savez"),
    (b"\x1f\x8b", "a gzip archive", "unpack it"),
    (b"%PDF", "a PDF", "save the table as CSV"),
)
_MISSING = frozenset({"", "nan", "na", "n/a", "#n/a", "null", "none"})
_NUMBER = {
    ".": re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eEdD][-+]?\d+)?$"),
    ",": re.compile(r"[-+]?(\d+,?\d*|,\d+)([eEdD][-+]?\d+)?$"),
}
_INFINITE = re.compile(r"[-+]?inf(inity)?$", re.I)
_FORMS: tuple[tuple[str | None, str], ...] = (
    (";", "."), (";", ","), ("\t", "."), ("\t", ","), (",", "."), (None, "."), (None, ","),
)  # fmt: skip
_STAMP = re.compile(r"\d[-./:]\d")  # a date or a time of day is no unit
_TIME_OF_DAY = re.compile(
    r"(?:(?P<date>\d{1,4}[-./]\d{1,2}[-./]\d{1,4})[T_ ]\s*)?(?P<hour>\d{1,2}):(?P<minute>\d{2}):(?P<second>\d{2})"
    r"(?:[.,](?P<part>\d+))?\s*(?P<zone>Z|UTC|[-+]\d{2}:?\d{2})?$"
)
_DATE_AND_TIME = re.compile(r"(\d{4}-\d{2}-\d{2}|\d{2}\.\d{2}\.\d{4}) +(?=\d{1,2}:\d{2}:\d{2})")
_HEAD_NUMBER = r"(?:\s*[\[(]\s*(?P<before>[^\])]*)[\])])?[\s:=;,\"]*(?P<number>\d[\d.,]*(?:[eE][-+]?\d+)?)\s*[;,\"]?\s*"
_HEAD_RATE = re.compile(rf"(?:sampl\w*[ _-]*(?:rate|freq\w*)|abtastrate|\bfs\b){_HEAD_NUMBER}(?P<after>[kM]?Hz)?", re.I)
_HEAD_STEP = re.compile(
    r"(?:sampl\w*[ _-]*(?:interval|period|time)|time[ _-]*(?:step|increment)|delta[ _-]?[tx]|\bdt\b)"
    rf"{_HEAD_NUMBER}(?P<after>ms|us|µs|ns|s)?\b",
    re.I,
)
_HEAD_UNITS = {
    "hz": 0,
    "khz": 3,
    "mhz": 6,
    "s": 0,
    "sec": 0,
    "ms": -3,
    "us": -6,
    "µs": -6,
    "ns": -9,
}  # powers of ten
# Without a unit, what is no likely rate or step in Hz or s is one in another unit.
_LEAST_RATE, _LARGEST_STEP = 200.0, 0.05
_UNIT_IN_NAME = re.compile(r"^(.*?)\s*[\[({]\s*([^\[\](){}]*)\s*[\])}]\s*$")


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
        constants: single numbers beside the columns (MATLAB).
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
    judged: str = ""
    question: tuple[str, str] | None = None
    fields: tuple[str, ...] = ()
    stretches: tuple[tuple[int, int], ...] = ()

    def __post_init__(self) -> None:
        self.units = self.units or ("",) * len(self.columns)
        self.quantities = self.quantities or (Quantity.UNKNOWN,) * len(self.columns)

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


def read_table(path: Path, wanted: Sequence[str | int] = ()) -> SourceTable:
    """Read a file of columns by the kind that its name and first bytes say.

    Args:
        path: the file.
        wanted: names of columns that are needed: of a MATLAB or HDF5 file, which may hold arrays of many lengths, those
            as long as they are read; without any, those of the largest set.

    Raises:
        BenchError: not there, of another kind, or malformed.
    """
    from nmt_record.exchange.ros_bag_table import is_bag, read_bag  # a bag reader, where the file is one

    if is_bag(path):
        return read_bag(path, wanted)
    kind = kind_of(path)
    if kind == "mat":
        return _read_mat(path, wanted)
    return {"csv": _read_csv, "npz": _read_npz, "uff": _read_uff, "lvm": _read_lvm, "tdms": _read_tdms}[kind](path)


def kind_of(path: Path) -> str:
    """``csv``, ``npz``, ``mat`` (HDF5 too), ``uff``, ``lvm`` or ``tdms``.

    Raises:
        BenchError: not there, empty, or a file of another kind.
    """
    try:
        if path.is_dir():
            raise BenchError(f"{path} is a folder; name the file with the data.")
        with open_regular(path, "data file", LARGEST_DATA) as file:
            head = file.read(520)
    except OSError as error:
        raise BenchError(f"The data file {path} cannot be read: {(error.strerror or str(error)).lower()}.") from error
    if not head.strip():
        raise BenchError(f"{path.name} is empty; name the file with the data.")
    kind = _SUFFIXES.get(path.suffix.lower(), "")
    for magic, what, fix in _FOREIGN:
        if head.startswith(magic) and not (magic == b"PK\x03\x04" and kind == "npz"):
            raise BenchError(f"{path.name} is {what}; {fix}.")
    if is_universal_file(head):
        kind = "uff"
    elif is_hdf5(head) or head.startswith(MAT5):
        kind = "mat"
    elif head.startswith(b"TDSm"):
        kind = "tdms"
    elif head.startswith(b"LabVIEW Measurement"):
        kind = "lvm"
    elif kind == "lvm":
        kind = "csv"  # without a header it is a table
    elif not kind or (kind == "npz" and not head.startswith(b"PK")) or kind in ("uff", "mat", "tdms"):
        wanted = {
            "npz": "an NPZ file (numpy.savez)",
            "uff": "a universal file (it does not begin with '    -1')",
            "tdms": "a TDMS file",
            "mat": "a MATLAB file of version 5 or later, nor HDF5 (save it with 'save -v7')",
        }
        what = f"is not {wanted[kind]}" if kind else f"has the unknown ending '{path.suffix}'"
        raise BenchError(f"{path.name} {what}; import csv, txt, npz, mat, h5, uff, lvm or tdms.")
    return kind


def split_name(name: str) -> tuple[str, str]:
    """Name of a column and the unit in brackets behind it, empty if there is none."""
    match = _UNIT_IN_NAME.match(name)
    return (match.group(1).strip(), match.group(2).strip()) if match else (name, "")


# --- CSV -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Form:
    delimiter: str | None
    decimal: str

    def cells(self, line: str) -> list[str]:
        parts = line.split() if self.delimiter is None else line.split(self.delimiter)
        return [part.strip().strip('"').strip() for part in parts]

    def is_number(self, cell: str) -> bool:
        return bool(_NUMBER[self.decimal].match(cell))

    def is_value(self, cell: str) -> bool:
        """Whether a cell is a number or a stamp."""
        return self.is_number(cell) or _TIME_OF_DAY.match(cell) is not None

    def numeric(self, line: str) -> bool:
        cells = self.cells(line)
        numbers = [cell for cell in cells if cell.lower() not in _MISSING and not _INFINITE.match(cell)]
        return bool(numbers) and all(map(self.is_value, numbers)) and any(map(self.is_number, numbers))


def _decoded(data: bytes, name: str, notes: list[str]) -> str:
    for mark, encoding in ((b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"), (b"\xef\xbb\xbf", "utf-8-sig")):
        if data.startswith(mark):
            try:
                text = data.decode(encoding)
            except UnicodeDecodeError:
                raise BenchError(f"{name} is not whole text in {encoding}; save it as plain CSV in UTF-8.") from None
            if encoding == "utf-16":
                notes.append(f"{name} is encoded in UTF-16; it was read as such.")
            return text
    if b"\0" in data[:65536]:
        raise BenchError(f"{name} is not a text file (it has zero bytes); save the table as CSV in UTF-8.")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        notes.append(f"{name} is not in UTF-8; its names were read as Windows-1252.")
        return data.decode("cp1252", "replace")


def _read_csv(path: Path) -> SourceTable:
    name = path.name
    notes: list[str] = []
    with open_regular(path, "table", LARGEST_TABLE // 2) as file:
        text = _decoded(file.read(LARGEST_TABLE), name, notes)
    if _TIME_OF_DAY.search(text[:4096].replace("\n", " ")) or ":" in text[:65536]:
        text = _DATE_AND_TIME.sub(r"\1T", text)
    everything = re.split(r"\r\n|\n|\r", text)
    numbers = [
        i for i, line in enumerate(everything) if line.strip() and not line.lstrip().startswith(("#", "%", "//"))
    ]
    lines = [everything[i] for i in numbers]
    if not lines:
        raise BenchError(f"{name} has no lines with values; name the file with the data.")
    form = _form_of(lines, name)
    if form.delimiter is None:
        numbers, lines = _with_empty_rows(everything, numbers, form, name, notes)
    first = next(row for row, line in enumerate(lines) if form.numeric(line))
    if form.decimal == ",":
        notes.append(f"{name} writes decimals with a comma; they were read as points.")
    header, lines = lines[:first], lines[first:]
    width = len(form.cells(lines[0]))
    one = width == 1 and form.delimiter is None  # the name of a single column may have spaces
    heads = [[line.strip().strip('"').strip()] if one else form.cells(line) for line in header]
    if width > 1 and not form.cells(lines[0])[-1] and (not heads or len(heads[-1]) < width or not heads[-1][-1]):
        # A delimiter at the end of every line.
        width -= 1
        heads = [cells[:-1] if len(cells) == width + 1 and not cells[-1] else cells for cells in heads]
        lines = [line.rstrip().removesuffix(form.delimiter or "") for line in lines]
    names, units = _heading(heads, width, form, name, notes)
    _refuse_split_decimals(heads, lines, width, form, name)
    start = first
    stamps = tuple(i for i, cell in enumerate(form.cells(lines[0])[:width]) if _TIME_OF_DAY.match(cell))
    if stamps:
        lines = _without_stamps(lines, stamps, form, lambda row: numbers[start + row] + 1, name)
        told = ", ".join(names[i] or str(i + 1) for i in stamps)
        notes.append(f"Column {told} of {name} holds dates or times of day; they were read as seconds after the first.")
    table, kept, breaks = _values(lines, width, form, names, header, lambda row: numbers[start + row] + 1, name)
    place = [numbers[start + row] + 1 for row in kept] if kept is not None else None
    for row in breaks:
        before = f"after line {place[row - 1]}" if place is not None and row else "at its begin"
        notes.append(f"The header of {name} is repeated {before}; that line was left out.")

    def line_of(row: int) -> int:
        return place[row] if place is not None else numbers[start + row] + 1

    columns = tuple(np.ascontiguousarray(column) for column in table.T)
    for i in stamps:
        columns[i].flat[:] = columns[i] - (columns[i][0] if np.isfinite(columns[i][0]) else 0.0)
    above = [line for line in everything[: numbers[first]] if line.strip()]
    # A line of names tells no clock.
    rate, step = _clock_of_heading(above[:-1] if any(names) and heads and len(heads[-1]) == width > 1 else above)
    return SourceTable(
        name, names, columns, units, notes=notes, lines=line_of, breaks=breaks, stamps=stamps, sample_rate=rate,
        step=step,
    )  # fmt: skip


def _with_empty_rows(
    everything: Sequence[str], numbers: list[int], form: _Form, name: str, notes: list[str]
) -> tuple[list[int], list[str]]:
    """Lines of a file, and their numbers, where an empty line among those of a single column is a missing value."""
    lines = [everything[i] for i in numbers]
    begin = next(row for row, line in enumerate(lines) if form.numeric(line))
    if len(form.cells(lines[begin])) > 1:
        return numbers, lines
    span = range(numbers[begin], numbers[-1] + 1)
    empty = [i for i in span if not everything[i].strip()]
    if not empty or len(empty) > 0.2 * len(span):
        return numbers, lines  # none, or a file with an empty line behind every one
    notes.append(f"{name} has {len(empty)} empty lines among its values; they were read as missing values.")
    numbers = sorted({*numbers, *empty})
    return numbers, [everything[i] if everything[i].strip() else "nan" for i in numbers]


def _clock_of_heading(lines: Sequence[str]) -> tuple[float | None, float | None]:
    """Sampling rate (Hz) and step (s) that the lines above the numbers state; None if none does, or several."""
    found: tuple[list[float], list[float]] = ([], [])
    for line in lines:
        for own, pattern in zip(found, (_HEAD_RATE, _HEAD_STEP), strict=True):
            match = pattern.search(line)
            value = None if match is None else _stated_number(match)
            likely = value is not None and (value >= _LEAST_RATE if own is found[0] else value <= _LARGEST_STEP)
            if match is not None and value is not None and (likely or match["before"] or match["after"]):
                own.append(value)
            if match is not None:
                break
    rate, step = (own[0] if len(set(own)) == 1 and own[0] > 0.0 else None for own in found)
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


def _without_stamps(
    lines: list[str], stamps: Sequence[int], form: _Form, line_of: Callable[[int], int], name: str
) -> list[str]:
    """Lines with seconds in the place of stamps.

    Raises:
        BenchError: a stamp cannot be read, or its zone differs from the first one's.
    """
    result = []
    zone: str | None = None
    days: dict[str, int] = {}
    for row, line in enumerate(lines):
        cells = form.cells(line)
        for index in stamps:
            found = _TIME_OF_DAY.match(cells[index]) if index < len(cells) else None
            if found is None:
                if index < len(cells) and cells[index].lower() in _MISSING:
                    cells[index] = "nan"
                continue  # refused below with its line
            zone = found["zone"] or "" if zone is None else zone
            if (found["zone"] or "") != zone:
                raise BenchError(
                    f"{name} line {line_of(row)}: the time zone changes from '{zone or 'none'}' to "
                    f"'{found['zone'] or 'none'}'; write all stamps in one zone."
                )
            day = _day(found["date"] or "", days)
            seconds = int(found["hour"]) * 3600 + int(found["minute"]) * 60 + int(found["second"])
            cells[index] = f"{day * 86400 + seconds}.{found['part'] or '0'}"
            if form.decimal == ",":
                cells[index] = cells[index].replace(".", ",")
        result.append((form.delimiter or " ").join(cell if cell else "nan" for cell in cells))
    return result


def _day(date: str, days: dict[str, int]) -> int:
    """Number of a date, from the first of the file on; one that is not year-month-day or day.month.year counts as the
    next one where it changes."""
    if date not in days:
        plain = re.fullmatch(r"(\d{4})[-/.](\d{1,2})[-/.](\d{1,2})", date)
        turned = re.fullmatch(r"(\d{1,2})\.(\d{1,2})\.(\d{4})", date)
        parts = plain.groups() if plain else turned.groups()[::-1] if turned else None
        try:
            number = datetime.date(*map(int, parts)).toordinal() if parts else None
        except ValueError:
            number = None
        if number is None:
            days[date] = max(days.values(), default=-1) + 1
        else:
            days.setdefault("first", number)
            days[date] = number - days["first"]
    return days[date]


def _form_of(lines: Sequence[str], name: str) -> _Form:
    """Delimiter and decimal sign under which most lines are numbers."""
    sample = list(lines[:200]) + list(lines[200:4000:97])
    best, score = None, 0
    for delimiter, decimal in _FORMS:
        form = _Form(delimiter, decimal)
        rows = [line for line in sample if form.numeric(line) and (delimiter is None or delimiter in line)]
        if len(rows) > score * 1.5:
            best, score = form, len(rows)
    if best is not None and best.delimiter == "," and _one_column_of_decimal_commas(sample, name):
        best = _Form(None, ",")
    if best is None:
        raise BenchError(
            f"{name} has no line of numbers; a CSV needs columns of numbers separated by ; or tab or comma, decimals "
            f"with a point."
        )
    return best


def _one_column_of_decimal_commas(lines: Sequence[str], name: str) -> bool:
    """Whether lines that look like two columns of whole numbers are one of numbers with a decimal comma.

    A heading then has one name, and the digits behind the comma are as many in every line.

    Raises:
        BenchError: nothing tells.
    """
    numbers = [line.strip() for line in lines if re.fullmatch(r"\s*[-+]?\d+,\d+\s*", line)]
    rest = [line for line in lines if line.strip() and line.strip() not in numbers]
    heads = [line for line in rest if not re.match(r"\s*[-+]?\d", line) and line.strip().lower() not in _MISSING]
    empty = len(rest) - len(heads)
    if len(numbers) < 3 or empty > 0.2 * len(lines):
        return False
    behind = [line.partition(",")[2] for line in numbers]
    if len({len(digits) for digits in behind}) > 1:
        return False
    if heads:
        return "," not in heads[-1]
    if any(re.match(r"0\d", digits) for digits in behind):
        return True
    raise BenchError(
        f"{name} has no heading, and lines such as '{numbers[0]}' may be two columns or one with decimal commas; write "
        "decimals with a point, or give the columns names."
    )


def _heading(
    heads: list[list[str]], width: int, form: _Form, name: str, notes: list[str]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    # Empty cells at the end of a heading are no columns.
    trimmed = [cells[:width] if len(cells) > width and not any(cells[width:]) else cells for cells in heads[-3:]]
    fitting = [cells for cells in trimmed if len(cells) == width]
    if heads and not fitting and len(heads[-1]) > 1:
        hint = ""
        if form.delimiter == "," and len(heads[-1]) * 2 >= width > len(heads[-1]):
            hint = " (decimal commas in a comma-separated file? save it with ; as separator or with decimal points)"
        raise BenchError(f"{name} has {len(heads[-1])} column names but {width} values in its first row{hint}.")
    if not fitting:
        return ("",) * width, ("",) * width
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
        told = ", ".join(dict.fromkeys(filter(None, labels)))
        notes.append(f"The second line of the heading of {name} was read as what the columns belong to ({told}).")
    return tuple(names), tuple(units)


def _is_unit(cell: str) -> bool:
    plain = plain_unit(cell.strip("[](){} "))
    return (
        not plain
        or plain in ("s", "ms", "us", "Hz", "rad/s", "1", "%", "deg", "rad")
        or (quantity_of_unit(plain) is not Quantity.UNKNOWN)
    )


def _refuse_split_decimals(heads: list[list[str]], lines: Sequence[str], width: int, form: _Form, name: str) -> None:
    """A comma-separated file without one decimal point, but with cells like 05, was written with decimal commas."""
    if form.delimiter != "," or any("." in line for line in lines[:200]):
        return
    cells = [cell for line in lines[:200] for cell in form.cells(line)]
    if any(re.match(r"0\d", cell) for cell in cells):
        raise BenchError(
            f"{name} separates columns by commas and seems to write decimals with commas too (a cell reads "
            f"'{next(cell for cell in cells if re.match(r'0[0-9]', cell))}'); save it with ; as separator or with "
            f"decimal points."
        )


def _values(
    lines: list[str],
    width: int,
    form: _Form,
    names: tuple[str, ...],
    header: list[str],
    line_of: Callable[[int], int],
    name: str,
) -> tuple[FloatArray, list[int] | None, tuple[int, ...]]:
    """Numbers, rows kept (None = all) and rows before which the header was repeated."""
    plain = [line.replace(",", ".") for line in lines] if form.decimal == "," else lines
    try:
        table = np.loadtxt(plain, dtype=np.float64, delimiter=form.delimiter, ndmin=2, comments=None, encoding=None)
        if table.shape == (len(lines), width) and not np.isinf(table).any():
            return table, None, ()
    except (ValueError, IndexError):
        pass
    rows: list[list[float]] = []
    kept: list[int] = []
    breaks: list[int] = []
    heads = {line.strip() for line in header}
    for row, line in enumerate(lines):
        if line.strip() in heads:
            breaks.append(len(rows))
            continue
        cells = form.cells(line)
        where = f"{name} line {line_of(row)}"
        if len(cells) != width:
            more = (
                "cut off"
                if row == len(lines) - 1 and len(cells) < width
                else "columns of unequal length or a stray separator"
            )
            raise BenchError(f"{where} has {len(cells)} values instead of {width} ({more}); fix the line.")
        rows.append([_cell(cell, form, where, names[i] or str(i + 1)) for i, cell in enumerate(cells)])
        kept.append(row)
    return np.array(rows, dtype=np.float64).reshape(-1, width), kept, tuple(breaks)


def _cell(cell: str, form: _Form, where: str, column: str) -> float:
    if cell.lower() in _MISSING:
        return np.nan
    number = float(cell.replace(",", ".").replace("D", "e").replace("d", "e")) if form.is_number(cell) else np.nan
    if np.isfinite(number):
        return number
    if np.isinf(number) or _INFINITE.match(cell):
        raise BenchError(
            f"{where}: column {column} is infinite ({cell}); leave the cell empty if the value is missing."
        )
    comma = form.decimal == "." and _NUMBER[","].match(cell) is not None
    hint = "decimal comma among decimal points" if comma else "text in a column of numbers"
    raise BenchError(f"{where}: column {column} has '{cell[:30]}' ({hint}); fix it or leave it empty if it is missing.")


# --- NPZ and UFF -----------------------------------------------------------------------------------------------------


def _read_npz(path: Path) -> SourceTable:
    name = path.name
    arrays = dict(read_arrays(path, "data file"))
    rate, step, clock_keys = _clock_keys(arrays)
    for key in clock_keys:
        del arrays[key]
    columns: dict[str, FloatArray] = {}
    for key, array in arrays.items():
        if array.ndim == 0:
            continue
        if array.dtype.kind not in "iufb" or array.dtype.kind == "b":
            raise BenchError(f"Array {key} of {name} is of type {array.dtype}; real numbers are needed.")
        if array.ndim > 2 or (array.ndim == 2 and 1 not in array.shape):
            shape = " × ".join(map(str, array.shape))
            raise BenchError(f"Array {key} of {name} has the shape {shape}; save each channel as an array of its own.")
        columns[key] = array.reshape(-1).astype(np.float64, copy=False)
    if not columns or not next(iter(columns.values())).size:
        raise BenchError(f"{name} is empty of arrays; save the columns with numpy.savez.")
    lengths = {key: column.shape[0] for key, column in columns.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{key} {length}" for key, length in list(lengths.items())[:6])
        raise BenchError(f"The arrays of {name} have unequal lengths ({listed}); save columns of one recording.")
    for key, column in columns.items():
        if np.isinf(column).any():
            raise BenchError(
                f"Array {key} of {name} is infinite at sample {int(np.argmax(np.isinf(column)))}; use NaN where "
                f"values are missing."
            )
    return SourceTable(name, tuple(columns), tuple(columns.values()), sample_rate=rate, step=step)


def _read_lvm(path: Path) -> SourceTable:
    """Texts of LabVIEW, by lvm-read; one section with one clock. Its time columns stand behind the channels.

    Raises:
        BenchError: the file cannot be read as such, or has sections or steps of several kinds.
    """
    import lvm_read

    name, notes = path.name, list[str]()
    with open_regular(path, "table", LARGEST_TABLE // 2) as file:
        text = _decoded(file.read(LARGEST_TABLE), name, notes)
    try:
        content = lvm_read.read_str(text.replace("\r\n", "\n"))
        sections = [content[number] for number in range(content["Segments"])]
        section = max(sections, key=lambda item: item["data"].size)
        data = np.asarray(section["data"], dtype=np.float64)
        count = int(section["Channels"])
        heads = [str(head).strip() for head in section["Channel names"]]
        kind = content.get("X_Columns", "One")
        # Behind the header a row has one time before all channels, one before each, or none.
        places = {
            "No": range(count), "Multi": range(1, 2 * count, 2)
        }.get(kind, range(1, count + 1))  # fmt: skip
        clocks = {"No": range(0), "Multi": range(0, 2 * count, 2)}.get(kind, range(1))
        names = [heads[place] if place < len(heads) and heads[place] else str(n + 1) for n, place in enumerate(places)]
        steps, starts = (
            [float(value) for value in section.get(key, []) if math.isfinite(float(value))] for key in ("Delta_X", "X0")
        )
        units = [str(unit).strip() for unit in section.get("Y_Unit_Label", []) if kind != "Multi" or str(unit).strip()]
    except (KeyError, ValueError, IndexError, TypeError, SyntaxError, AttributeError) as error:
        raise BenchError(f"{name} cannot be read as a LabVIEW measurement ({error}); export it again.") from error
    if len(sections) > 1:
        notes.append(f"{name} has {len(sections)} sections; the largest was read.")
    kinds = {str(kind).strip() for kind in section.get("X_Dimension", [])} - {"", "Time"}
    if kinds:
        raise BenchError(f"The channels of {name} are over {', '.join(sorted(kinds)).lower()}, not over time.")
    if len(set(steps[:count])) > 1 or len(set(starts[:count])) > 1:
        raise BenchError(f"The channels of {name} have clocks of their own; export those of one clock.")
    if not steps or not steps[0] > 0.0:
        raise BenchError(f"The header of {name} has no time step (Delta_X); export it again.")
    if data.ndim != 2 or not data.size or count < 1 or data.shape[1] <= places[-1]:
        raise BenchError(f"{name} has no rows of {count} channels; export it again.")
    columns = [np.ascontiguousarray(data[:, place]) for place in places]
    if any(column.size == 0 or not np.isfinite(column).any() for column in columns):
        raise BenchError(f"{name} has a channel without numbers; export it again.")
    every = [np.ascontiguousarray(data[:, place]) for place in clocks]
    times = [time for time in every if np.isfinite(time).all()]  # empty cells are no clock
    units = [*(units[:count] if len(units) >= count else [""] * count), *["s"] * len(times)]
    labels = ["X_Value" if len(times) < 2 else f"X_Value.{number + 1}" for number in range(len(times))]
    return SourceTable(
        name,
        (*names, *labels),
        (*columns, *times),
        tuple(units),
        notes=notes,
        start=starts[0] if starts else 0.0,
        step=steps[0],
    )


def _read_tdms(path: Path) -> SourceTable:
    """TDMS files, by npTDMS; the channels of the group with the most samples.

    Raises:
        BenchError: the file is damaged, or has no channels of equal length with a clock.
    """
    from nptdms import TdmsFile

    name = path.name
    try:
        content = TdmsFile.read(path)
        groups = [[c for c in group.channels() if len(c) and c.dtype.kind in "iuf"] for group in content.groups()]
        channels = max(groups, key=lambda group: sum(map(len, group)), default=[])
        columns = tuple(np.asarray(channel[:], dtype=np.float64) for channel in channels)
        steps = {float(channel.properties.get("wf_increment", 0.0)) for channel in channels}
        starts = {float(channel.properties.get("wf_start_offset", 0.0)) for channel in channels}
        units = tuple(str(channel.properties.get("unit_string", "")) for channel in channels)
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, OSError, OverflowError, MemoryError) as error:
        raise BenchError(f"{name} is cut off or damaged ({str(error).rstrip('.')}); save it again.") from error
    if not columns or len({column.size for column in columns}) > 1 or len(steps) > 1 or len(starts) > 1:
        raise BenchError(f"{name} holds no group of channels of one clock and length; save those of one recording.")
    if any(not np.isfinite(column).any() for column in columns):
        raise BenchError(f"{name} has a channel without numbers; save it again.")
    notes = [f"{name} has {len(groups)} groups; the largest was read."] if len(groups) > 1 else []
    step = steps.pop()
    return SourceTable(
        name, tuple(channel.name for channel in channels), columns, units, notes=notes,
        start=starts.pop() if step > 0.0 else None, step=step if step > 0.0 else None,
    )  # fmt: skip


_RATES = frozenset(("samplerate", "fs", "samplingrate", "samplingfrequency", "samplefrequency"))
_STEPS = frozenset(("dt", "deltat", "sampleinterval", "samplinginterval", "timestep", "wfincrement"))


def _plain_key(key: str) -> str:
    """Last part of a name, in small letters, without what joins words."""
    return re.sub(r"[_ -]", "", key.rpartition(".")[2]).lower()


def _clock_keys(values: Mapping[str, NDArray[Any]]) -> tuple[float | None, float | None, list[str]]:
    """Sampling rate (Hz) and step (s) among single numbers, and their keys; None where there is none, or several."""
    single = {key: float(np.real(array.reshape(-1)[0])) for key, array in values.items()
              if array.size == 1 and array.dtype.kind in "iufc"}  # fmt: skip
    rates = {key: value for key, value in single.items() if _plain_key(key) in _RATES and value > 0.0}
    steps = {key: value for key, value in single.items() if _plain_key(key) in _STEPS and 0.0 < value <= _LARGEST_STEP}
    rate = next(iter(rates.values())) if len(set(rates.values())) == 1 else None
    step = next(iter(steps.values())) if len(set(steps.values())) == 1 else None
    return rate, step, [key for key in single if _plain_key(key) in _RATES | _STEPS]


def _read_mat(path: Path, wanted: Sequence[str | int]) -> SourceTable:
    name = path.name
    arrays = read_mat(path, "data file")
    rate, step, _ = _clock_keys(arrays)
    columns: dict[str, FloatArray] = {}
    for key, array in arrays.items():
        if array.size > 1:
            columns |= _columns_of(key, array)
    if not columns:
        raise BenchError(f"{name} has no arrays of numbers; save the columns as numeric arrays.")
    lengths = {key: column.shape[0] for key, column in columns.items()}
    needed = {column: lengths[column] for column in wanted if isinstance(column, str) and column in lengths}
    if len(set(needed.values())) > 1:
        listed = ", ".join(f"{key} {length}" for key, length in needed.items())
        raise BenchError(f"The columns of {name} have unequal lengths ({listed}); save those of one recording.")
    if needed:
        length = next(iter(needed.values()))
    else:
        every = list(lengths.values())
        length = max(set(every), key=lambda own: (own * every.count(own), own))
    kept = {key: column for key, column in columns.items() if column.shape[0] == length}
    for key, column in kept.items():
        if np.isinf(column).any():
            raise BenchError(
                f"Array {key} of {name} is infinite at sample {int(np.argmax(np.isinf(column)))}; use NaN."
            )
    others = len(columns) - len(kept)
    notes = [f"{others} arrays of {name} have other lengths than {length} and are left out."] if others else []
    single = {key: float(np.real(array.reshape(-1)[0])) for key, array in arrays.items() if array.size == 1}
    return SourceTable(
        name, tuple(kept), tuple(kept.values()), notes=notes, sample_rate=rate, step=step, constants=single
    )


def _columns_of(key: str, array: NDArray[Any]) -> dict[str, FloatArray]:
    """Columns of one array: ``x``, or ``x.1``, ``x.2`` … along its shorter side; of complex ones real and imag."""
    flat = array.reshape(-1) if array.ndim < 2 or 1 in array.shape else array
    if flat.ndim > 2 or (flat.ndim == 2 and min(flat.shape) > _MOST_COLUMNS):
        return {}
    if flat.ndim == 2:
        long = flat if flat.shape[0] >= flat.shape[1] else flat.T
        parts = {f"{key}.{number + 1}": long[:, number] for number in range(long.shape[1])}
    else:
        parts = {key: flat}
    result: dict[str, FloatArray] = {}
    for own, values in parts.items():
        if np.iscomplexobj(values):
            result |= {f"{own}.real": values.real.astype(np.float64), f"{own}.imag": values.imag.astype(np.float64)}
        else:
            result[own] = values.astype(np.float64)
    return result


def _read_uff(path: Path) -> SourceTable:
    name = path.name
    functions = uff.read_uff(path)
    times = [f for f in functions if f.function_type in (0, uff.TIME_RESPONSE) and not np.iscomplexobj(f.values)]
    times = [f for f in times if f.abscissa_axis.data_type in (0, 1, uff.TIME)]
    notes = []
    if not times:
        kinds = sorted({uff.FUNCTION_NAMES.get(f.function_type, f"type {f.function_type}") for f in functions})
        raise BenchError(
            f"{name} holds no time data but {', '.join(kinds)}; export time responses (frequency responses "
            "belong into a segment of 'kind: frf')."
        )
    if len(times) < len(functions):
        others = [f for f in functions if f not in times]
        kinds = sorted({uff.FUNCTION_NAMES.get(f.function_type, f"type {f.function_type}") for f in others})
        notes.append(f"{name} also holds {', '.join(kinds)} ({len(others)} datasets); they were left out.")
    head = times[0]
    for function in times[1:]:
        if function.values.shape != head.values.shape:
            raise BenchError(
                f"Datasets {head.number} and {function.number} of {name} have {head.values.shape[0]} and "
                f"{function.values.shape[0]} values; one recording has equal lengths."
            )
        if not np.allclose(function.x[[0, -1]], head.x[[0, -1]], rtol=1e-5, atol=1e-12):
            raise BenchError(
                f"Datasets {head.number} and {function.number} of {name} have different time axes (two clocks); "
                "import them one by one."
            )
    for function in times:
        if np.isinf(function.values).any():
            raise BenchError(f"Dataset {function.number} of {name} holds infinite values; export it again.")
    if head.abscissa is None and not head.abscissa_increment > 0.0:
        raise BenchError(
            f"Dataset {head.number} of {name} has the time step {head.abscissa_increment:g} s; export it again."
        )
    units = tuple("" if f.ordinate_axis.unit.upper() == "NONE" else f.ordinate_axis.unit for f in times)
    return SourceTable(
        name,
        tuple(f.name for f in times),
        tuple(np.ascontiguousarray(f.values, dtype=np.float64) for f in times),
        tuple(unit if quantity_of_unit(unit) is not Quantity.UNKNOWN else "" for unit in units),
        tuple(uff.QUANTITIES.get(f.ordinate_axis.data_type, Quantity.UNKNOWN) for f in times),
        notes,
        start=None if head.abscissa is not None else head.abscissa_minimum,
        step=None if head.abscissa is not None else head.abscissa_increment,
        abscissa=head.abscissa,
    )
