"""A laboratory's driver: how it is loaded, what it is held to, and that the template keeps it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_core.processes.steady_clock import SteadyClock
from nmt_plant.check.converter_contract import ContractResult, check_converter, check_driver, check_monitor
from nmt_plant.converters.converter import Converter, LoopbackConverter, Taken
from nmt_plant.converters.custom_converter import find_rig_driver
from nmt_plant.devices.device import DeviceFault
from nmt_plant.devices.hardware_rig import HardwareRig, device_of
from nmt_rig.rig import load_rig
from nmt_rig.rig_snapshot import rig_text

TEMPLATE = Path(__file__).resolve().parents[2] / "examples" / "converter"
RATE = 5000.0


class Clock(SteadyClock):
    """Goes on only when somebody sleeps."""

    time = 0.0

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> None:
        self.time += seconds


GOOD = """
import numpy as np

class Driver:
    delay = 0
    opened = 0

    def __init__(self, sample_rate, outputs, inputs, clock):
        if Driver.opened:
            raise OSError("the device is busy")
        Driver.opened = 1
        self.rate, self.inputs, self.clock = sample_rate, len(inputs), clock

    def exchange(self, volts):
        self.clock.sleep(volts.shape[1] / self.rate)
        return np.tile(volts[0], (self.inputs, 1))

    def close(self):
        Driver.opened = 0
