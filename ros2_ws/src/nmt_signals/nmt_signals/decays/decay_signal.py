"""One mode of a free decay as a slowly varying complex amplitude on its own phase, whatever its frequency does.

The frequency is found in the data: the strongest ridge of short spectra gives a first phase. On that phase the samples
are demodulated with a B-spline of the fourth order, four boxcars of whole periods convolved (Unser 1999). Its transfer
function sinc⁴ has zeros of fourth order at every harmonic, at the offset and at the negative frequency, and because it
is counted in periods the band follows a frequency that changes by a factor of two. The phase that is left over corrects
the first one, twice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter, stft

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS, Quantity
from nmt_signals.thresholds import DECAYS

# Boxcars that are folded to the window: side lobes fall with the fourth power.
_WINDOW_BOXCARS = 4
# Frames without overlap into which a decay is cut.
_MOST_FRAMES = 256
# Bins on either side of a peak that belong to it: the window's main lobe.
_HALF_WIDTH_BINS = 2
# Lower bins are the mean and its leakage.
_LOWEST_BIN = 3
# Ridges that are followed.
_MOST_RIDGES = 3
# Passes between phase and demodulated signal.
_PASSES = 3
# Values of the filter that smooths the frequency between passes.
_SMOOTHED_VALUES = 5
# Values of a slow signal that are kept.
_MOST_VALUES = 3000


@dataclass(frozen=True)
class Ridge:
    """Frequency over time of one mode in short spectra.

    Attributes:
        time_s: middles of the frames, s, shape (frames,).
        frequency_hz: shape (frames,).
        energy: of velocity, in each frame, arbitrary unit, shape (frames,).
        clear: whether the mode stands out of its surroundings in the frame, shape (frames,).
    """

    time_s: FloatArray
    frequency_hz: FloatArray
    energy: FloatArray
    clear: NDArray[np.bool_]

    @property
    def late_hz(self) -> float:
        """Frequency of the last part that stands out: where the amplitude is lowest, Hz."""
        strong = np.flatnonzero(self.clear)
        late = strong[strong >= strong[-1] - max(2, strong.size // 5)]
        return float(np.median(self.frequency_hz[late]))


def ridges(samples: FloatArray, sample_rate: float, quantity: Quantity) -> list[Ridge]:
    """The strongest ridges of the short spectra of a decay, strongest first.

    Spectra are taken as those of a velocity, so that neither the drift of a displacement nor the ringing in an
    acceleration counts for more than the energy of its motion. Frames are as long as concentrates the power most, by
    the sum of its squares (Jones and Parks 1990).

    Args:
        samples: without mean, shape (n,).
        sample_rate: Hz.
        quantity: displacement, velocity or acceleration.

    Raises:
        BenchError: fewer samples than a frame.
    """
    if samples.size < 2 * DECAYS.frame_fewest_samples:
        raise BenchError(f"{samples.size} samples are too few; {2 * DECAYS.frame_fewest_samples} are needed")
    best: tuple[FloatArray, FloatArray, FloatArray] | None = None
    most = -1.0
    size = max(DECAYS.frame_fewest_samples, 2 ** int(math.log2(samples.size / _MOST_FRAMES)))
    while size <= max(DECAYS.frame_fewest_samples, min(samples.size // 4, 2**14)):
        frequency, time, power = _power(samples, sample_rate, quantity, size)
        total = float(np.sum(power))
        # The lowest lines hold no ridge, but their power is missing in the others.
        power[:_LOWEST_BIN] = 0.0
        concentration = float(np.sum(power**2)) / max(total**2, 1e-300)
        if concentration > most:
            best, most = (frequency, time, power), concentration
        size *= 2
    return [] if best is None else _ridges_of(*best)


def _power(
    samples: FloatArray, sample_rate: float, quantity: Quantity, size: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Frequencies, middles of frames of one length, and power of the velocity, shape (lines, frames)."""
    frequency, time, spectrum = stft(
        samples, sample_rate, nperseg=size, noverlap=size - size // 4, boundary=None, padded=False
    )
    orders = 1 - MOTIONS.get(quantity, 1)
    power = np.abs(spectrum) ** 2
    power[0] = 0.0
    power[1:] *= frequency[1:, np.newaxis] ** (2 * orders)
    return frequency, time, power


def _ridges_of(frequency: FloatArray, time: FloatArray, power: FloatArray) -> list[Ridge]:
    """The strongest ridges, strongest first."""
    found: list[Ridge] = []
    remaining_power = power.copy()
    for _ in range(_MOST_RIDGES):
        if not remaining_power.max() > 0.0:
            break
        found.append(_followed(remaining_power, power, frequency, time))
    found.sort(key=lambda ridge: -float(ridge.energy.sum()))
    return [ridge for ridge in found if ridge.energy.sum() > DECAYS.other_ridge_share * found[0].energy.sum()]


