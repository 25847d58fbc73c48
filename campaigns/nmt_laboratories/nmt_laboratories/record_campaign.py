"""Sealed records of an imposed or driven motion with a missing force: makes them, reads the law of each, and tabulates.

Run in ``./nmt shell``::

    python -m nmt_laboratories.record_campaign make --seed 300 --count 40 --out cases
    python -m nmt_laboratories.record_campaign read cases --out answers

``make --group following`` makes cases of one group, ``--noise 0.1`` forces with so much white noise, rms over rms, and
``--late 0.012`` forces that come so many seconds after the motion; ``--driven`` rows of masses that a measured force
drives, with the missing force at any place (:mod:`nmt_laboratories.driven_rows`). ``make --driven --group pair`` makes
rows with two laws at two places, of which the whole diagnosis is asked: an answer is right where it names both with
their places, half where it names one and says that more remains, wrong where it is the whole and another one.

The forces are formulas and recursions of this file alone, twenty steps to a sample. ``make`` writes ``seal.txt``, the
SHA-256 of all truths; ``read`` refuses others. A case that has an answer is not read again.
"""

from __future__ import annotations

import json
import math
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from nmt_bench.data_import import import_data
from nmt_core.errors import BenchError
from nmt_diagnose.diagnose import diagnose_observations, observed
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.law.reading import LawReading
from nmt_diagnose.search.law_starts import law_of
from nmt_laboratories import driven_rows
from nmt_laboratories.campaign_frame import seal, sealed_answers, sealed_parser
from nmt_laboratories.headline_campaign import headline_of, parts_of
from nmt_rig.rig import load_rig

Array = np.ndarray
RATE, SECONDS, STEPS = 250.0, 32.0, 20
_LOOP = 0.10
_DELAY = 0.02
GROUPS = ("library", "outside", "healthy", "library", "following")
OF_DRIVEN = ("library", "outside", "healthy", "library")

SLIDER = "friction of a slider behind a spring"
DRY, WEAK = "dry friction", "dry friction that weakens with speed"
BACKLASH = "friction with pinched loops"
DRAG, CLEARANCE, STOP, HARD = "damping that grows with speed", "clearance", "stop on one side", "hardening spring"
COGGING = "cogging"


def play(x: Array, slip: float) -> Array:
    """Deflection of a spring in series with a slider, m."""
    result, at = np.empty_like(x), x[0]
    for k, now in enumerate(x):
        at = now + slip if at > now + slip else now - slip if at < now - slip else at
        result[k] = now - at
    return result


def bristles(x: Array, v: Array, reach: Array) -> Array:
    """Deflection z of ż = v − |v| z / reach by Heun's rule, m."""
    result, z = np.empty_like(x), 0.0
    step = 1.0 / (RATE * STEPS)
    for k in range(x.size - 1):
        result[k] = z
        first = v[k] - abs(v[k]) * z / reach[k]
        second = v[k + 1] - abs(v[k + 1]) * (z + step * first) / reach[k + 1]
        z += 0.5 * step * (first + second)
    result[-1] = z
    return result


def dead(x: Array, gap: float) -> Array:
    """Travel beyond a gap on both sides."""
    return np.asarray(np.sign(x) * np.maximum(np.abs(x) - gap, 0.0))


def yielding(x: Array, slip: float) -> Array:
    """Share of its limit that a slider behind a spring has."""
    return play(x, slip) / slip


def backlash(x: Array, slip: float, share: float) -> Array:
    """Share of its limit that a slider has whose spring is slack up to a share of its way."""
    return dead(play(x, slip), share * slip) / (slip * (1.0 - share))


def dahl(x: Array, v: Array, reach: float) -> Array:
    """Share of their limit that bristles have."""
    return bristles(x, v, np.full_like(x, reach)) / reach


def lugre(x: Array, v: Array, reach: float, fall: float) -> Array:
    """Share of their largest limit that bristles have whose limit halves with speed."""
    return bristles(x, v, reach * weakening(v, fall)) / reach


def weakening(v: Array, fall: float) -> Array:
    """1 at rest, a half far above a speed."""
    return 0.5 + 0.5 * np.exp(-((v / fall) ** 2))


def contact(x: Array, gap: float, reach: float) -> Array:
    """Force of a stop on one side over the one at the reach."""
    return np.maximum(x - gap, 0.0) / (reach - gap)


