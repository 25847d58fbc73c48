"""The check of a bench with two exciters: each drives in turn."""

from __future__ import annotations

import numpy as np
import pytest

from nmt_plant.check.exciter_in_turn import check_in_turn, with_first
from nmt_plant.check.hardware_check import check
from nmt_plant.devices.hardware_rig import HardwareRig, device_of
from nmt_plant.specimen import Specimen
from nmt_plant.specimen_faults import Fault
from nmt_rig.rig import load_rig


class Cabled(Specimen):
    """A specimen of the bench as it is, with cables from the outputs of a turned section."""

    def __init__(self, rig, section, device, gains, swapped, faults):
        super().__init__(rig, section, faults=faults)
        row = {entry.port: number for number, entry in enumerate(device.outputs)}
        self._cables = np.zeros((2, 2))
        for number, entry in enumerate(section.outputs):
            self._cables[1 - number if swapped else number, row[entry.port]] = gains[number]

    def respond(self, port):
        return super().respond(self._cables @ port)


def outcome(gains=(1.0, 1.0), swapped=False, faults=()):
    """Result with cables from output to amplifier that have these gains, or are exchanged."""
    rig = load_rig("frame", ["sample_rate_hz=2000", "block_samples=100"])
    section = device_of(rig, "portaudio")
    driven = []

    def one(turned, its_section):
        specimen = Cabled(rig, section, its_section, gains, swapped, faults)
        device = HardwareRig(turned, its_section, specimen=specimen)
        device.configure()
        device.start()
        try:
            result = check(device, (0.05, 1.5))
        finally:
            device.close()
        driven.append(its_section.outputs[0].channel)
        return result

    result = check_in_turn(rig, section, one)
    assert driven == ["u", "u2"]
    assert 0.0 < result.drive_peak_v <= result.drive_limit_v
    return result


def named(result):
    return {(each.sentence.partition(" drives: ")[0], each.name, each.channels) for each in result.findings}


@pytest.mark.campaign
def test_nothing_is_found_on_a_healthy_bench_and_both_monitors_follow():
    result = outcome()
    assert result.passed, result.findings
    assert {figures.channel for figures in result.channels if figures.coherence > 0.9} >= {"u", "u2", "f1", "f2"}


@pytest.mark.campaign
@pytest.mark.parametrize("number", [1, 2])
def test_an_output_without_its_cable_is_found_at_its_exciter(number):
    gains = [1.0, 1.0]
    gains[number - 1] = 0.0
    assert {(who, name) for who, name, _ in named(outcome(gains))} == {(f"exciter {number}", "no_drive")}


@pytest.mark.campaign
def test_exchanged_outputs_are_found():
    assert named(outcome(swapped=True)) == {("exciter 1", "open", ("u",)), ("exciter 2", "open", ("u2",))}


@pytest.mark.campaign
def test_a_sign_at_the_second_force_is_found_whoever_drives():
    assert named(outcome(faults=[Fault("sign", "f2")])) == {
        ("exciter 1", "sign", ("f2",)),
        ("exciter 2", "sign", ("f2",)),
    }


def test_the_second_exciter_comes_first_and_everything_else_stays():
    rig = load_rig("frame")
    section = device_of(rig, "nidaqmx")
    turned, its_section = with_first(rig, section, 2)
    assert turned.exciter_points == (2, 1)
    assert [entry.port for entry in its_section.outputs] == ["nmt_specimen/ao1", "nmt_specimen/ao0"]
    assert [turned.sensor_channel(each) for each in turned.sensors] == [
        rig.sensor_channel(each) for each in rig.sensors
    ]
    assert [turned.sensor_point(each) for each in turned.sensors] == [rig.sensor_point(each) for each in rig.sensors]
    assert [each.exciter for each in turned.sensors[-2:]] == [2, 1]
    assert with_first(rig, section, 1) == (rig, section)
