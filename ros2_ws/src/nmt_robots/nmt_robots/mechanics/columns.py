"""Columns that a joint's torque may be a sum of, beyond that of the rigid bodies."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nmt_robots.log.joint_log import Array
from nmt_robots.mechanics.motion import Motion, built_up
from nmt_robots.mechanics.readings import DriveSignals

_LARGEST_SCALE = 0.5
"""Of gravity or inertia: no link of a model is wrong by more than half."""

_WARMING = (0.1, 0.2, 0.35, 0.7)
"""Times in which a drive warms, as shares of the log."""

_LARGEST_MASS = 1.0
"""Of a link, as a share of it, that it may carry or lack."""

REACHES = np.geomspace(5e-4, 0.1, 24)
"""Angles over which friction may build up, rad: from asperities of a bearing to hoses and cables."""
_FINEST = 8.0
"""Multiple of an encoder's noise below which the log does not resolve an angle."""

_PASSIVE = frozenset({"stribeck", "quadratic_friction", "root_friction", "load_friction", "end_stop"})
"""Rivals that would drive the joint if their coefficient were negative."""


@dataclass(frozen=True, eq=False)
class State:
    """Motion of a joint and the torques on it: N rows each, or numbers of one moment of a simulation.

    Attributes:
        q, v, a: angle, speed, acceleration; rad, rad/s, rad/s².
        gravity, inertial: torque of the rigid bodies at rest, and what motion adds to it, N·m.
        torque: of the drive, N·m.
        error, speed_error: what its gains multiply, rad and rad/s; NaN where the torque was measured.
        built: friction of size one that builds up over an angle; NaN where that is not asked.
    """

    q: Any
    v: Any
    a: Any
    gravity: Any
    inertial: Any
    torque: Any = math.nan
    error: Any = math.nan
    speed_error: Any = math.nan
    built: Any = math.nan


Law = Callable[[State], tuple[Any, ...]]
"""Torques of a state, one for each coefficient, per unit."""


@dataclass(frozen=True, eq=False)
class JointEffect:
    """What may act in a joint.

    Attributes:
        key: name in files.
        words: name in sentences.
        unit: of each coefficient.
        columns: N × K, N·m per unit, unfiltered; made of a motion.
        never_negative: whether a negative coefficient is impossible.
        shape: number that is fixed in the columns, such as a speed; in sentences.
        largest: size of a coefficient beyond which it is not what its words say; infinite without one.
        smallest: the same below which it is not.
        frees: key of a usual effect that it brings with it, such as the offset of a spring whose rest is not known.
        made_of_torque: whether the columns are part of the drive's torque itself, so that they can make it small.
        law: that the columns follow; None for columns of more than one joint.
        reach: angle over which friction builds up, rad; zero of other effects.
    """

    key: str
    words: str
    unit: str
    columns: Array
    never_negative: bool = False
    shape: str = ""
    largest: float = np.inf
    made_of_torque: bool = False
    smallest: float = 0.0
    frees: str = ""
    law: Law | None = None
    reach: float = 0.0

    @property
    def parameters(self) -> int:
        """K."""
        return int(self.columns.shape[1])


def _following(state: State, law: Law, key: str, words: str, unit: str, **limits: Any) -> JointEffect:
    """An effect whose columns a law makes of the rows of a state."""
    rows = len(state.q)
    columns = np.column_stack([np.broadcast_to(column, rows) for column in law(state)])
    return JointEffect(key, words, unit, columns, law=law, **limits)


def usual_effects(motion: Motion, joint: int) -> list[JointEffect]:
    """Coulomb and viscous friction, armature and an offset: the plain fit."""
    state = _state(motion, joint)
    return [
        _following(state, lambda s: (np.sign(s.v),), "coulomb", "Coulomb friction", "N·m", never_negative=True),
        _following(state, lambda s: (s.v,), "viscous", "viscous friction", "N·m·s/rad", never_negative=True),
        _following(state, lambda s: (s.a,), "armature", "armature", "kg·m²", never_negative=True),
        _following(state, lambda s: (1.0,), "offset", "offset of the torque", "N·m"),
    ]


def creeping_effects(motion: Motion, joint: int) -> list[JointEffect]:
    """Friction that builds up over an angle instead of at once, for angles that the encoder resolves."""
    position, state = motion.position[:, [joint]], _state(motion, joint)
    noise = float(np.median(np.abs(np.diff(position[:, 0], 2)))) / (0.6745 * np.sqrt(6.0))
    steps = np.abs(np.diff(position[:, 0]))
    coarse = max(noise, float(np.min(steps[steps > 0.0], initial=np.inf)))
    return [
        _following(
            replace(state, built=motion.smooth(built_up(position, reach)[:, 0])), lambda s: (s.built - np.sign(s.v),),
            "creep", "friction that builds up over an angle", "N·m", never_negative=True,
            shape=f"{1e3 * reach:.2g} mrad", reach=float(reach),
        )
        for reach in REACHES
        if reach > _FINEST * coarse
    ]  # fmt: skip


def _state(motion: Motion, joint: int, drive: DriveSignals | None = None) -> State:
    q, v, a = motion.q[:, joint], motion.v[:, joint], motion.a[:, joint]
    gravity = motion.gravity[:, joint]
    bodies = gravity, motion.rigid[:, joint] - gravity
    if drive is None:
        return State(q, v, a, *bodies)
    error = math.nan if drive.error is None else drive.error
    return State(q, v, a, *bodies, drive.torque, error, math.nan if drive.speed_error is None else drive.speed_error)


