"""What the kernels of periodic motions know of a rig: sensors, and the forces of all its local coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.numerics.kernels import njit
from nmt_diagnose.prediction.linear_model import LinearTables
from nmt_rig.model.aft import LocalTables, element_rows, forces_alone, local_forces
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.local_elements.element import LocalElement

# Columns of the table of sensor chains, see `rig_parts.channel_table`.
GAIN, DELAY, LOW_PASS, HIGH_PASS = 0, 1, 2, 3
# Places of G b₁ and G b₂ in the force factor.
FACTOR_LINEAR, FACTOR_QUADRATIC = 1, 2


class RigTables(NamedTuple):
    """What the kernels know of a rig, see `RigParts.kernel_tables`.

    Attributes:
        model: the linear part.
        channels: sensor chains of the channels (c, 4).
        factor: G, G b₁, G b₂.
        local: the local elements and their basis.
    """

    model: LinearTables
    channels: FloatArray
    factor: FloatArray
    local: LocalTables


class Forces(NamedTuple):
    """Forces of all local coordinates.

    Attributes:
        amounts: real Fourier coefficients (r, size).
        slopes: their derivatives by all coefficients of the coordinates (r, size, r · size); empty = not wanted.
        by_omega: by ω (r, size).
    """

    amounts: FloatArray
    slopes: FloatArray
    by_omega: FloatArray


@njit(cache=True)
def sensor_gain(s: complex, chain: FloatArray) -> tuple[complex, complex]:
    """Complex gain of a sensor's chain (4,) at s = iω, and its derivative with respect to s."""
    gain, delay, low_pass, high_pass = chain[GAIN], chain[DELAY], chain[LOW_PASS], chain[HIGH_PASS]
    low = 1.0 / (1.0 + s * low_pass)
    value = gain * np.exp(-s * delay) * low
    slope = value * (-delay - low_pass * low)
    if high_pass > 0.0:
        high = s / (s + high_pass)
        slope = slope * high + value * high_pass / (s + high_pass) ** 2
        value = value * high
    return value, slope


@njit(cache=True)
def channel_gains(s: complex, channels: FloatArray) -> ComplexArray:
    """Complex gains (c,) of the sensors' chains (c, 4) at s."""
    result = np.empty(channels.shape[0], dtype=np.complex128)
    for k in range(channels.shape[0]):
        result[k] = sensor_gain(s, channels[k])[0]
    return result


@njit(cache=True)
def factor_forces(
    coil: FloatArray,
    current: FloatArray,
    omega: float,
    factor: FloatArray,
    values: FloatArray,
    slopes: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Forces of the position-dependent part of the force factor, G(x) − G = G b₁ x + G b₂ x².

    Returns:
        coefficients of −(G(x) − G) i on the coil and of (G(x) − G) ẋ in the circuit (2, size), their derivatives with
        respect to coil displacement and current (2, size, 2 · size), and to ω (2, size).
    """
    linear, quadratic = factor[FACTOR_LINEAR], factor[FACTOR_QUADRATIC]
    size = coil.size
    samples = values.shape[0]
    force = np.zeros((2, size))
    derivative = np.zeros((2, size, 2 * size))
    by_frequency = np.zeros((2, size))
    for j in range(samples):
        x = 0.0
        i = 0.0
        dx = 0.0
        for a in range(size):
            x += values[j, a] * coil[a]
            i += values[j, a] * current[a]
            dx += slopes[j, a] * coil[a]
        change = linear * x + quadratic * x * x
        change_slope = linear + 2.0 * quadratic * x
        for a in range(size):
            weight = (2.0 if a > 0 else 1.0) * values[j, a] / samples
            force[0, a] -= weight * change * i
            force[1, a] += weight * change * omega * dx
            by_frequency[1, a] += weight * change * dx
            for b in range(size):
                derivative[0, a, b] -= weight * change_slope * i * values[j, b]
                derivative[0, a, size + b] -= weight * change * values[j, b]
                derivative[1, a, b] += weight * omega * (change_slope * dx * values[j, b] + change * slopes[j, b])
    return force, derivative, by_frequency


@njit(cache=True)
def harmonic_forces(
    displacement: FloatArray, omega: float, factor: FloatArray, tables: LocalTables, sloped: bool
) -> Forces:
    """Forces of all local coordinates: local elements first, then the nonlinear force factor if there is one.

    Args:
        displacement: (r, size) real Fourier coefficients of the coordinates.
        omega: rad/s.
        factor: G, G b₁, G b₂.
        tables: the local elements and their basis.
        sloped: with derivatives, which cost many times as much.
    """
    r, size = displacement.shape
    elements = tables.jenkins_start.size - 1
    g = np.zeros((r, size))
    dg = np.zeros((r, size, r * size if sloped else 0))
    g_omega = np.zeros((r, size))
    if sloped:
        force, derivative, by_frequency = local_forces(displacement[:elements], omega, tables)
        for i in range(elements):
            g[i] = force[i]
            g_omega[i] = by_frequency[i]
            for a in range(size):
                for b in range(size):
                    dg[i, a, i * size + b] = derivative[i, a, b]
    else:
        g[:elements] = forces_alone(displacement[:elements], omega, tables)
    if r > elements:
        pair, pair_derivative, pair_frequency = factor_forces(
            displacement[r - 2], displacement[r - 1], omega, factor, tables.values, tables.slopes
        )
        for i in range(2):
            g[r - 2 + i] = pair[i]
            g_omega[r - 2 + i] = pair_frequency[i]
            if sloped:
                dg[r - 2 + i, :, (r - 2) * size :] = pair_derivative[i]
    return Forces(g, dg, g_omega)


@njit(cache=True)
def any_nonlinear(factor: FloatArray, tables: LocalTables) -> bool:
    """Whether any force of the local coordinates is there at all: those that are linear are not among them."""
    elements = tables.jenkins.shape[0] + tables.contacts.shape[0] + tables.kinds.size
    return bool(elements > 0 or factor[FACTOR_LINEAR] != 0.0 or factor[FACTOR_QUADRATIC] != 0.0)


@lru_cache(maxsize=16)
def _sampled(highest: int, samples: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    basis = FourierBasis.up_to(highest)
    return basis.sampled(samples), basis.sampled_slope(samples), basis.sampled_slope(max(64, 8 * highest))


def local_tables(groups: Sequence[Sequence[LocalElement]], basis: FourierBasis, samples: int | None) -> LocalTables:
    """Tables of the elements of each coordinate (an empty group is a coordinate without force).

    Args:
        groups: elements of each coordinate.
        basis: orders 0 … H.
        samples: samples per period of smooth elements; None = from their kinds.

    Raises:
        BenchError: a kind without harmonic balance.
    """
    highest = int(basis.orders[-1])
    rows, needed = element_rows(groups, highest, 4 * highest + 4, fitted=True)
    values, slopes, slope_basis = _sampled(highest, needed if samples is None else samples)
    return LocalTables(basis.orders, basis.offsets, slope_basis, *rows, values, slopes)
