"""The table of modal properties that a run shows in the terminal at its end."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from nmt_core.vocabulary import PointStatus
from nmt_extract.curves.limit_cycles import feeds_its_motion, limit_cycles
from nmt_extract.judgement.uncertainty_budget import BudgetInputs, left_out
from nmt_extract.modal.mode_identity import mode_verdict
from nmt_report.columns import shown_columns, status_text, unit_text
from nmt_report.quantity_format import concise, plain, significant, uncertain
from nmt_report.run_verdict import BAD, GOOD, PARTLY, level_sentences, run_verdict
from nmt_report.stated_uncertainty import std_note, with_budgets

if TYPE_CHECKING:
    from nmt_core.messages.linear_description import LinearDescription
    from nmt_core.messages.modal_point import ModalPoint
    from nmt_extract.judgement.uncertainty_budget import PointBudget
    from nmt_report.run_data import ReferenceCurve
    from nmt_report.run_verdict import RunVerdict


def modal_table(
    points: Sequence[ModalPoint],
    reference: ReferenceCurve | None = None,
    width: int = 160,
    budgets: Sequence[PointBudget] = (),
) -> Table:
    """Modal properties of each level with standard uncertainties, as many of them as fit.

    Args:
        points: in the order of the test; those without a result show what became of the level.
        reference: computed backbone; adds the deviation at the same modal amplitude.
        budgets: uncertainty budgets of the points; ± is their total, without them repeatability.
        width: columns of the terminal. Where ``value ± uncertainty`` does not fit, ``value(uncertainty of its
            last digits)`` is written; then the least important properties are left out.
    """
    console = Console(width=10_000)
    points = with_budgets(points, budgets)
    for write, rank in _LAYOUTS:
        table = _table(points, reference, write, rank)
        how = "value ± uncertainty" if write is uncertain else "value(uncertainty of its last digits)"
        table.title = f"Modal properties: {how}"
        table.caption = std_note(budgets)
        if console.measure(table).maximum <= width:
            break
    return table


_LAYOUTS: tuple[tuple[Callable[..., str], int], ...] = (
    (uncertain, 4), (concise, 5), (concise, 3), (concise, 2), (concise, 1),
)  # fmt: skip
"""How values are written, and the highest rank of a column that is shown."""


def _table(
    points: Sequence[ModalPoint],
    reference: ReferenceCurve | None,
    write: Callable[..., str],
    rank: int,
) -> Table:
    good = [point for point in points if point.status == PointStatus.OK]
    unit = unit_text(points[0].level_unit) if points else "V"
    table = Table(
        title_justify="left",
        title_style="bold",
        caption_justify="left",
        caption_style="dim",
        header_style="bold",
        box=SIMPLE_HEAD,
    )
    table.add_column(f"level\n{unit}", justify="right", no_wrap=True)
    columns = [column for column in shown_columns(good) if column.shown.rank <= rank]
    exponents = {column.name: column.exponent(good) for column in columns}
    for column in columns:
        unit = column.unit(exponents[column.name]) or "1"
        table.add_column(f"{column.shown.symbol}\n{unit}", justify="right", no_wrap=True)
    feeds = feeds_its_motion(points)
    if reference is not None:
        table.add_column("Δf̃\n%", justify="right", no_wrap=True)
        table.add_column("Δδ̃\npoints" if feeds else "Δδ̃\n%", justify="right", no_wrap=True)
    for point in points:
        cells = [significant(point.level)]
        if point.status != PointStatus.OK:
            table.add_row(*cells, Text(status_text(point.status)), style="red")
            continue
        cells += [column.cell(point, exponents[column.name], write) for column in columns]
        if reference is not None:
            expected = reference.at(point.modal_amplitude)
            cells.append(plain(100 * (point.omega_rad_s / expected[0] - 1), 4))
            deviation = point.damping_ratio - expected[1] if feeds else point.damping_ratio / expected[1] - 1
            cells.append(plain(100 * deviation, 3 if feeds else 2))
        table.add_row(*cells)
    return table


def print_modal_table(
    points: Sequence[ModalPoint],
    reference: ReferenceCurve | None,
    console: Console,
    budgets: Sequence[PointBudget] = (),
    inputs: BudgetInputs | None = None,
) -> None:
    """Print :func:`modal_table`, and below it what ± leaves out and why levels gave no result, or lack a channel."""
    if not points:
        console.print("No modal point.")
        return
    console.print(modal_table(points, reference, console.width, budgets))
    for sentence in () if inputs is None else left_out(inputs):
        console.print(Text(sentence, style="dim"))
    for cycle in limit_cycles(with_budgets(points, budgets)):
        kind = "Stable" if cycle.stable else "Unstable"
        q = uncertain(cycle.modal_amplitude, cycle.modal_amplitude_std)
        frequency = significant(cycle.omega_rad_s / (2.0 * math.pi), 6)
        console.print(f"{kind} limit cycle at q = {q} m√kg, {frequency} Hz")
    for is_good, style in ((True, "yellow"), (False, "red")):
        chosen = [p for p in points if (p.status == PointStatus.OK) is is_good and (p.reason or not is_good)]
        for sentence in level_sentences(chosen):
            console.print(Text(sentence, style=style))


def print_verdict(
    points: Sequence[ModalPoint], console: Console, planned: int = 0, linear: LinearDescription | None = None
) -> RunVerdict:
    """Print what a run gave in the colour of its tone.

    Args:
        points: one a level.
        console: where to.
        planned: levels of the plan; 0 = as many as there are points.
        linear: linear modes that they were extracted with, which determine the mode of a level.

    Returns:
        The verdict.
    """
    verdict = run_verdict(points, planned, linear)
    modes = "" if linear is None else mode_verdict(points, linear)
    if modes:
        console.print(Text(modes, style=_TONES[PARTLY]), soft_wrap=True)
    console.print(Text(f"{verdict.sentence}.", style=_TONES[verdict.tone]), soft_wrap=True)
    return verdict


_TONES = {GOOD: "green", PARTLY: "yellow", BAD: "red"}
