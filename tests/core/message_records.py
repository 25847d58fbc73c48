"""Random records of every message of the bench, and the field values that their messages have."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from hypothesis import strategies as st

from nmt_core.messages.blocks import OscillatorPhase, SampleBlock
from nmt_core.messages.cdr import bench_time_ns
from nmt_core.messages.modal_point import COMPLEX, MEASURED, ModalPoint
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
    DRIVE_STOP,
    LEVEL,
    LOCK_EVENT,
    MODAL_POINT,
    MONITOR,
    RUN_RECORD,
    RUN_STATE,
    STEERING,
    read_drive,
    read_status,
    write_drive,
    write_status,
)
from nmt_core.vocabulary import (
    ControlKind,
    LoopState,
    OutputState,
    PointStatus,
    Quantity,
    RecordKind,
    ResultCode,
    RunPhase,
    SteeringAct,
    StopCause,
    TestKind,
    Waveform,
)

RATE = 10_000.0
uint8, uint32, uint64 = (st.integers(0, 2**bits - 1) for bits in (8, 32, 64))
times = st.integers(0, (2**31 - 1) * 10**9)
floats = st.floats(allow_nan=True, width=64)
texts = st.text(st.characters(exclude_characters="\x00", exclude_categories=["Cs"]), max_size=30)
long_texts = st.one_of(texts, st.integers(1, 3000).map(lambda count: "é{" * count))


def complex_arrays(shape: tuple[int, ...]) -> st.SearchStrategy[Any]:
    """Complex arrays of random bits."""

    def make(seed: int) -> Any:
        values = np.random.default_rng(seed).standard_normal((2, *shape))
        return values[0] + 1j * values[1]

    return st.integers(0, 2**32 - 1).map(make)


@st.composite
def modal_points(draw: st.DrawFn) -> ModalPoint:
    harmonics, channels, modes = draw(st.integers(0, 30)), draw(st.integers(0, 7)), draw(st.integers(0, 5))
    empty = draw(st.booleans())
    measured = {name + suffix: draw(floats) for name in MEASURED for suffix in ("", "_std")}
    arrays = {} if empty else {
        "force_harmonics": draw(complex_arrays((harmonics + 1,))),
        "shape_harmonics": draw(complex_arrays((harmonics + 1, channels) if channels else (0, 0))),
        "normalised_shape": draw(complex_arrays((channels,))),
        "participation": draw(complex_arrays((modes,))),
    }  # fmt: skip
    return ModalPoint(
        level_index=draw(uint32), status=draw(st.sampled_from(PointStatus)), reason=draw(long_texts),
        level=draw(floats),
        level_unit=draw(st.sampled_from(["V", "N", "m", "m/s^2", ""])), time_ns=draw(times),
        window_first_sample=draw(uint64), window_samples=draw(uint64), window_periods=draw(uint32), harmonics=harmonics,
        points=tuple(draw(st.lists(uint32, min_size=channels, max_size=channels))), **measured, **arrays,
    )  # fmt: skip


levels = st.builds(
    LevelCommand, uint32, uint32, floats, uint64, floats, st.sampled_from(ControlKind), floats, uint32, floats,
    st.sampled_from([kind for kind in TestKind if kind]), floats, floats, floats, floats, floats,
)  # fmt: skip
lock_events = st.builds(
    LockEvent, uint32, floats, texts, uint64, floats, floats, uint64, uint64, uint32,
    st.sampled_from([kind for kind in TestKind if kind]), times,
)  # fmt: skip
run_states = st.builds(
    RunState, long_texts, st.sampled_from(RunPhase), uint32, uint32, floats, floats, uint64, uint64,
    st.sampled_from(ResultCode), long_texts, times,
)  # fmt: skip
steerings = st.builds(
    Steering, uint32, long_texts, st.sampled_from(SteeringAct), uint32, uint64, uint64, st.booleans(),
    st.lists(floats, max_size=5).map(tuple), st.lists(floats, max_size=5).map(tuple), texts, long_texts, times,
)  # fmt: skip
drive_stops = st.builds(
    DriveStop, uint64, st.sampled_from(StopCause), st.sampled_from(OutputState), long_texts, times,
)  # fmt: skip
monitors = st.builds(
    SignalLevels, uint64, floats, st.tuples(*[st.tuples(floats, floats)] * 6), long_texts,
    st.lists(floats, max_size=5).map(tuple), st.lists(floats, max_size=5).map(tuple), uint8, times,
)  # fmt: skip
run_records = st.builds(RunRecord, st.sampled_from(RecordKind), long_texts, long_texts, times)
values = st.complex_numbers(allow_nan=False)
volts = st.builds(DriveTerm, st.just(1), uint32, values, st.just(False))
ratios = st.builds(DriveTerm, uint32, uint32, values, st.just(True))
terms = st.tuples(st.lists(volts, max_size=5), st.lists(ratios, max_size=3))
drives = st.builds(
    DriveCommand, st.sampled_from([w for w in Waveform if w]), floats, floats, floats, st.integers(0, 2**40),
    st.integers(0, 2**40),
    floats, floats, floats, floats, terms.map(lambda lists: (*lists[0], *lists[1])),
)  # fmt: skip
statuses = st.builds(
    LoopStatus, st.integers(0, 2**40), uint32, uint32, st.sampled_from(LoopState), floats, floats, floats, floats,
    texts, floats, uint8, long_texts,
)  # fmt: skip


@st.composite
def blocks(draw: st.DrawFn) -> SampleBlock:
    channels = draw(st.lists(texts, min_size=1, max_size=5))
    samples = draw(st.integers(0, 40))
    data = np.random.default_rng(draw(uint32)).standard_normal((len(channels), samples))
    return SampleBlock(
        draw(st.integers(0, 2**40)), draw(st.sampled_from([1.0, 1e4, 51_200.0])), draw(st.sampled_from(Quantity)),
        draw(texts), tuple(channels), tuple(draw(st.lists(uint32, max_size=6))), data,
        OscillatorPhase(draw(floats), draw(floats), draw(floats)), draw(uint8),
    )  # fmt: skip


def values_of(record: Any) -> dict[str, Any]:
    """Values of the fields of a record's message by name; a stamp is a time in ns."""
    if isinstance(record, DriveCommand):
        values = record._asdict()
        terms = values.pop("terms")
        volts, ratios = ([term for term in terms if term.relative is kind] for kind in (False, True))
        values["harmonics"] = [term.order for term in volts]
        values["harmonics_real"] = [term.value.real for term in volts]
        values["harmonics_imag"] = [term.value.imag for term in volts]
        values["exciters"] = [term.exciter for term in ratios]
        values["exciter_orders"] = [term.order for term in ratios]
        values["exciter_ratio_real"] = [term.value.real for term in ratios]
        values["exciter_ratio_imag"] = [term.value.imag for term in ratios]
        return {**values, "stamp": bench_time_ns(record.based_on_sample, RATE)}
    if isinstance(record, LoopStatus):
        return {**record._asdict(), "stamp": bench_time_ns(record.last_sample, RATE)}
    values = {item.name: getattr(record, item.name) for item in fields(record)}
    if isinstance(record, ModalPoint):
        for name in COMPLEX:
            array = values.pop(name).ravel()
            values[f"{name}_real"], values[f"{name}_imag"] = array.real, array.imag
    if isinstance(record, SignalLevels):
        for quantity, pair in zip(list(Quantity)[1:], values.pop("drive_point"), strict=True):
            values.update(zip((f"{quantity.topic}_peak", f"{quantity.topic}_rms"), pair, strict=True))
    return {**values, "stamp": values.get("time_ns")}


def same(a: Any, b: Any) -> bool:
    """Equal, NaN being equal to NaN."""
    if isinstance(a, ModalPoint):
        return a.identical(b)
    if is_dataclass(a):
        a, b = ([getattr(item, field.name) for field in fields(item)] for item in (a, b))
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return bool(a == b or (a != a and b != b))


CODECS = {
    codec.name: codec
    for codec in (DRIVE_STOP, LEVEL, LOCK_EVENT, MODAL_POINT, MONITOR, RUN_RECORD, RUN_STATE, STEERING)
}
WRITE = {name: codec.write for name, codec in CODECS.items()}
WRITE.update(Drive=lambda drive: write_drive(drive, RATE), Frequency=lambda status: write_status(status, RATE))
READ = {**{name: codec.read for name, codec in CODECS.items()}, "Drive": read_drive, "Frequency": read_status}
RECORDS: dict[str, Any] = {
    "Level": levels, "LockEvent": lock_events, "RunState": run_states, "Steering": steerings, "DriveStop": drive_stops,
    "Monitor": monitors, "RunRecord": run_records, "ModalPoint": modal_points(), "Drive": drives,
    "Frequency": statuses,
}  # fmt: skip
"""Random records by the name of their message; `WRITE` and `READ` have its codec."""
