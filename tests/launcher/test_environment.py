"""Commands run in an environment that holds this workspace and nothing of another ROS 2."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from .conftest import ROOT

STATE = {"source": "wheels", "python": f"{sys.version_info[0]}.{sys.version_info[1]}"}
SEARCH_PATHS = ("PYTHONPATH", "LD_LIBRARY_PATH", "AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH")


def fake_ros(folder):
    """Folders of a sourced ROS 2: its Python modules and its libraries."""
    (folder / "python" / "rclpy").mkdir(parents=True)
    (folder / "python" / "rclpy" / "_rclpy_pybind11.cpython-312-x86_64-linux-gnu.so").touch()
    (folder / "lib").mkdir()
    (folder / "lib" / "librcutils.so").touch()
    return folder / "python", folder / "lib"


def test_another_ros_does_not_leak_in_and_other_libraries_stay(project, monkeypatch, tmp_path):
    modules, libraries = fake_ros(tmp_path / "jazzy")
    card = tmp_path / "card"
    card.mkdir()
    monkeypatch.setenv("PYTHONPATH", str(modules))
    monkeypatch.setenv("LD_LIBRARY_PATH", f"{libraries}:/x/site-packages/ros_rcl.libs:{card}")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "jazzy"))
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")
    monkeypatch.setenv("PYTHONHOME", "/other")
    environment = project.launcher.environment.command_environment(STATE)
    assert all(str(tmp_path / "jazzy") not in environment[name] for name in SEARCH_PATHS)
    assert environment["LD_LIBRARY_PATH"].split(":")[-1] == str(card)
    assert "ros_rcl.libs" not in environment["LD_LIBRARY_PATH"]
    assert environment["RMW_IMPLEMENTATION"] == "rmw_fastrtps_cpp"
    assert "PYTHONHOME" not in environment


def test_system_ros_stays_behind_the_workspace(project, monkeypatch, tmp_path):
    modules, libraries = fake_ros(tmp_path / "jazzy")
    monkeypatch.setenv("PYTHONPATH", str(modules))
    monkeypatch.setenv("LD_LIBRARY_PATH", str(libraries))
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")
    environment = project.launcher.environment.command_environment({"source": "system", "python": "3.12"})
    assert environment["PYTHONPATH"].split(":")[-1] == str(modules)
    assert environment["LD_LIBRARY_PATH"].split(":")[-1] == str(libraries)
    assert environment["RMW_IMPLEMENTATION"] == "rmw_cyclonedds_cpp"
    assert "_ROS_WHEELS_BOOTSTRAP_COMPLETE" not in environment


def test_defaults_give_way_to_the_user(project, monkeypatch):
    for name in ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OPENBLAS_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    environment = project.launcher.environment.command_environment(STATE)
    assert environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert environment["OPENBLAS_NUM_THREADS"] == "1"
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "4")
    environment = project.launcher.environment.command_environment(STATE)
    assert environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET"
    assert environment["OPENBLAS_NUM_THREADS"] == "4"


def test_logs_have_a_place_without_a_home(project, monkeypatch):
    monkeypatch.delenv("HOME")
    monkeypatch.delenv("ROS_LOG_DIR", raising=False)
    assert project.launcher.environment.command_environment(STATE)["ROS_LOG_DIR"].startswith(str(project.root))


def test_source_follows_the_user_then_the_set_up_then_what_is_sourced(project, monkeypatch, tmp_path):
    choose = project.launcher.machine.choose_source
    assert choose(None, {}) == "wheels"
    modules, _ = fake_ros(tmp_path / "jazzy")
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    assert choose(None, {}) == "wheels"  # nothing importable yet
    monkeypatch.setenv("PYTHONPATH", f":{modules}")
    assert project.launcher.machine.sourced_python() == "3.12"
    assert choose(None, {}) == "system"
    assert choose(None, {"source": "wheels"}) == "wheels"
    assert choose("system", {"source": "wheels"}) == "system"
    monkeypatch.setenv("NMT_ROS", "wheels")
    assert choose(None, {"source": "system"}) == "wheels"
    monkeypatch.delenv("NMT_ROS")
    monkeypatch.setenv("ROS_DISTRO", "humble")
    assert choose(None, {}) == "wheels"


def test_sourced_ros_for_a_python_without_lock_is_refused(project, monkeypatch, tmp_path):
    modules, _ = fake_ros(tmp_path / "jazzy")
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    monkeypatch.setenv("PYTHONPATH", str(modules))
    project.write("requirements/lock/system-3.9.txt", "")
    with pytest.raises(project.launcher.places.SetupError, match=r"built for Python 3\.12"):
        project.launcher.set_up.set_up(None)


def test_environment_is_that_of_the_workspaces_setup_file(launcher, monkeypatch):
    setup = ROOT / "ros2_ws" / "install" / "setup.bash"
    if not setup.exists():
        pytest.skip("the workspace is not built")
    for name in (*SEARCH_PATHS, "COLCON_PREFIX_PATH"):
        monkeypatch.delenv(name, raising=False)
    script = f". {setup} && exec env -0"
    lines = subprocess.run(["bash", "-c", script], check=True, capture_output=True, text=True).stdout.split("\0")
    sourced = dict(line.split("=", 1) for line in lines if "=" in line)
    computed = launcher.environment.command_environment(STATE)
    for name in ("PYTHONPATH", "LD_LIBRARY_PATH", "AMENT_PREFIX_PATH"):
        ours = [f for f in sourced[name].split(":") if f.startswith(str(ROOT / "ros2_ws"))]
        assert ours
        assert set(ours) <= set(computed[name].split(":"))


def test_unknown_executable_is_answered_with_those_there_are(project):
    project.launcher.set_up.set_up(None)
    node = project.write("ros2_ws/install/nmt_pll/lib/nmt_pll/pll", "#!/bin/sh\n")
    node.chmod(0o755)
    assert project.launcher.commands.executables() == {"nmt_pll": ["pll"]}
    with pytest.raises(project.launcher.places.SetupError, match="nmt_pll pll") as refusal:
        project.launcher.commands.run_node({**STATE}, ["nmt_pll", "loop"])
    assert refusal.value.code == 2


def test_node_gets_its_arguments_and_the_environment(project):
    project.launcher.set_up.set_up(None)
    script = '#!/bin/sh\necho "$@" "$ROS_AUTOMATIC_DISCOVERY_RANGE"\n'
    project.write("ros2_ws/install/nmt_pll/lib/nmt_pll/pll", script).chmod(0o755)
    environment = {k: v for k, v in os.environ.items() if k != "ROS_AUTOMATIC_DISCOVERY_RANGE"}
    command = [sys.executable, str(project.root / "nmt"), "ros", "nmt_pll", "pll", "--ros-args", "-p", "a:=1"]
    answer = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert answer.stdout == "--ros-args -p a:=1 LOCALHOST\n"
