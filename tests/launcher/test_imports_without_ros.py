"""Everything but nodes, the harness and the run command imports without ROS 2; no modules import in a circle."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
from scipy.sparse import lil_array
from scipy.sparse.csgraph import connected_components

from .conftest import ROOT

SOURCES = sorted(
    init for source in ("ros2_ws/src", "campaigns") for init in (ROOT / source).glob("nmt_*/nmt_*/__init__.py")
)
SCRIPT = """
import importlib, sys
BLOCKED = ("rclpy", "nmt_msgs", "std_msgs", "std_srvs", "diagnostic_msgs", "builtin_interfaces",
           "rcl_interfaces", "action_msgs", "rosidl_runtime_py", "ament_index_python")
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in BLOCKED:
            raise ModuleNotFoundError("No module named " + repr(name), name=name)
sys.meta_path.insert(0, Absent())
failed = []
for name in sys.argv[1:]:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in BLOCKED:
            raise
        failed.append(name + " needs " + str(error.name))
print("\\n".join(failed))
"""


def may_use_ros(module: str) -> bool:
    """Whether the design lets a module import ROS 2."""
    last = module.rpartition(".")[2]
    bench = module.startswith(("nmt_bench.harness", "nmt_bench.commands.run_command"))
    return bench or last.endswith("_node")


def test_numerical_modules_import_without_ros():
    modules = []
    for init in SOURCES:
        for file in sorted(init.parent.rglob("*.py")):
            parts = file.relative_to(init.parent.parent).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            if parts[-1] != "__main__" and not may_use_ros(name):
                modules.append(name)
    assert len(modules) > 20
    path = os.pathsep.join(str(init.parent.parent) for init in SOURCES)
    environment = {**os.environ, "PYTHONPATH": path}
    answer = subprocess.run([sys.executable, "-c", SCRIPT, *modules], capture_output=True, text=True, env=environment)
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout.strip() == ""


IMPORT = re.compile(r"^ *(?:import (nmt\w*[\w.]*)|from (nmt\w*[\w.]*) import (\([^)]*\)|[^\n#]*))", re.M)


def imported(file: Path, modules: dict[str, Path]) -> set[str]:
    """Modules of the bench that a file imports anywhere: for type checkers and inside functions, too."""
    found = set()
    for module, package, names in IMPORT.findall(file.read_text(encoding="utf-8")):
        members = {f"{package}.{name}" for name in re.findall(r"\w+", names)}
        found |= members & modules.keys() or {module or package}
    return found & modules.keys()


def test_no_modules_import_each_other_in_a_circle():
    modules = {
        ".".join(file.relative_to(init.parent.parent).with_suffix("").parts).removesuffix(".__init__"): file
        for init in SOURCES
        for file in init.parent.rglob("*.py")
    }
    names = sorted(modules)
    graph = lil_array((len(names), len(names)), dtype=bool)
    for row, name in enumerate(names):
        for other in imported(modules[name], modules) - {name}:
            graph[row, names.index(other)] = True
    _, labels = connected_components(graph.tocsr(), connection="strong")
    circles = [[names[k] for k in np.flatnonzero(labels == label)] for label in np.unique(labels)]
    assert not [circle for circle in circles if len(circle) > 1]
