"""Made-up bags: each is read right within its uncertainty or asked about; none is read wrong in silence.

The generator knows the truth and answers the questions of the proposal as somebody who made the recording would.
``NMT_BAGS=300`` makes as many.
"""

from __future__ import annotations

import math
import os
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_record.exchange.imports.imported_run import ImportedRun, read_import
from nmt_record.exchange.templates.sidecar_template import sidecar_templates

BAGS = int(os.environ.get("NMT_BAGS", "30"))
BEGIN = 1_764_064_800_000_000_000  # ns
RATES = (20.0, 100.0, 125.0, 240.0, 500.0, 1000.0)
KINDS = (
    "joints", "moving joints", "parted joints", "late joint", "frames", "pairs", "own names", "block", "plain block",
    "labels", "imu", "field",
)  # fmt: skip
FAULTS = (
    "none", "none", "zero", "repeated", "one back", "ahead", "pause", "set back", "set ahead", "slow log", "jitter",
    "jitter and loss", "late", "bursts", "lost", "restart",
)  # fmt: skip
JOINTS = ("hip", "knee.left", "a1", "time", "t", "force 2", "9")
SERIES = "std_msgs/Header header\nstring[] axis_names\nfloat64[] reading\nfloat64 unused\n"
CLOCKED = "uint64 time_usec\nfloat32[3] gyro\nfloat32 temperature\n"


@dataclass
class Made:
    """One bag, and what is true of it: by column the times of its samples and the signal."""

    path: Path
    kind: str
    fault: str
    rate: float
    signals: dict[str, tuple[float, float]]
    answers: dict[str, Any] = field(default_factory=dict)
    clock_error: float = 0.0
    origin: dict[str, np.ndarray] = field(default_factory=dict)


def signal(time: np.ndarray | float, wave: tuple[float, float]) -> Any:
    """A decaying sine of a frequency (Hz) and an amplitude."""
    return wave[1] * np.exp(-0.05 * time) * np.sin(2 * math.pi * wave[0] * time + 0.4)


def store_of() -> Any:
    store = get_typestore(Stores.ROS2_JAZZY)
    for text, name in ((SERIES, "lab_msgs/msg/Series"), (CLOCKED, "lab_msgs/msg/Clocked"),
                       ("float64 x\n", "lab_msgs/msg/Camera")):  # fmt: skip
        store.register(get_types_from_msg(text, name))
    return store


STORE = store_of()
T = STORE.types


def header(stamp: int, frame: str = "base") -> Any:
    return T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9), frame)


def joint_state(stamp: int, names: list[str], values: list[float], effort: bool) -> Any:
    position = np.array(values)
    return T["sensor_msgs/msg/JointState"](
        header(stamp), names, position, np.full(len(names), np.nan), 10.0 * position if effort else np.zeros(0)
    )


def frames(stamp: int, names: list[str], values: list[float]) -> Any:
    vector, turn = T["geometry_msgs/msg/Vector3"], T["geometry_msgs/msg/Quaternion"]
    transforms = [
        T["geometry_msgs/msg/TransformStamped"](
            header(stamp), name, T["geometry_msgs/msg/Transform"](vector(value, 0.0, 1.0), turn(0.0, 0.0, 0.0, 1.0))
        )
        for name, value in zip(names, values, strict=True)
    ]
    return T["tf2_msgs/msg/TFMessage"](transforms)


def pairs(stamp: int, names: list[str], values: list[float]) -> Any:
    every = [T["diagnostic_msgs/msg/KeyValue"](name, f"{value:.9g}") for name, value in zip(names, values, strict=True)]
    status = T["diagnostic_msgs/msg/DiagnosticStatus"](0, "drive", "ok", "x1", [*every, T[
        "diagnostic_msgs/msg/KeyValue"]("state", "running")])  # fmt: skip
    return T["diagnostic_msgs/msg/DiagnosticArray"](header(stamp), [status])


