"""Reading in a process of its own: what takes memory or time for whatever a file claims runs with limits on both.

The child is a module run with ``python -m``; it calls :func:`limit` first, and what is wrong is the last line of its
traceback.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any


class ChildError(Exception):
    """A child ended without an answer.

    Attributes:
        kind: name of the exception that ended it; empty = a signal, or the time was over.
        why: its words.
    """

    def __init__(self, kind: str, why: str) -> None:
        super().__init__(why)
        self.kind, self.why = kind, why

    @property
    def is_memory(self) -> bool:
        """Whether it needed more memory than it may have."""
        return self.kind.endswith("MemoryError") or "allocate" in self.why


def run_limited(
    module: str,
    arguments: Sequence[str],
    seconds: int,
    source: IO[bytes] | bytes,
    target: Any = None,
    folder: Path | None = None,
) -> None:
    """Run a module in a child.

    Args:
        module: its name.
        arguments: of the child.
        seconds: that it may take.
        source: what it reads from its standard input: an open file, or bytes.
        target: where its standard output goes; None = nowhere.
        folder: in which it works; None = here.

    Raises:
        ChildError: it ended with an error, by a signal, or took too long.
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(str(Path(part).absolute()) for part in sys.path)}
    content: dict[str, Any] = {"input": source} if isinstance(source, bytes) else {"stdin": source}
    try:
        child: subprocess.CompletedProcess[bytes] = subprocess.run(
            [sys.executable, "-m", module, *arguments],
            stdout=subprocess.DEVNULL if target is None else target, stderr=subprocess.PIPE, timeout=seconds,
            cwd=folder, env=environment, **content,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise ChildError("", f"reading it takes more than {seconds} s") from None
    if child.returncode:
        lines = child.stderr.decode("utf-8", "replace").strip().splitlines() or [""]
        kind, _, why = lines[-1].partition(": ")
        raise ChildError(kind, why or "its reader ended")


def limit(largest: int, seconds: int) -> None:
    """Let this process take no more than ``largest`` bytes twice above what it has, and no more time."""
    with open("/proc/self/statm") as file:
        taken = int(file.read().split()[0]) * resource.getpagesize()
    for kind, most in ((resource.RLIMIT_AS, taken + 2 * largest + 2**28), (resource.RLIMIT_CPU, seconds)):
        _, hard = resource.getrlimit(kind)
        resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard),) * 2)
