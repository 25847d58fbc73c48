"""Figures as inline SVG: no outside reference, no clash of ids between figures, hover texts on points."""

from __future__ import annotations

import gc
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from io import StringIO
from typing import Any

import matplotlib
from markupsafe import Markup, escape
from matplotlib.backends.backend_svg import RendererSVG
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter
from matplotlib.transforms import Bbox

from nmt_report.figure_record import packed, record
from nmt_report.kept_formulas import kept_formulas

FIGURE_TYPE = "application/x-nmt-figure"
"""Kind of the element that holds a figure's numbers; nothing that a browser would run."""

_HALF_PAGE = 600.0
"""Points: a wider figure takes the whole page."""

_SCALE_WIDTH = 0.05
"""Share of a figure's width: narrower axes are a colour scale, and stay with the others."""

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
    "axes.titley": 1.0,  # no axis has labels above it, which matplotlib would measure to keep clear of them
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
    "figure.dpi": 72.0,  # that of SVG
    "figure.facecolor": "none",
    "axes.facecolor": "none",
}


@contextmanager
def figure_style() -> Iterator[None]:
    """The look of all figures; nothing of it stays behind.

    Figures are very many small objects: looking through them for garbage would take a quarter of the time.
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        with matplotlib.rc_context(), kept_formulas():
            matplotlib.rcdefaults()
            matplotlib.rcParams.update(_STYLE)
            yield
    finally:
        if collects:
            gc.enable()


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
    for number, part in enumerate((*figure.axes, *figure.legends)):
        part.set_gid(part.get_gid() or f"part-{number}")
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
    text = re.sub(r'\bd="([^"]+)"', lambda match: f'd="{shortened_path(match[1])}"', text)
    text = re.sub(r">\s+<", "><", text)
    text = _merged_paths(_DOTS.sub(_dots, text))
    titles = {f"{name}-{gid}": f"<title>{escape(tip)}</title>" for gid, tip in (tips or {}).items()}
    if titles:
        text = re.sub(r'<g id="([^"]+)">', lambda match: match[0] + titles.pop(match[1], ""), text)
    width, height = figure.get_size_inches() * 72.0
    words = label.striptags() if isinstance(label, Markup) else label
    head = f'<svg class="plot" role="img" aria-label="{escape(words)}" viewBox="0 0 {width:g} {height:g}"'
    text = re.sub(r"<svg\b[^>]*", lambda _: head, text, count=1).strip()
    numbers = packed(record(figure, name, words, bool(width > _HALF_PAGE), drawn=True))
    return Markup(f'{text}{_columns(figure, name)}<script type="{FIGURE_TYPE}">{numbers}</script>')


class ScaledNumbers(ScalarFormatter):
    """Tick labels as text next to a common power of ten: matplotlib would set every number as a formula, which is slow.

    Args:
        limits: exponents within which no common power is used.
    """

    def __init__(self, limits: tuple[int, int]) -> None:
        super().__init__(useMathText=True)
        self.set_powerlimits(limits)

    def __call__(self, value: float, place: int | None = None) -> str:
        """The label of one tick."""
        return _NUMBER.sub(r"\1", super().__call__(value, place))


_NUMBER = re.compile(r"\$\\mathdefault\{(.*)\}\$")


def _columns(figure: Figure, name: str) -> str:
    """Views of the columns of a figure, for a narrow screen to show below each other; empty for one column.

    A view draws nothing anew: it refers to the figure's own elements, and not to those of its neighbours.
    """
    columns: list[tuple[float, list[Any]]] = []
    for axes in sorted(figure.axes, key=lambda axes: float(axes.get_position().x0)):
        left, right = axes.get_position().x0, axes.get_position().x1
        if not axes.get_visible():
            continue
        is_narrow = right - left < _SCALE_WIDTH or (columns and left < columns[-1][0])
        if columns and is_narrow:
            columns[-1] = max(columns[-1][0], right), [*columns[-1][1], axes]
        else:
            columns.append((right, [axes]))
    if len(columns) < 2:
        return ""
    groups = [[legend] for legend in figure.legends] + [group for _, group in columns]
    width, height = figure.get_size_inches() * 72.0
    # Text is measured as it was drawn: any other renderer would set all formulas anew.
    renderer = RendererSVG(width, height, StringIO(), image_dpi=72)  # type: ignore[no-untyped-call]
    views = ""
    for group in groups:
        boxes = (item.get_tightbbox(renderer) for item in group)
        box = Bbox.union([box for box in boxes if box is not None])
        place = (box.x0 - 2.0, height - box.y1 - 2.0, box.width + 4.0, box.height + 4.0)
        frame = " ".join(f"{value:.1f}" for value in place)
        parts = "".join(f'<use href="#{name}-{item.get_gid()}"/>' for item in group)
        views += f'<svg viewBox="{frame}" aria-hidden="true">{parts}</svg>'
    return f'<div class="panels">{views}</div>'


def shortened_path(way: str) -> str:
    """A path with two decimals, each letter once for a row of equal steps, and lines after a move without theirs."""
    words: list[str] = []
    last = ""
    for step in _TAIL.sub("", way).split("\n"):
        letter, _, numbers = step.strip().partition(" ")
        repeated = letter == last and letter in ("L", "Q", "C")
        words.append(numbers if repeated or (letter, last) == ("L", "M") else f"{letter}{numbers}")
        last = letter
    return " ".join(words).strip()


_PATH = re.compile(r'<path d="([^"]*)"([^>]*)/>')
_MARK = re.compile(r'<use href="([^"]*)" x="([^"]*)" y="([^"]*)" style="([^"]*)"/>')
_ADJOINING = re.compile(r'<path d="[^"]*"([^>]*)/>(?:\s*<path d="[^"]*"\1/>)+')
_MARKS = re.compile(
    r'<use href="([^"]*)" x="[^"]*" y="[^"]*" style="([^"]*)"/>(?:\s*<use href="\1" x="[^"]*" y="[^"]*" style="\2"/>)+'
)


def _merged_paths(text: str) -> str:
    """Neighbouring paths of one look as one, and marks with their common look said once: far shorter for many points.

    Strokes that one can see through stay apart: where they cross, they add up.
    """

    def paths(match: re.Match[str]) -> str:
        if "opacity" in match[1]:
            return match[0]
        ways = " ".join(way.strip() for way, _ in _PATH.findall(match[0]))
        return f'<path d="{ways}"{match[1]}/>'

    def marks(match: re.Match[str]) -> str:
        uses = "".join(
            f'<use href="{href}" x="{_TAIL.sub("", x)}" y="{_TAIL.sub("", y)}"/>'
            for href, x, y, _ in _MARK.findall(match[0])
        )
        return f'<g style="{match[2]}">{uses}</g>'

    return _MARKS.sub(marks, _ADJOINING.sub(paths, text))


DOTS = "dots"
"""``gid`` of lines, before a hyphen, whose many marks are round and may be written as one path."""

_DOTS = re.compile(rf'(<g id="[^"]*-{DOTS}-[^"]*">).*?<g clip-path="([^"]*)">(.*?)</g>\s*</g>', re.S)
_COLOUR = re.compile(r"stroke: ([^;\"]*)")


def _dots(match: re.Match[str]) -> str:
    """Round marks as lines of no length with round ends."""
    marks = _MARK.findall(match[3])
    colour = _COLOUR.search(marks[0][3]) if marks else None
    if colour is None:
        return match[0]
    ways = "".join(f"M{_TAIL.sub('', x)} {_TAIL.sub('', y)}h0" for _, x, y, _ in marks)
    size = _STYLE["lines.markersize"] + 1.0  # with its edge
    style = f"fill: none; stroke: {colour[1]}; stroke-width: {size:g}; stroke-linecap: round"
    return f'{match[1]}<path d="{ways}" clip-path="{match[2]}" style="{style}"/></g>'


_TAIL = re.compile(r"(?<=\.\d\d)\d+")


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
