"""The XML of a robot's file: parsed once, and written again with nothing but what the torque of its bodies needs.

What passes is a list of elements and attributes. An element that would make bodies which do not stand in the file is
refused; all else is left out and named.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from nmt_core.errors import BenchError

_MOST_ELEMENTS = 50_000
_DEEPEST = 200
LARGEST = 1e12
"""Of any number in a robot's file, in SI units."""


@dataclass(eq=False)
class Element:
    """An element of a robot's file.

    Attributes:
        name: its tag.
        attributes: by name.
        line: of its tag, from 1.
        start: byte of the text in UTF-8 at which its tag begins.
        end: the same of its end tag; of one without, the byte behind its tag.
        children: in their order.
    """

    name: str
    attributes: dict[str, str]
    line: int
    start: int
    end: int = 0
    children: list[Element] = field(default_factory=list)

    def find(self, name: str) -> Element | None:
        """The first child of a name."""
        return next((child for child in self.children if child.name == name), None)

    def all_of(self, *names: str) -> list[Element]:
        """Children of some names."""
        return [child for child in self.children if child.name in names]

    def below(self) -> Iterator[Element]:
        """All elements below, in the order of the file."""
        for child in self.children:
            yield child
            yield from child.below()


def parse_robot(text: str, name: str) -> Element:
    """The tree of a robot's file.

    Args:
        text: of the file.
        name: of the file, for sentences.

    Raises:
        BenchError: no XML, too large or too deep, entities, parts in other files, or neither MJCF nor URDF.
    """
    content = text.encode()
    parser = expat.ParserCreate("utf-8")
    root: list[Element] = []
    opened: list[Element] = []
    count = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        line = parser.CurrentLineNumber
        if count > _MOST_ELEMENTS or len(opened) >= _DEEPEST:
            raise BenchError(f"{name} line {line}: the file is nested too deeply or has too many elements for a robot.")
        if tag.startswith("xacro:"):
            raise BenchError(f"{name} line {line} has <{tag}>; expand it first: xacro FILE.xacro > robot.urdf.")
        if tag.lower() == "include":
            raise BenchError(f"{name} includes other files; save it as one file first (mujoco.mj_saveLastXML).")
        element = Element(tag, attributes, line, parser.CurrentByteIndex)
        (opened[-1].children if opened else root).append(element)
        opened.append(element)

    def end(_: str) -> None:
        opened.pop().end = parser.CurrentByteIndex

    def refuse_entities(*_: object) -> None:
        raise BenchError(f"{name} line {parser.CurrentLineNumber} declares a document type or entities; delete that.")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.StartDoctypeDeclHandler = refuse_entities
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        words = expat.errors.messages.get(error.code, "an error")
        raise BenchError(
            f"{name} line {error.lineno} cannot be read as a robot: it is not well-formed XML ({words})."
        ) from error
    if root[0].name not in ("mujoco", "robot"):
        raise BenchError(f"{name} is neither MJCF nor URDF: it has no element <mujoco> or <robot>.")
    return root[0]


def checked_number(word: str, name: str, element: Element, attribute: str, unlimited: bool = False) -> float:
    """A number of an attribute; a limit beyond the largest is that.

    Raises:
        BenchError: it is none, or beyond every robot.
    """
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if unlimited and abs(value) > LARGEST:
        return math.copysign(LARGEST, value)
    if not abs(value) <= LARGEST:
        what = f"{value:g} is beyond every robot" if abs(value) > LARGEST else f"{word[:40]} is not a number"
        raise BenchError(f"{name} line {element.line}: {attribute} of <{element.name}>: {what}; write its value.")
    return value


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_ORIENTATION = "pos quat axisangle xyaxes zaxis euler "
_DRIVE = "name class joint jointinparent gear ctrllimited forcelimited ctrlrange forcerange "
_TENDON = "name class stiffness springlength armature"
_ATTRIBUTES = {
    name: _words(words)
    for name, words in {
        "mujoco": "model",
        "compiler": "autolimits boundmass boundinertia settotalmass balanceinertia angle eulerseq inertiafromgeom "
        "inertiagrouprange meshdir assetdir strippath",
        "option": "gravity",
        "flag": "gravity spring passive",
        "default": "class",
        "asset": "",
        "mesh": "name class file vertex face scale inertia refpos refquat",
        "worldbody": "",
        "body": _ORIENTATION + "name childclass mocap gravcomp",
        "frame": _ORIENTATION + "name childclass",
        "inertial": _ORIENTATION + "mass diaginertia fullinertia",
        "joint": "name class type pos axis springdamper limited range actuatorfrclimited actuatorfrcrange stiffness "
        "springref armature damping frictionloss ref",
        "freejoint": "name",
        "geom": _ORIENTATION + "name class type contype conaffinity group size mass density shellinertia fromto mesh "
        "fitscale",
        "site": _ORIENTATION + "name",
        "tendon": _TENDON,
        "fixed": _TENDON,
        "spatial": _TENDON,
        "pulley": "divisor",
        "actuator": "",
        "motor": _DRIVE,
        "general": _DRIVE + "gaintype biastype gainprm biasprm",
        "position": _DRIVE + "kp kv",
        "velocity": _DRIVE + "kv",
        "intvelocity": _DRIVE + "kp kv",
        "damper": _DRIVE + "kv",
    }.items()
}
_OF_TENDONS = {"joint": _words("joint coef"), "geom": _words("geom sidesite"), "site": _words("site")}
DRIVES = ("motor", "general", "position", "velocity", "intvelocity", "damper")
_BODIES = "body frame inertial joint freejoint geom site"
_CHILDREN = {
    "mujoco": _words("compiler option default asset worldbody tendon actuator"),
    "option": _words("flag"),
    "default": _words(f"default joint geom mesh tendon {' '.join(DRIVES)}"),
    "asset": _words("mesh"),
    "worldbody": _words(_BODIES),
    "body": _words(_BODIES),
    "frame": _words(_BODIES),
    "tendon": _words("fixed spatial"),
    "fixed": _words("joint"),
    "spatial": _words("site geom pulley"),
    "actuator": _words(" ".join(DRIVES)),
}
_WITHOUT_MASS = _words("camera light plugin")
_TEXTS = _words(
    "name class childclass model meshdir assetdir file mesh joint jointinparent site geom sidesite eulerseq type"
)
_LIMITS = _words("range ctrlrange forcerange actuatorfrcrange")


