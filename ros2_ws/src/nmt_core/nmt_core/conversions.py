"""Between messages and the bench's own types.

Reading works by attribute names alone, so it takes rclpy's messages and those of the ``rosbags`` reader alike: live
and offline evaluation see the same numbers, bit for bit.
"""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np

from nmt_core.blocks import OscillatorPhase, Quantity, SampleBlock
from nmt_core.wire import bench_stamp


def block_from_message(message: Any) -> SampleBlock:
    """Read ``nmt_msgs/SampleBlock`` (rclpy or rosbags) without copying the samples.

    Raises:
        ValueError: the data does not divide into the channels, or an index is not a number.
    """
    channels = tuple(message.channels)
    data = np.asarray(message.data, dtype=np.float64)
    if not channels or data.size % len(channels):
        raise ValueError(f"{data.size} values do not divide into {len(channels)} channels")
    return SampleBlock(
        first_sample=int(message.first_sample),
        sample_rate=float(message.sample_rate),
        quantity=Quantity(message.quantity),
        unit=message.unit,
        channels=channels,
        points=tuple(int(point) for point in message.points),
        data=data.reshape(len(channels), -1),
        oscillator=OscillatorPhase(
            float(message.oscillator_cycles),
            float(message.oscillator_frequency_hz),
            float(message.oscillator_rate_hz_s),
        ),
        flags=int(message.flags),
    )


def fill_block(message: Any, block: SampleBlock, frame_id: str) -> Any:
    """Write a block into a (reused) ``nmt_msgs/SampleBlock``; returns the message."""
    set_stamp(message.header.stamp, block.first_sample, block.sample_rate)
    message.header.frame_id = frame_id
    message.first_sample = int(block.first_sample)
    message.sample_rate = float(block.sample_rate)
    message.quantity = int(block.quantity)
    message.unit = block.unit
    message.channels = list(block.channels)
    message.points = array("I", block.points)
    message.data = float_array(block.data)
    message.oscillator_cycles = float(block.oscillator.cycles)
    message.oscillator_frequency_hz = float(block.oscillator.frequency_hz)
    message.oscillator_rate_hz_s = float(block.oscillator.rate_hz_s)
    message.flags = int(block.flags)
    return message


def float_array(values: Any) -> array[float]:
    """``array('d')`` of any float64 array-like in C order: the fast way into a ``float64[]`` field."""
    return array("d", np.ascontiguousarray(values, dtype=np.float64).tobytes())


def set_stamp(stamp: Any, sample: int, sample_rate: float) -> None:
    """Set a ``builtin_interfaces/Time`` to the bench time of a sample, exact to the nanosecond."""
    stamp.sec, stamp.nanosec = bench_stamp(sample, sample_rate)
