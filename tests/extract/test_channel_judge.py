"""Faults of single channels planted in the middle of a run, and shapes that are strange without a fault."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from nmt_core.messages.blocks import SampleBlock
from nmt_core.messages.records import LevelCommand
from nmt_core.vocabulary import PointStatus
from nmt_extract.judgement.channel_noise import unrepeated_rms
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_session import Session, plan_test
from nmt_signals.channel_faults.clipping import flat_top

LEVELS = [0.15, 0.35, 0.8]
RANDOM = np.random.default_rng(3)

Change = Callable[[np.ndarray, np.ndarray], np.ndarray]


def run(rig: str, levels: list[float], channel: str = "", change: Change | None = None, **plan: Any) -> Any:
    """Points of a run; from its second level on a channel is changed: (values, the 100 values before) -> values."""
    test = plan_test(rig, levels, window_periods=24, **plan)
    on = [False]

    class Device(SimulatedRig):
        tail = np.zeros(100)

        def read(self) -> Any:
            return [self.changed(block) for block in super().read()]

        def changed(self, block: SampleBlock) -> SampleBlock:
            if channel not in block.channels or change is None:
                return block
            row = block.channels.index(channel)
            data = block.data.copy()
            if on[0]:
                data[row] = change(data[row], self.tail)
            self.tail = np.concatenate([self.tail, block.data[row]])[-100:]
            return dataclasses.replace(block, data=data)

    def listen(_: str, record: Any) -> None:
        on[0] = on[0] or (isinstance(record, LevelCommand) and record.index == 1)

    with Session(test, device=Device(test.rig), listener=listen, record=False) as session:
        return session.run().points


def late(samples: int) -> Change:
    return lambda values, before: np.concatenate([before[100 - samples :], values])[: values.size]


@pytest.fixture(scope="module")
def clean() -> Any:
    return run("beam", LEVELS)


@pytest.mark.parametrize(
    ("channel", "change", "words"),
    [
        ("x6", lambda values, _: 0.0 * values, "is dead"),
        ("x6", lambda values, _: 1e-8 * RANDOM.standard_normal(values.size), "does not follow"),
        ("x6", lambda values, _: np.clip(values, -1.5e-4, 1.5e-4), "flat-topped at 0.00015 m"),
        ("x4", lambda values, _: np.clip(values, -9e-5, 1.0), "flat-topped at -9e-05 m"),
        ("x6", lambda values, _: -values, "wrong sign"),
        ("x5", lambda values, _: 1.4 * values, "1.40 times"),
        ("x5", late(60), "late"),
        ("x4", lambda values, _: values + 3e-5 * RANDOM.standard_normal(values.size), "of noise"),
        ("x5", lambda values, _: np.sign(values) * np.maximum(np.abs(values) - 5e-5, 0.0), "times"),
        ("x2", lambda values, _: 0.0 * values, ""),
        ("x2", lambda values, _: np.sign(values) * np.maximum(np.abs(values) - 2e-5, 0.0), "x2"),
        ("x2", lambda values, _: -values, ""),
        ("f2", lambda values, _: 0.0 * values, ""),
        ("f2", lambda values, _: np.clip(values, -0.1, 0.1), "f2 is flat-topped"),
        ("f2", lambda values, _: 2.0 * values, "what voltage and response say"),
        ("f2", lambda values, _: 0.5 * values, "what voltage and response say"),
    ],
    ids=(
        "far dead", "far open", "far clipped", "clipped on one side", "sign", "gain", "late", "noise", "loose",
        "drive dead", "drive loose", "drive sign", "force dead", "force clipped", "force doubled", "force halved",
    ),
)  # fmt: skip
def test_a_channel_that_fails_in_a_run_is_named_and_no_damping_is_wrong(
    channel: str, change: Change, words: str, clean: Any
) -> None:
    points = run("beam", LEVELS, channel, change)
    assert points[0].identical(clean[0])
    said = " ".join(point.reason for point in points[1:])
    for point, truth in zip(points[1:], clean[1:], strict=False):
        if point.status is PointStatus.OK:
            assert abs(point.damping_ratio - truth.damping_ratio) < 2.0 * point.damping_ratio_std + 1e-5
    assert words in said
    assert said


@pytest.mark.parametrize(
    ("channel", "change"),
    [("a3", lambda values, _: 0.0 * values), ("a2", lambda values, _: 1.4 * values), ("a3", late(3))],
    ids=("dead", "gain", "late"),
)
def test_three_channels_of_three_modes_are_enough_to_tell(channel: str, change: Change) -> None:
    levels = [1.0, 3.0, 9.0]
    for point, truth in zip(
        run("joint_resonator", levels, channel, change)[1:], run("joint_resonator", levels)[1:], strict=True
    ):
        assert point.reason.startswith(f"Left out: {channel} ")
        assert abs(point.damping_ratio - truth.damping_ratio) < 2.0 * point.damping_ratio_std


@pytest.mark.parametrize(
    ("rig", "levels", "plan"),
    [
        ("beam", [0.05, 1.5], {}),
        ("joint_resonator", [18.0, 0.25], {}),
        ("clamped_beam", [0.005, 0.3], {}),
        ("beam", [0.7296, 1.065], {"exciter": 4}),
        ("beam", [0.5, 2.0], {"exciter": 6, "overrides": ["local_elements.0.point=2",
                                                           "local_elements.0.tangential_stiffness_n_m=500000"]}),
    ],
    ids=("friction", "joint", "stiffening", "harmonics of slip beyond the tenth", "slip at the drive"),
)  # fmt: skip
def test_a_shape_that_changes_much_from_level_to_level_is_no_fault(rig: str, levels: list[float], plan: Any) -> None:
    assert [(p.status, p.reason) for p in run(rig, levels, **plan)] == [(PointStatus.OK, "")] * 2


def test_what_comes_again_each_period_is_no_noise() -> None:
    samples_per_period = 61.3
    time = np.arange(4000) / samples_per_period
    noise = 0.1 * RANDOM.standard_normal(time.size)
    assert unrepeated_rms(np.sin(2 * math.pi * 15 * time), samples_per_period) < 0.3 * math.sqrt(0.5)
    assert unrepeated_rms(noise, samples_per_period) == pytest.approx(0.09, rel=0.1)


def test_a_flat_top_is_told_from_rest_square_waves_and_coarse_samples() -> None:
    time = np.arange(4000) / 61.3
    sine = np.sin(2 * math.pi * time)
    assert flat_top(sine, 61.3) is None
    assert flat_top(np.minimum(sine, 0.95), 61.3) == 0.95
    assert flat_top(np.round(sine, 1), 61.3) is None
    assert flat_top(np.sin(2 * math.pi * np.arange(4000) / 8), 8.0) is None
    # A body that stops against friction rests for a while; it comes to rest without a jump of its velocity.
    phase = np.mod(time, 1.0)
    moving = np.clip((np.mod(phase, 0.5)) / 0.35, 0.0, 1.0)
    assert flat_top(np.where(phase < 0.5, 1.0, -1.0) * np.cos(math.pi * moving), 61.3) is None
