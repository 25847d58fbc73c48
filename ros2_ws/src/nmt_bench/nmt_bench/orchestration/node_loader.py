"""The program that loads what all nodes need once and forks each node from it; see `prepared_nodes` for the other side.

    python node_loader.py DESCRIPTOR [BLANKS]

It imports, says ``ready``, takes one request, forks, says the process ids, and ends. The processes that it leaves wait
until whoever adopts them lets them go: each takes one message from the channel, or ends where the channel does.

ROS 2's client library is not among what is imported here: its tracer starts threads as it is loaded, and a process with
threads must not be forked. Each node loads it itself; its messages, which take as long, are here.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import inspect
import json
import os
import resource
import runpy
import socket
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from nmt_core.processes.process_end import begin_group, end_process

READY, GO = b"ready", b"go"
ROOM = 1024
"""Characters of a node's command line that may be seen in the table of processes: the loader has as many blanks."""
MOST_DESCRIPTORS = 64

PREPARED = (
    "nmt_core.messages.bundle",
    "nmt_core.messages.command_judge",
    "nmt_core.dds_profile",
    "nmt_core.nodes.heartbeat",
    "nmt_core.nodes.identity",
    "nmt_core.nodes.launcher_watch",
    "nmt_core.nodes.link",
    "nmt_core.nodes.liveness",
    "nmt_core.nodes.transport",
    "nmt_core.processes.memory",
    "nmt_plant.devices.guarded_device",
    "nmt_plant.devices.hardware_rig",
    "nmt_plant.plant_core",
    "nmt_plant.plant_settings",
    "nmt_plant.real_time",
    "nmt_plant.devices.simulated_rig",
    "nmt_pll.loop_core",
    "nmt_sequencer.run_core",
    "nmt_sequencer.steering",
    "nmt_record.bag.message_definitions",
    "nmt_record.bag.run_recorder",
    "nmt_extract.extraction_core",
    "nmt_msgs.action",
    "nmt_msgs.msg",
    "nmt_msgs.srv",
    # What rclpy imports before and after its library.
    "ament_index_python",
    "asyncio",
    "builtin_interfaces.msg",
    "concurrent.futures.thread",
    "diagnostic_msgs.msg",
    "faulthandler",
    "importlib.metadata",
    "queue",
    "rcl_interfaces.msg",
    "rcl_interfaces.srv",
    "rosgraph_msgs.msg",
    "rosidl_generator_py",
    "rosidl_parser.parser",
    "service_msgs.msg",
    "std_msgs.msg",
    "std_srvs.srv",
    "type_description_interfaces.msg",
    "type_description_interfaces.srv",
    "unique_identifier_msgs.msg",
)
"""What nodes import and what neither starts threads nor opens anything."""

TYPE_SUPPORTS = (
    "action_msgs",
    "builtin_interfaces",
    "diagnostic_msgs",
    "nmt_msgs",
    "rcl_interfaces",
    "service_msgs",
    "std_msgs",
    "std_srvs",
    "type_description_interfaces",
    "unique_identifier_msgs",
)
"""Packages whose messages nodes send."""

_ARG_START, _ARG_END = 45, 46  # in /proc/PID/stat, counted from the state of the process on


def prepare() -> None:
    """Load what nodes need; what fails here is left for the node to complain about."""
    gc.disable()
    steps: list[Callable[[], object]] = [partial(importlib.import_module, name) for name in PREPARED]
    steps += [load_type_supports, read_definitions, load_kernels, _look_at_modules]
    for step in steps:
        with contextlib.suppress(Exception):
            step()
    gc.freeze()


def load_type_supports() -> None:
    """Load the middleware's support of the bench's messages."""
    load = importlib.import_module("rosidl_generator_py").import_type_support
    for package in TYPE_SUPPORTS:
        load(package)


def read_definitions() -> None:
    """Definitions of messages, which the recorder writes into bags."""
    from nmt_record.bag.bench_topics import BENCH_TOPICS
    from nmt_record.bag.message_definitions import local_definitions

    for topic in BENCH_TOPICS:
        local_definitions().definition(topic.message_type)


def load_kernels() -> None:
    """The time loop of a simulated rig, for the plant."""
    from nmt_plant.devices.simulated_rig import SimulatedRig
    from nmt_rig.rig import load_rig

    rig = SimulatedRig(load_rig("beam"))
    rig.configure()
    rig.start()
    rig.read()
    rig.close()


