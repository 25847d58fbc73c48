"""Both converters keep the device contract: PortAudio over JACK's dummy driver, NI over its own client library.

On the other side stands the simulated specimen, in a process of its own.
"""

from __future__ import annotations

import ctypes.util
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import yaml
from busy_computer import on_a_quiet_computer

from nmt_core.blocks import BlockFlag, Quantity
from nmt_core.errors import BenchError
from nmt_core.records import DriveCommand
from nmt_core.vocabulary import OutputState, StopCause, Waveform
from nmt_plant.device import DeviceFault, DeviceState, DeviceStateError
from nmt_plant.hardware_rig import HardwareRig, device_of
from nmt_plant.nidaqmx_converter import find_channels
from nmt_plant.portaudio_converter import MissedTurns, find_device, list_devices
from nmt_rig.device_sections import StopInputSection
from nmt_rig.rig import load_rig

BUFFER = 10
LEAD = 25  # a busy machine may be late by half a second
CHANGES = ["watchdog.blocks=40", "watchdog.ramp_s=0.04", "limits.ramp_s=0.04"]
SINE = DriveCommand(Waveform.SINE, 22.0, 0.5)
NEEDED = {
    "portaudio": shutil.which("jackd") is None or ctypes.util.find_library("portaudio") is None,
    "nidaqmx": False,
}


