"""The launch file, without the packages of ``ros2 launch``, which the wheels do not have.

Stand-ins take what the file says, and the nodes are started and interrupted as ``launch`` does it: as one process
group, SIGINT to all of it and to each.
"""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
import time
import types
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from nmt_bench.orchestration.bench_domain import bench_environment
from nmt_bench.orchestration.node_processes import find_executable
from nmt_core.errors import BenchError
from nmt_session.node_plan import NODES

FILE = Path(__file__).parents[2] / "ros2_ws" / "src" / "nmt_bench" / "launch" / "bench.launch.py"


class Said:
    """A stand-in for an action of launch: what it was made with."""

    def __init__(self, *values: Any, **options: Any) -> None:
        self.values, self.options = values, options

    def perform(self, context: dict[str, str]) -> str:
        return context[self.values[0]]


class StartedNode(Said):
    """As ``launch_ros.actions.Node`` of ROS 2 Jazzy: what it takes, and the command it makes."""

    TAKES = frozenset(("package", "executable", "name", "namespace", "parameters", "output", "on_exit")) | {
        "sigterm_timeout",
        "sigkill_timeout",
    }

    def __init__(self, **options: Any) -> None:
        assert set(options) <= self.TAKES
        super().__init__(**options)

    @property
    def command(self) -> list[str]:
        given = self.options
        executable = find_executable(given["package"], given["executable"])
        words = [str(executable), "--ros-args", "-r", f"__node:={given['name']}"]
        if given["namespace"]:
            words += ["-r", f"__ns:=/{given['namespace'].strip('/')}"]
        for file in given["parameters"]:
            words += ["--params-file", file]
        return words


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> types.ModuleType:
    contents = {
        "launch": {"LaunchDescription": Said},
        "launch.actions": dict.fromkeys(("DeclareLaunchArgument", "LogInfo", "OpaqueFunction", "Shutdown"), Said),
        "launch.substitutions": {"LaunchConfiguration": Said},
        "launch_ros": {},
        "launch_ros.actions": {"Node": StartedNode},
    }
    for name, members in contents.items():
        module = types.ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    spec = importlib.util.spec_from_file_location("bench_launch", FILE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def started(module: types.ModuleType, **arguments: str) -> list[StartedNode]:
    """The nodes that a launch with these arguments starts."""
    (entities,) = module.generate_launch_description().values
    declared = {entity.values[0]: entity.options["default_value"] for entity in entities[:-1]}
    assert set(arguments) <= set(declared)
    start = entities[-1].options["function"]
    return [entity for entity in start({**declared, **arguments}) if isinstance(entity, StartedNode)]


def test_all_five_nodes_with_their_parameters(launch_file: types.ModuleType, tmp_path: Path) -> None:
    nodes = started(launch_file, rig="joint_resonator", pacing="lockstep", namespace="hall", out=str(tmp_path))
    assert {node.options["name"]: node.options["package"] for node in nodes} == {
        name: package for name, (package, _, _) in NODES.items()
    }
    assert {node.options["namespace"] for node in nodes} == {"hall"}
    assert all(node.options["parameters"] == [str(tmp_path / "nodes.yaml")] for node in nodes)
    assert "pacing: lockstep" in (tmp_path / "nodes.yaml").read_text()
    assert "name: joint_resonator" in (tmp_path / "rig.yaml").read_text()


def test_a_wrong_rig_is_refused_before_anything_starts(launch_file: types.ModuleType, tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="nowhere"):
        started(launch_file, rig="nowhere.yaml", out=str(tmp_path / "out"))
    assert not (tmp_path / "out").exists()


@pytest.mark.campaign
@pytest.mark.parametrize("namespace", ["hall", ""])
def test_an_interrupted_launch_aborts_no_node(
    namespace: str, launch_file: types.ModuleType, domain_id: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in bench_environment(domain_id).items():
        monkeypatch.setenv(name, value)
    nodes = started(launch_file, rig="joint_resonator", pacing="lockstep", namespace=namespace, out=str(tmp_path))
    interrupted(nodes, namespace, tmp_path, domain_id)


def interrupted(nodes: list[StartedNode], namespace: str, folder: Path, domain_id: int) -> None:
    """Start the nodes in one process group, wait until all are ready, and interrupt them; all must end with code 0."""
    logs = {node.options["name"]: folder / f"{node.options['name']}.log" for node in nodes}
    processes: dict[str, subprocess.Popen[bytes]] = {}
    group = 0
    try:
        for node in nodes:
            name = node.options["name"]
            with open(logs[name], "wb") as log:
                processes[name] = subprocess.Popen(
                    node.command,
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    preexec_fn=partial(os.setpgid, 0, group),
                )
            group = group or processes[name].pid
        end = time.monotonic() + 90.0
        while not all("]: Ready" in log.read_text() for log in logs.values()):
            assert time.monotonic() < end, {name: log.read_text() for name, log in logs.items()}
            assert all(process.poll() is None for process in processes.values()), processes
            time.sleep(0.05)
        os.killpg(group, signal.SIGINT)
        for process in processes.values():
            process.send_signal(signal.SIGINT)
        codes = {name: process.wait(timeout=20.0) for name, process in processes.items()}
    finally:
        for process in processes.values():
            if process.poll() is None:
                process.kill()
                process.wait()
    assert codes == dict.fromkeys(processes, 0), {name: log.read_text() for name, log in logs.items()}
    assert not [name for name, log in logs.items() if "Traceback" in log.read_text()]
    assert f"in ROS domain {domain_id} as" in logs["plant"].read_text()
