"""What an investigation tells its page: news as JSON objects, one a line, over a pipe that is never waited for."""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from nmt_bench.page.page_process import page_process

_LONGEST_LINE = 4000  # bytes; a pipe takes so many at once or not at all
_MOST_ROWS = 12


class TaskFeed:
    """Tells the page; where it does not listen any more, or not fast enough, the news is lost.

    Args:
        pipe: file descriptor; negative: no page.
        answers: file descriptor of the page's answers, a word a line; negative: none is.
    """

    def __init__(self, pipe: int = -1, answers: int = -1) -> None:
        self._pipe, self.answers = pipe, answers
        if pipe >= 0:
            os.set_blocking(pipe, False)

    def tell(self, **news: Any) -> None:
        """Tell news; see :meth:`nmt_bench.page.task_view.TaskView.take`."""
        if self._pipe < 0:
            return
        line = json.dumps(news, ensure_ascii=False).encode() + b"\n"
        if len(line) <= _LONGEST_LINE:
            with contextlib.suppress(OSError):
                os.write(self._pipe, line)

    def step(self, sentence: str) -> None:
        """Tell what is being done."""
        self.tell(step=sentence)

    def table(self, heading: tuple[str, str], rows: Sequence[tuple[str, str]]) -> None:
        """Tell the results so far, the first ones only."""
        self.tell(heading=list(heading), rows=[[first[:120], second[:120]] for first, second in rows[:_MOST_ROWS]])


@contextlib.contextmanager
def task_page(wanted: bool, title: str, console: Any) -> Iterator[TaskFeed]:
    """The page of a command while it works, its address printed; without a page a feed that goes nowhere.

    Args:
        wanted: whether ``--page`` was given.
        title: of the page.
        console: gets the address.

    Raises:
        BenchError: the page does not come up.
    """
    if not wanted:
        yield TaskFeed()
        return
    with (
        tempfile.TemporaryDirectory(prefix="nmt-page-") as folder,
        page_process(Path(folder) / "page.log", ("--task",)) as page,
    ):
        for line in page.lines:
            console.print(line, soft_wrap=True)
        feed = TaskFeed(page.feed, page.answers)
        feed.tell(title=title)
        yield feed
