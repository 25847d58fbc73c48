"""The live page beside running nodes: what a person does there is in the bag, and its death changes no sample."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import threading
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from node.browser import Browser, find_chromium
from node.hostile import harass
from node.test_session import messages, same
from std_srvs.srv import Trigger

from nmt_bench.harness import Bench
from nmt_bench.page.page_process import ServedPage, page_process
from nmt_core.messages.wire import DRIVE_STOP, STEERING
from nmt_core.vocabulary import ResultCode, SteeringAct, StopCause
from nmt_record.bag.bag_reader import Bag
from nmt_session import Session, plan_test

pytestmark = pytest.mark.node

needs_browser = pytest.mark.skipif(find_chromium() is None, reason="no Chromium is installed; apt install chromium")
SHOWN = "document.getElementById('{}').textContent"


def served(bench: Bench) -> Any:
    arguments = ("--domain", str(bench.domain_id), "--no-reference")
    return page_process(bench.out / "log" / "page.log", arguments)


def address(page: ServedPage) -> str:
    return page.lines[0].partition(": ")[2].strip()


def use(page: ServedPage, bench: Bench, act: Callable[[Browser], Awaitable[None]]) -> None:
    """Use the page in a thread while the nodes work at half speed, so that a slow machine has room for the browser.

    Raises:
        BaseException: what was raised there.
    """
    failures: list[BaseException] = []

    async def browse() -> None:
        async with Browser() as browser:
            await browser.size(1400, 900)
            await browser.open(address(page))
            await act(browser)
            assert browser.errors == []

    def run() -> None:
        try:
            asyncio.run(browse())
        except BaseException as error:
            failures.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    while thread.is_alive():
        bench.spin(0.03)
        time.sleep(0.03)
    thread.join()
    if failures:
        raise failures[0]


@needs_browser
def test_a_person_starts_watches_steers_and_stops(tmp_path: Path) -> None:
    phase, acts = SHOWN.format("phase"), SHOWN.format("acts")
    steps: list[str] = []
    seen: dict[str, float] = {}

    async def first_run(browser: Browser) -> None:
        await browser.until(f"{phase} === 'no run' && !document.getElementById('start').hidden", 60.0)
        await browser.value("document.getElementById('start-levels').value = '0.1:0.1:40'")
        await browser.submit("start")
        await browser.until(f"{phase} === 'running'", 60.0)
        await browser.until("document.querySelectorAll('#points tbody tr td').length > 3", 60.0)
        seen["point"] = time.time()
        assert "no modal point" not in (await browser.text("points")).lower()
        await browser.until("document.querySelectorAll('#channels tbody tr').length > 3")
        await browser.until("document.querySelector('#plot-waves canvas')")
        await browser.until(f"{SHOWN.format('rig')} === 'beam'")  # from the bag that is being written
        await browser.key("p")
        await browser.until(f"{phase} === 'paused'")
        # The level that the page shows is the present one only while none can end: in a run a click may come too late.
        await browser.click("skip")
        await browser.click("pause")
        await browser.until(f"{phase} === 'running'")
        await browser.until(f"{acts}.includes('skipped by the live page')")
        await browser.value("document.getElementById('levels').value = '0.3, 0.3 0.3;0.3'")
        await browser.submit("change")
        await browser.until(f"{acts}.includes('levels to come changed by the live page')")
        await browser.until(f"{SHOWN.format('plan')}.includes('0.3')")
        await browser.value("document.getElementById('repeat-level').value = '0'")
        await browser.key("r")
        await browser.until(f"{acts}.includes('level 1 to be repeated')")
        await browser.click("end")
        await browser.until(f"{phase}.startsWith('ended')", 60.0)
        assert await browser.value("document.getElementById('stop-alarm').hidden")

    async def second_run(browser: Browser) -> None:
        await browser.until("!document.getElementById('start').hidden")
        await browser.value("document.getElementById('start-levels').value = '0.2:0.2:40'")
        await browser.submit("start")
        loop = SHOWN.format("loop")
        await browser.until(f"{phase} === 'running' && ({loop} === 'acquiring' || {loop} === 'locked')", 60.0)
        await browser.key("Escape")
        alarm = SHOWN.format("stop-alarm") + ".toLowerCase()"
        await browser.until(f"{alarm}.includes('emergency stop')")
        await browser.until(f"{phase}.startsWith('ended')", 60.0)
        await browser.until(f"{alarm}.includes('emergency stop by /page. the drive is at zero')")
        steps.append("stopped")
        await asyncio.sleep(4.0)  # by now other alarms have come: silent nodes, the end of the run
        assert "emergency stop" in (await browser.text("stop-alarm")).lower()
        assert not await browser.value("document.getElementById('stop-alarm').hidden")
        assert bench.nodes["plant"].device.stop_cause is StopCause.EMERGENCY_STOP
        steps.append("reset")
        await browser.until("document.getElementById('stop-alarm').hidden")

    async def act(browser: Browser) -> None:
        await first_run(browser)
        await second_run(browser)

    with Bench("beam", [0.1], out=tmp_path / "out", window_periods=200) as bench, served(bench) as page:
        client = bench.nodes["sequencer"].create_client(Trigger, "reset")
        released: list[Any] = []

        class Spinning:
            """The bench, which calls the operator's service when the person asks for it."""

            @staticmethod
            def spin(seconds: float) -> None:
                bench.spin(seconds)
                if "reset" in steps and not released:
                    released.append(client.call_async(Trigger.Request()))

        use(page, Spinning, act)
    bag = Bag.open(tmp_path / "out" / "bag")
    acts_in_bag = list(bag.records("steering", STEERING))
    assert [item.act for item in acts_in_bag] == [
        SteeringAct.PAUSE,
        SteeringAct.RESUME,
        SteeringAct.SKIP_LEVEL,
        SteeringAct.CHANGE_LEVELS,
        SteeringAct.REPEAT_LEVEL,
        SteeringAct.END,
    ]
    assert all(item.taken and item.source == "the live page" for item in acts_in_bag)
    assert acts_in_bag[3].levels[-4:] == (0.3,) * 4
    assert acts_in_bag[4].level_index == 0
    assert bag.run_start is not None
    assert bag.run_start["plan"]["levels"] == [0.1] * 40
    # A person saw the first point soon after its message.
    written = next(received for _, received, _, _ in bag.raw_messages(("modal_point",))) / 1e9
    assert seen["point"] - written < 5.0
    stopped = Bag.open(tmp_path / "out" / "bag-2")
    assert StopCause.EMERGENCY_STOP in {stop.cause for stop in stopped.records("drive_stop", DRIVE_STOP)}
    assert not list(stopped.blocks("voltage"))[-1].data.any()


