"""Sealed robots one of whose bodies is not as in the file: torque by Lagrange's equations on 4 × 4 matrices.

The product's torque is that of MuJoCo and of Newton and Euler; here it is Uicker's form of Lagrange's equations with
pseudo-inertias, whose accelerations are second differences of the frames over time::

    τ_j = Σ_i tr(∂T_i/∂q_j J_i T̈_iᵀ) − gᵀ ∂T_i/∂q_j J_i e₄

In ``./nmt shell``, 72 clean cases and 48 with ripple, drift and friction that falls
with speed, which the product does not fit with the bodies::

    python -m nmt_laboratories.body_cases [--dirty] [--seeds N] [--first SEED] [--kinds KIND …]
"""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from nmt_laboratories.campaign_frame import command_parser

Array = Any
GRAVITY = np.array([0.0, 0.0, -9.81])
RATE_HZ, SECONDS = 250.0, 20.0
KINDS = ("none", "part", "mass", "centre", "payload", "tilt", "constant", "two")
ROBOTS = ("arm6", "arm7", "leg")
SMALLEST = 0.03
"""Share of every joint's torque below which a change is not asked for."""


@dataclass(frozen=True, eq=False)
class Body:
    """A link of a chain, with the joint before it; a fixed one has no axis."""

    name: str
    offset: Array
    axis: Array | None
    mass: float
    centre: Array
    inertia: Array

    def pseudo(self) -> Array:
        """4 × 4 about the origin of its frame."""
        spread = 0.5 * np.trace(self.inertia) * np.eye(3) - self.inertia
        found = np.empty((4, 4))
        found[:3, :3] = spread + self.mass * np.outer(self.centre, self.centre)
        found[:3, 3] = found[3, :3] = self.mass * self.centre
        found[3, 3] = self.mass
        return found


@dataclass(frozen=True, eq=False)
class Truth:
    """What a case is: kind, body or joint by name, and size."""

    kind: str
    place: str = ""
    size: float = 0.0
    effect: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, eq=False)
class Case:
    """File, log and truth."""

    urdf: str
    columns: dict[str, Array]
    truth: Truth


def chain(robot: str, rng: np.random.Generator) -> list[Body]:
    """Links of a robot as the file has them."""
    x, y, z = np.eye(3)
    plans = {
        "arm6": ([z, y, y, y, z, y], [0.15, 0.13, 0.42, 0.38, 0.1, 0.1], [3.7, 8.0, 2.3, 1.2, 1.2, 0.4], (0.9, 0.12)),
        "arm7": ([z, y, z, y, z, y, z], [0.33, 0.1, 0.3, 0.1, 0.35, 0.1, 0.12], [4.9, 2.6, 3.2, 3.0, 1.5, 1.6, 0.7],
                 (0.76, 0.14)),
        "leg": ([x, y, y], [0.0, 0.08, 0.25], [1.9, 1.6, 0.5], (0.35, 0.24)),
    }  # fmt: skip
    axes, steps, masses, (hung, far) = plans[robot]
    down = -1.0 if robot == "leg" else 1.0
    found = []
    reach = [*steps[1:], far]
    for number, (axis, step, mass) in enumerate(zip(axes, steps, masses, strict=True)):
        # Beyond a shoulder links lie across the axis that turns them.
        aside = 0.06 * x if robot == "arm7" and number in (3, 6) else np.zeros(3)
        length = max(reach[number], 0.08)
        offset = down * step * z + aside if robot != "leg" else (y * step if number == 1 else -step * z)
        centre = down * 0.45 * length * z + 0.02 * rng.standard_normal(3)
        radius = np.sort(rng.uniform(0.2, 0.45, 3))[::-1] * length * np.array([1.0, 1.0, 0.6]) + 0.02
        inertia = mass * np.diag([radius[1] ** 2 + radius[2] ** 2, radius[0] ** 2 + radius[2] ** 2,
                                  radius[0] ** 2 + radius[1] ** 2]) / 2.0  # fmt: skip
        found.append(Body(f"link{number + 1}", offset, axis, mass * rng.uniform(0.8, 1.2), centre, inertia))
    name = "foot" if robot == "leg" else "hand"
    tool = hung * np.diag([0.002, 0.002, 0.001])
    found.append(Body(name, down * far * z, None, hung, 0.04 * down * z + 0.005 * x, tool))
    return found