# Families of the truth, and the force along x and v over its size; a and s are their largest, r a random number.
Shape = Callable[[Array, Array, float, float, float], Array]
LIBRARY: dict[str, tuple[tuple[str, ...], Shape]] = {
    "friction": ((DRY,), lambda x, v, a, s, r: np.tanh(v / (s * (0.003 + 0.017 * r)))),
    "slider": ((SLIDER,), lambda x, v, a, s, r: yielding(x, a * (0.03 + 0.25 * r))),
    "backlash": ((BACKLASH,), lambda x, v, a, s, r: backlash(x, a * (0.05 + 0.2 * r), 0.3 + 0.4 * r)),
    "dahl": ((SLIDER,), lambda x, v, a, s, r: dahl(x, v, a * (0.03 + 0.17 * r))),
    "drag": ((DRAG,), lambda x, v, a, s, r: v * np.abs(v) / s**2),
    "cubic": ((HARD,), lambda x, v, a, s, r: (x / a) ** 3),
    "clearance": (
        (CLEARANCE,),
        lambda x, v, a, s, r: contact(x, (0.3 + 0.4 * r) * a, a) - contact(-x, (0.3 + 0.4 * r) * a, a),
    ),
    "stop": ((STOP,), lambda x, v, a, s, r: contact(x, (0.2 + 0.4 * r) * a, a)),
    "cogging": ((COGGING,), lambda x, v, a, s, r: np.cos(2.0 * np.pi * (x / (a * (0.06 + 0.9 * r**2)) + r))),
    "cogging and friction": (
        (COGGING, DRY),
        lambda x, v, a, s, r: 0.5 * np.sin(2.0 * np.pi * x / (a * (0.1 + 0.6 * r))) + 0.5 * np.tanh(v / (0.01 * s)),
    ),
    "friction and drag": (
        (DRY, DRAG),
        lambda x, v, a, s, r: 0.5 * np.tanh(v / (0.01 * s)) + 0.5 * v * np.abs(v) / s**2,
    ),
    "slider and stop": (
        (SLIDER, STOP),
        lambda x, v, a, s, r: 0.5 * yielding(x, 0.1 * a) + 0.5 * contact(x, 0.4 * a, a),
    ),
}
OUTSIDE: dict[str, tuple[tuple[str, ...], Shape]] = {
    "Stribeck": ((WEAK,), lambda x, v, a, s, r: np.tanh(v / (0.005 * s)) * weakening(v, 0.15 * s)),
    "LuGre": ((WEAK,), lambda x, v, a, s, r: lugre(x, v, 0.05 * a, 0.2 * s)),
    "power of speed": ((DRAG,), lambda x, v, a, s, r: np.sign(v) * np.abs(v / s) ** (1.4 + 0.4 * r)),
    "softening": (("softening spring",), lambda x, v, a, s, r: -((x / a) ** 3)),
    "soft friction": ((DRY,), lambda x, v, a, s, r: v / np.hypot(v, 0.02 * s)),
}
FOLLOWING: dict[str, Shape] = {
    f"{DRY} that follows the current": lambda x, v, a, s, r: np.tanh(v / (0.01 * s)),
    f"{SLIDER} that follows the current": lambda x, v, a, s, r: yielding(x, 0.1 * a),
    f"{DRAG} that follows the current": lambda x, v, a, s, r: v * np.abs(v) / s**2,
}


def motion(random: np.random.Generator) -> tuple[Array, Array, Array]:
    """Displacement, speed and acceleration at the steps: three sines of changing size, or one that grows."""
    time_s = np.arange(int(RATE * SECONDS) * STEPS) / (RATE * STEPS)
    reach = 10.0 ** random.uniform(-3.0, -1.7)
    x = np.zeros_like(time_s)
    for share in (1.0, 0.4, 0.2) if random.random() < 0.7 else (1.0,):
        x += share * np.sin(2.0 * np.pi * random.uniform(0.6, 5.0) * time_s + random.uniform(0.0, 6.3))
    x *= reach * (0.4 + 0.6 * time_s / SECONDS)
    v = np.gradient(x, time_s, edge_order=2)
    return x, v, np.gradient(v, time_s, edge_order=2)


