"""``./nmt sweep``: sine sweep or stepped sine with a held force, and the frequency responses from it."""

from __future__ import annotations

from collections.abc import Sequence
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
    latency_option,
    one_process_option,
    pacing_option,
    page_option,
    quiet_option,
    replace_option,
    seed_option,
    set_option,
)
from nmt_core.errors import BenchError
from nmt_core.options import argument, needed_option, option

if TYPE_CHECKING:
    from nmt_bench.harness import Bench
    from nmt_extract.curves.swept_response import FrequencyResponseTable
    from nmt_extract.synthesis.single_mode import ResonanceError
    from nmt_report.response_analysis import HeldForce, ModelResponse
    from nmt_session.run_result import RunResult

_MOST_STEPS = 2000


@dataclass(frozen=True, kw_only=True)
class SweepOptions:
    """Sweeps the frequency slowly while a controller holds the amplitude of the force's fundamental, records
    everything, and finds the frequency responses of all sensors by order analysis. With --stepped the frequency
    stands still at N places instead. Where the rig is simulated, the steady response of its model (harmonic
    balance) is laid over the measurement."""

    rig: str = argument("name of a rig (for example joint_resonator) or path of a rig file", metavar="RIG")
    out: Path = dated_folder_option("bag/, frf.csv, report.html, rig.yaml, run.json", "sweep")
    replace: bool = replace_option()
    levels: str = needed_option(
        "amplitudes held, one sweep each: N; with --control voltage V, with --control response m/s^2 or m",
        name="--force",
        metavar="F[,F2…]",
    )
    start: float = needed_option("first frequency, Hz", name="--from", metavar="f1")
    stop: float = needed_option("last frequency, Hz", name="--to", metavar="f2")
    rate: float = option(0.2, "sweep rate, Hz/s, without sign (default: 0.2)", metavar="r")
    stepped: int | None = option(None, "stand still at N evenly spaced frequencies instead of sweeping", metavar="N")
    direction: str = option(
        "given",
        "from the lower to the higher frequency, the reverse, or as given (default)",
        choices=("given", "up", "down"),
    )
    control: str = option("force", "amplitude that is held (default: force)", choices=("force", "voltage", "response"))
    periods: int | None = option(None, "--stepped: whole periods a window (default: the rig's)", metavar="N")
    ramp: float | None = option(None, "half-cosine to the amplitude, s (default: the rig's)", metavar="S")
    exciter: int | None = exciter_option()
    seed: int | None = seed_option()
    set: tuple[str, ...] = set_option("test.ramp_s=1")
    pacing: str = pacing_option()
    device: str = device_option()
    latency_blocks: int = latency_option()
    points: int = option(400, "frequencies of frf.csv (default: 400)", metavar="N")
    reference: str = option("model", "what to compare with (default: the model)", choices=("model", "none"))
    one_process: bool = one_process_option()
    domain: int | None = domain_option()
    quiet: bool = quiet_option()
    page: bool = page_option()


def run(options: SweepOptions) -> int:
    """Sweep, analyse, write the results, print the figures.

    Returns:
        0 if every level gave a response, 130 after Ctrl-C, 1 otherwise.

    Raises:
        BenchError: the rig, a level or an option is refused, or the nodes do not start.
    """
    levels, start, stop = checked_request(options)
    check_output(options.out, options.replace, "replace")
    from nmt_bench.orchestration.prepared_nodes import nodes_ahead

    with nodes_ahead(not options.one_process):
        return measure_sweep(options, levels, start, stop)


def measure_sweep(options: SweepOptions, levels: list[float], start: float, stop: float) -> int:
    """Sweep at each level and write the tables; returns the exit code.

    Args:
        options: of the command.
        levels: forces or voltages.
        start, stop: frequencies, Hz.
    """
    from nmt_bench.commands.console import make_console
    from nmt_bench.commands.run_command import measure
    from nmt_bench.orchestration.interrupts import terminate_as_interrupt

    bench = bench_of(
        options,
        ramp=options.ramp,
        control=options.control,
        latency_blocks=options.latency_blocks,
        **_excitation(options, levels, start, stop),
    )
    console = make_console()
    with terminate_as_interrupt(), OutputFolder(options.out, options.replace, live=True) as folder:
        result = measure(bench, console, options.quiet, options.page)
        return _finish(options, bench, result, levels, folder, console)


