"""Figures of frequency responses: amplitude and phase of a channel, held force, drive voltage."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_extract.curves.swept_response import FrequencyResponseTable
from nmt_report.figure_parts import plot_panels, report_figure
from nmt_report.quantity_format import significant
from nmt_report.svg import INK, MUTED, ReportFigure, level_colours

_QUANTITIES = {"a": ("acceleration", "m/s²"), "v": ("velocity", "m/s"), "x": ("displacement", "m")}


@dataclass(frozen=True, eq=False)
class Overlay:
    """A computed curve next to measured ones: level (N), frequency (Hz), complex responses (channels, k)."""

    label: str
    level: float
    frequency_hz: FloatArray
    responses: ComplexArray


def channel_text(channel: str) -> tuple[str, str]:
    """What a channel is in words, and its unit: ``("acceleration at point 1", "m/s²")``."""
    quantity, unit = _QUANTITIES[channel[0]]
    return f"{quantity} at point {channel[1:]}", unit


def response_figure(
    tables: Sequence[FrequencyResponseTable], channel: str, overlays: Sequence[Overlay], caption: str
) -> ReportFigure:
    """Amplitude, difference to computed curves, and phase of one channel over the frequency, every level."""
    row = tables[0].channels.index(channel)
    title, unit = channel_text(channel)
    ratios = (1.6, 0.8, 1) if overlays else (1.6, 1)
    figure, (top, *between, bottom) = _stacked(ratios, 6.6 if overlays else 5.2, 0.08)
    levels = list(dict.fromkeys(table.level for table in tables))
    colours = dict(zip(levels, level_colours(len(levels)), strict=True))
    named: set[str] = set()

    def once(label: str) -> str | None:
        if label in named:
            return None
        named.add(label)
        return label

    for table in tables:
        values = table.frf[row] * table.force_n
        stepped = table.rate_hz_s == 0.0
        word = "stepped" if stepped else "sweep up" if table.rate_hz_s > 0 else "sweep down"
        label = f"{significant(table.level)} {table.level_unit}, {word}"
        style = "o" if stepped else "-"
        for axes, data in ((top, np.abs(values)), (bottom, _degrees(values))):
            axes.plot(
                table.frequency_hz,
                data,
                style,
                color=colours[table.level],
                markersize=3.5,
                linewidth=1.8,
                label=once(label),
            )
            label = "_"
        for axes in between:
            for overlay in overlays:
                if overlay.level == table.level and np.all(np.diff(overlay.frequency_hz) > 0):
                    axes.plot(
                        table.frequency_hz,
                        _excess(overlay, row, table.frequency_hz, values),
                        style if stepped or table.rate_hz_s > 0 else "--",
                        color=colours[table.level],
                        markersize=2.5,
                    )
    for number, overlay in enumerate(overlays):
        dashes = (0, (4, 2)) if number < len(levels) else (0, (1, 1.5))
        values = overlay.responses[row]
        shown = once(overlay.label)
        for axes, data in ((top, np.abs(values)), (bottom, _degrees(values))):
            axes.plot(overlay.frequency_hz, data, color=INK, linewidth=1.0, linestyle=dashes, label=shown)
            shown = None
    shown_hz = np.concatenate([table.frequency_hz for table in tables])
    top.set_xlim(float(shown_hz.min()), float(shown_hz.max()))
    top.set_ylim(bottom=0.0)
    top.set_ylabel(_ordinate(title, unit))
    for axes in between:
        axes.axhline(0.0, color=MUTED, linewidth=0.8)
        axes.set_ylabel("computed less\nmeasured / % of peak")
    bottom.set_ylabel("phase to force / °")
    bottom.set_xlabel("frequency / Hz")
    top.legend(loc="best")
    return report_figure(figure, f"response-{channel}", title[:1].upper() + title[1:], caption, label=title)


def _excess(overlay: Overlay, row: int, frequency_hz: FloatArray, measured: ComplexArray) -> FloatArray:
    """Computed modulus less the measured one at the measured frequencies, % of the largest measured one."""
    computed = np.interp(
        frequency_hz, overlay.frequency_hz, np.abs(overlay.responses[row]), left=math.nan, right=math.nan
    )
    return np.asarray(100.0 * (computed - np.abs(measured)) / np.nanmax(np.abs(measured)))


def synthesis_figure(overlays: Sequence[Overlay], row: int, channel: str) -> ReportFigure:
    """Amplitude and phase of computed curves alone."""
    title, unit = channel_text(channel)
    figure, (top, bottom) = _stacked((1.6, 1))
    levels = list(dict.fromkeys(overlay.level for overlay in overlays))
    colours = dict(zip(levels, level_colours(max(1, len(levels))), strict=False))
    for overlay in overlays:
        values, colour = overlay.responses[row], colours[overlay.level]
        top.plot(overlay.frequency_hz, np.abs(values), color=colour, label=f"{significant(overlay.level)} N")
        bottom.plot(overlay.frequency_hz, _degrees(values), color=colour)
    top.set_ylim(bottom=0.0)
    top.set_ylabel(_ordinate(title, unit))
    bottom.set_ylabel("phase to force / °")
    bottom.set_xlabel("frequency / Hz")
    if overlays:
        top.legend(loc="upper right")
    caption = "Synthesis from the backbone alone."
    return report_figure(figure, f"synthesis-{channel}", title[:1].upper() + title[1:], caption, label=title)


def _stacked(ratios: Sequence[float], height: float = 5.2, bottom: float = 0.09) -> tuple[Figure, Any]:
    """Axes below each other over one frequency axis, with the ratios of their heights."""
    grid = {"sharex": True, "height_ratios": ratios}
    return plot_panels((6.3, height), len(ratios), 1, grid, left=0.12, right=0.97, bottom=bottom, top=0.97, hspace=0.1)


def _ordinate(title: str, unit: str) -> str:
    """Quantity and unit of a channel as a label."""
    return f"{title.split(' ')[0]} / ({unit})" if "/" in unit else f"{title.split(' ')[0]} / {unit}"


def _degrees(values: ComplexArray) -> FloatArray:
    """Phase in degrees, cut where no response lies near resonance: within ±180 about −90 or +90."""
    good = values[np.isfinite(values)]
    if good.size == 0:
        return np.full(values.shape, math.nan)
    middle = np.angle(np.sum(good * np.abs(good)))
    return np.asarray(np.degrees(np.angle(values * np.exp(-1j * middle)) + middle))


def force_figure(tables: Sequence[FrequencyResponseTable]) -> ReportFigure:
    """Deviation of the force from its target, and the drive voltage that it took."""
    figure, (top, bottom) = _stacked((1, 1))
    levels = list(dict.fromkeys(table.level for table in tables))
    colours = dict(zip(levels, level_colours(len(levels)), strict=True))
    for table in tables:
        stepped = table.rate_hz_s == 0.0
        style = "o" if stepped else "-" if table.rate_hz_s > 0 else "--"
        word = "stepped" if stepped else "up" if table.rate_hz_s > 0 else "down"
        label = f"{significant(table.level)} {table.level_unit}, {word}"
        error = table.held_error()
        shown = 100.0 * error if np.all(np.isfinite(error)) else table.force_n
        top.plot(table.frequency_hz, shown, style, color=colours[table.level], markersize=3.0, label=label)
        bottom.plot(table.frequency_hz, table.voltage_v, style, color=colours[table.level], markersize=3.0)
    held = all(table.level_unit == "N" for table in tables)
    top.axhline(0.0, color=MUTED, linewidth=0.8)
    top.set_ylabel("force error / %" if held else "force / N")
    bottom.set_ylabel("drive voltage / V")
    bottom.set_xlabel("frequency / Hz")
    bottom.set_ylim(bottom=0.0)
    top.legend(loc="best")
    caption = (
        "Above: amplitude of the force’s fundamental against its target. Below: the voltage that keeps it; near the "
        "resonance the motion takes most of the exciter’s force."
        if held
        else "Above: amplitude of the force’s fundamental. Below: drive voltage."
    )
    heading = "Error and drive voltage" if held else "Force and drive voltage"
    return report_figure(figure, "force", heading, caption, label="Force error")
