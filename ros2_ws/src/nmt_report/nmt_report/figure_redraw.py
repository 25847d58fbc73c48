"""Draws a recorded figure again: at another width, with the letter size of a journal, to SVG, PDF or PNG."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import FixedLocator, MaxNLocator, NullLocator

from nmt_core.errors import BenchError
from nmt_report.figure_record import FORMAT
from nmt_report.kept_formulas import kept_formulas
from nmt_report.svg import MUTED, figure_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FORMATS = ("svg", "pdf", "png", "eps")
_REPORT_LETTERS = 9.0
_GUTTER_MM = 5.0
_DPI = 600
_MOST_LAYOUTS = 4
_SPILL = 0.003


def redraw(figure: Mapping[str, Any], width_mm: float = 85.0, letters_pt: float = 7.0) -> Figure:
    """A recorded figure as a matplotlib figure of its own.

    Args:
        figure: of :func:`nmt_report.figure_record.record`.
        width_mm: width of a column, mm. A figure that takes the whole page gets two columns and a gutter of 5 mm.
        letters_pt: size of the axis labels, points.

    Returns:
        The figure, laid out.

    Raises:
        BenchError: the record has another format, or is damaged.
    """
    if figure.get("format") != FORMAT:
        raise BenchError(f"A figure is recorded as '{figure.get('format')}'; this version draws '{FORMAT}'.")
    try:
        return _redrawn(figure, width_mm, letters_pt)
    except (ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
        name = str(figure.get("name"))[:80]
        raise BenchError(f"The data of the figure '{name}' are damaged ({error}); make the report anew.") from error


def _redrawn(figure: Mapping[str, Any], width_mm: float, letters_pt: float) -> Figure:
    width = (2.0 * width_mm + _GUTTER_MM if figure["wide"] else width_mm) / 25.4
    size = figure["size_in"]
    scale = width / size[0]
    letters = letters_pt / _REPORT_LETTERS
    # Letters that shrink less than the figure need more height.
    height = size[1] * scale * max(1.0, min(2.0, (letters / scale) ** 0.5))
    with figure_style(), matplotlib.rc_context(_letters(letters)):
        growth = letters / scale
        in_grid = any(panel["cells"] for panel in figure["panels"])
        narrow = [_narrow_place(panel, growth) for panel in figure["panels"] if in_grid and _is_narrow(panel)]
        edge = min((place[0] - 0.02 for place in narrow), default=1.0)
        layout = ConstrainedLayoutEngine(w_pad=0.02, h_pad=0.02, rect=(0.0, 0.0, edge, 1.0))
        page = Figure(figsize=(width, height), layout=layout if in_grid else None)
        grids: dict[Any, Any] = {}
        drawn: list[Axes] = []
        for panel in figure["panels"]:
            if panel["twin_of"] is not None:
                axes = drawn[panel["twin_of"]].twinx()
            elif panel["cells"]:
                axes = page.add_subplot(_cell_of(page, panel["cells"], grids))
            else:
                axes = page.add_axes(_narrow_place(panel, growth) if in_grid else panel["place"])
            drawn.append(axes)
            _draw(axes, panel, letters, growth)
        for legend in figure["legends"]:
            handles, texts = _handles(legend, letters)
            page.legend(handles, texts, loc="outside upper center", ncols=_columns(legend, width))
        page.draw_without_rendering()
        for axes in drawn:
            _break_label(axes)
        page.draw_without_rendering()
        for axes in drawn:
            _thin_out(axes)
        if in_grid:
            _fit(page, layout, edge)
    return page


def save(figure: Figure, path: Path, dpi: int = _DPI) -> None:
    """Write a figure; the ending of the path chooses the format. Texts stay texts in SVG and PDF.

    Raises:
        OSError: the file cannot be written.
    """
    kind = path.suffix[1:]
    meta = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
    fonts: Any = {"svg.fonttype": "none", "pdf.fonttype": 42, "ps.fonttype": 42, "svg.hashsalt": path.stem}
    with matplotlib.rc_context(fonts), kept_formulas():
        figure.savefig(path, format=kind, dpi=dpi, metadata=meta, facecolor="white")


def _letters(scale: float) -> Any:
    sizes = {"font.size": 9.0, "axes.titlesize": 9.5, "axes.labelsize": 9.0, "legend.fontsize": 8.5}
    sizes |= {"xtick.labelsize": 8.5, "ytick.labelsize": 8.5}
    formats = {"axes.formatter.limits": (-3, 4), "axes.formatter.use_mathtext": True}
    return formats | {key: value * scale for key, value in sizes.items()}


def _columns(legend: Mapping[str, Any], width: float) -> int:
    """As many as fit next to each other at this width."""
    letters = max((len(entry["text"]) for entry in legend["entries"]), default=1) + 6
    return max(1, min(int(legend["columns"]), int(width * 72.0 / (4.0 * letters))))


def _cell_of(page: Figure, chain: list[list[Any]], grids: dict[Any, Any]) -> Any:
    spec: Any = None
    key: tuple[Any, ...] = ()
    for shape, rows, columns, heights, widths in chain:
        key = (*key, tuple(shape))
        if key not in grids:
            ratios = {"height_ratios": heights, "width_ratios": widths}
            make = page.add_gridspec if spec is None else spec.subgridspec
            grids[key] = make(*shape, **ratios)
        spec = grids[key][rows[0] : rows[1], columns[0] : columns[1]]
        key = (*key, tuple(rows), tuple(columns))
    return spec


def _fit(page: Figure, layout: ConstrainedLayoutEngine, right: float) -> None:
    """Draw the panels in by what still sticks out of the page, then keep the layout as it is."""
    width, height = page.get_size_inches()
    left = low = over = high = 0.0
    for _ in range(_MOST_LAYOUTS):
        page.draw_without_rendering()
        box = page.get_tightbbox()
        out = (-box.x0 / width, -box.y0 / height, box.x1 / width - 1.0, box.y1 / height - 1.0)
        if max(out) < _SPILL:
            break
        left, low, over, high = (a + max(0.0, b) for a, b in zip((left, low, over, high), out, strict=True))
        layout.set(rect=(left, low, right - left - over, 1.0 - low - high))
    # How many ticks fit follows from settings that end with this figure's style.
    for axes in page.axes:
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(FixedLocator([float(place) for place in axis.get_majorticklocs()]))
    page.set_layout_engine("none")


def _is_narrow(panel: Mapping[str, Any]) -> bool:
    """Whether a panel stands outside the grid, as a colour scale does."""
    return not panel["cells"] and panel["twin_of"] is None


def _narrow_place(panel: Mapping[str, Any], growth: float) -> tuple[float, float, float, float]:
    """Place of a colour scale: its letters take a larger share of a smaller figure."""
    left, bottom, width, height = panel["place"]
    return max(0.5, 1.0 - (1.0 - left) * max(1.0, growth)), bottom, width, min(height, 0.92 - bottom)


def _break_label(axes: Axes) -> None:
    """Put the unit of an abscissa below its name where both are longer than the axis."""
    label = axes.xaxis.label
    if " / " in label.get_text() and label.get_window_extent().width > axes.get_window_extent().width:
        name, _, unit = label.get_text().rpartition(" / ")
        label.set_text(f"{name}\n/ {unit}")


def _thin_out(axes: Axes) -> None:
    """Blank the labels of ticks that would touch a neighbour's; whole decades stay first."""
    for axis in (axes.xaxis, axes.yaxis):
        labels = [tick for tick in axis.get_majorticklabels() if tick.get_visible() and tick.get_text()]
        boxes = [tick.get_window_extent().padded(2.0) for tick in labels]
        order = sorted(range(len(labels)), key=lambda k: ("times" in labels[k].get_text(), k))
        kept: list[Any] = []
        dropped = set()
        for k in order:
            if any(boxes[k].overlaps(box) for box in kept):
                dropped.add(labels[k].get_text())
            else:
                kept.append(boxes[k])
        if dropped:
            axis.set_ticks(
                axis.get_majorticklocs(),
                ["" if tick.get_text() in dropped else tick.get_text() for tick in axis.get_majorticklabels()],
            )


