"""``./nmt synthesis``: the frequency response that a measured backbone predicts, beside measured sweeps."""

from __future__ import annotations

import argparse
import csv
import io
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nmt_bench.commands.output_folder import OutputFolder, add_output_options, check_output
from nmt_core.errors import BenchError
from nmt_core.hardened import read_json

if TYPE_CHECKING:
    from nmt_core.linear_description import LinearDescription
    from nmt_extract.swept_response import FrequencyResponseTable
    from nmt_extract.synthesis import OtherModes, ResonanceError, Synthesis
    from nmt_report.response_figures import Overlay

    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]


def add_parser(subparsers: Subparsers) -> None:
    """Add the command and its options."""
    parser = subparsers.add_parser(
        "synthesis",
        help="frequency response from a backbone alone, beside measured sweeps",
        description=(
            "Computes the frequency response near a resonance from nothing but the measured backbone (modal frequency, "
            "damping and shape over the modal amplitude) and the residuals of the other linear modes, and compares it "
            "with measured sweeps at the same force."
        ),
    )
    parser.add_argument(
        "--backbone", metavar="RUN_OUT", type=Path, required=True, help="results folder of './nmt run', or a modal.json"
    )
    parser.add_argument(
        "--linear",
        metavar="FILE",
        type=Path,
        help="linear.json of './nmt linear', for the other modes (default: the linear modes that the run used)",
    )
    parser.add_argument(
        "--sweep",
        metavar="SWEEP_OUT",
        type=Path,
        action="append",
        default=[],
        help="results folder of './nmt sweep', or a frf.csv, to compare with; may be repeated",
    )
    parser.add_argument("--levels", metavar="F[,F2…]", help="forces, N (default: those of the sweeps)")
    for option, place, name, which in (("--from", "start", "f1", "first"), ("--to", "stop", "f2", "last")):
        parser.add_argument(
            option, dest=place, metavar=name, type=float, help=f"{which} frequency, Hz (default: that of the sweeps)"
        )
    parser.add_argument(
        "--points", metavar="N", type=int, default=801, help="frequencies of synthesis.csv (default: 801)"
    )
    add_output_options(parser, "synthesis.csv, report.html")


def run(arguments: argparse.Namespace) -> int:
    """Synthesise, compare, write, print.

    Raises:
        BenchError: files that are missing or do not go together, no force or no frequencies.
    """
    check_output(arguments.out, arguments.force)

    import numpy as np

    from nmt_bench.commands.sweep_command import comparison_lines
    from nmt_bench.commands.terminal import make_console
    from nmt_core.whole_file import write_whole
    from nmt_extract.modal_table import read_json
    from nmt_extract.response_table import read_response_csv
    from nmt_extract.synthesis import Backbone, Synthesis
    from nmt_report.response_figures import Overlay

    points, inputs = read_json(_file(arguments.backbone, "modal.json"))
    linear, others = _others(arguments.linear, inputs, _points(points))
    backbone = Backbone.from_points(points, others)
    tables = [table for path in arguments.sweep for table in read_response_csv(_file(path, "frf.csv"))]
    for table in tables:
        if table.level_unit != "N":
            raise BenchError(
                f"The sweep at {table.level:g} {table.level_unit} held no force, so it cannot be compared; sweep with "
                "'--control force'."
            )
    forces = _forces(arguments.levels, tables)
    low, high = _frequencies(arguments, tables)
    frequency = np.linspace(low, high, _count(arguments.points))
    synthesised = {force: Synthesis(backbone, linear.drive_point, others, force) for force in forces}
    remarks = [line for s in synthesised.values() for line in s.gaps(2 * math.pi * low, 2 * math.pi * high)]
    channels = _channels(tables, backbone.points)
    comparisons = _compare(tables, synthesised, channels)
    overlays = [
        Overlay("synthesis from the backbone", force, curve[0], curve[1])
        for force, s in synthesised.items()
        for curve in _curves(s, channels, low, high)
    ]
    with OutputFolder(arguments.out, arguments.force) as folder:
        write_whole(folder / "synthesis.csv", _table(synthesised, frequency, backbone.points))
        page = _report(
            arguments, inputs, backbone.modal_amplitude, others, tables, overlays, comparisons, remarks, channels
        )
        write_whole(folder / "report.html", page)
    console = make_console()
    q = backbone.modal_amplitude
    console.print(
        f"Backbone of {q.size} amplitudes, q from {q[0]:.3g} to {q[-1]:.3g} m√kg; {others.origin}.", markup=False
    )
    for line in comparison_lines(comparisons, "synthesis"):
        console.print(line, markup=False)
    for line in remarks:
        console.print(line, style="yellow", markup=False, soft_wrap=True)
    console.print(f"Results in {arguments.out}: synthesis.csv, report.html", markup=False)
    sys.stdout.flush()
    return 0