"""

GIVES = "        return np.tile(volts[0], (self.inputs, 1))"
BY_CALLBACK = """
    def run(self, turn):
        measured = None
        for _ in range({turns}):
            values = turn(50, measured)
            if values is None:
                {at_end}
            self.clock.sleep(50 / self.rate)
            measured = np.zeros((self.inputs, 50))

    def close"""

BROKEN = {
    "imports what is not there": ("import numpy", "import numpie, numpy", "start", "needs the package numpie"),
    "cannot be imported": ("import numpy", "1/0; import numpy", "start", "cannot be imported: Zero"),
    "other arguments": ("inputs, clock)", "inputs, voltage, clock)", "start", "missing a required argument: 'voltage'"),
    "does not start": ("self.rate, self", "raise OSError('no cable'); self.rate, self", "start", "OSError: no cable"),
    "no close": ("def close", "def shut", "start", "has no method close; write it"),
    "no exchange": ("def exchange", "def swap", "start", "no method exchange .or run.; write it"),
    "delay in words": ("delay = 0", "delay = 'none'", "start", "Driver.delay is 'none'; it must be a number"),
    "wrong shape": (GIVES, "        return volts[0]", "failure", r"shape \(50,\); it must be \(3, samples\)"),
    "too few inputs": (GIVES, "        return volts", "failure", r"shape \(1, 50\); it must be \(3, samples\)"),
    "no numbers": (GIVES, GIVES + " * np.nan", "failure", "volts that are not finite"),
    "words": (GIVES, "        return 'volts'", "failure", "gave str, no array of volts"),
    "nothing": (GIVES, "        pass", "failure", r"exchange gave nothing; it must give \(3, samples\)"),
    "long turns": ("delay = 0", "delay = 0; chunk_samples = 1000", "turn", r"a turn has 1000 samples \(200 ms\)"),
    "no samples": ("delay = 0", "delay = 0; chunk_samples = 0", "turn", "it asked for 0 samples"),
    "falls behind": (GIVES, GIVES + "[:, :20]", "input", "it measured 4000 samples while it put out 10000"),
    "loses one of fifty": (
        GIVES, GIVES + "[:, :49]", "input", "measures fewer samples than it puts out: 9800 for 10000",
    ),
    "loses samples": (GIVES, GIVES + ", True", "loss", "it lost samples in 200 of 200 turns"),
    "another rate": ("shape[1] / self.rate", "shape[1] / 4594.0", "rate", "it takes 4594 samples a second"),
    "does not wait": ("self.clock.sleep", "abs", "rate", "it takes inf samples a second"),
    "goes on": (
        "\n    def close", BY_CALLBACK.format(turns=500, at_end="continue"), "end", "it went on after the answer None",
    ),
    "ends early": ("\n    def close", BY_CALLBACK.format(turns=20, at_end="return"), "end", "ended before it was told"),
    "closes once": ("Driver.opened = 0", "Driver.opened -= 1; 1 / (1 + Driver.opened)", "close", "ZeroDivisionError"),
    "keeps the device": ("Driver.opened = 0", "pass", "second_start", "the device is busy"),
}  # fmt: skip


def tried(folder: Path, source: str, name: str = "Driver") -> ContractResult:
    module = f"driver_{abs(hash((folder, source)))}"
    (folder / f"{module}.py").write_text(source)
    clock = Clock()
    inputs = [(1, 10.0), (2, 10.0), (3, 10.0)]
    return check_driver(
        f"{module}:{name}", folder, RATE, inputs=inputs, arguments={"clock": clock}, clock=clock, monitored=False
    )


def test_a_good_driver_is_found_so(tmp_path: Path) -> None:
    result = tried(tmp_path, GOOD)
    assert result.passed, str(result)
    assert (result.delay_samples, result.turn_samples) == (0, 50)
    assert result.rate_hz == pytest.approx(RATE)


def test_a_device_that_gives_blocks_of_its_own_is_good(tmp_path: Path) -> None:
    blocks = """
        self.waiting = getattr(self, "waiting", 0) + volts.shape[1]
        ready = 64 * (self.waiting // 64)
        self.waiting -= ready
        return np.zeros((self.inputs, ready))"""
    result = tried(tmp_path, GOOD.replace(GIVES, blocks))
    assert result.passed, str(result)


def test_a_driver_with_a_callback_is_good_too(tmp_path: Path) -> None:
    result = tried(tmp_path, GOOD.replace("\n    def close", BY_CALLBACK.format(turns=500, at_end="return")))
    assert result.passed, str(result)


@pytest.mark.parametrize("what", BROKEN)
def test_what_a_driver_does_not_keep_is_named(what: str, tmp_path: Path) -> None:
    old, new, rule, sentence = BROKEN[what]
    assert old in GOOD
    result = tried(tmp_path, GOOD.replace(old, new))
    assert [each.name for each in result.findings] == [rule], str(result)
    with pytest.raises(AssertionError, match=sentence):
        assert result.passed, str(result)


def test_a_class_that_is_not_there_is_named_with_those_that_are(tmp_path: Path) -> None:
    assert "has no class Drivr; it has Driver" in str(tried(tmp_path, GOOD, "Drivr"))


def test_a_delay_that_nobody_knows_is_told(tmp_path: Path) -> None:
    (finding,) = tried(tmp_path, GOOD.replace("delay = 0", "delay = -1")).findings
    assert finding.name == "delay"
    assert "quantity: voltage" in finding.remedy


class Careless(LoopbackConverter):
    """Uses its buffer again, and writes into what it is given."""

    buffer: Any = None

    def exchange(self, values: Any) -> Taken:
        taken = super().exchange(values)
        if self.buffer is None or self.buffer.shape != taken.values.shape:
            self.buffer = np.array(taken.values)
        self.buffer += 1.0
        values += 1.0
        return Taken(self.buffer)


def test_buffers_that_are_used_again_are_seen() -> None:
    clock = Clock()
    result = check_converter(lambda: Careless(RATE, clock=clock), RATE, 1, 1, clock=clock)
    assert [each.sentence for each in result.findings] == [
        "it changed what it had given before",
        "it wrote into the samples to put out",
    ]


def test_channels_that_do_not_fit_the_rig_are_told() -> None:
    clock = Clock()

    def made() -> Converter:
        return LoopbackConverter(RATE, inputs=2, clock=clock)

    assert check_converter(made, RATE, 1, 2, clock=clock).passed
    assert "it has 1 outputs and 2 inputs, the rig 1 and 3" in str(check_converter(made, RATE, 1, 3, clock=clock))


# --- the template ----------------------------------------------------------------------------------------------------


@pytest.fixture
def laboratory(tmp_path: Path) -> Path:
    """The template in a folder outside the clone."""
    for name in ("laboratory.yaml", "laboratory_driver.py"):
        (tmp_path / name).write_text((TEMPLATE / name).read_text())
    return tmp_path / "laboratory.yaml"


def test_the_driver_is_found_beside_the_rig_file_and_not_executed(laboratory: Path) -> None:
    (laboratory.parent / "laboratory_driver.py").write_text("raise SystemExit('executed')")
    rig = load_rig(laboratory)
    find_rig_driver(rig.device, rig)
    (laboratory.parent / "laboratory_driver.py").unlink()
    with pytest.raises(BenchError, match=r"there is no module laboratory_driver in .*; look at device.folder"):
        find_rig_driver(rig.device, rig)


def test_the_text_of_the_rig_finds_the_driver_from_anywhere(laboratory: Path, tmp_path_factory: Any) -> None:
    elsewhere = tmp_path_factory.mktemp("results") / "rig.yaml"
    elsewhere.write_text(rig_text(load_rig(laboratory), laboratory))
    assert load_rig(elsewhere).device == load_rig(laboratory).device


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ("device.converter=driver", "device converter must be module:Class, as in my_driver:MyDriver, got 'driver'"),
        ("device.arguments={inputs: 3}", "device arguments has inputs, which the class gets from the rig file"),
        (
            "device.kind=costum",
            "device.kind must be one of 'portaudio', 'nidaqmx', 'loopback', 'custom'.*; got 'costum'",
        ),
        ("device.convertr=a:B", "unknown key device.convertr; did you mean converter"),
    ],
)
def test_a_section_that_cannot_be_is_refused(change: str, sentence: str, laboratory: Path) -> None:
    with pytest.raises(BenchError, match=sentence):
        load_rig(laboratory, [change])


def test_the_template_answers_as_the_model_of_its_rig_file(laboratory: Path) -> None:
    """Independent of the driver's steps: the mass at rest under a constant force, and its natural frequency."""
    import sys

    sys.path.insert(0, str(TEMPLATE))
    try:
        from laboratory_driver import LaboratoryDriver
    finally:
        sys.path.remove(str(TEMPLATE))
    rig = load_rig(laboratory)
    inputs = [(entry.port, entry.range_v) for entry in rig.device.inputs]
    driver = LaboratoryDriver(rig.sample_rate_hz, [(1, 5.0)], inputs, cubic_n_m3=1e9)
    measured = driver._answer(np.concatenate([np.ones(30_000), np.zeros(5_000)]))
    force, acceleration = measured[0] / 0.5, measured[1] / 0.1
    assert force[0] == 1.0
    assert acceleration[0] == pytest.approx(1.0, rel=1e-3)  # F / m at rest
    position = next(root.real for root in np.roots([1e9, 0.0, 15791.367, -1.0]) if abs(root.imag) < 1e-12)
    assert acceleration[30_000] == pytest.approx(-(15791.367 * position + 1e9 * position**3), rel=1e-3)
    late = acceleration[33_500:]  # small again: the linear mode
    crossings = np.flatnonzero((late[:-1] < 0.0) & (late[1:] >= 0.0))
    assert rig.sample_rate_hz / np.diff(crossings).mean() == pytest.approx(20.0, rel=3e-3)


def test_the_template_streams_behind_the_guard(laboratory: Path) -> None:
    """A short stream through the process that owns the output: what is put out comes back, and ends at zero."""
    rig = load_rig(laboratory, ["device.settling_s=0.05"])
    device = HardwareRig(rig, device_of(rig), lead_blocks=20)
    try:
        device.configure()
        device.start()
        for _ in range(5):
            device.read()
        assert device.figures.delay == 0
        device.quiet("end")
        assert device.tripped == "end"
    finally:
        device.close()


def test_what_fails_in_a_driver_is_said(laboratory: Path) -> None:
    driver = laboratory.parent / "laboratory_driver.py"
    driver.write_text(driver.read_text().replace("return measured", "return measured[:1]"))
    rig = load_rig(laboratory, ["device.settling_s=0.05"])
    device = HardwareRig(rig, device_of(rig))
    device.configure()

    def stream() -> None:
        device.start()
        for _ in range(50):
            device.read()

    try:
        with pytest.raises(
            (DeviceFault, BenchError), match=r"gave an array of shape \(1, 50\); it must be \(3, samples"
        ):
            stream()
    finally:
        device.close()


@pytest.mark.parametrize("broken", with_quick([False, True], True))
def test_a_check_of_the_converter_alone_asks_for_the_monitor_as_a_run_does(broken: bool, laboratory: Path) -> None:
    driver = laboratory.parent / "laboratory_driver.py"
    if broken:
        driver.write_text(driver.read_text().replace("return measured", "return 0.0 * measured"))
    rig = load_rig(laboratory, ["device.settling_s=0.05"])
    found = check_monitor(rig, device_of(rig))
    assert [finding.name for finding in found] == (["monitor"] if broken else [])
    assert not broken or "is not seen at the drive's monitor input" in found[0].sentence


def test_arguments_are_those_of_the_rig_file(laboratory: Path) -> None:
    given = load_rig(laboratory).device.driver_arguments(RATE, 100)
    assert json.loads(json.dumps(given)) == given
    assert given["arguments"] == {"cubic_n_m3": 1e9}
    assert given["outputs"] == [[1, 5.0, 1.0]]
