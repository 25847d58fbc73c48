"""Signal-to-noise ratio of recorded windows: power of the harmonics over the power of what remains."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_signals.harmonics import harmonic_amplitudes, synthesise


def window_signal_to_noise(bag: Path, point: int, harmonics: int, periods: int = 50) -> dict[str, dict[str, float]]:
    """SNR of force and displacement at the drive point in each window.

    Args:
        bag: bag of a run.
        point: drive point.
        harmonics: harmonics that count as signal.
        periods: at most so many periods from the start of each window are used.

    Returns:
        For each level index (as text) ``force`` and ``displacement`` in dB.

    Raises:
        BenchError: the bag cannot be read.
    """
    from nmt_record.bag.bag_reader import Bag

    opened = Bag.open(bag)
    found: dict[str, dict[str, float]] = {}
    for lock in opened.lock_events():
        used = round(lock.window_samples * min(1.0, periods / max(1, lock.window_periods)))
        first, stop = lock.window_first_sample, lock.window_first_sample + used
        values = {}
        for topic in ("force", "displacement"):
            data, cycles = _stretch(opened, topic, point, first, stop)
            if data.size < 20 * harmonics:
                break
            amplitudes = harmonic_amplitudes(cycles, data[np.newaxis], harmonics)[0]
            signal = synthesise(cycles, amplitudes) - amplitudes[0].real
            noise = data - synthesise(cycles, amplitudes)
            values[topic] = float(10.0 * np.log10(np.mean(signal**2) / np.mean(noise**2)))
        else:
            found[str(lock.level_index)] = values
    return found


def _stretch(bag: Any, topic: str, point: int, first: int, stop: int) -> tuple[FloatArray, FloatArray]:
    """Samples of one channel and their unwrapped phase in cycles."""
    data: list[FloatArray] = []
    cycles: list[FloatArray] = []
    turns = 0.0
    for block in bag.blocks(topic, first, stop):
        row = block.points.index(point) if len(block.points) > 1 else 0
        phase = block.oscillator.phase(block.samples, block.sample_rate) / (2.0 * np.pi)
        if cycles:
            turns = float(np.round(cycles[-1][-1] - phase[0] + 0.5 * (phase[1] - phase[0])))
        data.append(block.data[row])
        cycles.append(phase + turns)
    if not data:
        return np.empty(0), np.empty(0)
    begin = max(0, first - int(next(iter(bag.blocks(topic, first, stop))).first_sample))
    return np.concatenate(data)[begin:], np.concatenate(cycles)[begin:]
