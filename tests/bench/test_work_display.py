"""The display of work: sentences with counts and the time left on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from nmt_bench.commands import work_display
from nmt_bench.commands.work_display import WorkDisplay
from nmt_core.processes.work_progress import counted, tell
from nmt_report.quantity_format import duration


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    own = Clock()
    monkeypatch.setattr(work_display, "time", own)
    return own


def shown(display: WorkDisplay) -> str:
    assert display.bar is not None
    return display.bar.tasks[0].description


def terminal() -> Console:
    return Console(file=io.StringIO(), force_terminal=True, width=120)


def test_a_terminal_shows_step_count_and_time_left(clock: Clock) -> None:
    with WorkDisplay(terminal(), ("measuring", "drawing")) as display:
        assert shown(display) == "step 1 of 2: measuring"
        display.step()
        for number in range(4):
            tell("drawing figures", number, 4)
            if number == 3:
                assert shown(display) == f"step 2 of 2: drawing figures, 3 of 4; about {duration(2.0)} left"
            clock.now += 2.0


def test_what_is_done_gives_way_to_the_work_it_was_part_of(clock: Clock) -> None:
    with WorkDisplay(terminal(), ("fitting",)) as display:
        assert list(counted("reading", range(3), 3)) == [0, 1, 2]
        assert shown(display) == "fitting"


def test_a_file_gets_a_line_every_ten_seconds(clock: Clock) -> None:
    stream = io.StringIO()
    with WorkDisplay(Console(file=stream, width=120)):
        for number in range(30):
            tell("drawing figures", number, 30)
            clock.now += 1.0
    assert stream.getvalue().splitlines() == [
        f"drawing figures, 11 of 30; about {duration(19.0)} left",
        f"drawing figures, 22 of 30; about {duration(8.0)} left",
    ]


def test_quiet_shows_nothing(clock: Clock) -> None:
    stream = io.StringIO()
    with WorkDisplay(Console(file=stream, force_terminal=True), ("measuring",), quiet=True):
        clock.now += 60.0
        tell("measuring", 1, 2)
    assert stream.getvalue() == ""


def test_without_a_listener_items_pass_as_they_are() -> None:
    items = [1, 2]
    assert counted("reading", items, 2) is items
    tell("reading")
