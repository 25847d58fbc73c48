"""Sensors: gain, noise and converter of each channel.

Noise convention: `noise_psd` S is a density in units²/Hz such that the noise has the variance S / t_c, where
t_c is the time over which a value is held (the correlation time; one sampling interval when it is 0). This is
the two-sided density; the one-sided one is 2 S. With it a force amplitude of 0.1 N has the SNR of the paper's
noise table (14 dB at 2e-9 and t_c = 0.01 ms). There is no anti-aliasing: values held for less than a sampling
interval are independent.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from nmt_core.blocks import FloatArray, Quantity


@dataclass(frozen=True)
class Sensor:
    """One channel.

    Attributes:
        channel: channel name.
        quantity: what it measures.
        point: measurement point, 0 = none.
        gain: recorded value per true value.
        noise_psd: units²/Hz, see the module's text.
        noise_correlation_time: s.
        adc_range: full scale in recorded units (values are clipped to ±range); None = unlimited.
        adc_bits: converter resolution, step 2 range / 2^bits; None = none.
    """

    channel: str
    quantity: Quantity
    point: int
    gain: float = 1.0
    noise_psd: float = 0.0
    noise_correlation_time: float = 0.0
    adc_range: float | None = None
    adc_bits: int | None = None


class SensorChannel:
    """A sensor at work; its noise depends on seed, channel name and sample index, not on the block length."""

    def __init__(self, sensor: Sensor, sample_rate: float, seed: int) -> None:
        self.sensor = sensor
        seeds = np.random.SeedSequence([seed, zlib.crc32(sensor.channel.encode())])
        self._generator = np.random.Generator(np.random.PCG64(seeds))
        interval = 1.0 / sample_rate
        held = sensor.noise_correlation_time or interval
        self.noise_deviation = float(np.sqrt(sensor.noise_psd / held))
        self._samples_per_value = max(held / interval, 1.0)
        self.plain = sensor.gain == 1.0 and self.noise_deviation == 0.0 and sensor.adc_range is None
        self._sample = 0
        self._drawn = 0
        self._last = 0.0

    def _noise(self, samples: int) -> FloatArray:
        index = np.floor((self._sample + np.arange(samples)) / self._samples_per_value + 1e-9).astype(
            np.int64
        )
        first = self._drawn
        fresh = self._generator.standard_normal(int(index[-1]) + 1 - first)
        values = np.concatenate([[self._last], fresh])
        self._drawn = int(index[-1]) + 1
        self._last = float(values[-1])
        return np.asarray(self.noise_deviation * values[index - first + 1], dtype=np.float64)

    def measure(self, true_values: FloatArray) -> tuple[FloatArray, bool]:
        """Recorded values of the next samples.

        Args:
            true_values: (samples,) in SI units.

        Returns:
            (samples,) recorded values, and whether the converter was driven to its end.
        """
        if self.plain:
            return true_values, False
        samples = true_values.shape[0]
        values = self.sensor.gain * true_values
        if self.noise_deviation > 0.0 and samples > 0:
            values = values + self._noise(samples)
        self._sample += samples
        overload = False
        if self.sensor.adc_range is not None:
            full = self.sensor.adc_range
            overload = bool(np.any(np.abs(values) >= full))
            values = np.clip(values, -full, full)
            if self.sensor.adc_bits is not None:
                step = 2.0 * full / 2.0**self.sensor.adc_bits
                values = step * np.round(values / step)
        return values, overload
