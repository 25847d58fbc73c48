"""``./nmt linear``: linear modal test with random excitation."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nmt_bench.commands.bench_options import add_pacing_option, add_process_options, add_rig_options
from nmt_bench.commands.output_folder import OutputFolder, add_output_options, check_output
from nmt_core.errors import BenchError
from nmt_core.whole_file import write_whole

if TYPE_CHECKING:
    from nmt_extract.linear_file import Linearity
    from nmt_extract.linear_test import LinearTest, LinearTestSettings
    from nmt_record.bag_reader import Bag
    from nmt_record.segments import Segment
    from nmt_rig.rig import Rig
    from nmt_session.run_result import RunResult

    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]

EXIT_DONE, EXIT_FAILED, EXIT_INTERRUPTED = 0, 1, 130
DEFAULT_DURATION = 60.0
DEFAULT_BAND = "10:2000"


def add_parser(subparsers: Subparsers) -> None:
    """Add the command and its options."""
    parser = subparsers.add_parser(
        "linear",
        help="linear modal test: random excitation, frequency responses, fitted modes",
        description=(
            "Drives the rig with low random noise, at half the level first and then at the level, and finds the linear "
            "modes: averaged frequency responses, stabilisation diagram, fit, mass-normalised shapes, residuals, and "
            "the plant with its exciter. Give linear.json to './nmt run --linear': loop and extraction then need no "
            "model."
        ),
    )
    parser.add_argument(
        "rig", metavar="RIG", nargs="?", help="name of a rig (for example joint_resonator) or path of a rig file"
    )
    add_output_options(parser, "bag/, linear.json, frf.csv, report.html, rig.yaml, run.json")
    parser.add_argument("--bag", metavar="BAG", type=Path, help="evaluate a recording again instead of measuring")
    parser.add_argument(
        "--level", metavar="V", type=float, help="drive, V rms (default: the number of the rig's lowest test level)"
    )
    parser.add_argument(
        "--duration",
        metavar="S",
        type=float,
        default=DEFAULT_DURATION,
        help=f"length of the record at each level, s (default: {DEFAULT_DURATION:g})",
    )
    parser.add_argument(
        "--band", metavar="LOW:HIGH", default=DEFAULT_BAND, help=f"band of the noise, Hz (default: {DEFAULT_BAND})"
    )
    parser.add_argument(
        "--mode",
        metavar="N",
        type=int,
        help="target: number of the fitted mode in the band, from 1 (default: the rig's test.mode, less one where a "
        "suspension mode lies below the band)",
    )
    parser.add_argument("--near", metavar="HZ", type=float, help="target: the fitted mode nearest to this frequency")
    parser.add_argument("--modes", metavar="N", type=int, help="most modes to keep (default: the rig's linear_modes)")
    parser.add_argument(
        "--segment", metavar="S", type=float, help="length of an averaged segment, s (default: a tenth of the record)"
    )
    parser.add_argument("--no-half-level", action="store_true", help="leave out the record at half the level")
    parser.add_argument(
        "--reference",
        choices=("model", "none"),
        default="model",
        help="what the report compares with; linear.json never uses it (default: the rig's model)",
    )
    add_rig_options(parser)
    add_pacing_option(parser)
    add_process_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Measure, evaluate, write the results, print the modes.

    Returns:
        0 if it worked, 130 after Ctrl-C, 1 if the run was cut short.

    Raises:
        BenchError: a wrong rig or option, or a record that cannot be evaluated.
    """
    if (arguments.rig is None) == (arguments.bag is None):
        raise BenchError("Give either a rig to measure or --bag with a recording to evaluate.")
    band = _band(arguments.band)
    check_output(arguments.out, arguments.force)
    from nmt_bench.commands.terminal import make_console

    console = make_console()
    if arguments.bag is not None:
        from nmt_record.bag_reader import Bag

        bag = Bag.open(arguments.bag)
        outcome = evaluate(bag, arguments, band)
        with OutputFolder(arguments.out, arguments.force) as folder:
            _write(outcome, folder, arguments)
        _show(outcome, arguments, console)
        return EXIT_DONE
    return _measure(arguments, band, console)


