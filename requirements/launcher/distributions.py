"""What the lock file pins and what the virtual environment holds."""

from __future__ import annotations

import contextlib
import glob
import os
import re
from typing import Any

from .places import VENV


def normalised(name: str) -> str:
    """A distribution's name as the package index compares it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def pins_of(path: str) -> dict[str, str]:
    """Name and version of every entry of a lock file; empty if it is not there."""
    with contextlib.suppress(OSError), open(path) as file:
        return {
            normalised(name): version for name, version in re.findall(r"^([\w.-]+)==([\w.+!-]+)", file.read(), re.M)
        }
    return {}


def site_packages(state: dict[str, Any]) -> str:
    """The venv's folder of packages."""
    return os.path.join(VENV, "lib", f"python{state['python']}", "site-packages")


def installed(state: dict[str, Any]) -> dict[str, tuple[str, str]]:
    """Installed distributions: name -> (version, folder of its metadata)."""
    found = {}
    for folder in glob.glob(os.path.join(site_packages(state), "*.dist-info")):
        name, _, version = os.path.basename(folder)[: -len(".dist-info")].partition("-")
        found[normalised(name)] = (version, folder)
    return found


def is_complete(metadata: str) -> bool:
    """Whether all files that a distribution lists are there with their sizes; pip completes the list last."""
    site = os.path.dirname(metadata)
    try:
        with open(os.path.join(metadata, "RECORD"), newline="") as file:
            import csv

            rows = [row for row in csv.reader(file) if row]
        if not any(row[0].endswith(".dist-info/INSTALLER") for row in rows):
            return False
        for row in rows:
            size = os.stat(os.path.join(site, row[0])).st_size if not row[0].endswith(".pyc") else None
            if size is not None and len(row) > 2 and row[2] and size != int(row[2]):
                return False
    except (OSError, ValueError):
        return False
    return True
