"""Linear modes of the sticking structure, alone and with the exciter attached."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eig, eigh

from nmt_rig.model.assembly import ElectromechanicalSystem
from nmt_rig.model.local_elements.element import LocalElement
from nmt_rig.model.structure import Array, Structure

# A mode whose strain energy φᵀKφ is so small a share of the sum of its terms' sizes is a rigid-body mode with rounding.
_RIGID_SHARE = 1e-13


def without_rounding(squares: Array, vectors: Array, stiffness: Array) -> Array:
    """(m,) squared frequencies with those of rigid-body modes exactly zero.

    Args:
        squares: (m,) eigenvalues, (rad/s)².
        vectors: (n, m) eigenvectors.
        stiffness: (n, n) that they belong to.
    """
    sizes = np.einsum("im,im->m", np.abs(vectors), np.abs(stiffness) @ np.abs(vectors))
    energies = np.einsum("im,im->m", vectors, stiffness @ vectors)
    return np.where(energies > _RIGID_SHARE * sizes, np.maximum(squares, 0.0), 0.0)


@dataclass(frozen=True)
class LinearModes:
    """Undamped modes, ascending frequency.

    Attributes:
        frequencies: (m,) rad/s.
        damping_ratios: (m,) φᵀ C φ / (2 ω); 0 for rigid-body modes.
        shapes: (points, m) mass-normalised shapes (1/√kg) at `points`.
        points: point numbers of the rows.
        full_shapes: (n, m) the same shapes on all degrees of freedom.
    """

    frequencies: Array
    damping_ratios: Array
    shapes: Array
    points: tuple[int, ...]
    full_shapes: Array


@dataclass(frozen=True)
class DampedModes:
    """Oscillating modes of the damped system, ascending |λ|.

    Attributes:
        eigenvalues: (m,) λ with positive imaginary part, rad/s.
        frequencies: (m,) |λ|, rad/s.
        damping_ratios: (m,) -Re λ / |λ|.
        shapes: (points, m) complex displacement shapes at `points`, largest entry 1; 0 where a mode moves none of them.
        points: point numbers of the rows.
    """

    eigenvalues: NDArray[np.complex128]
    frequencies: Array
    damping_ratios: Array
    shapes: NDArray[np.complex128]
    points: tuple[int, ...]


def sticking_modes(
    structure: Structure, elements: Sequence[LocalElement] = (), count: int | None = None
) -> LinearModes:
    """Modes of the structure with its local elements at rest (Jenkins elements stick).

    All modes when `count` is None. Each shape has a positive largest entry over the points.
    """
    stiffness = structure.stiffness.copy()
    damping = structure.damping.copy()
    for element in elements:
        outer = np.outer(element.direction, element.direction)
        stiffness += element.linear_stiffness * outer
        damping += element.linear_damping * outer
    highest = structure.size if count is None else min(count, structure.size)
    squares, full = eigh(stiffness, structure.mass, subset_by_index=[0, highest - 1])
    frequencies = np.sqrt(without_rounding(squares, full, stiffness))
    points = structure.point_numbers
    at_points = np.array([structure.motion(point, full) for point in points]).reshape(len(points), full.shape[1])
    reference = at_points if points else full
    largest = np.argmax(np.abs(reference), axis=0)
    full = full * np.where(reference[largest, np.arange(full.shape[1])] < 0, -1.0, 1.0)
    modal_damping = np.einsum("im,ij,jm->m", full, damping, full)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(frequencies > 0, modal_damping / (2.0 * frequencies), 0.0)
    shapes = np.array([structure.motion(point, full) for point in points]).reshape(len(points), full.shape[1])
    return LinearModes(frequencies, ratios, shapes, points, full)


def damped_modes(system: ElectromechanicalSystem) -> DampedModes:
    """Damped modes of the whole system linearised at rest: ω_p, ζ_p of the closed-form PLL gains.

    Solves (λ² M + λ C + K) φ = 0 as a generalised first-order problem (the current's row has no mass).
    """
    n, m = system.size, system.mechanical_size
    # States: q (n) and velocities of the degrees of freedom with inertia (m).
    left = np.zeros((n + m, n + m))
    right = np.zeros((n + m, n + m))
    left[:n, :n] = -system.sticking_stiffness()
    damping = system.resting_damping()
    left[:n, n:] = 0.0
    right[:n, :n] = damping
    right[:n, n:] = system.mass[:, :m]
    left[n:, n:] = np.eye(m)
    right[n:, :m] = np.eye(m)
    values, vectors = eig(left, right)
    keep = np.flatnonzero(np.isfinite(values) & (values.imag > 1e-9 * np.abs(values)))
    keep = keep[np.argsort(np.abs(values[keep]))]
    values = values[keep]
    vectors = vectors[:n, keep]
    points = system.point_numbers
    shapes = np.array([system.motion(point, vectors) for point in points]).reshape(len(points), vectors.shape[1])
    if points:
        largest = shapes[np.argmax(np.abs(shapes), axis=0), np.arange(shapes.shape[1])]
        shapes = shapes / np.where(largest == 0.0, 1.0, largest)
    return DampedModes(values, np.abs(values), -values.real / np.abs(values), shapes, points)


def modal_damping_matrix(mass: Array, stiffness: Array, ratios: Sequence[float]) -> Array:
    """Damping matrix (n, n) that gives the undamped modes these damping ratios, the last one all higher modes.

    C = M Φ diag(2 ζ ω) Φᵀ M with mass-normalised Φ.
    """
    squares, shapes = eigh(stiffness, mass)
    zeta = np.array([*ratios, *[ratios[-1]] * max(squares.size - len(ratios), 0)])[: squares.size]
    weighted = mass @ shapes
    result: Array = (weighted * (2.0 * zeta * np.sqrt(np.maximum(squares, 0.0)))) @ weighted.T
    return result
