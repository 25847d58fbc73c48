"""What long work tells of itself while it goes on: what is being done, and how much of it is done.

Code that works for seconds calls :func:`tell`; whoever wants to know, the command line for one, listens with
:func:`listening`. Without a listener nothing happens.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

Listener = Callable[[str, int, int], None]
"""Takes what is being done, the pieces that are done and how many there are (0 where they are not counted)."""

_EACH = 500
_listener: ContextVar[Listener | None] = ContextVar("nmt_work_progress", default=None)
_Item = TypeVar("_Item")


def tell(what: str, done: int = 0, total: int = 0) -> None:
    """Say what is being done.

    Args:
        what: the present work, as "reading the bag".
        done: pieces of it that are done.
        total: how many there are; 0 where they are not counted.
    """
    listener = _listener.get()
    if listener is not None:
        listener(what, done, total)


def counted(what: str, items: Iterable[_Item], total: int) -> Iterable[_Item]:
    """The items, telling now and then how many have been taken.

    Args:
        what: as for :func:`tell`.
        items: handed on.
        total: how many there are.
    """
    return items if _listener.get() is None else _counting(what, items, total)


def _counting(what: str, items: Iterable[_Item], total: int) -> Iterator[_Item]:
    for number, item in enumerate(items):
        if number % _EACH == 0:
            tell(what, min(number, total), total)
        yield item
    tell(what, total, total)


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Listen to the work that is done in the block, on this thread."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)
