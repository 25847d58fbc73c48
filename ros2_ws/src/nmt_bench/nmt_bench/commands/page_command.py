"""``./nmt page``: the live page next to running nodes, or a recording with a slider."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nmt_core.options import option, optional_argument

if TYPE_CHECKING:
    from nmt_bench.page.server import PageServer


@dataclass(frozen=True, kw_only=True)
class PageOptions:
    """Serves a page on 127.0.0.1 and prints its address. Next to running nodes it shows the test as it goes on and lets
    steer it; with a bag it replays the recording. Ctrl-C ends the page, not the test."""

    bag: Path | None = optional_argument(None, "recording to replay (default: running nodes)", metavar="BAG")
    port: int = option(0, "port on 127.0.0.1 (default: a free one)", metavar="N")
    domain: int | None = option(None, "ROS domain of the nodes (default: that of ROS_DOMAIN_ID)", metavar="N")
    namespace: str = option("", "namespace of the nodes (default: none)", metavar="NAME")
    task: bool = option(False, "", hidden=True)
    no_reference: bool = option(False, "do not compute the model's backbone")


def run(options: PageOptions) -> int:
    """Serve the page until Ctrl-C.

    Raises:
        BenchError: the port is taken, or the bag cannot be read.
    """
    import asyncio

    from nmt_bench.page.process import serve, serve_task
    from nmt_core.errors import BenchError

    if not 0 <= options.port <= 65_535:
        raise BenchError(f"--port must be from 0 to 65535, got {options.port}.")
    if options.task:
        asyncio.run(serve_task(tell_addresses, options.port))
        return 0
    reference = not options.no_reference
    port, bag, domain = options.port, options.bag, options.domain
    asyncio.run(serve(tell_addresses, port, bag, domain, options.namespace, reference))
    return 0


def tell_addresses(server: PageServer) -> None:
    """Print the addresses of a page."""
    if server.player is not None:
        sys.stdout.write(f"Page (works once): {server.steer_address}\n")
    else:
        sys.stdout.write(f"Page, to watch and steer (works once): {server.steer_address}\n")
        sys.stdout.write(f"Page, to watch: {server.watch_address}\n")
    sys.stdout.flush()
