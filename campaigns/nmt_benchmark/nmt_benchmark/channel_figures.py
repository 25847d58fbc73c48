"""Figures of ``./nmt benchmark`` for the whole bench: commands, speed, processor time, many channels, real time."""

from __future__ import annotations

import contextlib
import functools
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from nmt_benchmark.benchmark_figures import AT_MOST, Figure, window_periods
from nmt_core.errors import BenchError
from nmt_core.vocabulary import ResultCode
from nmt_rig.rig import Rig, SensorSection, load_rig
from nmt_session import Session, plan_test

LIMIT_ONE_PROCESS = 100.0
LIMIT_PROCESSES = 65.0
LIMIT_OF_ONE = 0.9
LIMIT_OF_DEVICE = 0.4
LIMIT_BENCH_TIME = 3.0
LIMIT_CHANNELS = 10.0
LIMIT_CHANNELS_PROCESSES = 8.0
LIMIT_CHANNELS_CPU = 0.2
LIMIT_LARGE = 2.0
LIMIT_LARGE_CPU = 0.5
LIMIT_MEMORY = 500.0
LIMIT_REAL_TIME = 0.98
LIMIT_REAL_TIME_CPU = 0.6
LIMIT_COMMAND = 6.0
LIMITS_SMALLEST = {"": 3.8, "--one-process": 3.3}
_TEN_LEVELS = ("--levels", "0.05:0.6:10")
_SMALLEST = ("--levels", "0.3", "--periods", "5")
_LEVELS = (0.2, 0.5, 1.0)
_SHORT = "block_samples=200"  # 20 ms
_ROUNDS = 2
_CPU = "s of processor time a bench second"
_Result = TypeVar("_Result")
_LEVEL = 0.5  # V
_LOOK = 0.1  # s between two looks at the memory
_BLOCK = 0.02  # s
_REAL_TIME_PERIODS = 60


def large_rig(elements: int, channels: int, sample_rate: float) -> Rig:
    """The beam with a finer mesh and accelerometers along it, several at a point where there are more than points.

    Args:
        elements: of the beam.
        channels: force, voltage and accelerometers; one of these is at the drive point.
        sample_rate: Hz.

    Raises:
        ValueError: fewer than 3 channels.
    """
    if channels < 3:
        raise ValueError(f"at least 3 channels, got {channels}")
    exciter = round(elements * 14 / 49)
    rig = load_rig(
        "beam",
        [
            f"sample_rate_hz={sample_rate}",
            f"block_samples={round(_BLOCK * sample_rate)}",
            f"structure.elements={elements}",
            f"local_elements.0.point={round(elements * 21 / 49)}",
            f"exciter.point={exciter}",
        ],
    )
    points = [exciter, *(point for point in range(elements, 0, -1) if point != exciter)]
    sensors = [SensorSection(quantity="force", point="drive"), SensorSection(quantity="voltage")]
    sensors += [
        SensorSection(quantity="acceleration", point=points[k % elements], channel=f"a{k + 1}")
        for k in range(channels - 2)
    ]
    extraction = rig.extraction.model_copy(update={"quantity": "acceleration"})
    return rig.model_copy(update={"sensors": sensors, "extraction": extraction})


class RunCost(NamedTuple):
    """What a run took.

    Attributes:
        speed: multiple of real time.
        megabytes: largest memory of all processes together; NaN where it was not looked at.
        cpu: processor time of all processes from the first progress to the end, s a bench second.
    """

    speed: float
    megabytes: float
    cpu: float


