"""Control of the force's harmonics on a made-up plant: latency, block length, a wrong force per volt, noise, limits."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from pll.harmonic_plant import CUTOFF, DISTURBANCE, FREQUENCY, RATE, HarmonicPlant, gain

from nmt_core.errors import BenchError
from nmt_pll.force_control.force_controller import ForceController, integral_rate, most_harmonics
from nmt_pll.force_control.force_per_volt import table_from_json
from nmt_pll.force_control.held_voltages import HeldVoltages
from nmt_pll.thresholds import HARMONICS

ALONE = float(np.linalg.norm(DISTURBANCE))
BLOCKS_MS = (10.0, 20.0, 40.0)
LATENCIES = (0, 1, 3)


def turned(degrees: float) -> complex:
    return cmath.rect(1.0, math.radians(degrees))


@pytest.mark.parametrize("block", [0.01, 0.02, 0.04])
@pytest.mark.parametrize("latency", LATENCIES)
def test_closed_form_has_the_margins_that_it_states(block, latency):
    dead = (1.5 + latency) * block
    rate = integral_rate(CUTOFF, dead)
    omega = np.geomspace(1e-3, 1e4, 400_000)
    loop = rate * np.exp(-1j * omega * dead) / (1j * omega * (1 + 1j * omega / CUTOFF))
    phase = np.unwrap(np.angle(loop))
    crossover = np.argmax(np.abs(loop) < 1.0)
    assert math.pi + phase[crossover] >= 0.5 * math.pi - HARMONICS.phase_margin_rad
    assert 1.0 / abs(loop[np.argmax(phase < -math.pi)]) >= math.pi / (2 * HARMONICS.phase_margin_rad)


@pytest.mark.parametrize("block_ms", BLOCKS_MS)
@pytest.mark.parametrize("latency", LATENCIES)
def test_harmonics_vanish_within_the_periods_that_latency_and_block_allow(block_ms, latency):
    plant = HarmonicPlant(block_ms, latency)
    periods = plant.run_to(0.05)
    # e^-3 of the integral, and once more the filter and the dead time
    time = 3.0 / plant.controller.rate + 1.0 / CUTOFF + plant.setup.dead_time
    assert periods < 1.6 * time * FREQUENCY
    assert periods < 40
    plant.run(20)
    assert plant.residual < 0.002
    assert plant.controller.settled.all()
    assert not plant.controller.given_up


@pytest.mark.parametrize("block_ms", BLOCKS_MS)
@pytest.mark.parametrize("latency", LATENCIES)
@pytest.mark.parametrize("factor", [turned(60), turned(-60), turned(150), turned(-150), 2.0, 0.5], ids=str)
def test_a_wrong_force_per_volt_is_put_right(block_ms, latency, factor):
    plant = HarmonicPlant(block_ms, latency, factor)
    assert plant.run_to(0.05) < 60
    # What was learnt: the correction undoes the error, where a harmonic was large enough to tell.
    told = np.abs(DISTURBANCE) > 0.04
    learnt = plant.known_gain[told] / plant.gains[told]
    if abs(cmath.phase(factor)) > math.radians(90):
        assert np.abs(np.angle(learnt)).max() < math.radians(45)
    assert not plant.controller.given_up


@pytest.mark.parametrize("factor", [1.0, turned(60), turned(150), 2.0], ids=str)
def test_amplitudes_that_come_up_slowly_do_not_mislead_it(factor):
    plant = HarmonicPlant(20.0, 1, factor, growth=1.5)
    plant.run_to(0.05)
    plant.run(60)
    assert plant.residual < 0.004
    assert not plant.controller.given_up
    if factor == 1.0:  # the right one is not spoilt by what the motion does to the force
        assert np.abs(plant.known_gain / plant.gains - 1.0).max() < 0.35


def test_what_nobody_knows_is_probed_one_harmonic_at_a_time():
    plant = HarmonicPlant(20.0, 1, factor=None)
    seen = set()
    while plant.periods < 6 or plant.controller.is_probing or np.isnan(plant.known_gain).any():
        plant.step()
        voltages = np.abs(plant.voltages)
        assert np.count_nonzero(voltages) <= 1
        assert voltages.max() <= 0.02 * plant.amplitude + 1e-12
        seen |= {int(index) for index in np.flatnonzero(voltages)}
        assert plant.periods < 200
    assert len(seen) == plant.controller.orders.size - 1
    assert np.abs(plant.known_gain / plant.gains - 1.0).max() < 0.05
    plant.run(60)
    assert plant.residual < 0.002


def test_noise_is_not_driven():
    """In noise as great as the smallest harmonics the residual is far below the noise in the filter's bandwidth."""
    noise = 0.05
    plant = HarmonicPlant(20.0, 0, noise=noise)
    plant.run(150)
    true = []
    for _ in range(400):
        plant.step()
        true.append(plant.force.copy())
    rms = np.sqrt(np.mean(np.abs(true) ** 2, axis=0))
    in_filter = noise * math.sqrt(2.0 * 2.0 * CUTOFF / RATE / 2.0)  # rms of a coefficient behind the filter
    assert rms.max() < 0.6 * in_filter
    assert np.abs(np.mean(true, axis=0)).max() < 0.003
    assert not plant.controller.given_up
    assert not plant.controller.obstacle


