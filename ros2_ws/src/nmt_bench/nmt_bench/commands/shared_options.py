"""Options that several commands have, each declared once, and what functions that take such options ask for."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Protocol

from nmt_bench.commands.output_folder import free_folder
from nmt_core.options import option, option_made


class RigOptions(Protocol):
    """Options that say which rig, and what of it is changed."""

    @property
    def rig(self) -> str:
        """Name or path of the rig."""

    @property
    def set(self) -> tuple[str, ...]:
        """``key=value`` texts."""

    @property
    def exciter(self) -> int | None:
        """Drive point; None = the rig's."""


class DeviceOptions(RigOptions, Protocol):
    """Options that say what is driven, and by which clock."""

    @property
    def device(self) -> str:
        """Kind of converter, see ``--device``."""

    @property
    def pacing(self) -> str:
        """``lockstep`` or ``realtime``."""


_DEVICE = (
    "what is driven: {}portaudio, nidaqmx, or nidaqmx@HOST:PORT for NI's device server, loopback, custom; a converter "
    "that the rig file does not describe is taken for the simulated specimen's (default: the rig file's device{})"
)
_FOLDER = "folder for the results ({}); made if it does not exist"


def dated_folder_option(contents: str, command: str) -> Path:
    """``--out``; without it the results go to a folder with the command's name and the time.

    Args:
        contents: what the command leaves in the folder, for the help.
        command: its name.
    """
    return option_made(
        lambda: free_folder(Path("out") / time.strftime(f"{command}-%Y%m%d-%H%M%S")),
        f"{_FOLDER.format(contents)} (default: out/{command}-DATE-TIME)",
        metavar="DIR",
    )


def folder_option(contents: str) -> Path | None:
    """``--out`` of a command that finds its folder by itself; ``contents`` as of :func:`dated_folder_option`."""
    return option(None, _FOLDER.format(contents), metavar="DIR")


def replace_option() -> bool:
    """``--force``, or ``--replace`` where that means something else."""
    return option(False, "replace earlier results in the folder; files that nmt did not write stay")


def set_option(example: str = "") -> tuple[str, ...]:
    """``--set``, with an example for the help."""
    shown = f", for example {example}" if example else ""
    return option((), f"change a value of the rig file{shown}; may be repeated", metavar="KEY=VALUE")


def exciter_option() -> int | None:
    """``--exciter``."""
    return option(None, "drive point (default: the rig's)", metavar="N")


def seed_option() -> int | None:
    """``--seed``."""
    return option(None, "seed of all noise (default: the rig's)", metavar="N")


def pacing_option() -> str:
    """``--pacing``."""
    return option(
        "lockstep",
        "lockstep: simulated, as fast as the machine goes; realtime: by the clock (default: lockstep)",
        choices=("lockstep", "realtime"),
    )


def latency_option() -> int:
    """``--latency-blocks``."""
    return option(0, "blocks of converter buffering (default: 0; in real time 6, and 3 at least)", metavar="N")


def device_option() -> str:
    """``--device`` of a test, which may be simulated."""
    return option("", _DEVICE.format("simulated, ", ", else simulated"), metavar="KIND")


def hardware_option() -> str:
    """``--device`` where it must be a converter."""
    return option("", _DEVICE.format("", ""), metavar="KIND")


def one_process_option() -> bool:
    """``--one-process``."""
    return option(False, "all nodes in one process instead of one process each")


def domain_option() -> int | None:
    """``--domain``."""
    return option(None, "ROS domain, 1 to 100 (default: a free one)", metavar="N")


def quiet_option() -> bool:
    """``--quiet``."""
    return option(False, "no progress display")


def page_option() -> bool:
    """``--page`` of a test."""
    return option(False, "live page in the browser, to watch, steer and stop; prints its address")


def jobs_option() -> int | None:
    """``--jobs``."""
    return option(None, "worker processes (default: one for each core)", metavar="N")


def scheduler_option() -> str:
    """``--scheduler``."""
    return option("", "Dask scheduler, tcp://host:port, in place of own processes", metavar="ADDRESS")
