"""``model.yaml``: the rig file of a diagnosis, with re-fitted parameters and the effect added."""

from __future__ import annotations

import math
from typing import Any

from nmt_core.text.number_words import value_text
from nmt_diagnose.effects.location import effect_words
from nmt_diagnose.ledger.diagnosis import Diagnosis, Verdict
from nmt_diagnose.say.words import key_text
from nmt_report.quantity_format import significant
from nmt_rig.rig import Rig
from nmt_rig.rig_file_edit import changed_keys, edited_rig_text

_LISTED = 40


def model_text(text: str, name: str, given: Rig, model: Rig, diagnosis: Diagnosis) -> str:
    """Text of the new rig file; what the diagnosis changed stands among its assumptions.

    Where a gap stays unexplained, nothing is changed: parameters that were re-fitted against it follow what they cannot
    explain.

    Args:
        text: rig file that the given model was loaded from.
        name: of that file.
        given: the model as given.
        model: the model of the outcome.
        diagnosis: what was found.

    Raises:
        BenchError: ``text`` is not a rig file.
    """
    if diagnosis.verdict is Verdict.UNKNOWN and not (diagnosis.law is not None and diagnosis.law.is_written):
        model = given
    lines = assumptions(given, model, diagnosis)
    target = model.model_copy(update={"assumptions": [*model.assumptions, *lines]})
    return edited_rig_text(text, name, target)


def assumptions(given: Rig, model: Rig, diagnosis: Diagnosis) -> list[str]:
    """Sentences for the rig file: what was added or re-fitted, by which diagnosis."""
    changes = changed_keys(given, model)
    if not changes and diagnosis.verdict is not Verdict.UNKNOWN:
        return []
    bags = ", ".join(f"{bag['path']} (SHA-256 {bag['sha256'][:12]})" for bag in diagnosis.inputs.get("bags", ()))
    by = f"by a diagnosis of {bags}" if bags else "by a diagnosis"
    if not changes:
        return [f"Not changed {by}: it found a gap that no effect of its library explains."]
    fitted = {item.name: item for item in diagnosis.calibration}
    refitted, added = [], []
    for key, old, new in changes:
        item = fitted.get(key)
        if item is not None:
            start, to = value_text(item.start, math.nan), value_text(item.to, item.std, item.unit)
            refitted.append(f"{key_text(key, given)} from {start} to {to}")
        elif isinstance(old, int | float) and isinstance(new, int | float):
            added.append(f"{key_text(key, given)} from {significant(float(old), 6)} to {significant(float(new), 6)}")
        else:
            added.append(f"{key_text(key, given)} = {_brief(new)}")
    result = []
    if added and diagnosis.verdict is Verdict.EFFECT and diagnosis.ranking:
        effect = effect_words(diagnosis.ranking[0].effect)
        result.append(f"Effect added {by}: {effect}; {'; '.join(added[:_LISTED])}.")
    elif added:
        result.append(f"Changed {by}: {'; '.join(added[:_LISTED])}.")
    if refitted:
        result.append(f"Parameters re-fitted {by}: {'; '.join(refitted[:_LISTED])}.")
    return result


def _brief(value: Any) -> str:
    """A new entry in words, its kind first."""
    if not isinstance(value, dict):
        return significant(value, 6) if isinstance(value, float) else str(value)
    silent: tuple[Any, ...] = (None, [], False)
    parts = [
        f"{key} {_brief(item)}"
        for key, item in value.items()
        if item not in silent and key not in ("name", "kind") and (key, item) != ("side", "structure")
    ]
    kind = [str(value["kind"])] if value.get("kind") else []
    return ", ".join(kind + parts)
