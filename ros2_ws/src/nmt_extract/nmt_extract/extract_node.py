"""The extraction node: blocks, loop states and lock events in, modal points out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nmt_core.base_node import SAMPLES_QOS, BenchNode, ReaderProgress, spin_node
from nmt_core.messages.bundle import PLANT_BUNDLE, PLL_BUNDLE, read_bundle
from nmt_core.messages.wire import MODAL_POINT
from nmt_extract.extraction_core import ExtractionCore
from nmt_extract.extraction_settings import ExtractSettings
from nmt_msgs.msg import Bundle, Frequency, Level, LockEvent, ModalPoint, SampleBlock

_REST = 0.1  # s between two looks whether something has been taken and not told
_STATE_TYPES = {"frequency": Frequency, "lock": LockEvent, "level": Level}


class ExtractNode(BenchNode):
    """Publishes one ``modal_point`` for each lock event and for each level that does not lock.

    Without a linear description, as in tests that come before there is one, it listens and publishes nothing.

    Args:
        settings: for launch-free use; ROS overrides win over them.
        **kwargs: forwarded to :class:`rclpy.node.Node`.

    Raises:
        BenchError: a parameter is out of range.
    """

    # No node waits for this one block by block.
    BURST_PERIOD = 0.02
    NEEDED = ("linear_json",)
    settings: ExtractSettings

    def __init__(self, settings: ExtractSettings | None = None, **kwargs: Any) -> None:
        super().__init__("extract", ExtractSettings, settings, **kwargs)
        self.core = ExtractionCore(self.settings)
        self.publisher = self.bench_publisher(ModalPoint, "modal_point", SAMPLES_QOS)
        self._progress = ReaderProgress(self, "extract")
        bundled = self.settings.bundled
        self._bundled = {topic: self.core.callback(topic) for topic in self.core.topics if topic in bundled}
        for bundle in (PLANT_BUNDLE, PLL_BUNDLE) if self._bundled else ():
            self.bench_subscription(Bundle, bundle, self._on_bundle, SAMPLES_QOS, raw=True)
        for topic in self.core.topics:
            if topic in self._bundled:
                continue
            kind = _STATE_TYPES.get(topic, SampleBlock)
            self.bench_subscription(kind, topic, self._publishing(self.core.callback(topic)), SAMPLES_QOS, raw=True)

        if self.in_lockstep:
            self.steady_timer(_REST, lambda: self._progress.rest(self.core.taken[0]))

    def _publishing(self, callback: Callable[[bytes], None]) -> Callable[[bytes], None]:
        def on_message(raw: bytes) -> None:
            callback(raw)
            self._publish_points()
            self._progress.tell(*self.core.taken)

        return on_message

    def _on_bundle(self, raw: bytes) -> None:
        try:
            messages = read_bundle(raw)
        except ValueError as error:
            self.get_logger().error(f"Bundle refused: {error}", throttle_duration_sec=1.0)
            return
        for topic, message in messages:
            take = self._bundled.get(topic)
            if take is not None:
                take(message)
                self._publish_points()
        self._progress.tell(*self.core.taken)

    def _publish_points(self) -> None:
        for point in self.core.points():
            self.publisher.publish(MODAL_POINT.write(point))
            if point.reason:
                self.get_logger().warning(f"Level {point.level_index}: {point.reason}")

    def update_counters(self) -> None:
        """Counters for the heartbeat."""
        self.counters.update(self.core.counters)


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run nmt_extract extract``."""
    return spin_node(ExtractNode, args)
