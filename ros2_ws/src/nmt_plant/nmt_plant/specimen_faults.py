"""Faults of wiring, sensors and converter that can be planted behind the ports of a simulated specimen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_rig.device_sections import DeviceSection
from nmt_rig.rig import Rig, SensorSection
from nmt_signals.channel_faults.mains_lines import MAINS_HZ

FAULTS = {
    "noise": "the channel's noise floor is 300 times as high",
    "mains": "50 Hz of 1 % of the range on the channel",
    "offset": "DC offset of 20 % of the range on the channel",
    "overload": "an input amplifier at its end stops: a square wave of the full range",
    "open": "cable off: noise and a little hum, no signal",
    "short": "input short-circuited: exactly zero",
    "icp": "supply of the sensor is dead: the input sits at its bias rail",
    "sign": "the channel's sign is wrong",
    "force_response": "cables of the force and of the drive point's response are exchanged",
    "permuted": "cables of two response channels are exchanged",
    "sensitivity": "the channel's sensitivity is 40 % too high",
    "late": "the channel is 3 ms late",
    "no_drive": "the exciter does not move: amplifier of",
    "rate": "the converter's clock is 1 % of",
    "delay": "the delay moves by 40 samples now and then",
    "resonance": "the structure is 15 % stiffer than its file says",
}
"""Name and what is wrong."""


_LATE = 3e-3  # s


class Fault(NamedTuple):
    """A planted fault.

    Attributes:
        name: of `FAULTS`.
        channel: that has it; empty where it belongs to none.
        from_v: drive at the exciter from which on a channel has it, V; 0 = it always has.
    """

    name: str
    channel: str = ""
    from_v: float = 0.0


def parse_fault(text: str) -> Fault:
    """Fault from ``name``, ``name:channel`` or ``name:channel@volts``.

    Raises:
        BenchError: there is none of that name, or the volts are no number.
    """
    what, _, volts = text.partition("@")
    name, _, channel = what.partition(":")
    if name not in FAULTS:
        raise BenchError(f"There is no fault '{name}'; there are {', '.join(FAULTS)}.")
    try:
        return Fault(name, channel, float(volts or 0.0))
    except ValueError:
        raise BenchError(f"Fault '{text}': '{volts}' is not a drive in V, as in 'short:x6@0.5'.") from None


class Wiring:
    """What faults do to drive and signals.

    Args:
        rig: healthy.
        device: the ports.
        faults: planted ones.

    Attributes:
        rig: as it is behind the ports.
        delay_moves: whether `delay` is ever other than zero.

    Raises:
        BenchError: a fault names a channel that is not there.
    """

    def __init__(self, rig: Rig, device: DeviceSection, faults: Sequence[Fault]) -> None:
        self._names = [entry.channel for entry in device.inputs]
        self._range = np.array([entry.range_v for entry in device.inputs])
        quantities = {rig.sensor_channel(sensor): sensor for sensor in rig.sensors}
        for fault in faults:
            if fault.channel and fault.channel not in self._names:
                raise BenchError(f"There is no channel {fault.channel}; there are {', '.join(self._names)}.")
        self._faults = [(fault.name, self._row(fault), fault.from_v) for fault in faults]
        self._highest = 0.0
        names = {fault.name for fault in faults}
        self.dead = "no_drive" in names
        self.delay_moves = "delay" in names
        self._order = list(range(len(self._names)))
        for fault in faults:
            if fault.name == "force_response":
                force = next(name for name, sensor in quantities.items() if sensor.quantity == "force")
                response = next(
                    name
                    for name, sensor in quantities.items()
                    if sensor.quantity in ("acceleration", "displacement", "velocity")
                    and rig.sensor_point(sensor) == rig.drive_point
                )
                self._exchange(force, response)
            if fault.name == "permuted":
                self._exchange(*self._pair(rig, quantities, fault.channel))
        changes: dict[str, object] = {}
        if "rate" in names:
            changes["clock_error"] = 0.01
        if "resonance" in names:
            changes["structure"] = _stiffer(rig)
        self.rig = rig.model_copy(update=changes) if changes else rig
        self._random = np.random.default_rng(7)
        self._time = 0
        self._before = np.zeros((len(self._names), 0))

    def _row(self, fault: Fault) -> int:
        return self._names.index(fault.channel) if fault.channel else 0

    def _pair(self, rig: Rig, sensors: Mapping[str, SensorSection], channel: str) -> tuple[str, str]:
        """Two channels of one quantity at different points, the first as named."""
        response = [name for name, sensor in sensors.items() if sensor.quantity == rig.extraction.quantity]
        first = channel or response[0]
        return first, next(name for name in reversed(response) if name != first)

    def _exchange(self, one: str, other: str) -> None:
        i, j = self._names.index(one), self._names.index(other)
        self._order[i], self._order[j] = self._order[j], self._order[i]

    def drive(self, voltage: FloatArray) -> FloatArray:
        """What the exciter gets of the amplifier's voltage."""
        self._highest = max(self._highest, float(np.abs(voltage).max(initial=0.0)))
        return 0.0 * voltage if self.dead else voltage

    def delay(self, first: int, count: int) -> FloatArray:
        """Further samples of delay at these samples."""
        if not self.delay_moves:
            return np.zeros(count)
        return np.asarray(40.0 * (((first + np.arange(count)) // 40_000) % 2), dtype=np.float64)

    def sense(self, volts: FloatArray, sample_rate: float) -> FloatArray:
        """What arrives at the ports, (inputs, n) V, of the sensors' volts."""
        arrived = volts[self._order].copy()
        n = volts.shape[1]
        late = round(_LATE * sample_rate)
        line = np.concatenate([self._before, arrived], axis=1)
        self._before = line[:, -late:]
        time = (self._time + np.arange(n)) / sample_rate
        self._time += n
        for name, row, from_v in self._faults:
            if self._highest < from_v:
                continue
            full = self._range[row]
            match name:
                case "noise":
                    arrived[row] += 300.0 * 2e-5 * self._random.standard_normal(n) * full / 10.0
                case "mains":
                    arrived[row] += 0.01 * full * np.sin(2 * np.pi * MAINS_HZ[0] * time)
                case "offset":
                    arrived[row] += 0.2 * full
                case "overload":
                    arrived[row] = np.where(np.sin(2 * np.pi * 3.0 * time) >= 0.0, 2.0 * full, -2.0 * full)
                case "open":
                    arrived[row] = 5e-5 * full * np.sin(2 * np.pi * MAINS_HZ[0] * time)
                    arrived[row] += 4e-6 * full * self._random.standard_normal(n)
                case "short":
                    arrived[row] = 0.0
                case "icp":
                    arrived[row] = 0.9 * full + 2e-6 * full * self._random.standard_normal(n)
                case "sign":
                    arrived[row] *= -1.0
                case "late":
                    whole = np.concatenate([np.zeros(late), line[row]])
                    arrived[row] = whole[whole.size - n - late : whole.size - late]
                case "sensitivity":
                    arrived[row] *= 1.4
        return arrived


def _stiffer(rig: Rig) -> object:
    """The structure with 15 % more stiffness."""
    structure = rig.structure
    for key in ("youngs_modulus_pa", "stiffness_n_m"):
        value = getattr(structure, key, None)
        if isinstance(value, float):
            return structure.model_copy(update={key: 1.15 * value})
        if isinstance(value, list):
            return structure.model_copy(update={key: [1.15 * each for each in value]})
    raise BenchError("The fault resonance needs a beam or a chain.")
