"""Torque of a robot's joints as columns of the inertial parameters of its links.

A link is what one joint moves: its body and all that hangs on it by fixed or held joints. Its ten parameters, in the
frame of its body, are mass, first moments and second moments about the frame's origin::

    m, m c, I = (xx, yy, zz, xy, xz, yz)

The torque is linear in them (Atkeson, An, Hollerbach 1986): force and moment of each link by Newton and Euler, at the
motion of the log, projected on the axes of the joints before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_robots.model.coupling import Array
from nmt_robots.model.robot_model import RobotModel

_SHORTEST = 0.05
"""Length of a link, at least, m."""


@dataclass(frozen=True, eq=False)
class RobotLink:
    """What one joint moves.

    Attributes:
        joint: its name.
        root: number of the body that the joint moves.
        bodies: numbers of all bodies that move with it, the root first.
        parameters: 10, of all of them together, in the frame of the root; kg, kg·m, kg·m².
        length: from the joint to the next ones, or twice as far as the centre of mass, m.
    """

    joint: str
    root: int
    bodies: tuple[int, ...]
    parameters: Array
    length: float

    @property
    def mass(self) -> float:
        """Of all bodies, kg."""
        return float(self.parameters.item(0))


def links_of(robot: RobotModel, names: Sequence[str]) -> list[RobotLink]:
    """The links of joints of a log, and of those that follow them, in the order of the file."""
    model, data = robot.at_rest()
    everyone = robot.with_followers(names)[0]
    moved = robot.body_joints(everyone)
    found: dict[int, list[int]] = {}
    root_of = np.zeros(model.nbody, dtype=int)
    for body in range(1, model.nbody):
        root_of[body] = body if body in moved else root_of[model.body_parentid[body]]
        if root_of[body]:
            found.setdefault(int(root_of[body]), []).append(body)
    links = []
    for root, bodies in found.items():
        parameters = np.sum([in_frame_of(model, data, root, body) for body in bodies], axis=0)
        next_roots = [body for body in found if body != root and root_of[model.body_parentid[body]] == root]
        reaches = [float(np.linalg.norm(data.xpos[body] - data.xpos[root])) for body in next_roots]
        if not reaches:
            reaches = [2.0 * float(np.linalg.norm(parameters[1:4])) / max(float(parameters.item(0)), 1e-9)]
        length = max(*reaches, _SHORTEST)
        links.append(RobotLink(moved[root][0], root, tuple(bodies), parameters, length))
    return links


def in_frame_of(model: object, data: object, root: int, body: int) -> Array:
    """Ten parameters of a body in the frame of another one that moves with it."""
    turn = data.xmat[root].reshape(3, 3)  # type: ignore[attr-defined]
    centre = turn.T @ (data.xipos[body] - data.xpos[root])  # type: ignore[attr-defined]
    axes = turn.T @ data.ximat[body].reshape(3, 3)  # type: ignore[attr-defined]
    mass = float(model.body_mass[body])  # type: ignore[attr-defined]
    inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T  # type: ignore[attr-defined]
    return parameters_of(mass, centre, inertia)


def parameters_of(mass: float, centre: Array, inertia: Array) -> Array:
    """Ten parameters of mass (kg), centre (3, m) and inertia about it (3 × 3, kg·m²)."""
    about = inertia + mass * (float(centre @ centre) * np.eye(3) - np.outer(centre, centre))
    return np.array([mass, *(mass * centre), *about[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]])


def split_parameters(parameters: Array) -> tuple[float, Array, Array]:
    """Mass, centre and inertia about it of ten parameters."""
    mass = float(parameters.item(0))
    centre = parameters[1:4] / mass
    xx, yy, zz, xy, xz, yz = parameters[4:]
    about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return mass, centre, about - mass * (float(centre @ centre) * np.eye(3) - np.outer(centre, centre))


class LinkMotion:
    """Motion of all links over the rows of a log.

    Args:
        robot: whose links move.
        names: J joints of the columns.
        q, v, a: rows × J, rad, rad/s, rad/s².
    """

    def __init__(self, robot: RobotModel, names: tuple[str, ...], q: Array, v: Array, a: Array) -> None:
        self._model, _ = robot.at_rest()
        everyone, ratios, offsets = robot.with_followers(names)
        self._joints = robot.numbers_of(everyone)
        self._shares = robot.shares(names)
        self._sliding = robot.sliding()
        self._q, self._v, self._a = q @ ratios + offsets, v @ ratios, a @ ratios
        self.links = links_of(robot, names)
        self._frames = robot.frames(everyone, self._q)

    def columns(self, gravity: Array, still: bool = False) -> dict[tuple[int, int], Array]:
        """Rows × 10 for a named joint and a link: its torque per unit of each parameter of the link, N·m.

        Args:
            gravity: 3, m/s².
            still: whether the robot is at rest in each pose.
        """
        wrenches = self._wrenches(gravity, still)
        everyone: dict[tuple[int, int], Array] = {}
        for number, link in enumerate(self.links):
            place, turn = self._frames.position[:, link.root], self._frames.turn[:, link.root]
            for joint, jnt in enumerate(self._joints):
                if self._above(int(self._model.jnt_bodyid[jnt]), link.root):
                    axis = _into(turn, self._frames.axis[:, jnt])
                    column = np.einsum("ri,rij->rj", axis, wrenches[number][:, 3:])
                    arm = _into(turn, place - self._frames.anchor[:, jnt])
                    if self._slides(jnt):
                        column = np.einsum("ri,rij->rj", axis, wrenches[number][:, :3])
                    else:
                        column += np.einsum("ri,rij->rj", np.cross(axis, arm), wrenches[number][:, :3])
                    everyone[joint, number] = column
        found: dict[tuple[int, int], Array] = {}
        for (joint, number), column in everyone.items():
            for named in np.flatnonzero(self._shares[:, joint]):
                key = int(named), number
                part = self._shares[named, joint] * column
                found[key] = found[key] + part if key in found else part
        return found

    def _slides(self, jnt: int) -> bool:
        return self._sliding[jnt]

    def _above(self, body: int, other: int) -> bool:
        """Whether a body is another one or carries it."""
        while other and other != body:
            other = int(self._model.body_parentid[other])
        return other == body

    def _wrenches(self, gravity: Array, still: bool) -> list[Array]:
        """For each link rows × 6 × 10: force and moment at its origin, in its frame, per unit of each parameter."""
        model, frames = self._model, self._frames
        rows = len(self._q)
        nothing = np.zeros((rows, 3))
        state = {0: (nothing, nothing, nothing, np.zeros((rows, 3)))}
        place = {int(jnt): column for column, jnt in enumerate(self._joints)}
        for body in range(1, model.nbody):
            w, dw, a, at = state[int(model.body_parentid[body])]
            first = int(model.body_jntadr[body])
            for jnt in range(first, first + int(model.body_jntnum[body])) if first >= 0 else ():
                if jnt not in place or still:
                    continue
                axis, anchor = frames.axis[:, jnt], frames.anchor[:, jnt]
                rate, change = (values[:, [place[jnt]]] * axis for values in (self._v, self._a))
                a, at = a + _shifted(w, dw, anchor - at), anchor
                if self._slides(jnt):
                    a = a + change + 2.0 * np.cross(w, rate)
                else:
                    w, dw = w + rate, dw + change + np.cross(w, rate)
            a, at = a + _shifted(w, dw, frames.position[:, body] - at), frames.position[:, body]
            state[body] = w, dw, a, at
        found = []
        for link in self.links:
            w, dw, a, _ = state[link.root]
            turn = frames.turn[:, link.root]
            found.append(_wrench(_into(turn, w), _into(turn, dw), _into(turn, a - gravity)))
        return found


def _into(turn: Array, vectors: Array) -> Array:
    """Vectors in frames whose axes are the columns of ``turn``."""
    return np.asarray(np.einsum("rji,rj->ri", turn, vectors))


def _shifted(w: Array, dw: Array, arm: Array) -> Array:
    return np.asarray(np.cross(dw, arm) + np.cross(w, np.cross(w, arm)))


def _cross(vectors: Array) -> Array:
    """Rows × 3 × 3 that make the cross product with each vector."""
    found = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    found[:, 0, 1], found[:, 0, 2], found[:, 1, 2] = -z, y, -x
    found[:, 1, 0], found[:, 2, 0], found[:, 2, 1] = z, -y, x
    return found


def _moments(vectors: Array) -> Array:
    """Rows × 3 × 6: I w as a matrix times (xx, yy, zz, xy, xz, yz)."""
    found = np.zeros((len(vectors), 3, 6))
    x, y, z = vectors.T
    found[:, 0, 0], found[:, 0, 3], found[:, 0, 4] = x, y, z
    found[:, 1, 1], found[:, 1, 3], found[:, 1, 5] = y, x, z
    found[:, 2, 2], found[:, 2, 4], found[:, 2, 5] = z, x, y
    return found


def _wrench(w: Array, dw: Array, a: Array) -> Array:
    """Newton and Euler: rows × 6 × 10."""
    found = np.zeros((len(w), 6, 10))
    turning = _cross(w)
    found[:, :3, 0] = a
    found[:, :3, 1:4] = _cross(dw) + turning @ turning
    found[:, 3:, 1:4] = -_cross(a)
    found[:, 3:, 4:] = _moments(dw) + turning @ _moments(w)
    return found
