"""The look at what a run leaves in shared memory, which benches of other domains use meanwhile."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest
from node import signal_trials


@pytest.fixture
def memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in place of shared memory."""
    monkeypatch.setattr(signal_trials, "MEMORY", tmp_path)
    monkeypatch.setattr(signal_trials, "BETWEEN_LOOKS", 0.2)
    return tmp_path


def test_a_segment_that_nobody_uses_is_left(memory: Path) -> None:
    (memory / "fastrtps_port7007").touch()
    (memory / "sem.fastrtps_port7007_mutex").touch()
    assert signal_trials.stays({"fastrtps_port7007"}) == ["fastrtps_port7007", "sem.fastrtps_port7007_mutex"]
    assert signal_trials.stays({"fastrtps_port7009"}) == []


def test_a_port_that_another_bench_gives_up_meanwhile_is_not(memory: Path) -> None:
    port = memory / "fastrtps_port7007"
    port.touch()
    after_the_first_look = threading.Timer(0.1, port.unlink)
    after_the_first_look.start()
    assert signal_trials.stays({port.name}) == []
    after_the_first_look.join()


def test_a_port_that_another_bench_takes_anew_is_not(memory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    port = memory / "fastrtps_port7007"
    port.touch()

    def take_anew(_seconds: float) -> None:
        (memory / "other").touch()
        (memory / "other").rename(port)

    monkeypatch.setattr(signal_trials.time, "sleep", take_anew)
    assert signal_trials.stays({port.name}) == []
