"""A rig behind a converter: the sensors of a rig file, measured at the ports that its section ``device`` names."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_plant.converters.converter_watch import ClockWatch, DelayWatch
from nmt_plant.devices.guarded_device import GuardedDevice, owned_output
from nmt_plant.devices.simulated_rig import channel_groups, guard_settings, rig_sensors
from nmt_plant.oscillator import OscillatorBlock
from nmt_plant.specimen import Specimen
from nmt_rig.device_sections import AnyDevice, specimen_device
from nmt_rig.rig import Rig

PROBE_SHARE = 0.005
"""Of the drive's limit: amplitude of the signal that finds the delay."""
HARDWARE_LEAD = 8
"""Blocks that wait at the output of hardware unless a test says otherwise."""
_END_STOP = 0.999  # of the range, from which a sample counts as overload


class ConverterFigures(NamedTuple):
    """What is known of a converter in use.

    Attributes:
        delay: samples from a sample put out to the one that measures it, found at the start.
        round_trip: samples from the start of the converter's turn to its samples measured: delay and a turn.
        stated: round trip as the driver says it; negative = it says nothing.
        monitor_gain: of the drive's monitor, measured over put out; 0 = not measured.
        drift: samples by which the delay has moved since; NaN = not seen yet.
        clock_ppm: rate of the converter's samples against the computer's clock, millionths; NaN = not known yet.
        lost_turns: turns of the converter in which samples were lost.
    """

    delay: int
    round_trip: int
    stated: int
    monitor_gain: float
    drift: float
    clock_ppm: float
    lost_turns: int


def device_of(rig: Rig, kind: str = "", address: str = "") -> AnyDevice:
    """The rig's converter; where its file has none of the kind, the ports of the simulated specimen.

    Args:
        rig: the rig.
        kind: of :data:`nmt_rig.device_sections.DEVICES`; empty = that of the file.
        address: of a kind that takes one.

    Raises:
        BenchError: the file has no section ``device`` and no kind is named, or the kind does not exist, or none without
            a section.
    """
    section = rig.device
    if section is not None and kind in ("", section.kind):
        return section
    if not kind:
        raise BenchError(f"Rig {rig.name} has no section 'device'; write one, or name a kind with --device.")
    channels = [(sensor.channel, sensor.quantity) for sensor in rig_sensors(rig)]
    return specimen_device(kind, channels, dict(guard_settings(rig).limits), address, len(rig.all_exciters))


