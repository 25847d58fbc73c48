"""Couplings of modes against responses of matrices that have them; how large they may be."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh

from nmt_core.messages.blocks import Quantity
from nmt_core.tolerances import MODEL_PRIORS
from nmt_diagnose.chain.chain_columns import linear_chain
from nmt_diagnose.chain.chain_tests import ChainTests
from nmt_diagnose.chain.coupled_modes import CoupledModes
from nmt_diagnose.measurements.measurement import joined
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.observations.read_tables import table_observations
from nmt_record.exchange.reduced.observables import ObservableTable
from nmt_record.exchange.sidecar.import_sidecar import TableKind
from nmt_rig.rig import Rig, validate_rig
from nmt_rig.rig_file import RigDocument

MASS = np.diag([1.0, 0.8, 1.2])
STIFFNESS = 1e5 * np.array([[2.0, -0.8, 0.0], [-0.8, 1.9, -0.7], [0.0, -0.7, 1.6]])
DAMPING = 4e-5 * STIFFNESS
SENSORS = [{"quantity": "force", "point": "drive"}, {"quantity": "acceleration", "point": 1}]
DRIVE = {
    "exciter": {"kind": "force", "point": 1}, "sensors": SENSORS,
    "extraction": {"quantity": "acceleration", "linear_modes": 1},
}  # fmt: skip
LINES = np.array([34.0, 45.0, 50.5, 56.0, 70.0, 79.5, 85.0])


def rig(mass: np.ndarray = MASS, source: str = "model.op4 (SHA-256 0)", **more: Any) -> Rig:
    structure = {
        "kind": "matrices", "source": source, "points_at": [{"point": k + 1, "row": k} for k in range(3)],
        "mass_kg": mass.tolist(),
        "stiffness_n_m": STIFFNESS.tolist(), **({"damping_ns_m": DAMPING.tolist()} | more),
    }  # fmt: skip
    return validate_rig(RigDocument("test", {"name": "three_masses", "structure": structure, **DRIVE}, {}))


def responses(stiffness: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """Accelerations of the points over a force at the first, (lines, points)."""
    force = np.array([1.0, 0.0, 0.0])
    return np.array([-(w**2) * np.linalg.solve(stiffness + 1j * w * damping - w**2 * MASS, force)
                     for w in 2.0 * np.pi * LINES])  # fmt: skip


def observed(model: Rig, measured: np.ndarray) -> Any:
    tables = [
        ObservableTable(
            TableKind.FRF, {"frequency_hz": LINES, "real": measured[:, k].real, "imag": measured[:, k].imag}, {},
            Quantity.ACCELERATION, point=k + 1, drive_point=1, name=f"p{k + 1}", noise=0.01,
        )
        for k in range(3)
    ]  # fmt: skip
    settings = ObservationSettings()
    found = joined([table_observations(table.name, [table], model, settings) for table in tables])
    return replace(found, chains=tuple(MeasuringChain() for _ in found.tests))


def chain(model: Rig, measured: np.ndarray) -> ChainTests:
    found = observed(model, measured)
    return ChainTests(found, model, dict(enumerate(found.chains)))


def expected(first: int, second: int, kind: str, model: Rig, over: np.ndarray, tests_of: ChainTests) -> np.ndarray:
    """Change of the rows by the modal matrices, over what was measured."""
    squares, shapes = eigh(STIFFNESS, MASS)
    both = MASS @ (np.outer(shapes[:, first], shapes[:, second]) + np.outer(shapes[:, second], shapes[:, first])) @ MASS
    omega, losses = np.sqrt(squares), np.diag(shapes.T @ DAMPING @ shapes)
    size = {
        "stiffness": np.sqrt(2.0) * MODEL_PRIORS["frequency_factors"].std * omega[first] * omega[second],
        "damping": np.sqrt(losses[first] * losses[second] / 3.0),
    }[kind]
    step = 1e-4 * size * both
    moved = responses(STIFFNESS + step, DAMPING) if kind == "stiffness" else responses(STIFFNESS, DAMPING + step)
    change = (moved - responses(STIFFNESS, DAMPING)) / 1e-4 / over
    rows = tests_of.rows
    points = np.array([tests_of.tests[t].channels[c].point for t, c in zip(rows.test, rows.channel, strict=True)])
    lines = np.array([int(np.argmin(np.abs(LINES - hz))) for hz in rows.frequency_hz])
    each = change[lines, points - 1]
    return np.where(rows.part == Part.PHASE, each.imag, each.real)


@pytest.mark.parametrize("share", [1.0, 1.5], ids=["as the model", "half as much again"])
def test_a_column_is_the_change_over_what_was_measured(share: float):
    model = rig()
    over = share * responses(STIFFNESS, DAMPING)
    tests_of = chain(model, over)
    found = CoupledModes(tests_of).columns(tests_of.forward.predict(model))
    pairs = [(0, 1), (1, 2)]  # the first and the last are a factor of two apart
    assert len(found) == 2 * len(pairs)
    for (first, second), columns in zip(pairs, zip(found[::2], found[1::2], strict=True), strict=True):
        for kind, column in zip(("stiffness", "damping"), columns, strict=True):
            wanted = expected(first, second, kind, model, over, tests_of)
            np.testing.assert_allclose(column, wanted, atol=5e-3 * np.max(np.abs(wanted)))


def test_damping_by_ratios_couples_no_less():
    """The same damping of each mode, given mode by mode: the shapes that it belongs to move with the stiffness."""
    squares, shapes = eigh(STIFFNESS, MASS)
    ratios = (np.diag(shapes.T @ DAMPING @ shapes) / (2.0 * np.sqrt(squares))).tolist()
    measured = responses(STIFFNESS, DAMPING)
    found = []
    for model in (rig(), rig(damping_ns_m=None, damping_ratios=ratios)):
        tests_of = chain(model, measured)
        found.append(CoupledModes(tests_of).columns(tests_of.forward.predict(model)))
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, atol=0.03 * np.max(np.abs(one)))


def test_modes_that_are_far_apart_are_not_coupled():
    tests_of = chain(rig(), responses(STIFFNESS, DAMPING))
    assert CoupledModes(tests_of).pairs(np.array([45.0, 80.0, 120.0])) == [(0, 1), (1, 2)]
    assert CoupledModes(tests_of).pairs(np.array([10.0, 45.0, 300.0])) == []


def test_structures_that_are_no_matrices_have_none():
    tests_of = chain(rig(), responses(STIFFNESS, DAMPING))
    masses = {"kind": "chain", "masses_kg": [1.0, 1.0, 1.0], "springs_n_m": [1e5, 1e5]}
    tests_of.rig = validate_rig(RigDocument("test", {"name": "row", "structure": masses, **DRIVE}, {}))
    assert CoupledModes(tests_of).columns(tests_of.forward.predict(rig())) == []


def test_matrices_of_the_rig_file_itself_have_none():
    """A lumped model, of which no mesh and no reduction left out anything."""
    tests_of = chain(rig(source=""), responses(STIFFNESS, DAMPING))
    assert CoupledModes(tests_of).columns(tests_of.forward.predict(rig(source=""))) == []


def test_couplings_are_added_to_lines_and_do_not_multiply_them():
    found = observed(rig(), responses(STIFFNESS, DAMPING))
    tests_of = ChainTests(found, rig(), dict(enumerate(found.chains)))
    columns = linear_chain(found, rig(), tests_of.forward.predict(rig()))
    added = [name for name, is_added in zip(columns.names, columns.added, strict=True) if is_added]
    assert len([name for name in added if name.startswith("CoupledModes")]) == len(added) == 4


def test_a_mass_on_a_spring_is_coupled_to_nothing():
    oscillator = [{"point": 2, "mass_kg": 1e-9, "frequency_hz": 70.0, "damping_ratio": 0.1}]
    found = []
    for model in (rig(), rig(oscillators=oscillator)):
        tests_of = chain(model, responses(STIFFNESS, DAMPING))
        found.append(CoupledModes(tests_of).columns(tests_of.forward.predict(model)))
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-4 * np.max(np.abs(one)))
