"""Gaps of a long stream through a converter: every one must be marked.

The drive is noise, and the specimen's monitor shows what came out at the port: a block that is not marked must be, to
the sample, what was put out. The process at the converter can be stopped now and then, and the computer loaded.

./nmt shell <<< "python tests/node/converter_gaps.py portaudio --seconds 600"
./nmt shell <<< "python tests/node/converter_gaps.py portaudio --seconds 60 --stop-every 3 --stop-ms 30 --load 4"
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from node.converter_bench import KINDS, RATES, converter_bench, environment
from node.converter_delay import open_device

from nmt_core.messages.records import DriveCommand
from nmt_core.vocabulary import Waveform
from nmt_plant.real_time import real_time_priority

DIFFERENCE = 0.02
"""Of the drive's rms: a block of noise that differs by more from what was put out holds a gap."""


@dataclass
class Gaps:
    """Outcome of a stream.

    Attributes:
        blocks: read.
        marked: of them, left out by the device.
        unmarked: blocks that were given and are not what was put out: first sample, and where in it the difference
            begins and ends.
        places: first samples of the marked blocks.
        stops: times at which the process at the converter was stopped.
        lost_turns: of the converter.
        ended: why the drive was taken to zero; empty = it was not.
        lateness: s, of all blocks.
    """

    blocks: int = 0
    marked: int = 0
    unmarked: list[tuple[int, int, int]] = field(default_factory=list)
    places: list[int] = field(default_factory=list)
    stops: int = 0
    lost_turns: int = 0
    ended: str = ""
    lateness: list[float] = field(default_factory=list)


def stream(
    kind: str, folder: Path, seconds: float, stop_every: float = 0.0, stop_s: float = 0.03, block: int = 0
) -> Gaps:
    """Stream noise for as long as is said; stops, s apart, of the process at the converter."""
    rate = RATES[kind][0]
    block = block or rate // (100 if kind == "portaudio" else 50)  # a device server takes up to 20 ms for a call
    changes = (f"block_samples={block}", "watchdog.blocks=0", "limits.force_n=50")
    result = Gaps()
    with converter_bench(kind, folder, changes=changes) as bench:
        device = open_device(kind, bench.device.partition("@")[2], *changes)
        noise = DriveCommand(Waveform.RANDOM, amplitude=0.5, ramp=0.1, band_low_hz=20.0, band_high_hz=0.1 * rate)
        row = next(n for n, entry in enumerate(device.section.inputs) if entry.channel == "u")
        sensitivity = device.section.inputs[row].sensitivity_v
        next_stop = stop_every or float("inf")
        began = time.monotonic()
        try:
            with real_time_priority():
                device.write(noise)
                while result.blocks * block < seconds * rate and not device.tripped:
                    if time.monotonic() - began > next_stop and device.output_pid is not None:
                        next_stop += stop_every
                        result.stops += 1
                        os.kill(device.output_pid, signal.SIGSTOP)
                        time.sleep(stop_s)
                        os.kill(device.output_pid, signal.SIGCONT)
                    first = device.next_sample
                    got = device.read()
                    result.lateness.append(device.lateness)
                    result.blocks += 1
                    result.marked += not got
                    seen = device.measured[row] / sensitivity
                    wrong = np.flatnonzero(np.abs(seen - device.put_out) > DIFFERENCE * 0.5)
                    if got and wrong.size:
                        result.unmarked.append((first, int(wrong[0]), int(wrong[-1])))
                    elif not got:
                        result.places.append(first)
            result.ended = device.tripped
            result.lost_turns = device.figures.lost_turns
        finally:
            device.close()
    return result


def main() -> int:
    """Print the counts; 0 where no gap was unmarked and the drive was not taken to zero."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--stop-every", type=float, default=0.0, metavar="S")
    parser.add_argument("--stop-ms", type=float, default=30.0, metavar="MS")
    parser.add_argument("--load", type=int, default=0, metavar="N", help="busy processes beside it")
    given = parser.parse_args()
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(given.load)]
    try:
        with tempfile.TemporaryDirectory() as temporary:
            os.environ.update(environment(Path(temporary)))
            found = stream(given.kind, Path(temporary), given.seconds, given.stop_every, 1e-3 * given.stop_ms)
    finally:
        for process in busy:
            process.kill()
            process.wait()
    late = 1e3 * np.array(found.lateness)
    print(
        f"{found.blocks} blocks, {found.stops} stops: {found.lost_turns} turns with losses, {found.marked} "
        f"blocks marked, {len(found.unmarked)} unmarked {found.unmarked[:10] or ''}; next block late by "
        f"{np.median(late):.1f} ms (median), {np.quantile(late, 0.99):.1f} (99 %), {late.max():.1f} (worst); load "
        f"{os.getloadavg()[0]:.1f}. {found.ended}"
    )
    return 0 if not found.unmarked and not found.ended else 1


if __name__ == "__main__":
    sys.exit(main())
