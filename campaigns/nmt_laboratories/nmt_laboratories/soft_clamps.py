"""Cantilevers whose clamp turns, measured by tables of one channel each, as a roving hammer gives them.

Made by ``python -m nmt_laboratories.campaign make --laboratory clamps``, diagnosed by ``./nmt blind laboratory``. The
clamp lowers the first frequency by 5 to 40 %; every eighth beam is healthy. Modes by a Ritz sum of polynomials that
shares no code with the bench, each with a damping ratio of its own, where the owner has damping by the stiffness.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.polynomial import Legendre, Polynomial
from scipy.linalg import eigh
from scipy.optimize import brentq

POINTS = (2, 4, 6, 8, 10, 12)
_ELEMENTS, _DEGREE, _LINES = 12, 14, 300
_RIGID = 1e5  # over EI/L
_MEASURED = 3


def modes_of(length: float, bending: float, mass_per_length: float, clamp: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (rad/s) and mass-normalised shapes (points, modes) with a clamp of so many N m/rad."""
    x = Polynomial([0.0, 1.0])
    basis = [x * Legendre.basis(n, domain=[0.0, 1.0]).convert(kind=Polynomial) for n in range(_DEGREE)]
    at, weights = np.polynomial.legendre.leggauss(60)
    at, weights = 0.5 * (at + 1.0), 0.5 * weights
    values = np.array([each(at) for each in basis])
    bent = np.array([each.deriv(2)(at) for each in basis])
    slope = np.array([each.deriv()(0.0) for each in basis])
    stiffness = bending / length**3 * (bent * weights) @ bent.T + clamp / length**2 * np.outer(slope, slope)
    squares, vectors = eigh(stiffness, mass_per_length * length * (values * weights) @ values.T)
    shapes = np.array([[each(point / _ELEMENTS) for each in basis] for point in POINTS]) @ vectors
    return np.sqrt(squares), shapes


def make_case(out: Path, seed: int) -> str:
    """Draw, measure and write the case of a seed, ``truth.yaml`` last; its name."""
    folder = out / f"clamp_{seed:04d}"
    if (folder / "truth.yaml").is_file():
        return folder.name
    folder.mkdir(parents=True, exist_ok=True)
    draw = np.random.default_rng([77, seed])
    length, height, width = (float(draw.uniform(*span)) for span in ((0.4, 0.9), (0.004, 0.009), (0.02, 0.04)))
    modulus, density = ((70e9, 2700.0), (205e9, 7850.0))[int(draw.integers(2))]
    beam = length, modulus * width * height**3 / 12.0, density * width * height
    rigid = _RIGID * beam[1] / length
    first = float(modes_of(*beam, rigid)[0][0])
    shift = float(10 ** draw.uniform(math.log10(0.05), math.log10(0.4)))
    low, high = math.log(1e-3 * beam[1] / length), math.log(rigid)
    clamp = math.exp(brentq(lambda log: modes_of(*beam, math.exp(log))[0][0] / first - 1.0 + shift, low, high))
    healthy = seed % 8 == 7
    omega, shapes = modes_of(*beam, rigid if healthy else clamp)
    driven = int(draw.choice([1, 2, 3]))
    channels = sorted({driven, *map(int, draw.choice(len(POINTS), int(draw.integers(2, 5)), replace=False))})
    ratios = draw.uniform(0.002, 0.006, _DEGREE)
    noise, off, everywhere = (
        float(10 ** draw.uniform(-2.7, -2.0)),
        float(draw.normal(1.0, 0.01)),
        bool(draw.integers(2)),
    )
    hertz = np.geomspace(0.6 * omega[0], 0.5 * (omega[_MEASURED - 1] + omega[_MEASURED]), _LINES) / (2.0 * math.pi)
    w = 2.0 * math.pi * hertz[:, None]
    over_modes = shapes[driven] / (omega**2 - w**2 + 2j * ratios * omega * w)
    segments: list[dict[str, Any]] = []
    for channel in channels:
        response = -(w[:, 0] ** 2) * (over_modes @ shapes[channel])
        gain = draw.normal(1.0, 0.005) * np.exp(1j * math.radians(0.1) * draw.standard_normal())
        std = np.hypot(noise * np.abs(response), everywhere * 1e-3 * np.median(np.abs(response)))
        measured = gain * response + std * (draw.standard_normal(_LINES) + 1j * draw.standard_normal(_LINES))
        file = f"a{POINTS[channel]}.csv"
        np.savetxt(
            folder / file, np.column_stack([hertz, measured.real, measured.imag]), delimiter=",",
            header="frequency_hz,real,imag", comments="", fmt="%.7g",
        )  # fmt: skip
        segments.append({"kind": "frf", "file": file, "unit": "m/s^2/N", "point": POINTS[channel],
                         "drive_point": POINTS[driven]})  # fmt: skip
    sensors = [{"quantity": "acceleration", "point": POINTS[channel]} for channel in channels]
    model = {
        "name": "cantilever",
        "structure": {
            "kind": "beam", "length_m": length, "width_m": width, "height_m": height,
            "youngs_modulus_pa": modulus * off, "density_kg_m3": density, "elements": _ELEMENTS,
            "stiffness_damping_s": float(2.0 * ratios[0] / first),
        },
        "exciter": {"kind": "force", "point": POINTS[driven]},
        "sensors": [{"quantity": "force", "point": "drive"}, *sensors],
        "extraction": {"quantity": "acceleration", "linear_modes": 1},
    }  # fmt: skip
    effect = {"kind": "effect", "verdicts": ["effect"], "effects": ["clamp_compliance"], "place": ["boundary"],
              "parameters": {"k": clamp}, "remark": f"first frequency {100 * shift:.1f} % lower"}  # fmt: skip
    truth = {"kind": "healthy", "verdicts": ["none", "calibration"]} if healthy else effect
    sidecar = {"rig": "model.yaml", "file": segments[0]["file"], "segments": segments}
    for name, content in (("model", model), ("sidecar", sidecar), ("truth", truth)):
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return folder.name
