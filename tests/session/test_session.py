"""A session in one process: how it ends, and what its bag says."""

from __future__ import annotations

import itertools
import json
import math
import signal
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nmt_bench.page.server import steering_request
from nmt_bench.page.start_goal import goal_of, start_request
from nmt_benchmark.channel_figures import large_rig
from nmt_core.errors import BenchError
from nmt_core.messages.blocks import SampleBlock
from nmt_core.messages.records import DriveCommand, LockEvent, LoopStatus, RunState
from nmt_core.messages.wire import LOCK_EVENT
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import LoopState, PointStatus, Quantity, ResultCode, RunPhase, SteeringAct, Waveform
from nmt_extract.offline import extract_bag
from nmt_plant.devices.device import DeviceFault
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_plant.oscillator import OscillatorBlock
from nmt_record.bag.bag_reader import Bag
from nmt_rig.rig import load_rig
from nmt_sequencer.run_core import RunCore
from nmt_sequencer.steering import SteeringRequest
from nmt_session import Progress, Session, TestPlan, plan_test
from nmt_session.node_plan import plan_nodes


def one_level(**changes: Any) -> TestPlan:
    """A short phase resonance test of the beam."""
    return plan_test("beam", **{"levels": [0.5], "window_periods": 10, "run_id": "short", **changes})


def last_blocks(bag: Bag, count: int = 1) -> list[SampleBlock]:
    return list(bag.blocks("voltage"))[-count:]


def test_a_run_ends_with_its_points_and_a_bag_that_gives_them_again(tmp_path: Path) -> None:
    seen: list[Progress] = []
    with Session(one_level(), tmp_path) as session:
        result = session.run(seen.append)
    assert (result.code, result.bag_state, result.interrupted) == (ResultCode.SUCCEEDED, "closed", False)
    assert session.levels_locked == 1
    bag = Bag.open(tmp_path / "bag")
    assert bag.loss is None
    assert (bag.run_stop or {})["exit"] == {"state": "done", "reason": ""}
    assert bag.run_start == session.plan.run
    assert bag.rig_yaml == session.test.rig_yaml
    assert not last_blocks(bag)[0].data.any()
    (point,) = extract_bag(tmp_path / "bag").points
    assert point.identical(result.points[0])
    assert all(0.0 <= progress.fraction_done <= 1.0 for progress in seen)


def test_without_a_folder_nothing_stays_behind() -> None:
    with Session(one_level()) as session:
        folder = session.out
        assert (folder / "bag").is_dir()
    assert not folder.exists()


def test_with_its_drive_at_zero_the_loop_says_off_and_no_frequency() -> None:
    drives: list[DriveCommand] = []
    statuses: list[LoopStatus] = []

    def listen(_: str, record: Any) -> None:
        if isinstance(record, DriveCommand):
            drives.append(record)
        elif isinstance(record, LoopStatus):
            statuses.append(record)

    with Session(one_level(), record=False, extract=False, listener=listen) as session:
        session.run()
    quiet = [drive for drive in drives if drive.amplitude == 0.0]
    assert len(quiet) > 5
    assert {drive.waveform for drive in quiet} == {Waveform.OFF}
    assert {drive.waveform for drive in drives if drive.amplitude > 0.0} == {Waveform.SINE}
    assert {status.frequency_hz for status in statuses if status.drive_amplitude == 0.0} == {0.0}
    assert all(status.frequency_hz > 0.0 for status in statuses if status.drive_amplitude > 0.0)
    assert LoopState.LOCKED in {status.state for status in statuses}


@pytest.mark.parametrize(
    ("control", "levels", "unit"), [("voltage", [0.5], "V"), ("force", [0.8], "N"), ("response", [2e-4], "m")]
)
def test_the_level_of_a_lock_is_in_the_unit_of_what_is_held(
    control: str, levels: list[float], unit: str, tmp_path: Path
) -> None:
    with Session(one_level(control=control, levels=levels), tmp_path) as session:
        result = session.run()
    assert session.test.level_unit == unit
    (event,) = Bag.open(tmp_path / "bag").records("lock", LOCK_EVENT)
    assert (event.level, event.level_unit) == (levels[0], unit)
    assert result.points[0].level_unit == unit


def test_a_stop_ramps_the_drive_to_zero(tmp_path: Path) -> None:
    def stop_at_lock(_: str, record: Any) -> None:
        if isinstance(record, LockEvent):
            assert session.stop()

    with Session(one_level(), tmp_path, listener=stop_at_lock) as session:
        result = session.run()
        assert not session.stop()
    assert (result.code, result.bag_state) == (ResultCode.STOPPED, "closed")
    assert [point.status for point in result.points] == [PointStatus.REJECTED]
    assert not last_blocks(Bag.open(tmp_path / "bag"))[0].data.any()


