"""Opens a results folder as the object that suits what is in it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from nmt.reference_result import ReferenceResult
from nmt.results import DiagnosisResult, FrequencyResponses, LinearResult, Results, RunResults
from nmt.table_result import TABLES, TableResult
from nmt_core.errors import BenchError
from nmt_core.kinds import kind_class
from nmt_core.messages.driven_test import DrivenTest

KINDS_OF_RESULTS: tuple[tuple[str, Callable[[Path], Results]], ...] = (
    ("modal.json", RunResults.read),
    ("linear.json", LinearResult.read),
    *((name, TableResult.read) for name in TABLES),
    ("diagnosis.json", DiagnosisResult.read),
    ("reference.csv", ReferenceResult.read),
    ("frf.csv", FrequencyResponses.read),
)
"""What a folder is, by the first of these files that it has. A linear test has frf.csv, too, and the diagnosis of a
robot diagnosis.json."""
_WITHOUT_TABLE = (
    ("sidecar.yaml", "holds an export; nmt.import_data reads its sidecar.yaml back into a bag"),
    ("check.json", "holds a check, whose findings are sentences; read check.json or report.html"),
    ("bag", "holds a recording without results; nmt.Bag.open reads it, nmt.extract or nmt.linear evaluates it"),
)
"""What folders of other commands hold, and what reads it."""


def covers(test: DrivenTest) -> str:
    """Why the folder of a test that was run has no results to open, and what writes some; empty = it has."""
    kind = kind_class(test.kind)
    if kind.gives_modal_points:
        return ""
    writer = "'./nmt sweep' writes frf.csv where it measures"
    if kind.is_broad_band:
        writer = "'./nmt linear --bag' writes linear.json and frf.csv"
    elif kind.closes_phase_loop:
        writer = "'./nmt extract' writes decay.csv"
    return f"The folder of a {kind.words()} test holds its recording alone; {writer}, which nmt.open reads."


def open(folder: Path | str) -> Results:
    """The results of a command as an object.

    Args:
        folder: what a command was given as ``--out``: of a run, an extraction, a linear test, a sweep, a reference, a
            synthesis, a study or a diagnosis. A file in it does as well.

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
    for name, read in KINDS_OF_RESULTS:
        if (path / name).is_file():
            return read(path)
    if (path / "bag").exists():
        from nmt_record.bag.bag_reader import Bag

        refusal = covers(DrivenTest.of_run(Bag.open(path / "bag").run_start, None))
        if refusal:
            raise BenchError(f"{folder}: {refusal}")
    for name, sentence in _WITHOUT_TABLE:
        if (path / name).exists():
            raise BenchError(f"{folder} {sentence}.")
    known = ", ".join(name for name, _ in KINDS_OF_RESULTS)
    raise BenchError(f"{folder} holds no results that can be opened; it needs one of {known}.")
