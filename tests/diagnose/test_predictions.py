"""The prediction against the reference of nmt_plant, closed forms and differences of its own predictions."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from diagnose.predicted_tests import SHAKER, chain, channels_of, level, locked, noise_test, rows_of
from moved_threshold import moved_threshold
from rig.effect_rigs import oscillator, rig_of, run
from tiers import with_quick

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.records import DriveCommand
from nmt_core.vocabulary import Waveform
from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.effects.library import candidates, effect_named, library
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.effects.rig_edit import value_at, with_element, with_value
from nmt_diagnose.measurements.backbone_table import BackboneTable
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.driven_record import DrivenRecord, stepped_model
from nmt_diagnose.measurements.recorded_decay import RecordedDecay
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.prediction.influence import Source
from nmt_diagnose.prediction.operating_range import operating_range
from nmt_diagnose.prediction.parts_cache import PartsCache, Setup
from nmt_diagnose.prediction.prediction_settings import PredictionSettings
from nmt_diagnose.prediction.rig_parts import rig_parts
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_rig.model.forced_response import ForcedProblem
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.model.linear_modes import sticking_modes
from nmt_rig.model.local_elements.springs import LinearSpringSection
from nmt_rig.model.phase_resonance import phase_resonant_backbone
from nmt_rig.rig import Rig, load_rig, validate_rig
from nmt_rig.rig_file import RigDocument
from nmt_rig.rig_model import build_elements, build_structure, build_system

PLAIN = PredictionSettings(harmonics=7, mesh_refinement=1)
AT_2, A2 = Source("structure", 2), Source("response_sensor", channel="a2")
EXCITER, FORCE, LOOP = Source("exciter"), Source("force_sensor"), Source("controller")


def run_and_stop(rig: Rig, hz: float, volts: float, driven: float, free: float) -> np.ndarray:
    """Displacement from the stop of a drive on."""
    device = SimulatedRig(rig)
    device.configure()
    device.start()
    device.write(DriveCommand(Waveform.SINE, hz, volts))
    parts = []
    blocks = round(driven * 50)
    for block in range(blocks + round(free * 50)):
        if block == blocks:
            device.write(DriveCommand(Waveform.OFF))
        parts += [b.data[0] for b in device.read() if b.quantity == Quantity.DISPLACEMENT]
    return np.concatenate(parts)[(blocks + 5) * 200 :]


def first_mode(rig: Rig, mode: int = 1) -> float:
    structure = build_structure(rig)
    return float(sticking_modes(structure, build_elements(rig, structure), mode).frequencies[-1]) / (2 * np.pi)


@pytest.mark.parametrize(("name", "volts", "response"), [
    ("beam", (0.1, 0.5, 1.5), "x2"),
    ("joint_resonator", (0.5, 4.0, 18.0), "a1"),
    ("pair", (0.1, 1.0, 4.0), "x1"),
])  # fmt: skip
def test_phase_resonance_meets_the_single_point_reference(name, volts, response):
    """Same model, other formulation: frequency and all harmonics of all channels to 1e-8."""
    rig = chain() if name == "pair" else load_rig(name)
    guess = first_mode(rig, rig.test.mode)
    problem = ForcedProblem(build_system(rig), FourierBasis.up_to(7), 2 * np.pi * guess)
    expected = phase_resonant_backbone(problem, np.array([1e-3 * volts[0], *volts])).responses[1:]
    test, table = locked(rig, [level(v, guess) for v in volts], response)
    prediction = Forward([test], rows_of(table), PLAIN).predict(rig)
    assert np.all(prediction.converged) or name != "pair"
    system = problem.system
    for state, solution in zip(prediction.states[0], expected, strict=True):
        omega = solution.angular_frequency
        assert state.omega == pytest.approx(omega, rel=1e-9)
        for row, channel in enumerate(test.channels):
            s = 1j * omega * np.arange(8)
            if channel.quantity == Quantity.FORCE:
                harmonics = solution.force
            elif channel.quantity == Quantity.VOLTAGE:
                harmonics = state.drive * (np.arange(8) == 1)
            else:
                harmonics = solution.unknowns @ system.selector(channel.point)
                harmonics = harmonics * (s * s if channel.quantity == Quantity.ACCELERATION else 1.0)
            np.testing.assert_allclose(state.channels[row], harmonics, atol=1e-8 * abs(harmonics[1]))


def test_a_duffing_oscillator_in_closed_form():
    """Ideal force, one order: m ω² = k + ¾ k₃ A² and F = c ω A."""
    k3 = 1e9
    rig = oscillator([{"kind": "cubic_spring", "point": 1, "stiffness_n_m3": k3}])
    test, table = locked(rig, [level(f, 32.0) for f in (0.1, 1.0, 3.0)], "x1", harmonics=1)
    prediction = Forward([test], rows_of(table), PredictionSettings(harmonics=1)).predict(rig)
    for force, state in zip((0.1, 1.0, 3.0), prediction.states[0], strict=True):
        amplitude = abs(state.channels[1, 1])
        assert force == pytest.approx(2.0 * state.omega * amplitude, rel=1e-9)
        assert 0.5 * state.omega**2 == pytest.approx(20_000.0 + 0.75 * k3 * amplitude**2, rel=1e-9)


def test_a_measured_phase_and_a_held_force():
    """A linear oscillator that the loop holds φ off resonance; the given force is the amplitude, and phase zero."""
    rig, phase = oscillator(), 0.2
    conditions = [level(math.nan, 32.0, phase)]
    conditions = [type(conditions[0])(0, math.nan, phase, 0.0, 32.0, 0.0, 1.0, 0.0, 1, 1.5)]
    test, table = locked(rig, conditions, "x1", harmonics=2, held="force")
    values = dict(zip(table, Forward([test], rows_of(table)).predict(rig).values, strict=True))
    omega = math.exp(values[(0, 0, -1, -1, Part.LOG_FREQUENCY)])
    # arg Z = π/2 + φ
    assert math.atan2(2.0 * omega, 20_000.0 - 0.5 * omega**2) == pytest.approx(0.5 * np.pi + phase, abs=1e-9)
    assert math.exp(values[(0, 0, 0, 1, Part.LOG_MAGNITUDE)]) == pytest.approx(1.5, rel=1e-9)
    x = 1.5 / (20_000.0 - 0.5 * omega**2 + 2j * omega)
    assert values[(0, 0, 1, 1, Part.LOG_MAGNITUDE)] == pytest.approx(math.log(abs(x)), abs=1e-9)
    assert values[(0, 0, 1, 1, Part.PHASE)] == pytest.approx(np.angle(x), abs=1e-9)


@pytest.mark.parametrize("reference", ["voltage", "force"])
@pytest.mark.parametrize("name", ["beam", "pair"])
def test_random_responses_are_the_smoothed_ones_of_the_sticking_system(name, reference):
    rig = load_rig("beam") if name == "beam" else chain()
    test, table = noise_test(rig, 5.0, 500.0, 40, reference=reference)
    forward = Forward([test], rows_of(table), PLAIN)
    values = forward.predict(rig).values.reshape(test.lines_hz.size, len(test.channels), 2)
    system = build_system(rig)
    for line, hz in enumerate(test.lines_hz):
        top, bottom = np.zeros(len(test.channels), complex), 0.0
        for step, weight in ((-1, 1 / 6), (0, 2 / 3), (1, 1 / 6)):
            omega = 2 * np.pi * (hz + step * test.resolution_hz)
            q, force = system.response(omega)
            power = {Quantity.DISPLACEMENT: 0, Quantity.ACCELERATION: 2}
            y = np.array([
                force if c.quantity == Quantity.FORCE else q[system.points[c.point]] * (1j * omega) ** power[c.quantity]
                for c in test.channels
            ])  # fmt: skip
            r = 1.0 if reference == "voltage" else force
            top += weight * y * np.conj(r)
            bottom += weight * abs(r) ** 2
        np.testing.assert_allclose(np.exp(values[line, :, 0] + 1j * values[line, :, 1]), top / bottom, rtol=3e-7)


def test_at_rest_a_gap_is_open_and_a_preloaded_stop_closed():
    """Against the plant's linear system with a spring where the preloaded stop is."""
    elements = [
        {"kind": "two_sided_gap", "point": 1, "stiffness_n_m": 5e3, "gap_m": 1e-3},
        {"kind": "unilateral_stop", "point": 1, "stiffness_n_m": 5e3, "gap_m": 1e-3},
        {"kind": "unilateral_stop", "point": 2, "stiffness_n_m": 7e3, "gap_m": -1e-3},
    ]
    rig = chain(local_elements=elements)
    system = build_system(chain(local_elements=[{"kind": "linear_spring", "point": 2, "stiffness_n_m": 7e3}]))
    test, table = noise_test(rig, 5.0, 100.0, 30, window="none")
    values = Forward([test], rows_of(table), PLAIN).predict(rig).values
    own = values.reshape(test.lines_hz.size, len(test.channels), 2)
    row = next(k for k, channel in enumerate(test.channels) if channel.name == "x1")
    for line, hz in enumerate(test.lines_hz):
        q, _ = system.response(2 * np.pi * hz)
        expected = q[system.points[1]]
        assert np.exp(own[line, row, 0] + 1j * own[line, row, 1]) == pytest.approx(expected, rel=1e-6)


