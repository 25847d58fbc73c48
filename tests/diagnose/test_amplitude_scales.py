"""Backbones and decays bring their own scale: the same data in other amplitudes are judged the same."""

from __future__ import annotations

from dataclasses import replace
from math import pi, sqrt
from typing import Any

import numpy as np
import pytest
from diagnose.predicted_observations import observations_of_model
from diagnose.predicted_tests import chain
from scipy.integrate import solve_ivp
from tiers import with_quick

from nmt_core.messages.blocks import Quantity
from nmt_diagnose.chain.chain_columns import linear_chain, scale_columns
from nmt_diagnose.diagnose import diagnose_observations
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.effects.library import library
from nmt_diagnose.ledger.diagnosis import Diagnosis, Verdict
from nmt_diagnose.measurements.backbone_table import BackboneTable
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.driven_record import DrivenRecord
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.measurements.random_responses import RandomResponses
from nmt_diagnose.measurements.recorded_decay import RecordedDecay
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Part, Rows
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.observations.read_tables import table_observations
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.prediction.operating_range import operating_range
from nmt_record.exchange.reduced.observables import ObservableTable
from nmt_record.exchange.sidecar.import_sidecar import TableKind
from nmt_rig.model.assembly import displacement_output
from nmt_rig.model.time_integration import TimeIntegrator
from nmt_rig.rig import ForceSection, Rig, validate_rig
from nmt_rig.rig_file import RigDocument
from nmt_rig.rig_model import build_structure, build_system

HZ, RATIO = 133.0, 0.0035
OMEGA = 2.0 * pi * HZ
# Largest amplitude of the backbone, m, and the cubic force there over the linear one.
TOP, SHARE = 5e-4, 4.0
SCATTER = 5e-3
KNOWN = ("cubic_stiffness", "quintic_stiffness", "two_sided_gap", "added_mass")


def oscillator() -> Rig:
    """1 kg on a spring, pushed by a force."""
    values: dict[str, Any] = {
        "name": "oscillator",
        "structure": {
            "kind": "chain",
            "masses_kg": [1.0],
            "ground_springs_n_m": [OMEGA**2],
            "ground_dampers_ns_m": [2.0 * RATIO * OMEGA],
        },
        "exciter": {"kind": "force", "point": 1, "newton_per_volt": 1.0},
        "sensors": [{"quantity": "force", "point": "drive"}, {"quantity": "displacement", "point": 1}],
        "extraction": {"quantity": "displacement", "linear_modes": 1},
    }
    return validate_rig(RigDocument("test", values, {}))


def free_vibration(peak: float, cubic: float) -> tuple[float, float]:
    """ω, and amplitude of the fundamental, of a mass on a linear and a cubic spring that is let go at a peak."""

    def rest(_: float, y: np.ndarray) -> float:
        return float(y[1])

    rest.terminal, rest.direction = True, 1.0  # type: ignore[attr-defined]
    run = solve_ivp(
        lambda _, y: [y[1], -(OMEGA**2) * y[0] - cubic * y[0] ** 3], (0.0, 2.0 * pi / OMEGA), [peak, 0.0],
        events=rest, rtol=1e-10, atol=1e-14, dense_output=True,
    )  # fmt: skip
    half = float(run.t_events[0][0])
    times = np.arange(2000) / 2000 * half
    fundamental = 2.0 * np.mean(run.sol(times)[0] * np.exp(-1j * pi * times / half))
    return pi / half, float(abs(fundamental))


def backbone(scale: float) -> Observations:
    """A backbone with scatter as laboratories have it, its amplitudes in another unit, so to say."""
    cubic = SHARE * OMEGA**2 / TOP**2
    points = [free_vibration(peak, cubic) for peak in np.linspace(0.1, 1.0, 10) * TOP]
    amplitudes = scale * np.array([amplitude for _, amplitude in points])
    noise = np.random.default_rng(5).standard_normal(len(points)) * SCATTER
    values = np.log([omega for omega, _ in points]) + noise
    count = len(points)
    same = lambda value: np.full(count, value, dtype=np.int64)  # noqa: E731
    rows = Rows(
        same(0), np.arange(count, dtype=np.int64), same(0), same(1), same(int(Part.LOG_FREQUENCY)), np.zeros(count),
        np.exp(values) / (2.0 * pi), amplitudes,
    )  # fmt: skip
    channel = MeasuredChannel("x1", Quantity.DISPLACEMENT, 1)
    test = BackboneTable("backbone", 1, channel, amplitudes)
    return Observations((test,), rows, values, np.full(count, SCATTER), np.zeros(count))


