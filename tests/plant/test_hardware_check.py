"""The check names every planted fault with its channel, nothing on a healthy bench, and stays below its drive."""

from __future__ import annotations

import numpy as np
import pytest
from tiers import with_quick

from nmt_blind.cases.blind_rigs import BLIND_RIGS
from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_plant.check.hardware_check import check
from nmt_plant.devices.hardware_rig import HardwareRig, device_of
from nmt_plant.specimen import Specimen
from nmt_plant.specimen_faults import FAULTS, Fault, parse_fault
from nmt_report.check_report import check_page
from nmt_rig.rig import Rig, load_rig

CHANNELS = {
    "noise": "a2",
    "mains": "f2",
    "offset": "x6",
    "overload": "x2",
    "open": "x4",
    "short": "x5",
    "icp": "a2",
    "sign": "x4",
    "permuted": "x4",
    "sensitivity": "x5",
    "late": "x5",
}
FOUND = {"force_response": ("f2", "x2"), "permuted": ("x4", "x6")}
LEVELS = (0.05, 1.5)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig("beam", ["sample_rate_hz=4000"])


def outcome(rig, faults=(), seed=1, levels=LEVELS):
    section = device_of(rig, "portaudio")
    specimen = Specimen(rig, section, faults=faults, seed=seed)
    device = HardwareRig(rig.model_copy(update={"seed": seed}), section, specimen=specimen)
    device.configure()
    device.start()
    try:
        result = check(device, levels)
    finally:
        device.close()
    assert 0.0 < result.drive_peak_v <= result.drive_limit_v == 0.5
    return result


@pytest.mark.parametrize(
    "name", with_quick(FAULTS, "noise", "open", "force_response", "sensitivity", "no_drive", "rate")
)
def test_a_planted_fault_is_named_with_its_channel(rig, name):
    channel = CHANNELS.get(name, "")
    result = outcome(rig, [Fault(name, channel)])
    expected = FOUND.get(name, (channel,) if channel else ())
    assert [(each.name, each.channels) for each in result.findings] == [(name, expected)]
    assert not result.passed


def outcome_of(rig, truth):
    """The check of another rig than its file says."""
    section = device_of(rig, "portaudio")
    device = HardwareRig(rig, section, specimen=Specimen(truth, section))
    device.configure()
    device.start()
    try:
        return check(device, LEVELS)
    finally:
        device.close()


def test_a_late_drive_sensor_is_measured_and_what_it_does_to_a_test_is_said(rig):
    """0.2 ms: a run of the same rig gives -141 ppm in frequency and +0.04 % in damping."""
    result = outcome_of(rig, load_rig("beam", ["sample_rate_hz=4000", "sensors.1.delay_s=0.0002"]))
    assert [(each.name, each.channels) for each in result.findings] == [("late", ("x2",))]
    late = result.channels[1]
    assert late.delay == pytest.approx(2e-4, abs=4 * late.delay_std)
    assert late.delay_std < 5e-6
    assert late.frequency_error == pytest.approx(-141e-6, rel=0.03)
    assert late.damping_error == pytest.approx(4e-4, abs=5e-3)
    assert all(abs(each.delay) < 5 * each.delay_std for each in result.channels if each.channel not in ("x2", "u"))


@pytest.mark.campaign
def test_a_single_mode_off_is_named_with_its_number():
    """The first mode 15 % lower and twice as damped, the others as the model has them."""
    rig = load_rig(BLIND_RIGS["modal_beam"].file, ["sample_rate_hz=4000"])
    seen = [sensor for sensor in rig.sensors if sensor.quantity != "displacement"]  # it sees nothing at this level
    rig = rig.model_copy(update={"sensors": seen})
    first, *others = rig.structure.modes
    low = first.model_copy(
        update={"frequency_hz": 0.85 * first.frequency_hz, "damping_ratio": 2.0 * first.damping_ratio}
    )
    truth = rig.model_copy(update={"structure": rig.structure.model_copy(update={"modes": [low, *others]})})
    result = outcome_of(rig, truth)
    assert [(each.name, each.channels) for each in result.findings] == [("resonance", ())]
    assert result.findings[0].sentence.startswith("mode 1 lies at ")
    assert "mode 2" not in result.findings[0].sentence
    for found, mode in zip(result.modes, [low, *others], strict=False):
        assert found.frequency_hz == pytest.approx(mode.frequency_hz, rel=2e-3)
        assert found.damping_ratio == pytest.approx(mode.damping_ratio, rel=0.2)
    page = check_page({"rig": "beam", "device": "portaudio", "date": "", "priority": "", **result.to_mapping()})
    assert "mode 1 lies at" in page
    assert "δ̃ error" in page
    assert 'aria-label="Gain and delay of each channel"' in page
    assert all(f">{channel}<" in page for channel in ("f3", "a2", "a3", "a6"))


