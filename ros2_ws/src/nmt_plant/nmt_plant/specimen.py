"""A simulated rig behind a converter's ports: volts at the output port in, volts at the input ports out.

It is what stands on the other side of the cables: amplifier, exciter, structure, sensors with their sensitivities, and
the converter that samples them, with noise, resolution, range and a clock of its own. For tests and for teaching.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_plant.specimen_faults import Fault, Wiring
from nmt_rig.device_sections import DeviceSection
from nmt_rig.rig import Rig

_ORDER = 4  # samples on either side of an interpolated one
_SLACK = 256  # samples that a clock which runs ahead may gain before it slips


class Specimen:
    """The rig as seen from the ports, block by block.

    Args:
        rig: what is simulated.
        device: the ports.
        bits: resolution of the converter.
        noise: V rms at a port of 10 V range; proportionally less at a smaller one.
        clock_error: of the converter's clock against that of whoever asks, relative; the specimen's samples then drift
            against the asker's, as with two devices that share no clock.
        delay: more samples from the output port to the input ports.
        faults: planted ones, see `specimen_faults`.
        seed: of the noise; None = the rig's.
    """

    def __init__(
        self,
        rig: Rig,
        device: DeviceSection,
        bits: int = 24,
        noise: float = 2e-5,
        clock_error: float = 0.0,
        delay: int = 0,
        faults: Sequence[Fault] = (),
        seed: int | None = None,
    ) -> None:
        self.wiring = Wiring(rig, device, faults)
        self._rig = SimulatedRig(self.wiring.rig)
        self._rig.configure()
        self._rig.integrator.reset()
        channels = [sensor.channel for sensor in self._rig.sensors]
        self._rows = [channels.index(entry.channel) for entry in device.inputs]
        self._monitors = [n for n, each in enumerate(self._rig.sensors) if each.quantity is Quantity.VOLTAGE]
        self._sensitivity = np.array([[entry.sensitivity_v] for entry in device.inputs])
        self._range = np.array([[entry.range_v] for entry in device.inputs])
        self._monitor_of = [(rig.sensors[n].exciter or 1) - 1 for n in self._monitors]
        self._gain = np.array([[entry.amplifier_gain] for entry in device.outputs])
        self._output_range = np.array([[entry.range_v] for entry in device.outputs])
        self._step = 2.0 * self._range / 2.0**bits
        self._noise = noise * self._range / 10.0
        start = rig.seed if seed is None else seed
        self._random = np.random.default_rng([start, zlib.crc32(b"specimen")])
        self._last = np.zeros((len(device.outputs), 1))
        self._clock_error = clock_error
        self._wait = float(delay + (_SLACK if clock_error < 0.0 else _ORDER if clock_error else 0))
        self._line = np.zeros((len(self._rows), int(self._wait) + 2 * _ORDER + 1))
        self._time = 0

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the input ports, in their order."""
        return tuple(self._rig.sensors[row].channel for row in self._rows)

    @property
    def input_ranges(self) -> tuple[float, ...]:
        """V, of the input ports."""
        return tuple(float(value) for value in self._range[:, 0])

    @property
    def output_ranges(self) -> tuple[float, ...]:
        """V, of the output ports."""
        return tuple(float(value) for value in self._output_range[:, 0])

    @property
    def outputs(self) -> int:
        """Number of output ports."""
        return self._output_range.size

    @property
    def seconds(self) -> float:
        """Time that has passed by the specimen's own clock, s."""
        return self._time / self._rig.true_sample_rate

    @property
    def inputs(self) -> int:
        """Number of input ports."""
        return len(self._rows)

    def respond(self, port: FloatArray) -> FloatArray:
        """Volts at the input ports, (inputs, n), while these volts are at the output ports; a sample later.

        Args:
            port: (outputs, n), or (n,) of one output.

        Raises:
            ValueError: not as many rows as there are outputs.
        """
        volts_out = np.atleast_2d(port)
        if len(volts_out) != self.outputs:
            raise ValueError(f"{len(volts_out)} rows of volts for {self.outputs} outputs")
        clipped = np.clip(volts_out, -self._output_range, self._output_range)
        voltage = np.concatenate([self._last, self._gain * clipped], axis=1)
        self._last = voltage[:, -1:]
        driven = self.wiring.drive(voltage)
        values = self._rig.respond(driven)
        values[self._monitors] = voltage[self._monitor_of, :-1]  # the monitor is before the exciter
        volts = self._sensitivity * values[self._rows]
        late = self._late(volts)
        noisy = late + self._noise * self._random.standard_normal(late.shape)
        sensed = self.wiring.sense(noisy, self._rig.sample_rate)
        return np.clip(np.round(sensed / self._step) * self._step, -self._range, self._range - self._step)

    def _late(self, volts: FloatArray) -> FloatArray:
        """The same after the delay, which the clock's error moves on."""
        n = volts.shape[1]
        self._line = np.concatenate([self._line, volts], axis=1)
        end = self._line.shape[1] - n
        drift = self._clock_error * (self._time + np.arange(n)) + self.wiring.delay(self._time, n)
        self._time += n
        delay = self._wait + drift
        if not self._clock_error and not self.wiring.delay_moves:
            first = end - int(self._wait)
            late = self._line[:, first : first + n]
        else:
            late = _interpolated(self._line, end + np.arange(n) - np.maximum(delay, float(_ORDER)))
        keep = int(max(delay[-1], self._wait)) + 4 * _ORDER + n
        self._line = self._line[:, -keep:]
        return np.asarray(late)


def write_port(path: Path, values: FloatArray, times: FloatArray | Sequence[tuple[float, int]]) -> None:
    """Write what was at an output port as a NumPy archive.

    Args:
        path: of the file.
        values: V, (samples,), or (outputs, samples) of several outputs.
        times: s on the steady clock, and how many samples had passed then.
    """
    with path.open("wb") as file:
        np.savez(file, values=values, times=np.array(times, dtype=np.float64).reshape(-1, 2))


def _interpolated(line: FloatArray, at: FloatArray) -> FloatArray:
    """Band-limited values of (channels, samples) between the samples, by a windowed sinc over eight of them."""
    at = np.clip(at, _ORDER, line.shape[1] - _ORDER - 1.0)
    whole = np.floor(at).astype(int)
    offsets = np.arange(1 - _ORDER, 1 + _ORDER)
    distance = (at - whole)[:, None] - offsets
    weights = np.sinc(distance) * np.cos(0.5 * np.pi * distance / (_ORDER + 0.5)) ** 2
    weights /= weights.sum(axis=1, keepdims=True)
    return np.asarray(np.einsum("cnk,nk->cn", line[:, whole[:, None] + offsets], weights))
