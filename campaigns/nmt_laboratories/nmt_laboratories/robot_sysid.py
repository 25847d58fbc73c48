"""What MuJoCo's own system identification leaves of a robot's log, next to the diagnosis.

``mujoco.sysid`` fits armature, damping and friction of each joint to positions and speeds of simulated windows, a fixed
structure. Both see the log before its last part and are judged in that part, which neither has seen: by the torque that
they leave, and by simulations of half a second from measured states. Needs ``pip install 'mujoco[sysid]'``. Run in
``./nmt shell``::

    python -m nmt_laboratories.robot_sysid ROBOT.xml LOG
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from nmt_laboratories.campaign_frame import command_parser
from nmt_robots.log.joint_log import Array, JointLog
from nmt_robots.mechanics.ladder import JointProblem, first_of_last_part
from nmt_robots.mechanics.readings import DriveSignals, DriveTorque, Reading
from nmt_robots.verdict.other_logs import diagnose_robot_by_logs
from nmt_robots.verdict.replay import replayed
from nmt_robots.verdict.robot_diagnosis import RobotDiagnosis

WINDOW_S = 1.0
"""Of a simulation that begins at the measured motion, s."""
COMPARED_S = 0.5
"""Of a simulation by which the models are compared, s."""
STEPS = 2
"""Of the simulation for each row of the log, at least 1 ms."""


def specification(robot: Path, log: JointLog, sensed: Sequence[str]) -> Any:
    """The robot on a base that stands still, with the law of its drives as actuators, and sensors of some joints."""
    spec = mujoco.MjSpec.from_string(robot.read_text())
    for geometry in list(spec.geoms):
        spec.delete(geometry)
    for kind in ("meshes", "skins", "textures", "hfields", "keys", "sensors", "actuators", "tendons"):
        for item in list(getattr(spec, kind, ())):
            spec.delete(item)
    for joint in list(spec.joints):
        if joint.type == mujoco.mjtJoint.mjJNT_FREE:
            spec.delete(joint)
    spec.option.timestep = max(log.step_s / STEPS, 1e-3)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert log.position_gain is not None
    assert log.velocity_gain is not None
    for number, name in enumerate(log.joints):
        kp, kd = float(log.position_gain[number]), float(log.velocity_gain[number])
        for part, gain, bias in (("q", kp, (0.0, -kp, -kd)), ("v", kd, (0.0, 0.0, 0.0)), ("t", 1.0, (0.0, 0.0, 0.0))):
            drive = spec.add_actuator(name=f"{part}_{name}", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            drive.gainprm[0] = gain
            drive.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            drive.biasprm[:3] = bias
    for name in sensed:
        spec.add_sensor(
            name=f"p_{name}", type=mujoco.mjtSensor.mjSENS_JOINTPOS, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=name
        )
        spec.add_sensor(
            name=f"s_{name}", type=mujoco.mjtSensor.mjSENS_JOINTVEL, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=name
        )
    return spec


def by_sysid(robot: Path, log: JointLog, rows: int) -> dict[str, dict[str, float]]:
    """Armature, damping and Coulomb friction of each joint by the first rows of a log."""
    from mujoco import sysid

    length = round(WINDOW_S / log.step_s)
    derived = np.gradient(log.position, log.step_s, axis=0)
    speed = derived if log.velocity is None else log.velocity
    firsts = range(0, rows - length, length)
    # Residuals are over the size of what was measured in their window: of a joint at zero there is none.
    moves = [
        min(float(np.std(part[first : first + length, number])) for first in firsts for part in (log.position, speed))
        > 1e-6
        for number in range(len(log.joints))
    ]
    spec = specification(robot, log, [name for name, moving in zip(log.joints, moves, strict=True) if moving])
    model = spec.compile()
    names = [model.joint(number).name for number in range(model.njnt)]
    columns = [log.joints.index(name) for name in names]
    command = [log.position_command, log.velocity_command, log.torque_command]
    control = np.stack([np.zeros_like(log.position) if part is None else part for part in command], axis=2)
    control = control.reshape(log.rows, -1)
    sensors = np.stack([log.position, speed], axis=2)[:, moves].reshape(log.rows, -1)
    starts, controls, measured = [], [], []
    for begin in firsts:
        part = slice(begin, begin + length)
        at = np.arange(length) * log.step_s
        starts.append(sysid.create_initial_state(model, log.position[begin, columns], speed[begin, columns]))
        controls.append(sysid.TimeSeries(at, control[part]))
        measured.append(sysid.TimeSeries.from_names(at, sensors[part], model))
    parameters = sysid.ParameterDict()
    for joint in spec.joints:
        for key, least, most in (("armature", 1e-5, 1.0), ("damping", 0.0, 20.0), ("frictionloss", 0.0, 20.0)):
            first = float(np.max(np.ravel(getattr(joint, key)), initial=0.0))

            def put(changed: Any, parameter: Any, name: str = joint.name, key: str = key) -> None:
                target, value = changed.joint(name), float(parameter.value[0])
                if key == "damping" and np.ndim(getattr(target, key)):
                    target.damping[0] = value
                else:
                    setattr(target, key, value)

            parameters.add(
                sysid.Parameter(
                    f"{joint.name}/{key}", nominal=min(max(first, least + 1e-2), most), min_value=least,
                    max_value=most, modifier=put,
                )
            )  # fmt: skip
    numbered = [str(number) for number in range(len(starts))]
    sequences = sysid.ModelSequences("robot", spec, numbered, starts, controls, measured)
    residual = sysid.build_residual_fn(models_sequences=[sequences])
    found, _ = sysid.optimize(
        initial_params=parameters, residual_fn=residual, optimizer="mujoco", max_iters=30, verbose=False
    )
    unseen = {name for name, moving in zip(log.joints, moves, strict=True) if not moving}
    return {
        joint.name: {
            "armature": float(found[f"{joint.name}/armature"].value[0]),
            "viscous": float(found[f"{joint.name}/damping"].value[0]),
            "coulomb": float(found[f"{joint.name}/frictionloss"].value[0]),
        }
        for joint in spec.joints
        if joint.name not in unseen
    }


def left_of_last_part(diagnosis: RobotDiagnosis, number: int, drive: DriveSignals, values: dict[str, float]) -> float:
    """Torque that a joint's values leave in the last part, rms, N·m; its constant offset is that of the rows before."""
    problem = JointProblem(diagnosis.motion, number, drive, diagnosis.log.joints)
    left: Array = problem.left.copy()
    for effect in problem.usual:
        if effect.key in values:
            left -= problem.columns([effect])[:, 0] * values[effect.key]
    rows = np.flatnonzero(problem.rows)
    late = rows >= first_of_last_part(diagnosis.motion)
    return float(np.sqrt(np.mean((left[late] - np.mean(left[~late])) ** 2)))


