"""Errors of mode shapes against the derivative of the modal sum; healthy structures whose shapes are 1 % off."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from nmt_core.messages.blocks import Quantity
from nmt_diagnose.chain.chain_tests import ChainTests
from nmt_diagnose.chain.shape_errors import ShapeErrors
from nmt_diagnose.measurements.measurement import joined
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.observations.read_tables import table_observations
from nmt_record.exchange.reduced.observables import ObservableTable
from nmt_record.exchange.sidecar.import_sidecar import TableKind
from nmt_rig.rig import Rig, validate_rig
from nmt_rig.rig_file import RigDocument

HZ, RATIO = np.array([50.0, 80.0]), np.array([0.01, 0.008])
SHAPES = np.array([[1.0, 0.6], [0.5, -0.8], [-0.3, 0.4]])  # points 1 to 3, modes
LINES = np.array([44.0, 49.0, 50.5, 56.0, 70.0, 79.5, 85.0])
STD = 0.02


def rig(**more: Any) -> Rig:
    modes = [
        {"frequency_hz": float(HZ[k]), "damping_ratio": float(RATIO[k]), "shape": [float(v) for v in SHAPES[:, k]]}
        for k in range(2)
    ]
    structure = {"kind": "modal", "points": [1, 2, 3], "modes": modes, "shape_std": STD, **more}
    return validate_rig(RigDocument("test", {"name": "two_modes", "structure": structure}, {}))


def responses(shapes: np.ndarray, drive: int = 1) -> np.ndarray:
    """Accelerations of the points over a force, (lines, points)."""
    omega, natural = 2.0 * np.pi * LINES[:, None, None], 2.0 * np.pi * HZ
    below = natural**2 - omega**2 + 2j * RATIO * natural * omega
    return np.asarray(-(omega[:, :, 0] ** 2) * (shapes * shapes[drive - 1] / below).sum(axis=2))


def chain(model: Rig, level: float) -> ChainTests:
    values = responses(SHAPES)
    tables = [
        ObservableTable(
            TableKind.FRF, {"frequency_hz": LINES, "real": values[:, k].real, "imag": values[:, k].imag}, {},
            Quantity.ACCELERATION, level=level, level_unit="N" if level else "", point=k + 1, drive_point=1,
            name=f"p{k + 1}", direction="up" if level else "", noise=0.01,
        )
        for k in range(3)
    ]  # fmt: skip
    if level:
        found = table_observations("all", tables, model, ObservationSettings())
    else:
        settings = ObservationSettings()
        found = joined([table_observations(table.name, [table], model, settings) for table in tables])
    found = replace(found, chains=tuple(MeasuringChain() for _ in found.tests))
    return ChainTests(found, model, {number: own for number, own in enumerate(found.chains) if own is not None})


@pytest.mark.parametrize("level", [0.0, 0.5], ids=["random", "held force"])
def test_a_column_is_the_derivative_of_the_modal_sum(level: float) -> None:
    own = chain(rig(), level)
    found = ShapeErrors(own).columns(own.forward.predict(own.rig))
    rows, expected = own.rows, []
    points = np.array(
        [own.tests[test].channels[channel].point for test, channel in zip(rows.test, rows.channel, strict=True)]
    )
    lines = np.array([int(np.argmin(np.abs(LINES - hz))) for hz in rows.frequency_hz])
    for mode in range(2):
        for point in range(3):
            moved = SHAPES.copy()
            moved[point, mode] += 1e-6
            change = np.log(responses(moved) / responses(SHAPES)) / 1e-6 * STD * np.abs(SHAPES[:, mode]).max()
            own_change = change[lines, points - 1]
            expected.append(np.where(rows.part == Part.PHASE, own_change.imag, own_change.real))
    assert len(found) == 6
    for column in expected:
        apart = min(float(np.max(np.abs(column - each))) for each in found)
        assert apart < 2e-3 * max(1.0, float(np.max(np.abs(column))))


def test_shapes_that_are_exact_and_single_points_have_no_errors() -> None:
    exact = chain(rig(shape_std=0.0), 0.5)
    assert ShapeErrors(exact).columns(exact.forward.predict(exact.rig)) == []
    few = chain(rig(), 0.5)
    mode = {"frequency_hz": 50.0, "damping_ratio": 0.01}
    few.rig = validate_rig(RigDocument("test", {"name": "one", "structure": {"kind": "modal", "modes": [mode]}}, {}))
    assert ShapeErrors(few).columns(few.forward.predict(rig())) == []


def test_modes_far_from_the_lines_have_none() -> None:
    own = chain(rig(), 0.0)
    away = own.rig.structure.modes[1].model_copy(update={"frequency_hz": 1000.0})  # type: ignore[union-attr]
    structure = own.rig.structure.model_copy(update={"modes": [own.rig.structure.modes[0], away]})  # type: ignore[union-attr]
    own.rig = own.rig.model_copy(update={"structure": structure})
    assert len(ShapeErrors(own).columns(own.forward.predict(own.rig))) == 3
