"""What a column of a log is by its name: quantity, whether it was commanded, joint or number, and unit."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from nmt_record.exchange.source_table import split_name

POSITION, SPEED, TORQUE, CURRENT = "position", "velocity", "torque", "current"


def _listed(words: str) -> frozenset[str]:
    return frozenset(words.split())


_KINDS = {
    POSITION: _listed("pos position positions q qpos angle angles theta jpos"),
    SPEED: _listed("vel velocity velocities dq qd qvel qdot speed speeds omega dtheta jvel"),
    TORQUE: _listed("torque torques tau effort efforts trq force forces"),
    CURRENT: _listed("current currents amp amps iq load"),
    "": _listed("acc accel acceleration accelerations ddq qdd qacc ddot dtau jerk"),
}
_KIND_OF = {word: kind for kind, words in _KINDS.items() for word in words}
_COMMAND = _listed(
    "des desired cmd cmds command commands commanded target targets tgt ref reference references goal goals setpoint "
    "setpoints action actions sp ff feedforward demand demanded ctrl d"
)
_MEASURED = _listed("actual act meas measured feedback fb est estimated estimate present sensor sensed")
_PLAIN = _listed("joint joints dof values value data state states interface link name motor") | _MEASURED
_OTHER = _listed(
    "error errors err temp temperature temperatures voltage volt limit limits max min std var ext external residual "
    "gravity model friction status mode id base imu foot cartesian ee tcp covariance stamp time diff"
)
TIME = _listed("t time times stamp timestamp timestamps sec secs seconds clock elapsed tick")
KP = _listed("kp stiffness pgain")
KD = _listed("kd dgain kv")
NAMES = _listed("names name joints")

UNITS: dict[str, dict[str, str]] = {
    POSITION: {
        **dict.fromkeys(("rad", "rads", "radian", "radians"), "rad"),
        **dict.fromkeys(("deg", "degs", "degree", "degrees", "°"), "deg"),
        **dict.fromkeys(("turn", "turns", "rev", "revs", "revolutions", "rotations", "rotation"), "turn"),
        **dict.fromkeys(("%", "percent", "pct"), "percent"),
        **dict.fromkeys(("m", "metre", "meter", "metres", "meters"), "m"), "mm": "mm", "cm": "cm", "mrad": "mrad",
        **dict.fromkeys(("counts", "count", "ticks", "tick", "raw", "steps", "step", "lsb"), "counts"),
    },
    SPEED: {
        **dict.fromkeys(("rad/s", "rads", "radps", "radpers"), "rad/s"),
        **dict.fromkeys(("deg/s", "degs", "dps", "degps", "degpers", "°/s"), "deg/s"),
        **dict.fromkeys(("rpm", "1/min", "rev/min", "revpermin"), "rpm"),
        **dict.fromkeys(("turn/s", "turns/s", "rev/s", "turnpers", "revpers"), "turn/s"),
        **dict.fromkeys(("m/s", "ms", "mps"), "m/s"), **dict.fromkeys(("mm/s", "mms", "mmps"), "mm/s"),
        **dict.fromkeys(("cm/s", "cms"), "cm/s"), **dict.fromkeys(("%", "percent", "pct"), "percent"),
    },
    TORQUE: {
        **dict.fromkeys(("nm", "n*m", "n·m", "newtonmetre"), "N*m"), **dict.fromkeys(("mnm", "nmm"), "mN*m"),
        "ncm": "N*cm", "knm": "kN*m", "n": "N", "newton": "N", "kn": "kN", **dict.fromkeys(("kgfcm", "kgcm"), "kgf*cm"),
        **dict.fromkeys(("kgfm", "kgm"), "kgf*m"), **dict.fromkeys(("a", "amp", "amps"), "A"), "ma": "mA",
        **dict.fromkeys(("%", "percent", "pct"), "percent"),
    },
    "time": {
        **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), "s"),
        **dict.fromkeys(("ms", "msec", "msecs", "millis", "milliseconds"), "ms"),
        **dict.fromkeys(("us", "usec", "usecs", "µs", "micros", "microseconds"), "us"),
        **dict.fromkeys(("ns", "nsec", "nsecs", "nanos", "nanoseconds"), "ns"),
    },
}  # fmt: skip
"""Units by how headings spell them without blanks, points and stars."""
UNITS[CURRENT] = UNITS[TORQUE]
_LETTERS = frozenset(("m", "n", "a", "ms"))
"""Units that are no unit where a name ends so without brackets."""


@dataclass(frozen=True)
class ColumnRole:
    """What a column is by its name.

    Attributes:
        column: its name.
        kind: position, velocity, torque or current; empty where its name does not say it.
        commanded: whether it is a command.
        template: words with ``@`` for the joint or ``#`` for a number.
        joint: of the robot; empty where the name has none.
        number: in the place of a joint; −1 = none.
        noise: words that say nothing; of two columns the one with fewer is meant.
        unit: that the heading states, as sidecars spell it; empty = none.
    """

    column: str
    kind: str
    commanded: bool
    template: tuple[str, ...]
    joint: str = ""
    number: int = -1
    noise: int = 0
    unit: str = ""


@dataclass(eq=False)
class Family:
    """Columns whose names differ in a joint or a number only, or one column for all joints.

    Attributes:
        kind, commanded, noise: of all.
        by: ``joint``, ``number`` or ``array``.
        columns: by joint or number; of an array one, called ``""``.
        units: stated by the headings, as the columns.
    """

    kind: str
    commanded: bool
    noise: int
    by: str
    columns: dict[str | int, str] = field(default_factory=dict)
    units: dict[str | int, str] = field(default_factory=dict)


def words_of(name: str) -> tuple[str, ...]:
    """Words and numbers of a name, in small letters; ``j1``, ``axis_1`` and ``joint1`` are the same."""
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    words = [word.lower() for word in re.findall(r"[^\W\d_]+|\d+|%|°", parted)]
    for place in range(len(words) - 1):
        if words[place] in ("j", "jnt", "axis", "jt", "dof") and words[place + 1].isdigit():
            words[place] = "joint"
    return tuple(words)


def _squeezed(unit: str) -> str:
    text = unit.strip().strip("[](){}").lower().replace("sec", "s").replace("°", "deg")
    return re.sub(r"[\s.·⋅*_-]", "", text)


def _bare(name: str) -> str:
    """A name without the unit in brackets behind it; a number there is none."""
    bare, unit = split_name(name)
    return name if unit.strip().isdigit() else bare


def stated_unit(name: str, kind: str, stated: str = "") -> str:
    """Unit of a column by what its file or its heading states, as sidecars spell it.

    Args:
        name: of the column.
        kind: of its values.
        stated: by the file.

    Returns:
        Empty where none is stated; ``?`` where the stated one is none of the kind's.
    """
    known = UNITS.get(kind, {})
    bracket = stated or split_name(name)[1]
    if bracket:
        if bracket.strip().isdigit():
            return ""
        found = known.get(_squeezed(bracket)) or known.get(bracket.strip().lower())
        return found or ("?" if any(_squeezed(bracket) in units for units in UNITS.values()) else "")
    words = words_of(name)
    for length in (3, 2, 1):
        tail = "".join(words[-length:])
        certain = length > 1 or tail not in _LETTERS or name.endswith(("_A", "_N"))
        if len(words) > length and tail in known and certain:
            return known[tail]
    return ""


def _unit_words(words: tuple[str, ...], kind: str) -> int:
    """How many words at the end of a name are its unit."""
    known = UNITS.get(kind, {})
    return next((n for n in (3, 2, 1) if len(words) > n and "".join(words[-n:]) in known), 0)


def joint_words(joints: Sequence[str]) -> dict[tuple[str, ...], str]:
    """By what words columns may call a robot's joints; what would mean two joints is left out."""
    all_words = {joint: words_of(joint) for joint in joints}
    found: dict[tuple[str, ...], str] = {words: joint for joint, words in all_words.items()}
    if len(joints) > 1:
        first, last = 0, 0
        every = list(all_words.values())
        while all(len(words) > first + 1 and words[first] == every[0][first] for words in every):
            first += 1
        while all(len(words) > first + last + 1 and words[-1 - last] == every[0][-1 - last] for words in every):
            last += 1
        shorter = [(words[first : len(words) - last], joint) for joint, words in all_words.items()]
        # A number alone is not a name.
        shorter = [(words if not words[0].isdigit() else ("joint", *words), joint) for words, joint in shorter]
        found |= dict(shorter) if len({words for words, _ in shorter}) == len(joints) else {}
    bare = [(tuple(w for w in words if w not in ("joint", "jnt")), joint) for joint, words in all_words.items()]
    for words, joint in bare:
        if words and not all(word.isdigit() for word in words) and [w for w, _ in bare].count(words) == 1:
            found.setdefault(words, joint)
    return found


