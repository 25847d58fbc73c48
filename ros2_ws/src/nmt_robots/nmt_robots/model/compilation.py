"""A robot's file, parsed once, with what the torque of its bodies needs; compiled by MuJoCo in a child with limits."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_text
from nmt_core.files.limited_child import ChildError, run_limited
from nmt_robots.model.coupling import Follower, JointCoupling
from nmt_robots.model.robot_xml import (
    DRIVES,
    Element,
    checked_number,
    joints_of_bodies,
    kept_of_mjcf,
    parse_robot,
    with_names_of_joints,
    xml_text,
)
from nmt_robots.model.urdf_as_mjcf import urdf_as_mjcf

LARGEST_FILE = 2**24
_LARGEST_MODEL = 2**28
_LONGEST = 60
"""Bytes of a robot's file and of its compiled model, and seconds that compiling it may take."""
_MOST_ANSWERS = 32
_ANSWERS: dict[str, tuple[bytes, str]] = {}
"""Models and facts of texts that need no mesh, by text, joints and followers."""


@dataclass(frozen=True)
class RobotFile:
    """A robot's file.

    Attributes:
        path: of it.
        text: as it is.
        root: its tree.
        kept: MJCF with what is read of it.
        is_urdf: whether it is URDF.
        couplings: of its joints.
        others: joints that are neither hinge nor slide, with their type.
        zero_limits: joints whose effort or range is stated as zero.
        unlimited: joints with a drive whose limit is not read.
        left_out: names of elements and attributes that are not read.
    """

    path: Path
    text: str
    root: Element
    kept: str
    is_urdf: bool
    couplings: tuple[JointCoupling, ...]
    others: dict[str, str]
    zero_limits: tuple[str, ...]
    unlimited: frozenset[str]
    left_out: tuple[str, ...]


def read_robot(path: Path) -> RobotFile:
    """Read a robot's file.

    Raises:
        BenchError: it cannot be read or is not a robot; it has closed loops.
    """
    text = read_text(path, "robot file", LARGEST_FILE)
    root = parse_robot(text, str(path))
    left_out: Counter[str] = Counter()
    if root.name == "robot":
        robot = urdf_as_mjcf(root, str(path), left_out)
        return RobotFile(
            path, text, root, xml_text(robot.root), True, tuple(robot.couplings), robot.others,
            tuple(robot.zero_limits), frozenset(), tuple(left_out),
        )  # fmt: skip
    with_names_of_joints(root)
    couplings = _equalities(root, path)
    drives = [drive for actuator in root.all_of("actuator") for drive in actuator.children]
    unlimited = frozenset(drive.attributes.get("joint", "") for drive in drives if drive.name not in DRIVES)
    kept = kept_of_mjcf(root, str(path), left_out)
    left_out.pop("<equality>", None)
    return RobotFile(path, text, root, xml_text(kept), False, couplings, {}, (), unlimited, tuple(left_out))


def _equalities(root: Element, path: Path) -> tuple[JointCoupling, ...]:
    """Couplings of two joints.

    Raises:
        BenchError: other constraints close a loop.
    """
    found = []
    mocap = {item.attributes.get("name") for item in root.below() if item.attributes.get("mocap") == "true"}
    joints = {joint.attributes["name"] for joint in joints_of_bodies(root)}
    for item in (child for equality in root.all_of("equality") for child in equality.children):
        words = item.attributes
        to_mocap = {words.get("body1"), words.get("body2")} & mocap - {None}
        if words.get("active") == "false" or to_mocap:
            continue
        if item.name != "joint":
            raise BenchError(
                f"{path} line {item.line} closes a loop (equality {item.name}), whose torque the angles alone do not "
                "tell; only an open chain of hinges and slides can be diagnosed."
            )
        names = [words.get("joint1", ""), words.get("joint2", "")]
        for name in names[: 1 + bool(names[1])]:
            if name not in joints:
                raise BenchError(
                    f"{path} line {item.line}: the coupling names joint '{name}', which is not in the file."
                )
        polynomial = words.get("polycoef", "0 1 0 0 0").split()
        numbers = tuple(checked_number(word, str(path), item, "polycoef") for word in polynomial)
        found.append(JointCoupling(names[0], names[1], (*numbers, 0.0, 0.0)[: max(2, len(numbers))]))
    return tuple(found)


def compiled(
    mujoco: Any, robot: RobotFile, joints: Sequence[str] | None = None, moved: Sequence[Follower] = ()
) -> tuple[Any, dict[str, Any]]:
    """The compiled model, and what was noticed of its bodies.

    Args:
        mujoco: the library.
        robot: its file.
        joints: that move, without drives and tendons; all others stand still where the file has them. None = all.
        moved: joints that follow some of them.

    Returns:
        MuJoCo's model; names of bodies: ``free`` that float alone and are not in it, ``gravcomp``, and ``impossible``
        inertias with what is wrong.

    Raises:
        BenchError: MuJoCo refuses it, a mesh that gives mass is missing, or it needs too much memory or time.
    """
    question = {
        "text": robot.kept,
        "keep": None if joints is None else list(joints),
        "followers": [[item.joint, item.driver, item.ratio, item.offset] for item in moved],
    }
    key = json.dumps(question)
    answer = _ANSWERS.get(key) or _answer(str(robot.path), question | {"folder": str(robot.path.parent.absolute())})
    if not json.loads(answer[1])["meshes"]:  # a mesh may change while the text stays
        _ANSWERS[key] = answer
        if len(_ANSWERS) > _MOST_ANSWERS:
            del _ANSWERS[next(iter(_ANSWERS))]
    with TemporaryDirectory() as folder:
        target = Path(folder) / "robot.mjb"
        target.write_bytes(answer[0])
        return mujoco.MjModel.from_binary_path(str(target)), json.loads(answer[1])


def _answer(name: str, request: dict[str, Any]) -> tuple[bytes, str]:
    """Bytes of the model and facts of a child."""
    with TemporaryDirectory() as place:
        folder = Path(place)
        try:
            words = (str(_LARGEST_MODEL), str(_LONGEST))
            source = json.dumps(request).encode()
            run_limited("nmt_robots.model.robot_child", words, _LONGEST, source, folder=folder)
        except ChildError as failure:
            if failure.is_memory:
                raise BenchError(
                    f"{name} needs more than the {_LARGEST_MODEL // 2**20} MiB that a robot may have; leave out what "
                    "is not a robot."
                ) from None
            what = "" if failure.kind.endswith("BenchError") else " cannot be read as a robot"
            raise BenchError(f"{name}{what}: {failure.why.rstrip('.')}.") from None
        return (folder / "robot.mjb").read_bytes(), (folder / "facts.json").read_text(encoding="utf-8")
