"""The sidecar of a log of joints: which columns are what, in which units, and the law of the drives."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from nmt_core.errors import BenchError
from nmt_core.files.validation_sentence import validation_sentence
from nmt_core.files.yaml_document import KeyPath, YamlDocument, parse_document, read_document
from nmt_robots.log.columns_of_file import FileColumns, read_columns
from nmt_robots.log.joint_log import Array, JointLog

Columns = str | list[str]
"""One column of N × J values, or J columns of N."""

_DEGREE, _TURN = float(np.pi / 180.0), float(2.0 * np.pi)
ANGLES = {
    "rad": 1.0, "deg": _DEGREE, "turn": _TURN, "mrad": 1e-3, "m": 1.0, "cm": 1e-2, "mm": 1e-3, "percent": 1e-2,
}  # fmt: skip
SPEEDS = {
    "rad/s": 1.0, "deg/s": _DEGREE, "rpm": _TURN / 60.0, "turn/s": _TURN, "m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3,
    "percent": 1e-2,
}  # fmt: skip
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class TimeSection(_Section):
    """The clock of the rows.

    Attributes:
        column: its column; left out where there is none, then ``rate_hz`` says it.
        unit: of the column.
        rate_hz: rows per second.
        clock: of a bag's messages: that of their headers, or the time at which they were logged.
    """

    column: str | None = None
    unit: Literal["s", "ms", "us", "ns"] = "s"
    rate_hz: Annotated[float, Field(gt=0)] | None = None
    clock: Literal["header", "log"] | None = None


AngleUnit = Literal["rad", "deg", "turn", "mrad", "m", "cm", "mm", "percent"]
SpeedUnit = Literal["rad/s", "deg/s", "rpm", "turn/s", "m/s", "cm/s", "mm/s", "percent"]
Numbers = float | list[float]
"""One number for all joints, or one for each."""


class AngleSection(_Section):
    """Positions of the joints: ``sign (value - zero) unit / gear``.

    Attributes:
        column: one column for all, or one for each joint.
        unit: of the values, one for all or one for each joint.
        sign: of each joint, 1 or −1; left out = 1.
        zero: value of the column where the model's joint is at zero.
        gear: measured turns for one turn of the joint.
        full_scale: of joints in percent: rad (m) that 100 % are.
    """

    column: Columns
    unit: AngleUnit | list[AngleUnit] = "rad"
    sign: list[Literal[1, -1]] | None = None
    zero: Numbers = 0.0
    gear: Numbers = 1.0
    full_scale: Numbers | None = None


class SpeedSection(_Section):
    """Speeds of the joints; keys as for positions, ``full_scale`` in rad/s (m/s)."""

    column: Columns
    unit: SpeedUnit | list[SpeedUnit] = "rad/s"
    sign: list[Literal[1, -1]] | None = None
    gear: Numbers = 1.0
    full_scale: Numbers | None = None


_Moving = TypeVar("_Moving", AngleSection, SpeedSection)


class CommandSection(_Section):
    """What the drives were told.

    Attributes:
        position, velocity, torque: columns, in the units of positions, speeds and N·m; positions and speeds with a unit
            of their own as those sections.
    """

    position: Columns | AngleSection | None = None
    velocity: Columns | SpeedSection | None = None
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
        robot: the model that proposed it; of a further log its own model, such as that with a known mass hung on.
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
    columns = read_columns(data, sidecar.time.clock or "", sidecar.joints, sidecar.position.column)
    return log_of(sidecar, columns, str(data))


def robot_of_sidecar(path: Path) -> Path | None:
    """The model that a sidecar names; None for a log without a sidecar, or where it names none.

    Raises:
        BenchError: the sidecar is wrong, or no such file exists.
    """
    if path.suffix.lower() not in (".yaml", ".yml"):
        return None
    name = _valid(read_document(path, "sidecar of a robot's log", "robot_log, data, joints, time and position")).robot
    if name is None:
        return None
    robot = path.parent / name
    if not robot.is_file():
        raise BenchError(f"{path}: the robot {robot} does not exist; name its model or leave the key robot out.")
    return robot


def sidecar_of_text(text: str, folder: Path, columns: FileColumns) -> JointLog:
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
            f"{document.name} is not a sidecar of a robot's log; make one: ./nmt import --init LOG --robot ROBOT.xml."
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


def log_of(sidecar: RobotSidecar, columns: FileColumns, source: str) -> JointLog:
    """The log that a sidecar makes of columns.

    Raises:
        BenchError: a column is missing or has another shape, or the time runs backwards.
    """
    twice = sorted({name for name in sidecar.joints if sidecar.joints.count(name) > 1})
    if twice:
        raise BenchError(f"{source}: the sidecar names the joint {', '.join(twice)} twice; name each joint once.")
    if columns.question and sidecar.time.clock is None:
        raise BenchError(f"{source}: {columns.question} The sidecar's key is time.clock.")
    reader = _Columns(columns, len(sidecar.joints), source)
    position = reader.motion(sidecar.position, ANGLES, "position")
    velocity, command, torque = sidecar.velocity, sidecar.command, sidecar.torque
    speeds = velocity if velocity is not None else SpeedSection(column=[])
    angle_command = reader.commanded(command.position, sidecar.position)
    speed_command = reader.commanded(command.velocity, speeds)
    fields = {
        "time": _time(sidecar.time, reader, len(position)),
        "position": position,
        "velocity": None if velocity is None else reader.motion(velocity, SPEEDS, "velocity"),
        "position_command": None if angle_command is None else reader.motion(angle_command, ANGLES, "command.position"),
        "velocity_command": None if speed_command is None else reader.motion(speed_command, SPEEDS, "command.velocity"),
        "torque_command": None if command.torque is None else reader.scaled(command.torque),
        "torque": None if torque is None else _torque(torque, reader),
    }
    fields, notes = _without_open_ends(fields, source)
    units = sidecar.position.unit
    log = JointLog(
        source=source,
        joints=tuple(sidecar.joints),
        position_gain=None if sidecar.gains is None else reader.numbers(sidecar.gains.kp, "gains.kp"),
        velocity_gain=None if sidecar.gains is None else reader.numbers(sidecar.gains.kd, "gains.kd"),
        position_units=(units,) * len(sidecar.joints) if isinstance(units, str) else tuple(units),
        notes=(*columns.notes, *notes),
        **fields,  # type: ignore[arg-type]
    )
    return _checked(log)


def _torque(section: TorqueSection, reader: _Columns) -> Array:
    factor = reader.numbers(section.constant, "torque.constant") * reader.numbers(section.gear, "torque.gear")
    torque: Array = reader.scaled(section.column) * factor
    return torque


def _time(section: TimeSection, reader: _Columns, rows: int) -> Array:
    if section.column is not None:
        time: Array = reader.one(section.column) * TIMES[section.unit]
        if time.ndim != 1:
            raise BenchError(f"{reader.source}: time.column {section.column} has {time.shape[1]} columns; name one.")
        known = time[np.isfinite(time)]
        return np.asarray(time - known[0]) if len(known) else time
    if section.rate_hz is None:
        raise BenchError(f"{reader.source}: the sidecar names no time; give time.column or time.rate_hz.")
    return np.arange(rows) / section.rate_hz


def _without_open_ends(fields: dict[str, Array | None], source: str) -> tuple[dict[str, Array | None], list[str]]:
    """The log without rows at its begin and end in which another clock has no values yet, and a sentence on it.

    Raises:
        BenchError: a quantity has another number of rows.
    """
    rows = len(fields["time"])  # type: ignore[arg-type]
    known = np.ones(rows, dtype=bool)
    for name, values in fields.items():
        if values is None:
            continue
        if len(values) != rows:
            raise BenchError(f"{source}: {name} has {len(values)} rows and the time {rows}; they must have as many.")
        known &= np.all(np.isfinite(values.reshape(rows, -1)), axis=1)
    if not known.any() or known.all():
        return fields, []
    first, last = int(np.argmax(known)), rows - int(np.argmax(known[::-1]))
    if last - first in (rows, 0):
        return fields, []
    note = f"{rows - (last - first)} rows at the ends of the log have not all values and were left out."
    return {name: None if values is None else values[first:last] for name, values in fields.items()}, [note]


def _checked(log: JointLog) -> JointLog:
    """The log, if a diagnosis can use it.

    Raises:
        BenchError: a sentence on what it lacks.
    """
    if log.rows < 50:
        raise BenchError(f"{log.source} has {log.rows} rows; a diagnosis needs at least 50.")
    if not np.all(np.isfinite(log.time)):
        row = int(np.argmax(~np.isfinite(log.time))) + 1
        raise BenchError(f"{log.source}: time has no number in row {row}; cut the log there.")
    if not np.all(np.diff(log.time) >= 0.0):
        row = int(np.argmax(np.diff(log.time) < 0.0)) + 2
        raise BenchError(f"{log.source}: time runs backwards at row {row}; sort or split the log.")
    if log.time[-1] <= log.time[0]:
        raise BenchError(f"{log.source}: the time column stands still; give time.rate_hz instead.")
    if not _FASTEST_S < log.step_s < _SLOWEST_S:
        raise BenchError(
            f"{log.source}: its rows are {log.step_s:.3g} s apart, which is not a log of a motion; check time.unit or "
            "time.rate_hz."
        )
    for name, largest in _LARGEST.items():
        values = getattr(log, name)
        if values is None:
            continue
        if values.shape != log.position.shape:
            raise BenchError(f"{log.source}: {name} has {values.shape} values and the position {log.position.shape}.")
        for wrong, what in ((~np.isfinite(values), "no number"), (np.abs(values) > largest, "no possible value")):
            if np.any(wrong):
                row, joint = (int(x[0]) for x in np.nonzero(wrong))
                value = f" ({values[row, joint]:.3g} in SI units)" if what != "no number" else ""
                raise BenchError(
                    f"{log.source}: {name} of {log.joints[joint]} has {what}{value} in row {row + 1}; cut the log "
                    "there, or check its unit."
                )
    if not np.any(np.ptp(log.position, axis=0) > 0.0):
        raise BenchError(f"{log.source}: no joint moves: every position is the same in all rows; log a motion.")
    if log.torque is None and (log.position_gain is None or log.position_command is None):
        raise BenchError(
            f"{log.source}: no torque was measured, so the drives' law must be known: give gains.kp and gains.kd "
            "(N·m/rad, N·m·s/rad) and command.position in the sidecar, or a measured torque or current."
        )
    _check_torque(log)
    return log


_FASTEST_S, _SLOWEST_S = 1e-6, 1.0
_LARGEST = {
    "position": 1e5, "velocity": 1e6, "position_command": 1e5, "velocity_command": 1e6, "torque_command": 1e9,
    "torque": 1e9,
}  # fmt: skip
"""In SI units; what is beyond is not a reading of a joint."""


def _check_torque(log: JointLog) -> None:
    """Raise where a joint moves and its torque is not a reading.

    Raises:
        BenchError: the torque is the same in all rows, or the gains make none.
    """
    moves = np.ptp(log.position, axis=0) > 0.0
    if log.torque is not None:
        same = moves & (np.ptp(log.torque, axis=0) <= 0.0)
        if np.any(same):
            names = ", ".join(name for name, is_same in zip(log.joints, same, strict=True) if is_same)
            raise BenchError(
                f"{log.source}: the torque of {names} is the same in all rows, so it is not a reading; leave torque "
                f"out "
                "and give gains.kp, gains.kd and command.position, or take a joint that was held still out of joints."
            )
        return
    assert log.position_gain is not None
    assert log.velocity_gain is not None
    assert log.position_command is not None
    gains = np.abs(np.r_[log.position_gain, log.velocity_gain])
    if not np.all(np.isfinite(gains)) or np.any(gains > 1e9):
        raise BenchError(f"{log.source}: a gain is not a possible number; give gains.kp and gains.kd as they were.")
    speed_error = log.velocity_gain * np.ptp(log.position, axis=0)
    silent = moves & (log.position_gain * np.ptp(log.position_command - log.position, axis=0) + speed_error == 0.0)
    if np.any(silent):
        names = ", ".join(name for name, is_silent in zip(log.joints, silent, strict=True) if is_silent)
        raise BenchError(
            f"{log.source}: the drives' law makes no torque of {names}: a gain is 0 or the command is the position "
            "itself; check gains.kp, gains.kd and command.position."
        )


class _Columns:
    """Columns by name, with errors that say what is there."""

    def __init__(self, columns: FileColumns, joints: int, source: str) -> None:
        self._columns, self._joints, self.source = columns.values, joints, source

    def one(self, name: str) -> Array:
        """A column.

        Raises:
            BenchError: there is none of that name, or it holds no numbers.
        """
        if name not in self._columns:
            raise BenchError(f"{self.source} has no column {name}; it has {', '.join(list(self._columns)[:40])}.")
        values = np.asarray(self._columns[name])
        if values.dtype.kind != "f" or not 1 <= values.ndim <= 2:
            raise BenchError(f"{self.source}: column {name} holds no numbers in rows.")
        return values

    def scaled(self, names: Columns) -> Array:
        """N × J values as they are."""
        if isinstance(names, str):
            values = self.one(names)
        else:
            parts = [self.one(name) for name in names]
            if not parts or any(part.shape != parts[0].shape or part.ndim > 1 for part in parts):
                raise BenchError(f"{self.source}: {', '.join(names) or 'no columns'}: name a column of N values each.")
            values = np.column_stack(parts)
        if values.ndim == 1:
            values = values[:, None]
        if values.shape[1] != self._joints:
            raise BenchError(
                f"{self.source}: {names} has {values.shape[-1]} columns and the sidecar names {self._joints} joints; "
                "name the joints of the columns, or one column for each."
            )
        return values

    def motion(self, section: AngleSection | SpeedSection, factors: dict[str, float], key: str) -> Array:
        """Positions or speeds, N × J, in rad or m and in rad/s or m/s."""
        units = [section.unit] * self._joints if isinstance(section.unit, str) else list(section.unit)
        if len(units) != self._joints:
            raise BenchError(f"{self.source}: {key} has {len(units)} units for {self._joints} joints.")
        factor = np.array([factors[unit] for unit in units])
        percent = np.array([unit == "percent" for unit in units])
        if np.any(percent):
            if section.full_scale is None:
                raise BenchError(f"{self.source}: {key} is in percent; give {key}.full_scale, rad (m) that 100 % are.")
            factor = np.where(percent, factor * self.numbers(section.full_scale, f"{key}.full_scale"), factor)
        gear = self.numbers(section.gear, f"{key}.gear")
        if not np.all(gear != 0.0):
            raise BenchError(f"{self.source}: {key}.gear is 0; give the turns that are measured for one of the joint.")
        zero = self.numbers(section.zero, f"{key}.zero") if isinstance(section, AngleSection) else 0.0
        result: Array = (self.scaled(section.column) - zero) * (factor / gear)
        if section.sign is not None:
            if len(section.sign) != self._joints:
                raise BenchError(f"{self.source}: {len(section.sign)} signs for {self._joints} joints.")
            result = result * np.array(section.sign, dtype=float)
        return result

    @staticmethod
    def commanded(command: Columns | _Moving | None, measured: _Moving) -> _Moving | None:
        """A command as a section: with its own unit, or in that of the measurement."""
        if command is None or isinstance(command, _Section):
            return command
        return measured.model_copy(update={"column": command})

    def numbers(self, value: Any, key: str) -> Array:
        """J values of a column, a list or a number."""
        values = np.ravel(self.one(value) if isinstance(value, str) else np.asarray(value, dtype=float))
        if values.size == 1:
            values = np.full(self._joints, float(values[0]))
        if values.size != self._joints:
            raise BenchError(f"{self.source}: {key} has {values.size} values for {self._joints} joints.")
        return values
