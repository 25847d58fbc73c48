"""What a diagnosis says of recordings that bear it out, and of those that tempt to it and are something else."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from diagnose.court.small_rigs import backbone, chain_rig, chain_tables, diagnosed, one_mode_rig
from tiers import with_quick

from nmt_diagnose.ledger.diagnosis import Diagnosis, Verdict

CUBIC, DRAG = 3e9, 20.0


@cache
def of_one_mode(**course: float) -> Diagnosis:
    return diagnosed(one_mode_rig(), backbone(21, **course))


def first_effect(found: Diagnosis) -> str:
    return found.ranking[0].effect if found.ranking else ""


@pytest.mark.court(said="calibration")
@pytest.mark.parametrize("course", [{"stiffer": 1.02}, {"damped": 1.5}])
def test_a_parameter_that_was_off_is_told_as_such(course: dict[str, float]) -> None:
    found = of_one_mode(**course)
    assert found.verdict is Verdict.CALIBRATION
    values = {moved.name.rsplit(".", 1)[1]: moved.to for moved in found.calibration}
    assert values["frequency_hz"] == pytest.approx(50.0 * np.sqrt(course.get("stiffer", 1.0)), rel=1e-3)
    omega = np.sqrt(course.get("stiffer", 1.0))
    assert values["damping_ratio"] == pytest.approx(0.004 * course.get("damped", 1.0) / omega, rel=0.02)


@pytest.mark.court(not_said="calibration")
@pytest.mark.parametrize("course", with_quick([{}, {"cubic": CUBIC}, {"drag": DRAG}], {}))
def test_a_parameter_that_is_right_was_not_off(course: dict[str, float]) -> None:
    """A stiffness and a damping that grow with the amplitude have a mean, too."""
    found = of_one_mode(**course)
    assert found.verdict is (Verdict.EFFECT if course else Verdict.NONE)


@pytest.mark.court(said="second effect")
@pytest.mark.parametrize(("cubic", "drag"), with_quick([(CUBIC, DRAG), (0.5 * CUBIC, 2.0 * DRAG)], (CUBIC, DRAG)))
def test_of_two_effects_both_are_named(cubic: float, drag: float) -> None:
    found = of_one_mode(cubic=cubic, drag=drag)
    assert found.verdict is Verdict.EFFECT
    both = next(it for it in found.ranking if " + " in it.effect)
    assert "cubic_stiffness" in both.effect
    assert any("air_drag" in name for name in (both.effect, *both.equivalents))
    assert both.parameters["cubic_stiffness@1.k"].value == pytest.approx(cubic, rel=0.1)
    assert any(
        "cubic stiffness" in sentence and ("drag" in sentence or "damping" in sentence) for sentence in found.sentences
    )


@pytest.mark.court(not_said="second effect")
@pytest.mark.parametrize(
    "course",
    with_quick([{"cubic": CUBIC, "damped": 1.2}, {"drag": DRAG, "stiffer": 1.01}], {"drag": DRAG, "stiffer": 1.01}),
)
def test_a_parameter_beside_an_effect_is_no_second_one(course: dict[str, float]) -> None:
    found = of_one_mode(**course)
    assert found.verdict is Verdict.EFFECT
    assert " + " not in first_effect(found)


@pytest.mark.court(said="closed")
@pytest.mark.parametrize("course", with_quick([{"cubic": CUBIC}, {"drag": DRAG}], {"drag": DRAG}))
def test_the_cause_closes_the_gap(course: dict[str, float]) -> None:
    assert of_one_mode(**course).gap.closed > 0.97


@pytest.mark.court(not_said="closed")
@pytest.mark.parametrize("course", [{}, {"wave": 0.02}])
def test_no_share_is_closed_where_there_is_no_gap_or_no_cause(course: dict[str, float]) -> None:
    found = of_one_mode(**course)
    assert not found.gap.closed > 0.8


@pytest.mark.court(said="adequate", not_said="partial")
@pytest.mark.parametrize("course", with_quick([{"cubic": CUBIC}, {"drag": DRAG}], {"drag": DRAG}))
def test_a_cause_that_is_all_is_the_whole(course: dict[str, float]) -> None:
    found = of_one_mode(**course)
    assert found.verdict is Verdict.EFFECT
    assert found.adequate
    assert found.ranking[0].adequate


@pytest.mark.court(not_said="adequate")
@pytest.mark.parametrize(
    "course",
    with_quick(
        [{"cubic": 2.0 * CUBIC, "wave": 0.01}, {"drag": 2.0 * DRAG, "losses": 0.15}],
        {"drag": 2.0 * DRAG, "losses": 0.15},
    ),
)
def test_a_cause_beside_something_unnamed_is_not_the_whole(course: dict[str, float]) -> None:
    assert not of_one_mode(**course).adequate


@pytest.mark.court(said="partial")
@pytest.mark.parametrize("losses", with_quick([0.1, 0.15], 0.15))
def test_a_cause_beside_something_unnamed_is_a_part(losses: float) -> None:
    found = of_one_mode(drag=2.0 * DRAG, losses=losses)
    assert found.verdict is Verdict.EFFECT
    assert not found.adequate
    assert "air_drag" in (found.ranking[0].effect, *found.ranking[0].equivalents)
    assert found.gap.closed > 0.8


@pytest.mark.court(said="unknown", not_said="partial")
@pytest.mark.parametrize("course", with_quick([{"wave": 0.02}, {"losses": 0.3}], {"wave": 0.02}))
def test_a_course_that_no_law_makes_is_unknown_and_has_no_place(course: dict[str, float]) -> None:
    found = of_one_mode(**course)
    assert found.verdict is Verdict.UNKNOWN
    assert found.gap.bridged < 0.1
    assert found.where == ()
    assert "Where the gap lies could not be told." in found.sentences


@pytest.mark.court(not_said="unknown")
@pytest.mark.parametrize(
    "course",
    with_quick([{"stiffer": 1.02, "stated": 0.5}, {"cubic": CUBIC, "stated": 0.5}], {"stiffer": 1.02, "stated": 0.5}),
)
def test_an_uncertainty_that_is_stated_too_small_is_nothing_unknown(course: dict[str, float]) -> None:
    assert of_one_mode(**course).verdict is not Verdict.UNKNOWN


@pytest.mark.court(said="faulty channel")
@pytest.mark.parametrize("gain", [1000.0, -1.0, 9.81])
def test_a_channel_of_another_unit_or_sign_is_named(gain: float) -> None:
    found = diagnosed(chain_rig(), chain_tables(32, 1.0, (1.0, gain, 1.0)))
    assert found.verdict is Verdict.UNKNOWN
    assert "a2" in found.sentences[0]


@pytest.mark.campaign
@pytest.mark.court(not_said="faulty channel")
@pytest.mark.parametrize("stiffer", with_quick([0.97, 1.03], 1.03))
def test_another_stiffness_is_no_faulty_channel(stiffer: float) -> None:
    found = diagnosed(chain_rig(), chain_tables(33, stiffer=stiffer))
    assert found.verdict is Verdict.CALIBRATION
    assert not any("times what the model predicts" in sentence for sentence in found.sentences)


@pytest.mark.court(said="delay")
@pytest.mark.parametrize("channel", with_quick([2, 3], 2))
def test_a_late_channel_is_named_with_its_delay(channel: int) -> None:
    late = [0.0, 0.0, 0.0]
    late[channel - 1] = 3e-3
    found = diagnosed(chain_rig(), chain_tables(34, late=late))
    assert found.verdict is Verdict.EFFECT
    leader = found.ranking[0]
    assert "channel_skew" in (leader.effect, *leader.equivalents)
    assert f"a{channel}" in leader.detail


@pytest.mark.campaign
@pytest.mark.court(not_said="delay")
@pytest.mark.parametrize("gains", [(1.0, np.exp(-0.3j), 1.0), (1.0, 1.2, 1.0)])
def test_a_phase_or_a_size_that_does_not_grow_with_frequency_is_no_delay(gains: tuple[complex, ...]) -> None:
    found = diagnosed(chain_rig(), chain_tables(35, gains=gains))
    assert found.verdict is Verdict.UNKNOWN or "channel_skew" not in first_effect(found)


@pytest.mark.campaign
@pytest.mark.court(said="place")
@pytest.mark.parametrize("place", [2, 3])
def test_a_spring_is_placed_by_responses_of_all_modes(place: int) -> None:
    found = diagnosed(chain_rig(), chain_tables(36, cubic=2e6, place=place))
    leader = found.ranking[0]
    assert (leader.effect, leader.detail) == ("cubic_stiffness", str(place))
    assert leader.places[str(place)] > 0.95
    assert leader.parameters["k"].value == pytest.approx(2e6, rel=0.1)


@pytest.mark.campaign
@pytest.mark.court(not_said="place")
@pytest.mark.parametrize("place", [2, 3])
def test_about_one_mode_more_than_one_place_is_named(place: int) -> None:
    """A spring at one point does there what one at another does."""
    found = diagnosed(chain_rig(), chain_tables(37, cubic=2e6, place=place, band=(8.0, 10.0)))
    assert found.verdict is Verdict.EFFECT
    assert max(found.ranking[0].places.values()) < 0.95
    assert found.ranking[0].places.get(str(place), 0.0) > 0.05


@pytest.mark.campaign
@pytest.mark.court(said="second effect")
@pytest.mark.parametrize(
    "seed",
    [24, 38],
)
def test_a_spring_and_a_gain_are_both_named(seed: int) -> None:
    found = diagnosed(chain_rig(), chain_tables(seed, gains=(1.0, 1.0, 1.2), cubic=2e6, place=2))
    assert found.ranking[0].effect == "cubic_stiffness + response_gain"
    assert "a3" in found.ranking[0].detail


@pytest.mark.campaign
@pytest.mark.court(not_said="second effect")
def test_ordinary_gains_beside_a_spring_are_no_second_effect() -> None:
    found = diagnosed(chain_rig(), chain_tables(39, gains=(1.01, 0.99, 1.0), cubic=2e6, place=2))
    assert found.ranking[0].effect == "cubic_stiffness"
