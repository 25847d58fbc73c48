"""What the page shows of work that computes and measures nothing: a diagnosis, a study, a campaign; free of ROS.

News come as JSON objects, one a line; see :mod:`nmt_bench.page.task_feed`. What is not as expected is passed over. A
command that asks gets the answer of the page as a line, too.
"""

from __future__ import annotations

import json
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from nmt_bench.page.bench_link import ServiceAnswer
from nmt_bench.page.frames import write_frame
from nmt_report.quantity_format import duration

_MOST_STEPS = 300
_MOST_ROWS = 40
_LONGEST = 300  # characters of a text
_MOST_LINES, _MOST_POINTS = 6, 100
ANSWERS = ("yes", "no", "stop")
"""What a page may answer: do it, another one, end."""


@dataclass
class _Step:
    text: str
    began: float
    ended: float = math.nan


class TaskView:
    """Gathers what a task tells; safe to be fed in one thread and read in another.

    Args:
        clock: s, monotonic.
        answered: gets what a person answers; None = the command asks nothing.
    """

    FRAME_PERIOD = 0.5
    PAGE = "task.html"

    def __init__(
        self, clock: Callable[[], float] = time.monotonic, answered: Callable[[str], None] | None = None
    ) -> None:
        self._clock, self._answered = clock, answered
        self._lock = threading.RLock()
        self.version = 0
        """Counts what has changed."""
        self._title = ""
        self._began = clock()
        self._ended = math.nan
        self._outcome = ""
        self._steps: list[_Step] = []
        self._done = self._total = 0
        self._counting_since = self._began
        self._counted_from = 0
        self._heading: tuple[str, str] = ("", "")
        self._rows: list[tuple[str, str]] = []
        self._question = ""
        self._timeline: dict[str, list[list[float]]] = {}

    def take_line(self, line: bytes) -> None:
        """Take one line of the feed."""
        try:
            news = json.loads(line)
        except (ValueError, RecursionError):
            return
        if isinstance(news, dict):
            self.take(news)

    def take(self, news: dict[str, Any]) -> None:
        """Take news: ``title``, ``step``, ``done`` and ``total``, ``heading`` and ``rows``, ``timeline``, ``question``,
        ``outcome``.

        A question that is empty is one that was answered elsewhere. The timeline has points (time, probability) by
        name.
        """
        with self._lock:
            now = self._clock()
            self._title = _text(news.get("title")) or self._title
            step = _text(news.get("step"))
            if step and (not self._steps or step != self._steps[-1].text):
                if self._steps:
                    self._steps[-1].ended = now
                self._steps.append(_Step(step, now))
                del self._steps[:-_MOST_STEPS]
            self._count(news, now)
            rows, heading = news.get("rows"), news.get("heading")
            if isinstance(rows, list):
                pairs = [row for row in rows if isinstance(row, list) and len(row) == 2]
                self._rows = [(_text(a), _text(b)) for a, b in pairs[:_MOST_ROWS]]
            if isinstance(heading, list) and len(heading) == 2:
                self._heading = (_text(heading[0]), _text(heading[1]))
            if "question" in news:
                self._question = _text(news["question"])
            if isinstance(news.get("timeline"), dict):
                self._timeline = _lines(news["timeline"])
            outcome = _text(news.get("outcome"))
            if outcome:
                self._end(outcome, now)
            self.version += 1

    def end(self) -> None:
        """Nothing more will be told."""
        with self._lock:
            if math.isnan(self._ended):
                self._end("The command has ended; the terminal says what came of it.", self._clock())
                self.version += 1

    @property
    def asks(self) -> bool:
        """Whether the command takes answers."""
        return self._answered is not None

    def answer(self, word: Any) -> ServiceAnswer:
        """Take what a person answers: ``yes`` or ``no`` to what is asked now, ``stop`` at any time."""
        if word not in ANSWERS:
            return ServiceAnswer(False, f"An answer is one of {', '.join(ANSWERS)}")
        with self._lock:
            if self._answered is None or math.isfinite(self._ended):
                return ServiceAnswer(False, "Nothing is asked here")
            if not self._question and word != "stop":
                return ServiceAnswer(False, "Nothing is asked now; it was answered, or a test is under way")
            self._question = ""
            self.version += 1
            self._answered(word)
        return ServiceAnswer(True, {"yes": "It is run", "no": "Another one is looked for", "stop": "It ends"}[word])

    def _end(self, outcome: str, now: float) -> None:
        self._outcome, self._ended, self._question = outcome, now, ""
        if self._steps and math.isnan(self._steps[-1].ended):
            self._steps[-1].ended = now

    def _count(self, news: dict[str, Any], now: float) -> None:
        done, total = news.get("done"), news.get("total")
        if not isinstance(done, int) or not isinstance(total, int):
            return
        if total != self._total or done < self._done:
            self._counting_since, self._counted_from = now, done
        self._done, self._total = max(0, done), max(0, total)

    @property
    def _left(self) -> float:
        """s that the counted pieces may still take; NaN where nothing can be told."""
        new = self._done - self._counted_from
        if new <= 0 or not self._total or math.isfinite(self._ended):
            return math.nan
        return (self._clock() - self._counting_since) / new * (self._total - self._done)

    # -- frames --------------------------------------------------------------------------------------------------

    def newest_stretch(self) -> int:
        """There are no signals."""
        return -1

    def facts(self) -> bytes:
        """The frame of what stays."""
        with self._lock:
            steps = [
                {"text": step.text, "took": duration(step.ended - step.began) if math.isfinite(step.ended) else ""}
                for step in self._steps
            ]
            return write_frame(
                {
                    "kind": "task",
                    "title": self._title,
                    "steps": steps,
                    "heading": list(self._heading),
                    "rows": [list(row) for row in self._rows],
                    "question": self._question,
                    "asks": self.asks,
                    "timeline": self._timeline,
                    "outcome": self._outcome,
                },
                {},
            )

    def live(self, since: int, spectrum: bool = True) -> bytes:
        """The frame of what moves."""
        with self._lock:
            now = self._clock() if math.isnan(self._ended) else self._ended
            present = self._steps[-1] if self._steps and math.isnan(self._ended) else None
            return write_frame(
                {
                    "kind": "live",
                    "present": present.text if present else "",
                    "since": duration(now - present.began) if present else "—",
                    "elapsed": duration(now - self._began),
                    "left": duration(self._left) if math.isfinite(self._left) else "—",
                    "done": self._done,
                    "total": self._total,
                },
                {},
            )


def _text(value: Any) -> str:
    return value[:_LONGEST] if isinstance(value, str) else ""


def _lines(value: dict[Any, Any]) -> dict[str, list[list[float]]]:
    """Points by name, of those that are points: a time from 0 on, and a probability."""
    found: dict[str, list[list[float]]] = {}
    for name, points in list(value.items())[:_MOST_LINES]:
        if isinstance(points, list):
            found[_text(name)] = [
                [float(point[0]), float(point[1])]
                for point in points[:_MOST_POINTS]
                if isinstance(point, list) and len(point) == 2 and all(isinstance(v, int | float) for v in point)
                and 0.0 <= point[0] < math.inf and 0.0 <= point[1] <= 1.0
            ]  # fmt: skip
    return found