def diagnosed(scale: float) -> Diagnosis:
    withheld = tuple(effect.name for effect in library() if effect.name not in KNOWN)
    return diagnose_observations(
        oscillator(), backbone(scale), DiagnosisSettings(withheld=withheld, look_ahead=False)
    ).diagnosis


@pytest.fixture(scope="module")
def plain() -> Diagnosis:
    return diagnosed(1.0)


def test_a_cubic_force_many_times_the_linear_one_is_named(plain: Diagnosis) -> None:
    assert plain.verdict is Verdict.EFFECT
    first = plain.ranking[0]
    assert first.effect == "cubic_stiffness"
    assert first.parameters["k"].value == pytest.approx(SHARE * OMEGA**2 / TOP**2, abs=3.0 * first.parameters["k"].std)
    # The scale of the motion, 1 %, is 2 % of k.
    assert first.parameters["k"].std > 0.015 * first.parameters["k"].value
    assert plain.gap.closed > 0.9


@pytest.mark.parametrize("scale", with_quick([0.01, 100.0], 100.0))
def test_amplitudes_in_other_units_change_nothing(plain: Diagnosis, scale: float) -> None:
    other = diagnosed(scale)
    assert other.verdict is plain.verdict
    assert other.ranking[0].effect == plain.ranking[0].effect
    assert other.ranking[0].probability == pytest.approx(plain.ranking[0].probability, abs=0.01)
    assert other.probabilities["unknown"] == pytest.approx(plain.probabilities["unknown"], abs=0.01)
    assert other.gap.closed == pytest.approx(plain.gap.closed, abs=0.01)
    k, wanted = other.ranking[0].parameters["k"], plain.ranking[0].parameters["k"]
    assert k.value * scale**2 == pytest.approx(wanted.value, rel=0.01)


def test_the_gain_of_a_decays_channel_is_an_error_of_the_chain_and_counts_once() -> None:
    values = {**oscillator().model_dump(), "local_elements": [{"kind": "cubic_spring", "point": 1,
              "stiffness_n_m3": SHARE * OMEGA**2 / TOP**2}]}  # fmt: skip
    rig = validate_rig(RigDocument("test", values, {}))
    table = backbone(1.0)
    amplitudes = np.sort(table.tests[0].amplitudes)[::-1]  # type: ignore[union-attr]
    decay = RecordedDecay("decay", 1, MeasuredChannel("x1", Quantity.DISPLACEMENT, 1), amplitudes, HZ)
    decays = replace(table, tests=(decay,), chains=(MeasuringChain(),))
    found = Forward(decays.tests, decays.rows).predict(rig)
    chain = linear_chain(decays, rig, found)
    column = chain.columns[:, chain.names.index("gain x1")]
    cubic, peaks = SHARE * OMEGA**2 / TOP**2, TOP * np.array([0.999, 1.001])
    (low, small), (high, large) = (free_vibration(peak, cubic) for peak in peaks)
    slope = np.log(high / low) / np.log(large / small)
    assert abs(column[0]) == pytest.approx(MeasuringChain().of("x1").gain * slope, rel=0.02)
    assert scale_columns(decays, rig, found).shape[1] == 0
    assert scale_columns(table, rig, Forward(table.tests, table.rows).predict(rig)).shape[1] == 1


@pytest.mark.parametrize(
    ("quantity", "derivatives"), [(Quantity.DISPLACEMENT, 0), (Quantity.VELOCITY, 1), (Quantity.ACCELERATION, 2)]
)
def test_the_scale_of_a_table_and_of_a_decay_is_their_own_amplitude(quantity: Quantity, derivatives: int) -> None:
    channel = MeasuredChannel("y1", quantity, 1)
    amplitudes = np.array([2e-4, 3e-3]) * OMEGA**derivatives
    for test in (
        BackboneTable("table", 1, channel, amplitudes),
        RecordedDecay("decay", 1, channel, amplitudes[::-1], HZ),
    ):
        found = operating_range(oscillator(), [test], observations=backbone(1.0))
        assert found.displacement[1] == pytest.approx(3e-3, rel=1e-9)
        assert found.omega == pytest.approx(OMEGA, rel=1e-9)
        assert found.channels["x1"] == pytest.approx(3e-3, rel=1e-9)
        assert found.channels_low["x1"] == pytest.approx(2e-4, rel=1e-9)


