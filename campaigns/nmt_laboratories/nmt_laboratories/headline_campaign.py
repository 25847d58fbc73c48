"""Fifteen sealed cases with a law at held levels: what the answer begins with, and what its rig file leaves later.

Run in ``./nmt shell``::

    python -m nmt_laboratories.headline_campaign make --seed 8000 --out cases --laboratory-one LABORATORY
    python -m nmt_laboratories.headline_campaign read cases --out answers

Phase resonance and stepped sines of a row of four masses, phase resonance of the free beam of laboratory three and of
laboratory one, decays of one mass; the first five are those of a table of misses. Models are exact but for the beam.
Each case has a second recording of other levels, which the diagnosis does not get. ``make`` writes ``seal.txt``, the
SHA-256 of all truths; ``read`` refuses others, and takes an answer that is there.

An answer is right where it begins with

* the law: each of its families at its place is one of the truth's, and none is lacking;
* else an effect: it is named in the truth, at its place, and what it leaves does not matter.

A file is good where it leaves of the second recording no more than the model that was given, and no more than
``_WORSE`` of what the other candidate leaves: rms over the stated uncertainty, with the best errors of the chain.
"""

from __future__ import annotations

import csv
import math
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from nmt_bench.data_import import import_data
from nmt_diagnose.diagnose import DiagnosisOutcome, diagnose_bags, observed
from nmt_diagnose.fit.fitting import best_chain_errors, data_about
from nmt_diagnose.ledger.diagnosis import Diagnosis, Verdict
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.say.words import verdict_text
from nmt_laboratories import laboratory_laws, laboratory_one
from nmt_laboratories.campaign_frame import seal, sealed_answers, sealed_parser
from nmt_laboratories.driven_laboratories import _MASS_RATIOS, _row_of_masses
from nmt_laboratories.laboratory_two import frequency_of
from nmt_laboratories.modal_simulator import Element, Simulator, fundamental
from nmt_rig.rig import Rig, load_rig

RATE = 2048.0
_LARGEST, _TOP = 1.2e-3, 1.0  # m, of mass 4 at the highest level without the law; and that level over its force
_LEVELS, _LATER = np.geomspace(0.08, 1.0, 8), np.array([0.15, 0.42, 0.85])
_NOISE = 5e-5  # of the largest value of a channel
_WORSE = 1.05

DRY, WEAK, GAP = "dry friction", "dry friction that weakens with speed", "clearance"
SOFT, DRAG, PINCHED = "softening spring", "damping that grows with speed", "friction with pinched loops"
_FRICTION = ("second_friction_contact",)


@dataclass(frozen=True)
class Case:
    """What a case has.

    Attributes:
        kind: ``levels``, ``lines`` or ``decay`` of the masses, ``beam`` or ``one`` of the other laboratories.
        point: where the laws act.
        laws: names of :func:`elements_of`.
        families: of the law, in words.
        effects: of the library that are the same.
    """

    kind: str
    point: int
    laws: tuple[str, ...]
    families: tuple[str, ...]
    effects: tuple[str, ...] = ()


CASES = {
    "weakening": Case("levels", 3, ("stribeck",), (WEAK,)),
    "gap_and_friction": Case("levels", 2, ("gap", "friction"), (GAP, DRY)),
    "magnet": Case("levels", 2, ("magnet",), (SOFT,)),
    "joint": Case("one", 3, ("stribeck",), (WEAK,)),
    "weak_friction": Case("levels", 3, ("weak friction",), (DRY,), _FRICTION),
    "lugre": Case("levels", 4, ("lugre",), (WEAK,)),
    "pinched": Case("levels", 3, ("pinched",), (PINCHED,)),
    "softening_and_drag": Case("levels", 2, ("softening", "drag"), (SOFT, DRAG)),
    "asymmetric": Case("beam", 0, ("asymmetric",), ("hardening, asymmetric spring",)),
    "sliders": Case("beam", 0, ("iwan",), ("friction of many sliders",), ("microslip",)),
    "lines_magnet": Case("lines", 3, ("magnet",), (SOFT,)),
    "lines_weakening": Case("lines", 2, ("stribeck",), (WEAK,)),
    "decay_weakening": Case("decay", 1, ("stribeck",), (WEAK,)),
    "decay_friction_and_drag": Case("decay", 1, ("friction", "drag"), (DRY, DRAG)),
    "decay_magnet": Case("decay", 1, ("magnet",), (SOFT,)),
}


