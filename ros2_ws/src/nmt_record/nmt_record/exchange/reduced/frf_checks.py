"""Do frequency responses have the sign and the convention of phase that the bench means? Their resonance tells.

With x(t) = Re ψ exp(iωt) the phase of every response falls as the frequency passes a resonance. At the resonance of a
drive point the force does work: velocity is in phase with it, displacement lags by 90°, acceleration leads by 90°.
Over the acceleration of a base it is the other way round, because the load is −m a.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_record.exchange.reduced.observables import ObservableTable
from nmt_record.exchange.sidecar.import_sidecar import TableKind, TableSection

ShapeSign = Callable[[int, int, float], float]
"""Sign of a response at its resonance by the model: point, drive point, frequency in Hz; 0 where it is not known."""

_FEWEST_LINES = 5
_NEAR = 0.3  # of the largest magnitude: lines that the resonance rules
_LEAST_TURN = 0.8  # rad
_WRONG = math.radians(120.0)


def check_responses(section: TableSection, table: ObservableTable, place: str, sign: ShapeSign) -> None:
    """Refuse frequency responses of the other convention or sign, unless the sidecar states that they are meant so.

    Args:
        section: what the sidecar says; ``conjugate``, ``scale`` or ``turned`` in it, whatever the value, ends a check.
        table: as read.
        place: of the segment in the sidecar, for messages.
        sign: what the model says.

    Raises:
        BenchError: with the key that fixes it.
    """
    if (
        table.kind != TableKind.FRF
        or not table.phase_known
        or table.quantity not in MOTIONS
        or table.reference not in ("force", "base")
    ):
        return
    frequency, response = _one_level(table)
    if frequency.size < _FEWEST_LINES:
        return
    peak = int(np.argmax(np.abs(response)))
    turn = _turn(response, peak)
    if abs(turn) < _LEAST_TURN:
        return
    source = f"dataset {table.dataset} of {table.source}" if table.dataset else table.source
    where = f"{place}: {source}: at the resonance near {frequency[peak]:.4g} Hz"
    if turn > 0.0 and "conjugate" not in section.model_fields_set:
        raise BenchError(
            f"{where} the phase rises with frequency, as in the convention exp(−iωt) or with a phase lag counted "
            "positive; write 'conjugate: true' (or 'conjugate: false' if it is meant so)."
        )
    if "scale" in section.model_fields_set or (table.dataset and section.turned is not None):
        return
    own = _expected_sign(table, float(frequency[peak]), sign)
    if own == 0.0:
        return
    quarter = 0.5 * math.pi * (MOTIONS[table.quantity] - 1)
    expected = own * cmath.exp(1j * quarter) * (-1.0 if table.reference == "base" else 1.0)
    off = abs(cmath.phase(complex(response[peak]) / expected))
    if off > _WRONG:
        other = "base" if table.reference == "base" else "force"
        # A universal file has many points, and one sensor may be the wrong way round.
        keys = f"'turned: [{table.point}]' (or 'turned: []'" if table.dataset else "'scale: -1' (or 'scale: 1'"
        raise BenchError(
            f"{where} the response has a phase of {math.degrees(cmath.phase(complex(response[peak]))):.0f}° to the "
            f"{other}, where {math.degrees(cmath.phase(expected)):.0f}° belong: a sensor is the other way round; write "
            f"{keys} if it is meant so)."
        )


def _one_level(table: ObservableTable) -> tuple[FloatArray, np.ndarray]:
    """Lines of the lowest level, by frequency."""
    frequency = table.columns["frequency_hz"]
    response = table.responses
    level = table.columns.get("level")
    mine = np.ones(frequency.size, dtype=bool) if level is None else level == np.nanmin(level)
    order = np.argsort(frequency[mine], kind="stable")
    return frequency[mine][order], response[mine][order]


def _turn(response: np.ndarray, peak: int) -> float:
    """Phase over the lines around the peak that it rules, rad."""
    strong = np.abs(response) > _NEAR * np.abs(response[peak])
    first = peak - int(np.argmin(strong[peak::-1])) + 1 if not strong[: peak + 1].all() else 0
    last = peak + int(np.argmin(strong[peak:])) - 1 if not strong[peak:].all() else response.size - 1
    # One line more on either side: a sharp resonance has few.
    near = response[max(0, first - 1) : last + 2]
    return float(np.sum(np.angle(near[1:] * np.conj(near[:-1]))))


def _expected_sign(table: ObservableTable, frequency_hz: float, sign: ShapeSign) -> float:
    """+1 at a drive point; elsewhere what the model says."""
    if table.reference == "force" and (table.point or table.drive_point) == (table.drive_point or table.point):
        return 1.0
    return sign(table.point, table.drive_point, frequency_hz)
