from __future__ import annotations

import contextlib

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from nmt_core.messages.cdr import read_stamp
from nmt_core.messages.wire import BlockReader
from nmt_record.bag.bench_topics import SAMPLE_BLOCK

TEXT = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12)
SETTINGS = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@SETTINGS
@given(
    first=st.integers(0, 2**64 - 1),
    samples=st.integers(0, 9),
    names=st.lists(TEXT, min_size=1, max_size=5),
    points=st.integers(0, 5),
    frame=TEXT,
    unit=TEXT,
    sec=st.integers(-5, 2**31 - 1),
    nanosec=st.integers(0, 999_999_999),
)
def test_block_agrees_with_full_decoding(store, first, samples, names, points, frame, unit, sec, nanosec):
    types = store.typestore.types
    stamp = types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
    message = types[SAMPLE_BLOCK](
        header=types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame),
        first_sample=first,
        sample_rate=25_600.0,
        quantity=3,
        unit=unit,
        channels=names,
        points=np.zeros(points, dtype=np.uint32),
        data=np.ones(samples * len(names)),
        oscillator_cycles=0.25,
        oscillator_frequency_hz=21.5,
        oscillator_rate_hz_s=-3.0,
        flags=1,
    )
    raw = bytes(store.typestore.serialize_cdr(message, SAMPLE_BLOCK, little_endian=True))
    full = store.typestore.deserialize_cdr(raw, SAMPLE_BLOCK)
    head = BlockReader().head(raw)
    assert head[:3] == (full.first_sample, len(full.data) // len(full.channels), full.sample_rate)
    assert (head.quantity, head.unit, head.flags) == (full.quantity, full.unit, full.flags)
    assert (head.channels, head.points) == (tuple(full.channels), tuple(full.points))
    assert head.oscillator == (full.oscillator_cycles, full.oscillator_frequency_hz, full.oscillator_rate_hz_s)
    assert head.end_sample == first + samples
    assert read_stamp(raw) == sec * 1_000_000_000 + nanosec
    for end in range(len(raw) - 1):
        with pytest.raises(ValueError, match=r"not a whole SampleBlock|do not divide|past the end|not little-endian"):
            BlockReader().head(raw[:end])


@SETTINGS
@given(st.binary(max_size=200))
def test_any_bytes_raise_nothing_but_value_errors(raw):
    for read in (BlockReader().head, read_stamp):
        for prefix in (b"", b"\0\1\0\0"):
            with contextlib.suppress(ValueError):
                assert read(prefix + raw) is not None


def test_big_endian_is_refused():
    for read in (BlockReader().head, read_stamp):
        with pytest.raises(ValueError, match="little-endian"):
            read(b"\0\0\0\0" + bytes(100))
