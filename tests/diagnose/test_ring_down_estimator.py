"""Ring-downs as laboratories have them, against closed forms, an ordinary integrator and the prediction."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipk

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.ledger.size import large_lines
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.measurements.recorded_decay import RecordedDecay, ring_down_observations
from nmt_diagnose.observations.channels.bag_samples import SampleStretch
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.prediction.forward import Forward
from nmt_rig.rig import Rig, SensorSection, validate_rig
from nmt_rig.rig_file import RigDocument
from nmt_signals.decays.decay_nodes import nodes
from nmt_signals.decays.decay_signal import demodulated, middles, ridges, slow_amplitude, window
from nmt_signals.decays.half_cycles import half_cycle_nodes

HZ, RATIO, TOP = 50.0, 0.004, 1e-3
OMEGA = 2.0 * math.pi * HZ
LASER = MeasuredChannel("v1", Quantity.VELOCITY, 1)


def rig(cubic: float = 0.0, modes: tuple[tuple[float, float], ...] = ((HZ, RATIO),)) -> Rig:
    """Modes of 1 kg, their shapes alike at points 1 and 2."""
    values = {
        "name": "modes",
        "structure": {
            "kind": "modal",
            "points": [1, 2],
            "modes": [
                {"frequency_hz": hz, "damping_ratio": ratio, "modal_mass_kg": 1.0, "shape": [1.0, 0.4]}
                for hz, ratio in modes
            ],
        },
        "exciter": {"kind": "force", "point": 1},
        "sensors": [{"quantity": "force", "point": "drive"}, {"quantity": "velocity", "point": 1}],
        "extraction": {"quantity": "velocity", "linear_modes": 1},
    }
    if cubic:
        values["local_elements"] = [{"kind": "cubic_spring", "point": 1, "stiffness_n_m3": cubic}]
    return validate_rig(RigDocument("test", values, {}))


def decay(rate: float, seconds: float, cubic: float = 0.0) -> FloatArray:
    """Velocity of 1 kg on a linear and a cubic spring, let go at ``TOP``."""
    times = np.arange(round(seconds * rate)) / rate
    run = solve_ivp(
        lambda _, y: [y[1], -(OMEGA**2) * y[0] - cubic * y[0] ** 3 - 2.0 * RATIO * OMEGA * y[1]],
        (0.0, times[-1]), [TOP, 0.0], t_eval=times, rtol=1e-9, atol=1e-14, method="DOP853",
    )  # fmt: skip
    return np.asarray(run.y[1])


def linear(rate: float, seconds: float, hz: float = HZ, ratio: float = RATIO) -> FloatArray:
    """Exponentially decaying velocity of amplitude 1 m/s."""
    t = np.arange(round(seconds * rate)) / rate
    omega = 2.0 * math.pi * hz
    return np.asarray(np.exp(-ratio * omega * t) * np.sin(omega * math.sqrt(1.0 - ratio**2) * t + 0.4))


def observations_of(samples: FloatArray, rate: float, model: Rig, **others: FloatArray) -> Observations:
    """Observations of a laser's samples, and of further channels by name: quantity letter and point."""
    channels = [LASER]
    channels += [MeasuredChannel(name, Quantity.ACCELERATION, int(name[1:])) for name in others]
    stretch = SampleStretch(0, rate, tuple(channels), np.stack([samples, *others.values()]), None, {}, math.nan)
    view = ModelView.of(model, (1,))
    return ring_down_observations(
        "decay", stretch, math.nan, view, {c.name: c for c in channels}, ObservationSettings()
    )


def values(observations: Observations, part: Part) -> FloatArray:
    return observations.values[observations.rows.part == part]


def z_scores(observations: Observations, model: Rig) -> FloatArray:
    forward = Forward(observations.tests, observations.rows)
    return np.asarray(forward.difference(observations.values, forward.predict(model).values) / observations.sigma)


def exact_frequency(velocity: FloatArray, cubic: float) -> FloatArray:
    """ω of the undamped oscillator at fundamental amplitudes of its velocity, by elliptic functions.

    x = a cn(Ωt, m), Ω² = ω₀² + k₃a², m = k₃a²/(2Ω²), of the period 4K/Ω; fundamental of cn: 2π/(√m K) √q/(1+q) with
    the nome q (Abramowitz and Stegun, 16.23.2).
    """
    a = np.geomspace(1e-4 * TOP, 2.0 * TOP, 4000)
    fast = np.sqrt(OMEGA**2 + cubic * a**2)
    m = cubic * a**2 / (2.0 * fast**2)
    nome = np.exp(-math.pi * ellipk(1.0 - m) / ellipk(m))
    omega = math.pi * fast / (2.0 * ellipk(m))
    fundamental = a * 2.0 * math.pi / (np.sqrt(m) * ellipk(m)) * np.sqrt(nome) / (1.0 + nome)
    return np.asarray(np.interp(velocity, omega * fundamental, omega))


