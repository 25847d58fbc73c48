"""``./nmt figures``: the figures of a report as files for a paper, each with its table."""

from __future__ import annotations

import argparse
from pathlib import Path

from nmt_bench.commands.output_folder import OutputFolder, check_output
from nmt_core.errors import BenchError

USAGE = """\
Draws every figure of a report anew at the width of a column, with letters of a stated size, and writes the plotted
numbers beside it as a table with one point a row. Figures that take the page get two columns.

DIR >source  results folder of any command with a report, or a report.html
--format FORMAT =svg,pdf,png  svg, pdf, png, eps; several by commas (default: all but eps)
--width WIDTH =85mm  width of a column, in mm, cm or in (default: 85mm)
--letters PT =7  letter size, points (default: 7)
--figure NAME...  only this figure; may be repeated (default: all)
@output-undated FIGURE.svg, .pdf, .png, .csv; by default DIR/figures
"""


def run(arguments: argparse.Namespace) -> int:
    """Write the figures, print what was written.

    Raises:
        BenchError: no report, no such figure, a size out of its range, or the files cannot be written.
    """
    source: Path = arguments.source
    out: Path = arguments.out or (source if source.is_dir() else source.parent) / "figures"
    width = _millimetres(arguments.width)
    formats = list(dict.fromkeys(part.strip().lower().lstrip(".") for part in arguments.format.split(",")))
    check_output(out, arguments.force)

    from nmt_bench.commands.console import make_console
    from nmt_bench.commands.work_display import WorkDisplay
    from nmt_report.figure_files import write_figures

    console = make_console()
    with OutputFolder(out, arguments.force) as folder, WorkDisplay(console, ("reading the report",)):
        written = write_figures(source, folder, formats, width, arguments.letters, arguments.figure)
    kinds = ", ".join([*formats, "csv"])
    for figure in written:
        console.print(f"{figure.name}: {figure.title}", soft_wrap=True)
    console.print(f"{len(written)} figures in {out}, each as {kinds}.", soft_wrap=True)
    return 0


_UNITS = {"mm": 1.0, "cm": 10.0, "in": 25.4, "": 1.0}


def _millimetres(text: str) -> float:
    number = text.strip().lower()
    unit = next((unit for unit in ("mm", "cm", "in") if number.endswith(unit)), "")
    try:
        return float(number.removesuffix(unit)) * _UNITS[unit]
    except ValueError:
        raise BenchError(f"--width must be a length as in 85mm, 8.5cm or 3.35in, got '{text}'.") from None
