"""A figure as plain numbers: what a page keeps of it, so that it can be redrawn at another size or read as a table.

The record of a figure holds every drawn coordinate in data units, and enough of its look to draw it again. It is made
of lists, numbers and texts only, so it can be written as JSON.
"""

from __future__ import annotations

import base64
import json
import math
import re
import zlib
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection, QuadMesh
from matplotlib.colors import to_hex
from matplotlib.container import BarContainer, ErrorbarContainer
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon, Rectangle
from matplotlib.text import Annotation

from nmt_core.errors import BenchError
from nmt_core.files.whole_file import csv_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMAT = "nmt figure 1"
COLUMNS = ("panel", "series", "x_name", "x", "y_name", "y", "x_low", "x_high", "y_low", "y_high", "value")

Record = dict[str, Any]

_LARGEST = 64 << 20


def record(figure: Figure, name: str, title: str, wide: bool = False, *, drawn: bool = False) -> Record:
    """Everything that a figure shows.

    Args:
        figure: a figure of a report.
        name: its anchor on the page.
        title: what it shows.
        wide: whether it takes the whole width of a page.
        drawn: whether it has been drawn since it was last changed.

    Returns:
        A mapping of JSON's types. Coordinates are those of the data, in the units of the axis labels.
    """
    if not drawn:
        figure.draw_without_rendering()  # ticks, and the place of legends, are known only afterwards
    panels = [axes for axes in figure.axes if axes.get_visible()]
    return {
        "format": FORMAT,
        "name": name,
        "title": title,
        "wide": wide,
        "size_in": [round(float(v), 4) for v in figure.get_size_inches()],
        "legends": [_legend(legend) for legend in figure.legends],
        "panels": [_named(_panel(axes, number, panels), number) for number, axes in enumerate(panels)],
    }


def packed(figure: Mapping[str, Any]) -> str:
    """A recorded figure as one line of letters: JSON, deflated, in base 64 for URLs; the same for the same figure."""
    return base64.urlsafe_b64encode(zlib.compress(json.dumps(figure, separators=(",", ":")).encode())).decode()


def unpacked(text: str) -> Record:
    """The figure behind :func:`packed`.

    Raises:
        BenchError: the text is not a packed figure, or a figure of more than 64 MB.
    """
    try:
        inflate = zlib.decompressobj()
        plain = inflate.decompress(base64.b64decode(text, altchars=b"-_", validate=True), _LARGEST)
        figure = None if inflate.unconsumed_tail else json.loads(plain)
    except (ValueError, zlib.error, RecursionError) as error:
        raise BenchError(f"The data of a figure are damaged ({error}); make the report anew.") from error
    if not isinstance(figure, dict) or figure.get("format") != FORMAT:
        raise BenchError(f"A figure's data are not '{FORMAT}'; make the report anew with this version.")
    return figure


def _named(panel: Record, number: int) -> Record:
    """A panel with the names that its table uses."""
    panel["name"] = plain_text(panel["title"]) or str(number + 1)
    for axis in (panel["x"], panel["y"]):
        axis["name"] = plain_text(axis["label"])
    for index, series in enumerate(panel["series"], start=1):
        series["name"] = plain_text(series["label"]) or f"{series['kind']} {index}"
    return panel


def tidy_csv(figure: Mapping[str, Any]) -> str:
    """The coordinates of a recorded figure as a table, one point a row.

    Args:
        figure: of :func:`record`.

    Returns:
        CSV with the columns of :data:`COLUMNS`; cells that a point has not are empty. ``value`` is that of a cell of a
        map, whose ``x`` and ``y`` are its middle. Reference lines have one coordinate only.
    """
    return csv_text([COLUMNS, *_rows(figure)])


def _rows(figure: Mapping[str, Any]) -> Iterator[tuple[Any, ...]]:
    for panel in figure["panels"]:
        names = panel["x"]["name"], panel["y"]["name"]
        for series in panel["series"]:
            size = max(len(series.get(key) or ()) for key in ("x", "y", "x_low", "y_low"))
            for k in range(size):
                cell = {key: _cell(series.get(key), k) for key in COLUMNS}
                cell |= {"panel": panel["name"], "series": series["name"], "x_name": names[0], "y_name": names[1]}
                yield tuple(cell[key] for key in COLUMNS)


def _cell(values: Any, index: int) -> Any:
    return values[index] if values else None


