"""What stands in the way of a set-up is said in one sentence, without a traceback."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from .conftest import copy_launcher, load_launcher


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A launcher in a folder of its own on a machine that lacks nothing."""
    copy_launcher(tmp_path)
    launcher = load_launcher(tmp_path)
    for name in ("g++", "gcc"):
        (tmp_path / name).write_text("#!/bin/sh\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    for name in ("CC", "CXX", "ROS_DISTRO", "NMT_ROS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os, "uname", lambda: SimpleNamespace(sysname="Linux", machine="x86_64"))
    monkeypatch.setattr(os, "confstr", lambda name: "glibc 2.36")
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=1e11, total=1e12))
    return launcher


def test_complete_machine_has_no_trouble(machine):
    assert machine.machine.machine_troubles("wheels") == []


def only_trouble(machine, source="wheels"):
    """The one sentence found."""
    found = machine.machine.machine_troubles(source)
    assert len(found) == 1, found
    return found[0]


def test_missing_compiler(machine, tmp_path):
    (tmp_path / "g++").unlink()
    assert "sudo apt install g++" in only_trouble(machine)


def test_compiler_named_by_the_user_is_taken(machine, monkeypatch, tmp_path):
    (tmp_path / "g++").rename(tmp_path / "g++-13")
    monkeypatch.setenv("CXX", "g++-13 -march=native")
    assert machine.machine.machine_troubles("wheels") == []


@pytest.mark.parametrize(("sysname", "machine_name"), [("Linux", "aarch64"), ("Darwin", "x86_64")])
def test_wheels_need_linux_on_x86_64_and_a_system_ros_does_not(machine, monkeypatch, sysname, machine_name):
    monkeypatch.setattr(os, "uname", lambda: SimpleNamespace(sysname=sysname, machine=machine_name))
    assert f"{sysname} {machine_name}" in only_trouble(machine)
    assert machine.machine.machine_troubles("system") == []


@pytest.mark.parametrize(
    ("libc", "refused"), [("glibc 2.27", True), ("glibc 2.28", False), ("glibc 3.0", False), (None, True)]
)
def test_wheels_need_a_recent_glibc(machine, monkeypatch, libc, refused):
    monkeypatch.setattr(os, "confstr", lambda name: libc)
    assert bool(machine.machine.machine_troubles("wheels")) == refused


def test_little_disk(machine, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=1e9, total=1e12))
    assert "1.0 GB free and the set-up needs 2.0 GB" in only_trouble(machine)


def test_little_room_for_downloads(machine, monkeypatch, tmp_path):
    monkeypatch.setenv("TMPDIR", "/")
    monkeypatch.setattr(shutil, "disk_usage", lambda f: SimpleNamespace(free=1e11 if f == str(tmp_path) else 1e8))
    assert "set TMPDIR" in only_trouble(machine)


def test_folder_of_another_user(machine, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode, **_: mode != os.W_OK)
    assert "cannot be written" in only_trouble(machine)


@pytest.mark.parametrize("name", ["my bench", "a:b", "quote'd"])
def test_path_that_the_build_tools_do_not_bear(machine, monkeypatch, tmp_path, name):
    (tmp_path / name).mkdir()
    monkeypatch.setattr(machine.machine, "ROOT", str(tmp_path / name))
    assert "move the folder" in only_trouble(machine)


@pytest.mark.parametrize(
    ("log", "sentence"),
    [
        ("ERROR: Could not install packages due to an OSError: [Errno 28] No space left on device", "disk is full"),
        ("WARNING: Retrying ... NewConnectionError('<pip...>: [Errno 111] Connection refused')", "cannot be reached"),
        ("Temporary failure in name resolution\nERROR: No matching distribution found for x==1", "cannot be reached"),
        ("ERROR: THESE PACKAGES DO NOT MATCH THE HASHES FROM THE REQUIREMENTS FILE.", "differs from the locked one"),
        ("ERROR: No matching distribution found for numpy==2.4.6", "does not offer a locked file"),
        ("CMake Error: No CMAKE_CXX_COMPILER could be found.", "compiler does not work"),
        ("error: ../msg/Level.msg:3: invalid type", "invalid type"),
    ],
)
def test_failure_is_explained_from_the_log(project, log, sentence):
    with project.launcher.set_up.only_set_up() as guard:
        runner = project.launcher.programs.StepRunner(
            "requirements", project.launcher.progress.Progress(1, 1, "x"), guard
        )
        with pytest.raises(project.launcher.places.SetupError) as failure:
            runner.run(["sh", "-c", f"cat <<'END'\n{log}\nEND\nexit 3"], dict(os.environ))
    assert sentence in str(failure.value)
    assert ".nmt/log/requirements.log" in str(failure.value)


def test_interrupt_ends_the_program_and_what_it_started(project):
    noted = project.root / "noted"
    command = ["sh", "-c", f"trap '' INT; sleep 300 & echo $! > {noted}; wait"]

    def interrupt_when_started():
        if noted.exists() and noted.read_text().strip():
            raise KeyboardInterrupt
        return ""

    with project.launcher.set_up.only_set_up() as guard:
        runner = project.launcher.programs.StepRunner("workspace", project.launcher.progress.Progress(1, 1, "x"), guard)
        with pytest.raises(KeyboardInterrupt):
            runner.run(command, dict(os.environ), interrupt_when_started)
    status = Path(f"/proc/{noted.read_text().strip()}/stat")
    for _ in range(500):  # its adopter may still have to bury it
        if not status.exists() or status.read_text().split()[2] == "Z":
            break
        time.sleep(0.01)
    else:
        pytest.fail("a program started by the interrupted one is still running")


def run_launcher(project, *arguments, **variables):
    """The launcher as a program of its own; what it says."""
    environment = {**os.environ, **variables}
    return subprocess.run(
        [sys.executable, str(project.root / "nmt"), *arguments], env=environment, capture_output=True, text=True
    )


@pytest.mark.parametrize(
    ("arguments", "variables", "code", "sentence"),
    [
        (["demo"], {"NMT_ROS": "apt"}, 2, "'wheels' or 'system'"),
        (["--system", "demo"], {}, 1, "not sourced"),
        (["demo"], {"NMT_PYTHON": "/bin/false"}, 2, "is not a Python"),
        (["setup", "--wheel"], {}, 2, "does not know '--wheel'"),
        (["doctor", "please"], {}, 2, "knows --json and nothing else"),
    ],
)
def test_refusals_are_one_sentence(project, arguments, variables, code, sentence):
    answer = run_launcher(project, *arguments, **variables)
    assert answer.returncode == code
    assert sentence in answer.stderr
    assert len(answer.stderr.splitlines()) == 1


def test_help_sets_nothing_up(project):
    for arguments in ([], ["--help"], ["-h"], ["setup", "--help"]):
        answer = run_launcher(project, *arguments)
        assert answer.returncode == 0
        assert answer.stdout.startswith("usage: ./nmt")
    assert project.calls() == []
    assert not (project.root / ".nmt").exists()
    assert not (project.root / ".venv").exists()


def test_doctor_before_the_set_up_changes_nothing(project):
    answer = run_launcher(project, "doctor", PIP_INDEX_URL="http://127.0.0.1:9/simple")
    assert answer.returncode == 1
    assert "not set up yet" in answer.stdout
    assert "does not answer" in answer.stdout
    assert not (project.root / ".nmt").exists()
