"""The log once more in simulation: through the model as given, and through the model as it was changed.

Where the law of the drives makes the torque, the log's command goes through it, and the robot moves freely from the
first row on. Where the torque was measured and is not such a law, it acts in short windows that each start from the
measured motion, for without a drive an error of the torque grows without bound. Both go over the last part of the log
with values of the rows before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nmt_robots.log.joint_log import Array, JointLog
from nmt_robots.log_faults.finding import Finding
from nmt_robots.mechanics.columns import Effect, State
from nmt_robots.mechanics.ladder import first_of_last_part
from nmt_robots.mechanics.motion import Motion, built_up
from nmt_robots.mechanics.readings import DriveTorque, Reading
from nmt_robots.mechanics.transmission import Transmission
from nmt_robots.model.robot_model import Joint, RobotModel
from nmt_robots.model.robot_simulation import RobotSimulation
from nmt_robots.thresholds import THRESHOLDS
from nmt_robots.verdict.joint_verdict import OF_ALL_JOINTS, JointVerdict

_STEP_S = 5e-4
_WINDOW_S = 0.25
_FARTHEST = 50.0
"""Angle (rad) or speed over 100 (rad/s) of a simulation that has run away."""
_DRY = frozenset({"coulomb", "stribeck", "root_friction", "load_friction"})
"""Effects that can hold a joint still."""


@dataclass(frozen=True, eq=False)
class JointReplay:
    """Motion of a joint over the last part of the log, rows each, rad (m of a slide).

    Attributes:
        joint: its name.
        measured, by_model, by_changed: positions.
    """

    joint: str
    measured: Array
    by_model: Array
    by_changed: Array

    @property
    def before(self) -> float:
        """Rms residual of the model as given; NaN where its motion runs away."""
        return float(np.sqrt(np.mean((self.by_model - self.measured) ** 2)))

    @property
    def after(self) -> float:
        """The same of the changed model."""
        return float(np.sqrt(np.mean((self.by_changed - self.measured) ** 2)))


@dataclass(frozen=True, eq=False)
class Replay:
    """The log through the model as given and as changed.

    Attributes:
        how: sentence on what drove it, and over which rows.
        time: rows, s.
        joints: of the columns of the log.
        changed: words of the changes, by joint.
    """

    how: str
    time: Array
    joints: tuple[JointReplay, ...]
    changed: dict[str, str]

    def to_mapping(self) -> dict[str, Any]:
        """As ``diagnosis.json`` has it."""
        return {
            "how": self.how,
            "joints": [
                {"joint": item.joint, "changed": self.changed.get(item.joint, ""), "rms_model": item.before,
                 "rms_changed": item.after}
                for item in self.joints
            ],
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class ChangedJoint:
    """A joint as it is simulated.

    Attributes:
        armature, damping, coulomb: kg·m², N·m·s/rad, N·m.
        further: effects that the robot's file has no word for, with their coefficients.
        mass: factor of its link's mass.
        transmission: behind which its link moves by itself.
        words: of the changes; empty = nothing.
    """

    armature: float
    damping: float
    coulomb: float
    further: tuple[tuple[Effect, Array], ...] = ()
    mass: float = 1.0
    transmission: Transmission | None = None
    words: str = ""

    @staticmethod
    def of(joint: Joint) -> ChangedJoint:
        """As the model has it."""
        return ChangedJoint(joint.armature, joint.damping, joint.coulomb)

    def has(self, *keys: str) -> bool:
        """Whether one of these effects is among the further ones."""
        return any(effect.key in keys for effect, _ in self.further)


def changed_joint(verdict: JointVerdict, faults: Sequence[Finding]) -> ChangedJoint:
    """The joint with all that differs from its model, by values of the rows before the last part of the log.

    Args:
        verdict: of the joint.
        faults: findings on the log, of which gains and limits of its drive are taken.
    """
    joint = ChangedJoint.of(verdict.joint)
    if verdict.mechanics is None:
        return joint
    claimed = {term.key for term in verdict.terms if term.differs}
    claimed |= {item.key for item in faults if item.fault and verdict.joint.name in item.joints}
    further, place = [], 0
    words = [term.words for term in verdict.terms if term.differs and term.key in OF_ALL_JOINTS]
    for share in verdict.mechanics.shares:
        effect = share.effect
        values = verdict.mechanics.held_out.early[place : place + effect.parameters]
        place += effect.parameters
        # The rest of a spring is in the offset that it brings with it.
        freed = effect.key == "offset" and any(
            item.effect.frees == "offset" and item.effect.key in claimed for item in verdict.mechanics.shares
        )
        if effect.key not in claimed and not freed:
            continue
        words.append(effect.words)
        if effect.key == "coulomb":
            joint = replace(joint, coulomb=float(values[0]))
        elif effect.key == "viscous":
            joint = replace(joint, damping=float(values[0]))
        elif effect.key == "armature":
            joint = replace(joint, armature=float(values[0]))
        elif effect.key == "link_mass":
            joint = replace(joint, mass=1.0 + float(values[0]))
        elif effect.law is not None:
            further.append((effect, values))
    moved = verdict.transmission if claimed & {"elastic", "backlash"} else None
    if moved is not None:
        words.append("backlash" if moved.gap else "elastic transmission")
    return replace(joint, further=tuple(further), transmission=moved, words=", ".join(words))


def replayed(
    original: tuple[RobotModel, JointLog], found: tuple[RobotModel, JointLog], motion: Motion,
    readings: Sequence[Reading], verdicts: Sequence[JointVerdict], faults: Sequence[Finding],
) -> Replay | None:  # fmt: skip
    """The last part of a log through the model as given and as changed; None where it has too few rows.

    Args:
        original: robot and log as they are.
        found: the same with bodies and constants of drives that were found.
        motion: of the diagnosis.
        readings: of the log that fit as well.
        verdicts: of the joints.
        faults: findings on the log.
    """
    first = first_of_last_part(motion)
    if len(motion.q) - first < 50:
        return None
    unchanged = [ChangedJoint.of(verdict.joint) for verdict in verdicts]
    changed = [changed_joint(verdict, faults) for verdict in verdicts]
    # Readings that the torque hardly tells apart may have a command early, which no drive has.
    reading = min(readings, key=lambda item: abs(item.command_lag_s) + abs(item.torque_lag_s))
    robot, log = original
    driven = driven_by(log, reading)
    by_model = Simulated(robot, log, motion, driven, unchanged).positions(first)
    by_changed = by_model
    if found != original or any(item.words for item in changed):
        by_changed = Simulated(*found, motion, driven_by(found[1], reading), changed).positions(first)
    rows = slice(first, None)
    joints = tuple(
        JointReplay(name, log.position[rows, number], by_model[:, number], by_changed[:, number])
        for number, name in enumerate(log.joints)
    )
    span = f"over the last {(len(motion.q) - first) * motion.step_s:.3g} s, with values of the rows before"
    base = "; the base stands still" if robot.floating else ""
    how = (
        f"The command of the log through the drives' law ({reading.text()}), free from the first row on, {span}{base}."
        if driven.window is None
        else f"The measured torque in windows of {driven.window * motion.step_s:.2g} s, each from the measured motion, "
        f"{span}{base}."
    )
    words = {name: item.words for name, item in zip(log.joints, changed, strict=True) if item.words}
    return Replay(how, np.arange(len(by_model)) * motion.step_s, joints, words)


@dataclass(frozen=True, eq=False)
class Driven:
    """What drives a replay, N × J: command (rad), its speed (rad/s), torque on top of the law or measured (N·m).

    ``window``: rows after which it starts anew from the measured motion; None = never.
    ``delay_s``: of the law's torque.
    """

    command: Array
    speed: Array
    torque: Array
    gains: tuple[Array, Array]
    window: int | None
    delay_s: float


def driven_by(log: JointLog, reading: Reading) -> Driven:
    """What drives a log: the law where it makes the torque, else the measured torque."""
    still = np.zeros_like(log.position)
    lawful = log if log.is_arithmetic else replace(log, torque=None)
    known = log.position_gain is not None and log.position_command is not None
    if known and (log.is_arithmetic or _alike(DriveTorque(lawful).torque(Reading()), log.torque)):
        assert log.position_gain is not None
        drive = DriveTorque(lawful)
        damped = np.zeros(len(log.joints)) if log.velocity_gain is None else log.velocity_gain
        speed = still if log.velocity_command is None else log.velocity_command
        torque = still if log.torque_command is None else log.torque_command
        return Driven(
            drive.command(reading), speed, torque, (log.position_gain, damped), None, max(reading.torque_lag_s, 0.0)
        )
    nothing = np.zeros(len(log.joints))
    torque = DriveTorque(log).torque(reading)
    return Driven(still, still, torque, (nothing, nothing), max(2, round(_WINDOW_S / log.step_s)), 0.0)


def _alike(law: Array, measured: Array | None) -> bool:
    """Whether the law explains a measured torque in every joint."""
    assert measured is not None
    left = np.std(law - measured, axis=0)
    return bool(np.all(left < THRESHOLDS.unexplained * np.maximum(np.std(measured, axis=0), 1e-300)))


class Simulated:
    """A log in simulation.

    Args:
        robot, log, motion: of the diagnosis.
        driven: what drives it.
        joints: of the columns, as they are simulated.
    """

    def __init__(
        self, robot: RobotModel, log: JointLog, motion: Motion, driven: Driven, joints: Sequence[ChangedJoint]
    ) -> None:
        self._log, self._motion, self._driven, self._joints = log, motion, driven, joints
        self._parts = max(1, int(np.ceil(motion.step_s / _STEP_S - 1e-9)))
        self._step = motion.step_s / self._parts
        heavier = {name: joint.mass for name, joint in zip(log.joints, joints, strict=True) if joint.mass != 1.0}
        self._simulation = RobotSimulation(robot, log.joints, self._step, heavier)
        loose = np.array([joint.transmission is not None for joint in joints])
        armature, damping, coulomb = (
            np.array([getattr(joint, name) for joint in joints]) for name in ("armature", "damping", "coulomb")
        )
        self._simulation.set_joints(np.where(loose, 0.0, armature), np.where(loose, 0.0, damping))
        self._coulomb, self._loose = coulomb, [int(number) for number in np.flatnonzero(loose)]
        self._of_bodies = any(joint.has("gravity_scale", "inertia_scale") for joint in joints)
        self._angle, self._speed = np.zeros(len(joints)), np.zeros(len(joints))
        self._reach = np.array([max((effect.reach for effect, _ in joint.further), default=0.0) for joint in joints])
        self._built = np.zeros_like(motion.position)
        for number in np.flatnonzero(self._reach):
            self._built[:, [number]] = built_up(motion.position[:, [number]], self._reach[number])
        self._held, self._before = np.zeros(len(joints)), np.zeros(len(joints))

    def positions(self, first: int) -> Array:
        """Angles of the encoders from a row on, rows × J, rad; NaN once the motion has run away."""
        log, driven = self._log, self._driven
        rows = len(log.position)
        found = np.full((rows - first, log.position.shape[1]), np.nan)
        delay = round(driven.delay_s / self._step)
        late: list[Array] = []
        for row in range(first, rows):
            if row == first or (driven.window is not None and (row - first) % driven.window == 0):
                self._reset(row)
            q, v = self._encoders()
            if not np.all(np.abs(q) + np.abs(v) / 100.0 < _FARTHEST):
                break
            found[row - first] = q
            after = min(row + 1, rows - 1)
            for part in range(self._parts):
                share = part / self._parts
                if part:
                    q, v = self._encoders()
                command, speed, torque = (
                    (1.0 - share) * values[row] + share * values[after]
                    for values in (driven.command, driven.speed, driven.torque)
                )
                error, speed_error = command - q, speed - v
                late.append(driven.gains[0] * error + driven.gains[1] * speed_error + torque)
                acting = late.pop(0) if len(late) > delay else late[0]
                self._advance(q, v, acting, error, speed_error)
        return found

    def _reset(self, row: int) -> None:
        """Start from the measured motion; a link behind its transmission lies where it carries the bodies."""
        q, v = self._motion.q[row].copy(), self._motion.v[row].copy()
        self._angle, self._speed = q.copy(), v.copy()
        self._held, self._before = self._built[row].copy(), q.copy()
        for number in self._loose:
            found = self._joints[number].transmission
            assert found is not None
            needed = float(self._motion.rigid[row, number])
            q[number] -= needed / found.stiffness + 0.5 * np.sign(needed) * found.gap
        self._simulation.reset(q, v)

    def _encoders(self) -> tuple[Array, Array]:
        """Angles and speeds of the joints' motors."""
        q, v = self._simulation.position, self._simulation.speed
        q[self._loose], v[self._loose] = self._angle[self._loose], self._speed[self._loose]
        return q, v

    def _advance(self, q: Array, v: Array, acting: Array, error: Array, speed_error: Array) -> None:
        """One step with all that the joints have next to bodies, armature and damping."""
        torque, dry = acting.copy(), self._coulomb.copy()
        gravity = inertial = np.full(len(q), np.nan)
        if self._of_bodies:
            gravity, inertial = self._simulation.body_torques()
        acceleration = self._simulation.acceleration
        turned = (q - self._before) / np.where(self._reach > 0.0, self._reach, np.inf)
        self._held, self._before = np.clip(self._held + turned, -1.0, 1.0), q.copy()
        for number, joint in enumerate(self._joints):
            for effect, values in sorted(joint.further, key=lambda item: not item[0].made_of_torque):
                assert effect.law is not None
                if effect.reach:
                    dry[number] -= values[0]
                    torque[number] -= values[0] * self._held[number]
                    continue
                # Friction is asked for at its size: its sign is that of the motion which it ends.
                speed = abs(v[number]) + 1e-9 if effect.key in _DRY else v[number]
                state = State(
                    q[number], speed, acceleration[number], gravity[number], inertial[number], torque[number],
                    error[number], speed_error[number],
                )  # fmt: skip
                size = float(np.dot(values, effect.law(state)))
                if effect.key in _DRY:
                    dry[number] += size
                else:
                    torque[number] -= size
        dry = np.maximum(dry, 0.0)
        for number in self._loose:
            torque[number] = self._passed_on(number, torque[number], dry[number])
            dry[number] = 0.0
        self._simulation.advance(torque, dry)

    def _passed_on(self, number: int, torque: float, dry: float) -> float:
        """Torque on the link behind a transmission, N·m, with a step of its motor."""
        joint = self._joints[number]
        found = joint.transmission
        assert found is not None
        twist = self._angle[number] - self._simulation.position[number]
        turning = self._speed[number] - self._simulation.speed[number]
        half = 0.5 * found.gap
        beyond = twist - min(max(twist, -half), half)
        damper = 2.0 * found.ratio * np.sqrt(found.stiffness * found.inertia)
        passed = found.stiffness * beyond + (damper * turning if beyond or not half else 0.0)
        # A motor too light for the step is as heavy as the step can follow.
        rotor = max(joint.armature, 4.0 * found.stiffness * self._step**2, damper * self._step)
        free = self._speed[number] + self._step * (torque - passed - joint.damping * self._speed[number]) / rotor
        self._speed[number] = np.sign(free) * max(abs(free) - self._step * dry / rotor, 0.0)
        self._angle[number] += self._step * self._speed[number]
        return float(passed)
