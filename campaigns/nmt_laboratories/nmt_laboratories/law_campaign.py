"""Makes sealed cases of :mod:`nmt_laboratories.laboratory_laws`, reads the law of each, and tabulates what was read.

Run in ``./nmt shell``::

    python -m nmt_laboratories.law_campaign make --seed 800 --out cases --laboratory-one LABORATORY
    python -m nmt_laboratories.law_campaign read cases --out answers

``make`` writes ``seal.txt``, the SHA-256 of all truths; ``read`` refuses others. The reading alone is timed, without
import and rows. A case that has an answer is not read again.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from nmt_bench.data_import import import_data
from nmt_core.errors import BenchError
from nmt_diagnose.diagnose import observed
from nmt_diagnose.law.reading import LawReading, LocalLaw
from nmt_diagnose.search.law_starts import law_of
from nmt_laboratories import laboratory_laws
from nmt_laboratories.campaign_frame import seal, sealed_answers, sealed_parser
from nmt_rig.rig import load_rig

_CLEAR = 10.0  # standard deviations of a harmonic from which a law must be read
_STRENGTH, _LOOP, _INSIDE, _ABOVE = 0.05, 0.10, 0.90, 0.80


def read_case(folder: Path) -> dict[str, Any]:
    """What is read from one case, and what the truth says of it."""
    truth = yaml.safe_load((folder / "truth.yaml").read_text(encoding="utf-8"))
    rig = load_rig(str(folder / "model.yaml"), vibrating=False)
    found: dict[str, Any] = {"case": folder.name, "group": truth["group"], "seconds": 0.0, "laws": []}
    found |= {"true": [f"{law['family']} at {law['point']}" for law in truth["laws"]], "stated": False}
    try:
        with tempfile.TemporaryDirectory() as bags:
            import_data(folder / "sidecar.yaml", Path(bags) / "bag")
            observations = observed(rig, [Path(bags) / "bag"])
    except BenchError as error:
        return {**found, "refusals": [str(error)], "harmonic_sigma": math.inf, "levels": 0}
    begin = time.process_time()
    reading = law_of(rig, observations)
    seconds = time.process_time() - begin
    found["seconds"] = seconds
    levels = [
        held
        for k in range(len(observations.tests))
        if (held := observations.tests[k].held_levels(observations, k)) is not None
    ]
    with np.errstate(invalid="ignore", divide="ignore"):
        ratios = [np.nanmax(np.abs(held.motion[:, :, 2:]) / held.motion_std[:, :, 2:]) for held in levels]
    found["harmonic_sigma"] = float(max(ratios, default=math.nan))
    found["levels"] = max((held.count for held in levels), default=0)
    if reading is None:
        return {**found, "refusals": ["no reading"]}
    found |= {
        "stated": reading.is_stated, "refusals": list(reading.refusals), "before": reading.before,
        "after": reading.after, "inside": reading.closed_inside, "above": reading.closed_above,
    }  # fmt: skip
    for law in reading.laws:
        terms = [[t.kind, *t.parameters, t.coefficient, t.std] for t in law.terms]
        found["laws"].append(
            {"place": law.place, "family": law.family, "alike": list(law.other_places), "terms": terms}
        )
    found["strength"] = _strength_error(reading, truth)
    # Segments before the levels count among those that a level is numbered by.
    segments = yaml.safe_load((folder / "sidecar.yaml").read_text(encoding="utf-8"))["segments"]
    before = next(k for k, segment in enumerate(segments) if segment["kind"] == "phase_resonance")
    found["loop"] = _loop_error(reading.laws, truth, before)
    return found


def _strength_error(reading: LawReading, truth: dict[str, Any]) -> float:
    """Largest relative error of the strengths that the truth names; NaN where a term of that kind is missing."""
    errors = []
    for law in truth["laws"]:
        for name, value in law["strengths"].items():
            kind, _, exponent = name.partition(" ")
            terms = [t for one in reading.laws if one.place == str(law["point"]) for t in one.terms]
            if kind == "clearance":
                close = [t.parameters[0] for t in terms if t.kind in ("gap", "stop", "slider") and t.parameters]
                read = close[0] if close else math.nan
            else:
                read = sum(
                    t.coefficient
                    for t in terms
                    if t.kind == kind and (not exponent or t.parameters[0] == float(exponent))
                )
            errors.append(abs(read / value - 1.0))
    return float(max(errors, default=math.nan))


def _loop_error(laws: Sequence[LocalLaw], truth: dict[str, Any], before: int) -> float:
    """rms of law − truth over rms of the truth without means, over all levels with a loop; ``before`` the levels are
    other segments."""
    miss = total = 0.0
    for point in dict.fromkeys(law.point for law in laws):
        mine = [law for law in laws if law.point == point]
        for loop in mine[0].loops:
            if not truth["levels"]:
                return math.nan
            place = truth["levels"][loop.level - before]["places"].get(point)
            if place is None:
                return math.inf
            force, moved = (np.array([complex(*z) for z in place[name]]) for name in ("force", "displacement"))
            x, v = np.array(loop.displacement), np.array(loop.velocity)
            read = sum(t.coefficient * t.of_unit_strength.force(x, v) for law in mine for t in law.terms)
            series, x = np.fft.rfft(read) / x.size, np.fft.rfft(x)
            orders = np.arange(force.size)
            shift = np.angle(x[1]) - np.angle(moved[1])
            turned = force[orders] * np.exp(1j * orders * shift)
            miss += float(np.sum(np.abs(2.0 * series[orders] - turned)[1:] ** 2))
            total += float(np.sum(np.abs(turned[1:]) ** 2))
    return math.sqrt(miss / total) if total > 0.0 else math.nan


def is_right(line: dict[str, Any]) -> bool:
    """Whether the law that is stated has family and place of the truth."""
    read = sorted(f"{law['family']} at {law['place']}" for law in line["laws"])
    return bool(line["stated"]) and read == sorted(line["true"])


def table(lines: Sequence[dict[str, Any]]) -> list[str]:
    """The figures of a campaign, a line each."""
    structure = [line for line in lines if line["group"] != "other"]
    clear = [line for line in structure if line["harmonic_sigma"] >= _CLEAR]
    library = [line for line in clear if line["group"] == "library"]
    outside = [line for line in clear if line["group"] == "outside"]
    others = [line for line in lines if line["group"] == "other"]
    right = [line for line in library if is_right(line)]
    stated = [line for line in structure if line["stated"]]
    loops = [line for line in stated if not math.isnan(line["loop"])]
    singles = [line for line in stated if len(line["true"]) == 1]
    pairs = [line for line in structure if len(line["true"]) > 1]
    alone = [line["seconds"] for line in lines if len(line["true"]) < 2]

    def of(chosen: Sequence[Any], test: Callable[[Any], bool]) -> str:
        return f"{sum(map(test, chosen))} of {len(chosen)}"

    times = ", ".join(f"{line['seconds']:.1f}" for line in pairs)
    told = [line for line in outside if line["stated"]]
    return [
        f"in the library, a harmonic of {_CLEAR:g} σ: family and place {of(library, is_right)}",
        f"  strength within {_STRENGTH:.0%}: {of(right, lambda x: x['strength'] <= _STRENGTH)} of these",
        f"outside it: family and place {of(outside, is_right)}; stated {len(told)}",
        f"  closed inside ≥ {_INSIDE:g}: {of(told, lambda x: x['inside'] >= _INSIDE)}, "
        f"at the top ≥ {_ABOVE:g}: {of(told, lambda x: x['above'] >= _ABOVE)} of these",
        f"false laws: {of(others, lambda x: x['stated'])}",
        f"needless second law: {of(singles, lambda x: len(x['laws']) > 1)}",
        f"loop within {_LOOP:.0%}: {of(loops, lambda x: x['loop'] <= _LOOP)}",
        f"processor time, single: median {np.median(alone):.1f}, worst {max(alone):.1f} s; pairs: {times} s",
    ]


def _line(line: dict[str, Any]) -> str:
    laws = "; ".join(f"{law['family']} at {law['place']}" for law in line["laws"]) or "no law"
    figures = [f"{line.get(key, math.nan):.3g}" for key in ("before", "after", "inside", "above", "strength", "loop")]
    end = "stated" if line["stated"] else "refused: " + ", ".join(line["refusals"])
    mark = "" if line["group"] == "other" else "  ok  " if is_right(line) else "  MISS"
    return (
        f"{line['case']:32s}{mark} [{', '.join(line['true'])}] {laws} | {' '.join(figures)} | "
        f"{line['harmonic_sigma']:.0f} σ, {line['seconds']:.1f} s | {end}"
    )


def main() -> None:
    """Make or read."""
    parser, maker, _ = sealed_parser(__doc__)
    maker.add_argument("--seed", type=int, default=800, help="of the first case")
    maker.add_argument("--laboratory-one", type=Path, help="folder of laboratory one, where it is at hand")
    options = parser.parse_args()
    if options.part == "make":
        options.out.mkdir(parents=True, exist_ok=True)
        laboratory = options.laboratory_one and options.laboratory_one.resolve()
        for name in laboratory_laws.names(laboratory, options.seed):
            print(laboratory_laws.make_case(options.out, name, laboratory), flush=True)
        seal(options.out)
        return
    lines = []
    for line in sealed_answers(options, read_case):
        lines.append(line)
        print(_line(line), flush=True)
    print("\n".join(table(lines)))


if __name__ == "__main__":
    main()
