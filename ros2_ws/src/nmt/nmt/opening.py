"""Opens a results folder as the object that suits what is in it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from nmt.results import DiagnosisResult, FrequencyResponses, LinearResult, ReferenceResult, Results, RunResults
from nmt_core.errors import BenchError

_KINDS: tuple[tuple[str, Callable[[Path], Results]], ...] = (
    ("modal.json", RunResults.read),
    ("linear.json", LinearResult.read),
    ("diagnosis.json", DiagnosisResult.read),
    ("reference.csv", ReferenceResult.read),
    ("frf.csv", FrequencyResponses.read),
)
"""What a folder is, by the first of these files that it has. A linear test has frf.csv too."""


def open(folder: Path | str) -> Results:
    """The results of a command as an object.

    Args:
        folder: what a command was given as ``--out``: of a run, an extraction, a linear test, a sweep, a reference or
            a diagnosis. A file in it does as well.

    Returns:
        One of the classes of :mod:`nmt.results`; frozen, with ``to_dataframe``, ``to_xarray`` and ``plot``.

    Raises:
        BenchError: there are no results that it knows, or they are damaged.

    Examples:
        >>> run = nmt.open("out/demo")
        >>> run
        RunResults('out/demo': 2 of 2 levels with values)
        >>> run.values("damping_ratio").round(4)
        array([0.0051, 0.0538])
        >>> nmt.open("out/empty")
        Traceback (most recent call last):
        nmt_core.errors.BenchError: out/empty holds no results that can be opened; it needs one of modal.json, ...
    """
    path = Path(folder)
    if path.is_file():
        path = path.parent
    for name, read in _KINDS:
        if (path / name).is_file():
            return read(path)
    known = ", ".join(name for name, _ in _KINDS)
    raise BenchError(f"{folder} holds no results that can be opened; it needs one of {known}.")
