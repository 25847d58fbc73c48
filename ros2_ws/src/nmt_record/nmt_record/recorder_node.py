"""The recorder: every topic of the bench, undecoded, into one bag that explains itself."""

from __future__ import annotations

import importlib
import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

from nmt_core.base_node import SAMPLES_QOS, STATE_QOS, BenchNode, spin_node
from nmt_core.errors import BenchError
from nmt_core.hardened import read_text
from nmt_core.parameters import Parameter
from nmt_msgs.msg import RunState
from nmt_record.bag_writer import COMPRESSIONS, BagWriter
from nmt_record.bench_topics import BENCH_TOPICS, SAMPLE_BLOCK, BenchTopic, Service, parse_topic
from nmt_record.cdr_peek import BlockExtent, BlockPeek, peek_run_state, peek_stamp
from nmt_record.gap_counter import GapCounter
from nmt_record.message_definitions import local_definitions

PARAMETERS: tuple[Parameter, ...] = (
    Parameter("output", "", "", "Folder of the bag to create; must not exist."),
    Parameter(
        "topics",
        [topic.name for topic in BENCH_TOPICS],
        "",
        "Topics to record; those that are not of the bench as 'name:package/msg/Type'.",
    ),
    Parameter("run_json", "", "", "Self-description of the run, a JSON object."),
    Parameter("run_file", "", "", "File with the same, instead of run_json."),
    Parameter("rig_yaml", "", "", "The rig file as used, its text."),
    Parameter("rig_file", "", "", "File with the same, instead of rig_yaml."),
    Parameter("chunk_messages", 500, "", "Messages after which a chunk is written.", low=1),
    Parameter("flush_interval", 0.5, "s", "Wall time after which a chunk is written.", low=0.01),
    Parameter("compression", "none", "", "Compression of the chunks.", choices=tuple(COMPRESSIONS)),
    Parameter("split_bytes", 0, "byte", "Size after which the bag goes on in another file; 0 = one file.", low=0),
    Parameter("split_duration", 0.0, "s", "Wall time after which it does so; 0 = one file.", low=0.0),
    Parameter("settle_time", 0.25, "s", "Silence before the bag of a done run closes.", low=0.0),
    Parameter("patience", 2.0, "s", "Silence after which missing blocks are given up.", low=0.1),
)

_QOS = {
    Service.SAMPLES: SAMPLES_QOS,
    # Deeper than the publisher's: every state is to be recorded, not only the newest.
    Service.STATE: QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL),
    Service.DEFAULT: QoSProfile(depth=100),
}
# A source in real time goes on after the run; its blocks do not keep the bag open for ever.
_LONGEST_END = 3.0


