"""Both converters from the device to the specimen behind the ports, on a clock of the test: see `converter_chain`."""

from __future__ import annotations

import re
import socket

import numpy as np
import pytest
from plant.converter_chain import BLOCK, KINDS, OWNER, PERIOD, RATE, chain
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import BlockFlag, Quantity
from nmt_core.messages.records import DriveCommand
from nmt_core.vocabulary import OutputState, StopCause, Waveform
from nmt_plant.devices.device import DeviceFault, DeviceState, DeviceStateError
from nmt_plant.specimen_faults import Fault
from nmt_rig.device_sections import StopInputSection

SINE = DriveCommand(Waveform.SINE, 22.0, 0.5)
NOISE = DriveCommand(Waveform.RANDOM, amplitude=0.5, ramp=0.1, band_low_hz=20.0, band_high_hz=1000.0)
LEAD = 8
RAMP = 0.1  # s, limits.ramp_s of the beam
GAIN = 5.0  # V at the exciter per V at the port
BUFFER = {"portaudio": 0, "nidaqmx": 3 * BLOCK}
"""Samples that wait in the converter itself."""
TURN = {"portaudio": PERIOD, "nidaqmx": BLOCK}
"""Samples of a turn."""
STEP = 0.5 * 2 * np.pi * 22.0 / RATE / GAIN
"""V, largest change of `SINE` between two samples at the port."""

both = pytest.mark.parametrize("kind", KINDS)


def voltage(blocks):
    return next(block for block in blocks if block.quantity == Quantity.VOLTAGE).data[0]


def drive(device, blocks, command=SINE):
    device.write(command)
    for _ in range(blocks):
        device.read()


# -- start -----------------------------------------------------------------------------------------------------------


@both
@pytest.mark.parametrize("planted", [0, 899, 3000])
def test_a_start_finds_the_delay_to_the_sample(kind, planted):
    with chain(kind, delay=planted, lead_blocks=30) as made:
        figures = made.start().figures
        assert figures.delay == planted + 1 + BUFFER[kind]
        assert figures.monitor_gain == pytest.approx(1.0, abs=1e-3)
        assert figures.round_trip == figures.delay + TURN[kind]


@both
@pytest.mark.parametrize("tells", [True, False])
def test_a_delay_is_looked_for_again_where_turns_were_lost(kind, tells):
    with chain(kind, delay=37, tells=tells) as made:
        made.stop_owner([0.5, 1.4], 0.2)
        assert made.start().figures.delay == 38 + BUFFER[kind]
        assert made.clock.now() > 101.9, "once is 1.2 s"


@both
def test_a_converter_that_loses_samples_again_and_again_does_not_start(kind):
    with chain(kind) as made:
        made.stop_owner(np.arange(0.5, 20.0, 1.15), 0.2)
        sentence = {"portaudio": "it loses samples again and again, or its", "nidaqmx": "NI-DAQmx lost samples 6 times"}
        with pytest.raises(DeviceFault, match=sentence[kind]):
            made.start()


def test_a_monitor_that_shows_nothing_stops_the_start_unless_it_may():
    with chain("portaudio", faults=[Fault("short", "u")]) as made, pytest.raises(DeviceFault, match="is not seen at"):
        made.start()
    with chain("portaudio", faults=[Fault("short", "u")], output={"probe_needed": False}) as made:
        figures = made.start().figures
        assert figures.delay == PERIOD, "what the driver says"
        assert figures.monitor_gain == 0.0
    with chain("portaudio", faults=[Fault("sign", "u")]) as made:
        assert made.start().figures.monitor_gain == pytest.approx(-1.0, abs=1e-3)


@both
def test_a_lead_that_is_shorter_than_the_delay_is_refused(kind):
    with chain(kind, delay=1000, lead_blocks=5) as made:
        with pytest.raises(DeviceFault, match=f"{1001 + BUFFER[kind]} samples after what is put out, so at least"):
            made.start()
        assert made.device.output_pid is None