def _draw(axes: Axes, panel: Mapping[str, Any], letters: float, growth: float) -> None:
    for name in ("x", "y"):
        axis = panel[name]
        if axis["scale"] == "symlog":
            getattr(axes, f"set_{name}scale")("symlog", linthresh=axis["linthresh"], linscale=axis["linscale"])
        else:
            getattr(axes, f"set_{name}scale")(axis["scale"])
    for series in panel["series"]:
        _draw_series(axes, series, letters)
    for name in ("x", "y"):
        _set_axis(axes, name, panel[name])
    for side, spine in axes.spines.items():
        spine.set_visible(side in panel["spines"])
    narrow = _is_narrow(panel)
    axes.set_title(panel["title"], loc="center" if narrow else "left", fontweight="normal" if narrow else "bold")
    for second in panel["second_axes"]:
        factor = float(second["factor"])
        functions = partial(operator.mul, factor), partial(operator.mul, 1.0 / factor)
        other = axes.secondary_yaxis(1.0 + (second["place"] - 1.0) * growth, functions=functions)
        other.set_ylabel(second["label"], color=second["colour"])
        other.tick_params(colors=MUTED, labelcolor=MUTED)
        other.spines["right"].set_visible(True)
        other.spines["right"].set_color(MUTED)
    for text in panel["texts"]:
        axes.annotate(
            text["text"], (text["x"], text["y"]), xycoords=tuple(text["system"]), xytext=text["offset"],
            textcoords="offset points", color=text["colour"], fontsize=text["size"] * letters, ha=text["ha"],
            va=text["va"], rotation=text["rotation"],
        )  # fmt: skip
    if panel.get("drawing"):
        axes.set_axis_off()
        axes.set_aspect("equal")
    if panel["legend"]:
        legend = panel["legend"]
        handles, texts = _handles(legend, letters)
        outside = legend["anchor"] is not None and not np.allclose(legend["anchor"], (0.0, 0.0, 1.0, 1.0), atol=1e-3)
        place = {"bbox_to_anchor": legend["anchor"]} if outside else {}
        axes.legend(
            handles, texts, loc=legend["place"] or "best", ncols=legend["columns"], frameon=legend["frame"], **place
        )


