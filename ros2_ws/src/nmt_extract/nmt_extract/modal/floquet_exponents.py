"""Floquet exponents of a measured orbit from a small perturbation of its drive.

Once a period T of the orbit the fundamentals of force and response at the drive point, in the frame of the mean
frequency, differ by u_k and y_k (real and imaginary parts) from those of the orbit. A system with period T, looked at
once a period, does not vary with time (Bittanti and Colaneri, Periodic Systems, 2009, chapter 2), so that

    z_{k+1} = A z_k + Σ_j B_j u_{k+j},    y_k = z_k + noise,    j = −1 … 2,

for the one mode that two real numbers can tell; the other orders j are what the force does within its periods, and what
stiff modes follow at once. The multipliers are the eigenvalues of A, the exponents λ = ln(eig A) / T. The force is the
measured one, so that it does not matter what the phase loop does meanwhile: the exponents are those without it.

A is fitted by least squares of the output error; everything else is linear in it and eliminated (variable projection,
Golub and Pereyra 1973). The standard uncertainty has the scatter about the fit, half of the change without the order
j = 2, and a tenth of one over the window: other modes answer to the beginning of the perturbation, of which two numbers
know nothing. Next to a mode with the exponents −3.8 ± 2.7i 1/s an exponent of −0.30 1/s was 0.044, 0.023 and 0.004 1/s
off in windows of 2, 4 and 8 s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.kinds import FLOQUET_PERIODS
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_signals.harmonics import segment_moments, solve_moments, whole_period_bounds

_ORDERS = (-1, 0, 1, 2)
_FEWER = (-1, 0, 1)
_HARMONICS = 5
_RESOLUTION = 0.1  # of one over the window, by which an exponent is off next to another mode
_LEAST_SAMPLES = 2 * _HARMONICS + 4
"""Samples of a period without which its fundamental is not told from its neighbours."""


@dataclass(frozen=True)
class FloquetExponents:
    """The two exponents of the mode that is driven.

    Attributes:
        growth, growth_std: largest real part, 1/s; the orbit is stable below zero.
        frequency, frequency_std: size of the imaginary part, rad/s; 0 = both are real.
        second_growth, second_growth_std: the other real part, 1/s.
    """

    growth: float
    growth_std: float
    frequency: float
    frequency_std: float
    second_growth: float
    second_growth_std: float

    @property
    def fields(self) -> dict[str, float]:
        """As a modal point has them."""
        return {f"floquet_{name}": value for name, value in vars(self).items()}


def floquet_exponents(
    force: FloatArray, response: FloatArray, cycles: FloatArray, advance: float, duration: float
) -> FloquetExponents:
    """Exponents of the orbit of a window whose drive was perturbed.

    Args:
        force, response: at the drive point, any unit, ``(samples,)``.
        cycles: phase of the excitation at each sample, cycles, ``(samples,)``.
        advance: of the phase over the window, cycles.
        duration: of the window, s.

    Raises:
        BenchError: too few periods or samples, or no perturbation that tells anything.
    """
    periods = round(advance)
    if periods < FLOQUET_PERIODS:
        raise BenchError(
            f"Floquet exponents need {FLOQUET_PERIODS} periods in a window, this one has {periods}; give --periods "
            f"{FLOQUET_PERIODS} or more."
        )
    if force.size < _LEAST_SAMPLES * periods:
        raise BenchError(
            f"Floquet exponents need {_LEAST_SAMPLES} samples in a period, this window has "
            f"{force.size / periods:.3g}; raise the sample rate."
        )
    steady = cycles[0] + advance * np.arange(force.size) / force.size
    bounds = whole_period_bounds(steady - steady[0], periods, periods)
    found = solve_moments(segment_moments(steady, np.array([force, response]), _HARMONICS, bounds))[:, :, 1]
    inputs, outputs = _deviations(found[:, 0]), _deviations(found[:, 1])
    if not (inputs.any() and outputs.any()):
        raise BenchError("The force or the response did not change within the window, which tells no exponents.")
    period = duration / periods
    matrix, root = _fit(inputs, outputs, _ORDERS)
    fewer, _ = _fit(inputs, outputs, _FEWER)
    values, other = _values(matrix, period), _values(fewer, period)
    spread = np.array([0.5 * (_values(matrix + d, period) - _values(matrix - d, period)) for d in root])
    # Real exponents have no imaginary part to be resolved.
    resolution = _RESOLUTION / duration * np.array([1.0, float(values[1] != 0.0), 1.0])
    stds = np.sqrt((spread**2).sum(axis=0) + (0.5 * (other - values)) ** 2 + resolution**2)
    return FloquetExponents(*(float(x) for pair in zip(values, stds, strict=True) for x in pair))


def _deviations(fundamental: ComplexArray) -> FloatArray:
    """Real and imaginary parts about their mean over the largest of them, ``(periods, 2)``."""
    found = np.column_stack([fundamental.real, fundamental.imag])
    found = found - found.mean(axis=0)
    size = float(np.abs(found).max())
    return np.asarray(found / size if size > 0.0 else found)


def _values(matrix: FloatArray, period: float) -> FloatArray:
    """Largest real part, size of the imaginary part, other real part; 1/s and rad/s."""
    multipliers = np.linalg.eigvals(matrix).astype(np.complex128)
    found = np.log(np.where(np.abs(multipliers) > 0.0, multipliers, 1e-12)) / period
    return np.array([found.real.max(), float(np.abs(found.imag).max()), found.real.min()])


def _fit(inputs: FloatArray, outputs: FloatArray, orders: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    """A, and a square root of its covariance as matrices, ``(4, 2, 2)``."""
    first, last = -min(orders), inputs.shape[0] - max(orders)
    driven = np.column_stack([inputs[first + j : last + j] for j in orders] + [np.ones(last - first)])
    target = outputs[first : last + 1]
    start = np.column_stack([target[:-1], driven])
    guess = np.linalg.lstsq(start, target[1:], rcond=None)[0][:2].T

    def residual(values: FloatArray) -> FloatArray:
        basis = _responses(values.reshape(2, 2), driven).reshape(target.size, -1)
        right = target.ravel()
        q, _ = np.linalg.qr(basis / np.maximum(np.abs(basis).max(axis=0), 1e-300))
        return np.asarray(right - q @ (q.T @ right))

    from scipy.optimize import least_squares  # late: most windows have no perturbation

    best = least_squares(residual, guess.ravel(), method="lm", x_scale=0.1, max_nfev=200)
    freedom = max(1, target.size - 6 - 2 * driven.shape[1])
    _, sizes, turns = np.linalg.svd(best.jac, full_matrices=False)
    scale = math.sqrt(float(best.fun @ best.fun) / freedom)
    root = scale * turns / np.maximum(sizes, 1e-12)[:, np.newaxis]
    return np.asarray(best.x.reshape(2, 2)), np.asarray(root.reshape(4, 2, 2))


def _responses(matrix: FloatArray, driven: FloatArray) -> FloatArray:
    """Outputs over time of every unit start and of every input into each row, ``(steps + 1, 2, 2 + 2 inputs)``."""
    steps, columns = driven.shape
    found = np.zeros((steps + 1, 2, 2 + 2 * columns))
    found[0, :, :2] = np.eye(2)
    for k in range(steps):
        following = matrix @ found[k]
        following[0, 2 : 2 + columns] += driven[k]
        following[1, 2 + columns :] += driven[k]
        found[k + 1] = following
    return found
