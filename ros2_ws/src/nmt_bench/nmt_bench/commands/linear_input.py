"""A linear description that comes from a file, for loop and extraction."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_text
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription

if TYPE_CHECKING:
    from nmt_rig.rig import Rig


def read_linear(path: Path) -> LinearDescription:
    """Read a ``linear.json``, or the one in a folder of results.

    Raises:
        BenchError: no such file, or not a linear description.
    """
    path = path / "linear.json" if os.path.isdir(path) else path
    text = read_text(path, "linear description (linear.json)")
    try:
        return LinearDescription.from_json(text)
    except BenchError as error:
        raise BenchError(f"{path}: {error}") from error


def check_fits(linear: LinearDescription, rig: Rig, source: Path | str) -> None:
    """Refuse a description that belongs to another set-up.

    Raises:
        BenchError: another drive point, or a point without a sensor on this rig.
    """
    if linear.drive_point != rig.drive_point:
        raise BenchError(
            f"{source} was measured with the exciter at point {linear.drive_point}, but rig {rig.name} has it at point "
            f"{rig.drive_point}; make a new one with './nmt linear' or change --exciter."
        )
    sensors = rig.response_points(Quantity[rig.extraction.quantity.upper()])
    missing = [point for point in linear.points if point not in sensors]
    if missing:
        raise BenchError(
            f"{source} has shapes at point {', '.join(map(str, missing))}, where rig {rig.name} has no "
            f"{rig.extraction.quantity} sensor; make a new one with './nmt linear'."
        )