def _file(path: Path, name: str) -> Path:
    return path / name if path.is_dir() else path


def _points(points: Sequence[Any]) -> tuple[int, ...]:
    for point in points:
        if point.points:
            return tuple(point.points)
    raise BenchError("This run has no locked level, so there is no backbone to synthesise from.")


def _others(path: Path | None, inputs: dict[str, Any], points: Sequence[int]) -> tuple[LinearDescription, OtherModes]:
    """Linear description and what the other modes add."""
    from nmt_core.linear_description import LinearDescription
    from nmt_extract.synthesis import OtherModes

    if path is None:
        known = inputs.get("linear")
        if not isinstance(known, dict):
            raise BenchError("The run does not say which linear modes it used; give --linear FILE.")
        linear = LinearDescription.from_mapping(known)
        return linear, OtherModes.from_modes(linear, points)
    values = read_json(_file(path, "linear.json"), "linear description")
    return LinearDescription.from_mapping(values), OtherModes.from_file(values, points)


def _forces(text: str | None, tables: Sequence[FrequencyResponseTable]) -> list[float]:
    from nmt_sequencer.level_plan import parse_levels

    if text is not None:
        return list(parse_levels(text))
    forces = list(dict.fromkeys(table.level for table in tables))
    if not forces:
        raise BenchError("Nothing says at which force to synthesise; give --sweep SWEEP_OUT or --levels F.")
    return forces


def _frequencies(arguments: argparse.Namespace, tables: Sequence[FrequencyResponseTable]) -> tuple[float, float]:
    measured = [float(f) for table in tables for f in (table.frequency_hz.min(), table.frequency_hz.max())]
    low = arguments.start if arguments.start is not None else min(measured, default=math.nan)
    high = arguments.stop if arguments.stop is not None else max(measured, default=math.nan)
    if math.isnan(low) or math.isnan(high):
        raise BenchError("Without --sweep the frequencies must be given: --from f1 --to f2 in Hz.")
    if not 0 < low < high < math.inf:
        raise BenchError(f"--from must be below --to and both positive, got {low:g} and {high:g} Hz.")
    return low, high


def _count(points: int) -> int:
    if not 2 <= points <= 100_000:
        raise BenchError(f"--points must be 2 to 100000, got {points}.")
    return points


def _channels(tables: Sequence[FrequencyResponseTable], points: Sequence[int]) -> list[str]:
    """Response channels to show: those measured at points of the backbone, else acceleration everywhere."""
    measured = [name for table in tables[:1] for name in table.channels if int(name[1:]) in points]
    return measured or [f"a{point}" for point in points]


def _factor(channel: str, omega: Any) -> Any:
    return {"a": -(omega**2), "v": 1j * omega, "x": 1.0 + 0.0 * omega}[channel[0]]


def _curves(s: Synthesis, channels: Sequence[str], low: float, high: float) -> list[tuple[Any, Any]]:
    """Frequency (Hz) and responses (channels, k) of every curve within the frequencies."""
    import numpy as np

    found = []
    for curve in s.curves:
        hertz = curve.omega_rad_s / (2.0 * math.pi)
        inside = (hertz >= low) & (hertz <= high)
        rows = [
            _factor(name, curve.omega_rad_s) * curve.displacement[:, s.backbone.points.index(int(name[1:]))]
            for name in channels
        ]
        if np.any(inside):
            found.append((hertz[inside], np.stack(rows)[:, inside]))
    return found


