"""Starts of the bench in six processes under load: one line a failure, and how many there were.

    ./nmt shell <<< "python tests/node/start_trials.py --count 300 --burners 4"

A start is the shortest run there is: one level, from nothing to its result. ``--burners`` processes count meanwhile, so
that discovery, imports and the matching of both sides of the action are as slow as on a busy computer.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import time

import numpy as np

from nmt_bench.harness import Bench
from nmt_core.errors import BenchError
from nmt_core.vocabulary import ResultCode


def burn() -> None:
    """Keep a core busy."""
    count = 0
    while True:
        count += 1


def start() -> tuple[float, str]:
    """Seconds that a shortest run takes, and what went wrong; empty if nothing did."""
    began = time.monotonic()
    try:
        with Bench("joint_resonator", [0.3], processes=True, window_periods=5) as bench:
            result = bench.run()
    except BenchError as error:
        return time.monotonic() - began, str(error)
    fault = "" if result.code == ResultCode.SUCCEEDED and len(result.points) == 1 else result.message
    return time.monotonic() - began, fault


def main() -> int:
    """Print the failures; 1 if there is one."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=300, help="starts (default: 300)")
    parser.add_argument("--burners", type=int, default=4, help="processes that keep cores busy (default: 4)")
    parser.add_argument("--seconds", type=float, default=np.inf, help="begin no start after this time")
    options = parser.parse_args()
    burners = [multiprocessing.Process(target=burn, daemon=True) for _ in range(options.burners)]
    for burner in burners:
        burner.start()
    times: list[float] = []
    faults = 0
    began = time.monotonic()
    try:
        while len(times) < options.count and time.monotonic() - began < options.seconds:
            seconds, fault = start()
            times.append(seconds)
            if fault:
                faults += 1
                print(f"start {len(times)}, {seconds:.1f} s: {fault}", flush=True)
    finally:
        for burner in burners:
            burner.kill()
    print(
        f"{len(times)} starts, {faults} failed; median {np.median(times):.1f} s, longest {max(times):.1f} s; load "
        f"{os.getloadavg()[0]:.1f}"
    )
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
