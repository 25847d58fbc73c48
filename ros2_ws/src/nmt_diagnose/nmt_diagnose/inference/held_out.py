"""What is kept out of a fit to judge it: interleaved levels, the highest two levels, and whole tests."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath

import numpy as np

from nmt_core.errors import BenchError
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


def named_tests(evidence: Evidence, names: Sequence[str]) -> BoolArray:
    """Rows of the tests of some names; a bag's name stands for all tests of the bag, shape (m,).

    Raises:
        BenchError: there is no such test, or nothing else is left.
    """
    found = np.zeros(len(evidence.rows), dtype=bool)
    for name in names:
        own = PurePath(name).name
        numbers = [
            k for k, t in enumerate(evidence.tests) if t.name == own or re.fullmatch(rf"{re.escape(own)} \d+", t.name)
        ]
        mine = np.isin(evidence.rows.test, numbers)
        if not mine.any():
            known = ", ".join(test.name for test in evidence.tests)
            raise BenchError(f"No test {name} with observables can be held out; the tests are {known}.")
        found |= mine
    if names and found.all():
        raise BenchError("Every test is held out, so there is nothing to fit; hold fewer of them out.")
    return found


def splits(evidence: Evidence, hold_out: Sequence[str] = ()) -> list[Split]:
    """The splits that a piece of evidence allows; empty if it is too small to hold anything out.

    Args:
        evidence: the real side.
        hold_out: tests to hold out, and nothing else.

    Raises:
        BenchError: a test to hold out that is not there.
    """
    if hold_out:
        mine = named_tests(evidence, hold_out)
        return [Split(" and ".join(f"the test {PurePath(name).name}" for name in hold_out), ~mine, mine)]
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
