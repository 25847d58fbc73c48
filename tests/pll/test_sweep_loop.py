"""Sweep and stepped sine on the joint resonator, without ROS."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from pll.swept_rig import SweptRig

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.vocabulary import ControlKind, LoopState, TestKind


@pytest.mark.parametrize(("start", "stop"), [(366.0, 371.0), (371.0, 366.0)])
def test_force_is_held_through_the_resonance(start: float, stop: float) -> None:
    rig = SweptRig()
    rig.order(14.65, start, frequency_end_hz=stop, rate_hz_s=0.5 if stop > start else -0.5)
    outcome = rig.run()
    force = outcome.column("force_amplitude")
    assert np.max(np.abs(force / 14.65 - 1.0)) < 0.02
    assert outcome.lock.samples == 100_000
    assert outcome.lock.periods == 0
    assert outcome.lock.frequency_hz == start
    # The window is the sweep: the oscillator starts and ends on the frequencies asked for.
    blocks = [b[Quantity.FORCE] for b in outcome.blocks if b[Quantity.FORCE].first_sample >= outcome.lock.first_sample]
    first, last = blocks[0].oscillator, blocks[-1].oscillator
    assert first.frequency_hz == pytest.approx(start, abs=1e-9)
    assert last.frequency_hz + last.rate_hz_s * 0.02 == pytest.approx(stop, abs=1e-6)
    # Voltage goes up where the force drops out.
    voltage = outcome.column("amplitude")
    assert voltage.max() > 1.3 * voltage[[0, -1]].min()


def test_latency_slows_the_controller_but_holds_the_force() -> None:
    rig = SweptRig(latency_blocks=2)
    rig.order(14.65, 366.5, frequency_end_hz=370.5, rate_hz_s=0.5)
    outcome = rig.run()
    assert np.max(np.abs(outcome.column("force_amplitude") / 14.65 - 1.0)) < 0.05
    assert outcome.lock.first_sample == outcome.lock.sample + 1 + 400


def test_two_sweeps_one_after_the_other_start_at_the_same_frequency() -> None:
    rig = SweptRig()
    for force in (5.0, 10.0):
        rig.order(force, 369.0, frequency_end_hz=369.5, rate_hz_s=1.0)
        outcome = rig.run(10.0)
        assert outcome.lock.level.amplitude == force
        assert np.max(np.abs(outcome.column("force_amplitude") / force - 1.0)) < 0.02
        force_blocks = [b[Quantity.FORCE] for b in outcome.blocks]
        first = next(b for b in force_blocks if b.first_sample >= outcome.lock.first_sample)
        assert first.oscillator.frequency_hz == pytest.approx(369.0, abs=1e-9)
    # In between the drive was at zero: no frequency jumps at full amplitude.
    amplitudes = [o.amplitude for o in outcome.outputs]
    assert min(amplitudes) == 0.0


@pytest.mark.parametrize("seed", [4, 5])
def test_what_still_rings_after_a_sweep_teaches_nothing_of_the_exciter(seed: int) -> None:
    rig = SweptRig(overrides=[f"seed={seed}"])
    for force, start in ((0.19273, 370.9), (0.47553, 369.147)):
        rig.order(force, start, frequency_end_hz=start + 0.6, rate_hz_s=0.2)
        outcome = rig.run()
        assert np.max(np.abs(outcome.column("force_amplitude") / force - 1.0)) < 0.04


def test_response_and_voltage_can_be_held_too() -> None:
    rig = SweptRig()
    rig.order(50.0, 366.0, frequency_end_hz=369.0, rate_hz_s=1.0, control=ControlKind.RESPONSE)
    outcome = rig.run()
    assert np.max(np.abs(outcome.column("response_amplitude") / 50.0 - 1.0)) < 0.05
    rig = SweptRig()
    rig.order(3.0, 366.0, frequency_end_hz=367.0, rate_hz_s=1.0, control=ControlKind.VOLTAGE)
    assert set(rig.run().column("amplitude")) == {3.0}


def test_levels_that_cannot_be_held_are_given_up_with_a_reason() -> None:
    rig = SweptRig(voltage_limit=5.0)
    rig.order(14.65, 366.0, frequency_end_hz=371.0, rate_hz_s=1.0)
    outcome = rig.run()
    assert outcome.outputs[-1].state == LoopState.LOCK_LOST
    assert "more than 5 V" in outcome.reasons[-1]
    assert outcome.outputs[-1].amplitude == 0.0
    rig = SweptRig()
    rig.order(0.01, 366.0, frequency_end_hz=371.0, rate_hz_s=1.0)
    assert "noise" in rig.run(20.0).reasons[-1]
    rig = SweptRig()
    rig.order(14.65, 369.0, frequency_end_hz=371.0, rate_hz_s=1.0, timeout=0.01)
    assert "time-out" in rig.run(20.0).reasons[-1]


def test_stepped_sine_glides_to_the_next_frequency_and_settles() -> None:
    rig = SweptRig(TestKind.STEPPED_SINE)
    for frequency in (368.0, 368.6, 369.2):
        rig.order(14.65, frequency, window_periods=40)
        outcome = rig.run(20.0)
        window = outcome.column("force_amplitude")
        assert outcome.lock.frequency_hz == frequency
        assert np.max(np.abs(window / 14.65 - 1.0)) < 2e-3
        assert outcome.lock.periods == 40
        phases = {b[Quantity.FORCE].oscillator.frequency_hz for b in outcome.blocks[-3:]}
        assert phases == {frequency}
        response = outcome.column("response_amplitude")
        assert np.ptp(response) < 5e-3 * response.mean()
    assert min(o.amplitude for o in outcome.outputs) > 0.5


@pytest.mark.parametrize(
    ("fields", "word"),
    [
        ({"frequency_hz": 0.0}, "frequencies between 0"),
        ({"frequency_end_hz": 6000.0}, "half the sample rate"),
        ({"rate_hz_s": -1.0}, "rate in that direction"),
        ({"rate_hz_s": 0.0}, "rate in that direction"),
        ({"control": 9}, "control 9"),
    ],
)
def test_refusals(fields: dict, word: str) -> None:
    rig = SweptRig()
    values = {"frequency_hz": 366.0, "frequency_end_hz": 371.0, "rate_hz_s": 1.0, **fields}
    with pytest.raises(BenchError, match=word):
        rig.order(1.0, values.pop("frequency_hz"), **values)


def test_a_held_amplitude_may_be_off_by_a_factor_of_two_for_a_second() -> None:
    rig = SweptRig()
    level = rig.order(14.65, 366.0, frequency_end_hz=371.0, rate_hz_s=1.0)
    while rig.loop.machine.state is not LoopState.LOCKED:
        rig.step()
    loop, end = rig.loop, rig.device.next_sample
    second = round(loop.sample_rate)
    phasors = 14.65 + 0j, 1.0 + 0j
    for share in (0.52, 1.9):
        loop.held = share * level.amplitude
        assert loop.refusal(level, phasors, end) == ""
    for share in (0.48, 2.1):
        loop.held = share * level.amplitude
        assert loop.refusal(level, phasors, end + round(0.9 * second)) == ""
        assert "instead of 14.65" in loop.refusal(level, phasors, end + round(1.1 * second))


def test_a_probe_begins_at_a_tenth_of_a_millivolt_and_grows_by_a_quarter_a_block() -> None:
    """So that no exciter, whatever its gain, starts with more than that; and in 50 blocks it has five decades."""
    rig = SweptRig()
    rig.order(14.65, 366.0, frequency_end_hz=371.0, rate_hz_s=1.0)
    drives: list[float] = []
    while len(drives) < 6:
        drives += [output.amplitude for output in (rig.step(),) if output.amplitude > 0.0]
    assert drives[0] == pytest.approx(1e-4)
    grown = np.log(drives[-1] / drives[0]) / sum(b > a for a, b in itertools.pairwise(drives))
    assert grown == pytest.approx(0.25, rel=1e-6)


def test_an_amplitude_is_judged_over_a_fifth_of_a_second_at_least() -> None:
    """Ten periods of a high frequency are too few blocks to be steady."""
    loop = SweptRig().loop
    for hertz, seconds in ((3000.0, 0.2), (20.0, loop.settings.dwell_periods / 20.0)):
        loop._prepare(hertz)
        assert loop.dwell.length * loop.block_duration == pytest.approx(seconds, rel=0.1)
