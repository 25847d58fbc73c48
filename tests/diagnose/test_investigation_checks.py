"""Plain checks of what an investigation states, and recordings and records that tempt to it and are not it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.one_of_each_kind import MATTERS, locked_windows, rig_of_kinds

from nmt_core.kinds import RandomTest
from nmt_core.kinds.request import TestRequest
from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.investigation.checks import end_contradicted, ended_record, none_contradicted
from nmt_diagnose.investigation.investigation_record import AskedTest, InvestigationRecord, Turn
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.observations.observables import Part

NO_GAP = "No unmodelled effect is claimed."


def windows() -> tuple[Observations, FloatArray]:
    """Five levels, and what a model without a gap predicts of them."""
    found = locked_windows(rig_of_kinds())
    return found, found.values.copy()


def moved(found: Observations, part: Part, change: FloatArray, channel: int = -1) -> Observations:
    """The windows with a course over the levels, which are in their order."""
    rows = found.rows
    here = (rows.part == part) & (rows.channel == channel) & (np.abs(rows.harmonic) == 1)
    return replace(found, values=found.values + np.where(here, change[rows.level], 0.0))


@pytest.mark.court(said="none of an investigation")
def test_a_model_without_a_gap_is_not_contradicted() -> None:
    found, predicted = windows()
    assert none_contradicted(found, predicted, MATTERS) == ""


@pytest.mark.court(said="none of an investigation")
def test_scatter_and_what_does_not_matter_are_no_gap() -> None:
    """A frequency that scatters by more than what matters, one that moves by less, and a gain."""
    found, predicted = windows()
    scattered = moved(found, Part.LOG_FREQUENCY, 2e-3 * np.array([1.0, -1.0, 1.0, -1.0, 1.0]))
    assert none_contradicted(scattered, predicted, MATTERS) == ""
    small = moved(found, Part.LOG_FREQUENCY, 1e-4 * np.arange(5.0))
    assert none_contradicted(small, predicted, MATTERS) == ""
    gain = moved(found, Part.LOG_MAGNITUDE, np.full(5, 0.05), 1)
    assert none_contradicted(gain, predicted, MATTERS) == ""


@pytest.mark.court(not_said="none of an investigation")
@pytest.mark.parametrize(
    ("part", "channel", "words"),
    [(Part.LOG_FREQUENCY, -1, "the frequency moves by 1.6 %"), (Part.LOG_MAGNITUDE, 1, "the response of x1 moves by")],
)
def test_a_course_over_the_levels_is_no_lack_of_a_gap(part: Part, channel: int, words: str) -> None:
    """A spring that hardens, and friction: whatever noise a fit has learnt from them."""
    found, predicted = windows()
    liar = moved(found, part, (0.004 if channel < 0 else 0.02) * np.arange(5.0), channel)
    liar = replace(liar, std=100.0 * liar.std)
    assert words in none_contradicted(liar, predicted, MATTERS)


def record(ended: str, verdict: str, reached: float = 0.6, **changes: object) -> InvestigationRecord:
    """An investigation that ended so, with its bound in its conclusion."""
    levels = AskedTest("02_levels", TestRequest(levels=(0.1, reached)), "", "", state="measured", reached=reached)
    linear = AskedTest("01_linear", TestRequest(kind=RandomTest()), "", "", state="measured")
    turn = Turn(2, 40.0, 1.0, verdict, {"none": 0.97}, NO_GAP)
    made = InvestigationRecord(
        "beam", "real.yaml", tests=(linear, levels), turns=(turn,), plan=(0.1, 0.3, 0.6), ended=ended
    )
    return replace(made, **{"conclusion": f"{NO_GAP} {made.bound}".rstrip(), **changes})  # type: ignore[arg-type]


@pytest.mark.court(said="end of an investigation")
@pytest.mark.parametrize(
    ("ended", "verdict"),
    [
        ("named", "effect"), ("no_gap", "none"), ("recalibrated", "calibration"), ("unknown", "unknown"),
        ("unknown", "effect"), ("unknown", "none"), ("not_told_apart", "effect"), ("budget", "none"),
        ("stopped", "unknown"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("reached", [0.3, 0.6])
def test_ends_that_rest_on_their_diagnosis_stand(ended: str, verdict: str, reached: float) -> None:
    assert end_contradicted(record(ended, verdict, reached)) == ""


@pytest.mark.court(not_said="end of an investigation")
@pytest.mark.parametrize(
    ("liar", "words"),
    [
        (record("no_gap", "calibration"), "its last diagnosis says calibration"),
        (record("no_gap", "none", 0.3, conclusion=NO_GAP), "levels that were not measured nothing"),
        (record("named", "none"), "its last diagnosis says none"),
        (record("named", "effect", 0.3, conclusion=NO_GAP), "levels that were not measured nothing"),
        (record("budget", "none", 0.3, conclusion=NO_GAP), "levels that were not measured nothing"),
        (record("named", "effect", turns=()), "It rests on no diagnosis"),
        (record("no_gap", "none", turns=(Turn(1, 20.0, 1.0, "none", {}, NO_GAP),)), "knows 1 of 2 tests"),
    ],
)
def test_ends_that_their_own_record_contradicts_do_not(liar: InvestigationRecord, words: str) -> None:
    assert words in end_contradicted(liar)


def test_an_end_that_its_record_contradicts_is_unknown_and_says_why() -> None:
    made = record("", "none", 0.3, conclusion="")
    assert ended_record(made, "named", "It is a spring.").ended == "unknown"
    assert "its last diagnosis says none. It is a spring." in ended_record(made, "named", "It is a spring.").conclusion
    stands = ended_record(made, "no_gap", NO_GAP)
    assert (stands.ended, stands.conclusion) == ("no_gap", f"{NO_GAP} {made.bound}")
