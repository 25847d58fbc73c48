"""The plant node: one device behind the bench's topics, paced in lockstep or in real time."""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Iterator
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import SetParametersResult
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool, Float64, UInt64
from std_srvs.srv import Trigger

from nmt_core.base_node import SAMPLES_QOS, STATE_QOS, BenchNode, spin_node
from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity, SampleBlock
from nmt_core.messages.bundle import LOOP_INPUT, PLANT_BUNDLE, BundleWriter
from nmt_core.messages.command_judge import CommandSource
from nmt_core.messages.records import SignalLevels
from nmt_core.messages.run_announcement import TAKEN_TOPICS
from nmt_core.messages.wire import DRIVE_STOP, MONITOR, RUN_STATE, BlockWriter, read_drive
from nmt_core.nodes.liveness import READY
from nmt_core.vocabulary import OutputState, RunPhase, StopCause
from nmt_msgs.msg import Bundle, Drive, DriveStop, Monitor, RunState
from nmt_msgs.msg import SampleBlock as SampleBlockMessage
from nmt_plant.devices.device import Device, DeviceFault, DeviceState
from nmt_plant.devices.guarded_device import LEAST_LEAD, GuardedDevice
from nmt_plant.devices.hardware_rig import HardwareRig, device_of
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_plant.plant_core import PlantCore
from nmt_plant.plant_settings import PlantSettings
from nmt_plant.real_time import LatenessHistogram, computer_settings, priority_of, real_time_priority
from nmt_rig.device_sections import SIMULATED
from nmt_rig.rig import Rig, load_rig

# Whoever publishes an emergency stop is heard, whatever quality of service was asked for; the first of these also hears
# a stop that was latched before the plant came up.
_EMERGENCY_QOS = (
    STATE_QOS,
    QoSProfile(depth=10),
    QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE),
)
_GUARD_PERIOD = 0.05
_LATE_LIMIT = 5.0  # s a real-time plant may fall behind before it gives up
_MOST_AT_ONCE = 20  # blocks in real time before other messages are looked at

_NAME_UNKNOWN = "_NODE_NAME_UNKNOWN_"
"""What rcl gives for the name of a node that it has not discovered."""


