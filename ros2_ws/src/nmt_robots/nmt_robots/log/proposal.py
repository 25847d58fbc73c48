"""A sidecar proposed from the names of the columns and a robot's joints."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.yaml_text import yaml_text
from nmt_robots.log.columns_of_file import STAMP, read_columns
from nmt_robots.log.joint_log import Array
from nmt_robots.log.robot_sidecar import Columns
from nmt_robots.model.robot_model import RobotModel
from nmt_robots.thresholds import THRESHOLDS


def _listed(words: str) -> frozenset[str]:
    return frozenset(words.split())


_COMMAND = _listed("des desired cmd command commands target tgt ref reference goal setpoint action sp")
_MEASURED = _listed("actual meas measured feedback state states act")
_POSITION = _listed("pos position positions q qpos angle angles theta")
_SPEED = _listed("vel velocity velocities dq qvel qdot speed speeds omega")
_TORQUE = _listed("torque torques tau effort efforts trq")
_CURRENT = _listed("current currents amp amps iq")
_TIME = _listed("t time times stamp timestamp timestamps sec secs seconds")
_KP = _listed("kp stiffness pgain")
_KD = _listed("kd dgain")
_NAMES = _listed("names name joints")


@dataclass(frozen=True)
class Proposal:
    """A sidecar and what was noticed while it was made.

    Attributes:
        text: YAML.
        questions: what its reader must answer.
    """

    text: str
    questions: tuple[str, ...]


def propose_sidecar(data: Path, robot: Path, folder: Path) -> Proposal:
    """A sidecar for a log.

    Args:
        data: the log.
        robot: MJCF or URDF file.
        folder: where the sidecar will be; paths in it are relative to that.

    Raises:
        BenchError: one of them cannot be read, or no column is a position.
    """
    model = RobotModel(robot)
    columns = read_columns(data)
    words = {name: _words(name) for name in columns}
    joints, remarks, questions = _joints(columns, model)
    count = len(joints)
    chosen: dict[str, Columns] = {}
    for quantity in _QUANTITIES:
        found = _column_of(quantity, words, columns, joints)
        if found is not None:
            chosen[quantity] = found
    if "position" not in chosen:
        raise BenchError(
            f"{data} has no column of {count} joint positions by its name; its columns are "
            f"{', '.join(list(columns)[:40])}. Write the sidecar by hand (robot_log: 1, data, joints, time, position)."
        )
    position = _stacked(columns, chosen["position"])
    sidecar: dict[str, Any] = {
        "robot_log": 1,
        "data": _relative(data, folder),
        "robot": _relative(robot, folder),
        "joints": list(joints),
        "time": _time(columns, words, questions),
    }
    angle = _angle_unit(position, model, joints)
    sidecar["position"] = {"column": chosen["position"], "unit": angle}
    if "velocity" in chosen:
        sidecar["velocity"] = {"column": chosen["velocity"], "unit": f"{angle}/s"}
    gains = {key: values for key in ("kp", "kd") if (values := _gain(key, words, columns, count)) is not None}
    command = {
        key: chosen[f"{key} command"] for key in ("position", "velocity", "torque") if f"{key} command" in chosen
    }
    torque = chosen.get("torque")
    if gains and "position" in command:
        law = _Law(columns, chosen, gains, count)
        for key, column in (("command", command.get("torque")), ("measured", torque)):
            if column is not None and law.gives(column):
                remarks.append(f"{column} is the control law of the drives itself, so it is no {key} torque.")
                if key == "command":
                    command.pop("torque")
                else:
                    torque = None
    if command:
        sidecar["command"] = command
    if "kp" in gains:
        sidecar["gains"] = gains
    if torque is not None:
        sidecar["torque"] = {"column": torque}
    elif "current" in chosen and "kp" not in gains:
        sidecar["torque"] = {"column": chosen["current"], "constant": "?", "gear": "?"}
        questions.append("torque.constant (N·m/A) and torque.gear of the currents")
    elif "kp" not in gains:
        sidecar["gains"] = {"kp": "?", "kd": "?"}
        questions.append("gains.kp and gains.kd of the drives (N·m/rad, N·m·s/rad): no torque was measured")
    text = "".join(f"# {line}\n" for line in remarks) + yaml_text(sidecar)
    return Proposal(text, tuple(questions))


_QUANTITIES = {
    "position": (_POSITION, False),
    "velocity": (_SPEED, False),
    "torque": (_TORQUE, False),
    "current": (_CURRENT, False),
    "position command": (_POSITION, True),
    "velocity command": (_SPEED, True),
    "torque command": (_TORQUE, True),
}


def _words(name: str) -> frozenset[str]:
    """Words of a column's name."""
    parted = re.sub(r"([a-z])([A-Z])", r"\1 \2", name)
    return frozenset(word for word in re.split(r"[^a-z]+", parted.lower()) if word)


