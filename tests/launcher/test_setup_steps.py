"""The set-up does what is missing and no more, and goes on where it stopped."""

from __future__ import annotations

import contextlib
import fcntl
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

FIRST = ["venv", "pip install first.txt", "pip install wheels-3.11.txt", "colcon nmt_msgs nmt_pll"]


def test_first_use_does_every_step_and_the_second_none(project):
    state = project.launcher.set_up.set_up(None)
    assert project.calls() == FIRST
    assert (state["source"], state["python"]) == ("wheels", "3.11")
    project.launcher.set_up.set_up(None)
    assert project.calls() == []


@pytest.mark.parametrize(
    ("failing", "first", "second"),
    [("venv", ["venv"], FIRST), ("pip", FIRST[:2], FIRST[1:]), ("colcon", FIRST, FIRST[3:])],
)
def test_interrupted_set_up_goes_on_where_it_stopped(project, failing, first, second):
    marker = project.write("fail-at-" + failing, "")
    with pytest.raises(project.launcher.places.SetupError, match="disk is full"):
        project.launcher.set_up.set_up(None)
    assert project.calls() == first
    marker.unlink()
    project.launcher.set_up.set_up(None)
    assert project.calls() == second


def test_changed_message_rebuilds_its_package_only(project):
    project.launcher.set_up.set_up(None)
    project.calls()
    project.write("ros2_ws/src/nmt_msgs/msg/Level.msg", "float64 amplitude\nuint32 index\n")
    project.launcher.set_up.set_up(None)
    assert project.calls() == ["colcon nmt_msgs"]
    project.write("ros2_ws/src/nmt_msgs/msg/Lock.msg", "uint64 sample\n")
    project.launcher.set_up.set_up(None)
    assert project.calls() == ["colcon nmt_msgs"]


def test_new_or_edited_python_file_needs_nothing(project):
    project.launcher.set_up.set_up(None)
    project.calls()
    project.write("ros2_ws/src/nmt_pll/nmt_pll/phase_loop/gains.py", "GAIN = 2\n")
    project.write("ros2_ws/src/nmt_pll/nmt_pll/detection/lock.py", "")
    project.launcher.set_up.set_up(None)
    assert project.calls() == []


def test_changed_entry_points_rebuild_their_package(project):
    project.launcher.set_up.set_up(None)
    project.calls()
    project.write("ros2_ws/src/nmt_pll/setup.py", "setup(entry_points={})\n")
    project.launcher.set_up.set_up(None)
    assert project.calls() == ["colcon nmt_pll"]


def test_new_package_is_built_and_a_removed_one_forgotten(project):
    project.launcher.set_up.set_up(None)
    project.calls()
    added = project.write("ros2_ws/src/nmt_more/package.xml", "<package/>")
    project.launcher.set_up.set_up(None)
    assert project.calls() == ["colcon nmt_more"]
    added.unlink()
    state = project.launcher.set_up.set_up(None)
    assert project.calls() == []
    assert sorted(state["workspace"]) == ["nmt_msgs", "nmt_pll"]
    assert not (project.root / "ros2_ws/install/nmt_more").exists()


def test_deleted_install_folder_is_built_again(project):
    project.launcher.set_up.set_up(None)
    project.calls()
    (project.root / "ros2_ws/install/nmt_pll/share/nmt_pll/package.xml").unlink()
    project.launcher.set_up.set_up(None)
    assert project.calls() == ["colcon nmt_pll"]


def test_changed_lock_file_touches_the_requirements_only(project):
    project.launcher.set_up.set_up(None)
    project.calls()
    project.write("requirements/lock/wheels-3.11.txt", "numpy==2.1\nsetuptools==79.0.1\n")
    site = project.root / ".venv/lib/python3.11/site-packages"
    (site / "yaml-1.0.dist-info").mkdir(parents=True)
    project.launcher.set_up.set_up(None)
    assert project.calls() == ["pip uninstall yaml", *FIRST[1:3]]


