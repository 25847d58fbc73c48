"""``./nmt run``: one test of a rig from the first node to the report."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nmt_bench.command_parser import EXIT_DONE, EXIT_FAILED, EXIT_INTERRUPTED, EXIT_PARTLY
from nmt_bench.commands.bench_options import bench_of
from nmt_bench.commands.output_folder import OutputFolder, check_output
from nmt_bench.commands.shared_options import (
    dated_folder_option,
    device_option,
    domain_option,
    exciter_option,
    latency_option,
    one_process_option,
    pacing_option,
    page_option,
    quiet_option,
    replace_option,
    seed_option,
    set_option,
)
from nmt_bench.orchestration.interrupts import deferred_interrupts, interrupts_of_kernels, terminate_as_interrupt
from nmt_core.errors import BenchError
from nmt_core.options import argument, option

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from nmt_bench.harness import Bench
    from nmt_record.exchange.sidecar.calibration_file import CalibrationSheet
    from nmt_report.run_data import ReferenceCurve
    from nmt_report.run_verdict import RunVerdict
    from nmt_session.run_result import RunResult


def _harmonics(text: str) -> int | str:
    if text == "auto":
        return text
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"'{text}' is not a number of harmonics; give one from 2 on, auto or 0"
        ) from None


def _lags(text: str) -> tuple[float, float]:
    try:
        first, last = map(float, text.split(":"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' are no two lags; give them in degrees as in 20:160") from None
    return first, last


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Tests a rig: the phase-locked loop holds phase resonance at the drive point, the level is stepped, and every
    locked window gives a modal point. Everything is recorded to a bag. Ctrl-C ramps the drive to zero, closes the
    bag and reports what was measured."""

    rig: str = argument("name of a rig (for example beam) or path of a rig file", metavar="RIG")
    out: Path = dated_folder_option(
        "bag/, modal.csv, modal.json, uncertainty.csv, report.html, rig.yaml, run.json", "run"
    )
    force: bool = replace_option()
    kind: str = option(
        "phase_resonance",
        "self_excited: amplitudes of a rig that feeds its motion, damping of either sign; response_curve: responses "
        "at held forces past folds, phase lag stepped (default: phase_resonance)",
        choices=("phase_resonance", "self_excited", "response_curve"),
    )
    method: str | None = option(
        None,
        "self-excited test: amplitude control, velocity feedback, released motion, or what is stable (default: auto)",
        choices=("auto", "amplitude", "feedback", "envelope"),
    )
    duration: float | None = option(
        None,
        "self-excited test: longest wait for a free motion, and longest damping at the end (default: 5)",
        metavar="S",
    )
    linear: Path | None = option(
        None,
        "linear.json of './nmt linear' for loop and extraction (default: the linear modes of the rig's model)",
        metavar="FILE",
    )
    levels: str | None = option(
        None,
        "levels in the unit of --control: a:b:n in geometric steps, a:b:n:linear, or a list a,b,c; of response "
        "curves one for each, in N (default: the rig's)",
        metavar="PLAN",
    )
    strategy: str | None = option(
        None,
        "stepped: lock at every level; ramp: lock once, then windows of 20 periods during slow ramps (default: "
        "stepped)",
        choices=("stepped", "ramp"),
    )
    control: str | None = option(
        None,
        "meaning of the levels: drive voltage (V), held drive-point response (m or m/s^2), or held force "
        "fundamental (N) (default: voltage; self-excited: response; response curve: force)",
        choices=("voltage", "response", "force"),
    )
    refine: float | None = option(
        None,
        "insert levels where the backbone bends: largest relative deviation of the frequency from a straight line, "
        "such as 0.001 (default: none)",
        metavar="TOL",
    )
    lag: tuple[float, float] | None = option(
        None,
        "response curve: first and last lag of the drive-point displacement behind the force, degrees (default: "
        "10:170)",
        metavar="A:B",
        parse=_lags,
    )
    spacing: float | None = option(
        None,
        "response curve: distance of neighbouring points; 1 = factor e of the response, a radian of lag or a tenth "
        "of the frequency (default: 0.2)",
        metavar="D",
    )
    floquet: bool = option(
        False,
        "response curve: measure the Floquet exponents of each orbit by a small multisine in windows of 20 periods "
        "or more",
    )
    along: str | None = option(
        None,
        "response curve: step the lag, or the distance along the curve (secant); auto: secant with another mode "
        "within the loop's filter (default: auto)",
        choices=("auto", "lag", "secant"),
    )
    resonance: str | None = option(
        None,
        "hold a secondary resonance: 3:1 superharmonic, 1:3 subharmonic; levels are voltages or forces",
        choices=("3:1", "1:3"),
    )
    release: float | None = option(
        None,
        "with --resonance 1:3: drive-point response (m or m/s^2) before the drive turns to three times the "
        "frequency, about half of the isola's tip ('./nmt synthesis --resonance 1:3'); response curve on an isola: "
        "amplitude held at its first lag",
        metavar="A",
    )
    start_frequency: float | None = option(
        None,
        "with --resonance: first frequency of the excitation, Hz (default: from the linear frequency)",
        metavar="HZ",
    )
    direction: str = option(
        "given",
        "order of the levels: up, down, up and down again, or as given (default)",
        choices=("up", "down", "both", "given"),
    )
    periods: int | None = option(None, "whole periods a window (default: the rig's)", metavar="N")
    ramp: float | None = option(None, "half-cosine between levels, s (default: the rig's)", metavar="S")
    timeout: float | None = option(None, "bench time a level may take to lock, s (default: the rig's)", metavar="S")
    stop_on_lost_lock: bool = option(False, "end the test at the first level that does not lock")
    harmonics_control: int | str | None = option(
        None,
        "control harmonics 2 to H of the force; auto = as many as the sample rate allows, at most 15; 0 = none "
        "(default: the rig's, else 0)",
        metavar="H",
        parse=_harmonics,
    )
    harmonics_target: str | None = option(
        None,
        "force: zero; modal: the ratio to the fundamental that modal power needs, with three linear modes (default: "
        "the rig's, else force)",
        choices=("force", "modal"),
    )
    compare: int | None = option(
        None,
        "with controlled harmonics: measure every K-th level without control first, for the change of frequency and "
        "damping (default: never)",
        metavar="K",
    )
    pll: str | None = option(
        None,
        "phase-locked loop: adaptive filter with guard band, or the paper's (default: the rig's, else adaptive)",
        choices=("adaptive", "paper"),
    )
    pacing: str = pacing_option()
    device: str = device_option()
    latency_blocks: int = latency_option()
    exciter: int | None = exciter_option()
    seed: int | None = seed_option()
    set: tuple[str, ...] = set_option("local_elements.0.slip_force_n=2")
    reference: str | None = option(
        None,
        "reference.csv to compare with; 'none' for no comparison (default: computed from the rig's model)",
        metavar="FILE",
    )
    calibration: Path | None = option(
        None,
        "calibration file of the sensors for the uncertainty budget (default: section device of the rig file, else "
        "ordinary tolerances; none for a simulated rig)",
        metavar="FILE",
    )
    no_report: bool = option(False, "tables only; './nmt extract' makes a report of the bag at any time")
    one_process: bool = one_process_option()
    domain: int | None = domain_option()
    quiet: bool = quiet_option()
    page: bool = page_option()


