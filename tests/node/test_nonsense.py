"""Nonsense on the topics: counted and refused, never obeyed, and the run still ends well."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.node import Node
from tiers import with_quick

from nmt_bench.harness import Bench, Progress, RunResult
from nmt_core.base_node import SAMPLES_QOS
from nmt_core.vocabulary import LoopState, PointStatus, ResultCode
from nmt_msgs.msg import Drive, Level, LockEvent
from nmt_msgs.msg import SampleBlock as SampleBlockMessage
from nmt_record.bag.bag_reader import Bag


def stranger(bench: Bench) -> Node:
    """A node on the bench's domain that nobody asked for."""
    node = Node("stranger", context=bench.context, enable_rosout=False, start_parameter_services=False)
    bench.add_node("stranger", node)
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


def disturbed(
    out: Path, kind: Any, topic: str, sent: list[Any], linked: bool = False
) -> tuple[RunResult, dict[str, dict[str, Any]]]:
    """A run in which a stranger becomes a second publisher of a topic once the loop has locked; and the counters.

    Past the middleware (``linked``) a stranger is not even heard; without, as in real time, what it says is refused.
    """
    # A window of two minutes takes a second: nodes hear of a stranger before it is over.
    with Bench("beam", [0.3, 0.4], out=out, window_periods=3000, linked=linked) as bench:
        node = stranger(bench)
        publishers: list[Any] = []

        def disturb(progress: Progress) -> None:
            if progress.state == LoopState.LOCKED and not publishers:
                publishers.append(node.create_publisher(kind, topic, SAMPLES_QOS))
                for message in sent:
                    publishers[0].publish(message)

        result = bench.run(disturb)
        assert publishers
        counters = {}
        for name in ("plant", "pll", "sequencer"):
            bench.nodes[name].update_counters()
            counters[name] = bench.nodes[name].counters
    return result, counters


def assert_ended_by_a_ramp(result: RunResult) -> None:
    """The stranger is named, the level was never passed, and the last block is zero after a ramp."""
    assert "/stranger" in result.message
    assert result.bag_state == "closed"
    assert result.bag is not None
    blocks = list(Bag.open(result.bag).blocks("voltage"))
    voltage = np.concatenate([block.data[0] for block in blocks])
    assert 0.29 < np.max(np.abs(voltage)) <= 0.3
    assert not blocks[-1].data.any()
    assert np.max(np.abs(np.diff(voltage))) < 0.3 * 2 * np.pi * 25 / 10_000


@pytest.mark.parametrize("silent", with_quick([False, True], False))
@pytest.mark.campaign
def test_a_second_publisher_of_drive_moves_nothing_and_ends_the_run(silent: bool, tmp_path: Path) -> None:
    attack = Drive(waveform=Drive.SINE, frequency_hz=22.0, amplitude=5.0)
    blind = Drive(waveform=Drive.SINE, frequency_hz=22.0, amplitude=5.0, based_on_sample=2**60)
    sent = [] if silent else [*nonsense_drives(), blind, *[attack] * 100]
    result, counters = disturbed(tmp_path / "out", Drive, "drive", sent)
    assert result.code == ResultCode.NODE_LOST
    assert_ended_by_a_ramp(result)
    assert counters["plant"]["refused"] >= len(sent)


@pytest.mark.parametrize("linked", [pytest.param(False, marks=pytest.mark.campaign), True])
def test_a_second_publisher_of_level_moves_nothing_and_ends_the_run(linked: bool, tmp_path: Path) -> None:
    sent = [Level(**{"amplitude": 5.0, "sequence": 2**30, **values}) for values in (
        {}, {"apply_at_sample": 2**60}, {"amplitude": math.nan}, {"amplitude": -3.0}, {"control": 9},
        {"ramp": math.inf},
    )]  # fmt: skip
    result, counters = disturbed(tmp_path / "out", Level, "level", sent, linked)
    assert result.code == ResultCode.NODE_LOST
    assert_ended_by_a_ramp(result)
    if not linked:  # past the middleware nothing of it need arrive before the run ends
        assert counters["pll"]["refused"] >= len(sent)


def test_a_run_does_not_begin_under_two_publishers() -> None:
    with Bench("beam", [0.3], window_periods=10, node_values={"sequencer": {"ready_timeout": 2.0}}) as bench:
        stranger(bench).create_publisher(Drive, "drive", SAMPLES_QOS)
        result = bench.run()
    assert result.code == ResultCode.NODE_LOST
    assert "plant (topic drive has several publishers: /pll and /stranger)" in result.message


def test_blocks_of_another_source_do_not_reach_the_loop_unnoticed(tmp_path: Path) -> None:
    with Bench("beam", [0.3], out=tmp_path / "out", window_periods=300, linked=False) as bench:
        bench.nodes["plant"].identity.topics.clear()  # as if it had not noticed the second publisher
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
    assert point.status != PointStatus.OK or point.damping_ratio == pytest.approx(0.00853, rel=0.02)


def test_lock_events_of_strangers_do_not_stop_the_nodes(tmp_path: Path) -> None:
    with Bench("beam", [0.3], out=tmp_path / "out", window_periods=300) as bench:
        bench.nodes["pll"].identity.topics.clear()  # as if it had not noticed the second publisher
        lock = stranger(bench).create_publisher(LockEvent, "lock", SAMPLES_QOS)
        sent: list[int] = []

        def disturb(progress: Progress) -> None:
            if not sent:
                sent.append(progress.sample)
                lock.publish(LockEvent())
                lock.publish(LockEvent(level_index=4_000_000_000, window_samples=2**60))

        result = bench.run(disturb)
    assert result.code in (ResultCode.SUCCEEDED, ResultCode.STOPPED)
    assert result.bag_state == "closed"
    assert any(point.status == PointStatus.OK for point in result.points)


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
