"""Columns of the measurement files of LabVIEW: LVM and TDMS."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.hardened import LARGEST_TABLE, open_regular
from nmt_core.numerics.arrays import FloatArray
from nmt_record.exchange.source_table import SourceTable
from nmt_record.exchange.text.text_table import decoded

_TDMS_STEP = rb"wf_increment\x0a\x00\x00\x00(.{8})"  # name of the property, type (double) and value


def read_lvm(path: Path) -> SourceTable:
    """Texts of LabVIEW, by lvm-read; one section with one clock. Its time columns stand behind the channels.

    Raises:
        BenchError: the file cannot be read as such, or has sections or steps of several kinds.
    """
    import lvm_read

    name, notes = path.name, list[str]()
    with open_regular(path, "table", LARGEST_TABLE // 2) as file:
        text = decoded(file.read(LARGEST_TABLE), name, notes)
    try:
        content = lvm_read.read_str(text.replace("\r\n", "\n"))
        sections = [content[number] for number in range(content["Segments"])]
        largest = max(sections, key=lambda item: item["data"].size)
        alike = [one for one in sections if _same_clock(one, largest)]
        section, notes_on = alike[0], len(sections) - len(alike)
        pieces = [np.asarray(one["data"], dtype=np.float64) for one in alike]
        data = np.concatenate(pieces)
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
        apart = f"; {notes_on} of other steps or channels were left out: save them apart" if notes_on else ""
        notes.append(
            f"{name} has {len(sections)} sections; {len(alike)} of one clock stand one after the other{apart}."
        )
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
    # The clock of each section begins anew.
    every = [np.ascontiguousarray(data[:, place]) for place in clocks if len(alike) == 1]
    times = [time for time in every if np.isfinite(time).all()]  # empty cells are no clock
    units = [*(units[:count] if len(units) >= count else [""] * count), *["s"] * len(times)]
    labels = ["X_Value" if len(times) < 2 else f"X_Value.{number + 1}" for number in range(len(times))]
    return SourceTable(
        name,
        (*names, *labels),
        (*columns, *times),
        tuple(units),
        notes=notes,
        start=starts[0] if starts and len(alike) == 1 else 0.0,
        step=steps[0],
        stretches=_one_after_the_other(pieces) if len(alike) > 1 else (),
    )


def _same_clock(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether two sections have the same step and channels."""
    return all(list(map(str, one.get(key, []))) == list(map(str, other.get(key, []))) for key in (
        "Delta_X", "Channel names", "Y_Unit_Label"))  # fmt: skip


def _one_after_the_other(pieces: Sequence[FloatArray]) -> tuple[tuple[int, int], ...]:
    ends = np.cumsum([piece.shape[0] for piece in pieces]).tolist()
    return tuple(zip([0, *ends[:-1]], ends, strict=True))


def read_tdms(path: Path) -> SourceTable:
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
    # The reader keeps the last value of a property that changes from segment to segment.
    stated = {struct.unpack("<d", found)[0] for found in re.findall(_TDMS_STEP, path.read_bytes(), re.S)}
    if len(stated) > 1 and steps <= stated and len(groups) == 1:
        listed = " and ".join(f"{1.0 / step:g} Hz" for step in sorted(stated, reverse=True) if step > 0.0)
        raise BenchError(
            f"{name} changes its rate from segment to segment ({listed} in wf_increment); save the segments of each "
            "rate in a file of their own."
        )
    notes = [f"{name} has {len(groups)} groups; the largest was read."] if len(groups) > 1 else []
    step = steps.pop()
    return SourceTable(
        name, tuple(channel.name for channel in channels), columns, units, notes=notes,
        start=starts.pop() if step > 0.0 else None, step=step if step > 0.0 else None,
    )  # fmt: skip
