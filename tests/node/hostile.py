"""What strangers may send to a page's port: none of it is allowed to reach the bench."""

from __future__ import annotations

import asyncio
import contextlib
import socket

import aiohttp

_HEADERS: list[dict[str, str]] = [
    {},
    {"Origin": "http://evil.example"},
    {"Origin": "null"},
    {"Host": "evil.example"},
    {"Host": "evil.example", "Origin": "http://evil.example"},
    {"Origin": "http://localhost:1"},
    {"Cookie": "nmt_page_1=x"},
]
_BODIES = (b"", b'{"act":"end"}', b"[" * 5000, b"\x00" * 1_000_000)
_PATIENCE = aiohttp.ClientTimeout(total=10.0)


async def harass(address: str, used_key: str, connections: int = 500) -> tuple[int, set[int]]:
    """Send some two hundred hostile requests, and open connections that say nothing or half of something.

    Args:
        address: of the page, ``http://127.0.0.1:PORT``.
        used_key: address with a key that is used before.
        connections: that are opened and left.

    Returns:
        Number of requests, and every status that answered one.
    """
    key = used_key.removeprefix(address)
    host, _, port = address.removeprefix("http://").partition(":")
    count, statuses = 0, set()
    async with aiohttp.ClientSession(cookie_jar=aiohttp.DummyCookieJar(), timeout=_PATIENCE) as client:

        async def ask(method: str, path: str, **what: object) -> None:
            nonlocal count
            count += 1
            with contextlib.suppress(aiohttp.ClientError, asyncio.TimeoutError, OSError):
                async with client.request(method, address + path, **what) as answer:
                    statuses.add(answer.status)

        await ask("GET", key, allow_redirects=False)  # somebody uses the key
        assert statuses == {303}
        statuses.clear()
        for headers in _HEADERS:
            for path in ("/steer", "/start", "/replay", "/stop"):
                await asyncio.gather(*(ask("POST", path, data=body, headers=headers) for body in _BODIES))
            for path in ("/live", "/steer", "/stop", "/start", "/static/%2e%2e/guard.py"):
                await ask("GET", path, headers=headers)
        own = {"Origin": address}
        for order in ('{"act":"end"}', '{"levels":"9"}'):
            for path in ("/steer", "/start"):
                for _ in range(10):
                    await ask("POST", path, data=order, headers={**own, "Content-Type": "application/json"})
        for _ in range(10):
            await ask("GET", key)
        for method in ("PUT", "DELETE", "OPTIONS", "TRACE", "PATCH"):
            await ask(method, "/stop", headers=own)
    silent = []
    for number in range(connections):
        stranger = socket.socket()
        stranger.setblocking(False)
        stranger.connect_ex((host, int(port)))
        silent.append(stranger)
        if number % 50 == 0:
            await asyncio.sleep(0.01)
            for half in silent[-40::8]:
                with contextlib.suppress(OSError):
                    half.send(b"POST /stop HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 1000000\r\n")
    await asyncio.sleep(1.0)
    for stranger in silent:
        stranger.close()
    return count, statuses
