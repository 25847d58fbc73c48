"""What the page shows of an investigation, which asks before it tests; free of ROS.

News come as JSON objects, one a line; see :mod:`nmt_bench.page.task_feed`. What is not as expected is passed over. The
command gets the answer of the page as a line, too.
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
        answered: gets what a person answers.
    """

    FRAME_PERIOD = 0.5
    PAGE = "task.html"

    def __init__(self, answered: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._answered = clock, answered
        self._lock = threading.RLock()
        self.version = 0
        """Counts what has changed."""
        self._title = ""
        self._began = clock()
        self._ended = math.nan
        self._outcome = ""
        self._steps: list[_Step] = []
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
        """Take news: ``title``, ``step``, ``heading`` and ``rows``, ``timeline``, ``question``, ``outcome``.

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

    def answer(self, word: Any) -> ServiceAnswer:
        """Take what a person answers: ``yes`` or ``no`` to what is asked now, ``stop`` at any time."""
        if word not in ANSWERS:
            return ServiceAnswer(False, f"An answer is one of {', '.join(ANSWERS)}")
        with self._lock:
            if math.isfinite(self._ended):
                return ServiceAnswer(False, "Nothing is asked here")
            if not self._question and word != "stop":
                return ServiceAnswer(False, "Nothing is asked now; it was answered, or a test is under way")
            self._question = ""
            self.version += 1
            self._answered(word)
        return ServiceAnswer(
            True, {"yes": "It is run", "no": "The bench searches another one", "stop": "It ends"}[word]
        )

    def _end(self, outcome: str, now: float) -> None:
        self._outcome, self._ended, self._question = outcome, now, ""
        if self._steps and math.isnan(self._steps[-1].ended):
            self._steps[-1].ended = now

    # -- frames --------------------------------------------------------------------------------------------------

    def newest_stretch(self) -> int:
        """There are no signals."""
        return -1

    def facts(self) -> bytes:
        """The frame of lasting content."""
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
                    "timeline": self._timeline,
                    "outcome": self._outcome,
                },
                {},
            )

    def live(self, since: int, spectrum: bool = True) -> bytes:
        """The frame of changing content."""
        with self._lock:
            now = self._clock() if math.isnan(self._ended) else self._ended
            present = self._steps[-1] if self._steps and math.isnan(self._ended) else None
            return write_frame(
                {
                    "kind": "live",
                    "present": present.text if present else "",
                    "since": duration(now - present.began) if present else "—",
                    "elapsed": duration(now - self._began),
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
