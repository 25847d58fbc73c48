"""The diagnosis that measures its noise: scales, complex lines, verdicts under noise that is stated wrongly."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from diagnose.predicted_observations import chain, observations_of_model, real
from moved_threshold import moved_threshold
from scipy.integrate import quad
from scipy.optimize import minimize
from tiers import with_quick

from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import FloatArray
from nmt_diagnose.chain.chain_columns import SharedDelay, linear_chain
from nmt_diagnose.diagnose import diagnose_observations
from nmt_diagnose.diagnosis_settings import MATTERS, DiagnosisSettings
from nmt_diagnose.effects.calibration import calibration_parameters
from nmt_diagnose.effects.library import candidates, library
from nmt_diagnose.effects.location import Location
from nmt_diagnose.fit.best_fit import from_believed
from nmt_diagnose.fit.explanations import FittedExplanation, Score
from nmt_diagnose.fit.fitting import Effort, Start, best_chain_errors, data_about, fit
from nmt_diagnose.fit.low_level_modes import LowLevelModes
from nmt_diagnose.fit.model_alone import free_parameters, model_alone
from nmt_diagnose.fit.noise import Groups, groups_of
from nmt_diagnose.ledger.comparison import Hypotheses, SourceEvidence, laws
from nmt_diagnose.ledger.diagnosis import Diagnosis, Verdict
from nmt_diagnose.ledger.size import IMITATION
from nmt_diagnose.measurements.backbone_table import BackboneTable
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.locked_windows import LockedWindows
from nmt_diagnose.measurements.measurement import Observations, RowTable
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Part, Place
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.prediction.operating_range import operating_range
from nmt_diagnose.search.search import Search
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig, validate_rig
from nmt_rig.rig_file import RigDocument

MODEL = chain()
KNOWN = ("cubic_stiffness", "phase_offset", "viscous_damping", "response_gain")
WITHHELD = tuple(effect.name for effect in library() if effect.name not in KNOWN)
HARDENING = real(MODEL, local_elements=[{"kind": "cubic_spring", "point": 2, "stiffness_n_m3": 2e8}])


def observed(truth: Rig, seed: int = 6) -> Observations:
    return observations_of_model(truth, seed=seed, drives=(0.1, 0.2, 0.4, 0.8, 1.6))


def stated(observations: Observations, factor: float) -> Observations:
    """The same recordings with all uncertainties stated so many times as large."""
    return replace(observations, std=factor * observations.std, floor=factor * observations.floor)


def diagnosed(observations: Observations, **settings: object) -> Diagnosis:
    settings = {"withheld": WITHHELD, "look_ahead": False, **settings}
    return diagnose_observations(MODEL, observations, DiagnosisSettings(**settings)).diagnosis  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def hardening() -> Diagnosis:
    return diagnosed(observed(HARDENING))


def test_marginal_scale_is_the_integral_over_all_scales() -> None:
    nu, rows = 6.0, 9
    groups = Groups(np.zeros(rows, dtype=np.int64), ("all",), np.array([nu]), np.zeros(1))

    def density(squares: float) -> float:
        # s² is inverse-gamma distributed with shape and scale ν/2.
        def integrand(v: float) -> float:
            return float(v ** (-rows / 2) * np.exp(-squares / (2 * v)) * v ** (-nu / 2 - 1) * np.exp(-nu / (2 * v)))

        return quad(integrand, 1e-3, np.inf, limit=200)[0]

    counts = np.array([float(rows)])
    cost = [groups.cost(np.array([squares]), counts) for squares in (4.0, 40.0)]
    assert cost[1] - cost[0] == pytest.approx(-2.0 * np.log(density(40.0) / density(4.0)), rel=1e-6)


def test_known_scales_stay_one() -> None:
    groups = Groups(np.array([0, 0, 1]), ("learnt", "known"), np.array([6.0, np.inf]), np.zeros(2))
    counts = groups.counts(np.ones(3, dtype=bool))
    weights = groups.weights(np.array([100.0, 100.0]), counts)
    assert weights[0] < 0.1
    assert weights[1] == 1.0
    assert groups.cost(np.array([0.0, 7.0]), counts) == pytest.approx(7.0)


@pytest.mark.parametrize("factor", with_quick([0.4, 3.0], 3.0))
def test_a_healthy_rig_is_healthy_whatever_noise_is_stated(factor: float) -> None:
    found = diagnosed(stated(observed(MODEL), factor))
    assert found.verdict in (Verdict.NONE, Verdict.CALIBRATION)
    assert found.gap.after == pytest.approx(1.0, abs=0.25)


@pytest.mark.campaign
def test_uncertainties_follow_the_noise_that_is_there() -> None:
    found = [diagnosed(stated(observed(HARDENING), factor)).ranking[0] for factor in (1.0, 3.0)]
    assert [own.effect for own in found] == ["cubic_stiffness", "cubic_stiffness"]
    one, three = (own.parameters["k"] for own in found)
    # Five levels tell their own noise against the prior of a scale.
    assert one.std < three.std < 0.8 * 3.0 * one.std
    assert three.value == pytest.approx(2e8, abs=4.0 * three.std)


def test_an_effect_is_named_placed_and_closes_the_gap(hardening: Diagnosis) -> None:
    found = hardening
    assert found.verdict is Verdict.EFFECT
    assert (found.ranking[0].effect, found.ranking[0].detail) == ("cubic_stiffness", "2")
    assert found.where[0].place == "structure"
    assert found.gap.closed > 0.8
    assert found.ranking[0].converged


def laboratory(observations: Observations) -> Observations:
    own = MeasuringChain(hold_hz=1000.0)
    return replace(observations, chains=(own,) * len(observations.tests))


def test_images_of_a_held_drive_add_to_lines_however_small_a_response_is() -> None:
    observations = laboratory(observations_of_model(MODEL, seed=1, drives=(0.1, 0.4)))
    near = Forward(observations.tests, observations.rows).predict(MODEL)
    used = np.isfinite(near.values)
    data = data_about(observations, MODEL, near, used)
    image = [k for k, name in enumerate(data.chain_names) if name.startswith("image 0")]
    assert image
    errors = np.zeros(len(data.chain_names))
    errors[image[0]] = 1.0
    clean = observations.values + np.zeros(len(used))
    # What is recorded is the response and the image beside it.
    size, turned = data.lines
    response = np.exp(clean[size] + 1j * clean[turned])
    added = data.added[size, image[0]] + 1j * data.added[turned, image[0]]
    seen = response * (1.0 + added)
    values = clean.copy()
    values[size], values[turned] = np.log(np.abs(seen)), np.angle(seen)
    moved = data_about(replace(observations, values=values), MODEL, near, used)
    with_image = best_chain_errors(moved, near.values).cost
    without = best_chain_errors(
        replace(moved, added=np.zeros_like(moved.added), chain=np.zeros_like(moved.chain)), near.values
    )
    assert with_image < without.cost


def test_a_gain_within_the_tolerance_of_its_channel_is_no_effect() -> None:
    within = laboratory(observed(real(MODEL, sensors=_with_gain(1.01))))
    assert diagnosed(within).verdict in (Verdict.NONE, Verdict.CALIBRATION)


def _with_gain(gain: float) -> list[dict[str, object]]:
    sensors = [sensor.model_dump() for sensor in MODEL.sensors]
    number = next(k for k, sensor in enumerate(sensors) if sensor["quantity"] == "acceleration")
    sensors[number]["gain"] = gain
    return sensors


def test_delays_that_a_kind_of_sensors_shares_are_parameters_of_the_rig() -> None:
    delay = SharedDelay.of(Quantity.ACCELERATION, 1e-4)
    late = delay.apply(MODEL, 2.0)
    for before, after in zip(MODEL.sensors, late.sensors, strict=True):
        expected = 2e-4 if before.quantity == "acceleration" else 0.0
        assert after.delay_s - before.delay_s == pytest.approx(expected)
    assert delay.apply(MODEL, 0.0) is MODEL


def test_rows_of_one_kind_in_one_test_share_a_scale() -> None:
    observations = observed(MODEL)
    groups = groups_of(observations, np.zeros(len(observations.rows)))
    for part in (Part.LOG_FREQUENCY, Part.PHASE_ERROR):
        assert np.unique(groups.of[observations.rows.part == part]).size == 1
    assert np.unique(groups.of).size == len(groups.names)


@pytest.mark.parametrize("start", [20.0, 100.0])
def test_a_strength_beyond_its_ordinary_prior_is_found_from_where_the_score_puts_it(start: float) -> None:
    """A strength that its prior holds back would be taken for noise: the scale of the noise would grow instead."""
    search, cubic = _table_search()
    null = alone(search)
    found = search.with_added(
        null, Score(cubic, np.array([start]), 0.0, 1.0, np.zeros(search.data.sigma.size)), lost=np.inf
    )
    assert found is not None
    (value,) = found.fit.parametrisation.values(found.fit.theta, 0).values()
    assert value == pytest.approx(CUBIC, rel=0.1)


def test_strong_effects_are_climbed_from_low_levels() -> None:
    search, _ = _table_search()
    null = alone(search)
    best = search.singles(null, search.scores(null))[0]
    assert best.effects == ("cubic_stiffness",)
    (value,) = best.fit.parametrisation.values(best.fit.theta, 0).values()
    assert value == pytest.approx(CUBIC, rel=0.1)


CUBIC = 2.1e12


def alone(search: Search) -> FittedExplanation:
    """The model alone."""
    parametrisation = search.parametrisation()
    return FittedExplanation((), fit(search.data, parametrisation, Start("given", parametrisation.zero)))


def _table_search() -> tuple[Search, int]:
    """A backbone of seven amplitudes, its cubic force 1.3 times the linear one at the top, scatter 0.6 %."""
    model = validate_rig(
        RigDocument(
            "one_mode",
            {
                "name": "one_mode",
                "structure": {
                    "kind": "modal",
                    "modes": [{"frequency_hz": 133.1, "damping_ratio": 0.0035, "modal_mass_kg": 1.0}],
                },
                "test": {"levels": "0.01:1:8"},
            },
            {},
        )
    )
    amplitudes = np.linspace(5e-5, 6.5e-4, 7)
    linear = (2.0 * np.pi * 133.1) ** 2
    omega = np.sqrt(linear + 0.75 * CUBIC * amplitudes**2)
    channel = MeasuredChannel("x1", Quantity.DISPLACEMENT, 1, ideal=True)
    test = BackboneTable("table", 1, channel, amplitudes)
    table = RowTable()
    scatter = 0.006 * np.random.default_rng(4).standard_normal(7)
    for k, amplitude in enumerate(amplitudes):
        place = Place(k, np.nan, omega[k] / (2.0 * np.pi), amplitude)
        table.add(Part.LOG_FREQUENCY, float(np.log(omega[k]) + scatter[k]), 0.006, 0.0, place, 0, 1)
    observations = table.observations(test)
    given = Forward(observations.tests, observations.rows).predict(model)
    data = data_about(observations, model, given, np.isfinite(given.values))
    every = candidates(model, operating_range(model, observations.tests, observations=observations))
    known = [own for own in every if own.effect.name in ("cubic_stiffness", "air_drag", "one_sided_stop")]
    search = Search(data, model, calibration_parameters(model), known)
    return search, next(k for k, own in enumerate(known) if own.effect.name == "cubic_stiffness")


def test_a_channel_may_turn_all_frequencies_by_the_same_angle() -> None:
    observations = laboratory(observations_of_model(MODEL, drives=(0.1, 0.4)))
    near = Forward(observations.tests, observations.rows).predict(MODEL)
    found = linear_chain(observations, MODEL, near)
    channels = observations.tests[1].channels
    column = found.columns[:, found.names.index(f"phase {channels[0].name}")]
    rows = observations.rows
    lines = (rows.test == 1) & (rows.channel == 0)
    assert column[lines & (rows.part == Part.PHASE)] == pytest.approx(np.radians(0.2))
    assert not column[lines & (rows.part == Part.LOG_MAGNITUDE)].any()
    assert not column[(rows.test == 1) & (rows.channel == 1)].any()


def test_errors_of_the_chain_that_no_row_shows_are_left_out() -> None:
    observations = laboratory(observations_of_model(MODEL, drives=(0.1, 0.4)))
    near = Forward(observations.tests, observations.rows).predict(MODEL)

    def has_clock(share: float) -> bool:
        column = full.columns[:, full.names.index("clock")]
        std = np.full(column.size, math.sqrt(float(column @ column) / share))
        noisy = replace(observations, std=std, floor=np.zeros_like(std))
        return "clock" in linear_chain(noisy, MODEL, near).names

    full = linear_chain(observations, MODEL, near)
    assert has_clock(1.1e-3)
    assert not has_clock(0.9e-3)


def test_the_drives_of_two_tests_have_images_of_their_own() -> None:
    observations = laboratory(observations_of_model(MODEL, drives=(0.1, 0.4)))
    near = Forward(observations.tests, observations.rows).predict(MODEL)
    found = linear_chain(observations, MODEL, near)
    images = [k for k, name in enumerate(found.names) if name.startswith("image")]
    assert images
    for k in images:
        tests = np.unique(observations.rows.test[found.columns[:, k] != 0.0])
        assert tests.size == 1


def test_where_the_loop_truly_stood_is_no_gap() -> None:
    """Noise of the loop moves all observables of a window together: rows alone would be off by many deviations."""
    wandering = laboratory(observations_of_model(MODEL, seed=6, drives=(0.1, 0.2, 0.4, 0.8, 1.6), lock_noise=3e-2))
    found = diagnosed(wandering)
    assert found.verdict in (Verdict.NONE, Verdict.CALIBRATION)
    assert found.features["rms:levels: frequency"] < 2.0
    known = replace(wandering, tests=(_certain(wandering.tests[0]), *wandering.tests[1:]))
    assert diagnosed(known).features["rms:levels: frequency"] > 5.0


def _certain(test: object) -> LockedWindows:
    """The test with the phases of its windows as if they were known."""
    assert isinstance(test, LockedWindows)
    return replace(test, levels=tuple(replace(level, phase_error_std=0.0) for level in test.levels))


def test_the_weakest_that_would_show_is_sure() -> None:
    later = DiagnosisSettings(withheld=WITHHELD, put_off_detectable=True)
    outcome = diagnose_observations(MODEL, observed(MODEL), later)
    assert not outcome.diagnosis.visible
    found = outcome.completed().diagnosis
    (cubic,) = [own for own in found.visible if own.effect == "cubic_stiffness"]
    with moved_threshold("verdict.largest_strength", 1e-9):
        assert not outcome.completed().diagnosis.visible
    spring = {"kind": "cubic_spring", "point": int(cubic.detail), "stiffness_n_m3": cubic.parameters["k"].value}
    told = diagnosed(observed(real(MODEL, local_elements=[spring]), seed=7), matters={})
    rows = [row for row in told.ledger.rows if row.label.startswith("cubic_stiffness")]
    sure = THRESHOLDS.verdict.sure_log_evidence
    assert sure < max(row.evidence for row in rows) < 3.0 * sure


def test_a_difference_that_does_not_matter_is_told_with_what_it_looks_like() -> None:
    observations = observed(HARDENING)
    found = diagnosed(observations, matters={"frequency": 0.9, "damping": 0.9, "response": 9.0, "harmonics": 0.9})
    assert found.verdict in (Verdict.NONE, Verdict.CALIBRATION)
    (sentence,) = [each for each in found.sentences if "The model lacks cubic stiffness at point 2" in each]
    assert "probability over 99 %. That is too small to matter: it changes " in sentence
    assert found.too_small is not None
    assert (found.too_small.effect, found.too_small.detail) == ("cubic_stiffness", "2")
    assert found.ranking == ()
    # What shows takes the room that is left for what is too weak to matter.
    share = THRESHOLDS.comparison.too_weak_share
    assert found.probabilities["cubic_stiffness@2"] == pytest.approx(share, abs=0.02)
    assert found.probabilities["unknown"] < 0.02
    sizes = [float(word) for word in re.findall(r"([\d.e+-]+) % of", sentence)]
    assert max(sizes) > 0.01


def test_an_effect_that_is_not_there_lowers_the_evidence() -> None:
    observations = observed(MODEL)
    near = Forward(observations.tests, observations.rows).predict(MODEL)
    data = data_about(observations, MODEL, near, np.isfinite(near.values))
    every = candidates(MODEL, operating_range(MODEL, observations.tests, observations=observations))
    cubic = next(own for own in every if own.effect.name == "cubic_stiffness")
    search = Search(data, MODEL, calibration_parameters(MODEL), [cubic])
    null = alone(search)
    found = search.with_added(null, Score(0, np.array([0.01]), 0.0, 1.0, np.zeros(data.sigma.size)), lost=np.inf)
    assert found is not None
    assert found.fit.cost < null.fit.cost + 0.5
    assert found.fit.log_evidence < null.fit.log_evidence - 1.0


def test_what_an_explanation_leaves_beyond_noise_is_something_unnamed() -> None:
    """Without any source at a place to say so; a good explanation keeps its probability."""
    observations = replace(observed(HARDENING), matters=dict(MATTERS))
    parameters = free_parameters(MODEL, observations)
    everything = np.ones(len(observations.rows), dtype=bool)
    null, data = model_alone(MODEL, observations, parameters, everything, LowLevelModes(observations, MODEL))[2:]
    operating = operating_range(MODEL, observations.tests, observations=observations)
    cubic = [own for own in candidates(MODEL, operating) if own.effect.name == "cubic_stiffness"]
    search = Search(data, MODEL, parameters, cubic)
    best = search.singles(null, search.scores(null))[0]
    squares = best.fit.errors.squares.copy()
    squares[0] *= 1e4
    off = replace(best.fit.prediction, values=best.fit.prediction.values + 0.1 * (data.groups.of == 0))
    worse = replace(best, fit=replace(best.fit, prediction=off, errors=replace(best.fit.errors, squares=squares)))
    good, left = (Hypotheses(data, null, [own], cubic, [], []).compared() for own in (best, worse))
    assert good.unknown < 0.05
    assert good.classes[0].adequate
    assert left.unknown > 0.95
    assert left.classes[0].probability < 0.05
    assert left.classes[0].given_library == pytest.approx(1.0)
    assert [objection.group for objection in left.classes[0].objections] == [data.groups.names[0]]
    assert left.places == good.places
    # A little that is left elsewhere makes it no less the place of the most.
    fall = null.fit.cost - best.fit.cost
    little = SourceEvidence(Location("controller"), 50.0, 0.01 * fall)
    beside = Hypotheses(data, null, [best], cubic, [], [little]).compared()
    assert beside.unknown > 0.95
    assert next(iter(beside.places)) == next(iter(good.places))
    assert beside.places[little.location] == pytest.approx(0.01 / 1.01, rel=0.05)


def test_two_laws_that_explain_everything_may_imitate_a_third() -> None:
    """What the library lacks takes 0.1 of 0.15 of a pair's probability; a sensor beside a law is not an imitation."""
    truth = real(
        MODEL,
        local_elements=[
            {"kind": "cubic_spring", "point": 2, "stiffness_n_m3": 2e8},
            {"kind": "quadratic_spring", "point": 2, "stiffness_n_m2": 3e5},
        ],
    )
    observations = replace(observed(truth), matters=dict(MATTERS))
    parameters = free_parameters(MODEL, observations)
    everything = np.ones(len(observations.rows), dtype=bool)
    null, data = model_alone(MODEL, observations, parameters, everything, LowLevelModes(observations, MODEL))[2:]
    every = candidates(MODEL, operating_range(MODEL, observations.tests, observations=observations))
    at_two = [
        next(it for it in every if it.effect.name == name and it.site.location.points[:1] == (2,))
        for name in ("cubic_stiffness", "quadratic_stiffness")
    ]
    gain = next(it for it in every if it.effect.name == "response_gain")
    search = Search(data, MODEL, parameters, [*at_two, gain])
    single = search.singles(null, search.scores(null))[0]

    def beside(number: int) -> FittedExplanation:
        score = next(it for it in search.scores(single) if it.candidate == number)
        found = search.with_added(single, score)
        assert found is not None
        return search.refit(found)

    two = beside(1 - search.candidates.index(single.candidates[0]))
    assert [laws(found) for found in (two, single, beside(2))] == [2, 1, 1]
    compared = Hypotheses(data, null, [two], search.candidates, [], []).compared()
    assert compared.classes[0].objections == (IMITATION,)
    assert compared.classes[0].probability == pytest.approx(0.05 / 0.15, rel=1e-3)
    assert compared.unknown == pytest.approx(0.1 / 0.15, rel=1e-3)


