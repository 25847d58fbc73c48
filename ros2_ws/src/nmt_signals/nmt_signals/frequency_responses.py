"""Averaged frequency response functions: H1, H2, Hv, coherence, and the estimate by way of the drive voltage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_signals.thresholds import SIGNAL_FITS

_DEPENDENT = 1e6  # condition of the inputs' normalised spectra from which they are one
_ROUNDING = 1e-12  # of a response's power
_NOT_INDEPENDENT = "The inputs are not independent of each other; drive every exciter with a noise of its own."


@dataclass(frozen=True, eq=False)
class AveragedSpectra:
    """Averaged auto and cross spectra of several channels.

    Attributes:
        frequency_hz: lines, Hz, shape ``(lines,)``.
        channels: channel names, in the order of the matrix.
        matrix: S_ij = mean of X_i conj(X_j), units² (any common scale), shape ``(channels, channels, lines)``.
        averages: number of segments.
        independent_averages: number of segments without overlap of the same statistical weight.
        segment_samples: samples a segment.
    """

    frequency_hz: FloatArray
    channels: tuple[str, ...]
    matrix: ComplexArray
    averages: int
    independent_averages: float
    segment_samples: int

    def cross(self, row: str, column: str) -> ComplexArray:
        """S of two channels, shape ``(lines,)``."""
        return np.asarray(self.matrix[self.channels.index(row), self.channels.index(column)])

    def without(self, inputs: Sequence[str], instruments: Sequence[str]) -> AveragedSpectra:
        """Spectra conditioned on the other inputs, as least squares over the instruments find it.

        With the inputs as their own instruments these are the partial spectra of Bendat and Piersol, and their H1 of
        one more input is that of S_xf S_ff⁻¹ of all inputs at once. With the voltages as instruments it is that of
        S_xu S_fu⁻¹, free of the bias by noise of the inputs.

        Args:
            inputs: channels to take out.
            instruments: as many channels; what is found is uncorrelated with them.

        Raises:
            BenchError: the inputs are not independent of each other at a line.
        """
        rows = [self.channels.index(name) for name in inputs]
        columns = [self.channels.index(name) for name in instruments]
        taken = self.matrix[rows].transpose(2, 0, 1)
        pivot = taken[:, :, columns]
        scale = np.sqrt(
            np.einsum("ii...->...i", self.matrix).real[:, rows, None]
            * np.einsum("ii...->...i", self.matrix).real[:, None, columns]
        )
        if rows and not np.linalg.cond(pivot / scale).max() < _DEPENDENT:
            raise BenchError(_NOT_INDEPENDENT)
        explained = self.matrix[:, columns].transpose(2, 0, 1) @ np.linalg.solve(pivot, taken)
        return replace(self, matrix=self.matrix - explained.transpose(1, 2, 0))


@dataclass(frozen=True, eq=False)
class FrfEstimate:
    """Frequency responses of one input to several outputs, other inputs at zero.

    Attributes:
        frequency_hz: lines, Hz, shape ``(lines,)``.
        input: name of the input channel.
        outputs: names of the output channels.
        h1: S_xf / S_ff: biased low by noise of the input. Output unit over input unit, shape ``(outputs, lines)``.
        h2: S_xx / S_fx: biased high by noise of the output.
        hv: total least squares with both signals scaled to equal power: between the two.
        hc: S_xu / S_fu by way of the drive voltage u, free of the bias by noise of either signal; None without voltage.
        coherence: γ² of input and output, shape ``(outputs, lines)``.
        independent_averages: see :class:`AveragedSpectra`.
    """

    frequency_hz: FloatArray
    input: str
    outputs: tuple[str, ...]
    h1: ComplexArray
    h2: ComplexArray
    hv: ComplexArray
    hc: ComplexArray | None
    coherence: FloatArray
    independent_averages: float

    @property
    def best(self) -> ComplexArray:
        """The estimate least biased by noise: by way of the voltage if there is one, else H1."""
        return self.h1 if self.hc is None else self.hc


def averaged_spectra(
    signals: Mapping[str, FloatArray],
    sample_rate: float,
    segment_samples: int,
    band_hz: tuple[float, float] | None = None,
    overlap: float = 2.0 / 3.0,
) -> AveragedSpectra:
    """Welch's average over Hann-windowed segments.

    The window widens resonances that are narrower than a few lines; damping is therefore never read from these
    spectra but from the fit of the whole record (see :mod:`nmt_signals.rational_fit`).

    Args:
        signals: samples by channel, all of one length.
        sample_rate: Hz.
        segment_samples: samples a segment.
        band_hz: lines to keep; None = all.
        overlap: of neighbouring segments, 0 to below 1.

    Raises:
        BenchError: the record is shorter than a few segments.
    """
    names = tuple(signals)
    length = min(len(signals[name]) for name in names)
    step = max(1, round(segment_samples * (1.0 - overlap)))
    averages = 1 + (length - segment_samples) // step if length >= segment_samples else 0
    if averages < SIGNAL_FITS.fewest_averages:
        raise BenchError(
            f"The record of {length / sample_rate:.3g} s holds {averages} segments of "
            f"{segment_samples / sample_rate:.3g} s; at least {SIGNAL_FITS.fewest_averages} are needed: record longer."
        )
    window = _hann(segment_samples)
    frequency = np.fft.rfftfreq(segment_samples, 1.0 / sample_rate)
    low, high = band_hz if band_hz is not None else (0.0, np.inf)
    lines = np.flatnonzero((frequency >= low) & (frequency <= high))
    total = np.zeros((len(names), len(names), lines.size), dtype=np.complex128)
    for number in range(averages):
        part = slice(number * step, number * step + segment_samples)
        spectra = np.empty((len(names), lines.size), dtype=np.complex128)
        for row, name in enumerate(names):
            spectra[row] = _spectrum(signals[name][part], window)[lines]
        total += spectra[:, np.newaxis] * spectra[np.newaxis].conj()
    return AveragedSpectra(
        np.asarray(frequency[lines], dtype=np.float64),
        names,
        total / averages,
        averages,
        _independent(window, step, averages),
        segment_samples,
    )


def _hann(samples: int) -> FloatArray:
    """Periodic Hann window."""
    return np.hanning(samples + 1)[:-1]


def _spectrum(values: FloatArray, window: FloatArray) -> ComplexArray:
    """Spectrum of one segment without its mean."""
    return np.asarray(np.fft.rfft(window * (values - values.mean())))


def _independent(window: FloatArray, step: int, averages: int) -> float:
    """Averages that count: overlapping segments share data (Welch 1967)."""
    power = float(np.sum(window**2))
    shared = 0.0
    for lag in range(1, averages):
        offset = lag * step
        if offset >= window.size:
            break
        rho = float(np.sum(window[offset:] * window[: window.size - offset])) / power
        shared += 2.0 * (1.0 - lag / averages) * rho**2
    return averages / (1.0 + shared)


def frf_estimate(
    spectra: AveragedSpectra,
    input_channel: str,
    outputs: tuple[str, ...],
    voltage: str | None = None,
    others: Sequence[str] = (),
    other_voltages: Sequence[str] = (),
) -> FrfEstimate:
    """Frequency responses from averaged spectra.

    Args:
        spectra: of all channels named here.
        input_channel: name of the input.
        outputs: names of the outputs.
        voltage: name of the drive voltage, for ``hc``.
        others: further inputs that act at the same time; coherence and estimates are then the partial ones.
        other_voltages: their drive voltages, for ``hc``.

    Raises:
        BenchError: the input or an output vanishes at a line, or the inputs are not independent.
    """
    by_voltage = spectra.without(others, other_voltages) if voltage is not None else spectra
    partial = spectra.without(others, others)
    force = partial.cross(input_channel, input_channel).real
    if others and not np.all(force * _DEPENDENT > spectra.cross(input_channel, input_channel).real):
        raise BenchError(_NOT_INDEPENDENT)
    shape = (len(outputs), force.size)
    h1, h2, hv, hc = (np.empty(shape, dtype=np.complex128) for _ in range(4))
    coherence = np.empty(shape)
    for row, output in enumerate(outputs):
        cross = partial.cross(output, input_channel)
        power = spectra.cross(output, output).real
        # What the other inputs explain to the last digit leaves rounding alone.
        response = np.maximum(partial.cross(output, output).real, _ROUNDING * power)
        if not (
            np.all(force > 0.0) and np.all(power > 0.0) and np.all(np.abs(spectra.cross(output, input_channel)) > 0.0)
        ):
            raise BenchError(
                f"Channel {input_channel} or {output} is zero within the band; check the sensor and the drive."
            )
        h1[row] = cross / force
        coherence[row] = np.minimum(np.abs(cross) ** 2 / (force * response), 1.0)
        with np.errstate(divide="ignore", invalid="ignore"):  # of several inputs one may not reach an output
            h2[row] = response / cross.conj()
            # Smallest eigenvector of the spectral matrix of signals of equal power: |Hv| = sqrt(|H1| |H2|).
            hv[row] = np.sqrt(response / force) * cross / np.abs(cross)
        if voltage is not None:
            hc[row] = by_voltage.cross(output, voltage) / by_voltage.cross(input_channel, voltage)
    return FrfEstimate(
        spectra.frequency_hz,
        input_channel,
        outputs,
        h1,
        h2,
        hv,
        hc if voltage is not None else None,
        coherence,
        spectra.independent_averages,
    )


@dataclass
class RunningFrf:
    """Averaged response of one channel to another while samples come: H1 and coherence, as of :func:`averaged_spectra`.

    Hann windows, half overlapping. A gap leaves the segment out that it falls into.

    Attributes:
        segment: samples a segment.
        sample_rate: Hz.
        averages: segments so far.
    """

    segment: int
    sample_rate: float
    averages: int = 0

    def __post_init__(self) -> None:
        self._window = _hann(self.segment)
        self._input = np.zeros((0,))
        self._output = np.zeros((0,))
        self._end = -1
        lines = self.segment // 2 + 1
        self._sii, self._soo = np.zeros(lines), np.zeros(lines)
        self._soi = np.zeros(lines, dtype=np.complex128)

    def add(self, first_sample: int, input_: FloatArray, output: FloatArray) -> None:
        """Take simultaneous samples of both channels."""
        if first_sample != self._end:
            self._input, self._output = np.zeros((0,)), np.zeros((0,))
        self._end = first_sample + input_.size
        self._input, self._output = np.append(self._input, input_), np.append(self._output, output)
        while self._input.size >= self.segment:
            fa, fb = (_spectrum(part[: self.segment], self._window) for part in (self._input, self._output))
            self._sii += np.abs(fa) ** 2
            self._soo += np.abs(fb) ** 2
            self._soi += fb * fa.conj()
            self.averages += 1
            step = self.segment // 2
            self._input, self._output = self._input[step:], self._output[step:]

    def estimate(self, low_hz: float, high_hz: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Frequency (Hz), magnitude of H1 and coherence within a band; empty before the second average."""
        frequency = np.fft.rfftfreq(self.segment, 1.0 / self.sample_rate).astype(np.float64)
        band = (frequency >= low_hz) & (frequency <= high_hz)
        if self.averages < 2:
            band[:] = False
        with np.errstate(divide="ignore", invalid="ignore"):
            magnitude = np.abs(self._soi[band]) / self._sii[band]
            coherence = np.abs(self._soi[band]) ** 2 / (self._sii[band] * self._soo[band])
        return frequency[band], magnitude, coherence
