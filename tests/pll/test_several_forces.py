"""The law for several exciters on a plant of known matrices: closed form, wrong or unknown gains, limits, giving up."""

from __future__ import annotations

import cmath
import math
from functools import cache

import numpy as np
import pytest
from pll.force_plant import BLOCK, CUTOFF, FREQUENCY, HIGHEST, ForcePlant, matrices
from tiers import with_quick

from nmt_pll.force_control.gain_estimate import GainEstimate, solved
from nmt_pll.thresholds import HARMONICS


def turned(degrees: float) -> complex:
    return cmath.rect(1.0, math.radians(degrees))


@cache
def deviation_with_dead_time(rate: float, dead: float, blocks: int) -> np.ndarray:
    """Deviation at every block over that at first, by fine steps of v̇ = −κ y(t − T), ẏ = ω_LP (v + 1 − y).

    From y = 1, v = 0.
    """
    step = 1e-5
    lag = round(dead / step)
    steps = round(blocks * BLOCK / step)
    force, filtered, voltage = np.ones(steps + 1), np.ones(steps + 1), 0.0
    for k in range(steps):
        voltage -= step * rate * (filtered[k - lag] if k >= lag else 0.0)
        force[k + 1] = voltage + 1.0
        filtered[k + 1] = filtered[k] + CUTOFF * step * (force[k + 1] - filtered[k])
    return force[: -1 : round(BLOCK / step)]


@pytest.mark.parametrize("exciters", [1, 2, 3])
@pytest.mark.parametrize("latency", with_quick([0, 1, 3], 3))
def test_every_force_is_an_integral_loop_with_dead_time_of_its_own(exciters, latency):
    plant = ForcePlant(exciters, latency)
    rate = plant.controller.rate
    assert rate == pytest.approx(HARMONICS.phase_margin_rad / (1 / CUTOFF + plant.setup.dead_time))
    begun = plant.disturbance[:, 2].copy()
    measured = []
    for _ in range(round(5.0 / rate / BLOCK)):
        plant.step()
        measured.append(plant.deviation[:, 2] / begun)
    # Half a block of the hold and half of the line to the new value.
    expected = deviation_with_dead_time(rate, (1.0 + latency) * BLOCK, len(measured))
    np.testing.assert_allclose(np.array(measured), np.repeat(expected[:, None], exciters, axis=1), atol=0.09)
    plant.run(2.0 + 20.0 * latency * BLOCK)
    assert np.abs(plant.deviation).max() < 0.002
    assert not plant.controller.obstacle


FACTORS = {
    "three times": (3.0, 1.0),
    "a third": (1.0, 1 / 3),
    "sign of the first": (-1.0, 1.0),
    "sign of the second": (1.0, -1.0),
    "both signs": (-1.0, -1.0),
    "60 degrees": (turned(60), turned(-60)),
    "three times and a sign": (3.0, -1.0),
}


@pytest.mark.parametrize(
    ("name", "latency"),
    with_quick([(name, latency) for name in FACTORS for latency in (0, 3)], ("both signs", 0), ("both signs", 3)),
)
def test_wrong_factors_of_the_exciters_are_learnt(name, latency):
    factors = FACTORS[name]
    plant = ForcePlant(2, latency, factors)
    plant.run(6.0 + 4.0 * latency)
    assert np.abs(plant.deviation).max() < 0.003
    assert not plant.controller.given_up
    assert not plant.controller.obstacle
    # What was learnt undoes the error where it would have been unstable, and the disturbance was large enough to tell.
    gain = plant.controller.gain(FREQUENCY)[1]
    for column, factor in enumerate(factors):
        if factor.real < 0.0:
            assert abs(cmath.phase(gain[column, column] / plant.gains[1, column, column])) < math.radians(45)


def test_exchanged_terms_beside_the_diagonal_are_within_the_margins():
    exchanged = lambda f: matrices(f).swapaxes(1, 2)  # noqa: E731
    plant = ForcePlant(2, known=exchanged)
    wrong = np.linalg.eigvals(plant.gains @ np.linalg.inv(exchanged(FREQUENCY * np.arange(2, HIGHEST + 1))))
    assert np.abs(wrong).max() < math.pi / (2 * HARMONICS.phase_margin_rad)
    assert np.abs(np.angle(wrong)).max() < 0.5 * math.pi - HARMONICS.phase_margin_rad
    assert np.abs(plant.gains - plant.gains.swapaxes(1, 2)).max() > 0.1
    plant.run(4.0)
    assert np.abs(plant.deviation).max() < 0.002


def test_what_nobody_knows_is_probed_exciter_by_exciter():
    plant = ForcePlant(2, 1, factors=None)
    probed = set()
    while plant.blocks < 3 or plant.controller.is_probing or np.isnan(plant.controller.gain(FREQUENCY)).any():
        plant.step()
        harmonics = np.abs(plant.controller.terms[:, 1:])
        assert np.count_nonzero(harmonics) <= 1
        assert harmonics.max() <= HARMONICS.probe_share + 1e-12
        probed |= set(map(tuple, np.argwhere(harmonics).tolist()))
        assert plant.blocks < 2000
        assert plant.controller.obstacle
    assert len(probed) == 2 * (HIGHEST - 1)
    found = plant.controller.gain(FREQUENCY)
    assert np.abs(found - plant.gains).max() < 0.05 * np.abs(plant.gains).max()
    plant.run(4.0)
    assert np.abs(plant.deviation).max() < 0.002


