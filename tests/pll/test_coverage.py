"""What the loops say of every kind of test agrees with what they do."""

from __future__ import annotations

from dataclasses import replace

import pytest

from nmt_core.messages.driven_test import DrivenTest
from nmt_core.messages.records import LevelCommand
from nmt_core.vocabulary import ControlKind, LoopState, TestKind
from nmt_pll.coverage import covers, covers_linear
from nmt_pll.loop_core import LoopCore
from nmt_pll.pll_settings import PllSettings
from nmt_rig.linear_description import linear_description
from nmt_rig.rig import load_rig

DONE = [kind for kind in TestKind if kind not in (TestKind.UNKNOWN, TestKind.RECORD)]


def core(rig, loop):
    linear = linear_description(rig)
    return LoopCore(
        PllSettings(
            sample_rate=float(rig.sample_rate_hz),
            block_samples=rig.block_samples,
            linear_json=linear.to_json(),
            drive_point=rig.drive_point,
            exciters=len(rig.all_exciters),
            response_topic=rig.extraction.quantity,
            loop=loop,
        )
    )


@pytest.mark.parametrize("loop", ["adaptive", "paper"])
@pytest.mark.parametrize("name", ["beam", "frame"])
def test_a_kind_that_is_covered_has_a_loop_and_no_other_has(name, loop):
    rig = load_rig(name)
    loops = core(rig, loop)
    exciters = tuple(exciter.kind for exciter in rig.all_exciters)
    for kind in DONE:
        refusal = covers(DrivenTest(kind=kind, exciters=exciters), loop)
        assert bool(refusal) == (loops.refusal(kind) != ""), (kind, refusal)


def test_a_level_that_is_not_covered_is_answered_by_the_sentence():
    rig = load_rig("frame")
    loops, told = core(rig, "adaptive"), []
    loops._complain = lambda sentence, often: told.append(sentence)
    loops.take_level(LevelCommand(index=0, amplitude=1.0, apply_at_sample=0, ramp=0.1, sequence=1, test=TestKind.SWEEP))
    assert covers(DrivenTest(kind=TestKind.SWEEP, exciters=("", ""))) in told[0]
    assert loops.loop.machine.state is not LoopState.LOCKED


@pytest.mark.parametrize(
    ("changes", "ramps", "words"),
    [
        ({}, True, "the strategy ramp"),
        ({"kind": TestKind.RING_DOWN}, False, "ring-down"),
        ({"kind": TestKind.SELF_EXCITED}, False, "self-excited"),
        ({"kind": TestKind.SECONDARY_RESONANCE}, False, "secondary resonances"),
        ({"control": ControlKind.FORCE}, False, "levels of force"),
        ({"controlled_harmonics": 5}, False, "controlled harmonics"),
        ({"exciters": ("", "")}, False, "several exciters"),
    ],
)
def test_the_loop_of_the_paper_says_what_it_lacks(changes, ramps, words):
    test = replace(DrivenTest(), **changes)
    assert words in covers(test, "paper", ramps)
    assert covers(test, "adaptive", ramps) == ""
    assert covers(DrivenTest(), "paper") == ""


def test_a_rest_that_is_not_stable_is_refused_but_for_self_excited_tests():
    unstable = linear_description(load_rig("van_der_pol"))
    assert "use --kind self_excited" in covers_linear(DrivenTest(), unstable)
    assert covers_linear(DrivenTest(kind=TestKind.SELF_EXCITED), unstable) == ""
    assert covers_linear(DrivenTest(), linear_description(load_rig("beam"))) == ""
