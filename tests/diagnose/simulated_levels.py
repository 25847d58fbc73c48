"""Held levels of a chain of masses by an independent time integration, as observations of the diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from independent.modal_simulator import Element, Simulator

from nmt_core.messages.blocks import Quantity
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.conditions import LockedLevel, MeasuredChannel, PhaseResonanceTest
from nmt_diagnose.observations.observables import Observations, Part, Place, RowTable
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


def chain_of_masses() -> Rig:
    """The model: the chain without any law, an ideal force at point 1 and accelerometers at all points."""
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
        "exciter": {"kind": "force", "point": 1},
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
    elements = [Element(kind, shapes[point - 1], values, sliders) for point, kind, values, sliders in laws]
    frequency = detuned * omega[0] / (2.0 * np.pi)
    simulator = Simulator(omega / (2.0 * np.pi), ratios, shapes[0] + second * shapes[-1], elements)
    generator = np.random.default_rng(seed)
    channels = (
        MeasuredChannel("f1", Quantity.FORCE, 1),
        *(MeasuredChannel(f"a{p + 1}", Quantity.ACCELERATION, p + 1) for p in range(len(MASSES))),
    )
    points = (1, len(MASSES)) if second else (1,)
    channels += tuple(MeasuredChannel(f"f{p}", Quantity.FORCE, p) for p in points[1:])
    settle = round(4.0 / ratios[0])
    table, levels = RowTable(), []
    for k, force in enumerate(forces):
        simulator.sine(force, frequency, 8)
        simulator.sine(force, frequency, settle)
        out, _ = simulator.sine(force, frequency, 4, PER_PERIOD)
        count = len(MASSES)
        signals = np.column_stack([out[:, 3 * count], out[:, 2 * count : 3 * count] @ shapes.T])
        signals = np.column_stack([signals, *[second * out[:, 3 * count] for _ in points[1:]]])
        spectra = 2.0 * np.fft.rfft(signals, axis=0)[::4][: HARMONICS + 1].T / len(signals)
        spectra[1 : 1 + count] *= np.asarray(gains)[:, None]
        place = Place(k, 10.0 * k, frequency, force)
        table.add(Part.LOG_FREQUENCY, float(np.log(2.0 * np.pi * frequency)), 1e-7, 0.0, place)
        for number, row in enumerate(spectra):
            size = abs(row[1])
            noisy = row + size * NOISE * (generator.standard_normal(6) + 1j * generator.standard_normal(6))
            table.add(Part.LOG_MAGNITUDE, float(np.log(abs(noisy[1]))), NOISE, 0.0, place, number, 1)
            table.add(Part.PHASE, float(np.angle(noisy[1])), NOISE, 0.0, place, number, 1)
            for order in range(2, HARMONICS + 1):
                ratio = noisy[order] / abs(noisy[1])
                table.add(Part.REAL, float(ratio.real), NOISE, 0.0, place, number, order)
                table.add(Part.IMAG, float(ratio.imag), NOISE, 0.0, place, number, order)
        levels.append(LockedLevel(k, force, 0.0, 1e-4, frequency, 10.0 * k, 10.0 * k + 5.0, 0.0, 1, force))
    test = PhaseResonanceTest("levels", points, "a1", channels, HARMONICS, "voltage", tuple(levels))
    found = table.observations(test)
    return Observations(found.tests, found.rows, found.values, found.std, found.floor, chains=(MeasuringChain(),))
