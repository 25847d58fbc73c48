"""Nonlinear modes of the self-excited rigs by a harmonic balance of numpy and scipy alone, nothing of the bench.

M ẍ + C ẋ + K x + f(x, ẋ) = ξ M ẋ with q² = X₁ᴴ M X₁ and δ̃ = ξ / (2 ω̃) (extended periodic motion concept). The figures
of the rigs stand here a second time, and so do their laws.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import odeint
from scipy.optimize import root

Force = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class SelfExcitedModel:
    """Matrices (n, n) and the force (n, …) that works against the motion, from displacements and velocities (n, …)."""

    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    force: Force


def van_der_pol() -> SelfExcitedModel:
    """The rig ``van_der_pol``."""
    return SelfExcitedModel(
        np.eye(1), np.array([[-15.08]]), np.array([[15791.4]]), lambda x, v: 2.4128e6 * x**2 * v + 5.0e7 * x**3
    )


def subcritical() -> SelfExcitedModel:
    """The rig ``subcritical``."""

    def force(x: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.array([5.0e7 * x[0] ** 3, (-3.6e6 * x[1] ** 2 + 1.78e11 * x[1] ** 4) * v[1]])

    return SelfExcitedModel(
        np.diag([1.0, 0.6]),
        np.array([[4.0, -4.0], [-4.0, 4.0 + 3.2]]),
        np.array([[25500.0 + 90000.0, -90000.0], [-90000.0, 90000.0]]),
        force,
    )


def belt() -> SelfExcitedModel:
    """The rig ``belt`` without its shaker; the mean friction is part of the rest position."""

    def curve(slip: np.ndarray | float) -> np.ndarray:
        return np.tanh(np.asarray(slip) / 0.0075) * (4.0 + 10.0 * np.exp(-np.abs(slip) / 0.15))

    return SelfExcitedModel(
        np.eye(1), np.array([[5.5]]), np.array([[15791.4]]), lambda x, v: curve(v - 0.45) - curve(-0.45)
    )


def nonlinear_mode(
    model: SelfExcitedModel, amplitudes: np.ndarray, harmonics: int = 15, samples: int = 4096
) -> tuple[np.ndarray, np.ndarray]:
    """ω̃ (rad/s) and δ̃ of the first mode at modal amplitudes q (m√kg), each of shape (k,).

    Alternating frequency/time with FFTs; each solution is the start of the next, all unknowns over q.
    """
    n = model.mass.shape[0]
    squares, shapes = np.linalg.eig(np.linalg.solve(model.mass, model.stiffness))
    first = int(np.argmin(squares))
    reference = float(np.sqrt(squares[first]))
    shape = shapes[:, first] / np.sqrt(shapes[:, first] @ model.mass @ shapes[:, first])
    orders = np.arange(harmonics + 1)

    def coefficients(z: np.ndarray) -> tuple[np.ndarray, float, float]:
        parts = z[:-2].reshape(n, 2 * harmonics + 1)
        wave = np.concatenate([parts[:, :1] + 0j, parts[:, 1 : harmonics + 1] + 1j * parts[:, harmonics + 1 :]], axis=1)
        return wave, reference * z[-2], reference * z[-1]

    def residual(z: np.ndarray, q: float) -> np.ndarray:
        wave, omega, excitation = coefficients(z)
        wave = q * wave
        spectrum = np.zeros((2, n, samples // 2 + 1), complex)
        spectrum[0, :, : harmonics + 1] = wave
        spectrum[1, :, : harmonics + 1] = 1j * orders * omega * wave
        spectrum[:, :, 1:] /= 2.0
        motion = np.fft.irfft(spectrum * samples, samples, axis=-1)
        forces = np.fft.rfft(model.force(motion[0], motion[1]), axis=-1)[:, : harmonics + 1] / samples
        forces[:, 1:] *= 2.0
        for order in orders:
            s = 1j * order * omega
            dynamic = s * s * model.mass + s * (model.damping - excitation * model.mass) + model.stiffness
            forces[:, order] += dynamic @ wave[:, order]
        forces /= q * reference**2
        norm = float((wave[:, 1].conj() @ model.mass @ wave[:, 1]).real) / q**2 - 1.0
        rows = [forces[:, :1].real, forces[:, 1:].real, forces[:, 1:].imag]
        return np.concatenate([np.concatenate(rows, axis=1).ravel(), [norm, wave[0, 1].imag / q]])

    parts = np.zeros((n, 2 * harmonics + 1))
    parts[:, 1] = shape
    z = np.concatenate([parts.ravel(), [1.0, 0.0]])
    found = []
    for q in amplitudes:
        solution = root(residual, z, args=(float(q),), method="hybr", options={"xtol": 1e-11})
        if np.abs(solution.fun).max() > 1e-7:
            raise ArithmeticError(f"no mode at q = {q:g}: {solution.message}")
        z = solution.x
        _, omega, excitation = coefficients(z)
        found.append((omega, excitation / (2.0 * omega)))
    result = np.array(found)
    return result[:, 0], result[:, 1]


def limit_cycle(model: SelfExcitedModel, start: float, seconds: float = 8.0) -> tuple[float, float]:
    """Amplitude q of the fundamental and angular frequency that the free motion settles at, by time integration.

    Args:
        model: the model.
        start: displacement of all masses at the start, m.
        seconds: of motion; the last tenth is looked at.
    """
    n = model.mass.shape[0]
    inverse = np.linalg.inv(model.mass)
    linear = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ model.stiffness, -inverse @ model.damping]])

    def rate(_: float, state: np.ndarray) -> np.ndarray:
        result = linear @ state
        result[n:] -= inverse @ model.force(state[:n], state[n:])
        return result

    begin = np.concatenate([np.full(n, start), np.zeros(n)])
    times = np.concatenate([[0.0], np.arange(0.9 * seconds, seconds, 1e-4)])
    states = odeint(rate, begin, times, tfirst=True, rtol=1e-9, atol=1e-12, hmax=2e-3, mxstep=1_000_000)
    motion = states[1:, :n].T
    swing = motion[0] - motion[0].mean()
    up = np.flatnonzero((swing[:-1] < 0.0) & (swing[1:] >= 0.0))
    crossings = up - swing[up] / (swing[up + 1] - swing[up])
    period = float((crossings[-1] - crossings[0]) / (crossings.size - 1)) * 1e-4
    count = crossings.size - 1
    place = np.arange(round(count * period / 1e-4))
    wave = np.exp(-2j * np.pi * place * 1e-4 / period)
    fundamental = 2.0 * (motion[:, up[0] : up[0] + place.size] * wave).mean(axis=1)
    return float(np.sqrt((fundamental.conj() @ model.mass @ fundamental).real)), 2.0 * np.pi / period
