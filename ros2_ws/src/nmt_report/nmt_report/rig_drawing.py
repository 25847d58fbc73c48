"""A drawing of a rig with a place of a diagnosis marked: structure, supports, points, elements, exciter, sensors."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from nmt_report.svg import BLUE, INK, MUTED, RED, ReportFigure, svg_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from nmt_rig.rig import Rig

_MOST_LABELS = 24
_WIDTH = 10.0
_SENSOR, _ELEMENT, _EXCITER = 1.15, -0.75, -1.5
"""Heights."""


def rig_figure(rig: Rig, place: str = "", detail: str = "", words: str = "") -> ReportFigure:
    """The rig as a line of points.

    Args:
        rig: the rig.
        place: kind of place, as in a diagnosis (``structure``, ``force_sensor`` …), joined by `` + `` for two.
        detail: point, pair of points or channel, likewise joined.
        words: the place in words, for the caption; empty = nothing is marked.
    """
    figure = Figure(figsize=(6.3, 2.2))
    axes = figure.add_axes((0.01, 0.02, 0.98, 0.96))
    axes.set_axis_off()
    x = _positions(rig)
    _structure(axes, rig, x)
    _elements(axes, rig, x)
    _exciter(axes, rig, x)
    _sensors(axes, rig, x)
    if words:
        for point, height in marked_places(rig, place, detail):
            if point is None or point in x:
                _marker(axes, [0.0 if point is None else x[point]], [height], "o", "none", RED, 26.0, 2.0)
    axes.set_xlim(-1.2, _WIDTH + 1.2)
    axes.set_ylim(-2.0, 2.1)
    axes.set_aspect("equal")
    caption = "Dots: points of the structure. Arrows from below: exciters. Triangles: sensors. Squares: local elements."
    if words:
        caption = f"Marked: {words}. {caption}"
    return ReportFigure(
        "place", "The rig", caption, svg_text(figure, "place", f"Drawing of the rig; {words or 'no mark'}")
    )


def _ends(rig: Rig) -> tuple[bool, bool]:
    """Whether the left and the right end of a beam are held; its points lie between them then."""
    section = rig.structure
    if section.kind != "beam":
        return False, False
    boundary = str(section.boundary)
    return not boundary.startswith("free"), "free" not in boundary


def _positions(rig: Rig) -> dict[int, float]:
    points = sorted(rig.structure.points)
    left, right = _ends(rig)
    steps = len(points) - 1 + left + right
    return {point: _WIDTH * (index + left) / max(steps, 1) for index, point in enumerate(points)}


def _structure(axes: Axes, rig: Rig, x: dict[int, float]) -> None:
    beam = rig.structure.kind == "beam"
    left, right = _ends(rig)
    low, high = (0.0 if left else min(x.values())), (_WIDTH if right else max(x.values()))
    axes.plot([low, high], [0.0, 0.0], color=INK, linewidth=3.0 if beam else 1.2, solid_capstyle="butt", zorder=1)
    for held, place in ((left, low - 0.25), (right, high)):
        if held:
            axes.add_patch(Rectangle((place, -0.6), 0.25, 1.2, color=MUTED, zorder=2))
    places = list(x.values())
    _marker(
        axes, places, [0.0] * len(places), "o" if beam else "s", INK if beam else "white", INK, 5.0 if beam else 9.0
    )
    for number, (point, place) in enumerate(x.items()):
        if number % (1 + len(x) // _MOST_LABELS) == 0:
            axes.text(place, 0.5, str(point), ha="center", va="bottom", fontsize=7, color=MUTED)


def _marker(
    axes: Axes,
    x: Sequence[float],
    y: Sequence[float],
    shape: str,
    face: str,
    edge: str,
    size: float,
    width: float = 1.0,
) -> None:
    """Markers of a fixed size; lines, so that the figure's numbers hold them."""
    axes.plot(
        x, y, linestyle="none", marker=shape, markersize=size, markerfacecolor=face, color=edge,
        markeredgewidth=width, zorder=3,
    )  # fmt: skip


def _elements(axes: Axes, rig: Rig, x: dict[int, float]) -> None:
    for element in rig.local_elements:
        ends = [x[point] for point in (element.point, element.other_point) if point in x]
        if ends:
            place = sum(ends) / len(ends)
            axes.plot([place, place], [0.0, _ELEMENT], color=BLUE, linewidth=1.0, zorder=1)
            _marker(axes, [place], [_ELEMENT], "s", "white", BLUE, 9.0)


def _exciter(axes: Axes, rig: Rig, x: dict[int, float]) -> None:
    for place in (x[point] for point in rig.exciter_points if point in x):
        axes.plot([place, place], [_EXCITER, -0.2], color=INK, linewidth=1.4, zorder=1)
        _marker(axes, [place], [-0.28], "^", INK, INK, 6.0)
        _marker(axes, [place], [_EXCITER], "o", "white", INK, 13.0)


def _sensors(axes: Axes, rig: Rig, x: dict[int, float]) -> None:
    seen: dict[int, int] = {}
    for sensor in rig.sensors:
        point = rig.sensor_point(sensor)
        if sensor.quantity in ("voltage", "current") or point not in x:
            continue
        _marker(axes, [x[point]], [_SENSOR + 0.3 * seen.get(point, 0)], "v", MUTED, MUTED, 5.0)
        seen[point] = seen.get(point, 0) + 1


def marked_places(rig: Rig, place: str, detail: str) -> list[tuple[int | None, float]]:
    """What a place of a diagnosis marks in the drawing.

    Args:
        rig: the rig.
        place: kind of place; several joined by `` + ``.
        detail: point, pair of points or channel, likewise joined.

    Returns:
        Point and height of each mark; the point is None for the clamp.
    """
    marks: list[tuple[int | None, float]] = []
    for kind, what in _parts(place, detail):
        if kind == "boundary":
            marks.append((None, 0.0))
        elif kind in ("exciter", "controller"):
            at = [point for point in _points_of(rig, kind, what) if point in rig.exciter_points]
            marks += [(point, _EXCITER) for point in at or rig.exciter_points]
        else:
            height = _SENSOR if kind.endswith("sensor") else _ELEMENT if kind == "joint" else 0.0
            marks += [(point, height) for point in _points_of(rig, kind, what)]
    return marks


def _parts(place: str, detail: str) -> list[tuple[str, str]]:
    kinds = place.split(" + ")
    whats = detail.split(" + ") if detail else []
    return [(kind, whats[k] if k < len(whats) else "") for k, kind in enumerate(kinds)]


def _points_of(rig: Rig, kind: str, what: str) -> list[int]:
    """Points that a detail names: one, a pair, or the point of a channel."""
    channels = {rig.sensor_channel(sensor): rig.sensor_point(sensor) for sensor in rig.sensors}
    channel = re.split("<| ", what)[0]
    if channel in channels:
        return [channels[channel]]
    numbers = [int(text) for text in re.findall(r"\d+", what)]
    if numbers:
        return numbers[:2]
    if kind == "joint":
        return [element.point for element in rig.local_elements][:1]
    return []
