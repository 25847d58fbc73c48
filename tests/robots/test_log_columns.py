"""Columns of a robot's log by many names, in many units and files: read right, or the question that settles it.

Each kind of log is made from a motion in closed form, so that what must be read is known; a case is right where the
log that the proposed sidecar makes is that motion, and asked where the sidecar has a question.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

from nmt_core.errors import BenchError

pytest.importorskip("mujoco", reason="mujoco is not installed: robots are not tested")

from nmt_robots.log.proposal import propose_sidecar
from nmt_robots.log.robot_sidecar import read_robot_sidecar

Random = np.random.Generator
# Each robot is compiled once in a process: what is compiled is kept by path and text.
_FOLDER = TemporaryDirectory()
_ROBOTS = (
    ("pan", "lift", "elbow"),
    ("panda_joint1", "panda_joint2", "panda_joint3", "panda_joint4", "panda_joint5", "panda_joint6"),
    ("FL_hip_joint", "FL_thigh_joint", "FL_calf_joint", "RR_hip_joint"),
    ("shoulder_pan", "wrist_1"),
)
_DEGREE = np.pi / 180.0


@dataclass(eq=False)
class Case:
    """A robot, what its joints did, and where its log is."""

    joints: tuple[str, ...]
    turns: np.ndarray[Any, Any]
    time: np.ndarray[Any, Any]
    position: np.ndarray[Any, Any]
    velocity: np.ndarray[Any, Any]
    command: np.ndarray[Any, Any]
    torque: np.ndarray[Any, Any]
    robot: Path
    log: Path = field(default_factory=Path)

    @property
    def count(self) -> int:
        """J."""
        return len(self.joints)


def motion(random: Random, folder: Path, slides: bool = False, reach: float = 1.0, rows: int = 200) -> Case:
    """A robot of two to six joints, and a motion of it."""
    joints = _ROBOTS[random.integers(len(_ROBOTS))]
    count = len(joints)
    turns = np.ones(count, dtype=bool)
    turns[-1] = not slides
    rate = float(random.choice([50.0, 100.0, 200.0, 250.0, 500.0]))
    time = np.arange(rows) / rate
    phase = 2.0 * np.pi * random.uniform(0.8, 2.5, count) * time[:, None] / time[-1] * 3.0 + random.uniform(0, 6, count)
    size = np.where(turns, reach * random.uniform(0.4, 1.0, count), random.uniform(0.04, 0.1, count))
    rates = (phase[1] - phase[0]) * rate
    position = size * np.sin(phase) + np.where(turns, 0.2 * reach, 0.02)
    velocity = size * rates * np.cos(phase)
    torque = 2.0 * np.sign(velocity) + 5.0 * position + random.normal(0.0, 0.01, position.shape)
    command = position + 0.02 * size * np.cos(0.7 * phase)
    bodies, tail = "", ""
    for name, is_turn in zip(joints, turns, strict=True):
        kind, limits = ("hinge", "-2.6 2.6") if is_turn else ("slide", "-0.2 0.2")
        bodies += f'<body pos="0 0 0.1"><joint name="{name}" type="{kind}" axis="0 1 0" range="{limits}"/>'
        bodies += '<inertial pos="0.05 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>'
        tail += "</body>"
    robot = Path(_FOLDER.name) / f"{joints[0]}{'_slide' * slides}.xml"
    robot.write_text(
        f'<mujoco><compiler angle="radian" autolimits="true"/><worldbody>{bodies}{tail}</worldbody></mujoco>'
    )
    return Case(joints, turns, time, position, velocity, command, torque, robot)


def one_of(random: Random, *items: Any) -> Any:
    """One of some items."""
    return items[random.integers(len(items))]


def table(case: Case, folder: Path, heads: list[str], columns: list[Any], random: Random) -> Path:
    """The columns as a table of text, in any order."""
    order = [0, *(1 + random.permutation(len(heads) - 1))]
    path = folder / "log.csv"
    values = np.column_stack([columns[number] for number in order])
    np.savetxt(path, values, delimiter=",", header=",".join(heads[number] for number in order), comments="", fmt="%.9g")
    return path


def zero_effort(random: Random, folder: Path) -> Case:
    """Efforts, and perhaps speeds, that are 0 or no number in every row."""
    case = motion(random, folder)
    word = one_of(random, "effort", "torque", "tau", "current")
    value = one_of(random, 0.0, np.nan)
    columns: dict[str, Any] = {"time": case.time, "position": case.position, "position_cmd": case.command}
    columns |= {word: np.full(case.position.shape, value)}
    if random.random() < 0.5:
        columns["velocity"] = np.full(case.position.shape, 0.0)
    columns["joint_names"] = np.array(case.joints)
    np.savez(folder / "log.npz", **columns)
    case.torque = np.zeros((0, 0))
    case.log = folder / "log.npz"
    return case


def units_by_heading(random: Random, folder: Path, reach: float = 1.0, slides: bool = True) -> Case:
    """A unit for each joint, stated by the headings in one of many spellings."""
    case = motion(random, folder, slides=slides and random.random() < 0.7, reach=reach)
    style = int(random.integers(4))
    angle = one_of(random, ("rad", 1.0), ("deg", _DEGREE), ("turn", 2.0 * np.pi))
    spellings = {"rad": ("rad", "rad/s"), "deg": one_of(random, ("deg", "deg/s"), ("degrees", "dps")),
                 "turn": ("rev", one_of(random, "rpm", "rev/s"))}  # fmt: skip
    factors = {"rad/s": 1.0, "deg/s": _DEGREE, "dps": _DEGREE, "rpm": np.pi / 30.0, "rev/s": 2.0 * np.pi, "mm/s": 1e-3,
               "m/s": 1.0}  # fmt: skip
    slide = one_of(random, ("mm", 1e-3), ("m", 1.0))
    force = one_of(random, True, False)
    words = one_of(random, ("pos", "vel", "torque"), ("position", "velocity", "effort"), ("angle", "speed", "tau"))
    heads, columns = [one_of(random, "time [s]", "time_s", "t (s)")], [case.time]
    for number, name in enumerate(case.joints):
        turns = case.turns[number]
        unit, factor = angle if turns else slide
        text, rate = spellings[unit] if turns else (unit, f"{unit}/s")
        load = ("Nm" if turns else "N") if style != 3 else ""
        last = "force" if not turns and force else words[2]
        for word, stated in ((words[0], text), (words[1], rate), (last, load)):
            plain = stated.replace("/", "_") if style == 1 else stated
            ending = (f" [{stated}]", f"_{plain}", f" ({stated})", f" ({stated})")[style] if stated else ""
            heads.append(f"{name}_{word}{ending}")
        columns += [case.position[:, number] / factor, case.velocity[:, number] / factors[rate], case.torque[:, number]]
    if style == 1 and slide[0] == "m" and not all(case.turns):
        heads = [head.removesuffix("_m") for head in heads]
    case.command = np.zeros((0, 0))
    case.log = table(case, folder, heads, columns, random)
    return case


def small_degrees(random: Random, folder: Path) -> Case:
    """Headings in degrees of a motion that is as small as one in radians."""
    return units_by_heading(random, folder, reach=0.05, slides=False)


def union(random: Random, folder: Path) -> Case:
    """Topics with clocks of their own in the rows of one table, blanks where a topic has no message."""
    case = motion(random, folder)
    step = case.time[1]
    every = int(random.integers(1, 4))
    late = random.uniform(0.1, 0.9) * step
    words = one_of(random, ("position", "velocity", "effort"), ("pos", "vel", "torque"))
    heads = ["__time"] + [f"/joint_states/{name}/{word}" for name in case.joints for word in words]
    numbered = one_of(random, True, False)
    heads += [f"/ctl/reference/positions[{n}]" if numbered else f"/ctl/reference/{name}/position"
              for n, name in enumerate(case.joints)]  # fmt: skip
    extra = random.random() < 0.5
    if extra:
        heads.append("/diagnostics/temperature")
    rows = []
    for row, at in enumerate(case.time):
        values = np.column_stack([case.position[row], case.velocity[row], case.torque[row]]).ravel()
        rows.append((at, ",".join(f"{v:.9f}" for v in values) + "," * case.count + "," * extra))
        if row % every == 0:
            commands = ",".join(f"{v:.9f}" for v in case.command[row])
            rows.append((at + late, "," * (3 * case.count) + commands + "," * extra))
        if extra and row % 10 == 0:
            rows.append((at + 0.95 * step, "," * (4 * case.count) + "30"))
    rows.sort()
    begin = one_of(random, 0.0, 1.7e9)
    text = ",".join(heads) + "\n" + "".join(f"{begin + at:.6f},{line}\n" for at, line in rows)
    case.log = folder / "log.csv"
    case.log.write_text(text)
    case.command = np.zeros((0, 0))
    return case


def numbered(random: Random, folder: Path) -> Case:
    """Columns with numbers in the place of joints, as controllers of legged robots and motors write them."""
    case = motion(random, folder)
    first = int(random.integers(2))
    form = one_of(random, "{w}_{n}", "{w}{n}", "{w}[{n}]", "motor_state[{n}].{w}", "m{n}_{w}", "motor{n}/{w}")
    words = one_of(
        random, ("q", "dq", "tau_est", "q_des"), ("pos", "vel", "torque", "pos_cmd"), ("q", "qd", "tau", "q_d")
    )
    spare = int(random.integers(3)) if "motor" in form else 0
    heads, columns = ["time"], [case.time]
    for number in range(case.count + spare):
        for word, values in zip(words, (case.position, case.velocity, case.torque, case.command), strict=True):
            heads.append(form.format(w=word, n=number + first))
            columns.append(values[:, number] if number < case.count else 0.0 * case.time)
        heads.append(form.format(w="temperature", n=number + first))
        columns.append(30.0 + 0.0 * case.time)
    case.log = table(case, folder, heads, columns, random)
    return case


def hdf5_episode(random: Random, folder: Path) -> Case:
    """Arrays of an episode, with or without a clock."""
    import h5py

    case = motion(random, folder)
    with h5py.File(folder / "episode_0.hdf5", "w") as file:
        group = file.create_group(one_of(random, "observations", "obs", "observation"))
        names = one_of(random, ("qpos", "qvel", "effort"), ("position", "velocity", "torque"), ("q", "dq", "tau"))
        for name, values in zip(names, (case.position, case.velocity, case.torque), strict=True):
            group[name] = values
        file["action"] = case.command
        if random.random() < 0.5:
            group[one_of(random, "time", "timestamp", "t")] = case.time
        if random.random() < 0.3:
            group["images"] = np.zeros((len(case.time), 4, 4, 3), dtype=np.uint8)
    case.log = folder / "episode_0.hdf5"
    return case


def array_command(random: Random, folder: Path) -> Case:
    """An array command beside position; of positions, of speeds, or of something else."""
    case = motion(random, folder)
    word = one_of(random, "command", "cmd", "action", "target", "setpoint", "joint_command", "goal")
    of = one_of(random, "position", "other")
    values = case.command if of == "position" else random.normal(0.0, 1.0, case.position.shape)
    columns: dict[str, Any] = {
        "time": case.time,
        one_of(random, "position", "q", "dof_pos"): case.position,
        word: values,
    }
    if random.random() < 0.5:
        columns[one_of(random, "velocity", "dq")] = case.velocity
    columns |= {"kp": np.full(case.count, 30.0), "kd": np.full(case.count, 1.0)}
    np.savez(folder / "log.npz", **columns)
    case.torque = np.zeros((0, 0))
    if of == "other":
        case.command = np.zeros((0, 0))
    case.log = folder / "log.npz"
    return case


def commands_by_name(random: Random, folder: Path) -> Case:
    """Commands that are called otherwise than the positions, such as cmd_hip and q_des."""
    case = motion(random, folder)
    forms = one_of(
        random, ("{j}", "cmd_{j}"), ("{j}_pos", "{j}_des"), ("q_{j}", "q_des_{j}"), ("pos_{j}", "act_{j}_target"),
        ("state_{j}_pos", "target_{j}_pos"), ("{j}.position", "{j}.command"),
    )  # fmt: skip
    if forms[0] == "{j}":
        forms = ("{j}_angle", forms[1])
    heads = [one_of(random, "time", "t", "stamp")]
    columns = [case.time]
    for number, name in enumerate(case.joints):
        heads += [form.format(j=name) for form in forms]
        columns += [case.position[:, number], case.command[:, number]]
    case.log = table(case, folder, heads, columns, random)
    case.torque = np.zeros((0, 0))
    return case


def units_by_speed(random: Random, folder: Path) -> Case:
    """No heading states a unit, or one of two; the other follows from the speed."""
    case = motion(random, folder)
    angle, rate = one_of(
        random, (1.0, 1.0), (_DEGREE, 1.0), (1.0, _DEGREE), (2.0 * np.pi, 2.0 * np.pi / 60.0), (_DEGREE, _DEGREE),
        (2.0 * np.pi, 1.0),
    )  # fmt: skip
    gear = one_of(random, 1.0, 1.0, 9.0)
    heads = ["time"] + [f"{name}_{word}" for name in case.joints for word in ("pos", "vel", "torque")]
    columns = [case.time]
    for n in range(case.count):
        columns += [gear * case.position[:, n] / angle, gear * case.velocity[:, n] / rate, case.torque[:, n]]
    case.log = table(case, folder, heads, columns, random)
    case.command = np.zeros((0, 0))
    return case


def percent(random: Random, folder: Path) -> Case:
    """Positions in percent of a range, with a heading or without one."""
    case = motion(random, folder)
    full = 2.0 * np.max(np.abs(case.position))
    head = one_of(random, " [%]", "_percent", "")
    heads = ["time"] + [f"{name}_{word}" for name in case.joints for word in (f"pos{head}", "torque")]
    columns = [case.time]
    for n in range(case.count):
        columns += [100.0 * case.position[:, n] / full, case.torque[:, n]]
    case.log = table(case, folder, heads, columns, random)
    case.command = np.zeros((0, 0))
    return case


def contradicted(random: Random, folder: Path) -> Case:
    """Headings that the sizes contradict."""
    case = motion(random, folder, reach=1.5)
    if random.random() < 0.5:
        angle, rate, texts = _DEGREE, _DEGREE, ("rad", "rad/s")
    else:
        angle, rate, texts = 1.0, 1.0, ("rad", "deg/s")
    heads = ["time"]
    columns = [case.time]
    for number, name in enumerate(case.joints):
        heads += [f"{name}_pos [{texts[0]}]", f"{name}_vel [{texts[1]}]", f"{name}_torque [Nm]"]
        columns += [case.position[:, number] / angle, case.velocity[:, number] / rate, case.torque[:, number]]
    case.log = table(case, folder, heads, columns, random)
    case.command = np.zeros((0, 0))
    return case


def bag_clocks(random: Random, folder: Path) -> Case:
    """Messages of a robot with stamps that are not even, its commands in a topic of their own."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    case = motion(random, folder)
    store = get_typestore(Stores.ROS2_JAZZY)
    value = "string[] interface_names\nfloat64[] values\n"
    dynamic = "std_msgs/Header header\nstring[] joint_names\ncontrol_msgs/InterfaceValue[] interface_values\n"
    store.register({**get_types_from_msg(value, "control_msgs/msg/InterfaceValue"),
                    **get_types_from_msg(dynamic, "control_msgs/msg/DynamicJointState")})  # fmt: skip
    types = store.types
    state, each = "sensor_msgs/msg/JointState", "control_msgs/msg/InterfaceValue"
    step = float(case.time[1])
    case.time = case.time + np.r_[0.0, random.uniform(-0.3, 0.3, len(case.time) - 2) * step, 0.0]
    is_dynamic, order = random.random() < 0.5, random.permutation(case.count)
    names = [case.joints[number] for number in order]
    interfaces = ["position", "velocity", "effort"]
    with Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        kind = "control_msgs/msg/DynamicJointState" if is_dynamic else state
        states = bag.add_connection("/states", kind, typestore=store)
        commands = bag.add_connection("/joint_command", state, typestore=store)
        for row, at in enumerate(case.time):
            stamp = 1_764_064_800 * 10**9 + round(float(at) * 1e9)
            time = types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
            header = types["std_msgs/msg/Header"](time, "")
            rows = [values[row][order] for values in (case.position, case.velocity, case.torque)]
            if is_dynamic:
                parts = [types[each](interfaces, np.array(of_joint)) for of_joint in zip(*rows, strict=True)]
                message = types[kind](header, names, parts)
            else:
                message = types[kind](header, names, *rows)
            late = round(float(random.uniform(1e5, 4e5)))
            bag.write(states, stamp + late, store.serialize_cdr(message, kind))
            goal = types[state](header, names, case.command[row][order], np.zeros(0), np.zeros(0))
            bag.write(commands, stamp + late, store.serialize_cdr(goal, state))
    case.log = folder / "bag"
    return case


