"""The force that a model lacks, as a diagnosis reads it: its loops level by level, and the terms of its law."""

from __future__ import annotations

import math
import re
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from nmt_core.numerics.arrays import FloatArray
from nmt_core.text.number_words import percent, value_text
from nmt_diagnose.law.force_loop import ForceLoop
from nmt_diagnose.law.law_words import formula, raised
from nmt_diagnose.law.reading import LawReading, LocalLaw
from nmt_diagnose.law.record_check import RecordCheck
from nmt_report.html_page import PageColumn, Row, Table
from nmt_report.quantity_format import significant
from nmt_report.svg import INK, MUTED, ORANGE, ReportFigure, level_colours, svg_text

_BAND = 2.0  # standard deviations
_SHAPED = 6.0
"""Standard deviations of a loop from which it has a shape to show."""


def law_figures(reading: LawReading) -> list[ReportFigure]:
    """All figures of a reading: the loops of each law, and of records a part that was left out."""
    figures = [law_figure(law, number) for number, law in enumerate(reading.laws)]
    if reading.check is not None:
        figures.append(check_figure(reading.check, " and ".join(law.family for law in reading.laws)))
    return figures


def law_figure(law: LocalLaw, number: int) -> ReportFigure:
    """The loops of a law for a page.

    Args:
        law: with its loops.
        number: of the law, for the anchor.
    """
    name = f"law-{number}"
    title = f"Missing force at {_where(law)}: {law.family}"
    periodic = not any(loop.line for loop in law.loops)
    along = (
        "along one period of the place, at levels named by their largest displacement. Points: by the rows of the "
        "level alone, of the harmonics that were measured, without the mean. Lines: the law, which all levels share. "
        if periodic
        else "along stretches of the record, named by their largest displacement. Points: measured force less that of "
        "the model, errors of chain and model taken off. Lines: the law. "
    )
    caption = (
        f"The force that the model lacks, {along}A spring is one line over the displacement; what takes energy "
        "encloses an area there and, where it is a damper, is one line over the velocity. Where two standard "
        "deviations are more than the force it is not drawn."
    )
    return ReportFigure(name, title, caption, svg_text(drawn_loops(law), name, title), wide=True)


def check_figure(check: RecordCheck, family: str) -> ReportFigure:
    """The law of records against a part that it does not know, and what it leaves, for a page.

    Args:
        check: of the law.
        family: of the law, in words.
    """
    title = f"A part of {check.record} that was left out: {family}"
    caption = (
        "Left: the force that the model lacks in the part of the largest motion, and the law with strengths of all "
        "other parts. Right: autocorrelation of the residual of all parts. Where it lies within the band, two standard "
        "deviations of independent noise, nothing is left that a law of the motion could tell."
    )
    return ReportFigure("law-check", title, caption, svg_text(drawn_check(check), "law-check", title), wide=True)


def drawn_check(check: RecordCheck) -> Figure:
    """Missing force over time with the law's line, and autocorrelations of the remainders."""
    figure = Figure(figsize=(12.9, 4.0))
    left, right = figure.subplots(1, 2, width_ratios=(2.0, 1.0))
    figure.subplots_adjust(left=0.055, right=0.99, bottom=0.14, top=0.9, wspace=0.17)
    newtons, per_newton = ("N", 1.0) if np.abs(check.line).max() >= 0.1 else ("mN", 1e3)
    measured, line = per_newton * np.array(check.measured), per_newton * np.array(check.line)
    spread = _BAND * per_newton * check.std
    left.errorbar(check.time_s, measured, spread, fmt="none", ecolor=MUTED, alpha=0.4)
    left.plot(check.time_s, measured, "o", color=INK, markersize=2.6, label=f"measured, ±{_BAND:g} standard deviations")
    left.plot(check.line_s, line, color=ORANGE, linewidth=1.2, label="law of the other parts")
    left.set_xlabel("time / s")
    left.set_ylabel(f"missing force / {newtons}")
    right.axhspan(-check.band, check.band, color=MUTED, alpha=0.25, linewidth=0.0, label="independent noise")
    right.axhline(0.0, color=INK, linewidth=0.6)
    right.plot(check.lags_s, check.without, color=MUTED, linewidth=1.2, label="without the law")
    right.plot(check.lags_s, check.with_law, color=ORANGE, linewidth=1.4, label="with it")
    right.set_xlabel("lag / s")
    right.set_ylabel("autocorrelation of the remainder")
    right.set_ylim(-1.05, 1.05)
    for axes in (left, right):
        axes.set_axisbelow(True)
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.1)
    return figure


