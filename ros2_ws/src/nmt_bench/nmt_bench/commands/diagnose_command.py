"""``./nmt diagnose``: where the gap between a model and recordings of the real rig lies, and which effect causes it."""

from __future__ import annotations

import json
import os
import re
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nmt_bench.command_parser import EXIT_DONE
from nmt_bench.commands.diagnose_options import DiagnoseOptions, DiagnosisProgress
from nmt_bench.commands.output_folder import OutputFolder, check_output
from nmt_bench.commands.worker_count import worker_count
from nmt_core.errors import BenchError

if TYPE_CHECKING:
    from rich.console import Console

    from nmt_diagnose.diagnosis_settings import DiagnosisSettings
    from nmt_diagnose.ledger.diagnosis import Diagnosis
    from nmt_rig.rig import Rig

DIAGNOSIS = "diagnosis.json"
_NOTES = 3
"""Notes that the terminal shows."""


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
    show(outcome.diagnosis, console, options.verbose)
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


def diagnose_group(
    options: DiagnoseOptions, rig: Rig, settings: DiagnosisSettings, console: Console, progress: DiagnosisProgress
) -> int:
    """Diagnose several units, write a folder for each and what they say together, print the verdict.

    Raises:
        BenchError: the table or a recording cannot be used.
    """
    from nmt_core.files.whole_file import write_whole
    from nmt_diagnose.diagnose import diagnose_bags
    from nmt_diagnose.units.unit_group import UnitDiagnosis, unit_group
    from nmt_diagnose.units.unit_table import read_unit_table
    from nmt_report.diagnosis_files import write_diagnosis
    from nmt_report.group_report import group_page

    assert options.group is not None
    if options.floor:
        raise BenchError("--floor belongs to one unit; give its repeats in the table of --group, column repeat.")
    rows, varied = read_unit_table(options.group)
    diagnoses, folders = [], []
    with OutputFolder(options.out, options.force) as folder:
        for number, row in enumerate(rows, start=1):
            name = f"{row.unit}{f', {row.setting}' if row.setting else ''}"
            progress.update(f"{name} ({number} of {len(rows)})")
            outcome = diagnose_bags(rig, row.recordings, (), settings, progress.update)
            place = Path(folder) / f"{number}-{re.sub(r'[^A-Za-z0-9]+', '-', name).strip('-')}"
            place.mkdir()
            write_diagnosis(outcome, place, options.model, options.set)
            diagnoses.append(UnitDiagnosis(row.unit, row.setting, outcome.diagnosis))
            folders.append((name, f"{place.name}/report.html"))
        group = unit_group(diagnoses, varied)
        content = {"format": "nmt units 1", "model": str(options.model), "group": group.to_mapping()}
        write_whole(Path(folder) / "diagnosis.json", json.dumps(content, indent=2, ensure_ascii=False) + "\n")
        write_whole(Path(folder) / "report.html", group_page(rig.name, rig.description, group, folders))
    console.print()
    for sentence in group.sentences:
        console.print(sentence, markup=False, highlight=False, soft_wrap=True)
    console.print(f"Report: {(options.out / 'report.html').resolve()}", soft_wrap=True)
    return EXIT_DONE


def show(diagnosis: Diagnosis, console: Console, verbose: bool = False) -> None:
    """Print the verdict, the places, the ranking, what was re-fitted and the next test; ``verbose``: every table."""
    from rich.text import Text

    from nmt_diagnose.say.words import answered, verdict_text
    from nmt_report.diagnosis_tables import (
        calibration_table,
        next_table,
        place_table,
        ranking_table,
        recordings_table,
        visible_sentence,
        visible_table,
    )

    text, kind = verdict_text(diagnosis)
    style = {"good": "bold green", "partly": "bold yellow", "bad": "bold red"}[kind]
    console.print()
    console.print(Text(f"Verdict: {text}", style=style), soft_wrap=True)
    for question, sentence in (*answered(diagnosis), *(("Mind", warning) for warning in diagnosis.warnings)):
        console.print(Text.assemble((f"{question:<10}", "bold"), sentence), soft_wrap=not console.is_terminal)
    console.print()
    for table in (
        ranking_table(diagnosis), place_table(diagnosis), calibration_table(diagnosis, verbose),
        next_table(diagnosis), recordings_table(diagnosis) if verbose else None,
        visible_table(diagnosis) if verbose else None,
    ):  # fmt: skip
        if table is not None:
            console.print(table)
    if diagnosis.visible and not verbose:
        console.print(Text(visible_sentence(diagnosis)), soft_wrap=True)
    notes = diagnosis.notes if verbose else diagnosis.notes[:_NOTES]
    for note in notes:
        console.print(Text(note, style="yellow"), soft_wrap=True)
    if len(notes) < len(diagnosis.notes):
        more = f"{len(diagnosis.notes) - len(notes)} more notes stand in the report; --verbose prints them."
        console.print(Text(more, style="yellow"), soft_wrap=True)
