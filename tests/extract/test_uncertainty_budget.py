"""Uncertainty budget: closed forms of its parts, and how often its intervals hold the truth with wrong sensors."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from extract.nonlinear_rigs import IDEAL, NonlinearRig
from extract.nonlinear_rigs import measured as nonlinear_point
from extract.sensor_errors import CHANNELS, Rig, Sensors, measured, true_point

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.vocabulary import PointStatus
from nmt_extract.judgement.uncertainty_budget import (
    Budget,
    BudgetInputs,
    MethodError,
    UncertaintySource,
    left_out,
    uncertainty_budget,
    write_budget,
)
from nmt_record.exchange.sidecar.calibration_file import CalibrationSheet, read_calibration
from nmt_record.exchange.sidecar.channel_tolerances import ChannelTolerance, Tolerances, tolerances

FORCE, A = Quantity.FORCE, Quantity.ACCELERATION


def linear(source: str, stds: tuple[tuple[float, ...], ...] = ()) -> LinearDescription:
    """One mode, one point."""
    return LinearDescription(
        source, 1, 0, (1,), (300.0,), (0.01,), ((2.0,),), 2.0, 300.0, 0.01, 0.0, shape_stds=stds
    )  # fmt: skip


def one_point(**changes: float) -> ModalPoint:
    """Harmonic motion of one mode with P₁ = δ̃ ω̃³ q²."""
    omega, damping, q = 300.0, 0.01, 1e-3
    values = {
        "frequency_hz": omega / (2 * math.pi), "frequency_hz_std": 1e-5, "omega_rad_s": omega, "damping_ratio": damping,
        "damping_ratio_std": 0.0, "modal_amplitude": q, "modal_amplitude_std": 0.0, "force_n": 1.0, "force_n_std": 0.0,
        "active_power": damping * omega**3 * q**2, "phase_error": 0.0, "phase_error_std": 0.0, "window_periods": 100,
        **changes,
    }  # fmt: skip
    shape = np.array([[0.0], [2.0 * q]], dtype=complex)
    return ModalPoint(0, PointStatus.OK, "", 1.0, "N", points=(1,), shape_harmonics=shape, **values)  # type: ignore[arg-type]


def part(source: UncertaintySource, quantity: str, inputs: BudgetInputs, point: ModalPoint | None = None) -> float:
    (found,) = uncertainty_budget([point or one_point()], inputs)
    budget = found.budgets[quantity]
    return budget.parts.get(source, 0.0) / abs(budget.value)


def known(**channels: float) -> Tolerances:
    """Gains of force and response, no other error."""
    own = {
        (FORCE, 1): ChannelTolerance(channels.get("force", 0.0), channels.get("phase", 0.0), 0.0),
        (A, 1): ChannelTolerance(channels.get("response", 0.0), 0.0, 0.0),
    }
    return Tolerances(own, ChannelTolerance(0.0, 0.0, 0.0), 0.0)


def test_gains_with_shapes_of_a_model() -> None:
    # δ̃ = P₁ / (ω̃³ q²) ~ g_F g_x / g_x² and q ~ g_x.
    inputs = BudgetInputs(linear("model"), known(force=0.01, response=0.02), A)
    assert part(UncertaintySource.GAINS, "damping_ratio", inputs) == pytest.approx(math.hypot(0.01, 0.02), rel=1e-3)
    assert part(UncertaintySource.GAINS, "modal_amplitude", inputs) == pytest.approx(0.02, rel=1e-3)
    assert part(UncertaintySource.GAINS, "force_n", inputs) == pytest.approx(0.01)
    assert part(UncertaintySource.GAINS, "omega_rad_s", inputs) == 0.0


def test_gains_with_shapes_that_the_same_sensors_measured() -> None:
    # The scale of such a shape is off by √(g_x / g_F): both errors cancel in the damping, and q goes with √(g_x g_F).
    inputs = BudgetInputs(linear("test"), known(force=0.01, response=0.02), A)
    assert part(UncertaintySource.GAINS, "damping_ratio", inputs) == pytest.approx(0.0, abs=1e-6)
    assert part(UncertaintySource.GAINS, "modal_amplitude", inputs) == pytest.approx(
        0.5 * math.hypot(0.01, 0.02), rel=1e-2
    )
    other = Tolerances(inputs.tolerances.channels, inputs.tolerances.default, 0.0, same_sensors=False)
    apart = BudgetInputs(linear("test"), other, A)
    assert part(UncertaintySource.GAINS, "damping_ratio", apart) == pytest.approx(math.hypot(0.01, 0.02), rel=1e-3)


def test_phase_moves_the_frequency_by_the_slope_of_the_resonance() -> None:
    # Near resonance the phase of the force turns by dφ = dω / (δ̃ ω̃).
    inputs = BudgetInputs(linear("model"), known(phase=0.01), A)
    assert part(UncertaintySource.PHASES, "omega_rad_s", inputs) == pytest.approx(0.01 * 0.01)
    assert part(UncertaintySource.PHASES, "damping_ratio", inputs) == pytest.approx(0.5 * 0.01**2, rel=1e-2)


def test_shapes_clock_and_method() -> None:
    tolerant = Tolerances({}, ChannelTolerance(0.0, 0.0, 0.0), 1e-5)
    method = MethodError(np.array([5e-4, 2e-3]), np.array([1e-4, 1e-4]), np.array([0.01, 0.03]))
    inputs = BudgetInputs(linear("test", ((0.02,),)), tolerant, A, method)
    assert part(UncertaintySource.SHAPES, "modal_amplitude", inputs) == pytest.approx(0.01, rel=1e-3)
    assert part(UncertaintySource.SHAPES, "damping_ratio", inputs) == pytest.approx(0.02, rel=1e-3)
    assert part(UncertaintySource.CLOCK, "omega_rad_s", inputs) == pytest.approx(1e-5)
    assert part(UncertaintySource.METHOD, "omega_rad_s", inputs) == pytest.approx(1e-4)
    assert part(UncertaintySource.METHOD, "damping_ratio", inputs) == pytest.approx(0.01 + 0.02 / 3.0)
    calibration = "± does not include the calibration of the sensors: no tolerance of a channel is stated."
    assert list(left_out(inputs)) == [calibration]
    assert not list(left_out(replace(inputs, tolerances=Tolerances({}, ChannelTolerance(0.01, 0.0, 0.0), 1e-5))))
    assert [sentence.split(";")[0] for sentence in left_out(replace(inputs, method=None))][1:] == [
        "± does not include the error of single-point excitation"
    ]
    two = replace(inputs, method=None, linear=replace(inputs.linear, exciter_points=(1, 4)))
    assert [sentence.split(";")[0] for sentence in left_out(two)][1:] == [
        "± does not include the error of excitation at 2 points"
    ]


def test_repeats_count_beyond_the_noise() -> None:
    inputs = BudgetInputs(linear("model"), known(), A)
    points = [one_point(damping_ratio=value, damping_ratio_std=3e-5) for value in (0.0100, 0.0102, 0.0104)]
    for found in uncertainty_budget(points, inputs):
        spread = found.budgets["damping_ratio"].parts[UncertaintySource.REPEATS]
        assert spread == pytest.approx(math.sqrt(4e-8 - 9e-10))
    (alone,) = uncertainty_budget(points[:1], inputs)
    assert UncertaintySource.REPEATS not in alone.budgets["damping_ratio"].parts


def test_coverage_factor_follows_the_degrees_of_freedom() -> None:
    # Student's t at 9 degrees of freedom, 97.5 %: 2.262 (JCGM 100:2008, table G.2); 1.960 for many.
    assert Budget("q", 1.0, {UncertaintySource.NOISE: 0.1}).coverage_factor == pytest.approx(2.262, abs=1e-3)
    assert Budget(
        "q", 1.0, {UncertaintySource.NOISE: 1e-6, UncertaintySource.GAINS: 0.1}
    ).coverage_factor == pytest.approx(1.960, abs=1e-3)


@pytest.mark.campaign
@pytest.mark.parametrize("source", ["model", "test"])
def test_intervals_hold_the_truth_as_often_as_stated(source: str) -> None:
    random = np.random.default_rng(20)
    inside = dict.fromkeys(("omega_rad_s", "damping_ratio", "modal_amplitude", "force_n"), 0)
    rigs = 240
    for _ in range(rigs):
        rig = Rig.drawn(random)
        sensors = Sensors.drawn(random)
        linear_description = rig.description(source, sensors, random)
        point = measured(rig, sensors, linear_description, random)
        truth = true_point(rig)
        inputs = BudgetInputs(linear_description, sensors.tolerances, A)
        (found,) = uncertainty_budget([point], inputs)
        for name in inside:
            inside[name] += abs(found.budgets[name].value - truth[name]) <= found.budgets[name].expanded
    for name, count in inside.items():
        assert 0.92 <= count / rigs <= 0.985, (name, count / rigs)
    assert len(CHANNELS) == 5


@pytest.mark.campaign
@pytest.mark.parametrize("kind", ["cubic", "joint"])
def test_intervals_hold_the_truth_of_nonlinear_rigs(kind: str) -> None:
    """Beside what ideal sensors would have found; the error of single-point excitation is another part."""
    random = np.random.default_rng(20)
    inside = dict.fromkeys(("omega_rad_s", "damping_ratio", "modal_amplitude", "force_n"), 0)
    rigs = 0
    while rigs < 120:
        source = ("model", "test")[rigs % 2]
        rig, sensors = NonlinearRig.drawn(kind, random), Sensors.drawn(random)
        linear_description = rig.linear.description(source, sensors, random)
        try:
            truth = nonlinear_point(rig, IDEAL, rig.linear.description("model", IDEAL, random), random, noise=0.0)
            point = nonlinear_point(rig, sensors, linear_description, random)
        except ArithmeticError:  # no steady state: a few in a hundred of those that slip far
            continue
        rigs += 1
        (found,) = uncertainty_budget([point], BudgetInputs(linear_description, sensors.tolerances, A))
        for name in inside:
            apart = abs(found.budgets[name].value - getattr(truth, name))
            inside[name] += apart <= found.budgets[name].expanded
    for name, count in inside.items():  # of 120 at 95 %, 105 or fewer are seen once in 1,000
        assert count >= 106, (name, count)


def test_files(tmp_path: Path) -> None:
    inputs = BudgetInputs(linear("model"), known(force=0.01, response=0.02), A)
    write_budget(uncertainty_budget([one_point()], inputs), tmp_path, inputs)
    with open(tmp_path / "uncertainty.csv", encoding="utf-8") as handle:
        rows = {(row["quantity"], row["source"]): float(row["std"]) for row in csv.DictReader(handle)}
    document = json.loads((tmp_path / "uncertainty.json").read_text(encoding="utf-8"))
    entry = document["points"][0]["quantities"]["damping_ratio"]
    assert rows["damping_ratio", "total"] == entry["total"] == pytest.approx(0.01 * math.hypot(0.01, 0.02), rel=1e-3)
    assert entry["expanded_95"] == pytest.approx(1.96 * entry["total"], rel=1e-3)
    assert any("single-point" in sentence for sentence in document["not_included"])


def test_a_calibration_file_counts_before_the_bag(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_text(
        "clock_std: 1.0e-6\nchannels:\n"
        "  - {quantity: force, point: 2, gain_std: 0.005, calibrated: 2026-03-01, serial: '77'}\n"
        "  - {quantity: acceleration, gain_std: 0.015, phase_std_deg: 0.5}\n",
        encoding="utf-8",
    )
    sheet = read_calibration(path)
    own = [{"quantity": "acceleration", "point": 4, "gain_std": 0.03}, {"quantity": "force", "point": 2}]
    run = {"imported": {"sidecar": {"channels": own}}}
    plain, stated = tolerances(run), tolerances(run, None, sheet)
    assert (plain.of(A, 4).gain, plain.of(FORCE, 2).gain) == (0.03, 0.01)
    assert (stated.of(FORCE, 2).gain, stated.of(A, 9).gain, stated.clock) == (0.005, 0.015, 1e-6)
    assert stated.of(FORCE, 2).source == "calibration sheet (serial 77, 2026-03-01)"
    assert stated.of(A, 9).phase == pytest.approx(math.radians(0.5))
    # What the sidecar says of this very channel is nearer than a sheet's line on all of its kind.
    assert stated.of(A, 4).gain == 0.03


def test_a_simulated_run_has_no_tolerances_and_a_device_those_of_its_rig_file() -> None:
    assert tolerances({"device": "simulated rig"}).of(A, 1) == ChannelTolerance(0.0, 0.0, 0.0)
    rig = "device:\n  inputs:\n    - {channel: a4, port: 1, sensitivity_v: 0.01, uncertainty: 0.02}\n"
    found = tolerances({"device": "portaudio"}, rig)
    assert (found.of(A, 4).gain, found.of(A, 5).gain) == (0.02, 0.01)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("channels: []", "channels"),
        ("channels: [{quantity: force, gain_std: 1.5}]", "gain_std"),
        ("channels: [{quantity: force, gain: 0.1}]", "gain"),
        ("channels: [{quantity: force}, {quantity: force}]", "stands twice"),
        ("clock_std: .nan\nchannels: [{quantity: force}]", "clock_std"),
    ],
)
def test_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BenchError, match=said):
        read_calibration(path)


def test_sheet_is_a_model() -> None:
    sheet = CalibrationSheet.model_validate({"channels": [{"quantity": "force"}]})
    assert sheet.shapes_with_same_sensors


def test_a_negative_damping_ratio_has_no_negative_part() -> None:
    point = one_point(damping_ratio=-0.01, phase_error=0.02, phase_error_std=0.01, omega_rad_s_std=0.5)
    budget = uncertainty_budget([point], BudgetInputs(linear("model"), known(), A))[0].budgets["omega_rad_s"]
    assert min(budget.parts.values()) >= 0.0
    assert budget.parts[UncertaintySource.PHASE] == pytest.approx(0.01 * point.omega_rad_s * math.hypot(0.02, 0.01))
    assert budget.repeatability == pytest.approx(0.5)
