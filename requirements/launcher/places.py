"""Where things lie in a clone, and the refusal that a user reads."""

from __future__ import annotations

import os

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.realpath(__file__))))
VENV = os.path.join(ROOT, ".venv")
VENV_PYTHON = os.path.join(VENV, "bin", "python")
STATE_FOLDER = os.path.join(ROOT, ".nmt")
STATE_FILE = os.path.join(STATE_FOLDER, "setup.json")
INSTALLED_LOCK = os.path.join(STATE_FOLDER, "installed.txt")
LOCKS = os.path.join(ROOT, "requirements", "lock")
WORKSPACE = os.path.join(ROOT, "ros2_ws")
SOURCE = os.path.join(WORKSPACE, "src")
CAMPAIGNS = os.path.join(ROOT, "campaigns")
"""Packages beside the workspace: studies, blind checks, benchmarks, stand-ins."""
BUILD = os.path.join(WORKSPACE, "build")
INSTALL = os.path.join(WORKSPACE, "install")
WARM_UP = os.path.join(SOURCE, "nmt_bench", "nmt_bench", "warm_up.py")

FAILED, MISUSED, INTERRUPTED = 1, 2, 130  # exit codes


class SetupError(Exception):
    """Something the user must fix; the text is the sentence to show.

    Args:
        sentence: what is wrong and how to fix it.
        code: the exit code.
    """

    def __init__(self, sentence: str, code: int = FAILED) -> None:
        super().__init__(sentence)
        self.code = code
