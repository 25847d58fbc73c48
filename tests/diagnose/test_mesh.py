"""A coarse mesh of a beam is an error of the model that its own refinement shows, not an effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.predicted_observations import observations_of_model
from diagnose.predicted_tests import rows_of

from nmt_core.messages.blocks import Quantity
from nmt_diagnose.chain.chain_columns import linear_chain
from nmt_diagnose.diagnose import diagnose_observations
from nmt_diagnose.diagnosis_settings import MATTERS, DiagnosisSettings
from nmt_diagnose.fit.fitting import Metric
from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.driven_record import DrivenRecord
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.prediction.forward import Forward
from nmt_rig.rig import Rig, load_rig

COARSE = load_rig("beam", ["local_elements=[]", "structure.elements=7"])


def fine(rig: Rig) -> Rig:
    return rig.model_copy(update={"structure": rig.structure.model_copy(update={"mesh_refinement": 6})})


def test_a_recording_of_a_finer_mesh_is_healthy() -> None:
    observations = observations_of_model(fine(COARSE), seed=4, drives=(0.05, 0.1, 0.2, 0.4))
    chains = tuple(MeasuringChain() for _ in observations.tests)
    observations = replace(observations, chains=chains, matters=dict(MATTERS))
    near = Forward(observations.tests, observations.rows).predict(COARSE)
    chain = linear_chain(observations, COARSE, near)
    column = chain.columns[:, chain.names.index("mesh")]
    moved = Forward(observations.tests, observations.rows).difference(
        Forward(observations.tests, observations.rows).predict(fine(COARSE)).values, near.values
    )
    small = (np.abs(moved) < 0.02) & (np.abs(moved) > 1e-5)
    assert small.sum() > 20
    # Half the element length takes away fifteen sixteenths of an error of fourth order.
    assert np.median(column[small] / moved[small]) == pytest.approx(15.0 / 16.0, abs=0.03)
    found = diagnose_observations(COARSE, observations, DiagnosisSettings(look_ahead=False)).diagnosis
    assert found.verdict in (Verdict.NONE, Verdict.CALIBRATION)


def test_the_mesh_is_an_error_of_records_too() -> None:
    count, rate = 4000, 4000.0
    tap = np.where(np.arange(count) < 20, np.sin(np.pi * np.arange(count) / 20), 0.0)
    channel = MeasuredChannel("a", Quantity.ACCELERATION, 2)
    force = MeasuredChannel("f", Quantity.FORCE, 2)
    test = DrivenRecord("tap", 2, rate, force, tap, (channel,), np.array([0.0, count]), responses=tap[None])
    picks = np.arange(20, count - 20, 7)
    rows = replace(rows_of([(0, 0, 0, 1, Part.SAMPLE) for _ in picks]), time_s=picks / rate)
    values = Forward((test,), rows).predict(fine(COARSE)).values
    size = float(np.std(values))
    chains = (MeasuringChain(),)
    found = Observations((test,), rows, values, np.full(picks.size, 1e-3 * size), np.zeros(picks.size), chains=chains)
    near = Forward((test,), rows).predict(COARSE)
    chain = linear_chain(found, COARSE, near)
    column, moved = chain.columns[:, chain.names.index("mesh")], values - near.values
    assert np.std(moved) > 0.002 * size
    assert np.std(moved - 16.0 / 15.0 * column) < 0.1 * np.std(moved)


def test_a_normal_matrix_without_an_inverse_is_one_of_rounding() -> None:
    column = np.array([[1.0, 1.0], [1.0, 1.0]]) * 1e9
    metric = Metric(column, np.array([0.0, 0.0]), np.ones(2))
    projected, _ = metric.project(np.array([[1.0], [1.0]]))
    assert np.all(np.abs(projected) < 1e-2)
