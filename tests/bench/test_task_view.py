"""The page of an investigation: what it tells, through the pipe; and runs that a page asks for."""

from __future__ import annotations

import asyncio
import json
import os
from types import SimpleNamespace
from typing import Any

import aiohttp
import pytest
from bench.frame_reader import read_frame

from nmt_bench.page.start_goal import StartRequest, goal_of, start_request
from nmt_bench.page.task_feed import TaskFeed, task_page
from nmt_bench.page.task_view import TaskView
from nmt_core.errors import BenchError
from nmt_core.messages.run_settings import RunSettings
from nmt_core.vocabulary import TestKind


def heads(view: TaskView) -> tuple[dict[str, Any], dict[str, Any]]:
    return read_frame(view.facts())[0], read_frame(view.live(0))[0]


def test_what_a_command_tells_arrives_with_its_times() -> None:
    now = [0.0]
    view = TaskView(lambda _: None, lambda: now[0])
    reading, writing = os.pipe()
    feed = TaskFeed(writing)
    with os.fdopen(reading, "rb") as pipe:
        feed.tell(title="Investigation of beam")
        feed.step("reading")
        feed.step("fitting gap@7")
        for _ in range(3):
            view.take_line(pipe.readline())
        now[0] = 10.0
        feed.step("fitting cubic@3")
        feed.table(("explanation", "ln"), [("gap@7", "best"), ("none", "40.0 behind")])
        for _ in range(2):
            view.take_line(pipe.readline())
        now[0] = 20.0
        facts, live = heads(view)
        os.close(writing)
    assert facts["title"] == "Investigation of beam"
    assert [step["text"] for step in facts["steps"]] == ["reading", "fitting gap@7", "fitting cubic@3"]
    assert [step["took"] for step in facts["steps"]] == ["0.0\u202fs", "10.0\u202fs", ""]
    assert facts["rows"] == [["gap@7", "best"], ["none", "40.0 behind"]]
    assert live["present"] == "fitting cubic@3"
    view.end()
    assert "has ended" in heads(view)[0]["outcome"]


@pytest.mark.parametrize("line", [b"", b"[1]", b"{", b'{"step": 3, "done": "x", "total": [], "rows": {}}', b"[" * 9999])
def test_strange_lines_break_nothing(line: bytes) -> None:
    view = TaskView(lambda _: None)
    view.take_line(line)
    json.dumps(heads(view))


def test_a_page_that_is_gone_or_hangs_stops_no_command() -> None:
    reading, writing = os.pipe()
    feed = TaskFeed(writing)
    for number in range(20_000):  # nobody reads
        feed.step(f"step {number}")
    os.close(reading)
    feed.step("nobody is there")
    os.close(writing)
    TaskFeed().step("no page")


def test_a_run_from_the_page_is_the_run_before_with_other_levels() -> None:
    asked = start_request({"levels": "0.2:0.8:3", "window_periods": 50})
    assert asked.levels == pytest.approx((0.2, 0.4, 0.8))
    before = {
        "control": 3,
        "ramp": 0.5,
        "window_periods": 200,
        "test": "sweep",
        "frequencies_hz": [18.0],
        "pacing": "x",
    }
    goal = goal_of(asked, before)
    assert goal["test"] == TestKind.SWEEP
    assert (goal["control"], goal["window_periods"], goal["frequencies_hz"]) == (3, 50, [18.0] * 3)
    assert "pacing" not in goal
    assert goal_of(StartRequest((0.1,)), {}) == RunSettings(levels=(0.1,)).goal
    with pytest.raises(BenchError, match="ask for as many levels"):
        goal_of(asked, {"frequencies_hz": [18.0, 19.0]})
    for order in (
        {},
        {"levels": 3},
        {"levels": "a"},
        {"levels": "1", "act": "end"},
        {"levels": "1", "window_periods": -1},
    ):
        with pytest.raises(BenchError):
            start_request(order)


def test_a_new_run_may_have_other_harmonics_controlled():
    before = {"levels": [0.1], "test": "phase_resonance", "harmonics_control": 9, "harmonics_target": 1}
    for words, wanted in (("", 9), ("auto", 1), ("0", 0), ("7", 7)):
        goal = goal_of(start_request({"levels": "0.2", "harmonics": words}), before)
        assert goal["harmonics_control"] == wanted
        assert goal["harmonics_target"] == 1
    for words in ("1", "51", "-2", "many", 3.5):
        with pytest.raises(BenchError, match="number from 2 to 50"):
            start_request({"levels": "0.2", "harmonics": words})


def test_a_command_serves_its_progress_in_a_process_of_its_own() -> None:
    lines: list[str] = []
    console = SimpleNamespace(print=lambda line, **_: lines.append(line))

    async def watch() -> dict[str, Any]:
        origin, _, _ = address.partition("/?")
        async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as client:
            async with client.get(address) as answer:
                assert "task.js" in await answer.text()
            async with client.ws_connect(f"{origin}/live", headers={"Origin": origin}) as live:
                async for message in live:
                    head, _ = read_frame(message.data)
                    if head["kind"] == "task" and head["rows"]:
                        return head
        raise AssertionError("the page has ended")

    with task_page(True, "Investigation of beam", console) as page:
        address = lines[1].partition(": ")[2]
        page.step("reading")
        page.step("fitting gap@7")
        page.table(("explanation", "ln"), [("cubic_stiffness@3", "best"), ("gap@7", "12.3 behind")])
        head = asyncio.run(asyncio.wait_for(watch(), 60.0))
    assert [step["text"] for step in head["steps"]] == ["reading", "fitting gap@7"]
    assert head["rows"] == [["cubic_stiffness@3", "best"], ["gap@7", "12.3 behind"]]
    with task_page(False, "none", console) as page:
        page.step("nobody is told")
    assert len(lines) == 2
