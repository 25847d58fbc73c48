"""Arrays of MATLAB files, read so that no file can make the reader take more memory than its arrays may have.

Version 5 to 7 (``save -v7``) is read here byte by byte, because a reader in C would trust lengths that the file
claims; the layout is that of MathWorks, "MAT-File Format" (R2024b), chapter 1. Version 7.3 is HDF5 and is read with
h5py: only what lies in the file itself, so neither external links nor external or virtual data sets. Members of structs
are named by their path, ``test.force``.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nmt_core.errors import BenchError
from nmt_core.files.hardened import LARGEST_ARRAYS, open_regular

HDF5 = b"\x89HDF\r\n\x1a\n"
MAT5 = b"MATLAB 5.0"

_DEEPEST = 12
_MOST_ENTRIES = 20_000
_MOST_DIMENSIONS = 8
_HEADER = 128
_COMPRESSED, _MATRIX = 15, 14
_TYPES = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip
_CELL, _STRUCT, _CHAR = 1, 2, 4
_NUMERIC = range(6, 16)
_IS_COMPLEX = 0x0800

Array = NDArray[Any]


def is_hdf5(head: bytes) -> bool:
    """Whether a file begins as HDF5, at its first byte or behind MATLAB's header of 512 bytes."""
    return head.startswith(HDF5) or head[512:520] == HDF5 or head.startswith(b"MATLAB 7.3")


def read_mat(path: Path, what: str, largest: int = LARGEST_ARRAYS) -> dict[str, Array]:
    """Numeric arrays of a MATLAB or HDF5 file by the path of their name; of HDF5 also single numbers in attributes.

    Texts and objects are left out, elements of cells and of arrays of structs are numbered.

    Args:
        path: the file.
        what: kind of file, for messages.
        largest: bytes of all arrays together, as double precision.

    Returns:
        Arrays of real or complex numbers as MATLAB shows them (rows first); those of HDF5 files that MATLAB did not
        write as they are.

    Raises:
        BenchError: as :func:`open_regular`; no such file, cut off or damaged, or its arrays are more than ``largest``.
    """
    with open_regular(path, what, largest) as file:
        head = file.read(520)
        file.seek(0)
        if is_hdf5(head):
            return _read_hdf5(path, what, largest)
        if not head.startswith(MAT5):
            raise BenchError(
                f"The {what} {path.name} is not a MATLAB file of version 5 or later; save it with 'save -v7'."
            )
        data = file.read(largest + 1)
    budget = _Budget(path, what, largest)
    try:
        return dict(_Mat5(data, budget).variables())
    except (struct.error, ValueError, IndexError, OverflowError, zlib.error, UnicodeDecodeError) as error:
        raise BenchError(f"The {what} {path.name} is cut off or damaged ({error}); save it again.") from error


class _Budget:
    """Bytes and entries that a file may still claim."""

    def __init__(self, path: Path, what: str, largest: int) -> None:
        self.path, self.what, self.left, self.entries, self.largest = path, what, largest, _MOST_ENTRIES, largest

    def take(self, values: int, size: int = 8) -> None:
        """Count an array before memory is taken for it.

        Raises:
            BenchError: the arrays are too large together.
        """
        self.left -= values * size
        if self.left < 0:
            raise BenchError(
                f"The arrays of the {self.what} {self.path} need more than the {self.largest / 2**20:g} MiB that are "
                "read; split the file."
            )

    def enter(self, depth: int) -> None:
        """Count an entry.

        Raises:
            BenchError: too deep or too many.
        """
        self.entries -= 1
        if self.entries < 0 or depth > _DEEPEST:
            raise BenchError(f"The {self.what} {self.path} is nested too deeply or has too many entries.")


