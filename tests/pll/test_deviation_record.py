"""Mean and noise of deviations over a dwell: against noise of a known size, behind filters."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_pll.force_control.deviation_record import DeviationRecord


@pytest.mark.parametrize("cutoff", [100.0, 20.0])
def test_noise_is_found_beside_an_offset_and_a_slow_change(cutoff):
    """Noise behind a low-pass of the cut-off, sampled every 10 ms, 0.1 per part; circular, so √2 as much in all."""
    rng = np.random.default_rng(3)
    keep = np.exp(-cutoff * 0.01)
    record = DeviationRecord(2000, (2,), cutoff, 0.01)
    state = np.zeros(2, complex)
    for k in range(2000):
        fresh = 0.1 * (rng.standard_normal(2) + 1j * rng.standard_normal(2))
        state = keep * state + np.sqrt(1.0 - keep**2) * fresh
        record.add(state + 3.0 + 1e-3 * k)
    mean, noise = record.mean_and_noise()
    np.testing.assert_allclose(noise, 0.1 * np.sqrt(2.0), rtol=0.1)
    assert np.abs(mean - (3.0 + 0.9995)).max() < 5.0 * record.mean_std(noise).max()


def test_only_the_newest_dwell_counts():
    record = DeviationRecord(5, (1,), 1e6, 0.01)
    for value in (100.0, 100.0, 1.0, 2.0, 3.0, 4.0, 5.0):
        record.add(np.array([value + 0j]))
    assert record.is_full
    assert record.mean_and_noise()[0][0] == pytest.approx(3.0)
    record.restart()
    assert not record.is_full
    assert record.length == 0
