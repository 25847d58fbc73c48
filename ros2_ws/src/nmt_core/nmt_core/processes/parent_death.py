"""A process that ends when its parent does, whatever ended that."""

from __future__ import annotations

import ctypes
import os
import signal
import sys

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
