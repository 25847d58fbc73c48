"""What stands behind ±: the budget with every source that is known, or repeatability without a budget.

Repeatability is the standard uncertainty that a window shows of itself; ``modal.csv`` and ``modal.json`` have it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nmt_core.messages.modal_point import ModalPoint
    from nmt_extract.judgement.uncertainty_budget import PointBudget

BUDGET, REPEATABILITY = "combined standard uncertainty", "repeatability"


def with_budgets(points: Sequence[ModalPoint], budgets: Sequence[PointBudget]) -> list[ModalPoint]:
    """The points with the total of their budget as standard uncertainty, for each quantity that has one."""
    by_level = {point.level_index: point.budgets for point in budgets}
    stated = []
    for point in points:
        totals: dict[str, Any] = {
            f"{name}_std": budget.total for name, budget in by_level.get(point.level_index, {}).items()
        }
        stated.append(replace(point, **totals))
    return stated


def std_words(name: str, budgets: Sequence[PointBudget]) -> str:
    """What the standard uncertainty of a quantity is, once :func:`with_budgets` is through with its points."""
    return BUDGET if any(name in point.budgets for point in budgets) else REPEATABILITY


def std_note(budgets: Sequence[PointBudget]) -> str:
    """The same of a table with all quantities, a sentence."""
    if not budgets:
        return f"±: {REPEATABILITY}."
    return f"±: {BUDGET} for f̃, δ̃, q and |F₁|, {REPEATABILITY} for the others."
