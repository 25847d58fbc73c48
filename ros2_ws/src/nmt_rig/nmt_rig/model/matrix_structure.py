"""Structure given by its matrices, as a finite-element code exports them, with reduction to points and modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import eigh
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh, splu

from nmt_rig.model.structure import Array

# Relative size of rounding in matrices that come through files.
_ROUNDING = 1e-8
# Pivots below this share of their own diagonal entry say that a structure moves freely; a fine mesh of a plate leaves
# the fourth power of elements over the plate.
_FREE = 1e-13
# Beyond this size a stiffness is factored once, when the structure is reduced, and its signs are read there.
_FACTORED_ONCE = 2000
# Share by which the modes that a reduction leaves out may move a frequency, for the band that it states.
TRUNCATION = 1e-3
# Shares of the mean ω² of the rows that the stiffness of a free structure is lifted by; files of ten figures leave the
# rigid-body modes of light structures more negative than the first.
_LIFTS = (1e-9, 1e-7)
# Share of the largest 1/ω² below which a mode has no mass.
_MASSLESS = 1e-14
_RIGID_BODY_MODES = 6
# Of the ω² of the next mode; ten thousand in frequency.
_RIGID = 1e-8
# Share of the largest mass of static deflections below which one is a sum of others.
_ALONE = 1e-10
# Lowest modes whose forces in a part of the structure are answered statically, and share of ω² that such an answer may
# matter by where it is left out.
_PART_MODES, _CONTAINED = 8, 2e-3
# Up to this size all eigenvalues are computed, beyond it the lowest ones by Lanczos iteration.
_DENSE = 600


@dataclass(frozen=True)
class Matrices:
    """M, C and K with the displacement r of all degrees of freedom for a unit displacement of the base.

    Attributes:
        mass, damping, stiffness: (n, n) dense or sparse; damping None = none given.
        base_vector: (n,) r, None where it is not known; 0 for the modes of a reduced structure.
        base_load: (n,) M r + M_b, None = M r.
        band_hz: of a reduced structure, up to which its frequencies are within ``TRUNCATION`` of the full ones; None =
            not known.
        basis: (N, n) of a reduced structure, motion of the full one by each of its coordinates; None = not reduced.
    """

    mass: Any
    stiffness: Any
    damping: Any = None
    base_vector: Array | None = None
    base_load: Array | None = None
    band_hz: float | None = None
    basis: Array | None = None

    @property
    def size(self) -> int:
        """Number of degrees of freedom n."""
        return int(self.stiffness.shape[0])

    def checked(self) -> Matrices:
        """The same, made exactly symmetric.

        Raises:
            ValueError: not square, of different sizes, not finite, not symmetric, a mass that is not positive definite
                but for rows of zeros, or a stiffness or damping with negative eigenvalues.
        """
        n = self.size
        result: dict[str, Any] = {}
        for name in ("mass", "stiffness", "damping"):
            matrix = getattr(self, name)
            if matrix is None:
                continue
            if matrix.ndim != 2 or matrix.shape != (n, n):
                raise ValueError(
                    f"{name} must be {n} x {n}, as the stiffness, got {' x '.join(map(str, matrix.shape))}"
                )
            values = matrix.data if sparse.issparse(matrix) else matrix
            if np.iscomplexobj(values) or not np.all(np.isfinite(values)):
                raise ValueError(f"{name} has entries that are not finite real numbers")
            largest = float(np.max(np.abs(values), initial=0.0))
            if float(np.max(np.abs(matrix - matrix.T))) > _ROUNDING * largest:
                raise ValueError(
                    f"{name} is not symmetric; export the full matrix, not one triangle, and no gyroscopic or "
                    "follower forces"
                )
            result[name] = (matrix + matrix.T) * 0.5
        for name in ("base_vector", "base_load"):
            vector = getattr(self, name)
            if vector is not None and (vector.shape != (n,) or not np.all(np.isfinite(vector))):
                raise ValueError(f"{name} must have {n} finite entries")
        if not _massive(result["mass"]):
            raise ValueError(
                "the mass must be positive definite but for rows of zeros; export it without Lagrange multipliers and "
                "with the rigid elements eliminated"
            )
        tested = ("damping",) if n > _FACTORED_ONCE else ("stiffness", "damping")
        for name in tested:
            if name in result and not _positive_definite(result[name], lift=True):
                raise ValueError(f"{name} has a negative eigenvalue; a passive structure at rest has none")
        return Matrices(result["mass"], result["stiffness"], result.get("damping"), self.base_vector, self.base_load)

    def massless(self) -> NDArray[np.int64]:
        """Rows without mass and damping, as the rotations of a lumped mass have them."""
        empty = _empty_rows(self.mass)
        return empty if self.damping is None else np.intersect1d(empty, _empty_rows(self.damping))

    def load(self) -> Array | None:
        """(n,) base load p, None where neither it nor r is known."""
        if self.base_load is not None:
            return self.base_load
        return None if self.base_vector is None else np.asarray(self.mass @ self.base_vector)

    def dense(self) -> Matrices:
        """The same with dense matrices."""

        def plain(matrix: Any) -> Any:
            return matrix.toarray() if sparse.issparse(matrix) else matrix

        return Matrices(plain(self.mass), plain(self.stiffness), plain(self.damping), self.base_vector, self.base_load)


def _empty_rows(matrix: Any) -> NDArray[np.int64]:
    """Rows of zeros of a symmetric matrix."""
    return np.flatnonzero(np.asarray(abs(matrix).sum(axis=1)).reshape(-1) == 0.0)


def _block(matrix: Any, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> Any:
    return matrix.tocsr()[rows][:, columns] if sparse.issparse(matrix) else matrix[np.ix_(rows, columns)]


def condensed(matrices: Matrices, kept: Sequence[int]) -> tuple[Matrices, NDArray[np.int64]]:
    """The same structure without its rows of no mass but the kept ones: K_rr − K_rz K_zz⁻¹ K_zr, which is exact.

    Args:
        matrices: checked matrices of n degrees of freedom, few enough for dense ones.
        kept: rows that stay, whatever their mass.

    Returns:
        Dense matrices, and the rows of the old ones that are left.

    Raises:
        ValueError: rows without mass that no stiffness holds, or that the base loads.
    """
    out = np.setdiff1d(matrices.massless(), np.asarray(kept, dtype=np.int64))
    left = np.setdiff1d(np.arange(matrices.size), out)
    plain = matrices.dense()
    if not out.size:
        return plain, left
    load = plain.base_load
    if _held(_block(plain.stiffness, out, out)) is None or (load is not None and np.any(load[out] != 0.0)):
        raise ValueError(
            f"row {out[0]} has no mass and cannot be condensed: no stiffness holds it, or the base loads it"
        )
    coupled = plain.stiffness[np.ix_(left, out)]
    follows = np.linalg.solve(plain.stiffness[np.ix_(out, out)], coupled.T)
    stiffness = plain.stiffness[np.ix_(left, left)] - coupled @ follows
    return Matrices(
        plain.mass[np.ix_(left, left)],
        0.5 * (stiffness + stiffness.T),
        None if plain.damping is None else plain.damping[np.ix_(left, left)],
        None if plain.base_vector is None else plain.base_vector[left],
        None if load is None else load[left],
    ), left


def _factor(matrix: Any) -> Any:
    """L and U of a symmetric matrix by an ordering for symmetric ones, without exchanges of rows; None with one.

    The pivots then have the signs of the eigenvalues (Sylvester).
    """
    try:
        factor = splu(
            sparse.csc_matrix(matrix), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )  # fmt: skip
    except RuntimeError:
        return None
    return factor if np.array_equal(factor.perm_r, factor.perm_c) else None


def _massive(mass: Any) -> bool:
    """Whether a mass is positive definite but for rows of zeros, within rounding of each row's own entries.

    Superelements have combinations of rows that move no mass, too, as turning about a bar has.
    """
    massive = np.setdiff1d(np.arange(mass.shape[0]), _empty_rows(mass))
    block = _block(mass, massive, massive)
    diagonal = block.diagonal()
    if not massive.size or np.any(diagonal <= 0.0):
        return False
    if not sparse.issparse(block) or massive.size <= _DENSE:
        plain = block.toarray() if sparse.issparse(block) else block
        return _positive_definite(plain / np.sqrt(np.outer(diagonal, diagonal)), lift=True)
    if np.max(np.abs(block - sparse.diags(diagonal))) == 0.0:
        return True
    scale = sparse.diags(1.0 / np.sqrt(diagonal))
    scaled = sparse.csr_matrix(scale @ block @ scale)
    try:
        # A scaled mass is well conditioned, so that its lowest eigenvalue needs no factor; negative ones stand apart.
        start = np.random.default_rng(0).standard_normal(massive.size)
        (lowest,) = eigsh(scaled, k=1, which="SA", tol=1e-3, v0=start, maxiter=300, return_eigenvectors=False)
    except ArpackNoConvergence:
        return _positive_definite(scaled, lift=True)
    return bool(lowest > -_ROUNDING)


def regular(mass: Array) -> bool:
    """Whether a dense mass is positive definite beyond rounding, each row by its own entries."""
    size = np.sqrt(np.diag(mass))
    return bool(np.linalg.eigvalsh(mass / np.outer(size, size))[0] > 1e-12)


def _positive_definite(matrix: Any, lift: bool = False) -> bool:
    """Whether a symmetric matrix is positive definite; with `lift` positive semidefinite within rounding."""
    largest = float(np.max(np.abs(matrix.diagonal()), initial=0.0))
    shift = _ROUNDING * largest if lift else 0.0
    if lift and largest == 0.0:
        return bool(np.max(np.abs(matrix)) == 0.0)
    if not sparse.issparse(matrix):
        try:
            np.linalg.cholesky(matrix + shift * np.eye(matrix.shape[0]))
        except np.linalg.LinAlgError:
            return False
        return True
    factor = _factor(matrix + shift * sparse.identity(matrix.shape[0]))
    return factor is not None and bool(np.all(factor.U.diagonal() > 0.0))


@dataclass(frozen=True)
class PartMatrix:
    """Stiffness or mass (n, n) of a part of a structure."""

    matrix: Any
    of_mass: bool


def craig_bampton(
    matrices: Matrices, kept: Sequence[int], modes: int, parts: Sequence[PartMatrix] = (), held: int = 0,
    most: int | None = None,
) -> Matrices:  # fmt: skip
    """Reduction to physical degrees of freedom and fixed-interface modes (Craig and Bampton, AIAA J. 6 (1968) 1313).

    Static deflections under forces at the kept degrees of freedom are exact whatever the number of modes, and so is
    what the modes left out answer to first order in ω². Rows without mass follow the others statically, which is exact.

    The modes left out add ω⁴ Σ L Lᵀ / (ω_k² − ω²) to the dynamic stiffness of the kept degrees of freedom, with the
    loads L = φᵀ (M_ib + M_ii Ψ) of their static shapes Ψ. All modes together have Σ L Lᵀ / ω_k² = Pᵀ K_ii⁻¹ P, so that
    R, the part of those left out, is known without them, and no frequency ω moves by more than
    ω² ρ / (2 (1 − ω² / ω_m²)) of itself, ρ the largest eigenvalue of R against the statically condensed mass.

    Args:
        matrices: checked matrices of n degrees of freedom.
        kept: rows that stay degrees of freedom, in the new order; the modes come behind them.
        modes: number of modes of the structure with the kept degrees of freedom fixed, the lowest ones.
        parts: of the structure that may change: static deflections under their forces in the lowest modes are kept,
            too, so that frequencies are right to second order in the change.
        held: number of the last kept degrees of freedom that do not move in these lowest modes.
        most: coordinates next to the held ones, up to which what the modes left out answer is added; None = all of it.

    Returns:
        Dense matrices of size len(kept) + modes, and further coordinates for what the modes left out answer and for the
        parts, with their basis.

    Raises:
        ValueError: rows that do not exist or repeat, more modes than there are, or supports so few that the structure
            moves freely with the kept degrees of freedom fixed.
    """
    n = matrices.size
    own = np.asarray(kept, dtype=np.int64)
    if own.size == 0 or own.min() < 0 or own.max() >= n or np.unique(own).size != own.size:
        raise ValueError(f"the kept degrees of freedom must be different rows of 0 to {n - 1}")
    inner = np.setdiff1d(np.arange(n), own)
    heavy = inner.size - np.intersect1d(inner, matrices.massless()).size
    if not 0 <= modes <= heavy:
        raise ValueError(f"{heavy} modes are left besides the points, {modes} are asked for")
    stiffness, mass = (sparse.csr_matrix(matrix) for matrix in (matrices.stiffness, matrices.mass))
    k_ii, m_ii = stiffness[inner][:, inner], mass[inner][:, inner]
    basis = np.zeros((n, own.size + modes))
    basis[own, np.arange(own.size)] = 1.0
    band_hz = None
    if inner.size:
        factor = _held(k_ii)
        if factor is None:
            raise ValueError(
                "with the points held the structure can still move freely; name more points, or a rotation of one"
            )
        basis[np.ix_(inner, np.arange(own.size))] = factor.solve(-stiffness[inner][:, own].toarray())
        basis[inner, own.size :] = _lowest(k_ii, m_ii, factor, modes)
        at_rest = np.delete(basis, np.s_[own.size - held : own.size], axis=1)
        if 0 < modes < heavy:
            band_hz = _band(at_rest, inner, own.size - held, k_ii, mass, factor)
        if parts and 0 < modes < heavy:
            basis = _with_parts(basis, inner, own.size, stiffness, mass, factor, parts, held)
        if 0 < modes < heavy:
            room = basis.shape[1] if most is None else most + held - basis.shape[1]
            basis = _with_inertia(basis, inner, own.size, k_ii, mass, factor, max(0, room))

    def projected(matrix: Any) -> Any:
        return None if matrix is None else projection(matrix, basis)

    load, r = matrices.load(), matrices.base_vector
    reduced = projected(matrices.stiffness)
    if not _positive_definite(reduced, lift=True):
        raise ValueError("stiffness has a negative eigenvalue; a passive structure at rest has none")
    return Matrices(
        projected(matrices.mass),
        reduced,
        projected(matrices.damping),
        None if r is None else np.concatenate([r[own], np.zeros(basis.shape[1] - own.size)]),
        None if load is None else basis.T @ load,
        band_hz,
        basis,
    )


def projection(matrix: Any, basis: Array) -> Array:
    """Tᵀ A T of a symmetric matrix, exactly symmetric."""
    result = basis.T @ np.asarray(matrix @ basis)
    return np.asarray(0.5 * (result + result.T))


def _with_inertia(
    basis: Array, inner: NDArray[np.int64], points: int, k_ii: Any, mass: Any, factor: Any, most: int
) -> Array:
    """The basis with static deflections of inner rows under the inertia of the points' static shapes, the largest.

    They are what the modes left out answer to first order in ω² (modal truncation augmentation: Dickens, Nakagawa and
    Wittbrodt, Comput. Struct. 62 (1997) 985), so that the error of the reduction falls from ω⁴ to ω⁸.
    """
    known, m_ii = basis[inner, points:], mass[inner][:, inner]
    deflections = factor.solve(np.asarray(mass @ basis[:, :points])[inner])
    together = np.hstack([known, _beside(deflections, known, m_ii)[:, : -most - 1 : -1]])
    turned = together @ eigh(projection(k_ii, together), projection(m_ii, together))[1]
    return np.hstack([basis[:, :points], _spread(turned, inner, basis.shape[0])])


def _beside(deflections: Array, known: Array, m_ii: Any) -> Array:
    """Part of deflections (n, k) that modes do not have, orthonormal in the mass; what has no mass is left out."""
    # Once more against rounding.
    for _ in range(2):
        deflections = deflections - known @ (known.T @ np.asarray(m_ii @ deflections))
    sizes, turns = eigh(projection(m_ii, deflections))
    heavy = sizes > _ALONE * max(float(sizes[-1]), 1e-300)
    return np.asarray(deflections @ (turns[:, heavy] / np.sqrt(sizes[heavy])))


def _with_parts(
    basis: Array, inner: NDArray[np.int64], points: int, stiffness: Any, mass: Any, factor: Any,
    parts: Sequence[PartMatrix], held: int,
) -> Array:  # fmt: skip
    """The basis with static deflections of inner rows under the forces of parts in its lowest modes.

    Where a part changes by the share δ, deflections d beyond the basis lower ω² by δ² dᵀ K d of itself, for a mode with
    φᵀ K φ = 1. Those of less than ``_CONTAINED`` are left out; modes and deflections together become modes again.
    """
    moving = np.delete(basis, np.s_[points - held : points], axis=1)
    squares, shapes = eigh(projection(stiffness, moving), projection(mass, moving))
    squares = np.maximum(squares[:_PART_MODES], _LIFTS[0] * squares[-1])
    lowest = moving @ (shapes[:, :_PART_MODES] / np.sqrt(squares))
    known = basis[inner, points:]
    k_ii, m_ii = stiffness[inner][:, inner], mass[inner][:, inner]
    for part in parts:
        forces = np.asarray(part.matrix @ (lowest * squares if part.of_mass else lowest))[inner]
        deflections = factor.solve(forces)
        # Modes of the inner rows are orthogonal in both matrices; once more against rounding.
        for _ in range(2):
            deflections = deflections - known @ (known.T @ np.asarray(m_ii @ deflections))
        sizes, turns = eigh(projection(k_ii, deflections))
        if not np.any(sizes > _CONTAINED):
            continue
        deflections = deflections @ turns[:, sizes > _CONTAINED]
        together = np.hstack([known, deflections])
        known = together @ eigh(projection(k_ii, together), projection(m_ii, together))[1]
    return np.hstack([basis[:, :points], _spread(known, inner, basis.shape[0])])


def _spread(values: Array, rows: NDArray[np.int64], size: int) -> Array:
    """Values (r, k) in their rows of (size, k), zeros elsewhere."""
    result = np.zeros((size, values.shape[1]))
    result[rows] = values
    return result


def _band(basis: Array, inner: NDArray[np.int64], points: int, k_ii: Any, mass: Any, factor: Any) -> float:
    """Frequency up to which the modes left out move no frequency by more than ``TRUNCATION``, Hz."""
    inertia = np.asarray(mass @ basis[:, :points])
    modes = basis[inner, points:]
    squares = np.einsum("ij,ij->j", modes, np.asarray(k_ii @ modes))
    loads = modes.T @ inertia[inner]
    left_out = inertia[inner].T @ factor.solve(inertia[inner]) - loads.T @ (loads / squares[:, None])
    static = basis[:, :points].T @ inertia
    size = np.sqrt(np.diag(static))
    if not np.all(size > 0.0) or not regular(static):
        return 0.0
    scale = np.outer(size, size)
    largest = eigh(0.5 * (left_out + left_out.T) / scale, static / scale, eigvals_only=True)[-1]
    return float(np.sqrt(2.0 * TRUNCATION / (max(largest, 0.0) + 2.0 * TRUNCATION / squares.max())) / (2.0 * np.pi))


def lowest_frequencies(matrices: Matrices, count: int) -> Array:
    """The lowest angular frequencies of the full structure, rad/s, behind zeros for the rigid-body modes of a free one.

    Args:
        matrices: checked matrices of n degrees of freedom.
        count: number of frequencies next to the zeros; fewer come back where fewer rows have mass.

    Raises:
        ValueError: rows without mass and stiffness.
    """
    heavy = matrices.size - _empty_rows(matrices.mass).size
    stiffness, mass = sparse.csc_matrix(matrices.stiffness), sparse.csc_matrix(matrices.mass)
    mean = float(stiffness.diagonal().sum() / mass.diagonal().sum())
    for lift in _LIFTS:
        lifted = (stiffness + lift * mean * mass).tocsc()
        factor = _factor(lifted)
        if factor is not None and np.all(factor.U.diagonal() > 0.0):
            break
    else:
        raise ValueError("stiffness has a negative eigenvalue, or nothing holds a row without mass")
    modes = _lowest(lifted, mass, factor, min(count + _RIGID_BODY_MODES, heavy))
    squares = np.einsum("ij,ij->j", modes, np.asarray(stiffness @ modes))
    # Rounding leaves rigid-body modes a stiffness; nothing else lies so far below the next mode.
    candidates = range(1, min(_RIGID_BODY_MODES, squares.size - 1) + 1)
    free = max((k for k in candidates if squares[k - 1] < _RIGID * squares[k]), default=0)
    squares[:free] = 0.0
    return np.asarray(np.sqrt(np.maximum(squares[: free + count], 0.0)))


def _held(stiffness: Any) -> Any:
    """Factor of a stiffness that leaves no rigid-body motion, regular within rounding; None where it leaves one.

    Raises:
        ValueError: a negative eigenvalue.
    """
    diagonal = stiffness.diagonal()
    if not np.all(diagonal > 0.0):
        return None
    factor = _factor(stiffness)
    if factor is None:
        return None
    # Row k of L U is row perm_r⁻¹(k) of the matrix.
    shares = factor.U.diagonal() / diagonal[np.argsort(factor.perm_r)]
    if shares.min() < -_ROUNDING:
        raise ValueError("stiffness has a negative eigenvalue; a passive structure at rest has none")
    return factor if shares.min() > _FREE else None


def _lowest(stiffness: Any, mass: Any, factor: Any, count: int) -> Array:
    """(n, count) mass-normalised modes of the lowest frequencies; `factor` is that of the stiffness."""
    n = int(stiffness.shape[0])
    if count == 0:
        return np.zeros((n, 0))
    if n <= _DENSE or count >= n - 1:
        # Of the inverse problem, in which rows without mass have the eigenvalue 0.
        values, vectors = eigh(mass.toarray(), stiffness.toarray(), subset_by_index=[n - count, n - 1])
        if values[0] <= _MASSLESS * values[-1]:
            heavy = int(np.sum(values > _MASSLESS * values[-1]))
            raise ValueError(f"{heavy} modes of the structure have mass, {count} are asked for")
        return np.asarray(vectors[:, ::-1] / np.sqrt(values[::-1]))
    # A fixed start vector: the same file gives the same numbers.
    inverse = LinearOperator((n, n), matvec=factor.solve, dtype=float)
    values, vectors = eigsh(stiffness, k=count, M=mass, sigma=0.0, OPinv=inverse, v0=factor.solve(mass @ np.ones(n)))
    return np.asarray(vectors[:, np.argsort(values)])
