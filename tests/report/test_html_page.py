"""Templates: text is escaped, markup is kept, what a page needs must be given."""

from __future__ import annotations

import re
from dataclasses import replace
from html import unescape

import pytest
from jinja2 import UndefinedError
from markupsafe import Markup
from report import diagnosis_fixture as fixture
from report.synthetic_run import synthetic_run

from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_report.diagnosis_report import diagnosis_page
from nmt_report.html_page import PageColumn, Row, Table, part, render, subtitle
from nmt_report.response_page import ResponsePage, html_table
from nmt_report.run_report import report_html
from nmt_report.svg import ReportFigure

BAD = '<script>alert("1")</script>'


def without_figures(page: str) -> str:
    return re.sub(r"<(style|svg)\b.*?</\1>", "", page, flags=re.S)


def test_cells_are_escaped_unless_they_are_markup() -> None:
    table = Table(
        (PageColumn("a<b", kind="text"), PageColumn(Markup("<i>q</i>"), "<m>"), PageColumn("c")),
        [Row(("x & y", Markup("<b>1</b>"), 2)), Row(("z",), failed=True, reason="not <locked>")],
        "no<te",
        "head>ing",
    )
    assert part("table", table) == (
        '<h3 class="after">head&gt;ing</h3>'
        '<div class="scroll"><table><thead><tr><th class="text">a&lt;b</th>'
        '<th><i>q</i><span class="unit">&lt;m&gt;</span></th><th>c</th></tr></thead><tbody>'
        '<tr><td class="text">x &amp; y</td><td><b>1</b></td><td>2</td></tr>'
        '<tr class="failed"><td class="text">z</td><td class="reason" colspan="2">not &lt;locked&gt;</td></tr>'
        '</tbody></table></div><p class="note">no&lt;te</p>'
    )


def test_a_page_without_what_it_needs_is_refused() -> None:
    with pytest.raises(UndefinedError, match="sections"):
        render("base.html", title="t")


@pytest.mark.parametrize(
    ("run", "below_name"),
    [
        ({"device": "simulated rig"}, "Simulated rig: a beam"),
        ({"device": "nidaqmx"}, "a beam"),
        ({"imported": {"file": "x.csv"}}, "a beam"),
        ({}, "a beam"),
    ],
)
def test_a_rig_is_simulated_only_where_its_recording_says_so(run: dict[str, object], below_name: str) -> None:
    assert subtitle(run, "a beam") == below_name
    assert subtitle(run, "") == ("Simulated rig" if "Simulated" in below_name else "")


def test_every_text_of_a_response_page_is_escaped() -> None:
    figure = ReportFigure("f", BAD, BAD, Markup("<svg></svg>"))
    page = ResponsePage(
        BAD, BAD, BAD, (BAD, "good"), [("s", BAD, html_table([(BAD, BAD)], [[BAD]], BAD) + part("figures", [figure]))],
        [(BAD, BAD, BAD)], [(BAD, BAD)], [BAD], BAD, [(BAD, BAD)], [BAD],
    ).html()  # fmt: skip
    assert "<script>alert" not in page
    assert page.count("&lt;script&gt;alert(&#34;1&#34;)&lt;/script&gt;") == 24
    assert "<svg></svg>" in page


def test_a_run_with_a_script_for_a_name_and_a_channel() -> None:
    data = synthetic_run(levels=2, failed=1)
    data.rig = {"name": BAD, "description": BAD, "assumptions": [BAD]}
    data.run = {**data.run, "rig": BAD, "versions": {BAD: BAD}}
    data.envelopes = tuple(replace(envelope, channel=BAD) for envelope in data.envelopes)
    data = replace(data, history=None, excerpts=())
    page = without_figures(report_html(data))
    assert "<script>alert" not in page
    assert page.count("<script>") == 1
    assert f"<h1>{BAD}</h1>" in unescape(page)


@pytest.mark.campaign
def test_a_diagnosis_with_a_script_for_a_rig_and_a_channel() -> None:
    report = fixture.report(Verdict.EFFECT, fixture.one_test())
    (head, *rest), worst = report.diagnosis.ranking, report.diagnosis.residual_tests[0]
    diagnosis = replace(
        report.diagnosis,
        ranking=(replace(head, place="force_sensor", detail=BAD), *rest),
        residual_tests=({**worst, "where": BAD},),
    )
    rig = report.rig.model_copy(update={"name": BAD, "description": BAD})
    page = without_figures(diagnosis_page(replace(report, diagnosis=diagnosis, rig=rig)))
    assert page.count("<script>") == 1
    assert f"<h1>{BAD}</h1>" in unescape(page)
    assert f'<td class="text wrap">the force sensor, channel {BAD}</td>' in unescape(page)
    assert f'<td class="text">{BAD}</td>' in unescape(page)
