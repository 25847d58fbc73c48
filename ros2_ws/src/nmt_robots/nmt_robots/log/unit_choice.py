"""Units of positions and speeds: by the heading, by size and range, and by one against the other; else a question."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from nmt_robots.log.joint_log import Array
from nmt_robots.log.robot_sidecar import ANGLES, SPEEDS
from nmt_robots.model.robot_model import Joint

_BY_SLOPE = 0.025
"""Relative distance of a speed over the derivative of a position from a factor of units."""
_ROOM_RAD, _ROOM_DEG, _ROOM_M = 1.0, 0.2, 0.05
"""How far a motion may be beyond a joint's range before its unit is doubted, rad; of degrees, rad; of a slide, m."""
_TWO_TURNS = 4.0 * np.pi
_FULL = 100.5
_TURNING, _SLIDING = ("rad", "deg", "turn"), ("m", "mm", "cm")
_TURNING_SPEED, _SLIDING_SPEED = ("rad/s", "deg/s", "rpm", "turn/s"), ("m/s", "mm/s", "cm/s")


@dataclass(frozen=True, eq=False)
class JointMotion:
    """What is known of the units of one joint.

    Attributes:
        joint: of the model; None where the order of the columns is a question.
        position: N values as logged.
        heading, speed_heading: stated units; empty = none, ``?`` = one of another quantity.
        slope: of the logged speed over the derivative of the logged position; NaN without.
    """

    joint: Joint | None
    position: Array
    heading: str = ""
    speed_heading: str = ""
    slope: float = float("nan")

    @property
    def turns(self) -> bool:
        """Whether it turns; a joint that is not known by what its heading says."""
        return self.joint.turns if self.joint is not None else self.heading not in _SLIDING

    def reach(self, unit: str) -> float:
        """How far the motion is beyond the joint's range in a unit, rad or m; infinite ranges have no end."""
        scaled = np.array([np.nanmin(self.position), np.nanmax(self.position)]) * ANGLES[unit]
        if self.joint is None or not np.isfinite(self.joint.lower + self.joint.upper):
            return 0.0
        return float(max(self.joint.lower - scaled[0], scaled[1] - self.joint.upper))

    @property
    def largest(self) -> float:
        """Of the values as logged."""
        return float(np.nanmax(np.abs(self.position)))

    @property
    def is_limited(self) -> bool:
        """Whether its range is known."""
        return self.joint is not None and bool(np.isfinite(self.joint.lower + self.joint.upper))


@dataclass(eq=False)
class MotionUnits:
    """Units of all joints, ``?`` where one must be asked for, what else the sections need, remarks and questions."""

    position: list[str] = field(default_factory=list)
    velocity: list[str] = field(default_factory=list)
    position_more: dict[str, str] = field(default_factory=dict)
    velocity_more: dict[str, str] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)
    questions: list[str] = field(default_factory=list)


def slope_of(time: Array, position: Array, velocity: Array) -> float:
    """Logged speed over the derivative of the logged position, by the integral of the speed; NaN where it is not one.

    Args:
        time: s, N.
        position, velocity: as logged, N.
    """
    known = np.isfinite(position) & np.isfinite(velocity)
    if np.count_nonzero(known) < 50:
        return float("nan")
    time, position, velocity = time[known], position[known], velocity[known]
    gone = np.r_[0.0, np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(time))]
    drift = np.column_stack([np.ones(len(time)), time])
    first, second = (values - drift @ np.linalg.lstsq(drift, values, rcond=None)[0] for values in (position, gone))
    size = float(np.std(first) * np.std(second))
    if not size > 0.0 or abs(float(np.mean(first * second))) < 0.9 * size:
        return float("nan")
    return float(np.mean(first * second) / np.mean(first**2))


def motion_units(joints: Sequence[JointMotion]) -> MotionUnits:
    """The units of a log's positions and speeds."""
    found = MotionUnits()
    shared = _by_size(joints, found)
    for joint in joints:
        unit, speed = _of_joint(joint, shared)
        found.position.append(unit)
        found.velocity.append(speed)
    _say(joints, found)
    return found


def _by_size(joints: Sequence[JointMotion], found: MotionUnits) -> str:
    """Unit of all joints that turn and whose heading states none, by size and range; ``?`` where that is open."""
    silent = [joint for joint in joints if joint.turns and not joint.heading]
    if not silent:
        return "rad"
    limited = [joint for joint in silent if joint.is_limited]
    largest = max(joint.largest for joint in silent)
    rooms = {"rad": _ROOM_RAD, "deg": _ROOM_DEG}
    in_range = {unit: all(joint.reach(unit) < room for joint in limited) for unit, room in rooms.items()}
    if in_range["rad"] and (limited or largest <= _TWO_TURNS):
        return "rad"
    if in_range["deg"] and _FULL < largest <= 720.0:
        return "deg"
    if not limited:
        return "deg" if _FULL < largest <= 720.0 else "?"
    return "?"


