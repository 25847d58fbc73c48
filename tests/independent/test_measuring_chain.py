"""Recordings of the second laboratory through measuring chains of ordinary tolerances, diagnosed."""

from __future__ import annotations

from pathlib import Path

import pytest
from independent.campaign import INJECTED_EFFECTS, SEED, diagnosed
from independent.laboratory import Chain, MeasuringChain


@pytest.mark.campaign
@pytest.mark.parametrize("seed", [2, 7])
def test_a_healthy_recording_raises_no_alarm(tmp_path: Path, seed: int) -> None:
    """Gains of 1 %, phases of 0.2°, a delay, a held drive with a third harmonic of 0.1 %.

    The second was called an effect where lines on top of its resonances counted for more than sensors are flat to.
    """
    found = diagnosed(tmp_path, Chain(), MeasuringChain.drawn(seed), (0.2, 0.5, 1.0))
    assert found.verdict.value == "none"


@pytest.mark.campaign
@pytest.mark.parametrize("name", ["gain", "source"])
def test_an_effect_beyond_the_tolerances_is_named(tmp_path: Path, name: str) -> None:
    truth = INJECTED_EFFECTS[name]
    measuring = truth.change(MeasuringChain.drawn(SEED))
    found = diagnosed(tmp_path, truth.chain, measuring, (0.2, 0.4, 0.6, 0.8, 1.0))
    head = found.ranking[0]
    assert (found.verdict.value, head.effect) == ("effect", truth.effect)
    for key, value in truth.parameters.items():
        assert abs(head.parameters[key].value - value) < 3.0 * head.parameters[key].std
