"""Figures for papers: every coordinate of a report's figures comes back, on paper as in the table."""

from __future__ import annotations

import base64
import csv
import io
import itertools
import json
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox
from report import diagnosis_fixture as fixture
from report.synthetic_run import synthetic_run

from nmt_bench import cli
from nmt_core.errors import BenchError
from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_report.diagnosis_report import diagnosis_page
from nmt_report.figure_files import report_figures, write_figures
from nmt_report.figure_record import packed, plain_text, record, tidy_csv, unpacked
from nmt_report.figure_redraw import redraw
from nmt_report.run_report import write_report

RUN = synthetic_run(levels=3, failed=None)


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    write_report(RUN, folder / "report.html")
    return folder


def rows(text: str, **wanted: str) -> list[dict[str, str]]:
    return [row for row in csv.DictReader(io.StringIO(text)) if all(row[key] == value for key, value in wanted.items())]


def column(found: list[dict[str, str]], name: str) -> np.ndarray:
    return np.array([float(row[name] or "nan") for row in found])


def test_table_of_every_kind_of_artist() -> None:
    figure = Figure()
    left, right = figure.subplots(1, 2)
    x = np.array([1.0, 2.0, 4.0])
    left.plot(x, [3.0, np.nan, 5.0], label=r"$\tilde\omega$ of it")
    left.errorbar(x, [1.0, 2.0, 3.0], yerr=[0.1, 0.2, 0.3], xerr=0.5, fmt="o", label="bars")
    left.fill_between(x, [0.0, 1.0, 2.0], [2.0, 1.5, 5.0], label="between")
    left.axhline(7.0)
    left.axvline(8.0)
    left.axvspan(2.5, 3.5)
    left.set_xlabel("time / s")
    left.legend()
    right.set_title("map")
    right.pcolormesh([0.0, 1.0, 2.0], [0.0, 10.0, 20.0, 30.0], np.arange(6.0).reshape(3, 2))
    right.bar([1.0, 2.0], [4.0, 6.0], 0.5, bottom=1.0, label="columns")
    right.vlines([0.5], [1.0], [9.0], label="upright")
    text = tidy_csv(record(figure, "f", "title"))
    line = rows(text, panel="1", series="ω̃ of it")
    assert column(line, "x").tolist() == [1.0, 2.0, 4.0]
    assert [row["y"] for row in line] == ["3.0", "", "5.0"]
    assert {row["x_name"] for row in line} == {"time / s"}
    bars = rows(text, series="bars")
    np.testing.assert_allclose(column(bars, "y"), [1, 2, 3])
    np.testing.assert_allclose(column(bars, "y_high") - column(bars, "y_low"), [0.2, 0.4, 0.6])
    np.testing.assert_allclose(column(bars, "x_high") - column(bars, "x_low"), 1.0)
    between = rows(text, series="between")
    np.testing.assert_allclose(column(between, "x"), x)
    np.testing.assert_allclose(column(between, "y_low"), [0.0, 1.0, 2.0])
    np.testing.assert_allclose(column(between, "y_high"), [2.0, 1.5, 5.0])
    single = {row["series"].rsplit(" ", 1)[0]: row for row in rows(text, panel="1") if row["x"] == "" or row["y"] == ""}
    assert (single["level line"]["y"], single["upright line"]["x"]) == ("7.0", "8.0")
    assert (single["band"]["x_low"], single["band"]["x_high"]) == ("2.5", "3.5")
    cells = [row for row in rows(text, panel="map") if row["value"]]
    assert [(row["x"], row["y"], row["value"]) for row in cells[:3]] == [
        ("0.5", "5.0", "0.0"),
        ("1.5", "5.0", "1.0"),
        ("0.5", "15.0", "2.0"),
    ]
    columns = rows(text, series="columns")
    np.testing.assert_allclose(column(columns, "y_high"), [5.0, 7.0])
    assert [(row["y_low"], row["y_high"]) for row in rows(text, series="upright")] == [("1.0", "9.0")]


