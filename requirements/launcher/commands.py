"""The launcher's own commands, and the hand-over of every other one to the bench."""

from __future__ import annotations

import contextlib
import errno
import glob
import os
import re
import signal
import sys
from typing import Any

from .places import (
    CAMPAIGNS,
    FAILED,
    INSTALL,
    INTERRUPTED,
    MISUSED,
    ROOT,
    SOURCE,
    STATE_FOLDER,
    VENV_PYTHON,
    SetupError,
)

USAGE = """usage: ./nmt [--wheels | --system] COMMAND [ARGUMENTS]

The launcher's own commands:
  setup [--fresh]             set up and nothing else; --fresh throws the old set-up away first
  doctor [--json]             check this machine and the set-up, and say how to fix what is wrong
  test [PYTEST ARGUMENTS]     run the tests that protect a change; --all: every test, goes on where it stopped
  shell [-c COMMAND]          a shell in the bench's environment, or one command in it
  ros PACKAGE EXECUTABLE ...  start one node, as `ros2 run` does (without arguments: list them)

Every other command (demo, run, extract, ...) belongs to the bench and is set up for at its first use.
--wheels or --system (or NMT_ROS=wheels, NMT_ROS=system) chooses where ROS 2 Jazzy comes from.
"""


def executables() -> dict[str, list[str]]:
    """The nodes of the workspace: package -> executables."""
    from .stamps import packages

    found = {}
    for name in packages():
        paths = sorted(glob.glob(os.path.join(INSTALL, name, "lib", name, "*")))
        found[name] = [os.path.basename(path) for path in paths if os.access(path, os.X_OK) and os.path.isfile(path)]
    return {name: names for name, names in found.items() if names}


def run_node(state: dict[str, Any], arguments: list[str]) -> int:
    """``ros PACKAGE EXECUTABLE ...``: become one node of the workspace."""
    known = executables()
    listing = "\n".join(f"  {name} {executable}" for name, names in known.items() for executable in names)
    if not arguments:
        sys.stdout.write(listing + "\n")
        return 0
    package, executable = arguments[0], arguments[1] if len(arguments) > 1 else ""
    if executable not in known.get(package, []):
        raise SetupError(f"There is no executable '{executable}' in package '{package}'; there are\n{listing}", MISUSED)
    from .environment import command_environment

    path = os.path.join(INSTALL, package, "lib", package, executable)
    os.execve(path, [path, *arguments[2:]], command_environment(state))


def open_shell(state: dict[str, Any], arguments: list[str]) -> int:
    """``shell``: an interactive shell in the bench's environment; ``shell -c COMMAND``: one command in it.

    Raises:
        SetupError: other arguments.
    """
    from .environment import command_environment

    environment = command_environment(state)
    shell = os.environ.get("SHELL") or "/bin/sh"
    if arguments:
        if arguments[0] != "-c" or len(arguments) < 2:
            raise SetupError(f"shell takes nothing or -c COMMAND, not '{' '.join(arguments)}'.", MISUSED)
        os.execvpe(shell, [shell, *arguments], environment)
    sys.stderr.write("In the bench's environment; 'exit' leaves it. One node: ./nmt ros PACKAGE EXECUTABLE\n")
    sys.stderr.flush()
    arguments = [shell]
    if os.path.basename(shell) == "bash":  # the user's own start-up file may set PATH or source another ROS 2
        start = os.path.join(STATE_FOLDER, "shell.bash")
        changed = {
            k: v
            for k, v in environment.items()
            if os.environ.get(k) != v or k in ("PATH", "PYTHONPATH", "LD_LIBRARY_PATH")
        }
        quoted = ["export {}='{}'".format(k, v.replace("'", "'\\''")) for k, v in sorted(changed.items())]
        with contextlib.suppress(OSError), open(start, "w") as file:
            file.write("[ -f ~/.bashrc ] && . ~/.bashrc\n" + "\n".join(quoted) + '\nPS1="(nmt) $PS1"\n')
        if os.path.exists(start):
            arguments = [shell, "--rcfile", start, "-i"]
    os.execvpe(shell, arguments, environment)


def run_tests(state: dict[str, Any], arguments: list[str]) -> int:
    """``test``: pytest on one worker more than there are cores, up to eight; later arguments win.

    Tests with nodes wait for half of their time: for processes to start, for the clock. A worker that has nothing to
    do takes half of what another one still has. The slowest ten are listed. Without bytecode each worker would compile
    every test anew.
    """
    from .environment import command_environment

    environment = command_environment(state)
    environment.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")
    environment.setdefault("ROS_LOG_DIR", os.path.join(STATE_FOLDER, "ros_log"))
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    workers = ["-n", str(min(len(os.sched_getaffinity(0)) + 1, 8)), "--dist", "worksteal"]
    slowest = ["--durations=10", "--durations-min=1"]
    os.chdir(ROOT)
    os.execve(VENV_PYTHON, [VENV_PYTHON, "-m", "pytest", *workers, *slowest, *arguments], environment)


