"""The page as a child process of a command that runs a test; free of ROS."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from nmt_core.errors import BenchError
from nmt_core.processes.process_end import die_with_parent

_START_TIMEOUT = 60.0  # s
_GRACE = 3.0  # s


@dataclass(frozen=True)
class ServedPage:
    """A page that is being served: its process, the lines that tell its addresses, and the pipes that it reads and
    writes."""

    pid: int
    lines: tuple[str, ...]
    feed: int
    answers: int


@contextlib.contextmanager
def page_process(log: Path, arguments: tuple[str, ...] = ()) -> Iterator[ServedPage]:
    """Serve the page while a test runs; what becomes of the page does not concern the test.

    Args:
        log: file that gets what the page complains about.
        arguments: of ``./nmt page``.

    Yields:
        The page.

    Raises:
        BenchError: the page does not come up.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    with open(log, "wb") as complaints:
        process = subprocess.Popen(
            [sys.executable, "-m", "nmt_bench", "page", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=complaints,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            start_new_session=True,
            preexec_fn=die_with_parent,
        )
    try:
        assert process.stdin is not None
        assert process.stdout is not None
        addresses = tuple(_addresses(process, log))
        yield ServedPage(process.pid, addresses, process.stdin.fileno(), process.stdout.fileno())
    finally:
        process.terminate()
        process.send_signal(signal.SIGCONT)  # one that was stopped could not hear
        try:
            process.wait(_GRACE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        for pipe in (process.stdin, process.stdout):
            assert pipe is not None
            pipe.close()


def _addresses(process: subprocess.Popen[bytes], log: Path) -> list[str]:
    assert process.stdout is not None
    end = time.monotonic() + _START_TIMEOUT
    told = b""
    while told.count(b"\n") < 2:  # to steer and to watch
        ready, _, _ = select.select([process.stdout], [], [], max(0.0, end - time.monotonic()))
        part = os.read(process.stdout.fileno(), 4096) if ready else b""
        if not part:
            raise BenchError(f"The page did not come up; {log} may say why, or run without --page.")
        told += part
    return told.decode().splitlines()