def run(options: RunOptions) -> int:
    """Run the test, write the results, print the table.

    Returns:
        0 if the plan was worked through and every level is in the table, 3 if it was worked through and some are, 130
        after Ctrl-C, 1 otherwise.

    Raises:
        BenchError: the rig, a level or an option is refused, or the nodes do not start.
    """
    check_output(options.out, options.force)
    from nmt_bench.orchestration.prepared_nodes import nodes_ahead

    with nodes_ahead(not options.one_process):
        return run_test(options)


def run_test(options: RunOptions) -> int:
    """Run the test, its nodes started anew or ahead; as of :func:`run`."""
    from nmt_bench.commands.console import make_console
    from nmt_bench.commands.linear_input import check_fits, read_linear
    from nmt_bench.commands.work_display import WorkDisplay
    from nmt_record.exchange.sidecar.calibration_file import read_calibration
    from nmt_report.run_verdict import BAD, GOOD

    if not options.resonance and options.start_frequency is not None:
        raise BenchError("--start-frequency belongs to --resonance; give it, or leave it out.")
    if options.kind != "phase_resonance" and options.resonance:
        words = options.kind.replace("_", " ")
        raise BenchError(f"A {words} test has no secondary resonance; leave out --resonance or --kind.")
    settings: dict[str, Any] = {"control": options.control} if options.control else {}
    linear = read_linear(options.linear) if options.linear is not None else None
    sheet = None if options.calibration is None else read_calibration(options.calibration)
    bench = bench_of(
        options,
        _levels(options),
        window_periods=options.periods,
        ramp=options.ramp,
        timeout=options.timeout,
        stop_on_lost_lock=options.stop_on_lost_lock,
        node_values={"pll": {"loop": options.pll}} if options.pll else {},
        method=options.method,
        duration=options.duration,
        strategy=options.strategy,
        linear=linear,
        harmonics_control=options.harmonics_control,
        harmonics_target=options.harmonics_target,
        compare=options.compare or 0,
        latency_blocks=options.latency_blocks,
        refinement=options.refine,
        lag_deg=options.lag,
        spacing=options.spacing,
        floquet=options.floquet or None,
        along=options.along,
        test="secondary_resonance" if options.resonance else options.kind,
        resonance=options.resonance,
        release=options.release,
        frequencies_hz=() if options.start_frequency is None else (options.start_frequency,),
        **settings,
    )
    if linear is not None:
        check_fits(linear, bench.rig, str(options.linear))
    console = make_console()
    with terminate_as_interrupt(), OutputFolder(options.out, options.force, live=True) as folder:
        # In real time and in one process the nodes would wait for it.
        with _loading_meanwhile(bench, options.pacing == "lockstep" and not options.one_process):
            result = measure(bench, console, options.quiet, options.page)
        with WorkDisplay(console, quiet=options.quiet):
            found = evaluate(result, bench, folder, console, options.reference, sheet)
        verdict = _print_table(result, bench, found, console)
        if not (options.no_report or found.unwritten):
            with WorkDisplay(console, quiet=options.quiet):
                write_report_of(result, folder, found)
        _print_files(found, folder, console)
    if result.interrupted or found.interrupted:
        return EXIT_INTERRUPTED
    if verdict.tone == BAD or not result.complete or found.unwritten:
        return EXIT_FAILED
    return EXIT_DONE if verdict.tone == GOOD else EXIT_PARTLY