def _look_at_modules() -> None:
    """The first line that a node logs looks up the files of all modules."""
    inspect.getmodule(sys._getframe())


def threads() -> int:
    """Threads of this process, those of libraries too."""
    return len(os.listdir("/proc/self/task"))


def serve(channel: socket.socket) -> dict[str, Any] | None:
    """Answer one request for nodes.

    Args:
        channel: to whoever wants them, of the kind SOCK_SEQPACKET.

    Returns:
        In the process of a node that may begin: what it has to do. In the loader: None.
    """
    channel.send(READY if threads() == 1 else f"{threads()} threads".encode())
    message, descriptors, _, _ = socket.recv_fds(channel, 1, MOST_DESCRIPTORS)
    if not message:
        return None
    with open(descriptors[0], "rb") as file:
        request = json.load(file)
    processes: list[int] = []
    answer: dict[str, Any] = {"processes": processes}
    logs = descriptors[1 : 1 + len(request["nodes"])]
    for node, log in zip(request["nodes"], logs, strict=True):
        try:
            process = os.fork()
        except OSError as error:
            answer["error"] = str(error)
            break
        if process == 0:
            if channel.recv(len(GO)) != GO:
                os._exit(1)
            os.dup2(log, 1)
            os.dup2(log, 2)
            channel.close()
            for descriptor in logs:
                os.close(descriptor)
            for descriptor in descriptors[1 + len(logs) :]:
                os.set_inheritable(descriptor, True)  # held for as long as the node lives, whatever it is executed by
            return {**request, **node}
        processes.append(process)
    channel.send(json.dumps(answer).encode())
    return None


def become(node: dict[str, Any]) -> None:
    """Make this process what it would be, had it been started for the node alone.

    Args:
        node: ``command``, ``environment``, ``folder`` to work in (empty = as it is), ``files`` (limits of open ones)
            and ``launcher`` (process id of the parent).
    """
    begin_group()
    if os.getppid() != node["launcher"]:  # it has died in between, and its signal will not come
        os._exit(1)
    os.environ.clear()
    os.environ.update(node["environment"])
    if node["folder"]:
        os.chdir(node["folder"])
    resource.setrlimit(resource.RLIMIT_NOFILE, tuple(node["files"]))
    command = node["command"]
    if not runs_here(Path(command[0])):
        os.execve(command[0], command, os.environ)
    show_command([sys.executable, *command])
    sys.argv = list(command)
    sys.path.insert(0, os.path.dirname(command[0]))
    gc.enable()


def runs_here(program: Path) -> bool:
    """Whether a program is a script for the Python that runs here; others are started in the usual way."""
    try:
        with open(program, "rb") as file:
            first = file.readline(4096)
    except OSError:
        return False
    words = first[2:].decode(errors="replace").split()
    if not first.startswith(b"#!") or not words:
        return False
    interpreter = Path(words[0])
    return (
        interpreter.parent.resolve() == Path(sys.executable).parent.resolve()
        and interpreter.resolve() == Path(sys.executable).resolve()
    )


def show_command(command: Sequence[str]) -> None:
    """Have the table of processes show a command as the one of this process, cut to what the own one leaves room for.

    The name of the process becomes that of the script, as the kernel gives it.
    """
    Path("/proc/self/comm").write_bytes(os.path.basename(command[1]).encode()[:15])
    fields = Path("/proc/self/stat").read_text().rpartition(")")[2].split()
    start, end = int(fields[_ARG_START]), int(fields[_ARG_END])
    if 0 < start < end:  # zeros where the system does not tell
        text = b"\0".join(map(os.fsencode, command))[: end - start - 1]
        ctypes.memmove(start, text.ljust(end - start, b"\0"), end - start)


def main() -> None:
    """Serve; in the process of a node, run its script to its end."""
    if sys.path and sys.path[0] == os.path.dirname(os.path.abspath(__file__)):
        del sys.path[0]  # the neighbours of this file are not modules of their own
    channel = socket.socket(fileno=int(sys.argv[1]))
    prepare()
    node = serve(channel)
    if node is None:
        os._exit(0)  # nodes wait for the end of this process; to tidy up first would take a tenth of a second
    become(node)
    try:
        runpy.run_path(node["command"][0], run_name="__main__")
    except SystemExit as end:
        if end.code is None or isinstance(end.code, int):
            end_process(end.code or 0)
        raise


if __name__ == "__main__":
    main()
