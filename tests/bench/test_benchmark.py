from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from nmt_bench import cli
from nmt_benchmark import benchmark_figures
from nmt_benchmark.benchmark_figures import Figure
from nmt_benchmark.plant_speed import channel_speed, contact_speed
from nmt_core.vocabulary import PointStatus
from nmt_extract.offline import extract_bag
from nmt_rig.reference import single_point_reference
from nmt_rig.rig import load_rig
from nmt_session import Session, plan_test


def test_a_session_measures_what_harmonic_balance_predicts(tmp_path: Path) -> None:
    """Time integration, loop, bag and extraction in a row against the harmonic balance of the same drive."""
    rig = load_rig("beam")
    levels = [0.2, 1.0]
    with Session(plan_test(rig, levels, window_periods=30), tmp_path) as session:
        result = session.run()
    points = extract_bag(tmp_path / "bag").points
    assert all(a.identical(b) for a, b in zip(points, result.points, strict=True))
    assert [point.status for point in points] == [PointStatus.OK, PointStatus.OK]
    expected = single_point_reference(rig, None, levels).mode
    np.testing.assert_allclose([p.omega_rad_s for p in points], expected.omega_rad_s, rtol=5e-4)
    np.testing.assert_allclose([p.damping_ratio for p in points], expected.damping_ratio, rtol=5e-3)


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> None:
    made = [
        Figure("fast enough", 300.0, "× real time", 200.0, "limit, at least", True),
        Figure("too slow", 100.0, "× real time", 200.0, "limit, at least", False),
        Figure("beside a peer", 5.0, "µs", 7.0, "peer"),
        Figure("not there", None, "µs", 1.0, "not measured: no ROS"),
    ]
    monkeypatch.setattr(benchmark_figures, "plant_figures", lambda seconds: made)


@pytest.mark.usefixtures("figures")
def test_figures_stand_beside_their_limits(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    words = ["benchmark", "--part", "plant", "--json", str(tmp_path / "b.json")]
    assert cli.main(words) == 0
    lines = capsys.readouterr().out.splitlines()
    row = next(line for line in lines if "too slow" in line)
    assert "100 × real time" in row
    assert "200 × real time" in row
    assert "missed" in row
    assert lines[-1] == "Missed: too slow."
    assert any("not measured: no ROS" in line for line in lines)
    content = json.loads((tmp_path / "b.json").read_text())
    assert [figure["met"] for figure in content["figures"]] == [True, False, None, None]
    assert cli.main([*words, "--check"]) == 1


@pytest.mark.parametrize("words", [("--seconds", "0"), ("--json", "/no/such/folder/b.json")])
def test_wrong_options(capsys: pytest.CaptureFixture[str], words: tuple[str, str]) -> None:
    assert cli.main(["benchmark", *words]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.campaign
def test_many_levels_have_a_report_and_their_growth(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmark_figures, "_MANY", 8)
    monkeypatch.setattr(benchmark_figures, "_READ_LEVELS", (2, 4))
    figures = {figure.name: figure for figure in benchmark_figures.level_figures(1.0)}
    assert len(figures) == 6
    assert all(figure.value is not None and figure.value > 0.0 for figure in figures.values())
    assert all(figure.met is not None for figure in figures.values())
    assert figures["report of 8 levels: page"].met


@pytest.mark.campaign
def test_contacts_and_channels_have_their_speeds() -> None:
    assert contact_speed(3, 0.02) > 0.0
    assert channel_speed(4, 0.04) > 0.0
    for channels in (2, 52):
        with pytest.raises(ValueError, match="3 to 51 channels"):
            channel_speed(channels)
