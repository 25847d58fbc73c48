"""``report.html`` of a linear modal test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_extract.linear.evaluation import LinearTestResult
from nmt_extract.linear.file import synthesis_correlation
from nmt_extract.linear.residuals import modal_receptance
from nmt_extract.linear.results import LinearMode, LinearTest
from nmt_extract.modal.quantities import estimated_mass
from nmt_report.figure_parts import plot_panels, report_figure
from nmt_report.html_page import Table, subtitle
from nmt_report.quantity_format import duration, plain, significant, uncertain
from nmt_report.response_page import ResponsePage, text_table
from nmt_report.svg import BLUE, GREEN, INK, MUTED, ORANGE, RED, ReportFigure, figure_style

if TYPE_CHECKING:
    from nmt_rig.rig import Rig

_CURVE_POINTS = 700
_LOW_COHERENCE = 0.9  # mean partial coherence below which the page names response and input
_COLOURS = (BLUE, GREEN, RED, INK)  # of the inputs


@dataclass(frozen=True, eq=False)
class ExactModes:
    """Sticking modes of a rig's model: frequencies (Hz), damping ratios, shapes (points × modes), point numbers."""

    frequency_hz: FloatArray
    damping_ratio: FloatArray
    shapes: FloatArray
    points: tuple[int, ...]


@dataclass(frozen=True)
class ModeErrors:
    """A measured mode against the model's nearest: relative errors, 1 − MAC, and that mode."""

    frequency: float
    damping: float
    mac_defect: float
    scale: float
    exact_frequency_hz: float
    exact_damping_ratio: float


def exact_modes(rig: Rig) -> ExactModes:
    """Modes of the rig's model with friction sticking."""
    from nmt_rig.model.linear_modes import sticking_modes
    from nmt_rig.rig_model import build_elements, build_structure

    structure = build_structure(rig)
    modes = sticking_modes(structure, build_elements(rig, structure))
    return ExactModes(np.asarray(modes.frequencies / (2.0 * np.pi)), modes.damping_ratios, modes.shapes, modes.points)


def match(mode: LinearMode, exact: ExactModes, points: Sequence[int]) -> ModeErrors:
    """Errors of a measured mode against the model's mode nearest in frequency."""
    index = int(np.argmin(np.abs(exact.frequency_hz - mode.frequency_hz)))
    shape = exact.shapes[[exact.points.index(point) for point in points], index]
    product = float(mode.shape @ shape)
    own, other = float(mode.shape @ mode.shape), float(shape @ shape)
    return ModeErrors(
        float(mode.frequency_hz / exact.frequency_hz[index] - 1.0),
        float(mode.damping_ratio / exact.damping_ratio[index] - 1.0),
        float(1.0 - product**2 / (own * other)),
        float(abs(product) / other - 1.0),
        float(exact.frequency_hz[index]),
        float(exact.damping_ratio[index]),
    )


