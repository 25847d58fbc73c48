"""A sidecar proposed from the names of the columns and a robot's joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.files.yaml_text import yaml_text
from nmt_robots.log.column_roles import (
    CURRENT,
    KD,
    KP,
    NAMES,
    POSITION,
    SPEED,
    TIME,
    TORQUE,
    ColumnRole,
    Family,
    families_of,
    joint_words,
    roles_of,
    stated_unit,
    words_of,
)
from nmt_robots.log.columns_of_file import STAMP, FileColumns, read_columns
from nmt_robots.log.joint_log import Array, control_law
from nmt_robots.log.robot_sidecar import ANGLES, TIMES, Columns
from nmt_robots.log.unit_choice import JointMotion, MotionUnits, motion_units, slope_of
from nmt_robots.model.robot_model import RobotModel
from nmt_robots.thresholds import THRESHOLDS

_CONSTANTS = {"N*m": 1.0, "N": 1.0, "mN*m": 1e-3, "N*cm": 1e-2, "kN*m": 1e3, "kN": 1e3, "kgf*cm": 0.0980665,
              "kgf*m": 9.80665}  # fmt: skip
_LIKE = 0.9
"""Correlation from which a column without a word for it is a command of the column it follows."""
_MOST_NAMED = 40


@dataclass(frozen=True)
class SidecarProposal:
    """A sidecar and what was noticed while it was made.

    Attributes:
        text: YAML.
        questions: what its reader must answer.
        columns: of the log.
    """

    text: str
    questions: tuple[str, ...]
    columns: FileColumns


def propose_sidecar(data: Path, robot: Path, folder: Path) -> SidecarProposal:
    """A sidecar for a log.

    Args:
        data: the log.
        robot: MJCF or URDF file.
        folder: where the sidecar will be; paths in it are relative to that.

    Raises:
        BenchError: one of them cannot be read, or no column is a position.
    """
    model = RobotModel(robot)
    columns = read_columns(data, joints=model.names)
    if columns.question:
        columns = replace(read_columns(data, "log", model.names), question=columns.question)
    draft = _Draft(data, columns, model)
    sidecar = {"robot_log": 1, "data": _relative(data, folder), "robot": _relative(robot, folder), **draft.sections()}
    text = "".join(f"# {line}\n" for line in draft.remarks) + yaml_text(sidecar)
    return SidecarProposal(text, tuple(draft.questions), columns)


def _relative(path: Path, folder: Path) -> str:
    try:
        return str(path.resolve().relative_to(folder.resolve()))
    except ValueError:
        return str(path.resolve())


@dataclass(eq=False)
class _Draft:
    """A sidecar on its way: what was chosen, remarked and must be asked."""

    data: Path
    columns: FileColumns
    model: RobotModel
    remarks: list[str] = field(default_factory=list)
    questions: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.remarks += self.columns.notes
        self._values = self._readings()
        words = joint_words(self.model.names)
        roles = [role for name in self._values for role in roles_of(name, words, self.columns.units.get(name, ""))]
        widths = {name: values.shape[1] for name, values in self._values.items() if values.ndim == 2}
        self._families = families_of(_numbers_are_joints(roles, self.model.names), widths)
        self._position = self._positions()
        self._places: list[str | int] = list(self._position.columns)
        self._joints, self._order = self._names()

    # --- columns ------------------------------------------------------------------------------------------------------

    def _readings(self) -> dict[str, Array]:
        """Columns that hold a motion or a reading: not those that are the same number in every row."""
        kept: dict[str, Array] = {}
        empty: list[str] = []
        rows = max((len(values) for values in self.columns.values.values() if values.ndim), default=0)
        for name, values in self.columns.values.items():
            if values.dtype.kind != "f" or values.ndim not in (1, 2) or len(values) != rows or rows < 3:
                continue
            if not np.any(np.nan_to_num(values)):
                empty.append(name)
                continue
            kept[name] = values
        spoken = [name for name in empty if any(role.kind not in ("", "other") for role in roles_of(name, {}))]
        if spoken:
            listed = ", ".join(spoken[:6]) + (", …" if len(spoken) > 6 else "")
            self.remarks.append(f"Without a reading, 0 or no number in every row, and left out: {listed}.")
        self._empty = set(empty)
        return kept

    def _stacked(self, names: Sequence[str]) -> Array:
        values = np.column_stack([self._values[name] for name in names])
        return np.asarray(values, dtype=float)

    def _positions(self) -> Family:
        """The family of the measured positions.

        Raises:
            BenchError: there is none.
        """
        found = [family for family in self._families if family.kind == POSITION and not family.commanded]
        found = [family for family in found if self._width(family) >= 1]
        if not found:
            still = [name for name in self._empty if roles_of(name, {})[0].kind == POSITION]
            why = f"{', '.join(still[:6])} are 0 in every row" if still else (
                f"its columns are {', '.join(list(self.columns.values)[:_MOST_NAMED])}"
            )  # fmt: skip
            raise BenchError(
                f"{self.data} has no column of joint positions by its name; {why}. Write the sidecar by hand "
                "(robot_log: 1, data, joints, time, position)."
            )
        named = self._named_columns()
        wanted = len(named) if named else len(self.model.names)

        def rank(family: Family) -> tuple[Any, ...]:
            width = self._width(family)
            by_name = family.by == "joint"
            return (not by_name, width != wanted, -width if by_name else 0, family.noise, len(str(family.columns)))

        best = min(found, key=rank)
        rivals = [other for other in found if other is not best and rank(other)[:4] == rank(best)[:4]]
        for rival in rivals:
            theirs, ours = self._of(rival), self._of(best)
            if theirs.shape == ours.shape and not np.allclose(theirs, ours, atol=1e-2 * float(np.std(ours)) + 1e-12):
                self._ask(
                    "position.column",
                    f"position.column: {self._words(best)} or {self._words(rival)}, which differ (at the joint or at "
                    "the motor?)",
                )
                break
        return best

    def _width(self, family: Family) -> int:
        if family.by == "array":
            return int(self._values[family.columns[""]].shape[1])
        return len(family.columns)

    def _of(self, family: Family) -> Array:
        values = self._stacked(list(family.columns.values()))
        return values

    @staticmethod
    def _words(family: Family) -> str:
        names = list(family.columns.values())
        return names[0] if len(names) == 1 else f"{names[0]}, …"

    def _ask(self, key: str, question: str) -> None:
        self._asked = getattr(self, "_asked", set()) | {key}
        self.questions.append(question)

    def _is_asked(self, key: str) -> bool:
        return key in getattr(self, "_asked", set())

    # --- joints -------------------------------------------------------------------------------------------------------

    def _named_columns(self) -> tuple[str, ...]:
        """Names of joints that the log itself lists."""
        for name, values in self.columns.values.items():
            if values.dtype.kind in "US" and set(words_of(name)) & NAMES:
                return tuple(str(item) for item in values.ravel())
        return ()

    def _names(self) -> tuple[list[str], bool]:
        """Names of the joints in the order of the columns, and whether that order is known."""
        if self._position.by == "joint":
            order = {name: number for number, name in enumerate(self.model.names)}
            self._places.sort(key=lambda name: order[str(name)])
            return [str(name) for name in self._places], True
        listed = self._named_columns()
        count = self._width(self._position)
        if listed and len(listed) == count:
            return list(listed), True
        if self._position.by == "number" and count > len(self.model.names):
            self._leave_out_still_numbers()
            count = len(self._places)
        if count > len(self.model.names):
            raise BenchError(
                f"The log has {count} joints and {self.model.path} {len(self.model.names)}; is it the right model? "
                "If it is, write the sidecar by hand (robot_log: 1, data, joints, time, position)."
            )
        if self._position.by == "array" and count == len(self.model.names):
            self.remarks.append("The columns have no names of joints: those of the model are taken in its order.")
            return list(self.model.names), True
        if count == len(self.model.names) == 1:
            return list(self.model.names), True
        listed_columns = self._column_list(self._position)
        of = f"of {listed_columns}" if isinstance(listed_columns, str) else f"of {', '.join(listed_columns)}"
        self._ask("joints", f"joints: the names {of} in that order; the model's are {', '.join(self.model.names)}")
        return list(self.model.names[:count]), False

    def _leave_out_still_numbers(self) -> None:
        """Take out numbered columns that never change, such as places of motors that a robot has not."""
        still = [place for place, name in self._position.columns.items() if np.ptp(self._values[name]) == 0.0]
        if still and len(self._position.columns) - len(still) >= 1:
            self.remarks.append(f"Columns that never change were left out: {', '.join(map(str, still))}.")
            self._places = [place for place in self._places if place not in still]

    def _column_list(self, family: Family) -> Columns:
        """The columns of a family in the order of the joints."""
        if family.by == "array":
            return family.columns[""]
        names = [family.columns[place] for place in self._places if place in family.columns]
        if family.by != self._position.by:
            names = list(family.columns.values())
        return names[0] if len(names) == 1 and len(self._places) == 1 and self._values[names[0]].ndim == 2 else names

    def _matching(self, kind: str, commanded: bool) -> list[Family]:
        """Families of a quantity that have all joints, those that say least else first."""
        count = len(self._joints)
        fits = []
        for family in self._families:
            if (family.kind, family.commanded) != (kind, commanded) or family is self._position:
                continue
            if family.by == self._position.by and family.by != "array":
                if all(place in family.columns for place in self._places):
                    fits.append(family)
            elif self._width(family) == count and (family.by == "array" or self._position.by == "array" or commanded):
                fits.append(family)
        return sorted(fits, key=lambda family: (family.by != self._position.by, family.noise, self._words(family)))

    def _values_of(self, family: Family) -> Array:
        names = self._column_list(family)
        return self._stacked([names] if isinstance(names, str) else names)

    # --- the sections -------------------------------------------------------------------------------------------------

    def sections(self) -> dict[str, Any]:
        """All sections of the sidecar but its head."""
        speed = next(iter(self._matching(SPEED, False)), None)
        time, clock = self._time()
        command = self._commands(speed)
        torque = self._first_reading(TORQUE)
        current = self._first_reading(CURRENT)
        units = self._units(speed, clock)
        result: dict[str, Any] = {
            "joints": self._joints if self._order else "?",
            "time": time,
            "position": self._motion(self._position, units.position, units.position_more),
        }
        if speed is not None:
            result["velocity"] = self._motion(speed, units.velocity, units.velocity_more)
        gains = {key: values for key, words in (("kp", KP), ("kd", KD)) if (values := self._gain(words)) is not None}
        if gains and POSITION in command:
            torque = self._without_the_law(gains, speed, command, torque)
        sections = self._command_sections(command, units)
        if sections:
            result["command"] = sections
        if "kp" in gains:
            result["gains"] = gains
        if torque is not None:
            result["torque"] = self._torque(torque)
        elif current is not None and "kp" not in gains:
            result["torque"] = {"column": self._column_list(current), "constant": "?", "gear": "?"}
            self.questions.append("torque.constant (N·m per unit of the column, at the motor) and torque.gear of the "
                                  f"column {self._words(current)}")  # fmt: skip
        elif "kp" not in gains:
            result["gains"] = {"kp": "?", "kd": "?"}
            self.questions.append(
                "gains.kp and gains.kd of the drives (N·m/rad, N·m·s/rad): no torque was measured"
                + self._gains_of_model()
            )
        if "torque" not in result and POSITION not in command:
            result.setdefault("command", {})["position"] = "?"
            listed = [name for name in self._values if any(role.commanded for role in roles_of(name, {}))]
            among = f" ({', '.join(listed[:6])}: no position by its values)" if listed else ""
            self.questions.append(f"command.position: the column of the commanded positions{among}")
        self.remarks += units.remarks
        self.questions += units.questions
        if self._is_asked("position.column"):
            result["position"]["column"] = "?"
        return result

    def _gains_of_model(self) -> str:
        """What the model's own drives have, in words."""
        every = self.model.drive_gains
        stated = [f"{joint} {kp:.6g} and {kd:.6g}" for joint, kp, kd in every if joint in self._joints]
        return f"; the model states {', '.join(stated)}" if stated else ""

    def _first_reading(self, kind: str) -> Family | None:
        """A measured torque or current of all joints that move."""
        found = next(iter(self._matching(kind, False)), None)
        if found is not None:
            return found
        for family in self._families:
            if family.kind != kind or family.commanded or family.by != "joint" or self._position.by != "joint":
                continue
            missing = [joint for joint in self._joints if joint not in family.columns]
            still = [joint for joint in missing if np.ptp(self._values[self._position.columns[joint]]) == 0.0]
            if len(missing) < len(self._joints) and missing == still:
                self.remarks.append(f"Joints that stand still and have no torque were left out: {', '.join(still)}.")
                self._places = [place for place in self._places if place not in still]
                self._joints = [joint for joint in self._joints if joint not in still]
                return family
            self.remarks.append(f"{self._words(family)} has no reading of {', '.join(missing)}, so it was left out.")
        return None

    def _motion(self, family: Family, units: list[str], more: dict[str, str]) -> dict[str, Any]:
        return {"column": self._column_list(family), "unit": _one(units), **more}

    def _torque(self, family: Family) -> dict[str, Any]:
        """The section of a torque with its unit by the headings."""
        units = self._units_of(family)
        section: dict[str, Any] = {"column": self._column_list(family)}
        known = {joint.name: joint for joint in self.model.joints}
        constants: list[Any] = []
        for joint, unit in zip(self._joints, units, strict=True):
            turns = known[joint].turns if joint in known else True
            wrong = (unit in ("N", "kN") and turns) or ("*" in unit and not turns)
            constants.append("?" if wrong or (unit and unit not in _CONSTANTS) else _CONSTANTS.get(unit, 1.0))
        if "?" in constants and self._order:
            section["constant"] = "?"
            stated = ", ".join(sorted({unit for unit in units if unit}))
            self.questions.append(
                f"torque.constant (N·m, of a slide N, per unit of the column), whose heading is in {stated}"
            )
        elif any(constant not in ("?", 1.0) for constant in constants):
            section["constant"] = constants[0] if len(set(constants)) == 1 else constants
        return section

    def _units_of(self, family: Family) -> list[str]:
        if family.by == "array":
            return [family.units[""]] * len(self._joints)
        places = self._places if family.by == self._position.by else list(family.units)
        return [family.units[place] for place in places]

    def _units(self, speed: Family | None, clock: Array | None) -> MotionUnits:
        """Units of positions and speeds by heading, size and each other."""
        known = {joint.name: joint for joint in self.model.joints}
        position = self._values_of(self._position)
        velocity = None if speed is None else self._values_of(speed)
        headings = self._units_of(self._position)
        speed_headings = [""] * len(self._joints) if speed is None else self._units_of(speed)
        joints = []
        for number, name in enumerate(self._joints):
            slope = float("nan")
            if velocity is not None and clock is not None:
                slope = slope_of(clock, position[:, number], velocity[:, number])
            joints.append(
                JointMotion(known[name] if self._order and name in known else None, position[:, number],
                            headings[number], speed_headings[number], slope)
            )  # fmt: skip
        return motion_units(joints)

    # --- commands -----------------------------------------------------------------------------------------------------

    def _commands(self, speed: Family | None) -> dict[str, Family]:
        """Commands by their names, and those without a quantity in their names by their values."""
        found = {
            kind: families[0]
            for kind in (POSITION, SPEED, TORQUE)
            if (families := [item for item in self._matching(kind, True) if self._has_the_order(item, kind)])
        }
        taken = set(map(id, found.values()))
        position = self._values_of(self._position)
        for family in self._matching("", True):
            values = self._values_of(family)
            if id(family) in taken:
                continue
            if POSITION not in found and _follows(values, position):
                found[POSITION] = family
            elif SPEED not in found and speed is not None and _follows(values, self._values_of(speed)):
                found[SPEED] = family
            elif POSITION not in found:
                self.remarks.append(
                    f"{self._words(family)} is not a command of positions by its values; it was left out."
                )
        return found

    def _has_the_order(self, family: Family, kind: str) -> bool:
        """Whether numbered commands next to joints with names are in their order, by what they follow."""
        if family.by == self._position.by or "array" in (family.by, self._position.by):
            return True
        return kind == POSITION and _follows(self._values_of(family), self._values_of(self._position))

    def _command_sections(self, command: dict[str, Family], units: MotionUnits) -> dict[str, Any]:
        sections: dict[str, Any] = {kind: self._column_list(family) for kind, family in command.items()}
        for kind, measured in ((POSITION, units.position), (SPEED, units.velocity)):
            if kind not in command or "?" in measured or "percent" in measured:
                continue
            stated = self._units_of(command[kind])
            if "?" in stated or "counts" in stated:
                sections[kind] = {"column": sections[kind], "unit": "?"}
                self.questions.append(
                    f"command.{kind}.unit of {self._words(command[kind])}, whose heading is another one"
                )
                continue
            commanded = [heading or unit for heading, unit in zip(stated, measured, strict=True)]
            if kind == POSITION and not any(stated):
                commanded = self._units_of_command(command[kind], measured)
            if commanded != measured:
                sections[kind] = {"column": sections[kind], "unit": _one(commanded)}
        return sections

    def _units_of_command(self, command: Family, measured: list[str]) -> list[str]:
        """Units of commanded positions without headings: not that of the positions where the size says so."""
        sizes = [np.nanstd(values, axis=0) for values in (self._values_of(command), self._values_of(self._position))]
        found = []
        for commanded, position, unit in zip(*sizes, measured, strict=True):
            others = [other for other in ("rad", "deg") if unit in ("rad", "deg") and other != unit and position > 0.0]
            fits = [o for o in others if abs(commanded * ANGLES[o] / (position * ANGLES[unit]) - 1.0) < 0.3]
            found.append(fits[0] if fits else unit)
        return found

    # --- time and gains -----------------------------------------------------------------------------------------------

    def _time(self) -> tuple[dict[str, Any], Array | None]:
        """The section on time, and the clock in s where it is known."""
        rows = len(self._values_of(self._position))
        found: list[tuple[int, str]] = []
        for name, values in self.columns.values.items():
            called = name == STAMP or name in self.columns.stamps or bool(set(words_of(name)) & TIME)
            if not called or values.dtype.kind != "f" or values.size != rows or roles_of(name, {})[0].kind not in (
                "", "other"):  # fmt: skip
                continue
            clock = values.ravel()
            if np.all(np.isfinite(clock)) and np.all(np.diff(clock) >= 0.0) and clock[-1] > clock[0]:
                found.append((len(words_of(name)), name))
        if not found:
            if self.columns.rate_hz:
                return {"rate_hz": float(self.columns.rate_hz)}, np.arange(rows) / self.columns.rate_hz
            self.questions.append("time.rate_hz: rows per second")
            return {"rate_hz": "?"}, None
        name = min(found)[1]
        clock = self.columns.values[name].ravel()
        stated = "s" if name == STAMP or name in self.columns.stamps else stated_unit(
            name, "time", self.columns.units.get(name, ""))  # fmt: skip
        step = float(clock[-1] - clock[0]) / (rows - 1)
        by_size = "s" if step < 0.3 else "ms" if step < 200.0 else "us" if step < 2e5 else "ns"
        unit = stated if stated in TIMES else by_size
        section: dict[str, Any] = {"column": name, "unit": unit}
        if not 2e-5 < step * TIMES[unit] < 0.5:
            section["unit"] = "?"
            self.questions.append(f"time.unit: rows {step * TIMES[unit]:.3g} s apart by {unit} are no log of a motion")
            return section, None
        if self.columns.question:
            section["clock"] = "?"
            self.questions.append(f"time.clock, header or log: {self.columns.question}")
        return section, (clock - clock[0]) * TIMES[unit]

    def _gain(self, kinds: frozenset[str]) -> str | None:
        for name, values in self.columns.values.items():
            single = values.dtype.kind == "f" and values.size in (1, len(self._joints)) and np.all(np.isfinite(values))
            if single and set(words_of(name)) & kinds:
                return name
        return None

    def _without_the_law(
        self, gains: dict[str, str], speed: Family | None, command: dict[str, Family], torque: Family | None
    ) -> Family | None:
        """The measured torque, if it is not the control law of the drives itself; nor is a commanded one then."""
        position = self._values_of(self._position)
        terms = [self._values_of(command[POSITION]) - position]
        if speed is not None:
            commanded = self._values_of(command[SPEED]) if SPEED in command else 0.0
            terms.append(commanded - self._values_of(speed))
        for key, family in (("command", command.get(TORQUE)), ("measured", torque)):
            if family is not None and control_law(terms, self._values_of(family))[0] < THRESHOLDS.exact:
                names = self._column_list(family)
                self.remarks.append(f"{names} is the control law of the drives itself, so it is not a {key} torque.")
                if key == "command":
                    command.pop(TORQUE)
                else:
                    torque = None
        return torque


