"""Clears away the shared memory of nodes that were killed.

Fast DDS keeps one segment a participant in /dev/shm and locks a file beside it, ``<segment>_el``, as long as its owner
lives. Where nobody holds that lock the owner is dead: a killed process cannot tidy up.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import time
from pathlib import Path

FOLDER = Path("/dev/shm")
_YOUNGEST = 1.0  # s; a segment that is being made is not locked yet


def remove_dead_segments(folder: Path = FOLDER) -> list[str]:
    """Remove segments whose owner is dead; those of living processes, whoever's they are, stay.

    Args:
        folder: where shared memory lives.

    Returns:
        Names of what was removed.
    """
    removed = []
    for lock in sorted(folder.glob("fastrtps_*_el")):
        name = lock.name.removesuffix("_el")
        with contextlib.suppress(OSError):
            if time.time() - lock.stat().st_mtime < _YOUNGEST:
                continue
            handle = os.open(lock, os.O_RDWR)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                for path in (folder / name, folder / f"sem.{name}_mutex", lock):
                    with contextlib.suppress(FileNotFoundError):
                        path.unlink()
                        removed.append(path.name)
            finally:
                os.close(handle)
    # A port whose last reader is gone leaves its segment without a lock file.
    locked = {path.name.removesuffix("_el") for path in folder.glob("fastrtps_*_el")}
    for segment in sorted(folder.glob("fastrtps_port*")):
        if segment.name.endswith(("_el", "_sl")) or segment.name in locked or _in_use(segment):
            continue
        with contextlib.suppress(OSError):
            if time.time() - segment.stat().st_mtime >= _YOUNGEST:
                segment.unlink()
                removed.append(segment.name)
                (folder / f"sem.{segment.name}_mutex").unlink()
                removed.append(f"sem.{segment.name}_mutex")
    return removed


def _in_use(segment: Path) -> bool:
    """Whether a living process of this user has the segment mapped."""
    for maps in Path("/proc").glob("[0-9]*/maps"):
        with contextlib.suppress(OSError):
            if str(segment) in maps.read_text():
                return True
    return False
