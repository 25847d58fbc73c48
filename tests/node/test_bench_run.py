"""Whole runs: all nodes, a bag, modal points; how a run ends when something goes wrong."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import signal
import subprocess
import threading
from pathlib import Path

import numpy as np
import pytest
import yaml
from node import lockstep_trials
from tiers import with_quick

from nmt_bench.harness import Bench, Progress, RunResult
from nmt_core.errors import BenchError
from nmt_core.messages.wire import MODAL_POINT
from nmt_core.vocabulary import LoopState, PointStatus, ResultCode
from nmt_extract.modal.table import write_csv
from nmt_extract.offline import extract_bag
from nmt_record.bag.bag_reader import Bag
from nmt_report.run_report import report_data_from_bag, write_report
from nmt_rig.reference import single_point_reference
from nmt_rig.rig import load_rig
from nmt_session.node_plan import NODES

SAMPLES = ("force", "displacement", "acceleration", "voltage")


def samples_digest(bag: Path) -> str:
    """SHA-256 over all samples and excitation phases, in order of topic and time (not over padding bytes)."""
    digest = hashlib.sha256()
    opened = Bag.open(bag)
    for topic in SAMPLES:
        for block in opened.blocks(topic):
            digest.update(f"{topic} {block.first_sample} {block.channels} {block.oscillator!r} {block.flags}".encode())
            digest.update(block.data.tobytes())
    return digest.hexdigest()


def run_once(out: Path, **options: object) -> RunResult:
    with Bench("beam", [0.2, 0.7], out=out, window_periods=20, **options) as bench:  # type: ignore[arg-type]
        return bench.run()


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> RunResult:
    return run_once(tmp_path_factory.mktemp("run") / "out")


def test_levels_lock_and_agree_with_the_single_point_reference(finished: RunResult) -> None:
    assert finished.code == ResultCode.SUCCEEDED
    assert finished.bag_state == "closed"
    reference = single_point_reference(load_rig("beam"), 2, [0.2, 0.7], harmonics=15)
    for index, point in enumerate(finished.points):
        assert point.status == PointStatus.OK
        assert point.omega_rad_s == pytest.approx(reference.mode.omega_rad_s[index], rel=2e-4)
        assert point.damping_ratio == pytest.approx(reference.mode.damping_ratio[index], rel=5e-3)


def test_extraction_from_the_bag_equals_the_live_result_bit_for_bit(finished: RunResult) -> None:
    assert finished.bag is not None
    offline = extract_bag(finished.bag)
    assert offline.loss is None
    assert len(offline.points) == len(finished.points) == 2
    assert all(a.identical(b) for a, b in zip(offline.points, finished.points, strict=True))


def test_no_sample_is_missing_from_the_bag(finished: RunResult) -> None:
    assert finished.bag is not None
    bag = Bag.open(finished.bag)
    assert bag.run_stop is not None
    assert bag.run_stop["exit"]["state"] == "done"
    for topic in SAMPLES:
        following = 0
        for block in bag.blocks(topic):
            assert block.first_sample == following
            following = block.end_sample
        assert following == round(finished.bench_time * 10_000)


@pytest.mark.parametrize("options", [{"processes": True}, {"linked": False}], ids=["processes", "topics"])
def test_processes_and_transport_do_not_change_a_bit(
    options: dict[str, bool], finished: RunResult, tmp_path: Path
) -> None:
    again = run_once(tmp_path / "again", **options)
    assert finished.bag is not None
    assert again.bag is not None
    assert samples_digest(again.bag) == samples_digest(finished.bag)
    write_csv(finished.points, tmp_path / "a.csv")
    write_csv(again.points, tmp_path / "b.csv")
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_noise_follows_the_seed(tmp_path: Path) -> None:
    noise = ["sensors.0.noise_psd=2e-9", "sensors.0.noise_correlation_time_s=1e-5"]
    digests = []
    for name, seed in (("a", 7), ("b", 7), ("c", 8)):
        with Bench("beam", [0.7], out=tmp_path / name, window_periods=10, overrides=noise, seed=seed) as bench:
            digests.append(samples_digest(bench.run().bag or Path()))
    assert digests[0] == digests[1] != digests[2]


def test_nothing_is_left_without_an_output_folder() -> None:
    threads = threading.active_count()
    with Bench("beam", [0.7], window_periods=5) as bench:
        folder = bench.out
        assert bench.run().code == ResultCode.SUCCEEDED
        assert folder.exists()
    assert not folder.exists()
    assert threading.active_count() == threads
    with pytest.raises(BenchError, match="runs once"):
        bench.run()


def test_a_level_that_does_not_lock_is_marked_and_the_run_goes_on(tmp_path: Path) -> None:
    hopeless = {"pll": {"scatter_limit": 1e-12}}
    with Bench("beam", [0.2, 0.7], window_periods=5, timeout=1.0, node_values=hopeless) as bench:
        result = bench.run()
    assert result.code == ResultCode.SUCCEEDED
    assert [point.status for point in result.points] == [PointStatus.NOT_LOCKED, PointStatus.NOT_LOCKED]
    assert "time-out" in result.points[0].reason
    assert "0 of 2 levels locked" in result.message


def test_a_lost_lock_can_end_the_run() -> None:
    hopeless = {"pll": {"scatter_limit": 1e-12}}
    with Bench(
        "beam", [0.2, 0.7], window_periods=5, timeout=1.0, stop_on_lost_lock=True, node_values=hopeless
    ) as bench:
        result = bench.run()
    assert result.code == ResultCode.LOCK_LOST
    assert "time-out" in result.message


def test_a_tripped_limit_ends_the_run_with_the_drive_at_zero(tmp_path: Path) -> None:
    with Bench("beam", [0.2, 1.0], out=tmp_path / "out", window_periods=5, overrides=["limits.force_n=0.5"]) as bench:
        result = bench.run()
    assert result.code == ResultCode.LIMIT
    assert "force limit: f" in result.message, "the channel, its value and the limit are the sentence"
    assert "limit 0.5 N" in result.message
    last = list(Bag.open(tmp_path / "out" / "bag").blocks("voltage"))[-1]
    assert not last.data.any()


def test_cancelling_ramps_to_zero_and_closes_the_bag(tmp_path: Path) -> None:
    with Bench("beam", [0.2] * 20, out=tmp_path / "out", window_periods=50) as bench:

        def cancel_when_locked(progress: Progress) -> None:
            if progress.state == LoopState.LOCKED:
                bench.cancel()

        result = bench.run(cancel_when_locked)
    assert result.code == ResultCode.CANCELED
    bag = Bag.open(tmp_path / "out" / "bag")
    assert bag.loss is None
    blocks = list(bag.blocks("voltage"))
    assert not blocks[-1].data.any()
    voltage = np.concatenate([block.data[0] for block in blocks])
    assert np.max(np.abs(np.diff(voltage))) < 0.2 * 2 * np.pi * 25 / 10_000  # a ramp, not a step


def test_wrong_plans_are_refused_before_anything_starts(tmp_path: Path) -> None:
    for levels, sentence in (([], "1 to 1000 levels"), ([0.1, -1.0], "positive"), ("1:2", "not a plan")):
        with pytest.raises(BenchError, match=sentence):
            Bench("beam", levels, out=tmp_path / "out")
    with pytest.raises(BenchError, match="lockstep or realtime"):
        Bench("beam", [0.1], pacing="fast")
    with pytest.raises(BenchError, match="at least 3 periods"):
        Bench("beam", [0.1], window_periods=1)
    assert not (tmp_path / "out").exists()


def test_nodes_with_other_blocks_are_refused(tmp_path: Path) -> None:
    odd = {"sequencer": {"block_samples": 150}}
    with Bench("beam", [0.3], out=tmp_path / "out", node_values=odd) as bench:
        result = bench.run()
    assert result.code == ResultCode.REFUSED
    assert result.message == (
        "Node plant has block_samples 200, the sequencer 150: they would wait for each other; start all nodes with the "
        "parameter file of one rig."
    )


# The plant and the recorder die with blocks that are still between them. In real time that is a part of a second; in
# lockstep, forty times as fast, a recorder that waits for a processor is behind by any number of them.
@pytest.mark.parametrize(
    ("victim", "pacing"),
    with_quick(
        [*((name, "lockstep") for name in NODES), ("plant", "realtime"), ("recorder", "realtime")], ("pll", "lockstep")
    ),
)
def test_a_killed_node_ends_the_run(victim: str, pacing: str, tmp_path: Path) -> None:
    levels = [0.3, 0.5, 0.8, 1.0]
    with Bench("beam", levels, out=tmp_path / "out", processes=True, pacing=pacing) as bench:
        assert bench.processes is not None
        pids = bench.processes.pids
        killed: list[int] = []

        def kill_when_locked(progress: Progress) -> None:
            if progress.state == LoopState.LOCKED and not killed:
                killed.append(progress.sample)
                os.kill(pids[victim], signal.SIGKILL)

        result = bench.run(kill_when_locked)
    assert killed
    assert result.code == ResultCode.NODE_LOST
    assert result.lost_node == victim
    assert f"Node {victim} has died (killed by SIGKILL)" in result.message
    for pid in pids.values():
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
    bag = Bag.open(tmp_path / "out" / "bag")
    blocks = list(bag.blocks("voltage"))
    both_live = victim not in ("recorder", "plant")
    if both_live or pacing == "realtime":
        assert blocks[-1].end_sample > killed[0] - 10_000
    else:
        ends = [block.end_sample for block in blocks]
        assert [block.first_sample for block in blocks[1:]] == ends[:-1]  # what arrived is whole
    if victim != "plant":  # what it had said last may be lost with it
        assert (bag.loss is not None) == (victim == "recorder")
    assert (bag.path / "metadata.yaml").is_file() == (victim != "recorder")
    if both_live:
        assert not blocks[-1].data.any()


@pytest.mark.parametrize("reader", with_quick(["recorder", "extract"], "recorder"))
def test_in_lockstep_a_stopped_reader_is_waited_for(reader: str, tmp_path: Path) -> None:
    """It is stopped until the plant waits for it; bag and points are whole."""
    said: list[str] = []
    stopped: list[int] = []
    values = {"plant": {"reader_lead": 2.0}}
    with Bench("beam", [0.3], out=tmp_path / "out", processes=True, window_periods=120, node_values=values) as bench:
        assert bench.processes is not None
        process = bench.processes.pids[reader]

        def strike(progress: Progress) -> None:
            if progress.state == LoopState.LOCKED and not stopped:
                stopped.append(progress.sample)
                os.kill(process, signal.SIGSTOP)

        turn = bench.turn

        def look() -> None:
            turn()
            if stopped and bench.client.plant_said.get("waits_for") == reader and not said:
                said.append(bench.client.plant_said["next_sample"])
                os.kill(process, signal.SIGCONT)

        bench.turn = look  # type: ignore[method-assign]
        result = bench.run(strike)
    assert said, "the plant did not wait"
    assert result.code == ResultCode.SUCCEEDED, result.message
    assert (result.bag_state, result.lacks_s) == ("closed", 0.0)
    assert [point.status for point in result.points] == [PointStatus.OK]
    assert result.missing == ()
    bag = Bag.open(tmp_path / "out" / "bag")
    assert bag.loss is None
    assert bag.run_stop is not None
    assert bag.run_stop["lacks_s"] == 0.0
    run = json.loads((tmp_path / "out" / "run.json").read_text())
    assert run["result"]["bag"] == {"state": "closed", "lacks_s": 0.0}
    assert run["result"]["points"] == {"count": 1, "not_live": []}


@pytest.mark.campaign
def test_a_lead_shorter_than_a_bundle_and_than_what_readers_tell_stands_nowhere() -> None:
    """The plant keeps nothing joined for long, and readers tell what they have when they rest."""
    values = {"plant": {"reader_lead": 0.05, "bundle_blocks": 50}, "sequencer": {"stall_timeout": 5.0}}
    with Bench("beam", [0.7], window_periods=5, node_values=values) as bench:
        result = bench.run()
    assert result.code == ResultCode.SUCCEEDED, result.message
    assert [point.status for point in result.points] == [PointStatus.OK]


RAISING = """
import nmt_extract.extractor as extractor
known = extractor.modal_point
def raising(window, *rest):
    if window.lock.level_index == 2:
        raise RuntimeError("made to fail at the third level")
    return known(window, *rest)
