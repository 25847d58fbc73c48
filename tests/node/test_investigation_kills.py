"""A node that is killed in the middle of an investigation: its drive ends at zero, nothing is lost, and it goes on."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from node.kill_trials import MARK, marked

from nmt_bench.commands.investigate_command import measure
from nmt_core.errors import BenchError
from nmt_core.kinds import RandomTest
from nmt_core.kinds.request import TestRequest
from nmt_diagnose.investigation.investigation import Investigation, InvestigationSettings
from nmt_diagnose.investigation.investigation_record import AskedTest, EmptyTestError, InvestigationRecord, read_record
from nmt_diagnose.ledger.diagnosis import Ranked, Share, Verdict
from nmt_record.bag.bag_reader import Bag
from nmt_session.node_plan import NODES

RIG = "joint_resonator"
LINEAR = AskedTest(
    "01_linear", TestRequest(kind=RandomTest(), rig=RIG), "a random test", "", seconds=10.0, state="measured"
)
_LONGEST = 240.0  # s of wall time until a bag has begun


def levels_alone(test: AskedTest, out: Path) -> tuple[float, float]:
    """Levels without the file of a linear test, which counts as made."""
    return measure(replace(test, request=replace(test.request, linear="")), out)


def sure(_: Any) -> tuple[Any, float]:
    """A diagnosis that names its cause."""
    first = Ranked("cubic_stiffness", "structure", "2", 0.99, (), {}, Share(0.9, 0.8, 1.0), 9.0)
    return SimpleNamespace(
        verdict=Verdict.EFFECT, sentences=("where", "which"), ranking=(first,), next_test=(), adequate=True,
        probabilities={"cubic_stiffness@2": 0.99}, next_levels=None,
    ), 0.0  # fmt: skip


def investigation(folder: Path, record: InvestigationRecord, periods: int) -> Investigation:
    settings = InvestigationSettings(levels=(0.3, 0.5), periods=periods)
    return Investigation(record, settings, folder, partial(levels_alone, out=folder), sure)


def kill(mark: str, node: str, bag: Path) -> None:
    """Kill a node once the bag of the test has samples of its first level."""
    end = time.monotonic() + _LONGEST
    while time.monotonic() < end:
        size = sum(path.stat().st_size for path in bag.glob("*.mcap")) if bag.is_dir() else 0
        # Who is who is asked of every process of the machine, so only when it is needed.
        found = [process for process, name in marked(mark).items() if name == node] if size > 200_000 else []
        if found:
            os.kill(found[0], signal.SIGKILL)
            return
        time.sleep(0.02)


def last_drive(bag: Path) -> float:
    """Largest drive of the last recorded block, V."""
    found = Bag.open(bag)
    voltages = [topic for topic in found.sample_topics if "voltage" in topic]
    blocks = [block for topic in voltages for block in found.blocks(topic)]
    return float(np.abs(blocks[-1].data).max())


def recorded_s(bag: Path) -> float:
    """Bench time of the samples of the drive that are in a bag, s."""
    found = Bag.open(bag)
    topic = next(topic for topic in found.sample_topics if "voltage" in topic)
    blocks = list(found.blocks(topic))
    return float(sum(block.data.size for block in blocks) / blocks[0].sample_rate)


@pytest.mark.campaign
@pytest.mark.parametrize("node", NODES)
def test_a_killed_node_costs_its_test_only(node: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Through the second test of three."""
    mark = f"{os.getpid()}-{node}"
    monkeypatch.setenv(MARK, mark)
    begun = InvestigationRecord(RIG, RIG, tests=(LINEAR,))
    victim = threading.Thread(target=kill, args=(mark, node, tmp_path / "02_levels" / "bag"))
    victim.start()
    with pytest.raises(BenchError, match="its drive is at zero, and what it recorded is left out") as failure:
        investigation(tmp_path, begun, 200_000).run()
    victim.join()
    assert "Traceback" not in str(failure.value)
    assert not marked(mark)
    kept = read_record(tmp_path)
    assert kept is not None
    assert [test.state for test in kept.tests] == ["measured", "failed"]
    # What was recorded until then is read all the same.
    assert recorded_s(tmp_path / "02_levels" / "bag") > 0.2
    if node not in ("plant", "recorder"):  # else nobody was left to say it, or to write it down
        assert last_drive(tmp_path / "02_levels" / "bag") == 0.0
    monkeypatch.delenv(MARK)
    record = investigation(tmp_path, kept, 20).run()
    assert [test.state for test in record.tests] == ["measured", "failed", "measured"]
    assert record.ended == "named"
    result = json.loads((tmp_path / "03_levels" / "run.json").read_text())["result"]
    assert result["message"].startswith("2 of 2 levels")


@pytest.mark.campaign
def test_a_test_that_locks_nothing_has_not_failed(tmp_path: Path) -> None:
    asked = TestRequest(rig=RIG, levels=(0.3,), periods=20, changes=(("test.lock_timeout_s", 0.3),))
    hasty = AskedTest("01_levels", asked, "levels", "")
    with pytest.raises(EmptyTestError, match="No level of test 01_levels locked") as nothing:
        measure(hasty, tmp_path)
    result = json.loads((tmp_path / "01_levels" / "run.json").read_text())["result"]
    assert nothing.value.seconds == result["bench_time_s"] > 0.0
