"""Cases of a laboratory that others wrote, as folders that ``./nmt blind laboratory`` takes.

The laboratory (a beam with a friction joint behind a shaker; own simulator, loop and measuring chain) lies beside
this repository where it is at hand. It makes its cases by code; this writes its twenty, and forty more with other
seeds, points, strengths and tolerances, each with the truth that was put in. Run in ``./nmt shell``::

    python -m nmt_laboratories.laboratory_one LABORATORY --out DIR --jobs 2

A case that is there already is not made again.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import math
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from joblib import Parallel, delayed

SAMPLE_RATE = 10000.0
_MODE_HZ = 22.2
_HOLD = 12.0
_COLUMNS = (2, 4, 5, 6)
_SLIP = "local_elements.joint.slip_force_n"
_STIFFNESS = "local_elements.joint.tangential_stiffness_n_m"
_DAMPING = "structure.stiffness_damping_s"


@dataclass(frozen=True)
class Recipe:
    """What is simulated, and what is true of it.

    Attributes:
        effects: of the structure, in the laboratory's own words.
        chain: of the measuring chain, likewise.
        options: of the laboratory's ``run_case``; ``model`` and ``only`` are taken out.
        truth: content of ``truth.yaml``.
        tolerance: relative gain and phase (deg at the first mode) of ordinary sensors, drawn with ``seed``.
        seed: of the tolerances.
        amplifier: voltage of the amplifier's input to that of its output.
    """

    effects: dict[str, Any]
    chain: dict[str, Any]
    options: dict[str, Any]
    truth: dict[str, Any]
    tolerance: tuple[float, float] = (0.0, 0.0)
    seed: int = 0
    amplifier: Callable[[np.ndarray], np.ndarray] | None = field(default=None, compare=False)


def _healthy(*verdicts: str, **parameters: float) -> dict[str, Any]:
    return {"kind": "healthy", "verdicts": list(verdicts), "parameters": parameters}


def _effect(
    names: str | Sequence[str],
    place: Sequence[str] = (),
    partly: Sequence[str] = (),
    verdicts: Sequence[str] = ("effect",),
    sizes: Mapping[str, float] | None = None,
    **parameters: float,
) -> dict[str, Any]:
    sets = [names] if isinstance(names, str) else list(names)
    return {
        "kind": "effect",
        "verdicts": list(verdicts),
        "effects": sets,
        "partly": list(partly),
        "place": list(place),
        "parameters": {**(sizes or {}), **parameters},
    }


def _unknown(place: Sequence[str] = (), partly: Sequence[str] = ()) -> dict[str, Any]:
    return {"kind": "unknown", "verdicts": ["unknown"], "place": list(place), "partly": list(partly)}


_FINE = _healthy("none", "calibration")
_FRICTION = ("power_law_damping", "second_friction_contact")
OWN_TRUTHS: dict[str, dict[str, Any]] = {
    "null_2": _FINE,
    "calib_slip": _healthy("calibration", **{_SLIP: 1.25}),
    "x_null_tolsmall": _FINE,
    "x_null_tol": _FINE,
    "x_null_skew20us": _FINE,
    "x_cal_thd": _healthy("calibration", **{_SLIP: 1.1}),
    "x_hold": _effect("cubic_stiffness", ["7"], k=1.1e6),
    "x_cubic_tol": _effect("cubic_stiffness", ["7"], k=1.1e6),
    "gap_6": _effect("two_sided_gap", ["6"], k=150.0, gap=1.2e-3),
    "source_R": _effect("source_impedance", R=1.5),
    "two_cubic_gain": _effect(
        ["cubic_stiffness + force_gain", "cubic_stiffness + response_gain"], ["7"], ["cubic_stiffness"],
        sizes={"cubic_stiffness.k": 1.1e6},
    ),
    "x_two_stop_gain": _effect(
        "one_sided_stop + response_gain", ["6"], ["one_sided_stop"],
        sizes={"one_sided_stop.k": 150.0, "one_sided_stop.gap": 1.2e-3, "response_gain.g": -0.05},
    ),
    "skew": _effect(
        ["shared_delay", "channel_skew", "low_pass", "drive_hold"], verdicts=["effect", "calibration"], tau=1.5e-4
    ),
    "gain_a4": _effect("response_gain", ["a4"], g=-0.05),
    "clip_a2": _effect("clipping", ["a2"]),
    "microslip": _effect("microslip", ["joint"]),
    "x_stribeck": _unknown(["6"], _FRICTION),
    "x_amp_cross": _unknown(),
    "x_cubic_strong": _effect("cubic_stiffness", ["7"], k=3e8),
    "x_cubic_weak": _effect("cubic_stiffness", ["7"], k=1.1e5),
}  # fmt: skip
"""The laboratory's own cases: verdict, effect and place as it states them."""


