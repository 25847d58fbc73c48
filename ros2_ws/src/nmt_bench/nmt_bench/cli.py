"""The command line: picks the command, loads only its module, and turns every end into an exit code.

Each command is a module with ``run(options) -> int`` and the class of these options, see
`nmt_bench.commands.command_options`. Nothing but the
chosen command's module is imported, so help and refusals come at once; what few ends need is imported where they need
it. Further commands come from whatever is installed with entry points in the group ``nmt.commands``, as are the
campaigns; their modules have a ``SUMMARY``, too.

Exit codes: 0 done, 1 failed or an unexpected error (its traceback is in a log file), 2 a mistake that the user can fix,
3 a run some of whose levels are not in the table, 130 interrupted.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import gc
import importlib
import importlib.util
import os
import re
import resource
import signal
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING, NoReturn

from nmt_bench.command_parser import (
    EXIT_DONE,
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    EXIT_USER,
    CommandParser,
    CommandRefusal,
)
from nmt_bench.orchestration.interrupts import interrupts_of_kernels, raise_interrupt
from nmt_core.bench_version import bench_version
from nmt_core.errors import BenchError, FailedError
from nmt_core.processes.process_end import end_process

if TYPE_CHECKING:
    from pathlib import Path

PROGRAM = "nmt" if os.path.basename(sys.argv[0]) == "nmt" else "./nmt"
"""As the user calls it: the script that pip installs, or the launcher, which starts ``python -m nmt_bench``."""

COMMANDS = {
    "demo": "the paper's virtual experiment, from the first node to the report",
    "run": "one test of a rig: step the level, lock, record, extract, report",
    "page": "live page in the browser: watch, steer and stop a test; replay a bag",
    "extract": "modal properties from a recorded bag; equal to the live ones",
    "linear": "linear modal test: random drive, frequency responses, fitted modes",
    "check": "low-level check of every channel and of the loop before a test on hardware",
    "sweep": "sine sweep or stepped sine with a held force; frequency responses",
    "synthesis": "frequency response from a backbone alone, compared with measured sweeps",
    "diagnose": "where model and real rig part, which effect causes it, how far the gap shrinks",
    "investigate": "chooses, runs and stops tests until the gap to a model has a name",
    "import": "data measured elsewhere (tables, MATLAB, LabVIEW, UFF58) as a bag",
    "repair": "what can be saved of a damaged or cut bag, and what was lost",
    "export": "a recording as UFF58, CSV, NPZ, HDF5 or MATLAB; modes as UFF55",
    "figures": "figures of a report as SVG, PDF and PNG for a paper, each with its table",
    "reference": "computed backbone of a rig's model (EPMC, harmonic balance)",
    "stop": "emergency stop of the benches of this host",
    "rigs": "the rigs that can be given by name",
    "params": "parameter file of a rig for starting the nodes one by one",
    "goal": "starts the run of nodes that were started one by one",
    "completion": "completion of commands and options for bash or zsh",
    "help": "the commands, or the options of one",
}
"""Line of help of each command of the bench; its module is ``nmt_bench.commands.<name>_command``. ``test``, ``doctor``
and ``setup`` belong to the launcher."""

GROUP = "nmt.commands"
"""Entry points of further commands: name = module."""

_LAUNCHER_COMMANDS = """\
also, from the launcher:
  test                  the whole test-suite
  doctor                what is missing on this machine and how to fix it
  setup                 only the set-up
"""

_CLONE_COMMANDS = ("blind",)
"""Campaigns are made where the program is developed; the wheel leaves them out."""

_ROS_MODULES = frozenset(
    {
        "action_msgs",
        "builtin_interfaces",
        "diagnostic_msgs",
        "nmt_msgs",
        "rcl_interfaces",
        "rclpy",
        "std_msgs",
        "std_srvs",
        "unique_identifier_msgs",
    }
)


_REASONS = {
    errno.ENOSPC: "the disk is full; make room or choose another folder with --out",
    errno.EDQUOT: "the disk quota is used up; make room or choose another folder with --out",
    errno.EROFS: "this cannot be written; choose another folder with --out",
    errno.EACCES: "access is denied; choose another file or folder, or change its owner",
    errno.EPERM: "access is denied; choose another file or folder, or change its owner",
    errno.EMFILE: "this shell allows too few open files; type 'ulimit -n 1024' and the command again",
    errno.ENFILE: "this computer has no file handles left; end other programs",
    errno.ENAMETOOLONG: "this name is too long for a file; give a shorter one",
}
"""What the user can fix where the operating system refuses."""


@cache
def further_commands() -> dict[str, str]:
    """Module of each command that an installed package adds, by its name."""
    from importlib.metadata import entry_points

    found = {entry.name: entry.value for entry in sorted(entry_points(group=GROUP)) if entry.name not in COMMANDS}
    return {name: path for name, path in found.items() if _is_importable(path.partition(".")[0])}


def _is_importable(package: str) -> bool:
    """Whether a package is there; an entry point may outlive what it names."""
    try:
        return importlib.util.find_spec(package) is not None
    except ModuleNotFoundError:
        return False


@cache
def all_commands() -> dict[str, str]:
    """Line of help of each command, the bench's before the others."""
    return COMMANDS | {name: str(importlib.import_module(path).SUMMARY) for name, path in further_commands().items()}


