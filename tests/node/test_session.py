"""The bag of the nodes and the bag of a session in one process: equal on every topic, message for message."""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest
from tiers import with_quick

from nmt_bench.harness import Bench
from nmt_core.messages.wire import RUN_RECORD, STEERING
from nmt_core.vocabulary import RecordKind, ResultCode, RunPhase, SteeringAct
from nmt_record.bag.bag_reader import Bag
from nmt_sequencer.steering import SteeringRequest
from nmt_session import Session, plan_test

pytestmark = pytest.mark.node

TESTS: dict[str, dict[str, Any]] = {
    "phase_resonance": {"levels": [0.2, 0.5], "window_periods": 20, "seed": 3},
    "force": {"levels": [0.4, 0.8], "window_periods": 20, "control": "force"},
    "latency": {"levels": [0.3], "window_periods": 20, "latency_blocks": 2},
    "harmonics": {"levels": [0.3308, 0.7], "window_periods": 20, "harmonics_control": 9, "compare": 2},
    "modal_power": {
        "levels": [0.7], "window_periods": 20, "harmonics_control": "auto", "harmonics_target": "modal",
        "overrides": ["extraction.linear_modes=3"],
    },
    "lost": {"levels": [0.3, 0.4], "window_periods": 20, "timeout": 0.3},
    "random": {"levels": [0.05], "test": "random", "band_hz": (5.0, 500.0), "duration": 2.0},
    "ring_down": {"levels": [0.3], "test": "ring_down", "duration": 2.0},
    "sweep": {
        "levels": [0.5], "test": "sweep", "frequencies_hz": [20.0], "rate_hz_s": 1.0, "frequency_end_hz": 24.0,
        "control": "force",
    },
    "stepped_sine": {"levels": [0.2], "test": "stepped_sine", "frequencies_hz": [20.0, 21.0], "window_periods": 20},
    "limit": {"levels": [0.3, 3.0], "window_periods": 20, "overrides": ["limits.voltage_v=4", "limits.force_n=2"]},
}  # fmt: skip
# Of the run's records: when it was made, where its files lie, and messages counted on a topic that only nodes have.
PROCESS_FACTS = ("started",)
PATHS = (("parameters", "plant", "rig_file"), ("parameters", "recorder", "output"))


def messages(path: Path) -> dict[str, list[bytes]]:
    """Serialised messages by topic; those of ``/diagnostics`` tell of processes."""
    found: dict[str, list[bytes]] = defaultdict(list)
    for topic, _, _, raw in Bag.open(path).raw_messages():
        if topic != "diagnostics":
            found[topic].append(bytes(raw))
    return found


def records(raws: list[bytes]) -> list[tuple[RecordKind, Any, str, int]]:
    """Run records without process facts."""
    found = []
    for record in map(RUN_RECORD.read, raws):
        run = json.loads(record.run_json)
        for name in PROCESS_FACTS:
            assert run.pop(name)
        for *sections, name in PATHS:
            section = run
            for key in sections:
                section = section[key]
            assert Path(section.pop(name)).is_absolute()
        run.get("counts", {}).pop("diagnostics", None)
        found.append((record.kind, run, record.rig_yaml, record.time_ns))
    return found


def same(a: bytes, b: bytes) -> bool:
    """Whether two messages are equal; between processes the middleware fills up the last word."""
    return a == b or (a.startswith(b) and len(a) - len(b) < 4 and not len(a) % 4)


def compare(live: Path, alone: Path) -> None:
    there, here = messages(live), messages(alone)
    assert set(there) == set(here)
    assert {"force", "drive", "frequency", "level", "run_state", "run_record"} <= set(here)
    assert records(there.pop("run_record")) == records(here.pop("run_record"))
    for topic, raws in there.items():
        assert len(raws) == len(here[topic]), topic
        different = [number for number, pair in enumerate(zip(raws, here[topic], strict=True)) if not same(*pair)]
        assert not different, (topic, different[:5], raws[different[0]], here[topic][different[0]])


