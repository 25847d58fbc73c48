"""Linear test with two exciters at once: closed form of two modes 2 % apart, noise, dependent inputs."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_extract.several_inputs import partial_coherence, responses_of_inputs, several_inputs_test
from nmt_record.windows.segments import Signals
from nmt_signals.frequency_responses import averaged_spectra

RATE, SECONDS = 2000.0, 40.0
FREQUENCIES, ZETA = np.array([100.0, 102.0, 260.0]), np.array([0.003, 0.004, 0.005])
SHAPES = np.array([[0.45, 0.55, 0.5], [0.6, -0.4, -0.4], [0.4, 0.5, -0.5]])
BAND = (20.0, 600.0)


def motion_of(forces):
    """Accelerations (points, samples) under forces (inputs, samples) that are straight between the samples.

    Each mode's equation is stepped by the matrix exponential of [η, η̇, f, ḟ].
    """
    from scipy.linalg import expm

    result = np.zeros((3, forces.shape[1]))
    for k in range(3):
        omega = 2 * np.pi * FREQUENCIES[k]
        modal = SHAPES[: forces.shape[0], k] @ forces
        matrix = np.zeros((4, 4))
        matrix[0, 1], matrix[1, 0], matrix[1, 1], matrix[1, 2] = 1.0, -(omega**2), -2 * ZETA[k] * omega, 1.0
        matrix[2, 3] = 1.0
        step = expm(matrix / RATE)[:2]
        state = np.zeros(2)
        slope = np.diff(modal, append=modal[-1]) * RATE
        acceleration = np.empty(modal.size)
        for n in range(modal.size):
            acceleration[n] = modal[n] - 2 * ZETA[k] * omega * state[1] - omega**2 * state[0]
            state = step @ np.array([state[0], state[1], modal[n], slope[n]])
        result += SHAPES[:, k : k + 1] * acceleration
    return result


@pytest.fixture(scope="module")
def record():
    generator = np.random.default_rng(5)
    samples = round(RATE * SECONDS)
    spectrum = np.fft.rfft(generator.standard_normal((2, samples)))
    lines = np.fft.rfftfreq(samples, 1.0 / RATE)
    spectrum[:, (lines < BAND[0]) | (lines > BAND[1])] = 0.0
    forces = np.fft.irfft(spectrum, samples)
    return forces, motion_of(forces)


def signals(forces, responses, noise=0.0):
    generator = np.random.default_rng(9)
    channels = {"f1": forces[0], "f2": forces[1], "u": 0.5 * forces[0], "u2": 0.25 * forces[1] + 0.1 * forces[0]}
    for row, values in enumerate(responses):
        channels[f"a{row + 1}"] = values + noise * values.std() * generator.standard_normal(values.size)
    kinds = {"f": Quantity.FORCE, "u": Quantity.VOLTAGE, "a": Quantity.ACCELERATION}
    points = {name: 0 if name[0] == "u" else int(name[1:]) for name in channels}
    quantities = {name: kinds[name[0]] for name in channels}
    units = {name: kind.unit for name, kind in quantities.items()}
    return Signals(RATE, 0, channels, units, points, quantities, None, ())


def evaluated(recorded, start=((100.0, 0.003), (102.0, 0.003)), target=0):
    return several_inputs_test(recorded, (1, 2), BAND, [start], target, Quantity.ACCELERATION)


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_both_modes_are_found(record, noise):
    test = evaluated(signals(*record, noise), [(99.7, 0.005), (102.5, 0.005)], 1)
    np.testing.assert_allclose(test.modes.frequencies_hz, FREQUENCIES[:2], rtol=1e-4)
    np.testing.assert_allclose(test.modes.damping_ratios, ZETA[:2], rtol=0.01)
    np.testing.assert_allclose(test.shapes, SHAPES[:, :2], atol=0.01)
    assert (test.modes.frequency_stds < 0.01).all()
    described = test.description()
    assert described.exciter_points == (1, 2)
    assert described.target_mode == 1
    # u1 = 0.5 f1 and u2 = 0.25 f2 + 0.1 f1: f1 = 2 u1, f2 = 4 u2 − 0.8 u1.
    exact = np.broadcast_to([[2.0, 0.0], [-0.8, 4.0]], test.force_per_volt.shape)
    np.testing.assert_allclose(test.force_per_volt, exact, atol=1e-6)


def test_responses_and_coherence_are_those_of_each_input(record):
    forces, responses = record
    generator = np.random.default_rng(2)
    noisy = 3.0 * forces[1] + generator.standard_normal(forces.shape[1])
    channels = {"f1": forces[0], "f2": forces[1], "a": responses[0], "b": noisy}
    spectra = averaged_spectra(channels, RATE, 8000, BAND)
    h = responses_of_inputs(spectra, ("a", "b"), ("f1", "f2"))
    away = np.abs(spectra.frequency_hz - 160.0) < 20.0
    s = 2j * np.pi * spectra.frequency_hz[away]
    poles = [s * s / (s * s + 2 * z * w * s + w * w) for w, z in zip(2 * np.pi * FREQUENCIES, ZETA, strict=True)]
    for column in (0, 1):
        exact = sum(SHAPES[0, k] * SHAPES[column, k] * poles[k] for k in range(3))
        np.testing.assert_allclose(h[0, column, away], exact, rtol=0.05, atol=0.01)
    coherence = partial_coherence(spectra, ("a", "b"), ("f1", "f2"))
    assert coherence[0].mean() > 0.97
    assert np.median(coherence[1, 0]) < 0.1  # b knows nothing of f1
    assert np.median(coherence[1, 1]) > 0.5


def test_inputs_that_depend_on_each_other_are_refused(record):
    forces, responses = record
    same = np.array([forces[0], 2.0 * forces[0]])
    with pytest.raises(BenchError, match="not independent"):
        evaluated(signals(same, responses))


def test_an_inverted_force_is_refused(record):
    forces, responses = record
    with pytest.raises(BenchError, match="wrong sign"):
        evaluated(signals(-forces, responses))
