"""NI's client against a stand-in as strict as the devices: wrong settings end in a sentence, right ones measure."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from typing import Any

import nidaqmx
import numpy as np
import pytest
from plant.converter_chain import NiChannel
from plant.turned_clock import TurnedClock

from nmt_core.errors import BenchError
from nmt_plant.converters import nidaqmx_converter
from nmt_plant.converters.nidaqmx_converter import NiDaqmxConverter
from nmt_plant.devices.hardware_rig import device_of
from nmt_plant.specimen import Specimen
from nmt_rig.rig import load_rig
from nmt_specimen.ni_specimen import Hardware

NAMES = "cDAQ1, cDAQ1Mod1, cDAQ1Mod2, cDAQ1Mod3, Dev1"
RATE = 10_240.0
MODULES: dict[str, Any] = {
    "sample_rate": RATE,
    "outputs": [("cDAQ1Mod3/ao0", 10.0, 1.0)],
    "inputs": [("cDAQ1Mod1/ai0", 5.0, "dc", 0.0, ""), ("cDAQ1Mod2/ai0", 5.0, "ac", 2.0, "")],
    "block_samples": 200,
}
BOARD: dict[str, Any] = {
    "sample_rate": 10_000.0,
    "outputs": [("Dev1/ao0", 10.0, 1.0)],
    "inputs": [("Dev1/ai0", 10.0, "dc", 0.0, ""), ("Dev1/ai1", 5.0, "ac", 4.0, "")],
    "block_samples": 200,
}


@pytest.fixture
def hardware(monkeypatch: pytest.MonkeyPatch) -> Iterator[Hardware]:
    rig = load_rig("beam", [f"sample_rate_hz={RATE}"])
    clock = TurnedClock()
    made = Hardware(Specimen(rig, device_of(rig, "nidaqmx")), RATE, record=100_000, clock=clock)
    options = functools.partial(nidaqmx.GrpcSessionOptions, NiChannel(clock, made, NAMES))
    monkeypatch.setattr(nidaqmx_converter, "session_options", lambda _, name: options(name))
    yield made
    clock.close()


def test_settings_that_fit_are_taken(hardware: Hardware) -> None:
    for settings in (MODULES, BOARD, {**MODULES, "sample_rate": 51_200.0}, {**BOARD, "clock_source": "/Dev1/PFI0"}):
        NiDaqmxConverter(**settings).close()


def first_input(settings: dict[str, Any], *entry: Any, serial: str = "") -> dict[str, Any]:
    return {**settings, "inputs": [(*entry, serial), *settings["inputs"][1:]]}


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "rate of no module": ({**MODULES, "sample_rate": 10_000.0}, "takes 10240 Hz .*; write sample_rate_hz: 10240"),
    "rate between two": ({**MODULES, "sample_rate": 20_000.0}, "takes 25600 Hz .* not 20000"),
    "rate below the lowest": ({**MODULES, "sample_rate": 1000.0}, r"takes 1651\.6\d+ Hz .* not 1000"),
    "rate beyond the modules": ({**MODULES, "sample_rate": 102_400.0}, "refuses 102400 Hz .*give a sample_rate_hz"),
    "rate beyond the board": ({**BOARD, "sample_rate": 1e6}, r"refuses 1e\+06 Hz .*give a sample_rate_hz"),
    "rate that does not divide": ({**BOARD, "sample_rate": 44_100.0}, r"takes 44111\.\d+ Hz .* not 44100"),
    "range of a module": (first_input(MODULES, "cDAQ1Mod1/ai0", 10.0, "dc", 0.0), "refuses ±10 V at cDAQ1Mod1/ai0"),
    "range that is coerced": (first_input(MODULES, "cDAQ1Mod1/ai0", 2.0, "dc", 0.0), "takes 5 V .*range_v: 5"),
    "range of the board": (first_input(BOARD, "Dev1/ai0", 42.0, "dc", 0.0), "refuses ±42 V at Dev1/ai0"),
    "range between two": (first_input(BOARD, "Dev1/ai0", 2.5, "dc", 0.0), "takes 5 V .* not 2.5; write range_v: 5"),
    "ICP of 4 mA": (first_input(MODULES, "cDAQ1Mod1/ai0", 5.0, "ac", 4.0), "refuses an ICP current of 4 mA .*icp_ma"),
    "ICP of 20 mA": (first_input(BOARD, "Dev1/ai0", 5.0, "ac", 20.0), "refuses an ICP current of 20 mA at Dev1/ai0"),
    "no such device": (first_input(BOARD, "Dev2/ai0", 10.0, "dc", 0.0), "at Dev2/ai0 .Device identifier is invalid"),
    "no such module": (first_input(MODULES, "cDAQ1Mod8/ai0", 5.0, "dc", 0.0), "at cDAQ1Mod8/ai0 .Device identifier"),
    "no such channel": (first_input(MODULES, "cDAQ1Mod1/ai4", 5.0, "dc", 0.0), "at cDAQ1Mod1/ai4 .Physical channel"),
    "no such output": ({**BOARD, "outputs": [("Dev1/ao77", 10.0, 1.0)]}, "at Dev1/ao77 .Physical channel"),
    "output beyond its range": ({**BOARD, "outputs": [("Dev1/ao0", 12.0, 1.0)]}, "refuses ±12 V at Dev1/ao0"),
    "trigger of a module": ({**MODULES, "start_trigger": "/cDAQ1Mod1/ai/StartTrigger"}, "trigger .*start_trigger"),
    "clock of a module": ({**MODULES, "clock_source": "/cDAQ1Mod1/ai/SampleClock"}, "the clock .*device.clock_source"),
    "clock of another device": ({**BOARD, "clock_source": "/Dev7/ai/SampleClock"}, "the clock /Dev7/ai/SampleClock"),
    "stop line beyond its range": ({**MODULES, "stop": ("cDAQ1Mod2/ai1", 24.0, 2.5, True)}, "±24 V at cDAQ1Mod2/ai1"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_setting_is_one_sentence(name: str, hardware: Hardware) -> None:
    settings, sentence = WRONG[name]
    with pytest.raises(BenchError, match=sentence) as refused:
        NiDaqmxConverter(**settings)
    assert str(refused.value).count("\n") == 0


def test_a_sensor_whose_data_sheet_says_another_number_is_one_sentence(hardware: Hardware) -> None:
    hardware.sheets["cDAQ1Mod1/ai0"] = 4711
    for serial in ("LW4711", ""):
        NiDaqmxConverter(**first_input(MODULES, "cDAQ1Mod1/ai0", 5.0, "dc", 0.0, serial=serial)).close()
    with pytest.raises(BenchError, match=r"cDAQ1Mod1/ai0 has the serial number 4711 .TEDS., not LW4712; look at"):
        NiDaqmxConverter(**first_input(MODULES, "cDAQ1Mod1/ai0", 5.0, "dc", 0.0, serial="LW4712"))
    without = {**BOARD, "inputs": [("Dev1/ai0", 10.0, "dc", 0.0, "77"), *BOARD["inputs"][1:]]}
    NiDaqmxConverter(**without).close()


def test_modules_on_the_clock_of_their_chassis_measure(hardware: Hardware) -> None:
    count = len(hardware._specimen.channels)
    inputs = [(f"cDAQ1Mod{1 + n // 4}/ai{n % 4}", 5.0, "dc", 0.0, "") for n in range(count)]
    clock = hardware._clock
    converter = NiDaqmxConverter(RATE, MODULES["outputs"], inputs, 200, clock=clock)
    t = np.arange(4000) / RATE
    drive = np.sin(2.0 * np.pi * 50.0 * t)[np.newaxis]
    measured = [converter.exchange(drive[:, first : first + 200]).values for first in range(0, 4000, 200)]
    converter.close()
    port = hardware.at_the_port()[0]
    start = int(np.argmax(port != 0.0)) - 1
    np.testing.assert_allclose(port[start : start + 3000], drive[0, :3000], atol=1e-9)
    assert all(part.shape == (count, 200) for part in measured)
    assert np.abs(np.concatenate(measured, axis=1)).max() > 0.0
