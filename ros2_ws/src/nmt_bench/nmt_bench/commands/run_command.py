"""``./nmt run``: one test of a rig from the first node to the report."""

from __future__ import annotations

import argparse
import contextlib
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nmt_bench.command_parser import EXIT_DONE, EXIT_FAILED, EXIT_INTERRUPTED
from nmt_bench.commands.bench_options import bench_of
from nmt_bench.commands.output_folder import OutputFolder, check_output
from nmt_bench.orchestration.interrupts import deferred_interrupts, terminate_as_interrupt
from nmt_core.errors import BenchError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from nmt_bench.harness import Bench
    from nmt_record.exchange.calibration_file import CalibrationSheet
    from nmt_report.run_data import ReferenceCurve
    from nmt_session.run_result import RunResult


USAGE = """\
Tests a rig: the phase-locked loop holds phase resonance at the drive point, the level is stepped, and every locked
window gives a modal point. Everything is recorded to a bag. Ctrl-C ramps the drive to zero, closes the bag and
reports what was measured.

RIG  name of a rig (for example beam) or path of a rig file
@output bag/, modal.csv, modal.json, uncertainty.csv, report.html, rig.yaml, run.json
--linear FILE  linear.json of './nmt linear' for loop and extraction (default: the linear modes of the rig's model)
--levels PLAN  levels in the unit of --control: a:b:n for n levels from a to b in geometric steps, a:b:n:linear, or a
    list a,b,c (default: the rig's, in V)
--strategy stepped|ramp =stepped  stepped: wait for lock at every level; ramp: lock once, then windows of 20 periods
    during slow ramps, evaluated by the balance of power (default: stepped)
--control voltage|response|force =voltage  what the levels are: drive voltage (V), amplitude of the drive-point
    response that is held (m or m/s^2), or force fundamental that is held (N) (default: voltage)
--direction up|down|both|given =given  order of the levels: up, down, up and down again, or as given (default)
--periods N  whole periods a window (default: the rig's)
--ramp S  half-cosine between levels, s (default: the rig's)
--timeout S  bench time a level may take to lock, s (default: the rig's)
--stop-on-lost-lock  end the test at the first level that does not lock
--harmonics-control H :harmonics  bring harmonics 2 to H of the force to their targets by harmonics of the drive; auto =
    as many as the sample rate allows, at most 15; 0 = none (default: the rig's, else 0)
--harmonics-target force|modal  force: to zero; modal: to the ratio to the fundamental that modal power needs, for which
    the linear description must have three modes (default: the rig's, else force)
--compare K :int  with control of harmonics: every K-th level is measured without it first, which tells by how much it
    moves frequency and damping (default: never)
--pll adaptive|paper  phase-locked loop: adaptive filter with guard band, or the paper's (default: the rig's, else
    adaptive)
@pacing
@device
@latency
@rig local_elements.0.slip_force_n=2
--reference FILE :text  reference.csv to compare with; 'none' for no comparison (default: computed from the rig's
    model)
--calibration FILE  calibration file with uncertainties of the sensors' sensitivities, for the uncertainty budget
    (default: section device of the rig file, else ordinary tolerances; none for a simulated rig)
--no-report  tables only; './nmt extract' makes a report of the bag at any time
@processes
"""


def _harmonics(text: str) -> int | str:
    if text == "auto":
        return text
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is no number of harmonics; give one from 2 on, auto or 0") from None


KINDS = {"harmonics": _harmonics}


def run(arguments: argparse.Namespace) -> int:
    """Run the test, write the results, print the table.

    Returns:
        0 if the plan was worked through and a level locked, 130 after Ctrl-C, 1 otherwise.

    Raises:
        BenchError: the rig, a level or an option is refused, or the nodes do not start.
    """
    check_output(arguments.out, arguments.force)
    from nmt_bench.orchestration.prepared_nodes import nodes_ahead

    with nodes_ahead(not arguments.one_process):
        return _run(arguments)