def test_two_faults_at_once_are_both_named(rig):
    result = outcome(rig, [Fault("sign", "x4"), Fault("offset", "a2")], seed=4)
    assert {(each.name, each.channels) for each in result.findings} == {("sign", ("x4",)), ("offset", ("a2",))}


@pytest.mark.parametrize(
    ("faults", "expected"),
    with_quick(
        [
            ("delay permuted:x5", {("delay", ()), ("permuted", ("x5", "x6"))}),
            ("permuted:x4 overload:x4", {("overload", ("x4",)), ("permuted", ("x4", "x6"))}),
            ("permuted:x5 sensitivity:x5", {("permuted", ("x5", "x6")), ("sensitivity", ("x5",))}),
            ("force_response resonance", {("force_response", ("f2", "x2")), ("resonance", ())}),
            ("delay resonance", {("delay", ()), ("resonance", ())}),
            ("delay sensitivity:x2", {("delay", ()), ("sensitivity", ("x2",))}),
            ("permuted:x5 short:x6", {("short", ("x6",)), ("permuted", ("x5", "x6"))}),
            ("open:x5 sensitivity:x6", {("open", ("x5",)), ("sensitivity", ("x6",))}),
        ],
        ("delay permuted:x5", {("delay", ()), ("permuted", ("x5", "x6"))}),
    ),
)
def test_a_fault_does_not_hide_another(rig, faults, expected):
    """A delay that moves, a dead channel among exchanged ones, a wrong gain or other frequencies besides."""
    result = outcome(rig, [parse_fault(text) for text in faults.split()], seed=5)
    assert {(each.name, each.channels) for each in result.findings} == expected


@pytest.mark.parametrize("text", with_quick(["", "offset:x4"], "offset:x4"))
def test_a_few_lost_blocks_make_no_finding(rig, text):
    """In silence and under drive; what stands in the buffer of a lost block is old or zero."""
    section = device_of(rig, "portaudio")
    faults = [parse_fault(text)] if text else []
    device = HardwareRig(rig, section, specimen=Specimen(rig, section, faults=faults, seed=2))
    device.configure()
    device.start()
    read, count = device.read, 0

    def losing():
        nonlocal count
        count += 1
        got = read()
        if count in (30, 31, 120, 300, 301, 400):
            device.measured = np.zeros_like(device.measured)
            return []
        return got

    device.read = losing
    try:
        result = check(device, LEVELS)
    finally:
        device.close()
    assert result.lost_blocks == 6
    assert [(each.name, each.channels) for each in result.findings] == (
        [(faults[0].name, (faults[0].channel,))] if faults else []
    )


def test_a_healthy_bench_passes(rig):
    result = outcome(rig, seed=11)
    assert result.findings == ()
    assert [round(each.gain, 2) for each in result.channels] == [1.0] * 7
    assert result.to_mapping()["passed"] is True


def test_levels_beyond_a_range_are_named(rig):
    """A displacement range of a fiftieth, on the bench and in its file."""
    section = device_of(rig, "portaudio")
    inputs = [entry.model_copy(update={"range_v": 0.2}) if entry.channel == "x6" else entry for entry in section.inputs]
    narrow = rig.model_copy(update={"device": section.model_copy(update={"inputs": inputs})})
    result = outcome(narrow, levels=(3.0,))
    assert [(each.name, each.channels) for each in result.findings] == [("headroom", ("x6",))]


def test_an_unknown_fault_or_channel_is_refused(rig):
    with pytest.raises(BenchError, match="There is no fault 'rust'"):
        parse_fault("rust")
    with pytest.raises(BenchError, match="There is no channel x9"):
        Specimen(rig, device_of(rig, "portaudio"), faults=[Fault("sign", "x9")])


def test_a_specimen_measures_in_the_units_of_its_channel_map(rig):
    """Sensitivities go in and out: what the device reads is what the rig did."""
    section = device_of(rig, "portaudio")
    by_name = {entry.channel: entry for entry in section.inputs}
    assert HardwareRig(rig, section).overloaded == ()
    assert by_name["f2"].sensitivity_v == pytest.approx(10.0 / 50.0)
    assert section.output.amplifier_gain == pytest.approx(5.0)
    quantities = {sensor.channel: sensor.quantity for sensor in HardwareRig(rig, section).sensors}
    assert quantities["u"] is Quantity.VOLTAGE
