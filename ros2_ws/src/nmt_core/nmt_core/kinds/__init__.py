"""Kinds of test: a class for each, with its settings, what applies to it, and what it refuses.

Messages and recordings have the number of a kind (:class:`nmt_core.vocabulary.TestKind`); `kind_class` is its class.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from nmt_core.kinds.given_frequency import SteppedSineTest, SweepTest
from nmt_core.kinds.kind_of_test import KindOfTest, refuse_foreign
from nmt_core.kinds.phase_resonance import MOST_HARMONICS, STRATEGIES, PhaseResonanceTest, RingDownTest
from nmt_core.kinds.random import PEAK_FACTOR, RandomTest
from nmt_core.kinds.record import RecordedTest
from nmt_core.kinds.response_curve import FLOQUET_PERIODS, ResponseCurveTest
from nmt_core.kinds.secondary_resonance import SecondaryResonanceTest
from nmt_core.kinds.self_excited import METHODS, SelfExcitedTest
from nmt_core.vocabulary import TestKind

__all__ = [
    "FLOQUET_PERIODS",
    "GOAL_FIELDS",
    "KINDS",
    "METHODS",
    "MOST_HARMONICS",
    "PEAK_FACTOR",
    "STRATEGIES",
    "KindOfTest",
    "PhaseResonanceTest",
    "RandomTest",
    "RecordedTest",
    "ResponseCurveTest",
    "RingDownTest",
    "SecondaryResonanceTest",
    "SelfExcitedTest",
    "SteppedSineTest",
    "SweepTest",
    "goal_fields",
    "kind_class",
    "kind_named",
    "kind_of_goal",
]

KINDS: dict[TestKind, type[KindOfTest]] = {
    kind.NUMBER: kind
    for kind in (
        PhaseResonanceTest,
        RandomTest,
        SweepTest,
        SteppedSineTest,
        RingDownTest,
        RecordedTest,
        SelfExcitedTest,
        SecondaryResonanceTest,
        ResponseCurveTest,
    )
}
"""Every kind by its number."""


def _zeros() -> dict[str, Any]:
    kinds = KINDS.values()
    return {name: type(getattr(kind, name))() for kind in kinds for name in kind.travelling("level", "goal")}


GOAL_FIELDS = _zeros()
"""Settings of all kinds as the goal of a run has them, each zero."""


def kind_class(number: TestKind | int) -> type[KindOfTest]:
    """Class of a message's number; UNKNOWN, as recorded by benches that knew one kind, is PHASE_RESONANCE.

    Raises:
        BenchError: no such kind.
    """
    return KINDS[TestKind.of(int(number))]


def kind_named(name: str) -> type[KindOfTest]:
    """Class of a kind that the bench does, by its name in small letters.

    Raises:
        BenchError: no such kind.
    """
    return KINDS[TestKind.named(name)]


def kind_of_goal(goal: Mapping[str, Any]) -> KindOfTest:
    """The kind with its settings, from the flat fields of an action goal; what is not there has its default.

    Raises:
        BenchError: no such kind of test, or a setting of another kind.
    """
    kind = kind_class(goal["test"])
    refuse_foreign(kind, goal, tuple(GOAL_FIELDS))
    names = [name for name in kind.travelling("level", "goal") if name in goal]
    return kind(**{name: type(GOAL_FIELDS[name])(goal[name]) for name in names})


def goal_fields(kind: KindOfTest) -> dict[str, Any]:
    """Flat fields of the action goal: the kind's number, its settings, and zeros for those of other kinds."""
    names = kind.travelling("level", "goal")
    return {**GOAL_FIELDS, **{name: getattr(kind, name) for name in names}, "test": int(kind.NUMBER)}