def plain_text(text: str) -> str:
    """A label without the marks of mathematical typesetting."""
    words = {
        r"\tilde\omega": "ω̃", r"\tilde f": "f̃", r"\tilde\delta": "δ̃", r"\tilde\varphi": "φ̃", r"\omega": "ω",
        r"\Gamma": "Γ", r"\gamma": "γ", r"\delta": "δ", r"\psi": "ψ", r"\varphi": "φ", r"\sqrt": "√", r"\mathrm": "",
        r"\degree": "°", r"\cdot": "·", r"\,": "", "$": "", "{": "", "}": "", "_": "", "^": "",
    }  # fmt: skip
    for mark, word in words.items():
        text = text.replace(mark, word)
    return " ".join(text.split())


# -- recording --------------------------------------------------------------------------------------------------------


def _number(value: Any) -> float | None:
    """A number that JSON can hold; 8 digits are more than any figure shows."""
    number = float(value)
    return float(f"{number:.8g}") if math.isfinite(number) else None


def _numbers(values: Any) -> list[float | None]:
    numbers: Any = np.ma.filled(np.ma.asarray(values, dtype=float), np.nan)
    return [_number(value) for value in numbers.ravel()]


def _colour(value: Any) -> str:
    return str(to_hex(value, keep_alpha=True))


# The type hints of matplotlib leave out much of its artists; hence Any.


def _panel(axes: Axes, number: int, panels: list[Axes]) -> Record:
    place = axes.get_position().bounds
    twins = [k for k, other in enumerate(panels[:number]) if np.allclose(place, other.get_position().bounds)]
    names = _names(axes)
    drawn: list[Record] = []
    contained: set[int] = set()
    for container in axes.containers:
        if isinstance(container, ErrorbarContainer):
            series, parts = _error_bars(container, names)
            drawn.append(series)
            contained |= parts
        elif isinstance(container, BarContainer):
            drawn.append(_bars(container))
            contained |= {id(patch) for patch in container.patches}
    for line in axes.lines:
        if id(line) not in contained:
            drawn.append(_line(line, axes, names))
    for patch in axes.patches:
        if id(patch) not in contained and isinstance(patch, Rectangle | Polygon):
            drawn.append(_span(patch, axes))
    for collection in axes.collections:
        if id(collection) in contained:
            continue
        if isinstance(collection, QuadMesh):
            drawn.append(_mesh(collection))
        elif isinstance(collection, PolyCollection):
            drawn += _areas(collection)
        elif isinstance(collection, LineCollection):
            drawn.append(_segments(collection))
    return {
        "twin_of": twins[0] if twins else None,
        "place": [round(float(v), 5) for v in place],
        "cells": _cells(axes),
        "title": axes.get_title("left") or axes.get_title("center"),
        "drawing": not axes.axison,
        "x": _axis(axes.xaxis, axes.get_xlim(), axes.get_xscale()),
        "y": _axis(axes.yaxis, axes.get_ylim(), axes.get_yscale()),
        "spines": [side for side, spine in axes.spines.items() if side in _SIDES and spine.get_visible()],
        "second_axes": [_second_axis(child) for child in axes.child_axes],
        "legend": _legend(axes.get_legend()) if axes.get_legend() is not None else None,
        "texts": [_text(text, axes) for text in axes.texts if text.get_text()],
        "series": _joined(drawn),
    }


_SIDES = ("left", "bottom", "right", "top")


def _cells(axes: Axes) -> list[list[Any]]:
    """Place in the grid and in the grids around it, the outermost first: shape, rows, columns, ratios."""
    chain: list[list[Any]] = []
    spec: Any = axes.get_subplotspec()
    while spec is not None:
        grid = spec.get_gridspec()
        rows, columns = spec.rowspan, spec.colspan
        chain.append(
            [
                [grid.nrows, grid.ncols], [rows.start, rows.stop], [columns.start, columns.stop],
                [float(v) for v in grid.get_height_ratios()], [float(v) for v in grid.get_width_ratios()],
            ]
        )  # fmt: skip
        spec = getattr(grid, "_subplot_spec", None)
    return chain[::-1]