@pytest.mark.parametrize("rate", [5000.0, 1024.0])
def test_a_decay_that_starts_at_twice_its_frequency(rate: float) -> None:
    """The last has ten samples a period at the start; the model knows the frequency at rest only."""
    cubic = 4.5 * OMEGA**2 / TOP**2
    observations = observations_of(decay(rate, 5.0, cubic), rate, rig())
    test = observations.tests[0]
    assert isinstance(test, RecordedDecay)
    assert test.amplitudes.size >= 10
    log = values(observations, Part.LOG_FREQUENCY)
    assert math.exp(log[0]) > 1.6 * OMEGA
    assert math.exp(log[-1]) == pytest.approx(OMEGA, rel=2e-4)
    assert log == pytest.approx(np.log(exact_frequency(test.amplitudes, cubic)), abs=5e-4)
    assert test.frequency_hz == pytest.approx(HZ, rel=2e-4)
    # The prediction agrees with the integrator in frequency and in damping, a third of it from the change of frequency.
    exact = {Part.LOG_FREQUENCY: 2e-4, Part.DAMPING: 2e-5}
    floor = np.array([exact.get(Part(part), 0.0) for part in observations.rows.part])
    observations = replace(observations, floor=np.hypot(observations.floor, floor))
    assert np.abs(z_scores(observations, rig(cubic))).max() < 4.0
    assert np.abs(z_scores(observations, rig())).max() > 100.0


@pytest.mark.campaign
def test_uncertainties_are_those_of_the_noise() -> None:
    rate, found = 1000.0, []
    for seed in range(25):
        noise = 3e-3 * np.random.default_rng(seed).standard_normal(4000)
        observations = observations_of(linear(rate, 4.0) + noise, rate, rig())
        found.append(
            (observations.values - Forward(observations.tests, observations.rows).predict(rig()).values)
            / observations.std
        )
    scores = np.concatenate(found)
    assert scores.size > 300
    assert 0.75 < float(np.sqrt(np.mean(scores**2))) < 1.25
    assert np.abs(scores).max() < 6.0


@pytest.mark.parametrize("per_period", [3.3, 5.0, 9.7])
def test_few_samples_a_period(per_period: float) -> None:
    rate = per_period * HZ
    observations = observations_of(linear(rate, 5.0), rate, rig())
    assert values(observations, Part.LOG_FREQUENCY) == pytest.approx(
        np.log(OMEGA * math.sqrt(1.0 - RATIO**2)), abs=1e-4
    )
    assert values(observations, Part.DAMPING) == pytest.approx(RATIO, rel=0.02)


def test_fewer_than_three_samples_a_period_are_refused_with_the_numbers() -> None:
    observations = observations_of(linear(2.5 * HZ, 5.0), 2.5 * HZ, rig())
    assert not len(observations.rows)
    assert "2.5 samples a period" in observations.notes[0]


def test_what_lies_before_the_impact_is_not_used() -> None:
    rate = 2000.0
    quiet = 1e-4 * np.random.default_rng(3).standard_normal(800)
    observations = observations_of(np.concatenate((quiet, linear(rate, 4.0))), rate, rig())
    assert observations.rows.time_s.min() > 0.4
    assert any("is used from 0.4" in note for note in observations.notes)
    assert np.abs(z_scores(observations, rig())).max() < 4.0


def test_another_mode_and_the_hammer_are_filtered_out() -> None:
    rate, t = 4000.0, np.arange(16000) / 4000.0
    ringing = 2.0 * np.exp(-300.0 * t) * np.sin(2.0 * math.pi * 1200.0 * t)
    own = linear(rate, 4.0) + 0.5 * linear(rate, 4.0, 1.7 * HZ, 0.005) + ringing
    observations = observations_of(own, rate, rig(modes=((HZ, RATIO), (1.7 * HZ, 0.005))))
    frequency = values(observations, Part.LOG_FREQUENCY)
    assert frequency.size >= 6
    assert frequency[2:] == pytest.approx(np.log(OMEGA), abs=3e-4)
    assert np.abs(z_scores(observations, rig())).max() < 5.0


