"""A drive that is held from sample to sample, seen through channels without anti-alias filters and with them.

The witness is the sampled system in closed form: modes by matrix exponentials, the output a share of a sample after the
drive has moved on. It shares nothing with the sum over images that the diagnosis works with.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.twin_tests import noise_test, rows_of
from scipy.linalg import expm

from nmt_blind.cases.blind_rigs import blind_rig
from nmt_core.blocks import Quantity
from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.inference.chain_errors import with_chain_errors
from nmt_diagnose.inference.fit import fit
from nmt_diagnose.inference.held_images import with_detected_images
from nmt_diagnose.inference.problem import Problem
from nmt_diagnose.inference.sampling_moment import with_better_moment
from nmt_diagnose.observations.conditions import RandomTest
from nmt_diagnose.observations.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Observations, Part, Rows
from nmt_diagnose.twin.forward import Forward
from nmt_diagnose.twin.held_steps import LEAST_RISE
from nmt_rig.rig import Rig

MODEL = blind_rig("modal_beam").model()
RATE = float(MODEL.sample_rate_hz)
_POWER = {Quantity.DISPLACEMENT: 0, Quantity.VELOCITY: 1, Quantity.ACCELERATION: 2}


def _random(count: int = 80) -> tuple[RandomTest, Rows]:
    test, table = noise_test(MODEL, 30.0, 1100.0, count, window="none")
    rows = rows_of(table)
    return test, replace(rows, frequency_hz=test.lines_hz[rows.level])


def _sampled(rig: Rig, test: RandomTest, at: float) -> np.ndarray:
    """Responses (lines, channels) of the modes to samples that are held, sampled a share of a sample after a step."""
    structure = rig.structure
    points = [int(point) for point in structure.points]
    z = np.exp(2j * np.pi * test.lines_hz / RATE)
    result = np.zeros((test.lines_hz.size, len(test.channels)), dtype=complex)
    whole = int(np.floor(at))
    for mode in structure.modes:
        omega = 2.0 * np.pi * mode.frequency_hz
        shape = np.array(mode.shape) / np.sqrt(getattr(mode, "modal_mass_kg", None) or 1.0)
        drive = float(shape[points.index(test.drive_point)])
        # State (q, q', u) with u constant over a sample.
        system = np.array([[0.0, 1.0, 0.0], [-(omega**2), -2.0 * mode.damping_ratio * omega, drive], [0.0, 0.0, 0.0]])
        step, part = expm(system / RATE), expm(system * (at - whole) / RATE)
        states = np.array([
            np.append(np.linalg.solve(z_line * np.eye(2) - step[:2, :2], step[:2, 2]), 1.0) for z_line in z
        ])  # fmt: skip
        after = states @ part.T
        for column, channel in enumerate(test.channels):
            if channel.quantity in _POWER:
                seen = (after @ np.linalg.matrix_power(system, _POWER[channel.quantity]).T)[:, 0]
                result[:, column] += shape[points.index(channel.point)] * seen * z**whole
    for column, channel in enumerate(test.channels):
        if channel.quantity is Quantity.FORCE:
            result[:, column] = z**whole
    return result


def _values(responses: np.ndarray, rows: Rows) -> np.ndarray:
    own = np.log(responses[rows.level, rows.channel])
    return np.where(rows.part == Part.PHASE, own.imag, own.real)


def _off(found: np.ndarray, expected: np.ndarray) -> np.ndarray:
    return np.abs(found - expected) / np.abs(expected).max(axis=0)


@pytest.mark.parametrize("at", [0.25, 0.8, -0.3, 1.6])
def test_a_held_drive_seen_without_filters_is_the_sampled_system(at: float) -> None:
    test, rows = _random()
    held = replace(test, drive_hold_hz=RATE, sampled_at=at)
    values = Forward([held], rows).predict(MODEL).values
    found = np.zeros((test.lines_hz.size, len(test.channels)), dtype=complex)
    for part, factor in ((Part.LOG_MAGNITUDE, 1.0), (Part.PHASE, 1j)):
        mine = rows.part == part
        found[rows.level[mine], rows.channel[mine]] += factor * values[mine]
    assert _off(np.exp(found), _sampled(MODEL, test, at)).max() < 2e-3
    # Without images it is far from that.
    smooth = Forward([test], rows).predict(MODEL).values
    assert np.abs(smooth - _values(_sampled(MODEL, test, at), rows)).max() > 0.1


def test_the_delay_of_a_sensor_turns_its_images() -> None:
    """A channel that is late sees an earlier part of the held sample."""
    test, rows = _random()
    late = [
        sensor if sensor.quantity == "voltage" else sensor.model_copy(update={"delay_s": 0.2 / RATE})
        for sensor in MODEL.sensors
    ]
    moved = MODEL.model_copy(update={"sensors": late})
    found = Forward([replace(test, drive_hold_hz=RATE, sampled_at=0.7)], rows).predict(moved).values
    expected = Forward([replace(test, drive_hold_hz=RATE, sampled_at=0.5)], rows).predict(MODEL).values
    turned = (found - expected + np.pi) % (2.0 * np.pi) - np.pi
    assert np.abs(np.where(rows.part == Part.PHASE, turned, found - expected)).max() < 2e-2


def test_a_low_pass_far_above_smooths_the_step_and_nothing_else() -> None:
    """Against a filter of first order in closed form, on a force that follows the drive at once."""
    test, rows = _random()
    corner, at = 20_000.0, 0.1
    slow = [s.model_copy(update={"low_pass_hz": corner}) if s.quantity == "force" else s for s in MODEL.sensors]
    found = Forward([replace(test, drive_hold_hz=RATE, sampled_at=at)], rows).predict(
        MODEL.model_copy(update={"sensors": slow})
    )
    force = next(k for k, channel in enumerate(test.channels) if channel.quantity is Quantity.FORCE)
    mine = (rows.channel == force) & (rows.part == Part.LOG_MAGNITUDE)
    z = np.exp(2j * np.pi * test.lines_hz / RATE)
    # State of the filter at the samples, and a tenth of one later.
    whole, part = np.exp(-2.0 * np.pi * corner / RATE), np.exp(-2.0 * np.pi * corner * at / RATE)
    expected = part * (1.0 - whole) / (z - whole) + 1.0 - part
    np.testing.assert_allclose(np.exp(found.values[mine]), np.abs(expected)[rows.level[mine]], rtol=2e-4)
    assert np.ptp(np.abs(expected)) > 0.02


def _observations(responses: np.ndarray, test: RandomTest, rows: Rows, seed: int, noise: float = 2e-3) -> Observations:
    values = _values(responses, rows) + noise * np.random.default_rng(seed).standard_normal(len(rows))
    full = np.full(len(rows), noise)
    return Observations((test,), rows, values, full, 0.0 * full, chains=(MeasuringChain(hold_hz=RATE),))


def _off_by(factor: float) -> Rig:
    """The model with frequencies a little off, as after a first re-fit."""
    modes = [
        mode.model_copy(update={"frequency_hz": mode.frequency_hz * (1.0 + factor * sign)})
        for mode, sign in zip(MODEL.structure.modes, (1.0, -1.0, 0.5), strict=True)
    ]
    return MODEL.model_copy(update={"structure": MODEL.structure.model_copy(update={"modes": modes})})


@pytest.mark.parametrize("at", [0.25, -0.2])
def test_images_that_are_there_are_found_and_when_the_channels_are_sampled(at: float) -> None:
    test, rows = _random()
    found = with_detected_images(_observations(_sampled(MODEL, test, at), test, rows, 1), _off_by(2e-4))
    assert len(found) == 1
    (seen,) = found[0].tests
    assert isinstance(seen, RandomTest)
    assert seen.sampled_at == pytest.approx(at, abs=0.08)
    assert seen.drive_hold_hz == RATE
    assert not found[0].chains[0].images


def test_kinds_of_sensors_that_are_late_by_different_times_have_moments_of_their_own() -> None:
    """A force cell 0.4 of a held sample behind the accelerometers sees the step before."""
    test, rows = _random()
    force = np.array([channel.quantity is Quantity.FORCE for channel in test.channels])
    both = np.where(force, _sampled(MODEL, test, -0.2), _sampled(MODEL, test, 0.2))
    observations = _observations(both, test, rows, 1)
    (found,) = with_detected_images(observations, _off_by(2e-4))
    (seen,) = found.tests
    assert isinstance(seen, RandomTest)
    assert seen.sampled_at is not None
    moments = seen.sampled_at + RATE * np.array(seen.late_s)
    np.testing.assert_allclose(moments[~force], 0.2, atol=0.04)
    # A force that follows the drive at once is the same throughout the sample.
    assert np.all((moments[force] > -1.0) & (moments[force] < 0.0))
    left = []
    for own in (seen, replace(seen, sampled_at=0.2, late_s=())):
        forward = Forward((own,), rows)
        difference = forward.difference(observations.values, forward.predict(MODEL).values)
        left.append(float(np.sqrt(np.mean(difference[rows.channel == np.flatnonzero(force)[0]] ** 2))))
    assert left[0] < 2.0 * 2e-3
    assert left[1] > 20.0 * left[0]


def test_filters_that_keep_images_out_are_found() -> None:
    test, rows = _random()
    values = Forward([test], rows).predict(MODEL).values
    late = 1e-4 * 2.0 * np.pi * rows.frequency_hz * (rows.part == Part.PHASE)
    gain = 0.01 * (rows.part == Part.LOG_MAGNITUDE) * (rows.channel == 1)
    noise = 2e-3 * np.random.default_rng(2).standard_normal(len(rows))
    full = np.full(len(rows), 2e-3)
    chains = (MeasuringChain(hold_hz=RATE),)
    observations = Observations((test,), rows, values - late + gain + noise, full, 0.0 * full, chains=chains)
    found = with_detected_images(observations, _off_by(2e-4))
    assert len(found) == 1
    assert found[0].tests == observations.tests
    assert not found[0].chains[0].images


def test_where_images_hardly_matter_nothing_is_decided() -> None:
    test, rows = _random()
    noisy = _observations(_sampled(MODEL, test, 0.25), test, rows, 3, noise=2e-2)
    assert with_detected_images(noisy, MODEL) == ()
    assert with_detected_images(replace(noisy, chains=(None,)), MODEL) == ()


@pytest.mark.parametrize("turn", [1.0, 1j])
def test_a_share_of_the_images_that_a_channel_is_off_by_is_one_error(turn: complex) -> None:
    """Two percent of the images, the same at all lines of a channel, beside the same with a sign of each line's own."""
    test, rows = _random()
    (seen,) = with_detected_images(_observations(_sampled(MODEL, test, 0.25), test, rows, 1), MODEL)
    forward = Forward(seen.tests, seen.rows)
    base = forward.predict(MODEL)
    smooth = Forward((replace(seen.tests[0], sampled_at=None, drive_hold_hz=np.inf),), seen.rows).predict(MODEL)
    change = forward.difference(smooth.values, base.values)
    # The held tone itself is smaller and later than that of the samples, without any image.
    share, at = rows.frequency_hz / RATE, seen.tests[0].sampled_at
    change += np.where(rows.part == Part.PHASE, np.pi * share * (2.0 * at - 1.0), np.log(np.sinc(share)))
    images = np.zeros((test.lines_hz.size, len(test.channels)), dtype=complex)
    for part, factor in ((Part.LOG_MAGNITUDE, 1.0), (Part.PHASE, 1j)):
        mine = rows.part == part
        images[rows.level[mine], rows.channel[mine]] += factor * change[mine]
    own = 0.02 * turn * images[rows.level, rows.channel] * (rows.channel == 2)
    error = np.where(rows.part == Part.PHASE, own.imag, own.real)
    problem = with_chain_errors(Problem(seen, forward), MODEL, base)
    alternating = np.where(rows.level % 2, error, -error)
    sizes = [float(problem.whitened(each) @ problem.whitened(each)) for each in (error, alternating)]
    assert sizes[0] < 5.0
    assert sizes[1] > 5.0 * sizes[0]


