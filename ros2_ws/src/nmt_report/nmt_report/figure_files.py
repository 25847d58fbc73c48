"""Figures of a report as files: SVG, PDF or PNG for a paper, and the table behind each."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_text
from nmt_core.files.whole_file import write_whole
from nmt_core.processes.work_progress import tell
from nmt_report.figure_record import Record, tidy_csv, unpacked
from nmt_report.figure_redraw import FORMATS, redraw, save
from nmt_report.svg import FIGURE_TYPE

FIGURE_NUMBERS = re.compile(rf'<script type="{re.escape(FIGURE_TYPE)}">([A-Za-z0-9_=-]*)</script>')
_LETTERS = re.compile(r"[^A-Za-z0-9._-]+")


@dataclass(frozen=True)
class FigureFiles:
    """What was written of one figure.

    Attributes:
        name: of the figure on its page.
        title: what it shows.
        files: paths, the table last.
    """

    name: str
    title: str
    files: tuple[Path, ...]


def report_figures(report: Path | str) -> list[Record]:
    """The figures of a report, in the order of the page.

    Args:
        report: ``report.html``, or the results folder that holds it.

    Raises:
        BenchError: no such page, or exists it holds no figures that could be drawn anew.
    """
    path = Path(report)
    if path.is_dir():
        path = path / "report.html"
    if not path.exists():
        raise BenchError(f"There is no report.html in {report}; name a results folder or a report.")
    figures = [unpacked(match[1]) for match in FIGURE_NUMBERS.finditer(read_text(path, "report"))]
    if not figures:
        raise BenchError(f"{path} holds no figure data; make the report anew with this version ('./nmt extract BAG').")
    return figures


def write_figures(
    report: Path | str,
    folder: Path | str,
    formats: Sequence[str] = ("svg", "pdf", "png"),
    width_mm: float = 85.0,
    letters_pt: float = 7.0,
    names: Sequence[str] = (),
) -> list[FigureFiles]:
    """Write the figures of a report to a folder, each in several formats and as a table.

    Args:
        report: ``report.html``, or the results folder that holds it.
        folder: exists.
        formats: of :data:`nmt_report.figure_redraw.FORMATS`.
        width_mm: width of a column, 20 to 500 mm; figures that take the page get two columns and the gutter.
        letters_pt: size of the axis labels, 4 to 24 points.
        names: figures to write; all if empty.

    Returns:
        What was written, in the order of the page.

    Raises:
        BenchError: no report, no such figure or format, or a size out of its range.

    Examples:
        >>> written = nmt.write_figures("out/demo", "out/figures", formats=["svg"], names=["backbone"])
        >>> [figure.name for figure in written]
        ['backbone']
        >>> nmt.write_figures("out/demo", "out/figures", names=["portrait"])
        Traceback (most recent call last):
        nmt_core.errors.BenchError: The report has no figure 'portrait'; it has backbone, damping, ...
    """
    unknown = [kind for kind in formats if kind not in FORMATS]
    if unknown or not formats:
        raise BenchError(f"Figures are written as {', '.join(FORMATS)}, not as '{', '.join(unknown)}'.")
    if not 20.0 <= width_mm <= 500.0:
        raise BenchError(f"The width of a figure must be 20 to 500 mm, got {width_mm:g}.")
    if not 4.0 <= letters_pt <= 24.0:
        raise BenchError(f"The letters of a figure must be 4 to 24 points, got {letters_pt:g}.")
    figures = report_figures(report)
    known = [figure["name"] for figure in figures]
    missing = [name for name in names if name not in known]
    if missing:
        raise BenchError(f"The report has no figure '{missing[0]}'; it has {', '.join(known)}.")
    written = []
    chosen = [figure for figure in figures if not names or figure["name"] in names]
    for number, figure in enumerate(chosen):
        tell("drawing figures", number, len(chosen))
        stem = Path(folder) / (_LETTERS.sub("-", str(figure["name"])).strip("-.") or "figure")
        drawn = redraw(figure, width_mm, letters_pt)
        files = [stem.with_name(f"{stem.name}.{kind}") for kind in formats]
        for path in files:
            save(drawn, path)
        table = stem.with_name(f"{stem.name}.csv")
        write_whole(table, tidy_csv(figure))
        written.append(FigureFiles(str(figure["name"]), str(figure["title"]), (*files, table)))
    return written