@contextlib.contextmanager
def _loading_meanwhile(bench: Bench, wanted: bool) -> Iterator[None]:
    """Load what tables and report are made with while the nodes are at work; this process only waits for them."""
    loading = threading.Thread(target=_load_evaluation, args=(bench,), name="loading")
    if wanted:
        loading.start()
    try:
        yield
    finally:
        if wanted:  # a process that is copied must not be loading
            loading.join()


def _load_evaluation(bench: Bench) -> None:
    from nmt_rig.reference import compute_reference, covers, default_amplitudes

    for module in _OF_THE_EVALUATION:
        importlib.import_module(module)
    if not covers(bench.test.driven):
        with contextlib.suppress(BenchError, ArithmeticError, ValueError):  # said where it is wanted
            compute_reference(bench.rig, 15, default_amplitudes(bench.rig, 2)[:1])  # loads the kernels of all others


_OF_THE_EVALUATION = (
    "nmt_extract.modal.bag_budget",
    "nmt_extract.curves.force_surface",
    "nmt_extract.modal.table",
    "nmt_report.run_report",
    "nmt_report.run_page",
    "nmt_report.backbone_figures",
    "nmt_report.curve_figures",
    "nmt_report.history_figures",
    "nmt_report.hysteresis_figures",
    "nmt_report.shape_figures",
)


