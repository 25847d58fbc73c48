"""History of the loop over a whole run, thinned as it grows."""

from __future__ import annotations

import math

import numpy as np

from nmt_bench.page.channels import FLOOR_SHARE, LEAST
from nmt_core.messages.records import LoopStatus
from nmt_core.numerics.arrays import FloatArray

_MOST = 2000
_COLUMNS = ("time", "frequency", "phase", "force", "response", "drive", "state", "level")


class LoopTrack:
    """Keeps at most ``_MOST`` states of the loop, evenly over the run: when it is full every second one goes."""

    def __init__(self) -> None:
        self._rows: list[tuple[float, ...]] = []
        self._every = 1
        self._count = 0

    def add(self, status: LoopStatus, sample_rate: float) -> None:
        """Take the state after a block."""
        self._count += 1
        if (self._count - 1) % self._every:
            return
        self._rows.append(
            (
                (status.last_sample + 1) / sample_rate,
                status.frequency_hz if status.frequency_hz > 0.0 else math.nan,
                math.degrees(status.phase_error),
                status.force_amplitude,
                status.response_amplitude,
                status.drive_amplitude,
                float(status.state),
                float(status.level_index),
            )
        )
        if len(self._rows) > _MOST:
            self._rows = self._rows[::2]
            self._every *= 2

    def arrays(self) -> dict[str, FloatArray]:
        """Time (s), frequency (Hz), phase error (°), force, response, drive (V), state, level; one value a block."""
        table = np.array(self._rows, dtype=np.float64).reshape(-1, len(_COLUMNS))
        for name in ("force", "response"):
            column = table[:, _COLUMNS.index(name)]
            largest = float(np.fmax.reduce(np.abs(column), initial=0.0))
            column[np.abs(column) < max(FLOOR_SHARE * largest, LEAST)] = np.nan
        return {f"track_{name}": table[:, number] for number, name in enumerate(_COLUMNS)}
