"""``report.html`` of a diagnosis: where the gap lies, what causes it, how far it shrinks, and how that was found."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from nmt_diagnose.evidence.conditions import PhaseResonanceTest, RandomTest, RecordTest
from nmt_diagnose.evidence.observables import Evidence, Part
from nmt_diagnose.inference.diagnosis import Diagnosis, Gap, Verdict
from nmt_diagnose.inference.hypotheses import NULL, UNKNOWN
from nmt_report.diagnosis_curves import Models, courses, drive_label, harmonic_courses
from nmt_report.diagnosis_figures import Shown, course_figure, harmonic_figure, residual_figure
from nmt_report.diagnosis_words import (
    QUESTIONS,
    channel_text,
    class_text,
    closed_text,
    effect_text,
    equation_text,
    key_text,
    parameters_text,
    percent,
    place_text,
    probability_text,
    rest_text,
    sigma_text,
    value_text,
    verdict_text,
)
from nmt_report.quantity_format import plain, significant
from nmt_report.response_page import ResponsePage, html_figures, html_table
from nmt_report.svg import ReportFigure, figure_style
from nmt_rig.rig import Rig

_LEFT_OVER = 0.01
_LARGE = 1.5
_WINNERS = ((Verdict.NONE, NULL), (Verdict.CALIBRATION, NULL), (Verdict.UNKNOWN, UNKNOWN))


@dataclass(frozen=True, eq=False)
class DiagnosisReport:
    """What the page is made from.

    Attributes:
        diagnosis: the result.
        evidence: the real side.
        models: observables of the models.
        rig: the model as given.
    """

    diagnosis: Diagnosis
    evidence: Evidence
    models: Models
    rig: Rig

    @property
    def with_effect(self) -> bool:
        """Whether an effect was accepted."""
        return self.diagnosis.verdict is Verdict.EFFECT


def diagnosis_page(report: DiagnosisReport) -> str:
    """The whole page."""
    d = report.diagnosis
    with figure_style():
        maps = [
            residual_figure(d.residual_map, name, number, report.with_effect, _level_label(report.evidence, name))
            for number, name in enumerate(dict.fromkeys(group.test for group in d.residual_map))
        ]
        curves = _curves(report)
    sections = [
        ("explanations", "Which", _ranking(d)),
        ("places", "Where", _places(d)),
        ("gap", "How far", _gap(d)),
        ("next", "Next test", _next(d)),
        ("map", "Residual map", html_figures(maps)),
        ("curves", "Curves", html_figures(curves)),
        ("calibration", "The model’s own parameters", _calibration(d, report.rig)),
        ("tests", "Is anything left?", _residual_tests(d)),
        ("inputs", "Inputs", _inputs(d)),
        ("fits", "All fitted explanations", _candidates(d)),
    ]
    heading = report.rig.name
    return ResponsePage(
        kicker="Diagnosis of the gap between model and rig",
        heading=heading,
        subtitle=report.rig.description,
        verdict=_verdict(d),
        answers=_answers(d),
        cards=_cards(d),
        facts=[],
        notices=d.notes,
        sections=sections,
        footer="Residual: (measured − model) / standard deviation of the measurement, so noise alone gives a root mean "
        "square of 1. ± standard uncertainty. Model as given: the rig file; re-fitted: its own parameters adjusted to "
        "these tests within what is known of them beforehand; with the effect: re-fitted with the effect added. SI "
        "units.",
    ).html()


def _level_label(evidence: Evidence, test: str) -> str:
    """What the columns of a test's residual map are."""
    kind = next((kind for kind in evidence.tests if kind.name == test), None)
    if isinstance(kind, RandomTest):
        return "middle of the band / Hz"
    return "segment" if kind is None or isinstance(kind, RecordTest) else drive_label(kind)


def _verdict(d: Diagnosis) -> tuple[str, str]:
    text, kind = verdict_text(d)
    return text[:1].upper() + text[1:], kind


