"""The plant node in real time, hung, stopped, blocked and killed: its output goes to zero by itself.

Judged by the converter's own samples, as the process that owns the output records them, so that a busy machine changes
nothing: from the sample at which the last block was fed to the first zero that is held. The logic is tested on a clock
of the test in `plant.test_converters` and `plant.test_output_owner`.
"""

from __future__ import annotations

import ctypes
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nmt_bench.harness import Bench, Progress
from nmt_core.processes.output_record import OutputLine, output_sentence, read_output
from nmt_core.vocabulary import ResultCode
from nmt_plant.devices.guarded_device import LEAST_LEAD
from nmt_record.bag.bag_reader import Bag

RATE, BLOCK = 10_000.0, 200
LEAD = 60  # blocks; a busy machine may be late by more than a second without a fault
RAMP = 0.1  # s, limits.ramp_s of the beam
STATED = LEAD * BLOCK / RATE + RAMP + 0.02  # s from the last block fed to zero; see run-on-hardware.md
PATIENCE = 60.0  # s of wall time, for a busy machine


def options(tmp_path: Path, **changes: Any) -> dict[str, Any]:
    return {
        "out": tmp_path / "out", "pacing": "realtime", "latency_blocks": LEAD, "window_periods": 400,
        "node_values": {"sequencer": {"ready_timeout": 90.0}}, **changes,
    }  # fmt: skip


def wait_for(path: Path, states: tuple[str, ...], after: int = 0) -> list[OutputLine]:
    """The record's lines from ``after`` on, once one of them has one of the states."""
    end = time.monotonic() + PATIENCE
    while True:
        lines = read_output(path)[after:]
        if any(line.state in states for line in lines):
            return lines
        assert time.monotonic() < end, f"no {' or '.join(states)} in {[line.state for line in lines]}"
        time.sleep(0.02)


def when_driving(record: Path, act: Callable[[int], Any]) -> tuple[Callable[[Progress], None], list[Any]]:
    """A callback that acts once, at the newest sample, when the output has moved; and what the act has returned."""
    done: list[Any] = []

    def look(progress: Progress) -> None:
        if not done and read_output(record)[-1:] and read_output(record)[-1].state == "FOLLOWING":
            done.append(None)
            done[0] = act(progress.sample)

    return look, done


def seconds_to_zero(lines: list[OutputLine]) -> float:
    """From the last block that was fed to the first sample at zero, by the converter's clock."""
    ramping = next(line for line in lines if line.state == "RAMPING")
    held = next(line for line in lines if line.state in ("HELD", "ENDED"))
    return (held.sample - ramping.fed_at) / RATE


@pytest.mark.campaign
@pytest.mark.parametrize("fault", [signal.SIGSTOP, signal.SIGKILL])
def test_a_plant_that_is_stopped_or_killed(fault: signal.Signals, tmp_path: Path) -> None:
    with Bench("beam", [0.3], processes=True, **options(tmp_path)) as bench:
        assert bench.processes is not None
        pid, record = bench.processes.pids["plant"], bench.out / "output.jsonl"

        def strike(_: int) -> list[OutputLine]:
            before = len(read_output(record))
            os.kill(pid, fault)
            return wait_for(record, ("HELD", "ENDED"), before)

        look, done = when_driving(record, strike)
        result = bench.run(look)
    assert done, result.message
    assert RAMP <= seconds_to_zero(done[0]) <= STATED
    assert result.code == ResultCode.NODE_LOST
    owner = done[0][0].pid
    assert "the process that owns the output put it to zero at sample" in result.message
    end = time.monotonic() + PATIENCE
    while Path(f"/proc/{owner}").exists():
        assert time.monotonic() < end, "the owner stays behind"
        time.sleep(0.02)
    assert read_output(record)[-1].state == "ENDED"


def hang() -> None:
    time.sleep(STATED + 1.0)


def block_the_interpreter() -> None:
    ctypes.PyDLL(None).usleep(int(1e6 * (STATED + 1.0)))  # PyDLL keeps the interpreter locked


@pytest.mark.campaign
@pytest.mark.parametrize("fault", [hang, block_the_interpreter])
def test_a_read_that_hangs(fault: Callable[[], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All nodes in one process, which hangs in the device; when it goes on, the run ends with what the owner did."""
    with Bench("beam", [0.3], **options(tmp_path)) as bench:
        device, record = bench.nodes["plant"].device, bench.out / "output.jsonl"
        measure, before = device._measure, []

        def hung(drive: Any) -> Any:
            monkeypatch.undo()
            before.append(len(read_output(record)))
            fault()
            return measure(drive)

        look, done = when_driving(record, lambda _: monkeypatch.setattr(device, "_measure", hung))
        result = bench.run(look)
        lines = read_output(record)[before[0] :]
    assert done, result.message
    assert RAMP <= seconds_to_zero(lines) <= STATED
    assert result.code == ResultCode.NODE_LOST
    assert "The drive was stopped at sample" in result.message
    assert "not fed for" in result.message or "no block was there" in result.message
    blocks = list(Bag.open(tmp_path / "out" / "bag").blocks("voltage"))
    line = np.concatenate([block.data[0] for block in blocks])
    assert not blocks[-1].data.any()
    assert np.max(np.abs(np.diff(line))) < 0.3 * 2 * np.pi * 25 / RATE, "the recorded voltage has the ramp, no step"


@pytest.mark.campaign
def test_an_owner_that_is_killed_leaves_an_unknown_state_and_says_so(tmp_path: Path) -> None:
    with Bench("beam", [0.3], **options(tmp_path)) as bench:
        record = bench.out / "output.jsonl"
        look, done = when_driving(record, lambda _: os.kill(bench.nodes["plant"].device.output_pid, signal.SIGKILL))
        result = bench.run(look)
    assert done, result.message
    assert result.code == ResultCode.NODE_LOST
    assert "the state of the output is UNKNOWN" in result.message
    time.sleep(1.2)  # until the record is old
    assert "UNKNOWN" in output_sentence(record)


@pytest.mark.campaign
@pytest.mark.parametrize(("name", "longest"), [("pll", 1.5), ("sequencer", 3.5), ("extract", 4.0), ("recorder", 4.0)])
def test_another_node_that_is_stopped(name: str, longest: float, tmp_path: Path) -> None:
    """The plant takes the drive to zero when commands or heartbeats stop; times as in run-on-hardware.md."""
    with Bench("beam", [0.3], processes=True, **options(tmp_path, window_periods=4000)) as bench:
        assert bench.processes is not None
        pid, record = bench.processes.pids[name], bench.out / "output.jsonl"

        def strike(sample: int) -> tuple[int, list[OutputLine]]:
            before = len(read_output(record))
            os.kill(pid, signal.SIGSTOP)
            try:
                return sample, wait_for(record, ("AT_ZERO", "HELD"), before)
            finally:
                os.kill(pid, signal.SIGCONT)

        look, done = when_driving(record, strike)
        result = bench.run(look)
    assert done, result.message
    assert result.code != ResultCode.SUCCEEDED
    sample, lines = done[0]
    # What the client had heard of is older than the stop by the blocks that wait and by its own messages.
    assert (lines[-1].sample - sample) / RATE <= longest + LEAD * BLOCK / RATE + 1.0


def test_the_stated_time_is_that_of_the_least_lead() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs/how-to/run-on-hardware.md").read_text(encoding="utf-8")
    assert f"**stated: {1e3 * (LEAST_LEAD * BLOCK / RATE + RAMP + 0.02):.0f} ms**" in page