KINDS: tuple[Callable[[Random, Path], Case], ...] = (
    zero_effort, units_by_heading, small_degrees, union, numbered, hdf5_episode, array_command, commands_by_name,
    units_by_speed, percent, contradicted, bag_clocks,
)  # fmt: skip


def answered(case: Case, text: str) -> str:
    """A proposed sidecar with the answers that somebody who made the log knows."""
    rate = (len(case.time) - 1) / float(case.time[-1])
    joints = f"joints: [{', '.join(case.joints)}]"
    return (
        text.replace("joints: '?'", joints).replace("rate_hz: '?'", f"rate_hz: {rate!r}")
        .replace("kp: '?'", "kp: 30.0").replace("kd: '?'", "kd: 1.0")
    )  # fmt: skip


def outcome(case: Case) -> str:
    """``right``, ``asked: …`` (right with the answers, where they are known) or ``refused: …``; else what is wrong."""
    sidecar = case.log.parent / "log.yaml"
    try:
        proposal = propose_sidecar(case.log, case.robot, case.log.parent)
        text = answered(case, proposal.text)
        if "'?'" in text:
            return f"asked: {'; '.join(proposal.questions)}"
        sidecar.write_text(text)
        log = read_robot_sidecar(sidecar)
    except BenchError as error:
        return f"refused: {error}"
    order = [log.joints.index(name) for name in case.joints]
    pairs = (("position", case.position), ("velocity", case.velocity), ("torque", case.torque),
             ("position_command", case.command))  # fmt: skip
    if log.rows != len(case.time) or not np.allclose(log.time, case.time, atol=2e-6):
        return f"the clock is wrong: {log.rows} rows, {log.step_s} s"
    for name, truth in pairs:
        values = getattr(log, name)
        if values is None:
            if name in ("torque", "position_command") and truth.size and log.torque is None:
                return f"{name} was not read: {proposal.text}"
            continue
        if not truth.size:
            if name == "torque":
                return f"{name} was read although there is none: {proposal.text}"
            continue
        if not np.allclose(values[:, order], truth, atol=1e-5 * float(np.max(np.abs(truth)))):
            return f"{name} is wrong: {proposal.text}"
    return f"asked: {'; '.join(proposal.questions)}" if proposal.questions else "right"


