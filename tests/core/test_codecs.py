"""The codecs against the message files: names, order and types of all fields, and the bytes that rosbags makes."""

from __future__ import annotations

import math
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from core.message_records import RATE, READ, RECORDS, WRITE, blocks, same, texts, values_of
from hypothesis import given, settings
from hypothesis import strategies as st

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import SampleBlock
from nmt_core.messages.cdr import bench_time_ns
from nmt_core.messages.message_files import message_fields
from nmt_core.messages.modal_point import COMPLEX, ModalPoint
from nmt_core.messages.records import (
    DriveCommand,
    DriveStop,
    DriveTerm,
    LevelCommand,
    LockEvent,
    LoopStatus,
    RunRecord,
    RunState,
    SignalLevels,
    Steering,
)
from nmt_core.messages.wire import (
    LEVEL,
    LOCK_EVENT,
    MODAL_POINT,
    RUN_RECORD,
    RUN_STATE,
    BlockReader,
    BlockWriter,
    read_drive,
    write_drive,
)
from nmt_core.vocabulary import ControlKind, PointStatus, Quantity, RecordKind, ResultCode, RunPhase, TestKind, Waveform
from nmt_record.bag.message_definitions import local_definitions

MESSAGES = Path(__file__).resolve().parents[2] / "ros2_ws" / "src" / "nmt_msgs" / "msg"


def fields_of(name: str) -> dict[str, str]:
    """Name and type of the fields in a message file, in order."""
    return dict(message_fields((MESSAGES / f"{name}.msg").read_text(encoding="utf-8")))


TERMS = ("exciters", "exciter_orders", "exciter_ratio_real", "exciter_ratio_imag")


@pytest.mark.parametrize(
    ("name", "record", "elsewhere"),
    [
        ("Drive", DriveCommand, {"stamp", "harmonics", "harmonics_real", "harmonics_imag", *TERMS}),
        ("Frequency", LoopStatus, {"stamp"}),
        ("Level", LevelCommand, set()),
        ("LockEvent", LockEvent, {"stamp"}),
        ("RunState", RunState, {"stamp"}),
        ("Steering", Steering, {"stamp"}),
        ("DriveStop", DriveStop, {"stamp"}),
        ("Monitor", SignalLevels, {"stamp", *(f"{q.topic}_{p}" for q in list(Quantity)[1:] for p in ("peak", "rms"))}),
        ("RunRecord", RunRecord, {"stamp"}),
        ("ModalPoint", ModalPoint, {"stamp", *(f"{n}_{p}" for n in COMPLEX for p in ("real", "imag"))}),
        (
            "SampleBlock",
            SampleBlock,
            {"header", "oscillator_cycles", "oscillator_frequency_hz", "oscillator_rate_hz_s"},
        ),
    ],
)
def test_records_have_the_fields_of_their_message(name, record, elsewhere):
    names = {item.name for item in fields(record)} if is_dataclass(record) else set(record._fields)
    in_message = set(fields_of(name))
    assert elsewhere <= in_message
    assert in_message - elsewhere == names - {"time_ns", "oscillator", "drive_point", "terms", *COMPLEX}


# --- the bytes -------------------------------------------------------------------------------------------------------


def rosbags_bytes(name: str, values: dict[str, Any]) -> bytes:
    """What rosbags, which knows the message files alone, makes of the field values."""
    store = local_definitions()
    kind = f"nmt_msgs/msg/{name}"
    store.definition(kind)
    types = store.typestore.types
    plain = {}
    for field, kind_of_field in fields_of(name).items():
        value = values[field]
        if field == "stamp":
            value = types["builtin_interfaces/msg/Time"](*divmod(value, 10**9))
        elif kind_of_field.endswith("[]") and kind_of_field != "string[]":
            value = np.ascontiguousarray(value, dtype=kind_of_field[:-2])
        plain[field] = value
    return bytes(store.typestore.serialize_cdr(types[kind](**plain), kind))


@pytest.mark.parametrize(("name", "strategy"), RECORDS.items())
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_bytes_of_random_records(name, strategy, data):
    record = data.draw(strategy)
    raw = WRITE[name](record)
    assert raw == rosbags_bytes(name, values_of(record))
    assert same(READ[name](raw), record)


@settings(max_examples=60, deadline=None)
@given(blocks(), texts)
def test_blocks(block, rig):
    raw = BlockWriter(rig).write(block)
    store = local_definitions()
    store.definition("nmt_msgs/msg/SampleBlock")
    types = store.typestore.types
    stamp = types["builtin_interfaces/msg/Time"](*divmod(bench_time_ns(block.first_sample, block.sample_rate), 10**9))
    cycles, frequency, rate = block.oscillator
    values = {
        "header": types["std_msgs/msg/Header"](stamp, rig), "first_sample": block.first_sample,
        "sample_rate": block.sample_rate, "quantity": int(block.quantity), "unit": block.unit,
        "channels": list(block.channels), "points": np.array(block.points, np.uint32), "data": block.data.ravel(),
        "oscillator_cycles": cycles, "oscillator_frequency_hz": frequency, "oscillator_rate_hz_s": rate,
        "flags": block.flags,
    }  # fmt: skip
    kind = "nmt_msgs/msg/SampleBlock"
    assert raw == bytes(store.typestore.serialize_cdr(types[kind](**values), kind))
    again = BlockReader().read(raw)
    assert np.array_equal(again.data, block.data)
    for name in ("first_sample", "sample_rate", "quantity", "unit", "channels", "points", "oscillator", "flags"):
        assert same(getattr(again, name), getattr(block, name))


