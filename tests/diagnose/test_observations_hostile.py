"""Malformed and hostile real sides: a sentence each, and no observable of what is broken."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnose.observation_bags import LEVELS, altered, record, rig_with_noise, with_data
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import BlockFlag, OscillatorPhase, Quantity, SampleBlock
from nmt_core.vocabulary import TestKind
from nmt_diagnose.measurements.locked_windows import LockedWindows
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.observations.read_observations import read_observations
from nmt_rig.rig import load_rig
from nmt_session import Session, plan_test

RIG = rig_with_noise()


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("clean") / "run", RIG)


def rows_of(observations: Observations, channel: str) -> np.ndarray:
    names = [c.name for c in observations.tests[0].channels]
    return observations.rows.channel == (names.index(channel) if channel in names else -2)


def said(observations: Observations, *words: str) -> str:
    """The note with all the words."""
    found = [note for note in observations.notes if all(word in note for word in words)]
    assert found, f"no note with {words} in {observations.notes}"
    return found[0]


def one_sentence(failure: pytest.ExceptionInfo[BenchError], *words: str) -> None:
    text = str(failure.value)
    assert "\n" not in text
    assert text.endswith(".")
    for word in words:
        assert word in text


def test_a_clean_bag_says_nothing(clean: Path) -> None:
    observations = read_observations([clean], RIG)
    assert observations.notes == ()
    assert len(observations.tests) == 1
    assert np.unique(observations.rows.level).tolist() == list(range(len(LEVELS)))


def test_nan_in_one_channel_of_one_level(clean: Path, tmp_path: Path) -> None:
    whole = read_observations([clean], RIG)
    test = whole.tests[0]
    assert isinstance(test, LockedWindows)
    hit = int(test.levels[2].start_s * RIG.sample_rate_hz) + 400

    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        if block.quantity is Quantity.DISPLACEMENT and block.first_sample <= hit < block.end_sample:
            data = block.data.copy()
            data[block.channels.index("x5"), hit - block.first_sample] = np.nan
            block = with_data(block, data)
        yield block

    observations = read_observations([altered(clean, tmp_path / "nan", change)], RIG)
    note = said(observations, "x5", "level 2", "NaN")
    assert str(hit) in note
    lost = rows_of(whole, "x5") & (whole.rows.level == 2)
    assert len(observations.rows) == len(whole.rows) - int(lost.sum())
    np.testing.assert_allclose(observations.values, whole.values[~lost], rtol=1e-12)


def test_nan_in_the_force_spoils_the_level(clean: Path, tmp_path: Path) -> None:
    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        if block.quantity is Quantity.FORCE:
            data = block.data.copy()
            data[0, 7] = np.nan
            block = with_data(block, data)
        yield block

    with pytest.raises(BenchError) as failure:
        read_observations([altered(clean, tmp_path / "nan", change)], RIG)
    one_sentence(failure, "Nothing in", "force", "NaN")


def test_missing_channels_are_named(clean: Path, tmp_path: Path) -> None:
    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        if block.quantity is Quantity.ACCELERATION:
            return
        yield block

    observations = read_observations([altered(clean, tmp_path / "bare", change)], RIG)
    said(observations, "a2", "not recorded")
    assert not rows_of(observations, "a2").any()
    assert rows_of(observations, "x2").any()


def test_without_the_force_frequencies_are_known_and_no_damping(clean: Path, tmp_path: Path) -> None:
    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        if block.quantity is not Quantity.FORCE:
            yield block

    found = read_observations([altered(clean, tmp_path / "bare", change)], RIG)
    said(found, "no force was recorded", "frequencies over amplitudes")
    forced = read_observations([clean], RIG)
    known = forced.rows.part == Part.LOG_FREQUENCY
    assert set(found.rows.part) == {Part.LOG_FREQUENCY}
    uncertain = np.hypot(found.std, found.floor)
    assert np.all(np.abs(found.values - forced.values[known]) < 3.0 * uncertain + 1e-5)
    fundamental = (forced.rows.part == Part.LOG_MAGNITUDE) & rows_of(forced, "x2")
    assert found.rows.amplitude == pytest.approx(np.exp(forced.values[fundamental]), rel=1e-3)


def test_without_the_forces_of_two_exciters_there_is_no_evidence(tmp_path: Path) -> None:
    with Session(plan_test("frame", [1.0], window_periods=10), tmp_path / "run") as session:
        recorded = session.run().bag
    assert recorded is not None

    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        if block.quantity is not Quantity.FORCE:
            yield block

    with pytest.raises(BenchError) as failure:
        read_observations([altered(recorded, tmp_path / "bare", change)], load_rig("frame"))
    one_sentence(failure, "no force channel")


def test_a_channel_that_the_model_does_not_have(clean: Path) -> None:
    fewer = RIG.model_copy(update={"sensors": [s for s in RIG.sensors if s.point != 6]})
    observations = read_observations([clean], fewer)
    said(observations, "x6", "no counterpart")
    assert not rows_of(observations, "x6").any()


@pytest.mark.parametrize("factor", with_quick([1e3, 1e-3, 9.80665], 9.80665))
def test_wrong_units_of_a_channel(clean: Path, tmp_path: Path, factor: float) -> None:
    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        if block.quantity is Quantity.DISPLACEMENT:
            data = block.data.copy()
            data[block.channels.index("x4")] *= factor
            block = with_data(block, data)
        yield block

    observations = read_observations([altered(clean, tmp_path / "units", change)], RIG)
    assert "?" in said(observations, "x4", "unit or scale")
    assert not rows_of(observations, "x4").any()
    assert rows_of(observations, "x5").any()


def test_a_dead_channel(clean: Path, tmp_path: Path) -> None:
    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        if block.quantity is Quantity.DISPLACEMENT:
            data = block.data.copy()
            data[block.channels.index("x6")] = 0.25
            block = with_data(block, data)
        yield block

    observations = read_observations([altered(clean, tmp_path / "dead", change)], RIG)
    said(observations, "x6", "does not move")
    assert not rows_of(observations, "x6").any()


@pytest.mark.parametrize("samples", [0, 3, 10**9])
def test_windows_of_impossible_length(clean: Path, tmp_path: Path, samples: int) -> None:
    def events(message: Any) -> Any:
        return dataclasses.replace(message, window_samples=samples) if message.level_index == 2 else message

    observations = read_observations([altered(clean, tmp_path / "odd", events=events)], RIG)
    said(observations, "level 2", "left out")
    kept = observations.tests[0]
    assert isinstance(kept, LockedWindows)
    assert [level.index for level in kept.levels] == [0, 1, 3]


def test_wrong_units_of_all_displacements(clean: Path, tmp_path: Path) -> None:
    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        yield with_data(block, block.data * 1e3) if block.quantity is Quantity.DISPLACEMENT else block

    # One vote per quantity: voltage, force and acceleration agree.
    observations = read_observations([altered(clean, tmp_path / "units", change)], RIG)
    for channel in ("x2", "x4", "x5", "x6"):
        said(observations, channel, "unit or scale")
        assert not rows_of(observations, channel).any()
    assert rows_of(observations, "a2").any()


def test_scales_that_contradict_each_other(clean: Path, tmp_path: Path) -> None:
    factors = {Quantity.DISPLACEMENT: 1e3, Quantity.ACCELERATION: 1e-3, Quantity.FORCE: 1e3}

    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        yield with_data(block, block.data * factors.get(block.quantity, 1.0))

    with pytest.raises(BenchError) as failure:
        read_observations([altered(clean, tmp_path / "units", change)], RIG)
    one_sentence(failure, "do not agree on their scale")


def test_a_wrong_sign_is_no_phase_of_the_loop(clean: Path, tmp_path: Path) -> None:
    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        yield with_data(block, -block.data) if block.quantity is Quantity.FORCE else block

    with pytest.raises(BenchError) as failure:
        read_observations([altered(clean, tmp_path / "sign", change)], RIG)
    one_sentence(failure, "wrong sign")


def test_time_going_backwards(clean: Path, tmp_path: Path) -> None:
    test = read_observations([clean], RIG).tests[0]
    assert isinstance(test, LockedWindows)
    turn = int(test.levels[1].start_s * RIG.sample_rate_hz) + 2000

    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        yield block
        if block.first_sample <= turn < block.end_sample:
            yield dataclasses.replace(block, first_sample=block.first_sample - 400)

    observations = read_observations([altered(clean, tmp_path / "back", change)], RIG)
    said(observations, "level 1", "repeats samples")
    kept = observations.tests[0]
    assert isinstance(kept, LockedWindows)
    assert [level.index for level in kept.levels] == [0, 2, 3]


def test_a_clock_that_is_set_back_spoils_all_that_follows(clean: Path, tmp_path: Path) -> None:
    test = read_observations([clean], RIG).tests[0]
    assert isinstance(test, LockedWindows)
    turn = int(test.levels[1].stop_s * RIG.sample_rate_hz) + 4000

    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        late = block.first_sample >= turn
        yield dataclasses.replace(block, first_sample=block.first_sample - 3000) if late else block

    observations = read_observations([altered(clean, tmp_path / "back", change)], RIG)
    said(observations, "level 2", "clock", "was set back")
    kept = observations.tests[0]
    assert isinstance(kept, LockedWindows)
    assert [level.index for level in kept.levels] == [0, 1]


def test_a_gap_spoils_its_window_only(clean: Path, tmp_path: Path) -> None:
    test = read_observations([clean], RIG).tests[0]
    assert isinstance(test, LockedWindows)
    hole = int(test.levels[3].start_s * RIG.sample_rate_hz) + 2000

    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        if not block.first_sample <= hole < block.end_sample:
            yield block

    observations = read_observations([altered(clean, tmp_path / "gap", change)], RIG)
    kept = observations.tests[0]
    assert isinstance(kept, LockedWindows)
    assert [level.index for level in kept.levels] == [0, 1, 2]
    said(observations, "level 3", "missing")


def test_a_jump_of_the_phase_spoils_its_window(clean: Path, tmp_path: Path) -> None:
    test = read_observations([clean], RIG).tests[0]
    assert isinstance(test, LockedWindows)
    hit = int(test.levels[0].start_s * RIG.sample_rate_hz) + 2000

    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        if block.first_sample <= hit < block.end_sample:
            own = block.oscillator
            moved = OscillatorPhase((own.cycles + 0.1) % 1.0, own.frequency_hz, own.rate_hz_s)
            block = dataclasses.replace(block, oscillator=moved)
        yield block

    said(read_observations([altered(clean, tmp_path / "jump", change)], RIG), "level 0", "phase jumps")


def clipped(block: SampleBlock) -> SampleBlock:
    """Accelerations cut off at ±1 m/s²."""
    return with_data(block, np.clip(block.data, -1.0, 1.0)) if block.quantity is Quantity.ACCELERATION else block


def test_clipping_that_nobody_noticed_is_evidence(clean: Path, tmp_path: Path) -> None:
    whole = read_observations([clean], RIG)

    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        yield clipped(block)

    observations = read_observations([altered(clean, tmp_path / "clip", change)], RIG)
    assert "kept" in said(observations, "a2", "clipped")
    limits = observations.rows.part == Part.LIMIT
    assert observations.values[limits] == pytest.approx(1.0)  # s²/m
    assert len(observations.rows) - int(limits.sum()) == len(whole.rows)
    sizes = []
    for found in (observations, whole):
        thirds = rows_of(found, "a2") & (found.rows.harmonic == 3) & (found.rows.level == len(LEVELS) - 1)
        sizes.append(float(np.hypot(*found.values[thirds])))
    assert sizes[0] > 3.0 * sizes[1]


def test_a_converter_that_says_so_costs_its_channels(clean: Path, tmp_path: Path) -> None:
    """The run was extracted from force and displacement, so the window stays; what the acceleration shows does not."""
    test = read_observations([clean], RIG).tests[0]
    assert isinstance(test, LockedWindows)
    hit = int(test.levels[2].start_s * RIG.sample_rate_hz) + 400

    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        if block.quantity is Quantity.ACCELERATION and block.first_sample <= hit < block.end_sample:
            block = dataclasses.replace(block, flags=block.flags | BlockFlag.OVERLOAD)
        yield block

    observations = read_observations([altered(clean, tmp_path / "over", change)], RIG)
    said(observations, "channel a2 is left out at level 2", "a converter was overloaded")
    lost = rows_of(observations, "a2")
    assert np.unique(observations.rows.level[lost]).tolist() == [0, 1, 3]
    assert np.unique(observations.rows.level).tolist() == [0, 1, 2, 3]


def test_three_periods_are_too_few(clean: Path, tmp_path: Path) -> None:
    def events(message: Any) -> Any:
        return dataclasses.replace(
            message, window_samples=round(3.0 * RIG.sample_rate_hz / message.frequency_hz), window_periods=3
        )

    with pytest.raises(BenchError) as failure:
        read_observations([altered(clean, tmp_path / "short", events=events)], RIG)
    one_sentence(failure, "3 whole periods")


def test_no_locked_window_at_all(clean: Path, tmp_path: Path) -> None:
    with pytest.raises(BenchError) as failure:
        read_observations([altered(clean, tmp_path / "none", events=lambda _: None)], RIG)
    one_sentence(failure, "no level was locked")


def test_too_few_levels_are_said(clean: Path, tmp_path: Path) -> None:
    def events(message: Any) -> Any:
        return message if message.level_index == 1 else None

    said(read_observations([altered(clean, tmp_path / "one", events=events)], RIG), "1 level cannot tell")


def test_bag_of_another_rig(clean: Path, tmp_path: Path) -> None:
    with pytest.raises(BenchError) as failure:
        read_observations([clean], load_rig("joint_resonator"))
    one_sentence(failure, "name the rig file of the rig that was tested")
    renamed = altered(clean, tmp_path / "name", run={"rig": "elsewhere"})
    said(read_observations([renamed], RIG), "elsewhere", "beam")


def test_wrong_sampling_rate(clean: Path, tmp_path: Path) -> None:
    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        own = block.oscillator
        phase = OscillatorPhase(own.cycles, own.frequency_hz * 2.5, own.rate_hz_s)
        yield dataclasses.replace(block, sample_rate=2.5 * block.sample_rate, oscillator=phase)

    with pytest.raises(BenchError) as failure:
        read_observations([altered(clean, tmp_path / "rate", change)], RIG)
    one_sentence(failure, "modes at")


def test_unknown_unit_of_a_channel(clean: Path, tmp_path: Path) -> None:
    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        yield dataclasses.replace(block, unit="mm") if block.quantity is Quantity.DISPLACEMENT else block

    observations = read_observations([altered(clean, tmp_path / "unit", change)], RIG)
    said(observations, "x2", "'mm'")
    assert not rows_of(observations, "x2").any()


def test_the_same_bag_twice_counts_once(clean: Path) -> None:
    observations = read_observations([clean, clean], RIG)
    assert len(observations.tests) == 1
    said(observations, "is the same as")


def test_a_random_test_with_a_gap_uses_the_longer_part(tmp_path: Path) -> None:
    whole = record(tmp_path / "whole", RIG, TestKind.RANDOM, (0.05,), duration=4.0)

    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        if not block.first_sample <= 17_400 < block.end_sample:
            yield block

    observations = read_observations([altered(whole, tmp_path / "gap", change)], RIG)
    said(observations, "level 0", "used in part", "of 20000 samples", "Samples 17400 to 17599 of 'force' are missing")
    assert (observations.rows.part == Part.LOG_MAGNITUDE).any()


def test_a_silent_random_test_is_left_out(tmp_path: Path) -> None:
    whole = record(tmp_path / "whole", RIG, TestKind.RANDOM, (0.05,), duration=2.0)

    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        yield with_data(block, 0.0 * block.data) if block.quantity is Quantity.VOLTAGE else block

    with pytest.raises(BenchError) as failure:
        read_observations([altered(whole, tmp_path / "silent", change)], RIG)
    one_sentence(failure, "constant")


def test_no_bag_at_all(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="at least one bag"):
        read_observations([], RIG)
    with pytest.raises(BenchError, match="There is no bag"):
        read_observations([tmp_path / "nothing"], RIG)
