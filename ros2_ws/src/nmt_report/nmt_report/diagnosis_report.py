"""``report.html`` of a diagnosis: where the gap lies, what causes it, how far it shrinks, and how that was found."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from nmt_core.text.number_words import percent, share_with_interval, value_text
from nmt_diagnose.ledger.diagnosis import NULL, UNKNOWN, Diagnosis, Gap, Remainder, Verdict
from nmt_diagnose.measurements.measurement import Measurement, Observations
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.say.sentences import place_words
from nmt_diagnose.say.words import (
    answered,
    answers_text,
    channel_text,
    class_text,
    closed_text,
    effect_text,
    equation_text,
    is_partial,
    is_within_first,
    key_text,
    parameters_text,
    place_text,
    probability_text,
    rest_text,
    sigma_text,
    smallest_text,
    verdict_text,
)
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_report.diagnosis_curves import (
    Course,
    Models,
    courses,
    harmonic_courses,
    level_names,
    on_one_scale,
)
from nmt_report.diagnosis_figures import Shown, course_figure, harmonic_figure, residual_figure
from nmt_report.html_page import PageColumn, Row, Table, part
from nmt_report.law_figures import law_figures, law_table
from nmt_report.quantity_format import plain, significant
from nmt_report.response_page import ResponsePage
from nmt_report.rig_drawing import rig_figure
from nmt_report.svg import BLUE, GREEN, MUTED, ORANGE, ReportFigure, figure_style
from nmt_rig.rig import Rig

_LEFT_OVER = 0.01
_LARGE = 1.5
_CORRECTED = ("Corrected model", "It is model.yaml, next to this page.")
_WINNERS = ((Verdict.NONE, NULL), (Verdict.CALIBRATION, NULL), (Verdict.UNKNOWN, UNKNOWN))


@dataclass(frozen=True, eq=False)
class DiagnosisReport:
    """What the page is made from.

    Attributes:
        diagnosis: the result.
        observations: the real side.
        models: observables of the models.
        rig: the model as given.
        has_model: whether ``model.yaml`` lies next to the page.
    """

    diagnosis: Diagnosis
    observations: Observations
    models: Models
    rig: Rig
    has_model: bool = False

    @property
    def with_effect(self) -> bool:
        """Whether an effect was accepted."""
        return self.diagnosis.verdict is Verdict.EFFECT


def diagnosis_page(report: DiagnosisReport) -> str:
    """The whole page."""
    d = report.diagnosis
    with figure_style():
        maps = [
            residual_figure(d.residual_map, name, number, report.with_effect, _level_label(report.observations, name))
            for number, name in enumerate(dict.fromkeys(group.test for group in d.residual_map))
        ]
        curves = course_figures(report)
        drawing = place_drawing(d, report.rig)
        stated = d.law if d.law is not None and d.law.is_stated else None
        laws = law_figures(stated) if stated is not None else []
    claimed = d.verdict in (Verdict.EFFECT, Verdict.CALIBRATION)
    page = ResponsePage(
        kicker="Diagnosis of the gap between model and rig",
        heading=report.rig.name,
        subtitle=report.rig.description,
        verdict=_verdict(d),
        answers=answered(d) + ([_CORRECTED] if report.has_model and claimed else []),
        cards=_cards(d),
        notices=d.warnings,
        notes=d.notes,
        footer="Residual: (measured − model) / standard deviation of the noise, as the recordings show it: noise "
        "leaves a root mean square of about 1. ± standard uncertainty. Model as given: the rig file; re-fitted: its "
        "own parameters adjusted to these tests within what is known of them beforehand; with the effect: re-fitted "
        "with the effect added. SI units.",
    )
    return page.html(
        "diagnosis_report.html",
        drawing=[drawing],
        shares=probability_shares(d) if d.ranking else [],
        ranking=_ranking(d) if d.ranking else None,
        place_table=_places(d),
        placed_by_calibration=d.verdict is Verdict.CALIBRATION,
        no_gap=d.verdict is Verdict.NONE,
        closed=closed_text(d.gap) if claimed and math.isfinite(d.gap.closed) else "",
        gap_table=_gap(d),
        observable_table=observable_table(d.gap, d.verdict),
        remainder_table=remainder_table(d.remainder),
        law_table=law_table(stated) if stated is not None else None,
        laws=laws,
        next_table=_next(d),
        could_do_better=d.verdict.gap,
        one_remains=_one_remains(d),
        maps=maps,
        curves=curves,
        calibration_table=_calibration(d, report.rig),
        unexplained=d.verdict is Verdict.UNKNOWN,
        residual_tests=_residual_tests(d),
        input_tables=_input_tables(d),
        settings=_settings(d),
        fit_table=_candidates(d),
    )


def place_drawing(d: Diagnosis, rig: Rig) -> ReportFigure:
    """The rig with the place of the gap marked, where one is known."""
    if d.verdict is Verdict.EFFECT and d.ranking:
        head = d.ranking[0]
        return rig_figure(rig, head.place, head.detail, place_text(head.place, head.detail))
    if d.verdict is Verdict.UNKNOWN and d.where:
        first = d.where[0]
        return rig_figure(rig, first.place, first.detail, place_text(first.place, first.detail))
    return rig_figure(rig)


_LARGEST_SHARES = 4
_SHARE_COLOURS = (BLUE, ORANGE, GREEN, "#7a5195")


def probability_shares(d: Diagnosis) -> list[tuple[str, str, float, str]]:
    """Explanations whose probabilities add to 1: label, probability in words, share, colour; the last is the rest.

    Those of a partial explanation are probabilities among the library alone.
    """
    # Causes that two places share stand as one, in whatever order each names them.
    sums: dict[frozenset[str], float] = {}
    texts: dict[frozenset[str], str] = {}
    for item in d.ranking:
        if not is_within_first(d, item):
            key = frozenset((item.effect, *item.equivalents))
            sums[key] = sums.get(key, 0.0) + item.probability
            texts.setdefault(key, class_text(item))
    named = [(texts[key], p) for key, p in sums.items()]
    if not is_partial(d):
        named += [(effect_text(NULL), d.probabilities.get(NULL, 0.0)), rest_text(d)]
    largest = sorted(((text, p) for text, p in named if p > 0.0), key=lambda item: -item[1])[:_LARGEST_SHARES]
    shares = [
        (text, probability_text(p), p, colour) for (text, p), colour in zip(largest, _SHARE_COLOURS, strict=False)
    ]
    left = 1.0 - sum(p for _, _, p, _ in shares)
    if left > 0.005:
        shares.append(("all other explanations", probability_text(left), left, MUTED))
    return shares


def _one_remains(d: Diagnosis) -> bool:
    """Whether one effect at one place holds most of the probability and leaves nothing that matters."""
    effects = [effect for answer in d.answers for effect in answer.effects]
    certain = bool(d.ranking) and d.ranking[0].probability >= THRESHOLDS.verdict.cause_probability
    return (
        d.verdict is Verdict.EFFECT and d.adequate and certain and len(effects) == 1 and not place_words(d.ranking[0])
    )


def _level_label(observations: Observations, test: str) -> str:
    """What the columns of a test's residual map are."""
    kind = next((kind for kind in observations.tests if kind.name == test), None)
    return "segment" if kind is None else kind.axis.map_label


