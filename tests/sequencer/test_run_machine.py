"""State machine of a run: determinism, the horizon, lost lock, limits, stop, pause, abandon, several runs."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sequencer.bench import BLOCK, PACING, Bench, Fate, status

from nmt_core.errors import BenchError
from nmt_core.vocabulary import BlockFlag, LoopState, ResultCode, RunPhase
from nmt_sequencer.level_plan import RunPlan
from nmt_sequencer.run_machine import NO_HORIZON, Pacing, RunMachine

TICK = PACING.tick
REALTIME = replace(PACING, lockstep=False)
PACINGS = pytest.mark.parametrize("pacing", [PACING, REALTIME], ids=["lockstep", "realtime"])


def plan(levels=(1.0, 2.0, 3.0), **fields) -> RunPlan:
    return RunPlan("run", tuple(levels), **fields)


def finished(fates=None, pacing=PACING, choose=None, **fields) -> Bench:
    bench = Bench(list(fates or [Fate()]), pacing)
    bench.start(plan(**fields))
    bench.run(choose)
    return bench


def amplitudes(bench):
    return [order.amplitude for order in bench.orders]


# -- the plain run ---------------------------------------------------------------------------------------------------


@PACINGS
def test_works_through_the_levels_and_ends_with_zero(pacing):
    bench = finished(pacing=pacing, ramp=0.3, window_periods=17, timeout=9.0, control=2)
    assert amplitudes(bench) == [1.0, 2.0, 3.0, 0.0]
    assert [order.sequence for order in bench.orders] == [1, 2, 3, 4]
    assert [order.index for order in bench.orders] == [0, 1, 2, 2]
    for order in bench.orders[:3]:
        assert (order.control, order.ramp, order.window_periods, order.timeout) == (2, 0.3, 17, 9.0)
    last = bench.orders[3]
    assert (last.ramp, last.window_periods, last.timeout) == (PACING.quiet_ramp, 0, 0.0)
    machine = bench.machine
    assert machine.code == ResultCode.SUCCEEDED
    assert machine.reason == "3 of 3 levels locked."
    assert all(record.complete and not record.reason for record in machine.records)
    assert [record.index for record in machine.records] == [0, 1, 2]
    assert [record.amplitude for record in machine.records] == [1.0, 2.0, 3.0]
    assert bench.loop.state == LoopState.FIXED


@PACINGS
def test_a_level_begins_after_the_window_of_the_one_before(pacing):
    bench = finished([Fate(window=5), Fate(window=11), Fate(window=1)], pacing)
    for record, order in zip(bench.machine.records, bench.orders[1:], strict=True):
        assert record.locked_at < record.window_end
        assert record.window_end <= order.apply_at_sample
        assert record.window_end <= record.ended + 1


@PACINGS
def test_progress_shows_the_level_that_the_loop_reports_of(pacing):
    bench = Bench([Fate()], pacing)
    bench.start(plan())
    machine, late = bench.machine, 0
    for _ in range(20_000):
        if not machine.active:
            break
        bench.move(bench.possible()[0])
        if machine.report is not None:
            assert machine.reported.index == machine.report.level_index
            late += machine.reported.index != machine.level_index
    assert machine.code == ResultCode.SUCCEEDED
    assert late  # there was an order that the loop did not have yet


@PACINGS
def test_the_drive_has_time_to_reach_zero_before_the_run_is_done(pacing):
    bench = finished(pacing=pacing)
    quiet = bench.orders[-1].apply_at_sample + round((PACING.quiet_ramp + PACING.settle) * PACING.sample_rate)
    assert bench.machine.newest + 1 >= quiet
    assert bench.machine.end_sample > bench.machine.newest


def test_in_lockstep_everything_lies_on_ticks():
    bench = finished()
    assert all(order.apply_at_sample % TICK == 0 for order in bench.orders)
    assert all(horizon % TICK == 0 for horizon in bench.horizons)
    assert bench.horizons == sorted(bench.horizons)
    assert not bench.loop.late


def test_in_real_time_there_is_no_horizon_to_wait_for():
    bench = finished(pacing=REALTIME)
    assert bench.machine.horizon == NO_HORIZON


@PACINGS
def test_progress_never_goes_back_and_ends_at_one(pacing):
    fates = [Fate(), Fate(locks=False), Fate(lost_after=2), Fate(window=30)]
    bench = finished(fates, pacing, levels=(1.0, 2.0, 3.0, 4.0))
    assert bench.progress == sorted(bench.progress)
    assert bench.progress[0] == 0.0
    assert bench.progress[-1] == 1.0
    assert len(set(bench.progress)) > 8  # it moves within a window


def test_before_any_run_there_is_no_progress():
    machine = RunMachine(PACING)
    assert (machine.progress, machine.level_index, machine.active) == (0.0, 0, False)
    assert machine.take_orders() == []


@pytest.mark.parametrize("latency", [0, 1, 4])
def test_a_tick_leaves_room_for_the_latency(latency):
    pacing = Pacing(1e4, 200, tick_blocks=1, latency_blocks=latency)
    assert pacing.tick == 200 * (2 + latency)


@given(st.floats(0.0, 100.0))
def test_times_are_covered_by_whole_blocks(seconds):
    samples = PACING.samples(seconds)
    assert samples % BLOCK == 0
    assert 0 <= samples - round(seconds * PACING.sample_rate) < BLOCK


# -- determinism -----------------------------------------------------------------------------------------------------

fates = st.lists(
    st.builds(
        Fate,
        blocks=st.integers(0, 7),
        locks=st.sampled_from([True, True, False]),
        window=st.integers(1, 12),
        lost_after=st.none() | st.integers(0, 6),
        limit_after=st.sampled_from([None, None, None, None, 3]),
    ),
    min_size=1,
    max_size=4,
)


@given(fates, st.randoms(use_true_random=False), st.booleans(), st.integers(1, 6))
@settings(max_examples=150, deadline=None)
def test_no_order_of_arrival_changes_the_run(level_fates, random, stop_on_lost_lock, tick_blocks):
    pacing = replace(PACING, tick_blocks=tick_blocks)
    levels = tuple(range(1, len(level_fates) + 1))

    def run(shuffled):
        bench = Bench(level_fates, pacing)
        bench.start(plan(levels, stop_on_lost_lock=stop_on_lost_lock))
        favourite = random.choice(["plant", "reports", "locks", "levels", "states"])
        for _ in range(20_000):
            if bench.done:
                break
            moves = bench.possible()
            assert moves, f"nothing can move: {bench.machine}"
            if not shuffled:
                bench.move(moves[0])
                continue
            others = [name for name in moves if name != favourite]
            # One channel lags behind all others for most of the time.
            slow = others and random.random() < 0.9
            bench.move(random.choice(others if slow else moves), twice=random.random() < 0.2)
        return bench

    plain, shuffled = run(False), run(True)
    assert plain.done
    assert shuffled.done
    assert shuffled.orders == plain.orders
    # A late acknowledgement can join two steps of the horizon into one; it never makes another step.
    assert set(shuffled.horizons) <= set(plain.horizons)
    assert shuffled.horizons == sorted(shuffled.horizons)
    assert shuffled.horizons[-1] == plain.horizons[-1]
    assert (shuffled.machine.code, shuffled.machine.reason) == (plain.machine.code, plain.machine.reason)
    assert [record.complete for record in shuffled.machine.records] == [
        record.complete for record in plain.machine.records
    ]
    assert shuffled.machine.end_sample == plain.machine.end_sample
    assert not shuffled.loop.late
    assert shuffled.progress == sorted(shuffled.progress)


def test_a_lock_without_its_event_waits_for_it():
    bench = Bench([Fate()])
    bench.start(plan())
    while [name for name in bench.possible() if name != "locks"]:
        bench.move(next(name for name in bench.possible() if name != "locks"))
    assert bench.locks
    assert bench.machine.report.state == LoopState.LOCKED
    stands = bench.machine.horizon
    bench.move("locks")
    assert bench.machine.horizon > stands
    bench.run()
    assert bench.machine.code == ResultCode.SUCCEEDED


def test_the_horizon_waits_for_the_acknowledgement():
    bench = Bench([Fate()])
    bench.start(plan())
    first = bench.orders[0]
    for _ in range(50):
        moves = [name for name in bench.possible() if name != "levels"]
        if not moves:
            break
        bench.move(moves[0])
    assert bench.machine.horizon == first.apply_at_sample == bench.produced
    bench.move("levels")
    bench.run()
    assert bench.machine.code == ResultCode.SUCCEEDED


# -- lost lock, limits -----------------------------------------------------------------------------------------------


@PACINGS
@pytest.mark.parametrize("fate", [Fate(locks=False), Fate(lost_after=2)], ids=["never", "in the window"])
def test_a_level_without_lock_is_marked_and_the_run_goes_on(pacing, fate):
    bench = finished([Fate(), fate, Fate()], pacing)
    assert amplitudes(bench) == [1.0, 2.0, 3.0, 0.0]
    machine = bench.machine
    assert (machine.code, machine.reason) == (ResultCode.SUCCEEDED, "2 of 3 levels locked.")
    assert [record.complete for record in machine.records] == [True, False, True]
    assert machine.records[1].reason == bench_reason(fate)


def bench_reason(fate):
    return "level 1 lost its lock" if fate.locks else "level 1 did not lock"


@PACINGS
@pytest.mark.parametrize("fate", [Fate(locks=False), Fate(lost_after=2)], ids=["never", "in the window"])
def test_a_level_without_lock_ends_the_run_if_so_planned(pacing, fate):
    bench = finished([Fate(), fate], pacing, stop_on_lost_lock=True)
    assert amplitudes(bench) == [1.0, 2.0, 0.0]
    machine = bench.machine
    assert machine.code == ResultCode.LOCK_LOST
    assert machine.reason == f"Level 2 did not hold lock: {bench_reason(fate)}."
    assert len(machine.records) == 2


@PACINGS
def test_no_higher_level_follows_one_without_response(pacing):
    blind = Fate(locks=False, answers=False)
    bench = finished([Fate(), blind, Fate()], pacing)
    assert amplitudes(bench) == [1.0, 2.0, 0.0]
    assert bench.machine.code == ResultCode.LOCK_LOST
    assert "Level 2 had no force or no response (level 1 did not lock), so no higher level" in bench.machine.reason
    assert amplitudes(finished([blind, Fate()], pacing, levels=(2.0, 1.0))) == [2.0, 1.0, 0.0]
    assert amplitudes(finished([blind, Fate()], pacing, levels=(1.0, 2.0), open_loop_abort=False)) == [1.0, 2.0, 0.0]


@PACINGS
def test_a_limit_ends_the_run(pacing):
    bench = finished([Fate(), Fate(limit_after=2)], pacing)
    assert amplitudes(bench) == [1.0, 2.0, 0.0]
    assert bench.machine.code == ResultCode.LIMIT
    assert bench.machine.reason == "Level 2: a safety limit has tripped."
    assert bench.machine.records[1].complete is False


def test_a_limit_ends_a_pause():
    bench = Bench([Fate(window=10_000)], REALTIME)
    bench.start(plan())
    bench.until(lambda: bench.loop.state == LoopState.LOCKED)
    assert bench.call(bench.machine.pause)
    bench.loop.flags = BlockFlag.LIMIT
    bench.run()
    assert bench.machine.code == ResultCode.LIMIT


# -- stop, cancel ----------------------------------------------------------------------------------------------------


def at_start(bench):
    return True


def acquiring(bench):
    return bench.produced > 0 and bench.machine.report is not None and bench.machine.report.state == 2


def in_window(bench):
    return bench.machine.report is not None and bench.machine.report.state == LoopState.LOCKED


def second_level(bench):
    return bench.machine.level_index == 1


@PACINGS
@pytest.mark.parametrize("when", [at_start, acquiring, in_window, second_level])
@pytest.mark.parametrize("paused", [False, True])
@pytest.mark.parametrize("code", [ResultCode.STOPPED, ResultCode.CANCELED, ResultCode.NODE_LOST])
def test_stop_ends_with_zero_from_every_phase(pacing, when, paused, code):
    bench = Bench([Fate()], pacing)
    bench.start(plan())
    bench.until(lambda: when(bench))
    if paused:
        assert bench.call(bench.machine.pause)
        for _ in range(30):
            if bench.possible():
                bench.move(bench.possible()[0])
    levels = len(bench.machine.records)
    bench.call(bench.machine.stop, code, "Enough.")
    bench.run()
    assert (bench.machine.code, bench.machine.reason) == (code, "Enough.")
    assert bench.orders[-1].amplitude == 0.0
    assert amplitudes(bench).count(0.0) == 1
    assert len(bench.machine.records) == levels
    assert bench.machine.progress < 1.0
    assert not bench.loop.late or not pacing.lockstep


def test_the_first_stop_counts():
    bench = Bench([Fate()])
    bench.start(plan())
    bench.call(bench.machine.stop, ResultCode.CANCELED, "First.")
    bench.call(bench.machine.stop, ResultCode.STOPPED, "Second.")
    bench.until(lambda: bench.machine.phase == RunPhase.STOPPING)
    bench.call(bench.machine.stop, ResultCode.STOPPED, "Third.")
    bench.run()
    assert (bench.machine.code, bench.machine.reason) == (ResultCode.CANCELED, "First.")


@pytest.mark.parametrize("call", ["stop", "abandon"])
def test_without_a_run_there_is_nothing_to_end(call):
    machine = RunMachine(PACING)
    getattr(machine, call)(ResultCode.STOPPED, "Enough.")
    assert (machine.phase, machine.code, machine.take_orders()) == (RunPhase.IDLE, ResultCode.UNKNOWN, [])


# -- pause -----------------------------------------------------------------------------------------------------------


@given(st.integers(0, 200), fates.filter(lambda items: all(fate.limit_after is None for fate in items)))
@settings(max_examples=60, deadline=None)
def test_in_lockstep_a_pause_stands_still_and_leaves_no_trace(moves, level_fates):
    levels = tuple(range(1, len(level_fates) + 1))
    plain = finished(level_fates, levels=levels)
    bench = Bench(level_fates)
    bench.start(plan(levels))
    for _ in range(moves):
        if bench.possible() and bench.machine.active:
            bench.move(bench.possible()[0])
    if bench.call(bench.machine.pause):
        standing = []
        for _ in range(500):
            if not bench.possible():
                break
            bench.move(bench.possible()[0])
            standing.append(bench.machine.horizon)
        assert not bench.possible()  # bench time has come to rest
        # An acknowledgement on its way may still release the tick that was decided before.
        assert len(set(standing)) <= 2
        assert bench.machine.phase == RunPhase.PAUSED
        assert bench.call(bench.machine.resume)
    bench.run()
    assert bench.orders == plain.orders
    # Two ticks may be waiting when the pause ends; the horizon then passes both at once.
    assert set(bench.horizons) <= set(plain.horizons)
    assert bench.horizons[-1] == plain.horizons[-1]


def test_in_real_time_a_pause_holds_the_level():
    bench = Bench([Fate(window=3)], REALTIME)
    bench.start(plan())
    bench.until(lambda: in_window(bench))
    assert bench.call(bench.machine.pause)
    produced = bench.produced
    bench.until(lambda: bench.produced > produced + 100 * BLOCK)
    assert amplitudes(bench) == [1.0]
    assert bench.call(bench.machine.resume)
    bench.run()
    assert amplitudes(bench) == [1.0, 2.0, 3.0, 0.0]
    assert bench.orders[1].apply_at_sample > produced + 100 * BLOCK
    assert bench.machine.code == ResultCode.SUCCEEDED


def test_pause_and_resume_say_whether_they_did_anything():
    machine = RunMachine(PACING)
    assert not machine.pause()
    assert not machine.resume()
    machine.start(plan())
    assert not machine.resume()
    assert machine.pause()
    assert not machine.pause()
    assert machine.phase == RunPhase.PAUSED
    assert machine.resume()
    assert machine.phase == RunPhase.RUNNING


def test_a_run_that_is_stopping_cannot_be_paused():
    bench = Bench([Fate()])
    bench.start(plan())
    bench.call(bench.machine.stop, ResultCode.STOPPED, "Enough.")
    bench.until(lambda: bench.machine.phase == RunPhase.STOPPING)
    assert not bench.machine.pause()


# -- abandon, several runs -------------------------------------------------------------------------------------------


@PACINGS
def test_abandon_ends_a_run_whose_loop_is_silent(pacing):
    bench = Bench([Fate()], pacing)
    bench.start(plan())
    bench.until(lambda: in_window(bench))
    bench.call(bench.machine.abandon, ResultCode.NODE_LOST, "The loop no longer answers.")
    assert bench.done
    assert bench.machine.code == ResultCode.NODE_LOST
    assert bench.machine.end_sample == bench.machine.newest + 1
    assert not bench.machine.active


def test_abandon_while_stopping_keeps_the_first_reason():
    bench = Bench([Fate()])
    bench.start(plan())
    bench.call(bench.machine.stop, ResultCode.CANCELED, "Cancelled.")
    bench.until(lambda: bench.machine.phase == RunPhase.STOPPING)
    bench.call(bench.machine.abandon, ResultCode.NODE_LOST, "Silent.")
    assert (bench.machine.code, bench.machine.reason) == (ResultCode.CANCELED, "Cancelled.")


@PACINGS
def test_a_second_run_goes_on_in_sample_and_sequence(pacing):
    bench = finished(pacing=pacing)
    orders, produced = len(bench.orders), bench.produced
    bench.start(plan((5.0, 6.0)))
    assert bench.machine.progress == 0.0
    bench.run()
    second = bench.orders[orders:]
    assert [order.amplitude for order in second] == [5.0, 6.0, 0.0]
    assert [order.index for order in second] == [0, 1, 1]
    assert [order.sequence for order in second] == [orders + 1, orders + 2, orders + 3]
    assert second[0].apply_at_sample >= produced
    assert bench.machine.reason == "2 of 2 levels locked."
    assert bench.horizons == sorted(bench.horizons)


@PACINGS
def test_a_lost_run_does_not_spoil_the_next(pacing):
    """The loop still reports the loss of the first run's level 0 when the second run's level 0 is ordered."""
    bench = finished([Fate(locks=False)], pacing, levels=(1.0,))
    assert bench.loop.state == LoopState.LOCK_LOST
    bench.loop.fates = [Fate()]
    bench.start(plan((5.0,)))
    # The level is slow to arrive; blocks pass meanwhile where nothing holds them back.
    for _ in range(40):
        moves = [name for name in bench.possible() if name != "levels"]
        if moves:
            bench.move(moves[0])
    bench.run()
    assert bench.machine.reason == "1 of 1 levels locked."
    assert bench.machine.code == ResultCode.SUCCEEDED


@PACINGS
def test_a_run_after_an_abandoned_one_does_not_wait_for_the_old_lock(pacing):
    bench = Bench([Fate(window=10_000)], pacing)
    bench.start(plan((1.0, 2.0)))
    bench.until(lambda: in_window(bench) and bench.machine.records[0].locked_at is not None)
    bench.call(bench.machine.abandon, ResultCode.NODE_LOST, "The loop no longer answers.")
    bench.loop.fates = [Fate()]
    bench.start(plan((5.0,)))
    bench.run()
    assert bench.machine.reason == "1 of 1 levels locked."


@PACINGS
@pytest.mark.parametrize("stands_at", [0, 1000 * BLOCK])
def test_a_run_begins_where_a_new_plant_stands(pacing, stands_at):
    """Also where that is before or far behind what the machine has driven so far."""
    bench = finished([Fate()], pacing, levels=(1.0,))
    bench.machine.join(stands_at)
    assert bench.machine.newest == stands_at - 1
    bench.produced, bench.plant_horizon, bench.horizons = stands_at, stands_at, []
    bench.loop.newest = None
    bench.start(plan((5.0,)))
    assert stands_at <= bench.orders[-1].apply_at_sample <= stands_at + 2 * pacing.tick
    bench.run()
    assert bench.machine.reason == "1 of 1 levels locked."
    bench.machine.phase = RunPhase.RUNNING
    with pytest.raises(BenchError, match="A run is active"):
        bench.machine.join(0)


def test_only_one_run_at_a_time():
    machine = RunMachine(PACING)
    machine.start(plan())
    with pytest.raises(BenchError, match=r"A run is active \(run\); stop it or wait for its end"):
        machine.start(plan())


def test_old_reports_change_nothing():
    bench = Bench([Fate()])
    bench.start(plan())
    bench.until(lambda: in_window(bench))
    machine = bench.machine
    newest, horizon, report = machine.newest, machine.horizon, machine.report
    machine.on_report(status(newest - BLOCK, 0, 1, LoopState.LOCK_LOST, BlockFlag.LIMIT))
    assert (machine.newest, machine.horizon, machine.report) == (newest, horizon, report)
    assert machine.take_orders() == []


# -- plans -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"levels": ()}, "Plan: a plan needs 1 to 1000 levels"),
        ({"levels": (1.0, math.nan)}, "Plan: every level must be positive and finite"),
        ({"levels": (1.0, 0.0)}, "Plan: every level must be positive and finite"),
        ({"control": 0}, "Control 0 is not known"),
        ({"control": 4}, "Control 4 is not known"),
        ({"ramp": -0.1}, "The ramp must be finite and >= 0 s"),
        ({"ramp": math.nan}, "The ramp must be finite"),
        ({"ramp": math.inf}, "The ramp must be finite"),
        ({"timeout": -1.0}, "The time-out must be finite and >= 0 s"),
        ({"timeout": math.nan}, "The time-out must be finite"),
        ({"window_periods": 0}, "A window needs at least one period"),
    ],
)
def test_plans_that_cannot_be_run_are_refused(fields, words):
    with pytest.raises(BenchError, match=words):
        plan(**fields)


def test_a_lock_event_from_before_the_level_began_is_not_taken():
    bench = Bench([Fate(locks=True, blocks=50)])
    bench.start(plan())
    bench.until(lambda: len(bench.machine.records) == 2)
    record = bench.machine.records[-1]
    bench.machine.on_lock(record.index, record.started - 1, record.started + 5 * BLOCK)
    assert (record.locked_at, record.window_end) == (None, None)
    bench.machine.on_lock(record.index, record.started, record.started + 5 * BLOCK)
    assert (record.locked_at, record.window_end) == (record.started, record.started + 5 * BLOCK)