@pytest.mark.parametrize(
    ("limits", "bound"), [({"voltage_limit": 1.03}, "largest"), ({"slew_limit": 207.0}, "steepest")]
)
def test_limits_hold_for_each_exciter_and_what_they_stop_is_named(limits, bound):
    plant = ForcePlant(2, **limits)
    plant.run(12.0)
    assert getattr(plant, bound).max() <= next(iter(limits.values()))
    assert plant.controller.given_up
    assert {exciter for exciter, _ in plant.controller.given_up} == {1}  # the other needs less for its fundamental
    assert all("would need more than" in why for why in plant.controller.given_up.values())
    assert "of the force of exciter 1 given up" in plant.controller.summary
    assert not plant.controller.obstacle
    assert np.abs(plant.deviation[1, 0]) < 0.003


def test_a_fundamental_stays_below_the_limit_and_goes_before_harmonics():
    plant = ForcePlant(2, voltage_limit=1.5)
    plant.target[1, 0] = 30.0
    plant.run(3.0)
    assert plant.largest.max() <= 1.5
    assert abs(plant.controller.terms[1, 0]) == pytest.approx(HARMONICS.voltage_limit_share * 1.5)
    assert np.abs(plant.controller.terms[1, 1:]).max() < 1e-6
    assert "harmonic 1 of the force of exciter 2" in plant.controller.obstacle


def test_a_harmonic_that_does_not_follow_is_given_up_at_its_exciter_and_the_others_go_on():
    plant = ForcePlant(2, 1, dead=[(2, 3)])
    plant.run(30.0)
    assert set(plant.controller.given_up) == {(2, 3)}
    assert abs(plant.controller.terms[1, 2]) < 1e-6
    others = np.abs(plant.deviation)
    others[1, 2] = 0.0
    assert others.max() < 0.003
    assert not plant.controller.obstacle
    plant.controller.clear()
    assert not plant.controller.given_up


def test_noise_is_not_driven():
    noise = 0.02
    plant = ForcePlant(2, noise=noise)
    plant.run(5.0)
    true = []
    for _ in range(400):
        plant.step()
        true.append(plant.deviation[:, 1:])
    # White noise σ of each block comes back as σ √(κ Δt / 2); of κ a tenth is left in so much of it.
    in_full = noise * math.sqrt(2.0) * math.sqrt(0.5 * plant.controller.rate * BLOCK)
    rms = np.sqrt(np.mean(np.abs(np.array(true) - np.mean(true, axis=0)) ** 2, axis=0))
    assert rms.mean() < 0.5 * in_full
    assert not plant.controller.given_up
    assert not plant.controller.obstacle


def test_harmonics_that_are_off_are_zero_and_the_fundamentals_go_on():
    plant = ForcePlant(2)
    plant.run(3.0)
    held = plant.controller.terms.copy()
    plant.controller.off = True
    plant.target[1, 0] *= 1.2
    plant.run(3.0)
    assert [term.value for term in plant.controller.drive_terms() if term.order > 1] == [0.0] * (2 * HIGHEST - 2)
    np.testing.assert_array_equal(plant.controller.terms[:, 1:], held[:, 1:])
    assert plant.controller.terms[1, 0] == pytest.approx(1.2 * held[1, 0], rel=0.01)


@pytest.mark.parametrize("exciters", [1, 2, 4])
def test_elimination_is_a_division_for_one_and_solves_for_many(exciters):
    random = np.random.default_rng(2)
    a = random.normal(size=(50, exciters, exciters, 2)) @ [1.0, 1.0j]
    b = random.normal(size=(50, exciters, 2)) @ [1.0, 1.0j]
    if exciters > 1:
        a[:20, 0, 0] = 0.0  # without exchange of rows there is nothing to divide by
        np.testing.assert_allclose(np.einsum("kij,kj->ki", a, solved(a, b)), b, atol=1e-12)
    else:
        np.testing.assert_array_equal(solved(a, b)[:, 0], b[:, 0] / a[:, 0, 0])


def test_the_filter_on_the_factors_is_least_squares_with_what_was_known():
    """Against the regularised normal equations of all moves at once."""
    random = np.random.default_rng(4)
    truth, spread = np.array([0.7 - 0.4j, 1.5 + 0.2j]), HARMONICS.initial_gain_std**2
    estimate, scatter = GainEstimate(1, 2), 0.01
    information, right = np.eye(2) / spread + 0j, np.ones(2) / spread + 0j
    for _ in range(12):
        moves = random.normal(size=(1, 2, 2, 2)) @ [1.0, 1.0j]
        change = moves[0] @ truth + 0.1 * random.normal(size=(2, 2)) @ [1.0, 1.0j]
        estimate.learn(moves, change[None, :], np.zeros((1, 2)), np.full((1, 2), scatter))
        information += moves[0].conj().T @ moves[0] / scatter
        right += moves[0].conj().T @ change / scatter
    np.testing.assert_allclose(estimate.correction[0], np.linalg.solve(information, right), rtol=1e-9)
    np.testing.assert_allclose(estimate.covariance[0], np.linalg.inv(information), rtol=1e-6, atol=1e-9)
