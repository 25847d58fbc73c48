"""What the plant node insists on: a guarded device, the steady clock, and that a failed device is told at once."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64

from nmt_bench.harness import Bench, Progress
from nmt_core.base_node import SAMPLES_QOS, BenchNode
from nmt_core.errors import BenchError
from nmt_core.messages.command_judge import CommandSource
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import LoopState, PointStatus, ResultCode
from nmt_msgs.msg import Drive, SampleBlock
from nmt_plant.devices.device import DeviceFault
from nmt_plant.devices.loopback_device import LoopbackDevice
from nmt_plant.plant_node import PlantNode
from nmt_plant.plant_settings import PlantSettings
from nmt_sequencer.sequencer_node import SequencerNode

SIM_TIME = Parameter("use_sim_time", Parameter.Type.BOOL, True)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with Bench("beam", [0.3], out=tmp_path / "out", window_periods=600) as bench:
        yield bench


def test_simulated_time_is_refused_at_the_start_and_later(bench: Bench) -> None:
    with pytest.raises(BenchError, match="does not take use_sim_time"):
        PlantNode(device=LoopbackDevice(), context=bench.context, namespace="other", parameter_overrides=[SIM_TIME])
    (answer,) = bench.nodes["plant"].set_parameters([SIM_TIME])
    assert not answer.successful
    assert "does not take use_sim_time" in answer.reason
    assert not bench.nodes["plant"].get_parameter("use_sim_time").value
    assert bench.run().code == ResultCode.SUCCEEDED


def test_simulated_time_of_the_other_nodes_stops_neither_heartbeat_nor_guard(bench: Bench) -> None:
    for name in ("pll", "sequencer", "extract", "recorder"):
        (answer,) = bench.nodes[name].set_parameters([SIM_TIME])
        assert answer.successful
        assert bench.nodes[name].get_clock().ros_time_is_active
    result = bench.run()
    assert result.code == ResultCode.SUCCEEDED
    assert result.points[0].status == PointStatus.OK


def test_every_timer_of_the_nodes_runs_on_the_steady_clock(bench: Bench) -> None:
    nodes = [node for node in bench.nodes.values() if isinstance(node, BenchNode)]
    assert len(nodes) == 5
    timers = [timer for node in nodes for timer in node.timers]
    assert len(timers) >= 9
    assert all(timer.clock.clock_type == ClockType.STEADY_TIME for timer in timers)


def test_a_device_without_output_guard_is_refused(bench: Bench) -> None:
    class Bare:
        pass

    with pytest.raises(BenchError, match="derive Bare from GuardedDevice"):
        PlantNode(device=Bare(), context=bench.context, namespace="other")  # type: ignore[arg-type]


class Listener(Node):  # type: ignore[misc]
    """Keeps what the plant says of itself."""

    def __init__(self, bench: Bench) -> None:
        super().__init__("listener", context=bench.context, enable_rosout=False, start_parameter_services=False)
        self.heard: list[DiagnosticStatus] = []
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)
        bench.add_node("listener", self)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.heard += [status for status in message.status if status.name == "plant"]


def test_a_failed_device_is_an_error_at_once_and_ends_the_run(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    listener = Listener(bench)
    plant = bench.nodes["plant"]
    beats: list[int] = []

    def fail(_: Any) -> FloatArray:
        # Any later heartbeat would be another one: the error must be published with the failure.
        monkeypatch.setattr(plant, "beat", lambda: None)
        plant.beat_timer.cancel()
        raise DeviceFault("the amplifier is on fire")

    def break_it(progress: Progress) -> None:
        if progress.state == LoopState.LOCKED and not beats:
            beats.append(progress.sample)
            monkeypatch.setattr(plant.device, "_measure", fail)

    result = bench.run(break_it)
    assert beats
    assert result.code == ResultCode.NODE_LOST
    assert "Node plant reports: The device failed: the amplifier is on fire" in result.message
    late = Drive(waveform=Drive.SINE, frequency_hz=20.0, amplitude=0.1)
    plant._on_drive(serialize_message(late), CommandSource("", "/pll", alone=True))  # on its way when the device failed
    errors = [status for status in listener.heard if status.level == DiagnosticStatus.ERROR]
    assert errors
    assert "the amplifier is on fire" in errors[0].message


def test_warnings_and_margins_are_published(tmp_path: Path) -> None:
    overrides = ["limits.force_n=100", "limits.warning_share=0.001"]
    with Bench("beam", [0.3], out=tmp_path / "out", window_periods=10, overrides=overrides) as bench:
        listener = Listener(bench)
        assert bench.run().code == ResultCode.SUCCEEDED
        bench.spin(0.5)
    newest = listener.heard[-1]
    values = {item.key: item.value for item in newest.values}
    assert newest.level == DiagnosticStatus.WARN
    assert "warning" in values["warnings"]
    assert '"f' in values["margins"]
    assert "output_pid" not in values


def test_a_plant_that_is_started_alone_runs_in_real_time_with_numbers_to_plot(bench: Bench) -> None:
    plant = PlantNode(PlantSettings(rig_file="beam"), context=bench.context, namespace="alone")
    bench.add_node("alone/plant", plant)
    found: dict[str, list[Any]] = {}
    reader = Node("reader", context=bench.context, namespace="alone", enable_rosout=False)
    reader.create_subscription(SampleBlock, "force", found.setdefault("force", []).append, SAMPLES_QOS)
    for topic in ("force", "acceleration", "frequency"):
        reader.create_subscription(Float64, f"view/{topic}", found.setdefault(f"view/{topic}", []).append, 10)
    bench.add_node("reader", reader)
    bench.spin_until(lambda: all(len(heard) > 3 for heard in found.values()) and len(found) == 4, 15.0, "samples")
    blocks = found["force"]
    assert blocks[-1].first_sample > blocks[0].first_sample
    assert found["view/frequency"][-1].data == 0.0  # nothing drives
    assert not any(name.startswith("/view") for name, _ in reader.get_topic_names_and_types())  # in lockstep none


def test_a_failure_of_the_run_before_does_not_end_the_next(bench: Bench) -> None:
    sequencer = bench.nodes["sequencer"]
    assert isinstance(sequencer, SequencerNode)
    sequencer.liveness.failures["plant"] = "it was so before"
    assert bench.run().code == ResultCode.SUCCEEDED
