"""Folders in which the launcher cannot work, and readers of its output that leave."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def test_a_folder_with_a_strange_letter_is_refused_by_name(project):
    with pytest.raises(project.launcher.places.SetupError, match=r"has 'ü' in its name.*plain letters") as refusal:
        project.launcher.set_up.refuse_path("/home/lab/prüfstand")
    assert refusal.value.code == 2
    project.launcher.set_up.refuse_path("/home/lab/test bench-2")


def test_an_incomplete_set_up_of_somebody_else_is_said(project, monkeypatch):
    set_up = project.launcher.set_up

    def deny(*_: object, **__: object) -> int:
        raise PermissionError(13, "Permission denied")

    with monkeypatch.context() as patch:
        patch.setattr(os, "open", deny)
        with (
            pytest.raises(project.launcher.places.SetupError, match=r"have its owner run '\./nmt setup'") as refusal,
            set_up.only_set_up(),
        ):
            pass
    assert refusal.value.code == 2


def test_a_reader_that_leaves_gets_no_traceback():
    reading, writing = os.pipe()
    os.close(reading)
    try:
        answer = subprocess.run(
            [sys.executable, str(ROOT / "nmt"), "setup", "--help"], stdout=writing, stderr=subprocess.PIPE, text=True
        )
    finally:
        os.close(writing)
    assert "Traceback" not in answer.stderr
    assert answer.returncode == 1
