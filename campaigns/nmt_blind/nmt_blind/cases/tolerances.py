"""What an ordinary laboratory's measuring chain is off by, drawn for every case; none of it is a fault.

Gains by the calibration sheet, phases of conditioners (the high-pass of a sensor with built-in electronics), delays of
filters and multiplexers, a drive with zero-order hold and harmonics, channels
with and without an anti-alias filter, a clock that is some ten parts in a million off, a trace of the mains. How large
stands in :mod:`nmt_core.tolerances`: shared delays within ± theirs, hum and harmonics up to theirs, the rest normal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from nmt_blind.cases.laboratory_rig import Converters
from nmt_blind.cases.operating import Operating
from nmt_blind.cases.rig_edits import Edit
from nmt_core.errors import BenchError
from nmt_core.tolerances import TOLERANCES
from nmt_rig.rig import Rig

FILTERED = 0.5
"""Share of laboratories whose channels have an anti-alias filter."""

# Beyond so many standard deviations a calibration would have noticed.
_LARGEST = 2.5
LEAST_LEAD = 0.95
"""A channel can lead by one sample at most."""


@dataclass(frozen=True)
class DrawnChain:
    """The measuring chain of one case.

    Attributes:
        gains: factor of each sensor of the rig file.
        leads: phase lead of each at the mode that is tested, rad; 0 where the sensor measures constants too.
        delays: of each, s.
        hums: amplitude of the mains of each, recorded units.
        clock: relative error of the clock.
        converters: what they make of the drive and of the channels.
    """

    gains: tuple[float, ...]
    leads: tuple[float, ...]
    delays: tuple[float, ...]
    hums: tuple[float, ...]
    clock: float
    converters: Converters

    def edits(self, truth: Rig, omega: float) -> tuple[Edit, ...]:
        """Changes of a rig that add the chain to what its sensors are.

        Args:
            truth: the rig with its effects.
            omega: of the mode that is tested, rad/s.
        """
        edits: list[Edit] = []
        latest = -LEAST_LEAD / truth.sample_rate_hz
        for index, sensor in enumerate(truth.sensors):
            path = ("sensors", index)
            edits.append(Edit((*path, "gain"), sensor.gain * self.gains[index]))
            edits.append(Edit((*path, "delay_s"), max(sensor.delay_s + self.delays[index], latest)))
            if sensor.high_pass_hz is None and self.leads[index] > 0.0:
                corner = omega / (2.0 * math.pi) * math.tan(self.leads[index])
                edits.append(Edit((*path, "high_pass_hz"), corner))
            if sensor.hum_amplitude == 0.0:
                edits.append(Edit((*path, "hum_amplitude"), self.hums[index]))
        edits.append(Edit(("clock_error",), truth.clock_error + self.clock))
        return tuple(edits)


def has_lead(quantity: str) -> bool:
    """Whether sensors of a quantity have a high-pass: force cells and accelerometers do."""
    return quantity in ("force", "acceleration")


def draw_chain(model: Rig, operating: Operating, generator: np.random.Generator) -> DrawnChain:
    """A healthy measuring chain.

    Args:
        model: the rig as it is believed to be.
        operating: its motion, for the size of each channel.
        generator: of random numbers.
    """
    count = len(model.sensors)

    def normal() -> np.ndarray[Any, np.dtype[np.float64]]:
        return np.clip(generator.standard_normal(count), -_LARGEST, _LARGEST)

    gains = 1.0 + TOLERANCES.gain * normal()
    leads = math.radians(TOLERANCES.phase_deg) * np.abs(normal())
    kinds = list(dict.fromkeys(sensor.quantity for sensor in model.sensors))
    largest = TOLERANCES.shared_delay_s
    shared = dict(zip(kinds, generator.uniform(-largest, largest, len(kinds)), strict=True))
    delays = TOLERANCES.delay_s * normal() + np.array([shared[sensor.quantity] for sensor in model.sensors])
    hums = TOLERANCES.mains * generator.random(count)
    clock = TOLERANCES.clock * float(np.clip(generator.standard_normal(), -_LARGEST, _LARGEST))
    sizes = TOLERANCES.drive_harmonic * generator.random(2) * (0.5, 1.0)
    turns = np.exp(2j * np.pi * generator.random(2))
    voltage = [sensor.quantity == "voltage" for sensor in model.sensors]
    names = [model.sensor_channel(sensor) for sensor in model.sensors]
    return DrawnChain(
        tuple(float(gain) for gain in gains),
        tuple(float(lead) if has_lead(s.quantity) else 0.0 for lead, s in zip(leads, model.sensors, strict=True)),
        # Delays count against the drive's own channel.
        tuple(0.0 if is_voltage else float(delay) for delay, is_voltage in zip(delays, voltage, strict=True)),
        tuple(
            0.0 if is_voltage else float(hum) * operating.channels.get(name, 0.0)
            for hum, is_voltage, name in zip(hums, voltage, names, strict=True)
        ),
        clock,
        Converters(
            True,
            bool(generator.random() < FILTERED),
            tuple((n, complex(size * turn)) for n, size, turn in zip((2, 3), sizes, turns, strict=True)),
        ),
    )


TOLERANCE_SETS = ("laboratory", "none")


def check_tolerances(name: str) -> str:
    """The name of a set of tolerances.

    Raises:
        BenchError: there is none of that name.
    """
    if name not in TOLERANCE_SETS:
        raise BenchError(f"There are no tolerances '{name}'; choose from {', '.join(TOLERANCE_SETS)}.")
    return name
