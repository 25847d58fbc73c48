"""Step 3: colcon build of ros2_ws/src and campaigns into ros2_ws/install, by links: Python edits are live."""

from __future__ import annotations

import os
import re
import shutil
from typing import Any

from .environment import build_environment
from .places import BUILD, CAMPAIGNS, INSTALL, SOURCE, STATE_FOLDER, VENV, VENV_PYTHON, WORKSPACE, SetupError
from .programs import StepRunner
from .stamps import expected_stamps, is_built, packages_to_build, write_state


def build_workspace(state: dict[str, Any], runner: StepRunner) -> None:
    """Step 3: build the packages that changed; each gets its stamp when all of the call is built."""
    expected = expected_stamps(state)
    changed = packages_to_build(state, expected)
    stamps = state.setdefault("workspace", {})
    for name in set(stamps) - set(expected["workspace"]):
        remove_package(name)
        del stamps[name]
    for name in changed:
        if stamps.pop(name, "").rpartition(" ")[0] == "" or not is_built(name):
            remove_package(name)  # never built to its end: start over
    write_state(state)
    if not changed:
        return
    with open(os.path.join(STATE_FOLDER, "colcon-defaults.yaml"), "w") as file:
        file.write("{}\n")
    command = [
        VENV_PYTHON,
        os.path.join(VENV, "bin", "colcon"),
        "--log-base",
        os.path.join(WORKSPACE, "log"),
        "build",
        "--base-paths",
        SOURCE,
        CAMPAIGNS,
        "--build-base",
        BUILD,
        "--install-base",
        INSTALL,
        "--symlink-install",
        "--packages-select",
        *changed,
        "--cmake-args",
        f"-DPython3_EXECUTABLE={VENV_PYTHON}",
        "-DBUILD_TESTING=OFF",
        f"-DNMT_MSGS_CPP={'OFF' if state['source'] == 'wheels' else 'ON'}",
        "--no-warn-unused-cli",
    ]

    def detail() -> str:
        log = runner.text()
        finished = set(re.findall(r"^Finished <<< (\w+)", log, re.M))
        under_way = [name for name in re.findall(r"^Starting >>> (\w+)", log, re.M) if name not in finished]
        return f"{len(finished)} of {len(changed)} packages   {' '.join(under_way)}"

    runner.run(command, build_environment(state["source"]), detail, cwd=WORKSPACE)
    missing = [name for name in changed if not is_built(name)]
    if missing:
        raise SetupError(
            f"colcon said it built {', '.join(missing)} but left nothing in ros2_ws/install: see ros2_ws/log."
        )
    stamps.update({name: expected["workspace"][name] for name in changed})


def remove_package(name: str) -> None:
    """Forget a package's build."""
    for folder in (BUILD, INSTALL):
        shutil.rmtree(os.path.join(folder, name), ignore_errors=True)
