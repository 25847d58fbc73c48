"""Kinds of test other than phase resonance through all nodes: random, ring-down, sweep, stepped sine."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

from nmt_bench.harness import Bench, Progress, RunResult
from nmt_core.errors import BenchError
from nmt_core.messages.blocks import BlockFlag, Quantity
from nmt_core.vocabulary import LoopState, ResultCode, TestKind
from nmt_extract.offline import extract_bag
from nmt_record.bag.bag_reader import Bag
from nmt_record.windows.segments import read_signals, segments

RANDOM = {"test": "random", "levels": [0.05], "band_hz": (10.0, 500.0), "duration": 3.0, "seed": 5}
SWEEP = {
    "test": "sweep",
    "levels": [0.05],
    "frequencies_hz": [22.0],
    "frequency_end_hz": 22.5,
    "rate_hz_s": 0.5,
    "ramp": 0.2,
}


def run(out: Path, **options: object) -> RunResult:
    with Bench("beam", out=out, **options) as bench:  # type: ignore[arg-type]
        return bench.run()


@pytest.fixture(scope="module")
def random_run(tmp_path_factory: pytest.TempPathFactory) -> RunResult:
    return run(tmp_path_factory.mktemp("random") / "out", **RANDOM)


def test_random_needs_no_linear_description_and_fills_its_band(random_run: RunResult) -> None:
    assert random_run.code == ResultCode.SUCCEEDED
    assert random_run.points == ()
    bag = Bag.open(random_run.bag or Path())
    assert bag.run_start is not None
    assert bag.run_start["linear"] is None
    assert bag.run_start["parameters"]["pll"]["linear_json"] == ""
    plan = bag.run_start["plan"]
    assert (plan["test"], plan["band_low_hz"], plan["band_high_hz"], plan["duration"]) == ("random", 10.0, 500.0, 3.0)
    (segment,) = segments(bag)
    assert (segment.kind, segment.level, segment.level_unit) == (TestKind.RANDOM, 0.05, "V")
    assert (segment.samples, segment.periods, segment.fault) == (30_000, 0, "")
    signals = read_signals(bag, segment.first_sample, segment.samples)
    assert signals.oscillator is None
    assert signals.gaps == ()
    voltage = signals.channels["u"]
    # 3 s of a band of 490 Hz hold about 2 * 490 * 3 independent values: 2 % of scatter of the rms.
    assert voltage.std() == pytest.approx(0.05, rel=0.06)
    power = np.abs(np.fft.rfft(voltage * np.hanning(voltage.size))) ** 2
    frequency = np.fft.rfftfreq(voltage.size, 1e-4)
    inside = (frequency > 8.0) & (frequency < 700.0)
    assert power[inside].sum() > 0.95 * power.sum()  # slopes of 24 dB an octave leave 1.3 % above 700 Hz
    levels = [message.test for _, _, message in bag.messages(["level"])]
    assert levels == [TestKind.RANDOM, TestKind.RANDOM]  # the level, and the end of the excitation


def test_random_is_no_data_for_modal_points(random_run: RunResult) -> None:
    with pytest.raises(BenchError, match="Windows of a random test give no modal points"):
        extract_bag(random_run.bag or Path())


def test_peaks_of_random_trip_the_limits(tmp_path: Path) -> None:
    result = run(tmp_path / "out", **{**RANDOM, "overrides": ["limits.force_n=0.1"]})
    assert result.code == ResultCode.LIMIT
    bag = Bag.open(tmp_path / "out" / "bag")
    force = np.concatenate([block.data[0] for block in bag.blocks("force")])
    flagged = [block.first_sample for block in bag.blocks("force") if block.flags & BlockFlag.LIMIT]
    first_peak = int(np.argmax(np.abs(force) > 0.1))
    assert flagged[0] - 400 < first_peak < flagged[0] + 200
    assert np.std(force[:first_peak]) < 0.05  # a peak, not the rms
    assert not list(bag.blocks("voltage"))[-1].data.any()
    assert all("given up" in segment.fault for segment in segments(bag))


@pytest.mark.campaign
def test_a_killed_loop_in_a_random_test_leaves_the_drive_at_zero(tmp_path: Path) -> None:
    options = {**RANDOM, "duration": 60.0, "node_values": {"pll": {"settling_time": 0.1}}, "ramp": 0.1}
    with Bench("beam", out=tmp_path / "out", processes=True, **options) as bench:
        assert bench.processes is not None
        pid = bench.processes.pids["pll"]
        killed: list[int] = []

        def kill_when_locked(progress: Progress) -> None:
            if progress.state == LoopState.LOCKED and not killed:
                killed.append(progress.sample)
                os.kill(pid, signal.SIGKILL)

        result = bench.run(kill_when_locked)
    assert killed
    assert result.code == ResultCode.NODE_LOST
    assert result.lost_node == "pll"
    bag = Bag.open(tmp_path / "out" / "bag")
    blocks = list(bag.blocks("voltage"))
    assert any(block.data.any() for block in blocks)
    assert not blocks[-1].data.any()
    assert blocks[-1].flags & BlockFlag.WATCHDOG
    (segment,) = segments(bag)
    assert "was never completed" in segment.fault


def test_a_ring_down_is_recorded_from_its_switch_off_on(tmp_path: Path) -> None:
    result = run(tmp_path / "out", test="ring_down", levels=[0.1, 0.5], duration=0.5)
    assert result.code == ResultCode.SUCCEEDED
    assert result.points == ()
    bag = Bag.open(tmp_path / "out" / "bag")
    found = segments(bag)
    assert [(item.kind, item.level, item.samples, item.fault) for item in found] == [
        (TestKind.RING_DOWN, 0.1, 5000, ""),
        (TestKind.RING_DOWN, 0.5, 5000, ""),
    ]
    for segment in found:
        signals = read_signals(bag, segment.first_sample, segment.samples)
        period = round(10_000 / segment.frequency_hz)
        voltage = signals.channels["u"]
        assert np.abs(voltage[:period]).max() > 0.5 * segment.level
        assert not voltage[period + 1 :].any()
        assert signals.oscillator is not None
        frequency = np.diff(signals.oscillator) * signals.sample_rate
        assert frequency == pytest.approx(segment.frequency_hz, rel=1e-3)
        motion = signals.channels[signals.named(Quantity.DISPLACEMENT, 2)[0]]
        assert np.abs(motion[-period:]).max() < 0.3 * np.abs(motion[:period]).max()


def test_a_stepped_sine_visits_every_frequency(tmp_path: Path) -> None:
    options = {"test": "stepped_sine", "levels": [0.05], "frequencies_hz": [21.0, 21.5], "window_periods": 5}
    result = run(tmp_path / "out", **options)
    assert result.code == ResultCode.SUCCEEDED
    found = segments(Bag.open(tmp_path / "out" / "bag"))
    assert [(item.kind, item.level, item.periods) for item in found] == [(TestKind.STEPPED_SINE, 0.05, 5)] * 2
    assert [item.frequency_hz for item in found] == pytest.approx([21.0, 21.5])


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({**RANDOM, "band_hz": (10.0, 6000.0)}, "half the sample rate, 5000 Hz"),
        ({**RANDOM, "band_hz": None}, "random band of 0 to 0 Hz"),
        ({**RANDOM, "duration": 0.0}, "needs a duration"),
        ({**RANDOM, "levels": None}, "random test needs levels"),
        ({**RANDOM, "levels": [20.0]}, r"reach 4 times as much, beyond the limit of the rig"),
        ({**RANDOM, "control": "force"}, "levels of voltage"),
        ({**SWEEP, "frequencies_hz": []}, "needs a frequency"),
        ({**SWEEP, "rate_hz_s": 0.0}, "rate other than 0"),
        ({**SWEEP, "rate_hz_s": -1.0}, "mind its sign"),
        ({"test": "ring_down", "strategy": "ramp", "duration": 1.0}, "A ring down test has no strategy"),
        ({"test": "ring_down", "duration": 1.0, "node_values": {"pll": {"loop": "paper"}}}, "does not switch off"),
        ({"test": "wobble"}, "'wobble' is not known; use phase_resonance"),
    ],
)
def test_wrong_plans_are_refused_before_anything_starts(
    options: dict[str, object], sentence: str, tmp_path: Path
) -> None:
    with pytest.raises(BenchError, match=sentence):
        Bench("beam", out=tmp_path / "out", **options)  # type: ignore[arg-type]
    assert not (tmp_path / "out").exists()


def test_a_level_that_the_loop_refuses_is_not_waited_for(tmp_path: Path) -> None:
    """Whoever sets nodes up by hand may forget the linear description: the run ends and says so."""
    with Bench("beam", [0.2], out=tmp_path / "out", node_values={"pll": {"linear_json": ""}}) as bench:
        result = bench.run()
    assert result.code == ResultCode.SUCCEEDED
    assert result.message == "0 of 1 levels locked."
    assert "needs a linear description" in result.points[0].reason