@pytest.mark.parametrize("name", with_quick(TESTS, "phase_resonance", "sweep", "limit"))
def test_a_session_writes_the_bag_that_the_nodes_write(name: str, tmp_path: Path) -> None:
    arguments = {"run_id": name, **TESTS[name]}
    with Bench("beam", out=tmp_path / "live", **arguments) as bench:
        live = bench.run()
    with Session(plan_test("beam", **arguments), tmp_path / "alone") as session:
        alone = session.run()
    assert (live.code, live.message, live.bench_time) == (alone.code, alone.message, alone.bench_time)
    assert alone.code == (ResultCode.LIMIT if name == "limit" else ResultCode.SUCCEEDED)
    assert len(live.points) == len(alone.points)
    assert all(a.identical(b) for a, b in zip(live.points, alone.points, strict=True))
    assert live.bag is not None
    assert alone.bag is not None
    compare(live.bag, alone.bag)


STEERED = (
    SteeringRequest(SteeringAct.PAUSE, at_sample=9_000, source="a test"),
    SteeringRequest(SteeringAct.SKIP_LEVEL, 0, at_sample=12_000, source="a test"),
    SteeringRequest(SteeringAct.CHANGE_LEVELS, levels=(0.45, 0.35, 0.9), at_sample=14_000, source="a test"),
    SteeringRequest(SteeringAct.REPEAT_LEVEL, 1, at_sample=22_000, source="a test"),
    SteeringRequest(SteeringAct.END, at_sample=70_000, source="a test"),
)


def test_nodes_and_a_session_that_are_steered_at_the_same_samples_write_the_same_bag(tmp_path: Path) -> None:
    arguments = {"run_id": "steered", **TESTS["phase_resonance"]}
    answers: list[str] = []

    def steer_session(topic: str, record: Any) -> None:
        if topic == "run_state" and record.phase == RunPhase.RUNNING and not answers:
            answers.extend(session.steer(request) for request in STEERED)

    def steer_bench(progress: Any) -> None:
        if not asked:
            asked.append(True)
            futures.extend(bench.ask_to_steer(request) for request in STEERED)
        if progress.sample >= 8_999:
            futures.append(bench.ask_to_steer(SteeringRequest(SteeringAct.RESUME, source="the session")))

    with Session(plan_test("beam", **arguments), tmp_path / "alone", listener=steer_session) as session:
        alone = session.run()
    assert answers == [""] * len(STEERED)
    asked: list[bool] = []
    futures: list[Any] = []
    with Bench("beam", out=tmp_path / "live", **arguments) as bench:
        live = bench.run(steer_bench)
    assert alone.code == live.code == ResultCode.STOPPED
    assert live.message == "Stopped by a test."
    assert all(future.result().success for future in futures[: len(STEERED)])
    there, here = messages(tmp_path / "live" / "bag"), messages(tmp_path / "alone" / "bag")
    acts = [STEERING.read(raw) for raw in here["steering"]]
    assert [act.act for act in acts] == [
        SteeringAct.PAUSE,
        SteeringAct.RESUME,
        SteeringAct.SKIP_LEVEL,
        SteeringAct.CHANGE_LEVELS,
        SteeringAct.REPEAT_LEVEL,
        SteeringAct.END,
    ]
    for topic in ("force", "acceleration", "voltage", "drive", "frequency", "level", "lock", "modal_point", "steering"):
        assert len(there[topic]) == len(here[topic]), topic
        if topic == "steering":  # when the pause ended is told by the sample, how long it was is not
            continue
        assert all(same(*pair) for pair in zip(there[topic], here[topic], strict=True)), topic


@pytest.mark.campaign
def test_so_do_nodes_in_processes_of_their_own(tmp_path: Path) -> None:
    arguments = {"run_id": "processes", **TESTS["phase_resonance"]}
    with Bench("beam", out=tmp_path / "live", processes=True, **arguments) as bench:
        live = bench.run()
    with Session(plan_test("beam", **arguments), tmp_path / "alone") as session:
        alone = session.run()
    assert live.bag is not None
    assert alone.bag is not None
    compare(live.bag, alone.bag)
