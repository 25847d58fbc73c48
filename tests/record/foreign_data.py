"""Data as someone else's bench would write it: a mode at resonance, in files with a sidecar."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

RATE = 2000.0
FREQUENCY_HZ = 21.7
SHAPES = (0.4, 1.1)
DAMPING = 0.01

LINEAR: dict[str, Any] = {
    "source": "test",
    "drive_point": 2,
    "target_mode": 0,
    "points": [2, 4],
    "frequencies_rad_s": [2 * np.pi * FREQUENCY_HZ, 760.0],
    "damping_ratios": [DAMPING, 0.03],
    "shapes": [[0.4, -1.4], [1.1, -1.9]],
    "drive_point_shape": 0.4,
    "plant_frequency_rad_s": 137.0,
    "plant_damping_ratio": 0.012,
    "moving_mass_kg": 0.04,
}


def recording(seconds: float = 6.0, frequency: float = FREQUENCY_HZ) -> dict[str, np.ndarray]:
    """Force 0.5 N then 1 N, in phase with the velocity of a mode of known damping; accelerations in m/s²."""
    time = np.arange(round(seconds * RATE)) / RATE
    omega = 2 * np.pi * frequency
    force = np.where(time < seconds / 2, 0.5, 1.0)
    amplitude = force * SHAPES[0] / (2 * DAMPING * omega**2)
    noise = np.random.default_rng(1).standard_normal((3, time.size)) * 1e-9
    return {
        "u": 3.0 * force * np.cos(omega * time + 0.2),
        "f": force * np.cos(omega * time) + noise[0],
        "a2": -SHAPES[0] * amplitude * omega**2 * np.sin(omega * time) + noise[1],
        "a4": -SHAPES[1] * amplitude * omega**2 * np.sin(omega * time) + noise[2],
    }


def sidecar(**changes: Any) -> dict[str, Any]:
    """The sidecar of :func:`recording`; a change to None takes a key out."""
    values: dict[str, Any] = {
        "sample_rate": RATE,
        "file": "data.npz",
        "linear": "linear.json",
        "channels": [
            {"column": "u", "quantity": "voltage", "unit": "V"},
            {"column": "f", "quantity": "force", "unit": "N", "point": 2},
            {"column": "a2", "quantity": "acceleration", "unit": "m/s^2", "point": 2},
            {"column": "a4", "quantity": "acceleration", "unit": "m/s^2", "point": 4},
        ],
        "segments": [
            {
                "kind": "phase_resonance",
                "level": 0.5,
                "level_unit": "N",
                "start": 0.0,
                "stop": 3.0,
                "window": [0.5, 2.9],
            },
            {
                "kind": "phase_resonance",
                "level": 1.0,
                "level_unit": "N",
                "start": 3.0,
                "stop": 6.0,
                "window": [3.5, 5.9],
            },
        ],
    }
    values.update(changes)
    return {key: value for key, value in values.items() if value is not None}


def write(folder: Path, values: dict[str, Any] | None = None, data: dict[str, np.ndarray] | None = None) -> Path:
    """Write NPZ, linear.json and sidecar; returns the sidecar's path."""
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(folder / "data.npz", **(recording() if data is None else data))
    (folder / "linear.json").write_text(json.dumps(LINEAR))
    return write_sidecar(folder, sidecar() if values is None else values)


def write_sidecar(folder: Path, values: dict[str, Any]) -> Path:
    path = folder / "sidecar.yaml"
    path.write_text(yaml.safe_dump(values, sort_keys=False))
    return path


def write_csv(
    folder: Path,
    data: dict[str, np.ndarray] | None = None,
    delimiter: str = ",",
    change: Callable[[str], str] = lambda text: text,
    values: dict[str, Any] | None = None,
    encoding: str = "utf-8",
    header: bool = True,
    digits: int = 9,
) -> Path:
    """Write CSV in the place of NPZ; ``change`` spoils its text."""
    data = recording() if data is None else data
    path = write(folder, sidecar(file="data.csv") if values is None else {**values, "file": "data.csv"})
    lines = [delimiter.join(data)] if header else []
    table = np.column_stack(list(data.values()))
    lines += [delimiter.join(f"{value:.{digits}g}" for value in row) for row in table]
    (folder / "data.csv").write_bytes(change("\n".join(lines) + "\n").encode(encoding))
    return path
