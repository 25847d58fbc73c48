"""Torque of a log: computed or measured, at its limit, late; and the order, sign and unit of the joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from nmt_robots.log.joint_log import Array, JointLog, control_law
from nmt_robots.log_faults.finding import Finding
from nmt_robots.mechanics.motion import Motion
from nmt_robots.mechanics.readings import HELD, SMOOTH, DriveTorque, joined
from nmt_robots.mechanics.shared_reading import ReadingScores, compare_readings
from nmt_robots.model.robot_model import Joint
from nmt_robots.thresholds import THRESHOLDS

_SHARE_OF_ONE = 0.4
"""Of the plain residual, taken by a lag that a single joint has to show."""
_DOUBTFUL = 0.15
"""Torque left over, as a share, from which a lag may stand for an unknown cause."""
_AT_LIMIT = 1.03
"""Of a limit: torque above which it is no limit of the drive, whatever its noise."""
_FOLLOWS = 0.5
"""Squared residual with the speed of the command over that without it, below which the drives follow that speed."""
_ORDINARY_S = 0.002
"""A control loop that holds its torque for a millisecond and a current loop are so late, s."""


def torque_findings(log: JointLog, joints: tuple[Joint, ...], torque: Array) -> list[Finding]:
    """Where the torque comes from, and whether it is at the drive's limit."""
    found = []
    if log.is_arithmetic:
        found.append(
            Finding(
                "torque_computed",
                "No torque was measured: it is computed by the control law with the stated gains, so a wrong gain, "
                "another loop in the drive or a limit of its current would look like friction or mass.",
                fault=False,
            )
        )
    at_limit, beyond = dict[str, float](), dict[str, float]()
    for number, joint in enumerate(joints):
        size = np.abs(torque[:, number])
        share = float(np.mean(size > 0.999 * joint.effort))
        if share > 0.002:
            # A drive at its limit gives no more than that.
            more = not log.is_arithmetic and float(np.mean(size > _AT_LIMIT * joint.effort)) > 0.5 * share
            (beyond if more else at_limit)[joint.name] = share
    for shares, how, fault in (
        (at_limit, "would be beyond" if log.is_arithmetic else "is at", True), (beyond, "goes beyond", False),
    ):  # fmt: skip
        if shares:
            listed = ", ".join(f"{name} in {100 * share:.0f} % of the rows" for name, share in shares.items())
            sentence = f"The torque {how} the limit that the model states for the drive: {listed}."
            found.append(
                Finding(
                    "saturation" if fault else "beyond_limit", sentence, max(shares.values()), 0.0, "share of rows",
                    joints=tuple(shares), fault=fault,
                )
            )  # fmt: skip
    return found


def computed_by_law(log: JointLog, joints: Sequence[Joint]) -> tuple[JointLog, list[Finding]]:
    """The log with a torque that was given as measured, but is the control law of the drives, taken for what it is.

    Such a torque says no more than command, position and speed do, so it is computed of these from here on, in every
    reading of them, with the gains that it has itself.
    """
    if log.torque is None or log.position_command is None:
        return log, []
    commanded = np.zeros_like(log.position) if log.velocity_command is None else log.velocity_command
    terms = [log.position_command - log.position]
    if log.velocity is not None:
        # A drive's speed may have another filter than the logged one.
        terms += [commanded - log.velocity, np.gradient(log.velocity, axis=0)]
    middle, gains = control_law(terms, log.torque - (0.0 if log.torque_command is None else log.torque_command))
    if not middle <= THRESHOLDS.exact:
        return log, []
    gains = np.pad(gains, ((0, 0), (0, 1)))[:, :2]
    listed = ", ".join(
        joint.units(f"{joint.name} {kp:.3g} N·m/rad") for joint, (kp, _) in zip(joints, gains, strict=True)
    )
    sentence = (
        "The torque that is given as measured is the control law of the drives to "
        f"{100 * middle:.2g} %: it was computed, not measured (position gains {listed})."
    )
    found = Finding("torque_is_law", sentence, middle, 0.0, "1")
    return replace(log, torque=None, position_gain=gains[:, 0], velocity_gain=gains[:, 1]), [found]


