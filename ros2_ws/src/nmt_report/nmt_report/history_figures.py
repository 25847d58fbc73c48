"""Figures over bench time: signals within a level, envelopes of the whole run, frequency and phase error."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup, escape
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from nmt_core.vocabulary import LoopState
from nmt_report.columns import unit_text
from nmt_report.quantity_format import significant
from nmt_report.run_data import Excerpt, LevelStart, RunReportData
from nmt_report.shown_levels import MOST_MARKS, MOST_PANELS, shown_note, spread_evenly
from nmt_report.svg import BLUE, GREEN, INK, MUTED, ORANGE, RED, ReportFigure, ScaledNumbers, svg_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_STRIP_COLUMNS = 400
_WINDOW = "#dbe8f6"
_STATE_COLOURS = {
    LoopState.FIXED: "#c9cfd6",
    LoopState.ACQUIRING: "#f0b429",
    LoopState.LOCKED: GREEN,
    LoopState.LOCK_LOST: RED,
}
_STATE_NAMES = {
    LoopState.FIXED: "fixed",
    LoopState.ACQUIRING: "acquiring",
    LoopState.LOCKED: "locked",
    LoopState.LOCK_LOST: "lock lost",
}


def history_figure(data: RunReportData) -> ReportFigure | None:
    """Frequency, phase error and loop state over the run with locks and windows; None if not recorded."""
    history = data.history
    if history is None or history.sample.size == 0:
        return None
    time = history.sample / data.sample_rate
    figure = Figure(figsize=(12.9, 5.4))
    strip, frequency, phase = figure.subplots(3, 1, sharex=True, height_ratios=(0.16, 1.25, 1))
    figure.subplots_adjust(left=0.062, right=0.985, bottom=0.105, top=0.93, hspace=0.1)
    _state_strip(strip, time, history.state)
    active = history.frequency_hz > 0.0
    hertz = np.where(active, history.frequency_hz, np.nan)
    _windows(frequency, data)
    _windows(phase, data)
    frequency.plot(*thinned(time, hertz), color=BLUE, linewidth=1.2)
    if not _crowded(data):
        for lock in data.locks:
            frequency.axvline(lock.sample / data.sample_rate, color=GREEN, linewidth=0.8)
            phase.axvline(lock.sample / data.sample_rate, color=GREEN, linewidth=0.8)
        frequency.plot([], [], color=GREEN, linewidth=0.8, label="lock")
        frequency.fill_between([], [], [], facecolor=_WINDOW, edgecolor="#8fb3da", linewidth=0.7, label="window")
    _lost_spans((frequency, phase), time, history.state)
    if np.any(history.state == LoopState.LOCK_LOST):
        frequency.fill_between([], [], [], color=RED, alpha=0.14, label="lock lost")
    if frequency.get_legend_handles_labels()[0]:
        frequency.legend(loc="upper right", ncols=3, frameon=True, facecolor="white", framealpha=0.9, edgecolor="none")
    _level_numbers(strip, data)
    _level_starts((frequency, phase), data)
    frequency.set_ylabel("excitation frequency / Hz")
    frequency.ticklabel_format(axis="y", useOffset=False)
    # With the drive off the phase means nothing.
    degrees = np.degrees(np.where(history.state == LoopState.FIXED, np.nan, history.phase_error))
    phase.axhline(0.0, color=MUTED, linewidth=0.8)
    phase.plot(*thinned(time, degrees), color=ORANGE, linewidth=1.0)
    # Transients after a level step reach tens of degrees; a mixed scale keeps the locked stretches visible
    # too.
    phase.set_yscale("symlog", linthresh=1.0, linscale=1.0)
    largest = float(np.nanmax(np.abs(degrees))) if np.any(np.isfinite(degrees)) else 1.0
    limit = max(3.0, 1.3 * largest)
    ticks = [tick for tick in (-180.0, -10.0, -1.0, 0.0, 1.0, 10.0, 180.0) if abs(tick) <= limit]
    phase.set_ylim(-limit, limit)
    phase.set_yticks(ticks, [f"{tick:g}".replace("-", "−") for tick in ticks])
    phase.minorticks_off()
    phase.set_ylabel("phase error / °")
    phase.set_xlabel("bench time / s")
    phase.set_xlim(0.0, data.end_sample / data.sample_rate or float(time[-1]))
    marks = "Green lines: confirmed locks; blue bands: the windows that were extracted; numbers: levels."
    caption = (
        f"Top: state of the loop. {_CROWDED if _crowded(data) else marks} Phase error: phase of the force against "
        "the velocity at the drive point; the axis is linear within ±1° and logarithmic beyond."
    )
    label = "Loop state, excitation frequency and phase error over bench time"
    return ReportFigure(
        "history",
        "Excitation frequency and phase error over the run",
        caption,
        svg_text(figure, "history", label),
        wide=True,
    )


def envelope_figure(data: RunReportData) -> ReportFigure | None:
    """Envelopes of voltage, force and response over the run; None if nothing was recorded."""
    if not data.envelopes:
        return None
    count = len(data.envelopes)
    figure = Figure(figsize=(12.9, 1.2 + 1.35 * count))
    panels = np.atleast_1d(figure.subplots(count, 1, sharex=True))
    bottom = 0.55 / figure.get_figheight()
    figure.subplots_adjust(left=0.062, right=0.985, bottom=bottom, top=1.0 - 0.35 / figure.get_figheight(), hspace=0.12)
    for axes, envelope, colour in zip(panels, data.envelopes, (MUTED, BLUE, ORANGE, GREEN), strict=False):
        _windows(axes, data)
        time = envelope.sample / data.sample_rate
        time, low, high = _merged(time, envelope.low, envelope.high)
        axes.fill_between(time, low, high, color=colour, linewidth=0.4)
        axes.set_ylabel(f"{envelope.symbol} / {unit_text(envelope.unit)}")
        axes.yaxis.set_major_locator(MaxNLocator(5, symmetric=True))
        axes.yaxis.set_major_formatter(ScaledNumbers((-3, 4)))
    _level_starts(panels, data)
    _level_numbers(panels[0], data, above=True)
    panels[-1].set_xlabel("bench time / s")
    panels[-1].set_xlim(0.0, data.end_sample / data.sample_rate or None)
    marks = f". {_CROWDED}" if _crowded(data) else "; blue bands: the extracted windows."
    caption = f"Smallest and largest values of the signals over the run{marks}"
    label = "Envelopes of drive voltage, force and response over bench time"
    return ReportFigure(
        "envelope", "Signals over the whole run", caption, svg_text(figure, "envelope", label), wide=True
    )


def excerpt_figure(data: RunReportData) -> ReportFigure | None:
    """A few periods of force and drive-point response at each level; None if nothing was recorded."""
    chosen = chosen_excerpts(data.excerpts)
    if not chosen:
        return None
    columns = min(4, len(chosen))
    rows = -(-len(chosen) // columns)
    height = 0.75 + 1.75 * rows
    figure = Figure(figsize=(12.9, height))
    panels = np.atleast_1d(figure.subplots(rows, columns, sharex=True)).ravel()
    figure.subplots_adjust(
        left=0.055, right=0.945, bottom=0.5 / height, top=1.0 - 0.3 / height, hspace=0.36, wspace=0.4
    )
    for index, (axes, excerpt) in enumerate(zip(panels, chosen, strict=False)):
        last = index % columns == columns - 1 or index == len(chosen) - 1
        _excerpt(axes, excerpt, first_column=index % columns == 0, last_column=last)
    for axes in panels[len(chosen) :]:
        axes.set_visible(False)
    for index in range(len(chosen)):
        if index + columns >= len(chosen):
            panels[index].set_xlabel("time in the window / periods")
            panels[index].tick_params(labelbottom=True)
    some = shown_note(len(chosen), max(len(data.excerpts), data.excerpts_of))
    symbol = chosen[0].response_symbol
    caption = (
        "Force (blue, left axis, N) and response "
        + _html_symbol(symbol)
        + f" at the drive point (orange, right axis) at the start of each window.{some}"
    )
    label = "Force and drive-point response over a few periods at every level"
    return ReportFigure("signals", "Force and response in time", caption, svg_text(figure, "signals", label), wide=True)


def chosen_excerpts(excerpts: Sequence[Excerpt]) -> list[Excerpt]:
    """At most :data:`MOST_PANELS` excerpts, spread evenly over the levels, the first and last among them."""
    return spread_evenly(excerpts, MOST_PANELS)


def thinned(x: Any, y: Any, stretches: int = 1200) -> tuple[Any, Any]:
    """Keep the smallest and largest value of each of ``stretches`` stretches, so that no peak is lost.

    Args:
        x, y: shape ``(n,)``; NaN in ``y`` are gaps.
        stretches: number of stretches.

    Returns:
        x and y with at most ``2 · stretches`` entries, in the order of x; unchanged if there are no more
        than that.
    """
    count = len(x)
    if count <= 2 * stretches:
        return x, y
    keep: list[int] = []
    edges = np.linspace(0, count, stretches + 1).astype(int)
    for first, stop in itertools.pairwise(edges):
        part = y[first:stop]
        if np.all(np.isnan(part)):
            keep.append(first)
        else:
            keep.extend(sorted({first + int(np.nanargmin(part)), first + int(np.nanargmax(part))}))
    return x[keep], y[keep]


def _merged(time: Any, low: Any, high: Any, stretches: int = 1200) -> tuple[Any, Any, Any]:
    """Join neighbouring stretches of an envelope until there are at most ``stretches``."""
    count = len(time)
    if count <= stretches:
        return time, low, high
    edges = np.linspace(0, count, stretches + 1).astype(int)[:-1]
    return time[edges], np.fmin.reduceat(low, edges), np.fmax.reduceat(high, edges)


def _excerpt(axes: Axes, excerpt: Excerpt, first_column: bool, last_column: bool) -> None:
    periods = np.arange(excerpt.force.size) / excerpt.sample_rate * excerpt.frequency_hz
    other = axes.twinx()
    other.plot(periods, excerpt.response, color=ORANGE, linewidth=1.2)
    axes.plot(periods, excerpt.force, color=BLUE, linewidth=1.2)
    for side, values, colour, spine in (
        (axes, excerpt.force, BLUE, "left"),
        (other, excerpt.response, ORANGE, "right"),
    ):
        limit = 1.12 * float(np.nanmax(np.abs(values))) or 1.0
        side.set_ylim(-limit, limit)
        side.yaxis.set_major_locator(MaxNLocator(4, symmetric=True))
        side.tick_params(axis="y", labelcolor=colour, labelsize=7.5)
        side.yaxis.set_major_formatter(ScaledNumbers((-2, 3)))
        side.yaxis.get_offset_text().set_fontsize(7.5)
        side.spines[spine].set_visible(True)
    other.grid(False)
    if last_column:
        other.set_ylabel(f"{excerpt.response_symbol} / {unit_text(excerpt.response_unit)}", color=ORANGE, fontsize=8)
    if first_column:
        axes.set_ylabel("$F$ / N", color=BLUE, fontsize=8)
    axes.set_title(
        f"level {excerpt.level_index + 1}: {significant(excerpt.level, 3)} {unit_text(excerpt.level_unit)}",
        fontsize=8.5,
        loc="center",
        y=1.0,
    )
    axes.set_xlim(0.0, float(periods[-1]))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def _state_strip(axes: Axes, time: Any, state: Any) -> None:
    for value, first, stop in _strip_stretches(state):
        known = LoopState(int(value)) if int(value) in _STATE_COLOURS else None
        colour = _STATE_COLOURS[known] if known is not None else "#ffffff"
        start = 0.0 if first == 0 else time[first - 1]
        axes.axvspan(start, time[stop - 1], color=colour, linewidth=0)
    axes.set_yticks([])
    axes.grid(False)
    axes.tick_params(axis="x", length=0, labelbottom=False)
    for spine in axes.spines.values():
        spine.set_visible(False)
    present = [name for name in _STATE_NAMES if np.any(state == name)]
    for name in present:
        axes.fill_between([], [], [], color=_STATE_COLOURS[name], label=_STATE_NAMES[name])
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 0.95), ncols=4, borderaxespad=0.0, handlelength=1.1)


def _lost_spans(panels: Sequence[Axes], time: Any, state: Any) -> None:
    for value, first, stop in _stretches(state):
        if value == LoopState.LOCK_LOST:
            for axes in panels:
                axes.axvspan(time[max(0, first - 1)], time[stop - 1], color=RED, alpha=0.14, linewidth=0)


def _stretches(state: Any) -> list[tuple[int, int, int]]:
    edges = [0, *(np.flatnonzero(np.diff(state)) + 1).tolist(), len(state)]
    return [(int(state[first]), first, stop) for first, stop in itertools.pairwise(edges)]


def _strip_stretches(state: Any) -> list[tuple[int, int, int]]:
    """Stretches of one state; of very many, columns with the worst state in them: a lost lock stays visible."""
    stretches = _stretches(state)
    if len(stretches) <= _STRIP_COLUMNS:
        return stretches
    edges = np.linspace(0, len(state), _STRIP_COLUMNS + 1).astype(int)
    lost = np.maximum.reduceat(state == LoopState.LOCK_LOST, edges[:-1])
    share = [np.add.reduceat(state == kind, edges[:-1]) for kind in _STATE_COLOURS]
    most = np.array([int(kind) for kind in _STATE_COLOURS])[np.argmax(share, axis=0)]
    worst = np.where(lost, int(LoopState.LOCK_LOST), most)
    return [(value, int(edges[first]), int(edges[stop])) for value, first, stop in _stretches(worst)]


_CROWDED = "Locks, windows and starts of so many levels are in the table below only."


def _crowded(data: RunReportData) -> bool:
    """Whether marks of single levels would cover the curves."""
    return max(len(data.levels), len(data.locks)) > MOST_MARKS


def _windows(axes: Axes, data: RunReportData) -> None:
    for lock in () if _crowded(data) else data.locks:
        first = lock.window_first_sample / data.sample_rate
        axes.axvspan(first, first + lock.window_samples / data.sample_rate, color=_WINDOW, linewidth=0, zorder=0)


def _level_starts(panels: Iterable[Axes], data: RunReportData) -> None:
    for step in () if _crowded(data) else _steps(data):
        for axes in panels:
            axes.axvline(step.sample / data.sample_rate, color=MUTED, linewidth=0.6, linestyle=(0, (1, 2)))


def _level_numbers(axes: Axes, data: RunReportData, above: bool = False) -> None:
    """Number each level, in its window if it has one: on the strip of states or above a panel."""
    steps = _steps(data)
    if len(steps) > 40:
        return
    middle = {lock.level_index: lock.window_first_sample + lock.window_samples / 2 for lock in data.locks}
    failed = {point.level_index for point in data.failed_points}
    for step in steps:
        place = middle.get(step.index, step.sample) / data.sample_rate
        inside = step.index in middle
        colour = RED if above and step.index in failed else "white" if inside and not above else INK
        axes.annotate(
            str(step.index + 1),
            (place, 1.0 if above else 0.5),
            xycoords=("data", "axes fraction"),
            xytext=(0 if inside else 4, 3 if above else 0),
            textcoords="offset points",
            color=colour,
            fontsize=8,
            fontweight="bold",
            ha="center" if inside else "left",
            va="bottom" if above else "center_baseline",
        )


def _steps(data: RunReportData) -> list[LevelStart]:
    return [step for step in data.levels if step.amplitude > 0.0]


def _html_symbol(symbol: str) -> Markup:
    """HTML of an axis symbol such as ``$x_{2}$`` or ``$\\ddot x_{2}$``."""
    bare = symbol.replace("$", "").replace("\\ddot x", "ẍ")
    return Markup("<i>{}</i>").format(Markup(re.sub(r"_\{?(\w+)\}?", r"<sub>\1</sub>", str(escape(bare)))))
