"""The end of a process: with its parent, or when its work is done."""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import os
import signal
import sys
import threading
from typing import NoReturn


def end_process(status: int) -> NoReturn:
    """End as ``sys.exit`` does, but leave the memory to the system.

    What was registered for the end runs, and what was printed is written. The interpreter would go on to take its
    modules apart, which takes a command that drew figures half a second and each node a tenth. Where a thread is still
    at work that is to be waited for, the interpreter ends as always.

    Args:
        status: exit code.
    """
    if any(not thread.daemon for thread in threading.enumerate() if thread is not threading.main_thread()):
        sys.exit(status)
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            stream.flush()
    os._exit(status)


_PR_SET_PDEATHSIG = 1


def die_with_parent() -> None:
    """Have the kernel send this process SIGTERM when its parent dies; Linux only.

    In a child before it starts its program, or in a process that has just been adopted. Where it is stopped then, it
    hears of it all the same if it leads a group of its own in the session of its parent: the kernel lets the stopped
    members of a group continue when no process outside it can.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def begin_group() -> None:
    """Lead a group of its own, so that Ctrl-C in the terminal does not reach this process, and `die_with_parent`."""
    os.setpgid(0, 0)
    die_with_parent()