@dataclass
class Evaluation:
    """What is computed from a test before its table is printed.

    Attributes:
        reference: to compare with, if any.
        budgets: uncertainty budgets of the points, and what they were made from; empty where there are none.
        unwritten: what could not be written, as a sentence.
        interrupted: whether Ctrl-C came.
    """

    reference: ReferenceCurve | None = None
    budgets: tuple[Any, ...] = ()
    unwritten: str = ""
    interrupted: bool = False


def evaluate(
    result: RunResult,
    bench: Bench,
    folder: Path,
    console: Any,
    choice: str | None,
    sheet: CalibrationSheet | None = None,
) -> Evaluation:
    """Write the tables, then compute what they are compared with and their uncertainties; Ctrl-C leaves that out.

    Args:
        result, bench: what was measured, and where.
        folder: of the results.
        console: takes a sentence without a reference.
        choice, sheet: as ``--reference`` and ``--calibration`` say.
    """
    from nmt_core.processes.work_progress import tell

    found = Evaluation()
    with deferred_interrupts(patient=True) as deferred:
        found.unwritten = _saving(folder, lambda: _write_tables(result, bench, folder))
    try:
        found.interrupted = deferred.came
        if not found.interrupted:
            tell("computing the reference")
            with interrupts_of_kernels():
                found.reference = _reference(choice, bench, result, console)
    except KeyboardInterrupt:
        found.interrupted = True
    if found.unwritten:
        return found

    def write() -> None:
        found.budgets = _write_budget(result, bench, folder, found.reference, sheet)

    try:
        tell("computing the uncertainties")
        with interrupts_of_kernels():
            found.unwritten = _saving(folder, write)
    except KeyboardInterrupt:
        found.interrupted, found.unwritten = True, _stopped(folder)
    return found


def write_report_of(result: RunResult, folder: Path, found: Evaluation) -> None:
    """Write the report; Ctrl-C leaves it out. What went wrong stands in ``found``."""
    from nmt_core.processes.work_progress import tell

    try:
        tell("drawing the report")
        with interrupts_of_kernels():
            found.unwritten = _saving(folder, lambda: _write_report(result, folder, found.reference, found.budgets))
    except KeyboardInterrupt:
        found.interrupted, found.unwritten = True, _stopped(folder)


def _stopped(folder: Path) -> str:
    return (
        f"Stopped before the report was written. The results so far are in {folder}; "
        f"'./nmt extract {folder} --out DIR' goes on from the bag."
    )


def _levels(options: RunOptions) -> list[float] | str | None:
    if options.direction == "given":
        return options.levels
    from nmt_rig.rig import load_rig
    from nmt_sequencer.level_plan import directed, parse_levels

    test = load_rig(options.rig, options.set).test
    own = test.response_levels or test.levels if options.kind == "self_excited" else test.levels
    plan = options.levels or own
    return directed(parse_levels(plan), options.direction)


def measure(bench: Bench, console: Any, quiet: bool, page: bool = False) -> RunResult:
    """Start the nodes and run the test, with a progress display unless ``quiet``, and with the live page if wanted."""
    from nmt_bench.commands.run_progress import RunProgress
    from nmt_report.columns import unit_text

    began = time.monotonic()
    with bench, contextlib.ExitStack() as stack:
        if page:
            from nmt_bench.page.page_process import page_process

            options = ("--domain", str(bench.domain_id))
            for line in stack.enter_context(page_process(bench.out / "log" / "page.log", options)).lines:
                console.print(line, soft_wrap=True)
        if quiet:
            return bench.run()
        levels, unit = bench.test.asked.levels, bench.test.level_unit
        console.print(
            f"{bench.rig.name}, drive point {bench.rig.drive_point}, {len(levels)} levels from {min(levels):g} to "
            f"{max(levels):g} {unit_text(unit)}, run {bench.test.asked.run_id}; nodes started in "
            f"{time.monotonic() - began:.1f} s in ROS domain {bench.domain_id}"
        )
        with RunProgress(bench.rig.sample_rate_hz, len(levels), unit, console) as progress:
            return bench.run(progress.update, progress.note)