def _followed(remaining_power: FloatArray, power: FloatArray, frequency: FloatArray, time: FloatArray) -> Ridge:
    """The ridge through the highest peak of ``remaining_power``, followed both ways and taken out of it."""
    step = float(frequency[1])
    top, anchor = np.unravel_index(int(np.argmax(remaining_power)), remaining_power.shape)
    bins = np.zeros(time.size, dtype=np.int64)
    bins[anchor] = top
    for way in (range(int(anchor) + 1, time.size), range(int(anchor) - 1, -1, -1)):
        last = int(top)
        for frame in way:
            low = max(_LOWEST_BIN, math.floor(last * (1.0 - DECAYS.ridge_log_change)) - 1)
            high = min(frequency.size, math.ceil(last * (1.0 + DECAYS.ridge_log_change)) + 2)
            peak = low + int(np.argmax(remaining_power[low:high, frame]))
            # In noise it stays where it was, and so it does where another ridge has gone.
            last = peak if remaining_power[peak, frame] > 0.0 and _clear(power[:, frame], peak) else last
            bins[frame] = last
    hertz, energy = np.zeros(time.size), np.zeros(time.size)
    clear = np.array(
        [
            remaining_power[middle, frame] > 0.0 and _clear(power[:, frame], int(middle))
            for frame, middle in enumerate(bins)
        ]
    )
    clear[anchor] = True
    for frame, middle in enumerate(bins):
        near = slice(
            max(1, middle - _HALF_WIDTH_BINS),
            min(frequency.size, middle + _HALF_WIDTH_BINS + 1),
        )
        peak_power = remaining_power[near, frame].copy()
        energy[frame] = peak_power.sum()
        hertz[frame] = (
            float(frequency[near] @ peak_power / peak_power.sum()) if peak_power.sum() > 0.0 else middle * step
        )
        reach = max(_HALF_WIDTH_BINS, math.ceil(DECAYS.ridge_log_change * middle))
        remaining_power[max(0, middle - reach) : middle + reach + 1, frame] = 0.0
    return Ridge(time, hertz, energy, clear)


