"""Locked windows, random tests and ring-downs against exact solutions of the model that made them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from diagnose.observation_bags import altered, record, rig_with_noise, with_data
from numpy.typing import NDArray

from nmt_core.messages.blocks import OscillatorPhase, Quantity, SampleBlock
from nmt_core.numerics.arrays import FloatArray
from nmt_core.vocabulary import TestKind
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.locked_windows import LockedWindows, analyse_window
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.measurements.random_responses import RandomResponses
from nmt_diagnose.measurements.recorded_decay import RecordedDecay
from nmt_diagnose.observations.channels.bag_samples import SampleStretch
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.noise.scatter import moderated
from nmt_diagnose.observations.noise.settling import settling
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.observations.read_observations import read_observations
from nmt_diagnose.prediction.forward import Forward
from nmt_rig.model.linear_modes import damped_modes
from nmt_rig.rig import Rig, load_rig
from nmt_signals.local_responses import REACH, choose_bins, local_responses

LINEAR = ["local_elements=[]"]


def wrapped(values: FloatArray) -> FloatArray:
    return np.asarray((values + np.pi) % (2.0 * np.pi) - np.pi)


def linear_responses(rig: Rig, channels: tuple, frequency_hz: FloatArray) -> np.ndarray:
    """Responses to 1 V by solving the assembled equations one frequency at a time."""
    system = ModelView.of(rig, rig.exciter_points).system
    result = np.empty((len(channels), frequency_hz.size), dtype=complex)
    for index, frequency in enumerate(frequency_hz):
        s = 2j * np.pi * frequency
        motion, force = system.response(2.0 * np.pi * frequency)
        for row, channel in enumerate(channels):
            power = {Quantity.DISPLACEMENT: 0, Quantity.ACCELERATION: 2}.get(channel.quantity)
            result[row, index] = force if power is None else s**power * motion[system.points[channel.point]]
    return result


def exact_linear(observations: Observations, rig: Rig) -> FloatArray:
    """Observables of a linear rig at the measured frequency and drive; NaN where they are conditions."""
    test = observations.tests[0]
    rows = observations.rows
    exact = np.full(len(rows), np.nan)
    if isinstance(test, RandomResponses):
        frequency, drive = test.lines_hz, np.ones(test.lines_hz.size)
    else:
        assert isinstance(test, LockedWindows)
        frequency = np.array([level.frequency_hz for level in test.levels])
        drive = np.array([level.drive for level in test.levels])
    response = linear_responses(rig, test.channels, frequency) * drive
    if isinstance(test, RandomResponses):
        response = of_a_held_drive(rig, test)
    own = response[rows.channel, rows.level]
    fundamental = rows.channel >= 0
    exact[rows.part == Part.LOG_MAGNITUDE] = np.log(np.abs(own))[rows.part == Part.LOG_MAGNITUDE]
    exact[rows.part == Part.PHASE] = np.angle(own)[rows.part == Part.PHASE]
    exact[np.isin(rows.part, (Part.REAL, Part.IMAG)) & fundamental] = 0.0
    exact[rows.part == Part.PHASE_ERROR] = 0.0
    return exact


def of_a_held_drive(rig: Rig, test: RandomResponses) -> NDArray[np.complex128]:
    """Sampled responses to the samples of a drive that goes straight between them (channels, lines)."""
    rate, total = test.drive_hold_hz, np.zeros((len(test.channels), test.lines_hz.size), dtype=np.complex128)
    for order in range(-8, 9):
        place = test.lines_hz + order * rate
        values = linear_responses(rig, test.channels, np.abs(place))
        total += np.sinc(place / rate) ** 2 * np.where(place > 0.0, values, np.conj(values))
    return total


def residual(observations: Observations, exact: FloatArray) -> FloatArray:
    difference = observations.values - exact
    angles = np.isin(observations.rows.part, (Part.PHASE, Part.PHASE_ERROR))
    difference[angles] = wrapped(difference[angles])
    return difference


@pytest.fixture(scope="module")
def noisy(tmp_path_factory: pytest.TempPathFactory) -> tuple[Rig, Path]:
    rig = rig_with_noise(overrides=LINEAR, noise=10.0)
    return rig, record(tmp_path_factory.mktemp("noisy") / "run", rig, periods=60)


def test_observables_of_a_linear_rig_without_noise(tmp_path: Path) -> None:
    rig = rig_with_noise(overrides=[*LINEAR, "sample_rate_hz=10000"], noise=0.0)
    observations = read_observations([record(tmp_path / "run", rig, levels=(0.2, 0.5, 0.3))], rig)
    test = observations.tests[0]
    assert isinstance(test, LockedWindows)
    assert test.held == "voltage"
    assert (test.drive_point, test.response_channel) == (2, "x2")
    assert [level.direction for level in test.levels] == [1, 1, -1]
    # sinc² of the straight lines between samples is 1.5e-5 at this frequency.
    assert [level.drive for level in test.levels] == pytest.approx([0.2, 0.5, 0.3], rel=2e-5)
    difference = residual(observations, exact_linear(observations, rig))
    rows = observations.rows
    fundamental = np.isin(rows.part, (Part.LOG_MAGNITUDE, Part.PHASE))
    force = rows.channel == 0
    assert np.abs(difference[fundamental & ~force]).max() < 5e-5
    # Near resonance the force is the small difference of large ones: more of the lock's transient is left in it.
    assert np.abs(difference[fundamental & force]).max() < 6e-4
    others = np.isin(rows.part, (Part.REAL, Part.IMAG))
    assert np.abs(difference[others & ~force]).max() < 2e-5
    assert np.abs(difference[others & force]).max() < 2e-4
    frequency = np.exp(observations.values[rows.part == Part.LOG_FREQUENCY]) / (2.0 * np.pi)
    assert frequency == pytest.approx([level.frequency_hz for level in test.levels], rel=1e-12)


def test_phase_at_lock_and_frequency_belong_together(noisy: tuple[Rig, Path]) -> None:
    rig, bag = noisy
    observations = read_observations([bag], rig)
    test = observations.tests[0]
    assert isinstance(test, LockedWindows)
    index = [channel.name for channel in test.channels].index
    rows = (test.channels[index("f2")], test.channels[index("x2")])
    for level in test.levels:
        # The phase between force and velocity of the exact model at the measured frequency.
        force, motion = linear_responses(rig, rows, np.array([level.frequency_hz]))[:, 0]
        exact = wrapped(np.array([np.angle(force * np.conj(motion)) - 0.5 * np.pi]))[0]
        assert level.phase_error == pytest.approx(exact, abs=6.0 * level.phase_error_std + 2e-4)


@pytest.mark.campaign
def test_stated_uncertainties_are_those_of_the_residuals(tmp_path: Path) -> None:
    ratios, harmonics = [], []
    for seed in range(3):
        rig = rig_with_noise(overrides=LINEAR, noise=20.0, seed=seed)
        observations = read_observations(
            [record(tmp_path / f"run{seed}", rig, levels=(0.3, 0.6, 1.2), periods=60)], rig
        )
        z = residual(observations, exact_linear(observations, rig)) / observations.std
        rows = observations.rows
        # Force and the drive-point acceleration have transients of the lock beside so little noise: see their floor.
        motion = np.isin(rows.channel, (1, 2, 3, 4))
        ratios.append(z[np.isin(rows.part, (Part.LOG_MAGNITUDE, Part.PHASE)) & motion])
        harmonics.append(z[np.isin(rows.part, (Part.REAL, Part.IMAG))])
    for group, low, high in ((np.concatenate(ratios), 0.6, 1.3), (np.concatenate(harmonics), 0.9, 1.1)):
        assert low < np.sqrt(np.mean(group**2)) < high
        assert np.mean(np.abs(group) > 4.0) < 0.01


def test_without_recorded_phase_or_voltage_the_force_is_held(noisy: tuple[Rig, Path], tmp_path: Path) -> None:
    rig, bag = noisy

    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        if block.quantity is not Quantity.VOLTAGE:
            yield dataclasses.replace(block, oscillator=OscillatorPhase(np.nan, np.nan))

    whole = read_observations([bag], rig)
    bare = read_observations([altered(bag, tmp_path / "bare", change, run={"imported": {}})], rig)
    test = bare.tests[0]
    assert isinstance(test, LockedWindows)
    assert test.held == "force"
    names = [channel.name for channel in test.channels]
    force = bare.rows.channel == names.index("f2")
    assert not np.isin(bare.rows.part[force], (Part.LOG_MAGNITUDE, Part.PHASE)).any()
    for level, other in zip(test.levels, whole.tests[0].levels, strict=True):  # type: ignore[union-attr]
        assert level.frequency_hz == pytest.approx(other.frequency_hz, rel=1e-5)
        assert level.phase_error == pytest.approx(other.phase_error, abs=1e-3)
        assert level.force_n == pytest.approx(other.force_n, rel=1e-3)
    # Phases against the force: the difference of those against the drive.
    for level in range(len(test.levels)):

        def phase(observations: Observations, name: str, level: int = level) -> float:
            own = [c.name for c in observations.tests[0].channels].index(name)
            rows = observations.rows
            return float(
                observations.values[(rows.level == level) & (rows.channel == own) & (rows.part == Part.PHASE)][0]
            )

        assert wrapped(phase(bare, "x4") - phase(whole, "x4") + phase(whole, "f2")) == pytest.approx(0.0, abs=2e-3)


@pytest.mark.campaign
def test_with_voltage_but_without_phase_the_voltage_is_the_frame(noisy: tuple[Rig, Path], tmp_path: Path) -> None:
    rig, bag = noisy

    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        yield dataclasses.replace(block, oscillator=OscillatorPhase(np.nan, np.nan))

    whole = read_observations([bag], rig)
    blind = read_observations([altered(bag, tmp_path / "blind", change)], rig)
    test = blind.tests[0]
    assert isinstance(test, LockedWindows)
    assert test.held == "voltage"
    difference = blind.values - whole.values
    difference[blind.rows.part == Part.PHASE] = wrapped(difference[blind.rows.part == Part.PHASE])
    assert np.abs(difference / np.hypot(whole.sigma, 3e-5)).max() < 1.0


def test_second_drive_point_and_hidden_voltage_offset(noisy: tuple[Rig, Path], tmp_path: Path) -> None:
    rig, bag = noisy

    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        if block.quantity is Quantity.FORCE:
            block = dataclasses.replace(block, points=(4,), channels=("f4",))
        yield block

    test = read_observations([altered(bag, tmp_path / "moved", change)], rig).tests
    assert test[0].drive_point == 4


@pytest.mark.parametrize("noise", [1.0, pytest.param(30.0, marks=pytest.mark.campaign)])
def test_random_responses_of_a_linear_rig_are_normally_distributed(tmp_path: Path, noise: float) -> None:
    squares = []
    for seed in range(3):
        rig = rig_with_noise(overrides=LINEAR, noise=noise, seed=seed)
        bag = record(tmp_path / f"run{seed}", rig, TestKind.RANDOM, (0.1,), duration=8.0)
        observations = read_observations([bag], rig)
        noisy_rows = observations.std > 4.0 * observations.floor
        z = (residual(observations, exact_linear(observations, rig)) / observations.sigma)[noisy_rows]
        assert z.size > 400
        assert np.mean(np.abs(z) > 4.0) < 0.005
        squares.append(z**2)
    # χ² over some thousand rows: its standard deviation is below 0.05, neighbouring lines included.
    assert np.mean(np.concatenate(squares)) == pytest.approx(1.0, abs=0.1)


def resonator(u: np.ndarray, pole: complex, state: complex = 0j) -> np.ndarray:
    """Real part of a difference equation with one pole."""
    y = np.empty(u.size)
    for k in range(u.size):
        y[k] = state.real
        state = pole * state + u[k]
    return y


def exact_response(pole: complex, lines: np.ndarray, size: int) -> np.ndarray:
    """Its frequency response at lines of a Fourier transform."""
    z = np.exp(2j * np.pi * lines / size)
    return 0.5 * (1.0 / (z - pole) + 1.0 / (z - np.conj(pole)))


def test_local_fits_have_no_leakage() -> None:
    generator = np.random.default_rng(3)
    size, rate, decay, omega = 16384, 1000.0, 2.0, 2.0 * np.pi * 80.0
    u = generator.standard_normal(size)
    # Two poles, sampled, with a start that is not at rest.
    pole = np.exp((-decay + 1j * omega) / rate)
    y = resonator(u, pole, 5.0 + 3.0j)
    lines = np.array([700, 1100, 1290, 1300, 1306, 1311, 1316, 1330, 2000, 5000])
    exact = exact_response(pole, lines, size)
    found = local_responses(u, y[np.newaxis], lines)
    # The reach of ten lines is the whole half-power band here: the worst that may happen.
    near = np.abs(lines - 80.0 * size / rate) < 11
    assert near.sum() == 4
    assert found.resonant[near].all()
    assert np.abs(found.estimate[0] / exact - 1.0).max() < 1e-6
    assert found.degrees_of_freedom == 2 * (2 * REACH + 1 - 10)
    assert (found.noise[0] * found.factor < 1e-10 * np.abs(exact) ** 2).all()
    plain = local_responses(u, y[np.newaxis], lines, np.zeros(lines.size, dtype=bool))
    assert np.abs(plain.estimate[0] / exact - 1.0)[near].max() > 1e-3
    far = np.abs(lines - 80.0 * size / rate) > 200
    assert np.abs(plain.estimate[0] / exact - 1.0)[far].max() < 1e-6


def test_local_fits_take_out_what_other_references_do() -> None:
    generator = np.random.default_rng(4)
    size, rate = 16384, 1000.0
    u = generator.standard_normal((2, size))
    poles = [np.exp((-2.0 + 2j * np.pi * hertz) / rate) for hertz in (80.0, 86.0)]
    y = sum(resonator(row, pole, 3.0 + 1.0j) for row, pole in zip(u, poles, strict=True))
    lines = np.array([700, 1100, 1250, 1600, 2000, 5000])
    for first, pole in enumerate(poles):
        found = local_responses(u[[first, 1 - first]], y[np.newaxis], lines)
        assert np.abs(found.estimate[0] / exact_response(pole, lines, size) - 1.0).max() < 1e-3
        assert found.degrees_of_freedom == 2 * (2 * REACH + 1 - 15)
    alone = local_responses(u[0], y[np.newaxis], lines)
    assert np.abs(alone.estimate[0] / exact_response(poles[0], lines, size) - 1.0).max() > 0.1


def test_uncertainties_of_local_fits_cover_noise_at_a_resonance() -> None:
    generator = np.random.default_rng(5)
    size, rate = 16384, 1000.0
    pole = np.exp((-1.0 + 2j * np.pi * 80.0) / rate)
    lines = np.arange(1256, 1370, 11)
    exact = exact_response(pole, lines, size)
    squares, errors = [], []
    for _ in range(40):
        u = generator.standard_normal(size)
        y = resonator(u, pole)
        both = np.stack([y, -0.4 * y]) + np.std(y) * 1e-2 * generator.standard_normal((2, size))
        found = local_responses(u, both, lines)
        degrees = found.degrees_of_freedom
        variance = found.noise * found.factor * degrees / (degrees - 2.0) + found.resonance
        error = found.estimate / (exact * np.array([[1.0], [-0.4]])) - 1.0
        errors.append(error)
        squares.append(np.abs(error * exact * np.array([[1.0], [-0.4]])) ** 2 / variance)
    # Of a complex number over its standard deviation, by lines: off the resonance, on its flanks and at its top.
    mean = np.mean(squares, axis=(0, 1))
    assert (mean > 0.6).all()
    assert (mean < 1.5).all()
    # What noise leaves is not an offset of the estimates.
    offset = np.abs(np.mean(errors, axis=0)) / (np.std(errors, axis=0) / np.sqrt(40.0))
    assert offset.max() < 4.0


def test_noise_alone_has_no_resonance() -> None:
    generator = np.random.default_rng(6)
    u = generator.standard_normal(40_000)
    lines = np.arange(100, 19_000, 21)
    found = local_responses(u, u + generator.standard_normal((3, u.size)), lines)
    assert found.resonant.sum() <= 1
    assert np.mean(np.abs(found.estimate - 1.0) ** 2 / (found.noise * found.factor)) == pytest.approx(1.1, abs=0.15)


def test_lines_gather_where_the_phase_turns() -> None:
    generator = np.random.default_rng(4)
    u = generator.standard_normal(50_000)
    pole = np.exp((-5.0 + 2j * np.pi * 60.0) / 1000.0)
    y, state = np.empty(u.size), 0.0j
    for k in range(u.size):
        y[k] = state.real
        state = pole * state + u[k]
    lines = choose_bins(u, y, 1000.0, 120) * 1000.0 / u.size
    near = np.sum(np.abs(lines - 60.0) < 5.0) / 10.0
    away = np.sum((lines > 150.0) & (lines < 250.0)) / 100.0
    assert near > 3.0 * away
    assert np.diff(lines).min() > REACH * 1000.0 / u.size


def test_ring_down_of_a_linear_rig(tmp_path: Path) -> None:
    rig = rig_with_noise(overrides=[*LINEAR, "sample_rate_hz=10000"], noise=0.1)
    observations = read_observations([record(tmp_path / "run", rig, TestKind.RING_DOWN, (1.0,), duration=3.0)], rig)
    test = observations.tests[0]
    assert isinstance(test, RecordedDecay)
    assert test.channel.name == "x2"
    assert (np.diff(test.amplitudes) < 0.0).all()
    assert test.amplitudes.size >= 4
    value = damped_modes(ModelView.of(rig, (2,)).system).eigenvalues[0]
    frequency = observations.rows.part == Part.LOG_FREQUENCY
    damping = observations.rows.part == Part.DAMPING
    prediction = Forward(observations.tests, observations.rows).predict(rig)
    z = (observations.values - prediction.values) / observations.sigma
    assert np.abs(z).max() < 5.0
    assert (observations.rows.part == Part.PHASE).sum() >= 8
    for values in (observations.values, prediction.values):
        assert np.abs(np.exp(values[frequency][1]) / value.imag - 1.0) < 5e-4
        assert np.abs(values[damping][1] / (-value.real / value.imag) - 1.0) < 5e-3


def test_ring_down_of_friction_ends_at_the_sticking_rig(tmp_path: Path) -> None:
    rig = rig_with_noise(noise=0.1)
    observations = read_observations([record(tmp_path / "run", rig, TestKind.RING_DOWN, (4.0,), duration=3.0)], rig)
    damping = observations.values[observations.rows.part == Part.DAMPING]
    std = observations.std[observations.rows.part == Part.DAMPING]
    sticking = damped_modes(ModelView.of(rig, (2,)).system).damping_ratios[0]
    assert damping[0] > sticking + 2.0 * std[0]
    # The last node is within the noise of the channel.
    assert np.all(np.abs(damping[1:] - sticking) < np.maximum(2.5 * std[1:], 0.01 * sticking))
    assert np.count_nonzero(std < 0.01 * damping) >= 2


@pytest.mark.campaign
def test_stepped_sines_have_no_row_for_the_phase(noisy: tuple[Rig, Path], tmp_path: Path) -> None:
    rig, bag = noisy
    stepped = altered(bag, tmp_path / "st", events=lambda m: dataclasses.replace(m, test=int(TestKind.STEPPED_SINE)))
    observations = read_observations([stepped], rig)
    whole = read_observations([bag], rig)
    assert not (observations.rows.part == Part.PHASE_ERROR).any()
    np.testing.assert_array_equal(observations.values, whole.values[whole.rows.part != Part.PHASE_ERROR])


def test_sweeps_are_passed_over_with_a_sentence(noisy: tuple[Rig, Path], tmp_path: Path) -> None:
    rig, bag = noisy

    def events(message: object) -> object:
        kind = TestKind.SWEEP if message.level_index == 0 else TestKind.PHASE_RESONANCE  # type: ignore[attr-defined]
        return dataclasses.replace(message, test=int(kind))  # type: ignore[type-var]

    observations = read_observations([altered(bag, tmp_path / "sweep", events=events)], rig)
    assert any("a sweep test" in note and "not a steady state" in note for note in observations.notes)
    assert [level.index for level in observations.tests[0].levels] == [1, 2, 3]  # type: ignore[union-attr]


def test_repeats_give_the_floor(noisy: tuple[Rig, Path], tmp_path: Path) -> None:
    rig, bag = noisy

    def change(block: SampleBlock) -> Iterator[SampleBlock]:
        yield with_data(block, 1.01 * block.data) if block.quantity is Quantity.DISPLACEMENT else block

    alone = read_observations([bag], rig)
    same = read_observations([bag], rig, [altered(bag, tmp_path / "again", change)])
    rows = alone.rows
    displacement = np.isin(rows.channel, (1, 2, 3, 4)) & (rows.part == Part.LOG_MAGNITUDE)
    assert same.floor[displacement] == pytest.approx(np.log(1.01) / np.sqrt(2.0), rel=1e-2)
    np.testing.assert_array_equal(same.floor[~displacement], alone.floor[~displacement])
    assert any("repeat" in note for note in same.notes)
    assert len(same.inputs) == 2


def test_floor_bags_without_a_repeat_say_so(noisy: tuple[Rig, Path], tmp_path: Path) -> None:
    rig, bag = noisy
    other = record(tmp_path / "other", rig, TestKind.RANDOM, (0.1,), duration=2.0)
    observations = read_observations([bag], rig, [other])
    assert any("no repeat" in note for note in observations.notes)


def test_moderated_variances_of_equal_noise_are_nearly_equal() -> None:
    generator = np.random.default_rng(1)
    drawn, degrees = moderated(4.0 * generator.chisquare(9, 400) / 9.0, 9.0)
    assert np.median(drawn) == pytest.approx(4.0, rel=0.05)
    assert drawn.std() < 0.4
    assert degrees.min() > 60.0


def test_moderated_variances_of_different_noise_stay_different() -> None:
    generator = np.random.default_rng(2)
    true = np.exp(generator.normal(0.0, 2.0, 400))
    drawn, degrees = moderated(true * generator.chisquare(9, 400) / 9.0, 9.0)
    assert np.corrcoef(np.log(drawn), np.log(true))[0, 1] > 0.95
    assert degrees.max() < 12.0


def test_moderation_leaves_single_rows_alone() -> None:
    drawn, degrees = moderated(np.array([1.0, 2.0]), 9.0)
    assert drawn.tolist() == [1.0, 2.0]
    assert degrees.tolist() == [9.0, 9.0]


def test_the_shipped_rigs_make_views() -> None:
    for name, point in (("beam", 6), ("joint_resonator", 1)):
        view = ModelView.of(load_rig(name), (point,))
        exact = linear_responses(view.rig, view.channels[:-1], np.array([30.0, 400.0]))
        np.testing.assert_allclose(view.responses(view.channels[:-1], np.array([30.0, 400.0])), exact, rtol=1e-10)


def test_a_loop_that_still_settles_leans_and_a_steady_offset_does_not() -> None:
    from nmt_diagnose.measurements.locked_reading import phase_lean

    time = np.arange(10) / 10.0
    noise = 1e-5 * np.random.default_rng(3).standard_normal(10)
    settling = 1e-3 * np.exp(-0.6 * time) + noise
    assert 0.7 * settling.mean() < phase_lean(settling) < 1.6 * settling.mean()
    # The scatter of ten values lets a small drift through now and then, never the offset itself.
    assert phase_lean(1e-3 + noise) < 1e-4


@pytest.mark.parametrize(("size", "rate"), [(-0.02, 2.0), (0.01, 1.2), (-0.03, 3.0)])
def test_a_transient_is_told_from_all_responses_together(size: float, rate: float) -> None:
    """Two good channels and one that is noisier than its transient; the force has none."""
    time = (np.arange(10) + 0.5) / 10.0
    transient = size * np.exp(-rate * time)
    noise = np.random.default_rng(5).standard_normal((10, 4)) * np.array([3e-3, 1e-4, 1e-4, 2e-2])
    logs = np.outer(transient, [0, 1, 1, 1]) + noise + [2.0, 0.5, -3.0, 0.1]
    found = settling(logs, np.array([False, True, True, True]))
    assert found.leans[0] == 0.0
    np.testing.assert_allclose(found.leans[1:], transient.mean(), rtol=0.15)


def test_a_response_that_contradicts_the_others_has_a_transient_of_its_own() -> None:
    time = (np.arange(10) + 0.5) / 10.0
    sizes, noise = np.array([-0.02, -0.02, 0.01]), 1e-4 * np.random.default_rng(1).standard_normal((10, 3))
    found = settling(np.outer(np.exp(-2.0 * time), sizes) + noise, np.ones(3, dtype=bool))
    np.testing.assert_allclose(found.leans, sizes * np.exp(-2.0 * time).mean(), rtol=0.05)


def test_the_doubt_about_a_transient_covers_what_it_is_off_by() -> None:
    generator, time, inside, doubts = np.random.default_rng(11), (np.arange(10) + 0.5) / 10.0, 0, []
    for _ in range(300):
        size, rate, noise = 0.01, generator.uniform(1.0, 4.0), 10.0 ** generator.uniform(-5.0, -3.0)
        transient = size * np.exp(-rate * time)
        logs = transient[:, None] + noise * generator.standard_normal((10, 4))
        found = settling(logs, np.arange(4) > 0)
        mean = size * (1.0 - np.exp(-rate)) / rate
        inside += bool(abs(found.leans[1] - mean) <= 3.0 * found.doubt * abs(found.leans[1]))
        doubts.append(found.doubt)
    assert inside >= 291
    assert min(doubts) < 0.03
    assert max(doubts) > 0.1


def test_of_an_amplitude_that_creeps_nothing_says_where_it_would_settle() -> None:
    time = (np.arange(10) + 0.5) / 10.0
    noise = 1e-5 * np.random.default_rng(12).standard_normal((10, 3))
    found = settling(0.01 * time[:, None] + noise, np.ones(3, dtype=bool))
    assert found.leans.all()
    assert found.doubt == 1.0


def test_noise_seldom_passes_for_a_transient_and_an_exact_amplitude_never() -> None:
    generator, shown = np.random.default_rng(7), 0
    for _ in range(400):
        shown += bool(np.any(settling(1e-3 * generator.standard_normal((10, 5)), np.arange(5) > 0).leans))
    assert shown <= 12
    assert not settling(np.full((10, 2), 0.3), np.array([False, True])).leans.any()
    assert not settling(np.zeros((3, 2)), np.array([False, True])).leans.any()


def test_a_window_without_its_transient_is_that_of_the_settled_rig() -> None:
    """40 periods of a rig that still settles by half a percent, against the closed form of the settled one."""
    rate, frequency, samples = 4000.0, 50.0, 3200
    time = np.arange(samples) / rate
    cycles = frequency * time + 0.13
    sizes = np.array([0.0, -0.006, -0.006])
    harmonics = np.array([[1.0, 1e-4], [2.0, 3e-5 + 1e-5j], [5.0, 0.0]])
    settling_amplitudes = np.exp(np.outer(sizes, np.exp(-2.0 * time * rate / samples)))
    data = settling_amplitudes * (harmonics[:, :1] * np.exp(2j * np.pi * cycles)).real
    data = data + (harmonics[:, 1:] * np.exp(4j * np.pi * cycles)).real
    quantities = (Quantity.FORCE, Quantity.DISPLACEMENT, Quantity.ACCELERATION)
    channels = tuple(MeasuredChannel(f"c{k}", quantity, 1) for k, quantity in enumerate(quantities))
    stretch = SampleStretch(0, rate, channels, data, cycles, {}, math.nan)
    segment = SimpleNamespace(level_index=0, level_unit="V", level=1.0, frequency_hz=frequency)
    view = ModelView.of(load_rig("beam"), (2,))
    found = [analyse_window(segment, stretch, ObservationSettings(), view, settled) for settled in (True, False)]
    errors = [np.abs(window.amplitudes[:, 1:3] / harmonics[:, :1] - harmonics / harmonics[:, :1]) for window in found]
    assert errors[0][1, 0] > 2e-3
    assert errors[0][2, 1] > 1e-5
    assert errors[1][:, 0].max() < 1e-5
    assert errors[1][:, 1].max() < 1e-6
    # It is known to some percent; what is left of that is what the amplitudes may be off by.
    left = np.abs(found[1].leans) / np.abs(sizes * (1.0 - np.exp(-2.0)) / 2.0 + (sizes == 0.0))
    assert left[0] == 0.0
    assert np.all((left[1:] > 0.019) & (left[1:] < 0.05))
