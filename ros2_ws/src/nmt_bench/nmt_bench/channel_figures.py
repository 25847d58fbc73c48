"""Figures of ``./nmt benchmark`` for many channels: the whole bench, its memory, and real time."""

from __future__ import annotations

import functools
import os
import threading
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from nmt_bench.benchmark_figures import AT_LEAST, AT_MOST, Figure
from nmt_core.errors import BenchError
from nmt_core.vocabulary import ResultCode
from nmt_rig.rig import Rig, SensorSection, load_rig

LIMIT_ONE_PROCESS = 10.0
LIMIT_PROCESSES = 8.0
LIMIT_LARGE = 2.0
LIMIT_MEMORY = 500.0
LIMIT_REAL_TIME = 0.98
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


def channel_figures(seconds: float) -> list[Figure]:
    """The whole bench with many channels beside its limits.

    Args:
        seconds: bench time of a run; a third of it for the largest.
    """
    name = "bench: 49 elements, 32 channels, 51.2 kHz"
    figures = []
    for words, processes, limit in (
        ("all nodes in one process", False, LIMIT_ONE_PROCESS),
        ("one process a node", True, LIMIT_PROCESSES),
    ):
        rig = large_rig(49, 32, 51_200.0)
        speed = functools.partial(_speed, rig, processes, seconds)
        figures.append(_measured(f"{name}, {words}", limit, speed))
    name = "bench: 50 elements, 64 channels, 51.2 kHz, one process a node"
    memory: list[float] = []

    def large() -> float:
        # What other figures have loaded into this process is not the bench's.
        factor, megabytes = _alone(_run, large_rig(50, 64, 51_200.0), True, seconds / 3.0)
        memory.append(megabytes)
        return factor

    figures.append(_measured(name, LIMIT_LARGE, large))
    if memory:
        used = memory[0]
        figures.append(Figure(f"{name}: memory", used, "MB", LIMIT_MEMORY, AT_MOST, used <= LIMIT_MEMORY))
    name = "bench: 200 channels, 25.6 kHz, in real time"
    rig = large_rig(20, 200, 25_600.0)
    figures.append(_measured(name, LIMIT_REAL_TIME, functools.partial(_speed, rig, True, 0.0, "realtime")))
    return figures


def _measured(name: str, limit: float, measure: Callable[[], float]) -> Figure:
    try:
        value = measure()
    except ImportError:
        return Figure(name, None, "× real time", limit, "not measured: ROS 2 is not there")
    except BenchError as error:
        return Figure(name, None, "× real time", limit, f"not measured: {error}")
    return Figure(name, value, "× real time", limit, AT_LEAST, value >= limit)


def _alone(function: Callable[..., _Result], *arguments: Any) -> _Result:
    """What a function gives in a process of its own."""
    with ProcessPoolExecutor(max_workers=1, mp_context=get_context("spawn")) as process:
        return process.submit(function, *arguments).result()


def _speed(rig: Rig, processes: bool, seconds: float, pacing: str = "lockstep") -> float:
    return _run(rig, processes, seconds, pacing)[0]


def _run(rig: Rig, processes: bool, seconds: float, pacing: str = "lockstep") -> tuple[float, float]:
    """Multiple of real time, and the largest memory of all processes together, MB.

    Raises:
        ImportError: ROS 2 is not there.
        BenchError: the bench could not run, or the run did not succeed without a gap.
    """
    from nmt_bench.harness import Bench

    periods = _REAL_TIME_PERIODS if pacing == "realtime" else max(10, round(20.0 * (seconds - 2.0)))
    with Bench(rig, levels=[_LEVEL], processes=processes, window_periods=periods, pacing=pacing) as bench:
        watch = _MemoryWatch()
        try:
            result = bench.run()
        finally:
            used = watch.end()
    if result.code != ResultCode.SUCCEEDED:
        raise BenchError(result.message)
    if not any("gaps 0, missing samples 0" in remark for remark in result.remarks):
        raise BenchError(" ".join(result.remarks))
    return result.real_time_factor, used


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