def _verdict(d: Diagnosis) -> tuple[str, str]:
    text, kind = verdict_text(d)
    return text[:1].upper() + text[1:], kind


def _cards(d: Diagnosis) -> list[tuple[str, str, str]]:
    gap, cards = d.gap, []
    if d.verdict is Verdict.EFFECT and d.ranking:
        head = d.ranking[0]
        note = f"of {len(head.equivalents) + 1} that these tests cannot distinguish, together"
        note = note if head.equivalents else "of this explanation"
        note += " among the effects of the library" if is_partial(d) else ""
        cards.append(("Probability", probability_text(head.probability), note))
        cards.append(
            (
                "Size of the effect",
                parameters_text(head.parameters),
                "± standard uncertainty",
            )
        )
    if d.verdict is Verdict.UNKNOWN:
        cards.append(("Not in the library", probability_text(d.probabilities.get(UNKNOWN, math.nan)), "probability"))
    if d.verdict is Verdict.EFFECT or (d.verdict is Verdict.CALIBRATION and math.isfinite(gap.closed)):
        closed, interval = share_with_interval(gap.closed, gap.low, gap.high)
        cards.append(("Gap closed on held-out data", closed, f"90 % interval {interval or 'not known'}"))
    if math.isfinite(gap.before):
        before = gap.as_given if d.verdict is Verdict.NONE else gap.before
        text = plain(before, 2)
        if d.verdict in (Verdict.EFFECT, Verdict.CALIBRATION):
            text += f" → {plain(gap.after, 2)}"
        cards.append(("Residual, rms", text, f"standard deviations; noise alone leaves {plain(gap.floor, 2)}"))
    return cards


