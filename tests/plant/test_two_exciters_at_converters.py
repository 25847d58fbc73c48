"""Two exciters at both converters, on a clock of the test: see `converter_chain`."""

from __future__ import annotations

import numpy as np
import pytest
from plant.converter_chain import BLOCK, KINDS, OWNER, RATE, chain
from plant.test_converters import close, end_of_the_plant, hang, quiet, told_to_end
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.records import DriveCommand, DriveTerm
from nmt_core.vocabulary import OutputState, StopCause, Waveform
from nmt_plant.devices.device import DeviceFault
from nmt_plant.devices.hardware_rig import HardwareRig, device_of
from nmt_plant.specimen import Specimen
from nmt_rig.rig import load_rig

RATIO = 0.6 * np.exp(1.1j)
SINE = DriveCommand(Waveform.SINE, 22.0, 0.5, terms=(DriveTerm(2, 1, RATIO), DriveTerm(2, 3, 0.2j)))
NOISE = DriveCommand(
    Waveform.RANDOM, amplitude=0.5, ramp=0.1, band_low_hz=20.0, band_high_hz=1000.0, terms=(DriveTerm(2, 1, 0.6 + 0j),)
)
RAMP = 0.1  # s, limits.ramp_s of the frame
GAIN = 5.0  # V at the exciter per V at the port
BASE = ("watchdog.blocks=0", "block_samples=200")

both = pytest.mark.parametrize("kind", KINDS)


def frame(kind, *changes, **options):
    return chain(kind, name="frame", changes=[*BASE, *changes], **options)


def drive(device, blocks, command=SINE):
    device.write(command)
    for _ in range(blocks):
        device.read()


def ports(made):
    """V at the exciters, (2, samples)."""
    return GAIN * np.array([port.values for port in made.ports])


def check_ramps(made, seconds=RAMP):
    """Both went to zero along one half-cosine of the same samples, without a step."""
    volts = ports(made)
    ends = [int(np.flatnonzero(row)[-1]) + 1 for row in volts]
    length = round(seconds * RATE)
    end = max(ends)
    for row in volts:
        assert not row[end:].any()
        start = row[end - length]
        weight = 0.5 + 0.5 * np.cos(np.pi * np.arange(length + 1) / length)
        np.testing.assert_allclose(row[end - length : end + 1], start * weight, atol=2e-4)
    assert np.abs(volts[:, end - length]).max() > 0.01, "and there was something to take to zero"


@both
def test_each_output_has_its_own_samples_and_both_come_back_under_their_index(kind):
    with frame(kind, delay=37, noise=0.0) as made:
        device = made.start()
        device.write(NOISE)
        names = [entry.channel for entry in device.section.inputs]
        monitors = [names.index("u"), names.index("u2")]
        scale = np.array([[device.section.inputs[row].sensitivity_v] for row in monitors])
        seen = []
        for n in range(60):
            blocks = device.read()
            assert blocks[0].first_sample == n * BLOCK
            seen.append(device.measured[monitors] / scale)
            measured = next(block for block in blocks if block.quantity is Quantity.VOLTAGE)
            np.testing.assert_array_equal(measured.data, seen[-1])
            np.testing.assert_allclose(measured.data, device.outputs, atol=1e-4)
        line = np.concatenate(seen, axis=1)
        assert line[1].std() == pytest.approx(0.6 * line[0].std(), rel=0.1)
        volts = ports(made)
        first = volts.shape[1] - np.argmax(np.correlate(volts[0, -20_000:], line[0, 2000:10_000], "valid")[::-1])
        first -= 10_000
        np.testing.assert_allclose(volts[:, first : first + line.shape[1]], line, atol=2e-4)


@both
def test_what_is_measured_at_the_converter_is_what_the_rig_answers_in_lockstep(kind):
    """Forces and responses of both exciters, beside the specimen without converter and process."""
    rig = load_rig("frame", list(BASE))
    section = device_of(rig, kind, "server")
    beside = HardwareRig(rig, section, specimen=Specimen(rig, section, bits=32, noise=0.0))
    beside.configure()
    beside.start()
    with frame(kind, noise=0.0, bits=32) as made:
        device = made.start()
        records = []
        for each in (device, beside):
            each.write(SINE)
            got = [np.concatenate([block.data for block in each.read()]) for _ in range(60)]
            records.append(np.concatenate(got, axis=1))
        lead = 8 * BLOCK
        at_converter, in_lockstep = records[0][:, lead + 4000 :], records[1][:, 4000 : records[1].shape[1] - lead]
        largest = np.abs(in_lockstep).max(axis=1, keepdims=True)
        assert (largest > 0.0).all()
        # The specimen answers a sample later, which the chain knows; the probe has left the frame moving a little.
        np.testing.assert_allclose(at_converter[:, :-1] / largest, in_lockstep[:, 1:] / largest, atol=0.01)


