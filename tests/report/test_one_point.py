"""Figures of a rig of one point have axes that a reader would draw."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from report.synthetic_run import synthetic_run

from nmt_report import backbone_figures, shape_figures
from nmt_report.figure_record import record
from nmt_report.figure_redraw import redraw
from nmt_report.run_data import RunReportData
from nmt_report.svg import figure_style


def drawn(monkeypatch: pytest.MonkeyPatch, module: Any, name: str, data: RunReportData) -> list[Axes]:
    """Axes of a figure of the report, and of the same figure on paper."""
    figures: list[Any] = []
    original = module.svg_text
    monkeypatch.setattr(module, "svg_text", lambda figure, *rest: figures.append(figure) or original(figure, *rest))
    with figure_style():
        getattr(module, name)(data)
        again = redraw(record(figures[0], name, name, False))
    return [*figures[0].axes, *again.axes]


def one_point(data: RunReportData) -> RunReportData:
    points = [
        replace(
            point,
            points=point.points[:1],
            normalised_shape=point.normalised_shape[:1],
            shape_harmonics=point.shape_harmonics[:, :1],
            mac=1.0,
            gamma_force=1.0,
        )
        for point in data.points
    ]
    return replace(data, points=points, linear=None)


def test_one_point_is_counted_and_indicators_of_one_have_no_offset(monkeypatch: pytest.MonkeyPatch) -> None:
    data = one_point(synthetic_run(levels=3, failed=None))
    for axes in drawn(monkeypatch, shape_figures, "shape_figure", data):
        if axes.get_xlabel() == "measurement point":
            low, high = axes.get_xlim()
            assert [tick for tick in axes.get_xticks() if low < tick < high] == [data.points[0].points[0]]
    panels = [axes for axes in drawn(monkeypatch, backbone_figures, "indicator_figure", data) if axes.lines]
    of_one = [axes for axes in panels if axes.get_title("left") == "MAC"]
    assert len(of_one) == 2
    for axes in of_one:
        assert np.ptp(axes.get_ylim()) > 2e-3
        assert axes.yaxis.get_offset_text().get_text() == ""