def _answers(d: Diagnosis) -> list[tuple[str, str]]:
    names = [*QUESTIONS, "What next"]
    names += [""] * (len(d.sentences) - len(names))
    return list(zip(names, d.sentences, strict=False))


def _cards(d: Diagnosis) -> list[tuple[str, str, str]]:
    gap, cards = d.gap, []
    if d.verdict is Verdict.EFFECT and d.ranking:
        head = d.ranking[0]
        note = f"of {len(head.equivalents) + 1} that these tests cannot tell apart, together"
        note = note if head.equivalents else "of this explanation"
        cards.append(("Probability", probability_text(head.probability), note))
        cards.append(
            ("Strength of the effect", f"{plain(head.sigmas, 1)} × its uncertainty", parameters_text(head.parameters))
        )
    if d.verdict is Verdict.UNKNOWN:
        cards.append(("Not in the library", probability_text(d.probabilities.get(UNKNOWN, math.nan)), "probability"))
    if d.verdict is Verdict.EFFECT or (d.verdict is Verdict.CALIBRATION and math.isfinite(gap.closed)):
        cards.append(("Gap closed on held-out data", percent(gap.closed), f"90 % interval {_interval(gap)}"))
    if math.isfinite(gap.before):
        before = gap.as_given if d.verdict is Verdict.NONE else gap.before
        text = significant(before, 3)
        if d.verdict in (Verdict.EFFECT, Verdict.CALIBRATION):
            text += f" → {significant(gap.after, 3)}"
        cards.append(("Residual, rms", text, f"noise leaves {significant(gap.floor, 3)}"))
    return cards


def _interval(gap: Gap) -> str:
    if not math.isfinite(gap.low):
        return "not known"
    return f"{percent(gap.low)[:-2]} to {percent(gap.high)}"


# -- which, where, how far --------------------------------------------------------------------------------------------


def _bar(share: float, kind: str = "") -> str:
    if not math.isfinite(share):
        return ""
    width = 100.0 * min(1.0, max(0.0, share))
    return f'<span class="bar {kind}"><i style="width:{width:.1f}%"></i></span>'


def _probability_cell(p: float, kind: str = "") -> str:
    return f'<td class="text">{_bar(p, kind)} {escape(probability_text(p))}</td>'


def _row(cells: Sequence[str], wrapped: Sequence[int] = ()) -> str:
    """A table row; cells that start with ``<td`` are taken as they are, ``wrapped`` ones are texts that may wrap."""
    return (
        "<tr>"
        + "".join(
            cell
            if cell.startswith("<td")
            else f'<td class="text wrap">{cell}</td>'
            if k in wrapped
            else f"<td>{cell}</td>"
            for k, cell in enumerate(cells)
        )
        + "</tr>"
    )


def _table(head: Sequence[tuple[str, str, bool]], rows: Sequence[str], note: str = "") -> str:
    """A table of ready rows; the head has heading, unit, and whether it is a text column."""
    cells = "".join(
        f"<th{' class=text' if text else ''}>{name}{f'<span class=unit>{unit}</span>' if unit else ''}</th>"
        for name, unit, text in head
    )
    return f'<div class="scroll"><table><thead><tr>{cells}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>' + (
        f'<p class="note">{note}</p>' if note else ""
    )