@both
@pytest.mark.parametrize("fault", [hang, end_of_the_plant, told_to_end, quiet, close])
def test_both_ports_go_to_zero_along_one_ramp_whatever_ends(kind, fault):
    with frame(kind) as made:
        drive(made.start(), 50)
        fault(made)
        made.clock.sleep(0.2)
        assert made.owner.state is OutputState.HELD
        check_ramps(made)


@both
def test_an_owner_that_is_killed_leaves_both_ports_at_zero(kind):
    with frame(kind) as made:
        device = made.start()
        drive(device, 50)
        made.clock.kill(OWNER)
        with pytest.raises(DeviceFault, match="UNKNOWN"):
            drive(device, 50)
        made.clock.sleep(0.2)
        assert device.output_state is OutputState.NOT_KNOWN
        volts = ports(made)
        assert (np.abs(volts).max(axis=1) > 0.2).all()
        assert not volts[:, -int(0.1 * RATE) :].any()


@both
@pytest.mark.parametrize(("row", "ratio"), [(0, 0.5), (1, 40.0)])
def test_a_measured_limit_at_either_exciter_takes_both_to_zero(kind, row, ratio):
    channel = f"f{row + 1}"
    limit = f"limits.channels=[{{channel: {channel}, abort_peak: 0.3}}]"
    with frame(kind, limit, "limits.rise_from_v=50") as made:
        device = made.start()
        amplitude = 2.0 if row == 0 else 0.05
        drive(device, 100, DriveCommand(Waveform.SINE, 60.0, amplitude, 0.2, terms=(DriveTerm(2, 1, ratio + 0j),)))
        assert device.stop_cause is StopCause.LIMIT
        assert channel in device.tripped
        check_ramps(made)


@both
@pytest.mark.parametrize("row", with_quick([0, 1], 1))
@pytest.mark.parametrize("bad", [np.nan, 60.0])
def test_a_sample_beyond_the_limit_at_either_output_takes_both_to_zero_from_there(kind, row, bad):
    """What is fed is not what a guard has seen: the process that owns the outputs looks once more."""
    with frame(kind) as made:
        device = made.start()
        drive(device, 50)
        link = device.link
        real = link.feed

        def feed(values):
            wrong = values.copy()
            wrong[row, 77] = bad
            link.feed = real
            real(wrong)

        link.feed = feed
        for _ in range(60):
            device.read()
        assert "is beyond the limit of 50" in device.tripped
        assert device.output_state is OutputState.HELD
        check_ramps(made)


@pytest.mark.parametrize("row", [0, 1])
def test_the_device_stops_both_at_the_sample_that_is_beyond(row):
    """The guard of the device, before anything is handed to the process."""
    with frame("portaudio") as made:
        device = made.start()
        drive(device, 50)
        oscillator = device.oscillator
        real = oscillator.block

        def block(samples):
            made_now = real(samples)
            made_now.voltages[row, 33] = 51.0
            oscillator.block = real
            return made_now

        oscillator.block = block
        for _ in range(60):
            device.read()
        assert "would have reached 51 V" in device.tripped
        check_ramps(made)


@both
def test_a_drive_of_the_second_exciter_alone_is_a_drive(kind):
    """The state of the outputs is that of all: the first at zero says nothing."""
    with frame(kind) as made:
        device = made.start()
        drive(device, 30, DriveCommand(Waveform.SINE, 22.0, 0.001, terms=(DriveTerm(2, 1, 1000.0 + 0j),)))
        assert device.output_state is OutputState.FOLLOWING
        assert not device.is_quiet
        device.quiet("the operator")
        device.read()
        assert not device.is_quiet
        while not device.is_quiet:
            device.read()
        assert not ports(made)[:, -1].any()


def test_a_rig_has_one_output_for_each_exciter():
    rig = load_rig("frame")
    section = device_of(rig, "portaudio")
    assert [entry.channel for entry in section.outputs] == ["u", "u2"]
    assert [entry.port for entry in device_of(rig, "nidaqmx").outputs] == ["nmt_specimen/ao0", "nmt_specimen/ao1"]
    with pytest.raises(BenchError, match="1 outputs for 2 exciters; give one for each"):
        HardwareRig(rig, section.model_copy(update={"outputs": section.outputs[:1]}))
    with pytest.raises(BenchError, match="3 outputs for 2 exciters; give one for each"):
        HardwareRig(rig, section.model_copy(update={"outputs": [*section.outputs, section.outputs[0]]}))
