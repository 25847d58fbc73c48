"""Processes that another one has forked and that this one adopts when their parent ends."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

_PR_SET_CHILD_SUBREAPER, PR_GET_CHILD_SUBREAPER = 36, 37
_LONGEST_NAP = 0.05  # s
_ADOPTING = threading.Lock()


def can_adopt() -> bool:
    """Whether this system gives orphans to an ancestor that asks for them: Linux since 3.4, unless it is forbidden."""
    if sys.platform != "linux":
        return False
    try:
        with adopted_orphans():
            return True
    except OSError:
        return False


@contextlib.contextmanager
def adopted_orphans() -> Iterator[None]:
    """Become the parent of processes below this one whose parent ends meanwhile.

    One thread at a time does so; afterwards orphans go where they went before.

    Raises:
        OSError: the system does not allow it.
    """
    library = ctypes.CDLL(None, use_errno=True)
    before = ctypes.c_int(0)
    with _ADOPTING:
        if library.prctl(PR_GET_CHILD_SUBREAPER, ctypes.byref(before), 0, 0, 0) != 0:
            raise OSError(ctypes.get_errno(), "orphans cannot be adopted here")
        if library.prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0) != 0:
            raise OSError(ctypes.get_errno(), "orphans cannot be adopted here")
        try:
            yield
        finally:
            library.prctl(_PR_SET_CHILD_SUBREAPER, before.value, 0, 0, 0)


class AdoptedProcess:
    """A child that this process did not start itself, in the manner of :class:`subprocess.Popen`.

    Args:
        pid: its process id.

    Attributes:
        pid: its process id.
        returncode: exit code, minus the number of the signal that killed it, or None while it lives.

    Raises:
        ChildProcessError: it is not a child of this process.
    """

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.returncode: int | None = None
        os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)

    def poll(self) -> int | None:
        """The exit code if the process has ended, else None."""
        if self.returncode is None:
            try:
                found, status = os.waitpid(self.pid, os.WNOHANG)
            except ChildProcessError:  # somebody else in this program has waited for any child
                self.returncode = 0
                return self.returncode
            if found == self.pid:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end, at most ``timeout`` s.

        Returns:
            The exit code.

        Raises:
            subprocess.TimeoutExpired: it lives on.
        """
        end = None if timeout is None else time.monotonic() + timeout
        nap = 0.0005
        while (code := self.poll()) is None:
            left = _LONGEST_NAP if end is None else end - time.monotonic()
            if timeout is not None and left <= 0.0:
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout)
            nap = min(2.0 * nap, left, _LONGEST_NAP)
            time.sleep(nap)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal, unless the process has ended: its number may be another's then."""
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def kill(self) -> None:
        """Send SIGKILL."""
        self.send_signal(signal.SIGKILL)