def test_a_refined_mesh_moves_high_modes_only():
    rig = load_rig("beam")
    test, table = noise_test(rig, 5.0, 500.0, 40, window="none")
    coarse = Forward([test], rows_of(table), PLAIN).predict(rig).values
    refined = rig.model_copy(update={"structure": rig.structure.model_copy(update={"mesh_refinement": 2})})
    finer = Forward([test], rows_of(table), PredictionSettings(mesh_refinement=2)).predict(rig).values
    np.testing.assert_allclose(finer, Forward([test], rows_of(table), PLAIN).predict(refined).values, atol=1e-9)
    assert 1e-4 < np.max(np.abs(finer - coarse)) < 0.05
    # The rig file's own mesh is the model unless told otherwise.
    np.testing.assert_array_equal(Forward([test], rows_of(table)).predict(rig).values, coarse)


def test_a_reduced_structure_keeps_the_responses():
    rig = load_rig("beam")
    test, table = noise_test(rig, 5.0, 500.0, 40, window="none")
    whole = Forward([test], rows_of(table), PredictionSettings(mesh_refinement=4, full_size=100)).predict(rig).values
    reduced = Forward([test], rows_of(table), PredictionSettings(mesh_refinement=4)).predict(rig).values
    assert 0.0 < np.max(np.abs(whole - reduced)) < 2e-5


