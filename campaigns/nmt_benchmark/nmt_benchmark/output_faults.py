"""How long an output that a process of its own owns takes to zero when the process that feeds it fails.

    python -m nmt_benchmark.output_faults --repeats 5

Each time a process with a loopback device feeds a sine to an output, and then hangs in its read, is stopped, holds its
interpreter in one call, or is killed. The owner's log says when the last sample that is not zero was put out.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import os
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nmt_core.messages.records import DriveCommand
from nmt_core.vocabulary import Waveform
from nmt_plant.converters.converter import read_log
from nmt_plant.devices.guarded_device import LEAST_LEAD
from nmt_plant.devices.loopback_device import LoopbackDevice

FAULTS = ("hung read", "SIGSTOP", "blocked interpreter", "SIGKILL")
"""What the process that feeds suffers: a call that never returns, a stop, a call that locks the interpreter, a kill."""

_RATE = 10_000.0
_BLOCK = 200
_RAMP = 0.1
LEAD_BLOCKS = LEAST_LEAD
DEADLINE_BLOCKS = float(LEAST_LEAD)

_MOST_TRIALS = 20
_HELD = 0.2  # s of zeros after which the output is at zero for good


class LateFeederError(RuntimeError):
    """The feeding process was late, and its output stopped, before the fault was caused: a busy machine."""


def stated_time(deadline_blocks: float) -> float:
    """Longest time from a fault to zero, s: the deadline, the ramp, and 20 ms for chunks and scheduling.

    The deadline counts from the last block fed, which lies before the fault.
    """
    return deadline_blocks * _BLOCK / _RATE + _RAMP + 0.02


@dataclass(frozen=True)
class FaultOutcome:
    """One fault.

    Attributes:
        fault: which of `FAULTS`.
        seconds: from the fault to the first of the zeros that follow for good, by the samples put out; those of the
            call during which the fault came are counted as after it.
        largest_step: V, largest change between two samples after the fault.
        amplitude: V, largest magnitude before the fault.
        left: processes that were left behind, and files in shared memory that the owner used.
    """

    fault: str
    seconds: float
    largest_step: float
    amplitude: float
    left: tuple[str, ...]


def feed(fault: str, log: str, lead_blocks: int, deadline_blocks: float) -> None:
    """Feed a sine, say when the output follows it, and fail on a line from the parent."""
    device = LoopbackDevice(
        _RATE,
        _BLOCK,
        watchdog_blocks=0,
        quiet_ramp=_RAMP,
        owned=True,
        lead_blocks=lead_blocks,
        deadline_blocks=deadline_blocks,
        arguments={"log": log},
    )
    device.configure()
    device.start()
    device.write(DriveCommand(Waveform.SINE, 50.0, 1.0, 0.1))
    hang, settled = threading.Event(), threading.Semaphore(0)

    def read() -> None:
        while not hang.is_set():
            device.read()
            settled.release()
        os.read(os.pipe()[0], 1)  # as in a driver that never returns

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    for _ in range(lead_blocks + 30):
        settled.acquire()
    sys.stdout.write(f"{device.output_pid} {device.tripped}\n")
    sys.stdout.flush()
    sys.stdin.readline()
    sys.stdout.write(f"{time.monotonic()}\n")
    sys.stdout.flush()
    if fault == "hung read":
        hang.set()
    elif fault == "blocked interpreter":
        ctypes.PyDLL(None).sleep(3600)  # PyDLL keeps the interpreter locked
    time.sleep(3600)


@contextmanager
def _feeder(fault: str, log: Path, lead_blocks: int, deadline_blocks: float) -> Iterator[subprocess.Popen[str]]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(part for part in sys.path if part)}
    command = [sys.executable, "-m", "nmt_benchmark.output_faults", "--feed", fault, "--log", str(log)]
    command += ["--lead", str(lead_blocks), "--deadline", str(deadline_blocks)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment)
    try:
        yield process
    finally:
        process.kill()
        process.wait()
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                stream.close()


def _line(process: subprocess.Popen[str]) -> str:
    """The next line of the feeding process.

    Raises:
        RuntimeError: it says nothing for a minute, or has ended.
    """
    stream = process.stdout
    line = stream.readline() if stream is not None and select.select([stream], [], [], 60.0)[0] else ""
    if not line:
        raise RuntimeError("the feeding process did not come up")
    return line.strip()


def measure(fault: str, lead_blocks: int = LEAD_BLOCKS, deadline_blocks: float = DEADLINE_BLOCKS) -> FaultOutcome:
    """Cause one fault and read the owner's log.

    Args:
        fault: one of `FAULTS`.
        lead_blocks, deadline_blocks: as of `guarded_device.owned_output`; blocks of 20 ms.

    Raises:
        RuntimeError: the feeding process did not come up.
        LateFeederError: it was late.
    """
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "output"
        with _feeder(fault, log, lead_blocks, deadline_blocks) as process:
            owner, _, tripped = _line(process).partition(" ")
            if tripped:
                raise LateFeederError(f"stopped before the fault: {tripped}")
            if process.stdin is not None:
                process.stdin.write("now\n")
                process.stdin.flush()
            at = float(_line(process))
            shared = _shared_files(int(owner))
            if fault in ("SIGSTOP", "SIGKILL"):
                at = time.monotonic()
                process.send_signal(signal.SIGSTOP if fault == "SIGSTOP" else signal.SIGKILL)
            _until_zero(log, at, int(owner))
        left = _left(int(owner)) + shared
        calls = read_log(log)
    times = np.concatenate([np.full(values.shape[1], end) for end, values in calls])
    values = np.concatenate([values[0] for _, values in calls])
    first = max(int(np.argmax(times > at)), 1)
    last = int(np.flatnonzero(values)[-1])
    return FaultOutcome(
        fault,
        (last + 2 - first) / _RATE if last < values.size - 1 else float("inf"),
        float(np.abs(np.diff(values[first - 1 :])).max()),
        float(np.abs(values[:first]).max()),
        left,
    )


def _until_zero(log: Path, since: float, owner: int) -> None:
    """Wait until nothing but zeros were put out for a while, or the owner has ended; for a minute at most."""
    end = time.monotonic() + 60.0
    while time.monotonic() < end and Path(f"/proc/{owner}").exists():
        values = [values[0] for at, values in read_log(log) if at > since]
        line = np.concatenate(values) if values else np.ones(1)
        if line.size > _HELD * _RATE and not line[-int(_HELD * _RATE) :].any():
            return
        time.sleep(0.05)


def _shared_files(process: int) -> tuple[str, ...]:
    """Files in shared memory that a process has mapped or open."""
    names = Path(f"/proc/{process}/maps").read_text(encoding="utf-8").split()
    with contextlib.suppress(OSError):
        names += [os.readlink(link) for link in Path(f"/proc/{process}/fd").iterdir()]
    return tuple(sorted({name for name in names if name.startswith("/dev/shm/")}))


def _left(owner: int) -> tuple[str, ...]:
    """The owner's process if it is still there some time after the feeding process has gone."""
    end = time.monotonic() + 5.0
    while Path(f"/proc/{owner}").exists() and time.monotonic() < end:
        time.sleep(0.01)
    return (f"process {owner}",) if Path(f"/proc/{owner}").exists() else ()