def _axis(axis: Any, limits: tuple[float, float], scale: str) -> Record:
    low, high = sorted(limits)
    ticks = [
        (place, label.get_text())
        for place, label in zip(axis.get_majorticklocs(), axis.get_majorticklabels(), strict=False)
        if low - 1e-9 * (high - low) <= place <= high + 1e-9 * (high - low)
    ]
    transform = axis.get_transform()
    return {
        "label": axis.get_label_text(),
        "colour": _colour(axis.label.get_color()),
        "scale": scale,
        "linthresh": _number(getattr(transform, "linthresh", 1.0)),
        "linscale": _number(getattr(transform, "linscale", 1.0)),
        "limits": [_number(v) for v in limits],
        "ticks": [_number(place) for place, _ in ticks],
        "tick_labels": [text for _, text in ticks],
        "labelled": any(label.get_visible() and label.get_text() for label in axis.get_majorticklabels())
        and bool(axis.get_tick_params().get("labelbottom", True) if axis.axis_name == "x" else True),
        "free": axis.get_scale() == "linear" and _say_their_place(ticks, axis),
        "side": axis.get_ticks_position(),
        "grid": any(bool(line.get_visible()) for line in axis.get_gridlines()),
    }


_NUMBER_MARKS = re.compile(r"[${}]|\\mathdefault")


def _say_their_place(ticks: list[tuple[float, str]], axis: Any) -> bool:
    """Whether tick labels are the numbers at which they stand, so that other ticks would do as well."""
    formatter = axis.get_major_formatter()
    factor = 10.0 ** float(getattr(formatter, "orderOfMagnitude", 0))
    shift = float(getattr(formatter, "offset", 0.0))
    span = max((abs(place) for place, _ in ticks), default=1.0) or 1.0
    for place, text in ticks:
        if not text:
            continue
        try:
            shown = float(_NUMBER_MARKS.sub("", text).replace("−", "-")) * factor + shift
        except ValueError:
            return False
        if abs(shown - place) > 1e-3 * span:
            return False
    return True


def _second_axis(child: Any) -> Record:
    """A secondary ordinate: a multiple of the main one."""
    forward = child._functions[0]
    return {
        "place": float(child._pos),
        "factor": _number(float(forward(1.0)) - float(forward(0.0))),
        "label": child.get_ylabel(),
        "colour": _colour(child.yaxis.label.get_color()),
    }


def _names(axes: Axes) -> dict[tuple[Any, ...], str]:
    """Texts of the legends by the look of their handles: for artists that carry no label of their own."""
    legends = [axes.get_legend(), *axes.figure.legends]
    found = {}
    for legend in filter(None, legends):
        for handle, text in zip(legend.legend_handles, legend.get_texts(), strict=False):
            if isinstance(handle, Line2D):
                found[_look(handle)] = text.get_text()
    return found


def _look(line: Any) -> tuple[Any, ...]:
    return _colour(line.get_color()), str(line.get_marker()), str(line.get_linestyle()) if _has_line(line) else "None"


def _has_line(line: Any) -> bool:
    return line.get_linestyle() not in ("None", "none", "", " ")


def _own_label(artist: Any) -> str:
    text = str(artist.get_label() or "")
    return "" if text.startswith("_") else text


def _label(artist: Any, names: Mapping[tuple[Any, ...], str]) -> str:
    text = _own_label(artist)
    if text:
        return text
    return names.get(_look(artist), "") if isinstance(artist, Line2D) else ""


def _style(line: Any) -> Record:
    dashes = line._unscaled_dash_pattern[1] if _has_line(line) else None
    face = line.get_markerfacecolor()
    return {
        "colour": _colour(line.get_color()),
        "alpha": line.get_alpha(),
        "width": _number(line.get_linewidth()) if _has_line(line) else 0.0,
        "dashes": [float(v) for v in dashes] if dashes else None,
        "step": str(line.get_drawstyle()),
        "marker": str(line.get_marker()),
        "marker_size": _number(line.get_markersize()),
        "marker_face": "none" if isinstance(face, str) and face == "none" else _colour(face),
        "marker_edge": _number(line.get_markeredgewidth()),
    }


def _line(line: Any, axes: Axes, names: Mapping[tuple[Any, ...], str]) -> Record:
    x, y = (np.asarray(values, dtype=float) for values in line.get_data(orig=False))
    base: Record = {"kind": "line", "label": _label(line, names), **_style(line)}
    if line.get_transform() == axes.get_yaxis_transform(which="grid"):
        return {**base, "kind": "level line", "label": _own_label(line), "y": _numbers(y[:1])}
    if line.get_transform() == axes.get_xaxis_transform(which="grid"):
        return {**base, "kind": "upright line", "label": _own_label(line), "x": _numbers(x[:1])}
    return {**base, "x": _numbers(x), "y": _numbers(y)}


