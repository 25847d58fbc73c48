"""Sends an emergency stop to the bench on one ROS domain and waits for what its plant says."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator

import rclpy
from rclpy.context import Context
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Bool

from nmt_bench.orchestration.bench_domain import bench_environment
from nmt_core.base_node import STATE_QOS
from nmt_core.messages.records import DriveStop
from nmt_core.messages.wire import DRIVE_STOP
from nmt_core.vocabulary import OutputState, StopCause
from nmt_msgs import msg

_REST = (OutputState.HELD, OutputState.ENDED)
_AGAIN = 0.1  # s between two messages


class StopNode(Node):  # type: ignore[misc]
    """Says stop until it is destroyed, and keeps what the plant answers.

    Args:
        context: context of rclpy.
        namespace: of the bench.

    Attributes:
        plants: how many plants listen.
        answer: the newest stop that a plant has told; None = none.
    """

    def __init__(self, context: Context, namespace: str = "") -> None:
        super().__init__(
            "nmt_stop", context=context, namespace=namespace, enable_rosout=False, start_parameter_services=False
        )
        self.answer: DriveStop | None = None
        self._publisher = self.create_publisher(
            Bool, "emergency_stop", STATE_QOS, event_callbacks=PublisherEventCallbacks(use_default_callbacks=False)
        )
        self.create_subscription(msg.DriveStop, "drive_stop", self._on_stop, STATE_QOS, raw=True)
        self.say()

    def say(self) -> None:
        """Publish the stop."""
        self._publisher.publish(Bool(data=True))

    def _on_stop(self, raw: bytes) -> None:
        stop = DRIVE_STOP.read(raw)
        if stop.cause is not StopCause.RELEASED:
            self.answer = stop


@contextlib.contextmanager
def visitor_of(domain: int) -> Iterator[Context]:
    """A context for a node next to those of the bench of a domain, and the bench's environment while it lasts."""
    before = dict(os.environ)
    os.environ.update(bench_environment(domain))
    context = Context()
    try:
        rclpy.init(args=[], context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
        yield context
    finally:
        rclpy.try_shutdown(context=context)
        os.environ.clear()
        os.environ.update(before)


def send_stop(domain: int, namespace: str = "", timeout: float = 5.0) -> DriveStop | None:
    """Stop the bench of a domain.

    Args:
        domain: ROS domain.
        namespace: of the bench.
        timeout: s to wait until the drive is at zero.

    Returns:
        What its plant said last; None where no plant answered.
    """
    with visitor_of(domain) as context:
        node = StopNode(context, namespace)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        end = time.monotonic() + timeout
        while time.monotonic() < end and (node.answer is None or node.answer.output not in _REST):
            node.say()  # again, for a plant whose stop was released meanwhile
            executor.spin_once(timeout_sec=_AGAIN)
        answer = node.answer
        executor.shutdown()
        node.destroy_node()
        return answer