def _measure(arguments: argparse.Namespace, band: tuple[float, float], console: Any) -> int:
    from nmt_bench.commands.run_command import measure, terminate_as_interrupt
    from nmt_bench.harness import Bench
    from nmt_core.vocabulary import ResultCode
    from nmt_record.bag_reader import Bag
    from nmt_rig.rig import load_rig
    from nmt_sequencer.level_plan import parse_levels

    rig = load_rig(arguments.rig, arguments.set)
    level = arguments.level if arguments.level is not None else min(parse_levels(rig.test.levels))
    if not 0.0 < level < float("inf"):
        raise BenchError(f"--level must be positive, got {level:g} V.")
    bench = Bench(
        arguments.rig,
        # The lower level first: sliders that a higher one has moved would still be displaced.
        levels=[level] if arguments.no_half_level else [0.5 * level, level],
        out=arguments.out,
        processes=not arguments.one_process,
        overrides=arguments.set,
        exciter=arguments.exciter,
        seed=arguments.seed,
        pacing=arguments.pacing,
        domain_id=arguments.domain,
        test="random",
        band_hz=band,
        duration=arguments.duration,
    )
    with terminate_as_interrupt(), OutputFolder(arguments.out, arguments.force, live=True) as folder:
        result = measure(bench, console, arguments.quiet)
        if result.bag is None or not result.bag.exists():
            console.print(result.message, style="yellow", markup=False)
            return EXIT_FAILED
        try:
            outcome = evaluate(Bag.open(result.bag), arguments, band)
        except BenchError as error:
            if result.interrupted or result.code != ResultCode.SUCCEEDED:
                console.print(result.message, style="yellow", markup=False)
            raise BenchError(
                f"{str(error).rstrip('.')}. The recording is in {folder / 'bag'}; './nmt linear --bag' evaluates it "
                "again."
            ) from error
        _write(outcome, folder, arguments)
    _show(outcome, arguments, console)
    _say_how_it_ran(result, console)
    if result.interrupted:
        return EXIT_INTERRUPTED
    return EXIT_DONE if result.code == ResultCode.SUCCEEDED and result.bag_state == "closed" else EXIT_FAILED


def _say_how_it_ran(result: RunResult, console: Any) -> None:
    from nmt_core.vocabulary import ResultCode
    from nmt_report.quantity_format import duration

    if result.code != ResultCode.SUCCEEDED:
        console.print(result.message, style="yellow", markup=False)
    console.print(
        f"Bench time {duration(result.bench_time)} in {result.wall_time:.1f} s: {result.real_time_factor:.1f} × real "
        f"time; bag {result.bag_state}.",
        markup=False,
    )