def array_of(values: np.ndarray, dimensions: list[tuple[str, int]]) -> Any:
    dims = [T["std_msgs/msg/MultiArrayDimension"](label, size, size) for label, size in dimensions]
    return T["std_msgs/msg/Float64MultiArray"](T["std_msgs/msg/MultiArrayLayout"](dims, 0), values)


def imu(stamp: int, value: float) -> Any:
    vector = T["geometry_msgs/msg/Vector3"]
    none = np.zeros(9)
    return T["sensor_msgs/msg/Imu"](
        header(stamp), T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0), none, vector(0.0, 0.0, 0.0), none,
        vector(0.0, 0.0, value), none,
    )  # fmt: skip


def clocks(made: Made, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """True times (s), stamps and log times (ns) of messages, and which are recorded."""
    step = 1.0 / made.rate
    time = np.arange(count) * step
    kept = np.ones(count, dtype=bool)
    fault = made.fault
    if fault.startswith("jitter"):
        time = time + step * rng.uniform(-0.3, 0.3, count)
    stamps = BEGIN + np.round(1e9 * time).astype(np.int64)
    logs = stamps + np.round(1e9 * (2e-4 + rng.exponential(5e-5, count))).astype(np.int64)
    inner = rng.choice(np.arange(20, count - 20), 3, replace=False)
    inner = inner[np.argsort(inner)]
    if fault == "zero":
        stamps[: int(rng.integers(1, 5))] = 0
        stamps[inner[1]] = 0
    elif fault == "repeated":
        stamps[inner] = stamps[inner - 1]
    elif fault == "one back":
        stamps[inner] -= np.round(1e9 * step * rng.choice([1.4, 2.0, 3.3], 3)).astype(np.int64)
    elif fault == "ahead":
        stamps[inner[0]] += np.int64(1e9 * step * float(rng.choice([7.4, 12.0, 1e6])))
    elif fault == "pause":
        first = int(rng.integers(count // 4, count // 2))
        kept[first : first + max(20, round(0.7 * made.rate))] = False
    elif fault in ("lost", "jitter and loss"):
        kept[rng.choice(np.arange(5, count - 5), count // 50, replace=False)] = False
    elif fault in ("set back", "set ahead"):
        jump = np.int64(1e9 * step * float(rng.choice([25.3, 60.0])))
        stamps[count // 2 :] += jump if fault == "set ahead" else -jump
    elif fault == "restart":
        stamps[count // 2 :] -= stamps[count // 2] - BEGIN + np.int64(10**12)
    elif fault == "slow log":
        logs = BEGIN + np.round((logs - BEGIN) * float(rng.choice([0.5, 2.0, 1.05]))).astype(np.int64)
        made.answers["clock"] = "header"
    elif fault == "late":
        logs = logs + np.round(1e9 * rng.exponential(2.5 * step, count)).astype(np.int64)
        if made.kind in ("block", "plain block"):  # without stamps, one publisher's messages come in order
            logs = np.maximum.accumulate(logs)
    elif fault == "bursts":
        burst = 1 + np.arange(count) // 5
        logs = BEGIN + np.round(1e9 * 5 * step * burst + 3e4 * (np.arange(count) % 5)).astype(np.int64)
    return time, stamps, logs, kept


def made_bag(seed: int, folder: Path) -> Made:
    rng = np.random.default_rng(seed)
    kind, fault = KINDS[seed % len(KINDS)], FAULTS[int(rng.integers(len(FAULTS)))]
    rate = float(rng.choice(RATES))
    path = folder / f"bag{seed}"
    made = Made(path, kind, fault, rate, {})
    names = [str(name) for name in rng.permutation(JOINTS)[: int(rng.integers(2, 4))]]
    waves = {name: (float(rng.uniform(0.02, 0.06)) * rate, float(rng.uniform(0.1, 1.0))) for name in names}
    topic = str(rng.choice(["/robot/state", "/x", "/daq_1"]))
    count = int(rng.integers(300, 900))
    if kind in ("block", "plain block") and fault not in ("none", "pause", "late"):
        made.fault = fault = "none"
    if kind in ("labels", "field") and fault not in ("none", "pause", "lost"):
        made.fault = fault = "none"
    time, stamps, logs, kept = clocks(made, count, rng)
    reliability = [QosReliability.RELIABLE, QosReliability.BEST_EFFORT][int(rng.integers(2))]
    qos = [Qos(QosHistory.KEEP_LAST, int(rng.integers(1, 50)), reliability, QosDurability.VOLATILE, QosTime(0, 0),
               QosTime(0, 0), QosLiveliness.AUTOMATIC, QosTime(0, 0), False)]  # fmt: skip
    messages = list(globals()[f"send_{kind.replace(' ', '_')}"](made, names, waves, time, stamps, rng))
    plugin = StoragePlugin.MCAP if rng.random() < 0.7 else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        types = {message.__msgtype__ for _, message in messages}
        (msgtype,) = types
        connection = writer.add_connection(topic, msgtype, typestore=STORE, offered_qos_profiles=qos)
        camera = writer.add_connection("/camera", "lab_msgs/msg/Camera", typestore=STORE)
        for number, message in messages:
            if kept[number]:
                writer.write(connection, int(logs[number]), STORE.serialize_cdr(message, msgtype))
                writer.write(camera, int(logs[number]), STORE.serialize_cdr(T["lab_msgs/msg/Camera"](1.0),
                                                                            "lab_msgs/msg/Camera"))  # fmt: skip
    made.signals = {f"{topic}.{name}": wave for name, wave in made.signals.items()}
    return made


def send_joints(made: Made, names: list[str], waves: Any, time: Any, stamps: Any, rng: Any) -> Any:
    made.signals = {f"position.{name}": waves[name] for name in names}
    begin = int(rng.integers(0, time.size // 4))  # effort is empty at first
    for k, t in enumerate(time):
        yield k, joint_state(int(stamps[k]), names, [signal(t, waves[name]) for name in names], k >= begin)


def send_moving_joints(made: Made, names: list[str], waves: Any, time: Any, stamps: Any, rng: Any) -> Any:
    made.signals = {f"position.{name}": waves[name] for name in names}
    change = int(rng.integers(20, time.size - 20))
    for k, t in enumerate(time):
        order = names if k < change else names[::-1]
        yield k, joint_state(int(stamps[k]), order, [signal(t, waves[name]) for name in order], False)


def send_parted_joints(made: Made, names: list[str], waves: Any, time: Any, stamps: Any, rng: Any) -> Any:
    made.signals = {f"position.{name}": waves[name] for name in names[:1]}
    for k, t in enumerate(time):
        if k % 11 == 0:  # a gripper between the messages of the arm
            yield k, joint_state(int(stamps[k]) + 1000, ["finger_l", "finger_r"], [0.01, 0.02], True)
        yield k, joint_state(int(stamps[k]), names[:1], [signal(t, waves[names[0]])], True)


def send_late_joint(made: Made, names: list[str], waves: Any, time: Any, stamps: Any, rng: Any) -> Any:
    made.signals = {f"position.{name}": waves[name] for name in names}
    begin = int(rng.integers(20, time.size // 3))
    for k, t in enumerate(time):
        there = names if k >= begin else names[:-1]
        yield k, joint_state(int(stamps[k]), there, [signal(t, waves[name]) for name in there], False)


def send_frames(made: Made, names: list[str], waves: Any, time: Any, stamps: Any, rng: Any) -> Any:
    made.signals = {f"transforms.{name}.transform.translation.x": waves[name] for name in names}
    for k, t in enumerate(time):
        order = [str(name) for name in rng.permutation(names)]
        yield k, frames(int(stamps[k]), order, [signal(t, waves[name]) for name in order])


def send_pairs(made: Made, names: list[str], waves: Any, time: Any, stamps: Any, rng: Any) -> Any:
    made.signals = {f"status.drive.values.{name}": waves[name] for name in names}
    for k, t in enumerate(time):
        order = [str(name) for name in rng.permutation(names)]
        yield k, pairs(int(stamps[k]), order, [float(signal(t, waves[name])) for name in order])


def send_own_names(made: Made, names: list[str], waves: Any, time: Any, stamps: Any, rng: Any) -> Any:
    made.signals = {f"reading.{name}": waves[name] for name in names}
    for k, t in enumerate(time):
        order = names if k % 2 else names[::-1]
        values = np.array([signal(t, waves[name]) for name in order])
        yield k, T["lab_msgs/msg/Series"](header(int(stamps[k])), order, values, 0.0)


def send_block(made: Made, names: list[str], waves: Any, time: Any, stamps: Any, rng: Any) -> Any:
    size = int(rng.integers(5, 100))
    transposed = bool(rng.random() < 0.5)
    made.signals = {f"data.{number + 1}": waves[name] for number, name in enumerate(names)}
    yield from sent_blocks(made, size, names, waves, time, transposed)


def sent_blocks(made: Made, size: int, names: list[str], waves: Any, time: Any, transposed: bool) -> Any:
    within = np.arange(size) / (made.rate * size)
    made.rate *= size
    for name in list(made.signals):
        made.signals[name] = (made.signals[name][0] * size, made.signals[name][1])
    for k, t in enumerate(time):
        table = np.array([signal(t + within, (waves[name][0] * size, waves[name][1])) for name in names])
        if transposed:
            yield k, array_of(table.ravel(), [("channels", len(names)), ("samples", size)])
        else:
            yield k, array_of(table.T.ravel(), [("samples", size), ("channels", len(names))])


def send_plain_block(made: Made, names: list[str], waves: Any, time: Any, stamps: Any, rng: Any) -> Any:
    size = int(rng.integers(40, 200))
    made.signals = {"data": waves[names[0]]}
    wave = (waves[names[0]][0] * size, waves[names[0]][1])
    within = np.arange(size) / (made.rate * size)
    made.rate *= size
    made.signals = {"data": wave}
    labelled = bool(rng.random() < 0.5)
    for k, t in enumerate(time):
        yield k, array_of(signal(t + within, wave), [("samples", size)] if labelled else [])


def send_labels(made: Made, names: list[str], waves: Any, time: Any, stamps: Any, rng: Any) -> Any:
    made.signals = {f"data.{name}": waves[name] for name in names}
    for k, t in enumerate(time):
        order = [str(name) for name in rng.permutation(names)]
        yield k, array_of(np.array([signal(t, waves[name]) for name in order]), [(name, 1 + k % 1) for name in order])


def send_imu(made: Made, names: list[str], waves: Any, time: Any, stamps: Any, rng: Any) -> Any:
    made.signals = {"linear_acceleration.z": waves[names[0]]}
    for k, t in enumerate(time):
        yield k, imu(int(stamps[k]), float(signal(t, waves[names[0]])))


def send_field(made: Made, names: list[str], waves: Any, time: Any, stamps: Any, rng: Any) -> Any:
    made.signals = {"gyro.2": waves[names[0]]}
    for k, t in enumerate(time):
        value = np.float32(signal(t, waves[names[0]]))
        yield k, T["lab_msgs/msg/Clocked"](round(1e6 * t) + 77_000_000, np.array([0, value, 0], np.float32), 20.0)


# --- what an owner answers, and what is true --------------------------------------------------------------------------


def completed(text: str, made: Made) -> tuple[dict[str, Any], list[str]]:
    """The proposal with its questions answered, and what they were."""
    values = yaml.safe_load(text)
    asked = [key for key in ("clock", "time_unit", "stretch") if values.get(key) == "?"]
    for key in asked:
        values[key] = made.answers.get(key, "header")
    for number, channel in enumerate(values["channels"]):
        for key, answer in (("quantity", "displacement"), ("unit", "m"), ("scale", 1)):
            if channel.get(key) == "?":
                channel[key] = answer
        channel.setdefault("point", number + 1)
    for segment in values["segments"]:
        if segment.get("stop") == "?":
            del values["segments"]
            break
    return values, asked


def check(made: Made, run: ImportedRun, columns: list[str]) -> None:
    """Rate, and each column within its noise; a record may begin later and have holes."""
    spread = 3.0 * run.clock_std + 2e-5
    assert run.sample_rate == pytest.approx(made.rate, rel=spread), f"{made.path.name} {made.kind} {made.fault}"
    for channel in run.channels:
        wave = made.signals.get(channel.source)
        if wave is None:
            continue
        columns.append(channel.source)
        stretches = parts_of(channel.data)
        assert sum(part.size for part in stretches) > 40, f"{made.path.name} {made.kind} {made.fault} {channel.source}"
        for part in stretches:
            if part.size < 40:
                continue
            left = left_over(part, wave, made.rate)
            margin = 0.02 + 2 * math.pi * wave[0] * part.size / made.rate * spread
            assert left < margin, f"{made.path.name} {made.kind} {made.fault} {channel.source}: {left:.3g}"


def parts_of(values: np.ndarray) -> list[np.ndarray]:
    """Stretches without holes."""
    good = np.isfinite(values)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], good.astype(int), [0]))))
    return [values[first:stop] for first, stop in zip(edges[::2], edges[1::2], strict=True)]


def left_over(values: np.ndarray, wave: tuple[float, float], rate: float) -> float:
    """What is left of samples without the sine that they should be, relative: wrong samples, order or times show."""
    time = np.arange(values.size) / rate
    turn = 2 * math.pi * wave[0] * time
    basis = np.stack([np.cos(turn), np.sin(turn)], axis=1) * np.exp(-0.05 * time)[:, None]
    fitted = basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
    return float(np.std(values - fitted) / np.std(fitted))


def judged(made: Made) -> tuple[str, list[str]]:
    """Right, asked or refused, and questions or the sentence; what is wrong is an error."""
    try:
        texts = sidecar_templates(made.path)
    except BenchError as error:
        return "refused", [str(error)]
    every: list[str] = []
    columns: list[str] = []
    for number, text in enumerate(texts):
        values, asked = completed(text, made)
        every += asked
        sidecar = made.path.with_name(f"{made.path.name}-{number}.yaml")
        sidecar.write_text(yaml.safe_dump(values, allow_unicode=True), encoding="utf-8")
        run = read_import(sidecar)  # neither a proposal nor its answers are refused
        if any(channel.source in made.signals for channel in run.channels):
            check(made, run, columns)
    if not columns and any("say 'elements: samples'" in text for text in texts):
        every.append("elements")
        channels = [{"column": name, "quantity": "displacement", "unit": "m"} for name in made.signals]
        sidecar = made.path.with_name(f"{made.path.name}.yaml")
        sidecar.write_text(yaml.safe_dump({"file": made.path.name, "elements": "samples", "channels": channels}))
        check(made, read_import(sidecar), columns)
    assert set(columns) == set(made.signals), f"{made.path.name} {made.kind} {made.fault}: {columns}"
    return ("asked" if every else "right"), every


@pytest.mark.parametrize("part", with_quick(range(3), 0))
def test_a_bag_is_read_right_or_asked_about(part: int, tmp_path: Path) -> None:
    results = []
    for seed in range(part, BAGS, 3):
        made = made_bag(seed, tmp_path)
        result, why = judged(made)
        results.append((made.kind, made.fault, result, why))
    refused = [item for item in results if item[2] == "refused"]
    assert not refused, refused
    # Only clocks that contradict each other (also one that is set back by few steps), and arrays of many elements that
    # say nothing, are asked about.
    for kind, fault, result, why in results:
        assert result == "right" or fault in ("slow log", "set back") or (kind, why) == ("plain block", ["elements"]), (
            kind,
            fault,
        )
    if BAGS > 30:
        print(Counter((result, fault) for _, fault, result, _ in results))
