"""The force controller on an envelope model of exciter and structure: estimate of the exciter, poles of the loop."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest

from nmt_pll.amplitude.held_amplitude import ExciterEstimate, ForceHolder, ResponseHolder, VoltageRecord
from nmt_pll.thresholds import AMPLITUDE

BLOCK = 0.02  # s
CUTOFF = 350.0  # rad/s
BLOCKED, STIFFNESS = 5.0 * cmath.exp(-0.1j), 0.034 - 0.047j  # N/V and N/(m/s²), as the joint resonator's exciter
DRIVE = 0.25  # 1/kg, φ² at the drive point
OMEGA = 2.0 * math.pi * 368.6


class Envelope:
    """Slowly varying amplitudes of one mode behind an exciter: a' = −(δ + iΔ) a + ½ i Ω φ² F, F = P u − Z a.

    State: a, then force and response as the adaptive filter sees them; exact over a block with constant coefficients.
    """

    def __init__(self, decay: float, detuning: float) -> None:
        self.pole = decay + 1j * detuning
        self.gain = 0.5j * OMEGA * DRIVE
        self.steps = 40

    def block(self, state: np.ndarray, start: float, target: float) -> np.ndarray:
        a, force, response = state
        dt = BLOCK / self.steps
        total = self.pole + self.gain * STIFFNESS
        keep, pass_on = cmath.exp(-total * dt), math.exp(-CUTOFF * dt)
        for k in range(self.steps):
            u = start + (target - start) * (0.5 - 0.5 * math.cos(math.pi * (k + 0.5) / self.steps))
            a = keep * a + (1.0 - keep) / total * self.gain * BLOCKED * u
            f = BLOCKED * u - STIFFNESS * a
            force = pass_on * force + (1.0 - pass_on) * f
            response = pass_on * response + (1.0 - pass_on) * a
        return np.array([a, force, response])

    def steady(self, u: float) -> np.ndarray:
        a = self.gain * BLOCKED * u / (self.pole + self.gain * STIFFNESS)
        return np.array([a, BLOCKED * u - STIFFNESS * a, a])


def closed_loop_radius(decay: float, detuning: float, stiffness: complex, latency: int = 0) -> float:
    """Largest modulus of the poles of the sampled loop, linearised at its equilibrium."""
    plant = Envelope(decay, detuning)
    holder = ForceHolder(CUTOFF, BLOCK, latency)
    holder.exciter.force_per_volt, holder.exciter.stiffness = BLOCKED, stiffness
    equilibrium = plant.steady(1.0)
    target = abs(equilibrium[1])

    def step(x: np.ndarray) -> np.ndarray:
        state = x[0:3] + 1j * x[3:6]
        previous = complex(x[6], x[7])
        commands = x[8:]  # voltage at the end of the last block, then those on their way
        new = plant.block(state, commands[0], commands[1])
        taken = stiffness * (new[2] - previous)
        last = holder.voltage(float(commands[-1]), target, complex(new[1]), taken)
        return np.concatenate([new.real, new.imag, [new[2].real, new[2].imag], commands[1:], [last]])

    x0 = np.concatenate(
        [equilibrium.real, equilibrium.imag, [equilibrium[2].real, equilibrium[2].imag], np.ones(2 + latency)]
    )
    assert step(x0) == pytest.approx(x0, rel=1e-9, abs=1e-12)
    jacobian = np.empty((x0.size, x0.size))
    for k in range(x0.size):
        h = 1e-6 * max(1e-3, abs(x0[k]))
        jacobian[:, k] = (step(x0 + h * np.eye(x0.size)[k]) - step(x0 - h * np.eye(x0.size)[k])) / (2 * h)
    return float(np.max(np.abs(np.linalg.eigvals(jacobian))))


@pytest.mark.parametrize("decay", [2.4, 7.0, 14.0])
@pytest.mark.parametrize("latency", [0, 1])
def test_loop_is_stable_over_the_sweep(decay: float, latency: int) -> None:
    """350 to 390 Hz, dampings from sticking to the highest level, and an estimate of Z off by half or absent."""
    for detuning_hz in (-18.6, -6.0, -3.0, -1.5, -0.6, 0.0, 0.6, 1.5, 4.0, 21.4):
        for factor in (0.0, 0.5, 1.0, 1.3):
            radius = closed_loop_radius(decay, 2.0 * math.pi * detuning_hz, factor * STIFFNESS, latency)
            assert radius < 1.0, (detuning_hz, factor)


def test_a_reckless_controller_is_found_out() -> None:
    """The same check fails with four times the gain: it is able to."""

    def radius() -> float:
        return closed_loop_radius(2.4, 0.0, 0j)

    assert radius() < 1.0
    share = AMPLITUDE.feedback_gain_share
    try:
        object.__setattr__(AMPLITUDE, "feedback_gain_share", 5.0 * share)
        assert radius() > 1.0
    finally:
        object.__setattr__(AMPLITUDE, "feedback_gain_share", share)


def test_exciter_is_found_along_a_sweep() -> None:
    generator = np.random.default_rng(1)
    estimate = ExciterEstimate()
    plant_decay = 5.0
    for k, hertz in enumerate(np.linspace(-15.0, 10.0, 1500)):
        steady = Envelope(plant_decay, 2.0 * math.pi * hertz).steady(1.0)
        u = 10.0 / abs(steady[1])
        noise = 0.005 * (generator.standard_normal(2) @ (1, 1j))
        values = complex(steady[1] * u + noise), float(u), complex(steady[0] * u)
        if k == 0:
            estimate.start(*values)
        else:
            estimate.update(*values)
    assert estimate.force_per_volt == pytest.approx(BLOCKED, rel=0.02)
    assert estimate.stiffness == pytest.approx(STIFFNESS, rel=0.05)


def test_directions_that_nothing_excites_keep_what_was_learnt() -> None:
    estimate = ExciterEstimate()
    estimate.start(10.0, 2.0, 3.0j)
    for _ in range(20_000):
        estimate.update(10.0, 2.0, 3.0j)
    assert estimate.force_per_volt * 2.0 - estimate.stiffness * 3.0j == pytest.approx(10.0)
    assert abs(estimate.force_per_volt - 5.0) < 0.01


def test_noise_of_the_sensors_is_weighed() -> None:
    """Repeated phasors of one steady state: the estimate's scatter falls as that of a mean."""
    generator = np.random.default_rng(3)

    def scatter(told: float) -> float:
        left = []
        for _ in range(40):
            estimate = ExciterEstimate(drift=0.0)
            estimate.force_noise = told
            noise = 1.0 * (generator.standard_normal((101, 2)) @ (1, 1j)) / math.sqrt(2.0)
            estimate.start(10.0 + complex(noise[0]), 2.0, 3.0j)
            for value in noise[1:]:
                estimate.update(10.0 + complex(value), 2.0, 3.0j)
            left.append(abs(estimate.force_per_volt * 2.0 - estimate.stiffness * 3.0j - 10.0) ** 2)
        return math.sqrt(np.mean(left))

    assert scatter(1.0) == pytest.approx(0.1, rel=0.2)


