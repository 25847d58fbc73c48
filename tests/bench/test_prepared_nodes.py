"""Nodes forked from one process: each is what it would be as a program of its own, and none is left."""

from __future__ import annotations

import contextlib
import ctypes
import importlib.util
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from nmt_bench.orchestration import adopted_process, node_loader, prepared_nodes
from nmt_bench.orchestration.adopted_process import AdoptedProcess, adopted_orphans, can_adopt
from nmt_bench.orchestration.bench_domain import BenchDomain, domains_in_use
from nmt_bench.orchestration.node_processes import NodeProcesses
from nmt_bench.orchestration.prepared_nodes import NodeCommand, NodeLoader, nodes_ahead, take_loader
from nmt_core.errors import BenchError
from nmt_core.processes.process_watch import state_of

pytestmark = pytest.mark.skipif(not can_adopt(), reason="no orphans are adopted here")
PATIENCE = 60.0  # s

SURROUNDINGS = """
import gc, json, os, resource, signal, sys, threading
from pathlib import Path
stat = Path("/proc/self/stat").read_text()
names = [name for name in signal.Signals.__members__ if name not in ("SIGKILL", "SIGSTOP")]
said = {
    "name": __name__,
    "argv": sys.argv,
    "first path": sys.path[0],
    "other paths": sys.path[1:],
    "python": sys.executable,
    "folder": os.getcwd(),
    "environment": dict(os.environ),
    "leads a group": os.getpgid(0) == os.getpid(),
    "session is that of its parent": os.getsid(0) == os.getsid(os.getppid()),
    "parent": os.getppid(),
    "signals": {name: str(signal.getsignal(getattr(signal, name))) for name in names},
    "blocked": sorted(map(int, signal.pthread_sigmask(signal.SIG_BLOCK, []))),
    "files": {number: os.readlink(f"/proc/self/fd/{number}") for number in (0, 1, 2)},
    "more files": [number for number in range(3, 64) if os.path.exists(f"/proc/self/fd/{number}")],
    "threads": threading.active_count(),
    "command": Path("/proc/self/cmdline").read_bytes().rstrip(b"\\0").decode().split("\\0"),
    "comm": Path("/proc/self/comm").read_text(),
    "limits": resource.getrlimit(resource.RLIMIT_NOFILE),
    "collector": gc.isenabled(),
    "scheduling": (os.sched_getscheduler(0), os.nice(0), sorted(os.sched_getaffinity(0))),
    "umask": os.umask(0o22),
}
print(json.dumps(said))
"""
# The same process without what real nodes import, which is a second of processor time.
LIGHT = f"""
import sys
sys.path[0] = {os.path.dirname(node_loader.__file__)!r}
import node_loader
node_loader.PREPARED = ()
for step in ("load_type_supports", "read_definitions", "load_kernels", "_look_at_modules"):
    setattr(node_loader, step, lambda: None)
node_loader.main()
"""
BUSY = "while True:\n    pass\n"
LONG = "import time\nprint('begun', flush=True)\ntime.sleep(600)\n"


