"""Whether the program that started the nodes is stopped (Ctrl-Z, SIGSTOP), so that a run is unattended."""

from __future__ import annotations

import os
import time

from nmt_core.processes.process_watch import state_of

LAUNCHER = "NMT_LAUNCHER"
"""Environment variable in which the program that starts nodes gives them its process id."""

_LONGEST = 2.0  # s


class LauncherWatch:
    """Looks at the state of the process that started this one.

    Args:
        process: its id; None = what ``NMT_LAUNCHER`` says, if that is the parent of this process.
        longest: s for which it may be stopped.
    """

    def __init__(self, process: int | None = None, longest: float = _LONGEST) -> None:
        if process is None and os.environ.get(LAUNCHER, "") == str(os.getppid()):
            process = os.getppid()
        self.process, self._longest = process, longest
        self._since: float | None = None

    def complaint(self, now: float | None = None) -> str:
        """A sentence once the program has been stopped for too long; empty before, and where no program is known.

        Args:
            now: s of the steady clock; None = the present.
        """
        if self.process is None:
            return ""
        now = time.monotonic() if now is None else now
        if state_of(self.process) != "T":
            self._since = None
        elif self._since is None:
            self._since = now
        elif now - self._since > self._longest:
            return f"The program that started the nodes (process {self.process}) is stopped."
        return ""
