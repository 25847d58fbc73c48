"""Sealed plates with an error of their model's form: is it named, with its region?

Run in ``./nmt shell``::

    python -m nmt_laboratories.plate_campaign --first 8300 --count 40 --out answers

Theory, boundary, local stiffness, local mass, damping and none take turns. A plate whose answer is in the folder is not
diagnosed again.
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
from nmt_laboratories import plates
from nmt_laboratories.campaign_frame import answers_of_seeds, print_ends, seed_parser
from nmt_laboratories.plates import Plate, drawn, recorded

RIGHT, HEDGED, UNKNOWN = "right", "hedged right", "honest unknown"
HEDGED_WRONG, WRONG = "hedged wrong", "confidently wrong"
CONFIDENT = 0.9
# Effects that say it, and what their place begins with.
NAMED = {
    plates.BOUNDARY: ({"clamp_compliance"}, "clamp rotation"),
    plates.STIFFNESS: ({"local_stiffness"}, "patch{at}"),
    plates.MASS: ({"local_mass"}, "patch{at}"),
    plates.DAMPING: ({"structural_damping", "viscous_damping"}, ""),
    plates.THEORY: (set(), ""),
}


def judged(plate: Plate, diagnosis: Diagnosis) -> str:
    """How it ended.

    A healthy plate has no effect; the owner's modulus may be said to be off. Of damping the parameters of the modes are
    the model's own, so that it may be a calibration in which nothing but them matters. No hypothesis is the soft shear
    of another theory: what is right there is that something is unknown.
    """
    verdict, first = diagnosis.verdict, diagnosis.ranking[0] if diagnosis.ranking else None
    if plate.kind == plates.HEALTHY:
        return RIGHT if verdict in (Verdict.NONE, Verdict.CALIBRATION) else _wrong(diagnosis)
    if verdict is Verdict.UNKNOWN:
        return RIGHT if plate.kind == plates.THEORY else UNKNOWN
    if verdict is Verdict.CALIBRATION and plate.kind == plates.DAMPING:
        return RIGHT
    if verdict is not Verdict.EFFECT or first is None:
        return WRONG
    effects, place = NAMED[plate.kind]
    if first.effect in effects and first.detail.startswith(place.format(at=plate.at)):
        return RIGHT if first.probability >= CONFIDENT and diagnosis.adequate else HEDGED
    others = [item for item in diagnosis.ranking[1:] if item.probability > 1.0 - CONFIDENT]
    if any(item.effect in effects and item.detail.startswith(place.format(at=plate.at)) for item in others):
        return HEDGED
    return _wrong(diagnosis)


def _wrong(diagnosis: Diagnosis) -> str:
    """Whether a wrong effect was stated as sure, as the whole explanation."""
    if diagnosis.verdict is not Verdict.EFFECT:
        return HEDGED_WRONG
    sure = diagnosis.adequate and diagnosis.ranking[0].probability >= CONFIDENT
    return WRONG if sure else HEDGED_WRONG


def answered(seed: int) -> dict[str, Any]:
    """The answer of a seed."""
    plate = drawn(seed)
    with tempfile.TemporaryDirectory() as name:
        rig, bag = recorded(plate, Path(name), np.random.default_rng([823, seed]))
        began = time.process_time()
        settings = DiagnosisSettings(jobs=1, look_ahead=False)
        diagnosis = diagnose_bags(rig, [bag], settings=settings).diagnosis
    first = diagnosis.ranking[0] if diagnosis.ranking else None
    return {
        "seed": seed, "kind": plate.kind, "at": plate.at, "factor": plate.factor, "compliance": plate.compliance,
        "end": judged(plate, diagnosis), "verdict": str(diagnosis.verdict.value), "adequate": diagnosis.adequate,
        "effect": first.effect if first else "", "detail": first.detail if first else "",
        "probability": first.probability if first else 0.0,
        "parameters": {
            key: [value.value, value.std, value.unit] for key, value in first.parameters.items()
        } if first else {},
        "ranking": [[item.effect, item.detail, item.probability] for item in diagnosis.ranking[:4]],
        "sentences": list(diagnosis.sentences[:4]), "cpu_s": time.process_time() - began,
    }  # fmt: skip


def line_of(answer: dict[str, Any]) -> str:
    """A plate in words."""
    truth = f"{answer['kind']} {answer['at']} {answer['factor']:.3g} {answer['compliance']:.2g}"
    words = f"{answer['verdict']} {answer['effect']}@{answer['detail']} {answer['probability']:.2f}"
    values = ", ".join(f"{key} {value[0]:.4g} ± {value[1] or 0:.2g}" for key, value in answer["parameters"].items())
    return f"{answer['seed']} {truth:32} {answer['end']:18} {words:44} {values:36} {answer['cpu_s']:.0f} s"


def main() -> None:
    """Diagnose the plates that have no answer yet, print a line each, and how many ended how."""
    options = seed_parser(__doc__, 8300, 40, kept=True).parse_args()
    print_ends((line_of(answer), answer["end"]) for answer in answers_of_seeds(options, answered))


if __name__ == "__main__":
    main()
