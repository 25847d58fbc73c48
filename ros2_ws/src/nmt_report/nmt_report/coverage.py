"""What the report of a run, and the figures of that report, take: tests whose windows give modal points."""

from __future__ import annotations

from nmt_core.kinds import kind_class
from nmt_core.messages.driven_test import DrivenTest
from nmt_core.vocabulary import TestKind

_INSTEAD = {
    TestKind.RANDOM: "'./nmt linear RIG --bag BAG' writes a report with figures",
    TestKind.SWEEP: "'./nmt sweep' writes a report with figures",
    TestKind.STEPPED_SINE: "'./nmt sweep' writes a report with figures",
    TestKind.RING_DOWN: "'./nmt extract BAG' writes its decays to decay.csv",
}


def covers(test: DrivenTest) -> str:
    """What a report does not take of a test, and what to use instead; empty = it takes it."""
    if kind_class(test.kind).gives_modal_points:
        return ""
    instead = _INSTEAD.get(test.kind, "say in the sidecar what drove it")
    words = test.words
    return f"{words[0].upper()}{words[1:]} gives no modal points, which the report of a run shows; {instead}."
