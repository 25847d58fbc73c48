"""Symmetric matrices as one text of a rig file, which takes few entries."""

from __future__ import annotations

import base64
import binascii
from functools import lru_cache

import numpy as np

from nmt_rig.model.structure import Array


def packed(matrix: Array) -> str:
    """Lower triangle of a symmetric matrix as one text: doubles by rows, in base64."""
    return base64.b64encode(matrix[np.tril_indices(matrix.shape[0])].astype("<f8").tobytes()).decode("ascii")


@lru_cache(maxsize=64)
def unpacked(text: str) -> Array:
    """The matrix (n, n) of a text that :func:`packed` made; not to be changed.

    Raises:
        ValueError: another text, or numbers that are not finite.
    """
    try:
        numbers = np.frombuffer(base64.b64decode(text.encode("ascii"), validate=True), dtype="<f8")
    except (binascii.Error, ValueError) as error:
        raise ValueError("it is not a packed matrix, which the bench writes") from error
    n = int(np.sqrt(2 * numbers.size))
    if numbers.size == 0 or n * (n + 1) // 2 != numbers.size or not np.all(np.isfinite(numbers)):
        raise ValueError("it is not a packed matrix, which the bench writes")
    matrix = np.zeros((n, n))
    matrix[np.tril_indices(n)] = numbers
    matrix = matrix + np.tril(matrix, -1).T
    matrix.setflags(write=False)
    return matrix