@dataclass(frozen=True)
class Structure:
    """Modes of unit mass: frequencies in Hz, ratios, shapes (points, modes); the first point is driven."""

    frequencies: np.ndarray
    ratios: np.ndarray
    shapes: np.ndarray

    @property
    def top(self) -> float:
        """Force in N that moves the last point by ``_LARGEST`` at the first resonance."""
        omega = 2.0 * math.pi * float(self.frequencies[0])
        return float(2.0 * self.ratios[0] * omega**2 * _LARGEST / abs(self.shapes[-1, 0] * self.shapes[0, 0]))


def structure_of(case: Case) -> Structure:
    """One mass for decays, else four in a row."""
    if case.kind == "decay":
        return Structure(np.array([20.0]), np.array([0.004]), np.array([[1.0]]))
    frequencies, shapes = _row_of_masses()
    return Structure(frequencies, _MASS_RATIOS, shapes)


def elements_of(case: Case, structure: Structure, draw: np.random.Generator) -> list[Element]:
    """Local forces, of a size that shifts the first mode by some per cent or changes its damping as much."""
    shape, omega = structure.shapes[case.point - 1], 2.0 * math.pi * float(structure.frequencies[0])
    a = _LARGEST * abs(float(shape[0] / structure.shapes[-1, 0]))
    unit, ratio, speed = omega**2 / float(shape[0]) ** 2, float(structure.ratios[0]), omega * a
    spring = float(draw.uniform(0.03, 0.06)) * unit
    damper = 2.0 * float(draw.uniform(0.5, 1.0)) * ratio * omega / float(shape[0]) ** 2
    # The lowest level moves what has so little.
    rubbed = float(draw.uniform(0.025, 0.035)) * 0.5 * math.pi * unit * a * ratio
    found = {
        "stribeck": ("stribeck", (rubbed, 1.5e-3 * speed, float(draw.uniform(0.7, 1.1)), 0.15 * speed)),
        "friction": ("stribeck", (rubbed, 1.5e-3 * speed, 0.0, 1.0)),
        "weak friction": ("stribeck", (0.03, 1.5e-3 * speed, 0.0, 1.0)),
        "gap": ("gap", (2.0 * spring, 0.45 * a)),
        "magnet": ("magnet", (-0.3 * spring / (0.75 * a**2) * (2.2 * a) ** 5 / 8.0, 2.2 * a)),
        "lugre": ("lugre", (0.4 * spring, 1e-3 * damper, rubbed, 1.9 * rubbed, 0.15 * speed)),
        "pinched": ("pinched", (0.75 * spring, 0.2 * a, 1.5, 2.0, 0.06 * a)),
        "softening": ("quintic", (-0.3 * spring / (0.625 * a**4),)),
        "drag": ("drag", (damper * 3.0 * math.pi / (8.0 * speed),)),
    }
    return [Element(kind, shape, values) for kind, values in (found[name] for name in case.laws)]


def model_of(structure: Structure) -> dict[str, Any]:
    """Rig file of the structure without the law."""
    modes = []
    for r in range(structure.frequencies.size):
        scale = float(max(structure.shapes[:, r], key=abs))
        modes.append({
            "frequency_hz": float(structure.frequencies[r]), "damping_ratio": float(structure.ratios[r]),
            "modal_mass_kg": 1.0 / scale**2, "shape": [float(value / scale) for value in structure.shapes[:, r]],
        })  # fmt: skip
    points = list(range(1, len(structure.shapes) + 1))
    return {
        "name": "row_of_masses", "sample_rate_hz": RATE,
        "structure": {"kind": "modal", "points": points, "modes": modes},
        "exciter": {"kind": "force", "point": 1},
        "sensors": [
            {"quantity": "force", "point": "drive"}, *({"quantity": "acceleration", "point": p} for p in points)
        ],
        "extraction": {"quantity": "acceleration", "linear_modes": min(2, len(points)), "harmonics": 7},
    }  # fmt: skip


