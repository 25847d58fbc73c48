"""What is kept out of a fit to judge it: interleaved levels, the highest two levels, and whole tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nmt_diagnose.evidence.conditions import BackboneTable, PhaseResonanceTest, RecordTest, RingDownTest
from nmt_diagnose.evidence.observables import Evidence
from nmt_diagnose.inference.problem import BoolArray

_FEWEST_LEVELS = 4


@dataclass(frozen=True)
class Split:
    """One way to hold data out.

    Attributes:
        name: what is held out, for people.
        fitted: rows to fit, shape (m,).
        held_out: rows to judge by, shape (m,).
    """

    name: str
    fitted: BoolArray
    held_out: BoolArray


def splits(evidence: Evidence) -> list[Split]:
    """The splits that a piece of evidence allows; empty if it is too small to hold anything out."""
    rows = evidence.rows
    result = []
    levelled = np.zeros(len(rows), dtype=bool)
    odd = np.zeros(len(rows), dtype=bool)
    top = np.zeros(len(rows), dtype=bool)
    for number, test in enumerate(evidence.tests):
        mine = rows.test == number
        if not isinstance(test, PhaseResonanceTest | RingDownTest | BackboneTable | RecordTest) or not mine.any():
            continue
        levels = np.unique(rows.level[mine])
        if levels.size < _FEWEST_LEVELS:
            continue
        levelled |= mine
        odd |= mine & np.isin(rows.level, levels[1::2])
        if not isinstance(test, RecordTest):
            by_amplitude = {level: float(np.max(rows.amplitude[mine & (rows.level == level)])) for level in levels}
            highest = sorted(levels, key=lambda level: by_amplitude[level])[-2:]
            top |= mine & np.isin(rows.level, highest)
    if odd.any():
        result.append(Split("every second level", ~odd, odd))
    if top.any():
        result.append(Split("the highest two levels", ~top, top))
    present = [number for number in range(len(evidence.tests)) if np.any(rows.test == number)]
    if len(present) > 1:
        for number in present:
            mine = rows.test == number
            result.append(Split(f"the test {evidence.tests[number].name}", ~mine, mine))
    return result
