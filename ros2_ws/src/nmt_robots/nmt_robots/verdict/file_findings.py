"""What a robot's file says that a reader of the diagnosis has to know before the fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nmt_robots.log_faults.finding import Finding
from nmt_robots.model.robot_model import RobotModel

_LISTED = 8
_USUAL_GRAVITY = (9.7, 9.9)
_UPRIGHT = np.radians(0.5)


def file_findings(robot: RobotModel, names: Sequence[str]) -> list[Finding]:
    """Facts of a robot's file.

    Args:
        robot: the model.
        names: joints of the log.
    """
    return [
        Finding(f"file_{key}", sentence, joints=tuple(joints), fault=False)
        for key, sentence, joints in (*_of_bodies(robot), *_of_joints(robot, names), *_of_base(robot))
        if sentence
    ]


def _listed(items: Sequence[str]) -> str:
    more = f" and {len(items) - _LISTED} more" if len(items) > _LISTED else ""
    return ", ".join(items[:_LISTED]) + more


_Fact = tuple[str, str, Sequence[str]]


def _of_bodies(robot: RobotModel) -> list[_Fact]:
    found: list[_Fact] = []
    impossible: dict[str, str] = robot.facts["impossible"]
    if impossible:
        links = "; ".join(f"{link}: {why}" for link, why in list(impossible.items())[:_LISTED])
        more = f"; and {len(impossible) - _LISTED} more" if len(impossible) > _LISTED else ""
        found.append((
            "inertias",
            f"No body can have the inertia that the file states for {len(impossible)} of its links. It is used as "
            f"it stands, for the torque is linear in it; correct it: {links}{more}.",
            (),
        ))  # fmt: skip
    if robot.facts["gravcomp"]:
        found.append((
            "gravcomp",
            f"The file has the simulator carry the weight of {_listed(robot.facts['gravcomp'])} (gravcomp). Drives of "
            "a robot carry it, so it is left out of the model.",
            (),
        ))  # fmt: skip
    if robot.facts["free"]:
        words = f"Bodies that float alone in the file's scene are left out: {_listed(robot.facts['free'])}."
        found.append(("free_objects", words, ()))
    if robot.file.left_out:
        words = f"Not read, as the torque of the bodies does not need it: {_listed(robot.file.left_out)}."
        found.append(("left_out", words, ()))
    return found


def _of_joints(robot: RobotModel, names: Sequence[str]) -> list[_Fact]:
    found: list[_Fact] = []
    bare = [
        joint.name for joint in robot.chosen(tuple(names)) if not (joint.coulomb or joint.damping or joint.armature)
    ]
    if bare:
        words = (
            f"The file states no friction, no damping and no armature for {_listed(bare)}: what is found of them is "
            "new to the model."
        )
        found.append(("no_friction", words, bare))
    zero = [name for name in robot.file.zero_limits if name in names]
    if zero:
        words = f"An effort or a range of 0 in the file is read as no limit: {_listed(zero)}."
        found.append(("zero_limits", words, zero))
    moved = robot.followers(names)
    for item in moved:
        words = (
            f"{item.joint} moves {item.ratio:.6g} times as far as {item.driver}, as the file couples them; its torque "
            f"is counted at {item.driver}."
        )
        found.append(("coupled", words, (item.driver,)))
    followers = {item.joint for item in moved}
    held = [name for name in robot.names if name not in followers and name not in names]
    held += [name for name in robot.file.others if name not in names]
    if held:
        words = f"Joints that are not in the log are held where the file has them: {_listed(held)}."
        found.append(("held", words, ()))
    return found


def _of_base(robot: RobotModel) -> list[_Fact]:
    gravity = robot.gravity
    if gravity == 0.0:
        return [("gravity", "The file has no gravity, so the model needs no torque to hold its weight.", ())]
    found: list[_Fact] = []
    if not _USUAL_GRAVITY[0] < gravity < _USUAL_GRAVITY[1]:
        found.append(("gravity", f"Gravity in the file is {gravity:.4g} m/s².", ()))
    body, angle = robot.tilt()
    if angle > _UPRIGHT:
        words = f"In the file the z axis of the base ({body}) is tilted against gravity by {np.degrees(angle):.3g}°."
        found.append(("tilted_base", words, ()))
    return found