def test_no_gap_leaves_room_for_what_is_too_weak_to_see(hardening: Diagnosis) -> None:
    found = diagnosed(observed(MODEL))
    assert found.verdict in (Verdict.NONE, Verdict.CALIBRATION)
    share = THRESHOLDS.comparison.too_weak_share
    assert found.probabilities["none"] == pytest.approx(1.0 - share, abs=0.02)
    assert found.probabilities["unknown"] == pytest.approx(share, abs=0.02)
    # A gap that is there leaves none.
    assert hardening.probabilities["unknown"] < 0.05


def test_a_fit_of_the_model_alone_returns_from_where_nobody_believes_it() -> None:
    observations = replace(observed(MODEL), matters=dict(MATTERS))
    parameters = free_parameters(MODEL, observations)
    everything = np.ones(len(observations.rows), dtype=bool)
    null, data = model_alone(MODEL, observations, parameters, everything, LowLevelModes(observations, MODEL))[2:]
    far = null.fit.theta.copy()
    far[[parameter.name.startswith("structure") for parameter in parameters].index(True)] = 40.0
    lost = fit(data, null.fit.parametrisation, Start("far", far, effort=Effort(steps=0)))
    assert lost.cost > null.fit.cost + 100.0
    assert from_believed(data, lost).cost == pytest.approx(null.fit.cost, abs=0.5)
    assert from_believed(data, null.fit) is null.fit


