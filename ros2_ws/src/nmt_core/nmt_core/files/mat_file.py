"""Arrays of MATLAB files, read so that no file can make the reader take more memory than its arrays may have.

Version 5 to 7 (``save -v7``) is read by scipy in a process with limits, :mod:`nmt_core.files.mat_child`. Version 7.3 is
HDF5 and is read with h5py: only what lies in the file itself, so neither external links nor external or virtual data
sets. Members of structs are named by their path, ``test.force``.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from nmt_core.errors import BenchError
from nmt_core.files.hardened import LARGEST_ARRAYS, open_regular, read_arrays
from nmt_core.files.limited_child import ChildError, run_limited
from nmt_core.files.mat_child import DEEPEST, LONGEST_TEXT, EntryBudget, numbered

HDF5 = b"\x89HDF\r\n\x1a\n"
MAT5 = b"MATLAB 5.0"

_LONGEST = 120
"""Seconds that a file may take."""

Array = NDArray[Any]


def is_hdf5(head: bytes) -> bool:
    """Whether a file begins as HDF5, at its first byte or behind MATLAB's header of 512 bytes."""
    return head.startswith(HDF5) or head[512:520] == HDF5 or head.startswith(b"MATLAB 7.3")


def read_mat(
    path: Path, what: str, largest: int = LARGEST_ARRAYS, texts: dict[str, str] | None = None
) -> dict[str, Array]:
    """Numeric arrays of a MATLAB or HDF5 file by the path of their name; of HDF5 also single numbers in attributes.

    Objects are left out, elements of cells and of arrays of structs are numbered. A sparse matrix K of a
    MATLAB file is K_data, K_indices, K_indptr and K_shape (compressed rows).

    Args:
        path: the file.
        what: kind of file, for messages.
        largest: bytes of all arrays together, as double precision.
        texts: where short texts of a MATLAB file go, by the path of their name.

    Returns:
        Arrays of real or complex numbers as MATLAB shows them (rows first); those of HDF5 files that MATLAB did not
        write as they are.

    Raises:
        BenchError: as :func:`open_regular`; no such file, cut off or damaged, or its arrays are more than ``largest``.
    """
    with open_regular(path, what, largest) as file:
        head = file.read(520)
        if is_hdf5(head):
            return _read_hdf5(path, what, largest, texts)
        if not head.startswith(MAT5):
            raise BenchError(
                f"The {what} {path.name} is not a MATLAB file of version 5 or later; save it with 'save -v7'."
            )
        found = _read_mat5(path, file, what, largest)
    words = {name: str(value[0]) for name, value in found.items() if value.dtype.kind == "U"}
    if texts is not None:
        texts.update(words)
    return {name: value for name, value in found.items() if name not in words}


def _read_mat5(path: Path, file: IO[bytes], what: str, largest: int) -> dict[str, Array]:
    words = (str(largest), str(_LONGEST))
    with tempfile.NamedTemporaryFile(suffix=".npz") as target:
        try:
            run_limited("nmt_core.files.mat_child", words, _LONGEST, file, target)
        except ChildError as failure:
            raise _refused(path, what, largest, failure) from None
        names, *arrays = read_arrays(Path(target.name), what, 4 * largest).values()
    return dict(zip(names.tolist(), arrays, strict=True))


def _refused(path: Path, what: str, largest: int, failure: ChildError) -> BenchError:
    """What to say of a file whose reader failed."""
    if failure.is_memory:
        return BenchError(
            f"The arrays of the {what} {path} need more than the {largest / 2**20:g} MiB that are read; split the file."
        )
    if failure.kind == "RecursionError":
        return BenchError(f"The {what} {path} is nested too deeply or has too many entries.")
    return BenchError(f"The {what} {path.name} is cut off or damaged ({failure.why.rstrip('.')}); save it again.")


_STATED = ("units", "unit", "scale_factor", "add_offset", "_FillValue", "missing_value", "point")


def read_attributes(path: Path) -> dict[str, dict[str, str | float]]:
    """What the data sets of an HDF5 file say of themselves after the CF conventions, by the path of their name: unit,
    scale_factor, add_offset, fill values and point; empty for other files.

    Raises:
        BenchError: the file cannot be read.
    """
    import h5py

    found: dict[str, dict[str, str | float]] = {}

    def visit(group: Any, prefix: str, depth: int) -> None:
        for name in group if depth < DEEPEST else ():
            if name == "#refs#" or not isinstance(group.get(name, getlink=True), h5py.HardLink):
                continue
            entry = group[name]
            if isinstance(entry, h5py.Group):
                visit(entry, f"{prefix}{name}.", depth + 1)
            elif stated := {key: value for key in _STATED if (value := _plain(entry.attrs.get(key))) is not None}:
                found[prefix + name] = stated

    with path.open("rb") as start:
        if not is_hdf5(start.read(520)):
            return {}
    try:
        with h5py.File(path, "r") as file:
            visit(file, "", 0)
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError) as error:
        first = (str(error).splitlines() or [type(error).__name__])[0].rstrip(".")
        raise BenchError(f"The attributes of {path.name} cannot be read ({first}); save it again.") from error
    return found


def _plain(value: Any) -> str | float | None:
    """A text or a number of an attribute; None where it is neither."""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    if isinstance(value, str):
        return value
    number = np.asarray(value) if value is not None else np.empty(0)
    return float(number.reshape(-1)[0]) if number.size == 1 and number.dtype.kind in "iuf" else None