def _shape(point: int) -> float:
    """First mode of a clamped beam at one of seven equal parts, over the tip (Rao, Mechanical Vibrations)."""
    root = 1.875104068711961
    sigma = (math.cos(root) + math.cosh(root)) / (math.sin(root) + math.sinh(root))

    def bent(x: float) -> float:
        return math.cosh(x) - math.cos(x) - sigma * (math.sinh(x) - math.sin(x))

    return bent(root * point / 7.0) / bent(root)


def _cubic(point: int, factor: float) -> tuple[dict[str, Any], dict[str, Any]]:
    k = 1.1e6 * factor / _shape(point) ** 4
    return {"cubic": (k, point)}, _effect("cubic_stiffness", [str(point)], k=k)


def _stop(kind: str, name: str, point: int, factor: float) -> tuple[dict[str, Any], dict[str, Any]]:
    ratio = _shape(point) / _shape(6)
    k, gap = 150.0 * factor / ratio**2, 1.2e-3 * ratio
    return {kind: (k, gap, point)}, _effect(name, [str(point)], k=k, gap=gap)


def _damped(kind: int, name: str, key: str, point: int, value: float, power: int) -> tuple[dict[str, Any], Any]:
    c = value / _shape(point) ** power
    injected = {"drag": (c, point)} if kind == 2 else {"ext": [(kind, point, c, 0.0, 0.0)]}
    return injected, _effect(name, [str(point)], sizes={key: c})


def _stribeck(point: int, force: float) -> tuple[dict[str, Any], dict[str, Any]]:
    scale = _shape(6) / _shape(point)
    return {"ext": [(7, point, force * scale, 0.5, 0.02 / scale)]}, _unknown([str(point)], _FRICTION)


def _rattle(point: int, gap: float) -> tuple[dict[str, Any], dict[str, Any]]:
    return {"ext": [(8, point, 0.004, gap, 3e4)]}, _unknown([str(point)], ("added_mass", "two_sided_gap"))


