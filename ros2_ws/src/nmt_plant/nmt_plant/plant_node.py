"""The plant node: one device behind the bench's topics, paced in lockstep or in real time."""

from __future__ import annotations

import contextlib
import json
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import SetParametersResult
from std_srvs.srv import Trigger

from nmt_core.base_node import SAMPLES_QOS, STATE_QOS, BenchNode, spin_node
from nmt_core.blocks import SampleBlock
from nmt_core.command_judge import Source
from nmt_core.errors import BenchError
from nmt_core.parameters import Parameter
from nmt_core.vocabulary import RunPhase
from nmt_core.wire import RUN_STATE, BlockWriter, read_drive
from nmt_msgs.msg import Drive, RunState
from nmt_msgs.msg import SampleBlock as SampleBlockMessage
from nmt_plant.device import Device, DeviceFault, DeviceState
from nmt_plant.guarded_device import GuardedDevice
from nmt_plant.plant_core import PlantCore
from nmt_plant.simulated_rig import SimulatedRig
from nmt_rig.rig import load_rig

PARAMETERS = (
    Parameter("rig_file", "", "", "Rig file to simulate: a path, or the name of a rig that comes with the bench."),
    Parameter(
        "pacing",
        "lockstep",
        "",
        "lockstep: every block waits for the drive computed from the one before; realtime: paced by the steady clock.",
        choices=("lockstep", "realtime"),
    ),
    Parameter("latency_blocks", 0, "blocks", "Blocks of buffering between command and excitation.", low=0, high=100),
    Parameter(
        "command_timeout",
        10.0,
        "s",
        "Wall time in lockstep without a command after which blocks go on without it, so that the watchdog can act.",
        low=0.1,
    ),
)

_GUARD_PERIOD = 0.05
_LATE_LIMIT = 5.0  # s a real-time plant may fall behind before it gives up