class _Mat5:
    """Reader of the format of versions 5 to 7."""

    def __init__(self, data: bytes, budget: _Budget) -> None:
        if len(data) < _HEADER or data[126:128] not in (b"IM", b"MI"):
            raise ValueError("its header is not whole")
        self.order = "<" if data[126:128] == b"IM" else ">"
        self.data, self.budget = data, budget

    def variables(self) -> Iterator[tuple[str, Array]]:
        """Name and array of every variable and member."""
        place = _HEADER
        while place + 8 <= len(self.data):
            kind, content, place = self._element(memoryview(self.data), place, padded=False)
            if kind == _COMPRESSED:
                kind, content, _ = self._element(memoryview(self._inflated(content)), 0)
            if kind == _MATRIX:
                yield from self._matrix(content, "", 0)

    def _inflated(self, content: memoryview) -> bytes:
        """What a compressed element holds, no more than the budget."""
        stream = zlib.decompressobj()
        result = stream.decompress(content, self.budget.left + 1)
        self.budget.take(len(result), 1)
        if not stream.eof:
            raise ValueError("a compressed variable has no end")
        # Its arrays are counted by themselves.
        self.budget.take(-len(result), 1)
        return result

    def _element(self, data: memoryview, place: int, padded: bool = True) -> tuple[int, memoryview, int]:
        """Type, content and the place behind an element."""
        (first,) = struct.unpack_from(self.order + "I", data, place)
        if first >> 16:
            size, kind, start, behind = first >> 16, first & 0xFFFF, place + 4, place + 8
            if size > 4:
                raise ValueError("an element claims more than it has")
        else:
            kind, (size,) = first, struct.unpack_from(self.order + "I", data, place + 4)
            start = place + 8
            behind = start + (-(-size // 8) * 8 if padded else size)
        if start + size > len(data):
            raise ValueError("an element claims more than the file has")
        return kind, data[start : start + size], behind

    def _numbers(self, kind: int, content: memoryview) -> Array:
        if kind not in _TYPES:
            raise ValueError(f"type {kind} of numbers is not known")
        return np.frombuffer(content, dtype=self.order + _TYPES[kind])

    def _matrix(self, data: memoryview, path: str, depth: int) -> Iterator[tuple[str, Array]]:
        self.budget.enter(depth)
        if not len(data):
            return
        _, content, place = self._element(data, 0)
        flags, _ = struct.unpack_from(self.order + "II", content, 0)
        kind = flags & 0xFF
        if kind == 17:  # an object of a class; nothing in it is an array of the user's
            return
        number, content, place = self._element(data, place)
        shape = tuple(int(n) for n in self._numbers(number, content))
        if not 2 <= len(shape) <= _MOST_DIMENSIONS or any(n < 0 for n in shape):
            raise ValueError("an array has no shape")
        _, content, place = self._element(data, place)
        own = bytes(content).decode("ascii")
        path = f"{path}.{own}" if path and own else path or own
        count = math.prod(shape)
        if kind in _NUMERIC:
            yield path, self._array(data, place, shape, count, bool(flags & _IS_COMPLEX))
        elif kind == _STRUCT:
            yield from self._struct(data, place, path, count, depth)
        elif kind == _CELL:
            for element in range(count):
                _, content, place = self._element(data, place)
                yield from self._matrix(content, f"{path}.{_numbered(element, shape)}", depth + 1)

    def _array(self, data: memoryview, place: int, shape: tuple[int, ...], count: int, is_complex: bool) -> Array:
        self.budget.take(count * (2 if is_complex else 1))
        parts = []
        for _ in range(2 if is_complex else 1):
            number, content, place = self._element(data, place)
            values = self._numbers(number, content)
            if values.size != count:
                raise ValueError(f"an array of {count} numbers has {values.size}")
            parts.append(values.reshape(shape, order="F"))
        return parts[0] + 1j * parts[1] if is_complex else parts[0]

    def _struct(self, data: memoryview, place: int, path: str, count: int, depth: int) -> Iterator[tuple[str, Array]]:
        number, content, place = self._element(data, place)
        (length,) = self._numbers(number, content)
        _, content, place = self._element(data, place)
        names = bytes(content)
        if length < 1 or len(names) % int(length):
            raise ValueError("the names of a struct are not whole")
        fields = [names[i : i + int(length)].split(b"\0")[0].decode("ascii") for i in range(0, len(names), int(length))]
        for element in range(count):
            number_of = f"{path}.{element + 1}" if count > 1 else path
            for field in fields:
                _, content, place = self._element(data, place)
                yield from self._matrix(content, f"{number_of}.{field}", depth + 1)


def _numbered(element: int, shape: tuple[int, ...]) -> str:
    """Number of an element of a cell array from 1, column by column; of a matrix of cells its row and column."""
    if max(shape) == math.prod(shape):
        return str(element + 1)
    return ".".join(str(int(n) + 1) for n in np.unravel_index(element, shape, order="F"))


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
        for name in group if depth < _DEEPEST else ():
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


def _read_hdf5(path: Path, what: str, largest: int) -> dict[str, Array]:
    import h5py

    budget = _Budget(path, what, largest)
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
            if isinstance(entry, h5py.Group):
                visit(entry, f"{prefix}{name}.", depth + 1)
            elif isinstance(entry, h5py.Dataset) and h5py.check_ref_dtype(entry.dtype) is h5py.Reference:
                budget.take(int(entry.size))
                shape = entry.shape[::-1] if len(entry.shape) > 1 else (*entry.shape, 1)
                own = name if entry.attrs.get("MATLAB_class") in (b"cell", "cell") else ""
                for number, reference in enumerate(entry[()].ravel()):
                    budget.enter(depth)
                    parts = (prefix.rstrip("."), own, _numbered(number, shape), "" if own else name)
                    member = file[reference] if reference else None
                    values = array(member) if isinstance(member, h5py.Dataset) else None
                    if values is not None:
                        found[".".join(filter(None, parts))] = values
            elif isinstance(entry, h5py.Dataset):
                values = array(entry)
                if values is not None:
                    found[prefix + name] = values
                    attributes(entry, f"{prefix}{name}.")

    def array(entry: Any) -> Array | None:
        kind, names = entry.dtype.kind, entry.dtype.names
        is_complex = names is not None and len(names) == 2 and all(entry.dtype[n].kind == "f" for n in names)
        text = entry.attrs.get("MATLAB_class") in (b"char", "char", b"cell", "cell")
        if (kind not in "iufc" and not is_complex) or text or entry.attrs.get("MATLAB_empty") or entry.shape is None:
            return None
        if entry.external or entry.is_virtual:
            raise BenchError(f"The {what} {path.name} keeps '{entry.name}' in another file; save it as one.")
        budget.take(int(entry.size) * (2 if is_complex or kind == "c" else 1))
        values: Array = entry[()]
        if is_complex:
            values = values[names[0]] + 1j * values[names[1]]
        # MATLAB's columns are HDF5's rows.
        return values.T if "MATLAB_class" in entry.attrs else values

    try:
        with h5py.File(path, "r") as file:
            visit(file, "", 0)
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError) as error:
        first = (str(error).splitlines() or [type(error).__name__])[0].rstrip(".")
        raise BenchError(f"The {what} {path.name} is cut off or damaged ({first}); save it again.") from error
    return found
