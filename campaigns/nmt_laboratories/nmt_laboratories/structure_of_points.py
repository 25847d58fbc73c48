"""A structure measured at several points, one of which has a force of its own; by the equations of its modes.

It shares no code with the bench. A force of held amplitude is stepped through two resonances at one point, and every
point is measured. Where the nonlinear force acts is what a diagnosis has to find.

Run in ``./nmt shell``::

    python -m nmt_laboratories.structure_of_points --first 1 --count 12

Each seed draws a beam-like structure of three modes and four points, where it is driven, where its nonlinear force is
and of what kind, and measures frequency responses at three forces about its first two modes with scatter. The model has
the modes with errors: 0.1 % of the frequencies, 5 % of the damping, 1 % of the shapes.
"""

from __future__ import annotations

import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from ruamel.yaml import YAML

from nmt_bench.data_import import import_data
from nmt_diagnose.diagnose import diagnose_bags
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.ledger.diagnosis import Diagnosis, Verdict
from nmt_laboratories.campaign_frame import judged_in_parallel, print_ends, seed_parser
from nmt_laboratories.structure_at_a_point import STEPS, advance, local_force, slide

POINTS, MODES, LINES = 4, 3, 40
_MEASURED = 40  # periods
_FORCES = (0.05, 0.3, 1.0)
HEALTHY = "healthy"
EFFECTS = {
    HEALTHY: "",
    "hardening": "cubic_stiffness",
    "stop": "two_sided_gap",
    "damping": "amplitude_damping",
    "softening": "cubic_stiffness",
    "slider": "second_friction_contact",
}


@dataclass(frozen=True)
class Drawn:
    """A structure.

    Attributes:
        frequencies_hz, ratios: of the modes, (MODES,).
        shapes: at the points, 1/√kg, (POINTS, MODES).
        driven, local: points of the drive and of the nonlinear force, from 1.
        terms: cubic (N/m³), quadratic (N/m²), damping (N s/m³), stiffness (N/m) and gap (m) of a stop.
        slider: stiffness (N/m) and slip force (N) of a friction slider; 0 = none.
        forces: N, that drive each of the first two modes, (2,).
    """

    frequencies_hz: np.ndarray
    ratios: np.ndarray
    shapes: np.ndarray
    driven: int
    local: int
    terms: np.ndarray
    slider: tuple[float, float]
    forces: np.ndarray


@njit(cache=False)
def _play(
    state: Any, steps: int, dt: float, force: float, omega: float, modes: Any, shapes: Any, driven: int, local: int,
    terms: Any, stiffness: Any, limits: Any, moved: Any, kept: Any,
) -> None:  # fmt: skip
    """Runge–Kutta of fourth order; rows of ``modes`` are ω and ζ, ``kept`` gets the points' displacements."""
    points, count = shapes.shape
    slope, now = np.zeros((4, 2, count)), np.zeros((2, count))
    for step in range(steps):
        for stage in range(4):
            part = 0.0 if stage == 0 else (0.5 if stage < 3 else 1.0)
            for k in range(2):
                for m in range(count):
                    now[k, m] = state[k, m] + (part * dt * slope[stage - 1, k, m] if stage else 0.0)
            x, v = 0.0, 0.0
            for m in range(count):
                x += shapes[local, m] * now[0, m]
                v += shapes[local, m] * now[1, m]
            if stage == 0:
                for p in range(points):
                    kept[p, step] = 0.0
                    for m in range(count):
                        kept[p, step] += shapes[p, m] * now[0, m]
            drive = force * np.cos(omega * (step + part) * dt)
            own = local_force(x, v, terms, stiffness, limits, moved)
            for m in range(count):
                slope[stage, 0, m] = now[1, m]
                slope[stage, 1, m] = (
                    shapes[driven, m] * drive
                    - shapes[local, m] * own
                    - 2.0 * modes[1, m] * modes[0, m] * now[1, m]
                    - modes[0, m] * modes[0, m] * now[0, m]
                )
        advance(state, slope, dt)
        x = 0.0
        for m in range(count):
            x += shapes[local, m] * state[0, m]
        slide(x, stiffness, limits, moved)


