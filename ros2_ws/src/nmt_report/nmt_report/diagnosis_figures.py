"""Figures of a diagnosis: residual maps, and curves of the measurement next to the models."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.ledger.diagnosis import ResidualGroup
from nmt_diagnose.say.words import channel_text
from nmt_report.diagnosis_curves import Course, HarmonicCourse
from nmt_report.quantity_format import significant
from nmt_report.svg import BLUE, GRID, INK, MUTED, ORANGE, ReportFigure, level_colours, svg_text

_BOUNDS = (0.0, 1.5, 2.0, 3.0, 5.0, 10.0, 30.0, 1e9)
_COLOURS = ("#f1f4f7", "#fde9c9", "#fbcf8f", "#f4a259", "#e0703a", "#b8322a", "#5c0f1e")
_MISSING = "#ffffff"
_COLUMNS = 3
_NO_CHANNEL = "frequency and phase"
_FIELDS = ("given", "refitted", "final")
_DENSE = 40  # points of a course


Colour = str | tuple[float, float, float]


@dataclass(frozen=True)
class Shown:
    """Which models a figure shows.

    Attributes:
        models: name of the field, label, colour, dashes and width of each.
        ink: colour of measured values.
    """

    models: tuple[tuple[str, str, Colour, tuple[float, ...] | None, float], ...]
    ink: Colour = INK

    @staticmethod
    def of(with_effect: bool) -> Shown:
        """Model as given and re-fitted; with the effect too where one was accepted."""
        given = ("given", "model as given", MUTED, (2.5, 1.5), 1.3)
        refitted = ("refitted", "re-fitted", ORANGE, (5.0, 1.5), 1.4)
        final = ("final", "with the effect", BLUE, None, 1.6)
        return Shown((given, refitted, final) if with_effect else (given, refitted))

    def coloured(self, colour: Colour) -> Shown:
        """One test among several: the model as given, dashed, and the last one, in one colour."""
        first, last = self.models[0], self.models[-1]
        return Shown(((*first[:2], colour, *first[3:]), (*last[:2], colour, None, 1.2)), colour)


# -- residual map -----------------------------------------------------------------------------------------------------


def residual_figure(
    groups: Sequence[ResidualGroup], test: str, number: int, with_effect: bool, label: str
) -> ReportFigure:
    """Heat map of the residual of one test: channel and harmonic over the level, a panel for each model.

    Args:
        groups: the map.
        test: name of the test.
        number: of the test, for the anchor.
        with_effect: whether there is a model with an effect.
        label: what the columns are; ``segment`` where they have no size.
    """
    mine = [group for group in groups if group.test == test]
    lines = sorted({(group.channel, group.harmonic) for group in mine}, key=lambda key: _line_key(key, mine))
    levels = sorted({group.level for group in mine})
    fields = ["as_given", "before", "after"][: 3 if with_effect else 2]
    titles = ["model as given", "parameters re-fitted", "with the effect"]
    height = 1.15 + 0.165 * max(4, len(lines))
    figure = Figure(figsize=(12.9, height))
    panels = figure.subplots(1, len(fields), sharey=True, squeeze=False)[0]
    figure.subplots_adjust(left=0.105, right=0.985, bottom=0.62 / height, top=1.0 - 0.27 / height, wspace=0.04)
    cell_map, norm = ListedColormap(list(_COLOURS)), BoundaryNorm(_BOUNDS, len(_COLOURS))
    cell_map.set_bad(_MISSING)
    harmonics = any(group.harmonic >= 0 for group in mine)
    for axes, name, title in zip(panels, fields, titles, strict=False):
        values = np.full((len(lines), len(levels)), np.nan)
        for group in mine:
            values[lines.index((group.channel, group.harmonic)), levels.index(group.level)] = getattr(group, name)
        axes.pcolormesh(np.ma.masked_invalid(values), cmap=cell_map, norm=norm, edgecolors="white", linewidth=0.8)
        axes.set_ylim(len(lines), 0)
        axes.set_title(f"{title}: {_rms_text(mine, name)}")
        axes.grid(False)
        for side in ("left", "bottom"):
            axes.spines[side].set_visible(False)
        axes.tick_params(length=0)
        _level_ticks(axes, mine, levels, label)
        for row in range(1, len(lines)):
            if lines[row][0] != lines[row - 1][0]:
                axes.axhline(row, color=MUTED, linewidth=0.8)
    panels[0].set_yticks(np.arange(len(lines)) + 0.5, [_line_text(line, harmonics) for line in lines], fontsize=7.5)
    for tick, line in zip(panels[0].get_yticklabels(), lines, strict=True):
        tick.set_fontweight("bold" if line[1] in (1, -1) else "normal")
    caption = (
        "Root-mean-square residual of each cell in standard deviations of the noise: noise alone gives about 1. "
        + _legend()
        + " A cell of two values passes 1.7 by chance in one case of twenty."
        + (Markup(" <i>n</i>: order of the harmonic.") if harmonics else "")
        + (" White: nothing measured there well enough." if len(mine) < len(lines) * len(levels) else "")
    )
    name = f"map-{number}"
    return ReportFigure(name, test, caption, svg_text(figure, name, f"Residual map of {test}"), wide=True)


def _legend() -> Markup:
    words = ["up to 1.5", "2", "3", "5", "10", "30", "more"]
    return (
        Markup(" ").join(
            Markup(
                '<span style="white-space:nowrap"><span class="swatch" style="background:{}"></span>{}</span>'
            ).format(colour, word)
            for colour, word in zip(_COLOURS, words, strict=True)
        )
        + "."
    )


def _rms_text(groups: Sequence[ResidualGroup], name: str) -> str:
    total = count = 0.0
    for group in groups:
        value = getattr(group, name)
        if math.isfinite(value):
            total += group.rows * value**2
            count += group.rows
    return f"rms {math.sqrt(total / count):.2f}" if count else "no values"


def _line_key(key: tuple[str, int], groups: Sequence[ResidualGroup]) -> tuple[int, int]:
    channels = list(dict.fromkeys(group.channel for group in groups))
    return channels.index(key[0]), 1 if key[1] == 1 else key[1] + 10


def _line_text(line: tuple[str, int], harmonics: bool) -> str:
    channel, harmonic = line
    if harmonic < 0:
        return "other spectral lines" if harmonics and channel != _NO_CHANNEL else channel
    return f"{channel}   n = {harmonic}" if harmonic == 1 else f"{harmonic}"


def _level_ticks(axes: Axes, groups: Sequence[ResidualGroup], levels: Sequence[int], label: str) -> None:
    # Rows of spectral lines carry the line's frequency for their size, all others that of the level.
    chosen = [g for g in groups if g.harmonic >= 0 or g.channel == _NO_CHANNEL] or groups
    size = {group.level: group.amplitude for group in chosen}
    places = range(0, len(levels), max(1, math.ceil(len(levels) / 8)))
    if label == "segment":
        texts = [str(levels[k] + 1) for k in places]
    else:
        texts = [significant(size.get(levels[k], math.nan), 3 if label.endswith("Hz") else 2) for k in places]
    axes.set_xticks([k + 0.5 for k in places], texts)
    axes.set_xlabel(label)


# -- curves -----------------------------------------------------------------------------------------------------------


def course_figure(
    name: str,
    title: str,
    caption: str,
    panels: Sequence[Sequence[Course | None]],
    shown: Shown,
    tests: Sequence[str] = (),
) -> ReportFigure:
    """Small multiples: above the values, below measured − model with the measurement's ±2 standard deviations.

    Args:
        name: anchor.
        title: heading.
        caption: below it.
        panels: courses of each panel, one for each test; None where a test lacks it.
        shown: models to draw.
        tests: names of several tests, each in a colour of its own; empty for one.
    """
    columns = min(_COLUMNS, len(panels))
    lines = math.ceil(len(panels) / columns)
    width = 12.9 if columns > 1 else 6.3
    names = 5.5 * sum(len(test) + 8 for test in tests) / 72.0  # of the legend, in
    head = 0.35 + 0.2 * math.ceil(names / width) if tests else 0.55
    height = 3.3 * lines + head - 0.1
    figure = Figure(figsize=(width, height))
    outer = figure.add_gridspec(
        lines, columns, left=0.95 / width, right=1.0 - 0.1 / width, top=1.0 - head / height, bottom=0.5 / height,
        hspace=0.32, wspace=0.27,
    )  # fmt: skip
    handles: dict[str, Artist] = {}
    looks = [shown.coloured(colour) for colour in level_colours(len(tests))] if tests else [shown]
    for number, panel in enumerate(panels):
        cell = outer[number // columns, number % columns]
        label = number + columns >= len(panels)
        inner = cell.subgridspec(2, 1, height_ratios=(1.25, 1.0), hspace=0.12)
        top, bottom = figure.add_subplot(inner[0]), figure.add_subplot(inner[1])
        there = [(course, look) for course, look in zip(panel, looks, strict=True) if course is not None]
        first = there[0][0]
        for course, look in there:
            _draw_values(top, course, look, handles)
            _draw_deviations(bottom, course, look, handles)
        _scales(top, bottom, [course for course, _ in there], looks[0])
        top.tick_params(labelbottom=False)
        top.set_title(first.title if len(first.title) > 3 else channel_text(first.title))
        bottom.set_xlabel(first.x_label if label else "")
        bottom.set_ylabel(f"difference\n{first.deviation_unit}" if number % columns == 0 else first.deviation_unit)
    line = matplotlib.lines.Line2D
    for test, look in zip(tests, looks, strict=False):
        handles[test] = line([], [], color=look.ink, linewidth=2.4)
    per_row = math.ceil(len(handles) * width / max(names, width))
    figure.legend(
        list(handles.values()), list(handles), loc="upper right", ncols=per_row, bbox_to_anchor=(1.0, 1.0),
        handlelength=2.6, columnspacing=1.6,
    )  # fmt: skip
    return ReportFigure(name, title, caption, svg_text(figure, name, title), wide=columns > 1)


def _draw_values(axes: Axes, course: Course, shown: Shown, handles: dict[str, Artist]) -> None:
    size = 2.0 if course.x.size > _DENSE else 4.0
    (points,) = axes.plot(course.x, course.measured, "o", markersize=size, color=shown.ink, zorder=5)
    handles.setdefault("measured", points)
    for field, label, colour, dashes, width in shown.models:
        if not course.joined:
            axes.plot(course.x, getattr(course, field), "_", color=colour, markersize=11, markeredgewidth=width)
            continue
        (line,) = axes.plot(course.x, getattr(course, field), color=colour, linewidth=width)
        if dashes:
            line.set_dashes(dashes)
        handles.setdefault(label, line)


def _draw_deviations(axes: Axes, course: Course, shown: Shown, handles: dict[str, Artist]) -> None:
    deviations, sigma = course.deviations[:3], course.deviations[3]
    order = np.argsort(course.x, kind="stable")
    if course.joined:
        band = axes.fill_between(
            course.x[order], -2.0 * sigma[order], 2.0 * sigma[order], color=GRID, linewidth=0.0, zorder=0
        )
        handles.setdefault("±2 standard deviations", band)
    else:
        axes.vlines(course.x, -2.0 * sigma, 2.0 * sigma, color=GRID, linewidth=6.0, zorder=0)
    for field, label, colour, dashes, width in shown.models:
        row = deviations[_FIELDS.index(field)]
        if not course.joined:
            axes.plot(course.x, row, "o", color=colour, markersize=3.4)
            continue
        if course.x.size > _DENSE:
            (line,) = axes.plot(course.x, row, color=colour, linewidth=0.8 * width)
        else:
            (line,) = axes.plot(course.x, row, color=colour, linewidth=width, marker="o", markersize=2.6)
        if dashes:
            line.set_dashes(dashes)
        handles.setdefault(label, line)


def _scales(top: Axes, bottom: Axes, panel: Sequence[Course], shown: Shown) -> None:
    """Axes of a panel by all its courses."""
    x = np.concatenate([course.x for course in panel])
    measured = np.concatenate([course.measured for course in panel])
    deviations = np.concatenate([course.deviations for course in panel], axis=1)
    positive = measured[np.isfinite(measured)]
    _abscissa(top, x)
    _abscissa(bottom, x)
    if panel[0].logarithmic and positive.size and positive.min() > 0.0:
        top.set_yscale("log")
        _round_ticks(top.yaxis, float(positive.min()), float(positive.max()))
    top.set_ylabel(panel[0].unit)
    bottom.axhline(0.0, color=INK, linewidth=0.7)
    _ordinate(bottom, deviations[[_FIELDS.index(field) for field, *_ in shown.models]], deviations[3])


def _ordinate(axes: Axes, deviations: FloatArray, sigma: FloatArray) -> None:
    """Linear near zero, logarithmic beyond where one model is far off and another is not."""
    finite = np.abs(deviations[np.isfinite(deviations)])
    noise = float(np.median(sigma[np.isfinite(sigma)])) if np.isfinite(sigma).any() else 0.0
    if finite.size and noise > 0.0 and finite.max() > 60.0 * noise:
        bound = 6.0 * noise
        axes.set_yscale("symlog", linthresh=bound, linscale=1.2)
        top = 10.0 ** math.ceil(math.log10(finite.max()))
        inner = float(f"{bound / 2.0:.0e}")
        decades = 10.0 ** np.arange(math.ceil(math.log10(2.0 * bound)), math.log10(top) + 1)
        ticks = [inner, *decades[:: max(1, math.ceil(decades.size / 3))]]
        used = [t for t in ticks if t <= 1.2 * finite.max()]
        axes.set_yticks([*(-t for t in reversed(used)), 0.0, *used])
        axes.set_yticklabels([*(f"−{t:g}" for t in reversed(used)), "0", *(f"{t:g}" for t in used)])
        axes.minorticks_off()
        low, high = float(np.nanmin(deviations)), float(np.nanmax(deviations))
        axes.set_ylim(min(1.6 * low, -1.1 * bound), max(1.6 * high, 1.1 * bound))
    else:
        axes.yaxis.set_major_locator(MaxNLocator(4))


def _abscissa(axes: Axes, x: FloatArray) -> None:
    finite = x[np.isfinite(x)]
    if finite.size > 1 and finite.min() > 0.0 and finite.max() > 5.0 * finite.min():
        axes.set_xscale("log")
        _round_ticks(axes.xaxis, float(finite.min()), float(finite.max()))


def _round_ticks(axis: Axis, low: float, high: float) -> None:
    """Ticks of a logarithmic axis at round numbers, written out."""
    decades = math.log10(high / low)
    steps = (1, 2, 5) if decades < 2.2 else (1,)
    candidates = [m * 10.0**e for e in range(-12, 13) for m in steps]
    ticks = [value for value in candidates if 0.95 * low <= value <= 1.05 * high]
    if len(ticks) < 2:
        ticks = [float(f"{value:.2g}") for value in (low, high)]
    axis.set_ticks(ticks, labels=[f"{value:g}" for value in ticks])
    axis.set_ticks([], minor=True)


def harmonic_figure(name: str, title: str, courses: Sequence[HarmonicCourse], shown: Shown) -> ReportFigure:
    """Magnitudes of the harmonics over the level, a panel per channel; measured points, models as lines."""
    columns = min(_COLUMNS, len(courses))
    lines = math.ceil(len(courses) / columns)
    width, height = (12.9 if columns > 1 else 6.3), 2.45 * lines + 0.5
    figure = Figure(figsize=(width, height))
    panels = figure.subplots(lines, columns, squeeze=False)
    figure.subplots_adjust(
        left=0.75 / width, right=1.0 - 0.1 / width, top=1.0 - 0.6 / height, bottom=0.5 / height, hspace=0.36, wspace=0.2
    )
    orders = sorted({order for course in courses for order in course.orders})
    colours = dict(zip(orders, level_colours(max(2, len(orders))), strict=False))
    model = shown.models[-1]
    for number, axes in enumerate(panels.flat):
        if number >= len(courses):
            axes.set_visible(False)
            continue
        course = courses[number]
        for row, order in enumerate(course.orders):
            colour = colours[order]
            seen = course.measured[row] > 2.0 * course.sigma[row]
            axes.plot(course.x[seen], course.measured[row][seen], "o", color=colour, markersize=4.2)
            axes.plot(
                course.x[~seen], course.measured[row][~seen], "o", color=colour, markersize=3.0, markerfacecolor="none",
                markeredgewidth=0.6, alpha=0.6,
            )  # fmt: skip
            (line,) = axes.plot(course.x, course.given[row], color=colour, linewidth=1.0, alpha=0.75)
            line.set_dashes((2.5, 1.5))
            axes.plot(course.x, getattr(course, model[0])[row], color=colour, linewidth=1.3)
        axes.set_yscale("log")
        tops = course.measured[np.isfinite(course.measured)]
        least = np.nanmin(course.sigma)
        axes.set_ylim(0.3 * float(least), 3.0 * max(float(tops.max(initial=0.0)), 3.0 * float(least)))
        _abscissa(axes, course.x)
        axes.set_title(channel_text(course.title))
        if number % columns == 0:
            axes.set_ylabel("share of the fundamental")
        axes.set_xlabel(course.x_label if number + columns >= len(courses) else "")
    line = matplotlib.lines.Line2D
    handles = [line([], [], color=colours[order], linewidth=2.4) for order in orders]
    texts = [f"order {order}" for order in orders]
    handles += [line([], [], color=INK, marker="o", linestyle="none", markersize=4.2)]
    handles += [line([], [], color=INK, marker="o", linestyle="none", markersize=3.2, markerfacecolor="none")]
    handles += [line([], [], color=INK, linewidth=1.0, dashes=(2.5, 1.5)), line([], [], color=INK, linewidth=1.3)]
    texts += ["measured", "within noise", "model as given", model[1]]
    figure.legend(
        handles, texts, loc="upper right", ncols=len(handles), bbox_to_anchor=(1.0, 1.0), columnspacing=1.3,
        handlelength=2.2,
    )  # fmt: skip
    caption = (
        "Magnitude of each harmonic over that of the measured fundamental. Open circles lie within two standard "
        "deviations of zero: there only the noise is seen, and a model below them is not a contradiction."
    )
    return ReportFigure(name, title, caption, svg_text(figure, name, title), wide=columns > 1)
