"""Matrices from files: NPZ or MATLAB with several of them, or one of each in Matrix Market, NPZ or NPY form."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy import io, sparse

from nmt_core.errors import BenchError
from nmt_core.files.hardened import LARGEST_ARRAYS, open_regular, read_array, read_arrays
from nmt_core.files.mat_file import read_mat
from nmt_rig.file_errors import BadFileError

_NAMES = {
    "mass": ("M", "mass"), "stiffness": ("K", "stiffness"), "damping": ("C", "damping"),
    "base_vector": ("r", "base_vector"), "base_load": ("p", "base_load"),
}  # fmt: skip
# What scipy.sparse.save_npz writes.
_SPARSE = ("data", "indices", "indptr", "shape")


def read_matrices(path: Path) -> dict[str, Any]:
    """Matrices of one file by quantity: mass (M or mass), stiffness (K), damping (C), base_vector (r), base_load (p).

    An NPZ holds a sparse matrix as K_data, K_indices, K_indptr and K_shape (compressed rows).

    Raises:
        BadFileError: another kind of file, or none of the names in it.
        OSError: the file cannot be read.
    """
    if path.suffix.lower() == ".npz":
        content = _weighed(read_arrays, path)
    elif path.suffix.lower() == ".mat":
        content = _weighed(read_mat, path)
    else:
        raise BadFileError("structure.file must be .npz or .mat; single matrices go into mass_file and stiffness_file")
    found: dict[str, Any] = {}
    for quantity, names in _NAMES.items():
        for name in names:
            value = _taken(content, name)
            if value is not None:
                vector = quantity.startswith("base_")
                found[quantity] = _vector(value) if vector else value
                break
    if not found:
        raise BadFileError(f"it has none of M, K, C; it has {', '.join(sorted(content)) or 'nothing'}")
    return found


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
    return None if name not in content else _number_array(content[name], name)


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
    try:
        return io.mmread(path)
    except (ValueError, IndexError, OverflowError, TypeError, MemoryError) as error:
        raise BadFileError(f"it is not a Matrix Market file ({error})") from error


def _number_array(value: Any, name: str) -> Any:
    if sparse.issparse(value):
        return value
    array = np.asarray(value)
    if array.dtype.kind not in "biuf":
        raise BadFileError(f"{name} is not an array of real numbers")
    return array.astype(float)


def _vector(value: Any) -> Any:
    if sparse.issparse(value) and value.shape[0] * value.shape[1] > LARGEST_ARRAYS // 8:
        raise BadFileError(f"a vector of the base cannot be {value.shape[0]} x {value.shape[1]}")
    array = value.toarray() if sparse.issparse(value) else value
    return np.asarray(array, dtype=float).reshape(-1)
