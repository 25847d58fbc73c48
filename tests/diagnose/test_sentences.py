"""What is said stands beside the model that the user has, and no sentence denies what a parameter did."""

from __future__ import annotations

import pytest

from nmt_diagnose.ledger.diagnosis import Gap, PlaceShare, Ranked, Recalibrated, Share, Verdict
from nmt_diagnose.say.sentences import sentences

GAP = Gap(86.37, 5.2, 1.0, 57.66, 0.94, 0.92, 0.96, {}, ("every second level",))


def spring(sigmas: float) -> Recalibrated:
    return Recalibrated("structure.springs_n_m.0", 210.0, 218.0, 8.0 / sigmas, "N/m", 0.05, sigmas)


def said(verdict: Verdict, *calibration: Recalibrated, effect: str = "cubic_stiffness", gap: Gap = GAP) -> str:
    head = Ranked(effect, "structure", "1", 0.99, (), {}, Share(0.94, 0.92, 0.96), 30.0)
    where, ranking = (PlaceShare("structure", "1", 1.0, 1.0),), (head,)
    return " ".join(sentences(verdict, where, ranking, None, gap, (), calibration))


def test_no_gap_names_parameters_that_moved_by_many_of_their_uncertainties() -> None:
    assert "need no change either" in said(Verdict.NONE, spring(4.0))
    text = said(Verdict.NONE, spring(7.0))
    assert "need no change" not in text
    assert "were off, by less than what matters: structure.springs_n_m.0 210 to 218" in text


def test_an_effect_is_told_beside_the_model_as_it_was_given() -> None:
    text = said(Verdict.EFFECT)
    assert (
        "57.66 with the model as given, 86.37 with its parameters re-fitted (which predicts worse), 5.20 with it added"
        in text
    )


def test_what_the_model_has_is_corrected_and_what_it_lacks_is_added() -> None:
    assert "adding it removes" in said(Verdict.EFFECT)
    assert "correcting it removes" in said(Verdict.EFFECT, effect="local_stiffness")
    assert "adding it removes" in said(Verdict.EFFECT, effect="local_stiffness + added_mass")


def test_places_of_two_effects_are_no_alternatives() -> None:
    head = Ranked("clamp_compliance + added_mass", "boundary + structure", "rotation + 6", 0.99, (), {}, None, 30.0)
    where = (PlaceShare("boundary", "rotation", 0.6, 0.52), PlaceShare("structure", "6", 0.4, 0.48))
    text = sentences(Verdict.EFFECT, where, (head,), None, GAP, (), ())[0]
    assert text.startswith("The gap lies in the clamping, rotation, and the structure, point 6 (probability ")
    assert "otherwise" not in text


def test_parameters_that_predict_worse_close_no_share_of_a_gap() -> None:
    worse = Gap(129.47, 324.56, 1.0, 129.47, -1.519, -1.55, -0.17, {}, ("every second level",))
    text = " ".join(sentences(Verdict.CALIBRATION, (), (), None, worse, (), (spring(7.0),)))
    assert "predicts data held out from the fit no better: 129.47 standard deviations rms before, 324.56 after" in text
    assert "closes" not in text


@pytest.mark.parametrize(
    ("ratios", "says"),
    [
        (
            (1.045, 1.0453, 1.0449, 1.0492),
            "All 4 modal masses changed by one factor, 1.046 ± 0.012: a force channel that",
        ),
        ((0.94, 0.938), "a force channel that reads 6.1 % too little, or responses that read 6.1 % too much"),
        ((1.045, 1.0, 1.0449, 1.0492), ""),
        ((1.01, 1.011, 1.009), ""),
        ((1.06,), ""),
    ],
)
def test_masses_that_change_by_one_factor_may_be_a_gain(ratios: tuple[float, ...], says: str) -> None:
    masses = (
        Recalibrated(f"structure.modes.{k}.modal_mass_kg", 0.8, 0.8 * ratio, 0.8 * 0.012, "kg", 0.05, 4.0)
        for k, ratio in enumerate(ratios)
    )
    text = said(Verdict.CALIBRATION, *masses)
    assert says in text
    assert ("one factor" in text) == bool(says)
