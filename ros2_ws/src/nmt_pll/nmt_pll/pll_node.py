"""The PLL node: force and response blocks in, drive commands, loop state and lock events out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

from nmt_core.base_node import SAMPLES_QOS, BenchNode, spin_node
from nmt_core.blocks import Quantity, SampleBlock
from nmt_core.cdr import bench_time_ns
from nmt_core.errors import BenchError
from nmt_core.linear_description import LinearDescription
from nmt_core.parameters import Parameter
from nmt_core.records import DriveCommand, LevelCommand, LockEvent, LoopStatus
from nmt_core.vocabulary import ControlKind, LoopState, TestKind, Waveform
from nmt_core.wire import LEVEL, LOCK_EVENT, BlockReader, write_drive, write_status
from nmt_msgs import msg
from nmt_pll.level_loop import LevelLoop, LockWindow, LoopOutput
from nmt_pll.loop import PhaseLockedLoop
from nmt_pll.paper_loop import PaperLoop
from nmt_pll.paper_settings import paper_parameters, paper_settings_from
from nmt_pll.random_drive import RandomDrive
from nmt_pll.settings import LoopSettings, setting_parameters, settings_from
from nmt_pll.sweep_loop import SteppedSineLoop, SweepLoop

PARAMETERS = (
    Parameter(
        "linear_json",
        "",
        "",
        "Linear description of the rig as JSON, see the reference of linear.json; empty = no phase is controlled.",
    ),
    Parameter("drive_point", 0, "", "Point of the exciter if there is no linear description.", low=0),
    Parameter("sample_rate", 10000.0, "Hz", "Sample rate of the blocks.", low=1.0),
    Parameter("block_samples", 200, "samples", "Samples a block.", low=2, high=100000),
    Parameter(
        "response_topic",
        "displacement",
        "",
        "Topic of the drive-point response whose phase is controlled.",
        choices=("displacement", "velocity", "acceleration"),
    ),
    Parameter(
        "loop",
        "adaptive",
        "",
        "adaptive: adaptive filter, closed-form gains, guard band; paper: product detector, low-pass, PI.",
        choices=("adaptive", "paper"),
    ),
    Parameter("settling_time", 2.0, "s", "Random test: between the end of the ramp and the window.", low=0.0),
    *setting_parameters(),
    *paper_parameters(),
)


class PllNode(BenchNode):
    """Closes the phase loop block by block; one Drive and one Frequency message answer each block.

    Args:
        values: parameter values for launch-free use; see ``PARAMETERS``.
        **kwargs: forwarded to :class:`rclpy.node.Node`.

    Raises:
        BenchError: a parameter is out of range.
    """

    def __init__(self, values: dict[str, Any] | None = None, **kwargs: Any) -> None:
        super().__init__("pll", PARAMETERS, values, **kwargs)
        self.sample_rate = float(self.values["sample_rate"])
        self.block_samples = int(self.values["block_samples"])
        self.loops = self._make_loops()
        self.loop: LevelLoop = next(iter(self.loops.values()))
        self._delay = int(self.values["latency_blocks"]) * self.block_samples
        self._response_topic = str(self.values["response_topic"])
        self._waiting: dict[str, SampleBlock] = {}
        self._next_sample: int | None = None
        self._sequence = 0
        self._gaps = self._refused = self._late_levels = self._lost_locks = 0
        self._warm_up()

        self._drive = self.bench_publisher(msg.Drive, "drive", SAMPLES_QOS)
        self._frequency = self.bench_publisher(msg.Frequency, "frequency", SAMPLES_QOS)
        self._lock = self.bench_publisher(msg.LockEvent, "lock", SAMPLES_QOS)
        self._status: LoopStatus | None = None
        self.bench_subscription(msg.Level, "level", self._on_level, SAMPLES_QOS, raw=True)
        for topic in ("force", self._response_topic):
            self.bench_subscription(msg.SampleBlock, topic, self._reading(BlockReader()), SAMPLES_QOS, raw=True)
        self.create_timer(0.25, self._guard)

    def _make_loops(self) -> dict[TestKind, LevelLoop]:
        """The loop for each kind of test; the phase is controlled only where a linear description is given."""
        v = self.values
        names = {item.name for item in fields(LoopSettings)}
        settings = settings_from({name: value for name, value in v.items() if name in names})
        loops: list[LevelLoop] = []
        drive_point = int(v["drive_point"])
        if v["linear_json"]:
            linear = LinearDescription.from_json(str(v["linear_json"]))
            drive_point = linear.drive_point
            if v["loop"] == "paper":
                loops.append(PaperLoop(linear, paper_settings_from(v), self.sample_rate, self.block_samples))
            else:
                loops.append(PhaseLockedLoop(linear, settings, self.sample_rate, self.block_samples))
        loops.append(
            RandomDrive(
                drive_point,
                self.sample_rate,
                self.block_samples,
                settings.quiet_ramp,
                float(v["settling_time"]),
                settings.latency_blocks,
            )
        )
        for given_frequency in (SweepLoop, SteppedSineLoop):
            loops.append(given_frequency(drive_point, settings, self.sample_rate, self.block_samples))
        return {kind: loop for loop in loops for kind in loop.KINDS}

    def _guard(self) -> None:
        """Quiet the drive if the node that commands the levels has gone."""
        silent = self.silent_node()
        if silent:
            self.loop.quiet(f"node {silent} has fallen silent")

    def _warm_up(self) -> None:
        """Compile the detector's kernel before the first block, not with it."""
        for loop in self.loops.values():
            if not isinstance(loop, PhaseLockedLoop | SweepLoop | SteppedSineLoop):
                continue
            loop.filter.process(loop.warm_up_data(), 0.0, 1.0)
            loop.filter.reset()

    def _choose_loop(self, level: LevelCommand) -> None:
        """Take the loop for the kind of test; only a loop at rest may be left.

        Raises:
            BenchError: no such loop here, or another one is at work.
        """
        loop = self.loops.get(level.test)
        label = level.test.label.replace("_", " ")
        if loop is None and level.test.closes_phase_loop and not self.values["linear_json"]:
            raise BenchError(
                f"A {label} test needs a linear description: the parameter 'linear_json' of the pll node is empty."
            )
        if loop is None:
            raise BenchError(f"The pll node has no {label} test with this loop.")
        if loop is self.loop:
            return
        if self.loop.machine.state in (LoopState.ACQUIRING, LoopState.LOCKED):
            raise BenchError(f"A {label} test cannot begin while the level before is at work.")
        self.loop = loop

    def _on_level(self, raw: bytes) -> None:
        try:
            level = LEVEL.read(raw)
        except (BenchError, ValueError) as error:
            self._refused += 1
            self.get_logger().error(f"Level refused: {error}")
            return
        if level.control == ControlKind.UNKNOWN:
            level = replace(level, control=ControlKind.VOLTAGE)
        try:
            self._choose_loop(level)
            self.loop.set_level(level)
        except BenchError as error:
            self._refused += 1
            self.get_logger().error(f"Level refused: {error}")
            if level.sequence <= self._sequence:
                return
            # The next level of the run: without an answer the sequencer would wait for ever.
            self.loop.reject(level, str(error).rstrip("."))
        if self._next_sample is not None and level.apply_at_sample < self._next_sample:
            self._late_levels += 1
        self._sequence = max(self._sequence, level.sequence)
        if self._status is not None:
            # The sequencer holds the horizon until it sees its level acknowledged; blocks may have to wait for that.
            self._status = self._status._replace(level_sequence=self._sequence, reason="")
            self._frequency.publish(write_status(self._status, self.sample_rate))

    def _reading(self, reader: BlockReader) -> Callable[[bytes], None]:
        def on_bytes(raw: bytes) -> None:
            try:
                block = reader.read(raw)
            except ValueError as error:
                self._refused += 1
                self.get_logger().error(f"Sample block refused: {error}", throttle_duration_sec=1.0)
                return
            self._on_block(block)

        return on_bytes

    def _on_block(self, block: SampleBlock) -> None:
        kind = "force" if block.quantity == Quantity.FORCE else "response"
        self._waiting[kind] = block
        if len(self._waiting) < 2:
            return
        force, response = self._waiting["force"], self._waiting["response"]
        if force.first_sample != response.first_sample:
            # One topic is ahead: drop the older block and wait for its successor.
            older = "force" if force.first_sample < response.first_sample else "response"
            del self._waiting[older]
            self._gaps += 1
            return
        self._waiting.clear()
        if self._next_sample is not None and force.first_sample != self._next_sample:
            self._gaps += 1
            if force.first_sample < self._next_sample:
                self._refused += 1
                return
        if force.sample_rate != self.sample_rate:
            self._refused += 1
            self.get_logger().error(
                f"Sample rate is {force.sample_rate} Hz, the parameter says {self.sample_rate} Hz.",
                throttle_duration_sec=1.0,
            )
            return
        self._next_sample = force.end_sample
        try:
            output = self.loop.process(force, response)
        except ValueError as error:
            self._refused += 1
            self.get_logger().error(f"Blocks refused: {error}", throttle_duration_sec=1.0)
            return
        self._publish(output, response.unit)

    def _publish(self, output: LoopOutput, unit: str) -> None:
        running = output.amplitude > 0.0
        drive = DriveCommand(
            apply_at_sample=output.last_sample + 1 + self._delay,
            based_on_sample=output.last_sample,
            waveform=output.waveform if running else Waveform.OFF,
            frequency_hz=output.frequency_hz,
            amplitude=output.amplitude,
            ramp=output.ramp,
            band_low_hz=output.band_low_hz,
            band_high_hz=output.band_high_hz,
            rate_hz_s=output.rate_hz_s,
            frequency_end_hz=output.frequency_end_hz,
        )
        self._drive.publish(write_drive(drive, self.sample_rate))
        if output.transition and output.transition.state == LoopState.LOCK_LOST:
            self._lost_locks += 1
        if output.lock is not None:
            self._publish_lock(output.lock)
        self._status = LoopStatus(
            last_sample=output.last_sample,
            level_index=output.level.index if output.level else 0,
            level_sequence=self._sequence,
            state=int(output.state),
            frequency_hz=output.frequency_hz if running else 0.0,
            phase_error=output.phase_error,
            force_amplitude=output.force_amplitude,
            response_amplitude=output.response_amplitude,
            response_unit=unit,
            drive_amplitude=output.amplitude,
            flags=output.flags,
            reason=output.transition.reason if output.transition else "",
        )
        self._frequency.publish(write_status(self._status, self.sample_rate))

    def _publish_lock(self, lock: LockWindow) -> None:
        control = ControlKind(lock.level.control)
        event = LockEvent(
            level_index=lock.level.index,
            level=lock.level.amplitude,
            level_unit=control.level_unit(Quantity[self._response_topic.upper()]),
            sample=lock.sample,
            frequency_hz=lock.frequency_hz,
            phase_error=lock.phase_error,
            window_first_sample=lock.first_sample,
            window_samples=lock.samples,
            window_periods=lock.periods,
            test=lock.level.test,
            time_ns=bench_time_ns(lock.sample, self.sample_rate),
        )
        self._lock.publish(LOCK_EVENT.write(event))

    def update_counters(self) -> None:
        """Counters for the heartbeat."""
        self.counters.update(
            gaps=self._gaps, refused=self._refused, late_levels=self._late_levels, lock_losses=self._lost_locks
        )


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run nmt_pll pll``."""
    return spin_node(PllNode, args)
