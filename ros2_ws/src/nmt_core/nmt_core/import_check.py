"""What ``colcon test`` runs of each package: all its modules can be imported."""

from __future__ import annotations

import importlib
import unittest
from pathlib import Path

_ROS = {"builtin_interfaces", "diagnostic_msgs", "nmt_msgs", "rcl_interfaces", "rclpy", "std_msgs", "std_srvs"}


def check_imports(folder: Path) -> None:
    """Import every module of a package.

    Args:
        folder: of the package, with the folder of its modules in it.

    Raises:
        ModuleNotFoundError: a module needs what is not there.
        unittest.SkipTest: ROS 2 is not installed, and modules need it; all others can be imported.
    """
    without_ros = []
    for path in sorted((folder / folder.name).rglob("*.py")):
        name = ".".join(path.relative_to(folder).with_suffix("").parts).removesuffix(".__init__")
        if path.stem == "__main__":
            continue
        try:
            importlib.import_module(name)
        except ModuleNotFoundError as error:
            if (error.name or "").partition(".")[0] not in _ROS:
                raise
            without_ros.append(name)
    if without_ros:
        raise unittest.SkipTest(f"All others can; ROS 2 is not installed, which these need: {', '.join(without_ros)}")