def write_signals(
    folder: Path, rows: np.ndarray, structure: Structure, segments: list[Any], draw: np.random.Generator
) -> None:
    """A recording of force and accelerations with white noise."""
    modes = structure.frequencies.size
    columns = {"f": rows[:, -1]}
    points = range(1, len(structure.shapes) + 1)
    columns |= {f"a{p}": rows[:, 2 * modes : 3 * modes] @ structure.shapes[p - 1] for p in points}
    noisy: dict[str, Any] = {
        name: signal + _NOISE * float(np.abs(signal).max()) * draw.standard_normal(signal.size)
        for name, signal in columns.items()
    }
    channels: list[dict[str, Any]] = [{"column": "f", "quantity": "force", "unit": "N", "point": 1}]
    channels += [{"column": f"a{p}", "quantity": "acceleration", "unit": "m/s^2", "point": p} for p in points]
    if not np.any(columns["f"]):
        del noisy["f"], channels[0]
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(folder / "data.npz", **noisy)
    sidecar = {
        "rig": "model.yaml", "sample_rate": RATE, "file": "data.npz", "channels": channels, "segments": segments
    }  # fmt: skip
    (folder / "sidecar.yaml").write_text(yaml.safe_dump(sidecar, sort_keys=False), encoding="utf-8")


def write_levels(
    folder: Path, structure: Structure, elements: Sequence[Element], shares: np.ndarray, draw: np.random.Generator
) -> None:
    """Phase resonance at held forces, from small to large."""
    simulator = Simulator(structure.frequencies, structure.ratios, structure.shapes[0], elements)
    hz, modes = float(structure.frequencies[0]), structure.frequencies.size
    # From a small motion in the shape of the mode.
    simulator.state[modes] = shares[0] * _LARGEST / abs(structure.shapes[-1, 0]) * 2.0 * math.pi * hz
    simulator.state[-2] = simulator.state[modes] * float(structure.shapes[0, 0])
    settle = 6.0 / (2.0 * math.pi * float(structure.ratios[0]))
    pieces: list[np.ndarray] = []
    segments = []
    begin = 0
    for share in shares:
        level = float(share) * structure.top
        start = begin
        for part in (1.0, 0.7, 0.7):
            rows, _ = simulator.tracked(level, hz, math.ceil(part * settle / hz * RATE), RATE)
            pieces.append(rows)
            begin += len(rows)
            hz = frequency_of(rows[-min(len(rows), round(60 / hz * RATE)) :, modes], RATE)
        rows, _ = simulator.tracked(level, hz, math.ceil(0.7 * settle / hz * RATE), RATE)
        window = begin + len(rows)
        pieces.append(rows)
        rows, _ = simulator.tracked(level, hz, round(60 / hz * RATE), RATE)
        pieces.append(rows)
        begin = window + len(rows)
        segments.append({
            "kind": "phase_resonance", "level": float(f"{level:.6g}"), "level_unit": "N",
            "start": round(start / RATE, 6), "stop": round((begin - 1) / RATE, 6),
            "window": [round(window / RATE, 6), round((begin - 1) / RATE, 6)],
        })  # fmt: skip
    write_signals(folder, np.concatenate(pieces), structure, segments, draw)


