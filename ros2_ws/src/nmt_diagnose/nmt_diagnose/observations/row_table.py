"""Collects observables row by row."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nmt_diagnose.observations.conditions import Test
from nmt_diagnose.observations.observables import Observations, Part, Rows


class Place(NamedTuple):
    """What the rows of one level have in common; see :class:`nmt_diagnose.observations.observables.Rows`."""

    level: int
    time_s: float
    frequency_hz: float
    amplitude: float


class RowTable:
    """Observables of one test, in the order in which they are added."""

    def __init__(self) -> None:
        self._identity: list[tuple[float, ...]] = []
        self._numbers: list[tuple[float, float, float]] = []

    def __len__(self) -> int:
        return len(self._numbers)

    def add(
        self, part: Part, value: float, std: float, floor: float, place: Place, channel: int = -1, harmonic: int = -1
    ) -> None:
        """One observable; channel and harmonic are −1 where it belongs to none."""
        self._identity.append(
            (place.level, channel, harmonic, int(part), place.time_s, place.frequency_hz, place.amplitude)
        )
        self._numbers.append((value, std, floor))

    def observations(self, test: Test, notes: Sequence[str] = ()) -> Observations:
        """The rows as observations of one test; rows that are not finite are left out."""
        identity = np.array(self._identity, dtype=np.float64).reshape(-1, 7)
        numbers = np.array(self._numbers, dtype=np.float64).reshape(-1, 3)
        level, channel, harmonic, part = (identity[:, column].astype(np.int64) for column in range(4))
        time_s, frequency_hz, amplitude = (identity[:, column].copy() for column in (4, 5, 6))
        number = np.zeros(len(self), dtype=np.int64)
        rows = Rows(number, level, channel, harmonic, part, time_s, frequency_hz, amplitude)
        result = Observations((test,), rows, numbers[:, 0], numbers[:, 1], numbers[:, 2], tuple(notes))
        usable: NDArray[np.bool_] = np.asarray(np.isfinite(numbers).all(axis=1))
        return result if usable.all() else result.take(usable)


def empty(notes: Sequence[str] = ()) -> Observations:
    """No observables, only notes."""
    integers, real = np.zeros(0, dtype=np.int64), np.zeros(0)
    rows = Rows(integers, integers, integers, integers, integers, real, real, real)
    return Observations((), rows, real, real, real, tuple(notes))
