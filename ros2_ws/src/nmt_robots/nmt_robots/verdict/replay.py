"""How far the simulated robot is from the measured one in motion: open-loop windows from measured states.

Each window starts from the measured motion and runs on by itself. Where the law of the drives makes the torque, the
log's command goes through it; where the torque was measured and is not such a law, it acts as it is. All windows lie in
the last part of the log, with values of the rows before it, through the model as given and as it was changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nmt_robots.log.joint_log import Array, JointLog
from nmt_robots.log_faults.finding import Finding
from nmt_robots.mechanics.columns import JointEffect, State
from nmt_robots.mechanics.ladder import first_of_last_part
from nmt_robots.mechanics.motion import Motion, built_up
from nmt_robots.mechanics.readings import DriveTorque, Reading
from nmt_robots.mechanics.transmission import Transmission
from nmt_robots.model.robot_model import Joint, RobotModel
from nmt_robots.model.robot_simulation import RobotSimulation
from nmt_robots.thresholds import THRESHOLDS
from nmt_robots.verdict.joint_verdict import OF_ALL_JOINTS, JointVerdict

HORIZONS_S = (0.2, 0.5, 1.0)
"""Lengths of windows after which the distance is stated."""
_WINDOWS = 16
"""At most, spread evenly over the last part."""
_CURVE_S = 0.05
"""Between points of the error over the horizon in files."""
_STEP_S = 5e-4
_ROOM = 0.3
"""By which a joint may leave its range in the log before its window ends, rad or m; at least that range once more."""
_DRY = frozenset({"coulomb", "stribeck", "root_friction", "load_friction"})
"""Effects that can hold a joint still."""


@dataclass(frozen=True, eq=False)
class PredictedMotion:
    """Windows through one model.

    Attributes:
        position: windows × rows × J, rad (m of a slide); the last one once a joint has left its range.
        missed: the same, less the measured position.
        tool: windows × rows × ends, m: distance of each end of the robot from where it was.
        lasted: windows; rows until a joint left its range.
    """

    position: Array
    missed: Array
    tool: Array
    lasted: Array

    def joints(self) -> Array:
        """Rows × J: rms over the windows."""
        return np.asarray(np.sqrt(np.mean(self.missed**2, axis=0)))

    def ends(self) -> Array:
        """Rows: rms over windows and ends, m."""
        return np.asarray(np.sqrt(np.mean(self.tool**2, axis=(0, 2))))

    def ended(self, row: int = -1) -> int:
        """Windows that ended before a row, as a joint left its range."""
        rows = self.missed.shape[1]
        return int(np.count_nonzero(self.lasted <= row % rows)) if rows else 0


@dataclass(frozen=True, eq=False)
class Replay:
    """Windows of the last part of a log through the model as given and as changed.

    Attributes:
        how: what drives them and where they lie; why there are none of a length.
        joints: names of the columns.
        turns: of each of them, whether it turns.
        tool: name of the body, or number of limbs, whose ends are compared.
        step_s: between rows.
        starts: first rows of the windows.
        measured: windows × rows × J.
        by_model, by_changed: what the simulations make of them.
        changed: words of the changes, by joint.
    """

    how: str
    joints: tuple[str, ...]
    turns: tuple[bool, ...]
    tool: str
    step_s: float
    starts: Array
    measured: Array
    by_model: PredictedMotion
    by_changed: PredictedMotion
    changed: dict[str, str]

    @property
    def time(self) -> Array:
        """Since the start of a window, s."""
        return self.step_s * np.arange(self.measured.shape[1])

    @property
    def horizons_s(self) -> tuple[float, ...]:
        """Lengths that the last part has room for."""
        return tuple(span for span in HORIZONS_S if round(span / self.step_s) < self.measured.shape[1])

    def after(self, predicted: PredictedMotion, span_s: float) -> tuple[Array, float]:
        """Rms distance of each joint (rad, m) and of the tool (m) after a time."""
        row = round(span_s / self.step_s)
        return predicted.joints()[row], float(predicted.ends()[row])

    def is_beyond(self, predicted: PredictedMotion, span_s: float) -> bool:
        """Whether windows ended before that time, so that the distance is at least so large."""
        return predicted.ended(round(span_s / self.step_s)) > 0

    @property
    def models(self) -> list[tuple[str, PredictedMotion]]:
        """Words for each simulation, that of the changed model only where something was changed."""
        return [
            ("as given", self.by_model),
            *([("as changed", self.by_changed)] if self.by_changed is not self.by_model else []),
        ]

    @property
    def sentence(self) -> str:
        """For people: how far tool and joints are off after each time."""
        if not self.horizons_s:
            return self.how
        span, whose = self.horizons_s[-1], [(self.tool, "mm", np.zeros(0, dtype=bool))]
        for name, unit, kind in (("revolute joints", "mrad", True), ("sliding joints", "mm", False)):
            chosen = np.array(self.turns) == kind
            if np.any(chosen):
                whose.append((name, unit, chosen))
        parts = []
        for name, unit, chosen in whose:
            sizes = []
            for words, predicted in self.models:
                joints, tool = self.after(predicted, span)
                size = float(np.sqrt(np.mean(joints[chosen] ** 2))) if chosen.size else tool
                sizes.append(f"{missed_text(size, self.is_beyond(predicted, span))} {unit} {words}")
            parts.append(f"{name} {' and '.join(sizes)}")
        return f"Simulated for {span:g} s from measured states, off by (rms): {'; '.join(parts)}. {self.how}"

    def to_mapping(self) -> dict[str, Any]:
        """As ``diagnosis.json`` has it."""
        every = max(1, round(_CURVE_S / self.step_s))
        rows = range(0, self.measured.shape[1] if self.horizons_s else 0, every)
        return {
            "how": self.how, "sentence": self.sentence, "windows": len(self.starts), "tool": self.tool,
            "horizons_s": list(self.horizons_s), "time_s": [float(self.time[row]) for row in rows],
            "tool_rms_m": {
                words.replace(" ", "_"): [float(predicted.ends()[row]) for row in rows]
                for words, predicted in self.models
            },
            "joints": [
                {"joint": name, "changed": self.changed.get(name, ""), "unit": "rad" if turns else "m",
                 **{f"rms_{words.replace(' ', '_')}": [float(predicted.joints()[row, number]) for row in rows]
                    for words, predicted in self.models}}
                for number, (name, turns) in enumerate(zip(self.joints, self.turns, strict=True))
            ],
        }  # fmt: skip


def _enumerated(words: Sequence[str]) -> str:
    return f"{', '.join(words[:-1])} and {words[-1]}" if len(words) > 1 else words[0]


def missed_text(value: float, beyond: bool) -> str:
    """A distance in mrad or mm, or that it is more than so much."""
    size = f"{1e3 * value:.0f}" if value >= 0.1 else f"{1e3 * value:.3g}"
    return f"> {size}" if beyond else size


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
    further: tuple[tuple[JointEffect, Array], ...] = ()
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
) -> Replay:  # fmt: skip
    """Windows of the last part of a log through the model as given and as changed.

    Args:
        original: robot and log as they are.
        found: the same with bodies and constants of drives that were found before the last part.
        motion: of the diagnosis.
        readings: of the log that fit as well.
        verdicts: of the joints.
        faults: findings on the log.
    """
    robot, log = original
    first, step = first_of_last_part(motion), motion.step_s
    rows = min(round(HORIZONS_S[-1] / step) + 1, len(motion.q) - first)
    starts = np.unique(np.linspace(first, len(motion.q) - rows, _WINDOWS).astype(int))
    unchanged = [ChangedJoint.of(verdict.joint) for verdict in verdicts]
    changed = [changed_joint(verdict, faults) for verdict in verdicts]
    # Readings that the torque hardly tells apart may have a command early, which no drive has.
    reading = min(readings, key=lambda item: abs(item.command_lag_s) + abs(item.torque_lag_s))
    driven = driven_by(log, reading)
    too_short = [f"{span:g}" for span in HORIZONS_S if round(span / step) >= rows]
    if len(too_short) == len(HORIZONS_S):
        starts = starts[:0]
    ends = robot.ends(log.joints)
    measured = np.stack([log.position[row : row + rows] for row in starts]) if len(starts) else np.empty((0, rows, 1))

    simulated: list[Simulated] = []

    def predicted(robot_of: RobotModel, log_of: JointLog, joints: list[ChangedJoint]) -> PredictedMotion:
        simulated.append(Simulated(robot_of, log_of, motion, driven_by(log_of, reading), joints))
        position = np.array([simulated[-1].window(row, rows) for row in starts]).reshape(measured.shape)
        lasted = np.count_nonzero(np.isfinite(position[..., 0]), axis=1)
        for window, row in zip(position, lasted, strict=True):
            window[row:] = window[row - 1]
        # Both through the kinematics of the file: a part that is not mounted stays a point.
        flat = [values.reshape(-1, values.shape[-1]) for values in (position, measured)]
        reached, was = (robot.places(ends, log.joints, values) for values in flat)
        apart = np.linalg.norm(reached - was, axis=2)
        return PredictedMotion(position, position - measured, apart.reshape(*measured.shape[:2], len(ends)), lasted)

    by_model = predicted(robot, log, unchanged)
    by_changed = by_model
    words = {name: item.words for name, item in zip(log.joints, changed, strict=True) if item.words}
    if found[0] is not robot or found[1] is not log or words:
        by_changed = predicted(*found, changed)
    span = f"the last {(len(motion.q) - first) * step:.3g} s; the changes are fitted to earlier rows"
    read = reading.text() if reading == readings[0] else f"{reading.text()}, which fits as well"
    what = f"the recorded command through the drives' control law ({read})" if driven.is_law else "the measured torque"
    how = f"{len(starts)} windows within {span}. The simulation is driven by {what}"
    how += "; the base stands still." if robot.floating else "."
    models = {"as given": by_model} | ({"as changed": by_changed} if by_changed is not by_model else {})
    left = [f"{item.ended()} of the model {words}" for words, item in models.items() if item.ended()]
    if left:
        how += f" {_enumerated(left)} end early, where a joint leaves its range in the log by that range (>)."
    if left and not driven.is_law:
        how += f" {simulated[-1].drift(int(starts[0]), verdicts)}"
    if too_short:
        how = "" if not len(starts) else how + " "
        how += f"The last part of the log, {(len(motion.q) - first) * step:.2g} s, is too short for windows of " + (
            f"{_enumerated(too_short)} s."
        )
    tool = f"tool point ({ends[0].name})" if len(ends) == 1 else f"ends of {len(ends)} limbs"
    turns = tuple(verdict.joint.turns for verdict in verdicts)
    return Replay(how, log.joints, turns, tool, step, starts, measured, by_model, by_changed, words)


@dataclass(frozen=True, eq=False)
class ReplayDrive:
    """What drives a replay, N × J: command (rad), its speed (rad/s), torque on top of the law or measured (N·m).

    ``is_law``: whether the law makes the torque.
    ``delay_s``: of the law's torque.
    """

    command: Array
    speed: Array
    torque: Array
    gains: tuple[Array, Array]
    is_law: bool
    delay_s: float


def driven_by(log: JointLog, reading: Reading) -> ReplayDrive:
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
        return ReplayDrive(
            drive.command(reading), speed, torque, (log.position_gain, damped), True, max(reading.torque_lag_s, 0.0)
        )
    nothing = np.zeros(len(log.joints))
    torque = DriveTorque(log).torque(reading)
    return ReplayDrive(still, still, torque, (nothing, nothing), False, 0.0)


def _alike(law: Array, measured: Array | None) -> bool:
    """Whether the law explains a measured torque in every joint."""
    assert measured is not None
    left = np.std(law - measured, axis=0)
    return bool(np.all(left < THRESHOLDS.unexplained * np.maximum(np.std(measured, axis=0), 1e-300)))


def _between(values: Array, places: Array) -> Array:
    """Rows of values at places between them, on the line that joins two."""
    last = len(values) - 1
    lower = np.clip(np.floor(places).astype(int), 0, last)
    share = np.clip(places - lower, 0.0, 1.0)[:, None]
    return np.asarray((1.0 - share) * values[lower] + share * values[np.minimum(lower + 1, last)])


class Simulated:
    """A log in simulation.

    Args:
        robot, log, motion: of the diagnosis.
        driven: what drives it.
        joints: of the columns, as they are simulated.
    """

    def __init__(
        self, robot: RobotModel, log: JointLog, motion: Motion, driven: ReplayDrive, joints: Sequence[ChangedJoint]
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
        # An offset is the same in every state; all else follows the motion.
        further = [[item for item in joint.further if item[0].key != "offset"] for joint in joints]
        self._further = [sorted(items, key=lambda item: not item[0].made_of_torque) for items in further]
        self._constant = np.array(
            [sum(float(values[0]) for item, values in joint.further if item.key == "offset") for joint in joints]
        )
        self._plain = not np.any(loose) and not any(further)
        self._of_bodies = any(joint.has("gravity_scale", "inertia_scale") for joint in joints)
        self._angle, self._speed = np.zeros(len(joints)), np.zeros(len(joints))
        self._reach = np.array([max((effect.reach for effect, _ in joint.further), default=0.0) for joint in joints])
        self._built = np.zeros_like(motion.position)
        for number in np.flatnonzero(self._reach):
            self._built[:, [number]] = built_up(motion.position[:, [number]], self._reach[number])
        self._held, self._before = np.zeros(len(joints)), np.zeros(len(joints))
        low, high = np.min(log.position, axis=0), np.max(log.position, axis=0)
        self._middle, self._room = 0.5 * (low + high), 0.5 * (high - low) + np.maximum(high - low, _ROOM)

    def window(self, first: int, rows: int) -> Array:
        """Angles of the encoders from the measured state of a row on, rows × J, rad; NaN once out of range."""
        driven = self._driven
        found = np.full((rows, self._log.position.shape[1]), np.nan)
        places = first + np.arange((rows - 1) * self._parts) / self._parts
        command, speed, torque = (_between(values, places) for values in (driven.command, driven.speed, driven.torque))
        delay = round(driven.delay_s / self._step)
        late = list(self._by_log(first + np.arange(-delay, 0) / self._parts)) if delay else []
        self._reset(first)
        q, v = self._encoders()
        for row in range(rows):
            if not np.all(np.abs(q - self._middle) < self._room):
                break
            found[row] = q
            for part in range(row * self._parts, min(row + 1, rows - 1) * self._parts):
                error, speed_error = command[part] - q, speed[part] - v
                acting = torque[part]
                if driven.is_law:
                    late.append(driven.gains[0] * error + driven.gains[1] * speed_error + acting)
                    acting = late.pop(0)
                self._advance(q, v, acting, error, speed_error)
                q, v = self._encoders()
        return found

    def drift(self, row: int, verdicts: Sequence[JointVerdict]) -> str:
        """How far the torque left at a joint takes it in the longest window, where no law leads it back."""
        self._reset(row)
        inertia = self._simulation.free_inertia()
        left = np.array([item.left if item.mechanics is not None else 0.0 for item in verdicts])
        span = HORIZONS_S[-1]
        joint = int(np.argmax(left / inertia))
        item, by = verdicts[joint].joint, 0.5 * left[joint] / inertia[joint] * span**2
        return item.units(
            f"A measured torque leads no joint back to its motion: the {left[joint]:.2g} N·m left at {item.name} move "
            f"its {inertia[joint]:.2g} kg·m² by up to {by:.2g} rad in {span:g} s."
        )

    def _by_log(self, places: Array) -> Array:
        """Torque of the drives as the measured motion has it, at rows and between them."""
        driven, motion = self._driven, self._motion
        torque = driven.gains[0] * (driven.command - motion.q) + driven.gains[1] * (driven.speed - motion.v)
        return _between(torque + driven.torque, places)

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
        if self._plain:
            self._simulation.advance(acting - self._constant, self._coulomb)
            return
        torque, dry = acting.copy(), self._coulomb.copy()
        gravity = inertial = np.full(len(q), np.nan)
        if self._of_bodies:
            gravity, inertial = self._simulation.body_torques()
        acceleration = self._simulation.acceleration
        turned = (q - self._before) / np.where(self._reach > 0.0, self._reach, np.inf)
        self._held, self._before = np.clip(self._held + turned, -1.0, 1.0), q.copy()
        for number, further in enumerate(self._further):
            for effect, values in further:
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
        dry, torque = np.maximum(dry, 0.0), torque - self._constant
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
