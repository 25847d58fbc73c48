"""Sealed logs of public arms and a leg whose bodies are not those of their URDFs: torque by pinocchio.

``make`` needs pinocchio, example-robot-data and no bench; ``run`` the bench::

    python campaigns/nmt_laboratories/nmt_laboratories/public_bodies.py make --out DIR [--seeds N] [--dirty]
    python -m nmt_laboratories.public_bodies run --out DIR

The URDF of a case has no friction, damping or armature; the log of 20 s has all three, and a body that is not as in
the file. ``--dirty`` adds ripple, drift and friction that falls with speed. ``run`` asks the whole diagnosis, prints a
line for each case and counts; a case with an answer is not asked again.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from importlib import import_module
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

RATE_HZ, SECONDS = 250, 20
ROBOTS = {
    "panda": ("panda_description/urdf/panda.urdf", "panda_joint", 7, "panda_hand"),
    "ur5": ("ur_description/urdf/ur5_robot.urdf", "", 6, ""),
    "leg": ("hyq_description/robots/hyq_no_sensors.urdf", "lf_", 3, ""),
}
"""File, beginning of the joints' names, how many, and the first link of the part that may be off."""
KINDS = ("none", "part", "mass", "centre", "payload", "tilt", "constant", "two", "several")
MOMENT = 2e-4
TOOL = (0.76, 0.12, 4e-4)
"""Mass (kg), place along the last link (m) and moment of inertia about each axis (kg·m²) of a tool that a file has."""


def installed(name: str) -> Path:
    """A file of the package example-robot-data."""
    for place in map(Path, sys.path):
        if (found := place / "cmeel.prefix/share/example-robot-data/robots" / name).is_file():
            return found
    raise SystemExit("example-robot-data is not installed; type: pip install example-robot-data pin.")


