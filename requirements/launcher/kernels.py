"""Step 4: the compiled numerical kernels are cached."""

from __future__ import annotations

import contextlib
import glob
import os
import sys
from typing import Any

from .environment import command_environment
from .places import ROOT, SOURCE, VENV_PYTHON, WARM_UP, WORKSPACE
from .programs import StepRunner


def cache_kernels(state: dict[str, Any], runner: StepRunner) -> None:
    """Step 4: compile the numerical kernels into their cache; without it the first run is slower."""
    for pattern in ("*.nbi", "*.nbc"):
        for path in glob.glob(os.path.join(SOURCE, "**", "__pycache__", pattern), recursive=True):
            with contextlib.suppress(OSError):
                os.remove(path)
    if not os.path.isfile(WARM_UP):
        return
    command = [VENV_PYTHON, "-m", "nmt_bench.warm_up"]
    if not runner.run(command, command_environment(state), cwd=WORKSPACE, may_fail=True):
        runner.progress.break_line()
        sys.stderr.write(
            f"note: the kernels could not be compiled beforehand ({os.path.relpath(runner.log, ROOT)} says why)\n"
        )