def _run(arguments: argparse.Namespace) -> int:
    from nmt_bench.commands.console import make_console
    from nmt_bench.commands.linear_input import check_fits, read_linear
    from nmt_bench.commands.work_display import WorkDisplay
    from nmt_core.vocabulary import PointStatus
    from nmt_record.exchange.calibration_file import read_calibration

    linear = read_linear(arguments.linear) if arguments.linear is not None else None
    sheet = None if arguments.calibration is None else read_calibration(arguments.calibration)
    bench = bench_of(
        arguments,
        _levels(arguments),
        window_periods=arguments.periods,
        ramp=arguments.ramp,
        timeout=arguments.timeout,
        stop_on_lost_lock=arguments.stop_on_lost_lock,
        node_values={"pll": {"loop": arguments.pll}} if arguments.pll else {},
        control=arguments.control,
        strategy=arguments.strategy,
        linear=linear,
        harmonics_control=arguments.harmonics_control,
        harmonics_target=arguments.harmonics_target,
        compare=arguments.compare or 0,
    )
    if linear is not None:
        check_fits(linear, bench.rig, arguments.linear)
    console = make_console()
    with terminate_as_interrupt(), OutputFolder(arguments.out, arguments.force, live=True) as folder:
        result = measure(bench, console, arguments.quiet, arguments.page)
        with WorkDisplay(console, quiet=arguments.quiet):
            reference, unwritten, interrupted = evaluate(
                result, bench, folder, arguments.reference, not arguments.no_report, sheet
            )
        _summarise(result, reference, console, folder, unwritten)
    if result.interrupted or interrupted:
        return EXIT_INTERRUPTED
    locked = any(point.status == PointStatus.OK for point in result.points)
    return EXIT_DONE if locked and result.complete and not unwritten else EXIT_FAILED


def evaluate(
    result: RunResult,
    bench: Bench,
    folder: Path,
    choice: str | None,
    report: bool = True,
    sheet: CalibrationSheet | None = None,
) -> tuple[ReferenceCurve | None, str, bool]:
    """Write tables and report; the tables first, since Ctrl-C may end the rest.

    Args:
        result, bench: what was measured, and where.
        folder: of the results.
        choice, report, sheet: as ``--reference``, ``--no-report`` and ``--calibration`` say.

    Returns:
        The reference; what could not be written, as a sentence; whether Ctrl-C came. One leaves out the comparison that
        is being computed, a second one the report.
    """
    from nmt_core.processes.work_progress import tell

    reference, interrupted = None, False
    with deferred_interrupts(patient=True) as deferred:
        unwritten = _saving(folder, lambda: _write_tables(result, bench, folder))
    try:
        interrupted = deferred.came
        if not interrupted:
            tell("computing the reference")
            reference = _reference(choice, bench, result)
    except KeyboardInterrupt:
        interrupted = True
    if unwritten:
        return reference, unwritten, interrupted
    try:
        tell("writing the results")
        budgets: list[Any] = []
        unwritten = _saving(folder, lambda: budgets.extend(_write_budget(result, bench, folder, reference, sheet)))
        if report and not unwritten:
            unwritten = _saving(folder, lambda: _write_report(result, folder, reference, budgets))
    except KeyboardInterrupt:
        interrupted = True
        unwritten = (
            f"Stopped before the report was written. The results so far are in {folder}; "
            f"'./nmt extract {folder} --out DIR' goes on from the bag."
        )
    return reference, unwritten, interrupted


def _levels(arguments: argparse.Namespace) -> list[float] | str | None:
    if arguments.direction == "given":
        return arguments.levels  # type: ignore[no-any-return]
    from nmt_rig.rig import load_rig
    from nmt_sequencer.level_plan import directed, parse_levels

    plan = arguments.levels or load_rig(arguments.rig, arguments.set).test.levels
    return directed(parse_levels(plan), arguments.direction)


def measure(bench: Bench, console: Any, quiet: bool, page: bool = False) -> RunResult:
    """Start the nodes and run the test, with a progress display unless ``quiet``, and with the live page if wanted."""
    from nmt_bench.commands.run_progress import RunProgress
    from nmt_report.columns import unit_text

    began = time.monotonic()
    with bench, contextlib.ExitStack() as stack:
        if page:
            from nmt_bench.page.page_process import page_process

            arguments = ("--domain", str(bench.domain_id))
            for line in stack.enter_context(page_process(bench.out / "log" / "page.log", arguments)).lines:
                console.print(line, soft_wrap=True)
        if quiet:
            return bench.run()
        levels, unit = bench.test.levels, bench.test.level_unit
        console.print(
            f"{bench.rig.name}, drive point {bench.rig.drive_point}, {len(levels)} levels from {min(levels):g} to "
            f"{max(levels):g} {unit_text(unit)}, run {bench.test.run_id}; nodes started in "
            f"{time.monotonic() - began:.1f} s in ROS domain {bench.domain_id}"
        )
        with RunProgress(bench.rig.sample_rate_hz, len(levels), unit, console) as progress:
            return bench.run(progress.update, progress.note)


