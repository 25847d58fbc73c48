"""Step 4: the compiled numerical kernels are cached.

They need the requirements and the sources but no built workspace. Where both are to be made, the kernels are compiled
while the workspace is built: the one keeps a single core busy, the other waits for one package through half its time.
"""

from __future__ import annotations

import glob
import os
import shutil
import sys
from typing import Any

from .environment import command_environment, prepend
from .places import CAMPAIGNS, ROOT, SOURCE, VENV_PYTHON, WARM_UP, WORKSPACE
from .programs import StepRunner, end_group
from .progress import Progress
from .stamps import packages


class KernelCompilation:
    """Compiles the numerical kernels into their cache; without it the first run is slower.

    Starts at once, beside whatever else runs, and throws away what an older set-up has cached.

    Args:
        state: source of ROS 2 and version of Python.
        guard: the set-up's lock.
    """

    def __init__(self, state: dict[str, Any], guard: int) -> None:
        for source in (SOURCE, CAMPAIGNS):
            for folder in glob.glob(os.path.join(source, "**", "__pycache__", "kernels-*"), recursive=True):
                shutil.rmtree(folder, ignore_errors=True)
        self._runner = StepRunner("kernels", None, guard)
        self._process = None
        if os.path.isfile(WARM_UP):
            environment = command_environment(state)
            prepend(environment, "PYTHONPATH", list(packages().values()))
            command = [VENV_PYTHON, "-m", "nmt_bench.warm_up"]
            self._process = self._runner.start(command, environment, WORKSPACE)

    def finish(self, progress: Progress) -> None:
        """Wait for the end; a failure is a note and no more."""
        self._runner.progress = progress
        if self._process and not self._runner.finish(self._process, may_fail=True):
            progress.break_line()
            log = os.path.relpath(self._runner.log, ROOT)
            sys.stderr.write(f"note: the kernels could not be compiled beforehand ({log} says why)\n")

    def end(self) -> None:
        """End the compilation if it is still under way."""
        if self._process and self._process.poll() is None:
            end_group(self._process)
