"""``report.html`` of a study: summary, findings, figures and the table of all levels in one file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from nmt_report.html_page import PageColumn, Row, Table, render
from nmt_report.quantity_format import duration, plain, significant
from nmt_study.study import Finding, Result, StudyOutput, StudyTable
from nmt_study.study_table import SummaryRow


def study_page(
    name: str,
    title: str,
    results: Sequence[Result],
    summary: Sequence[SummaryRow],
    rows: Sequence[Mapping[str, Any]],
    output: StudyOutput,
    quick: bool,
) -> str:
    """The whole page; the same text for the same results."""
    bench = sum(result["run"]["bench_time_s"] for result in results)
    rigs = sorted({str(result["case"]["rig"]) for result in results})
    specimen = "the virtual beam" if rigs == ["beam"] else f"the rig {' and '.join(rigs)}"
    noun = "test" if len(results) == 1 else "tests"
    short = ["Shortened run (--quick): few cases, levels and periods; not for conclusions."]
    return render(
        "study_report.html",
        title=f"{title}: study",
        name=name,
        heading=title,
        subtitle=f"{len(results)} {noun} of {specimen} through the bench’s nodes, {duration(bench)} of bench time",
        result=_verdict(output.findings, summary),
        warnings=short if quick else [],
        summary_table=_summary_table(summary),
        finding_table=_finding_table(output.findings),
        remarks=output.remarks,
        own_tables=[_own_table(table) for table in output.tables],
        shown=output.figures,
        level_table=_level_table(rows),
        case_table=_case_table(results),
    )


def index_page(entries: Sequence[tuple[str, str, Sequence[SummaryRow], Sequence[Finding]]], quick: bool) -> str:
    """Page over several studies: name, title, summary and findings of each."""
    return render(
        "study_index.html",
        title="Studies of the virtual experiment",
        studies=[
            (name, title, _summary_table(summary), _finding_table(findings))
            for name, title, summary, findings in entries
        ],
        warnings=["Shortened run (--quick)."] if quick else [],
    )


def _verdict(findings: Sequence[Finding], summary: Sequence[SummaryRow]) -> tuple[str, str]:
    """One sentence on what the study showed, and its class: ``good``, ``partly`` or ``bad``."""
    locked, levels = sum(row.locked for row in summary), sum(row.levels for row in summary)
    judged = [finding for finding in findings if finding.holds is not None]
    holding = sum(bool(finding.holds) for finding in judged)
    parts = [f"{holding} of {len(judged)} statements hold"] if judged else []
    if levels or not judged:  # random excitation has no levels that lock
        parts.append(f"{locked} of {levels} levels locked and extracted")
    whole = locked == levels and holding == len(judged)
    some = locked if levels else holding
    return "; ".join(parts), "good" if whole and some else "partly" if some else "bad"


_SUMMARY_COLUMNS = (
    PageColumn("Case", kind="text"),
    PageColumn("Levels"),
    PageColumn("Test: f̃", "%"),
    PageColumn("Test: δ̃", "%"),
    PageColumn("Method: f̃", "%"),
    PageColumn("Method: δ̃", "%"),
    PageColumn("Periods", "per level"),
    PageColumn("Note", kind="text wrap"),
)


def _summary_table(summary: Sequence[SummaryRow]) -> Table:
    """Largest errors of each case."""
    rows = [
        Row((
            row.case,
            f"{row.locked} of {row.levels}",
            *(_percent(value) for value in (*row.single_point, *row.epmc)),
            plain(row.periods, 1),
            row.note,
        ))
        for row in summary
    ]  # fmt: skip
    note = Markup(
        "Largest errors over the levels. Test: against the single-point reference at the same drive voltage. Method: "
        "against EPMC at the same <i>q</i>, where that is single-valued."
    )
    return Table(_SUMMARY_COLUMNS, rows, note)


def _own_table(table: StudyTable) -> Table:
    columns = [PageColumn(name, unit, "" if k else "text") for k, (name, unit) in enumerate(table.columns)]
    return Table(columns, [Row(row) for row in table.rows], table.note, table.title)


def _finding_table(findings: Sequence[Finding]) -> Table | None:
    if not findings:
        return None
    words = {True: "holds", False: "does not hold", None: "not judged"}
    rows = [
        Row((finding.claim, finding.found, words[finding.holds]), failed=finding.holds is False) for finding in findings
    ]
    columns = (
        PageColumn("Statement", kind="text wrap"),
        PageColumn("Found here", kind="text wrap"),
        PageColumn("", kind="text"),
    )
    return Table(columns, rows, heading="Statements checked")


_MOST_ROWS = 400
_LEVEL_COLUMNS = (
    ("omega_rad_s", "f̃", "Hz", 0.5 / math.pi, 6),
    ("damping_ratio", "δ̃", "%", 100.0, 4),
    ("modal_amplitude", Markup("<i>q</i>"), "10⁻⁶ m√kg", 1e6, 5),
    ("force_n", Markup("|<i>F</i>₁|"), "N", 1.0, 4),
    ("pbmif", "PBMIF", "1", 1.0, 5),
    ("omega_error_single_point", "Δf̃ test", "%", 100.0, 2),
    ("damping_error_single_point", "Δδ̃ test", "%", 100.0, 2),
    ("omega_error_epmc", "Δf̃ method", "%", 100.0, 2),
    ("damping_error_epmc", "Δδ̃ method", "%", 100.0, 2),
    ("time_to_lock_s", "lock", "s", 1.0, 3),
    ("periods", "periods", "", 1.0, 4),
)


def _level_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    body = []
    for row in rows[:_MOST_ROWS]:
        cells = [str(row["case"]), significant(row["level"])]
        if row["omega_rad_s"] is None:
            body.append(Row(cells, failed=True, reason=f"{row['status']}: {row['reason']}"))
            continue
        for name, _, _, factor, digits in _LEVEL_COLUMNS:
            value = row[name]
            cells.append("—" if value is None else significant(factor * value, digits))
        body.append(Row(cells))
    columns = [PageColumn("Case", kind="text"), PageColumn("Level")]
    columns += [PageColumn(symbol, unit) for _, symbol, unit, _, _ in _LEVEL_COLUMNS]
    more = f"The first {_MOST_ROWS} of {len(rows)} rows; all are in study.csv." if len(rows) > _MOST_ROWS else ""
    return Table(columns, body, more)


_CASE_COLUMNS = (
    PageColumn("Case", kind="text"),
    PageColumn("Changes of the rig", kind="text wrap"),
    PageColumn("Loop", kind="text wrap"),
    PageColumn("Window", "periods"),
    PageColumn("Bench time", "s"),
    PageColumn("× real time"),
    PageColumn("Case", "s"),
    PageColumn("EPMC folds, q in m√kg", kind="text wrap"),
)


def _case_table(results: Sequence[Result]) -> Table:
    rows = []
    for result in results:
        case, run = result["case"], result["run"]
        settings = {"loop": case["loop"], **case["loop_values"]}
        folds = ", ".join(f"{significant(low, 3)} to {significant(high, 3)}" for low, high in result["epmc"]["folds"])
        cells = (
            case["name"],
            ", ".join(case["overrides"]) or "none",
            ", ".join(f"{k}: {significant(v, 4) if isinstance(v, float) else v}" for k, v in settings.items()),
            case["window_periods"],
            significant(run["bench_time_s"], 4),
            plain(run["real_time_factor"], 0),
            plain(run["case_time_s"], 1),
            folds or "none",
        )
        rows.append(Row(cells))
    return Table(_CASE_COLUMNS, rows)


def _percent(value: float) -> str:
    return significant(100.0 * value, 2) if math.isfinite(value) else "—"
