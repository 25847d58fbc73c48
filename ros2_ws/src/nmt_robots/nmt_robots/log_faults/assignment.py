"""Whether the columns of a log are the joints that they are called, and turn the way the model's joints turn.

Two columns in each other's place, or one turned, are reported where the rigid bodies would explain far more of the
torque so. Nothing is fitted in the other order: the sidecar is to be put right.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nmt_robots.log.joint_log import Array, JointLog
from nmt_robots.log_faults.finding import Finding
from nmt_robots.mechanics.motion import Motion
from nmt_robots.model.robot_model import RobotModel

_ROWS = 800
_POOR = 0.15
"""Torque left over as a share of the torque above which the columns are doubted."""
_BETTER = 0.35
"""Of the squared residual of the columns as named, by the joints that change."""


@dataclass(frozen=True)
class _Other:
    """Another reading of the columns: places of the columns, signs, and the joints that change."""

    places: tuple[int, ...]
    signs: tuple[float, ...]
    changed: tuple[int, ...]


def assignment_findings(model: RobotModel, log: JointLog, motion: Motion, torque: Array) -> list[Finding]:
    """Columns in a wrong order or with a wrong sign; nothing where the columns as they are explain the torque."""
    joints = torque.shape[1]
    smooth = motion.smooth(torque)
    usable = np.flatnonzero(np.any(motion.moving, axis=1))
    if len(usable) < 100:
        return []
    rows = usable[:: max(1, len(usable) // _ROWS)]
    as_named = _left(model, log, motion, smooth, rows, _Other(tuple(range(joints)), (1.0,) * joints, ()))
    poor = np.flatnonzero(motion.moves & (as_named > _POOR**2))
    if not len(poor):
        return []
    plain = tuple(range(joints))
    best, least = None, _BETTER
    turned: dict[int, float] = {}
    for other in _others(joints, poor):
        left = _left(model, log, motion, smooth, rows, other)
        changed = list(other.changed)
        ratio = float(np.sum(left[changed]) / max(np.sum(as_named[changed]), 1e-300))
        if other.places == plain:
            turned[other.changed[0]] = float(np.sum(left))
        # Joints that do not change have to stay as well explained.
        if ratio < least and float(np.sum(left)) < 0.6 * float(np.sum(as_named)):
            best, least = other, ratio
    if best is None:
        return []
    names = tuple(log.joints[number] for number in best.changed)
    if best.places != plain:
        sentence = (
            f"The columns of {names[0]} and {names[1]} are in each other's place: so the bodies leave "
            f"{100 * np.sqrt(least):.0f} % of the residual as named. Put the order of the joints right."
        )
        return [Finding("order", sentence, float(np.sqrt(least)), float("nan"), "1", joints=names)]
    lowest = turned[best.changed[0]]
    # A chain of parallel joints and its mirror image are the same.
    names = tuple(log.joints[number] for number, left_over in turned.items() if left_over < 1.5 * lowest)
    sentence = (
        f"{' or '.join(names)} turns the other way than in the model: with its columns turned the bodies leave "
        f"{100 * np.sqrt(least):.0f} % of the residual as logged. Put its sign right."
    )
    return [Finding("joint_sign", sentence, float(np.sqrt(least)), float("nan"), "1", joints=names)]


def _others(joints: int, poor: Array) -> list[_Other]:
    """Exchanges of two columns and turns of one, where a joint is poorly explained."""
    doubted = set(poor.tolist())
    found = []
    for first in range(joints):
        if first in doubted:
            signs = [1.0] * joints
            signs[first] = -1.0
            found.append(_Other(tuple(range(joints)), tuple(signs), (first,)))
        for second in range(first + 1, joints):
            if doubted & {first, second}:
                places = list(range(joints))
                places[first], places[second] = second, first
                found.append(_Other(tuple(places), (1.0,) * joints, (first, second)))
    return found[:120]


def _left(model: RobotModel, log: JointLog, motion: Motion, torque: Array, rows: Array, other: _Other) -> Array:
    """J: torque left over by the bodies and the usual effects, squared, as a share of the torque's square."""
    places, signs = np.array(other.places), np.array(other.signs)
    q, v, a = (values[np.ix_(rows, places)] * signs for values in (motion.q, motion.v, motion.a))
    rigid = model.torque(log.joints, q, v, a)
    acting = torque[np.ix_(rows, places)] * signs
    found = np.zeros(len(places))
    for joint in range(len(places)):
        matrix = np.column_stack([np.tanh(v[:, joint] / 0.05), v[:, joint], a[:, joint]])
        size = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
        left = acting[:, joint] - rigid[:, joint]
        solution = np.linalg.lstsq(matrix / size, left, rcond=1e-10)[0] / size
        # A negative armature or damping is not an explanation.
        solution = np.maximum(solution, 0.0)
        found[joint] = float(np.sum((left - matrix @ solution) ** 2) / max(np.sum(acting[:, joint] ** 2), 1e-300))
    return found
