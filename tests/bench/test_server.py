"""The page's server against strangers: nothing they send reaches the bench; a stop from the page always does."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

import aiohttp
import numpy as np
import pytest
from bench.frame_reader import read_frame

from nmt_bench.page.bench_link import ServiceAnswer, StartRequest
from nmt_bench.page.door import Door
from nmt_bench.page.live_view import LiveView
from nmt_bench.page.server import PageServer
from nmt_core.errors import BenchError
from nmt_core.messages.blocks import OscillatorPhase, SampleBlock
from nmt_core.vocabulary import Quantity, SteeringAct
from nmt_sequencer.steering import SteeringRequest


class FakeBench:
    def __init__(self) -> None:
        self.asked: list[SteeringRequest] = []
        self.started: list[StartRequest] = []
        self.stops = 0

    async def steer(self, request: SteeringRequest) -> ServiceAnswer:
        self.asked.append(request)
        return ServiceAnswer(True, "taken")

    async def start(self, request: StartRequest) -> ServiceAnswer:
        self.started.append(request)
        return ServiceAnswer(True, "begun")

    def emergency_stop(self) -> None:
        self.stops += 1

    @property
    def touched(self) -> bool:
        return bool(self.asked or self.started or self.stops)


@asynccontextmanager
async def page(view: LiveView | None = None) -> AsyncIterator[tuple[PageServer, FakeBench, aiohttp.ClientSession]]:
    bench = FakeBench()
    server = PageServer(view or LiveView(), bench)
    await server.start()
    try:
        async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as client:
            yield server, bench, client
    finally:
        await server.close()


def run(test: Callable[[], Awaitable[None]]) -> None:
    asyncio.run(asyncio.wait_for(test(), 60.0))


async def log_in(server: PageServer, client: aiohttp.ClientSession) -> dict[str, str]:
    async with client.get(server.steer_address) as answer:
        assert answer.status == 200
        assert str(answer.url) == f"{server.guard.origin}/"
    return {"Origin": server.guard.origin}


def test_the_page_steers_and_stops() -> None:
    async def test() -> None:
        async with page() as (server, bench, client):
            own = await log_in(server, client)
            async with client.post(f"{server.guard.origin}/steer", json={"act": "pause"}, headers=own) as answer:
                assert await answer.json() == {"taken": True, "message": "taken"}
            assert [request.act for request in bench.asked] == [SteeringAct.PAUSE]
            order = {"levels": "0.1, 0.2"}
            async with client.post(f"{server.guard.origin}/start", json=order, headers=own) as answer:
                assert await answer.json() == {"taken": True, "message": "begun"}
            assert bench.started == [StartRequest((0.1, 0.2))]
            for number, address in enumerate((server.stop_door.address, f"{server.guard.origin}/stop"), start=1):
                async with client.post(address, headers=own) as answer:
                    assert answer.status == 200
                assert bench.stops == number

    run(test)


def test_stopping_needs_no_session() -> None:
    async def test() -> None:
        async with page() as (server, bench, client):
            async with client.post(server.stop_door.address, headers={"Origin": server.guard.origin}) as answer:
                assert answer.status == 200
                assert answer.headers["Access-Control-Allow-Origin"] == server.guard.origin
            assert bench.stops == 1

    run(test)


def test_the_stop_answers_while_the_server_is_stuck() -> None:
    async def test() -> None:
        async with page() as (server, bench, _):
            request = f"POST /stop HTTP/1.1\r\nHost: {server.stop_door.host}\r\nOrigin: {server.guard.origin}\r\n\r\n"
            # Nothing is awaited from here on: the server's loop stands still.
            with socket.create_connection(("127.0.0.1", int(server.stop_door.host.split(":")[1])), 5.0) as connection:
                connection.sendall(request.encode())
                assert connection.recv(100).startswith(b"HTTP/1.1 200")
            assert bench.stops == 1

    run(test)


def test_what_is_served_asks_for_nothing_outside_and_is_small() -> None:
    async def test() -> None:
        async with page() as (server, _, client):
            await log_in(server, client)
            total = 0
            for path in ("/", *(f"/static/{name}" for name in server._files if name != "index.html")):
                async with client.get(server.guard.origin + path) as answer:
                    assert answer.status == 200
                    policy = answer.headers["Content-Security-Policy"]
                    assert "unsafe" not in policy
                    assert "default-src 'none'" in policy
                    body = await answer.read()
                    total += len(body)
                    if not path.startswith("/static/uPlot"):
                        assert b"//cdn" not in body
                        assert b"https://" not in body
            assert total < 300_000

    run(test)


HOSTILE_HEADERS: list[dict[str, str]] = [
    {},
    {"Origin": "http://evil.example"},
    {"Origin": "null"},
    {"Origin": "http://localhost:1"},
    {"Host": "evil.example"},
    {"Host": "evil.example", "Origin": "http://evil.example"},
    {"Cookie": "nmt_page_1=x"},
]


def test_two_hundred_hostile_requests_reach_nothing() -> None:
    async def test() -> None:
        async with page() as (server, bench, client):
            used = server.steer_address
            async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as owner:
                await log_in(server, owner)
            origin = server.guard.origin
            count = 0
            for headers in HOSTILE_HEADERS:
                for path in ("/steer", "/start", "/replay", "/stop"):
                    for body in (b"", b'{"act":"pause"}', b"[" * 5000, b"\x00" * 1_000_000):
                        statuses = []
                        try:
                            async with client.post(origin + path, data=body, headers=headers) as answer:
                                statuses.append(answer.status)
                        except aiohttp.ClientError:
                            statuses.append(400)
                        assert min(statuses) >= 400, (headers, path)
                        count += 1
                for path in ("/live", "/", "/steer", "/stop", "/static/../server.py", "/static/%2e%2e/guard.py"):
                    try:
                        async with client.get(origin + path, headers=headers) as answer:
                            assert answer.status >= 400, (headers, path)
                    except aiohttp.ClientError:
                        pass
                    count += 1
            # With the right origin, but no session, or a key that is used up.
            for _ in range(40):
                async with client.post(f"{origin}/steer", json={"act": "end"}, headers={"Origin": origin}) as answer:
                    assert answer.status in (403, 429)
                async with client.get(used) as answer:
                    assert answer.status in (403, 429)
                count += 2
            for method in ("PUT", "DELETE", "OPTIONS", "TRACE", "PATCH"):
                async with client.request(method, f"{origin}/stop", headers={"Origin": origin}) as answer:
                    assert answer.status == 405
                count += 1
            assert count > 200
            assert not bench.touched

    run(test)


def test_who_may_only_watch_cannot_steer() -> None:
    async def test() -> None:
        async with page() as (server, bench, client):
            async with client.get(server.watch_address) as answer:
                text = await answer.text()
                assert 'data-role="watch"' in text
                assert '<input id="start-levels" name="levels"' in text
            own = {"Origin": server.guard.origin}
            async with client.post(f"{server.guard.origin}/steer", json={"act": "end"}, headers=own) as answer:
                assert answer.status == 403
            order = {"levels": "9"}
            async with client.post(f"{server.guard.origin}/start", json=order, headers=own) as answer:
                assert answer.status == 403
            async with client.ws_connect(f"{server.guard.origin}/live", headers=own) as live:
                head, _ = read_frame((await live.receive()).data)
                assert head["kind"] == "facts"
            assert not bench.touched

    run(test)


def test_nothing_is_taken_by_the_socket_of_the_frames() -> None:
    async def test() -> None:
        async with page() as (server, bench, client):
            own = await log_in(server, client)
            for message in ('{"act":"pause"}', "x" * 1_000_000):
                async with client.ws_connect(f"{server.guard.origin}/live", headers=own, max_msg_size=0) as live:
                    await live.send_str(message)
                    async for _ in live:
                        pass
                    assert live.close_code in (1008, 1009)
            assert not bench.touched

    run(test)


def test_orders_come_at_a_limited_rate_and_stops_do_not() -> None:
    async def test() -> None:
        async with page() as (server, bench, client):
            own = await log_in(server, client)
            stranger = {**own, "Cookie": f"{server.guard.cookie}=somebody"}
            async with aiohttp.ClientSession() as other:
                for _ in range(450):
                    async with other.post(f"{server.guard.origin}/steer", json={}, headers=stranger) as answer:
                        assert answer.status in (403, 429)
            statuses = []
            for _ in range(40):
                async with client.post(f"{server.guard.origin}/steer", json={"act": "pause"}, headers=own) as answer:
                    statuses.append(answer.status)
            assert statuses[:8] == [200] * 8  # whatever a stranger has sent
            assert 429 in statuses
            assert len(bench.asked) < 40
            for _ in range(60):
                async with client.post(server.stop_door.address, headers=own) as answer:
                    assert answer.status == 200
            assert bench.stops == 60

    run(test)


def test_bad_orders_of_the_page_are_refused_with_a_sentence() -> None:
    async def test() -> None:
        async with page() as (server, bench, client):
            own = await log_in(server, client)
            address = f"{server.guard.origin}/steer"
            async with client.post(address, json={"act": "explode"}, headers=own) as answer:
                assert answer.status == 400
                assert "cannot be steered by 'explode'" in (await answer.json())["message"]
            for data, kind in ((b"{", "application/json"), (b"[]", "application/json"), (b"{}", "text/plain")):
                async with client.post(address, data=data, headers={**own, "Content-Type": kind}) as answer:
                    assert answer.status in (400, 415)
            assert not bench.touched

    run(test)


def test_five_hundred_connections_that_say_nothing_do_not_keep_the_page_out() -> None:
    async def test() -> None:
        async with page() as (server, bench, client):
            server.door.patience = 0.5
            silent = []
            for number in range(500):
                port = int((server.guard.host if number % 2 else server.stop_door.host).split(":")[1])
                connection = socket.socket()
                connection.setblocking(False)
                connection.connect_ex(("127.0.0.1", port))
                silent.append(connection)
                if number % 50 == 0:
                    await asyncio.sleep(0)
            await asyncio.sleep(0.1)
            assert server.door.open <= server.door.most
            while server.door.open:
                await asyncio.sleep(0.05)
            own = await log_in(server, client)
            loop = asyncio.get_running_loop()
            end = loop.time() + 10.0
            while (
                not bench.stops
            ):  # a connection that is turned away is tried again, as the page does by its second way
                assert loop.time() < end
                try:
                    async with client.post(server.stop_door.address, headers=own) as answer:
                        assert answer.status == 200
                except aiohttp.ClientError:
                    await asyncio.sleep(0.1)
            for connection in silent:
                connection.close()

    run(test)


def test_a_head_without_an_end_is_cut_off() -> None:
    class Inner(asyncio.Protocol):
        received = 0

        def data_received(self, data: bytes) -> None:
            Inner.received += len(data)

    async def test() -> None:
        door = Door(Inner, largest_head=1000)
        server = await asyncio.get_running_loop().create_server(door, "127.0.0.1", 0)
        reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
        writer.write(b"GET / HTTP/1.1\r\nX: " + b"a" * 5000)
        with contextlib.suppress(ConnectionError):
            assert await reader.read() == b""
        assert Inner.received <= 1000
        writer.close()
        server.close()
        await asyncio.sleep(0.05)
        assert door.open == 0

    run(test)


def test_a_viewer_that_does_not_read_keeps_nobody_waiting() -> None:
    view = LiveView()

    def feed(first: int) -> None:
        data = np.sin(0.1 * np.arange(first, first + 200))[np.newaxis]
        view.take(SampleBlock(first, 10_000.0, Quantity.FORCE, "N", ("f",), (1,), data, OscillatorPhase(0.0, 20.0)))

    async def test() -> None:
        async with page(view) as (server, _, client):
            own = await log_in(server, client)
            feed(0)
            cookies = "; ".join(f"{item.key}={item.value}" for item in client.cookie_jar)
            host, port = server.guard.host.split(":")
            deaf = socket.create_connection((host, int(port)))
            deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            deaf.sendall(
                f"GET /live HTTP/1.1\r\nHost: {server.guard.host}\r\nOrigin: {own['Origin']}\r\nCookie: {cookies}\r\n"
                "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
                "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
            )
            async with client.ws_connect(f"{server.guard.origin}/live", headers=own, max_msg_size=0) as live:
                frames = 0
                while frames < 60:
                    feed(200 * (frames + 1))
                    head, _ = read_frame((await live.receive()).data)
                    frames += head["kind"] == "live"
            deaf.close()

    run(test)


def test_a_port_in_use_is_refused_with_a_sentence() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(BenchError, match="choose another with --port"):
        PageServer(LiveView(), FakeBench(), taken.getsockname()[1])


def test_it_listens_on_loopback_alone() -> None:
    async def test() -> None:
        async with page() as (server, _, _client):
            found: list[Any] = [item.getsockname()[0] for item in server.listening.sockets]
            assert found == ["127.0.0.1"]

    run(test)