def test_table_of_the_backbone_holds_the_modal_points(report: Path, tmp_path: Path) -> None:
    write_figures(report, tmp_path, ["pdf"], names=["backbone"])
    measured = rows((tmp_path / "backbone.csv").read_text(), panel="1")
    points = [row for row in measured if row["y_low"]]
    np.testing.assert_allclose(column(points, "x"), [p.modal_amplitude for p in RUN.good_points], rtol=1e-7)
    np.testing.assert_allclose(
        0.5 * (column(points, "y_low") + column(points, "y_high")),
        [p.omega_rad_s / (2 * np.pi) for p in RUN.good_points],
        rtol=1e-7,
    )
    assert RUN.reference is not None
    assert any(row["series"] == RUN.reference.label for row in measured)


@pytest.fixture(scope="module", params=["every kind", pytest.param("every figure", marks=pytest.mark.campaign)])
def redrawn(request: pytest.FixtureRequest, report: Path) -> dict[str, tuple[dict[str, Any], Figure]]:
    kinds: set[str] = set()
    found = {}
    for figure in report_figures(report):
        own = {series["kind"] for panel in figure["panels"] for series in panel["series"]}
        if own - kinds or figure["name"] == "history" or request.param == "every figure":
            found[figure["name"]] = (figure, redraw(figure, 85.0, 7.0))
        kinds |= own
    return found


def test_a_redrawn_figure_has_the_same_coordinates(redrawn: dict[str, tuple[dict[str, Any], Figure]]) -> None:
    for name, (kept, page) in redrawn.items():
        drawn = record(page, name, kept["title"], kept["wide"])
        assert len(drawn["panels"]) == len(kept["panels"]), name
        for new, old in zip(drawn["panels"], kept["panels"], strict=True):
            assert new["x"]["limits"] == pytest.approx(old["x"]["limits"], rel=1e-6), name
            assert new["y"]["limits"] == pytest.approx(old["y"]["limits"], rel=1e-6), name
            if any(series["kind"] == "map" for series in old["series"]):
                continue  # its cells are drawn one by one
            for key in ("x", "y", "y_low", "y_high"):
                values = coordinates(old, key)
                assert coordinates(new, key) == pytest.approx(values, rel=1e-6, nan_ok=True), (name, key)


def coordinates(panel: dict[str, Any], key: str) -> list[float]:
    """All different values of a coordinate; error bars come back as a series of their own."""
    values = {v for series in panel["series"] for v in series.get(key) or () if v is not None}
    return sorted(values)


def test_width_and_letters(redrawn: dict[str, tuple[dict[str, Any], Figure]]) -> None:
    assert redrawn["backbone"][1].get_figwidth() * 25.4 == pytest.approx(85.0)
    assert redrawn["history"][1].get_figwidth() * 25.4 == pytest.approx(175.0)
    for name, (_, page) in redrawn.items():
        assert page.axes[0].xaxis.label.get_fontsize() == pytest.approx(7.0)
        box, (width, height) = page.get_tightbbox(), page.get_size_inches()
        assert min(box.x0, box.y0) > -0.02, name
        assert box.x1 < width + 0.02, name
        assert box.y1 < height + 0.04, name


def test_no_text_is_cut_off_or_touches_another_or_a_mark(redrawn: dict[str, tuple[dict[str, Any], Figure]]) -> None:
    for name, (_, page) in redrawn.items():
        page.draw_without_rendering()
        found = list(texts(page))
        assert len(found) > 5
        for text, box, _ in found:
            assert min(box.x0, box.y0) > -1.0, (name, text)
            assert box.x1 < page.bbox.width + 1.0, (name, text)
            assert box.y1 < page.bbox.height + 1.0, (name, text)
        for (text, box, _), (other, beside, _) in itertools.combinations(found, 2):
            assert not box.padded(-1.0).overlaps(beside), (name, text, other)
        for line in (line for axes in page.axes for line in axes.lines if line.get_marker() not in ("None", "")):
            marks = line.get_transform().transform(np.column_stack(line.get_data()))
            for text, box, inside in found:
                assert not inside or not np.any(np.all((marks >= box.min) & (marks <= box.max), axis=1)), (name, text)


