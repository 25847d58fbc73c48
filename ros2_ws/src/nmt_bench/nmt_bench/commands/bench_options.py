"""Options that every command which starts the bench's nodes has."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Unpack

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nmt_bench.harness import Bench
    from nmt_session.node_plan import PlanSettings

_LATENCY = "blocks of converter buffering (default: 0; in real time 6, and 3 at least)"


def add_rig_options(parser: argparse.ArgumentParser, example: str = "") -> None:
    """``--exciter``, ``--seed`` and ``--set``: what is changed of the rig."""
    parser.add_argument("--exciter", metavar="N", type=int, help="drive point (default: the rig's)")
    parser.add_argument("--seed", metavar="N", type=int, help="seed of all noise (default: the rig's)")
    add_set_option(parser, example)


def add_set_option(parser: argparse.ArgumentParser, example: str = "") -> None:
    """``--set``; ``example``: key=value, for its help."""
    shown = f", for example {example}" if example else ""
    text = f"change a value of the rig file{shown}; may be repeated"
    parser.add_argument("--set", metavar="KEY=VALUE", action="append", default=[], help=text)


def bench_of(
    arguments: argparse.Namespace, levels: Sequence[float] | str | None = None, **settings: Unpack[PlanSettings]
) -> Bench:
    """The bench that the options of rig, device and processes ask for; levels and settings as of `plan_test`.

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
        **settings,
        **device_settings(arguments),
    )


def add_pacing_option(parser: argparse.ArgumentParser) -> None:
    """``--pacing``."""
    parser.add_argument(
        "--pacing",
        choices=("lockstep", "realtime"),
        default="lockstep",
        help="lockstep: simulated, as fast as the machine goes; realtime: by the clock (default: lockstep)",
    )


def add_latency_option(parser: argparse.ArgumentParser) -> None:
    """``--latency-blocks``."""
    parser.add_argument("--latency-blocks", metavar="N", type=int, default=0, help=_LATENCY)


def add_device_option(parser: argparse.ArgumentParser, simulated: bool = True) -> None:
    """``--device``; ``simulated``: whether the command knows what to do with a simulated rig."""
    words = ("simulated, ", ", else simulated") if simulated else ("", "")
    parser.add_argument(
        "--device",
        metavar="KIND",
        default="",
        help=f"what is driven: {words[0]}portaudio, nidaqmx, or nidaqmx@HOST:PORT for NI's device server; a converter "
        f"that the rig file does not describe is taken for the simulated specimen's (default: the rig file's device"
        f"{words[1]})",
    )


def add_process_options(parser: argparse.ArgumentParser) -> None:
    """``--one-process``, ``--domain``, ``--quiet`` and ``--page``: how the nodes are started and watched."""
    parser.add_argument(
        "--one-process", action="store_true", help="all nodes in one process instead of one process each"
    )
    parser.add_argument("--domain", metavar="N", type=int, help="ROS domain, 1 to 100 (default: a free one)")
    parser.add_argument("--quiet", action="store_true", help="no progress display")
    add_page_option(parser)


def add_page_option(parser: argparse.ArgumentParser) -> None:
    """``--page``."""
    parser.add_argument(
        "--page", action="store_true", help="live page in the browser, to watch, steer and stop; prints its address"
    )


def add_task_page_option(parser: argparse.ArgumentParser) -> None:
    """``--page`` of a command that computes."""
    parser.add_argument(
        "--page", action="store_true", help="progress in the browser, to watch only; prints the page's address"
    )
