"""``./nmt extract``: modal properties from a recorded bag, by the code of the live node."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nmt_bench.commands.output_folder import OutputFolder, check_output
from nmt_bench.commands.shared_options import dated_folder_option, replace_option
from nmt_core.errors import BenchError
from nmt_core.files.hardened import json_value, read_text
from nmt_core.options import argument, option
from nmt_core.text.number_words import level_list

if TYPE_CHECKING:
    from rich.console import Console

    from nmt_core.messages.modal_point import ModalPoint
    from nmt_extract.extraction_settings import ExtractionSettings
    from nmt_extract.judgement.uncertainty_budget import MethodError
    from nmt_record.bag.bag_reader import Bag
    from nmt_record.exchange.sidecar.calibration_file import CalibrationSheet


@dataclass(frozen=True, kw_only=True)
class ExtractOptions:
    """Extracts modal frequency, damping, amplitude and shape from every locked window of a recorded bag, with the code
    of the live node: the results are the same, bit for bit. Opens bags of killed recorders too and says what they
    lost."""

    bag: Path = argument(
        "rosbag2 folder (MCAP or SQLite), .mcap or .db3 file, or the results folder of a run", metavar="BAG"
    )
    out: Path = dated_folder_option(
        "modal.csv, modal.json, uncertainty.csv, uncertainty.json, report.html; of free decays alone decay.csv",
        "extract",
    )
    force: bool = replace_option()
    linear: Path | None = option(
        None, "linear.json to use in place of the linear modes named in the bag", metavar="FILE"
    )
    harmonics: int | None = option(
        None, "highest harmonic to extract, 1 to 200 (default: as recorded in the bag)", metavar="H"
    )
    reference: Path | None = option(
        None, "reference.csv of './nmt reference' to compare with in table and report", metavar="FILE"
    )
    calibration: Path | None = option(
        None,
        "calibration file of the sensors for the uncertainty budget (default: that of the bag, else ordinary "
        "tolerances)",
        metavar="FILE",
    )
    model_run: Path | None = option(
        None,
        "results folder of a run of the rig's model with its reference.csv, for the error of single-point excitation",
        metavar="DIR",
    )
    no_report: bool = option(False, "write modal.csv and modal.json only")


def run(options: ExtractOptions) -> int:
    """Extract, write the results, print the table.

    Raises:
        BenchError: no bag, nothing to extract in it, or the results cannot be written.
    """
    check_output(options.out, options.force)

    from nmt_bench.commands.console import make_console
    from nmt_bench.commands.linear_input import read_linear
    from nmt_bench.commands.terminal import print_modal_table, print_verdict
    from nmt_bench.commands.work_display import WorkDisplay
    from nmt_extract.modal.table import write_results
    from nmt_extract.offline import extract_opened_bag
    from nmt_record.bag.bag_reader import Bag
    from nmt_report.run_data import read_reference

    sheet = None if options.calibration is None else _calibration(options.calibration)
    method = None if options.model_run is None else _method_error(options.model_run)
    linear = read_linear(options.linear) if options.linear is not None else None
    reference = read_reference(options.reference) if options.reference is not None else None
    bag = Bag.open(options.bag)
    settings = _settings(bag.run_start, options.harmonics)
    console = make_console()
    if _holds_decays_only(bag):
        return _decays(bag, options, console)
    with WorkDisplay(console, ("extracting",)):
        result = extract_opened_bag(bag, linear, settings)
    if not result.points:
        raise BenchError(f"The bag {options.bag} gave no modal point; its run may have ended before the first lock.")
    from nmt_extract.judgement.uncertainty_budget import write_budget
    from nmt_extract.modal.bag_budget import bag_budget

    expected = None if reference is None else reference.at
    budgets, known = bag_budget(bag, result.points, result.linear, result.settings, sheet, method, expected)
    with OutputFolder(options.out, options.force) as folder, WorkDisplay(console, ("writing the report",)):
        write_results(result.points, folder, result.inputs)
        write_budget(budgets, folder, known)
        if not options.no_report:
            from nmt_report.run_report import list_files, report_data_from_bag, write_report

            data = report_data_from_bag(bag, result.points, reference)
            data.linear, data.budgets, data.budget_inputs = result.linear, budgets, known
            data.files = list_files(folder)
            write_report(data, folder / "report.html")
    for sentence in (result.loss, _lack_of_run(bag)):
        if sentence:
            console.print(sentence, style="yellow")
    print_modal_table(result.points, reference, console, budgets, known)
    if linear is None and settings is None:
        from nmt_core.messages.wire import MODAL_POINT

        console.print(comparison_with_live(result.points, list(bag.records("modal_point", MODAL_POINT))))
    tables = ("modal.csv", "modal.json", "uncertainty.csv", "uncertainty.json", "hysteresis.csv", "limit_cycles.csv")
    written = (*tables, "report.html")
    names = ", ".join(name for name in written if (options.out / name).exists())
    console.print(f"Results in {options.out}: {names}")
    print_verdict(result.points, console, linear=result.linear)
    return 0


def _holds_decays_only(bag: Bag) -> bool:
    from nmt_extract.decays.free_decay import holds_decays_only

    return holds_decays_only(bag)


def _decays(bag: Bag, options: ExtractOptions, console: Console) -> int:
    """Free decays of a recording that holds nothing else to extract."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from nmt_bench.commands.work_display import WorkDisplay
    from nmt_extract.decays.free_decay import free_decays, write_decays
    from nmt_report.quantity_format import uncertain

    with WorkDisplay(console, ("extracting",)):
        decays = free_decays(bag)
    with OutputFolder(options.out, options.force) as folder:
        write_decays(decays, folder / "decay.csv")
    table = Table(
        title="Free decays, of structure and all that hangs on it: mean ± standard uncertainty",
        title_justify="left",
        box=SIMPLE_HEAD,
    )
    for head in ("segment", "channel", "amplitude", "frequency Hz", "damping %"):
        table.add_column(head, justify="left" if head == "channel" else "right")
    for decay in decays:
        if decay.reason:
            table.add_row(str(decay.segment), decay.channel, "", "", "")
            continue
        amplitude = f"{decay.amplitude.max():.3g} to {decay.amplitude.min():.3g} {decay.unit}"
        damping = [100.0 * value for value in decay.mean("damping_ratio")]
        frequency = uncertain(*decay.mean("frequency_hz"), 4)
        table.add_row(str(decay.segment), decay.channel, amplitude, frequency, uncertain(damping[0], damping[1], 4))
    console.print(table)
    for decay in decays:
        if decay.reason:
            console.print(f"Segment {decay.segment}, {decay.channel}: {decay.reason}", style="yellow")

    console.print(f"Results in {options.out}: decay.csv")
    return 0


