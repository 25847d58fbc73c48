"""The law of a missing force, read from driven records: at every place, by what its force makes of the responses."""

from __future__ import annotations

import math

import numpy as np

from nmt_diagnose.law.reading import LawReading, nearly_as_well
from nmt_diagnose.law.record_law import reading_of
from nmt_diagnose.law.record_search import RecordLaw, RecordSearch, words_of
from nmt_diagnose.law.responding_record import RespondingRecords, moving
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig

_ROUNDS = 2  # along the motion that a law makes
_PLACES = 2  # at which more than one block is tried


def read_driven_law(rig: Rig, observations: Observations) -> LawReading | None:
    """The law of the force that the model lacks where measured forces drive; None without such a record.

    Args:
        rig: the model as given.
        observations: the real side.
    """
    every = RespondingRecords.at_places(rig, observations)
    if not every:
        return None
    searches = [] if isinstance(every, str) else [RecordSearch(records) for records in moving(every)]
    if not searches:
        name = " and ".join(
            test.name for test in observations.tests if test.record is not None and test.record.responses.size
        )
        why = "the channels of the record tell the motion of no place; put a sensor where the force may act"
        why, count = (every, 0) if isinstance(every, str) else (why, every[0].count)
        return LawReading(name, count, (), math.nan, math.nan, math.nan, math.nan, (why,), True)
    lacking = [search for search in searches if search.null.score >= THRESHOLDS.law.least_null_score]
    if not lacking:
        return reading_of(rig, searches[0], [])
    singles = [(search, law) for search in lacking if (law := search.single()) is not None]
    singles.sort(key=lambda one: one[1].score)
    if not singles:
        return reading_of(rig, lacking[0], [])
    tried: list[tuple[RecordSearch, list[RecordLaw]]] = []
    near = THRESHOLDS.law.place_score_ratio * max(singles[0][1].score, THRESHOLDS.law.least_null_score)
    for search, law in [one for one in singles if one[1].score <= near][:_PLACES]:
        moved = _along_its_motion(search, law)
        if found := moved.found():
            tried.append((moved, found))
    if not tried:
        return reading_of(rig, singles[0][0], [])
    least = THRESHOLDS.law.alike_score_ratio * min(found[0].score for _, found in tried)
    search, laws = min(
        (one for one in tried if one[1][0].score <= least), key=lambda one: (len(one[1][0].terms), one[1][0].score)
    )
    nearer = _along_its_motion(search, laws[0]) if laws[0].score > THRESHOLDS.law.least_null_score else search
    if nearer is not search and (again := nearer.found()) and again[0].score < laws[0].score:
        search, laws = nearer, again
    best = laws[0]
    everywhere = [(s.records, found) for s, found in tried]

    def other_places(words: str) -> tuple[str, ...]:
        return tuple(
            _name(records.place)
            for records, found in everywhere
            if records.place != search.records.place
            and any(nearly_as_well(law.score, best.score) and words_of(records, law) == words for law in found)
        )

    return reading_of(rig, search, laws, other_places)


def _along_its_motion(search: RecordSearch, law: RecordLaw) -> RecordSearch:
    """The search along the motion that a law makes, where the law leaves less along it.

    Without a sensor at the place, its motion under an unknown force is noisy; under a law it is the model's.
    Several blocks together would explain that noise.
    """
    for _ in range(_ROUNDS):
        if law.score <= THRESHOLDS.law.second_from_score or not law.terms:
            break
        records: RespondingRecords = search.records  # type: ignore[assignment]
        forces = [np.sum([c * record.force(term) for term, c in law.terms], axis=0) for record in records.records]
        again = RecordSearch(records.with_forces(forces))
        other = again.moved(law.blocks)
        if not other.score < law.score:
            break
        search, law = again, other
    return search


def _name(place: tuple[int, int]) -> str:
    point, other = place
    return f"{point}-{other}" if other else f"{point}"
