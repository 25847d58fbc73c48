"""Where neither ROS nor the source tree is, the definitions of the messages come with the wheel."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = """
from nmt_core.messages.wire import LEVEL
from nmt_record.bag.message_definitions import local_definitions
print(local_definitions().definition("nmt_msgs/msg/SampleBlock").text, LEVEL.fields)
"""


@pytest.mark.parametrize("complete", [True, False])
def test_definition_is_found_beside_the_module(tmp_path: Path, complete: bool) -> None:
    source = ROOT / "ros2_ws" / "src"
    for package in ("nmt_core", "nmt_record"):
        shutil.copytree(source / package / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    included = tomllib.loads((ROOT / "pyproject.toml").read_text())
    for origin, place in included["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"].items():
        if complete:
            shutil.copytree(ROOT / origin, tmp_path / place)
    environment = {k: v for k, v in os.environ.items() if k != "AMENT_PREFIX_PATH"}
    environment["PYTHONPATH"] = str(tmp_path)
    answer = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, env=environment)
    if complete:
        assert "first_sample" in answer.stdout, answer.stderr
        assert "apply_at_sample" in answer.stdout
    else:
        assert "is not on this machine" in answer.stderr
