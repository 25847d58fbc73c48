"""Motions of one point judged against each other: position, velocity and acceleration are derivatives of each other.

The derivative is taken by differences of samples, and the gain of these differences is taken out line by line. So
decays, random motion and sines are judged alike, and windows change nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.mistaken_units import mistaken_units
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.text.number_words import significant
from nmt_core.vocabulary import MOTIONS
from nmt_record.exchange.judgement.channel_checks import CheckedStretch, ImportedChannel
from nmt_signals.spectral_lines import piece_spectra

_PIECES = (16, 8, 4, 1)
_PERIODS = 3.0  # of the strongest line in a piece
_LONGEST = 2_000_000
_COHERENT = 0.9  # of lines by which motions are compared
_COMPARED = 0.5  # share of the power that these lines have
_HIGHEST = 0.8  # of half the sampling rate: above it differences of samples lose their gain
_FACTOR = math.log(1.5)  # a gain that is not a calibration
_NOTED_FACTOR = math.log(1.1)
_QUARTER = (math.radians(60.0), math.radians(120.0))  # phases of another quantity
_LATE = 0.3  # sampling intervals
_CERTAIN = 5.0
_FILTERED = 0.8  # gain at the upper lines over that at the lower ones


@dataclass(frozen=True)
class MotionRatio:
    """A motion over what another one at the same point says that it should be.

    Attributes:
        factor: usual ratio; negative = turned.
        delay: by which it is late, s.
        delay_std: standard uncertainty of that, s.
        frequency_hz: lowest and highest line by which they were compared.
        gain: of the upper third of the lines over that of the lower third.
        phase: usual phase, rad.
    """

    factor: float
    delay: float
    delay_std: float
    frequency_hz: tuple[float, float]
    gain: float
    phase: float


def motion_ratio(lower: FloatArray, higher: FloatArray, orders: int, sample_rate: float) -> MotionRatio | None:
    """A motion against one or two derivatives of another.

    Args:
        lower: the motion of lower order, such as a position, shape (samples,).
        higher: that of higher order, shape (samples,).
        orders: 1 or 2, by how many derivatives they differ.
        sample_rate: Hz.

    Returns:
        ``higher`` over the derivative of ``lower``; None where they are too short or not coherent.
    """
    good = np.isfinite(lower) & np.isfinite(higher)
    first, stop = _longest_run(good)
    lower, higher = lower[first : min(stop, first + _LONGEST)], higher[first : min(stop, first + _LONGEST)]
    if lower.size < 64 or not np.ptp(lower) > 0.0 or not np.ptp(higher) > 0.0:
        return None
    if orders == 1:
        derived = 0.5 * (lower[2:] - lower[:-2]) * sample_rate
    else:
        derived = (lower[2:] - 2.0 * lower[1:-1] + lower[:-2]) * sample_rate**2
    found = _spectra(derived, higher[1:-1], sample_rate)
    if found is None:
        return None
    frequency, derivative, other, several = found
    step = 2.0 * np.pi * frequency / sample_rate
    derivative = derivative * (step / np.sin(step) if orders == 1 else step**2 / (2.0 - 2.0 * np.cos(step)))
    cross = (other * derivative.conj()).sum(axis=0)
    power, theirs = (np.abs(derivative) ** 2).sum(axis=0), (np.abs(other) ** 2).sum(axis=0)
    strong = theirs > 1e-4 * theirs.max()
    coherent = strong if not several else strong & (np.abs(cross) ** 2 > _COHERENT * power * theirs)
    if not coherent.any() or theirs[coherent].sum() < _COMPARED * theirs.sum():
        return None
    return _ratio(frequency[coherent], cross[coherent] / power[coherent], theirs[coherent])


def _spectra(
    derived: FloatArray, other: FloatArray, sample_rate: float
) -> tuple[FloatArray, ComplexArray, ComplexArray, bool] | None:
    """Spectra of pieces that hold some periods, below the highest line."""
    for pieces in _PIECES:
        found = piece_spectra([derived, other], sample_rate, pieces)
        if found is None:
            continue
        frequency, (one, two) = found
        keep = frequency < _HIGHEST * 0.5 * sample_rate
        strongest = int(np.argmax((np.abs(two) ** 2).sum(axis=0)[keep]))
        if strongest + 1 >= _PERIODS or pieces == 1:
            return frequency[keep], one[:, keep], two[:, keep], pieces > 1
    return None


def _ratio(frequency: FloatArray, ratio: ComplexArray, weights: FloatArray) -> MotionRatio:
    weights = weights / weights.sum()
    order = np.argsort(np.abs(ratio))
    middle = float(np.abs(ratio)[order][min(int(np.searchsorted(np.cumsum(weights[order]), 0.5)), order.size - 1)])
    omega = 2.0 * np.pi * frequency
    several = frequency.size >= 3 and frequency[-1] > 1.2 * frequency[0]
    fits = [_delay(omega, np.angle(sign * ratio), weights, several) for sign in (1.0, -1.0)]
    turned = fits[1][2] < 0.5 * fits[0][2]
    delay, std, _ = fits[turned]
    third = max(1, frequency.size // 3)
    low, high = (float(np.median(np.abs(part))) for part in (ratio[:third], ratio[-third:]))
    mean = np.angle((weights * ratio / np.abs(ratio)).sum())
    return MotionRatio(
        -middle if turned else middle, delay, std, (float(frequency[0]), float(frequency[-1])),
        high / max(low, 1e-300) if several else 1.0, float(mean),
    )  # fmt: skip


def _delay(omega: FloatArray, angles: FloatArray, weights: FloatArray, several: bool) -> tuple[float, float, float]:
    """Delay (s, NaN where one line does not tell it), its standard uncertainty, and the variance of phase left."""
    if not several:
        return math.nan, math.inf, float((weights * angles**2).sum())
    bottom = float((weights * omega**2).sum())
    slope = float((weights * omega * angles).sum()) / bottom
    left = angles - slope * omega
    variance = float((weights * left**2).sum())
    return -slope, math.sqrt(variance * float(weights.max()) / bottom) + 1e-12, variance


def _longest_run(good: np.ndarray) -> tuple[int, int]:
    """First sample and sample after the last of the longest stretch without holes."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], good, [False])).astype(np.int8)))
    if not edges.size:
        return 0, 0
    starts, stops = edges[::2], edges[1::2]
    longest = int(np.argmax(stops - starts))
    return int(starts[longest]), int(stops[longest])


