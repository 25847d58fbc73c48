"""Figures as inline SVG: no outside reference, no clash of ids between figures, hover texts on points."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from io import StringIO
from typing import Any

import matplotlib
from markupsafe import Markup, escape
from matplotlib.figure import Figure

from nmt_report.figure_record import packed, record

FIGURE_TYPE = "application/x-nmt-figure"
"""Kind of the element that holds a figure's numbers; nothing that a browser would run."""

_HALF_PAGE = 600.0
"""Points: a wider figure takes the whole page."""

INK = "#22272e"
MUTED = "#6b7480"
GRID = "#e3e7ec"
BLUE = "#1f5fa8"
ORANGE = "#c4570c"
RED = "#b3261e"
GREEN = "#2e7d4f"

_STYLE: Any = {
    "svg.fonttype": "path",
    "font.family": "DejaVu Sans",
    "mathtext.fontset": "dejavusans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.labelsize": 9.0,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "text.color": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "lines.linewidth": 1.4,
    "lines.markersize": 4.5,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "path.simplify": True,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
}


@contextmanager
def figure_style() -> Iterator[None]:
    """The look of all figures; nothing of it stays behind."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        yield


def svg_text(figure: Figure, name: str, label: str, tips: Mapping[str, str] | None = None) -> Markup:
    """Render a figure to an ``<svg>`` element for an HTML page.

    Args:
        figure: the figure; laid out as it is.
        name: prefix of all ids, unique on the page.
        label: what the figure shows, for readers who do not see it.
        tips: hover text by artist ``gid``.

    Returns:
        The element, scaled by its container, and behind it the figure's numbers, from which a page saves a table and
        ``./nmt figures`` draws the figure anew; the same text for the same figure.
    """
    buffer = StringIO()
    with matplotlib.rc_context({"svg.hashsalt": name}):
        figure.savefig(buffer, format="svg", metadata={"Creator": None, "Date": None, "Format": None, "Type": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.S)
    text = re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", text)
    text = text.replace("xlink:href", "href")
    text = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', text)
    text = text.replace('href="#', f'href="#{name}-').replace("url(#", f"url(#{name}-")
    # Two decimals are a hundredth of a point; more would double the size of the page.
    text = re.sub(r'\bd="([^"]+)"', lambda match: 'd="' + re.sub(r"(\.\d\d)\d+", r"\1", match[1]) + '"', text)
    for gid, tip in (tips or {}).items():
        opening = f'<g id="{name}-{gid}">'
        text = text.replace(opening, f"{opening}<title>{escape(tip)}</title>", 1)
    width, height = figure.get_size_inches() * 72.0
    words = label.striptags() if isinstance(label, Markup) else label
    head = f'<svg class="plot" role="img" aria-label="{escape(words)}" viewBox="0 0 {width:g} {height:g}"'
    text = re.sub(r"<svg\b[^>]*", lambda _: head, text, count=1).strip()
    numbers = packed(record(figure, name, words, bool(width > _HALF_PAGE)))
    return Markup(f'{text}<script type="{FIGURE_TYPE}">{numbers}</script>')


@dataclass(frozen=True)
class ReportFigure:
    """One figure of a report.

    Attributes:
        name: anchor on the page.
        title: heading, plain text.
        caption: one or two sentences below the figure; markup where they have symbols.
        svg: the ``<svg>`` element.
        wide: whether it takes the width of the page instead of half of it.
    """

    name: str
    title: str
    caption: str
    svg: Markup
    wide: bool = False


def level_colours(count: int) -> list[tuple[float, float, float]]:
    """One colour a level, dark (low) to warm (high), legible on white and in greyscale print."""
    map_ = matplotlib.colormaps["plasma"]
    steps = [0.45] if count == 1 else [0.02 + 0.82 * index / (count - 1) for index in range(count)]
    return [tuple(float(c) for c in map_(step)[:3]) for step in steps]  # type: ignore[misc]
