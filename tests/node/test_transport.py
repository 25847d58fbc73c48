"""Nobody on the network reaches a node: two network namespaces, a wire between them, a stranger at its other end."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from nmt_bench.orchestration.bench_domain import bench_environment
from nmt_core.dds_profile import PROFILE, two_host_profile
from nmt_core.processes.output_record import read_output
from nmt_core.vocabulary import LoopState, ResultCode
from nmt_record.bag.bag_reader import Bag
from nmt_session.node_plan import NODES, OUTPUT_RECORD, plan_nodes
from nmt_session.planning import plan_test

BENCH_ADDRESS, STRANGER_ADDRESS = "10.213.7.1", "10.213.7.2"
DOMAIN = 87
ATTACK = 4.0  # s of attack
PATIENCE = 30.0
LONGEST_RUN = 150.0

# A node started by hand: nothing of the middleware is set but what base_node sets itself.
LISTENER = """
import json, os, sys, threading, time
import rclpy
from nmt_core.base_node import BenchNode, SAMPLES_QOS, spin_node
from nmt_msgs.msg import Drive

class Listener(BenchNode):
    def __init__(self):
        super().__init__(sys.argv[1])
        self.heard = {}
        self.bench_subscription(Drive, "drive", self.on_drive, SAMPLES_QOS)
        self.sender = self.bench_publisher(Drive, "drive", SAMPLES_QOS) if len(sys.argv) > 2 else None
        self.create_timer(0.05, self.tick)
        threading.Thread(target=self.wait, daemon=True).start()

    def on_drive(self, message):
        self.heard[message.amplitude] = self.heard.get(message.amplitude, 0) + 1

    def tick(self):
        if self.sender:
            self.sender.publish(Drive(amplitude=float(sys.argv[2])))

    def wait(self):
        print("up", flush=True)
        sys.stdin.readline()
        sockets = []
        for line in open("/proc/net/udp").read().splitlines()[1:]:
            address, port = line.split()[1].split(":")
            sockets.append((address, int(port, 16)))
        names = sorted(self.get_node_names())
        print(json.dumps({"heard": self.heard, "nodes": names, "sockets": sockets}), flush=True)
        os._exit(0)

sys.exit(spin_node(Listener, args=[]))
"""

# The stranger uses plain rclpy and knows the address, the domain and the topic.
STRANGER = f"""
import json, os, time
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, HistoryPolicy, ReliabilityPolicy
from nmt_msgs.msg import Drive

rclpy.init()
node = Node("stranger")
qos = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)
sender = node.create_publisher(Drive, "drive", qos)
heard = []
node.create_subscription(Drive, "drive", heard.append, qos)
until_met = "UNTIL_MET" in os.environ  # long enough for any discovery; else for one that must not happen
end, met = time.monotonic() + ({PATIENCE} / 2 if until_met else {ATTACK}), 0
while time.monotonic() < end and not (until_met and met > 20):
    met += until_met and len(node.get_node_names()) > 2
    sender.publish(Drive(amplitude=5.0))
    rclpy.spin_once(node, timeout_sec=0.05)