@pytest.mark.parametrize("name", with_quick(["beam", "pair"], "pair"))
def test_jacobian_against_differences_of_predictions(name):
    rig = load_rig("beam") if name == "beam" else chain()
    volts, response = ((0.3, 1.0), "x2") if name == "beam" else ((0.5, 2.0), "x1")
    test, table = locked(rig, [level(v, first_mode(rig) * 0.97) for v in volts], response)
    noise, more = noise_test(rig, 5.0, 300.0, 20, test=1)
    forward = Forward([test, noise], rows_of([*table, *more]), PLAIN)
    operating = operating_range(rig, [test, noise])
    wanted = ("cubic_stiffness@2", "two_sided_gap@2", "response_gain@x2", "channel_skew@f2", "source_impedance",
              "cubic_stiffness@1", "response_gain@x1", "added_mass@2", "clamp_compliance@rotation", "microslip@joint",
              "force_factor_asymmetric", "temperature_drift", "stinger_stiffness@lateral")  # fmt: skip
    own = tuple(c for c in candidates(rig, operating) if c.label in wanted)
    assert len(own) >= 8
    parametrisation = Parametrisation(rig, calibration_parameters(rig), own)
    theta = parametrisation.zero + 0.3
    for index, entry in enumerate(parametrisation.names):
        if entry.endswith(".gap"):
            theta[index] = math.log(0.4)
    start = forward.predict(parametrisation.rig(theta))
    assert not start.reasons
    jacobian = forward.jacobian(parametrisation, theta, start)
    for column in range(parametrisation.size):
        h = 3e-3
        plus, minus = theta.copy(), theta.copy()
        plus[column] += h
        minus[column] -= h
        a, b = (forward.predict(parametrisation.rig(t), start).values for t in (plus, minus))
        expected = forward.difference(a, b) / (2 * h)
        size = np.max(np.abs(expected))
        assert size > 0.0
        name = parametrisation.names[column]
        np.testing.assert_allclose(jacobian[:, column], expected, atol=4e-3 * size, err_msg=name)


def test_a_warm_start_finds_the_cold_solution():
    rig = load_rig("beam")
    test, table = locked(rig, [level(v, 21.0) for v in (0.1, 0.5, 1.5)], "x2")
    forward = Forward([test], rows_of(table), PLAIN)
    exciter = rig.exciter.model_copy(update={"table_mass_kg": 0.03})
    other = rig.model_copy(update={"exciter": exciter})
    warm = forward.predict(other, forward.predict(rig))
    np.testing.assert_allclose(warm.values, forward.predict(other).values, atol=1e-8)


def test_an_antiresonance_is_no_phase_resonance():
    """Above the first resonance the drive point of the pair has an antiresonance: force and velocity are in phase."""
    rig = chain(local_elements=[])
    system = build_system(rig)
    grid = np.linspace(10.0, 60.0, 5001)
    angle = []
    for hz in grid:
        q, force = system.response(2 * np.pi * hz)
        angle.append(np.angle(force / (2j * np.pi * hz * q[0])))
    angle = np.array(angle)
    falls = grid[np.flatnonzero((angle[:-1] > 0) & (angle[1:] <= 0) & (np.abs(np.diff(angle)) < 1))]
    rises = grid[np.flatnonzero((angle[:-1] < 0) & (angle[1:] >= 0) & (np.abs(np.diff(angle)) < 1))]
    assert falls.size
    assert rises.size
    starts = [float(falls[0]) * share for share in (0.75, 0.85, 0.95, 1.0, 1.05)]
    test, table = locked(rig, [level(0.5, hz) for hz in starts], "x1")
    prediction = Forward([test], rows_of(table)).predict(rig)
    found = np.array([s.omega / (2 * np.pi) for s in prediction.states[0] if s is not None])
    assert found.size + len(prediction.reasons) == len(starts)
    assert found.size > 0
    assert all(np.min(np.abs(rises - hz)) < 0.02 for hz in found)


def test_linear_ring_down_is_the_damped_pole():
    """At zero volts, with the current through the coil: eigenvalues of the assembled equations."""
    rig = chain(local_elements=[])
    system = build_system(rig)
    n, m = system.size, system.mechanical_size
    inverse = np.linalg.inv(system.mass[:m, :m])
    a = np.zeros((n + m, n + m))
    a[:m, n:] = np.eye(m)
    a[m, :n] = -system.stiffness[m] / system.damping[m, m]
    a[m, n:] = -system.damping[m, :m] / system.damping[m, m]
    a[n:, :n] = -inverse @ system.stiffness[:m]
    a[n:, n:] = -inverse @ system.damping[:m, :m]
    poles = np.linalg.eigvals(a)
    poles = poles[(poles.imag > 0) & (poles.imag < 500)]
    for pole in poles:
        hz = pole.imag / (2 * np.pi)
        channel = MeasuredChannel("x1", Quantity.DISPLACEMENT, 1)
        test = RecordedDecay("decay", 1, channel, np.array([1e-3, 1e-4]), hz * 1.02)
        table = [(0, k, 0, 1, part) for k in range(2) for part in (Part.LOG_FREQUENCY, Part.DAMPING)]
        values = Forward([test], rows_of(table)).predict(rig).values
        np.testing.assert_allclose(np.exp(values[::2]), pole.imag, rtol=1e-8)
        np.testing.assert_allclose(values[1::2], -pole.real / pole.imag, rtol=1e-7)


