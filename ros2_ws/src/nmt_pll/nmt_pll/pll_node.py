"""The PLL node: force and response blocks in, drive commands, loop state and lock events out."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from nmt_core.base_node import SAMPLES_QOS, BenchNode, spin_node
from nmt_core.errors import BenchError
from nmt_core.messages.bundle import LOOP_INPUT, PLL_BUNDLE, BundleWriter, read_bundle
from nmt_core.messages.command_judge import CommandSource
from nmt_core.messages.records import LoopStatus
from nmt_core.messages.wire import LEVEL, LOCK_EVENT, BlockReader, NodeStatus, write_drive, write_status
from nmt_msgs import msg
from nmt_pll.loop_core import LoopCore
from nmt_pll.pll_settings import PllSettings

_BUNDLE_WAIT_S = 0.05  # that a message waits for its bundle
_END_WAIT_S = 2.0  # that the loop waits for the ramp to zero when it is asked to end


class PllNode(BenchNode):
    """Closes the phase loop block by block; one Drive and one Frequency message answer each block.

    Args:
        settings: for launch-free use; ROS overrides win over them.
        **kwargs: forwarded to :class:`rclpy.node.Node`.

    Raises:
        BenchError: a parameter is out of range.
    """

    NEEDED = ("sample_rate", "block_samples", "watched_nodes")
    settings: PllSettings

    def __init__(self, settings: PllSettings | None = None, **kwargs: Any) -> None:
        super().__init__("pll", PllSettings, settings, **kwargs)
        self.core = LoopCore(self.settings, self._complain)
        self._drive = self.bench_publisher(msg.Drive, "drive", SAMPLES_QOS)
        self._frequency = self.bench_publisher(msg.Frequency, "frequency", SAMPLES_QOS)
        self._lock = self.bench_publisher(msg.LockEvent, "lock", SAMPLES_QOS)
        self._bundle: BundleWriter | None = None
        blocks = self.settings.bundle_blocks
        if blocks > 0:
            bundles = self.bench_publisher(msg.Bundle, PLL_BUNDLE, SAMPLES_QOS)
            self._bundle = BundleWriter(("drive", "frequency"), blocks, bundles.publish)
            self.steady_timer(_BUNDLE_WAIT_S, self._bundle.flush)
        self.command_subscription(msg.Level, "level", self._on_level, SAMPLES_QOS)
        self._inputs = {topic: self._reading(BlockReader()) for topic in ("force", self.core.response.topic)}
        if self.settings.joined_input:
            self.bench_subscription(msg.Bundle, LOOP_INPUT, self._on_input, SAMPLES_QOS, raw=True)
        else:
            for topic, take in self._inputs.items():
                self.bench_subscription(msg.SampleBlock, topic, take, SAMPLES_QOS, raw=True)
        self._reported = ""
        self._plant_instance = ""
        self.steady_timer(0.25, self._guard)

    def hear(self, status: NodeStatus) -> None:
        """Take a heartbeat; another plant counts its samples anew."""
        super().hear(status)
        own = self.heartbeat_name.rpartition("/")[0]
        if status.name.rpartition("/")[0] != own or "drive_at_zero" not in status.values:
            return
        if self._plant_instance and status.hardware_id != self._plant_instance and not self.core.at_work:
            self.core.forget_samples()
        self._plant_instance = status.hardware_id

    def _complain(self, sentence: str, often: bool) -> None:
        if often:
            self.get_logger().error(sentence, throttle_duration_sec=1.0)
        else:
            self.get_logger().error(sentence)

    def _guard(self) -> None:
        """Quiet the drive if the node that commands the levels has gone, or if another one commands them, too."""
        lost = self.liveness.first_lost(time.monotonic())
        if lost:
            self.core.loop.quiet(lost)
        self._report(self.second_publisher() or (self.core.second_source if self.core.at_work else ""))

    def _report(self, second: str) -> None:
        """Warn of a second publisher once and take the drive to zero; the heartbeat goes on saying so."""
        if second and not self._reported and self.core.at_work:
            self.get_logger().warning(f"Drive goes to zero: {second}.")
            self.core.loop.quiet(second)
            self._reported = second
            self.publish_diagnostics()
        elif not second:
            self._reported = ""
            if not self.core.at_work:
                self.core.judge.release()  # another sequencer may begin the next run

    def may_end(self, since: float) -> bool:
        """When no level is at work any more, since the sequencer takes the drive to zero through this node."""
        return not self.core.at_work or since > _END_WAIT_S

    def publish_diagnostics(self, level: bytes = DiagnosticStatus.OK, message: str = "") -> None:
        """Publish the counters; a second publisher of levels makes an error of it."""
        if self._reported:
            level, message = DiagnosticStatus.ERROR, self._reported
        super().publish_diagnostics(level, message)

    def _on_level(self, raw: bytes, source: CommandSource) -> None:
        try:
            level = LEVEL.read(raw)
        except (BenchError, ValueError) as error:
            self.core.refuse(f"Level refused: {error}", often=False)
            return
        if not self.core.at_work:
            self.liveness.meet_again(time.monotonic())
        self._publish_statuses(self.core.take_level(level, source))
        if self.core.second_source:
            self._report(self.core.second_source)

    def _on_input(self, raw: bytes) -> None:
        try:
            messages = read_bundle(raw)
        except ValueError as error:
            self.core.refuse(f"Sample block refused: {error}")
            return
        for topic, message in messages:
            take = self._inputs.get(topic)
            if take is not None:
                take(message)

    def _reading(self, reader: BlockReader) -> Callable[[bytes], None]:
        def on_bytes(raw: bytes) -> None:
            try:
                block = reader.read(raw)
            except ValueError as error:
                self.core.refuse(f"Sample block refused: {error}")
                return
            answer = self.core.take_block(block)
            if answer is None:
                return
            drive = write_drive(answer.drive, self.core.sample_rate)
            self._drive.publish(drive)
            if self._bundle is not None:
                self._bundle.add("drive", drive)
            if answer.lock is not None:
                self._lock.publish(LOCK_EVENT.write(answer.lock))
            self._publish_statuses(answer.statuses)
            if self._bundle is not None:
                self._bundle.end_block(last=not self.core.at_work)

        return on_bytes

    def _publish_statuses(self, statuses: Iterable[LoopStatus]) -> None:
        for status in statuses:
            raw = write_status(status, self.core.sample_rate)
            self._frequency.publish(raw)
            if self._bundle is not None:
                self._bundle.add("frequency", raw)

    def shut_down(self) -> None:
        """Publish what waits for its bundle."""
        if self._bundle is not None:
            self._bundle.flush()

    @property
    def is_at_work(self) -> bool:
        """Whether a run is under way."""
        return bool(self.core.at_work)

    def update_counters(self) -> None:
        """Counters for the heartbeat."""
        rate, block = self.settings.sample_rate, self.settings.block_samples
        self.counters.update(sample_rate=rate, block_samples=block, **self.core.counters)


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run nmt_pll pll``."""
    return spin_node(PllNode, args)