def file_of(robot: str) -> tuple[ElementTree.Element, list[str], str]:
    """The robot's file without friction, its joints, and the first link of the part that may be off."""
    place, begins, count, part = ROBOTS[robot]
    root = ElementTree.parse(installed(place)).getroot()
    for element in [*root]:
        if element.tag not in ("link", "joint"):
            root.remove(element)
    for link in root.findall("link"):
        for element in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(element)
    names = list[str]()
    for joint in root.findall("joint"):
        for element in [*joint.findall("dynamics"), *joint.findall("safety_controller")]:
            joint.remove(element)
        name = str(joint.get("name"))
        if joint.get("type") in ("revolute", "continuous") and name.startswith(begins) and len(names) < count:
            names.append(name)
            last = joint.find("child").get("link")  # type: ignore[union-attr]
        elif joint.get("type") != "fixed":
            # Other limbs and fingers are held.
            joint.set("type", "fixed")
            for element in [*joint.findall("axis"), *joint.findall("limit"), *joint.findall("mimic")]:
                joint.remove(element)
    if not part:
        part, (mass, far, inertia) = "tool", TOOL
        if robot == "leg":
            mass, far = 0.5 * mass, -3.0 * far
        root.append(ElementTree.fromstring(
            f'<link name="tool"><inertial><origin xyz="0 0 {far}"/><mass value="{mass}"/><inertia ixx="{inertia}" '
            f'iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        ))  # fmt: skip
        root.append(ElementTree.fromstring(
            f'<joint name="mount" type="fixed"><parent link="{last}"/><child link="tool"/></joint>'
        ))  # fmt: skip
    return root, names, part


def inertial(link: ElementTree.Element) -> tuple[float, Any, dict[str, float]]:
    """Mass, centre and moments of inertia of a link."""
    element = link.find("inertial")
    assert element is not None
    origin, mass, moments = (element.find(tag) for tag in ("origin", "mass", "inertia"))
    assert mass is not None
    assert moments is not None
    centre = np.array([float(x) for x in (origin.get("xyz", "0 0 0") if origin is not None else "0 0 0").split()])
    return float(mass.get("value", 0.0)), centre, {key: float(value) for key, value in moments.attrib.items()}


def changed(link: ElementTree.Element, factor: float, shift: Any, shape: float = 1.0) -> None:
    """Change a link's mass, centre and inertia."""
    element = link.find("inertial")
    assert element is not None
    mass, centre, moments = inertial(link)
    origin = element.find("origin")
    if origin is None:
        origin = ElementTree.SubElement(element, "origin")
    origin.set("xyz", " ".join(f"{x:.9g}" for x in centre + shift))
    element.find("mass").set("value", f"{mass * factor:.9g}")  # type: ignore[union-attr]
    for key, value in moments.items():
        element.find("inertia").set(key, f"{value * factor * shape:.9g}")  # type: ignore[union-attr]


def _carried(root: ElementTree.Element, name: str) -> set[str]:
    """A link and all that hangs on it by fixed joints."""
    found, more = set[str](), {name}
    while more - found:
        found |= more
        more = {
            str(joint.find("child").get("link"))  # type: ignore[union-attr]
            for joint in root.findall("joint")
            if joint.get("type") == "fixed" and str(joint.find("parent").get("link")) in found  # type: ignore[union-attr]
        }
    return found


def make_case(robot: str, kind: str, seed: int, dirty: bool, folder: Path) -> dict[str, Any]:
    """Write file and log; what is true."""
    pin = import_module("pinocchio")
    rng = np.random.default_rng([seed, list(ROBOTS).index(robot), KINDS.index(kind), int(dirty)])
    root, names, part = file_of(robot)
    text = ElementTree.tostring(root, encoding="unicode")
    links = {str(link.get("name")): link for link in root.findall("link") if link.find("inertial") is not None}
    moved = [joint.find("child").get("link") for joint in root.findall("joint") if joint.get("name") in names]  # type: ignore[union-attr]
    for link in links.values():
        changed(link, float(np.exp(0.01 * rng.standard_normal())), 0.001 * rng.standard_normal(3),
                float(np.exp(0.02 * rng.standard_normal())))  # fmt: skip
    plain_text = ElementTree.tostring(root, encoding="unicode")
    truth: dict[str, Any] = {"robot": robot, "kind": kind, "place": [], "size": 0.0}
    factor, gravity = np.ones(len(names)), np.array([0.0, 0.0, -9.81])
    able = [str(name) for name in moved[1:]]
    if kind == "part":
        truth |= {"place": [part], "size": inertial(links[part])[0]}
        for name in _carried(root, part) & set(links):
            changed(links[name], 0.0, np.zeros(3))
    elif kind == "mass":
        name = str(rng.choice(able))
        changed(links[name], 1.3, np.zeros(3))
        truth |= {"place": [name], "size": 0.3 / 1.3 * inertial(links[name])[0]}
    elif kind == "centre":
        name = str(rng.choice(able))
        axis = int(np.argmax(np.abs(inertial(links[name])[1])))
        changed(links[name], 1.0, 0.03 * np.sign(inertial(links[name])[1][axis]) * np.eye(3)[axis])
        share = inertial(links[name])[0] / sum(inertial(links[item])[0] for item in _carried(root, name) & set(links))
        truth |= {"place": [name], "size": 0.03 * share * float(np.sign(inertial(links[name])[1][axis])),
                  "axis": "xyz"[axis]}  # fmt: skip
    elif kind == "payload":
        place = inertial(links[part])[1] * (0 if robot == "panda" else 1) + rng.uniform(-0.03, 0.03, 3)
        place = place + (np.array([0, 0, 0.18]) if robot == "panda" else 0)
        root.append(ElementTree.fromstring(
            f'<link name="load"><inertial><origin xyz="{place[0]} {place[1]} {place[2]}"/><mass value="0.5"/><inertia '
            'ixx="2e-4" iyy="2e-4" izz="2e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        ))  # fmt: skip
        root.append(ElementTree.fromstring(
            f'<joint name="hold" type="fixed"><parent link="{moved[-1]}"/><child link="load"/></joint>'
        ))  # fmt: skip
        truth |= {"place": [moved[-1]], "size": 0.5}
    elif kind == "tilt":
        about = rng.uniform(0.0, 2.0 * np.pi)
        gravity = gravity + np.cross(np.radians(3.0) * np.array([np.cos(about), np.sin(about), 0.0]), gravity)
        truth["size"] = 3.0
    elif kind == "constant":
        number = int(rng.integers(1, len(names)))
        factor[number] = rng.choice([0.92, 1.08])
        truth |= {"place": [names[number]], "size": float(1.0 / factor[number])}
    elif kind == "two":
        first, second = (str(name) for name in rng.choice(able, 2, replace=False))
        changed(links[first], 1.3, np.zeros(3))
        changed(links[second], 0.7, np.zeros(3))
        truth |= {"place": [first, second], "size": 0.3}
    elif kind == "several":
        for name in map(str, moved):
            changed(links[name], float(np.exp(0.12 * rng.standard_normal())), 0.01 * rng.standard_normal(3),
                    float(np.exp(0.15 * rng.standard_normal())))  # fmt: skip
        truth["place"] = list(map(str, moved))
    rows = np.arange(SECONDS * RATE_HZ) / RATE_HZ
    count = len(names)
    omega = 2.0 * np.pi * rng.uniform(0.08, 1.1, (count, 5))
    phase = rng.uniform(0.0, 2.0 * np.pi, (count, 5))
    reach = 0.3 / np.sqrt(1.0 + omega / 4.0)
    planned, given, real = (pin.buildModelFromXML(item) for item in
                            (text, plain_text, ElementTree.tostring(root, encoding="unicode")))  # fmt: skip
    low, high = (np.clip(values, -3.0, 3.0) for values in _limits(planned, names))
    middle = 0.5 * (low + high) + rng.uniform(-0.15, 0.15, count) * np.minimum(high - low, 2.0)
    reach *= np.minimum(1.0, 0.33 * (high - low) / np.sum(reach, axis=1))[:, None]
    angle = omega[:, :, None] * rows + phase[:, :, None]
    q = (middle[:, None] + np.sum(reach[:, :, None] * np.sin(angle), axis=1)).T
    v = np.sum((reach * omega)[:, :, None] * np.cos(angle), axis=1).T
    a = -np.sum((reach * omega**2)[:, :, None] * np.sin(angle), axis=1).T
    plain = _torque(pin, given, names, q, v, a, np.array([0.0, 0.0, -9.81]))
    acting = _torque(pin, real, names, q, v, a, gravity)
    size = np.sqrt(np.mean(plain**2, axis=0))
    # A joint that carries little has friction of its drive all the same.
    drive = np.maximum(size, 0.05 * np.max(size))
    coulomb, damping = rng.uniform(0.04, 0.1, count) * drive, rng.uniform(0.01, 0.03, count) * drive
    armature = rng.uniform(0.01, 0.03, count) * drive / np.sqrt(np.mean(a**2, axis=0))
    friction = coulomb * np.sign(v) + damping * v + armature * a
    if dirty:
        friction = friction + 0.4 * coulomb * np.sign(v) * np.exp(-((v / 0.1) ** 2))
        friction = friction + 0.014 * size * np.sin(rng.integers(5, 12, count) * q + phase[:, 0])
        friction = friction + 0.02 * size * (rows[:, None] / SECONDS - 0.5)
    measured = (acting + friction) * factor + 0.005 * size * rng.standard_normal(q.shape)
    # Of all torque: a wrist that carries nothing has little else than friction.
    differs, sizes = (np.sqrt(np.mean(values**2, axis=0)) for values in (acting * factor - plain, measured))
    truth["effect"] = (differs / sizes).tolist()
    counts = 2.0 * np.pi / 2**18
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.urdf").write_text(text, encoding="utf-8")
    np.savez(
        folder / "log.npz", time=rows, names=np.array(names), position=np.round(q / counts) * counts,
        velocity=v + 1e-3 * rng.standard_normal(q.shape), torque=measured,
    )  # fmt: skip
    return truth


def _limits(model: Any, names: list[str]) -> tuple[Any, Any]:
    places = [model.joints[model.getJointId(name)] for name in names]
    low, high = (
        np.array([float(values[joint.idx_q]) if joint.nq == 1 else side for joint in places])
        for values, side in ((model.lowerPositionLimit, -1.0), (model.upperPositionLimit, 1.0))
    )
    return low, high


def _torque(pin: Any, model: Any, names: list[str], q: Any, v: Any, a: Any, gravity: Any) -> Any:
    """Rows × joints."""
    model.gravity.linear = gravity
    data = model.createData()
    joints = [model.joints[model.getJointId(name)] for name in names]
    neutral, found = pin.neutral(model), np.empty_like(q)
    speed, change = np.zeros(model.nv), np.zeros(model.nv)
    for row in range(len(q)):
        place = neutral.copy()
        for number, joint in enumerate(joints):
            angle = q[row, number]
            place[joint.idx_q : joint.idx_q + joint.nq] = angle if joint.nq == 1 else (np.cos(angle), np.sin(angle))
            speed[joint.idx_v], change[joint.idx_v] = v[row, number], a[row, number]
        torque = pin.rnea(model, data, place, speed, change)
        found[row] = [torque[joint.idx_v] for joint in joints]
    return found


def judged(folder: Path) -> dict[str, Any]:
    """The diagnosis of a case next to what is true of it."""
    from nmt_laboratories.body_cases import Truth
    from nmt_laboratories.body_cases import judged as verdict_of
    from nmt_robots.log.proposal import propose_sidecar
    from nmt_robots.verdict.robot_diagnosis import diagnose_robot

    truth: dict[str, Any] = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    begun = time.process_time()
    robot, sidecar = folder / "robot.urdf", folder / "log.yaml"
    sidecar.write_text(propose_sidecar(folder / "log.npz", robot, folder).text, encoding="utf-8")
    diagnosis = diagnose_robot(robot, sidecar)
    seconds = round(time.process_time() - begun, 1)
    bodies = diagnosis.bodies
    sealed = Truth(truth["kind"], " ".join(truth["place"]), truth["size"], np.array(truth["effect"]))
    extra = {
        joint.joint.name: [term.key for term in joint.terms if term.differs and term.key not in USUAL]
        for joint in diagnosis.joints
    }
    return {
        "verdict": verdict_of(bodies, sealed),
        "kind": "not asked" if bodies is None else bodies.kind,
        "subjects": [] if bodies is None else list(bodies.subjects),
        "probability": 0.0 if bodies is None else bodies.probability,
        "sentence": "" if bodies is None else bodies.sentence,
        "deviations": [] if bodies is None else _deviations(truth, bodies),
        "extra": {name: keys for name, keys in extra.items() if keys},
        "faults": [finding.key for finding in diagnosis.findings if finding.fault],
        "seconds": seconds,
    }


USUAL = frozenset({"coulomb", "viscous", "armature", "bodies", "torque_constant", "stribeck", "ripple",
                   "changing_friction", "offset"})  # fmt: skip
"""Terms that are planted, in dirty cases too, and the bodies."""


def _deviations(truth: dict[str, Any], bodies: Any) -> list[float]:
    """Errors of stated sizes of what is planted, in their standard uncertainties; a link is all that moves with it."""
    wanted = {
        "mass": "mass", "payload": "payload", "tilt": "lean", "constant": "torque constant",
        "centre": f"centre of mass along {truth.get('axis', '')}",
    }.get(truth["kind"], "")  # fmt: skip
    return [
        (value.value - (value.in_model if truth["kind"] in ("mass", "centre") else 0.0) - truth["size"]) / value.std
        for value in bodies.values
        if value.quantity == wanted and (not truth["place"] or value.body in truth["place"]) and value.std > 0.0
    ]


def make(out: Path, seeds: int, dirty: bool, kinds: list[str], first: int) -> None:
    """Write the cases that are not there yet; ``truth.json`` of a folder is there when it is whole."""
    for seed in range(first, first + seeds):
        for robot in ROBOTS:
            for kind in kinds:
                folder = out / f"{robot}-{kind}-{seed}{'-dirty' if dirty else ''}"
                if (folder / "truth.json").exists():
                    continue
                truth = make_case(robot, kind, seed, dirty, folder)
                (folder / "truth.json").write_text(json.dumps(truth, indent=1), encoding="utf-8")
                print(folder.name, truth["place"], f"{max(truth['effect']):.3f}", flush=True)


def run(out: Path, names: list[str]) -> None:
    """Diagnose what has no answer yet and print all; a name without an answer again."""
    counts, deviations = Counter[str](), []
    for folder in sorted(path.parent for path in out.glob("*/truth.json")):
        if names and folder.name not in names:
            continue
        target = folder / "answer.json"
        if not target.exists() or names:
            target.write_text(json.dumps(judged(folder), indent=1, ensure_ascii=False), encoding="utf-8")
        answer = json.loads(target.read_text(encoding="utf-8"))
        truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
        counts[answer["verdict"]] += 1
        deviations += answer["deviations"]
        extra = {key: answer[key] for key in ("extra", "faults") if answer[key]}
        print(
            f"{answer['verdict']:6} {folder.name} {' '.join(truth['place'])} {max(truth['effect']):.3f} -> "
            f"{answer['kind']} {', '.join(answer['subjects'])} ({answer['probability']:.3f}) "
            f"{np.round(answer['deviations'], 1)} {extra or ''} {answer['seconds']} s",
            flush=True,
        )
    held = sum(abs(value) < 1.96 for value in deviations)
    print(dict(counts), f"{held} of {len(deviations)} sizes within 1.96 standard uncertainties")


def main() -> None:
    """Make the cases, or diagnose them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("step", choices=("make", "run"))
    parser.add_argument("names", nargs="*", help="cases that are diagnosed anew; all without an answer otherwise")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kinds", nargs="*", default=list(KINDS))
    parser.add_argument("--dirty", action="store_true")
    options = parser.parse_intermixed_args()
    if options.step == "make":
        make(options.out, options.seeds, options.dirty, options.kinds, options.first)
    else:
        run(options.out, options.names)


if __name__ == "__main__":
    main()