def bench_figures(seconds: float) -> list[Figure]:
    """The whole bench with its bag written, all nodes in one process and one process a node, in turn; the device alone.

    Args:
        seconds: bench time of a run.
    """
    from nmt_benchmark.plant_speed import run_benchmark

    plan = plan_test("beam")
    periods = window_periods(seconds)
    ticks = {"sequencer": {"tick_blocks": plan.tick_blocks}}
    kinds = ("all nodes in one process", False, LIMIT_ONE_PROCESS), ("one process a node", True, LIMIT_PROCESSES)
    best: dict[bool, RunCost] = {}
    figures: list[Figure] = []
    try:
        for _ in range(_ROUNDS):
            for _, processes, _ in kinds:
                cost = run_cost(plan.rig, processes, periods, levels=_LEVELS, node_values=ticks)
                best[processes] = max(best.get(processes, cost), cost)
        device = run_benchmark(plan.rig, seconds).device
        for words, processes, limit in kinds:
            cost = best[processes]
            short = run_cost(load_rig("beam", [_SHORT]), processes, periods, levels=_LEVELS)
            name = f"bench: {words}"
            figures.append(Figure.limited(name, cost.speed, "× real time", limit))
            figures.append(Figure(f"{name}, long blocks", cost.speed, "× real time", short.speed, "blocks of 20 ms"))
            figures.append(Figure(name, cost.cpu, _CPU, best[False].cpu, "in one process"))
        ratio = best[True].speed / best[False].speed
        figures.append(Figure.limited("bench: one process a node over all in one", ratio, "×", LIMIT_OF_ONE))
        share = 1.0 / (best[False].cpu * device)
        name = "bench: processor time of the device alone over that of all in one process"
        figures.append(Figure.limited(name, share, "×", LIMIT_OF_DEVICE))
    except ImportError:
        figures.append(Figure("bench", None, "× real time", None, "not measured: ROS 2 is not there"))
    except BenchError as error:
        figures.append(Figure("bench", None, "× real time", None, f"not measured: {error}"))
    times = []
    for test in (plan, plan_test("beam", overrides=[_SHORT])):
        with Session(test, record=False, extract=False) as session:
            times.append(session.run().bench_time)
    more = 100.0 * (times[0] / times[1] - 1.0)
    figures.append(Figure.limited("bench time, long blocks against 20 ms", more, "% more", LIMIT_BENCH_TIME, AT_MOST))
    return figures


def command_figures(_: float) -> list[Figure]:
    """Whole commands with start, reference and report: ten levels, and the smallest run in both kinds."""
    wall, cpu = _command(*_TEN_LEVELS)
    name = "command: run of ten levels"
    figures = [
        Figure.limited(name, wall, "s", LIMIT_COMMAND, AT_MOST),
        Figure(name, cpu, "s of processor time", None, "all processes"),
    ]
    for option, limit in LIMITS_SMALLEST.items():
        _, cpu = _command(*_SMALLEST, *filter(None, (option,)))
        kind = "all nodes in one process" if option else "one process a node"
        figures.append(Figure.limited(f"command: smallest run, {kind}", cpu, "s of processor time", limit, AT_MOST))
    return figures


def _command(*options: str) -> tuple[float, float]:
    """Wall time and processor time (s) of ``./nmt run beam``, its nodes included.

    Raises:
        BenchError: it failed.
    """
    with tempfile.TemporaryDirectory(prefix="nmt-benchmark-") as folder:
        words = [sys.executable, "-m", "nmt_bench", "run", "beam", *options, "--quiet", "--out", f"{folder}/out"]
        before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        wall, after = time.monotonic() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise BenchError(f"'{' '.join(words[2:])}' failed: {done.stderr.strip() or done.stdout.strip()}")
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def channel_figures(seconds: float) -> list[Figure]:
    """The whole bench with many channels against its limits.

    Args:
        seconds: bench time of a run; a third of it for the largest.
    """
    periods, fewer = (max(10, round(20.0 * (time - 2.0))) for time in (seconds, seconds / 3.0))
    rig = large_rig(49, 32, 51_200.0)
    name = "bench: 49 elements, 32 channels, 51.2 kHz"
    each = "one process a node"
    figures = _measured(f"{name}, all nodes in one process", LIMIT_CHANNELS, lambda: run_cost(rig, False, periods))
    figures += _measured(
        f"{name}, {each}", LIMIT_CHANNELS_PROCESSES, lambda: run_cost(rig, True, periods), LIMIT_CHANNELS_CPU
    )
    # What other figures have loaded into this process is not the bench's.
    figures += _measured(
        f"bench: 50 elements, 64 channels, 51.2 kHz, {each}",
        LIMIT_LARGE,
        lambda: in_a_process(functools.partial(run_cost, memory=True), large_rig(50, 64, 51_200.0), True, fewer),
        LIMIT_LARGE_CPU,
        LIMIT_MEMORY,
    )
    return figures + _measured(
        "bench: 200 channels, 25.6 kHz, in real time",
        LIMIT_REAL_TIME,
        lambda: run_cost(large_rig(20, 200, 25_600.0), True, _REAL_TIME_PERIODS, pacing="realtime"),
        LIMIT_REAL_TIME_CPU,
    )


