"""A robot's file with the friction, damping and armature that were found, each with its ± in a comment."""

from __future__ import annotations

import re
from dataclasses import dataclass

from nmt_robots.verdict.robot_diagnosis import RobotDiagnosis

_MJCF = {"coulomb": "frictionloss", "viscous": "damping", "armature": "armature"}
_URDF = {"coulomb": "friction", "viscous": "damping"}


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
    """All terms that differ from the model."""
    words = _URDF if is_urdf(diagnosis.model.text) else _MJCF
    return [
        Change(
            joint.joint.name, term.key, term.value, term.std, term.unit, term.in_model, term.equal,
            words.get(term.key, ""),
        )
        for joint in diagnosis.joints
        for term in joint.terms
        if term.differs
    ]  # fmt: skip


def is_urdf(text: str) -> bool:
    """Whether a robot's file is URDF."""
    return re.search(r"<robot\b", text) is not None


def robot_text(diagnosis: RobotDiagnosis, changed: list[Change]) -> str:
    """The robot's file with what it has words for; all else stays as it was."""
    text = diagnosis.model.text
    for name in dict.fromkeys(change.joint for change in changed):
        items = [change for change in changed if change.joint == name and change.attribute]
        if items:
            text = _in_urdf(text, name, items) if is_urdf(text) else _in_mjcf(text, name, items)
    return text


def _comment(items: list[Change]) -> str:
    words = ", ".join(
        f"{item.attribute} {item.value:.4g} ± {item.std:.1g} {item.unit} (was {item.in_model:.4g}"
        f"{''.join(f'; or {words}' for words in item.alike)})"
        for item in items
    )
    return f"<!-- {words} -->"


def _in_mjcf(text: str, name: str, items: list[Change]) -> str:
    """Attributes of the element ``joint`` of that name."""

    def put(match: re.Match[str]) -> str:
        tag = match[0]
        for item in items:
            tag = _with_attribute(tag, item)
        return f"{tag} {_comment(items)}"

    return re.sub(rf'<joint\b[^>]*\bname="{re.escape(name)}"[^>]*>', put, text, count=1)


def _in_urdf(text: str, name: str, items: list[Change]) -> str:
    """Attributes of ``dynamics`` in the joint of that name, which is made where it is missing."""

    def put(match: re.Match[str]) -> str:
        element = match[0]
        found = re.search(r"<dynamics\b[^>]*>", element)
        tag = found[0] if found else "<dynamics/>"
        changed = tag
        for item in items:
            changed = _with_attribute(changed, item)
        changed = f"{changed} {_comment(items)}"
        if found:
            return element.replace(tag, changed, 1)
        return element.replace("</joint>", f"{changed}</joint>", 1)

    return re.sub(rf'<joint\b[^>]*\bname="{re.escape(name)}".*?</joint>', put, text, count=1, flags=re.S)


def _with_attribute(tag: str, item: Change) -> str:
    """A tag with an attribute set."""
    value = f'{item.attribute}="{item.value:.5g}"'
    pattern = rf'\b{item.attribute}="[^"]*"'
    if re.search(pattern, tag):
        return re.sub(pattern, value, tag, count=1)
    return re.sub(r"\s*(/?)>$", lambda match: f" {value}{match[1]}>", tag)
