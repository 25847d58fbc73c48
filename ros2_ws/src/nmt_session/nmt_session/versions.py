"""Versions on which the results of a run depend."""

from __future__ import annotations

import platform
from functools import cache
from importlib import metadata


@cache
def versions() -> dict[str, str]:
    """Versions on which a run's result depends."""
    found = {"python": platform.python_version()}
    for name in ("numpy", "scipy", "numba", "rosbags", "nmt_bench", "ros-jazzy-rclpy"):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found