def test_ring_down_of_duffing_and_friction_follow_the_averages():
    """Light damping: m ω² = k + ¾ k₃ A²; 2 ω Ȧ + ω̇ A = −(c / m + 8 c₂ ω A / (3 π m)) ω A."""
    k3, c2 = 1e9, 20.0
    rig = oscillator([
        {"kind": "cubic_spring", "point": 1, "stiffness_n_m3": k3},
        {"kind": "quadratic_drag", "point": 1, "drag_ns2_m2": c2},
    ])  # fmt: skip
    amplitudes = np.array([2e-3, 1e-3, 2e-4])
    test = RecordedDecay("decay", 1, MeasuredChannel("x1", Quantity.DISPLACEMENT, 1), amplitudes, 33.0)
    table = [(0, k, 0, 1, part) for k in range(3) for part in (Part.LOG_FREQUENCY, Part.DAMPING)]
    values = Forward([test], rows_of(table), PredictionSettings(harmonics=3)).predict(rig).values
    omega, ratio = np.exp(values[::2]), values[1::2]
    np.testing.assert_allclose(omega**2, (20_000.0 + 0.75 * k3 * amplitudes**2) / 0.5, rtol=2e-3)
    rate = 2.0 / (2 * 0.5) + 4.0 * c2 * omega * amplitudes / (3 * np.pi * 0.5)
    slope = 0.75 * k3 * amplitudes**2 / (20_000.0 + 0.75 * k3 * amplitudes**2)
    np.testing.assert_allclose(ratio * omega, rate / (1.0 + 0.5 * slope), rtol=1.2e-2)
    seen = RecordedDecay("decay", 1, MeasuredChannel("a1", Quantity.ACCELERATION, 1), amplitudes * omega**2, 33.0)
    values = Forward([seen], rows_of(table), PredictionSettings(harmonics=3)).predict(rig).values
    np.testing.assert_allclose(np.exp(values[::2]), omega, rtol=2e-3)
    np.testing.assert_allclose(values[1::2], ratio * (1.0 + 2.0 * slope), rtol=2e-2)


@pytest.mark.parametrize("kind", ["cubic_spring", "jenkins"])
def test_a_decay_in_time_follows_the_ring_down(kind):
    """Energy at the turning points of a decay integrated by the plant, once it is free."""
    element = (
        {"kind": "cubic_spring", "point": 1, "stiffness_n_m3": 1.5e9}
        if kind == "cubic_spring"
        else {"kind": "jenkins", "point": 1, "tangential_stiffness_n_m": 4000.0, "slip_force_n": 0.3}
    )
    rig = oscillator([element])
    y = run_and_stop(rig, 33.0, 3.0, 1.5, 1.2)
    time = np.arange(y.size) / 1e4
    ups = np.flatnonzero((y[:-1] < 0) & (y[1:] >= 0))
    crossings = time[ups] - y[ups] / (y[ups + 1] - y[ups]) * 1e-4
    fundamental = []
    for start, stop in itertools.pairwise(crossings):
        grid = np.linspace(start, stop, 400, endpoint=False)
        own = np.interp(grid, time, y)
        fundamental.append(2.0 * abs(np.mean(own * np.exp(-2j * np.pi * np.arange(400) / 400))))
    middle = 0.5 * (crossings[1:] + crossings[:-1])
    log, omega = np.log(fundamental), 2 * np.pi / np.diff(crossings)
    rate = -np.gradient(log, middle)
    # Above the amplitude at which the joint sticks: there a decay changes within one period.
    picks = np.array([3, 6, 9])
    test = RecordedDecay(
        "decay", 1, MeasuredChannel("x1", Quantity.DISPLACEMENT, 1), np.exp(log[picks]), omega[3] / (2 * np.pi)
    )
    table = [(0, k, 0, 1, part) for k in range(3) for part in (Part.LOG_FREQUENCY, Part.DAMPING)]
    values = Forward([test], rows_of(table)).predict(rig).values
    np.testing.assert_allclose(np.exp(values[::2]), omega[picks], rtol=2e-3)
    np.testing.assert_allclose(values[1::2], (rate / omega)[picks], rtol=0.03)


def test_a_late_channel_sees_an_earlier_and_larger_part_of_a_decay():
    """A free decay is e^{(−δ + iω) t}: a delay τ turns it by −ωτ and makes it larger by e^{δτ}."""
    late = 6e-4
    rig = chain(local_elements=[])
    sensors = [s.model_copy(update={"delay_s": late}) if s.quantity == "acceleration" else s for s in rig.sensors]
    here, there = MeasuredChannel("x1", Quantity.DISPLACEMENT, 1), MeasuredChannel("a2", Quantity.ACCELERATION, 2)
    test = RecordedDecay("decay", 1, here, np.array([1e-3, 3e-4]), 24.0, (there,))
    kinds = [(0, Part.LOG_FREQUENCY), (0, Part.DAMPING), (1, Part.LOG_MAGNITUDE), (1, Part.PHASE)]
    forward = Forward([test], rows_of([(0, k, channel, 1, part) for k in range(2) for channel, part in kinds]))
    punctual = forward.predict(rig).values
    values = forward.predict(rig.model_copy(update={"sensors": sensors})).values
    omega, ratio = np.exp(punctual[::4]), punctual[1::4]
    np.testing.assert_allclose(values[2::4] - punctual[2::4], ratio * omega * late, rtol=1e-5)
    np.testing.assert_allclose(values[3::4] - punctual[3::4], -omega * late, rtol=1e-5)


def test_ring_down_jacobian_is_that_of_solutions():
    rig = chain()
    test = RecordedDecay("decay", 1, MeasuredChannel("x1", Quantity.DISPLACEMENT, 1), np.array([1e-3, 3e-4]), 24.0)
    table = [(0, k, 0, 1, part) for k in range(2) for part in (Part.LOG_FREQUENCY, Part.DAMPING)]
    forward = Forward([test], rows_of(table))
    parametrisation = Parametrisation(rig, calibration_parameters(rig))
    start = forward.predict(rig)
    assert not start.reasons
    jacobian = forward.jacobian(parametrisation, parametrisation.zero, start)
    h = 1e-2
    for column in range(parametrisation.size):
        step = np.zeros(parametrisation.size)
        step[column] = h
        a, b = (forward.predict(parametrisation.rig(t), start).values for t in (step, -step))
        np.testing.assert_allclose(
            jacobian[:, column], (a - b) / (2 * h), atol=5e-3 * np.max(np.abs(jacobian[:, column])) + 1e-9
        )


