"""Ring-down of the simulated beam: phase-locked, switched off, decaying with the damping of structure and exciter."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from pll.closed_loop import ClosedLoop

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.vocabulary import LoopState, TestKind
from nmt_pll.loop_settings import LoopSettings

SETTINGS = LoopSettings(force_floor=1e-9)


@pytest.mark.parametrize("latency", [0, 2])
def test_the_window_is_the_free_decay(latency):
    loop = ClosedLoop(settings=replace(SETTINGS, latency_blocks=latency))
    kept = []
    loop.spoil = lambda force, response: (kept.append((force, response)), (force, response))[1]
    outcome = loop.run_level(0.1, test=TestKind.RING_DOWN, duration=0.8)
    lock = outcome.lock
    assert lock is not None
    assert lock.samples == 8000
    assert lock.first_sample == lock.sample + 1 + 200 * latency
    assert lock.frequency_hz == pytest.approx(139.434 / (2 * math.pi), rel=2e-4)
    assert all(item.state == LoopState.LOCKED and item.amplitude == 0.0 for item in outcome.window)
    assert outcome.window[0].ramp == pytest.approx(1.0 / lock.frequency_hz)
    force = np.concatenate([block.data[0] for block, _ in kept])
    motion = np.concatenate([block.data[block.points.index(2)] for _, block in kept])
    period = round(10_000 / lock.frequency_hz)
    before = np.abs(motion[lock.first_sample - period : lock.first_sample]).max()
    assert np.abs(force[: lock.first_sample]).max() > 0.0
    # Free decay of structure and exciter together, by the damped eigenvalue of the assembled rig.
    decay = loop.linear.plant_damping_ratio * loop.linear.plant_frequency_rad_s
    peaks = [np.abs(motion[lock.first_sample + k * period :][:period]).max() for k in range(2, 12)]
    slope = np.polyfit(np.arange(10) * period / 10_000, np.log(peaks), 1)[0]
    assert -slope == pytest.approx(decay, rel=0.02)
    assert peaks[0] < before
    # The oscillator goes on as the reference of the phase.
    phases = [block.oscillator for block, _ in kept if block.first_sample >= lock.first_sample]
    assert len({phase.frequency_hz for phase in phases}) == 1
    turns = np.diff([phase.cycles for phase in phases]) - phases[0].frequency_hz * 0.02
    assert np.allclose(turns, np.round(turns), atol=1e-9)


def test_the_next_level_is_driven_again():
    loop = ClosedLoop(settings=SETTINGS)
    for amplitude in (0.1, 0.2):
        outcome = loop.run_level(amplitude, test=TestKind.RING_DOWN, duration=0.3, ramp=0.2)
        assert outcome.lock is not None
        assert outcome.lock.level.amplitude == amplitude
        driven = [item for item in outcome.outputs if item.last_sample < outcome.lock.sample]
        assert driven[-1].amplitude == amplitude


def test_what_cannot_be_switched_off_so_is_refused():
    loop = ClosedLoop(response=Quantity.DISPLACEMENT)
    with pytest.raises(BenchError, match="duration above 0 s"):
        loop.order(0.1, test=TestKind.RING_DOWN)
    with pytest.raises(BenchError, match="at most 1 period"):
        LoopSettings(switch_off_periods=1.5)
