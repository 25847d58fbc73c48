"""The sidecar of a log of joints: which columns are what, in which units, and the law of the drives."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from nmt_core.errors import BenchError
from nmt_core.files.validation_sentence import validation_sentence
from nmt_core.files.yaml_document import KeyPath, YamlDocument, parse_document, read_document
from nmt_robots.log.columns_of_file import read_columns
from nmt_robots.log.joint_log import Array, JointLog

Columns = str | list[str]
"""One column of N × J values, or J columns of N."""

ANGLES = {"rad": 1.0, "deg": float(np.pi / 180.0), "m": 1.0, "mm": 1e-3}
SPEEDS = {"rad/s": 1.0, "deg/s": float(np.pi / 180.0), "rpm": float(np.pi / 30.0), "m/s": 1.0, "mm/s": 1e-3}
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class TimeSection(_Section):
    """The clock of the rows.

    Attributes:
        column: its column; left out where there is none, then ``rate_hz`` says it.
        unit: of the column.
        rate_hz: rows per second.
    """

    column: str | None = None
    unit: Literal["s", "ms", "us", "ns"] = "s"
    rate_hz: Annotated[float, Field(gt=0)] | None = None


class AngleSection(_Section):
    """Positions of the joints.

    Attributes:
        column: one column for all, or one for each joint.
        unit: of the values.
        sign: of each joint, 1 or −1; left out = 1.
    """

    column: Columns
    unit: Literal["rad", "deg", "m", "mm"] = "rad"
    sign: list[Literal[1, -1]] | None = None


class SpeedSection(_Section):
    """Speeds of the joints; keys as for positions."""

    column: Columns
    unit: Literal["rad/s", "deg/s", "rpm", "m/s", "mm/s"] = "rad/s"
    sign: list[Literal[1, -1]] | None = None


class CommandSection(_Section):
    """What the drives were told.

    Attributes:
        position, velocity, torque: columns, in the units of positions, speeds and N·m.
    """

    position: Columns | None = None
    velocity: Columns | None = None
    torque: Columns | None = None


class GainSection(_Section):
    """The control law ``kp (q_command − q) + kd (v_command − v) + torque command`` of the drives.

    Attributes:
        kp: N·m/rad: a column of J values, one number for all, or a list.
        kd: N·m·s/rad.
    """

    kp: str | float | list[float]
    kd: str | float | list[float] = 0.0


class TorqueSection(_Section):
    """Torque that was measured.

    Attributes:
        column: torque or current.
        constant: N·m per unit of the column at the motor, one for all or one for each joint.
        gear: ratio from motor to joint.
    """

    column: Columns
    constant: float | list[float] = 1.0
    gear: float | list[float] = 1.0


class RobotSidecar(_Section):
    """A log of joints.

    Attributes:
        robot_log: version of this format.
        data: the log, relative to the sidecar.
        robot: the model that proposed it.
        joints: names of the joints in the model, in the order of the columns.
        time, position, velocity, command, gains, torque: see their classes.
    """

    robot_log: Literal[1]
    data: str
    robot: str | None = None
    joints: Annotated[list[str], Field(min_length=1)]
    time: TimeSection
    position: AngleSection
    velocity: SpeedSection | None = None
    command: CommandSection = CommandSection()
    gains: GainSection | None = None
    torque: TorqueSection | None = None


def read_robot_sidecar(path: Path) -> JointLog:
    """A log by its sidecar.

    Raises:
        BenchError: the sidecar is wrong, or its columns are not in the data.
    """
    document = read_document(path, "sidecar of a robot's log", "robot_log, data, joints, time and position")
    sidecar = _valid(document)
    data = path.parent / sidecar.data
    return log_of(sidecar, read_columns(data), str(data))


def sidecar_of_text(text: str, folder: Path, columns: dict[str, Array]) -> JointLog:
    """A log by the text of a sidecar in a folder, and columns that have been read.

    Raises:
        BenchError: as :func:`read_robot_sidecar`.
    """
    sidecar = _valid(parse_document(text, "the proposed sidecar", "sidecar of a robot's log", "data"))
    return log_of(sidecar, columns, str(folder / sidecar.data))


def _valid(document: YamlDocument) -> RobotSidecar:
    """The sidecar of a document.

    Raises:
        BenchError: it is none, a key is wrong, or a question is not answered.
    """
    if "robot_log" not in document.values:
        raise BenchError(
            f"{document.name} is no sidecar of a robot's log; make one: ./nmt import --init LOG --robot ROBOT.xml."
        )
    for path, place in document.places.items():
        if _at(document.values, path) == "?":
            raise BenchError(
                f"{document.name} {place}: {'.'.join(map(str, path))} is still a question; write its value."
            )
    try:
        return RobotSidecar.model_validate(document.values)
    except ValidationError as failure:
        raise BenchError(validation_sentence(failure.errors(), document, RobotSidecar, "the sidecar")) from failure


def _at(values: Any, path: KeyPath) -> Any:
    for key in path:
        values = values[key]
    return values


def log_of(sidecar: RobotSidecar, columns: dict[str, Array], source: str) -> JointLog:
    """The log that a sidecar makes of columns.

    Raises:
        BenchError: a column is missing or has another shape, or the time runs backwards.
    """
    reader = _Columns(columns, len(sidecar.joints), source)
    position = reader.scaled(sidecar.position.column, ANGLES[sidecar.position.unit], sidecar.position.sign)
    rows = len(position)
    time = _time(sidecar.time, reader, rows)
    velocity = sidecar.velocity
    angle, command = ANGLES[sidecar.position.unit], sidecar.command
    speed = SPEEDS[velocity.unit] if velocity is not None else 1.0
    sign, speed_sign = sidecar.position.sign, velocity.sign if velocity is not None else None
    log = JointLog(
        source=source,
        joints=tuple(sidecar.joints),
        time=time,
        position=position,
        velocity=None if velocity is None else reader.scaled(velocity.column, speed, speed_sign),
        position_command=None if command.position is None else reader.scaled(command.position, angle, sign),
        velocity_command=None if command.velocity is None else reader.scaled(command.velocity, speed, speed_sign),
        torque_command=None if command.torque is None else reader.scaled(command.torque),
        torque=None if sidecar.torque is None else _torque(sidecar.torque, reader),
        position_gain=None if sidecar.gains is None else reader.gains(sidecar.gains.kp),
        velocity_gain=None if sidecar.gains is None else reader.gains(sidecar.gains.kd),
        position_unit=sidecar.position.unit,
    )
    return _checked(log)


def _torque(section: TorqueSection, reader: _Columns) -> Array:
    torque: Array = reader.scaled(section.column) * reader.gains(section.constant) * reader.gains(section.gear)
    return torque


def _time(section: TimeSection, reader: _Columns, rows: int) -> Array:
    if section.column is not None:
        time: Array = reader.one(section.column) * TIMES[section.unit]
        time = time - time[0]
        return time
    if section.rate_hz is None:
        raise BenchError(f"{reader.source}: the sidecar names no time; give time.column or time.rate_hz.")
    return np.arange(rows) / section.rate_hz


def _checked(log: JointLog) -> JointLog:
    """The log, if a diagnosis can use it.

    Raises:
        BenchError: a sentence on what it lacks.
    """
    if log.rows < 50:
        raise BenchError(f"{log.source} has {log.rows} rows; a diagnosis needs at least 50.")
    if not np.all(np.diff(log.time) >= 0.0):
        row = int(np.argmax(np.diff(log.time) < 0.0)) + 2
        raise BenchError(f"{log.source}: time runs backwards at row {row}; sort or split the log.")
    if log.time[-1] <= log.time[0]:
        raise BenchError(f"{log.source}: the time column stands still; give time.rate_hz instead.")
    shapes = {
        name: getattr(log, name)
        for name in ("position", "velocity", "position_command", "velocity_command", "torque_command", "torque")
    }
    for name, values in shapes.items():
        if values is None:
            continue
        if values.shape != log.position.shape or len(values) != log.rows:
            raise BenchError(f"{log.source}: {name} has {values.shape} values and the time {log.rows} rows.")
        if not np.all(np.isfinite(values)):
            row = int(np.argmax(~np.all(np.isfinite(values), axis=1))) + 1
            raise BenchError(f"{log.source}: {name} has no number in row {row}; cut the log there.")
    if log.torque is None and (log.position_gain is None or log.position_command is None):
        raise BenchError(
            f"{log.source}: no torque was measured, so the drives' law must be known: give gains.kp and gains.kd "
            "(N·m/rad, N·m·s/rad) and command.position in the sidecar, or a measured torque or current."
        )
    return log


class _Columns:
    """Columns by name, with errors that say what is there."""

    def __init__(self, columns: dict[str, Array], joints: int, source: str) -> None:
        self._columns, self._joints, self.source = columns, joints, source

    def one(self, name: str) -> Array:
        """A column.

        Raises:
            BenchError: there is none of that name, or it holds no numbers.
        """
        if name not in self._columns:
            raise BenchError(f"{self.source} has no column {name}; it has {', '.join(list(self._columns)[:40])}.")
        values = np.asarray(self._columns[name])
        if values.dtype.kind != "f":
            raise BenchError(f"{self.source}: column {name} holds no numbers.")
        return values

    def scaled(self, names: Columns, factor: float = 1.0, signs: list[Literal[1, -1]] | None = None) -> Array:
        """N × J values."""
        values = self.one(names) if isinstance(names, str) else np.column_stack([self.one(name) for name in names])
        if values.ndim == 1:
            values = values[:, None]
        if values.ndim != 2 or values.shape[1] != self._joints:
            raise BenchError(
                f"{self.source}: {names} has {values.shape[-1]} columns and the sidecar names {self._joints} joints; "
                "name the joints of the columns, or one column for each."
            )
        result: Array = values * factor
        if signs is not None:
            if len(signs) != self._joints:
                raise BenchError(f"{self.source}: {len(signs)} signs for {self._joints} joints.")
            result = result * np.array(signs, dtype=float)
        return result

    def gains(self, value: Any) -> Array:
        """J values of a column, a list or a number."""
        values = np.ravel(self.one(value) if isinstance(value, str) else np.asarray(value, dtype=float))
        if values.size == 1:
            values = np.full(self._joints, float(values[0]))
        if values.size != self._joints:
            raise BenchError(f"{self.source}: {values.size} gains for {self._joints} joints.")
        return values
