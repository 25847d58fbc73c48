"""A node that was told to end works off what it was sent before it goes."""

from __future__ import annotations

import time
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="the nodes need ROS 2")

from nmt_core.base_node import EndRequest, spin_for_ever


class BusyNode:
    """A node that waits for its last message and gets one a pass."""

    BURST_PERIOD = 0.001
    link = None
    end_grace = 4.0

    def __init__(self, messages: int, lockstep: bool = False) -> None:
        self.in_lockstep = lockstep
        self.context = SimpleNamespace(ok=lambda: True)
        self.received, self.messages = 0, messages
        self.told = 0

    def told_to_end(self) -> None:
        self.told += 1

    def may_end(self, since: float) -> bool:
        return self.received >= self.messages


class OneMessageAPass:
    """An executor that delivers one message in every second call, so that a pass ends after each."""

    def __init__(self, node: BusyNode, sent: int) -> None:
        self.node, self.left, self.turn = node, sent, False

    def spin_once(self, timeout_sec: float) -> None:
        self.turn = not self.turn
        if self.turn and self.left:
            self.left -= 1
            self.node.received += 1


def told(seconds_ago: float) -> EndRequest:
    request = EndRequest()
    request.since = time.monotonic() - seconds_ago
    return request


def test_a_node_that_had_no_processor_for_long_still_takes_what_was_sent() -> None:
    node = BusyNode(5)
    spin_for_ever(OneMessageAPass(node, 5), node, told(5.0))  # type: ignore[arg-type]
    assert node.received == 5
    assert node.told == 1


def test_a_node_to_which_nothing_comes_goes() -> None:
    node = BusyNode(5)
    spin_for_ever(OneMessageAPass(node, 3), node, told(5.0))  # type: ignore[arg-type]
    assert node.received == 3


def test_a_node_does_not_work_off_for_ever() -> None:
    node = BusyNode(5)
    spin_for_ever(OneMessageAPass(node, 5), node, told(60.0))  # type: ignore[arg-type]
    assert node.received == 0


def test_in_lockstep_it_works_off_all_that_it_was_sent() -> None:
    node = BusyNode(5, lockstep=True)
    spin_for_ever(OneMessageAPass(node, 5), node, told(60.0))  # type: ignore[arg-type]
    assert node.received == 5
