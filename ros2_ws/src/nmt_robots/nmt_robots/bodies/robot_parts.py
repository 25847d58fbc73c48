"""Parts of a robot's file: what it hangs on a link by fixed or held joints, such as a hand, and the last links."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_robots.log.joint_log import Array
from nmt_robots.model.links import RobotLink, in_frame_of
from nmt_robots.model.robot_model import RobotModel


@dataclass(frozen=True, eq=False)
class MountedPart:
    """Bodies that are mounted together.

    Attributes:
        link: number of the link that carries them.
        bodies: their numbers, those with mass.
        words: name of the first, and how many more there are.
        parameters: 10, of all together in the frame of the link; kg, kg·m, kg·m².
    """

    link: int
    bodies: tuple[int, ...]
    words: str
    parameters: Array

    @property
    def mass(self) -> float:
        """Of all bodies together, kg."""
        return float(self.parameters.item(0))


def parts_of(robot: RobotModel, links: Sequence[RobotLink]) -> list[MountedPart]:
    """What is mounted on links, each set of bodies with mass once, the outermost first."""
    model, data = robot.at_rest()
    found: list[MountedPart] = []
    for number, link in enumerate(links):
        for top in link.bodies[1:]:
            carried = {top}
            for body in link.bodies:
                if int(model.body_parentid[body]) in carried:
                    carried.add(body)
            heavy = tuple(body for body in link.bodies if body in carried and model.body_mass[body] > 0.0)
            if not heavy or any(part.bodies == heavy for part in found):
                continue
            parameters = np.sum([in_frame_of(model, data, link.root, body) for body in heavy], axis=0)
            more = len(heavy) - 1
            words = robot.body_name(heavy[0]) + (f" with {more} more" if more else "")
            found.append(MountedPart(number, heavy, words, parameters))
    return found


def last_links(robot: RobotModel, links: Sequence[RobotLink]) -> list[int]:
    """Numbers of links that carry no other one."""
    model, _ = robot.at_rest()
    roots = {link.root for link in links}
    carrying = set()
    for root in roots:
        above = int(model.body_parentid[root])
        while above and above not in roots:
            above = int(model.body_parentid[above])
        carrying.add(above)
    return [number for number, link in enumerate(links) if link.root not in carrying]