@pytest.fixture(autouse=True)
def light(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        if request.node.name != "test_what_nodes_import_is_prepared_but_for_the_client_library":
            path = tmp_path_factory.mktemp("light") / "loader.py"
            path.write_text(LIGHT)
            patch.setattr(node_loader, "__file__", str(path))
        yield


def script(path: Path, text: str) -> Path:
    """A node in the place of a real one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text if text.startswith("#!") else f"#!{sys.executable}\n{text}")
    path.chmod(0o755)
    return path


def wait_until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def is_gone(process: int) -> bool:
    """Whether a process has ended and been waited for."""
    return not Path(f"/proc/{process}").exists()


def has_ended(process: int) -> bool:
    """Whether a process has ended, waited for or not."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] in "ZX"
    except OSError:
        return True


@contextlib.contextmanager
def forked(folder: Path, *texts: str) -> Iterator[tuple[NodeLoader, list[AdoptedProcess], list[Path]]]:
    """Nodes that have been forked and wait; their logs."""
    loader = NodeLoader()
    logs = [folder / f"{number}.log" for number in range(len(texts))]
    try:
        assert loader.can_fork()
        with contextlib.ExitStack() as stack:
            files = [stack.enter_context(open(log, "wb")) for log in logs]
            commands = [
                NodeCommand([str(script(folder / f"node{number}", text))], dict(os.environ), file.fileno())
                for number, (text, file) in enumerate(zip(texts, files, strict=True))
            ]
            nodes = loader.fork(commands)
        yield loader, nodes, logs
    finally:
        loader.close()


def a_bench(folder: Path, monkeypatch: pytest.MonkeyPatch, **texts: str) -> Callable[..., NodeProcesses]:
    """Makes the processes of a bench whose nodes are scripts."""
    packages = {"plant": "nmt_plant", "pll": "nmt_pll", "recorder": "nmt_record"}
    for name, text in texts.items():
        script(folder / "prefix" / "lib" / packages[name] / name, text)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(folder / "prefix"))
    plan: Any = SimpleNamespace(settings=dict.fromkeys(texts), write_parameters=lambda path: path.write_text("{}"))
    environment = {"ROS_DOMAIN_ID": "77", "HERE": "a b\nc"}
    return lambda loader, held=None: NodeProcesses(plan, folder / "out", environment, loader, held)


def test_a_forked_node_finds_what_one_of_its_own_finds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make = a_bench(tmp_path, monkeypatch, plant=SURROUNDINGS)
    said = []
    for loader in (NodeLoader(), None):
        monkeypatch.chdir(tmp_path)  # after the loader was started: the present folder counts
        nodes = make(loader)
        nodes.start()
        pid = nodes.pids["plant"]
        wait_until(lambda nodes=nodes: not nodes.is_alive("plant"))  # type: ignore[misc]
        log = (tmp_path / "out" / "log" / "plant.log").read_text()
        assert isinstance(nodes.processes["plant"], AdoptedProcess) == (loader is not None)
        nodes.end()
        assert is_gone(pid)
        if loader is not None:
            loader.close()
        said.append(json.loads(log))
    own = said[1]
    assert own["leads a group"]
    assert own["session is that of its parent"]
    assert own["parent"] == os.getpid()
    assert own["environment"]["HERE"] == "a b\nc"
    assert own["comm"] == "plant\n"
    assert own["command"][1] == str(tmp_path / "prefix" / "lib" / "nmt_plant" / "plant")
    for name, value in own.items():
        # The first word may be another name of the same Python.
        assert said[0][name] == value, name


def test_exit_codes_and_last_words_are_those_of_the_node(tmp_path: Path) -> None:
    texts = {
        "pass": 0,
        "import sys; sys.exit(3)": 3,
        "import no_such_module_of_this_node": 1,
        "raise RuntimeError('so it goes')": 1,
        "import os; os.kill(os.getpid(), 9)": -signal.SIGKILL,
        "import os; os.kill(os.getpid(), 2); import time; time.sleep(9)": -signal.SIGINT,
        "import atexit; atexit.register(print, 'tidied up')": 0,
        "#!/bin/sh\necho other program; exit 7": 7,
    }
    with forked(tmp_path, *texts) as (loader, nodes, logs):
        loader.release()
        assert [node.wait(PATIENCE) for node in nodes] == list(texts.values())
    assert all(is_gone(node.pid) for node in nodes)
    words = [log.read_text() for log in logs]
    assert words[2].endswith("No module named 'no_such_module_of_this_node'\n")
    assert words[3].endswith("RuntimeError: so it goes\n")
    assert words[6:] == ["tidied up\n", "other program\n"]


