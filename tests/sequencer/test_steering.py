"""Steering a run: each act has its effect at a stated sample, and nothing else changes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sequencer.bench import BLOCK, PACING, Bench, Fate

from nmt_core.errors import BenchError
from nmt_core.kinds import SteppedSineTest
from nmt_core.messages.records import Steering
from nmt_core.vocabulary import LoopState, ResultCode, RunPhase, SteeringAct
from nmt_sequencer.level_plan import RunPlan
from nmt_sequencer.run_machine import RunMachine
from nmt_sequencer.steering import PRESENT_LEVEL, SteeringRequest, with_repetition, with_rest

REALTIME = replace(PACING, lockstep=False)
PACINGS = pytest.mark.parametrize("pacing", [PACING, REALTIME], ids=["lockstep", "realtime"])


def started(levels: tuple[float, ...] = (1.0, 2.0, 3.0), pacing: object = PACING, fate: Fate | None = None) -> Bench:
    bench = Bench([fate or Fate()], pacing)  # type: ignore[arg-type]
    bench.start(RunPlan("run", levels))
    return bench


def in_level(bench: Bench, index: int) -> Callable[[], bool]:
    """The loop seeks the lock of a level, and the machine has heard of it."""
    return lambda: (
        bench.machine.report is not None
        and (bench.machine.report.level_index == index and bench.machine.report.state == LoopState.ACQUIRING)
    )


def steer(bench: Bench, act: SteeringAct, index: int = PRESENT_LEVEL, **fields: object) -> str:
    return str(bench.call(bench.machine.steer, SteeringRequest(act, index, **fields)))  # type: ignore[arg-type]


def amplitudes(bench: Bench) -> list[float]:
    return [order.amplitude for order in bench.orders]


def outcome(bench: Bench) -> list[tuple[float, bool, str]]:
    return [(record.amplitude, record.complete, record.reason) for record in bench.machine.records]


@PACINGS
def test_a_skipped_level_is_given_up_and_the_next_one_begins(pacing: object) -> None:
    bench = started(pacing=pacing)
    bench.until(in_level(bench, 1))
    asked_at = bench.machine.newest
    assert steer(bench, SteeringAct.SKIP_LEVEL, source="a person") == ""
    bench.run()
    assert amplitudes(bench) == [1.0, 2.0, 3.0, 0.0]
    assert outcome(bench) == [(1.0, True, ""), (2.0, False, "skipped by a person"), (3.0, True, "")]
    assert bench.machine.reason == "2 of 3 levels locked."
    (act,) = bench.machine.take_acts()
    assert (act.act, act.level_index, act.taken, act.source) == (SteeringAct.SKIP_LEVEL, 1, True, "a person")
    assert act.levels == (1.0, 2.0, 3.0)
    assert asked_at < act.sample <= act.apply_at_sample == bench.orders[2].apply_at_sample
    assert act.time_ns == round(act.sample / PACING.sample_rate * 1e9)


@PACINGS
def test_a_level_that_is_repeated_while_present_begins_anew(pacing: object) -> None:
    bench = started(pacing=pacing)
    bench.until(in_level(bench, 1))
    assert steer(bench, SteeringAct.REPEAT_LEVEL) == ""
    bench.run()
    assert amplitudes(bench) == [1.0, 2.0, 2.0, 3.0, 0.0]
    assert [order.index for order in bench.orders] == [0, 1, 2, 3, 3]
    assert [complete for _, complete, _ in outcome(bench)] == [True, False, True, True]
    assert bench.machine.records[1].reason == "started over by a program"


@PACINGS
def test_an_earlier_level_is_repeated_after_the_present_one(pacing: object) -> None:
    bench = started(pacing=pacing)
    bench.until(in_level(bench, 1))
    assert steer(bench, SteeringAct.REPEAT_LEVEL, 0) == ""
    bench.run()
    assert amplitudes(bench) == [1.0, 2.0, 1.0, 3.0, 0.0]
    assert all(complete for _, complete, _ in outcome(bench))


@PACINGS
@pytest.mark.parametrize("rest", [(), (9.0,), (7.0, 8.0, 9.0)])
def test_the_rest_of_the_plan_is_replaced(pacing: object, rest: tuple[float, ...]) -> None:
    bench = started(pacing=pacing)
    bench.until(in_level(bench, 1))
    assert steer(bench, SteeringAct.CHANGE_LEVELS, levels=rest) == ""
    bench.run()
    assert amplitudes(bench) == [1.0, 2.0, *rest, 0.0]
    assert bench.machine.code == ResultCode.SUCCEEDED
    (act,) = bench.machine.take_acts()
    assert act.levels == (1.0, 2.0, *rest)


@PACINGS
def test_the_end_that_was_asked_for_is_a_ramp_to_zero_and_is_noted(pacing: object) -> None:
    bench = started(pacing=pacing)
    bench.until(in_level(bench, 1))
    assert steer(bench, SteeringAct.END, source="a person") == ""
    assert steer(bench, SteeringAct.SKIP_LEVEL) == "the run is ending"
    bench.run()
    assert amplitudes(bench) == [1.0, 2.0, 0.0]
    assert (bench.machine.code, bench.machine.reason) == (ResultCode.STOPPED, "Stopped by a person.")
    (act,) = bench.machine.take_acts()
    assert (act.act, act.taken) == (SteeringAct.END, True)
    assert act.apply_at_sample == bench.orders[-1].apply_at_sample


@PACINGS
def test_a_pause_and_its_end_are_noted(pacing: object) -> None:
    bench = started(pacing=pacing)
    bench.until(in_level(bench, 0))
    assert steer(bench, SteeringAct.RESUME) == "nothing is paused"
    assert steer(bench, SteeringAct.PAUSE) == ""
    assert steer(bench, SteeringAct.PAUSE) == "the run is paused already"
    assert bench.machine.phase == RunPhase.PAUSED
    assert steer(bench, SteeringAct.RESUME) == ""
    bench.run()
    assert amplitudes(bench) == [1.0, 2.0, 3.0, 0.0]
    assert [act.act for act in bench.machine.take_acts()] == [SteeringAct.PAUSE, SteeringAct.RESUME]


def test_the_end_comes_from_a_pause_too() -> None:
    bench = started()
    bench.until(in_level(bench, 0))
    assert steer(bench, SteeringAct.PAUSE) == ""
    assert steer(bench, SteeringAct.END) == ""
    bench.run()
    assert bench.machine.code == ResultCode.STOPPED


# -- the same samples ------------------------------------------------------------------------------------------------

acts = st.sampled_from([SteeringAct.SKIP_LEVEL, SteeringAct.REPEAT_LEVEL, SteeringAct.CHANGE_LEVELS, SteeringAct.END])
requests = st.builds(
    SteeringRequest,
    acts,
    st.sampled_from([0, 1, 2, PRESENT_LEVEL]),
    st.lists(st.sampled_from([4.0, 5.0, 6.0]), max_size=3).map(tuple),
    st.just(()),
    st.integers(1, 60).map(lambda block: block * BLOCK),
)


def steered(asked: list[SteeringRequest], choose: Callable[[list[str]], str] | None) -> tuple[Bench, list[Steering]]:
    bench = started()
    for request in asked:
        bench.call(bench.machine.steer, request)
    bench.run(choose)
    return bench, bench.machine.take_acts()


@given(st.lists(requests, max_size=5), st.integers(0, 2**32 - 1))
@settings(max_examples=100, deadline=None)
def test_acts_with_a_sample_give_the_same_orders_however_messages_lag(asked: list[SteeringRequest], seed: int) -> None:
    plain, plain_acts = steered(asked, None)
    other, other_acts = steered(asked, Random(seed).choice)
    assert other.orders == plain.orders
    assert other_acts == plain_acts
    for act in plain_acts:
        assert not act.taken or act.sample <= act.apply_at_sample


@given(st.integers(1, 40), st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_a_pause_at_a_sample_changes_no_order_in_lockstep(block: int, seed: int) -> None:
    plain, _ = steered([], None)
    bench = started()
    bench.call(bench.machine.steer, SteeringRequest(SteeringAct.PAUSE, at_sample=block * BLOCK))
    random = Random(seed)
    for _ in range(2000):
        if not bench.possible():
            break
        bench.move(random.choice(bench.possible()))
    if bench.machine.phase == RunPhase.PAUSED:
        assert steer(bench, SteeringAct.RESUME) == ""
    bench.run(random.choice)
    assert bench.orders == plain.orders


@PACINGS
def test_two_acts_of_one_tick_do_not_begin_two_levels(pacing: object) -> None:
    bench = started((1.0, 2.0, 3.0, 4.0), pacing)
    bench.until(in_level(bench, 1))
    assert steer(bench, SteeringAct.SKIP_LEVEL, 1) == ""
    assert steer(bench, SteeringAct.SKIP_LEVEL, 1) == ""
    bench.run()
    assert [complete for _, complete, _ in outcome(bench)] == [True, False, True, True]
    first, second = bench.machine.take_acts()
    assert (first.taken, second.taken) == (True, False)
    assert second.reason == "level 2 is not the present one, which is 3"


def test_a_level_that_is_complete_when_it_is_to_be_skipped_stays_complete() -> None:
    plain = started()
    plain.run()
    over = next(record.window_end for record in plain.machine.records)
    bench = started()
    request = SteeringRequest(SteeringAct.SKIP_LEVEL, 0, at_sample=plain.orders[1].apply_at_sample - PACING.tick)
    assert over is not None
    assert over <= request.at_sample
    bench.call(bench.machine.steer, request)
    bench.run()
    assert all(complete for _, complete, _ in outcome(bench))
    assert bench.orders == plain.orders


def test_what_is_still_waiting_when_the_run_ends_is_noted_as_too_late() -> None:
    bench = started((1.0,))
    assert steer(bench, SteeringAct.SKIP_LEVEL, at_sample=10**9) == ""
    bench.run()
    (act,) = bench.machine.take_acts()
    assert (act.taken, act.reason) == (False, "the run is ending")
    assert bench.machine.code == ResultCode.SUCCEEDED


def test_an_end_that_the_loop_no_longer_answers_is_noted() -> None:
    bench = started()
    bench.until(in_level(bench, 0))
    assert steer(bench, SteeringAct.END) == ""
    bench.machine.abandon(ResultCode.NODE_LOST, "gone")
    (act,) = bench.machine.take_acts()
    assert (act.act, act.taken) == (SteeringAct.END, True)


# -- refusals --------------------------------------------------------------------------------------------------------


def test_what_cannot_be_done_is_refused_with_a_sentence() -> None:
    assert RunMachine(PACING).steer(SteeringRequest(SteeringAct.PAUSE)) == "no run is active"
    bench = started()
    bench.until(in_level(bench, 0))
    assert steer(bench, SteeringAct.SKIP_LEVEL, 2) == "level 3 is not the present one, which is 1"
    assert steer(bench, SteeringAct.REPEAT_LEVEL, 2) == "level 3 has not begun; the present one is 1"
    assert "takes no frequencies" in steer(bench, SteeringAct.CHANGE_LEVELS, levels=(1.0,), frequencies_hz=(9.0,))
    assert "at most 1000 levels" in steer(bench, SteeringAct.CHANGE_LEVELS, levels=(1.0,) * 1000)
    bench.run()
    assert amplitudes(bench) == [1.0, 2.0, 3.0, 0.0]
    assert bench.machine.take_acts() == []


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"act": SteeringAct.UNKNOWN}, "Nothing is asked"),
        ({"act": SteeringAct.CHANGE_LEVELS, "levels": (float("nan"),)}, "positive and finite"),
        ({"act": SteeringAct.CHANGE_LEVELS, "levels": (0.0,)}, "positive and finite"),
        ({"act": SteeringAct.PAUSE, "source": "x" * 101}, "at most 100"),
        ({"act": SteeringAct.PAUSE, "source": "a\nb"}, "printable"),
        ({"act": SteeringAct.RESUME, "at_sample": 1}, "at once"),
    ],
)
def test_requests_that_mean_nothing_are_refused(fields: dict[str, object], words: str) -> None:
    with pytest.raises(BenchError, match=words):
        SteeringRequest(**fields)  # type: ignore[arg-type]


def test_frequencies_go_with_their_levels() -> None:
    stepped = RunPlan("run", (1.0, 1.0, 1.0), kind=SteppedSineTest(), frequencies_hz=(10.0, 11.0, 12.0))
    changed = with_rest(stepped, 0, (2.0,), (20.0,))
    assert (changed.levels, changed.frequencies_hz) == ((1.0, 2.0), (10.0, 20.0))
    again = with_repetition(stepped, 1, 0)
    assert (again.levels, again.frequencies_hz) == ((1.0, 1.0, 1.0, 1.0), (10.0, 11.0, 10.0, 12.0))
    with pytest.raises(BenchError, match="a frequency for each"):
        with_rest(stepped, 0, (2.0,), ())
    same = replace(stepped, frequencies_hz=(10.0,) * 3)
    assert with_rest(same, 0, (2.0, 3.0), ()).frequencies_hz == (10.0, 10.0, 10.0)