def make(folder: Path, seed: int, group: str, noise: float = 0.003, late: float = 0.0) -> None:
    """One case: rig file, record, sidecar and truth; the force has white noise, rms over rms, and comes late by s."""
    random = np.random.default_rng(seed)
    x, v, acceleration = motion(random)
    a, s = float(np.abs(x).max()), float(np.abs(v).max())
    mass = 10.0 ** random.uniform(-1.0, 1.0)
    spring = mass * (2.0 * np.pi * random.uniform(2.0, 20.0)) ** 2
    damper = 2.0 * random.uniform(0.02, 0.1) * math.sqrt(spring * mass)
    known = mass * acceleration + damper * v + spring * x
    size = float(np.std(known)) * random.uniform(0.2, 1.5)
    families: tuple[str, ...] = ()
    missing, channel = np.zeros_like(x), None
    if group in ("library", "outside"):
        table = LIBRARY if group == "library" else OUTSIDE
        families, law = table[sorted(table)[int(random.integers(len(table)))]]
        missing = size * law(x, v, a, s, float(random.random()))
    elif group == "following":
        family = sorted(FOLLOWING)[int(random.integers(len(FOLLOWING)))]
        turns = random.uniform(0.1, 0.4) * np.arange(x.size) / (RATE * STEPS)
        channel = 1.0 + 0.6 * np.sin(2.0 * np.pi * turns)
        families = (family,)
        strength = random.uniform(0.1, 0.5) + random.uniform(0.3, 0.8) * channel
        missing = size * FOLLOWING[family](x, v, a, s, 0.0) * strength
    force = known * (1.0 + 0.004 * random.standard_normal()) + missing
    steps = np.arange(force.size)
    force = np.interp(steps - late * RATE * STEPS, steps, force)[::STEPS]
    force += noise * float(np.std(force)) * random.standard_normal(force.size) + 0.01 * size * random.standard_normal()
    columns = {"x": x[::STEPS] + 2e-5 * a * random.standard_normal(force.size), "f": force}
    if channel is not None:
        columns["i"] = channel[::STEPS] + 0.005 * random.standard_normal(force.size)
    folder.mkdir(parents=True)
    np.savez(folder / "data.npz", **columns)
    chain = {"kind": "chain", "masses_kg": [mass], "ground_springs_n_m": [spring], "ground_dampers_ns_m": [damper]}
    model = {
        "name": "moved", "sample_rate_hz": RATE, "structure": chain, "exciter": {"kind": "force", "point": 1},
        "sensors": [{"quantity": "force", "point": "drive"}, {"quantity": "displacement", "point": 1}],
        "extraction": {"quantity": "displacement", "linear_modes": 1},
    }  # fmt: skip
    (folder / "model.yaml").write_text(yaml.safe_dump(json.loads(json.dumps(model, default=float))), encoding="utf-8")
    names = {"x": ("displacement", "m"), "f": ("force", "N"), "i": ("current", "A")}
    sidecar = {
        "rig": "model.yaml", "sample_rate": RATE, "file": "data.npz",
        "channels": [{"column": c, "quantity": names[c][0], "unit": names[c][1], "point": 1} for c in columns],
        "segments": [{"kind": "record", "start": 0.0, "stop": SECONDS, "held": "response"}],
    }  # fmt: skip
    (folder / "sidecar.yaml").write_text(yaml.safe_dump(sidecar), encoding="utf-8")
    np.savez(folder / "truth.npz", x=x[::STEPS], v=v[::STEPS], missing=missing[::STEPS],
             channel=np.zeros(force.size) if channel is None else channel[::STEPS])  # fmt: skip
    truth = {"group": group, "families": list(families), "seed": seed, "late": late}
    (folder / "truth.yaml").write_text(yaml.safe_dump(truth), encoding="utf-8")


