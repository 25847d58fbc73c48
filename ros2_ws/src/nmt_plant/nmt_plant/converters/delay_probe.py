"""Delay from a sample put out to the sample in which it is measured, found with a short low pseudo-random signal.

The signal is a maximum-length sequence, put out twice. Its circular autocorrelation is a peak on a flat ground, so that
the cross-correlation with what a loop measures shows the loop's impulse response, whatever filters lie on the way; the
largest value is the delay. Source: D. D. Rife, J. Vanderkooy, J. Audio Eng. Soc. 37 (1989) 419-444.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nmt_core.numerics.arrays import FloatArray

ORDER = 10
LEAST_PEAK = 8.0
"""Peak of the correlation over its root mean square elsewhere, below which no delay is believed."""
CLOCKS = 2e-4
"""Relative error of clocks that are not shared, up to which a delay that drifts is believed; crystals have 1e-4."""
_MOST_TIMES = 5  # its own length, after which it is given up


class Delay(NamedTuple):
    """What a probe found.

    Attributes:
        samples: delay.
        gain: measured over put out, at the peak; negative where the monitor is inverted.
        clearness: peak over the root mean square elsewhere, in the run of the sequence that is less clear.
        clearest: the same in the other run.
        spread: samples by which both runs of the sequence differ.
        apart: samples between both runs.
    """

    samples: int
    gain: float
    clearness: float
    clearest: float
    spread: int
    apart: int

    @property
    def is_seen(self) -> bool:
        """Whether a run shows the output at all."""
        return self.clearest >= LEAST_PEAK

    @property
    def is_clear(self) -> bool:
        """Whether it may be believed: both runs show it, with one delay but for rounding and the drift of clocks."""
        return self.clearness >= LEAST_PEAK and abs(self.spread) <= 1.0 + CLOCKS * self.apart


class DelayProbe:
    """Signal and evaluation; sample by sample with a converter.

    Args:
        amplitude: V.
        sample_rate: Hz.
        settling: s of zeros before.
        longest: s, largest delay that is found.
    """

    def __init__(self, amplitude: float, sample_rate: float, settling: float = 0.2, longest: float = 0.4) -> None:
        from scipy.signal import max_len_seq  # late: a process that owns an output without a probe starts faster

        sequence = amplitude * (2.0 * max_len_seq(ORDER)[0].astype(np.float64) - 1.0)
        self._sequence = sequence
        self._pause = np.zeros(round(longest * sample_rate))
        self._settling = round(settling * sample_rate)
        run = np.concatenate([sequence, self._pause])
        self._signal = np.concatenate([np.zeros(self._settling), run, run])
        self._asked = 0
        self.restart()

    def restart(self) -> None:
        """Put it out again, from the beginning."""
        self._position = 0
        self._measured: list[FloatArray] = []
        self._count = 0

    @property
    def done(self) -> bool:
        """Whether everything was put out and measured."""
        return self._count >= self._signal.size

    @property
    def failed(self) -> bool:
        """Whether it was begun again until it could have been put out whole five times."""
        return not self.done and self._asked > _MOST_TIMES * self._signal.size

    def next(self, count: int) -> FloatArray:
        """What to put out next, V, shape (count,)."""
        part = self._signal[self._position : self._position + count]
        self._position += count
        self._asked += count
        return np.concatenate([part, np.zeros(count - part.size)])

    def take(self, values: FloatArray, lost: bool) -> None:
        """What was measured since the first `next`, V at the monitor; starts again where samples were lost."""
        if self._position == 0 or self.done:
            return
        if lost:
            self.restart()
            return
        self._measured.append(values)
        self._count += values.size

    def delay(self) -> Delay:
        """The delay; call when `done`."""
        measured = np.concatenate(self._measured)[self._settling : self._signal.size]
        first, second = (self._one(part) for part in np.split(measured, 2))
        clearest = first if first.clearness >= second.clearness else second
        return clearest._replace(
            clearness=min(first.clearness, second.clearness),
            spread=second.samples - first.samples,
            apart=self._sequence.size + self._pause.size,
        )

    def _one(self, measured: FloatArray) -> Delay:
        reach = self._pause.size
        centred = measured - measured.mean()
        size = measured.size + self._sequence.size
        spectrum = np.fft.rfft(centred, size) * np.conj(np.fft.rfft(self._sequence, size))
        response = np.fft.irfft(spectrum, size)[:reach] / np.sum(self._sequence**2)
        peak = int(np.argmax(np.abs(response)))
        rest = np.delete(response, slice(max(peak - 20, 0), peak + 200))
        ground = float(np.sqrt(np.mean(rest**2))) if rest.size else 0.0
        gain = float(response[peak])
        clearness = abs(gain) / ground if ground > 0.0 else (np.inf if gain else 0.0)
        return Delay(peak, gain, clearness, clearness, 0, 0)
