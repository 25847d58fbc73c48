"""Options that several commands have, and the options of a command from its module."""

from __future__ import annotations

import argparse
import time
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Unpack

from nmt_bench.commands.output_folder import free_folder
from nmt_core.text.option_table import declare

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from nmt_bench.harness import Bench
    from nmt_session.node_plan import PlanSettings

_DEVICE = """\
--device KIND =""  what is driven: {}portaudio, nidaqmx, or nidaqmx@HOST:PORT for NI's device server; a converter that
    the rig file does not describe is taken for the simulated specimen's (default: the rig file's device{})"""


def _set(example: str) -> str:
    shown = f", for example {example}" if example else ""
    return f"--set KEY=VALUE...  change a value of the rig file{shown}; may be repeated"


def _rig(example: str) -> str:
    return f"""\
--exciter N  drive point (default: the rig's)
--seed N  seed of all noise (default: the rig's)
{_set(example)}"""


def _output(contents: str, command: str, replace: str = "force") -> str:
    """``--out`` and ``--force``.

    Args:
        contents: what the command leaves in the folder, for the help text.
        command: its name: without ``--out`` the results go to a folder with it and the time. Empty: ``out`` is None.
        replace: name of the option that allows earlier results to be replaced, where ``--force`` means something else.
    """
    folder, told = "", ""
    if command:
        folder = f" ={free_folder(Path('out') / time.strftime(f'{command}-%Y%m%d-%H%M%S'))}"
        told = f" (default: out/{command}-DATE-TIME)"
    return f"""\
--out DIR{folder}  folder for the results ({contents}); made if it does not exist{told}
--{replace}  replace earlier results in the folder; files that nmt did not write stay"""


SHARED: dict[str, str | Callable[[str], str]] = {
    "output-undated": partial(_output, command=""),
    "output-replace": partial(_output, command="sweep", replace="replace"),
    "set": _set,
    "rig": _rig,
    "pacing": """\
--pacing lockstep|realtime =lockstep  lockstep: simulated, as fast as the machine goes; realtime: by the clock
    (default: lockstep)
""",
    "latency": "--latency-blocks N =0  blocks of converter buffering (default: 0; in real time 6, and 3 at least)",
    "device": _DEVICE.format("simulated, ", ", else simulated"),
    "device-of-hardware": _DEVICE.format("", ""),
    "processes": """\
--one-process  all nodes in one process instead of one process each
--domain N  ROS domain, 1 to 100 (default: a free one)
--quiet  no progress display
@page
""",
    "page": "--page  live page in the browser, to watch, steer and stop; prints its address",
    "task-page": "--page  progress in the browser, to watch only; prints the page's address",
    "jobs": "--jobs N  worker processes (default: one for each core)",
    "json": """\
--json  print one JSON document (exit code, files, results) on standard output, all else on standard error""",
    "scheduler": '--scheduler ADDRESS =""  Dask scheduler, tcp://host:port, in place of own processes',
}
"""What several commands have, by the name behind the @ in their tables."""


def add_options(parser: argparse.ArgumentParser, command: ModuleType) -> None:
    """Give a command's parser what its module states.

    Args:
        parser: of the command.
        command: its module. ``USAGE`` has the description, the table of options (see `nmt_core.text.option_table`) and
            what stands below them, with an empty line between; ``KINDS`` types of its own; ``PART_USAGE``
            the same of each part, with its line of help in place of the description.
    """
    parser.description, table, below = _sections(command.USAGE)
    if below:
        parser.epilog = below.rstrip()
    if "\n" in below.rstrip():
        parser.formatter_class = argparse.RawDescriptionHelpFormatter
    shared = {**SHARED, "output": partial(_output, command=parser.prog.rpartition(" ")[2])}
    if not hasattr(command, "PART_USAGE"):
        declare(parser, table, getattr(command, "KINDS", None), shared)
        return
    parts = parser.add_subparsers(dest="part", metavar="PART", title="parts", required=True)
    for name, usage in command.PART_USAGE.items():
        summary, table, _ = _sections(usage)
        declare(parts.add_parser(name, help=summary), table, shared=shared)


def _sections(usage: str) -> tuple[str, str, str]:
    """What stands above the table of options, the table with ``--json``, and what stands below."""
    above, table, below = (*usage.split("\n\n", 2), "", "")[:3]
    return " ".join(above.split()), table if "--json" in table else f"{table}\n@json", below


def bench_of(
    arguments: argparse.Namespace,
    levels: Sequence[float] | str | None = None,
    compare: int = 0,
    **settings: Unpack[PlanSettings],
) -> Bench:
    """The bench that the options of rig, device and processes ask for; levels, compare and settings as of `plan_test`.

    Raises:
        BenchError: the rig, a level or an option is refused, or the converter is not there or not checked.
    """
    from nmt_bench.commands.hardware_options import device_settings
    from nmt_bench.harness import Bench

    return Bench(
        arguments.rig,
        levels,
        out=arguments.out,
        processes=not arguments.one_process,
        domain_id=arguments.domain,
        overrides=arguments.set,
        exciter=arguments.exciter,
        seed=arguments.seed,
        compare=compare,
        **settings,
        **device_settings(arguments),
    )