def checked_request(options: SweepOptions) -> tuple[list[float], float, float]:
    """Levels and frequencies in the order of the test."""
    from nmt_sequencer.level_plan import parse_levels

    levels = parse_levels(options.levels)
    start, stop = options.start, options.stop
    if not (0 < start < float("inf") and 0 < stop < float("inf") and start != stop):
        raise BenchError(f"--from and --to must be two different positive frequencies, got {start:g} and {stop:g} Hz.")
    if options.direction != "given" and (start > stop) == (options.direction == "up"):
        start, stop = stop, start
    if not 0 < options.rate < float("inf"):
        raise BenchError(f"--rate must be positive, got {options.rate:g} Hz/s; --direction says which way.")
    if options.stepped is not None and not 2 <= options.stepped <= _MOST_STEPS:
        raise BenchError(f"--stepped needs 2 to {_MOST_STEPS} frequencies, got {options.stepped}.")
    if not 10 <= options.points <= 100_000:
        raise BenchError(f"--points must be 10 to 100000, got {options.points}.")
    return levels, start, stop


def _excitation(options: SweepOptions, levels: list[float], start: float, stop: float) -> dict[str, Any]:
    """Arguments of the bench that say what is done at the levels."""
    from nmt_rig.rig import load_rig

    limit = load_rig(options.rig, options.set).limits.voltage_v
    values: dict[str, Any] = {"node_values": {"pll": {"voltage_limit": 0.95 * limit}}} if limit else {}
    if options.stepped is None:
        rate = options.rate if stop > start else -options.rate
        return {
            **values,
            "test": "sweep",
            "levels": levels,
            "frequencies_hz": (start,),
            "rate_hz_s": rate,
            "frequency_end_hz": stop,
        }
    step = (stop - start) / (options.stepped - 1)
    frequencies = [start + k * step for k in range(options.stepped)]
    return {
        **values,
        "test": "stepped_sine",
        "levels": [level for level in levels for _ in frequencies],
        "frequencies_hz": tuple(frequencies * len(levels)),
        "window_periods": options.periods,
    }


def _finish(
    options: SweepOptions, bench: Bench, result: RunResult, levels: list[float], folder: Path, console: Any
) -> int:
    """Analyse the bag, write and print."""
    from nmt_bench.commands.run_command import pace_line
    from nmt_bench.commands.work_display import WorkDisplay
    from nmt_core.files.whole_file import write_whole
    from nmt_core.vocabulary import ResultCode
    from nmt_extract.curves.response_table import write_response_csv
    from nmt_record.bag.bag_reader import Bag
    from nmt_report.response_analysis import held_force, responses_of_bag

    tables: list[FrequencyResponseTable] = []
    remarks: list[str] = []
    if result.code != ResultCode.SUCCEEDED or "not" in result.message:
        remarks.append(result.message)
    steps = "analysing the recording", "computing the model's response", "writing the report"
    with WorkDisplay(console, steps, options.quiet) as display:
        if result.bag is not None and result.bag.exists():
            try:
                tables, more = responses_of_bag(Bag.open(result.bag), options.points)
                remarks += more
            except BenchError as error:
                remarks.append(str(error))
        display.step()
        models = _model(options, bench, tables, remarks) if tables else []
        comparisons = compare(tables, models)
        forces = [held for held in map(held_force, tables) if held is not None]
        display.step()
        if tables:
            write_response_csv(tables, folder / "frf.csv")
            text = _report(options, bench, result, tables, models, comparisons, forces, remarks)
            write_whole(folder / "report.html", text)
    for line in (*force_lines(forces), *comparison_lines(comparisons, "the model's steady response")):
        console.print(line)
    for line in remarks:
        console.print(line, style="yellow", soft_wrap=True)
    if result.bench_time > 0:
        console.print(pace_line(result))
    if tables:
        console.print(f"Report: {(folder / 'report.html').resolve()}", soft_wrap=True)
    if result.interrupted:
        return EXIT_INTERRUPTED
    return EXIT_DONE if result.complete and not remarks and len(tables) == len(levels) else EXIT_FAILED


