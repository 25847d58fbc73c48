"""Columns that a joint's torque may be a sum of, beyond that of the rigid bodies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nmt_robots.log.joint_log import Array
from nmt_robots.mechanics.motion import Motion

_LARGEST_SCALE = 0.5
"""Of gravity or inertia: no link of a model is wrong by more than half."""

_PASSIVE = frozenset({"stribeck", "quadratic_friction", "root_friction", "load_friction", "end_stop"})
"""Rivals that would drive the joint if their coefficient were negative."""


@dataclass(frozen=True, eq=False)
class Effect:
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

    @property
    def parameters(self) -> int:
        """K."""
        return int(self.columns.shape[1])


def usual_effects(motion: Motion, joint: int) -> list[Effect]:
    """Coulomb and viscous friction, armature and an offset: the plain fit."""
    v, a = motion.v[:, joint], motion.a[:, joint]
    return [
        Effect("coulomb", "Coulomb friction", "N·m", np.sign(v)[:, None], never_negative=True),
        Effect("viscous", "viscous friction", "N·m·s/rad", v[:, None], never_negative=True),
        Effect("armature", "armature", "kg·m²", a[:, None], never_negative=True),
        Effect("offset", "offset of the torque", "N·m", np.ones((len(v), 1))),
    ]


def rival_effects(
    motion: Motion, joint: int, torque: Array, error: Array | None, names: tuple[str, ...] = ()
) -> list[Effect]:
    """What may come on top of the usual effects, one at a time.

    Args:
        motion: of all joints.
        joint: number of the column.
        torque: N, N·m, of the drive, filtered once.
        names: of the joints, for the links that they carry.
        error: N, filtered once; command minus position where the torque is computed of it; None = it was measured.
    """
    q, v, a = motion.q[:, joint], motion.v[:, joint], motion.a[:, joint]
    direction = np.sign(v)
    gravity, rigid = motion.gravity[:, joint], motion.rigid[:, joint]
    found: list[Effect] = []

    def add(key: str, words: str, unit: str, *columns: Array, shape: str = "", largest: float = np.inf) -> None:
        found.append(Effect(key, words, unit, np.column_stack(columns), key in _PASSIVE, shape, largest))

    for speed in (0.05, 0.1, 0.2, 0.5):
        if speed < 0.3 * float(np.max(np.abs(v))):
            fading = direction * np.exp(-np.abs(v) / speed)
            add("stribeck", "friction that falls with speed (Stribeck)", "N·m", fading, shape=f"{speed:g} rad/s")
    add("quadratic_friction", "friction that grows with the square of speed", "N·m·s²/rad²", v * np.abs(v))
    add("root_friction", "friction that grows with the root of speed", "N·m·√(s/rad)", direction * np.sqrt(np.abs(v)))
    add("viscous_by_direction", "viscous friction that depends on the direction", "N·m·s/rad", np.abs(v))
    add("load_friction", "friction that grows with the load, or efficiency by direction", "1",
        direction * np.abs(torque), largest=_LARGEST_SCALE)  # fmt: skip
    if np.std(gravity) > 0.0:
        add("gravity_scale", "mass or its distance (all of gravity scaled)", "1", gravity, largest=_LARGEST_SCALE)
    for name, doubled in zip(names, motion.of_links, strict=False):
        if np.std(doubled[:, joint]) > 0.01 * np.std(torque):
            add("link_mass", "mass of a link", "1", doubled[:, joint], shape=f"link of {name}")
    if np.std(rigid - gravity) > 0.0:
        add("inertia_scale", "inertia of the links (all of the inertial torque scaled)", "1", rigid - gravity,
            largest=_LARGEST_SCALE)  # fmt: skip
    found.append(
        Effect("spring", "spring or counterbalance", "N·m/rad", (q - np.mean(q))[:, None], frees="offset")
    )  # fmt: skip
    if np.std(gravity) > 0.0:
        add("mass_centre", "mass or centre of mass in the plane of the joint", "N·m", np.cos(q), np.sin(q),
            largest=_LARGEST_SCALE * float(np.max(np.abs(gravity))))  # fmt: skip
    words = "gain, torque constant or gear ratio of the drive (all of its torque scaled)"
    found.append(Effect("gain", words, "1", -torque[:, None], largest=_LARGEST_SCALE, made_of_torque=True))
    if error is not None:
        words = "position gain of the drive"
        found.append(Effect("gain", words, "N·m/rad", -error[:, None], shape="kp", made_of_torque=True))
        size = np.abs(torque)
        lowest, highest = (float(x) for x in np.quantile(size, (0.5, 0.98)))
        for limit in np.linspace(lowest, highest, 16):
            beyond = np.sign(torque) * np.maximum(size - limit, 0.0)
            found.append(Effect("saturation", "limit of the drive's torque", "1", beyond[:, None], True,
                                f"{limit:.3g} N·m", 1.5, True, 0.5))  # fmt: skip
    for side in (1.0, -1.0):
        low, high = np.quantile(side * q, (0.75, 0.998))
        for angle in side * np.linspace(low, high, 20):
            add("end_stop", "end stop", "N·m/rad", side * np.maximum(side * (q - angle), 0.0),
                shape=f"{'above' if side > 0 else 'below'} {angle:.3g} rad")  # fmt: skip
    reach = float(np.ptp(q))
    for order in range(1, 61):
        if order * reach > 2.0 * np.pi:
            add("ripple", "torque that changes with the angle", "N·m", np.cos(order * q), np.sin(order * q),
                shape=f"{order} per turn")  # fmt: skip
    jerk = np.gradient(a, motion.step_s)
    add("jerk", "elastic transmission, backlash or a delay of this joint alone", "kg·m²·s", jerk)
    return found
