"""Cases for the reading of laws: the free beam of laboratory three with one or two local forces, and laboratory one.

Twenty-six structure cases, twelve of them with a law that the library lacks, and sixteen that are healthy or have a
fault of a sensor, an exciter or in time. The beam moves by the integrator of :mod:`nmt_laboratories.modal_simulator`,
its force in phase with the velocity of its point. The truth of a case of the beam has displacement and force of each
place, harmonic by harmonic, at every level.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from nmt_laboratories import laboratory_one
from nmt_laboratories.laboratory_three import DRIVEN, RATE, SENSORS, _through_chain, draw_case, owners_model
from nmt_laboratories.laboratory_two import frequency_of
from nmt_laboratories.modal_simulator import Element, Simulator

LEVELS, _WINDOW, _ORDERS = 10, 50, 15
_POINTS = (1, 2, 3, 7, 8, 9, 11, 13)
IN_LIBRARY = (
    "cubic", "softening", "quintic", "quadratic", "gap", "stop", "drag", "amplitude_damper", "coulomb", "slider",
)  # fmt: skip
OUTSIDE = (
    "stribeck", "iwan", "pinched", "magnet", "softening_and_drag", "cubic_and_coulomb", "gap_and_drag", "backlash",
    "asymmetric", "lugre",
)  # fmt: skip
OTHERS = (
    "healthy", "healthy", "detuned", "gain", "late", "clipped", "force_gain", "drift", "stinger_spring", "hum",
)  # fmt: skip
FAMILIES = {
    "cubic": "hardening spring", "softening": "softening spring", "quintic": "hardening spring",
    "quadratic": "asymmetric spring", "gap": "clearance", "stop": "stop on one side",
    "drag": "damping that grows with speed", "amplitude_damper": "damping that grows with amplitude",
    "coulomb": "dry friction", "slider": "friction of a slider behind a spring",
    "stribeck": "dry friction that weakens with speed", "iwan": "friction of many sliders",
    "pinched": "friction with pinched loops", "magnet": "softening spring", "backlash": "clearance",
    "asymmetric": "hardening, asymmetric spring", "lugre": "dry friction that weakens with speed",
}  # fmt: skip
"""How a reader would say it."""


@dataclass(frozen=True)
class Local:
    """A local force: its place, its kind among ``FAMILIES``, the element that makes it, and its strengths by name."""

    point: int
    name: str
    element: Element
    strengths: dict[str, float]


def local_force(name: str, case: dict[str, Any], point: int, draw: np.random.Generator) -> list[Local]:
    """One law at a point, sized by the motion that the highest level has without it."""
    shapes, omega = case["beam"].shapes[point - 1], math.sqrt(case["beam"].omega2[2])
    phi2, w = float(shapes[2] ** 2), abs(float(shapes[2])) * case["largest"]
    speed, ratio = omega * w, case["beam"].ratio(2)
    shift = float(np.exp(draw.uniform(math.log(0.005), math.log(0.03))))  # Δω/ω at the highest level
    lost = float(draw.uniform(0.4, 1.2)) * ratio  # damping ratio there
    spring, damper = 2.0 * shift * omega**2 / phi2, 2.0 * lost * omega / phi2
    soft = 0.2 * spring  # what softens more throws the beam off its suspension
    friction = damper * math.pi * omega * w / 4.0
    rubbed = 0.04 * friction  # the lowest level moves it
    stuck = 2.0 * float(draw.uniform(0.004, 0.008)) * omega**2 / phi2

    def one(
        kind: str, parameters: Sequence[float], sliders: Sequence[tuple[float, float]] = (), **strengths: Any
    ) -> list[Local]:
        plain = {key: float(value) for key, value in strengths.items()}
        return [Local(point, name, Element(kind, shapes, tuple(parameters), tuple(sliders)), plain)]

    if name in ("cubic", "softening"):
        k = (spring if name == "cubic" else -soft) / (0.75 * w**2)
        return one("cubic", [k], **{"power 3": k})
    if name == "quintic":
        k = spring / (0.625 * w**4)
        return one("quintic", [k], **{"power 5": k})
    if name == "quadratic":
        # The mean force pushes the beam on its suspension; at twice as much it has no equilibrium.
        k = float(draw.uniform(0.1, 0.2)) * 3950.0 * case["mass"] / w
        return one("polynomial", [0.0, k], **{"power 2": k})
    if name == "gap":
        k, gap = spring / 0.391, 0.5 * w
        return one("gap", [k, gap], gap=k, clearance=gap)
    if name == "stop":
        k, gap = 2.0 * spring / 0.391, 0.5 * w
        return one("stop", [k, gap], stop=k, clearance=gap)
    if name == "drag":
        c = damper * 3.0 * math.pi / (8.0 * speed)
        return one("drag", [c], **{"speed 2": c})
    if name == "amplitude_damper":
        c = 4.0 * damper / w**2
        return one("amplitude_damper", [c], **{"amplitude 2": c})
    if name == "coulomb":
        return one("stribeck", [rubbed, 2e-3 * speed, 0.0, 1.0], friction=rubbed)
    if name == "slider":
        slip = float(draw.uniform(0.1, 0.25)) * w
        return one("sliders", [], [(stuck, stuck * slip)], slider=stuck, clearance=slip)
    if name == "stribeck":
        return one("stribeck", [0.35 * rubbed, 1e-3 * speed, float(draw.uniform(0.6, 1.4)), 0.15 * speed])
    if name == "iwan":
        slips = np.geomspace(0.02, 1.2, 30) * w
        each = stuck * slips**-0.5 / float(np.sum(slips**-0.5))
        return one("sliders", [], [(float(k), float(k * s)) for k, s in zip(each, slips, strict=True)])
    if name == "pinched":
        return one("pinched", [1.5 * stuck, 0.25 * w, 1.5, 2.0, 0.06 * w])
    if name == "magnet":
        distance = 2.2 * w
        return one("magnet", [-soft / (0.75 * w**2) * distance**5 / 8.0, distance])
    if name == "softening_and_drag":
        half = local_force("drag", case, point, draw)
        k = -soft / (0.625 * w**4)
        return [*one("quintic", [k]), *half]
    if name == "backlash":
        return one("backlash", [spring / 0.5, 0.4 * w, 1.0 * spring / speed])
    if name == "asymmetric":
        k = 0.12 * 3950.0 * case["mass"] / w
        return one("polynomial", [0.0, k, spring / (0.75 * w**2)])
    if name == "lugre":
        return one("lugre", [3.0 * stuck, 1e-3 * damper, 0.25 * friction, 0.4 * friction, 0.1 * speed])
    raise KeyError(name)


def _laws(family: str, case: dict[str, Any], draw: np.random.Generator) -> list[Local]:
    moving = [p for p in _POINTS if abs(case["beam"].shapes[p - 1, 2]) > 0.3 * abs(case["beam"].shapes[0, 2])]
    point = int(draw.choice(moving))
    if "_and_" not in family or family == "softening_and_drag":
        return local_force(family, case, point, draw)
    other = int(draw.choice([p for p in moving if abs(p - point) >= 3]))
    first, second = family.split("_and_")
    return [*local_force(first, case, point, draw), *local_force(second, case, other, draw)]


def make_beam_case(folder: Path, family: str, seed: int) -> None:
    """Write one case of the beam, ``truth.yaml`` last."""
    case = draw_case(seed, modes=6)
    draw, beam, chain = case["draw"], case["beam"], case["chain"]
    case["largest"] = 1.5e-3 / abs(float(beam.shapes[0, 2]))
    sensor = int(draw.integers(1, len(SENSORS) + 1))
    laws = _laws(family, case, draw) if family in IN_LIBRARY + OUTSIDE else []
    chain["hum"] = 1e-3 if family == "hum" else chain["hum"]
    scale = 0.992 if family == "detuned" else 1.0
    if family == "gain":
        chain["gains"][sensor] *= 0.94
    elif family == "force_gain":
        chain["gains"][0] *= 1.06
    elif family == "late":
        chain["delays"][sensor] = 3e-4
    elif family == "clipped":
        case["clipped"] = {sensor: 0.75}
    elements = [law.element for law in laws]
    if family == "stinger_spring":
        k = 0.02 * float(beam.omega2[2]) / float(beam.shapes[DRIVEN - 1, 2]) ** 2
        elements = [Element("polynomial", beam.shapes[DRIVEN - 1], (k,))]
    frequencies = np.sqrt(beam.omega2) / (2.0 * math.pi) * scale
    ratios = np.array([beam.ratio(mode) for mode in range(frequencies.size)])
    driven, load = beam.shapes[DRIVEN - 1], beam.shapes[DRIVEN - 1]
    top = 2.0 * ratios[2] * beam.omega2[2] * case["largest"] / abs(float(driven[2]))
    modes, hz = frequencies.size, float(frequencies[2])
    simulator = Simulator(frequencies, ratios, load, elements)
    pieces, segments, truth_levels, begin = [], [], [], 0.0

    def add(rows: np.ndarray) -> float:
        nonlocal begin
        pieces.append(
            np.column_stack([rows[:, -1], rows[:, 2 * modes : 3 * modes] @ beam.shapes[np.array(SENSORS) - 1].T])
        )
        begin += len(rows) / RATE
        return begin

    for share in (1.0, 0.5):
        start = begin
        stop = add(simulator.tap(share * 2.0 * top, 0.004, round(3.0 * RATE), RATE)[0])
        segments.append({"kind": "record", "start": round(start, 6), "stop": round(stop - 1.5 / RATE, 6)})
    settle = 6.0 / (2.0 * math.pi * ratios[2])
    for number, level in enumerate(np.geomspace(0.06, 1.0, LEVELS) * top):
        state = simulator.state
        if family == "drift":
            slower = frequencies * (1.0 - 0.004 * number / (LEVELS - 1))
            simulator = Simulator(slower, ratios, load, elements)
            simulator.state = state
        if number == 0:
            # From a small motion in the shape of the mode.
            simulator.state[:] = 0.0
            simulator.state[modes + 2] = 0.06 * case["largest"] * 2.0 * math.pi * hz
            simulator.state[-2] = simulator.state[modes + 2] * float(driven[2])
        start = begin
        for part in (1.0, 0.5, 0.5):
            rows, _ = simulator.tracked(float(level), hz, math.ceil(part * settle / hz * RATE), RATE)
            add(rows)
            hz = frequency_of(rows[-min(len(rows), round(60 / hz * RATE)) :, modes + 2], RATE)
        # The frequency of the band-pass stays as it is to the window's end.
        count = round(_WINDOW / hz * RATE)
        add(simulator.tracked(float(level), hz, math.ceil(0.7 * settle / hz * RATE), RATE)[0])
        from_here = begin
        rows, forces = simulator.tracked(float(level), hz, count, RATE)
        stop = add(rows)
        truth_levels.append(_truth_of(rows, forces, laws, modes, frequency_of(rows[:, modes + 2], RATE)))
        segments.append({"kind": "phase_resonance", "level": float(f"{level:.6g}"), "level_unit": "N",
                         "start": round(start, 6), "stop": round(stop - 1.0 / RATE, 6),
                         "window": [round(from_here, 6), round(stop - 1.0 / RATE, 6)]})  # fmt: skip
    signals = np.concatenate(pieces)
    sizes = np.array([2e-4, *[3e-5 * float(np.abs(signals[:, 1:]).max())] * len(SENSORS)])
    columns: dict[str, Any] = {"f": _through_chain(case, signals[:, 0], 0, sizes)}
    columns |= {f"a{p}": _through_chain(case, signals[:, k + 1], k + 1, sizes) for k, p in enumerate(SENSORS)}
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(folder / "data.npz", **columns)
    channels = [{"column": "f", "quantity": "force", "unit": "N", "point": DRIVEN}]
    channels += [{"column": f"a{p}", "quantity": "acceleration", "unit": "m/s^2", "point": p} for p in SENSORS]
    sidecar = {"rig": "model.yaml", "sample_rate": RATE, "file": "data.npz", "channels": channels, "segments": segments}
    truth = {
        "group": "other" if not laws else "library" if family in IN_LIBRARY else "outside",
        "laws": [
            {"point": law.point, "family": FAMILIES[_kind(law)], "strengths": law.strengths}
            for law in laws
        ],
        "levels": truth_levels,
    }  # fmt: skip
    for name, content in (("sidecar", sidecar), ("model", owners_model(case["model"])), ("truth", truth)):
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def _kind(law: Local) -> str:
    """Name of a law in ``FAMILIES``; the parts of a law of two have names of their own."""
    return law.name if law.name in FAMILIES else {"quintic": "softening"}[law.element.kind]


def _truth_of(
    rows: np.ndarray, forces: np.ndarray, laws: Sequence[Local], modes: int, hz: float
) -> dict[str, Any]:  # fmt: skip
    """Harmonics of displacement and force of every place, by least squares over the window; cos is real."""
    angle = 2.0 * math.pi * hz * np.arange(len(rows)) / RATE
    base = np.concatenate(
        [np.ones((1, angle.size)), *[[np.cos(h * angle), np.sin(h * angle)] for h in range(1, _ORDERS + 1)]]
    ).T
    found: dict[str, Any] = {"frequency_hz": hz, "places": {}}
    for point in dict.fromkeys(law.point for law in laws):
        own = [k for k, law in enumerate(laws) if law.point == point]
        signals = np.column_stack([rows[:, :modes] @ laws[own[0]].element.shape, forces[:, own].sum(axis=1)])
        fit = np.linalg.lstsq(base, signals, rcond=None)[0]
        series = np.vstack([fit[:1].astype(complex), fit[1::2] - 1j * fit[2::2]])
        found["places"][point] = {
            name: [[float(z.real), float(z.imag)] for z in series[:, k]]
            for k, name in enumerate(("displacement", "force"))
        }
    return found


def _recipes(seed: int) -> dict[str, laboratory_one.Recipe]:
    """Cases of laboratory one: six with a law, six without one."""
    scale, draw = laboratory_one._shape, np.random.default_rng([1, seed])
    found: dict[str, laboratory_one.Recipe] = {}

    def size() -> float:
        return float(np.exp(draw.uniform(-0.5, 0.5)))

    def point(*among: int) -> int:
        return int(draw.choice(among))

    def add(
        name: str, effects: dict[str, Any], group: str, laws: Sequence[tuple[int, str, dict[str, float]]] = (),
        chain: dict[str, Any] | None = None, amplifier: Any = None,
    ) -> None:  # fmt: skip
        number = len(found) + 1
        truth = {
            "group": group,
            "laws": [{"point": p, "family": FAMILIES[f], "strengths": strengths} for p, f, strengths in laws],
            "levels": [],
        }
        chain = {"seed": seed + number, **(chain or {})}
        recipe = laboratory_one.Recipe(effects, chain, {}, truth, (0.01, 0.2), 10 * seed + number, amplifier)
        found[f"one_{seed:04d}_{number:02d}_{name}"] = recipe

    at = point(5, 6, 7)
    k = 1.5e8 * size() / scale(at) ** 4
    add("cubic", {"cubic": (k, at)}, "library", [(at, "cubic", {"power 3": k})])
    at = point(5, 6, 7)
    ratio = scale(at) / scale(6)
    k, gap = 200.0 * size() / ratio**2, 1.0e-3 * ratio
    add("gap", {"gap": (k, gap, at)}, "library", [(at, "gap", {"gap": k, "clearance": gap})])
    at = point(5, 6)
    k = 9.0e3 * size()
    add("quadratic", {"quad": (k, at)}, "library", [(at, "quadratic", {"power 2": k})])
    at = point(5, 6)
    k = 3000.0 * size()
    add("slider", {"jenkins2": (k, 0.2, at)}, "library", [(at, "slider", {"slider": k, "clearance": 0.2 / k})])
    at = point(5, 6, 7)
    force = 0.05 * size() * scale(6) / scale(at)
    add("stribeck", {"ext": [(7, at, force, 0.8, 0.02 * scale(at) / scale(6))]}, "outside", [(at, "stribeck", {})])
    k, c = 1.2e8 * size(), 3.0 * size()
    add("cubic_and_drag", {"cubic": (k, 7), "drag": (c, 5)}, "outside",
        [(7, "cubic", {"power 3": k}), (5, "drag", {"speed 2": c})])  # fmt: skip
    add("fine", {}, "other")
    joint = {"_muN": 1.0 + 0.2 * draw.uniform(-1, 1), "_kt": 1.0 + 0.06 * draw.uniform(-1, 1)}
    add("joint", {**joint, "beta_scale": 1.0 + 0.2 * draw.uniform(-1, 1)}, "other")
    add("source", {"shaker": {"R": 3.0 + 2.5 * size()}}, "other")
    most = 4.0 * size()
    add("saturation", {}, "other", amplifier=lambda u: most * np.tanh(u / most))
    add("gain", {}, "other", chain={"gain_a4": 0.93})
    add("loose_mass", {"ext": [(8, point(6, 7), 0.004, 3e-4 * size(), 3e4)]}, "other")
    return found


def names(laboratory: Path | None, seed: int) -> list[str]:
    """Names of the cases; those of laboratory one only where it is at hand."""
    families = [*IN_LIBRARY, *OUTSIDE, *OTHERS]
    found = [f"beam_{seed + k:04d}_{family}" for k, family in enumerate(families)]
    return found + ([*_recipes(seed)] if laboratory is not None else [])


def make_case(out: Path, name: str, laboratory: Path | None) -> str:
    """Write one case; nothing where it is there already.

    Returns:
        Its name.
    """
    folder = out / name
    if (folder / "truth.yaml").is_file():
        return name
    if name.startswith("beam_"):
        _, seed, family = name.split("_", 2)
        make_beam_case(folder, family, int(seed))
    elif laboratory is not None:
        simulate, _ = laboratory_one.recipes_of(laboratory)
        laboratory_one.write_case(simulate, laboratory, folder, _recipes(int(name.split("_")[1]))[name])
    return name
