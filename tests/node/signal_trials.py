"""Signals to each process of ``./nmt run``: one trial, and a table of many.

    ./nmt shell <<< "python tests/node/signal_trials.py --count 100 --seed 12 --at-once 2"

Every trial starts a run in the domain of the one before, as soon as that has ended: the next run starts at once.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import queue
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from nmt_bench.orchestration.bench_domain import BenchDomain
from nmt_core.errors import BenchError
from nmt_record.bag.bag_reader import Bag
from nmt_session.node_plan import NODES

LAUNCHER = "launcher"
VICTIMS = (LAUNCHER, *NODES)
SIGNALS = ("KILL", "STOP", "TERM", "INT", "HUP")
PACINGS = ("realtime", "lockstep")
PATIENCE = 180.0  # s of wall time; a run that hangs is a failure, a slow computer is none
LONGEST = 30.0  # s from a signal to the end of all processes
MEMORY = Path("/dev/shm")
_POLL = 0.02


@dataclass(frozen=True)
class Trial:
    """What is done: which process gets which signal, in which pacing."""

    victim: str
    name: str
    pacing: str

    @property
    def plant_and_recorder_live(self) -> bool:
        """Whether both can still take the drive to zero and record it."""
        return self.victim not in ("plant", "recorder") or self.name not in ("KILL", "STOP")


@dataclass
class Outcome:
    """What came of it.

    Attributes:
        trial: what was done.
        start_s: s from the start of the run to its first lock.
        end_s: s from the signal to the end of all processes.
        drive_s: s from the signal to the end of the run in the bag; only where the launcher is stopped, since it
            cannot end before it goes on.
        code: exit code of the run command.
        said: what it printed.
        last_voltage: largest magnitude of the last voltage block in the bag, V; NaN where the bag does not open.
        left: processes that stayed, and shared memory, of which a killed process could hold locks.
        fault: why there was no trial.
    """

    trial: Trial
    start_s: float = np.nan
    end_s: float = np.nan
    drive_s: float = np.nan
    code: int | None = None
    said: str = ""
    last_voltage: float = np.nan
    left: list[str] = field(default_factory=list)
    fault: str = ""

    @property
    def faults(self) -> list[str]:
        """What should not be, each in a few words."""
        found = [self.fault] if self.fault else []
        if not self.end_s <= LONGEST:
            found.append(f"over {LONGEST:.0f} s")
        if self.trial.plant_and_recorder_live and self.last_voltage != 0.0:
            found.append("not at zero")
        if "Traceback" in self.said:
            found.append("traceback")
        return found + [f"left: {name}" for name in self.left]


def hear_signals() -> None:
    """What is ignored stays ignored, and whoever starts this in the background may have ignored something."""
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)


def wait_until(condition: Callable[[], bool], what: str) -> None:
    """Wait; AssertionError with ``what`` when it takes too long."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(_POLL)


def node_processes(parent: int) -> dict[str, int]:
    """Process ids of the nodes that a process has started, by name."""
    found = {}
    for path in Path(f"/proc/{parent}/task").glob("*/children"):
        for child in path.read_text().split():
            words = Path(f"/proc/{child}/cmdline").read_bytes().decode().split("\0")
            found.update({name: int(child) for name in NODES if any(word.endswith(f"/{name}") for word in words)})
    return found


def descendants(parent: int) -> list[int]:
    """Processes that a process has started, and theirs: the nodes, and what owns the output."""
    found, todo = [], [parent]
    while todo:
        for path in Path(f"/proc/{todo.pop()}/task").glob("*/children"):
            children = [int(child) for child in path.read_text().split()]
            found += children
            todo += children
    return found


def runs(process: int) -> bool:
    """Whether a process is there and no zombie."""
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def shared_memory(processes: list[int]) -> list[str]:
    """Names of the segments that processes have mapped; the tracer's, one a computer, are nobody's."""
    names: set[str] = set()
    for process in processes:
        with contextlib.suppress(OSError):
            words = Path(f"/proc/{process}/maps").read_text().split()
            names.update(Path(word).name for word in words if word.startswith(f"{MEMORY}/"))
    return sorted(name for name in names if not name.startswith("lttng-ust-wait"))


def voltage_at_the_end(bag: Path) -> float:
    """Largest magnitude of the last voltage block of a bag, V; NaN where it does not open."""
    try:
        blocks = list(Bag.open(bag).blocks("voltage"))
    except BenchError:
        return float("nan")
    return float(np.abs(blocks[-1].data).max()) if blocks else float("nan")


