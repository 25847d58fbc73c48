"""``./nmt doctor``: checks this machine and the set-up, and says how to fix what is wrong."""

from __future__ import annotations

import contextlib
import ctypes.util
import glob
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from typing import Any

from .distributions import installed, pins_of
from .environment import command_environment
from .kernels import later_progress
from .machine import choose_python, choose_source, machine_troubles, sourced_python
from .pace import estimated_seconds
from .places import FAILED, ROOT, VENV_PYTHON, SetupError
from .stamps import STEPS, expected_stamps, is_built, lock_file, packages, packages_to_build, pending_steps, read_state

IMPORT_CHECK = """
import numpy, scipy, numba, rosbags, rclpy
from nmt_msgs.msg import SampleBlock
from nmt_msgs.action import RunLevels
SampleBlock(); RunLevels.Goal()
"""

DISCOVERY_CHECK = """
import sys, time
import rclpy
import rclpy.executors
from std_msgs.msg import Empty
rclpy.init()
role = sys.argv[1]
node = rclpy.create_node("nmt_doctor_" + role)
heard = []
publisher = None
if role == "listen":
    node.create_subscription(Empty, "nmt_doctor", heard.append, 10)
else:
    publisher = node.create_publisher(Empty, "nmt_doctor", 10)
end = time.monotonic() + 15
try:
    while rclpy.ok() and time.monotonic() < end and not heard:
        if publisher:
            publisher.publish(Empty())
        rclpy.spin_once(node, timeout_sec=0.05)
except (KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
    pass
rclpy.try_shutdown()
sys.exit(0 if heard else 1)
"""


class Findings:
    """The doctor's lines; counts those that need fixing.

    Args:
        quiet: keep the lines in ``lines`` and print none.
    """

    def __init__(self, quiet: bool = False) -> None:
        self.bad, self.quiet = 0, quiet
        self.lines: list[dict[str, str]] = []

    def ok(self, what: str) -> None:
        """Nothing to do."""
        self._line("ok", what)

    def fix(self, what: str) -> None:
        """Something to do."""
        self.bad += 1
        self._line("FIX", what)

    def note(self, what: str) -> None:
        """Good to know, nothing wrong."""
        self._line("note", what)

    def _line(self, mark: str, what: str) -> None:
        self.lines.append({"kind": mark.lower(), "sentence": what})
        if self.quiet:
            return
        sys.stdout.write(f"{mark:>5}  {what}\n")
        sys.stdout.flush()


def examine_machine(findings: Findings, source: str, state: dict[str, Any]) -> None:
    """Checks that need no set-up."""
    try:
        if state.get("environment") and os.path.exists(VENV_PYTHON):
            findings.ok(f"Python {state['python']} in .venv, started by Python {sys.version.split()[0]}")
        else:
            path, version = choose_python(source)
            findings.ok(f"Python {version} with venv ({path})")
    except SetupError as trouble:
        findings.fix(str(trouble))
    troubles = machine_troubles(source)
    for sentence in troubles:
        findings.fix(sentence)
    if not any("compiler" in sentence for sentence in troubles):
        names = [os.environ.get("CXX", "").split(" ")[0], "g++", "c++", "clang++"]
        findings.ok(f"compiler {next(filter(None, map(shutil.which, filter(None, names))))}")
    origin = "wheels of the Python package index" if source == "wheels" else f"the system (Python {sourced_python()})"
    findings.ok(f"ROS 2 Jazzy from {origin}")
    free = shutil.disk_usage(ROOT).free / 1e9
    if free >= 1.0:
        findings.ok(f"disk: {free:.0f} GB free")
    elif not any("GB free" in sentence for sentence in troubles):
        findings.fix(f"disk: only {free:.2f} GB free, a long run's bag may not fit: make room.")


def examine_hardware(findings: Findings) -> None:
    """Whether processes may have real-time priority, and what hardware tests need besides."""
    ask = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(20))"
    if subprocess.run([sys.executable, "-c", ask], capture_output=True).returncode == 0:
        findings.ok("real-time priority is allowed (tests on hardware)")
    else:
        findings.note(
            "real-time priority is not allowed; tests on hardware want it: write '@audio - rtprio 95' and '@audio - "
            "memlock unlimited' into /etc/security/limits.d/audio.conf, type 'sudo usermod -aG audio $USER', log in "
            "again (containers: --cap-add=SYS_NICE --ulimit rtprio=95 --ulimit memlock=-1)"
        )
    missing = [
        name
        for name, found in (
            ("libportaudio2", ctypes.util.find_library("portaudio")),
            ("jackd2", shutil.which("jackd")),
        )
        if not found
    ]
    if missing:
        findings.note(f"for sound cards and the simulated specimen: sudo apt install {' '.join(missing)}")
    else:
        findings.ok("PortAudio and JACK are installed (sound cards, simulated specimen)")


def examine_network(findings: Findings) -> None:
    """Whether the package index answers; asked only when something must be fetched."""
    from urllib.error import HTTPError
    from urllib.request import urlopen

    index = os.environ.get("PIP_INDEX_URL", "https://pypi.org/simple").rstrip("/") + "/"
    try:
        urlopen(index + "pip/", timeout=10).close()
    except HTTPError:
        pass  # it answers
    except (OSError, ValueError) as error:
        findings.fix(
            f"the Python package index {index} does not answer ({getattr(error, 'reason', error)}): check "
            "the network, HTTPS_PROXY and PIP_INDEX_URL."
        )
        return
    findings.ok(f"the Python package index answers ({index})")


