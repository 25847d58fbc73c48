"""Floquet multipliers of periodic responses: how a small perturbation grows in one period.

Around a periodic motion with local displacements w_j(t) a perturbation y obeys

    M ÿ + (C + Σ_j ∂g_j/∂v d_j d_jᵀ) ẏ + (K + Σ_j ∂g_j/∂w d_j d_jᵀ) y = 0

with slopes that repeat with the period T. With the state z = (y, ẏ), ż = A(t) z, the matrix that takes z(0) to z(T) is
a product of exponentials (Magnus expansion of fourth order; Hairer, Lubich and Wanner, Geometric Numerical Integration,
section IV.7): over a step h with A₁, A₂ at its two Gauss points, exp(h (A₁ + A₂) / 2 + √3 h² [A₂, A₁] / 12). Its
eigenvalues are the multipliers; the motion is stable where all are within the unit circle.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import expm

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_rig.model.assembly import ElectromechanicalSystem
from nmt_rig.model.forced_response import PeriodicResponse
from nmt_rig.model.local_elements.element import LocalElement

STEPS = 256
"""Steps of a period."""


def floquet_multipliers(
    system: ElectromechanicalSystem, response: PeriodicResponse, steps: int = STEPS
) -> ComplexArray:
    """Multipliers (2 n,) of a periodic response, the largest first.

    Args:
        system: the structure under an ideal force, of n degrees of freedom.
        response: the motion, harmonic by harmonic.
        steps: of a period.

    Raises:
        BenchError: an element has a memory, or an unknown has no inertia.
    """
    if any(element.sliders for element in system.elements):
        raise BenchError(
            "Floquet multipliers are not computed for friction, whose slider has a memory; the stability follows from "
            "the direction of the branch between its folds."
        )
    n = system.size
    if not np.all(np.diag(system.mass) > 0.0):
        raise BenchError("Floquet multipliers need inertia in every unknown; take the structure without its exciter.")
    period = 2.0 * math.pi / response.angular_frequency
    h = period / steps
    places = np.array([0.5 - math.sqrt(3.0) / 6.0, 0.5 + math.sqrt(3.0) / 6.0])
    times = h * (np.arange(steps)[:, np.newaxis] + places)
    matrices = _matrices(system, response, times.ravel()).reshape(steps, 2, 2 * n, 2 * n)
    first, second = matrices[:, 0], matrices[:, 1]
    commutator = second @ first - first @ second
    exponentials = expm(0.5 * h * (first + second) + math.sqrt(3.0) / 12.0 * h**2 * commutator)
    whole = np.eye(2 * n)
    for factor in exponentials:
        whole = factor @ whole
    found = np.linalg.eigvals(whole)
    return np.asarray(found[np.argsort(-np.abs(found))], dtype=np.complex128)


def _matrices(system: ElectromechanicalSystem, response: PeriodicResponse, times: FloatArray) -> FloatArray:
    """A at the times (s), (times, 2 n, 2 n)."""
    n = system.size
    turning = np.exp(1j * np.outer(times * response.angular_frequency, response.orders))
    speeds = 1j * response.orders * response.angular_frequency
    inverse = np.linalg.inv(system.mass)
    matrices = np.zeros((times.size, 2 * n, 2 * n))
    matrices[:, :n, n:] = np.eye(n)
    matrices[:, n:, :n] = -inverse @ system.stiffness
    matrices[:, n:, n:] = -inverse @ system.damping
    for element in system.elements:
        direction = np.zeros(n)
        direction[: element.direction.size] = element.direction
        along = response.unknowns @ direction
        motion, velocity = (turning @ along).real, (turning @ (speeds * along)).real
        slopes = np.array([_slopes(element, w, v) for w, v in zip(motion.tolist(), velocity.tolist(), strict=True)])
        outer = np.outer(inverse @ direction, direction)
        matrices[:, n:, :n] -= slopes[:, 0, np.newaxis, np.newaxis] * outer
        matrices[:, n:, n:] -= slopes[:, 1, np.newaxis, np.newaxis] * outer
    return matrices


def _slopes(element: LocalElement, w: float, v: float) -> tuple[float, float]:
    """∂g/∂w (N/m) and ∂g/∂v (N s/m) at a displacement (m) and a velocity (m/s)."""
    if hasattr(element, "frozen"):
        branch = element.next_branch(*element.values, 0, w, v, 0.0)
        return element.frozen(*element.values, branch, w, v, 0.0)[1:]
    return element.response(*element.values, w, v)[1:]