# -- which, where, how far --------------------------------------------------------------------------------------------


def _bar(share: float, kind: str = "") -> Markup:
    return part("bar", _width(share), kind) if math.isfinite(share) else Markup("")


def _width(share: float) -> float:
    """Percent of a bar that a share fills."""
    return 100.0 * min(1.0, max(0.0, share))


def _with_bar(share: float, text: str, kind: str = "") -> Markup:
    return part("share", _width(share) if math.isfinite(share) else None, text, kind)


def _probability_cell(p: float, kind: str = "") -> Markup:
    return _with_bar(p, probability_text(p), kind)


def _ranking(d: Diagnosis) -> Table:
    rows = []
    for number, item in enumerate(d.ranking):
        remark = ""
        if item.equivalents:
            remark = "one class: these tests cannot distinguish them"
            remark += "; the test that would is below" if d.next_test and number == 0 else ""
        text = part("explanation", class_text(item), remark, effect_text(item.effect), equation_text(item.effect))
        accepted = "on" if d.verdict is Verdict.EFFECT and d.adequate and number == 0 else ""
        closed = item.closed
        value, limits = share_with_interval(closed.value, closed.low, closed.high)
        cells = (
            "within the first" if is_within_first(d, item) else _probability_cell(item.probability, accepted),
            text,
            place_text(item.place, item.detail),
            parameters_text(item.parameters),
            plain(item.sigmas, 1),
            part("std", value, limits),
        )
        rows.append((item.probability, Row(cells)))
    rest, p_rest = rest_text(d)
    partial = is_partial(d)
    unnamed = "an unknown force or error that no effect of the library describes"
    for label, title, p, what in (
        (NULL, effect_text(NULL), d.probabilities.get(NULL, 0.0), "the model as it is, its own parameters re-fitted"),
        (UNKNOWN, rest, p_rest, unnamed),
    ):
        accepted = "on" if (d.verdict, label) in _WINNERS else ""
        text = part("explanation", title, what, "", "")
        if not partial:
            rows.append((p, Row((_probability_cell(p, accepted), text, "", "", "", ""))))
        elif label == UNKNOWN:
            rows.append((-1.0, Row(("in addition", text, "", "", "", ""))))
    rows.sort(key=lambda item: -item[0])
    head = (
        PageColumn("Probability", "among the library" if partial else "", "text"),
        PageColumn("Explanation", kind="text wrap"),
        PageColumn("Place", kind="text wrap"),
        PageColumn("Parameters", "± standard uncertainty", "text wrap"),
        PageColumn("Strength", "standard deviations"),
        PageColumn("Gap closed", "%, held-out data"),
    )
    note = (
        "These explanations are fitted to the same data with the model’s own parameters free. The probability weighs "
        "the fit against the number of parameters. Strength: the estimate (of a factor its logarithm) over its "
        "standard deviation from noise of the data alone; ± also holds the uncertainty of gains and parameters. Gap "
        "closed: share of the residual beyond noise that the explanation removes from held-out data, with its 90 % "
        "interval; negative: it predicts worse than the model without it. Only the most probable are judged on it."
    )
    return Table(head, [row for _, row in rows], f"{answers_text(d.answers)} {note}".lstrip())