def test_a_folder_that_is_gone_hinders_no_node(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    with forked(tmp_path, "print('begun')") as (loader, nodes, logs):
        loader.release()
        assert nodes[0].wait(PATIENCE) == 0
    assert logs[0].read_text() == "begun\n"


def test_what_cannot_be_imported_ahead_is_the_nodes_own_complaint(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(node_loader, "PREPARED", ("no_such_module", "json"))
    for step in ("load_type_supports", "read_definitions", "load_kernels"):
        monkeypatch.setattr(node_loader, step, lambda: 1 / 0)
    try:
        node_loader.prepare()
    finally:
        node_loader.gc.enable()
        node_loader.gc.unfreeze()


def test_a_node_is_killed_stopped_and_ended_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nodes = a_bench(tmp_path, monkeypatch, plant=LONG, pll=LONG, recorder=LONG)(loader := NodeLoader())
    nodes.start()
    loader.close()
    pids = nodes.pids
    assert is_gone(loader.pid)
    log = tmp_path / "out" / "log"
    wait_until(lambda: all("begun" in (log / f"{name}.log").read_text() for name in pids))
    assert nodes.first_dead() == ""
    os.kill(pids["pll"], signal.SIGKILL)
    wait_until(lambda: nodes.first_dead() == "pll")
    assert nodes.last_words("pll").startswith("killed by SIGKILL")
    assert nodes.is_alive("plant")
    os.kill(pids["recorder"], signal.SIGSTOP)
    wait_until(lambda: " T " in Path(f"/proc/{pids['recorder']}/stat").read_text())
    assert nodes.is_alive("recorder")
    nodes.end()
    assert nodes.last_words("plant").startswith("killed by SIGTERM")
    assert all(is_gone(pid) for pid in pids.values())


def test_a_node_that_does_not_come_up_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nmt_bench.orchestration.node_processes.IDLE_START", 1.2)
    nodes = a_bench(tmp_path, monkeypatch, plant=BUSY, pll=LONG, recorder=LONG)(loader := NodeLoader())
    nodes.start()
    loader.close()
    stopped = nodes.pids["recorder"]
    os.kill(stopped, signal.SIGSTOP)
    wait_until(lambda: nodes.not_coming_up(["plant", "recorder"]) != "")
    said = nodes.not_coming_up(["plant", "recorder"])
    assert f"Node recorder does not come up: its process ({stopped}) is stopped" in said
    nodes.end()
    assert all(is_gone(pid) for pid in nodes.pids.values())


def test_a_stopped_node_does_not_outlive_its_launcher(tmp_path: Path) -> None:
    """The launcher is killed while a node is stopped; the kernel lets the node go on, and it hears of it."""
    program = f"""
import os, subprocess, sys, time
from nmt_core.processes.process_end import begin_group
node = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"], preexec_fn=begin_group)
os.kill(node.pid, {int(signal.SIGSTOP)})
print(node.pid, flush=True)
time.sleep(600)
"""
    launcher = subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    assert launcher.stdout is not None
    node = int(launcher.stdout.readline())
    wait_until(lambda: state_of(node) == "T")
    launcher.kill()
    launcher.wait()
    launcher.stdout.close()
    wait_until(lambda: state_of(node) in ("", "Z"))


def test_nothing_begins_before_it_is_let_go(tmp_path: Path) -> None:
    with forked(tmp_path, LONG, LONG) as (_, nodes, logs):
        time.sleep(0.2)
        assert [node.poll() for node in nodes] == [None, None]
    assert all(is_gone(node.pid) for node in nodes)
    assert [log.read_text() for log in logs] == ["", ""]


def test_a_system_without_room_for_processes_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    request = os.memfd_create("request")
    os.pwrite(request, json.dumps({"nodes": [{}]}).encode(), 0)

    def no_fork() -> int:
        raise BlockingIOError("no room")

    monkeypatch.setattr(node_loader.os, "fork", no_fork)
    with ours, theirs, open(tmp_path / "log", "wb") as log:
        socket.send_fds(ours, [b"!"], [request, log.fileno()])
        assert node_loader.serve(theirs) is None
        ours.recv(100)  # what it says of its threads
        answer = ours.recv(1000)
    os.close(request)
    assert json.loads(answer) == {"processes": [], "error": "no room"}
    loader = NodeLoader()
    try:
        assert loader.can_fork()
        monkeypatch.setattr(loader, "_answer", lambda: answer)
        with pytest.raises(BenchError, match=r"cannot be started \(no room\); end other programs"):
            loader.fork([])
    finally:
        loader.close()


@pytest.mark.parametrize("moment", ["importing", "ready"])
def test_a_killed_loader_is_a_sentence(moment: str, tmp_path: Path) -> None:
    loader = NodeLoader()

    def begin() -> None:
        with open(tmp_path / "log", "wb") as log:
            assert moment == "ready" or loader.can_fork()
            loader.fork([NodeCommand([str(script(tmp_path / "node", LONG))], dict(os.environ), log.fileno())])

    try:
        if moment == "ready":
            assert loader.can_fork()
        os.kill(loader.pid, signal.SIGKILL)
        with pytest.raises(BenchError, match=r"has ended \(killed by SIGKILL\) before they began"):
            begin()
    finally:
        loader.close()
    assert is_gone(loader.pid)


def test_a_loader_that_is_stopped_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(prepared_nodes, "LONGEST", 0.3)
    loader = NodeLoader()
    os.kill(loader.pid, signal.SIGSTOP)
    with pytest.raises(BenchError, match="it is stopped or hangs"):
        loader.can_fork()
    loader.close()
    loader.close()
    assert is_gone(loader.pid)


LAUNCHER = """
import os, sys, time
from nmt_bench.orchestration import node_loader
from nmt_bench.orchestration.prepared_nodes import NodeCommand, NodeLoader
node_loader.__file__ = sys.argv[4]
loader = NodeLoader()
print(loader.pid, flush=True)
if sys.argv[1] != "importing":
    loader.can_fork()
    log = os.open(sys.argv[2], os.O_WRONLY | os.O_CREAT)
    nodes = loader.fork([NodeCommand([sys.argv[3]], dict(os.environ), log)] * 3)
    if sys.argv[1] == "begun":
        loader.release()
    print(*(node.pid for node in nodes), flush=True)
time.sleep(600)
"""


@pytest.mark.parametrize("moment", ["importing", "forked", "begun"])
def test_nodes_end_with_a_killed_launcher(moment: str, tmp_path: Path) -> None:
    text = "import signal, time\nsignal.signal(signal.SIGTERM, lambda *_: exit(print('told to end')))\n" + LONG
    node, log = script(tmp_path / "node", text), tmp_path / "log"
    words = [sys.executable, "-c", LAUNCHER, moment, str(log), str(node), node_loader.__file__]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as launcher:
        assert launcher.stdout is not None
        processes = [int(launcher.stdout.readline())]
        if moment != "importing":
            processes += map(int, launcher.stdout.readline().split())
        if moment == "begun":
            wait_until(lambda: log.read_text().count("begun") == 3)
        launcher.kill()
    wait_until(lambda: all(map(has_ended, processes)))
    if moment != "importing":
        assert log.read_text().count("told to end") == (3 if moment == "begun" else 0)


@pytest.mark.parametrize("forks", [True, False])
def test_nodes_hold_the_domain_for_as_long_as_they_live(
    forks: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nodes of a launcher that was killed take their run to an end; nobody else may be in their domain meanwhile."""
    loader = NodeLoader() if forks else None
    domain = BenchDomain()
    nodes = a_bench(tmp_path, monkeypatch, plant=LONG, pll=LONG)(loader, domain.descriptor)
    try:
        nodes.start()
        assert isinstance(nodes.processes["plant"], AdoptedProcess) == forks
        if loader is not None:
            loader.close()
        domain.close()  # as the system does it for a launcher that is killed
        assert domain.id in domains_in_use()
        with pytest.raises(BenchError, match="in use by another bench"):
            BenchDomain(domain.id)
    finally:
        nodes.end()
    wait_until(lambda: domain.id not in domains_in_use())
    BenchDomain(domain.id).close()


def test_libraries_with_threads_are_not_forked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    library = "import threading, time\nthreading.Thread(target=time.sleep, args=(600,), daemon=True).start()\n"
    (tmp_path / "sitecustomize.py").write_text(library)
    with monkeypatch.context() as patch:
        patch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
        loader = NodeLoader()
    nodes = a_bench(tmp_path, monkeypatch, plant=LONG)(loader)
    try:
        nodes.start()
        assert isinstance(nodes.processes["plant"], subprocess.Popen)
    finally:
        nodes.end()
        loader.close()
    assert is_gone(loader.pid)


def test_without_adoption_each_node_is_started_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(adopted_process.sys, "platform", "darwin")
    assert not can_adopt()
    assert take_loader() is None
    with nodes_ahead():
        assert prepared_nodes.loaders_ahead == []


def test_a_loader_ahead_is_taken_once_or_ended() -> None:
    with nodes_ahead(False):
        assert prepared_nodes.loaders_ahead == []
    with nodes_ahead():
        unused = prepared_nodes.loaders_ahead[0].pid
    assert is_gone(unused)
    with nodes_ahead():
        loader = take_loader()
        assert loader is not None
        assert prepared_nodes.loaders_ahead == []
    assert not is_gone(loader.pid)
    loader.close()
    assert is_gone(loader.pid)


def adopts() -> bool:
    value = ctypes.c_int(-1)
    assert ctypes.CDLL(None).prctl(adopted_process.PR_GET_CHILD_SUBREAPER, ctypes.byref(value), 0, 0, 0) == 0
    return bool(value.value)


def test_orphans_are_adopted_for_a_moment_only() -> None:
    assert not adopts()
    with adopted_orphans():
        assert adopts()
    assert not adopts()


@pytest.mark.campaign
def test_benches_of_several_threads_start_their_nodes(tmp_path: Path) -> None:
    codes: list[int] = []

    def start(number: int) -> None:
        (tmp_path / str(number)).mkdir()
        with forked(tmp_path / str(number), "import sys; sys.exit(5)") as (loader, nodes, _):
            loader.release()
            codes.extend(node.wait(PATIENCE) for node in nodes)

    # The kernel ends a process with the thread that started it: these live until their nodes have ended.
    threads = [threading.Thread(target=start, args=(number,)) for number in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert codes == [5, 5, 5]


def test_a_stranger_is_not_adopted() -> None:
    with pytest.raises(ChildProcessError):
        AdoptedProcess(os.getppid())


REST = """
import importlib, sys
sys.path.insert(0, sys.argv[1])
import node_loader
node_loader.prepare()
print(node_loader.threads())
before = set(sys.modules)
for name in sys.argv[2:]:
    importlib.import_module(name)
print(*sorted(set(sys.modules) - before))
"""


def test_what_nodes_import_is_prepared_but_for_the_client_library() -> None:
    if importlib.util.find_spec("rclpy") is None or importlib.util.find_spec("nmt_msgs") is None:
        pytest.skip("needs ROS 2 and the built workspace; source ros2_ws/install/setup.bash")
    from nmt_session.node_plan import NODES

    modules = [where.partition(":")[0] for _, _, where in NODES.values()]
    words = [sys.executable, "-c", REST, os.path.dirname(node_loader.__file__), *modules]
    answer = subprocess.run(words, capture_output=True, text=True, check=True)
    threads, rest = answer.stdout.splitlines()
    assert threads == "1"
    left = [name for name in rest.split() if not name.startswith(("rclpy", "rpyutils", "tracetools"))]
    assert sorted(left) == sorted(["nmt_core.base_node", *modules])
