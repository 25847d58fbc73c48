"""Control laws of self-excited tests against the averaged motion, with the dead time of the loop."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import pytest

from nmt_core.errors import BenchError
from nmt_pll.self_excited.self_excited_control import AmplitudeLaw, SelfExcitedPlant
from nmt_pll.thresholds import SELF_EXCITED
from nmt_rig.linear_description import linear_description
from nmt_rig.rig import load_rig

STEP = 1e-3
PLANT = SelfExcitedPlant(125.0, 0.004, 5.0, 7.5, 0.03)


def averaged(law: AmplitudeLaw, decay, target: float, start: float, dead_time: float, seconds: float = 8.0):
    """Amplitudes of ȧ/a = -σ(a) + u a(t-τ)/a(t), the force in proportion to the amplitude that was measured τ ago."""
    a = start
    late = deque([start] * round(dead_time / STEP))
    history = []
    for _ in range(round(seconds / STEP)):
        late.append(a)
        measured = late.popleft()
        force = law.update(measured, target, STEP) * measured
        a = max(a + STEP * (-decay(a) * a + force), 1e-9)
        history.append(a)
        if a > 100.0:
            break
    return history


def subcritical(a: float) -> float:
    """σ, 1/s: unstable from 2, stable from 6."""
    return 125.0 * 7e-5 * (a * a - 4.0) * (a * a - 36.0)


def van_der_pol(a: float) -> float:
    """σ, 1/s: limit cycle at 5."""
    return -7.5 * (1.0 - a * a / 25.0)


@pytest.mark.parametrize("target", [1.0, 2.0, 3.3, 4.5, 6.0, 6.5])
def test_amplitudes_are_held_where_the_free_motion_is_stable_and_where_it_is_not(target: float) -> None:
    law = AmplitudeLaw(replace(PLANT, growth=-1.3))
    motion = averaged(law, subcritical, target, 0.7 * target, PLANT.dead_time)
    assert motion[-1] == pytest.approx(target, rel=1e-3)
    assert law.feedback == pytest.approx(subcritical(target), abs=0.02)


def test_without_the_proportional_part_only_stable_amplitudes_are_held() -> None:
    law = AmplitudeLaw(PLANT, proportional=False)
    assert averaged(law, van_der_pol, 4.5, 4.0, PLANT.dead_time)[-1] == pytest.approx(4.5, rel=1e-2)
    lost = averaged(AmplitudeLaw(PLANT, proportional=False), subcritical, 3.0, 3.05, PLANT.dead_time)
    assert abs(math.log(lost[-1] / 3.0)) > 0.3


def test_a_dead_time_as_long_as_the_growth_lets_the_motion_go() -> None:
    """What `holds_amplitude` decides: near rest van der Pol's motion is not held through a long dead time."""
    slow = replace(PLANT, dead_time=0.2)
    assert not slow.holds_amplitude
    assert replace(PLANT, growth=-1.0).holds_amplitude
    motion = averaged(AmplitudeLaw(slow), van_der_pol, 1.0, 0.9, slow.dead_time)
    assert max(motion[len(motion) // 2 :]) > 1.5


def test_damping_feedback_takes_the_motion_down_through_the_dead_time() -> None:
    a, late = 5.0, deque([5.0] * round(PLANT.dead_time / STEP))
    for _ in range(round(2.0 / STEP)):
        late.append(a)
        a = max(a + STEP * (-van_der_pol(a) * a + PLANT.damping_rate * late.popleft()), 1e-9)
    assert a < 0.05
    assert -SELF_EXCITED.largest_damping_rate <= PLANT.damping_rate * PLANT.dead_time <= -SELF_EXCITED.amplitude_rate


def test_the_plant_of_a_shaker_with_its_circuit() -> None:
    """Blocked force per volt G/R and decay by G²/R, by hand from the rig file of the belt."""
    plant = SelfExcitedPlant.of(linear_description(load_rig("belt")), 0.03)
    moving = 0.03
    assert plant.force_per_volt == pytest.approx(5.0 / 6.0, rel=2e-3)
    feeding = 10.0 / 0.15 * math.exp(-3.0)
    assert plant.growth == pytest.approx(-(5.5 - feeding + 25.0 / 6.0 + 0.5) / 2.0 / (1.0 + moving), rel=0.01)
    assert plant.rate_per_force == pytest.approx(1.0 / (2.0 * math.sqrt(15791.4) * (1.0 + moving)), rel=1e-3)


def test_a_description_without_force_per_volt_is_refused() -> None:
    linear = replace(linear_description(load_rig("van_der_pol")), force_per_volt=math.nan)
    with pytest.raises(BenchError, match="needs force per volt"):
        SelfExcitedPlant.of(linear, 0.03)
