"""Rows of matrices by node and direction, as finite-element programs name them, and the units of their figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from nmt_rig.file_errors import BadFileError

DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")
"""Of the degrees of freedom 1 to 6 of a node."""

# Degrees of freedom of a node go up to some tens: pressure, temperature, internal ones.
_PER_NODE = 100
_LARGEST_NODE = 10**12
# What programs write on the diagonal of a degree of freedom that is held, in place of removing it.
_HELD = 1e30
_LENGTHS_M = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254, "ft": 0.3048}
_MASSES_KG = {"kg": 1.0, "t": 1e3, "g": 1e-3, "lb": 0.45359237, "slug": 14.593902937, "slinch": 175.126835246}
_FORCES_N = {"N": 1.0, "kN": 1e3, "mN": 1e-3, "lbf": 4.4482216152605}
# Masses, and masses in the cube around the nodes, beyond which no structure on a test bench lies.
_SMALLEST_MASS_KG, _LARGEST_MASS_KG = 1e-4, 1e8
_THINNEST_KG_M3, _DENSEST_KG_M3 = 1e-3, 1e5

Labels = NDArray[np.int64]


def label(node: Any, direction: Any) -> Any:
    """One number for node and direction (1 to 6 for translations and rotations, 0 of a scalar point).

    Raises:
        BadFileError: a node beyond 10¹².
    """
    nodes = np.asarray(node)
    if nodes.dtype == object or np.any(np.abs(nodes.astype(float)) > _LARGEST_NODE):
        raise BadFileError("it has a number of a node beyond 10¹²")
    return nodes.astype(np.int64) * _PER_NODE + np.asarray(direction, dtype=np.int64)


def once(rows: Any, columns: Any, names: Callable[[int], str] = str) -> None:
    """Refuse a list that has an entry of a matrix twice, as one has that was written into an older file.

    Args:
        rows, columns: (n,) of the entries.
        names: words for a row.

    Raises:
        BadFileError: the first such entry.
    """
    order = np.lexsort((columns, rows))
    r, c = np.asarray(rows)[order], np.asarray(columns)[order]
    again = np.flatnonzero((r[1:] == r[:-1]) & (c[1:] == c[:-1]))
    if again.size:
        where = f"{names(int(r[again[0]]))}, {names(int(c[again[0]]))}"
        raise BadFileError(f"it has the entry {where} twice; keep one of them, or their sum")


def label_words(number: int) -> str:
    """Node and direction of a label, as node 17 z."""
    return f"node {number // _PER_NODE} {direction_words([number % _PER_NODE])}"


@dataclass(frozen=True)
class Entries:
    """Entries of a symmetric matrix by the labels of their rows and columns, each once."""

    rows: Labels
    columns: Labels
    values: NDArray[np.float64]


@dataclass(frozen=True)
class ModelPart:
    """What one file says.

    Attributes:
        matrices: square matrices by quantity, whose rows the labels name where there are any.
        labels: (n,) labels of the rows of ``matrices``.
        entries: matrices by quantity, given by labels.
        nodes: (m, 4) number and coordinates of each node, in the units of the file.
    """

    matrices: Mapping[str, Any] = field(default_factory=dict)
    labels: Labels | None = None
    entries: Mapping[str, Entries] = field(default_factory=dict)
    nodes: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class NamedModel:
    """Matrices of one structure by quantity, with names of their rows.

    Attributes:
        matrices: mass, stiffness, damping (n, n), base_vector and base_load (n,), in the units of the file.
        labels: (n,) node and direction of each row, None where no file says them.
        nodes: (m, 4) number and coordinates of nodes, with no row where no file says them.
        held: rows that were left out as the program holds them.
    """

    matrices: dict[str, Any]
    labels: Labels | None
    nodes: NDArray[np.float64]
    held: int = 0

    def row(self, node: int, direction: str) -> int:
        """Row of a node's direction.

        Raises:
            ValueError: the files do not name rows, or have no such node or direction.
        """
        if self.labels is None:
            raise ValueError(
                "the file does not say which node a row belongs to; give the points by row, or the nodes of the rows "
                "as structure.rows_file"
            )
        found = np.flatnonzero(self.labels == label(node, DIRECTIONS.index(direction) + 1))
        if found.size:
            return int(found[0])
        there = self.labels[self.labels // _PER_NODE == node] % _PER_NODE
        if not there.size:
            known = np.unique(self.labels // _PER_NODE)
            raise ValueError(
                f"node {node} is not among the {known.size} nodes that are kept, {known[0]} to {known[-1]}"
            )
        raise ValueError(f"node {node} has no direction {direction}, only {direction_words(there)}")

    def nearest(self, place: Sequence[float]) -> tuple[int, float]:
        """Node that has rows nearest to a place, and its distance, both in the units of the file.

        Raises:
            ValueError: no coordinates of these nodes are known.
        """
        if self.labels is None or not self.nodes.size:
            raise ValueError(
                "the files have no coordinates of nodes; give the points by node, or a file with the nodes as "
                "structure.nodes_file"
            )
        known = self.nodes[np.isin(self.nodes[:, 0].astype(np.int64), self.labels // _PER_NODE)]
        if not known.size:
            raise ValueError("none of the nodes with coordinates has a row of the matrices")
        distances = np.linalg.norm(known[:, 1:] - np.asarray(place, dtype=float), axis=1)
        best = int(np.argmin(distances))
        return int(known[best, 0]), float(distances[best])

    def mass_by_direction(self) -> dict[str, float]:
        """Mass that moves when the whole structure is displaced in x, y or z, for the directions that have rows."""
        if self.labels is None or "mass" not in self.matrices:
            return {}
        masses = {}
        for number, name in enumerate(DIRECTIONS[:3], start=1):
            moved = (self.labels % _PER_NODE == number).astype(float)
            if moved.any():
                masses[name] = float(moved @ (self.matrices["mass"] @ moved))
        return masses

    def in_metres(self, units: Units) -> NamedModel:
        """The same with mass and coordinates in kg and m; rotations stay as they are."""
        nodes = self.nodes * np.array([1.0, *[units.length_m] * 3])
        mass = {name: value * units.mass_kg for name, value in self.matrices.items() if name == "mass"}
        return NamedModel(self.matrices | mass, self.labels, nodes, self.held)

    def doubt_of_units(self) -> str:
        """Why the figures cannot be those of a structure in metres and kilograms; empty where they can."""
        masses = self.mass_by_direction()
        mass = max(masses.values(), default=0.0)
        if not mass > 0.0:
            return ""
        if not _SMALLEST_MASS_KG < mass < _LARGEST_MASS_KG:
            return f"its mass is {mass:.3g} kg"
        if self.nodes.shape[0] > 1:
            size = float(np.linalg.norm(np.ptp(self.nodes[:, 1:], axis=0)))
            if size > 0.0 and not _THINNEST_KG_M3 < mass / size**3 < _DENSEST_KG_M3:
                return f"its mass is {mass:.3g} kg and its nodes are up to {size:.3g} m apart"
        return ""


def direction_words(directions: Any) -> str:
    """Names of degrees of freedom: x, y and rz."""
    names = [DIRECTIONS[d - 1] if 1 <= d <= len(DIRECTIONS) else f"number {d}" for d in np.unique(directions).tolist()]
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def united(parts: Sequence[ModelPart]) -> NamedModel:
    """One model of several files; rows in the order of the files where all agree, else by node.

    Raises:
        BadFileError: a quantity comes twice, files that name their rows meet files that do not, numbers that are not
            finite, or Lagrange multipliers.
    """
    quantities = [name for part in parts for name in (*part.matrices, *part.entries)]
    for name in quantities:
        if quantities.count(name) > 1:
            raise BadFileError(f"the {name} comes twice")
    for part in parts:
        for name, value in (*part.matrices.items(), *((n, each.values) for n, each in part.entries.items())):
            # Before rows are left out by their diagonals, in which NaN is not less than anything.
            if not np.all(np.isfinite(value.data if sparse.issparse(value) else value)):
                raise BadFileError(f"the {name} has entries that are not finite numbers")
    nodes = [part.nodes for part in parts if part.nodes is not None and part.nodes.size]
    all_nodes = np.unique(np.concatenate(nodes), axis=0) if nodes else np.zeros((0, 4))
    labelled = [part.labels for part in parts if part.labels is not None]
    entries = {name: value for part in parts for name, value in part.entries.items()}
    if not entries and all(np.array_equal(labels, labelled[0]) for labels in labelled[1:]):
        matrices = {name: value for part in parts for name, value in part.matrices.items()}
        labels = labelled[0] if labelled else None
        if labels is not None:
            wrong = [name for name, value in matrices.items() if value.shape[0] != labels.size]
            if wrong:
                raise BadFileError(f"the {wrong[0]} has {matrices[wrong[0]].shape[0]} rows, {labels.size} are named")
        return _without_held(matrices, labels, all_nodes)
    for part in parts:
        for name, matrix in part.matrices.items():
            if part.labels is None:
                raise BadFileError(f"the {name} has rows by number, other files by node; give all by node")
            plain = sparse.coo_matrix(matrix)
            entries[name] = Entries(part.labels[plain.row], part.labels[plain.col], plain.data)
    return _without_held(*_assembled(entries), all_nodes)


def _assembled(entries: Mapping[str, Entries]) -> tuple[dict[str, Any], Labels]:
    """Sparse matrices with one order of rows, by node and direction."""
    labels = np.unique(np.concatenate([part for each in entries.values() for part in (each.rows, each.columns)]))
    n = labels.size
    matrices = {}
    for name, each in entries.items():
        once(each.rows, each.columns, label_words)
        places = (np.searchsorted(labels, each.rows), np.searchsorted(labels, each.columns))
        matrices[name] = mirrored(sparse.coo_matrix((each.values, places), shape=(n, n)).tocsr())
    return matrices, labels


def mirrored(matrix: Any) -> Any:
    """The sparse matrix with both triangles: an entry whose mirror image the file leaves out is taken for both."""
    pattern = matrix.copy()
    pattern.data = np.ones_like(pattern.data)
    image = matrix.T.tocsr()
    return (matrix + image - image.multiply(pattern)).tocsr()


def _without_held(matrices: dict[str, Any], labels: Labels | None, nodes: NDArray[np.float64]) -> NamedModel:
    """Without the rows that a program holds: by a huge diagonal entry of the stiffness, or by leaving them empty."""
    stiffness = matrices.get("stiffness")
    _refuse_multipliers(matrices, labels)
    if labels is None or stiffness is None or stiffness.ndim != 2 or stiffness.shape[0] != labels.size:
        return NamedModel(matrices, labels, nodes)
    sizes = [np.asarray(abs(value).sum(axis=1)).reshape(-1) for value in matrices.values() if value.ndim == 2]
    free = np.flatnonzero((np.abs(stiffness.diagonal()) < _HELD) & (np.sum(sizes, axis=0) > 0.0))
    if free.size < labels.size:
        matrices = {
            name: value[free] if value.ndim == 1 else sparse.csr_matrix(value)[free][:, free]
            for name, value in matrices.items()
        }
    return NamedModel(matrices, labels[free], nodes, labels.size - free.size)


def _refuse_multipliers(matrices: Mapping[str, Any], labels: Labels | None) -> None:
    """Refuse rows without mass and without a positive stiffness that couple others: Lagrange multipliers.

    K_ij² ≤ K_ii K_jj holds in every passive structure.
    """
    mass, stiffness = matrices.get("mass"), matrices.get("stiffness")
    if mass is None or stiffness is None or mass.ndim != 2 or mass.shape != stiffness.shape:
        return
    suspects = (stiffness.diagonal() <= 0.0) & (np.asarray(abs(mass).sum(axis=1)).reshape(-1) == 0.0)
    multipliers = np.flatnonzero(suspects & (np.asarray(abs(stiffness).sum(axis=1)).reshape(-1) > 0.0))
    if multipliers.size:
        first = int(multipliers[0])
        where = f"row {first}" if labels is None else label_words(int(labels[first]))
        raise BadFileError(
            f"{where} is a Lagrange multiplier (it couples other rows and has neither mass nor a positive stiffness); "
            "export the matrices with the constraint eliminated, as by *MPC or *EQUATION in place of a tie or hybrid "
            "elements"
        )


@dataclass(frozen=True)
class Units:
    """Length, mass and force of a file in m, kg and N; time follows from them, as in every consistent system."""

    length_m: float = 1.0
    mass_kg: float = 1.0
    force_n: float = 1.0

    @classmethod
    def named(cls, text: str) -> Units:
        """From a text as mm-t-N.

        Raises:
            ValueError: a unit that is not known.
        """
        tables = (_LENGTHS_M, _MASSES_KG, _FORCES_N)
        words = text.split("-")
        if len(words) != len(tables) or any(word not in table for word, table in zip(words, tables, strict=True)):
            known = ", ".join("-".join(each) for each in (("m", "kg", "N"), ("mm", "t", "N"), ("in", "slinch", "lbf")))
            raise ValueError(
                f"units are length, mass and force, as {known}, of {'/'.join(_LENGTHS_M)}, {'/'.join(_MASSES_KG)} and "
                f"{'/'.join(_FORCES_N)}; got {text!r}"
            )
        return cls(*(table[word] for word, table in zip(words, tables, strict=True)))

    def in_si(self, matrices: Mapping[str, Any], rotations: Sequence[int]) -> dict[str, Any]:
        """The same matrices in SI units, rotations in rad for the rows named; those of other rows stay scaled by a
        length, which changes nothing at the points."""
        time_s = float(np.sqrt(self.mass_kg * self.length_m / self.force_n))
        factors = {
            "mass": self.mass_kg, "stiffness": self.force_n / self.length_m,
            "damping": self.force_n * time_s / self.length_m, "base_vector": 1.0, "base_load": self.mass_kg,
        }  # fmt: skip
        result: dict[str, Any] = {name: value * factors[name] for name, value in matrices.items()}
        if not rotations or self.length_m == 1.0:
            return result
        n = next(value.shape[0] for value in matrices.values())
        scale = np.ones(n)
        scale[list(rotations)] = self.length_m
        for name, value in result.items():
            if name == "base_vector":
                result[name] = value / scale
            elif value.ndim == 1:
                result[name] = value * scale
            else:
                diagonal = sparse.diags(scale)
                result[name] = diagonal @ value @ diagonal if sparse.issparse(value) else value * np.outer(scale, scale)
        return result
