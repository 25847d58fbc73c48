"""Every kind of measurement: predicted, derived and measured alike, and asked by nobody what it is."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnose.one_of_each_kind import KINDS, rig_of_kinds, with_chain

import nmt_diagnose
import nmt_report
from nmt_core import kinds as kinds_of_test
from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_diagnose.chain.chain_columns import is_linear, linear_chain
from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.imposed_motion import ImposedMotion, imposed_motion_observations
from nmt_diagnose.measurements.measurement import Measurement, Observations, holds_amplitude
from nmt_diagnose.measurements.registry import MEASUREMENTS, MeasurementKind
from nmt_diagnose.observations.bag_windows import BagWindows
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.observations.tables_together import TablesTogether
from nmt_diagnose.prediction.forward import Forward
from nmt_record.exchange.reduced.observables import ObservableTable
from nmt_record.exchange.sidecar.import_sidecar import TableKind
from nmt_rig.rig import Rig

GAIN = 1e-4
"""By which the gain of a channel is off in differences."""


def changed(rig: Rig, observed: Observations, channel: str) -> np.ndarray:
    """Change of what is predicted of a sensor whose gain is off, over that gain."""
    sensors = [
        s.model_copy(update={"gain": s.gain * (1.0 + GAIN)}) if rig.sensor_channel(s) == channel else s
        for s in rig.sensors
    ]
    forward = Forward(observed.tests, observed.rows)
    base = forward.predict(rig)
    moved = forward.predict(rig.model_copy(update={"sensors": sensors}), base)
    return forward.difference(moved.values, base.values) / GAIN


def test_there_is_one_of_each_kind() -> None:
    rig = rig_of_kinds()
    assert {type(test) for make in KINDS.values() for test in make(rig).tests} == {
        kind.measurement for kind in MEASUREMENTS
    }
    assert len({kind.measurement.WORDS for kind in MEASUREMENTS}) == len(MEASUREMENTS)
    names = {kind.measurement.__name__ for kind in MEASUREMENTS}
    assert not names & set(vars(kinds_of_test)), "a measurement and a kind of test would share a name"


def bag_of_no_windows() -> BagWindows:
    rig = rig_of_kinds()
    view = ModelView.of(rig, [rig.drive_point])
    return BagWindows("bag", {}, rig, view, ObservationSettings(), True, {}, {}, rig.sample_rate_hz, [])


@pytest.mark.parametrize("kind", [kind for kind in MEASUREMENTS if kind.measurement is not ImposedMotion])
def test_a_bag_without_windows_has_no_measurement(kind: MeasurementKind) -> None:
    assert kind.read(bag_of_no_windows()) == []


def test_a_bag_without_response_is_refused_before_it_is_read() -> None:
    with pytest.raises(BenchError, match="has no response channel"):
        imposed_motion_observations(bag_of_no_windows())


@pytest.mark.parametrize("kind", [*TableKind, "levels"])
def test_a_table_is_of_one_kind_of_measurement(kind: str) -> None:
    rig, lines = rig_of_kinds(), np.linspace(20.0, 30.0, 12)
    columns = {"frequency_hz": lines, "amplitude": 1e-4 * lines, "real": lines, "imag": lines}
    level = 1.0 if kind == "levels" else np.nan
    table = ObservableTable(
        TableKind.BACKBONE if kind == TableKind.BACKBONE else TableKind.FRF, columns, {}, Quantity.DISPLACEMENT,
        point=rig.drive_point, drive_point=rig.drive_point, level=level, level_unit="N" if kind == "levels" else "",
    )  # fmt: skip
    view = ModelView.of(rig, [rig.drive_point])
    channel = MeasuredChannel("x", Quantity.DISPLACEMENT, rig.drive_point)
    together = TablesTogether("table", (table,), view, (channel,), ObservationSettings())
    assert sum(kind.read_tables is not None and kind.read_tables(together) is not None for kind in MEASUREMENTS) == 1


def test_nobody_asks_a_measurement_what_kind_it_is() -> None:
    names, found = {kind.measurement.__name__ for kind in MEASUREMENTS}, []
    for package in (nmt_diagnose, nmt_report):
        for file in sorted(Path(package.__path__[0]).rglob("*.py")):
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("isinstance", "issubclass"):
                    asked = {it.id for it in ast.walk(node.args[1]) if isinstance(it, ast.Name)}
                    found += [f"{file.name}:{node.lineno}"] if asked & names else []
    assert not found


@pytest.mark.parametrize("kind", KINDS)
def test_the_model_leaves_nothing_of_what_it_predicts(kind: str) -> None:
    """Solved anew, and from the solutions of a rig that is a little stiffer."""
    rig = rig_of_kinds()
    observed = KINDS[kind](rig)
    forward = Forward(observed.tests, observed.rows)
    start = forward.predict(Parametrisation(rig, calibration_parameters(rig)).rig(0.1 * np.ones(18)))
    for prediction in (forward.predict(rig), forward.predict(rig, start)):
        left = forward.difference(prediction.values, observed.values) / observed.sigma
        assert not prediction.reasons
        if not holds_amplitude(observed.tests[0]):  # those are bent away from the model
            assert np.abs(left).max() < 1e-4


@pytest.mark.parametrize("kind", KINDS)
def test_tangents_are_differences(kind: str) -> None:
    """Columns of the model's own parameters against solutions on either side."""
    rig = rig_of_kinds()
    observed = KINDS[kind](rig)
    forward, parametrisation = Forward(observed.tests, observed.rows), Parametrisation(rig, calibration_parameters(rig))
    theta = np.zeros(parametrisation.size)
    prediction, step = forward.predict(rig), 1e-3
    columns = forward.jacobian(parametrisation, theta, prediction)
    for column in range(parametrisation.size):
        moved = step * parametrisation.prior_std[column] * (np.arange(parametrisation.size) == column)
        sides = [forward.predict(parametrisation.rig(theta + s * moved), prediction).values for s in (1.0, -1.0)]
        slope = forward.difference(*sides) / (2.0 * moved[column])
        # A thousandth of the noise for a whole prior standard deviation is the rounding of differences.
        least = 0.2 * observed.sigma / parametrisation.prior_std[column]
        away = np.abs(columns[:, column] - slope) / np.maximum(np.abs(slope).max(), least)
        assert away.max() < 5e-3, f"{parametrisation.names[column]}: {away.max():.2g}"


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "stepped responses"])
def test_gains_of_the_chain_are_differences(kind: str) -> None:
    """What a tenth of a thousandth of each sensor's gain changes, but where the bench's chain knows no channel."""
    rig = rig_of_kinds()
    observed = with_chain(KINDS[kind](rig))
    chain = linear_chain(observed, rig, Forward(observed.tests, observed.rows).predict(rig))
    checked = 0
    for name, column in zip(chain.names, chain.columns.T, strict=True):
        channel = name.removeprefix("gain ").removeprefix("of ").partition(" in ")[0]
        known = channel in {rig.sensor_channel(sensor) for sensor in rig.sensors} - {"u"}
        if not name.startswith("gain ") or not known or channel == moved_channel(observed.tests[0]):
            continue
        tolerance = observed.chains[0].of(channel).gain if observed.chains[0] is not None else 0.0
        expected = tolerance * changed(rig, observed, channel)
        assert np.abs(column - expected).max() < 2e-3 * np.abs(expected).max(), name
        checked += 1
    assert checked or not is_linear(observed.tests[0])


def moved_channel(test: Measurement) -> str:
    """Channel of an imposed motion: its gain moves the model, and no sensor of the model shows it."""
    return test.input_channel.name if test.imposed_scales is not None and hasattr(test, "input_channel") else ""


def test_errors_of_responses_are_those_of_measured_ones() -> None:
    """A response that was recorded too large leaves as much as its column says, the amplitude given as it was."""
    rig = rig_of_kinds()
    observed = with_chain(KINDS["stepped responses"](rig))
    test, rows = observed.tests[0], observed.rows.take(observed.rows.test == 0)
    chain = observed.chains[0]
    assert chain is not None
    assert test.lines is not None
    errors = test.lines.errors(rows, chain)
    scaled = np.array([1.0, 1.0 + GAIN])
    larger = replace(test, measured=test.measured * scaled)  # type: ignore[type-var]
    base, moved = (Forward([it], rows).predict(rig).values for it in (test, larger))
    recorded = np.where(rows.part == Part.LOG_MAGNITUDE, np.log(scaled[rows.channel]), 0.0)
    left = (recorded - (moved - base)) / GAIN
    np.testing.assert_allclose(errors["gain of a2 in responses"], chain.of("a2").gain * left, atol=1e-5)