def _band(text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        raise BenchError(f"--band must be LOW:HIGH in Hz as in {DEFAULT_BAND}, got '{text}'.") from None
    if not 0.0 < low < high < float("inf"):
        raise BenchError(f"--band must be LOW:HIGH with 0 < LOW < HIGH in Hz, got '{text}'.")
    return low, high


# -- evaluation -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class LinearOutcome:
    """What the command found.

    Attributes:
        test: evaluation of the highest level.
        level: its level, V rms; None if the recording does not say.
        check: comparison with the lowest level; None if there is one level only.
        rig: rig of the recording; None if it has none.
        run: the recording's description of itself.
        remarks: sentences.
    """

    test: LinearTest
    level: float | None
    check: Linearity | None
    rig: Rig | None
    run: dict[str, Any]
    remarks: tuple[str, ...]


def evaluate(bag: Bag, arguments: argparse.Namespace, band: tuple[float, float]) -> LinearOutcome:
    """Evaluate the random windows of a recording.

    Raises:
        BenchError: it has none, or they cannot be evaluated.
    """
    from nmt_core.test_kind import TestKind
    from nmt_extract.linear_file import linearity
    from nmt_extract.linear_test import linear_test
    from nmt_record.segments import read_signals, segments

    windows = [segment for segment in segments(bag) if segment.kind is TestKind.RANDOM]
    whole = [segment for segment in windows if not segment.fault]
    if not whole:
        fault = f" ({windows[0].fault})" if windows else ""
        raise BenchError(
            f"The bag {bag.path} has no whole window of random excitation{fault}; record one with './nmt linear'."
        )
    rig = _rig_of(bag)
    run = bag.run_start or {}
    settings = _settings(bag, run, rig, arguments, band)
    main = max(whole, key=lambda segment: segment.level)
    test = linear_test(read_signals(bag, main.first_sample, main.samples), settings)
    lowest = min(whole, key=lambda segment: segment.level)
    check, remarks = None, list(test.remarks)
    if lowest.level < main.level:
        try:
            lower = linear_test(read_signals(bag, lowest.first_sample, lowest.samples), settings)
            check = linearity(test, lower, main.level, lowest.level)
        except BenchError as error:
            remarks.append(f"The lower level of {lowest.level:g} V rms could not be evaluated: {error}")
    if test.reference == "force":
        remarks.append(
            "No voltage was recorded: noise of the force biases the fit where the force drops out, and the exciter's "
            "share of the plant is not known."
        )
    return LinearOutcome(test, _level(main), check, rig, run, tuple(remarks))


def _level(segment: Segment) -> float | None:
    return segment.level if segment.level > 0.0 else None


def _rig_of(bag: Bag) -> Rig | None:
    if not bag.rig_yaml:
        return None
    import tempfile

    from nmt_rig.rig import load_rig

    with tempfile.TemporaryDirectory(prefix="nmt-") as folder:
        path = Path(folder) / "rig.yaml"
        path.write_text(bag.rig_yaml, encoding="utf-8")
        try:
            return load_rig(path)
        except BenchError:
            return None


def _settings(
    bag: Bag, run: dict[str, Any], rig: Rig | None, arguments: argparse.Namespace, band: tuple[float, float]
) -> LinearTestSettings:
    from nmt_core.blocks import Quantity
    from nmt_extract.linear_test import LinearTestSettings

    plan = run.get("plan") or {}
    if arguments.band == DEFAULT_BAND and plan.get("band_low_hz") and plan.get("band_high_hz"):
        band = float(plan["band_low_hz"]), float(plan["band_high_hz"])
    drive, modes, rig_mode = run.get("exciter_point"), 2, 1
    quantity = Quantity.ACCELERATION if "acceleration" in bag.topics else Quantity.DISPLACEMENT
    if rig is not None:
        drive, modes, rig_mode = rig.drive_point, rig.extraction.linear_modes, rig.test.mode
        quantity = Quantity[rig.extraction.quantity.upper()]
    if arguments.exciter is not None:
        drive = arguments.exciter
    if drive is None:
        block = next(iter(bag.blocks("force")), None)
        drive = block.points[0] if block is not None else 0
    if arguments.modes is not None and arguments.modes < 1:
        raise BenchError(f"--modes must be at least 1, got {arguments.modes}.")
    for name in ("near", "segment"):
        value = getattr(arguments, name)
        if value is not None and not 0.0 < value < float("inf"):
            raise BenchError(f"--{name} must be positive, got {value:g}.")
    return LinearTestSettings(
        drive_point=int(drive),
        quantity=quantity,
        band_hz=band,
        modes=arguments.modes or modes,
        mode=arguments.mode,
        near_hz=arguments.near,
        rig_mode=rig_mode,
        segment_s=arguments.segment,
    )


# -- results ----------------------------------------------------------------------------------------------------------


def _write(outcome: LinearOutcome, folder: Path, arguments: argparse.Namespace) -> None:
    from nmt_extract.linear_file import frf_table, linear_mapping
    from nmt_report.linear_report import exact_modes, linear_page

    values = linear_mapping(outcome.test, outcome.check, outcome.level)
    values["quality"]["remarks"] = list(outcome.remarks)
    write_whole(folder / "linear.json", json.dumps(values, indent=1) + "\n")
    write_whole(folder / "frf.csv", frf_table(outcome.test))
    exact = exact_modes(outcome.rig) if outcome.rig is not None and arguments.reference == "model" else None
    write_whole(folder / "report.html", linear_page(outcome, exact))


def _show(outcome: LinearOutcome, arguments: argparse.Namespace, console: Any) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from nmt_report.linear_report import exact_modes, match
    from nmt_report.quantity_format import plain, uncertain

    test = outcome.test
    exact = exact_modes(outcome.rig) if outcome.rig is not None and arguments.reference == "model" else None
    table = Table(
        title="Linear modes: value ± standard uncertainty", title_justify="left", title_style="bold", box=SIMPLE_HEAD
    )
    for head in ("mode", "frequency\nHz", "damping ratio\n%", "drive-point shape\n1/√kg", "complexity\n%"):
        table.add_column(head, justify="right", no_wrap=True)
    if exact is not None:
        for head in ("Δf\n%", "Δζ\n%", "1 − MAC", "scale\n%"):
            table.add_column(head, justify="right", no_wrap=True)
    for index, mode in enumerate(test.modes):
        row = [
            f"{index + 1}{' (target)' if index == test.target else ''}",
            uncertain(mode.frequency_hz, mode.frequency_std),
            uncertain(100 * mode.damping_ratio, 100 * mode.damping_std),
            uncertain(mode.drive_shape, mode.drive_shape_std),
            plain(100 * mode.complexity, 1),
        ]
        if exact is not None:
            errors = match(mode, exact, test.points)
            row += [
                plain(100 * errors.frequency, 4),
                plain(100 * errors.damping, 3),
                f"{errors.mac_defect:.1e}",
                plain(100 * errors.scale, 3),
            ]
        table.add_row(*row)
    console.print(table)
    if exact is not None:
        console.print("Δ: against the exact sticking modes of the rig's model.", markup=False)
    plant = test.plant
    if plant is not None:
        console.print(
            f"With exciter: {plant.frequency_hz:.4f} Hz, damping ratio {100 * plant.damping_ratio:.4f} %, "
            f"{plant.force_per_volt:.4g} N/V and {plant.displacement_per_volt:.4g} m/V at the target's frequency, "
            f"moving mass {plant.moving_mass_kg:.4g} kg.",
            markup=False,
            soft_wrap=True,
        )
    if outcome.check is not None:
        style = None if outcome.check.is_linear else "yellow"
        console.print(outcome.check.sentence, style=style, markup=False, soft_wrap=True)
    for line in outcome.remarks:
        console.print(line, style="yellow", markup=False, soft_wrap=True)
    console.print(f"Results in {arguments.out}: linear.json, frf.csv, report.html", markup=False, soft_wrap=True)
    sys.stdout.flush()
