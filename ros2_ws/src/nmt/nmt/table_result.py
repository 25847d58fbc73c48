"""Results that are one table of a command, as the command wrote it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nmt.results import Results, _axes, _column, _xarray
from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_rows

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TABLES = ("joints.csv", "decay.csv", "synthesis.csv", "secondary.csv", "study.csv")
"""Files that are opened so: of a robot's diagnosis, of ring-downs, of syntheses and of a study."""


@dataclass(frozen=True, repr=False)
class TableResult(Results):
    """A table of a robot's joints, of free decays, of a synthesis or of a study.

    Attributes:
        table: its lines, texts and numbers by the names of the columns.
    """

    table: tuple[dict[str, Any], ...] = ()

    @classmethod
    def read(cls, folder: Path) -> TableResult:
        """Read the first of :data:`TABLES` that is there.

        Raises:
            BenchError: damaged.
        """
        path = next(folder / name for name in TABLES if (folder / name).is_file())
        head, *lines = read_rows(path, "table") or [[]]
        if not head or any(len(line) != len(head) for line in lines):
            raise BenchError(f"{path} is not a table with the same columns in every line; make it again.")
        columns = {name: _numbers([line[at] for line in lines]) for at, name in enumerate(head)}
        return cls(folder, tuple({name: columns[name][row] for name in head} for row in range(len(lines))))

    def rows(self) -> list[dict[str, Any]]:
        """The lines of the file; a column that has numbers alone is one of numbers, empty cells are NaN."""
        return [dict(row) for row in self.table]

    def to_xarray(self) -> Any:
        """Every column over ``row`` as an ``xarray.Dataset``.

        Raises:
            BenchError: xarray is not installed.
        """
        names = self.table[0] if self.table else ()
        data = {name: ("row", _column([row[name] for row in self.table])) for name in names}
        return _xarray().Dataset(data, attrs={"folder": str(self.folder)})

    def plot(self, y: str = "", x: str = "", axes: Axes | None = None, **style: Any) -> Axes:
        """One column of numbers over another; left out = the last one over the first.

        Raises:
            BenchError: no such column exists of numbers.
        """
        numbers = [name for name, value in (self.table[0] if self.table else {}).items() if isinstance(value, float)]
        if not numbers or not {x, y} <= {"", *numbers}:
            raise BenchError(f"{self.folder} has no such columns of numbers; it has {', '.join(numbers) or 'none'}.")
        drawn = _axes(axes)
        across, up = x or numbers[0], y or numbers[-1]
        drawn.plot([row[across] for row in self.table], [row[up] for row in self.table], **{"marker": "o", **style})
        drawn.set_xlabel(across)
        drawn.set_ylabel(up)
        return drawn


def _numbers(cells: list[str]) -> list[Any]:
    try:
        return [float(cell) if cell else math.nan for cell in cells]
    except ValueError:
        return list(cells)