def _ranking(d: Diagnosis) -> str:
    rows = []
    for number, item in enumerate(d.ranking):
        equation = equation_text(item.effect)
        text = f"<b>{escape(class_text(item))}</b>"
        if item.equivalents:
            text += '<br><span class="small">one class: these tests cannot tell them apart'
            text += "; the test that would is below</span>" if d.next_test and number == 0 else "</span>"
        if equation:
            text += f'<br><span class="small">{escape(effect_text(item.effect))}: {escape(equation)}</span>'
        accepted = "on" if d.verdict is Verdict.EFFECT and number == 0 else ""
        closed = percent(item.closed.value)
        if math.isfinite(item.closed.low):
            closed += f' <span class="std">{percent(item.closed.low)[:-2]} to {percent(item.closed.high)}</span>'
        rows.append((
            item.probability,
            _row(
                [
                    _probability_cell(item.probability, accepted), text, escape(place_text(item.place, item.detail)),
                    escape(parameters_text(item.parameters)), plain(item.sigmas, 1), closed,
                ],
                wrapped=(1, 2, 3),
            ),
        ))  # fmt: skip
    rest, p_rest = rest_text(d)
    named = rest == effect_text(UNKNOWN)
    unnamed = "a source at one of the places that follows no named law"
    for label, title, p, what in (
        (NULL, effect_text(NULL), d.probabilities.get(NULL, 0.0), "the model as it is, its own parameters re-fitted"),
        (UNKNOWN, rest, p_rest, unnamed if named else "how often that was so where the tests showed as little"),
    ):
        text = f'<b>{escape(title)}</b><br><span class="small">{what}</span>'
        accepted = "on" if (d.verdict, label) in _WINNERS else ""
        rows.append((p, _row([_probability_cell(p, accepted), text, "", "", "", ""], wrapped=(1, 2, 3))))
    rows.sort(key=lambda item: -item[0])
    head = [
        ("Probability", "", True), ("Explanation", "", True), ("Place", "", True),
        ("Parameters", "± standard uncertainty", True),
        ("Strength", "× its uncertainty", False), ("Gap closed", "%, held-out data", False),
    ]  # fmt: skip
    note = (
        "All explanations are fitted to the same data with the model’s own parameters free; the probability weighs how "
        "well each fits against how much freedom it has. Gap closed: share of the residual beyond the noise that goes, "
        "on data kept out of the fit, with the interval of 90 %; below zero the explanation predicts worse than the "
        "model without it. Only the most probable ones are tried on held-out data."
    )
    return _table(head, [row for _, row in rows], note)


def _places(d: Diagnosis) -> str:
    if not d.where:
        if d.verdict is Verdict.CALIBRATION:
            return (
                '<p>In <a href="#calibration">parameters that the model already has</a>; nothing is left to place.</p>'
            )
        return "<p>There is no gap to place.</p>" if d.verdict is Verdict.NONE else ""
    rows = [
        _row([
            f'<td class="text">{escape(place_text(item.place))}</td>',
            f'<td class="text">{escape(place_text(item.place, item.detail).partition(", ")[2] or "—")}</td>',
            _probability_cell(item.p, "on" if number == 0 else ""),
            f'<td class="text">{_bar(item.share)} {escape(percent(item.share))}</td>',
        ])
        for number, item in enumerate(d.where)
    ]  # fmt: skip
    head = [("Place", "", True), ("Most probably", "", True), ("Probability", "", True), ("Share of the gap", "", True)]
    note = (
        "Probability: of all explanations at the place together, named and unnamed. Share: what a source at this place "
        "can account for, weighted with that probability."
    )
    return _table(head, rows, note)


def _gap(d: Diagnosis) -> str:
    gap = d.gap
    steps = [("model as given", gap.as_given, ""), ("parameters re-fitted", gap.before, "")]
    if d.verdict is Verdict.CALIBRATION:
        steps = [("model as given", gap.before, ""), ("parameters re-fitted", gap.after, "on")]
    if d.verdict is Verdict.EFFECT:
        steps.append(("with the effect", gap.after, "on"))
    steps.append(("noise and repeatability", gap.floor, "quiet"))
    largest = max((value for _, value, _ in steps if math.isfinite(value)), default=1.0)
    rows = [
        _row([
            f'<td class="text">{escape(name)}</td>',
            f'<td class="text">{_bar(value / largest, kind)} {significant(value, 3)}</td>',
        ])
        for name, value, kind in steps
        if math.isfinite(value)
    ]  # fmt: skip
    names = escape("; ".join(gap.held_out))
    held = f"Held out from the fit: {names}." if names else "Nothing could be held out."
    text = _table([("Residual, rms", "", True), ("standard deviations", "", True)], rows, held)
    if d.verdict in (Verdict.EFFECT, Verdict.CALIBRATION) and math.isfinite(gap.closed):
        text = f"<p>Closed: <b>{escape(closed_text(gap))}</b> of what can be closed.</p>" + text
    return text + _per_observable(gap, d.verdict)


