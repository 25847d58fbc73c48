"""A threshold of the diagnosis or of the loops at another value: in a test, or in a run of pytest (``-p``)."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from nmt_core.threshold import thresholds_of
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_pll.thresholds import THRESHOLDS as OF_LOOPS

ROOT = Path(__file__).resolve().parents[1]
MOVED = "NMT_MOVED_THRESHOLD"
"""Variable of the environment: dotted path, ``=`` and value; those of the loops begin with ``pll.``."""


def set_threshold(path: str, value: Any) -> Any:
    """Put a threshold, such as ``fits.most_steps``, to another value; gives the one before."""
    every = (*thresholds_of(THRESHOLDS), *thresholds_of(OF_LOOPS, "pll"))
    (record, name) = next((record, entry.name) for known, record, entry in every if known == path)
    before = getattr(record, name)
    object.__setattr__(record, name, value)
    return before


@contextmanager
def moved_threshold(path: str, value: Any) -> Iterator[None]:
    """A threshold at another value."""
    before = set_threshold(path, value)
    try:
        yield
    finally:
        set_threshold(path, before)


def moves(value: Any) -> list[Any]:
    """Values by which a threshold is moved: twice, half, ten times and a tenth; of whole numbers the next ones."""
    if isinstance(value, int):
        return [value // 2, 2 * value + 1, 8 * value]
    if isinstance(value, float):
        return [2.0 * value, 0.5 * value, 10.0 * value, 0.1 * value]
    return [tuple(2 * item for item in value), value[:1], tuple(type(item)(0.25 * item) for item in value)]


def notices(path: str, value: Any, node: str) -> bool:
    """Whether a test fails where a threshold has another value."""
    environment = {**os.environ, MOVED: f"{path}={value!r}"}
    command = [sys.executable, "-m", "pytest", "-p", "moved_threshold", "-p", "no:cacheprovider", "-q", "-x", node]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode in (0, 1), done.stdout + done.stderr
    return done.returncode == 1


def pytest_configure() -> None:
    """Move the threshold that the environment names."""
    path, _, value = os.environ.get(MOVED, "").partition("=")
    if path:
        set_threshold(path, ast.literal_eval(value))