def linear_page(result: LinearTestResult, rig: Rig | None = None, exact: ExactModes | None = None) -> str:
    """The whole page.

    Args:
        result: of :func:`nmt_extract.evaluate_linear_test`.
        rig: rig of the recording; None where it is not known.
        exact: modes of the rig's model to compare with; None where there is none.
    """
    test = result.test
    with figure_style():
        responses = [_response_figure(test, row) for row in range(len(test.points))]
        details = [_target_figure(test), _coherence_figure(test), _diagram_figure(test), _shape_figure(test)]
    target = test.target_mode
    name = rig.name if rig is not None else str(result.run.get("rig") or "Recording")
    check = result.check
    kind = "good" if check is None or check.is_linear else "partly"
    text = f"{len(test.modes)} modes identified and mass-normalised"
    if check is not None:
        text += (
            "; the response is linear at this level"
            if check.is_linear
            else "; the response is not linear at this level"
        )
    cards = [
        (
            "Target mode",
            f"{plain(target.frequency_hz, 4)} Hz",
            f"± {significant(target.frequency_std, 1)} Hz, scatter only; bias is not included",
        ),
        (
            "Damping ratio",
            f"{plain(100 * target.damping_ratio, 4)} %",
            f"± {significant(100 * target.damping_std, 1)} %, scatter only; bias is not included",
        ),
    ]
    if test.plant is not None:
        plant = test.plant
        cards.append(
            (
                "Target mode, exciter attached",
                f"{plain(plant.frequency_hz, 3)} Hz",
                f"{plain(100 * plant.damping_ratio, 3)} %",
            )
        )
    facts = [
        ("Run", str(result.run.get("run_id") or "")),
        ("Started", str(result.run.get("started") or "").replace("T", " ")),
        ("Exciter", f"at {_points(test)}"),
        ("Level", "" if result.level is None else f"{significant(result.level)} V rms"),
        ("Band", f"{test.settings.band_hz[0]:g} to {test.settings.band_hz[1]:g} Hz"),
        ("Record", duration(test.duration_s)),
        ("Averages", f"{test.force_frfs[0].independent_averages:.0f} effective (overlapping), Hann window"),
        (
            "Fitted",
            "responses over force" if test.reference == "force" else "responses and forces over voltage, then divided",
        ),
    ]
    page = ResponsePage(
        kicker="Linear modal test",
        heading=name,
        subtitle=subtitle(result.run, "" if rig is None else rig.description),
        verdict=(text, kind),
        cards=cards,
        facts=facts,
        notices=[*result.remarks, *coherence_remarks(test)],
        footer=Markup(
            "Receptance: displacement over force. Convention: x(t) = Re X e<sup>iωt</sup>. ± standard uncertainty. SI "
            "units."
        ),
    )
    return page.html(
        "linear_report.html",
        mode_tables=_mode_tables(test, exact),
        linearity=check.sentence if check is not None else "",
        responses=responses,
        details=details,
        mac=[_input_table(test), _mac_table(test)],
        residual_tables=[_residual_table(test), _mass_table(test)],
    )


def coherence_remarks(test: LinearTest) -> list[str]:
    """Of several exciters a sentence for every response and force whose mean partial coherence is low."""
    if len(test.force_frfs) == 1:
        return []
    return [
        f"The partial coherence of point {point} with the exciter at point {exciter} is {mean:.2f} in the mean: noise, "
        "or little of that force in the response."
        for exciter, frf in zip(test.settings.exciter_points, test.force_frfs, strict=True)
        for point, mean in zip(test.points, frf.coherence.mean(axis=1), strict=False)
        if mean < _LOW_COHERENCE
    ]


def _points(test: LinearTest) -> str:
    points = test.settings.exciter_points
    return f"point{'s' if len(points) > 1 else ''} {', '.join(map(str, points))}"


# -- tables -----------------------------------------------------------------------------------------------------------


def _mode_tables(test: LinearTest, exact: ExactModes | None) -> list[Table]:
    head = [
        ("Mode", ""),
        ("Frequency", "Hz"),
        ("Damping ratio", "%"),
        ("φ at the drive point", "1/√kg"),
        ("Complexity", "%"),
        ("Explained", "%"),
        ("From averages: f", "Hz"),
        ("ζ", "%"),
    ]
    rows, errors_rows = [], []
    for index, mode in enumerate((*test.modes, *test.further_modes)):
        kept = index < len(test.modes)
        name = f"{index + 1}" + (", target" if index == test.target else "") if kept else "not kept"
        row = [
            name,
            uncertain(mode.frequency_hz, mode.frequency_std),
            uncertain(100 * mode.damping_ratio, 100 * mode.damping_std),
            uncertain(mode.drive_shape, mode.drive_shape_std),
            plain(100 * mode.complexity, 1),
            plain(100 * mode.coherence, 3),
            plain(mode.averaged.frequency_hz, 3),
            plain(100 * mode.averaged.damping_ratio, 3),
        ]
        if exact is not None:
            errors = match(mode, exact, test.points)
            errors_rows.append(
                [
                    name,
                    plain(errors.exact_frequency_hz, 4),
                    plain(100 * errors.exact_damping_ratio, 4),
                    plain(100 * errors.frequency, 4),
                    plain(100 * errors.damping, 3),
                    significant(errors.mac_defect, 2),
                    plain(100 * errors.scale, 3),
                ]
            )
        rows.append(row)
    note = (
        "Explained: share of the response’s power around the mode that the fit explains. From averages: starting "
        "values, from Hann-windowed averages; the window adds to their damping. Complexity: ‖Im ψ‖/‖ψ‖."
    )
    if test.further_modes:
        note += f" Not kept: further modes than the {len(test.modes)} that were asked for."
    tables = [text_table(head, rows, note), _shape_table(test)]
    if exact is not None:
        head = [
            ("Against the model", ""),
            ("Model: f", "Hz"),
            ("ζ", "%"),
            ("Δf", "%"),
            ("Δζ", "%"),
            ("1 − MAC", ""),
            ("Δscale", "%"),
        ]
        note = "Compared with the linear modes of the rig’s model (joints stick); the identification does not use them."
        tables.append(text_table(head, errors_rows, note))
    return tables + _plant_tables(test)


