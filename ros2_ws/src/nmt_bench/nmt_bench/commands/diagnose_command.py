"""``./nmt diagnose``: where the gap between a model and recordings of the real rig lies, and which effect causes it."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nmt_bench.command_parser import EXIT_DONE
from nmt_bench.commands.output_folder import OutputFolder, check_output
from nmt_bench.commands.shared_options import dated_folder_option, jobs_option, replace_option
from nmt_bench.commands.worker_count import worker_count
from nmt_core.errors import BenchError
from nmt_core.options import needed_option, option

if TYPE_CHECKING:
    from rich.console import Console

    from nmt_diagnose.ledger.diagnosis import Diagnosis


DIAGNOSIS = "diagnosis.json"


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


def run(options: DiagnoseOptions) -> int:
    """Diagnose, write the results, print the verdict.

    Returns:
        0 whatever the verdict is.

    Raises:
        BenchError: the rig, a bag or an option is refused.
    """
    from nmt_bench.commands.robot_diagnosis import diagnose_robot_log, is_robot

    if is_robot(options.model):
        return diagnose_robot_log(options)
    if bool(options.real) == (options.group is not None):
        raise BenchError("Give the recordings: --real BAG for one unit, or --group TABLE for several, not both.")
    if options.why and not options.force and (options.out / DIAGNOSIS).is_file():
        return _asked_again(options)
    check_output(options.out, options.force)
    if options.seed < 0:
        raise BenchError(f"--seed must not be negative, got {options.seed}.")
    jobs = worker_count(options)
    # Each process works on one core, and sums come out alike whatever their number: set before NumPy is imported.
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")

    from nmt_bench.commands.console import make_console
    from nmt_bench.commands.group_diagnosis import diagnose_group
    from nmt_bench.commands.requested_test import command_text
    from nmt_diagnose.diagnose import diagnose_bags
    from nmt_diagnose.diagnosis_settings import DiagnosisSettings
    from nmt_diagnose.effects.library import effect_named
    from nmt_record.exchange.sidecar.calibration_file import read_calibration
    from nmt_report.diagnosis_files import write_diagnosis
    from nmt_rig.rig import load_rig

    withheld = tuple(dict.fromkeys(name.strip().replace("-", "_").replace(" ", "_") for name in options.without))
    for name in withheld:
        try:
            effect_named(name)
        except BenchError as error:
            raise BenchError(f"--without: {error}") from error
    rig = load_rig(options.model, options.set, vibrating=False)
    calibration = None if options.calibration is None else read_calibration(options.calibration)
    console = make_console()
    started = time.monotonic()
    with DiagnosisProgress(console, options.quiet) as progress:
        held_out = tuple(dict.fromkeys(options.hold_out))
        settings = DiagnosisSettings(
            withheld=withheld,
            seed=options.seed,
            hold_out=held_out,
            jobs=jobs,
            allow_own_model=options.allow_own_model,
            calibration=calibration,
            matters=_matters(options.matters),
            command=command_text,
        )
        if options.group is not None:
            return diagnose_group(options, rig, settings, console, progress)
        outcome = diagnose_bags(rig, options.real, options.floor, settings, progress.update)
        progress.update("writing the report")
        with OutputFolder(options.out, options.force) as folder:
            remark = write_diagnosis(outcome, folder, options.model, options.set, options.floor)
    show(outcome.diagnosis, console)
    show_why(outcome.diagnosis.to_mapping(), options.why, console)
    if remark:
        console.print(remark, style="yellow", soft_wrap=True)
    new = "" if remark else f" New rig file: {options.out / 'model.yaml'}"
    console.print(f"Diagnosed in {time.monotonic() - started:.0f} s.{new}", soft_wrap=True)
    console.print(f"Report: {(options.out / 'report.html').resolve()}", soft_wrap=True)
    return EXIT_DONE


def _asked_again(options: DiagnoseOptions) -> int:
    """Answer ``--why`` from a diagnosis that stands in the folder."""
    import json

    from nmt_bench.commands.console import make_console

    path, console = options.out / DIAGNOSIS, make_console()
    try:
        written = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BenchError(f"{path} cannot be read: {error}.") from error
    if not isinstance(written, dict) or "ledger" not in written:
        raise BenchError(f"{path} has no ledger: it is of an earlier version; --force diagnoses again.")
    console.print(f"Of the diagnosis in {options.out}, which stands; --force diagnoses again.", soft_wrap=True)
    show_why(written, options.why, console)
    return EXIT_DONE


def show_why(written: Mapping[str, Any], words: Sequence[str], console: Console) -> None:
    """Print why explanations are stated or not, of a diagnosis as ``diagnosis.json`` has it."""
    from rich.text import Text

    from nmt_diagnose.ledger.why import why

    for word in words:
        first, *others = why(written["ledger"], word)
        console.print()
        console.print(Text(first, style="bold"), soft_wrap=True)
        for line in others:
            console.print(Text(line), soft_wrap=not console.is_terminal)


def _matters(words: Sequence[str]) -> dict[str, float]:
    """Smallest size that matters of each kind of observable."""
    from nmt_diagnose.diagnosis_settings import MATTERS

    found = dict(MATTERS)
    for word in words:
        kind, _, size = word.partition("=")
        try:
            value = float(size)
        except ValueError:
            value = -1.0
        if kind not in found or not 0.0 <= value < 1.0:
            kinds = ", ".join(MATTERS)
            raise BenchError(
                f"--matters is one of {kinds} and a relative size below 1, such as frequency=0.001; got {word}."
            )
        found[kind] = value
    return found


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


def show(diagnosis: Diagnosis, console: Console) -> None:
    """Print the verdict, the places, the ranking, what was re-fitted and the next test."""
    from rich.text import Text

    from nmt_report.diagnosis_tables import (
        calibration_table,
        next_table,
        place_table,
        ranking_table,
        recordings_table,
        visible_table,
    )
    from nmt_report.diagnosis_words import QUESTIONS, verdict_text

    text, kind = verdict_text(diagnosis)
    style = {"good": "bold green", "partly": "bold yellow", "bad": "bold red"}[kind]
    console.print()
    console.print(Text(f"Verdict: {text}", style=style), soft_wrap=True)
    questions = [*QUESTIONS, "What next"]
    for number, sentence in enumerate(diagnosis.sentences):
        question = questions[number] if number < len(questions) else ""
        console.print(Text.assemble((f"{question:<10}", "bold"), sentence), soft_wrap=not console.is_terminal)
    console.print()
    for table in (
        ranking_table(diagnosis), place_table(diagnosis), calibration_table(diagnosis), next_table(diagnosis),
        recordings_table(diagnosis), visible_table(diagnosis),
    ):  # fmt: skip
        if table is not None:
            console.print(table)
    for note in diagnosis.notes:
        console.print(Text(note, style="yellow"), soft_wrap=True)