def _places(d: Diagnosis) -> Table | None:
    if not d.where:
        return None
    rows = [
        Row((
            place_text(item.place),
            place_text(item.place, item.detail).partition(", ")[2] or "—",
            _probability_cell(item.p, "on" if number == 0 else ""),
        ))
        for number, item in enumerate(d.where)
    ]  # fmt: skip
    head = [PageColumn(name, kind="text") for name in ("Place", "Most probably", "Probability")]
    note = "Probability that the cause, in the library or not, is at the place."
    return Table(head, rows, note)


def _gap(d: Diagnosis) -> Table:
    gap = d.gap
    steps = [("model as given", gap.as_given, ""), ("parameters re-fitted", gap.before, "")]
    if d.verdict is Verdict.CALIBRATION:
        steps = [("model as given", gap.before, ""), ("parameters re-fitted", gap.after, "on")]
    if d.verdict is Verdict.EFFECT:
        steps.append(("with the effect", gap.after, "on"))
    steps.append(("noise alone", gap.floor, "quiet"))
    largest = max((value for _, value, _ in steps if math.isfinite(value)), default=1.0)
    rows = [
        Row((name, _with_bar(value / largest, plain(value, 2), kind)))
        for name, value, kind in steps
        if math.isfinite(value)
    ]
    held = f"Held out in turn: {'; '.join(gap.held_out)}." if gap.held_out else "No data are held out."
    return Table((PageColumn("Residual, rms", kind="text"), PageColumn("standard deviations", kind="text")), rows, held)


def observable_table(gap: Gap, verdict: Verdict) -> Table | None:
    """What the model leaves of each observable, before and after; None where nothing is left to judge."""
    if not gap.per_observable:
        return None
    after = verdict in (Verdict.EFFECT, Verdict.CALIBRATION)
    rows = []
    for name, values in gap.per_observable.items():
        test, _, what = name.rpartition(": ")
        unit = str(values.get("unit", "")).replace("deg", "°")
        cells = [test, _observable_text(what)]
        for key in ("before", "after")[: 2 if after else 1]:
            size = _number(values, key)
            text = plain(size, 2 if size < 100 else 0)
            cells.append(Markup("<b>{}</b>").format(text) if size > _LARGE else text)
            cells.append(f"{significant(_number(values, f'{key}_unit'), 3)} {unit}")
        rows.append(Row([*cells, str(values.get("values", values.get("rows", "")))]))
    first, last = (
        ("model as given", "re-fitted") if verdict is Verdict.CALIBRATION else ("re-fitted", "with the effect")
    )
    head = [PageColumn("Test", kind="text"), PageColumn("Observable", kind="text")]
    for name in (first, last)[: 2 if after else 1]:
        head += [PageColumn(f"Residual {name}", "standard deviations"), PageColumn(f"Residual {name}", "rms")]
    note = f"Bold: more than {_LARGE:g} standard deviations."
    if not gap.held_out:
        return Table([*head, PageColumn("Values")], rows, f"{note} All data are in the fits.", "By observable")
    note += (
        " Each value is predicted from fits that exclude it; a value that several fits exclude counts in each rms. "
        "The rms of all rows is the residual above."
    )
    return Table([*head, PageColumn("Held-out values")], rows, note, "By observable, on held-out data")


