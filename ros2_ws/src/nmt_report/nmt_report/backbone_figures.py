"""Figures of modal properties over modal amplitude: backbone, damping, appropriation, participation."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation, LogLocator, MaxNLocator, NullFormatter

from nmt_core.messages.modal_point import QUANTITIES
from nmt_extract.curves.limit_cycles import limit_cycles
from nmt_report.abscissa import Abscissa, abscissa_of
from nmt_report.columns import unit_text
from nmt_report.error_bars import joined_error_bars
from nmt_report.quantity_format import significant, uncertain
from nmt_report.run_data import RunReportData
from nmt_report.shown_levels import MOST_MARKS
from nmt_report.stated_uncertainty import std_words
from nmt_report.svg import BLUE, DOTS, GREEN, INK, MUTED, ORANGE, RED, ReportFigure, svg_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from nmt_core.messages.modal_point import ModalPoint


def frequency_figure(data: RunReportData) -> ReportFigure:
    """f̃ over q with standard uncertainties, and the deviation from the reference where there is one."""
    points = data.good_points
    abscissa = abscissa_of(data)
    x, x_std = abscissa.of_points(points)
    omega, omega_std = _column(points, "omega_rad_s")
    hertz, hertz_std = omega / (2.0 * math.pi), omega_std / (2.0 * math.pi)
    figure, main, residual = _axes_with_residual(data.reference is not None, right=0.86)
    if data.linear is not None:
        linear = data.linear.frequency_hz
        main.axhline(linear, color=MUTED, linewidth=0.9, linestyle=(0, (1, 2)))
        main.annotate(
            f"linear mode {data.linear.target_mode + 1}: {linear:.3f} Hz",
            (0.98, linear),
            xycoords=("axes fraction", "data"),
            xytext=(0, 3),
            textcoords="offset points",
            ha="right",
            va="bottom",
            color=MUTED,
            fontsize=8,
        )
        _quiet_axis(main.secondary_yaxis(1.0, functions=_scaled(linear)), "relative to the linear mode")
    _reference_line(main, data, abscissa, "omega_rad_s", 0.5 / math.pi, x)
    tips = _points(main, points, x, x_std, hertz, hertz_std, "omega_rad_s", "Hz", data.reference is None)
    main.set_ylabel(r"modal frequency $\tilde f$ / Hz")
    main.ticklabel_format(axis="y", useOffset=False)
    main.margins(y=0.08)  # room for the name of the linear mode
    if data.reference is not None:
        _deviation(residual, data, abscissa, points, omega, omega_std, 0)
    _finish(main, residual, abscissa, x)
    caption = "Modal frequency f̃ over " + abscissa.html + _bars("omega_rad_s", data) + _reference_caption(data)
    label = "Modal frequency over modal amplitude"
    return ReportFigure("backbone", "Backbone f̃(q)", caption, svg_text(figure, "backbone", label, tips))


def damping_figure(data: RunReportData) -> ReportFigure:
    """δ̃ over q with standard uncertainties, and the deviation from the reference where there is one."""
    points = data.good_points
    abscissa = abscissa_of(data)
    x, x_std = abscissa.of_points(points)
    damping, damping_std = _column(points, "damping_ratio")
    figure, main, residual = _axes_with_residual(data.reference is not None, right=0.97)
    _reference_line(main, data, abscissa, "damping_ratio", 100.0, x)
    tips = _points(
        main, points, x, x_std, 100 * damping, 100 * damping_std, "damping_ratio", "%", data.reference is None
    )
    hysteresis, hysteresis_std = _column(points, "hysteresis_damping")
    if np.any(np.isfinite(hysteresis)):
        main.errorbar(
            x,
            100 * hysteresis,
            100 * np.nan_to_num(hysteresis_std),
            fmt="s",
            markerfacecolor="white",
            color=GREEN,
            label=r"from hysteresis loops $\delta_\mathrm{hyst}$",
        )
        main.legend(loc="best")
    main.set_ylabel(r"modal damping ratio $\tilde\delta$ / %")
    feeds = bool(np.any(damping < 0.0))
    if feeds:
        _limit_cycles(main, points, x)
    else:
        main.set_ylim(bottom=0.0)
    if data.reference is not None:
        _deviation(residual, data, abscissa, points, damping, damping_std, 1, relative=not feeds)
    _finish(main, residual, abscissa, x)
    caption = "Modal damping ratio δ̃ over " + abscissa.html + _bars("damping_ratio", data) + _reference_caption(data)
    if feeds:
        caption += " Below zero the structure feeds its motion. Circles: limit cycles, filled where stable."
    label = "Modal damping ratio over modal amplitude"
    return ReportFigure("damping", "Damping δ̃(q)", caption, svg_text(figure, "damping", label, tips))


def indicator_figure(data: RunReportData) -> ReportFigure:
    """How well the mode is isolated: PBMIF, γ_F, γ_A and MAC over q, one panel each."""
    points = data.good_points
    abscissa = abscissa_of(data)
    x, x_std = abscissa.of_points(points)
    shown = [quantity for quantity in QUANTITIES if quantity.panel]
    rows = math.ceil(len(shown) / 2)
    figure = Figure(figsize=(6.3, 0.5 + 2.0 * rows))
    panels = figure.subplots(rows, 2, sharex=True)
    figure.subplots_adjust(left=0.12, right=0.97, bottom=0.12, top=0.93, hspace=0.28, wspace=0.32)
    for empty in panels.flat[len(shown) :]:
        empty.set_axis_off()
    tips: dict[str, str] = {}
    for axes, quantity in zip(panels.flat, shown, strict=False):
        name = quantity.name
        value, std = _column(points, name)
        tips |= _points(axes, points, x, x_std, value, std, name, "")
        axes.axhline(1.0, color=MUTED, linewidth=0.8)
        axes.set_title(quantity.panel, y=1.0)
        lowest = float(np.nanmin(value)) if np.any(np.isfinite(value)) else 0.9
        span = max(1.0 - lowest, 1e-4) if lowest < 1.0 - 1e-6 else 0.01  # of a rig of one point all may be 1
        axes.set_ylim(lowest - 0.25 * span, 1.0 + 0.25 * span)
        axes.yaxis.set_major_locator(MaxNLocator(4))
        axes.ticklabel_format(axis="y", useOffset=False)
        _log_x(axes, x)
    for axes in panels[-1]:
        axes.set_xlabel(abscissa.label)
    caption = Markup(
        "PBMIF: active over apparent power, 1 for a perfectly appropriated mode; γ<sub>F</sub>, "
        "γ<sub>A</sub>: fundamental content of force and drive-point acceleration, 1 without other harmonics; MAC: "
        "correlation with the linear mode, 1 for its shape. Bars: repeatability."
    )
    if any(point.force_order for point in points):
        caption += Markup(" In a secondary resonance the power enters in another order: PBMIF is small there.")
    label = "Power-based mode indicator, fundamental contents and modal assurance criterion over modal amplitude"
    return ReportFigure("indicators", "Quality of the isolation", caption, svg_text(figure, "indicators", label, tips))


def quantity_figures(data: RunReportData) -> list[ReportFigure]:
    """A figure over q of each quantity that asks for one; none where no level has a value."""
    points = data.good_points
    abscissa = abscissa_of(data)
    x, x_std = abscissa.of_points(points)
    made = []
    for quantity in QUANTITIES:
        value, std = _column(points, quantity.name)
        if not quantity.curve or not np.any(np.isfinite(value)):
            continue
        figure, main, _ = _axes_with_residual(False, right=0.97)
        unit = "" if quantity.unit == "1" else quantity.unit
        tips = _points(main, points, x, x_std, value, std, quantity.name, unit)
        main.set_ylabel(quantity.curve)
        _finish(main, None, abscissa, x)
        words = quantity.meaning[0].upper() + quantity.meaning[1:]
        caption = Markup("{} over ").format(words) + abscissa.html + _bars(quantity.name, data)
        svg = svg_text(figure, quantity.name, f"{words} over modal amplitude", tips)
        made.append(ReportFigure(quantity.name, words, caption, svg))
    return made


def participation_figure(data: RunReportData) -> ReportFigure | None:
    """Participation |Γ_j| of the linear modes and its phase over q; None without linear shapes."""
    points = data.good_points
    if not points or data.linear is None or len(points[0].participation) == 0:
        return None
    abscissa = abscissa_of(data)
    x, _ = abscissa.of_points(points)
    gamma = np.array([point.participation for point in points])
    figure = Figure(figsize=(6.3, 4.5))
    magnitude, phase = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    figure.subplots_adjust(left=0.12, right=0.97, bottom=0.12, top=0.96, hspace=0.12)
    colours = (BLUE, ORANGE, GREEN, RED, MUTED)
    look = "o-" if len(points) <= MOST_MARKS else "-"
    for mode in range(gamma.shape[1]):
        number = mode + 1
        target = " (target)" if mode == data.linear.target_mode else ""
        magnitude.plot(
            x,
            np.abs(gamma[:, mode]),
            look,
            color=colours[mode % 5],
            linewidth=1.0,
            label=f"linear mode {number}{target}",
        )
        phase.plot(x, np.degrees(np.angle(gamma[:, mode])), look, color=colours[mode % 5], linewidth=1.0)
    magnitude.set_yscale("log")
    low, high = float(np.nanmin(np.abs(gamma))), float(np.nanmax(np.abs(gamma)))
    if low > 0.1 * high > 0.0:  # of one mode |Γ| is 1 but for rounding: a decade about it
        middle = math.sqrt(low * high)
        magnitude.set_ylim(middle / math.sqrt(10.0), middle * math.sqrt(10.0))
    magnitude.set_ylabel(r"$|\Gamma|$")
    magnitude.legend(loc="best")
    phase.set_ylabel(r"$\arg\Gamma$ / °")
    phase.set_ylim(-195, 195)
    phase.set_yticks((-180, -90, 0, 90, 180))
    phase.set_xlabel(abscissa.label)
    _log_x(phase, x)
    caption = "Participation Γ = Φ⁺φ̃₁ of the linear modes in the nonlinear mode: magnitude and phase."
    label = "Participation of the linear modes over modal amplitude"
    return ReportFigure("participation", "Modal participation Γ", caption, svg_text(figure, "participation", label))


def amplitude_figure(data: RunReportData) -> ReportFigure:
    """Modal amplitude and force fundamental over the level."""
    points = data.good_points
    level = np.array([point.level for point in points])
    q, q_std = _column(points, "modal_amplitude")
    force, force_std = _column(points, "force_n")
    figure = Figure(figsize=(6.3, 4.5))
    upper, lower = figure.subplots(2, 1, sharex=True)
    figure.subplots_adjust(left=0.14, right=0.97, bottom=0.12, top=0.96, hspace=0.12)
    tips = _points(upper, points, level, None, q, q_std, "modal_amplitude", "m√kg")
    tips |= _points(lower, points, level, None, force, force_std, "force_n", "N")
    for point in data.failed_points:
        for axes in (upper, lower):
            axes.axvline(point.level, color=RED, linewidth=1.0, linestyle=(0, (4, 3)))
    if data.failed_points:
        upper.plot([], [], color=RED, linewidth=1.0, linestyle=(0, (4, 3)), label="level without a result")
        upper.legend(loc="upper left")
    upper.set_ylabel(r"$q$ / (m$\sqrt{\mathrm{kg}}$)")
    lower.set_ylabel(r"force $|F_1|$ / N")
    unit = points[0].level_unit if points else "V"
    lower.set_xlabel(f"level / {unit_text(unit)}")
    for axes in (upper, lower):
        axes.set_xscale("log")
        axes.set_yscale("log")
        decade_ticks(axes.yaxis, *axes.get_ylim())
    decade_ticks(lower.xaxis, *lower.get_xlim())
    caption = "Modal amplitude and fundamental of the excitation force at each level" + _bars("modal_amplitude", data)
    label = "Modal amplitude and force over level"
    return ReportFigure("amplitudes", "Amplitude and force", caption, svg_text(figure, "amplitudes", label, tips))


def _column(points: Sequence[ModalPoint], name: str) -> tuple[Any, Any]:
    values = np.array([getattr(point, name) for point in points], dtype=np.float64)
    stds = np.array([getattr(point, f"{name}_std") for point in points], dtype=np.float64)
    return values, stds


def _points(
    axes: Axes,
    points: Sequence[ModalPoint],
    x: Any,
    x_std: Any,
    y: Any,
    y_std: Any,
    name: str,
    unit: str,
    joined: bool = True,
) -> dict[str, str]:
    """Draw points with error bars; returns the hover texts by gid, none where there are too many to point at."""
    single = len(points) <= MOST_MARKS
    if not single and x_std is not None and not np.nanmax(x_std / x, initial=0.0) > _HIDDEN:
        x_std = None
    bars = np.nan_to_num(y_std), None if x_std is None else np.nan_to_num(x_std)
    if single:
        axes.errorbar(x, y, *bars, fmt="none", ecolor=BLUE, elinewidth=1.0, capsize=2.0, capthick=1.0)
    else:
        joined_error_bars(axes, x, y, *bars, colour=BLUE, width=1.0)
    if joined:
        axes.plot(x, y, "-", color=BLUE, linewidth=0.8, alpha=0.55)
    tips: dict[str, str] = {}
    if not single:
        axes.plot(x, y, "o", color=BLUE, gid=f"{DOTS}-{name}")
        return tips
    for point, horizontal, vertical, std in zip(points, x, y, y_std, strict=True):
        gid = f"{name}-{point.level_index}"
        axes.plot([horizontal], [vertical], "o", color=BLUE, gid=gid)
        tips[gid] = (
            f"level {point.level_index + 1}: {significant(point.level)} {unit_text(point.level_unit)}\n"
            f"q = {significant(point.modal_amplitude, 5)} m√kg\n"
            f"{_PLAIN_SYMBOLS[name]} = {uncertain(float(vertical), float(std), 6)} {unit}".rstrip()
        )
    return tips


# The abscissa spans a factor of 2.56 at least: a bar of this relative size is shorter than a mark.
_HIDDEN = 0.004
_PLAIN_SYMBOLS = {quantity.name: quantity.symbol for quantity in QUANTITIES} | {"omega_rad_s": "f̃"}


def _axes_with_residual(with_residual: bool, right: float) -> tuple[Figure, Axes, Axes | None]:
    figure = Figure(figsize=(6.3, 4.9 if with_residual else 4.2))
    if with_residual:
        main, residual = figure.subplots(2, 1, sharex=True, height_ratios=(3.2, 1))
    else:
        main, residual = figure.subplots(), None
    figure.subplots_adjust(left=0.135, right=right, bottom=0.12, top=0.95, hspace=0.1)
    return figure, main, residual


def _reference_line(main: Axes, data: RunReportData, abscissa: Abscissa, column: str, factor: float, x: Any) -> None:
    if data.reference is None:
        return
    curve = data.reference
    # The curve may go far beyond the test; show a third of a decade on each side of the measured points.
    place = abscissa.of_curve(curve)
    keep = np.ones(place.size, dtype=bool)
    if x.size:
        keep = (place > x.min() / 2.0) & (place < x.max() * 2.0)
    values = factor * getattr(curve, column)
    main.plot(place[keep], values[keep], color=INK, linewidth=1.1, label=curve.label)
    main.plot([], [], "o", color=BLUE, label="measured")
    main.legend(loc="best")


def _limit_cycles(main: Axes, points: Sequence[ModalPoint], x: Any) -> None:
    """The line of zero damping, and where it is crossed."""
    main.axhline(0.0, color=INK, linewidth=1.0)
    q = np.array([point.modal_amplitude for point in points])
    order = np.argsort(q)
    for cycle in limit_cycles(points):
        place = float(np.interp(cycle.modal_amplitude, q[order], np.asarray(x)[order]))
        main.plot([place], [0.0], "o", color=RED, markersize=9, markerfacecolor=RED if cycle.stable else "white")


def _deviation(
    residual: Axes | None,
    data: RunReportData,
    abscissa: Abscissa,
    points: Sequence[ModalPoint],
    value: Any,
    std: Any,
    column: int,
    relative: bool = True,
) -> None:
    assert residual is not None
    assert data.reference is not None
    q = np.array([point.modal_amplitude for point in points])
    reference = np.array([data.reference.at(amplitude)[column] for amplitude in q])
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = reference if relative else 1.0  # a damping ratio that may be zero: percentage points
        percent = 100.0 * (value / reference - 1.0) if relative else 100.0 * (value - reference)
        bars = 100.0 * np.nan_to_num(std) / unit
    residual.axhline(0.0, color=INK, linewidth=1.0)
    residual.errorbar(
        abscissa.of_points(points)[0],
        percent,
        np.nan_to_num(bars),
        fmt="o",
        color=BLUE,
        markersize=3.5,
        elinewidth=1.0,
        capsize=2.0,
    )
    residual.set_ylabel("dev. / %" if relative else "dev. / points")
    reach = np.abs(percent) + np.nan_to_num(bars)
    limit = 1.2 * float(np.nanmax(reach)) if np.any(np.isfinite(reach)) else 1.0
    residual.set_ylim(-max(limit, 1e-3), max(limit, 1e-3))
    residual.yaxis.set_major_locator(MaxNLocator(4, symmetric=True))


def _bars(name: str, data: RunReportData) -> str:
    """End of a caption's sentence, and what the bars are."""
    return f". Bars: {std_words(name, data.budgets)}."


