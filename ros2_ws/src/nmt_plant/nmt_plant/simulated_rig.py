"""Simulated rig behind the device contract: oscillator, time integration, sensors, watchdog and limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from nmt_core.blocks import BlockFlag, FloatArray, OscillatorPhase, Quantity, SampleBlock
from nmt_core.errors import BenchError

from .device import Device, DeviceFault, DriveCommand, Waveform
from .limits import LimitGuard, within_limit
from .model.assembly import (
    ElectromechanicalSystem,
    OutputRow,
    acceleration_output,
    current_output,
    displacement_output,
    input_output,
    velocity_output,
)
from .model.time_integration import IntegrationError, TimeIntegrator
from .oscillator import Oscillator, OscillatorBlock, check_command
from .rig import Rig
from .rig_model import build_system, input_per_volt
from .sensors import Sensor, SensorChannel
from .watchdog import DriveWatchdog

# The order in which `tick` works; tests hold it to this.
TICK_ORDER = ("commands", "measure", "compute", "safety", "actuate", "publish")


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
        )
        for section in rig.sensors
    )


def sensor_output(system: ElectromechanicalSystem, sensor: Sensor, volts_to_input: float) -> OutputRow:
    """Output row of what a sensor sees.

    Raises:
        ValueError: a quantity that no sensor measures, or a current without a shaker.
    """
    if sensor.quantity == Quantity.FORCE:
        return system.force
    if sensor.quantity == Quantity.VOLTAGE:
        row = input_output(system)
        return OutputRow(row.acceleration, row.velocity, row.displacement, 1.0 / volts_to_input)
    if sensor.quantity == Quantity.CURRENT:
        return current_output(system)
    by_point = {
        Quantity.DISPLACEMENT: displacement_output,
        Quantity.VELOCITY: velocity_output,
        Quantity.ACCELERATION: acceleration_output,
    }
    if sensor.quantity not in by_point:
        raise ValueError(f"no sensor measures {sensor.quantity.name}")
    return by_point[sensor.quantity](system, sensor.point)


_Group = tuple[Quantity, tuple[str, ...], tuple[int, ...], list[int]]


class _ChannelGroup(NamedTuple):
    """The channels of one quantity: one block of them is published."""

    quantity: Quantity
    unit: str
    channels: tuple[str, ...]
    points: tuple[int, ...]
    rows: slice | list[int]


def _channel_groups(sensors: Sequence[Sensor]) -> list[_ChannelGroup]:
    groups = []
    for quantity in Quantity:
        rows = [row for row, sensor in enumerate(sensors) if sensor.quantity == quantity]
        if rows:
            together = rows == list(range(rows[0], rows[-1] + 1))
            groups.append(
                _ChannelGroup(
                    quantity,
                    quantity.unit,
                    tuple(sensors[row].channel for row in rows),
                    tuple(sensors[row].point for row in rows),
                    slice(rows[0], rows[-1] + 1) if together else rows,
                )
            )
    return groups


class SimulatedRig(Device):
    """A rig file brought to life; every `read` integrates one block.

    Args:
        rig: validated rig.
        block_samples: overrides the rig's.
    """

    def __init__(self, rig: Rig, block_samples: int | None = None) -> None:
        super().__init__()
        self.rig = rig
        self._block_samples = block_samples or rig.block_samples
        self.sensors = rig_sensors(rig)
        self._sample_rate = float(rig.sample_rate_hz)
        self._groups = _channel_groups(self.sensors)
        self._integrator: TimeIntegrator | None = None
        self._next_sample = 0
        self._prepare()

    def _prepare(self) -> None:
        rig = self.rig
        self._oscillator = Oscillator(rig.sample_rate_hz, rig.seed)
        self._channels = [SensorChannel(sensor, rig.sample_rate_hz, rig.seed) for sensor in self.sensors]
        self._plain_sensors = all(channel.plain for channel in self._channels)
        self._watchdog = DriveWatchdog(rig.watchdog.blocks)
        limits = {
            Quantity.VOLTAGE: rig.limits.voltage_v,
            Quantity.FORCE: rig.limits.force_n,
            Quantity.ACCELERATION: rig.limits.acceleration_m_s2,
            Quantity.DISPLACEMENT: rig.limits.displacement_m,
        }
        self._guard = LimitGuard({quantity: limit for quantity, limit in limits.items() if limit is not None})
        self._pending: list[DriveCommand] = []
        self._reason = ""
        self._flags = BlockFlag.NONE
        self._next_sample = 0

    @property
    def sample_rate(self) -> float:
        """Sample rate, Hz."""
        return float(self.rig.sample_rate_hz)

    @property
    def block_samples(self) -> int:
        """Samples in a block."""
        return self._block_samples

    @property
    def next_sample(self) -> int:
        """Index of the first sample of the next block."""
        return self._next_sample

    @property
    def tripped(self) -> str:
        """Why the drive was taken to zero and held there; empty if it was not."""
        return self._reason

    @property
    def is_quiet(self) -> bool:
        """Whether the drive is at zero and stays there without a new command."""
        harmless = all(command.waveform == Waveform.OFF for command in self._pending)
        return self._oscillator.is_quiet and (bool(self._reason) or harmless)

    @property
    def integrator(self) -> TimeIntegrator:
        """Time integration of the rig, for energies and states.

        Raises:
            AttributeError: not configured yet.
        """
        if self._integrator is None:
            raise AttributeError("configure the rig first")
        return self._integrator

    def _configure(self) -> None:
        system = build_system(self.rig)
        self._volts_to_input = input_per_volt(self.rig)
        outputs = [sensor_output(system, sensor, self._volts_to_input) for sensor in self.sensors]
        self._integrator = TimeIntegrator(system, self.sample_rate, outputs, self.rig.substeps)
        # Compiles the time loop, or loads it: not in the first block.
        self._integrator.advance(np.zeros(2))
        within_limit(np.zeros((1, 1)), 1.0)
        self._oscillator.block(1)

    def _start(self) -> None:
        self.integrator.reset()
        self._prepare()

    def _read(self) -> list[SampleBlock]:
        return self.tick()

    def tick(self) -> list[SampleBlock]:
        """One block, in the order of TICK_ORDER; `read` calls it.

        Commands that are due act on this block's drive; a violation seen in it acts from the next one on.
        """
        self._take_commands()
        drive = self._oscillator.block(self._block_samples)
        true_values = self._measure(drive)
        recorded, overload = self._compute(true_values)
        blocks = self._blocks(recorded, drive.phase)
        self._safety(blocks)
        self._actuate()
        return self._publish(blocks, overload)

    def _take_commands(self) -> None:
        """Apply, in order of arrival, what is due at this block; ignored while tripped."""
        due = [command for command in self._pending if command.apply_at_sample <= self._next_sample]
        self._pending = [command for command in self._pending if command.apply_at_sample > self._next_sample]
        if not self._reason:
            for command in due:
                self._oscillator.apply(command)

    def _measure(self, drive: OscillatorBlock) -> FloatArray:
        try:
            return self.integrator.advance(self._volts_to_input * drive.voltage)
        except (IntegrationError, ValueError) as error:
            raise DeviceFault(str(error)) from error

    def _compute(self, true_values: FloatArray) -> tuple[FloatArray, bool]:
        if self._plain_sensors:
            return true_values, False
        overload = False
        recorded = np.empty_like(true_values)
        for row, channel in enumerate(self._channels):
            recorded[row], over = channel.measure(true_values[row])
            overload = overload or over
        return recorded, overload

    def _blocks(self, recorded: FloatArray, phase: OscillatorPhase) -> list[SampleBlock]:
        return [
            SampleBlock(
                self._next_sample,
                self._sample_rate,
                group.quantity,
                group.unit,
                group.channels,
                group.points,
                recorded[group.rows],
                phase,
            )
            for group in self._groups
        ]

    def _safety(self, blocks: Sequence[SampleBlock]) -> None:
        if self._reason:
            return
        if self._guard.check(blocks):
            self._trip(self._guard.reason, BlockFlag.LIMIT, self.rig.limits.ramp_s)
        elif self._watchdog.block(not self._oscillator.is_quiet):
            self._trip(
                f"watchdog: no drive command for {self._watchdog.missed} blocks",
                BlockFlag.WATCHDOG,
                self.rig.watchdog.ramp_s,
            )

    def _actuate(self) -> None:
        """Hand the drive to the output: while tripped it can only go to zero."""
        if self._reason:
            self._oscillator.ramp_to_zero(0.0 if self._oscillator.is_quiet else self._quiet_ramp)

    def _publish(self, blocks: Sequence[SampleBlock], overload: bool) -> list[SampleBlock]:
        flags = int(self._flags | (BlockFlag.OVERLOAD if overload else BlockFlag.NONE))
        self._next_sample += self._block_samples
        if not flags:
            return list(blocks)
        return [replace(block, flags=flags) for block in blocks]

    def _trip(self, reason: str, flag: BlockFlag, ramp: float) -> None:
        self._reason = reason
        self._flags |= flag
        self._quiet_ramp = ramp

    def _write(self, command: DriveCommand) -> None:
        # A command the oscillator cannot follow is refused here, where its sender can be told.
        if command.waveform != Waveform.OFF:
            check_command(command, self.sample_rate)
            limit = self.rig.limits.voltage_v
            if limit is not None and command.amplitude > limit:
                raise BenchError(
                    f"drive amplitude {command.amplitude:g} V is beyond the rig's voltage limit "
                    f"of {limit:g} V; lower the level."
                )
        self._watchdog.command()
        self._pending.append(command)

    def _quiet(self, reason: str, ramp: float | None) -> None:
        if not self._reason:
            self._trip(reason, BlockFlag.WATCHDOG, self.rig.limits.ramp_s if ramp is None else ramp)
        self._oscillator.ramp_to_zero(self._quiet_ramp)

    def _reset(self) -> None:
        # The tripped drive must be at rest before anybody takes over again.
        self._oscillator.ramp_to_zero(0.0)
        self._pending.clear()
        self._guard.reset()
        self._watchdog.command()
        self._reason = ""
        self._flags = BlockFlag.NONE

    def _stop(self) -> None:
        self._oscillator.ramp_to_zero(0.0)
        self._pending.clear()

    def _close(self) -> None:
        self._integrator = None
