"""Linear modal test through the nodes, and a run that knows nothing but its result."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from nmt_bench import cli
from nmt_bench.commands.linear_input import check_fits, read_linear
from nmt_bench.harness import Bench
from nmt_core.errors import BenchError
from nmt_core.vocabulary import PointStatus
from nmt_rig import linear_description as model_description
from nmt_rig.rig import load_rig
from nmt_session import plan_of_test

RIGS = {
    # rig: duration of the record (s), level (V) and periods of the run
    "joint_resonator": (6.0, "1.0", 40),
    "beam": (16.0, "0.7", 40),
}


def _forbidden(*_: object) -> None:
    raise AssertionError("a figure of the model was asked for")


@pytest.fixture(scope="module", params=["joint_resonator", pytest.param("beam", marks=pytest.mark.campaign)])
def measured(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    name = request.param
    out = tmp_path_factory.mktemp("linear") / name
    words = ["linear", name, "--out", str(out), "--duration", str(RIGS[name][0]), "--one-process", "--quiet"]
    with pytest.MonkeyPatch.context() as patch:
        # Neither the test nor its evaluation may ask the model; only the report compares with it.
        patch.setattr(plan_of_test, "linear_description", _forbidden)
        patch.setattr(model_description, "linear_description", _forbidden)
        assert cli.main([*words, "--reference", "none"]) == 0
    return name, out


def test_files(measured: tuple[str, Path]) -> None:
    _, out = measured
    assert {"bag", "linear.json", "frf.csv", "report.html", "rig.yaml", "run.json"} <= {f.name for f in out.iterdir()}
    assert json.loads((out / "run.json").read_text())["linear"] is None
    assert json.loads((out / "linear.json").read_text())["quality"]["linearity"]["is_linear"]
    assert "Stabilisation diagram" in (out / "report.html").read_text()


def test_run_with_the_measured_description_equals_the_run_with_the_model(
    measured: tuple[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    name, out = measured
    _, level, periods = RIGS[name]
    options = {"levels": level, "window_periods": periods}
    with Bench(name, **options) as bench:  # type: ignore[arg-type]
        (expected,) = bench.run().points
    monkeypatch.setattr(plan_of_test, "linear_description", _forbidden)
    monkeypatch.setattr(model_description, "linear_description", _forbidden)
    linear = read_linear(out)
    check_fits(linear, load_rig(name), out)
    with Bench(name, linear=linear, **options) as bench:  # type: ignore[arg-type]
        assert bench.plan.run["linear"]["source"] == "test"
        (point,) = bench.run().points
    assert (expected.status, point.status) == (PointStatus.OK, PointStatus.OK)
    assert point.omega_rad_s == pytest.approx(expected.omega_rad_s, rel=5e-4)
    assert point.damping_ratio == pytest.approx(expected.damping_ratio, rel=0.02)
    assert point.modal_amplitude == pytest.approx(expected.modal_amplitude, rel=0.01)


def test_a_recording_is_evaluated_again_with_the_same_result(measured: tuple[str, Path], tmp_path: Path) -> None:
    _, out = measured
    words = ["linear", "--bag", str(out), "--out", str(tmp_path / "again"), "--reference", "none"]
    assert cli.main(words) == 0
    assert (tmp_path / "again" / "linear.json").read_bytes() == (out / "linear.json").read_bytes()
    assert (tmp_path / "again" / "frf.csv").read_bytes() == (out / "frf.csv").read_bytes()


def test_a_description_of_another_set_up_is_refused(measured: tuple[str, Path]) -> None:
    name, out = measured
    linear = read_linear(out)
    with pytest.raises(BenchError, match="exciter at point"):
        check_fits(linear, load_rig("beam", ["exciter.point=4"]), out)
    other = "beam" if name == "joint_resonator" else "joint_resonator"
    with pytest.raises(BenchError):
        check_fits(linear, load_rig(other), out)