def test_a_backbone_table_is_the_locked_test_seen_from_its_response():
    rig = chain()
    locked_test, table = locked(rig, [level(v, 24.0) for v in (0.5, 2.0)], "x1")
    prediction = Forward([locked_test], rows_of(table)).predict(rig)
    values = dict(zip(table, prediction.values, strict=True))
    amplitudes = np.exp([values[(0, k, 1, 1, Part.LOG_MAGNITUDE)] for k in range(2)])
    test = BackboneTable("table", 1, MeasuredChannel("x1", Quantity.DISPLACEMENT, 1), amplitudes)
    own = [(0, k, 0, 1, part) for k in range(2) for part in (Part.LOG_FREQUENCY, Part.DAMPING)]
    got = Forward([test], rows_of(own, 24.0)).predict(rig).values
    frequency = [values[(0, k, -1, -1, Part.LOG_FREQUENCY)] for k in range(2)]
    np.testing.assert_allclose(got[::2], frequency, atol=1e-8)
    # Power balance with the two masses; the acceleration of the second mass is the third channel.
    for k in range(2):
        omega = math.exp(frequency[k])
        force = math.exp(values[(0, k, 0, 1, Part.LOG_MAGNITUDE)])
        second = math.exp(values[(0, k, 2, 1, Part.LOG_MAGNITUDE)]) / omega**2
        power = 0.5 * force * omega * amplitudes[k]
        expected = power / (omega**3 * (0.5 * amplitudes[k] ** 2 + 0.3 * second**2))
        assert got[2 * k + 1] == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("kind", ["linear", "jenkins", "cubic", "stop", "factor"])
def test_a_record_against_the_plant(kind):
    """Two tones at once, from rest: the prediction by the recorded voltage against the time integration."""
    elements = {
        "jenkins": [{"kind": "jenkins", "point": 2, "tangential_stiffness_n_m": 4000.0, "slip_force_n": 0.3}],
        "cubic": [{"kind": "cubic_spring", "point": 2, "other_point": 1, "stiffness_n_m3": 2e9}],
        "stop": [{"kind": "unilateral_stop", "point": 1, "stiffness_n_m": 1e4, "gap_m": 1e-4}],
    }.get(kind, [])
    exciter = dict(SHAKER)
    if kind == "factor":
        exciter.update(force_factor_linear_per_m=300.0, force_factor_quadratic_per_m2=-2e5)
    rig = chain(local_elements=elements, exciter=exciter)
    y = run(rig, 23.0, 3.0, 0.5)
    channels = tuple(c for c in channels_of(rig) if c.quantity != Quantity.VOLTAGE)
    count = y["u"].size
    picks = np.arange(100, count - 100, 7)
    table = [(0, 0, channel, 1, Part.SAMPLE) for channel in range(3) for _ in picks]
    rows = rows_of(table)
    rows.time_s[:] = np.tile(picks / 1e4, 3)
    test = DrivenRecord(
        "record", 1, 1e4, MeasuredChannel("u", Quantity.VOLTAGE, 0), y["u"], channels, np.array([0.0, count])
    )
    values = Forward([test], rows).predict(rig).values.reshape(3, -1)
    for row, name in enumerate(("f1", "x1", "a2")):
        expected = y[name][picks]
        limit = 0.02 if name == "f1" else 5e-3
        # But for a constant: that of a transient which the cut has left out.
        assert np.std(values[row] - expected) < limit * np.std(expected), name


def test_a_record_of_one_mass_driven_by_a_measured_force():
    rig = oscillator([{"kind": "cubic_spring", "point": 1, "stiffness_n_m3": 1e9}])
    y = run(rig, 29.0, 2.0, 0.5)
    picks = np.arange(100, 4900, 11)
    rows = rows_of([(0, 0, 0, 1, Part.SAMPLE)] * picks.size)
    rows.time_s[:] = 3.0 + picks / 1e4
    test = DrivenRecord(
        "record", 1, 1e4, MeasuredChannel("f1", Quantity.FORCE, 1), y["f1"],
        (MeasuredChannel("x1", Quantity.DISPLACEMENT, 1),), np.array([0.0, 5000.0]), 3.0,
    )  # fmt: skip
    values = Forward([test], rows).predict(rig).values
    expected = y["x1"][picks]
    assert np.std(values - expected) < 2e-3 * np.std(expected)


def test_sources_span_what_an_effect_at_their_place_does():
    """A weak cubic spring at point 2 acts as forces at point 2: no other place explains it to the last bit."""
    rig = chain()
    test, table = locked(rig, [level(v, 24.0) for v in (0.5, 2.0)], "x1")
    noise, more = noise_test(rig, 5.0, 60.0, 12, test=1)
    forward = Forward([test, noise], rows_of([*table, *more]))
    prediction = forward.predict(rig)
    operating = operating_range(rig, [test, noise])
    own = {c.label: c for c in candidates(rig, operating)}
    left = {}
    for label in ("cubic_stiffness@2", "viscous_damping@2", "suspension_cubic", "response_gain@a2", "phase_offset"):
        parametrisation = Parametrisation(rig, (), (own[label],))
        signature = forward.jacobian(parametrisation, np.zeros(1), prediction)[:, 0]
        for place in (AT_2, Source("structure", 1), EXCITER, A2, FORCE, LOOP):
            columns, names = forward.influence(rig, prediction, place)
            assert columns.shape == (len(signature), len(names))
            if columns.shape[1]:
                rest = signature - columns @ np.linalg.lstsq(columns, signature, rcond=1e-10)[0]
                left[label, place] = np.linalg.norm(rest) / np.linalg.norm(signature)
    for label, place in (
        ("cubic_stiffness@2", AT_2), ("viscous_damping@2", AT_2), ("suspension_cubic", EXCITER),
        ("response_gain@a2", A2), ("phase_offset", LOOP),
    ):  # fmt: skip
        assert left[label, place] < 0.02, (label, place, left[label, place])
    assert left["cubic_stiffness@2", LOOP] > 0.9
    assert left["response_gain@a2", LOOP] > 0.9
    assert left["cubic_stiffness@2", FORCE] > 0.1