def with_command_speed(
    log: JointLog, motion: Motion, scores: ReadingScores, derived: bool
) -> tuple[JointLog, ReadingScores, list[Finding]]:
    """The log with the speed of the command as velocity command, where it has none and the drives follow that speed.

    To first order that is a command early by kd / kp, as late as the drives are fast.

    Args:
        log: as it was read.
        motion: of the log.
        scores: of all readings of it.
        derived: as in :meth:`DriveTorque.candidates`.
    """
    if not log.is_arithmetic or log.velocity_command is not None or log.velocity_gain is None:
        return log, scores, []
    assert log.position_command is not None
    led = replace(log, velocity_command=np.gradient(joined(log.position_command), log.step_s, axis=0))
    found = compare_readings(motion, DriveTorque(led), derived)
    # With a lag of kd / kp that speed would be as none.
    best = found.best
    if max(abs(best.command_lag_s), abs(best.torque_lag_s)) > max(_ORDINARY_S, log.step_s):
        return log, scores, []
    least = float(np.min(found.relative))
    if least > _FOLLOWS * float(np.min(scores.relative)):
        return log, scores, []
    share = 1.0 - float(np.sqrt(least / scores.relative[scores.plain]))
    sentence = (
        "The log has no velocity command, but the drives follow the speed of the position command: with kd times its "
        f"derivative {100 * share:.0f} % of the residual of the plain reading is gone, and it is used from here on."
    )
    return led, found, [Finding("command_speed", sentence, share, float("nan"), "1", fault=False)]


def reading_findings(scores: ReadingScores, held_s: float, measured: bool = False) -> list[Finding]:
    """What all joints together say of how commands and torques are to be read.

    Args:
        scores: of all readings.
        held_s: mean time for which the log keeps a command, s.
        measured: whether the log has the torque: one that acted before its row was logged late.
    """
    best = scores.best
    plain, least = scores.relative[scores.plain], float(np.min(scores.relative))
    share = 1.0 - float(np.sqrt(least / plain))
    alike = scores.fit_as_well()
    found = []
    kinds = {reading.command for reading in scores.readings}
    if len(kinds) > 1:
        apart = float(np.sqrt(_least(scores, SMOOTH) / _least(scores, HELD))) - 1.0
        better = best.command
        both = {reading.command for reading in alike} == kinds
        words = "both fit as well, and every ± spans both" if both else f"as {better} it fits better"
        found.append(
            Finding(
                "command_reading",
                f"Command read as held or as running straight between its changes: {words} (torque left over "
                f"{100 * abs(apart):.0f} % {'more' if apart > 0 else 'less'} if straight).",
                apart, float("nan"), "1", fault=False,
            )
        )  # fmt: skip
    if scores.is_beyond:
        longest = max(max(abs(item.command_lag_s), abs(item.torque_lag_s)) for item in scores.readings)
        sentence = (
            f"Command or torque fit best with the largest lag that was asked, {1e3 * longest:.3g} ms: no lag is "
            "stated, and damping and armature may be made of one."
        )
        return [*found, Finding("lag_beyond", sentence)]
    late = "command_lag_s" if best.command_lag_s else "torque_lag_s"
    lag, std = scores.lag(best.command, late)
    kind = bool(best.command_lag_s)
    others = [getattr(item, late) for item in alike if bool(item.command_lag_s) == kind and getattr(item, late)]
    if others:
        std = float(np.hypot(std, max(abs(other - lag) for other in others) / np.sqrt(3.0)))
    # A command that is held is late by half of its time compared with one that runs straight.
    expected = 0.5 * held_s if best.command == SMOOTH else 0.0
    # One joint alone makes a lag of much that it has not in common with others.
    several = int(np.sum(np.all(np.isfinite(scores.by_joint), axis=0))) > 1
    sure = np.sqrt(least) < _DOUBTFUL and (several or (lag > 0.0 and share > _SHARE_OF_ONE))
    # A drive that holds its torque over a row is late by half of one.
    if (
        abs(lag) > max(THRESHOLDS.lag_s, 0.75 * scores.step_s, THRESHOLDS.certain * std)
        and share > 0.5 * THRESHOLDS.fits_as_well
    ):
        logged = measured and late == "torque_lag_s"
        loop = "torque (or the whole control loop)" if late == "torque_lag_s" else "command"
        sense = "early" if (lag > 0.0) == logged else "late"
        joints = _agreeing(scores, best.command, late)
        order = (
            "" if measured else " To first order such a delay is a damping of −kp·δ and an armature of −kd·δ, so "
            "neither is reported without it."
        )  # fmt: skip
        found.append(
            Finding(
                late.removesuffix("_s"),
                f"The {'logged torque' if logged else loop} is {1e3 * abs(lag):.3g} ± {1e3 * std:.2g} ms {sense} "
                f"against the motion in all joints ({joints}); read so, {100 * share:.0f} % of the residual of the "
                f"plain reading is gone.{order}",
                lag, std, "s", share, fault=bool(sure) and abs(lag - expected) > _ORDINARY_S + 0.25 * expected,
            )
        )  # fmt: skip
    return found