def windows(diagnosis: RobotDiagnosis, values: dict[str, dict[str, float]]) -> list[tuple[str, Array, float]]:
    """Rms error of joints (rad, m) and tool (m) at the end of windows: as given, as changed and by sysid."""
    replay = diagnosis.replay
    assert replay is not None
    with_values = []
    for verdict in diagnosis.joints:
        joint = verdict.joint
        found = values.get(joint.name, {})
        joint = replace(
            joint, armature=found.get("armature", joint.armature), damping=found.get("viscous", joint.damping),
            coulomb=found.get("coulomb", joint.coulomb),
        )  # fmt: skip
        with_values.append(replace(verdict, mechanics=None, terms=(), joint=joint))
    original = diagnosis.model, diagnosis.log if diagnosis.as_given is None else diagnosis.as_given[0]
    other = replayed(original, original, diagnosis.motion, diagnosis.as_well, with_values, ())
    models = [*replay.models, ("by sysid", other.by_model)]
    return [(words, *replay.after(predicted, COMPARED_S)) for words, predicted in models]


def main() -> None:
    """Diagnose a log, identify the same by sysid, and print what each leaves of every joint."""
    parser = command_parser(__doc__)
    parser.add_argument("robot", type=Path)
    parser.add_argument("log", type=Path)
    asked = parser.parse_args()
    diagnosis = diagnose_robot_by_logs(asked.robot, [asked.log])
    begun = time.process_time()
    found = by_sysid(asked.robot, diagnosis.log, first_of_last_part(diagnosis.motion))
    seconds = time.process_time() - begun
    drive = DriveTorque(diagnosis.log)
    plain, chosen = drive.signals(Reading()), drive.signals(diagnosis.reading)
    print(f"torque left in the last part, N·m rms; sysid took {seconds:.0f} s of processor time")
    print(f"{'joint':>20} {'plain':>8} {'sysid':>8} {'sysid, as read':>15} {'diagnosis':>10}")
    every = []
    for number, (name, verdict) in enumerate(zip(diagnosis.log.joints, diagnosis.joints, strict=True)):
        if verdict.mechanics is None or name not in found:
            continue
        row = [
            verdict.last_plain,
            *(left_of_last_part(diagnosis, number, part.of(number), found[name]) for part in (plain, chosen)),
            verdict.last,
        ]
        every.append(row)
        print(f"{name:>20} {row[0]:8.4f} {row[1]:8.4f} {row[2]:15.4f} {row[3]:10.4f}")
    rms = np.sqrt(np.mean(np.square(every), axis=0))
    better = int(np.sum(np.array(every)[:, 3] < np.min(np.array(every)[:, 1:3], axis=1)))
    print(f"{'rms':>20} {rms[0]:8.4f} {rms[1]:8.4f} {rms[2]:15.4f} {rms[3]:10.4f}; better in {better} of {len(every)}")
    print(f"windows of {COMPARED_S:g} s in the last part, rms at their end")
    for words, joints, tool in windows(diagnosis, found):
        print(f"{words:>20} joints {1e3 * float(np.sqrt(np.mean(joints**2))):8.2f} mrad, tool {1e3 * tool:8.2f} mm")


if __name__ == "__main__":
    main()
