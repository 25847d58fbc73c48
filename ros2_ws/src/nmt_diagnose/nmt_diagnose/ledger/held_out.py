"""What is kept out of a fit to judge it: interleaved levels, the highest two levels, and whole tests."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import BoolArray
from nmt_diagnose.observations.observables import Observations, Part
from nmt_diagnose.thresholds import THRESHOLDS


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


def named_tests(observations: Observations, names: Sequence[str]) -> BoolArray:
    """Rows of the tests of some names; a bag's name stands for all tests of the bag, shape (m,).

    Raises:
        BenchError: there is no such test, or nothing else is left.
    """
    found = np.zeros(len(observations.rows), dtype=bool)
    for name in names:
        test_name = PurePath(name).name
        numbers = [
            k
            for k, t in enumerate(observations.tests)
            if t.name == test_name or re.fullmatch(rf"{re.escape(test_name)} \d+", t.name)
        ]
        selected = np.isin(observations.rows.test, numbers)
        if not selected.any():
            known = ", ".join(test.name for test in observations.tests)
            raise BenchError(f"No test {name} with observables can be held out; the tests are {known}.")
        found |= selected
    if names and found.all():
        raise BenchError("Every test is held out, so there is nothing to fit; hold fewer of them out.")
    return found


def splits(observations: Observations, hold_out: Sequence[str] = ()) -> list[Split]:
    """The splits that a set of observations allows; empty if it is too small to hold anything out.

    Args:
        observations: the real side.
        hold_out: tests to hold out, and nothing else.

    Raises:
        BenchError: a test to hold out that is not there.
    """
    if hold_out:
        selected = named_tests(observations, hold_out)
        return [Split(" and ".join(f"the test {PurePath(name).name}" for name in hold_out), ~selected, selected)]
    rows = observations.rows
    # Where a channel is clipped is read off the few windows that reach the level; no other window predicts it. Nor do
    # the samples that are lost in one window tell of those in others.
    limits = np.isin(rows.part, (Part.LIMIT, Part.REPEATS))
    result = []
    odd = np.zeros(len(rows), dtype=bool)
    top = np.zeros(len(rows), dtype=bool)
    for number, test in enumerate(observations.tests):
        selected = rows.test == number
        if not test.interleaved or not selected.any():
            continue
        levels = np.unique(rows.level[selected])
        if levels.size < THRESHOLDS.verdict.held_out_fewest_levels:
            continue
        odd |= selected & np.isin(rows.level, levels[1::2])
        if test.rising:
            by_amplitude = {level: float(np.max(rows.amplitude[selected & (rows.level == level)])) for level in levels}
            highest = sorted(levels, key=lambda level: by_amplitude[level])[-2:]
            top |= selected & np.isin(rows.level, highest)
    swept = _swept(observations)
    for group in swept:
        amplitudes = sorted({level for _, level in group})
        odd |= np.isin(rows.test, [number for number, level in group if level in amplitudes[1::2]])
        upper = amplitudes[-1:] if len(amplitudes) < THRESHOLDS.verdict.held_out_fewest_for_two else amplitudes[-2:]
        top |= np.isin(rows.test, [number for number, level in group if level in upper])
    if odd.any():
        result.append(Split("every second level", ~odd, odd))
    if top.any():
        result.append(Split("the highest levels" if swept else "the highest two levels", ~top, top))
    together = [[number for number, _ in group] for group in swept]
    alone = [[number] for number in range(len(observations.tests)) if not any(number in group for group in together)]
    present = [numbers for numbers in (*alone, *together) if np.any(np.isin(rows.test, numbers))]
    if len(present) > 1:
        for numbers in present:
            selected = np.isin(rows.test, numbers)
            names = observations.tests[numbers[0]].name
            if len(numbers) > 1:
                names = f"{names} and {len(numbers) - 1} more levels of it"
            result.append(Split(f"the test {names}", ~selected, selected))
    return [Split(split.name, split.fitted | limits, split.held_out & ~limits) for split in result]


def _swept(observations: Observations) -> list[list[tuple[int, float]]]:
    """Tests that are one frequency response at several held amplitudes: number and level of each, group by group."""
    groups: dict[object, list[tuple[int, float]]] = {}
    for number, test in enumerate(observations.tests):
        selected = observations.rows.test == number
        if test.sweep_key is not None and selected.any():
            level = float(f"{np.median(observations.rows.amplitude[selected]):.3g}")
            groups.setdefault(test.sweep_key, []).append((number, level))
    return [
        g for g in groups.values() if len({level for _, level in g}) >= THRESHOLDS.verdict.held_out_fewest_responses
    ]
