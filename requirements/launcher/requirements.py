"""Step 2: the locked requirements, every file checked by its hash."""

from __future__ import annotations

import os
import re
import shutil
from typing import Any

from .distributions import installed, is_complete, pins_of
from .environment import clean_environment
from .places import INSTALLED_LOCK, STATE_FOLDER, VENV_PYTHON
from .programs import StepRunner
from .stamps import lock_file


def install_requirements(state: dict[str, Any], runner: StepRunner) -> None:
    """Step 2: bring the venv in step with the lock file; only what differs is fetched and installed."""
    lock = lock_file(state)
    pins = pins_of(lock)
    present = installed(state)
    for name, (_, metadata) in present.items():
        if name in pins and not is_complete(metadata):  # left by an interrupted installation: let pip do it again
            shutil.rmtree(metadata)
    environment = clean_environment(state["source"])
    pip = [VENV_PYTHON, "-m", "pip", "--disable-pip-version-check", "--no-input"]
    gone = sorted(set(pins_of(INSTALLED_LOCK)) - set(pins) & set(present) - {"pip"})
    gone = [name for name in gone if name in present]
    if gone:
        runner.run([*pip, "uninstall", "--yes", *gone], environment, lambda: "removing what is no longer required")
    with open(lock) as file:
        text = file.read()
    first = re.search(r"^setuptools==.*?(?=^[^\s])", text, re.M | re.S)
    build_tool = os.path.join(STATE_FOLDER, "build-tool.txt")
    with open(build_tool, "w") as file:
        file.write(first[0] if first else "")
    # The one source archive of the lock is built by the locked setuptools, which therefore comes first.
    install = [
        *pip,
        "install",
        "--no-deps",
        "--require-hashes",
        "--only-binary",
        ":all:",
        "--no-binary",
        "empy",
        "--no-build-isolation",
        "--use-pep517",
        "--progress-bar",
        "off",
    ]

    def detail() -> str:
        log = runner.text()
        if "Installing collected packages" in log.rpartition("$ ")[2]:
            here = installed(state)
            ready = sum(1 for name, version in pins.items() if here.get(name, ("",))[0] == version)
            return f"installing {ready} of {len(pins)}"
        seen = len(re.findall(r"^(?:Collecting|Requirement already satisfied)", log, re.M))
        return f"fetching {min(seen, len(pins))} of {len(pins)}"

    runner.run([*install, "-r", build_tool], environment, detail)
    runner.run([*install, "-r", lock], environment, detail)
    shutil.copyfile(lock, INSTALLED_LOCK)