def drawn_loops(law: LocalLaw) -> Figure:
    """Missing force over displacement and over velocity, and every loop by its own size."""
    figure = Figure(figsize=(12.9, 4.5))
    panels = figure.subplots(1, 3)
    figure.subplots_adjust(left=0.055, right=0.99, bottom=0.125, top=0.8, wspace=0.21)
    # Where the uncertainty is larger than the force, it would cover the others.
    loops = [loop for loop in law.loops if _size(loop) > _BAND * loop.std] or law.loops[-1:]
    colours = level_colours(len(loops))
    reaches = [float(np.abs(loop.displacement).max()) for loop in loops]
    unit, scale = ("mm", 1e3) if max(reaches) >= 1e-4 else ("µm", 1e6)
    largest = max(map(_size, loops))
    newtons, per_newton = ("N", 1.0) if largest >= 0.1 else ("mN", 1e3)
    for loop, reach, colour in zip(loops, reaches, colours, strict=True):
        x, v = np.array(loop.displacement), np.array(loop.velocity)
        along = [np.append(x, x[0]), np.append(v, v[0]), np.append(loop.law, loop.law[0])]
        line = [np.array(values) for values in loop.line] or along
        _draw(panels[0], loop, scale * x, (scale * line[0], line[2]), 1.0 / per_newton, colour)
        _draw(panels[1], loop, v, (line[1], line[2]), 1.0 / per_newton, colour)
        size = _size(loop)
        if size > _SHAPED * loop.std:
            _draw(panels[2], loop, x / reach, (line[0] / reach, line[2]), size, colour)
    for axes, title in zip(panels, ("over displacement", "over velocity", "each loop by its own size"), strict=True):
        axes.axhline(0.0, color=INK, linewidth=0.6)
        axes.axvline(0.0, color=INK, linewidth=0.6)
        axes.set_title(title)
        axes.set_axisbelow(True)
    for axes in panels[:2]:
        axes.set_ylim(-1.2 * per_newton * largest, 1.2 * per_newton * largest)
    panels[2].set_ylim(-1.6, 1.6)
    panels[0].set_xlabel(f"displacement / {unit}")
    panels[0].set_ylabel(f"missing force / {newtons}")
    panels[1].set_xlabel("velocity / (m/s)")
    panels[2].set_xlabel("displacement / its largest")
    panels[2].set_ylabel("force / largest of the law's")
    handles: list[Line2D | Patch] = [Line2D([], [], color=colour, linewidth=2.4) for colour in colours]
    texts = [f"{significant(scale * reach, 2)} {unit}" for reach in reaches]
    handles += [Line2D([], [], color=INK, marker="o", linestyle="none", markersize=3.0)]
    handles += [Patch(color=MUTED, alpha=0.3, linewidth=0.0), Line2D([], [], color=INK, linewidth=1.4)]
    texts += ["as it was read", f"±{_BAND:g} standard deviations", "law"]
    figure.legend(
        handles, texts, loc="upper right", ncols=len(handles), bbox_to_anchor=(0.995, 1.0), columnspacing=1.3,
        handlelength=1.8,
    )  # fmt: skip
    return figure


def _size(loop: ForceLoop) -> float:
    return float(np.abs(loop.law).max())


def _draw(
    axes: Axes,
    loop: ForceLoop,
    x: FloatArray,
    line: tuple[FloatArray, FloatArray],
    size: float,
    colour: tuple[float, float, float],
) -> None:
    """One loop: band and points as read, the law as a line."""
    read, spread = np.array(loop.measured) / size, _BAND * loop.std / size
    if loop.line:
        axes.errorbar(x, read, spread, fmt="none", ecolor=colour, alpha=0.3)
    for part in () if loop.line else _runs(x):
        axes.fill_between(x[part], read[part] - spread, read[part] + spread, color=colour, alpha=0.18, linewidth=0.0)
    axes.plot(line[0], line[1] / size, color=colour, linewidth=0.8 if loop.line else 1.4)
    marked = slice(None) if loop.line else slice(None, None, 2)
    axes.plot(x[marked], read[marked], "o", color=colour, markersize=2.6)


def _runs(x: FloatArray) -> list[list[int]]:
    """Stretches of a period along which the abscissa goes one way, so that a band can be filled over each."""
    begin = int(np.argmax(x))
    order = [int(k) for k in (begin + np.arange(x.size + 1)) % x.size]
    found: list[list[int]] = [[order[0]]]
    falling = True
    for before, after in pairwise(order):
        if (x[after] < x[before]) != falling and len(found[-1]) > 1:
            found.append([before])
        falling = bool(x[after] < x[before])
        found[-1].append(after)
    return found


def law_table(reading: LawReading) -> Table:
    """Terms of the laws of a reading with their strengths."""
    rows = []
    for law in reading.laws:
        for number, term in enumerate(law.terms):
            place = _where(law) if number == 0 else ""
            kind = formula(term.of_unit_strength)
            strength = value_text(term.coefficient, term.std, _raised(term.unit))
            rows.append(Row((place, law.family if number == 0 else "", kind, strength)))
    head = (
        PageColumn("Place", kind="text"), PageColumn("Family", kind="text wrap"), PageColumn("Term", kind="text"),
        PageColumn("Strength", "± standard uncertainty"),
    )  # fmt: skip
    pieces = "parts" if reading.of_record else "levels"
    note = f"Read from {reading.levels} {pieces} of {reading.test}. "
    reach = significant(1e3 * max(law.valid_to_m for law in reading.laws), 3)
    note += f"Valid up to {reach} mm, the largest displacement that was visited"
    if math.isfinite(reading.before) and math.isfinite(reading.after):
        left = significant(reading.after, 2)
        note += f"; residual of {pieces} left out {significant(reading.before, 3)} → {left} standard deviations"
        note += f" ({percent(reading.after / reading.before)} stay)"
    return Table(head, rows, note + ".")


def _where(law: LocalLaw) -> str:
    return f"points {law.point} and {law.other_point}" if law.other_point else f"point {law.point}"


def _raised(unit: str) -> str:
    """``N/m³`` for ``N/m^3``."""
    return re.sub(r"\^([\d.]+)", lambda power: raised(power[1]), unit)
