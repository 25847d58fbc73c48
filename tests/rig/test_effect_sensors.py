"""Sensor chain: filters and delay against their transfer functions, and everything else against its formula."""

from __future__ import annotations

import numpy as np
import pytest
from rig.effect_rigs import RATE, beam, harmonic, oscillator, run

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_rig.analogue_chain import AnalogueChain
from nmt_rig.rig import load_rig
from nmt_rig.sensors import Sensor, SensorChannel

FREQUENCIES = (2.0, 20.0, 100.0, 250.0)


def channel(**settings) -> SensorChannel:
    return SensorChannel(Sensor("a2", Quantity.ACCELERATION, 2, **settings), RATE, seed=7)


def response(hz: float, process, seconds: float = 1.5) -> complex:
    """Steady complex gain at a frequency with whole samples per period, over the last half second."""
    k = np.arange(round(seconds * RATE))
    y = process(np.cos(2 * np.pi * hz * k / RATE))
    last = slice(-5000, None)
    return complex(2 / 5000 * y[last] @ np.exp(-2j * np.pi * hz * k[last] / RATE))


@pytest.mark.parametrize("hz", FREQUENCIES)
@pytest.mark.parametrize("corner", [30.0, 500.0, 4000.0, 30_000.0])
def test_low_pass(hz, corner):
    chain = AnalogueChain(RATE, low_pass_hz=corner)
    assert response(hz, chain.process) == pytest.approx(1 / (1 + 1j * hz / corner), rel=1e-6)


@pytest.mark.parametrize("hz", FREQUENCIES)
@pytest.mark.parametrize("corner", [1.0, 10.0])
def test_high_pass(hz, corner):
    chain = AnalogueChain(RATE, high_pass_hz=corner)
    assert response(hz, chain.process, 4.0) == pytest.approx(1j * hz / (1j * hz + corner), rel=1e-6)


@pytest.mark.parametrize("hz", FREQUENCIES)
@pytest.mark.parametrize("delay", [1e-6, 3.7e-5, 1e-4, 2.4e-4, 5e-4, 1.234e-3, -2e-5, -1e-4])
def test_delay(hz, delay):
    chain = AnalogueChain(RATE, delay=delay)
    assert response(hz, chain.process) == pytest.approx(np.exp(-2j * np.pi * hz * delay), rel=2e-5)


def test_a_delay_of_whole_samples_moves_them():
    values = np.random.default_rng(1).standard_normal(50)
    moved = AnalogueChain(RATE, delay=7e-4).process(values)
    np.testing.assert_allclose(moved[7:], values[:-7], rtol=0, atol=1e-12)
    assert np.array_equal(moved[:7], np.zeros(7))


@pytest.mark.parametrize("delay", [0.3, 1.7, 2.5])
def test_a_late_step_does_not_ring(delay):
    step = np.repeat((0.0, 1.0), 20)
    seen = AnalogueChain(RATE, low_pass_hz=None, delay=delay / RATE, steps=True).process(step)
    np.testing.assert_allclose(seen, np.interp(np.arange(40) - delay, np.arange(40), step), atol=1e-12)
    filtered = AnalogueChain(RATE, low_pass_hz=0.1 * RATE, delay=delay / RATE, steps=True).process(step)
    assert np.all(np.diff(filtered) >= 0.0)
    # The ordinary chain, for smooth signals, does.
    assert AnalogueChain(RATE, delay=delay / RATE).process(step).max() > 1.02


def test_filters_in_a_row_are_multiplied():
    chain = AnalogueChain(RATE, 800.0, 2.0, 3e-4)
    expected = 1 / (1 + 50j / 800) * 50j / (50j + 2) * np.exp(-2j * np.pi * 50 * 3e-4)
    assert response(50.0, chain.process, 3.0) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    "settings",
    [
        {"low_pass_hz": 300.0, "high_pass_hz": 2.0, "delay": 3.3e-4},
        {"hum_amplitude": 0.2, "dead_zone": 0.1, "noise_psd": 1e-7},
        {"dropped_fraction": 0.2, "noise_psd": 1e-7},
        {"dropped_fraction": 0.9, "clip": 0.5, "gain": 2.0},
        {"crosstalk_per_volt": 0.3},
    ],
)
def test_recording_does_not_depend_on_the_block_length(settings):
    values = np.random.default_rng(3).standard_normal(1000)
    drive = np.cos(np.arange(1000))
    outcome = []
    for lengths in ([1000], [200] * 5, [1] * 10 + [7, 983]):
        c = channel(**settings)
        edges = np.cumsum([0, *lengths])
        outcome.append(np.concatenate([c.measure(values[a:b], drive[a:b])[0] for a, b in _pairs(edges)]))
    assert np.array_equal(outcome[0], outcome[1])
    assert np.array_equal(outcome[0], outcome[2])
    assert not np.array_equal(outcome[0], values)


def _pairs(edges):
    return zip(edges[:-1], edges[1:], strict=True)  # noqa: RUF007 - slices of arrays


def test_hum_is_a_line_at_its_frequency_of_one_phase_in_all_channels():
    a = channel(hum_amplitude=0.3).measure(np.zeros(10_000))[0]
    other = SensorChannel(Sensor("f2", Quantity.FORCE, 2, hum_amplitude=0.3), RATE, 7).measure(np.zeros(10_000))[0]
    spectrum = np.abs(np.fft.rfft(a)) / 5000
    assert np.argmax(spectrum) == 50
    assert spectrum[50] == pytest.approx(0.3, rel=1e-9)
    assert np.sort(spectrum)[-2] < 1e-9
    assert np.array_equal(a, other)
    sixty = channel(hum_amplitude=0.3, hum_hz=60.0).measure(np.zeros(10_000))[0]
    assert np.argmax(np.abs(np.fft.rfft(sixty))) == 60


