"""Step 1: the virtual environment .venv."""

from __future__ import annotations

import contextlib
import os
from typing import Any

from .environment import clean_environment
from .machine import version_of
from .places import VENV, VENV_PYTHON
from .programs import StepRunner


def make_environment(state: dict[str, Any], python: str, runner: StepRunner) -> None:
    """Step 1: the venv; an old one of the same Python and source is kept, any other is replaced."""
    environment = clean_environment(state["source"])
    system_site = state["source"] == "system"
    keep = False
    with contextlib.suppress(OSError):
        with open(os.path.join(VENV, "pyvenv.cfg")) as file:
            configuration = file.read()
        home = os.path.dirname(VENV_PYTHON)
        keep = (
            version_of(VENV_PYTHON) == state["python"]
            and f"include-system-site-packages = {str(system_site).lower()}" in configuration
            and is_own_script(os.path.join(home, "pip"))
        )
    options = (["--system-site-packages"] if system_site else []) + ([] if keep else ["--clear"])
    runner.run([python, "-m", "venv", *options, VENV], environment, lambda: f"Python {state['python']}")


def is_own_script(path: str) -> bool:
    """Whether a script of the venv starts the venv's own Python: not so after the folder was moved."""
    with contextlib.suppress(OSError), open(path, errors="replace") as file:
        return os.path.join(VENV, "bin") in file.read(500)
    return True