def build_parser(*wanted: str | None, further: Mapping[str, str] | None = None) -> argparse.ArgumentParser:
    """The parser of the whole command line.

    Args:
        *wanted: the commands whose options are wanted; the others get their line of help only. Where all are the
            bench's own the others are not searched for.
        further: lines of help of the other packages' commands; None = as installed.

    Raises:
        BenchError: the command's module is not installed.
    """
    parser = CommandParser(
        prog=PROGRAM,
        description="A test bench for nonlinear modal testing, on simulated rigs and on hardware.",
        epilog=_LAUNCHER_COMMANDS if PROGRAM == "./nmt" else None,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"nmt {_version()}")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", title="commands")
    if wanted and COMMANDS.keys() >= set(wanted):
        listed = COMMANDS
    else:
        listed = all_commands() if further is None else {**COMMANDS, **further}
    for name, summary in listed.items():
        options = subparsers.add_parser(name, help=summary, add_help=name in wanted)
        if name in wanted:
            from nmt_bench.commands.command_options import add_command

            add_command(options, _load(name))
    return parser


def program() -> NoReturn:
    """The command line as a process of its own."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, raise_interrupt)
    gc.set_threshold(50_000, 20, 50)  # by default the collector takes a seventh of the time in which figures are drawn
    end_process(main())


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: arguments without the program's name; None = those of the process.

    Returns:
        The exit code.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    end = _End()
    try:
        if "--json" in words and "benchmark" not in words:
            with contextlib.redirect_stdout(sys.stderr):
                status = _run(words, end)
            sys.stdout.write(_document(words, end, status))
        else:
            status = _run(words, end)
        sys.stdout.flush()
        return status
    except BrokenPipeError:
        # The reader of our output has gone (``| head``): the output has no reader left. Python would complain at
        # exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_FAILED


class _End:
    """How a command ended, next to its exit code.

    Attributes:
        arguments: as parsed; None where they were refused.
        sentence: of a refusal or failure; None where there was none.
    """

    def __init__(self) -> None:
        self.arguments: argparse.Namespace | None = None
        self.sentence: str | None = None


def _document(words: Sequence[str], end: _End, status: int) -> str:
    """What ``--json`` prints."""
    from nmt_bench.commands.command_options import command_options
    from nmt_bench.commands.json_output import json_document, json_refusal

    if end.arguments is None or end.sentence is not None:
        return json_refusal(_command_of(words), status, end.sentence)
    module = _load(end.arguments.command)
    options = command_options(module, end.arguments)
    return json_document(end.arguments.command, options, module, status)


def _command_of(words: Sequence[str]) -> str | None:
    return next((word for word in words if not word.startswith("-")), None)


def _run(words: list[str], end: _End) -> int:
    command = _command_of(words)
    try:
        if command in _CLONE_COMMANDS and command not in further_commands():
            raise BenchError(f"Campaigns are not in what pip installs; use './nmt {command}' of a clone.")
        parser = build_parser(command)
        if not words:
            parser.print_help()
            return EXIT_USER
        for word in words:
            if word.startswith("--") and word.endswith("=--"):  # argparse would make an empty list of it
                parser.error(f"argument {word[:-3]}: expected a value, got '--'")
        end.arguments = parser.parse_args(words)
        if end.arguments.command is None:
            parser.error("a command is missing")
        with interrupts_of_kernels():
            return run_parsed(end.arguments)
    except CommandRefusal as refusal:
        end.sentence = refusal.sentence
        return EXIT_USER
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else EXIT_DONE if stop.code is None else EXIT_USER
    except BenchError as error:
        end.sentence = _complain(command, str(error))
        return EXIT_FAILED if isinstance(error, FailedError) else EXIT_USER
    except ModuleNotFoundError as error:
        library = (error.name or "nmt_").partition(".")[0]
        if library.startswith("nmt_") and library not in _ROS_MODULES:
            return _unexpected(command, error, words, end)
        end.sentence = _complain(command, _missing_module(library))
        return EXIT_USER
    except KeyboardInterrupt:
        end.sentence = _complain(command, "Stopped on request (Ctrl-C).")
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        raise
    except OSError as error:
        if error.errno not in _REASONS:
            return _unexpected(command, error, words, end)
        name = str(error.filename or "")
        where = f"{name[:100]}{'…' if len(name) > 100 else ''}: " if name else ""
        end.sentence = _complain(command, f"{where}{_REASONS[error.errno]}.")
        return EXIT_USER
    except Exception as error:
        return _unexpected(command, error, words, end)


def run_parsed(arguments: argparse.Namespace) -> int:
    """Run the command of parsed arguments.

    Returns:
        Its exit code.

    Raises:
        BenchError: a mistake that the user can fix.
    """
    from nmt_bench.commands.command_options import run_command

    status = run_command(_load(arguments.command), arguments)
    sys.stdout.flush()
    return status


def write_error_log(words: Sequence[str]) -> Path:
    """Write the traceback of the exception being handled to a log file.

    Args:
        words: the command line's arguments.

    Returns:
        Path of the file, in the folder for temporary files.
    """
    import tempfile
    import time
    import traceback
    from pathlib import Path

    stamp = time.strftime("%Y%m%d-%H%M%S")
    handle, name = tempfile.mkstemp(prefix=f"nmt-error-{stamp}-", suffix=".log", text=True)
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        file.write(f"nmt {_version()}, Python {sys.version}\narguments: {list(words)!r}\n\n{traceback.format_exc()}")
    return Path(name)


def _load(name: str) -> ModuleType:
    try:
        return importlib.import_module(
            f"nmt_bench.commands.{name}_command" if name in COMMANDS else further_commands()[name]
        )
    except ModuleNotFoundError as error:
        if error.name is None:
            raise
        raise BenchError(f"The command '{name}' cannot start: {_missing_module(error.name)}") from error


def _missing_module(name: str) -> str:
    """What to say where a module cannot be imported."""
    library = name.partition(".")[0]
    if PROGRAM == "./nmt":
        return f"'{library}' is not installed; run './nmt setup' and, if that does not fix it, './nmt doctor'."
    if library in _ROS_MODULES:
        return (
            f"This starts ROS 2 nodes and '{library}' is not installed; use './nmt' of a clone, which brings ROS 2, or "
            "a workspace built and sourced next to ROS 2 Jazzy."
        )
    if library == "distributed":
        return "'distributed' is not installed; type in a clone of the bench: pip install '.[dask]'."
    return f"'{library}' is not installed, although nmt needs it; type in a clone: pip install --force-reinstall ."


_NO_MEMORY = re.compile(r"pthread_create|start new thread|failed to map|Could not find/load shared|allocate memory")


def _memory_sentence(error: Exception) -> str:
    """What to say where memory was not enough; empty if that is not what failed."""
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY and (isinstance(error, MemoryError) or _NO_MEMORY.search(str(error))):
        return f"{limit / 2**20:.0f} MiB of address space are too few for this; type 'ulimit -v unlimited' before it."
    if isinstance(error, MemoryError):
        return f"The memory of this computer is not enough for this ({_first_line(error)}); give it less data at once."
    return ""


def _unexpected(command: str | None, error: Exception, words: Sequence[str], end: _End) -> int:
    """Say that something failed which should not, and where the details are; or that memory was not enough."""
    if sentence := _memory_sentence(error):
        end.sentence = _complain(command, sentence)
        return EXIT_USER
    log = write_error_log(words)
    sentence = f"This should not have happened ({type(error).__name__}: {_first_line(error)}); details are in {log}."
    end.sentence = _complain(command, sentence)
    return EXIT_FAILED


def _complain(command: str | None, sentence: str) -> str:
    """Write a sentence to standard error; returns it."""
    sys.stdout.flush()
    known = command in COMMANDS or command in _CLONE_COMMANDS or command in further_commands()
    name = f"{PROGRAM} {command}" if known else PROGRAM
    sys.stderr.write(f"{name}: {sentence}\n")
    return sentence


def _first_line(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return lines[0].rstrip(".") if lines else "no message"


def _version() -> str:
    return bench_version() or "(not installed)"
