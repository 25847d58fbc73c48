"""Columns of a file by name: one value or one for each joint in every row."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_arrays
from nmt_record.exchange.messages.ros_bag_table import bag_tables, is_bag, read_bag
from nmt_record.exchange.source_table import SourceTable
from nmt_record.exchange.text.text_table import read_text_table

Array = np.ndarray[Any, Any]

STAMP = "(time of the messages)"
"""Column of a bag's clock."""


def read_columns(path: Path) -> dict[str, Array]:
    """All columns of a log.

    Args:
        path: NPZ file, table of text, or bag of ROS 2.

    Returns:
        By name: N or N × J values, or a few for the whole log (gains), in the file's own units.

    Raises:
        BenchError: it cannot be read.
    """
    if not path.exists():
        raise BenchError(f"The log {path} does not exist.")
    if is_bag(path):
        return _of_bag(path)
    if path.suffix.lower() == ".npz":
        arrays = read_arrays(path, "log of joints")
        return {
            name: np.asarray(values, dtype=float) if values.dtype.kind in "fiub" else values
            for name, values in arrays.items()
        }
    return _of_table(read_text_table(path))


def _of_bag(path: Path) -> dict[str, Array]:
    """Fields of all topics that speak of joints, on the clock of one of them."""
    wanted = [name for table in bag_tables(path) for name in table.names if speaks_of_joints(name)]
    if not wanted:
        raise BenchError(f"The bag {path.name} has no positions of joints (sensor_msgs/JointState or control_msgs).")
    table = read_bag(path, wanted)
    columns = _of_table(table)
    rows = len(table.columns[0])
    step = table.step if table.step else 1.0 / float(table.sample_rate or 1.0)
    return {STAMP: (table.start or 0.0) + step * np.arange(rows), **columns}


def speaks_of_joints(name: str) -> bool:
    """Whether a field is a position, speed, effort or command of a joint."""
    return any(f"{word}." in name for word in ("position", "velocity", "effort", "positions", "velocities"))


def _of_table(table: SourceTable) -> dict[str, Array]:
    names = table.names or [f"column {number + 1}" for number in range(len(table.columns))]
    return {name: np.asarray(values, dtype=float) for name, values in zip(names, table.columns, strict=True)}
