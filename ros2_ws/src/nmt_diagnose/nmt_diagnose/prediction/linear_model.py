"""Linear part of a rig as poles and residues: frequency responses at any s for a few inputs and outputs.

The local elements that are not linear are left out; their forces are inputs, their displacements outputs. Large
structures are reduced first (Rubin's method: lowest modes and the static shapes of all forces and sensors), structure
and exciter are joined exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.numerics.kernels import njit
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.assembly import ElectromechanicalSystem


class LinearTables(NamedTuple):
    """A `LinearModel` for compiled functions."""

    poles: ComplexArray
    displacement: ComplexArray
    velocity: ComplexArray
    acceleration: ComplexArray
    inputs: ComplexArray
    feedthrough: ComplexArray


class Fractions(NamedTuple):
    """Σ_k (c_k + s e_k) / (s² − σ_k s + π_k) + constant part in real numbers, one k for each pair of poles.

    Attributes:
        sums, products: σ and π (k,).
        constants, slopes: c and e (k, entries).
        constant_part: (entries,).
    """

    sums: FloatArray
    products: FloatArray
    constants: FloatArray
    slopes: FloatArray
    constant_part: FloatArray

    def of_inputs(self, inputs: int, first: int) -> Fractions:
        """The same of the ``first`` of so many inputs."""
        if inputs == first:
            return self
        kept = np.arange(self.constant_part.size).reshape(-1, inputs)[:, :first].ravel()
        return self._replace(
            constants=self.constants[:, kept], slopes=self.slopes[:, kept], constant_part=self.constant_part[kept]
        )


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
class PoleFrame:
    """Where the poles of a system come from, to follow them when it changes a little.

    Attributes:
        shapes: undamped mass-normalised shapes of the mechanical unknowns, (mechanical, size).
        squares: their squared angular frequencies, (size,).
        right, left: right eigenvectors of the first-order system and their inverse, (k, k).
        full: all unknowns [q, i] of each pole, (n, k).
    """

    shapes: FloatArray
    squares: FloatArray
    right: ComplexArray
    left: ComplexArray
    full: ComplexArray


@dataclass(frozen=True)
class LinearModel:
    """T(s) = Σ_k (d_k + s v_k + s² a_k) b_k / (s − λ_k) + feedthrough.

    Attributes:
        poles: λ (k,), rad/s.
        displacement, velocity, acceleration: (o, k) outputs of each pole.
        inputs: (k, p) share of each pole in the inputs.
        feedthrough: (o, p).
        frame: where the poles come from; None where the system was reduced or has a body without suspension.
    """

    poles: ComplexArray
    displacement: ComplexArray
    velocity: ComplexArray
    acceleration: ComplexArray
    inputs: ComplexArray
    feedthrough: ComplexArray
    frame: PoleFrame | None = None

    @cached_property
    def tables(self) -> LinearTables:
        """What compiled functions need of it."""
        return LinearTables(
            self.poles, self.displacement, self.velocity, self.acceleration, self.inputs, self.feedthrough
        )

    def at(self, s: complex) -> tuple[ComplexArray, ComplexArray]:
        """T (o, p) and dT/ds at s."""
        transfer, slope = np.zeros((2, 1, *self.feedthrough.shape), dtype=np.complex128)
        add_response(s, self.tables, 0, *self.feedthrough.shape, transfer, slope)
        return transfer[0], slope[0]

    def partial_fractions(self, rows: NDArray[np.int64]) -> Fractions:
        """Some outputs as partial fractions; entries are those of (rows, p), row by row."""
        return Fractions(*real_fractions(rows, tuple(self.tables)))


@njit(cache=True)
def real_fractions(
    rows: NDArray[np.int64], model_tables: tuple[ComplexArray, ...]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Compiled body of ``LinearModel.partial_fractions``; plain tuples come from Python and go there sooner."""
    poles, displacement, velocity, acceleration, inputs, feedthrough = LinearTables(*model_tables)
    columns = inputs.shape[1]
    count = 0
    for pole in poles:
        count += pole.imag > 0.0 or abs(pole.imag) < 1e-12 * abs(pole)
    sums, products = np.empty(count), np.empty(count)
    constants, slopes = np.empty((count, rows.size * columns)), np.empty((count, rows.size * columns))
    constant_part = np.empty(rows.size * columns)
    for position in range(rows.size):
        for p in range(columns):
            constant_part[position * columns + p] = feedthrough[rows[position], p].real
    k = 0
    for number in range(poles.size):
        pole = poles[number]
        single = abs(pole.imag) < 1e-12 * abs(pole)
        kept = single or pole.imag > 0.0
        if kept:
            sums[k] = 0.0 if single else 2.0 * pole.real
            products[k] = -(pole.real**2) if single else abs(pole) ** 2
        for position in range(rows.size):
            o = rows[position]
            # (d + s v + s² a) b / (s − λ) = (d + λ v + λ² a) b / (s − λ) + (v + λ a) b + s a b; Σ v b, Σ a b vanish.
            direct = velocity[o, number] + acceleration[o, number] * pole
            output = displacement[o, number] + direct * pole
            for p in range(columns):
                entry = position * columns + p
                constant_part[entry] += (direct * inputs[number, p]).real
                if not kept:
                    continue
                residue = output * inputs[number, p]
                if single:
                    # r / (s − λ) = (r λ + r s) / (s² − λ²).
                    constants[k, entry] = residue.real * pole.real
                    slopes[k, entry] = residue.real
                else:
                    constants[k, entry] = -2.0 * (residue * np.conj(pole)).real
                    slopes[k, entry] = 2.0 * residue.real
        k += kept
    return sums, products, constants, slopes, constant_part