def _reference(choice: str | None, bench: Bench, result: RunResult, console: Any) -> ReferenceCurve | None:
    """The backbone to compare with: a file, or EPMC of the rig's model, solved at the measured amplitudes too.

    The measurement stands without its comparison: what keeps it from being made is said in a sentence.
    """
    if choice == "none":
        return None
    import numpy as np

    from nmt_report.run_data import ReferenceCurve, read_reference

    if choice is not None:
        return read_reference(Path(choice))
    from nmt_rig.reference import compute_reference, covers

    if refusal := covers(bench.test.driven):
        console.print(refusal, soft_wrap=True)
        return None
    measured = [point.modal_amplitude for point in result.points if np.isfinite(point.modal_amplitude)]
    if not measured:
        return None
    grid = np.geomspace(0.5 * min(measured), 2.0 * max(measured), 150)
    try:
        computed = compute_reference(bench.rig, 15, np.unique(np.concatenate([grid, measured])))
    except (BenchError, ArithmeticError, ValueError) as error:
        why = str(error).rstrip(".") or type(error).__name__
        words = f"There is no reference to compare with: {why}; give a reference.csv with --reference, or 'none'."
        console.print(words, style="yellow", soft_wrap=True)
        return None
    return ReferenceCurve(
        "EPMC (harmonic balance)", computed.modal_amplitude, computed.omega_rad_s, computed.damping_ratio
    )


def _write_tables(result: RunResult, bench: Bench, folder: Path) -> None:
    from nmt_extract.modal.table import write_results

    inputs = {
        "run_id": bench.test.asked.run_id,
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
    from nmt_extract.curves.response_curve import is_of_curve
    from nmt_extract.extraction_settings import ExtractionSettings
    from nmt_extract.judgement.uncertainty_budget import write_budget
    from nmt_extract.modal.bag_budget import bag_budget
    from nmt_record.bag.bag_reader import Bag

    good = [point for point in result.points if point.status is PointStatus.OK and not point.force_order]
    if is_of_curve(good):  # the budget is that of modal properties at phase resonance
        return ()
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


def _print_table(result: RunResult, bench: Bench, found: Evaluation, console: Any) -> RunVerdict:
    """Print what was measured, without waiting for the report."""
    from nmt_bench.commands.terminal import print_modal_table, print_verdict
    from nmt_core.messages.linear_description import LinearDescription
    from nmt_core.vocabulary import ResultCode
    from nmt_extract.curves.backbone_jumps import backbone_sentences
    from nmt_extract.curves.force_surface import surface_sentences
    from nmt_extract.curves.response_curve import curve_sentences, is_of_curve, response_curves

    if result.points:
        print_modal_table(result.points, found.reference, console, *(found.budgets or ()))
    if result.code != ResultCode.SUCCEEDED:
        console.print(result.message, style="yellow")
    if result.bench_time > 0:
        levels = max(1, len(result.points))
        console.print(
            f"Bench time {result.bench_time:.1f} s ({result.bench_time / levels:.1f} s a level) in "
            f"{result.wall_time:.1f} s: {result.real_time_factor:.1f} × real time; bag {result.bag_state}."
        )
    curves = response_curves(result.points) if is_of_curve(result.points) else ()
    for line in (
        *result.remarks,
        *backbone_sentences(result.points),
        *curve_sentences(curves),
        *surface_sentences(curves),
    ):
        console.print(line, soft_wrap=True)
    described = bench.plan.run.get("linear")
    linear = LinearDescription.from_mapping(dict(described)) if described else None
    return print_verdict(result.points, console, len(bench.test.asked.levels), linear)


def _print_files(found: Evaluation, folder: Path, console: Any) -> None:
    """Print what could not be written, and where the report is."""
    if found.unwritten and folder.is_dir():
        console.print(found.unwritten, style="red", soft_wrap=True)
    if (folder / "report.html").exists():
        console.print(f"Report: {(folder / 'report.html').resolve()}", soft_wrap=True)
