"""The report's page: facts, tables and figures put together to one self-contained HTML file."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from html import escape
from importlib.resources import files
from typing import Any

from nmt_core.vocabulary import ControlKind
from nmt_extract.modal_point import Status
from nmt_report.columns import shown_columns, status_text, unit_text
from nmt_report.quantity_format import (
    duration,
    engineering_exponent,
    file_size,
    plain,
    power_of_ten,
    significant,
    uncertain,
)
from nmt_report.run_data import RunReportData
from nmt_report.svg import ReportFigure


def page(data: RunReportData, figures: Mapping[str, Sequence[ReportFigure]]) -> str:
    """The whole HTML page.

    Args:
        data: the run.
        figures: figures by section: ``modal``, ``shape`` and ``run``.
    """
    title = f"{run_name(data)}: nonlinear modal test"
    # The policy forbids every request: the file can be read anywhere, for ever.
    policy = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"
    sections = [
        ("properties", "Modal properties", _modal_table(data) + _figures(figures.get("modal", ()))),
        ("shape", "Shape and harmonics", _figures(figures.get("shape", ()))),
        ("run", "The run", _figures(figures.get("run", ())) + _level_table(data)),
        ("assumptions", "Assumptions of the rig", _assumptions(data)),
        ("files", "Files and settings", _files(data) + _settings(data)),
    ]
    body = "".join(
        f'<section id="{key}"><h2>{escape(name)}</h2>{html}</section>\n' for key, name, html in sections if html
    )
    links = "".join(f'<a href="#{key}">{escape(name)}</a>' for key, name, html in sections if html)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{_template('report.css')}</style>\n</head>\n<body>\n<main>\n"
        f"{_header(data, links)}{body}"
        "<footer>Symbols: ω̃, f̃ modal frequency; δ̃ modal damping ratio; <i>q</i> modal amplitude; φ̃ "
        "mass-normalised shape; "
        "Γ modal participation. Convention: x(t) = Re Σ ψ<sub>n</sub> e<sup>inωt</sup>. ± standard "
        "uncertainty from sub-windows. SI units.</footer>\n"
        "</main>\n<dialog><p><button>Close</button>Wheel: zoom. Drag: move. Double click: whole figure.</p>"
        "<div></div></dialog>\n"
        f"<script>\n{_template('report.js')}</script>\n</body>\n</html>\n"
    )


def run_name(data: RunReportData) -> str:
    """Name of the rig, else of the run."""
    return str(data.rig.get("name") or data.run.get("rig") or data.run.get("run_id") or "Run")


def verdict(data: RunReportData) -> tuple[str, str]:
    """One sentence on what the run gave, and its class: ``good``, ``partly`` or ``bad``."""
    total = max(len(data.points), len(data.run.get("plan", {}).get("levels", ())))
    good = len(data.good_points)
    not_locked = sum(point.status == Status.NOT_LOCKED for point in data.points)
    rejected = len(data.failed_points) - not_locked
    parts = [f"{good} of {total} levels locked and extracted"]
    if not_locked:
        parts.append(f"{not_locked} not locked")
    if rejected:
        parts.append(f"{rejected} rejected")
    if total > len(data.points):
        parts.append(f"{total - len(data.points)} not reached")
    kind = "good" if good == total and good else "partly" if good else "bad"
    return "; ".join(parts), kind


def worst_deviation(data: RunReportData) -> tuple[float, float]:
    """Largest relative deviation of ω̃ and of δ̃ from the reference; NaN without a reference."""
    if data.reference is None:
        return math.nan, math.nan
    worst = [math.nan, math.nan]
    for point in data.good_points:
        expected = data.reference.at(point.modal_amplitude)
        for index, value in enumerate((point.omega_rad_s, point.damping_ratio)):
            deviation = value / expected[index] - 1.0
            if not abs(deviation) <= abs(worst[index]) and not math.isnan(deviation):
                worst[index] = deviation
    return worst[0], worst[1]


_CONTROLS: dict[Any, str] = {kind.value: kind.label for kind in ControlKind if kind is not ControlKind.UNKNOWN}


def _header(data: RunReportData, links: str) -> str:
    text, kind = verdict(data)
    description = data.rig.get("description", "")
    subtitle = f'<p class="subtitle">{escape(str(description))}</p>' if description else ""
    notices = "".join(
        f'<p class="notice">Level {point.level_index + 1} '
        f"({significant(point.level)} {unit_text(point.level_unit)}): "
        f"{status_text(point.status)}{': ' + escape(point.reason) if point.reason else ''}</p>"
        for point in data.failed_points
    )
    if data.loss:
        notices = f'<p class="notice">{escape(data.loss)}</p>' + notices
    state, reason = _end_of_run(data)
    if state not in ("", "done") and reason:
        notices = f'<p class="notice">End of the run: {escape(reason)}</p>' + notices
    return (
        f'<header>\n<p class="kicker">Nonlinear modal test</p>\n<h1>{escape(run_name(data))}</h1>\n{subtitle}'
        f'<p class="verdict {kind}">{escape(text)}</p>\n'
        f"{notices}{_cards(data)}{_facts(data)}<nav>{links}</nav>\n</header>\n"
    )


def _cards(data: RunReportData) -> str:
    points = data.good_points
    if not points:
        return ""

    def span(values: Sequence[float], digits: int = 4) -> str:
        low, high = significant(min(values), digits), significant(max(values), digits)
        return low if low == high else f"{low} … {high}"

    frequencies = [point.frequency_hz for point in points]
    exponent = engineering_exponent(point.modal_amplitude for point in points)
    cards = [
        (
            "Modal frequency f̃",
            f"{span(frequencies)} Hz",
            f"shift {_percent(min(frequencies) / max(frequencies) - 1.0)}",
        ),
        ("Modal damping δ̃", f"{span([100 * p.damping_ratio for p in points], 3)} %", ""),
        (
            "Modal amplitude <i>q</i>",
            f"({span([p.modal_amplitude / 10**exponent for p in points], 3)}) {power_of_ten(exponent)} m√kg",
            f"force {span([p.force_n for p in points], 3)} N",
        ),
    ]
    if data.reference is not None:
        omega, damping = worst_deviation(data)
        label = f"Largest deviation from {escape(data.reference.label)}"
        cards.append((label, f"ω̃ {_percent(omega)}, δ̃ {_percent(damping)}", ""))
    else:
        cards.append(("PBMIF, worst level", significant(min(point.pbmif for point in points), 4), ""))
    return (
        '<div class="cards">'
        + "".join(
            f'<div class="card"><div class="label">{label}</div><div class="value">{escape(value)}</div>'
            f'<div class="note">{escape(note)}</div></div>'
            for label, value, note in cards
        )
        + "</div>\n"
    )


def _facts(data: RunReportData) -> str:
    run, plan, linear = data.run, data.run.get("plan", {}), data.linear
    facts: list[tuple[str, Any]] = [
        ("Run", run.get("run_id")),
        ("Started", str(run.get("started", "")).replace("T", " ")),
        ("Rig", run.get("rig")),
        ("Exciter", f"at point {linear.drive_point}" if linear is not None else None),
        (
            "Target mode",
            f"{linear.target_mode + 1} (linear: {linear.frequency_hz:.3f} Hz, "
            f"{100 * linear.damping_ratios[linear.target_mode]:.2f} %, "
            f"from {'the model' if linear.source == 'model' else 'a linear test'})"
            if linear is not None
            else None,
        ),
        ("Level control", _CONTROLS.get(plan.get("control"), plan.get("control"))),
        ("Window", f"{plan['window_periods']} periods" if plan.get("window_periods") else None),
        ("Sampling", f"{significant(data.sample_rate, 6)} Hz"),
        ("Bench time", duration(data.end_sample / data.sample_rate) if data.end_sample else None),
        ("Seed", run.get("seed")),
        ("End of run", ": ".join(filter(None, _end_of_run(data)))),
        ("Versions", ", ".join(f"{name} {value}" for name, value in run.get("versions", {}).items())),
    ]
    items = "".join(
        f"<div><dt>{escape(name)}</dt><dd>{escape(str(value))}</dd></div>"
        for name, value in facts
        if value not in (None, "")
    )
    return f'<dl class="facts">{items}</dl>\n'


def _modal_table(data: RunReportData) -> str:
    if not data.points:
        return "<p>The run gave no modal point.</p>"
    points, columns = data.good_points, shown_columns(data.good_points)
    exponents = {c.name: engineering_exponent(getattr(p, c.name) for p in points) if c.scaled else 0 for c in columns}
    unit = unit_text(data.points[0].level_unit)
    head = f'<th>Level<span class="unit">{escape(unit)}</span></th>' + "".join(
        f"<th>{c.symbol}<span "
        f'class="unit">{" ".join(filter(None, (power_of_ten(exponents[c.name]), c.unit))) or 1}'
        "</span></th>"
        for c in columns
    )
    if data.reference is not None:
        head += '<th>Δω̃<span class="unit">%</span></th><th>Δδ̃<span class="unit">%</span></th>'
    rows = []
    for point in data.points:
        cells = [f"<td>{significant(point.level)}</td>"]
        if point.status != Status.OK:
            width = len(columns) + (2 if data.reference is not None else 0)
            reason = f": {escape(point.reason)}" if point.reason else ""
            rows.append(
                f'<tr class="failed">{cells[0]}<td class="reason" colspan="{width}">'
                f"{status_text(point.status)}{reason}</td></tr>"
            )
            continue
        for column in columns:
            factor = column.factor / 10.0 ** exponents[column.name]
            text = uncertain(
                factor * getattr(point, column.name),
                factor * getattr(point, f"{column.name}_std"),
                column.decimals,
            )
            value, _, std = text.partition(" ± ")
            cells.append(f"<td>{value}" + (f' <span class="std">± {escape(std)}</span>' if std else "") + "</td>")
        if data.reference is not None:
            expected = data.reference.at(point.modal_amplitude)
            cells.append(f"<td>{plain(100 * (point.omega_rad_s / expected[0] - 1), 4)}</td>")
            cells.append(f"<td>{plain(100 * (point.damping_ratio / expected[1] - 1), 2)}</td>")
        rows.append(f"<tr>{''.join(cells)}</tr>")
    note = ""
    if data.reference is not None:
        label = escape(data.reference.label)
        note = f'<p class="note">Δω̃, Δδ̃: deviation from {label} at the same modal amplitude.</p>'
    return _table(head, rows) + note


def _level_table(data: RunReportData) -> str:
    """When each level started, locked and was captured, in bench time."""
    if not data.levels:
        return ""
    locks = {lock.level_index: lock for lock in data.locks}
    steps = [step for step in data.levels if step.amplitude > 0.0]
    ends = [step.sample for step in data.levels[1:]] + [data.end_sample]
    after = {id(step): end for step, end in zip(data.levels, ends, strict=True)}
    points = {point.level_index: point for point in data.points}
    rate = data.sample_rate
    rows = []
    for step in steps:
        lock, point = locks.get(step.index), points.get(step.index)
        unit = unit_text(lock.level_unit) if lock else unit_text(point.level_unit) if point else ""
        cells = [
            f'<td class="text">{step.index + 1}</td>',
            f"<td>{significant(step.amplitude)} {escape(unit)}</td>",
            f"<td>{plain(step.sample / rate, 2)}</td>",
            f"<td>{plain((lock.sample - step.sample) / rate, 2) if lock else '—'}</td>",
            f"<td>{lock.window_periods if lock else '—'}</td>",
            f"<td>{plain(lock.window_samples / rate, 2) if lock else '—'}</td>",
            f"<td>{plain((after[id(step)] - step.sample) / rate, 2)}</td>",
            f'<td class="text wrap">{status_text(point.status) if point else "no result"}</td>',
        ]
        bad = point is None or point.status != Status.OK
        opening = '<tr class="failed">' if bad else "<tr>"
        rows.append(f"{opening}{''.join(cells)}</tr>")
    head = (
        '<th class="text">Level</th><th>Target</th><th>Start<span class="unit">s</span></th>'
        '<th>Time to lock<span class="unit">s</span></th><th>Window<span class="unit">periods</span></th>'
        '<th>Window<span class="unit">s</span></th><th>Whole level<span class="unit">s</span></th><th '
        'class="text">Result</th>'
    )
    return '<h3 class="after">Bench time of each level</h3>' + _table(head, rows)


def _assumptions(data: RunReportData) -> str:
    items = data.rig.get("assumptions") or []
    if isinstance(items, str):
        items = [items]
    return f'<ul class="plain">{"".join(f"<li>{escape(str(item))}</li>" for item in items)}</ul>' if items else ""


def _files(data: RunReportData) -> str:
    if not data.files:
        return ""
    rows = "".join(
        f'<tr><td class="text">{escape(entry.name)}</td><td>{file_size(entry.size)}</td>'
        f'<td class="text mono">{escape(entry.sha256)}</td></tr>'
        for entry in data.files
    )
    head = '<th class="text">File</th><th>Size</th><th class="text">SHA-256</th>'
    return _table(head, [rows])


def _settings(data: RunReportData) -> str:
    parts: list[tuple[str, Mapping[str, Any], Callable[[Any], str]]] = [
        ("run.json: plan, parameters, versions", data.run, _json_text),
        ("Rig file as used", data.rig, _json_text),
        ("Stop record", data.stop, _json_text),
    ]
    return "".join(
        f"<details><summary>{escape(name)}</summary><pre>{escape(write(values))}</pre></details>"
        for name, values, write in parts
        if values
    )


def _figures(figures: Sequence[ReportFigure]) -> str:
    items = "".join(
        f'<figure id="{figure.name}"{" class=wide" if figure.wide else ""}>'
        f"<h3>{escape(figure.title)}</h3>{figure.svg}"
        f"<figcaption>{figure.caption}</figcaption></figure>\n"
        for figure in figures
    )
    return f'<div class="figures">{items}</div>' if items else ""


def _table(head: str, rows: Sequence[str]) -> str:
    body = "".join(rows)
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _end_of_run(data: RunReportData) -> tuple[str, str]:
    """Exit state and reason of the stop record; empty where there is none."""
    end = data.stop.get("exit")
    if not isinstance(end, Mapping):
        return "", ""
    return str(end.get("state", "")), str(end.get("reason", ""))


def _json_text(values: Any) -> str:
    return json.dumps(values, indent=1, ensure_ascii=False, default=str)


def _percent(value: float) -> str:
    return f"{100 * value:+.2g} %".replace("-", "−") if math.isfinite(value) else "—"


def _template(name: str) -> str:
    return files("nmt_report").joinpath("templates", name).read_text(encoding="utf-8")