def torque_of(bodies: list[Body], q: Array, q_before: Array, q_after: Array, step: float, gravity: Array) -> Array:
    """Torque of each joint, rows × J, N·m; accelerations by frames a moment before and after each row."""
    axes = [body.axis for body in bodies if body.axis is not None]
    generators = [np.zeros((4, 4)) for _ in axes]
    for generator, (a, b, c) in zip(generators, axes, strict=True):
        generator[:3, :3] = [[0, -c, b], [c, 0, -a], [-b, a, 0]]
    frames, before, after = (_frames(bodies, generators, values) for values in (q, q_before, q_after))
    found = np.zeros_like(q)
    rows = 0
    for number, body in enumerate(bodies):
        rows += body.axis is not None
        curve = (after[number] - 2.0 * frames[number] + before[number]) / step**2
        # The pull of gravity acts on the fourth column, the position.
        curve[:, :3, 3] -= gravity
        pull = np.einsum("nab,bc->nac", curve, body.pseudo())
        placed = 0
        for other in range(number + 1):
            if bodies[other].axis is None:
                continue
            turned = frames[other] @ generators[placed] @ np.linalg.inv(frames[other]) @ frames[number]
            found[:, placed] += np.einsum("nab,nab->n", turned, pull)
            placed += 1
    return found


def _frames(bodies: list[Body], generators: list[Array], q: Array) -> list[Array]:
    """Rows × 4 × 4 of each body."""
    frame, found, joint = np.broadcast_to(np.eye(4), (len(q), 4, 4)), [], 0
    for body in bodies:
        step = np.broadcast_to(np.eye(4), (len(q), 4, 4)).copy()
        step[:, :3, 3] = body.offset
        if body.axis is not None:
            k, angle = generators[joint], q[:, joint, None, None]
            step[:, :3, :3] += np.sin(angle) * k[:3, :3] + (1.0 - np.cos(angle)) * (k @ k)[:3, :3]
            joint += 1
        frame = frame @ step
        found.append(frame)
    return found


def changed(bodies: list[Body], kind: str, rng: np.random.Generator) -> tuple[list[Body], Array, Array, Truth]:
    """The bodies as they are, gravity in the base's frame, factor of each measured torque, and the truth."""
    moving = [number for number, body in enumerate(bodies) if body.axis is not None]
    width = len(moving)
    bodies, gravity, factor, truth = list(bodies), GRAVITY.copy(), np.ones(width), Truth(kind)
    # The first link turns about a vertical axis, or hardly moves its mass.
    able = moving[1:]
    if kind == "part":
        truth = Truth(kind, bodies[-1].name, bodies[-1].mass)
        bodies[-1] = replace(bodies[-1], mass=0.0, inertia=np.zeros((3, 3)))
    elif kind == "mass":
        number = int(rng.choice(able))
        bodies[number] = _heavier(bodies[number], 1.3)
        truth = Truth(kind, bodies[number].name, 0.3)
    elif kind == "centre":
        number = int(rng.choice(able))
        body = bodies[number]
        bodies[number] = replace(body, centre=body.centre + 0.03 * np.array([0.0, 0.0, np.sign(body.centre[2])]))
        truth = Truth(kind, body.name, 0.03)
    elif kind == "payload":
        load = 0.5
        place = bodies[-1].centre + rng.uniform(-0.03, 0.03, 3)
        bodies.append(Body("load", place, None, load, np.zeros(3), load * 4e-4 * np.eye(3)))
        truth = Truth(kind, bodies[width - 1].name, load)
    elif kind == "tilt":
        about = rng.uniform(0.0, 2.0 * np.pi)
        lean = np.radians(3.0) * np.array([np.cos(about), np.sin(about), 0.0])
        gravity = gravity + np.cross(lean, gravity)
        truth = Truth(kind, "", np.radians(3.0))
    elif kind == "constant":
        number = int(rng.integers(1, width))
        factor[number] = 1.08 if rng.uniform() < 0.5 else 0.92
        truth = Truth(kind, f"joint{number + 1}", factor[number] - 1.0)
    elif kind == "two":
        first, second = sorted(rng.choice(able, 2, replace=False).tolist())
        bodies[first], bodies[second] = _heavier(bodies[first], 1.3), _heavier(bodies[second], 0.7)
        truth = Truth(kind, f"{bodies[first].name} {bodies[second].name}", 0.3)
    return bodies, gravity, factor, truth


