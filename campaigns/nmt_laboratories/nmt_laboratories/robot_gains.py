"""Joints under three sets of gains: each log by itself is to name the same cause, of the same size within its ±.

Run in ``./nmt shell``::

    python -m nmt_laboratories.robot_gains --joints 0:20
    python -m nmt_laboratories.robot_gains --joints 0:20 --lag 30

Each joint is the geared one of laboratory four with one effect, whose drive has half, once and twice the gains. The
torque is computed in joints of even number and measured in the others. With ``--lag`` the logger writes position, speed
and torque later than the command by as much at most, or the drive gets the command later than it is written: each log
by itself is then to name its cause, too.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from nmt_laboratories import laboratory_four
from nmt_laboratories.campaign_frame import command_parser, seeds_of
from nmt_laboratories.laboratory_four import ROBOTS, believed, changed_links, links_of, sidecar_of, sizes_of
from nmt_laboratories.simulated_robot import SECONDS, STEP_S, Cause, Chain, Robot, command_of, logged, robot_text
from nmt_robots.verdict.joint_verdict import JointTerm
from nmt_robots.verdict.robot_diagnosis import diagnose_robot

EFFECTS = ("coulomb", "armature", "spring", "load_friction", "viscous")
FACTORS = (0.5, 1.0, 2.0)


def make_logs(folder: Path, number: int, lag_s: float = 0.0) -> list[Path]:
    """Write the logs of a joint, one for each set of gains; their folders.

    Args:
        folder: for them.
        number: of the joint.
        lag_s: largest lag of motion behind command or the reverse, s.
    """
    names, axes = ROBOTS["geared"]
    rng = np.random.default_rng([6, number])
    nominal = links_of("geared", rng)
    model = believed(nominal, rng)
    effect = EFFECTS[number % len(EFFECTS)]
    causes = [Cause(effect, 0, sizes_of(effect, rng))]
    links = [dict(link) for link in nominal]
    changed_links(links, causes)
    chain = Chain(2, 4, 5e-4, 3e-4, 2.0**16, bool(number % 2), 0.01)
    time = np.arange(int(SECONDS / STEP_S)) * STEP_S
    command = command_of(time, np.array([-0.3]), rng)
    command = command[(np.arange(len(time)) // chain.log_steps) * chain.log_steps]
    folders = []
    lags = np.random.default_rng([7, number]).uniform(-lag_s, lag_s, len(FACTORS))
    for factor, lag in zip(FACTORS, lags, strict=True):
        kp, kd = np.array([80.0 * factor]), np.array([2.0 * factor])
        text = robot_text(names, axes, links)
        delay = max(round(lag / STEP_S), 0)
        followed = np.vstack([np.repeat(command[:1], delay, axis=0), command[: len(command) - delay]])
        late = [Cause("measurement_late", -1, {"delay": -lag})] if lag < 0.0 else []
        motion = Robot(text, causes, (kp, kd), chain).run(followed)
        columns = logged(motion, command, chain, [*causes, *late], rng)
        case = folder / f"{number:03d}_{factor:g}"
        case.mkdir(parents=True)
        (case / "robot.xml").write_text(robot_text(names, axes, model))
        if not chain.measured:
            columns.pop("tau")
        np.savez(case / "log.npz", **columns, kp=kp, kd=kd)
        (case / "log.yaml").write_text(yaml.safe_dump(sidecar_of(names, chain.measured), sort_keys=False))
        folders.append(case)
    return folders


def compared(terms: Sequence[JointTerm | None]) -> tuple[bool, list[float]]:
    """Whether all logs name the same cause, and differences of the sizes of those that do, in combined ±."""
    same = len({term.key if term is not None else "" for term in terms}) == 1
    found = []
    for first, second in combinations(terms, 2):
        if first is not None and second is not None and first.key == second.key:
            found.append((first.value - second.value) / float(np.hypot(first.std, second.std)))
    return same, found


def main() -> None:
    """Make, diagnose and compare the logs of each joint."""
    parser = command_parser(__doc__)
    parser.add_argument("--joints", type=seeds_of, required=True, metavar="FIRST:END", help="the end is left out")
    parser.add_argument("--lag", type=float, default=0.0, metavar="MS", help="largest lag in a log (default 0)")
    asked = parser.parse_args()
    same_cause, apart, answers = 0, [], Counter[str]()
    for number in asked.joints:
        with tempfile.TemporaryDirectory() as folder:
            terms: list[Any] = []
            for case in make_logs(Path(folder), number, 1e-3 * asked.lag):
                (joint,) = diagnose_robot(case / "robot.xml", case / "log.yaml").joints
                terms.append(next((term for term in joint.terms if term.differs), None))
        right = laboratory_four.EFFECTS[EFFECTS[number % len(EFFECTS)]][0]
        answers.update("silent" if term is None else "right" if term.key in right else "wrong" for term in terms)
        same, differences = compared(terms)
        same_cause += same
        apart += differences
        words = ", ".join(
            "nothing" if term is None else f"{term.key} {term.value:.3g} ± {term.std:.2g}" for term in terms
        )
        print(f"{number}: {EFFECTS[number % len(EFFECTS)]}: {words}", flush=True)
    within = sum(abs(value) <= 2.0 for value in apart)
    print(f"same cause in {same_cause} of {len(asked.joints)} joints; {within} of {len(apart)} pairs within 2 ±")
    print("logs: " + ", ".join(f"{count} {answer}" for answer, count in sorted(answers.items())))


if __name__ == "__main__":
    main()
