"""What the report of a run, and the figures of that report, take: tests whose windows give modal points."""

from __future__ import annotations

from nmt_core.kinds import kind_class
from nmt_core.messages.driven_test import DrivenTest


def covers(test: DrivenTest) -> str:
    """What a report does not take of a test, and what to use instead; empty = it takes it."""
    kind = kind_class(test.kind)
    if kind.gives_modal_points:
        return ""
    instead = "say in the sidecar what drove it"
    if kind.is_broad_band:
        instead = "'./nmt linear RIG --bag BAG' writes a report with figures"
    elif kind.needs_frequencies:
        instead = "'./nmt sweep' writes a report with figures"
    elif kind.closes_phase_loop:
        instead = "'./nmt extract BAG' writes its decays to decay.csv"
    words = test.words
    return f"{words[0].upper()}{words[1:]} gives no modal points, which the report of a run shows; {instead}."
