"""The way of the emergency stop: its own socket and thread, a few lines, nothing of the page in between.

It answers while the page's server is stuck. A request is ``POST /stop`` from a page of this very server; no key is
asked for. Connections that say nothing are cut off, and stops are never limited in their rate.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
from collections.abc import Callable

_PATIENCE = 2.0  # s
_MOST = 128
_LARGEST = 8192  # bytes


class StopDoor:
    """Listens on a port of its own of 127.0.0.1 until closed.

    Args:
        stop: called for every stop that is allowed.
        own_page: whether the origin of a request is the page.

    Attributes:
        host: address that requests must name.
        stops: requests taken; refused: requests turned away.
    """

    def __init__(self, stop: Callable[[], None], own_page: Callable[[str | None], bool]) -> None:
        self._stop, self._own_page = stop, own_page
        self.stops = 0
        self.refused = 0
        self._open = 0
        self._socket = socket.create_server(("127.0.0.1", 0), backlog=128)
        self.host = f"127.0.0.1:{self._socket.getsockname()[1]}"
        self._ready = threading.Event()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._serve, name="stop door", daemon=True)
        self._thread.start()
        self._ready.wait()

    @property
    def address(self) -> str:
        """Where a stop is posted to."""
        return f"http://{self.host}/stop"

    def close(self) -> None:
        """Listen no more."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(timeout=5.0)

    def _serve(self) -> None:
        asyncio.set_event_loop(self._loop)
        server = self._loop.run_until_complete(asyncio.start_server(self._visit, sock=self._socket, limit=_LARGEST))
        self._ready.set()
        try:
            self._loop.run_forever()
        finally:
            server.close()
            for task in asyncio.all_tasks(self._loop):
                task.cancel()
            self._loop.run_until_complete(asyncio.sleep(0))
            self._loop.close()

    async def _visit(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._open += 1
        try:
            if self._open <= _MOST:
                with contextlib.suppress(OSError, asyncio.TimeoutError, asyncio.IncompleteReadError, ValueError):
                    head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), _PATIENCE)
                    writer.write(self._answer(head.decode("latin-1")))
                    await asyncio.wait_for(writer.drain(), _PATIENCE)
        except asyncio.LimitOverrunError:
            self.refused += 1
        finally:
            self._open -= 1
            writer.close()

    def _answer(self, head: str) -> bytes:
        request, *lines = head.split("\r\n")
        fields: dict[str, str] = {}
        for line in lines:
            name, _, value = line.partition(":")
            fields.setdefault(name.strip().lower(), value.strip())
        origin = fields.get("origin")
        allowed = (
            request.split(" ")[:2] == ["POST", "/stop"] and fields.get("host") == self.host and self._own_page(origin)
        )
        if not allowed:
            self.refused += 1
            return _response("403 Forbidden", "A stop is posted by the page of this server alone.")
        self.stops += 1
        self._stop()
        return _response("200 OK", "Emergency stop requested.", f"Access-Control-Allow-Origin: {origin}\r\n")


def _response(status: str, text: str, fields: str = "") -> bytes:
    body = text.encode()
    return (
        f"HTTP/1.1 {status}\r\nContent-Type: text/plain; charset=utf-8\r\nContent-Length: {len(body)}\r\n"
        f"X-Content-Type-Options: nosniff\r\nCache-Control: no-store\r\n{fields}Connection: close\r\n\r\n"
    ).encode() + body
