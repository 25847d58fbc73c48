"""The report: complete, self-contained, honest about what is missing."""

from __future__ import annotations

import itertools
import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from bench.synthetic_bag import FREQUENCY_HZ, SAMPLE_RATE, write_bag
from report.synthetic_run import damping_of, omega_of, synthetic_run

from nmt_core.errors import BenchError
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.vocabulary import PointStatus
from nmt_extract.judgement.uncertainty_budget import Budget, PointBudget, UncertaintySource
from nmt_extract.offline import extract_bag
from nmt_report import run_report
from nmt_report.backbone_figures import participation_figure
from nmt_report.history_figures import MOST_PANELS, chosen_excerpts, thinned
from nmt_report.quantity_format import plain
from nmt_report.run_data import ReferenceCurve
from nmt_report.run_data_from_bag import plant_facts
from nmt_report.run_page import page as words_of_page
from nmt_report.run_page import worst_deviation
from nmt_report.run_report import list_files, read_reference, report_data_from_bag, report_html, write_report
from nmt_report.run_verdict import run_verdict
from nmt_report.stated_uncertainty import with_budgets
from nmt_session import Session, plan_test

FIGURES = (
    "backbone",
    "damping",
    "indicators",
    "participation",
    "shapes",
    "amplitudes",
    "harmonics",
    "history",
    "envelope",
    "signals",
)


CONVERTER = {
    "lateness_histogram": "< 0.5 ms: 30; < 1 ms: 10",
    "jitter_p50_ms": "0.4",
    "jitter_p99_ms": "0.9",
    "jitter_max_ms": "0.97",
    "overruns": "3",
    "converter_delay": "38",
    "converter_drift": "0.01",
    "converter_round_trip": "518",
    "converter_stated": "-1",
    "converter_clock_ppm": "nan",
    "converter_lost_turns": "7",
    "converter_priority": "real time (FIFO 10)",
    "plant_priority": "ordinary (nice 0)",
    "computer": "2 cores, frequency governor performance, load 0.5",
}


