"""A force channel that is late makes the loop hold another phase: amplitudes fall with the cosine of it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from diagnose.twin_observations import chain, observations_of_twin, real

from nmt_diagnose.inference.chain_errors import chain_errors, with_shared
from nmt_diagnose.inference.diagnose import diagnose_observations
from nmt_diagnose.inference.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.inference.true_phase import LEAST_CHANGE, at_true_phases, chain_share, phase_offset
from nmt_diagnose.observations.conditions import PhaseResonanceTest
from nmt_diagnose.observations.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Observations, Part
from nmt_diagnose.twin.forward import Forward
from nmt_rig.rig import Rig

LATE_S = 8e-4


def light() -> Rig:
    """Two masses, linear and lightly damped."""
    dampers = {"dampers_ns_m": [0.4], "ground_dampers_ns_m": [0.3, 0.1]}
    return real(chain(local_elements=[]), structure=dampers)


def recorded(late_s: float) -> Observations:
    """Exact tests of a linear rig whose force channel is late, from a laboratory with ordinary tolerances."""
    linear = light()
    sensors = [s.model_copy(update={"delay_s": late_s}) if s.quantity == "force" else s for s in linear.sensors]
    found = observations_of_twin(linear.model_copy(update={"sensors": sensors}), noise=0.0)
    return replace(found, std=0.1 * found.std, chains=(MeasuringChain(shared_delay_s=LATE_S),) * len(found.tests))


def measured_phase(observations: Observations) -> float:
    """The delay's phase at the frequency that the loop found, rad."""
    rows = observations.rows
    return math.exp(observations.values[(rows.part == Part.LOG_FREQUENCY) & (rows.level == 0)][0]) * LATE_S


def test_amplitudes_fall_with_the_cosine_of_the_phase() -> None:
    """Near a single resonance |ωX / F| is proportional to cos δ; to first order in δ it stays."""
    late, punctual = recorded(LATE_S), recorded(0.0)
    rows, phase = late.rows, measured_phase(late)
    size = (rows.test == 0) & (rows.part == Part.LOG_MAGNITUDE) & (rows.harmonic == 1)
    test = late.tests[0]
    assert isinstance(test, PhaseResonanceTest)
    names = [channel.name for channel in test.channels]
    response, force = (size & (rows.channel == names.index(name)) for name in ("x1", "f1"))
    change = late.values - punctual.values
    fell = change[response] - change[force] + change[rows.part == Part.LOG_FREQUENCY]
    # The other mode has a share.
    assert fell == pytest.approx(math.log(math.cos(phase)), rel=0.1)


def test_locked_windows_are_predicted_where_they_stood() -> None:
    """Exact observations: linear errors leave the square of the phase, errors about the true phase leave nothing."""
    observations, model = recorded(LATE_S), light()
    forward = Forward(observations.tests, observations.rows)
    prediction = forward.predict(model)
    plain = Problem(observations, forward)
    left, offset, moves = [], None, []
    for _ in range(4):
        noisy, columns = chain_errors(plain, model, prediction)
        difference = plain.difference(prediction.values)
        whitened = with_shared(noisy, columns).whitened(difference)
        left.append(float(whitened @ whitened))
        share = chain_share(noisy, columns, difference)
        observations, change = at_true_phases(observations, model, prediction, share)
        moves.append(change)
        forward = Forward(observations.tests, observations.rows)
        prediction = forward.predict(model, prediction)
        offset = phase_offset(observations, model, prediction)
        plain = Problem(observations, forward, offset=offset)
    test = observations.tests[0]
    assert isinstance(test, PhaseResonanceTest)
    assert [abs(level.phase_moved) for level in test.levels] == pytest.approx(
        [measured_phase(observations)] * 8, rel=0.02
    )
    assert np.allclose([level.phase_error - level.phase_moved for level in test.levels], 0.0, atol=1e-12)
    assert left[0] > 100.0
    assert left[-1] < 3.0
    assert moves[-1] < LEAST_CHANGE


def test_a_late_force_is_not_taken_for_damping() -> None:
    """The delay is within what the laboratory may be off by; damping of the model is right within what is stated."""
    model = light()
    found = diagnose_observations(model, recorded(LATE_S), DiagnosisSettings(look_ahead=False)).diagnosis
    assert found.verdict.value in ("none", "calibration")
    dampers = [each for each in found.calibration if "damper" in each.name]
    assert dampers
    for each in dampers:
        assert abs(each.to - each.start) < each.std
