"""Rigs of laboratories and chains of masses behind a converter: their simulators answer to a drive, in real time.

Nothing of the bench's simulation is in them. ``./nmt blind investigate`` takes what this writes: for each rig the model
that its owner believes, the rig file with the driver, and the truth. Run in ``./nmt shell``::

    python -m nmt_laboratories.driven_laboratories one --laboratory LABORATORY --count 5 --out RIGS
    python -m nmt_laboratories.driven_laboratories two --count 5 --out RIGS
    python -m nmt_laboratories.driven_laboratories masses --count 20 --out RIGS

Laboratory one is a beam with a friction joint behind a shaker, two a pinned beam at a force, masses are four in a row
on springs, with one effect, nothing, or an effect beside a wrong gain. The drive goes along a straight line from sample
to sample. Sensors have gains of an ordinary laboratory and noise; phases are right.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numba import njit

from nmt_laboratories import laboratory_one, laboratory_two
from nmt_laboratories.modal_simulator import Element, Simulator, _rates

_LATE = 0.05  # s by which a clock may be behind before it goes on from the present
_RANGE = 10.0  # V at every port
_SECOND_RATE = 5000.0
_SECOND_LEVELS = "0.08:1:10"
_NOISE = 1e-4  # of the largest motion that is expected


class _Laboratory:
    """Takes samples when they are due, and answers by what a simulator makes of them.

    Args:
        sample_rate: Hz.
        outputs, inputs: (port, range in V) of each.
        sensitivities_v: volts for a unit of each input, the monitor of the drive last.
        noise: standard deviation of each input, units.
        seed: of the noise.
    """

    delay = 1  # what is measured is the motion at the beginning of a sample's interval

    def __init__(self, sample_rate, outputs, inputs, sensitivities_v, noise, seed) -> None:  # type: ignore[no-untyped-def]
        self._rate, self._draw = float(sample_rate), np.random.default_rng(seed)
        self._sensitivities = np.array(sensitivities_v, dtype=float)[:, None]
        self._noise = np.array(noise, dtype=float)[:, None]
        self._last = 0.0
        self._due = time.monotonic()

    def exchange(self, volts: np.ndarray) -> np.ndarray:
        """Put out (1, n) samples; return (inputs, n) when they are due."""
        drive = np.concatenate([[self._last], volts[0]])
        values = np.vstack([self._answer(drive), drive[:-1]])
        self._last = float(drive[-1])
        measured = self._sensitivities * (values + self._noise * self._draw.standard_normal(values.shape))
        self._due = max(self._due, time.monotonic() - _LATE) + volts.shape[1] / self._rate
        time.sleep(max(0.0, self._due - time.monotonic()))
        return measured

    def _answer(self, drive: np.ndarray) -> np.ndarray:
        """Channels at the first n of n + 1 samples of the drive."""
        raise NotImplementedError

    def close(self) -> None:
        """The simulation is left as it is."""


class LaboratoryOne(_Laboratory):
    """A recipe of laboratory one: force of the stinger, four accelerations, drive.

    Args:
        laboratory: its folder.
        case: name of the recipe.
        **port: of every converter.
    """

    def __init__(self, sample_rate, outputs, inputs, laboratory, case, sensitivities_v, noise, seed) -> None:  # type: ignore[no-untyped-def]
        super().__init__(sample_rate, outputs, inputs, sensitivities_v, noise, seed)
        simulate, recipes = laboratory_one.recipes_of(Path(laboratory))
        recipe = recipes[case]
        effects = dict(recipe.effects)
        slip, stiffness = effects.pop("_muN", 1.0), 8000.0 * effects.pop("_kt", 1.0)
        self._rig = simulate.Rig(kt=stiffness, muN=slip, exc=2, fs=self._rate, effects=effects)
        self._gains = np.ones((5, 1))
        self._gains[0] = recipe.chain.get("gain_f", 1.0)
        self._gains[2] = recipe.chain.get("gain_a4", 1.0)

    def _answer(self, drive: np.ndarray) -> np.ndarray:
        substeps, n = self._rig.nsub, drive.size - 1
        fine = np.interp(np.arange(n * substeps + 1) / substeps, np.arange(n + 1), drive)
        found = self._rig.step2(np.ascontiguousarray(fine[:-1]), np.ascontiguousarray(fine[1:]))
        return np.asarray(self._gains * np.vstack([found["force"], found["acc"][:, [1, 3, 4, 5]].T]))


class _Modes(_Laboratory):
    """A structure by its modes at a force: force, accelerations, drive."""

    def _take(self, frequencies_hz, ratios, load, elements, sensors, gains, newton_per_volt) -> None:  # type: ignore[no-untyped-def]
        self._simulator = Simulator(frequencies_hz, ratios, load, elements)
        self._substeps = math.ceil(10.0 * frequencies_hz[-1] / self._rate) + 1
        self._newton_per_volt, self._gains = newton_per_volt, np.array(gains)[:, None]
        self._sensors = np.array(sensors)

    def _answer(self, drive: np.ndarray) -> np.ndarray:
        simulator, force = self._simulator, self._newton_per_volt * drive
        accelerations = np.empty((drive.size - 1, simulator.modes))
        _driven(
            simulator.state, simulator._at, force, self._substeps, 1.0 / self._rate / self._substeps, simulator._omega2,
            simulator._damping, simulator._load, simulator._kinds, simulator._shapes, simulator._parameters,
            simulator._stiff, simulator._limit, accelerations,
        )  # fmt: skip
        return np.asarray(self._gains * np.vstack([force[:-1], self._sensors @ accelerations.T]))


class LaboratoryTwo(_Modes):
    """The pinned beam of a seed of laboratory two: force, three accelerations, drive.

    Args:
        case: the seed.
        newton_per_volt: of the exciter.
        **port: of every converter.
    """

    def __init__(self, sample_rate, outputs, inputs, case, newton_per_volt, sensitivities_v, noise, seed) -> None:  # type: ignore[no-untyped-def]
        super().__init__(sample_rate, outputs, inputs, sensitivities_v, noise, seed)
        specimen, injected, chain, _ = _beam(case)
        gains = [chain.reference_gain, *(chain.gains[p] for p in specimen.sensors)]
        shapes = [specimen.shapes[p] for p in specimen.sensors]
        self._take(
            specimen.frequencies_hz, specimen.ratios, specimen.load, injected.elements, shapes, gains, newton_per_volt
        )


class Masses(_Modes):
    """A row of masses of ``MASS_RIGS``: force, two accelerations, drive.

    Args:
        case: its name.
        newton_per_volt: of the exciter.
        **port: of every converter.
    """

    def __init__(self, sample_rate, outputs, inputs, case, newton_per_volt, sensitivities_v, noise, seed) -> None:  # type: ignore[no-untyped-def]
        super().__init__(sample_rate, outputs, inputs, sensitivities_v, noise, seed)
        rig = MASS_RIGS[case]
        frequencies, shapes = _row_of_masses(rig.spring)
        ordinary = np.clip(np.random.default_rng([seed, 0x3A5]).standard_normal(3), -2.0, 2.0)
        gains = (1.0 + _ORDINARY_GAIN * ordinary) * [1.0, *(1.0 + rig.gains.get(p, 0.0) for p in _MASS_SENSORS)]
        self._take(
            frequencies, _MASS_RATIOS, shapes[0], _elements(rig), shapes[np.array(_MASS_SENSORS) - 1], gains,
            newton_per_volt,
        )  # fmt: skip
        self._late = np.array([rig.late.get(p, 0) for p in _MASS_SENSORS])
        self._kept = np.zeros((len(_MASS_SENSORS), int(self._late.max()) + 1))

    def _answer(self, drive: np.ndarray) -> np.ndarray:
        values = super()._answer(drive)
        run = np.hstack([self._kept, values[1:]])
        n, most = values.shape[1], self._kept.shape[1]
        for row, late in enumerate(self._late):
            values[1 + row] = run[row, most - late : most - late + n]
        self._kept = run[:, -most:]
        return values


@dataclass(frozen=True)
class _MassRig:
    """What a row of masses has beyond its model.

    Attributes:
        truth: content of ``truth.yaml``.
        element: kind of local force, its point; empty = none.
        spring: to the ground at mass 3, over that between masses.
        gains: relative errors beyond ordinary ones, by point.
        late: samples by which a channel comes late, by point.
    """

    truth: dict[str, Any]
    element: tuple[str, int] = ("", 0)
    spring: float = 0.0
    gains: dict[int, float] = field(default_factory=dict)
    late: dict[int, int] = field(default_factory=dict)


_MASS, _SPRING = 1.0, 2e5  # kg, N/m
_MASS_RATIOS = np.array([0.006, 0.005, 0.006, 0.008])
_MASS_SENSORS = (1, 4)
_LARGEST = 1.2e-3  # m, of mass 4 at the highest level
_ORDINARY_GAIN = 0.005
_MASS_LEVELS = "0.08:1:8"


def _effect(names: list[str], places: list[str], partly: list[str]) -> dict[str, Any]:
    return {"kind": "effect", "verdicts": ["effect"], "effects": names, "place": places, "partly": partly}


def _with_gain(rig: _MassRig, point: int, gain: float) -> _MassRig:
    """The same with a wrong gain beside it, which alone is a part of the truth."""
    truth = dict(rig.truth)
    if truth["kind"] == "effect":
        truth["partly"] = [*truth["effects"], *truth["partly"], "response_gain"]
        truth["effects"] = [f"{name} + response_gain" for name in truth["effects"]]
    else:
        truth = _effect(["response_gain"], [str(point), f"a{point}"], [])
    return _MassRig(truth, rig.element, rig.spring, rig.gains | {point: gain}, rig.late)


_HEALTHY = _MassRig({"kind": "healthy", "verdicts": ["none", "calibration"]})
_MOVED = _MassRig({"kind": "healthy", "verdicts": ["calibration"]}, spring=0.02)
_LATE_4 = _MassRig(_effect(["channel_skew", "low_pass"], ["4", "a4"], []), late={4: 2})
_CONTACT = ["second_friction_contact", "microslip"]
_LOCAL = {
    "cubic": _MassRig(_effect(["cubic_stiffness"], ["2"], ["quintic_stiffness"]), ("cubic", 2)),
    "softening": _MassRig(_effect(["cubic_stiffness"], ["4"], ["quintic_stiffness"]), ("softening", 4)),
    "friction": _MassRig(_effect(_CONTACT, ["3"], ["power_law_damping"]), ("friction", 3)),
    "stop": _MassRig(_effect(["one_sided_stop"], ["3"], ["two_sided_gap"]), ("stop", 3)),
    "rattle": _MassRig(_effect(["two_sided_gap"], ["4"], ["one_sided_stop"]), ("gap", 4)),
    "drag": _MassRig(_effect(["air_drag", "power_law_damping"], ["4"], ["amplitude_damping"]), ("drag", 4)),
    "slider": _MassRig(_effect(_CONTACT, ["3"], []), ("slider", 3)),
}
MASS_RIGS = {
    "nothing": _HEALTHY,
    "moved": _MOVED,
    "late": _LATE_4,
    "gain": _with_gain(_HEALTHY, 4, 0.07),
    **_LOCAL,
    "moved_gain": _with_gain(_MOVED, 1, -0.07),
    "late_gain": _with_gain(_LATE_4, 1, 0.07),
    **{f"{name}_gain": _with_gain(rig, 1 + 3 * (i % 2 == 0), 0.07) for i, (name, rig) in enumerate(_LOCAL.items())},
}  # fmt: skip
"""Rigs of a row of masses by name."""


def _row_of_masses(spring: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies, Hz, and mass-normalised shapes (masses, modes) of four masses, the first tied to the ground."""
    stiffness = _SPRING * (np.diag([2.0, 2.0, 2.0 + spring, 1.0]) - np.eye(4, k=1) - np.eye(4, k=-1))
    values, vectors = np.linalg.eigh(stiffness / _MASS)
    vectors = vectors * np.sign(vectors[-1])
    return np.sqrt(values) / (2.0 * np.pi), vectors / math.sqrt(_MASS)


