"""``./nmt linear``: linear modal test with random excitation."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nmt_bench.command_parser import EXIT_DONE, EXIT_FAILED, EXIT_INTERRUPTED
from nmt_bench.commands.bench_options import bench_of
from nmt_bench.commands.output_folder import OutputFolder, check_output
from nmt_bench.commands.shared_options import (
    dated_folder_option,
    device_option,
    domain_option,
    exciter_option,
    one_process_option,
    pacing_option,
    page_option,
    quiet_option,
    replace_option,
    seed_option,
    set_option,
)
from nmt_core.errors import BenchError
from nmt_core.files.whole_file import write_whole
from nmt_core.options import option, optional_argument

if TYPE_CHECKING:
    from nmt_extract.linear.evaluation import LinearTestResult
    from nmt_record.bag.bag_reader import Bag
    from nmt_rig.rig import Rig

DEFAULT_DURATION = 60.0
DEFAULT_BAND = "10:2000"
_BAND_SHARE = 0.4  # of the sample rate
_STEPS = "evaluating the recording", "writing the report"


@dataclass(frozen=True, kw_only=True)
class LinearOptions:
    """Drives the rig with low random noise, at half the level first and then at the level, and finds the linear modes:
    averaged frequency responses, stabilisation diagram, fit, mass-normalised shapes, residuals, and the plant with
    its exciters. Several exciters are driven at once, each with a noise of its own. Give linear.json to './nmt run
    --linear': loop and extraction then need no model."""

    rig: str = optional_argument("", "name of a rig (for example joint_resonator) or path of a rig file", metavar="RIG")
    out: Path = dated_folder_option("bag/, linear.json, frf.csv, report.html, rig.yaml, run.json", "linear")
    force: bool = replace_option()
    bag: Path | None = option(None, "evaluate a recording again instead of measuring", metavar="BAG")
    level: float | None = option(None, "drive, V rms (default: the number of the rig's lowest test level)", metavar="V")
    duration: float = option(DEFAULT_DURATION, "length of the record at each level, s (default: 60)", metavar="S")
    band: str = option(
        DEFAULT_BAND,
        "band of the noise, Hz (default: 10:2000, no further than 0.4 of the sample rate)",
        metavar="LOW:HIGH",
    )
    mode: int | None = option(
        None,
        "target: number of the fitted mode in the band, from 1 (default: the rig's test.mode, less one where "
        "a "
        "suspension mode lies below the band)",
        metavar="N",
    )
    near: float | None = option(None, "target: the fitted mode nearest to this frequency", metavar="HZ")
    modes: int | None = option(None, "most modes to keep (default: the rig's linear_modes)", metavar="N")
    segment: float | None = option(
        None, "length of an averaged segment, s (default: a tenth of the record)", metavar="S"
    )
    no_half_level: bool = option(False, "leave out the record at half the level")
    reference: str = option(
        "model",
        "what the report compares with; linear.json never uses it (default: the rig's model)",
        choices=("model", "none"),
    )
    exciter: int | None = exciter_option()
    seed: int | None = seed_option()
    set: tuple[str, ...] = set_option()
    pacing: str = pacing_option()
    device: str = device_option()
    one_process: bool = one_process_option()
    domain: int | None = domain_option()
    quiet: bool = quiet_option()
    page: bool = page_option()


def run(options: LinearOptions) -> int:
    """Measure, evaluate, write the results, print the modes.

    Returns:
        0 if it worked, 130 after Ctrl-C, 1 if the run was cut short.

    Raises:
        BenchError: a wrong rig or option, or a record that cannot be evaluated.
    """
    if bool(options.rig) == (options.bag is not None):
        raise BenchError("Give either a rig to measure or --bag with a recording to evaluate.")
    band = band_of(options.band)
    check_output(options.out, options.force)
    from nmt_bench.commands.console import make_console
    from nmt_bench.commands.work_display import WorkDisplay

    console = make_console()
    if options.bag is not None:
        from nmt_record.bag.bag_reader import Bag

        bag = Bag.open(options.bag)
        with WorkDisplay(console, _STEPS, options.quiet) as display:
            evaluated = _evaluate(bag, options, band)
            display.step()
            with OutputFolder(options.out, options.force) as folder:
                _write(*evaluated, folder, options)
        _show(*evaluated, options, console)
        return EXIT_DONE
    from nmt_bench.orchestration.prepared_nodes import nodes_ahead

    with nodes_ahead(not options.one_process):
        return measure_noise(options, band, console)


