"""Work that a second processor takes half of."""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import tempfile
from collections.abc import Callable, Sequence
from typing import IO, Any

FEWEST_CALLS = 4
"""With fewer, a second process would take longer to start than it saves."""


def results_of(calls: Sequence[Callable[[], Any]], alone: bool = False) -> list[Any]:
    """What functions without arguments return, in their order.

    Every second one is called in a copy of this process where there is another processor; what such a copy fails to
    deliver is called here. So the functions must give the same twice, and what they return must be picklable.

    Args:
        calls: the functions.
        alone: whether this process cannot be copied.
    """
    if alone or len(calls) < FEWEST_CALLS or len(os.sched_getaffinity(0)) < 2:
        return [call() for call in calls]
    with tempfile.TemporaryFile() as file:
        process = os.fork()
        if not process:
            _deliver(calls[1::2], file)
        try:
            own = [call() for call in calls[::2]]
            _, status = os.waitpid(process, 0)
        except BaseException:
            with contextlib.suppress(ProcessLookupError, ChildProcessError):
                os.kill(process, signal.SIGKILL)
                os.waitpid(process, 0)
            raise
        file.seek(0)
        other = pickle.load(file) if status == 0 else [call() for call in calls[1::2]]
    return [(other if number % 2 else own)[number // 2] for number in range(len(calls))]


def font_is_open() -> bool:
    """Whether this process reads a font: two copies of it would move each other's place in that file."""
    for descriptor in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError):
            if os.readlink(f"/proc/self/fd/{descriptor}").lower().endswith((".ttf", ".otf", ".pfb")):
                return True
    return False


def _deliver(calls: Sequence[Callable[[], Any]], file: IO[bytes]) -> None:
    """Call functions, write what they return, and end this process without taking anything apart."""
    status = 1
    try:
        pickle.dump([call() for call in calls], file)
        file.flush()
        status = 0
    finally:
        os._exit(status)
