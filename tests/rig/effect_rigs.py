"""Small rigs for the tests of single effects."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from nmt_core.messages.records import DriveCommand
from nmt_core.vocabulary import Waveform
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_rig.rig import Rig, load_rig, validate_rig
from nmt_rig.rig_file import RigDocument

RATE = 10_000.0
MASS, SPRING, DAMPER = 0.5, 20_000.0, 2.0


def rig_of(values: dict[str, Any]) -> Rig:
    """Rig of plain values."""
    return validate_rig(RigDocument("test", values, {}))


def oscillator(elements: Sequence[dict[str, Any]] = (), **changes: Any) -> Rig:
    """One mass on a spring, ideal force, force, displacement and acceleration sensors; `changes` at top level."""
    values: dict[str, Any] = {
        "name": "oscillator",
        "structure": {
            "kind": "chain",
            "masses_kg": [MASS],
            "ground_springs_n_m": [SPRING],
            "ground_dampers_ns_m": [DAMPER],
        },
        "local_elements": list(elements),
        "exciter": {"kind": "force", "point": 1},
        "sensors": [
            {"quantity": "force", "point": "drive"},
            {"quantity": "displacement", "point": 1},
            {"quantity": "acceleration", "point": 1},
            {"quantity": "voltage"},
        ],
        "extraction": {"linear_modes": 1},
        "watchdog": {"blocks": 0},
    }
    values.update(changes)
    return rig_of(values)


def beam(*overrides: str) -> Rig:
    """The paper's beam with changes, watchdog off."""
    return load_rig("beam", ["watchdog.blocks=0", *overrides])


def run(rig: Rig, frequency_hz: float, volts: float, seconds: float, block: int = 200) -> dict[str, np.ndarray]:
    """Channels of a sine test from rest; the drive steps to its amplitude at sample 0."""
    device = SimulatedRig(rig, block)
    device.configure()
    device.start()
    device.write(DriveCommand(Waveform.SINE, frequency_hz, volts))
    parts: dict[str, list[np.ndarray]] = {}
    for _ in range(round(seconds * rig.sample_rate_hz / block)):
        for item in device.read():
            for name, row in zip(item.channels, item.data, strict=True):
                parts.setdefault(name, []).append(row)
    return {name: np.concatenate(rows) for name, rows in parts.items()}


def harmonic(values: np.ndarray, frequency_hz: float, order: int = 1, rate: float = RATE, periods: int = 10) -> complex:
    """Complex amplitude over the last periods (a whole number of samples each is the caller's affair)."""
    count = round(periods * rate / frequency_hz)
    first = values.size - count
    phase = 2 * np.pi * order * frequency_hz * np.arange(first, values.size) / rate
    return complex(2.0 / count * values[first:] @ np.exp(-1j * phase))
