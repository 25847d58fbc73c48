"""Ctrl-C, SIGTERM and SIGHUP while a test runs: a wish to end that must not lose what was measured."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Any

_MOMENT = 1e-3  # s
_ALL = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def raise_interrupt(number: int, frame: FrameType | None) -> None:
    """Handler of a signal that interrupts.

    Where it comes while numba makes Python objects of a result, which is not prepared for an exception, it acts a
    moment later: a named tuple that is not made would end the process.

    Raises:
        KeyboardInterrupt: otherwise.
    """
    inner = frame
    while inner is not None:
        name = str(inner.f_globals.get("__name__", ""))
        if name in ("numba.core.serialize", "collections") or name.startswith("namedtuple_"):
            threading.Timer(_MOMENT, os.kill, (os.getpid(), number)).start()
            return
        inner = inner.f_back
    raise KeyboardInterrupt


@contextlib.contextmanager
def interrupts_of_kernels() -> Iterator[None]:
    """Let an interrupt that comes while compiled code hands over its result be an interrupt.

    numba returns with it pending, which Python takes for a fault of the compiled function (``SystemError``).
    """
    try:
        yield
    except SystemError as error:
        if isinstance(error.__cause__, KeyboardInterrupt):
            raise KeyboardInterrupt from error
        raise


@contextlib.contextmanager
def terminate_as_interrupt() -> Iterator[None]:
    """Let SIGTERM and SIGHUP (a dropped connection) end a test as Ctrl-C does: by a ramp to zero.

    What is ignored, as SIGHUP under ``nohup``, stays ignored.
    """

    def interrupt(number: int, frame: FrameType | None) -> None:
        if number == signal.SIGHUP:
            _leave_terminal()
        raise_interrupt(number, frame)

    with _handled((signal.SIGTERM, signal.SIGHUP), interrupt), interrupts_of_kernels():
        yield


class Deferred:
    """What came while interrupts were deferred.

    Attributes:
        came: whether a signal came.
        number: of the first one; 0 = none came.
    """

    def __init__(self) -> None:
        self.came = False
        self.number = 0


@contextlib.contextmanager
def deferred_interrupts(patient: bool = False) -> Iterator[Deferred]:
    """Keep a signal from breaking into work that is short or must not be left half done.

    Args:
        patient: no number of signals breaks in; otherwise the second one does.
    """
    deferred = Deferred()

    def note(number: int, _: object) -> None:
        if number == signal.SIGHUP:
            _leave_terminal()
        if deferred.came and not patient:
            raise KeyboardInterrupt
        deferred.came, deferred.number = True, number

    with _handled(_ALL, note):
        yield deferred


@contextlib.contextmanager
def unbroken() -> Iterator[None]:
    """Keep a signal from breaking into a library that would take it for a failure of its own; it acts afterwards.

    A second one breaks in.
    """
    deferred = Deferred()
    try:
        with deferred_interrupts() as deferred:
            yield
    finally:
        if deferred.came:
            signal.raise_signal(deferred.number)


@contextlib.contextmanager
def _handled(numbers: tuple[signal.Signals, ...], handler: Any) -> Iterator[None]:
    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in numbers:
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                before[number] = signal.signal(number, handler)
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


def _leave_terminal() -> None:
    """Write to nowhere what would go to a terminal that has gone; files and pipes stay."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            if os.isatty(stream.fileno()) or _is_dead_terminal(stream.fileno()):
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, stream.fileno())
                os.close(nowhere)


def _is_dead_terminal(descriptor: int) -> bool:
    """Whether a descriptor leads to a terminal that hung up, which is none any more to ``isatty``."""
    return os.readlink(f"/proc/self/fd/{descriptor}").startswith(("/dev/pts/", "/dev/tty"))
