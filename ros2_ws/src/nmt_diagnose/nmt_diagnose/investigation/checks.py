"""Plain checks of an investigation's statements: of having no gap, by the recordings alone, and of how it ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from nmt_core.numerics.arrays import BoolArray, FloatArray
from nmt_diagnose.investigation.investigation_record import InvestigationRecord
from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.thresholds import THRESHOLDS

_COURSES = ((Part.LOG_FREQUENCY, "frequency", "the frequency"), (Part.LOG_MAGNITUDE, "response", "the response of {}"))
"""Observables whose course over the levels a person would look at: part, kind of the size that matters, words."""
_STATED_BY = {
    "named": (Verdict.EFFECT,),
    "no_gap": (Verdict.NONE,),
    "recalibrated": (Verdict.CALIBRATION,),
    "not_told_apart": (Verdict.EFFECT,),
    "unknown": tuple(Verdict),
}
"""Verdicts of the last diagnosis on which each end may rest."""


def none_contradicted(observations: Observations, predicted: FloatArray, matters: Mapping[str, float]) -> str:
    """What the course of the recordings over the levels says against having no gap.

    Frequency and responses of a model without a gap leave a residual that does not depend on the level. Neither a fit
    nor a learnt noise scale enters: the noise is the scatter between neighbouring levels.

    Args:
        observations: the real side.
        predicted: by the model that is stated to have no gap, (m,).
        matters: smallest relative size that matters, by kind of observable.

    Returns:
        A sentence; empty where nothing speaks against it.
    """
    rows = observations.rows
    left = observations.values - predicted
    for number, test in enumerate(observations.tests):
        if test.locked is None:
            continue
        for part, kind, words in _COURSES:
            for channel in np.unique(rows.channel[(rows.test == number) & (rows.part == part)]):
                here = (rows.test == number) & (rows.part == part) & (rows.channel == channel) & np.isfinite(left)
                here &= np.abs(rows.harmonic) == 1
                change = _course(left, rows.amplitude, here)
                if abs(change) > matters.get(kind, 0.0):
                    name = "" if channel < 0 else test.channels[channel].name
                    return (
                        f"Between the lowest and the highest levels {words.format(name)} moves by "
                        f"{100.0 * abs(change):.2g} % more than the model says, which is not noise."
                    )
    return ""


def _course(left: FloatArray, amplitude: FloatArray, rows: BoolArray) -> float:
    """Change of the residual from the lowest to the highest third of the levels; 0 where that is their scatter."""
    found = np.flatnonzero(rows)
    values = left[found][np.argsort(amplitude[found], kind="stable")]
    third = max(1, values.size // 3)
    if values.size < 3:
        return 0.0
    # A straight course has no second differences; those of scatter have six times its variance.
    scatter = float(np.sqrt(np.mean(np.diff(values, 2) ** 2) / 6.0))
    change = float(np.mean(values[-third:]) - np.mean(values[:third]))
    std = scatter * np.sqrt(2.0 / third)
    return change if abs(change) > THRESHOLDS.verdict.visible_sigmas * std else 0.0


def end_contradicted(record: InvestigationRecord) -> str:
    """What a record itself says against how it ended; empty where nothing does.

    Args:
        record: with its end.
    """
    if record.ended not in _STATED_BY:
        return "" if record.ended and _is_bounded(record) else "It says of levels that were not measured nothing."
    if not record.turns:
        return "It rests on no diagnosis."
    last = record.turns[-1]
    if Verdict(last.verdict) not in _STATED_BY[record.ended]:
        return f"It ended with {record.ended}, and its last diagnosis says {last.verdict}."
    if last.tests < len(record.measured):
        return f"Its last diagnosis knows {last.tests} of {len(record.measured)} tests."
    return "" if _is_bounded(record) else "It says of levels that were not measured nothing."


def ended_record(record: InvestigationRecord, why: str, sentence: str) -> InvestigationRecord:
    """A record with its end: a sentence, with the record's bound where it rests on a diagnosis.

    An end that the record itself contradicts is `unknown`, and says what contradicts it.

    Args:
        record: without its end.
        why: kind of the end.
        sentence: what it states.
    """
    bound = record.bound if record.turns else ""
    made = replace(record, ended=why, conclusion=f"{sentence} {bound}".rstrip())
    contradicted = end_contradicted(made)
    return replace(made, ended="unknown", conclusion=f"{contradicted} {made.conclusion}") if contradicted else made


def _is_bounded(record: InvestigationRecord) -> bool:
    return not record.turns or record.bound in record.conclusion
