"""Parts of a finite-element model that may be off: elements or masses of a region, and supports that may give way.

A region's own matrices come from a file: entries at its edge belong to elements on both sides, and what each side has
of them does not follow from the assembled matrices. Mass needs no file: what moves with a set of nodes is their block.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import eigh
from scipy.sparse.linalg import splu

from nmt_core.numerics.arrays import FloatArray
from nmt_rig.model.matrix_structure import Matrices, craig_bampton

Rows = NDArray[np.int64]
# Modes of the held structure whose reactions a support may give way to, and share of the largest reaction left out.
_REACTIONS, _SMALLEST = 12, 1e-4
# Springs that take half of ω², over the stiffness of their rows: smaller ones are rounding of a reaction that is zero.
_NO_REACTION = 1e-12


@dataclass(frozen=True)
class Support:
    """Rows that an ideal support holds and an elastic one carries by springs.

    Attributes:
        name: of its region.
        nodes: number of its nodes.
        translations, rotations: rows of either kind.
        others: rows of its nodes that are neither; held whatever it is made of.
        spread: (translations, translations) and (rotations, rotations) springs of a support that is as stiff all over;
            the entries of each direction sum to ``nodes``. None = a spring of 1 at each row.
    """

    name: str
    nodes: int
    translations: Rows
    rotations: Rows
    others: Rows
    spread: tuple[Any, Any] | None = None

    @property
    def springs(self) -> tuple[tuple[Rows, Any], ...]:
        """Rows of translations and of rotations with the springs between them."""
        each = self.spread or tuple(sparse.eye(rows.size, format="csc") for rows in (self.translations, self.rotations))
        return tuple(zip((self.translations, self.rotations), each, strict=True))


@dataclass(frozen=True)
class Supported:
    """A structure whose supported rows move by patterns instead of one by one.

    Attributes:
        matrices: of the free rows, then the patterns.
        motion: (N, n) motion of the rows of the full structure by them.
        free: (f,) rows of the full structure that are not supported.
        patterns: by support and kind (0 translations, 1 rotations): columns of ``motion``; the springs of a kind are
            springs of unit stiffness at its patterns.
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


def spread_of(mass: Any, rows: Rows, labels: Rows, others: Rows, other_labels: Rows) -> Any:
    """Springs between rows of a support that is as stiff all over its length or area.

    They have the form of the mass of its nodes: ∫ NᵀN of the elements along it. A spring for each node would be too
    stiff against turning, by 2/n² along n elements even where its ends have half of one.

    Args:
        mass: (n, n) of the structure, sparse.
        rows: translations of the nodes, which have the mass.
        labels: node · 100 + direction of these.
        others: rows between which the springs are.
        other_labels: the same of these.

    Returns:
        Sparse (others, others); the entries of each direction sum to the number of its nodes. Nodes without mass have
        a spring each.
    """
    nodes, number = np.unique(np.concatenate([labels // 100, other_labels // 100]), return_inverse=True)
    of, count = number[: rows.size], nodes.size
    alike = sparse.coo_matrix(sparse.csr_matrix(mass)[rows][:, rows])
    same = labels[alike.row] % 100 == labels[alike.col] % 100
    blocks = sparse.csr_matrix(
        (alike.data[same], (of[alike.row[same]], of[alike.col[same]])), shape=(count, count)
    )  # the sum over directions
    if not np.all(blocks.diagonal() > 0.0):
        return sparse.eye(others.size, format="csc")
    parts, at = [], []
    for direction in np.unique(other_labels % 100):
        here = np.flatnonzero(other_labels % 100 == direction)
        part = blocks[number[rows.size + here]][:, number[rows.size + here]]
        parts.append(part * (here.size / part.sum()))
        at.append(here)
    order = np.argsort(np.concatenate(at)) if at else np.zeros(0, int)
    return sparse.csc_matrix(sparse.block_diag(parts))[order][:, order] if parts else sparse.csc_matrix((0, 0))


def _scaled(motions: Any, springs: Any) -> Any:
    """Motions of a support, (rows, k), over the root of the largest energy of its springs."""
    largest = float(np.max(np.einsum("rk,rk->k", motions, springs @ motions)))
    return motions / math.sqrt(largest) if largest > 0.0 else motions


def _soft(stiffness: Any, free: Rows, rows: Rows, springs: Any, reactions: Any, squares: FloatArray) -> Any:
    """Static motions (rows, k) of a support by reactions (rows, k), its springs so soft that a mode loses half its ω².

    Args:
        stiffness: of the full structure.
        free: rows that no support holds.
        rows: of this support.
        springs: between them.
        reactions: of modes of the held structure, mass-normalised, each over its ω².
        squares: ω² of these, (k,).
    """
    # To first order compliances c S⁻¹ take c ω⁴ r·S⁻¹r of the ω² of a mode.
    losses = np.einsum("rk,rk->k", reactions, splu(springs).solve(reactions))
    mode = int(np.argmax(losses))
    softest = 2.0 * float(squares[mode] * losses[mode])
    if softest * springs.diagonal().max() <= _NO_REACTION * stiffness.diagonal()[rows].max():
        return np.zeros_like(reactions)  # no mode moves it
    every = np.concatenate([free, rows])
    held = sparse.block_diag([sparse.csr_matrix((free.size, free.size)), springs * softest])
    loads = np.vstack([np.zeros((free.size, reactions.shape[1])), reactions])
    return splu(sparse.csc_matrix(stiffness[every][:, every] + held)).solve(loads)[free.size :]


def supported(matrices: Matrices, kept: Sequence[int], modes: int, supports: Sequence[Support]) -> Supported:
    """The structure with its supports elastic in the patterns that their reactions have.

    An elastic support moves by minus its reactions over its springs, so that this, of the reactions of the modes of the
    held structure, is what it moves by to first order, and their span is right to second order in frequencies.

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
        for kind, (rows, springs) in enumerate(support.springs):
            if not rows.size:
                continue
            reactions = np.asarray(stiffness[rows][:, free] @ lowest)
            springs = sparse.csc_matrix(springs)
            gives = splu(springs).solve(reactions)
            motions = np.hstack(
                [
                    _scaled(each, springs)
                    for each in (gives, _soft(stiffness, free, rows, springs, reactions, squares[:_REACTIONS]))
                ]
            )
            energies, combined = eigh(motions.T @ (springs @ motions))
            kept_patterns = energies > _SMALLEST**2 * energies[-1]
            directions = motions @ (combined[:, kept_patterns] / np.sqrt(energies[kept_patterns]))
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