def write_decay(
    folder: Path, structure: Structure, elements: Sequence[Element], share: float, draw: np.random.Generator
) -> None:
    """A free decay from a share of the largest motion, for three constants of time."""
    simulator = Simulator(structure.frequencies, structure.ratios, structure.shapes[0], elements)
    hz = float(structure.frequencies[0])
    simulator.state[0] = share * _LARGEST
    count = round(3.5 / (2.0 * math.pi * hz * float(structure.ratios[0])) * RATE)
    rows, _ = simulator.tap(0.0, 0.004, count, RATE)
    segments = [{"kind": "ring_down", "start": 0.0, "stop": round((count - 1) / RATE, 6)}]
    write_signals(folder, rows, structure, segments, draw)


def write_lines(
    folder: Path, structure: Structure, elements: Sequence[Element], shares: Sequence[float], draw: np.random.Generator
) -> None:
    """Frequency responses at held forces, each line from the steady state of the one before."""
    folder.mkdir(parents=True, exist_ok=True)
    hz, ratio, modes = float(structure.frequencies[0]), float(structure.ratios[0]), structure.frequencies.size
    folds, segments = 1.0 / (2.0 * math.pi * ratio), []
    lines = np.round(hz * np.linspace(1.0 - 5.0 * ratio, 1.0 + 4.0 * ratio, 31), 4)
    for number, share in enumerate(shares, 1):
        level = float(f"{share * structure.top:.4g}")
        simulator = Simulator(structure.frequencies, structure.ratios, structure.shapes[0], elements)
        table = []
        for line in lines:
            simulator.sine(level, line, math.ceil((9.0 if line == lines[0] else 6.0) * folds))
            rows, _ = simulator.sine(level, line, 8, per_period=64)
            motion = [fundamental(rows[:, 2 * modes : 3 * modes] @ shape, 8) for shape in structure.shapes]
            table.append(np.array(motion) / fundamental(rows[:, -1], 8))
        for point, column in enumerate(np.array(table).T, 1):
            std = np.hypot(1e-3 * np.abs(column), 2e-4 * np.abs(column).max())
            column = column + std * (draw.standard_normal(lines.size) + 1j * draw.standard_normal(lines.size))
            name = f"level{number}_point{point}.csv"
            with (folder / name).open("w", encoding="utf-8", newline="") as file:
                writer = csv.writer(file)
                writer.writerow(["frequency_hz", "real", "imag", "real_std", "imag_std"])
                writer.writerows(zip(lines, column.real, column.imag, std, std, strict=True))
            segments.append({
                "kind": "frf", "file": name, "unit": "m/s^2/N", "point": point, "drive_point": 1, "level": level,
                "level_unit": "N", "direction": "up",
            })  # fmt: skip
    sidecar = {"rig": "model.yaml", "file": segments[0]["file"], "segments": segments}
    (folder / "sidecar.yaml").write_text(yaml.safe_dump(sidecar, sort_keys=False), encoding="utf-8")


def write_beam(folder: Path, family: str, seed: int) -> int:
    """The beam of laboratory three; every third of its levels is the second recording. Point of the law."""
    laboratory_laws.make_beam_case(folder, family, seed)
    split_levels(folder)
    truth = yaml.safe_load((folder / "truth.yaml").read_text(encoding="utf-8"))
    return int(truth["laws"][0]["point"])