def check_motions(
    channels: Sequence[ImportedChannel], stretches: Sequence[CheckedStretch], places: Sequence[str], sample_rate: float
) -> list[str]:
    """Motions of each point against each other, in the longest stretch.

    Args:
        channels: all of them.
        stretches: in which something was done; without any nothing is judged.
        places: of the channels in the sidecar, for messages.
        sample_rate: Hz.

    Returns:
        Sentences on gains, delays and filters.

    Raises:
        BenchError: by a factor of units, or by their sign, one of two motions is not what the sidecar says.
    """
    longest = max(stretches, key=lambda stretch: stretch.stop - stretch.first, default=None)
    if longest is None:
        return []
    motions = [(c, place) for c, place in zip(channels, places, strict=True) if c.quantity in MOTIONS and c.point]
    notes: list[str] = []
    for number, (one, place) in enumerate(motions):
        for other, _ in motions[:number]:
            orders = MOTIONS[one.quantity] - MOTIONS[other.quantity]
            if one.point != other.point or orders == 0 or _turns(one) != _turns(other):
                continue
            lower, higher = (other, one) if orders > 0 else (one, other)
            cut = slice(longest.first, longest.stop)
            found = motion_ratio(lower.data[cut], higher.data[cut], abs(orders), sample_rate)
            if found is not None:
                notes += _sentences(lower, higher, found, place, sample_rate)
    return notes


def _turns(channel: ImportedChannel) -> bool:
    return channel.section.si_unit.startswith("rad")


def _sentences(
    lower: ImportedChannel, higher: ImportedChannel, found: MotionRatio, place: str, sample_rate: float
) -> list[str]:
    derivative = "rate of change" if MOTIONS[higher.quantity] - MOTIONS[lower.quantity] == 1 else "second derivative"
    first = f"the {derivative} of column {lower.source} ({lower.name})"
    second = f"column {higher.source} ({higher.name})"
    size = math.log(abs(found.factor))
    stated = any("scale" in channel.section.model_fields_set for channel in (lower, higher))
    turned = found.factor < 0.0
    inverse = 1.0 / found.factor
    units = mistaken_units(max(abs(found.factor), abs(inverse)))  # of the one that is too large
    if (abs(size) > _FACTOR or turned) and not stated:
        what = f"{first} is {significant(inverse, 3)} times {second}"
        guess = f" ({' or '.join(units[:1])}?)" if units and abs(size) > _FACTOR else ""
        raise BenchError(
            f"{place}: at point {higher.point} {what}{guess}: unit, gear or sign of one of them is not as the sidecar "
            f"says ({lower.section.unit}, {higher.section.unit}); correct it, give 'point: …' if they are at two "
            "points, or state 'scale: …' (1 if they are meant so)."
        )
    notes = []
    if _QUARTER[0] < abs(found.phase) < _QUARTER[1] and not stated:
        notes.append(
            f"At point {higher.point} {first} and {second} are {math.degrees(abs(found.phase)):.0f}° apart; is one of "
            "them another quantity?"
        )
    if abs(size) > _NOTED_FACTOR or turned:
        notes.append(f"At point {higher.point} {first} is {significant(inverse, 3)} times {second}.")
    if abs(found.delay) > max(_LATE / sample_rate, _CERTAIN * found.delay_std):
        late, than = (higher.name, first) if found.delay > 0.0 else (lower.name, second)
        notes.append(
            f"At point {higher.point} {late} is late against {than} by {1e3 * abs(found.delay):.3g} ms from "
            f"{found.frequency_hz[0]:.3g} to {found.frequency_hz[1]:.3g} Hz ('delay_s' takes a delay out)."
        )
    for gain, name, than in ((found.gain, higher.name, first), (1.0 / found.gain, lower.name, second)):
        if gain < _FILTERED:
            notes.append(
                f"Towards {found.frequency_hz[1]:.3g} Hz {name} falls to {100.0 * gain:.0f} % of the value by "
                f"{than}: a "
                "filter."
            )
    return notes
