"""Lines of spectra: of consecutive pieces of signals, and the strongest one by frequency and amplitude."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray


def piece_spectra(
    signals: Sequence[FloatArray], sample_rate: float, pieces: int
) -> tuple[FloatArray, list[ComplexArray]] | None:
    """Hann-windowed spectra of consecutive pieces of simultaneous signals.

    Args:
        signals: shape ``(samples,)`` each.
        sample_rate: Hz.
        pieces: into which the signals are cut.

    Returns:
        Frequencies from the first line on, Hz, and the spectra of each signal, shape ``(pieces, lines)``; None if
        samples are missing or too few.
    """
    stacked = np.array(signals)
    size = stacked.shape[1] // pieces
    if size < 16 or not np.isfinite(stacked).all():
        return None
    cut = stacked[:, : size * pieces].reshape(len(signals), pieces, size)
    cut = (cut - cut.mean(axis=2, keepdims=True)) * np.hanning(size)
    lines = np.asarray(np.fft.rfftfreq(size, 1.0 / sample_rate)[1:], dtype=np.float64)
    return lines, list(np.fft.rfft(cut, axis=2)[:, :, 1:])


def line_amplitude(signal: FloatArray, sample_rate: float) -> tuple[float, float] | None:
    """Frequency (Hz, of the nearest line) and amplitude of the strongest line; None if samples are missing or too few.

    Args:
        signal: shape ``(samples,)``.
        sample_rate: Hz.
    """
    found = piece_spectra([signal], sample_rate, 1)
    if found is None:
        return None
    frequency, (spectrum,) = found
    line = int(np.argmax(np.abs(spectrum[0])))
    # Sum over the main lobe of the Hann window, so that the frequency between lines does not matter.
    lobe = np.abs(spectrum[0][max(0, line - 3) : line + 4])
    return float(frequency[line]), float(np.sqrt((lobe**2).sum() / 1.5) * 4.0 / signal.shape[0])


def strongest_line(signal: FloatArray, sample_rate: float) -> float:
    """Frequency of the strongest line of the spectrum, between the lines by a parabola, Hz.

    Args:
        signal: shape ``(samples,)``.
        sample_rate: Hz.
    """
    spectrum = np.abs(np.fft.rfft((signal - signal.mean()) * np.hanning(signal.shape[0])))
    peak = int(np.argmax(spectrum[1:])) + 1
    if 0 < peak < spectrum.shape[0] - 1:
        left, middle, right = spectrum[peak - 1 : peak + 2]
        curvature = left - 2.0 * middle + right
        if curvature < 0.0:
            return float((peak + 0.5 * (left - right) / curvature) * sample_rate / signal.shape[0])
    return float(peak * sample_rate / signal.shape[0])


def common_line(signals: Sequence[FloatArray], sample_rate: float) -> float:
    """Frequency of the strongest line that channels have in common, between the lines by a parabola of ln power, Hz.

    Args:
        signals: of all channels, shape ``(samples,)`` each.
        sample_rate: Hz.

    Returns:
        The frequency; 0 where no line stands within the spectrum.
    """
    total: FloatArray = np.zeros(signals[0].size // 2 + 1)
    for signal in signals:
        centred = signal - signal.mean()
        power = float(centred @ centred)
        if power > 0.0:
            total += np.abs(np.fft.rfft(centred * np.hanning(signal.size))) ** 2 / power
    line = int(np.argmax(total))
    if not 0 < line < total.size - 1 or not total[line] > 0.0:
        return 0.0
    left, middle, right = np.log(total[line - 1 : line + 2] + 1e-300)
    shift = 0.5 * (left - right) / (left - 2.0 * middle + right) if left - 2.0 * middle + right < 0.0 else 0.0
    return float((line + shift) * sample_rate / signals[0].size)
