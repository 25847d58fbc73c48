"""Kills of the run command, its loader and its nodes at random moments from the first on: what is left is counted.

./nmt shell <<< "python tests/node/kill_trials.py --count 30"
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from node.signal_trials import PATIENCE, hear_signals, runs, shared_memory

from nmt_session.node_plan import NODES

LAUNCHER, LOADER = "launcher", "loader"
MARK = "NMT_KILL_TRIAL"
_PATIENCE = 30.0  # s for what is left to end
_LATEST = 5.0  # s after the start of the command


def marked(mark: str) -> dict[int, str]:
    """Living processes of a trial, whoever their parent is: process id -> launcher, loader, name of a node or other."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if f"{MARK}={mark}".encode() not in (folder / "environ").read_bytes().split(b"\0"):
                continue
            words = (folder / "cmdline").read_bytes().decode().rstrip("\0").split("\0")
        except OSError:
            continue
        if runs(int(folder.name)):
            name = next((name for name in NODES if any(word.endswith(f"/{name}") for word in words)), "other")
            name = LOADER if any(word.endswith("/node_loader.py") for word in words) else name
            found[int(folder.name)] = LAUNCHER if "nmt_bench" in words else name
    return found


def trial(mark: str, victim: str, moment: float) -> tuple[str, list[str]]:
    """Who was killed, and what should not be."""
    folder = tempfile.TemporaryDirectory(prefix="nmt-kill-")
    words = [
        "run",
        "joint_resonator",
        "--levels",
        "0.3,0.5",
        "--periods",
        "200000",  # never over by itself
        "--out",
        f"{folder.name}/out",
    ]
    command = subprocess.Popen(
        [sys.executable, "-m", "nmt_bench", *words, "--reference", "none", "--no-report"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, MARK: mark},
        start_new_session=True,
        preexec_fn=hear_signals,
    )
    faults = []
    end = time.monotonic() + moment
    killed = "nobody"
    while command.poll() is None and time.monotonic() < end + _PATIENCE:
        time.sleep(0.02)
        processes = marked(mark)
        chosen = [process for process, name in processes.items() if name == victim]
        if chosen and time.monotonic() >= end:
            faults += [f"shared memory: {name}" for name in shared_memory(list(processes))]
            os.kill(chosen[0], signal.SIGKILL)
            killed = victim
            break
    said, _ = command.communicate(timeout=PATIENCE)
    end = time.monotonic() + _PATIENCE
    while (left := marked(mark)) and time.monotonic() < end:
        time.sleep(0.05)
    for process, name in left.items():
        faults.append(f"left: {name} {process}")
        os.kill(process, signal.SIGKILL)
    if "Traceback" in said or "should not have happened" in said:
        faults.append(said.strip().splitlines()[-1])
    wanted = (-signal.SIGKILL,) if killed == LAUNCHER else (1, 2)
    if command.returncode not in wanted:
        faults.append(f"exit code {command.returncode}: {said.strip()[-300:]}")
    folder.cleanup()
    return killed, faults


def main() -> int:
    """One line a trial; 1 if something is not as it should."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=30, help="kills (default: 30)")
    parser.add_argument("--seed", type=int, default=1, help="of victims and moments (default: 1)")
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    victims = [LAUNCHER, LOADER, *NODES]
    counts: Counter[str] = Counter()
    faulty = 0
    for number in range(options.count):
        victim = victims[number % len(victims)]
        moment = rng.uniform(0.0, 1.0 if victim == LOADER else _LATEST)
        killed, faults = trial(f"{os.getpid()}-{number}", victim, moment)
        counts[killed] += 1
        faulty += bool(faults)
        print(
            f"{number + 1:3d}  {victim:10s} {moment:4.1f} s  killed {killed:10s} {faults or 'as it should'}", flush=True
        )
    print(f"{dict(counts)}; {faulty} of {options.count} not as they should be")
    return int(faulty > 0)


if __name__ == "__main__":
    sys.exit(main())
