import numpy as np
import pytest
from diagnose.linear_problem import observations_of

from nmt_diagnose.ledger.gap import closed, rms
from nmt_diagnose.ledger.held_out import splits
from nmt_diagnose.measurements.measurement import joined


def test_splits_hold_out_every_second_level_the_top_two_and_whole_tests():
    levels = np.repeat(np.arange(6), 4)
    run, repeat = (
        observations_of(np.zeros(24), 1.0, levels),
        observations_of(np.zeros(8), 1.0, np.zeros(8), tests=("low",)),
    )
    found = {split.name: split for split in splits(joined([run, repeat]))}
    assert set(found) == {"every second level", "the highest two levels", "the test run", "the test low"}
    odd = found["every second level"]
    assert set(levels[odd.held_out[:24]]) == {1, 3, 5}
    assert not odd.held_out[24:].any()
    assert set(levels[found["the highest two levels"].held_out[:24]]) == {4, 5}
    for split in found.values():
        assert not np.any(split.fitted & split.held_out)
        assert np.all(split.fitted | split.held_out)
    assert splits(observations_of(np.zeros(6), 1.0, np.repeat(np.arange(3), 2))) == []


def test_closed_is_the_share_of_the_reachable_gap():
    generator = np.random.default_rng(5)
    levels = np.repeat(np.arange(20), 50)
    observations = observations_of(np.zeros(1000), 1.0, levels)
    noise = generator.standard_normal(1000)
    everything = np.ones(1000, dtype=bool)
    full = closed(observations, [(noise + 4.0, noise, everything)])
    assert full.before == pytest.approx(np.sqrt(17.0), rel=0.05)
    assert full.value == pytest.approx(1.0, abs=0.03)
    assert full.low < full.value == full.high == 1.0
    half = closed(observations, [(noise + 4.0, noise + 2.0, everything)])
    assert half.low < half.value < half.high
    assert half.value == pytest.approx((17.0**0.5 - 5.0**0.5) / (17.0**0.5 - 1.0), abs=0.03)
    harm = closed(observations, [(noise + 4.0, noise + 5.0, everything)])
    assert harm.value < 0.0
    assert np.isnan(closed(observations, [(noise, noise, everything)]).value)
    assert np.isnan(rms(np.full(3, np.nan)))


def test_a_prediction_is_worse_only_beyond_its_own_scatter():
    generator = np.random.default_rng(6)
    levels = np.repeat(np.arange(20), 50)
    observations = observations_of(np.zeros(1000), 1.0, levels)
    noise, everything = generator.standard_normal(1000), np.ones(1000, dtype=bool)
    assert closed(observations, [(noise + 1.0, noise, everything)]).gain > 10.0
    assert closed(observations, [(noise, noise + 1.0, everything)]).gain < -10.0
    # Noise added to a prediction of one level is one block among twenty: no sign of being worse.
    odd = noise + 0.05 * generator.standard_normal(1000)
    assert abs(closed(observations, [(noise, odd, everything)]).gain) < 3.0
    assert closed(observations, [(noise, noise, everything)]).gain == 0.0


def test_no_more_than_all_of_a_gap_is_closed_and_the_floor_is_at_most_what_is_left():
    generator = np.random.default_rng(7)
    observations = observations_of(np.zeros(400), 1.0, np.repeat(np.arange(20), 20))
    noise, everything = generator.standard_normal(400), np.ones(400, dtype=bool)
    for floor in (0.5, 1.0, 3.0):
        found = closed(observations, [(noise + 6.0, noise, everything)], floor=floor)
        assert found.floor == pytest.approx(min(floor, found.after))
        assert found.value <= 1.0
        assert found.high <= 1.0
    # With something left, a floor below it takes nothing from the share that is open.
    left = closed(observations, [(noise + 6.0, noise + 3.0, everything)], floor=1.0)
    assert left.value == pytest.approx((left.before - left.after) / (left.before - 1.0))
    assert left.value < 0.7