def outcomes(kind: Callable[[Random, Path], Case], count: int, folder: Path) -> list[str]:
    """How the reading of variants of a kind ends."""
    found = []
    for number in range(count):
        random = np.random.default_rng([71, *kind.__name__.encode(), number])
        place = folder / f"{kind.__name__}{number}"
        place.mkdir()
        found.append(outcome(kind(random, place)))
    return found


@pytest.mark.parametrize(
    ("kind", "count"),
    [*((kind, 3) for kind in KINDS), *(pytest.param(kind, 100, marks=pytest.mark.campaign) for kind in KINDS)],
)
def test_a_log_is_read_right_or_the_question_is_asked(
    tmp_path: Path, kind: Callable[[Random, Path], Case], count: int
) -> None:
    ends = outcomes(kind, count, tmp_path)
    wrong = [end for end in ends if not end.startswith(("right", "asked"))]
    assert not wrong, f"{len(wrong)} of {count}: {wrong[0]}"


def test_each_fault_of_a_log_is_one_sentence(tmp_path: Path) -> None:
    case = motion(np.random.default_rng(3), tmp_path)
    joints = ", ".join(case.joints)
    head = f"robot_log: 1\ndata: log.npz\njoints: [{joints}]\ntime: {{column: time}}\n"
    body = "position: {column: position}\nvelocity: {column: velocity}\ntorque: {column: torque}\n"
    columns: dict[str, Any] = {"time": case.time, "position": case.position, "velocity": case.velocity,
                               "torque": case.torque}  # fmt: skip
    huge = case.position.copy()
    huge[7, 1] = 1e300
    hole = case.position.copy()
    hole[9, 0] = np.nan
    for changed, sidecar, words in (
        ({"position": huge}, head + body, "no possible value (1e+300 in SI units) in row 8"),
        ({"position": hole}, head + body, "no number in row 10"),
        ({"torque": 0.0 * case.torque}, head + body, "is the same in all rows, so it is not a reading"),
        ({"position": 0.0 * case.position + 0.3}, head + body, "no joint moves"),
        ({"time": case.time * np.nan}, head + body, "no number in row 1"),
        ({}, head.replace(case.joints[1], case.joints[0], 1) + body, f"names the joint {case.joints[0]} twice"),
        ({}, head + body.replace("position}", "position, gear: 0.0}"), "position.gear is 0"),
        ({}, head + body.replace("position}", "position, unit: percent}"), "give position.full_scale"),
        ({}, head + body.replace("column: torque", "column: [torque]"), "name a column of N values each"),
        ({"torque": case.torque[:-1]}, head + body, "they must have as many"),
        ({"kp": np.zeros(1)}, head + body.split("torque")[0] + "command: {position: velocity}\ngains: {kp: kp}\n",
         "the drives' law makes no torque"),
    ):  # fmt: skip
        np.savez(tmp_path / "log.npz", **{**columns, **changed})
        (tmp_path / "log.yaml").write_text(sidecar)
        with pytest.raises(BenchError) as refusal:
            read_robot_sidecar(tmp_path / "log.yaml")
        assert words in str(refusal.value)


