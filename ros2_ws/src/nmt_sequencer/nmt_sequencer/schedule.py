"""What becomes of the levels of a plan while it runs: they stay, are put in where the backbone bends, or along a curve.

A schedule knows nothing of ticks, orders and loops: it hears the loop's reports, and is asked what follows a level.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import singledispatch
from typing import Any

from nmt_core.kinds import KindOfTest, PhaseResonanceTest, ResponseCurveTest
from nmt_core.messages.records import LoopStatus
from nmt_core.vocabulary import ControlKind
from nmt_sequencer.curve_steps import CurveSteps
from nmt_sequencer.refinement import LevelRefinement


@dataclass(frozen=True, slots=True)
class Steps:
    """Levels in their order.

    Attributes:
        levels: amplitudes.
        phases: phase of each by which the held force leads the velocity, rad; empty = phase resonance.
    """

    levels: tuple[float, ...]
    phases: tuple[float, ...] = ()

    def preceded_by(self, level: float, phase: float) -> Steps:
        """These after one with a held phase."""
        return Steps((level, *self.levels), (phase, *self.phases))

    @property
    def without_first(self) -> Steps:
        """All but the first."""
        return Steps(self.levels[1:], self.phases[1:])


class Schedule:
    """The plan as it stands."""

    def hear(self, report: LoopStatus) -> None:
        """Take a report of the present level while it is locked."""

    def following(self, done: Steps, locked: bool, planned: Steps, report: LoopStatus) -> Steps | None:
        """Levels to follow a level instead of the plan's.

        Args:
            done: the level that has ended, alone.
            locked: whether its window is complete.
            planned: what the plan has after it.
            report: the newest one.

        Returns:
            The levels; None = go on with the plan.
        """
        del done, locked, planned, report
        return None

    def level_fields(self, level: float, phase: float) -> dict[str, Any]:
        """Fields of ``nmt_msgs/Level`` of a level with a held phase (rad)."""
        del level
        return {"held_phase": phase}


class RefinedSchedule(Schedule):
    """Levels put in where the backbone bends.

    Args:
        refinement: the step control.
    """

    def __init__(self, refinement: LevelRefinement) -> None:
        self._refinement = refinement

    def following(self, done: Steps, locked: bool, planned: Steps, report: LoopStatus) -> Steps | None:
        """See :meth:`Schedule.following`."""
        (amplitude,) = done.levels
        levels = planned.levels
        if locked:
            self._refinement.add(amplitude, report.frequency_hz)
            level = self._refinement.before(levels[0]) if levels else None
        else:
            level = self._refinement.after_loss(amplitude)
            levels = (amplitude, *levels)
        return None if level is None else Steps((level, *levels))


class CurveSchedule(Schedule):
    """Points put in along response curves.

    Args:
        curve: the step control.
    """

    def __init__(self, curve: CurveSteps) -> None:
        self._curve = curve

    def hear(self, report: LoopStatus) -> None:
        """See :meth:`Schedule.hear`."""
        self._curve.hear(report)

    def level_fields(self, level: float, phase: float) -> dict[str, Any]:
        """See :meth:`Schedule.level_fields`."""
        return self._curve.level_fields(level, phase)

    def following(self, done: Steps, locked: bool, planned: Steps, report: LoopStatus) -> Steps | None:
        """See :meth:`Schedule.following`."""
        (level,), (phase,) = done.levels, done.phases
        follows = bool(planned.levels) and planned.levels[0] == level
        if not locked:
            return self._after_loss(level, phase, planned, follows)
        self._curve.add(level, phase, report)
        step = self._curve.before(planned.phases[0]) if follows else None
        if self._curve.is_finished and follows:  # the point of the plan lies where there is one
            return planned.without_first
        return None if step is None else planned.preceded_by(level, step.phase)

    def _after_loss(self, level: float, lost: float, planned: Steps, follows: bool) -> Steps | None:
        curve = self._curve
        if follows and curve.begins_at_other_end(level):
            return planned.without_first.preceded_by(level, lost).preceded_by(planned.levels[0], planned.phases[0])
        phase = curve.after_loss(level, lost)
        if phase is None:
            phase = curve.from_rest(level, lost)
        if phase is not None:  # the end of the curve is tried again
            return (planned if follows else planned.preceded_by(level, lost)).preceded_by(level, phase)
        if follows and curve.turns_back(level):
            return planned.without_first.preceded_by(planned.levels[0], lost).preceded_by(
                planned.levels[0], planned.phases[0]
            )
        return planned.without_first if follows and curve.is_given_up else None


@singledispatch
def schedule_of(kind: KindOfTest, levels: Sequence[float], control: int) -> Schedule:
    """The schedule of a kind of test; one that puts levels in is registered for its class.

    Args:
        kind: the test.
        levels: of the plan.
        control: what they are, a `ControlKind`.
    """
    del kind, levels, control
    return Schedule()


@schedule_of.register
def _(kind: PhaseResonanceTest, levels: Sequence[float], control: int) -> Schedule:
    del control
    return RefinedSchedule(LevelRefinement(kind.refinement, levels)) if kind.refinement else Schedule()


@schedule_of.register
def _(kind: ResponseCurveTest, levels: Sequence[float], control: int) -> Schedule:
    del levels
    return CurveSchedule(CurveSteps(kind, control == ControlKind.FORCE))
