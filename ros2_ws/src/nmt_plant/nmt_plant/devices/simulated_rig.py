"""Simulated rig behind the device contract: oscillator, time integration, sensors, watchdog and limits."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from nmt_core.messages.blocks import OscillatorPhase, Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_plant.devices.device import DeviceFault
from nmt_plant.devices.guarded_device import TICK_ORDER, ChannelGroup, GuardedDevice, GuardSettings, owned_output
from nmt_plant.oscillator import OscillatorBlock
from nmt_plant.safety.limits import ChannelLimit, OpenLoop
from nmt_rig.drift import Drift
from nmt_rig.model.assembly import (
    ElectromechanicalSystem,
    acceleration_output,
    current_output,
    displacement_output,
    force_output,
    input_output,
    velocity_output,
)
from nmt_rig.model.exciter import OutputRow
from nmt_rig.model.time_integration import IntegrationError, TimeIntegrator
from nmt_rig.rig import Rig, ShakerSection
from nmt_rig.rig_model import build_system, inputs_per_volt
from nmt_rig.sensors import Sensor, SensorChannel

__all__ = [
    "TICK_ORDER",
    "SimulatedRig",
    "channel_groups",
    "guard_settings",
    "rig_sensors",
    "sensor_output",
    "sensor_row",
]


def rig_sensors(rig: Rig) -> tuple[Sensor, ...]:
    """Sensors of a rig with points and channel names resolved."""
    return tuple(
        Sensor(
            channel=rig.sensor_channel(section),
            quantity=Quantity[section.quantity.upper()],
            point=rig.sensor_point(section),
            gain=section.gain,
            noise_psd=section.noise_psd,
            noise_correlation_time=section.noise_correlation_time_s,
            adc_range=section.range,
            adc_bits=section.bits,
            dead_zone=section.dead_zone,
            low_pass_hz=section.low_pass_hz,
            high_pass_hz=section.high_pass_hz,
            delay=section.delay_s,
            hum_amplitude=section.hum_amplitude,
            hum_hz=section.hum_hz,
            crosstalk_per_volt=section.crosstalk_per_volt,
            clip=section.clip,
            dropped_fraction=section.dropped_fraction,
        )
        for section in rig.sensors
    )


def sensor_output(
    system: ElectromechanicalSystem, sensor: Sensor, volts_to_input: float, exciter: int = 0
) -> OutputRow:
    """Output row that a sensor measures; voltage and current are those of an exciter, counted from 0.

    Raises:
        ValueError: a quantity that no sensor measures, or a current without a shaker.
    """
    if sensor.quantity == Quantity.FORCE:
        return force_output(system, sensor.point)
    if sensor.quantity == Quantity.VOLTAGE:
        row = input_output(system, exciter)
        return replace(row, feedthrough=1.0 / volts_to_input)
    if sensor.quantity == Quantity.CURRENT:
        return current_output(system, exciter)
    by_point = {
        Quantity.DISPLACEMENT: displacement_output,
        Quantity.VELOCITY: velocity_output,
        Quantity.ACCELERATION: acceleration_output,
    }
    if sensor.quantity not in by_point:
        raise ValueError(f"no sensor measures {sensor.quantity.name}")
    return by_point[sensor.quantity](system, sensor.point)


def sensor_row(system: ElectromechanicalSystem, rig: Rig, index: int) -> OutputRow:
    """Output row of one of the rig's sensors, with the mass of a force cell and the share of a transverse motion.

    Raises:
        ValueError: a quantity that no sensor measures, or a current without a shaker.
    """
    sensor, section = rig_sensors(rig)[index], rig.sensors[index]
    exciter = (section.exciter or 1) - 1
    per_volt = inputs_per_volt(rig)[exciter]
    row = sensor_output(system, sensor, per_volt, exciter)
    if section.mass_kg and sensor.quantity == Quantity.FORCE:
        row = row.plus(acceleration_output(system, sensor.point), section.mass_kg)
    if section.transverse is not None:
        other = sensor_output(system, replace(sensor, point=section.transverse.point), per_volt, exciter)
        row = row.plus(other, section.transverse.fraction)
    return row


def channel_groups(sensors: Sequence[Sensor]) -> list[ChannelGroup]:
    """The channels of each quantity, in the order of the sensors."""
    groups = []
    for quantity in Quantity:
        rows = [row for row, sensor in enumerate(sensors) if sensor.quantity == quantity]
        if rows:
            together = rows == list(range(rows[0], rows[-1] + 1))
            groups.append(
                ChannelGroup(
                    quantity,
                    quantity.unit,
                    tuple(sensors[row].channel for row in rows),
                    tuple(sensors[row].point for row in rows),
                    slice(rows[0], rows[-1] + 1) if together else rows,
                )
            )
    return groups


def guard_settings(rig: Rig) -> GuardSettings:
    """What a rig file says about limits and watchdog, for any device that extends `GuardedDevice`."""
    section = rig.limits
    limits = {
        Quantity.VOLTAGE: section.voltage_v,
        Quantity.FORCE: section.force_n,
        Quantity.ACCELERATION: section.acceleration_m_s2,
        Quantity.VELOCITY: section.velocity_m_s,
        Quantity.DISPLACEMENT: section.displacement_m,
    }
    return GuardSettings(
        limits={quantity: limit for quantity, limit in limits.items() if limit is not None},
        limit_ramp=section.ramp_s,
        watchdog_blocks=rig.watchdog.blocks,
        watchdog_ramp=rig.watchdog.ramp_s,
        slew=section.slew_v_s,
        rise_from=section.rise_from_v,
        channels=tuple(
            ChannelLimit(own.channel, own.abort_peak, own.abort_rms, own.warning_peak, own.warning_rms)
            for own in section.channels
        ),
        open_loops=tuple(OpenLoop(own.channel, own.least, own.drive_v, own.time_s) for own in section.open_loop),
        drive_maximum=section.drive_maximum_v,
        rms_time=section.rms_time_s,
        warning_share=section.warning_share,
        sample_bits=53 if rig.recording is None else rig.recording.sample_bits,
    )


class SimulatedRig(GuardedDevice):
    """A rig file brought to life; every `read` integrates one block.

    Args:
        rig: validated rig.
        block_samples: overrides the rig's.
        owned: whether a process of its own owns the output, for real time: it goes to zero when this one hangs or dies.
        stop_file: path whose existence is the rig's external stop input; empty = none.
        **output: settings of `guarded_device.owned_output`.
    """

    def __init__(
        self, rig: Rig, block_samples: int | None = None, owned: bool = False, stop_file: str = "", **output: Any
    ) -> None:
        self.rig = rig
        self._stop_file = stop_file
        self.sensors = rig_sensors(rig)
        block, settings = block_samples or rig.block_samples, guard_settings(rig)
        if owned:
            count = len(rig.all_exciters)
            arguments = {"sample_rate": float(rig.sample_rate_hz), "stop_file": stop_file, "outputs": count}
            output = {"arguments": arguments, "outputs": count, **output}
        super().__init__(
            rig.sample_rate_hz,
            block,
            channel_groups(self.sensors),
            settings,
            rig.seed,
            owned_output(rig.sample_rate_hz, block, settings, **output) if owned else None,
            len(rig.all_exciters),
        )
        self._integrator: TimeIntegrator | None = None
        self._prepare()

    def _prepare(self) -> None:
        super()._prepare()
        rig = self.rig
        self._channels = [SensorChannel(sensor, self.true_sample_rate, rig.seed) for sensor in self.sensors]
        self._plain_sensors = all(channel.plain for channel in self._channels)
        self._drift = Drift(rig)
        self._drive_voltages = np.zeros((len(rig.all_exciters), 0))

    @property
    def true_sample_rate(self) -> float:
        """Hz: what a clock without error would find; the rig takes its sample rate for the nominal one."""
        return self.rig.sample_rate_hz * (1.0 + self.rig.clock_error)

    @property
    def integrator(self) -> TimeIntegrator:
        """Time integration of the rig, for energies and states.

        Raises:
            AttributeError: not configured yet.
        """
        if self._integrator is None:
            raise AttributeError("configure the rig first")
        return self._integrator

    def _stop_requested(self) -> bool:
        return bool(self._stop_file) and os.path.exists(self._stop_file)

    def _configure(self) -> None:
        self._volts_to_inputs = np.array(inputs_per_volt(self.rig))[:, None]
        self._integrator = self._make_integrator()
        # Exciters, counted from 0, whose amplifiers saturate, and how far.
        self._saturations = {
            number: exciter.amplifier_saturation_v
            for number, exciter in enumerate(self.rig.all_exciters)
            if isinstance(exciter, ShakerSection) and exciter.amplifier_saturation_v is not None
        }
        self._voltage_rows = [row for row, s in enumerate(self.sensors) if s.quantity == Quantity.VOLTAGE]
        # Row of each voltage sensor whose amplifier saturates, and its exciter.
        exciters = [(section.exciter or 1) - 1 for section in self.rig.sensors]
        self._saturated_rows = [
            (row, exciters[row]) for row in self._voltage_rows if exciters[row] in self._saturations
        ]
        # Compiles the time loop, or loads it: not in the first block.
        self._integrator.advance(np.zeros((len(self.rig.all_exciters), 2)))

    def _make_integrator(self) -> TimeIntegrator:
        system = build_system(self.rig)
        outputs = [sensor_row(system, self.rig, row) for row in range(len(self.sensors))]
        return TimeIntegrator(system, self.true_sample_rate, outputs, self.rig.substeps)

    def _start(self) -> None:
        if self._drift.active:
            self._integrator = self._make_integrator()  # what drifted is as it was
        self.integrator.reset()
        super()._start()

    def _measure(self, drive: OscillatorBlock) -> FloatArray:
        self._drive_voltages = drive.voltages[:, :-1]
        behind = drive.voltages
        for exciter, most in self._saturations.items():
            behind = behind.copy()
            behind[exciter] = most * np.tanh(behind[exciter] / most)
        inputs = self._volts_to_inputs * behind
        try:
            if self._drift.active:
                values = self._drift.advance(self.integrator, inputs, drive.phase)
            else:
                values = self.integrator.advance(inputs)
        except (IntegrationError, ValueError) as error:
            raise DeviceFault(str(error)) from error
        for row, exciter in self._saturated_rows:  # measured before the amplifier
            values[row] = self._drive_voltages[exciter]
        return values

    def respond(self, voltage: FloatArray) -> FloatArray:
        """What the sensors record while a voltage acts, next to the device's own clock; needs a configured rig.

        Args:
            voltage: (n + 1,) V, the last one where the next call begins; of several exciters (exciters, n + 1).

        Returns:
            (channels, n), SI.

        Raises:
            DeviceFault: a motion that is not finite.
        """
        still = OscillatorPhase(0.0, 0.0, 0.0)
        return self._compute(self._measure(OscillatorBlock(np.atleast_2d(voltage), still)))[0]

    def _compute(self, true_values: FloatArray) -> tuple[FloatArray, bool]:
        if self._plain_sensors:
            return true_values, False
        overload = False
        recorded = np.empty_like(true_values)
        for row, channel in enumerate(self._channels):
            recorded[row], over = channel.measure(true_values[row], self._drive_voltages[0])
            overload = overload or over
        return recorded, overload

    def _close(self) -> None:
        self._integrator = None
