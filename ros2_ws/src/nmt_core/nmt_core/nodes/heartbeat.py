"""What a node says of itself, and the thread that says it while the node is at a long piece of work; free of ROS."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

from nmt_core.messages.wire import NodeStatus
from nmt_core.nodes.liveness import BUSY, HANG_LIMIT, HUNG
from nmt_core.processes.process_watch import ProcessWatch

HEARTBEAT_PERIOD = 0.25  # s of wall time
_LATE = 2.5 * HEARTBEAT_PERIOD  # s without a heartbeat of the working thread after which another one speaks for it
ERROR = b"\x02"
"""Level of ``diagnostic_msgs/DiagnosticStatus`` that ends a run."""


class Heartbeat:
    """The newest status of a node.

    Args:
        status: the first one.
        publish: puts a status on ``/diagnostics``; called from two threads.
        hang_timeout: s of one piece of work after which the node calls itself hung, in real time.
        lockstep: whether the run waits for the node.
        gone: what publishing raises once the middleware has been shut down.

    Attributes:
        newest: status that was said last by the working thread.
        worked: when, s of the steady clock.
    """

    def __init__(
        self,
        status: NodeStatus,
        publish: Callable[[NodeStatus], None],
        hang_timeout: float,
        lockstep: bool,
        gone: type[Exception] = OSError,
    ) -> None:
        self.newest, self.worked = status, time.monotonic()
        self._publish, self._gone = publish, gone
        self._limit = HANG_LIMIT if lockstep else hang_timeout
        self._lockstep = lockstep

    def say(self, status: NodeStatus) -> None:
        """Publish a status; the working thread is alive."""
        self.newest, self.worked = status, time.monotonic()
        self._publish(status)

    @contextlib.contextmanager
    def watched_work(self) -> Iterator[None]:
        """Have a thread next to the working one that says on ``/diagnostics`` how long the work takes, if it is long.

        The node is ``busy`` then and stays alive to others; beyond the time-out, and in lockstep when it could have
        worked for `nmt_core.nodes.liveness.HANG_LIMIT`, it is ``hung``, which is an error.
        """
        over = threading.Event()
        process = ProcessWatch(os.getpid()) if self._lockstep else None

        def watch() -> None:
            worked, free = 0.0, 0.0
            while not over.wait(HEARTBEAT_PERIOD):
                since = time.monotonic() - self.worked
                if since < _LATE:
                    continue
                if process is None:
                    free = since
                elif worked != self.worked:  # begin to count what it could have worked since
                    worked, free = self.worked, 0.0
                    process.begin()
                else:
                    free += process.looked()[0]
                status = replace(self.newest, message=f"{BUSY} for {since:.1f} s")
                if free > self._limit:
                    status.level = ERROR
                    status.message = f"{HUNG}: nothing has been done for {since:.1f} s"
                with contextlib.suppress(self._gone):
                    self._publish(status)

        thread = threading.Thread(target=watch, name="heartbeat", daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()
