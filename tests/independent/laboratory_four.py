"""Laboratory four: robots simulated by MuJoCo with a drive, an encoder and a logger, one cause or none in each.

An arm and a leg with three joints and a single geared joint are driven by a PD law at 1 kHz that holds its command,
log a quantised encoder, a filtered speed and a measured or computed torque, and are known by a model with the ordinary
errors of a user. Run from the root of the repository::

    PYTHONPATH=tests python -m independent.laboratory_four make --seeds 0:24 --out four
    PYTHONPATH=tests python -m independent.laboratory_four score four

``make`` writes a folder for each case: ``robot.xml``, ``log.npz``, ``log.yaml`` and ``truth.yaml``, which no diagnosis
sees. ``score`` diagnoses every case and compares.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from independent.campaign import seeds_of

MECHANICAL = ("coulomb", "viscous", "armature", "spring", "gravity", "ripple")
LOGGED = ("torque_lag", "command_held", "velocity_late", "clock_factor", "rows_repeated", "velocity_sign")
KINDS = ("healthy", "mechanical", "log", "mechanical", "outside", "mechanical")
"""In turn; outside: friction that changes with the temperature, which no library has."""
STEP_S = 5e-4
LOG_EVERY = 4


@dataclass(frozen=True)
class Truth:
    """What is true of a case."""

    kind: str
    cause: str
    joint: str
    size: float
    factor: float


def arm(names: tuple[str, ...], axes: tuple[str, ...], inertias: list[dict[str, Any]]) -> str:
    """A chain of links as MJCF."""
    text, ends = "", ""
    for name, axis, link in zip(names, axes, inertias, strict=True):
        diagonal = " ".join(f"{x:.6g}" for x in link["inertia"])
        centre = " ".join(f"{x:.6g}" for x in link["centre"])
        text += (
            f'<body name="{name}_link" pos="0 0 {-link["before"]:.4g}">'
            f'<inertial pos="{centre}" mass="{link["mass"]:.6g}" diaginertia="{diagonal}"/>'
            f'<joint name="{name}" axis="{axis}" range="-3 3" armature="{link["armature"]:.6g}" '
            f'damping="{link["damping"]:.6g}" frictionloss="{link["coulomb"]:.6g}"/>'
        )
        ends += "</body>"
    return (
        '<mujoco model="laboratory"><compiler angle="radian"/>'
        f'<option timestep="{STEP_S}" integrator="implicitfast"/><worldbody>{text}{ends}</worldbody></mujoco>'
    )


ROBOTS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "arm": (("base", "shoulder", "elbow"), ("0 0 1", "0 1 0", "0 1 0")),
    "leg": (("hip", "thigh", "calf"), ("1 0 0", "0 1 0", "0 1 0")),
    "geared": (("drive",), ("0 1 0",)),
}


def links_of(robot: str, rng: Any) -> list[dict[str, Any]]:
    """True links."""
    links = []
    for number in range(len(ROBOTS[robot][0])):
        mass = float(rng.uniform(0.8, 3.0)) / (1.0 + 0.7 * number)
        length = float(rng.uniform(0.2, 0.35))
        links.append({
            "mass": mass, "before": 0.0 if number == 0 else links[-1]["length"], "length": length,
            "centre": [0.01, 0.0, -0.45 * length], "inertia": [mass * length**2 / 10.0] * 2 + [mass * length**2 / 40.0],
            "armature": float(rng.uniform(0.02, 0.06)), "damping": float(rng.uniform(0.15, 0.5)),
            "coulomb": float(rng.uniform(0.3, 0.8)),
        })  # fmt: skip
    return links


def believed(links: list[dict[str, Any]], rng: Any) -> list[dict[str, Any]]:
    """The same with the ordinary errors of a user."""
    found = []
    for link in links:
        found.append({
            **link,
            "mass": link["mass"] * (1 + 0.02 * rng.standard_normal()),
            "centre": [x + 0.002 * float(rng.standard_normal()) for x in link["centre"]],
            "inertia": [x * (1 + 0.05 * float(np.clip(rng.standard_normal(), -2, 2))) for x in link["inertia"]],
            "armature": link["armature"] * (1 + 0.05 * rng.standard_normal()),
            "damping": link["damping"] * (1 + 0.15 * rng.standard_normal()),
            "coulomb": link["coulomb"] * (1 + 0.10 * rng.standard_normal()),
        })  # fmt: skip
        # A diagonal inertia must keep its triangle.
        largest = max(found[-1]["inertia"])
        found[-1]["inertia"] = [max(x, 0.51 * largest) if x != largest else x for x in found[-1]["inertia"]]
    return found


def command_of(time_s: Any, joints: int, rng: Any) -> Any:
    """Chirp and slow sines, out of phase between the joints."""
    columns = []
    for joint in range(joints):
        phase = 2.0 * np.pi * (0.15 * time_s + 0.5 * (0.08 + 0.01 * joint) * time_s**2)
        slow = 0.35 * np.sin(2.0 * np.pi * (0.11 + 0.03 * joint) * time_s + rng.uniform(0, 6))
        fade = 0.4 / (1.0 + 0.05 * time_s)
        columns.append(0.3 * (joint - 1) + slow + fade * np.sin(phase + rng.uniform(0, 6)))
    return np.column_stack(columns)


def simulate(links: list[dict[str, Any]], robot: str, truth: Truth, rng: Any, held: int) -> dict[str, Any]:
    """The real robot and its log, at 500 Hz for 24 s."""
    import mujoco

    names, axes = ROBOTS[robot]
    model = mujoco.MjModel.from_xml_string(arm(names, axes, links))
    model.dof_frictionloss[:] = 0.0
    data = mujoco.MjData(model)
    count = int(24.0 / STEP_S)
    times = np.arange(count) * STEP_S
    command = command_of(times, len(names), rng)
    every = held * LOG_EVERY
    command = command[(np.arange(count) // every) * every]
    delay = round(truth.size / STEP_S) if truth.cause == "torque_lag" else 0
    coulomb = np.array([link["coulomb"] for link in links])
    kp = np.array([80.0, 60.0, 40.0][: len(names)])
    kd = np.array([2.0, 1.5, 1.0][: len(names)])
    hit = names.index(truth.joint) if truth.joint else -1
    q, v, applied = (np.empty((count, len(names))) for _ in range(3))
    torque = np.zeros(len(names))
    data.qpos[:] = command[0]
    queue = [torque] * (delay + 1)
    for row in range(count):
        if row % 2 == 0:
            torque = kp * (command[row] - data.qpos) - kd * data.qvel
        queue.append(torque)
        acting = queue[-1 - delay]
        q[row], v[row], applied[row] = data.qpos, data.qvel, torque
        friction = coulomb * np.tanh(data.qvel / 1e-3)
        extra = np.zeros(len(names))
        if truth.cause == "spring":
            extra[hit] = truth.size * data.qpos[hit]
        elif truth.cause == "ripple":
            extra[hit] = truth.size * np.sin(12.0 * data.qpos[hit])
        elif truth.cause == "temperature":
            extra[hit] = truth.size * np.exp(-times[row] / 8.0) * np.tanh(data.qvel[hit] / 1e-3)
        data.qfrc_applied[:] = acting - friction - extra
        mujoco.mj_step(model, data)
    return logged(times, q, v, command, applied, kp, kd, truth, rng)


def logged(
    times: Any, q: Any, v: Any, command: Any, torque: Any, kp: Any, kd: Any, truth: Truth, rng: Any
) -> dict[str, Any]:
    """What the logger makes of it."""
    counts = 2.0 * np.pi / 2**16
    rows = slice(None, None, LOG_EVERY)
    late = round(truth.size / STEP_S) if truth.cause == "velocity_late" else 0
    speed = np.vstack([np.repeat(v[:1], late, axis=0), v[: len(v) - late]]) if late else v
    position = np.round(q[rows] / counts) * counts
    speed = speed[rows] + 0.002 * rng.standard_normal(position.shape)
    clock = times[rows] * (truth.size if truth.cause == "clock_factor" else 1.0)
    if truth.cause == "velocity_sign":
        speed = -speed
    if truth.cause == "rows_repeated":
        again = np.flatnonzero(rng.uniform(size=len(position)) < truth.size)
        again = again[again > 0]
        position[again], speed[again] = position[again - 1], speed[again - 1]
    return {
        "time": clock, "q": position, "dq": speed, "q_des": command[rows], "kp": kp, "kd": kd,
        "tau": torque[rows] + 0.01 * np.std(torque, axis=0) * rng.standard_normal(position.shape),
    }  # fmt: skip


def draw(seed: int) -> tuple[str, Truth]:
    """Robot and cause of a case."""
    rng = np.random.default_rng([4, seed])
    robot = list(ROBOTS)[seed % len(ROBOTS)]
    kind = KINDS[(seed // len(ROBOTS)) % len(KINDS)]
    joint = str(rng.choice(ROBOTS[robot][0]))
    if kind == "healthy":
        return robot, Truth(kind, "", "", 0.0, 1.0)
    if kind == "outside":
        return robot, Truth(kind, "temperature", joint, float(rng.uniform(0.5, 1.0)), 1.0)
    if kind == "log":
        cause = str(rng.choice(LOGGED))
        sizes = {"torque_lag": 0.008, "command_held": 6.0, "velocity_late": 0.006, "clock_factor": 1.05,
                 "rows_repeated": 0.1, "velocity_sign": -1.0}  # fmt: skip
        return robot, Truth(kind, cause, "", sizes[cause], 1.0)
    cause = str(rng.choice(MECHANICAL))
    factor = float(rng.uniform(1.8, 3.0))
    size = {"spring": 3.0, "ripple": 0.4}.get(cause, 0.0) * float(rng.uniform(0.8, 1.5))
    return robot, Truth(kind, cause, joint, size, factor)


def make_case(folder: Path, seed: int) -> str:
    """Write a case that is not there yet."""
    robot, truth = draw(seed)
    name = f"{robot}_{seed:03d}"
    case = folder / name
    if (case / "truth.yaml").is_file():
        return name
    rng = np.random.default_rng([5, seed])
    nominal = links_of(robot, rng)
    model = believed(nominal, rng)
    names, axes = ROBOTS[robot]
    links = [dict(link) for link in nominal]
    size = truth.size
    if truth.cause in ("coulomb", "viscous", "armature"):
        key = {"viscous": "damping"}.get(truth.cause, truth.cause)
        links[names.index(truth.joint)][key] *= truth.factor
        size = links[names.index(truth.joint)][key]
    elif truth.cause == "gravity":
        links[names.index(truth.joint)]["mass"] *= 1.0 + 0.15 * truth.factor
        size = 0.15 * truth.factor
    held = int(truth.size) if truth.cause == "command_held" else 1
    columns = simulate(links, robot, truth, rng, held)
    case.mkdir(parents=True, exist_ok=True)
    (case / "robot.xml").write_text(arm(names, axes, model))
    measured = bool(seed % 2)
    if not measured or truth.kind == "log":
        columns.pop("tau")
        measured = False
    np.savez(case / "log.npz", **columns)
    sidecar: dict[str, Any] = {
        "robot_log": 1, "data": "log.npz", "joints": list(names), "time": {"column": "time"},
        "position": {"column": "q"}, "velocity": {"column": "dq"}, "command": {"position": "q_des"},
        "gains": {"kp": "kp", "kd": "kd"},
    }  # fmt: skip
    if measured:
        sidecar["torque"] = {"column": "tau"}
    (case / "log.yaml").write_text(yaml.safe_dump(sidecar, sort_keys=False))
    facts = {"kind": truth.kind, "cause": truth.cause, "joint": truth.joint, "size": float(size)}
    (case / "truth.yaml").write_text(yaml.safe_dump(facts, sort_keys=False))
    return name


NAMED = {
    "gravity": ("gravity_scale", "mass_centre", "spring", "inertia_scale", "armature", "offset"),
    "spring": ("spring", "gravity_scale", "mass_centre"),
}
"""Terms that are the cause or its honest class, where those are not the cause alone."""


def judge(case: Path) -> dict[str, Any]:
    """Diagnose a case and class the answer."""
    from nmt_core.errors import BenchError
    from nmt_robots.verdict.robot_diagnosis import diagnose_robot

    truth = yaml.safe_load((case / "truth.yaml").read_text())
    begin = time.process_time()
    try:
        answer = diagnose_robot(case / "robot.xml", case / "log.yaml")
    except BenchError as error:
        return {"case": case.name, **truth, "outcome": "refused", "answer": str(error), "cpu_s": 0.0}
    cpu = time.process_time() - begin
    differing = {
        joint.joint.name: [term for term in joint.terms if term.differs] for joint in answer.joints if joint.differs
    }
    faults = sorted({finding.key for finding in answer.findings if finding.fault})
    words = "; ".join(f"{name}: {', '.join(t.key for t in terms)}" for name, terms in differing.items())
    outcome = _outcome(truth, differing, faults)
    deviation = np.nan
    for term in differing.get(truth["joint"], []):
        if term.key == truth["cause"] and truth["size"]:
            deviation = (term.value - truth["size"]) / term.std
    left = max((joint.left / joint.torque for joint in answer.joints if joint.mechanics is not None), default=np.nan)
    return {
        "case": case.name, **truth, "outcome": outcome, "answer": f"[{', '.join(faults)}] {words}", "cpu_s": cpu,
        "deviation": float(deviation), "left": float(left),
    }  # fmt: skip


def _outcome(truth: dict[str, Any], differing: dict[str, list[Any]], faults: list[str]) -> str:
    """Right, or how it is wrong."""
    if truth["kind"] == "healthy":
        return "right" if not differing and not faults else "alarm"
    if truth["kind"] == "log":
        named = truth["cause"] in faults
        if named and not differing:
            return "right"
        return "named, mechanics beside it" if named else "missed"
    terms = differing.get(truth["joint"], [])
    if truth["kind"] == "outside":
        return "right" if not terms or terms[0].key in ("coulomb", "viscous") else "misnamed"
    wanted = NAMED.get(truth["cause"], (truth["cause"],))
    if terms and terms[0].key in wanted:
        others = [name for name in differing if name != truth["joint"]]
        return "right, others beside it" if others or (faults and faults != ["rows_repeated"]) else "right"
    if any(term.key in wanted for term in terms):
        return "among others"
    return "wrong" if differing else "missed"


def main() -> None:
    """Make or score."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parts = parser.add_subparsers(dest="part", required=True)
    make = parts.add_parser("make", help="write cases")
    make.add_argument("--seeds", type=seeds_of, required=True, metavar="FIRST:END[:STEP]")
    make.add_argument("--out", type=Path, required=True)
    score = parts.add_parser("score", help="diagnose cases and compare")
    score.add_argument("folder", type=Path)
    options = parser.parse_args()
    if options.part == "make":
        for seed in options.seeds:
            sys.stdout.write(f"{make_case(options.out, seed)}\n")
        return
    outcomes: Counter[tuple[str, str]] = Counter()
    for path in sorted(options.folder.glob("*/truth.yaml")):
        result = judge(path.parent)
        outcomes[result["kind"], result["outcome"]] += 1
        sys.stdout.write(
            f"{result['case']} {result['kind']} {result['cause']}@{result['joint']} {result['size']:.3g}: "
            f"{result['outcome']} | {result['answer']} | {result.get('deviation', np.nan):.1f} sigma, left "
            f"{100 * result.get('left', np.nan):.1f} %, {result['cpu_s']:.1f} s\n"
        )
        sys.stdout.flush()
    for (kind, outcome), count in sorted(outcomes.items()):
        sys.stdout.write(f"{kind}: {outcome} {count}\n")


if __name__ == "__main__":
    main()
