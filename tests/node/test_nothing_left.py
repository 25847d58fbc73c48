"""The watch over leftovers sees each kind of them."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import threading
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2; source the workspace")

from rclpy.context import Context


@pytest.fixture
def surroundings(request):
    path = Path(__file__).with_name("conftest.py")
    plugin = next(
        plugin
        for plugin in request.config.pluginmanager.get_plugins()
        if getattr(plugin, "__file__", None) and Path(plugin.__file__) == path
    )
    return plugin.Surroundings()


def test_a_child_process_is_seen(surroundings):
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as child:
        assert [line for line in surroundings.new() if f"child process {child.pid}:" in line]
        child.communicate(b"\n")
    assert surroundings.new() == []


def test_a_thread_is_seen_unless_it_is_a_daemon(surroundings):
    end = threading.Event()
    for daemon in (True, False):
        thread = threading.Thread(target=end.wait, name="stray", daemon=daemon)
        thread.start()
        assert surroundings.new() == ([] if daemon else ["thread stray"])
    end.set()
    thread.join()


def test_an_initialised_context_is_seen(surroundings, domain_id):
    context = Context()
    context.init(domain_id=domain_id)
    assert [line.split(" <")[0] for line in surroundings.new()] == ["initialised rclpy context"]
    context.shutdown()
    assert surroundings.new() == []


def test_messages_check_their_fields():
    if importlib.util.find_spec("nmt_msgs") is None:
        pytest.skip("needs the built workspace; source ros2_ws/install/setup.bash")
    from nmt_msgs.msg import Level

    with pytest.raises(AssertionError, match="amplitude"):
        Level().amplitude = "much"
