"""What settles is waited for, what swings or runs away is given up in seconds."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from nmt_pll.phase_loop import prospect
from nmt_pll.phase_loop.prospect import Prospect
from nmt_pll.thresholds import CURVE

DECAY, DWELL, STEP = 1.25, 0.5, 0.01


def given_up(share, deadline: float = 120.0) -> float:
    """Second at which a course of the share over time is given up; infinite where it locks before."""
    course = Prospect(DECAY, DWELL)
    for k in range(round(deadline / STEP)):
        if share(k * STEP) <= 1.0:
            return math.inf
        if course.is_hopeless(share(k * STEP), k * STEP, deadline):
            return k * STEP
    return math.inf


def settling(t: float, rate: float = 0.3) -> float:
    return 200.0 * math.exp(-rate * DECAY * t)


def swinging(t: float) -> float:
    return 8.0 + 6.0 * math.sin(2.0 * t)


def creeping(t: float) -> float:
    return 200.0 * math.exp(-0.1 * t)


@pytest.mark.parametrize("rate", [0.1, 0.3, 1.0])
def test_what_settles_is_waited_for(rate):
    assert given_up(lambda t: settling(t, rate)) == math.inf


@pytest.mark.parametrize("share", [swinging, lambda t: 50.0, lambda t: 2.5 * math.exp(0.1 * t)])
def test_what_swings_or_runs_away_is_given_up_in_seconds(share):
    assert given_up(share) < 15.0


def test_what_comes_too_late_is_given_up_as_well():
    assert given_up(creeping, 30.0) < 15.0
    assert given_up(creeping, 400.0) == math.inf


def test_noise_about_the_limits_is_no_trend():
    assert given_up(lambda t: 1.5 + 0.3 * math.sin(40.0 * t)) == math.inf


CASES = {
    "prospect_decays": (0.2, swinging, False),
    "prospect_spans": (2, lambda t: 100.0 if t < 8.0 else 100.0 * math.exp(-t + 8.0), True),
    "prospect_fall": (0.6, lambda t: settling(t, 0.1), True),
    "prospect_near": (0.1, lambda t: 1.5 + 0.3 * math.sin(40.0 * t), True),
}


@pytest.mark.parametrize("name", sorted(CASES))
def test_a_threshold_decides(name, monkeypatch):
    value, share, sooner = CASES[name]
    before = given_up(share)
    monkeypatch.setattr(prospect, "CURVE", replace(CURVE, **{name: value}))
    assert given_up(share) < before if sooner else given_up(share) != before
