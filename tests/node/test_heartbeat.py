"""A node that is busy says so, one that hangs calls itself hung, and signals are wishes to end."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.context import Context

from nmt_core.base_node import BenchNode, EndRequest
from nmt_core.nodes.node_settings import NodeSettings


@pytest.fixture
def node(domain_id: int) -> Iterator[BenchNode]:
    context = Context()
    rclpy.init(context=context, domain_id=domain_id, args=[])
    made = BenchNode("worker", settings=NodeSettings(hang_timeout=1.5), context=context)
    yield made
    made.destroy_node()
    rclpy.shutdown(context=context)


def test_work_that_takes_long_is_busy_and_then_hung(node: BenchNode, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[DiagnosticStatus] = []
    monkeypatch.setattr(node.heartbeat, "_publish", said.append)
    node.beat()  # the working thread
    with node.heartbeat.watched_work():
        end = time.monotonic() + 30.0
        while not said[-1].message.startswith("hung") and time.monotonic() < end:
            time.sleep(0.05)  # a piece of work
        node.beat()
    words = [status.message.partition(" ")[0].rstrip(":") for status in said]
    assert [word for before, word in zip(["", *words], words, strict=False) if word != before] == [
        "ready",
        "busy",
        "hung",
        "ready",
    ]
    levels = {word: status.level for word, status in zip(words, said, strict=True)}
    assert levels["busy"] == DiagnosticStatus.OK
    assert levels["hung"] == DiagnosticStatus.ERROR
    assert {(status.name, status.hardware_id) for status in said} == {("worker", node.instance)}


def test_a_node_at_work_speaks_for_itself(node: BenchNode, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[DiagnosticStatus] = []
    monkeypatch.setattr(node.heartbeat, "_publish", said.append)
    with node.heartbeat.watched_work():
        node.heartbeat.worked = time.monotonic() + 1.0e6  # never long ago
        time.sleep(0.6)
    assert said == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_is_a_wish_to_end_and_a_later_one_urges(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr("nmt_core.base_node.time.monotonic", lambda: now[0])
    before = signal.getsignal(number)
    with EndRequest() as request:
        os.kill(os.getpid(), number)
        assert request.since == 100.0
        now[0] = 100.5
        os.kill(os.getpid(), number)  # the echo of the first: from the terminal and from launch
        assert not request.hurry
        now[0] = 102.0
        os.kill(os.getpid(), number)
        assert request.hurry
    assert signal.getsignal(number) == before


def test_an_ignored_signal_stays_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with EndRequest() as request:
            os.kill(os.getpid(), signal.SIGHUP)
            assert request.since is None
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
