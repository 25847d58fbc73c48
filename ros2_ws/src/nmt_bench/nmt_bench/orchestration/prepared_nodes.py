"""Nodes forked from one process that has imported what all of them need; `node_loader` is that process.

    loader = NodeLoader()                # it imports meanwhile
    if loader.can_fork():
        nodes = loader.fork(commands)    # they are children of this process now, and wait
        loader.release()                 # they begin
    loader.close()

The loader ends as soon as it has forked them. This process adopts them then, and is to them what it would be had it
started them itself. What goes wrong before `release` leaves no process, since none of them has begun.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from nmt_bench.orchestration import node_loader
from nmt_bench.orchestration.adopted_process import AdoptedProcess, adopted_orphans, can_adopt
from nmt_bench.orchestration.bench_domain import ONE_THREAD
from nmt_core.errors import BenchError
from nmt_core.processes.process_end import begin_group

LONGEST = 120.0  # s; a busy computer imports for long
_LOOK = 0.1  # s between two looks whether the loader lives
_ANSWER = 65_536  # bytes
loaders_ahead: list[NodeLoader] = []


class NodeCommand(NamedTuple):
    """What one node is started with.

    Attributes:
        command: path of its program, and arguments.
        environment: all of its variables.
        log: descriptor that gets what it prints.
    """

    command: Sequence[str]
    environment: Mapping[str, str]
    log: int


class NodeLoader:
    """The process from which nodes are forked, once.

    Raises:
        BenchError: it cannot be started.
    """

    def __init__(self) -> None:
        self._words = os.memfd_create("words of the loader")
        self._channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._nodes: list[AdoptedProcess] = []
        self._released = False
        try:
            self._process = subprocess.Popen(
                # The blanks are room for the command lines of nodes.
                [sys.executable, node_loader.__file__, str(theirs.fileno()), " " * node_loader.ROOM],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=self._words,
                env={**os.environ, **ONE_THREAD},
                pass_fds=(theirs.fileno(),),
                preexec_fn=begin_group,
            )
        except OSError as error:
            os.close(self._words)
            self._channel.close()
            raise BenchError(f"The nodes cannot be started ({error}); run './nmt setup' again.") from error
        finally:
            theirs.close()

    @property
    def pid(self) -> int:
        """Its process id, which is that of the group of all that it forks, until they begin."""
        return self._process.pid

    def can_fork(self) -> bool:
        """Wait until everything is imported; whether no library has started a thread, which a fork would lose.

        Raises:
            BenchError: the process has ended.
        """
        return self._answer() == node_loader.READY

    def fork(self, nodes: Sequence[NodeCommand], held: Sequence[int] = ()) -> list[AdoptedProcess]:
        """Fork one process a node, once `can_fork` says so; none of them begins before `release`.

        Args:
            nodes: what they are.
            held: descriptors that each of them holds open for as long as it lives.

        Raises:
            BenchError: the loader has ended, or the system allows no more processes.
        """
        with adopted_orphans():
            self._ask(nodes, held)
            answer = json.loads(self._answer())
            self._process.wait()
        if "error" in answer:
            raise BenchError(f"The nodes cannot be started ({answer['error']}); end other programs.")
        try:
            self._nodes = [AdoptedProcess(process) for process in answer["processes"]]
        except ChildProcessError as error:
            raise self._end_of_loader() from error
        return self._nodes

    def release(self) -> None:
        """Let the nodes begin."""
        self._released = True
        for _ in self._nodes:
            with contextlib.suppress(OSError):  # all of them have been killed
                self._channel.send(node_loader.GO)

    def close(self) -> None:
        """End the loader, and its nodes unless they have been let go; does nothing the second time."""
        if not self._released:
            # The number is that of another group once no child is left in this one.
            with contextlib.suppress(ChildProcessError, ProcessLookupError):
                os.waitid(os.P_PGID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)
                os.killpg(self.pid, signal.SIGKILL)
            self._process.wait()
            with contextlib.suppress(ChildProcessError):
                while True:
                    os.waitpid(-self.pid, 0)
        self._released = True
        if self._channel.fileno() >= 0:
            self._channel.close()
            os.close(self._words)

    def _ask(self, nodes: Sequence[NodeCommand], held: Sequence[int]) -> None:
        """Send what is to be forked, in memory without a name since it may be long."""
        request = {
            "nodes": [{"command": list(node.command), "environment": dict(node.environment)} for node in nodes],
            "folder": _present_folder(),
            "files": resource.getrlimit(resource.RLIMIT_NOFILE),
            "launcher": os.getpid(),
        }
        with open(os.memfd_create("nodes"), "w+b") as file:
            file.write(json.dumps(request).encode())
            file.flush()
            file.seek(0)
            with contextlib.suppress(OSError):  # it has ended, and there will be no answer
                socket.send_fds(self._channel, [b"!"], [file.fileno(), *(node.log for node in nodes), *held])

    def _answer(self) -> bytes:
        end = time.monotonic() + LONGEST
        ended = False
        while time.monotonic() < end:
            # Nodes hold the other side too: that it is closed is not how the end of the loader shows.
            ready, _, _ = select.select([self._channel], [], [], 0.0 if ended else _LOOK)
            answer = b""
            with contextlib.suppress(OSError):
                answer = self._channel.recv(_ANSWER) if ready else b""
            if answer:
                return answer
            if ready or ended:
                raise self._end_of_loader()
            ended = self._process.poll() is not None
        raise BenchError(
            f"The process that loads the nodes ({self.pid}) has said nothing for {LONGEST:g} s; it is stopped or hangs."
        )

    def _end_of_loader(self) -> BenchError:
        code = None
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = self._process.wait(1.0)
        how = f"killed by {signal.Signals(-code).name}" if code is not None and code < 0 else f"exit code {code}"
        lines = os.pread(self._words, _ANSWER, 0).decode(errors="replace").strip().splitlines()
        last = f": {lines[-1].strip().rstrip('.')}" if lines else ""
        return BenchError(f"The process that loads the nodes has ended ({how}{last}) before they began; start again.")


def _present_folder() -> str:
    """The folder to work in; empty where it has been removed, which hinders no node."""
    try:
        return os.getcwd()
    except FileNotFoundError:
        return ""


@contextlib.contextmanager
def nodes_ahead(wanted: bool = True) -> Iterator[None]:
    """Have what nodes need imported next to what the program does meanwhile, for the next bench that it starts.

    Args:
        wanted: False = do nothing.
    """
    loader = NodeLoader() if wanted and can_adopt() else None
    if loader is not None:
        loaders_ahead.append(loader)
    try:
        yield
    finally:
        if loader in loaders_ahead:
            loaders_ahead.remove(loader)
            loader.close()


def take_loader() -> NodeLoader | None:
    """The loader that was started ahead, or a new one; None where the system has no orphans adopted.

    Raises:
        BenchError: it cannot be started.
    """
    if loaders_ahead:
        return loaders_ahead.pop()
    return NodeLoader() if can_adopt() else None
