"""Steps of the phase lag along a response curve: equally long on a curve that is known, and what follows a loss."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.kinds import ResponseCurveTest
from nmt_core.messages.records import LoopStatus
from nmt_core.vocabulary import ControlKind, LoopState
from nmt_sequencer.curve_steps import CurveSteps
from nmt_sequencer.run_machine import RunPlan
from nmt_sequencer.steering import with_repetition, with_rest

KIND = ResponseCurveTest(lag_from=math.radians(10.0), lag_to=math.radians(170.0), spacing=0.2)
OMEGA, ZETA = 120.0, 0.01


def hardening(lag: float, cubic: float = 0.3) -> tuple[float, float]:
    """Response per force and frequency (Hz) of a mode whose frequency grows with the square of its amplitude."""
    amplitude = math.sin(lag)
    omega = OMEGA * (1.0 + cubic * amplitude**2) - ZETA * OMEGA / math.tan(lag)
    return amplitude, omega / (2.0 * math.pi)


def report(phase: float, curve=hardening) -> LoopStatus:
    response, frequency = curve(phase + 0.5 * math.pi)
    return LoopStatus(0, 0, 0, int(LoopState.LOCKED), frequency, 0.0, 1.0, response, "m", 1.0)


def walk(steps: CurveSteps, first: float, last: float, level: float = 1.0) -> list[float]:
    phases = [first]
    while True:
        steps.add(level, phases[-1], report(phases[-1]))
        following = steps.before(last)
        if following is None:
            return [*phases, last]
        phases.append(following)


@pytest.mark.parametrize("backwards", [False, True])
def test_neighbours_are_equally_far_apart_along_the_curve(backwards):
    ends = (KIND.lag_from - 0.5 * math.pi, KIND.lag_to - 0.5 * math.pi)
    phases = walk(CurveSteps(KIND), *(ends[::-1] if backwards else ends))
    places = []
    for phase in phases:
        response, frequency = hardening(phase + 0.5 * math.pi)
        places.append((phase, math.log(response), KIND.FREQUENCY_WEIGHT * math.log(frequency)))
    lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
    away = np.abs(lengths[2:-1] / 0.2 - 1.0)
    assert np.quantile(away, 0.85) < 0.15
    assert away.max() < 0.9  # at the tip, where the curve turns within a step
    assert np.median(lengths) == pytest.approx(0.2, rel=0.1)


def test_the_frequency_of_the_next_point_is_foreseen_by_a_parabola():
    steps = CurveSteps(KIND)
    assert steps.foreseen(1.0, 0.1) == 0.0
    for phase in (-0.4, -0.3, -0.2):
        steps.add(1.0, phase, report(phase))
    assert steps.foreseen(1.0, -0.1) == pytest.approx(hardening(-0.1 + 0.5 * math.pi)[1], rel=2e-3)
    assert steps.foreseen(2.0, -0.1) == 0.0  # another curve


def test_a_lost_point_is_tried_half_way_once():
    steps = CurveSteps(KIND)
    steps.add(1.0, 0.0, report(0.0))
    assert steps.after_loss(1.0, 0.2) == pytest.approx(0.1)
    assert steps.after_loss(1.0, 0.2) is None
    assert steps.after_loss(1.0, 1e-4) is None  # too near to be cut


def test_a_curve_whose_first_end_is_lost_begins_at_the_other_once():
    steps = CurveSteps(KIND)
    assert steps.begins_at_other_end(1.0)
    assert not steps.begins_at_other_end(1.0)
    assert steps.begins_at_other_end(2.0)


def curve_plan(*forces: float) -> RunPlan:
    return RunPlan(run_id="curve", levels=forces, control=ControlKind.FORCE, kind=KIND)


def degrees(plan: RunPlan) -> list[int]:
    """Lags of the steps."""
    return [round(math.degrees(phase)) + 90 for phase in plan.phases]


def test_a_plan_goes_along_each_curve_there_and_back():
    plan = curve_plan(1.0, 2.0, 3.0)
    assert plan.levels == (1.0, 1.0, 2.0, 2.0, 3.0, 3.0)
    assert degrees(plan) == [10, 170, 170, 10, 10, 170]


def test_new_levels_follow_the_rest_of_the_present_curve():
    plan = curve_plan(1.0, 2.0)
    changed = with_rest(plan, 0, (1.0, 3.0), ())
    assert changed.levels == (1.0, 1.0, 3.0, 3.0)
    assert degrees(changed) == [10, 170, 170, 10]
    assert with_rest(plan, 0, (3.0,), ()).levels == (1.0, 3.0, 3.0)  # the present curve is given up


def test_a_repeated_point_has_its_lag_again():
    plan = with_repetition(curve_plan(1.0), 0, 0)
    assert plan.levels == (1.0, 1.0, 1.0)
    assert degrees(plan) == [10, 10, 170]


def test_a_comparison_without_controlled_harmonics_is_refused():
    with pytest.raises(BenchError, match="leave out --compare"):
        RunPlan(levels=(1.0,), control=ControlKind.FORCE, kind=KIND, levels_without=frozenset({0}))
