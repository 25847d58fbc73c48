"""Further logs of a robot as tests that are held out: the same values, and torque that the first log's terms leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from nmt_robots.bodies.body_finding import without_factor
from nmt_robots.log.joint_log import Array
from nmt_robots.log.robot_sidecar import robot_of_sidecar
from nmt_robots.mechanics.ladder import JointProblem
from nmt_robots.mechanics.motion import with_bodies
from nmt_robots.mechanics.readings import DriveTorque
from nmt_robots.model.robot_model import RobotModel
from nmt_robots.verdict.alike_joints import joint_group, read_joint_table
from nmt_robots.verdict.joint_verdict import JointVerdict, values_in_model
from nmt_robots.verdict.replay import replayed
from nmt_robots.verdict.robot_diagnosis import ComparedTerm, OtherLog, Progress, RobotDiagnosis, diagnose_robot


def model_of_other_log(model: Path, first: Path, other: Path) -> Path:
    """The model that a further log is tested with: its sidecar's own, where that is another than the first log's.

    So a known mass that was hung on for the second log stands in a model of its own.

    Args:
        model: of the first log.
        first, other: logs or their sidecars.

    Raises:
        BenchError: a sidecar is wrong, or its robot does not exist.
    """
    theirs = robot_of_sidecar(other)
    if theirs is None or theirs.samefile(model):
        return model
    proposed = robot_of_sidecar(first)
    return model if proposed is not None and theirs.samefile(proposed) else theirs


def other_log(first: RobotDiagnosis, other: RobotDiagnosis, model: str = "") -> OtherLog:
    """What a further log says of the answer of the first one; joints are matched by name.

    Args:
        first, other: by the two logs.
        model: name of the further log's own model; empty = that of the first one.
    """
    by_name = {verdict.joint.name: verdict for verdict in other.joints}
    terms: list[ComparedTerm] = []
    left: dict[str, tuple[float, float, float]] = {}
    assert other.as_given is not None
    log, motion = other.as_given
    sides = [(log, motion, DriveTorque(log).signals(other.reading))]
    if first.bodies is not None and first.bodies.claimed and not model:
        log = without_factor(log, first.bodies.factor) if log.joints == first.log.joints else log
        motion = with_bodies(first.changed, log, motion)
    sides.append((log, motion, DriveTorque(log).signals(other.reading)))
    for verdict in first.joints:
        name = verdict.joint.name
        match = by_name.get(name)
        if match is None or verdict.mechanics is None or match.mechanics is None:
            continue
        terms += _compared(verdict, match)
        number = other.log.joints.index(name)
        before, after = (JointProblem(motion, number, signals.of(number), log.joints) for log, motion, signals in sides)
        left[name] = _left(before, after, verdict)
    return OtherLog(other.log.source, tuple(terms), left, other.joints, model)


def _compared(verdict: JointVerdict, match: JointVerdict) -> list[ComparedTerm]:
    """Terms that differ from the model by one of two answers for a joint."""
    found = {}
    for here, there, turned in ((verdict, match, False), (match, verdict, True)):
        others = {term.key: term for term in there.terms}
        for term in here.terms:
            if not term.differs or term.key in found:
                continue
            twin = others.get(term.key)
            values = (term.value, term.std), ((twin.value, twin.std) if twin else (float("nan"), float("nan")))
            first, second = reversed(values) if turned else values
            found[term.key] = ComparedTerm(verdict.joint.name, term.words, term.unit, first, second)
    return list(found.values())


def _left(before: JointProblem, after: JointProblem, verdict: JointVerdict) -> tuple[float, float, float]:
    """Torque of a joint, and what the model and another log's terms leave of it, rms about the mean, N·m."""
    assert verdict.mechanics is not None
    in_model = values_in_model(verdict.joint)
    model, terms = before.left.copy(), after.left.copy()
    for effect in before.usual:
        model -= before.columns([effect])[:, 0] * in_model.get(effect.key, 0.0)
    effects = {(effect.key, effect.shape): effect for effect in [*after.usual, *after.rivals]}
    for share in verdict.mechanics.shares:
        twin = effects.get((share.effect.key, share.effect.shape))
        if twin is not None:
            terms -= after.columns([twin]) @ share.values
    return _spread(before.torque), _spread(model), _spread(terms)


def _spread(values: Array) -> float:
    return float(np.std(values))


def diagnose_robot_by_logs(
    model: Path, real: Sequence[Path], progress: Progress = lambda _: None, alike: Path | None = None
) -> RobotDiagnosis:
    """Diagnose a robot by its first log, replay it, and test the answer on the others, of which nothing is fitted.

    Args:
        model: MJCF or URDF file.
        real: logs or their sidecars.
        progress: gets a sentence on each step.
        alike: table of joints that are meant to be alike; the logs are its repeats.

    Raises:
        BenchError: as :func:`diagnose_robot`; the table cannot be used.
    """
    if alike is not None:
        read_joint_table(alike, [joint.name for joint in RobotModel(model).joints])
    first = diagnose_robot(model, real[0], progress)
    progress("replaying the log")
    assert first.as_given is not None
    early = first.model if first.bodies is None else first.bodies.early
    replay = replayed(
        (first.model, first.as_given[0]), (early, first.log), first.motion, first.as_well, first.joints,
        first.findings,
    )  # fmt: skip
    others = []
    for path in real[1:]:
        progress(f"testing on {path.name}")
        theirs = model_of_other_log(model, real[0], path)
        others.append(other_log(first, diagnose_robot(theirs, path), "" if theirs == model else theirs.name))
    group = None
    if alike is not None:
        places = read_joint_table(alike, first.log.joints)
        group = joint_group([first.joints, *(other.joints for other in others)], places)
    return replace(first, others=tuple(others), replay=replay, group=group)
