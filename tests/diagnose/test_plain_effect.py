"""Which effect leads where two may not explain a gap: one that closes most of it alone, or both."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import cast

import pytest
from diagnose.predicted_observations import chain, observations_of_model

from nmt_diagnose.effects.effect import Candidate
from nmt_diagnose.effects.library import candidates
from nmt_diagnose.effects.location import Location
from nmt_diagnose.fit.explanations import FittedExplanation
from nmt_diagnose.fit.fitting import FitResult
from nmt_diagnose.ledger.comparison import IMITATION, Comparison, EquivalentClass, by_plain_effect
from nmt_diagnose.ledger.gap import ClosedShare
from nmt_diagnose.ledger.size import Objection
from nmt_diagnose.prediction.operating_range import operating_range

MODEL = chain()
REMAINS = Objection("run: response", "response", 0.04)


@pytest.fixture(scope="module")
def library() -> dict[str, Candidate]:
    """The first candidate of each effect."""
    observations = observations_of_model(MODEL, seed=1, drives=(0.1, 0.4))
    operating = operating_range(MODEL, observations.tests, observations=observations)
    return {it.effect.name: it for it in reversed(candidates(MODEL, operating))}


def of(library: dict[str, Candidate], effects: str, probability: float, *against: Objection) -> EquivalentClass:
    found = FittedExplanation(tuple(library[name] for name in effects.split("+")), cast(FitResult, None))
    return EquivalentClass((found,), 0.0, probability, against)


def led(*closes: tuple[EquivalentClass, float], leaves_less: bool = False) -> tuple[str, float]:
    """Effects and probability of what leads, from classes, the most probable first, and what each closes.

    The first certainly leaves less than any other.
    """
    comparison = Comparison(0.0, 1.0, tuple(it for it, _ in closes), {}, 100.0, {})
    nan = math.nan
    shares = {it.head.explanation: ClosedShare(1.0, nan, 0.0, value, nan, nan) for it, value in closes}
    first = by_plain_effect(comparison, shares, lambda one, other: leaves_less).classes[0]
    return "+".join(first.head.explanation.effects), first.given_library


@pytest.mark.parametrize("against", [IMITATION, REMAINS])
@pytest.mark.parametrize("second", ["power_law_damping", "response_gain"])
@pytest.mark.parametrize(("alone", "leads"), [(0.91, 1), (0.79, 2)])
def test_what_closes_most_of_a_gap_alone_is_named_first(
    library: dict[str, Candidate], alone: float, leads: int, second: str, against: Objection
) -> None:
    two = of(library, f"cubic_stiffness+{second}", 0.9, against)
    one = of(library, "cubic_stiffness", 0.0, REMAINS)
    other = of(library, "quintic_stiffness", 0.1, REMAINS)
    effects, probability = led((two, 0.99), (other, 0.97), (one, alone))
    assert effects == ("cubic_stiffness" if leads == 1 else f"cubic_stiffness+{second}")
    assert probability == pytest.approx(0.9)  # that the effect acts, alone or beside another


@pytest.mark.parametrize(("alone", "leads"), [(0.5, 1), (0.4, 2)])
def test_of_two_that_are_not_the_gap_the_one_that_does_most_comes_nearest(
    library: dict[str, Candidate], alone: float, leads: int
) -> None:
    two = of(library, "cubic_stiffness+response_gain", 0.9, REMAINS)
    assert len(led((two, 0.56), (of(library, "cubic_stiffness", 0.1, REMAINS), alone))[0].split("+")) == leads


@pytest.mark.parametrize(("implausible", "leads"), [((), 1), ((1,), 2), ((2,), 1), ((1, 2), 1)])
def test_an_effect_that_needs_an_implausible_chain_does_not_lead_two_that_need_none(
    library: dict[str, Candidate], implausible: tuple[int, ...], leads: int
) -> None:
    """Its size is wrong by the gain that it needs, however much it closes."""
    two = of(library, "cubic_stiffness+power_law_damping", 0.9, IMITATION)
    one = of(library, "cubic_stiffness", 0.0)
    nan = math.nan
    shares = {it.head.explanation: ClosedShare(1.0, nan, 0.0, 0.99, nan, nan) for it in (two, one)}
    first = by_plain_effect(
        Comparison(0.0, 1.0, (two, one), {}, 100.0, {}), shares, lambda *_: False,
        lambda found: len(found.candidates) in implausible,
    ).classes[0]  # fmt: skip
    assert len(first.head.candidates) == leads


def test_two_effects_that_explain_everything_stay_together(library: dict[str, Candidate]) -> None:
    two = of(library, "cubic_stiffness+response_gain", 1.0)
    assert led((two, 0.995), (of(library, "cubic_stiffness", 0.0, REMAINS), 0.98))[0] == "cubic_stiffness+response_gain"


@pytest.mark.parametrize(("alone", "leads"), [(0.985, 1), (0.97, 2)])
def test_one_effect_that_leaves_noise_leads_where_it_closes_as_much(
    library: dict[str, Candidate], alone: float, leads: int
) -> None:
    two = of(library, "cubic_stiffness+power_law_damping", 1.0, IMITATION)
    effects, probability = led((two, 0.99), (of(library, "cubic_stiffness", 0.0), alone))
    assert len(effects.split("+")) == leads
    assert probability == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("second", "against", "leaves_less", "leads"),
    [
        ("power_law_damping", IMITATION, True, 2),
        ("power_law_damping", IMITATION, False, 1),
        ("power_law_damping", REMAINS, True, 1),
        ("quintic_stiffness", IMITATION, True, 1),
    ],
)
@pytest.mark.parametrize("alone", [(0.95, (REMAINS,)), (0.985, ())])
def test_two_laws_at_two_places_stay_together_where_they_certainly_leave_less(
    library: dict[str, Candidate], second: str, against: Objection, leaves_less: bool, leads: int,
    alone: tuple[float, tuple[Objection, ...]],
) -> None:  # fmt: skip
    """Two at one place may imitate one that the library lacks, and two that leave something are not the gap."""
    here = library["cubic_stiffness"].site.location
    places = {"power_law_damping": Location.at("structure", here.points[0] + 1)}
    other = library[second]
    moved = replace(other, site=replace(other.site, location=places.get(second, here)))
    found = FittedExplanation((library["cubic_stiffness"], moved), cast(FitResult, None))
    two = EquivalentClass((found,), 0.0, 1.0, (against,))
    one = of(library, "cubic_stiffness", 0.0, *alone[1])
    assert two.of_two_places == (second == "power_law_damping" and against == IMITATION)
    assert len(led((two, 0.99), (one, alone[0]), leaves_less=leaves_less)[0].split("+")) == leads