class PlantNode(BenchNode):
    """Reads blocks from a device, publishes them, and hands drive commands to it.

    Args:
        settings: for launch-free use; ROS overrides win over them.
        device: the device; None = the simulated rig of ``rig_file``.
        **kwargs: forwarded to :class:`rclpy.node.Node`.

    Raises:
        BenchError: no rig file, or one that is not usable.
    """

    settings: PlantSettings

    def __init__(self, settings: PlantSettings | None = None, device: Device | None = None, **kwargs: Any) -> None:
        super().__init__("plant", PlantSettings, settings, **kwargs)
        self._refuse_simulated_time()
        self._frame = "rig"
        self._priority: contextlib.ExitStack | None = None
        self._kind = self.settings.device.removeprefix(SIMULATED)
        if device is None:
            if not self.settings.rig_file:
                raise BenchError("The plant node needs the parameter 'rig_file': a path or the name of a rig.")
            rig = load_rig(self.settings.rig_file)
            self._frame = rig.name
            device = self._converter(rig) if self._kind else self._simulated(rig)
        if not isinstance(device, GuardedDevice):
            raise BenchError(
                "The plant drives devices with an output guard only; derive "
                f"{type(device).__name__} from GuardedDevice."
            )
        if self.settings.pacing == "realtime" and not device.is_owned:
            raise BenchError(
                "The plant runs in real time only where a process of its own owns the output; give "
                f"{type(device).__name__} an 'output' (guarded_device.owned_output)."
            )
        self.device: GuardedDevice = device
        lead = round(self.settings.reader_lead * device.sample_rate)
        self.core = PlantCore(device, self.settings.latency_blocks, self.in_lockstep, lead)
        self._lockstep = self.core.lockstep
        self._period = device.block_samples / device.sample_rate
        self._failed = self._second = ""
        self._quiet_sample: int | None = None
        self._told_trip = ""
        self._commands = self._refused = self._overruns = 0
        self._worst_lateness = self._busy = self._started = 0.0
        self._jitter: list[float] = []
        self._histogram = LatenessHistogram(self._period)

        self._publishers_by_quantity: dict[int, tuple[str, Any, BlockWriter]] = {}
        for quantity in self.core.quantities:
            publisher = self.bench_publisher(SampleBlockMessage, quantity.topic, SAMPLES_QOS)
            self._publishers_by_quantity[int(quantity)] = (quantity.topic, publisher, BlockWriter(self._frame))
        self._loop_input: BundleWriter | None = None
        self._loop_writers: dict[int, BlockWriter] = {}
        loop_topics = self.settings.loop_topics
        if any(loop_topics):
            self._loop_point = self.settings.drive_point
            chosen = [quantity for quantity in self.core.quantities if quantity.topic in loop_topics]
            self._loop_writers = {int(quantity): BlockWriter(self._frame) for quantity in chosen}
            inputs = self.bench_publisher(Bundle, LOOP_INPUT, SAMPLES_QOS)
            self._loop_input = BundleWriter([quantity.topic for quantity in chosen], 1, inputs.publish)
        self._bundle: BundleWriter | None = None
        bundled = self.settings.bundle_blocks
        if bundled > 0:
            topics = [*(quantity.topic for quantity in self.core.quantities), "monitor"]
            bundles = self.bench_publisher(Bundle, PLANT_BUNDLE, SAMPLES_QOS)
            self._bundle = BundleWriter(topics, bundled, bundles.publish)
        self._monitor = self.bench_publisher(Monitor, "monitor", SAMPLES_QOS)
        # Plain numbers for tools that plot, which need no message of the bench's; lockstep is too fast to be watched.
        viewed = [] if self._lockstep else ["frequency", *(quantity.topic for quantity in self.core.quantities)]
        self._views = {topic: self.create_publisher(Float64, f"view/{topic}", 10) for topic in viewed}
        self.command_subscription(Drive, "drive", self._on_drive, SAMPLES_QOS)
        self.bench_subscription(RunState, "run_state", self._on_run_state, STATE_QOS, raw=True)
        if lead and self.in_lockstep:
            for reader, topic in TAKEN_TOPICS.items():
                self.create_subscription(UInt64, topic, partial(self._on_progress, reader), STATE_QOS)
        self._stops = self.bench_publisher(DriveStop, "drive_stop", STATE_QOS)
        # One of them fits whoever stops, so that the others do not is nothing to warn of.
        calm = SubscriptionEventCallbacks(use_default_callbacks=False)
        for service in _EMERGENCY_QOS:
            self.create_subscription(Bool, "emergency_stop", self._on_emergency_stop, service, event_callbacks=calm)
        self.bench_service(Trigger, "quiet", self._quiet)
        self.bench_service(Trigger, "reset", self._reset)
        self._guard_timer = self.steady_timer(_GUARD_PERIOD, self._guard)
        alone = not self.watched_nodes
        if alone and self._lockstep:
            self.get_logger().info("Waits for a run, whose nodes set the pace; '-p pacing:=realtime' needs none")
        elif alone:
            self.core.running, self._started = True, time.monotonic()
        if not self._lockstep:
            self._tick_timer = self.steady_timer(min(1.0e-3, self._period / 8.0), self._tick)

    def _simulated(self, rig: Rig) -> SimulatedRig:
        stop_file = self.settings.stop_file
        if self.settings.pacing != "realtime":
            return SimulatedRig(rig, stop_file=stop_file)
        lead = max(LEAST_LEAD, self.settings.latency_blocks)
        record = self.settings.output_record
        return SimulatedRig(rig, stop_file=stop_file, owned=True, lead_blocks=lead, record=record)

    def _converter(self, rig: Rig) -> HardwareRig:
        if self.settings.pacing != "realtime":
            raise BenchError("A converter's samples are the clock; give the plant the pacing realtime.")
        section = device_of(rig, self._kind, self.settings.device_address)
        lead = max(LEAST_LEAD, self.settings.latency_blocks)
        # For the life of the process: a block that comes late stops a real test.
        stack = contextlib.ExitStack()
        stack.enter_context(real_time_priority())
        self._priority = stack
        return HardwareRig(rig, section, lead_blocks=lead, record=self.settings.output_record)

    def _refuse_simulated_time(self) -> None:
        """Refuse ``use_sim_time``, now and whenever it is set: a shaker moves in real time.

        Raises:
            BenchError: it is set.
        """
        sentence = (
            "The plant does not take use_sim_time: its guard and its blocks follow the steady clock; leave it out."
        )
        if self.has_parameter("use_sim_time") and self.get_parameter("use_sim_time").value:
            raise BenchError(sentence)

        def check(parameters: list[Any]) -> SetParametersResult:
            refused = any(item.name == "use_sim_time" and item.value for item in parameters)
            return SetParametersResult(successful=not refused, reason=sentence if refused else "")

        self.add_on_set_parameters_callback(check)

    # -- lockstep ------------------------------------------------------------------------------------------------

    def _on_run_state(self, raw: bytes) -> None:
        try:
            state = RUN_STATE.read(raw)
        except ValueError as error:
            self.get_logger().error(f"Run state refused: {error}", throttle_duration_sec=1.0)
            return
        rested = not self.core.in_run
        if self.core.take_state(state):
            self._started = time.monotonic()
        if rested and self.core.in_run:
            self.liveness.meet_again(time.monotonic())
        self._advance()

    def _on_progress(self, reader: str, message: Any) -> None:
        self.core.take_progress(reader, int(message.data))
        self._advance()

    def _on_drive(self, raw: bytes, source: CommandSource) -> None:
        self._commands += 1
        if self._failed:
            return  # the device is closed; what failed has been said
        try:
            why = self.core.take_drive(read_drive(raw), source)
        except (BenchError, ValueError) as error:
            why = str(error)
        if why:
            self._refused += 1
            self.get_logger().error(f"Drive command refused: {why}", throttle_duration_sec=1.0)
        if self.core.second_source:
            self._end_for_second_source(self.core.second_source)
        self._advance()

    def _end_for_second_source(self, second: str) -> None:
        """Ramp to zero, since the source of commands is unknown; why comes before the blocks."""
        if self._second == second or self._failed or not self.core.in_run:
            return
        self._second = second
        self.get_logger().warning(f"Drive goes to zero: {second}.")
        self.publish_diagnostics()
        self._quiet_down(second)

    def _advance(self) -> None:
        """Produce the blocks that are due in lockstep: one for every answer."""
        while not self._failed and self.core.due:
            self._produce()

    def _produce(self) -> None:
        began = time.perf_counter()
        try:
            blocks = self.core.produce()
        except DeviceFault as error:
            self._fail(f"The device failed: {error}")
            return
        self._publish(blocks)
        self._busy += time.perf_counter() - began

    def _publish(self, blocks: list[SampleBlock]) -> None:
        self._publish_stop()
        written = [self._publishers_by_quantity[int(block.quantity)][2].write(block) for block in blocks]
        if self._loop_input is not None and blocks:
            self._publish_loop_input(self._loop_input, blocks, written)
        for block, raw in zip(blocks, written, strict=True):
            topic, publisher, _ = self._publishers_by_quantity[int(block.quantity)]
            publisher.publish(raw)
            if self._bundle is not None:
                self._bundle.add(topic, raw)
        levels = self.core.levels(blocks)
        if levels is not None:
            monitor = MONITOR.write(levels)
            self._monitor.publish(monitor)
            if self._bundle is not None:
                self._bundle.add("monitor", monitor)
            self._publish_views(levels)
        if self._bundle is not None:
            self._bundle.end_block(last=self.core.phase != RunPhase.RUNNING)

    def _publish_views(self, levels: SignalLevels) -> None:
        """Frequency of the drive, and the largest magnitude of each quantity at the drive point since the last view."""
        for topic, publisher in self._views.items():
            value = levels.frequency_hz
            if topic != "frequency":
                value = levels.drive_point[Quantity[topic.upper()] - Quantity.FORCE][0]
            publisher.publish(Float64(data=float(value)))

    def _publish_loop_input(self, joined: BundleWriter, blocks: list[SampleBlock], written: list[bytes]) -> None:
        """What the loop waits for, in one message and before all else; ``written``: the blocks as messages."""
        for block, raw in zip(blocks, written, strict=True):
            writer = self._loop_writers.get(int(block.quantity))
            if writer is not None:
                chosen = block.at_point(self._loop_point) if self._loop_point else block
                joined.add(block.quantity.topic, raw if chosen is block else writer.write(chosen))
        joined.flush()

    def _publish_stop(self) -> None:
        stop = self.core.stop()
        if stop is not None:
            self._stops.publish(DRIVE_STOP.write(stop))

    # -- real time -----------------------------------------------------------------------------------------------

    def _tick(self) -> None:
        """Produce the blocks that the converter has put out."""
        for _ in range(_MOST_AT_ONCE):
            if not self.core.running or self._failed or not self.device.is_ready:
                break
            lateness = self.device.lateness
            if lateness > _LATE_LIMIT:
                self._fail(f"The plant fell {lateness:.1f} s behind real time.")
                return
            self._worst_lateness = max(self._worst_lateness, lateness)
            self._jitter.append(lateness)
            self._histogram.add(lateness)
            if lateness > self._period + self.device.turn_time:
                self._overruns += 1
            self._produce()
        if len(self._jitter) > 100_000:
            del self._jitter[:50_000]

    # -- safety --------------------------------------------------------------------------------------------------

    def _guard(self) -> None:
        """Quiet the drive when the nodes that command it have gone; in lockstep blocks go on until it is at zero."""
        if self._bundle is not None:
            self._bundle.flush()
        if self._failed:
            return
        if self.device.output_state is OutputState.NOT_KNOWN:
            self._fail(f"The device failed: {self.device.output_sentence}")
            return
        self._publish_stop()
        if not self.core.running:
            return
        self._tell_trip()
        second = self.second_publisher()
        if second:
            self._end_for_second_source(second)
        lost = self.liveness.first_lost(time.monotonic())
        starved = self.core.starved
        if lost:
            self._quiet_down(lost)
        elif self.core.phase == RunPhase.DONE and starved and not self.core.at_rest:
            self._quiet_down("the run is over")

    def _tell_trip(self) -> None:
        """One line for every stop of the drive, and one when it is over."""
        told, now = self._told_trip, self.device.tripped
        if now and self.device.is_quiet:
            now = f"{now}. The drive is at zero"
        if now == told:
            return
        self._told_trip = now
        if now:
            self.get_logger().warning(f"The output has tripped: {now}.")
        else:
            self.get_logger().info("The output is armed again")

    def _quiet_down(self, reason: str) -> None:
        """Emergency ramp to zero; in lockstep produced right away, since only this moves bench time on."""
        if not self.device.is_quiet and self.device.state is DeviceState.RUNNING and not self.device.tripped:
            self.get_logger().error(f"Drive goes to zero: {reason}.")
        self._publish_ramp(self.core.quiet_down(reason))

    def _publish_ramp(self, ramp: Iterator[list[SampleBlock]]) -> None:
        try:
            for blocks in ramp:
                self._publish(blocks)
            self._publish_stop()
        except DeviceFault as error:
            self._fail(f"The device failed: {error}")

    def _on_emergency_stop(self, message: Any) -> None:
        """Anybody may stop; only the operator ends a stop, by `reset`."""
        if message.data and self.device.stop_cause is not StopCause.EMERGENCY_STOP:
            found = self.get_publishers_info_by_topic(self.resolve_topic_name("emergency_stop"))
            # A publisher may be matched before its node's name has come.
            names = {
                "a node that has not told its name yet"
                if _NAME_UNKNOWN in info.node_name
                else f"{info.node_namespace.rstrip('/')}/{info.node_name}"
                for info in found
            }
            self._stop_drive(
                f"emergency stop by {' or '.join(sorted(names)) or 'a node that has gone'}", StopCause.EMERGENCY_STOP
            )

    def _quiet(self, _: Any, response: Any) -> Any:
        response.success = self._stop_drive("the service quiet", StopCause.QUIET)
        response.message = "the drive goes to zero and is held there" if response.success else self._failed
        return response

    def _stop_drive(self, reason: str, cause: StopCause) -> bool:
        """Ramp to zero and hold; blocks go on. False where the device has failed and is closed."""
        if self._failed or self.device.state is not DeviceState.RUNNING:
            return False
        if not self.device.tripped:
            self.get_logger().warning(f"Drive goes to zero: {reason}.")
        self._publish_ramp(self.core.stop_drive(reason, cause))
        self.publish_diagnostics()
        return not self._failed

    def _fail(self, reason: str) -> None:
        self._failed = reason
        self.get_logger().error(reason)
        self.publish_diagnostics()
        self.device.close()
        self._stops.publish(DRIVE_STOP.write(self.core.failure(reason)))

    def _reset(self, _: Any, response: Any) -> Any:
        if self._failed:
            response.success, response.message = False, self._failed
        elif not self.device.is_quiet:
            response.success, response.message = False, "the drive is not at zero yet"
        else:
            try:
                self.device.reset()
            except (BenchError, DeviceFault) as error:
                response.success, response.message = False, str(error)
                return response
            self._second = ""
            self.get_logger().info("Drive released by the service reset.")
            self._publish_stop()
            response.success, response.message = True, "limits are armed again"
        return response

    @property
    def is_at_work(self) -> bool:
        """Whether a run is under way."""
        return bool(self.core.in_run)

    def update_counters(self) -> None:
        """Counters for the heartbeat; in real time also jitter and margin."""
        elapsed = time.monotonic() - self._started if self._started else 0.0
        bench_time = self.device.next_sample / self.device.sample_rate if not self._failed else 0.0
        self.counters.update(
            sample_rate=float(self.device.sample_rate),
            block_samples=int(self.device.block_samples),
            next_sample=self.device.next_sample,
            commands=self._commands,
            refused=self._refused,
            **{f"drive_{key}": value for key, value in self.core.judge.counts.items()},
            tripped=self._failed or self.device.tripped,
            warnings="; ".join(self.device.warnings),
            margins=json.dumps({name: round(value, 3) for name, value in self.device.margins.items()}),
            spread_samples=self.device.spread_samples,
            drive_at_zero=int(self.device.is_quiet),
            **self._output_counters(),
            waits_for=self.core.waits_for,
            real_time_factor=round(bench_time / elapsed, 2) if elapsed > 0 else 0.0,
        )
        if not self._lockstep and self._jitter:
            ordered = sorted(self._jitter[-10_000:])
            self.counters.update(
                overruns=self._overruns,
                jitter_p50_ms=round(1e3 * ordered[len(ordered) // 2], 3),
                jitter_p99_ms=round(1e3 * ordered[int(0.99 * (len(ordered) - 1))], 3),
                jitter_max_ms=round(1e3 * self._worst_lateness, 3),
                lateness_histogram=self._histogram.text,
                real_time_margin=round(1.0 - self._busy / max(bench_time, self._period), 4),
            )

    def _output_counters(self) -> dict[str, int | float | str]:
        device = self.device
        if not device.is_owned:
            return {}
        return {
            "output": device.output_sentence,
            **self._converter_counters(),
            "output_pid": device.output_pid or 0,
            "output_record": device.output_record,
        }

    def _converter_counters(self) -> dict[str, int | float | str]:
        """Delay, clock, losses and priority of a converter, for the bag and the report."""
        if not isinstance(self.device, HardwareRig):
            return {}
        figures = self.device.figures
        return {
            "converter_delay": figures.delay,
            "converter_round_trip": figures.round_trip,
            "converter_stated": figures.stated,
            "converter_drift": round(figures.drift, 3),
            "converter_clock_ppm": round(figures.clock_ppm, 1),
            "converter_monitor_gain": round(figures.monitor_gain, 6),
            "converter_lost_turns": figures.lost_turns,
            "converter_priority": priority_of(self.device.output_pid),
            "plant_priority": priority_of(os.getpid()),
            "computer": computer_settings(),
            "overloaded": ", ".join(self.device.overloaded),
        }

    def publish_diagnostics(self, level: bytes = DiagnosticStatus.OK, message: str = "") -> None:
        """Publish the counters; a failed device or a second publisher is an error, a warning level a warning."""
        if self._failed or self._second:
            self.update_counters()
            level, message = DiagnosticStatus.ERROR, self._failed or self._second
        elif level == DiagnosticStatus.OK and (self.device.warnings or self.device.tripped):
            level = DiagnosticStatus.WARN
            if self.device.tripped and message == READY and not self.core.in_run:
                message = f"the drive is held at zero ({self.device.tripped}) until the service 'reset' is called"
        super().publish_diagnostics(level, message)

    def told_to_end(self) -> None:
        """Take the drive to zero while others still hear of it: the ramp belongs into the bag."""
        super().told_to_end()
        if self.core.running and not self._failed:
            self._quiet_down("the plant node was told to end")

    def may_end(self, since: float) -> bool:
        """When a block with the drive at zero has been published."""
        if self._failed or not self.core.running or self.device.state is not DeviceState.RUNNING:
            return True
        if not self.device.is_quiet:
            self._quiet_sample = None
            return False
        if self._quiet_sample is None:
            self._quiet_sample = self.device.next_sample
        return self._lockstep or self.device.next_sample > self._quiet_sample

    def shut_down(self) -> None:
        """Take the drive to zero along its ramp and release the device."""
        if self._bundle is not None:
            self._bundle.flush()
        with contextlib.suppress(Exception):
            self.core.shut_down("the plant node ends")
        if self._priority is not None:
            self._priority.close()


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run nmt_plant plant``."""
    return spin_node(PlantNode, args)