class RecorderNode(BenchNode):
    """Records until the run is done, the node is told to end, or the disk is full.

    The bag exists, with the run's start record in it, when the constructor returns. Its state is published,
    latched, on ``bag`` as JSON: ``{"path", "state": "open" | "closed" | "failed", "messages", "reason"}``.

    Args:
        values: parameters by name, see ``PARAMETERS``.
        **kwargs: forwarded to :class:`rclpy.node.Node` (``context``, ``namespace``, …).

    Attributes:
        writer: the bag being written.
        gaps: continuity of the sample topics.

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
        try:
            self.writer.close(
                exit_state,
                reason,
                round(self.gaps.bench_time() * 1e9),
                gaps=self.gaps.as_dict(),
                malformed_messages=self._malformed,
            )
        except BenchError as error:
            reason = str(error)
        self._publish_state(reason)

    def update_counters(self) -> None:
        """Messages written, gaps and their samples, malformed messages and those after the end of the bag."""
        self.counters = {
            "state": self.writer.state,
            "messages": self.writer.messages,
            "gaps": self.gaps.gaps,
            "missing_samples": self.gaps.missing_samples,
            "malformed_messages": self._malformed,
            "late_messages": self._late,
        }

    def publish_diagnostics(self, level: bytes = DiagnosticStatus.OK, message: str = "") -> None:
        """Publish the counters; a gap makes a warning of it, a bag that could not be written an error."""
        self.update_counters()
        if self.writer.failure:
            level, message = DiagnosticStatus.ERROR, self.writer.failure
        elif self.gaps.gaps:
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
        if not values["output"]:
            raise BenchError("Parameter 'output' of recorder must name the folder of the bag to create.")
        topics = [parse_topic(text) for text in values["topics"]]
        types = {topic.message_type: _message_class(topic.message_type) for topic in topics}
        self.gaps = GapCounter()
        self._settle_time: float = values["settle_time"]
        self._patience: float = values["patience"]
        self._malformed = 0
        self._late = 0
        self._seen_running = False
        self._end_sample: int | None = None
        self._end_time = 0.0
        self._last_time = time.monotonic()
        run_json = _text(values, "run_json", "run_file")
        self.writer = BagWriter(
            str(values["output"]),
            run_json=run_json,
            rig_yaml=_text(values, "rig_yaml", "rig_file"),
            chunk_messages=values["chunk_messages"],
            flush_interval=values["flush_interval"],
            compression=str(values["compression"]),
            split_bytes=values["split_bytes"],
            split_duration=values["split_duration"],
        )
        self._run_id = str(json.loads(run_json).get("run_id", "")) if run_json else ""
        self._state_publisher = self.create_publisher(String, "bag", STATE_QOS)
        for topic in topics:
            self.writer.add_topic(topic.name, topic.message_type, topic.service)
            self.bench_subscription(
                types[topic.message_type],
                # What stands in the global place stays there whatever the node's namespace is.
                "/diagnostics" if topic.name == "diagnostics" else topic.name,
                self._callback(topic),
                _QOS[topic.service],
                raw=True,
            )
        self.create_timer(min(0.1, values["flush_interval"] / 2.0), self._watch)
        self._publish_state("")

    def _callback(self, topic: BenchTopic) -> Any:
        if topic.message_type == SAMPLE_BLOCK:
            return partial(self._on_block, topic.name, BlockPeek().extent)
        if topic.name == "run_state":
            return self._on_run_state
        stamped = local_definitions().fields(topic.message_type)[:1] in (("stamp",), ("header",))
        return partial(self._on_message, topic.name, stamped)

    def _on_block(self, topic: str, extent: Callable[[bytes], BlockExtent], raw: bytes) -> None:
        try:
            self.gaps.add(topic, extent(raw))
        except ValueError:
            self._malformed += 1
        self._on_message(topic, True, raw)

    def _on_run_state(self, raw: bytes) -> None:
        self._on_message("run_state", True, raw)
        try:
            run_id, phase, sample = peek_run_state(raw)
        except ValueError:
            self._malformed += 1
            return
        if phase != RunState.DONE:
            self._seen_running = True
        elif self._seen_running or (run_id and run_id == self._run_id):
            # Otherwise it is the latched end of an earlier run.
            if self._end_sample is None:
                self._end_time = time.monotonic()
            self._end_sample = sample

    def _on_message(self, topic: str, stamped: bool, raw: bytes) -> None:
        if self.writer.state != "open":
            self._late += 1
            return
        stamp = None
        if stamped:
            try:
                stamp = max(peek_stamp(raw), 0)
            except ValueError:
                self._malformed += 1
        if topic != "diagnostics":
            self._last_time = time.monotonic()
        try:
            self.writer.write(topic, raw, None, stamp)
        except BenchError as error:
            self._failed(error)

    def _watch(self) -> None:
        """Flush what has waited long enough, and close the bag when the run is over."""
        if self.writer.state != "open":
            return
        try:
            self.writer.flush_if_due()
        except BenchError as error:
            self._failed(error)
            return
        if self._end_sample is None:
            return
        now = time.monotonic()
        silence, since_end = now - self._last_time, now - self._end_time
        if self.gaps.reached(self._end_sample):
            if silence >= self._settle_time or since_end >= _LONGEST_END:
                self.close("", "done")
        elif silence >= self._patience or since_end >= self._patience + _LONGEST_END:
            self.close(f"blocks up to sample {self._end_sample} did not arrive", "incomplete")

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


def _text(values: dict[str, Any], text: str, file: str) -> str:
    if values[text] and values[file]:
        raise BenchError(f"Parameters '{text}' and '{file}' of recorder exclude each other; give one.")
    if not values[file]:
        return str(values[text])
    return read_text(Path(values[file]), f"file of parameter '{file}' of recorder,")


def main(args: list[str] | None = None) -> int:
    """Run the recorder as an executable."""
    return spin_node(RecorderNode, args)