def test_kernels_are_cached_once_their_module_exists(project):
    project.launcher.set_up.set_up(None)
    project.calls()
    project.write("ros2_ws/src/nmt_bench/nmt_bench/warm_up.py", "")
    project.launcher.set_up.set_up(None)
    project.launcher.kernels.wait_for_later()
    asked = project.calls()
    parts = [line.partition(" ")[2] for line in asked if line.startswith("nmt_bench.warm_up")]
    assert sorted(parts) == ["records", "reference", "responses", "test"]  # at one time
    assert "OPENBLAS_NUM_THREADS=1" in asked
    project.launcher.set_up.set_up(None)
    assert project.calls() == []


def test_a_command_that_computes_nothing_leaves_the_kernels_to_the_next(project):
    project.write("ros2_ws/src/nmt_bench/nmt_bench/warm_up.py", "")
    project.launcher.set_up.set_up(None, compiled=False)
    assert project.calls() == FIRST
    project.launcher.set_up.set_up(None, compiled=False)
    assert project.calls() == []
    project.launcher.set_up.set_up(None)
    project.launcher.kernels.wait_for_later()
    assert any("nmt_bench.warm_up" in line for line in project.calls())


def test_kernels_of_the_background_are_waited_for_by_who_needs_them_and_end_with_the_set_up(project, monkeypatch):
    project.write("ros2_ws/src/nmt_bench/nmt_bench/warm_up.py", "")
    project.write("hold-records", "")
    kernels = project.launcher.kernels
    kernels.start_later(project.launcher.set_up.set_up(None))
    waiting = threading.Thread(target=kernels.wait_for_later)
    waiting.start()
    waiting.join(0.5)
    assert waiting.is_alive()
    kernels.start_later({})  # one is under way: nothing is started
    held = project.root / "held"
    end = time.monotonic() + 60
    while not held.exists():
        assert time.monotonic() < end
        time.sleep(0.02)
    kernels.end_later()
    waiting.join(60)
    assert not waiting.is_alive()
    assert project.calls().count("nmt_bench.warm_up records") == 1


@pytest.mark.parametrize("name", ["kernel.py", "local_elements/springs.py"])
def test_after_a_change_of_a_kernel_they_are_used_once_more_and_what_is_cached_stays(project, name):
    """The cache is keyed by the formulas: what the change does not reach is read from it."""
    first, other = ("from numba import njit", "# another") if name == "kernel.py" else ("x = 1", "+ 1")
    kernel = project.write(f"ros2_ws/src/nmt_plant/nmt_plant/{name}", f"{first}\n")
    project.write("ros2_ws/src/nmt_plant/nmt_plant/plain.py", "x = 1\n")
    project.write("ros2_ws/src/nmt_bench/nmt_bench/warm_up.py", "")
    project.launcher.set_up.set_up(None)
    cached = kernel.parent / "__pycache__" / "kernels" / "kernel.f-0123456789abcdef.1.nbc"
    cached.parent.mkdir(parents=True)
    cached.write_text("old")
    project.calls()
    project.write("ros2_ws/src/nmt_plant/nmt_plant/plain.py", "x = 2\n")
    project.launcher.set_up.set_up(None)
    assert "nmt_bench.warm_up test" not in project.calls()
    project.write(f"ros2_ws/src/nmt_plant/nmt_plant/{name}", f"{first}  {other}\n")
    project.launcher.set_up.set_up(None)
    project.launcher.kernels.wait_for_later()
    assert "nmt_bench.warm_up test" in project.calls()
    assert cached.exists()


def test_kernels_are_compiled_beside_the_build_and_ended_with_it(project):
    """The build fails once the compilation, which would take minutes, is under way."""
    project.write("ros2_ws/src/nmt_bench/nmt_bench/warm_up.py", "")
    project.write("hold-test", "")
    project.write("fail-at-colcon", "")
    with pytest.raises(project.launcher.places.SetupError):
        project.launcher.set_up.set_up(None)
    pid = int((project.root / "held").read_text())
    assert not Path(f"/proc/{pid}").exists()
    (project.root / "hold-test").unlink()
    (project.root / "fail-at-colcon").unlink()
    project.calls()
    state = project.launcher.set_up.set_up(None)
    project.launcher.kernels.wait_for_later()
    assert "nmt_bench.warm_up test" in project.calls()
    assert project.launcher.stamps.pending_steps(state) == []


