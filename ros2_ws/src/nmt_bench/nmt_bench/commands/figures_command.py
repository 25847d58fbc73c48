"""``./nmt figures``: the figures of a report as files for a paper, each with its table."""

from __future__ import annotations

import argparse
from pathlib import Path

from nmt_bench.command_parser import Subparsers
from nmt_bench.commands.output_folder import OutputFolder, add_output_options, check_output
from nmt_core.errors import BenchError


def add_parser(subparsers: Subparsers) -> None:
    """Add the command and its options."""
    parser = subparsers.add_parser(
        "figures",
        help="figures of a report as SVG, PDF and PNG for a paper, each with its table",
        description=(
            "Draws every figure of a report anew at the width of a column, with letters of a stated size, and writes "
            "the plotted numbers beside it as a table with one point a row. Figures that take the page get two "
            "columns."
        ),
    )
    parser.add_argument(
        "source", metavar="DIR", type=Path, help="results folder of any command with a report, or a report.html"
    )
    parser.add_argument(
        "--format", default="svg,pdf,png", help="svg, pdf, png, eps; several by commas (default: all but eps)"
    )
    parser.add_argument("--width", default="85mm", help="width of a column, in mm, cm or in (default: 85mm)")
    parser.add_argument("--letters", type=float, default=7.0, metavar="PT", help="letter size, points (default: 7)")
    parser.add_argument(
        "--figure", action="append", default=[], metavar="NAME", help="only this figure; may be repeated (default: all)"
    )
    add_output_options(parser, "FIGURE.svg, .pdf, .png, .csv; by default DIR/figures", dated=False)


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
