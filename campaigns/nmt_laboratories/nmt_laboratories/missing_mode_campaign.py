"""Sealed structures with a degree of freedom that their model lacks: is it named, with its place and frequency?

Run in ``./nmt shell``::

    python -m nmt_laboratories.missing_mode_campaign --first 8200 --count 12 --out answers

Even seeds have a mass on a spring at a point, odd ones an elastic transmission. A structure whose answer is in the
folder is not diagnosed again.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from nmt_diagnose.diagnose import diagnose_bags
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.ledger.diagnosis import Diagnosis, Verdict
from nmt_laboratories.campaign_frame import answers_of_seeds, print_ends, seed_parser
from nmt_laboratories.structures_with_more_modes import MoreModes, drawn, recorded

NAMED, HEDGED = "named", "hedged"
HEDGED_WRONG, WRONG = "hedged wrong", "confidently wrong"
CONFIDENT, FREQUENCY = 0.9, 0.02


def judged(structure: MoreModes, diagnosis: Diagnosis) -> str:
    """How it ended: named with its point, and its frequency within two per cent; or open; or wrong."""
    if diagnosis.verdict is not Verdict.EFFECT or not diagnosis.ranking:
        return HEDGED if diagnosis.verdict is Verdict.UNKNOWN else WRONG
    first = diagnosis.ranking[0]
    sure = diagnosis.adequate and first.probability >= CONFIDENT
    hertz = first.parameters.get("f")
    mode = first.effect == "missing_mode" and hertz is not None
    near = hertz is not None and abs(hertz.value / structure.frequency_hz - 1.0) < FREQUENCY
    if mode and near and first.detail.split()[0] == str(structure.point):
        return NAMED
    if mode and max(first.places.values(), default=1.0) < CONFIDENT:
        return HEDGED_WRONG
    return WRONG if sure else HEDGED_WRONG


def answered(seed: int) -> dict[str, Any]:
    """The answer of a seed."""
    structure = drawn(seed)
    with tempfile.TemporaryDirectory() as name:
        rig, bag = recorded(structure, Path(name), np.random.default_rng([821, seed]))
        began = time.process_time()
        settings = DiagnosisSettings(jobs=1, look_ahead=False)
        diagnosis = diagnose_bags(rig, [bag], settings=settings).diagnosis
    first = diagnosis.ranking[0] if diagnosis.ranking else None
    return {
        "seed": seed, "kind": structure.kind, "point": structure.point, "mass": structure.mass,
        "frequency_hz": structure.frequency_hz, "end": judged(structure, diagnosis),
        "verdict": str(diagnosis.verdict.value), "adequate": diagnosis.adequate,
        "effect": first.effect if first else "", "detail": first.detail if first else "",
        "probability": first.probability if first else 0.0,
        "parameters": {key: value.value for key, value in first.parameters.items()} if first else {},
        "places": first.places if first else {}, "sentences": list(diagnosis.sentences[:3]),
        "cpu_s": time.process_time() - began,
    }  # fmt: skip


def line_of(answer: dict[str, Any]) -> str:
    """A structure in words."""
    named = f"{answer['effect']}@{answer['detail']} f {answer['parameters'].get('f', float('nan')):.4g} Hz"
    truth = f"{answer['kind']}@{answer['point']} f {answer['frequency_hz']:.4g} Hz m {answer['mass']:.3g} kg"
    return (
        f"{answer['seed']} {truth:48} {answer['end']:18} {named:40} p {answer['probability']:.2f} "
        f"{answer['cpu_s']:.0f} s"
    )


def main() -> None:
    """Diagnose the structures that have no answer yet, print a line each, and how many ended how."""
    options = seed_parser(__doc__, 8200, 12, kept=True).parse_args()
    print_ends((line_of(answer), answer["end"]) for answer in answers_of_seeds(options, answered))


if __name__ == "__main__":
    main()
