"""Two benches in two namespaces on one domain, ten processes; one node of the first is killed, each in turn.

./nmt shell <<< "python tests/node/two_bench_trials.py"
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionClient
from rclpy.node import Node

from nmt_bench.harness import Bench, Progress
from nmt_bench.orchestration.node_processes import find_executable
from nmt_core.vocabulary import LoopState, ResultCode
from nmt_msgs.action import RunLevels
from nmt_session import plan_test
from nmt_session.node_plan import NODES, NodePlan, plan_nodes

NAMESPACE = "second"
PATIENCE = 180.0  # s of wall time; a run that hangs is a failure, a slow computer is none
LONGEST = 3.0  # s from the death to the drive at zero


class Strike:
    """Kills a node of the first bench at its first lock and notes when its drive was at zero."""

    def __init__(self, bench: Bench, name: str, listener: Node) -> None:
        assert bench.processes is not None
        self._pid = bench.processes.pids[name]
        self.time = self.at_zero = float("nan")
        listener.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)

    def __call__(self, progress: Progress) -> None:
        """A callback of the run."""
        if progress.state == LoopState.LOCKED and not self.time > 0.0:
            os.kill(self._pid, signal.SIGKILL)
            self.time = time.monotonic()

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            said = {item.key: item.value for item in status.values}
            if status.name == "plant" and said.get("drive_at_zero") == "1" and self.time > 0.0:
                self.at_zero = self.at_zero if self.at_zero > 0.0 else time.monotonic()


def start_second(plan: NodePlan, folder: Path) -> list[subprocess.Popen[bytes]]:
    """Start the nodes of the second bench."""
    plan.write_parameters(folder / "nodes.yaml")
    words = ["--ros-args", "-r", f"__ns:=/{NAMESPACE}", "--params-file", str(folder / "nodes.yaml")]
    started = []
    for name, (package, executable, _) in NODES.items():
        with open(folder / f"{name}.log", "wb") as log:
            command = [str(find_executable(package, executable)), *words]
            started.append(subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, start_new_session=True))
    return started


def attempt(name: str, folder: Path) -> str:
    """Kill one node of the first bench; what is not as it should be, empty = nothing. Prints a line."""
    with Bench("beam", [0.3] * 50, out=folder / "first", processes=True, window_periods=2000) as bench:
        test = plan_test("beam", [0.2, 0.3], window_periods=1200, timeout=200.0, run_id="second")
        (folder / "rig.yaml").write_text(test.rig_yaml, encoding="utf-8")
        plan = plan_nodes(test, folder / "second", folder / "rig.yaml")
        others = start_second(plan, folder)
        try:
            caller = Node("caller", context=bench.context, namespace=NAMESPACE, enable_rosout=False)
            bench.add_node("caller", caller)
            client = ActionClient(caller, RunLevels, "run_levels")
            bench.spin_until(client.server_is_ready, PATIENCE, "the second bench")
            handle = bench.wait_for(client.send_goal_async(RunLevels.Goal(**plan.goal)), PATIENCE, "its answer")
            future = handle.get_result_async()
            strike = Strike(bench, name, caller)
            first = bench.run(strike)
            ended = time.monotonic()
            was_running = not future.done()
            while not future.done():
                assert time.monotonic() < ended + PATIENCE, "the second run does not end"
                bench.spin(0.1)
            second = future.result().result
            alive = sum(process.poll() is None for process in others)
        finally:
            for process in others:
                process.send_signal(signal.SIGINT)
            codes = [process.wait(PATIENCE) for process in others]
    points = len(second.points)
    found = [] if first.code == ResultCode.NODE_LOST and name in first.message else ["the first did not name it"]
    found += [] if (second.result_code, points) == (ResultCode.SUCCEEDED, 2) else ["the second suffered"]
    found += (
        [] if was_running and alive == len(NODES) and not any(codes) else ["the second was not there, or ended ill"]
    )
    found += [] if name == "plant" or strike.at_zero - strike.time <= LONGEST else [f"over {LONGEST:g} s"]
    print(
        f"{name:10s} drive at zero after {strike.at_zero - strike.time:4.1f} s, run over and bag closed after "
        f"{ended - strike.time:4.1f} s: {first.code.name}, {first.message} | second: "
        f"{ResultCode(second.result_code).name}, {points} points, {alive} nodes alive | "
        f"load {os.getloadavg()[0]:.1f} | {'; '.join(found) or 'as it should'}",
        flush=True,
    )
    return "; ".join(found)


def main() -> int:
    """Each node in turn; 1 if something is not as it should."""
    faults = []
    for name in sys.argv[1:] or NODES:
        with tempfile.TemporaryDirectory(prefix="nmt-two-") as folder:
            faults.append(attempt(name, Path(folder)))
    return int(any(faults))


if __name__ == "__main__":
    sys.exit(main())