def remainder_table(rest: Remainder | None) -> Table | None:
    """What the explanation leaves, observable by observable."""
    if rest is None or not rest.where:
        return None
    rows = []
    for item in rest.where:
        test, _, what = item.observable.rpartition(": ")
        value = f"{significant(item.rms_unit, 3)} {item.unit.replace('deg', '°')}"
        cells = [test, _observable_text(what), item.levels or "spread", _with_bar(item.share, percent(item.share))]
        rows.append(Row([*cells, significant(item.rms, 3), value]))
    head = [PageColumn(name, kind="text") for name in ("Test", "Observable", "Levels", "Share of the rest")]
    head += [PageColumn("Left", "standard deviations"), PageColumn("Left", "rms")]
    left, interval = share_with_interval(rest.share, rest.low, rest.high)
    interval = f" ({interval})" if interval else ""
    note = (
        f"{left}{interval} of the gap is left. A laboratory's rig differs from its model by more than "
        "one thing; a smooth error of some percent of the effect itself is expected."
    )
    return Table(head, rows, note, "Residual")


def _observable_text(text: str) -> str:
    """``amplitude of displacement at point 4`` for ``amplitude of x4``."""
    words, _, channel = text.rpartition(" ")
    named = channel_text(channel)
    return f"{words} {named}" if words and named != channel else text


def _number(values: Mapping[str, Any], key: str) -> float:
    value = values.get(key)
    return float(value) if isinstance(value, int | float) else math.nan


def _next(d: Diagnosis) -> Table | None:
    if not d.next_test:
        return None
    rows = [
        Row((
            item.test[:1].upper() + item.test[1:],
            ", ".join(effect_text(name) for name in item.separates),
            sigma_text(item.expected_sigma),
            item.command or "measure it on the rig",
        ))
        for item in d.next_test
    ]  # fmt: skip
    head = (
        PageColumn("Test", kind="text wrap"),
        PageColumn("Distinguishes", kind="text wrap"),
        PageColumn("Expected", "standard deviations"),
        PageColumn("Command", kind="text mono"),
    )
    note = (
        "Computed ahead with the fitted explanations: by how many standard deviations the least different two of them "
        "differ in the new test, after each has adapted what it still can. On hardware, run it with the real "
        "rig’s file."
    )
    return Table(head, rows, note)


# -- details ----------------------------------------------------------------------------------------------------------


def _calibration(d: Diagnosis, rig: Rig) -> Table | None:
    if not d.calibration:
        return None
    rows = []
    for item in sorted(d.calibration, key=lambda c: -abs(c.sigmas)):
        change = 100.0 * (item.to / item.start - 1.0) if item.start else math.nan
        learnt = item.std / (abs(item.to) * item.prior_std) if item.to and item.prior_std else math.nan
        rows.append(
            Row((
                key_text(item.name, rig),
                value_text(item.start, math.nan, item.unit),
                value_text(item.to, item.std, item.unit),
                _signed(change, 2),
                significant(100.0 * item.prior_std, 2),
                _bar(1.0 - learnt**2) if math.isfinite(learnt) else "",
                _signed(item.sigmas, 1),
            ))
        )  # fmt: skip
    head = (
        PageColumn("Key of the rig file", kind="text mono"),
        PageColumn("From"),
        PageColumn("To", "± standard uncertainty"),
        PageColumn("Change", "%"),
        PageColumn("Prior uncertainty", "%"),
        PageColumn("Variance removed by the tests", kind="text"),
        PageColumn("Change", "over ±"),
    )
    which = "with the effect in the model" if d.verdict is Verdict.EFFECT else "without any effect"
    note = (
        f"Re-fitted {which}. An empty bar: the tests remove none of the prior variance, and the parameter keeps its "
        "value."
    )
    return Table(head, rows, note)


def _signed(value: float, decimals: int) -> str:
    """Number with its sign; none where it rounds to zero."""
    text = f"{value:+.{decimals}f}" if math.isfinite(value) else "—"
    return text.lstrip("+-") if not text.strip("+-0.") else text.replace("-", "−")


