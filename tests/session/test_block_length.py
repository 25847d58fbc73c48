"""Block length of simulated phase resonance tests: the rule, where it is used, and what it costs."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from nmt_pll.loop_settings import LoopSettings
from nmt_rig.linear_description import linear_description
from nmt_rig.rig import load_rig
from nmt_session import Session, plan_test
from nmt_session.block_length import (
    USUAL,
    LevelTime,
    allowed_bandwidth,
    choose_block,
    settling_time,
    tick_blocks,
    wanted_bandwidth,
)
from nmt_session.node_plan import plan_nodes

BEAM = linear_description(load_rig("beam"))
LEVEL = LevelTime(ramp=0.5, window=9.0)


def chosen(linear=BEAM, level=LEVEL, rate=10_000.0, channels=4, **settings):
    return choose_block(linear, LoopSettings(**settings), level, rate, channels)


def test_bandwidths_are_those_of_the_loop():
    plant = (
        BEAM.plant_damping_ratio * BEAM.plant_frequency_rad_s * (1.0 + BEAM.drive_point_shape**2 * BEAM.moving_mass_kg)
    )
    assert wanted_bandwidth(BEAM, LoopSettings()) == pytest.approx((plant + 0.15 * BEAM.frequencies_rad_s[0]) / 3.0)
    assert allowed_bandwidth(LoopSettings(delay_margin=0.3), 0.04) == pytest.approx(0.3 / (1.5 * 0.04))
    assert allowed_bandwidth(LoopSettings(latency_blocks=2), 0.04) == pytest.approx(0.25 / (3.5 * 0.04))


@pytest.mark.parametrize(("length", "blocks"), [(0.02, 5), (0.03, 3), (0.04, 2), (0.05, 2), (0.5, 2)])
def test_the_sequencer_decides_about_ten_times_a_second(length, blocks):
    assert tick_blocks(length) == blocks


def test_longer_windows_and_more_bandwidth_allow_longer_blocks():
    lengths = [chosen(level=replace(LEVEL, window=window)).block_samples for window in (0.5, 2.0, 9.0, 60.0)]
    assert lengths == sorted(lengths)
    assert lengths[0] < lengths[-1]
    assert chosen(delay_margin=0.1).block_samples <= chosen().block_samples <= chosen(delay_margin=0.5).block_samples


def test_a_fast_mode_keeps_the_usual_block():
    """The loop judges a lock in four blocks at least, which is ten periods."""
    fast = linear_description(load_rig("joint_resonator"))
    assert chosen(fast, LevelTime(0.5, 1e6)).block_samples == 200


@pytest.mark.parametrize(
    ("margin", "says"),
    [
        (0.25, "4.17 rad/s for the mode at 22.19 Hz (9.15 without the dead time of 1.5 blocks);"),
        (2.0, "9.15 rad/s for the mode at 22.19 Hz;"),
    ],
)
def test_the_reason_says_a_limit_only_where_dead_time_is_one(margin, says):
    assert f"loop bandwidth {says}" in chosen(delay_margin=margin).reason


def test_a_held_amplitude_settles_slower():
    held = replace(LEVEL, holds_amplitude=True)
    assert settling_time(BEAM, LoopSettings(), held, 0.04) > settling_time(BEAM, LoopSettings(), LEVEL, 0.04)
    assert chosen(level=held).block_samples <= chosen().block_samples


def test_large_messages_keep_the_usual_block():
    assert chosen(channels=100).block_samples == round(USUAL * 10_000.0)


def test_no_choice_costs_more_than_it_says():
    settings = LoopSettings()
    usual = settling_time(BEAM, settings, LEVEL, USUAL)
    length = chosen().block_samples / 10_000.0
    assert settling_time(BEAM, settings, LEVEL, length) - usual <= 0.03 * (LEVEL.ramp + LEVEL.window + usual + 1.0)


def test_the_chosen_length_is_in_rig_text_nodes_and_run():
    plan = plan_test("beam")
    block = plan.rig.block_samples
    assert block > 200
    assert yaml.safe_load(plan.rig_yaml)["block_samples"] == block
    assert "# The virtual experiment" in plan.rig_yaml
    nodes = plan_nodes(plan, Path("bag"), Path("rig.yaml"))
    assert {nodes.pll.block_samples, nodes.sequencer.block_samples} == {block}
    assert nodes.sequencer.tick_blocks == tick_blocks(block / 1e4)
    assert nodes.run["block"] == {"samples": block, "reason": plan.block_reason}
    assert "22.19 Hz" in plan.block_reason


@pytest.mark.parametrize(
    ("rig", "options"),
    [
        ("beam", {"overrides": ["block_samples=200"]}),
        ("beam", {"pacing": "realtime"}),
        ("beam", {"latency_blocks": 1}),
        ("beam", {"strategy": "ramp"}),
        ("beam", {"overrides": ["pll.loop=paper"]}),
        ("beam", {"overrides": ["pll.proportional=5", "pll.integral=10"]}),
        ("beam", {"node_values": {"sequencer": {"tick_blocks": 5}}}),
        ("beam", {"node_values": {"pll": {"loop": "paper"}}}),
        ("beam", {"levels": [0.1], "test": "random", "band_hz": (5.0, 500.0), "duration": 5.0}),
        ("beam", {"levels": [0.1], "test": "stepped_sine", "frequencies_hz": (20.0,)}),
        ("clamped_beam", {}),
    ],
)
def test_what_is_given_or_depends_on_wall_time_stays(rig, options):
    plan = plan_test(rig, **options)
    assert plan.rig.block_samples == (100 if rig == "clamped_beam" else 200)
    assert plan.block_reason == ""
    assert plan.tick_blocks == 5


def test_a_recorded_rig_gives_the_same_block_again(tmp_path):
    plan = plan_test("beam")
    path = tmp_path / "rig.yaml"
    path.write_text(plan.rig_yaml, encoding="utf-8")
    again = plan_test(path)
    assert again.rig == plan.rig
    assert again.block_reason == ""


@pytest.mark.campaign
def test_results_agree_with_those_of_short_blocks_at_little_more_bench_time():
    results = []
    for changes in ([], ["block_samples=200"]):
        with Session(plan_test("beam", overrides=changes), record=False) as session:
            results.append(session.run())
    chosen_blocks, short = results
    assert chosen_blocks.bench_time <= 1.03 * short.bench_time
    for one, other in zip(chosen_blocks.points, short.points, strict=True):
        assert math.isclose(one.frequency_hz, other.frequency_hz, rel_tol=5e-6)
        assert math.isclose(one.damping_ratio, other.damping_ratio, rel_tol=5e-4)


def test_the_loop_may_ask_for_no_more_than_the_rig_bears() -> None:
    test = plan_test("beam", [0.1], overrides=["limits.voltage_v=7.5"])
    plan = plan_nodes(test, Path("bag"), Path("rig.yaml"))
    assert plan.pll.loop_settings.voltage_limit == 7.5
    assert plan.plant.rig_file == "rig.yaml"
