"""The page of a check as a browser shows it."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from node.browser import Browser, find_chromium

from nmt_report.check_report import check_page

LONG = "x5 comes 2.999 ms (±0.002) after the others, 24° at 22.19 Hz: the test would give δ̃ wrong by +3.3 %"
CHANNEL = {
    "port": "1", "noise_v": 2.01e-5, "noise": 1.0e-7, "unit": "m/s^2", "mains_v": 1.84e-6, "offset_v": -2.0e-3,
    "coherence": 0.999, "gain": 1.0021, "gain_std": 2e-4, "delay": 2.999e-3, "delay_std": 2e-6,
    "damping_error": 0.033, "frequency_error": -5.7e-4, "headroom": 0.12,
}  # fmt: skip
MODE = {
    "number": 1, "frequency_hz": 22.1901, "frequency_std": 0.0059, "model_hz": 22.2, "damping_ratio": 0.005,
    "damping_std": 1e-4, "model_damping": 0.005,
}  # fmt: skip
CHECK = {
    "rig": "beam", "device": "portaudio", "date": "2026-11-24", "stated_samples": -1, "round_trip_samples": 1,
    "clock_ppm": 0.1, "drive_peak_v": 0.31, "drive_limit_v": 0.5, "frequency_hz": 22.19, "expected_hz": 22.19,
    "lost_blocks": 0, "modes": [MODE], "channels": [{"channel": name, **CHANNEL} for name in ("f2", "x4", "x5", "a2")],
    "findings": [{"name": "late", "channels": ["x5"], "sentence": LONG, "remedy": f"look at {LONG}"}],
}  # fmt: skip
CUT = "[...document.querySelectorAll('.scroll')].filter((e) => e.scrollWidth > e.clientWidth).length"
RIGHT = (
    """[...document.querySelectorAll('#findings td')].filter((e) => getComputedStyle(e).textAlign !== 'left').length"""
)


@pytest.mark.parametrize("lacking", ["gain", "gain_std", "delay", "delay_std"])
def test_a_channel_of_which_not_all_was_fitted_leaves_the_page_whole(lacking: str) -> None:
    channels = [{"channel": "f2", **CHANNEL}, {"channel": "x4", **CHANNEL, lacking: None}]
    assert "x4" in check_page({**CHECK, "channels": channels})


@pytest.mark.campaign
@pytest.mark.skipif(find_chromium() is None, reason="no Chromium is installed; apt install chromium")
def test_findings_are_read_from_the_left_and_no_table_is_cut(tmp_path: Path) -> None:
    page = tmp_path / "check.html"
    page.write_text(check_page(CHECK))

    async def look() -> None:
        async with Browser() as browser:
            await browser.open(page.as_uri())
            for width, tables in ((1280, 0), (800, 0), (390, 3)):  # on a phone tables of figures are moved sideways
                await browser.size(width, 900)
                await browser.until(f"innerWidth === {width} && document.querySelectorAll('#findings td').length === 3")
                assert await browser.value(CUT) <= tables
                assert await browser.value("document.documentElement.scrollWidth") <= width
            assert await browser.value(RIGHT) == 0
            assert browser.errors == []

    asyncio.run(look())