def rival_effects(motion: Motion, joint: int, drive: DriveSignals, names: tuple[str, ...] = ()) -> list[JointEffect]:
    """What may come on top of the usual effects, one at a time.

    Args:
        motion: of all joints.
        joint: number of the column.
        drive: of the joint, filtered once.
        names: of the joints, for the links that they carry.
    """
    state = _state(motion, joint, drive)
    torque = drive.torque
    found: list[JointEffect] = []

    def add(law: Law, key: str, words: str, unit: str, **limits: Any) -> None:
        limits.setdefault("never_negative", key in _PASSIVE)
        found.append(_following(state, law, key, words, unit, **limits))

    for speed in (0.05, 0.1, 0.2, 0.5):
        if speed < 0.3 * float(np.max(np.abs(state.v))):
            for power, how in ((1, ""), (2, " as a bell")):
                add(_falling(speed, power), "stribeck", "friction that falls with speed (Stribeck)", "N·m",
                    shape=f"{speed:g} rad/s{how}")  # fmt: skip
    time = motion.step_s * np.arange(len(motion.q))
    for share in _WARMING:
        fades = np.sign(state.v) * np.exp(-time / (share * time[-1]))
        found.append(JointEffect("changing_friction", "friction that changes over the log", "N·m", fades[:, None],
                            shape=f"within {share * time[-1]:.2g} s"))  # fmt: skip
    add(lambda s: (s.v * np.abs(s.v),), "quadratic_friction", "friction that grows with the square of speed",
        "N·m·s²/rad²")  # fmt: skip
    add(lambda s: (np.sign(s.v) * np.sqrt(np.abs(s.v)),), "root_friction",
        "friction that grows with the root of speed", "N·m·√(s/rad)")  # fmt: skip
    add(lambda s: (np.abs(s.v),), "viscous_by_direction", "viscous friction that depends on the direction",
        "N·m·s/rad")  # fmt: skip
    add(lambda s: (np.sign(s.v) * np.abs(s.torque),), "load_friction",
        "friction by load or efficiency", "1", largest=_LARGEST_SCALE)  # fmt: skip
    if np.std(state.gravity) > 0.0:
        add(lambda s: (s.gravity,), "gravity_scale", "gravity of its links", "1",
            largest=_LARGEST_SCALE)  # fmt: skip
    for name, doubled in zip(names, motion.of_links, strict=False):
        if np.std(doubled[:, joint]) > 0.01 * np.std(torque):
            found.append(JointEffect("link_mass", "mass of a link", "1", doubled[:, [joint]], shape=f"link of {name}",
                                largest=_LARGEST_MASS))  # fmt: skip
    if np.std(state.inertial) > 0.0:
        add(lambda s: (s.inertial,), "inertia_scale", "inertia of its links", "1",
            largest=_LARGEST_SCALE)  # fmt: skip
    middle = float(np.mean(state.q))
    add(lambda s: (s.q - middle,), "spring", "spring or counterbalance", "N·m/rad", frees="offset")
    if np.std(state.gravity) > 0.0:
        add(lambda s: (np.cos(s.q), np.sin(s.q)), "mass_centre", "mass or centre of mass in the plane of the joint",
            "N·m", largest=_LARGEST_SCALE * float(np.max(np.abs(state.gravity))))  # fmt: skip
    found += _of_the_drive(state, drive)
    for side in (1.0, -1.0):
        low, high = np.quantile(side * state.q, (0.75, 0.998))
        for angle in side * np.linspace(low, high, 20):
            add(_stopped(side, angle), "end_stop", "end stop", "N·m/rad",
                shape=f"{'above' if side > 0 else 'below'} {angle:.3g} rad")  # fmt: skip
    reach = float(np.ptp(state.q))
    for order in range(1, 61):
        if order * reach > 2.0 * np.pi:
            add(_rippling(order), "ripple", "torque that changes with the angle", "N·m", shape=f"{order} per turn")
    jerk = np.gradient(state.a, motion.step_s)[:, None]
    words = "elastic transmission, backlash or a delay of this joint alone"
    found.append(JointEffect("jerk", words, "kg·m²·s", jerk))
    return found


def _of_the_drive(state: State, drive: DriveSignals) -> list[JointEffect]:
    """Gains, torque constant and limit of a drive."""
    words = "scale of the drive's torque"
    found = [_following(state, lambda s: (-s.torque,), "gain", words, "1", largest=_LARGEST_SCALE, made_of_torque=True)]
    if drive.error is None:
        return found
    for law, words, unit, shape in (
        (lambda s: (-s.error,), "position gain of the drive", "N·m/rad", "kp"),
        (lambda s: (-s.speed_error,), "velocity gain of the drive", "N·m·s/rad", "kd"),
    ):
        found.append(_following(state, law, "gain", words, unit, shape=shape, made_of_torque=True))
    lowest, highest = (float(x) for x in np.quantile(np.abs(drive.torque), (0.5, 0.98)))
    for limit in np.linspace(lowest, highest, 16):
        found.append(
            _following(
                state, _limited(float(limit)), "saturation", "limit of the drive's torque", "1", never_negative=True,
                shape=f"{limit:.3g} N·m", largest=1.5, smallest=0.5, made_of_torque=True,
            )
        )  # fmt: skip
    return found


def _falling(speed: float, power: int) -> Law:
    return lambda s: (np.sign(s.v) * np.exp(-np.power(np.abs(s.v) / speed, power)),)


def _stopped(side: float, angle: float) -> Law:
    return lambda s: (side * np.maximum(side * (s.q - angle), 0.0),)


def _rippling(order: int) -> Law:
    return lambda s: (np.cos(order * s.q), np.sin(order * s.q))


def _limited(limit: float) -> Law:
    return lambda s: (np.sign(s.torque) * np.maximum(np.abs(s.torque) - limit, 0.0),)
