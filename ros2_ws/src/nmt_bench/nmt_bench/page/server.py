"""The page's server: one HTML page, its files, one WebSocket with frames, and the requests to steer."""

from __future__ import annotations

import asyncio
import contextlib
import html
import json
import socket
import time
from collections.abc import Awaitable, Callable
from dataclasses import asdict
from importlib import resources
from typing import Any, Protocol

from aiohttp import WSCloseCode, WSMsgType, web

from nmt_bench.page.bench_link import BenchLink, ServiceAnswer
from nmt_bench.page.door import Door
from nmt_bench.page.frames import write_frame
from nmt_bench.page.guard import Guard, Role
from nmt_bench.page.start_goal import start_form, start_request
from nmt_bench.page.stop_door import StopDoor
from nmt_bench.page.task_view import TaskView
from nmt_core.errors import BenchError
from nmt_core.vocabulary import SteeringAct
from nmt_sequencer.level_plan import check_levels
from nmt_sequencer.steering import PRESENT_LEVEL, SteeringRequest

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]

_SPECTRUM_EVERY = 5  # frames
_MOST_VIEWERS = 16
_LARGEST_BODY = 16_384  # bytes
_BODY_PATIENCE = 5.0  # s
_FULL = 256_000  # bytes on the way to a viewer, beyond which frames are left out for it
_STUCK = 15.0  # s of that until the viewer is let go
_FILES = {
    "page.js": "text/javascript",
    "stop.js": "text/javascript",
    "task.js": "text/javascript",
    "uPlot.iife.min.js": "text/javascript",
    "page.css": "text/css",
    "uPlot.min.css": "text/css",
    "uPlot.LICENSE": "text/plain",
}


class PageSource(Protocol):
    """What the frames are made of; see :class:`nmt_bench.page.live_view.LiveView`."""

    FRAME_PERIOD: float
    """s between two frames."""
    PAGE: str
    """Name of the HTML page that shows them."""
    version: int
    """Counts what has changed in the facts."""

    def facts(self) -> bytes:
        """The frame of lasting content."""

    def live(self, since: int, spectrum: bool = True) -> bytes:
        """The frame of changing content."""

    def newest_stretch(self) -> int:
        """Number of the newest stretch of the strips."""


class Player:
    """What the slider of a replay moves; see :class:`nmt_bench.page.bag_player.BagPlayer`."""

    def control(self, order: dict[str, Any]) -> None:
        """Take an order of the page."""
        raise NotImplementedError

    def state(self) -> dict[str, Any]:
        """Position (s), duration (s), whether it plays, and its speed."""
        raise NotImplementedError


