"""Sensors: dead zone, analogue chain, gain, what is added on the way, noise and converter of each channel.

Order: true value → dead zone → low-pass → high-pass → delay → gain → + cross-talk + mains hum + noise → clipping →
converter → dropped samples.

Noise convention: `noise_psd` S is a density in units²/Hz such that the noise has the variance S / t_c, where
t_c is the time over which a value is held (the correlation time; one sampling interval when it is 0). This is
the two-sided density; the one-sided one is 2 S. With it a force amplitude of 0.1 N has the SNR of the paper's
noise table (14 dB at 2e-9 and t_c = 0.01 ms). Anti-aliasing is missing: values held for less than a sampling
interval are independent.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_rig.analogue_chain import AnalogueChain

# Set the random numbers of hum and dropped samples apart from those of the noise.
_HUM_SEED = 0x48554D
_DROP_SEED = 0x44524F50


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
        dead_zone: a loose sensor sees sign(y) max(|y| - dead_zone, 0), SI units.
        low_pass_hz, high_pass_hz, delay: analogue chain, see analogue_chain.py; Hz, Hz, s.
        hum_amplitude, hum_hz: sine from the mains, recorded units, Hz; of one phase in all channels.
        crosstalk_per_volt: recorded units per volt of drive command.
        clip: recorded values beyond ±clip are cut off unnoticed (no overload flag); None = never.
        dropped_fraction: share of samples that are lost; the one before is recorded again.
    """

    channel: str
    quantity: Quantity
    point: int
    gain: float = 1.0
    noise_psd: float = 0.0
    noise_correlation_time: float = 0.0
    adc_range: float | None = None
    adc_bits: int | None = None
    dead_zone: float = 0.0
    low_pass_hz: float | None = None
    high_pass_hz: float | None = None
    delay: float = 0.0
    hum_amplitude: float = 0.0
    hum_hz: float = 50.0
    crosstalk_per_volt: float = 0.0
    clip: float | None = None
    dropped_fraction: float = 0.0


class SensorChannel:
    """A sensor at work; its noise depends on seed, channel name and sample index, not on the block length."""

    def __init__(self, sensor: Sensor, sample_rate: float, seed: int) -> None:
        self.sensor = sensor
        entropy = [seed, zlib.crc32(sensor.channel.encode())]
        self._generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(entropy)))
        interval = 1.0 / sample_rate
        held = sensor.noise_correlation_time or interval
        self.noise_deviation = float(np.sqrt(sensor.noise_psd / held))
        self._samples_per_value = max(held / interval, 1.0)
        self._chain = AnalogueChain(sample_rate, sensor.low_pass_hz, sensor.high_pass_hz, sensor.delay)
        self._hum_step = sensor.hum_hz * interval
        self._hum_start = float(np.random.default_rng([seed, _HUM_SEED]).random())
        self._drops = np.random.Generator(np.random.PCG64(np.random.SeedSequence([*entropy, _DROP_SEED])))
        self._recorded = 0.0
        self.plain = (
            sensor.gain == 1.0
            and self.noise_deviation == 0.0
            and sensor.adc_range is None
            and sensor.dead_zone == 0.0
            and self._chain.plain
            and sensor.hum_amplitude == 0.0
            and sensor.crosstalk_per_volt == 0.0
            and sensor.clip is None
            and sensor.dropped_fraction == 0.0
        )
        self._sample = 0
        self._drawn = 0
        self._last = 0.0

    def _noise(self, samples: int) -> FloatArray:
        index = np.floor((self._sample + np.arange(samples)) / self._samples_per_value + 1e-9).astype(np.int64)
        first = self._drawn
        fresh = self._generator.standard_normal(int(index[-1]) + 1 - first)
        values = np.concatenate([[self._last], fresh])
        self._drawn = int(index[-1]) + 1
        self._last = float(values[-1])
        return np.asarray(self.noise_deviation * values[index - first + 1], dtype=np.float64)

    def _added(self, samples: int, drive: FloatArray | None) -> FloatArray:
        """Mains hum and cross-talk of the next samples, recorded units."""
        sensor = self.sensor
        result = np.zeros(samples)
        if sensor.hum_amplitude != 0.0:
            cycles = self._hum_start + self._hum_step * (self._sample + np.arange(samples))
            result += sensor.hum_amplitude * np.sin(2.0 * np.pi * cycles)
        if sensor.crosstalk_per_volt != 0.0 and drive is not None:
            result += sensor.crosstalk_per_volt * drive
        return result

    def _with_drops(self, values: FloatArray) -> FloatArray:
        """Lost samples replaced by the last one that was not lost."""
        kept = self._drops.random(values.size) >= self.sensor.dropped_fraction
        source = np.maximum.accumulate(np.where(kept, np.arange(values.size), -1))
        result = np.where(source >= 0, values[source], self._recorded)
        if result.size:
            self._recorded = float(result[-1])
        return result

    def measure(self, true_values: FloatArray, drive: FloatArray | None = None) -> tuple[FloatArray, bool]:
        """Recorded values of the next samples.

        Args:
            true_values: (samples,) in SI units.
            drive: (samples,) commanded drive voltage, V, for cross-talk.

        Returns:
            (samples,) recorded values, and whether the converter was driven to its end.
        """
        if self.plain:
            return true_values, False
        samples = true_values.shape[0]
        sensor = self.sensor
        if sensor.dead_zone > 0.0:
            true_values = np.sign(true_values) * np.maximum(np.abs(true_values) - sensor.dead_zone, 0.0)
        if not self._chain.plain:
            true_values = self._chain.process(true_values)
        values = self.sensor.gain * true_values
        if sensor.hum_amplitude != 0.0 or sensor.crosstalk_per_volt != 0.0:
            values = values + self._added(samples, drive)
        if self.noise_deviation > 0.0 and samples > 0:
            values = values + self._noise(samples)
        self._sample += samples
        overload = False
        if sensor.clip is not None:
            values = np.clip(values, -sensor.clip, sensor.clip)
        if self.sensor.adc_range is not None:
            full = self.sensor.adc_range
            overload = bool(np.any(np.abs(values) >= full))
            values = np.clip(values, -full, full)
            if self.sensor.adc_bits is not None:
                step = 2.0 * full / 2.0**self.sensor.adc_bits
                values = step * np.round(values / step)
        if sensor.dropped_fraction > 0.0:
            values = self._with_drops(values)
        return values, overload