def test_estimate_waits_until_the_force_stands_out_of_what_was_heard_at_rest() -> None:
    holder = ForceHolder(CUTOFF, BLOCK, 0)
    for turned in (1.0, 1.0j, -1.0, -1.0j, 1.0):
        holder.listen(0.02 * turned, 0.5 * turned)
    assert holder.exciter.force_noise == pytest.approx(0.02)
    assert holder.exciter.response_noise == pytest.approx(0.5)
    for _ in range(5):
        assert holder.observe(0.19 + 0j, 1j, 0.1) == 0.0
    assert holder.exciter.force_per_volt == 0
    holder.observe(0.21 + 0j, 1j, 0.1)
    assert holder.exciter.force_per_volt == pytest.approx(2.1)
    holder.clear()
    assert holder.exciter.force_per_volt == holder.exciter.force_noise == 0


def test_known_exciter_takes_the_motion_away() -> None:
    """Resonance passed at 1 Hz/s: the error is a small part of what plain feedback leaves."""

    def worst(stiffness: complex) -> float:
        holder = ForceHolder(CUTOFF, BLOCK, 0)
        holder.exciter.force_per_volt, holder.exciter.stiffness = BLOCKED, stiffness
        holder.exciter.update = lambda *_: None  # type: ignore[method-assign]
        u = 1.0
        state = Envelope(3.0, -2 * math.pi * 6.0).steady(u)
        target, before, errors = abs(state[1]), u, []
        for k in range(600):
            state = Envelope(3.0, 2 * math.pi * (-6.0 + k * BLOCK)).block(state, before, u)
            taken = holder.observe(complex(state[1]), complex(state[2]), u)
            before, u = u, holder.voltage(u, target, complex(state[1]), taken)
            errors.append(abs(state[1]) / target - 1.0)
        return max(abs(error) for error in errors[50:])

    assert worst(STIFFNESS) < 0.02
    assert worst(0j) > 5.0 * worst(STIFFNESS)


