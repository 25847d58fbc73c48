"""Progress of a run in the terminal, from the feedback of the action ``run_levels``."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeElapsedColumn
from rich.table import Column
from rich.text import Text

from nmt_bench.commands.console import make_console
from nmt_core.vocabulary import LoopState
from nmt_report.columns import unit_text
from nmt_report.quantity_format import duration, plain, significant
from nmt_session.run_result import Progress as RunState

_STATES = {
    LoopState.UNKNOWN: ("waiting", "dim"),
    LoopState.FIXED: ("fixed", "dim"),
    LoopState.ACQUIRING: ("acquiring", "yellow"),
    LoopState.LOCKED: ("locked", "green"),
    LoopState.LOCK_LOST: ("lock lost", "red"),
}


class RunProgress:
    """Progress of a run from the feedback of the action ``run_levels``.

    On a terminal one line is kept up to date below a line for each level that is over; elsewhere only plain
    lines are written, one for each change of level or state.

    Args:
        sample_rate: Hz.
        levels: number of levels of the plan.
        unit: unit of the levels.
        console: where to show it; None = standard output.

    Use as a context manager and call :meth:`update` with each feedback.
    """

    def __init__(self, sample_rate: float, levels: int, unit: str = "V", console: Console | None = None) -> None:
        self._rate = sample_rate
        self._levels = levels
        self._unit = unit_text(unit)
        self._console = console or make_console()
        self._live = self._console.is_terminal
        self._started = math.nan
        self._seen: tuple[int, LoopState] | None = None
        self._progress = Progress(
            TextColumn("{task.description}", table_column=Column(no_wrap=True)),
            BarColumn(bar_width=16),
            TextColumn("{task.percentage:3.0f} %"),
            _StateColumn(table_column=Column(no_wrap=True)),
            TimeElapsedColumn(),
            console=self._console,
            transient=True,
            disable=not self._live,
        )
        self._task = self._progress.add_task("starting", total=1.0, state=LoopState.UNKNOWN, detail="")

    def __enter__(self) -> RunProgress:
        self._started = time.monotonic()
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def note(self, sentence: str) -> None:
        """Print a line above the progress display."""
        self._progress.console.print(Text(sentence)) if self._live else self._console.print(Text(sentence))

    def update(self, feedback: object) -> None:
        """Show a feedback.

        Args:
            feedback: anything with the fields of `Progress` as attributes or keys; missing ones are left out.
        """
        if not isinstance(feedback, Mapping):
            names = [item.name for item in fields(RunState)]
            feedback = {name: getattr(feedback, name) for name in names if hasattr(feedback, name)}
        index = int(feedback.get("level_index", 0))
        count = int(feedback.get("level_count", 0)) or self._levels
        state = _state(feedback.get("state", 0))
        level = float(feedback.get("level", math.nan))
        fraction = min(1.0, max(0.0, float(feedback.get("fraction_done", 0.0))))
        name = f"level {index + 1}/{count}  {significant(level)} {self._unit}"
        detail = self._detail(feedback)
        if self._live:
            brief = self._detail(feedback, brief=True)
            self._progress.update(self._task, description=name, completed=fraction, state=state, detail=brief)
        if self._seen != (index, state):
            settled = state in (LoopState.LOCKED, LoopState.LOCK_LOST)
            # Between levels and after the last one the loop rests, which is not news.
            resting = state is LoopState.FIXED and self._seen is not None
            # On a terminal the bar shows the rest; what a level came to stays as a line.
            if settled or not (self._live or resting):
                self._line(name, state, detail)
            self._seen = (index, state)

    def _line(self, name: str, state: LoopState, detail: str) -> None:
        word, style = _STATES[state]
        self._progress.console.print(Text.assemble(f"{name:<26}", (f"{word:<10}", style), detail))

    def _detail(self, feedback: Mapping[str, Any], brief: bool = False) -> str:
        parts = []
        frequency = float(feedback.get("frequency_hz", math.nan))
        if math.isfinite(frequency) and frequency > 0.0:
            parts.append(f"{frequency:8.4f} Hz")
        error = float(feedback.get("phase_error", math.nan))
        if math.isfinite(error):
            parts.append(f"{'' if brief else 'phase error '}{plain(math.degrees(error), 2):>7}°")
        sample = int(feedback.get("sample", 0))
        if sample > 0:
            bench = sample / self._rate
            elapsed = time.monotonic() - self._started
            speed = f" ({bench / elapsed:.0f} ×{'' if brief else ' real time'})" if elapsed > 0.5 else ""
            parts.append(f"{'' if brief else 'bench time '}{duration(bench)}{speed}")
        return "  ".join(parts)


class _StateColumn(ProgressColumn):
    """State of the loop in its colour, then frequency, phase error and bench time."""

    def render(self, task: Task) -> Text:
        word, style = _STATES[task.fields["state"]]
        return Text.assemble((f"{word:<10}", style), task.fields["detail"])


def _state(value: Any) -> LoopState:
    try:
        return LoopState(int(value))
    except ValueError:
        return LoopState.UNKNOWN