names = sorted(set(node.get_node_names()) - {{"stranger"}})
print(json.dumps({{"heard": len([m for m in heard if m.amplitude != 5.0]), "nodes": names}}), flush=True)
"""

PEER_LIST = f"""<?xml version="1.0" encoding="UTF-8" ?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"><profiles>
<participant profile_name="stranger" is_default_profile="true"><rtps><builtin>
<initialPeersList><locator><udpv4><address>{BENCH_ADDRESS}</address></udpv4></locator></initialPeersList>
</builtin></rtps></participant></profiles></dds>
"""


def run_ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True)


@dataclass(frozen=True)
class Wire:
    """Two namespaces that only a wire connects; every process has shared memory of its own."""

    bench: str
    stranger: str

    def start(self, where: str, script: str, *arguments: str, **environment: str) -> subprocess.Popen[str]:
        """Start a script at one end of the wire, with no setting of the middleware but those given."""
        settings = {
            name: value
            for name, value in os.environ.items()
            if not name.startswith(("FAST", "RMW_FASTRTPS", "ROS_AUTOMATIC", "ROS_STATIC", "ROS_LOCALHOST"))
        }
        settings.update({"ROS_DOMAIN_ID": str(DOMAIN), **environment})
        # A node with other settings uses shared memory: the two ends would meet by it where two hosts cannot, and what
        # it leaves there would stay.
        command = ["ip", "netns", "exec", where, "sh", "-c", 'mount -t tmpfs none /dev/shm; exec "$@"', "sh"]
        return subprocess.Popen(
            [*command, sys.executable, "-c", script, *arguments],
            env=settings,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )


@pytest.fixture(scope="module")
def wire() -> Iterator[Wire]:
    if os.geteuid() != 0 or shutil.which("ip") is None:
        pytest.skip("network namespaces need root and the program 'ip' (package iproute2)")
    ends = Wire(f"nmt-bench-{os.getpid()}", f"nmt-stranger-{os.getpid()}")
    here, there = f"nmta{os.getpid() % 100000}", f"nmtb{os.getpid() % 100000}"
    try:
        try:
            for name in (ends.bench, ends.stranger):
                run_ip("netns", "add", name)
                run_ip("-n", name, "link", "set", "lo", "up")
            run_ip(
                "link", "add", here, "netns", ends.bench, "type", "veth", "peer", "name", there, "netns", ends.stranger
            )
        except subprocess.CalledProcessError as error:
            pytest.skip(f"this machine makes no network namespaces: {error.stderr.strip()}")
        for name, link, address in ((ends.bench, here, BENCH_ADDRESS), (ends.stranger, there, STRANGER_ADDRESS)):
            run_ip("-n", name, "address", "add", f"{address}/24", "dev", link)
            run_ip("-n", name, "link", "set", link, "up")
            run_ip("-n", name, "route", "add", "224.0.0.0/4", "dev", link)
        run_ip("netns", "exec", ends.stranger, "true")
        yield ends
    finally:
        for name in (ends.bench, ends.stranger):
            subprocess.run(["ip", "netns", "del", name], capture_output=True)


def up(process: subprocess.Popen[str]) -> None:
    assert process.stdout is not None
    line = process.stdout.readline()
    assert line == "up\n", process.stderr.read() if process.stderr else line


def answer(process: subprocess.Popen[str], say: str = "") -> dict:
    try:
        text, errors = process.communicate(say, timeout=PATIENCE)
    finally:
        process.kill()
        process.wait()
    assert text.strip(), errors
    return json.loads(text.strip().splitlines()[-1])


def attack(wire: Wire, bench: dict[str, str], stranger: dict[str, str]) -> tuple[dict, dict]:
    """Two nodes of a bench that talk to each other, and the stranger."""
    nodes = [
        wire.start(wire.bench, LISTENER, "listener", **bench),
        wire.start(wire.bench, LISTENER, "pll", "0.3", **bench),
    ]
    try:
        for node in nodes:
            up(node)
        seen = answer(wire.start(wire.stranger, STRANGER, **stranger))
        return answer(nodes[0], "end\n"), seen
    finally:
        for node in nodes:
            node.kill()
            node.communicate()


@pytest.fixture
def forms(tmp_path) -> dict[str, dict[str, str]]:
    """Ways of a stranger to name the bench."""
    peers = tmp_path / "peers.xml"
    peers.write_text(PEER_LIST)
    return {
        "static peers": {"ROS_STATIC_PEERS": BENCH_ADDRESS},
        "peer list in XML": {"FASTRTPS_DEFAULT_PROFILES_FILE": str(peers)},
        "multicast": {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"},
    }


# What the user may have set: nothing; what the launcher and the harness set; a range wider than the bench's.
STARTS = {
    "by hand": {},
    "by the launcher": {"FASTRTPS_DEFAULT_PROFILES_FILE": str(PROFILE), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
    "by the harness": bench_environment(DOMAIN),
    "range widened": {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_STATIC_PEERS": STRANGER_ADDRESS},
    "built-in transports asked for": {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"},
}


@pytest.mark.parametrize(
    ("start", "form"),
    [
        ("by hand", "static peers"),
        pytest.param("range widened", "static peers", marks=pytest.mark.campaign),
        *(pytest.param(start, "static peers", marks=pytest.mark.campaign) for start in STARTS if "by the" in start),
        pytest.param("built-in transports asked for", "static peers", marks=pytest.mark.campaign),
        pytest.param("by hand", "peer list in XML", marks=pytest.mark.campaign),
        pytest.param("by hand", "multicast", marks=pytest.mark.campaign),
    ],
)
def test_a_stranger_sees_and_reaches_nobody(wire, forms, start: str, form: str) -> None:
    bench, stranger = attack(wire, STARTS[start], forms[form])
    assert stranger == {"heard": 0, "nodes": []}
    assert set(bench["heard"]) == {"0.3"}  # the bench's own nodes do meet
    assert bench["nodes"] == ["listener", "pll"]
    assert {address for address, _ in bench["sockets"]} == {"0100007F"}


@pytest.mark.campaign
@pytest.mark.parametrize("form", ["static peers", "peer list in XML"])
def test_without_the_profile_the_stranger_drives(wire, forms, form: str) -> None:
    """The attack works where nothing stops it, so the test above can fail."""
    open_to_all = {"NMT_TRANSPORT": "own", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    bench, stranger = attack(wire, open_to_all, {**forms[form], "UNTIL_MET": "1"})
    assert bench["heard"].get("5.0", 0) > 0
    assert stranger["nodes"] == ["listener", "pll"]


@pytest.mark.campaign
def test_two_hosts_that_name_each_other_meet(wire, tmp_path) -> None:
    profiles = []
    for own, peer in ((BENCH_ADDRESS, STRANGER_ADDRESS), (STRANGER_ADDRESS, BENCH_ADDRESS)):
        profiles.append(tmp_path / f"{own}.xml")
        profiles[-1].write_text(two_host_profile(own, [peer]))
    here = wire.start(wire.bench, LISTENER, "plant", FASTRTPS_DEFAULT_PROFILES_FILE=str(profiles[0]))
    there = wire.start(wire.stranger, LISTENER, "pll", "0.3", FASTRTPS_DEFAULT_PROFILES_FILE=str(profiles[1]))
    try:
        up(here)
        up(there)
        time.sleep(ATTACK)
        bench = answer(here, "end\n")
    finally:
        for node in (here, there):
            node.kill()
            node.communicate()
    assert bench["nodes"] == ["plant", "pll"]
    assert bench["heard"].get("0.3", 0) > 10
    assert [place for place in bench["sockets"] if place[0] == "00000000"] == []


# One node of the bench by its class, as 'ros2 run' starts it.
NODE = """
import importlib, sys
module, name, parameters = sys.argv[1:4]
from nmt_core.base_node import spin_node
kind = getattr(importlib.import_module(module), name)
print("up", flush=True)
sys.exit(spin_node(kind, args=["node", "--ros-args", "--params-file", parameters]))
"""

# Sends the goal and prints how the run ends; a line for every change of the loop's state.
CLIENT = """
import json, sys
import rclpy
from rclpy.action import ActionClient
from rclpy.node import Node
from nmt_core.dds_profile import seal_transport
from nmt_msgs.action import RunLevels