@njit(cache=True)
def add_response(
    s: complex, model: LinearTables, place: int, outputs: int, columns: int, transfer: ComplexArray, slope: ComplexArray
) -> None:
    """Add T (o, p) at s to ``transfer[place]`` and dT/ds to ``slope[place]`` where that has room.

    Args:
        s: complex frequency.
        model: the linear part.
        place: row of (·, o, p) to add to.
        outputs, columns: numbers of outputs and inputs that are wanted, the first ones.
        transfer, slope: (·, o, p).
    """
    poles, displacement, velocity, acceleration, inputs, feedthrough = model
    sloped = slope.shape[0] > 0
    for o in range(outputs):
        for p in range(columns):
            transfer[place, o, p] += feedthrough[o, p]
    for k in range(poles.shape[0]):
        inverse = 1.0 / (s - poles[k])
        for o in range(outputs):
            row = (displacement[o, k] + s * (velocity[o, k] + s * acceleration[o, k])) * inverse
            for p in range(columns):
                transfer[place, o, p] += row * inputs[k, p]
            if sloped:
                change = (velocity[o, k] + 2.0 * s * acceleration[o, k] - row) * inverse
                for p in range(columns):
                    slope[place, o, p] += change * inputs[k, p]


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
    softest = max(1e-16 * squares[-1], 1e-12)
    stiffness = np.diag(np.maximum(squares, softest))
    currents = range(mechanical, system.size)
    electric = len(currents)
    a = np.zeros((2 * size + electric, 2 * size + electric))
    a[:size, size : 2 * size] = np.eye(size)
    a[size : 2 * size, :size] = -stiffness
    a[size : 2 * size, size : 2 * size] = -damping
    b = np.zeros((2 * size + electric, inputs.shape[1]))
    b[size : 2 * size] = shapes.T @ inputs[:mechanical]
    for row, current in enumerate(currents, start=2 * size):
        inductance = system.damping[current, current]
        a[size : 2 * size, row] = -(shapes.T @ system.stiffness[:mechanical, current])
        a[row, :size] = -(system.stiffness[current, :mechanical] @ shapes) / inductance
        a[row, size : 2 * size] = -(system.damping[current, :mechanical] @ shapes) / inductance
        a[row, row] = -system.stiffness[current, current] / inductance
        b[row] = inputs[current] / inductance
    poles, right = np.linalg.eig(a)
    left: ComplexArray = np.asarray(np.linalg.inv(right), dtype=np.complex128)
    # Rows of full unknowns [q, i] for each pole.
    full = np.zeros((system.size, poles.size), dtype=np.complex128)
    full[:mechanical] = shapes @ right[:size]
    full[mechanical:] = right[2 * size :]
    exact = basis is None and squares[0] > softest
    frame = PoleFrame(shapes, squares, right.astype(np.complex128), left, full) if exact else None
    shares: ComplexArray = left @ b.astype(np.complex128)
    return _with_outputs(poles.astype(np.complex128), full, shares, rows, frame)