def split_levels(folder: Path) -> None:
    """Every third level, from the third on, goes into the second recording, which has the same file."""
    sidecar = yaml.safe_load((folder / "sidecar.yaml").read_text(encoding="utf-8"))
    levels = [segment for segment in sidecar["segments"] if segment["kind"] == "phase_resonance"]
    held = levels[2::3]
    first = [segment for segment in sidecar["segments"] if segment not in held]
    later = {**sidecar, "file": "../data.npz", "rig": "../model.yaml", "segments": held}
    (folder / "later").mkdir(exist_ok=True)
    for path, content in ((folder, {**sidecar, "segments": first}), (folder / "later", later)):
        (path / "sidecar.yaml").write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def make(folder: Path, name: str, seed: int, laboratory: Path | None) -> None:
    """Write one case, its truth last; nothing where it is there already."""
    if (folder / "truth.yaml").is_file():
        return
    case = CASES[name]
    point, draw = case.point, np.random.default_rng([seed, list(CASES).index(name)])
    if case.kind == "beam":
        point = write_beam(folder, case.laws[0], seed)
    elif case.kind == "one":
        if laboratory is None:
            return
        simulate, _ = laboratory_one.recipes_of(laboratory)
        effects = {"ext": [(7, point, float(draw.uniform(0.04, 0.06)), 0.8, 0.01)]}
        recipe = laboratory_one.Recipe(effects, {"seed": seed}, {}, {}, (0.01, 0.2), seed, None)
        laboratory_one.write_case(simulate, laboratory, folder, recipe)
        split_levels(folder)
    else:
        structure = structure_of(case)
        elements = elements_of(case, structure, draw)
        if case.kind == "levels":
            write_levels(folder, structure, elements, _LEVELS, draw)
            write_levels(folder / "later", structure, elements, _LATER, draw)
        elif case.kind == "lines":
            write_lines(folder, structure, elements, (0.1, 0.3, 0.6, 1.0), draw)
            write_lines(folder / "later", structure, elements, (0.2, 0.8), draw)
        else:
            write_decay(folder, structure, elements, 1.0, draw)
            write_decay(folder / "later", structure, elements, 0.7, draw)
        (folder / "model.yaml").write_text(yaml.safe_dump(model_of(structure), sort_keys=False), encoding="utf-8")
        (folder / "later" / "model.yaml").write_bytes((folder / "model.yaml").read_bytes())
    truth = {"families": list(case.families), "effects": list(case.effects), "point": point, "seed": seed}
    (folder / "truth.yaml").write_text(yaml.safe_dump(truth), encoding="utf-8")


def headline_of(diagnosis: Diagnosis) -> dict[str, Any]:
    """What the answer begins with: the law, an effect, or a verdict alone."""
    if diagnosis.law is not None and diagnosis.law_leads:
        laws = [[family, law.point] for law in diagnosis.law.laws for family in parts_of(law.family)]
        return {"by": "law", "names": laws, "whole": True}
    if diagnosis.verdict is Verdict.EFFECT:
        first = diagnosis.ranking[0]
        names = list(zip(first.effect.split(" + "), first.detail.split(" + "), strict=False))
        return {"by": "effect", "names": [list(pair) for pair in names], "whole": first.adequate}
    return {"by": diagnosis.verdict.value, "names": [], "whole": False}


def parts_of(words: str) -> list[str]:
    """Families of a law at one place: what a spring is stays with it."""
    return words.replace(", ", " and ").split(" and ") if "spring" not in words else words.split(" and ")


def is_right(line: dict[str, Any]) -> bool:
    """Whether the answer begins with what the case has, at its place, and with nothing else."""
    head, truth = line["headline"], line["truth"]
    point = truth["point"]
    if head["by"] == "law":
        return sorted(head["names"]) == sorted([family, point] for family in truth["families"])
    named = [[name, str(detail)] for name, detail in head["names"]]
    return head["by"] == "effect" and head["whole"] and named in [[[name, str(point)]] for name in truth["effects"]]


def is_good(line: dict[str, Any]) -> bool:
    """Whether the file leaves no more of the second recording than what it stands beside."""
    left = line["left"]
    return bool(left["file"] <= left["given"] and not left["file"] > _WORSE * left["other"])