def _trials(fault: str, count: int, lead_blocks: int, deadline_blocks: float) -> tuple[list[FaultOutcome], int]:
    """Outcomes of a fault, and how often the feeding process was late before it."""
    outcomes: list[FaultOutcome] = []
    late = 0
    while len(outcomes) < count and late < _MOST_TRIALS:
        try:
            outcomes.append(measure(fault, lead_blocks=lead_blocks, deadline_blocks=deadline_blocks))
        except LateFeederError:
            late += 1
    return outcomes, late


def main(arguments: list[str] | None = None) -> int:
    """Print the times to zero of every fault; 1 if one is beyond the stated time or something was left behind."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5, metavar="N", help="times each fault is caused (default: 5)")
    parser.add_argument("--lead", type=int, default=LEAD_BLOCKS, metavar="N", help="blocks that wait at the output")
    parser.add_argument("--deadline", type=float, default=DEADLINE_BLOCKS, metavar="N", help="blocks until it acts")
    parser.add_argument("--feed", choices=FAULTS, help=argparse.SUPPRESS)
    parser.add_argument("--log", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.feed:
        feed(options.feed, options.log, options.lead, options.deadline)
        return 0
    missed = False
    stated = stated_time(options.deadline)
    sys.stdout.write(f"time to zero, ms; stated: {1e3 * stated:.0f}\n")
    for fault in FAULTS:
        outcomes, late = _trials(fault, options.repeats, options.lead, options.deadline)
        times = 1e3 * np.array([outcome.seconds for outcome in outcomes] or [np.inf])
        step = max((outcome.largest_step for outcome in outcomes), default=np.inf)
        left = sorted({name for outcome in outcomes for name in outcome.left})
        missed = missed or bool(times.max() > 1e3 * stated) or bool(left)
        sys.stdout.write(
            f"{fault:20s} median {np.median(times):6.1f}  worst {times.max():6.1f}  largest step {step:.4f} V  "
            f"left behind: {', '.join(left) or 'nothing'}" + (f"  late before: {late}" if late else "") + "\n"
        )
        sys.stdout.flush()
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