def read_case(folder: Path) -> dict[str, Any]:
    """What is read from one case, beside the truth."""
    truth = yaml.safe_load((folder / "truth.yaml").read_text(encoding="utf-8"))
    found: dict[str, Any] = {"case": folder.name, "group": truth["group"], "true": truth["families"], "stated": False}
    rig = load_rig(str(folder / "model.yaml"), vibrating=False)
    try:
        with tempfile.TemporaryDirectory() as bags:
            import_data(folder / "sidecar.yaml", Path(bags) / "bag")
            observations = observed(rig, [Path(bags) / "bag"])
    except BenchError as error:
        refused = {"by": "refused", "names": [], "whole": False, "places": [], "noise": 0.0}
        return {**found, **(refused if truth["group"] == "pair" else {}), "refusals": [str(error)], "seconds": 0.0}
    begin = time.process_time()
    if truth["group"] == "pair":
        diagnosis = diagnose_observations(rig, observations, DiagnosisSettings(jobs=1, look_ahead=False)).diagnosis
        answer = headline_of(diagnosis)
        if answer["by"] == "law" and diagnosis.law is not None:
            answer["names"] = [[family, law.place] for law in diagnosis.law.laws for family in parts_of(law.family)]
        if answer["by"] == "unknown" and diagnosis.ranking:
            first = diagnosis.ranking[0]
            answer["names"] = list(zip(first.effect.split(" + "), first.detail.split(" + "), strict=False))
        return found | answer | {
            "seconds": time.process_time() - begin, "places": truth["places"], "masses": truth["masses"],
            "noise": truth["noise"], "shares": truth["shares"], "sentences": list(diagnosis.sentences),
            "probability": diagnosis.ranking[0].probability if diagnosis.ranking else 0.0,
        }  # fmt: skip
    reading = law_of(rig, observations)
    found["seconds"] = time.process_time() - begin
    if reading is None:
        return {**found, "refusals": ["no reading"]}
    return found | {
        "stated": reading.is_stated,
        "written": reading.is_written,
        "refusals": list(reading.refusals),
        "inside": reading.closed_inside,
        "above": reading.closed_above,
        "by_file": reading.closed_by_file,
        "read": [law.family for law in reading.laws],
        "places": [law.place for law in reading.laws],
        "other_places": [place for law in reading.laws for place in law.other_places],
        "true_place": truth.get("place", "1"),
        "bare": truth.get("bare", False),
        "alike": [family for law in reading.laws for family in law.other_families],
        "loop": loop_error(reading, folder) if reading.laws else math.nan,
        "late": None if reading.late is None else reading.late[1],
        "true_late": truth.get("late", 0.0),
        "terms": [[t.kind, *t.parameters, t.coefficient, t.by] for law in reading.laws for t in law.terms],
    }