def _error_bars(container: ErrorbarContainer, names: Mapping[tuple[Any, ...], str]) -> tuple[Record, set[int]]:
    line, caps, bars = container.lines
    parts = {id(item) for item in (line, *caps, *bars) if item is not None}
    label = _own_label(container) or (_label(line, names) if line is not None else "")
    series: Record = {"kind": "points", "label": label}
    collection: Any
    for collection in bars:
        segments = [np.asarray(segment, dtype=float) for segment in collection.get_segments()]
        ends = np.array([[part[0], part[-1]] if len(part) else np.full((2, 2), np.nan) for part in segments])
        if ends.size == 0:
            continue
        sideways = np.nanmax(np.abs(np.diff(ends[:, :, 0])), initial=0.0) > np.nanmax(
            np.abs(np.diff(ends[:, :, 1])), initial=0.0
        )
        along = 0 if sideways else 1
        series["xy"[along] + "_low"] = _numbers(ends[:, 0, along])
        series["xy"[along] + "_high"] = _numbers(ends[:, 1, along])
        series.setdefault("xy"[1 - along], _numbers(ends[:, 0, 1 - along]))
        series.setdefault("bar_colour", _colour(collection.get_colors()[0]))
        series.setdefault("bar_width", _number(collection.get_linewidths()[0]))
    if line is not None:
        x, y = line.get_data(orig=False)
        series |= {**_style(line), "x": _numbers(x), "y": _numbers(y)}
    return series, parts


def _bars(container: BarContainer) -> Record:
    upright = getattr(container, "orientation", "vertical") != "horizontal"
    boxes = [patch.get_bbox() for patch in container.patches]
    series: Record = {
        "kind": "bars" if upright else "level bars",
        "label": _own_label(container),
        "colour": _colour(container.patches[0].get_facecolor()) if boxes else "#000000ff",
    }
    low, high = np.array([box.min for box in boxes]).T, np.array([box.max for box in boxes]).T
    along, across = (1, 0) if upright else (0, 1)
    series["xy"[across]] = _numbers(0.5 * (low[across] + high[across]))
    series["thickness"] = _numbers(high[across] - low[across])
    series["xy"[along] + "_low"], series["xy"[along] + "_high"] = _numbers(low[along]), _numbers(high[along])
    return series


def _span(patch: Any, axes: Axes) -> Record:
    box = patch.get_path().get_extents(patch.get_patch_transform())
    upright = patch.get_data_transform() == axes.get_xaxis_transform(which="grid")
    kind = "band" if upright else "box"
    series = {
        "kind": kind,
        "label": _own_label(patch),
        "colour": _colour(patch.get_facecolor()),
        "x_low": _numbers([box.x0]),
        "x_high": _numbers([box.x1]),
    }
    return series if upright else {**series, "y_low": _numbers([box.y0]), "y_high": _numbers([box.y1])}


def _mesh(mesh: Any) -> Record:
    corners = np.asarray(mesh.get_coordinates())
    middle = 0.25 * (corners[:-1, :-1] + corners[1:, :-1] + corners[:-1, 1:] + corners[1:, 1:])
    values: Any = np.ma.asarray(mesh.get_array())
    colours = mesh.get_cmap()(mesh.norm(values.reshape(middle.shape[:2])))
    return {
        "kind": "map",
        "label": "",
        "shape": list(middle.shape[:2]),
        "x": _numbers(middle[..., 0]),
        "y": _numbers(middle[..., 1]),
        "value": _numbers(values),
        "colours": [_colour(colour) for colour in colours.reshape(-1, 4)],
    }


def _areas(collection: Any) -> list[Record]:
    """Filled areas between two curves; the outline is read back into lower and upper values over x."""
    found = []
    faces = collection.get_facecolors()
    for path in collection.get_paths():
        outline: Any = path.vertices
        half = (len(outline) - 3) // 2
        if half < 1:
            continue
        # matplotlib goes along one curve, back along the other, and closes: 1 + n + 1 + n + 1 corners.
        there, back = outline[1 : half + 1], outline[half + 2 : 2 * half + 2][::-1]
        low, high = np.minimum(there[:, 1], back[:, 1]), np.maximum(there[:, 1], back[:, 1])
        found.append(
            {
                "kind": "area",
                "label": _own_label(collection),
                "colour": _colour(faces[0]) if len(faces) else "#000000ff",
                "x": _numbers(there[:, 0]),
                "y_low": _numbers(low),
                "y_high": _numbers(high),
            }
        )
    return found


