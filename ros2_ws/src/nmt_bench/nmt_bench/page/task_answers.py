"""What is answered on the page of a command that asks: heard in a thread, as long as the command goes on."""

from __future__ import annotations

import os
import queue
import select
import signal
import sys
import threading
from collections.abc import Callable

from nmt_bench.page.task_view import ANSWERS

_TURN = 0.2  # s between looks at the terminal


class TaskAnswers:
    """Answers of the page and of the terminal.

    A stop that comes while nothing is asked is as Ctrl-C.

    Args:
        pipe: file descriptor that the page's answers come from; negative: no page.
        interrupt: called with a stop that comes while nothing is asked.
    """

    def __init__(
        self, pipe: int = -1, interrupt: Callable[[], None] = lambda: os.kill(os.getpid(), signal.SIGINT)
    ) -> None:
        self._words: queue.Queue[str] = queue.Queue()
        self._asking = threading.Event()
        self._interrupt = interrupt
        self._has_page = pipe >= 0
        self._typed = b""
        if self._has_page:
            threading.Thread(target=self._listen, args=(pipe,), name="answers", daemon=True).start()

    def _listen(self, pipe: int) -> None:
        left = b""
        try:
            while part := os.read(pipe, 256):
                *lines, left = (left + part).split(b"\n")
                for line in lines:
                    word = line.decode(errors="replace").strip()
                    if self._asking.is_set():
                        self._words.put(word)
                    elif word == "stop":
                        self._interrupt()
        except OSError:
            return  # the page has ended

    def _read(self) -> bool:
        """Take what was typed, past the buffer that hides lines from a look at the terminal; whether there was any."""
        part = os.read(sys.stdin.fileno(), 4096)
        self._typed += part
        return bool(part)

    def wait(self, prompt: str) -> str:
        """The first answer, ``yes``, ``no`` or ``stop``; ``stop`` without a reader."""
        self._asking.set()
        terminal, wait = True, _TURN if self._has_page else None
        sys.stdout.write(prompt)
        sys.stdout.flush()
        try:
            while True:
                try:
                    return self._words.get(timeout=0.0 if terminal else _TURN)
                except queue.Empty:
                    pass
                if terminal and (b"\n" in self._typed or select.select([sys.stdin], [], [], wait)[0]):
                    terminal = b"\n" in self._typed or self._read()
                    line, _, self._typed = self._typed.partition(b"\n")
                    word = line.decode(errors="replace").strip().lower()
                    for answer in ANSWERS:
                        if word and answer.startswith(word):
                            return answer
                    if terminal:
                        sys.stdout.write(prompt)
                        sys.stdout.flush()
                if not terminal and not self._has_page:
                    return "stop"
        finally:
            self._asking.clear()
