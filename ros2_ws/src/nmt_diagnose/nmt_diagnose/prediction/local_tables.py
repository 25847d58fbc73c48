"""Tables of nonlinear local elements for the compiled kernels of nmt_rig, coordinate by coordinate."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from nmt_core.numerics.arrays import FloatArray
from nmt_rig.model.aft import LocalTables, element_rows
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.local_elements.element import LocalElement


@lru_cache(maxsize=16)
def _sampled(highest: int, samples: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    basis = FourierBasis.up_to(highest)
    return basis.sampled(samples), basis.sampled_slope(samples), basis.sampled_slope(max(64, 8 * highest))


def local_tables(groups: Sequence[Sequence[LocalElement]], basis: FourierBasis, samples: int | None) -> LocalTables:
    """Tables of the elements of each coordinate (an empty group is a coordinate without force).

    Args:
        groups: elements of each coordinate.
        basis: orders 0 … H.
        samples: samples per period of smooth elements; None = from their kinds.

    Raises:
        BenchError: a kind without harmonic balance.
    """
    highest = int(basis.orders[-1])
    rows, needed = element_rows(groups, highest, 4 * highest + 4, fitted=True)
    values, slopes, slope_basis = _sampled(highest, needed if samples is None else samples)
    return LocalTables(basis.orders, basis.offsets, slope_basis, *rows, values, slopes)
