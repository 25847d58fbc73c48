"""``./nmt page``: the live page beside running nodes, or a recording with a slider."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nmt_bench.page.server import PageServer


USAGE = """\
Serves a page on 127.0.0.1 and prints its address. Beside running nodes it shows the test as it goes on and lets steer
it; with a bag it replays the recording. Ctrl-C ends the page, not the test.

BAG?  recording to replay (default: running nodes)
--port N =0  port on 127.0.0.1 (default: a free one)
--domain N  ROS domain of the nodes (default: that of ROS_DOMAIN_ID)
--namespace NAME =""  namespace of the nodes (default: none)
--task hidden
--no-reference  do not compute the model's backbone
"""


def run(arguments: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C.

    Raises:
        BenchError: the port is taken, or the bag cannot be read.
    """
    import asyncio

    from nmt_bench.page.process import serve, serve_task
    from nmt_core.errors import BenchError

    if not 0 <= arguments.port <= 65_535:
        raise BenchError(f"--port must be from 0 to 65535, got {arguments.port}.")
    if arguments.task:
        asyncio.run(serve_task(tell_addresses, arguments.port))
        return 0
    reference = not arguments.no_reference
    port, bag, domain = arguments.port, arguments.bag, arguments.domain
    asyncio.run(serve(tell_addresses, port, bag, domain, arguments.namespace, reference))
    return 0


def tell_addresses(server: PageServer) -> None:
    """Print the addresses of a page."""
    if server.player is not None:
        sys.stdout.write(f"Page (works once): {server.steer_address}\n")
    else:
        if server.view.PAGE != "task.html":  # a task is not steered
            sys.stdout.write(f"Page, to watch and steer (works once): {server.steer_address}\n")
        sys.stdout.write(f"Page, to watch: {server.watch_address}\n")
    sys.stdout.flush()