def _reference_caption(data: RunReportData) -> Markup:
    below = Markup(" Below: deviation from the computed mode at the same <i>q</i>.")
    return below if data.reference is not None else Markup("")


def _finish(main: Axes, residual: Axes | None, abscissa: Abscissa, x: Any) -> None:
    lowest = main if residual is None else residual
    lowest.set_xlabel(abscissa.label)
    _log_x(lowest, x)


def _log_x(axes: Axes, x: Any) -> None:
    axes.set_xscale("log")
    good = x[np.isfinite(x) & (x > 0)]
    if good.size:
        axes.set_xlim(good.min() / 1.6, good.max() * 1.6)
    decade_ticks(axes.xaxis, *axes.get_xlim())


def decade_ticks(axis: Any, low: float, high: float) -> None:
    """Ticks of a logarithmic axis: decades, and between them 3, or 2 and 5, where the range is short."""
    decades = math.log10(high / low)
    between = (1.0, 2.0, 5.0) if decades < 0.9 else (1.0, 3.0) if decades < 1.9 else (1.0,)
    axis.set_major_locator(LogLocator(10.0, subs=between, numticks=20))
    axis.set_minor_locator(LogLocator(10.0, subs=tuple(range(2, 10)), numticks=40))
    axis.set_major_formatter(LogFormatterSciNotation(10.0, labelOnlyBase=False))
    axis.set_minor_formatter(NullFormatter())


def _scaled(unit: float) -> tuple[Callable[[Any], Any], Callable[[Any], Any]]:
    """Functions of a secondary axis in multiples of ``unit``."""
    return lambda values: values / unit, lambda values: values * unit


def _quiet_axis(axis: Any, label: str) -> None:
    axis.set_ylabel(label, color=MUTED)
    axis.tick_params(colors=MUTED, labelcolor=MUTED)
    axis.spines["right"].set_visible(True)
    axis.spines["right"].set_color(MUTED)
    axis.spines["right"].set_linewidth(0.5)
