"""The longest tests begin first, those that share a fixture stay together, and none is left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("xdist")

from worker_schedule import TABLE, Cost, LongestFirst, read_costs, write_costs

ROOT = Path(__file__).resolve().parents[2]
TESTS = [
    *("short.py::a", "short.py::b"),
    *("long.py::a", "long.py::b[x::y]", "long.py::c"),
    *("apart.py::a", "apart.py::b", "apart.py::c", "apart.py::d"),
    *("clock.py::a", "clock.py::b"),
    "new.py::a",
]
COSTS = {
    "clock.py": Cost(1.0, "punctual"),
    "short.py": Cost(2.0),
    "long.py": Cost(30.0),
    "apart.py": Cost(80.0, "apart"),
}


class Worker:
    """Notes what it is given."""

    def __init__(self, name: str) -> None:
        self.gateway = SimpleNamespace(id=name)
        self.shutting_down = False
        self.given: list[int] = []

    def send_runtest_some(self, indices: list[int]) -> None:
        self.given += indices

    def shutdown(self) -> None:
        self.shutting_down = True


def scheduled(
    workers: int, tests: Sequence[str] = TESTS, costs: Mapping[str, Cost] = COSTS, cores: int = 8
) -> tuple[LongestFirst, list[Worker]]:
    option: Any = SimpleNamespace(loadscopereorder=True, tx=["popen"] * workers, maxprocesses=None)
    config: Any = SimpleNamespace(option=option, getvalue=lambda name: getattr(option, name))
    schedule = LongestFirst(config, costs=costs, cores=cores)
    made = [Worker(f"gw{number}") for number in range(workers)]
    for worker in reversed(made):  # they report in any order
        schedule.add_node(worker)  # type: ignore[arg-type]
        schedule.add_node_collection(worker, tests)  # type: ignore[arg-type]
    schedule.schedule()
    return schedule, made


def work_off(schedule: LongestFirst, workers: list[Worker], tests: Sequence[str] = TESTS) -> list[str]:
    """Tests in the order of their ends; all take the same time."""
    done: list[str] = []
    turns = [0] * len(workers)
    while schedule.has_pending:
        for k, worker in enumerate(workers):
            if turns[k] < len(worker.given):
                index = worker.given[turns[k]]
                turns[k] += 1
                done.append(tests[index])
                schedule.mark_test_complete(worker, index)  # type: ignore[arg-type]
    return done


@pytest.mark.parametrize("workers", [1, 2, 3, 8])
def test_every_test_runs_once(workers: int) -> None:
    assert sorted(work_off(*scheduled(workers))) == sorted(TESTS)


def test_the_longest_begins_and_the_unknown_ends() -> None:
    order = work_off(*scheduled(1))
    assert order[:2] == ["clock.py::a", "clock.py::b"]
    assert order[2:5] == ["long.py::a", "long.py::b[x::y]", "long.py::c"]
    assert order[5:9] == ["apart.py::a", "apart.py::b", "apart.py::c", "apart.py::d"]
    assert order[9:] == ["short.py::a", "short.py::b", "new.py::a"]


def test_what_shares_a_fixture_is_with_one_worker() -> None:
    schedule, workers = scheduled(3)
    work_off(schedule, workers)
    for worker in workers:
        given = {TESTS[index] for index in worker.given}
        for file in ("long.py", "short.py"):
            own = {test for test in TESTS if test.startswith(file)}
            assert own <= given or not own & given
    assert sum(any(TESTS[index].startswith("apart.py") for index in worker.given) for worker in workers) > 1


@pytest.mark.parametrize("workers", [1, 2, 4])
def test_the_first_does_what_is_punctual_before_all_else(workers: int) -> None:
    schedule, made = scheduled(workers)
    work_off(schedule, made)
    assert [TESTS[index] for index in made[0].given][:2] == ["clock.py::a", "clock.py::b"]


def test_what_is_punctual_waits_for_the_first() -> None:
    tests = ["slow.py::a", "clock.py::a", "clock.py::b", "clock.py::c", "new.py::a"]
    schedule, made = scheduled(2, tests, {"slow.py": Cost(9.0, "punctual"), "clock.py": Cost(5.0, "punctual")})
    assert sorted(work_off(schedule, made, tests)) == sorted(tests)
    assert [tests[index] for index in made[0].given][:4] == tests[:4]
    assert [tests[index] for index in made[1].given] == ["new.py::a"]


def test_workers_beyond_the_cores_begin_after_what_is_punctual() -> None:
    tests = ["clock.py::a", "clock.py::b", *(f"new{number}.py::a" for number in range(20))]
    schedule, made = scheduled(3, tests, COSTS, cores=2)
    assert made[1].given
    assert not made[2].given
    for index in (0, 1):
        assert not made[2].given
        schedule.mark_test_complete(made[0], index)  # type: ignore[arg-type]
    assert made[2].given
    assert not made[2].shutting_down


def test_no_worker_begins_before_what_is_alone_is_done() -> None:
    tests = ["late.py::a", "late.py::b", "clock.py::a", *(f"new{number}.py::a" for number in range(20))]
    costs = {"clock.py": Cost(90.0, "punctual"), "late.py": Cost(5.0, "alone")}
    schedule, made = scheduled(3, tests, costs, cores=2)
    for index in (0, 1):
        assert made[0].given[:2] == [0, 1]
        assert not made[1].given
        assert not made[2].given
        schedule.mark_test_complete(made[0], index)  # type: ignore[arg-type]
    assert made[1].given
    assert not made[2].given
    assert tests[made[0].given[2]] == "clock.py::a"
    schedule.mark_test_complete(made[0], 2)  # type: ignore[arg-type]
    assert made[2].given


def test_a_worker_that_may_begin_knows_two_tests() -> None:
    """xdist's worker runs a test when it knows the next one, and says nothing before."""
    tests = ["late.py::a", "clock.py::a", "clock.py::b", "clock.py::c", *(f"new{number}.py::a" for number in range(20))]
    costs = {"clock.py": Cost(90.0, "punctual"), "late.py": Cost(5.0, "alone"), "new7.py": Cost(300.0)}
    schedule, made = scheduled(2, tests, costs, cores=2)
    schedule.mark_test_complete(made[0], 0)  # type: ignore[arg-type]
    assert tests[made[1].given[0]] == "new7.py::a"
    assert len(made[1].given) >= 2