def _joints(columns: dict[str, Array], model: RobotModel) -> tuple[tuple[str, ...], list[str], list[str]]:
    """Names of the joints, remarks and questions."""
    for name, values in columns.items():
        if values.dtype.kind in "US" and _words(name) & _NAMES:
            return tuple(str(item) for item in values.ravel()), [], []
    named = [joint for joint in model.names if any(_is_of(column, joint) for column in columns)]
    if named:
        return tuple(named), [], []
    widths = [values.shape[1] for values in columns.values() if values.ndim == 2]
    count = max(set(widths), key=widths.count) if widths else 1
    remark = "The columns have no names of joints: those of the model are taken in its order."
    if count == len(model.names):
        return model.names, [remark], []
    if count > len(model.names):
        raise BenchError(f"The log has {count} joints and {model.path} {len(model.names)}; is it the right model?")
    names = (*model.names[:count],)
    return names, [remark], [f"joints: the log has {count} of the {len(model.names)} joints of the model"]


def _is_of(column: str, joint: str) -> bool:
    """Whether a column's name holds a joint's name as a whole."""
    return re.search(rf"(?<![A-Za-z0-9]){re.escape(joint)}(?![A-Za-z0-9])", column.replace("_", "_")) is not None or (
        re.search(rf"(^|[^A-Za-z0-9]){re.escape(joint)}($|[^A-Za-z0-9])", column) is not None
    )


def _column_of(
    quantity: str, words: dict[str, frozenset[str]], columns: dict[str, Array], joints: tuple[str, ...]
) -> Columns | None:
    """The column, or the columns of the joints, of a quantity."""
    kinds, commanded = _QUANTITIES[quantity]

    def fits(name: str, without: str = "") -> bool:
        found = _words(name.replace(without, " ")) if without else words[name]
        return bool(found & kinds) and bool(found & _COMMAND) == commanded

    wide = [n for n, v in columns.items() if v.ndim == 2 and v.shape[1] == len(joints) and fits(n)]
    if wide:
        return min(wide, key=lambda name: (not words[name] & _MEASURED, len(name)))
    single = []
    for joint in joints:
        options = [n for n, v in columns.items() if v.ndim == 1 and _is_of(n, joint) and fits(n, joint)]
        if not options:
            return None
        single.append(min(options, key=len))
    return single


def _stacked(columns: dict[str, Array], names: Columns) -> Array:
    values = columns[names] if isinstance(names, str) else np.column_stack([columns[name] for name in names])
    return np.asarray(values, dtype=float).reshape(len(values), -1)


def _relative(path: Path, folder: Path) -> str:
    try:
        return str(path.resolve().relative_to(folder.resolve()))
    except ValueError:
        return str(path.resolve())


def _time(columns: dict[str, Array], words: dict[str, frozenset[str]], questions: list[str]) -> dict[str, Any]:
    """The section on time."""
    names = [n for n, v in columns.items() if v.ndim == 1 and v.size > 2 and (n == STAMP or words[n] & _TIME)]
    if not names:
        questions.append("time.rate_hz: rows per second")
        return {"rate_hz": "?"}
    step = float(np.median(np.diff(columns[names[0]])))
    unit = "s" if step < 0.3 else "ms" if step < 200.0 else "us" if step < 2e5 else "ns"
    return {"column": names[0], "unit": unit}


def _angle_unit(position: Array, model: RobotModel, joints: tuple[str, ...]) -> str:
    """rad, or deg where angles are far beyond what the joints' ranges allow and turning explains it."""
    known = {joint.name: joint for joint in model.joints}
    turning = np.array([name in known and known[name].turns for name in joints])
    if not np.any(turning):
        return "m"
    largest = float(np.max(np.abs(position[:, turning])))
    return "deg" if largest > 4.0 * np.pi and largest <= 720.0 else "rad"


def _gain(key: str, words: dict[str, frozenset[str]], columns: dict[str, Array], count: int) -> Columns | None:
    kinds = _KP if key == "kp" else _KD
    names = [n for n, v in columns.items() if words[n] & kinds and v.dtype.kind == "f" and v.size in (1, count)]
    return names[0] if names else None


class _Law:
    """Tells whether a column is the control law itself."""

    def __init__(
        self, columns: dict[str, Array], chosen: dict[str, Columns], gains: dict[str, Columns], count: int
    ) -> None:
        position = _stacked(columns, chosen["position"])
        self._columns = columns
        self._terms = [_stacked(columns, chosen["position command"]) - position]
        if "velocity" in chosen:
            speed = _stacked(columns, chosen["velocity"])
            commanded = _stacked(columns, chosen["velocity command"]) if "velocity command" in chosen else 0.0
            self._terms.append(commanded - speed)

    def gives(self, names: Columns) -> bool:
        """Whether the law with some gains gives a column of torques but for rounding, in all joints that moved."""
        torque = _stacked(self._columns, names)
        left = []
        for joint in range(torque.shape[1]):
            matrix = np.column_stack([term[:, joint] for term in self._terms])
            size = float(np.std(torque[:, joint]))
            if size > 0.0:
                solution = np.linalg.lstsq(matrix, torque[:, joint], rcond=None)[0]
                left.append(float(np.std(torque[:, joint] - matrix @ solution)) / size)
        return bool(left) and float(np.median(left)) < THRESHOLDS.exact