seal_transport()
rclpy.init()
node = Node("operator")
client = ActionClient(node, RunLevels, "run_levels")
print("up", flush=True)
client.wait_for_server()
states = []
def on_feedback(message):
    if message.feedback.state not in states:
        states.append(message.feedback.state)
        print(json.dumps({"state": message.feedback.state}), flush=True)
sent = client.send_goal_async(RunLevels.Goal(**json.loads(sys.argv[1])), feedback_callback=on_feedback)
rclpy.spin_until_future_complete(node, sent)
result = sent.result().get_result_async()
rclpy.spin_until_future_complete(node, result)
answer = result.result().result
print(json.dumps({"code": answer.result_code, "message": answer.message}), flush=True)
"""


@contextlib.contextmanager
def two_host_bench(wire: Wire, folder: Path, periods: int) -> Iterator[tuple[subprocess.Popen[str], dict]]:
    """The plant on one host, all other nodes and the operator on the other; the operator's process and the plant's."""
    late = {"sequencer": {"ready_timeout": 90.0}}
    test = plan_test(
        # What waits at the output is put out after the cut: 0.36 s beside the watchdog's 1 s and the ramp of 0.1 s.
        "beam",
        [0.3],
        pacing="realtime",
        latency_blocks=18,
        window_periods=periods,
        timeout=60.0,
        node_values=late,
    )
    rig_file = folder / "rig.yaml"
    rig_file.write_text(test.rig_yaml)
    plan = plan_nodes(test, folder / "bag", rig_file)
    plan.write_parameters(folder / "nodes.yaml")
    profiles = {}
    for own, peer in ((BENCH_ADDRESS, STRANGER_ADDRESS), (STRANGER_ADDRESS, BENCH_ADDRESS)):
        profiles[own] = folder / f"{own}.xml"
        profiles[own].write_text(two_host_profile(own, [peer]))
    processes = []
    try:
        for name, (_, _, where) in NODES.items():
            host, address = (wire.stranger, STRANGER_ADDRESS) if name == "plant" else (wire.bench, BENCH_ADDRESS)
            module, _, kind = where.partition(":")
            profile = {"FASTRTPS_DEFAULT_PROFILES_FILE": str(profiles[address])}
            processes.append(wire.start(host, NODE, module, kind, str(folder / "nodes.yaml"), **profile))
            up(processes[-1])
        profile = {"FASTRTPS_DEFAULT_PROFILES_FILE": str(profiles[BENCH_ADDRESS])}
        client = wire.start(wire.bench, CLIENT, json.dumps(plan.goal), **profile)
        processes.append(client)
        up(client)
        yield client, dict(zip(NODES, processes, strict=False))
    finally:
        for process in reversed(processes):
            process.terminate()
        for process in reversed(processes):
            try:
                process.communicate(timeout=PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.communicate()


def heard(client: subprocess.Popen[str], key: str, wanted: object = None) -> dict:
    """The next line of the operator that has a key, and a value if one is wanted."""
    assert client.stdout is not None
    limit = threading.Timer(LONGEST_RUN, client.kill)
    limit.start()
    try:
        for line in client.stdout:
            words = json.loads(line)
            if key in words and wanted in (None, words[key]):
                return words
    finally:
        limit.cancel()
    raise AssertionError("the operator has ended, or says nothing")


@pytest.mark.campaign
def test_a_run_on_two_hosts_has_no_gap(wire: Wire, tmp_path: Path) -> None:
    with two_host_bench(wire, tmp_path, 60) as (client, _):
        answer = heard(client, "code")
        end = time.monotonic() + PATIENCE
        while not (tmp_path / "bag" / "metadata.yaml").exists() and time.monotonic() < end:
            time.sleep(0.1)
    assert answer["code"] == ResultCode.SUCCEEDED, answer
    for topic in ("force", "acceleration", "voltage"):
        blocks = list(Bag.open(tmp_path / "bag").blocks(topic))
        assert [block.first_sample for block in blocks] == list(range(0, 200 * len(blocks), 200))
        assert len(blocks) > 200


@pytest.mark.campaign
def test_a_wire_that_is_cut_takes_the_drive_to_zero(wire: Wire, tmp_path: Path) -> None:
    record = tmp_path / OUTPUT_RECORD
    link = f"nmta{os.getpid() % 100000}"
    with two_host_bench(wire, tmp_path, 5000) as (client, nodes):
        heard(client, "state", LoopState.LOCKED)
        before = len(read_output(record))
        run_ip("-n", wire.bench, "link", "set", link, "down")
        cut = time.monotonic()
        try:
            end = cut + PATIENCE
            while not any(line.state == "HELD" for line in read_output(record)[before:]):
                assert time.monotonic() < end
                time.sleep(0.02)
            time.sleep(2.0)
            lines = read_output(record)
            assert lines[-1].state == "HELD", "latched"
            assert nodes["plant"].poll() is None, "the plant lives and measures on"
        finally:
            run_ip("-n", wire.bench, "link", "set", link, "up")
            run_ip("-n", wire.bench, "route", "replace", "224.0.0.0/4", "dev", link)
    following = [line for line in lines[:before] if line.state == "FOLLOWING"][-1]
    held = lines[-1]
    # Commands stop; and a plant whose middleware waits for the lost host is late for its own output. Either is enough.
    assert held.reason.startswith(("watchdog: no drive command", "no block was there", "not fed for"))
    # What the converter's clock lost on a busy machine is not a time of the drive.
    slip = (held.time - following.time) - (held.sample - following.sample) / 10_000.0
    assert held.time - cut - max(slip, 0.0) <= 1.5