def _set_axis(axes: Axes, name: str, axis: Mapping[str, Any]) -> None:
    getattr(axes, f"set_{name}label")(axis["label"], color=axis["colour"])
    if None not in axis["limits"]:
        getattr(axes, f"set_{name}lim")(*axis["limits"])
    # The report's ticks suit its size; fewer fit on a narrow figure, so matplotlib chooses where it can.
    if not axis["free"]:
        getattr(axes, f"set_{name}ticks")(axis["ticks"], axis["tick_labels"])
        getattr(axes, f"{name}axis").set_minor_locator(NullLocator())
    elif not axis["ticks"]:
        getattr(axes, f"set_{name}ticks")([])
    else:
        axes.ticklabel_format(axis=name, useOffset=False)  # type: ignore[arg-type]
        ticks = np.asarray(axis["ticks"])
        if np.all(ticks % 1.0 == 0.0) and np.all(np.diff(ticks) == 1.0):  # points are counted
            getattr(axes, f"{name}axis").set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    if axis["side"] in ("left", "right", "top", "bottom"):
        getattr(axes, f"{name}axis").set_ticks_position(axis["side"])
    if not axis["labelled"]:
        axes.tick_params(axis=name, labelbottom=False, labelleft=False)  # type: ignore[arg-type]
    axes.grid(axis["grid"], axis=name)  # type: ignore[arg-type]