def kept_of_mjcf(root: Element, name: str, left_out: Counter[str]) -> Element:
    """The tree of an MJCF file with what the torque of its bodies needs; joints without names get one.

    Args:
        root: of the file.
        name: of the file, for sentences.
        left_out: takes the names of the elements and attributes that are left out.

    Raises:
        BenchError: an element makes bodies that do not stand in the file, or a number is none.
    """
    return _kept(root, _ATTRIBUTES["mujoco"], name, left_out)


def _kept(element: Element, attributes: frozenset[str], name: str, left_out: Counter[str]) -> Element:
    chosen = {}
    for key, value in element.attributes.items():
        if key in attributes:
            chosen[key] = value if key in _TEXTS else _number_words(value, name, element, key)
        elif element.name in ("compiler", "option", "body", "inertial"):
            left_out[f"{key} of <{element.name}>"] += 1
    allowed, found = _CHILDREN.get(element.name, frozenset()), []
    for child in element.children:
        if child.name not in allowed:
            if element.name in ("worldbody", "body", "frame") and child.name not in _WITHOUT_MASS:
                raise BenchError(
                    f"{name} line {child.line}: <{child.name}> stands for bodies that are not written in the file; "
                    "save it written out first (mujoco.mj_saveLastXML)."
                )
            left_out[f"<{child.name}>"] += 1
        elif element.name == "actuator" and not child.attributes.keys() & {"joint", "jointinparent"}:
            left_out[f"<{child.name}> that acts on no joint"] += 1
        else:
            of_tendon = _OF_TENDONS.get(child.name) if element.name in ("fixed", "spatial") else None
            found.append(_kept(child, of_tendon or _ATTRIBUTES[child.name], name, left_out))
    return replace(element, attributes=chosen, children=found)


def _number_words(value: str, name: str, element: Element, key: str) -> str:
    """The words of an attribute, after a look at those that are numbers."""
    words = value.split()
    for place, word in enumerate(words):
        try:
            float(word)
        except ValueError:
            continue
        number = checked_number(word, name, element, key, key in _LIMITS)
        if number != float(word):
            words[place] = repr(number)
    return " ".join(words)


def with_names_of_joints(root: Element) -> None:
    """Give each joint of the bodies that has no name its number in the file."""
    joints = joints_of_bodies(root)
    names = {joint.attributes.get("name") for joint in joints}
    for number, joint in enumerate(joints):
        if not joint.attributes.get("name"):
            fallback = f"joint{number}"
            while fallback in names:
                fallback += "_"
            joint.attributes["name"] = fallback
            names.add(fallback)


def joints_of_bodies(root: Element) -> list[Element]:
    """The joints of a robot, in the order of the file; nothing of defaults, tendons, comments or ros2_control."""
    if root.name == "robot":
        return root.all_of("joint")
    bodies = [element for world in root.all_of("worldbody") for element in world.below()]
    return [element for element in bodies if element.name in ("joint", "freejoint")]


def xml_text(element: Element) -> str:
    """An element as XML."""
    parts: list[str] = []

    def write(item: Element) -> None:
        words = "".join(f" {key}={quoteattr(value)}" for key, value in item.attributes.items())
        parts.append(f"<{item.name}{words}>")
        for child in item.children:
            write(child)
        parts.append(f"</{item.name}>")

    write(element)
    return "".join(parts)
