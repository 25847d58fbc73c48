"""A long run in lockstep on a loaded computer: no false alarm, no growth of memory.

    ./nmt shell <<< "python tests/node/soak.py --minutes 60 --load 10 --out out/soak"

Starts ``./nmt run`` with levels for days, adds busy processes while the computer's load is below the wanted one, notes
memory of each process every ten seconds in ``memory.csv``, ends the run as Ctrl-C does, and prints a table.
"""

from __future__ import annotations

import argparse
import csv
import os
import signal
import statistics
import subprocess
import sys
import time
from pathlib import Path

from signal_trials import hear_signals

PERIOD = 10.0  # s between two looks
END = 1800.0  # s that the run gets to end and to write its report of hundreds of levels
FIRST = 0.1  # share of the time in which memory may still grow: imports, kernels, histories that fill
COMMAND = ["run", "joint_resonator", "--levels", "0.3:0.5:1000:linear", "--periods", "12000", "--reference", "none"]


def memory(process: int) -> float:
    """Resident memory of a process, MB; 0 if it has ended."""
    try:
        for line in Path(f"/proc/{process}/status").read_text().splitlines():
            if line.startswith("VmRSS:"):
                return int(line.split()[1]) / 1024.0
    except OSError:
        pass
    return 0.0


def nodes_of(process: int) -> dict[str, int]:
    """Process ids of the nodes that the run has started, by name."""
    found = {}
    for path in Path(f"/proc/{process}/task").glob("*/children"):
        for child in path.read_text().split():
            words = Path(f"/proc/{child}/cmdline").read_bytes().decode().split("\0")
            found.update({Path(word).name: int(child) for word in words[:2] if "/lib/nmt_" in word})
    return found


class Burners:
    """Busy processes at the lowest priority, as many as the load lacks."""

    def __init__(self, load: float) -> None:
        self.load = load
        self.processes: list[subprocess.Popen[bytes]] = []

    def adjust(self) -> None:
        lack = self.load - os.getloadavg()[0]
        if lack > 1.0 and len(self.processes) < self.load:
            command = ["nice", "-n", "19", sys.executable, "-c", "while True: pass"]
            self.processes.append(subprocess.Popen(command))
        elif lack < -1.0 and self.processes:
            self.end(1)

    def end(self, count: int | None = None) -> None:
        for process in self.processes[:count]:
            process.kill()
            process.wait()
        del self.processes[:count]


def soak(minutes: float, load: float, out: Path) -> tuple[int, str, list[dict[str, float]]]:
    """Run and watch; exit code, what the run has said, and what was noted."""
    rows: list[dict[str, float]] = []
    burners = Burners(load)
    out.mkdir(parents=True, exist_ok=True)
    said = out / "said.txt"
    with open(said, "w") as stream, open(out / "memory.csv", "w", newline="") as table:
        words = [sys.executable, "-m", "nmt_bench", *COMMAND, "--out", str(out / "run")]
        run = subprocess.Popen(
            words, stdout=stream, stderr=subprocess.STDOUT, start_new_session=True, preexec_fn=hear_signals
        )
        writer = None
        began = time.monotonic()
        try:
            while run.poll() is None and time.monotonic() - began < 60.0 * minutes:
                time.sleep(PERIOD)
                burners.adjust()
                nodes = {"run command": run.pid, **nodes_of(run.pid)}
                if len(nodes) < 6:
                    continue
                row = {"time_s": round(time.monotonic() - began, 1), "load": os.getloadavg()[0]}
                row.update({f"{name}_mb": round(memory(process), 1) for name, process in nodes.items()})
                rows.append(row)
                if writer is None:
                    writer = csv.DictWriter(table, list(row))
                    writer.writeheader()
                writer.writerow(row)
                table.flush()
            if run.poll() is None:
                run.send_signal(signal.SIGINT)
            code = run.wait(END)
        finally:
            burners.end()
            if run.poll() is None:
                run.terminate()
                run.wait(END)
    return code, said.read_text(), rows


def main() -> int:
    """Print the table; 1 if the run ended by itself, or memory grew by more than a tenth."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=60.0, help="wall time (default: 60)")
    parser.add_argument("--load", type=float, default=10.0, help="load of the computer to be kept (default: 10)")
    parser.add_argument("--out", type=Path, required=True, help="folder of the run and of memory.csv")
    options = parser.parse_args()
    code, said, rows = soak(options.minutes, options.load, options.out)
    wall = rows[-1]["time_s"] if rows else 0.0
    settled = [row for row in rows if row["time_s"] > FIRST * wall]
    loads = [row["load"] for row in rows] or [0.0]
    print(f"{wall / 60:.1f} min; load {statistics.mean(loads):.1f} (mean), {min(loads):.1f} to {max(loads):.1f}")
    print("\n".join(said.strip().splitlines()[-6:]))
    alarmed, grown = code != 130, False
    for name in [key for key in (rows[-1] if rows else {}) if key.endswith("_mb")]:
        values = [row[name] for row in settled]
        tenth = max(1, len(values) // 10)
        first, last = statistics.mean(values[:tenth]), statistics.mean(values[-tenth:])
        hours = 0.9 * wall * (1.0 - FIRST) / 3600.0
        grown = grown or last > 1.1 * first
        print(f"{name[:-3]:12s} {first:7.1f} MB, then {last:7.1f} MB; largest {max(values):7.1f}; "
              f"{(last - first) / hours:+.1f} MB an hour")  # fmt: skip
    print(f"exit code {code}; " + ("the run ended by itself" if alarmed else "no false alarm"))
    return int(alarmed or grown or not rows)


if __name__ == "__main__":
    sys.exit(main())
