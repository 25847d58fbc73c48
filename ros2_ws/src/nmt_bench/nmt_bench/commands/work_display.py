"""Progress of a command that computes: what it does, how much of it is done and the time left."""

from __future__ import annotations

import time
from contextlib import ExitStack
from typing import TYPE_CHECKING

from nmt_core.processes.work_progress import listening, tell

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

_BETWEEN_LINES = 10.0


class WorkDisplay:
    """One line that changes on a terminal and goes at the end; elsewhere a line every ten seconds.

    Args:
        console: where to show it. Nothing else may print there while the display is open.
        steps: sentences of the steps, in their order; :meth:`step` goes on to the next.
        quiet: show nothing.

    Use as a context manager around the work; the console is free again after it.
    """

    def __init__(self, console: Console, steps: tuple[str, ...] = (), quiet: bool = False) -> None:
        self._console, self._steps, self._quiet = console, steps, quiet
        self._number = 0
        self._stack = ExitStack()
        self.bar: Progress | None = None
        self._starts: dict[str, float] = {}
        self._now = self._before = ("", 0, 0)
        self._began = self._said = time.monotonic()

    def __enter__(self) -> WorkDisplay:
        self._stack.enter_context(listening(self._on_progress))
        if self._steps:
            self.step()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()
        if self.bar is not None:
            self.bar.stop()

    def step(self) -> None:
        """Go on to the next step."""
        what = self._steps[min(self._number, len(self._steps) - 1)]
        self._number += 1
        tell(what)

    def _on_progress(self, what: str, done: int, total: int) -> None:
        if 0 < total <= done and self._before[0]:
            what, done, total = self._before  # what is done gives way to the work that it was part of
        if what != self._now[0]:
            self._before = self._now
        self._began = self._starts.setdefault(what, time.monotonic())
        self._now = what, done, total
        if self._quiet:
            return
        sentence = self._sentence(what, done, total)
        if self._console.is_terminal:
            self._show(sentence, done, total)
        elif time.monotonic() - self._said > _BETWEEN_LINES:
            self._said = time.monotonic()
            self._console.print(sentence, markup=False, soft_wrap=True)

    def _sentence(self, what: str, done: int, total: int) -> str:
        place = f"step {self._number} of {len(self._steps)}: " if len(self._steps) > 1 else ""
        count = f", {done} of {total}" if total else ""
        return f"{place}{what}{count}{self._left(done, total)}"

    def _left(self, done: int, total: int) -> str:
        elapsed = time.monotonic() - self._began
        if not 0 < done < total or elapsed < 0.5:
            return ""
        from nmt_report.quantity_format import duration

        return f"; about {duration(elapsed / done * (total - done))} left"

    def _show(self, sentence: str, done: int, total: int) -> None:
        from rich.markup import escape

        if self.bar is None:
            from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

            self.bar = Progress(
                SpinnerColumn(), TimeElapsedColumn(), BarColumn(bar_width=16), TextColumn("{task.description}"),
                console=self._console, transient=True,
            )  # fmt: skip
            self.bar.add_task("", total=None)
            self.bar.start()
        self.bar.update(self.bar.task_ids[0], description=escape(sentence), completed=done, total=total or None)
