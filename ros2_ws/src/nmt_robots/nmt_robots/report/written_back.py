"""A robot's file with the friction, damping and armature that were found, each with its ± in a comment.

The file is changed at the places that its parsed tree names, so that comments, other elements with the same name and
quotes of either kind stay as they are.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from nmt_robots.model.robot_xml import Element, joints_of_bodies
from nmt_robots.report.written_bodies import body_edits, end_of_tag
from nmt_robots.verdict.joint_verdict import OF_ALL_JOINTS
from nmt_robots.verdict.robot_diagnosis import RobotDiagnosis

_MJCF = {"coulomb": "frictionloss", "viscous": "damping", "armature": "armature"}
_URDF = {"coulomb": "friction", "viscous": "damping"}
_ATTRIBUTE = re.compile(rb"""([^\s=<>/'"]+)\s*=\s*("[^"]*"|'[^']*')""")


@dataclass(frozen=True)
class Change:
    """What was found to differ in a joint.

    Attributes:
        joint: its name.
        key, value, std, unit, in_model: of the term.
        alike: causes that are one class with it.
        attribute: of the robot's file that takes it; empty where the format has no word for it.
    """

    joint: str
    key: str
    value: float
    std: float
    unit: str
    in_model: float
    alike: tuple[str, ...]
    attribute: str


def changes(diagnosis: RobotDiagnosis) -> list[Change]:
    """All that differs from the model: bodies first; an attribute only where the file has an element to take it."""
    words = _URDF if diagnosis.model.file.is_urdf else _MJCF
    places = _places(diagnosis)
    return [
        *_of_bodies(diagnosis),
        *_of_joints(diagnosis, words, places),
    ]


def _of_bodies(diagnosis: RobotDiagnosis) -> list[Change]:
    """Numbers of bodies that differ."""
    if diagnosis.bodies is None:
        return []
    written = "inertial" if diagnosis.bodies.changes else ""
    if diagnosis.bodies.kind == "tilt" and not diagnosis.model.file.is_urdf:
        written = "gravity"
    return [
        Change(item.body, item.quantity, item.value, item.std, item.unit, item.in_model, (), written)
        for item in diagnosis.bodies.values
    ]


def _of_joints(diagnosis: RobotDiagnosis, words: dict[str, str], places: dict[str, Element]) -> list[Change]:
    """Terms of joints that differ."""
    return [
        Change(
            joint.joint.name, term.key, term.value, term.std, term.unit, term.in_model, term.equal,
            words.get(term.key, "") if joint.joint.name in places else "",
        )
        for joint in diagnosis.joints
        for term in joint.terms
        if term.differs and term.key not in OF_ALL_JOINTS
    ]  # fmt: skip


def _places(diagnosis: RobotDiagnosis) -> dict[str, Element]:
    """The element of each joint."""
    return {joint.attributes["name"]: joint for joint in joints_of_bodies(diagnosis.model.file.root)}


def robot_text(diagnosis: RobotDiagnosis, changed: list[Change]) -> str:
    """The robot's file with what it has words for; all else stays as it was."""
    content = diagnosis.model.file.text.encode()
    places = _places(diagnosis)
    edits: list[tuple[int, int, bytes]] = []
    of_joints = [change for change in changed if change.joint in places]
    for name in dict.fromkeys(change.joint for change in of_joints if change.attribute):
        items = [change for change in of_joints if change.joint == name and change.attribute]
        edits.append(_edit(content, places[name], items, diagnosis.model.file.is_urdf))
    edits += body_edits(diagnosis, content)
    for start, end, text in sorted(edits, reverse=True):
        content = content[:start] + text + content[end:]
    return content.decode()


def _edit(content: bytes, joint: Element, items: list[Change], urdf: bool) -> tuple[int, int, bytes]:
    """First byte, byte behind the last, and what stands there instead."""
    dynamics = joint.find("dynamics") if urdf else joint
    comment = _comment(items)
    if dynamics is None:
        words = " ".join(_assignment(item) for item in items)
        return joint.end, joint.end, f"<dynamics {words}/> {comment}".encode()
    end = end_of_tag(content, dynamics.start)
    tag = content[dynamics.start : end]
    for item in items:
        tag = _with_attribute(tag, item)
    return dynamics.start, end, tag + f" {comment}".encode()


def _with_attribute(tag: bytes, item: Change) -> bytes:
    """A tag with an attribute set."""
    for match in _ATTRIBUTE.finditer(tag):
        if match[1] == item.attribute.encode():
            return tag[: match.start()] + _assignment(item).encode() + tag[match.end() :]
    head = tag[:-2] if tag.endswith(b"/>") else tag[:-1]
    return head.rstrip() + f" {_assignment(item)}".encode() + tag[len(head) :]


def _assignment(item: Change) -> str:
    return f'{item.attribute}="{item.value:.5g}"'


def _comment(items: list[Change]) -> str:
    words = ", ".join(
        f"{item.attribute} {item.value:.4g} ± {item.std:.1g} {item.unit} (was {item.in_model:.4g}"
        f"{''.join(f'; or {words}' for words in item.alike)})"
        for item in items
    )
    return f"<!-- {words.replace('--', '- -')} -->"