def _elements(rig: _MassRig) -> tuple[Element, ...]:
    """Of a size that shifts mode 1 by 2 % or its damping by half, by averaging as in laboratory two."""
    kind, point = rig.element
    if not kind:
        return ()
    frequencies, shapes = _row_of_masses(rig.spring)
    shape, omega = shapes[point - 1], 2.0 * math.pi * float(frequencies[0])
    a = _LARGEST * abs(shape[0] / shapes[3, 0])
    unit, zeta = omega**2 / shape[0] ** 2, float(_MASS_RATIOS[0])
    k = 0.04 * unit
    if kind in ("cubic", "softening"):
        return (Element("cubic", shape, (k / (0.75 * a**2) * (1.0 if kind == "cubic" else -0.4),)),)
    if kind == "friction":
        return (
            Element("stribeck", shape, (0.5 * math.pi * unit * a * zeta * 0.12, 0.005 * omega * a, 0.0, omega * a)),
        )
    if kind in ("stop", "gap"):
        return (Element(kind, shape, ((4.0 if kind == "stop" else 2.0) * k, 0.4 * a)),)
    if kind == "drag":
        return (Element("drag", shape, (0.6 * zeta * 0.75 * math.pi * unit / (omega**2 * a),)),)
    return (Element("sliders", shape, sliders=((k, 0.2 * k * a),)),)


