"""The set-up: one step at a time; an interrupted one goes on where it stopped."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import shutil
import sys
import time
from collections.abc import Iterator
from functools import partial
from typing import Any

from .kernels import KernelCompilation, end_later
from .machine import choose_python, choose_source, machine_troubles
from .pace import estimated_seconds, left
from .places import (
    BUILD,
    INSTALL,
    INSTALLED_LOCK,
    MISUSED,
    ROOT,
    STATE_FILE,
    STATE_FOLDER,
    VENV,
    VENV_PYTHON,
    WORKSPACE,
    SetupError,
)
from .programs import StepRunner
from .progress import Progress, clock
from .requirements import install_requirements
from .stamps import STEPS, expected_stamps, lock_file, pending_steps, read_state, write_state
from .virtual_environment import make_environment
from .workspace import build_workspace

TITLES = {
    "environment": "Python environment",
    "requirements": "requirements",
    "workspace": "ROS 2 workspace",
    "kernels": "numerical kernels",
}


@contextlib.contextmanager
def only_set_up() -> Iterator[int]:
    """Hold the set-up's lock; wait for another set-up of this folder, or what a killed one left running."""
    try:
        os.makedirs(STATE_FOLDER, exist_ok=True)
        guard = os.open(os.path.join(STATE_FOLDER, "lock"), os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
            raise SetupError(
                f"The set-up in {ROOT} is not complete, and the folder cannot be written: have its owner run "
                "'./nmt setup', or clone the project to a folder of yours.",
                MISUSED,
            ) from None
        raise
    try:
        try:
            fcntl.flock(guard, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            sys.stderr.write("Another set-up of this folder is at work; waiting for it.\n")
            fcntl.flock(guard, fcntl.LOCK_EX)
        yield guard
    finally:
        os.close(guard)


def set_up(wanted: str | None, compiled: bool = True) -> dict[str, Any]:
    """Bring the set-up in step with the files of the project; returns its stamps.

    Args:
        wanted: "wheels" or "system" where the user chose, else None.
        compiled: whether the command computes: else its kernels are left for one that does.

    Raises:
        SetupError: something the user must fix.
    """

    def pending_now() -> list[str]:
        return [step for step in pending_steps(state) if compiled or step != "kernels"]

    state = read_state()
    source = choose_source(wanted, state)
    if state.get("source") == source and not pending_now():
        return state
    refuse_path(ROOT)
    with only_set_up() as guard:
        state = read_state()  # the other set-up may have done it all
        renewed = state.get("source") != source or not os.path.exists(VENV_PYTHON)
        renewed = renewed or state.get("environment") != expected_stamps(state)["environment"]
        python = VENV_PYTHON
        if renewed or os.environ.get("NMT_PYTHON"):
            python, version = choose_python(source)
            if renewed or version != state.get("python"):
                state = {"source": source, "python": version}
        if not os.path.isfile(lock_file(state)):
            raise SetupError(f"{os.path.relpath(lock_file(state), ROOT)} is missing: is this a complete clone?")
        pending = pending_now()
        troubles = machine_troubles(source)
        if troubles:
            raise SetupError("\nnmt: ".join(troubles))
        complete = len(pending) == len(STEPS)  # a part of a step says little of how long all of it takes
        if complete:
            sys.stderr.write(
                f"First use: setting up in {ROOT} (once, about two minutes; Ctrl-C and go on later at will).\n"
            )
        begun = time.monotonic()
        with contextlib.ExitStack() as under_way:
            kernels: KernelCompilation | None = None
            for number, step in enumerate(pending, 1):
                if step != "workspace":
                    state.pop(step, None)
                write_state(state)
                if "kernels" in pending and step in ("workspace", "kernels") and kernels is None:
                    kernels = KernelCompilation(state, guard)
                    under_way.callback(kernels.end)
                progress = Progress(number, len(pending), TITLES[step], partial(_left, pending[number - 1 :], state))
                start = time.monotonic()
                try:
                    if step == "environment":
                        make_environment(state, python, StepRunner(step, progress, guard))
                    elif step == "requirements":
                        install_requirements(state, StepRunner(step, progress, guard))
                    elif step == "workspace":
                        build_workspace(state, StepRunner(step, progress, guard))
                    elif kernels:
                        kernels.finish(progress)
                except BaseException:
                    progress.break_line()
                    end_later()
                    raise
                if step != "workspace":
                    state[step] = expected_stamps(state)[step]
                if complete:
                    state.setdefault("seconds", {})[step] = round(time.monotonic() - start, 1)
                write_state(state)
                progress.done()
        sys.stderr.write(f"Set up in {clock(time.monotonic() - begun)}.\n")
    return state


def _left(steps: list[str], state: dict[str, Any], elapsed: float) -> str:
    """What is left of steps, the first of which has been at work for some seconds."""
    first = estimated_seconds(steps[:1], state)
    return left(max(first - elapsed, 0.1 * first) + estimated_seconds(steps[1:], state))


def refuse_path(root: str) -> None:
    """Refuse a folder whose name the tools that build the messages cannot read.

    Raises:
        SetupError: with the letter.
    """
    strange = next((letter for letter in root if not (letter.isascii() and letter.isprintable())), "")
    if strange:
        raise SetupError(
            f"The folder {root} has '{strange}' in its name, which CMake and the generators of ROS 2 cannot read: move "
            "the clone to a path of plain letters.",
            MISUSED,
        )


def discard_set_up() -> None:
    """Throw away the venv, the built workspace and the stamps."""
    with only_set_up():
        end_later()
        for path in (STATE_FILE, INSTALLED_LOCK):
            with contextlib.suppress(FileNotFoundError):
                os.remove(path)
        for folder in (BUILD, INSTALL, os.path.join(WORKSPACE, "log"), VENV):
            shutil.rmtree(folder, ignore_errors=True)