def test_what_is_wide_begins_after_what_is_punctual() -> None:
    tests = ["clock.py::a", "clock.py::b", "wide.py::a", *(f"new{number}.py::a" for number in range(20))]
    costs = {"clock.py": Cost(90.0, "punctual"), "wide.py": Cost(300.0, "wide")}
    schedule, made = scheduled(2, tests, costs, cores=2)
    assert 2 not in made[1].given
    for index in (0, 1):
        schedule.mark_test_complete(made[0], index)  # type: ignore[arg-type]
    schedule.mark_test_complete(made[1], made[1].given[0])  # type: ignore[arg-type]
    assert 2 in made[0].given + made[1].given
    only = ["clock.py::a", "clock.py::b", "wide.py::a"]
    assert sorted(work_off(*scheduled(2, only, costs, cores=2), only)) == sorted(only)


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_every_test_runs_once_where_some_are_alone(workers: int) -> None:
    costs = {**COSTS, "short.py": Cost(2.0, "alone")}
    assert sorted(work_off(*scheduled(workers, costs=costs, cores=2))) == sorted(TESTS)


@pytest.mark.parametrize("cores", [1, 2])
def test_every_test_runs_once_where_workers_wait(cores: int) -> None:
    assert sorted(work_off(*scheduled(3, cores=cores))) == sorted(TESTS)


def test_measured_seconds_replace_those_of_the_table(tmp_path: Path) -> None:
    table = tmp_path / "tests" / "seconds.txt"
    table.parent.mkdir()
    for name in ("a.py", "b.py", "c.py"):
        (table.parent / name).touch()
    table.write_text("# head\n  50 tests/a.py apart\n  40 tests/b.py\n  30 tests/gone.py\n")
    write_costs({"tests/a.py": 20.0, "tests/c.py": 0.2}, table)
    assert read_costs(table) == {"tests/b.py": Cost(40.0), "tests/a.py": Cost(20.0, "apart")}
    assert [line.split()[-1] for line in table.read_text().splitlines()[1:]] == ["tests/b.py", "apart"]


def test_the_table_names_files_that_exist() -> None:
    costs = read_costs()
    assert TABLE.is_file()
    assert costs
    assert [name for name in costs if not (ROOT / name).is_file()] == []
