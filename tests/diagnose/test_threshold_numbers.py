"""Numbers that a decision hangs on, each just on either side of it; keys of local elements have a prior and a unit."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh

from nmt_core.errors import BenchError
from nmt_core.key_units import unit_of_key
from nmt_core.messages.blocks import Quantity
from nmt_core.tolerances import MODEL_PRIORS
from nmt_diagnose.chain.chain_columns import distorted
from nmt_diagnose.effects.calibration import mode_factors
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.locked_reading import phase_lean
from nmt_diagnose.measurements.measurement import LockedLevel
from nmt_diagnose.observations.channels.bag_samples import SampleStretch
from nmt_diagnose.observations.channels.plausibility import check_frequency, out_of_scale
from nmt_diagnose.observations.noise.settling import RATES, settling
from nmt_rig.model.local_elements.element import ElementSection
from nmt_rig.rig import load_rig
from nmt_rig.rig_model import build_structure

DIMENSIONLESS = ("exponent", "stiffness_ratio", "onset_ratio")
CHANNELS = (
    MeasuredChannel("f1", Quantity.FORCE, 1),
    *(MeasuredChannel(f"x{point}", Quantity.DISPLACEMENT, point) for point in (1, 2, 3)),
    MeasuredChannel("a1", Quantity.ACCELERATION, 1),
)


def left_out(measured: dict[str, float], expected: dict[str, float]) -> set[str]:
    """Channels whose size is taken for a wrong unit; those that are not named are 1."""
    cycles = np.arange(400) / 40.0
    data = np.array([measured.get(channel.name, 1.0) * np.cos(2.0 * np.pi * cycles) for channel in CHANNELS])
    stretch = SampleStretch(0, 400.0, CHANNELS, data, cycles, {}, math.nan)

    def responses(channels: Any, frequency_hz: Any, terms: Any) -> Any:
        return np.array([[expected.get(channel.name, 1.0) + 0j] * len(frequency_hz) for channel in channels])

    view: Any = SimpleNamespace(
        rig=SimpleNamespace(name="small"), frequencies_hz=(10.0,), responses=responses, voltages=lambda channels: ("",)
    )
    return out_of_scale("test", [(stretch, 10.0)], view, {channel.name: channel for channel in CHANNELS})[0]


def test_a_channel_that_is_far_too_large_has_a_wrong_unit() -> None:
    assert not left_out({"x3": 4.5}, {})
    assert left_out({"x3": 5.5}, {}) == {"x3"}


def test_a_force_may_be_further_from_the_model() -> None:
    assert not left_out({"f1": 27.0}, {})
    assert left_out({"f1": 33.0}, {}) == {"f1"}


def test_a_channel_near_a_node_says_nothing_of_its_unit() -> None:
    assert not left_out({"x3": 1.0}, {"x3": 0.09})
    assert left_out({"x3": 1.0}, {"x3": 0.11}) == {"x3"}


def test_a_frequency_that_is_far_from_all_modes_is_of_another_structure() -> None:
    view: Any = SimpleNamespace(rig=SimpleNamespace(name="small"), frequencies_hz=(10.0, 100.0))
    check_frequency("test", [15.5], view)
    with pytest.raises(BenchError, match=r"was locked at 16\.5 Hz"):
        check_frequency("test", [16.5], view)


def test_a_phase_that_drifts_leans_by_twice_its_change() -> None:
    time = (np.arange(10) + 0.5) / 10 - 0.5
    assert phase_lean(0.01 * time) == pytest.approx(0.02)


def test_the_form_of_a_transient_is_known_to_two_per_cent() -> None:
    time = (np.arange(10) + 0.5) / 10
    logs = np.outer(np.exp(-RATES[10] * time), [-0.006, -0.006])
    assert settling(logs, np.array([True, True])).doubt == pytest.approx(0.02, rel=0.02)


def test_a_drive_is_distorted_by_a_thousandth() -> None:
    level = LockedLevel(0, 1.0, 0.0, 0.0, 10.0, 0.0, 1.0, 0.0, 1, terms=((1.0,), (2.0j,)))
    assert distorted(level, 3, 1.0).terms == ((1.0, 0.0, 1e-3), (2.0j, 0.0, 2e-3j))


def test_modes_near_the_band_of_the_tests_have_dampings_of_their_own() -> None:
    rig = load_rig("beam")
    structure = build_structure(rig)
    squares = eigh(structure.stiffness, structure.mass, eigvals_only=True)
    lowest = math.sqrt(float(squares[0])) / (2.0 * math.pi)
    assert mode_factors(rig, 1.25 * lowest, 2.0 * lowest)[0].mode == 0
    assert not any(each.mode == 0 for each in mode_factors(rig, 1.35 * lowest, 8.0 * lowest))


def sections() -> list[type[ElementSection]]:
    """Every local element that harmonic balance covers."""
    found: list[type[ElementSection]] = []
    waiting = list(ElementSection.__subclasses__())
    while waiting:
        section = waiting.pop()
        waiting += section.__subclasses__()
        if "kind" in section.model_fields and not section.without_harmonic_balance:
            found.append(section)
    return found


@pytest.mark.parametrize("section", sections())
def test_each_key_of_a_local_element_has_a_prior_and_a_unit(section: type[ElementSection]) -> None:
    for key in set(section.own_keys()) - set(section.not_calibrated):
        assert key in MODEL_PRIORS, key
        assert (unit_of_key(key) == "1") == (key in DIMENSIONLESS), key
