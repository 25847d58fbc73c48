"""``./nmt synthesis``: the frequency response that a measured backbone predicts, next to measured sweeps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nmt_bench.commands.output_folder import OutputFolder, check_output
from nmt_bench.commands.shared_options import dated_folder_option, replace_option
from nmt_core.options import needed_option, option

if TYPE_CHECKING:
    from nmt_extract.synthesis.synthesised_responses import SynthesisResult


@dataclass(frozen=True, kw_only=True)
class SynthesisOptions:
    """Computes the frequency response near a resonance from nothing but the measured backbone (modal frequency,
    damping and shape over the modal amplitude) and the residuals of the other linear modes, and compares it with
    measured sweeps at the same force."""

    backbone: Path = needed_option("results folder of './nmt run', or a modal.json", metavar="RUN_OUT")
    linear: Path | None = option(
        None,
        "linear.json of './nmt linear', for the other modes (default: the linear modes that the run used)",
        metavar="FILE",
    )
    sweep: tuple[Path, ...] = option(
        (), "results folder of './nmt sweep', or a frf.csv, to compare with; may be repeated", metavar="SWEEP_OUT"
    )
    curve: tuple[Path, ...] = option(
        (),
        "results folder of './nmt run --kind response_curve', or a modal.json, to compare with on every branch; may be "
        "repeated",
        metavar="RUN_OUT",
    )
    levels: str | None = option(None, "forces, N (default: those of sweeps and curves)", metavar="F[,F2…]")
    start: float | None = option(None, "first frequency, Hz (default: that of the sweeps)", name="--from", metavar="f1")
    stop: float | None = option(None, "last frequency, Hz (default: that of the sweeps)", name="--to", metavar="f2")
    points: int = option(801, "frequencies of synthesis.csv (default: 801)", metavar="N")
    resonance: str | None = option(
        None,
        "a secondary resonance and its isola at the forces of --levels (default: none)",
        choices=("3:1", "1:3"),
    )
    out: Path = dated_folder_option("synthesis.csv or secondary.csv, report.html", "synthesis")
    force: bool = replace_option()


def run(options: SynthesisOptions) -> int:
    """Synthesise, compare, write, print.

    Raises:
        BenchError: files that are missing or do not go together, no force or no frequencies.
    """
    check_output(options.out, options.force)
    if options.resonance:
        return _secondary(options)

    from nmt_bench.commands.console import make_console
    from nmt_bench.commands.sweep_command import comparison_lines
    from nmt_bench.commands.work_display import WorkDisplay
    from nmt_core.files.whole_file import write_whole
    from nmt_extract.synthesis.synthesised_responses import synthesise
    from nmt_sequencer.level_plan import parse_levels

    console = make_console()
    with WorkDisplay(console, ("computing the responses", "writing the report")) as display:
        result = synthesise(
            options.backbone,
            sweeps=options.sweep,
            curves=options.curve,
            linear=options.linear,
            forces=None if options.levels is None else parse_levels(options.levels),
            low_hz=options.start,
            high_hz=options.stop,
        )
        table = result.csv(options.points)
        display.step()
        with OutputFolder(options.out, options.force) as folder:
            write_whole(folder / "synthesis.csv", table)
            write_whole(folder / "report.html", _report(options, result))
    q = result.backbone.modal_amplitude
    console.print(f"Backbone of {q.size} amplitudes, q from {q[0]:.3g} to {q[-1]:.3g} m√kg; {result.others.origin}.")
    for line in comparison_lines(result.comparisons, "synthesis"):
        console.print(line)
    for found in result.measured_curves:
        console.print(found.sentence, soft_wrap=True)
    for line in result.remarks:
        console.print(line, style="yellow", soft_wrap=True)
    console.print(f"Results in {options.out}: synthesis.csv, report.html")
    return 0


def _secondary(options: SynthesisOptions) -> int:
    """Synthesise a secondary resonance from the backbone of the primary mode."""
    from nmt_bench.commands.console import make_console
    from nmt_core.errors import BenchError
    from nmt_core.files.whole_file import write_whole
    from nmt_core.messages.secondary_resonance import resonance_named
    from nmt_extract.synthesis.secondary_resonance import secondary_csv, synthesise_secondary
    from nmt_report.secondary_figures import secondary_page
    from nmt_sequencer.level_plan import parse_levels

    if options.levels is None:
        raise BenchError("Nothing says at which force the secondary resonance is; give forces: --levels F.")
    resonance = resonance_named(str(options.resonance))
    forces = parse_levels(options.levels)
    synthesis = synthesise_secondary(options.backbone, options.linear)
    console = make_console()
    table = secondary_csv(synthesis, resonance, forces)
    with OutputFolder(options.out, options.force) as folder:
        write_whole(folder / "secondary.csv", table)
        write_whole(folder / "report.html", secondary_page(synthesis, resonance, forces, options.backbone.name))
    for force in forces:
        found = synthesis.solve(resonance, force)
        if not found.modal_amplitude.size:
            console.print(f"{force:g} N: no {resonance.label} resonance within the measured amplitudes.")
            continue
        tip = float(found.modal_amplitude[0]) * synthesis.drive_shape
        told = f"{force:g} N: {found.excitation_hz[0]:.4f} Hz, {tip:.4g} m at the drive point"
        console.print(f"{told}; release from {0.5 * tip:.3g} m." if resonance.needs_release else f"{told}.")
    console.print(f"Results in {options.out}: secondary.csv, report.html")
    return 0


def _report(options: SynthesisOptions, result: SynthesisResult) -> str:
    from dataclasses import replace

    from markupsafe import Markup

    from nmt_bench.commands.sweep_command import COMPARISON_HEAD, DEFINITIONS, comparison_rows
    from nmt_report.response_figures import Overlay, response_figure, synthesis_figure
    from nmt_report.response_page import ResponsePage, html_figures, html_table
    from nmt_report.svg import figure_style

    channels, comparisons, remarks = result.channels, result.comparisons, result.remarks
    amplitudes = result.backbone.modal_amplitude
    overlays = [
        Overlay("synthesis from the backbone", force, hertz, responses)
        for force in result.synthesised
        for hertz, responses in result.curves(force)
    ]
    shown = [
        replace(t, channels=tuple(channels), frf=t.frf[rows], frf_std=t.frf_std[rows])
        for t in result.tables
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
        heading=str(result.inputs.get("rig") or options.backbone.name),
        subtitle="Single nonlinear mode over the measured amplitudes, and the other linear modes",
        verdict=(verdict, "partly" if remarks else "good"),
        notices=remarks,
        facts=[
            ("Backbone", f"run {result.inputs.get('run_id') or options.backbone.name}"),
            ("Amplitudes", f"{len(amplitudes)}, q from {amplitudes[0]:.3g} to {amplitudes[-1]:.3g} m√kg"),
            ("Other modes", result.others.origin),
            ("Sweeps", ", ".join(path.name for path in options.sweep)),
        ],
        sections=[
            ("responses", "Frequency responses", html_figures(figures)),
            ("errors", "Near the resonance", table if comparisons else Markup("")),
            (
                "curves",
                "Along response curves",
                Markup("").join(Markup("<p>{}</p>").format(found.sentence) for found in result.measured_curves),
            ),
        ],
        footer=Markup(
            "(−Ω² + 2iΩω̃δ̃ + ω̃²) <i>q</i> e<sup>iΔΘ</sup> = φ̃₁ᴴ f₁ with ω̃, δ̃, φ̃₁ interpolated over ln <i>q</i> "
            "(piecewise cubic, monotone); nothing is extrapolated. SI units."
        ),
    )
    return page.html()
