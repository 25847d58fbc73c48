"""The chain on the virtual beam: time integration, shaker, sensors, extraction, against harmonic balance."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nmt_core.messages.records import DriveCommand, LockEvent
from nmt_core.vocabulary import PointStatus, Waveform
from nmt_extract.extraction_settings import ExtractionSettings
from nmt_extract.extractor import Extractor
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_rig.linear_description import linear_description
from nmt_rig.reference import single_point_reference
from nmt_rig.rig import load_rig

VOLTS = 1.0


@pytest.fixture(scope="module")
def pair():
    """Point extracted at the phase-resonant frequency of harmonic balance, and what that gives."""
    rig = load_rig("beam")
    reference = single_point_reference(rig, None, [VOLTS], harmonics=20).mode
    frequency = float(reference.omega_rad_s[0]) / (2.0 * math.pi)
    settings = ExtractionSettings(harmonics=20, topics=("force", "displacement", "acceleration"))
    extractor = Extractor(linear_description(rig), settings, require_loop_state=False)
    first = 120_000
    samples = round(50 * rig.sample_rate_hz / frequency)
    extractor.add_lock(LockEvent(0, VOLTS, "V", first, frequency, 0.0, first, samples, 50))
    device = SimulatedRig(rig)
    device.configure()
    device.start()
    device.write(DriveCommand(waveform=Waveform.SINE, frequency_hz=frequency, amplitude=VOLTS, ramp=0.5))
    points = []
    while not points:
        for block in device.read():
            extractor.add_block(block.quantity.topic, block)
        device.write(DriveCommand(waveform=Waveform.SINE, frequency_hz=frequency, amplitude=VOLTS, ramp=0.5))
        points = extractor.take()
    device.stop()
    device.close()
    return points[0], reference


def test_extraction_agrees_with_harmonic_balance(pair):
    point, reference = pair
    assert point.status is PointStatus.OK
    assert point.omega_rad_s == pytest.approx(float(reference.omega_rad_s[0]), rel=1e-9)
    assert abs(point.phase_error) < 2e-4
    for name, tolerance in (
        ("damping_ratio", 5e-4),
        ("modal_amplitude", 2e-4),
        ("force_n", 2e-4),
        ("pbmif", 1e-4),
        ("gamma_force", 1e-4),
        ("gamma_acceleration", 1e-3),
    ):
        assert getattr(point, name) == pytest.approx(float(getattr(reference, name)[0]), rel=tolerance), name


def test_participation_agrees_with_harmonic_balance(pair):
    point, reference = pair
    expected = reference.participation[0]
    turned = expected * np.exp(-1j * np.angle(expected[0]))
    np.testing.assert_allclose(point.participation, turned, atol=1e-3)


def test_steady_state_has_small_stated_uncertainties(pair):
    point, _ = pair
    assert point.damping_ratio_std < 1e-3 * point.damping_ratio
    phase = point.damping_ratio * math.hypot(point.phase_error, point.phase_error_std)
    assert point.frequency_hz_std == pytest.approx(phase * point.frequency_hz, abs=1e-9)
