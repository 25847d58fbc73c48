"""Delay of the force of records of imposed motion behind the motion, whatever the law.

A force that comes late turns springs into dampers and dampers into masses, so laws that are not there explain it. The
measured force is moved sample by sample, and a sum of many laws, which need not be distinguishable, is fitted at each
shift. The shift with the smallest residual is the delay.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.law.convex import ConvexFit
from nmt_diagnose.law.law_blocks import blocks_of_records
from nmt_diagnose.law.moved_record import MovedRecords
from nmt_diagnose.law.terms import Term

_COARSE = 12  # delays of each sign that are tried first
_SHORTEST = 1  # sample
_PLACES = (0.2, 0.5, 0.8)  # of a family of blocks
_TURN = 0.25  # of the motion, that a delay is not more than


def delay_of(records: MovedRecords, worth: FloatArray, ratio: float) -> int:
    """Samples by which the force comes later than the motion, negative where it is early; 0 without a clear delay.

    Args:
        records: as they were recorded.
        worth: what their errors of chain and model are divided by, (m,).
        ratio: largest residual over that without a delay at which a delay is accepted.
    """
    terms = _sum_of_laws(records)
    columns, signed = records.columns(terms), np.array([term.signed for term in terms], bool)
    errors = records.nuisance / worth
    costs: dict[int, float] = {}

    def cost(delay: int) -> float:
        if delay not in costs:
            costs[delay] = ConvexFit(records.moved(delay), errors, [], records.names).solve(columns, signed).cost
        return costs[delay]

    most = max(_SHORTEST, int(_TURN * records.samples_of_a_turn))
    tried = np.unique(np.round(np.geomspace(_SHORTEST, most, _COARSE)).astype(int)).tolist()
    delays = sorted([-delay for delay in tried] + [0, *tried])
    best = min(delays, key=cost)
    place = delays.index(best)
    near = range(delays[max(place - 1, 0)], delays[min(place + 1, len(delays) - 1)] + 1)
    best = min(_every(near), key=cost)
    return best if abs(best) >= _SHORTEST and cost(best) <= ratio**2 * cost(0) else 0


def _every(near: range) -> Sequence[int]:
    """All of few, else some of them."""
    return near[:: max(1, len(near) // _COARSE)]


def _sum_of_laws(records: MovedRecords) -> list[Term]:
    """Terms of a few blocks of each family, and the grids of sliders."""
    families = blocks_of_records(records.x, records.v).values()
    some = (members[int(place * len(members))] for members in families for place in _PLACES)
    return list(dict.fromkeys(term for block in some for term in block.terms))
