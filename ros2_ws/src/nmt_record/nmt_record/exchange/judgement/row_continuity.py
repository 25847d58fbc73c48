"""Are all rows of imported data there, once each? Doubled blocks of rows, and jumps of the phase inside windows.

Without a time column nothing else tells: a few rows too many or too few shift everything behind them, and a window over
such a place gives a wrong frequency with a small uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nmt_core.numerics.arrays import FloatArray
from nmt_signals.spectral_lines import common_line

_PERIODS = 2.0  # length of the moving sine fit; its Hann window is half as long in effect
_STEPS = 16  # positions of the fit in each length
_FEWEST_PERIODS = 6.0
_CERTAIN = 8.0  # standard deviations of the local phase
_SMALLEST = 0.5  # sampling intervals
_AGREEMENT = 0.5  # of a jump's size: channels that see it clearly agree that far
_LEAST_SINE = 0.3  # amplitude of the fitted sine over that of a sine with the power of the channel
_BATCH = 4096


@dataclass(frozen=True)
class PhaseJump:
    """A place where the phase of all channels steps.

    Attributes:
        sample: index in the stretch; known to a fraction of a period.
        phase: step of the phase, rad; the rest of whole turns.
        rows: the same in sampling intervals; positive = rows are missing, negative = rows are doubled.
        sigmas: size of the step in standard deviations of the local phase elsewhere in the stretch.
    """

    sample: int
    phase: float
    rows: float
    sigmas: float


def phase_jump(signals: Sequence[FloatArray], sample_rate: float) -> PhaseJump | None:
    """The clearest step of phase in a stretch of steady sine excitation, if there is one beyond the noise.

    A sine is fitted to each channel over a moving Hann window of two periods. The difference between the phases of
    adjacent windows, less its median (the frequency), is the step in between. The channels are averaged with the
    inverse of their variance, estimated from the median of the absolute differences, which a single step does not
    move. A change of frequency is not a step: it adds little over one window.

    Args:
        signals: channels of one stretch, each (samples,), without missing samples.
        sample_rate: Hz.
    """
    frequency = common_line(signals, sample_rate)
    samples = signals[0].size
    if not frequency > 0.0 or samples * frequency < _FEWEST_PERIODS * sample_rate:
        return None
    omega = 2.0 * math.pi * frequency / sample_rate
    step = max(1, round(_PERIODS * sample_rate / frequency / _STEPS))
    length = step * _STEPS
    position = np.arange(length) - 0.5 * (length - 1)
    weights = (0.5 + 0.5 * np.cos(2.0 * math.pi * position / length)) * np.exp(-1j * omega * position)
    apart = _STEPS * 3 // 4  # so far apart two Hann windows share next to nothing
    found: list[tuple[FloatArray, float]] = []
    for signal in signals:
        fitted = _moving_fit(signal - signal.mean(), weights, step)
        amplitude = 2.0 * np.median(np.abs(fitted)) / np.abs(weights).sum() if fitted.size > 2 * apart else 0.0
        if not amplitude > _LEAST_SINE * math.sqrt(2.0) * float(np.std(signal)):
            continue  # too short, or hardly a sine
        turned = fitted[apart:] * fitted[:-apart].conj() * np.exp(-1j * omega * step * apart)
        differences = np.angle(turned * np.exp(-1j * np.angle(np.sum(turned))))
        differences -= np.median(differences)
        found.append((differences, _spread(differences)))
    if not found:
        return None
    quietest = max(min(spread for _, spread in found), 1e-12)
    shares = [1.0 / max(spread, quietest) ** 2 for _, spread in found]
    combined = np.average([values for values, _ in found], axis=0, weights=shares)
    spread = max(_spread(combined), 1e-12)
    place = int(np.argmax(np.abs(combined)))
    size = float(combined[place])
    if not abs(size) > max(_CERTAIN * spread, _SMALLEST * omega):
        return None
    clear = [values[place] for values, own in found if own < 0.1 * abs(size)]
    if any(abs(value - size) > _AGREEMENT * abs(size) for value in clear):
        return None  # one sensor, not the rows
    centre = round(step * (place + 0.5 * apart) + 0.5 * length)
    return PhaseJump(centre, size, size / omega, abs(size) / spread)


def doubled_blocks(columns: Sequence[FloatArray]) -> list[tuple[int, int]]:
    """Blocks of at least two rows that are repeated at once, value by value.

    A block of m rows is repeated where exactly m rows, or fewer than 2 m, equal those m rows before. A signal that is
    periodic to the bit, or constant, equals itself for longer and is not meant.

    Args:
        columns: each (rows,).

    Returns:
        First row of each repetition and number of rows, ascending.
    """
    if not columns or columns[0].size < 4:
        return []
    identity = _row_digests(columns)
    order = np.argsort(identity, kind="stable")
    same = identity[order[1:]] == identity[order[:-1]]
    lag = np.zeros(identity.size, dtype=np.int64)
    lag[order[1:][same]] = (order[1:] - order[:-1])[same]
    edges = np.flatnonzero(np.diff(lag)) + 1
    starts = np.concatenate(([0], edges))
    lengths = np.diff(np.concatenate((starts, [lag.size])))
    blocks = lag[starts]
    repeated = (blocks >= 2) & (lengths >= blocks) & (lengths < 2 * blocks)
    found = [(int(start), int(block)) for start, block in zip(starts[repeated], blocks[repeated], strict=True)]
    return [
        (start, block)
        for start, block in found
        if all(np.array_equal(column[start - block : start], column[start : start + block]) for column in columns)
    ]


def _row_digests(columns: Sequence[FloatArray]) -> NDArray[np.uint64]:
    """A number for each row, equal where all values are equal and hardly ever otherwise, shape (rows,)."""
    total = np.zeros(columns[0].size, dtype=np.uint64)
    for column in columns:
        bits = np.ascontiguousarray(column).view(np.uint64)
        total = (total ^ bits) * np.uint64(0x9E3779B97F4A7C15)  # odd, from the golden ratio: spreads neighbours
        total ^= total >> np.uint64(29)
    return total


def _moving_fit(signal: FloatArray, weights: NDArray[np.complex128], step: int) -> NDArray[np.complex128]:
    """Amplitude of the sine in each window of the signal, shape (positions,)."""
    windows = np.lib.stride_tricks.sliding_window_view(signal, weights.size)[::step]
    parts = [windows[start : start + _BATCH] @ weights for start in range(0, windows.shape[0], _BATCH)]
    return np.concatenate(parts)


def _spread(values: FloatArray) -> float:
    """Standard deviation by the median of the absolute values."""
    return 1.4826 * float(np.median(np.abs(values)))