def show_version() -> int:
    """``--version``: from the sources, so without the set-up; returns the exit code."""
    sys.path.insert(0, os.path.join(SOURCE, "nmt_core"))
    from nmt_core.bench_version import bench_version

    sys.stdout.write(f"nmt {bench_version()}\n")
    return 0


def _campaigns() -> dict[str, str]:
    """Line of help of each command of the campaigns, read from their sources: they may not be built yet."""
    found = {}
    for path in sorted(glob.glob(os.path.join(CAMPAIGNS, "*", "*", "*_command.py"))):
        with open(path, encoding="utf-8") as file:
            summary = re.search(r'^SUMMARY = "(.*)"$', file.read(), re.M)
        if summary:
            found[os.path.basename(path)[: -len("_command.py")]] = summary[1]
    return dict(sorted(found.items()))


def show_help() -> int:
    """``--help``: the launcher's own commands, then the bench's; returns the exit code."""
    sys.stdout.write(USAGE)
    sys.path[:0] = [os.path.join(SOURCE, name) for name in ("nmt_core", "nmt_bench")]
    with contextlib.suppress(ImportError):  # a clone that lacks them still says how to use the doctor
        from nmt_bench import cli

        cli.PROGRAM = "./nmt"
        sys.stdout.write("\n" + cli.build_parser(further=_campaigns()).format_help())
    return 0


def main(arguments: list[str]) -> int:
    """Set up what is missing and become the command; returns the exit code."""
    wanted = None
    while arguments[:1] in (["--wheels"], ["--system"]):
        wanted = arguments.pop(0)[2:]
    command = arguments[0] if arguments else "--help"
    rest = arguments[1:]
    if command == "--version" and not rest:
        return show_version()
    if command in ("-h", "--help"):
        return show_help()

    from .environment import command_environment

    if command == "doctor":
        from .doctor import doctor

        if rest not in ([], ["--json"]):
            raise SetupError(f"doctor knows --json and nothing else, not '{' '.join(rest)}'.", MISUSED)
        return doctor(wanted, as_json=bool(rest))

    from .kernels import PATIENT, wait_for_later
    from .set_up import discard_set_up, set_up

    if command == "setup":
        for argument in rest:
            if argument in ("--wheels", "--system"):
                wanted = argument[2:]
            elif argument not in ("--fresh", "-h", "--help"):
                raise SetupError(f"setup does not know '{argument}'; it knows --fresh, --wheels and --system.", MISUSED)
        if {"-h", "--help"} & set(rest):
            sys.stdout.write(USAGE)
            return 0
        if "--fresh" in rest:
            from .machine import choose_source
            from .stamps import read_state

            wanted = choose_source(wanted, read_state())
            discard_set_up()
        set_up(wanted)
        return 0
    computes = command not in ("rigs", "completion") and not {"-h", "--help"} & set(rest)
    state = set_up(wanted, compiled=computes)
    if computes and command in PATIENT:
        wait_for_later()
    if command == "test":
        return run_tests(state, rest)
    if command == "shell":
        return open_shell(state, rest)
    if command == "ros":
        return run_node(state, rest)
    os.execve(VENV_PYTHON, [VENV_PYTHON, "-m", "nmt_bench", *([command, *rest])], command_environment(state))


def stop(signal_number: int, _frame: object) -> None:
    """Let a request to end unwind like Ctrl-C, so that programs under way are ended too."""
    raise KeyboardInterrupt(signal_number)


def run(arguments: list[str]) -> int:
    """Run a command line and turn every end into an exit code; returns it."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, stop)
    try:
        code = main(arguments)
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # the reader of the output has gone: nobody is left to tell
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except SetupError as trouble:
        sys.stderr.write(f"nmt: {trouble}\n")
        return trouble.code
    except KeyboardInterrupt:
        sys.stderr.write("\nnmt: interrupted; the same command goes on where this one stopped.\n")
        return INTERRUPTED
    except OSError as problem:
        reasons = {
            errno.ENOSPC: "the disk is full: make room",
            errno.EDQUOT: "the disk quota is used up: make room",
            errno.EROFS: "it cannot be written: clone the project to a folder of yours",
            errno.EACCES: "access is denied: see that this folder is yours",
        }
        if problem.errno not in reasons:
            raise
        sys.stderr.write(f"nmt: {problem.filename or ROOT}: {reasons[problem.errno]}, then type the command again.\n")
        return FAILED