def attempt(trial: Trial, out: Path, domain: int | None = None) -> Outcome:
    """Start a run, send the signal once its first level has locked, and look at what stays."""
    outcome = Outcome(trial)
    words = ["run", "joint_resonator", "--levels", "0.3,0.5", "--out", str(out), "--pacing", trial.pacing]
    # Never over by itself before the signal.
    words += ["--reference", "none", "--no-report", "--periods", "200000" if trial.pacing == "lockstep" else "20000"]
    if trial.pacing == "realtime":  # a busy computer may be late by half a second without a fault
        words += ["--latency-blocks", "25"]
    words += [] if domain is None else ["--domain", str(domain)]
    began = time.monotonic()
    command = subprocess.Popen(
        [sys.executable, "-m", "nmt_bench", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
        preexec_fn=hear_signals,
    )
    started: list[int] = []
    try:
        log = out / "log" / "sequencer.log"
        ended = command.poll
        wait_until(
            lambda: ended() is not None or (log.exists() and "Level 1 locked" in log.read_text()), "no level locked"
        )
        outcome.start_s = time.monotonic() - began
        nodes = node_processes(command.pid)
        assert set(nodes) == set(NODES), f"only {sorted(nodes)} run"
        started = descendants(command.pid)
        outcome.left += shared_memory([command.pid, *started])
        struck = time.monotonic()
        os.kill(command.pid if trial.victim == LAUNCHER else nodes[trial.victim], getattr(signal, f"SIG{trial.name}"))
        if trial.victim == LAUNCHER and trial.name == "STOP":
            metadata = out / "bag" / "metadata.yaml"
            wait_until(metadata.exists, "the bag of a run that nobody attends to was not closed")
            outcome.drive_s = time.monotonic() - struck
            os.kill(command.pid, signal.SIGCONT)
        outcome.said, _ = command.communicate(timeout=PATIENCE)
        wait_until(lambda: not any(map(runs, started)), f"left: {nodes}")
        outcome.end_s = time.monotonic() - struck
        outcome.last_voltage = voltage_at_the_end(out / "bag")
    except (AssertionError, subprocess.TimeoutExpired) as error:
        outcome.fault = str(error)
    finally:
        for process in (command.pid, *started):
            if runs(process):
                os.kill(process, signal.SIGKILL)
                outcome.left.append(f"process {process}")
        outcome.said += command.communicate()[0] or ""
        outcome.code = command.returncode
    return outcome


def drawn(count: int, seed: int) -> list[Trial]:
    """Random trials; every victim, signal and pacing comes up about as often as the others."""
    rng = np.random.default_rng(seed)
    every = [Trial(victim, name, pacing) for victim in VICTIMS for name in SIGNALS for pacing in PACINGS]
    # In lockstep the run waits for who is stopped: see lockstep_trials.py.
    every = [trial for trial in every if (trial.name, trial.pacing) != ("STOP", "lockstep")]
    order: list[Trial] = []
    while len(order) < count:
        order += [every[index] for index in rng.permutation(len(every))]
    return order[:count]


def line(number: int, outcome: Outcome) -> str:
    """One line of the table."""
    trial = outcome.trial
    waited = f" (run over after {outcome.drive_s:.1f} s, then SIGCONT)" if np.isfinite(outcome.drive_s) else ""
    return (
        f"{number:4d}  {trial.victim:10s} {trial.name:5s} {trial.pacing:9s} start {outcome.start_s:6.1f} s  "
        f"end {outcome.end_s:6.1f} s  last voltage {outcome.last_voltage:.3g} V  exit {outcome.code}  "
        f"{', '.join(outcome.faults) or 'as it should'}{waited}"
    )


def main() -> int:
    """Print the table; 1 if something is not as it should."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=100, help="trials (default: 100)")
    parser.add_argument("--seed", type=int, default=12, help="seed of their order (default: 12)")
    parser.add_argument("--skip", type=int, default=0, help="trials of the order that are left out at its beginning")
    parser.add_argument("--at-once", type=int, default=1, help="trials at the same time (default: 1)")
    parser.add_argument("--keep", type=Path, help="folder that keeps what is not as it should")
    options = parser.parse_args()
    todo: queue.Queue[tuple[int, Trial]] = queue.Queue()
    for item in list(enumerate(drawn(options.count, options.seed), 1))[options.skip :]:
        todo.put(item)
    outcomes: list[Outcome] = []

    def work() -> None:
        domain = BenchDomain()
        number = domain.id
        domain.close()  # the runs take it themselves, one after the other
        while True:
            try:
                index, trial = todo.get_nowait()
            except queue.Empty:
                return
            folder = Path(tempfile.mkdtemp(prefix="nmt-signals-"))
            outcome = attempt(trial, folder / "out", number)
            outcomes.append(outcome)
            print(line(index, outcome), flush=True)
            if outcome.faults and options.keep:
                (folder / "said.txt").write_text(outcome.said)
                shutil.copytree(folder, options.keep / str(index), dirs_exist_ok=True)
            shutil.rmtree(folder, ignore_errors=True)

    workers = [threading.Thread(target=work) for _ in range(options.at_once)]
    for worker in workers:
        worker.start()
        time.sleep(1.0)
    for worker in workers:
        worker.join()
    lived = [outcome for outcome in outcomes if outcome.trial.plant_and_recorder_live]
    times = [outcome.end_s for outcome in outcomes]
    print(
        f"{len(outcomes)} signals, seed {options.seed}: {sum(value <= LONGEST for value in times)} ended within "
        f"{LONGEST:.0f} s (median {np.nanmedian(times):.1f} s, longest {np.nanmax(times):.1f} s); "
        f"{sum(outcome.last_voltage == 0.0 for outcome in lived)} of {len(lived)} at 0 V in the last block where plant "
        f"and recorder lived; {sum(not outcome.fault for outcome in outcomes)} started at once; "
        f"{sum(bool(outcome.left) for outcome in outcomes)} left something; load {os.getloadavg()[0]:.1f}"
    )
    return int(any(outcome.faults for outcome in outcomes) or len(outcomes) < options.count - options.skip)


if __name__ == "__main__":
    sys.exit(main())
