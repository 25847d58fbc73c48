"""The common misfit: whitening against the covariance, the least of a scale, and none where there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.one_of_each_kind import KINDS, rig_of_kinds, with_chain
from diagnose.predicted_observations import chain, observations_of_model
from scipy.stats import multivariate_normal

from nmt_diagnose.diagnose import diagnose_observations
from nmt_diagnose.diagnosis_settings import MATTERS, DiagnosisSettings
from nmt_diagnose.fit.misfit import Whitening, least_scale, misfit_of, rows_of_kind
from nmt_diagnose.fit.noise import Groups
from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.thresholds import THRESHOLDS

MODEL = chain()


def observed(truth: object = MODEL, tolerances: bool = True) -> Observations:
    found = observations_of_model(truth, seed=3, drives=(0.1, 0.2, 0.4, 0.8, 1.6))  # type: ignore[arg-type]
    own = MeasuringChain() if tolerances else None
    return replace(found, chains=tuple(own for _ in found.tests), matters=dict(MATTERS))


def test_whitened_residuals_have_the_likelihood_of_the_covariance() -> None:
    """Against the normal density with the whole covariance matrix, written down once more row by row."""
    observations = observed()
    rows, count = observations.rows, len(observations.rows)
    rng = np.random.default_rng(1)
    share = rng.uniform(0.2, 0.9, count)
    line = np.array([type(observations.tests[t]).__name__ == "RandomResponses" for t in rows.test])
    covariance = np.eye(count)
    for i in range(count):
        for j in range(i):
            same = all(getattr(rows, n)[i] == getattr(rows, n)[j] for n in ("test", "part", "channel", "harmonic"))
            if not same:
                continue
            at = rows.frequency_hz if line[i] else rows.amplitude
            apart = np.log(at[i] / at[j]) / (
                THRESHOLDS.misfit.line_length if line[i] else THRESHOLDS.misfit.level_length
            )
            covariance[i, j] = covariance[j, i] = np.sqrt(share[i] * share[j]) * np.exp(-0.5 * apart**2)
    whiten = Whitening(observations, share, np.ones(count, dtype=bool))
    residuals = rng.standard_normal((2, count))
    squares = [float(np.sum(whiten(own) ** 2)) for own in residuals]
    density = [multivariate_normal.logpdf(own, cov=covariance, allow_singular=True) for own in residuals]
    assert squares[1] - squares[0] == pytest.approx(-2.0 * (density[1] - density[0]), rel=1e-6)
    assert np.allclose(whiten(residuals.T)[:, 0], whiten(residuals[0]))


def test_rows_of_a_record_have_the_likelihood_of_what_they_share() -> None:
    rng, observations, count = np.random.default_rng(2), observed(), len(observed().rows)
    index = np.sort(rng.permutation(count)[:40])
    shared = rng.standard_normal((40, 5)) * rng.uniform(0.05, 0.25, (40, 1))
    used = np.ones(count, dtype=bool)
    used[index[::7]] = False
    whiten = Whitening(observations, np.zeros(count), used, [(index, shared)])
    kept = used[index]
    covariance = shared[kept] @ shared[kept].T
    np.fill_diagonal(covariance, 1.0)
    residuals = np.where(used, rng.standard_normal((2, count)), 0.0)
    squares = [float(np.sum(whiten(own)[index] ** 2)) for own in residuals]
    density = [multivariate_normal.logpdf(own[index[kept]], cov=covariance) for own in residuals]
    assert squares[1] - squares[0] == pytest.approx(-2.0 * (density[1] - density[0]), rel=1e-6)
    assert np.allclose(whiten.back(whiten(residuals[0])), residuals[0])
    assert np.allclose(whiten(residuals.T)[:, 0], whiten(residuals[0]))


def test_a_response_of_a_record_may_be_off_by_a_share_of_what_matters() -> None:
    """Of a sine the share that lines of a frequency response may be off, at every moment."""
    observed_record = KINDS["driven record"](rig_of_kinds())
    (test,) = observed_record.tests
    sine = 0.3 * np.sin(2.0 * np.pi * 40.0 * np.arange(test.input.size) / test.sample_rate)  # type: ignore[attr-defined]
    test = replace(test, responses=np.tile(sine, (len(test.channels), 1)))  # type: ignore[type-var]
    found = misfit_of(with_chain(replace(observed_record, tests=(test,))))
    expected = THRESHOLDS.misfit.shared_share * MATTERS["response"] * 0.3
    assert np.median(found.common) == pytest.approx(expected, rel=0.03)
    assert not misfit_of(replace(observed_record, tests=(test,), matters=MATTERS)).common.any()


def test_unused_rows_tell_nothing_of_the_others() -> None:
    observations = observed()
    count = len(observations.rows)
    used = np.arange(count) % 3 > 0
    whiten = Whitening(observations, np.full(count, 0.5), used)
    residual = np.where(used, 1.0, 0.0)
    assert np.all(whiten(residual)[~used] == 0.0)


def test_a_scale_goes_down_to_the_misfit_and_the_cost_stays_smooth() -> None:
    groups = Groups(np.zeros(20, dtype=np.int64), ("all",), np.array([6.0]), np.array([0.5]))
    counts = np.array([20.0])
    bend = 0.5 * 26.0 - 6.0
    for squares in (0.0, 0.5 * bend, bend, 2.0 * bend):
        step = 1e-4
        slope = (groups.cost(np.array([squares + step]), counts) - groups.cost(np.array([squares]), counts)) / step
        assert slope == pytest.approx(groups.weights(np.array([squares]), counts)[0], rel=1e-3)
    assert groups.weights(np.array([0.0]), counts)[0] == pytest.approx(2.0)


def test_least_scale_is_the_share_of_the_misfit() -> None:
    found = least_scale(np.array([0, 0, 1]), 3, np.array([0.2, 0.4, 1.0]))
    assert found == pytest.approx([0.3, 1.0, 0.0])


def test_the_bench_itself_measures_without_misfit() -> None:
    found = misfit_of(observed(tolerances=False))
    assert not found.common.any()
    assert not found.independent.any()


def test_kinds_of_what_matters_share_no_row() -> None:
    observations = observed()
    total = sum(rows_of_kind(observations, kind).astype(int) for kind in MATTERS)
    assert np.max(total) == 1


def test_a_smooth_misfit_below_what_matters_is_no_gap() -> None:
    """Frequencies bend with the level by a share of what matters, ten times their noise; no effect does just that."""
    observations = observed()
    rows = observations.rows
    mine = rows_of_kind(observations, "frequency") & (rows.amplitude > 0.0)
    bent = np.where(mine, 0.2 * MATTERS["frequency"] * np.log(np.maximum(rows.amplitude, 1e-9) / 0.4) ** 2, 0.0)
    found = diagnose_observations(
        MODEL, replace(observations, values=observations.values + bent), DiagnosisSettings(look_ahead=False)
    ).diagnosis
    assert found.verdict in (Verdict.NONE, Verdict.CALIBRATION)