def _compare(
    tables: Sequence[FrequencyResponseTable], synthesised: dict[float, Synthesis], channels: Sequence[str]
) -> list[tuple[FrequencyResponseTable, ResonanceError]]:
    import numpy as np

    from nmt_extract.synthesis import resonance_error

    found = []
    for table in tables:
        s = synthesised.get(table.level)
        if s is None or not s.curves:
            continue
        omega = 2.0 * math.pi * table.frequency_hz
        values = s.response(omega, "sweep")
        low, high = float(table.frequency_hz.min()), float(table.frequency_hz.max())
        curves = _curves(s, channels, low, high)
        for row, channel in enumerate(channels):
            if channel not in table.channels:
                continue
            column = s.backbone.points.index(int(channel[1:]))
            measured = table.frf[table.channels.index(channel)] * table.force_n
            hertz = np.concatenate([curve[0] for curve in curves])
            modulus = np.abs(np.concatenate([curve[1][row] for curve in curves]))
            computed = _factor(channel, omega) * values[:, column]
            error = resonance_error(channel, table.frequency_hz, measured, computed, (hertz, modulus))
            found.append((table, error))
    return found


def _table(synthesised: dict[float, Synthesis], frequency: Any, points: Sequence[int]) -> str:
    """``synthesis.csv``: one row a solution, largest amplitude first."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        ["force_n", "frequency_hz", "solution", "modal_amplitude"]
        + [f"a{point}_{part}" for point in points for part in ("real", "imag")]
    )
    for force, s in synthesised.items():
        for hertz in frequency:
            omega = 2.0 * math.pi * float(hertz)
            for number, (q, displacement) in enumerate(s.solutions(omega)):
                values = -(omega**2) * displacement
                parts = [repr(float(x)) for value in values for x in (value.real, value.imag)]
                writer.writerow([repr(float(force)), repr(float(hertz)), number, repr(float(q)), *parts])
    return text.getvalue()


def _report(
    arguments: argparse.Namespace,
    inputs: dict[str, Any],
    amplitudes: Any,
    others: OtherModes,
    tables: Sequence[FrequencyResponseTable],
    overlays: Sequence[Overlay],
    comparisons: Sequence[tuple[FrequencyResponseTable, ResonanceError]],
    remarks: Sequence[str],
    channels: Sequence[str],
) -> str:
    from dataclasses import replace

    from nmt_bench.commands.sweep_command import COMPARISON_HEAD, DEFINITIONS, comparison_rows
    from nmt_report.response_figures import response_figure, synthesis_figure
    from nmt_report.response_page import ResponsePage, html_figures, html_table
    from nmt_report.svg import figure_style

    shown = [
        replace(t, channels=tuple(channels), frf=t.frf[rows], frf_std=t.frf_std[rows])
        for t in tables
        for rows in [[t.channels.index(name) for name in channels]]
    ]
    with figure_style():
        if shown:
            caption = (
                "Modulus of the measured fundamental and its phase relative to the force; dashed: synthesis from the "
                "backbone alone; between: how far it lies from the measurement."
            )
            figures = [response_figure(shown, channel, overlays, caption) for channel in channels]
        else:
            figures = [synthesis_figure(overlays, row, channel) for row, channel in enumerate(channels)]
    worst = max((abs(e.amplitude_error) for _, e in comparisons), default=math.nan)
    verdict = f"Peak amplitudes within {100 * worst:.2g} % of the sweeps" if comparisons else "No sweep to compare with"
    table = html_table(COMPARISON_HEAD, comparison_rows(comparisons), "Synthesis against the sweep. " + DEFINITIONS)
    page = ResponsePage(
        kicker="Synthesis from the backbone",
        heading=str(inputs.get("rig") or arguments.backbone.name),
        subtitle="Single nonlinear mode over the measured amplitudes, and the other linear modes",
        verdict=(verdict, "partly" if remarks else "good"),
        notices=remarks,
        facts=[
            ("Backbone", f"run {inputs.get('run_id') or arguments.backbone.name}"),
            ("Amplitudes", f"{len(amplitudes)}, q from {amplitudes[0]:.3g} to {amplitudes[-1]:.3g} m√kg"),
            ("Other modes", others.origin),
            ("Sweeps", ", ".join(path.name for path in arguments.sweep)),
        ],
        sections=[
            ("responses", "Frequency responses", html_figures(figures)),
            ("errors", "Near the resonance", table if comparisons else ""),
        ],
        footer="(−Ω² + 2iΩω̃δ̃ + ω̃²) <i>q</i> e<sup>iΔΘ</sup> = φ̃₁ᴴ f₁ with ω̃, δ̃, φ̃₁ interpolated over ln <i>q</i> "
        "(piecewise cubic, monotone); nothing is extrapolated. SI units.",
    )
    return page.html()
