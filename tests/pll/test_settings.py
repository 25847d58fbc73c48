"""Loop settings: refusals, derived values, parameter table."""

from __future__ import annotations

import math
from dataclasses import fields

import pytest

from nmt_core.errors import BenchError
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.settings import parameters_of
from nmt_pll.loop_settings import SIGNED_SETTINGS, LoopSettings, settings_from

LINEAR = LinearDescription("test", 2, 1, (2,), (100.0, 700.0), (0.01, 0.02), ((1.0, 2.0),), 2.0, 690.0, 0.05, 0.04)


@pytest.mark.parametrize("name", sorted({item.name for item in fields(LoopSettings)} - SIGNED_SETTINGS))
@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0])
def test_every_setting_must_be_finite_and_not_negative(name, value):
    with pytest.raises(BenchError, match=f"^PLL setting '{name}' must be finite and not negative, got"):
        settings_from({name: value})


@pytest.mark.parametrize("name", sorted(SIGNED_SETTINGS))
def test_what_the_loop_holds_may_be_negative_but_must_be_finite(name):
    assert getattr(settings_from({name: -0.1}), name) == -0.1
    with pytest.raises(BenchError, match=f"^PLL setting '{name}' must be finite, got"):
        settings_from({name: math.nan})


@pytest.mark.parametrize("name", ["phase_tolerance", "dwell_periods", "unlock_tolerance", "quiet_ramp", "delay_margin"])
def test_some_settings_must_be_positive(name):
    with pytest.raises(BenchError, match=f"^PLL setting '{name}' must be positive"):
        settings_from({name: 0.0})


@pytest.mark.parametrize(("low", "high"), [(1.0, 1.1), (0.4, 1.0), (2.0, 3.0)])
def test_the_guard_band_must_contain_the_mode(low, high):
    with pytest.raises(BenchError, match="guard band must contain the target mode"):
        settings_from({"guard_low": low, "guard_high": high})


@pytest.mark.parametrize("gains", [{"proportional": 1.0}, {"integral": 1.0}])
def test_fixed_gains_come_in_pairs(gains):
    with pytest.raises(BenchError, match="both fixed PLL gains"):
        settings_from(gains)


def test_an_unknown_setting_is_named_with_the_known_ones():
    with pytest.raises(BenchError, match=r"'cutof' is not known; known are .*cutoff, .*voltage_limit\.$"):
        settings_from({"cutof": 1.0})


def test_cutoff_follows_the_target_mode_unless_given():
    assert LoopSettings().resolved_cutoff(LINEAR) == pytest.approx(0.15 * 700.0)
    assert LoopSettings(cutoff=33.0).resolved_cutoff(LINEAR) == 33.0


def test_parameters_are_the_settings():
    table = parameters_of(LoopSettings)
    assert [item.name for item in table] == [item.name for item in fields(LoopSettings)]
    assert {"phase_offset_rad", "loop_latency_s"} == SIGNED_SETTINGS
    assert all(item.description.endswith(".") for item in table)
