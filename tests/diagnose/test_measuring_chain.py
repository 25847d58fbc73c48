"""Tolerances of the measuring chain of imports: covariance, directions, images of a held drive, harmonics of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from diagnose.linear_problem import FunctionModel, observations_of
from diagnose.twin_observations import chain, observations_of_twin
from scipy.signal import cont2discrete

from nmt_core.blocks import Quantity
from nmt_diagnose.inference.chain_errors import chain_errors, with_chain_errors
from nmt_diagnose.inference.problem import Nuisance, Problem
from nmt_diagnose.inference.shared_errors import SharedErrors
from nmt_diagnose.observations.conditions import (
    MeasuredChannel,
    PhaseResonanceTest,
    RandomTest,
    RingDownTest,
    Test,
)
from nmt_diagnose.observations.drive_hold import hold_factor, image_responses, zero_order_images
from nmt_diagnose.observations.measuring_chain import ChannelTolerance, MeasuringChain, measuring_chain
from nmt_diagnose.observations.model_view import ModelView
from nmt_diagnose.observations.observables import Observations, Part, Rows
from nmt_diagnose.twin.forward import Forward
from nmt_record.import_sidecar import ChannelSection
from nmt_record.run_device import SIMULATED_RIG
from nmt_rig.rig import Rig, validate_rig
from nmt_rig.rig_file import RigDocument

CHANNELS = {
    "force": MeasuredChannel("f1", Quantity.FORCE, 1),
    "a2": MeasuredChannel("a2", Quantity.ACCELERATION, 2),
}


def test_whitening_is_the_dense_inverse_root() -> None:
    draw = np.random.default_rng(1)
    sigma = draw.uniform(0.5, 2.0, 9)
    columns = draw.standard_normal((9, 3)) * np.array([0.2, 3.0, 50.0])
    plain = Problem(observations_of(np.zeros(9), sigma), FunctionModel(lambda t: t))
    problem = replace(plain, shared=SharedErrors.of(plain.whitened(columns)))
    left = draw.standard_normal((9, 4))
    whitened = problem.whitened(left)
    covariance = np.diag(sigma**2) + columns @ columns.T
    assert np.allclose(whitened.T @ whitened, left.T @ np.linalg.solve(covariance, left))
    assert np.allclose(problem.whitened(left[:, 1]), whitened[:, 1])
    assert problem.log_volume(np.ones(9, dtype=bool)) == pytest.approx(0.5 * np.linalg.slogdet(covariance)[1])


def test_the_volume_of_the_noise_holds_what_rows_share() -> None:
    sigma, size = np.array([0.5, 2.0, 3.0, 4.0]), 5.0
    shared = Nuisance(np.array([1, 3]), np.array([0.6, 0.8]), size)
    problem = Problem(observations_of(np.zeros(4), sigma), FunctionModel(lambda t: t), (shared,))
    column = np.zeros(4)
    column[shared.rows] = sigma[shared.rows] * shared.direction * size
    covariance = np.diag(sigma**2) + np.outer(column, column)
    assert problem.log_volume(np.ones(4, dtype=bool)) == pytest.approx(0.5 * np.linalg.slogdet(covariance)[1])


def test_a_row_without_a_solution_does_not_spoil_the_others() -> None:
    draw = np.random.default_rng(2)
    shared = SharedErrors.of(draw.standard_normal((6, 2)))
    values = draw.standard_normal(6)
    values[3] = np.nan
    assert np.array_equal(np.isnan(shared.whitened(values)), np.isnan(values))


def test_only_imports_have_tolerances() -> None:
    assert measuring_chain({"rig": "beam", "run_id": "x"}, CHANNELS, 1e4) is None
    assert measuring_chain({"rig": "beam", "device": SIMULATED_RIG}, CHANNELS, 1e4) is None


def test_a_device_has_ordinary_tolerances():
    found = measuring_chain({"rig": "beam", "device": "soundcard"}, CHANNELS, 48_000.0)
    assert found == MeasuringChain(hold_hz=48_000.0)
    stated = [
        {"column": "u", "quantity": "voltage", "gain_std": 2e-3, "delay_std_s": 5e-6},
        {"column": "f", "quantity": "force", "point": 1, "name": "force", "phase_std_deg": 1.0},
        {"column": 3, "quantity": "acceleration", "point": 2, "gain_std": 0.0, "delay_std_s": 2e-6},
    ]
    for section in stated:
        ChannelSection.model_validate({**section, "unit": "V"})
    found = measuring_chain({"imported": {"sidecar": {"channels": stated}}}, CHANNELS, 5000.0)
    assert found is not None
    assert (found.voltage_gain, found.shared_delay_s, found.hold_hz) == (2e-3, 5e-6, 5000.0)
    assert found.of("f1") == ChannelTolerance(phase=math.radians(1.0))
    assert found.of("a2") == ChannelTolerance(gain=0.0, delay_s=2e-6)
    assert found.of("a9") == ChannelTolerance()


class _FirstOrder:
    """ẏ = −a y + u, seen as a model."""

    rate = 700.0

    def responses(self, channels: object, frequency_hz: np.ndarray) -> np.ndarray:
        return (1.0 / (2j * np.pi * frequency_hz + self.rate))[None, :]


def test_images_of_a_held_drive_are_those_of_the_sampled_system() -> None:
    """A first-order system, held and sampled, has a transfer function in closed form (step-invariant transform)."""
    hertz, frequency = 5000.0, np.array([20.0, 97.0, 400.0, 1500.0])
    view = _FirstOrder()
    orders = tuple(m for m in range(-4000, 4001) if m)
    folded = zero_order_images(view, (CHANNELS["a2"],), frequency, hertz, orders)[0]  # type: ignore[arg-type]
    share = frequency / hertz
    direct = view.responses((), frequency)[0] * np.sinc(share) * np.exp(-1j * np.pi * share)
    top, bottom, *_ = cont2discrete(([1.0], [1.0, view.rate]), 1.0 / hertz, method="zoh")
    z = np.exp(2j * np.pi * share)
    assert direct + folded == pytest.approx(np.polyval(top[0], z) / np.polyval(bottom, z), rel=2e-4)


def test_images_of_an_interpolated_drive_are_those_of_the_sampled_system() -> None:
    """The same for a drive that goes straight from sample to sample."""
    hertz, frequency = 5000.0, np.array([97.0, 400.0])
    view = _FirstOrder()
    folded = image_responses(view, (CHANNELS["a2"],), frequency, hertz)[0]  # type: ignore[arg-type]
    direct = view.responses((), frequency)[0] * hold_factor(frequency, hertz)
    top, bottom, *_ = cont2discrete(([1.0], [1.0, view.rate]), 1.0 / hertz, method="foh")
    z = np.exp(2j * np.pi * frequency / hertz)
    assert direct + folded == pytest.approx(np.polyval(np.ravel(top), z) / np.polyval(bottom, z), rel=1e-4)


def test_harmonics_of_the_drive_drive_the_model() -> None:
    """Of a linear rig the third harmonic of each channel is its response there times that of the drive."""
    model = chain(local_elements=[])
    observations = observations_of_twin(model, random=False)
    test = observations.tests[0]
    assert isinstance(test, PhaseResonanceTest)
    share = 2e-3 * np.exp(0.7j)
    moved = replace(test, levels=tuple(replace(level, drive_harmonics=(0j, complex(share))) for level in test.levels))
    rows = observations.rows
    pure, driven = (Forward((own,), rows).predict(model).values for own in (test, moved))
    found = 0
    for channel, own in enumerate(test.channels):
        for level in range(len(test.levels)):
            mine = (rows.level == level) & (rows.channel == channel)
            log_size = pure[mine & (rows.part == Part.LOG_MAGNITUDE)]
            parts = [np.flatnonzero(mine & (rows.harmonic == 3) & (rows.part == p)) for p in (Part.REAL, Part.IMAG)]
            if log_size.size and all(part.size for part in parts):
                change = [float(driven[part[0]] - pure[part[0]]) for part in parts]
                frequency = np.exp(pure[(rows.level == level) & (rows.part == Part.LOG_FREQUENCY)]) / (2.0 * np.pi)
                response = ModelView.of(model, test.drive_point).responses((own,), 3.0 * frequency)[0, 0]
                expected = response * share * test.levels[level].drive / math.exp(float(log_size[0]))
                assert complex(*change) == pytest.approx(complex(expected), rel=2e-3)
                found += 1
    assert found >= 2 * len(test.levels)


def test_errors_within_the_tolerances_are_noise_and_beyond_them_are_not() -> None:
    """Gains of 1 % and 10 %, a common delay of 80 µs: exact predictions of a rig with these sensors."""
    model = chain()
    observations = observations_of_twin(model)
    tolerant = replace(observations, chains=(MeasuringChain(),) * len(observations.tests))
    forward = Forward(observations.tests, observations.rows)
    base = forward.predict(model)
    problem = with_chain_errors(Problem(tolerant, forward), model, base)
    plain = Problem(observations, forward)

    def size(kind: Problem, gain: float, delay: float) -> float:
        sensors = [
            s.model_copy(update={"gain": s.gain * (gain if k == 0 else 1.0), "delay_s": s.delay_s + delay})
            if s.quantity != "voltage"
            else s
            for k, s in enumerate(model.sensors)
        ]
        seen = forward.predict(model.model_copy(update={"sensors": sensors}), base)
        residual = kind.whitened(forward.difference(seen.values, base.values))
        return float(residual @ residual)

    assert size(plain, 1.01, 80e-6) > 1e4
    assert size(problem, 1.01, 80e-6) < 5.0
    assert size(problem, 1.10, 80e-6) > 50.0


def test_images_in_a_fundamental_change_the_harmonics_over_it() -> None:
    """An acceleration with an image z of the held drive, at any angle: ln Y₁ moves by z, Y_n / |Y₁| by −Re z of it."""
    model = chain()
    observations = observations_of_twin(model, random=False)
    tolerant = replace(observations, chains=(MeasuringChain(hold_hz=250.0),))
    forward, rows = Forward(observations.tests, observations.rows), observations.rows
    base = forward.predict(model)
    columns = chain_errors(Problem(tolerant, forward), model, base)[1]
    test = observations.tests[0]
    assert isinstance(test, PhaseResonanceTest)
    channel = next(c for c in test.channels if c.quantity is Quantity.ACCELERATION)
    mine = rows.channel == test.channels.index(channel)
    size, phase = (np.flatnonzero(mine & (rows.part == part)) for part in (Part.LOG_MAGNITUDE, Part.PHASE))
    view = ModelView.of(model, test.drive_point)
    frequency = rows.frequency_hz[size]
    plain = np.exp(base.values[size] + 1j * base.values[phase]) / rows.amplitude[size]
    assert np.abs(base.values[mine & np.isin(rows.part, (Part.REAL, Part.IMAG))]).max() > 0.01
    for order in (-1, 1, 2):
        image = zero_order_images(view, (channel,), frequency, 250.0, (order,))[0] / plain
        for turned in (image, 1j * image):
            own = next(c for c in columns.T if np.allclose(c[size] + 1j * c[phase], turned, rtol=1e-6))
            for row, z in zip(size, turned, strict=True):
                over = mine & (rows.level == rows.level[row]) & np.isin(rows.part, (Part.REAL, Part.IMAG))
                assert own[over] == pytest.approx(-z.real * base.values[over], rel=1e-6)


def test_a_loop_leans_by_an_image_of_the_phase_and_not_by_one_of_a_small_harmonic() -> None:
    """Of images, those of the fundamentals' phases tell by how much a loop with filters stands elsewhere."""
    model = chain()
    observations = observations_of_twin(model, random=False)
    rows = observations.rows
    held = rows.part == Part.PHASE_ERROR
    forward = Forward(observations.tests, rows)
    base = forward.predict(model)

    def lean(hold_hz: float) -> float:
        tolerant = replace(observations, chains=(MeasuringChain(hold_hz=hold_hz),))
        columns = chain_errors(Problem(tolerant, forward), model, base)[1]
        (own,) = (c for c in columns.T if np.abs(c[held]).min() > 0.01 and not c[~held].any())
        return float(own[held][0])

    assert lean(math.inf) == pytest.approx(math.radians(1.0))
    test = observations.tests[0]
    assert isinstance(test, PhaseResonanceTest)
    view = ModelView.of(model, test.drive_point)
    turned, sized = (np.flatnonzero(rows.part == part) for part in (Part.PHASE, Part.LOG_MAGNITUDE))
    assert np.array_equal(rows.channel[turned], rows.channel[sized])
    assert np.array_equal(rows.level[turned], rows.level[sized])
    plain = np.exp(base.values[sized]) / rows.amplitude[sized]
    place = (rows.channel[turned], np.arange(turned.size))
    images = sum(
        np.abs(zero_order_images(view, test.channels, rows.frequency_hz[turned], 250.0, (order,))[place]) / plain
        for order in (-1, 1, -2, 2, -3, 3, -4, 4)
    )
    # One image each of two chains, of which one may have filters.
    assert math.radians(1.0) < lean(250.0) <= math.hypot(math.radians(1.0), float(images.max()) / math.sqrt(2.0))