def _model(
    options: SweepOptions, bench: Bench, tables: Sequence[FrequencyResponseTable], remarks: list[str]
) -> list[ModelResponse]:
    """The model's steady responses; none where the level was no force or none is wanted."""
    if options.reference == "none" or any(table.level_unit != "N" for table in tables):
        return []
    from nmt_report.response_analysis import model_responses

    low, high = sorted((options.start, options.stop))
    try:
        return model_responses(bench.rig, [table.level for table in tables], low, high, tables[0].channels)
    except (BenchError, ArithmeticError, ValueError) as error:
        remarks.append(f"The model's response was not found, so there is nothing to compare with: {error}")
        return []


def compare(
    tables: Sequence[FrequencyResponseTable], models: Sequence[ModelResponse]
) -> list[tuple[FrequencyResponseTable, ResonanceError]]:
    """Model against measurement, every level and channel; the model takes the place of the synthesis."""
    import numpy as np

    from nmt_extract.synthesis.single_mode import resonance_error

    by_level = {model.level: model for model in models}
    found = []
    for table in tables:
        model = by_level.get(table.level)
        if model is None:
            continue
        for row, channel in enumerate(table.channels):
            computed = model.at(row, table.frequency_hz)
            curve = model.frequency_hz, np.abs(model.responses[row])
            error = resonance_error(channel, table.frequency_hz, table.frf[row] * table.force_n, computed, curve)
            found.append((table, error))
    return found


def force_lines(forces: Sequence[HeldForce]) -> list[str]:
    """Force error of each level as sentences."""
    lines = []
    for held in forces:
        way = "stepped" if held.rate_hz_s == 0 else f"{held.rate_hz_s:+.3g} Hz/s"
        lines.append(
            f"{held.level:g} N, {way}: force error {100 * held.rms:.3f} % rms, largest {100 * held.worst:+.3f} % at "
            f"{held.worst_at_hz:.2f} Hz"
        )
    return lines


def comparison_lines(comparisons: Sequence[tuple[FrequencyResponseTable, ResonanceError]], what: str) -> list[str]:
    """Errors near resonance as sentences."""
    from nmt_report.response_figures import channel_text

    return [
        f"{table.level:g} {table.level_unit}, {error.channel}: peak {error.peak_amplitude:.4g} "
        f"{channel_text(error.channel)[1]} at "
        f"{error.peak_frequency_hz:.3f} Hz; {what}: peak {100 * error.amplitude_error:+.2f} %, frequency "
        f"{100 * error.frequency_error:+.3f} %, rms in the half-power band {100 * error.rms_error:.2f} % "
        f"(magnitudes {100 * error.modulus_rms_error:.2f} %)"
        for table, error in comparisons
    ]


DEFINITIONS = (
    "Peak: largest value, by a parabola through 1/modulus² of five points (three of both, at "
    "the measured frequencies, where the band has fewer than 40). "
    "Half-power band: where the measured modulus is at least "
    "its peak over √2. Rms: root mean square of the complex difference over that band, divided by the measured peak; "
    "(magnitudes): of the difference of the magnitudes."
)


def comparison_rows(comparisons: Sequence[tuple[FrequencyResponseTable, ResonanceError]]) -> list[list[str]]:
    """Cells of the table of errors."""
    from nmt_report.quantity_format import plain, significant
    from nmt_report.response_figures import channel_text

    rows = []
    for table, e in comparisons:
        channel, unit = channel_text(e.channel)
        way = "stepped" if table.rate_hz_s == 0 else "up" if table.rate_hz_s > 0 else "down"
        rows.append(
            [
                f"{significant(table.level)} {table.level_unit}, {way}: {channel}",
                f"{significant(e.peak_amplitude)} {unit}",
                plain(e.peak_frequency_hz, 3),
                plain(100 * e.amplitude_error, 2),
                plain(100 * e.frequency_error, 3),
                plain(100 * e.rms_error, 2),
                plain(100 * e.modulus_rms_error, 2),
                f"{plain(e.band_hz[0], 2)} … {plain(e.band_hz[1], 2)}",
            ]
        )
    return rows


