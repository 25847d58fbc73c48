"""Linear description of a rig from its model, for phase-locked loop and extraction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_rig.model.assembly import ElectromechanicalSystem
from nmt_rig.model.linear_modes import damped_modes, sticking_modes
from nmt_rig.rig import Rig
from nmt_rig.rig_model import (
    build_resting_elements,
    build_shaker,
    build_structure,
    build_system,
    input_per_volt,
    inputs_per_volt,
)

_BESIDE = 1e-6
_NEAR_ROWS = 41  # of force per volt, within a fifth of the target mode's frequency
_WIDE_ROWS = 120  # next to it, up to half the sample rate


def force_per_volt(rig: Rig, frequencies_hz: Sequence[float]) -> ComplexArray:
    """Force at the drive point for a volt of drive, N/V, all friction sticking, shape (k,).

    Args:
        rig: the rig.
        frequencies_hz: Hz, shape (k,).
    """
    system = build_system(rig)
    per_volt = input_per_volt(rig)
    return np.array([per_volt * system.response(2.0 * np.pi * float(f))[1] for f in frequencies_hz], complex)


def exciter_force_rows(rig: Rig, frequencies_hz: Sequence[float]) -> tuple[tuple[float, ...], ...]:
    """Force at every exciter per volt of every exciter with all friction sticking, as rows of the description.

    Args:
        rig: the rig.
        frequencies_hz: Hz, ascending.
    """
    system = build_system(rig)
    volts = np.array(inputs_per_volt(rig))
    rows = []
    for frequency in frequencies_hz:
        matrix = system.responses(2.0 * np.pi * float(frequency))[1] * volts
        parts = np.column_stack([matrix.ravel().real, matrix.ravel().imag]).ravel()
        rows.append((float(f"{frequency:.6g}"), *(float(f"{value:.6g}") for value in parts)))
    return tuple(rows)


def _several_exciters(rig: Rig, frequency_hz: float, shapes: FloatArray) -> dict[str, Any]:
    """What the description says of several exciters; nothing where there is one.

    Force and displacement per volt of the first are those with all exciters in the ratio that isolates the mode.

    Args:
        rig: the rig.
        frequency_hz: of the target mode.
        shapes: at the exciters' points, 1/√kg, shape (exciters, modes).
    """
    if len(rig.all_exciters) == 1:
        return {}
    system = build_system(rig)
    inputs, wanted = isolating_inputs(system, 2.0 * np.pi * frequency_hz, shapes, rig.test.mode - 1)
    motion = system.motion(rig.drive_point, system.responses(2.0 * np.pi * frequency_hz)[0] @ inputs)
    voltages = inputs / np.array(inputs_per_volt(rig))
    near = frequency_hz * np.linspace(0.8, 1.2, _NEAR_ROWS)
    wide = np.geomspace(0.5 * frequency_hz, 0.5 * float(rig.sample_rate_hz), _WIDE_ROWS)
    wide = wide[(wide < near[0]) | (wide > near[-1])]
    first = abs(voltages[0]) or 1.0
    return {
        "force_per_volt": float(abs(wanted[0]) / first),
        "displacement_per_volt": float(abs(motion) / first),
        "exciter_points": rig.exciter_points,
        "exciter_force_rows": exciter_force_rows(rig, sorted([*near.tolist(), *wide.tolist()])),
    }


def isolating_inputs(
    system: ElectromechanicalSystem, frequency: float, shapes: FloatArray, mode: int
) -> tuple[ComplexArray, FloatArray]:
    """Inputs of all exciters whose forces drive one of the modes alone, and these forces (exciters,), N.

    Args:
        system: at rest.
        frequency: ω, rad/s.
        shapes: at the exciters' points, 1/√kg, shape (exciters, modes).
        mode: number of the mode, from 0.
    """
    wanted = np.linalg.pinv(shapes.T)[:, mode]
    forces = system.responses(frequency)[1]
    return np.asarray(np.linalg.solve(forces, wanted.astype(complex)), dtype=np.complex128), np.asarray(wanted)


def linear_description(rig: Rig) -> LinearDescription:
    """Linear modes of the sticking structure at the response points, and the plant with its exciter.

    The plant's frequency and damping ratio are those of the damped mode of structure and exciter whose shape
    resembles the target mode most (largest MAC over all points; the nearest in frequency where several do alike). Force
    and displacement per volt are taken at phase resonance of the structure, i.e. at the target mode's linear frequency,
    with all friction sticking: the smallest levels of a test scale by them.

    Raises:
        BenchError: the target mode is a rigid-body mode, or no such mode, or exists nothing oscillates.
    """
    structure = build_structure(rig)
    elements = build_resting_elements(rig, structure)
    target = rig.test.mode - 1
    modes = sticking_modes(structure, elements, max(rig.extraction.linear_modes, rig.test.mode))
    if target >= modes.frequencies.size or modes.frequencies[target] <= 0.0:
        rigid = int(np.sum(modes.frequencies == 0.0))
        raise BenchError(
            f"test.mode {rig.test.mode} of rig {rig.name} is not an elastic mode: of the first "
            f"{modes.frequencies.size} "
            f"modes {rigid} are rigid-body modes; choose another test.mode."
        )
    points = rig.response_points(Quantity[rig.extraction.quantity.upper()])
    rows = [modes.points.index(point) for point in points]
    drive = modes.points.index(rig.drive_point)

    system = build_system(rig)
    plant = damped_modes(system)
    if plant.frequencies.size == 0:
        raise BenchError(
            f"Structure and exciter of rig {rig.name} together have no oscillating mode: all are overdamped; lower the "
            "damping of the structure or of the exciter."
        )
    shape = modes.shapes[:, target]
    size = np.sum(np.abs(plant.shapes) ** 2, axis=0)
    overlap = np.abs(shape @ plant.shapes) ** 2 / np.where(size > 0.0, size, np.inf)
    # Few points cannot tell the mode from one of the exciter's own: of those that look alike, the nearest.
    alike = np.flatnonzero(overlap >= (1.0 - 1e-9) * np.max(overlap))
    distance = np.abs(np.log(plant.frequencies[alike] / modes.frequencies[target]))
    nearest = int(alike[np.argmin(distance)])

    try:
        q, force = system.response(float(modes.frequencies[target]))
    except np.linalg.LinAlgError:  # without any damping the response is finite only next to the resonance
        q, force = system.response(float(modes.frequencies[target]) * (1.0 + _BESIDE))
    per_volt = input_per_volt(rig)
    shaker = build_shaker(rig)
    excited = modes.shapes[[modes.points.index(point) for point in rig.exciter_points]]
    per_first_volt = {
        "force_per_volt": per_volt * abs(force),
        "displacement_per_volt": per_volt * float(abs(system.motion(rig.drive_point, q))),
    }
    return LinearDescription(
        source="model",
        drive_point=rig.drive_point,
        target_mode=target,
        points=points,
        frequencies_rad_s=tuple(float(value) for value in modes.frequencies),
        damping_ratios=tuple(float(value) for value in modes.damping_ratios),
        shapes=tuple(tuple(float(value) for value in modes.shapes[row]) for row in rows),
        drive_point_shape=float(modes.shapes[drive, target]),
        plant_frequency_rad_s=float(plant.frequencies[nearest]),
        plant_damping_ratio=float(plant.damping_ratios[nearest]),
        moving_mass_kg=0.0 if shaker is None else shaker.moving_mass,
        **(per_first_volt | _several_exciters(rig, float(modes.frequencies[target]) / (2.0 * np.pi), excited)),
    )
