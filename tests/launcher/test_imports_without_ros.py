"""Everything but nodes, the harness and the run command imports on a machine without ROS 2."""

from __future__ import annotations

import os
import subprocess
import sys

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
