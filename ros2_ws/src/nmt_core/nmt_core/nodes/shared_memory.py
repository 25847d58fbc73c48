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
_AGAIN = 0.1  # s between two looks


def remove_dead_segments(folder: Path = FOLDER, patience: float = 0.0, ending: bool = False) -> list[str]:
    """Remove segments whose owner is dead; those of living processes, whoever's they are, stay.

    Args:
        folder: where shared memory lives.
        patience: s to wait for segments that are too young to be judged. Whoever still talked to a node when it was
            killed has made its segments anew since.
        ending: whether this process talks to nobody any more, so that what it has mapped itself is of no use.

    Returns:
        Names of what was removed.
    """
    end = time.monotonic() + patience
    removed, young = _look_through(folder, ending)
    while young and time.monotonic() < end:
        time.sleep(_AGAIN)
        more, young = _look_through(folder, ending)
        removed += more
    return removed


def _look_through(folder: Path, ending: bool) -> tuple[list[str], bool]:
    """Remove what is dead for certain; what was removed, and whether something may be dead that is too young."""
    removed: list[str] = []
    young = False
    for lock in sorted(folder.glob("fastrtps_*_el")):
        name = lock.name.removesuffix("_el")
        with contextlib.suppress(OSError):
            handle = os.open(lock, os.O_RDWR)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if _age(lock) < _YOUNGEST:
                    young = True
                    continue
                for path in (folder / name, folder / f"sem.{name}_mutex", lock):
                    with contextlib.suppress(FileNotFoundError):
                        path.unlink()
                        removed.append(path.name)
            finally:
                os.close(handle)
    # A port whose last reader is gone leaves its segment without a lock file.
    locked = {path.name.removesuffix("_el") for path in folder.glob("fastrtps_*_el")}
    ports = [path for path in folder.glob("fastrtps_port*") if not path.name.endswith(("_el", "_sl"))]
    unlocked = sorted(path for path in ports if path.name not in locked)
    mapped = _mapped(folder, ending) if unlocked else set()
    for segment in unlocked:
        if str(segment) in mapped:
            continue
        with contextlib.suppress(OSError):
            if _age(segment) < _YOUNGEST:
                young = True
                continue
            segment.unlink()
            removed.append(segment.name)
            (folder / f"sem.{segment.name}_mutex").unlink()
            removed.append(f"sem.{segment.name}_mutex")
    return removed, young


def _age(path: Path) -> float:
    return time.time() - path.stat().st_mtime


def _mapped(folder: Path, ending: bool) -> set[str]:
    """Segments that living processes of this user have mapped, those of this one if it is not ending."""
    own = str(os.getpid())
    found: set[str] = set()
    for maps in Path("/proc").glob("[0-9]*/maps"):
        if ending and maps.parent.name == own:
            continue
        with contextlib.suppress(OSError):
            lines = maps.read_text().splitlines()
            found.update(line[line.index("/") :] for line in lines if f" {folder}/" in line)
    return found
