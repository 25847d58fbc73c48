"""Regions of a finite-element model as a rig file names them: their nodes, and matrices of their own from files."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from nmt_rig.file_errors import BadFileError, KeyOfRigError
from nmt_rig.matrix_files import read_model
from nmt_rig.model.matrix_structure import Matrices, PartMatrix, craig_bampton, projection
from nmt_rig.model.packed_matrix import packed
from nmt_rig.model.regions import Rows, Support, block_of, spread_of, supported
from nmt_rig.named_rows import NamedModel, Units

_NAME = re.compile(r"[A-Za-z](?:[A-Za-z0-9_ -]*[A-Za-z0-9_-])?")
WRITTEN = ("stiffness_n_m", "mass_kg", "moved_kg", "translation_rows", "rotation_rows")
"""Keys of a region that the bench writes."""


@dataclass
class Region:
    """A region in the rows of its model, in SI units.

    Attributes:
        section: as in the rig file.
        nodes: its nodes, ascending.
        stiffness, mass: (n, n) of its own, None where it has none.
        support: rows that it holds; None where it holds none.
        moved_kg: mass that moves with it.
        written: keys that come out of the reduction.
    """

    section: Mapping[str, Any]
    nodes: list[int]
    stiffness: Any = None
    mass: Any = None
    support: Support | None = None
    moved_kg: float = 0.0
    written: dict[str, Any] = field(default_factory=dict)

    def keys(self) -> dict[str, Any]:
        """Keys of the region in the rig that was read."""
        kept = {key: value for key, value in self.section.items() if key not in ("file", "within")}
        return kept | {"nodes": self.nodes, "moved_kg": self.moved_kg, **self.written}


def read_regions(
    model: NamedModel, sections: Mapping[str, Any], folder: Path, units: Units, rotations: Sequence[int]
) -> dict[str, Region]:
    """The regions of a rig file on its model.

    Args:
        model: as it was read.
        sections: by name, as in the rig file.
        folder: where relative paths start.
        units: of all files.
        rotations: rows in rad where the length of the files is not the metre.

    Raises:
        ValueError: nodes or files that do not fit, in words.
        OSError: a file cannot be read.
    """
    if not isinstance(sections, Mapping):
        raise ValueError("structure.regions must be regions by name, as patch: {nodes: [4, 5, 6]}")
    found = {}
    for name, section in sections.items():
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise KeyOfRigError(
                ("structure", "regions"),
                f"region {name!r}: a name begins with a letter and has letters, digits, blanks, - and _",
            )
        try:
            found[name] = _region(model, name, section, folder, units, rotations)
        except (BadFileError, ValueError) as error:
            raise KeyOfRigError(("structure", "regions", name), f"region {name}: {error}") from error
    held = [(name, node) for name, region in found.items() if region.support for node in region.nodes]
    for name, node in held:
        if other := next((each for each, same in held if same == node and each != name), None):
            raise ValueError(f"regions {name} and {other} both hold node {node}; take it out of one of them")
    return found


def _region(model: NamedModel, name: str, section: Any, folder: Path, units: Units, rotations: Sequence[int]) -> Region:
    if not isinstance(section, Mapping):
        raise ValueError("it must have nodes, within or file")
    if written := [key for key in WRITTEN if section.get(key)]:
        raise ValueError(f"{written[0]} is written by the bench; leave it out next to files of the model")
    from_file: dict[str, Any] = {}
    if section.get("file") is not None:
        from_file = _own_matrices(model, folder / Path(str(section["file"])).expanduser(), units, rotations)
    nodes = _nodes(model, section)
    labels = np.zeros(0, np.int64) if model.labels is None else model.labels
    rows = np.flatnonzero(np.isin(labels // 100, nodes))
    if section.get("held"):
        if from_file:
            raise ValueError("it is held and has a file; name the support and the part of the structure apart")
        if not rows.size:
            raise ValueError("it is held and names no nodes")
        directions = labels[rows] % 100
        translations, turned = rows[(directions >= 1) & (directions <= 3)], rows[(directions >= 4) & (directions <= 6)]
        others = rows[(directions < 1) | (directions > 6)]
        spread = tuple(
            spread_of(model.matrices["mass"], translations, labels[translations], part, labels[part])
            for part in (translations, turned)
        )
        return Region(section, nodes, support=Support(name, len(nodes), translations, turned, others, spread))
    if not from_file and not rows.size:
        raise ValueError("it has neither nodes nor a file")
    mass = from_file.get("mass")
    if mass is None and rows.size:
        mass = block_of(units.in_si({"mass": model.matrices["mass"]}, rotations)["mass"], rows)
    if not nodes and labels.size:
        nodes = np.unique(labels[np.concatenate([_touched(matrix) for matrix in from_file.values()])] // 100).tolist()
    moved = 0.0 if mass is None else _moved(mass, labels)
    return Region(section, nodes, from_file.get("stiffness"), mass, moved_kg=moved)


def _touched(matrix: Any) -> Rows:
    """Rows with entries."""
    return np.flatnonzero(np.asarray(abs(matrix).sum(axis=1)).reshape(-1) > 0.0)


def _moved(mass: Any, labels: Any) -> float:
    """Mass (kg) of a region that is displaced rigidly, the largest over x, y and z."""
    directions = [(labels % 100 == number).astype(float) for number in (1, 2, 3)] if labels.size else []
    return max((float(each @ (mass @ each)) for each in directions), default=0.0)


def _nodes(model: NamedModel, section: Mapping[str, Any]) -> list[int]:
    """Nodes of a region by number and by the box that they lie in."""
    listed, box = section.get("nodes") or [], section.get("within")
    if not isinstance(listed, list) or not all(isinstance(node, int) and not isinstance(node, bool) for node in listed):
        raise ValueError("nodes must be a list of numbers of nodes")
    if (listed or box is not None) and model.labels is None:
        raise ValueError("the files do not say which node a row belongs to; give structure.rows_file")
    known = set() if model.labels is None else set(np.unique(model.labels // 100).tolist())
    if unknown := sorted(set(listed) - known):
        raise ValueError(f"node {unknown[0]} is not among the {len(known)} nodes that the matrices have")
    nodes = set(listed)
    if box is not None:
        try:
            low, high = np.array(box, dtype=float).reshape(2, 3)
        except (TypeError, ValueError) as error:
            raise ValueError("within must be two corners, as [[0, 0, 0], [0.1, 0.2, 0.01]]") from error
        if not model.nodes.size:
            raise ValueError("the files have no coordinates of nodes; give structure.nodes_file, or nodes by number")
        inside = np.all((model.nodes[:, 1:] >= low) & (model.nodes[:, 1:] <= high), axis=1)
        boxed = set(model.nodes[inside, 0].astype(np.int64).tolist()) & known
        if not boxed:
            raise ValueError("no node of the model lies within it")
        nodes |= boxed
    return sorted(nodes)


def _own_matrices(model: NamedModel, path: Path, units: Units, rotations: Sequence[int]) -> dict[str, Any]:
    """Stiffness and mass of a file in the rows of the model; rows that the model holds are left out."""
    if not path.is_file():
        raise ValueError(f"there is no file {path}; fix the path")
    part = read_model({"file": path})
    found: dict[str, Any] = {name: part.matrices[name] for name in ("stiffness", "mass") if name in part.matrices}
    if not found:
        raise BadFileError(f"{path.name} has neither a stiffness nor a mass")
    n = model.matrices["stiffness"].shape[0]
    if part.labels is None or model.labels is None:
        for name, matrix in found.items():
            if matrix.shape != (n, n):
                raise BadFileError(
                    f"the {name} of {path.name} has {matrix.shape[0]} rows without names, the model {n}; name them by "
                    "node and direction, or export all of them"
                )
        placed = found
    else:
        order = np.argsort(model.labels, kind="stable")
        place = np.searchsorted(model.labels[order], part.labels)
        there = np.isin(part.labels, model.labels)
        if not there.any():
            raise BadFileError(f"no node of {path.name} is one of the model")
        rows = order[np.minimum(place, n - 1)]
        to_model = sparse.csr_matrix(
            (np.ones(int(there.sum())), (rows[there], np.flatnonzero(there))), shape=(n, part.labels.size)
        )
        placed = {name: sparse.csr_matrix(to_model @ sparse.csr_matrix(m) @ to_model.T) for name, m in found.items()}
    for name, matrix in placed.items():
        if abs(matrix - matrix.T).max() > 1e-8 * abs(matrix).max():
            raise BadFileError(f"the {name} of {path.name} is not symmetric")
    return units.in_si(placed, rotations)


def reduced_with_regions(
    matrices: Matrices, kept: Sequence[int], modes: int, regions: Mapping[str, Region], most: int
) -> tuple[Matrices, dict[str, Any]]:
    """The reduced structure, ideal supports behind its points, and the regions in its coordinates.

    Args:
        matrices: checked matrices of the structure; supports are not held in them.
        kept: rows of the points.
        modes: to keep next to them.
        regions: on these rows.
        most: coordinates next to those of supports, up to which what the modes left out answer is kept, too.

    Returns:
        Matrices, and regions by name as the rig has them.

    Raises:
        ValueError: as :func:`nmt_rig.model.regions.supported` and the reduction.
    """
    supports = [region.support for region in regions.values() if region.support is not None]
    coordinates, projected, patterns = list(kept), _same, {}
    if supports:
        if matrices.base_vector is not None or matrices.base_load is not None:
            raise ValueError("a region that is held does not go with base_vector or base_load_kg; hold it in the model")
        found = supported(matrices, kept, modes, supports)
        matrices, patterns, motion = found.matrices, found.patterns, found.motion
        coordinates = [*np.searchsorted(found.free, kept).tolist(), *range(found.free.size, matrices.size)]

        def projected(matrix: Any) -> Any:
            return sparse.csr_matrix(motion.T @ sparse.csr_matrix(matrix) @ motion)

    parts = {
        (name, key): PartMatrix(projected(matrix), key == "mass_kg")
        for name, region in regions.items()
        for key, matrix in (("stiffness_n_m", region.stiffness), ("mass_kg", region.mass))
        if matrix is not None
    }
    small = craig_bampton(matrices, coordinates, modes, list(parts.values()), len(coordinates) - len(kept), most)
    assert small.basis is not None
    for (name, key), part in parts.items():
        regions[name].written[key] = packed(projection(part.matrix, small.basis))
    number = {row: column for column, row in enumerate(coordinates)}
    for (name, kind), columns in patterns.items():
        key = ("translation_rows", "rotation_rows")[kind]
        regions[name].written[key] = [number[column] for column in columns]
    return small, {name: region.keys() for name, region in regions.items()}


def _same(matrix: Any) -> Any:
    return matrix
