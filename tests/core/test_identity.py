"""Who commands a node, and who else does its work, on a graph that the test turns."""

from __future__ import annotations

from nmt_core.nodes.identity import Identity

PLL, STRANGER, FORCE = "/pll", "/stranger/pll", "nmt_msgs/msg/Drive"


class Graph:
    """Publishers by topic: identifier, node, type; servers by service."""

    def __init__(self) -> None:
        self.published: dict[str, list[tuple[str, str, str]]] = {}
        self.served: dict[str, list[str]] = {}
        self.asked = 0

    def publishers(self, topic: str, message_type: str = "") -> dict[str, str]:
        self.asked += 1
        found = self.published.get(topic, [])
        return {token: node for token, node, kind in found if kind == (message_type or kind)}

    def count_publishers(self, topic: str) -> int:
        return len(self.published.get(topic, []))

    def servers(self, service: str) -> list[str]:
        found = self.served.get(service, [])
        return found if len(found) > 1 else []


def commanded() -> tuple[Identity, Graph]:
    graph = Graph()
    graph.published["drive"] = [("1", PLL, FORCE)]
    identity = Identity(graph, lambda topic: len(graph.published[topic]))
    identity.watch_commands("drive", FORCE)
    return identity, graph


def test_the_only_publisher_is_the_source_and_is_asked_for_once() -> None:
    identity, graph = commanded()
    source = identity.source("drive")
    assert (source.token, source.name, source.alone) == ("1", PLL, True)
    assert identity.source("drive") is source
    assert graph.asked == 1
    assert identity.second_command() == ""


def test_of_two_publishers_nobody_can_tell_who_sent_a_command() -> None:
    identity, graph = commanded()
    identity.source("drive")
    graph.published["drive"].append(("2", STRANGER, FORCE))
    assert identity.known_source("drive").alone  # as it was last asked
    source = identity.source("drive")
    assert not source.alone
    assert identity.second_command() == f"topic drive has several publishers: {PLL} and {STRANGER}"


def test_what_a_publisher_sent_before_it_left_still_counts() -> None:
    identity, graph = commanded()
    before = identity.source("drive")
    graph.published["drive"].clear()
    assert identity.source("drive") == before
    graph.published["drive"] = [("3", PLL, FORCE)]
    assert identity.source("drive").token == "3"


def test_another_type_on_a_commanded_topic_commands_nothing() -> None:
    identity, graph = commanded()
    graph.published["drive"] = [("1", PLL, FORCE), ("2", STRANGER, "std_msgs/msg/String")]
    assert identity.source("drive").name == PLL


def test_a_second_publisher_or_server_of_what_is_the_nodes_own_is_named() -> None:
    identity, graph = commanded()
    identity.claim("level")
    identity.claim_service("stop")
    identity.look_around()
    assert identity.intruder == ""
    graph.published["level"] = [("4", "/sequencer", "L"), ("5", STRANGER, "L")]
    assert identity.intruder == ""  # until the next look
    identity.look_for_intruders()
    assert identity.intruder == "topic level has several publishers: /sequencer and /stranger/pll"
    graph.served["stop"] = ["/b", "/a"]
    identity.look_for_intruders()
    assert identity.intruder == "service stop has several servers: /a and /b"
    graph.served.clear()
    graph.published["level"].pop()
    identity.look_for_intruders()
    assert identity.intruder == ""
