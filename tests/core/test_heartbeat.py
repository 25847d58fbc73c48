"""What a node says of itself while it is at a long piece of work, without a middleware."""

from __future__ import annotations

import threading
import time

import pytest

from nmt_core.messages.wire import NodeStatus
from nmt_core.nodes.heartbeat import ERROR, Heartbeat


class Heard:
    """The statuses of a node, and the thread that each came from."""

    def __init__(self, gone: bool = False) -> None:
        self.statuses: list[tuple[str, bytes, bool]] = []
        self.gone = gone

    def __call__(self, status: NodeStatus) -> None:
        of_work = threading.current_thread() is threading.main_thread()
        self.statuses.append((status.message.partition(" ")[0].rstrip(":"), status.level, of_work))
        if self.gone and not of_work:
            raise LookupError("the middleware has gone")

    def until(self, message: str) -> None:
        end = time.monotonic() + 30.0
        while time.monotonic() < end and not any(status[0] == message for status in self.statuses):
            time.sleep(0.02)


def status(message: str) -> NodeStatus:
    return NodeStatus("worker", "here", message=message)


def test_long_work_is_busy_and_then_hung_by_another_thread() -> None:
    heard = Heard()
    heartbeat = Heartbeat(status("starting"), heard, hang_timeout=1.2, lockstep=False)
    heartbeat.say(status("ready"))
    with heartbeat.watched_work():
        heard.until("hung")
        heartbeat.say(status("ready"))
    assert list(dict.fromkeys(heard.statuses)) == [
        ("ready", b"\x00", True), ("busy", b"\x00", False), ("hung", ERROR, False)
    ]  # fmt: skip
    assert heard.statuses[-1] == ("ready", b"\x00", True)
    assert heartbeat.newest.message == "ready"


def test_a_middleware_that_has_gone_ends_no_thread() -> None:
    heard = Heard(gone=True)
    heartbeat = Heartbeat(status("ready"), heard, 1.2, False, LookupError)
    with heartbeat.watched_work():
        heard.until("hung")
    assert ("hung", ERROR, False) in heard.statuses


def test_in_lockstep_waiting_for_a_processor_does_not_hang(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nmt_core.nodes.heartbeat.ProcessWatch", lambda process: Waiting())
    heard = Heard()
    heartbeat = Heartbeat(status("ready"), heard, hang_timeout=0.1, lockstep=True)
    with heartbeat.watched_work():
        heard.until("busy")
        time.sleep(0.6)
    assert {message for message, _, _ in heard.statuses} == {"busy"}


class Waiting:
    """A process that waits for a processor all the time."""

    def begin(self) -> None:
        """Begin to count."""

    def looked(self) -> tuple[float, float]:
        return 0.0, 1.0