def _calibration(path: Path) -> CalibrationSheet:
    from nmt_record.exchange.sidecar.calibration_file import (
        read_calibration,
    )  # loads pydantic, which few extractions need

    return read_calibration(path)


def _method_error(folder: Path) -> MethodError | None:
    from nmt_extract.judgement.uncertainty_budget import MethodError
    from nmt_extract.modal.table import read_json
    from nmt_report.run_data import read_reference

    points, _ = read_json(folder / "modal.json")
    found = MethodError.of(points, read_reference(folder / "reference.csv").at)
    if found is None:
        raise BenchError(f"--model-run: no point of {folder / 'modal.json'} lies on {folder / 'reference.csv'}.")
    return found


def comparison_with_live(points: Sequence[ModalPoint], recorded: Sequence[ModalPoint]) -> str:
    """A sentence on how points extracted from a bag compare with those that its run gave."""
    if not recorded:
        return "The bag holds no live results to compare with."
    by_level = {point.level_index: point for point in recorded}
    shared = [point for point in points if point.level_index in by_level]
    different = [point.level_index + 1 for point in shared if not point.identical(by_level[point.level_index])]
    missing = [point.level_index for point in points if point.level_index not in by_level]
    lacking = f"There are no live results of {level_list(missing)} ({len(missing)} of {len(points)} levels). "
    said = lacking if missing else ""
    if different:
        levels = ", ".join(map(str, different))
        return (
            f"{said}Level {levels} differs from the live result: settings, blocks or version were others at the time."
        )
    others = f"The other {len(shared)} are equal to them bit for bit." if shared else ""
    if missing:
        return f"{said}{others}".strip()
    return f"Equal to the live results bit for bit ({len(shared)} of {len(points)} levels compared)."


def _settings(run: dict[str, object] | None, harmonics: int | None) -> ExtractionSettings | None:
    if harmonics is None:
        return None
    from nmt_extract.extraction_settings import ExtractionSettings

    recorded = (run or {}).get("extraction")
    values = dict(recorded) if isinstance(recorded, dict) else {}
    return ExtractionSettings.from_mapping({**values, "harmonics": harmonics})


def _lack_of_run(bag: Bag) -> str:
    """What a bag without a stop record lacks, as the run command noted it; empty if nothing is known."""
    if bag.run_stop is not None:
        return ""
    try:
        run = json_value(read_text(bag.path.parent / "run.json", "The file"), "The file run.json", bounded=False)
        lacks = float(run["result"]["bag"]["lacks_s"])
    except (BenchError, KeyError, TypeError, ValueError):
        return ""
    return f"Of the run the bag lacks {lacks:.3f} s of bench time, as run.json says." if lacks > 0.0 else ""