def test_a_rate_that_the_card_has_not_is_one_sentence():
    with chain("portaudio", changes=["sample_rate_hz=48000"]) as made:
        sentence = r"PortAudio does not open nmt_specimen at 48000 Hz \(its rate is 10000 Hz\)"
        with pytest.raises(DeviceFault, match=sentence):
            made.start()


def test_settings_that_ni_refuses_are_one_sentence():
    with chain("nidaqmx") as made:
        made.channel.refused["CfgSampClkTiming"] = (-200077, "Requested value is not a supported value.\nProperty: x")
        sentence = r"NI-DAQmx refuses 10000 Hz \(Requested value is not a supported value\); give a sample_rate_hz"
        with pytest.raises(DeviceFault, match=sentence):
            made.start()


def test_an_owner_that_does_not_come_up_is_given_up_after_a_minute_and_a_half():
    with chain("nidaqmx") as made:
        made.clock.stop(OWNER)
        with pytest.raises(DeviceFault, match="did not start: it does not answer"):
            made.start()
        assert 190.0 <= made.clock.now() < 193.0


# -- blocks ----------------------------------------------------------------------------------------------------------


@both
def test_what_comes_back_is_what_was_at_the_port(kind):
    """Sample by sample: made, put out, at the port, and measured under the same index."""
    with chain(kind, delay=37, noise=0.0) as made:
        device = made.start()
        device.write(NOISE)
        put_out, seen = [], []
        row = [entry.channel for entry in device.section.inputs].index("u")
        for n in range(60):
            blocks = device.read()
            assert blocks[0].first_sample == n * BLOCK
            put_out.append(device.put_out.copy())
            seen.append(device.measured[row] / device.section.inputs[row].sensitivity_v)
            np.testing.assert_array_equal(voltage(blocks), seen[-1])
        line = np.concatenate(put_out)
        assert np.abs(line).max() > 1.0
        np.testing.assert_allclose(np.concatenate(seen), line, atol=1e-4)
        port = made.port.values * GAIN
        first = port.size - np.argmax(np.correlate(port[-20_000:], line[2000:10_000], "valid")[::-1]) - 10_000
        np.testing.assert_allclose(port[first : first + line.size], line, atol=1e-5)


@both
def test_the_device_contract(kind):
    changes = ["watchdog.blocks=40", "watchdog.ramp_s=0.04", "limits.ramp_s=0.04"]
    with chain(kind, delay=37, changes=changes) as made:
        device = made.device
        for call in (device.start, device.read, device.stop, device.reset, lambda: device.write(SINE)):
            with pytest.raises(DeviceStateError):
                call()
        made.start()
        with pytest.raises(DeviceStateError):
            device.configure()
        delay = device.figures.delay
        assert device.output_state is OutputState.AT_ZERO

        # The drive is zero until it is commanded, and follows the oscillator's phase.
        blocks = device.read()
        assert {each.quantity for each in blocks} == set(device.quantities)
        assert len({each.oscillator for each in blocks}) == 1
        assert all(each.unit == each.quantity.unit for each in blocks)
        with pytest.raises(BenchError, match="amplitude must be finite"):
            device.write(DriveCommand(Waveform.SINE, 22.0, -0.5))
        with pytest.raises(BenchError, match="beyond the voltage limit"):
            device.write(DriveCommand(Waveform.SINE, 22.0, 1e4))
        at = device.next_sample + (LEAD + 2) * BLOCK
        device.write(DriveCommand(Waveform.SINE, 22.0, 0.5, apply_at_sample=at))
        while device.next_sample < at:
            assert np.abs(voltage(device.read())).max() < 0.001
        blocks = device.read()
        assert device.output_state is OutputState.FOLLOWING
        theta = blocks[0].oscillator.phase(BLOCK, RATE)
        np.testing.assert_allclose(voltage(blocks), 0.5 * np.cos(theta), atol=0.001)

        # The watchdog takes it to zero, latched until reset.
        for _ in range(40):
            blocks = device.read()
        assert "watchdog" in device.tripped
        assert blocks[0].flags & BlockFlag.WATCHDOG
        assert np.abs(voltage(blocks)).max() < 0.001
        assert device.is_quiet
        device.reset()
        drive(device, LEAD + 1)
        assert np.abs(voltage(device.read())).max() > 0.4

        # Quiet goes past the blocks that wait at the output.
        device.quiet("operator", 0.04)
        seen = [np.abs(voltage(device.read())).max() for _ in range(LEAD)]
        assert seen[-1] < 0.001
        assert device.tripped == "operator"

        # A restart begins at sample zero, and finds the same delay.
        device.stop()
        made.start()
        assert device.next_sample == 0
        assert device.figures.delay == delay
        device.close()
        device.close()
        assert device.state is DeviceState.CLOSED


