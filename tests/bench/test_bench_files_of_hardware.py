"""Nodes started by hand on a rig with a converter: they drive it, its bags say so, and a check has passed before."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from nmt_bench.cli import main
from nmt_bench.hardware.hardware_checks import keep_check
from nmt_bench.orchestration.bench_files import write_bench_files
from nmt_core.errors import BenchError
from nmt_core.messages.run_announcement import RunAnnouncement
from nmt_diagnose.observations.origin import origin_of
from nmt_plant.devices.hardware_rig import HARDWARE_LEAD, device_of
from nmt_record.bag.bag_reader import Bag
from nmt_record.bag.run_recorder import RunRecorder, described_run
from nmt_rig.rig import load_rig
from nmt_session.node_plan import NodePlan


@pytest.fixture
def rig_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The beam with a channel map of its own, and a check that passed: a delay of two blocks and a sample."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    content = load_rig("beam").model_dump(mode="json", exclude_none=True)
    section = device_of(load_rig("beam"), "portaudio").model_copy(update={"name": "Laboratory"})
    content["device"] = section.model_dump(mode="json", exclude_none=True)
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    rig = load_rig(path)
    assert rig.device is not None
    check = {"time": time.time(), "passed": True, "findings": [], "delay_samples": 2 * rig.block_samples + 1}
    keep_check(rig, rig.device, check)
    return path


def recorded(plan: NodePlan, run_json: str | None = None) -> Bag:
    """The bag of a run that ends at once."""
    recorder = RunRecorder(plan.recorder, run_json=run_json)
    recorder.close("done", "")
    return Bag.open(Path(plan.recorder.output))


def test_the_nodes_drive_the_converter_and_the_bag_names_it(rig_file: Path, tmp_path: Path) -> None:
    plan = write_bench_files(str(rig_file), tmp_path / "out", tmp_path / "out")
    nodes = yaml.safe_load((tmp_path / "out" / "nodes.yaml").read_text())
    values = {name.rpartition("/")[2]: content["ros__parameters"] for name, content in nodes.items()}
    assert (values["plant"]["device"], values["plant"]["pacing"]) == ("portaudio", "realtime")
    for name in ("plant", "pll", "sequencer"):
        assert values[name]["latency_blocks"] == HARDWARE_LEAD + 3, name
    bag = recorded(plan)
    origin = origin_of(bag, tmp_path / "out")
    assert (origin.kind, origin.device) == ("measured", "portaudio")
    assert origin.rig is not None
    assert origin.rig.device == load_rig(rig_file).device  # ports, sensitivities and their sheets


def test_a_further_goal_on_the_same_nodes_is_of_the_same_device(rig_file: Path, tmp_path: Path) -> None:
    plan = write_bench_files(str(rig_file), tmp_path / "out", tmp_path / "out")
    second = RunAnnouncement("goal 2", "again", {"levels": [0.1]})
    bag = recorded(plan, described_run(plan.recorder, second))
    assert bag.run_start is not None
    assert (bag.run_start["run_id"], bag.run_start["device"]) == ("again", "portaudio")


@pytest.mark.parametrize(
    ("rig", "device", "named"),
    [
        ("own", "simulated", "simulated rig"),
        ("beam", "simulated", "simulated rig"),
        ("beam", "", ""),  # a plant of one's own may take the place of the bench's
    ],
)
def test_what_is_simulated_by_wish_is_called_so(
    rig: str, device: str, named: str, rig_file: Path, tmp_path: Path
) -> None:
    plan = write_bench_files(str(rig_file) if rig == "own" else rig, tmp_path / "out", tmp_path / "out", device=device)
    assert plan.plant.device == ""
    assert plan.run["device"] == named


def test_the_ports_of_the_simulated_specimen_are_called_so(rig_file: Path, tmp_path: Path) -> None:
    rig = load_rig("beam")
    keep_check(rig, device_of(rig, "portaudio"), {"time": time.time(), "passed": True, "delay_samples": 0})
    plan = write_bench_files("beam", tmp_path / "out", tmp_path / "out", device="portaudio")
    assert plan.run["device"] == "portaudio (nmt_specimen)"
    assert plan.plant.device == "portaudio"


Refusal = Callable[[Path], tuple[list[str], str]]
REFUSALS: dict[str, Refusal] = {
    "not checked": lambda rig: (
        [str(rig), "--set", "limits.force_n=33", "--exciter", "2"],
        f"type: ./nmt check {rig} --set limits.force_n=33 --exciter 2",
    ),
    "lockstep": lambda rig: ([str(rig), "--pacing", "lockstep"], "in real time; leave out --pacing lockstep"),
    "another kind": lambda rig: ([str(rig), "--device", "asio"], "--device 'asio' is not known"),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_hardware_is_refused_with_a_sentence(
    case: str, rig_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words, sentence = REFUSALS[case](rig_file)
    assert main(["params", *words, "--out", str(tmp_path / "out"), "--json"]) == 2
    document: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert sentence in " ".join(document["error"].split())
    assert not (tmp_path / "out").exists()


def test_a_refused_check_is_a_bench_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    with pytest.raises(BenchError, match=r"has not been checked .* type: \./nmt check beam --device portaudio"):
        write_bench_files("beam", tmp_path / "out", tmp_path / "out", device="portaudio")
