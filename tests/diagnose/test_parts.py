"""Everything that is said of a part of rows stands in its one row of facts."""

from __future__ import annotations

import math
from dataclasses import MISSING, fields

import numpy as np
import pytest

from nmt_diagnose.diagnosis_settings import MATTERS
from nmt_diagnose.ledger.size import SIZE_NAMES
from nmt_diagnose.observations.observables import HARMONICS, Natural, Part, PartFacts

FACTS = [entry.name for entry in fields(PartFacts)]
# Facts that may be empty, and what that says stands with the class.
MAY_BE_EMPTY = {"unit", "matters", "half", "stated", "title", "axis"}


def test_a_new_part_must_fill_each_fact() -> None:
    assert all(entry.default is MISSING and entry.default_factory is MISSING for entry in fields(PartFacts))
    for missing in FACTS:
        with pytest.raises(TypeError, match=missing):
            PartFacts(**{name: getattr(Part.DAMPING.facts, name) for name in FACTS if name != missing})


@pytest.mark.parametrize("part", Part)
def test_each_fact_says_something(part: Part) -> None:
    facts = part.facts
    for name in set(FACTS) - MAY_BE_EMPTY:
        assert getattr(facts, name) != "", name
    assert facts.factor > 0.0
    assert facts.matters in {*MATTERS, ""}
    assert (facts.natural is Natural.NONE) == (not facts.matters) == (not facts.excited)
    assert facts.natural is not Natural.NONE or not facts.smooth
    assert not facts.angle or (facts.unit, facts.axis) == ("deg", "°")
    assert not facts.logarithmic or facts.scaled
    # What can be foretold has an uncertainty to be foretold with.
    assert math.isnan(facts.typical_std) == (facts.natural in (Natural.RMS, Natural.NONE))
    assert np.isfinite(facts.drawn(np.array([0.1, 0.2]))).all()


def test_columns_are_unique_and_only_halves_of_a_harmonic_share_their_words() -> None:
    assert len({part.facts.column for part in Part}) == len(Part)
    words = [part.facts.words for part in Part if part not in HARMONICS]
    assert len({*words, Part.REAL.facts.words}) == len(Part) - 1
    assert Part.REAL.facts.words == Part.IMAG.facts.words


def test_every_kind_of_what_matters_has_parts_and_a_name() -> None:
    assert {part.facts.matters for part in Part} - {""} == set(MATTERS) == set(SIZE_NAMES)


def test_drawn_values_are_in_the_unit_of_the_axis() -> None:
    omega = 2.0 * math.pi * np.array([20.0, 30.0])
    assert Part.LOG_FREQUENCY.facts.drawn(np.log(omega)) == pytest.approx([20.0, 30.0])
    assert Part.DAMPING.facts.drawn(np.array([0.01])) == pytest.approx([1.0])
    assert Part.PHASE.facts.drawn(np.radians([170.0, -170.0])) == pytest.approx([170.0, 190.0])
