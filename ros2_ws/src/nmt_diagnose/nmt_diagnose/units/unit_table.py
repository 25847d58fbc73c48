"""Which recording is of which unit: a table with the columns recording, unit, and mounting, day, repeat where known."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_rows

SETTINGS = ("mounting", "day", "repeat")
_COLUMNS = ("recording", "unit", *SETTINGS)


@dataclass(frozen=True)
class UnitRecordings:
    """Recordings that are diagnosed together: of one unit at one setting.

    Attributes:
        unit: its name.
        setting: mounting, day and repeat in words, such as ``mounting 2``; empty where none is stated.
        recordings: bags or folders.
    """

    unit: str
    setting: str
    recordings: tuple[Path, ...]


def read_unit_table(path: Path) -> tuple[tuple[UnitRecordings, ...], str]:
    """Recordings by unit and setting, and which setting differs within units (the first of ``SETTINGS`` that does).

    Raises:
        BenchError: no such table, a recording that is not there, or fewer than two units.
    """
    rows = [[cell.strip() for cell in row] for row in read_rows(path, "table of units") if any(map(str.strip, row))]
    head = rows[0] if rows else []
    if not {"recording", "unit"} <= set(head) or not set(head) <= set(_COLUMNS) or len(set(head)) < len(head):
        raise BenchError(f"{path}: the first line must name the columns recording, unit, and {', '.join(SETTINGS)}.")
    found: dict[tuple[str, str], list[Path]] = {}
    values: dict[str, dict[str, set[str]]] = {name: {} for name in SETTINGS}
    for line, row in enumerate(rows[1:], start=2):
        if len(row) != len(head):
            raise BenchError(f"{path} line {line}: it has {len(row)} cells for {len(head)} columns.")
        cells = dict(zip(head, row, strict=True))
        recording = path.parent / cells["recording"]
        if not cells["recording"] or not cells["unit"] or not recording.exists():
            raise BenchError(f"{path} line {line}: it needs a unit and a recording that is there; fix the path.")
        for name in SETTINGS:
            values[name].setdefault(cells["unit"], set()).add(cells.get(name, ""))
        setting = ", ".join(f"{name} {cells[name]}" for name in SETTINGS if cells.get(name))
        found.setdefault((cells["unit"], setting), []).append(recording)
    if len({unit for unit, _ in found}) < 2:
        raise BenchError(f"{path}: a group needs recordings of two units or more.")
    varied = next((name for name in SETTINGS if any(len(different) > 1 for different in values[name].values())), "")
    groups = tuple(UnitRecordings(unit, setting, tuple(bags)) for (unit, setting), bags in found.items())
    return groups, varied
