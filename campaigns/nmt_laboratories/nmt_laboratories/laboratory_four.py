"""Laboratory four: robots simulated by MuJoCo with drives, encoders and a logger, one cause, two or none in each.

An arm and a leg with three joints and a single geared joint are known by a model with the ordinary errors of a user.
``campaign.py`` makes the cases and ``./nmt blind laboratory`` diagnoses them: ``robot.xml``, ``log.npz``, ``log.yaml``
and ``truth.yaml``, which no diagnosis sees.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from nmt_laboratories.simulated_robot import SECONDS, STEP_S, Cause, Chain, Robot, command_of, logged, robot_text

KINDS = ("healthy", "effect", "log", "effect", "log", "two", "effect", "log", "effect", "effect", "log", "unknown")
EFFECTS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "coulomb": (("coulomb",), ()),
    "viscous": (("viscous",), ()),
    "armature": (("armature",), ("inertia_scale",)),
    "stribeck": (("stribeck",), ("root_friction", "coulomb")),
    "ripple": (("ripple",), ()),
    "gravity": (("link_mass", "gravity_scale", "mass_centre"), ("inertia_scale", "armature", "spring", "offset")),
    "spring": (("spring",), ("gravity_scale", "mass_centre")),
    "load_friction": (("load_friction", "efficiency"), ("coulomb",)),
    "efficiency": (("load_friction", "efficiency"), ("coulomb",)),
    "backlash": (("backlash",), ("jerk", "elastic", "transmission")),
    "elastic": (("elastic",), ("jerk", "backlash", "transmission")),
    "end_stop": (("end_stop",), ("spring",)),
}
"""By cause: terms that name it, and terms that are a part of it or its class."""
FAULTS: dict[str, tuple[str, ...]] = {
    "command_held": ("command_held",),
    "command_late": ("command_lag", "torque_lag"),
    "measurement_late": ("command_lag", "torque_lag"),
    "clock_jitter": ("hidden_jitter", "uneven_clock"),
    "clock_alternating": ("hidden_jitter", "uneven_clock"),
    "clock_factor": ("clock_factor",),
    "rows_dropped": ("hidden_jitter", "rows_missing"),
    "rows_repeated": ("rows_repeated",),
    "speed_filter": ("velocity_late",),
    "torque_is_law": ("torque_is_law",),
    "torque_constant": ("gain",),
    "gain": ("gain",),
    "saturation": ("saturation",),
    "order": ("order", "gravity_sign", "out_of_range"),
    "joint_sign": ("gravity_sign", "joint_sign", "order"),
    "speed_sign": ("velocity_sign", "velocity_factor"),
    "speed_degrees": ("velocity_factor", "clock_factor", "velocity_degrees"),
    "degrees": ("degrees", "out_of_range"),
    "wrap": ("wrap",),
}
"""By fault of the log: findings that name it."""
SHARED = {
    "gravity": ("body of {}_link", "payload on {}_link that is not in the file"),
    "torque_constant": ("torque constant of {}",),
}
"""Words of all joints together that name a cause at a joint; a heavier last link is a payload at its centre."""
UNKNOWN = ("temperature", "band", "hose")
NAMED: dict[str, tuple[str, ...]] = {"temperature": ("changing_friction",), "hose": ("creep", "coulomb")}
"""Terms that name what no row of the library has as a whole; a hose is friction that builds up over an angle."""
ROBOTS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "arm": (("base", "shoulder", "elbow"), ("0 0 1", "0 1 0", "0 1 0")),
    "leg": (("hip", "thigh", "calf"), ("1 0 0", "0 1 0", "0 1 0")),
    "geared": (("drive",), ("0 1 0",)),
}
_GAINS = np.array([80.0, 60.0, 40.0]), np.array([2.0, 1.5, 1.0])
_ARITHMETIC = ("command_late", "gain", "saturation", "command_held")
"""Causes that are there only where the torque is computed."""
_SHARED = ("command_held", "command_late", "measurement_late", "clock_jitter", "clock_alternating", "clock_factor",
           "rows_dropped", "rows_repeated", "speed_filter", "speed_degrees", "degrees", "order")  # fmt: skip
"""Faults of all joints at once."""
_MEASURED = ("torque_constant", "torque_is_law", "order")


def links_of(robot: str, rng: Any) -> list[dict[str, Any]]:
    """True links."""
    links: list[dict[str, Any]] = []
    for number in range(len(ROBOTS[robot][0])):
        mass = float(rng.uniform(1.2, 3.0)) / (1.0 + 0.7 * number)
        length = float(rng.uniform(0.2, 0.35))
        links.append({
            "mass": mass, "before": 0.0 if number == 0 else links[-1]["length"], "length": length,
            "centre": [0.01, 0.0, -0.45 * length], "inertia": [mass * length**2 / 10.0] * 2 + [mass * length**2 / 40.0],
            "armature": float(rng.uniform(0.02, 0.06)), "damping": float(rng.uniform(0.15, 0.5)),
            "coulomb": float(rng.uniform(0.3, 0.8)), "reach": 3.0,
        })  # fmt: skip
    return links


def believed(links: list[dict[str, Any]], rng: Any) -> list[dict[str, Any]]:
    """The same with the ordinary errors of a user, at most two standard deviations."""

    def error(size: float) -> float:
        return 1.0 + size * float(np.clip(rng.standard_normal(), -2.0, 2.0))

    found = []
    for link in links:
        inertia = [x * error(0.05) for x in link["inertia"]]
        # A diagonal inertia must keep its triangle.
        largest = max(inertia)
        found.append({
            **link,
            "mass": link["mass"] * error(0.02),
            "centre": [x + 0.002 * (error(1.0) - 1.0) for x in link["centre"]],
            "inertia": [x if x == largest else max(x, 0.51 * largest) if x > 0.4 * largest else x for x in inertia],
            "armature": link["armature"] * error(0.05),
            "damping": link["damping"] * error(0.15),
            "coulomb": link["coulomb"] * error(0.10),
        })  # fmt: skip
        high, middle, low = sorted(found[-1]["inertia"], reverse=True)
        if high > middle + low:
            found[-1]["inertia"] = [min(x, middle + 0.99 * low) for x in found[-1]["inertia"]]
    return found


def sizes_of(name: str, rng: Any) -> dict[str, float]:
    """Sizes of a cause."""
    ranges: dict[str, dict[str, tuple[float, float]]] = {
        "coulomb": {"factor": (1.8, 3.0)}, "viscous": {"factor": (2.5, 4.0)}, "armature": {"factor": (2.0, 3.5)},
        "stribeck": {"excess": (1.0, 2.0), "speed": (0.15, 0.35)},
        "ripple": {"torque": (0.4, 0.9), "order": (7.0, 20.0)}, "gravity": {"factor": (1.25, 1.5)},
        "spring": {"stiffness": (2.5, 5.0), "rest": (-0.3, 0.3)}, "load_friction": {"share": (0.15, 0.3)},
        "efficiency": {"eta": (0.7, 0.85)},
        "backlash": {"gap": (0.015, 0.04), "stiffness": (2500.0, 3500.0), "damper": (2.0, 3.0)},
        "elastic": {"stiffness": (60.0, 180.0), "damper": (0.2, 0.5)},
        "end_stop": {"stiffness": (100.0, 300.0), "angle": (0.0, 0.0)},
        "command_held": {"rows": (4.0, 8.0)}, "command_late": {"delay": (0.006, 0.012)},
        "measurement_late": {"delay": (0.006, 0.012)}, "clock_jitter": {"share": (0.3, 0.45)},
        "clock_factor": {"factor": (1.05, 1.1)}, "rows_dropped": {"share": (0.05, 0.1)},
        "rows_repeated": {"share": (0.05, 0.15)}, "speed_filter": {"time": (0.006, 0.012)},
        "torque_constant": {"factor": (1.2, 1.4)}, "gain": {"factor": (1.25, 1.5)}, "saturation": {"share": (0.3, 0.5)},
        "temperature": {"friction": (0.5, 1.0)}, "band": {"friction": (0.6, 1.2)},
        "hose": {"stiffness": (15.0, 30.0), "torque": (0.8, 1.5)},
    }  # fmt: skip
    found = {key: float(rng.uniform(*span)) for key, span in ranges.get(name, {}).items()}
    if "order" in found:
        found["order"] = float(round(found["order"]))
    return found


def draw(seed: int) -> tuple[str, str, list[Cause]]:
    """Robot, kind and causes of a case; kinds and causes go round over the seeds, so that a run of them has all."""
    rng = np.random.default_rng([4, seed])
    kind = KINDS[seed % len(KINDS)]
    before = (seed // len(KINDS)) * KINDS.count(kind) + KINDS[: seed % len(KINDS)].count(kind)
    robot = list(ROBOTS)[(seed + seed // len(KINDS)) % len(ROBOTS)]
    joints = len(ROBOTS[robot][0])
    if kind == "healthy":
        return robot, kind, []
    if kind == "two":
        robot, joints = ("arm", "leg")[before % 2], 3
        first, second = rng.choice(list(EFFECTS)[:10], size=2, replace=False)
        places = rng.choice(joints, size=2, replace=False)
        pairs = [(str(first), int(places[0])), (str(second), int(places[1]))]
        if before % 2:
            fault = str(rng.choice(["speed_filter", "rows_repeated", "command_late"]))
            pairs[1] = (fault, -1)
        return robot, kind, [Cause(name, joint, sizes_of(name, rng)) for name, joint in pairs]
    names = {"effect": list(EFFECTS), "log": list(FAULTS), "unknown": list(UNKNOWN)}[kind]
    name = names[(7 * before) % len(names)]
    # A single joint and its mirror image move alike, so no log tells its sign.
    if name in ("order", "joint_sign"):
        robot, joints = ("arm", "leg")[before % 2], 3
    joint = int(rng.integers(joints))
    if name in ("gravity", "joint_sign") and robot == "arm":
        joint = int(rng.integers(1, 3))
    if name in ("wrap",) and robot != "geared":
        joint = 0
    if name in _SHARED:
        joint = -1
    return robot, kind, [Cause(name, joint, sizes_of(name, rng))]


def make_case(folder: Path, seed: int) -> str:
    """Write a case that is not there yet; its name."""
    robot, kind, causes = draw(seed)
    case = folder / f"{robot}_{seed:04d}"
    if (case / "truth.yaml").is_file():
        return case.name
    rng = np.random.default_rng([5, seed])
    names, axes = ROBOTS[robot]
    nominal = links_of(robot, rng)
    by_name = {cause.name: cause for cause in causes}
    if "wrap" in by_name:
        nominal[by_name["wrap"].joint]["reach"] = 7.0
    model = believed(nominal, rng)
    links = [dict(link) for link in nominal]
    changed_links(links, causes)
    chain = _chain(by_name, rng)
    command = _command(robot, by_name, chain, rng)
    kp, kd = (gains[: len(names)].copy() for gains in _GAINS)
    real = [kp.copy(), kd.copy()]
    if "gain" in by_name:
        real[0][by_name["gain"].joint] *= by_name["gain"].sizes["factor"]
    delay = round(by_name["command_late"].sizes["delay"] / STEP_S) if "command_late" in by_name else 0
    followed = np.vstack([np.repeat(command[:1], delay, axis=0), command[: len(command) - delay]]) if delay else command
    causes = _with_sizes_of_motion(robot_text(names, axes, links), causes, (real[0], real[1]), chain, followed)
    motion = Robot(robot_text(names, axes, links), causes, (real[0], real[1]), chain).run(followed)
    columns = logged(motion, command, chain, causes, rng)
    case.mkdir(parents=True, exist_ok=True)
    (case / "robot.xml").write_text(robot_text(names, axes, model))
    if not chain.measured:
        columns.pop("tau")
    np.savez(case / "log.npz", **columns, kp=kp, kd=kd)
    (case / "log.yaml").write_text(yaml.safe_dump(sidecar_of(names, chain.measured), sort_keys=False))
    truth = {"kind": kind, "causes": [_as_truth(cause, names, links) for cause in causes]}
    (case / "truth.yaml").write_text(yaml.safe_dump(truth, sort_keys=False))
    return case.name


def changed_links(links: list[dict[str, Any]], causes: list[Cause]) -> None:
    """Links with the causes that are values of theirs."""
    keys = {"coulomb": "coulomb", "viscous": "damping", "armature": "armature", "gravity": "mass"}
    for cause in causes:
        if cause.name in keys:
            links[cause.joint][keys[cause.name]] *= cause.sizes["factor"]


def _chain(by_name: dict[str, Cause], rng: Any) -> Chain:
    measured = bool(rng.integers(2))
    if set(by_name) & set(_ARITHMETIC):
        measured = False
    if set(by_name) & set(_MEASURED):
        measured = True
    return Chain(
        drive_steps=int(rng.choice([2, 4])), log_steps=int(rng.choice([4, 8])),
        current_s=float(rng.uniform(2e-4, 8e-4)),
        speed_s=float(rng.uniform(0.0, 8e-4)), counts=float(2 ** rng.integers(14, 17)), measured=measured, noise=0.01,
    )  # fmt: skip


def _command(robot: str, by_name: dict[str, Cause], chain: Chain, rng: Any) -> Any:
    time = np.arange(int(SECONDS / STEP_S)) * STEP_S
    centres = 0.3 * (np.arange(len(ROBOTS[robot][0])) - 1.0)
    if "wrap" in by_name:
        centres[by_name["wrap"].joint] = np.pi
    command = command_of(time, centres, rng)
    every = chain.log_steps * (round(by_name["command_held"].sizes["rows"]) if "command_held" in by_name else 1)
    return command[(np.arange(len(time)) // every) * every]


def _with_sizes_of_motion(
    text: str, causes: list[Cause], gains: tuple[Any, Any], chain: Chain, command: Any
) -> list[Cause]:
    """Causes whose size follows from how the robot moves without them."""
    if not any(cause.name in ("end_stop", "saturation") for cause in causes):
        return causes
    q, _, acting, _ = Robot(text, [], gains, chain).run(command)
    found = []
    for cause in causes:
        sizes = dict(cause.sizes)
        if cause.name == "end_stop":
            sizes["angle"] = float(np.quantile(q[:, cause.joint], 0.93))
        elif cause.name == "saturation":
            sizes["limit"] = float(np.quantile(np.abs(acting[:, cause.joint]), 1.0 - 0.4 * sizes["share"]))
        found.append(Cause(cause.name, cause.joint, sizes))
    return found


def sidecar_of(names: tuple[str, ...], measured: bool) -> dict[str, Any]:
    """The description of a robot's log, with measured torque or with command and gains."""
    sidecar: dict[str, Any] = {
        "robot_log": 1, "data": "log.npz", "joints": list(names), "time": {"column": "time"},
        "position": {"column": "q"}, "velocity": {"column": "dq"}, "command": {"position": "q_des"},
        "gains": {"kp": "kp", "kd": "kd"},
    }  # fmt: skip
    if measured:
        sidecar["torque"] = {"column": "tau"}
    return sidecar


def _as_truth(cause: Cause, names: tuple[str, ...], links: list[dict[str, Any]]) -> dict[str, Any]:
    """A cause as ``truth.yaml`` has it."""
    named, partly = EFFECTS.get(cause.name, (FAULTS.get(cause.name, NAMED.get(cause.name, ())), ()))
    where = cause.name in FAULTS
    if cause.name in SHARED:
        named = (*named, *(words.format(names[cause.joint]) for words in SHARED[cause.name]))
    truth: dict[str, Any] = {
        "name": cause.name, "of": "log" if where else "joint",
        "joint": "" if cause.joint < 0 else names[cause.joint],
        "named": list(named), "partly": list(partly), "sizes": {k: float(v) for k, v in cause.sizes.items()},
    }  # fmt: skip
    key = {"coulomb": "coulomb", "viscous": "damping", "armature": "armature"}.get(cause.name)
    value = links[cause.joint][key] if key else {
        "spring": cause.sizes.get("stiffness"), "ripple": cause.sizes.get("torque"),
        "load_friction": cause.sizes.get("share"),
    }.get(cause.name)  # fmt: skip
    if value is not None:
        truth["value"] = float(value)
    return truth
