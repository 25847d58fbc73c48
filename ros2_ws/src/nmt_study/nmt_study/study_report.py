"""``report.html`` of a study: summary, findings, figures and the table of all levels in one file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from typing import Any

from nmt_report.quantity_format import duration, plain, significant
from nmt_report.svg import ReportFigure
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
    sections = [
        ("summary", "Summary", summary_table(summary) + _findings(output.findings) + _remarks(output.remarks)),
        ("comparison", "Comparison", "".join(_own_table(table) for table in output.tables)),
        ("figures", "Figures", _figures(output.figures)),
        ("levels", "All cases and levels", _level_table(rows)),
        ("cases", "Cases", _cases(results)),
    ]
    notice = (
        '<p class="notice">Shortened run (--quick): few cases, levels and periods; not for conclusions.</p>'
        if quick
        else ""
    )
    bench = sum(result["run"]["bench_time_s"] for result in results)
    rigs = sorted({str(result["case"]["rig"]) for result in results})
    specimen = "the virtual beam" if rigs == ["beam"] else f"the rig {' and '.join(map(escape, rigs))}"
    noun = "test" if len(results) == 1 else "tests"
    head = (
        f'<header>\n<p class="kicker">Study {escape(name)}</p>\n<h1>{escape(title)}</h1>\n'
        f'<p class="subtitle">{len(results)} {noun} of {specimen} through the bench’s nodes, '
        f"{duration(bench)} of bench time</p>\n" + notice + _links(sections) + "</header>\n"
    )
    return html_page(f"{title}: study", head, sections)


def index_page(entries: Sequence[tuple[str, str, Sequence[SummaryRow], Sequence[Finding]]], quick: bool) -> str:
    """Page over several studies: name, title, summary and findings of each."""
    sections = [
        (
            name,
            title,
            f'<p><a href="{escape(name)}/report.html">Report with figures</a></p>'
            + summary_table(summary)
            + _findings(findings),
        )
        for name, title, summary, findings in entries
    ]
    notice = '<p class="notice">Shortened run (--quick).</p>' if quick else ""
    head = (
        '<header>\n<p class="kicker">Studies</p>\n<h1>The virtual experiment against its references</h1>\n'
        + notice
        + _links(sections)
        + "</header>\n"
    )
    return html_page("Studies of the virtual experiment", head, sections)


def html_page(title: str, head: str, sections: Sequence[tuple[str, str, str]]) -> str:
    """A self-contained page in the look of the run's report."""
    policy = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"
    body = "".join(
        f'<section id="{key}"><h2>{escape(name)}</h2>{html}</section>\n' for key, name, html in sections if html
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{_template('report.css')}</style>\n</head>\n<body>\n<main>\n"
        f"{head}{body}<footer>Symbols: ω̃ modal frequency, ω̃* relative to the linear mode; δ̃ modal damping ratio; "
        "<i>q</i> modal amplitude; Γ modal participation. Error of the method: distance to EPMC at the same <i>q</i>; "
        "error of the test: distance to the single-point phase-resonant reference at the same voltage. "
        "SI units.</footer>\n</main>\n"
        "<dialog><p><button>Close</button>Wheel: zoom. Drag: move. Double click: all.</p><div></div></dialog>\n"
        f"<script>\n{_template('report.js')}</script>\n</body>\n</html>\n"
    )


def summary_table(summary: Sequence[SummaryRow]) -> str:
    """Largest errors of each case as HTML."""
    rows = []
    for row in summary:
        cells = [
            f'<td class="text">{escape(row.case)}</td>',
            f"<td>{row.locked} of {row.levels}</td>",
            *(f"<td>{_percent(value)}</td>" for value in (*row.single_point, *row.epmc)),
            f"<td>{plain(row.periods, 1)}</td>",
            f'<td class="text wrap">{escape(row.note)}</td>',
        ]
        rows.append(f"<tr>{''.join(cells)}</tr>")
    head = (
        '<th class="text">Case</th><th>Levels</th><th>Test: ω̃<span class="unit">%</span></th>'
        '<th>Test: δ̃<span class="unit">%</span></th><th>Method: ω̃<span class="unit">%</span></th>'
        '<th>Method: δ̃<span class="unit">%</span></th><th>Periods<span class="unit">per level</span></th>'
        '<th class="text">Note</th>'
    )
    return (
        _table(head, rows)
        + '<p class="note">Largest errors over the levels. Test: against the single-point reference at the same '
        "drive voltage. Method: against EPMC at the same <i>q</i>, where that is single-valued.</p>"
    )


def _own_table(table: StudyTable) -> str:
    head = "".join(
        f"<th{' class=text' if k == 0 else ''}>{escape(name)}"
        + (f'<span class="unit">{escape(unit)}</span>' if unit else "")
        + "</th>"
        for k, (name, unit) in enumerate(table.columns)
    )
    rows = [
        "<tr>"
        + "".join(f"<td{' class=text' if k == 0 else ''}>{escape(cell)}</td>" for k, cell in enumerate(row))
        + "</tr>"
        for row in table.rows
    ]
    note = f'<p class="note">{escape(table.note)}</p>' if table.note else ""
    return f'<h3 class="after">{escape(table.title)}</h3>' + _table(head, rows) + note