def test_a_drift_has_three_sources():
    rig = chain()
    test, table = locked(rig, [level(v, 24.0) for v in (0.5, 2.0)], "x1")
    forward = Forward([test], rows_of(table))
    assert forward.influence(rig, forward.predict(rig), Source("time"))[0].shape[1] == 3


def test_what_the_twin_does_not_cover_is_said():
    rig = chain()
    test, table = locked(rig, [level(0.5, 24.0)], "x1")
    forward = Forward([test], rows_of(table))
    backlash = {"kind": "backlash_damper", "point": 1, "stiffness_n_m": 1.0, "damping_ns_m2": 1.0, "gap_m": 1e-4}
    bristles = {"coulomb_force_n": 1.0, "static_force_n": 1.0, "stribeck_velocity_m_s": 1.0}
    lugre = {"kind": "lugre", "point": 1, "bristle_stiffness_n_m": 1.0, **bristles}
    for element in (backlash, lugre):
        with pytest.raises(BenchError, match=element["kind"]):
            forward.predict(chain(local_elements=[element]))
    loose = [{"quantity": "force"}, {"quantity": "displacement", "point": 1, "dead_zone": 1e-5}]
    with pytest.raises(BenchError, match="dead_zone"):
        forward.predict(chain(sensors=loose))
    with pytest.raises(BenchError, match="point 2"):
        forward.predict(oscillator())


def test_a_level_without_solution_is_nan_and_said():
    rig = chain()
    test, table = locked(rig, [level(0.5, 24.0), level(math.nan, 24.0)], "x1")
    prediction = Forward([test], rows_of(table)).predict(rig)
    levels = np.array([row[1] for row in table])
    assert np.all(np.isfinite(prediction.values[levels == 0]))
    assert np.all(np.isnan(prediction.values[levels == 1]))
    assert len(prediction.reasons) == 1
    assert "level 1" in prediction.reasons[0]


def test_every_candidate_gives_a_rig_that_the_plant_accepts():
    """Effects are rig files: with plain values, validated from scratch, and unchanged where they are absent."""
    for rig in (chain(), load_rig("beam"), oscillator()):
        response = "x2" if rig.name == "beam" else "x1"
        test, _ = locked(rig, [level(0.5, first_mode(rig))], response)
        found = candidates(rig, operating_range(rig, [test]))
        assert {c.effect.name for c in found} <= {effect.name for effect in library()}
        assert len({c.cause for c in found}) == len(found)
        for own in found:
            parametrisation = Parametrisation(rig, (), (own,))
            assert parametrisation.rig(parametrisation.zero) is rig, own.label
            theta = np.where([p.kind == "strength" for p in own.effect.parameters], 1.0, 0.0)
            changed = parametrisation.rig(theta)
            again = validate_rig(RigDocument("changed", changed.model_dump(exclude_none=True), {}))
            assert again != rig, own.label
            assert again == changed, own.label
            reported = parametrisation.reported(theta, 0)
            assert all(math.isfinite(value) for value, _ in reported.values()), own.label


def test_parametrisation_orders_and_scales():
    rig = load_rig("beam")
    test, _ = locked(rig, [level(1.0, 20.0)], "x2")
    library = [c for c in candidates(rig, operating_range(rig, [test])) if not c.cause.form]
    own = [c for c in library if c.label in ("one_sided_stop@4", "force_gain@f2")]
    parametrisation = Parametrisation(rig, calibration_parameters(rig)[:1], tuple(own))
    assert parametrisation.names == (
        "structure.youngs_modulus_pa", "one_sided_stop@4.k", "one_sided_stop@4.gap", "force_gain@f2.g",
    )  # fmt: skip
    np.testing.assert_array_equal(parametrisation.prior_std, [1.0, 3.0, 1.0, 3.0])
    np.testing.assert_array_equal(parametrisation.lower, [-np.inf, 0.0, -np.inf, -np.inf])
    changed = parametrisation.rig(np.array([2.0, 1.0, math.log(0.5), -1.0]))
    assert changed.structure.youngs_modulus_pa == pytest.approx(185e9 * math.exp(0.02))
    stop = changed.local_elements[-1]
    assert stop.gap_m == pytest.approx(0.5 * own[0].site.scales["gap"])
    assert changed.sensors[0].gain == pytest.approx(0.98)
    assert parametrisation.rig(np.array([0.0, -1.0, 0.0, 0.0])) is rig
    with pytest.raises(BenchError, match="no effect"):
        effect_named("magic")


def test_a_second_drive_point_moves_the_exciter_and_its_side():
    rig = load_rig("beam")
    spring = {"kind": "linear_spring", "point": 2, "side": "exciter", "stiffness_n_m": 500.0}
    values = rig.model_dump(exclude_none=True)
    values["local_elements"] = [spring]
    here = rig_of(values)
    values["exciter"]["point"] = 4
    values["local_elements"] = [{**spring, "point": 4}]
    there = rig_of(values)
    test, table = noise_test(there, 5.0, 300.0, 10)
    forward = Forward([test], rows_of(table))
    np.testing.assert_array_equal(forward.predict(here).values, forward.predict(there).values)