def _least(scores: ReadingScores, command: str) -> float:
    numbers = [number for number, reading in enumerate(scores.readings) if reading.command == command]
    return float(np.min(scores.relative[numbers]))


def _agreeing(scores: ReadingScores, command: str, late: str) -> str:
    """What single joints say of a lag, in words."""
    lags, numbers = scores.among(command, late)
    each = scores.by_joint[numbers]
    known = np.all(np.isfinite(each), axis=0)
    each_lag = 1e3 * np.abs(lags[np.argmin(each[:, known], axis=0)])
    if len(each_lag) < 2:
        return "one joint"
    low, high = np.quantile(each_lag, (0.1, 0.9))
    return f"single joints say {low:.3g} to {high:.3g} ms"


def order_findings(log: JointLog, joints: tuple[Joint, ...], motion: Motion, torque: Array) -> list[Finding]:
    """Joints that are not what the names say: range, sign of gravity, unit."""
    found = []
    outside = []
    for number, joint in enumerate(joints):
        low, high = float(np.min(log.position[:, number])), float(np.max(log.position[:, number]))
        room = 0.05 * max(joint.upper - joint.lower, 1e-9) if np.isfinite(joint.upper - joint.lower) else 0.0
        if low < joint.lower - room or high > joint.upper + room:
            outside.append(f"{joint.name} ({low:.3g} to {high:.3g}, range {joint.lower:.3g} to {joint.upper:.3g})")
    if outside:
        found.append(
            Finding(
                "out_of_range",
                f"Positions are beyond the joint's range in the model: {', '.join(outside)}; check order, sign, unit "
                "and zero of these joints.",
                len(outside), 0.0, "joints", joints=tuple(word.split(" ")[0] for word in outside),
            )
        )  # fmt: skip
    return [*found, *_mirrored(joints, motion, torque)]


def _mirrored(joints: tuple[Joint, ...], motion: Motion, torque: Array) -> list[Finding]:
    """Joints whose steady torque holds against gravity with the wrong sign."""
    wrong = []
    for number, joint in enumerate(joints):
        gravity = motion.gravity[:, number]
        size = float(np.sqrt(np.mean(gravity**2)))
        if size < 0.3 * float(np.sqrt(np.mean(torque[:, number] ** 2))):
            continue
        rows = motion.moving[:, number]
        if np.count_nonzero(rows) < 50:
            continue
        v, acting = motion.v[rows, number], motion.smooth_twice(torque)[rows, number]
        rubbing = np.column_stack([np.sign(v), v, motion.a[rows, number]])
        matrix = np.column_stack([gravity[rows], rubbing])
        factor = float(np.linalg.lstsq(matrix, acting, rcond=None)[0][0])
        # A joint that other joints' motion moves hardly says what gravity does.
        rigid = motion.rigid[rows, number]
        as_named, turned, hanging = (
            float(np.linalg.norm(left - rubbing @ np.linalg.lstsq(rubbing, left, rcond=None)[0]))
            for left in (acting - rigid, acting + rigid, acting - rigid + 2.0 * gravity[rows])
        )
        if factor < -0.3 and min(turned, hanging) < as_named:
            wrong.append(joint.name)
    if not wrong:
        return []
    return [
        Finding(
            "gravity_sign",
            f"The torque holds against gravity with the wrong sign in {', '.join(wrong)}: sign or order of the joints, "
            "or the way gravity points.",
            len(wrong), 0.0, "joints", joints=tuple(wrong),
        )
    ]  # fmt: skip
