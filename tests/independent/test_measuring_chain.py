"""Recordings of the second laboratory through measuring chains of ordinary tolerances, diagnosed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from independent.laboratory import Chain, MeasuringChain, record

from nmt_bench.data_import import import_data
from nmt_diagnose.diagnose import diagnose_bags
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.ledger.diagnosis import Diagnosis

START_HZ = 96.9676
SEED = 101


def diagnosed(folder: Path, chain: Chain, measuring: MeasuringChain, levels: Sequence[float]) -> Diagnosis:
    """Record, import and diagnose; the model is without nonlinear forces and source resistance."""
    recorded = record(folder, chain, measuring, tuple(levels), start_hz=START_HZ, random_seconds=12.0)
    bag = folder / "imported"
    import_data(recorded.sidecar, bag)
    return diagnose_bags(recorded.model, [bag], settings=DiagnosisSettings(look_ahead=False)).diagnosis


@pytest.mark.campaign
@pytest.mark.parametrize("seed", [2, 7])
def test_a_healthy_recording_raises_no_alarm(tmp_path: Path, seed: int) -> None:
    """Gains of 1 %, phases of 0.2°, a delay, a held drive with a third harmonic of 0.1 %.

    The second was called an effect where lines on top of its resonances counted for more than sensors are flat to.
    """
    found = diagnosed(tmp_path, Chain(), MeasuringChain.drawn(seed), (0.2, 0.5, 1.0))
    assert found.verdict.value == "none"


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("chain", "weak", "effect", "parameters"),
    [
        pytest.param(Chain(), 0.95, "response_gain", {"g": -0.05}, id="gain"),
        pytest.param(Chain(source_resistance=1.5), 1.0, "source_impedance", {"R": 1.5}, id="source"),
    ],
)
def test_an_effect_beyond_the_tolerances_is_named(
    tmp_path: Path, chain: Chain, weak: float, effect: str, parameters: dict[str, float]
) -> None:
    measuring = MeasuringChain.drawn(SEED)
    gains = (*measuring.gains[:3], weak * measuring.gains[3], *measuring.gains[4:])
    found = diagnosed(tmp_path, chain, replace(measuring, gains=gains), (0.2, 0.4, 0.6, 0.8, 1.0))
    head = found.ranking[0]
    assert (found.verdict.value, head.effect) == ("effect", effect)
    for key, value in parameters.items():
        assert abs(head.parameters[key].value - value) < 3.0 * head.parameters[key].std
