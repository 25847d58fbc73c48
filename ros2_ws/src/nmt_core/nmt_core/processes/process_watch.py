"""A process on this host seen from outside: whether it lives, is stopped, and how long it could have worked."""

from __future__ import annotations

import contextlib
import os
import re
import select
import socket
import time
from pathlib import Path

_INSTANCE = re.compile(r"(?P<host>\S+) process (?P<process>\d+) node \d+")
_LONGEST_LOOK = 0.5  # s; whoever looks less often was itself without a processor


def process_of(instance: str) -> int | None:
    """Process id in the name that a node's heartbeat gives; None on another host or where it names none."""
    found = _INSTANCE.fullmatch(instance)
    if found is None or found["host"] != socket.gethostname():
        return None
    return int(found["process"])


def state_of(process: int) -> str:
    """State letter of a process as the kernel names it; empty if it has ended or cannot be looked at."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except (OSError, IndexError):
        return ""


class ProcessWatch:
    """Looks at one process.

    Args:
        process: its id.

    Raises:
        OSError: no such process, or exists this system does not let it be watched.
    """

    def __init__(self, process: int) -> None:
        self.process = process
        self._descriptor = os.pidfd_open(process)
        self._poll = select.poll()
        self._poll.register(self._descriptor, select.POLLIN)
        self._times: dict[str, tuple[int, int]] = {}
        self._looked = 0.0

    def close(self) -> None:
        """Look no more."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def __del__(self) -> None:
        with contextlib.suppress(OSError, AttributeError):
            self.close()

    @property
    def lives(self) -> bool:
        """Whether it has not ended; the id of one that has may be another's by now."""
        return self._descriptor >= 0 and not self._poll.poll(0)

    @property
    def is_stopped(self) -> bool:
        """Whether a signal or a debugger holds it."""
        return state_of(self.process) in ("T", "t")

    def begin(self, now: float | None = None) -> None:
        """Count from now (s of the steady clock) on."""
        self._times, self._looked = self._read(), time.monotonic() if now is None else now

    def looked(self, now: float | None = None) -> tuple[float, float]:
        """What it did since the last look.

        Args:
            now: s of the steady clock; None = the present.

        Returns:
            s in which it could have worked, because no thread of it waited for a processor and it was not stopped,
            and s of processor time that it used. A look that comes late counts for no more than `_LONGEST_LOOK`.
        """
        now = time.monotonic() if now is None else now
        before, since = self._times, min(max(now - self._looked, 0.0), _LONGEST_LOOK)
        self.begin(now)
        if self.is_stopped:
            return 0.0, 0.0
        pairs = [(before.get(thread, times), times) for thread, times in self._times.items()]
        waited = max((new[1] - old[1] for old, new in pairs), default=0) / 1e9
        ran = sum(new[0] - old[0] for old, new in pairs) / 1e9
        return max(0.0, since - waited), ran

    def _read(self) -> dict[str, tuple[int, int]]:
        """Time on a processor and waiting for one of each thread, ns."""
        times = {}
        folder = f"/proc/{self.process}/task"
        with contextlib.suppress(OSError):
            for thread in os.listdir(folder):
                with contextlib.suppress(OSError, ValueError, IndexError), open(f"{folder}/{thread}/schedstat") as file:
                    words = file.read().split()
                    times[thread] = (int(words[0]), int(words[1]))
        return times
