"""Every module of this package can be imported; nodes where ROS 2 is installed. This is what ``colcon test`` runs."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

ROS = {"builtin_interfaces", "diagnostic_msgs", "nmt_msgs", "rcl_interfaces", "rclpy", "std_msgs", "std_srvs"}
FOLDER = Path(__file__).resolve().parents[1]


def test_modules_can_be_imported() -> None:
    without_ros = []
    for path in sorted((FOLDER / FOLDER.name).rglob("*.py")):
        name = ".".join(path.relative_to(FOLDER).with_suffix("").parts).removesuffix(".__init__")
        if path.stem == "__main__":
            continue
        try:
            importlib.import_module(name)
        except ModuleNotFoundError as error:
            if (error.name or "").partition(".")[0] not in ROS:
                raise
            without_ros.append(name)
    if without_ros:
        pytest.skip(f"All others can; ROS 2 is not installed, which these need: {', '.join(without_ros)}")
