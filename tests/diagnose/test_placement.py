"""Placements and explanations compare by what they mean, and their labels are made from them."""

from __future__ import annotations

import pytest
from diagnose.predicted_tests import chain, level, locked

from nmt_diagnose.effects.library import candidates
from nmt_diagnose.effects.location import Cause, Explanation, Location
from nmt_diagnose.prediction.operating_range import operating_range

AT_2 = Cause("cubic_stiffness", Location.at("structure", 2))
BETWEEN = Cause("cubic_stiffness", Location.at("structure", 2, 3))
GAIN = Cause("response_gain", Location.on_channel("response_sensor", "a2", 2))
HUM = Cause("mains_hum", Location.on_channel("response_sensor", "a2", 2, mains_hz=60.0))
ACROSS = Cause("transverse_sensitivity", Location.on_channel("response_sensor", "a2", 2, picked_up=3))
OFFSET = Cause("phase_offset", Location("controller"))


@pytest.mark.parametrize(
    ("cause", "label"),
    [
        (AT_2, "cubic_stiffness@2"),
        (BETWEEN, "cubic_stiffness@2-3"),
        (GAIN, "response_gain@a2"),
        (HUM, "mains_hum@a2 at 60 Hz"),
        (ACROSS, "transverse_sensitivity@a2<3"),
        (OFFSET, "phase_offset"),
    ],
)
def test_labels(cause: Cause, label: str) -> None:
    assert cause.label == label


def test_explanations_are_equal_whatever_was_found_first() -> None:
    one, other = Explanation((AT_2, GAIN)), Explanation((GAIN, AT_2))
    assert one == other
    assert hash(one) == hash(other)
    assert {one: 1.0}[other] == 1.0
    assert one != Explanation((AT_2,)) != Explanation((BETWEEN,))
    assert Explanation() == Explanation(()) != Explanation((OFFSET,))
    # The order shows in the label only.
    assert (one.label, other.label) == ("cubic_stiffness@2 + response_gain@a2", "response_gain@a2 + cubic_stiffness@2")
    assert one.effects == other.effects == ("cubic_stiffness", "response_gain")
    assert one.kinds == "structure + response_sensor"
    assert Explanation().label == "none"


def test_a_channel_of_force_lies_at_the_force_sensor_and_no_two_candidates_are_one() -> None:
    rig = chain()
    found = candidates(rig, operating_range(rig, [locked(rig, [level(0.5, 24.0)], "x1")[0]]))
    assert len({candidate.cause for candidate in found}) == len(found)
    force = {channel for s in rig.sensors if s.quantity == "force" for channel in (rig.sensor_channel(s),)}
    for candidate in found:
        channel = candidate.site.location.channel
        if channel:
            kind = "force_sensor" if channel in force else "response_sensor"
            assert candidate.site.location.kind == kind, candidate.label