def examine_set_up(findings: Findings, state: dict[str, Any]) -> bool:
    """Whether the set-up is in step with the project's files; returns whether commands can be tried."""
    pending = pending_steps(state)
    if "requirements" in pending:
        examine_network(findings)
    if len(pending) == len(STEPS):
        findings.fix("not set up yet: type './nmt setup' (every command does it at first use).")
        return False
    for step in pending:
        what = "changed since" if state.get(step) else "unfinished"
        if step == "workspace":
            what += " (" + " ".join(packages_to_build(state, expected_stamps(state))) + ")"
        findings.fix(f"{step}: {what}: the next command brings it in step, or type './nmt setup'.")
    if "requirements" not in pending:
        pins, present = pins_of(lock_file(state)), installed(state)
        wrong = [n for n, version in pins.items() if n in present and present[n][0] != version]
        wrong += [n for n in pins if n not in present and state["source"] == "wheels"]
        if wrong:
            findings.fix(
                f"{len(wrong)} packages in .venv differ from the lock file "
                f"({' '.join(sorted(wrong)[:4])}): type './nmt setup --fresh'."
            )
        else:
            findings.ok(f".venv holds the {len(pins)} locked packages")
    if "workspace" not in pending:
        findings.ok(f"workspace built and fresh: {' '.join(packages())}")
    return "requirements" not in pending and is_built("nmt_msgs")


def examine_ros(findings: Findings, state: dict[str, Any]) -> None:
    """Whether messages can be imported and two processes find each other."""
    environment = command_environment(state)
    environment["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)  # not the domain of a running bench
    answer = subprocess.run([VENV_PYTHON, "-c", IMPORT_CHECK], capture_output=True, text=True, env=environment)
    if answer.returncode != 0:
        reason = (answer.stderr.strip().splitlines() or ["no reason given"])[-1]
        findings.fix(f"the messages or a library cannot be imported ({reason}): type './nmt setup --fresh'.")
        return
    findings.ok("messages and libraries can be imported")
    begun = time.monotonic()
    command = [VENV_PYTHON, "-c", DISCOVERY_CHECK]
    speaker = subprocess.Popen(
        [*command, "speak"], env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        listener = subprocess.run([*command, "listen"], env=environment, capture_output=True, text=True)
    finally:
        speaker.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            speaker.wait(10)
        speaker.kill()
        speaker.wait()
    if listener.returncode == 0:
        findings.ok(f"two ROS 2 processes found each other on this host in {time.monotonic() - begun:.1f} s")
    else:
        reason = (listener.stderr.strip().splitlines() or ["no message in 15 s"])[-1]
        findings.fix(
            f"two ROS 2 processes did not find each other on this host ({reason}): the loopback interface "
            "must be up and allow multicast ('sudo ip link set lo multicast on'), and no firewall may "
            "stop UDP on it."
        )


def examine_real_time(findings: Findings) -> None:
    """Hints for pacing by the clock; a simulated run in lockstep needs none of them."""
    cores = len(os.sched_getaffinity(0))
    (findings.ok if cores >= 2 else findings.note)(
        f"{cores} processor cores" + ("" if cores >= 2 else ": real-time pacing needs two")
    )
    governors = set()
    for path in glob.glob("/sys/devices/system/cpu/cpu*/cpufreq/scaling_governor"):
        with contextlib.suppress(OSError), open(path) as file:
            governors.add(file.read().strip())
    if governors - {"performance"}:
        findings.note(
            f"frequency governor {'/'.join(sorted(governors))}: 'performance' lowers the jitter of real-time pacing"
        )


def set_up_left(state: dict[str, Any]) -> dict[str, Any]:
    """Steps of the set-up that are to be done, minutes that they take, and how far the background is."""
    pending = pending_steps(state)
    return {
        "pending": pending,
        "minutes_left": round(estimated_seconds(pending, state) / 60.0, 1),
        "kernels_in_background": later_progress(),
    }


def doctor(wanted: str | None, as_json: bool = False) -> int:
    """Check everything; one line each, or one object in JSON; 0 if nothing needs fixing."""
    findings = Findings(as_json)
    state = read_state()
    try:
        source = choose_source(wanted, state)
    except SetupError as trouble:
        findings.fix(str(trouble))
        source = "wheels"
    if state.get("source") != source:
        state = {}
    examine_machine(findings, source, state)
    if examine_set_up(findings, state):
        examine_ros(findings, state)
    examine_real_time(findings)
    examine_hardware(findings)
    if as_json:
        document = {"in_order": not findings.bad, "findings": findings.lines, "set_up": set_up_left(state)}
        sys.stdout.write(json.dumps(document, indent=1) + "\n")
        return FAILED if findings.bad else 0
    sys.stdout.write("Everything is in order.\n" if not findings.bad else f"{findings.bad} to fix.\n")
    return FAILED if findings.bad else 0