class PlantNode(BenchNode):
    """Reads blocks from a device, publishes them, and hands drive commands to it.

    Args:
        values: parameter values for launch-free use; see ``PARAMETERS``.
        device: the device; None = the simulated rig of ``rig_file``.
        **kwargs: forwarded to :class:`rclpy.node.Node`.

    Raises:
        BenchError: no rig file, or one that is not usable.
    """

    def __init__(self, values: dict[str, Any] | None = None, device: Device | None = None, **kwargs: Any) -> None:
        super().__init__("plant", PARAMETERS, values, **kwargs)
        self._refuse_simulated_time()
        self._frame = "rig"
        if device is None:
            if not self.values["rig_file"]:
                raise BenchError("The plant node needs the parameter 'rig_file': a path or the name of a rig.")
            rig = load_rig(str(self.values["rig_file"]))
            self._frame = rig.name
            device = SimulatedRig(rig)
        if not isinstance(device, GuardedDevice):
            raise BenchError(
                "The plant drives devices with an output guard only; derive "
                f"{type(device).__name__} from GuardedDevice."
            )
        self.device: GuardedDevice = device
        self.core = PlantCore(device, int(self.values["latency_blocks"]), self.values["pacing"] == "lockstep")
        self._lockstep = self.core.lockstep
        self._period = device.block_samples / device.sample_rate
        self._failed = self._second = ""
        self._last_command = time.monotonic()
        self._next_due = 0.0
        self._commands = self._refused = self._overruns = 0
        self._worst_lateness = self._busy = self._started = 0.0
        self._jitter: list[float] = []

        self._publishers_by_quantity: dict[int, tuple[Any, BlockWriter]] = {}
        for quantity in self.core.quantities:
            publisher = self.bench_publisher(SampleBlockMessage, quantity.topic, SAMPLES_QOS)
            self._publishers_by_quantity[int(quantity)] = (publisher, BlockWriter(self._frame))
        self.command_subscription(Drive, "drive", self._on_drive, SAMPLES_QOS)
        self.bench_subscription(RunState, "run_state", self._on_run_state, STATE_QOS, raw=True)
        self.create_service(Trigger, "reset", self._reset)
        self._guard_timer = self.steady_timer(_GUARD_PERIOD, self._guard)
        if not self._lockstep:
            self._tick_timer = self.steady_timer(min(1.0e-3, self._period / 8.0), self._tick)

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
        if self.core.take_state(state):
            self._begin()
        self._advance()

    def _begin(self) -> None:
        self._last_command = time.monotonic()
        self._started = time.monotonic()
        self._next_due = self._started + self._period

    def _on_drive(self, raw: bytes, source: Source) -> None:
        self._commands += 1
        try:
            why = self.core.take_drive(read_drive(raw), source)
        except (BenchError, ValueError) as error:
            why = str(error)
        if why:
            self._refused += 1
            self.get_logger().error(f"Drive command refused: {why}", throttle_duration_sec=1.0)
        else:
            self._last_command = time.monotonic()
        if self.core.second_source:
            self._end_for_second_source(self.core.second_source)
        self._advance()

    def _end_for_second_source(self, second: str) -> None:
        """Ramp to zero, since nobody can tell any more whose commands these are; why comes before the blocks."""
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
        for block in blocks:
            publisher, writer = self._publishers_by_quantity[int(block.quantity)]
            publisher.publish(writer.write(block))

    # -- real time -----------------------------------------------------------------------------------------------

    def _tick(self) -> None:
        """Produce the blocks whose last sample has come to pass on the steady clock."""
        if not self.core.running or self._failed:
            return
        now = time.monotonic()
        if now - self._next_due > _LATE_LIMIT:
            self._fail(f"The plant fell {now - self._next_due:.1f} s behind real time.")
            return
        while now >= self._next_due:
            lateness = now - self._next_due
            self._worst_lateness = max(self._worst_lateness, lateness)
            self._jitter.append(lateness)
            if lateness > self._period:
                self._overruns += 1
            self._produce()
            self._next_due += self._period
            now = time.monotonic()
        if len(self._jitter) > 100_000:
            del self._jitter[:50_000]

    # -- safety --------------------------------------------------------------------------------------------------

    def _guard(self) -> None:
        """Quiet the drive when the nodes that command it have gone; in lockstep blocks go on until it is at zero."""
        if self._failed or not self.core.running:
            return
        second = self.second_publisher()
        if second:
            self._end_for_second_source(second)
        silent = self.silent_node()
        starved = self.core.starved
        overdue = time.monotonic() - self._last_command > float(self.values["command_timeout"])
        if silent:
            self._quiet_down(f"node {silent} has fallen silent")
        elif self._lockstep and starved and overdue and self.core.phase != RunPhase.PAUSED and not self.device.is_quiet:
            self._quiet_down("no drive command arrives")
        elif self.core.phase == RunPhase.DONE and starved and not self.device.is_quiet:
            self._quiet_down("the run is over")

    def _quiet_down(self, reason: str) -> None:
        """Emergency ramp to zero; in lockstep produced right away, since nobody else moves bench time on."""
        if not self.device.is_quiet and self.device.state is DeviceState.RUNNING and not self.device.tripped:
            self.get_logger().error(f"Drive goes to zero: {reason}.")
        try:
            for blocks in self.core.quiet_down(reason):
                self._publish(blocks)
        except DeviceFault as error:
            self._fail(f"The device failed: {error}")

    def _fail(self, reason: str) -> None:
        self._failed = reason
        self.get_logger().error(reason)
        self.publish_diagnostics()
        self.device.close()

    def _reset(self, _: Any, response: Any) -> Any:
        if self._failed:
            response.success, response.message = False, self._failed
        elif not self.device.is_quiet:
            response.success, response.message = False, "the drive is not at zero yet"
        else:
            self.device.reset()
            self._second = ""
            response.success, response.message = True, "limits are armed again"
        return response

    def update_counters(self) -> None:
        """Counters for the heartbeat; in real time also jitter and margin."""
        elapsed = time.monotonic() - self._started if self._started else 0.0
        bench_time = self.device.next_sample / self.device.sample_rate if not self._failed else 0.0
        owned = self.device.output_pid is not None
        self.counters.update(
            next_sample=self.device.next_sample,
            commands=self._commands,
            refused=self._refused,
            **{f"drive_{key}": value for key, value in self.core.judge.counts.items()},
            tripped=self._failed or self.device.tripped,
            warnings="; ".join(self.device.warnings),
            margins=json.dumps({name: round(value, 3) for name, value in self.device.margins.items()}),
            spread_samples=self.device.spread_samples,
            drive_at_zero=int(self.device.is_quiet),
            **({"output": self.device.output_sentence, "output_pid": self.device.output_pid} if owned else {}),
            real_time_factor=round(bench_time / elapsed, 2) if elapsed > 0 else 0.0,
        )
        if not self._lockstep and self._jitter:
            ordered = sorted(self._jitter[-10_000:])
            self.counters.update(
                overruns=self._overruns,
                jitter_p50_ms=round(1e3 * ordered[len(ordered) // 2], 3),
                jitter_p99_ms=round(1e3 * ordered[int(0.99 * (len(ordered) - 1))], 3),
                jitter_max_ms=round(1e3 * self._worst_lateness, 3),
                real_time_margin=round(1.0 - self._busy / max(bench_time, self._period), 4),
            )

    def publish_diagnostics(self, level: bytes = DiagnosticStatus.OK, message: str = "") -> None:
        """Publish the counters; a failed device or a second publisher is an error, a warning level a warning."""
        if self._failed or self._second:
            self.update_counters()
            level, message = DiagnosticStatus.ERROR, self._failed or self._second
        elif self.device.warnings or self.device.tripped:
            level = DiagnosticStatus.WARN
        super().publish_diagnostics(level, message)

    def shut_down(self) -> None:
        """Take the drive to zero along its ramp and release the device."""
        with contextlib.suppress(Exception):
            self.core.shut_down("the plant node ends")


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run nmt_plant plant``."""
    return spin_node(PlantNode, args)
