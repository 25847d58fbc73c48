"""A passing node test must leave nothing running."""

from __future__ import annotations

import gc
import os
import threading
import time
import weakref
from collections.abc import Iterator
from pathlib import Path

import pytest

try:
    from rclpy.context import Context
except ImportError:  # the tests skip themselves
    Context = None

_PATIENCE = 5.0  # s of wall time for threads and processes that are about to end
_PASSED = pytest.StashKey[bool]()
# Helpers of the standard library that live as long as the test session.
_STANDARD_HELPERS = ("multiprocessing.resource_tracker", "multiprocessing.forkserver")

_contexts: weakref.WeakSet = weakref.WeakSet()


def _watch_contexts() -> None:
    """Note every context that is initialised from now on."""
    original = Context.init

    def init(self, *args, **kwargs):
        _contexts.add(self)
        return original(self, *args, **kwargs)

    Context.init = init


if Context is not None:
    _watch_contexts()


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo) -> Iterator[None]:
    outcome = yield
    if call.when == "call":
        item.stash[_PASSED] = outcome.get_result().passed


def child_processes() -> dict[int, str]:
    """Living children of this process and of their children: process id -> command line."""
    children: dict[int, str] = {}
    todo = [os.getpid()]
    while todo:
        for task in Path(f"/proc/{todo.pop()}/task").glob("*/children"):
            try:
                found = [int(word) for word in task.read_text().split()]
            except OSError:
                continue
            for child in found:
                try:
                    line = Path(f"/proc/{child}/cmdline").read_bytes().replace(b"\0", b" ").decode().strip()
                except OSError:
                    continue
                children[child] = line or "(ended, not waited for)"
                todo.append(child)
    helpers = {pid for pid, line in children.items() if any(name in line for name in _STANDARD_HELPERS)}
    return {pid: line for pid, line in children.items() if pid not in helpers}


def threads() -> set[threading.Thread]:
    """Threads that would keep the interpreter from ending."""
    return {thread for thread in threading.enumerate() if not thread.daemon}


def contexts() -> set:
    """Contexts of rclpy that are initialised."""
    return {context for context in _contexts if context.ok()}


class Surroundings:
    """What runs now, to be compared with what runs later."""

    def __init__(self) -> None:
        self.children = set(child_processes())
        self.threads = threads()
        self.contexts = contexts()

    def new(self) -> list[str]:
        """One sentence about each thing that runs now and did not run then."""
        children = {pid: line for pid, line in child_processes().items() if pid not in self.children}
        found = [f"child process {pid}: {line}" for pid, line in children.items()]
        found += [f"thread {thread.name}" for thread in threads() - self.threads]
        if contexts() - self.contexts:
            gc.collect()  # a context nobody holds any more is not a leak
        found += [f"initialised rclpy context {context!r}" for context in contexts() - self.contexts]
        return found


@pytest.fixture(autouse=True)
def _nothing_left(request: pytest.FixtureRequest) -> Iterator[None]:
    before = Surroundings()
    yield
    if not request.node.stash.get(_PASSED, False):
        return
    deadline = time.monotonic() + _PATIENCE
    while (left := before.new()) and time.monotonic() < deadline:
        time.sleep(0.05)
    if left:
        pytest.fail("the test passed but left behind: " + "; ".join(left))
