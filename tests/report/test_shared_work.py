"""Half of the figures are drawn by a second process."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import partial

import pytest

from nmt_report.shared_work import FEWEST_CALLS, results_of


@pytest.fixture
def _two_processors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})


def _process(number: int) -> tuple[int, int]:
    return number, os.getpid()


@pytest.mark.usefixtures("_two_processors")
@pytest.mark.parametrize("count", range(FEWEST_CALLS, FEWEST_CALLS + 3))
def test_results_come_in_order_from_two_processes(count: int) -> None:
    results = results_of([partial(_process, number) for number in range(count)])
    assert [number for number, _ in results] == list(range(count))
    assert {process == os.getpid() for _, process in results[::2]} == {True}
    assert {process == os.getpid() for _, process in results[1::2]} == {False}


def test_few_calls_and_one_processor_need_no_second_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fork", None)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})
    assert results_of([partial(_process, 1)] * 8) == [(1, os.getpid())] * 8
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    assert len(results_of([partial(_process, 1)] * (FEWEST_CALLS - 1))) == FEWEST_CALLS - 1


@pytest.mark.usefixtures("_two_processors")
def test_what_the_second_process_does_not_deliver_is_done_here() -> None:
    here = os.getpid()

    def only_here() -> int:
        if os.getpid() != here:
            raise MemoryError
        return here

    assert results_of([only_here] * FEWEST_CALLS) == [here] * FEWEST_CALLS


@pytest.mark.usefixtures("_two_processors")
def test_a_failure_here_leaves_no_process(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[int] = []
    fork = os.fork

    def noted() -> int:
        started.append(fork())
        return started[-1]

    monkeypatch.setattr(os, "fork", noted)

    def fails() -> None:
        raise ValueError("no figure")

    with pytest.raises(ValueError, match="no figure"):
        results_of([fails] * FEWEST_CALLS)
    (process,) = started
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)


PAGES = """
import os
os.sched_getaffinity = lambda _: {0, 1}
forks, fork = [], os.fork
os.fork = lambda: forks.append(1) or fork()
from report.synthetic_run import synthetic_run
from nmt_report.run_report import report_html
from nmt_report.shared_work import font_is_open
data = synthetic_run(levels=3, failed=1)
assert not font_is_open()
first = report_html(data)
assert font_is_open()
print(first == report_html(data), len(forks))
"""


@pytest.mark.campaign
def test_the_page_is_the_same_from_one_process_and_from_two() -> None:
    """The second is drawn alone, since a font is open by then."""
    words = [sys.executable, "-c", PAGES]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    answer = subprocess.run(words, env=environment, capture_output=True, text=True)
    assert answer.stdout.split() == ["True", "1"], answer.stderr


def test_a_process_that_cannot_be_copied_works_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fork", None)
    assert results_of([partial(_process, 1)] * 8, alone=True) == [(1, os.getpid())] * 8