@pytest.mark.parametrize("at", [0.005, -0.005])
def test_channels_sampled_just_beside_the_step_are_on_the_right_side_of_it(at: float) -> None:
    test, rows = _random()
    (found,) = with_detected_images(_observations(_sampled(MODEL, test, at), test, rows, 4), _off_by(2e-4))
    (seen,) = found.tests
    assert isinstance(seen, RandomTest)
    assert 0.0 < (seen.sampled_at or 0.0) * np.sign(at) < 0.06


def test_what_half_a_step_would_explain_leaves_it_open() -> None:
    """Between its two sides a channel never is: a mass or a filter that the model lacks looks the same."""
    test, rows = _random()
    middle = 0.5 * (_sampled(MODEL, test, 0.0) + _sampled(MODEL, test, -1e-9))
    options = with_detected_images(_observations(middle, test, rows, 6), _off_by(2e-4))
    assert len(options) == 2
    held, plain = (option.tests[0] for option in options)
    assert isinstance(held, RandomTest)
    assert abs(held.sampled_at or 0.0) < 0.03
    assert plain == test


@pytest.mark.parametrize("start", [0.17, 0.36])
def test_the_moment_of_sampling_is_what_leaves_least_of_all_lines(start: float) -> None:
    test, rows = _random()
    test = replace(test, drive_hold_hz=RATE, sampled_at=start)
    seen = _observations(_sampled(MODEL, test, 0.25), test, rows, 5)
    seen = replace(seen, chains=(replace(seen.chains[0], images=False),))
    last, _ = _settled(seen, rows, 3)
    assert last.sampled_at == pytest.approx(0.25, abs=0.025)


