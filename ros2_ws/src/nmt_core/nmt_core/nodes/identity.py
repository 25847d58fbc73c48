"""Who a node is on its bench: what it alone publishes and serves, and who sends it commands; free of ROS.

A command counts only while one publisher may have sent it. A second one of a topic, a second server of a service or a
second node of a name means that two benches meet, and no command can be trusted.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from nmt_core.messages.command_judge import CommandSource


class Graph(Protocol):
    """What is asked of the middleware about other nodes; topics and services by the node's names for them."""

    def publishers(self, topic: str, message_type: str = "") -> dict[str, str]:
        """Publishers that match a reliable reader: identifier -> fully qualified name of the node.

        Args:
            topic: its name.
            message_type: only those of this type; empty = of any.
        """

    def count_publishers(self, topic: str) -> int:
        """How many publish on a topic, matching or not."""

    def servers(self, service: str) -> list[str]:
        """Names of the nodes that serve a service where these are several; else nothing."""


class Identity:
    """What is a node's alone.

    Args:
        graph: of the middleware.
        peers: topic -> how many endpoints of it are connected to the node now.
    """

    def __init__(self, graph: Graph, peers: Callable[[str], int]) -> None:
        self._graph, self._peers = graph, peers
        self.topics: list[str] = []
        self._services: list[str] = []
        self._sources: dict[str, tuple[int, CommandSource]] = {}
        self._command_types: dict[str, str] = {}
        self._intruder = ""

    def claim(self, topic: str) -> None:
        """Watch that no other node publishes on a topic that is this node's own."""
        self.topics.append(topic)

    def claim_service(self, name: str) -> None:
        """Watch that no other node serves a service of this node."""
        self._services.append(name)

    def watch_commands(self, topic: str, message_type: str) -> None:
        """Watch who publishes on a topic that commands this node."""
        self._command_types[topic] = message_type

    def known_source(self, topic: str) -> CommandSource:
        """Who published on a commanded topic when it was last asked."""
        known = self._sources.get(topic)
        return self.source(topic) if known is None else known[1]

    def source(self, topic: str) -> CommandSource:
        """Who publishes on a commanded topic now."""
        count = self._peers(topic)
        known = self._sources.get(topic)
        if known is not None and known[0] == count:
            return known[1]
        return self._look_for_publishers(topic, count)

    def _look_for_publishers(self, topic: str, count: int) -> CommandSource:
        found = self._graph.publishers(topic, self._command_types[topic])
        known = self._sources.get(topic)
        if not found and known is not None and known[1].alone:
            source = known[1]  # what it sent before it left
        else:
            names = " and ".join(sorted(found.values())) or "a publisher that is not known yet"
            source = CommandSource(" ".join(sorted(found)), names, alone=len(found) == 1 and count <= 1)
        self._sources[topic] = (count, source)
        return source

    def look_around(self) -> None:
        """Ask the middleware anew who commands this node, and who does its work."""
        for topic in self._command_types:
            self._look_for_publishers(topic, self._peers(topic))
        self.look_for_intruders()

    def look_for_intruders(self) -> None:
        """Look whether somebody else does the work of this node; `second` says so then."""
        self._intruder = self._found_intruders()

    def _found_intruders(self) -> str:
        for service in self._services:
            servers = self._graph.servers(service)
            if servers:
                return f"service {service} has several servers: {' and '.join(sorted(set(servers)))}"
        for topic in self.topics:
            if self._graph.count_publishers(topic) < 2:
                continue
            found = self._graph.publishers(topic)
            if len(found) > 1:
                return f"topic {topic} has several publishers: {' and '.join(sorted(found.values()))}"
        return ""

    @property
    def intruder(self) -> str:
        """A sentence on who does the work of this node, by the last look; empty if none."""
        return self._intruder

    def second_command(self) -> str:
        """A sentence on a commanded topic with several publishers; empty if there is none."""
        for topic in self._command_types:
            source = self.source(topic)
            if not source.alone and self._sources[topic][0] > 1:
                return f"topic {topic} has several publishers: {source}"
        return ""
