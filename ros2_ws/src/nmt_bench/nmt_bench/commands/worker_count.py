"""The option ``--jobs``: how many processes of this machine share a command's work."""

from __future__ import annotations

import argparse
import os

from nmt_core.errors import BenchError


def worker_count(arguments: argparse.Namespace) -> int:
    """Processes that were asked for; one for each core that this process may use where none were.

    Raises:
        BenchError: fewer than one.
    """
    if arguments.jobs is not None:
        if arguments.jobs < 1:
            raise BenchError(f"--jobs must be at least 1, got {arguments.jobs}.")
        return int(arguments.jobs)
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1
