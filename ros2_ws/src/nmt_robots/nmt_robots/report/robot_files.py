"""Files of a robot's diagnosis: answers, page, changed model, next motion, and joints that are meant to be alike."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from nmt_core.bench_version import bench_version
from nmt_core.files.plain_json import plain_json
from nmt_core.files.whole_file import csv_text, write_result
from nmt_core.files.yaml_text import yaml_text
from nmt_report.group_report import group_page
from nmt_robots.report.robot_page import robot_page
from nmt_robots.report.written_back import changes, robot_text
from nmt_robots.verdict.next_motion import STEP_S, NextMotion
from nmt_robots.verdict.robot_diagnosis import RobotDiagnosis

JOINT_COLUMNS = (
    "joint", "cause", "value", "value_std", "unit", "in_model", "torque_rms", "left_as_logged", "left_by_model",
    "left_by_plain_fit", "left", "closed", "last_part_plain", "last_part", "remains",
)  # fmt: skip


def write_robot_diagnosis(diagnosis: RobotDiagnosis, folder: Path) -> None:
    """Write all files to a folder that exists.

    Raises:
        BenchError: one cannot be written.
    """
    mapping = {**diagnosis.to_mapping(), "version": f"nmt {bench_version()}".strip()}
    write_result(folder / "diagnosis.json", json.dumps(plain_json(mapping), indent=1, ensure_ascii=False) + "\n")
    write_result(folder / "joints.csv", joints_csv(diagnosis))
    changed = changes(diagnosis)
    write_result(folder / diagnosis.model.path.with_stem("robot").name, robot_text(diagnosis, changed))
    heads = ("joint", "term", "value", "std", "unit", "in_model", "one_class_with", "written_to_robot_file")
    rows = [
        (item.joint, item.key, f"{item.value:.6g}", f"{item.std:.2g}", item.unit, f"{item.in_model:.6g}",
         "; ".join(item.alike), "yes" if item.attribute else "no word for it")
        for item in changed
    ]  # fmt: skip
    write_result(folder / "changes.csv", csv_text([heads, *rows]))
    write_result(folder / "trajectory.csv", trajectory_csv(diagnosis.next))
    write_result(folder / "trajectory.yaml", joint_trajectory(diagnosis.next))
    write_result(folder / "report.html", robot_page(diagnosis))
    if diagnosis.group is not None:
        title = f"Joints of {diagnosis.model.path.stem} that are meant to be alike"
        write_result(folder / "units.html", group_page(title, "", diagnosis.group, [("the robot", "report.html")]))


def joints_csv(diagnosis: RobotDiagnosis) -> str:
    """A row for each joint."""
    rows: list[tuple[object, ...]] = [JOINT_COLUMNS]
    for joint in diagnosis.joints:
        first = next((term for term in joint.terms if term.differs), None)
        value = ("", "", "", "") if first is None else (
            f"{first.value:.6g}", f"{first.std:.2g}", first.unit, f"{first.in_model:.6g}"
        )  # fmt: skip
        numbers = (
            joint.torque, joint.as_logged, joint.unchanged, joint.plain, joint.left, joint.closed, joint.last_plain,
            joint.last,
        )  # fmt: skip
        rows.append((joint.joint.name, joint.cause, *value, *(f"{x:.4g}" for x in numbers), joint.remains))
    return csv_text(rows)


def trajectory_csv(motion: NextMotion) -> str:
    """A row for each point: time in s, the part's kind, position of each joint in rad (m of a slide)."""
    rows: list[tuple[object, ...]] = [("time", "part", *motion.joints)]
    rows += [
        (f"{time:.3f}", motion.requests[part].kind, *(f"{x:.6f}" for x in position))
        for time, part, position in zip(motion.time, motion.part, motion.position, strict=True)
    ]
    return csv_text(rows)


def joint_trajectory(motion: NextMotion) -> str:
    """The message's fields in YAML, as ``ros2 topic pub`` takes them; the first point is reached in 3 s."""
    speeds = np.gradient(motion.position, STEP_S, axis=0)
    names = yaml_text({"joint_names": list(motion.joints)})
    points = []
    for time, position, speed in zip(motion.time, motion.position, speeds, strict=True):
        nanoseconds = round((time + 3.0) * 1e9)
        seconds, part = divmod(nanoseconds, 10**9)
        angles, rates = (", ".join(f"{x:.6f}" for x in values) for values in (position, speed))
        reached = f"{{sec: {seconds}, nanosec: {part}}}"
        points.append(f"- {{positions: [{angles}], velocities: [{rates}], time_from_start: {reached}}}\n")
    return f"{names}points:\n{''.join(points)}"
