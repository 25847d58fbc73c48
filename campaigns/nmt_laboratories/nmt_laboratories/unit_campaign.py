"""Sealed sets of five units that the bench did not simulate: is the odd one named, does the band hold the sixth?

Run in ``./nmt shell``::

    python -m nmt_laboratories.unit_campaign --first 8100 --count 40 --out answers

Each seed draws one mode, how much its frequency, damping and nonlinear spring scatter between units, and six units of
it, each measured on its own: responses of the linear mode by the closed form, or a backbone by Runge and Kutta's rule.
In every second set one of the first five is odd. Named is a unit that its sisters do not predict in some parameter, or
whose diagnosis alone names another explanation. The sixth unit is the next one: the band of each parameter is to hold
its estimate. A set whose answer is in the folder is not diagnosed again.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from nmt_bench.data_import import import_data
from nmt_diagnose.diagnose import diagnose_bags
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.units.unit_group import UnitDiagnosis, UnitGroup, unit_group
from nmt_laboratories.campaign_frame import answers_of_seeds, seed_parser
from nmt_laboratories.structure_at_a_point import Structure, backbone_table

UNITS = 5
RESPONSES, BACKBONE = "responses", "backbone"
# Data, whether all units have a spring that the model lacks, and what is odd of one unit.
SETS = (
    (RESPONSES, False, ""), (RESPONSES, False, "damping"), (BACKBONE, True, ""), (BACKBONE, True, "spring"),
    (RESPONSES, False, ""), (RESPONSES, False, "frequency"), (BACKBONE, False, ""), (BACKBONE, False, "spring"),
)  # fmt: skip
LINES = 120


@dataclass(frozen=True)
class Unit:
    """One mode of unit mass: frequency in Hz, damping ratio, cubic spring over the linear one at the top amplitude."""

    frequency_hz: float
    ratio: float
    strength: float


@dataclass(frozen=True)
class UnitSet:
    """What is measured.

    Attributes:
        data: ``RESPONSES`` or ``BACKBONE``.
        model: of all units, without the spring.
        units: five and the next one.
        odd: number of the odd one from 0; None = none is.
        what: is odd of it.
        top: largest amplitude, m.
    """

    data: str
    model: Unit
    units: tuple[Unit, ...]
    odd: int | None
    what: str
    top: float


def drawn(seed: int) -> UnitSet:
    """The set of a seed."""
    random = np.random.default_rng([810, seed])
    data, sprung, what = SETS[seed % len(SETS)]
    middle = Unit(10 ** random.uniform(1.3, 2.4), 10 ** random.uniform(-2.5, -1.8), sprung * random.uniform(0.15, 0.6))
    scatter = 10 ** random.uniform((-3.5, -2.0, -2.0), (-2.8, -1.5, -1.5))
    units = []
    for _ in range(UNITS + 1):
        factors = 1.0 + scatter * random.standard_normal(3)
        hertz, ratio, strength = factors * (middle.frequency_hz, middle.ratio, middle.strength)
        units.append(Unit(float(hertz), float(ratio), float(strength)))
    odd = int(random.integers(UNITS)) if what else None
    if odd is not None:
        up, share = random.choice([-1.0, 1.0]), random.uniform(0.03, 0.08)
        unit, times = units[odd], random.uniform(2.0, 3.5)
        changed = {
            "damping": replace(unit, ratio=unit.ratio * times**up),
            "frequency": replace(unit, frequency_hz=unit.frequency_hz * (1.0 + up * share)),
            "spring": replace(unit, strength=unit.strength * times if sprung else random.uniform(0.15, 0.6)),
        }
        units[odd] = changed[what]
    model = Unit(
        middle.frequency_hz * (1.0 + 0.001 * random.standard_normal()),
        middle.ratio * (1.0 + 0.05 * random.standard_normal()), 0.0,
    )  # fmt: skip
    return UnitSet(data, model, tuple(units), odd, what, 10 ** random.uniform(-4.0, -2.5))


def _responses(unit: Unit, folder: Path, random: np.random.Generator) -> dict[str, Any]:
    """Accelerance of the linear mode over six bandwidths on either side, 0.5 % of noise."""
    reach = 6.0 * unit.ratio + 0.01
    hertz = unit.frequency_hz * np.linspace(1.0 - reach, 1.0 + reach, LINES)
    omega, natural = 2.0 * np.pi * hertz, 2.0 * np.pi * unit.frequency_hz
    value = -(omega**2) / (natural**2 - omega**2 + 2j * unit.ratio * natural * omega)
    value *= 1.0 + 0.005 * random.standard_normal()
    value *= 1.0 + 0.005 * (random.standard_normal(LINES) + 1j * random.standard_normal(LINES))
    columns = np.column_stack([hertz, value.real, value.imag])
    np.savetxt(folder / "frf.csv", columns, delimiter=",", header="frequency_hz,real,imag", comments="")
    segment = {"kind": "frf", "file": "frf.csv", "unit": "m/s^2/N", "point": 1, "drive_point": 1}
    return {"file": "frf.csv", "segments": [segment]}


def _backbone(unit: Unit, folder: Path, random: np.random.Generator, top: float) -> dict[str, Any]:
    """Twelve points up to the top amplitude."""
    omega = 2.0 * np.pi * unit.frequency_hz
    structure = Structure((unit.frequency_hz,), (unit.ratio,), cubic=unit.strength * omega**2 / top**2)
    amplitudes = top * np.geomspace(0.05, 1.0, 12)
    forces = 2.0 * unit.ratio * omega**2 * amplitudes * np.sqrt(1.0 + 0.75 * unit.strength * (amplitudes / top) ** 2)
    scatter = (10 ** random.uniform(-3.8, -3.0), 0.005, random.uniform(0.01, 0.04))
    gain = 1.0 + 0.005 * random.standard_normal()
    backbone_table(structure, forces, folder / "table.csv", scatter, int(random.integers(2**31)), gain)
    return {"file": "table.csv", "segments": [{"kind": "backbone", "unit": "mm", "point": 1}]}


def diagnosed(drawn_set: UnitSet, folder: Path, random: np.random.Generator) -> list[UnitDiagnosis]:
    """The diagnosis of each unit."""
    mode = {
        "frequency_hz": float(drawn_set.model.frequency_hz), "damping_ratio": float(drawn_set.model.ratio),
        "modal_mass_kg": 1.0,
    }  # fmt: skip
    model: dict[str, Any] = {"name": "one_mode", "structure": {"kind": "modal", "modes": [mode]}}
    if drawn_set.data == BACKBONE:
        model["test"] = {"levels": "0.01:1:8"}
    yaml = YAML(typ="safe")
    yaml.dump(model, folder / "model.yaml")
    found = []
    for number, unit in enumerate(drawn_set.units, start=1):
        place = folder / str(number)
        place.mkdir()
        if drawn_set.data == BACKBONE:
            words = _backbone(unit, place, random, drawn_set.top)
        else:
            words = _responses(unit, place, random)
        yaml.dump({"rig": "../model.yaml", **words}, place / "data.yaml")
        import_data(place / "data.yaml", place / "bag")
        settings = DiagnosisSettings(jobs=1, look_ahead=False)
        diagnosis = diagnose_bags(folder / "model.yaml", [place / "bag"], settings=settings).diagnosis
        found.append(UnitDiagnosis(f"unit {number}", "", diagnosis))
    return found


def named_odd(group: UnitGroup) -> set[str]:
    """Units that are called odd: in a parameter, or by an explanation that no other has."""
    odd = {each.unit for quantity in group.quantities for each in quantity.components.odd}
    labels = [label for _, _, label in group.explanations]
    if len(set(labels)) == 2:
        odd |= {unit for unit, _, label in group.explanations if labels.count(label) == 1}
    return odd


def answered(seed: int) -> dict[str, Any]:
    """The answer of a seed."""
    drawn_set = drawn(seed)
    with tempfile.TemporaryDirectory() as name:
        diagnoses = diagnosed(drawn_set, Path(name), np.random.default_rng([811, seed]))
    five, next_one = unit_group(diagnoses[:UNITS], ""), unit_group(diagnoses, "")
    estimates = {
        quantity.name: [each.value for each in quantity.estimates if each.unit == f"unit {UNITS + 1}"]
        for quantity in next_one.quantities
    }
    held = {
        quantity.name: bool(
            quantity.components.next_low <= estimates[quantity.name][0] <= quantity.components.next_high
        )
        for quantity in five.quantities
        if estimates.get(quantity.name)
    }
    return {
        "seed": seed, "data": drawn_set.data, "what": drawn_set.what,
        "odd": None if drawn_set.odd is None else f"unit {drawn_set.odd + 1}", "named": sorted(named_odd(five)),
        "held": held, "sentences": list(five.sentences),
        "estimates": {q.name: [(e.unit, e.value, e.std) for e in q.estimates] for q in next_one.quantities},
    }  # fmt: skip


def summary(answers: Sequence[dict[str, Any]]) -> str:
    """How many sets ended how."""
    odd = [each for each in answers if each["odd"]]
    found = sum(each["named"] == [each["odd"]] for each in odd)
    false = sum(bool(set(each["named"]) - {each["odd"]}) for each in answers)
    held = [inside for each in answers for inside in each["held"].values()]
    return (
        f"{len(answers)} sets: odd unit named in {found} of {len(odd)}, a unit wrongly named in {false} of "
        f"{len(answers)}, bands that held the next unit {sum(held)} of {len(held)}"
    )


def line_of(answer: dict[str, Any]) -> str:
    """A set in words."""
    truth = f"{answer['odd']} odd in {answer['what']}" if answer["odd"] else "none odd"
    held = list(answer["held"].values())
    named = ", ".join(answer["named"]) or "none"
    return f"{answer['seed']} {answer['data']:9} {truth:26} named {named:8} held {sum(held)}/{len(held)}"


def main() -> None:
    """Diagnose the sets that have no answer yet, print a line each, and how many ended how."""
    options = seed_parser(__doc__, 8100, 40, kept=True).parse_args()
    answers = []
    for answer in answers_of_seeds(options, answered):
        print(line_of(answer), flush=True)
        answers.append(answer)
    print(summary(answers))


if __name__ == "__main__":
    main()
