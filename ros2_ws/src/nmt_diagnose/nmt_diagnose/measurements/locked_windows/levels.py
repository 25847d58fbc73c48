"""Locked windows as complex amplitudes of force and motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nmt_core.messages.blocks import Quantity
from nmt_core.vocabulary import MOTIONS
from nmt_diagnose.law.held_levels import HeldLevels, complex_amplitudes
from nmt_diagnose.observations.observables import Observations, Part

if TYPE_CHECKING:
    from nmt_diagnose.measurements.locked_windows.locked_windows import LockedWindows


def levels_of_windows(test: LockedWindows, observations: Observations, number: int) -> HeldLevels | None:
    """Locked windows as levels; None where an exciter has no force, no channel a motion, or a response was held.

    Args:
        test: the windows.
        observations: the real side.
        number: of the test.
    """
    if test.held == "response":
        return None
    rows, here = observations.rows, observations.rows.test == number
    sensors = {c.point: k for k, c in reversed(list(enumerate(test.channels))) if c.quantity is Quantity.FORCE}
    forces = [sensors[point] for point in test.drive_points if point in sensors]
    moved = [k for k, channel in enumerate(test.channels) if channel.quantity in MOTIONS]
    single = test.held == "force" and len(test.drive_points) == 1
    if not moved or (len(forces) < len(test.drive_points) and not single):
        return None
    values, std = complex_amplitudes(observations, rows, here, len(test.levels), len(test.channels), test.harmonics)
    omega = np.full(len(test.levels), np.nan)
    frequency = here & (rows.part == Part.LOG_FREQUENCY)
    omega[rows.level[frequency]] = np.exp(observations.values[frequency])
    force = np.zeros((len(test.drive_points), len(test.levels), test.harmonics + 1), complex)
    force_std = np.zeros(force.shape[:2])
    if single:
        for k, level in enumerate(test.levels):
            terms = np.array(level.terms[0][: test.harmonics])
            force[0, k, 1 : 1 + terms.size] = level.force_n * terms
    else:
        force = np.nan_to_num(np.moveaxis(values[:, forces], 1, 0))
        force_std = np.nan_to_num(np.moveaxis(std[:, forces, 1], 1, 0))
    orders = np.maximum(np.arange(test.harmonics + 1), 1)
    powers = np.array([MOTIONS[test.channels[k].quantity] for k in moved])
    scale = (1j * omega[:, None, None] * orders) ** powers[None, :, None]
    with np.errstate(invalid="ignore"):  # levels that are held out have no frequency
        motion, motion_std = values[:, moved] / scale, std[:, moved] / np.abs(scale)
    size = np.nanmax(np.abs(motion[:, :, 1]), axis=1, initial=0.0)
    usable = np.isfinite(omega) & (np.abs(force[:, :, 1]).max(axis=0) > 0.0) & (size > 0.0)
    order = [int(k) for k in np.argsort(size, kind="stable") if usable[k]]
    chain = observations.chains[number] if observations.chains else None
    channels = tuple(test.channels[k] for k in moved)
    found = HeldLevels(
        test.name, test.drive_points, tuple(level.index for level in test.levels), omega, force, force_std, channels,
        motion, motion_std, chain, recorded=test.channels,
    )  # fmt: skip
    return found.take(order) if order else None
