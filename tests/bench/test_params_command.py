"""The parameter file for ``ros2 run`` holds what the harness itself gives its nodes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
import yaml

from nmt_bench.cli import main
from nmt_core.messages.linear_description import LinearDescription
from nmt_rig.rig import load_rig
from nmt_session.node_plan import NODES


def test_the_files_describe_one_test(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    words = ["params", "beam", "--levels", "0.1,0.2", "--exciter", "4", "--set", "seed=9", "--out", str(out)]
    assert main(words) == 0
    printed = capsys.readouterr().out
    nodes = yaml.safe_load((out / "nodes.yaml").read_text())
    assert set(nodes) == {f"/**/{name}" for name in NODES}  # in any namespace
    values = {name.rpartition("/")[2]: content["ros__parameters"] for name, content in nodes.items()}
    assert values["plant"]["rig_file"] == str(out / "rig.yaml")
    assert values["plant"]["pacing"] == "realtime"
    assert LinearDescription.from_json(values["pll"]["linear_json"]).drive_point == 4
    assert load_rig(out / "rig.yaml").seed == 9
    assert json.loads((out / "goal.json").read_text())["levels"] == [0.1, 0.2]
    assert f"./nmt goal {out}" in printed
    starter = "ros2 run" if shutil.which("ros2") else "./nmt ros"  # the wheels have no command ros2
    for name, (package, executable, _) in NODES.items():
        assert f"  {starter} {package} {executable} " in printed, name


def test_a_goal_without_nodes_is_refused_in_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nmt_bench.commands.goal_command._PATIENCE", 0.3)
    assert main(["params", "beam", "--out", str(tmp_path / "out")]) == 0
    capsys.readouterr()
    for name, text in (("other", '{"levels": [0.1], "speed": 3}'), ("empty", "{}")):
        shutil.copytree(tmp_path / "out", tmp_path / name)
        (tmp_path / name / "goal.json").write_text(text)
    for words, sentence in (
        (
            (str(tmp_path / "out"), "--domain", "99", "--namespace", "bench1"),
            "No sequencer answers in ROS domain 99 under",
        ),
        ((str(tmp_path / "out"), "--domain", "500"), "from 0 to 232"),
        ((str(tmp_path),), "goal.json cannot be read"),
        ((str(tmp_path / "other"),), "not a goal of a run"),
        ((str(tmp_path / "empty"),), "holds no plan of a run"),
    ):
        assert main(["goal", *words]) == 2
        error = capsys.readouterr().err
        assert sentence in error
        assert error.count("\n") == 1


def test_nothing_is_left_of_a_refusal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["params", "beam", "--levels", "0", "--out", str(tmp_path / "out")]) == 2
    assert "positive" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
