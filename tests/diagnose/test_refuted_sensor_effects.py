"""Sensor effects that a record refutes, and the gap of a model that runs away from what was measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from diagnose.oscillator_records import OMEGA, RATE, RATIO, band_noise, imported, rig_in
from scipy.signal import cont2discrete, lfilter

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.effects.library import candidates, effect_named
from nmt_diagnose.ledger.gap import no_worse_than_silence, rms
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.observations.read_observations import read_observations
from nmt_diagnose.prediction.operating_range import operating_range


def response(volts: FloatArray) -> FloatArray:
    top, bottom, _ = cont2discrete(([OMEGA**2], [1.0, 2.0 * RATIO * OMEGA, OMEGA**2]), 1.0 / RATE, "foh")
    return np.asarray(lfilter(top[0], bottom, volts))


def recorded(folder: Path, level: float = np.inf) -> Observations:
    volts = band_noise(4096, 3, 0.02)
    y = response(volts) + 1e-4 * np.random.default_rng(1).standard_normal(volts.size)
    bag = imported(folder, volts, np.clip(y, -level, level), [(0, volts.size)])
    return read_observations([bag], rig_in(folder))


@pytest.mark.parametrize("level", [np.inf, 0.05])
def test_a_record_that_shows_no_clipping_refutes_it(tmp_path: Path, level: float) -> None:
    observations, rig = recorded(tmp_path, level), rig_in(tmp_path)
    operating = operating_range(rig, observations.tests, observations=observations)
    sites = [c.site for c in candidates(rig, operating) if c.effect.name == "clipping"]
    at_response = [site for site in sites if site.location.detail == "x1"]
    assert bool(at_response) is bool(np.isfinite(level))
    if at_response:
        assert operating.limits["x1"] == pytest.approx(level)


@pytest.mark.parametrize(
    ("g", "factor"), [(0.9, 1.9), (1.1, 2.0), (9.0, 2.0), (-0.45, 0.55), (-0.55, 0.5), (-2.0, 0.5)]
)
def test_a_gain_stays_within_a_factor_of_two(tmp_path: Path, g: float, factor: float) -> None:
    rig, observations = rig_in(tmp_path), recorded(tmp_path)
    operating = operating_range(rig, observations.tests, observations=observations)
    effect = effect_named("response_gain")
    (site,) = effect.sites(rig, operating)
    assert effect.apply(rig, site, {"g": g}).sensors[site.index].gain == pytest.approx(factor)
    assert effect.reported(site, {"g": g})["g"][0] == pytest.approx(factor - 1.0)


@pytest.mark.parametrize(("factor", "counted"), [(0.0, 1.0), (1.5, 0.5), (3.0, 1.0), (100.0, 1.0)])
def test_a_model_that_runs_away_defines_no_gap(tmp_path: Path, factor: float, counted: float) -> None:
    """A model of ``factor`` times the motion leaves |factor − 1| of the record, and as a gap no more than all of it."""
    observations = recorded(tmp_path)
    sigma = observations.sigma
    residual = (1.0 - factor) * observations.values / sigma
    found = no_worse_than_silence(observations, residual, sigma)
    assert rms(found) == pytest.approx(counted * rms(observations.values / sigma))
    assert np.all(np.sign(found) == np.sign(residual))
