"""What the diagnosis takes of recorded tests: what its model can predict."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from nmt_core.errors import BenchError
from nmt_core.messages.driven_test import DrivenTest
from nmt_core.vocabulary import TestKind
from nmt_rig.rig import Rig

if TYPE_CHECKING:
    from nmt_diagnose.measurements.measurement import Measurement

_NOT_PREDICTED = {
    TestKind.SWEEP: "a swept response is not a steady state",
    TestKind.SECONDARY_RESONANCE: "its model follows resonances at the frequency of the drive",
    TestKind.SELF_EXCITED: "its model follows motions that a drive holds or that decay",
}


class NotCoveredError(BenchError):
    """A recording holds no test that the diagnosis takes."""


def covers(test: DrivenTest) -> str:
    """What the diagnosis does not take of a test, and what to use instead; empty = it takes it."""
    if test.kind in _NOT_PREDICTED:
        return (
            f"The diagnosis takes no part of {test.words}, as {_NOT_PREDICTED[test.kind]}; use windows at phase "
            "resonance or stepped sines near resonance."
        )
    if test.has_several_exciters and test.kind is TestKind.RESPONSE_CURVE:
        return (
            f"The diagnosis takes no part of {test.words}, as its model has one force at every line; use windows at "
            "phase resonance, random tests or ring-downs."
        )
    if test.has_several_exciters and test.kind is TestKind.RECORD:
        return (
            f"The diagnosis takes no part of {test.words}, as its model drives a record by one input; use windows at "
            "phase resonance, random tests or ring-downs."
        )
    return ""


def refuse_unbalanced(model: Rig, tests: Sequence[Measurement]) -> None:
    """Refuse what is predicted as periodic where an element of the model is only stepped through records.

    Raises:
        BenchError: a test is not a record and the model has such an element.
    """
    kinds = [section.kind_name() for section in model.local_elements if section.without_harmonic_balance]
    others = [test for test in tests if test.record is None]
    if kinds and others:
        raise BenchError(
            f"{others[0].name} is a {others[0].WORDS}, and the diagnosis' model balances no {kinds[0]} over a period; "
            "give records, or leave the element out of the model."
        )
