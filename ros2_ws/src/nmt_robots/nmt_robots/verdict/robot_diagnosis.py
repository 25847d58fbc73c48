"""Diagnosis of a robot: the log first, then each joint."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_diagnose.units.unit_group import UnitGroup
from nmt_robots.bodies.body_finding import BodyFinding, body_finding, without_factor
from nmt_robots.log.joint_log import Array, JointLog
from nmt_robots.log.proposal import propose_sidecar
from nmt_robots.log.robot_sidecar import read_robot_sidecar, sidecar_of_text
from nmt_robots.log_faults.assignment import assignment_findings
from nmt_robots.log_faults.drive import (
    computed_by_law,
    order_findings,
    reading_findings,
    torque_findings,
    with_command_speed,
)
from nmt_robots.log_faults.finding import Finding
from nmt_robots.log_faults.repair import (
    alternation,
    in_radians,
    on_even_clock,
    stale_rows,
    stamps_agree,
    time_by_motion,
    time_with_missing_rows,
    unwrapped,
    with_fresh_rows,
)
from nmt_robots.log_faults.rows import row_findings
from nmt_robots.log_faults.velocity import velocity_findings, with_right_speeds
from nmt_robots.mechanics.ladder import JointMechanics, JointProblem, explain
from nmt_robots.mechanics.motion import Motion, motion_of, with_bodies, with_link_masses, with_yielding_base
from nmt_robots.mechanics.readings import DriveSignals, DriveTorque, Reading, held_time
from nmt_robots.mechanics.shared_reading import ReadingScores, compare_readings
from nmt_robots.model.robot_model import Joint, RobotModel, rms_by_unit, rms_text
from nmt_robots.thresholds import THRESHOLDS
from nmt_robots.verdict.file_findings import file_findings
from nmt_robots.verdict.joint_verdict import (
    OF_BODIES,
    JointVerdict,
    by_lag_of_torque,
    by_shared_delay,
    joint_verdict,
    scale_findings,
    uncertain_causes,
    undisturbed,
    unjudged,
    values_in_model,
    with_body_terms,
    without_claims,
)
from nmt_robots.verdict.next_motion import NextMotion, next_motion
from nmt_robots.verdict.replay import Replay
from nmt_robots.verdict.transmission_verdict import joint_with_transmission, verdict_with_transmission

Progress = Callable[[str], None]
_NO_FAULT = "No fault was found in the log."
_CLEARLY_WORSE = 4.0
"""Squares that a reading leaves with the causes, against those of the best one, from which it does not fit as well."""
_POSES = 200
"""Of a log, in which contacts are searched for, and links push each other."""

_WITHIN = 2.0
"""Combined standard uncertainties within which two logs say the same."""


@dataclass(frozen=True)
class ComparedTerm:
    """A term of a joint by two logs, each with its standard uncertainty.

    Attributes:
        joint, words, unit: of the term.
        first: by the first log; value and ±.
        other: by the other one; both NaN where that has no such term.
    """

    joint: str
    words: str
    unit: str
    first: tuple[float, float]
    other: tuple[float, float]

    @property
    def agrees(self) -> bool:
        """Whether both say the same within two combined ±."""
        apart = abs(self.first[0] - self.other[0])
        return bool(apart <= _WITHIN * float(np.hypot(self.first[1], self.other[1])))


@dataclass(frozen=True)
class OtherLog:
    """A further log, which nothing of the first answer was fitted to.

    Attributes:
        source: file.
        terms: that differ from the model by one of the logs.
        left: by joint: rms of the torque, the residual of the model as it is, and of the first log's terms,
            each about its mean, N·m.
        joints: the answer by this log alone.
        model: file of a model of its own; empty = that of the first log.
    """

    source: str
    terms: tuple[ComparedTerm, ...]
    left: dict[str, tuple[float, float, float]]
    joints: tuple[JointVerdict, ...] = ()
    model: str = ""

    @property
    def sentence(self) -> str:
        """For people."""
        agreeing = sum(term.agrees for term in self.terms)
        words = f"{agreeing} of {len(self.terms)} differing values agree within 2 ±" if self.terms else (
            "no log finds a value that differs"
        )  # fmt: skip
        source = f"{self.source} with its own model {self.model}" if self.model else self.source
        if not self.left:
            return f"{source}: {words}; no joint moves in both."
        moved = [item.joint for item in self.joints if item.joint.name in self.left]
        model, terms = (
            rms_text(rms_by_unit(moved, [self.left[joint.name][place] for joint in moved])) for place in (1, 2)
        )
        return (
            f"{source}: {words}; of its torque the model leaves {model}, with the first log's values {terms} (rms over "
            "the joints)."
        )

    def to_mapping(self) -> dict[str, Any]:
        """As ``diagnosis.json`` has it."""
        return {
            "log": self.source,
            "model": self.model,
            "terms": [
                {"joint": term.joint, "words": term.words, "unit": term.unit, "first": list(term.first),
                 "other": list(term.other), "agrees": term.agrees}
                for term in self.terms
            ],
            "left": {joint: list(values) for joint, values in self.left.items()},
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class RobotDiagnosis:
    """What a log says of a robot's model.

    Attributes:
        model: the robot.
        log: as it was read.
        motion: of the log.
        findings: on the log, faults first.
        reading: how the log is read in all that follows.
        as_well: readings that fit as well, the chosen one included.
        joints: a verdict for each column of the log.
        next: what to move next.
        others: further logs that test the answer.
        replay: the log through the model as given and as changed; None where it was not asked for.
        group: joints that are meant to be alike; None = not stated.
        of_file: facts of the model's file, known before the fit.
        bodies: what all joints together say of the bodies; None where that was not asked.
        as_given: log and motion before what differs of the bodies was put in.
    """

    model: RobotModel
    log: JointLog
    motion: Motion
    findings: tuple[Finding, ...]
    reading: Reading
    as_well: tuple[Reading, ...]
    joints: tuple[JointVerdict, ...]
    next: NextMotion
    others: tuple[OtherLog, ...] = ()
    replay: Replay | None = None
    group: UnitGroup | None = None
    of_file: tuple[Finding, ...] = ()
    bodies: BodyFinding | None = None
    as_given: tuple[JointLog, Motion] | None = None

    def left_over(self, which: str) -> dict[str, float]:
        """Torque left on held-out seconds, rms over the joints that were judged, by its unit.

        Args:
            which: ``torque``, ``unchanged`` (model as given), ``as_logged`` (plain fit of the log as it is), ``plain``
                or ``left``.
        """
        judged = [joint for joint in self.joints if joint.mechanics is not None]
        return rms_by_unit([joint.joint for joint in judged], [getattr(joint, which) for joint in judged])

    @property
    def changed(self) -> RobotModel:
        """The robot with the bodies that were found."""
        return self.model if self.bodies is None else self.bodies.robot

    @property
    def verdict(self) -> str:
        """One sentence, or two where the bodies differ."""
        judged = [joint for joint in self.joints if joint.mechanics is not None]
        if not judged:
            return "No joint moves enough to be judged."
        faults = sum(finding.fault for finding in self.findings)
        log = f"The log has {faults} faults." if faults > 1 else "The log has one fault." if faults else _NO_FAULT
        differing = sum(joint.differs for joint in judged)
        open_joints = sum(not joint.differs and not joint.is_as_in_the_model for joint in judged)
        unknown = f"; {open_joints} more, cause open" if open_joints else ""
        bodies = self.bodies.words if self.bodies is not None else ""
        bodies = f"{bodies[:1].upper()}{bodies[1:]}. " if bodies else ""
        as_given, named = (rms_text(self.left_over(which)) for which in ("unchanged", "left"))
        efforts = "force" if all(not joint.joint.turns for joint in judged) else "torque"
        efforts = f"computed {efforts}" if self.log.is_arithmetic else efforts
        return (
            f"{bodies}{differing} of {len(judged)} joints {'differs' if differing == 1 else 'differ'} from the model, "
            f"cause named{unknown}. "
            f"On held-out motion the model misses the {efforts} by {as_given} (rms over the joints) as given, by "
            f"{named} with the changes. {log}"
        )

    def to_mapping(self) -> dict[str, Any]:
        """As ``diagnosis.json`` has it."""
        return {
            "kind": "robot",
            "robot": str(self.model.path),
            "log": self.log.source,
            "verdict": self.verdict,
            "rows": self.log.rows,
            "step_s": self.log.step_s,
            "file_findings": [finding.to_mapping() for finding in self.of_file],
            "log_findings": [finding.to_mapping() for finding in self.findings],
            "bodies": None if self.bodies is None else self.bodies.to_mapping(),
            "reading": self.reading.text(),
            "readings_that_fit_as_well": [reading.text() for reading in self.as_well],
            "torque_rms": {
                name: self.left_over(name) for name in ("torque", "unchanged", "as_logged", "plain", "left")
            },
            "joints": [joint.to_mapping() for joint in self.joints],
            "next_motion": [request.to_mapping() for request in self.next.requests],
            "other_logs": [item.to_mapping() for item in self.others],
            "replay": None if self.replay is None else self.replay.to_mapping(),
            "group": None if self.group is None else self.group.to_mapping(),
            "notes": list(self.log.notes),
        }


def diagnose_robot(model: Path, real: Path, progress: Progress = lambda _: None) -> RobotDiagnosis:
    """Diagnose a robot by a log.

    Args:
        model: MJCF or URDF file.
        real: a log, or its sidecar.
        progress: gets a sentence on each step.

    Raises:
        BenchError: the model or the log cannot be used; the sentence says what is needed.
    """
    progress("reading the model and the log")
    robot = RobotModel(model)
    log = read_log(real, model)
    joints = robot.chosen(log.joints)
    check_units(log, joints)
    progress("torque of the rigid bodies")
    log, motion, found = mended(robot, log, joints)
    found += contact_findings(robot, log)
    log, law = computed_by_law(log, joints)
    found += law
    drive = DriveTorque(log)
    progress("looking at the log")
    plain_torque = drive.torque(Reading())
    found += [
        *velocity_findings(log, motion),
        *torque_findings(log, joints, plain_torque),
        *order_findings(log, joints, motion, plain_torque),
    ]
    log = with_right_speeds(log, motion)
    drive = DriveTorque(log)
    found += assignment_findings(robot, log, motion, drive.torque(Reading()))
    derived = any(
        (finding.fault or finding.key == "velocity_late") and finding.key.startswith("velocity") for finding in found
    )
    scores = compare_readings(motion, drive, derived)
    log, scores, led = with_command_speed(log, motion, scores, derived)
    drive = DriveTorque(log)
    found += led
    plain = _plain_left(motion, plain_torque)
    progress("bodies")
    as_given = log, motion
    bodies = None if no_claims_because(found) else body_finding(robot, log, drive.torque(scores.best), joints)
    changed = robot
    if bodies is not None and bodies.claimed:
        changed, log = bodies.within, without_factor(log, bodies.factor)
        drive, motion = DriveTorque(log), with_bodies(changed, log, motion)
        scores = compare_readings(motion, drive, derived)
    if robot.floating:
        motion, scores, finding = with_base(changed, log, motion, drive, scores, derived)
        found += finding
    motion = with_link_masses(changed, log, motion)
    believed = [values_in_model(joint) for joint in joints]
    progress("joints")
    of_all = frozenset() if bodies is None else OF_BODIES
    as_well, results = _understood(motion, drive, scores, believed, log.joints, of_all)
    if as_well[0] == scores.best:
        found += reading_findings(scores, held_time(log), measured=not log.is_arithmetic)
    verdicts = []
    put_in = _put_in(as_given, log, motion, as_well[0])
    delayed = by_shared_delay(log, believed, {number: items[0] for number, items in results.items()})
    lagging = by_lag_of_torque(log, as_well[0])
    for number, joint in enumerate(joints):
        if number in results:
            timing = delayed.get(number, {})
            for key, size in lagging.get(number, {}).items():
                timing[key] = max(timing.get(key, 0.0), size)
            verdicts.append(
                joint_verdict(joint, motion, number, results[number], plain[number], put_in[:, number], timing)
            )
        else:
            verdicts.append(unjudged(joint, float(np.std(plain_torque[:, number]))))
    loose = joint_with_transmission(changed, log, motion, drive, as_well, results, joints, found)
    if loose is not None:
        verdicts[loose.number] = verdict_with_transmission(joints[loose.number], loose, verdicts[loose.number])
    verdicts = undisturbed(verdicts, changed.coupling(log.joints, motion.q[:: max(1, log.rows // _POSES)]))
    if bodies is not None:
        verdicts = with_body_terms(verdicts, bodies)
    found += scale_findings(tuple(verdicts), bodies is not None and bodies.of_links)
    reason = no_claims_because(found)
    if reason:
        verdicts = [without_claims(item, f"{reason}: nothing is claimed") for item in verdicts]
    ordered = sorted(found, key=lambda item: not item.fault)
    classes = [name for finding in found if finding.instead for name in finding.joints]
    following = next_motion(motion, joints, verdicts, as_well, classes)
    return RobotDiagnosis(
        robot, log, motion, tuple(ordered), as_well[0], tuple(as_well), tuple(verdicts), following,
        of_file=tuple(file_findings(robot, log.joints)), bodies=bodies, as_given=as_given,
    )  # fmt: skip


def check_units(log: JointLog, joints: tuple[Joint, ...]) -> None:
    """Raise where a joint cannot have the unit of its positions.

    Raises:
        BenchError: lengths of a joint that turns, or angles of one that slides.
    """
    for joint, unit in zip(joints, log.position_units, strict=False):
        if joint.turns and unit in ("m", "cm", "mm"):
            raise BenchError(f"{log.source}: positions in {unit}, but {joint.name} turns: give rad, deg or turn.")
        if not joint.turns and unit in ("deg", "turn", "mrad"):
            raise BenchError(f"{log.source}: positions in {unit}, but {joint.name} slides: give m, cm or mm.")


def contact_findings(robot: RobotModel, log: JointLog) -> list[Finding]:
    """Whether shapes of the model touch in poses of the log: what a contact does is not in the rigid bodies' torque."""
    if robot.floating:
        return []
    poses = log.position[:: max(1, log.rows // _POSES)]
    share, (first, second) = robot.touching(log.joints, poses)
    if share == 0.0:
        return []
    sentence = (
        f"In {100 * share:.0f} % of the poses {first} and {second} touch in the model. Contacts are left out: if they "
        "touch really, log a motion in free air, for what a contact does would be taken for the joints'."
    )
    return [Finding("contact", sentence, share, float("nan"), "1", fault=False)]


def no_claims_because(found: Sequence[Finding]) -> str:
    """Why no joint's cause can be claimed next to what was found on the log; empty where that is not so."""
    for finding in found:
        if finding.fault and finding.key in {"order", "joint_sign", "gravity_sign"}:
            return "columns are in another order or have another sign"
        # All speeds and accelerations have the clock's factor, and the torque of the bodies its square.
        clock = "clock_factor" in (finding.key, *finding.instead)
        if finding.fault and clock and abs(finding.size - 1.0) > THRESHOLDS.clock_factor:
            return "the clock or all speeds are wrong by a factor"
    return ""


def mended(robot: RobotModel, log: JointLog, joints: tuple[Joint, ...]) -> tuple[JointLog, Motion, list[Finding]]:
    """The log with turns, degrees, rows and clock put right, its motion, and what was found on them.

    Raises:
        BenchError: no joint moves.
    """
    log, found = unwrapped(log, joints)
    log, in_degrees = in_radians(log, joints)
    motion = motion_of(robot, log)
    if not np.any(motion.moves):
        raise BenchError(
            f"{log.source}: no joint moves in {100 * THRESHOLDS.moving_rows:.0f} % of the rows faster than "
            f"{THRESHOLDS.sticking_rad_s:g} rad/s: a joint that sticks or stands still says nothing of its friction "
            "and inertia. Command more than its breakaway torque, over its range; check the unit of the positions, too."
        )
    rows = row_findings(log, motion)
    keys = {finding.key for finding in rows}
    changed = log
    if "rows_repeated" in keys:
        changed = with_fresh_rows(changed, stale_rows(log, motion.moving))
        motion = motion_of(robot, changed)
        # Repeated rows look like a clock that jitters.
        rows = [
            *(finding for finding in rows if finding.key != "hidden_jitter"),
            *(finding for finding in row_findings(changed, motion) if finding.key == "hidden_jitter"),
        ]
    time, missing = time_with_missing_rows(changed)
    if missing and not keys & {"rows_missing", "rows_repeated"}:
        sentence = (
            f"{missing} rows are missing on a clock that does not say so: between some rows the joints went twice as "
            "far as their speed. The time is counted anew."
        )
        rows = [*(item for item in rows if item.key != "hidden_jitter"), Finding("rows_missing", sentence, missing, 0.0,
                "rows")]  # fmt: skip
        changed = on_even_clock(changed, time)
    # The stamps and the motion may each say when rows were measured: that clock is right which serves all joints.
    clocks = [changed]
    if keys & {"uneven_clock", "rows_missing"} and stamps_agree(changed):
        clocks.append(on_even_clock(changed, changed.time))
    in_turn = bool(alternation(changed)[0])
    if any(finding.key == "hidden_jitter" for finding in rows):
        # Rows in turn are certain by themselves, and the filter hides them from the torque.
        clocks = [*([] if in_turn else clocks), on_even_clock(changed, time_by_motion(changed))]
    if clocks[-1] is not log:
        counted = [(item, motion if item is log else motion_of(robot, item)) for item in clocks]
        if log not in clocks and not in_turn:
            counted.append((log, motion_of(robot, log)))
        changed, motion = min(counted, key=lambda item: _least_left(*item))
        if changed is log:
            as_it_is = (item for item in row_findings(log, motion) if item.key != "hidden_jitter")
            return log, motion, [*found, *in_degrees, *as_it_is]
    return changed, motion, [*found, *in_degrees, *rows]


def _least_left(log: JointLog, motion: Motion) -> float:
    """Mean squared residual over torque of the reading that fits best."""
    return float(np.min(compare_readings(motion, DriveTorque(log)).relative))


def read_log(real: Path, model: Path) -> JointLog:
    """A log by its sidecar, or by the sidecar that would be proposed for it.

    Raises:
        BenchError: it cannot be read, or a question must be answered in a sidecar first.
    """
    if real.suffix.lower() in (".yaml", ".yml"):
        return read_robot_sidecar(real)
    proposal = propose_sidecar(real, model, real.parent)
    if proposal.questions:
        raise BenchError(
            f"{real} does not say {'; '.join(proposal.questions)}: make a sidecar and answer it there: "
            f"./nmt import --init {real} --robot {model}."
        )
    return sidecar_of_text(proposal.text, real.parent, proposal.columns)


def with_base(
    robot: RobotModel, log: JointLog, motion: Motion, drive: DriveTorque, scores: ReadingScores, derived: bool
) -> tuple[Motion, ReadingScores, list[Finding]]:
    """Whether the base stood still or gave way, by all joints together."""
    yielding = with_yielding_base(robot, log, motion)
    other = compare_readings(yielding, drive, derived, scores.fit_as_well())
    still, gives = float(np.min(scores.relative)), float(np.min(other.relative))
    apart = float(np.sqrt(gives / still)) - 1.0
    alike = abs(apart) < 0.5 * THRESHOLDS.fits_as_well
    better = gives < still
    words = "gives way under the limbs" if better else "stands still"
    sentence = (
        f"The base floats in the model and has no sensor in the log. All joints together fit "
        f"{100 * abs(apart):.0f} % better if it {words}"
    )
    sentence += ", which is too little to tell." if alike else "."
    sentence += " An IMU on the base would tell, or the base clamped; no foot may touch the ground."
    finding = Finding(
        "base", sentence, -abs(apart), float("nan"), "1", abs(apart) if better else 0.0, fault=better and not alike
    )
    if not better or alike:
        return motion, scores, [finding]
    return yielding, compare_readings(yielding, drive, derived), [finding]


def _few(readings: list[Reading]) -> list[Reading]:
    """The best reading and those that differ most from it, of each kind."""
    chosen = readings[:1]
    for key in ("command", "command_lag_s", "torque_lag_s", "derived"):
        for extreme in (min, max):
            reading = extreme(readings, key=lambda item: getattr(item, key))
            if reading not in chosen:
                chosen.append(reading)
    return chosen


def _understood(
    motion: Motion,
    drive: DriveTorque,
    scores: ReadingScores,
    believed: list[dict[str, float]],
    names: tuple[str, ...],
    of_all: frozenset[str],
) -> tuple[list[Reading], dict[int, list[JointMechanics]]]:
    """How the log is read, best first, and the mechanics of each joint that moves under each of the readings.

    A reading other than the log as it is has to explain more than that does with the causes that it needs: what a
    gain or a spring does to the torque would else be made of delays. A cause that leaves no less on the last part in
    one of the readings, that is not certain over them, or that all joints were asked for, is left out and the rest are
    compared again.

    Args:
        of_all: keys of effects that all joints were asked for.
    """
    movers = [int(number) for number in np.flatnonzero(motion.moves)]

    def explained(reading: Reading) -> dict[int, JointMechanics]:
        signals = drive.signals(reading)
        return {
            number: explain(JointProblem(motion, number, signals.of(number), names), believed[number])
            for number in movers
        }

    def score(found: dict[int, JointMechanics]) -> float:
        return float(sum(item.choice.score for item in found.values()))

    def left(found: dict[int, JointMechanics]) -> float:
        return float(np.mean([(item.held_out.interleaved / item.held_out.torque) ** 2 for item in found.values()]))

    readings = _few(scores.fit_as_well())
    first = explained(readings[0])
    if readings[0] != Reading():
        plain = explained(Reading())
        if score(plain) < score(first) or left(plain) < (1.0 + THRESHOLDS.fits_as_well) * left(first):
            alike = [item for item in readings if item != Reading() and scores.alike(item, Reading())]
            readings, first = [Reading(), *alike], plain
    results = {number: [first[number]] for number in movers}
    as_well = readings[:1]
    for reading in readings[1:]:
        signals = drive.signals(reading)
        found = {
            number: explain(JointProblem(motion, number, signals.of(number), names), believed[number], first[number])
            for number in movers
        }
        # What fits as well by friction and armature alone need not with the causes.
        if left(found) > max(_CLEARLY_WORSE * left(first), THRESHOLDS.smallest_floor**2):
            continue
        as_well.append(reading)
        for number in movers:
            results[number].append(found[number])
    every = [drive.signals(reading) for reading in as_well]
    for number in movers:
        refused, problems = frozenset[str](), list[JointProblem]()
        while True:
            items = results[number]
            causes = frozenset(items[0].causes)
            doubted = uncertain_causes(items).union(*(item.lost for item in items))
            more = (causes & doubted | (of_all if causes & of_all else frozenset())) - refused
            if not more:
                break
            refused |= more
            problems = problems or [JointProblem(motion, number, signals.of(number), names) for signals in every]
            best = explain(problems[0], believed[number], without=refused)
            results[number] = [best, *(explain(problem, believed[number], best) for problem in problems[1:])]
    return as_well, results


def _put_in(original: tuple[JointLog, Motion], log: JointLog, motion: Motion, reading: Reading) -> Array:
    """N × J: torque that bodies and constants which were put in take from what the model as given leaves over, N·m."""
    before, after = (DriveTorque(item).torque(reading) for item in (original[0], log))
    return np.asarray(motion.smooth_twice(before - after) + motion.rigid - original[1].rigid)


def _plain_left(motion: Motion, torque: Array) -> list[tuple[float, float]]:
    """Torque of each joint and what the plain fit of the log as it is leaves on held-out seconds, N·m."""
    found = []
    for joint in range(torque.shape[1]):
        if not motion.moves[joint]:
            found.append((float(np.std(torque[:, joint])), float("nan")))
            continue
        problem = JointProblem(motion, joint, DriveSignals(torque[:, joint]))
        held_out = problem.held_out(problem.usual)
        found.append((held_out.torque, held_out.interleaved))
    return found