@both
def test_how_late_a_block_is_read(kind):
    with chain(kind) as made:
        device = made.start()
        drive(device, 20)
        while not device.is_ready:
            made.clock.sleep(0.001)
        before = device.lateness
        assert before <= TURN[kind] / RATE + 0.003
        made.clock.sleep(0.013)
        assert device.lateness == pytest.approx(before + 0.013)
        made.clock.sleep(0.06)
        assert device.is_ready
        assert device.lateness == pytest.approx(before + 0.073), "although further blocks have come"


# -- clocks ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "ppm"), with_quick([("portaudio", 0.0), ("portaudio", 60.0), ("nidaqmx", -60.0)], ("portaudio", 60.0))
)
def test_a_clock_that_is_off_is_said_and_another_is_not(kind, ppm):
    with chain(kind, ppm=ppm) as made:
        if kind == "portaudio":  # calls come late by chance
            made.jack.late = iter(np.random.default_rng(1).exponential(5e-4, 100_000).clip(0.0, 0.004))
        device = made.start()
        for _ in range(26):
            drive(device, 50)
        assert device.figures.clock_ppm == pytest.approx(ppm, abs=10.0)
        assert device.figures.lost_turns == 0
        said = [each for each in device.warnings if "clock" in each]
        assert len(said) == (ppm != 0.0)
        assert all(("fast" if ppm > 0.0 else "slow") in each for each in said)


@pytest.mark.parametrize("ppm", [0.0, 60.0])
def test_output_and_input_that_share_no_clock_are_said(ppm):
    with chain("portaudio", clock_error=1e-6 * ppm) as made:
        device = made.start()
        for _ in range(8):
            drive(device, 50)
        wanted = 1e-6 * ppm * RATE * 7.5  # the first figure is half a second long
        assert abs(device.figures.drift) == pytest.approx(wanted, abs=0.1 * wanted + 0.01)
        said = [each for each in device.warnings if "do not share one clock" in each]
        assert len(said) == (abs(wanted) > 1.0)


# -- losses ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "tells", "seconds", "delay"),
    with_quick(
        [
            ("portaudio", True, 0.03, 37),
            ("portaudio", False, 0.03, 237),
            ("portaudio", True, 0.03, 737),
            ("nidaqmx", True, 0.2, 37),
        ],
        ("portaudio", True, 0.03, 37),
        ("nidaqmx", True, 0.2, 37),
    ),
)
def test_every_gap_is_marked_and_nothing_else(kind, tells, seconds, delay):
    """The owner is stopped now and then: a block that is given is, to the sample, what was put out."""
    with chain(kind, tells=tells, delay=delay, noise=0.0, lead_blocks=40) as made:
        device = made.start()
        made.stop_owner(1.5 * np.arange(1, 5) + np.array([0.0013, 0.0113, 0.0013, 0.0113]), seconds)
        row = [entry.channel for entry in device.section.inputs].index("u")
        device.write(NOISE)
        marked = []
        for n in range(370):
            if not device.read():
                marked.append(n)
                continue
            seen = device.measured[row] / device.section.inputs[row].sensitivity_v
            np.testing.assert_allclose(seen, device.put_out, atol=1e-4)
        gaps = np.split(marked, np.flatnonzero(np.diff(marked) > 10) + 1)
        assert len(gaps) == 4
        assert max(gap.size for gap in gaps) <= 3 + (delay + BUFFER[kind]) // BLOCK
        assert device.tripped == ""
        assert device.figures.lost_turns >= 4


