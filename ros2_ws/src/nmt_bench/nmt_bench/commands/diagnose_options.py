"""Options of ``./nmt diagnose``, and how far it is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nmt_bench.commands.shared_options import dated_folder_option, jobs_option, replace_option
from nmt_core.options import needed_option, option

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True, kw_only=True)
class DiagnoseOptions:
    """Compares a rig file with recordings of the real rig: re-fits the model's own parameters, weighs every effect of
    the library at every place, and says where the gap lies, which effect causes it and how far it shrinks on data
    kept out of the fit; or that no gap exists, or that nothing in the library explains it."""

    model: str = needed_option(
        "name of a rig (for example beam), path of a rig file, or a robot's MJCF or URDF file", metavar="RIG"
    )
    real: tuple[Path, ...] = option(
        (),
        "results folder or bag of './nmt run', 'linear' or 'import' on the real rig; of a robot a log of its joints "
        "or its sidecar; may be repeated: different tests separate more effects, further logs test the answer",
        metavar="BAG",
    )
    group: Path | None = option(
        None,
        "instead of --real: CSV table of several units of one type (recording, unit; mounting, day, repeat if they "
        "differ); with --real of a robot: table of alike joints (joint, unit, part)",
        metavar="TABLE",
    )
    floor: tuple[Path, ...] = option(
        (),
        "repeat of a test among --real, for the scatter between tests; may be repeated",
        metavar="BAG",
    )
    set: tuple[str, ...] = option(
        (), "change a value of the model before the diagnosis; may be repeated", metavar="KEY=VALUE"
    )
    without: tuple[str, ...] = option((), "leave an effect out of the library; may be repeated", metavar="EFFECT")
    hold_out: tuple[str, ...] = option(
        (),
        "test (named as its folder) that no fit uses and that alone judges the gap; may be repeated (default: "
        "levels and whole tests in turn)",
        metavar="TEST",
    )
    out: Path = dated_folder_option("diagnosis.json, report.html, model.yaml, observables.csv", "diagnose")
    force: bool = replace_option()
    seed: int = option(0, "seed of the intervals (default: 0)", metavar="N")
    calibration: Path | None = option(
        None,
        "calibration file of the real sensors (default: that of the bags, else ordinary tolerances)",
        metavar="FILE",
    )
    allow_own_model: bool = option(
        False,
        "accept recordings simulated from the model itself, which have no gap",
    )
    matters: tuple[str, ...] = option(
        (),
        "smallest relative size of a gap that matters, of frequency (default: 0.0005), damping (0.02), "
        "response "
        "(0.02) or harmonics over the fundamental (0.001); may be repeated",
        metavar="KIND=SIZE",
    )
    why: tuple[str, ...] = option(
        (),
        "rule that reported an explanation, such as cubic_stiffness@3, or not; asks the diagnosis in --out if there "
        "is one; may be repeated",
        metavar="EFFECT@PLACE",
    )
    jobs: int | None = jobs_option()
    quiet: bool = option(False, "no progress display")
    verbose: bool = option(False, "all tables and notes of the report in the terminal, too")


class DiagnosisProgress:
    """What is being done: one line that changes on a terminal, plain lines elsewhere.

    Args:
        console: where to show it.
        quiet: show nothing.
    """

    def __init__(self, console: Console, quiet: bool = False) -> None:
        from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        self._console, self._quiet = console, quiet
        self._live = console.is_terminal and not quiet
        self._progress = Progress(
            SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn(), console=console, transient=True,
            disable=not self._live,
        )  # fmt: skip
        self._task = self._progress.add_task("starting", total=None)

    def __enter__(self) -> DiagnosisProgress:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def update(self, sentence: str) -> None:
        """Show what is being done now."""
        from rich.markup import escape

        if self._live:
            self._progress.update(self._task, description=escape(sentence))
        elif not self._quiet:
            self._console.print(sentence, soft_wrap=True)
