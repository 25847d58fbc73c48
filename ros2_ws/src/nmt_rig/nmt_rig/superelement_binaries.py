"""Matrices in the binary files of Nastran and Ansys, by the packages that know them."""

from __future__ import annotations

import contextlib
import importlib
import struct
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from nmt_core.errors import BenchError
from nmt_core.files.hardened import LARGEST_ARRAYS, open_regular
from nmt_rig.file_errors import BadFileError
from nmt_rig.named_rows import ModelPart, label, mirrored
from nmt_rig.superelement_texts import matrix_names, names_of_neighbour

# What the packages raise on files that are cut off or of another kind.
_DAMAGED = (
    ValueError, IndexError, KeyError, TypeError, OverflowError, MemoryError, RuntimeError, AttributeError, OSError,
    UnicodeDecodeError, EOFError, struct.error, RuntimeWarning,
)  # fmt: skip


def _package(module: str, name: str, what: str) -> Any:
    """A module of an optional package.

    Raises:
        BadFileError: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise BadFileError(f"{what} need the package {name}; install it with 'pip install {name}'") from error


@contextlib.contextmanager
def _reading(form: str) -> Iterator[None]:
    """What a package raises or warns of while it reads, as one sentence."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.simplefilter("error", RuntimeWarning)
            yield
    except BadFileError:
        raise
    except _DAMAGED as error:
        raise BadFileError(f"it is not a whole {form} file ({error})") from error


def _weighed(path: Path) -> int:
    """Bytes of a regular file that is not too large."""
    try:
        with open_regular(path, "matrix file", LARGEST_ARRAYS):
            return path.stat().st_size
    except BenchError as error:
        raise BadFileError(str(error).rstrip(".")) from error


def _claims(sizes: Mapping[str, tuple[int, int]], size: int, dense: bool) -> None:
    """Refuse matrices that are not square or claim more than is read."""
    for name, (rows, columns) in sizes.items():
        if rows != columns or rows < 1:
            raise BadFileError(f"{name} is {rows} x {columns}; matrices here are square")
        if rows > max(size, 1) or (dense and 8 * rows * columns > LARGEST_ARRAYS):
            raise BadFileError(f"{name} claims {rows} x {columns} entries, more than its file of {size} bytes holds")


def _checked(matrix: Any, name: str) -> Any:
    """A matrix whose indices lie inside it, with both triangles."""
    plain = sparse.coo_matrix(matrix)
    if plain.dtype.kind not in "biuf":
        raise BadFileError(f"{name} is complex; real matrices are needed")
    if plain.nnz and not (
        int(plain.row.min()) >= 0
        and int(plain.col.min()) >= 0
        and int(plain.row.max()) < plain.shape[0]
        and int(plain.col.max()) < plain.shape[1]
    ):
        raise BadFileError(f"{name} has entries outside the matrix")
    return mirrored(plain.astype(float).tocsr())


def read_op4(path: Path) -> ModelPart:
    """Matrices of an OUTPUT4 file of Nastran, text or binary; rows by the EXTRN card punched next to it, if any.

    Raises:
        BadFileError: pyyeti is missing, or no real square matrices named K…, M…, B….
        OSError: the file cannot be read.
    """
    size = _weighed(path)
    op4 = _package("pyyeti.nastran.op4", "pyyeti", "OP4 files")
    with _reading("OP4"):
        names, shapes, _, _ = op4.OP4().dir(str(path), verbose=False)
        square = [(name, shape) for name, shape in zip(names, shapes, strict=True) if shape[0] == shape[1] > 0]
        chosen, claimed = matrix_names([name for name, _ in square]), dict(square)
        _claims({name: (int(claimed[name][0]), int(claimed[name][1])) for name in chosen.values()}, size, dense=False)
        read = op4.load(str(path), list(chosen.values()), into="dct", justmatrix=True, sparse=True)
    names_of_rows = names_of_neighbour(path)
    matrices = {quantity: _checked(read[name], name) for quantity, name in chosen.items()}
    return ModelPart(matrices, names_of_rows.labels, nodes=names_of_rows.nodes)


def read_op2(path: Path) -> ModelPart:
    """Matrices of an OUTPUT2 file of Nastran; rows by the EXTRN card punched next to it, if any.

    Raises:
        BadFileError: pyyeti is missing, or no real square matrices named K…, M…, B….
        OSError: the file cannot be read.
    """
    size = _weighed(path)
    op2 = _package("pyyeti.nastran.op2", "pyyeti", "OP2 files")
    with _reading("OP2"), op2.OP2(str(path)) as file:
        blocks = {
            name: found[-1]
            for name, found in file.directory(verbose=False).items()
            if found[-1].dbtype == 1 and found[-1].size[0] == found[-1].size[1]
        }
        chosen = matrix_names(list(blocks))
        _claims({name: blocks[name].size for name in chosen.values()}, size, dense=True)
        read = file.rdop2mats(list(chosen.values()))
    names_of_rows = names_of_neighbour(path)
    matrices = {quantity: _checked(read[name], name) for quantity, name in chosen.items()}
    return ModelPart(matrices, names_of_rows.labels, nodes=names_of_rows.nodes)


def read_full(path: Path) -> ModelPart:
    """Stiffness and mass of a .full file of Ansys, rows by node and direction.

    Raises:
        BadFileError: ansys-mapdl-reader is missing, or the file is not whole or has no mass.
        OSError: the file cannot be read.
    """
    size = _weighed(path)
    reader = _package("ansys.mapdl.reader", "ansys-mapdl-reader", ".full files of Ansys")
    with _reading(".full"):
        full = reader.read_binary(str(path))
        _claims({"the stiffness": (int(full.neqn), int(full.neqn))}, size, dense=False)
        names, stiffness, mass = full.load_km(sort=False)
    directions = np.asarray(names)[:, 1]
    if directions.size != stiffness.shape[0] or not np.all((directions >= 0) & (directions < 99)):
        raise BadFileError("its degrees of freedom are not those of its matrices")
    return ModelPart(
        {"stiffness": _checked(stiffness, "the stiffness"), "mass": _checked(mass, "the mass")},
        label(np.asarray(names)[:, 0], directions + 1),
    )
