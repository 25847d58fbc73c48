"""A bag of a made-up run: steady sines at each level, with everything that the bench records."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np

from nmt_core.messages.blocks import OscillatorPhase, Quantity, SampleBlock
from nmt_core.messages.linear_description import LinearDescription
from nmt_record.bag.bag_writer import BagWriter
from nmt_record.bag.bench_topics import parse_topic
from nmt_record.bag.message_definitions import local_definitions

SAMPLE_RATE = 10_000.0
BLOCK = 200
FREQUENCY_HZ = 21.7
DRIVE_POINT = 2
POINTS = (2, 4)
RIG_YAML = "name: beam\ndescription: A made-up beam\nassumptions:\n- The signals are pure sines & nothing else.\n"

LINEAR = LinearDescription(
    source="model",
    drive_point=DRIVE_POINT,
    target_mode=0,
    points=POINTS,
    frequencies_rad_s=(2 * math.pi * FREQUENCY_HZ, 760.0),
    damping_ratios=(0.005, 0.035),
    shapes=((0.4, -1.4), (1.1, -1.9)),
    drive_point_shape=0.4,
    plant_frequency_rad_s=137.0,
    plant_damping_ratio=0.009,
    moving_mass_kg=0.043,
)


def write_bag(
    path: Path,
    levels: tuple[float, ...] = (0.1, 0.3, 1.0),
    level_seconds: float = 4.0,
    window_periods: int = 20,
    lost_level: int | None = None,
    stop: bool = True,
) -> Path:
    """Write the bag; level ``lost_level`` never locks; without ``stop`` it is cut off."""
    types = local_definitions().typestore.types
    run = {
        "run_id": "made-up",
        "rig": "beam",
        "seed": 7,
        "plan": {"control": 1, "levels": list(levels), "window_periods": window_periods},
        "linear": json.loads(LINEAR.to_json()),
        "extraction": {"harmonics": 5, "topics": ["force", "displacement"]},
        "versions": {"nmt": "0.1.0"},
        "started": "2026-01-01T00:00:00+00:00",
    }
    writer = BagWriter(path, run_json=json.dumps(run), rig_yaml=RIG_YAML)
    for name in ("force", "displacement", "voltage", "frequency", "level", "lock", "modal_point", "run_state"):
        topic = parse_topic(name)
        writer.add_topic(name, topic.message_type, topic.service)
    clock = 0

    def put(topic: str, message: object) -> None:
        nonlocal clock
        clock += 1000
        writer.write_message(topic, message, receive_time_ns=clock)

    omega = 2 * math.pi * FREQUENCY_HZ
    sample = 0
    for index, level in enumerate(levels):
        first = sample
        put(
            "level",
            _make(
                types,
                "Level",
                sequence=index + 1,
                index=index,
                control=1,
                amplitude=level,
                apply_at_sample=first,
                ramp=0.1,
                frequency_hz=FREQUENCY_HZ,
                window_periods=window_periods,
                timeout=10.0,
            ),
        )
        window_first = first + int(SAMPLE_RATE)
        locked = False
        for _ in range(round(level_seconds * SAMPLE_RATE / BLOCK)):
            time = (sample + np.arange(BLOCK)) / SAMPLE_RATE
            phase = omega * time
            # At resonance ω̃² q = F φ / (2 δ): the amplitudes fit δ̃ = 0.5 % of the first linear mode.
            force = level * np.cos(phase)
            q = level * 0.4 / (2 * 0.005 * omega**2)
            response = np.outer([0.4, 1.1], q * np.sin(phase))
            for block in (
                _block(sample, Quantity.FORCE, ("f2",), (2,), force[None]),
                _block(sample, Quantity.DISPLACEMENT, ("x2", "x4"), POINTS, response),
                _block(sample, Quantity.VOLTAGE, ("u",), (0,), level * np.cos(phase)[None]),
            ):
                put(block.quantity.topic, _message(types, block))
            sample += BLOCK
            state = 2 if sample < window_first else 4 if index == lost_level else 3
            put(
                "frequency",
                _make(
                    types,
                    "Frequency",
                    last_sample=sample - 1,
                    level_index=index,
                    level_sequence=index + 1,
                    state=state,
                    frequency_hz=FREQUENCY_HZ,
                    phase_error=math.nan if state == 4 else 0.001 * index,
                    force_amplitude=level,
                    response_amplitude=q * 0.4,
                    response_unit="m",
                    drive_amplitude=level,
                    reason="",
                ),
            )
            if state == 3 and not locked:
                locked = True
                put(
                    "lock",
                    _make(
                        types,
                        "LockEvent",
                        level_index=index,
                        level=level,
                        level_unit="V",
                        sample=sample - 1,
                        frequency_hz=FREQUENCY_HZ,
                        phase_error=0.0,
                        window_first_sample=sample,
                        window_samples=round(window_periods / FREQUENCY_HZ * SAMPLE_RATE),
                        window_periods=window_periods,
                    ),
                )
    writer.close("done", "every level was worked through")
    if not stop:
        (path / "metadata.yaml").unlink()
        file = path / f"{path.name}_0.mcap"
        file.write_bytes(file.read_bytes()[: file.stat().st_size * 9 // 10])
    return path


def _make(types: dict[str, type], name: str, **values: object) -> object:
    """A message of nmt_msgs; fields not given are zero, empty or NaN-free defaults."""
    kind = types[f"nmt_msgs/msg/{name}"]
    blank = {"int": 0, "float": 0.0, "str": "", "bool": False}
    for field in dataclasses.fields(kind):  # ClassVar constants have string annotations and count as fields
        if "ClassVar" in str(field.type) or field.name == "__msgtype__":
            continue
        if field.name not in values:
            values[field.name] = _time(types) if field.name == "stamp" else blank[str(field.type)]
    return kind(**values)


def _time(types: dict[str, type]) -> object:
    return types["builtin_interfaces/msg/Time"](0, 0)


def _block(
    first: int, quantity: Quantity, channels: tuple[str, ...], points: tuple[int, ...], data: object
) -> SampleBlock:
    cycles = FREQUENCY_HZ * first / SAMPLE_RATE % 1.0
    return SampleBlock(
        first,
        SAMPLE_RATE,
        quantity,
        quantity.unit,
        channels,
        points,
        np.asarray(data),
        OscillatorPhase(cycles, FREQUENCY_HZ),
    )


def _message(types: dict[str, type], block: SampleBlock) -> object:
    header = types["std_msgs/msg/Header"](_time(types), "beam")
    return _make(
        types,
        "SampleBlock",
        header=header,
        first_sample=block.first_sample,
        sample_rate=block.sample_rate,
        quantity=int(block.quantity),
        unit=block.unit,
        channels=list(block.channels),
        points=np.array(block.points, dtype=np.uint32),
        data=np.ascontiguousarray(block.data).ravel(),
        oscillator_cycles=block.oscillator.cycles,
        oscillator_frequency_hz=block.oscillator.frequency_hz,
        oscillator_rate_hz_s=0.0,
        flags=0,
    )