def _heavier(body: Body, factor: float) -> Body:
    return replace(body, mass=factor * body.mass, inertia=factor * body.inertia)


def tolerated(body: Body, rng: np.random.Generator) -> Body:
    """The body as it is within the tolerances of a file."""
    length = max(float(np.linalg.norm(body.centre)) * 2.0, 0.05)
    return replace(
        _heavier(body, float(np.exp(0.01 * rng.standard_normal()))),
        centre=body.centre + 0.005 * length * rng.standard_normal(3),
    )


def make_case(robot: str, kind: str, seed: int, dirty: bool = False) -> Case:
    """A robot's file and a log of 20 s with measured torques."""
    rng = np.random.default_rng([seed, ROBOTS.index(robot), KINDS.index(kind), int(dirty)])
    bodies = chain(robot, rng)
    real = [tolerated(body, rng) for body in bodies]
    changed_, gravity, factor, truth = changed(real, kind, rng)
    width = sum(body.axis is not None for body in bodies)
    rows = np.arange(int(SECONDS * RATE_HZ)) / RATE_HZ
    omega = 2.0 * np.pi * rng.uniform(0.08, 1.1, (width, 5))
    phase = rng.uniform(0.0, 2.0 * np.pi, (width, 5))
    reach = 0.32 / np.sqrt(1.0 + omega / 4.0)
    middle = np.where(np.arange(width) % 2, 0.5, -0.4) * rng.uniform(0.6, 1.4, width)

    def at(shift: float) -> Array:
        angle = omega[:, :, None] * (rows + shift) + phase[:, :, None]
        return (middle[:, None] + np.sum(reach[:, :, None] * np.sin(angle), axis=1)).T

    moment = 2e-4
    q, before, after = at(0.0), at(-moment), at(moment)
    speed = (after - before) / (2.0 * moment)
    torque = torque_of(changed_, q, before, after, moment, gravity)
    plain = torque_of(real, q, before, after, moment, GRAVITY)
    size = np.sqrt(np.mean(plain**2, axis=0))
    truth = replace(truth, effect=np.sqrt(np.mean((torque * factor - plain) ** 2, axis=0)) / size)
    if kind == "two":
        # Each of the two is asked for where it alone takes enough.
        alone = {}
        for name in truth.place.split():
            one = [
                changed_one if changed_one.name == name else usual
                for changed_one, usual in zip(changed_, real, strict=True)
            ]
            moved = torque_of(one, q, before, after, moment, GRAVITY) - plain
            alone[name] = float(np.max(np.sqrt(np.mean(moved**2, axis=0)) / size))
        asked = [name for name, effect in alone.items() if effect >= SMALLEST]
        truth = replace(truth, kind=("none", "mass", "two")[len(asked)], place=" ".join(asked))
    coulomb = rng.uniform(0.04, 0.1, width) * size
    damping = rng.uniform(0.01, 0.03, width) * size
    friction = coulomb * np.sign(speed) * (0.9 + 0.2 * rng.uniform(size=width)) + damping * speed
    if dirty:
        friction = friction + 0.4 * coulomb * np.sign(speed) * np.exp(-((speed / 0.1) ** 2))
        orders = rng.integers(5, 12, width)
        friction = friction + 0.014 * size * np.sin(orders * q + phase[:, 0])
        friction = friction + 0.02 * size * (rows[:, None] / SECONDS - 0.5)
    measured = (torque + friction) * factor + 0.005 * size * rng.standard_normal(q.shape)
    counts = 2.0 * np.pi / 2**18
    columns = {
        "time": rows, "names": np.array([f"joint{number + 1}" for number in range(width)]),
        "position": np.round(q / counts) * counts, "velocity": speed + 1e-3 * rng.standard_normal(q.shape),
        "torque": measured,
    }  # fmt: skip
    return Case(urdf_of(bodies, coulomb, damping), columns, truth)


