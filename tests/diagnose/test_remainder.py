"""What an accepted explanation leaves of the gap, and how that is said."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnose.predicted_observations import chain, observations_of_model
from diagnose.test_warnings import GAP

from nmt_diagnose.ledger.diagnosis import PlaceShare, Ranked, Remainder, Share, Value, Verdict
from nmt_diagnose.ledger.judgement import Judgement
from nmt_diagnose.ledger.size import IMITATION, Objection
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.say.remainder import remainder
from nmt_diagnose.say.sentences import sentences

LEFT = replace(GAP, closed=0.94, low=0.9, high=0.97)


@pytest.fixture(scope="module")
def observations() -> Observations:
    return observations_of_model(chain(), random=False, drives=np.linspace(0.1, 1.6, 9))


def left_in(observations: Observations, part: Part, above: float) -> np.ndarray:
    """Residuals of noise, ten times as large in a part of the rows at the levels above one."""
    noise = np.random.default_rng(2).standard_normal(len(observations.rows))
    return np.where((observations.rows.part == part) & (observations.rows.amplitude > above), 10.0, 1.0) * noise


def test_what_is_left_is_found_where_it_is(observations: Observations) -> None:
    found = remainder(observations, LEFT, left_in(observations, Part.LOG_FREQUENCY, 1.2))
    assert found is not None
    assert (found.share, found.low, found.high) == pytest.approx((0.06, 0.03, 0.1))
    first = found.where[0]
    assert first.observable.endswith(": frequency")
    assert first.levels == "highest levels"
    assert first.share > 0.5 > sum(item.share for item in found.where[1:])
    frequency = observations.rows.part == Part.LOG_FREQUENCY
    left = left_in(observations, Part.LOG_FREQUENCY, 1.2)[frequency]
    assert first.rms == pytest.approx(np.sqrt(np.mean(left**2)))
    assert first.rms_unit == pytest.approx(100.0 * np.sqrt(np.mean((left * observations.sigma[frequency]) ** 2)))


def test_rows_that_no_split_held_out_do_not_count(observations: Observations) -> None:
    left = left_in(observations, Part.LOG_FREQUENCY, 1.2)
    found = remainder(observations, LEFT, np.where(observations.rows.part == Part.LOG_FREQUENCY, np.nan, left))
    assert found is not None
    assert not any(item.observable.endswith(": frequency") for item in found.where)


@pytest.mark.parametrize("closed", [0.995, 1.0, math.nan])
def test_less_than_a_percent_is_not_told(observations: Observations, closed: float) -> None:
    assert remainder(observations, replace(LEFT, closed=closed), np.zeros(len(observations.rows))) is None


def test_of_noise_nothing_is_left(observations: Observations) -> None:
    """What the uncertainties allow without the explanation is not a gap that it could leave."""
    weak = replace(LEFT, before=0.9, after=0.8, closed=0.3)
    assert remainder(observations, weak, left_in(observations, Part.LOG_FREQUENCY, 1.2)) is None
    ranked = Ranked("clipping", "force_sensor", "f1", 0.9, (), {}, Share(0.3, 0.1, 0.5), 9.0)
    said = sentences(Verdict.EFFECT, (), (ranked,), None, weak, (), ())[2]
    assert "The uncertainties of the held-out data allow 1, so they hardly show it." in said


def test_the_answer_says_how_much_is_left_and_where(observations: Observations) -> None:
    rest = remainder(observations, LEFT, left_in(observations, Part.LOG_FREQUENCY, 1.2))
    ranked = Ranked(
        "cubic_stiffness", "structure", "2", 0.95, (), {"k": Value(1.0, 0.1, "N/m³")}, Share(0.94, 0.9, 0.97), 9.0
    )

    def said(of: Remainder | None) -> str:
        where = (PlaceShare("structure", "2", 1.0, 1.0),)
        return sentences(Verdict.EFFECT, where, (ranked,), None, LEFT, (), (), of)[2]

    assert "It explains 94 %; 6 % is left, most of it in levels: frequency at the highest levels" in said(rest)
    assert "left" not in said(None)


def test_what_leaves_more_than_noise_is_a_partial_explanation() -> None:
    share = Share(0.94, 0.9, 0.97)
    left = (Objection("levels: frequency", "frequency", 0.004),)

    def said(p: float, adequate: bool = True) -> str:
        head = Ranked("air_drag", "structure", "2", p, (), {}, share, 9.0, adequate=adequate)
        return sentences(Verdict.EFFECT, (), (head,), None, LEFT, (), (), None, () if adequate else left)[1]

    told = {p: said(p) for p in (0.95, 0.5)}
    assert told[0.95].startswith("The cause is air drag")
    assert told[0.5].startswith("The most probable cause is air drag")
    assert said(0.7, adequate=False) == (
        "94.0 % of the gap acts like air drag, probability 70 % among the effects of the library; 0.4 % of the "
        "frequency (levels: frequency) remain that it does not explain, so something unnamed acts too."
    )


@pytest.mark.parametrize(("p", "part"), [(0.0, True), (0.33, True), (0.6, False)])
def test_a_cause_less_likely_than_something_unnamed_is_a_part(p: float, part: bool) -> None:
    """A cause that closes nearly all is stated next to an unnamed one, and never as the whole at a probability of 0."""
    head: Any = SimpleNamespace(adequate=True, probability=p)
    comparison: Any = SimpleNamespace(classes=(head,), unknown=0.4)
    unused: Any = None
    assert Judgement(unused, comparison, {}, unused, Verdict.EFFECT).partial is part


def test_two_laws_are_told_as_what_they_imitate() -> None:
    """Nothing is left that would have to be explained: the sentence says why it is a likeness."""
    head = Ranked(
        "one_sided_stop + second_friction_contact", "structure", "2", 0.99, (), {}, Share(0.98, 0.9, 1.0), 9.0,
        adequate=False,
    )  # fmt: skip
    text = sentences(Verdict.EFFECT, (), (head,), None, LEFT, (), (), None, (IMITATION,))[1]
    assert "acts like one-sided stop + friction contact" in text
    assert text.endswith("; two laws together can imitate one that the library lacks.")