def _per_observable(gap: Gap, verdict: Verdict) -> str:
    if not gap.per_observable:
        return ""
    after = verdict in (Verdict.EFFECT, Verdict.CALIBRATION)
    rows = []
    for name, values in gap.per_observable.items():
        test, _, what = name.rpartition(": ")
        unit = escape(str(values.get("unit", "")).replace("deg", "°"))
        cells = [f'<td class="text">{escape(test)}</td>', f'<td class="text">{escape(_observable_text(what))}</td>']
        for key in ("before", "after")[: 2 if after else 1]:
            size = _number(values, key)
            text = plain(size, 2 if size < 100 else 0)
            cells.append(f"<b>{text}</b>" if size > _LARGE else text)
            cells.append(f"{significant(_number(values, f'{key}_unit'), 3)} {unit}")
        rows.append(_row([*cells, str(values.get("rows", ""))]))
    head = [("Test", "", True), ("Observable", "", True), ("Before", "noise = 1", False), ("Before", "rms", False)]
    if after:
        head += [("After", "noise = 1", False), ("After", "rms", False)]
    note = (
        f"Bold: more than {_LARGE:g} times the noise. Predicted without the level or the test that is judged, so that "
        "an uncertain parameter shows here too."
    )
    return '<h3 class="after">By observable, on held-out data</h3>' + _table([*head, ("Values", "", False)], rows, note)


def _observable_text(text: str) -> str:
    """``amplitude of displacement at point 4`` for ``amplitude of x4``."""
    words, _, channel = text.rpartition(" ")
    named = channel_text(channel)
    return f"{words} {named}" if words and named != channel else text


def _number(values: Mapping[str, Any], key: str) -> float:
    value = values.get(key)
    return float(value) if isinstance(value, int | float) else math.nan


def _next(d: Diagnosis) -> str:
    if not d.next_test:
        if d.verdict in (Verdict.NONE, Verdict.CALIBRATION):
            return ""
        return "<p>No test that this rig allows promises to tell the explanations apart any better.</p>"
    rows = [
        _row(
            [
                escape(item.test[:1].upper() + item.test[1:]),
                escape(", ".join(effect_text(name) for name in item.separates)),
                sigma_text(item.expected_sigma),
                f'<td class="text mono">{escape(item.command)}</td>',
            ],
            wrapped=(0, 1),
        )
        for item in d.next_test
    ]  # fmt: skip
    head = [
        ("Test", "", True), ("Tells apart", "", True), ("Expected", "standard deviations", False), ("Command", "", True)
    ]  # fmt: skip
    note = (
        "Computed ahead with the fitted explanations: by how many standard deviations the least different two of them "
        "differ in the new test, after each has adapted what it still can. On hardware, run it with the real "
        "rig’s file."
    )
    return _table(head, rows, note)


# -- details ----------------------------------------------------------------------------------------------------------


def _calibration(d: Diagnosis, rig: Rig) -> str:
    if not d.calibration:
        return ""
    rows = []
    for item in sorted(d.calibration, key=lambda c: -abs(c.sigmas)):
        change = 100.0 * (item.to / item.start - 1.0) if item.start else math.nan
        learnt = item.std / (abs(item.to) * item.prior_std) if item.to and item.prior_std else math.nan
        rows.append(
            _row([
                f'<td class="text mono">{escape(key_text(item.name, rig))}</td>',
                escape(value_text(item.start, math.nan, item.unit)),
                escape(value_text(item.to, item.std, item.unit)),
                _signed(change, 2),
                plain(100.0 * item.prior_std, 0),
                f'<td class="text">{_bar(1.0 - learnt**2) if math.isfinite(learnt) else ""}</td>',
                _signed(item.sigmas, 1),
            ])
        )  # fmt: skip
    head = [
        ("Key of the rig file", "", True), ("From", "", False), ("To", "± standard uncertainty", False),
        ("Change", "%", False), ("Known beforehand to", "%", False), ("Learnt from these tests", "", True),
        ("Change", "× its uncertainty", False),
    ]  # fmt: skip
    which = "with the effect in the model" if d.verdict is Verdict.EFFECT else "without any effect"
    warning = ""
    if d.verdict is Verdict.UNKNOWN:
        warning = (
            "<p>These values follow a gap that they cannot explain, and are no better knowledge of the rig: model.yaml "
            "keeps the ones given.</p>"
        )
    note = (
        f"Re-fitted {which}. Learnt: how much of the variance known beforehand the tests took away; an empty bar means "
        "that they say nothing about the parameter, and its value is the one given."
    )
    return warning + _table(head, rows, note)


