"""Version of the bench, however it was installed."""

from __future__ import annotations

import os
import re


def bench_version() -> str:
    """Version that a clone's package.xml states, else of the ROS package or the wheel; empty where neither is there."""
    return _stated_version(_PACKAGE_FILE) or _installed_version()


_PACKAGE_FILE = os.path.join(os.path.realpath(__file__), "..", "..", "..", "nmt_bench", "package.xml")
"""Of the package nmt_bench where this file lies in a clone, or in a workspace built by links."""


def _stated_version(path: str) -> str:
    try:
        with open(os.path.normpath(path), encoding="utf-8") as file:
            found = re.search(r"<version>\s*([^<\s]+)\s*</version>", file.read())
    except OSError:
        return ""
    return found.group(1) if found else ""


def _installed_version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    for distribution in ("nmt_bench", "nonlinear-modal-testing"):
        try:
            return version(distribution)
        except PackageNotFoundError:
            continue
    return ""
