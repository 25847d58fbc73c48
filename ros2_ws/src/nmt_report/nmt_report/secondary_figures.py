"""Page of a synthesised secondary resonance."""

from __future__ import annotations

import math
from collections.abc import Sequence

from markupsafe import Markup

from nmt_core.messages.secondary_resonance import SecondaryResonance
from nmt_extract.synthesis.secondary_resonance import SecondarySynthesis
from nmt_report.figure_parts import plot_panels, report_figure
from nmt_report.quantity_format import significant
from nmt_report.response_page import ResponsePage, html_figures, html_table
from nmt_report.svg import MUTED, ReportFigure, figure_style, level_colours


def secondary_figure(
    synthesis: SecondarySynthesis, resonance: SecondaryResonance, forces: Sequence[float]
) -> ReportFigure:
    """Amplitude of the resonant order over its frequency: backbone of the mode, isola, points at resonance."""
    figure, axes = plot_panels((6.3, 4.0), left=0.12, right=0.97, bottom=0.13, top=0.97)
    backbone = synthesis.backbone
    axes.plot(
        backbone.omega_rad_s / (2.0 * math.pi), backbone.modal_amplitude, color=MUTED, label="backbone of the mode"
    )
    ratio = resonance.response_order / resonance.force_order
    for force, colour in zip(forces, level_colours(len(forces)), strict=True):
        found = synthesis.solve(resonance, force)
        label = f"{significant(force)} N"
        if found.curve_hz.size:
            axes.plot(ratio * found.curve_hz, found.curve_amplitude, color=colour)
        axes.plot(ratio * found.excitation_hz, found.modal_amplitude, "o", color=colour, label=label)
    axes.set_xlabel("frequency of the resonant order / Hz")
    axes.set_ylabel("modal amplitude / m√kg")
    axes.legend(loc="upper left")
    caption = (
        f"{resonance.label} resonance from the backbone of the primary mode alone. Marks: the lag is that of resonance"
        + ("; lines: the isola." if resonance.needs_release else ".")
    )
    return report_figure(figure, "secondary", f"{resonance.label} resonance", caption)


def secondary_page(
    synthesis: SecondarySynthesis, resonance: SecondaryResonance, forces: Sequence[float], name: str
) -> str:
    """The whole HTML page."""
    rows, none = [], []
    for force in forces:
        found = synthesis.solve(resonance, force)
        if not found.modal_amplitude.size:
            none.append(f"At {significant(force)} N there is no {resonance.label} resonance within the amplitudes.")
        for amplitude, hertz in zip(found.modal_amplitude, found.excitation_hz, strict=True):
            rows.append(
                [
                    significant(force),
                    significant(float(hertz), 6),
                    significant(float(amplitude), 4),
                    significant(float(amplitude) * synthesis.drive_shape, 4),
                ]
            )
    head = (("Force", "N"), ("Excitation", "Hz"), ("Modal amplitude", "m√kg"), ("Drive point", "m"))
    with figure_style():
        figure = secondary_figure(synthesis, resonance, forces)
    amplitudes = synthesis.backbone.modal_amplitude
    page = ResponsePage(
        kicker="Synthesis of a secondary resonance",
        heading=name,
        subtitle="From the backbone of the primary mode alone",
        verdict=(f"{len(forces) - len(none)} of {len(forces)} forces have it", "partly" if none else "good"),
        notices=none,
        facts=[
            ("Resonance", resonance.label),
            ("Amplitudes", f"{len(amplitudes)}, q from {amplitudes[0]:.3g} to {amplitudes[-1]:.3g} m√kg"),
            ("Hardening", f"{significant(synthesis.hardening, 4)} rad²/s² per kg m²"),
        ],
        sections=[
            ("secondary", "Amplitude over frequency", html_figures([figure])),
            ("places", "Where the lag is that of resonance", html_table(head, rows, "Largest amplitude first.")),
        ],
        footer=Markup("Harmonic balance of two orders with ω̃² = ω₁² + κ <i>q</i>²; nothing is extrapolated. SI units."),
    )
    return page.html()
