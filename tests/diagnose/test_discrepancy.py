"""Smooth errors of an effect's model: seen where there are some, never larger than a share of what the effect does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.test_amplitude_scales import backbone
from diagnose.twin_observations import chain, observations_of_twin

from nmt_diagnose.inference.discrepancy import LARGEST_SHARE, smooth_errors
from nmt_diagnose.observations.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Observations


def table(sigma: float = 1e-3) -> Observations:
    found = backbone(1.0)
    return replace(found, std=np.full(len(found.rows), sigma))


def hardening(observations: Observations) -> np.ndarray:
    """What a cubic spring does to ln ω."""
    x = observations.rows.amplitude / observations.rows.amplitude.max()
    return np.asarray(0.5 * np.log(1.0 + 3.0 * x**2))


def variance(columns: np.ndarray) -> np.ndarray:
    return np.asarray(np.sum(columns**2, axis=1))


def test_noise_as_stated_is_no_smooth_error() -> None:
    observations = table()
    for seed in range(20):
        noise = observations.sigma * np.random.default_rng(seed).standard_normal(len(observations.rows))
        assert not smooth_errors(observations, noise, hardening(observations)).any()


def test_a_remainder_that_grows_with_the_effect_is_one() -> None:
    observations = table()
    effect = hardening(observations)
    found = smooth_errors(observations, 0.05 * effect * np.linspace(0.6, 1.4, effect.size), effect)
    size = np.sqrt(variance(found))
    top = int(np.argmax(effect))
    assert 0.02 < size[top] / effect[top] <= LARGEST_SHARE * 1.05


def test_a_smooth_error_is_bounded_by_the_effect_whatever_is_left() -> None:
    """A second effect as large as the first is no error of the first one's model."""
    observations = table()
    effect = hardening(observations)
    found = np.sqrt(variance(smooth_errors(observations, effect.copy(), effect)))
    low = 3e-3
    assert np.all(found <= np.hypot(LARGEST_SHARE * effect, low) * (1.0 + 1e-9))
    assert not smooth_errors(observations, effect.copy(), 0.0 * effect).any()


def test_neighbouring_levels_share_it() -> None:
    observations = table()
    effect = hardening(observations)
    columns = smooth_errors(observations, 0.06 * effect, effect)
    covariance = columns @ columns.T
    order = np.argsort(observations.rows.amplitude)
    a, b, far = order[-1], order[-2], order[0]
    correlation = lambda i, j: covariance[i, j] / np.sqrt(covariance[i, i] * covariance[j, j])  # noqa: E731
    assert correlation(a, b) > 0.95 > correlation(a, far)


@pytest.mark.parametrize("chains", [(), (None,), (MeasuringChain(),)])
def test_the_own_simulator_has_none(chains: tuple[MeasuringChain | None, ...]) -> None:
    observations = replace(observations_of_twin(chain(), random=False, drives=np.linspace(0.1, 1.6, 8)), chains=chains)
    effect = 0.1 * observations.rows.amplitude
    found = smooth_errors(observations, 0.05 * effect, effect)
    assert found.any() == bool(chains and chains[0])