def _shape_table(test: LinearTest) -> Table:
    head = [("Mass-normalised shape at", ""), *((f"mode {index + 1}", "1/√kg") for index in range(len(test.modes)))]
    rows = [
        [f"point {point}", *(uncertain(float(m.shape[row]), float(m.shape_std[row])) for m in test.modes)]
        for row, point in enumerate(test.points)
    ]
    return text_table(head, rows)


def _plant_tables(test: LinearTest) -> list[Table]:
    plant = test.plant
    if plant is None:
        return []
    ratio = "" if len(test.force_frfs) == 1 else ", all exciters in the ratio that isolates it"
    rows = [
        ["Frequency with exciter", f"{uncertain(plant.frequency_hz, plant.frequency_std)} Hz"],
        ["Damping ratio with exciter", f"{uncertain(100 * plant.damping_ratio, 100 * plant.damping_std)} %"],
        [f"Force at the target’s frequency{ratio}", f"{significant(plant.force_per_volt, 5)} N/V"],
        ["Drive-point displacement there", f"{significant(plant.displacement_per_volt, 5)} m/V"],
        ["Moving mass of the exciter", f"{significant(plant.moving_mass_kg, 3)} kg"],
    ]
    return [text_table([("Plant: structure and exciter", ""), ("", "")], rows)]


def _input_table(test: LinearTest) -> Table:
    """Force per volt at the target, and the mean coherence of every response."""
    exciters = test.settings.exciter_points
    line = int(np.argmin(np.abs(test.frequency_hz - test.target_mode.frequency_hz)))
    volts = exciters if test.voltage_frfs else ()
    head = [
        ("Force at", ""),
        *((f"force per volt, exciter at point {point}", "N/V") for point in volts),
        *((f"γ², point {point}", "mean") for point in test.points),
    ]
    per_volt = test.force_per_volt()[0][line] if volts else np.empty((len(exciters), 0))
    rows = [
        [
            f"point {exciter}",
            *(significant(abs(value), 4) for value in per_volt[row]),
            *(plain(float(value), 4) for value in frf.coherence[: len(test.points)].mean(axis=1)),
        ]
        for row, (exciter, frf) in enumerate(zip(exciters, test.force_frfs, strict=True))
    ]
    note = (
        f"Force per volt by averaged spectra at {test.frequency_hz[line]:.5g} Hz, which the window smears. γ²: mean "
        "coherence, partial with several forces."
    )
    return text_table(head, rows, note)


def _mac_table(test: LinearTest) -> Table:
    shapes = np.column_stack([mode.complex_shape for mode in test.modes])
    norms = np.sum(np.abs(shapes) ** 2, axis=0)
    mac = np.abs(shapes.conj().T @ shapes) ** 2 / np.outer(norms, norms)
    head = [("MAC", ""), *((f"mode {index + 1}", "") for index in range(len(test.modes)))]
    rows = [[f"mode {index + 1}", *(plain(float(value), 4) for value in row)] for index, row in enumerate(mac)]
    return text_table(
        head,
        rows,
        "Between the identified modes at the response points; with few points off-diagonal values are not near 0.",
    )


