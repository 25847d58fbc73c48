"""Recordings that tempt to an effect and have none, and recordings that have one."""

from __future__ import annotations

import numpy as np
import pytest
from diagnose.court.small_rigs import TO_GROUND, backbone, chain_rig, chain_tables, diagnosed, one_mode_rig
from tiers import with_quick

from nmt_diagnose.ledger.diagnosis import Verdict

HEALTHY = (Verdict.NONE, Verdict.CALIBRATION)


@pytest.mark.court(not_said="effect")
@pytest.mark.parametrize("stated", with_quick([0.3, 1.0, 3.0], 0.3))
def test_a_healthy_table_has_no_effect(stated: float) -> None:
    """Uncertainties that are stated too small or too large, and gains a little beyond an ordinary chain."""
    gains = 1.0 + 0.0125 * np.random.default_rng(int(10 * stated)).standard_normal(3)
    assert diagnosed(chain_rig(), chain_tables(1, stated, gains)).verdict in HEALTHY


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(20))
def test_healthy_tables_have_no_effect(seed: int) -> None:
    generator = np.random.default_rng(1000 + seed)
    stated, gains = float(np.exp(generator.uniform(*np.log((0.3, 3.0))))), 1.0 + 0.0125 * generator.standard_normal(3)
    assert diagnosed(chain_rig(), chain_tables(seed, stated, gains)).verdict in HEALTHY


@pytest.mark.court(not_said="effect")
@pytest.mark.parametrize("stated", with_quick([0.3, 1.0, 3.0], 0.3))
@pytest.mark.parametrize("stiffer", with_quick([1.0, 1.02], 1.02))
def test_a_healthy_backbone_has_no_effect(stated: float, stiffer: float) -> None:
    assert diagnosed(one_mode_rig(), backbone(2, stated=stated, stiffer=stiffer)).verdict in HEALTHY


@pytest.mark.campaign
@pytest.mark.court(not_said="effect")
def test_a_gain_of_two_and_a_half_per_cent_is_no_stop_and_no_mass() -> None:
    """All three accelerometers louder by two and a half tolerances, which one law cannot stand in for."""
    found = diagnosed(chain_rig(), chain_tables(3, 3.0, (1.025, 0.975, 1.025)))
    assert found.verdict in HEALTHY


@pytest.mark.court(said="effect")
def test_a_cubic_spring_is_named() -> None:
    found = diagnosed(one_mode_rig(), backbone(4, cubic=3e9))
    assert found.verdict is Verdict.EFFECT
    assert "cubic_stiffness" in (found.ranking[0].effect, *found.ranking[0].equivalents)
    assert found.ranking[0].parameters["k"].value == pytest.approx(3e9, rel=0.1)


@pytest.mark.campaign
@pytest.mark.court(said="effect")
def test_a_spring_to_the_ground_that_the_model_lacks_is_named() -> None:
    found = diagnosed(chain_rig(), chain_tables(7, more=(0.0, 400.0, 0.0)))
    assert found.verdict is Verdict.EFFECT
    head = found.ranking[0]
    assert ("added_stiffness" in (head.effect, *head.equivalents), head.detail) == (True, "2")
    assert head.parameters["k"].value == pytest.approx(400.0, abs=4.0 * head.parameters["k"].std)
    assert head.parameters["k"].std < 80.0


@pytest.mark.campaign
@pytest.mark.court(not_said="effect")
def test_a_spring_that_the_model_has_and_that_is_stiffer_is_its_own_parameter() -> None:
    found = diagnosed(chain_rig(), chain_tables(7, more=(0.0, 0.0, 300.0)))
    assert found.verdict is Verdict.CALIBRATION
    moved = max(found.calibration, key=lambda item: abs(item.sigmas))
    assert moved.name == "structure.ground_springs_n_m.2"
    assert moved.to == pytest.approx(TO_GROUND[2] + 300.0, abs=4.0 * moved.std)


@pytest.mark.court(said="effect")
def test_air_drag_is_named() -> None:
    found = diagnosed(one_mode_rig(), backbone(5, drag=20.0))
    assert found.verdict is Verdict.EFFECT
    assert "air_drag" in (found.ranking[0].effect, *found.ranking[0].equivalents)


@pytest.mark.campaign
@pytest.mark.court(said="effect")
def test_a_gain_of_a_fifth_is_named_with_its_channel() -> None:
    found = diagnosed(chain_rig(), chain_tables(6, 1.0, (1.0, 1.2, 1.0)))
    assert found.verdict is Verdict.EFFECT
    assert found.ranking[0].effect == "response_gain"
    assert "a2" in found.ranking[0].detail
