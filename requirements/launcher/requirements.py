"""Step 2: the locked requirements, every file checked by its hash.

pip installs uv and the build tool of the one source archive; uv, which fetches and unpacks in parallel, installs the
rest. Where uv is not locked or fails, pip does it.
"""

from __future__ import annotations

import os
import re
import shutil
from typing import Any

from .distributions import installed, is_complete, normalised, pins_of
from .environment import clean_environment
from .index_settings import pip_settings, uv_variables
from .places import INSTALLED_LOCK, STATE_FOLDER, VENV_PYTHON
from .programs import StepRunner
from .stamps import lock_file

CHECKED = ["--no-deps", "--require-hashes", "--only-binary", ":all:", "--no-binary", "empy", "--no-build-isolation"]
PIP = [VENV_PYTHON, "-m", "pip", "--disable-pip-version-check", "--no-input"]
PIP_INSTALL = [*PIP, "install", *CHECKED, "--use-pep517", "--progress-bar", "off"]
# Every index counts alike, as with pip; the hashes decide.
UV_INSTALL = [VENV_PYTHON, "-m", "uv", "pip", "install", "--python", VENV_PYTHON, "--no-config", *CHECKED]
UV_INSTALL += ["--link-mode", "hardlink", "--index-strategy", "unsafe-best-match", "--no-progress"]


def install_requirements(state: dict[str, Any], runner: StepRunner) -> None:
    """Bring the venv in step with the lock file; only what differs is fetched and installed."""
    lock = lock_file(state)
    pins = pins_of(lock)
    present = installed(state)
    # Left by an interrupted installation, or damaged later: have it done again, and by pip, which takes no file from
    # uv's cache. Files are links into that cache, so what was damaged here may be damaged there.
    damaged = [name for name, (_, folder) in present.items() if name in pins and not is_complete(folder)]
    for name in damaged:
        shutil.rmtree(present[name][1])
    environment = clean_environment(state["source"])
    gone = [name for name in sorted(set(pins_of(INSTALLED_LOCK)) - set(pins) - {"pip"}) if name in present]
    if gone:
        runner.run([*PIP, "uninstall", "--yes", *gone], environment, lambda: "removing what is no longer required")
    first = os.path.join(STATE_FOLDER, "first.txt")
    with open(lock) as file, open(first, "w") as selected:
        for entry in re.findall(r"^[\w.-]+==.*?(?=^\S|\Z)", file.read(), re.M | re.S):
            if normalised(entry.partition("==")[0]) in {"setuptools", "uv", *damaged}:
                selected.write(entry)

    def fetching() -> str:
        log = runner.text().rpartition("$ ")[2]
        if "Installing collected packages" in log:
            return installing()
        seen = len(re.findall(r"^(?:Collecting|Requirement already satisfied)", log, re.M))
        return f"fetching {min(seen, len(pins))} of {len(pins)}"

    def installing() -> str:
        here = installed(state)
        ready = sum(1 for name, version in pins.items() if here.get(name, ("",))[0] == version)
        return f"installing {ready} of {len(pins)}"

    runner.run([*PIP_INSTALL, "-r", first], environment, fetching)
    done = False
    if "uv" in pins:
        uv_environment = {**environment, **uv_variables(pip_settings(environment), environment)}
        cache = [] if uv_environment.get("HOME") else ["--no-cache"]
        done = runner.run([*UV_INSTALL, *cache, "-r", lock], uv_environment, installing, may_fail=True)
    if not done:
        runner.run([*PIP_INSTALL, "-r", lock], environment, fetching)
    shutil.copyfile(lock, INSTALLED_LOCK)
