"""A vibration whose amplitude grows or decays fast: phasors of a short window, and the mode's properties in it.

All channels are fitted over the window by the same oscillation,

    x(t₀ + τ) = Re[(a₀ + a₁ τ + a₂ τ² + a₃ τ³) e^{s₀ τ}] + harmonics + c₀ + c₁ τ,        s₀ = g₀ + i Ω₀,

weighted least squares with a Hann window; harmonics go with the powers of e^{g₀ τ}. s₀ is iterated until a₁ of the
motion along its own shape vanishes, so exponential growth is met exactly, whatever its rate. From a₀, a₁, a₂ follow the
phasor, its s = a₁/a₀ + s₀ = ẋ/x and ṡ.

A mode whose amplitude q and s = g + iΩ change under the modal force φ̃₁ᴴF obeys

    s² + ṡ + 2 δ̃ ω̃ s + ω̃² = F ψ̄_d / q²,

so that, real and imaginary part,

    2 δ̃ ω̃ = Im(F ψ̄_d)/(Ω q²) − 2 g − Ω̇/Ω,        ω̃² = Ω² − g² − ġ − 2 δ̃ ω̃ g + Re(F ψ̄_d)/q².

The first term on the right is the balance of power of :mod:`nmt_extract.modal.power_balance`. q is the norm of Φ⁺ψ, as
at phase resonance (paper, eq. 4).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import ComplexArray, FloatArray

_ITERATIONS = 8


@dataclass(frozen=True, eq=False)
class Phasors:
    """Fit of one window.

    Attributes:
        exponent: s₀, rad/s.
        coefficients: a₀, a₁, a₂, shape ``(channels, 3)``.
        covariance: of (Re a₀, Im a₀, Re a₁, …) for unit white noise, shape ``(6, 6)``.
        noise: standard deviation of each channel's residual, shape ``(channels,)``.
    """

    exponent: complex
    coefficients: ComplexArray
    covariance: FloatArray
    noise: FloatArray


def fit_phasors(data: FloatArray, sample_rate: float, exponent: complex, harmonics: int = 3) -> Phasors:
    """Oscillation of all channels over a window, about its middle.

    Args:
        data: shape ``(channels, samples)``.
        sample_rate: Hz.
        exponent: s₀, rad/s.
        harmonics: highest order.

    Raises:
        BenchError: more unknowns than samples.
    """
    samples = data.shape[1]
    time = (np.arange(samples) - 0.5 * (samples - 1)) / sample_rate
    scale = 0.5 * samples / sample_rate
    place = time / scale
    wave = np.exp(exponent * time)
    columns = []
    for power in range(4):
        columns += [place**power * wave.real, -(place**power) * wave.imag]
    for order in range(2, harmonics + 1):
        if order * abs(exponent.imag) >= math.pi * sample_rate:
            break
        high = np.exp((order * exponent.real + 1j * order * exponent.imag) * time)
        columns += [high.real, -high.imag]
    columns += [np.ones(samples), place]
    design = np.stack(columns, axis=1)
    if samples <= design.shape[1] + 2:
        raise BenchError(f"A window of {samples} samples is too short for an oscillation.")
    weight = np.sin(math.pi * (np.arange(samples) + 0.5) / samples) ** 2
    weighted = design * weight[:, None]
    inverse = np.linalg.inv(design.T @ weighted)
    filters = inverse @ weighted.T
    solution = filters @ data.T
    residual = data.T - design @ solution
    degrees_of_freedom = float(weight.sum() - np.sum(filters.T * weighted))
    noise = np.sqrt(np.maximum(weight @ residual**2, 0.0) / degrees_of_freedom)
    powers = np.repeat(scale ** -np.arange(3.0), 2)
    covariance = (filters @ filters.T)[:6, :6] * np.outer(powers, powers)
    parts = solution[:6].T * powers
    return Phasors(exponent, parts[:, 0::2] + 1j * parts[:, 1::2], covariance, noise)


def window_fit(
    data: FloatArray,
    sample_rate: float,
    middle: float,
    length: float,
    exponent: complex,
    inverse: FloatArray,
    harmonics: int,
) -> tuple[Phasors, complex, float] | None:
    """Fit of a window with its exponent iterated, that exponent and the middle (s); None if nothing oscillates."""
    samples = min(round(length * sample_rate), data.shape[1])
    first = min(max(0, round(middle * sample_rate - 0.5 * samples)), data.shape[1] - samples)
    part = data[:, first : first + samples]
    fit = fit_phasors(part, sample_rate, exponent, harmonics)
    for _ in range(_ITERATIONS):
        modal = inverse @ fit.coefficients[1:]
        # The change that makes a₁ of the motion along its own shape vanish.
        change = complex(np.vdot(modal[:, 0], modal[:, 1]) / np.vdot(modal[:, 0], modal[:, 0]).real)
        exponent += change
        if not (math.isfinite(exponent.real) and exponent.imag > 0.0 and abs(exponent.real) < exponent.imag):
            return None
        fit = fit_phasors(part, sample_rate, exponent, harmonics)
        if abs(change) < 1e-9 * abs(exponent):
            break
    return fit, exponent, (first + 0.5 * (samples - 1)) / sample_rate


def modal_row(fit: Phasors, inverse: FloatArray, drive: int, order: int) -> tuple[tuple[float, ...], float]:
    """Values of a window after its time, and the relative standard uncertainty of the damping ratio.

    Uncertainties by first-order propagation of the residual's white noise.
    """
    modal = inverse @ fit.coefficients[1:, 0]
    size = float(np.linalg.norm(modal))
    along = (modal.conj() / size) @ inverse
    tracked = (along @ fit.coefficients[1:]) / size
    shape_drive = fit.coefficients[1 + drive, 0] / size
    force = fit.coefficients[0, 0]
    noise = float(np.linalg.norm(along * fit.noise[1:])) / size
    at = np.array([*np.stack((tracked.real, tracked.imag), axis=1).ravel(), force.real, force.imag])
    covariance = np.zeros((8, 8))
    covariance[:6, :6] = noise**2 * fit.covariance
    covariance[6:, 6:] = fit.noise[0] ** 2 * fit.covariance[:2, :2]

    def values(point: FloatArray) -> FloatArray:
        return _modal_values(point, fit.exponent, size, shape_drive, order)

    found = values(at)
    jacobian = _jacobian(values, at, np.sqrt(np.diag(covariance)))
    std = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian), 0.0))
    q, omega, damping, apparent_omega, apparent_damping = (float(value) for value in found)
    row = (
        q, omega, std[1], damping, std[2], apparent_omega, std[3], apparent_damping, std[4], float(abs(force))
    )  # fmt: skip
    relative = std[2] / abs(damping) if damping else math.inf
    return tuple(float(value) for value in row), float(relative)


def _modal_values(point: FloatArray, exponent: complex, size: float, shape_drive: complex, order: int) -> FloatArray:
    """q, ω̃, δ̃, apparent ω̃ and δ̃ from (a₀, a₁, a₂ over the size of a₀, force)."""
    zero, one, two, force = point[0::2] + 1j * point[1::2]
    ratio = one / zero
    s = exponent + ratio
    change = 2.0 * two / zero - ratio**2
    # The displacement is the response divided by this operator, whose own change shifts s a little.
    operator = 1.0 if order == 0 else s if order == 1 else s * s + change
    s = s - order * change / s
    growth, omega = s.real, s.imag
    q = size * abs(zero) / abs(operator)
    displacement = size * shape_drive * zero / operator
    modal_force = force * displacement.conjugate() / q**2

    def properties(stiffness: complex) -> tuple[float, float]:
        twice = stiffness.imag / omega - 2.0 * growth - change.imag / omega
        square = omega**2 - growth**2 - change.real - twice * growth + stiffness.real
        frequency = math.sqrt(max(square, 1e-300))
        return frequency, twice / (2.0 * frequency)

    return np.array([q, *properties(modal_force), *properties(0j)])


def _jacobian(function: Callable[[FloatArray], FloatArray], at: FloatArray, steps: FloatArray) -> FloatArray:
    """∂f_i/∂x_j by central differences with steps of the size of the uncertainties."""
    columns = []
    for k in range(at.size):
        step = max(1e-3 * float(steps[k]), 1e-9 * float(np.abs(at).max()))
        move = np.zeros(at.size)
        move[k] = step
        columns.append((function(at + move) - function(at - move)) / (2.0 * step))
    return np.stack(columns, axis=1)