def test_a_band_that_is_too_narrow_for_the_first_periods_is_not_taken() -> None:
    """A gap stiffens the largest amplitudes alone; quiet small ones must not choose the band."""
    rate, gap, stiffness = 3000.0, 0.6 * TOP, 2.3 * OMEGA**2
    times = np.arange(round(2.0 * rate)) / rate
    run = solve_ivp(
        lambda _, y: [
            y[1],
            -(OMEGA**2) * y[0] - stiffness * (y[0] - np.clip(y[0], -gap, gap)) - 2.0 * RATIO * OMEGA * y[1],
        ],
        (0.0, 2.0), [TOP, 0.0], t_eval=times, rtol=1e-9, atol=1e-13, max_step=1e-3,
    )  # fmt: skip
    velocity = run.y[1] + 2e-3 * OMEGA * TOP * np.random.default_rng(3).standard_normal(times.size)
    found = observations_of(velocity, rate, rig())
    frequencies = np.exp(values(found, Part.LOG_FREQUENCY)) / (2.0 * math.pi)
    assert frequencies.max() > 1.1 * HZ
    assert frequencies.min() == pytest.approx(HZ, rel=1e-3)


def test_a_knock_spoils_its_own_amplitudes_only() -> None:
    rate = 2000.0
    bad = linear(rate, 5.0)
    bad[4000:4200] += 0.3 * np.random.default_rng(1).standard_normal(200)
    observations = observations_of(bad, rate, rig())
    log = observations.rows.part == Part.LOG_FREQUENCY
    time, std = observations.rows.time_s[log], observations.std[log]
    near = np.abs(time - 2.05) < 0.5
    assert near.any()
    assert std[near].max() > 1e-3
    assert std[~near].max() < 1e-6
    assert np.abs(z_scores(observations, rig())).max() < 5.0


def test_several_responses_have_the_shape_of_the_mode() -> None:
    rate = 2000.0
    own = linear(rate, 4.0)
    later = linear(rate, 4.0 + 2.0 / rate)[1:-1]
    acceleration = 0.4 * (later - own)[: own.size] * rate
    observations = observations_of(own, rate, rig(), a2=0.4 * np.gradient(own) * rate)
    assert acceleration.size == own.size
    size = values(observations, Part.LOG_MAGNITUDE)
    amplitudes = observations.rows.amplitude[observations.rows.part == Part.LOG_MAGNITUDE]
    # Central differences are smaller by sin(x)/x.
    loss = np.sinc(HZ * 2.0 / rate)
    assert size == pytest.approx(np.log(0.4 * OMEGA * loss * amplitudes), abs=2e-4)
    assert values(observations, Part.PHASE) == pytest.approx(math.pi / 2.0 + RATIO, abs=1e-3)
    predicted = Forward(observations.tests, observations.rows).predict(rig()).values
    assert predicted[observations.rows.part == Part.LOG_MAGNITUDE] == pytest.approx(size - np.log(loss), abs=2e-4)
    assert predicted[observations.rows.part == Part.PHASE] == pytest.approx(values(observations, Part.PHASE), abs=1e-3)


def test_a_decay_of_no_mode_of_the_model_is_left_out_with_both_frequencies() -> None:
    observations = observations_of(linear(2000.0, 4.0, 3.0 * HZ), 2000.0, rig())
    assert not len(observations.rows)
    assert "150" in observations.notes[0]
    assert "50" in observations.notes[0]


def test_the_window_passes_a_constant_and_no_harmonic() -> None:
    cycles = np.linspace(0.0, 12.0, 2401)
    for width in (1, 2):
        assert window(np.linspace(-8.0, 8.0, 16001), width).sum() * 1e-3 == pytest.approx(1.0, abs=1e-6)
        for order in (0, 2, 3):
            signal = np.cos(2.0 * math.pi * order * cycles + 0.3)
            assert np.abs(demodulated(signal, cycles, width)).max() < 1e-4
        found = demodulated(np.cos(2.0 * math.pi * cycles + 0.3), cycles, width)
        assert found.size == middles(cycles, width).size
        assert found == pytest.approx(np.exp(0.3j), abs=1e-4)


def test_a_state_at_the_pole_of_the_linear_system_starts_one_with_a_spring() -> None:
    """The linear decay is the pole to the last bit, where transfer functions are infinite."""
    observations = observations_of(linear(2000.0, 4.0), 2000.0, rig())
    forward = Forward(observations.tests, observations.rows)
    start = forward.predict(rig())
    again = forward.predict(rig(), start)
    spring = forward.predict(rig(1e6), again)
    assert np.isfinite(spring.values).all()
    assert spring.values == pytest.approx(forward.predict(rig(1e6)).values, rel=1e-7)


