"""The bridge: topics of nodes that are none of the bench's, published as its own blocks of samples."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy

from nmt_core.base_node import SAMPLES_QOS, BenchNode, spin_node
from nmt_core.errors import BenchError
from nmt_core.messages.named_elements import what_a_type_lacks
from nmt_core.messages.wire import BlockReader, BlockWriter
from nmt_msgs.msg import SampleBlock
from nmt_plant.topic_bridge import TopicBridge, TopicBridgeSettings
from nmt_plant.topic_bridge_table import BridgeTable, read_channel_table

# Sensors are often published so; a reliable publisher is taken as well.
_FOREIGN_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
_PERIOD = 0.02  # s between two looks for complete blocks


class TopicBridgeNode(BenchNode):
    """Takes the topics of a channel table and publishes blocks on ``force``, ``acceleration`` and so on.

    Args:
        settings: for launch-free use; ROS overrides win over them.
        **kwargs: forwarded to :class:`rclpy.node.Node`.

    Raises:
        BenchError: the channel table is wrong, a message type is not installed, or it has no such field.
    """

    BURST_PERIOD = 0.02
    NEEDED = ("table",)

    settings: TopicBridgeSettings

    def __init__(self, settings: TopicBridgeSettings | None = None, **kwargs: Any) -> None:
        super().__init__("topic_bridge", TopicBridgeSettings, settings, **kwargs)
        try:
            self._set_up()
        except BaseException:
            self.destroy_node()
            raise

    def _set_up(self) -> None:
        table = read_channel_table(Path(self.settings.table))
        _check_fields(table)
        reference = self.settings.reference
        self.bridge = TopicBridge(table, self.settings.patience, bool(reference))
        quantities = dict.fromkeys(channel.quantity for channel in table.channels)
        if reference in (quantity.topic for quantity in quantities):
            raise BenchError(
                f"The reference '{reference}' is a topic that the bridge itself publishes; name another one."
            )
        self._writers = {quantity: BlockWriter(self.settings.rig) for quantity in quantities}
        self.outlets = {
            quantity: self.bench_publisher(SampleBlock, quantity.topic, SAMPLES_QOS) for quantity in quantities
        }
        for topic, kind in table.topics.items():
            self.create_subscription(_message_type(kind), topic, self._taker(topic), _FOREIGN_QOS)
        if reference:
            self._reader = BlockReader()
            self.bench_subscription(SampleBlock, reference, self._on_reference, SAMPLES_QOS, raw=True)
        self.steady_timer(_PERIOD, self._publish)

    def _taker(self, topic: str) -> Any:
        def take(message: Any) -> None:
            self.received += 1
            self.bridge.add(topic, message, self.get_clock().now().nanoseconds)

        return take

    def _on_reference(self, raw: bytes) -> None:
        try:
            head = self._reader.head(raw)
        except ValueError as error:
            self.get_logger().error(f"Block of the reference refused: {error}", throttle_duration_sec=1.0)
            return
        self.bridge.add_reference(head.end_sample, head.sample_rate, self.get_clock().now().nanoseconds)

    def _publish(self) -> None:
        for block in self.bridge.take():
            self.outlets[block.quantity].publish(self._writers[block.quantity].write(block))
            self.counters["blocks"] = int(self.counters.get("blocks", 0)) + 1
        for sentence in self.bridge.watch.findings(self.get_clock().now().nanoseconds):
            self.get_logger().warning(sentence)
            self.counters["finding"] = sentence

    def update_counters(self) -> None:
        """Messages taken, those out of order, and samples that are missing."""
        self.counters.update(
            messages=self.received, late_messages=self.bridge.late, missing_samples=self.bridge.missing
        )


def _check_fields(table: BridgeTable) -> None:
    """Refuse a channel whose message type has no such number.

    Raises:
        BenchError: there is one, or a type is not installed.
    """
    for channel in table.channels:
        lack = what_a_type_lacks(channel.field, channel.kind, _fields_of)
        if lack:
            raise BenchError(f"Channel {channel.name} of {channel.topic}: {lack}; correct field {channel.field}.")


def _fields_of(kind: str) -> dict[str, str]:
    return dict(_message_type(kind).get_fields_and_field_types())


def _message_type(kind: str) -> Any:
    package, _, name = kind.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise BenchError(
            f"The message type {kind} is not installed here; build its package and source it before the bench's."
        ) from error


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run nmt_plant topic_bridge``."""
    return spin_node(TopicBridgeNode, args)
