import numpy as np
import pytest
from unit.diagnose.linear_problem import evidence_of

from nmt_diagnose.evidence.observables import joined
from nmt_diagnose.inference.gap import closed, noise_floor, rms
from nmt_diagnose.inference.held_out import splits


def test_splits_hold_out_every_second_level_the_top_two_and_whole_tests():
    levels = np.repeat(np.arange(6), 4)
    run, repeat = evidence_of(np.zeros(24), 1.0, levels), evidence_of(np.zeros(8), 1.0, np.zeros(8), tests=("low",))
    found = {split.name: split for split in splits(joined([run, repeat]))}
    assert set(found) == {"every second level", "the highest two levels", "the test run", "the test low"}
    odd = found["every second level"]
    assert set(levels[odd.held_out[:24]]) == {1, 3, 5}
    assert not odd.held_out[24:].any()
    assert set(levels[found["the highest two levels"].held_out[:24]]) == {4, 5}
    for split in found.values():
        assert not np.any(split.fitted & split.held_out)
        assert np.all(split.fitted | split.held_out)
    assert splits(evidence_of(np.zeros(6), 1.0, np.repeat(np.arange(3), 2))) == []


def test_closed_is_the_share_of_the_reachable_gap():
    generator = np.random.default_rng(5)
    levels = np.repeat(np.arange(20), 50)
    evidence = evidence_of(np.zeros(1000), 1.0, levels)
    noise = generator.standard_normal(1000)
    everything = np.ones(1000, dtype=bool)
    full = closed(evidence, [(noise + 4.0, noise, everything)])
    assert full.before == pytest.approx(np.sqrt(17.0), rel=0.05)
    assert full.value == pytest.approx(1.0, abs=0.03)
    assert full.low < full.value < full.high
    half = closed(evidence, [(noise + 4.0, noise + 2.0, everything)])
    assert half.value == pytest.approx((17.0**0.5 - 5.0**0.5) / (17.0**0.5 - 1.0), abs=0.03)
    harm = closed(evidence, [(noise + 4.0, noise + 5.0, everything)])
    assert harm.value < 0.0
    assert np.isnan(closed(evidence, [(noise, noise, everything)]).value)
    assert np.isnan(rms(np.full(3, np.nan)))


def test_noise_floor_is_the_scatter_whatever_a_smooth_effect_adds():
    generator = np.random.default_rng(8)
    evidence = evidence_of(np.zeros(3000), 1.0, np.arange(3000))
    everything = np.ones(3000, dtype=bool)
    smooth = 5.0 * np.sin(np.arange(3000) / 100.0)
    for scatter in (0.5, 1.0, 2.0):
        residual = scatter * generator.standard_normal(3000)
        assert noise_floor(evidence, residual, everything) == pytest.approx(scatter, rel=0.08)
        assert noise_floor(evidence, residual + smooth, everything) == pytest.approx(scatter, rel=0.08)
    assert noise_floor(evidence.take(np.arange(10)), np.zeros(10), np.ones(10, dtype=bool)) == 1.0


def test_a_prediction_is_worse_only_beyond_its_own_scatter():
    generator = np.random.default_rng(6)
    levels = np.repeat(np.arange(20), 50)
    evidence = evidence_of(np.zeros(1000), 1.0, levels)
    noise, everything = generator.standard_normal(1000), np.ones(1000, dtype=bool)
    assert closed(evidence, [(noise + 1.0, noise, everything)]).gain > 10.0
    assert closed(evidence, [(noise, noise + 1.0, everything)]).gain < -10.0
    # Noise added to a prediction of one level is one block among twenty: no sign of being worse.
    odd = noise + 0.05 * generator.standard_normal(1000)
    assert abs(closed(evidence, [(noise, odd, everything)]).gain) < 3.0
    assert closed(evidence, [(noise, noise, everything)]).gain == 0.0