def more_recipes(models: Path) -> dict[str, Recipe]:
    """Forty more cases by name: thirteen healthy, twenty-one with an effect of the library, six with another.

    Args:
        models: the laboratory's folder of rig files.
    """
    ordinary, stiff = (0.01, 0.2), {"kt": 20000.0, "model": str(models / "rig_kt20.yaml")}
    few = {"levels": np.geomspace(0.08, 2.0, 5)}
    weak, wide = {"only": (2, 6)}, {"zoh": True}
    found: dict[str, Recipe] = {}

    def add(name: str, own: tuple[dict[str, Any], dict[str, Any]], tolerance: Any = (0.0, 0.0),
            chain: Any = None, amplifier: Any = None, **options: Any) -> None:  # fmt: skip
        number = len(found) + 1
        chain = {"seed": 100 + number, **(chain or {})}
        recipe = Recipe(own[0], chain, options, own[1], tolerance, 1000 + number, amplifier)
        found[f"more_{number:02d}_{name}"] = recipe

    def shifted(slip: float = 1.0, stiffness: float = 1.0, damping: float = 1.0) -> tuple[dict[str, Any], Any]:
        given = {
            "_muN": (slip, _SLIP, 1.0),
            "_kt": (stiffness, _STIFFNESS, 8000.0),
            "beta_scale": (damping, _DAMPING, 1e-4),
        }
        changed = {key: value for key, value in given.items() if value[0] != 1.0}
        true = {name: factor * base for factor, name, base in changed.values()}
        return {key: value[0] for key, value in changed.items()}, _healthy("calibration", **true)

    add("fine", ({}, _FINE), ordinary)
    add("fine", ({}, _FINE), ordinary)
    add("fine_hold", ({}, _FINE), ordinary, **wide)
    add("fine_distorted", ({}, _FINE), ripple=True)
    add("fine_noisy", ({}, _FINE), noise=5.0)
    add("fine_few", ({}, _FINE), (0.005, 0.1), **few)
    add("fine_stiff", ({}, _FINE), ordinary, **stiff)
    add("slip", shifted(slip=0.8))
    add("joint_and_damping", shifted(stiffness=1.08, damping=1.2))
    add("slip_tolerances", shifted(slip=1.15), ordinary)
    add("damping_distorted", shifted(damping=0.75), ripple=True)
    add("all", shifted(1.07, 0.95, 1.12), (0.003, 0.05))
    add("slip_two_sensors", shifted(slip=0.85, stiffness=0.93), **weak)
    add("cubic", _cubic(5, 0.5))
    add("cubic", _cubic(6, 0.15), ordinary)
    add("cubic_hold", _cubic(4, 0.3), **wide)
    add("cubic_few", _cubic(7, 2.0), ordinary, **few)
    add("cubic_stiff", _cubic(6, 1.0), **stiff)
    add("quadratic", ({"quad": (1.2e4, 5)}, _effect("quadratic_stiffness", ["5"], k=1.2e4)))
    add("stop", _stop("stop", "one_sided_stop", 5, 1.0), ordinary)
    add("gap", _stop("gap", "two_sided_gap", 7, 0.6))
    add("drag", _damped(2, "air_drag", "c2", 6, 0.05, 3), (0.005, 0.1))
    add("drag", _damped(2, "air_drag", "c2", 7, 0.02, 3))
    # Damping at a point and damping of the whole model differ by the shapes of few modes.
    add(
        "damper",
        (
            {"ext": [(6, 7, 0.08, 0.0, 0.0)]},
            _effect("viscous_damping", ["7"], ["structural_damping"], ("effect", "calibration"), c=0.08),
        ),
    )
    add(
        "friction",
        ({"jenkins2": (4000.0, 0.15, 5)}, _effect("second_friction_contact", ["5"], kt=4000.0, slip_force=0.15)),
    )
    add("mass", ({"tip_mass": 0.006}, _effect(["added_mass", "sensor_mass"], ["7"], m=0.006)), ordinary)
    add("source", ({"shaker": {"R": 5.0}}, _effect("source_impedance", R=2.0)), (0.005, 0.1))
    add("force_gain", ({}, _effect(["force_gain", "response_gain"], g=0.06)), chain={"gain_f": 1.06})
    add("response_gain", ({}, _effect("response_gain", ["a4"], g=0.07)), (0.003, 0.1), chain={"gain_a4": 1.07})
    add("skew", ({}, _effect(["channel_skew", "low_pass"], ["a4"], tau=2.5e-4)), chain={"skew_a4": 2.5e-4})
    add("clipping", ({}, _effect("clipping", ["a2"])), ordinary, chain={"clip_a2": 0.6})
    add("hum", ({}, _effect("mains_hum", ["a5"], amplitude=0.04)), chain={"hum": 0.04})
    add("microslip", ({"iwan": (40, 0.9)}, _effect("microslip", ["joint"])), ordinary)
    add("saturation", ({}, _effect("amplifier_saturation", V=5.0)), amplifier=lambda u: 5.0 * np.tanh(u / 5.0))
    add("stribeck", _stribeck(7, 0.03))
    add("stribeck", _stribeck(6, 0.04), ordinary)
    add("stribeck_stiff", _stribeck(5, 0.03), **stiff)
    add("rattle", _rattle(7, 2e-4))
    add("rattle", _rattle(6, 1e-4), (0.005, 0.1))
    add("crossover", ({}, _unknown()), amplifier=lambda u: u - 0.03 * np.tanh(u / 0.03))
    return found


def own_recipes(simulate: Any, basic: Any) -> dict[str, Recipe]:
    """The laboratory's twenty cases by name.

    Args:
        simulate, basic: its modules ``simulate`` and ``basic_cases``.
    """
    found = {}
    for name, truth in OWN_TRUTHS.items():
        effects, chain, options = (*basic.CASES[name][:2], {}) if name in basic.CASES else simulate.EXTRA[name]
        options = dict(options)
        amplifier = getattr(simulate, options.pop("amp")) if "amp" in options else None
        found[name] = Recipe(effects, chain, options, truth, amplifier=amplifier)
    return found


def make_case(laboratory: Path, out: Path, name: str) -> str:
    """Simulate one case and write its folder, ``truth.yaml`` last; nothing where that is there.

    Args:
        laboratory: its folder.
        out: gets the case's folder.
        name: of one of the sixty.

    Returns:
        The name.
    """
    if not (out / name / "truth.yaml").is_file():
        simulate, recipes = recipes_of(laboratory)
        write_case(simulate, laboratory, out / name, recipes[name])
    return name


