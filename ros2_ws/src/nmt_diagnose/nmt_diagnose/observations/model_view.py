"""What the reading of observations asks of the model: its channels, and its linear response for plausibility."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_diagnose.effects.rig_edit import with_exciters_at
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.linear_description import linear_description
from nmt_rig.model.assembly import ElectromechanicalSystem
from nmt_rig.model.linear_modes import damped_modes, sticking_modes
from nmt_rig.rig import Rig
from nmt_rig.rig_model import build_elements, build_structure, build_system, inputs_per_volt

RIGID = 1e-6
"""Of the highest frequency, below which a body is free."""


@dataclass(frozen=True)
class ModelView:
    """Channels and linear behaviour of a rig with its exciters where a test had them.

    Attributes:
        rig: the model with the exciters of the test.
        system: its equations.
        shape: target mode at the drive point, 1/√kg.
        frequencies_hz: linear frequencies of structure alone and with exciter.
        modes_hz: linear frequencies of the structure alone.
    """

    rig: Rig
    system: ElectromechanicalSystem
    shape: float
    frequencies_hz: tuple[float, ...]
    modes_hz: tuple[float, ...]

    @classmethod
    def of(cls, rig: Rig, drive_points: Sequence[int]) -> ModelView:
        """View of a rig driven at points of its own, or at another one."""
        rig = with_exciters_at(rig, drive_points)
        try:
            linear = linear_description(rig)
        except BenchError:  # its target mode does not swing: what needs one that does says so
            system, structure = build_system(rig), build_structure(rig)
            alone = sticking_modes(structure, build_elements(rig, structure)).frequencies
            plant = np.abs(damped_modes(system).eigenvalues.imag)
            modes, swinging = (_swinging(found) for found in (alone, np.concatenate([alone, plant])))
            return cls(rig, system, 0.0, swinging, modes)
        modes = tuple(value / (2.0 * math.pi) for value in linear.frequencies_rad_s)
        hertz = (*modes, linear.plant_frequency_rad_s / (2.0 * math.pi))
        return cls(rig, build_system(rig), linear.drive_point_shape, tuple(sorted(hertz)), modes)

    def swinging_hz(self, duration_s: float, highest_hz: float) -> tuple[float, ...]:
        """Frequencies of modes that swing some times within a duration, friction sticking, Hz.

        Args:
            duration_s: s.
            highest_hz: of modes that samples show, Hz.
        """
        lowest_hz = THRESHOLDS.reading.imposed_fewest_periods / duration_s
        modes = damped_modes(self.system)
        hertz = np.abs(modes.eigenvalues.imag) / (2.0 * math.pi)
        return tuple(float(value) for value in hertz if lowest_hz <= value < highest_hz)

    @property
    def channels(self) -> tuple[MeasuredChannel, ...]:
        """Channels that the model predicts."""
        rig = self.rig
        return tuple(
            MeasuredChannel(
                rig.sensor_channel(sensor),
                Quantity[sensor.quantity.upper()],
                rig.sensor_point(sensor),
                turns=rig.coordinate == "angle",
            )
            for sensor in rig.sensors
        )

    def far_from_modes(self, frequency_hz: FloatArray) -> bool:
        """Whether no frequency is near a mode, friction sticking: motion there is not vibration of the structure."""
        modes = self.swinging_hz(math.inf, math.inf)
        ratios = [nearest_ratio(float(value), modes) for value in frequency_hz] if modes else []
        return all(max(ratio, 1.0 / ratio) > THRESHOLDS.reading.wrong_frequency_ratio for ratio in ratios)

    def voltages(self, recorded: Sequence[MeasuredChannel]) -> tuple[str, ...]:
        """Names of the recorded voltage of each exciter, in their order; empty text where there is none."""
        names = [channel.name for channel in recorded if channel.quantity is Quantity.VOLTAGE]
        exciters = range(1, len(self.rig.all_exciters) + 1)
        by_exciter = {s.exciter or 1: self.rig.sensor_channel(s) for s in self.rig.sensors if s.quantity == "voltage"}
        found = tuple(by_exciter.get(exciter, "") for exciter in exciters)
        if not set(found) <= set(names) and len(names) >= len(found):
            return tuple(names[: len(found)])
        return tuple(name if name in names else "" for name in found)

    def responses(
        self, channels: Sequence[MeasuredChannel], frequency_hz: FloatArray, terms: Sequence[complex] = (1.0,)
    ) -> ComplexArray:
        """Linear responses to a drive, sensors ideal, shape (channels, frequencies); NaN where there is none.

        Args:
            channels: of the responses.
            frequency_hz: Hz.
            terms: drive of each exciter, V; those left out have none.
        """
        system = self.system
        volts = inputs_per_volt(self.rig)
        ports = system.exciters[: len(terms)]
        shares = [term * gain / volts[0] for term, gain in zip(terms, volts, strict=False)]
        s = 2j * math.pi * np.asarray(frequency_hz, dtype=np.float64)[:, np.newaxis, np.newaxis]
        stiffness, damping = system.sticking_stiffness(), system.resting_damping()
        impedance = np.asarray(stiffness + s * damping + s * s * system.mass, dtype=np.complex128)
        loads = sum(share * port.input_vector for share, port in zip(shares, ports, strict=True))
        unit = np.broadcast_to(np.asarray(loads, dtype=complex)[:, np.newaxis], (*impedance.shape[:2], 1))
        motion = _solved(impedance, unit)[:, :, 0].T
        s = s[:, 0, 0]
        shares += [0.0] * (len(volts) - len(shares))
        values = np.full((len(channels), s.size), complex(math.nan))
        scale = volts[0]
        for index, channel in enumerate(channels):
            if channel.quantity is Quantity.VOLTAGE:
                values[index] = terms[min(self._exciter_of(channel), len(terms) - 1)]
            elif channel.quantity is Quantity.FORCE:
                at = self.rig.exciter_points.index(channel.point) if channel.point in self.rig.exciter_points else 0
                row = system.exciters[at].force
                force = s * s * (row.acceleration @ motion) + s * (row.velocity @ motion) + row.displacement @ motion
                values[index] = scale * (force + row.feedthrough * shares[at])
            elif channel.quantity is Quantity.CURRENT and system.current is not None:
                values[index] = scale * motion[system.exciters[self._exciter_of(channel)].current]
            elif channel.quantity in MOTIONS and channel.point in system.point_numbers:
                values[index] = scale * system.motion(channel.point, motion) * s ** MOTIONS[channel.quantity]
        return values

    def _exciter_of(self, channel: MeasuredChannel) -> int:
        """Number of the exciter, from 0, that a voltage or current of the model belongs to."""
        sensors = (s for s in self.rig.sensors if self.rig.sensor_channel(s) == channel.name)
        return next(((sensor.exciter or 1) - 1 for sensor in sensors), 0)


def _swinging(frequencies: FloatArray) -> tuple[float, ...]:
    """Those of some angular frequencies, rad/s, that are not of a body at rest or drifting, Hz, ascending."""
    hertz = np.sort(frequencies) / (2.0 * math.pi)
    return tuple(float(value) for value in hertz if value > RIGID * hertz[-1])


def _solved(impedance: ComplexArray, load: ComplexArray) -> ComplexArray:
    """Motion (lines, n, 1) under loads; NaN at lines where a free body or an undamped mode has none."""
    try:
        return np.asarray(np.linalg.solve(impedance, load))
    except np.linalg.LinAlgError:
        result = np.full(load.shape, complex(math.nan, math.nan))
        for line, matrix in enumerate(impedance):
            with contextlib.suppress(np.linalg.LinAlgError):
                result[line] = np.linalg.solve(matrix, load[line])
        return result


def matched(
    channels: tuple[MeasuredChannel, ...], view: ModelView
) -> tuple[dict[str, MeasuredChannel], tuple[str, ...]]:
    """The model's channel for each recorded one, by quantity and point.

    Returns:
        The model's channel by recorded name, and sentences on what has no counterpart.
    """
    by_place = {(channel.quantity, channel.point): channel for channel in reversed(view.channels)}
    by_name = {channel.name: channel for channel in view.channels}
    result: dict[str, MeasuredChannel] = {}
    notes = []
    for channel in channels:
        model_channel = by_name.get(channel.name)
        if model_channel is None or (model_channel.quantity, model_channel.point) != (channel.quantity, channel.point):
            model_channel = by_place.get((channel.quantity, channel.point))
        if channel.quantity is Quantity.FORCE and model_channel is None:
            model_channel = next((c for c in view.channels if c.quantity is Quantity.FORCE), None)
        if model_channel is not None and model_channel.name not in {c.name for c in result.values()}:
            result[channel.name] = model_channel
        else:
            place = f" at point {channel.point}" if channel.point else ""
            notes.append(
                f"Channel {channel.name} ({channel.quantity.name.lower()}{place}) has no counterpart among the model's "
                "sensors and is left out; add the sensor to the rig file to use it."
            )
    taken = {channel.name for channel in result.values()}
    missing = [channel.name for channel in view.channels if channel.name not in taken]
    if missing:
        verb = "was" if len(missing) == 1 else "were"
        notes.append(f"Of the model's channels, {', '.join(missing)} {verb} not recorded.")
    return result, tuple(notes)


def nearest_ratio(frequency_hz: float, frequencies_hz: tuple[float, ...]) -> float:
    """Frequency over the nearest of several, on a logarithmic scale.

    Raises:
        BenchError: there is none.
    """
    if not frequencies_hz:
        raise BenchError(
            "the model has no mode that swings, and this test needs one; give the structure a restoring force, or "
            "record force and motion and write held: response in the sidecar's segment"
        )
    logs = np.log(frequency_hz / np.asarray(frequencies_hz))
    return float(np.exp(logs[np.argmin(np.abs(logs))]))
