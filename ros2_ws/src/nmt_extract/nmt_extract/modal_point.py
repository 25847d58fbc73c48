"""The modal properties of one level, and the point of a window that must not be used."""

from __future__ import annotations

from nmt_core.messages.cdr import bench_time_ns
from nmt_core.messages.modal_point import COMPLEX, EVALUATED, MEASURED, QUANTITIES, ModalPoint
from nmt_core.messages.records import LockEvent
from nmt_core.vocabulary import PointStatus as Status

__all__ = [
    "COMPLEX",
    "EVALUATED",
    "MEASURED",
    "QUANTITIES",
    "ModalPoint",
    "Status",
    "bench_time_ns",
    "rejected_point",
]


def rejected_point(lock: LockEvent, sample_rate: float, reason: str) -> ModalPoint:
    """The point of a window that must not be used."""
    return ModalPoint(
        level_index=lock.level_index,
        status=Status.REJECTED,
        reason=reason,
        level=lock.level,
        level_unit=lock.level_unit,
        time_ns=bench_time_ns(max(0, lock.window_end - 1), sample_rate),
        window_first_sample=lock.window_first_sample,
        window_samples=lock.window_samples,
        window_periods=lock.window_periods,
        held_phase=lock.held_phase,
        parameter=lock.parameter,
    )