@njit(cache=True, error_model="numpy")
def _driven(
    y: Any, at: Any, force: Any, substeps: int, h: float, omega2: Any, damping: Any, b: Any, kinds: Any, shapes: Any,
    p: Any, stiff: Any, limit: Any, out: Any,
) -> None:  # fmt: skip
    """Runge and Kutta's fourth order under a force along straight lines between samples; sliders follow each step."""
    n, elements = omega2.size, kinds.size
    k, x, forces = np.zeros((4, y.size)), np.empty(y.size), np.empty(max(elements, 1))
    shares = np.array([0.0, 0.5, 0.5, 1.0])
    weights = np.array([1.0, 2.0, 2.0, 1.0]) / 6.0
    for sample in range(force.size - 1):
        for step in range(substeps):
            for stage in range(4):
                for c in range(y.size):
                    x[c] = y[c] + (h * shares[stage] * k[stage - 1, c] if stage else 0.0)
                place = (step + shares[stage]) / substeps
                s = force[sample] + place * (force[sample + 1] - force[sample])
                _rates(x, s, omega2, damping, b, kinds, shapes, p, stiff, limit, at, k[stage], forces)
                k[stage, y.size - 2 :] = 0.0
                if step == 0 and stage == 0:
                    out[sample] = k[0, n : 2 * n]
            for c in range(y.size):
                for stage in range(4):
                    y[c] += h * weights[stage] * k[stage, c]
            for e in range(elements):
                if kinds[e] == 6:
                    w = 0.0
                    for r in range(n):
                        w += shapes[e, r] * y[r]
                    for j in range(stiff.shape[1]):
                        if stiff[e, j] > 0.0:
                            slip = limit[e, j] / stiff[e, j]
                            at[e, j] = min(max(at[e, j], w - slip), w + slip)