def _settled(seen: Observations, rows: Rows, most: int) -> tuple[RandomTest, float]:
    """The test at the moments that leave least, and rms of what they leave."""
    for _ in range(most):
        forward = Forward(seen.tests, rows)
        base = forward.predict(MODEL)
        problem = with_chain_errors(Problem(seen, forward), MODEL, base)
        own = Parametrisation(MODEL, calibration_parameters(MODEL))
        found = fit(problem, own, np.zeros(own.size), np.isfinite(base.values), base)
        moved = with_better_moment(problem, found)
        if moved is None:
            break
        seen = moved
    assert moved is None
    (last,) = seen.tests
    assert isinstance(last, RandomTest)
    return last, float(np.sqrt(np.mean(found.residual[found.used] ** 2)))


@pytest.mark.parametrize("passed", [0.2, 0.5, 0.9])
def test_within_the_rise_a_channel_sees_a_part_of_the_step(passed: float) -> None:
    test, rows = _random()
    held = replace(test, drive_hold_hz=RATE, sampled_at=LEAST_RISE * (passed - 0.5))
    values = Forward([held], rows).predict(MODEL).values
    sides = [_sampled(MODEL, test, side * LEAST_RISE) for side in (-0.5, 0.5)]
    expected = _values((1.0 - passed) * sides[0] + passed * sides[1], rows)
    apart = np.abs(
        np.exp(values * np.where(rows.part == Part.PHASE, 1j, 1.0))
        - np.exp(expected * np.where(rows.part == Part.PHASE, 1j, 1.0))
    )
    assert np.quantile(apart, 0.9) < 0.01


def test_a_channel_that_sees_a_part_of_the_step_is_found() -> None:
    """One acceleration is sampled while the drive moves on, microseconds beside the others of its kind."""
    test, rows = _random()
    before, after = (_sampled(MODEL, test, at) for at in (-0.005, 0.005))
    channel = next(k for k, own in enumerate(test.channels) if own.quantity is Quantity.ACCELERATION)
    after[:, channel] = 0.7 * before[:, channel] + 0.3 * after[:, channel]
    seen = _observations(after, test, rows, 7)
    seen = replace(
        seen,
        tests=(replace(test, drive_hold_hz=RATE, sampled_at=0.02),),
        chains=(replace(seen.chains[0], images=False),),
    )
    last, left = _settled(seen, rows, 8)
    moments = (last.sampled_at or 0.0) + RATE * np.array(last.late_s or (0.0,) * len(test.channels))
    assert abs(moments[channel]) < 0.5 * LEAST_RISE
    assert np.all(np.delete(moments, channel) > 0.0)
    assert left < 1.2
