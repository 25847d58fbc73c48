"""The picture and the table of a missing force: what stands in the reading stands in them."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from report import diagnosis_fixture as fixture
from report.test_diagnosis_report import text_of

from nmt_diagnose.law.force_loop import ForceLoop
from nmt_diagnose.law.law_words import formula
from nmt_diagnose.law.reading import LawReading, LawTerm, LocalLaw
from nmt_diagnose.law.record_check import RecordCheck
from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_report.diagnosis_report import diagnosis_page
from nmt_report.figure_record import unpacked

ANGLES = 2.0 * np.pi * np.arange(64) / 64
STD = 0.02


def reading(*refusals: str) -> LawReading:
    """A damped cubic spring at two levels, the points 0.01 N above the law."""
    loops = []
    for level, reach in ((0, 0.5e-3), (7, 1.0e-3)):
        x, v = reach * np.cos(ANGLES), -0.2 * reach / 1e-3 * np.sin(ANGLES)
        law = 2e9 * x**3 + 3.0 * v
        loops.append(ForceLoop(level, tuple(x), tuple(v), tuple(law + 0.01), STD, tuple(law)))
    term = LawTerm("power", (3.0,), 2e9, 1e7, "N/m^3")
    law = LocalLaw(5, 0, "hardening spring", (term,), 1e-3, (), tuple(loops))
    return LawReading("backbone", 8, (law,), 20.0, 2.0, 0.95, 0.9, refusals)


def page(found: LawReading | None) -> str:
    report = fixture.report(Verdict.UNKNOWN, fixture.one_test())
    leads = found is not None and found.is_written
    return diagnosis_page(replace(report, diagnosis=replace(report.diagnosis, law=found, law_leads=leads)))


@pytest.fixture(scope="module")
def stated() -> str:
    """The page of the reading, drawn once."""
    return page(reading())


def test_the_figure_has_the_loops_and_their_bands(stated: str) -> None:
    found, made = reading(), stated
    (numbers,) = re.findall(r'<figure id="law-0".*?<script type="application/x-nmt-figure">(.*?)</script>', made, re.S)
    panels = unpacked(numbers)["panels"]
    top = found.laws[0].loops[-1]
    lines = [series for series in panels[0]["series"] if series["kind"] == "line" and len(series["x"]) > 2]
    law = next(series for series in lines if len(series["x"]) == 65 and max(series["x"]) > 0.9)
    assert np.allclose(law["x"][:64], 1e3 * np.array(top.displacement), atol=1e-6)
    assert np.allclose(law["y"][:64], top.law, atol=1e-6)
    points = next(series for series in lines if len(series["x"]) == 32 and max(series["x"]) > 0.9)
    assert np.allclose(points["y"], top.measured[::2], atol=1e-6)
    bands = [series for series in panels[0]["series"] if series["kind"] == "area"]
    widths = np.concatenate([np.subtract(band["y_high"], band["y_low"]) for band in bands])
    assert np.allclose(widths, 4.0 * STD, atol=1e-6)
    sizes = [max(np.abs(series["y"])) for series in panels[2]["series"] if len(series.get("x", ())) == 65]
    assert sizes == pytest.approx([1.0, 1.0], rel=1e-3)


def test_the_table_has_term_and_reach(stated: str) -> None:
    text = re.sub(r"\s+", " ", text_of(stated))
    assert "point 5 hardening spring x³ (2.000 ± 0.010)·10⁹ N/m³" in text
    assert "Valid up to 1 mm" in text
    assert "20 → 2 standard deviations (10 % stay)" in text


HEADING = "A force like hardening spring (point 5), which no effect of the library explains"


def test_the_page_is_headed_by_the_law_and_says_a_warning_once(stated: str) -> None:
    text = re.sub(r"\s+", " ", text_of(stated))
    assert HEADING in text
    report = fixture.report(Verdict.UNKNOWN, fixture.one_test())
    warning = "The fit moves structure.density_kg_m3: check it."
    warned = replace(
        report.diagnosis, sentences=(*report.diagnosis.sentences, warning), warnings=(warning,), next_test=()
    )  # fmt: skip
    answered = re.sub(r"\s+", " ", text_of(diagnosis_page(replace(report, diagnosis=warned))))
    assert answered.count(warning) == 1
    assert "What next" not in answered


@pytest.mark.parametrize("found", [pytest.param(None, marks=pytest.mark.campaign), reading("it needs a gain of 5 σ")])
def test_a_law_that_is_not_stated_is_not_drawn(found: LawReading | None) -> None:
    made = page(found)
    assert 'id="law-0"' not in made
    assert HEADING not in re.sub(r"\s+", " ", text_of(made))


def as_read(kind: str, parameters: tuple[float, ...]) -> str:
    return formula(LawTerm(kind, parameters, 1.0, 0.0, "").of_unit_strength)


def test_formulas_name_side_and_size() -> None:
    assert as_read("stop", (2e-4, -1.0)) == "spring where x < −0.2 mm"
    assert as_read("stop", (1.0,)) == "spring where x > 0 mm"
    assert as_read("slider", (5e-5,)) == "spring that slips at 0.05 mm"
    assert as_read("speed", (1.5,)) == "|v|¹·⁵ sgn v"
    assert as_read("weakening friction", (1e-3, 0.05)) == "tanh(v / 0.001 m/s) exp(−(v / 0.05 m/s)²)"


def test_a_part_that_was_left_out_is_drawn_with_its_law_and_the_remainders() -> None:
    check = RecordCheck(
        "record", (1.0, 1.1, 1.3), (0.4, -0.2, 0.3), 0.02, (1.0, 1.1, 1.2, 1.3), (0.39, -0.21, 0.0, 0.31),
        (0.0, 0.1, 0.2), (1.0, 0.8, -0.6), (1.0, 0.01, -0.02), 0.04,
    )  # fmt: skip
    made = page(replace(reading(), of_record=True, check=check))
    (numbers,) = re.findall(
        r'<figure id="law-check".*?<script type="application/x-nmt-figure">(.*?)</script>', made, re.S
    )
    time, lags = unpacked(numbers)["panels"]
    drawn = {series["label"]: series for series in time["series"]}
    assert drawn["law of the other parts"]["y"] == pytest.approx(check.line)
    assert drawn["measured, ±2 standard deviations"]["y"] == pytest.approx(check.measured)
    drawn = {series["label"]: series for series in lags["series"]}
    assert drawn["without the law"]["y"] == pytest.approx(check.without)
    assert drawn["with it"]["y"] == pytest.approx(check.with_law)
