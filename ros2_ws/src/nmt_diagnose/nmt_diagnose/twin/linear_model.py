"""Linear part of a rig as poles and residues: frequency responses at any s for a few inputs and outputs.

The local elements that are not linear are left out; their forces are inputs, their displacements outputs. Large
structures are reduced first (Rubin's method: lowest modes and the static shapes of all forces and sensors), structure
and exciter are joined exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import eigh

from nmt_core.blocks import FloatArray
from nmt_rig.model.assembly import ElectromechanicalSystem

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class OutputRows:
    """Outputs y = (s² acceleration + s velocity + displacement) q + feedthrough · inputs.

    Attributes:
        displacement, velocity, acceleration: (o, n).
        feedthrough: (o, p); the columns are the inputs.
    """

    displacement: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    feedthrough: FloatArray


@dataclass(frozen=True)
class LinearModel:
    """T(s) = Σ_k (d_k + s v_k + s² a_k) b_k / (s − λ_k) + feedthrough.

    Attributes:
        poles: λ (k,), rad/s.
        displacement, velocity, acceleration: (o, k) outputs of each pole.
        inputs: (k, p) share of each pole in the inputs.
        feedthrough: (o, p).
    """

    poles: ComplexArray
    displacement: ComplexArray
    velocity: ComplexArray
    acceleration: ComplexArray
    inputs: ComplexArray
    feedthrough: ComplexArray

    def at(self, s: complex) -> tuple[ComplexArray, ComplexArray]:
        """T (o, p) and dT/ds at s."""
        result: tuple[ComplexArray, ComplexArray] = transfer_at(
            s, self.poles, self.displacement, self.velocity, self.acceleration, self.inputs, self.feedthrough
        )
        return result

    def partial_fractions(self, rows: NDArray[np.int64]) -> tuple[FloatArray, ...]:
        """Some outputs as Σ_k (c_k + s e_k) / (s² − σ_k s + π_k) + rest, in real numbers.

        Returns:
            σ (k,), π (k,), c (k, rows · p), e (k, rows · p), rest (rows · p,); one k for each pair of poles.
        """
        order = np.argsort(np.abs(self.poles.imag) < 1e-12 * np.abs(self.poles), kind="stable")
        poles = self.poles[order]
        # (d + s v + s² a) b / (s − λ) = (d + λ v + λ² a) b / (s − λ) + (v + λ a) b + s a b; Σ v b and Σ a b vanish.
        outputs = self.displacement[rows] + self.velocity[rows] * self.poles
        outputs = (outputs + self.acceleration[rows] * self.poles**2)[:, order]
        residues = (outputs[:, None, :] * self.inputs[order].T[None]).reshape(-1, poles.size).T
        direct = (self.velocity[rows] + self.acceleration[rows] * self.poles) @ self.inputs
        rest = (self.feedthrough[rows] + direct).real.ravel()
        real = np.abs(poles.imag) < 1e-12 * np.abs(poles)
        upper = (poles.imag > 0.0) & ~real
        pairs, r = poles[upper], residues[upper]
        sums, products = [2.0 * pairs.real], [np.abs(pairs) ** 2]
        constants, slopes = [-2.0 * (r * np.conj(pairs)[:, None]).real], [2.0 * r.real]
        # A real pole: r / (s − λ) = (r λ + r s) / (s² − λ²).
        single, own = poles[real].real, residues[real].real
        sums.append(np.zeros_like(single))
        products.append(-(single**2))
        constants.append(own * single[:, None])
        slopes.append(own)
        return (
            np.concatenate(sums),
            np.concatenate(products),
            np.ascontiguousarray(np.concatenate(constants)),
            np.ascontiguousarray(np.concatenate(slopes)),
            rest,
        )


@njit(cache=True)
def transfer_at(
    s: complex,
    poles: ComplexArray,
    displacement: ComplexArray,
    velocity: ComplexArray,
    acceleration: ComplexArray,
    inputs: ComplexArray,
    feedthrough: ComplexArray,
) -> tuple[ComplexArray, ComplexArray]:
    """Compiled body of ``LinearModel.at``."""
    outputs = displacement.shape[0]
    columns = inputs.shape[1]
    count = poles.shape[0]
    transfer = feedthrough.copy()
    slope = np.zeros((outputs, columns), dtype=np.complex128)
    for k in range(count):
        inverse = 1.0 / (s - poles[k])
        for o in range(outputs):
            row = (displacement[o, k] + s * (velocity[o, k] + s * acceleration[o, k])) * inverse
            change = (velocity[o, k] + 2.0 * s * acceleration[o, k] - row) * inverse
            for p in range(columns):
                transfer[o, p] += row * inputs[k, p]
                slope[o, p] += change * inputs[k, p]
    return transfer, slope


def linear_model(
    system: ElectromechanicalSystem, inputs: FloatArray, rows: OutputRows, kept_modes: int, full_size: int
) -> LinearModel:
    """Poles and residues of the linear part of a system; its local elements are ignored.

    Args:
        system: structure with or without shaker.
        inputs: (n, p) generalised forces (voltage in the row of the current).
        rows: outputs.
        kept_modes: modes of a structure with more than ``full_size`` degrees of freedom that are kept.
        full_size: see ``kept_modes``.
    """
    basis = _reduction(system, inputs, rows, kept_modes, full_size)
    mechanical = system.mechanical_size
    m = system.mass[:mechanical, :mechanical]
    k = system.stiffness[:mechanical, :mechanical]
    if basis is not None:
        m, k = basis.T @ m @ basis, basis.T @ k @ basis
    squares, vectors = eigh(0.5 * (k + k.T), m)
    shapes = vectors if basis is None else basis @ vectors
    size = shapes.shape[1]
    damping = shapes.T @ system.damping[:mechanical, :mechanical] @ shapes
    # A body without suspension has a double pole at zero, which has no residues: a spring too soft to be seen.
    stiffness = np.diag(np.maximum(squares, max(1e-16 * squares[-1], 1e-12)))
    electric = 0 if system.current is None else 1
    a = np.zeros((2 * size + electric, 2 * size + electric))
    a[:size, size : 2 * size] = np.eye(size)
    a[size : 2 * size, :size] = -stiffness
    a[size : 2 * size, size : 2 * size] = -damping
    b = np.zeros((2 * size + electric, inputs.shape[1]))
    b[size : 2 * size] = shapes.T @ inputs[:mechanical]
    current = system.current
    if current is not None:
        inductance = system.damping[current, current]
        a[size : 2 * size, -1] = -(shapes.T @ system.stiffness[:mechanical, current])
        a[-1, :size] = -(system.stiffness[current, :mechanical] @ shapes) / inductance
        a[-1, size : 2 * size] = -(system.damping[current, :mechanical] @ shapes) / inductance
        a[-1, -1] = -system.stiffness[current, current] / inductance
        b[-1] = inputs[current] / inductance
    poles, right = np.linalg.eig(a)
    # Rows of full unknowns [q, i] for each pole.
    full = np.zeros((system.size, poles.size), dtype=np.complex128)
    full[:mechanical] = shapes @ right[:size]
    if current is not None:
        full[current] = right[-1]
    return LinearModel(
        poles.astype(np.complex128),
        np.ascontiguousarray(rows.displacement @ full),
        np.ascontiguousarray(rows.velocity @ full),
        np.ascontiguousarray(rows.acceleration @ full),
        np.ascontiguousarray(np.linalg.solve(right, b.astype(np.complex128))),
        rows.feedthrough.astype(np.complex128),
    )


def _reduction(
    system: ElectromechanicalSystem, inputs: FloatArray, rows: OutputRows, kept_modes: int, full_size: int
) -> FloatArray | None:
    """Basis (mechanical unknowns, reduced ones), or None where the structure is small."""
    n = system.structure_size
    if n <= full_size:
        return None
    squares, vectors = eigh(system.stiffness[:n, :n], system.mass[:n, :n])
    places = np.column_stack((inputs[:n], rows.displacement[:, :n].T, rows.acceleration[:, :n].T))
    if system.coil is not None:
        places = np.column_stack((places, system.selector(system.drive_point)[:n]))
    sizes = np.linalg.norm(places, axis=0)
    places = places[:, sizes > 0.0] / sizes[sizes > 0.0]
    # Independent places only: sensors sit where forces act.
    left, strengths, _ = np.linalg.svd(places, full_matrices=False)
    places = left[:, strengths > 1e-6 * strengths[0]]
    dropped = vectors[:, kept_modes:]
    static = (dropped.T @ places) / squares[kept_modes:, None]
    orthogonal, _ = np.linalg.qr(static)
    total = system.mechanical_size
    basis = np.zeros((total, kept_modes + orthogonal.shape[1] + total - n))
    basis[:n, :kept_modes] = vectors[:, :kept_modes]
    basis[:n, kept_modes : kept_modes + orthogonal.shape[1]] = dropped @ orthogonal
    basis[n:, kept_modes + orthogonal.shape[1] :] = np.eye(total - n)
    return basis
