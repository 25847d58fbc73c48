"""The recorder: every topic of the bench, undecoded, into one bag that explains itself."""

from __future__ import annotations

import importlib
import json
import time
from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

from nmt_core.base_node import SAMPLES_QOS, STATE_QOS, BenchNode, spin_node
from nmt_core.errors import BenchError
from nmt_record.bench_topics import Service, parse_topic
from nmt_record.message_definitions import local_definitions
from nmt_record.run_recorder import PARAMETERS, RunRecorder

_QOS = {
    Service.SAMPLES: SAMPLES_QOS,
    # Deeper than the publisher's: every state is to be recorded, not only the newest.
    Service.STATE: QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL),
    Service.DEFAULT: QoSProfile(depth=100),
}
# A source in real time goes on after the run; its blocks do not keep the bag open for ever.
_LONGEST_END = 3.0
# After a run that ended early the plant takes the drive to zero by itself: its ramp belongs into the bag.
_LONGEST_RAMP = 6.0  # s


class RecorderNode(BenchNode):
    """Records until the run is done, the node is told to end, or the disk is full.

    The bag exists, with the run's start record in it, when the constructor returns. Its state is published,
    latched, on ``bag`` as JSON: ``{"path", "state": "open" | "closed" | "failed", "messages", "reason"}``.

    Args:
        values: parameters by name, see ``PARAMETERS``.
        **kwargs: forwarded to :class:`rclpy.node.Node` (``context``, ``namespace``, …).

    Attributes:
        writer: the bag being written.
        core: what it does with messages.

    Raises:
        BenchError: a parameter is wrong, a message type is not installed, or the bag cannot be created.
    """

    # Nobody waits for this node block by block.
    BURST_PERIOD = 0.02

    def __init__(self, values: dict[str, Any] | None = None, **kwargs: Any) -> None:
        super().__init__("recorder", PARAMETERS, values, **kwargs)
        try:
            self._set_up()
        except BaseException:
            self.destroy_node()
            raise

    @property
    def state(self) -> str:
        """``open``, ``closed`` or ``failed``."""
        return self.writer.state

    def close(self, reason: str = "closed by request", exit_state: str = "interrupted") -> None:
        """Write the stop record and close the bag; does nothing if it is closed already. Never raises."""
        if self.writer.state != "open":
            return
        reason = self.core.close(exit_state, reason)
        self._publish_state(reason)

    def update_counters(self) -> None:
        """Messages written, gaps and their samples, malformed messages and those after the end of the bag."""
        self.counters = {
            "state": self.writer.state,
            "messages": self.writer.messages,
            "gaps": self.core.gaps.gaps,
            "missing_samples": self.core.gaps.missing_samples,
            "malformed_messages": self.core.malformed,
            "late_messages": self.core.late,
        }

    def publish_diagnostics(self, level: bytes = DiagnosticStatus.OK, message: str = "") -> None:
        """Publish the counters; a gap makes a warning of it, a bag that could not be written an error."""
        self.update_counters()
        if self.writer.failure:
            level, message = DiagnosticStatus.ERROR, self.writer.failure
        elif self.core.gaps.gaps:
            level = DiagnosticStatus.WARN
        super().publish_diagnostics(level, message)

    def shut_down(self) -> None:
        """Close the bag before the node is destroyed."""
        self.close("the recorder was told to end")

    def destroy_node(self) -> None:
        """Close the bag and release the node."""
        if hasattr(self, "writer"):
            self.close("the recorder was told to end")
        super().destroy_node()

    def _set_up(self) -> None:
        values: dict[str, Any] = dict(self.values)
        types = {kind: _message_class(kind) for kind in {parse_topic(text).message_type for text in values["topics"]}}
        self._settle_time: float = values["settle_time"]
        self._patience: float = values["patience"]
        self._end_time: float | None = None
        self._last_time = time.monotonic()
        self.core = RunRecorder(values)
        self.writer = self.core.writer
        self._state_publisher = self.create_publisher(String, "bag", STATE_QOS)
        for topic in self.core.topics:
            self.bench_subscription(
                types[topic.message_type],
                # What stands in the global place stays there whatever the node's namespace is.
                "/diagnostics" if topic.name == "diagnostics" else topic.name,
                self._recording(topic.name),
                _QOS[topic.service],
                raw=True,
            )
        self.steady_timer(min(0.1, values["flush_interval"] / 2.0), self._watch)
        self._publish_state("")

    def _recording(self, topic: str) -> Callable[[bytes], None]:
        record = self.core.callback(topic)

        def on_message(raw: bytes) -> None:
            if topic != "diagnostics":
                self._last_time = time.monotonic()
            try:
                record(raw)
            except BenchError as error:
                self._failed(error)
            if self._end_time is None and self.core.end_sample is not None:
                self._end_time = time.monotonic()

        return on_message

    def _watch(self) -> None:
        """Flush what has waited long enough, and close the bag when the run is over."""
        if self.writer.state != "open":
            return
        try:
            self.writer.flush_if_due()
        except BenchError as error:
            self._failed(error)
            return
        if self.core.end_sample is None or self._end_time is None:
            return
        now = time.monotonic()
        silence, since_end = now - self._last_time, now - self._end_time
        if self.core.gaps.reached(self.core.end_sample):
            if since_end < _LONGEST_RAMP and self.core.awaits_ramp:
                return
            if silence >= self._settle_time or since_end >= _LONGEST_END:
                self.close("", "done")
        elif silence >= self._patience or since_end >= self._patience + _LONGEST_END:
            self.close(f"blocks up to sample {self.core.end_sample} did not arrive", "incomplete")

    def _failed(self, error: BenchError) -> None:
        self.get_logger().error(str(error))
        self._publish_state(str(error))
        self.publish_diagnostics()

    def _publish_state(self, reason: str) -> None:
        if not self.context.ok():
            return
        state = {
            "path": str(self.writer.path),
            "state": self.writer.state,
            "messages": self.writer.messages,
            "reason": reason,
        }
        self._state_publisher.publish(String(data=json.dumps(state)))


def _message_class(message_type: str) -> Any:
    """Import a message type and check that its definition on disk is the one it was built from.

    Raises:
        BenchError: not installed, or built from another definition.
    """
    package, _, name = message_type.partition("/msg/")
    try:
        kind = getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise BenchError(
            f"Message type {message_type} is not installed; source the workspace that contains it."
        ) from error
    if tuple(kind.get_fields_and_field_types()) != local_definitions().fields(message_type):
        raise BenchError(
            f"Message type {message_type} was built from another definition than the one on disk; "
            "build the workspace again."
        )
    return kind


def main(args: list[str] | None = None) -> int:
    """Run the recorder as an executable."""
    return spin_node(RecorderNode, args)
