"""Rational fit of whole records: exact on its own class, unbiased on records, uncertainties against scatter."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_signals.rational_fit import fit_rational, structure_mode

RATE, SAMPLES = 500.0, 10_000
STRUCTURE = (2 * np.pi * 30.0, 0.005)
PLANT = (2 * np.pi * 29.0, 0.03)


def channels(seed: int, noise: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Spectra of voltage, and of force and displacement of 1 kg at its drive point, cut out of a longer record.

    Voltage → force has the structure's poles as zeros and the plant's as poles; so displacement over force is that of
    the structure. What is cut out begins and ends amid vibration.
    """
    random = np.random.default_rng(seed)
    longer = 2 * SAMPLES
    s = 2j * np.pi * np.fft.rfftfreq(longer, 1 / RATE)
    voltage = random.standard_normal(longer)
    drive = np.fft.rfft(voltage)

    def quadratic(omega: float, damping: float) -> np.ndarray:
        return s**2 + 2 * damping * omega * s + omega**2

    responses = [quadratic(*STRUCTURE) / quadratic(*PLANT), 1 / quadratic(*PLANT)]
    part = slice(SAMPLES // 3, SAMPLES // 3 + SAMPLES)
    outputs = np.array([np.fft.irfft(h * drive, longer)[part] for h in responses])
    outputs = outputs + noise * np.std(outputs, axis=1, keepdims=True) * random.standard_normal(outputs.shape)
    return np.fft.rfft(voltage[part]), np.fft.rfft(outputs), np.fft.rfftfreq(SAMPLES, 1 / RATE)


def found(seed: int, noise: float):
    u, y, f = channels(seed, noise)
    fit = fit_rational(u, y, f, 30.1, 4.0)
    return fit, structure_mode(fit, 30.1 * (1 + 0.01j), [0])


def test_a_record_without_noise_gives_structure_and_plant_whatever_its_ends():
    fit, mode = found(1, 0.0)
    eigenvalue = mode.eigenvalue
    assert abs(eigenvalue) == pytest.approx(STRUCTURE[0], rel=1e-6)
    assert -eigenvalue.real / abs(eigenvalue) == pytest.approx(STRUCTURE[1], rel=1e-4)
    plant = fit.eigenvalues[0]
    assert abs(plant) == pytest.approx(PLANT[0], rel=1e-5)
    assert -plant.real / abs(plant) == pytest.approx(PLANT[1], rel=1e-4)
    # Receptance 1/(s² + 2ζωs + ω²) of 1 kg: residue 1/(2iω_d).
    assert 2j * eigenvalue.imag * mode.residues[0] == pytest.approx(1.0, rel=2e-4)


def test_the_force_as_input_gives_the_same_where_there_is_no_noise():
    _, y, f = channels(2, 0.0)
    fit = fit_rational(y[0], y[1:], f, 30.1, 4.0)
    mode = structure_mode(fit, 30.1 * (1 + 0.01j))
    assert abs(mode.eigenvalue) == pytest.approx(STRUCTURE[0], rel=1e-6)
    assert 2j * mode.eigenvalue.imag * mode.residues[0] == pytest.approx(1.0, rel=2e-4)


def test_noise_of_the_force_biases_the_force_as_input_but_not_the_voltage():
    damping = []
    for with_voltage in (True, False):
        values = []
        for seed in range(4):
            u, y, f = channels(seed, 0.0)
            noise = np.random.default_rng(100 + seed).standard_normal((2, f.size))
            y[0] += 0.3 * np.sqrt(np.mean(np.abs(y[0][np.abs(f - 30) < 4]) ** 2)) * (noise[0] + 1j * noise[1])
            fit = fit_rational(u, y, f, 30.1, 4.0) if with_voltage else fit_rational(y[0], y[1:], f, 30.1, 4.0)
            eigenvalue = structure_mode(fit, 30.1 * (1 + 0.01j), [0] if with_voltage else []).eigenvalue
            values.append(-eigenvalue.real / abs(eigenvalue) / STRUCTURE[1] - 1.0)
        damping.append(np.mean(values))
    assert abs(damping[0]) < 0.2
    assert damping[1] > 0.5  # H1: the resonance where the force drops out is flattened


def test_stated_uncertainties_are_the_scatter_over_seeds():
    normalised = []
    for seed in range(30):
        fit, mode = found(seed, 0.02)
        truth = STRUCTURE[0] * (-STRUCTURE[1] + 1j * np.sqrt(1 - STRUCTURE[1] ** 2))
        exact = np.array([truth, 1 / (2j * truth.imag)])
        std = np.sqrt(np.diagonal(mode.covariance).real / 2)
        errors = (np.array([mode.eigenvalue, *mode.residues.ravel()]) - exact) / std
        plant = PLANT[0] * (-PLANT[1] + 1j * np.sqrt(1 - PLANT[1] ** 2))
        plant_std = 2 * np.pi * fit.half_width_hz * np.sqrt(fit.covariance[0, 0].real / 2)
        plant_error = (fit.eigenvalues[0] - plant) / plant_std
        normalised.append([part for error in (*errors, plant_error) for part in (error.real, error.imag)])
    spread = np.sqrt(np.mean(np.square(normalised), axis=0))
    # 30 draws: the standard deviation of a standard deviation is 13 %.
    assert np.all(spread > 0.6)
    assert np.all(spread < 1.5)


def test_too_few_lines_and_silence_are_refused():
    u, y, f = channels(1, 0.0)
    with pytest.raises(BenchError, match="record longer"):
        fit_rational(u, y, f, 30.0, 0.3)
    with pytest.raises(BenchError, match="no signal"):
        fit_rational(u, 0.0 * y, f, 30.0, 4.0)