@contextmanager
def specimen(kind: str, *options: str, rig: str = "beam") -> Iterator[str]:
    """A specimen in a process of its own; gives the address of NI's server."""
    module = {"portaudio": "nmt_plant.jack_specimen", "nidaqmx": "nmt_plant.ni_specimen"}[kind]
    words = [rig, *(word for change in CHANGES for word in ("--set", change)), "--address", "127.0.0.1:0", *options]
    with subprocess.Popen(
        [sys.executable, "-m", module, *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(part for part in sys.path if part)},
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith("ready"), line
        try:
            yield line.partition(" at ")[2].partition(",")[0]
        finally:
            process.stdin.close()
            process.wait(30)


def own_jack(folder: Path) -> dict[str, str]:
    """A server of its own name, which only the specimen starts."""
    return {"JACK_DEFAULT_SERVER": f"nmt-test-{os.getpid()}-{folder.name}", "JACK_NO_START_SERVER": "1"}


@contextmanager
def converter(kind: str, folder: Path) -> Iterator[HardwareRig]:
    """A converter with the beam behind its ports; at the end its output must be at zero."""
    record = folder / "port"
    with specimen(kind, "--record", str(record), "--delay", "37") as address:
        rig = load_rig("beam", CHANGES)
        section = device_of(rig, kind, address)
        if kind == "nidaqmx":
            section = section.model_copy(update={"buffer_blocks": BUFFER})
        device = HardwareRig(rig, section, lead_blocks=LEAD)
        try:
            yield device
        finally:
            device.close()
    port = np.load(record)["values"]
    assert np.abs(port).max() > 0.05
    assert not port[-2000:].any(), "the output was left at zero"


def voltage(blocks):
    return next(block for block in blocks if block.quantity == Quantity.VOLTAGE).data[0]


def read(device, count=1):
    """The next blocks that are whole."""
    found = []
    while len(found) < count:
        blocks = device.read()
        if blocks:
            found.append(blocks)
    return found


@pytest.mark.parametrize("kind", ["portaudio", "nidaqmx"])
@on_a_quiet_computer(own_jack)
def test_the_device_contract_holds_in_real_time(kind, tmp_path):
    if NEEDED[kind]:
        pytest.skip("JACK or PortAudio is not installed: sudo apt install jackd2 libportaudio2")
    with converter(kind, tmp_path) as device:
        keep_the_contract(device)


def keep_the_contract(device):
    block = device.block_samples
    for call in (device.start, device.read, device.stop, device.reset, lambda: device.write(SINE)):
        with pytest.raises(DeviceStateError):
            call()
    device.configure()
    with pytest.raises(DeviceStateError):
        device.configure()
    device.start()
    figures = device.figures
    assert abs(figures.delay - (38 + (BUFFER * block if device.section.kind == "nidaqmx" else 0))) <= 1
    assert figures.monitor_gain == pytest.approx(1.0, abs=0.01)
    assert device.output_state in (OutputState.AT_ZERO, OutputState.FOLLOWING)

    # Blocks follow each other; the drive is zero until it is commanded, and follows the oscillator's phase.
    firsts = []
    for _ in range(3):
        (blocks,) = read(device)
        firsts.append(blocks[0].first_sample)
        assert {each.quantity for each in blocks} == set(device.quantities)
        assert np.abs(voltage(blocks)).max() < 0.01
        assert len({each.oscillator for each in blocks}) == 1
        assert all(each.unit == each.quantity.unit for each in blocks)
    assert all(first % block == 0 for first in firsts)
    with pytest.raises(BenchError, match="amplitude must be finite"):
        device.write(DriveCommand(Waveform.SINE, 22.0, -0.5))
    with pytest.raises(BenchError, match="beyond the voltage limit"):
        device.write(DriveCommand(Waveform.SINE, 22.0, 1e4))
    at = device.next_sample + (LEAD + 2) * block
    device.write(DriveCommand(Waveform.SINE, 22.0, 0.5, apply_at_sample=at))
    while device.next_sample < at:
        blocks = device.read()
        assert not blocks or np.abs(voltage(blocks)).max() < 0.01
    device.write(SINE)
    (blocks,) = read(device)
    theta = blocks[0].oscillator.phase(block, device.sample_rate)
    np.testing.assert_allclose(voltage(blocks)[5:], 0.5 * np.cos(theta)[5:], atol=0.01)

    # The watchdog takes it to zero, latched until reset.
    got = [device.read() for _ in range(60 + LEAD)]
    last = next(blocks for blocks in reversed(got) if blocks)
    assert "watchdog" in device.tripped
    assert last[0].flags & BlockFlag.WATCHDOG
    assert np.abs(voltage(last)).max() < 0.01
    while not device.is_quiet:
        device.read()
    device.reset()
    device.write(SINE)
    got = [blocks for blocks in (device.read() for _ in range(LEAD + 3)) if blocks]
    assert np.abs(voltage(got[-1])).max() > 0.4

    # Quiet goes past the blocks that wait at the output.
    device.quiet("operator", 0.04)
    got = [blocks for blocks in (device.read() for _ in range(LEAD + 8)) if blocks]
    assert np.abs(voltage(got[-1])).max() < 0.01
    assert "operator" in device.tripped

    # A restart begins at sample zero, and finds the same delay.
    device.stop()
    device.configure()
    device.start()
    assert device.next_sample == 0
    assert device.figures.delay == figures.delay
    device.close()
    device.close()
    assert device.state is DeviceState.CLOSED


def test_what_is_missing_is_one_sentence(tmp_path, monkeypatch):
    devices = [{"name": "card", "host_api": "ALSA", "inputs": 2, "outputs": 2, "rate": 48_000.0}]
    with pytest.raises(BenchError, match=r"no 'rig' with 8 inputs and 1 outputs; it lists: card \(2 in, 2 out\)"):
        find_device(devices, "rig", "", 8, 1)
    assert find_device(devices, "car", "alsa", 2, 1) == 0
    with pytest.raises(BenchError, match=r"No NI gRPC device server answers at 127\.0\.0\.1:9"):
        find_channels("127.0.0.1:9", ["Dev1/ai0"])
    with pytest.raises(BenchError, match="NI-DAQmx is not installed here"):
        find_channels("", ["Dev1/ai0"])
    stub = tmp_path / "sounddevice.py"
    stub.write_text("raise OSError('PortAudio library not found')\n")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *(part for part in sys.path if part)]))
    with pytest.raises(BenchError, match="PortAudio is not installed"):
        list_devices()


