"""What the process that owns an output writes, and what is said of it when the plant cannot be asked."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from nmt_core.processes.output_record import OutputRecord, drive_sentence, output_sentence, read_output
from nmt_core.vocabulary import OutputState


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "output.jsonl"


def write(path: Path, *lines: tuple[int, OutputState, str]) -> None:
    record = OutputRecord(str(path))
    for sample, state, reason in lines:
        record.write(sample, state, sample - 100, reason)
    record.close()


WAY = (
    (0, OutputState.AT_ZERO, ""),
    (40, OutputState.FOLLOWING, ""),
    (640, OutputState.RAMPING, "not fed for 60 ms"),
    (1640, OutputState.HELD, "not fed for 60 ms"),
    (1680, OutputState.ENDED, "not fed for 60 ms"),
)


def test_lines_come_back_as_they_were_written(path: Path) -> None:
    write(path, *WAY)
    lines = read_output(path)
    assert [(line.sample, line.state, line.reason) for line in lines] == [(s, state.name, why) for s, state, why in WAY]
    assert [line.fed_at for line in lines] == [s - 100 for s, _, _ in WAY]
    assert all(line.pid == os.getpid() for line in lines)
    assert [line.time for line in lines] == sorted(line.time for line in lines)


def test_a_cut_line_is_left_out(path: Path) -> None:
    write(path, *WAY)
    path.write_bytes(path.read_bytes()[:-9])
    assert [line.state for line in read_output(path)] == ["AT_ZERO", "FOLLOWING", "RAMPING", "HELD"]


@pytest.mark.parametrize(
    ("count", "words"),
    [
        (1, "the output is at zero"),
        (2, "the output follows its commands"),
        (3, "the process that owns the output takes it to zero: not fed for 60 ms"),
        (4, "the process that owns the output put it to zero at sample 1640 and holds it there: not fed for 60 ms"),
        (5, "the process that owns the output put it to zero at sample 1680 and released it: not fed for 60 ms"),
    ],
)
def test_the_last_line_says_what_the_output_does(path: Path, count: int, words: str) -> None:
    write(path, *WAY[:count])
    assert output_sentence(path) == words


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_a_writer_that_is_silent_leaves_it_unknown(path: Path, count: int) -> None:
    write(path, *WAY[:count])
    words = output_sentence(path, now=time.time() + 5.0)
    assert words.startswith("what the drive does is UNKNOWN: the process that owns the output has died or hangs")
    assert WAY[count - 1][1].name in words


def test_an_output_that_was_released_stays_so(path: Path) -> None:
    write(path, *WAY)
    assert "put it to zero" in output_sentence(path, now=time.time() + 3600.0)


def test_without_a_record_nothing_is_known(path: Path) -> None:
    assert "UNKNOWN" in output_sentence("")
    assert "cannot be read" in output_sentence(path)
    path.write_text("nonsense\n{}\n")
    assert "cannot be read" in output_sentence(path)


def test_what_is_said_of_the_drive(path: Path) -> None:
    write(path, *WAY)
    owned = {"output_pid": "7", "output_record": str(path), "drive_at_zero": "0", "output": "the output goes to zero."}
    assert "UNKNOWN" in drive_sentence(None, alive=False)
    assert drive_sentence({"drive_at_zero": "1"}, alive=True) == "the plant reports the drive at zero"
    assert drive_sentence(owned, alive=True) == "the plant lives and reports: the output goes to zero"
    assert "not at zero yet" in drive_sentence({"drive_at_zero": "0"}, alive=True)
    assert "put it to zero at sample 1680" in drive_sentence(owned, alive=False)
    assert "UNKNOWN" in drive_sentence({**owned, "output_record": ""}, alive=False)
    assert "time stands still" in drive_sentence({"drive_at_zero": "0"}, alive=False, lockstep=True)
    assert "UNKNOWN" in drive_sentence({"drive_at_zero": "1"}, alive=False)