def test_a_high_pass_within_the_tolerance_is_noise_and_beyond_it_is_not() -> None:
    """The corner of a conditioner at which a channel leads by 0.2° at resonance, and by more below it."""
    model = chain()
    observations = observations_of_twin(model)
    tolerant = replace(observations, chains=(MeasuringChain(),) * len(observations.tests))
    forward = Forward(observations.tests, observations.rows)
    base = forward.predict(model)
    problem = with_chain_errors(Problem(tolerant, forward), model, base)
    locked = next(number for number, test in enumerate(observations.tests) if isinstance(test, PhaseResonanceTest))
    resonance = float(np.median(observations.rows.frequency_hz[observations.rows.test == locked]))

    def size(kind: Problem, lead_deg: float) -> float:
        corner = resonance * math.tan(math.radians(lead_deg))
        sensors = [s.model_copy(update={"high_pass_hz": corner}) if s.quantity == "force" else s for s in model.sensors]
        seen = forward.predict(model.model_copy(update={"sensors": sensors}), base)
        residual = kind.whitened(forward.difference(seen.values, base.values))
        return float(residual @ residual)

    assert size(Problem(observations, forward), 0.2) > 100.0
    assert size(problem, 0.2) < 5.0
    assert size(problem, 4.0) > 50.0