def test_a_converter_that_does_not_open_is_named():
    rig = load_rig("beam")
    device = HardwareRig(rig, device_of(rig, "nidaqmx", "127.0.0.1:9"))
    device.configure()
    with pytest.raises(DeviceFault, match="No NI gRPC device server answers"):
        device.start()
    assert Path(f"/proc/{device.output_pid}").exists() is False


def test_looking_for_channels_leaves_no_grpc_in_the_process_that_asks():
    """Its threads would not survive the fork of the nodes, which then crash."""
    code = (
        "import sys\n"
        "from nmt_core.errors import BenchError\n"
        "from nmt_plant.nidaqmx_converter import find_channels\n"
        "try:\n"
        "    find_channels('127.0.0.1:9', ['Dev1/ai0'])\n"
        "except BenchError:\n"
        "    print([name for name in sys.modules if name.startswith(('grpc', 'nidaqmx'))])\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(part for part in sys.path if part)}
    asked = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert asked.stdout.strip() == "[]", asked.stderr


def test_turns_that_were_missed_are_found_by_their_time():
    """Calls jitter by up to half a period, the converter is 200 ppm slow; two turns are missed at one place."""
    random = np.random.default_rng(2)
    period, missed = 0.005, MissedTurns()
    found = []
    for turn in range(20_000):
        at = turn + (2 if turn >= 12_345 else 0)
        if missed.look(100.0 + 1.0002 * period * at + 0.5 * period * random.random(), period):
            found.append(turn)
    assert found == [12_345]


def test_the_stop_line_of_an_input_takes_the_drive_to_zero_and_holds_it(tmp_path):
    """The converter's process sees the line; nobody releases the drive while it asks for zero."""
    rig = load_rig("beam", CHANGES)
    section = device_of(rig, "nidaqmx").model_copy(
        update={"buffer_blocks": BUFFER, "stop_input": StopInputSection(port="nmt_specimen/ai20")}
    )
    content = rig.model_dump(mode="json", exclude_none=True)
    content["device"] = section.model_dump(mode="json", exclude_none=True)
    path, line, record = tmp_path / "rig.yaml", tmp_path / "line", tmp_path / "port"
    path.write_text(yaml.safe_dump(content))
    options = ("--stop-file", str(line), "--record", str(record))
    with specimen("nidaqmx", *options, rig=str(path)) as address:
        device = HardwareRig(rig, section.model_copy(update={"address": address}), lead_blocks=LEAD)
        device.configure()
        device.start()
        try:
            for _ in range(LEAD + 5):
                device.write(SINE)
                device.read()
            assert device.tripped == ""
            assert np.abs(device.put_out).max() > 0.4
            line.touch()
            for _ in range(10 * LEAD):
                device.read()
                if device.is_quiet:
                    break
            assert device.tripped == "output: the external stop input"
            assert device.stop_cause is StopCause.EXTERNAL_INPUT
            with pytest.raises(BenchError, match="still asks for zero"):
                device.reset()
            line.unlink()
            for _ in range(3 * BUFFER):
                device.read()
            device.reset()
            assert device.tripped == ""
        finally:
            device.close()
    assert np.abs(np.load(record)["values"]).max() > 0.04


@pytest.mark.parametrize(
    ("stop", "sentence"),
    [
        ({"port": "Dev1/ai0"}, "a physical channel of its own"),
        ({"port": "7"}, "a physical channel of its own"),
        ({"port": "Dev1/ai7", "threshold_v": 10}, "threshold_v must lie within the range"),
    ],
)
def test_a_stop_line_that_cannot_be_is_refused(stop, sentence, tmp_path):
    content = load_rig("beam").model_dump(mode="json", exclude_none=True)
    section = device_of(load_rig("beam"), "nidaqmx").model_dump(mode="json", exclude_none=True)
    for number, entry in enumerate(section["inputs"]):
        entry["port"] = f"Dev1/ai{number}"
    content["device"] = {**section, "stop_input": stop}
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(BenchError, match=sentence):
        load_rig(path)
