"""Where the computer does not let the nodes work: one sentence before anything is started."""

from __future__ import annotations

import errno
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from nmt_bench import cli
from nmt_bench.commands.output_folder import OutputFolder
from nmt_bench.orchestration.surroundings import LEAST_FILES, check_surroundings
from nmt_core.errors import BenchError


@pytest.fixture
def limits(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int]]:
    """The limit of open files, played: soft and hard."""
    now = [(1024, 4096)]
    unlimited = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    monkeypatch.setattr(resource, "getrlimit", lambda what: now[-1] if what == resource.RLIMIT_NOFILE else unlimited)
    monkeypatch.setattr(resource, "setrlimit", lambda _, pair: now.append(pair))
    return now


def test_a_sound_computer_is_taken(tmp_path: Path, limits: list[tuple[int, int]]) -> None:
    check_surroundings(tmp_path / "out")
    assert limits == [(1024, 4096)]


def test_the_limit_of_open_files_is_raised_where_it_may_be(tmp_path: Path, limits: list[tuple[int, int]]) -> None:
    limits.append((24, 4096))
    check_surroundings(tmp_path / "out")
    assert limits[-1] == (1024, 4096)
    limits.append((24, 500))
    check_surroundings(tmp_path / "out")
    assert limits[-1] == (500, 500)


def test_too_few_open_files_are_refused(tmp_path: Path, limits: list[tuple[int, int]]) -> None:
    limits.append((24, 24))
    with pytest.raises(BenchError, match=rf"24 open files and the nodes need {LEAST_FILES}.*ulimit -n"):
        check_surroundings(tmp_path / "out")


def test_too_little_address_space_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: (700 * 2**20, 700 * 2**20))
    monkeypatch.setattr(resource, "setrlimit", lambda *_: None)
    with pytest.raises(BenchError, match=r"700 MiB of address space and the nodes need 2048; .*ulimit -v unlimited"):
        check_surroundings(tmp_path / "out")


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("pthread_create failed"), ImportError("failed to map")])
def test_a_command_without_memory_ends_with_a_sentence(
    error: Exception, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(_: object) -> int:
        raise error

    monkeypatch.setattr(cli, "run_parsed", fail)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (700 * 2**20, 700 * 2**20))
    assert cli.main(["extract", "bag", "--out", "out"]) == 2
    said = capsys.readouterr().err
    assert "700 MiB of address space are too few" in said
    assert said.count("\n") == 1


@pytest.mark.parametrize("live", [True, False])
@pytest.mark.parametrize("failure", [None, FileNotFoundError("gone")])
def test_a_deleted_results_folder_is_one_sentence(tmp_path: Path, live: bool, failure: Exception | None) -> None:
    folder = OutputFolder(tmp_path / "out", live=live)
    shutil.rmtree(folder.__enter__())
    with pytest.raises(BenchError, match="was deleted while the command wrote to it"):
        folder.__exit__(None if failure is None else type(failure), failure, None)


def test_a_disk_without_space_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limits: list[tuple[int, int]]
) -> None:
    usage = type("usage", (), {"free": 4096})
    monkeypatch.setattr("shutil.disk_usage", lambda _: usage)
    with pytest.raises(BenchError, match=r"0\.0 MB are free in .*less than 16 MB; choose another folder with --out"):
        check_surroundings(tmp_path / "out")


@pytest.mark.parametrize(
    ("number", "sentence"),
    [
        (errno.ENOSPC, "a.csv: the disk is full"),
        (errno.EMFILE, "a.csv: this shell allows too few open files"),
        (errno.EROFS, "a.csv: this cannot be written"),
        (errno.EACCES, "a.csv: access is denied"),
        (errno.ENAMETOOLONG, "a.csv: this name is too long"),
    ],
)
def test_what_the_system_refuses_is_one_sentence(
    number: int, sentence: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(_: object) -> int:
        raise OSError(number, os.strerror(number), "a.csv")

    monkeypatch.setattr(cli, "run_parsed", refuse)
    assert cli.main(["extract", "bag", "--out", "out"]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"{cli.PROGRAM} extract: {sentence}")
    assert said.count("\n") == 1


@pytest.mark.parametrize("words", [["--help"], ["run", "--help"]])
def test_a_reader_that_leaves_gets_no_traceback(words: list[str]) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    try:
        answer = subprocess.run(
            [sys.executable, "-m", "nmt_bench", *words], stdout=writing, stderr=subprocess.PIPE, text=True
        )
    finally:
        os.close(writing)
    assert answer.stderr == ""
    assert answer.returncode in (0, 1)