@pytest.mark.campaign
def test_strangers_hangs_and_deaths_change_no_sample(tmp_path: Path) -> None:
    """One page is harassed, one hangs, one is killed; the samples are those of a run without a page."""
    arguments: dict[str, Any] = {"levels": [0.2, 0.5, 0.8], "window_periods": 150, "run_id": "alone"}
    struck: list[int] = []
    answers: list[tuple[int, set[int]]] = []

    def visit() -> None:
        own = address(page)
        with contextlib.suppress(AssertionError):
            answers.append(asyncio.run(harass(own.partition("/?")[0], own)))

    def strike(progress: Any) -> None:
        if progress.sample > 20_000 and not struck:
            struck.append(progress.sample)
            os.kill(hung.pid, signal.SIGSTOP)
            os.kill(killed.pid, signal.SIGKILL)

    visitor = threading.Thread(target=visit)
    with (
        Bench("beam", out=tmp_path / "live", processes=True, **arguments) as bench,
        served(bench) as page, served(bench) as hung, served(bench) as killed,
    ):  # fmt: skip
        visitor.start()
        live = bench.run(strike)
        visitor.join()
    assert live.code == ResultCode.SUCCEEDED
    ((count, statuses),) = answers
    assert count >= 200
    assert min(statuses) >= 400
    with Session(plan_test("beam", **arguments), tmp_path / "alone") as session:
        alone = session.run()
    assert alone.code == ResultCode.SUCCEEDED
    there, here = messages(tmp_path / "live" / "bag"), messages(tmp_path / "alone" / "bag")
    for topic in (
        "force", "displacement", "acceleration", "voltage", "drive", "frequency", "level", "lock", "modal_point",
        "monitor", "steering", "drive_stop",
    ):  # fmt: skip
        assert len(there.get(topic, ())) == len(here.get(topic, ())), topic
        assert all(same(*pair) for pair in zip(there.get(topic, ()), here.get(topic, ()), strict=True)), topic
    assert struck[0] < len(here["force"]) * 200 - 20_000  # it was struck in the middle
