"""Which motion would part what a log leaves open: a trajectory inside the ranges of the joints and what the log had."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nmt_robots.log.joint_log import Array
from nmt_robots.mechanics.motion import Motion, smoothed, window_of
from nmt_robots.mechanics.readings import Reading
from nmt_robots.model.robot_model import Joint
from nmt_robots.thresholds import THRESHOLDS
from nmt_robots.verdict.joint_verdict import JointVerdict

STEP_S = 0.01
_MARGIN = 0.1
"""Of a joint's range, kept free at each end."""
_WIDEST_RAD = 0.6
_SECONDS = 12.0
_IN_PHASE = 0.8


@dataclass(frozen=True)
class Request:
    """One part of a motion.

    Attributes:
        kind: ``triangle``, ``reversals``, ``chirp``, ``poses`` or ``out_of_phase``.
        joints: that move; the others keep their pose.
        why: what it parts.
        gain: by which factor the ± of a joint's Coulomb and viscous friction shrink in the same time, the lesser of
            the two; NaN where it is asked for something else.
        of_all: whether these are all joints of the log.
    """

    kind: str
    joints: tuple[str, ...]
    why: str
    gain: float = float("nan")
    of_all: bool = False

    @property
    def sentence(self) -> str:
        """For people."""
        whose = "all joints" if self.of_all else ", ".join(self.joints)
        words = f"{_KINDS[self.kind]} of {whose}: {self.why}"
        if self.gain > 1.2:
            words += f"; in the same time the ± of Coulomb and viscous friction shrink at least {self.gain:.2g}-fold"
        return words + "."

    def to_mapping(self) -> dict[str, Any]:
        """As ``diagnosis.json`` has it."""
        return {"kind": self.kind, "joints": list(self.joints), "why": self.why, "gain": self.gain}


@dataclass(frozen=True, eq=False)
class NextMotion:
    """What to move next.

    Attributes:
        joints: all of the log, in the order of its columns.
        requests: parts, in order.
        time: N, s.
        position: N × J, rad.
        part: N; number of the request.
    """

    joints: tuple[str, ...]
    requests: tuple[Request, ...]
    time: Array
    position: Array
    part: Array


_KINDS = {
    "triangle": "A slow triangle at two speeds",
    "reversals": "Slow reversals",
    "chirp": "A chirp at two amplitudes",
    "poses": "Poses held",
    "out_of_phase": "Sines out of phase",
}


def next_motion(
    motion: Motion, joints: Sequence[Joint], verdicts: Sequence[JointVerdict], as_well: Sequence[Reading],
    classes: Sequence[str] = (),
) -> NextMotion:  # fmt: skip
    """The motion that parts what remains open; where nothing is, one of another kind, as a test of the answer.

    Args:
        motion: of the log.
        joints: of its columns.
        verdicts: of the joints.
        as_well: readings that fit as well, the chosen one included.
        classes: joints whose drive's scale and link's mass are not told apart.
    """
    room = [_Room.of(motion, joint, number) for number, joint in enumerate(joints)]
    wanted = _wanted(motion, joints, verdicts, as_well, classes)
    pose = np.array([item.centre for item in room])
    parts: list[Array] = []
    requests: list[Request] = []
    for request in wanted:
        moved = [number for number, joint in enumerate(joints) if joint.name in request.joints]
        part = np.tile(pose, (round(_SECONDS / STEP_S), 1))
        for place, number in enumerate(moved):
            part[:, number] += _shape(request.kind, room[number], place, len(moved))
        gains = [_gain(motion, number, part[:, number]) for number in moved] if request.kind == "triangle" else []
        of_all = len(moved) == len(joints) > 1
        requests.append(Request(request.kind, request.joints, request.why, min(gains, default=float("nan")), of_all))
        parts.append(part)
    counted = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    position = np.vstack(parts)
    return NextMotion(
        tuple(joint.name for joint in joints), tuple(requests), STEP_S * np.arange(len(position)), position, counted
    )  # fmt: skip


@dataclass(frozen=True)
class _Room:
    """What a joint may do: centre (rad), reach to each side (rad), speed (rad/s) and acceleration (rad/s²)."""

    centre: float
    reach: float
    speed: float
    acceleration: float

    @staticmethod
    def of(motion: Motion, joint: Joint, number: int) -> _Room:
        """Inside the range of the joint, no faster than it was in the log; a joint that stood still goes slowly."""
        centre = float(np.median(motion.q[:, number]))
        lower, upper = joint.lower, joint.upper
        if np.isfinite(lower) and np.isfinite(upper):
            margin = _MARGIN * (upper - lower)
            centre = float(np.clip(centre, lower + margin, upper - margin))
            reach = min(centre - lower, upper - centre) - 0.5 * margin
        else:
            reach = max(0.5 * float(np.ptp(motion.q[:, number])), 0.1)
        return _Room(
            centre, min(reach, _WIDEST_RAD), max(float(np.quantile(np.abs(motion.v[:, number]), 0.99)), 0.5),
            max(float(np.quantile(np.abs(motion.a[:, number]), 0.99)), 5.0),
        )  # fmt: skip


