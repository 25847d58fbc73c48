"""Structures that have a degree of freedom which their model lacks, by their own matrices.

A row of masses on springs gets a mass on a spring at a point (a missing mode), or one of its masses turns out to be two
with a spring between them (an elastic transmission). Responses are those of the matrices, measured as laboratories do.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from nmt_bench.data_import import import_data

ATTACHED, TRANSMISSION, HEAVIER = "attached", "transmission", "heavier"
LINES = 400


@dataclass(frozen=True)
class MoreModes:
    """A row of masses and what its model lacks.

    Attributes:
        masses: of the model, kg.
        springs: between neighbours, N/m.
        ground: springs to the ground, N/m.
        damping: stiffness-proportional, s.
        kind: ``ATTACHED`` or ``TRANSMISSION``; ``HEAVIER`` has the mass fixed to the point; empty = nothing is lacking.
        point: that carries the mass, from 1.
        mass: kg; of a transmission a part of the model's.
        frequency_hz: of the mass on its spring, its base held.
        ratio: damping ratio of that.
        driven: point of the force.
        off: model's springs over the true ones.
        noise: relative deviation of a line.
    """

    masses: tuple[float, ...]
    springs: tuple[float, ...]
    ground: tuple[float, ...]
    damping: float
    kind: str
    point: int
    mass: float
    frequency_hz: float
    ratio: float
    driven: int
    off: float
    noise: float

    def matrices(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """M, C, K of the truth."""
        n = len(self.masses)
        m, k = np.diag(self.masses).astype(float), np.diag(self.ground).astype(float)
        for i, spring in enumerate(self.springs):
            k[i : i + 2, i : i + 2] += spring * np.array([[1.0, -1.0], [-1.0, 1.0]])
        c = self.damping * k
        if not self.kind:
            return m, c, k
        i, omega = self.point - 1, 2.0 * np.pi * self.frequency_hz
        if self.kind == HEAVIER:
            m[i, i] += self.mass
            return m, c, k
        m, c, k = (np.pad(matrix, (0, 1)) for matrix in (m, c, k))
        m[n, n] = self.mass
        if self.kind == TRANSMISSION:
            m[i, i] -= self.mass
        for matrix, value in ((k, self.mass * omega**2), (c, 2.0 * self.ratio * omega * self.mass)):
            matrix[i, i] += value
            matrix[n, n] += value
            matrix[i, n] -= value
            matrix[n, i] -= value
        return m, c, k

    def frequencies_hz(self) -> np.ndarray:
        """Undamped frequencies of the truth."""
        m, _, k = self.matrices()
        root = np.sqrt(np.diag(m))
        return np.asarray(np.sqrt(np.linalg.eigvalsh(k / np.outer(root, root))) / (2.0 * np.pi))

    def accelerances(self, hz: np.ndarray) -> np.ndarray:
        """Of all points of the model by a force at the driven one, (points, lines)."""
        m, c, k = self.matrices()
        force = np.zeros(len(m))
        force[self.driven - 1] = 1.0
        omega = 2.0 * np.pi * hz
        return np.array([-(w**2) * np.linalg.solve(k + 1j * w * c - w**2 * m, force) for w in omega]).T[
            : len(self.masses)
        ]


def drawn(seed: int) -> MoreModes:
    """A structure of three to six masses; even seeds have a mass attached, odd ones an elastic transmission."""
    random = np.random.default_rng([820, seed])
    n = int(random.integers(3, 7))
    masses = tuple(map(float, random.uniform(0.5, 2.0, n)))
    stiffness = (2.0 * np.pi * 10 ** random.uniform(1.3, 2.0)) ** 2
    springs = tuple(map(float, stiffness * random.uniform(0.6, 1.6, n - 1)))
    ground = tuple(float(value) for value in stiffness * np.array([random.uniform(0.3, 1.5), *[0.0] * (n - 1)]))
    plain = MoreModes(masses, springs, ground, 0.0, "", 1, 0.0, 0.0, 0.0, 1, 1.0, 0.0)
    modes = plain.frequencies_hz()
    point, driven = (int(random.integers(1, n + 1)) for _ in range(2))
    kind = (ATTACHED, TRANSMISSION)[seed % 2]
    share = random.uniform(0.05, 0.3) if kind == ATTACHED else random.uniform(0.2, 0.5)
    lower = int(random.integers(0, n - 1))
    between = random.uniform(0.2, 0.8)
    frequency = float(modes[lower] ** (1.0 - between) * modes[lower + 1] ** between)
    return MoreModes(
        masses, springs, ground, float(random.uniform(0.004, 0.02) / (np.pi * modes[n // 2])), kind, point,
        float(share * masses[point - 1]), frequency, float(random.uniform(0.003, 0.02)), driven,
        float(1.0 + 0.003 * random.standard_normal()), float(random.uniform(0.003, 0.01)),
    )  # fmt: skip


def recorded(structure: MoreModes, folder: Path, random: np.random.Generator) -> tuple[Path, Path]:
    """Model and bag: accelerances at all points with noise, gains of 0.5 % and phases of 0.1°."""
    modes = structure.frequencies_hz()
    hz = np.geomspace(0.6 * modes[0], 1.15 * modes[-1], LINES)
    segments = []
    for point, values in enumerate(structure.accelerances(hz), start=1):
        gain = (1.0 + 0.005 * random.standard_normal()) * np.exp(1j * np.radians(0.1) * random.standard_normal())
        std = np.hypot(structure.noise * np.abs(values), 1e-3 * np.median(np.abs(values)))
        noisy = gain * values + std * (random.standard_normal(LINES) + 1j * random.standard_normal(LINES))
        np.savetxt(
            folder / f"p{point}.csv", np.column_stack([hz, noisy.real, noisy.imag]), delimiter=",",
            header="frequency_hz,real,imag", comments="",
        )  # fmt: skip
        segments.append(
            {"kind": "frf", "file": f"p{point}.csv", "unit": "m/s^2/N", "point": point, "drive_point": structure.driven}
        )
    model: dict[str, Any] = {
        "name": "row_of_masses",
        "structure": {
            "kind": "chain", "masses_kg": list(structure.masses),
            "springs_n_m": [structure.off * value for value in structure.springs],
            "ground_springs_n_m": [structure.off * value for value in structure.ground],
            "dampers_ns_m": [structure.damping * value for value in structure.springs],
            "ground_dampers_ns_m": [structure.damping * value for value in structure.ground],
        },
        "exciter": {"kind": "force", "point": structure.driven},
        "sensors": [
            {"quantity": "force", "point": "drive"},
            *({"quantity": "acceleration", "point": point} for point in range(1, len(structure.masses) + 1)),
        ],
        "extraction": {"quantity": "acceleration", "linear_modes": 1},
    }  # fmt: skip
    yaml = YAML(typ="safe")
    yaml.dump(model, folder / "model.yaml")
    yaml.dump({"rig": "model.yaml", "file": "p1.csv", "segments": segments}, folder / "data.yaml")
    import_data(folder / "data.yaml", folder / "bag")
    return folder / "model.yaml", folder / "bag"
