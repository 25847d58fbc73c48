"""Diagnoses of random structures that the bench did not simulate, as tables and decays of a laboratory.

Run in ``./nmt shell``::

    python -m nmt_laboratories.random_structures --first 3000 --count 90

Each seed draws a structure of one mode or two at a point, with a nonlinear force or none, and a kind of data: a
backbone with scatter, frequency responses at three forces stepped up and down, a decay with noise, responses on a
shaking table, or the first three together, each by a sensor whose gain is off by its own 0.5 % at random. The model has
one linear mode, its frequency 0.1 % and its damping 5 % off at random. A healthy structure with any other verdict than
``none`` or ``calibration`` is an alarm.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from nmt_bench.data_import import import_data
from nmt_diagnose.diagnose import diagnose_bags
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.ledger.diagnosis import Diagnosis, Verdict
from nmt_laboratories.campaign_frame import judged_in_parallel, print_ends, seed_parser
from nmt_laboratories.structure_at_a_point import Bench, Structure, backbone_table, iwan_joint

HEALTHY = "healthy"
EFFECTS = {
    HEALTHY: "",
    "hardening": "cubic_stiffness",
    "softening": "cubic_stiffness",
    "even": "quadratic_stiffness",
    "stop": "two_sided_gap",
    "damping": "amplitude_damping",
    "bolted": "microslip",
    "slider": "second_friction_contact",
    "hardening and damping": "cubic_stiffness + amplitude_damping",
}


@dataclass(frozen=True)
class Drawn:
    """A structure, and the model that lacks what is nonlinear in it.

    Attributes:
        structure: the truth.
        top: amplitude up to which it is tested, m.
        force: that drives it there at phase resonance, N.
        frequency_hz: of small amplitudes.
        ratio: its damping ratio there.
        gain: of the sensor.
    """

    structure: Structure
    top: float
    force: float
    frequency_hz: float
    ratio: float
    gain: float = 1.0


def drawn(kind: str, generator: np.random.Generator) -> Drawn:
    """A random structure of a kind: 20 to 400 Hz, 0.1 to 1 %, up to 0.1 to 3 mm."""
    hz, ratio = 10 ** generator.uniform(1.3, 2.6), 10 ** generator.uniform(-2.9, -2.0)
    omega, top = 2.0 * np.pi * hz, 10 ** generator.uniform(-4.0, -2.5)
    strength = 10 ** generator.uniform(-1.3, 0.3)  # nonlinear over linear force at the top
    settings: dict[str, Any] = {}
    leaves_noise_only = hz
    if "hardening" in kind:
        settings["cubic"] = strength * omega**2 / top**2
    if kind == "softening":
        settings["cubic"] = -min(strength, 0.3) * omega**2 / top**2
    if kind == "even":
        settings["quadratic"] = min(strength, 0.25) * omega**2 / top
    if "damping" in kind:
        settings["square_damping"] = 10 ** generator.uniform(-0.3, 0.8) * 8.0 * ratio * omega / top**2
    if kind == "stop":
        settings["stop"] = (10 ** generator.uniform(-1.0, 0.5) * omega**2, top * generator.uniform(0.3, 0.7))
    if kind in ("bolted", "slider"):
        share, reach = 10 ** generator.uniform(-1.7, -0.7), top * 10 ** generator.uniform(-0.7, 0.7)
        stiffness = share * omega**2
        exponent = generator.uniform(-0.6, 0.0)
        settings["joint"] = (
            iwan_joint(stiffness, reach, exponent) if kind == "bolted" else ((stiffness, stiffness * reach / 5.0),)
        )
        leaves_noise_only = hz * np.sqrt(1.0 + share)
    frequencies: tuple[float, ...] = (hz,)
    ratios: tuple[float, ...] = (ratio,)
    shape: tuple[float, ...] = (1.0,)
    if generator.random() < 0.4:
        frequencies += (hz * generator.uniform(3.0, 7.0),)
        ratios, shape = (ratio, ratio), (1.0, generator.uniform(-1.0, 1.0))
    structure = Structure(frequencies, ratios, shape, **settings)
    return Drawn(structure, top, _force(structure, top, 2.0 * ratio * omega**2 * top), leaves_noise_only, ratio)


def _force(structure: Structure, top: float, start: float) -> float:
    """Force that drives a structure to an amplitude within 5 %, N."""
    force = start
    for _ in range(12):
        amplitude = Bench(structure).point(force)[1]
        if not np.isfinite(amplitude) or amplitude <= 0.0:
            force *= 0.5
        elif abs(amplitude / top - 1.0) < 0.05:
            break
        else:
            force *= min(max((top / amplitude) ** 0.8, 0.3), 3.0)
    return float(force)


def _backbone(own: Drawn, folder: Path, generator: np.random.Generator, seed: int) -> dict[str, Any]:
    scatter = (10 ** generator.uniform(-3.5, -2.3), 0.005, generator.uniform(0.02, 0.08))
    forces = own.force * np.geomspace(0.03, 1.0, int(generator.integers(10, 25)))
    backbone_table(own.structure, forces, folder / "table.csv", scatter, seed, own.gain)
    return {"file": "table.csv", "segments": [{"kind": "backbone", "unit": "mm", "point": 1}]}


def _responses(
    own: Drawn,
    folder: Path,
    generator: np.random.Generator,
    seed: int,
    participation: float | None = None,
    phase: bool = True,
) -> dict[str, Any]:
    """Responses at three forces, or on a table whose acceleration times -participation is the force on 1 kg."""
    units, factor, per_force = ("m/s^2/N", "N"), 1.0, 1.0
    if participation is not None:
        units, factor, per_force = ("g/g", "g"), -participation, 1.0 / (participation * _GRAVITY)
    noise, segments = 10 ** generator.uniform(-2.7, -2.0), []
    for number, force in enumerate(own.force * np.array([0.05, 0.3, 1.0])):
        resonance = Bench(own.structure).point(float(force))[0]
        reach = 6.0 * own.ratio + 0.01
        low, high = sorted((resonance, own.frequency_hz))
        lines = np.linspace(low * (1.0 - reach), high * (1.0 + reach), 60)
        for direction, frequencies in (("up", lines), ("down", lines[::-1])):
            response = -((2.0 * np.pi * frequencies) ** 2) * Bench(own.structure).response(float(force), frequencies)
            response *= own.gain * factor
            response *= 1.0 + noise * (generator.standard_normal(60) + 1j * generator.standard_normal(60))
            columns = (response.real, response.imag) if phase else (np.abs(response),)
            rows = sorted(zip(frequencies, *columns, strict=True))
            name = f"{direction}{number}.csv"
            head = "frequency_hz,real,imag" if phase else "frequency_hz,magnitude"
            text = [head, *(",".join(f"{value:.8g}" for value in row) for row in rows)]
            (folder / name).write_text("\n".join(text) + "\n", encoding="utf-8")
            segments.append(
                {
                    "kind": "frf", "file": name, "point": 1, "drive_point": 1, "level": float(force) * per_force,
                    "direction": direction, "name": f"{number} {direction}", "unit": units[0], "level_unit": units[1],
                }
            )  # fmt: skip
    return {"file": "up0.csv", "segments": segments}


def _on_a_table(own: Drawn, folder: Path, generator: np.random.Generator, seed: int) -> dict[str, Any]:
    return _responses(own, folder, generator, seed, _PARTICIPATION)


def _magnitudes(own: Drawn, folder: Path, generator: np.random.Generator, seed: int) -> dict[str, Any]:
    return _responses(own, folder, generator, seed, phase=False)


def _decay(own: Drawn, folder: Path, generator: np.random.Generator, seed: int) -> dict[str, Any]:
    rate, omega = float(max(2000.0, 40.0 * own.frequency_hz)), 2.0 * np.pi * own.frequency_hz
    speed = Bench(own.structure).decay(own.force, min(5.0 / (own.ratio * omega), 40.0), rate)
    noise = 10 ** generator.uniform(-4.0, -2.5) * np.abs(speed).max()
    speed = own.gain * speed + noise * generator.standard_normal(len(speed))
    (folder / "decay.csv").write_text("v\n" + "\n".join(f"{value:.7g}" for value in speed) + "\n", encoding="utf-8")
    return {
        "file": "decay.csv",
        "sample_rate": rate,
        "channels": [{"column": "v", "quantity": "velocity", "point": 1, "unit": "m/s"}],
        "segments": [{"kind": "ring_down", "start": 0.0, "stop": (len(speed) - 1) / rate}],
    }


DATA: dict[str, Callable[[Drawn, Path, np.random.Generator, int], dict[str, Any]]] = {
    "backbone": _backbone,
    "responses": _responses,
    "decay": _decay,
    "table": _on_a_table,
    "magnitudes": _magnitudes,
}
TOGETHER = ("backbone", "responses", "decay")
KINDS_OF_DATA = ("backbone", "responses", "decay", "table", "together")
_PARTICIPATION, _GRAVITY = 1.4, 9.80665
_GAIN = 0.005  # relative, of a sensor that others were set up for


def diagnosed(folder: Path, kind: str, data: str, seed: int) -> Diagnosis:
    """Draw, measure, import and diagnose.

    Args:
        folder: an existing, empty folder.
        kind: of ``EFFECTS``.
        data: of ``KINDS_OF_DATA``, or ``magnitudes``: responses without phase.
        seed: of everything.
    """
    generator = np.random.default_rng(seed)
    own = drawn(kind, generator)
    frequency = own.frequency_hz * (1.0 + 0.001 * generator.standard_normal())
    ratio = own.ratio * (1.0 + 0.05 * generator.standard_normal())
    mode = {"frequency_hz": float(frequency), "damping_ratio": float(ratio), "modal_mass_kg": 1.0}
    model: dict[str, Any] = {"name": "one_mode", "structure": {"kind": "modal", "modes": [mode]}}
    wanted = TOGETHER if data == "together" else (data,)
    if "backbone" in wanted:
        model["test"] = {"levels": "0.01:1:8"}
    if data == "table":
        mode["participation"] = _PARTICIPATION
        model["exciter"] = {"kind": "shaking_table", "point": 1}
    yaml = YAML(typ="safe")
    yaml.dump(model, folder / "model.yaml")
    bags = []
    for name in wanted:
        place = folder / name
        place.mkdir()
        gain = 1.0 + _GAIN * generator.standard_normal() if data == "together" else 1.0
        words = DATA[name](replace(own, gain=gain), place, generator, seed)
        yaml.dump({"rig": "../model.yaml", **words}, place / "data.yaml")
        import_data(place / "data.yaml", place / "bag")
        bags.append(place / "bag")
    settings = DiagnosisSettings(jobs=1, look_ahead=False)
    return diagnose_bags(folder / "model.yaml", bags, settings=settings).diagnosis


def judged(seed: int, data: str = "") -> tuple[str, str]:
    """A line about a seed, and how it ended: ``silent``, ``alarm``, ``first``, ``alike``, ``other`` or ``unknown``.

    Args:
        seed: of everything.
        data: kind of data; empty = by the seed.
    """
    warnings.simplefilter("ignore")
    kind = list(EFFECTS)[seed % len(EFFECTS)]
    data = data or KINDS_OF_DATA[seed // len(EFFECTS) % len(KINDS_OF_DATA)]
    with tempfile.TemporaryDirectory() as folder:
        found = diagnosed(Path(folder), kind, data, seed)
    first = found.ranking[0] if found.ranking else None
    truth = {item for item in EFFECTS[kind].split(" + ") if item}
    named = set(first.effect.split(" + ")) if first else set()
    alike = [set(item.split(" + ")) for item in first.equivalents] if first else []
    if kind == HEALTHY:
        end = "silent" if found.verdict in (Verdict.NONE, Verdict.CALIBRATION) else "alarm"
    elif found.verdict is not Verdict.EFFECT:
        end = "unknown"
    elif named == truth:
        end = "first"
    else:
        end = "alike" if truth in alike else "other"
    what = f"{first.effect} {100 * first.probability:.0f} %" if first else "nothing named"
    closed = f"closes {100 * found.gap.closed:.0f} %" if end in ("first", "alike", "other") else ""
    return f"{seed}  {kind:22} {data:10} {end:8} {found.verdict.value:12} {what} {closed}", end


def main() -> None:
    """Print a line for each seed, and how many ended how."""
    parser = seed_parser(__doc__, first=3000, count=45)
    parser.add_argument("--data", choices=[*KINDS_OF_DATA, "magnitudes"], default="", help="one kind for all seeds")
    words = parser.parse_args()
    seeds = range(words.first, words.first + words.count)
    print_ends(judged_in_parallel([(seed, words.data) for seed in seeds], judged, words.jobs))


if __name__ == "__main__":
    main()
