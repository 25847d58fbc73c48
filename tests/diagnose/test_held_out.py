from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from diagnose.linear_problem import observations_of

from nmt_diagnose.effects.effect import Candidate, Site
from nmt_diagnose.effects.library import effect_named
from nmt_diagnose.effects.placement import Placement
from nmt_diagnose.inference.fitted_model import FittedModel
from nmt_diagnose.inference.gap import closed, noise_floor, rms
from nmt_diagnose.inference.held_out import Split, splits
from nmt_diagnose.inference.held_out_comparison import HeldOut, determined
from nmt_diagnose.observations.observables import joined


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


def test_noise_floor_is_the_scatter_whatever_a_smooth_effect_adds():
    generator = np.random.default_rng(8)
    observations = observations_of(np.zeros(3000), 1.0, np.arange(3000))
    everything = np.ones(3000, dtype=bool)
    smooth = 5.0 * np.sin(np.arange(3000) / 100.0)
    for scatter in (0.5, 1.0, 2.0):
        residual = scatter * generator.standard_normal(3000)
        assert noise_floor(observations, residual, everything) == pytest.approx(scatter, rel=0.08)
        assert noise_floor(observations, residual + smooth, everything) == pytest.approx(scatter, rel=0.08)
    assert noise_floor(observations.take(np.arange(10)), np.zeros(10), np.ones(10, dtype=bool)) == 1.0


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


def test_the_onset_of_slip_is_no_noise():
    """A course that bends at one level has a few large second differences; the scatter shows in the others."""
    generator = np.random.default_rng(4)
    levels, series = 12, 40
    observations = replace_rows(
        observations_of(np.zeros(levels * series), 1.0, np.tile(np.arange(levels), series)), series
    )
    noise = generator.standard_normal(levels * series)
    bend = np.tile(np.maximum(np.arange(levels) - 7.0, 0.0), series) * 40.0
    everything = np.ones(levels * series, dtype=bool)
    assert noise_floor(observations, noise, everything) == pytest.approx(1.0, rel=0.1)
    assert noise_floor(observations, noise + bend, everything) == pytest.approx(1.0, rel=0.3)


def test_an_onset_in_few_levels_is_no_noise_either():
    """Of five levels a run has three second differences; contact between the third and the fourth bends two of them."""
    generator = np.random.default_rng(4)
    levels, series = 5, 60
    observations = replace_rows(
        observations_of(np.zeros(levels * series), 1.0, np.tile(np.arange(levels), series)), series
    )
    noise = generator.standard_normal(levels * series)
    bend = np.tile(np.maximum(np.arange(levels) - 2.3, 0.0), series) * 60.0
    everything = np.ones(levels * series, dtype=bool)
    assert noise_floor(observations, noise, everything) == pytest.approx(1.0, rel=0.15)
    # The clean third of them, by its upper quarter.
    assert noise_floor(observations, noise + bend, everything) < 4.0 < 0.1 * rms(bend)


def replace_rows(observations, series):
    """The rows as those of so many harmonics, one after the other."""
    size = len(observations.rows) // series
    return replace(observations, rows=replace(observations.rows, harmonic=np.repeat(np.arange(series) + 1, size)))


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


def explained(theta, std, prior, name="two_sided_gap", opened=10.0, chi_square=100.0):
    """A gap with a stop that a fit knows so well: stiffness and distance."""
    effect = effect_named(name)
    gap = Candidate(effect, Site(Placement.at("structure", 1), {"k": 1.0, "gap": 1.0}, 1))
    known = SimpleNamespace(prior_std=np.array(prior), index_of=lambda _: slice(0, 2))
    fitted = SimpleNamespace(
        theta=np.array(theta),
        std=np.array(std),
        parametrisation=known,
        predictive_std=np.full(8, opened),
        chi_square=chi_square,
        penalty=0.0,
    )
    return FittedModel((gap,), fitted)


WITHOUT = FittedModel((), SimpleNamespace(chi_square=200.0, penalty=0.0))
LAST = np.arange(8) >= 6


@pytest.mark.parametrize(
    ("theta", "std", "told"),
    [
        ([10.0, 0.1], [1.0, 0.1], True),
        # Its distance is what is believed beforehand: the levels that are left do not reach it.
        ([10.0, 0.1], [1.0, 0.9], False),
        ([1.0, 0.1], [1.0, 0.1], False),
    ],
)
def test_a_split_counts_only_if_it_tells_the_parameters(theta, std, told):
    assert determined(explained(theta, std, [3.0, 1.0]), WITHOUT, LAST) is told


