"""The end of a process that has done its work."""

from __future__ import annotations

import atexit
import contextlib
import os
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
