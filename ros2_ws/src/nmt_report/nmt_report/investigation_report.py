"""``report.html`` of an investigation: probabilities over bench time, what was asked and why, what it showed."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from statistics import median

from markupsafe import Markup

from nmt_diagnose.diagnose import DiagnosisOutcome
from nmt_diagnose.effects.location import effect_words
from nmt_diagnose.investigation.investigation_record import AskedTest, InvestigationRecord
from nmt_diagnose.say.words import verdict_text
from nmt_report.diagnosis_files import drawn
from nmt_report.diagnosis_report import course_figures, observable_table, place_drawing, remainder_table
from nmt_report.figure_parts import plot_panels, report_figure
from nmt_report.html_page import Table, part
from nmt_report.quantity_format import plain, significant
from nmt_report.response_page import ResponsePage, html_figures, text_table
from nmt_report.svg import GRID, INK, MUTED, ReportFigure, figure_style, level_colours

ENDS = {
    "named": ("The cause has a name", "good"),
    "no_gap": ("There is no gap", "good"),
    "recalibrated": ("The model's own parameters were off", "good"),
    "unknown": ("There is a gap, and nothing in the library explains all of it", "bad"),
    "not_told_apart": ("Some causes cannot be told apart here", "partly"),
    "budget": ("The bench time is used up", "partly"),
    "stopped": ("Stopped", "partly"),
    "proposed": ("The next test is proposed", "partly"),
    "": ("It goes on", "partly"),
}
"""Sentence and class of each end of an investigation."""

_SHOWN_ANSWERS = 6
_LEAST_SHOWN = 0.02


_COURSES = ("frequency", "amplitude", "frf")
"""Figures of a diagnosis that a person looks at first, by the key that their names begin with."""
DIAGNOSIS, REPORT = "diagnosis", "report.html"
"""Folder of the last diagnosis, and the page in it and in that of each test."""


def investigation_page(record: InvestigationRecord, outcome: DiagnosisOutcome | None = None) -> str:
    """The whole HTML page.

    Args:
        record: of the investigation.
        outcome: the last diagnosis; None = nothing has been diagnosed. Its report is in the folder `DIAGNOSIS`.
    """
    with figure_style():
        figures = [timeline_figure(record)] if record.turns else []
    verdict = ENDS[record.ended]
    thinking = [turn.thinking_s for turn in record.turns]
    page = ResponsePage(
        kicker="Investigation",
        heading=Path(record.real).stem or ", ".join(map(_last, record.bags)),
        subtitle=f"Compared with {Path(record.model).name}",
        verdict=verdict,
        answers=[("Conclusion", record.conclusion)] if record.conclusion else [],
        facts=[
            ("Tests", f"{len(record.measured)} in {record.bench_s:.0f} s of bench time" if record.real else ""),
            (
                "Diagnoses",
                f"{len(thinking)}, {median(thinking):.0f} s each in the median" if thinking else "",
            ),
        ],
        sections=[
            *(_looked_at(outcome) if outcome is not None else ()),
            ("timeline", "Probabilities over bench time", html_figures(figures)),
            ("tests", "Tests and their results", part("table", _linked(record)) if record.tests else Markup()),
        ],
        footer="Information in nats: what the entropy of the two answers falls by that the test is to set apart.",
    )
    return page.html()


def _looked_at(outcome: DiagnosisOutcome) -> list[tuple[str, str, Markup]]:
    """What a person looks at: where the gap lies, the course of measured and predicted values, and what remains."""
    report = drawn(outcome)
    found = outcome.diagnosis
    with figure_style():
        drawing = place_drawing(found, report.rig)
        courses = [figure for figure in course_figures(report) if figure.name.rsplit("-", 1)[0] in _COURSES]
    left = [remainder_table(found.remainder), observable_table(found.gap, found.verdict)]
    tables = Markup().join(part("table", table) for table in left if table is not None)
    words = Markup('<p>{} <a href="{}/{}">The whole diagnosis</a>.</p>').format(
        f"{verdict_text(found)[0].capitalize()}.", DIAGNOSIS, REPORT
    )
    return [
        ("place", "Where", words + html_figures([drawing])),
        ("courses", "Measured and predicted", html_figures(courses)),
        ("left", "What remains", tables),
    ]


def _linked(record: InvestigationRecord) -> Table:
    """The table of tests with links to the report of each that was measured."""
    table = tests_table(record)
    rows = [
        replace(row, cells=[Markup('<a href="{0}/{1}">{0}</a>').format(test.name, REPORT), *row.cells[1:]])
        if test.state == "measured"
        else row
        for row, test in zip(table.rows, record.tests, strict=True)
    ]
    return replace(table, rows=rows)


def _last(path: str) -> str:
    return Path(path).name


def timeline_figure(record: InvestigationRecord) -> ReportFigure:
    """Probabilities of the answers after each diagnosis over bench time, tests as marked spans."""
    figure, axes = plot_panels((6.3, 3.8), left=0.1, right=0.97, bottom=0.14, top=0.88)
    begun = 0.0
    for number, test in enumerate(record.measured):
        ended = begun + test.seconds
        if number % 2 == 0:
            axes.axvspan(begun, ended, color=GRID, alpha=0.5, linewidth=0)
        axes.text(0.5 * (begun + ended), 1.03, test.name[:2], ha="center", va="bottom", color=MUTED, fontsize="small")
        begun = ended
    times = [turn.bench_s for turn in record.turns]
    names = shown_answers(record)
    for name, colour in zip(names, [INK, *level_colours(max(1, len(names) - 1))], strict=False):
        values = [turn.answers.get(name, 0.0) for turn in record.turns]
        axes.plot(times, values, "o-", color=colour, label=effect_words(name), clip_on=False)
    axes.set_ylim(0.0, 1.0)
    axes.set_xlim(0.0, max([begun, *times, 1.0]))
    axes.set_xlabel("bench time (s)")
    axes.set_ylabel("probability")
    axes.legend(loc="center left")
    caption = "After each diagnosis; numbers above: tests, as in the table."
    return report_figure(figure, "timeline", "Probability of each answer", caption)


def shown_answers(record: InvestigationRecord) -> list[str]:
    """Answers that were ever likely, by their probability in the end, the first one first."""
    largest: dict[str, float] = {}
    for turn in record.turns:
        for name, p in turn.answers.items():
            largest[name] = max(largest.get(name, 0.0), p)
    last = record.turns[-1].answers
    likely = [name for name, p in largest.items() if p >= _LEAST_SHOWN]
    return sorted(likely, key=lambda name: (-last.get(name, 0.0), -largest[name]))[:_SHOWN_ANSWERS]


def tests_table(record: InvestigationRecord) -> Table:
    """Every test with what was asked, expected and received."""
    head = (
        ("Test", ""), ("What", ""), ("Why", ""), ("Bench time", "s"), ("Expected", "nats"), ("Received", "nats"),
        ("State", ""),
    )  # fmt: skip
    return text_table(head, [_row(test) for test in record.tests], "Dashes: nothing was to be set apart.")


def _row(test: AskedTest) -> list[str]:
    return [
        test.name, test.text, test.why, plain(test.seconds, 1), _nats(test.expected), _nats(test.received), test.state,
    ]  # fmt: skip


def _nats(value: float) -> str:
    return significant(value, 2) if math.isfinite(value) else "–"
