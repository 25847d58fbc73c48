"""Tests that a rig allows and that have not been made, as values."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nmt_core import kinds
from nmt_core.errors import BenchError
from nmt_core.kinds.request import TestRequest
from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.ahead.expected_rows import drive_point_of, expected, model_frequencies, voltage_runs
from nmt_diagnose.measurements.measurement import (
    Measurement,
    Observations,
    holds_amplitude,
    is_broad_band,
    locked_levels,
)
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig

_HIGHER_LEVELS = 6
_DECAY_PERIODS = 400.0
"""Length of a free decay that is asked for: it ends in the noise before, with a damping ratio above 0.2 %."""


@dataclass(frozen=True)
class Proposal:
    """A test that could be made.

    Attributes:
        text: what to do.
        request: the same as a value.
        observations: its observables with expected uncertainties; values are not set.
        seconds: bench time that it takes, as the tests at hand took it.
    """

    text: str
    request: TestRequest
    observations: Observations
    seconds: float = math.nan


class Proposals:
    """Tests that can be proposed in addition to those at hand: of the recorded rig, under its recorded conditions.

    The model is not what is to be measured.

    Args:
        rig: the model.
        observations: what has been measured.
    """

    def __init__(self, rig: Rig, observations: Observations) -> None:
        self.rig, self.observations = rig, observations
        self.runs = voltage_runs(observations)
        origins = observations.origins
        self._file = origins[0].rig_file if origins and all(origin.rig_file for origin in origins) else ""
        self._periods = next((origin.periods for origin in origins if origin.periods), 0)

    @property
    def drives(self) -> tuple[float, ...]:
        """Levels of the first mode and drive point at hand, V, rising; of further ones the same levels are these."""
        if not self.runs:
            return ()
        frequencies, first = model_frequencies(self.rig), self.runs[0]
        like = [run for run in self.runs if run.drive_point == first.drive_point]
        like = [run for run in like if _modes_of([run], frequencies) == _modes_of([first], frequencies)]
        return tuple(sorted({level.drive for level in locked_levels(like) if math.isfinite(level.drive)}))

    @property
    def seconds_of_a_level(self) -> float:
        """Bench time from level to level in the tests at hand, s."""
        steps = [
            abs(later.stop_s - before.stop_s)
            for run in self.runs
            for before, later in itertools.pairwise(sorted(run.levels, key=lambda level: level.stop_s))
        ]
        first = [level.stop_s - level.start_s for level in locked_levels(self.runs)]
        return float(np.median(steps or first or [math.nan]))

    def request(self, name: str, **settings: Any) -> TestRequest:
        """A test of the recorded rig, with windows as they were recorded."""
        kind = settings.setdefault("kind", kinds.PhaseResonanceTest())
        settings.setdefault("periods", self._periods if kind.has_phase and not kind.window_s else 0)
        return TestRequest(name=name, rig=self._file, **settings)

    def all(self, with_plan: bool = False, further: bool = False) -> list[Proposal]:
        """The tests that the rig allows and that have not been made.

        Args:
            with_plan: levels go on by a plan, see `next_levels`; else up to twice those measured.
            further: other kinds of test too, at the highest level at hand.
        """
        found = [self._random(), *(self._levels(with_plan) if self.runs else ())]
        found += self._other_kinds() if further and self.runs else []
        return [proposal for proposal in found if proposal is not None]

    def proposal(self, text: str, request: TestRequest, seconds: float) -> Proposal | None:
        """A test with its rows; None where the rig cannot be tested so, or what it would show is not foretold."""
        try:
            request.check(float(self.rig.sample_rate_hz))
            rows = expected(request, self.rig, self.observations)
        except BenchError:
            return None
        return Proposal(text, request, compared(rows, request), seconds)

    def _random(self) -> Proposal | None:
        if any(map(is_broad_band, self.observations.tests)):
            return None
        request = self.request("random", kind=kinds.RandomTest())
        point = drive_point_of(request, self.rig, self.observations)
        text = f"a random test at low level, driven at point {point}"
        return self.proposal(text, request, THRESHOLDS.next_test.random_seconds)

    def _other_kinds(self) -> list[Proposal | None]:
        """A decay, a response curve and noise at the highest level at hand, of the first mode and drive point."""
        high, each = self.drives[-1], self.seconds_of_a_level
        first = self.runs[0]
        top = max(first.levels, key=lambda level: level.drive if math.isfinite(level.drive) else 0.0)
        frequency_hz, result = top.frequency_hz, []
        if not any(test.free for test in self.observations.tests):
            lasts = _DECAY_PERIODS / frequency_hz
            request = self.request("decay", kind=kinds.RingDownTest(duration=lasts), levels=(high,))
            result.append(self.proposal(f"a free decay from {high:.3g} V", request, each + lasts))
        if math.isfinite(top.force_n) and not any(map(holds_amplitude, self.observations.tests)):
            request = self.request("curve", kind=kinds.ResponseCurveTest(), levels=(top.force_n,))
            found = self.proposal(f"the response curve at {top.force_n:.3g} N", request, each)
            # Each of its points takes about as long as a level.
            points = 0 if found is None else len(np.unique(found.observations.rows.level))
            result.append(None if found is None else replace(found, seconds=points * each))
        if any(map(is_broad_band, self.observations.tests)):
            request = self.request("noise", kind=kinds.RandomTest(), levels=(high,))
            text = f"a random test at {high:.3g} V rms"
            result.append(self.proposal(text, request, THRESHOLDS.next_test.random_seconds))
        return result

    def _levels(self, with_plan: bool) -> list[Proposal | None]:
        """Locked levels elsewhere, of another mode, downwards, and beyond those at hand."""
        drives, each = self.drives, self.seconds_of_a_level
        frequencies, mode = model_frequencies(self.rig), self.rig.test.mode
        made, locked = {run.drive_point for run in self.runs}, _modes_of(self.runs, frequencies)
        same = each * len(drives)
        result = []
        for point in self.rig.structure.points:
            if point not in made:
                request = self.request(f"point{point}", levels=drives, exciters=(point,))
                result.append(self.proposal(f"the same levels with the exciter at point {point}", request, same))
        others = (n for n in range(mode + 1, frequencies.size + 1) if n not in locked and frequencies[n - 1] > 0.0)
        if other := next(others, 0):
            request = self.request(f"mode{other}", levels=drives, changes=(("test.mode", other),))
            result.append(self.proposal(f"the same levels on mode {other}", request, same))
        if all(level.direction >= 0 for level in locked_levels(self.runs)):
            request = self.request("both", levels=drives, direction="both")
            result.append(self.proposal("the same levels downwards, after going up", request, 2.0 * same))
        limit, high = self.rig.limits.voltage_v, 2.0 * drives[-1]
        if not with_plan and (limit is None or high <= limit):
            more = tuple(map(float, np.geomspace(drives[-1], high, _HIGHER_LEVELS)))
            text = f"higher levels, up to {high:.3g} V (mind what the specimen bears)"
            result.append(self.proposal(text, self.request("high", levels=more), each * len(more)))
        return result


def proposals(rig: Rig, observations: Observations, with_plan: bool = False, further: bool = False) -> list[Proposal]:
    """Tests that a rig allows and that have not been made; arguments as for `Proposals`."""
    return Proposals(rig, observations).all(with_plan, further)


def compared(rows: Observations, request: TestRequest) -> Observations:
    """Rows by which a test is judged: of levels that are repeated downwards those on the way down."""
    taken = rows.rows.harmonic != 0
    if request.direction == "both":
        taken &= rows.rows.level >= len(request.levels) - 1
    return rows.take(taken)


def _modes_of(runs: Sequence[Measurement], frequencies: FloatArray) -> set[int]:
    """Numbers of the modes of the model that are nearest to the locked frequencies of some runs."""
    locked = [level.frequency_hz for level in locked_levels(runs) if level.frequency_hz > 0.0]
    numbers = np.flatnonzero(frequencies > 0.0)
    ratios = [np.abs(np.log(frequencies[numbers] / frequency)) for frequency in locked if numbers.size]
    return {int(numbers[np.argmin(ratio)]) + 1 for ratio in ratios}
