"""What is set up and what is not: each finished step leaves a stamp in .nmt/setup.json.

A stamp is the digest of what a step was made from. A later call compares the digests (a few milliseconds) and
does again only what changed.
"""

from __future__ import annotations

import contextlib
import glob
import hashlib
import itertools
import json
import os
from typing import Any

from .places import CAMPAIGNS, INSTALL, LOCKS, ROOT, SOURCE, STATE_FILE, VENV_PYTHON, WARM_UP

STEPS = ("environment", "requirements", "workspace", "kernels")


def read_state() -> dict[str, Any]:
    """The stamps of the finished steps; empty before the first set-up or when unreadable."""
    try:
        with open(STATE_FILE) as file:
            state = json.load(file)
    except (OSError, ValueError):
        return {}
    return state if isinstance(state, dict) else {}


def write_state(state: dict[str, Any]) -> None:
    """Replace the stamps in one piece."""
    unfinished = STATE_FILE + ".new"
    with open(unfinished, "w") as file:
        json.dump(state, file, indent=1, sort_keys=True)
        file.flush()
        os.fsync(file.fileno())
    os.replace(unfinished, STATE_FILE)


def digest(*paths: str) -> str:
    """SHA-256 of names and contents of files; a missing file counts as such."""
    total = hashlib.sha256()
    for path in paths:
        total.update(os.path.relpath(path, ROOT).encode() + b"\0")
        try:
            with open(path, "rb") as file:
                total.update(hashlib.sha256(file.read()).digest())
        except OSError:
            total.update(b"missing")
    return total.hexdigest()


def packages() -> dict[str, str]:
    """Folder of each package of the workspace and of the campaigns beside it, by its name."""
    files = glob.glob(os.path.join(SOURCE, "*", "package.xml")) + glob.glob(os.path.join(CAMPAIGNS, "*", "package.xml"))
    folders = [os.path.dirname(file) for file in files]
    return {os.path.basename(folder): folder for folder in sorted(folders, key=os.path.basename)}


def package_digest(folder: str) -> str:
    """Digest of what decides a package's build: its lists of files and entry points, and its interfaces.

    Python modules are not part of it: they are installed as links.
    """
    files = [os.path.join(folder, file) for file in ("package.xml", "setup.py", "setup.cfg", "CMakeLists.txt")]
    for subfolder in ("msg", "srv", "action", "resource"):
        files += sorted(glob.glob(os.path.join(folder, subfolder, "*")))
    return digest(*files)


def kernel_sources() -> list[str]:
    """Python files with compiled kernels or with formulas for them, or that only name their compiler.

    The cache is keyed by the formulas (``nmt_core.numerics.kernels``), so that nobody computes an old one. After a
    change of any of these files the set-up compiles beforehand what a run would otherwise wait for, and discards what
    is old.
    """
    sources = []
    found = [glob.iglob(f"{source}/*/*/**/*.py", recursive=True) for source in (SOURCE, CAMPAIGNS)]
    for path in sorted(itertools.chain(*found)):
        with contextlib.suppress(OSError), open(path, "rb") as file:
            content = file.read()
            if b"njit" in content or b"numba" in content or "local_elements" in path:
                sources.append(path)
    return sources


def lock_file(state: dict[str, Any]) -> str:
    """The lock file of a set-up's source of ROS 2 and Python version."""
    return os.path.join(LOCKS, f"{state.get('source')}-{state.get('python')}.txt")


def expected_stamps(state: dict[str, Any]) -> dict[str, Any]:
    """The stamps a finished set-up with this source and Python would have now."""
    environment = f"{ROOT} {state.get('source')} {state.get('python')}"  # a venv and a colcon workspace cannot be moved
    requirements = digest(lock_file(state)) + " " + environment
    return {
        "environment": environment,
        "requirements": requirements,
        "workspace": {name: package_digest(folder) + " " + environment for name, folder in packages().items()},
        "kernels": digest(WARM_UP, *kernel_sources()) + " " + requirements,
    }


def is_built(name: str) -> bool:
    """Whether a package's install folder is there."""
    return os.path.isfile(os.path.join(INSTALL, name, "share", name, "package.xml"))


def packages_to_build(state: dict[str, Any], expected: dict[str, Any]) -> list[str]:
    """Packages that were never built, were changed, or whose installed folder is gone."""
    stamps = state.get("workspace", {})
    return [name for name, stamp in expected["workspace"].items() if stamps.get(name) != stamp or not is_built(name)]


def pending_steps(state: dict[str, Any]) -> list[str]:
    """The steps that must be done, in their order; empty when everything is in step."""
    expected = expected_stamps(state)
    pending = [step for step in STEPS if step != "workspace" and state.get(step) != expected[step]]
    if not os.path.exists(VENV_PYTHON):
        return list(STEPS)
    if packages_to_build(state, expected) or set(state.get("workspace", {})) - set(expected["workspace"]):
        pending.append("workspace")
    return sorted(pending, key=STEPS.index)
