"""The phase-locked loop on the frame with two shakers: harmonics with a force per volt that is wrong, and lines."""

from __future__ import annotations

import numpy as np
import pytest
from pll.stepped_loop import SteppedLoop
from tiers import with_quick

from nmt_core.messages.blocks import Quantity
from nmt_core.messages.records import LevelCommand
from nmt_core.vocabulary import LoopState
from nmt_pll.force_control.force_per_volt import table_of
from nmt_pll.loop_settings import LoopSettings
from nmt_pll.phase_loop.loop import PhaseLockedLoop
from nmt_rig.linear_description import linear_description
from nmt_rig.rig import load_rig

HIGHEST = 5


def frame_loop(factor=1.0):
    """Frame and loop; ``factor`` is what the loop takes the force per volt to be, over what it is."""
    rig = load_rig("frame", [])
    linear = linear_description(rig)
    known = table_of(linear.exciter_force_rows, 2)
    settings = LoopSettings(voltage_limit=float(rig.limits.voltage_v))
    loop = PhaseLockedLoop(linear, settings, rig.sample_rate_hz, rig.block_samples, lambda f: factor * known(f))
    return SteppedLoop(rig, loop, Quantity.ACCELERATION)


def run_level(bench, number, amplitude, seconds=20.0, **fields):
    """Until the lock: s of bench time that it took."""
    begun = bench.next_sample
    bench.loop.set_level(
        LevelCommand(number + 1, number, amplitude, begun, 0.5, window_periods=20, timeout=seconds, **fields)
    )
    while bench.next_sample < begun + seconds * bench.device.sample_rate:
        output = bench.step()
        assert output.state != LoopState.LOCK_LOST, output.transition
        if output.lock is not None:
            return (bench.next_sample - begun) / bench.device.sample_rate
    raise AssertionError(bench.loop.forces.obstacle)


def force_harmonics(bench, blocks=50):
    """Harmonics 1 … 5 of both forces over a second, N, by least squares; shape (2, 5)."""
    data, phase = [], []
    for _ in range(blocks):
        bench.step()
        block = bench.blocks[Quantity.FORCE]
        data.append(block.data)
        phase.append(block.oscillator.phase(block.samples, bench.device.sample_rate))
    theta = np.concatenate(phase)
    orders = np.arange(1, 10)
    basis = np.exp(1j * np.outer(theta, orders))
    real = np.column_stack([basis.real, -basis.imag])
    solution = np.linalg.lstsq(real, np.concatenate(data, axis=1).T, rcond=None)[0]
    return (solution[:9] + 1j * solution[9:]).T[:, :HIGHEST]


@pytest.mark.parametrize("factor", with_quick([1.0, 2.0, 0.5], 2.0))
def test_harmonics_of_both_forces_vanish_with_a_force_per_volt_that_is_twice_or_half(factor):
    bench = frame_loop(factor)
    run_level(bench, 0, 8.0)
    alone = np.abs(force_harmonics(bench))
    time = run_level(bench, 1, 8.0, harmonics_control=HIGHEST)
    controlled = np.abs(force_harmonics(bench))
    assert alone[:, 1:].max() > 0.006 * alone[0, 0]
    assert controlled[:, 1:].max() < 0.003 * controlled[0, 0]
    assert time < 8.0
    assert not bench.loop.forces.law.given_up
    assert "MAC 0.9" in bench.loop.forces.summary


def test_a_level_without_harmonics_has_none_in_the_drive_and_keeps_the_second_exciter():
    bench = frame_loop()
    run_level(bench, 0, 8.0, harmonics_control=HIGHEST)
    ratio = bench.loop.forces.law.terms[1, 0]
    run_level(bench, 1, 8.0)
    terms = bench.step().terms
    assert {term.value for term in terms if term.order > 1} == {0j}
    (second,) = [term.value for term in terms if (term.exciter, term.order) == (2, 1)]
    assert second == pytest.approx(ratio, rel=0.02)
