"""The extraction node: blocks, loop states and lock events in, modal points out."""

from __future__ import annotations

import json
from typing import Any

from nmt_core.base_node import SAMPLES_QOS, BenchNode, spin_node
from nmt_core.errors import BenchError
from nmt_core.linear_description import LinearDescription
from nmt_core.parameters import Parameter
from nmt_core.wire import MODAL_POINT
from nmt_extract.extractor import Extractor
from nmt_extract.harmonics import compile_kernels
from nmt_extract.message_feed import STATE_TOPICS, MessageFeed
from nmt_extract.settings import ExtractionSettings
from nmt_msgs.msg import Frequency, Level, LockEvent, ModalPoint, SampleBlock

_STATE_TYPES = {"frequency": Frequency, "lock": LockEvent, "level": Level}

PARAMETERS = (
    Parameter(
        "linear_json",
        "",
        "",
        "Linear description of the rig as JSON, see the reference of linear.json; empty = nothing is extracted.",
    ),
    Parameter("harmonics", 10, "", "Number of harmonics H; 0..H are extracted.", low=1, high=200),
    Parameter(
        "topics",
        ["force", "acceleration"],
        "",
        "Sample topics a window needs: force and the rig's response topics.",
    ),
    Parameter("sub_windows", 10, "", "Sub-windows for the standard uncertainties.", low=3, high=1000),
    Parameter("minimum_periods", 3, "periods", "Windows of fewer whole periods are rejected.", low=3),
    Parameter("power_balance", False, "", "Balance of power for windows whose level still changes."),
    Parameter(
        "hysteresis_json",
        "",
        "",
        "Masses and points of a three-mass chain with a joint as JSON; empty = none.",
    ),
    Parameter("rig", "", "", "Name of the rig, for the log."),
)


class ExtractNode(BenchNode):
    """Publishes one ``modal_point`` for each lock event and for each level that does not lock.

    Without a linear description, as in tests that come before there is one, it listens and publishes nothing.

    Args:
        values: parameter values for launch-free use; see ``PARAMETERS``.
        **kwargs: forwarded to :class:`rclpy.node.Node`.

    Raises:
        BenchError: a parameter is out of range.
    """

    # Nobody waits for this node block by block.
    BURST_PERIOD = 0.02

    def __init__(self, values: dict[str, Any] | None = None, **kwargs: Any) -> None:
        super().__init__("extract", PARAMETERS, values, **kwargs)
        text = str(self.values["linear_json"])
        settings = self._settings()
        self.extractor: Extractor | None = None
        self._feed: MessageFeed | None = None
        self._publisher = self.bench_publisher(ModalPoint, "modal_point", SAMPLES_QOS)
        if not text:
            for topic in (*settings.topics, *STATE_TOPICS):
                self.bench_subscription(
                    _STATE_TYPES.get(topic, SampleBlock), topic, lambda _: None, SAMPLES_QOS, raw=True
                )
            return
        self.extractor = Extractor(LinearDescription.from_json(text), settings)
        compile_kernels()
        self._feed = MessageFeed(self.extractor)
        for topic, callback in self._feed.callbacks.items():
            kind = _STATE_TYPES.get(topic, SampleBlock)
            self.bench_subscription(kind, topic, self._publishing(callback, self.extractor), SAMPLES_QOS, raw=True)

    def _settings(self) -> ExtractionSettings:
        names = ("harmonics", "topics", "sub_windows", "minimum_periods", "power_balance")
        values: dict[str, Any] = {name: self.values[name] for name in names}
        text = str(self.values["hysteresis_json"])
        if text:
            try:
                values["hysteresis"] = json.loads(text)
            except json.JSONDecodeError as error:
                raise BenchError(f"Parameter 'hysteresis_json' of {self.get_name()} is not JSON: {error}.") from error
            if not isinstance(values["hysteresis"], dict):
                raise BenchError(f"Parameter 'hysteresis_json' of {self.get_name()} must be a JSON object.")
        return ExtractionSettings.from_mapping(values)

    def _publishing(self, callback: Any, extractor: Extractor) -> Any:
        def on_message(raw: bytes) -> None:
            callback(raw)
            if extractor.ready:
                self._publish(extractor)

        return on_message

    def _publish(self, extractor: Extractor) -> None:
        for point in extractor.take():
            self._publisher.publish(MODAL_POINT.write(point))
            if point.reason:
                self.get_logger().warning(f"Level {point.level_index}: {point.reason}")

    def update_counters(self) -> None:
        """Counters for the heartbeat."""
        if self.extractor is not None and self._feed is not None:
            self.counters.update(self.extractor.counters, malformed=self._feed.malformed)


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run nmt_extract extract``."""
    return spin_node(ExtractNode, args)
