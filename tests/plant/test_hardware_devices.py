"""What is missing of a converter or its driver is one sentence; turns that were missed are found."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from nmt_core.errors import BenchError
from nmt_plant.converters.nidaqmx_converter import find_channels
from nmt_plant.converters.portaudio_converter import MissedTurns, find_device, list_devices
from nmt_plant.devices.device import DeviceFault
from nmt_plant.devices.hardware_rig import HardwareRig, device_of
from nmt_rig.rig import load_rig


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


@pytest.mark.campaign
def test_a_converter_that_does_not_open_is_named():
    rig = load_rig("beam")
    device = HardwareRig(rig, device_of(rig, "nidaqmx", "127.0.0.1:9"))
    device.configure()
    with pytest.raises(DeviceFault, match="No NI gRPC device server answers"):
        device.start()
    assert Path(f"/proc/{device.output_pid}").exists() is False


@pytest.mark.campaign
def test_looking_for_channels_leaves_no_grpc_in_the_process_that_asks():
    """Its threads would not survive the fork of the nodes, which then crash."""
    code = (
        "import sys\n"
        "from nmt_core.errors import BenchError\n"
        "from nmt_plant.converters.nidaqmx_converter import find_channels\n"
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