def test_dead_zone_clip_and_crosstalk():
    values = np.array([-0.5, -0.1, 0.0, 0.1, 0.5])
    np.testing.assert_allclose(channel(dead_zone=0.2).measure(values)[0], [-0.3, 0, 0, 0, 0.3])
    clipped, overload = channel(clip=0.4, gain=2.0).measure(values)
    np.testing.assert_allclose(clipped, [-0.4, -0.2, 0, 0.2, 0.4])
    assert not overload
    recorded = channel(crosstalk_per_volt=0.5, gain=2.0).measure(values, np.full(5, 3.0))[0]
    np.testing.assert_allclose(recorded, 2 * values + 1.5)


def test_dropped_samples_repeat_the_one_before():
    values = 1.0 + np.arange(20_000)
    recorded = channel(dropped_fraction=0.1).measure(values)[0]
    lost = recorded != values
    assert np.mean(lost) == pytest.approx(0.1, abs=0.008)
    assert np.array_equal(recorded[1:][lost[1:]], recorded[:-1][lost[1:]])


def test_transverse_motion_is_added_with_its_share():
    sensors = (
        "sensors=[{quantity: force, point: drive}, {quantity: displacement, point: 2}, "
        "{quantity: displacement, point: 4, transverse: {point: 6, fraction: -0.05}}, "
        "{quantity: displacement, point: 6}, {quantity: displacement, point: 4, channel: plain}]"
    )
    y = run(beam(sensors), 20.0, 1.0, 0.2)
    np.testing.assert_allclose(y["x4"], y["plain"] - 0.05 * y["x6"], rtol=0, atol=1e-12 * np.abs(y["x4"]).max())
    assert np.abs(0.05 * y["x6"]).max() > 0.05 * np.abs(y["x4"]).max()


def test_a_force_cell_measures_the_inertia_of_its_mass():
    key = "sensors.0.mass_kg=0.02"
    a, b = run(beam(key), 20.0, 1.0, 0.2), run(beam(), 20.0, 1.0, 0.2)
    np.testing.assert_allclose(a["f2"], b["f2"] + 0.02 * b["a2"], rtol=0, atol=1e-10 * np.abs(b["f2"]).max())
    assert np.array_equal(a["x4"], b["x4"])


def test_chain_in_a_running_rig():
    """Delay, filter and gain of the accelerometer; the voltage sensor's cross-talk is that of the command."""
    sensors = [
        {"quantity": "force", "point": "drive"},
        {"quantity": "displacement", "point": 1},
        {"quantity": "acceleration", "point": 1, "delay_s": 2e-4, "low_pass_hz": 500.0, "gain": 1.03},
        {"quantity": "acceleration", "point": 1, "channel": "plain"},
        {"quantity": "displacement", "point": 1, "channel": "loop", "crosstalk_per_volt": 1e-4},
    ]
    y = run(oscillator(sensors=sensors), 25.0, 2.0, 8.0)
    s = 2j * np.pi * 25.0
    expected = harmonic(y["plain"], 25.0) * 1.03 * np.exp(-s * 2e-4) / (1 + 25j / 500)
    assert harmonic(y["a1"], 25.0) == pytest.approx(expected, rel=1e-6)
    assert harmonic(y["loop"] - y["x1"], 25.0) == pytest.approx(2e-4, rel=1e-9)


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("sensors.a2.delay_s=-2e-4", "lead by one sampling interval"),
        ("sensors.a2.dropped_fraction=1.0", "dropped_fraction"),
        ("sensors.a2.transverse={point: 12, fraction: 0.1}", "points 1 to 7"),
        ("sensors.u.mass_kg=0.1", "remove mass_kg"),
        ("sensors.0.transverse={point: 4, fraction: 0.1}", "remove transverse"),
        ("sensors.a2.low_pass_hz=0", "low_pass_hz must be positive"),
        ("sensors.a2.hum_amplitude=-1", "must not be negative"),
        ("exciter.amplifier_saturation_v=0", "must be positive"),
        ("exciter.source_resistance_ohm=-3.5", "positive sum"),
        ("structure.added_masses=[{point: 9, mass_kg: 1}]", "points 1 to 7"),
        ("structure.clamp_lateral_stiffness_n_m=0", "must be positive"),
        ("local_elements=[{kind: cubic_spring, point: 3, side: exciter, stiffness_n_m3: 1}]", "drive point"),
        (
            "local_elements=[{kind: bouc_wen, point: 2, side: exciter, stiffness_n_m: 1, yield_displacement_m: 1}]",
            "side of the structure",
        ),
        (
            "local_elements=[{kind: lugre, point: 2, bristle_stiffness_n_m: 1, coulomb_force_n: 2, static_force_n: 1, "
            "stribeck_velocity_m_s: 1}]",
            "must not be smaller",
        ),
        (
            "local_elements=[{kind: fractional_damper, point: 2, coefficient_n_sa_m: 1, low_hz: 5, high_hz: 5}]",
            "must be smaller",
        ),
        ("clock_error=0.9", "clock_error"),
        ("drift.slip_force=1", "slip_force_per_s"),
    ],
)
def test_what_cannot_be_is_said(override, says):
    names = {"sensors.a2": "sensors.5", "sensors.u": "sensors.6"}
    for name, index in names.items():
        override = override.replace(name, index)
    with pytest.raises(BenchError, match=says):
        load_rig("beam", [override])


def test_points_of_a_chain_do_not_rotate():
    with pytest.raises(BenchError, match="do not rotate"):
        oscillator([{"kind": "linear_spring", "point": 1, "rotation": True, "stiffness_n_m": 1.0}])