@pytest.mark.parametrize("label", ["cubic_stiffness@1", "air_drag@2", "second_friction_contact@1", "preload_loss"])
def test_jacobian_of_an_effect_that_the_solved_rig_lacks(label):
    """Its coordinate, or its drift, appears with the step only; differences of solutions know nothing of that."""
    rig = chain()
    levels = [level(v, first_mode(rig) * 0.97, start=10.0 * k) for k, v in enumerate((0.5, 2.0))]
    test, table = locked(rig, levels, "x1")
    forward = Forward([test], rows_of(table), PLAIN)
    own = next(c for c in candidates(rig, operating_range(rig, [test])) if c.label.startswith(label))
    parametrisation = Parametrisation(rig, (), (own,))
    start = forward.predict(rig)
    assert not start.reasons
    theta = parametrisation.zero
    position = next(k for k, p in enumerate(own.effect.parameters) if p.kind == "strength")
    jacobian = forward.jacobian(parametrisation, theta, start, [position])[:, 0]
    h = 2e-3
    one, two = theta.copy(), theta.copy()
    one[position], two[position] = h, 2 * h
    a, b = (forward.difference(forward.predict(parametrisation.rig(t), start).values, start.values) for t in (one, two))
    # One-sided and of second order: many strengths cannot be negative.
    expected = (4.0 * a - b) / (2.0 * h)
    assert np.max(np.abs(expected)) > 0.0
    np.testing.assert_allclose(jacobian, expected, atol=4e-3 * np.max(np.abs(expected)))


@pytest.mark.parametrize("name", ["beam", "pair"])
def test_poles_followed_to_first_order_miss_the_second_order_only(name):
    """Halving a change of the rig quarters what following its poles leaves of the new poles' transfer functions."""
    # Overdamped poles lie close together; at steps a hundred times those of a fit they would be found again.
    with moved_threshold("prediction.largest_shape_mix", 0.1):
        rig = load_rig("beam") if name == "beam" else chain()
        channels = channels_of(rig)
        basis = FourierBasis.up_to(3)
        parts = rig_parts(rig, channels, basis, PLAIN)
        structure = {"beam": ("youngs_modulus_pa", "density_kg_m3", "stiffness_damping_s"),
                     "pair": ("masses_kg", "springs_n_m", "dampers_ns_m")}[name]  # fmt: skip
        exciter = ("table_mass_kg", "table_stiffness_n_m", "table_damping_ns_m", "coil_mass_kg", "force_factor_n_a",
                   "resistance_ohm", "inductance_h")  # fmt: skip
        paths = [*(("structure", key) for key in structure), *(("exciter", key) for key in exciter)]
        points = 2j * np.pi * np.array([7.0, 23.0, 90.0, 300.0]) - 0.5
        for path in paths:
            left = []
            for step in (2e-5, 1e-5):
                value = value_at(rig, path)
                grown = [v * (1 + step) for v in value] if isinstance(value, list) else value * (1 + step)
                moved = with_value(rig, path, grown)
                exact = rig_parts(moved, channels, basis, PLAIN)
                followed = rig_parts(moved, channels, basis, PLAIN, near=parts)
                assert followed.linear.frame is None, path
                error = change = 0.0
                for s in points:
                    wanted, got, was = (own.linear.at(s)[0] for own in (exact, followed, parts))
                    size = np.max(np.abs(wanted), axis=0)
                    error = max(error, float(np.max(np.abs(got - wanted) / size)))
                    change = max(change, float(np.max(np.abs(was - wanted) / size)))
                left.append(error)
            assert change > 0.0, path
            assert left[0] < 2e-2 * change + 5e-10, path
            assert left[1] < 0.35 * left[0] + 5e-10, path
    with moved_threshold("prediction.largest_shape_mix", 0.0):
        again = rig_parts(moved, channels, basis, PLAIN, near=parts)
    assert again.linear.frame is not None
    np.testing.assert_array_equal(again.linear.poles, exact.linear.poles)


def test_poles_are_followed_as_far_as_the_first_order_is_right_to_a_millionth():
    """A step further would be worse than that, one that is far smaller would be found again for nothing."""
    rig, basis = chain(), FourierBasis.up_to(3)
    channels = channels_of(rig)
    parts = rig_parts(rig, channels, basis, PLAIN)
    value, points = rig.structure.springs_n_m, 2j * np.pi * np.array([7.0, 23.0, 90.0]) - 0.5
    errors = []
    for step in np.geomspace(1e-6, 1e-1, 41):
        moved = with_value(rig, ("structure", "springs_n_m"), [v * (1.0 + step) for v in value])
        followed = rig_parts(moved, channels, basis, PLAIN, near=parts)
        if followed.linear.frame is not None:  # found again
            break
        exact = rig_parts(moved, channels, basis, PLAIN)
        pairs = [(exact.linear.at(s)[0], followed.linear.at(s)[0]) for s in points]
        errors.append(max(float(np.max(np.abs(b - a)) / np.max(np.abs(a))) for a, b in pairs))
    assert 1e-7 < max(errors) < 1e-6


