"""Models that are free, overdamped, stuck, of one mode or none: a result or one true sentence, whatever is measured.

The recordings are of a rig that swings, so that the model is as wrong as a first one may be.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from diagnose.one_of_each_kind import KINDS, rig_of_kinds, with_chain
from diagnose.predicted_tests import chain

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_diagnose.ahead.proposals import Proposals
from nmt_diagnose.chain.chain_columns import linear_chain
from nmt_diagnose.chain.chain_tests import edited, later
from nmt_diagnose.diagnose import diagnose_observations
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.effects.library import library
from nmt_diagnose.ledger.diagnosis import Diagnosis
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.prediction.forward import Forward
from nmt_rig.rig import Rig

_PLAN = (0.05, 0.2, 0.5, 1.0, 1.6, 2.4, 3.2)


def _pair(**changes: Any) -> dict[str, Any]:
    return {
        "kind": "chain", "masses_kg": [0.5, 0.3], "springs_n_m": [15000.0], "dampers_ns_m": [5.0],
        "ground_springs_n_m": [0.0, 0.0], "ground_dampers_ns_m": [4.0, 1.0], **changes,
    }  # fmt: skip


_MODE = {"frequency_hz": 21.0, "damping_ratio": 0.01, "shape": [1.0, 1.3]}
_STICKS = {"kind": "jenkins", "point": 1, "tangential_stiffness_n_m": 20000.0, "slip_force_n": 50.0}
MODELS: dict[str, dict[str, Any]] = {
    "free": {"structure": _pair(springs_n_m=[0.0], dampers_ns_m=[0.0])},
    "free-free": {"structure": _pair(ground_dampers_ns_m=[0.0, 0.0])},
    "overdamped": {
        "structure": _pair(
            dampers_ns_m=[400.0], ground_springs_n_m=[20000.0, 3000.0], ground_dampers_ns_m=[900.0, 400.0]
        )
    },
    "one mode": {"structure": {"kind": "modal", "points": [1, 2], "modes": [_MODE]}},
    "no mode": {"structure": _pair(springs_n_m=[0.0], dampers_ns_m=[30.0])},
    "stuck": {"structure": _pair(), "local_elements": [_STICKS]},
}


def model(name: str) -> Rig:
    """A model, driven by a force."""
    exciter = {"kind": "force", "point": 1}
    return chain(**{"local_elements": [], "exciter": exciter, "extraction": {"linear_modes": 1}, **MODELS[name]})


def recorded(kind: str) -> Observations:
    """A recording of a rig that swings, by an ordinary laboratory."""
    found = with_chain(KINDS[kind](rig_of_kinds()))
    return replace(found, values=found.values + found.std * np.random.default_rng(1).standard_normal(found.std.size))


def diagnosed(name: str, kind: str, effects: tuple[str, ...], look_ahead: bool) -> Diagnosis | None:
    """What a diagnosis says with some effects; None where it says in one sentence that it cannot."""
    withheld = tuple(effect.name for effect in library() if effect.name not in effects)
    settings = DiagnosisSettings(withheld=withheld, plan=_PLAN, other_kinds=True, look_ahead=look_ahead)
    try:
        return diagnose_observations(model(name), recorded(kind), settings).diagnosis
    except BenchError as refused:
        sentence = str(refused)
        assert sentence.endswith(".")
        assert "\n" not in sentence
        return None


_FIRST = {"free", "free-free", "overdamped"}, {"random responses", "stepped responses", "free decay"}
_CELLS = [
    pytest.param(name, kind, marks=() if name in _FIRST[0] and kind in _FIRST[1] else pytest.mark.campaign)
    for name in MODELS
    for kind in KINDS
]


@pytest.mark.parametrize(("name", "kind"), _CELLS)
def test_the_chain_and_what_is_asked_of_tests_ahead_have_no_internal_error(name: str, kind: str) -> None:
    rig, observed = model(name), recorded(kind)
    prediction = Forward(observed.tests, observed.rows).predict(rig)
    columns = linear_chain(observed, rig, prediction)
    assert columns.columns.shape == (len(observed.rows), len(columns.names))
    asked = Proposals(rig, observed)
    for proposal in asked.all(further=True):
        assert np.all(proposal.observations.std > 0.0)
        assert np.all(np.isfinite(proposal.observations.rows.frequency_hz))


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("free", "stepped responses"), ("free", "free decay"), ("no mode", "random responses"),
        ("overdamped", "free decay"), ("one mode", "free decay"), ("stuck", "driven record"),
    ],
)  # fmt: skip
def test_a_diagnosis_has_a_result_or_a_sentence(name: str, kind: str) -> None:
    found = diagnosed(name, kind, (), look_ahead=False)
    assert found is None or found.sentences


@pytest.mark.campaign
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", MODELS)
def test_a_diagnosis_with_its_look_ahead_has_a_result_or_a_sentence(name: str, kind: str) -> None:
    found = diagnosed(name, kind, ("cubic_stiffness", "response_gain"), look_ahead=True)
    assert found is None or found.sentences


def test_a_free_body_swings_at_its_strain_only() -> None:
    """Two masses on a spring: ω² = k (1/m₁ + 1/m₂), although the mode that is asked for is the rigid one."""
    view = ModelView.of(model("free-free"), (1,))
    assert view.modes_hz == pytest.approx([np.sqrt(15000.0 * (1.0 / 0.5 + 1.0 / 0.3)) / (2.0 * np.pi)])
    assert ModelView.of(model("no mode"), (1,)).frequencies_hz == ()


def test_a_channel_of_a_recording_may_have_any_name() -> None:
    """A sensor that is only thought of, and one whose name no rig file would take, are late like others."""
    another = MeasuredChannel("another at 1", Quantity.DISPLACEMENT, 1, ideal=True)
    moved = edited(rig_of_kinds(), another, later)
    assert moved.sensors[-1].channel == "another at 1"
    assert moved.sensors[-1].delay_s > 0.0