def responses(own: Drawn, force: float, frequencies: np.ndarray) -> np.ndarray:
    """Fundamentals of the points' displacements over the force, m/N, (lines, POINTS), one line after the other."""
    state = np.zeros((2, MODES))
    modes = np.array([2.0 * np.pi * own.frequencies_hz, own.ratios])
    sliders = np.array([own.slider] if own.slider[0] else [], dtype=float).reshape(-1, 2)
    moved = np.zeros(len(sliders))
    found = np.zeros((len(frequencies), POINTS), dtype=complex)
    # Fast modes need short steps: the time step follows them.
    per_period = max(STEPS, int(np.ceil(20.0 * own.frequencies_hz[-1] / frequencies.min())))
    settling = int(1.5 / own.ratios.min())
    turning = np.exp(-2j * np.pi * np.arange(per_period * _MEASURED) / per_period)
    for i, frequency in enumerate(frequencies):
        kept = np.zeros((POINTS, per_period * (settling + _MEASURED)))
        _play(
            state, kept.shape[1], 1.0 / frequency / per_period, force, 2.0 * np.pi * frequency, modes, own.shapes,
            own.driven - 1, own.local - 1, own.terms, sliders[:, 0].copy(), sliders[:, 1].copy(), moved, kept,
        )  # fmt: skip
        found[i] = 2.0 * np.mean(kept[:, -turning.size :] * turning, axis=1) / force
    return found


def drawn(kind: str, generator: np.random.Generator) -> Drawn:
    """A random structure of a kind: the shapes of a fixed-free rod, frequencies of a beam."""
    first = 10 ** generator.uniform(1.3, 2.0)
    frequencies = first * np.array([1.0, generator.uniform(3.0, 6.5), generator.uniform(8.0, 17.0)])
    ratios = np.full(MODES, 10 ** generator.uniform(-2.5, -2.0))
    places = np.arange(1, POINTS + 1) / POINTS
    shapes = np.sin(np.outer(places, np.pi * (np.arange(MODES) + 0.5))) * np.sqrt(2.0)
    driven, local = (int(point) for point in generator.permutation(POINTS)[:2] + 1)
    # The nonlinear force is set by what it is of the first mode's at the largest motion.
    top = 10 ** generator.uniform(-4.0, -3.0)
    omega = 2.0 * np.pi * first
    moved = abs(shapes[local - 1, 0]) * top  # at the local point, for a modal amplitude of ``top``
    elastic = omega**2 * top / abs(shapes[local - 1, 0])  # force there that is as large as the modal stiffness force
    strength = 10 ** generator.uniform(-1.0, 0.0)
    terms, slider = np.array([0.0, 0.0, 0.0, 0.0, 1.0]), (0.0, 0.0)
    if kind == "hardening":
        terms[0] = strength * elastic / moved**3
    if kind == "softening":
        terms[0] = -min(strength, 0.2) * elastic / moved**3
    if kind == "damping":
        terms[2] = 10 ** generator.uniform(0.0, 0.8) * 8.0 * ratios[0] * elastic / (moved**3 * omega)
    if kind == "stop":
        terms[3:] = strength * elastic / moved, generator.uniform(0.3, 0.7) * moved
    if kind == "slider":
        share = 10 ** generator.uniform(-1.5, -0.7)
        slider = (share * elastic / moved, share * elastic * generator.uniform(0.1, 0.4))
    peaks = np.array([2.0 * ratios[k] * (2.0 * np.pi * frequencies[k]) ** 2 for k in range(2)])
    reach = np.array([top, top * abs(shapes[local - 1, 0] / shapes[local - 1, 1])])
    reach[1] = min(reach[1], top)
    forces = peaks * reach / np.abs(shapes[driven - 1, :2])
    return Drawn(frequencies, ratios, shapes, driven, local, terms, slider, forces)