def test_an_interrupt_ramps_the_drive_to_zero_and_is_a_result(tmp_path: Path) -> None:
    def interrupt(_: str, record: Any) -> None:
        if isinstance(record, LockEvent):
            signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    with Session(one_level(), tmp_path, listener=interrupt) as session:
        result = session.run()
    assert signal.getsignal(signal.SIGINT) is before
    assert (result.code, result.interrupted, result.bag_state) == (ResultCode.CANCELED, True, "closed")
    assert not last_blocks(Bag.open(tmp_path / "bag"))[0].data.any()


def test_an_error_of_a_callback_goes_on_after_the_ramp(tmp_path: Path) -> None:
    peak = 0.0

    def fail(_: str, record: Any) -> None:
        nonlocal peak
        if isinstance(record, SampleBlock) and record.quantity is Quantity.VOLTAGE:
            peak = max(peak, float(abs(record.data).max()))
        if isinstance(record, LockEvent):
            raise RuntimeError("no space for figures")

    with Session(one_level(), tmp_path, listener=fail) as session, pytest.raises(RuntimeError, match="no space"):
        session.run()
    bag = Bag.open(tmp_path / "bag")
    assert (bag.run_stop or {})["exit"] == {"state": "interrupted", "reason": "RuntimeError: no space for figures"}
    assert not last_blocks(bag)[0].data.any()
    # The drive goes to zero along a ramp, not at once.
    steps = [float(abs(block.data).max()) for block in last_blocks(bag, 50)]
    assert peak > 0.4
    assert any(0.1 * peak < step < 0.9 * peak for step in steps)


class _Faulty(SimulatedRig):
    """A rig that fails after a second."""

    def _measure(self, drive: OscillatorBlock) -> FloatArray:
        if self.next_sample > 10_000:
            raise DeviceFault("samples were lost")
        return super()._measure(drive)


def test_a_fault_of_the_device_is_a_result(tmp_path: Path) -> None:
    with Session(one_level(), tmp_path, device=_Faulty(load_rig("beam"))) as session:
        result = session.run()
    assert result.code == ResultCode.NODE_LOST
    assert "samples were lost" in result.message
    assert result.bag_state == "closed"


def test_what_the_loop_really_has_stays_out_of_the_bag(tmp_path: Path) -> None:
    hidden = {"phase_offset_rad": 0.1}
    with Session(one_level(), tmp_path, loop_values=hidden) as session:
        off = session.run().points[0]
    with Session(one_level(), record=False) as plain:
        on = plain.run().points[0]
    assert abs(off.phase_error - on.phase_error) == pytest.approx(0.1, abs=0.01)
    start = Bag.open(tmp_path / "bag").run_start or {}
    assert start["parameters"]["pll"].get("phase_offset_rad", 0.0) == 0.0


def test_a_described_run_is_in_the_bag_as_described(tmp_path: Path) -> None:
    session = Session(one_level(), tmp_path, extract=False)
    session.describe({"run_id": "mine"})
    with session:
        session.run()
    assert Bag.open(tmp_path / "bag").run_start == {"run_id": "mine"}
    assert json.loads((tmp_path / "run.json").read_text()) == {"run_id": "mine"}


def test_states_of_the_run_come_in_order() -> None:
    phases: list[RunPhase] = []

    def listen(_: str, record: Any) -> None:
        if isinstance(record, RunState) and (not phases or phases[-1] is not record.phase):
            phases.append(record.phase)

    with Session(one_level(), record=False, extract=False, listener=listen) as session:
        session.run()
    assert phases == [RunPhase.IDLE, RunPhase.RUNNING, RunPhase.STOPPING, RunPhase.DONE]


def test_refusals(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="runs in lockstep"):
        Session(one_level(pacing="realtime"))
    with (
        pytest.raises(BenchError, match="'colour' is not known to pll"),
        Session(one_level(), loop_values={"colour": 1}),
    ):
        pass
    (tmp_path / "bag").mkdir()
    with pytest.raises(BenchError, match="exists already"), Session(one_level(), tmp_path):
        pass
    with Session(one_level(), record=False, extract=False) as session:
        session.run()
        with pytest.raises(BenchError, match="runs once"):
            session.run()