def write_case(simulate: Any, laboratory: Path, folder: Path, recipe: Recipe) -> None:
    """Simulate a recipe by the laboratory's module ``simulate`` and write its folder, ``truth.yaml`` last."""
    options = {"hold": _HOLD, **recipe.options}
    model = Path(options.pop("model", laboratory / "rigs" / "rigacc.yaml"))
    only = options.pop("only", _COLUMNS)
    with contextlib.redirect_stdout(io.StringIO()):
        u, force, responses, segments = simulate.run_case(
            recipe.effects, recipe.chain, amp_fn=recipe.amplifier, **options
        )
    force, responses = _as_sensors_are(force, responses, recipe)
    folder.mkdir(parents=True, exist_ok=True)
    columns = {"u": u, "f": force} | {f"a{p}": responses[:, _COLUMNS.index(p)] for p in only}
    # Single precision is a thousandth of the noise.
    np.savez_compressed(folder / "data.npz", **{key: value.astype(np.float32) for key, value in columns.items()})
    shutil.copyfile(model, folder / "model.yaml")
    sidecar = {
        "rig": "model.yaml",
        "sample_rate": SAMPLE_RATE,
        "file": "data.npz",
        "channels": [
            {"column": "u", "quantity": "voltage", "unit": "V"},
            {"column": "f", "quantity": "force", "unit": "N", "point": 2},
            *({"column": f"a{p}", "quantity": "acceleration", "unit": "m/s^2", "point": p} for p in only),
        ],
        "segments": segments,
    }
    (folder / "sidecar.yaml").write_text(yaml.safe_dump(sidecar, sort_keys=False))
    (folder / "truth.yaml").write_text(yaml.safe_dump(recipe.truth, sort_keys=False))


def names(laboratory: Path) -> list[str]:
    """Names of the sixty cases."""
    return list(recipes_of(laboratory)[1])


def recipes_of(laboratory: Path) -> tuple[Any, dict[str, Recipe]]:
    """The laboratory's simulator, and all recipes."""
    # Its module "rig" must not be the folder of tests that has the same name.
    others = {name: sys.modules.pop(name) for name in [*sys.modules] if name.partition(".")[0] == "rig"}
    sys.path.insert(0, str(laboratory))
    try:
        simulate, basic = importlib.import_module("simulate"), importlib.import_module("basic_cases")
    finally:
        sys.path.remove(str(laboratory))
        sys.modules.update(others)
    return simulate, own_recipes(simulate, basic) | more_recipes(laboratory / "rigs")


def _as_sensors_are(force: np.ndarray, responses: np.ndarray, recipe: Recipe) -> tuple[np.ndarray, np.ndarray]:
    """Gains, and phases as the high-pass of an AC coupling leaves them, drawn for each sensor."""
    gain, phase = recipe.tolerance
    if gain == 0.0 and phase == 0.0:
        return force, responses
    draw = np.random.default_rng(recipe.seed)
    lines = np.fft.rfftfreq(force.size, 1.0 / SAMPLE_RATE)

    def sensor(signal: np.ndarray) -> np.ndarray:
        factor = 1.0 + gain * draw.standard_normal()
        corner = math.tan(math.radians(phase) * abs(draw.standard_normal())) * _MODE_HZ
        spectrum = np.fft.rfft(signal) * factor
        spectrum[1:] *= 1j * lines[1:] / (1j * lines[1:] + corner)
        return np.fft.irfft(spectrum, signal.size)

    return sensor(force), np.column_stack([sensor(column) for column in responses.T])


def main() -> None:
    """Make the cases that are not there yet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("laboratory", type=Path, help="folder of the laboratory")
    parser.add_argument("--out", type=Path, required=True, help="gets a folder for each case")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default 1)")
    parser.add_argument("--only", default="", help="names of cases, with commas between them (default: all)")
    given = parser.parse_args()
    laboratory = given.laboratory.resolve()
    chosen = [name for name in given.only.split(",") if name] or names(laboratory)
    work = (delayed(make_case)(laboratory, given.out.resolve(), name) for name in chosen)
    for name in Parallel(n_jobs=given.jobs, return_as="generator_unordered")(work):
        print(name, flush=True)


if __name__ == "__main__":
    main()