def _look(series: Mapping[str, Any], letters: float) -> dict[str, Any]:
    look: dict[str, Any] = {
        "color": series["colour"],
        "alpha": series.get("alpha"),
        "linewidth": series["width"] * letters,
        "linestyle": "-" if series["width"] else "none",
        "drawstyle": series.get("step", "default"),
    }
    if series.get("marker", "None") not in ("None", "", "none"):
        look |= {
            "marker": series["marker"],
            "markersize": series["marker_size"] * letters,
            "markerfacecolor": series["marker_face"],
            "markeredgewidth": series["marker_edge"] * letters,
        }
    if series["width"] and series.get("dashes"):
        look["dashes"] = series["dashes"]
    return look


def _values(series: Mapping[str, Any], key: str) -> Any:
    return np.array([np.nan if value is None else value for value in series.get(key) or ()], dtype=float)


def _draw_series(axes: Axes, series: Mapping[str, Any], letters: float) -> None:
    kind = series["kind"]
    x, y = _values(series, "x"), _values(series, "y")
    x_low, x_high = _values(series, "x_low"), _values(series, "x_high")
    y_low, y_high = _values(series, "y_low"), _values(series, "y_high")
    if kind == "line":
        axes.plot(x, y, **_look(series, letters))
    elif kind == "level line":
        axes.axhline(y[0], **{k: v for k, v in _look(series, letters).items() if k != "drawstyle"})
    elif kind == "upright line":
        axes.axvline(x[0], **{k: v for k, v in _look(series, letters).items() if k != "drawstyle"})
    elif kind == "points":
        bar = {"color": series.get("bar_colour", series.get("colour")), "linewidth": letters}
        if y_low.size:
            axes.vlines(x, y_low, y_high, **bar)
        if x_low.size:
            axes.hlines(y if y.size else 0.5 * (y_low + y_high), x_low, x_high, **bar)
        if "marker" in series:
            axes.plot(x, y, **_look(series, letters))
    elif kind == "bars":
        axes.bar(x, y_high - y_low, _values(series, "thickness"), bottom=y_low, color=series["colour"], linewidth=0)
    elif kind == "level bars":
        axes.barh(y, x_high - x_low, _values(series, "thickness"), left=x_low, color=series["colour"], linewidth=0)
    elif kind == "area":
        axes.fill_between(x, y_low, y_high, color=series["colour"], linewidth=0.0)
    elif kind == "level segments":
        axes.hlines(y, x_low, x_high, color=series["colour"], linewidth=series["width"] * letters)
    elif kind == "upright bars":
        axes.vlines(x, y_low, y_high, color=series["colour"], linewidth=series["width"] * letters)
    elif kind == "band":
        axes.axvspan(x_low[0], x_high[0], color=series["colour"], linewidth=0.0)
    elif kind == "box":
        axes.add_patch(
            Rectangle(
                (x_low[0], y_low[0]), x_high[0] - x_low[0], y_high[0] - y_low[0], color=series["colour"], linewidth=0
            )
        )
    elif kind == "map":
        _draw_map(axes, series, x, y)


def _draw_map(axes: Axes, series: Mapping[str, Any], x: Any, y: Any) -> None:
    rows, columns = series["shape"]
    place_x, place_y = x.reshape(rows, columns)[0], y.reshape(rows, columns)[:, 0]
    half_x = 0.5 * float(np.diff(place_x).mean()) if columns > 1 else 0.5
    half_y = 0.5 * float(np.diff(place_y).mean()) if rows > 1 else 0.5
    for index, colour in enumerate(series["colours"]):
        row, column = divmod(index, columns)
        corner = (place_x[column] - half_x, place_y[row] - half_y)
        axes.add_patch(Rectangle(corner, 2 * half_x, 2 * half_y, facecolor=colour, edgecolor="white", linewidth=0.5))


def _handles(legend: Mapping[str, Any], letters: float) -> tuple[list[Any], list[str]]:
    handles: list[Any] = []
    for entry in legend["entries"]:
        if entry.get("patch"):
            handles.append(Patch(color=entry["colour"], linewidth=0))
            continue
        look = _look(entry, letters)
        dashes = look.pop("dashes", None)
        line = Line2D([], [], **look)
        if dashes:
            line.set_dashes(dashes)
        handles.append(line)
    return handles, [entry["text"] for entry in legend["entries"]]