class Page(HTMLParser):
    """Collects what a browser would fetch, the ids, and checks that elements are closed."""

    VOID = frozenset({"meta", "path", "use", "rect", "br"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.links: list[str] = []
        self.open: list[str] = []
        self.text: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._attributes(attrs)
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._attributes(attrs)

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.VOID:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)

    def _attributes(self, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name == "id" and value:
                self.ids.append(value)
            if name in ("href", "src", "xlink:href", "data") and value:
                self.links.append(value)


@pytest.fixture(scope="module")
def html() -> str:
    return report_html(synthetic_run())


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp("run") / "bag", lost_level=1)


def test_all_sections_and_figures_are_there(html: str) -> None:
    page = Page(html)
    assert page.open == []
    for name in (*FIGURES, "properties", "run", "assumptions", "files"):
        assert page.ids.count(name) == 1, name


def test_nothing_is_fetched(html: str) -> None:
    page = Page(html)
    assert all(link.startswith("#") for link in page.links)
    assert {link[1:] for link in page.links} <= set(page.ids)
    assert not re.search(r"https?:|//[a-z]|@import|@font-face|<link|<img|<script[^>]+src", html)
    assert "default-src 'none'" in html
    assert len(html.encode()) < 5_000_000


def test_the_verdict_and_the_backbone_stand_first_and_raw_files_are_not_printed(html: str) -> None:
    places = [
        html.index(mark) for mark in ('class="verdict', 'id="backbone"', "<nav", 'id="properties"', "Versions", "<pre>")
    ]
    assert places == sorted(places)
    assert html.count('<details class="raw">') == html.count("<pre>") > 0
    assert re.search(r"@media print.*details\.raw \{ display: none", html, re.S)


def test_columns_of_a_figure_are_views_of_its_own_drawing(html: str) -> None:
    panels = re.findall(r'<div class="panels">(.*?)</div>', html)
    assert [part.count("<svg") for part in panels] == [2, 2, 4]  # indicators, harmonics, signals
    parts = re.findall(r'<use href="#(signals-part-\d+)"/>', html)
    assert len(parts) == len(set(parts)) >= 8  # each pair of axes in its own column only
    assert all(html.count(f'<g id="{part}">') == 1 for part in parts)
    views = [[float(v) for v in box.split()] for box in re.findall(r'viewBox="([^"]*)"', panels[2])]
    assert all(right[0] > left[0] for left, right in itertools.pairwise(views))
    assert all(150.0 < width < 320.0 and height > 200.0 for _, _, width, height in views)


def test_ids_are_unique(html: str) -> None:
    ids = Page(html).ids
    assert len(ids) == len(set(ids))


def test_facts_assumptions_files_and_failures_are_named(html: str) -> None:
    data = synthetic_run()
    text = "".join(Page(html).text)
    assert "9 of 10 levels locked and extracted; 1 not locked" in text
    assert "phase error stayed at 17°" in text
    for assumption in data.rig["assumptions"]:
        assert assumption in text
    for entry in data.files:
        assert entry.sha256 in text
    for fact in ("2026-11-20T12-00-00_beam", "at point 2", "200 periods", "0.1.0"):
        assert fact in text


def test_values_stand_in_the_table_with_their_uncertainty() -> None:
    data = synthetic_run(levels=1, failed=None, reference=False)
    point = replace(data.points[0], damping_ratio=0.012345, damping_ratio_std=0.000067)
    text = words_of_page(replace(data, points=[point]), {})
    assert "<td>1.2345 <i>± 0.0067</i></td>" in text


def test_text_from_outside_is_escaped() -> None:
    data = synthetic_run(levels=2, failed=1)
    data.rig = {"name": "<script>alert(1)</script>", "assumptions": ["a < b & c"]}
    data.points = [data.points[0], replace(data.points[1], reason="<b>bold</b>")]
    data.loss = "<i>lost</i>"
    text = words_of_page(data, {})
    assert "<script>alert" not in text
    assert "<b>bold" not in text
    assert "<i>lost" not in text
    assert "a &lt; b &amp; c" in text


def test_hover_texts_are_attached(html: str) -> None:
    # One per point in each of: backbone, damping, 4 indicators, amplitude, force.
    assert html.count("<title>level ") == 8 * 9


@pytest.mark.parametrize(("levels", "failed"), [(1, None), (1, 0), pytest.param(30, 3, marks=pytest.mark.campaign)])
def test_few_and_many_levels(levels: int, failed: int | None) -> None:
    page = Page(report_html(synthetic_run(levels=levels, failed=failed)))
    assert page.open == []
    assert ("backbone" in page.ids) == (not (levels == 1 and failed == 0))


@pytest.mark.campaign
def test_sparse_data() -> None:
    data = synthetic_run(levels=3, failed=None, reference=False)
    bare = replace(
        data, run={}, rig={}, stop={}, linear=None, history=None, envelopes=(), excerpts=(), levels=(), locks=()
    )
    page = Page(report_html(bare))
    assert "backbone" in page.ids
    assert "history" not in page.ids
    empty = replace(bare, points=[], sample_rate=math.nan)
    assert "no modal point" in report_html(empty)


def test_the_verdict_counts_what_became_of_every_level() -> None:
    points = synthetic_run(levels=10, failed=None).points
    assert run_verdict(points, 10) == ("10 of 10 levels locked and extracted", "good")
    assert run_verdict(points[:4], 10) == ("4 of 10 levels locked and extracted; 6 not reached", "partly")
    lost = [replace(point, status=PointStatus.NOT_LOCKED) for point in points[:2]]
    spoiled = [replace(point, status=PointStatus.REJECTED) for point in points[2:3]]
    assert run_verdict([*lost, *spoiled, *points[3:6]]) == (
        "3 of 6 levels locked and extracted; 2 not locked; 1 rejected",
        "partly",
    )
    assert run_verdict(lost) == ("0 of 2 levels locked and extracted; 2 not locked", "bad")
    assert run_verdict([]).tone == "bad"


def test_levels_that_are_another_mode_are_named_at_the_head_and_in_the_verdict() -> None:
    data = synthetic_run(levels=3, failed=None)
    assert data.linear is not None
    other = (data.linear.target_mode + 1) % data.linear.shape_matrix.shape[1]
    shape = data.linear.shape_matrix[:, other] + 0j
    points = [*data.points[:2], replace(data.points[2], normalised_shape=shape)]
    assert run_verdict(points, 3, data.linear) == ("3 of 3 levels locked and extracted; 1 another mode", "partly")
    text = words_of_page(replace(data, points=points), {})
    assert '<p class="verdict partly">' in text
    assert re.search(r'<p class="notice partly">1 of 3 levels with values are', text)


def test_a_recording_without_modal_points_is_refused_before_its_samples_are_read(tmp_path: Path) -> None:
    plan = plan_test("beam", [0.05], test="random", band_hz=(5.0, 50.0), duration=1.0)
    with Session(plan, tmp_path / "run") as session:
        session.run()
    with pytest.raises(BenchError, match=r"A random test gives no modal points.*nmt linear"):
        report_data_from_bag(tmp_path / "run/bag")


def test_the_whole_budget_is_what_stands_behind_plus_minus() -> None:
    data = synthetic_run(levels=2, failed=None, reference=False)
    first, second = data.points
    budget = Budget(
        "damping_ratio", first.damping_ratio, {UncertaintySource.NOISE: 3e-5, UncertaintySource.GAINS: 4e-5}
    )
    data.budgets = [PointBudget(first.level_index, first.level, "V", {"damping_ratio": budget})]
    assert [point.damping_ratio_std for point in with_budgets(data.points, data.budgets)] == [
        pytest.approx(5e-5),
        second.damping_ratio_std,
    ]
    html = report_html(data)
    shown = plain(100 * first.damping_ratio, 4)
    assert f"<td>{shown} <i>± 0.0050</i></td>" in html
    assert "Bars: combined standard uncertainty." in html
    assert "Bars: repeatability." in html


@pytest.mark.parametrize(("factor", "own"), [(1.0, True), (1.5, False), (0.0, False)])
def test_an_error_of_the_method_from_the_deviations_of_the_run_does_not_judge_them(factor: float, own: bool) -> None:
    """From another run, or absent, it says nothing of the kind."""
    data = synthetic_run(levels=3, failed=None)
    assert data.reference is not None
    data.budgets = []
    for point in data.points:
        away = abs(point.omega_rad_s - data.reference.at(point.modal_amplitude)[0])
        budget = Budget("omega_rad_s", point.omega_rad_s, {UncertaintySource.METHOD: factor * away})
        data.budgets.append(PointBudget(point.level_index, point.level, "V", {"omega_rad_s": budget}))
    assert ("it does not judge them" in report_html(data)) is own
    assert "Level: amplitude (peak value) of the drive voltage." in report_html(data)


def test_the_shift_counts_from_the_smallest_amplitude_and_has_a_sign() -> None:
    data = synthetic_run(levels=3, failed=None)
    for factor, words in ((1.02, "+2 %"), (0.98, "−2 %")):
        points = [replace(point, frequency_hz=20.0) for point in data.points]
        points[-1] = replace(points[-1], frequency_hz=20.0 * factor)
        assert f"{words} from the smallest to the largest amplitude" in words_of_page(replace(data, points=points), {})


def test_the_participation_of_one_mode_is_not_magnified() -> None:
    data = synthetic_run(levels=3, failed=None)
    data.points = [
        replace(point, participation=np.array([1.0 + 1e-15 * index]) + 0j) for index, point in enumerate(data.points)
    ]
    figure = participation_figure(data)
    assert figure is not None
    assert "e-15" not in figure.svg
    assert "1e−15" not in figure.svg


def test_agreement_of_up_and_down_is_a_tile_and_no_fault() -> None:
    data = synthetic_run(levels=3, failed=None)
    down = [replace(point, level_index=3 + n) for n, point in enumerate(reversed(data.points[:2]))]
    data.points = [*data.points, *down]
    text = words_of_page(data, {})
    assert "2 of 2 levels agree" in text
    assert "Up and down agree" not in text
    moved = [replace(point, frequency_hz=1.01 * point.frequency_hz) for point in down]
    text = words_of_page(replace(data, points=[*data.points[:3], *moved]), {})
    assert '<p class="notice partly">Up and down agree' in text


def test_deviation_from_the_reference() -> None:
    data = synthetic_run(levels=5, failed=None)
    assert data.reference is not None
    q = float(data.reference.modal_amplitude[60])
    exact = replace(
        data.points[0], modal_amplitude=q, omega_rad_s=1.01 * omega_of(q), damping_ratio=0.97 * damping_of(q)
    )
    omega, damping = worst_deviation(replace(data, points=[exact]))
    assert omega == pytest.approx(0.01, abs=1e-9)
    assert damping == pytest.approx(-0.03, abs=1e-9)
    outside = replace(exact, modal_amplitude=1.0)
    assert all(math.isnan(value) for value in worst_deviation(replace(data, points=[outside])))


def test_reference_interpolates_over_the_logarithm() -> None:
    curve = ReferenceCurve("r", np.array([1e-5, 1e-3]), np.array([100.0, 80.0]), np.array([0.01, 0.03]))
    assert curve.at(1e-4) == pytest.approx((90.0, 0.02))
    assert math.isnan(curve.at(2e-3)[0])


@pytest.mark.parametrize(
    "text",
    [
        "modal_amplitude,omega_rad_s,damping_ratio\n1e-5,139,0.005\n1e-4,138,0.006\n",
        "damping_ratio,modal_amplitude,omega_rad_s\n0.005,1e-5,139\n0.006,1e-4,138\n",
        "# made by someone\n# q,w,d\n1e-4,138,0.006\n1e-5,139,0.005\n",
    ],
)
def test_read_reference(tmp_path: Path, text: str) -> None:
    (tmp_path / "r.csv").write_text(text)
    curve = read_reference(tmp_path / "r.csv")
    assert curve.modal_amplitude.tolist() == [1e-5, 1e-4]
    assert curve.omega_rad_s.tolist() == [139, 138]
    assert curve.damping_ratio.tolist() == [0.005, 0.006]


@pytest.mark.parametrize("text", ["", "a,b\n1,2\n", "1,2,3\n1,2\n", "1,2,3\n-1,2,3\n", "1,2,nan\n2,2,3\n"])
def test_read_reference_refuses(tmp_path: Path, text: str) -> None:
    (tmp_path / "r.csv").write_text(text)
    with pytest.raises(BenchError, match=r"r\.csv"):
        read_reference(tmp_path / "r.csv")


def test_data_from_a_bag(bag: Path) -> None:
    result = extract_bag(bag)
    data = report_data_from_bag(bag, result.points)
    assert [point.status for point in data.points] == [PointStatus.OK, PointStatus.NOT_LOCKED, PointStatus.OK]
    assert data.sample_rate == SAMPLE_RATE
    assert data.end_sample == 3 * 4 * SAMPLE_RATE
    assert data.rig["name"] == "beam"
    assert [lock.level_index for lock in data.locks] == [0, 2]
    assert [step.amplitude for step in data.levels] == [0.1, 0.3, 1.0]
    assert data.history is not None
    assert data.history.sample.size == 600
    assert data.loss is None
    envelopes = {envelope.channel: envelope for envelope in data.envelopes}
    assert set(envelopes) == {"u", "f2", "x2"}
    # The force is a sine of the level's amplitude (V = N here), so its envelope is known.
    force = envelopes["f2"]
    assert force.high.max() == pytest.approx(1.0, rel=1e-3)
    assert force.low.min() == pytest.approx(-1.0, rel=1e-3)
    # Each stretch covers a whole period: the envelope of a steady sine is flat.
    steady = force.sample < 3.9 * SAMPLE_RATE
    np.testing.assert_allclose(force.high[steady], 0.1, rtol=1e-3)
    np.testing.assert_allclose(force.low[steady], -0.1, rtol=1e-3)


def test_excerpts_are_the_first_periods_of_the_window(bag: Path) -> None:
    data = report_data_from_bag(bag, extract_bag(bag).points)
    assert [excerpt.level_index for excerpt in data.excerpts] == [0, 2]
    for excerpt, lock in zip(data.excerpts, data.locks, strict=True):
        assert excerpt.force.size == pytest.approx(3 * SAMPLE_RATE / FREQUENCY_HZ, abs=1)
        time = (lock.window_first_sample + np.arange(excerpt.force.size)) / SAMPLE_RATE
        expected = excerpt.level * np.cos(2 * np.pi * FREQUENCY_HZ * time)
        np.testing.assert_allclose(excerpt.force, expected, atol=1e-9)


def test_cut_off_bag_says_so(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", stop=False)
    data = report_data_from_bag(path, extract_bag(path).points)
    assert data.loss is not None
    assert data.loss in "".join(Page(words_of_page(data, {})).text)


def test_write_report_and_files(bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_report, "report_html", lambda data: words_of_page(data, {}))
    (tmp_path / "modal.csv").write_bytes(b"abc")
    data = report_data_from_bag(bag, extract_bag(bag).points)
    data.files = list_files(tmp_path)
    path = write_report(data, tmp_path / "report.html")
    assert [entry.name for entry in data.files] == ["modal.csv"]
    # SHA-256 of "abc" as in FIPS 180-2, appendix B.1.
    assert data.files[0].sha256 == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert path.read_text(encoding="utf-8").endswith("</html>\n")
    assert sorted(item.name for item in tmp_path.iterdir()) == ["modal.csv", "report.html"]
    assert [entry.name for entry in list_files(tmp_path)] == ["modal.csv"]


def test_thinning_keeps_every_peak() -> None:
    x = np.arange(100_000.0)
    y = np.sin(x / 50.0)
    y[77_777] = 9.0
    y[100:200] = np.nan
    thin_x, thin_y = thinned(x, y, 500)
    assert len(thin_x) <= 1000
    assert np.all(np.diff(thin_x) > 0)
    assert 9.0 in thin_y
    assert np.nanmin(thin_y) == np.nanmin(y)
    assert thinned(x[:10], y[:10])[0] is not None


def test_many_excerpts_are_spread() -> None:
    data = synthetic_run(levels=40, failed=None)
    chosen = chosen_excerpts(data.excerpts)
    assert len(chosen) == MOST_PANELS
    assert (chosen[0].level_index, chosen[-1].level_index) == (0, 39)
    assert all(isinstance(point, ModalPoint) for point in data.points)


@pytest.mark.parametrize(
    ("names", "found"),
    [(["plant", "pll", "plant"], "2"), (["left/pll", "left/plant"], "1"), (["left/plant", "right/plant"], None)],
)
def test_the_counters_are_those_of_the_only_plant_that_was_heard(names: list[str], found: str | None) -> None:
    heard = [
        SimpleNamespace(name=name, values=[SimpleNamespace(key="overruns", value=str(number))])
        for number, name in enumerate(names)
    ]
    bag = SimpleNamespace(messages=lambda _: [("", 0, SimpleNamespace(status=[status])) for status in heard])
    assert plant_facts(bag).get("overruns") == found  # type: ignore[arg-type]


def test_a_test_on_a_converter_says_how_its_blocks_came(html: str) -> None:
    assert "Late by" not in html, "in lockstep nothing is late"
    run = synthetic_run(levels=1, failed=None, reference=False)
    text = " ".join(Page(words_of_page(replace(run, plant=CONVERTER), {})).text)
    for words in (
        "< 0.5 ms",
        "75",  # % of the blocks
        "38 samples, moved by 0.01",
        "not known",
        "real time (FIFO 10)",
        "ordinary (nice 0)",
        "2 cores, frequency governor performance",
    ):
        assert words in text
    assert "the driver says" not in text