def test_the_mode_of_a_table_is_the_one_at_its_frequency() -> None:
    rig = chain()
    squares = np.linalg.eigvals(
        np.linalg.solve(np.diag([0.5 + 0.024 + 0.019, 0.3]), [[58707.0, -18000.0], [-18000.0, 21000.0]])
    )
    low, high = sorted(sqrt(value) / (2.0 * pi) for value in squares)
    channel = MeasuredChannel("x1", Quantity.DISPLACEMENT, 1)
    for frequency in (low, high):
        test = BackboneTable("table", 1, channel, np.array([1e-3]))
        one = backbone(1.0).take(np.arange(1))
        found = operating_range(
            rig, [test], observations=replace(one, rows=replace(one.rows, frequency_hz=np.array([frequency])))
        )
        assert found.omega == pytest.approx(2.0 * pi * frequency, rel=0.02)
        assert found.displacement[1] == pytest.approx(1e-3, rel=1e-9)
    # Without frequencies: the mode that the rig file says is tested.
    assert operating_range(rig, [test]).omega == pytest.approx(2.0 * pi * low, rel=0.02)


def test_without_any_motion_the_scale_is_a_millimetre_at_the_mode_under_test() -> None:
    test = RandomResponses("frf", 1, (), "force", np.array([HZ]), 1.0, "none", 0.0, 0.0, 0.0)
    found = operating_range(oscillator(), [test])
    assert found.displacement[1] == pytest.approx(1e-3)
    assert found.omega == pytest.approx(OMEGA, rel=1e-9)


def test_a_backbone_whose_resonance_doubles_has_a_prediction_at_every_amplitude() -> None:
    """The linear model stays at its resonance, and the model with the spring follows: no level goes without."""
    observations = backbone(1.0)
    forward = Forward(observations.tests, observations.rows)
    assert np.exp(observations.values[-1] - observations.values[0]) > 1.9
    assert forward.predict(oscillator()).values == pytest.approx(np.full(10, np.log(OMEGA)), abs=1e-4)
    spring = {"kind": "cubic_spring", "point": 1, "stiffness_n_m3": SHARE * OMEGA**2 / TOP**2}
    values = {**oscillator().model_dump(), "local_elements": [spring]}
    truth = validate_rig(RigDocument("test", values, {}))
    assert forward.predict(truth).values == pytest.approx(observations.values, abs=4.0 * SCATTER)


def test_motions_that_the_model_is_far_from_are_taken_as_measured() -> None:
    model = chain()
    observations = observations_of_model(model, noise=0.0, drives=(0.1, 0.4, 1.6))
    plain = operating_range(model, observations.tests)
    # Samples that were looked at show no step of a converter; without samples nothing says so.
    same = operating_range(model, observations.tests, observations=observations)
    assert set(same.steps.values()) == {0.0}
    assert replace(same, steps={}, delays={}) == plain
    motion = (
        (observations.rows.part == Part.LOG_MAGNITUDE) & (observations.rows.channel > 0) & (observations.rows.test == 0)
    )
    motion &= observations.rows.harmonic == 1
    run = observations.take(observations.rows.test == 0)
    far = replace(run, tests=run.tests[:1], values=run.values + np.log(30.0) * motion[observations.rows.test == 0])
    alone = operating_range(model, far.tests)
    found = operating_range(model, far.tests, observations=far)
    assert found.displacement[2] == pytest.approx(30.0 * alone.displacement[2], rel=1e-3)
    assert found.channels["a2"] == pytest.approx(30.0 * alone.channels["a2"], rel=1e-3)
    assert found.channels_low["a2"] == pytest.approx(30.0 * alone.channels_low["a2"], rel=1e-3)
    assert (found.omega, found.voltage) == (alone.omega, alone.voltage)
    lines = observations.take(observations.rows.test == 1)
    lines = replace(
        lines, tests=lines.tests[1:], rows=replace(lines.rows, test=np.zeros(len(lines.rows), dtype=np.int64))
    )
    alone = operating_range(model, lines.tests)
    assert replace(operating_range(model, lines.tests, observations=lines), delays={}) == alone
    louder = replace(lines, values=lines.values + np.log(5.0) * (lines.rows.part == Part.LOG_MAGNITUDE))
    found = operating_range(model, lines.tests, observations=louder)
    assert found.displacement[1] == pytest.approx(5.0 * alone.displacement[1], rel=0.02)


