"""What chain and model are ordinarily off by, as columns of the rows of held levels: constant over the levels."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.law.law_rows import LawRows
from nmt_diagnose.law.modal_frame import ORDERS, KnownForces
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_record.exchange.sidecar.channel_tolerances import ChannelTolerance
from nmt_rig.rig import Rig
from nmt_rig.rig_model import build_elements

_STEP = 1e-3  # of a logarithm, for differences
MOTION_ROUNDS = 4
"""Rounds of motion and force: an even force near the end of its equilibrium takes so many to 1 %."""


_OTHER_MODES = 4
"""Errors of modes outside the frame that are let free, the largest ones."""


def nuisance_columns(
    rows: LawRows,
    rig: Rig,
    known: KnownForces | None,
    motion: ComplexArray | None,
    forces: Sequence[tuple[FloatArray, ComplexArray]] = (),
) -> tuple[ComplexArray, tuple[str, ...]]:
    """Columns (L, R, m) that one standard deviation of each error adds to the rows, with their names.

    Args:
        rows: of the levels.
        rig: the model.
        known: its own elements whose force is not linear; None without.
        motion: of their coordinates, m, (r, L, ORDERS + 1).
        forces: participation and harmonics of laws that act in addition.
    """
    frame, levels, limits = rows.frame, rows.levels, THRESHOLDS.law
    size, channels = rows.sigma.shape[1], len(levels.channels)
    q = rows.coordinate([])
    columns, names = [], []

    def add(name: str, column: ComplexArray, std: float) -> None:
        columns.append(std * column)
        names.append(name)

    def residual(number: int, values: ComplexArray) -> ComplexArray:
        found = np.zeros((levels.count, size), complex)
        found[:, number] = values
        return found

    def at_channel(channel: int, values: ComplexArray) -> ComplexArray:
        """What coordinates (L, T) times the shapes at one channel add to its fundamental."""
        y = np.zeros((levels.count, channels), complex)
        y[:, channel] = values @ rows.shapes[channel]
        beyond = np.zeros((levels.count, channels, max(rows.highest - 1, 0)), complex)
        column = rows.assembled(np.zeros_like(rows.near), y, beyond)
        # What all gains do together is one of the force; else they could take off the whole motion and the force.
        column[:, : len(rows.modes)] += rows.near * values / channels
        return column

    for j, mode in enumerate(rows.modes):
        omega_j, zeta = frame.omega[mode], frame.zeta[mode]
        what = "the mode" if len(rows.modes) == 1 else f"mode {mode + 1}"
        add(f"frequency of {what}", residual(j, -2.0 * omega_j**2 * q[:, j]), limits.mode_frequency_std)
        damping = max(limits.mode_damping_std * zeta, limits.least_damping_std)
        add(f"damping of {what}", residual(j, -2j * omega_j * levels.omega * q[:, j]), damping)
        for i in range(j):
            # What makes the frequencies of two modes uncertain turns their shapes into each other, too.
            both, pair = omega_j * frame.omega[rows.modes[i]], f"modes {rows.modes[i] + 1} and {mode + 1}"
            mixed = residual(i, -q[:, j]) + residual(j, -q[:, i])
            add(f"coupling of {pair}", 2.0 * both * mixed, limits.mode_frequency_std)
            lost = max(limits.mode_damping_std * math.sqrt(zeta * frame.zeta[rows.modes[i]]), limits.least_damping_std)
            add(f"damping between {pair}", 2j * math.sqrt(both) * levels.omega[:, np.newaxis] * mixed, lost)
    typical = np.sqrt(np.mean(rows.shapes**2, axis=0))
    sensors = {c.point: c.name for c in reversed(levels.recorded) if c not in levels.channels}
    force_names = [sensors.get(point, "") for point in levels.drive_points]
    for k, (name, tolerance) in enumerate([(c.name, _tolerance(rows, c.name)) for c in levels.channels]):
        # Near a node the error of the mode's form is a share of its size elsewhere.
        form = limits.form_std * max(1.0, typical[0] / max(abs(rows.shapes[k, 0]), 1e-6 * typical[0]))
        column = at_channel(k, q)
        # The form of the mode may be off, too, and turned by dampers.
        add(f"gain of {name}", column, math.hypot(tolerance.gain, form))
        turn = tolerance.phase_at(float(np.median(levels.omega)))
        add(f"phase of {name}", 1j * column, math.hypot(turn, form))
        for j, mode in list(enumerate(rows.modes))[1:]:
            here = max(abs(rows.shapes[k, j]), 1e-6 * typical[j])
            column = at_channel(k, np.where(np.arange(len(rows.modes)) == j, q, 0.0))
            spread = limits.form_std * max(1.0, typical[j] / here)
            add(f"form of mode {mode + 1} at {name}", column, spread)
            add(f"turn of mode {mode + 1} at {name}", 1j * column, spread)
    if levels.ratio is None:
        acting = [-rows.of_force(participation, force) for participation, force in rows.drives]
    else:
        acting = [-sum((rows.of_force(p, force) for p, force in rows.drives), np.zeros((levels.count, size), complex))]
    for number, drive in enumerate(acting):
        name = force_names[number] if number < len(force_names) else ""
        tolerance, what = _tolerance(rows, name), "the force" if len(acting) == 1 else name
        add(f"gain of {what}", drive, tolerance.gain)
        add(f"phase of {what}", 1j * drive, tolerance.phase_at(float(np.median(levels.omega))))
        for j, mode in list(enumerate(rows.modes))[1:] if levels.ratio is None else []:
            participation, force = rows.drives[number]
            share = max(float(typical[j]), abs(float(participation[mode])))
            add(f"form of mode {mode + 1} at {what}", residual(j, share * force[:, 1]), limits.form_std)
    for name, column in _of_other_modes(rows, forces):
        add(name, column, 1.0)
    if known is not None and motion is not None:
        for name, column, std in _of_elements(rows, rig, known, motion):
            add(name, column, std)
        # Friction feels an error of the amplitude that all channels share.
        scaled = known.of((1.0 + _STEP) * motion, levels.omega) - known.of((1.0 - _STEP) * motion, levels.omega)
        shared = sum(
            (rows.of_force(p, force) for p, force in zip(known.participation, scaled / (2.0 * _STEP), strict=True)),
            np.zeros((levels.count, size), complex),
        )
        gains = [_tolerance(rows, channel.name).gain for channel in levels.channels]
        add("scale of the motion", shared, float(np.mean(gains)))
    return np.stack(columns, axis=-1), tuple(names)


def _of_other_modes(rows: LawRows, forces: Sequence[tuple[FloatArray, ComplexArray]]) -> list[tuple[str, ComplexArray]]:
    """What one standard deviation of frequency and damping of other modes does to the rows by forces of laws.

    It is one error at all levels and channels, which the uncertainty of the rows takes for many.
    """
    frame, levels, limits = rows.frame, rows.levels, THRESHOLDS.law
    found: list[tuple[float, str, ComplexArray]] = []
    for mode in np.flatnonzero(frame.omega > 0.0) if forces else []:
        response = np.zeros((levels.count, rows.highest + 1), complex)
        for participation, force in forces:
            response += participation[mode] * force[:, : rows.highest + 1]
        d = np.array([rows.denominators[h][:, mode] for h in range(rows.highest + 1)]).T
        changes = {
            "frequency": np.full(d.shape, 2.0 * limits.mode_frequency_std * frame.omega[mode] ** 2, complex),
            "damping": 2j * limits.mode_damping_std * frame.zeta[mode] * frame.omega[mode]
            * levels.omega[:, np.newaxis] * np.arange(rows.highest + 1),
        }  # fmt: skip
        for what, change in changes.items():
            moved = frame.sensors[:, mode] * (response * change / d**2)[:, :, np.newaxis]
            first = np.zeros_like(moved[:, 1]) if mode in rows.modes else moved[:, 1]
            column = rows.assembled(np.zeros_like(rows.near), first, np.moveaxis(moved[:, 2:], 1, 2))
            size = float(np.linalg.norm(column / rows.sigma))
            if size > 1.0:
                found.append((size, f"{what} of mode {mode + 1} at its harmonics", column))
    found.sort(key=lambda one: -one[0])
    return [(name, column) for _, name, column in found[:_OTHER_MODES]]


def _tolerance(rows: LawRows, name: str) -> ChannelTolerance:
    return rows.levels.chain.of(name) if rows.levels.chain is not None else ChannelTolerance()


def _of_elements(
    rows: LawRows, rig: Rig, known: KnownForces, motion: ComplexArray
) -> list[tuple[str, ComplexArray, float]]:
    """Parameters of the model's own elements: name, change of the rows, prior standard deviation 1."""
    found = []
    here = known.of(motion, rows.levels.omega)
    for parameter in calibration_parameters(rig):
        if parameter.path[0] != "local_elements":
            continue
        moved_rig = parameter.apply(rig, _STEP / parameter.std)
        elements = [e for e in build_elements(moved_rig, rows.frame.structure) if not e.linear]
        if len(elements) != len(rows.frame.elements):
            continue
        moved = KnownForces(elements, rows.frame).of(motion, rows.levels.omega, known)
        slopes = (moved - here) / (_STEP / parameter.std)
        if not np.any(slopes):
            continue
        column: ComplexArray = np.zeros(rows.sigma.shape, complex)
        for participation, force in zip(known.participation, slopes, strict=True):
            column = column + rows.of_force(participation, force)
        found.append((parameter.name, column, 1.0))
    return found


def known_motion(
    rows: LawRows, known: KnownForces, others: list[tuple[FloatArray, ComplexArray]]
) -> tuple[ComplexArray, list[tuple[FloatArray, ComplexArray]]]:
    """Motion of the model's own elements (r, L, ORDERS + 1) and their forces, for other local forces that are known."""
    forces: list[tuple[FloatArray, ComplexArray]] = []
    motion = np.zeros((len(known.participation), rows.levels.count, ORDERS + 1), complex)
    for _ in range(MOTION_ROUNDS):
        motion = np.array([rows.motion(p, [*forces, *others]) for p in known.participation])
        made = known.of(motion, rows.levels.omega)
        forces = list(zip(known.participation, made, strict=True))
    return motion, forces
