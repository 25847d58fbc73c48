"""A URDF file as MJCF: links, inertias, joints and simple shapes, as the format defines them.

MuJoCo's reader of URDF merges links that are fixed, takes mass from shapes where a link has no inertia, and does not
know mimic joints; so it is not asked.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from nmt_core.errors import BenchError
from nmt_robots.model.coupling import Array, JointCoupling
from nmt_robots.model.robot_xml import Element, checked_number

_MOVING = {"revolute": "hinge", "continuous": "hinge", "prismatic": "slide"}
_READ = {
    "robot": {"link", "joint"},
    "link": {"inertial", "collision"},
    "joint": {"origin", "parent", "child", "axis", "limit", "dynamics", "mimic"},
}


@dataclass
class UrdfRobot:
    """What a URDF file says.

    Attributes:
        root: as MJCF.
        couplings: of mimic joints.
        others: joints that are neither hinge nor slide, with their type; they stand still.
        zero_limits: joints that move and state an effort or a range of zero.
    """

    root: Element
    couplings: list[JointCoupling] = field(default_factory=list)
    others: dict[str, str] = field(default_factory=dict)
    zero_limits: list[str] = field(default_factory=list)


def urdf_as_mjcf(root: Element, name: str, left_out: Counter[str]) -> UrdfRobot:
    """A URDF file as MJCF.

    Args:
        root: of the file.
        name: of the file, for sentences.
        left_out: takes the names of the elements that are left out.

    Raises:
        BenchError: its links are no tree, or a number or name is missing or wrong.
    """
    for element in (root, *root.all_of("link", "joint")):
        left_out.update(f"<{child.name}>" for child in element.children if child.name not in _READ[element.name])
    reader = _Reader(name, left_out)
    links = {reader.named(link): link for link in root.all_of("link")}
    joints = root.all_of("joint")
    below: dict[str, list[Element]] = {link: [] for link in links}
    parents: dict[str, str] = {}
    for joint in joints:
        reader.named(joint)
        parent, child = (reader.link_of(joint, end, links) for end in ("parent", "child"))
        if child in parents:
            raise BenchError(
                f"{name} line {joint.line}: link {child} has two parents, so the links make a closed loop, whose "
                "torque the angles alone do not tell; log a robot whose links are a tree."
            )
        parents[child] = parent
        below[parent].append(joint)
    roots = [link for link in links if link not in parents]
    if len(roots) != 1:
        listed = f" ({', '.join(roots[:5])})" if roots else ""
        raise BenchError(f"{name} has {len(roots)} links without a parent{listed}; a robot has one, its base.")
    robot = UrdfRobot(_element("mujoco", model="robot"))
    compiler = _element("compiler", angle="radian", autolimits="true", inertiafromgeom="false")
    world = _element("worldbody")
    robot.root.children = [compiler, world]
    reader.link(links[roots[0]], world, root=True)
    waiting = [(joint, world, 1) for joint in reversed(below[roots[0]])]
    while waiting:
        joint, parent_body, depth = waiting.pop()
        if depth > 180:
            raise BenchError(f"{name}: the chain of links is longer than a robot's.")
        body = reader.body(joint, robot, top=parent_body is world)
        parent_body.children.append(body)
        child = reader.link_of(joint, "child", links)
        reader.link(links[child], body)
        waiting += [(item, body, depth + 1) for item in reversed(below[child])]
    moving = {joint.attributes["name"]: joint for joint in joints}
    for joint in joints:
        reader.mimic(joint, moving, robot)
    return robot


def _element(tag: str, /, **attributes: str) -> Element:
    return Element(tag, attributes, 0, 0)


class _Reader:
    """Numbers and names of a URDF file, with sentences on what is wrong."""

    def __init__(self, name: str, left_out: Counter[str]) -> None:
        self._name, self._left_out, self._names = name, left_out, set[tuple[str, str]]()

    def named(self, element: Element) -> str:
        """Name of a link or joint, which no other of its kind may have."""
        found = element.attributes.get("name", "")
        key = element.name, found
        if not found or key in self._names:
            why = f"a second {element.name} has the name {found}" if found else f"<{element.name}> has no name"
            raise BenchError(f"{self._name} line {element.line}: {why}; give each its name.")
        self._names.add(key)
        return found

    def link_of(self, joint: Element, end: str, links: dict[str, Element]) -> str:
        """Link at an end of a joint."""
        element = joint.find(end)
        link = "" if element is None else element.attributes.get("link", "")
        if link not in links:
            raise BenchError(
                f"{self._name} line {joint.line}: joint {joint.attributes['name']} has no {end} link "
                f"{link or 'in it'}; name a link of the file."
            )
        return link

    def body(self, joint: Element, robot: UrdfRobot, top: bool) -> Element:
        """The body behind a joint, with the joint itself."""
        origin = joint.find("origin")
        kind = joint.attributes.get("type", "")
        name = joint.attributes["name"]
        child = joint.find("child")
        assert child is not None
        place = {"pos": _text(self._xyz(origin)), "quat": _text(_quaternion(self._rpy(origin)))}
        body = _element("body", name=child.attributes["link"], **place)
        if kind in _MOVING:
            body.children.append(self._moving(joint, kind, robot))
        elif kind == "floating" and top:
            body.children.append(_element("freejoint", name=name))
        elif kind in ("floating", "planar", "spherical"):
            robot.others[name] = kind
        elif kind != "fixed":
            raise BenchError(f"{self._name} line {joint.line}: joint {name} has the type '{kind}', which URDF has not.")
        return body

    def _moving(self, joint: Element, kind: str, robot: UrdfRobot) -> Element:
        name = joint.attributes["name"]
        axis, dynamics, limit = (joint.find(item) for item in ("axis", "dynamics", "limit"))
        direction = np.array([1.0, 0.0, 0.0]) if axis is None else self._vector(axis, "xyz", 3)
        if not float(np.max(np.abs(direction))) > 1e-9:
            raise BenchError(f"{self._name} line {joint.line}: the axis of joint {name} has no direction.")
        words = {"name": name, "type": _MOVING[kind], "axis": _text(direction / np.linalg.norm(direction))}
        if dynamics is not None:
            words["damping"] = repr(self._number(dynamics, "damping", 0.0))
            words["frictionloss"] = repr(self._number(dynamics, "friction", 0.0))
        if limit is not None:
            effort = abs(self._number(limit, "effort", 0.0, True))
            lower, upper = (self._number(limit, end, 0.0, True) for end in ("lower", "upper"))
            if effort > 0.0:
                words["actuatorfrcrange"] = f"{-effort!r} {effort!r}"
            if kind != "continuous" and lower < upper:
                words["range"] = f"{lower!r} {upper!r}"
            stated_zero = "effort" in limit.attributes and effort == 0.0
            if stated_zero or (kind != "continuous" and lower == upper):
                robot.zero_limits.append(name)
        return _element("joint", **words)

    def link(self, link: Element, body: Element, root: bool = False) -> None:
        """Inertia and simple shapes of a link, into its body; the root link stands still and needs no inertia."""
        inertial = link.find("inertial")
        if inertial is not None and not root:
            self._inertia(inertial, body)
        for collision in link.all_of("collision"):
            geometry = collision.find("geometry")
            shape = None if geometry is None or not geometry.children else geometry.children[0]
            if shape is None:
                continue
            origin = collision.find("origin")
            geom = self._shape(shape)
            if geom is None:
                self._left_out[f"<{shape.name}>"] += 1
                continue
            geom.attributes |= {"pos": _text(self._xyz(origin)), "quat": _text(_quaternion(self._rpy(origin)))}
            body.children.append(geom)

    def _inertia(self, inertial: Element, body: Element) -> None:
        origin, mass, inertia = (inertial.find(item) for item in ("origin", "mass", "inertia"))
        kilograms = 0.0 if mass is None else self._number(mass, "value", 0.0)
        values = [0.0 if inertia is None else self._number(inertia, key, 0.0)
                  for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")]  # fmt: skip
        if kilograms == 0.0 and not any(values):
            return
        xx, yy, zz, xy, xz, yz = values
        turn = rotation(self._rpy(origin))
        moments = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
        rows, columns = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
        body.children.append(
            _element(
                "inertial", pos=_text(self._xyz(origin)), mass=repr(kilograms),
                fullinertia=_text(moments[rows, columns]),
            )
        )  # fmt: skip

    def _shape(self, shape: Element) -> Element | None:
        if shape.name == "box":
            return _element("geom", type="box", size=_text(0.5 * self._size(shape, "size", 3)))
        if shape.name == "sphere":
            return _element("geom", type="sphere", size=_text(self._size(shape, "radius", 1)))
        if shape.name in ("cylinder", "capsule"):
            sizes = np.r_[self._size(shape, "radius", 1), 0.5 * self._size(shape, "length", 1)]
            return _element("geom", type=shape.name, size=_text(sizes)) if np.all(sizes > 0.0) else None
        return None

    def _size(self, shape: Element, key: str, count: int) -> Array:
        return np.maximum(np.abs(self._vector(shape, key, count)), 1e-9)

    def mimic(self, joint: Element, joints: dict[str, Element], robot: UrdfRobot) -> None:
        """What couples a joint to another one."""
        mimic, name = joint.find("mimic"), joint.attributes["name"]
        if mimic is None or joint.attributes.get("type") not in _MOVING:
            return
        master = mimic.attributes.get("joint", "")
        if master not in joints or joints[master].attributes.get("type") not in _MOVING or master == name:
            self._left_out[f"<mimic> of {name}, which names no joint that moves"] += 1
            return
        offset, ratio = self._number(mimic, "offset", 0.0), self._number(mimic, "multiplier", 1.0)
        robot.couplings.append(JointCoupling(name, master, (offset, ratio)))

    def _number(self, element: Element, key: str, otherwise: float, unlimited: bool = False) -> float:
        word = element.attributes.get(key)
        return otherwise if word is None else checked_number(word, self._name, element, key, unlimited)

    def _vector(self, element: Element, key: str, count: int) -> Array:
        words = element.attributes.get(key, "").split()
        if len(words) != count:
            raise BenchError(
                f"{self._name} line {element.line}: {key} of <{element.name}> has {len(words)} numbers, not {count}."
            )
        return np.array([checked_number(word, self._name, element, key) for word in words])

    def _xyz(self, origin: Element | None) -> Array:
        return np.zeros(3) if origin is None or "xyz" not in origin.attributes else self._vector(origin, "xyz", 3)

    def _rpy(self, origin: Element | None) -> Array:
        return np.zeros(3) if origin is None or "rpy" not in origin.attributes else self._vector(origin, "rpy", 3)


def rotation(angles: Array) -> Array:
    """Rotation of roll, pitch and yaw about fixed axes, rad; 3 × 3."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles), np.sin(angles)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _quaternion(angles: Array) -> Array:
    """The same as a quaternion w, x, y, z."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(0.5 * angles), np.sin(0.5 * angles)
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def _text(values: Array) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))
