from __future__ import annotations

import io
import math
from types import SimpleNamespace

import pytest
from report.synthetic_run import synthetic_run
from rich.console import Console

from nmt_bench.commands.console import make_console
from nmt_bench.commands.run_progress import RunProgress
from nmt_bench.commands.terminal import print_modal_table


def printed(width: int, reference: bool = True) -> str:
    data = synthetic_run(reference=reference)
    stream = io.StringIO()
    print_modal_table(data.points, data.reference, Console(file=stream, width=width))
    return stream.getvalue()


@pytest.mark.parametrize("width", [80, 100, 120, 160, 240])
def test_table_fits_the_terminal(width: int) -> None:
    text = printed(width)
    assert all(len(line.rstrip()) <= width for line in text.splitlines())
    assert "…" not in text
    for word in ("f̃", "δ̃", "q", "Δδ̃"):
        assert word in text


def test_wide_table_shows_uncertainties_in_full() -> None:
    assert "±" in printed(240)
    assert "MAC" in printed(240)
    assert "(20)" in printed(80)


def test_levels_without_a_result_are_explained() -> None:
    text = printed(100)
    assert "not locked" in text
    assert "Level 7 (0.4827 V) not locked: phase error stayed at 17° until the time-out of 11 s" in text


def test_no_points() -> None:
    stream = io.StringIO()
    print_modal_table([], None, Console(file=stream))
    assert stream.getvalue() == "No modal point.\n"


def test_progress_without_a_terminal_writes_plain_lines() -> None:
    stream = io.StringIO()
    with RunProgress(10_000.0, 2, "V", make_console(stream)) as progress:
        for index, state in ((0, 2), (0, 2), (0, 3), (0, 3), (1, 2), (1, 4)):
            progress.update(
                {
                    "level_index": index,
                    "level_count": 2,
                    "level": 0.05 * (index + 1),
                    "state": state,
                    "frequency_hz": 22.19,
                    "phase_error": math.radians(0.5),
                    "fraction_done": 0.25,
                    "sample": 20_000,
                }
            )
        progress.note("The bag is closed.")
    lines = stream.getvalue().splitlines()
    assert "\x1b" not in stream.getvalue()
    assert len(lines) == 5
    words = "level 1/2 0.05 V acquiring 22.1900 Hz phase error 0.50° bench time 2.0 s"
    assert lines[0].split() == words.split()
    assert "locked" in lines[1]
    assert "lock lost" in lines[3]
    assert lines[4] == "The bag is closed."


def test_progress_takes_objects_and_gaps() -> None:
    stream = io.StringIO()
    with RunProgress(10_000.0, 3, "m/s^2", make_console(stream)) as progress:
        progress.update(SimpleNamespace(level_index=1, level=2.0, state=3, phase_error=math.nan))
        progress.update({"state": 99})
    first, second = stream.getvalue().splitlines()
    assert first.split() == ["level", "2/3", "2", "m/s²", "locked"]
    assert "waiting" in second


def test_progress_on_a_terminal_keeps_what_levels_came_to() -> None:
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=True, width=120, color_system=None)
    with RunProgress(10_000.0, 1, "V", console) as progress:
        progress.update({"level_index": 0, "level": 1.0, "state": 2, "fraction_done": 0.1})
        progress.update({"level_index": 0, "level": 1.0, "state": 3, "fraction_done": 0.5})
    settled = [line for line in stream.getvalue().splitlines() if "level 1/1" in line and "%" not in line]
    assert len(settled) == 1
    assert "locked" in settled[0]
