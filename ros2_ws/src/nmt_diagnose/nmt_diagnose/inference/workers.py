"""Independent pieces of work over several processes, with results that do not depend on their number."""

from __future__ import annotations

import contextlib
import pickle
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from multiprocessing import get_context
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, TypeVar

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R")

# A piece of work: what all pieces share, and what is its own.
Task = Callable[[S, T], R]


class Workers:
    """This process and helpers of its own.

    Every piece of work goes through the same copies of its arguments wherever it is done, so that one process and
    several give the same bits. Helpers start at once, in the background: what they import is ready when work comes.

    Args:
        jobs: processes, this one among them; 1 = no helpers. A script that asks for more needs the usual guard
            ``if __name__ == "__main__"``.
    """

    def __init__(self, jobs: int = 1) -> None:
        self._helpers = [_Helper() for _ in range(max(1, jobs) - 1)]

    def map(
        self,
        task: Task[S, T, R],
        shared: S,
        items: Sequence[T],
        before: Callable[[T], None] | None = None,
        weight: Callable[[T], float] | None = None,
    ) -> list[R]:
        """``task(shared, item)`` of every item, in their order.

        Args:
            task: a function of a module.
            shared: what every piece needs.
            items: of each piece its own.
            before: called with an item as its work begins, from any thread.
            weight: how much work an item is likely to be: the longest begin first, so that none is left over in the
                end; None = in their order.

        Raises:
            Exception: what the first item that failed raised.
        """
        if not items:
            return []
        payload = pickle.dumps((task, shared), pickle.HIGHEST_PROTOCOL)
        pieces = [pickle.dumps(item, pickle.HIGHEST_PROTOCOL) for item in items]
        results: list[bytes | None] = [None] * len(pieces)
        order = list(range(len(pieces)))
        if weight is not None:
            order.sort(key=lambda number: -weight(items[number]))
        todo = _Queue(order)

        def helped(helper: _Helper) -> None:
            for number in todo:
                if before is not None:
                    before(items[number])
                results[number] = helper.work(payload, pieces[number])
                if results[number] is None:
                    return  # the helper is gone; what it had begun is done here in the end

        threads = []
        for helper in self._helpers[: len(pieces) - 1]:
            if helper.alive:
                threads.append(threading.Thread(target=helped, args=(helper,), daemon=True))
                threads[-1].start()
        own = pickle.loads(payload)
        for number in todo:
            if before is not None:
                before(items[number])
            results[number] = _done(own, pieces[number])
        for thread in threads:
            thread.join()
        found = []
        for number, result in enumerate(results):
            good, value = pickle.loads(_done(own, pieces[number]) if result is None else result)
            if not good:
                raise value
            found.append(value)
        return found

    def close(self) -> None:
        """End the helpers."""
        for helper in self._helpers:
            helper.close()
        self._helpers = []

    def __enter__(self) -> Workers:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class _Queue:
    """Numbers of the pieces that nobody has taken yet, for several threads."""

    def __init__(self, order: Sequence[int]) -> None:
        self._numbers = iter(order)
        self._lock = threading.Lock()

    def __iter__(self) -> Iterator[int]:
        return self

    def __next__(self) -> int:
        with self._lock:
            return next(self._numbers)


class _Helper:
    """One process that works on request."""

    def __init__(self) -> None:
        # A fresh process: threads and locks of this one are not copied.
        context = get_context("spawn")
        self._connection, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(other,), daemon=True)
        self._process.start()
        other.close()
        self._known = b""
        self.alive = True

    def work(self, payload: bytes, piece: bytes) -> bytes | None:
        """The outcome of a piece of work; None where the process has ended."""
        try:
            self._connection.send_bytes(payload if payload is not self._known else b"")
            self._known = payload
            self._connection.send_bytes(piece)
            return self._connection.recv_bytes()
        except (EOFError, OSError):
            self.alive = False
            return None

    def close(self) -> None:
        self.alive = False
        self._connection.close()
        self._process.terminate()
        self._process.join()
        self._process.close()


def _serve(connection: Connection) -> None:
    """Work until the other side is gone."""
    # An interrupt of the terminal is for the process that waits for the results.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # What the work needs, imported while the other side still reads its data.
    import nmt_diagnose.inference.next_test  # noqa: F401

    own: Any = None
    with contextlib.suppress(EOFError, OSError):
        while True:
            payload = connection.recv_bytes()
            if payload:
                own = pickle.loads(payload)
            connection.send_bytes(_done(own, connection.recv_bytes()))


def _done(own: tuple[Task[Any, Any, Any], Any], piece: bytes) -> bytes:
    """Whether a piece of work succeeded and its result or error, as bytes."""
    task, shared = own
    try:
        outcome = True, task(shared, pickle.loads(piece))
    except Exception as error:
        outcome = False, error
    return pickle.dumps(outcome, pickle.HIGHEST_PROTOCOL)
