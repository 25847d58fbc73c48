"""The line on the terminal that says how far a step is."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable


def clock(seconds: float) -> str:
    """Minutes and seconds."""
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


class Progress:
    """One line per step with the elapsed time: rewritten in place on a terminal, else repeated at times.

    Args:
        number, total: place of the step among those to be done.
        title: what is done.
        left: says after so many seconds what is left of all; empty = nothing is known.
    """

    EVERY = 20.0  # seconds between lines where nothing can be rewritten

    def __init__(self, number: int, total: int, title: str, left: Callable[[float], str] = lambda _: "") -> None:
        self.left = left
        self.title = f"[{number}/{total}] {title}"
        self.started = self.last = time.monotonic()
        self.terminal = sys.stderr.isatty()
        self.show("", force=True)

    def show(self, detail: str, force: bool = False, end: str = "\n") -> None:
        """Show how far the step is."""
        now = time.monotonic()
        if detail != "done":
            detail = "   ".join(filter(None, (detail, self.left(now - self.started))))
        if self.terminal:
            width = shutil.get_terminal_size().columns
            line = f"{self.title:<32} {clock(now - self.started)}  {detail}"[: width - 1]
            sys.stderr.write("\r\033[K" + line + (end if detail == "done" else ""))
        elif force or now - self.last > self.EVERY:
            self.last = now
            sys.stderr.write(f"{self.title:<32} {clock(now - self.started)}  {detail}".rstrip() + "\n")
        sys.stderr.flush()

    def done(self) -> None:
        """End the step's line."""
        self.show("done", force=True)

    def break_line(self) -> None:
        """Leave an unfinished line as it stands."""
        if self.terminal:
            sys.stderr.write("\n")