def _reference(choice: str | None, bench: Bench, result: RunResult) -> ReferenceCurve | None:
    """The backbone to compare with: a file, or EPMC of the rig's model, solved at the measured amplitudes too."""
    if choice == "none":
        return None
    import numpy as np

    from nmt_report.run_data import ReferenceCurve, read_reference

    if choice is not None:
        return read_reference(Path(choice))
    from nmt_rig.reference import compute_reference

    measured = [point.modal_amplitude for point in result.points if np.isfinite(point.modal_amplitude)]
    if not measured:
        return None
    grid = np.geomspace(0.5 * min(measured), 2.0 * max(measured), 150)
    try:
        computed = compute_reference(bench.rig, 15, np.unique(np.concatenate([grid, measured])))
    except (BenchError, ArithmeticError, ValueError):
        return None  # the measurement stands without its comparison
    return ReferenceCurve(
        "EPMC (harmonic balance)", computed.modal_amplitude, computed.omega_rad_s, computed.damping_ratio
    )


def _write_tables(result: RunResult, bench: Bench, folder: Path) -> None:
    from nmt_extract.modal_table import write_results

    inputs = {
        "run_id": bench.test.run_id,
        "rig": bench.rig.name,
        "linear": bench.plan.run["linear"],
        "extraction": bench.plan.run["extraction"],
        "result": result.code.name,
        "message": result.message,
    }
    if result.points:
        write_results(result.points, folder, inputs)


def _write_budget(
    result: RunResult,
    bench: Bench,
    folder: Path,
    reference: ReferenceCurve | None,
    sheet: CalibrationSheet | None,
) -> tuple[Any, ...]:
    """Write the uncertainty budget; the budgets and what they were made from, or nothing where there are no points."""
    from nmt_core.messages.linear_description import LinearDescription
    from nmt_core.vocabulary import PointStatus
    from nmt_extract.bag_budget import bag_budget
    from nmt_extract.extraction_settings import ExtractionSettings
    from nmt_extract.uncertainty_budget import write_budget
    from nmt_record.bag.bag_reader import Bag

    good = [point for point in result.points if point.status is PointStatus.OK]
    if not good or result.bag is None or not result.bag.exists():
        return ()
    budgets, inputs = bag_budget(
        Bag.open(result.bag),
        result.points,
        LinearDescription.from_mapping(dict(bench.plan.run["linear"])),
        ExtractionSettings.from_mapping(dict(bench.plan.run["extraction"])),
        sheet,
        expected=None if reference is None else reference.at,
    )
    write_budget(budgets, folder, inputs)
    return budgets, inputs


def _write_report(
    result: RunResult, folder: Path, reference: ReferenceCurve | None, budgets: Sequence[Any] = ()
) -> None:
    from nmt_report.run_report import list_files, report_data_from_bag, write_report

    if result.bag is not None and result.bag.exists():
        if reference is not None:
            from nmt_rig.reference import write_reference_csv

            write_reference_csv(reference, folder / "reference.csv")
        data = report_data_from_bag(result.bag, list(result.points) or None, reference)
        if budgets:
            data.budgets, data.budget_inputs = budgets
        data.files = list_files(folder)
        write_report(data, folder / "report.html")


def _saving(folder: Path, write: Callable[[], None]) -> str:
    """Write; what could not be written, as a sentence: the measurement is not to be lost for it."""
    try:
        write()
    except (OSError, BenchError) as error:
        why = error.strerror.lower() if isinstance(error, OSError) and error.strerror else str(error).rstrip(".")
        return (
            f"The results could not all be written ({why}); what was recorded is in {folder / 'bag'}: "
            f"make room and run './nmt extract {folder} --out DIR'."
        )
    return ""


def pace_line(result: RunResult) -> str:
    """How long a run took, as a sentence."""
    from nmt_report.quantity_format import duration

    return (
        f"Bench time {duration(result.bench_time)} in {result.wall_time:.1f} s: {result.real_time_factor:.1f} × real "
        f"time; bag {result.bag_state}."
    )


def _summarise(result: RunResult, reference: ReferenceCurve | None, console: Any, folder: Path, unwritten: str) -> None:
    from nmt_bench.commands.terminal import print_modal_table
    from nmt_core.vocabulary import ResultCode

    if result.points:
        print_modal_table(result.points, reference, console)
    style = None if result.code == ResultCode.SUCCEEDED else "yellow"
    console.print(result.message, style=style)
    if result.bench_time > 0:
        levels = max(1, len(result.points))
        console.print(
            f"Bench time {result.bench_time:.1f} s ({result.bench_time / levels:.1f} s a level) in "
            f"{result.wall_time:.1f} s: {result.real_time_factor:.1f} × real time; bag {result.bag_state}."
        )
    for line in result.remarks:
        console.print(line)
    if unwritten and folder.is_dir():
        console.print(unwritten, style="red", soft_wrap=True)
    if (folder / "report.html").exists():
        console.print(f"Report: {(folder / 'report.html').resolve()}", soft_wrap=True)
