"""The byte codecs of the sample path against rclpy's own serialisation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message

from nmt_core.blocks import OscillatorPhase, Quantity, SampleBlock
from nmt_core.conversions import block_from_message, fill_block
from nmt_core.wire import (
    BlockReader,
    BlockWriter,
    LoopStatus,
    PlainDrive,
    read_drive,
    read_status,
    write_drive,
    write_status,
)
from nmt_msgs.msg import Drive, Frequency
from nmt_msgs.msg import SampleBlock as SampleBlockMessage

finite = st.floats(allow_nan=False, width=64)
names = st.text(st.characters(min_codepoint=48, max_codepoint=122), min_size=1, max_size=9)


@st.composite
def blocks(draw: st.DrawFn) -> SampleBlock:
    channels = draw(st.lists(names, min_size=1, max_size=5, unique=True))
    samples = draw(st.integers(1, 7))
    data = draw(st.lists(finite, min_size=len(channels) * samples, max_size=len(channels) * samples))
    return SampleBlock(
        draw(st.integers(0, 2**31 - 1)),
        draw(st.sampled_from([1.0, 10_000.0, 51_200.0])),
        draw(st.sampled_from(Quantity)),
        draw(st.sampled_from(["", "N", "m/s^2"])),
        tuple(channels),
        tuple(draw(st.lists(st.integers(0, 2**32 - 1), min_size=len(channels), max_size=len(channels)))),
        np.array(data).reshape(len(channels), samples),
        OscillatorPhase(draw(finite), draw(finite), draw(finite)),
        draw(st.integers(0, 255)),
    )


def same(a: SampleBlock, b: SampleBlock) -> bool:
    scalars = ("first_sample", "sample_rate", "quantity", "unit", "channels", "points", "oscillator", "flags")
    return all(getattr(a, name) == getattr(b, name) for name in scalars) and np.array_equal(a.data, b.data)


@given(st.lists(blocks(), min_size=1, max_size=4), names)
@settings(max_examples=60, deadline=None)
def test_blocks_are_what_rclpy_serialises_and_read_back(sequence: list[SampleBlock], frame: str) -> None:
    writer, reader = BlockWriter(frame), BlockReader()
    for block in sequence:
        raw = writer.write(block)
        message = fill_block(SampleBlockMessage(), block, frame)
        expected = serialize_message(message)
        # Padding bytes are whatever the serialiser leaves there; everything else must agree.
        assert len(raw) == len(expected)
        assert deserialize_message(raw, SampleBlockMessage) == message
        assert same(reader.read(expected), block)
        assert same(block_from_message(deserialize_message(raw, SampleBlockMessage)), block)


@given(blocks(), st.data())
@settings(max_examples=60, deadline=None)
def test_a_cut_block_is_refused(block: SampleBlock, data: st.DataObject) -> None:
    raw = BlockWriter("rig").write(block)
    reader = BlockReader()
    if data.draw(st.booleans()):
        reader.read(raw)
    with pytest.raises(ValueError, match=r"not a whole|runs past|more channels|divide|little-endian|Quantity"):
        reader.read(raw[: data.draw(st.integers(0, len(raw) - 1))])


def test_drive_is_what_rclpy_serialises_and_reads_back() -> None:
    drive = PlainDrive(1200, 999, Drive.SWEEP, 22.5, 0.25, 0.5, 1.0, 2.0, -0.2, 20.0)
    message = Drive(
        apply_at_sample=1200, based_on_sample=999, waveform=Drive.SWEEP, frequency_hz=22.5, amplitude=0.25, ramp=0.5,
        band_low_hz=1.0, band_high_hz=2.0, rate_hz_s=-0.2, frequency_end_hz=20.0,
    )  # fmt: skip
    message.stamp.nanosec = 99_900_000
    assert deserialize_message(write_drive(drive, 10_000.0), Drive) == message
    assert len(write_drive(drive, 10_000.0)) == len(serialize_message(message))
    assert read_drive(serialize_message(message)) == drive


def test_drive_with_harmonics_is_left_to_rclpy() -> None:
    message = Drive(harmonics=[3], harmonics_real=[0.1], harmonics_imag=[0.0])
    assert read_drive(serialize_message(message)) is None


@given(st.text(max_size=40), st.sampled_from(["m", "m/s^2", ""]))
@settings(max_examples=40, deadline=None)
def test_status_is_what_rclpy_serialises_and_reads_back(reason: str, unit: str) -> None:
    reason = reason.replace("\x00", "")
    status = LoopStatus(19_999, 3, 4, 2, 22.1, -0.01, 1.5, 2e-4, unit, 0.3, 5, reason)
    message = Frequency(
        last_sample=19_999, level_index=3, level_sequence=4, state=2, frequency_hz=22.1, phase_error=-0.01,
        force_amplitude=1.5, response_amplitude=2e-4, response_unit=unit, drive_amplitude=0.3, flags=5, reason=reason,
    )  # fmt: skip
    message.stamp.sec, message.stamp.nanosec = 1, 999_900_000
    expected = serialize_message(message)
    raw = write_status(status, 10_000.0)
    assert len(raw) == len(expected)
    assert deserialize_message(raw, Frequency) == message
    assert read_status(expected) == status
    with pytest.raises(ValueError, match=r"whole|past"):
        read_status(expected[: len(raw) // 2])


def test_nan_survives() -> None:
    status = LoopStatus(0, 0, 0, 1, 0.0, math.nan, 0.0, 0.0, "m", 0.0)
    assert math.isnan(read_status(write_status(status, 1e4)).phase_error)
