"""What the feeding side knows of an output that another process owns; a few tests are on real processes."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plant.converter_chain import OwnerThread
from plant.turned_clock import TurnedClock

from nmt_benchmark.output_faults import measure
from nmt_core.errors import BenchError
from nmt_core.messages.blocks import BlockFlag, Quantity, SampleBlock
from nmt_core.messages.records import DriveCommand, DriveTerm
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import OutputState, StopCause, Waveform
from nmt_plant.converters.converter import SteadyClockConverter, read_log
from nmt_plant.devices.device import DeviceFault
from nmt_plant.devices.loopback_device import LoopbackDevice
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_plant.output_process.output_link import OutputLink
from nmt_plant.output_process.output_owner import OwnerSettings
from nmt_rig.rig import load_rig

RATE, BLOCK = 10_000.0, 200
LEAD = 5
SINE = DriveCommand(Waveform.SINE, 50.0, 1.0)


def settings(**changes: float) -> OwnerSettings:
    return OwnerSettings(**{"sample_rate": RATE, "block_samples": BLOCK, "deadline": 2.0, **changes})  # type: ignore[arg-type]


def alive(process: int | None) -> bool:
    return process is not None and Path(f"/proc/{process}").exists()


def come(condition: Callable[[], bool], sleep: Callable[[float], None] = time.sleep) -> None:
    """Wait for what another process does, however busy the computer is."""
    for _ in range(12_000):
        if condition():
            return
        sleep(0.005)
    pytest.fail("it does not come about")


def voltage(blocks: list[SampleBlock]) -> FloatArray:
    return next(block for block in blocks if block.quantity == Quantity.VOLTAGE).data[0]


# -- real processes --------------------------------------------------------------------------------------------------


@pytest.fixture
def link() -> Iterator[OutputLink]:
    with OutputLink(settings(lead_blocks=20)) as made:
        yield made


def test_what_is_fed_is_put_out_logged_and_given_back(tmp_path: Path) -> None:
    log = tmp_path / "output"
    fed = np.cos(2 * np.pi * 50.0 * np.arange(10 * BLOCK) / RATE)
    link = OutputLink(settings(lead_blocks=10), arguments={"sample_rate": RATE, "log": str(log)})
    link.start()
    process = link.pid
    assert link.state is OutputState.AT_ZERO
    for n in range(10):
        link.feed(fed[n * BLOCK : (n + 1) * BLOCK])
    np.testing.assert_array_equal(link.collect(10 * BLOCK, 60.0).put_out[0], fed)
    assert link.close(60.0) is OutputState.ENDED
    assert not alive(process)
    values = np.concatenate([values[0] for _, values in read_log(log)])
    first = int(np.flatnonzero(values)[0])
    np.testing.assert_array_equal(values[first : first + fed.size], fed)
    assert values[-1] == 0.0


def test_after_the_death_of_the_owner_the_state_is_unknown(link: OutputLink) -> None:
    link.feed(np.ones(BLOCK))
    assert link.pid is not None
    os.kill(link.pid, signal.SIGKILL)
    come(lambda: link.has_ended)
    assert "UNKNOWN: the process that owns it has died" in link.sentence
    with pytest.raises(DeviceFault, match="UNKNOWN"):
        link.collect(BLOCK)
    with pytest.raises(DeviceFault, match="cannot be fed: the state of the output is UNKNOWN"):
        link.feed(np.ones(BLOCK))
    assert link.close() is OutputState.NOT_KNOWN


def test_a_stopped_owner_is_unknown_and_does_not_stay_behind(link: OutputLink) -> None:
    process = link.pid
    assert process is not None
    os.kill(process, signal.SIGSTOP)
    come(lambda: link.state is OutputState.NOT_KNOWN)
    assert link.close() is OutputState.NOT_KNOWN
    assert not alive(process)


def test_an_owner_that_is_told_to_end_goes_to_zero_first(tmp_path: Path) -> None:
    log = tmp_path / "output"
    link = OutputLink(settings(lead_blocks=2), arguments={"sample_rate": RATE, "log": str(log)})
    link.start()
    for _ in range(40):
        link.feed(np.ones(BLOCK))
    come(lambda: link.last_report.put_out > 0)
    assert link.pid is not None
    os.kill(link.pid, signal.SIGTERM)
    come(lambda: link.state is OutputState.ENDED)
    assert "told to end" in link.sentence or "no block was there" in link.sentence
    link.close()
    values = np.concatenate([values[0] for _, values in read_log(log)])
    assert values[-1] == 0.0
    assert np.abs(np.diff(values[values.argmax() :])).max() < 0.01, "a ramp"


def test_a_converter_that_does_not_open_is_a_fault_with_its_sentence() -> None:
    with pytest.raises(DeviceFault, match="did not start: output owner: there is no converter nowhere:Converter"):
        OutputLink(settings(), converter="nowhere:Converter").start()


@pytest.mark.parametrize(
    "fault",
    [
        "SIGSTOP",
        pytest.param("SIGKILL", marks=pytest.mark.campaign),
        pytest.param("hung read", marks=pytest.mark.campaign),
        pytest.param("blocked interpreter", marks=pytest.mark.campaign),
    ],
)
def test_the_output_goes_to_zero_by_itself(fault: str) -> None:
    """By the samples put out, whose clock stands still with the computer; a feeder may be late by a second."""
    outcome = measure(fault, lead_blocks=50, deadline_blocks=50.0)
    assert outcome.amplitude == pytest.approx(1.0, abs=0.01)
    assert 0.09 < outcome.seconds < 1.3
    assert outcome.largest_step < 1.3 * 2 * np.pi * 50.0 / RATE, "a ramp, not a step"
    assert outcome.left == ()


# -- on a clock of the test ------------------------------------------------------------------------------------------


@pytest.fixture
def clock() -> Iterator[TurnedClock]:
    made = TurnedClock()
    yield made
    made.close()
    assert made.failures == []


@pytest.fixture
def patient(clock: TurnedClock) -> dict[str, Any]:
    """Options of a device whose owner takes part in the clock."""
    return {"clock": clock, "start": partial(OwnerThread, clock), "lead_blocks": LEAD, "deadline_blocks": 100.0}


def test_quiet_latches_until_reset(clock: TurnedClock) -> None:
    with OutputLink(settings(lead_blocks=20), clock=clock, start=partial(OwnerThread, clock)) as link:
        for _ in range(40):
            link.feed(np.ones(BLOCK))
        clock.sleep(0.05)
        assert link.state is OutputState.FOLLOWING
        link.quiet("operator", 0.01)
        assert not link.is_tripped
        clock.sleep(0.02)
        assert link.state is OutputState.HELD
        assert link.is_tripped
        assert link.sentence == "the output is held at zero: operator."
        assert link.reset()
        assert not link.is_tripped
        assert link.reason == ""


def test_a_reset_waits_for_a_second(clock: TurnedClock) -> None:
    with OutputLink(settings(lead_blocks=2), clock=clock, start=partial(OwnerThread, clock)) as link:
        for _ in range(40):
            link.feed(np.ones(BLOCK))
        clock.sleep(0.05)
        link.quiet("operator", 5.0)
        clock.sleep(0.05)
        at = clock.now()
        assert not link.reset()
        assert clock.now() - at == pytest.approx(1.0, abs=0.03)


def test_samples_are_put_out_when_they_are_due_and_a_late_host_stops_the_clock(clock: TurnedClock) -> None:
    """40 samples last 4 ms; after a standstill none comes earlier than its time after the one before, less 2 ms."""
    converter = SteadyClockConverter(RATE, clock=clock)
    begun = clock.now()
    for _ in range(100):
        converter.exchange(np.zeros((1, 40)))
    assert clock.now() - begun == pytest.approx(0.4)
    clock.sleep(0.1)
    for _ in range(100):
        converter.exchange(np.zeros((1, 40)))
    assert clock.now() - begun == pytest.approx(0.9 - 0.002)


def test_an_owned_rig_measures_what_was_put_out_a_lead_later(patient: dict[str, Any]) -> None:
    rig = load_rig("beam")
    plain, owned = SimulatedRig(rig), SimulatedRig(rig, owned=True, **patient)
    command = DriveCommand(Waveform.SINE, 22.0, 0.5, 0.1, terms=(DriveTerm(1, 3, 0.05j, False),))
    for device in (plain, owned):
        device.configure()
        device.start()
        device.write(command)
    try:
        expected = [plain.read() for _ in range(12)]
        found = [owned.read() for _ in range(12 + LEAD)]
        assert not any(block.data.any() for blocks in found[:LEAD] for block in blocks)
        for one, other in zip(expected, found[LEAD:], strict=True):
            for want, have in zip(one, other, strict=True):
                assert have.first_sample == want.first_sample + LEAD * BLOCK
                assert have.oscillator == want.oscillator
                np.testing.assert_allclose(have.data, want.data, rtol=1e-9, atol=1e-15)
        assert "follows what it is fed" in owned.output_sentence
    finally:
        owned.close()
    assert owned.output_pid is None


def test_an_owned_device_says_when_its_output_was_stopped(
    tmp_path: Path, patient: dict[str, Any], clock: TurnedClock
) -> None:
    stop = tmp_path / "stop"
    device = LoopbackDevice(watchdog_blocks=0, owned=True, arguments={"stop_file": str(stop)}, **patient)
    device.configure()
    device.start()
    try:
        device.write(SINE)
        come(lambda: bool(voltage(device.read()).any()), clock.sleep)
        assert not device.is_quiet
        stop.touch()
        come(lambda: bool(device.read()) and device.is_quiet, clock.sleep)
        assert device.tripped == "output: the external stop input"
        assert device.stop_cause is StopCause.EXTERNAL_INPUT
        assert device.read()[0].flags & BlockFlag.STOP
        with pytest.raises(BenchError, match="the external stop input still asks for zero"):
            device.reset()
        stop.unlink()
        come(lambda: bool(device.read()) and not device.link.stop_is_set, clock.sleep)  # type: ignore[union-attr]
        device.reset()
        assert device.tripped == ""
        device.write(SINE)
        come(lambda: bool(voltage(device.read()).any()), clock.sleep)
    finally:
        device.close()


def test_quiet_of_an_owned_device_does_not_wait_for_the_lead(patient: dict[str, Any], clock: TurnedClock) -> None:
    device = LoopbackDevice(watchdog_blocks=0, owned=True, **patient)
    device.configure()
    device.start()
    try:
        device.write(SINE)
        come(lambda: bool(voltage(device.read()).any()), clock.sleep)
        device.quiet("operator", 0.01)
        come(lambda: device.is_quiet or not device.read(), clock.sleep)
        sample = device.next_sample
        assert device.tripped == "operator"
        device.read()
        assert not voltage(device.read()).any()
        assert sample < 2 * LEAD * BLOCK, "earlier than the blocks that waited at the output"
    finally:
        device.close()


def test_is_ready_says_whether_a_read_would_wait(patient: dict[str, Any], clock: TurnedClock) -> None:
    device = LoopbackDevice(owned=True, **patient)
    device.configure()
    device.start()
    try:
        assert device.is_ready, "the first read sets the clock going"
        device.read()
        for _ in range(LEAD + 2):
            come(lambda: device.is_ready, clock.sleep)
            assert device.link is not None
            assert device.link.available >= BLOCK
            device.read()
        assert device.next_sample == (LEAD + 3) * BLOCK
    finally:
        device.close()
    assert LoopbackDevice().is_ready


def test_an_owned_device_starts_again_at_zero(patient: dict[str, Any]) -> None:
    device = LoopbackDevice(owned=True, **patient)
    for _ in range(2):
        device.configure()
        device.start()
        device.write(SINE)
        blocks = device.read()
        assert blocks[0].first_sample == 0
        assert not voltage(blocks).any()
        device.stop()
        assert device.output_pid is None
    device.close()


def test_a_full_duplex_converter_measures_what_acts_at_the_same_time(patient: dict[str, Any]) -> None:
    """Whatever the converter's delay is, block by block the input is the output of the same samples."""
    device = LoopbackDevice(watchdog_blocks=0, owned=True, newton_per_volt=2.0, arguments={"delay": 130}, **patient)
    device.configure()
    device.start()
    try:
        device.write(SINE)
        blocks = [device.read() for _ in range(LEAD + 6)]
        drive = np.concatenate([voltage(block) for block in blocks])
        force = np.concatenate([block[0].data[0] for block in blocks])
        assert drive.any()
        np.testing.assert_array_equal(force, 2.0 * drive)
    finally:
        device.close()


