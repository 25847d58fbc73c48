"""The report of a diagnosis: every verdict, every kind of test, and numbers as they are drawn."""

from __future__ import annotations

import csv
import io
import math
import re
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser

import numpy as np
import pytest
from report import diagnosis_fixture as fixture

from nmt_diagnose.effects.library import library
from nmt_diagnose.ledger.diagnosis import Answer, Ranked, Remainder, RemainderPart, Share, Value, Verdict
from nmt_diagnose.measurements.measurement import joined
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.say.words import (
    answers_text,
    class_text,
    effect_text,
    key_text,
    parameters_text,
    place_text,
    probability_text,
    rest_text,
    sigma_text,
    value_text,
    verdict_text,
)
from nmt_report.diagnosis_curves import courses, harmonic_courses, observables_csv, on_one_scale
from nmt_report.diagnosis_report import diagnosis_page, probability_shares
from nmt_report.diagnosis_tables import ranking_table
from nmt_report.figure_record import unpacked
from nmt_report.rig_drawing import marked_places, rig_figure
from nmt_report.svg import RED
from nmt_rig.rig import load_rig

_VOID = {"meta", "link", "br", "img", "hr", "input"}


class _Balanced(HTMLParser):
    """Fails where tags do not close in order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.attributes += attrs
        if tag not in _VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> without a beginning"
        assert self.open.pop() == tag


def text_of(page: str) -> str:
    """What a reader sees, without figures."""
    page = re.sub(r"<(style|script|svg)\b.*?</\1>", "", page, flags=re.S)
    return unescape(re.sub(r"<[^>]+>", " ", page))


@pytest.mark.parametrize("verdict", list(Verdict))
def test_a_page_for_every_verdict(verdict: Verdict, request: pytest.FixtureRequest) -> None:
    # One with every kind of test and drawn, the others quicker.
    if verdict is not Verdict.EFFECT:
        request.getfixturevalue("undrawn")
    report = fixture.report(verdict, None if verdict is Verdict.EFFECT else fixture.one_test())
    page = diagnosis_page(report)
    parser = _Balanced()
    parser.feed(page)
    assert parser.open == []
    ids = [value for key, value in parser.attributes if key == "id"]
    assert len(ids) == len(set(ids))
    # Self-contained: nothing but anchors of the page itself is referred to.
    assert all(str(value).startswith("#") for key, value in parser.attributes if key in ("href", "src"))
    assert "http" not in re.sub(r"http-equiv|https?://www\.w3\.org/\S*", "", page)
    text = text_of(page)
    answers = text.index("Where of")
    assert answers < text.index("Which of") < text.index("How far of") < text.index("Residual map")
    assert "level 7 is left out" in text
    assert "ab" * 32 in text
    assert "something is left" in text
    steps = text[text.index("Residual, rms", text.index("How far of")) : text.index("Held out")]
    assert ("with the effect" in steps) == (verdict is Verdict.EFFECT)
    assert page.count('<figure id="map-') == len(report.observations.tests)


@pytest.mark.usefixtures("undrawn")
def test_a_class_is_named_with_its_splitting_test() -> None:
    report = fixture.report(Verdict.EFFECT, fixture.one_test())
    text = text_of(diagnosis_page(report))
    assert (
        verdict_text(report.diagnosis)[0]
        == "the model lacks cubic stiffness or quintic stiffness (the structure, point 5)"
    )
    assert "one class: these tests cannot distinguish them; the test that would is below" in text
    assert "./nmt run beam --levels 1.5:3:6 --out high" in text
    assert "k = (20.00 ± 0.31)·10⁶ N/m³" in text
    assert (
        "air drag at point 3: c2 = 0.40 ± 0.10 N s²/m²; force gain at channel f2: relative error g = 0.0100 ± 0.0020"
        in text
    )
    assert "local_elements.joint.slip_force_n" in text


@pytest.mark.usefixtures("undrawn")
def test_an_unexplained_gap_does_not_offer_its_parameters() -> None:
    text = text_of(diagnosis_page(fixture.report(Verdict.UNKNOWN, fixture.one_test())))
    assert "model.yaml keeps the ones given" in text


@pytest.mark.campaign
def test_hostile_names_stay_text() -> None:
    report = fixture.report(Verdict.EFFECT, fixture.one_test())
    bad = "<script>alert(1)</script>&\"'"
    diagnosis = replace(
        report.diagnosis,
        notes=(bad,),
        sentences=(bad, bad, bad),
        inputs={"bags": [{"path": bad, "sha256": bad}], "withheld": [bad], "tests": [{"name": bad, "kind": bad}]},
        next_test=tuple(replace(item, test=bad, command=bad) for item in report.diagnosis.next_test),
        ranking=tuple(replace(item, effect=bad, detail=bad) for item in report.diagnosis.ranking),
    )
    page = diagnosis_page(replace(report, diagnosis=diagnosis))
    assert "<script>alert" not in page
    parser = _Balanced()
    parser.feed(page)
    assert parser.open == []


@pytest.mark.campaign
def test_what_was_not_found_leaves_the_page_whole() -> None:
    report = fixture.report(Verdict.EFFECT)
    nan = np.full(len(report.observations.rows), math.nan)
    d = report.diagnosis
    empty = replace(
        d, residual_map=(), residual_tests=(), candidates=(), calibration=(), where=(), next_test=(), ranking=(),
        notes=(), inputs={}, gap=replace(d.gap, closed=math.nan, low=math.nan, high=math.nan, before=math.nan,
        after=math.nan, per_observable={}, held_out=()), probabilities={},
    )  # fmt: skip
    models = replace(report.models, as_given=nan, refitted=nan, final=nan)
    assert "Curves" in diagnosis_page(replace(report, diagnosis=empty, models=models))


# -- curves -----------------------------------------------------------------------------------------------------------


def test_levels_of_the_same_channels_are_in_one_figure_and_told_apart() -> None:
    two = (fixture.DISPLACEMENT, replace(fixture.DISPLACEMENT, name="x3", point=3))
    one_less = fixture.stepped_sine(0.5, -1, two)
    sweeps = [
        fixture.stepped_sine(0.5, 1, two),
        one_less.take(one_less.rows.channel == 0),
        fixture.stepped_sine(1.5, 1, two[::-1]),
        fixture.stepped_sine(1.5, 1, two),
        fixture.stepped_sine(1.5, 1, two, point=4),
    ]
    page = diagnosis_page(fixture.report(Verdict.EFFECT, joined(sweeps)))
    figures = [unpacked(text) for text in re.findall(r'<script type="application/[^"]*">(.*?)</script>', page)]
    responses = [figure for figure in figures if figure["name"].startswith("frf-")]
    assert [figure["name"] for figure in responses] == ["frf-0", "frf-4"]
    legend = [entry["text"] for entry in responses[0]["legends"][0]["entries"]]
    assert legend[-4:] == ["0.5 N ↑", "0.5 N ↓", "1.5 N ↑", "1.5 N ↑ (2)"]
    assert [len(panel["series"]) for panel in responses[0]["panels"]] == [12, 8 + 5, 9, 6 + 4]


def test_levels_in_one_panel_have_one_unit_and_one_turn() -> None:
    """900 and 1100 m would have the units m and 10³ m, and 179° and −179° be a turn apart."""
    sweep = fixture.stepped_sine(0.5, 1, (fixture.DISPLACEMENT,))
    (one,) = courses(sweep, fixture.models_of(sweep), 0, Part.LOG_MAGNITUDE)
    low = one.moved(0.9e3, 0.0, unit="m", exponent=0)
    high = one.moved(1.1, 0.0, unit="10³ m", exponent=3)
    drawn = on_one_scale([low, None, high])
    assert [course and course.unit for course in drawn] == ["10³ m", None, "10³ m"]
    for course, size in zip((drawn[0], drawn[2]), (0.9, 1.1), strict=True):
        assert course is not None
        for name in ("measured", "given", "refitted", "final"):
            np.testing.assert_allclose(getattr(course, name), size * getattr(one, name))
        np.testing.assert_array_equal(course.deviations, one.deviations)
    phases = [one.moved(0.0, degrees, unit="°", turn=360.0) for degrees in (179.0, -179.0, -541.0)]
    assert [course.measured[0] for course in on_one_scale(phases) if course] == [179.0, 181.0, 179.0]


def test_a_course_is_in_the_units_that_its_axes_say() -> None:
    observations = fixture.every_test()
    models = fixture.models_of(observations)
    (frequency,) = courses(observations, models, 0, Part.LOG_FREQUENCY)
    np.testing.assert_allclose(frequency.measured, fixture.HZ)
    np.testing.assert_allclose(frequency.x, fixture.DRIVES)
    # 1e-4 of a logarithm is 0.01 %.
    np.testing.assert_allclose(frequency.deviations[3], 0.01)
    np.testing.assert_allclose(np.abs(frequency.deviations[0]), 0.05)
    np.testing.assert_allclose(np.abs(frequency.deviations[2]), 0.005)
    force, displacement = courses(observations, models, 0, Part.LOG_MAGNITUDE)
    np.testing.assert_allclose(force.measured, 2.0 * np.array(fixture.DRIVES))
    assert (force.unit, displacement.unit) == ("N", "10⁻⁶ m")
    np.testing.assert_allclose(displacement.measured, 300.0 * np.array(fixture.DRIVES))
    (response,) = courses(observations, models, 1, Part.LOG_MAGNITUDE)
    assert response.unit == "N / V"
    np.testing.assert_allclose(response.x, observations.tests[1].lines_hz)
    (damping,) = courses(observations, models, 2, Part.DAMPING)
    np.testing.assert_allclose(damping.measured, 1.0)
    np.testing.assert_allclose(damping.deviations[3], 0.01)


def test_phases_are_compared_over_the_cut() -> None:
    observations = fixture.phase_resonance()
    mine = (observations.rows.part == Part.PHASE) & (observations.rows.channel == 1)
    models = fixture.models_of(observations)
    turned = models.as_given.copy()
    turned[mine] = observations.values[mine] + 0.01 - 2.0 * math.pi
    course = courses(observations, replace(models, as_given=turned), 0, Part.PHASE)[1]
    np.testing.assert_allclose(course.deviations[0], -math.degrees(0.01), rtol=1e-9)
    np.testing.assert_allclose(course.given - course.measured, math.degrees(0.01), rtol=1e-9)


def test_harmonics_are_magnitudes() -> None:
    observations = fixture.phase_resonance()
    force, displacement = harmonic_courses(observations, fixture.models_of(observations), 0)
    assert force.orders == (2, 3)
    # 3-4-5 triangles: 0.003 and 0.004 times the order.
    np.testing.assert_allclose(force.measured, np.outer([0.010, 0.015], np.ones(5)))
    np.testing.assert_allclose(displacement.sigma, 1e-4)


def test_the_table_has_every_observable_with_all_its_digits() -> None:
    observations = fixture.every_test()
    models = fixture.models_of(observations)
    rows = list(csv.DictReader(io.StringIO(observables_csv(observations, models))))
    assert len(rows) == len(observations.rows)
    assert [float(row["measured"]) for row in rows] == observations.values.tolist()
    assert [float(row["model_final"]) for row in rows] == models.final.tolist()
    assert {row["test"] for row in rows} == {"backbone", "random", "decay", "record"}
    assert all(row["part"] for row in rows)


# -- words ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "std", "unit", "text"),
    [
        (1.9788e7, 2.633e5, "N/m³", "(19.79 ± 0.26)·10⁶ N/m³"),
        (0.0123, 0.004, "kg", "12.3 ± 4.0 g"),
        (0.123, 0.004, "kg", "0.1230 ± 0.0040 kg"),
        (5.8e-6, 1e-7, "s", "5.80 ± 0.10 µs"),
        (-1.5e-4, math.nan, "m", "−0.15 mm"),
        (1.85e11, math.nan, "Pa", "185·10⁹ Pa"),
        (-3.0e-5, 2.0e-6, "1/s", "(−30.0 ± 2.0)·10⁻⁶ 1/s"),
        (0.0, 0.5, "1", "0.00 ± 0.50"),
        (0.0, 0.0, "", "0"),
        (math.nan, 1.0, "N", "—"),
    ],
)
def test_values_with_their_uncertainty(value: float, std: float, unit: str, text: str) -> None:
    assert value_text(value, std, unit) == text


@pytest.mark.parametrize(
    ("place", "detail", "text"),
    [
        ("structure", "5", "the structure, point 5"),
        ("structure", "3-5", "the structure, between points 3 and 5"),
        ("response_sensor", "x4", "a response sensor, channel x4"),
        ("response_sensor", "x2<4", "a response sensor, channel x2 picking up point 4"),
        ("joint + force_sensor", "6 + f2", "a joint or contact, point 6, and the force sensor, channel f2"),
        ("boundary", "rotation", "the clamping, rotation"),
        ("boundary", "clamp", "the clamping"),
        ("time", "cycles", "a change over time, over the number of periods"),
        ("controller", "", "the controller"),
    ],
)
def test_places_in_words(place: str, detail: str, text: str) -> None:
    assert place_text(place, detail) == text


def test_a_large_class_in_few_words() -> None:
    nothing = Share(math.nan, math.nan, math.nan)
    others = ("added_mass", "sensor_mass + air_drag", "air_drag + clock_error", "low_pass", "clipping")
    item = Ranked("sensor_mass", "response_sensor", "x5", 0.9, others, {}, nothing, 9.0)
    assert class_text(item) == "sensor mass or added mass or air drag + clock error or low pass or one of 1 more"


def test_other_words() -> None:
    assert effect_text("cubic_stiffness@4 + air_drag@7") == "cubic stiffness + air drag"
    assert effect_text("unknown") == "something not in the library"
    assert (probability_text(0.9999), probability_text(0.001), probability_text(0.42)) == ("> 99 %", "< 1 %", "42 %")
    assert (sigma_text(8.4), sigma_text(5732.0)) == ("8", "> 100")
    assert parameters_text({"k": Value(1.0, 0.1, "N/m"), "gap": Value(2.0, 0.1, "m")}) == (
        "k = 1.00 ± 0.10 N/m, clearance = 2.00 ± 0.10 m"
    )
    rig = load_rig("beam")
    assert key_text("local_elements.0.slip_force_n", rig) == "local_elements.joint.slip_force_n"
    assert key_text("structure.density_kg_m3", rig) == "structure.density_kg_m3"
    for effect in library():
        assert "_" not in effect_text(effect.name)


def test_without_a_claim_the_rest_is_too_weak_to_see_and_not_unnamed() -> None:
    quiet = fixture.report(Verdict.NONE).diagnosis
    quiet = replace(quiet, probabilities={"none": 0.6, "unknown": 0.3})
    assert rest_text(quiet) == ("an effect too weak to see", pytest.approx(0.3))
    loud = replace(quiet, verdict=Verdict.UNKNOWN)
    assert rest_text(loud) == ("something not in the library", pytest.approx(0.3))


def test_answers_stand_together_in_words() -> None:
    alike = Answer("effect", ("cubic_stiffness", "quintic_stiffness"), 0.6)
    words = answers_text((alike, Answer("unknown", (), 0.36)))
    assert words.endswith(": cubic stiffness or quintic stiffness; something not in the library.")
    assert answers_text((Answer("too_weak", (), 1.0),)).endswith(": an effect too weak to see.")
    assert answers_text(()) == ""


@pytest.mark.usefixtures("undrawn")
def test_a_remainder_and_warnings_stand_in_the_verdict_and_on_the_page() -> None:
    report = fixture.report(Verdict.EFFECT, fixture.one_test())
    assert "warning" not in verdict_text(report.diagnosis)[0]
    left = RemainderPart("backbone: frequency", "highest levels", 0.8, 3.1, 0.42, "%")
    other = RemainderPart("backbone: amplitude of x5", "", 0.1, 1.2, 0.3, "%")
    warning = "The fit moves structure.masses_kg.0 from 0.5 to 4.1 kg, 210 standard deviations of what is believed."
    changed = replace(report.diagnosis, remainder=Remainder(0.06, 0.03, 0.1, (left, other)), warnings=(warning,))
    text, kind = verdict_text(changed)
    assert text.endswith("which explains 94 % of the gap and leaves 6 %; mind the warning")
    assert kind == "partly"
    page = text_of(diagnosis_page(replace(report, diagnosis=changed)))
    assert warning in page
    assert re.search(r"frequency\s+highest levels\s+80\s%\s+3\.10?\s+0\.420?\s%", page), page[page.find("Residual") :][
        :400
    ]
    assert re.search(r"6 % \(3 to 10 %\) of the gap is left", page)
    assert changed.to_mapping()["remainder"]["where"][0]["levels"] == "highest levels"
    assert verdict_text(replace(changed, warnings=(warning, warning)))[0].endswith("mind the 2 warnings")


@pytest.mark.parametrize("verdict", list(Verdict))
def test_the_probability_bar_is_whole(verdict: Verdict) -> None:
    shares = probability_shares(fixture.report(verdict).diagnosis)
    assert sum(share for _, _, share, _ in shares) == pytest.approx(1.0, abs=5e-3)
    assert len({colour for *_, colour in shares}) == len(shares)


def test_causes_that_two_places_share_stand_as_one() -> None:
    """Whichever of the two a place names first."""
    found = fixture.report(Verdict.EFFECT).diagnosis
    first = replace(found.ranking[0], effect="low_pass", equivalents=("channel_skew",), probability=0.5)
    other = replace(first, effect="channel_skew", equivalents=("low_pass",), probability=0.4)
    shares = probability_shares(replace(found, ranking=(first, other), probabilities={}))
    assert shares[0][0] == "low pass or channel skew"
    assert shares[0][2] == pytest.approx(0.9)
    assert effect_text("second_friction_contact@1 + mains_hum") == "friction contact + mains hum"


@pytest.mark.parametrize(
    ("place", "detail", "points"),
    [
        ("structure", "5", [5]),
        ("response_sensor", "x4", [4]),
        ("response_sensor", "x4<6", [4]),
        ("structure + force_sensor", "3 + f2", [3, 2]),
        ("structure", "2-6", [2, 6]),
        ("exciter", "", [2]),
        ("controller", "", [2]),
        ("joint", "joint", [3]),
        ("boundary", "clamp", [None]),
        ("time", "time", []),
    ],
)
def test_the_drawing_marks_the_place(place: str, detail: str, points: list[int | None]) -> None:
    rig = load_rig("beam")
    marks = marked_places(rig, place, detail)
    assert [point for point, _ in marks] == points
    for words, count in (("", 0), ("somewhere", len(points))):
        numbers = re.search(r"<script[^>]*>(.*?)</script>", rig_figure(rig, place, detail, words).svg)
        assert numbers is not None
        series = unpacked(numbers[1])["panels"][0]["series"]
        assert sum(len(item["x"]) for item in series if item["colour"] == f"{RED}ff") == count


def test_the_drawing_has_every_exciter() -> None:
    rig = load_rig("frame")
    first, second = rig.exciter_points
    assert [point for point, _ in marked_places(rig, "exciter", "")] == [first, second]
    assert [point for point, _ in marked_places(rig, "exciter", str(second))] == [second]
    numbers = re.search(r"<script[^>]*>(.*?)</script>", rig_figure(rig).svg)
    assert numbers is not None
    series = unpacked(numbers[1])["panels"][0]["series"]
    assert len({item["x"][0] for item in series if list(item["y"]) == [-1.5]}) == 2


def test_the_probabilities_of_the_console_table_add_up() -> None:
    diagnosis = fixture.report(Verdict.EFFECT).diagnosis
    rest = {"other": 0.2, **{name: 0.8 * p for name, p in diagnosis.probabilities.items() if name != "other"}}
    ranking = tuple(replace(item, probability=0.8 * item.probability) for item in diagnosis.ranking)
    table = ranking_table(replace(diagnosis, probabilities=rest, ranking=ranking))
    assert table is not None
    shown = [str(cell).strip(" %<>") for cell in table.columns[1].cells]
    names = [str(cell) for cell in table.columns[2].cells]
    assert names[-1] == "all other explanations"
    assert sum(map(float, shown)) == pytest.approx(100.0, abs=2.0)


@pytest.mark.usefixtures("undrawn")
def test_no_further_test_is_needed_only_where_one_effect_at_one_place_remains() -> None:
    report = fixture.report(Verdict.EFFECT, fixture.one_test())
    cubic = replace(report.diagnosis.ranking[0], equivalents=(), probability=0.97)
    alone = replace(
        report.diagnosis, next_test=(), ranking=(cubic,), answers=(Answer("effect", ("cubic_stiffness",), 0.97),)
    )
    needless, better = "no further test is needed", "separate the remaining explanations better"
    for diagnosis, said_of_tests in (
        (alone, needless),
        (replace(alone, adequate=False), better),
        (replace(alone, ranking=(replace(cubic, probability=0.6),)), better),
        (replace(alone, ranking=(replace(cubic, places={"5": 0.5, "6": 0.4}),)), better),
        (replace(alone, answers=(*alone.answers, Answer("unknown", (), 0.02))), needless),
        (replace(alone, answers=(Answer("effect", ("cubic_stiffness", "air_drag"), 0.97),)), better),
    ):
        assert said_of_tests in text_of(diagnosis_page(replace(report, diagnosis=diagnosis)))