def _signed(value: float, decimals: int) -> str:
    """Number with its sign; none where it rounds to zero."""
    text = f"{value:+.{decimals}f}" if math.isfinite(value) else "—"
    return text.lstrip("+-") if not text.strip("+-0.") else text.replace("-", "−")


def _residual_tests(d: Diagnosis) -> str:
    if not d.residual_tests:
        return ""
    rows = []
    for item in d.residual_tests:
        p, own = _number(item, "p_holm"), _number(item, "p")
        left = math.isfinite(p) and p < _LEFT_OVER
        rows.append(
            f"<tr{' class=failed' if left else ''}>"
            f'<td class="text">{escape(str(item.get("name", "")))}</td>'
            f'<td class="text">{escape(channel_text(str(item.get("where", ""))))}</td>'
            f"<td>{significant(_number(item, 'statistic'), 4)}</td><td>{item.get('freedom') or '—'}</td>"
            f"<td>{significant(own, 2)}</td><td>{significant(p, 2)}</td>"
            f'<td class="text">{"something is left" if left else "noise"}</td></tr>'
        )
    head = [
        ("Test of the residual", "", True), ("Of", "", True), ("Statistic", "", False), ("Freedom", "", False),
        ("p", "alone", False), ("p", "all tests together", False), ("Reading", "", True),
    ]  # fmt: skip
    note = (
        "Each test looks for one trace that an effect outside the library would leave in the residual of the best "
        "explanation. p: chance of as large a statistic from noise alone; with so many tests the smallest is corrected "
        f"(Holm). Below {_LEFT_OVER:g} something is left."
    )
    return _table(head, rows, note)


def _inputs(d: Diagnosis) -> str:
    inputs = d.inputs
    bags = [
        _row([f'<td class="text">{escape(str(bag.get("path", "")))}</td>',
              f'<td class="text mono">{escape(str(bag.get("sha256", "")))}</td>',
              f'<td class="text">{escape(str(bag.get("role", "real side")))}</td>'])
        for bag in inputs.get("bags", ())
    ]  # fmt: skip
    model = inputs.get("model_file")
    if isinstance(model, Mapping):
        bags.append(
            _row([f'<td class="text">{escape(str(model.get("path", "")))}</td>',
                  f'<td class="text mono">{escape(str(model.get("sha256", "")))}</td>', '<td class="text">model</td>'])
        )  # fmt: skip
    text = _table([("File", "", True), ("SHA-256", "", True), ("As", "", True)], bags) if bags else ""
    tests = [
        [
            escape(str(test.get("name", ""))), escape(_kind_text(str(test.get("kind", "")))),
            f"point {test.get('drive_point', '—')}", str(test.get("levels", "")), str(test.get("observables", "")),
        ]
        for test in inputs.get("tests", ())
    ]  # fmt: skip
    if tests:
        head = (("Test found", ""), ("Kind", ""), ("Driven at", ""), ("Levels or lines", ""), ("Observables", ""))
        text += '<h3 class="after">Tests found in them</h3>' + html_table(head, tests)
    facts = [
        ("Overrides of the model", ", ".join(inputs.get("overrides", ()))),
        ("Effects left out of the library", ", ".join(effect_text(name) for name in inputs.get("withheld", ()))),
        ("Held out in turn", "; ".join(inputs.get("held_out", ()))),
        ("Seed", str(inputs.get("seed", ""))),
        ("Calibration of confidence", str(inputs.get("confidence_sha256", ""))[:16]),
        ("Version", str(inputs.get("version", ""))),
    ]
    rows = "".join(f"<div><dt>{escape(k)}</dt><dd>{escape(v)}</dd></div>" for k, v in facts if v)
    return text + (f'<dl class="facts after">{rows}</dl>' if rows else "")


