"""The loop on made-up blocks: orders, floors, flags, gaps, refusals; every block answered."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import UNKNOWN_PHASE, BlockFlag, OscillatorPhase, Quantity, SampleBlock
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.records import LevelCommand
from nmt_core.vocabulary import ControlKind, LoopState
from nmt_pll.loop_settings import LoopSettings
from nmt_pll.phase_loop.loop import PhaseLockedLoop

RATE = 1e4
BLOCK = 200
OMEGA = 139.0
LINEAR = LinearDescription(
    "test", 2, 0, (2, 4), (OMEGA,), (0.005,), ((0.4,), (1.4,)), 0.4, 140.0, 0.02, 0.043, 0.3, 2e-4
)
FACTOR = {Quantity.DISPLACEMENT: 1.0, Quantity.VELOCITY: 1j * OMEGA, Quantity.ACCELERATION: -(OMEGA**2)}


class Blocks:
    """Blocks of a rig that is always in phase resonance; what is to go wrong is set from outside."""

    def __init__(self, response=Quantity.DISPLACEMENT):
        self.response = response
        self.first = 0
        self.cycles = 0.0
        self.force = 0.5
        self.displacement = -1e-3j  # lags the force by 90°
        self.error = 0.0
        self.flags = 0
        self.frequency = OMEGA / (2 * math.pi)

    def pair(self):
        phase = OscillatorPhase(self.cycles, self.frequency)
        theta = phase.phase(BLOCK, RATE)
        turn = np.exp(1j * self.error)
        motion = self.displacement * turn * FACTOR[self.response]
        blocks = []
        for quantity, value, points in ((Quantity.FORCE, self.force, (2,)), (self.response, motion, (4, 2))):
            row = (value * np.exp(1j * theta)).real
            data = np.stack([0 * row, row]) if len(points) == 2 else row[None]
            names = tuple(f"{quantity.name[0].lower()}{point}" for point in points)
            blocks.append(
                SampleBlock(self.first, RATE, quantity, quantity.unit, names, points, data, phase, self.flags)
            )
        self.first += BLOCK
        self.cycles = math.fmod(self.cycles + BLOCK * self.frequency / RATE, 1.0)
        return blocks


def level(amplitude=0.5, **fields) -> LevelCommand:
    values = {"sequence": 1, "index": 0, "apply_at_sample": 0, "ramp": 0.1, "timeout": 20.0}
    return LevelCommand(amplitude=amplitude, **{"window_periods": 5, **values, **fields})


def make(settings=None, response=Quantity.DISPLACEMENT, **linear):
    loop = PhaseLockedLoop(replace(LINEAR, **linear), settings or LoopSettings(), RATE, BLOCK)
    return loop, Blocks(response)


def until(loop, blocks, state, limit=400):
    """Feed blocks until the state is reached; the outputs."""
    outputs = []
    while len(outputs) < limit:
        outputs.append(loop.process(*blocks.pair()))
        if outputs[-1].state == state:
            return outputs
    raise AssertionError(f"{state.name} was not reached, but {outputs[-1].state.name}")


def locked(**arguments):
    loop, blocks = make(**arguments)
    loop.set_level(level())
    outputs = until(loop, blocks, LoopState.LOCKED)
    return loop, blocks, outputs


@pytest.mark.parametrize("response", FACTOR)
def test_locks_on_any_motion(response):
    loop, _, outputs = locked(response=response)
    lock = outputs[-1].lock
    assert lock.phase_error == pytest.approx(0.0, abs=1e-4)
    assert lock.frequency_hz == pytest.approx(OMEGA / (2 * math.pi), rel=1e-4)
    assert lock.sample == outputs[-1].last_sample
    assert lock.first_sample == lock.sample + 1
    assert lock.samples == round(5 * RATE / lock.frequency_hz)
    # δ = F φ² / (2 ω² x)
    assert loop.decay == pytest.approx(0.5 * 0.4**2 / (2 * OMEGA * 1e-3), rel=1e-3)


def test_every_block_is_answered():
    loop, blocks = make()
    for index in range(5):
        output = loop.process(*blocks.pair())
        assert output.last_sample == (index + 1) * BLOCK - 1
        assert output.state == LoopState.FIXED
        assert output.amplitude == 0.0
        assert output.level is None


@pytest.mark.parametrize("apply_at", [0, 1, 1999, 2000, 2001, 2200])
def test_a_level_acts_in_the_first_block_that_starts_at_or_after_its_sample(apply_at):
    loop, blocks = make()
    loop.set_level(level(0.7, apply_at_sample=apply_at))
    for first in range(0, 3000, BLOCK):
        output = loop.process(*blocks.pair())
        assert output.amplitude == (0.7 if first >= apply_at else 0.0)
        assert (output.transition is not None) == (0 <= first - apply_at < BLOCK)
        if output.transition is not None:
            assert output.transition.sample == first + BLOCK
            assert output.transition.reason == "level 0 starts"


def test_levels_are_taken_in_the_order_of_their_samples():
    loop, blocks = make()
    loop.set_level(level(0.3, sequence=2, index=1, apply_at_sample=1000))
    loop.set_level(level(0.2, sequence=1, index=0, apply_at_sample=400))
    amplitudes = [loop.process(*blocks.pair()).amplitude for _ in range(8)]
    assert amplitudes == [0.0, 0.0, 0.2, 0.2, 0.2, 0.3, 0.3, 0.3]
    assert loop.newest_sequence == 2


def test_the_ramp_of_the_level_goes_with_the_drive():
    loop, blocks = make()
    loop.set_level(level(ramp=0.7))
    assert loop.process(*blocks.pair()).ramp == 0.7


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"amplitude": math.nan}, "Level 3: the amplitude must be finite"),
        ({"amplitude": math.inf}, "Level 3: the amplitude must be finite"),
        ({"amplitude": -0.1}, "Level 3: the amplitude must be finite and >= 0"),
        ({"ramp": -1.0}, "Level 3: the ramp must be finite and >= 0"),
        ({"ramp": math.nan}, "Level 3: the ramp must be finite"),
        ({"control": 9}, "Level 3: control 9 is not known"),
    ],
)
def test_levels_that_cannot_be_worked_on_are_refused(change, words):
    loop, _ = make()
    with pytest.raises(BenchError, match=words):
        loop.set_level(replace(level(index=3), **change))


def test_amplitude_zero_ends_the_excitation():
    loop, blocks, _ = locked()
    loop.set_level(level(0.0, sequence=2, apply_at_sample=blocks.first, ramp=0.3))
    output = loop.process(*blocks.pair())
    assert (output.state, output.amplitude, output.ramp) == (LoopState.FIXED, 0.0, 0.3)
    assert output.transition.reason == "the drive goes to zero"


def test_no_window_without_periods():
    loop, blocks = make()
    loop.set_level(level(window_periods=0))
    assert until(loop, blocks, LoopState.LOCKED)[-1].lock is None


@pytest.mark.parametrize(("name", "limit"), [("force_floor", 0.6), ("response_floor", 1.1e-3)])
def test_below_a_floor_there_is_no_phase_and_no_lock(name, limit):
    loop, blocks = make(LoopSettings(**{name: limit}))
    loop.set_level(level(timeout=2.0))
    outputs = until(loop, blocks, LoopState.LOCK_LOST)
    assert all(math.isnan(output.phase_error) for output in outputs)
    assert outputs[-1].transition.reason == ("no lock within the time-out: force or response below its amplitude floor")
    # The frequency is left alone while there is nothing to control by.
    assert {output.frequency_hz for output in outputs} == {OMEGA / (2 * math.pi)}


@pytest.mark.parametrize(("name", "limit"), [("force_floor", 0.4), ("response_floor", 0.9e-3)])
def test_above_the_floors_it_locks(name, limit):
    locked(settings=LoopSettings(**{name: limit}))


def test_a_lock_whose_force_vanishes_is_lost():
    loop, blocks, _ = locked(settings=LoopSettings(force_floor=0.4))
    blocks.force = 0.3
    outputs = until(loop, blocks, LoopState.LOCK_LOST)
    assert outputs[-1].transition.reason == "force or response fell below its amplitude floor"


def test_the_time_out_counts_from_the_end_of_ramp_and_warm_up():
    loop, blocks = make()
    blocks.error = 0.5
    loop.set_level(level(ramp=1.0, timeout=3.0))
    outputs = until(loop, blocks, LoopState.LOCK_LOST)
    transition = outputs[-1].transition
    assert transition.reason.startswith("no lock within the time-out: mean phase error 28.65 deg")
    settled = 2.0 / loop.cutoff
    assert transition.sample / RATE == pytest.approx(1.0 + 3.0 + settled, abs=0.05)
    assert transition.sample == outputs[-1].last_sample + 1


def test_without_a_time_out_it_waits():
    loop, blocks = make(LoopSettings(guard_low=1e-3, guard_high=1e3))
    blocks.error = 1e-2
    loop.set_level(level(timeout=0.0))
    outputs = [loop.process(*blocks.pair()) for _ in range(2000)]
    assert outputs[-1].state == LoopState.ACQUIRING


@pytest.mark.parametrize(
    ("flag", "reason"),
    [
        (BlockFlag.LIMIT, "a safety limit has tripped"),
        (BlockFlag.WATCHDOG, "the plant has taken the drive to zero by itself"),
        (BlockFlag.STOP, "the drive was stopped at the plant"),
    ],
)
@pytest.mark.parametrize("state", [LoopState.ACQUIRING, LoopState.LOCKED])
def test_a_trip_of_the_plant_ends_the_level_in_the_same_block(flag, reason, state):
    loop, blocks = make()
    loop.set_level(level())
    until(loop, blocks, state)
    blocks.flags = int(flag)
    output = loop.process(*blocks.pair())
    assert (output.state, output.amplitude) == (LoopState.LOCK_LOST, 0.0)
    assert output.flags & flag
    assert output.transition.reason == reason
    assert output.ramp == loop.settings.quiet_ramp


def test_an_overload_is_passed_on_and_ends_nothing():
    loop, blocks, _ = locked()
    blocks.flags = int(BlockFlag.OVERLOAD)
    output = loop.process(*blocks.pair())
    assert output.state == LoopState.LOCKED
    assert output.flags == BlockFlag.OVERLOAD


def test_a_lost_lock_is_latched_until_the_next_level():
    loop, blocks, _ = locked()
    blocks.error = 1.0
    lost = until(loop, blocks, LoopState.LOCK_LOST)[-1]
    assert lost.transition.reason.startswith("mean phase error")
    blocks.error = 0.0
    for _ in range(100):
        output = loop.process(*blocks.pair())
        assert (output.state, output.amplitude, output.transition) == (LoopState.LOCK_LOST, 0.0, None)
    # The sequencer's order to end the level does not hide the loss; the next level ends it.
    loop.set_level(level(0.0, sequence=2, apply_at_sample=blocks.first))
    assert loop.process(*blocks.pair()).state == LoopState.LOCK_LOST
    loop.set_level(level(0.5, sequence=3, index=1, apply_at_sample=blocks.first))
    assert loop.process(*blocks.pair()).state == LoopState.ACQUIRING
    until(loop, blocks, LoopState.LOCKED)


def test_after_a_loss_the_next_level_starts_at_the_last_good_frequency():
    loop, blocks, outputs = locked()
    good = outputs[-1].frequency_hz
    blocks.error = 0.5  # drives the frequency away
    until(loop, blocks, LoopState.LOCK_LOST)
    assert loop.controller.output / (2 * math.pi) > 1.001 * good
    loop.set_level(level(sequence=2, index=1, apply_at_sample=blocks.first))
    assert loop.process(*blocks.pair()).frequency_hz == pytest.approx(good)


def test_a_level_may_bring_its_start_frequency():
    loop, blocks = make()
    loop.set_level(level(frequency_hz=20.5))
    assert loop.process(*blocks.pair()).frequency_hz == pytest.approx(20.5)


@pytest.mark.parametrize(("error", "side", "factor"), [(1.0, "upper", 1.15), (-1.0, "lower", 0.4)])
def test_a_frequency_that_stays_at_the_guard_band_is_not_the_target_mode(error, side, factor):
    loop, blocks = make()
    blocks.error = error
    loop.set_level(level(timeout=100.0))
    outputs = until(loop, blocks, LoopState.LOCK_LOST, limit=5000)
    edge = factor * OMEGA / (2 * math.pi)
    where = f"the {side} end of the guard band ({edge:.2f} Hz)"
    assert outputs[-1].transition.reason == f"the frequency stays at {where}: this is not the target mode"
    low, high = 0.4 * OMEGA / (2 * math.pi), 1.15 * OMEGA / (2 * math.pi)
    assert all(low * (1 - 1e-12) <= output.frequency_hz <= high * (1 + 1e-12) for output in outputs)
    assert all(output.lock is None for output in outputs)


@pytest.mark.parametrize("gap", [1, 10, 333])
def test_a_gap_of_blocks_does_not_end_a_lock(gap):
    loop, blocks, _ = locked()
    for _ in range(gap):
        blocks.pair()  # lost on the way
    outputs = [loop.process(*blocks.pair()) for _ in range(60)]
    assert all(output.state == LoopState.LOCKED for output in outputs)
    assert outputs[-1].phase_error == pytest.approx(0.0, abs=1e-3)


def test_a_gap_over_the_start_of_a_level_starts_it_with_the_next_block():
    loop, blocks = make()
    loop.set_level(level(apply_at_sample=1000))
    loop.process(*blocks.pair())
    for _ in range(20):
        blocks.pair()
    output = loop.process(*blocks.pair())
    assert output.state == LoopState.ACQUIRING
    assert output.transition.sample == 22 * BLOCK


def test_quiet_ends_the_level_with_its_reason():
    loop, blocks, _ = locked()
    loop.quiet("node sequencer has fallen silent")
    output = loop.process(*blocks.pair())
    assert (output.state, output.amplitude) == (LoopState.LOCK_LOST, 0.0)
    assert output.transition.reason == "node sequencer has fallen silent"


@pytest.mark.parametrize("lost", [False, True])
def test_quiet_with_the_drive_at_zero_does_not_strike_the_next_level(lost):
    loop, blocks, _ = locked()
    if lost:
        loop.quiet("first")
    else:
        loop.set_level(level(0.0, sequence=2, apply_at_sample=blocks.first))
    loop.process(*blocks.pair())
    loop.quiet("node sequencer has fallen silent")
    for _ in range(3):
        loop.process(*blocks.pair())
    loop.set_level(level(sequence=3, index=1, apply_at_sample=blocks.first))
    until(loop, blocks, LoopState.LOCKED)


def test_a_block_that_is_not_finite_is_survived():
    loop, blocks = make()
    loop.set_level(level())
    for _ in range(5):
        loop.process(*blocks.pair())
    force, response = blocks.pair()
    response.data[1, 7] = math.nan
    assert math.isnan(loop.process(force, response).phase_error)
    until(loop, blocks, LoopState.LOCKED)


def test_blocks_without_a_phase_give_no_phase_error():
    loop, blocks = make()
    loop.set_level(level())
    force, response = (replace(block, oscillator=UNKNOWN_PHASE) for block in blocks.pair())
    assert math.isnan(loop.process(force, response).phase_error)


def test_blocks_that_do_not_belong_together_are_refused():
    loop, blocks = make()
    force, response = blocks.pair()
    with pytest.raises(ValueError, match="do not cover the same samples"):
        loop.process(force, replace(response, first_sample=force.first_sample + BLOCK))
    with pytest.raises(ValueError, match="do not cover the same samples"):
        loop.process(force, replace(response, data=response.data[:, :-1]))


def test_a_response_that_is_no_motion_is_refused():
    loop, blocks = make()
    force, response = blocks.pair()
    with pytest.raises(ValueError, match="the response is voltage, not a motion"):
        loop.process(force, replace(response, quantity=Quantity.VOLTAGE))


def test_a_block_without_the_drive_point_is_refused():
    loop, blocks = make()
    force, response = blocks.pair()
    with pytest.raises(ValueError, match="no displacement channel at the drive point 2"):
        loop.process(force, replace(response, points=(4, 5)))


@pytest.mark.parametrize("response", FACTOR)
def test_a_held_response_starts_from_the_linear_estimate_in_its_own_unit(response):
    loop, blocks = make(response=response)
    per_volt = LINEAR.displacement_per_volt * abs(FACTOR[response])
    loop.set_level(level(1.5 * per_volt, control=ControlKind.RESPONSE))
    assert loop.process(*blocks.pair()).amplitude == pytest.approx(1.5, rel=1e-6)


def test_a_held_force_starts_from_the_linear_estimate():
    loop, blocks = make()
    loop.set_level(level(0.6, control=ControlKind.FORCE))
    assert loop.process(*blocks.pair()).amplitude == pytest.approx(2.0)


def test_without_an_estimate_a_held_amplitude_starts_from_next_to_nothing():
    loop, blocks = make(force_per_volt=math.nan)
    loop.set_level(level(0.6, control=ControlKind.FORCE))
    assert 0.0 < loop.process(*blocks.pair()).amplitude <= 1e-3
