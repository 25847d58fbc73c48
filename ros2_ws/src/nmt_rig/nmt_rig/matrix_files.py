"""Matrices from files: NPZ or MATLAB with several of them, or one of each in Matrix Market, NPZ or NPY form."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy import io, sparse

from nmt_core.errors import BenchError
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
        content = _npz(path)
    elif path.suffix.lower() == ".mat":
        content = _mat(path)
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
        try:
            return _number_array(np.load(path, allow_pickle=False), path.name)
        except ValueError as error:
            raise BadFileError(f"it is not a NumPy array of numbers ({error})") from error
    if suffix == ".npz":
        content = _npz(path)
        if not all(name in content for name in _SPARSE):
            raise BadFileError("it is not a matrix that scipy.sparse.save_npz wrote; name an .npz with M and K as file")
        if bytes(content.get("format", np.array(b"csr")).item()) not in (b"csr", b"csc"):
            raise BadFileError("save it in compressed rows or columns (tocsr)")
        kind = sparse.csc_matrix if bytes(content["format"].item()) == b"csc" else sparse.csr_matrix
        return kind((content["data"], content["indices"], content["indptr"]), tuple(map(int, content["shape"])))
    if suffix == ".mtx":
        try:
            return io.mmread(path)
        except (ValueError, IndexError) as error:
            raise BadFileError(f"it is not a Matrix Market file ({error})") from error
    raise BadFileError("a single matrix must be .mtx (Matrix Market), .npy or scipy's sparse .npz")


def _npz(path: Path) -> dict[str, Any]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (ValueError, EOFError, zipfile.BadZipFile) as error:
        raise BadFileError("it is not an NPZ archive of plain arrays; write it with numpy.savez") from error


def _mat(path: Path) -> dict[str, Any]:
    """Full and sparse matrices of a MATLAB file; of version 7.3 the full ones."""
    try:
        return read_mat(path, "matrix file")
    except BenchError as error:
        raise BadFileError(str(error).rstrip(".")) from error


def _taken(content: dict[str, Any], name: str) -> Any:
    """The array of one name, sparse where it is stored so; None where it is not there."""
    if all(f"{name}_{part}" in content for part in _SPARSE):
        parts = [content[f"{name}_{part}"] for part in _SPARSE]
        return sparse.csr_matrix((parts[0], parts[1], parts[2]), tuple(map(int, parts[3])))
    return None if name not in content else _number_array(content[name], name)


def _number_array(value: Any, name: str) -> Any:
    if sparse.issparse(value):
        return value
    array = np.asarray(value)
    if array.dtype.kind not in "biuf":
        raise BadFileError(f"{name} is not an array of real numbers")
    return array.astype(float)


def _vector(value: Any) -> Any:
    array = value.toarray() if sparse.issparse(value) else value
    return np.asarray(array, dtype=float).reshape(-1)