def _clear(power: FloatArray, middle: int) -> bool:
    """Whether a peak of a frame's spectrum stands out of its surroundings."""
    low, high = max(1, middle // 2), min(power.size, 2 * middle + 1)
    around = np.concatenate(
        (
            power[low : max(low, middle - _HALF_WIDTH_BINS)],
            power[middle + _HALF_WIDTH_BINS + 1 : high],
        )
    )
    return bool(around.size and power[middle] > DECAYS.ridge_peak_ratio * np.median(around))


@dataclass(frozen=True)
class SlowAmplitude:
    """Complex amplitude of one mode on its own phase, period by period.

    Attributes:
        cycles: phase of every sample, cycles, shape (n,).
        width: periods of each boxcar of the window.
        time_s: of each middle from the first sample, s, shape (k,).
        values: fundamental amplitude in the channel's unit; its argument is the residual phase, shape (k,).
        stride: periods from one value to the next; more than one in a very long decay.
    """

    cycles: FloatArray
    width: int
    time_s: FloatArray
    values: ComplexArray
    stride: int = 1

    @property
    def phase(self) -> FloatArray:
        """Phase of the vibration, rad, shape (k,)."""
        return np.asarray(2.0 * math.pi * self._middles + np.unwrap(np.angle(self.values)))

    @property
    def log(self) -> FloatArray:
        """ln of the amplitude, shape (k,)."""
        return np.asarray(np.log(np.maximum(np.abs(self.values), 1e-300)))

    @property
    def _middles(self) -> FloatArray:
        return middles(self.cycles, self.width)[:: self.stride]


def middles(cycles: FloatArray, width: int) -> FloatArray:
    """Phases, one a period, around which the whole window lies within the samples, cycles, shape (k,)."""
    half = 0.5 * _WINDOW_BOXCARS * width
    count = math.floor(cycles[-1] - cycles[0] - 2.0 * half) + 1
    return np.asarray(cycles[0] + half + np.arange(max(0, count)))


def window(offset: FloatArray, width: int) -> FloatArray:
    """B-spline of four boxcars of ``width`` periods, of unit area over the phase in cycles; same shape as offset."""
    u = np.abs(offset) / width
    inner = 2.0 / 3.0 - u**2 + 0.5 * u**3
    outer = np.clip(2.0 - u, 0.0, None) ** 3 / 6.0
    return np.asarray(np.where(u < 1.0, inner, outer) / width)


def demodulated(samples: FloatArray, cycles: FloatArray, width: int) -> ComplexArray:
    """Complex amplitude of the fundamental at :func:`middles`, shape (k,).

    Args:
        samples: shape (n,).
        cycles: phase of each sample, cycles, ascending, shape (n,).
        width: periods of each boxcar of the window.
    """
    share = np.gradient(cycles)
    turned = 2.0 * samples * np.exp(-2j * math.pi * cycles) * share
    at = middles(cycles, width)
    half = 0.5 * _WINDOW_BOXCARS * width
    first = np.searchsorted(cycles, at - half)
    stop = np.searchsorted(cycles, at + half, side="right")
    result = np.empty(at.size, dtype=np.complex128)
    for k, (low, high, middle) in enumerate(zip(first, stop, at, strict=True)):
        weights = window(cycles[low:high] - middle, width)
        # Divided by the weights' own sum: with few samples a period it is not quite one.
        result[k] = turned[low:high] @ weights / (weights @ share[low:high])
    return result


def slow_amplitude(samples: FloatArray, sample_rate: float, ridge: Ridge, width: int) -> SlowAmplitude:
    """Demodulate a decay on the phase of one ridge, which is corrected by the residual.

    Args:
        samples: without mean, shape (n,).
        sample_rate: Hz.
        ridge: first estimate of its frequency.
        width: periods of each boxcar of the window: one passes a band from half to three halves of the frequency (at
            half of the amplitude), two half of it.

    Raises:
        BenchError: too few periods, or too few samples a period.
    """
    time = np.arange(samples.size) / sample_rate
    hertz = np.interp(time, ridge.time_s, _steadied(ridge))
    per_period = sample_rate / float(np.max(hertz))
    if per_period < DECAYS.fewest_samples_per_period:
        raise BenchError(
            f"at {float(np.max(hertz)):.4g} Hz there are {per_period:.2g} samples a period; "
            f"{DECAYS.fewest_samples_per_period:g} are needed"
        )
    cycles = np.concatenate(([0.0], np.cumsum(0.5 * (hertz[1:] + hertz[:-1])))) / sample_rate
    if cycles[-1] < DECAYS.fewest_periods:
        raise BenchError(f"{cycles[-1]:.3g} periods of decay are too few; {DECAYS.fewest_periods} are needed")
    for number in range(_PASSES):
        at = middles(cycles, width)
        if not at.size:
            raise BenchError(f"{cycles[-1]:.3g} periods of decay are too few for a window of {_WINDOW_BOXCARS * width}")
        values = demodulated(samples, cycles, width)
        if number + 1 == _PASSES or values.size < DECAYS.fewest_periods // 2:
            break
        moved = _moved(cycles, at, values)
        if moved is None:
            break
        cycles = moved
    stride = -(-values.size // _MOST_VALUES)
    return SlowAmplitude(cycles, width, np.interp(at, cycles, time)[::stride], values[::stride], stride)


def _steadied(ridge: Ridge) -> FloatArray:
    """Frequencies of a ridge; where it does not stand out, that of the nearest frame that does."""
    strong = np.flatnonzero(ridge.clear)
    return np.asarray(np.interp(np.arange(ridge.time_s.size), strong, ridge.frequency_hz[strong]))


def _moved(cycles: FloatArray, at: FloatArray, values: ComplexArray) -> FloatArray | None:
    """The phase with its residual, as far as the decay stands out; None where time would run backwards."""
    size = np.abs(values)
    noise = float(np.median(size[-max(3, size.size // 20) :]))
    strong = np.flatnonzero(size > min(3.0 * noise, 1e-2 * size.max()))
    left = np.unwrap(np.angle(values[strong])) / (2.0 * math.pi)
    if strong.size > _SMOOTHED_VALUES:
        left = savgol_filter(left, _SMOOTHED_VALUES, 2)
    phase = at[strong] + left
    new = np.interp(cycles, at[strong], phase)
    if strong.size > 2:
        for outside, pick in ((cycles < at[strong[0]], slice(0, 3)), (cycles > at[strong[-1]], slice(-3, None))):
            slope = float(np.ptp(phase[pick]) / np.ptp(at[strong][pick]))
            end = 0 if pick.start == 0 else -1
            new[outside] = phase[end] + slope * (cycles[outside] - at[strong[end]])
    return np.asarray(new - new[0]) if bool((np.diff(new) > 0.0).all()) else None