extractor.modal_point = raising
"""


@pytest.mark.campaign
def test_a_level_at_which_extraction_fails_is_named_and_the_table_comes_from_the_bag(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "sitecustomize.py").write_text(RAISING, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    with Bench("beam", [0.2, 0.3, 0.4, 0.5], out=tmp_path / "out", processes=True, window_periods=20) as bench:
        result = bench.run()
    assert result.code == ResultCode.NODE_LOST
    assert result.lost_node == "extract"
    assert not result.complete
    assert "made to fail at the third level" in result.message
    assert 2 in result.missing
    assert "were extracted from the bag" in result.message
    assert [point.level_index for point in result.points] == list(range(len(result.points)))
    again = extract_bag(tmp_path / "out" / "bag").points
    assert all(one.identical(other) for one, other in zip(result.points, again, strict=True))
    assert not list(Bag.open(tmp_path / "out" / "bag").blocks("voltage"))[-1].data.any()


def test_what_ends_extraction_from_the_bag_as_well_costs_no_point_that_came(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(path: Path) -> None:
        raise RuntimeError("made to fail")

    monkeypatch.setattr("nmt_extract.offline.extract_bag", failing)
    values = {"sequencer": {"points_timeout": 1.0}}
    with Bench("beam", [0.2, 0.3], out=tmp_path / "out", window_periods=10, node_values=values) as bench:
        publisher = bench.nodes["extract"].publisher
        publish = publisher.publish
        publisher.publish = lambda raw: publish(raw) if MODAL_POINT.read(raw).level_index == 0 else None
        result = bench.run()
    assert result.code == ResultCode.POINTS_MISSING
    assert [point.level_index for point in result.points] == [0]
    assert result.missing == (1,)
    assert "Extraction of level 2 from the bag failed, too (RuntimeError: made to fail)" in result.message
    run = json.loads((tmp_path / "out" / "run.json").read_text())
    assert run["result"]["points"] == {"count": 1, "not_live": [2]}


@pytest.mark.campaign
def test_points_that_do_not_come_are_missed_by_name(tmp_path: Path) -> None:
    """Extraction lives on and says nothing of two levels: no success, and the table is whole all the same."""
    values = {"sequencer": {"points_timeout": 1.0}}
    levels = [0.2, 0.3, 0.5]
    with Bench("beam", levels, out=tmp_path / "out", window_periods=20, node_values=values) as bench:
        publisher = bench.nodes["extract"].publisher
        publish = publisher.publish

        def silent(raw: bytes) -> None:
            if MODAL_POINT.read(raw).level_index == 0:
                publish(raw)

        publisher.publish = silent
        result = bench.run()
    assert result.code == ResultCode.POINTS_MISSING
    assert not result.complete
    assert result.missing == (1, 2)
    assert "of 2 of 3 locked levels did not come from extraction: levels 2 and 3." in result.message
    assert [point.status for point in result.points] == [PointStatus.OK] * 3
    run = json.loads((tmp_path / "out" / "run.json").read_text())
    assert run["result"]["code"] == "POINTS_MISSING"
    assert run["result"]["points"] == {"count": 3, "not_live": [2, 3]}
    data = report_data_from_bag(tmp_path / "out" / "bag", list(result.points))
    page = tmp_path / "report.html"
    write_report(data, page)
    assert "Extraction sent no point of levels 2 and 3 while the test ran (2 of 3 locked)" in page.read_text()


@pytest.mark.campaign
@pytest.mark.parametrize(("count", "periods"), [(12, 20), (40, 200), (100, 40)])
def test_on_one_processor_every_level_gives_its_point(count: int, periods: int, tmp_path: Path) -> None:
    processors = os.sched_getaffinity(0)
    levels = [float(level) for level in np.geomspace(0.05, 1.5, count)]
    os.sched_setaffinity(0, {min(processors)})
    try:
        with Bench("beam", levels, out=tmp_path / "out", processes=True, window_periods=periods) as bench:
            result = bench.run()
    finally:
        os.sched_setaffinity(0, processors)
    assert result.code == ResultCode.SUCCEEDED, result.message
    assert [point.level_index for point in result.points] == list(range(count))
    again = extract_bag(tmp_path / "out" / "bag").points
    assert all(one.identical(other) for one, other in zip(result.points, again, strict=True))


@pytest.mark.campaign
@pytest.mark.parametrize("queue", [10, 512])
@pytest.mark.parametrize("hurt", ["recorder:stop", "recorder:slow", "extract:stop", "extract:slow"])
def test_a_reader_stopped_for_seconds_or_slowed_to_a_tenth_takes_all(
    hurt: str, queue: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On one processor, with queues of the kernel of two lengths, by the command."""
    if subprocess.run(["unshare", "-n", "true"], capture_output=True, check=False).returncode:
        pytest.skip("a queue of another length needs a network of its own, and that needs root")
    chosen = {"levels": 40, "periods": 40, "processors": 1, "queue": queue, "hurt": hurt}
    for name, value in chosen.items():
        monkeypatch.setattr(lockstep_trials.OPTIONS, name, value, raising=False)
    mark = f"slow-reader-{os.getpid()}-{hurt}-{queue}"
    assert lockstep_trials.account(tmp_path / "out", mark, np.random.default_rng(1)) == []
    assert lockstep_trials.leftovers(mark) == []