class HardwareRig(GuardedDevice):
    """The rig at its converter.

    Args:
        rig: validated rig; its model plays no part here.
        device: converter and channel map.
        lead_blocks: blocks that wait at the output.
        probe_needed: whether a drive that is not seen at its monitor is a fault.
        specimen: stands in for converter and cables, in lockstep, without a process of its own; None = the converter.
        **output: other settings of `guarded_device.owned_output`.

    Attributes:
        outputs: (exciters, samples) V put out in the last block.

    Raises:
        BenchError: the section does not fit the rig.
    """

    def __init__(
        self,
        rig: Rig,
        device: AnyDevice,
        lead_blocks: int = HARDWARE_LEAD,
        probe_needed: bool = True,
        specimen: Specimen | None = None,
        **output: Any,
    ) -> None:
        self.rig, self.section = rig, device
        self._specimen = specimen
        self.sensors = rig_sensors(rig)
        # Counted from 0; of every sensor, though only a voltage has one.
        self._exciter_of = [(section.exciter or 1) - 1 for section in rig.sensors]
        exciters = len(rig.all_exciters)
        if len(device.outputs) != exciters:
            raise BenchError(
                f"Section device of rig {rig.name} has {len(device.outputs)} outputs for {exciters} exciters; give one "
                "for each, in their order."
            )
        settings = guard_settings(rig)
        if settings.voltage is None:
            raise BenchError(f"Rig {rig.name} has no limits.voltage_v; hardware is not driven without one.")
        ports = {entry.channel: row for row, entry in enumerate(device.inputs)}
        for sensor in self.sensors:
            if sensor.channel not in ports and sensor.quantity is not Quantity.VOLTAGE:
                raise BenchError(f"Section device of rig {rig.name} has no port for sensor {sensor.channel}; add one.")
        self._rows = [ports.get(sensor.channel, -1) for sensor in self.sensors]
        self._sensitivity = np.array([[entry.sensitivity_v] for entry in device.inputs])
        self._end_stops = np.array([[_END_STOP * entry.range_v] for entry in device.inputs])
        self._gains = np.array([[entry.amplifier_gain] for entry in device.outputs])
        voltages = [row for row, sensor in enumerate(self.sensors) if sensor.quantity is Quantity.VOLTAGE]
        of_first = (self._rows[row] for row in voltages if self._exciter_of[row] == 0)
        self._monitor = next(of_first, -1)
        link = None
        if specimen is None:
            probe = {
                "probe": PROBE_SHARE * settings.voltage if self._monitor >= 0 else 0.0,
                "probe_input": max(self._monitor, 0),
                "probe_settling": device.quiet_s,
                "probe_needed": probe_needed,
            }
            link = owned_output(
                rig.sample_rate_hz,
                rig.block_samples,
                settings,
                lead_blocks=lead_blocks,
                inputs=len(device.inputs),
                outputs=exciters,
                converter=device.driver,
                arguments=device.driver_arguments(float(rig.sample_rate_hz), int(rig.block_samples)),
                probe=probe,
                **output,
            )
        super().__init__(
            rig.sample_rate_hz,
            rig.block_samples,
            channel_groups(self.sensors),
            settings,
            rig.seed,
            output=link,
            exciters=exciters,
        )
        self.outputs: FloatArray = np.zeros((exciters, rig.block_samples))
        self._prepare()

    @property
    def has_monitor(self) -> bool:
        """Whether an input measures the output of exciter 1, at which every start looks for the delay."""
        return self._monitor >= 0

    def _prepare(self) -> None:
        super()._prepare()
        self._clock = ClockWatch(self._sample_rate)
        self._delays = DelayWatch(self._sample_rate)
        self._lost_before = 0
        self.measured = np.zeros((len(self.section.inputs), self._block_samples))

    def _configure(self) -> None:
        pass

    def _measure(self, drive: OscillatorBlock) -> FloatArray:
        n = self._block_samples
        self.outputs = drive.voltages[:, :n]
        if self._specimen is not None:
            self.measured = self._specimen.respond(self.outputs / self._gains)
        values = self.measured / self._sensitivity
        self._watch(values, drive)
        recorded = np.empty((len(self._rows), self._block_samples))
        for row, port in enumerate(self._rows):
            recorded[row] = self.outputs[self._exciter_of[row]] if port < 0 else values[port]
        return recorded

    def _compute(self, true_values: FloatArray) -> tuple[FloatArray, bool]:
        return true_values, bool(np.any(np.abs(self.measured) >= self._end_stops))

    def _watch(self, values: FloatArray, drive: OscillatorBlock) -> None:
        if self.link is None:
            if self._specimen is not None:
                self._clock.add(self._specimen.seconds, self._next_sample)
            return
        report = self.link.last_report
        lost = report.lost_turns != self._lost_before
        self._lost_before = report.lost_turns
        self._clock.add(report.time, report.put_out, lost)
        if self._monitor >= 0 and not lost and not self._lost:
            self._delays.add(self.put_out, values[self._monitor], drive.phase.frequency_hz)

    @property
    def put_out(self) -> FloatArray:
        """(samples,) V, of the last block; of several exciters the first."""
        first: FloatArray = self.outputs[0]
        return first

    @property
    def turn_time(self) -> float:
        """s, of the converter's turns."""
        return 0.0 if self.link is None else self.link.last_report.turn / self._sample_rate

    @property
    def overloaded(self) -> tuple[str, ...]:
        """Channels that were at the end of their range in the last block."""
        over = np.any(np.abs(self.measured) >= self._end_stops, axis=1)
        return tuple(entry.channel for entry, bad in zip(self.section.inputs, over, strict=True) if bad)

    @property
    def figures(self) -> ConverterFigures:
        """Delay, drift, clock and losses so far."""
        if self.link is None:
            return ConverterFigures(1, 1, -1, 1.0, math.nan, self._clock.ppm, 0)
        report = self.link.last_report
        return ConverterFigures(
            report.delay,
            report.delay + report.turn,
            report.stated,
            report.monitor_gain / (float(self._sensitivity[self._monitor, 0]) if self._monitor >= 0 else 1.0),
            self._delays.drift,
            self._clock.ppm,
            report.lost_turns,
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence for each warning level passed, and for a clock or a delay that moves."""
        own = [self._clock.sentence, self._delays.sentence]
        return (*super().warnings, *(each for each in own if each))

    def _close(self) -> None:
        pass