COMPARISON_HEAD = (
    ("Measured", ""),
    ("Peak", ""),
    ("at", "Hz"),
    ("Peak error", "%"),
    ("Frequency error", "%"),
    ("Rms", "%"),
    ("Rms, magnitudes", "%"),
    ("Half-power band", "Hz"),
)


def _report(
    options: SweepOptions,
    bench: Bench,
    result: RunResult,
    tables: Sequence[FrequencyResponseTable],
    models: Sequence[ModelResponse],
    comparisons: Sequence[tuple[FrequencyResponseTable, ResonanceError]],
    forces: Sequence[HeldForce],
    remarks: Sequence[str],
) -> str:
    from markupsafe import Markup

    from nmt_report.quantity_format import duration, plain, significant
    from nmt_report.response_figures import Overlay, force_figure, response_figure
    from nmt_report.response_page import ResponsePage, html_figures, html_table
    from nmt_report.svg import figure_style

    overlays = [
        Overlay("model, steady (harmonic balance)", model.level, model.frequency_hz, model.responses)
        for model in models
    ]
    caption = "Modulus of the fundamental and its phase relative to the force, every level." + (
        " Dashed: steady response of the rig’s model at the same force; between: how far it lies from the measurement."
        if overlays
        else ""
    )
    with figure_style():
        force = force_figure(tables)
        figures = [response_figure(tables, channel, overlays, caption) for channel in tables[0].channels]
    force_rows = [
        [
            f"{significant(h.level)} N",
            "stepped" if h.rate_hz_s == 0 else plain(h.rate_hz_s, 3),
            plain(100 * h.rms, 3),
            plain(100 * h.worst, 3),
            plain(h.worst_at_hz, 2),
        ]
        for h in forces
    ]
    force_html = (
        html_table(
            (("Force", ""), ("Rate", "Hz/s"), ("Error, rms", "%"), ("Error, largest", "%"), ("at", "Hz")),
            force_rows,
            "Fundamental of the force by order analysis, over the whole sweep once the amplitude had settled at its "
            "start.",
        )
        if forces
        else Markup("")
    )
    comparison_html = (
        html_table(
            COMPARISON_HEAD,
            comparison_rows(comparisons),
            "Model’s steady response against the measurement. "
            + DEFINITIONS
            + " A sweep at r Hz/s finds the peak of a resonance of decay δ (rad/s) about r/δ Hz late.",
        )
        if comparisons
        else Markup("")
    )
    stepped = options.stepped is not None
    start, stop = (t.frequency_hz[[0, -1]] for t in (tables[0], tables[0]))
    page = ResponsePage(
        kicker="Stepped sine" if stepped else "Controlled sweep",
        heading=bench.rig.name,
        subtitle=bench.rig.description,
        verdict=(
            f"{len(tables)} level{'s' if len(tables) > 1 else ''} measured"
            + (f", force held within {100 * max(abs(h.worst) for h in forces):.2g} %" if forces else ""),
            "partly" if remarks else "good",
        ),
        notices=remarks,
        facts=[
            ("Run", bench.test.asked.run_id),
            ("Held", {"force": "force", "voltage": "drive voltage", "response": "response"}[options.control]),
            ("Frequencies", f"{plain(float(start[0]), 2)} to {plain(float(stop[1]), 2)} Hz"),
            ("Rate", f"{options.stepped} steps" if stepped else f"{options.rate:g} Hz/s"),
            ("Exciter", f"at point {bench.rig.drive_point}"),
            ("Sampling", f"{bench.rig.sample_rate_hz:g} Hz"),
            ("Bench time", duration(result.bench_time)),
        ],
        sections=[
            ("responses", "Frequency responses", html_figures(figures)),
            ("force", "Held force", force_html + html_figures([force])),
            ("comparison", "Near the resonance", comparison_html),
        ],
        footer=Markup(
            "Fundamentals A₁ of x(t) = Re Σ A<sub>n</sub> e<sup>inθ</sup> with the recorded phase θ of the "
            "excitation. SI units."
        ),
    )
    return page.html()
