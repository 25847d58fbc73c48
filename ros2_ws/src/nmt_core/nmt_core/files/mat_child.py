"""Run by :mod:`nmt_core.files.mat_file` in a process of its own: the numbers of a MATLAB file, version 5 to 7, as NPZ.

``python -m nmt_core.files.mat_child LARGEST SECONDS < data.mat > numbers.npz``. scipy takes memory for whatever a file
claims, so memory and time of this process have limits (:mod:`nmt_core.files.limited_child`). The first array of the
result names the others.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

import numpy as np

from nmt_core.files.limited_child import limit

DEEPEST = 12
LONGEST_TEXT = 200
"""Characters of a text that may be a unit or a name."""
_MOST_ENTRIES = 20_000


class EntryBudget:
    """Bytes and entries that a file may still claim."""

    def __init__(self, largest: int) -> None:
        self._left, self._entries = largest, _MOST_ENTRIES

    def take(self, values: int) -> None:
        """Count numbers, as double precision; MemoryError = the arrays are too large together."""
        self._left -= 8 * values
        if self._left < 0:
            raise MemoryError

    def enter(self, depth: int, entries: int = 1) -> None:
        """Count entries; RecursionError = too deep or too many."""
        self._entries -= entries
        if self._entries < 0 or depth > DEEPEST:
            raise RecursionError


def numbered(element: int, shape: tuple[int, ...]) -> str:
    """Number of an element of a cell array from 1, column by column; of a matrix of cells its row and column."""
    if max(shape) == np.prod(shape):
        return str(element + 1)
    return ".".join(str(int(n) + 1) for n in np.unravel_index(element, shape, order="F"))


def numbers_of(file: Any, largest: int) -> dict[str, np.ndarray[Any, Any]]:
    """Arrays of an open file by the path of their name; sparse ones as data, indices, indptr and shape of their rows.

    Raises:
        Exception: whatever scipy raises, and as :class:`EntryBudget`.
    """
    from scipy.io import loadmat, whosmat
    from scipy.io.matlab import matfile_version

    if matfile_version(file)[0] != 1:
        raise ValueError("its header is not that of version 5")
    stated = EntryBudget(largest)
    for _, shape, kind in whosmat(file):
        stated.take(int(np.prod(shape, dtype=object)) if kind.startswith(("int", "uint", "single", "double")) else 0)
    budget = EntryBudget(largest)
    content = {name: value for name, value in loadmat(file).items() if not name.startswith("__")}
    return {path: array for name in content for path, array in _members(content[name], name, 0, budget)}


def _members(value: Any, path: str, depth: int, budget: EntryBudget) -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
    """Path and array of every number and every short text in a variable or member; objects are left out."""
    from scipy import sparse
    from scipy.io.matlab import MatlabFunction, MatlabObject, MatlabOpaque

    budget.enter(depth)
    if sparse.issparse(value):
        rows = sparse.csr_matrix(value)
        budget.take(3 * rows.nnz + rows.shape[0])
        for part in ("data", "indices", "indptr", "shape"):
            yield f"{path}_{part}", np.asarray(getattr(rows, part))
    elif not isinstance(value, np.ndarray) or isinstance(value, MatlabFunction | MatlabObject | MatlabOpaque):
        return
    elif value.dtype.names:
        for number, element in enumerate(value.ravel(order="F")):
            for name in value.dtype.names:
                own = f"{path}.{number + 1}" if value.size > 1 else path
                yield from _members(element[name], f"{own}.{name}", depth + 1, budget)
    elif value.dtype.kind == "O":
        for number, element in enumerate(value.ravel(order="F")):
            yield from _members(element, f"{path}.{numbered(number, value.shape)}", depth + 1, budget)
    elif value.dtype.kind in "biufc":
        budget.take(value.size * (2 if value.dtype.kind == "c" else 1))
        yield path, value
    elif value.dtype.kind == "U" and value.size == 1 and value.dtype.itemsize <= 4 * LONGEST_TEXT:
        yield path, value.reshape(-1)


if __name__ == "__main__":
    limit(int(sys.argv[1]), int(sys.argv[2]))
    with open(0, "rb") as source, open(1, "wb") as target:
        source.seek(0)
        found = numbers_of(source, int(sys.argv[1]))
        np.savez(target, np.array(list(found), dtype=np.str_), *found.values())
