"""A secondary resonance from the backbone of the primary mode, against an independent harmonic balance."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from independent.harmonic_continuation import CubicModes, PhaseBranch, Solution
from pll.secondary_rig import FORCE, LENGTH, OMEGA, at_force

from nmt_core.errors import BenchError
from nmt_core.messages.secondary_resonance import resonance_named
from nmt_extract.synthesis.secondary_resonance import SecondarySynthesis, secondary_csv
from nmt_extract.synthesis.single_mode import SynthesisedBackbone

ONE = np.array([1.0])


@cache
def synthesis() -> SecondarySynthesis:
    """From the phase-resonant backbone of the shipped rig, as a balance has it."""
    system = CubicModes(ONE, np.array([0.01]), ONE, ONE, 1.0, 9)
    series = np.zeros((system.orders.size, 1), complex)
    series[0, 0] = -0.05j
    branch = PhaseBranch(system, 90.0, 1.0)
    found = branch.follow(Solution(series, 1.0, 0.001), 0.4, lambda item: abs(item.series[0, 0]) > 3.0)
    q = np.array([abs(item.series[0, 0]) for item in found])
    omega = np.array([item.omega_b for item in found])
    damping = np.array([item.force for item in found]) / (2.0 * omega**2 * q)
    backbone = SynthesisedBackbone(q * LENGTH, omega * OMEGA, damping, np.ones((q.size, 1), complex), (1,))
    return SecondarySynthesis(backbone, 1.0, OMEGA)


def test_the_hardening_is_that_of_the_spring():
    assert synthesis().hardening == pytest.approx(0.75 * OMEGA**2 / LENGTH**2, rel=0.02)


@pytest.mark.parametrize(("force", "frequency", "amplitude"), [(0.6, 0.02, 0.03), (1.0, 0.02, 0.03)])
def test_tip_and_lower_end_of_the_isola_are_near_those_of_the_balance(force, frequency, amplitude):
    found = synthesis().solve(resonance_named("1:3"), force * FORCE)
    balance = at_force("1:3", force)
    assert found.modal_amplitude.size == len(balance) == 2
    for a, f, solution in zip(found.modal_amplitude, found.excitation_hz, balance, strict=True):
        assert a / LENGTH == pytest.approx(abs(solution.series[0, 0]), rel=amplitude)
        assert f == pytest.approx(3.0 * solution.omega_b * OMEGA / (2.0 * math.pi), rel=frequency)
    assert found.curve_amplitude.max() <= found.modal_amplitude[0]
    assert found.curve_amplitude.min() >= found.modal_amplitude[1]
    assert found.curve_hz.size == found.curve_amplitude.size > 100


@pytest.mark.parametrize(("force", "frequency", "amplitude"), [(0.3, 0.005, 0.05), (0.5, 0.02, 0.08), (1.0, 0.04, 0.1)])
def test_the_superharmonic_resonance_is_near_that_of_the_balance(force, frequency, amplitude):
    found = synthesis().solve(resonance_named("3:1"), force * FORCE)
    (solution,) = at_force("3:1", force)
    assert found.modal_amplitude[0] / LENGTH == pytest.approx(abs(solution.series[1, 0]), rel=amplitude)
    assert found.excitation_hz[0] == pytest.approx(solution.omega_b * OMEGA / (2.0 * math.pi), rel=frequency)


def test_below_its_least_force_there_is_no_isola():
    found = synthesis().solve(resonance_named("1:3"), 0.4 * FORCE)
    assert found.modal_amplitude.size == 0
    assert found.curve_hz.size == 0


def test_the_table_has_tip_end_and_isola_of_each_force():
    lines = secondary_csv(synthesis(), resonance_named("1:3"), [0.4 * FORCE, 0.6 * FORCE]).splitlines()
    assert lines[0] == "force_n,place,modal_amplitude,drive_point_m,excitation_hz"
    places = [line.split(",")[1] for line in lines[1:]]
    assert places[:2] == ["tip", "end"]
    assert set(places[2:]) == {"isola"}


def test_what_does_not_harden_is_refused():
    q = np.array([1.0, 2.0])
    soft = SynthesisedBackbone(q, np.array([10.0, 9.0]), np.array([0.01, 0.01]), np.ones((2, 1), complex), (1,))
    with pytest.raises(BenchError, match="does not grow with the amplitude"):
        SecondarySynthesis(soft, 1.0, 10.0)
    with pytest.raises(BenchError, match="force above 0 N"):
        synthesis().solve(resonance_named("1:3"), 0.0)
