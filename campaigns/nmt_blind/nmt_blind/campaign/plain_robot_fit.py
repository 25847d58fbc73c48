"""What plain least squares says of a robot's log, for comparison with the diagnosis.

For each joint Coulomb and viscous friction, armature and an offset are fitted to all rows of the torque that inverse
dynamics leaves over, with differences of the logged positions. A value is claimed beyond three standard uncertainties
of white noise and three tolerances of the model. Nothing is asked of the log.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nmt_blind.campaign.robot_case import Claims
from nmt_robots.log.robot_sidecar import read_robot_sidecar
from nmt_robots.mechanics.readings import DriveTorque, Reading
from nmt_robots.model.robot_model import RobotModel
from nmt_robots.thresholds import THRESHOLDS


def plain_claims(model: Path, log_file: Path) -> Claims:
    """Claims of the plain fit.

    Raises:
        BenchError: model or log cannot be read.
    """
    robot, log = RobotModel(model), read_robot_sidecar(log_file)
    step = log.step_s
    v = np.gradient(log.position, step, axis=0)
    a = np.gradient(v, step, axis=0)
    left = DriveTorque(log).torque(Reading()) - robot.torque(log.joints, log.position, v, a)
    terms, values = [], {}
    for number, joint in enumerate(robot.chosen(log.joints)):
        matrix = np.column_stack([np.sign(v[:, number]), v[:, number], a[:, number], np.ones(log.rows)])
        solution, *_ = np.linalg.lstsq(matrix, left[:, number], rcond=None)
        variance = float(np.mean((left[:, number] - matrix @ solution) ** 2))
        std = np.sqrt(variance * np.diag(np.linalg.pinv(matrix.T @ matrix)))
        believed = {
            "coulomb": (joint.coulomb, THRESHOLDS.coulomb_tolerance),
            "viscous": (joint.damping, THRESHOLDS.damping_tolerance),
            "armature": (joint.armature, THRESHOLDS.armature_tolerance),
        }
        found = []
        for place, (key, (value, tolerance)) in enumerate(believed.items()):
            difference = float(solution[place]) - value
            values[joint.name, key] = (float(solution[place]), float(std[place]))
            if abs(difference) > THRESHOLDS.certain * max(float(std[place]), tolerance * value):
                found.append((abs(difference) * float(np.std(matrix[:, place])), key))
        terms += [(joint.name, key) for _, key in sorted(found, reverse=True)]
    return Claims(tuple(terms), (), values)