@pytest.mark.campaign
def test_a_point_that_never_comes_in_real_time_is_not_waited_for_without_end() -> None:
    """The source goes on after the run, and so does what extraction takes of it."""
    values = {"sequencer": {"points_timeout": 1.0}}
    options = {"pacing": "realtime", "latency_blocks": 25, "window_periods": 5, "node_values": values}
    with Bench("beam", [0.7], **options) as bench:  # type: ignore[arg-type]
        bench.nodes["extract"].publisher.publish = lambda raw: None
        result = bench.run()
    assert result.code == ResultCode.POINTS_MISSING
    assert result.missing == (0,)
    assert [point.status for point in result.points] == [PointStatus.OK]


@pytest.mark.campaign
def test_real_time_keeps_the_clock() -> None:
    with Bench("beam", [0.7], window_periods=20, pacing="realtime", latency_blocks=25) as bench:
        result = bench.run()
    assert result.code == ResultCode.SUCCEEDED, result.message
    assert result.points[0].status == PointStatus.OK
    assert 0.8 < result.real_time_factor < 1.2
    assert any("Real time" in line for line in result.remarks)


def test_blocks_of_latency_do_not_bias_the_result(finished: RunResult) -> None:
    with Bench("beam", [0.2, 0.7], window_periods=20, latency_blocks=2) as bench:
        result = bench.run()
    assert result.code == ResultCode.SUCCEEDED
    for late, prompt in zip(result.points, finished.points, strict=True):
        assert late.omega_rad_s == pytest.approx(prompt.omega_rad_s, rel=2e-4)
        assert late.damping_ratio == pytest.approx(prompt.damping_ratio, rel=5e-3)


