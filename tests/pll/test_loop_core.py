"""Answers of the loop as records, and when a level is acknowledged."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from nmt_core.messages.blocks import OscillatorPhase, Quantity, SampleBlock
from nmt_core.messages.command_judge import CommandSource
from nmt_core.messages.records import LevelCommand, LoopStatus
from nmt_core.settings import settings_of
from nmt_core.vocabulary import BlockFlag, ControlKind, LoopState, TestKind, Waveform
from nmt_pll.level_loop import LockWindow, LoopOutput
from nmt_pll.loop_core import LoopAnswer, LoopCore, drive_command, lock_event, loop_status
from nmt_pll.pll_settings import PllSettings

RATE, SIZE = 1000.0, 20
LEVEL = LevelCommand(
    1, 0, 0.1, 100, 0.0, timeout=10.0, test=TestKind.RANDOM, band_low_hz=5.0, band_high_hz=50.0, duration=1.0
)
VALUES = {"sample_rate": RATE, "block_samples": SIZE, "drive_point": 2, "settling_time": 0.0}


def core(**values: Any) -> LoopCore:
    return LoopCore(settings_of(PllSettings, {**VALUES, **values}, "pll"))


def pair(number: int) -> list[SampleBlock]:
    """Silent blocks of force and displacement."""
    phase = OscillatorPhase(0.0, 0.0)
    return [
        SampleBlock(number * SIZE, RATE, quantity, quantity.unit, ("c",), (2,), np.zeros((1, SIZE)), phase)
        for quantity in (Quantity.FORCE, Quantity.DISPLACEMENT)
    ]


def feed(loop: LoopCore, first: int, last: int) -> list[LoopAnswer]:
    """Answers to the blocks from one number to another."""
    answers = [loop.take_block(block) for number in range(first, last) for block in pair(number)]
    return [answer for answer in answers if answer is not None]


def statuses(arrival: int, blocks: int = 12) -> list[LoopStatus]:
    """All states published when the level arrives before block ``arrival``."""
    loop = core()
    found: list[LoopStatus] = []
    for number in range(blocks):
        if number == arrival:
            found += loop.take_level(LEVEL)
        for block in pair(number):
            answer = loop.take_block(block)
            if answer is not None:
                found += answer.statuses
    return found


def test_the_acknowledgement_is_the_same_whenever_the_level_arrives_in_time() -> None:
    expected = repr(statuses(0))
    assert all(repr(statuses(arrival)) == expected for arrival in range(1, 6))  # block 5 begins at the level's sample
    sequence = [(status.last_sample, status.level_sequence) for status in statuses(3)]
    assert sequence[:7] == [(19, 0), (39, 0), (59, 0), (79, 0), (99, 0), (99, 1), (119, 1)]


def test_a_late_level_is_acknowledged_at_once_and_counted() -> None:
    sequence = [(status.last_sample, status.level_sequence) for status in statuses(8)]
    assert sequence[7:10] == [(159, 0), (159, 1), (179, 1)]
    loop = core()
    for block in (*pair(0), *pair(9)):
        loop.take_block(block)
    assert loop.counters["gaps"] == 1
    assert loop.take_level(LEVEL)[0].level_sequence == 1
    assert loop.counters["late_levels"] == 1


def test_a_sequencer_that_was_started_again_counts_its_levels_from_one() -> None:
    loop = core()
    feed(loop, 0, 3)
    loop.take_level(replace(LEVEL, sequence=17, amplitude=0.0), "before")
    assert feed(loop, 3, 6)[-1].statuses[-1].level_sequence == 17
    loop.judge.release()
    loop.take_level(replace(LEVEL, sequence=1, apply_at_sample=10 * SIZE), "again")
    assert feed(loop, 6, 9)[-1].statuses[-1].level_sequence == 0
    assert feed(loop, 9, 11)[-1].statuses[-1].level_sequence == 1


def test_the_samples_of_a_plant_that_was_started_again_are_taken() -> None:
    loop = core()
    feed(loop, 100, 103)
    assert not feed(loop, 0, 1)
    assert loop.counters["refused"] == 1
    loop.forget_samples()
    (answer,) = feed(loop, 0, 1)
    assert answer.statuses[-1].last_sample == SIZE - 1


def test_a_level_that_cannot_be_done_is_answered_by_a_lost_lock() -> None:
    told: list[str] = []
    loop = LoopCore(settings_of(PllSettings, VALUES, "pll"), lambda sentence, _: told.append(sentence))
    loop.take_level(LevelCommand(1, 0, 0.1, 0, 0.0))
    (answer,) = filter(None, map(loop.take_block, pair(0)))
    assert answer.statuses[0].state == LoopState.LOCK_LOST
    assert "needs a linear description" in answer.statuses[0].reason
    assert (loop.counters["refused"], loop.counters["lock_losses"]) == (1, 1)
    assert told == [f"Level refused: {answer.statuses[0].reason}."]


OUTPUT = LoopOutput(
    199, 22.5, 0.4, 0.1, LoopState.LOCKED, 0.01, 1.5, 2e-4, LEVEL, None, None, int(BlockFlag.OVERLOAD), Waveform.SWEEP,
    0.5, 30.0, 1.0, 2.0,
)  # fmt: skip


def test_a_drive_command_repeats_the_answer() -> None:
    drive = drive_command(OUTPUT, 40)
    assert drive.waveform is Waveform.SWEEP
    assert (drive.apply_at_sample, drive.based_on_sample) == (240, 199)
    names = ("frequency_hz", "amplitude", "ramp", "rate_hz_s", "frequency_end_hz", "band_low_hz", "band_high_hz")
    assert all(getattr(drive, name) == getattr(OUTPUT, name) for name in names)
    off = drive_command(OUTPUT._replace(amplitude=0.0))
    assert (off.waveform, off.apply_at_sample, off.ramp) == (Waveform.OFF, 200, 0.1)


def test_the_state_of_a_quiet_loop_has_no_frequency() -> None:
    status = loop_status(OUTPUT, 7, "m")
    assert (status.frequency_hz, status.level_sequence, status.level_index, status.flags) == (22.5, 7, 0, 1)
    assert loop_status(OUTPUT._replace(amplitude=0.0, level=None), 7, "m").frequency_hz == 0.0


@pytest.mark.parametrize(
    ("control", "response", "unit"),
    [
        (ControlKind.VOLTAGE, Quantity.ACCELERATION, "V"),
        (ControlKind.FORCE, Quantity.ACCELERATION, "N"),
        (ControlKind.RESPONSE, Quantity.ACCELERATION, "m/s^2"),
        (ControlKind.RESPONSE, Quantity.VELOCITY, "m/s"),
        (ControlKind.RESPONSE, Quantity.DISPLACEMENT, "m"),
    ],
)
def test_a_lock_event_names_the_unit_of_its_level(control: ControlKind, response: Quantity, unit: str) -> None:
    window = LockWindow(LevelCommand(3, 2, 0.7, 0, 0.1, control), 1999, 21.0, 0.02, 2000, 930, 20)
    event = lock_event(window, response, RATE)
    assert (event.level_index, event.level, event.level_unit) == (2, 0.7, unit)
    assert (event.window_first_sample, event.window_samples, event.window_periods) == (2000, 930, 20)
    assert event.time_ns == 1_999_000_000


def test_levels_come_from_one_source_and_zero_from_anybody() -> None:
    told: list[str] = []
    loop = LoopCore(settings_of(PllSettings, VALUES, "pll"), lambda sentence, _: told.append(sentence))
    own, stranger = CommandSource("01", "/sequencer"), CommandSource("02", "/stranger")
    feed(loop, 0, 3)
    assert loop.take_level(LEVEL, own) == ()
    feed(loop, 3, 8)
    assert loop.take_level(replace(LEVEL, sequence=2, amplitude=5.0, apply_at_sample=180), stranger) == ()
    assert max(answer.drive.amplitude for answer in feed(loop, 8, 20)) == LEVEL.amplitude
    assert loop.second_source == "topic level has a second publisher: /stranger"
    assert "/stranger" in told[0]
    loop.take_level(replace(LEVEL, sequence=3, amplitude=0.0, apply_at_sample=420), stranger)
    assert feed(loop, 20, 40)[-1].drive.amplitude == 0.0


def test_of_several_publishers_no_level_is_taken() -> None:
    loop = core()
    feed(loop, 0, 3)
    assert loop.take_level(LEVEL, CommandSource("01 02", "/sequencer and /stranger", alone=False)) == ()
    assert all(answer.drive.amplitude == 0.0 for answer in feed(loop, 3, 20))
    assert not loop.at_work


def test_a_level_for_a_sample_that_never_comes_is_refused() -> None:
    loop = core()
    feed(loop, 0, 3)
    assert loop.take_level(replace(LEVEL, apply_at_sample=2**60)) == ()
    assert not loop.at_work
    assert loop.counters["refused"] == 1
