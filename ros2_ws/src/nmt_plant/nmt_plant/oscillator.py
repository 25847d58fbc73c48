"""Phase-continuous oscillator of the drive, with half-cosine amplitude ramps.

The phase never jumps: a new frequency bends it at a block boundary. The drive is a sum of terms Re A_n exp(i n θ) for
SINE and SWEEP (:mod:`nmt_plant.drive_terms`), band-limited Gaussian noise for RANDOM. A term in V of order 1 turns the
fundamental: the drive of a feedback, whose size and phase follow the response.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.kinds import PEAK_FACTOR
from nmt_core.messages.blocks import OscillatorPhase
from nmt_core.messages.records import DriveCommand
from nmt_core.numerics.arrays import FloatArray
from nmt_core.numerics.kernels import njit
from nmt_core.numerics.ramp import half_cosine
from nmt_core.vocabulary import Waveform
from nmt_plant.drive_terms import DriveTerms

_LONGEST_RAMP = 86_400.0  # s
_MOST_TERMS = 400
_NARROWEST_BAND = 2e-5  # of the sample rate, for the lower edge and the width


@njit(cache=True)
def _cosine(
    voltage: FloatArray, cycles: float, step: float, bend: float, start: float, target: float, elapsed: int, length: int
) -> None:
    """voltage[k] = envelope(k) cos(2π (cycles + step k + bend k²)), half-cosine envelope of ``length`` samples."""
    for k in range(voltage.size):
        amplitude = target
        if elapsed + k < length:
            amplitude = start + (target - start) * (0.5 - 0.5 * np.cos(np.pi * (elapsed + k) / length))
        if amplitude == 0.0:
            voltage[k] = 0.0
        else:
            voltage[k] = amplitude * np.cos(2.0 * np.pi * (cycles + k * (step + bend * k)))


class Envelope:
    """A value that follows its target along half-cosines, sample by sample."""

    def __init__(self) -> None:
        self.target = 0.0
        self._start = 0.0
        self._elapsed = 0
        self._length = 0

    @property
    def value(self) -> float:
        """Value at the present sample."""
        if self._elapsed >= self._length:
            return self.target
        return float(self.values(1)[0])

    def aim(self, target: float, length: int) -> None:
        """Go to `target` within `length` samples from the present value, unless already on the way there.

        On the way to zero the shorter of two ramps counts, so that no long one keeps an emergency waiting.
        """
        shorter = target == 0.0 and self._length - self._elapsed > length
        if target != self.target or shorter:
            self._start, self._elapsed, self._length, self.target = self.value, 0, length, target

    def largest(self, samples: int) -> float:
        """Largest value from the present sample to the one `samples` later; a half-cosine has it at an end."""
        if self._elapsed >= self._length:
            return self.target
        share = min((self._elapsed + samples) / self._length, 1.0)
        end = self._start + (self.target - self._start) * (0.5 - 0.5 * math.cos(math.pi * share))
        return max(self.value, end)

    def reaches_target_in(self, samples: int) -> bool:
        """Whether it is at its target after so many samples or before, and was set off at the present one or rests."""
        return self._elapsed >= self._length or (self._elapsed == 0 and self._length == samples)

    def values(self, count: int) -> FloatArray:
        """Values at the present and the following samples, shape (count,)."""
        if self._elapsed >= self._length:
            return np.full(count, self.target)
        weight = half_cosine((self._elapsed + np.arange(count)) / self._length)
        result: FloatArray = self._start + (self.target - self._start) * weight
        result[self._elapsed + np.arange(count) >= self._length] = self.target
        return result

    def cosine(self, voltage: FloatArray, phase: OscillatorPhase, sample_rate: float) -> None:
        """Fill ``voltage`` (V) with the value times the cosine of the phase, from the present sample on."""
        step, bend = phase.frequency_hz / sample_rate, 0.5 * phase.rate_hz_s / sample_rate**2
        _cosine(voltage, phase.cycles, step, bend, self._start, self.target, self._elapsed, self._length)

    def advance(self, samples: int) -> None:
        """Move on by `samples`."""
        self._elapsed = min(self._elapsed + samples, self._length)

    def clear(self) -> None:
        """Zero at once."""
        self.target = 0.0
        self._start, self._elapsed, self._length = 0.0, 0, 0


def check_command(command: DriveCommand, sample_rate: float) -> None:
    """Refuse what an oscillator at this sample rate (Hz) cannot follow.

    Raises:
        BenchError: a frequency, harmonic or band beyond half the sample rate; a band too low or too narrow for its
            filter; a ramp of more than a day; more than 400 terms.
    """
    nyquist = 0.5 * sample_rate
    if command.waveform == Waveform.OFF:
        return
    if command.ramp > _LONGEST_RAMP:
        raise BenchError(
            f"the drive's ramp of {command.ramp:g} s is longer than a day; use {_LONGEST_RAMP:g} s at most."
        )
    if len(command.terms) > _MOST_TERMS:
        raise BenchError(f"the drive has {len(command.terms)} harmonics and other terms; use {_MOST_TERMS} at most.")
    if command.waveform == Waveform.RANDOM:
        highest = command.band_high_hz
        least = _NARROWEST_BAND * sample_rate
        if command.band_low_hz < least or command.band_high_hz - command.band_low_hz < least:
            raise BenchError(
                f"the random band {command.band_low_hz:g} to {command.band_high_hz:g} Hz must begin at {least:g} Hz or "
                f"above and be at least as wide, at a sample rate of {sample_rate:g} Hz."
            )
    else:
        highest = max(command.frequency_hz, command.frequency_end_hz)
        if command.terms:
            highest *= max(1, *(term.order for term in command.terms))
    if highest >= nyquist:
        raise BenchError(f"the drive reaches {highest:g} Hz; it must stay below half the sample rate, {nyquist:g} Hz.")


def load_filters() -> None:
    """Load what noise needs, which takes a second of processor time: before a run in real time, not in it."""
    import scipy.signal  # noqa: F401


@lru_cache(maxsize=16)
def _band_filter(low_hz: float, high_hz: float, sample_rate: float) -> tuple[FloatArray, float]:
    """Second-order sections of the band-pass, and the gain that gives unit variance."""
    from scipy.signal import butter, sosfreqz

    sections = butter(4, [low_hz, high_hz], "bandpass", fs=sample_rate, output="sos")
    _, response = sosfreqz(sections, worN=1 << 16)
    return sections, float(1.0 / np.sqrt(np.mean(np.abs(response) ** 2)))


class BandNoise:
    """Gaussian noise of unit variance between two frequencies, reproducible whatever the block length."""

    def __init__(self, low_hz: float, high_hz: float, sample_rate: float, generator: np.random.Generator) -> None:
        if not 0 < low_hz < high_hz < 0.5 * sample_rate:
            raise BenchError(
                f"the random band {low_hz} to {high_hz} Hz must lie between 0 and half the sample rate, "
                f"{0.5 * sample_rate} Hz."
            )
        self._generator = generator
        self._filter, self._gain = _band_filter(low_hz, high_hz, sample_rate)
        self._memory = np.zeros((self._filter.shape[0], 2))
        self._next = self._draw(1)

    def _draw(self, count: int) -> FloatArray:
        from scipy.signal import sosfilt

        values, self._memory = sosfilt(self._filter, self._generator.standard_normal(count), zi=self._memory)
        return np.asarray(self._gain * values, dtype=np.float64)

    def values(self, samples: int) -> FloatArray:
        """Noise at the `samples` of a block and the first of the next, shape (samples + 1,)."""
        result = np.concatenate([self._next, self._draw(samples)])
        self._next = result[-1:]
        return result


@dataclass(frozen=True, slots=True)
class OscillatorBlock:
    """Output over one block.

    Attributes:
        voltages: (exciters, samples + 1) V at the block's samples and at the first of the next block, for a
            first-order hold.
        phase: phase at the first sample.
    """

    voltages: FloatArray
    phase: OscillatorPhase

    @property
    def voltage(self) -> FloatArray:
        """Voltage (samples + 1,) of exciter 1, V."""
        return np.asarray(self.voltages[0])


class Oscillator:
    """Drive oscillator; a command takes effect when it is applied, i.e. at a block boundary.

    Args:
        sample_rate: Hz.
        seed: of the random waveform.
        exciters: number of exciters that it drives.
    """

    def __init__(self, sample_rate: float, seed: int = 0, exciters: int = 1) -> None:
        self.sample_rate = sample_rate
        self.exciters = exciters
        self._terms = DriveTerms(exciters)
        self._seed = seed
        self.cycles = 0.0
        self.frequency_hz = 0.0
        self._rate = 0.0
        self._frequency_end = 0.0
        self._waveform = Waveform.OFF
        self._amplitude = Envelope()
        self._volts_weight = Envelope()
        self._noise: tuple[BandNoise, ...] = ()
        self._band = (0.0, 0.0)

    @property
    def amplitude(self) -> float:
        """Present amplitude, V (peak, or rms of a random drive)."""
        return self._amplitude.value

    @property
    def is_quiet(self) -> bool:
        """Whether the output is zero and stays zero."""
        main, harmonics = self._amplitude, self._volts_weight
        return main.target == 0.0 == harmonics.target and main.value == 0.0 == harmonics.value

    @property
    def is_stopping(self) -> bool:
        """Whether the amplitude is zero or on its way there."""
        return self._amplitude.target == 0.0 == self._volts_weight.target

    @property
    def is_periodic(self) -> bool:
        """Whether the drive is a sine or a sweep."""
        return self._waveform in (Waveform.SINE, Waveform.SWEEP)

    @property
    def is_feedback(self) -> bool:
        """Whether the fundamental is turned: the drive follows the response, which then does not follow from it."""
        return self._terms.turns_fundamental

    def bound(self, samples: int) -> float:
        """Largest amplitude in the next `samples`, V: harmonics added up, `PEAK_FACTOR` times a random rms."""
        largest = self._amplitude.largest(samples)
        factor = PEAK_FACTOR if self._waveform == Waveform.RANDOM else 1.0
        if not self._terms:
            return factor * largest
        fundamental = None
        if self.is_feedback and self._amplitude.reaches_target_in(samples):
            # Both parts of the fundamental move along one half-cosine: it is largest at an end.
            before, after = self._terms.turning
            weight = self._volts_weight
            ends = self._amplitude.value + weight.value * before, self._amplitude.target + weight.target * after
            fundamental = max(map(abs, ends))
        return factor * self._terms.largest(largest, self._volts_weight.largest(samples), fundamental)

    def apply(self, command: DriveCommand) -> None:
        """Follow a command from the next block on.

        A change between a periodic and a random drive starts the new one from zero amplitude.

        Raises:
            BenchError: a frequency, harmonic or band beyond half the sample rate.
        """
        check_command(command, self.sample_rate)
        if command.waveform == Waveform.OFF:
            self.ramp_to_zero(command.ramp)
            return
        length = round(command.ramp * self.sample_rate)
        random = command.waveform == Waveform.RANDOM
        if random:
            band = (command.band_low_hz, command.band_high_hz)
            if not self._noise or band != self._band:
                self._noise = tuple(self._band_noise(band, row) for row in range(self.exciters))
                self._band = band
        if random != (self._waveform == Waveform.RANDOM) and self._waveform != Waveform.OFF:
            self._amplitude.clear()
            self._volts_weight.clear()
        if not random:
            self._noise = ()
            self.frequency_hz = command.frequency_hz
            self._rate = command.rate_hz_s if command.waveform == Waveform.SWEEP else 0.0
            self._frequency_end = command.frequency_end_hz
        self._waveform = command.waveform
        self._terms.aim(command.terms, self._amplitude.value == 0.0, self._volts_weight.value == 0.0)
        self._amplitude.aim(command.amplitude, length)
        self._volts_weight.aim(1.0 if self._terms.in_volts else 0.0, length)

    def _band_noise(self, band: tuple[float, float], row: int) -> BandNoise:
        """Noise of an exciter, counted from 0; it is the same whatever others there are."""
        seeds = np.random.SeedSequence([self._seed, 0x6472697665, *([row] if row else [])])
        return BandNoise(*band, self.sample_rate, np.random.Generator(np.random.PCG64(seeds)))

    def ramp_to_zero(self, ramp: float) -> None:
        """Half-cosine to zero within `ramp` seconds, or sooner if it is on its way; phase and frequency go on."""
        length = round(min(ramp, _LONGEST_RAMP) * self.sample_rate)
        self._amplitude.aim(0.0, length)
        self._volts_weight.aim(0.0, length)
        self._rate = 0.0

    def block(self, samples: int) -> OscillatorBlock:
        """Output over the next `samples`; the oscillator moves on by as many."""
        rate = self._rate
        duration = samples / self.sample_rate
        end = self.frequency_hz + rate * duration
        if rate != 0.0 and (end - self._frequency_end) * rate >= 0.0:
            # Land on the last frequency at the block's end: within a block the rate is constant.
            end = self._frequency_end
            rate = (end - self.frequency_hz) / duration
            self._rate = 0.0
        if self._waveform == Waveform.RANDOM:
            phase = OscillatorPhase(self.cycles, 0.0, 0.0)
            voltages = np.array([source.values(samples) for source in self._noise])
            sizes = np.zeros_like(voltages)
            sizes[0] = amplitude = self._amplitude.values(samples + 1)
            self._terms.add_to(sizes, np.zeros(samples + 1), amplitude, np.zeros(samples + 1))
            voltages *= sizes
        else:
            phase = OscillatorPhase(self.cycles, self.frequency_hz, rate)
            voltages = self._periodic(samples, phase)
            moved = self.cycles + duration * (self.frequency_hz + 0.5 * rate * duration)
            self.cycles = moved - math.floor(moved)
            self.frequency_hz = end
        self._amplitude.advance(samples)
        self._volts_weight.advance(samples)
        if self.is_quiet:
            self._waveform = Waveform.OFF
            self._terms.clear()
        return OscillatorBlock(voltages, phase)

    def _periodic(self, samples: int, phase: OscillatorPhase) -> FloatArray:
        """Voltages (exciters, samples + 1) of a sine or sweep; also of a drive at rest."""
        voltages = np.zeros((self.exciters, samples + 1))
        self._amplitude.cosine(voltages[0], phase, self.sample_rate)
        if self._terms:
            theta = phase.phase(samples + 1, self.sample_rate)
            amplitude, weight = self._amplitude.values(samples + 1), self._volts_weight.values(samples + 1)
            self._terms.add_to(voltages, theta, amplitude, weight)
        return voltages
