"""An output in a process of its own: what is known of it, and that it goes to zero when the feeding process fails."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from nmt_core.arrays import FloatArray
from nmt_core.blocks import BlockFlag, Quantity, SampleBlock
from nmt_core.errors import BenchError
from nmt_core.records import DriveCommand
from nmt_core.vocabulary import OutputState, StopCause, Waveform
from nmt_plant.converter import read_log
from nmt_plant.device import DeviceFault
from nmt_plant.loopback_device import LoopbackDevice
from nmt_plant.output_faults import FAULTS, measure
from nmt_plant.output_link import OutputLink
from nmt_plant.output_owner import OwnerSettings
from nmt_plant.simulated_rig import SimulatedRig
from nmt_rig.rig import load_rig

RATE, BLOCK = 10_000.0, 200
# On a busy machine the feeding side may be late by half a second without a fault.
LEAD = 32
PATIENT = {"deadline_blocks": 100.0, "lead_blocks": LEAD}
SINE = DriveCommand(Waveform.SINE, 50.0, 1.0)


def settings(**changes: float) -> OwnerSettings:
    return OwnerSettings(**{"sample_rate": RATE, "block_samples": BLOCK, "deadline": 2.0, **changes})  # type: ignore[arg-type]


def alive(process: int | None) -> bool:
    return process is not None and Path(f"/proc/{process}").exists()


def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < end, "it does not come about"
        time.sleep(0.005)


def voltage(blocks: list[SampleBlock]) -> FloatArray:
    return next(block for block in blocks if block.quantity == Quantity.VOLTAGE).data[0]


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
    np.testing.assert_array_equal(link.collect(10 * BLOCK, 20.0).put_out[0], fed)
    assert link.close() is OutputState.ENDED
    assert not alive(process)
    values = np.concatenate([values[0] for _, values in read_log(log)])
    first = int(np.flatnonzero(values)[0])
    np.testing.assert_array_equal(values[first : first + fed.size], fed)
    assert values[-1] == 0.0


def test_quiet_latches_until_reset(link: OutputLink) -> None:
    for _ in range(40):
        link.feed(np.ones(BLOCK))
    until(lambda: link.state is OutputState.FOLLOWING)
    link.quiet("operator", 0.01)
    until(lambda: link.state is OutputState.HELD)
    assert link.is_tripped
    assert link.sentence == "the output is held at zero: operator."
    link.reset()
    until(lambda: not link.is_tripped)
    assert link.reason == ""


def test_after_the_death_of_the_owner_the_state_is_unknown(link: OutputLink) -> None:
    link.feed(np.ones(BLOCK))
    assert link.pid is not None
    os.kill(link.pid, signal.SIGKILL)
    until(lambda: link.state is OutputState.NOT_KNOWN)
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
    until(lambda: link.state is OutputState.NOT_KNOWN)
    assert link.close(timeout=0.2) is OutputState.NOT_KNOWN
    assert not alive(process)


def test_a_stopped_owner_is_killed_before_anything_is_waited_for(link: OutputLink, monkeypatch) -> None:
    """What it put out last may be repeated by the sound server for as long as it lives."""
    assert link.pid is not None
    os.kill(link.pid, signal.SIGSTOP)
    until(lambda: link.state is OutputState.NOT_KNOWN)
    process, done = link._process, []
    kill, listen = process.kill, link._listen
    monkeypatch.setattr(process, "kill", lambda: (done.append("kill"), kill()))
    monkeypatch.setattr(link, "_listen", lambda timeout: (done.append("wait") if timeout else None, listen(timeout))[1])
    link.close()
    assert done[:1] == ["kill"]


def test_an_owner_that_is_told_to_end_goes_to_zero_first(tmp_path: Path) -> None:
    log = tmp_path / "output"
    link = OutputLink(settings(lead_blocks=2), arguments={"sample_rate": RATE, "log": str(log)})
    link.start()
    for _ in range(40):
        link.feed(np.ones(BLOCK))
    until(lambda: link.state is OutputState.FOLLOWING)
    assert link.pid is not None
    os.kill(link.pid, signal.SIGTERM)
    until(lambda: link.state is OutputState.ENDED)
    assert "told to end" in link.sentence
    link.close()
    values = np.concatenate([values[0] for _, values in read_log(log)])
    assert values[-1] == 0.0
    assert np.abs(np.diff(values[values.argmax() :])).max() < 0.01, "a ramp"


def test_an_external_stop_file_is_seen(tmp_path: Path) -> None:
    stop = tmp_path / "stop"
    with OutputLink(settings(lead_blocks=1), arguments={"sample_rate": RATE, "stop_file": str(stop)}) as link:
        assert not link.is_tripped
        stop.touch()
        until(lambda: link.state is OutputState.HELD)
        assert link.reason == "the external stop input"


def test_a_converter_that_does_not_open_is_a_fault_with_its_sentence() -> None:
    with pytest.raises(DeviceFault, match="there is no converter nowhere:Converter"):
        OutputLink(settings(), converter="nowhere:Converter").start()


@pytest.mark.parametrize("fault", FAULTS)
def test_the_output_goes_to_zero_by_itself(fault: str) -> None:
    """The order of magnitude only; `python -m nmt_plant.output_faults` measures."""
    outcome = measure(fault, lead_blocks=25, deadline_blocks=25.0, seconds=2.0)
    assert outcome.amplitude == pytest.approx(1.0, abs=0.01)
    assert 0.0 < outcome.seconds < 1.9
    assert outcome.largest_step < 1.3 * 2 * np.pi * 50.0 / RATE, "a ramp, not a step"
    assert outcome.left == ()


def test_an_owned_rig_measures_what_was_put_out_a_lead_later() -> None:
    rig = load_rig("beam")
    plain, owned = SimulatedRig(rig), SimulatedRig(rig, owned=True, **PATIENT)
    command = DriveCommand(Waveform.SINE, 22.0, 0.5, 0.1, harmonics=((3, 0.05j),))
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


def test_an_owned_device_says_when_its_output_was_stopped(tmp_path: Path) -> None:
    stop = tmp_path / "stop"
    device = LoopbackDevice(watchdog_blocks=0, owned=True, arguments={"stop_file": str(stop)}, **PATIENT)
    device.configure()
    device.start()
    try:
        device.write(SINE)
        until(lambda: bool(voltage(device.read()).any()))
        assert not device.is_quiet
        stop.touch()
        until(lambda: bool(device.read()) and device.is_quiet)
        assert device.tripped == "output: the external stop input"
        assert device.stop_cause is StopCause.EXTERNAL_INPUT
        assert device.read()[0].flags & BlockFlag.STOP
        with pytest.raises(BenchError, match="the external stop input still asks for zero"):
            device.reset()
        stop.unlink()
        until(lambda: bool(device.read()) and not device._link.stop_is_set)  # type: ignore[union-attr]
        device.reset()
        assert device.tripped == ""
        device.write(SINE)
        until(lambda: bool(voltage(device.read()).any()))
    finally:
        device.close()


def test_quiet_of_an_owned_device_does_not_wait_for_the_lead() -> None:
    device = LoopbackDevice(watchdog_blocks=0, owned=True, **PATIENT)
    device.configure()
    device.start()
    try:
        device.write(SINE)
        until(lambda: bool(voltage(device.read()).any()))
        device.quiet("operator", 0.01)
        until(lambda: device.is_quiet or not device.read())
        sample = device.next_sample
        assert device.tripped == "operator"
        device.read()
        assert not voltage(device.read()).any()
        assert sample < 2 * LEAD * BLOCK, "earlier than the blocks that waited at the output"
    finally:
        device.close()


def test_the_death_of_the_owner_is_a_fault_of_the_device() -> None:
    device = LoopbackDevice(owned=True, **PATIENT)
    device.configure()
    device.start()
    try:
        device.read()
        assert device.output_pid is not None
        os.kill(device.output_pid, signal.SIGKILL)
        with pytest.raises(DeviceFault, match="UNKNOWN"):
            until(lambda: not device.read())
        assert "UNKNOWN" in device.output_sentence
    finally:
        device.close()


def test_is_ready_says_whether_a_read_would_wait() -> None:
    device = LoopbackDevice(owned=True, **PATIENT)
    device.configure()
    device.start()
    try:
        assert device.is_ready, "the first read sets the clock going"
        device.read()
        for _ in range(LEAD + 2):
            until(lambda: device.is_ready)
            assert device._link is not None
            assert device._link.available >= BLOCK
            device.read()
        assert device.next_sample == (LEAD + 3) * BLOCK
    finally:
        device.close()
    assert LoopbackDevice().is_ready


def test_an_owned_device_starts_again_at_zero() -> None:
    device = LoopbackDevice(owned=True, **PATIENT)
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


def test_a_full_duplex_converter_measures_what_acts_at_the_same_time() -> None:
    """Whatever the converter's delay is, block by block the input is the output of the same samples."""
    device = LoopbackDevice(watchdog_blocks=0, owned=True, newton_per_volt=2.0, arguments={"delay": 130}, **PATIENT)
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


def test_a_loss_of_the_converter_is_a_gap_of_one_block() -> None:
    device = LoopbackDevice(watchdog_blocks=0, owned=True, arguments={"lost_at": 750}, **PATIENT)
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


def test_a_lead_that_is_shorter_than_the_delay_of_the_converter_is_refused() -> None:
    device = LoopbackDevice(owned=True, lead_blocks=3, arguments={"delay": 450})
    device.configure()
    with pytest.raises(DeviceFault, match="450 samples after what is put out, so at least 4 blocks"):
        device.start()
    device.close()


def test_the_rig_measures_the_ramp_of_an_output_that_was_not_fed() -> None:
    """The structure moves with what was put out, not with what was commanded."""
    rig = load_rig("beam")
    device = SimulatedRig(rig, owned=True, lead_blocks=25)
    device.configure()
    device.start()
    try:
        device.write(DriveCommand(Waveform.SINE, 22.0, 0.5))
        drive = [voltage(device.read()) for _ in range(30)]
        assert drive[-1].any()
        link = device._link
        assert link is not None
        until(lambda: link.state is OutputState.HELD)
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