def test_a_recorded_voltage_may_be_off_from_the_commanded_one() -> None:
    """Amplitudes over a commanded voltage and responses over a recorded one differ by the gain of its channel."""
    model = chain()
    observations = observations_of_twin(model, noise=0.0)
    forward, rows = Forward(observations.tests, observations.rows), observations.rows
    base = forward.predict(model)
    random = np.array([isinstance(observations.tests[number], RandomTest) for number in rows.test])
    louder = np.where(random & (rows.part == Part.LOG_MAGNITUDE), 0.01, 0.0)
    sizes = []
    for commanded in (False, True):
        tests = tuple(
            replace(test, commanded=commanded) if isinstance(test, PhaseResonanceTest) else test
            for test in observations.tests
        )
        tolerant = replace(observations, tests=tests, chains=(MeasuringChain(),) * len(tests))
        problem = with_chain_errors(Problem(tolerant, forward), model, base)
        residual = problem.whitened(louder)
        sizes.append(float(residual @ residual))
    assert sizes[0] > 50.0
    assert sizes[1] < 2.0


def test_amplitudes_that_had_not_settled_are_one_error_of_their_level() -> None:
    model = chain()
    observations = observations_of_twin(model, noise=0.0, random=False)
    (test,) = observations.tests
    assert isinstance(test, PhaseResonanceTest)
    leans = tuple(-0.01 - 0.001 * k for k in range(len(test.channels)))
    levels = tuple(replace(own, amplitude_leans=leans if k == 2 else ()) for k, own in enumerate(test.levels))
    unsettled = replace(observations, tests=(replace(test, levels=levels),))
    forward, rows = Forward(unsettled.tests, unsettled.rows), unsettled.rows
    base = forward.predict(model)
    (column,) = chain_errors(Problem(unsettled, forward), model, base)[1].T
    mine = (rows.level == 2) & (rows.part == Part.LOG_MAGNITUDE)
    assert np.array_equal(column[mine], np.array(leans)[rows.channel[mine]])
    assert not column[~mine].any()
    problem = with_chain_errors(Problem(unsettled, forward), model, base)
    residual = problem.whitened(column)
    assert float(residual @ residual) < 1.0
    elsewhere = np.where((rows.level == 3) & (rows.part == Part.LOG_MAGNITUDE), 0.01, 0.0)
    assert float(problem.whitened(elsewhere) @ problem.whitened(elsewhere)) > 100.0


