"""What a converter leaves in its samples: the step of its grid, and values that it, its driver or a network lost.

`converter_step` is sure: values of many neighbouring steps have to stand there. `resolution` is a lower bound for
uncertainties: the grid that all values lie on, even if they are always the same few. Of a lost sample the one before
stands in its place.
"""

from __future__ import annotations

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_signals.thresholds import CHANNEL_FAULTS


def converter_step(samples: FloatArray) -> float:
    """Distance of the values of a staircase, in their unit; 0 where the samples lie on no staircase.

    The staircase may have any offset. Steps finer than 1e-7 of the range count as none.

    Args:
        samples: finite values, shape (samples,).
    """
    values = np.unique(samples[: CHANNEL_FAULTS.step_samples])
    span = float(values[-1] - values[0])
    apart = np.diff(values)
    apart = apart[apart > CHANNEL_FAULTS.finest_step * span]
    if apart.size < CHANNEL_FAULTS.step_fewest_values - 1:
        return 0.0
    # The smallest distance is known to rounding only; the whole range counts many steps of it.
    near = float(np.median(apart[apart < 1.5 * apart.min()]))
    step = span / round(span / near)
    places = (values - values[0]) / step
    return step if np.abs(places - np.round(places)).max() < CHANNEL_FAULTS.step_rounding else 0.0


CONVERTER_BITS = 24
"""No converter resolves more: a stated uncertainty is never below what this resolution of the range allows."""
_OFF_GRID = 1e-3  # of a step: by how much values on a grid may be off it


def resolution(values: FloatArray) -> float:
    """Step of the grid on which the values of a channel lie, of its file or converter, in its unit; 0 = none seen."""
    finest = float(np.ptp(values)) / 2**CONVERTER_BITS
    steps = np.diff(np.unique(values[:4000]))
    steps = steps[steps > finest]
    if steps.size < 3:
        return 0.0
    # Where the same few values repeat, none may be one step next to another.
    for parts in range(1, 9):
        step = float(steps.min()) / parts
        ratio = steps / step
        on_grid = np.abs(ratio - np.round(ratio)) < np.maximum(_OFF_GRID * ratio / parts, 1e-6)
        if bool(on_grid.all()) and float(np.median(ratio)) < 1.0 / _OFF_GRID:
            return step
    return 0.0


def repeated_share(*windows: FloatArray) -> float:
    """Share of steep places at which the sample before was recorded again: values that a converter lost.

    Where the neighbours on both sides differ much, two equal samples are no chance, unless the converter is coarse:
    then the smallest steps are there as often.

    Args:
        windows: samples of one channel, (n,) each; what is lost is counted over all of them. Where there are several,
            half of them have to show it: one alone tells of an accident.
    """
    counts = [_counted(samples) for samples in windows]
    repeated, by_chance, steep = (sum(count[k] for count in counts) for k in range(3))
    showing = sum(count[0] > CHANNEL_FAULTS.repeats_crowding * count[1] for count in counts)
    if (
        repeated < CHANNEL_FAULTS.repeats_fewest
        or repeated <= CHANNEL_FAULTS.repeats_crowding * by_chance
        or 2 * showing < len(counts)
    ):
        return 0.0
    share = repeated / steep
    return share if share >= CHANNEL_FAULTS.repeats_least_share else 0.0


def _counted(samples: FloatArray) -> tuple[float, float, float]:
    """Repeats at steep places of a window, how many of them chance would make, and number of steep places."""
    steps = np.diff(samples)
    if steps.size < 3:
        return 0.0, 0.0, 0.0
    around = np.abs(samples[3:] - samples[:-3])
    # What a limiter clips stays at its ends.
    inside = (samples[1:-2] > samples.min()) & (samples[1:-2] < samples.max())
    steep = inside & (around > CHANNEL_FAULTS.repeats_steepness * float(np.sqrt(np.mean(around**2))))
    if not steep.any() or np.unique(samples).size < 0.2 * samples.size:
        return 0.0, 0.0, 0.0
    between = np.abs(steps[1:-1])
    smallest = float(between[between > 0.0].min(initial=np.inf))
    repeated = float(np.sum(steep & (between == 0.0)))
    by_chance = 0.5 * float(np.sum(steep & (between > 0.0) & (between < 1.5 * smallest)))
    return repeated, by_chance, float(steep.sum())