def _of_joint(joint: JointMotion, shared: str) -> tuple[str, str]:
    """Units of position and speed of a joint; ``?`` where one must be asked for."""
    angles = _TURNING if joint.turns else _SLIDING
    speeds = _TURNING_SPEED if joint.turns else _SLIDING_SPEED
    stated = joint.heading if joint.heading != "?" else ""
    if joint.heading in ("?", "counts") or (stated and stated != "percent" and (stated in _SLIDING) == joint.turns):
        return "?", _speed(joint, "?", speeds)
    if stated == "percent":
        return "percent", _speed(joint, "?", speeds)
    pairs = _pairs(joint, [stated] if stated else list(angles), speeds)
    if not stated:
        by_speed = {unit for unit, _ in pairs if not joint.speed_heading.startswith("?")}
        size = shared if joint.turns else _slide_by_size(joint)
        # A speed in another unit tells that of the position; in the same one it tells nothing.
        is_other = joint.speed_heading in speeds or (size in ("rad", "m", "?") and not _same(joint))
        unit = next(iter(by_speed)) if is_other and len(by_speed) == 1 else size
        if unit != "?" and joint.reach(unit) > (_ROOM_RAD if joint.turns else _ROOM_M):
            unit = "?"
        return unit, _speed(joint, unit, speeds)
    speed = _speed(joint, stated, speeds)
    contradicted = joint.speed_heading in speeds and speed == "?"
    beyond = joint.reach(stated) > (_ROOM_RAD if joint.turns else _ROOM_M)
    other = next((unit for unit in angles if unit != stated and joint.reach(unit) < _ROOM_DEG), "")
    if beyond and other and joint.is_limited:
        return "?", speed
    return stated, "?" if contradicted else speed


def _same(joint: JointMotion) -> bool:
    """Whether the speed is the derivative of the position as it is."""
    return not np.isfinite(joint.slope) or abs(abs(joint.slope) - 1.0) < _BY_SLOPE


def _pairs(joint: JointMotion, angles: Sequence[str], speeds: Sequence[str]) -> list[tuple[str, str]]:
    """Units of position and speed whose factor is that of the two columns."""
    if not np.isfinite(joint.slope) or joint.slope == 0.0:
        return []
    allowed = [joint.speed_heading] if joint.speed_heading in speeds else speeds
    return [
        (angle, speed) for angle in angles for speed in allowed
        if abs(abs(joint.slope) * SPEEDS[speed] / ANGLES[angle] - 1.0) < _BY_SLOPE
    ]  # fmt: skip


def _speed(joint: JointMotion, angle: str, speeds: Sequence[str]) -> str:
    """Unit of the speed of a joint whose position has a unit."""
    default = {"rad": "rad/s", "deg": "deg/s", "turn": "turn/s", "m": "m/s", "mm": "mm/s", "cm": "cm/s"}.get(angle, "")
    heading = joint.speed_heading
    if heading and heading not in speeds:
        return "?"
    pairs = _pairs(joint, [angle], speeds) if angle in ANGLES and angle != "percent" else []
    if heading:
        free = JointMotion(joint.joint, joint.position, joint.heading, "", joint.slope)
        others = _pairs(free, [angle], speeds) if angle in ANGLES and angle != "percent" else []
        # Another unit explains the factor exactly: one of the two headings is wrong.
        return "?" if others and not pairs else heading
    if pairs:
        return pairs[0][1]
    return default or "?"


def _slide_by_size(joint: JointMotion) -> str:
    """Unit of a slide without a heading by its range."""
    if not joint.is_limited:
        return "m" if joint.largest < 5.0 else "?"
    if joint.reach("m") < _ROOM_M:
        return "m"
    fitting = [unit for unit in ("mm", "cm") if joint.reach(unit) < 0.1 * _ROOM_M]
    return fitting[0] if len(fitting) == 1 else "?"


def _say(joints: Sequence[JointMotion], found: MotionUnits) -> None:
    """Questions and remarks on the units that were chosen."""
    names = [joint.joint.name if joint.joint is not None else f"column {n + 1}" for n, joint in enumerate(joints)]
    asked = [number for number, unit in enumerate(found.position) if unit == "?"]
    if asked:
        parts = []
        for number in asked[:4]:
            joint = joints[number]
            low, high = float(np.nanmin(joint.position)), float(np.nanmax(joint.position))
            heading = f", heading in {joint.heading}" if joint.heading not in ("", "?") else ""
            span = f", range {joint.joint.lower:.3g} to {joint.joint.upper:.3g} {'rad' if joint.turns else 'm'}" if (
                joint.joint is not None and joint.is_limited) else ""  # fmt: skip
            parts.append(f"{names[number]} goes from {low:.4g} to {high:.4g}{heading}{span}")
        found.questions.append(
            "position.unit (rad, deg, turn, m, mm, or percent with full_scale; gear where the motor's side was "
            f"measured, such as counts per turn; zero where the model's zero is): {'; '.join(parts)}"
        )
        if any(joints[number].heading == "counts" for number in asked):
            found.position_more = {"zero": "?", "gear": "?"}
    if "percent" in found.position:
        found.position_more = {**found.position_more, "full_scale": "?", "zero": "?"}
        found.questions.append(
            "position.full_scale (rad, of a slide m, that 100 % are) and position.zero (percent where the joint of the "
            "model is at zero)"
        )
    pairs = zip(found.position, found.velocity, strict=True)
    open_speeds = [number for number, (unit, speed) in enumerate(pairs) if speed == "?" and unit != "?"]
    if any(np.isfinite(joint.slope) or joint.speed_heading for joint in joints):
        parts = []
        for number in open_speeds[:4]:
            stated = joints[number].speed_heading
            heading = f"heading in {stated}, " if stated not in ("", "?") else ""
            slope = joints[number].slope
            factor = f"{slope:.4g} of the derivative of the position" if np.isfinite(slope) else "no factor is known"
            parts.append(f"{names[number]}: {heading}{factor}")
        if parts:
            found.questions.append(f"velocity.unit (or position.unit): {'; '.join(parts)}")
    by_size = [
        (name, unit) for name, unit, joint in zip(names, found.position, joints, strict=True)
        if not joint.heading and unit not in ("?", "rad", "m")
    ]  # fmt: skip
    if by_size:
        units = sorted({unit for _, unit in by_size})
        found.remarks.append(f"No heading states the unit: {', '.join(units)} by size and range.")
