"""The files of a diagnosis: ``diagnosis.json``, ``report.html``, ``model.yaml`` and ``observables.csv``."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from nmt_core.bench_version import bench_version
from nmt_core.errors import BenchError
from nmt_core.files.whole_file import write_whole
from nmt_diagnose.diagnose import DiagnosisOutcome
from nmt_report.diagnosis_curves import Models, observables_csv
from nmt_report.diagnosis_model import model_text
from nmt_report.diagnosis_report import DiagnosisReport, diagnosis_page
from nmt_rig.rig import find_rig


def write_diagnosis(
    outcome: DiagnosisOutcome,
    folder: Path | str,
    model: Path | str,
    overrides: Sequence[str] = (),
    floor: Sequence[Path | str] = (),
) -> str:
    """Write a diagnosis to a folder.

    Args:
        outcome: of :func:`nmt_diagnose.diagnose_bags`.
        folder: exists.
        model: name or path of the rig file that the given model was loaded from.
        overrides: ``key=value`` texts that were applied to it.
        floor: the bags that were repeats, for the floor.

    Returns:
        A sentence without ``model.yaml`` because no rig file may hold the fitted values; else empty.

    Raises:
        BenchError: no such rig, or exists the folder cannot be written.
    """
    folder, path = Path(folder), find_rig(model)
    diagnosis = replace(
        outcome.diagnosis, inputs=_complete_inputs(outcome.diagnosis.inputs, path, overrides, list(map(str, floor)))
    )
    models = Models(outcome.as_given, outcome.refitted, outcome.final)
    diagnosis.write(folder / "diagnosis.json")
    remark, text = "", path.read_text(encoding="utf-8")
    try:
        text = model_text(text, path.name, outcome.initial_model, outcome.model, diagnosis)
        write_whole(folder / "model.yaml", text)
    except BenchError as error:
        remark = f"There is no model.yaml: the fitted values are no rig ({error})"
    write_whole(folder / "observables.csv", observables_csv(outcome.observations, models))
    write_whole(
        folder / "report.html", diagnosis_page(replace(drawn(outcome), diagnosis=diagnosis, has_model=not remark))
    )
    return remark


def drawn(outcome: DiagnosisOutcome) -> DiagnosisReport:
    """What pages draw of a diagnosis."""
    models = Models(outcome.as_given, outcome.refitted, outcome.final)
    return DiagnosisReport(outcome.diagnosis, outcome.observations, models, outcome.initial_model)


def _complete_inputs(
    inputs: dict[str, Any], model: Path, overrides: Sequence[str], floor: Sequence[str]
) -> dict[str, Any]:
    """What ``inputs`` of ``diagnosis.json`` says beyond what the diagnosis knows: files, overrides, versions."""
    bags = [
        {**bag, "role": "repeat, for the floor" if bag.get("path") in floor else "measurement"}
        for bag in inputs.get("bags", ())
    ]
    return {
        **inputs,
        "bags": bags,
        "model_file": {"path": str(model), "sha256": hashlib.sha256(model.read_bytes()).hexdigest()},
        "overrides": list(overrides),
        "version": f"nmt {bench_version()}".strip(),
    }