def _residual_table(test: LinearTest) -> Table:
    head = [
        ("Response", ""),
        ("Lower", "1/kg"),
        ("Upper", "m/N"),
        ("Lower, target alone", "1/kg"),
        ("Upper, target alone", "m/N"),
        ("Correlation, measured and synthesised", ""),
    ]
    correlation = synthesis_correlation(test)
    whole, alone = test.residuals, test.target_residuals
    exciters = test.settings.exciter_points
    names = [
        f"point {point}" + (f", force at {exciter}" if len(exciters) > 1 else "")
        for exciter in exciters
        for point in test.points
    ]
    rows = [
        [
            name,
            *(_complex(values[row]) for values in (whole.lower, whole.upper, alone.lower, alone.upper)),
            plain(float(correlation[row]), 6),
        ]
        for row, name in enumerate(names)
    ]
    note = (
        "x/F = modes + lower/(−ω²) + upper. Bands of the fits: "
        f"all kept modes {whole.band_hz[0]:.4g} to {whole.band_hz[1]:.4g} Hz; "
        f"target alone {alone.band_hz[0]:.4g} to {alone.band_hz[1]:.4g} Hz."
    )
    return text_table(head, rows, note)


def _complex(value: complex) -> str:
    sign = "+" if value.imag >= 0 else "−"
    return f"{significant(value.real, 3)} {sign} {significant(abs(value.imag), 3)} i"


def _mass_table(test: LinearTest) -> Table:
    head = [("Estimated mass", "kg"), *((f"point {point}", "") for point in test.points)]
    rows = [
        [f"point {point}", *(significant(float(value), 4) for value in row)]
        for point, row in zip(test.points, estimated_mass(test.shapes), strict=True)
    ]
    return text_table(
        head, rows, f"Mass matrix by the kept modes, (Φᵀ)⁺ Φ⁺, of rank {len(test.modes)}: not the masses at the points."
    )


# -- figures ----------------------------------------------------------------------------------------------------------


def thinned(frequency: FloatArray, values: ComplexArray) -> tuple[FloatArray, ComplexArray]:
    """At most a few hundred lines, even over the logarithm of frequency, of every stretch its largest value."""
    if frequency.size <= _CURVE_POINTS:
        return frequency, values
    edges = np.unique(
        np.searchsorted(frequency, np.geomspace(frequency[0], frequency[-1], _CURVE_POINTS)).clip(0, frequency.size - 1)
    )
    bounds = np.append(edges, frequency.size)
    index = [low + int(np.argmax(np.abs(values[low:high]))) for low, high in pairwise(bounds)]
    return frequency[index], values[index]


def _two_axes() -> tuple[Figure, Any, Any]:
    figure, (top, bottom) = plot_panels(
        (6.3, 4.6), 2, 1, {"sharex": True, "height_ratios": (1.8, 1)},
        left=0.13, right=0.97, bottom=0.11, top=0.97, hspace=0.1,
    )  # fmt: skip
    bottom.set_xlabel("frequency (Hz)")
    bottom.set_ylabel("phase (°)")
    bottom.set_ylim(-235, 145)
    bottom.set_yticks([-180, -90, 0, 90])
    return figure, top, bottom


def phase_degrees(values: ComplexArray, lowest: float = -225.0) -> FloatArray:
    """Degrees in one turn upwards of a lowest value; from −225 on, 0, −90 and −180 lie far from the ends."""
    return np.asarray((np.degrees(np.angle(values)) - lowest) % 360.0 + lowest)