def test_the_gains_of_the_model_are_offered_where_the_log_has_none(tmp_path: Path) -> None:
    case = commands_by_name(np.random.default_rng(5), tmp_path)
    first = case.joints[0]
    drive = f'<actuator><position joint="{first}" kp="90" kv="3" gear="2"/></actuator></mujoco>'
    robot = tmp_path / "with_drives.xml"
    robot.write_text(case.robot.read_text().replace("</mujoco>", drive))
    (question,) = propose_sidecar(case.log, robot, tmp_path).questions
    assert f"the model states {first} 360 and 12" in question


def test_the_value_of_a_joint_by_sign_zero_unit_and_gear(tmp_path: Path) -> None:
    case = motion(np.random.default_rng(4), tmp_path)
    counts = 2048.0 - 4096.0 * 9.0 * case.position / (2.0 * np.pi)
    np.savez(tmp_path / "log.npz", time=case.time, counts=counts, torque=case.torque)
    (tmp_path / "log.yaml").write_text(
        f"robot_log: 1\ndata: log.npz\njoints: [{', '.join(case.joints)}]\ntime: {{column: time}}\n"
        "position: {column: counts, unit: turn, gear: 36864.0, zero: 2048.0, sign: SIGNS}\n"
        "torque: {column: torque}\n".replace("SIGNS", str([-1] * case.count))
    )
    log = read_robot_sidecar(tmp_path / "log.yaml")
    np.testing.assert_allclose(log.position, case.position, atol=1e-9)