@pytest.mark.parametrize(
    ("opened", "chi_square", "told"),
    [
        (1.2, 100.0, True),
        # What is open of the parameters is open of the rows held out as well.
        (3.0, 100.0, False),
        # The rows that are left do without the effect.
        (1.2, 198.0, False),
    ],
)
def test_parameters_that_make_up_for_one_another_may_be_open_where_the_prediction_is_not(opened, chi_square, told):
    item = explained([1.5, 0.1], [1.0, 0.9], [3.0, 1.0], opened=opened, chi_square=chi_square)
    assert determined(item, WITHOUT, LAST) is told


def test_repeats_are_what_noise_leaves():
    generator = np.random.default_rng(9)
    observations = observations_of(np.zeros(400), 1.0, np.arange(400))
    # Scatter three times as large as what repeats showed is something else than noise.
    residual = 3.0 * generator.standard_normal(400)
    everything = np.ones(400, dtype=bool)
    base = FittedModel((), SimpleNamespace(residual=residual, predictive_std=np.ones(400)))
    refits = [(Split("all", ~everything, everything), base, {})]
    assert HeldOut(observations, refits, 0).floor == pytest.approx(3.0, rel=0.1)
    assert HeldOut(observations, refits, 0, repeated=True).floor == 1.0


def test_only_splits_that_tell_the_explanation_count():
    observations = observations_of(np.zeros(400), 1.0, np.repeat(np.arange(20), 20))
    generator = np.random.default_rng(10)
    noise, everything = generator.standard_normal(400), np.ones(400, dtype=bool)
    ones = np.ones(400)
    base = FittedModel((), SimpleNamespace(residual=noise + 5.0, predictive_std=ones, chi_square=100.0, penalty=0.0))

    def split(fitted_model, left):
        fitted_model.fit.residual, fitted_model.fit.predictive_std = noise + left, ones
        return Split("some", ~everything, everything), base, {fitted_model.explanation: fitted_model}

    told = explained([10.0, 0.1], [1.0, 0.1], [3.0, 1.0])
    blind = explained([10.0, 0.1], [1.0, 0.9], [3.0, 1.0])
    whole = HeldOut(observations, [split(told, 0.0)], 0).closed(told.explanation)
    assert whole.value > 0.97
    both = HeldOut(observations, [split(told, 0.0), split(blind, 5.0)], 0).closed(told.explanation)
    assert both.value == pytest.approx(whole.value)
    assert np.isnan(HeldOut(observations, [split(blind, 5.0)], 0).closed(blind.explanation).value)


def test_explanations_are_compared_by_what_they_predict():
    observations = observations_of(np.zeros(400), 1.0, np.repeat(np.arange(20), 20))
    noise, everything = np.random.default_rng(11).standard_normal(400), np.ones(400, dtype=bool)
    ones = np.ones(400)
    base = FittedModel((), SimpleNamespace(residual=noise + 5.0, predictive_std=ones, chi_square=100.0, penalty=0.0))
    good = explained([10.0, 0.1], [1.0, 0.1], [3.0, 1.0])
    bad = explained([10.0, 0.1], [1.0, 0.1], [3.0, 1.0], "one_sided_stop")
    good.fit.residual, bad.fit.residual = noise, noise + 1.0
    good.fit.predictive_std = bad.fit.predictive_std = ones
    tops = {good.explanation: good, bad.explanation: bad}
    held = HeldOut(observations, [(Split("all", ~everything, everything), base, tops)], 0)
    shares = {explanation: held.closed(explanation) for explanation in tops}
    found = held.worse(shares, 0.03)
    assert found[good.explanation] == 0.0
    # Twenty blocks of twenty rows, each worse by 1 ± 2/√20 squared standard deviations a row.
    assert found[bad.explanation] == pytest.approx(np.sqrt(20.0) * 1.0 / (2.0 / np.sqrt(20.0)), rel=0.4)
    # The bad one closes nine tenths of the gap: whoever calls that the same does not distinguish them.
    assert held.worse(shares, 0.3) == dict.fromkeys(tops, 0.0)
