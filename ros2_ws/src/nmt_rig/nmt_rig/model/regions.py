"""Parts of a finite-element model that may be off: elements or masses of a region, and supports that may give way.

A region's own matrices come from a file: entries at its edge belong to elements on both sides, and what each side has
of them does not follow from the assembled matrices. Mass needs no file: what moves with a set of nodes is their block.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import eigh

from nmt_rig.model.matrix_structure import Matrices, craig_bampton

Rows = NDArray[np.int64]
# Modes of the held structure whose reactions a support may give way to, and share of the largest reaction left out.
_REACTIONS, _SMALLEST = 12, 1e-4


@dataclass(frozen=True)
class Support:
    """Rows that an ideal support holds and an elastic one carries by a spring each.

    Attributes:
        name: of its region.
        nodes: number of its nodes.
        translations, rotations: rows of either kind.
        others: rows of its nodes that are neither; held whatever it is made of.
    """

    name: str
    nodes: int
    translations: Rows
    rotations: Rows
    others: Rows


@dataclass(frozen=True)
class Supported:
    """A structure whose supported rows move by patterns instead of one by one.

    Attributes:
        matrices: of the free rows, then the patterns.
        motion: (N, n) motion of the rows of the full structure by them.
        free: (f,) rows of the full structure that are not supported.
        patterns: by support and kind (0 translations, 1 rotations): columns of ``motion``; springs of unit stiffness at
            all rows of a kind are springs of unit stiffness at its patterns.
    """

    matrices: Matrices
    motion: Any
    free: Rows
    patterns: dict[tuple[str, int], range]


def block_of(matrix: Any, rows: Rows) -> Any:
    """The matrix with only the entries between some rows, sparse (n, n)."""
    kept = np.zeros(matrix.shape[0])
    kept[rows] = 1.0
    only = sparse.diags(kept)
    return sparse.csr_matrix(only @ sparse.csr_matrix(matrix) @ only)


def supported(matrices: Matrices, kept: Sequence[int], modes: int, supports: Sequence[Support]) -> Supported:
    """The structure with its supports elastic in the patterns that their reactions have.

    A support of compliance c that is spread evenly moves by −c times its reactions, so that the reactions of the modes
    of the held structure are what it moves by to first order, and their span is right to second order in frequencies.

    Args:
        matrices: checked matrices of the structure without its supports.
        kept: rows of points, none of them supported.
        modes: of the reduction that follows.
        supports: with rows of their own; the base does not move with them.

    Raises:
        ValueError: a row of a point is supported, or as :func:`nmt_rig.model.matrix_structure.craig_bampton`.
    """
    held = np.unique(np.concatenate([part for s in supports for part in (s.translations, s.rotations, s.others)]))
    if taken := np.intersect1d(held, np.asarray(kept, dtype=np.int64)).tolist():
        raise ValueError(f"row {taken[0]} is both a point's and of a region that is held; take it out of one of them")
    stiffness, mass = (sparse.csr_matrix(matrix) for matrix in (matrices.stiffness, matrices.mass))
    free = np.setdiff1d(np.arange(matrices.size), held)
    ideal = Matrices(mass[free][:, free], stiffness[free][:, free])
    small = craig_bampton(ideal, np.searchsorted(free, kept).tolist(), modes)
    squares, shapes = eigh(small.stiffness, small.mass)
    lowest = np.asarray(small.basis) @ (shapes[:, :_REACTIONS] / squares[:_REACTIONS])
    columns, patterns, at = [], {}, free.size
    for support in supports:
        for kind, rows in enumerate((support.translations, support.rotations)):
            if not rows.size:
                continue
            reactions = np.asarray(stiffness[rows][:, free] @ lowest)
            directions, sizes, _ = np.linalg.svd(reactions, full_matrices=False)
            directions = directions[:, sizes > _SMALLEST * sizes[0]]
            pattern = np.zeros((matrices.size, directions.shape[1]))
            pattern[rows] = directions
            columns.append(pattern)
            patterns[support.name, kind] = range(at, at + directions.shape[1])
            at += directions.shape[1]
    free_rows = sparse.csr_matrix((np.ones(free.size), (free, np.arange(free.size))), shape=(matrices.size, free.size))
    motion = sparse.csr_matrix(sparse.hstack([free_rows, *map(sparse.csr_matrix, columns)]))

    def moved(matrix: Any) -> Any:
        return None if matrix is None else sparse.csr_matrix(motion.T @ sparse.csr_matrix(matrix) @ motion)

    result = Matrices(moved(mass), moved(stiffness), moved(matrices.damping))
    return Supported(result, motion, free, patterns)
