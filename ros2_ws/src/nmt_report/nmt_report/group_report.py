"""``report.html`` of several units: their parameters one next to the other, what they share and how they scatter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup, escape

from nmt_core.text.number_words import value_text
from nmt_diagnose.units.random_effects import COVERAGE
from nmt_diagnose.units.unit_group import UnitGroup, UnitQuantity, explanation_words
from nmt_report.figure_parts import plot_panels, report_figure
from nmt_report.response_page import ResponsePage, html_figures, html_table
from nmt_report.svg import BLUE, INK, ORANGE, ReportFigure, figure_style

_DRAWN = 8


def group_page(name: str, description: str, group: UnitGroup, reports: Sequence[tuple[str, str]] = ()) -> str:
    """The whole page.

    Args:
        name, description: of the model.
        group: of :func:`nmt_diagnose.units.unit_group.unit_group`.
        reports: name and address of the report of each diagnosis.
    """
    with figure_style():
        figures = [_by_unit(quantity, number) for number, quantity in enumerate(group.quantities[:_DRAWN])]
    links = Markup("").join(Markup('<p><a href="{}">{}</a></p>').format(address, name) for name, address in reports)
    odd = any(quantity.components.odd for quantity in group.quantities)
    healthy = not odd and all(label == "none" for _, _, label in group.explanations)
    page = ResponsePage(
        kicker="Diagnosis of several units",
        heading=name,
        subtitle=description,
        verdict=(group.sentences[0] if group.sentences else "Nothing to compare.", "good" if healthy else "partly"),
        cards=[("Units", str(len(group.units)), f"{len(group.explanations)} diagnoses")],
        answers=[("Parameters", " ".join(group.sentences[1:]))] if group.sentences[1:] else [],
        footer=str(escape("± is one standard uncertainty. SI units.")),
        sections=[
            ("quantities", "Parameters over the units", _table(group)),
            ("units", "Parameter by unit", html_figures(figures)),
            ("explanations", "What each diagnosis named", _explanations(group)),
            ("reports", "Reports of the units", links),
        ],
    )
    return page.html()


def _table(group: UnitGroup) -> Markup:
    if not group.quantities:
        return Markup()
    rows = []
    for quantity in group.quantities:
        found, unit = quantity.components, quantity.unit_of_value
        within = "—" if found.within_std is None else value_text(found.within_std, 0.0, unit)
        reach = 0.5 * (found.next_high - found.next_low)
        rows.append(
            [
                quantity.name, value_text(found.mean, found.mean_std, unit), value_text(found.between_std, 0.0, unit),
                within, value_text(0.5 * (found.next_high + found.next_low), reach, unit),
                ", ".join(odd.unit for odd in found.odd) or "—",
            ]
        )  # fmt: skip
    head = [("parameter", ""), ("mean of the units", ""), ("between units", ""), ("within a unit", ""),
            (f"next unit, {COVERAGE:.0%}", ""), ("odd", "")]  # fmt: skip
    note = "Scatter beyond the ± of each estimate. The band is of the next unit's estimate, measured likewise."
    return html_table(head, rows, note)


def _explanations(group: UnitGroup) -> Markup:
    head = [("unit", ""), ("setting", ""), ("named", "")]
    return html_table(
        head, [[unit, setting or "—", explanation_words(label)] for unit, setting, label in group.explanations]
    )


def _by_unit(quantity: UnitQuantity, number: int) -> ReportFigure:
    """Estimates of one parameter by unit with their ±, the mean, and the band of the next unit."""
    figure, axes = plot_panels((6.2, 3.4), left=0.16, right=0.98, bottom=0.16, top=0.95)
    found = quantity.components
    places = {unit.unit: k for k, unit in enumerate(found.units)}
    odd = {each.unit for each in found.odd}
    axes.axhspan(found.next_low, found.next_high, color=BLUE, alpha=0.12, linewidth=0)
    axes.axhline(found.mean, color=INK, linewidth=0.8)
    for unit, k in places.items():
        estimates = [each for each in quantity.estimates if each.unit == unit]
        shifts = 0.25 * np.linspace(-1.0, 1.0, len(estimates)) if len(estimates) > 1 else np.zeros(1)
        axes.errorbar(
            k + shifts, [each.value for each in estimates], [each.std for each in estimates], fmt="o", markersize=4,
            capsize=3, color=ORANGE if unit in odd else BLUE,
        )  # fmt: skip
    axes.set_xticks(list(places.values()), list(places))
    axes.set_xlim(-0.6, len(places) - 0.4)
    unit_text = f" ({quantity.unit_of_value})" if quantity.unit_of_value not in ("", "1") else ""
    axes.set_ylabel(f"{quantity.name.rsplit(': ', 1)[-1].rsplit('.', 1)[-1]}{unit_text}")
    caption = (
        f"{quantity.name}: estimates with one standard uncertainty, mean of the units (line), and the band that holds "
        f"the next unit with {COVERAGE:.0%}. Orange: a unit that its sisters do not predict."
    )
    return report_figure(figure, f"unit-{number}", quantity.name, caption, label=f"{quantity.name} by unit")
