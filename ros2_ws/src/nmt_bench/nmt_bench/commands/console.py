"""The console that every command prints to."""

from __future__ import annotations

import sys
from typing import TextIO

from rich.console import Console

_PLAIN_WIDTH = 160


def make_console(stream: TextIO | None = None) -> Console:
    """A console on a stream (None = standard output): brackets are text, and files stay plain and unwrapped."""
    stream = sys.stdout if stream is None else stream
    if stream.isatty():
        return Console(file=stream, markup=False, highlight=False)
    return Console(file=stream, markup=False, highlight=False, width=_PLAIN_WIDTH, no_color=True, force_terminal=False)
