"""The page's process: the node in its thread, the server in the main one, and what is read from the bag."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from nmt_bench.page.bench_link import NoBench
from nmt_bench.page.live_view import LiveView
from nmt_bench.page.message_records import SLOW_TOPICS, RecordReader
from nmt_bench.page.server import PageServer
from nmt_bench.page.task_view import TaskView
from nmt_core.errors import BenchError
from nmt_core.files.hardened import yaml_value
from nmt_record.bag.bag_reader import Bag

_RETRY = 1.0  # s
_LARGEST_BAG = 500_000_000  # bytes that are read again to catch up with a run
_NICE = 5


class _Bench:
    """What a page next to running nodes does besides serving: it reads the bag and computes the reference."""

    def __init__(self, view: LiveView, with_reference: bool) -> None:
        self._view, self._with_reference = view, with_reference
        self._loop = asyncio.get_running_loop()
        self._tasks: set[asyncio.Task[None]] = set()

    def on_bag(self, path: Path) -> None:
        """A bag is being written; called in the node's thread."""
        self._loop.call_soon_threadsafe(self._begin, path)

    def _begin(self, path: Path) -> None:
        task = self._loop.create_task(self._read(path))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _read(self, path: Path) -> None:
        bag: Bag | None = None
        while bag is None or bag.run_start is None:
            bag = await asyncio.to_thread(_opened, path)
            if bag is None or bag.run_start is None:
                await asyncio.sleep(_RETRY)
        self._view.begin(bag.run_start, _parsed(bag.rig_yaml))
        await asyncio.to_thread(self._catch_up, bag, path)
        rig_file = path.parent / "rig.yaml"
        if self._with_reference and rig_file.is_file():
            from nmt_bench.page.model_reference import show_reference

            await show_reference(rig_file, self._view)

    def _catch_up(self, bag: Bag, path: Path) -> None:
        """Levels, locks and points from before the page was there."""
        if sum(file.stat().st_size for file in path.glob("*.mcap")) > _LARGEST_BAG:
            return
        reader = RecordReader()
        with contextlib.suppress(BenchError, OSError):
            for topic, _, _, raw in bag.raw_messages(SLOW_TOPICS):
                record = reader.read(topic, raw)
                if record is not None:
                    self._view.take_missed(record)

    async def close(self) -> None:
        """End what is still being read or computed."""
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)


def _opened(path: Path) -> Bag | None:
    try:
        return Bag.open(path)
    except (BenchError, OSError):
        return None  # its first chunk has not been written yet


def _parsed(text: str | None) -> dict[str, Any]:
    try:
        value = yaml_value(text or "", "rig file of the run")
    except BenchError:
        return {}
    return value if isinstance(value, dict) else {}


async def serve(
    tell: Callable[[PageServer], None],
    port: int = 0,
    bag: Path | None = None,
    domain_id: int | None = None,
    namespace: str = "",
    with_reference: bool = True,
) -> None:
    """Serve the page until SIGINT or SIGTERM.

    Args:
        tell: told of the server when it listens; shows its addresses.
        port: 0 = a free one.
        bag: recording to replay; None = watch running nodes.
        domain_id: ROS domain; None = that of the environment.
        namespace: of the bench.
        with_reference: whether the model's backbone is computed.

    Raises:
        BenchError: the port is taken, or the bag cannot be read.
    """
    ended = _told_to_end()
    view = LiveView(replay=bag is not None)
    bench = _Bench(view, with_reference)
    if bag is not None:
        from nmt_bench.page.bag_player import BagPlayer

        player = BagPlayer(bag, view)
        server = PageServer(view, NoBench(), port, player)
        close: Callable[[], None] = player.close
        rig_file = (bag if bag.is_dir() else bag.parent) / "rig.yaml"
        rig_file = rig_file if rig_file.is_file() else bag.parent / "rig.yaml"
    else:
        from nmt_bench.page.page_node import NodeLink

        with contextlib.suppress(OSError):
            os.nice(_NICE)  # the nodes come first
        link = NodeLink(view, domain_id, bench.on_bag, namespace)
        server = PageServer(view, link, port)
        close = link.close
        rig_file = Path()
    try:
        await server.start()
        tell(server)
        if bag is not None and with_reference and rig_file.is_file():
            from nmt_bench.page.model_reference import show_reference

            await _first(ended.wait(), show_reference(rig_file, view))
        await ended.wait()
    finally:
        await bench.close()
        await server.close()
        close()


async def serve_task(tell: Callable[[PageServer], None], port: int = 0) -> None:
    """Serve the progress of an investigation, told line by line on standard input, until SIGINT or SIGTERM.

    What is answered goes line by line to standard output.

    Args:
        tell: told of the server when it listens.
        port: 0 = a free one.

    Raises:
        BenchError: the port is taken.
    """
    ended = _told_to_end()
    view = TaskView(_say)
    with contextlib.suppress(OSError):
        os.nice(_NICE)
    server = PageServer(view, NoBench(), port)

    def listen() -> None:
        for line in sys.stdin.buffer:
            view.take_line(line)
        view.end()

    threading.Thread(target=listen, name="feed", daemon=True).start()
    try:
        await server.start()
        tell(server)
        await ended.wait()
    finally:
        await server.close()


def _say(word: str) -> None:
    sys.stdout.write(f"{word}\n")
    sys.stdout.flush()


def _told_to_end() -> asyncio.Event:
    """Set by SIGINT and SIGTERM."""
    loop = asyncio.get_running_loop()
    ended = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    return ended


async def _first(*waits: Any) -> None:
    """Wait until one of them is over, and end the others."""
    tasks = [asyncio.ensure_future(item) for item in waits]
    await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
