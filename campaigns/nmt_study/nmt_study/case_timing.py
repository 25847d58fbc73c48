"""How the loop spent its time in a recorded run: periods, time to lock, overshoot, scatter of each level."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.messages.records import LoopStatus
from nmt_core.messages.wire import read_status
from nmt_core.numerics.arrays import FloatArray


def level_timings(bag: Path, sample_rate: float, block_samples: int) -> dict[int, dict[str, float]]:
    """Timing of every level of a run in bench time from its bag, by level index.

    Returns:
        ``periods``: excitation periods from the start of the level to that of the next (or of the end); ``duration_s``:
        the same; ``time_to_lock_s``: from the start of the level to the lock, NaN without one; ``overshoot``: largest
        excursion of the frequency beyond its final value before the lock, relative to it; ``phase_scatter``: standard
        deviation of the loop's own phase error over the window, rad, NaN without one.

    Raises:
        BenchError: the bag cannot be read.
    """
    from nmt_record.bag.bag_reader import Bag

    opened = Bag.open(bag)
    states = [read_status(raw) for _, _, _, raw in opened.raw_messages(["frequency"])]
    levels = [message for _, _, message in opened.messages(["level"])]
    locks = {message.level_index: message for _, _, message in opened.messages(["lock"])}
    seen: dict[int, LoopStatus] = {state.last_sample: state for state in states}
    samples = np.array(sorted(seen))
    frequency = np.array([seen[int(k)].frequency_hz for k in samples])
    error = np.array([seen[int(k)].phase_error for k in samples])
    timings: dict[int, dict[str, float]] = {}
    previous = math.nan
    for k, level in enumerate(levels):
        if level.amplitude == 0.0:
            continue
        start = level.apply_at_sample
        end = levels[k + 1].apply_at_sample if k + 1 < len(levels) else int(samples[-1]) + 1
        inside = (samples >= start) & (samples < end)
        lock = locks.get(level.index)
        locked_at = lock.sample if lock is not None else None
        final = lock.frequency_hz if lock is not None else math.nan
        timings[level.index] = {
            "periods": float(frequency[inside].sum() * block_samples / sample_rate),
            "duration_s": (end - start) / sample_rate,
            "time_to_lock_s": (locked_at - start) / sample_rate if locked_at is not None else math.nan,
            "overshoot": _overshoot(frequency[inside & (samples <= (locked_at or 0))], previous, final),
            "phase_scatter": _scatter(error, samples, lock),
        }
        previous = final if math.isfinite(final) else previous
    return timings


def _overshoot(frequency: FloatArray, before: float, final: float) -> float:
    # Random excitation has no frequency.
    if not (math.isfinite(before) and math.isfinite(final)) or frequency.size == 0 or final == 0.0:
        return math.nan
    direction = math.copysign(1.0, final - before)
    return max(0.0, float(np.max(direction * (frequency - final)))) / final


def _scatter(error: FloatArray, samples: FloatArray, lock: object) -> float:
    if lock is None:
        return math.nan
    first = lock.window_first_sample  # type: ignore[attr-defined]
    window = (samples >= first) & (samples < first + lock.window_samples)  # type: ignore[attr-defined]
    values = error[window & np.isfinite(error)]
    return float(values.std()) if values.size > 1 else math.nan


def loop_history(bag: Path, entries: int) -> dict[str, list[Any]]:
    """Course of the frequency over a run, thinned.

    Args:
        bag: bag of the run.
        entries: number of entries to keep, at most.

    Returns:
        ``time_s`` (bench time), ``omega_rad_s`` (None where the drive is off) and ``state`` (as in
        ``nmt_msgs/Frequency``).
    """
    from nmt_record.bag.bag_reader import Bag

    opened = Bag.open(bag)
    states = [read_status(raw) for _, _, _, raw in opened.raw_messages(["frequency"])]
    seen = {state.last_sample: state for state in states}
    rate = float((opened.run_start or {})["parameters"]["pll"]["sample_rate"])
    chosen = [seen[k] for k in sorted(seen)][:: max(1, math.ceil(len(seen) / entries))]
    return {
        "time_s": [round((state.last_sample + 1) / rate, 6) for state in chosen],
        "omega_rad_s": [2.0 * math.pi * state.frequency_hz if state.frequency_hz > 0.0 else None for state in chosen],
        "state": [state.state for state in chosen],
    }
