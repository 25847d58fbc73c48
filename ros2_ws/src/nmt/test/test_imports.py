"""Every module of this package can be imported; nodes where ROS 2 is installed. This is what ``colcon test`` runs."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

ROS = {"builtin_interfaces", "diagnostic_msgs", "nmt_msgs", "rcl_interfaces", "rclpy", "std_msgs", "std_srvs"}
FOLDER = Path(__file__).resolve().parents[1]
FILES = sorted(path.relative_to(FOLDER) for path in (FOLDER / FOLDER.name).rglob("*.py") if path.stem != "__main__")
MODULES = [".".join(path.with_suffix("").parts).removesuffix(".__init__") for path in FILES]


@pytest.mark.parametrize("name", MODULES)
def test_module_can_be_imported(name: str) -> None:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in ROS:
            raise
        pytest.skip(f"{error.name} of ROS 2 is not installed")
