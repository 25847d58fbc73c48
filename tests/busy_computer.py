"""Tests on converters in real time, again where the computer was too busy for them.

A computer that stands still loses samples, whatever the program does: a virtual machine whose host is busy does so
for tens of milliseconds. `Standstills` is the witness, a process that only sleeps, at a higher priority than
everything of the bench. A test that lost samples while it saw several standstills is done again; where it sees them
every time the test shows nothing, and is skipped with what was seen.
"""

from __future__ import annotations

import functools
import os
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import pytest

ATTEMPTS = 3  # a busy computer loses samples of its own; such a test shows nothing
BUSY = "it loses samples again and again"
LOST = (BUSY, "had lost samples", "are missing from the window", "samples lost in")
LONG = 0.005  # s; half a period of the JACK servers of these tests
MANY = 10
_NAP = 0.002
_PRIORITY = 90


class Standstills:
    """Counts in a process of its own how often the computer stands still; a context manager.

    Attributes:
        late: s, of each wake-up that came later than `LONG`; set at the end.
    """

    def __init__(self) -> None:
        self.late: list[float] = []

    def __enter__(self) -> Standstills:
        self._process = subprocess.Popen(
            [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        said, _ = self._process.communicate()
        self.late = [float(word) for word in said.split()]

    @property
    def many(self) -> bool:
        """Whether they explain lost samples."""
        return len(self.late) >= MANY

    def __str__(self) -> str:
        worst = 1e3 * max(self.late, default=0.0)
        return f"stood still {len(self.late)} times for more than {1e3 * LONG:.0f} ms, {worst:.0f} ms at most"


def watch() -> None:
    """Print the standstills, s, when standard input ends."""
    with suppress(OSError):  # without the right to it, other programs count as well
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    os.set_blocking(sys.stdin.fileno(), False)
    late = []
    while sys.stdin.buffer.read(1) != b"":
        begun = time.monotonic()
        time.sleep(_NAP)
        late.append(time.monotonic() - begun - _NAP)
    print(*(f"{each:.6f}" for each in late if each > LONG))


def on_a_quiet_computer(environment: Callable[[Path], dict[str, str]]) -> Callable[[Any], Any]:
    """Do a test again, up to three times in all, where the computer was too busy for it.

    Args:
        environment: variables to set, by the folder of the attempt; that folder is the test's ``tmp_path``.
    """

    def repeated(test: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(test)
        def again(tmp_path: Path, **given: Any) -> None:
            for turn in range(1, ATTEMPTS + 1):
                folder = tmp_path / f"turn-{turn}"
                folder.mkdir()
                standstills = Standstills()
                try:
                    with standstills, pytest.MonkeyPatch.context() as patch:
                        for name, value in environment(folder).items():
                            patch.setenv(name, value)
                        return test(tmp_path=folder, **given)
                except Exception as error:
                    words = str(error)
                    excused = standstills.many and any(each in words for each in LOST)
                    if turn < ATTEMPTS and (excused or BUSY in words):
                        continue
                    if excused:
                        pytest.skip(f"samples were lost, and the computer {standstills}")
                    raise

        return again

    return repeated


if __name__ == "__main__":
    watch()