def _read_hdf5(path: Path, what: str, largest: int, texts: dict[str, str] | None) -> dict[str, Array]:
    import h5py

    budget = EntryBudget(largest)
    found: dict[str, Array] = {}

    def attributes(entry: Any, prefix: str) -> None:
        for name, value in entry.attrs.items():
            budget.enter(0)
            number = np.asarray(value)
            if number.size == 1 and number.dtype.kind in "iuf" and not name.startswith(("_", "MATLAB", "H5PATH")):
                found.setdefault(f"{prefix}{name}", number.reshape(1, 1))

    def visit(group: Any, prefix: str, depth: int) -> None:
        attributes(group, prefix)
        for name in group:
            budget.enter(depth)
            # What lies elsewhere is not this file's.
            if name == "#refs#" or not isinstance(group.get(name, getlink=True), h5py.HardLink):
                continue
            entry = group[name]
            if isinstance(entry, h5py.Group) and "MATLAB_sparse" in entry.attrs:
                found.update({f"{prefix}{name}_{part}": value for part, value in compressed_rows(entry).items()})
            elif isinstance(entry, h5py.Group):
                visit(entry, f"{prefix}{name}.", depth + 1)
            elif isinstance(entry, h5py.Dataset) and h5py.check_ref_dtype(entry.dtype) is h5py.Reference:
                budget.take(weight(entry))
                budget.enter(depth, int(entry.size))
                shape = entry.shape[::-1] if len(entry.shape) > 1 else (*entry.shape, 1)
                own = name if entry.attrs.get("MATLAB_class") in (b"cell", "cell") else ""
                for number, reference in enumerate(entry[()].ravel()):
                    parts = (prefix.rstrip("."), own, numbered(number, shape), "" if own else name)
                    member = file[reference] if reference else None
                    values = array(member) if isinstance(member, h5py.Dataset) else None
                    if values is not None:
                        found[".".join(filter(None, parts))] = values
            elif isinstance(entry, h5py.Dataset):
                if texts is not None and (letters := text_of(entry)):
                    texts[prefix + name] = letters
                values = array(entry)
                if values is not None:
                    found[prefix + name] = values
                    attributes(entry, f"{prefix}{name}.")

    def text_of(entry: Any) -> str:
        if entry.attrs.get("MATLAB_class") not in (b"char", "char") or entry.dtype.kind != "u" or entry.attrs.get(
            "MATLAB_empty"
        ) or weight(entry) > LONGEST_TEXT:  # fmt: skip
            return ""
        return "".join(map(chr, entry[()].reshape(-1).tolist()))

    def weight(entry: Any) -> int:
        # A chunk is unpacked as one, however little of it the array has.
        return max(int(entry.size), math.prod(entry.chunks or ())) * -(-int(entry.dtype.itemsize) // 8)

    def compressed_rows(entry: Any) -> dict[str, Array]:
        """MATLAB keeps columns: numbers, their rows, starts of the columns; the attribute is the number of rows."""
        from scipy import sparse

        inside = [key for key in entry if isinstance(entry.get(key, getlink=True), h5py.HardLink)]
        members = {key: entry[key] for key in inside if isinstance(entry[key], h5py.Dataset)}
        starts = array(members["jc"])
        data, rows = (array(members[key]) if key in members else np.zeros(0) for key in ("data", "ir"))
        size = (int(entry.attrs["MATLAB_sparse"]), 0 if starts is None else starts.size - 1)
        if starts is None or data is None or rows is None or not 0 <= size[0] <= 2**31:
            raise ValueError(f"the sparse matrix {entry.name} is not whole")
        starts, rows = starts.astype(np.int64).reshape(-1), rows.astype(np.int64).reshape(-1)
        good = starts.size and starts[0] == 0 and starts[-1] == rows.size == data.size and np.all(np.diff(starts) >= 0)
        if not good or (rows.size and not 0 <= rows.min() <= rows.max() < size[0]):
            raise ValueError(f"the sparse matrix {entry.name} points outside itself")
        budget.take(3 * data.size + size[0])
        matrix = sparse.csc_matrix((data.reshape(-1), rows, starts), shape=size).tocsr()
        return {part: np.asarray(getattr(matrix, part)) for part in ("data", "indices", "indptr", "shape")}

    def array(entry: Any) -> Array | None:
        kind, names = entry.dtype.kind, entry.dtype.names
        is_complex = names is not None and len(names) == 2 and all(entry.dtype[n].kind == "f" for n in names)
        text = entry.attrs.get("MATLAB_class") in (b"char", "char", b"cell", "cell")
        if (kind not in "iufc" and not is_complex) or text or entry.attrs.get("MATLAB_empty") or entry.shape is None:
            return None
        if entry.external or entry.is_virtual:
            raise BenchError(f"The {what} {path.name} keeps '{entry.name}' in another file; save it as one.")
        budget.take(weight(entry) * (2 if is_complex or kind == "c" else 1))
        values: Array = entry[()]
        if is_complex:
            parts, values = values, np.empty(values.shape, complex)
            values.real, values.imag = parts[names[0]], parts[names[1]]
        # MATLAB's columns are HDF5's rows.
        return values.T if "MATLAB_class" in entry.attrs else values

    try:
        with h5py.File(path, "r") as file:
            visit(file, "", 0)
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError) as error:
        first = (str(error).splitlines() or [type(error).__name__])[0]
        raise _refused(path, what, largest, ChildError(type(error).__name__, first)) from error
    return found
