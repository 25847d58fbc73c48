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
    kept out of the fit; or that there is no gap, or that nothing in the library explains it."""

    model: str = needed_option(
        "name of a rig (for example beam), path of a rig file, or a robot's MJCF or URDF file", metavar="RIG"
    )
    real: tuple[Path, ...] = option(
        (),
        "results folder or bag of './nmt run', 'linear' or 'import' on the real rig; may be repeated: "
        "different "
        "tests tell more effects apart; of a robot: a log of its joints, or that log's sidecar; further logs test it",
        metavar="BAG",
    )
    group: Path | None = option(
        None,
        "in place of --real: CSV table of several units of one type, with the columns recording, unit, and mounting, "
        "day, repeat where they differ; each is diagnosed, then all together; of a robot beside --real: with the "
        "columns joint, unit and part, which joints are meant to be alike; several logs are its repeats",
        metavar="TABLE",
    )
    floor: tuple[Path, ...] = option(
        (),
        "repeat of a test among --real: what differs between the two no model can explain; may be repeated",
        metavar="BAG",
    )
    set: tuple[str, ...] = option(
        (), "change a value of the model before the diagnosis; may be repeated", metavar="KEY=VALUE"
    )
    without: tuple[str, ...] = option((), "leave an effect out of the library; may be repeated", metavar="EFFECT")
    hold_out: tuple[str, ...] = option(
        (),
        "keep a test (named as its folder) out of every fit and judge the gap by it alone; may be repeated "
        "(default: levels and whole tests in turn)",
        metavar="TEST",
    )
    out: Path = dated_folder_option("diagnosis.json, report.html, model.yaml, observables.csv", "diagnose")
    force: bool = replace_option()
    seed: int = option(0, "seed of the intervals (default: 0)", metavar="N")
    calibration: Path | None = option(
        None,
        "calibration file with uncertainties of the real sensors' sensitivities (default: what the bags say, "
        "else"
        " ordinary tolerances)",
        metavar="FILE",
    )
    allow_own_model: bool = option(
        False,
        "take recordings that were simulated from the model itself, too: they show what a rig without a gap looks like",
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
        "say why an explanation, such as cubic_stiffness@3, is stated or not, with the rule that decided; where a "
        "diagnosis stands in --out it is asked and nothing is computed; may be repeated",
        metavar="EFFECT@PLACE",
    )
    jobs: int | None = jobs_option()
    quiet: bool = option(False, "no progress display")


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
