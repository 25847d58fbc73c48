"""Bounds what strangers can do with mere connections: how many there are, and how long one may say nothing."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

_HEAD_END = b"\r\n\r\n"


class Door:
    """Makes the protocols of a listening socket, each of which is cut off if it does not ask for anything in time.

    Args:
        factory: makes the protocol behind the door.
        most: connections at the same time; those beyond are closed at once.
        patience: s until the first request must be complete.
        largest_head: bytes that a request may have before its end is seen.
    """

    def __init__(
        self, factory: Callable[[], Any], most: int = 64, patience: float = 5.0, largest_head: int = 16_384
    ) -> None:
        self._factory = factory
        self.most = most
        self.patience = patience
        self.largest_head = largest_head
        self.open = 0

    def __call__(self) -> asyncio.Protocol:
        """The protocol of a new connection."""
        return _Visitor(self, self._factory())


class _Visitor(asyncio.Protocol):
    """One connection: passes everything on, once it may stay."""

    def __init__(self, door: Door, inner: Any) -> None:
        self._door, self._inner = door, inner
        self._admitted = False
        self._tail = b""
        self._seen = 0
        self._timer: asyncio.TimerHandle | None = None
        self._transport: Any = None

    def connection_made(self, transport: Any) -> None:
        self._transport = transport
        if self._door.open >= self._door.most:
            transport.abort()
            return
        self._door.open += 1
        self._admitted = True
        self._timer = asyncio.get_running_loop().call_later(self._door.patience, transport.abort)
        self._inner.connection_made(transport)

    def data_received(self, data: bytes) -> None:
        if not self._admitted:
            return
        if self._timer is not None:
            self._seen += len(data)
            if _HEAD_END in self._tail + data:
                self._timer.cancel()
                self._timer = None
            elif self._seen > self._door.largest_head:
                self._transport.abort()
                return
            self._tail = (self._tail + data)[-3:]
        self._inner.data_received(data)

    def eof_received(self) -> Any:
        return self._inner.eof_received() if self._admitted else None

    def pause_writing(self) -> None:
        if self._admitted:
            self._inner.pause_writing()

    def resume_writing(self) -> None:
        if self._admitted:
            self._inner.resume_writing()

    def connection_lost(self, error: Exception | None) -> None:
        if self._timer is not None:
            self._timer.cancel()
        if self._admitted:
            self._admitted = False
            self._door.open -= 1
            self._inner.connection_lost(error)
