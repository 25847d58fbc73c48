"""Endpoints of a node and their peers, without a middleware."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from nmt_core.nodes.link import TAKEN_BY
from nmt_core.nodes.transport import Transport


class Publisher:
    """Counts what it is given to publish, and has as many subscriptions as the test says."""

    def __init__(self, subscriptions: int = 0) -> None:
        self.subscriptions, self.sent = subscriptions, [b""][:0]

    def get_subscription_count(self) -> int:
        return self.subscriptions

    def publish(self, raw: bytes) -> None:
        self.sent.append(raw)


class Linked:
    """A link that notes what is sent and takes so many calls until it is empty."""

    def __init__(self, flushes: int = 1) -> None:
        self.sent: list[tuple[str, bytes]] = []
        self.flushes, self.closed = flushes, False
        self.counters = {"outbox_plant_bytes": 3}

    def sender(self, topic: str) -> Any:
        return lambda raw: self.sent.append((topic, raw))

    def flush(self) -> bool:
        self.flushes -= 1
        return self.flushes <= 0

    def close(self) -> None:
        self.closed = True


def nothing(patience: float) -> None:
    """Wait for nobody."""


@pytest.mark.parametrize(("subscriptions", "keeps", "sent"), [(0, False, 0), (1, False, 1), (0, True, 1)])
def test_what_nobody_takes_is_published_only_if_it_is_kept(subscriptions: int, keeps: bool, sent: int) -> None:
    publisher = Publisher(subscriptions)
    Transport("plant").outlet("force", publisher, keeps, nothing).publish(b"block")
    assert publisher.sent == [b"block"] * sent


def test_a_link_takes_its_topics_and_no_others() -> None:
    link = Linked()
    transport = Transport("plant", link)  # type: ignore[arg-type]
    drive = transport.outlet("lock", Publisher(), False, nothing)
    transport.outlet("force", Publisher(), False, nothing).publish(b"block")
    drive.publish(b"command")
    assert link.sent == [("lock", b"command")]
    assert drive.peers() == len(TAKEN_BY["lock"]) == 1
    assert transport.takes("drive")
    assert not transport.takes("lock")
    assert not Transport("plant").takes("drive")
    assert transport.counters == link.counters
    transport.close()
    assert link.closed


def test_peers_are_missing_until_any_endpoint_of_a_topic_has_them() -> None:
    transport, one, other = Transport("plant"), SimpleNamespace(n=0), SimpleNamespace(n=0)
    expected = {"drive": 2, "level": 1}
    assert transport.missing(expected) == ["drive", "level"]
    transport.endpoint("drive", lambda: one.n)
    transport.endpoint("drive", lambda: other.n)
    transport.endpoint("level", lambda: 1)
    assert transport.missing(expected) == ["drive"]
    other.n = 2
    assert transport.missing(expected) == []
    assert (transport.peers("drive"), transport.peers("nothing")) == (2, 0)


def test_the_last_words_are_waited_for_with_one_patience_for_all() -> None:
    link, left = Linked(flushes=3), []
    transport = Transport("plant", link)  # type: ignore[arg-type]
    for _ in range(2):
        transport.outlet("force", Publisher(), False, left.append)
    transport.deliver(5.0)
    assert link.flushes == 0
    assert 5.0 > left[0] >= left[1] > 0.0
    link.flushes, left[:] = 10**9, []
    transport.deliver(0.0)  # a reader that is stopped takes nothing
    assert left == [0.0, 0.0]