def _beam(seed: int) -> tuple[Any, Any, Any, np.random.Generator]:
    """Specimen, what it has, and its chain, of a seed whose rig is taken for the beam; and what goes on drawing."""
    draw = np.random.default_rng([seed, 0x2AC])
    specimen = laboratory_two.draw_specimen("beam", draw)
    injected = laboratory_two.draw_truth(seed, specimen, draw)
    return specimen, injected, injected.chain(laboratory_two.draw_chain(specimen, draw)), draw


def write_rig(folder: Path, model: dict[str, Any], driver: str, arguments: dict[str, Any], truth: Any) -> None:
    """Write a rig's folder, ``truth.yaml`` last.

    Args:
        folder: of the rig.
        model: rig file of its owner.
        driver: name of the class.
        arguments: of the driver, without those of the ports.
        truth: content of ``truth.yaml``.
    """
    sensors = model["sensors"]
    names = {"force": "f", "acceleration": "a", "voltage": "u"}
    channels, largest = [], []
    limits = {"force": model["limits"]["force_n"], "acceleration": model["limits"]["acceleration_m_s2"],
              "voltage": model["limits"]["voltage_v"]}  # fmt: skip
    for sensor in sensors:
        point = model["exciter"]["point"] if sensor.get("point") == "drive" else sensor.get("point", "")
        channels.append(f"{names[sensor['quantity']]}{point}")
        largest.append(limits[sensor["quantity"]])
    sensitivities = [float(f"{_RANGE / most:.4g}") for most in largest]
    noise = [_NOISE * 0.02 * most for most in largest[:-1]] + [0.0]
    device = {
        "kind": "custom",
        "converter": f"nmt_laboratories.driven_laboratories:{driver}",
        "folder": str(Path(__file__).resolve().parents[1]),
        "arguments": {**arguments, "sensitivities_v": sensitivities, "noise": noise},
        "outputs": [{"channel": "u", "port": 1, "range_v": _RANGE}],
        "inputs": [
            {"channel": channel, "port": port, "range_v": _RANGE, "sensitivity_v": sensitivity}
            for port, (channel, sensitivity) in enumerate(zip(channels, sensitivities, strict=True), 1)
        ],
    }
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.yaml").write_text(yaml.safe_dump(model, sort_keys=False))
    # A rig that differs from its model is checked by the contract of its driver; the model is what is in question.
    real = {**model, "device": {**device, "check": "converter"}}
    (folder / "real.yaml").write_text(yaml.safe_dump(real, sort_keys=False))
    (folder / "truth.yaml").write_text(yaml.safe_dump(truth, sort_keys=False))