def loop_error(reading: LawReading, folder: Path) -> float:
    """rms of law − truth over rms of the truth, without means, from a tenth of the record on."""
    truth = np.load(folder / "truth.npz")
    if not np.any(truth["missing"]):
        return math.inf
    read = np.zeros_like(truth["x"])
    for term in (term for law in reading.laws for term in law.terms):
        force = term.of_unit_strength.force(truth["x"][None], truth["v"][None], closed=False)[0]
        channel = {"": 1.0, "displacement": truth["x"]}.get(term.by, truth["channel"])
        read += term.coefficient * force * channel
    part = slice(read.size // 10, None)
    return float(np.std((read - truth["missing"])[part]) / np.std(truth["missing"][part]))


def families_of(line: dict[str, Any]) -> list[str]:
    """Families that were read."""
    return [words for law in line.get("read", ()) for words in law.replace(", ", " and ").split(" and ")]


def is_right(line: dict[str, Any]) -> bool:
    """Whether the law that is stated has the place and the families of the truth and no other."""
    at_place = line.get("places") in (None, [line.get("true_place")])
    return bool(line["stated"]) and at_place and sorted(families_of(line)) == sorted(line["true"])


def _effects_of(family: str) -> set[str]:
    """Effects of the diagnosis that a family is."""
    laws = driven_rows.LIBRARY.items()
    return {effect for name, law in laws if law.families == (family,) for effect in driven_rows.EFFECTS.get(name, ())}


def end_of_pair(line: dict[str, Any]) -> str:
    """``both``, ``nearest`` (both come nearest), ``one`` with more that remains, ``open`` or ``wrong``."""
    true = list(zip(line["true"], line["places"], strict=False))
    names = [(name, str(place)) for name, place in line["names"]]

    def is_one(name: str, place: str) -> bool:
        places = {place, "-".join(reversed(place.split("-")))}
        return any(at in places and (name == family or name in _effects_of(family)) for family, at in true)

    found = [is_one(*item) for item in names]
    if not names:
        return "wrong" if line["by"] == "none" else "open"
    if all(found) and len(set(names)) == 2:
        return "both" if line["by"] != "unknown" else "nearest"
    if line["whole"]:
        return "wrong"
    return "one" if any(found) else "open"


def table_of_pairs(lines: Sequence[dict[str, Any]]) -> list[str]:
    """How the pairs ended."""
    ends = Counter(map(end_of_pair, lines))
    seconds = [line["seconds"] for line in lines]
    return [
        f"pairs: {ends['both']} of {len(lines)} both, {ends['nearest']} as what comes nearest, "
        f"{ends['one']} one, {ends['open']} open, {ends['wrong']} wrong",
        f"CPU a record: median {np.median(seconds):.1f} s, largest {max(seconds):.1f} s",
    ]


def is_open(line: dict[str, Any]) -> bool:
    """Whether the families of the truth are named beside those that are read."""
    return any(
        sorted(words.replace(", ", " and ").split(" and ")) == sorted(line["true"]) for words in line.get("alike", ())
    )


def table(lines: Sequence[dict[str, Any]]) -> list[str]:
    """The figures of a campaign, a line each."""
    result = []
    for group in ("library", "outside", "following"):
        some = [line for line in lines if line["group"] == group]
        close = [line for line in some if line["stated"] and line["loop"] <= _LOOP]
        either = [line for line in some if is_right(line) or is_open(line)]
        silent = sum(not line["stated"] for line in some)
        result.append(
            f"{group}: {sum(map(is_right, some))} of {len(some)} right ({len(either)} with those that are named as "
            f"alike), {len(close)} with the force within {100 * _LOOP:.0f} %, {silent} not stated"
        )
    healthy = [line for line in lines if line["group"] == "healthy"]
    stated = [line for line in lines if line["group"] != "healthy" and line["stated"]]
    result.append(f"healthy: {sum(line['stated'] for line in healthy)} false laws in {len(healthy)}")
    if stated:
        more = sum(bool(set(families_of(line)) - set(line["true"])) for line in stated)
        inside, above, by_file = (np.median([line[key] for line in stated]) for key in ("inside", "above", "by_file"))
        unwritten = sum(not line["written"] for line in stated)
        result.append(f"stated: {more} of {len(stated)} with a family that is not there; {unwritten} not written")
        result.append(f"closed on parts left out, medians: inside {inside:.2f}, top {above:.2f}, file {by_file:.2f}")
    away = [line for line in stated if line["places"] != [line["true_place"]]]
    result.append(f"stated at another place: {len(away)}")
    without = [line for line in lines if line.get("bare") and line["group"] != "healthy"]
    if without:
        result.append(f"place without a sensor: {sum(map(is_right, without))} of {len(without)} right")
    moved = [line for line in stated if line.get("true_late")]
    if moved:
        near = sum(abs((line["late"] or 0.0) / line["true_late"] - 1.0) <= _DELAY for line in moved)
        result.append(f"late forces: {near} of {len(moved)} stated with their delay within {100 * _DELAY:.0f} %")
    in_step = sum(line.get("late") is not None for line in lines if not line.get("true_late"))
    result.append(f"forces in step that are told as late: {in_step}")
    seconds = [line["seconds"] for line in lines]
    return [*result, f"CPU a record: median {np.median(seconds):.1f} s, largest {max(seconds):.1f} s"]


def main() -> None:
    """Make cases, or read and tabulate them."""
    parser, maker, _ = sealed_parser(__doc__)
    maker.add_argument("--seed", type=int, required=True)
    maker.add_argument("--count", type=int, default=40)
    maker.add_argument("--group", choices=[*GROUPS, "pair"])
    maker.add_argument("--noise", type=float, default=0.003)
    maker.add_argument("--late", type=float, default=0.0)
    maker.add_argument("--driven", action="store_true")
    options = parser.parse_args()
    if options.part == "make" and options.group == "pair" and not options.driven:
        parser.error("two laws act on driven rows only; add --driven")
    if options.part == "make":
        groups = [options.group] if options.group else OF_DRIVEN if options.driven else GROUPS
        for number in range(options.count):
            seed = options.seed + number
            if options.driven:
                driven_rows.make(options.out / f"{seed}", seed, groups[number % len(groups)], options.noise)
                continue
            make(options.out / f"{seed}", seed, groups[number % len(groups)], options.noise, options.late)
        seal(options.out)
        return
    lines: list[dict[str, Any]] = []
    for line in sealed_answers(options, read_case):
        if line["group"] == "pair":
            true = " + ".join(f"{family}@{place}" for family, place in zip(line["true"], line["places"], strict=False))
            named = " + ".join(f"{name}@{place}" for name, place in line["names"])
            print(
                f"{line['case']} {end_of_pair(line)}: {true} | {line['by']}: {named} | {line['noise']:.3f}", flush=True
            )
            lines.append(line)
            continue
        mark = "right" if is_right(line) else "stated" if line["stated"] else "-"
        names = f"{', '.join(line['true'])} | {mark}: {', '.join(line.get('read', ()))}"
        names += f" | {line.get('true_place', '')}: {', '.join(line.get('places') or ())}"
        print(f"{line['case']} {line['group']}: {names} | {line.get('loop', math.nan):.3f}", flush=True)
        lines.append(line)
    pairs = [line for line in lines if line["group"] == "pair"]
    print("\n".join([*(table_of_pairs(pairs) if pairs else ()), *(table(lines) if len(lines) > len(pairs) else ())]))


if __name__ == "__main__":
    main()