def test_voltage_record_is_the_filtered_half_cosine() -> None:
    record = VoltageRecord(CUTOFF, BLOCK, 0)
    value = [record.advance(2.0) for _ in range(5)][-1]
    assert value == pytest.approx(2.0, abs=1e-6)
    # One slow filter, fine steps as witness.
    slow = VoltageRecord(20.0, BLOCK, 1)
    assert slow.advance(1.0) == 0.0
    time = (np.arange(200_000) + 0.5) / 200_000 * BLOCK
    shape = 0.5 - 0.5 * np.cos(np.pi * time / BLOCK)
    witness = float(np.sum(20.0 * shape * np.exp(-20.0 * (BLOCK - time))) * (time[1] - time[0]))
    assert slow.advance(1.0) == pytest.approx(witness, rel=1e-3)


def test_response_holder_is_a_slow_integral() -> None:
    holder = ResponseHolder(CUTOFF, BLOCK, 0)
    assert holder.voltage(1.0, 2.0, 2.0 + 0j) == 1.0
    assert 1.0 < holder.voltage(1.0, 2.0, 1.9j) < 1.0 + 0.1 * math.log(2.0 / 1.9) + 1e-4
    assert holder.voltage(1.0, 2.0, 0j) == 1.0


def test_no_block_changes_the_drive_by_more_than_a_third() -> None:
    """Whatever the estimates say: a filter of a few blocks has to see it coming."""
    holder = ForceHolder(CUTOFF, BLOCK, 0)
    holder.exciter.force_per_volt = BLOCKED
    changes = [holder.voltage(1.0, 5.0, BLOCKED, taken * BLOCKED) - 1.0 for taken in (100.0, -100.0)]
    assert changes == pytest.approx([1.0 / 3.0, -1.0 / 3.0], rel=0.15)
    response = ResponseHolder(CUTOFF, BLOCK, 0)
    assert response.voltage(1.0, 1e9, 1.0 + 0j) == pytest.approx(4.0 / 3.0, rel=0.05)


def test_noise_is_that_of_the_last_tenth_of_a_second_at_rest() -> None:
    holder = ForceHolder(CUTOFF, BLOCK, 0)
    for _ in range(20):
        holder.listen(1.0 + 0j, 2.0 + 0j)
    for _ in range(round(0.1 / BLOCK) - 1):
        holder.listen(0.1 + 0j, 0.2 + 0j)
    assert holder.exciter.force_noise > 0.4
    holder.listen(0.1 + 0j, 0.2 + 0j)
    assert holder.exciter.force_noise == pytest.approx(0.1)
    assert holder.exciter.response_noise == pytest.approx(0.2)