# --- what is damaged, old or unknown ---------------------------------------------------------------------------------

LOCK = LockEvent(3, 0.4, "N", 1999, 21.5, 0.01, 2000, 930, 2, TestKind.SWEEP, 199_900_000)
ORDER = LevelCommand(2, 1, 0.5, 400, 0.1, ControlKind.FORCE, 20.0, 30, 5.0, TestKind.SWEEP, 0.0, 0.0, 1.0, 30.0)


@pytest.mark.parametrize(
    ("codec", "record"),
    [
        (LEVEL, ORDER),
        (LOCK_EVENT, LOCK),
        (RUN_STATE, RunState("run", RunPhase.DONE, 1, 2, 0.5, 1.0, 100, 200, ResultCode.LIMIT, "why", 10)),
        (RUN_RECORD, RunRecord(RecordKind.STOP, "{}", "name: beam", 5)),
        (MODAL_POINT, ModalPoint(0, PointStatus.REJECTED, "gap", 0.1, "V")),
    ],
)
def test_a_cut_message_is_refused(codec, record):
    raw = codec.write(record)
    whole = codec.read(raw)
    assert whole.identical(record) if codec is MODAL_POINT else whole == record
    for stop in range(len(raw)):
        with pytest.raises(ValueError, match=r"not a whole|little-endian"):
            codec.read(raw[:stop])


def test_numbers_that_stand_for_nothing_are_refused():
    raw = bytearray(LOCK_EVENT.write(LOCK))
    raw[-29] = 77  # the kind, before its padding, two orders, held phase, perturbation and parameter
    with pytest.raises(BenchError, match="Test kind 77 is not known"):
        LOCK_EVENT.read(bytes(raw))
    for waveform in (0, 9):
        with pytest.raises(BenchError, match=f"waveform {waveform} is unknown"):
            read_drive(write_drive(DriveCommand(waveform, 20.0, 1.0), RATE))
    raw = RUN_STATE.write(RunState("run", 9, 1, 2, 0.5, 1.0, 100, 200, ResultCode.LIMIT, "why", 10))
    with pytest.raises(ValueError, match="9 is not a valid RunPhase"):
        RUN_STATE.read(raw)


def test_terms_of_several_exciters_come_back_and_those_of_one_cost_four_empty_lists():
    terms = (DriveTerm(1, 3, 1j, False), DriveTerm(2, 1, 0.5 - 0.2j), DriveTerm(1, 3, 0.1j))
    command = DriveCommand(Waveform.SINE, 20.0, 1.0, 0.1, 200, 199, terms=terms)
    assert read_drive(write_drive(command, RATE)) == command
    plain = write_drive(DriveCommand(Waveform.SINE, 20.0, 1.0), RATE)
    assert read_drive(plain).terms == ()
    assert plain[-16:] == bytes(16)
    values = {**command._asdict(), "stamp": 0, "harmonics": [], "harmonics_real": [], "harmonics_imag": []}
    bad = rosbags_bytes(
        "Drive", {**values, "exciters": [2], "exciter_orders": [1], "exciter_ratio_real": [], "exciter_ratio_imag": []}
    )
    with pytest.raises(BenchError, match="must have equal lengths"):
        read_drive(bad)


def test_harmonics_whose_lists_differ_in_length_are_refused():
    raw = bytearray(
        write_drive(DriveCommand(Waveform.SINE, 20.0, 1.0, terms=(DriveTerm(1, 3, 0.1 + 0.2j, False),)), RATE)
    )
    assert read_drive(bytes(raw)).terms == (DriveTerm(1, 3, 0.1 + 0.2j, False),)
    plain = write_drive(DriveCommand(Waveform.SINE, 20.0, 1.0), RATE)
    real_only = rosbags_bytes(
        "Drive",
        {**DriveCommand(Waveform.SINE, 20.0, 1.0)._asdict(), "stamp": 0, "harmonics": [3], "harmonics_real": [0.1],
         "harmonics_imag": [], **{name: [] for name in TERMS}},
    )  # fmt: skip
    assert len(real_only) != len(plain)
    with pytest.raises(BenchError, match="must have equal lengths"):
        read_drive(real_only)


def test_a_value_that_its_field_cannot_hold_is_named():
    with pytest.raises(ValueError, match=r"Level\.sequence cannot be -1"):
        LEVEL.write(LevelCommand(-1, 0, 0.1, 0, 0.1))


def test_nan_and_signed_zero_survive():
    read = LEVEL.read(LEVEL.write(LevelCommand(1, 0, math.nan, 0, -0.0)))
    assert math.isnan(read.amplitude)
    assert math.copysign(1.0, read.ramp) == -1.0
