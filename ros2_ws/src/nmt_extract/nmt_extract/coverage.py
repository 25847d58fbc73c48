"""What the evaluation of windows takes of a test."""

from __future__ import annotations

from nmt_core.kinds import kind_class
from nmt_core.messages.driven_test import DrivenTest


def covers(test: DrivenTest) -> str:
    """What the judgement and evaluation of a window, live and from a bag, does not take of a test; empty = it takes it.

    Windows of phase resonance with one exciter or several, of secondary resonances and of self-excited structures are
    evaluated, whatever drives them and whether harmonics of the force are controlled.
    """
    kind = kind_class(test.kind)
    if kind.gives_modal_points:
        return ""
    instead = "evaluate it with './nmt linear'" if kind.is_noise else "compare it with a model by './nmt diagnose'"
    return f"Windows of {test.words} give no modal points, which come from phase resonance tests; {instead}."
