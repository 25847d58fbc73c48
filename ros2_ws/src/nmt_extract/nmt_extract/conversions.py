"""Between messages and the extraction's own types; reads rclpy's and ``rosbags``' messages alike."""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np

from nmt_core.conversions import float_array
from nmt_extract.harmonics import ComplexArray
from nmt_extract.lock_event import LockEvent
from nmt_extract.modal_point import COMPLEX, MEASURED, ModalPoint, Status

_LEVEL_UNITS = {1: "V", 3: "N"}


def lock_event_from_message(message: Any) -> LockEvent:
    """Read ``nmt_msgs/LockEvent``."""
    return LockEvent(
        level_index=int(message.level_index),
        level=float(message.level),
        level_unit=str(message.level_unit),
        sample=int(message.sample),
        frequency_hz=float(message.frequency_hz),
        phase_error=float(message.phase_error),
        window_first_sample=int(message.window_first_sample),
        window_samples=int(message.window_samples),
        window_periods=int(message.window_periods),
    )


def level_unit(control: int) -> str:
    """Unit of a level by its ``control`` (``nmt_msgs/Level``); empty for a controlled response."""
    return _LEVEL_UNITS.get(control, "")


def fill_modal_point(message: Any, point: ModalPoint) -> Any:
    """Write a point into a (new) ``nmt_msgs/ModalPoint``; returns the message."""
    message.stamp.sec, message.stamp.nanosec = divmod(int(point.time_ns), 1_000_000_000)
    message.level_index = int(point.level_index)
    message.status = int(point.status)
    message.reason = point.reason
    message.level = float(point.level)
    message.level_unit = point.level_unit
    message.window_first_sample = int(point.window_first_sample)
    message.window_samples = int(point.window_samples)
    message.window_periods = int(point.window_periods)
    for name in MEASURED:
        setattr(message, name, float(getattr(point, name)))
        setattr(message, f"{name}_std", float(getattr(point, f"{name}_std")))
    message.harmonics = int(point.harmonics)
    message.points = array("I", point.points)
    for name in COMPLEX:
        values = getattr(point, name)
        setattr(message, f"{name}_real", float_array(values.real))
        setattr(message, f"{name}_imag", float_array(values.imag))
    return message


def modal_point_from_message(message: Any) -> ModalPoint:
    """Read ``nmt_msgs/ModalPoint``; the inverse of :func:`fill_modal_point`, bit for bit."""
    measured: dict[str, Any] = {
        name + suffix: float(getattr(message, name + suffix)) for name in MEASURED for suffix in ("", "_std")
    }
    arrays: dict[str, Any] = {name: _complex(message, name) for name in COMPLEX}
    harmonics = int(message.harmonics)
    shape = arrays["shape_harmonics"]
    arrays["shape_harmonics"] = shape.reshape((harmonics + 1, -1) if shape.size else (0, 0))
    return ModalPoint(
        level_index=int(message.level_index),
        status=Status(int(message.status)),
        reason=str(message.reason),
        level=float(message.level),
        level_unit=str(message.level_unit),
        time_ns=int(message.stamp.sec) * 1_000_000_000 + int(message.stamp.nanosec),
        window_first_sample=int(message.window_first_sample),
        window_samples=int(message.window_samples),
        window_periods=int(message.window_periods),
        harmonics=harmonics,
        points=tuple(int(point) for point in message.points),
        **measured,
        **arrays,
    )


def _complex(message: Any, name: str) -> ComplexArray:
    real = np.asarray(getattr(message, f"{name}_real"), dtype=np.float64)
    imag = np.asarray(getattr(message, f"{name}_imag"), dtype=np.float64)
    values = np.empty(real.shape, dtype=np.complex128)
    values.real, values.imag = real, imag
    return values
