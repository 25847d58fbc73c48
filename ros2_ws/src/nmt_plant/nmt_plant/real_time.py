"""Real-time figures: how late blocks come, and with which priority processes run."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_EDGES_MS = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
_POLICIES = {os.SCHED_FIFO: "FIFO", os.SCHED_RR: "RR"}


def computer_settings(folder: Path = Path("/sys/devices/system/cpu")) -> str:
    """What of this computer decides about real time, for people: cores that may be used, their governor, the load.

    Args:
        folder: where the system describes its processors.
    """
    governors = set()
    for path in folder.glob("cpu*/cpufreq/scaling_governor"):
        with suppress(OSError):
            governors.add(path.read_text(encoding="utf-8").strip())
    cores = len(os.sched_getaffinity(0))
    load = os.getloadavg()[0]
    return (
        f"{cores} core{'s' if cores != 1 else ''}, frequency governor {'/'.join(sorted(governors)) or 'not known'}, "
        f"load {load:.1f}"
    )


def priority_of(process: int | None) -> str:
    """Scheduling of a process, for people: real-time policy and priority, or its nice value."""
    if process is None:
        return "unknown"
    try:
        policy = os.sched_getscheduler(process)
        if policy in _POLICIES:
            return f"real time ({_POLICIES[policy]} {os.sched_getparam(process).sched_priority})"
        return f"ordinary (nice {os.getpriority(os.PRIO_PROCESS, process)})"
    except OSError:
        return "unknown"


@contextmanager
def real_time_priority(priority: int = 5) -> Iterator[bool]:
    """Run this thread at a real-time priority, where the system allows it; gives whether it does."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    allowed = True
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        allowed = False
    try:
        yield allowed
    finally:
        if allowed:
            os.sched_setscheduler(0, *before)


class LatenessHistogram:
    """Counts of blocks by how late they were published.

    Args:
        period: of a block, s.
    """

    def __init__(self, period: float) -> None:
        self._edges = tuple(sorted({*_EDGES_MS, round(1e3 * period, 3)}))
        self._counts = [0] * (len(self._edges) + 1)

    def add(self, lateness: float) -> None:
        """Count a block, s late."""
        milliseconds = 1e3 * lateness
        index = next((n for n, edge in enumerate(self._edges) if milliseconds < edge), len(self._edges))
        self._counts[index] += 1

    @property
    def text(self) -> str:
        """``< 0.5 ms: 12; < 1 ms: 3; …``: those of every class, the last beyond the largest edge."""
        parts = [f"< {edge:g} ms: {count}" for edge, count in zip(self._edges, self._counts, strict=False) if count]
        return "; ".join([*parts, *([f"later: {self._counts[-1]}"] if self._counts[-1] else [])])


def read_histogram(text: str) -> list[tuple[str, int]]:
    """The classes and counts of `LatenessHistogram.text`."""
    pairs = (part.rpartition(": ") for part in text.split("; ") if part)
    return [(name, int(count)) for name, _, count in pairs]
