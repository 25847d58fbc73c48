"""What the evaluation of windows takes of a test."""

from __future__ import annotations

from typing import Any

from nmt_core.errors import BenchError
from nmt_core.kinds import kind_class
from nmt_core.messages.driven_test import Covers, DrivenTest
from nmt_core.vocabulary import TestKind


def covers(test: DrivenTest) -> str:
    """What the judgement and evaluation of a window, live and from a bag, does not take of a test; empty = it takes it.

    Windows of phase resonance with one exciter or several, of secondary resonances and of self-excited structures are
    evaluated, whatever drives them and whether harmonics of the force are controlled.
    """
    kind = kind_class(test.kind)
    if kind.gives_modal_points:
        return ""
    if test.kind is TestKind.RING_DOWN:
        return f"Windows of {test.words} give free decays and no modal points; './nmt extract' writes decay.csv."
    instead = "compare it with a model by './nmt diagnose'"
    if kind.is_broad_band:
        instead = "evaluate it with './nmt linear'"
    elif kind.sweeps:
        instead = "'./nmt sweep' writes its responses to frf.csv while it measures"
    return f"Windows of {test.words} give no modal points, which come from phase resonance tests; {instead}."


def refuse_other_tests(bag: Any, asked: Covers) -> None:
    """Refuse a recording by what its run was asked for, before a sample is read; one that does not say is taken.

    Raises:
        BenchError: with the sentence of ``asked``.
    """
    run = bag.run_start or {}
    plan = run.get("plan")
    if isinstance(plan, dict) and "test" in plan and (refusal := asked(DrivenTest.of_run(run, None))):
        raise BenchError(f"The bag {bag.path} cannot be evaluated so: {refusal}")