def test_errors_of_the_chain_are_at_their_best_from_any_start() -> None:
    """A minimiser that knows neither their derivatives nor where they stood finds nothing better."""
    observations = laboratory(observations_of_model(MODEL, seed=1, drives=(0.1, 0.4)))
    near = Forward(observations.tests, observations.rows).predict(MODEL)
    data = data_about(observations, MODEL, near, np.isfinite(near.values))
    rng = np.random.default_rng(5)
    count = len(data.chain_names)
    values = near.values - data.chain @ rng.standard_normal(count)

    def cost(chain: FloatArray) -> float:
        left = data.difference(values, chain)
        return data.groups.cost(data.groups.sums(left * left), data.counts) + float(chain @ chain)

    fresh = best_chain_errors(data, values)
    far = best_chain_errors(data, near.values + data.chain @ rng.standard_normal(count))
    started = best_chain_errors(data, values, far)
    for found in (fresh, started):
        assert found.cost == pytest.approx(cost(found.chain), rel=1e-12)
        assert minimize(cost, found.chain, options={"maxiter": 5}).fun > found.cost - 0.02
        np.testing.assert_allclose(
            found.slopes, data.chain_slopes(found.values), atol=1e-2 * np.abs(found.slopes).max()
        )
    assert started.cost == pytest.approx(fresh.cost, abs=0.02)