def test_levels_beyond_the_rigs_voltage_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=r"60 V is beyond the limit of the rig \(limits.voltage_v: 50 V\)"):
        Bench("beam", [0.1, 60.0], out=tmp_path / "out")
    with pytest.raises(BenchError, match="ramp must be positive"):
        Bench("beam", [0.1], ramp=0.0)


def test_a_velocity_sensor_is_recorded_too(tmp_path: Path) -> None:
    sensor = tmp_path / "rig.yaml"
    text = load_rig("beam").model_dump_json()
    rig = load_rig_text(text, sensor)
    with Bench(str(rig), [0.7], out=tmp_path / "out", window_periods=5) as bench:
        assert bench.run().code == ResultCode.SUCCEEDED
    assert Bag.open(tmp_path / "out" / "bag").topics["velocity"][1] > 0


def load_rig_text(text: str, path: Path) -> Path:
    """A rig file with a velocity sensor at point 5 beside the beam's own."""
    values = {key: value for key, value in json.loads(text).items() if value is not None}
    sensors = [{k: v for k, v in item.items() if v is not None} for item in values["sensors"]]
    values["sensors"] = [*sensors, {"quantity": "velocity", "point": 5}]
    values["local_elements"] = [{k: v for k, v in e.items() if v is not None} for e in values["local_elements"]]
    path.write_text(yaml.safe_dump(values), encoding="utf-8")
    return path


def test_a_full_disk_ends_the_run_and_keeps_what_was_recorded(tmp_path: Path) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with Bench("beam", [0.3] * 5, out=tmp_path / "out", window_periods=100) as bench:
        writer = bench.nodes["recorder"].writer

        def fill_the_disk(progress: Progress) -> None:
            if progress.state == LoopState.LOCKED:
                writer.mcap.flush = full

        result = bench.run(fill_the_disk)
    assert result.code == ResultCode.NODE_LOST
    assert result.bag_state == "failed"
    assert "recorder reports" in result.message
    assert "No space left on device" in result.message
    assert len(list(Bag.open(tmp_path / "out" / "bag").blocks("force"))) > 10
