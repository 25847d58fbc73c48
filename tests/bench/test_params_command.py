"""The parameter file for ``ros2 run`` holds what the harness itself gives its nodes."""

from __future__ import annotations

import json
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
    goal = json.loads(printed.split("nmt_msgs/action/RunLevels '")[1].split("'")[0])
    assert goal["levels"] == [0.1, 0.2]
    for name, (package, executable, _) in NODES.items():
        assert f"ros2 run {package} {executable} " in printed, name


def test_nothing_is_left_of_a_refusal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["params", "beam", "--levels", "0", "--out", str(tmp_path / "out")]) == 2
    assert "positive" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
