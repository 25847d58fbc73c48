"""Version of the bench, however it was installed."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version


def bench_version() -> str:
    """Version of the ROS package nmt_bench or of the wheel nmt; empty where neither is installed."""
    for distribution in ("nmt_bench", "nmt"):
        try:
            return version(distribution)
        except PackageNotFoundError:
            continue
    return ""
