"""What a node concludes from the heartbeats of others, with times given by hand."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from typing import Any

from nmt_core.nodes.liveness import HANG_LIMIT, READY, Liveness

A, B = "lab process 1 node 1", "lab process 2 node 1"


def realtime(**options: Any) -> Liveness:
    made = Liveness(["pll", "plant"], 2.0, **options)
    made.listened(0.0)
    return made


def test_a_node_is_silent_after_the_time_out_and_not_before() -> None:
    others = realtime()
    assert not others.lost(0.0)  # nobody was heard yet: not ready, but not lost either
    others.hear("pll", A, READY, False, 0.5)
    for now in (1.0, 1.7, 2.4):
        others.listened(now)
    assert not others.lost(2.49)
    assert list(others.lost(2.51)) == ["pll"]


def test_time_in_which_the_node_could_not_listen_does_not_count() -> None:
    others = realtime()
    others.hear("pll", A, READY, False, 0.0)
    assert not others.lost(30.0)  # deaf for 30 s itself
    others.listened(30.0)
    assert not others.lost(30.5)
    for now in (30.9, 31.8, 32.6):
        others.listened(now)
    assert list(others.lost(32.7)) == ["pll"]


def test_a_busy_node_is_not_lost_and_a_hung_one_is() -> None:
    others = realtime()
    others.hear("pll", A, "busy for 8.0 s", False, 0.5)
    others.hear("plant", A, READY, False, 0.5)
    assert not others.lost(0.6)
    assert others.unready(0.6) == {"pll": "busy for 8.0 s"}
    others.hear("pll", A, "hung: nothing has been done for 10.1 s", True, 0.7)
    assert list(others.lost(0.8)) == ["pll"]
    assert others.failures == {"pll": "hung: nothing has been done for 10.1 s"}


def test_who_is_not_ready_and_why() -> None:
    others = realtime()
    assert others.unheard == ["pll", "plant"]
    assert others.unready(0.0) == {"pll": "not heard of", "plant": "not heard of"}
    others.hear("pll", A, READY, False, 0.0)
    others.hear("plant", A, "waiting for drive", False, 0.0)
    assert others.unready(0.1) == {"plant": "waiting for drive"}
    assert others.unheard == []
    assert others.unready(2.1) == {"pll": "silent", "plant": "silent"}


def test_two_processes_of_one_name_are_named_while_both_are_heard() -> None:
    others = realtime()
    for now, instance in ((0.1, A), (0.2, B), (0.35, A)):
        assert others.twice(now) == ""
        others.hear("pll", instance, READY, False, now)
    assert others.twice(0.4) == f"node pll is there twice: {A} and {B}"
    assert others.twice(2.4) == ""


def test_a_node_that_was_started_again_is_no_second_one() -> None:
    others = realtime()
    for now, instance in ((0.1, A), (0.35, A), (1.5, B), (1.75, B), (2.0, B)):
        others.hear("pll", instance, READY, False, now)
        assert others.twice(now) == ""


def test_a_heartbeat_in_the_own_name_from_another_process_is_a_second_one() -> None:
    others = realtime(own="sequencer", own_instance=A)
    others.hear("sequencer", A, READY, False, 0.1)
    assert others.twice(0.2) == ""
    others.hear("sequencer", B, READY, False, 0.3)
    assert others.twice(0.4) == f"node sequencer is there twice: {A} and {B}"
    others.hear("stranger", B, READY, False, 0.5)
    assert "stranger" not in others.twice(0.6)


def test_a_node_that_was_started_again_is_noted_until_the_next_run() -> None:
    others = realtime()
    others.hear("pll", A, READY, False, 0.0)
    others.hear("plant", A, READY, False, 0.0)
    others.hear("plant", B, READY, False, 1.0)
    assert others.restarted(1.5) == [], "the one before may be there still"
    assert others.restarted(2.1) == ["plant"]
    others.hear("plant", A, READY, False, 2.2)
    assert others.restarted(3.5) == []
    assert others.twice(3.5)
    others.hear("plant", B, READY, False, 9.0)
    assert others.restarted(11.1) == ["plant"]
    others.meet_again(11.2)
    assert others.restarted(20.0) == []


def test_who_was_not_heard_since() -> None:
    others = realtime()
    others.hear("pll", A, READY, False, 0.0)
    others.hear("plant", A, READY, False, 1.0)
    assert others.unheard_since(0.5) == ["pll"]
    assert others.unheard_since(0.0) == []


def test_a_run_gives_everybody_time_to_be_heard_again() -> None:
    others = realtime()
    others.hear("pll", A, READY, False, 0.0)
    for now in (0.9, 1.8, 2.7, 3.6):
        others.listened(now)
    assert list(others.lost(3.6)) == ["pll"]
    others.meet_again(3.6)
    assert not others.lost(3.7)
    for now in (4.5, 5.4, 5.7):
        others.listened(now)
    assert list(others.lost(5.7)) == ["pll"]


class Process:
    """A process that the test lets run, wait for a processor, stop and die."""

    process = 4711

    def __init__(self) -> None:
        self.lives, self.is_stopped = True, False
        self.free = 1.0  # share of the time in which it does not wait for a processor
        self._since = 0.0

    def begin(self, now: float) -> None:
        self._since = now

    def looked(self, now: float) -> tuple[float, float]:
        passed, self._since = now - self._since, now
        return (0.0 if self.is_stopped else passed * self.free), 0.0


class Lockstep:
    """A node in lockstep that listens four times a second, and the process of the one that it watches."""

    def __init__(self) -> None:
        self.process = Process()
        self.others = Liveness(["pll"], 2.0, lockstep=True, watching=lambda _: self.process)
        self.now = 0.0
        self.others.listened(0.0)
        self.others.hear("pll", A, READY, False, 0.0)

    def go_on(self, seconds: float) -> None:
        for _ in range(round(4 * seconds)):
            self.now += 0.25
            self.others.listened(self.now)

    @property
    def lost(self) -> dict[str, str]:
        return self.others.lost(self.now)


def test_in_lockstep_wall_time_ends_nothing() -> None:
    bench = Lockstep()
    bench.process.free = 0.01
    bench.go_on(600.0)
    assert not bench.lost
    assert bench.others.waited_for(bench.now) == {"pll": "is busy"}
    bench.process.is_stopped = True
    bench.go_on(600.0)
    assert not bench.lost
    assert bench.others.waited_for(bench.now) == {"pll": "is stopped (process 4711)"}
    bench.others.hear("pll", A, READY, False, bench.now)
    assert bench.others.waited_for(bench.now) == {}


def test_in_lockstep_a_node_hangs_when_it_could_have_worked() -> None:
    bench = Lockstep()
    bench.go_on(HANG_LIMIT)
    assert not bench.lost
    bench.go_on(3.0)
    assert bench.lost == {"pll": "hangs: it could have worked for 60 s"}
    bench.others.hear("pll", A, READY, False, bench.now)
    assert not bench.lost


def test_in_lockstep_a_node_dies_with_its_process() -> None:
    bench = Lockstep()
    assert not bench.lost
    bench.process.lives = False
    assert bench.lost == {"pll": "has died"}
    assert bench.others.first_lost(bench.now) == "node pll has died"


def test_a_node_of_this_process_is_never_silent_in_lockstep() -> None:
    here = f"{socket.gethostname()} process {os.getpid()} node 1"
    others = Liveness(["pll"], 2.0, lockstep=True)
    others.listened(0.0)
    others.hear("pll", here, READY, False, 0.0)
    for now in range(200):
        others.listened(now / 2.0)
    assert not others.lost(100.0)


def test_a_node_of_another_host_is_judged_by_its_heartbeats() -> None:
    others = Liveness(["pll"], 2.0, lockstep=True)
    others.listened(0.0)
    others.hear("pll", "elsewhere process 1 node 1", READY, False, 0.0)
    for now in (0.9, 1.8, 2.7):
        others.listened(now)
    assert others.lost(2.7) == {"pll": "has fallen silent"}


def test_a_real_process_stops_goes_on_and_ends() -> None:
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"]) as process:
        others = Liveness(["pll"], 2.0, lockstep=True)
        others.listened(0.0)
        others.hear("pll", f"{socket.gethostname()} process {process.pid} node 1", READY, False, 0.0)
        os.kill(process.pid, signal.SIGSTOP)
        until(lambda: others.waited_for(1.5) == {"pll": f"is stopped (process {process.pid})"})
        assert not others.lost(1.5)
        process.kill()
        until(lambda: others.lost(1.5) == {"pll": "has died"})


def until(condition: Any) -> None:
    end = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)