def _residual_tests(d: Diagnosis) -> Table | None:
    if not d.residual_tests:
        return None
    rows = []
    for item in d.residual_tests:
        p, own = _number(item, "p_holm"), _number(item, "p")
        left = math.isfinite(p) and p < _LEFT_OVER
        cells = (
            str(item.get("name", "")),
            channel_text(str(item.get("where", ""))),
            significant(_number(item, "statistic"), 4),
            item.get("degrees_of_freedom") or "—",
            significant(own, 2),
            significant(p, 2),
            "something is left" if left else "noise",
        )
        rows.append(Row(cells, failed=left))
    head = (
        PageColumn("Test of the residual", kind="text"),
        PageColumn("Of", kind="text"),
        PageColumn("Statistic"),
        PageColumn("Degrees of freedom"),
        PageColumn("p", "alone"),
        PageColumn("p", "all tests together"),
        PageColumn("Reading", kind="text"),
    )
    note = (
        "Each test looks for one pattern in the residual of the best explanation; a large positive statistic shows it. "
        "A fit follows the noise a little and makes correlations of neighbours negative. Where p of all tests together "
        f"(Holm) is below {_LEFT_OVER:g}, something is left. p: chance of as large a statistic from noise."
    )
    return Table(head, rows, note)


def _input_tables(d: Diagnosis) -> list[Table]:
    inputs = d.inputs
    files = [
        (
            str(bag.get("path", "")),
            str(bag.get("sha256", "")),
            str(bag.get("role", "measurement")),
            str(bag.get("origin", {}).get("text", "—")),
        )
        for bag in inputs.get("bags", ())
    ]
    model = inputs.get("model_file")
    if isinstance(model, Mapping):
        files.append((str(model.get("path", "")), str(model.get("sha256", "")), "model", "—"))
    tables = []
    if files:
        head = (
            PageColumn("File", kind="text"),
            PageColumn("SHA-256", kind="text mono"),
            PageColumn("As", kind="text"),
            PageColumn("What made it", kind="text wrap"),
        )
        tables.append(Table(head, [Row(cells) for cells in files]))
    tests = [
        (
            str(test.get("name", "")),
            str(test.get("kind", "")),
            f"point {test.get('drive_point', '—')}",
            str(test.get("levels", "")),
            str(test.get("observables", "")),
        )
        for test in inputs.get("tests", ())
    ]
    if tests:
        names = ("Kind", "Driven at", "Levels or frequency lines", "Values")
        columns = (PageColumn("Test found", kind="text"), *(PageColumn(name) for name in names))
        tables.append(Table(columns, [Row(cells) for cells in tests], heading="Tests found in them"))
    if d.visible:
        weakest = [
            (effect_text(v.effect), place_text(v.place, v.detail), smallest_text(v.parameters)) for v in d.visible
        ]
        columns = (
            PageColumn("Effect", kind="text"), PageColumn("Where it would show first", kind="text wrap"),
            PageColumn("Seen from", "five standard deviations", "text wrap"),
        )  # fmt: skip
        rows = [Row(cells) for cells in weakest]
        note = "At this size or stronger; a low-pass corner at this frequency or below."
        tables.append(Table(columns, rows, note, "Smallest effects that these recordings would show"))
    return tables


def _settings(d: Diagnosis) -> list[tuple[str, str]]:
    inputs = d.inputs
    facts = [
        ("Overrides of the model", ", ".join(inputs.get("overrides", ()))),
        ("Effects left out of the library", ", ".join(effect_text(name) for name in inputs.get("withheld", ()))),
        ("Held out in turn", "; ".join(inputs.get("held_out", ()))),
        ("Seed", str(inputs.get("seed", ""))),
        ("Version", str(inputs.get("version", ""))),
    ]
    return [(name, value) for name, value in facts if value]