class PageServer:
    """Serves the page on 127.0.0.1.

    Args:
        view: what is shown.
        link: way to the bench.
        port: 0 = a free one.
        player: of a replay, else None.

    Attributes:
        guard: keys and sessions.
        door: bounds of connections.
        stop_door: the way of the emergency stop.
        refused: requests turned away.

    Raises:
        BenchError: the port is taken.
    """

    def __init__(self, view: PageSource, link: BenchLink, port: int = 0, player: Player | None = None) -> None:
        self.view, self.link, self.player = view, link, player
        try:
            self._socket = socket.create_server(("127.0.0.1", port), backlog=128)
        except OSError as error:
            raise BenchError(
                f"Port {port} of this host cannot be used ({error.strerror}); choose another with --port."
            ) from error
        self.guard = Guard(self._socket.getsockname()[1])
        self.stop_door = StopDoor(link.emergency_stop, self.guard.own_page)
        self.refused = 0
        self._viewers: dict[web.WebSocketResponse, _Viewer] = {}
        self._files = {name: _file(name) for name in (*_FILES, view.PAGE)}

    @property
    def steer_address(self) -> str:
        """Address that lets steer; works once."""
        return f"{self.guard.origin}/?key={self.guard.steer_key}"

    @property
    def watch_address(self) -> str:
        """Address that lets watch."""
        return f"{self.guard.origin}/?key={self.guard.watch_key}"

    async def start(self) -> None:
        """Listen, and send frames."""
        application = web.Application(middlewares=[self._guarded], client_max_size=_LARGEST_BODY)
        application.on_response_prepare.append(self._protect)
        application.add_routes(
            [
                web.get("/", self._page),
                web.get("/static/{name}", self._static),
                web.get("/live", self._live),
                web.post("/steer", self._steer),
                web.post("/start", self._start),
                web.post("/stop", self._stop),
                web.post("/replay", self._replay),
                web.post("/answer", self._answered),
            ]
        )
        self._runner = web.AppRunner(application, access_log=None, keepalive_timeout=15.0, handle_signals=False)
        await self._runner.setup()
        assert self._runner.server is not None
        self.door = Door(self._runner.server)
        self.listening = await asyncio.get_running_loop().create_server(self.door, sock=self._socket)
        self._sending = asyncio.get_running_loop().create_task(self._send_frames())

    async def close(self) -> None:
        """Close every connection and listen no more."""
        self._sending.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await self._sending
        self.listening.close()
        for socket_ in list(self._viewers):
            with contextlib.suppress(Exception):
                await asyncio.wait_for(socket_.close(code=WSCloseCode.GOING_AWAY), 1.0)
        await self._runner.cleanup()
        self.stop_door.close()

    # -- the guard -----------------------------------------------------------------------------------------------

    @web.middleware
    async def _guarded(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        if not self.guard.right_host(request.headers.get("Host")):
            return self._refuse(403, "This server answers to its own address only.")
        if request.method not in ("GET", "HEAD", "POST"):
            return self._refuse(405, "Not a method of this server.")
        changes = request.method == "POST" or request.path == "/live"
        if changes and not self.guard.own_page(request.headers.get("Origin")):
            return self._refuse(403, "Only the page of this server may ask for this.")
        session = request.cookies.get(self.guard.cookie, "")
        if request.path != "/stop" and not self.guard.requests(session).take():
            return self._refuse(429, "Too many requests.")
        try:
            return await handler(request)
        except web.HTTPException as error:
            self.refused += error.status >= 400
            return web.Response(status=error.status, text=error.reason)

    def _refuse(self, status: int, sentence: str) -> web.Response:
        self.refused += 1
        return web.Response(status=status, text=sentence)

    async def _protect(self, request: web.Request, response: web.StreamResponse) -> None:
        stop = f"http://{self.stop_door.host}"
        response.headers.update(
            {
                "Content-Security-Policy": (
                    f"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
                    f"connect-src 'self' ws://{self.guard.host} {stop}; form-action 'self' {stop}; frame-src {stop}; "
                    "base-uri 'none'; frame-ancestors 'none'"
                ),
                "X-Content-Type-Options": "nosniff",
                "X-Frame-Options": "DENY",
                "Referrer-Policy": "strict-origin",
                "Cross-Origin-Resource-Policy": "same-origin",
                "Cross-Origin-Opener-Policy": "same-origin",
                "Cache-Control": "no-store",
            }
        )
        response.headers.pop("Server", None)

    def _role(self, request: web.Request) -> Role:
        return self.guard.role(request.cookies.get(self.guard.cookie, ""))

    # -- the page ------------------------------------------------------------------------------------------------

    async def _page(self, request: web.Request) -> web.StreamResponse:
        key = request.query.get("key")
        if key is not None:
            session = self.guard.exchange(key)
            if not session:
                return self._refuse(
                    403, "This address has been used, or is not one of this start. The terminal shows the address."
                )
            response = web.Response(status=303, headers={"Location": "/"})
            response.set_cookie(self.guard.cookie, session, httponly=True, samesite="Strict", path="/")
            return response
        role = self._role(request)
        if role is Role.NOBODY:
            return self._refuse(403, "Open the address that the terminal shows.")
        text = self._files[self.view.PAGE].decode().replace("{{start}}", start_form())
        for name, value in (
            ("{{role}}", "replay" if self.player is not None else role.value),
            ("{{stop}}", self.stop_door.address),
        ):
            text = text.replace(name, html.escape(value, quote=True))
        return web.Response(text=text, content_type="text/html")

    async def _static(self, request: web.Request) -> web.StreamResponse:
        name = request.match_info["name"]
        if name not in _FILES:
            return self._refuse(404, "No such file.")
        return web.Response(body=self._files[name], content_type=_FILES[name], charset="utf-8")

    # -- orders --------------------------------------------------------------------------------------------------

    async def _order(self, request: web.Request) -> dict[str, Any]:
        session = request.cookies.get(self.guard.cookie, "")
        if self.guard.role(session) is not Role.STEER:
            raise web.HTTPForbidden
        if not self.guard.orders(session).take():
            raise web.HTTPTooManyRequests
        if request.content_type != "application/json":
            raise web.HTTPUnsupportedMediaType
        try:
            order = json.loads(await asyncio.wait_for(request.read(), _BODY_PATIENCE))
        except asyncio.TimeoutError as error:
            raise web.HTTPRequestTimeout from error
        except (ValueError, RecursionError) as error:
            raise web.HTTPBadRequest from error
        if not isinstance(order, dict):
            raise web.HTTPBadRequest
        return order

    async def _steer(self, request: web.Request) -> web.StreamResponse:
        order = await self._order(request)
        try:
            asked = steering_request(order)
        except (BenchError, ValueError, TypeError, OverflowError) as error:
            return _answer(ServiceAnswer(False, str(error)[:300]), 400)
        return _answer(await self.link.steer(asked))

    async def _start(self, request: web.Request) -> web.StreamResponse:
        order = await self._order(request)
        try:
            asked = start_request(order)
        except BenchError as error:
            return _answer(ServiceAnswer(False, str(error)[:300].rstrip(".")), 400)
        return _answer(await self.link.start(asked))

    async def _stop(self, request: web.Request) -> web.StreamResponse:
        """The emergency stop on this socket too: needs no session, see :mod:`nmt_bench.page.guard`."""
        self.link.emergency_stop()
        return _answer(ServiceAnswer(True, "Emergency stop requested."))

    async def _replay(self, request: web.Request) -> web.StreamResponse:
        order = await self._order(request)
        if self.player is None:
            raise web.HTTPNotFound
        self.player.control(order)
        return _answer(ServiceAnswer(True, ""))

    async def _answered(self, request: web.Request) -> web.StreamResponse:
        """What a person answers to a command that asks."""
        order = await self._order(request)
        view = self.view
        if not isinstance(view, TaskView):
            raise web.HTTPNotFound
        answer = view.answer(order.get("answer"))
        return _answer(answer, 200 if answer.taken else 400)

    # -- frames --------------------------------------------------------------------------------------------------

    async def _live(self, request: web.Request) -> web.StreamResponse:
        if self._role(request) is Role.NOBODY:
            raise web.HTTPForbidden
        if len(self._viewers) >= _MOST_VIEWERS:
            raise web.HTTPServiceUnavailable
        response = web.WebSocketResponse(max_msg_size=1024, compress=False, heartbeat=20.0)
        await response.prepare(request)
        transport = request.transport
        if transport is None:
            return response
        transport.set_write_buffer_limits(high=8 * _FULL)
        await response.send_bytes(self.view.facts())
        await response.send_bytes(self.view.live(0))
        self._viewers[response] = _Viewer(transport)
        try:
            async for message in response:
                if message.type in (WSMsgType.TEXT, WSMsgType.BINARY):
                    await response.close(code=WSCloseCode.POLICY_VIOLATION)  # nothing is asked for on this way
        finally:
            self._viewers.pop(response, None)
        return response

    async def _send_frames(self) -> None:
        number, version, since = 0, -1, 0
        due = time.monotonic()
        while True:
            due = max(due + self.view.FRAME_PERIOD, time.monotonic())
            await asyncio.sleep(due - time.monotonic())
            if not self._viewers:
                since = max(0, self.view.newest_stretch())
                continue
            number += 1
            frames = []
            if self.view.version != version and number % 2 == 0:
                version = self.view.version
                frames.append(self.view.facts())
            newest = self.view.newest_stretch()
            if newest < since:  # a replay has gone back, or another run has begun
                since = 0
            frames.append(self.view.live(since, number % _SPECTRUM_EVERY == 0))
            since = max(0, newest)
            if self.player is not None and number % 2 == 0:
                frames.append(write_frame({"kind": "player", **self.player.state()}, {}))
            await self._broadcast(frames)

    async def _broadcast(self, frames: list[bytes]) -> None:
        for response, viewer in list(self._viewers.items()):
            waiting = viewer.transport.get_write_buffer_size()
            if waiting <= _FULL:
                viewer.full_since = None
                try:
                    for frame in frames:
                        await response.send_bytes(frame)
                except (ConnectionError, RuntimeError):
                    self._viewers.pop(response, None)
                continue
            now = time.monotonic()
            viewer.full_since = viewer.full_since or now
            if now - viewer.full_since > _STUCK:
                self._viewers.pop(response, None)
                viewer.transport.abort()


class _Viewer:
    def __init__(self, transport: Any) -> None:
        self.transport = transport
        self.full_since: float | None = None


def _answer(answer: ServiceAnswer, status: int = 200) -> web.Response:
    return web.json_response(asdict(answer), status=status)


def steering_request(order: dict[str, Any]) -> SteeringRequest:
    """The request that an order of the page asks for.

    Raises:
        BenchError, ValueError, TypeError: it is not a request.
    """
    unknown = set(order) - {"act", "level_index", "levels"}
    if unknown:
        raise BenchError(f"A request to steer has no '{sorted(unknown)[0][:40]}'.")
    levels = order.get("levels", [])
    if not isinstance(levels, list):
        raise BenchError("The levels must be a list of numbers.")
    if levels:
        levels = check_levels(levels, "The levels to come")
    index = order.get("level_index", PRESENT_LEVEL)
    if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index <= PRESENT_LEVEL:
        raise BenchError("The number of a level must be a whole number from 0.")
    act = SteeringAct.named(str(order.get("act"))[:40])
    return SteeringRequest(act, index, tuple(levels), source="the live page")


def _file(name: str) -> bytes:
    return resources.files("nmt_bench.page").joinpath("static", name).read_bytes()