def test_failing_kernels_do_not_stop_the_bench(project, capsys):
    project.write("ros2_ws/src/nmt_bench/nmt_bench/warm_up.py", "")
    project.write("fail-at-nmt_bench.warm_up", "")
    project.launcher.set_up.set_up(None)
    assert "could not be compiled beforehand" in capsys.readouterr().err


def test_moved_project_is_set_up_anew(project, tmp_path_factory, monkeypatch):
    state = project.launcher.set_up.set_up(None)
    assert project.launcher.stamps.pending_steps(state) == []
    monkeypatch.setattr(project.launcher.stamps, "ROOT", str(tmp_path_factory.mktemp("elsewhere")))
    assert project.launcher.stamps.pending_steps(state)[0] == "environment"


def test_vanished_interpreter_is_replaced(project):
    project.launcher.set_up.set_up(None)
    project.calls()
    (project.root / ".venv/bin/python").unlink()
    project.launcher.set_up.set_up(None)
    assert project.calls() == FIRST


def test_fresh_set_up_discards_the_old_one(project):
    project.launcher.set_up.set_up(None)
    project.calls()
    assert project.launcher.commands.main(["setup", "--fresh"]) == 0
    assert project.calls() == FIRST


@pytest.mark.parametrize("text", ["", "{", "[]", '{"source": "wheels"}'])
def test_unreadable_stamps_mean_a_new_set_up(project, text):
    project.launcher.set_up.set_up(None)
    project.calls()
    Path(project.launcher.places.STATE_FILE).write_text(text)
    project.launcher.set_up.set_up(None)
    assert project.calls() == FIRST


def test_second_set_up_waits_for_the_first(project):
    os.makedirs(project.launcher.places.STATE_FOLDER)
    with open(os.path.join(project.launcher.places.STATE_FOLDER, "lock"), "w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        second = threading.Thread(target=project.launcher.set_up.set_up, args=(None,))
        second.start()
        second.join(0.5)
        assert second.is_alive()
        assert project.calls() == []
    second.join(60)
    assert not second.is_alive()
    assert project.calls() == FIRST


def test_killed_launcher_leaves_its_lock_to_the_program_it_started(project):
    held = os.path.join(project.root, "still-running")
    runner_script = (
        f"import os, sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "from conftest import load_launcher; from pathlib import Path\n"
        f"launcher = load_launcher(Path({str(project.root)!r}))\n"
        "with launcher.set_up.only_set_up() as guard:\n"
        "    runner = launcher.programs.StepRunner('requirements', launcher.progress.Progress(1, 1, 'x'), guard)\n"
        f"    runner.run(['sh', '-c', 'touch {held}; sleep 60'], dict(os.environ))\n"
    )
    process = subprocess.Popen([sys.executable, "-c", runner_script], stderr=subprocess.DEVNULL)
    end = time.monotonic() + 60
    while not os.path.exists(held):
        assert time.monotonic() < end
        time.sleep(0.02)
    child = int(Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()[0])
    process.kill()
    process.wait()
    try:
        with open(os.path.join(project.launcher.places.STATE_FOLDER, "lock")) as lock:
            with pytest.raises(BlockingIOError):
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.killpg(child, signal.SIGKILL)
            fcntl.flock(lock, fcntl.LOCK_EX)  # free as soon as the program is gone
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)


@pytest.mark.parametrize(("source", "cpp"), [("wheels", "OFF"), ("system", "ON")])
def test_messages_have_no_cpp_part_where_ros_comes_from_wheels(project, source, cpp):
    asked = []

    class Runner:
        def run(self, command, *_, **__):
            asked.extend(command)
            raise KeyboardInterrupt

    project.launcher.set_up.set_up(None)
    with pytest.raises(KeyboardInterrupt):
        project.launcher.workspace.build_workspace({"source": source, "python": "3.11"}, Runner())
    assert f"-DNMT_MSGS_CPP={cpp}" in asked
