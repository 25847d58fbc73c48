"""The recorder: every topic of the bench, undecoded, into one bag that explains itself."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

from nmt_core.base_node import SAMPLES_QOS, STATE_QOS, BenchNode, ReaderProgress, spin_node
from nmt_core.errors import BenchError
from nmt_core.messages.bundle import PLANT_BUNDLE, PLL_BUNDLE, read_bundle
from nmt_core.messages.run_announcement import (
    ANNOUNCEMENT_TOPIC,
    BAG_TOPIC,
    BagState,
    RunAnnouncement,
)
from nmt_core.nodes.liveness import HANG_LIMIT
from nmt_msgs.msg import Bundle
from nmt_record.bag.bag_writer import BagWriter
from nmt_record.bag.bench_topics import Service, parse_topic
from nmt_record.bag.message_definitions import local_definitions
from nmt_record.bag.recorder_settings import RecorderSettings
from nmt_record.bag.run_recorder import RunRecorder, described_run, free_path, why_unwritable

_QOS = {
    Service.SAMPLES: SAMPLES_QOS,
    # Deeper than the publisher's: every state is to be recorded, not only the newest.
    Service.STATE: QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL),
    Service.DEFAULT: QoSProfile(depth=100),
}
# Neither what goes on after the run without a stamp nor a modal point that never comes keeps the bag open for ever.
LONGEST_END = 3.0
# After a run that ended early the plant takes the drive to zero by itself: its ramp belongs into the bag.
LONGEST_RAMP = 6.0  # s
_RAMP_GRACE = 30.0  # s that a recorder in lockstep which was told to end waits for a plant that is there


class RecorderNode(BenchNode):
    """Records every run into a bag of its own, until the node is asked to end.

    The first bag exists, with the run's start record in it, when the constructor returns. A bag closes when its run is
    over and the drive at zero; the next one is opened when the sequencer announces a run on ``run_plan``. What the node
    does is published, latched, on ``bag``, see :class:`nmt_core.messages.run_announcement.BagState`.

    Args:
        settings: for launch-free use; ROS overrides win over them.
        **kwargs: forwarded to :class:`rclpy.node.Node` (``context``, ``namespace``, …).

    Attributes:
        core: what it does with the messages of the newest bag.

    Raises:
        BenchError: a parameter is wrong, a message type is not installed, or the bag cannot be created.
    """

    # No node waits for this one block by block.
    BURST_PERIOD = 0.02
    settings: RecorderSettings

    def __init__(self, settings: RecorderSettings | None = None, **kwargs: Any) -> None:
        super().__init__("recorder", RecorderSettings, settings, **kwargs)
        try:
            self._set_up()
        except BaseException:
            self.destroy_node()
            raise

    @property
    def writer(self) -> BagWriter:
        """The newest bag."""
        return self.core.writer

    @property
    def state(self) -> str:
        """``open``, ``closed`` or ``failed``."""
        return self.writer.state

    def close(self, reason: str = "closed by request", exit_state: str = "interrupted") -> None:
        """Write the stop record and close the bag; does nothing if it is closed already. Never raises."""
        if self.writer.state != "open":
            return
        reason = self.core.close(exit_state, reason)
        self.get_logger().info(f"Bag {self.writer.path} closed with {self.writer.messages} messages")
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
            "recorded_s": round(self._recorded_s, 3),
            "lacks_s": round(self.core.lacks_s, 6),
        }

    def publish_diagnostics(self, level: bytes = DiagnosticStatus.OK, message: str = "") -> None:
        """Publish the counters; a gap makes a warning of it, a bag that could not be written an error."""
        self.update_counters()
        failure = self._refusal or self.writer.failure
        if failure:
            level, message = DiagnosticStatus.ERROR, failure
        elif level == DiagnosticStatus.OK and self.core.gaps.gaps:
            level = DiagnosticStatus.WARN
        super().publish_diagnostics(level, message)

    def why_not_ready(self) -> str:
        """Why no run could be recorded now; empty if one could, or is."""
        if self.writer.state == "open" and self.core.begun:
            return ""
        why = why_unwritable(Path(self.settings.output), self.settings.least_free_mb)
        return f"cannot record: {why}" if why else ""

    def may_end(self, since: float) -> bool:
        """When the drive is at zero in the bag, and all that was sent: whoever hears of it takes the drive there."""
        if self.writer.state != "open" or not self.core.begun:
            return True
        return self.core.drive_at_zero and (not self.in_lockstep or (self._is_drained and not self._plant_is_there))

    @property
    def end_grace(self) -> float:
        """In lockstep longer while there is a plant whose ramp to zero may come."""
        return _RAMP_GRACE if self.in_lockstep and self._plant_is_there else super().end_grace

    def shut_down(self) -> None:
        """Close the bag before the node is destroyed."""
        self.close("the recorder was told to end")

    def destroy_node(self) -> None:
        """Close the bag and release the node."""
        if hasattr(self, "core"):
            self.close("the recorder was told to end")
        super().destroy_node()

    def _set_up(self) -> None:
        settings = self.settings
        types = {kind: _message_class(kind) for kind in {parse_topic(text).message_type for text in settings.topics}}
        self._end_time: float | None = None
        self._last_time = self._last_own_time = time.monotonic()
        self._seen = 0.0  # time of the newest message when it was looked last
        self._is_drained = False
        self.announced = RunAnnouncement()
        self.goal = ""  # of the run that the newest bag is for
        self._refusal = ""  # why no bag was opened for it
        self.core = RunRecorder(settings)
        self._state_publisher = self.create_publisher(String, BAG_TOPIC, STATE_QOS)
        self.identity.claim(BAG_TOPIC)
        self._progress = ReaderProgress(self, "recorder")
        self._bundled = {topic: self._recording(topic) for topic in settings.bundled if topic}
        for topic in self.core.topics:
            if topic.name in self._bundled:
                continue
            self.bench_subscription(
                types[topic.message_type],
                # What stands in the global place stays there whatever the node's namespace is.
                "/diagnostics" if topic.name == "diagnostics" else topic.name,
                self._recording(topic.name),
                _QOS[topic.service],
                raw=True,
            )
        for bundle in (PLANT_BUNDLE, PLL_BUNDLE) if self._bundled else ():
            self.bench_subscription(Bundle, bundle, self._on_bundle, SAMPLES_QOS, raw=True)
        self._announcement_subscription = self.create_subscription(
            String, ANNOUNCEMENT_TOPIC, self._on_announcement, STATE_QOS
        )
        self.steady_timer(min(0.1, settings.flush_interval / 2.0), self.watch)
        self.get_logger().info(f"Bag {self.writer.path} opened")
        self._publish_state("")

    # -- one bag a run -------------------------------------------------------------------------------------------

    def _on_announcement(self, message: Any) -> None:
        try:
            self.announced = RunAnnouncement.from_json(message.data)
        except ValueError as error:
            self.get_logger().error(f"Announcement of a run refused: {error}", throttle_duration_sec=1.0)
            return
        self._open_for_announced()

    def _open_for_announced(self) -> None:
        """Have a bag open for the run that is about to begin, and say so; after a failure say why."""
        announced = self.announced
        if not announced.goal or announced.goal == self.goal:
            return
        if self.writer.state == "open" and self.core.begun:
            if self.core.end_sample is not None:
                return  # the bag of the run before closes soon
            self.close("another run was announced before the end of this one", "incomplete")
        try:
            self._open_bag(announced)
        except BenchError as error:
            self._refusal = str(error)
            self.get_logger().error(self._refusal)
        self.goal = announced.goal
        self._publish_state(self._refusal)

    def _open_bag(self, announced: RunAnnouncement) -> None:
        """Open the bag of an announced run; one that is open for it already stays.

        Raises:
            BenchError: it cannot be opened.
        """
        self._refusal = ""
        settings, output = self.settings, Path(self.settings.output)
        why = why_unwritable(output, settings.least_free_mb)
        if why:
            raise BenchError(f"The recorder cannot record: {why}.")
        if self.writer.state == "open":
            if self.core.run_id == announced.run_id:
                return
            self.writer.discard()  # it says what another run would have been
        self.core = RunRecorder(settings, path=free_path(output), run_json=described_run(settings, announced))
        self.get_logger().info(f"Bag {self.writer.path} opened for run {announced.run_id}")
        self._end_time = None

    def _recording(self, topic: str) -> Callable[[bytes], None]:
        def on_message(raw: bytes) -> None:
            if topic != "diagnostics":
                self._last_time = time.monotonic()
            try:
                self.core.callback(topic)(raw)
            except BenchError as error:
                self._failed(error)
            if topic != "diagnostics" and not self.core.after_end:
                self._last_own_time = self._last_time
                if self.in_lockstep and topic not in self._bundled:
                    self._tell_recorded()
            if self._end_time is None and self.core.end_sample is not None:
                self._end_time = time.monotonic()

        return on_message

    @property
    def _recorded_s(self) -> float:
        """Bench time up to which everything is in the bag, s."""
        return self.core.gaps.recorded / self._rate if self._rate > 0.0 else 0.0

    @property
    def _rate(self) -> float:
        return next((state.sample_rate for state in self.core.gaps.topics.values()), 0.0)

    def _tell_recorded(self) -> None:
        self._progress.tell(self.core.gaps.recorded, self._rate)

    def _on_bundle(self, raw: bytes) -> None:
        try:
            messages = read_bundle(raw)
        except ValueError:
            self.core.malformed += 1
            return
        for topic, message in messages:
            record = self._bundled.get(topic)
            if record is not None:
                record(message)
        if not self.core.after_end:
            self._tell_recorded()

    def watch(self) -> None:
        """Flush what has waited long enough, close the bag when the run is over, and open the next one."""
        self._is_drained, self._seen = self._last_time == self._seen, self._last_time
        if self.in_lockstep and self._is_drained:
            self._progress.rest(self.core.gaps.recorded)
        self._close_when_over()
        self._open_for_announced()

    def _close_when_over(self) -> None:
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
        if self.in_lockstep:
            self._close_in_lockstep(silence)
        elif self.core.gaps.reached(self.core.end_sample):
            if since_end < LONGEST_RAMP and self.core.awaits_ramp and self._plant_is_there:
                return
            # A source in real time goes on: what is stamped after the end of the run breaks no silence.
            own_silence = now - self._last_own_time
            silent = silence >= self.settings.settle_time
            silent = silent or (own_silence >= self.settings.settle_time and not self.core.awaits_points)
            if silent or since_end >= LONGEST_END:
                self.close("", "done")
        elif silence >= self.settings.patience or since_end >= self.settings.patience + LONGEST_END:
            self.close(f"blocks up to sample {self.core.end_sample} did not arrive", "incomplete")

    def _close_in_lockstep(self, silence: float) -> None:
        """Close the bag of a run that is over when all is in it that was sent, however long that takes."""
        if not self._is_drained:
            return
        core, end = self.core, self.core.end_sample or 0
        lacks = not core.gaps.reached(end)
        waits = (lacks or core.awaits_ramp) and self._plant_is_there
        # The sequencer waits for the points, and takes the announcement back when it has them.
        waits = waits or (self.announced.goal == self.goal != "" and self.count_publishers(ANNOUNCEMENT_TOPIC) > 0)
        if silence < (HANG_LIMIT if waits else self.settings.patience if lacks or core.awaits_points else 0.0):
            return
        self.close(f"blocks up to sample {end} did not arrive" if lacks else "", "incomplete" if lacks else "done")

    @property
    def _plant_is_there(self) -> bool:
        """Whether anybody is left who could send the ramp to zero."""
        return bool(self.count_publishers(PLANT_BUNDLE if "voltage" in self._bundled else "voltage") > 0)

    def _failed(self, error: BenchError) -> None:
        self.get_logger().error(str(error))
        self._publish_state(str(error))
        self.publish_diagnostics()

    def _publish_state(self, reason: str) -> None:
        if not self.context.ok():
            return
        state = "failed" if self._refusal else self.writer.state
        lacks = 0.0 if state == "open" else self.core.lacks_s
        told = BagState(str(self.writer.path), state, self.writer.messages, reason, self.goal, self._recorded_s, lacks)
        text = told.to_json()
        self._state_publisher.publish(String(data=text))


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
