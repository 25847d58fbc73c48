"""Matrices from files: NPZ, MATLAB, those of finite-element programs, or one of each in Matrix Market, NPZ, NPY."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from scipy import io, sparse

from nmt_core.errors import BenchError
from nmt_core.files.hardened import LARGEST_ARRAYS, open_regular, read_array, read_arrays
from nmt_core.files.mat_file import read_mat
from nmt_rig.file_errors import BadFileError
from nmt_rig.named_rows import ModelPart, NamedModel, label, united
from nmt_rig.superelement_binaries import read_full, read_op2, read_op4
from nmt_rig.superelement_texts import (
    is_harwell_boeing,
    is_matrix_market,
    quantity_of,
    read_abaqus,
    read_calculix,
    read_dmig,
    read_nodes,
    read_row_names,
    sister,
)

QUANTITIES = ("mass", "stiffness", "damping")

_NAMES = {
    "mass": ("M", "mass"), "stiffness": ("K", "stiffness"), "damping": ("C", "damping"),
    "base_vector": ("r", "base_vector"), "base_load": ("p", "base_load"),
}  # fmt: skip
# Of mphmatrix of COMSOL, with constraints eliminated and without; E ü + D u̇ + K u.
_COMSOL = ({"mass": "Ec", "stiffness": "Kc", "damping": "Dc"}, {"mass": "E", "stiffness": "K", "damping": "D"})
# Bytes of a full matrix; a structure of so many rows has few entries.
_LARGEST_FULL = 2**27
# What scipy.sparse.save_npz writes.
_SPARSE = ("data", "indices", "indptr", "shape")
_BULK = (".pch", ".bdf", ".dat", ".nas", ".asm", ".dmig")
_LISTS = (".sti", ".mas", ".dam")
_TEXTS = (".mtx", ".inp", ".txt")
_HARWELL_BOEING = (".matrix", ".mapping", ".hb", ".rsa", ".rua", ".rb")


def read_part(path: Path, quantity: str | None = None) -> ModelPart:
    """What one file says of a structure: several matrices, or one.

    Args:
        path: the file.
        quantity: which matrix it is where the rig file says so, None where the file has to.

    Raises:
        BadFileError: another kind of file, or nothing in it that is needed.
        OSError: the file cannot be read.
    """
    suffix = path.suffix.lower()
    if suffix in _HARWELL_BOEING or (suffix in _TEXTS and is_harwell_boeing(path)):
        raise BadFileError(
            "it is a Harwell-Boeing text, as HBMAT of Ansys writes it; write the matrices with *EXPORT,…,MMF of APDL "
            "(Matrix Market)"
        )
    if suffix in _TEXTS and not is_matrix_market(path):
        return read_abaqus(path, quantity or quantity_of(path))
    if suffix in _LISTS:
        return read_calculix(path, str(quantity or quantity_of(path)))
    reader = {".op4": read_op4, ".op2": read_op2, ".full": read_full, **dict.fromkeys(_BULK, read_dmig)}.get(suffix)
    if reader is not None:
        part = reader(path)
        if quantity is None:
            return part
        if quantity not in part.matrices and quantity not in part.entries:
            raise BadFileError(f"it has no {quantity}")
        return ModelPart(
            {name: value for name, value in part.matrices.items() if name == quantity}, part.labels,
            {name: value for name, value in part.entries.items() if name == quantity}, part.nodes,
        )  # fmt: skip
    if suffix == ".sub":
        raise BadFileError("no package reads .sub; write its matrices with *EXPORT,…,MMF of APDL (Matrix Market)")
    return ModelPart({quantity: read_matrix(path)}) if quantity else _named_arrays(path)


def read_model(paths: Mapping[str, Path]) -> NamedModel:
    """One structure from its files.

    Args:
        paths: by key of the rig file: file, mass_file, stiffness_file, damping_file, rows_file, nodes_file. A file that
            holds one matrix as Abaqus and CalculiX write it stands for those next to it, too.

    Raises:
        BadFileError: what is wrong with the files together; with one of them, it names the file.
        OSError: a file cannot be read.
    """
    parts = []
    for key, path in paths.items():
        try:
            if key == "rows_file":
                parts.append(ModelPart(labels=read_row_names(path)))
            elif key == "nodes_file":
                parts.append(read_nodes(path))
            elif key == "file":
                parts.extend(_with_sisters(path, read_part(path)))
            else:
                parts.append(read_part(path, key.removesuffix("_file")))
        except BadFileError as error:
            raise BadFileError(f"{path.name}: {error}") from error
    return united(parts)


def _with_sisters(path: Path, part: ModelPart) -> list[ModelPart]:
    """A part, and those of the other matrices that the program wrote next to its file."""
    quantity = quantity_of(path)
    if (
        quantity is None
        or [*part.matrices, *part.entries] != [quantity]
        or path.suffix.lower() not in (*_LISTS, *_TEXTS)
    ):
        return [part]
    sisters = {name: sister(path, quantity, name) for name in QUANTITIES if name != quantity}
    return [part, *(read_part(found, name) for name, found in sisters.items() if found is not None)]


def read_matrices(path: Path) -> dict[str, Any]:
    """Matrices of one file by quantity: mass (M or mass), stiffness (K), damping (C), base_vector (r), base_load (p).

    An NPZ holds a sparse matrix as K_data, K_indices, K_indptr and K_shape (compressed rows).

    Raises:
        BadFileError: another kind of file, or none of the names in it.
        OSError: the file cannot be read.
    """
    return dict(_named_arrays(path).matrices)


def _named_arrays(path: Path) -> ModelPart:
    """Matrices of an NPZ or MATLAB file; `rows` (n, 2) names their rows by node and direction, `nodes` (m, 4) are
    number and coordinates, `coordinate` names rows as SDynPy does.

    Raises:
        BadFileError: another kind of file, or none of the names in it.
        OSError: the file cannot be read.
    """
    if path.suffix.lower() == ".npz":
        content = _weighed(read_arrays, path)
    elif path.suffix.lower() == ".mat":
        content = _weighed(read_mat, path)
    else:
        raise BadFileError(
            "structure.file must be .npz or .mat, .pch, .bdf, .op4, .op2, .mtx, .sti, .full; single matrices go into "
            "mass_file and stiffness_file, or --check K.mtx --check M.mtx"
        )
    found: dict[str, Any] = {}
    for quantity, names in _NAMES.items():
        for name in names:
            value = _taken(content, name)
            if value is not None:
                vector = quantity.startswith("base_")
                found[quantity] = _vector(value) if vector else value
                break
    if "mass" not in found:
        found |= _of_comsol(content)
    if not found and set(_SPARSE) <= set(content):
        raise BadFileError(
            "it is a single matrix; name it and the others as mass_file and stiffness_file, or --check K.npz --check "
            "M.npz"
        )
    if not found:
        raise BadFileError(f"it has none of M, K, C; it has {', '.join(sorted(content)) or 'nothing'}")
    return ModelPart(found, _row_labels(content), nodes=_node_table(content))


def _of_comsol(content: Mapping[str, Any]) -> dict[str, Any]:
    """Matrices by the letters of COMSOL, where stiffness and mass of one size stand under them; else empty."""
    for letters in _COMSOL:
        found = {name: value for name, key in letters.items() if (value := _taken(content, key)) is not None}
        if {"mass", "stiffness"} <= found.keys() and found["mass"].shape == found["stiffness"].shape:
            return found
    return {}


def _row_labels(content: Mapping[str, Any]) -> Any:
    """Labels of `rows`, or of the coordinates of SDynPy; None without them."""
    if "coordinate" in content:
        fields = np.asarray(content["coordinate"])
        if fields.dtype.names is None or not {"node", "direction"} <= set(fields.dtype.names):
            raise BadFileError("coordinate is not an array of nodes and directions of SDynPy")
        change = content.get("transformation")
        if change is not None and not (change.ndim == 2 and np.array_equal(change, np.eye(*change.shape))):
            raise BadFileError("its transformation is not the identity; save the system in its physical coordinates")
        pairs = np.stack([fields["node"].reshape(-1), fields["direction"].reshape(-1)], axis=1)
    elif "rows" in content:
        pairs = np.asarray(content["rows"])
    else:
        return None
    if pairs.ndim != 2 or pairs.shape[1] != 2 or pairs.dtype.kind not in "biuf":
        raise BadFileError("rows must have two columns: node and direction 1 to 6")
    numbers = pairs.astype(float)
    if np.any(numbers != np.round(numbers)) or np.any((numbers[:, 1] < 0) | (numbers[:, 1] > 99)):
        raise BadFileError("rows must be whole numbers: node and direction 1 to 6")
    if np.any(np.abs(numbers) > 1e12):
        raise BadFileError("rows name nodes beyond 10¹²")
    return label(pairs[:, 0], pairs[:, 1])


def _node_table(content: Mapping[str, Any]) -> Any:
    """(m, 4) number and coordinates of `nodes`; None without them."""
    if "nodes" not in content:
        return None
    table = _number_array(content["nodes"], "nodes")
    if sparse.issparse(table) or table.ndim != 2 or table.shape[1] != 4 or not np.all(np.isfinite(table)):
        raise BadFileError("nodes must have four columns of finite numbers: number, x, y, z")
    if np.any(np.abs(table[:, 0]) > 1e12):
        raise BadFileError("nodes has numbers beyond 10¹²")
    return table


def read_matrix(path: Path) -> Any:
    """One matrix: Matrix Market (.mtx), scipy's sparse .npz, or .npy.

    Raises:
        BadFileError: another kind of file, or no matrix in it.
        OSError: the file cannot be read.
    """
    suffix = path.suffix.lower()
    if suffix == ".npy":
        return _number_array(_weighed(read_array, path), path.name)
    if suffix == ".npz":
        content = _weighed(read_arrays, path)
        if not all(name in content for name in _SPARSE):
            raise BadFileError("it is not a matrix that scipy.sparse.save_npz wrote; name an .npz with M and K as file")
        form = content.get("format", np.array(b"csr"))
        if form.size != 1 or form.item() not in (b"csr", b"csc", "csr", "csc"):
            raise BadFileError("save it in compressed rows or columns (tocsr)")
        return _sparse([content[name] for name in _SPARSE], form.item() in (b"csc", "csc"))
    if suffix == ".mtx":
        return _matrix_market(path)
    raise BadFileError("a single matrix must be .mtx (Matrix Market), .npy or scipy's sparse .npz")


def _weighed(read: Callable[[Path, str], Any], path: Path) -> Any:
    """What a reader that weighs before it reads makes of a file."""
    try:
        return read(path, "matrix file")
    except BenchError as error:
        raise BadFileError(str(error).rstrip(".")) from error


def _taken(content: Mapping[str, Any], name: str) -> Any:
    """The array of one name, sparse where it is stored so; None where it is not there."""
    if all(f"{name}_{part}" in content for part in _SPARSE):
        return _sparse([content[f"{name}_{part}"] for part in _SPARSE])
    if name not in content:
        return None
    array = _number_array(content[name], name)
    if array.nbytes > _LARGEST_FULL:
        raise BadFileError(f"{name} is a full array of {' x '.join(map(str, array.shape))}; save it sparse")
    return array


def _sparse(parts: list[Any], columns: bool = False) -> Any:
    """A matrix from its compressed rows (or columns); scipy itself believes every index."""
    data, indices, starts, shape = parts
    if not (
        data.ndim == indices.ndim == starts.ndim == shape.ndim == 1
        and data.dtype.kind in "biuf"
        and all(part.dtype.kind in "iu" for part in (indices, starts, shape))
        and shape.size == 2
        and shape.min() >= 0
    ):
        raise BadFileError("its data, indices, indptr and shape are not those of a sparse matrix of real numbers")
    major, minor = (int(n) for n in (shape[::-1] if columns else shape))
    if not (
        starts.size == major + 1
        and data.size == indices.size
        and int(starts[0]) == 0
        and int(starts[-1]) == data.size
        and np.all(starts[1:] >= starts[:-1])
        and (not indices.size or (int(indices.min()) >= 0 and int(indices.max()) < minor))
    ):
        raise BadFileError("its indices point outside the matrix; save it again with scipy.sparse.save_npz")
    if minor > max(major, LARGEST_ARRAYS // 8):
        raise BadFileError(f"it claims {major} x {minor} entries; matrices here are square")
    kind = sparse.csc_matrix if columns else sparse.csr_matrix
    return kind((data.astype(float), indices, starts), (minor, major) if columns else (major, minor))


# What no number and no space has, and an exponent or a sign that nothing follows.
_NO_NUMBER = re.compile(rb"[^0-9eE+\-.\s]|[eE+\-](?=\s|$)")


def _matrix_market(path: Path) -> Any:
    """A matrix of a Matrix Market file whose heading claims no more than its bytes can hold."""
    try:
        with open_regular(path, "matrix file", LARGEST_ARRAYS) as file:
            heading = file.readline(1024).decode("ascii", "replace").lower().split()
            line = b"%"
            while line.startswith(b"%") or (line and not line.strip()):
                line = file.readline(4096)
            claimed = [int(word) for word in line.split()]
            left = path.stat().st_size - file.tell()
            start, body = file.tell(), file.read()
            file.seek(0)
            head = file.read(start)
    except BenchError as error:
        raise BadFileError(str(error).rstrip(".")) from error
    except ValueError as error:
        raise BadFileError("it is not a Matrix Market file: the line of its sizes is missing") from error
    form = heading[2] if len(heading) == 5 and heading[:2] == ["%%matrixmarket", "matrix"] else ""
    if len(claimed) != {"coordinate": 3, "array": 2}.get(form) or min(claimed) < 0:
        raise BadFileError("it is not a Matrix Market file of a matrix, coordinate or array")
    if heading[3] not in ("real", "integer", "double"):
        raise BadFileError(f"its entries are {heading[3]}; real numbers are needed")
    # Each entry has two characters, behind two indices six; a symmetric array holds one triangle.
    entries = claimed[0] * (claimed[0] + 1) // 2 if heading[4] != "general" else claimed[0] * claimed[-1]
    listed = 6 * claimed[-1] <= left + 1 and max(claimed[:2]) <= left
    if not (2 * entries <= left + 1 if form == "array" else listed) or (
        form == "array" and 8 * claimed[0] * claimed[1] > LARGEST_ARRAYS
    ):
        raise BadFileError(f"its heading claims {' x '.join(map(str, claimed))}, more than its {left} bytes hold")
    if strange := _NO_NUMBER.search(body):
        raise BadFileError(f"it has {strange.group().decode('latin-1')!r} where numbers are")
    try:
        # The reader of SciPy reads past the end of a last line that does not end.
        return io.mmread(BytesIO(head + body + b"\n"))
    except (ValueError, IndexError, OverflowError, TypeError, MemoryError) as error:
        raise BadFileError(f"it is not a Matrix Market file ({error})") from error


def _number_array(value: Any, name: str) -> Any:
    if sparse.issparse(value):
        return value
    array = np.asarray(value)
    if array.dtype.kind not in "biuf":
        raise BadFileError(f"{name} is not an array of real numbers")
    return np.asarray(array, dtype=float)


def _vector(value: Any) -> Any:
    if sparse.issparse(value) and value.shape[0] * value.shape[1] > LARGEST_ARRAYS // 8:
        raise BadFileError(f"a vector of the base cannot be {value.shape[0]} x {value.shape[1]}")
    array = value.toarray() if sparse.issparse(value) else value
    return np.asarray(array, dtype=float).reshape(-1)
