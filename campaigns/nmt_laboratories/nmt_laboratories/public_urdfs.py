"""Public URDFs with torques of another library: what is planted has to be named, and nothing else.

Twice, from the root of the repository::

    pip install example-robot-data pin
    python campaigns/nmt_laboratories/nmt_laboratories/public_urdfs.py make --out court [--urdfs FOLDER]
    python -m nmt_laboratories.public_urdfs run --out court [NAME …]

``make`` needs no bench. For each URDF with joints it writes a log of 20 s at 500 Hz: smooth motion of up to 12 joints,
torque by pinocchio's recursive Newton-Euler algorithm with the friction and damping that the file states, mimic joints
moved by their ratio, and Coulomb friction of a quarter of its torque added at one joint; with ``--everywhere`` instead
Coulomb and viscous friction and armature of a tenth of its torque each at every joint whose file states none of them.
``run`` diagnoses each and prints a line; a robot whose answer is in the folder is not diagnosed again.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from importlib import import_module
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

RATE_HZ, SECONDS, JOINTS = 500, 20, 12
PLANTED = 0.25
BEYOND = 0.5
"""Coulomb friction that is added at one joint, of the rms torque, and more of what the file states (its tolerance)."""
EACH = 0.1
"""Torque (rms) of each term that is planted everywhere, of that of its joint."""
SMALLEST = 1e-3
SLOWEST = 0.1
"""Torque (rms, N·m) and speed (rms, rad/s) of a joint that friction can be planted at."""


def installed_urdfs() -> Path:
    """Folder of the package example-robot-data."""
    for place in map(Path, sys.path):
        if (found := place / "cmeel.prefix/share/example-robot-data/robots").is_dir():
            return found
    raise SystemExit("example-robot-data is not installed; type: pip install example-robot-data pin.")


def sines(random: np.random.Generator, middle: float, amplitude: float) -> tuple[Any, Any, Any]:
    """Position, speed and acceleration of four slow sines, rows."""
    rows = np.arange(SECONDS * RATE_HZ) / RATE_HZ
    omega = 2.0 * np.pi * (np.array([0.11, 0.27, 0.46, 0.63]) + 0.05 * random.random(4))
    phase = omega * rows[:, None] + random.uniform(0.0, 2.0 * np.pi, 4)
    size = amplitude / 4.0
    return (
        middle + size * np.sin(phase).sum(1),
        size * (omega * np.cos(phase)).sum(1),
        -size * (omega**2 * np.sin(phase)).sum(1),
    )


def make_case(urdf: Path, folder: Path, random: np.random.Generator, everywhere: bool) -> dict[str, Any]:
    """Write the log of one robot; what is true of it."""
    pin = import_module("pinocchio")
    model = pin.buildModelFromUrdf(str(urdf))
    root = ElementTree.parse(urdf).getroot()
    elements = {joint.get("name"): joint for joint in root.findall("joint")}
    mimics = {name: mimic for name, joint in elements.items() if (mimic := joint.find("mimic")) is not None}
    numbers = {model.names[n]: n for n in range(1, model.njoints) if model.joints[n].nv == 1}
    names = [name for name in numbers if name not in mimics][:JOINTS]
    if not names:
        return {"without_joints": True}
    rows = SECONDS * RATE_HZ
    q, v, a = np.tile(pin.neutral(model), (rows, 1)), np.zeros((rows, model.nv)), np.zeros((rows, model.nv))
    motions = {}
    for name in names:
        joint = model.joints[numbers[name]]
        low, high = -1.0, 1.0
        if joint.nq == 1:
            low = max(float(model.lowerPositionLimit[joint.idx_q]), -3.0)
            high = min(float(model.upperPositionLimit[joint.idx_q]), 3.0)
        low, high = (low, high) if low < high else (-1.0, 1.0)
        motions[name] = sines(random, 0.5 * (low + high), min(0.3 * (high - low), 0.6))
    gains = {name: {name: 1.0} for name in names}
    for name, mimic in mimics.items():
        master = mimic.get("joint")
        if name in numbers and master in motions:
            ratio, offset = float(mimic.get("multiplier", 1.0)), float(mimic.get("offset", 0.0))
            position, speed, acceleration = motions[master]
            motions[name] = ratio * position + offset, ratio * speed, ratio * acceleration
            gains[master][name] = ratio
    for name, (position, speed, acceleration) in motions.items():
        joint = model.joints[numbers[name]]
        turns = joint.nq == 2
        q[:, joint.idx_q : joint.idx_q + joint.nq] = (
            np.column_stack([np.cos(position), np.sin(position)]) if turns else position[:, None]
        )
        v[:, joint.idx_v], a[:, joint.idx_v] = speed, acceleration
    data = model.createData()
    everything = np.array([pin.rnea(model, data, *values) for values in zip(q, v, a, strict=True)])
    torque = np.column_stack(
        [sum(r * everything[:, model.joints[numbers[n]].idx_v] for n, r in gains[name].items()) for name in names]
    )
    position, speed = (np.column_stack([motions[name][part] for name in names]) for part in (0, 1))
    rms = np.sqrt(np.mean(torque**2, axis=0))
    for column, name in enumerate(names):
        dynamics = elements[name].find("dynamics")
        if dynamics is not None:
            torque[:, column] += float(dynamics.get("damping", 0.0)) * speed[:, column]
            torque[:, column] += float(dynamics.get("friction", 0.0)) * np.sign(speed[:, column])
    size = np.sqrt(np.mean(torque**2, axis=0))
    able = [k for k in range(len(names)) if rms[k] > SMALLEST and float(np.std(speed[:, k])) > SLOWEST]
    truth: dict[str, Any] = {"joints": names, "at": "", "friction": 0.0}
    if everywhere:
        truth["terms"] = {}
        for column in able:
            dynamics = elements[names[column]].find("dynamics")
            if dynamics is not None and any(float(dynamics.get(key, 0.0)) for key in ("damping", "friction")):
                continue
            v_of, a_of = (motions[names[column]][part] for part in (1, 2))
            truth["terms"][names[column]] = planted = {}
            for key, shape in (("coulomb", np.sign(v_of)), ("viscous", v_of), ("armature", a_of)):
                planted[key] = EACH * float(size[column] / np.sqrt(np.mean(shape**2)))
                torque[:, column] += planted[key] * shape
    elif able:
        column = able[len(able) // 2]
        dynamics = elements[names[column]].find("dynamics")
        stated = 0.0 if dynamics is None else float(dynamics.get("friction", 0.0))
        truth |= {"at": names[column], "friction": PLANTED * float(size[column]) + BEYOND * stated}
        torque[:, column] += truth["friction"] * np.sign(speed[:, column])
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.urdf").write_bytes(urdf.read_bytes())
    np.savez(
        folder / "log.npz", time=np.arange(rows) / RATE_HZ, names=np.array(names),
        position=position + 1e-5 * random.standard_normal(position.shape),
        velocity=speed + 1e-3 * random.standard_normal(speed.shape),
        torque=torque + 0.003 * size * random.standard_normal(torque.shape),
    )  # fmt: skip
    return truth


def make(urdfs: Path, out: Path, everywhere: bool) -> None:
    """Write a case for each URDF; ``truth.json`` of a folder is there when it is whole."""
    for urdf in sorted(urdfs.rglob("*.urdf")):
        folder = out / f"{urdf.parent.parent.name}-{urdf.stem}"
        if (folder / "truth.json").exists():
            continue
        try:
            truth = make_case(urdf, folder, np.random.default_rng([7, *urdf.name.encode()]), everywhere)
        except (ValueError, RuntimeError) as error:
            truth = {"not_read_by_pinocchio": str(error).splitlines()[0]}
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "truth.json").write_text(json.dumps(truth, indent=1), encoding="utf-8")
        print(folder.name, truth.get("at", truth), flush=True)


def judged(folder: Path) -> dict[str, Any]:
    """The diagnosis of one case beside what is true of it."""
    from nmt_core.errors import BenchError
    from nmt_robots.log.proposal import propose_sidecar
    from nmt_robots.verdict.robot_diagnosis import diagnose_robot

    truth: dict[str, Any] = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    if "joints" not in truth:
        return truth
    begun = time.process_time()
    robot, sidecar = folder / "robot.urdf", folder / "log.yaml"
    try:
        sidecar.write_text(propose_sidecar(folder / "log.npz", robot, folder).text, encoding="utf-8")
        diagnosis = diagnose_robot(robot, sidecar)
    except BenchError as error:
        return {"refused": str(error)}
    at, others, named, off, missed = "", {}, 0, [], []
    for joint in diagnosis.joints:
        terms = [term for term in joint.terms if term.differs]
        for key, expected in truth.get("terms", {}).get(joint.joint.name, {}).items():
            found = next((term for term in terms if term.key == key), None)
            named += found is not None
            if found is None:
                missed.append(f"{joint.joint.name} {key}: {joint.difference}")
            elif abs(found.value - expected) > 3.0 * found.std:
                off.append(f"{joint.joint.name} {key}: {found.value:.4g} ± {found.std:.2g}, planted {expected:.4g}")
            terms = [term for term in terms if term.key != key]
        if joint.joint.name == truth["at"]:
            found = next((term for term in terms if term.key == "coulomb"), None)
            expected = truth["friction"] + joint.joint.coulomb
            if found is not None:
                share = found.value / expected
                right = abs(found.value - expected) < 3.0 * found.std
                at = f"{'named' if right else 'off'}: {found.value:.4g} ± {found.std:.2g} ({share:.3f})"
            else:
                at = f"missed: {joint.difference}"
            terms = [term for term in terms if term.key != "coulomb"]
        if terms:
            others[joint.joint.name] = ", ".join(term.key for term in terms)
    return {
        "at": at,
        "named": named,
        "missed": missed,
        "off": off,
        "others": others,
        "log": [finding.sentence for finding in diagnosis.findings if finding.fault],
        "file": [finding.key for finding in diagnosis.of_file],
        "seconds": round(time.process_time() - begun, 1),
    }


def run(out: Path, names: list[str]) -> None:
    """Diagnose what has no answer yet and print all; a name without an answer again."""
    for folder in sorted(path.parent for path in out.glob("*/truth.json")):
        if names and folder.name not in names:
            continue
        target = folder / "answer.json"
        if not target.exists() or names:
            target.write_text(json.dumps(judged(folder), indent=1, ensure_ascii=False), encoding="utf-8")
        answer = json.loads(target.read_text(encoding="utf-8"))
        print(folder.name, {key: value for key, value in answer.items() if key != "file" and value}, flush=True)


def main() -> None:
    """Make the cases, or diagnose them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("step", choices=("make", "run"))
    parser.add_argument("names", nargs="*", help="robots that are diagnosed anew; all without an answer otherwise")
    parser.add_argument("--urdfs", type=Path, help="folder of URDFs; that of example-robot-data without")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--everywhere", action="store_true", help="plant three terms at every joint")
    options = parser.parse_intermixed_args()
    if options.step == "make":
        make(options.urdfs or installed_urdfs(), options.out, options.everywhere)
    else:
        run(options.out, options.names)


if __name__ == "__main__":
    main()
