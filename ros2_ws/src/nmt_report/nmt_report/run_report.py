"""``report.html``: one self-contained file that shows a run, readable offline and good to print."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from nmt_core.files.whole_file import write_whole
from nmt_extract.curves.response_curve import is_of_curve
from nmt_report.run_data import FileEntry, ReferenceCurve, RunReportData, read_reference
from nmt_report.run_data_from_bag import report_data_from_bag
from nmt_report.shared_work import font_is_open, results_of
from nmt_report.stated_uncertainty import with_budgets
from nmt_report.svg import ReportFigure, figure_style

__all__ = [
    "FileEntry",
    "ReferenceCurve",
    "RunReportData",
    "list_files",
    "read_reference",
    "report_data_from_bag",
    "report_html",
    "write_report",
]

_Builder = Callable[[RunReportData], "ReportFigure | None"]


def write_report(data: RunReportData, path: Path | str) -> Path:
    """Write a run's report; the file is whole or not there.

    Args:
        data: the run.
        path: where to write, for example ``OUT/report.html``.

    Returns:
        The path written.
    """
    path = Path(path)
    write_whole(path, report_html(data))
    return path


def report_html(data: RunReportData) -> str:
    """The report as HTML text; the same text for the same data."""
    from nmt_report import backbone_figures as report_backbone
    from nmt_report import curve_figures as report_curves
    from nmt_report import history_figures as report_history
    from nmt_report import hysteresis_figures as report_hysteresis
    from nmt_report import run_page as report_page
    from nmt_report import shape_figures as report_shapes

    of_curve = is_of_curve(data.points)
    backbone = (report_backbone.frequency_figure, report_backbone.damping_figure)
    builders: dict[str, tuple[_Builder, ...]] = {
        "first": (report_curves.curve_figure,) if of_curve else backbone,
        "modal": (
            report_backbone.indicator_figure,
            report_backbone.participation_figure,
        ),
        "shape": (
            report_shapes.shape_figure,
            report_backbone.amplitude_figure,
            report_shapes.harmonics_figure,
            report_hysteresis.hysteresis_figure,
        ),
        "run": (
            report_history.history_figure,
            report_history.envelope_figure,
            report_history.excerpt_figure,
        ),
    }
    data = replace(data, points=with_budgets(data.points, data.budgets))
    wanted = [
        (section, function)
        for section, functions in builders.items()
        if section == "run" or data.good_points
        for function in functions
    ]
    with figure_style():
        made = results_of([partial(function, data) for _, function in wanted], alone=font_is_open())
        figures: dict[str, list[ReportFigure]] = {section: [] for section, _ in wanted}
        for (section, _), figure in zip(wanted, made, strict=True):
            if figure is not None:
                figures[section].append(figure)
        if data.good_points:
            figures["modal"] += report_backbone.quantity_figures(data)
    return report_page.page(data, figures)


def list_files(folder: Path, leave_out: tuple[str, ...] = ("report.html",)) -> list[FileEntry]:
    """Names, sizes and SHA-256 of all files below a folder, sorted by name."""
    entries = []
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and name not in leave_out:
            entries.append(FileEntry(name, path.stat().st_size, _sha256(path)))
    return entries


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(1 << 20):
            digest.update(chunk)
    return digest.hexdigest()
