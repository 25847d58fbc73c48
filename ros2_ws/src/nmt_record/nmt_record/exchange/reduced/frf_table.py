"""Reads ``frf.csv``: frequency responses of linear tests and sweeps, one column pair a channel."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_rows
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import QUANTITIES

# a2 of a sweep; a2_f1_hv of a linear test. Responses over the voltage are no mechanical frequency responses.
_COLUMN = re.compile(r"([xva])(\d+)(?:_f(\d*))?(?:_(hc|hv|h1|h2))?_real")
_ESTIMATORS = ("hc", "hv", "h1", "h2", "")


@dataclass(frozen=True, eq=False)
class FrequencyResponseRecord:
    """Response over force at one point.

    Attributes:
        name: channel, with the force and the level where there are several.
        quantity: of the response.
        point: of the response.
        drive_point: of the force; 0 = not known.
        frequency_hz: Hz, shape ``(lines,)``.
        values: SI units, complex, shape ``(lines,)``.
        estimator: of a linear test; empty for a sweep.
    """

    name: str
    quantity: Quantity
    point: int
    drive_point: int
    frequency_hz: FloatArray
    values: NDArray[Any]
    estimator: str = ""


def read_frf_table(path: Path, drive_point: int = 0) -> list[FrequencyResponseRecord]:
    """Frequency responses of the ``frf.csv`` of a linear test or a sweep.

    Of several estimators of one channel the first of H_c, H_v, H_1, H_2 is taken. Each level of a sweep is a response
    of its own.

    Args:
        path: the table.
        drive_point: of the force, where the table does not name it.

    Raises:
        BenchError: no such file or no such columns.
    """
    rows = read_rows(path, "table of frequency responses")
    head = rows[0] if rows else []
    if "frequency_hz" not in head:
        raise BenchError(f"{path} is not a table of frequency responses: it has no column frequency_hz.")
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(head):
            raise BenchError(f"{path} line {number} has {len(row)} values instead of {len(head)}; make it again.")
    text = dict(zip(head, zip(*rows[1:], strict=True), strict=True)) if len(rows) > 1 else {}
    chosen = _chosen(head)
    if not chosen or not text:
        raise BenchError(f"{path} has no frequency responses: no rows, or no columns such as a2_real and a2_imag.")

    def numbers(name: str) -> FloatArray:
        try:
            values = [float(cell) if cell else math.nan for cell in text[name]]
        except ValueError as error:
            raise BenchError(f"{path}: column {name} holds something else than numbers ({error}).") from error
        return np.array(values, dtype=np.float64)

    frequency = numbers("frequency_hz")
    responses = []
    for suffix, group in _levels(text, len(rows) - 1):
        for name, (channel, column, force, estimator) in chosen.items():
            values = numbers(column) + 1j * numbers(column.removesuffix("_real") + "_imag")
            good = group & np.isfinite(frequency) & np.isfinite(values)
            if good.sum() < 2:
                continue
            responses.append(
                FrequencyResponseRecord(
                    name + suffix,
                    QUANTITIES[channel[0]],
                    int(channel[1:]),
                    force or drive_point,
                    frequency[good],
                    values[good],
                    estimator,
                )
            )
    return responses


def _chosen(head: list[str]) -> dict[str, tuple[str, str, int, str]]:
    """Name -> channel, column of its real part, drive point, estimator; several forces stand in the name."""
    found: dict[tuple[str, str], dict[str, str]] = {}
    for name in head:
        match = _COLUMN.fullmatch(name)
        if match is None or name.removesuffix("_real") + "_imag" not in head:
            continue
        letter, point, force, estimator = match.groups(default="")
        found.setdefault((letter + point, force), {})[estimator] = name
    several = len({force for _, force in found}) > 1
    chosen = {}
    for (channel, force), columns in found.items():
        best = next(estimator for estimator in _ESTIMATORS if estimator in columns)
        name = f"{channel}_f{force}" if several else channel
        chosen[name] = channel, columns[best], int(force or 0), best
    return chosen


def _levels(text: dict[str, tuple[str, ...]], rows: int) -> list[tuple[str, NDArray[np.bool_]]]:
    """Name and rows of each level of a sweep; all rows of a linear test."""
    if "segment" not in text:
        return [("", np.ones(rows, dtype=bool))]
    groups = []
    for segment in dict.fromkeys(text["segment"]):
        mask = np.array([cell == segment for cell in text["segment"]])
        first = int(np.argmax(mask))
        level = " ".join(text[name][first] for name in ("level", "level_unit") if name in text)
        groups.append((f" {level}" if level else "", mask))
    return groups