def test_a_loss_of_the_converter_is_a_gap_of_one_block(patient: dict[str, Any]) -> None:
    device = LoopbackDevice(watchdog_blocks=0, owned=True, arguments={"lost_at": 750}, **patient)
    device.configure()
    device.start()
    try:
        firsts = [[block.first_sample for block in device.read()] for _ in range(12)]
    finally:
        device.close()
    given = [first[0] for first in firsts if first]
    assert len(given) == 11, "one block is not given"
    assert sorted(set(range(0, 12 * BLOCK, BLOCK)) - set(given))[0] % BLOCK == 0
    assert [len(first) for first in firsts if first] == [3] * 11


def test_a_lead_that_is_shorter_than_the_delay_of_the_converter_is_refused(patient: dict[str, Any]) -> None:
    device = LoopbackDevice(owned=True, arguments={"delay": 450}, **patient | {"lead_blocks": 3})
    device.configure()
    with pytest.raises(DeviceFault, match="450 samples after what is put out, so at least 4 blocks"):
        device.start()
    device.close()


def test_the_rig_measures_the_ramp_of_an_output_that_was_not_fed(patient: dict[str, Any], clock: TurnedClock) -> None:
    """The structure moves with what was put out, not with what was commanded."""
    rig = load_rig("beam")
    device = SimulatedRig(rig, owned=True, **patient | {"lead_blocks": 25, "deadline_blocks": 25.0})
    device.configure()
    device.start()
    try:
        device.write(DriveCommand(Waveform.SINE, 22.0, 0.5))
        drive = [voltage(device.read()) for _ in range(30)]
        assert drive[-1].any()
        link = device.link
        assert link is not None
        come(lambda: link.state is OutputState.HELD, clock.sleep)
        while not device.is_quiet or not device.tripped:
            drive.append(voltage(device.read()))
        line = np.concatenate(drive)
        assert device.stop_cause is StopCause.OUTPUT
        assert "no block was there" in device.tripped or "not fed for" in device.tripped
        last = int(np.flatnonzero(line)[-1])
        length = round(rig.limits.ramp_s * RATE)
        ramp = line[last - length + 1 : last + 2]  # from the last sample that was fed to the first zero
        share = 0.5 * (1.0 + np.cos(np.pi * np.arange(length + 1) / length))
        np.testing.assert_allclose(ramp, ramp[0] * share, atol=1e-9)
        assert abs(ramp[0]) > 0.0
    finally:
        device.close()
