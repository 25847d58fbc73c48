"""Tables of nonlinear local elements for the compiled kernels of nmt_plant, coordinate by coordinate."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from nmt_core.arrays import FloatArray
from nmt_core.errors import BenchError
from nmt_rig.model.aft import POLYNOMIAL_DEGREE, LocalTables
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.local_elements import (
    JENKINS,
    PARAMETER_COUNT,
    POWER_LAW_DAMPER,
    QUADRATIC_DRAG,
    TANH_FRICTION,
    TWO_SIDED_GAP,
    UNILATERAL_STOP,
    LocalElement,
)

# Drag has a kink in its second derivative, tanh none but is steep: errors of the harmonics below 1e-5.
SMOOTH_SAMPLES = {QUADRATIC_DRAG: 256, POWER_LAW_DAMPER: 512, TANH_FRICTION: 1024}


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
    needed = 4 * highest + 4
    jenkins: list[tuple[float, float]] = []
    contacts: list[tuple[float, float, float]] = []
    kinds: list[int] = []
    parameters: list[FloatArray] = []
    starts: tuple[list[int], list[int], list[int]] = ([0], [0], [0])
    for group in groups:
        for element in group:
            p = element.parameters
            kind = element.kind
            if kind == JENKINS:
                jenkins.append((p[0], p[1]))
            elif kind == UNILATERAL_STOP:
                contacts.append((p[0], p[1], 1.0))
            elif kind == TWO_SIDED_GAP:
                contacts += [(p[0], p[1], 1.0), (p[0], p[1], -1.0)]
            elif kind in POLYNOMIAL_DEGREE or kind in SMOOTH_SAMPLES:
                kinds.append(kind)
                parameters.append(p)
                degree = POLYNOMIAL_DEGREE.get(kind)
                needed = max(needed, SMOOTH_SAMPLES[kind] if degree is None else (degree + 1) * highest + 1)
            else:
                raise BenchError(
                    f"the diagnosis' model does not cover local element {type(element).__name__}; "
                    "leave it out of the model."
                )
        for start, rows in zip(starts, (len(jenkins), len(contacts), len(kinds)), strict=True):
            start.append(rows)
    values, slopes, slope_basis = _sampled(highest, needed if samples is None else samples)
    return (
        basis.orders,
        basis.offsets,
        slope_basis,
        np.array(jenkins, dtype=np.float64).reshape(-1, 2),
        np.array(starts[0], dtype=np.int64),
        np.array(contacts, dtype=np.float64).reshape(-1, 3),
        np.array(starts[1], dtype=np.int64),
        np.array(kinds, dtype=np.int64),
        np.array(parameters, dtype=np.float64).reshape(-1, PARAMETER_COUNT),
        np.array(starts[2], dtype=np.int64),
        values,
        slopes,
    )
