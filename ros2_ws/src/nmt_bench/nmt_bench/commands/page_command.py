"""``./nmt page``: the live page beside running nodes, or a recording with a slider."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from nmt_bench.command_parser import Subparsers

if TYPE_CHECKING:
    from nmt_bench.page.server import PageServer


def add_parser(subparsers: Subparsers) -> None:
    """Add the command and its options."""
    parser = subparsers.add_parser(
        "page",
        help="live page in the browser: watch, steer and stop a test, or replay a bag",
        description=(
            "Serves a page on 127.0.0.1 and prints its address. Beside running nodes it shows the test as it goes on "
            "and lets steer it; with a bag it replays the recording. Ctrl-C ends the page, not the test."
        ),
    )
    parser.add_argument("bag", metavar="BAG", nargs="?", type=Path, help="recording to replay (default: running nodes)")
    parser.add_argument("--port", metavar="N", type=int, default=0, help="port on 127.0.0.1 (default: a free one)")
    parser.add_argument(
        "--domain", metavar="N", type=int, help="ROS domain of the nodes (default: that of ROS_DOMAIN_ID)"
    )
    parser.add_argument("--namespace", metavar="NAME", default="", help="namespace of the nodes (default: none)")
    parser.add_argument(
        "--task", action="store_true", help=argparse.SUPPRESS
    )  # progress of a command, on standard input
    parser.add_argument("--no-reference", action="store_true", help="do not compute the model's backbone")


def run(arguments: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C.

    Raises:
        BenchError: the port is taken, or the bag cannot be read.
    """
    from nmt_bench.page.process import serve, serve_task
    from nmt_core.errors import BenchError

    if not 0 <= arguments.port <= 65_535:
        raise BenchError(f"--port must be from 0 to 65535, got {arguments.port}.")
    if arguments.task:
        serve_task(_tell_task, arguments.port)
        return 0
    serve(
        tell_addresses,
        arguments.port,
        arguments.bag,
        arguments.domain,
        arguments.namespace,
        not arguments.no_reference,
    )
    return 0


def tell_addresses(server: PageServer) -> None:
    """Print the addresses of a page."""
    if server.player is None:
        sys.stdout.write(f"Page, to watch and steer (works once): {server.steer_address}\n")
        sys.stdout.write(f"Page, to watch: {server.watch_address}\n")
    else:
        sys.stdout.write(f"Page (works once): {server.steer_address}\n")
    sys.stdout.flush()


def _tell_task(server: PageServer) -> None:
    sys.stdout.write(f"Page, to watch: {server.watch_address}\n")
    sys.stdout.flush()
