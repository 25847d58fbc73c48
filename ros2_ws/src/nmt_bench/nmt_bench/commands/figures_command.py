"""``./nmt figures``: the figures of a report as files for a paper, each with its table."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from nmt_bench.commands.output_folder import OutputFolder, check_output
from nmt_bench.commands.shared_options import folder_option, replace_option
from nmt_core.errors import BenchError
from nmt_core.options import argument, option


@dataclass(frozen=True, kw_only=True)
class FiguresOptions:
    """Draws every figure of a report anew at the width of a column, with letters of a stated size, and writes the
    plotted numbers next to it as a table with one point a row. Figures that take the page get two columns."""

    source: Path = argument("results folder of any command with a report, or a report.html", metavar="DIR")
    format: str = option(
        "svg,pdf,png", "svg, pdf, png, eps; several by commas (default: all but eps)", metavar="FORMAT"
    )
    width: str = option("85mm", "width of a column, in mm, cm or in (default: 85mm)", metavar="WIDTH")
    letters: float = option(7.0, "letter size, points (default: 7)", metavar="PT")
    figure: tuple[str, ...] = option((), "only this figure; may be repeated (default: all)", metavar="NAME")
    out: Path | None = folder_option("FIGURE.svg, .pdf, .png, .csv; by default DIR/figures")
    force: bool = replace_option()


def run(options: FiguresOptions) -> int:
    """Write the figures, print what was written.

    Raises:
        BenchError: no report, no such figure, a size out of its range, or the files cannot be written.
    """
    source: Path = options.source
    out: Path = options.out or (source if source.is_dir() else source.parent) / "figures"
    width = _millimetres(options.width)
    formats = list(dict.fromkeys(part.strip().lower().lstrip(".") for part in options.format.split(",")))
    check_output(out, options.force)

    from nmt_bench.commands.console import make_console
    from nmt_bench.commands.work_display import WorkDisplay
    from nmt_report.figure_files import write_figures

    console = make_console()
    with OutputFolder(out, options.force) as folder, WorkDisplay(console, ("reading the report",)):
        written = write_figures(source, folder, formats, width, options.letters, options.figure)
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
