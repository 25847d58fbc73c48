"""Pages of very many levels: nothing is lost from the tables, and figures and paths stay what they were."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from report.synthetic_run import synthetic_run

from nmt_report import backbone_figures
from nmt_report.error_bars import joined_error_bars
from nmt_report.figure_files import FIGURE_NUMBERS
from nmt_report.figure_record import record, unpacked
from nmt_report.run_report import report_html
from nmt_report.shown_levels import MOST_CURVES, shown_note, spread_evenly
from nmt_report.svg import BLUE, figure_style, shortened_path, svg_text


@pytest.mark.parametrize(("count", "most"), [(1, 2), (7, 7), (8, 7), (25, 24), (47, 24), (1000, 24), (13, 12)])
def test_items_are_spread_evenly_and_none_comes_twice(count: int, most: int) -> None:
    chosen = spread_evenly(range(count), most)
    assert len(set(chosen)) == len(chosen) == min(count, most)
    assert (chosen[0], chosen[-1]) == (0, count - 1)
    assert np.ptp(np.diff(chosen)) <= 1 if len(chosen) > 1 else True
    assert shown_note(len(chosen), count) == (f" {most} of {count} levels are shown." if count > most else "")


def corners(way: str) -> list[tuple[str, tuple[float, ...]]]:
    """Steps of a path of M, L, Q, C and z, as the SVG standard reads letters that are left out."""
    size = {"M": 2, "L": 2, "Q": 4, "C": 6, "z": 0}
    found, letter, numbers = [], "", []
    for word in re.findall(r"[MLQCz]|-?[\d.]+", way):
        if word in size:
            letter, numbers = word, []
        else:
            numbers.append(float(word))
        if len(numbers) == size[letter]:
            found.append((letter, tuple(numbers)))
            letter, numbers = ("L" if letter == "M" else letter), []
    return found


def test_a_shortened_path_is_the_same_path() -> None:
    rng = np.random.default_rng(4)
    size = {"L": 2, "Q": 4, "C": 6}
    steps = []
    for letter in ["M", *rng.choice(["L", "Q", "C"], 40), "z", "M", "L", "L", "M", "L", "z"]:
        numbers = np.round(rng.uniform(-900, 900, size.get(letter, 2)), 2) if letter != "z" else []
        steps.append(" ".join([str(letter), *(f"{value:.2f}" for value in numbers)]))
    way = " \n".join(steps) + " \n"
    assert corners(shortened_path(way)) == corners(way)
    assert len(shortened_path(way)) < len(way)


def test_a_drawn_figure_is_recorded_as_one_that_is_drawn_for_it() -> None:
    def figure() -> Figure:
        made = Figure(figsize=(6.3, 4.2))
        axes = made.subplots()
        axes.errorbar([1, 2, 3], [4.0, 5.0, 7.0], [0.1, 0.2, 0.3], fmt="o", label="measured")
        axes.plot([1, 2, 3], [4.1, 5.1, 6.9], label="model")
        axes.set_xscale("log")
        axes.legend(loc="best")
        return made

    with figure_style():
        page = svg_text(figure(), "one", "title")
        assert unpacked(FIGURE_NUMBERS.findall(page)[0]) == record(figure(), "one", "title")


def test_error_bars_of_many_points_are_recorded_and_drawn_as_those_of_few() -> None:
    x, y = np.geomspace(1.0, 9.0, 30), np.linspace(4.0, 5.0, 30)
    y_std, x_std = np.full(30, 0.1), 0.01 * x

    def figure(joined: bool) -> Figure:
        made = Figure(figsize=(6.3, 4.2))
        axes = made.subplots()
        if joined:
            joined_error_bars(axes, x, y, y_std, x_std, colour=BLUE, width=1.0)
        else:
            axes.errorbar(x, y, y_std, x_std, fmt="none", ecolor=BLUE, elinewidth=1.0, capsize=0.0)
        axes.plot(x, y, "o", color=BLUE)
        axes.set_xscale("log")
        return made

    with figure_style():
        one, other = (svg_text(figure(joined), "one", "title") for joined in (True, False))
    assert unpacked(FIGURE_NUMBERS.findall(one)[0]) == unpacked(FIGURE_NUMBERS.findall(other)[0])
    ways = [[corners(way) for way in re.findall(r'<path d="([^"]*)"', page)] for page in (one, other)]
    assert ways[0] == ways[1]


@pytest.mark.campaign
def test_crowded_figures_keep_every_level_in_their_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    few, many = 5, MOST_CURVES + 6
    monkeypatch.setattr(backbone_figures, "MOST_MARKS", many - 1)
    pages = {}
    for levels in (few, many):
        data = synthetic_run(levels=levels, failed=None, reference=False)
        pages[levels] = report_html(replace(data, history=None, envelopes=[], excerpts=[]))
        figures = {figure["name"]: figure for figure in map(unpacked, FIGURE_NUMBERS.findall(pages[levels]))}
        marks = [
            series
            for series in figures["backbone"]["panels"][0]["series"]
            if series["kind"] == "line" and series["marker"] == "o" and not series["width"]
        ]
        assert np.allclose(
            [value for series in marks for value in series["y"]],
            [point.omega_rad_s / (2.0 * np.pi) for point in data.points],
            rtol=1e-7,
        )
    assert "<title>level 1:" in pages[few]
    assert "<title>level" not in pages[many]
    assert f" {MOST_CURVES} of {many} levels are shown." in pages[many]
    assert "levels are shown" not in pages[few]
    # Every level has its row.
    assert pages[many].count("<tr>") > many
