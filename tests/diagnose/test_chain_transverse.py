"""Transverse sensitivity as an error of the measuring chain: columns against y₁ + s y₂, and what is ordinary."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnose.predicted_observations import chain, observations_of_model

from nmt_core.numerics.arrays import ComplexArray
from nmt_core.tolerances import TOLERANCES
from nmt_diagnose.effects.library import library
from nmt_diagnose.inference.chain import linear_chain
from nmt_diagnose.inference.explanations import FittedExplanation
from nmt_diagnose.inference.size import needed
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Observations, Part
from nmt_diagnose.prediction.forward import Forward

TWO = [
    {"quantity": "force", "point": "drive"},
    {"quantity": "displacement", "point": 1},
    {"quantity": "displacement", "point": 2},
    {"quantity": "voltage"},
]


def response(observations: Observations, channel: int, harmonic: int) -> ComplexArray:
    """Fundamentals of a channel in the locked windows, (levels,)."""
    rows = observations.rows
    selected = (rows.test == 0) & (rows.channel == channel) & (rows.harmonic == harmonic)
    size, angle = (observations.values[selected & (rows.part == part)] for part in (Part.LOG_MAGNITUDE, Part.PHASE))
    return np.asarray(np.exp(size + 1j * angle))


def test_columns_are_those_of_a_sum_of_two_motions() -> None:
    rig = chain(sensors=TWO, local_elements=[])
    observations = observations_of_model(rig, noise=0.0, drives=(0.1, 0.4))
    observations = replace(observations, chains=tuple(MeasuringChain() for _ in observations.tests))
    prediction = Forward(observations.tests, observations.rows).predict(rig)
    found = linear_chain(observations, rig, prediction)
    names = [channel.name for channel in observations.tests[0].channels]  # type: ignore[union-attr]
    rows, picked = observations.rows, [name for name in found.names if name.startswith("transverse")]
    assert picked == ["transverse x1", "transverse x2"]
    # The loop holds the phase of x1, whose errors move all other channels with it.
    moved, held = names.index("x2"), names.index("x1")
    ratio = response(observations, held, 1) / response(observations, moved, 1)
    column = found.columns[:, found.names.index("transverse x2")]
    for part, value in ((Part.LOG_MAGNITUDE, ratio.real), (Part.PHASE, ratio.imag)):
        selected = (rows.test == 0) & (rows.channel == moved) & (rows.harmonic == 1) & (rows.part == part)
        assert column[selected] == pytest.approx(TOLERANCES.transverse * value, rel=2e-3, abs=1e-9)
    assert not column[(rows.test == 0) & (rows.channel == held)].any()


def test_a_pick_up_within_its_tolerance_is_no_effect() -> None:
    effects = {effect.name: effect for effect in library()}
    transverse, cubic = effects["transverse_sensitivity"], effects["cubic_stiffness"]

    def small(share: float, names: tuple[str, ...], *members: Any) -> list[int]:
        values = {"transverse_sensitivity": {"s": share}, "cubic_stiffness": {"k": 1.0}}
        fit: Any = SimpleNamespace(
            theta=None, parametrisation=SimpleNamespace(values=lambda _, k: values[members[k].name])
        )
        added: Any = tuple(SimpleNamespace(effect=effect, cause=effect.name) for effect in members)
        data: Any = SimpleNamespace(chain_names=names)
        found = FittedExplanation(added, fit)
        return sorted(needed(data, found, [], {}).small)

    ordinary, large = 2.9 * TOLERANCES.transverse, 3.1 * TOLERANCES.transverse
    assert small(ordinary, ("gain x1",), cubic, transverse) == [1]
    assert small(-ordinary, ("gain x1",), cubic, transverse) == [1]
    assert small(large, ("gain x1",), cubic, transverse) == []
    assert small(ordinary, (), cubic, transverse) == []  # the bench's own sensors have no tolerances
    assert small(ordinary, ("gain x1",), transverse) == []
