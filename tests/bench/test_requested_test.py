"""Tests that are asked for are values: checked as such, kept in JSON, and carried out by a command that means them."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest

from nmt_bench.cli import build_parser
from nmt_bench.commands.requested_test import command_text, command_words, levels_text
from nmt_core.errors import BenchError
from nmt_core.kinds import (
    FLOQUET_PERIODS,
    PhaseResonanceTest,
    RandomTest,
    ResponseCurveTest,
    RingDownTest,
    SelfExcitedTest,
    SteppedSineTest,
)
from nmt_core.kinds.request import PlacedSensor, TestRequest
from nmt_core.vocabulary import ControlKind
from nmt_rig.rig import load_rig
from nmt_sequencer.level_plan import parse_levels
from nmt_session.planning import kind_of_rig

RUNS = [
    TestRequest(rig="beam", levels=(0.1, 0.25, 0.7), exciters=(4,), periods=40, name="point4"),
    TestRequest(rig="beam", levels=(0.1, 0.2, 0.4), changes=(("test.mode", 2),), direction="both"),
    TestRequest(rig="beam", kind=PhaseResonanceTest(refinement=1e-3, harmonics_control=5), control=ControlKind.FORCE),
    TestRequest(rig="beam", kind=PhaseResonanceTest(harmonics_control=1, harmonics_target=1, strategy="ramp")),
    TestRequest(rig="beam", levels=(1.0,), kind=ResponseCurveTest(spacing=0.3, along=2, release=1e-3)),
    TestRequest(rig="beam", levels=(1.0,), kind=ResponseCurveTest(perturbation=0.01), periods=FLOQUET_PERIODS),
    TestRequest(rig="belt", levels=(1e-3,), kind=SelfExcitedTest(method="envelope", duration=3.0)),
]
OTHERS = [
    TestRequest(rig="beam", kind=RandomTest(duration=20.0), levels=(0.05,)),
    TestRequest(kind=RingDownTest(duration=2.0), levels=(0.5,), sensors=(PlacedSensor("displacement", 3, "x4"),)),
    TestRequest(rig="beam", kind=SteppedSineTest(), levels=(0.5, 0.5), frequencies_hz=(19.0, 20.0)),
]


def parsed(request: TestRequest) -> Any:
    words = command_words(request)
    return build_parser(words[0]).parse_args(words)


@pytest.mark.parametrize("request_", RUNS)
def test_the_command_of_a_run_means_what_is_asked(request_: TestRequest) -> None:
    """Read by the command's own parser."""
    found = parsed(request_)
    names = ("harmonics_control", "harmonics_target", "spacing", "along", "release", "method", "duration", "floquet")
    settings = {name: getattr(found, name) or None for name in (*names, "strategy")}
    kind = kind_of_rig(found.kind, load_rig(found.rig), {**settings, "refinement": found.refine, "lag_deg": found.lag})
    assert kind == request_.kind
    levels = () if found.levels is None else tuple(parse_levels(found.levels))
    assert levels == pytest.approx(request_.levels)
    assert (found.exciter,) == (request_.exciters or (None,))
    assert tuple(found.set) == tuple(f"{key}={value}" for key, value in request_.changes)
    assert found.direction == request_.direction
    assert found.periods == (request_.periods or None)
    assert ControlKind.named(found.control or kind.CONTROL.label) is request_.control


def test_a_random_test_is_that_of_the_linear_command() -> None:
    found = parsed(OTHERS[0])
    assert (found.rig, found.duration, found.level) == ("beam", 20.0, 0.05)
    assert (
        command_text(TestRequest(rig="a b.yaml", kind=RandomTest(), name="low")) == "./nmt linear 'a b.yaml' --out low"
    )


@pytest.mark.parametrize("request_", [*OTHERS[1:], replace(RUNS[0], rig=""), replace(RUNS[0], exciters=(1, 2))])
def test_what_no_command_does_has_no_command(request_: TestRequest) -> None:
    assert command_text(request_) == ""
    with pytest.raises(BenchError, match=r"command|rig"):
        command_words(request_)


@pytest.mark.parametrize("request_", [*RUNS, *OTHERS])
def test_a_request_is_read_as_it_was_written(request_: TestRequest) -> None:
    assert TestRequest.from_mapping(json.loads(json.dumps(request_.to_mapping()))) == request_


@pytest.mark.parametrize("request_", [it for it in (*RUNS, *OTHERS) if it.levels])
def test_what_a_bench_can_do_is_not_refused(request_: TestRequest) -> None:
    request_.check(5000.0)


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"levels": (0.1, -0.2)}, "not positive and finite"),
        ({"exciters": (4, 4)}, "points count from 1, one each"),
        ({"sensors": (PlacedSensor("displacement", 0),)}, "points count from 1"),
        ({"periods": -1}, "give a positive number"),
        ({"kind": RingDownTest()}, "needs a duration"),
        ({"kind": ResponseCurveTest(), "exciters": (1, 2), "control": ControlKind.FORCE}, "one exciter, got 2"),
        ({"kind": SteppedSineTest(), "frequencies_hz": (3000.0,)}, "half the sample rate"),
    ],
)
def test_a_request_is_refused_as_a_value(changed: dict[str, Any], sentence: str) -> None:
    with pytest.raises(BenchError, match=sentence):
        replace(RUNS[0], **changed).check(5000.0)


def test_levels_are_written_by_their_ends_where_they_say_it_all() -> None:
    assert levels_text((0.1, 0.2, 0.4, 0.8)) == "0.1:0.8:4"
    assert levels_text((0.1, 0.2, 0.3)) == "0.1,0.2,0.3"
    assert levels_text((0.1, 0.2)) == "0.1,0.2"
