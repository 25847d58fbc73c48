"""A decay of two masses whose shape changes with the amplitude, integrated here, against the prediction."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from diagnose.predicted_tests import rows_of
from moved_threshold import moved_threshold
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.linalg import eigh

from nmt_core.messages.blocks import Quantity
from nmt_diagnose.diagnose import diagnose_observations
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_diagnose.measurements import recorded_decay as reading
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.measurements.recorded_decay import RecordedDecay
from nmt_diagnose.observations.channels.bag_samples import SampleStretch
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.prediction.forward import Forward
from nmt_rig.rig import Rig, validate_rig
from nmt_rig.rig_file import RigDocument

MASS, STIFFNESS = np.diag([1.0, 0.6]), np.array([[90_000.0, -30_000.0], [-30_000.0, 45_000.0]])
CUBIC = 4e9  # N/m³, from mass 2 to the ground
# The second mode dies at once, so that what is left is the nonlinear mode.
DAMPING = (0.006, 0.08)
SQUARES, SHAPES = eigh(STIFFNESS, MASS)
OMEGA = np.sqrt(SQUARES)
PERIODS = np.array([10, 16, 24, 34, 50])


def integrated(
    ratios: Sequence[float], speeds: Sequence[float], time: np.ndarray, cubic: float = CUBIC
) -> dict[str, np.ndarray]:
    """Displacements, velocities and accelerations of both masses after a hit that gives them speeds, m/s."""
    inverse = np.linalg.inv(MASS)
    viscous = MASS @ SHAPES @ np.diag(2.0 * np.array(ratios) * OMEGA) @ SHAPES.T @ MASS

    def change(_: float, state: np.ndarray) -> np.ndarray:
        x, v = state[:2], state[2:]
        return np.concatenate([v, -inverse @ (viscous @ v + STIFFNESS @ x + [0.0, cubic * x[1] ** 3])])

    hit, span = [0.0, 0.0, *speeds], (0.0, time[-1])
    found = solve_ivp(change, span, hit, method="DOP853", rtol=1e-10, atol=1e-13, dense_output=True)
    states = found.sol(time)
    rates = np.array([change(0.0, state) for state in states.T]).T
    return {"x1": states[0], "x2": states[1], "v1": states[2], "a1": rates[2], "a2": rates[3]}


def two_masses(ratios: Sequence[float], cubic: float = CUBIC) -> Rig:
    """The rig by its modes."""
    modes = [
        {
            "frequency_hz": float(omega) / (2 * np.pi),
            "damping_ratio": ratio,
            "modal_mass_kg": 1.0,
            "shape": [float(value) for value in shape],
        }
        for omega, ratio, shape in zip(OMEGA, ratios, SHAPES.T, strict=True)
    ]
    sensors = [
        {"quantity": quantity, "point": point} for quantity in ("displacement", "acceleration") for point in (1, 2)
    ]
    values: dict[str, object] = {
        "name": "two_masses",
        "structure": {"kind": "modal", "points": [1, 2], "modes": modes},
        "exciter": {"kind": "force", "point": 1},
        "sensors": [{"quantity": "force", "point": "drive"}, *sensors, {"quantity": "velocity", "point": 1}],
        "extraction": {"quantity": "displacement", "linear_modes": 2},
    }
    if cubic:
        values["local_elements"] = [{"kind": "cubic_spring", "point": 2, "stiffness_n_m3": cubic}]
    return validate_rig(RigDocument("test", values, {}))


@pytest.fixture(scope="module")
def motion() -> dict[str, np.ndarray]:
    """Time, and the motion after a hit in the first mode."""
    time = np.arange(0.0, 1.7, 5e-5)
    return {"time": time, **integrated(DAMPING, 0.35 * SHAPES[:, 0] / SHAPES[0, 0], time)}


@pytest.mark.parametrize("name", ["x1", "v1", "a1", "x2", "a2"])
def test_each_channel_decays_at_its_own_rate(name: str, motion: dict[str, np.ndarray]) -> None:
    """Their rates differ by up to half, since frequency and shape change; fundamentals period by period."""
    displacement = CubicSpline(motion["time"], motion["x1"])
    crossings = displacement.roots(extrapolate=False)
    ups = crossings[displacement.derivative()(crossings) > 0.0]
    middle, period = 0.5 * (ups[1:] + ups[:-1]), np.diff(ups)
    share = (np.arange(400) + 0.5) / 400
    own = CubicSpline(motion["time"], motion[name])
    turned = own(ups[:-1, None] + period[:, None] * share) * np.exp(-2j * np.pi * share)
    log, log_omega = np.log(2.0 * np.abs(turned.mean(axis=1))), np.log(2.0 * np.pi / period)
    about = [slice(k - 3, k + 4) for k in PERIODS]
    fits = [np.polyfit(middle[at] - middle[k], log[at], 2) for at, k in zip(about, PERIODS, strict=True)]
    omega = np.exp(
        [np.polyfit(middle[at] - middle[k], log_omega[at], 2)[2] for at, k in zip(about, PERIODS, strict=True)]
    )
    ratio = np.array([-fit[1] for fit in fits]) / omega
    quantity = {"x": Quantity.DISPLACEMENT, "v": Quantity.VELOCITY, "a": Quantity.ACCELERATION}[name[0]]
    channel = MeasuredChannel(name, quantity, int(name[1]))
    test = RecordedDecay("decay", 1, channel, np.exp([fit[2] for fit in fits]), float(omega[0]) / (2.0 * np.pi))
    table = [(0, k, 0, 1, part) for k in range(PERIODS.size) for part in (Part.LOG_FREQUENCY, Part.DAMPING)]
    values = Forward([test], rows_of(table)).predict(two_masses(DAMPING)).values
    np.testing.assert_allclose(np.exp(values[::2]), omega, rtol=1e-4)
    np.testing.assert_allclose(values[1::2], ratio, rtol=4e-3)


LIGHT = (0.006, 0.008)


def read(cubic: float) -> Observations:
    """What is read off the velocity of mass 1 after a hit that both modes answer, with 0.3 % of noise."""
    velocity = integrated(LIGHT, (0.35, 0.1), np.arange(0.0, 4.0, 5e-4), cubic)["v1"]
    velocity += 0.003 * np.std(velocity) * np.random.default_rng(5).standard_normal(velocity.size)
    laser = MeasuredChannel("v1", Quantity.VELOCITY, 1)
    stretch = SampleStretch(0, 2000.0, (laser,), velocity[np.newaxis], None, {}, math.nan)
    view = ModelView.of(two_masses(LIGHT, 0.0), (1,))
    return reading.ring_down_observations("tap", stretch, math.nan, view, {"v1": laser}, ObservationSettings())


def deviations(observations: Observations) -> np.ndarray:
    """From the true rig, in stated standard uncertainties, of frequency and damping at the two largest amplitudes."""
    forward = Forward(observations.tests, observations.rows)
    off = forward.difference(observations.values, forward.predict(two_masses(LIGHT)).values) / observations.sigma
    return np.asarray(off[observations.rows.level < 2])


def test_what_another_mode_shifts_is_part_of_the_uncertainty() -> None:
    """The spring sees the motion of both modes, and the model has but one of them ring."""
    observations = read(CUBIC)
    assert any("other modes ring too, with 28 %" in note for note in observations.notes)
    assert np.max(np.abs(deviations(observations))) < 2.0
    with moved_threshold("reading.decay_cross_shift", 0.0):
        assert np.max(np.abs(deviations(read(CUBIC)))) > 4.0


def test_another_mode_costs_a_linear_decay_nothing() -> None:
    sigma = read(0.0).sigma
    with moved_threshold("reading.decay_cross_shift", 0.0):
        np.testing.assert_allclose(sigma, read(0.0).sigma, rtol=0.2)


def of_two_channels(limit: float) -> Observations:
    """A linear decay of both masses; the accelerometer at mass 2 cannot say more than ``limit`` times its largest."""
    time = np.arange(0.0, 4.0, 5e-4)
    moved = integrated(LIGHT, 0.35 * SHAPES[:, 0] / SHAPES[0, 0], time, 0.0)
    chance = np.random.default_rng(7)
    rows = [moved[name] + 0.002 * np.std(moved[name]) * chance.standard_normal(time.size) for name in ("v1", "a2")]
    largest = limit * float(np.max(np.abs(moved["a2"])))
    rows[1] = np.clip(rows[1], -largest, largest)
    channels = MeasuredChannel("v1", Quantity.VELOCITY, 1), MeasuredChannel("a2", Quantity.ACCELERATION, 2)
    stretch = SampleStretch(0, 2000.0, channels, np.array(rows), None, {}, math.nan)
    view = ModelView.of(two_masses(LIGHT, 0.0), (1,))
    by_name = {channel.name: channel for channel in channels}
    return reading.ring_down_observations("tap", stretch, math.nan, view, by_name, ObservationSettings())


@pytest.mark.campaign
def test_samples_of_a_decay_that_stay_at_a_level_say_that_a_channel_is_clipped() -> None:
    """Nothing else of this decay does: the rows stand where it is smaller than the level, or within their gains."""
    model = two_masses(LIGHT, 0.0)
    clipped = of_two_channels(0.8)
    at = clipped.rows.part == Part.LIMIT
    assert [clipped.tests[0].channels[k].name for k in clipped.rows.channel[at]] == ["a2"]
    largest = float(
        np.max(np.abs(integrated(LIGHT, 0.35 * SHAPES[:, 0] / SHAPES[0, 0], np.arange(0, 4, 5e-4), 0)["a2"]))
    )
    assert 1.0 / clipped.values[at] == pytest.approx(0.8 * largest, rel=1e-3)
    found = diagnose_observations(model, clipped, DiagnosisSettings(look_ahead=False)).diagnosis
    assert found.verdict is Verdict.EFFECT
    assert (found.ranking[0].effect, found.where[0].detail) == ("clipping", "a2")
    healthy = of_two_channels(2.0)
    assert not np.any(healthy.rows.part == Part.LIMIT)
    assert not diagnose_observations(model, healthy, DiagnosisSettings(look_ahead=False)).diagnosis.verdict.gap