def leaves_noise_only(own: Drawn) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (Hz) and shapes of small motion: a slider that sticks is a spring."""
    stiffness = np.diag((2.0 * np.pi * own.frequencies_hz) ** 2)
    stiffness += own.slider[0] * np.outer(own.shapes[own.local - 1], own.shapes[own.local - 1])
    squares, vectors = np.linalg.eigh(stiffness)
    return np.sqrt(squares) / (2.0 * np.pi), own.shapes @ vectors


def diagnosed(folder: Path, kind: str, seed: int, count: int = LINES, jobs: int = 1) -> tuple[Diagnosis, Drawn]:
    """Draw, measure, import and diagnose.

    Args:
        folder: an existing, empty folder.
        kind: of ``EFFECTS``.
        seed: of everything.
        count: lines of a sweep.
        jobs: processes of the diagnosis.
    """
    generator = np.random.default_rng(seed)
    own = drawn(kind, generator)
    frequencies, shapes = leaves_noise_only(own)
    noise, segments = 10 ** generator.uniform(-2.7, -2.0), []
    for mode in range(2):
        for number, share in enumerate(_FORCES):
            force = float(share * own.forces[mode])
            # The resonance at this force: a coarse look around the one at rest.
            coarse = np.linspace(0.9, 1.25, 36) * frequencies[mode]
            peak = coarse[np.argmax(np.abs(responses(own, force, coarse)[:, own.driven - 1]))]
            reach = 6.0 * own.ratios[0] + 0.01
            low, high = sorted((peak, frequencies[mode]))
            lines = np.linspace(low * (1.0 - reach), high * (1.0 + reach), count)
            found = -((2.0 * np.pi * lines[:, None]) ** 2) * responses(own, force, lines)
            found *= 1.0 + noise * (
                generator.standard_normal(found.shape) + 1j * generator.standard_normal(found.shape)
            )
            for point in range(POINTS):
                name = f"mode{mode}_force{number}_point{point + 1}.csv"
                rows = [f"{f:.8g},{h.real:.8g},{h.imag:.8g}" for f, h in zip(lines, found[:, point], strict=True)]
                (folder / name).write_text("\n".join(["frequency_hz,real,imag", *rows]) + "\n", encoding="utf-8")
                segments.append({
                    "kind": "frf", "file": name, "point": point + 1, "drive_point": own.driven, "level": force,
                    "direction": "up", "name": name[:-4], "unit": "m/s^2/N", "level_unit": "N",
                })  # fmt: skip
    modes = [
        {
            "frequency_hz": float(frequencies[k] * (1.0 + 0.001 * generator.standard_normal())),
            "damping_ratio": float(own.ratios[k] * (1.0 + 0.05 * generator.standard_normal())),
            "modal_mass_kg": 1.0,
            "shape": [float(value * (1.0 + 0.01 * generator.standard_normal())) for value in shapes[:, k]],
        }
        for k in range(MODES)
    ]
    structure = {"kind": "modal", "points": list(range(1, POINTS + 1)), "modes": modes}
    exciter = {"kind": "force", "point": own.driven}
    yaml = YAML(typ="safe")
    yaml.dump({"name": "of_points", "structure": structure, "exciter": exciter}, folder / "model.yaml")
    yaml.dump({"rig": "model.yaml", "file": segments[0]["file"], "segments": segments}, folder / "data.yaml")
    import_data(folder / "data.yaml", folder / "bag")
    settings = DiagnosisSettings(jobs=jobs, look_ahead=False)
    return diagnose_bags(folder / "model.yaml", [folder / "bag"], settings=settings).diagnosis, own


def judged(seed: int) -> tuple[str, str]:
    """A line about a seed, and how it ended.

    ``silent`` or ``alarm`` of a healthy one; ``place``: effect and point are right; ``alike``: the point is among those
    that are said to be hardly less likely; ``first``: the effect alone is right; ``other`` or ``unknown``.
    """
    warnings.simplefilter("ignore")
    kind = list(EFFECTS)[seed % len(EFFECTS)]
    with tempfile.TemporaryDirectory() as folder:
        found, own = diagnosed(Path(folder), kind, seed)
    first = found.ranking[0] if found.ranking else None
    if kind == HEALTHY:
        end = "silent" if found.verdict in (Verdict.NONE, Verdict.CALIBRATION) else "alarm"
    elif found.verdict is not Verdict.EFFECT or first is None:
        end = "unknown"
    elif first.effect != EFFECTS[kind]:
        end = "other"
    elif first.detail == str(own.local):
        end = "place"
    else:
        end = "alike" if str(own.local) in found.where[0].detail.split(" + ") else "first"
    what = f"{first.effect} at {first.detail} {100 * first.probability:.0f} %" if first else "nothing named"
    if first and found.where:
        what += f", place {found.where[0].detail}"
    truth = f"driven {own.driven}, force at {own.local}"
    return f"{seed}  {kind:10} {truth:24} {end:8} {found.verdict.value:12} {what}", end


def main() -> None:
    """Print a line for each seed, and how many ended how."""
    words = seed_parser(__doc__, first=1, count=12).parse_args()
    seeds = range(words.first, words.first + words.count)
    print_ends(judged_in_parallel([(seed,) for seed in seeds], judged, words.jobs))


if __name__ == "__main__":
    main()