def urdf_of(bodies: list[Body], coulomb: Array, damping: Array) -> str:
    """The robot's file."""
    links, joints, before, number = ['<link name="base"/>'], [], "base", 0
    for body in bodies:
        ixx, iyy, izz = np.diag(body.inertia)
        links.append(
            f'<link name="{body.name}"><inertial><origin xyz="{_words(body.centre)}"/><mass value="{body.mass:.9g}"/>'
            f'<inertia ixx="{ixx:.9g}" iyy="{iyy:.9g}" izz="{izz:.9g}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )
        ends = f'<parent link="{before}"/><child link="{body.name}"/><origin xyz="{_words(body.offset)}"/>'
        if body.axis is None:
            joints.append(f'<joint name="mount_{body.name}" type="fixed">{ends}</joint>')
        else:
            joints.append(
                f'<joint name="joint{number + 1}" type="revolute">{ends}<axis xyz="{_words(body.axis)}"/>'
                f'<limit lower="-3" upper="3" effort="500" velocity="10"/>'
                f'<dynamics damping="{damping[number]:.6g}" friction="{coulomb[number]:.6g}"/></joint>'
            )
            number += 1
        before = body.name
    return f'<robot name="sealed">{"".join(links)}{"".join(joints)}</robot>'


def _words(values: Array) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def judged(finding: Any, truth: Truth) -> str:
    """``right``, ``class`` (the truth is among those that cannot be told apart), ``unsure`` or ``wrong``.

    Args:
        finding: of the bodies; None where they were not asked.
        truth: of the case.
    """
    kind, subjects = ("not asked", ()) if finding is None else (finding.kind, finding.subjects)
    largest = float(np.max(truth.effect, initial=0.0))
    wanted = {"none"} if truth.kind == "none" or largest < SMALLEST else answers(truth)
    if truth.kind != "none" and largest < 1.7 * SMALLEST:
        wanted.add("none")
    if kind in ("unknown", "not asked", "joint"):
        return "class" if wanted & set(subjects) else "unsure"
    if truth.kind == "several" and any(item.startswith(("all", "several", "pair")) for item in subjects):
        return "right"
    return "right" if wanted & set(subjects) else "wrong"


def answers(truth: Truth) -> set[str]:
    """What may be answered, as kind and places; a payload on the last link is that link with more in it."""
    if truth.kind in ("mass", "centre"):
        return {f"link {truth.place}"}
    if truth.kind == "payload":
        return {f"payload {truth.place}", f"link {truth.place}"}
    if truth.kind == "two":
        places = (truth.place, " ".join(reversed(truth.place.split())))
        return {f"{kind} {place}" for kind in ("pair", "several") for place in places}
    return {f"{truth.kind} {truth.place}".strip()}


def tally(seeds: range, dirty: bool, kinds: tuple[str, ...] = KINDS) -> tuple[Counter[str], list[str]]:
    """Counts of the verdicts, and a line for each case."""
    from nmt_robots.bodies.body_finding import body_finding
    from nmt_robots.log.joint_log import JointLog
    from nmt_robots.model.robot_model import RobotModel

    counts, lines = Counter[str](), []
    for seed in seeds:
        for robot in ROBOTS:
            for kind in kinds:
                case = make_case(robot, kind, seed, dirty)
                with tempfile.TemporaryDirectory() as folder:
                    path = Path(folder) / "sealed.urdf"
                    path.write_text(case.urdf)
                    begun = time.process_time()
                    model = RobotModel(path)
                    names = tuple(str(name) for name in case.columns["names"])
                    log = JointLog("sealed", names, case.columns["time"], case.columns["position"],
                                   torque=case.columns["torque"])  # fmt: skip
                    found = body_finding(model, log, case.columns["torque"], model.chosen(names))
                    assert found is not None
                    seconds = time.process_time() - begun
                verdict = judged(found, case.truth)
                counts[verdict] += 1
                lines.append(
                    f"{verdict:7} {robot} {kind} {seed} {case.truth.place} "
                    f"effect {np.max(case.truth.effect, initial=0.0):.3f} -> {found.kind} "
                    f"{', '.join(found.subjects)} ({found.probability:.3f}) {seconds:.1f} s"
                )
                print(lines[-1], flush=True)
    return counts, lines


def main() -> None:
    """Diagnose the bodies of all cases and count."""
    parser = command_parser(__doc__)
    parser.add_argument("--dirty", action="store_true")
    parser.add_argument("--seeds", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kinds", nargs="*", default=KINDS)
    asked = parser.parse_args()
    count = asked.seeds or (2 if asked.dirty else 3)
    counts, _ = tally(range(asked.first, asked.first + count), asked.dirty, tuple(asked.kinds))
    print(dict(counts))


if __name__ == "__main__":
    main()
