"""Nonsense on the topics: counted and refused, never obeyed, and the run still ends well."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from rclpy.node import Node

from nmt_bench.harness import Bench, Progress
from nmt_core.base_node import SAMPLES_QOS
from nmt_core.vocabulary import LoopState, ResultCode
from nmt_extract.modal_point import Status
from nmt_msgs.msg import Drive, Frequency, Level, LockEvent
from nmt_msgs.msg import SampleBlock as SampleBlockMessage
from nmt_record.bag_reader import Bag


def stranger(bench: Bench) -> Node:
    """A node on the bench's domain that nobody asked for."""
    node = Node("stranger", context=bench.context, enable_rosout=False, start_parameter_services=False)
    bench._add("stranger", node)
    return node


def nonsense_drives() -> list[Drive]:
    fine = {"waveform": Drive.SINE, "frequency_hz": 22.0, "amplitude": 0.2}
    return [
        Drive(),
        Drive(waveform=99),
        Drive(**{**fine, "frequency_hz": math.nan}),
        Drive(**{**fine, "amplitude": math.inf}),
        Drive(**{**fine, "amplitude": -1.0}),
        Drive(**{**fine, "frequency_hz": 9000.0}),
        Drive(**{**fine, "amplitude": 1e9}),
        Drive(**fine, ramp=-0.5),
        Drive(**fine, harmonics=[3], harmonics_real=[], harmonics_imag=[]),
        Drive(**fine, harmonics=[1], harmonics_real=[1.0], harmonics_imag=[0.0]),
    ]


def test_nonsense_drive_commands_are_refused_one_by_one(tmp_path: Path) -> None:
    with Bench("beam", [0.3], out=tmp_path / "out", window_periods=300) as bench:
        publisher = stranger(bench).create_publisher(Drive, "drive", SAMPLES_QOS)
        sent: list[Drive] = []

        def disturb(progress: Progress) -> None:
            if progress.state == LoopState.LOCKED and not sent:
                sent.extend(nonsense_drives())
                for drive in sent:
                    publisher.publish(drive)

        result = bench.run(disturb)
        bench.nodes["plant"].update_counters()
        refused = bench.nodes["plant"].counters["refused"]
    assert sent
    assert refused == len(sent)
    assert result.code == ResultCode.SUCCEEDED
    assert result.points[0].status == Status.OK


def test_blocks_of_another_source_do_not_reach_the_loop_unnoticed(tmp_path: Path) -> None:
    with Bench("beam", [0.3], out=tmp_path / "out", window_periods=300) as bench:
        publisher = stranger(bench).create_publisher(SampleBlockMessage, "force", SAMPLES_QOS)
        sent: list[int] = []

        def disturb(progress: Progress) -> None:
            if progress.state == LoopState.LOCKED and not sent:
                sent.append(progress.sample)
                for message in (
                    SampleBlockMessage(),
                    SampleBlockMessage(channels=["f2", "f3"], data=[1.0, 2.0, 3.0]),
                    SampleBlockMessage(quantity=77, channels=["f2"], data=[1.0]),
                    SampleBlockMessage(first_sample=5, sample_rate=1.0, quantity=1, channels=["f2"], data=[1e9] * 200),
                ):
                    publisher.publish(message)

        result = bench.run(disturb)
        bench.nodes["pll"].update_counters()
        counters = bench.nodes["pll"].counters
    assert counters["refused"] >= 3
    assert result.code == ResultCode.SUCCEEDED
    # Either the window was untouched, or it is marked: it is never wrong in silence.
    point = result.points[0]
    assert point.status != Status.OK or point.damping_ratio == pytest.approx(0.00853, rel=0.02)


def test_levels_that_make_no_sense_are_refused(tmp_path: Path) -> None:
    with Bench("beam", [0.3], out=tmp_path / "out", window_periods=300) as bench:
        publisher = stranger(bench).create_publisher(Level, "level", SAMPLES_QOS)
        sent: list[int] = []

        def disturb(progress: Progress) -> None:
            if progress.state == LoopState.LOCKED and not sent:
                sent.append(progress.sample)
                for values in ({"amplitude": math.nan}, {"amplitude": -3.0}, {"amplitude": 1.0, "control": 9},
                               {"amplitude": 1.0, "ramp": math.inf}):  # fmt: skip
                    publisher.publish(Level(**values))

        result = bench.run(disturb)
        bench.nodes["pll"].update_counters()
        assert bench.nodes["pll"].counters["refused"] == 4
    assert result.code == ResultCode.SUCCEEDED
    assert result.points[0].status == Status.OK
    voltage = np.concatenate([block.data[0] for block in Bag.open(tmp_path / "out" / "bag").blocks("voltage")])
    assert np.max(np.abs(voltage)) <= 0.3


def test_lock_events_and_loop_states_of_strangers_do_not_stop_the_nodes(tmp_path: Path) -> None:
    with Bench("beam", [0.3], out=tmp_path / "out", window_periods=300) as bench:
        node = stranger(bench)
        lock = node.create_publisher(LockEvent, "lock", SAMPLES_QOS)
        state = node.create_publisher(Frequency, "frequency", SAMPLES_QOS)
        sent: list[int] = []

        def disturb(progress: Progress) -> None:
            if not sent:
                sent.append(progress.sample)
                lock.publish(LockEvent())
                lock.publish(LockEvent(level_index=4_000_000_000, window_samples=2**60))
                state.publish(Frequency(state=200))

        result = bench.run(disturb)
    assert result.code in (ResultCode.SUCCEEDED, ResultCode.STOPPED)
    assert result.bag_state == "closed"
    assert any(point.status == Status.OK for point in result.points)


def test_a_second_goal_and_a_senseless_goal_are_rejected() -> None:
    with Bench("beam", [0.3, 0.4], window_periods=300) as bench:
        answers: list[object] = []

        def disturb(progress: Progress) -> None:
            if progress.state == LoopState.LOCKED and not answers:
                for levels in ([0.1], [], [math.nan], [-1.0]):
                    goal = {**bench.plan.goal, "levels": levels}
                    answers.append(bench.client.send_goal(goal, None))

        result = bench.run(disturb)
        bench.spin(0.2)
    assert len(answers) == 4
    for answer in answers:
        assert answer.done()  # type: ignore[attr-defined]
        assert not answer.result().accepted  # type: ignore[attr-defined]
    assert result.code == ResultCode.SUCCEEDED
    assert len(result.points) == 2
