"""Inertias of bodies that differ, and gravity of a base that leans, as edits of a robot's file."""

from __future__ import annotations

from nmt_robots.model.robot_model import BodyChange
from nmt_robots.model.robot_xml import Element
from nmt_robots.verdict.robot_diagnosis import RobotDiagnosis

_ORIENTATION = ("quat", "axisangle", "xyaxes", "zaxis", "euler")


def body_edits(diagnosis: RobotDiagnosis, content: bytes) -> list[tuple[int, int, bytes]]:
    """First byte, byte behind the last, and what stands there instead.

    Args:
        diagnosis: with what was found of the bodies.
        content: the file, UTF-8.
    """
    found = diagnosis.bodies
    if found is None or not found.claimed:
        return []
    file, edits = diagnosis.model.file, []
    bodies = _bodies(file.root, file.is_urdf)
    for change in found.changes:
        element = bodies.get(diagnosis.model.body_name(change.body))
        if element is None:
            continue
        inertial = element.find("inertial")
        text = (
            _of_urdf(change) if file.is_urdf else _of_mjcf(change)
        ) + f" <!-- {found.words.replace('--', '- -')} -->"
        if inertial is not None:
            edits.append((inertial.start, _behind(content, inertial), text.encode()))
        else:
            place = end_of_tag(content, element.start)
            if content[place - 2 : place] != b"/>":
                edits.append((place, place, text.encode()))
    if found.gravity is not None and not file.is_urdf:
        edits += _gravity(file.root, content, " ".join(f"{value:.6g}" for value in found.gravity))
    return edits


def _bodies(root: Element, urdf: bool) -> dict[str, Element]:
    """Elements of bodies by the name of the body, or of the joint that moves it."""
    if urdf:
        return {link.attributes.get("name", ""): link for link in root.all_of("link")}
    found = {}
    for world in root.all_of("worldbody"):
        for body in (item for item in world.below() if item.name == "body"):
            joint = body.find("joint")
            fallback = "" if joint is None else joint.attributes.get("name", "")
            found[body.attributes.get("name") or fallback] = body
    return found


def _of_urdf(change: BodyChange) -> str:
    inertia = change.inertia
    words = " ".join(
        f'{name}="{inertia[row, column]:.6g}"'
        for name, row, column in (("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2), ("iyy", 1, 1), ("iyz", 1, 2),
                                  ("izz", 2, 2))
    )  # fmt: skip
    return (
        f'<inertial><origin xyz="{_three(change.centre)}" rpy="0 0 0"/><mass value="{change.mass:.6g}"/>'
        f"<inertia {words}/></inertial>"
    )


def _of_mjcf(change: BodyChange) -> str:
    inertia = change.inertia
    full = " ".join(f"{inertia[place]:.6g}" for place in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
    moments = 'diaginertia="0 0 0"' if change.mass == 0.0 else f'fullinertia="{full}"'
    return f'<inertial pos="{_three(change.centre)}" mass="{change.mass:.6g}" {moments}/>'


def _three(values: object) -> str:
    return " ".join(f"{value:.6g}" for value in values)  # type: ignore[attr-defined]


def _gravity(root: Element, content: bytes, words: str) -> list[tuple[int, int, bytes]]:
    """Gravity in the option of an MJCF file."""
    option = root.find("option")
    if option is None:
        place = end_of_tag(content, root.start)
        return [(place, place, f'<option gravity="{words}"/>'.encode())]
    end = end_of_tag(content, option.start)
    tag = content[option.start : end].decode()
    if "gravity" in option.attributes:
        first = tag.index("gravity")
        quote = min(place for place in (tag.find('"', first), tag.find("'", first)) if place >= 0)
        last = tag.index(tag[quote], quote + 1)
        return [(option.start, end, f"{tag[: quote + 1]}{words}{tag[last:]}".encode())]
    return [(option.start, end, tag.replace("<option", f'<option gravity="{words}"', 1).encode())]


def _behind(content: bytes, element: Element) -> int:
    """The byte behind an element."""
    end = end_of_tag(content, element.start)
    return end if content[end - 2 : end] == b"/>" else end_of_tag(content, element.end)


def end_of_tag(content: bytes, start: int) -> int:
    """The byte behind a tag; what is in quotes does not end it."""
    quote = 0
    for place in range(start, len(content)):
        byte = content[place]
        if quote:
            quote = 0 if byte == quote else quote
        elif byte in b"\"'":
            quote = byte
        elif byte == ord(">"):
            return place + 1
    return len(content)
