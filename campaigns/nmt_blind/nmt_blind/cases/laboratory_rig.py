"""A simulated rig between a laboratory's converters: zero-order hold, distortion by the amplifier, filters."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.signal import butter, sosfilt

from nmt_core.numerics.arrays import FloatArray
from nmt_plant.devices.device import DeviceFault
from nmt_plant.devices.simulated_rig import SimulatedRig, sensor_row
from nmt_plant.oscillator import OscillatorBlock
from nmt_rig.analogue_chain import AnalogueChain
from nmt_rig.drift import Drift
from nmt_rig.model.time_integration import IntegrationError, TimeIntegrator
from nmt_rig.rig import Rig
from nmt_rig.rig_model import build_system
from nmt_rig.sensors import SensorChannel

STEPS, STEPS_OF_IMAGES = 20, 40
"""Steps of the time integration per sample: the drive is held over all but the last, in which it moves on. There are
more where nothing filters the steps of a zero-order hold: delays of channels go along straight lines between them."""


@dataclass(frozen=True)
class Converters:
    """What a laboratory's converters and amplifier make of the drive and of the channels.

    Attributes:
        held: the drive, from sample to sample.
        filtered: an eighth-order Butterworth low-pass at 0.4 of the sample rate before every channel is sampled;
            without it, the steps of a zero-order hold appear in the channels as images of its frequency.
        harmonics: of the drive, order and complex amplitude over the fundamental's.
    """

    held: bool = False
    filtered: bool = False
    harmonics: tuple[tuple[int, complex], ...] = ()

    def to_mapping(self) -> dict[str, Any]:
        """Plain values for JSON."""
        harmonics = [[order, h.real, h.imag] for order, h in self.harmonics]
        return {"held": self.held, "filtered": self.filtered, "harmonics": harmonics}


class LaboratoryRig(SimulatedRig):
    """A rig as a laboratory drives and records it.

    Filters and delays of the channels act on the steps of the time integration, before anything is sampled. Where the
    drive is held, the integration is ahead of the samples by all steps but one of a sample: a channel may lead by that.

    Args:
        rig: the rig with everything that it really has.
        converters: what they make of the drive and of the channels.

    Attributes:
        steps: of the time integration per sample.
    """

    def __init__(self, rig: Rig, converters: Converters) -> None:
        self._converters = converters
        self._images = converters.held and not converters.filtered
        self.steps = STEPS_OF_IMAGES if self._images else STEPS
        self._ahead = self.steps - 1 if converters.held else 0
        self._filter = butter(8, 0.8 / self.steps, output="sos")
        super().__init__(rig)

    def _prepare(self) -> None:
        super()._prepare()
        rate = self.steps * self.true_sample_rate
        self._begun = False
        self._memory = np.zeros((self._filter.shape[0], len(self.sensors), 2))
        self._drift = Drift(self.rig.model_copy(update={"sample_rate_hz": self.steps * self.rig.sample_rate_hz}))
        self._chains = [
            AnalogueChain(
                rate, section.low_pass_hz, section.high_pass_hz, section.delay + self._ahead / rate, self._images
            )
            for section in self.sensors
        ]
        sampled = [replace(s, low_pass_hz=None, high_pass_hz=None, delay=0.0, dead_zone=0.0) for s in self.sensors]
        self._channels = [SensorChannel(sensor, self.true_sample_rate, self.rig.seed) for sensor in sampled]
        self._plain_sensors = all(channel.plain for channel in self._channels)

    def _make_integrator(self) -> TimeIntegrator:
        system = build_system(self.rig)
        outputs = [sensor_row(system, self.rig, row) for row in range(len(self.sensors))]
        return TimeIntegrator(system, self.steps * self.true_sample_rate, outputs)

    def _measure(self, drive: OscillatorBlock) -> FloatArray:
        monitor = self._distorted(drive)
        applied = monitor
        most = self._saturations.get(0)
        if most is not None:
            applied = most * np.tanh(applied / most)
        fine = self._volts_to_inputs * self._between(applied)
        self._drive_voltages = monitor[None, :-1]
        try:
            if self._drift.active:
                values = self._drift.advance(self.integrator, fine, drive.phase)
            else:
                values = self.integrator.advance(fine)
        except (IntegrationError, ValueError) as error:
            raise DeviceFault(str(error)) from error
        values[self._voltage_rows] = self._between(monitor)[:-1]  # measured before the amplifier
        first = 0 if self._begun else self._ahead
        self._begun = True
        values = self._sensed(values)
        if self._converters.filtered:
            values, self._memory = sosfilt(self._filter, values, zi=self._memory)
        return np.ascontiguousarray(values[:, first :: self.steps])

    def _sensed(self, values: FloatArray) -> FloatArray:
        """What the sensors and their conditioners pass, at every step."""
        result = np.empty_like(values)
        for row, (sensor, chain) in enumerate(zip(self.sensors, self._chains, strict=True)):
            recorded = values[row]
            if sensor.dead_zone > 0.0:
                recorded = np.sign(recorded) * np.maximum(np.abs(recorded) - sensor.dead_zone, 0.0)
            result[row] = chain.process(recorded)
        return result

    def _between(self, voltage: FloatArray) -> FloatArray:
        """The drive at every step that is to be made and at the end of the last, from that at the samples, (n + 1,)."""
        if self._converters.held:
            return np.repeat(voltage, self.steps)[self._ahead if self._begun else 0 :]
        places = np.arange(self.steps * (voltage.size - 1) + 1) / self.steps
        return np.interp(places, np.arange(voltage.size), voltage)

    def _distorted(self, drive: OscillatorBlock) -> FloatArray:
        """The drive with its harmonics, in proportion to its amplitude and in step with its phase."""
        if not self._converters.harmonics or not drive.phase.frequency_hz > 0.0:
            return drive.voltage
        u = drive.voltage
        theta = drive.phase.phase(u.size, self.sample_rate)
        # Two neighbours of A cos θ tell A, which hardly changes from one to the next: A² = |u₁ - u₀ e^{iΔ}|² / sin² Δ.
        step = np.diff(theta)
        size = np.abs(u[1:] - u[:-1] * np.exp(1j * step)) / np.abs(np.sin(step))
        size = np.append(size, size[-1])
        result = u.copy()
        for order, share in self._converters.harmonics:
            result += size * (share * np.exp(1j * order * theta)).real
        return result
