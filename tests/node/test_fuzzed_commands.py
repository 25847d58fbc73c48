"""A thousand senseless commands through the middleware: the output keeps its limits, and every run ends."""

from __future__ import annotations

import math
import time
from pathlib import Path

import numpy as np
import pytest
from rclpy.node import Node
from tiers import with_quick

from nmt_bench.harness import Bench, Progress
from nmt_core.base_node import SAMPLES_QOS, STATE_QOS
from nmt_core.messages.blocks import SampleBlock
from nmt_core.messages.wire import BlockReader
from nmt_core.vocabulary import LoopState
from nmt_msgs import msg
from nmt_plant.plant_node import PlantNode
from nmt_plant.plant_settings import PlantSettings
from nmt_record.bag.bag_reader import Bag

LIMIT, RATE, BLOCK = 2.0, 10_000.0, 200
RIG = [f"limits.voltage_v={LIMIT}", "limits.slew_v_s=500"]
STEP = 500.0 / RATE
LONGEST = 10.0  # s of wall time for the end of a run
MAGNITUDES = [0.0, 1e-300, 1e-3, 0.3, 1.0, 1.9, 2.0, 2.1, 50.0, 1e6, 1e300, -1.0, math.nan, math.inf, -math.inf]
SAMPLES = [0, 1, 199, 200, 2**31, 2**60, 2**63, 2**64 - 1]


def number(rng: np.random.Generator) -> float:
    return float(rng.choice(MAGNITUDES) if rng.random() < 0.6 else rng.normal(0.0, 3.0))


def index(rng: np.random.Generator, near: int) -> int:
    if rng.random() < 0.4:
        return int(rng.choice(np.array(SAMPLES, dtype=object)))
    return max(0, near + int(rng.integers(-3, 60)) * BLOCK - int(rng.integers(0, 2)))


def drive(rng: np.random.Generator, near: int) -> msg.Drive:
    count = int(rng.integers(0, 4)) if rng.random() < 0.4 else 0
    return msg.Drive(
        apply_at_sample=index(rng, near), based_on_sample=index(rng, near),
        waveform=int(rng.choice([0, 1, 2, 2, 2, 3, 4, 99])),
        frequency_hz=float(rng.choice([0.0, 22.0, 100.0, 900.0, 5000.0, 1e9, math.nan])), amplitude=number(rng),
        ramp=float(rng.choice([0.0, 0.0, 0.01, 1.0, 1e9, math.nan, -1.0])),
        harmonics=[int(rng.integers(0, 9)) for _ in range(count)], harmonics_real=[number(rng) for _ in range(count)],
        harmonics_imag=[number(rng) for _ in range(count + int(rng.random() < 0.1))],
        band_low_hz=number(rng), band_high_hz=number(rng), rate_hz_s=number(rng), frequency_end_hz=number(rng),
    )  # fmt: skip


def level(rng: np.random.Generator, near: int) -> msg.Level:
    return msg.Level(
        sequence=int(rng.integers(0, 2**32)), index=int(rng.integers(0, 5)), control=int(rng.integers(0, 6)),
        amplitude=number(rng), apply_at_sample=index(rng, near), ramp=number(rng), frequency_hz=number(rng),
        window_periods=int(rng.integers(0, 2**32)), timeout=number(rng), test=int(rng.integers(0, 9)),
        duration=number(rng),
    )  # fmt: skip


def frequency(rng: np.random.Generator, near: int) -> msg.Frequency:
    return msg.Frequency(
        last_sample=index(rng, near), level_index=int(rng.integers(0, 5)), level_sequence=int(rng.integers(0, 2**32)),
        state=int(rng.integers(0, 9)), frequency_hz=number(rng), drive_amplitude=number(rng),
        flags=int(rng.integers(0, 256)),
    )  # fmt: skip


def run_state(rng: np.random.Generator, near: int) -> msg.RunState:
    return msg.RunState(
        run_id="fuzz", phase=int(rng.integers(0, 9)), sample=index(rng, near), horizon_sample=index(rng, near),
        result_code=int(rng.integers(0, 12)),
    )  # fmt: skip


def assert_kept(voltage: np.ndarray, amplitude: float) -> None:
    """Every sample within the limits of the rig, and no faster than its slew."""
    assert np.isfinite(voltage).all()
    assert np.abs(voltage).max() <= amplitude * (1.0 + 1e-9)
    assert np.abs(np.diff(voltage)).max() <= STEP * (1.0 + 1e-9)


class Fuzzer(Node):  # type: ignore[misc]
    """The only publisher of drive and run_state, so that the plant takes what can be taken."""

    def __init__(self, bench: Bench) -> None:
        super().__init__("pll", context=bench.context, namespace="fuzz", enable_rosout=False)
        self.blocks: list[SampleBlock] = []
        reader = BlockReader()
        self.create_subscription(
            msg.SampleBlock, "voltage", lambda raw: self.blocks.append(reader.read(raw)), SAMPLES_QOS, raw=True
        )
        self.drive = self.create_publisher(msg.Drive, "drive", SAMPLES_QOS)
        self.state = self.create_publisher(msg.RunState, "run_state", STATE_QOS)