def _segments(collection: Any) -> Record:
    ends = np.array([[part[0], part[-1]] for part in collection.get_segments() if len(part)], dtype=float)
    ends = ends.reshape(-1, 2, 2)
    series: Record = {
        "kind": "upright bars",
        "label": _own_label(collection),
        "colour": _colour(collection.get_colors()[0]) if len(collection.get_colors()) else "#000000ff",
        "width": _number(collection.get_linewidths()[0]),
    }
    low, high = ends.min(axis=1), ends.max(axis=1)
    if len(ends) and np.all(low[:, 1] == high[:, 1]) and np.any(low[:, 0] < high[:, 0]):
        level = {"x_low": _numbers(low[:, 0]), "x_high": _numbers(high[:, 0]), "y": _numbers(low[:, 1])}
        return {**series, "kind": "level segments", **level}
    return {**series, "x": _numbers(low[:, 0]), "y_low": _numbers(low[:, 1]), "y_high": _numbers(high[:, 1])}


def _joined(drawn: list[Record]) -> list[Record]:
    """Markers that were drawn one by one become one series; empty stand-ins for legends go."""
    result: list[Record] = []
    for series in drawn:
        size = max(len(series.get(key) or ()) for key in ("x", "y", "x_low", "y_low"))
        if size == 0:
            continue
        single = series["kind"] == "line" and size == 1
        last = result[-1] if result else None
        if single and last is not None and last["kind"] == "line" and _alike(series, last):
            last["x"] += series["x"]
            last["y"] += series["y"]
            continue
        result.append({**series, "width": 0.0} if single else series)
    return result


def _alike(series: Record, other: Record) -> bool:
    keys = ("label", "colour", "marker", "marker_size", "marker_face", "alpha")
    return other.get("width") == 0.0 and all(series.get(key) == other.get(key) for key in keys)


def _legend(legend: Any) -> Record:
    entries = []
    for handle, text in zip(legend.legend_handles, legend.get_texts(), strict=False):
        if isinstance(handle, Line2D):
            look = _style(handle)
        else:
            # An error bar stands for its colour in a legend, as a filled area does.
            colours: list[Any] = [
                getattr(handle, name, list)() for name in ("get_facecolor", "get_edgecolor", "get_color")
            ]
            colour = next((face for face in colours if len(face)), "black")
            look = {"patch": True, "colour": _colour(colour[0] if np.ndim(colour) == 2 else colour)}
        entries.append({"text": text.get_text(), **look})
    frame = legend.get_frame()
    anchor = legend.get_bbox_to_anchor()
    if legend.axes is not None:
        anchor = anchor.transformed(legend.axes.transAxes.inverted())
    return {
        "anchor": [round(float(v), 4) for v in anchor.bounds] if legend.axes is not None else None,
        "place": int(legend._loc_real) if isinstance(legend._loc_real, int) else 0,
        "columns": int(legend._ncols),
        "frame": bool(legend.get_frame_on() and frame.get_visible()),
        "entries": entries,
    }


def _text(text: Any, axes: Axes) -> Record:
    offset = [0.0, 0.0]
    system: list[Any]
    if isinstance(text, Annotation):
        x, y = text.xy
        system = list(text.xycoords) if isinstance(text.xycoords, tuple) else [text.xycoords, text.xycoords]
        if isinstance(text.anncoords, str) and text.anncoords == "offset points":
            offset = [float(v) for v in text.get_position()]
    else:
        x, y = text.get_position()
        transform = text.get_transform()
        blended = {
            id(axes.transAxes): ["axes fraction", "axes fraction"],
            id(axes.transData): ["data", "data"],
        }
        system = blended.get(id(transform), ["data", "data"])
        if transform == axes.get_xaxis_transform():
            system = ["data", "axes fraction"]
        elif transform == axes.get_yaxis_transform():
            system = ["axes fraction", "data"]
    return {
        "text": text.get_text(),
        "x": _number(x),
        "y": _number(y),
        "system": system,
        "offset": offset,
        "colour": _colour(text.get_color()),
        "size": _number(text.get_fontsize()),
        "ha": text.get_ha(),
        "va": text.get_va(),
        "rotation": float(text.get_rotation()),
    }
