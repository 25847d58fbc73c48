"""What the evaluations of recordings take of a test."""

from __future__ import annotations

from typing import Any

from nmt_core.errors import BenchError
from nmt_core.kinds import kind_class
from nmt_core.messages.driven_test import Covers, DrivenTest
from nmt_core.vocabulary import TestKind

_INSTEAD = {
    TestKind.RING_DOWN: "'./nmt extract' writes its free decays to decay.csv (from Python nmt_extract.free_decay)",
    TestKind.RANDOM: "'./nmt linear --bag' fits modes to it",
    TestKind.SWEEP: "'./nmt sweep' writes the responses of one to frf.csv while it measures",
    TestKind.STEPPED_SINE: "'./nmt sweep' writes the responses of one to frf.csv while it measures",
    TestKind.RECORD: "'./nmt diagnose' takes it as it is",
}


def covers(test: DrivenTest) -> str:
    """Why a test gives no modal points, and what to use instead; empty = it gives them."""
    if kind_class(test.kind).gives_modal_points:
        return ""
    return (
        f"A {kind_class(test.kind).words()} test gives no modal points, which come from tests of phase resonance and "
        f"their relatives; {_INSTEAD[test.kind]}."
    )


def refuse_other_tests(bag: Any, asked: Covers) -> None:
    """Refuse a recording by what its run was asked for, before a sample is read; one that does not say is taken.

    Raises:
        BenchError: with the sentence of ``asked``.
    """
    run = bag.run_start or {}
    plan = run.get("plan")
    if not isinstance(plan, dict) or "test" not in plan:
        return
    try:
        test = DrivenTest.of_run(run, None)
    except BenchError:  # a kind of a later release, whose windows are passed over
        return
    if refusal := asked(test):
        raise BenchError(f"The bag {bag.path} cannot be evaluated so: {refusal}")
