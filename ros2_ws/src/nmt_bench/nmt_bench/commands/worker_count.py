"""The option ``--jobs``: how many processes of this machine share a command's work."""

from __future__ import annotations

import os
from typing import Protocol

from nmt_core.errors import BenchError


class WithJobs(Protocol):
    """Options of a command that has ``--jobs``."""

    @property
    def jobs(self) -> int | None:
        """Processes; None = one for each core."""


def worker_count(options: WithJobs) -> int:
    """Processes that were asked for; one for each core that this process may use where none were.

    Raises:
        BenchError: fewer than one.
    """
    if options.jobs is not None:
        if options.jobs < 1:
            raise BenchError(f"--jobs must be at least 1, got {options.jobs}.")
        return options.jobs
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1