def moved_model(
    model: LinearModel, before: ElectromechanicalSystem, system: ElectromechanicalSystem, inputs: FloatArray,
    rows: OutputRows,
) -> LinearModel | None:  # fmt: skip
    """Linear model of a system that differs a little from another, its poles and shapes to first order.

    The first derivatives of eigenvalues and eigenvectors (Fox and Kapoor, AIAA J. 6 (1968) 2426; Rogers, AIAA J. 8
    (1970) 943, for systems that are not symmetric); what they leave out is of second order in the change.

    Args:
        model: linear model of ``before``.
        before: the other system.
        system: the system, of the same unknowns.
        inputs, rows: of the system, as in ``linear_model``.

    Returns:
        The model; None where poles lie too close together for it, or the other model says nothing of its poles.
    """
    frame = model.frame
    if frame is None or (before.size, before.mechanical_size) != (system.size, system.mechanical_size):
        return None
    mechanical, shapes = system.mechanical_size, frame.shapes
    size = shapes.shape[1]
    mechanical_part = slice(None, mechanical)
    # Differences first: the lowest modes are many digits below the highest.
    dm, dc, dk = (
        shapes.T
        @ (
            getattr(system, name)[mechanical_part, mechanical_part]
            - getattr(before, name)[mechanical_part, mechanical_part]
        )
        @ shapes
        for name in ("mass", "damping", "stiffness")
    )
    damping = shapes.T @ before.damping[mechanical_part, mechanical_part] @ shapes
    change = np.zeros((frame.right.shape[0],) * 2)
    change[size : 2 * size, :size] = dm * frame.squares - dk
    change[size : 2 * size, size : 2 * size] = dm @ damping - dc
    b = np.zeros((change.shape[0], inputs.shape[1]))
    driven = shapes.T @ inputs[mechanical_part]
    b[size : 2 * size] = driven - dm @ driven
    for row, current in enumerate(range(mechanical, system.size), start=2 * size):
        pull, more = (shapes.T @ item.stiffness[mechanical_part, current] for item in (before, system))
        change[size : 2 * size, row] = dm @ pull - (more - pull)
        rates = []
        for item in (before, system):
            circuit = np.concatenate(
                (item.stiffness[current, mechanical_part] @ shapes, item.damping[current, mechanical_part] @ shapes,
                 [item.stiffness[current, current]])
            )  # fmt: skip
            rates.append(circuit / item.damping[current, current])
        change[row, : 2 * size] = (rates[0] - rates[1])[:-1]
        change[row, row] = (rates[0] - rates[1])[-1]
        b[row] = inputs[current] / system.damping[current, current]
    moved = frame.left @ change @ frame.right
    gaps = model.poles[None, :] - model.poles[:, None]
    np.fill_diagonal(gaps, 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        mixed = moved / gaps
    np.fill_diagonal(mixed, 0.0)
    if not np.max(np.abs(mixed), initial=0.0) < THRESHOLDS.prediction.largest_shape_mix:
        return None
    left = frame.left @ b
    shift = np.diag(moved)
    # A real pole stays real: an imaginary part by rounding would make half of a pair of it.
    poles = model.poles + np.where(model.poles.imag == 0.0, shift.real, shift)
    return _with_outputs(poles, frame.full + frame.full @ mixed, left - mixed @ left, rows, None)


def _with_outputs(
    poles: ComplexArray, full: ComplexArray, inputs: ComplexArray, rows: OutputRows, frame: PoleFrame | None
) -> LinearModel:
    return LinearModel(
        poles,
        np.ascontiguousarray(rows.displacement @ full),
        np.ascontiguousarray(rows.velocity @ full),
        np.ascontiguousarray(rows.acceleration @ full),
        np.ascontiguousarray(inputs),
        rows.feedthrough.astype(np.complex128),
        frame,
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
    coils = [system.selector(port.point)[:n] for port in system.exciters if port.coil is not None]
    places = np.column_stack((places, *coils))
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