def _rows(levels: int, parts: tuple[Part, ...], frequency_hz: float = 0.0, rate: float = 1.0) -> Rows:
    count = levels * len(parts)
    level = np.repeat(np.arange(levels), len(parts))
    zero = np.zeros(count, dtype=np.int64)
    part = np.tile([int(p) for p in parts], levels)
    return Rows(zero, level, zero, zero + 1, part, level / rate, np.full(count, frequency_hz), np.ones(count))


def oscillator(local_elements: list[dict[str, object]]) -> Rig:
    """1 kg at 20 Hz, pushed by a force."""
    values = {
        "name": "oscillator",
        "structure": {
            "kind": "chain", "masses_kg": [1.0], "ground_springs_n_m": [16e3], "ground_dampers_ns_m": [2.0],
        },
        "exciter": {"kind": "force", "point": 1, "newton_per_volt": 1.0},
        "sensors": [
            {"quantity": "force", "point": "drive"}, {"quantity": "voltage"}, {"quantity": "displacement", "point": 1},
        ],
        "extraction": {"quantity": "displacement", "linear_modes": 1},
        "local_elements": local_elements,
    }  # fmt: skip
    return validate_rig(RigDocument("test", values, {}))


def _decay() -> tuple[Rig, RingDownTest, Rows]:
    """A hardening oscillator seen by a laser that its rig file does not have."""
    rig = oscillator([{"kind": "cubic_spring", "point": 1, "stiffness_n_m3": 2e10}])
    laser = MeasuredChannel("v1", Quantity.VELOCITY, 1)
    test = RingDownTest("decay", 1, laser, np.geomspace(1.0, 1e-2, 8), 27.0)
    return rig, test, _rows(8, (Part.LOG_FREQUENCY, Part.DAMPING), 27.0)


