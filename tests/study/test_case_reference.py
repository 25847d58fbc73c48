from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nmt_core.errors import BenchError
from nmt_rig.reference import compute_reference, single_point_reference
from nmt_rig.rig import load_rig
from nmt_study.case import JOINT_KEY, StudyCase
from nmt_study.case_reference import epmc_at, fold_intervals, levels_for_amplitudes, single_point_at


@pytest.mark.parametrize("point", [2, 6])
def test_levels_reach_the_amplitudes_asked_for(point):
    wanted = np.geomspace(4e-5, 5e-4, 4)
    levels = levels_for_amplitudes((), point, wanted)
    reached = single_point_reference(load_rig("beam"), point, levels).mode.modal_amplitude
    np.testing.assert_allclose(reached, wanted, rtol=5e-3)


def test_amplitudes_out_of_reach_are_refused():
    with pytest.raises(BenchError, match="does not reach"):
        levels_for_amplitudes((), 2, [1e-5, 10.0])


def test_references_of_a_case_are_those_of_its_rig():
    case = StudyCase("x", "x", 4, (0.9, 0.5, 0.9), harmonics=5)
    single = single_point_at(case)
    direct = single_point_reference(load_rig("beam"), 4, [0.5, 0.9], harmonics=5).mode
    assert single["levels"]["omega_rad_s"] == pytest.approx(direct.omega_rad_s[[1, 0, 1]], rel=1e-8)
    assert single["levels"]["damping_ratio"] == pytest.approx(direct.damping_ratio[[1, 0, 1]], rel=1e-7)
    q = [1e-4, 3e-4]
    epmc = epmc_at(case, q)
    exact = compute_reference(load_rig("beam"), 5, q)
    places = [epmc["modal_amplitude"].index(value) for value in q]
    assert [epmc["omega_rad_s"][k] for k in places] == pytest.approx(exact.omega_rad_s, rel=1e-8)
    assert epmc["folds"] == []
    first = np.array(epmc["participation_real"])[:, 0]
    assert np.all(np.abs(first - 1.0) < 2e-3)


def test_a_missing_reference_is_a_sentence():
    case = StudyCase("x", "x", 2, (0.05, 0.1), overrides=(f"{JOINT_KEY}=100e3",), harmonics=5)
    single = single_point_at(case)
    assert "phase resonance" in single["failure"]
    assert single["levels"] == {}
    assert epmc_at(case, [float("nan")])["failure"]


def test_fold_of_a_known_curve():
    # s³ − s has its turning points at ±1/√3, where the parameter is ∓2/(3√3).
    s = np.linspace(-2.0, 2.0, 4001)
    (low, high), *rest = fold_intervals(s**3 - s)
    assert not rest
    assert (low, high) == pytest.approx((-2 / 3**1.5, 2 / 3**1.5), abs=1e-6)


@given(st.lists(st.integers(-20, 20), min_size=2, max_size=40))
def test_intervals_are_those_passed_more_than_once(values):
    # A branch comes from below everything and leaves above everything.
    parameter = np.array([min(values) - 1.0, *values, max(values) + 1.0], dtype=float)
    intervals = fold_intervals(parameter)
    assert all(a[1] < b[0] for a, b in pairwise(intervals))
    probes = np.unique(np.concatenate([parameter, 0.5 * (parameter[1:] + parameter[:-1])]))
    for probe in probes:
        before, after = parameter[:-1] - probe, parameter[1:] - probe
        passages = int(np.sum(before * after < 0))
        touching = bool(np.any(parameter == probe))
        if passages > 1 and not touching:
            assert any(low <= probe <= high for low, high in intervals)
        if passages == 1 and not touching:
            assert not any(low < probe < high for low, high in intervals)
