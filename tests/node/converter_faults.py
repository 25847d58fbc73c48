"""Each process of a test on a converter is killed, stopped, or has its interpreter blocked, in turn; when is the port
at zero?

The specimen records its drive port: on the other side of JACK, or in the stand-in for NI's device server.

./nmt shell <<< "python tests/node/converter_faults.py portaudio"
./nmt shell <<< "python tests/node/converter_faults.py nidaqmx --of owner,plant"
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from node.converter_bench import KINDS, RATES, ConverterBench, converter_bench

FAULTS = ("SIGKILL", "SIGSTOP", "blocked")
PROCESSES = ("owner", "plant", "pll", "sequencer", "extract", "recorder", "command")
_WORDS = {
    "owner": "nmt_plant.output_process.output_owner",
    "plant": "nmt_plant/plant",
    "pll": "nmt_pll/pll",
    "sequencer": "nmt_sequencer/sequencer",
    "extract": "nmt_extract/extract",
    "recorder": "nmt_record/recorder",
}
_BLOCKER = """
import os, threading, time
def _wait():
    import ctypes
    asked = os.path.join(os.environ["NMT_TRIAL_BLOCK"], str(os.getpid()))
    while not os.path.exists(asked):
        time.sleep(0.02)
    with open(asked + ".at", "w") as file:
        file.write(str(time.monotonic()))
    os.rename(asked + ".at", asked + ".done")
    ctypes.PyDLL(None).sleep(3600)  # PyDLL keeps the interpreter locked
if "NMT_TRIAL_BLOCK" in os.environ:
    threading.Thread(target=_wait, daemon=True).start()
"""
_LOCK_TIME, _END_TIME = 90.0, 60.0  # s of patience


def stated_time(kind: str, process: str, fault: str, lead_blocks: int) -> float:
    """Longest time to zero that the guide states, s, with what waits in the converter's own buffers."""
    block = RATES[kind][1] / RATES[kind][0]
    buffered = 3.0 * block if kind == "nidaqmx" else block
    if process == "owner":
        # JACK repeats the last period of a client that is stopped, until the plant node ends its process.
        return buffered + (0.02 if fault == "SIGKILL" or kind == "nidaqmx" else 0.7)
    if process == "plant":
        return lead_blocks * block + 0.1 + 0.02 + buffered
    if (process, fault) == ("command", "blocked"):
        return math.inf  # nobody notices: the nodes go on with the test
    if process == "pll":
        return 1.0 + 0.5 + (lead_blocks + 1) * block + buffered
    return 3.5 + 0.5 + (lead_blocks + 1) * block + buffered


class Outcome(NamedTuple):
    """Of a fault.

    Attributes:
        seconds: from the fault to zero for good at the port.
        stated: longest time that is stated, s.
        amplitude: V, at the port before the fault.
        step: V, largest change between two samples after the fault.
        ended: exit code of the command; -100 = it had to be killed.
        said: its last line.
    """

    seconds: float
    stated: float
    amplitude: float
    step: float
    ended: int
    said: str


def processes(of: int) -> dict[str, int]:
    """Name and process id of a test's processes."""
    found, todo = {"command": of}, [of]
    while todo:
        for task in Path(f"/proc/{todo.pop()}/task").glob("*/children"):
            with contextlib.suppress(OSError):
                for child in map(int, task.read_text().split()):
                    todo.append(child)
                    words = Path(f"/proc/{child}/cmdline").read_bytes().decode(errors="replace").replace("\0", " ")
                    found.update({name: child for name, word in _WORDS.items() if word in words})
    return found


def strike(process: int, fault: str, folder: Path) -> float:
    """Cause the fault; its time on the steady clock, s."""
    if fault != "blocked":
        at = time.monotonic()
        os.kill(process, signal.SIGKILL if fault == "SIGKILL" else signal.SIGSTOP)
        return at
    (folder / str(process)).touch()
    done = folder / f"{process}.done"
    end = time.monotonic() + 20.0
    while not done.exists():
        if time.monotonic() > end:
            raise RuntimeError(f"the interpreter of process {process} was not blocked")
        time.sleep(0.005)
    return float(done.read_text())


def until_locked(command: subprocess.Popen[str], out: Path, level: int = 1) -> None:
    """Wait for the lock of a level, counted from 1.

    Raises:
        RuntimeError: the command has ended, or patience has.
    """
    log = out / "log" / "sequencer.log"
    end = time.monotonic() + _LOCK_TIME
    while f"Level {level} locked at" not in (log.read_text() if log.exists() else ""):
        if command.poll() is not None or time.monotonic() > end:
            command.kill()
            raise RuntimeError(f"the test did not lock:\n{command.communicate()[0]}")
        time.sleep(0.05)


def attempt(kind: str, process: str, fault: str, folder: Path) -> Outcome:
    """Start a test, cause the fault while it is locked, wait for its end, look at the port."""
    blocker = folder / "blocker"
    blocker.mkdir(parents=True)
    (blocker / "sitecustomize.py").write_text(_BLOCKER)
    ids: dict[str, int] = {}
    said: list[str] = []
    with converter_bench(kind, folder, record_s=150.0) as bench:
        lead = bench.pass_check()
        command = _start(bench, blocker)
        try:
            until_locked(command, folder / "run")
            time.sleep(1.0)
            ids = processes(command.pid)
            at = strike(ids[process], fault, blocker)
            with contextlib.suppress(subprocess.TimeoutExpired):
                rest, _ = command.communicate(timeout=_END_TIME if process != "command" else 15.0)
                said = rest.splitlines()
            code = command.poll()
            time.sleep(0.5)
        finally:
            for number in (*ids.values(), *processes(command.pid).values()):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(number, signal.SIGKILL)
            with contextlib.suppress(ProcessLookupError):
                os.killpg(command.pid, signal.SIGKILL)
            command.wait()
            if command.stdout is not None:
                command.stdout.close()
    port = bench.port()
    index = port.index(at)
    after = port.values[max(index - 1, 0) :]
    return Outcome(
        port.time_to_zero(at),
        stated_time(kind, process, fault, lead),
        float(np.abs(port.values[max(index - int(0.2 * port.rate), 0) : index]).max(initial=0.0)),
        float(np.abs(np.diff(after)).max(initial=0.0)),
        -100 if code is None else code,
        next((line.strip() for line in reversed(said) if line.strip()), ""),
    )


def _start(bench: ConverterBench, blocker: Path) -> subprocess.Popen[str]:
    words = ["--levels", "0.5,0.6,0.7,0.8", "--periods", "600", "--quiet", "--out", str(bench.folder / "run")]
    return bench.start("run", *words, extra={"NMT_TRIAL_BLOCK": str(blocker)}, path=blocker)


def main() -> int:
    """Print a line for each; 0 where the port was at zero in time every time."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("--of", default=",".join(PROCESSES), help="processes (default: all)")
    parser.add_argument("--faults", default=",".join(FAULTS), help="faults (default: all)")
    given = parser.parse_args()
    missed = 0
    for process in given.of.split(","):
        for fault in given.faults.split(","):
            with tempfile.TemporaryDirectory() as temporary:
                found = attempt(given.kind, process, fault, Path(temporary))
            late = not found.seconds <= found.stated
            missed += late
            print(
                f"{process:10s} {fault:8s} zero after {1e3 * found.seconds:7.0f} ms (stated {1e3 * found.stated:.0f})"
                f"{' LATE' if late else ''}  {found.amplitude:.3f} V before, largest step {found.step:.3f} V; exit "
                f"{found.ended}: {found.said[:110]}",
                flush=True,
            )
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
