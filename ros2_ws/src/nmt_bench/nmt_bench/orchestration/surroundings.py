"""What the nodes need of the computer around them, looked at before the first one is started."""

from __future__ import annotations

import resource
from pathlib import Path

from nmt_core.errors import BenchError
from nmt_record.bag.run_recorder import why_unwritable

LEAST_FILES = 128
"""Open files that a process of the bench needs."""
_WANTED_FILES = 1024
_LEAST_FREE_MB = 16
_LEAST_ADDRESSES = 2**31  # bytes; a process of the bench maps 1.5 GB


def check_surroundings(out: Path) -> None:
    """Refuse to start nodes where they could not work.

    The limit of open files is raised as far as the user may raise it.

    Args:
        out: folder of the results.

    Raises:
        BenchError: too few open files, too little address space, or no space for results.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != resource.RLIM_INFINITY and soft < _WANTED_FILES:
        most = _WANTED_FILES if hard == resource.RLIM_INFINITY else min(_WANTED_FILES, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, most), hard))
        if most < LEAST_FILES:
            raise BenchError(
                f"This shell allows {most} open files and the nodes need {LEAST_FILES}; raise the limit with "
                f"'ulimit -n {_WANTED_FILES}', or have the administrator raise it."
            )
    addresses = resource.getrlimit(resource.RLIMIT_AS)[0]
    if addresses != resource.RLIM_INFINITY and addresses < _LEAST_ADDRESSES:
        raise BenchError(
            f"This shell gives a process {addresses / 2**20:.0f} MiB of address space and the nodes need "
            f"{_LEAST_ADDRESSES / 2**20:.0f}; raise the limit with 'ulimit -v unlimited'."
        )
    why = why_unwritable(out / "bag", _LEAST_FREE_MB)
    if why:
        why = why.removesuffix(" (parameter 'least_free_mb')")
        raise BenchError(f"The results cannot be recorded: {why}; choose another folder with --out, or make room.")
