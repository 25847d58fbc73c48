"""How long the set-up takes: what each step took on one computer, and how fast this one is beside it."""

from __future__ import annotations

from typing import Any

SECONDS = {"environment": 4.0, "requirements": 30.0, "workspace": 75.0, "kernels": 20.0}
"""Of each step on a slow computer of two cores. Kernels are compiled beside the workspace: what is left of them."""


def estimated_seconds(steps: list[str], state: dict[str, Any]) -> float:
    """Seconds that steps will take, by those that this computer has finished.

    Args:
        steps: names of steps that are to be done.
        state: the stamps; its ``seconds`` hold what finished steps took.
    """
    taken = state.get("seconds")
    known: dict[str, float] = {}
    if isinstance(taken, dict):
        known = {step: float(taken[step]) for step in SECONDS if step in taken}
    pace = sum(known.values()) / sum(SECONDS[step] for step in known) if known else 1.0
    return sum(known.get(step, pace * SECONDS[step]) for step in steps)


def left(seconds: float) -> str:
    """Time that is left, in whole minutes."""
    return "less than a minute left" if seconds < 60.0 else f"about {seconds / 60.0:.0f} min left"
