"""Held levels of a chain of masses or of modes by an independent time integration, as observations of the diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.locked_windows import LockedWindows
from nmt_diagnose.measurements.measurement import HeldLevels, LockedLevel, Observations, RowTable
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Part, Place
from nmt_laboratories.modal_simulator import Element, Simulator
from nmt_rig.rig import Rig, validate_rig
from nmt_rig.rig_file import RigDocument

MASSES, SPRINGS, GROUND = (1.0, 0.8, 0.6, 0.5), (2.0e4, 1.5e4, 1.2e4), (1.0e4, 0.0, 0.0, 0.0)
LOSS = 2.0e-4  # s, damping over stiffness
PER_PERIOD, HARMONICS = 128, 5
FORCES = tuple(float(value) for value in np.geomspace(0.05, 2.0, 8))
NOISE = 1e-5


def modes() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """ω (rad/s), damping ratios and mass-normalised shapes of the chain, by its matrices."""
    stiffness = np.diag(GROUND).astype(float)
    for k, spring in enumerate(SPRINGS):
        pair = np.zeros(len(MASSES))
        pair[k], pair[k + 1] = 1.0, -1.0
        stiffness += spring * np.outer(pair, pair)
    root = np.diag(1.0 / np.sqrt(MASSES))
    squares, vectors = np.linalg.eigh(root @ stiffness @ root)
    omega = np.sqrt(squares)
    return omega, 0.5 * LOSS * omega, root @ vectors


def chain_of_masses(exciter: Mapping[str, Any] | None = None) -> Rig:
    """The model: the chain without any law and accelerometers at all points; None = an ideal force at point 1."""
    values: dict[str, Any] = {
        "name": "chain",
        "structure": {
            "kind": "chain",
            "masses_kg": list(MASSES),
            "springs_n_m": list(SPRINGS),
            "dampers_ns_m": [LOSS * k for k in SPRINGS],
            "ground_springs_n_m": list(GROUND),
            "ground_dampers_ns_m": [LOSS * k for k in GROUND],
        },
        "exciter": dict(exciter or {"kind": "force", "point": 1}),
        "sensors": [
            {"quantity": "force", "point": "drive"},
            *({"quantity": "acceleration", "point": p + 1} for p in range(len(MASSES))),
        ],
        "extraction": {"quantity": "acceleration", "linear_modes": 2},
    }
    return validate_rig(RigDocument("test", values, {}))


def held(
    laws: Sequence[tuple[int, str, tuple[float, ...], tuple[tuple[float, float], ...]]] = (),
    gains: Sequence[float] = (1.0,) * len(MASSES),
    forces: Sequence[float] = FORCES,
    detuned: float = 1.0,
    seed: int = 1,
    second: float = 0.0,
) -> Observations:
    """Observations of sines at levels, near the first resonance.

    Args:
        laws: point, kind, parameters and sliders of each local force, as the simulator names them.
        gains: of the accelerometers.
        forces: amplitudes, N.
        detuned: frequency over that of the first mode.
        seed: of the noise.
        second: force of an exciter at the last point over that at the first; 0 = there is none.
    """
    omega, ratios, shapes = modes()
    weights = {1: 1.0, **({len(MASSES): second} if second else {})}
    frequency = detuned * omega[0] / (2.0 * np.pi)
    sines = [(force, frequency) for force in forces]
    return held_sines((omega, ratios, shapes), laws, weights, sines, gains, seed)


def held_sines(
    structure: tuple[np.ndarray, np.ndarray, np.ndarray],
    laws: Sequence[tuple[int, str, tuple[float, ...], tuple[tuple[float, float], ...]]],
    weights: Mapping[int, float],
    sines: Sequence[tuple[float, float]],
    gains: Sequence[float],
    seed: int = 1,
    table: tuple[np.ndarray, bool] | None = None,
) -> Observations:
    """Observations of sines at levels.

    Args:
        structure: ω (rad/s), damping ratios and mass-normalised shapes (points, modes).
        laws: as of :func:`held`.
        weights: force of each exciter over that of the first, by point.
        sines: force of the first (N) and frequency (Hz) of each level.
        gains: of the accelerometers.
        seed: of the noise.
        table: participation Γ of the modes in the motion of a table that moves instead of the force, −1 m/s² for 1 N,
            and whether its motion is in the responses.
    """
    omega, ratios, shapes = structure
    elements = [Element(kind, shapes[point - 1], values, sliders) for point, kind, values, sliders in laws]
    load = sum((weight * shapes[point - 1] for point, weight in weights.items()), np.zeros(omega.size))
    load = load if table is None else table[0]
    simulator = Simulator(omega / (2.0 * np.pi), ratios, load, elements)
    generator = np.random.default_rng(seed)
    count, points = len(shapes), tuple(weights)
    channels = (
        MeasuredChannel(f"f{points[0]}", Quantity.FORCE, points[0]),
        *(MeasuredChannel(f"a{p + 1}", Quantity.ACCELERATION, p + 1) for p in range(count)),
        *(MeasuredChannel(f"f{p}", Quantity.FORCE, p) for p in points[1:]),
    )
    settle = round(2.5 / ratios[0])  # until what is left of a start is a fiftieth of the noise
    rows, levels = RowTable(), []
    for k, (force, frequency) in enumerate(sines):
        simulator.sine(force, frequency, 8)
        simulator.sine(force, frequency, settle)
        out, _ = simulator.sine(force, frequency, 4, PER_PERIOD)
        drive, moved = out[:, -1], out[:, 2 * omega.size : 3 * omega.size] @ shapes.T
        if table is not None and table[1]:
            moved = moved - drive[:, np.newaxis]
        signals = np.column_stack([drive, moved, *[weights[p] * drive for p in points[1:]]])
        spectra = 2.0 * np.fft.rfft(signals, axis=0)[::4][: HARMONICS + 1].T / len(signals)
        spectra[1 : 1 + count] *= np.asarray(gains)[:, None]
        place = Place(k, 10.0 * k, frequency, force)
        rows.add(Part.LOG_FREQUENCY, float(np.log(2.0 * np.pi * frequency)), 1e-7, 0.0, place)
        for number, row in enumerate(spectra):
            size = abs(row[1])
            noisy = row + size * NOISE * (generator.standard_normal(6) + 1j * generator.standard_normal(6))
            rows.add(Part.LOG_MAGNITUDE, float(np.log(abs(noisy[1]))), NOISE, 0.0, place, number, 1)
            rows.add(Part.PHASE, float(np.angle(noisy[1])), NOISE, 0.0, place, number, 1)
            for order in range(2, HARMONICS + 1):
                ratio = noisy[order] / abs(noisy[1])
                rows.add(Part.REAL, float(ratio.real), NOISE, 0.0, place, number, order)
                rows.add(Part.IMAG, float(ratio.imag), NOISE, 0.0, place, number, order)
        levels.append(LockedLevel(k, force, 0.0, 1e-4, frequency, 10.0 * k, 10.0 * k + 5.0, 0.0, 1, force))
    test = LockedWindows("levels", points, "a1", channels, HARMONICS, "voltage", tuple(levels))
    found = rows.observations(test)
    return Observations(found.tests, found.rows, found.values, found.std, found.floor, chains=(MeasuringChain(),))


def levels_of(observations: Observations) -> HeldLevels | None:
    """Levels of the first measurement."""
    return observations.tests[0].held_levels(observations, 0)