def test_gaps_are_not_taken_for_a_delay_that_moves():
    with chain("portaudio", delay=237, lead_blocks=40) as made:
        device = made.start()
        made.stop_owner(np.arange(1.5, 7.0, 0.23), 0.011)
        for _ in range(6):
            drive(device, 50)
        assert device.figures.lost_turns > 10
        assert abs(device.figures.drift) < 0.1, "and the others give figures"
        assert not any("delay" in each for each in device.warnings)


def test_ni_starts_over_five_times_in_ten_seconds_and_no_more():
    for apart, ends in ((2.1, False), (1.5, True)):
        with chain("nidaqmx", lead_blocks=40) as made:
            device = made.start()
            made.stop_owner(apart * np.arange(1, 8), 0.2)
            if ends:
                with pytest.raises(DeviceFault, match="NI-DAQmx lost samples 6 times within 10 s"):
                    drive(device, 1000)
            else:
                drive(device, 850)
                assert device.tripped == ""


def test_an_error_of_ni_that_is_no_loss_ends_the_output():
    with chain("nidaqmx") as made:
        device = made.start()
        drive(device, 20)
        made.channel.refused["ReadAnalogF64"] = (-200220, "Device identifier is invalid.\nDevice: x")
        with pytest.raises(DeviceFault, match=r"UNKNOWN: .*NI-DAQmx: Device identifier is invalid\)"):
            drive(device, 20)
        assert device.output_state is OutputState.NOT_KNOWN
        made.clock.sleep(0.2)
        port = made.port.values
        assert port[np.flatnonzero(port)[-1] + 1 :].size > 0.1 * RATE, "zeros were written, or it idles at zero"


def test_a_sound_server_that_stands_still_is_said():
    with chain("portaudio") as made:
        device = made.start()
        drive(device, 20)
        made.jack.stands_still = True
        at = made.clock.now()
        with pytest.raises(DeviceFault, match="the state of the output is UNKNOWN"):
            drive(device, 20)
        assert made.clock.now() - at == pytest.approx(1.0 + 4.0 * LEAD * BLOCK / RATE, abs=0.05)
        made.clock.sleep(4.0)
        assert "PortAudio's stream stands still; the sound server has ended" in device.output_sentence


# -- faults: when is the port at zero? ---------------------------------------------------------------------------------


def hang(made):
    made.clock.sleep(1.5)


def end_of_the_plant(made):
    made.device.link._channel.shutdown(socket.SHUT_RDWR)
    made.clock.sleep(1.5)


def told_to_end(made):
    made.owner.terminate()
    made.clock.sleep(1.5)


def quiet(made):
    made.device.quiet("operator", RAMP)
    made.clock.sleep(1.5)


def close(made):
    made.device.close()


