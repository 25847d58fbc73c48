"""Rigs of laboratories one and two behind a converter: their simulators answer to samples of a drive, in real time.

Nothing of the bench's simulation is in them. ``./nmt blind investigate`` takes what this writes: for each rig the model
that its owner believes, the rig file with the driver, and the truth. Run from the root of the repository::

    PYTHONPATH=tests python -m independent.driven_laboratories one --laboratory LABORATORY --count 5 --out RIGS
    PYTHONPATH=tests python -m independent.driven_laboratories two --count 5 --out RIGS

Laboratory one is a beam with a friction joint behind a shaker, two a pinned beam at a force. The drive goes along a
straight line from sample to sample. Sensors have gains of an ordinary laboratory and noise; phases are right.
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from independent import laboratory_one, laboratory_two
from independent.modal_simulator import Simulator, _rates
from numba import njit

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


class LaboratoryTwo(_Laboratory):
    """The pinned beam of a seed of laboratory two: force, three accelerations, drive.

    Args:
        case: the seed.
        newton_per_volt: of the exciter.
        **port: of every converter.
    """

    def __init__(self, sample_rate, outputs, inputs, case, newton_per_volt, sensitivities_v, noise, seed) -> None:  # type: ignore[no-untyped-def]
        super().__init__(sample_rate, outputs, inputs, sensitivities_v, noise, seed)
        self._specimen, injected, chain, _ = _beam(case)
        specimen = self._specimen
        self._simulator = Simulator(specimen.frequencies_hz, specimen.ratios, specimen.load, injected.elements)
        self._substeps = math.ceil(10.0 * specimen.frequencies_hz[-1] / self._rate) + 1
        self._newton_per_volt = newton_per_volt
        gains = [chain.reference_gain, *(chain.gains[p] for p in specimen.sensors)]
        self._gains = np.array(gains)[:, None]

    def _answer(self, drive: np.ndarray) -> np.ndarray:
        simulator, force = self._simulator, self._newton_per_volt * drive
        accelerations = np.empty((drive.size - 1, simulator.modes))
        _driven(
            simulator.state, simulator._at, force, self._substeps, 1.0 / self._rate / self._substeps, simulator._omega2,
            simulator._damping, simulator._load, simulator._kinds, simulator._shapes, simulator._parameters,
            simulator._stiff, simulator._limit, accelerations,
        )  # fmt: skip
        shapes = np.array([self._specimen.shapes[p] for p in self._specimen.sensors])
        return np.asarray(self._gains * np.vstack([force[:-1], shapes @ accelerations.T]))


@njit(cache=True, error_model="numpy")
def _driven(
    y, at, force, substeps, h, omega2, damping, b, kinds, shapes, p, stiff, limit, out
):  # fmt: skip  # pragma: no cover - compiled
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
        "converter": f"independent.driven_laboratories:{driver}",
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


def main() -> None:
    """Write the rigs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("which", choices=("one", "two"), help="whose rigs")
    parser.add_argument("--laboratory", type=Path, help="folder of laboratory one")
    parser.add_argument("--count", type=int, default=10, help="how many (default 10)")
    parser.add_argument("--out", type=Path, required=True, help="gets a folder for each rig")
    asked = parser.parse_args()
    if asked.which == "one" and asked.laboratory is None:
        parser.error("give --laboratory with the folder of laboratory one")
    made = rigs_of_one(asked.laboratory, asked.out, asked.count) if asked.which == "one" else rigs_of_two(
        asked.out, asked.count
    )  # fmt: skip
    print(f"{len(made)} rigs: {', '.join(made)}")


if __name__ == "__main__":
    main()