def _response_figure(test: LinearTest, row: int) -> ReportFigure:
    point = test.points[row]
    figure, top, bottom = _two_axes()
    frequency = test.frequency_hz
    low, high = test.residuals.band_hz
    inside = (frequency >= low) & (frequency <= high)
    exciters = test.settings.exciter_points
    measured, synthesis = test.receptance(), test.synthesis()
    for number, exciter in enumerate(exciters):
        label = f", force at point {exciter}" if len(exciters) > 1 else ""
        style = "-" if number == 0 else "--"
        for lines, values, colour, name, width in (
            (frequency, measured[number, row], _COLOURS[number % len(_COLOURS)], "measured" + label, 1.6),
            (frequency[inside], synthesis[number, row, inside], ORANGE, "modes and residuals" + label, 1.0),
        ):
            f, h = thinned(lines, values)
            top.loglog(f, np.abs(h), color=colour, linewidth=width, linestyle=style, label=name)
            bottom.semilogx(f, phase_degrees(h), color=colour, linewidth=width, linestyle=style)
    top.set_ylabel("receptance (m/N)")
    top.legend(loc="lower left")
    caption = f"Displacement at point {point} over force at {_points(test)}."
    title = f"Receptance of point {point}"
    return report_figure(figure, f"frf-{point}", title, caption, label=f"{title} over frequency")


def _target_figure(test: LinearTest) -> ReportFigure:
    """Estimators around the target, where the force drops out, and the fit."""
    target = test.target_mode
    figure, top, bottom = _two_axes()
    strongest = int(np.argmax(np.abs(target.drive_shapes)))
    frf, drive_shape = test.force_frfs[strongest], float(target.drive_shapes[strongest])
    spacing = float(frf.frequency_hz[1] - frf.frequency_hz[0])
    width = max(8.0 * target.damping_ratio * target.frequency_hz, 12.0 * spacing)
    use = np.abs(frf.frequency_hz - target.frequency_hz) <= width
    powers = {"DISPLACEMENT": 0, "VELOCITY": 1, "ACCELERATION": 2}
    row = int(np.argmax(np.abs(target.shape)))
    # At resonance the phase is −90° or 90°; the cut lies opposite.
    lowest = -270.0 if target.shape[row] * drive_shape > 0 else -90.0
    factor = (2j * np.pi * frf.frequency_hz[use]) ** -powers[test.quantity.name]
    for values, colour, label, style in (
        (frf.h1, BLUE, "H1", "-"),
        (frf.h2, RED, "H2", "--"),
        (frf.hv, GREEN, "Hv", "-."),
        (frf.hc, MUTED, "by way of the voltage", ":"),
    ):
        if values is not None:
            h = values[row][use] * factor
            top.semilogy(frf.frequency_hz[use], np.abs(h), color=colour, linestyle=style, label=label)
            bottom.plot(frf.frequency_hz[use], phase_degrees(h, lowest), color=colour, linestyle=style)
    fine = np.linspace(target.frequency_hz - width, target.frequency_hz + width, 400)
    fitted = modal_receptance(target.shape * drive_shape, target.omega, target.damping_ratio, fine)[row]
    fitted = fitted + test.target_residuals.receptance(fine)[strongest * len(test.points) + row]
    top.semilogy(fine, np.abs(fitted), color=ORANGE, linewidth=1.0, label="fit of the whole record")
    bottom.plot(fine, phase_degrees(fitted, lowest), color=ORANGE, linewidth=1.0)
    bottom.set_yticks([lowest + 90.0, lowest + 180.0, lowest + 270.0])
    bottom.set_ylim(lowest + 45.0, lowest + 315.0)
    top.set_ylabel("receptance (m/N)")
    top.legend(loc="upper right")
    caption = "Measured: averaged spectra, broadened by the window. Fit: to the record without a window."
    title = f"Target mode at point {test.points[row]}"
    return report_figure(figure, "target", title, caption, label="Frequency response around the target mode")


