"""A frequency sweep of a model at a held amplitude: the branch that a rig follows, and where it jumps.

At each frequency the amplitude of the reference that a response amplitude s needs is a function R(s) with one value, so
all steady states at a held level are its crossings of that level. Those where R rises with s are stable (of a single
mode; where it falls the least disturbance grows). A sweep stays on its branch as long as there is one and jumps to the
nearest other stable state where the branch ends in a fold.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_diagnose.measurements.stepped_responses import SteppedResponses, SteppedSinePredictor
from nmt_diagnose.observations.observables import Rows
from nmt_diagnose.prediction.parts_cache import PartsCache
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig

_AMPLITUDES = 240  # of the course R(s), over ``_DECADES`` below what resonance could reach
_DECADES = 5.0
_NEWTON_STEPS = 4


@dataclass(frozen=True)
class Sweep:
    """Steady states along a sweep.

    Attributes:
        responses: first channel over the reference, (lines,); in the order of the test's lines.
        jumps: indices of the lines at which the rig arrived by a jump, in the order of the lines.
    """

    responses: ComplexArray
    jumps: tuple[int, ...]


def frequency_sweep(
    rig: Rig, test: SteppedResponses, largest: float, settings: PredictionSettings | None = None
) -> Sweep:
    """The responses that a rig would show in a stepped sine test, on the stable branch that the sweep follows.

    Args:
        rig: the model.
        test: lines, levels and direction (0 = up); its measured responses are not looked at.
        largest: amplitude of the first channel that no state exceeds, in its unit.
        settings: of the predictor.

    Raises:
        BenchError: the rig does not fit the test.
    """
    settings = settings or PredictionSettings()
    count = test.lines_hz.size
    order = np.arange(count)[:: -1 if test.direction < 0 else 1]
    grid = largest * 10.0 ** np.linspace(-_DECADES, 0.0, _AMPLITUDES)
    responses = np.full(count, complex(math.nan))
    jumps: list[int] = []
    before = math.nan
    for line in order:
        states = _stable_states(rig, test, int(line), grid, settings)
        if not states:
            before = math.nan
            continue
        distance = [abs(math.log(s / before)) if math.isfinite(before) else math.log(s / grid[0]) for s, _ in states]
        nearest = int(np.argmin(distance))
        if math.isfinite(before) and distance[nearest] > THRESHOLDS.prediction.continued_log_step:
            jumps.append(int(line))
        before, responses[line] = states[nearest]
    return Sweep(responses, tuple(sorted(jumps)))


def _stable_states(
    rig: Rig, test: SteppedResponses, line: int, grid: FloatArray, settings: PredictionSettings
) -> list[tuple[float, complex]]:
    """Amplitude and response of every stable state at a line, smallest first."""
    reference, growth, _ = _courses(rig, test, line, grid, settings)
    level = float(test.levels[line])
    log_ratio = np.log(np.abs(reference) / level)
    found = []
    for k in np.flatnonzero((log_ratio[:-1] < 0.0) & (log_ratio[1:] >= 0.0)):
        s = math.exp(np.interp(0.0, log_ratio[k : k + 2], np.log(grid[k : k + 2])))
        low, high = grid[k], grid[k + 1]
        for _ in range(_NEWTON_STEPS):
            value, growth, response = _courses(rig, test, line, np.array([s]), settings)
            slope = float(growth[0].real)
            s *= math.exp(-math.log(abs(value[0]) / level) / slope) if slope > 0.0 else 1.0
            s = min(max(s, low), high)
        found.append((s, complex(response[0])))
    return found


def _courses(
    rig: Rig, test: SteppedResponses, line: int, amplitudes: FloatArray, settings: PredictionSettings
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Reference, its growth and responses over response amplitudes at one frequency, (amplitudes,) each."""
    size = amplitudes.size
    same = replace(
        test,
        lines_hz=np.full(size, test.lines_hz[line]),
        levels=amplitudes,
        measured=np.ones((size, len(test.channels)), dtype=np.complex128),
        noise=np.ones(size),
        held="response",
        growth=None,
    )
    nothing, real = np.zeros(0, dtype=np.int64), np.zeros(0)
    predictor = SteppedSinePredictor(
        same, Rows(nothing, nothing, nothing, nothing, nothing, real, real, real), settings
    )
    state = predictor.solve(rig, PartsCache(settings), None)[0]
    assert state is not None
    with np.errstate(divide="ignore", invalid="ignore"):
        return amplitudes / state.responses[:, 0], state.growth, state.responses[:, 0]