def measure_noise(options: LinearOptions, band: tuple[float, float], console: Any) -> int:
    """Run the random test and evaluate it; returns the exit code."""
    from nmt_bench.commands.run_command import measure, pace_line
    from nmt_bench.commands.work_display import WorkDisplay
    from nmt_bench.orchestration.interrupts import interrupts_of_kernels, terminate_as_interrupt
    from nmt_core.vocabulary import ResultCode
    from nmt_record.bag.bag_reader import Bag
    from nmt_rig.rig import load_rig
    from nmt_sequencer.level_plan import parse_levels

    rig = load_rig(options.rig, options.set)
    if options.band == DEFAULT_BAND:
        band = band[0], min(band[1], _BAND_SHARE * rig.sample_rate_hz)
    level = options.level if options.level is not None else min(parse_levels(rig.test.levels))
    if not 0.0 < level < float("inf"):
        raise BenchError(f"--level must be positive, got {level:g} V.")
    bench = bench_of(
        options,
        # The lower level first: sliders that a higher one has moved would still be displaced.
        [level] if options.no_half_level else [0.5 * level, level],
        test="random",
        band_hz=band,
        duration=options.duration,
    )
    with terminate_as_interrupt(), OutputFolder(options.out, options.force, live=True) as folder:
        result = measure(bench, console, options.quiet, options.page)
        if result.bag is None or not result.bag.exists():
            console.print(result.message, style="yellow")
            return EXIT_FAILED
        try:
            with interrupts_of_kernels(), WorkDisplay(console, _STEPS[:1], options.quiet):
                recording = Bag.open(result.bag)
                evaluated = _evaluate(recording, options, band)
        except KeyboardInterrupt:
            console.print(
                f"Stopped before the evaluation was done. The recording is in {folder / 'bag'}; './nmt linear --bag "
                f"{folder / 'bag'} --out DIR' evaluates it.",
                soft_wrap=True,
            )
            return EXIT_INTERRUPTED
        except BenchError as error:
            if result.interrupted or result.code != ResultCode.SUCCEEDED:
                console.print(result.message, style="yellow")
            raise BenchError(
                f"{str(error).rstrip('.')}. The recording is in {folder / 'bag'}; './nmt linear --bag' evaluates it "
                "again."
            ) from error
        with WorkDisplay(console, _STEPS[1:], options.quiet):
            _write(*evaluated, folder, options)
    _show(*evaluated, options, console)
    if result.code != ResultCode.SUCCEEDED:
        console.print(result.message, style="yellow")
    console.print(pace_line(result))
    if result.interrupted:
        return EXIT_INTERRUPTED
    return EXIT_DONE if result.complete else EXIT_FAILED


def band_of(text: str) -> tuple[float, float]:
    """Band of ``low:high``, Hz.

    Raises:
        BenchError: it is none.
    """
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        raise BenchError(f"--band must be LOW:HIGH in Hz as in {DEFAULT_BAND}, got '{text}'.") from None
    if not 0.0 < low < high < float("inf"):
        raise BenchError(f"--band must be LOW:HIGH with 0 < LOW < HIGH in Hz, got '{text}'.")
    return low, high


# -- evaluation -------------------------------------------------------------------------------------------------------


def _evaluate(bag: Bag, options: LinearOptions, band: tuple[float, float]) -> tuple[LinearTestResult, Rig | None]:
    """The recording's modes, and the rig it names; None where it names none."""
    from nmt_core.messages.blocks import Quantity
    from nmt_extract.linear.evaluation import evaluate_linear_test

    rig = _rig_of(bag)
    points: tuple[int, ...] | None = None if options.exciter is None else (options.exciter,)
    modes, rig_mode, quantity = options.modes, 1, None
    if rig is not None:
        points = rig.exciter_points if points is None else points
        modes = rig.extraction.linear_modes if modes is None else modes
        rig_mode = rig.test.mode
        quantity = Quantity[rig.extraction.quantity.upper()]
    result = evaluate_linear_test(
        bag,
        # The band as it is by default gives way to that of the recording.
        band_hz=None if options.band == DEFAULT_BAND else band,
        modes=2 if modes is None else modes,
        mode=options.mode,
        near_hz=options.near,
        rig_mode=rig_mode,
        exciter_points=points,
        quantity=quantity,
        segment_s=options.segment,
    )
    return result, rig


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


# -- results ----------------------------------------------------------------------------------------------------------


def _write(result: LinearTestResult, rig: Rig | None, folder: Path, options: LinearOptions) -> None:
    from nmt_extract.linear.file import frf_table
    from nmt_report.linear_report import exact_modes, linear_page

    write_whole(folder / "linear.json", json.dumps(result.to_mapping(), indent=1) + "\n")
    write_whole(folder / "frf.csv", frf_table(result.test))
    exact = exact_modes(rig) if rig is not None and options.reference == "model" else None
    write_whole(folder / "report.html", linear_page(result, rig, exact))


def _show(result: LinearTestResult, rig: Rig | None, options: LinearOptions, console: Any) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from nmt_report.linear_report import exact_modes, match
    from nmt_report.quantity_format import plain, uncertain

    test = result.test
    exact = exact_modes(rig) if rig is not None and options.reference == "model" else None
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
        console.print("Δ: deviation from the modes of the rig's model without slip.")
    plant = test.plant
    if plant is not None:
        exciter = "exciter" if len(test.force_frfs) == 1 else "exciters in the target's ratio"
        console.print(
            f"With {exciter}: {plant.frequency_hz:.4f} Hz, damping ratio {100 * plant.damping_ratio:.4f} %, "
            f"{plant.force_per_volt:.4g} N/V and {plant.displacement_per_volt:.4g} m/V at the target's frequency, "
            f"moving mass {plant.moving_mass_kg:.4g} kg.",
            soft_wrap=True,
        )
    if result.check is not None:
        style = None if result.check.is_linear else "yellow"
        console.print(result.check.sentence, style=style, soft_wrap=True)
    for line in result.remarks:
        console.print(line, style="yellow", soft_wrap=True)
    console.print(f"Results in {options.out}: linear.json, frf.csv, report.html", soft_wrap=True)
