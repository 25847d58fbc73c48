"""Goals in a row on the same nodes: every run has a bag of its own, and none goes unrecorded."""

from __future__ import annotations

import errno
import json
from pathlib import Path
from typing import Any

import pytest

from nmt_bench.cli import main
from nmt_bench.harness import Bench
from nmt_core.errors import BenchError
from nmt_core.messages.command_judge import LONGEST_AHEAD
from nmt_core.messages.wire import MODAL_POINT
from nmt_core.vocabulary import ResultCode
from nmt_extract.offline import extract_bag
from nmt_msgs.action import RunLevels
from nmt_record.bag.bag_reader import Bag
from nmt_record.bag.run_recorder import free_path


def send(bench: Bench, **goal: Any) -> Any:
    """Send a goal as an operator does, and wait for its result."""
    client = bench.client.action_client
    bench.spin_until(client.server_is_ready, 20.0, "the action server")
    handle = bench.wait_for(client.send_goal_async(RunLevels.Goal(**goal)), 20.0, "the answer")
    assert handle.accepted
    answer = handle.get_result_async()
    # Not spin_once, which does not rest while the sequencer awaits the end of its run.
    bench.work(answer, 60.0)
    return answer.result().result


def test_the_goal_command_starts_the_run_of_nodes_that_are_there(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with Bench("beam", [0.3, 0.4], out=tmp_path / "out", window_periods=20, processes=True) as bench:
        bench.spin_until(bench.client.server_is_ready, 60.0, "the action server")
        bench.spin_until(lambda: not bench.client.liveness.unheard, 60.0, "all nodes")
        (bench.out / "goal.json").write_text(json.dumps(bench.plan.goal), encoding="utf-8")
        assert main(["goal", str(bench.out), "--domain", str(bench.domain_id)]) == 0
        assert "2 of 2 levels locked" in capfd.readouterr().out
        bag = wait_for_closed(bench, bench.out / "bag")
    assert len(bag.lock_events()) == 2


def wait_for_bag(bench: Bench) -> None:
    bench.spin_until(lambda: bench.nodes["recorder"].state == "closed", 20.0, "the bag")


def wait_for_closed(bench: Bench, folder: Path) -> Bag:
    """The bag of a recorder in a process of its own, once it is closed."""

    def closed() -> bool:
        try:
            return Bag.open(folder).run_stop is not None
        except BenchError:
            return False

    bench.spin_until(closed, 20.0, f"the bag {folder.name}")
    return Bag.open(folder)


@pytest.mark.parametrize("pacing", ["lockstep", pytest.param("realtime", marks=pytest.mark.campaign)])
def test_three_goals_give_three_bags_that_extract_bit_for_bit(pacing: str, tmp_path: Path) -> None:
    plans = ([0.3, 0.7], [0.5], [0.7, 0.2]) if pacing == "lockstep" else ([0.3], [0.5], [0.7])
    out = tmp_path / "out"
    late = 25 if pacing == "realtime" else 0  # blocks; a busy machine may be late by half a second
    with Bench("beam", [0.1], out=out, pacing=pacing, latency_blocks=late, window_periods=5) as bench:
        results = []
        for levels in plans:  # one after the other without a pause: the bag before may still be open
            results.append(send(bench, levels=levels, window_periods=5))
        wait_for_bag(bench)
    folders = [out / "bag", out / "bag-2", out / "bag-3"]
    assert sorted(path.name for path in out.iterdir() if path.is_dir()) == [folder.name for folder in folders]
    names = set()
    for folder, levels, result in zip(folders, plans, results, strict=True):
        assert (result.result_code, result.levels_locked) == (ResultCode.SUCCEEDED, len(levels))
        bag = Bag.open(folder)
        assert bag.loss is None
        assert bag.run_start is not None
        assert bag.run_stop is not None
        assert bag.run_start["plan"]["levels"] == levels
        assert bag.run_stop["exit"] == {"state": "done", "reason": ""}
        assert all(counts["gaps"] == 0 for counts in bag.run_stop["gaps"].values())
        names.add(bag.run_start["run_id"])
        live = list(bag.records("modal_point", MODAL_POINT))
        offline = extract_bag(folder).points
        assert [point.level for point in live] == levels
        assert all(a.identical(b) for a, b in zip(offline, live, strict=True))
        blocks = list(bag.blocks("voltage"))
        assert not blocks[-1].data.any()
    if pacing == "realtime":
        assert len(names) == 3


@pytest.mark.campaign
def test_a_run_begins_on_nodes_that_have_worked_for_long(tmp_path: Path) -> None:
    """Longer than a message may name a sample ahead: that is counted from where the run before has ended."""
    with Bench("beam", [0.1], out=tmp_path / "out") as bench:
        assert send(bench, levels=[0.1], window_periods=1600).result_code == ResultCode.SUCCEEDED
        device = bench.nodes["plant"].device
        assert device.next_sample > LONGEST_AHEAD * device.sample_rate
        assert send(bench, levels=[0.2], window_periods=5).result_code == ResultCode.SUCCEEDED


@pytest.mark.campaign
def test_nodes_may_be_started_again_between_runs(tmp_path: Path) -> None:
    """The others go on from where they are; a plant that is new counts its samples from zero."""
    out = tmp_path / "out"
    with Bench("beam", [0.1], out=out, window_periods=5, processes=True) as bench:
        assert bench.processes is not None
        assert send(bench, levels=[0.3], window_periods=5).result_code == ResultCode.SUCCEEDED
        for number, name in enumerate(["plant", "pll", "sequencer"], start=2):
            before = bench.processes.pids[name]
            bench.processes.restart(name)
            assert bench.processes.pids[name] != before
            result = send(bench, levels=[0.2, 0.4], window_periods=5)
            assert (result.result_code, result.levels_locked) == (ResultCode.SUCCEEDED, 2), (name, result.message)
            bag = wait_for_closed(bench, out / f"bag-{number}")
            assert bag.run_stop is not None
            assert all(counts["gaps"] == 0 for counts in bag.run_stop["gaps"].values()), name
            live = list(bag.records("modal_point", MODAL_POINT))
            assert [point.level for point in live] == pytest.approx([0.2, 0.4])
            assert all(a.identical(b) for a, b in zip(extract_bag(bag.path).points, live, strict=True))


def test_a_run_that_stands_still_ends_and_says_so(tmp_path: Path) -> None:
    """All nodes are alive, but the loop's states are not taken: nobody else would notice."""
    values = {"node_values": {"sequencer": {"stall_timeout": 1.0}}}
    with Bench("beam", [0.1], out=tmp_path / "out", **values) as bench:
        bench.nodes["sequencer"].core.judge.horizon = 1
        result = send(bench, levels=[0.1], window_periods=5)
    assert result.result_code == ResultCode.NODE_LOST
    assert "No block after sample 0 was answered for 1 s" in result.message
    assert "Refused last: it claims to be based on sample" in result.message


def test_a_run_that_cannot_be_recorded_does_not_begin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Bench("beam", [0.3], out=tmp_path / "out", window_periods=5) as bench:
        assert send(bench, levels=[0.3], window_periods=5).result_code == ResultCode.SUCCEEDED
        wait_for_bag(bench)
        before = bench.nodes["plant"].device.next_sample

        def full(*_: object, **__: object) -> None:
            raise OSError(errno.ENOSPC, "No space left on device")

        with monkeypatch.context() as patch:
            patch.setattr(Path, "mkdir", full)
            refused = send(bench, levels=[0.3], window_periods=5)
        assert refused.result_code == ResultCode.REFUSED
        assert refused.message.startswith("The run would not be recorded: The bag ")
        assert "No space left on device" in refused.message
        assert bench.nodes["plant"].device.next_sample == before  # nothing moved
        again = send(bench, levels=[0.3], window_periods=5)
        assert again.result_code == ResultCode.SUCCEEDED
        wait_for_bag(bench)
    assert (tmp_path / "out" / "bag-2").is_dir()


def test_too_little_space_is_said_before_a_goal_is_sent(tmp_path: Path) -> None:
    values = {"recorder": {"least_free_mb": 10**9}}
    with Bench("beam", [0.3], out=tmp_path / "out", node_values=values) as bench:
        result = bench.run()
    assert result.code == ResultCode.REFUSED
    assert "less than 1000000000 MB (parameter 'least_free_mb')" in result.message


def test_without_a_recorder_no_run_begins(tmp_path: Path) -> None:
    values = {"sequencer": {"ready_timeout": 1.0, "watched_nodes": ["plant", "pll", "extract"]}}
    with Bench("beam", [0.3], out=tmp_path / "out", node_values=values) as bench:
        recorder = bench.nodes["recorder"]
        bench.spin_until(bench.client.server_is_ready, 20.0, "the action server")
        recorder.destroy_subscription(recorder._announcement_subscription)
        result = bench.run()
    assert result.code == ResultCode.NODE_LOST
    assert "no recorder has opened a bag for this run" in result.message


def test_folders_are_counted_up_and_never_reused(tmp_path: Path) -> None:
    assert free_path(tmp_path / "bag") == tmp_path / "bag"
    for name in ("bag", "bag-2", "bag-4"):
        (tmp_path / name).mkdir()
    assert free_path(tmp_path / "bag") == tmp_path / "bag-3"