@pytest.mark.parametrize("path", [
    ("structure", "youngs_modulus_pa"), ("structure", "density_kg_m3"), ("exciter", "table_mass_kg"),
    ("exciter", "inductance_h"), ("sensors", 1, "mass_kg"), ("sensors", 2, "gain"),
    ("local_elements", 0, "tangential_stiffness_n_m"), ("local_elements", 1, "stiffness_n_m"),
    ("drift", "slip_force_per_s"), ("drift", "stiffness_per_s"), (),
])  # fmt: skip
def test_what_a_moved_rig_shares_with_another_is_what_it_has_itself(path):
    """Taken apart alone and beside a rig that differs in one number, both made anew as the steps of a fit are."""

    def made() -> Rig:
        return with_element(load_rig("beam"), LinearSpringSection(kind="linear_spring", point=4, stiffness_n_m=200.0))

    setup = Setup((2,), False, channels_of(made()), FourierBasis.up_to(3))
    base = PartsCache(PLAIN)
    for seconds in (0.0, 50.0):
        base.parts(made(), setup, seconds)
    rig, cache = made(), PartsCache(PLAIN, base)
    if path:
        rig = with_value(rig, path, value_at(rig, path) * (1.0 + 1e-6) + 1e-9)
    for seconds in (0.0, 50.0):
        own = rig_parts(rig, setup.channels, setup.basis, PLAIN, seconds)
        found = cache.parts(rig, setup, seconds)
        for name in ("mass", "damping", "stiffness"):
            np.testing.assert_array_equal(getattr(found.system, name), getattr(own.system, name))
        for name in ("displacement", "velocity", "acceleration", "feedthrough"):
            np.testing.assert_array_equal(getattr(found.rows, name), getattr(own.rows, name))
        for mine, theirs in zip(found.tables, own.tables, strict=True):
            np.testing.assert_array_equal(mine, theirs)
        np.testing.assert_array_equal(found.channels, own.channels)
        for s in (40j, 150j - 1.0):
            np.testing.assert_allclose(found.linear.at(s)[0], own.linear.at(s)[0], rtol=1e-8, atol=1e-14)
    moves = (
        "structure",
        "youngs_modulus_pa",
        "density_kg_m3",
        "exciter",
        "mass_kg",
        "stiffness_n_m",
        "stiffness_per_s",
    )
    own = any(part in moves for part in path)
    assert (cache.parts(rig, setup).linear is not base.parts(rig, setup).linear) == own


def test_slip_forces_that_drift_take_nothing_else_along():
    rig = with_value(load_rig("beam"), ("drift", "slip_force_per_s"), -1e-3)
    setup = Setup((2,), False, channels_of(rig), FourierBasis.up_to(3))
    cache = PartsCache(PLAIN)
    first, later = (cache.parts(rig, setup, seconds) for seconds in (10.0, 200.0))
    assert later.linear is first.linear
    own = rig_parts(rig, setup.channels, setup.basis, PLAIN, 200.0)
    for mine, theirs in zip(later.tables, own.tables, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert first.tables.jenkins[0, 1] == pytest.approx(0.99)
    assert later.tables.jenkins[0, 1] == pytest.approx(0.8)


def test_a_held_drive_folds_its_images_onto_the_lines():
    """Against the sum over many images; those beyond them are small."""
    rig, rate = load_rig("beam"), 2000.0
    plain, table = noise_test(rig, 20.0, 100.0, 9, window="none")

    def responses(test) -> np.ndarray:
        values = Forward([test], rows_of(table), PLAIN).predict(rig).values
        return (np.exp(values[0::2]) * np.exp(1j * values[1::2])).reshape(plain.lines_hz.size, -1)

    expected = np.zeros((plain.lines_hz.size, len(plain.channels)), dtype=complex)
    for order in range(-300, 301):
        place = plain.lines_hz + order * rate
        image = responses(replace(plain, lines_hz=np.abs(place)))
        expected += np.sinc(place / rate)[:, None] ** 2 * np.where(place[:, None] > 0.0, image, image.conj())
    found = responses(replace(plain, drive_hold_hz=rate))
    np.testing.assert_allclose(found, expected, rtol=1e-4)
    assert np.max(np.abs(found / responses(plain) - 1.0)) > 1e-4


def test_a_backbone_table_is_the_modes_own_whatever_the_sensors_do():
    rig = chain()
    amplitudes = np.array([1e-4, 1e-3])
    test = BackboneTable("table", 1, MeasuredChannel("x1", Quantity.DISPLACEMENT, 1), amplitudes)
    own = [(0, k, 0, 1, part) for k in range(2) for part in (Part.LOG_FREQUENCY, Part.DAMPING)]
    forward = Forward([test], rows_of(own, 24.0))
    expected = forward.predict(rig).values

    def with_sensor(quantity, **changes):
        sensors = [s.model_copy(update=changes) if s.quantity == quantity else s for s in rig.sensors]
        return forward.predict(rig.model_copy(update={"sensors": sensors})).values

    for changes in ({"high_pass_hz": 2.0}, {"delay_s": 1e-3}, {"gain": 1.3}):
        np.testing.assert_allclose(with_sensor("force", **changes), expected, rtol=1e-9)
    np.testing.assert_allclose(with_sensor("displacement", delay_s=1e-3), expected, rtol=1e-9)
    # The amplitudes are what their channel shows.
    louder = BackboneTable("table", 1, MeasuredChannel("x1", Quantity.DISPLACEMENT, 1), amplitudes / 1.3)
    np.testing.assert_allclose(
        with_sensor("displacement", gain=1.3), Forward([louder], rows_of(own, 24.0)).predict(rig).values, rtol=1e-9
    )


def test_real_poles_of_overdamped_modes_stay_real_when_they_are_followed():
    """Half of a record's poles would be lost to imaginary parts that are rounding."""
    rig, basis = with_value(load_rig("beam"), ("structure", "stiffness_damping_s"), 3e-4), FourierBasis.up_to(3)
    channels = channels_of(rig)
    parts = rig_parts(rig, channels, basis, PLAIN)
    real = parts.linear.poles.imag == 0.0
    assert real.sum() > 4
    moved = with_value(rig, ("structure", "density_kg_m3"), rig.structure.density_kg_m3 * (1.0 + 1e-7))
    followed = rig_parts(moved, channels, basis, PLAIN, near=parts)
    assert followed.linear.frame is None
    np.testing.assert_array_equal(followed.linear.poles.imag == 0.0, real)
    rows = np.arange(parts.coordinates)
    before, after = (stepped_model(it.linear, it.coordinates, rows, 1e-4) for it in (parts, followed))
    np.testing.assert_allclose(after.decay, before.decay, rtol=1e-4)