def roles_of(name: str, joints: dict[tuple[str, ...], str], stated: str = "") -> list[ColumnRole]:
    """What a column may be: by the joint in its name, or by each number in it.

    Args:
        name: of the column.
        joints: by their words, :func:`joint_words`.
        stated: unit by the file.
    """
    words = words_of(_bare(name))
    best: tuple[int, int, str] = (0, 0, "")
    for start in range(len(words)):
        for length in range(len(words) - start, best[1], -1):
            if (joint := joints.get(words[start : start + length])) is not None:
                best = start, length, joint
                break
    if best[1]:
        start, length, joint = best
        template = (*words[:start], "@", *words[start + length :])
        return [_role(name, template, joint, -1, stated)]
    places = [place for place, word in enumerate(words) if word.isdigit()]
    if not places:
        return [_role(name, words, "", -1, stated)]
    return [
        _role(name, (*words[:place], "#", *words[place + 1 :]), "", int(words[place]), stated)
        for place in places
        if len(words[place]) < 6
    ]


def _role(name: str, template: tuple[str, ...], joint: str, number: int, stated: str) -> ColumnRole:
    words = [word for word in template if word not in "@#" and not word.isdigit()]
    kinds = [_KIND_OF[word] for word in words if word in _KIND_OF]
    speaking = [kind for kind in kinds if kind != CURRENT] or kinds
    kind = speaking[-1] if speaking else ""
    if kind == POSITION and "dot" in words:
        kind = SPEED
    unit = stated_unit(name, kind, stated)
    # What ends a name as its unit is not another word of it.
    tail = _unit_words(tuple(words), kind) if _bare(name) == name else 0
    words = words[: len(words) - tail]
    template = template[: len(template) - tail]
    turns = [word for word in words if word in _COMMAND or (word in _MEASURED and word != "act")]
    commanded = bool(turns) and turns[-1] in _COMMAND
    # A point in space is not a joint's.
    in_space = not joint and bool(words) and words[-1] in ("x", "y", "z", "w")
    if in_space or "ddot" in words or (speaking and not kind) or set(words) & _OTHER:
        return ColumnRole(name, "other", commanded, template, joint, number, 0, unit)
    known = _KIND_OF.keys() | _COMMAND | _PLAIN | {"dot"}
    noise = sum(word not in known for word in words) + sum(word in ("motor", "rotor") for word in words)
    return ColumnRole(name, kind, commanded, template, joint, number, noise, unit)