def test_a_harmonic_below_the_noise_counts_as_settled_and_is_left_alone():
    plant = HarmonicPlant(20.0, 0, noise=0.3)
    plant.run(150)
    small = int(np.argmin(np.abs(DISTURBANCE)))
    assert plant.controller.settled[0, small + 1]
    assert not plant.controller.given_up


def test_a_dead_harmonic_is_given_up_by_name_and_the_rest_goes_on():
    plant = HarmonicPlant(20.0, 1, dead=(5,))
    plant.run(400)
    assert list(plant.controller.given_up) == [(1, 5)]
    assert "does not follow" in plant.controller.given_up[1, 5] or "would need more" in plant.controller.given_up[1, 5]
    assert not plant.controller.obstacle
    others = np.delete(plant.force, 3)
    assert np.abs(others).max() < 0.002
    assert abs(plant.voltages[3]) < 1e-6
    assert "harmonic 5 given up" in plant.controller.summary


def test_what_was_given_up_stays_so_until_the_drive_has_been_at_rest():
    plant = HarmonicPlant(20.0, 1, dead=(5,))
    plant.run(400)
    plant.controller.start_level()
    assert list(plant.controller.given_up) == [(1, 5)]
    before = plant.voltages[3]
    plant.run(20)
    assert abs(plant.voltages[3]) <= abs(before)
    plant.controller.clear()
    assert not plant.controller.given_up
    plant.run(20)
    assert abs(plant.voltages[3]) > 1e-4


@pytest.mark.parametrize("limit", [1.0, 1.03, 1.05])
def test_the_voltage_limit_is_never_passed_and_what_it_stops_is_named(limit):
    plant = HarmonicPlant(20.0, 0, voltage_limit=limit)
    plant.run(400)
    assert plant.amplitude + plant.largest <= limit
    needed = np.abs(DISTURBANCE / plant.gains)
    assert needed.sum() > 0.98 * limit - 1.0
    assert plant.controller.given_up
    assert all("would need more than" in why for why in plant.controller.given_up.values())
    assert not plant.controller.obstacle
    kept = [k for k, n in enumerate(plant.controller.orders[1:]) if (1, n) not in plant.controller.given_up]
    assert np.abs(plant.force[kept]).max() < 0.004


def test_voltages_are_held_between_levels_and_zero_after_rest():
    plant = HarmonicPlant(20.0, 0)
    plant.run(60)
    held = plant.voltages.copy()
    plant.controller.start_level()
    assert (plant.voltages == held).all()
    assert [term[1:3] for term in plant.controller.drive_terms()] == list(zip(range(2, 10), held.tolist(), strict=True))
    plant.controller.off = True
    assert all(term.value == 0 for term in plant.controller.drive_terms())
    plant.controller.clear()
    assert (plant.voltages == 0).all()


def test_held_voltages_are_those_of_a_low_pass():
    """Against a fine numerical solution of v̇ = ω (u − v) with u along half-cosines, two blocks late."""
    block, steps = 0.02, 4000
    held = HeldVoltages((1,), CUTOFF, block, 2)
    commands = [0.0, 1.0 + 0.5j, -0.3, -0.3, 2j]
    filtered, state, previous = [], 0j, 0j
    for target in [0.0, 0.0, *commands[:-2]]:
        u = previous + (target - previous) * (0.5 - 0.5 * np.cos(np.pi * (np.arange(steps) + 0.5) / steps))
        for value in u:
            state += CUTOFF * block / steps * (value - state)
        previous = target
        filtered.append(state)
    got = [complex(held.advance(np.array([command], complex))[0]) for command in commands]
    assert got == pytest.approx(filtered, rel=5e-3, abs=1e-3)


def test_the_number_of_harmonics_stays_below_nyquist_and_within_the_filter():
    assert most_harmonics(22.2, 1e4, CUTOFF) == 15
    assert most_harmonics(22.2, 1e4, CUTOFF, 50) == 50
    assert most_harmonics(400.0, 1e4, 20.0, 50) == 12  # 13 x 400 Hz is beyond 5 kHz
    assert most_harmonics(400.0, 1e4, 377.0, 50) == 11  # the filter: 2 x 377/1e4 x 12.5 < 1


def test_force_per_volt_from_json():
    known = table_from_json("[[10, 1, 0], [20, 3, 2]]")
    values = known(np.array([9.0, 10.0, 15.0, 20.0, 21.0]))
    assert values[1:4, 0, 0] == pytest.approx([1, 2 + 1j, 3 + 2j])
    assert np.isnan(values[[0, 4]]).all()
    assert np.isnan(table_from_json("")(np.array([10.0, 20.0]))).all()
    for text in ("{}", "[[1, 2]]", '[[1, 2, "3"]]', "[1]", "nonsense", "[[1, 2, NaN]]"):
        with pytest.raises(BenchError):
            table_from_json(text)


def test_the_plant_of_these_tests_is_what_it_says():
    """Without control the harmonics are the disturbances, and a constant voltage moves them by the force per volt."""
    plant = HarmonicPlant(20.0, 0)
    while plant.periods < 10:
        plant.step(control=False)
    assert plant.residual == pytest.approx(ALONE)
    plant.voltages[1] = 0.01
    while plant.periods < 20:
        plant.step(control=False)
    assert plant.force[1] == pytest.approx(DISTURBANCE[1] + 0.01 * gain(3 * FREQUENCY))
    assert isinstance(plant.controller, ForceController)
