"""What a diagnosis makes of one measurement of every kind, as numbers; run by itself it writes `golden_kinds.npz`."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from diagnose.one_of_each_kind import KINDS, rig_of_kinds, with_chain

from nmt_diagnose.chain.chain_columns import linear_chain, scale_columns, shared_delays
from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.fit.misfit import misfit_of
from nmt_diagnose.fit.noise import groups_of, sigma_of
from nmt_diagnose.ledger.held_out import splits
from nmt_diagnose.observations.noise.floors import repeatability
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.prediction.operating_range import operating_range
from nmt_diagnose.say.residual_map import residual_map
from nmt_report.diagnosis_curves import Models, courses, level_names

FILE = Path(__file__).with_name("golden_kinds.npz")


def golden(kind: str) -> dict[str, Any]:
    """Arrays, and texts as JSON, by name."""
    rig = rig_of_kinds()
    observed = with_chain(KINDS[kind](rig))
    found: dict[str, Any] = {"values": observed.values, "sigma": observed.sigma}
    forward = Forward(observed.tests, observed.rows)
    prediction = forward.predict(rig)
    found["predicted"] = prediction.values
    parameters = calibration_parameters(rig)
    parametrisation = Parametrisation(rig, parameters, ())
    found["jacobian"] = forward.jacobian(parametrisation, np.zeros(len(parameters)), prediction)
    chain = linear_chain(observed, rig, prediction)
    found["chain columns"], found["chain added"] = chain.columns, chain.added
    found["scale columns"] = scale_columns(observed, rig, prediction)
    found["misfit"], found["misfit alone"] = (misfit := misfit_of(observed)).common, misfit.independent
    groups = groups_of(observed, np.full(len(observed.rows), 0.1))
    found["groups"] = groups.of
    found["rank"] = np.zeros(0) if groups.rank is None else groups.rank
    found["sigma of"] = sigma_of(observed)
    moved = replace(observed, values=observed.values + 2.0 * observed.std * np.cos(np.arange(len(observed.rows))))
    found["floor"], notes = repeatability(observed, moved)
    texts: dict[str, Any] = {"chain": chain.names, "groups": groups.names, "repeats": notes}
    texts["shared delays"] = [f"{it.quantity.name} {it.std}" for it in shared_delays(observed, rig)]
    for name, value in vars(operating_range(rig, observed.tests, observations=observed)).items():
        texts[f"range {name}"] = repr(sorted(value) if isinstance(value, frozenset) else value)
    for split in splits(observed):
        found[f"split {split.name}"] = split.held_out
    levels = observed.tests[0].held_levels(observed, 0)
    if levels is not None:
        for name in ("omega", "force", "force_std", "motion", "motion_std", "ratio", "ratio_std"):
            array = getattr(levels, name)
            if array is not None:
                found[f"held {name}"] = array
        texts["held"] = [levels.numbers, [channel.name for channel in levels.channels]]
    zero = np.zeros(len(observed.rows))
    texts["map"] = [repr(it) for it in residual_map(observed, zero + 1.0, zero + 2.0, zero + 3.0)]
    texts["label"] = [observed.tests[0].axis.label, level_names(observed.tests)]
    models = Models(prediction.values, prediction.values, prediction.values)
    for part in Part:
        for number, course in enumerate(courses(observed, models, 0, part)):
            found[f"course {part.name} {number} x"] = course.x
            texts[f"course {part.name} {number}"] = [course.title, course.x_label, course.unit, course.joined]
    found["texts"] = np.array(json.dumps(texts, default=str))
    return found


def write(path: Path = FILE) -> None:
    """All kinds into one file."""
    arrays = {f"{kind}: {name}": value for kind in KINDS for name, value in golden(kind).items()}
    np.savez_compressed(path, **arrays)


if __name__ == "__main__":
    import sys

    write(Path(sys.argv[1]) if len(sys.argv) > 1 else FILE)