def test_the_noise_of_a_table_without_level_counts() -> None:
    frequency = np.linspace(120.0, 145.0, 12)
    response = 1.0 / (OMEGA**2 - (2.0 * pi * frequency) ** 2 + 2j * RATIO * OMEGA * 2.0 * pi * frequency)
    columns = {"frequency_hz": frequency, "real": response.real, "imag": response.imag}
    table = ObservableTable(TableKind.FRF, columns, {}, Quantity.DISPLACEMENT, point=1, drive_point=1, noise=0.005)
    found = table_observations("table", [table], oscillator(), ObservationSettings())
    assert np.allclose(found.std, 0.005)
    assert not found.notes


def test_damping_ratios_without_uncertainties_count_by_their_scatter() -> None:
    """5 % are taken at least; ratios that grow smoothly by as much as they are do not scatter."""
    amplitude = np.linspace(0.1, 1.0, 16) * TOP
    columns = {"frequency_hz": np.full(16, OMEGA / (2.0 * pi)), "amplitude": amplitude}
    smooth = 0.002 * (1.0 + (amplitude / TOP) ** 2)
    shares = {}
    for scatter in (0.01, 0.15):
        found = []
        for seed in range(20):
            ratio = smooth * np.exp(scatter * np.random.default_rng(seed).standard_normal(16))
            table = ObservableTable(TableKind.BACKBONE, {**columns, "damping_ratio": ratio}, {}, Quantity.DISPLACEMENT)
            observations = table_observations("table", [table], oscillator(), ObservationSettings())
            (test,) = observations.tests
            assert isinstance(test, BackboneTable)
            assert 1.0 < test.noise_degrees < 10.0
            damping = observations.rows.part == Part.DAMPING
            found.append(observations.sigma[damping] / observations.values[damping])
        shares[scatter] = np.array(found)
    np.testing.assert_allclose(shares[0.01], 0.05)
    assert np.sqrt(np.mean(shares[0.15] ** 2)) == pytest.approx(0.15, rel=0.1)


def test_the_scale_of_a_record_is_its_largest_motion_and_the_largest_way_between_points() -> None:
    """Two masses under a chirp, by the bench's own time integration; and as measured, far from the model."""
    rig = chain()
    time = np.arange(20000) / 2e3
    force = np.sin(2.0 * pi * (45.0 + time) * time)
    free = rig.model_copy(update={"exciter": ForceSection(kind="force", point=1)})
    system = build_system(free, build_structure(free))
    outputs = [displacement_output(system, point) for point in (1, 2)]
    moved = TimeIntegrator(system, 2e3, outputs, substeps=8).advance(np.append(force, force[-1]))[:, : time.size]
    far = np.abs(moved[0] - moved[1]).max()
    assert far > 2.0 * abs(np.abs(moved[0]).max() - np.abs(moved[1]).max())
    channels = (MeasuredChannel("x1", Quantity.DISPLACEMENT, 1), MeasuredChannel("a2", Quantity.ACCELERATION, 2))
    test = DrivenRecord(
        "record", 1, 2e3, MeasuredChannel("f1", Quantity.FORCE, 1), force, channels, np.array([0.0, time.size])
    )
    found = operating_range(rig, [test])
    assert [found.displacement[point] for point in (1, 2)] == pytest.approx(np.abs(moved).max(axis=1), rel=0.02)
    assert found.pairs[1, 2][0] == pytest.approx(far, rel=0.02)
    assert found.channels_low["x1"] == found.channels["x1"] == pytest.approx(np.abs(moved[0]).max(), rel=0.02)
    sizes = np.array([found.channels["x1"], found.channels["a2"]])
    for factor, taken in ((5.0, 5.0), (1.5, 1.0)):
        measured = replace(test, responses=factor * sizes[:, np.newaxis] * np.sin(2.0 * pi * time))
        again = operating_range(rig, [measured])
        assert again.displacement[2] == pytest.approx(taken * found.displacement[2], rel=1e-3)
