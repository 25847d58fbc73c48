"""Every way to stop the drive at the plant: it goes to zero, stays there until ``reset``, and the bag says why."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from tiers import with_quick

from nmt_bench.harness import Bench, Progress, RunResult
from nmt_core.base_node import STATE_QOS
from nmt_core.messages.records import DriveStop
from nmt_core.messages.wire import DRIVE_STOP
from nmt_core.vocabulary import BlockFlag, LoopState, OutputState, ResultCode, StopCause
from nmt_record.bag.bag_reader import Bag

QUALITIES = {
    "latched": STATE_QOS,
    "volatile": QoSProfile(depth=1),
    "best effort": QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE),
}


def stranger(bench: Bench, name: str = "door") -> Node:
    node = Node(name, context=bench.context, enable_rosout=False, start_parameter_services=False)
    bench.add_node(name, node)
    return node


def call(bench: Bench, service: str) -> tuple[bool, str]:
    """Call a service of a node of the bench, once the run is over."""
    node = stranger(bench, f"caller_of_{service}")
    client = node.create_client(Trigger, service)
    bench.spin_until(client.service_is_ready, 5.0, service)
    answer = bench.wait_for(client.call_async(Trigger.Request()), 5.0, service)
    return bool(answer.success), str(answer.message)


def once_locked(act: Callable[[], Any]) -> Callable[[Progress], None]:
    done: list[Any] = []

    def look(progress: Progress) -> None:
        if progress.state == LoopState.LOCKED and not done:
            done.append(act())
            done.append(True)

    return look


def stops(result: RunResult) -> list[DriveStop]:
    assert result.bag is not None
    return list(Bag.open(result.bag).records("drive_stop", DRIVE_STOP))


def assert_stopped(result: RunResult, cause: StopCause, words: str) -> None:
    """The run ended with the reason, the bag has the stop with its sample, and the drive was ramped to zero there."""
    assert result.code == ResultCode.STOPPED
    assert words in result.message
    assert result.bag_state == "closed"
    told = stops(result)
    assert [(stop.cause, stop.output) for stop in told] == [(cause, OutputState.RAMPING), (cause, OutputState.HELD)]
    assert words in told[0].reason
    blocks = list(Bag.open(result.bag or Path()).blocks("voltage"))
    flagged = [block for block in blocks if block.flags & BlockFlag.STOP]
    assert abs(flagged[0].first_sample - told[0].sample) <= flagged[0].samples
    assert flagged[0].data.any()
    assert not blocks[-1].data.any()
    line = np.concatenate([block.data[0] for block in blocks])
    assert np.max(np.abs(np.diff(line))) < 0.3 * 2 * np.pi * 25 / 10_000, "a ramp, not a step"


def test_quiet_stops_measures_on_and_is_released_by_reset(tmp_path: Path) -> None:
    with Bench("beam", [0.3], out=tmp_path / "out", window_periods=300) as bench:
        client = stranger(bench).create_client(Trigger, "quiet")
        result = bench.run(once_locked(lambda: client.call_async(Trigger.Request())))
        assert call(bench, "reset") == (True, "limits are armed again")
        assert bench.nodes["plant"].device.stop_cause is StopCause.UNKNOWN
    assert_stopped(result, StopCause.QUIET, "the service quiet")


@pytest.mark.parametrize("quality", with_quick(QUALITIES, "best effort"))
def test_anybody_may_stop_and_nobody_but_reset_releases(quality: str, tmp_path: Path) -> None:
    with Bench("beam", [0.3], out=tmp_path / "out", window_periods=300) as bench:
        publisher = stranger(bench).create_publisher(Bool, "emergency_stop", QUALITIES[quality])
        result = bench.run(once_locked(lambda: publisher.publish(Bool(data=True))))
        publisher.publish(Bool(data=False))
        bench.spin(0.3)
        device = bench.nodes["plant"].device
        assert device.stop_cause is StopCause.EMERGENCY_STOP
        assert call(bench, "reset")[0]
        bench.spin(0.3)
        assert device.stop_cause is StopCause.UNKNOWN, "what was latched before does not stop again"
    assert_stopped(result, StopCause.EMERGENCY_STOP, "emergency stop by /door")


def test_a_stop_that_was_latched_before_the_plant_came_holds_it(tmp_path: Path) -> None:
    values = {"sequencer": {"ready_timeout": 3.0}}
    with Bench("beam", [0.3], out=tmp_path / "out", window_periods=10, node_values=values) as bench:
        stranger(bench).create_publisher(Bool, "emergency_stop", STATE_QOS).publish(Bool(data=True))
        result = bench.run()
        assert bench.nodes["plant"].device.next_sample == 0
    assert result.code == ResultCode.NODE_LOST
    assert "plant (the drive is held at zero (emergency stop by /door) until the service 'reset' is called)" in (
        result.message
    )


def test_false_stops_nothing(tmp_path: Path) -> None:
    with Bench("beam", [0.3], out=tmp_path / "out", window_periods=20) as bench:
        publisher = stranger(bench).create_publisher(Bool, "emergency_stop", STATE_QOS)
        result = bench.run(once_locked(lambda: publisher.publish(Bool(data=False))))
    assert result.code == ResultCode.SUCCEEDED
    assert stops(result) == []


@pytest.mark.parametrize("pacing", with_quick(["lockstep", "realtime"], "lockstep"))
def test_the_external_stop_input_holds_until_it_is_released_and_reset(pacing: str, tmp_path: Path) -> None:
    line = tmp_path / "stop"
    values = {"plant": {"stop_file": str(line)}}
    options: dict[str, Any] = {"window_periods": 300, "node_values": values, "pacing": pacing, "latency_blocks": 0}
    if pacing == "realtime":
        options.update(window_periods=60, latency_blocks=8)
    with Bench("beam", [0.3], out=tmp_path / "out", **options) as bench:
        result = bench.run(once_locked(line.touch))
        bench.spin(1.0)
        succeeded, words = call(bench, "reset")
        assert not succeeded
        assert words == "the external stop input still asks for zero; release it first"
        line.unlink()
        bench.spin(0.5)
        client = bench.nodes["caller_of_reset"].create_client(Trigger, "reset")
        assert bench.wait_for(client.call_async(Trigger.Request()), 5.0, "reset").success
    assert_stopped(result, StopCause.EXTERNAL_INPUT, "the external stop input")


def test_the_command_stops_the_bench_of_a_domain(tmp_path: Path) -> None:
    with Bench("beam", [0.3], out=tmp_path / "out", window_periods=30000) as bench:
        command = [sys.executable, "-m", "nmt_bench", "stop", "--domain", str(bench.domain_id), "--timeout", "30"]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(part for part in sys.path if part)}
        started: list[subprocess.Popen[str]] = []

        def stop() -> None:
            started.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment))

        result = bench.run(once_locked(stop))
        (process,) = started
        bench.spin_while(lambda: process.poll() is None, 30.0)
        words, _ = process.communicate(timeout=30)
    assert process.returncode == 0
    assert f"Domain {bench.domain_id}: the drive is held at zero; sample" in words
    assert "emergency stop by" in words
    assert result.code == ResultCode.STOPPED
    # The plant obeys at once; it may not know yet who that was.
    assert re.search(r"emergency stop by (/nmt_stop|a node that has not told its name yet)", result.message)