def _measured(
    name: str, speed: float, measure: Callable[[], RunCost], cpu: float | None = None, megabytes: float | None = None
) -> list[Figure]:
    """What a run took against its limits, as far as it has any."""
    try:
        cost = measure()
    except ImportError:
        return [Figure(name, None, "× real time", speed, "not measured: ROS 2 is not there")]
    except BenchError as error:
        return [Figure(name, None, "× real time", speed, f"not measured: {error}")]
    figures = [Figure.limited(name, cost.speed, "× real time", speed)]
    if cpu is not None:
        figures.append(Figure.limited(name, cost.cpu, _CPU, cpu, AT_MOST))
    if megabytes is not None:
        figures.append(Figure.limited(f"{name}: memory", cost.megabytes, "MB", megabytes, AT_MOST))
    return figures


def in_a_process(function: Callable[..., _Result], *arguments: Any) -> _Result:
    """What a function gives in a process of its own."""
    with ProcessPoolExecutor(max_workers=1, mp_context=get_context("spawn")) as process:
        return process.submit(function, *arguments).result()


def run_cost(
    rig: Rig,
    processes: bool,
    periods: int,
    pacing: str = "lockstep",
    levels: Sequence[float] = (_LEVEL,),
    node_values: Mapping[str, Mapping[str, Any]] | None = None,
    memory: bool = False,
) -> RunCost:
    """A run of the whole bench; to look at its memory takes time.

    Raises:
        ImportError: ROS 2 is not there.
        BenchError: the bench could not run, or the run did not succeed without a gap.
    """
    from nmt_bench.harness import Bench

    with Bench(
        rig, levels=levels, processes=processes, window_periods=periods, pacing=pacing, node_values=node_values or {}
    ) as bench:
        nodes = [] if bench.processes is None else list(bench.processes.pids.values())
        begun: list[float] = []

        def on_progress(_: object) -> None:
            if not begun:
                begun.append(_processor_time(nodes))

        watch = _MemoryWatch() if memory else None
        try:
            result = bench.run(on_progress)
        finally:
            used = float("nan") if watch is None else watch.end()
        spent = _processor_time(nodes) - begun[0] if begun else float("nan")
    if result.code != ResultCode.SUCCEEDED:
        raise BenchError(result.message)
    if not any("gaps 0, missing samples 0" in remark for remark in result.remarks):
        raise BenchError(" ".join(result.remarks))
    return RunCost(result.real_time_factor, used, spent / result.bench_time)


def _processor_time(nodes: Sequence[int]) -> float:
    """Processor time of this process and of nodes that are processes, s."""
    spent = time.process_time()
    for process in nodes:
        with contextlib.suppress(OSError):
            words = Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
            spent += (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")
    return spent


class _MemoryWatch:
    """Largest memory of this process and its children together; what they share counts once."""

    def __init__(self) -> None:
        self._largest = 0.0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)
        self._thread.start()

    def _look(self) -> None:
        while not self._over.wait(_LOOK):
            self._largest = max(self._largest, sum(map(_megabytes, _family())))

    def end(self) -> float:
        """Stop; the largest memory in MB."""
        self._over.set()
        self._thread.join()
        return self._largest


def _family() -> list[str]:
    own, found = str(os.getpid()), [str(os.getpid())]
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                parent = (folder / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()[1]
            except OSError:
                continue
            if parent == own:
                found.append(folder.name)
    return found


def _megabytes(process: str) -> float:
    """Proportional set size: shared pages count by the share of the process."""
    try:
        text = Path(f"/proc/{process}/smaps_rollup").read_text(encoding="utf-8")
    except OSError:
        return 0.0
    sizes = [int(line.split()[1]) for line in text.splitlines() if line.startswith("Pss:")]
    return float(np.sum(sizes)) * 1024 / 1e6