def _candidates(d: Diagnosis) -> Table | None:
    if not d.candidates:
        return None
    competing = sorted((item for item in d.candidates if not item.get("filter")), key=_evidence, reverse=True)
    rows = [
        Row((
            Markup('<span class="mono">{}</span>').format(item.get("label", "")),
            place_text(str(item.get("place", ""))) if item.get("place") else "—",
            plain(_evidence(item), 1),
            plain(_number(item, "chi_square"), 1),
            str(item.get("rows", "")),
            str(item.get("parameters", "")),
            plain(_number(item, "sigmas"), 1),
            "yes" if item.get("converged") else "no",
            ", ".join(item.get("small", ())) or "—",
        ))
        for item in competing
    ]  # fmt: skip
    behind = sorted((item for item in d.candidates if item.get("filter")), key=_evidence, reverse=True)
    labels = list(dict.fromkeys(str(item.get("label", "")) for item in behind))
    head = (
        PageColumn("Explanation", kind="text"),
        PageColumn("Place"),
        PageColumn("ln evidence", "over no effect"),
        PageColumn("χ²", "all data, stated uncertainties"),
        PageColumn("Values"),
        PageColumn("Parameters", "added"),
        PageColumn("Strength", "standard deviations"),
        PageColumn("Converged"),
        PageColumn("Too small to state", kind="text"),
    )
    note = (
        "χ² is in the uncertainties that the recordings state. The evidence and all other residuals on this page are "
        "in standard deviations of the noise that the best explanation shows, so they are about 1 for it."
    )
    if labels:
        note += f" Fits that were stopped early because they lay far behind the best: {', '.join(labels)}."
    return Table(head, rows, note)


def _evidence(item: Mapping[str, Any]) -> float:
    return _number(item, "log_evidence")


# -- curves -----------------------------------------------------------------------------------------------------------

_BELOW = (
    "Above: values. Below: difference, measured − model, with ± 2 standard deviations of the measurement in grey; "
    "where one model is far off, the scale is logarithmic beyond a few standard deviations."
)


def course_figures(report: DiagnosisReport) -> list[ReportFigure]:
    """Measured values next to those of the model before and after, test by test."""
    result: list[ReportFigure] = []
    shown = Shown.of(report.with_effect)
    tests = report.observations.tests
    for numbers in _together(tests):
        test = tests[numbers[0]]
        first, several = numbers[0], len(numbers) > 1
        tail = f", {test.name}" if not several and len(tests) > 1 else ""
        names = level_names([tests[number] for number in numbers]) if several else []

        def add(
            key: str,
            title: str,
            *parts: Part,
            numbers: list[int] = numbers,
            tail: str = tail,
            names: list[str] = names,
        ) -> None:
            panels: dict[str, list[Course | None]] = {}
            for place, number in enumerate(numbers):
                for course in (c for p in parts for c in courses(report.observations, report.models, number, p)):
                    if course.x.size > 2:
                        panels.setdefault(course.title, [None] * len(numbers))[place] = course
            if panels:
                found = [on_one_scale(panel) for panel in panels.values()]
                result.append(course_figure(f"{key}-{numbers[0]}", title + tail, _BELOW, found, shown, names))

        over = test.axis.label.partition(" / ")[0]
        for key, title, parts in test.axis.figures:
            add(key, title.format(over=over), *parts)
        harmonics = harmonic_courses(report.observations, report.models, first)
        if harmonics:
            result.append(harmonic_figure(f"harmonics-{first}", f"Harmonics{tail}", harmonics, shown))
    return result


def _together(tests: tuple[Measurement, ...]) -> list[list[int]]:
    """Numbers of the tests of each figure: frequency responses of the same channels to the same drive are in one."""
    groups: dict[object, list[int]] = {}
    for number, test in enumerate(tests):
        key = None if test.lines is None else test.lines.sweep_key
        groups.setdefault((number,) if key is None else key, []).append(number)
    return list(groups.values())