@pytest.mark.parametrize(
    ("pacing", "latency", "lead"),
    [
        ("lockstep", 0, 0),
        ("lockstep", 2, 2),
        ("realtime", 0, 6),
        ("realtime", 2, 3),
        ("realtime", 4, 4),
        ("realtime", 9, 9),
    ],
)
def test_all_nodes_reckon_with_the_blocks_that_wait_at_the_output(pacing: str, latency: int, lead: int) -> None:
    plan = plan_nodes(one_level(pacing=pacing, latency_blocks=latency), Path("bag"), Path("rig.yaml"))
    assert plan.plant.latency_blocks == plan.pll.loop_settings.latency_blocks == plan.sequencer.latency_blocks == lead
    assert bool(plan.plant.output_record) == (pacing == "realtime")


@pytest.mark.parametrize(
    ("pacing", "channels", "linked", "joined"),
    [
        ("lockstep", 3, False, False),
        ("lockstep", 3, True, True),
        ("lockstep", 200, False, True),
        ("realtime", 3, True, False),
        ("realtime", 200, True, True),
    ],
)
def test_the_loop_takes_its_input_joined_with_many_channels_or_past_the_middleware(
    pacing: str, channels: int, linked: bool, joined: bool
) -> None:
    plan = plan_test(large_rig(10, channels, 25_600.0), [0.3], pacing=pacing, linked=linked)
    nodes = plan_nodes(plan, Path("bag"), Path("rig.yaml"))
    assert nodes.pll.joined_input is joined
    assert {settings.linked for settings in nodes.settings.values()} == {linked and pacing == "lockstep"}
    assert nodes.plant.loop_topics == (("force", "acceleration") if joined else ("",))
    peers = nodes.pll.expected_peers
    assert ("loop_input:1" in peers) is joined
    assert ("force:1" in peers) is not joined
    if joined:
        assert nodes.plant.drive_point == plan.rig.drive_point
        assert "loop_input:1" in nodes.plant.expected_peers


def absurd_levels() -> list[Any]:
    """A hundred values that are no level of a rig with a limit of 50 V."""
    strange: list[Any] = [True, False, None, "2", "", [1.0], {}, 1j, b"1", math.nan, math.inf, -math.inf, 0.0, -1.0]
    strange += [1e308, 10**400, -(10**400), 50.001, np.float64(1e300), object()]
    return strange + list(10.0 ** np.random.default_rng(5).uniform(1.7, 308.0, 100 - len(strange)))


def test_no_way_to_give_levels_passes_the_limit_or_ends_a_test() -> None:
    given = plan_nodes(one_level(), Path("bag"), Path("rig.yaml"))
    core = RunCore(given.sequencer)
    change = SteeringAct.CHANGE_LEVELS
    ways: dict[str, Callable[[list[Any]], Any]] = {
        "page": lambda levels: session.steer(steering_request({"act": "change_levels", "levels": levels})),
        "page's start": lambda levels: goal_of(start_request({"levels": repr(levels)[1:-1]}), given.run["plan"]),
        "service": lambda levels: session.steer(SteeringRequest(change, levels=tuple(levels))),
        "action": lambda levels: core.plan({**given.goal, "levels": levels}),
    }
    refused = Counter[str]()
    amplitudes = set()

    def listen(_: str, record: Any) -> None:
        if isinstance(record, DriveCommand):
            amplitudes.add(record.amplitude)
        if not isinstance(record, LockEvent):
            return
        for value, (way, ask) in itertools.product(absurd_levels(), ways.items()):
            try:
                answer = ask([0.3, value, 0.4])
            except BenchError as error:
                answer = str(error)
            refused[way] += isinstance(answer, str) and bool(answer)

    with Session(one_level(), record=False, listener=listen) as session:
        result = session.run()
    assert refused == dict.fromkeys(ways, 100)
    assert (result.code, [point.status for point in result.points]) == (ResultCode.SUCCEEDED, [PointStatus.OK])
    assert max(amplitudes) == 0.5


@pytest.mark.parametrize(
    ("control", "level", "settings"),
    [
        ("force", 30.0, {}),
        ("response", 9e-3, {}),
        ("force", 0.5, {"test": "response_curve", "release": 1e300}),
        ("force", 30.0, {"test": "secondary_resonance", "resonance": "3:1"}),
    ],
    ids=["force", "response", "release", "secondary resonance"],
)
def test_a_level_that_needs_more_than_the_voltage_limit_ends_with_that_reason(control, level, settings):
    """The plant refuses such commands, so that the loop would wait for its time-out at an old drive."""
    plan = plan_test("strong_cubic", [level], overrides=["limits.voltage_v=0.8"], control=control, **settings)
    with Session(plan, record=False) as session:
        result = session.run()
    assert all(point.status is not PointStatus.OK for point in result.points)
    assert "the voltage limit of 0.8 V" in result.points[0].reason
    assert result.bench_time < 60.0
