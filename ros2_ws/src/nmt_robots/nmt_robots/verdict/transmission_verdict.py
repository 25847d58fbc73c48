"""The joint whose transmission gives way or has play, if there is one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from nmt_robots.log.joint_log import Array, JointLog
from nmt_robots.log_faults.finding import Finding, is_known
from nmt_robots.mechanics.ladder import JointMechanics, JointProblem, explain
from nmt_robots.mechanics.motion import Motion
from nmt_robots.mechanics.readings import DriveTorque, Reading
from nmt_robots.mechanics.transmission import LinkBehindTransmission, Transmission, torque_of_bodies, transmission_of
from nmt_robots.model.robot_model import Joint, RobotModel
from nmt_robots.thresholds import THRESHOLDS
from nmt_robots.verdict.joint_verdict import JointTerm, JointVerdict, joint_verdict, values_in_model

_OF_TIMING = frozenset({"torque_lag", "command_lag", "hidden_jitter", "uneven_clock", "rows_missing", "clock_factor"})
"""Faults of a log that look like a transmission: what is late, or when its rows were measured."""


@dataclass(frozen=True, eq=False)
class JointWithTransmission:
    """A joint behind whose transmission the link moves by itself.

    Attributes:
        number: column of the joint.
        transmission: that was found.
        mechanics: of the joint with it.
        share: of the joint's torque that it changes, rms over rms.
        log_fault: sentence on the fault of the log that prevents the claim; empty = it is.
    """

    number: int
    transmission: Transmission
    mechanics: JointMechanics
    share: float
    log_fault: str = ""


def joint_with_transmission(
    robot: RobotModel, log: JointLog, motion: Motion, drive: DriveTorque, readings: list[Reading],
    results: dict[int, list[JointMechanics]], joints: Sequence[Joint], found: Sequence[Finding],
) -> JointWithTransmission | None:  # fmt: skip
    """The joint that a transmission explains best, where it explains what else stays; None without one.

    One only: a link that swings is felt by all joints next to it.

    Args:
        robot, log, motion, drive: of the diagnosis.
        readings: of the log that fit as well, that taken first.
        results: mechanics of each joint that moves.
        joints: of the columns.
        found: findings on the log.
    """
    tried = dict.fromkeys([Reading(), Reading(torque_lag_s=0.001), Reading(torque_lag_s=0.002), *readings])
    torques = [drive.torque(reading) for reading in tried]
    options: list[tuple[float, int, Transmission]] = []
    bodies: tuple[Array, Array] | None = None
    for number, items in results.items():
        held_out = items[0].held_out
        doubted = held_out.interleaved > THRESHOLDS.may_give_way * held_out.torque or "jerk" in items[0].causes
        if not doubted:
            continue
        bodies = torque_of_bodies(robot, log, motion) if bodies is None else bodies
        link = LinkBehindTransmission(robot, log, motion, number, bodies)
        item = transmission_of(link, [torque[:, number] for torque in torques])
        if item is None:
            continue
        options.append((item.left / max(item.rigid, 1e-300), number, item))
    if not options:
        return None
    ratio, number, item = min(options, key=lambda option: option[0])
    size, std = (item.gap, item.gap_std) if item.gap else (item.stiffness, item.stiffness_std)
    before = results[number][0].held_out
    rows = motion.moving[:, number]
    changed = (item.motion.rigid - motion.rigid)[rows, number]
    share = float(np.std(changed)) / max(before.torque, 1e-300)
    if ratio > THRESHOLDS.gives_way or size < THRESHOLDS.certain * std or share < THRESHOLDS.smallest_share:
        return None
    problem = JointProblem(item.motion, number, drive.signals(readings[0]).of(number), log.joints)
    mechanics = explain(problem, values_in_model(joints[number]))
    after = mechanics.held_out
    if after.interleaved > min(before.interleaved, THRESHOLDS.unexplained * after.torque):
        return None
    faults = [finding for finding in found if finding.fault and finding.key in _OF_TIMING]
    log_fault = next((finding.sentence for finding in faults if not is_known(finding.share) or finding.share > 0.0), "")
    return JointWithTransmission(number, item, mechanics, share, log_fault)


def verdict_with_transmission(joint: Joint, found: JointWithTransmission, plain: JointVerdict) -> JointVerdict:
    """The answer for a joint with its transmission; where it is not claimed, the plain one and why.

    Args:
        joint: as the model has it.
        found: its transmission.
        plain: the answer without it.
    """
    item = found.transmission
    if found.log_fault:
        kind = "backlash" if item.gap else "a transmission that gives way"
        return replace(plain, remains=f"{plain.remains}; {kind} may be there, but is not reported with the log's fault")
    figures = (plain.torque, plain.as_logged)
    verdict = joint_verdict(joint, item.motion, found.number, [found.mechanics], figures, np.zeros(len(item.motion.q)))
    alike = item.other < 1.5 * item.left
    if item.gap:
        other = ("elastic transmission",) if alike else ()
        # The stiffness behind it is not reported: it reads a quarter to a half of the true one.
        term = JointTerm(
            "backlash", "backlash from end to end,", joint.units("rad"), item.gap, item.gap_std, 0.0, found.share, True,
            other,
        )  # fmt: skip
    else:
        other = ("backlash",) if alike else ()
        term = JointTerm(
            "elastic", "elastic transmission, stiffness", joint.units("N·m/rad"), item.stiffness, item.stiffness_std,
            0.0, found.share, True, other,
        )  # fmt: skip
    return replace(verdict, terms=(term, *verdict.terms), unchanged=plain.unchanged, plain=plain.plain,
                   last_plain=plain.last_plain, transmission=item)  # fmt: skip
