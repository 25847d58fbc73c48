"""Runs the programs of a step: output into a log, progress on the terminal, plain words on failure."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
from collections.abc import Callable

from .places import ROOT, STATE_FOLDER, SetupError
from .progress import Progress

EXPLANATIONS = (
    (
        r"No space left on device|Errno 28|Disk quota exceeded",
        "the disk is full: make room and type the command again",
    ),
    (
        r"DO NOT MATCH THE HASHES",
        "a downloaded file differs from the locked one, it was cut or altered on its way: type the "
        "command again, and if that does not help use another index (PIP_INDEX_URL)",
    ),
    (
        r"NewConnectionError|Name or service not known|name resolution|Connection refused|Connection broken"
        r"|Network is unreachable|ProxyError|ConnectTimeout|ReadTimeout|timed out|RemoteDisconnected"
        r"|SSLError|CERTIFICATE_VERIFY_FAILED",
        "the Python package index cannot be reached: check the network (behind a proxy set HTTPS_PROXY, "
        "for a mirror PIP_INDEX_URL) and type the command again; what was downloaded is kept",
    ),
    (
        r"No matching distribution found",
        "the package index in use does not offer a locked file: check PIP_INDEX_URL and PIP_NO_INDEX",
    ),
    (
        r"ensurepip.*non-zero|No module named '?(ensurepip|venv)",
        "Python's venv module is not complete: install it (Debian, Ubuntu: 'sudo apt install python3-venv')",
    ),
    (
        r"No CMAKE_CXX?_COMPILER could be found|is not able to compile a simple test program",
        "the C++ compiler does not work: reinstall it (Debian, Ubuntu: 'sudo apt install g++')",
    ),
    (r"Permission denied|Read-only file system", "a file cannot be written: see that this folder is yours"),
)


class StepRunner:
    """Runs the programs of one step: output into a log, progress on the terminal, plain words on failure."""

    def __init__(self, step: str, progress: Progress | None, guard: int) -> None:
        self.step, self.progress, self.guard = step, progress, guard
        self.log = os.path.join(STATE_FOLDER, "log", step + ".log")
        os.makedirs(os.path.dirname(self.log), exist_ok=True)
        with open(self.log, "wb"):
            pass

    def text(self) -> str:
        """The log so far."""
        with open(self.log, errors="replace") as file:
            return file.read()

    def start(self, command: list[str], environment: dict[str, str], cwd: str = ROOT) -> subprocess.Popen[bytes]:
        """Start a program that writes to the log; returns it.

        The program holds the set-up's lock too: if this process is killed, the next set-up waits for it.

        Args:
            command: program and arguments.
            environment: its environment.
            cwd: its folder.
        """
        with open(self.log, "ab") as log:
            log.write(("$ " + " ".join(command) + "\n").encode())
            log.flush()
            return subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=environment,
                cwd=cwd,
                start_new_session=True,
                pass_fds=(self.guard,),
            )

    def finish(
        self, process: subprocess.Popen[bytes], detail: Callable[[], str] | None = None, may_fail: bool = False
    ) -> bool:
        """Wait for a started program and show how far it is; end it if this is interrupted.

        Args:
            process: the program.
            detail: function that says how far it is.
            may_fail: return False instead of raising.

        Raises:
            SetupError: the program failed.
        """
        try:
            while process.poll() is None:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(0.2)
                if self.progress:
                    self.progress.show(detail() if detail else "")
        except BaseException:
            end_group(process)
            raise
        if process.returncode == 0 or may_fail:
            return process.returncode == 0
        raise self.explain(process.returncode)

    def run(
        self,
        command: list[str],
        environment: dict[str, str],
        detail: Callable[[], str] | None = None,
        cwd: str = ROOT,
        may_fail: bool = False,
    ) -> bool:
        """Run a program to its end: :meth:`start` and :meth:`finish`.

        Raises:
            SetupError: the program failed.
        """
        return self.finish(self.start(command, environment, cwd), detail, may_fail)

    def explain(self, code: int) -> SetupError:
        """Why a program failed, from its log."""
        text = self.text()
        shown = os.path.relpath(self.log, ROOT)
        for pattern, reason in EXPLANATIONS:
            if re.search(pattern, text):
                return SetupError(f"The set-up stopped at '{self.step}': {reason} (all of it: {shown}).")
        tail = "\n".join("    " + line for line in text.strip().splitlines()[-15:])
        why = f"was ended by signal {-code}" if code < 0 else f"failed with code {code}"
        return SetupError(
            f"The set-up stopped at '{self.step}': the program {why}; its last lines were\n{tail}\nAll of it: {shown}."
        )


def end_group(process: subprocess.Popen[bytes]) -> None:
    """End a program and all it started: ask, wait, then insist."""
    for wanted, patience in ((signal.SIGINT, 3.0), (signal.SIGTERM, 2.0), (signal.SIGKILL, 5.0)):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, wanted)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(patience)
            break
    with contextlib.suppress(ProcessLookupError):  # grandchildren that outlived it
        os.killpg(process.pid, signal.SIGKILL)