def rigs_of_one(laboratory: Path, out: Path, count: int) -> list[str]:
    """Recipes whose chain has gains only and whose drive is that of the laboratory; names of the rigs."""
    _, recipes = laboratory_one.recipes_of(laboratory)
    plain = [
        name
        for name, recipe in recipes.items()
        if set(recipe.chain) <= {"seed", "gain_f", "gain_a4"} and not recipe.options and recipe.amplifier is None
    ]
    for number, name in enumerate(plain[:count]):
        recipe = recipes[name]
        model = yaml.safe_load((laboratory / "rigs" / "rigacc.yaml").read_text())
        model["limits"] |= {"voltage_v": 10, "force_n": 20, "acceleration_m_s2": 200}
        model["test"] |= {"levels": "0.08:2:10", "window_periods": 50}
        truth = {**recipe.truth, "place": list(recipe.truth.get("place", ()))}
        write_rig(out / f"one_{name}", model, "LaboratoryOne",
                  {"laboratory": str(laboratory.resolve()), "case": name, "seed": number}, truth)  # fmt: skip
    return [f"one_{name}" for name in plain[:count]]


def rigs_of_two(out: Path, count: int) -> list[str]:
    """Seeds whose truth needs nothing but gains of the chain; names of the rigs."""
    found: list[str] = []
    for seed in range(1000):
        if len(found) == count:
            break
        specimen, injected, chain, draw = _beam(seed)
        if any(name in str(injected.truth.get("effects")) for name in ("skew", "clipping", "mains_hum")):
            continue
        if chain.reference_gain > 1.05 or chain.reference_gain < 0.95:
            continue
        shifted = injected.truth["verdicts"] == ["calibration"]
        shift = float(draw.uniform(0.02, 0.035) * draw.choice((-1.0, 1.0))) if shifted else 0.0
        model, _ = laboratory_two.model_of(specimen, injected, shift, draw, False)
        largest = float(f"{laboratory_two.drive_for(specimen):.4g}")
        acceleration = (2.0 * math.pi * float(specimen.frequencies_hz[0])) ** 2 * specimen.largest
        model["exciter"]["newton_per_volt"] = largest
        model["sensors"].append({"quantity": "voltage"})
        model |= {
            "sample_rate_hz": _SECOND_RATE,
            "limits": {
                "voltage_v": 5,
                "force_n": 5.0 * largest,
                "acceleration_m_s2": float(f"{10 * acceleration:.3g}"),
            },
            "test": {"levels": _SECOND_LEVELS, "window_periods": 50},
        }
        name = f"two_{seed:04d}"
        write_rig(out / name, model, "LaboratoryTwo",
                  {"case": seed, "newton_per_volt": largest, "seed": seed}, injected.truth)  # fmt: skip
        found.append(name)
    return found