def _wanted(
    motion: Motion, joints: Sequence[Joint], verdicts: Sequence[JointVerdict], as_well: Sequence[Reading],
    classes: Sequence[str],
) -> list[Request]:  # fmt: skip
    """Parts by what remains open, what matters most first, at most three."""
    found: list[Request] = []

    def ask(kind: str, names: Sequence[str], why: str) -> None:
        if names and len(found) < 3:
            found.append(Request(kind, tuple(names), why))

    ask("triangle", [item.joint.name for item in verdicts if item.mechanics is None], "it did not move enough")
    loose = [item for item in verdicts if item.differs and item.terms[0].key in ("elastic", "backlash")]
    ask("reversals", [item.joint.name for item in loose],
        "play shows as a step at each reversal, a spring as a slope")  # fmt: skip
    ask("chirp", [item.joint.name for item in loose],
        "an apparent stiffness that grows with the load is backlash, one that stays is a spring")  # fmt: skip
    ask(
        "poses",
        list(classes),
        "gravity alone, once with a known payload, separates the scale of the drive from the mass of the link",
    )
    unknown = [item for item in verdicts if item.mechanics is not None and item.cause == "not known"]
    ask("triangle", [item.joint.name for item in unknown],
        "without inertia, friction shows its dependence on speed, angle and load")  # fmt: skip
    if len({(reading.command_lag_s, reading.torque_lag_s) for reading in as_well}) > 1:
        movers = [joint.name for number, joint in enumerate(joints) if motion.moves[number]]
        ask("chirp", movers, "it separates the drive's delay from damping: several delays fit this log")
    ask("out_of_phase", _in_phase(motion, joints), "they moved in phase, so their torques cannot be separated")
    if not found:
        ask(
            "triangle",
            [joint.name for joint in joints],
            "nothing is left open; motion of another kind tests the answer",
        )
    return found


def _in_phase(motion: Motion, joints: Sequence[Joint]) -> list[str]:
    """Joints whose accelerations go together."""
    movers = np.flatnonzero(motion.moves)
    if len(movers) < 2:
        return []
    together = np.abs(np.corrcoef(motion.a[:, movers].T)) - np.eye(len(movers))
    return [joints[int(movers[place])].name for place in np.flatnonzero(np.max(together, axis=1) > _IN_PHASE)]


def _shape(kind: str, room: _Room, place: int, count: int) -> Array:
    """Displacement of a joint in a part, rad; zero at both ends."""
    time = STEP_S * np.arange(round(_SECONDS / STEP_S))
    if kind == "poses":
        return _poses(time, room)
    if kind == "chirp":
        return _chirp(time, room)
    if kind == "out_of_phase":
        rate = (0.25 + 0.5 * place / max(count, 1)) * min(1.0, room.speed / (2.0 * np.pi * max(room.reach, 1e-3)))
        return _faded(time, room.reach * np.sin(2.0 * np.pi * rate * time))
    reach = room.reach if kind == "triangle" else min(0.15, room.reach)
    slow = 3.0 * THRESHOLDS.sticking_rad_s
    fast = min(room.speed, 6.0 * slow)
    half = len(time) // 2
    way = np.concatenate([slow * time[:half], slow * time[half - 1] + fast * (time[half:] - time[half - 1])])
    # A joint that is far from its ends turns round after the way that time allows.
    reach = min(reach, 0.25 * float(way[half - 1]))
    turned = reach * (2.0 / np.pi) * np.arcsin(np.sin(0.5 * np.pi * way / max(reach, 1e-9)))
    return _faded(time, smoothed(turned, window_of(STEP_S)))


def _poses(time: Array, room: _Room) -> Array:
    """Five poses in turn, each held; smooth between."""
    levels = room.reach * np.array([0.0, -1.0, -0.5, 0.5, 1.0, 0.0])
    each = time[-1] / (len(levels) - 1)
    place = np.minimum((time / each).astype(int), len(levels) - 2)
    share = np.clip(2.0 * (time / each - place), 0.0, 1.0)
    smooth = share * share * (3.0 - 2.0 * share)
    return np.asarray(levels[place] + (levels[place + 1] - levels[place]) * smooth)


def _chirp(time: Array, room: _Room) -> Array:
    """From 0.5 Hz up to where 20 mrad take the acceleration of the log; then the same half as wide."""
    half = len(time) // 2
    highest = float(np.clip(np.sqrt(room.acceleration / 0.02) / (2.0 * np.pi), 1.0, 0.2 / STEP_S))
    rate = np.linspace(0.5, highest, half)
    phase = 2.0 * np.pi * np.cumsum(rate) * STEP_S
    turning = 2.0 * np.pi * rate
    wide = np.minimum(room.reach, np.minimum(room.speed / turning, room.acceleration / turning**2))
    once = _faded(time[:half], wide * np.sin(phase))
    return np.concatenate([once, 0.5 * once, np.zeros(len(time) - 2 * half)])


def _faded(time: Array, values: Array) -> Array:
    """Values that begin and end at zero."""
    edge = np.clip(np.minimum(time - time[0], time[-1] - time) / 0.5, 0.0, 1.0)
    return np.asarray(values * edge * edge * (3.0 - 2.0 * edge))


def _gain(motion: Motion, joint: int, position: Array) -> float:
    """How much smaller the ± of Coulomb and viscous friction are than by the log, by their columns alone."""
    rows = motion.moving[:, joint]
    if not np.any(rows):
        return float("nan")
    v = np.gradient(position, STEP_S)
    before = _scatter(motion.v[rows, joint], motion.a[rows, joint])
    fast = np.abs(v) > THRESHOLDS.sticking_rad_s
    after = _scatter(v[fast], np.gradient(v, STEP_S)[fast])
    return float(np.min(before / after))


def _scatter(v: Array, a: Array) -> Array:
    """Standard uncertainties of Coulomb and viscous friction from one row of unit noise."""
    matrix = np.column_stack([np.sign(v), v, a, np.ones_like(v)])
    return np.asarray(np.sqrt(np.diag(np.linalg.pinv(matrix.T @ matrix / len(v)))[:2]))
