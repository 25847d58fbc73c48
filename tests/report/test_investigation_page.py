"""The page of an investigation shows what a person would look at, whatever its last diagnosis says."""

from __future__ import annotations

import math

import pytest
from report import diagnosis_fixture as fixture
from tiers import with_quick

from nmt_core.kinds import RandomTest
from nmt_core.kinds.request import TestRequest
from nmt_diagnose.diagnose import DiagnosisOutcome
from nmt_diagnose.investigation.investigation_record import AskedTest, InvestigationRecord, Turn
from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_report.investigation_report import investigation_page


def record(verdict: Verdict) -> InvestigationRecord:
    """A linear test that was measured and levels that failed."""
    linear = AskedTest("01_linear", TestRequest(kind=RandomTest()), "noise", "", seconds=20.0, state="measured")
    levels = AskedTest("02_levels", TestRequest(levels=(0.1, 0.2)), "levels", "", seconds=math.nan, state="failed")
    turn = Turn(1, 20.0, 1.0, verdict.value, {"none": 0.9, "unknown": 0.1}, "which")
    return InvestigationRecord("beam", "real.yaml", tests=(linear, levels), turns=(turn,), plan=(0.1, 0.2))


@pytest.mark.parametrize("verdict", with_quick(Verdict, Verdict.EFFECT))
@pytest.mark.usefixtures("undrawn")
def test_the_page_shows_the_place_the_courses_and_what_remains(verdict: Verdict) -> None:
    """With links to the diagnosis and to the report of each test that has one."""
    report = fixture.report(verdict)
    models = report.models
    outcome = DiagnosisOutcome(
        report.diagnosis, report.observations, report.rig, report.rig, models.as_given, models.refitted, models.final
    )
    page = investigation_page(record(verdict), outcome)
    for section in ("place", "courses", "timeline", "tests"):
        assert f'id="{section}"' in page
    assert '<a href="diagnosis/report.html">' in page
    assert '<a href="01_linear/report.html">01_linear</a>' in page
    assert "02_levels/report.html" not in page
    assert "Frequency and phase error over the" in page
    assert page.count("<svg") > investigation_page(record(verdict)).count("<svg")
