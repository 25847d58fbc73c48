"""A drive that is held from sample to sample: its delay and its images in channels without filters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.predicted_observations import observations_of_model, real
from diagnose.predicted_tests import chain, noise_test
from numpy.typing import NDArray
from scipy.signal import cont2discrete

from nmt_core.messages.blocks import Quantity
from nmt_diagnose.chain.chain_columns import linear_chain
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.measurements.random_responses import held_responses
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.rig_parts import rig_parts
from nmt_rig.model.fourier_basis import FourierBasis

MODEL = real(
    chain(), local_elements=[{"kind": "jenkins", "point": 1, "tangential_stiffness_n_m": 3e3, "slip_force_n": 0.05}]
)
RATE_HZ = 2000.0


def harmonics(observations: Observations, level: int, channel: int) -> dict[int, NDArray[np.intp]]:
    """Rows of real and imaginary part by order."""
    rows = observations.rows
    here = (rows.test == 0) & (rows.level == level) & (rows.channel == channel)
    orders = np.unique(rows.harmonic[here & (rows.part == Part.IMAG)])
    return {
        int(k): np.array(
            [np.flatnonzero(here & (rows.harmonic == k) & (rows.part == p))[0] for p in (Part.REAL, Part.IMAG)]
        )
        for k in orders
    }


def late(observations: Observations, seconds: float) -> Observations:
    """The recordings of a rig that is driven later than its voltage says, by the shift of the signals themselves."""
    values, rows = observations.values.copy(), observations.rows
    phase = rows.part == Part.PHASE
    values[phase] -= 2.0 * np.pi * rows.frequency_hz[phase] * seconds
    samples = np.arange(64) / 64.0
    for level in np.unique(rows.level[rows.test == 0]):
        for channel in np.unique(rows.channel[(rows.test == 0) & (rows.channel >= 0)]):
            for order, pair in harmonics(observations, level, channel).items():
                turns = rows.frequency_hz[pair[0]] * seconds
                signal = (values[pair] @ [1.0, 1j] * np.exp(2j * np.pi * order * (samples - turns))).real
                shifted = 2.0 / 64 * signal @ np.exp(-2j * np.pi * order * samples)
                values[pair] = shifted.real, shifted.imag
    return replace(observations, values=values)


def with_image(observations: Observations, channel: int, image: complex) -> Observations:
    """The recordings with an image on the fundamental of a channel, the same per volt and frequency at all levels."""
    values, rows = observations.values.copy(), observations.rows
    for level in np.unique(rows.level[rows.test == 0]):
        here = (rows.test == 0) & (rows.level == level) & (rows.channel == channel)
        size, angle = (np.flatnonzero(here & (rows.part == p))[0] for p in (Part.LOG_MAGNITUDE, Part.PHASE))
        true = np.exp(values[size] + 1j * values[angle])
        recorded = true + image * rows.amplitude[size] * rows.frequency_hz[size] / RATE_HZ
        values[size], values[angle] = np.log(np.abs(recorded)), np.angle(recorded)
        for pair in harmonics(observations, level, channel).values():
            values[pair] *= np.abs(true) / np.abs(recorded)
    return replace(observations, values=values)


def test_a_drive_that_is_held_turns_a_harmonic_by_its_order() -> None:
    recorded = observations_of_model(MODEL, noise=0.0, random=False)
    recorded = replace(recorded, chains=(MeasuringChain(hold_hz=RATE_HZ),))
    near = Forward(recorded.tests, recorded.rows).predict(MODEL)
    found = linear_chain(recorded, MODEL, near)
    column = found.columns[:, found.names.index("hold of the recorded drive")]
    moved = late(recorded, 0.5 / RATE_HZ).values - recorded.values
    turned = np.isin(recorded.rows.part, (Part.REAL, Part.IMAG)) & (recorded.rows.harmonic > 1)
    assert np.max(np.abs(moved[turned])) > 20.0 * recorded.std[turned][0]
    assert column[turned] == pytest.approx(moved[turned], abs=0.05 * np.max(np.abs(moved[turned])))


def test_images_change_what_harmonics_are_stated_over() -> None:
    channel = 2
    recorded = observations_of_model(MODEL, noise=0.0, random=False)
    recorded = replace(recorded, chains=(MeasuringChain(hold_hz=RATE_HZ),))
    rows = recorded.rows
    found = linear_chain(recorded, MODEL, Forward(recorded.tests, rows).predict(MODEL))
    name = recorded.tests[0].channels[channel].name
    constant = [found.columns[:, found.names.index(f"image 4 {part} {name} in levels")] for part in ("re", "im")]
    fundamental = (rows.channel == channel) & (rows.part == Part.LOG_MAGNITUDE)
    smallest = float(np.min(np.exp(recorded.values[fundamental]) / rows.amplitude[fundamental]))
    angle = recorded.values[(rows.channel == channel) & (rows.part == Part.PHASE)][0] + 0.6
    image = 0.01 * smallest * RATE_HZ / rows.frequency_hz[0] * np.exp(1j * angle)
    moved = with_image(recorded, channel, image).values - recorded.values
    stated = (rows.channel == channel) & np.isin(rows.part, (Part.LOG_MAGNITUDE, Part.PHASE))
    shares, *_ = np.linalg.lstsq(np.column_stack(constant)[stated], moved[stated])
    harmonic = (rows.channel == channel) & np.isin(rows.part, (Part.REAL, Part.IMAG))
    assert np.max(np.abs(moved[harmonic])) > 1e-4
    assert (np.column_stack(constant) @ shares)[harmonic] == pytest.approx(moved[harmonic], abs=4e-6)


def test_responses_to_a_held_drive_are_those_of_a_first_order_hold() -> None:
    """Against the matrices of the equations of motion, whose highest modes lie above half the rate; by scipy."""
    rig = chain(exciter={"kind": "force", "point": 1, "newton_per_volt": 1.0})
    channels = tuple(
        MeasuredChannel(f"{quantity.letter}{point}", quantity, point)
        for quantity, point in (
            (Quantity.DISPLACEMENT, 2), (Quantity.VELOCITY, 1), (Quantity.ACCELERATION, 1), (Quantity.FORCE, 1),
        )
    )  # fmt: skip
    parts = rig_parts(rig, channels, FourierBasis.up_to(1), PredictionSettings(), 0.0, ideal_force=False)
    r, system, rows = parts.coordinates, parts.system, parts.rows
    assert r > 0
    stiffness, damping = np.linspace(4e3, 8e3, r), np.linspace(0.5, 2.0, r)
    local = parts.inputs[:, :r]
    mass = np.linalg.inv(system.mass)
    k = system.stiffness + local @ np.diag(stiffness) @ rows.displacement[:r]
    c = system.damping + local @ np.diag(damping) @ rows.displacement[:r]
    n = len(mass)
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-mass @ k, -mass @ c]])
    b = np.vstack([np.zeros((n, 1)), mass @ parts.inputs[:, [r]]])
    at, speed, gain = (block[r:] for block in (rows.displacement, rows.velocity, rows.acceleration))
    motion = np.hstack([at - gain @ mass @ k, speed - gain @ mass @ c])
    motion -= rows.feedthrough[r:, :r] @ np.hstack([stiffness[:, None] * rows.displacement[:r],
                                                     damping[:, None] * rows.displacement[:r]])  # fmt: skip
    direct = rows.feedthrough[r:, [r]] + gain @ mass @ parts.inputs[:, [r]]
    interval = 1.0 / 30.0
    assert np.abs(np.linalg.eigvals(a)).max() > 2.0 * np.pi / interval
    sampled = cont2discrete((a, b, motion, direct), interval, "foh")
    omega = np.linspace(1.0, np.pi / interval - 1.0, 50)
    expected = np.array(
        [
            (sampled[2] @ np.linalg.solve(np.exp(1j * w * interval) * np.eye(2 * n) - sampled[0], sampled[1])
             + sampled[3])[:, 0]
            for w in omega
        ]
    )  # fmt: skip
    own = np.arange(len(motion))
    found = held_responses(parts.linear, r, stiffness, damping, own, omega, interval)
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-9 * np.abs(expected).max())


def test_modes_are_looked_for_below_the_images_of_a_held_drive() -> None:
    test, _ = noise_test(MODEL, 400.0, 600.0, 3)
    assert np.isfinite(test.modal_hz).all()
    held = replace(test, lines_hz=np.array([499.0, 501.0, 600.0]), drive_hold_hz=RATE_HZ)
    np.testing.assert_array_equal(held.modal_hz, [499.0, np.inf, np.inf])


def test_delays_of_channels_hold_nothing_of_the_delay_that_their_kind_shares() -> None:
    """The shared one is exact and those are of the first order: one against the other they would be a filter."""
    sensors = [
        {"quantity": "force", "point": "drive"},
        {"quantity": "displacement", "point": 1},
        {"quantity": "displacement", "point": 2},
        {"quantity": "voltage"},
    ]
    rig = chain(sensors=sensors)
    recorded = replace(observations_of_model(rig, noise=0.0), chains=(MeasuringChain(), MeasuringChain()))
    found = linear_chain(recorded, rig, Forward(recorded.tests, recorded.rows).predict(rig))
    first, second, force = (found.columns[:, found.names.index(f"delay {name}")] for name in ("x1", "x2", "f1"))
    size = np.linalg.norm(first)
    assert size > 0.0
    assert np.linalg.norm(first + second) < 1e-9 * size
    assert np.linalg.norm(force) > 0.0
