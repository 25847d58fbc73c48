"""The page of a command that asks: who may answer, when, and what becomes of a stop."""

from __future__ import annotations

import asyncio
import io
import os
import queue
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import aiohttp
import pytest
from bench.frame_reader import read_frame

from nmt_bench.commands.investigate_command import InvestigateOptions, _Bench
from nmt_bench.page.bench_link import NoBench
from nmt_bench.page.live_view import LiveView
from nmt_bench.page.server import PageServer
from nmt_bench.page.task_answers import TaskAnswers
from nmt_bench.page.task_feed import task_page
from nmt_bench.page.task_view import TaskView
from nmt_core.kinds.request import TestRequest
from nmt_diagnose.investigation.investigation_record import AskedTest, InvestigationRecord, Turn


@asynccontextmanager
async def page(view: TaskView | LiveView) -> AsyncIterator[tuple[PageServer, aiohttp.ClientSession]]:
    server = PageServer(view, NoBench())
    await server.start()
    try:
        async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as client:
            yield server, client
    finally:
        await server.close()


def run(test: Callable[[], Awaitable[None]]) -> None:
    asyncio.run(asyncio.wait_for(test(), 60.0))


async def posted(server: PageServer, client: aiohttp.ClientSession, answer: Any, origin: str = "") -> tuple[int, str]:
    headers = {"Origin": origin or server.guard.origin}
    async with client.post(f"{server.guard.origin}/answer", json={"answer": answer}, headers=headers) as response:
        text = await response.text()
        return response.status, (await response.json())["message"] if text.startswith("{") else text


def test_what_is_asked_is_answered_once_and_a_stop_is_always_taken() -> None:
    words: list[str] = []
    view = TaskView(words.append)

    async def test() -> None:
        async with page(view) as (server, client):
            await client.get(server.steer_address)
            assert await posted(server, client, "yes") == (
                400, "Nothing is asked now; it was answered, or a test is under way",
            )  # fmt: skip
            view.take({"question": "mode 2, 12 s: tells one from the other"})
            assert read_frame(view.facts())[0]["question"].startswith("mode 2")
            assert await posted(server, client, "perhaps") == (400, "An answer is one of yes, no, stop")
            assert await posted(server, client, "no") == (200, "The bench searches another one")
            assert (await posted(server, client, "no"))[0] == 400
            assert await posted(server, client, "stop") == (200, "It ends")
            view.take({"outcome": "The cause has a name."})
            assert await posted(server, client, "stop") == (400, "Nothing is asked here")

    run(test)
    assert words == ["no", "stop"]


def test_nobody_else_answers() -> None:
    """Who only watches, pages of others, and pages of other work."""
    words: list[str] = []
    view = TaskView(words.append)
    view.take({"question": "mode 2"})

    async def test() -> None:
        async with page(view) as (server, client):
            assert (await posted(server, client, "yes"))[0] == 403
            await client.get(server.watch_address)
            assert (await posted(server, client, "yes"))[0] == 403
        async with page(view) as (server, client):
            await client.get(server.steer_address)
            assert await posted(server, client, "yes", "http://127.0.0.1:1") == (
                403, "Only the page of this server may ask for this.",
            )  # fmt: skip
        async with page(LiveView()) as (server, client):
            await client.get(server.steer_address)
            assert (await posted(server, client, "yes"))[0] == 404

    run(test)
    assert words == []


def test_the_timeline_takes_points_only() -> None:
    view = TaskView(lambda _: None)
    view.take({"timeline": {"gap": [[10.0, 0.5], [20.0, 0.99], [30.0, 2.0], ["x", 1.0], [1.0]], "none": 3}})
    assert read_frame(view.facts())[0]["timeline"] == {"gap": [[10.0, 0.5], [20.0, 0.99]]}


@pytest.fixture
def pipe() -> Any:
    reading, writing = os.pipe()
    yield SimpleNamespace(reading=reading, say=lambda text: os.write(writing, text.encode()))
    os.close(writing)


def test_answers_come_from_the_page_and_from_the_terminal(pipe: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    stops: queue.Queue[str] = queue.Queue()
    answers = TaskAnswers(pipe.reading, lambda: stops.put("stop"))
    pipe.say("yes\nstop\n")  # nothing is asked: the stop is as Ctrl-C, the yes is of nothing
    assert stops.get(timeout=10.0) == "stop"
    asked, typed = os.pipe()
    with os.fdopen(asked) as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        os.write(typed, b"what\nn\n")
        assert answers.wait("Run it? ") == "no"
        os.close(typed)  # a terminal that has gone leaves the page
        monkeypatch.setattr("sys.stdout", Prompted(lambda: pipe.say("yes\n")))
        assert answers.wait("Run it? ") == "yes"
        assert TaskAnswers().wait("Run it? ") == "stop"


class Prompted(io.StringIO):
    """A terminal that does something when it is asked."""

    def __init__(self, act: Callable[[], object]) -> None:
        super().__init__()
        self._act = act

    def write(self, text: str) -> int:
        self._act()
        return len(text)


def test_a_question_of_an_investigation_reaches_its_page_and_comes_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Through the page's process: the address that steers, the question, the answer, and the growing timeline."""
    lines: list[str] = []
    console = SimpleNamespace(print=lambda text, **more: lines.append(text))
    bench = _Bench(InvestigateOptions(model="beam", out=tmp_path), SimpleNamespace(), 1, console)  # type: ignore[arg-type]
    asked = AskedTest("03_levels", TestRequest(rig="beam"), "the same levels on mode 2", "tells a from b", seconds=12.0)
    turn = Turn(2, 60.0, 9.0, "effect", {"gap": 0.7, "none": 0.3}, "which")
    with task_page(True, "Investigation of beam", console) as bench._feed, open(os.devnull) as nothing:
        bench._answers = TaskAnswers(bench._feed.answers)
        monkeypatch.setattr("sys.stdin", nothing)
        bench._tell_page(InvestigationRecord("beam", "real.yaml", tests=(asked,), turns=(turn,)))

        async def answered() -> dict[str, Any]:
            address = lines[0].split()[-1]
            origin = address.split("/?")[0]
            async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as client:
                await client.get(address)
                async with client.ws_connect(f"{origin}/live", headers={"Origin": origin}) as live:
                    waiting = asyncio.get_running_loop().run_in_executor(None, bench._agree, asked)
                    while True:
                        head = read_frame(await live.receive_bytes(timeout=30.0))[0]
                        if head["kind"] == "task" and head["question"]:
                            break
                order, headers = {"answer": "no"}, {"Origin": origin}
                async with client.post(f"{origin}/answer", json=order, headers=headers) as response:
                    assert response.status == 200
                return head | {"answer": await waiting}

        found = asyncio.run(asyncio.wait_for(answered(), 60.0))
    assert found["answer"] == "no"
    assert found["question"] == "the same levels on mode 2, 12 s: tells a from b."
    assert found["timeline"] == {"gap": [[60.0, 0.7]], "none": [[60.0, 0.3]]}
    assert found["rows"][0][0] == "03_levels"