def texts(page: Figure) -> Iterator[tuple[str, Bbox, bool]]:
    """Every text that is drawn with its box, pixels, and whether it stands among the data."""
    for axes in [*page.axes, *(child for parent in page.axes for child in parent.child_axes)]:
        outside = [axes.title, axes._left_title]
        for axis in (axis for axis in (axes.xaxis, axes.yaxis) if axis.get_visible()):
            low, high = sorted(axis.get_view_interval())
            ticks = [tick for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
            outside += [axis.label, axis.offsetText, *(label for t in ticks for label in (t.label1, t.label2))]
        legend = axes.get_legend()
        inside = [*axes.texts, *(legend.get_texts() if legend else ())]
        yield from ((t.get_text(), t.get_window_extent(), t in inside) for t in outside + inside if drawn(t))
    for text in (text for legend in page.legends for text in legend.get_texts()):
        yield text.get_text(), text.get_window_extent(), False


def drawn(text: Any) -> bool:
    return bool(text.get_visible() and text.get_text())


@pytest.mark.campaign
def test_files_of_every_format(report: Path, tmp_path: Path) -> None:
    written = write_figures(report, tmp_path, ["svg", "pdf", "png", "eps"], names=["damping"])
    assert [figure.name for figure in written] == ["damping"]
    starts = {path.suffix: path.read_bytes()[:8] for path in written[0].files}
    assert starts[".pdf"].startswith(b"%PDF")
    assert starts[".png"] == b"\x89PNG\r\n\x1a\n"
    assert starts[".eps"].startswith(b"%!PS")
    assert b"<?xml" in starts[".svg"]
    assert b">measured</text>" in (tmp_path / "damping.svg").read_bytes()  # text stays text
    again = write_figures(report, tmp_path, ["svg", "pdf"], names=["damping"])
    assert [path.suffix for path in again[0].files] == [".svg", ".pdf", ".csv"]


@pytest.mark.campaign
def test_figures_of_a_diagnosis(tmp_path: Path) -> None:
    (tmp_path / "report.html").write_text(diagnosis_page(fixture.report(Verdict.EFFECT)))
    names = [str(figure["name"]) for figure in report_figures(tmp_path)]
    assert len(names) > 3
    written = write_figures(tmp_path, tmp_path, ["pdf"], names=[next(n for n in names if n.startswith("map"))])
    table = (tmp_path / f"{written[0].name}.csv").read_text()
    assert any(row["value"] for row in rows(table))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("not base 64!", "damaged"),
        (base64.urlsafe_b64encode(b"not deflated").decode(), "damaged"),
        (base64.urlsafe_b64encode(zlib.compress(b"[1, 2")).decode(), "damaged"),
        (base64.urlsafe_b64encode(zlib.compress(json.dumps({"format": "other"}).encode())).decode(), "nmt figure 1"),
        (base64.urlsafe_b64encode(zlib.compress(b"0" * (65 << 20))).decode(), "nmt figure 1"),
    ],
)
def test_damaged_data(text: str, words: str) -> None:
    with pytest.raises(BenchError, match=words):
        unpacked(text)


def test_damaged_record() -> None:
    figure = Figure()
    figure.subplots().plot([1, 2], [3, 4])
    kept = unpacked(packed(record(figure, "f", "t")))
    kept["panels"][0]["x"]["label"] = r"$\nonsense{$"
    with pytest.raises(BenchError, match="damaged"):
        redraw(kept)
    del kept["panels"][0]["series"][0]["colour"]
    with pytest.raises(BenchError, match="damaged"):
        redraw(kept)


def test_plain_text() -> None:
    assert plain_text(r"modal frequency $\tilde\omega$ / (rad/s)") == "modal frequency ω̃ / (rad/s)"


def test_command(report: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["figures", str(report), "--format", "pdf", "--figure", "backbone"]) == 0
    assert sorted(path.name for path in (report / "figures").iterdir()) == ["backbone.csv", "backbone.pdf"]
    assert "1 figure" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--format", "bmp"], "not as 'bmp'"),
        (["--width", "wide"], "--width must be a length"),
        (["--width", "2mm"], "20 to 500 mm"),
        (["--letters", "99"], "4 to 24 points"),
        (["--figure", "none"], "has no figure 'none'"),
    ],
)
def test_refusals(
    report: Path, tmp_path: Path, words: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["figures", str(report), "--out", str(tmp_path / "out"), *words]) == 2
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_no_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["figures", str(tmp_path)]) == 2
    assert "no report.html" in capsys.readouterr().err
    (tmp_path / "report.html").write_text("<html></html>")
    assert cli.main(["figures", str(tmp_path)]) == 2
    assert "no figure data" in capsys.readouterr().err
