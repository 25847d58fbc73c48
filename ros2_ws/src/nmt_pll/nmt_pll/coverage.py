"""What the loops take of a test: its kind, its exciters, its controlled harmonics, its levels."""

from __future__ import annotations

from nmt_core.kinds import kind_class
from nmt_core.messages.driven_test import DrivenTest
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.vocabulary import ControlKind, TestKind

ADAPTIVE, PAPER = "adaptive", "paper"
"""Names of the loops of phase resonance."""


def covers(test: DrivenTest, loop: str = ADAPTIVE, ramps: bool = False) -> str:
    """What the loops do not take of a test, and what to use instead; empty = they take it.

    Args:
        test: the test.
        loop: of phase resonance, ``adaptive`` or ``paper``.
        ramps: whether windows lie in slow ramps from level to level.
    """
    if test.kind is TestKind.RECORD:
        return "The bench does no test of the kind record, which is imported data; choose another --kind."
    kind = kind_class(test.kind)
    if test.has_several_exciters and kind.one_exciter:
        return (
            f"{kind.one_exciter} one exciter, and this rig has {len(test.exciters)}; choose one by its point "
            "with --exciter N, which takes the others off the rig."
        )
    if test.kind is TestKind.SELF_EXCITED and "shaking_table" in test.exciters:
        return (
            "A self-excited motion is held and damped by a force at a point, and a shaking table moves the supports; "
            "use an exciter of the kind force or electrodynamic_shaker."
        )
    return _paper_covers(test, ramps) if loop == PAPER else ""


def _paper_covers(test: DrivenTest, ramps: bool) -> str:
    """The same for the paper's loop, which takes the place of those that close the phase."""
    kind = kind_class(test.kind)
    if not kind.closes_phase_loop:
        return ""
    lacks = kind.beyond_paper_loop
    for asked, does, what in (
        (ramps, "waits at every level", "the strategy ramp"),
        (bool(lacks), *(lacks or ("", ""))),
        (test.control != ControlKind.VOLTAGE, "steps the voltage only", f"levels of {test.control.label}"),
        (test.controlled_harmonics > 0, "leaves the force's harmonics as they are", "controlled harmonics"),
        (test.has_several_exciters, "drives one exciter", "several exciters"),
    ):
        if asked:
            return f"The paper's loop {does}; use the adaptive loop for {what}."
    return ""


def covers_linear(test: DrivenTest, linear: LinearDescription) -> str:
    """What keeps a test from a rig with these modes: a rest that is unstable; empty = nothing.

    Args:
        test: the test.
        linear: modes of the rig, as a linear test or its model has them.
    """
    if test.kind is TestKind.SELF_EXCITED:
        return ""
    worst = min(linear.damping_ratios)
    mode = f"mode {linear.damping_ratios.index(worst) + 1}"
    if worst > 0.0:
        worst, mode = linear.plant_damping_ratio, "the target mode with its exciter"
    if worst > 0.0:
        return ""
    words = kind_class(test.kind).words()
    return (
        f"The rig's rest is not stable: the damping ratio of {mode} is {100.0 * worst:.3g} %, so a motion grows "
        f"without a drive, and a {words} test measures that motion; use --kind self_excited."
    )