def rigs_of_masses(out: Path, count: int) -> list[str]:
    """Rows of masses; names of the rigs."""
    frequencies, shapes = _row_of_masses()
    omega = 2.0 * math.pi * float(frequencies[0])
    modal = _LARGEST / shapes[3, 0]
    largest = float(f"{2.0 * float(_MASS_RATIOS[0]) * omega**2 * modal / shapes[0, 0]:.4g}")
    modes = []
    for r in range(4):
        scale = float(max(shapes[:, r], key=abs))
        modes.append({
            "frequency_hz": float(f"{frequencies[r]:.6g}"), "damping_ratio": float(_MASS_RATIOS[r]),
            "modal_mass_kg": float(f"{1.0 / scale**2:.6g}"),
            "shape": [float(f"{value / scale:.5f}") for value in shapes[:, r]],
        })  # fmt: skip
    names = list(MASS_RIGS)[:count]
    for seed, name in enumerate(names):
        model = {
            "name": "row_of_masses",
            "structure": {"kind": "modal", "points": [1, 2, 3, 4], "modes": modes},
            "exciter": {"kind": "force", "point": 1, "newton_per_volt": largest},
            "sensors": [
                {"quantity": "force", "point": "drive"},
                *({"quantity": "acceleration", "point": p} for p in _MASS_SENSORS),
                {"quantity": "voltage"},
            ],
            "sample_rate_hz": _SECOND_RATE,
            "limits": {
                "voltage_v": 5, "force_n": 5.0 * largest, "acceleration_m_s2": float(f"{8.0 * omega**2 * _LARGEST:.3g}")
            },
            "extraction": {"quantity": "acceleration", "linear_modes": 2},
            "test": {"levels": _MASS_LEVELS, "window_periods": 50},
        }  # fmt: skip
        arguments = {"case": name, "newton_per_volt": largest, "seed": seed}
        write_rig(out / f"masses_{name}", model, "Masses", arguments, MASS_RIGS[name].truth)
    return [f"masses_{name}" for name in names]


def main() -> None:
    """Write the rigs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("which", choices=("one", "two", "masses"), help="whose rigs")
    parser.add_argument("--laboratory", type=Path, help="folder of laboratory one")
    parser.add_argument("--count", type=int, default=10, help="how many (default 10)")
    parser.add_argument("--out", type=Path, required=True, help="gets a folder for each rig")
    asked = parser.parse_args()
    if asked.which == "one" and asked.laboratory is None:
        parser.error("give --laboratory with the folder of laboratory one")
    makers = {
        "one": lambda: rigs_of_one(asked.laboratory, asked.out, asked.count),
        "two": lambda: rigs_of_two(asked.out, asked.count),
        "masses": lambda: rigs_of_masses(asked.out, asked.count),
    }
    made = makers[asked.which]()
    print(f"{len(made)} rigs: {', '.join(made)}")


if __name__ == "__main__":
    main()