def _findings(findings: Sequence[Finding]) -> str:
    if not findings:
        return ""
    words = {True: "holds", False: "does not hold", None: "open"}
    rows = [
        f"<tr{'' if finding.holds is not False else ' class=failed'}>"
        f'<td class="text wrap">{escape(finding.claim)}</td><td class="text wrap">{escape(finding.found)}</td>'
        f'<td class="text">{words[finding.holds]}</td></tr>'
        for finding in findings
    ]
    head = '<th class="text">Statement</th><th class="text">Found here</th><th class="text"></th>'
    return '<h3 class="after">Statements checked</h3>' + _table(head, rows)


def _remarks(remarks: Sequence[str]) -> str:
    items = "".join(f"<li>{escape(text)}</li>" for text in remarks)
    return f'<h3 class="after">Remarks</h3><ul class="plain">{items}</ul>' if items else ""


def _figures(figures: Sequence[ReportFigure]) -> str:
    items = "".join(
        f'<figure id="{figure.name}"{" class=wide" if figure.wide else ""}>'
        f"<h3>{escape(figure.title)}</h3>{figure.svg}<figcaption>{figure.caption}</figcaption></figure>\n"
        for figure in figures
    )
    return f'<div class="figures">{items}</div>' if items else ""


_LEVEL_COLUMNS = (
    ("omega_rad_s", "ω̃", "rad/s", 1.0, 6),
    ("damping_ratio", "δ̃", "%", 100.0, 4),
    ("modal_amplitude", "<i>q</i>", "10⁻⁶ m√kg", 1e6, 5),
    ("force_n", "|<i>F</i>₁|", "N", 1.0, 4),
    ("pbmif", "PBMIF", "1", 1.0, 5),
    ("omega_error_single_point", "Δω̃ test", "%", 100.0, 2),
    ("damping_error_single_point", "Δδ̃ test", "%", 100.0, 2),
    ("omega_error_epmc", "Δω̃ method", "%", 100.0, 2),
    ("damping_error_epmc", "Δδ̃ method", "%", 100.0, 2),
    ("time_to_lock_s", "lock", "s", 1.0, 3),
    ("periods", "periods", "", 1.0, 4),
)


def _level_table(rows: Sequence[Mapping[str, Any]]) -> str:
    body = []
    for row in rows[:400]:
        cells = [f'<td class="text">{escape(str(row["case"]))}</td><td>{significant(row["level"])}</td>']
        if row["omega_rad_s"] is None:
            why = escape(f"{row['status']}: {row['reason']}")
            cells.append(f'<td class="reason" colspan="{len(_LEVEL_COLUMNS)}">{why}</td>')
            body.append(f'<tr class="failed">{"".join(cells)}</tr>')
            continue
        for name, _, _, factor, digits in _LEVEL_COLUMNS:
            value = row[name]
            cells.append(f"<td>{'—' if value is None else significant(factor * value, digits)}</td>")
        body.append(f"<tr>{''.join(cells)}</tr>")
    head = '<th class="text">Case</th><th>Level</th>' + "".join(
        f'<th>{symbol}<span class="unit">{unit}</span></th>' for _, symbol, unit, _, _ in _LEVEL_COLUMNS
    )
    more = f'<p class="note">The first 400 of {len(rows)} rows; all are in study.csv.</p>' if len(rows) > 400 else ""
    return _table(head, body) + more


def _cases(results: Sequence[Result]) -> str:
    rows = []
    for result in results:
        case, run = result["case"], result["run"]
        changes = ", ".join(case["overrides"]) or "none"
        settings = {"loop": case["loop"], **case["loop_values"]}
        epmc = result["epmc"]
        folds = ", ".join(f"{significant(low, 3)} to {significant(high, 3)}" for low, high in epmc["folds"])
        rows.append(
            f'<tr><td class="text">{escape(case["name"])}</td><td class="text wrap">{escape(changes)}</td>'
            f'<td class="text wrap">{escape(", ".join(f"{k}: {_short(v)}" for k, v in settings.items()))}</td>'
            f"<td>{case['window_periods']}</td><td>{significant(run['bench_time_s'], 4)}</td>"
            f"<td>{plain(run['real_time_factor'], 0)}</td><td>{plain(run['case_time_s'], 1)}</td>"
            f'<td class="text wrap">{folds or "none"}</td></tr>'
        )
    head = (
        '<th class="text">Case</th><th class="text">Changes of the rig</th><th class="text">Loop</th>'
        '<th>Window<span class="unit">periods</span></th><th>Bench time<span class="unit">s</span></th>'
        '<th>× real time</th><th>Case<span class="unit">s</span></th><th class="text">EPMC folds, q in m√kg</th>'
    )
    return _table(head, rows)


def _short(value: Any) -> str:
    return significant(value, 4) if isinstance(value, float) else str(value)


def _links(sections: Sequence[tuple[str, str, str]]) -> str:
    links = "".join(f'<a href="#{key}">{escape(name)}</a>' for key, name, html in sections if html)
    return f"<nav>{links}</nav>\n"


def _table(head: str, rows: Sequence[str]) -> str:
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'


def _percent(value: float) -> str:
    return significant(100.0 * value, 2) if math.isfinite(value) else "—"


def _template(name: str) -> str:
    return files("nmt_report").joinpath("templates", name).read_text(encoding="utf-8")
