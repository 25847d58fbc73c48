"""Clock error and drift with bench time."""

from __future__ import annotations

import numpy as np
import pytest
from rig.effect_rigs import DAMPER, MASS, RATE, SPRING, beam, harmonic, oscillator, run

from nmt_core.messages.blocks import Quantity
from nmt_core.messages.records import DriveCommand
from nmt_core.vocabulary import Waveform
from nmt_plant.devices.simulated_rig import SimulatedRig


def decay_frequency(rig, strike=2.0):
    """Apparent frequency (Hz) of the free decay after a stop of the drive, over time: zero crossings."""
    device = SimulatedRig(rig)
    device.configure()
    device.start()
    device.write(DriveCommand(Waveform.SINE, 31.0, strike))
    parts = []
    for block in range(200):
        if block == 20:
            device.write(DriveCommand(Waveform.OFF))
        parts += [b.data[0] for b in device.read() if b.quantity == Quantity.DISPLACEMENT]
    x = np.concatenate(parts)[5000:]
    up = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0))
    times = (up - x[up] / (x[up + 1] - x[up]) + 5000) / RATE
    return times[:-1] + 0.5 * np.diff(times), 1 / np.diff(times)


NATURAL = np.sqrt(SPRING / MASS - (DAMPER / (2 * MASS)) ** 2) / (2 * np.pi)


def test_clock_error_divides_all_frequencies():
    """Real rates are 1.01 times the nominal: what happens at f appears at f / 1.01, whatever drives it."""
    _, seen = decay_frequency(oscillator(clock_error=0.01))
    assert np.mean(seen) == pytest.approx(NATURAL / 1.01, rel=1e-5)
    hz = 25.0
    x = run(oscillator(clock_error=0.01), hz, 2.0, 8.0)["x1"]
    s = 2j * np.pi * hz * 1.01
    assert harmonic(x, hz) == pytest.approx(2.0 / (SPRING + s * DAMPER + s * s * MASS), rel=5e-5)


def test_clock_error_shifts_the_mains_and_the_sensors_times():
    sensors = [
        {"quantity": "force", "point": "drive"},
        {"quantity": "displacement", "point": 1},
        {"quantity": "displacement", "point": 1, "channel": "slow", "delay_s": 1e-3},
        {"quantity": "acceleration", "point": 1, "hum_amplitude": 1.0},
    ]
    y = run(oscillator(sensors=sensors, clock_error=0.25), 25.0, 1.0, 8.0)
    assert abs(harmonic(y["a1"], 40.0, periods=40)) == pytest.approx(1.0, rel=2e-3)
    turned = harmonic(y["slow"], 25.0) / harmonic(y["x1"], 25.0)
    assert np.angle(turned) == pytest.approx(-2 * np.pi * 31.25 * 1e-3, rel=1e-4)


def test_stiffness_drifts_with_bench_time():
    rate = 0.005
    times, seen = decay_frequency(oscillator(drift={"stiffness_per_s": rate}))
    expected = np.sqrt(SPRING * (1 + rate * times) / MASS - (DAMPER / (2 * MASS)) ** 2) / (2 * np.pi)
    # Zero crossings between samples are found to 1e-5 of a period at this amplitude.
    np.testing.assert_allclose(seen, expected, rtol=6e-5)
    assert seen[-1] / seen[0] == pytest.approx(1 + 0.5 * rate * (times[-1] - times[0]), rel=3e-4)
    assert abs(seen[-1] / seen[0] - 1) > 5e-3


def test_no_drift_is_the_plain_integration_bit_for_bit():
    a = run(beam("drift.slip_force_per_s=1e-24"), 20.0, 1.0, 0.1)
    b = run(beam(), 20.0, 1.0, 0.1)
    assert all(np.array_equal(a[name], b[name]) for name in b)


@pytest.mark.parametrize("drift", [{"slip_force_per_s": -0.1}, {"slip_force_per_cycle": -0.004}])
def test_slip_force_falls_with_time_or_cycles(drift):
    """A joint that slips all along: its force's plateau is the slip force, in closed form."""
    joint = {"kind": "jenkins", "point": 1, "tangential_stiffness_n_m": 1e5, "slip_force_n": 3.0}
    y = run(oscillator([joint], drift=drift), 25.0, 40.0, 3.0)
    v = np.gradient(y["x1"], 1 / RATE)
    g = y["f1"] - MASS * y["a1"] - SPRING * y["x1"] - DAMPER * v
    for start in (1.0, 2.0, 2.9):
        window = slice(round(start * RATE), round(start * RATE) + 400)
        share = 1 - 0.1 * (start + 0.02)
        assert np.percentile(np.abs(g[window]), 70) == pytest.approx(3.0 * share, rel=5e-3)


def test_slip_force_of_an_iwan_joint_drifts_as_a_whole():
    joint = {"kind": "iwan", "point": 1, "tangential_stiffness_n_m": 1e5, "slip_force_n": 3.0, "sliders": 5}
    y = run(oscillator([joint], drift={"slip_force_per_s": -0.1}), 25.0, 40.0, 3.0)
    g = y["f1"] - MASS * y["a1"] - SPRING * y["x1"] - DAMPER * np.gradient(y["x1"], 1 / RATE)
    assert np.percentile(np.abs(g[-400:]), 60) == pytest.approx(3.0 * (1 - 0.1 * 2.98), rel=5e-3)


@pytest.mark.parametrize("drift", [{"slip_force_per_s": -0.5, "slip_force_per_cycle": -1e-3}, {"stiffness_per_s": 0.1}])
def test_drift_does_not_depend_on_the_block_length(drift):
    """Up to rounding: the oscillator's phase is carried on block by block."""
    joint = {"kind": "jenkins", "point": 1, "tangential_stiffness_n_m": 1e4, "slip_force_n": 1.0}
    a, b = (run(oscillator([joint], drift=drift), 25.0, 6.0, 0.6, block)["x1"] for block in (200, 40))
    plain = run(oscillator([joint]), 25.0, 6.0, 0.6)["x1"]
    assert np.abs(plain - a).max() > 1e-3 * np.abs(a).max()
    assert np.abs(a - b).max() < 1e-9 * np.abs(a).max()


def test_a_second_test_starts_from_the_undrifted_rig():
    device = SimulatedRig(oscillator(drift={"stiffness_per_s": 0.5}))
    outcome = []
    for _ in range(2):
        device.configure()
        device.start()
        device.write(DriveCommand(Waveform.SINE, 25.0, 2.0))
        outcome.append(np.concatenate([device.read()[1].data[0] for _ in range(20)]))
        device.stop()
    assert np.array_equal(*outcome)
