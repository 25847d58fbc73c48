"""Efficiency of a scheduler's workers: figures of works that wait, on a cluster that works one after the other."""

from __future__ import annotations

import builtins
import time
from typing import Any

import numpy as np
import pytest

from nmt_benchmark import scheduler_figures
from nmt_benchmark.scheduler_figures import waiting_times
from nmt_core.errors import BenchError


class Cluster:
    scheduler_address = "tcp://none"

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *_: Any) -> None:
        pass


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Workers that are perfect at waiting but for a lost share, and a study that takes what is said."""
    pytest.importorskip("distributed")
    said: dict[str, Any] = {"lost": 0.0, "study": iter([2.0, 2.5]), "workers": 0, "clock": 0.0}

    def cluster(_: Any, workers: int) -> Cluster:
        said["workers"] = workers
        return Cluster()

    def perfect(function: Any, work: list[tuple[float]], jobs: int, address: str) -> list[float]:
        said["clock"] += sum(seconds for (seconds,) in work) / said["workers"] / (1.0 - said["lost"])
        return [seconds for (seconds,) in work]

    monkeypatch.setattr(scheduler_figures, "_cluster", cluster)
    monkeypatch.setattr(scheduler_figures, "worked", perfect)
    monkeypatch.setattr(scheduler_figures, "_study_time", lambda address: next(said["study"]))
    monkeypatch.setattr(time, "perf_counter", lambda: said["clock"])
    return said


@pytest.mark.parametrize("lost", [0.0, 0.3])
def test_efficiency_is_the_share_of_the_workers_time(quick: dict[str, Any], lost: float) -> None:
    quick["lost"] = lost
    two, eight, study = scheduler_figures.scheduler_figures(1.0)
    assert "2 workers" in two.name
    assert "8 workers" in eight.name
    for figure in (two, eight):
        assert figure.value == pytest.approx(100.0 * (1.0 - lost))
        assert figure.met is (lost == 0.0)
    assert study.value == pytest.approx(80.0)
    assert study.met is False


def test_times_are_those_of_a_campaign() -> None:
    """Mean over median of the campaign's cases is 1.5, the longest of 320 some fourteen medians."""
    times = waiting_times(320)
    assert np.array_equal(times, waiting_times(320))
    assert np.mean(times) / np.median(times) == pytest.approx(1.5, abs=0.3)
    assert np.max(times) / np.median(times) == pytest.approx(14.0, rel=0.1)


def test_without_dask_it_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def missing(name: str, *rest: Any, **more: Any) -> Any:
        if name == "distributed":
            raise ModuleNotFoundError(name)
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", missing)
    figures = scheduler_figures.scheduler_figures(1.0)
    assert [figure.value for figure in figures] == [None] * 3
    assert all("dask" in figure.note for figure in figures)


def test_a_case_that_fails_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    from types import SimpleNamespace

    from nmt_study import study_runner

    failed = [SimpleNamespace(result=None, failure="no lock")]
    monkeypatch.setattr(study_runner, "run_cases", lambda *_, **__: failed)
    with pytest.raises(BenchError, match="no lock"):
        scheduler_figures._study_time("tcp://none")
