"""The ways of a node's messages: topics of the middleware, and the link past it; free of ROS."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from nmt_core.nodes.link import TAKEN_BY, Link

LINK_PERIOD = 0.01  # s between two looks at the middleware of a node that takes the sample path past it
_LAST_WORDS = 3.0  # s


class Outlet:
    """A publisher of serialised messages.

    A message without a reader is not handed to the middleware, unless it is kept for those who come later.

    Args:
        publisher: of rclpy.
        keeps: whether messages are kept for those who come later.
        send: hands a message to the nodes that take it past the middleware; None = there are none.
        takers: how many these are.
    """

    def __init__(
        self, publisher: Any, keeps: bool, send: Callable[[bytes], None] | None = None, takers: int = 0
    ) -> None:
        self.publisher, self._keeps, self._send, self._takers = publisher, keeps, send, takers

    def publish(self, raw: bytes) -> None:
        """Publish a serialised message."""
        if self._send is not None:
            self._send(raw)
        if self._keeps or self.publisher.get_subscription_count():
            self.publisher.publish(raw)

    def peers(self) -> int:
        """How many take what is published."""
        return int(self.publisher.get_subscription_count()) + self._takers


class Transport:
    """The endpoints of a node, each with how many peers it has.

    Args:
        name: of the node.
        link: its socket for what it takes past the middleware; None where it takes nothing so.
    """

    def __init__(self, name: str, link: Link | None = None) -> None:
        self._name, self.link = name, link
        self._endpoints: dict[str, list[Callable[[], int]]] = {}
        self._unfinished: list[Callable[[float], None]] = []

    def outlet(self, topic: str, publisher: Any, keeps: bool, finish: Callable[[float], None]) -> Outlet:
        """Take a publisher of serialised messages among the endpoints.

        Args:
            topic: its topic.
            publisher: of rclpy.
            keeps: whether its messages are kept for those who come later.
            finish: waits at most so long (s) until all that was published has arrived.
        """
        outlet = Outlet(publisher, keeps)
        if self.link is not None and topic in TAKEN_BY:
            outlet = Outlet(publisher, keeps, self.link.sender(topic), len(TAKEN_BY[topic]))
        self.endpoint(topic, outlet.peers)
        self._unfinished.append(finish)
        return outlet

    def endpoint(self, topic: str, peers: Callable[[], int]) -> None:
        """Take an endpoint of a topic, by what counts its peers."""
        self._endpoints.setdefault(topic, []).append(peers)

    def takes(self, topic: str) -> bool:
        """Whether the messages of a topic come over the node's link."""
        return self.link is not None and self._name in TAKEN_BY.get(topic, ())

    def peers(self, topic: str) -> int:
        """How many peers the endpoints of a topic have."""
        return max((connected() for connected in self._endpoints.get(topic, [])), default=0)

    def missing(self, expected: Mapping[str, int]) -> list[str]:
        """Topics whose expected peers are not connected yet."""
        return [topic for topic, count in expected.items() if self.peers(topic) < count]

    @property
    def counters(self) -> dict[str, int]:
        """What waits at the link."""
        return {} if self.link is None else dict(self.link.counters)

    def deliver(self, patience: float = _LAST_WORDS) -> None:
        """Wait until all that was published has arrived, since what is on its way goes with its node.

        Args:
            patience: s, the longest wait; a stopped receiver takes nothing.
        """
        end = time.monotonic() + patience
        while self.link is not None and not self.link.flush() and time.monotonic() < end:
            time.sleep(LINK_PERIOD)
        for finish in self._unfinished:
            finish(max(0.0, end - time.monotonic()))

    def close(self) -> None:
        """Give the link back."""
        if self.link is not None:
            self.link.close()
