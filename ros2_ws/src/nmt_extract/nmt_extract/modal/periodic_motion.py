"""The harmonics of a window: excitation phase, sub-windows, drift that is taken out; set 0 is the whole window."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_extract.extraction_settings import ExtractionSettings
from nmt_extract.judgement import channel_noise, signal_faults, window_judge
from nmt_extract.modal.channels import WindowRows
from nmt_extract.modal.evaluated_window import EvaluatedWindow
from nmt_extract.modal.window import Window
from nmt_signals.harmonics import Moments, resolvable_harmonics
from nmt_signals.sine_fit import fit_frequency
from nmt_signals.spectral_lines import strongest_line


class PeriodicMotion:
    """Harmonics of all channels, over the window (set 0) and without each of its sub-windows (sets 1 to K).

    Args:
        window: all channels.
        rows: that are evaluated.
        settings: of the extraction.
        orders: of response and force that are in resonance; harmonics count in the excitation frequency over the
            second.

    Attributes:
        window: without the drift that was found.
        fitted: whether the frequency is fitted, since the excitation's phase is unknown.
        cycles, advance, periods: of the base frequency: phase at each sample, over the window, whole ones.
        harmonics: H.
        amplitudes: shape ``(1 + K, channels, H + 1)``.
        part_amplitudes: of each sub-window, shape ``(K, channels, H + 1)``; of the window where K is 0.
        part_moments, part_bounds: of the sub-windows.
        parts: K; 0 = the window is too short.
        frequency_hz: base frequency, shape ``(1 + K,)``; frequency_std: its standard uncertainty.
        noise: rms of each channel that no harmonic explains.
        drifted: height of the drift that was taken out, by row.
        other_amplitudes: with another polynomial in the place of the drift; None = there is none.

    Raises:
        BenchError: too few periods or samples, or force or drive point are off for a while.
    """

    def __init__(
        self, window: Window, rows: WindowRows, settings: ExtractionSettings, orders: tuple[int, int] = (1, 1)
    ) -> None:
        self.window, self.rows, self.settings, self.orders = window, rows, settings, orders
        self.drifted: dict[int, float] = {}
        self.other_amplitudes: ComplexArray | None = None
        self._find_phase()
        self._find_harmonics()
        self.noise = channel_noise.noise_rms(self.window.data, self.part_moments, self.part_amplitudes)
        self._take_out_drift()

    @property
    def samples_per_period(self) -> float:
        """Of the base frequency."""
        return self.window.samples / self.advance

    @property
    def omega(self) -> FloatArray:
        """Base frequency, rad/s, shape ``(1 + K,)``."""
        return np.asarray(2.0 * np.pi * self.frequency_hz)

    def order_of(self, row: int) -> int:
        """Resonant order of a channel."""
        return self.orders[1] if row in self.rows.forces else self.orders[0]

    def size_of(self, rows: list[int]) -> FloatArray:
        """Amplitude of the resonant order of channels, shape ``(rows,)``."""
        return np.abs(self.amplitudes[0, rows, [self.order_of(row) for row in rows]])

    def second(self, sample: int) -> float:
        """Time of a sample of the window on the clock of the recording, s."""
        return (self.window.lock.window_first_sample + sample) / self.window.sample_rate

    def model(self, amplitudes: ComplexArray, first: int, end: int) -> FloatArray:
        """The course that harmonics of one channel make of the samples ``first`` to ``end``."""
        orders = np.arange(self.harmonics + 1)
        return np.asarray((amplitudes @ np.exp(2j * np.pi * np.outer(orders, self.cycles[first:end]))).real)

    def _find_phase(self) -> None:
        window = self.window
        self.fitted = window.cycles is None
        if window.cycles is None:
            force = window.data[self.rows.force]
            try:
                frequency = fit_frequency(force, window.sample_rate, window.lock.frequency_hz)
            except BenchError:
                self._refuse_silence(window.sample_rate / strongest_line(force, window.sample_rate))
                raise
            samples: FloatArray = np.arange(window.samples, dtype=np.float64)
            cycles: FloatArray = samples * (frequency / window.sample_rate)
            end = window.samples * (frequency / window.sample_rate)
        else:
            cycles = window.cycles
            end = window.end_cycles
        self.advance = end - float(cycles[0])
        self._require_periods("")
        self._refuse_silence(self.samples_per_period)
        self.cycles = cycles
        nu = self.orders[1]
        if nu > 1:
            self.cycles, self.advance = cycles / nu, self.advance / nu
            self._require_periods(" of the subharmonic")

    def _require_periods(self, of: str) -> None:
        self.periods, needed = round(self.advance), self.settings.minimum_periods
        if self.periods < needed:
            raise BenchError(f"The window holds {self.periods} whole periods{of}; at least {needed} are needed.")

    def _refuse_silence(self, samples_per_period: float) -> None:
        window = self.window
        for row in dict.fromkeys((self.rows.force, self.rows.drive)):
            off = window_judge.silent_stretch(window.data[row], samples_per_period)
            if off is not None:
                what = "force" if row == self.rows.force else "response at the drive point"
                raise BenchError(
                    f"The {what} ({window.channels[row].name}) was off from {self.second(off[0]):.6g} to "
                    f"{self.second(off[1]):.6g} s, within the window; choose a window next to it, or look at the cable."
                )

    def _take_out_drift(self) -> None:
        """Take slow polynomials out of channels whose mean changes over the window."""
        window, parts = self.window, self.part_amplitudes
        if not self.parts:
            return
        rows = self.rows.used
        found = signal_faults.drifting(
            parts[:, rows, 0].real, self.size_of(rows), self.noise[rows], window.samples, self.periods
        )
        if not found:
            return
        self.drifted = {rows[k]: float(np.ptp(parts[:, rows[k], 0].real)) for k in found}
        chosen = list(self.drifted)
        for order in signal_faults.drift_orders(self.periods)[::-1]:  # the one that stays last
            data = window.data.copy()
            data[chosen] = signal_faults.without_drift(self.cycles, window.data[chosen], self.harmonics, order)
            self.window = replace(window, data=data)
            if self.fitted and self.rows.force in chosen:
                self._find_phase()
            self._find_harmonics()
            if self.other_amplitudes is None:
                self.other_amplitudes = self.amplitudes
        self.noise = channel_noise.noise_rms(self.window.data, self.part_moments, self.part_amplitudes)

    def _find_harmonics(self) -> None:
        window = self.window
        self.harmonics = resolvable_harmonics(self.settings.harmonics, self.samples_per_period)
        if self.harmonics < max(self.orders):
            if self.orders != (1, 1):
                raise BenchError(
                    f"A {self.orders[0]}:{self.orders[1]} resonance needs {max(self.orders)} orders, {self.harmonics} "
                    "are extracted; set extraction.harmonics of the rig."
                )
            raise BenchError(
                f"{self.samples_per_period:.2g} samples a period do not resolve the fundamental; sample faster."
            )
        found = EvaluatedWindow.of(
            self.cycles, self.advance, window.data, window.sample_rate, self.harmonics, self.settings.sub_windows
        )
        self.parts, self.part_bounds, self.part_moments = found.count, found.bounds, found.moments
        self.amplitudes, self.part_amplitudes = found.sets, found.parts
        self.frequency_hz = found.frequencies_hz
        fitted = found.parts[:, self.rows.force, self.orders[1]] if self.fitted else None
        self.frequency_std = found.frequency_std(fitted) / (self.orders[1] if self.fitted else 1)

    def divide(self, row: int, gain: float) -> None:
        """Divide all that is known of a channel by a real gain, in place but for the samples of the window."""
        data = self.window.data.copy()
        data[row] /= gain
        self.window = replace(self.window, data=data)
        moments: Moments = self.part_moments
        projections = moments.projections.copy()
        projections[:, row] /= gain
        self.part_moments = Moments(moments.basis, projections)
        for amplitudes in (self.amplitudes, self.part_amplitudes, self.other_amplitudes):
            if amplitudes is not None:
                amplitudes[:, row] /= gain
        self.noise = self.noise.copy()
        self.noise[row] /= abs(gain)