def families_of(roles: Sequence[ColumnRole], widths: dict[str, int]) -> list[Family]:
    """Columns with one name but for the joint or a number, and columns of several values.

    Args:
        roles: of all columns.
        widths: columns of N × J values, and J.
    """
    found: dict[tuple[object, ...], Family] = {}
    alike: dict[tuple[object, ...], list[Family]] = {}
    for role in roles:
        if role.kind == "other":
            continue
        by = "array" if role.column in widths else "joint" if role.joint else "number"
        place: str | int = "" if by == "array" else role.joint or role.number
        template = (role.column,) if by == "array" else role.template
        family = found.get((by, *template))
        if family is None:
            family = found[(by, *template)] = Family(role.kind, role.commanded, role.noise, by)
            same = tuple(role.kind if _KIND_OF.get(word) == role.kind else word for word in template)
            alike.setdefault((by, *same), []).append(family)
        family.columns.setdefault(place, role.column)
        family.units.setdefault(place, role.unit)
    joined: list[Family] = []
    for first, *others in alike.values():
        # The force of a slide belongs to the torques of joints that turn.
        for other in others:
            if first.by == "joint" and not first.columns.keys() & other.columns.keys():
                first.columns |= other.columns
                first.units |= other.units
            else:
                joined.append(other)
        joined.append(first)
    kept = [family for family in joined if family.by != "number" or len(family.columns) > 1 or not any(
        role.number >= 0 for role in roles if role.column in family.columns.values())]  # fmt: skip
    for family in kept:
        if family.by == "number":
            family.columns = dict(sorted(family.columns.items(), key=lambda item: int(item[0])))
    return kept
