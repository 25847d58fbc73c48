"""Levels of response and force, ramps, and the paper's loop through the nodes."""

from __future__ import annotations

import json

import numpy as np
import pytest

pytest.importorskip("rclpy")

from nmt_bench.harness import Bench
from nmt_core.errors import BenchError
from nmt_core.vocabulary import PointStatus
from nmt_extract.offline import extract_bag
from nmt_study.case import StudyCase
from nmt_study.case_reference import single_point_at


@pytest.mark.parametrize(
    ("control", "unit", "levels"),
    [pytest.param("response", "m", (5e-5, 2e-4), marks=pytest.mark.campaign), ("force", "N", (0.05, 1.0))],
)
def test_a_level_is_held_and_gives_the_same_backbone(control, unit, levels):
    with Bench("beam", levels=levels, control=control, window_periods=30) as bench:
        assert bench.test.level_unit == unit
        result = bench.run()
    reference = single_point_at(StudyCase("x", "x", 2, tuple(np.geomspace(0.1, 2.0, 60))))["curve"]
    for point, level in zip(result.points, levels, strict=True):
        assert point.status is PointStatus.OK
        assert point.level_unit == unit
        held = point.force_n if control == "force" else abs(point.shape_harmonics[1][point.points.index(2)])
        assert held == pytest.approx(level, rel=5e-3)
        if point.modal_amplitude < 1.5e-4:  # sticking
            assert point.omega_rad_s == pytest.approx(139.434, rel=1e-4)
        q = np.log(reference["modal_amplitude"])
        omega = np.interp(np.log(point.modal_amplitude), q, reference["omega_rad_s"])
        damping = np.interp(np.log(point.modal_amplitude), q, reference["damping_ratio"])
        assert point.omega_rad_s == pytest.approx(omega, rel=1e-3)
        assert point.damping_ratio == pytest.approx(damping, rel=0.02)


def test_what_a_level_is_goes_into_the_records():
    bench = Bench("beam", levels="0.05:1:3", control="force")
    assert bench.test.asked.control == 3
    assert json.loads(json.dumps(bench.test.asked.goal))["levels"][0] == 0.05


def test_levels_that_fit_neither_rig_nor_loop_are_refused():
    with pytest.raises(BenchError, match="are voltages; give --levels"):
        Bench("beam", control="response")
    with pytest.raises(BenchError, match="Control 'power' is not known"):
        Bench("beam", levels=[1.0], control="power")
    with pytest.raises(BenchError, match="steps the voltage only"):
        Bench("beam", levels=[1.0], control="force", node_values={"pll": {"loop": "paper"}})


def test_the_papers_loop_runs_through_the_nodes():
    values = {"pll": {"loop": "paper", "paper_waiting_time": 4.0, "paper_phase_tolerance": 0.05}}
    with Bench("beam", levels=[0.1], window_periods=20, node_values=values) as bench:
        result = bench.run()
    assert result.points[0].omega_rad_s == pytest.approx(139.434, rel=2e-4)


def test_settings_of_the_papers_loop_come_from_the_rig_too():
    bench = Bench("beam", levels=[0.1], overrides=["pll.loop=paper", "pll.paper_gain=60"])
    assert bench.plan.pll.paper_settings.gain == 60.0
    assert bench.plan.pll.loop == "paper"
    with pytest.raises(BenchError, match="'paper_colour' is not known"):
        Bench("beam", levels=[0.1], overrides=["pll.paper_colour=1"])


def test_windows_along_ramps_need_no_waiting(tmp_path):
    levels = tuple(0.25 * 1.165**k for k in range(6))  # slip begins in the second window
    with Bench("beam", levels=levels, strategy="ramp", window_periods=30, out=tmp_path / "out") as bench:
        result = bench.run()
    assert [point.status for point in result.points] == len(levels) * [PointStatus.OK]
    reference = single_point_at(StudyCase("x", "x", 2, tuple(np.geomspace(0.2, 0.6, 80))))["curve"]
    q = np.log(reference["modal_amplitude"])
    for point in result.points:
        place = np.log(point.modal_amplitude)
        assert point.omega_rad_s == pytest.approx(np.interp(place, q, reference["omega_rad_s"]), rel=1e-3)
        assert point.damping_ratio == pytest.approx(np.interp(place, q, reference["damping_ratio"]), rel=0.03)
    # After the first level, a level is little longer than its window.
    starts = np.diff([point.window_first_sample for point in result.points[1:]])
    assert np.all(starts < 1.25 * np.array([point.window_samples for point in result.points[1:-1]]))
    offline = extract_bag(result.bag).points
    assert all(a.identical(b) for a, b in zip(offline, result.points, strict=True))


def test_the_strategy_is_checked():
    with pytest.raises(BenchError, match="Strategy 'leap' is not known"):
        Bench("beam", levels=[1.0], strategy="leap")
    with pytest.raises(BenchError, match="waits at every level"):
        Bench("beam", levels=[1.0], strategy="ramp", overrides=["pll.loop=paper"])
    for control in ("response", "force"):
        with pytest.raises(BenchError, match="holds neither response nor force; use --control voltage"):
            Bench("beam", levels=[1e-4], strategy="ramp", control=control)
    bench = Bench("beam", levels=[1.0], strategy="ramp")
    assert bench.test.asked.window_periods == 20
    assert bench.test.asked.ramp == pytest.approx(20 / 22.19, rel=1e-3)
