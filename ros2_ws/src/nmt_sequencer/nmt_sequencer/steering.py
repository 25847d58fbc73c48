"""Requests to steer a run, and what they make of its plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.vocabulary import SteeringAct
from nmt_sequencer.level_plan import MAX_LEVELS, RunPlan, check_levels

PRESENT_LEVEL = 2**32 - 1
"""Stands for the level that is present when the request comes; as in ``nmt_msgs/Steer``."""

_LONGEST_SOURCE = 100


@dataclass(frozen=True, slots=True)
class SteeringRequest:
    """What a person or a program asks of a run; fields as in ``nmt_msgs/Steer``.

    Attributes:
        act: what is asked for.
        level_index: SKIP_LEVEL, REPEAT_LEVEL: the level that is meant; ignored by the others.
        levels: CHANGE_LEVELS: what follows the present level, in the unit of the plan; ignored by the others.
        frequencies_hz: CHANGE_LEVELS: one for each of ``levels``, Hz, or none.
        at_sample: it is decided when all samples before this one are known; 0 = as soon as possible.
        source: who asks.

    Raises:
        BenchError: a value is out of range.
    """

    act: SteeringAct
    level_index: int = PRESENT_LEVEL
    levels: tuple[float, ...] = ()
    frequencies_hz: tuple[float, ...] = ()
    at_sample: int = 0
    source: str = "a program"

    def __post_init__(self) -> None:
        if self.act is SteeringAct.UNKNOWN:
            raise BenchError("Nothing is asked of the run; name the act, see the message Steering.")
        if len(self.source) > _LONGEST_SOURCE or not self.source.isprintable():
            raise BenchError(f"The source of a request must be at most {_LONGEST_SOURCE} printable characters.")
        if self.levels:
            check_levels(self.levels, "The levels to come")
        if self.act is SteeringAct.RESUME and self.at_sample:
            raise BenchError("A run goes on at once; leave at_sample at 0.")

    @property
    def fields(self) -> dict[str, Any]:
        """Fields of ``nmt_msgs/Steer``."""
        return {
            "act": int(self.act),
            "level_index": self.level_index,
            "levels": list(self.levels),
            "frequencies_hz": list(self.frequencies_hz),
            "at_sample": self.at_sample,
            "source": self.source,
        }


def with_rest(
    plan: RunPlan,
    present: int,
    levels: Sequence[float],
    frequencies_hz: Sequence[float],
    phases: Sequence[float] | None = None,
) -> RunPlan:
    """The plan with other levels after the present one.

    Args:
        plan: the plan.
        present: index of the present level.
        levels: what follows it.
        frequencies_hz: one for each of them, Hz; empty: as the plan has it, if all its levels have the same.
        phases: held phase of each of them, rad; None: as the kind of test begins with these levels.

    Raises:
        BenchError: too many levels, or frequencies are missing or too many.
    """
    if phases is None:
        levels, phases = _steps(plan, present, levels)
    if present + 1 + len(levels) > MAX_LEVELS:
        raise BenchError(
            f"A plan has at most {MAX_LEVELS} levels; {present + 1} are begun, {len(levels)} would follow."
        )
    given = tuple(frequencies_hz)
    if plan.frequencies_hz and not given and len(set(plan.frequencies_hz)) == 1:
        given = (plan.frequencies_hz[0],) * len(levels)
    if len(given) != (len(levels) if plan.frequencies_hz else 0):
        needed = "a frequency for each of the levels" if plan.frequencies_hz else "no frequencies"
        raise BenchError(f"This plan takes {needed}; {len(levels)} levels and {len(given)} frequencies are given.")
    kept = slice(0, present + 1)
    begun = frozenset(index for index in plan.levels_without if index <= present)
    return replace(
        plan,
        levels=(*plan.levels[kept], *levels),
        frequencies_hz=(*plan.frequencies_hz[kept], *given),
        phases=(*plan.phases[kept], *phases),
        levels_without=begun,
    )


def _steps(plan: RunPlan, present: int, levels: Sequence[float]) -> tuple[Sequence[float], Sequence[float]]:
    """Steps for levels to come; where each level is a curve, one that is the present one's stands for its end."""
    if not plan.phases:
        return levels, ()
    chosen = [level for place, level in enumerate(levels) if place == 0 or level != levels[place - 1]]
    begun: tuple[float, ...] = ()
    if chosen and chosen[0] == plan.levels[present] and plan.levels[present + 1 : present + 2] == (chosen[0],):
        del chosen[0]
        begun = plan.phases[present + 1 : present + 2]
    towards = begun or plan.phases[present : present + 1]
    amplitudes, phases = plan.kind.steps(chosen, backwards=towards[0] > 0.0)
    return ((plan.levels[present],) * len(begun)) + amplitudes, (*begun, *phases)


def with_repetition(plan: RunPlan, present: int, index: int) -> RunPlan:
    """The plan with a level once more, after the present one.

    Raises:
        BenchError: the plan has no room for it.
    """
    rest = slice(present + 1, None)
    repeated = {present + 1} if index in plan.levels_without else set()
    later = {place + 1 for place in plan.levels_without if place > present}
    changed = with_rest(
        plan,
        present,
        (plan.levels[index], *plan.levels[rest]),
        (*plan.frequencies_hz[index : index + 1], *plan.frequencies_hz[rest]),
        (*plan.phases[index : index + 1], *plan.phases[rest]),
    )
    return replace(changed, levels_without=changed.levels_without | repeated | later)