def _one(units: list[str]) -> str | list[str]:
    """One unit for all, or one for each."""
    return units[0] if len(set(units)) == 1 else units


def _numbers_are_joints(roles: list[ColumnRole], joints: Sequence[str]) -> list[ColumnRole]:
    """Roles in which numbers count from where the joints' do; joints by number where the two differ.

    ``joint_0 …`` of a log are not joint_1 … of a model, although most of the names are the same.
    """
    numbered = {joint for joint in joints if words_of(joint)[-1:] and words_of(joint)[-1].isdigit()}
    by_template: dict[tuple[str, ...], list[ColumnRole]] = {}
    for role in roles:
        if role.joint in numbered:
            by_template.setdefault(role.template, []).append(role)
    odd = {role.template for role in roles if role.number == 0 and any(
        _like(role.template, other) for other in by_template)}  # fmt: skip
    if not odd:
        return roles
    last = {joint: int(words_of(joint)[-1]) for joint in numbered}
    changed = []
    for role in roles:
        if role.joint in numbered:
            place = role.template.index("@")
            template = (*role.template[:place], "joint", "#", *role.template[place + 1 :])
            role = replace(role, joint="", number=last[role.joint], template=template)
        changed.append(role)
    return changed


def _like(numbered: tuple[str, ...], named: tuple[str, ...]) -> bool:
    """Whether two templates are the same but for a joint's name in the place of a number."""
    before, behind = numbered[: numbered.index("#")], numbered[numbered.index("#") + 1 :]
    place = named.index("@")
    return named[place + 1 :] == behind and before[:place] == named[:place]


def _follows(command: Array, values: Array) -> bool:
    """Whether columns are commands of others: in most joints that move they are nearly the same."""
    moving = [number for number in range(values.shape[1]) if np.std(values[:, number]) > 0.0]
    if not moving or command.shape != values.shape:
        return False
    alike = 0
    for number in moving:
        first, second = command[:, number], values[:, number]
        known = np.isfinite(first) & np.isfinite(second)
        if np.count_nonzero(known) < 10 or np.std(first[known]) == 0.0 or np.std(second[known]) == 0.0:
            continue
        correlation = float(np.corrcoef(first[known], second[known])[0, 1])
        gain = float(np.std(first[known]) / np.std(second[known]))
        apart = abs(float(np.mean(first[known]) - np.mean(second[known]))) / float(np.std(second[known]))
        alike += correlation > _LIKE and 0.6 < gain < 1.7 and apart < 1.5
    return alike > 0.7 * len(moving)
