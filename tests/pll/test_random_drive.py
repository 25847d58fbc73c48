from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import BlockFlag, Quantity, SampleBlock
from nmt_core.messages.records import LevelCommand
from nmt_core.vocabulary import ControlKind, LoopState, TestKind, Waveform
from nmt_pll.open_loop.random_drive import RandomDrive

RATE, BLOCK = 1000.0, 100
LEVEL = LevelCommand(
    sequence=1,
    index=0,
    amplitude=0.3,
    apply_at_sample=200,
    ramp=0.5,
    window_periods=200,
    test=TestKind.RANDOM,
    band_low_hz=10.0,
    band_high_hz=200.0,
    duration=0.73,
)


def blocks(first: int, flags: int = 0) -> tuple[SampleBlock, SampleBlock]:
    data = np.full((1, BLOCK), 2.0)
    data[0, ::2] = -2.0
    force = SampleBlock(first, RATE, Quantity.FORCE, "N", ("f2",), (2,), data, flags=flags)
    return force, replace(force, quantity=Quantity.DISPLACEMENT, unit="m", channels=("x2",), data=0.5 * data)


def answers(loop: RandomDrive, count: int, flags_from: int | None = None):
    flags = int(BlockFlag.LIMIT)
    for k in range(count):
        yield loop.process(*blocks(k * BLOCK, flags if flags_from is not None and k >= flags_from else 0))


def test_the_window_opens_after_ramp_settling_time_and_latency():
    loop = RandomDrive(2, RATE, BLOCK, settling_time=1.0, latency_blocks=2)
    loop.set_level(LEVEL)
    outputs = list(answers(loop, 40))
    locks = [output.lock for output in outputs if output.lock is not None]
    assert len(locks) == 1
    lock = locks[0]
    # level at sample 200, answered by the end of its block (300), two blocks of latency, ramp and settling time 1.5 s
    assert lock.first_sample == 300 + 200 + 1500
    assert lock.samples == 730
    assert (lock.periods, lock.frequency_hz) == (0, 0.0)
    assert math.isnan(lock.phase_error)
    assert outputs[1].amplitude == 0.0
    after = outputs[2]
    assert (after.waveform, after.amplitude, after.ramp) == (Waveform.RANDOM, 0.3, 0.5)
    assert (after.band_low_hz, after.band_high_hz) == (10.0, 200.0)
    assert (after.force_amplitude, after.response_amplitude) == pytest.approx((2.0, 1.0))
    assert outputs[-1].state == LoopState.LOCKED


def test_a_limit_ends_it():
    loop = RandomDrive(2, RATE, BLOCK, quiet_ramp=0.25, settling_time=1.0)
    loop.set_level(LEVEL)
    last = list(answers(loop, 30, flags_from=25))[-1]
    assert last.state == LoopState.LOCK_LOST
    assert (last.amplitude, last.ramp) == (0.0, 0.25)


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"test": TestKind.SWEEP}, "no sweep test"),
        ({"control": ControlKind.FORCE}, "voltage"),
        ({"band_high_hz": 500.0}, "half the sample rate"),
        ({"duration": 0.0}, "duration"),
        ({"amplitude": math.nan}, "finite"),
    ],
)
def test_levels_it_cannot_do_are_refused_and_answered(fields, sentence):
    loop = RandomDrive(2, RATE, BLOCK)
    level = replace(LEVEL, **fields)
    with pytest.raises(BenchError, match=sentence):
        loop.set_level(level)
    loop.reject(level, "it cannot be done")
    outputs = list(answers(loop, 4))
    transitions = [output.transition for output in outputs if output.transition is not None]
    assert [(item.state, item.reason) for item in transitions] == [(LoopState.LOCK_LOST, "it cannot be done")]
    assert loop.newest_sequence == 1
    assert all(output.amplitude == 0.0 for output in outputs)
