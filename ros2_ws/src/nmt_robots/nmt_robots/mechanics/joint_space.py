"""Torque of one joint as rows about its model: what may move within its tolerance, and the columns of its causes.

Every set of causes carries the same nuisances: friction, damping and armature about the model's values, mass, inertia
and torque about one, a delay about none, each with the cost of its pull. One cause that is far off wins so against five
that are each two standard deviations off.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nmt_diagnose.choose.space import Columns, Space
from nmt_robots.log.joint_log import Array
from nmt_robots.mechanics.columns import JointEffect
from nmt_robots.thresholds import THRESHOLDS

_PER_SECOND = 4.0
"""Independent rows in a second: neighbours leave the same errors of the model over."""
MARGIN = 0.01
"""Share of the torque by which friction, damping and armature may come out below zero where none is there."""
_RELATIVE = {
    "coulomb": THRESHOLDS.coulomb_tolerance,
    "viscous": THRESHOLDS.damping_tolerance,
    "armature": THRESHOLDS.armature_tolerance,
}


def independent_rows(rows: int, step_s: float) -> float:
    """Number of independent ones among so many."""
    return max(_PER_SECOND * rows * step_s, 8.0)


def joint_space(
    left: Array, torque: Array, bodies: Sequence[Array], seconds: Array, step_s: float,
    effects: Sequence[tuple[JointEffect, Array]], in_model: dict[str, float],
) -> Space:  # fmt: skip
    """Rows of a joint about its model as given.

    Args:
        left: rows, N·m; torque of the drive without that of the rigid bodies.
        torque: rows, N·m, of the drive, filtered.
        bodies: rows each: angle (rad), gravity and inertial torque (N·m), change of the torque (N·m/s), filtered.
        seconds: rows; number of the second of each.
        step_s: between rows.
        effects: what may be a cause, with filtered columns in the rows.
        in_model: values of the usual effects in the model, by key; those of them are nuisances as well.
    """
    size = max(float(np.std(torque)), 1e-12)
    nuisances, library = [], []
    for effect, values in effects:
        lowest, largest = (0.0 if effect.never_negative else -effect.largest), effect.largest
        if effect.key in in_model:
            mean, rms = in_model[effect.key], max(float(np.std(values)), 1e-12)
            left = left - mean * values[:, 0]
            # What a model does not state is left to the log.
            nuisances.append((_RELATIVE[effect.key] * abs(mean) or size / rms) * values[:, 0])
            lowest = -mean - MARGIN * size / rms
        elif effect.key == "offset":
            nuisances.append(0.02 * size * values[:, 0])
        elif not effect.made_of_torque:
            # What takes more than all of the torque takes it from others.
            largest = min(largest, size / max(float(np.std(values[:, 0])), 1e-12))
            lowest = max(lowest, -largest)
        strengths = effect.parameters
        if effect.frees == "offset":
            values = np.column_stack([values, np.ones(len(values))])
        library.append(
            Columns("", effect.key, values, effect.shape, lowest if strengths == 1 else 0.0, largest, effect.smallest,
                    strengths, effect.made_of_torque)
        )  # fmt: skip
    angle, gravity, inertial, change = bodies
    heaviest = float(np.max(np.abs(gravity)))
    nuisances += [
        1.5 * THRESHOLDS.mass_tolerance * gravity,
        THRESHOLDS.inertia_tolerance * inertial,
        THRESHOLDS.torque_tolerance * torque,
        THRESHOLDS.mass_tolerance * heaviest * np.cos(angle),
        THRESHOLDS.mass_tolerance * heaviest * np.sin(angle),
        THRESHOLDS.lag_s * change,
    ]
    independent = independent_rows(len(left), step_s)
    floor = THRESHOLDS.smallest_floor * size
    return Space(left, np.column_stack(nuisances), seconds, independent, floor, torque, library)
