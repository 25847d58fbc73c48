"""Loopback device: output wired to input, as on a bench without a structure.

The force channel records `newton_per_volt` times the drive voltage, delayed by `delay_samples`; the
acceleration channel records the same in m/s². For checking cabling, sequencing and phase without a rig.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_plant.devices.guarded_device import ChannelGroup, GuardedDevice, GuardSettings, owned_output
from nmt_plant.oscillator import OscillatorBlock


class LoopbackDevice(GuardedDevice):
    """Loopback with voltage limit and watchdog.

    Args:
        sample_rate: Hz.
        block_samples: samples in a block.
        newton_per_volt: gain of the force channel; that of the acceleration channel has the same figure.
        delay_samples: delay of both.
        voltage_limit: V.
        watchdog_blocks: blocks without a command that trip; 0 = off.
        quiet_ramp: s, ramp to zero after a trip.
        point: measurement point of both channels.
        owned: whether a process of its own owns the converter, for real time; what is put out comes back through it.
        **output: settings of `guarded_device.owned_output`; ``arguments`` are other ones of
            `converter.LoopbackConverter`, which that process then has.
    """

    def __init__(
        self,
        sample_rate: float = 10_000.0,
        block_samples: int = 200,
        newton_per_volt: float = 1.0,
        delay_samples: int = 0,
        voltage_limit: float = 10.0,
        watchdog_blocks: int = 50,
        quiet_ramp: float = 0.1,
        point: int = 1,
        owned: bool = False,
        **output: Any,
    ) -> None:
        channels = (
            (Quantity.FORCE, f"f{point}", point),
            (Quantity.ACCELERATION, f"a{point}", point),
            (Quantity.VOLTAGE, "u", 0),
        )
        settings = GuardSettings({Quantity.VOLTAGE: voltage_limit}, quiet_ramp, watchdog_blocks, quiet_ramp)
        output = {
            "converter": "nmt_plant.converters.converter:LoopbackConverter",
            "inputs": 1,
            **output,
            "arguments": {"sample_rate": sample_rate, **output.get("arguments", {})},
        }
        super().__init__(
            sample_rate,
            int(block_samples),
            [
                ChannelGroup(quantity, quantity.unit, (name,), (at,), slice(row, row + 1))
                for row, (quantity, name, at) in enumerate(channels)
            ],
            settings,
            output=owned_output(sample_rate, int(block_samples), settings, **output) if owned else None,
        )
        self._gain, self._delay = newton_per_volt, delay_samples
        self._prepare()

    def _prepare(self) -> None:
        super()._prepare()
        self._delayed = np.zeros(self._delay)

    @property
    def is_quiet(self) -> bool:
        """Whether the drive is at zero and no command waits, unless tripped."""
        return self._at_zero and (bool(self._reason) or not self._pending)

    def _configure(self) -> None:
        pass

    def _measure(self, drive: OscillatorBlock) -> FloatArray:
        n = self._block_samples
        voltage = drive.voltage[:n]
        line = np.concatenate([self._delayed, self.measured[0] if self.is_owned else voltage])
        delayed, self._delayed = self._gain * line[:n], line[n:]
        return np.stack([delayed, delayed, voltage])

    def _close(self) -> None:
        pass
