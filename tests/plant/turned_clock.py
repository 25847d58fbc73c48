"""A steady clock for tests: it stands still while somebody works, and goes on to the next event when all wait."""

from __future__ import annotations

import math
import select
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from nmt_core.processes.steady_clock import SteadyClock


class Killed(BaseException):
    """Ends a participant wherever it is; no driver answers it any more."""


@dataclass(eq=False)
class _Wait:
    name: str
    due: float
    ready: Callable[[], bool]
    go: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))
    outcome: bool = False


class TurnedClock(SteadyClock):
    """Whoever waits on it takes part: the test, and every function that `start` runs in a thread of its own.

    One of them runs at a time, in the order in which they are due, so that a test does the same every time.

    Attributes:
        killed: names of those who have been.
        failures: exceptions that ended participants.
    """

    def __init__(self) -> None:
        self._now = 100.0
        self._waits: list[_Wait] = []
        self._here = threading.local()
        self._stopped: dict[str, float] = {}
        self.killed: set[str] = set()
        self._threads: dict[threading.Thread, str] = {}
        self.failures: list[BaseException] = []

    def now(self) -> float:
        return self._now

    def sleep(self, seconds: float) -> None:
        self._wait(lambda: False, seconds)

    def wait(self, event: threading.Event, seconds: float) -> bool:
        return self._wait(event.is_set, seconds)

    def wait_to_read(self, channel: socket.socket, seconds: float) -> bool:
        return self._wait(lambda: bool(select.select([channel], [], [], 0.0)[0]), seconds)

    def start(self, name: str, work: Callable[[], None]) -> threading.Event:
        """Let a function take part from now on, under a name; the event says that it has ended."""
        begin, ended = _Wait(name, self._now, lambda: True), threading.Event()

        def run() -> None:
            self._here.name = name
            begin.go.acquire()
            try:
                self.check()
                work()
            except Killed:
                pass
            except BaseException as error:
                self.failures.append(error)
            ended.set()
            self._pass_on()

        thread = threading.Thread(target=run, daemon=True)
        self._threads[thread] = name
        self._waits.append(begin)
        thread.start()
        return ended

    def stop(self, name: str, seconds: float = math.inf) -> None:
        """Let nobody of that name do anything for so many seconds."""
        self._stopped[name] = self._now + seconds

    def is_stopped(self, name: str) -> bool:
        """Whether it is stopped at present."""
        return self._stopped.get(name, 0.0) > self._now

    def kill(self, name: str) -> None:
        """End all of that name."""
        self.killed.add(name)

    def check(self) -> None:
        """To be called by drivers: whoever has been killed calls none any more."""
        if self._name in self.killed:
            raise Killed

    def close(self) -> None:
        """End everybody but the test."""
        self.killed.update(self._threads.values())
        while any(thread.is_alive() for thread in self._threads):
            self.sleep(0.0)

    @property
    def _name(self) -> str:
        return getattr(self._here, "name", "")

    def _wait(self, ready: Callable[[], bool], seconds: float) -> bool:
        self.check()
        wait = _Wait(self._name, self._now + max(seconds, 0.0), ready)
        self._waits.append(wait)
        self._pass_on()
        wait.go.acquire()
        self.check()
        return wait.outcome

    def _pass_on(self) -> None:
        """Let the one go that is due next, of several the one that has waited longest."""
        chosen = min(self._waits, key=self._due)
        self._now = max(self._now, self._due(chosen))
        chosen.outcome = chosen.ready()
        self._waits.remove(chosen)
        chosen.go.release()

    def _due(self, wait: _Wait) -> float:
        if wait.name in self.killed:
            return self._now
        return max(self._now if wait.ready() else wait.due, self._stopped.get(wait.name, 0.0))
