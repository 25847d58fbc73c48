"""Figures of the live page beside a real-time run: its share of a core, sample to pixel, real-time margin, first point.

    ./nmt shell
    cd tests && python -m node.page_figures [--pairs 2] [--seconds 20] [--viewers 1,2,10]

Runs of the beam in real time, 10 kHz and six channels or more, without a page and with it in turn. The first viewer is
a headless Chromium, the others read the frames. CPU time is that of the page's process, from /proc; the browser is not
counted. Times of samples are those of the bag: the earliest that a block of a sample ever reached the recorder.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from node.browser import Browser, find_chromium
from rclpy.serialization import deserialize_message

from nmt_bench.harness import Bench
from nmt_bench.page.page_process import page_process
from nmt_core.vocabulary import Quantity
from nmt_record.bag.bag_reader import Bag

_WATCH = """
window.drawnAt = []; window.pointAt = 0; window.newest = '';
(function look() {
  const sample = document.body.dataset.sample;
  if (sample && sample !== window.newest) {
    window.newest = sample;
    requestAnimationFrame(() => window.drawnAt.push([+sample, Date.now()]));
  }
  if (!window.pointAt && document.querySelectorAll('#points tbody tr td').length > 3) { window.pointAt = Date.now(); }
  requestAnimationFrame(look);
})();
"""


def cpu_seconds(pid: int) -> float:
    """CPU time of a process so far, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


async def _watch(steer: str, watch: str, viewers: int, ended: threading.Event, told: dict[str, Any]) -> None:
    origin = steer.partition("/?")[0]

    async def read() -> None:
        async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as client:
            async with client.get(watch):
                pass
            async with client.ws_connect(f"{origin}/live", headers={"Origin": origin}, max_msg_size=0) as live:
                async for message in live:
                    told["bytes"] = told.get("bytes", 0) + len(message.data)

    others = [asyncio.create_task(read()) for _ in range(viewers - 1)]
    async with Browser() as browser:
        await browser.size(1400, 900)
        await browser.open(steer)
        await browser.until("document.getElementById('phase')", 60.0)
        await browser.value(_WATCH)
        told["ready"] = True
        while not ended.is_set():
            await asyncio.sleep(0.2)
        told["drawn"] = await browser.value("window.drawnAt")
        told["point"] = await browser.value("window.pointAt")
        told["errors"] = browser.errors
    for task in others:
        task.cancel()
    await asyncio.gather(*others, return_exceptions=True)


def measure(viewers: int, seconds: float) -> dict[str, Any]:
    """One real-time run with so many viewers; 0: without a page."""
    ended, told = threading.Event(), {}
    spent: list[tuple[float, float]] = []
    with tempfile.TemporaryDirectory(prefix="nmt-figures-") as folder, contextlib.ExitStack() as stack:
        levels = [0.2] * max(2, round(seconds / 5.0))
        bench = stack.enter_context(
            Bench("beam", levels, pacing="realtime", window_periods=60, processes=True, out=Path(folder) / "out")
        )
        page = watcher = None
        if viewers:
            arguments = ("--domain", str(bench.domain_id), "--no-reference")
            page = stack.enter_context(page_process(Path(folder) / "page.log", arguments))
            steer, watch = (line.partition(": ")[2].strip() for line in page.lines)
            watcher = threading.Thread(target=lambda: asyncio.run(_watch(steer, watch, viewers, ended, told)))
            watcher.start()
            while "ready" not in told and watcher.is_alive():
                time.sleep(0.1)

        def note(progress: Any) -> None:
            if page is not None:
                spent.append((time.monotonic(), cpu_seconds(page.pid)))

        load = os.getloadavg()[0]
        result = bench.run(note)
        time.sleep(0.5)
        ended.set()
        if watcher is not None:
            watcher.join()
        bag = Bag.open(Path(folder) / "out" / "bag")
        found = _read(bag)
    found.update(viewers=viewers, load=load, result=result.message)
    if spent:
        used = [item for item in spent if item[0] > spent[0][0] + 2.0]
        found["cpu_percent"] = 100.0 * (used[-1][1] - used[0][1]) / (used[-1][0] - used[0][0])
    if told.get("drawn"):
        drawn = np.array(told["drawn"][20:], dtype=float)
        latency = drawn[:, 1] - 1e3 * (found["zero"] + drawn[:, 0] / found["rate"])
        found["latency_ms"] = [float(value) for value in np.percentile(latency, [50, 95, 100])]
        found["pictures_per_s"] = float((len(drawn) - 1) / (drawn[-1, 1] - drawn[0, 1]) * 1e3)
        found["first_point_s"] = told["point"] / 1e3 - found["point"]
    return found


def _read(bag: Bag) -> dict[str, Any]:
    zero, rate, channels, point = np.inf, 1.0, 0, np.nan
    for quantity in Quantity:
        if bag.topics.get(quantity.topic, ("", 0))[1]:
            channels += len(next(iter(bag.blocks(quantity.topic))).channels)
    blocks = {(item.first_sample): item for item in bag.blocks("force")}
    for topic, received, published, _ in bag.raw_messages(("force", "modal_point")):
        if topic == "modal_point":
            point = received / 1e9 if np.isnan(point) else point
            continue
        any_block = next(iter(blocks.values()))
        rate = any_block.sample_rate
        zero = min(zero, (received - published) / 1e9 - any_block.samples / rate)
    margin = jitter = overruns = ""
    for _, _, _, raw in bag.raw_messages(("diagnostics",)):
        for status in deserialize_message(bytes(raw), DiagnosticArray).status:
            values = {item.key: item.value for item in status.values}
            if status.name.split("/")[-1] == "plant" and "real_time_margin" in values:
                margin, jitter, overruns = (values[name] for name in ("real_time_margin", "jitter_p99_ms", "overruns"))
    return {
        "zero": zero, "rate": rate, "channels": channels, "point": point, "margin": float(margin or "nan"),
        "jitter_p99_ms": float(jitter or "nan"), "overruns": int(overruns or 0),
    }  # fmt: skip


def sentence(figures: dict[str, Any]) -> str:
    """The figures of one run in words."""
    words = (
        f"{figures['viewers']:2d} viewers, {figures['channels']} channels at {figures['rate']:g} Hz, "
        f"load {figures['load']:.1f}: margin {100 * figures['margin']:.2f} %, "
        f"lateness {figures['jitter_p99_ms']:.2f} ms (99 %), overruns {figures['overruns']}"
    )
    if "latency_ms" in figures:
        median, most, worst = figures["latency_ms"]
        words += (
            f"; page {figures['cpu_percent']:.1f} % of a core, {figures['pictures_per_s']:.1f} pictures/s, sample to "
            f"pixel {median:.0f} ms (median), {most:.0f} ms (95 %), {worst:.0f} ms (all), first point after "
            f"{figures['first_point_s']:.2f} s"
        )
    return words


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=2, help="runs without and with the page, in turn (default: 2)")
    parser.add_argument("--seconds", type=float, default=20.0, help="bench time of a run, s (default: 20)")
    parser.add_argument("--viewers", default="1,2,10", help="numbers of viewers (default: 1,2,10)")
    parser.add_argument("--json", type=Path, help="also write everything to this file")
    arguments = parser.parse_args()
    if find_chromium() is None:
        parser.error("no Chromium is installed; apt install chromium")
    found = []
    for viewers in map(int, arguments.viewers.split(",")):
        for _ in range(arguments.pairs):
            for count in (0, viewers):
                figures = measure(count, arguments.seconds)
                found.append(figures)
                print(sentence(figures), flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
