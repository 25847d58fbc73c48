"""A trajectory of joints as a table, and as a ``trajectory_msgs/JointTrajectory`` in YAML."""

from __future__ import annotations

import numpy as np

from nmt_core.files.whole_file import csv_text
from nmt_core.files.yaml_text import yaml_text
from nmt_robots.verdict.next_motion import STEP_S, NextMotion


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