@both
@pytest.mark.parametrize(
    ("fault", "waits", "reason"),
    [
        (
            hang,
            LEAD * BLOCK / RATE,
            "(not fed for 180 ms|no block was there to be put out); the feeding process is hung",
        ),
        (end_of_the_plant, 0.0, "the process that fed the output has ended"),
        (told_to_end, 0.0, "the process that owns the output was told to end"),
        (quiet, 0.0, "operator"),
        (close, 0.0, "the output is closed"),
    ],
)
def test_the_port_goes_to_zero_along_the_ramp(kind, fault, waits, reason):
    """No later than is stated, no earlier than the ramp is long, and without a click."""
    with chain(kind) as made:
        device = made.start()
        drive(device, 30)
        owner, at = made.owner, made.clock.now()
        fault(made)
        made.clock.sleep(0.5)
        port = made.port
        index = port.index(at)
        assert np.abs(port.values[index - 500 : index]).max() == pytest.approx(0.5 / GAIN, rel=0.01)
        turn = 0.02  # s, of both converters at most
        seconds = port.time_to_zero(at)
        buffered = BUFFER[kind] / RATE
        assert waits + RAMP - 2 * turn <= seconds <= waits + RAMP + buffered + 2 * turn
        assert np.abs(np.diff(port.values[index - 1 :])).max() <= 1.2 * STEP
        assert re.match(reason, owner.reason)


@both
def test_an_owner_that_is_killed_leaves_the_state_unknown_and_the_port_at_zero(kind):
    with chain(kind) as made:
        device = made.start()
        drive(device, 30)
        at = made.clock.now()
        made.owners[-1].kill()
        with pytest.raises(DeviceFault, match="the state of the output is UNKNOWN"):
            drive(device, 30)
        assert made.clock.now() - at < 0.1
        made.clock.sleep(0.5)
        assert made.port.time_to_zero(at) <= BUFFER[kind] / RATE + 0.025


@both
def test_an_owner_that_is_stopped_is_ended_before_anything_is_waited_for(kind):
    """JACK repeats the last period of a client that is stopped, for as long as its process is there."""
    with chain(kind) as made:
        device = made.start()
        drive(device, 30)
        at = made.clock.now()
        made.clock.stop(OWNER)
        with pytest.raises(DeviceFault, match="the state of the output is UNKNOWN"):
            drive(device, 30)
        waited = made.clock.now() - at
        assert waited <= 1.0 + 4.0 * LEAD * BLOCK / RATE + 0.05
        assert device.output_state is OutputState.NOT_KNOWN
        device.close()
        assert made.clock.now() - at == pytest.approx(waited, abs=0.01)
        made.clock.sleep(0.5)
        assert made.port.time_to_zero(at) <= waited + 0.025
        if kind == "nidaqmx":
            assert made.port.time_to_zero(at) <= BUFFER[kind] / RATE + 0.025, "the hardware idles at zero"


@both
def test_silence_of_half_a_second_is_a_state_that_nobody_knows(kind):
    with chain(kind) as made:
        device = made.start()
        drive(device, 30)
        made.clock.stop(OWNER)
        made.clock.sleep(0.45)
        assert device.output_state is OutputState.FOLLOWING
        made.clock.sleep(0.1)
        assert device.output_state is OutputState.NOT_KNOWN


def test_the_stop_line_of_an_input_takes_the_drive_to_zero_and_holds_it():
    """Nobody releases the drive while the line asks for zero."""
    level = [10.0]
    section = {"stop_input": StopInputSection(port="nmt_specimen/ai20")}
    with chain("nidaqmx", section=section, stop_line=lambda: level[0]) as made:
        device = made.start()
        drive(device, 20)
        assert device.tripped == ""
        level[0], at = 0.0, made.clock.now()
        for _ in range(20):
            device.read()
        assert device.tripped == "output: the external stop input"
        assert device.stop_cause is StopCause.EXTERNAL_INPUT
        assert device.is_quiet
        assert made.port.time_to_zero(at) <= RAMP + (BUFFER["nidaqmx"] + 3 * BLOCK) / RATE
        with pytest.raises(BenchError, match="still asks for zero"):
            device.reset()
        level[0] = 10.0
        for _ in range(5):
            device.read()
        device.reset()
        drive(device, 20)
        assert device.tripped == ""
        assert np.abs(device.put_out).max() == pytest.approx(0.5, rel=0.01)
