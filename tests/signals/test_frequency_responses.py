"""Averaged frequency responses against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_signals.frequency_responses import averaged_spectra, frf_estimate
from nmt_signals.local_responses import choose_bins

RATE = 1000.0


def one_dof(frequency: np.ndarray) -> np.ndarray:
    """Receptance of 2 kg on 2e5 N/m with 5 %: 50.3 Hz."""
    omega = 2 * np.pi * frequency
    return 1.0 / (2e5 - 2.0 * omega**2 + 1j * omega * 2 * 0.05 * np.sqrt(2e5 * 2.0))


def record(seed: int, force_noise: float = 0.0, response_noise: float = 0.0, samples: int = 1 << 17):
    """Voltage, force and response of a periodic random excitation; force is twice the voltage."""
    random = np.random.default_rng(seed)
    voltage = random.standard_normal(samples)
    force = 2.0 * voltage
    lines = np.fft.rfftfreq(samples, 1 / RATE)
    response = np.fft.irfft(one_dof(lines) * np.fft.rfft(force), samples)
    return {
        "u": voltage,
        "f1": force + force_noise * random.standard_normal(samples),
        "x1": response + response_noise * random.standard_normal(samples),
    }


def test_all_estimates_meet_the_exact_response_without_noise():
    spectra = averaged_spectra(record(1), RATE, 4096, (20.0, 100.0))
    frf = frf_estimate(spectra, "f1", ("x1",), "u")
    exact = one_dof(frf.frequency_hz)
    for estimate in (frf.h1, frf.h2, frf.hv, frf.hc):
        assert np.max(np.abs(estimate[0] / exact - 1.0)) < 0.02  # leakage of the window
    assert np.min(frf.coherence) > 0.995


def test_noise_of_force_and_response_bias_h1_and_h2_by_the_known_factors():
    noise = 1.0  # a quarter of the force's power
    spectra = averaged_spectra(record(2, force_noise=noise), RATE, 1024, (20.0, 100.0))
    frf = frf_estimate(spectra, "f1", ("x1",), "u")
    reference = frf_estimate(averaged_spectra(record(2), RATE, 1024, (20.0, 100.0)), "f1", ("x1",)).h1
    ratio = {name: np.mean((getattr(frf, name) / reference).real) for name in ("h1", "h2", "hv", "hc")}
    assert ratio["h1"] == pytest.approx(4.0 / 5.0, rel=0.01)
    assert ratio["h2"] == pytest.approx(1.0, rel=0.03)
    assert ratio["hv"] == pytest.approx(np.sqrt(4.0 / 5.0), rel=0.02)
    assert ratio["hc"] == pytest.approx(1.0, rel=0.01)
    assert np.mean(frf.coherence) == pytest.approx(4.0 / 5.0, abs=0.02)


def test_hv_is_the_smallest_eigenvector_of_the_scaled_spectral_matrix():
    spectra = averaged_spectra(record(3, 1.0, 1e-5), RATE, 1024, (20.0, 100.0))
    frf = frf_estimate(spectra, "f1", ("x1",))
    for line in (0, 10, 40):
        matrix = np.array(
            [[spectra.cross(a, b)[line] for b in ("f1", "x1")] for a in ("f1", "x1")], dtype=np.complex128
        )
        scale = np.sqrt(np.diagonal(matrix).real)
        _, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
        smallest = vectors[:, 0]
        # The noise-free pair (F, X) is orthogonal to it.
        pair = np.array([-smallest[1].conj(), smallest[0].conj()])
        assert frf.hv[0, line] == pytest.approx(pair[1] / pair[0] * scale[1] / scale[0], rel=1e-9)


def test_averages_that_count():
    signals = record(4, samples=8192)
    apart = averaged_spectra(signals, RATE, 1024, overlap=0.0)
    assert (apart.averages, apart.independent_averages) == (8, pytest.approx(8.0))
    half = averaged_spectra(signals, RATE, 1024, overlap=0.5)
    # Hann at 50 %: correlation 1/36 between neighbours (Welch 1967).
    assert half.independent_averages == pytest.approx(15 / (1 + 2 * (14 / 15) / 36), rel=1e-3)


def test_a_short_record_is_refused():
    with pytest.raises(BenchError, match="record longer"):
        averaged_spectra(record(5, samples=2048), RATE, 1024, overlap=0.0)


def test_a_dead_channel_is_refused():
    signals = record(6, samples=8192)
    signals["x1"] = np.zeros(8192)
    with pytest.raises(BenchError, match="x1"):
        frf_estimate(averaged_spectra(signals, RATE, 1024), "f1", ("x1",))


def test_lines_go_to_the_resonances_and_not_to_noise_that_turns_the_phase():
    """A displacement resonates twice below 70 Hz and is noise beyond: most lines lie where its phase says something."""
    rate, seconds = 2500.0, 40.0
    time = np.arange(round(rate * seconds)) / rate
    rng = np.random.default_rng(3)
    drive = rng.standard_normal(time.size)
    frequency = np.fft.rfftfreq(time.size, 1.0 / rate)
    response = sum(1.0 / (f**2 - frequency**2 + 0.02j * f * frequency) for f in (14.0, 60.0))
    moved = np.fft.irfft(np.fft.rfft(drive) * response, time.size)
    noisy = moved + 1e-2 * np.std(moved) * rng.standard_normal(time.size)
    lines = choose_bins(drive, noisy, rate, 160) / seconds
    assert 100 < lines.size <= 160
    assert np.mean(lines < 100.0) > 0.5
    for f in (14.0, 60.0):  # a narrow one has as many as may stand on it
        assert np.min(np.abs(lines - f)) < 11.0 / seconds
