"""The study of other methods: its cases, and what it makes of results."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nmt_rig.rig import load_rig
from nmt_study.case import StudyCase
from nmt_study.method_comparison import METHODS, RANGE, cases, derived_results, expected, outcomes


def test_cases_keep_the_limits_and_have_a_frequency_for_every_level() -> None:
    rig = load_rig("joint_resonator")
    chosen = cases(False)
    assert len({case.name for case in chosen}) == len(chosen)
    assert {case.labels["method"] for case in chosen} <= set(METHODS)
    for case in chosen:
        if case.control == "force":
            assert max(case.levels) < rig.limits.force_n
        if case.control == "response":
            assert max(case.levels) < rig.limits.acceleration_m_s2
        if case.test in ("sweep", "stepped_sine"):
            assert len(case.frequencies_hz) == len(case.levels)
        if case.test == "sweep":
            assert max(case.frequencies_hz) < case.frequency_end_hz
    assert all(case.name in {c.name for c in chosen} for case in cases(True))


def test_expected_resonances_are_those_of_the_rig() -> None:
    """Frequencies of stepped sines lie around the resonance only as long as the table fits the rig file."""
    from nmt_rig.reference import compute_reference

    acceleration = np.array([60.0, 250.0, 700.0, 1700.0])
    omega = 2.0 * math.pi * expected(acceleration)[0]
    backbone = compute_reference(load_rig("joint_resonator"), 3, acceleration / omega**2)
    frequency, damping = expected(acceleration)
    assert np.all(np.abs(backbone.omega_rad_s / (2.0 * math.pi) / frequency - 1.0) < 0.25 * damping)
    np.testing.assert_allclose(backbone.damping_ratio, damping, rtol=0.1)


def test_kind_of_test_is_part_of_a_case_but_old_results_stay_valid() -> None:
    plain = StudyCase("a", "a", 2, (0.1,))
    assert plain.fingerprint == "d3a86db2339ed6b8"
    decay = StudyCase("a", "a", 2, (0.1,), test="ring_down", duration=0.5)
    longer = StudyCase("a", "a", 2, (0.1,), test="ring_down", duration=0.6)
    assert len({plain.fingerprint, decay.fingerprint, longer.fingerprint}) == 3
    assert StudyCase.from_mapping(decay.to_mapping()) == decay


def level(q: float, omega: float, damping: float) -> dict[str, Any]:
    return {
        "level_index": 0, "level": 1.0, "status": 1, "reason": "", "modal_amplitude": q, "omega_rad_s": omega,
        "omega_rad_s_std": 0.1, "damping_ratio": damping, "damping_ratio_std": 1e-5,
    }  # fmt: skip


def test_errors_are_taken_at_the_amplitude_found_and_within_the_range() -> None:
    from nmt_core.vocabulary import PointStatus

    omega = 2300.0
    q = np.array([0.5 * RANGE[0], 2.0 * RANGE[0], 0.5 * RANGE[1], 2.0 * RANGE[1]]) / omega**2
    epmc = {
        "failure": "", "folds": [], "modal_amplitude": [q[0] / 2, q[-1] * 2], "omega_rad_s": [omega, omega],
        "damping_ratio": [0.002, 0.002],
    }  # fmt: skip
    case = next(case for case in cases(True) if case.test == "ring_down")
    levels = [{**level(value, 1.001 * omega, 0.0021), "status": int(PointStatus.OK)} for value in q]
    result = {
        "case": case.to_mapping(), "levels": levels, "epmc": epmc, "run": {"bench_time_s": 16.0},
        "single_point": {"failure": "x", "curve": {}},
        "extra": {"methods": {"apparent": {"levels": levels[:2], "bench_time_s": 2.0}}},
    }  # fmt: skip
    assert [r["case"]["labels"]["method"] for r in derived_results([result])] == ["ring_downs", "apparent"]
    mean, apparent = outcomes([result])
    assert (mean.method, mean.bench_time, apparent.bench_time) == ("ring_downs", 16.0, 2.0)
    assert mean.acceleration.size == 2
    assert apparent.acceleration.size == 1
    np.testing.assert_allclose(mean.omega_error, 0.001)
    np.testing.assert_allclose(mean.damping_error, 0.05)
    np.testing.assert_allclose(mean.omega_std, 0.1 / omega)
