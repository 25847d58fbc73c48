"""The bench's nodes as processes: started, watched, ended; free of ROS."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO

from nmt_bench.orchestration.adopted_process import AdoptedProcess
from nmt_bench.orchestration.prepared_nodes import NodeCommand, NodeLoader
from nmt_core.errors import BenchError
from nmt_core.nodes.launcher_watch import LAUNCHER
from nmt_core.processes.process_end import begin_group
from nmt_core.processes.process_watch import ProcessWatch
from nmt_session.node_plan import NODES, NodePlan

_GRACE = 15.0  # s in which a node that was asked to end has nothing to do: it waits for the ramp to zero in vain
_HURRIED = 3.0  # s in which it leaves what it waits for and closes its files
_MOST_WORK = 120.0  # s of processor time that it may take for what it was sent
IDLE_START = 6.0  # s that a node which has not been heard of yet does nothing, after which it will not come up
_WORKS = 0.2  # share of a core from which it does something
_LOOK = 0.25  # s between two looks at processes
_LOG_HEAD = re.compile(r"^\[\w+\] \[[\d.]+\] \[[^\]]*\]: ")


class NodeProcesses:
    """One process a node; each ends with its parent, whatever kills that.

    Args:
        plan: parameters of the nodes.
        out: folder that gets ``nodes.yaml`` (parameters for ``ros2 run``) and ``log/``.
        environment: additional environment variables.
        loader: process from which they are forked; None = each is started as a program of its own.
        held: descriptor that each node holds open for as long as it lives, the bench's domain; None = none.
        quiet_s: s that the plant waits for its sensors before it is heard of.
    """

    def __init__(
        self,
        plan: NodePlan,
        out: Path,
        environment: Mapping[str, str],
        loader: NodeLoader | None = None,
        held: int | None = None,
        quiet_s: float = 0.0,
    ) -> None:
        self._plan, self._idle = plan, IDLE_START + quiet_s
        self._log = out / "log"
        self._parameters = out / "nodes.yaml"
        self._environment = {**os.environ, **environment, LAUNCHER: str(os.getpid())}
        self._loader = loader
        self._held = () if held is None else (held,)
        self.processes: dict[str, subprocess.Popen[bytes] | AdoptedProcess] = {}
        self._starts: dict[str, _Doing] = {}

    def start(self) -> None:
        """Start all nodes.

        Raises:
            BenchError: an executable is missing or cannot be started.
        """
        self._log.mkdir(parents=True, exist_ok=True)
        self._plan.write_parameters(self._parameters)
        self._environment.setdefault("ROS_LOG_DIR", str(self._log))
        commands = {name: self._command(name) for name in self._plan.settings}
        with contextlib.ExitStack() as stack:
            logs = {name: stack.enter_context(open(self._log / f"{name}.log", "wb")) for name in commands}
            if self._loader is not None and self._loader.can_fork():
                self._fork(self._loader, commands, logs)
                return
            for name, command in commands.items():
                self._start_alone(name, command, logs[name])

    def restart(self, name: str) -> None:
        """End a node and start it again, as a person does between two runs; its log is continued.

        Raises:
            BenchError: it cannot be started.
        """
        process = self.processes[name]
        process.send_signal(signal.SIGTERM)
        process.wait(_GRACE)
        with open(self._log / f"{name}.log", "ab") as log:
            self._start_alone(name, self._command(name), log)

    def _command(self, name: str) -> list[str]:
        package, executable, _ = NODES[name]
        return [str(find_executable(package, executable)), "--ros-args", "--params-file", str(self._parameters)]

    def _fork(self, loader: NodeLoader, commands: Mapping[str, list[str]], logs: Mapping[str, IO[bytes]]) -> None:
        nodes = [NodeCommand(command, self._environment, logs[name].fileno()) for name, command in commands.items()]
        self.processes.update(zip(commands, loader.fork(nodes, self._held), strict=True))
        loader.release()

    def _start_alone(self, name: str, command: list[str], log: IO[bytes]) -> None:
        try:
            self.processes[name] = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=self._environment,
                pass_fds=self._held,
                # Ctrl-C in the terminal is for the command line alone: it ramps the drive down first.
                preexec_fn=begin_group,
            )
        except OSError as error:
            raise BenchError(f"Node {name} cannot be started ({error}); run './nmt setup' again.") from error

    @property
    def pids(self) -> dict[str, int]:
        """Process ids by node name."""
        return {name: process.pid for name, process in self.processes.items()}

    def first_dead(self) -> str:
        """Name of a node whose process has ended; empty if all live."""
        return next((name for name, process in self.processes.items() if process.poll() is not None), "")

    def not_coming_up(self, unheard: Sequence[str]) -> str:
        """A sentence on a node of which nothing has been heard and whose process does nothing; empty if none is so.

        A busy computer is not a reason: what counts is the time in which the process could have worked and did not.
        """
        for name in unheard:
            process = self.processes.get(name)
            if process is None or process.poll() is not None:
                continue
            doing = self._starts.setdefault(name, _Doing(process.pid))
            if doing.look() > self._idle:
                how = "is stopped" if doing.is_stopped else "does nothing"
                return (
                    f"Node {name} does not come up: its process ({process.pid}) {how}; all others are ended. "
                    f"Its log is {self._log / name}.log."
                )
        return ""

    def is_alive(self, name: str) -> bool:
        """Whether the process of a node has not ended."""
        process = self.processes.get(name)
        return process is not None and process.poll() is None

    def last_words(self, name: str) -> str:
        """How the process ended and the last line of its log that is more than a note on its state."""
        process = self.processes.get(name)
        code = process.poll() if process else None
        how = ""
        if code is not None and code < 0:
            how = f"killed by {signal.Signals(-code).name}"
        elif code:
            how = f"exit code {code}"
        with contextlib.suppress(OSError, IndexError):
            text = (self._log / f"{name}.log").read_text(errors="replace")
            lines = [line for line in text.strip().splitlines() if not line.startswith("[INFO]")]
            last = _LOG_HEAD.sub("", lines[-1].strip())
            return ": ".join(part for part in (how, last.rstrip(".")) if part)
        return how

    def end(self, grace: float = _GRACE) -> None:
        """Ask every process to end, wait, ask again, by which a node leaves what it waits for, then kill the others.

        Args:
            grace: s in which a node has nothing to do.
        """
        asked_again: set[str] = set()
        for process in self.processes.values():
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
                process.send_signal(signal.SIGCONT)  # a stopped process would not hear of it
        left = {name: _Doing(process.pid) for name, process in self.processes.items() if process.poll() is None}
        while left:
            time.sleep(0.01)
            for name, doing in list(left.items()):
                process = self.processes[name]
                idle = doing.look()
                if process.poll() is None and idle > grace and name not in asked_again:
                    asked_again.add(name)
                    process.send_signal(signal.SIGTERM)
                if process.poll() is None and (idle > grace + _HURRIED or doing.worked > _MOST_WORK):
                    process.kill()
                    process.wait()
                if process.poll() is not None:
                    del left[name]


class _Doing:
    """For how long a process has done nothing although it could have.

    Args:
        process: its id.

    Attributes:
        worked: processor time that it has used, s.
        is_stopped: whether it was stopped at the last look.
    """

    def __init__(self, process: int) -> None:
        self.worked, self.is_stopped = 0.0, False
        self._idle, self._last = 0.0, time.monotonic()
        self._watch: ProcessWatch | None = None
        with contextlib.suppress(OSError, AttributeError):  # it has ended, or processes cannot be watched here
            self._watch = ProcessWatch(process)
            self._watch.begin(self._last)

    def look(self) -> float:
        """Look again if it is time; the s since it did something, and without a way to look those that have passed."""
        now = time.monotonic()
        passed = now - self._last
        if passed < _LOOK:
            return self._idle
        self._last = now
        free, ran = (passed, 0.0) if self._watch is None else self._watch.looked(now)
        self.is_stopped = self._watch is not None and self._watch.is_stopped
        self.worked += ran
        if self.is_stopped:
            self._idle += min(passed, 2.0 * _LOOK)
        else:
            self._idle = 0.0 if ran > _WORKS * passed else self._idle + max(0.0, free - ran)
        return self._idle


def find_executable(package: str, executable: str) -> Path:
    """Path of a node's executable, as ``ros2 run`` would find it.

    Raises:
        BenchError: the workspace is not built or not sourced.
    """
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        path = Path(prefix) / "lib" / package / executable
        if prefix and path.is_file():
            return path
    raise BenchError(
        f"Executable '{executable}' of package {package} was not found on AMENT_PREFIX_PATH; build the workspace with "
        "'./nmt setup', or source ros2_ws/install/setup.bash."
    )
