"""The paper's loop: detector and controller against closed forms, lock against the virtual beam."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pll.plant_in_the_loop import LoopOnRig
from scipy.signal import lsim

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import OscillatorPhase, Quantity, SampleBlock
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.records import LevelCommand
from nmt_core.settings import parameters_of, settings_of
from nmt_core.vocabulary import LoopState
from nmt_pll.phase_loop.paper_loop import PaperLoop
from nmt_pll.phase_loop.paper_settings import PaperSettings
from nmt_pll.pll_settings import PllSettings

RATE, BLOCK = 10_000.0, 200
LINEAR = LinearDescription("model", 2, 0, (2,), (139.4,), (0.005,), ((1.0,),), 1.0, 140.0, 0.02, 0.043, 0.28, 5e-4)


def make(**settings):
    return PaperLoop(LINEAR, PaperSettings(**settings), RATE, BLOCK)


def detected(loop, force, response):
    """Mean detector output over the last second, times 2a: sin of the phase error."""
    blocks = len(force) // BLOCK
    parts = np.array(
        [
            loop.process_signals(force[k * BLOCK : (k + 1) * BLOCK], response[k * BLOCK : (k + 1) * BLOCK], False)
            for k in range(blocks)
        ]
    )
    return 2.0 * loop.settings.pole * parts[-50:].mean()


@pytest.mark.parametrize("error", [-80.0, -20.0, 0.0, 1.0, 45.0, 90.0])
@pytest.mark.parametrize("scale", [1.0, 1e-4])
def test_detector_gives_half_the_sine_of_the_phase_error_at_any_amplitude(error, scale):
    time = np.arange(40_000) / RATE
    theta = 2 * math.pi * 22.19 * time
    force = 3.0 * scale * np.cos(theta + math.pi / 2 - math.radians(error))
    assert detected(make(), force, 1e-4 * np.cos(theta)) == pytest.approx(math.sin(math.radians(error)), abs=2e-3)


def test_noise_lowers_the_gain_as_stated():
    rng = np.random.default_rng(3)
    time = np.arange(200_000) / RATE
    theta = 2 * math.pi * 22.19 * time
    error = math.radians(30.0)
    force = np.cos(theta + math.pi / 2 - error) + 0.8 * rng.standard_normal(time.size)
    response = np.cos(theta) + 1.5 * rng.standard_normal(time.size)
    loop = make()
    expected = math.sin(error) / math.sqrt((1 + 2 * 0.8**2) * (1 + 2 * 1.5**2))
    values = [detected(loop, force[k : k + 20_000], response[k : k + 20_000]) for k in range(0, 200_000, 20_000)]
    assert np.mean(values[1:]) == pytest.approx(expected, rel=0.08)


def test_controller_is_the_published_transfer_function():
    # Constant signals have twice the mean square of a sine's: their normalised product is exactly one half.
    loop = make(gain=3.0, pole=5.0, zero=2.0)
    loop._state[:2] = 1.0
    ones = np.ones(BLOCK)
    means = []
    for _ in range(100):
        loop.process_signals(ones, ones)
        means.append(loop.frequency - loop.centre)
    time = np.arange(100 * BLOCK) / RATE
    _, output, _ = lsim(([3.0, 6.0], [1.0, 5.0, 0.0]), np.full(time.size, 0.5), time)
    np.testing.assert_allclose(means, output.reshape(100, BLOCK).mean(axis=1), rtol=2e-3, atol=2e-4)


def test_lock_on_the_beam_reaches_90_degrees_without_bias():
    rig = LoopOnRig()
    history = rig.hold(0.1, 14.0, ramp=0.0, frequency_hz=0.95 * 22.1898)
    assert history.locked_at == pytest.approx(11.0, abs=0.03)
    assert rig.measured_phase() == pytest.approx(90.0, abs=0.1)
    assert history.omega[-50:].mean() == pytest.approx(139.4341, rel=2e-5)


def test_time_to_lock_after_a_shift_of_5_percent_is_the_reported_one():
    """At 0.62 V friction has lowered the resonance by 5.2 %; the paper reports 10.7 s for K = 2π."""
    rig = LoopOnRig()
    rig.hold(0.1, 11.5)
    history = rig.hold(0.62, 14.0)
    final = 132.20
    assert final / rig.linear.frequencies_rad_s[0] == pytest.approx(0.948, abs=2e-3)
    near = np.abs(np.degrees(history.phase_error)) < 5.0
    settled = history.time[np.flatnonzero(~near)[-1] + 1]
    assert settled == pytest.approx(10.7, abs=0.7)
    assert history.omega[-1] == pytest.approx(final, rel=2e-3)


def test_window_opens_after_the_waiting_time_or_not_at_all():
    quick = LoopOnRig(waiting_time=4.0, phase_tolerance=math.radians(2.0))
    assert quick.hold(0.1, 5.0).locked_at == pytest.approx(4.0, abs=0.03)
    impatient = LoopOnRig()
    history = impatient.hold(0.62, 3.0, timeout=1.5)
    assert history.locked_at is None
    assert impatient.loop.machine.state is LoopState.LOCK_LOST
    assert history.reasons[-1] == "no lock within the time-out"


def test_stiff_joint_driven_at_point_2_locks_on_the_second_mode():
    """As in the paper: k_t = 500 kN/m, started at the first mode; nothing guards against it."""
    rig = LoopOnRig(["local_elements.0.tangential_stiffness_n_m=500e3"], gain=30.0 * math.pi)
    first = rig.linear.frequencies_rad_s[0]
    rig.hold(0.6, 14.0)
    history = rig.hold(5.0, 22.0)
    assert history.locked_at is not None
    assert history.omega[-1] > 2.5 * first


def block(quantity, data, first=0, points=(2,)):
    names = tuple(f"c{p}" for p in points)
    phase = OscillatorPhase(0.0, 22.0)
    return SampleBlock(first, RATE, quantity, "?", names, points, np.atleast_2d(data), phase)


def test_what_it_cannot_do_is_told():
    loop = make()
    with pytest.raises(BenchError, match="steps the voltage only"):
        loop.set_level(LevelCommand(1, 0, 1.0, 0, 0.5, control=2))
    with pytest.raises(BenchError, match="finite and >= 0"):
        loop.set_level(LevelCommand(1, 0, math.nan, 0, 0.5))
    force = block(Quantity.FORCE, np.zeros(BLOCK))
    with pytest.raises(ValueError, match="not a velocity"):
        loop.process(force, block(Quantity.VELOCITY, np.zeros(BLOCK)))
    with pytest.raises(ValueError, match="same samples"):
        loop.process(force, block(Quantity.DISPLACEMENT, np.zeros(BLOCK), first=BLOCK))
    with pytest.raises(ValueError, match="drive point 2"):
        loop.process(force, block(Quantity.DISPLACEMENT, np.zeros((2, BLOCK)), points=(4, 5)))


def test_a_gap_of_signal_ends_a_lock_with_its_reason():
    rig = LoopOnRig(waiting_time=3.0, phase_tolerance=0.2, force_floor=1e-3)
    assert rig.hold(0.1, 3.5).locked_at is not None
    rig.loop.quiet("somebody says so")
    history = rig.hold(0.1, 0.1)
    assert "somebody says so" in history.reasons


def test_parameters_and_settings_name_the_same_things():
    values = {parameter.name: parameter.default for parameter in parameters_of(PllSettings)}
    assert settings_of(PllSettings, values, "pll") == PllSettings()
    given = settings_of(PllSettings, {"paper_gain": 94.2, "force_floor": 0.5, "cutoff": 3.0}, "pll")
    shared = given.paper_settings.combined_with(given.loop_settings)
    assert (shared.gain, shared.force_floor) == (94.2, 0.5)
    with pytest.raises(BenchError, match="'gain'"):
        PaperSettings(gain=0.0)
    with pytest.raises(BenchError, match="'pole'"):
        PaperSettings(pole=-1.0)


def test_an_oscillator_does_not_turn_backwards() -> None:
    """A phase error that never ends pulls down for ever; a twentieth of the centre is left."""
    lowest = []
    for sign in (1.0, -1.0):
        loop = make(gain=2000.0)
        wave = np.sin(loop.centre * np.arange(400 * BLOCK) / RATE)
        for part in np.split(wave, 400):
            loop.process_signals(part, sign * part, True)
            lowest.append(loop.frequency)
    assert min(lowest) == pytest.approx(0.05 * loop.centre)
