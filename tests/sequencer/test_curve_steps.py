"""Steps of the phase lag along a response curve: equally long on a curve that is known, and what follows a loss."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.kinds import ResponseCurveTest
from nmt_core.messages.records import LoopStatus
from nmt_core.vocabulary import ControlKind, CurveParameter, LoopState
from nmt_sequencer.curve_steps import CurveStep, CurveSteps
from nmt_sequencer.level_plan import RunPlan
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
        phases.append(following.phase)


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


def test_at_a_held_response_a_step_is_halved_twice():
    steps = CurveSteps(KIND, holds_force=False)
    steps.add(1.0, 0.0, report(0.0))
    assert steps.after_loss(1.0, 0.2) == pytest.approx(0.1)
    assert steps.after_loss(1.0, 0.1) == pytest.approx(0.05)
    assert steps.after_loss(1.0, 0.05) is None


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


SECANT = replace(KIND, along=2)


def folding(place: float) -> tuple[float, float, float]:
    """Lag (rad), response per force and frequency (Hz) of a curve whose lag and frequency both turn back."""
    lag = 1.2 + 0.5 * math.sin(1.3 * place)
    return lag, math.exp(0.4 * place), 20.0 * math.exp(0.05 * math.sin(0.9 * place))


def at(lag_phase: float, place: float, index: int = 0) -> LoopStatus:
    """Report of a point of that curve while another phase was asked for."""
    lag, response, frequency = folding(place)
    error = lag_phase - (lag - 0.5 * math.pi)
    return report(0.0, lambda _: (response, frequency))._replace(level_index=index, phase_error=error)


def follow(steps: CurveSteps, places: list[float]) -> list[CurveStep]:
    """The steps after each point, with the points where they are foreseen."""
    found = []
    for index, place in enumerate(places):
        phase = found[-1].phase if len(found) else folding(place)[0] - 0.5 * math.pi
        if index == 1:
            phase = folding(place)[0] - 0.5 * math.pi
        steps.hear(at(phase, place, index))
        steps.add(1.0, phase, at(phase, place, index))
        step = steps.before(1.4)
        if index and step is not None:
            found.append(step)
    return found


def test_off_the_lag_what_is_held_follows_from_the_direction_of_the_curve():
    steps = follow(CurveSteps(SECANT), [0.2 * k for k in range(18)])
    assert [step.parameter for step in steps[:4]] == [CurveParameter.FREQUENCY] * 4
    falls = [step for step in steps if step.parameter is CurveParameter.SECANT]
    assert falls
    assert all(step.weight > 0.0 for step in falls if step.weight)  # the sign of the response along the curve
    assert any(step.weight for step in falls)
    for step, place in zip(steps, [0.2 * k for k in range(2, 20)], strict=False):
        lag, response, frequency = folding(place)
        assert step.response == pytest.approx(response, rel=0.1)
        assert step.frequency_hz == pytest.approx(frequency, rel=5e-3)
        assert step.phase + 0.5 * math.pi == pytest.approx(lag, abs=0.1)


def test_a_point_that_was_put_in_off_the_lag_keeps_what_it_is_held_by():
    steps = CurveSteps(SECANT)
    step = follow(steps, [0.0, 0.2, 0.4])[-1]
    assert steps.level_fields(1.0, step.phase) == step.level_fields
    assert steps.level_fields(1.0, 0.1)["parameter"] == CurveParameter.LAG


def test_a_loss_off_the_lag_begins_anew_from_the_last_point_with_shorter_steps():
    steps = CurveSteps(SECANT)
    lost = follow(steps, [0.0, 0.2, 0.4])[-1]
    again = steps.from_rest(1.0, lost.phase)
    assert again is not None
    assert steps.level_fields(1.0, again)["parameter"] == CurveParameter.FREQUENCY
    assert steps.level_fields(1.0, again)["frequency_hz"] == pytest.approx(folding(0.4)[2], rel=1e-6)
    steps.hear(at(again, 0.4, 9))
    steps.add(1.0, again, at(again, 0.4, 9))
    shorter = steps.before(1.4)
    assert shorter is not None
    assert abs(shorter.phase - again) < 0.6 * abs(lost.phase - again)
    assert steps.from_rest(2.0, lost.phase) is None


def test_a_lost_curve_is_followed_back_until_it_meets_the_points_before_its_loss():
    steps = CurveSteps(KIND)
    for phase in (-0.6, -0.45, -0.3):
        steps.add(1.0, phase, report(phase))
    assert steps.turns_back(1.0)
    assert not steps.turns_back(1.0)  # once a curve
    for phase in (0.6, 0.4, 0.2):
        steps.add(1.0, phase, report(phase))
        assert not steps.is_finished
    steps.add(1.0, -0.2, report(-0.2))
    assert steps.is_finished
