"""The codecs against rclpy's own serialisation."""

from __future__ import annotations

import math
from array import array
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from core.message_records import READ, RECORDS, WRITE, blocks, same, values_of
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message

from nmt_core.messages.blocks import SampleBlock
from nmt_core.messages.cdr import bench_stamp
from nmt_core.messages.modal_point import COMPLEX
from nmt_core.messages.records import LoopStatus
from nmt_core.messages.wire import (
    BlockReader,
    BlockWriter,
    NodeStatus,
    read_diagnostics,
    read_status,
    write_diagnostics,
    write_status,
)
from nmt_msgs import msg

names = st.text(st.characters(min_codepoint=48, max_codepoint=122), min_size=1, max_size=9)


def rclpy_message(name: str, values: dict[str, Any]) -> Any:
    """The message that rclpy has for these field values."""
    message = getattr(msg, name)()
    for field, kind in message.get_fields_and_field_types().items():
        value = values[field]
        if field == "stamp":
            message.stamp.sec, message.stamp.nanosec = divmod(value, 10**9)
        elif kind == "sequence<double>":
            setattr(message, field, array("d", np.ascontiguousarray(value, dtype=np.float64).tobytes()))
        elif kind == "sequence<uint32>":
            setattr(message, field, array("I", value))
        else:
            as_it_is = kind in ("string", "boolean")
            setattr(message, field, float(value) if kind == "double" else value if as_it_is else int(value))
    return message


@pytest.mark.parametrize(("name", "strategy"), RECORDS.items())
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_records_are_what_rclpy_serialises_and_reads_back(name: str, strategy: Any, data: st.DataObject) -> None:
    record = data.draw(strategy)
    expected = bytes(serialize_message(rclpy_message(name, values_of(record))))
    raw = WRITE[name](record)
    # Padding bytes are whatever the serialiser leaves there; rclpy ends with whole words of four bytes and reserves
    # some more for every empty sequence of numbers of eight bytes; everything else must agree.
    empty = sum(getattr(record, item).size == 0 for item in COMPLEX) if name == "ModalPoint" else 0
    empty += sum(not items for items in (record.peak, record.rms)) if name == "Monitor" else 0
    empty += sum(not items for items in (record.levels, record.frequencies_hz)) if name == "Steering" else 0
    empty += (
        sum(2 * all(term.relative != kind for term in record.terms) for kind in (False, True)) if name == "Drive" else 0
    )
    assert len(raw) <= len(expected) <= len(raw) + -len(raw) % 4 + 8 * empty
    assert same(READ[name](expected), record)
    again = bytes(serialize_message(deserialize_message(raw, getattr(msg, name))))
    assert same(READ[name](again), record)


@settings(max_examples=60, deadline=None)
@given(name=names, message=names, values=st.dictionaries(names, names | st.integers(), max_size=4))
def test_a_heartbeat_is_what_rclpy_serialises_and_reads_back(
    name: str, message: str, values: dict[str, object]
) -> None:
    status = NodeStatus(name, "host process 1 node 1", DiagnosticStatus.WARN, message, values)
    raw = write_diagnostics(status, 3_000_000_007)
    array = deserialize_message(raw, DiagnosticArray)
    assert (array.header.stamp.sec, array.header.stamp.nanosec, array.header.frame_id) == (3, 7, "")
    told = replace(status, values={key: str(value) for key, value in values.items()})
    assert read_diagnostics(bytes(serialize_message(array))) == [told]
    for end in range(len(raw)):
        with pytest.raises(ValueError, match=r"DiagnosticArray|XCDR1"):
            read_diagnostics(raw[:end])


def block_message(block: SampleBlock, frame: str) -> Any:
    """The block as rclpy's message."""
    message = msg.SampleBlock()
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = bench_stamp(block.first_sample, block.sample_rate)
    message.first_sample, message.sample_rate = block.first_sample, block.sample_rate
    message.quantity, message.unit = int(block.quantity), block.unit
    message.channels, message.points = list(block.channels), array("I", block.points)
    message.data = array("d", block.data.tobytes())
    message.oscillator_cycles, message.oscillator_frequency_hz, message.oscillator_rate_hz_s = block.oscillator
    message.flags = block.flags
    return message


@given(st.lists(blocks(), min_size=1, max_size=4), names)
@settings(max_examples=60, deadline=None)
def test_blocks_are_what_rclpy_serialises_and_read_back(sequence: list[SampleBlock], frame: str) -> None:
    writer, reader = BlockWriter(frame), BlockReader()
    for block in sequence:
        raw = writer.write(block)
        expected = bytes(serialize_message(block_message(block, frame)))
        assert len(raw) == len(expected)
        assert same(reader.read(expected), block)
        assert same(reader.read(bytes(serialize_message(deserialize_message(raw, msg.SampleBlock)))), block)


@given(blocks(), st.data())
@settings(max_examples=60, deadline=None)
def test_a_cut_block_is_refused(block: SampleBlock, data: st.DataObject) -> None:
    raw = BlockWriter("rig").write(block)
    reader = BlockReader()
    if data.draw(st.booleans()):
        reader.read(raw)
    with pytest.raises(ValueError, match=r"not a whole|past|more |divide|little-endian|Quantity"):
        reader.read(raw[: data.draw(st.integers(0, len(raw) - 1))])


def test_nan_survives() -> None:
    status = LoopStatus(0, 0, 0, 1, 0.0, math.nan, 0.0, 0.0, "m", 0.0)
    assert math.isnan(read_status(write_status(status, 1e4)).phase_error)
