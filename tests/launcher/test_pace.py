"""What is left of a set-up, in words and as JSON; one command in the bench's environment."""

from __future__ import annotations

import json
import os

import pytest


def test_what_is_left_follows_what_finished_steps_took(launcher):
    pace = launcher.pace
    steps = list(pace.SECONDS)
    assert pace.estimated_seconds(steps, {}) == pytest.approx(sum(pace.SECONDS.values()))
    twice = {"seconds": {"environment": 2.0 * pace.SECONDS["environment"]}}
    assert pace.estimated_seconds(["workspace"], twice) == pytest.approx(2.0 * pace.SECONDS["workspace"])
    assert pace.estimated_seconds(["environment"], twice) == pytest.approx(2.0 * pace.SECONDS["environment"])
    assert pace.estimated_seconds([], twice) == 0.0


@pytest.mark.parametrize(
    ("seconds", "words"), [(59.0, "less than a minute left"), (60.0, "about 1 min left"), (200.0, "about 3 min left")]
)
def test_words_for_what_is_left(launcher, seconds, words):
    assert launcher.pace.left(seconds) == words


def test_the_progress_line_says_what_is_left_until_the_step_is_done(project, capsys):
    project.launcher.set_up.set_up(None)
    lines = capsys.readouterr().err.splitlines()
    begun = [line for line in lines if line.startswith("[1/4]")]
    assert begun[0].endswith("min left")
    assert begun[-1].endswith("done")
    assert set(project.launcher.stamps.read_state()["seconds"]) == set(project.launcher.stamps.STEPS)


def test_the_doctor_answers_in_json(project, capsys):
    doctor = project.launcher.doctor
    assert doctor.doctor(None, as_json=True) in (0, 1)
    found = json.loads(capsys.readouterr().out)
    assert set(found["set_up"]["pending"]) == set(project.launcher.stamps.STEPS)
    assert found["set_up"]["minutes_left"] > 1.0
    assert found["in_order"] == all(finding["kind"] != "fix" for finding in found["findings"])
    assert any("not set up yet" in finding["sentence"] for finding in found["findings"])


def test_one_command_runs_in_the_environment_of_the_bench(project, monkeypatch):
    become = {}
    monkeypatch.setattr(os, "execvpe", lambda *words: become.update(words=words) or (_ for _ in ()).throw(SystemExit))
    monkeypatch.setenv("SHELL", "/bin/sh")
    with pytest.raises(SystemExit):
        project.launcher.commands.open_shell({"source": "wheels", "python": "3.11"}, ["-c", "echo here"])
    path, words, environment = become["words"]
    assert (path, words) == ("/bin/sh", ["/bin/sh", "-c", "echo here"])
    assert environment["VIRTUAL_ENV"] == str(project.root / ".venv")


@pytest.mark.parametrize("words", [["-x"], ["-c"], ["echo"]])
def test_other_arguments_of_the_shell_are_refused(project, words):
    with pytest.raises(project.launcher.places.SetupError, match="takes nothing or -c COMMAND"):
        project.launcher.commands.open_shell({"source": "wheels", "python": "3.11"}, words)
