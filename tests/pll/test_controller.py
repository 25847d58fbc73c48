"""Frequency controller, gain schedule and amplitude controller."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nmt_pll.loop_settings import LoopSettings
from nmt_pll.phase_loop.controller import AmplitudeController, FrequencyController, GainSchedule
from nmt_pll.phase_loop.gains import ControllerGains, LoopPlant, closed_form_gains

GAINS = ControllerGains(2.0, 10.0)
STEP = 0.02
PLANT = LoopPlant(structure_decay=0.7, plant_decay=2.0, mass_ratio=0.1)
CUTOFF = 20.0


def test_output_is_proportional_plus_integral():
    controller = FrequencyController(100.0, 50.0, 150.0)
    errors = [0.1, -0.2, 0.3, 0.05]
    for error in errors:
        output = controller.update(error, GAINS, STEP)
    assert output == pytest.approx(100.0 + 10.0 * STEP * sum(errors) + 2.0 * errors[-1])
    assert controller.output == output
    assert not controller.at_bound


@pytest.mark.parametrize(("sign", "bound"), [(1, 150.0), (-1, 50.0)])
def test_leaves_a_bound_as_soon_as_the_error_changes_sign(sign, bound):
    controller = FrequencyController(100.0, 50.0, 150.0)
    for _ in range(10_000):
        controller.update(sign * 1.0, GAINS, STEP)
    assert controller.output == bound
    assert controller.at_bound
    output = controller.update(-sign * 1e-3, GAINS, STEP)
    assert sign * (bound - output) == pytest.approx(1e-3 * (10.0 * STEP + 2.0))
    assert not controller.at_bound


@given(st.lists(st.floats(-4.0, 4.0), max_size=60), st.floats(0.0, 500.0), st.floats(0.0, 5000.0))
def test_never_leaves_its_bounds(errors, proportional, integral):
    controller = FrequencyController(100.0, 50.0, 150.0)
    for error in errors:
        output = controller.update(error, ControllerGains(proportional, integral), STEP)
        assert 50.0 <= output <= 150.0
        assert 50.0 <= controller.integrator <= 150.0


def test_a_large_error_clips_the_output_without_moving_the_integrator_to_the_bound():
    controller = FrequencyController(100.0, 50.0, 150.0)
    assert controller.update(3.0, ControllerGains(100.0, 1.0), STEP) == 150.0
    assert controller.integrator == pytest.approx(100.06)
    assert not controller.at_bound


@pytest.mark.parametrize(("asked", "got"), [(120.0, 120.0), (10.0, 50.0), (1000.0, 150.0)])
def test_reset_stays_within_the_bounds(asked, got):
    controller = FrequencyController(100.0, 50.0, 150.0)
    controller.update(1.0, GAINS, STEP)
    controller.reset(asked)
    assert controller.output == controller.integrator == got


def test_schedule_in_the_linear_regime_is_the_closed_form():
    schedule = GainSchedule(PLANT, LoopSettings(imaginary_part=0.3), CUTOFF, 0.01)
    wanted = closed_form_gains(PLANT, CUTOFF, 0.3)
    assert schedule.gains(PLANT.structure_decay) == wanted
    assert schedule.gains(0.0) == wanted  # never below the linear damping


def test_schedule_with_friction_is_the_closed_form_of_the_present_damping():
    schedule = GainSchedule(PLANT, LoopSettings(), CUTOFF, 1e-3)
    present = LoopPlant(5.0, 2.0 + (5.0 - 0.7) * 1.1, 0.1)
    assert schedule.gains(5.0) == closed_form_gains(present, CUTOFF)


@given(st.floats(0.0, 200.0), st.floats(0.01, 200.0), st.floats(0.002, 0.2))
def test_bandwidth_stays_within_what_the_dead_time_allows(decay, plant_decay, dead_time):
    plant = replace(PLANT, plant_decay=max(plant_decay, PLANT.structure_decay))
    schedule = GainSchedule(plant, LoopSettings(delay_margin=0.25), CUTOFF, dead_time)
    gains = schedule.gains(decay)
    present = max(decay, plant.structure_decay)
    # Bandwidth of the loop: integral gain times the static phase slope (1 + μ)/δ_s.
    bandwidth = gains.integral * (1.0 + plant.mass_ratio) / present
    assert bandwidth > 0.0
    total = plant.plant_decay + (present - plant.structure_decay) * (1.0 + plant.mass_ratio)
    if (total + CUTOFF) / 3.0 > 0.25 / dead_time:
        assert bandwidth == pytest.approx(0.25 / dead_time)
        assert gains.integral / gains.proportional == pytest.approx(min(CUTOFF, total))  # the slower lag
    else:
        pole = (total + CUTOFF) / 3.0
        assert bandwidth == pytest.approx(pole**3 / (total * CUTOFF))


def test_fixed_gains_are_not_scheduled():
    schedule = GainSchedule(PLANT, LoopSettings(proportional=5.0, integral=10.0), CUTOFF, 0.03)
    assert schedule.gains(0.7) == schedule.gains(50.0) == ControllerGains(5.0, 10.0)


def test_amplitude_converges_exponentially_to_its_target():
    controller = AmplitudeController(bandwidth=3.0)
    voltage, gain = 0.8, 2.5
    for step in range(200):
        error = math.log(4.0 / (gain * voltage))
        if step == 0:
            first = error
        else:
            assert error == pytest.approx(first * (1 - 3.0 * STEP) ** step, rel=1e-6, abs=1e-12)
        voltage = controller.update(voltage, 4.0, gain * voltage, STEP)
    assert gain * voltage == pytest.approx(4.0, rel=1e-4)


def test_amplitude_moves_by_a_fifth_at_most():
    controller = AmplitudeController(bandwidth=100.0)
    assert controller.update(1.0, 1.0, 1e-9, STEP) == pytest.approx(math.exp(0.2))
    assert controller.update(1.0, 1.0, 1e9, STEP) == pytest.approx(math.exp(-0.2))


def test_amplitude_stops_at_the_limit():
    controller = AmplitudeController(bandwidth=3.0, limit=1.5)
    voltage = 1.0
    for _ in range(100):
        voltage = controller.update(voltage, 10.0, 0.1, STEP)
    assert voltage == 1.5
    assert controller.update(1.5, 1.0, 2.0, STEP) < 1.5


@pytest.mark.parametrize(("target", "measured"), [(1.0, 0.0), (0.0, 1.0), (1.0, -1.0)])
def test_amplitude_holds_without_a_measurement_or_a_target(target, measured):
    assert AmplitudeController(3.0).update(0.7, target, measured, STEP) == 0.7


@pytest.mark.parametrize("plant_decay", [0.8, 7.0, 300.0])
@given(decay=st.floats(0.0, 60.0))
def test_a_held_force_settles(plant_decay, decay):
    """Integral law on the voltage, force by (s + δ_s)/(s + δ_p) δ_p/δ_s behind the adaptive filter."""
    plant = replace(PLANT, plant_decay=plant_decay, mass_ratio=0.0)
    schedule = GainSchedule(plant, LoopSettings(), CUTOFF, 0.03)
    bandwidth = schedule.force_bandwidth(decay)
    assert 0.0 < bandwidth <= schedule.amplitude_bandwidth
    present = max(decay, plant.structure_decay)
    total = plant_decay + present - plant.structure_decay
    step = 2e-3
    voltage = state = filtered = 0.0
    history = [0.0] * 16  # dead time
    for _ in range(round(8.0 / bandwidth / step)):
        state += step * total * (voltage - state)
        force = state + (voltage - state) * total / present
        filtered += step * CUTOFF * (force - filtered)
        history.append(filtered)
        voltage += step * bandwidth * (1.0 - history[-16])
    assert max(history) < 1.6
    assert filtered == pytest.approx(1.0, abs=0.02)