def left_of(rigs: dict[str, Rig | None], model: Rig, folder: Path) -> dict[str, float]:
    """rms of the second recording over its uncertainty that each rig leaves; NaN where there is none to ask.

    Where a rig has an element whose motion is only known step by step, the windows of levels are taken as records.
    """
    asked = {name: rig for name, rig in rigs.items() if rig is not None}
    stepped = any(element.without_harmonic_balance for rig in asked.values() for element in rig.local_elements)
    with tempfile.TemporaryDirectory() as bags:
        sidecar = folder / "later" / ("records.yaml" if stepped else "sidecar.yaml")
        if stepped:
            levels = yaml.safe_load(sidecar.with_name("sidecar.yaml").read_text(encoding="utf-8"))
            windows = [segment["window"] for segment in levels["segments"]]
            levels["segments"] = [{"kind": "record", "start": begin, "stop": end} for begin, end in windows]
            sidecar.write_text(yaml.safe_dump(levels, sort_keys=False), encoding="utf-8")
        import_data(sidecar, Path(bags) / "bag")
        observations = observed(model, [Path(bags) / "bag"])
    forward = Forward(observations.tests, observations.rows)
    first = forward.predict(model)
    predictions = {name: forward.predict(rig).values for name, rig in asked.items()}
    used = np.all([np.isfinite(values) for values in predictions.values()], axis=0)
    data = data_about(observations, model, first, used)
    found = dict.fromkeys(rigs, math.nan)
    for name, values in predictions.items():
        errors = best_chain_errors(data, values)
        left = data.residual_of(errors.values, errors.chain)
        found[name] = float(np.sqrt(np.mean(left[used] ** 2)))
    return found


def read_case(folder: Path) -> dict[str, Any]:
    """The answer to one case, beside its truth."""
    truth = yaml.safe_load((folder / "truth.yaml").read_text(encoding="utf-8"))
    found: dict[str, Any] = {"case": folder.name, "truth": truth}
    rig = load_rig(str(folder / "model.yaml"), vibrating=False)
    begin = time.process_time()
    with tempfile.TemporaryDirectory() as bags:
        import_data(folder / "sidecar.yaml", Path(bags) / "bag")
        outcome: DiagnosisOutcome = diagnose_bags(rig, [Path(bags) / "bag"])
    found["seconds"] = time.process_time() - begin
    found |= {
        "page": verdict_text(outcome.diagnosis)[0],
        "headline": headline_of(outcome.diagnosis),
        "left": left_of({"given": rig, "file": outcome.model, "other": outcome.other}, rig, folder),
    }
    return found | {"diagnosis": outcome.diagnosis.to_mapping()}


def line_of(line: dict[str, Any]) -> str:
    """One case in words."""
    truth, left = line["truth"], line["left"]
    mark = f"{'right' if is_right(line) else 'MISS'}, file {'good' if is_good(line) else 'WORSE'}"
    figures = ", ".join(f"{name} {value:.3g}" for name, value in left.items())
    true = f"{' and '.join(truth['families'])} at {truth['point']}"
    return f"{line['case']}: {mark} [{true}] {line['page']} | left {figures} | {line['seconds']:.0f} s"


def table(lines: Sequence[dict[str, Any]]) -> list[str]:
    """The figures of the campaign, a line each."""

    def of(test: Callable[[Any], bool]) -> str:
        return f"{sum(map(test, lines))} of {len(lines)}"

    seconds = [line["seconds"] for line in lines]
    return [
        f"answer begins with what acts, at its place: {of(is_right)}",
        f"file leaves no more than the model given and the other candidate: {of(is_good)}",
        f"processor time: median {np.median(seconds):.0f}, most {max(seconds):.0f} s",
    ]


def main() -> None:
    """Make or read."""
    parser, maker, _ = sealed_parser(__doc__)
    maker.add_argument("--seed", type=int, required=True)
    maker.add_argument("--laboratory-one", type=Path, help="folder of laboratory one, where it is at hand")
    options = parser.parse_args()
    if options.part == "make":
        options.out.mkdir(parents=True, exist_ok=True)
        laboratory = options.laboratory_one and options.laboratory_one.resolve()
        for number, name in enumerate(CASES):
            make(options.out / f"{number + 1:02d}_{name}", name, options.seed + number, laboratory)
            print(name, flush=True)
        seal(options.out)
        return
    lines = []
    for line in sealed_answers(options, read_case):
        lines.append(line)
        print(line_of(line), flush=True)
    if lines:
        print("\n".join(table(lines)))


if __name__ == "__main__":
    main()
