"""What a column of numbers shows of itself: codes of no value, ranges that begin again, held and clipped values,
steps of zero, gravity in another unit."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import BoolArray, FloatArray
from nmt_record.exchange.judgement.channel_checks import ImportedChannel
from nmt_record.exchange.sidecar.import_sidecar import ChannelSection
from nmt_record.exchange.source_table import SourceTable, split_name
from nmt_record.exchange.unit_table import STANDARD_GRAVITY, plain_unit

_CODES = (999.0, 999.25, 999.9, 999.99, 9999.0, 9999.9, 99999.0, 999999.0, 8888.0, 32767.0, 32768.0, 65535.0,
          2147483647.0, 2147483648.0, 4294967295.0)  # fmt: skip
_NO_SIGNAL = 1e29  # no sensor reads that: 1e30, 1e31, 9.9e37 and 9.91e37 of SCPI, the largest single
_APART = 2.0  # distance of a code from all other values, in their range
_JUMP = 20.0  # to a code and back, in usual steps
_MOST_CODES = 0.2  # of the values

_WHOLE_TURNS = {"rad": 2.0 * math.pi, "deg": 360.0}
_SIGN_BITS = (7, 9, 11, 12, 13, 14, 15, 17, 19, 21, 23, 27, 31)
_FEWEST_SIGNS = 0.02  # share of either
_COUNT_BITS = (8, 10, 12, 13, 14, 15, 16, 18, 20, 24, 32)
_NARROW = 0.25  # of the range: the rest of a step when a range is taken off
_OVER = 1.02  # of the range: how far values reach
_FEWEST_VALUES = 20

_HELD_RUNS = 50
_HELD_SHARE = 0.95
_FLAT_RUN, _FLAT_VALUES, _FLAT_LEVELS = 3, 6, 200
_PIECES = 64
_LAGS, _FEWEST_FITTED, _LONGEST_FITTED = 24, 960, 1_000_000
_CLEAR_STEP, _USUAL = 7.0, 4.5  # standard deviations: of a step, and of its surroundings
_STEP_SHARE = 0.2  # of the standard deviation
_LEAST_NOISE, _CANDIDATES = 1e-4, 20
_ALIKE, _MOST_JUMPS = 0.4, 500  # of a step: another jump of the same kind; how many are looked at


@dataclass(frozen=True)
class Wrap:
    """A range that begins again.

    Attributes:
        period: by how much values jump, in the file's numbers.
        jumps: how often.
        first: row of the first jump.
    """

    period: float
    jumps: int
    first: int


def value_codes(values: FloatArray) -> BoolArray:
    """Values that stand for no value, shape (rows,): the same number again and again, far from all others.

    Args:
        values: a column; NaN where it has none.
    """
    found = np.isfinite(values) & (np.abs(values) >= _NO_SIGNAL)
    others = np.isfinite(values) & ~found
    if found.any() and float(np.abs(values[others]).max(initial=0.0)) < 1e-3 * _NO_SIGNAL:
        values = np.where(found, np.nan, values)
    else:
        found = np.zeros(values.shape, dtype=bool)
    finite = values[np.isfinite(values)]
    steps = np.abs(np.diff(finite))
    usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
    for code in (sign * code for code in _CODES for sign in (-1.0, 1.0)):
        which = values == code
        count = int(which.sum())
        if not 0 < count < _MOST_CODES * values.size:
            continue
        rest = values[np.isfinite(values) & ~which]
        if not rest.size or not np.ptp(rest) > 0.0:
            continue
        apart = float(np.abs(rest - code).min())
        lonely = apart > _APART * float(np.ptp(rest))
        # A code may lie in the range of a wide signal, or whole numbers reach it in the course of it.
        if lonely or (count > 1 and _jumps(values, which, _JUMP * max(usual, 1e-300)) and apart > _JUMP * usual):
            found |= which
    return found


def _jumps(values: FloatArray, which: BoolArray, least: float) -> bool:
    """Whether the values next to all marked ones are far from them."""
    places = np.flatnonzero(which)
    for shift in (-1, 1):
        next_places = places + shift
        next_places = next_places[(next_places >= 0) & (next_places < values.size)]
        near = np.abs(values[next_places] - values[next_places - shift])[~which[next_places]]
        if (near < least).any():
            return False
    return True


def wrap_of(values: FloatArray, periods: Sequence[float]) -> Wrap | None:
    """A range that begins again: jumps by the whole of it among steps that are small.

    Args:
        values: a column; NaN where it has none.
        periods: ranges that may be.
    """
    rows = np.flatnonzero(np.isfinite(values))
    finite = values[rows]
    if finite.size < _FEWEST_VALUES:
        return None
    steps, reach = np.diff(finite), float(np.ptp(finite))
    for period in periods:
        jumps = np.abs(steps) > (1.0 - _NARROW) * period
        if reach > _OVER * period or not jumps.any() or jumps.mean() > 0.75:
            continue
        left = np.abs(steps[jumps]) - period
        # Both ends exactly are two states and no range.
        if (left == 0.0).all() or np.abs(left).max() > _NARROW * period:
            continue
        others = np.abs(steps[~jumps])
        if others.size and float(np.quantile(others, 0.99)) > _NARROW * period:
            continue
        return Wrap(period, int(jumps.sum()), int(rows[int(np.argmax(jumps)) + 1]))
    return None


def unwrapped(values: FloatArray, period: float) -> FloatArray:
    """Values that go on where their range began again, about zero as far as may be, shape (rows,).

    Args:
        values: a column; NaN where it has none.
        period: of the range, in the same numbers.
    """
    result, good = values.copy(), np.isfinite(values)
    if not good.any():
        return result
    going_on = np.unwrap(values[good], period=period)
    result[good] = going_on - period * np.round(float(np.median(going_on)) / period)
    return result


def held_samples(values: FloatArray) -> float:
    """Mean number of samples for which a column keeps each value; 1 where it does not hold them.

    Args:
        values: a column; NaN where it has none.
    """
    finite = values[np.isfinite(values)]
    changes = np.flatnonzero(np.diff(finite) != 0.0)
    if changes.size < _HELD_RUNS:
        return 1.0
    runs = np.diff(changes)
    usual = int(np.median(runs))
    near = [np.isin(runs, (usual + shift, usual + shift + 1)) for shift in (-1, 0)]
    best = max(near, key=lambda which: float(which.mean()))
    if usual < 2 or float(best.mean()) < _HELD_SHARE:
        return 1.0
    return float(runs[best].mean())


def flat_top(values: FloatArray) -> tuple[int, int]:
    """How many values stand at the largest or the smallest one, in runs, and the longest run; zeros where few do.

    Args:
        values: a column; NaN where it has none.
    """
    finite = values[np.isfinite(values)]
    if finite.size < _FEWEST_VALUES or np.unique(finite[:100_000]).size < _FLAT_LEVELS:
        return 0, 0
    count = longest = 0
    for end in (finite.max(), finite.min()):
        edges = np.flatnonzero(np.diff(np.concatenate(([False], finite == end, [False])).astype(np.int8)))
        runs = edges[1::2] - edges[::2]
        if runs.size and runs.max() >= _FLAT_RUN and runs.sum() >= _FLAT_VALUES:
            count, longest = count + int(runs.sum()), max(longest, int(runs.max()))
    return count, longest


def zero_step(values: FloatArray) -> tuple[int, float] | None:
    """Row and size of a step of the mean that comes from one sample to the next and stays; None where there is none.

    By generalised least squares: an autoregressive filter makes the signal white, and a step at every row, filtered by
    it as well, is fitted with a constant. A drift must explain less, what the step leaves near it must be what the
    signal has elsewhere, and the means on either side must differ by it.

    Args:
        values: a column; NaN where it has none.
    """
    coarse = -(-values.size // _LONGEST_FITTED)
    x = _filled_means(values, coarse)
    spread = float(np.std(x)) if x.size else 0.0
    if x.size < _FEWEST_FITTED or not spread > 0.0:
        return None
    x = (x - x.mean()) / spread
    size = 1 << int(2 * x.size).bit_length()
    covariance = np.fft.irfft(np.abs(np.fft.rfft(x, size)) ** 2, size)[: _LAGS + 1] * (
        1.0 + 1e-9 * (np.arange(_LAGS + 1) == 0)
    )
    whitening = np.concatenate(([1.0], -solve_toeplitz(covariance[:_LAGS], covariance[1:])))
    white = lfilter(whitening, [1.0], x)[_LAGS:]
    shape = np.cumsum(whitening)[:_LAGS]  # of a filtered step, until it stands still at `level`
    level = float(whitening.sum())
    count = white.size - _LAGS
    line = np.arange(white.size) - 0.5 * (white.size - 1)
    noise = max(float(np.median(np.abs(white))) / 0.6745, float(np.quantile(np.abs(white), 0.9)) / 1.645, _LEAST_NOISE)

    def products(signal: FloatArray) -> FloatArray:
        """Of a signal with the filtered step at every row."""
        behind = np.cumsum(signal[::-1])[::-1]
        return np.asarray(np.correlate(signal, shape, "valid")[:count] + level * behind[_LAGS:])

    mean = np.full(white.size, white.size**-0.5)
    shared = products(mean)
    norm = np.maximum((shape**2).sum() + level**2 * (count - np.arange(count)) - shared**2, 1e-12)
    result = products(white) - shared * float(mean @ white)
    steps, clear = result / norm, np.abs(result) / np.sqrt(norm) / noise
    drift = abs(float(line @ white)) / float(np.linalg.norm(line)) / noise
    for _ in range(_CANDIDATES):
        best = int(np.argmax(clear))
        if clear[best] < max(_CLEAR_STEP, drift):
            return None
        if _stands(white, shape, level, best, float(steps[best]), noise):
            if _jumps_elsewhere(white, shape, best, float(steps[best]), noise):
                return None
            return (best + _LAGS) * coarse, float(steps[best]) * spread
        clear[max(0, best - _LAGS) : best + _LAGS] = 0.0
    return None


def _stands(white: FloatArray, shape: FloatArray, level: float, row: int, step: float, noise: float) -> bool:
    """Whether what a step leaves near it is as elsewhere, and the means on either side differ by it."""
    if abs(step) < _STEP_SHARE or float(np.abs(white[row : row + _LAGS] - step * shape).max()) > _USUAL * noise:
        return False
    near = max(_LAGS, white.size // 8)
    before, after = white[max(0, row - near) : row], white[row + _LAGS : row + _LAGS + near]
    if min(before.size, after.size) <= _LAGS:
        return True
    std = noise * math.sqrt(1.0 / before.size + 1.0 / after.size)
    return bool(abs(after.mean() - before.mean() - level * step) < 0.3 * abs(level * step) + 3.0 * std)


def _jumps_elsewhere(white: FloatArray, shape: FloatArray, row: int, step: float, noise: float) -> bool:
    """Whether the signal jumps elsewhere as well, as dry friction does at every reversal: no zero was set anew."""
    energy = float((shape**2).sum())
    local = np.correlate(white, shape, "valid") / energy
    rows = np.flatnonzero(
        (np.abs(local) > _ALIKE * abs(step)) & (np.abs(local) * math.sqrt(energy) > _CLEAR_STEP * noise)
    )
    rows = rows[np.abs(rows - row) > _LAGS]
    misfit = [
        float(np.abs(white[row_index : row_index + _LAGS] - local[row_index] * shape).max())
        for row_index in rows[:_MOST_JUMPS]
    ]
    return any(value < _USUAL * noise for value in misfit)


def _filled_means(values: FloatArray, count: int) -> FloatArray:
    """Means of so many samples each, straight lines where values are missing; empty where most are."""
    good = np.flatnonzero(np.isfinite(values))
    if 2 * good.size <= values.size:
        return np.empty(0)
    filled = np.interp(np.arange(values.size), good, values[good])
    return np.asarray(filled[: filled.size // count * count].reshape(-1, count).mean(axis=1))


def judged_columns(
    channels: Sequence[ChannelSection], indices: Sequence[int], table: SourceTable, places: Sequence[str]
) -> tuple[list[FloatArray], list[str]]:
    """Columns without codes of no value and with ranges that go on, and sentences on what was found.

    Args:
        channels: what the sidecar says of each.
        indices: of their columns.
        table: the file.
        places: of the channels in the sidecar, for messages.

    Raises:
        BenchError: a range of counts begins again, or gravity says that a unit is another one, and the sidecar must
            say what it means.
    """
    columns, notes = [], []
    for channel, index, place in zip(channels, indices, places, strict=True):
        values, name = table.columns[index], table.names[index] or str(index + 1)
        codes = value_codes(values) if channel.no_value is None else values == channel.no_value
        if codes.any():
            listed = ", ".join(f"{code:g}" for code in np.unique(values[codes])[:3])
            notes.append(
                f"Column {name} holds {listed} {int(codes.sum())} times (first at "
                f"{table.place(int(np.argmax(codes)))}), which stands for no value; these are marked as missing."
            )
            values = np.where(codes, np.nan, values)
        values = _going_on(channel, table, index, values, place, notes)
        notes += _held_and_clipped(name, values, table)
        columns.append(values)
    _check_gravity(channels, indices, table, places)
    return columns, notes


def _going_on(
    channel: ChannelSection, table: SourceTable, index: int, values: FloatArray, place: str, notes: list[str]
) -> FloatArray:
    """Values whose range does not begin again."""
    name = table.names[index] or str(index + 1)
    if channel.sign_bit:
        return signed_values(values, channel.sign_bit)
    if channel.wrap is not None:
        return unwrapped(values, channel.wrap) if channel.wrap > 0.0 else values
    # Before ranges that begin again: both jump, and a sign turns half of the values.
    bits = sign_bit(values) if channel.sign_bit is None else 0
    if bits:
        raise BenchError(
            f"{place}: column {name} jumps by {2.0**bits:.0f} where it changes its sign, as numbers of a sign and "
            f"{bits} bits do; say 'sign_bit: {bits}', or 'sign_bit: 0' if they are meant so."
        )
    turn = _WHOLE_TURNS.get(plain_unit(channel.unit)) if "scale" not in channel.model_fields_set else None
    found = None if turn is None else wrap_of(values, (turn,))
    if found is not None:
        notes.append(
            f"Column {name} jumps by {found.period:.6g} at {found.jumps} places (first at {table.place(found.first)}), "
            "a whole turn; it was read as going on ('wrap: 0' takes it as it is)."
        )
        return unwrapped(values, found.period)
    found = wrap_of_counts(values)
    if found is not None:
        raise BenchError(
            f"{place}: column {name} jumps by {found.period:.0f} at {found.jumps} places (first at "
            f"{table.place(found.first)}): numbers with a sign that were written without it, or a counter that runs "
            f"over. Say 'wrap: {found.period:.0f}' (it then goes on about zero), or 'wrap: 0' if it jumps so."
        )
    return values


def wrap_of_counts(values: FloatArray) -> Wrap | None:
    """As :func:`wrap_of`, of whole numbers that begin again after a power of two."""
    finite = values[np.isfinite(values)]
    whole = bool(finite.size) and np.array_equal(finite, np.round(finite))
    return wrap_of(values, [2.0**bits for bits in _COUNT_BITS]) if whole else None


def sign_bit(values: FloatArray) -> int:
    """Bits below the sign of whole numbers that were written as sign and magnitude; 0 where they were not.

    Args:
        values: a column; NaN where it has none.
    """
    finite = values[np.isfinite(values)]
    if not finite.size or not np.array_equal(finite, np.round(finite)):
        return 0
    if finite.size < _FEWEST_VALUES or finite.min() < 0.0:
        return 0
    for bits in _SIGN_BITS:
        high = finite >= 2.0**bits
        if finite.max() >= 2.0 ** (bits + 1) or not _FEWEST_SIGNS < float(high.mean()) < 1.0 - _FEWEST_SIGNS:
            continue
        signed = np.where(high, 2.0**bits - finite, finite)
        changes = np.flatnonzero(np.diff(high.astype(np.int8)))
        if changes.size < 2:
            continue
        # Where the sign changes both numbers are small, and so is the step: as everywhere, once the sign is right.
        steps, jumps = np.abs(np.diff(signed)), np.abs(np.diff(finite))
        if float(np.quantile(steps[changes], 0.9)) <= 4.0 * max(float(np.quantile(steps, 0.95)), 1.0) and float(
            np.median(steps[changes])
        ) < 0.5 * float(np.median(jumps[changes])):
            return bits
    return 0


def signed_values(values: FloatArray, bit: int) -> FloatArray:
    """Numbers of sign and magnitude with their sign, shape (rows,).

    Args:
        values: a column; NaN where it has none.
        bit: of the sign.
    """
    return np.where(values >= 2.0**bit, 2.0**bit - values, values)


def _held_and_clipped(name: str, values: FloatArray, table: SourceTable) -> list[str]:
    values = table.recorded(values)
    held = held_samples(values)
    if held > 1.0:
        return [
            f"Column {name} keeps each value for {held:.3g} samples: it was measured that much more slowly and held, "
            f"so it is late by {0.5 * (held - 1.0):.3g} samples on the whole ('delay_s' takes a delay out)."
        ]
    count, longest = flat_top(values)
    if count:
        return [
            f"Column {name} stands at its largest or smallest value for {count} samples, up to {longest} in a row: the "
            "sensor or its range ends there, and what lies beyond was not recorded."
        ]
    return []


def check_zeros(
    channels: Sequence[ImportedChannel], spans: Sequence[tuple[int, int]], places: Sequence[str]
) -> list[str]:
    """Forces and accelerations whose zero steps while nothing else does.

    Args:
        channels: all of them.
        spans: first sample and sample after the last one of each segment.
        places: of the channels in the sidecar, for messages.

    Returns:
        Sentences on steps that no segment holds, or that the sidecar keeps.

    Raises:
        BenchError: a segment holds such a step.
    """
    steps = [zero_step(channel.data) for channel in channels]
    notes = []
    for channel, step, place in zip(channels, steps, places, strict=True):
        if step is None or channel.quantity not in (Quantity.FORCE, Quantity.ACCELERATION):
            continue
        near = channel.data.size // _PIECES * 2
        if sum(other is not None and abs(other[0] - step[0]) <= near for other in steps) > 1:
            continue  # a load that others feel, too
        what = (
            f"the zero of column {channel.source} steps by {step[1]:.3g} {channel.quantity.unit} near sample "
            f"{step[0]}, and no other channel does: was it tared or reset there?"
        )
        if channel.section.zero_step is None and any(first < step[0] < stop for first, stop in spans):
            raise BenchError(
                f"{place}: {what} Give a segment on either side of it, or say 'zero_step: keep' if the load did so."
            )
        notes.append(f"{what[0].upper()}{what[1:]} A window should lie on one side.")
    return notes


_AXIS = re.compile(r"(.*?)([ ._]?)([xyz])$", re.I)
_GRAVITY = {
    "m/s^2": ((1.0, "g"), (1000.0, "mg"), (100.0 * STANDARD_GRAVITY, "cm/s^2")),
    "g": ((STANDARD_GRAVITY, "m/s^2"), (1000.0, "mg")),
}
_GRAVITY_SPREAD = 0.04


def _check_gravity(
    channels: Sequence[ChannelSection], indices: Sequence[int], table: SourceTable, places: Sequence[str]
) -> None:
    """What an accelerometer that feels gravity reads at rest tells its unit."""
    for channel, index, place in zip(channels, indices, places, strict=True):
        unit = plain_unit(channel.unit)
        if channel.quantity != "acceleration" or unit not in _GRAVITY or "scale" in channel.model_fields_set:
            continue
        if table.scalings[index].has_scale:
            continue
        at_rest, axes = _at_rest(table, index)
        for value, other in _GRAVITY[unit]:
            if abs(at_rest / value - 1.0) < _GRAVITY_SPREAD:
                usual = STANDARD_GRAVITY if unit == "m/s^2" else 1.0
                raise BenchError(
                    f"{place}: {axes} {at_rest:.4g} on the whole, and gravity is {usual:.3g} {unit}: is it in {other}? "
                    f"Say 'scale: {usual / value:.9g}', or 'scale: 1' if it is in {unit}."
                )


def _at_rest(table: SourceTable, index: int) -> tuple[float, str]:
    """Size of the mean of a sensor's axes, and words for it; NaN where the mean does not stand still."""
    name = split_name(table.names[index])[0]
    found = _AXIS.fullmatch(name)
    group = [index]
    if found is not None:
        bare = [split_name(other)[0] for other in table.names]
        names = [f"{found[1]}{found[2]}{axis}" for axis in ("xyz" if found[3].islower() else "XYZ")]
        group = [bare.index(other) for other in names if bare.count(other) == 1]
    size = spread = 0.0
    for member in group:
        values = table.recorded(table.columns[member])
        pieces = [piece[np.isfinite(piece)] for piece in np.array_split(values, 8)]
        if not all(piece.size for piece in pieces):
            return math.nan, ""
        means = [float(piece.mean()) for piece in pieces]
        size, spread = size + float(np.mean(means)) ** 2, spread + float(np.var(means))
    size = math.sqrt(size)
    finite = table.columns[index][np.isfinite(table.columns[index])]
    if not np.ptp(finite) > 0.0:
        return math.nan, ""  # a sensor that is off
    if math.sqrt(spread) > 0.1 * size:
        return math.nan, ""
    others = f"column {name} and its other axes read" if len(group) > 1 else f"column {name} reads"
    return size, others