def test_segments_of_the_largest_amplitudes_are_half_as_long() -> None:
    """There contacts begin and end; everywhere else equal steps of ln A suffice."""
    samples = linear(2000.0, 6.0)
    (ridge, *_) = ridges(samples - samples.mean(), 2000.0, Quantity.VELOCITY)
    found = nodes(slow_amplitude(samples, 2000.0, ridge, 1), 12, 1)
    log = np.log([node.amplitude for node in found])
    apart = -np.diff(log)
    large = log[:-1] > log[0] - 0.7
    assert large.sum() >= 2
    assert np.mean(apart[~large]) == pytest.approx(2.0 * np.mean(apart[large]), rel=0.35)
    assert max(node.omega_std / node.omega for node in found) < 1e-3


def stopped(rate: float, seconds: float, offset: float) -> FloatArray:
    """Displacement of 1 kg on a spring, let go at 1 mm, stopped by dry friction that displaces its rest by ``offset``.

    Closed form: half cosines about the displaced rests.
    """
    x = np.full(round(seconds * rate), math.nan)
    half, top, first = 0.5 / HZ, 1e-3, 0
    for k in range(x.size):
        now = k / rate - first * half
        if now >= half and abs(top) > offset:
            top, first = 2.0 * math.copysign(offset, top) - top, first + 1
            now -= half
        rest = math.copysign(offset, top)
        x[k] = rest + (top - rest) * math.cos(OMEGA * now) if abs(top) > offset else top
    return x


def test_a_decay_that_friction_stops_after_a_few_periods() -> None:
    rate, offset = 5_000.0, 3e-5
    clean = stopped(rate, 0.4, offset) + 2e-4  # the channel has an offset, too
    noisy = clean + 1e-6 * np.random.default_rng(5).standard_normal(clean.size)
    found = half_cycle_nodes(noisy, rate, 1.02 * HZ)
    assert 6 <= len(found) <= 8
    for node in found:
        assert abs(node.omega - OMEGA) < 4.0 * node.omega_std < 0.02 * OMEGA
        # Amplitude falls by 4 offsets a period, evenly.
        assert node.rate * node.amplitude == pytest.approx(4.0 * offset * HZ, abs=4.0 * node.rate_std * node.amplitude)
        assert node.rate_std < 0.05 * node.rate
    assert np.all(np.diff([node.amplitude for node in found]) < -3.0 * offset)


def test_a_viscous_decay_of_a_few_periods_has_rows_of_its_own() -> None:
    rate, ratio = 5_000.0, 0.03
    samples = linear(rate, 9.0 / HZ, ratio=ratio) + 1e-4 * np.random.default_rng(6).standard_normal(
        round(9 / HZ * rate)
    )
    observations = observations_of(samples, rate, rig())
    assert "between its turning points" in observations.notes[0]
    damping = values(observations, Part.DAMPING)
    assert damping.size >= 3
    assert damping == pytest.approx(np.full(damping.size, ratio), rel=0.03)
    short = observations_of(linear(rate, 1.9 / HZ), rate, rig())
    assert not len(short.rows)
    assert "turns" in short.notes[0]
    shorter = observations_of(linear(rate, 0.1 / HZ), rate, rig())
    assert not len(shorter.rows)
    assert "less than a period" in shorter.notes[0]


def test_hum_next_to_a_decay_is_a_line_of_its_channel_and_the_model_may_have_it() -> None:
    hertz, rate, hum = 57.0, 2048.0, 8.0
    model = rig(modes=((hertz, RATIO),))
    noise = np.random.default_rng(3).standard_normal((2, round(3.0 * rate)))
    time = np.arange(noise.shape[1]) / rate
    velocity = linear(rate, 3.0, hertz)
    acceleration = 2.0 * np.pi * hertz * 0.4 * np.roll(velocity, -round(0.25 * rate / hertz))
    acceleration[-20:] = 0.0
    humming = acceleration + 0.05 * noise[1] + hum * np.cos(2.0 * np.pi * 50.01 * time)
    observations = observations_of(velocity + 1e-4 * noise[0], rate, model, a2=humming)
    rows = observations.rows
    line = np.flatnonzero(rows.part == Part.LINE)
    assert [(int(rows.channel[k]), float(rows.frequency_hz[k])) for k in line] == [(1, 50.0)]
    assert abs(observations.values[line[0]] - hum) < 4.0 * observations.std[line[0]] < 0.1 * hum
    assert np.flatnonzero(large_lines(observations, 0.02)).tolist() == line.tolist()
    assert not large_lines(observations, 0.9).any()
    sensor = SensorSection(quantity="acceleration", point=2, hum_amplitude=hum, hum_hz=50.0)
    twin = model.model_copy(update={"sensors": [*model.sensors, sensor]})
    forward = Forward(observations.tests, rows)
    assert forward.predict(model).values[line] == [0.0]
    assert forward.predict(twin).values[line] == [hum]