def _within(rig: Rig, test: Test, rows: Rows, change: Callable[[Forward, Rig], np.ndarray]) -> tuple[float, float]:
    """Whitened size of a change of the observables, without and with tolerances."""
    forward = Forward((test,), rows)
    base = forward.predict(rig)
    scale = np.where(rows.part == Part.SAMPLE, np.std(base.values), 1.0)
    observations = Observations((test,), rows, base.values, 1e-4 * scale, 0.0 * scale, chains=(MeasuringChain(),))
    plain = Problem(replace(observations, chains=(None,)), forward)
    problem = with_chain_errors(Problem(observations, forward), rig, base)
    moved = change(forward, rig) - base.values
    return tuple(float(np.linalg.norm(kind.whitened(moved))) for kind in (plain, problem))  # type: ignore[return-value]


def test_a_gain_within_the_tolerance_is_noise_in_a_decay() -> None:
    """An amplitude that is 1 % off puts every frequency of a hardening decay off."""
    rig, test, rows = _decay()
    louder = replace(test, amplitudes=test.amplitudes / 1.01)
    plain, tolerant = _within(rig, test, rows, lambda _, model: Forward((louder,), rows).predict(model).values)
    assert plain > 20.0
    assert tolerant < 1.5
    far = replace(test, amplitudes=test.amplitudes / 1.1)
    assert _within(rig, test, rows, lambda _, model: Forward((far,), rows).predict(model).values)[1] > 5.0


def test_without_tolerances_the_problem_is_the_same() -> None:
    model = chain()
    observations = observations_of_twin(model, random=False)
    problem = Problem(observations, Forward(observations.tests, observations.rows))
    assert with_chain_errors(problem, model, problem.forward.predict(model)) is problem
