"""How a text writes its columns: separator, decimal sign, thousands, quotes, and which columns hold words."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from nmt_core.errors import BenchError
from nmt_record.exchange.clocks.text_stamps import is_date, is_stamp

MISSING = frozenset({"", "nan", "na", "n/a", "#n/a", "null", "none"})
INFINITE = re.compile(r"[-+]?inf(inity)?$", re.I)
_NUMBER = {
    ".": re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eEdD][-+]?\d+)?$"),
    ",": re.compile(r"[-+]?(\d+,?\d*|,\d+)([eEdD][-+]?\d+)?$"),
}
# Digits in groups of three that no decimal sign explains, and those that one may explain.
_GROUPED = {
    ".": re.compile(r"[-+]?\d{1,3}(,\d{3})+\.\d*$|[-+]?\d{1,3}(,\d{3}){2,}$"),
    ",": re.compile(r"[-+]?\d{1,3}(\.\d{3})+,\d*$|[-+]?\d{1,3}(\.\d{3}){2,}$"),
}
_ONE_GROUP = {".": re.compile(r"[-+]?\d{1,3},\d{3}$"), ",": re.compile(r"[-+]?\d{1,3}\.\d{3}$")}
_FORMS: tuple[tuple[str | None, str], ...] = (
    (";", "."), (";", ","), ("\t", "."), ("\t", ","), (",", "."), (None, "."), (None, ","), (",", ","), ("|", "."),
)  # fmt: skip
_NUMERIC_SHARE = 0.9  # of the cells of a column of numbers; the others are missing or a heading's
_FEWEST_ROWS = 3


@dataclass(frozen=True)
class TextForm:
    """How the lines of a text are read.

    Attributes:
        delimiter: between columns; None = spaces.
        decimal: sign.
        grouped: one group of three digits behind the other sign is one of thousands.
        words: columns that hold no numbers.
        width: number of columns of a table with such; 0 = not fixed.
    """

    delimiter: str | None
    decimal: str
    grouped: bool = False
    words: frozenset[int] = frozenset()
    width: int = 0

    def cells(self, line: str) -> list[str]:
        """Cells of a line without spaces and quotes around them."""
        if '"' in line:
            rows = list(csv.reader([line], delimiter=self.delimiter or " ", skipinitialspace=True))
            parts = rows[0] if rows else []
        else:
            parts = line.split() if self.delimiter is None else line.split(self.delimiter)
        return [part.strip().strip('"').strip() for part in parts]

    def is_number(self, cell: str) -> bool:
        """Whether a cell is a number as this form writes them."""
        if _NUMBER[self.decimal].match(cell) or _GROUPED[self.decimal].match(cell):
            return True
        return self.grouped and _ONE_GROUP[self.decimal].match(cell) is not None

    def plain(self, cell: str) -> str:
        """A number as Python writes it."""
        if _NUMBER[self.decimal].match(cell):
            return cell.replace(",", ".") if self.decimal == "," else cell
        return cell.replace(",", "") if self.decimal == "." else cell.replace(".", "").replace(",", ".")

    def is_value(self, cell: str) -> bool:
        """Whether a cell is a number or a stamp."""
        return self.is_number(cell) or is_stamp(cell)

    def numeric(self, line: str) -> bool:
        """Whether a line is one of values."""
        cells = self.cells(line)
        if self.width and len(cells) != self.width:
            return False
        cells = [cell for i, cell in enumerate(cells) if i not in self.words]
        present = [cell for cell in cells if cell.lower() not in MISSING and not INFINITE.match(cell)]
        return (
            bool(present)
            and all(self.is_value(cell) or is_date(cell) for cell in present)
            and any(map(self.is_number, present))
        )


def form_of(lines: Sequence[str], name: str) -> TextForm:
    """The form under which most lines are numbers.

    Raises:
        BenchError: none, or nothing tells which of two.
    """
    sample = list(lines[:200]) + list(lines[200:4000:97])
    best, score = None, 0
    for delimiter, decimal in _FORMS:
        form = TextForm(delimiter, decimal)
        rows = [line for line in sample if (delimiter is None or delimiter in line) and form.numeric(line)]
        if len(rows) > score * 1.5:
            best, score = form, len(rows)
    if score < 0.5 * len(sample):
        best = _with_words(sample, score) or best
    if best is not None and best.delimiter == "," and not best.words and _one_column_of_decimal_commas(sample, name):
        best = TextForm(None, ",")
    if best is None:
        raise BenchError(
            f"{name} has no line of numbers; a CSV needs columns of numbers separated by ; or tab or comma, decimals "
            f"with a point."
        )
    return with_thousands(best, sample, name)


def _with_words(sample: Sequence[str], score: int) -> TextForm | None:
    """The form of a table some of whose columns hold words; None where no more lines than ``score`` are rows of one."""
    best: tuple[int, TextForm] | None = None
    for delimiter, decimal in _FORMS:
        form = TextForm(delimiter, decimal)
        rows = [form.cells(line) for line in sample if delimiter is None or delimiter in line]
        if not rows:
            continue
        width = Counter(map(len, rows)).most_common(1)[0][0]
        rows = [cells for cells in rows if len(cells) == width]
        filled = [[cells[i] for cells in rows if cells[i].lower() not in MISSING] for i in range(width)]
        shares = [sum(form.is_value(c) for c in column) / max(1, len(column)) for column in filled]
        words = frozenset(i for i, column in enumerate(filled) if column and shares[i] < 0.5 and not _dates(column))
        numbers = [i for i in range(width) if i not in words and filled[i]]
        if width < 2 or not numbers or min(shares[i] for i in numbers if not _dates(filled[i])) < _NUMERIC_SHARE:
            continue
        form = replace(form, words=words, width=width)
        found = sum(map(form.numeric, sample))
        weight = found * len(numbers)
        if found >= _FEWEST_ROWS and found > 1.5 * score and (best is None or weight > best[0]):
            best = weight, form
    return None if best is None else best[1]


def _dates(column: Sequence[str]) -> bool:
    return sum(map(is_date, column)) >= 0.5 * len(column)


def with_thousands(form: TextForm, lines: Sequence[str], name: str) -> TextForm:
    """The form, with thousands in groups where the text has some.

    Raises:
        BenchError: quoted numbers may have thousands or decimals behind their comma.
    """
    if form.delimiter == ",":
        lines = [line for line in lines if '"' in line]
    other = "," if form.decimal == "." or form.delimiter == "," else "."
    cells = [cell for line in lines if other in line for cell in form.cells(line)]
    if any(_GROUPED[form.decimal].match(cell) for cell in cells):
        return replace(form, grouped=True)
    if (form.delimiter, form.decimal) != (",", ","):
        return form
    with_comma = [cell for cell in cells if "," in cell and form.is_number(cell)]
    if any(not _ONE_GROUP["."].match(cell) or re.match(r"[-+]?0", cell) for cell in with_comma):
        return form
    if any(("." in cell and _NUMBER["."].match(cell)) or _GROUPED["."].match(cell) for cell in cells):
        return replace(form, decimal=".", grouped=True)
    example = with_comma[0] if with_comma else ""
    raise BenchError(
        f'{name} has quoted numbers such as "{example}", whose comma may stand before decimals or thousands; write '
        "decimals with a point and thousands without a sign."
    )


def _one_column_of_decimal_commas(lines: Sequence[str], name: str) -> bool:
    """Whether lines that look like two columns of whole numbers are one of numbers with a decimal comma.

    A heading then has one name, and the digits behind the comma are as many in every line.

    Raises:
        BenchError: nothing tells.
    """
    numbers = [line.strip() for line in lines if re.fullmatch(r"\s*[-+]?\d+,\d+\s*", line)]
    others = [line for line in lines if line.strip() and line.strip() not in numbers]
    heads = [line for line in others if not re.match(r"\s*[-+]?\d", line) and line.strip().lower() not in MISSING]
    empty = len(others) - len(heads)
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


def refuse_split_decimals(heads: list[list[str]], lines: Sequence[str], width: int, form: TextForm, name: str) -> None:
    """A comma-separated file without one decimal point, but with cells like 05, was written with decimal commas.

    Raises:
        BenchError: it was.
    """
    if form.delimiter != "," or any("." in line or '"' in line for line in lines[:200]):
        return
    cells = [cell for line in lines[:200] for i, cell in enumerate(form.cells(line)) if i not in form.words]
    if any(re.match(r"0\d+$", cell) for cell in cells):
        raise BenchError(
            f"{name} separates columns by commas and seems to write decimals with commas too (a cell reads "
            f"'{next(cell for cell in cells if re.match(r'0[0-9]', cell))}'); save it with ; as separator or with "
            f"decimal points."
        )
