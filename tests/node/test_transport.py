"""Nobody on the network reaches a node: two network namespaces, a wire between them, a stranger at its other end."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from nmt_bench.orchestration.bench_domain import bench_environment
from nmt_core.dds_profile import PROFILE, two_host_profile

BENCH_ADDRESS, STRANGER_ADDRESS = "10.213.7.1", "10.213.7.2"
DOMAIN = 87
ATTACK = 3.0  # s of attack
PATIENCE = 30.0

# A node started by hand: nothing of the middleware is set but what base_node sets itself.
LISTENER = """
import json, os, sys, threading, time
import rclpy
from nmt_core.base_node import BenchNode, SAMPLES_QOS, spin_node
from nmt_msgs.msg import Drive

class Listener(BenchNode):
    def __init__(self):
        super().__init__(sys.argv[1], ())
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
import json, time
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
end = time.monotonic() + {ATTACK}
while time.monotonic() < end:
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
    """Two namespaces that only a wire connects; each has its own shared memory, as two hosts have."""

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
        # The host's shared memory would let the two ends meet where two hosts cannot.
        memory = "mount -t tmpfs none /dev/shm; " if where == self.stranger else ""
        command = ["ip", "netns", "exec", where, "sh", "-c", memory + 'exec "$@"', "sh"]
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
    [*((start, "static peers") for start in STARTS), ("by hand", "peer list in XML"), ("by hand", "multicast")],
)
def test_a_stranger_sees_and_reaches_nobody(wire, forms, start: str, form: str) -> None:
    bench, stranger = attack(wire, STARTS[start], forms[form])
    assert stranger == {"heard": 0, "nodes": []}
    assert set(bench["heard"]) == {"0.3"}  # the bench's own nodes do meet
    assert bench["nodes"] == ["listener", "pll"]
    assert {address for address, _ in bench["sockets"]} == {"0100007F"}


@pytest.mark.parametrize("form", ["static peers", "peer list in XML"])
def test_without_the_profile_the_stranger_drives(wire, forms, form: str) -> None:
    """The attack works where nothing stops it, so the test above can fail."""
    bench, stranger = attack(wire, {"NMT_TRANSPORT": "own", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, forms[form])
    assert bench["heard"].get("5.0", 0) > 0
    assert stranger["nodes"] == ["listener", "pll"]


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
