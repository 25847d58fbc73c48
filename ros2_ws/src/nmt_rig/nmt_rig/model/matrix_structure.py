"""Structure given by its matrices, as a finite-element code exports them, with reduction to points and modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.linalg import eigh
from scipy.sparse.linalg import eigsh, splu

from nmt_rig.model.structure import Array

# Relative size of rounding in matrices that come through files.
_ROUNDING = 1e-8
# Pivots below this share of the largest diagonal entry say that a structure moves freely.
_FREE = 1e-12
# Up to this size all eigenvalues are computed, beyond it the lowest ones by Lanczos iteration.
_DENSE = 600


@dataclass(frozen=True)
class Matrices:
    """M, C and K with the displacement r of all degrees of freedom for a unit displacement of the base.

    Attributes:
        mass, damping, stiffness: (n, n) dense or sparse; damping None = none given.
        base_vector: (n,) r, None where it is not known; 0 for the modes of a reduced structure.
        base_load: (n,) M r + M_b, None = M r.
    """

    mass: Any
    stiffness: Any
    damping: Any = None
    base_vector: Array | None = None
    base_load: Array | None = None

    @property
    def size(self) -> int:
        """Number of degrees of freedom n."""
        return int(self.stiffness.shape[0])

    def checked(self) -> Matrices:
        """The same, made exactly symmetric.

        Raises:
            ValueError: not square, of different sizes, not finite, not symmetric, a mass that is not positive definite,
                or a stiffness or damping with negative eigenvalues (of the lowest ones where the matrices are large).
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
        if not _positive_definite(result["mass"]):
            raise ValueError(
                "the mass must be positive definite; condense degrees of freedom without mass (Lagrange multipliers, "
                "rotations of lumped masses) before the export"
            )
        for name in ("stiffness", "damping"):
            if name in result and not _positive_definite(result[name], lift=True):
                raise ValueError(f"{name} has a negative eigenvalue; a passive structure at rest has none")
        return Matrices(result["mass"], result["stiffness"], result.get("damping"), self.base_vector, self.base_load)

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
    lifted = (matrix + shift * sparse.identity(matrix.shape[0])).tocsc()
    # Without row exchanges the pivots of a symmetric matrix have the signs of its eigenvalues (Sylvester).
    try:
        factor = splu(lifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError:
        return False
    return bool(np.array_equal(factor.perm_r, factor.perm_c) and np.all(factor.U.diagonal() > 0.0))


def craig_bampton(matrices: Matrices, kept: Sequence[int], modes: int) -> Matrices:
    """Reduction to physical degrees of freedom and fixed-interface modes (Craig and Bampton, AIAA J. 6 (1968) 1313).

    Static deflections under forces at the kept degrees of freedom are exact whatever the number of modes.

    Args:
        matrices: checked matrices of n degrees of freedom.
        kept: rows that stay degrees of freedom, in the new order; the modes come behind them.
        modes: number of modes of the structure with the kept degrees of freedom fixed, the lowest ones.

    Returns:
        Dense matrices of size len(kept) + modes.

    Raises:
        ValueError: rows that do not exist or repeat, more modes than there are, or supports so few that the structure
            moves freely with the kept degrees of freedom fixed.
    """
    n = matrices.size
    own = np.asarray(kept, dtype=np.int64)
    if own.size == 0 or own.min() < 0 or own.max() >= n or np.unique(own).size != own.size:
        raise ValueError(f"the kept degrees of freedom must be different rows of 0 to {n - 1}")
    inner = np.setdiff1d(np.arange(n), own)
    if not 0 <= modes <= inner.size:
        raise ValueError(f"{inner.size} modes are left beside the points, {modes} are asked for")
    stiffness, mass = (sparse.csc_matrix(matrix) for matrix in (matrices.stiffness, matrices.mass))
    k_ii, m_ii = stiffness[inner][:, inner].tocsc(), mass[inner][:, inner].tocsc()
    k_ib = stiffness[inner][:, own].toarray()
    basis = np.zeros((n, own.size + modes))
    basis[own, np.arange(own.size)] = 1.0
    if inner.size:
        if not _held(k_ii):
            raise ValueError(
                "with the points held the structure can still move freely; name more points, or a rotation of one"
            )
        basis[np.ix_(inner, np.arange(own.size))] = splu(k_ii).solve(-k_ib)
        basis[inner, own.size :] = _lowest(k_ii, m_ii, modes)

    def projected(matrix: Any) -> Any:
        if matrix is None:
            return None
        result = basis.T @ np.asarray(matrix @ basis)
        return 0.5 * (result + result.T)

    load, r = matrices.load(), matrices.base_vector
    return Matrices(
        projected(matrices.mass),
        projected(matrices.stiffness),
        projected(matrices.damping),
        None if r is None else np.concatenate([r[own], np.zeros(modes)]),
        None if load is None else basis.T @ load,
    )


def _held(stiffness: Any) -> bool:
    """Whether a stiffness without rigid-body motions is left: regular within rounding."""
    largest = float(np.max(np.abs(stiffness.diagonal())))
    lowered = (stiffness - _FREE * largest * sparse.identity(stiffness.shape[0])).tocsc()
    return _positive_definite(lowered)


def _lowest(stiffness: Any, mass: Any, count: int) -> Array:
    """(n, count) mass-normalised modes of the lowest frequencies."""
    n = int(stiffness.shape[0])
    if count == 0:
        return np.zeros((n, 0))
    if n <= _DENSE or count >= n - 1:
        _, vectors = eigh(stiffness.toarray(), mass.toarray(), subset_by_index=[0, count - 1])
        return np.asarray(vectors)
    # A fixed start vector: the same file gives the same numbers.
    values, vectors = eigsh(stiffness, k=count, M=mass, sigma=0.0, v0=np.ones(n))
    return np.asarray(vectors[:, np.argsort(values)])
