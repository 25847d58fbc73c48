"""Joints that others move: mimic joints of URDF and equality constraints of two joints in MJCF."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]


@dataclass(frozen=True)
class JointCoupling:
    """One joint by another.

    Attributes:
        joint: that is moved.
        master: that moves it; empty = it is held at a constant.
        polynomial: of the master's position from its reference, rad or m, lowest power first; gives the joint's
            position from its reference.
    """

    joint: str
    master: str
    polynomial: tuple[float, ...]

    @property
    def is_ratio(self) -> bool:
        """Whether positions are proportional but for an offset."""
        return bool(self.master) and not any(self.polynomial[2:])


@dataclass(frozen=True)
class Follower:
    """A joint whose position is ``ratio`` times that of a joint of the log, plus ``offset``.

    Attributes:
        joint: its name.
        driver: joint of the log.
        ratio, offset: of its position, rad or m.
    """

    joint: str
    driver: str
    ratio: float
    offset: float


def followers(couplings: Sequence[JointCoupling], names: Sequence[str], references: dict[str, float]) -> list[Follower]:
    """Joints that move with joints of a log; what is coupled to none of them stands still.

    Where several joints of a log are coupled, the one that the others follow drives them.

    Args:
        couplings: of the file, those by a ratio.
        names: joints of the log.
        references: position of each joint at which its polynomial begins.
    """
    edges: dict[str, list[tuple[str, float, float]]] = {}
    for item in couplings:
        offset, ratio = references[item.joint] + item.polynomial[0], item.polynomial[1]
        offset -= ratio * references[item.master]
        edges.setdefault(item.master, []).append((item.joint, ratio, offset))
        edges.setdefault(item.joint, [])
        if ratio != 0.0:
            edges[item.joint].append((item.master, 1.0 / ratio, -offset / ratio))
    moved = {item.joint for item in couplings}
    reached: set[str] = set()
    found = []
    for driver in sorted(names, key=lambda name: name in moved):
        if driver in reached or driver not in edges:
            continue
        reached.add(driver)
        waiting = [(driver, 1.0, 0.0)]
        while waiting:
            joint, ratio, offset = waiting.pop()
            for other, factor, shift in edges[joint]:
                if other not in reached:
                    reached.add(other)
                    found.append(Follower(other, driver, factor * ratio, factor * offset + shift))
                    waiting.append((other, factor * ratio, factor * offset + shift))
    return found