@pytest.mark.parametrize("seed", with_quick([1, 2], 1))
def test_a_plant_that_gets_nothing_but_nonsense_keeps_its_limits(seed: int) -> None:
    rng = np.random.default_rng(seed)
    with Bench("beam", [0.3], overrides=RIG) as bench:
        plant = PlantNode(
            PlantSettings(rig_file=str(bench.out / "rig.yaml"), latency_blocks=4),
            context=bench.context, namespace="fuzz",
        )  # fmt: skip
        bench.add_node("fuzzed", plant)
        fuzzer = Fuzzer(bench)
        bench.add_node("fuzzer", fuzzer)
        bench.spin_until(lambda: fuzzer.drive.get_subscription_count() == 1, 20.0, "the plant")
        bench.spin_until(lambda: fuzzer.state.get_subscription_count() == 1, 20.0, "the plant")
        fuzzer.state.publish(msg.RunState(run_id="fuzz", phase=msg.RunState.RUNNING, horizon_sample=2**40))
        for count in range(500):
            near = plant.device.next_sample
            message = drive(rng, near)
            if count % 2:  # one that may be taken, and asks for all the output can give, at once
                message = msg.Drive(
                    based_on_sample=max(near - 1, 0), waveform=int(rng.integers(1, 5)),
                    ramp=float(rng.choice([0.0, 0.01])), frequency_hz=float(rng.choice([22.0, 50.0, 400.0])),
                    amplitude=float(rng.choice([0.5, 1.0, 1.9, 2.0, 2.1])), frequency_end_hz=500.0, rate_hz_s=1e3,
                    band_low_hz=10.0, band_high_hz=500.0,
                )  # fmt: skip
                if message.waveform != msg.Drive.SWEEP:
                    message.frequency_end_hz = message.rate_hz_s = 0.0
                if message.waveform != msg.Drive.RANDOM:
                    message.band_low_hz = message.band_high_hz = 0.0
                if rng.random() < 0.3:
                    message.harmonics, message.harmonics_real = [3, 7], rng.normal(0.0, 0.5, 2).tolist()
                    message.harmonics_imag = [0.1, -0.1]
            fuzzer.drive.publish(message)
            if count % 10 == 9:
                for state in (run_state(rng, near), msg.RunState(run_id="fuzz", phase=msg.RunState.DONE)):
                    fuzzer.state.publish(state)
                    bench.spin(0.004)
                fuzzer.state.publish(msg.RunState(run_id="fuzz", phase=msg.RunState.RUNNING, horizon_sample=2**40))
            bench.spin(0.004)
            if plant.device.is_quiet and plant.device.tripped:
                plant.device.reset()
        bench.spin(0.5)
        voltage = np.concatenate([block.data[0] for block in fuzzer.blocks])
        accepted = plant.core.judge.counts["accepted"]
    assert accepted > 30
    assert np.abs(voltage).max() > 0.5, "some commands moved it"
    assert_kept(voltage, LIMIT)


KINDS = {
    "drive": (msg.Drive, drive, SAMPLES_QOS),
    "level": (msg.Level, level, SAMPLES_QOS),
    "frequency": (msg.Frequency, frequency, SAMPLES_QOS),
    "run_state": (msg.RunState, run_state, STATE_QOS),
}


@pytest.mark.parametrize("topic", with_quick(KINDS, "drive"))
def test_a_run_under_a_thousand_senseless_messages_ends(topic: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    kind, make, service = KINDS[topic]
    with Bench("beam", [0.3], out=tmp_path / "out", overrides=RIG, window_periods=2000) as bench:
        node = Node("stranger", context=bench.context, enable_rosout=False, start_parameter_services=False)
        bench.add_node("stranger", node)
        begun: list[float] = []

        def attack(progress: Progress) -> None:
            if progress.state != LoopState.LOCKED or begun:
                return
            publisher = node.create_publisher(kind, topic, service)
            bench._cleanup.callback(node.destroy_publisher, publisher)
            for _ in range(250):
                publisher.publish(make(rng, progress.sample))
            begun.append(time.monotonic())
            if topic == "run_state":
                bench.cancel()  # nobody obeys these; what is shown is that the run still ends when it is asked to

        bench.run(attack)
        ended = time.monotonic()
    assert begun
    assert ended - begun[0] < LONGEST
    blocks = list(Bag.open(tmp_path / "out" / "bag").blocks("voltage"))
    assert_kept(np.concatenate([block.data[0] for block in blocks]), 0.3)
    assert not blocks[-1].data.any()