def _coherence_figure(test: LinearTest) -> ReportFigure:
    count = len(test.force_frfs)
    figure, panels = plot_panels(
        (6.3, 3.4 * count), count, 1, {"squeeze": False}, left=0.13, right=0.97, bottom=0.15 / count, top=0.96
    )
    colours = [BLUE, ORANGE, GREEN, RED, INK, MUTED]
    partial = "" if count == 1 else "partial "
    for axes, frf, exciter in zip(panels[:, 0], test.force_frfs, test.settings.exciter_points, strict=True):
        for row, point in enumerate(test.points):
            # Of every stretch the lowest value: 1 − γ² is what matters.
            f, lost = thinned(frf.frequency_hz, (1.0 - frf.coherence[row]).astype(np.complex128))
            label = f"point {point}" + (f", force at {exciter}" if count > 1 else "")
            axes.semilogx(f, 1.0 - lost.real, color=colours[row % len(colours)], label=label, linewidth=1.0)
        axes.set(ylim=(-0.02, 1.05), xlabel="frequency (Hz)", ylabel=f"{partial}coherence γ²")
        axes.legend(loc="lower left", ncols=3)
    caption = (
        "Lowest coherence in each interval of frequency. Dips at narrow resonances are leakage, which the fit avoids; "
        "dips at antiresonances are noise."
    )
    title = (
        f"{partial}coherence of forces and responses".capitalize() if partial else "Coherence of force and responses"
    )
    return report_figure(figure, "coherence", title, caption, label="Coherence over frequency")


def _diagram_figure(test: LinearTest) -> ReportFigure:
    figure, axes = plot_panels((6.3, 3.8), left=0.13, right=0.97, bottom=0.14, top=0.96)
    stable: list[tuple[float, int]] = []
    loose: list[tuple[float, int]] = []
    for poles in test.diagrams[0]:
        for frequency, good in zip(poles.frequency_hz, poles.stable, strict=True):
            (stable if good else loose).append((float(frequency), poles.order))
    for entries, marker, colour, label in ((loose, ".", MUTED, "new"), (stable, "o", BLUE, "stable")):
        if entries:
            x, y = zip(*entries, strict=True)
            size = 2.0 if marker == "." else 2.6
            axes.semilogx(x, y, marker, color=colour, markersize=size, label=label, linestyle="none")
    for index, mode in enumerate((*test.modes, *test.further_modes)):
        kept = index < len(test.modes)
        axes.axvline(mode.frequency_hz, color=ORANGE if kept else MUTED, linewidth=0.8, linestyle="-" if kept else ":")
    axes.set_xlim(*test.settings.band_hz)
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel("order")
    axes.legend(loc="lower left")
    caption = (
        "Poles of the LSCF polynomials over their order; stable: frequency within 0.5 % and damping within 5 % of the "
        "order below. Lines: fitted modes, dotted where not kept."
    )
    title = "Stabilisation diagram"
    return report_figure(figure, "stabilisation", title, caption, label=title)


def _shape_figure(test: LinearTest) -> ReportFigure:
    figure = Figure(figsize=(6.3, 3.8))
    count = len(test.modes)
    for index, mode in enumerate(test.modes):
        axes: Any = figure.add_subplot(1, count, index + 1)
        limit = 1.15 * float(np.max(np.abs(mode.complex_shape)))
        for value, point in zip(mode.complex_shape, test.points, strict=True):
            axes.plot([0.0, value.real], [0.0, value.imag], color=BLUE, linewidth=1.2)
            axes.plot([value.real], [value.imag], "o", color=BLUE)
            axes.annotate(str(point), (value.real, value.imag), textcoords="offset points", xytext=(3, 4), fontsize=8)
        axes.set_xlim(-limit, limit)
        axes.set_ylim(-limit, limit)
        axes.set_aspect("equal")
        axes.set_title(f"{significant(mode.frequency_hz, 5)} Hz")
        axes.set_xlabel("Re ψ (1/√kg)")
        if index == 0:
            axes.set_ylabel("Im ψ (1/√kg)")
    figure.subplots_adjust(left=0.1, right=0.98, bottom=0.13, top=0.92, wspace=0.3)
    caption = (
        "Proportional damping gives shapes on the real axis. A phase resonance test that starts from these modes uses "
        "the real part only."
    )
    label = "Complex shapes at the response points"
    return report_figure(figure, "complexity", "Shapes in the complex plane", caption, label=label)
