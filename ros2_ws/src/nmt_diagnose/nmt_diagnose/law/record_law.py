"""The law of a missing force, read sample by sample from records of an imposed motion whose force was measured.

No balance is solved: terms are evaluated along the measured motion, sliders and bristles with their memory, and their
strengths are a convex problem as those of held levels. The parts of the largest motion are predicted by a fit to all
below them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from nmt_core.numerics.arrays import FloatArray
from nmt_core.text.number_words import percent
from nmt_diagnose.law.force_loop import ForceLoop
from nmt_diagnose.law.law_elements import with_laws
from nmt_diagnose.law.moved_record import MovedRecords
from nmt_diagnose.law.reading import LawReading, LawTerm, LocalLaw, closed_share, nearly_as_well
from nmt_diagnose.law.record_check import RecordCheck, check_of
from nmt_diagnose.law.record_delay import delay_of
from nmt_diagnose.law.record_search import RecordLaw, RecordSearch, words_of
from nmt_diagnose.law.sampled_records import SampledRecords
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig

_DRAWN = 60  # points of a stretch
_LINE = 1500  # points of its line
_NAMED = 3  # families that do nearly as well
# Motions that may part laws: times the displacement, and times the speed along it.
_PARTING = {
    "twice the displacement": (2.0, 1.0), "half of the displacement": (0.5, 1.0), "twice the speed": (1.0, 2.0),
    "half of the speed": (1.0, 0.5),
}  # fmt: skip


def _none(_: str) -> tuple[str, ...]:
    return ()


def read_record_law(rig: Rig, observations: Observations) -> LawReading | None:
    """The law of the force that the model lacks at the point that records move; None without such a record.

    Args:
        rig: the model as given.
        observations: the real side.
    """
    records = MovedRecords.of(rig, observations)
    if records is None:
        return None
    in_step, worth = _reading(rig, records)
    if in_step.before < THRESHOLDS.law.least_null_score:
        return in_step
    ratio = 1.0 / THRESHOLDS.law.alike_score_ratio
    delay = delay_of(records, worth, ratio)
    apart = MovedRecords.of(rig, observations, delay) if delay else None
    if apart is None:
        return in_step
    late, _ = _reading(rig, apart)
    nearer = round(late.late[1] * records.force_rate) if late.late else delay
    if nearer != delay and (apart := MovedRecords.of(rig, observations, nearer)) is not None:
        late = min(late, _reading(rig, apart)[0], key=lambda reading: reading.after)
    if late.before < THRESHOLDS.law.least_null_score:
        return replace(
            in_step,
            refusals=(
                "with its force moved into step the record differs from the model by no more than noise and tolerances",
            ),
            late=late.late,
        )
    # Unmodelled hysteresis looks like a delay, so a delay is accepted only if it clearly lowers the residual.
    clear = late.is_stated and late.after <= THRESHOLDS.law.clear_score_ratio * in_step.after
    return late if clear else in_step


def _reading(rig: Rig, records: MovedRecords) -> tuple[LawReading, FloatArray]:
    """The law of records whose force is as late as they say, and what their errors of chain and model count with."""
    search = RecordSearch(records)
    tried = search.found() if search.null.score >= THRESHOLDS.law.least_null_score else []
    return reading_of(rig, search, tried), search.worth


def reading_of(
    rig: Rig,
    search: RecordSearch,
    tried: Sequence[RecordLaw],
    other_places: Callable[[str], tuple[str, ...]] = _none,
) -> LawReading:
    """The law of records, or why none is reported.

    Args:
        rig: the model as given.
        search: of the law.
        tried: the law that was found and those that it was compared with; nothing without a search.
        other_places: places at which a law of a family does nearly as well.
    """
    limits, records = THRESHOLDS.law, search.records
    before = search.null.score
    name = " and ".join(record.test.name for record in records.records)

    def reading(
        why: str,
        *laws: LocalLaw,
        after: float = before,
        above: float = math.nan,
        by_file: float = math.nan,
        late: float = float(records.late),
        check: RecordCheck | None = None,
    ) -> LawReading:
        inside = closed_share(before, after) if laws else math.nan
        refusals = (why,) if why else ()
        lateness = None if records.lateness is None else (records.lateness[0], late * records.lateness[1])
        return LawReading(
            name, records.count, laws, before, after, inside, above, refusals, True, by_file, late=lateness, check=check
        )

    if before < limits.least_null_score:
        return reading("the record differs from the model by no more than noise and tolerances")
    if not tried:
        return reading("no local force explains it")
    best = tried[0]
    if not best.terms:
        return reading("no local force explains it")
    pulled = search.pulled(best)
    if pulled:
        # It needs them where without them it leaves more than tolerances, or more than a law has to fall by.
        within = search.ordinary(best.blocks)
        enough = max(limits.least_null_score, limits.alike_score_ratio * best.score)
        if within.acts and within.score <= enough:
            best, pulled = within, []
    top = [records.count - 2, records.count - 1]
    above = closed_share(search.predicted([], top), search.predicted(best.blocks, top))
    why = ""
    remaining = search.remaining(best)
    if remaining > limits.told_score_ratio:
        why = f"with it {100.0 * remaining:.0f} % of the misfit stay; half is asked for"
    elif pulled:
        why = f"it needs what chain and model are not ordinarily off by: {', '.join(pulled)}"
    elif above < 0.0:
        why = "the parts of the largest motion are predicted worse with it"
    law = _law(search, best, tried, other_places)
    by_file = math.nan if why else _closed_by_file(rig, search, best, law, top)
    return reading(
        why, law, after=best.score, above=above, by_file=by_file, late=search.late(best), check=check_of(search, best)
    )


def _closed_by_file(rig: Rig, search: RecordSearch, best: RecordLaw, law: LocalLaw, out: list[int]) -> float:
    """Share of the gap at some parts that a rig file closes whose strengths are those of all others."""
    _, values = search.without(best.blocks, out)
    refitted = replace(best, fit=replace(best.fit, coefficients=values))
    count = len(refitted.terms)
    others = replace(law, terms=_law_terms(refitted, np.zeros((count, count)))) if refitted.acts else law
    before, after = (search.records.left_by(model, out) for model in (rig, with_laws(rig, [others])))
    return closed_share(before, after)


def _law(
    search: RecordSearch,
    best: RecordLaw,
    tried: Sequence[RecordLaw],
    other_places: Callable[[str], tuple[str, ...]],
) -> LocalLaw:
    records = search.records
    terms = _law_terms(best, search.covariance(best))
    words = words_of(records, best)
    others: dict[str, RecordLaw] = {}
    for law in tried:
        if nearly_as_well(law.score, best.score) and len(law.blocks) <= len(best.blocks):
            others.setdefault(words_of(records, law), law)
    others.pop(words, None)
    alike = list(others.items())[:_NAMED]
    largest = float(np.abs(records.x).max())
    channels = dict.fromkeys(term.by for term in terms if term.by)
    between = tuple((channel, *records.range_of(channel)) for channel in channels)
    return LocalLaw(
        *records.place, words, terms, largest, other_places(words), _loops(records, best),
        tuple(other for other, _ in alike), between,
        parting_motion(records, best, [law for _, law in alike]),
    )  # fmt: skip


def parting_motion(records: SampledRecords[Any], best: RecordLaw, others: Sequence[RecordLaw]) -> str:
    """The motion at which another law differs most from the best, with the difference there and here; or nothing.

    A difference is the rms between the force of the best law and of the other, without means, over the larger of both:
    a smaller motion may reach no contact of the best.
    """
    laws = [best, *others]
    if not others or any(term.by for law in laws for term, _ in law.terms):
        return ""

    def apart(size: float, rate: float) -> float:
        parts = []
        for record in records.records:
            x, v = size * record.x, size * rate * record.v
            forces = [
                sum((c * term.force(x, v, closed=False)[0] for term, c in law.terms), np.zeros(x.shape[1]))
                for law in laws
            ]
            parts.append([[float(np.std(force - forces[0])), float(np.std(force))] for force in forces])
        gaps, sizes = np.linalg.norm(parts, axis=0).T
        return float(np.max(gaps[1:] / np.maximum(np.maximum(sizes[1:], sizes[0]), 1e-300)))

    name, most = max(((name, apart(*scales)) for name, scales in _PARTING.items()), key=lambda one: one[1])
    here = apart(1.0, 1.0)
    if most <= here or percent(most) == percent(here):
        return ""
    return f"{name}: there they differ by up to {percent(most)}, here by {percent(here)}"


def _law_terms(best: RecordLaw, covariance: FloatArray) -> tuple[LawTerm, ...]:
    """Terms with their strengths where the channels that they follow are zero, and what a unit of these adds."""
    terms = [term for term, _ in best.terms]
    at_zero = np.eye(len(terms))
    for k, term in enumerate(terms):
        if term.by:
            at_zero[terms.index(replace(term, by="", about=0.0)), k] = -term.about
    values = at_zero @ np.array([value for _, value in best.terms])
    stds = np.sqrt(np.maximum(np.diag(at_zero @ covariance @ at_zero.T), 0.0))
    return tuple(
        LawTerm(t.kind, tuple(p for p in (float(t.first), float(t.second)) if p), float(c), float(s), t.unit, t.by)
        for t, c, s in zip(terms, values, stds, strict=True)
    )


def _loops(records: SampledRecords[Any], best: RecordLaw) -> tuple[ForceLoop, ...]:
    """Missing force over the motion of a few parts, as it was measured and as the law has it."""
    result = []
    for number in np.unique(np.linspace(0, records.count - 1, 3).round().astype(int)):
        k, part = records.part_of[number]
        record = records.records[k]
        law = np.sum([c * record.force(term) for term, c in best.terms], axis=0)
        at, measured, std = record.force_at(part, best.fit.corrected[number])
        at, measured = at[:_DRAWN], measured[:_DRAWN]
        line = np.arange(at[0], at[-1] + 1, max(1, (at[-1] - at[0]) // _LINE))
        result.append(
            ForceLoop(
                int(number) + 1, tuple(record.x[0, at]), tuple(record.v[0, at]),
                tuple(measured), std, tuple(law[at]),
                tuple(tuple(values[line]) for values in (record.x[0], record.v[0], law)),
            )
        )  # fmt: skip
    return tuple(result)
