"""Tables written as text: CSV and its relatives."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.hardened import LARGEST_ARRAYS, LARGEST_TABLE, open_regular
from nmt_core.numerics.arrays import FloatArray
from nmt_record.exchange.clocks.text_stamps import StampReader, date_columns, is_date, is_stamp, joined_stamps
from nmt_record.exchange.source_table import AS_IT_IS, Scaling, SourceTable, split_name
from nmt_record.exchange.text.text_form import INFINITE, MISSING, TextForm, form_of, refuse_split_decimals
from nmt_record.exchange.text.text_heading import Heading, clock_of_heading, heading_of, scaling_of_heading
from nmt_record.exchange.unit_table import plain_unit

_MOST_ROWS_ACROSS = 64  # of a table whose channels are rows
_FEWEST_ACROSS = 100  # numbers in each of them
_MOST_SERIES = 64  # of a table in the long form
_SERIES = re.compile(r"topic|series|signal|channel|name|variable|sensor|parameter|label|source|key|id", re.I)
_VALUE = re.compile(r"values?|y|reading|data|measurement|wert", re.I)
_LONGEST_FOOT = 30  # lines behind the numbers
_LONGEST_HEAD = 200  # lines before them
_LARGEST = LARGEST_TABLE // 2  # bytes of a text whose lines are all looked at
_LARGEST_PLAIN = 2 * LARGEST_TABLE  # of one that has plain numbers only
_HEAD = 2**18  # of its bytes that are read as any text


def decoded(data: bytes, name: str, notes: list[str]) -> str:
    """Text of a file, by its mark, in UTF-8 or Windows-1252.

    Raises:
        BenchError: it is not a text.
    """
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


def read_text_table(path: Path) -> SourceTable:
    """Columns of a text.

    Raises:
        BenchError: no table of numbers, or the first line of it that is not certain.
    """
    name = path.name
    notes: list[str] = []
    with open_regular(path, "table", _LARGEST_PLAIN) as file:
        if os.fstat(file.fileno()).st_size > _LARGEST:
            return _plain_table(file, path)
        text = joined_stamps(decoded(file.read(LARGEST_TABLE), name, notes))
    return _Text(name, re.split(r"\r\n|\n|\r", text), notes, '"' in text).table()


def _plain_table(file: IO[bytes], path: Path) -> SourceTable:
    """Columns of a long text that behind its heading has plain numbers only, such as an export; its lines are not kept.

    Its beginning is read as any text; the rest has to be of the same numbers, which numpy reads by itself.

    Raises:
        BenchError: as :func:`read_text_table`, or something else stands in it.
    """
    size = os.fstat(file.fileno()).st_size / 2**20
    refusal = (
        f"{path.name} has {size:.1f} MiB, and beyond {_LARGEST / 2**20:g} MiB a table may have plain numbers only, "
        "with one delimiter, behind its heading; cut it into shorter files, or save it as NPZ"
    )
    notes: list[str] = []
    head = decoded(file.read(_HEAD), path.name, notes)
    text = _Text(path.name, re.split(r"\r\n|\n|\r", head[: head.rfind("\n")]), notes, '"' in head)
    begin = text.table()
    if notes or begin.lines is None or begin.stamps or begin.parts or begin.breaks:
        raise BenchError(f"{refusal}.")
    width, rows = len(begin.columns), begin.columns[0].size
    most = LARGEST_ARRAYS // (8 * width)
    try:
        found = np.loadtxt(
            path, delimiter=text.form.delimiter, skiprows=begin.lines(0) - 1, comments=None, ndmin=2, max_rows=most,
            encoding="utf-8",
        )  # fmt: skip
    except ValueError as error:
        raise BenchError(f"{refusal} ({error}).") from error
    alike = found.shape[1] == width and np.array_equal(found[:rows].T, np.array(begin.columns), equal_nan=True)
    if not alike or len(found) == most or np.isinf(found).any():
        raise BenchError(f"{refusal}.")
    first = begin.lines(0)
    columns = tuple(np.ascontiguousarray(column) for column in found.T)
    return replace(begin, columns=columns, lines=lambda row: first + row)


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(("#", "%", "//"))


@dataclass
class _Rows:
    """Lines of numbers, and what of them is not a plain number."""

    lines: list[str]
    stamps: tuple[int, ...]
    dates: dict[int, int]
    quoted: bool


class _Text:
    """The lines of one file on their way to columns."""

    def __init__(self, name: str, everything: list[str], notes: list[str], quoted: bool) -> None:
        self.name, self.notes, self.quoted = name, notes, quoted
        self.everything = _upright(everything, name, notes)
        self.numbers = [i for i, line in enumerate(self.everything) if line.strip() and not _is_comment(line)]
        self.lines = [self.everything[i] for i in self.numbers]
        if not self.lines:
            raise BenchError(f"{name} has no lines with values; name the file with the data.")
        self.form = form_of(self.lines, name)
        self.first = 0

    def line_of(self, row: int) -> int:
        """Line in the file of a row behind the heading."""
        return self.numbers[self.first + row] + 1

    def table(self) -> SourceTable:
        """The columns.

        Raises:
            BenchError: as :func:`read_text_table`.
        """
        name, form, notes = self.name, self.form, self.notes
        if form.delimiter is None:
            self._keep_empty_rows()
        self.first = first = self._first_row()
        if form.decimal == ",":
            notes.append(f"{name} writes decimals with a comma; they were read as points.")
        header, lines = self.lines[:first], self._without_foot(self.lines[first:])
        width = len(form.cells(lines[0]))
        one = width == 1 and form.delimiter is None  # the name of a single column may have spaces
        heads = [[line.strip().strip('"').strip()] if one else form.cells(line) for line in header]
        if not any(len(cells) >= width for cells in heads):
            heads += self._commented_heading(width)
        if width > 1 and not form.cells(lines[0])[-1] and (not heads or len(heads[-1]) < width or not heads[-1][-1]):
            # A delimiter at the end of every line.
            width -= 1
            heads = [cells[:-1] if len(cells) == width + 1 and not cells[-1] else cells for cells in heads]
            lines = [line.rstrip().removesuffix(form.delimiter or "") for line in lines]
        heading = heading_of(heads, width, form, name, notes)
        refuse_split_decimals(heads, lines, width, form, name)
        rows = self._rows(lines, width)
        words = self._words(rows, width, heading)
        plain = self._plain_lines(rows, words, {line.strip() for line in header})
        table, kept, breaks = _values(plain, width, form, heading.names, header, self.line_of, name)
        place = [self.line_of(row) for row in kept] if kept is not None else None
        for row in breaks:
            before = f"after line {place[row - 1]}" if place is not None and row else "at its begin"
            notes.append(f"The header of {name} is repeated {before}; that line was left out.")
        if series := self._series(rows, words, heading, kept):
            return self._wide(series, table, heading, words)
        columns = tuple(np.ascontiguousarray(column) for column in table.T)
        for i in rows.stamps:
            columns[i].flat[:] = columns[i] - (columns[i][0] if np.isfinite(columns[i][0]) else 0.0)
        above = [line for line in self.everything[: self.numbers[first]] if line.strip()]
        # A line of names tells no clock.
        named = any(heading.names) and heads and len(heads[-1]) == width > 1
        rate, step = clock_of_heading(above[:-1] if named else above)
        scalings, units = self._scalings(above, columns, heading, [*rows.stamps, *words])

        def line_of(row: int) -> int:
            return place[row] if place is not None else self.line_of(row)

        return SourceTable(
            name, heading.names, columns, units, notes=notes, lines=line_of, breaks=breaks, stamps=rows.stamps,
            sample_rate=rate, step=heading.step or step, start=heading.start, scalings=scalings,
            parts=tuple(sorted({*words, *heading.empty, *([heading.counter] if heading.counter >= 0 else [])})),
        )  # fmt: skip

    def _commented_heading(self, width: int) -> list[list[str]]:
        """Names of the columns in the last comment above the numbers, as numpy.savetxt writes them; empty if none."""
        above = self.everything[: self.numbers[self.first]]
        comment = next((line for line in reversed(above) if line.strip()), "")
        text = re.sub(r"^[#%/\s]+", "", comment)
        forms = [self.form, TextForm(",", self.form.decimal), TextForm("\t", self.form.decimal), TextForm(";", ".")]
        for form in forms if text and _is_comment(comment) else ():
            cells = form.cells(text)
            if len(cells) == width and not any(map(self.form.is_value, cells)):
                return [cells]
        return []

    def _first_row(self) -> int:
        """Line of the first numbers; among words a line above the heading may have some, too."""
        form = self.form
        numeric = [row for row, line in enumerate(self.lines[:_LONGEST_HEAD]) if form.numeric(line)]
        if not numeric or not form.words:
            return next(row for row, line in enumerate(self.lines) if form.numeric(line))
        for row in numeric:
            below = form.cells(self.lines[row + 1]) if row + 1 < len(self.lines) else []
            numbers = [cell for i, cell in enumerate(below) if i not in form.words and cell]
            if row + 1 in numeric or not numbers or any(map(form.is_value, numbers)):
                return row
        return numeric[0]

    def _keep_empty_rows(self) -> None:
        """An empty line among those of a single column is a missing value."""
        begin = next(row for row, line in enumerate(self.lines) if self.form.numeric(line))
        if len(self.form.cells(self.lines[begin])) > 1:
            return
        last = max(row for row, line in enumerate(self.lines) if self.form.numeric(line))
        span = range(self.numbers[begin], self.numbers[last] + 1)
        empty = [i for i in span if not self.everything[i].strip()]
        if not empty or len(empty) > 0.2 * len(span):
            return  # none, or a file with an empty line behind every one
        self.notes.append(f"{self.name} has {len(empty)} empty lines among its values; they were read as missing.")
        self.numbers = sorted({*self.numbers, *empty})
        self.lines = [self.everything[i] if self.everything[i].strip() else "nan" for i in self.numbers]

    def _without_foot(self, lines: list[str]) -> list[str]:
        """Lines without those behind the last row that begin with a word, such as statistics."""
        form, last = self.form, len(lines)
        if 0 in form.words:
            last = self._row_of_last_block(lines)
        while last > 1 and len(lines) - last < _LONGEST_FOOT and self._is_foot(lines[last - 1]):
            last -= 1
        foot = lines[last:]
        if not foot or not form.numeric(lines[last - 1]):
            return lines
        begins = ", ".join(form.cells(line)[0][:20] for line in foot[:4]) + (", …" if len(foot) > 4 else "")
        self.notes.append(f"The last {len(foot)} lines of {self.name} are no rows ({begins}); they were left out.")
        return lines[:last]

    def _row_of_last_block(self, lines: Sequence[str]) -> int:
        """Row behind the last empty line, where few follow that begin with words which the rows do not have."""
        known = {self.form.cells(line)[0] for line in lines[:_LONGEST_HEAD]}
        for row in range(len(lines) - 1, max(0, len(lines) - _LONGEST_FOOT), -1):
            if self.form.cells(lines[row])[0] in known:
                break
            if self.line_of(row) > self.line_of(row - 1) + 1:
                return row
        return len(lines)

    def _is_foot(self, line: str) -> bool:
        cells = self.form.cells(line)
        first = cells[0].lower() if cells else ""
        word = bool(re.match(r"[^\W\d_]", first)) and first not in MISSING and not INFINITE.match(first)
        return word and 0 not in self.form.words and not self.form.is_value(cells[0])

    def _rows(self, lines: list[str], width: int) -> _Rows:
        cells = self.form.cells(lines[0])[:width]
        stamps = tuple(i for i, cell in enumerate(cells) if is_stamp(cell))
        dates = date_columns(cells)
        return _Rows(lines, stamps, dates, self.quoted and any('"' in line for line in lines))

    def _words(self, rows: _Rows, width: int, heading: Heading) -> tuple[int, ...]:
        """Columns that hold no numbers; sentences on them and on stamps."""
        names, name = heading.names, self.name
        cells = self.form.cells(rows.lines[0])[:width]
        dates = {i for i, cell in enumerate(cells) if is_date(cell)}
        words = sorted({i for i in self.form.words if i < width} | dates)
        left_out = [i for i in words if i not in rows.dates.values()]
        if left_out:
            listed = ", ".join(names[i] or str(i + 1) for i in left_out)
            self.notes.append(f"Column {listed} of {name} holds words; no numbers were read from it.")
        if rows.stamps:
            listed = ", ".join(names[i] or str(i + 1) for i in rows.stamps)
            self.notes.append(
                f"Column {listed} of {name} holds dates, times of day or durations; they were read as seconds after "
                "the first."
            )
        for time, date in rows.dates.items():
            self.notes.append(
                f"The dates of column {names[date] or date + 1} of {name} belong to the times of column "
                f"{names[time] or time + 1}."
            )
        return tuple(words)

    def _series(self, rows: _Rows, words: Sequence[int], heading: Heading, kept: list[int] | None) -> tuple[str, ...]:
        """Series that each row of a table in the long form belongs to; empty where it is none."""
        named = [i for i in words if _SERIES.fullmatch(heading.names[i])]
        others = [i for i in range(len(heading.names)) if i not in words]
        values = [i for i in others if _VALUE.fullmatch(split_name(heading.names[i])[0])]
        if len(named) != 1 or len(values) != 1 or rows.stamps:
            return ()
        lines = rows.lines if kept is None else [rows.lines[row] for row in kept]
        found = tuple(self.form.cells(line)[named[0]] for line in lines)
        return found if 1 < len(set(found)) <= _MOST_SERIES else ()

    def _wide(self, series: Sequence[str], table: FloatArray, heading: Heading, words: Sequence[int]) -> SourceTable:
        """Columns of a table in the long form: its times, and the values of each series.

        Raises:
            BenchError: the times of the series differ.
        """
        names = heading.names
        value = next(i for i in range(len(names)) if i not in words and _VALUE.fullmatch(split_name(names[i])[0]))
        times = [i for i in range(len(names)) if i not in words and i != value]
        marks = np.array(series)
        groups = {name: table[marks == name] for name in dict.fromkeys(series)}
        first = next(iter(groups.values()))
        listed = ", ".join(list(groups)[:4]) + (", …" if len(groups) > 4 else "")
        same = [i for i in times if all(np.array_equal(part[:, i], first[:, i]) for part in groups.values())]
        if not same:
            raise BenchError(
                f"{self.name} is in the long form, a row for each value of {len(groups)} series ({listed}), and their "
                "times differ: save the rows of each series as a table of its own, and import one at a time."
            )
        self.notes[:] = [note for note in self.notes if "holds words" not in note]
        self.notes.append(
            f"{self.name} is in the long form, a row for each value of {len(groups)} series ({listed}); each was read "
            "as a column."
        )
        place = np.flatnonzero(marks == series[0])
        columns = [*(first[:, i] for i in same), *(part[:, value] for part in groups.values())]
        return SourceTable(
            self.name, (*(names[i] for i in same), *groups), tuple(map(np.ascontiguousarray, columns)),
            (*(heading.units[i] for i in same), *[heading.units[value]] * len(groups)), notes=self.notes,
            lines=lambda row: self.line_of(int(place[row])), parts=tuple(range(1, len(same))),
        )  # fmt: skip

    def _plain_lines(self, rows: _Rows, words: Sequence[int], header: set[str]) -> list[str]:
        """Lines of plain numbers, in which stamps are seconds and words are missing.

        Raises:
            BenchError: a stamp's zone differs from the first one's.
        """
        form = self.form
        if not (rows.stamps or words or rows.quoted or form.grouped):
            return rows.lines
        reader = StampReader(self.name, self.line_of)
        result = []
        for row, line in enumerate(rows.lines):
            if line.strip() in header:
                result.append(line)
                continue
            cells = form.cells(line)
            for index in rows.stamps:
                if index < len(cells):
                    date = rows.dates.get(index)
                    day = cells[date] if date is not None and date < len(cells) else ""
                    found = reader.seconds(cells[index], row, day)
                    if found is not None:
                        cells[index] = found.replace(".", form.decimal)
            for index in words:
                if index < len(cells):
                    cells[index] = "nan"
            if form.grouped or rows.quoted:
                cells = [form.plain(c).replace(".", form.decimal) if form.is_number(c) else c for c in cells]
            result.append(_joined(cells, form))
        return result

    def _scalings(
        self, above: Sequence[str], columns: Sequence[FloatArray], heading: Heading, others: Sequence[int]
    ) -> tuple[tuple[Scaling, ...], tuple[str, ...]]:
        """Scales of whole numbers that the heading states, and units with those behind them."""
        units, scalings = list(heading.units), [AS_IT_IS] * len(columns)
        stated = scaling_of_heading(above, self.name)
        if stated is None:
            return tuple(scalings), tuple(units)
        for index, column in enumerate(columns):
            finite = column[np.isfinite(column)]
            counts = finite.size > 2 and bool((finite == np.round(finite)).all()) and bool((finite < 0.0).any())
            if index not in others and counts and plain_unit(units[index]) != "s":
                scalings[index], units[index] = stated
        if any(scaling is not AS_IT_IS for scaling in scalings):
            scaling, unit = stated
            self.notes.append(
                f"The heading of {self.name} states {scaling.scale:g} {unit} a count"
                + (f" from {scaling.zero:g} on" if scaling.zero else "") + "; counts were read so."
            )  # fmt: skip
        return tuple(scalings), tuple(units)


def _joined(cells: Sequence[str], form: TextForm) -> str:
    delimiter = form.delimiter or " "
    quoted = (f'"{cell}"' if form.delimiter is not None and delimiter in cell else cell for cell in cells)
    return delimiter.join(cell if cell else "nan" for cell in quoted)


def _upright(everything: list[str], name: str, notes: list[str]) -> list[str]:
    """Lines in which each channel is a column; of a table whose channels are rows, turned."""
    lines = [line for line in everything[: 4 * _MOST_ROWS_ACROSS] if line.strip() and not _is_comment(line)]
    if not 1 <= len(lines) <= _MOST_ROWS_ACROSS or len(lines) != sum(
        1 for line in everything if line.strip() and not _is_comment(line)
    ):
        return everything
    for delimiter in (";", "\t", ","):
        form = TextForm(delimiter, "," if delimiter != "," and "." not in lines[-1] else ".")
        rows = [form.cells(line.rstrip(delimiter)) for line in lines]
        numeric = [row for row in rows if len(row) > _FEWEST_ACROSS and all(map(form.is_value, row[1:]))]
        named = all(row[0] and not form.is_value(row[0]) for row in numeric)
        if len(numeric) == len(rows) and named and len({len(row) for row in numeric}) == 1:
            notes.append(f"Each channel of {name} is a row; it was read with rows and columns exchanged.")
            return [_joined(cells, form) for cells in zip(*numeric, strict=True)]
    return everything


def _values(
    lines: list[str],
    width: int,
    form: TextForm,
    names: tuple[str, ...],
    header: list[str],
    line_of: Callable[[int], int],
    name: str,
) -> tuple[FloatArray, list[int] | None, tuple[int, ...]]:
    """Numbers, rows kept (None = all) and rows before which the header was repeated."""
    plain = [line.replace(",", ".") for line in lines] if form.decimal == "," and form.delimiter != "," else lines
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


def _cell(cell: str, form: TextForm, where: str, column: str) -> float:
    if cell.lower() in MISSING:
        return np.nan
    number = float(form.plain(cell).replace("D", "e").replace("d", "e")) if form.is_number(cell) else np.nan
    if np.isfinite(number):
        return number
    if np.isinf(number) or INFINITE.match(cell):
        raise BenchError(
            f"{where}: column {column} is infinite ({cell}); leave the cell empty if the value is missing."
        )
    comma = form.decimal == "." and re.fullmatch(r"[-+]?\d*,\d+", cell) is not None
    hint = "decimal comma among decimal points" if comma else "text in a column of numbers"
    raise BenchError(f"{where}: column {column} has '{cell[:30]}' ({hint}); fix it or leave it empty if it is missing.")