_KINDS = {
    "PhaseResonanceTest": "phase resonance, locked levels",
    "RandomTest": "random, frequency response",
    "RingDownTest": "ring-down",
    "RecordTest": "record, driven by the measured input",
    "BackboneTable": "backbone table",
}


def _kind_text(kind: str) -> str:
    return _KINDS.get(kind, kind)


def _candidates(d: Diagnosis) -> str:
    if not d.candidates:
        return ""
    rows = [
        [
            f'<span class="mono">{escape(str(item.get("label", "")))}</span>',
            escape(place_text(str(item.get("place", ""))) if item.get("place") else "—"),
            plain(_number(item, "log_evidence"), 1),
            plain(_number(item, "chi_square"), 1),
            str(item.get("rows", "")),
            str(item.get("parameters", "")),
            plain(_number(item, "sigmas"), 1),
            "yes" if item.get("converged") else "no",
        ]
        for item in d.candidates
    ]
    head = (
        ("Explanation", ""), ("Place", ""), ("ln evidence", "over no effect"), ("χ²", ""), ("Values", ""),
        ("Parameters", "added"), ("Strength", "× its uncertainty"), ("Converged", ""),
    )  # fmt: skip
    table = html_table(head, rows)
    return f"<details><summary>{len(rows)} fits, best evidence first</summary>{table}</details>"


# -- curves -----------------------------------------------------------------------------------------------------------

_BELOW = (
    "Above: values. Below: difference, model − measured, with ± 2 standard deviations of the measurement in grey; "
    "where one model is far off, the scale is logarithmic beyond a few standard deviations."
)


def _curves(report: DiagnosisReport) -> list[ReportFigure]:
    result: list[ReportFigure] = []
    shown = Shown.of(report.with_effect)
    several = len(report.evidence.tests) > 1
    for number, test in enumerate(report.evidence.tests):
        tail = f", {test.name}" if several else ""

        def add(key: str, title: str, *parts: Part, number: int = number, tail: str = tail) -> None:
            found = [c for part in parts for c in courses(report.evidence, report.models, number, part)]
            found = [course for course in found if course.x.size > 2]
            if found:
                result.append(course_figure(f"{key}-{number}", title + tail, _BELOW, found, shown))

        if isinstance(test, RandomTest):
            add("frf", "Frequency responses: magnitude", Part.LOG_MAGNITUDE)
            add("frf-phase", "Frequency responses: phase", Part.PHASE)
        elif isinstance(test, PhaseResonanceTest):
            over = drive_label(test).partition(" / ")[0]
            add("frequency", f"Frequency and phase error over the {over}", Part.LOG_FREQUENCY, Part.PHASE_ERROR)
            add("amplitude", f"Amplitudes over the {over}", Part.LOG_MAGNITUDE)
            add("phase", f"Phases to the drive over the {over}", Part.PHASE)
            add("line", "Lines that follow no excitation (mains hum)", Part.LINE)
        elif isinstance(test, RecordTest):
            add("record", "Record", Part.SAMPLE)
        else:
            add("decay", "Frequency and damping over the amplitude", Part.LOG_FREQUENCY, Part.DAMPING)
        harmonics = harmonic_courses(report.evidence, report.models, number)
        if harmonics:
            result.append(harmonic_figure(f"harmonics-{number}", f"Harmonics{tail}", harmonics, shown))
    return result
