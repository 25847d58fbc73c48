"""Tests of rigs, as conditions and rows, for the tests of the prediction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.locked_windows import LockedWindows
from nmt_diagnose.measurements.measurement import LockedLevel
from nmt_diagnose.measurements.random_responses import RandomResponses
from nmt_diagnose.observations.observables import Part, Rows
from nmt_rig.rig import Rig, validate_rig
from nmt_rig.rig_file import RigDocument

SHAKER = {
    "kind": "electrodynamic_shaker", "point": 1, "table_mass_kg": 0.024, "table_stiffness_n_m": 20707.0,
    "table_damping_ns_m": 28.33, "coil_mass_kg": 0.019, "coil_stiffness_n_m": 8.42e7, "coil_damping_ns_m": 57.17,
    "force_factor_n_a": 15.48, "inductance_h": 140e-6, "resistance_ohm": 3.0,
}  # fmt: skip
IDS = ("test", "level", "channel", "harmonic", "part")


def chain(**changes: Any) -> Rig:
    """Two masses with a friction joint between them, shaker at the first."""
    values: dict[str, Any] = {
        "name": "pair",
        "structure": {
            "kind": "chain",
            "masses_kg": [0.5, 0.3],
            "springs_n_m": [15000.0],
            "dampers_ns_m": [5.0],
            "ground_springs_n_m": [20000.0, 3000.0],
            "ground_dampers_ns_m": [4.0, 1.0],
        },
        "local_elements": [
            {"kind": "jenkins", "point": 2, "other_point": 1, "tangential_stiffness_n_m": 3000.0, "slip_force_n": 0.1}
        ],
        "exciter": dict(SHAKER),
        "sensors": [
            {"quantity": "force", "point": "drive"},
            {"quantity": "displacement", "point": 1},
            {"quantity": "acceleration", "point": 2},
            {"quantity": "voltage"},
        ],
        "extraction": {"linear_modes": 1},
        "watchdog": {"blocks": 0},
    }
    values.update(changes)
    return validate_rig(RigDocument("test", values, {}))


def channels_of(rig: Rig) -> tuple[MeasuredChannel, ...]:
    """All channels of a rig."""
    return tuple(
        MeasuredChannel(rig.sensor_channel(s), Quantity[s.quantity.upper()], rig.sensor_point(s)) for s in rig.sensors
    )


def rows_of(table: Sequence[tuple[int, int, int, int, Part]], frequency: float = 0.0) -> Rows:
    """Rows of (test, level, channel, harmonic, part)."""
    ids = np.array([[int(entry) for entry in row] for row in table], dtype=np.int64).reshape(-1, 5)
    zero = np.zeros(len(table))
    return Rows(*(ids[:, i] for i in range(5)), zero, zero + frequency, zero)


def level(drive: float, frequency: float, phase: float = 0.0, start: float = 0.0, cycles: float = 0.0) -> LockedLevel:
    """One locked window."""
    return LockedLevel(0, drive, phase, 0.0, frequency, start, start, cycles, 1, drive)


def locked(
    rig: Rig, levels: Sequence[LockedLevel], response: str, test: int = 0, harmonics: int = 5, held: str = "voltage"
) -> tuple[LockedWindows, list[tuple[int, int, int, int, Part]]]:
    """A test of locked windows with all observables of all channels."""
    channels = channels_of(rig)
    conditions = LockedWindows(f"locked {test}", rig.exciter_points, response, channels, harmonics, held, tuple(levels))
    table: list[tuple[int, int, int, int, Part]] = []
    for position in range(len(levels)):
        table += [(test, position, -1, -1, Part.LOG_FREQUENCY), (test, position, -1, -1, Part.PHASE_ERROR)]
        for channel in range(len(channels)):
            table += [(test, position, channel, 1, Part.LOG_MAGNITUDE), (test, position, channel, 1, Part.PHASE)]
            for order in (0, *range(2, harmonics + 1)):
                table += [(test, position, channel, order, Part.REAL), (test, position, channel, order, Part.IMAG)]
    return conditions, table


def noise_test(
    rig: Rig, low: float, high: float, count: int, test: int = 0, reference: str = "voltage", window: str = "hann"
) -> tuple[RandomResponses, list[tuple[int, int, int, int, Part]]]:
    """A random test over evenly spread lines."""
    left_out = Quantity.VOLTAGE if reference == "voltage" else Quantity.FORCE
    channels = tuple(c for c in channels_of(rig) if c.quantity not in (left_out, Quantity.VOLTAGE))
    resolution = 0.5
    lines = np.unique(np.round(np.linspace(low, high, count) / resolution)) * resolution
    conditions = RandomResponses(
        f"noise {test}", rig.drive_point, channels, reference, lines, resolution, window, 0.05, 0.0, 60.0
    )
    table = [
        (test, line, channel, 1, part)
        for line in range(lines.size)
        for channel in range(len(channels))
        for part in (Part.LOG_MAGNITUDE, Part.PHASE)
    ]
    return conditions, table
