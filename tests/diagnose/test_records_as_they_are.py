"""Records as they are: with a bias, begun in mid-motion, driven by an input that was measured with noise."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from diagnose.oscillator_records import OMEGA, RATE, RATIO, RIG, band_noise, imported, rig_in
from scipy.signal import TransferFunction, lsim
from tiers import with_quick

from nmt_core.messages.blocks import Quantity, SampleBlock
from nmt_core.messages.wire import BlockWriter
from nmt_core.numerics.arrays import FloatArray
from nmt_core.tolerances import TOLERANCES
from nmt_diagnose.chain.chain_columns import record_errors
from nmt_diagnose.diagnose import diagnose_bags
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.fit.low_level_modes import LowLevelModes
from nmt_diagnose.fit.model_alone import free_parameters, model_alone
from nmt_diagnose.ledger.diagnosis import Diagnosis, Verdict
from nmt_diagnose.measurements.driven_record import DrivenRecord, RecordPredictor, head_of, starts_in_motion
from nmt_diagnose.observations.noise.input_noise import (
    InputNoise,
    input_noise,
    noise_lines,
    noise_part,
    propagated_noise,
)
from nmt_diagnose.observations.read_observations import read_observations
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.prediction.parts_cache import PartsCache
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_record.bag.bag_writer import BagWriter
from nmt_record.bag.bench_topics import SAMPLE_BLOCK
from nmt_rig.rig import Rig, load_rig

FINER = 8
CUBIC = 4.0 * OMEGA**2  # N/m³ of a stiffness of OMEGA² N/m, at displacements of some 0.1 m


def fine(samples: FloatArray) -> FloatArray:
    """A periodic signal at FINER times its rate."""
    return np.fft.irfft(np.fft.rfft(samples), FINER * samples.size) * FINER


def linear_response(volts: FloatArray, start: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
    time_s = np.arange(FINER * volts.size) / (FINER * RATE)
    system = TransferFunction([OMEGA**2], [1.0, 2.0 * RATIO * OMEGA, OMEGA**2]).to_ss()
    # In controllable form the states are velocity and displacement over the gain.
    first = np.array([start[1], start[0]]) / OMEGA**2
    return np.asarray(lsim(system, fine(volts), time_s, first)[1][::FINER])


def cubic_response(volts: FloatArray, start: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
    """Displacement by the method of Runge and Kutta of order four, two fine samples a step."""
    force, step = OMEGA**2 * fine(volts), 2.0 / (FINER * RATE)
    force = np.append(force, force[0])

    def slope(x: float, v: float, f: float) -> tuple[float, float]:
        return v, f - 2.0 * RATIO * OMEGA * v - OMEGA**2 * x - CUBIC * x**3

    x, v = start
    found = np.empty(force.size // 2)
    for n in range(found.size):
        found[n] = x
        early, middle, late = (float(value) for value in force[2 * n : 2 * n + 3])
        a = slope(x, v, early)
        b = slope(x + 0.5 * step * a[0], v + 0.5 * step * a[1], middle)
        c = slope(x + 0.5 * step * b[0], v + 0.5 * step * b[1], middle)
        d = slope(x + step * c[0], v + step * c[1], late)
        x += step / 6.0 * (a[0] + 2.0 * b[0] + 2.0 * c[0] + d[0])
        v += step / 6.0 * (a[1] + 2.0 * b[1] + 2.0 * c[1] + d[1])
    return found[:: FINER // 2]


def with_cubic(folder: Path) -> Rig:
    text = RIG + f"local_elements:\n  - {{name: k3, kind: cubic_spring, point: 1, stiffness_n_m3: {CUBIC!r}}}\n"
    (folder / "cubic.yaml").write_text(text, encoding="utf-8")
    return load_rig(folder / "cubic.yaml")


def diagnosed(rig: Rig, bag: Path) -> Diagnosis:
    return diagnose_bags(rig, [bag], settings=DiagnosisSettings(look_ahead=False)).diagnosis


def bridged(folder: Path, volts: FloatArray, motion: FloatArray) -> Path:
    """Bag of force and displacement as bridge and recorder write it: blocks, and no run."""
    writer = BagWriter(folder / "bridged")
    for quantity, name, data in ((Quantity.FORCE, "f1", OMEGA**2 * volts), (Quantity.DISPLACEMENT, "x1", motion)):
        writer.add_topic(quantity.topic, SAMPLE_BLOCK)
        codec = BlockWriter("bridge")
        for first in range(0, volts.size, 128):
            rows = data[None, first : first + 128]
            block = SampleBlock(first, RATE, quantity, quantity.unit, (name,), (1,), rows)
            writer.write(quantity.topic, codec.write(block), first, first)
    writer.close()
    return folder / "bridged"


def test_a_bridged_bag_goes_to_the_diagnosis_as_it_is(tmp_path: Path) -> None:
    rig, volts = rig_in(tmp_path), band_noise(4096, 3, 0.05)
    bag = bridged(tmp_path, volts, linear_response(volts))
    assert [type(test) for test in read_observations([bag], rig).tests] == [DrivenRecord]
    assert left(rig, bag) < 2e-3


def left(rig: Rig, bag: Path) -> float:
    """What a rig leaves of the samples of a record over their rms, zeros taken out."""
    observations = read_observations([bag], rig)
    (test,) = observations.tests
    assert isinstance(test, DrivenRecord)
    settings = PredictionSettings()
    difference = observations.values - RecordPredictor(test, observations.rows, settings).values(
        rig, PartsCache(settings)
    )
    return float(np.std(difference) / np.std(observations.values))


def test_the_zero_of_a_sensor_is_an_error_of_the_record(tmp_path: Path) -> None:
    rig, rng = rig_in(tmp_path), np.random.default_rng(1)
    volts = band_noise(8192, 1, 0.02)
    y = linear_response(volts) + 1e-4 * rng.standard_normal(volts.size)
    volts_zero, y_zero = 0.07 * np.abs(volts).max(), 0.05
    bag = imported(tmp_path, volts + volts_zero, y + y_zero, [(0, volts.size)])
    test = read_observations([bag], rig).tests[0]
    assert isinstance(test, DrivenRecord)
    assert np.mean(test.input) == pytest.approx(np.mean(volts) + volts_zero, rel=1e-3)
    assert test.zeros[0] == pytest.approx(0.1 * np.abs(volts + volts_zero).max(), rel=1e-3)
    assert test.zeros[1] == pytest.approx(math.hypot(0.1 * np.abs(y + y_zero).max(), np.mean(y + y_zero)), rel=1e-3)
    found = diagnosed(rig, bag)
    assert found.verdict in (Verdict.NONE, Verdict.CALIBRATION), found.verdict


def test_the_gain_of_a_channel_is_one_error_of_all_records(tmp_path: Path) -> None:
    """A sensor that shows too much: more of its own channel, and of the drive less response to what it shows."""
    rig = rig_in(tmp_path)
    volts = band_noise(4096, 1, 0.02)
    bag = imported(tmp_path, volts, linear_response(volts), [(0, 2048), (2048, 4096)])
    observations = read_observations([bag], rig)
    errors = record_errors(observations, rig)
    response = Forward(observations.tests, observations.rows).predict(rig).values
    gains = [name for name in errors if name.startswith("gain ")]
    drive = f"gain {observations.tests[0].record.input_channel.name}"  # type: ignore[union-attr]
    assert len(gains) == 2
    assert drive in gains
    for name in gains:
        sign = -1.0 if name == drive else 1.0
        assert errors[name] == pytest.approx(sign * TOLERANCES.gain * response, abs=1e-4 * np.abs(response).max())


def test_the_delay_of_a_channel_is_one_error_of_all_records(tmp_path: Path) -> None:
    """Of a standard deviation the error changes the samples as the same delay of the sensor does."""
    rig = rig_in(tmp_path)
    volts = band_noise(4096, 1, 0.02)
    bag = imported(tmp_path, volts, linear_response(volts), [(0, 2048), (2048, 4096)])
    observations = read_observations([bag], rig)
    errors = record_errors(observations, rig)
    (name,) = (name for name in errors if name.startswith("delay "))
    forward = Forward(observations.tests, observations.rows)
    late = [s.model_copy(update={"delay_s": s.delay_s + TOLERANCES.delay_s}) for s in rig.sensors]
    moved = forward.predict(rig.model_copy(update={"sensors": late})).values - forward.predict(rig).values
    for number in range(2):
        of_record = observations.rows.test == number
        assert errors[name][of_record] == pytest.approx(moved[of_record], abs=0.01 * np.abs(moved[of_record]).max())


def test_the_zero_of_a_sensor_is_one_for_quiet_and_loud_records(tmp_path: Path) -> None:
    """A cubic spring tells the zero of the voltage from that of the response: it moves the working point."""
    count, zero = 2048, 0.025
    volts = np.concatenate([band_noise(count, 1, 0.005), band_noise(count, 2, 0.08)])
    y = np.concatenate([cubic_response(volts[:count]), cubic_response(volts[count:])])
    y = y + 1e-3 * np.random.default_rng(4).standard_normal(y.size)
    bag = imported(tmp_path, volts + zero, y, [(0, count), (count, 2 * count)])
    rig = with_cubic(tmp_path)
    observations = read_observations([bag], rig)
    quiet, loud = observations.tests
    assert isinstance(quiet, DrivenRecord)
    assert isinstance(loud, DrivenRecord)
    assert zero > 4.0 * quiet.zeros[0]
    assert zero < loud.zeros[0]
    everything = np.ones(len(observations.rows), dtype=bool)
    modes = LowLevelModes(observations, rig)
    _, _, null, data = model_alone(rig, observations, free_parameters(rig, observations), everything, modes)
    errors = dict(zip(data.chain_names, null.fit.errors.chain, strict=True))
    for test in (quiet, loud):
        own = errors.get(f"zero of u in {test.name}", 0.0) * test.zeros[0]
        assert errors["zero of u"] * loud.zeros[0] + own == pytest.approx(-zero, rel=0.2)
    assert max(map(abs, errors.values())) < 2.0


@pytest.mark.parametrize("start", [(0.0, 0.0), (0.08, -25.0)])
def test_a_bias_moves_the_working_point_of_a_cubic_spring(tmp_path: Path, start: tuple[float, float]) -> None:
    """Against the equation of motion integrated step by step; without its mean the same record is 5 % off."""
    volts = band_noise(4096, 3, 0.06) + 0.05
    y = cubic_response(volts, start)
    bag = imported(tmp_path, volts, y, [(0, volts.size)])
    assert left(with_cubic(tmp_path), bag) < 6e-3
    # So much the bias does, and so much the spring.
    without = cubic_response(volts - 0.05, start)
    assert np.std(without - y) > 0.05 * np.std(y)
    assert left(rig_in(tmp_path), bag) > 0.05


@pytest.mark.parametrize("first", with_quick([0, 2500], 2500))
def test_a_record_cut_in_mid_motion_lacks_nothing(tmp_path: Path, first: int) -> None:
    rig, rng = rig_in(tmp_path), np.random.default_rng(2)
    volts = band_noise(8192, 5, 0.02)
    # Hit 1 ms before the cut, and lightly damped enough to ring into what is compared.
    y = linear_response(volts, (0.3, 0.0) if first == 0 else (0.0, 0.0))
    y = y + 1e-4 * rng.standard_normal(volts.size)
    bag = imported(tmp_path, volts, y, [(first, volts.size)])
    test = read_observations([bag], rig).tests[0]
    assert isinstance(test, DrivenRecord)
    assert test.begins_in_motion
    assert left(rig, bag) < 0.02
    found = diagnosed(rig, bag)
    assert found.verdict in (Verdict.NONE, Verdict.CALIBRATION), found.verdict


def test_noise_of_the_measured_input_is_noise_of_the_response(tmp_path: Path) -> None:
    rig, rng = rig_in(tmp_path), np.random.default_rng(4)
    volts = band_noise(16384, 7, 0.02)
    y = linear_response(volts) + 1e-7 * rng.standard_normal(volts.size)
    bag = imported(tmp_path, volts + 8e-4 * rng.standard_normal(volts.size), y, [(0, volts.size)])
    found = diagnosed(rig, bag)
    assert found.verdict in (Verdict.NONE, Verdict.CALIBRATION), found.verdict


@pytest.mark.parametrize("broad", with_quick([False, True], True))
def test_noise_of_the_input_comes_through_a_sharp_resonance(broad: bool) -> None:
    """White noise of density S gives σ² = S ω/(8 ζ)·|H(0)|² behind an oscillator (Crandall), S per Hz and one-sided."""
    rng = np.random.default_rng(6)
    ratio, noise, omega = 0.001, 1e-3, 2.0 * math.pi * 30.0
    density = 2.0 * noise**2 / RATE
    lines = noise_lines([30.0], RATE, 1e4)
    assert np.sum((lines > 30.03) & (lines < 30.3)) == pytest.approx(18, abs=1)
    response = 1.0 / (1.0 - (2 * np.pi * lines / omega) ** 2 + 2j * ratio * 2 * np.pi * lines / omega)
    known = InputNoise(density, RATE, np.full((1, 1), np.inf))
    expected = math.sqrt(density * omega / (8.0 * ratio))
    assert propagated_noise(known, response[None], lines)[0] == pytest.approx(expected, rel=0.01)
    volts = rng.standard_normal(20_000) if broad else band_noise(20_000, 8, 0.02)
    volts *= 0.02 / volts.std()
    y = linear_response(volts)
    found = input_noise(volts + noise * rng.standard_normal(volts.size), y[None], RATE)
    assert found.density == pytest.approx(density, rel=0.5)
    assert input_noise(volts, y[None], RATE).density < 0.05 * density


def test_noise_that_is_not_in_the_response_is_none() -> None:
    """A resonance of the model where nothing is incoherent in the response shows that the input has no such noise."""
    lines = noise_lines([30.0], RATE, 30.0)
    response = 1.0 / (1.0 - (lines / 30.0) ** 2 + 2e-6j * lines / 30.0)
    spectrum = np.full((1, 65), 1e-12)
    spectrum[0, 20:] = 1.0
    found = propagated_noise(InputNoise(1e-3, RATE / 128, spectrum), response[None], lines)
    assert found[0] < 2.0 * math.sqrt(1e-12 * 5 * RATE / 128)


def test_noise_beside_a_tap_never_drove_the_structure(tmp_path: Path) -> None:
    """What a noisy input adds to the prediction is known where and when the input is nothing else: after a tap."""
    rig, rng, count = rig_in(tmp_path), np.random.default_rng(12), 8192
    noise = 2e-4 * rng.standard_normal(count)
    volts = np.where(np.arange(count) < count // 8, band_noise(count, 4, 0.02), 0.0)
    bag = imported(tmp_path, volts + noise, linear_response(volts), [(0, count)])
    observations = read_observations([bag], rig)
    (test,) = observations.tests
    assert isinstance(test, DrivenRecord)
    own = np.interp(np.arange(test.noise.size) * RATE / test.sample_rate, np.arange(count), noise)
    assert np.corrcoef(own, test.noise)[0, 1] > 0.8
    (name,) = (found for found in record_errors(observations, rig) if found.startswith("noise of "))
    column = record_errors(observations, rig)[name]
    apart = observations.values - Forward(observations.tests, observations.rows).predict(rig).values
    assert np.std(apart - column) < 0.5 * np.std(apart)


def test_noise_is_no_more_than_its_density() -> None:
    rng = np.random.default_rng(13)
    noise = rng.standard_normal(20_000)
    density = 2.0 / RATE
    assert np.var(noise_part(noise, density, RATE)) == pytest.approx(1.0, abs=0.05)
    loud = noise + 30.0 * np.sin(0.3 * np.arange(noise.size))
    assert abs(np.corrcoef(noise_part(loud, density, RATE), loud - noise)[0, 1]) < 0.02
    assert not noise_part(noise, 0.0, RATE).any()


def test_a_short_record_tells_no_noise_of_its_input() -> None:
    rng = np.random.default_rng(9)
    for samples, known in ((280, False), (300, True)):
        source, response = rng.standard_normal((2, samples))
        assert (input_noise(source, response[None], 100.0).density > 0.0) is known


def test_the_begin_of_a_record_is_two_periods() -> None:
    rate, hertz = 1000.0, 5.0
    time_s = np.arange(8000) / rate
    sine = np.sin(2.0 * math.pi * hertz * time_s)[None]
    assert head_of(sine, rate) == pytest.approx(2.0 * rate / hertz, rel=0.03)
    assert head_of(np.sin(2.0 * math.pi * 400.0 * time_s)[None], rate) == 24
    head = head_of(sine, rate)
    assert starts_in_motion(np.cos(2.0 * math.pi * hertz * time_s)[None], head)
    for share, moves in ((0.09, False), (0.11, True)):
        # A step of noise before the motion.
        begun = np.where(time_s < 0.1, share * np.std(sine) * np.sign(np.sin(2e3 * math.pi / 2.0 * time_s + 1.0)), sine)
        assert starts_in_motion(begun, head) is moves
