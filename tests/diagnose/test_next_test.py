"""Which test would decide: expected distances against dense algebra, and silence where nothing is open."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnose.linear_problem import FunctionModel, observations_of
from diagnose.predicted_observations import DRIVES, observations_of_model
from diagnose.predicted_tests import chain

from nmt_core.kinds.request import TestRequest
from nmt_diagnose.ahead import ahead
from nmt_diagnose.ahead import next_tests as looking
from nmt_diagnose.ahead.expected_rows import expected as expected_rows
from nmt_diagnose.ahead.motion_noise import noise_over_motion
from nmt_diagnose.ahead.next_tests import next_tests, other_sensors
from nmt_diagnose.ahead.proposals import Proposal, proposals
from nmt_diagnose.chain.chain_columns import Chain
from nmt_diagnose.effects.effect import Candidate, Site
from nmt_diagnose.effects.library import candidates, effect_named
from nmt_diagnose.effects.location import Location
from nmt_diagnose.fit.explanations import FittedExplanation
from nmt_diagnose.fit.low_level_modes import LowLevelModes
from nmt_diagnose.fit.model_alone import free_parameters, model_alone
from nmt_diagnose.ledger.comparison import Comparison, EquivalentClass
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.prediction.operating_range import operating_range
from nmt_diagnose.search.search import Search
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import validate_rig
from nmt_rig.rig_file import RigDocument

RIG = chain()
SIGMA = 0.5
MEASURED = observations_of(np.zeros(20), 1.0)


CUBIC, DRAG = (
    Candidate(effect_named(name), Site(Location.at("structure", 2), {"k": 1.0, "c2": 1.0}, 2))
    for name in ("cubic_stiffness", "air_drag")
)


def fitted(candidate: Candidate, theta: float, std: float) -> FittedExplanation:
    """An explanation y = column θ with what has been measured of θ; its rig says which explanation it is of."""
    own = SimpleNamespace(
        names=(candidate.label,), rig=lambda values: (candidate.label, np.asarray(values)), prior_std=np.array([std])
    )
    errors = SimpleNamespace(slopes=np.zeros((20, 0)), chain=np.zeros(0), weights=np.ones(20))
    fit = SimpleNamespace(
        theta=np.array([theta]), covariance=np.array([[std**2]]), parametrisation=own, jacobian=np.zeros((20, 1)),
        errors=errors,
    )  # fmt: skip
    return FittedExplanation((candidate,), fit)  # type: ignore[arg-type]


def compared(*classes: tuple[tuple[FittedExplanation, ...], float], none: float = 0.0) -> Comparison:
    return Comparison(none, 0.0, tuple(EquivalentClass(*own) for own in classes), {}, 10.0, {})


@pytest.fixture
def future(monkeypatch: pytest.MonkeyPatch) -> dict[str, np.ndarray]:
    """Columns of the two explanations in a test that has not been made; the prediction predicts by them."""
    generator = np.random.default_rng(3)
    columns = {CUBIC.label: generator.standard_normal(6), DRAG.label: generator.standard_normal(6)}

    class Future:
        def __init__(self, *_: Any) -> None:
            pass

        def predict(self, rig: Any, start: Any = None) -> Any:
            name, theta = rig
            return FunctionModel(lambda t: columns[name] * t[0]).predict(theta)

        def difference(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
            return a - b

        def jacobian(self, parametrisation: Any, theta: Any, prediction: Any, which: Any = None) -> np.ndarray:
            return columns[parametrisation.names[0]][:, None]

    monkeypatch.setattr(ahead, "Forward", Future)
    monkeypatch.setattr(looking, "noise_over_motion", lambda left, *_: left)
    monkeypatch.setattr(ahead, "linear_chain", lambda *_: Chain((), np.zeros((6, 0)), np.zeros(0, dtype=bool)))
    return columns


def competing() -> tuple[FittedExplanation, FittedExplanation]:
    return fitted(CUBIC, 2.0, 0.2), fitted(DRAG, 1.9, 0.2)


def proposal() -> Proposal:
    return Proposal("a test", TestRequest(), observations_of(np.zeros(6), SIGMA))


def expected(future: dict[str, np.ndarray], a: FittedExplanation, b: FittedExplanation) -> float:
    """√(Δᵀ (σ² + J C Jᵀ)⁻¹ Δ) with a true and b adapting."""
    ja, jb = future[a.explanation.label], future[b.explanation.label]
    gap = ja * a.fit.theta[0] - jb * b.fit.theta[0]
    spread = SIGMA**2 * np.eye(6) + np.outer(jb, jb) * b.fit.covariance[0, 0]
    return float(np.sqrt(gap @ np.linalg.solve(spread, gap)))


def test_the_expected_distance_is_that_of_dense_algebra(
    future: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    a, b = competing()
    least = min(expected(future, a, b), expected(future, b, a))
    assert least > 3.0
    monkeypatch.setattr(looking, "proposals", lambda *_: [proposal()])
    (found,) = next_tests(RIG, MEASURED, a, compared(((a,), 0.6), ((b,), 0.3)))
    assert found.expected_sigma == pytest.approx(least, rel=1e-6)
    assert found.separates == ("cubic_stiffness", "air_drag")
    # Members of one class are distinguished just so.
    (same,) = next_tests(RIG, MEASURED, a, compared(((a, b), 0.95)))
    assert same == found


def test_noise_is_over_the_motion_of_the_test_to_come() -> None:
    """Displacements as noisy as before: by their amplitude, which the model tells, never less than in tests at hand."""
    noise, model = 1e-9, chain()
    measured = observations_of_model(model, random=False)
    amplitudes = (measured.rows.part == Part.LOG_MAGNITUDE) & (measured.rows.harmonic == 1)
    std = np.where(amplitudes, noise * np.exp(-measured.values), measured.std)
    measured = replace(measured, std=std, floor=np.zeros_like(std))
    found: Any = SimpleNamespace(fit=SimpleNamespace(theta=None, parametrisation=SimpleNamespace(rig=lambda _: model)))
    weak, strong = (
        expected_rows(TestRequest(levels=(level,)), model, measured)
        for level in (min(DRIVES) / 100.0, 2.0 * max(DRIVES))
    )
    for left in (weak, strong):
        row = np.flatnonzero(left.rows.part == Part.LOG_MAGNITUDE)
        predicted = Forward(left.tests, left.rows).predict(model).values[row]
        after = noise_over_motion(left, measured, found)
        # A window of as many periods is the shorter the higher the frequency.
        shorter = np.sqrt(left.rows.frequency_hz[row] / measured.rows.frequency_hz[amplitudes][0])
        expected = np.maximum(left.std[row], shorter * noise * np.exp(-predicted))
        assert after.std[row] == pytest.approx(expected, rel=1e-6)
        assert np.all(after.std[row] > 2.0 * left.std[row]) == (left is weak)
        alone = left.rows.channel < 0
        assert np.all(after.std[alone] > 2.0 * left.std[alone]) == (left is weak)


def test_a_test_that_cannot_tell_is_not_proposed(
    future: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    a, b = competing()
    future[DRAG.label] = future[CUBIC.label] * a.fit.theta[0] / b.fit.theta[0]
    monkeypatch.setattr(looking, "proposals", lambda *_: [proposal()])
    assert next_tests(RIG, MEASURED, a, compared(((a, b), 0.9))) == ()


def test_an_investigation_is_offered_tests_that_tell_little(
    future: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is not worth a person's while counts where the bench chooses by information for its time."""
    a, b = competing()
    cubic = future[CUBIC.label] * a.fit.theta[0]
    across = future[DRAG.label] - cubic * (cubic @ future[DRAG.label]) / (cubic @ cubic)
    across /= np.linalg.norm(across)
    monkeypatch.setattr(looking, "proposals", lambda *_: [proposal()])
    edges = THRESHOLDS.next_test.least_asked_sigmas, THRESHOLDS.next_test.least_sigmas
    for sigmas, offered in ((0.5 * edges[0], 0), (0.5 * (edges[0] + edges[1]), 1)):
        future[DRAG.label] = (cubic + sigmas * SIGMA * across) / b.fit.theta[0]
        for with_plan, count in ((True, offered), (False, 0)):
            assert len(next_tests(RIG, MEASURED, a, compared(((a, b), 0.9)), with_plan)) == count


def test_one_sure_explanation_needs_no_further_test(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: Any) -> Any:
        raise AssertionError("nothing is left to distinguish")

    monkeypatch.setattr(looking, "proposals", never)
    a, b = competing()
    assert next_tests(RIG, MEASURED, a, compared(((a,), 0.97), ((b,), 0.01))) == ()
    assert next_tests(RIG, MEASURED, a, compared()) == ()


@pytest.mark.parametrize(
    ("truth", "rivals", "would"),
    [
        ({"added": "mass"}, ("added_mass@2", "sensor_mass@a2"), "the sensor of a2 at point 3 in place of 2"),
        ({"gain": 1.05}, ("response_gain@a2", "force_gain@"), "a second sensor at point 2"),
    ],
)
def test_sensors_that_would_tell_apart_what_no_level_does(
    truth: dict[str, Any], rivals: tuple[str, str], would: str
) -> None:
    """A mass at a point from that of the sensor there: the sensor elsewhere. A gain: a second sensor beside it."""
    springs, masses = {"springs_n_m": [15000.0, 20000.0], "dampers_ns_m": [5.0, 5.0]}, [0.5, 0.3, 0.2]
    ground = {"ground_springs_n_m": [20000.0, 3000.0, 2000.0], "ground_dampers_ns_m": [4.0, 1.0, 1.0]}
    model = chain(structure={"kind": "chain", "masses_kg": masses, **springs, **ground})
    real_values = model.model_dump()
    if "gain" in truth:
        real_values["sensors"][2]["gain"] = truth["gain"]
    else:
        real_values["structure"]["masses_kg"][1] += 0.1
    observations = observations_of_model(validate_rig(RigDocument("test", real_values, {})), seed=4, drives=DRIVES[3:])
    used = np.ones(len(observations.rows), dtype=bool)
    parameters = [it for it in free_parameters(model, observations) if it.name.startswith("exciter.")]
    observations, _, null, data = model_alone(model, observations, parameters, used, LowLevelModes(observations, model))
    known = candidates(model, operating_range(model, observations.tests, observations=observations))
    search = Search(data, model, parameters, [it for it in known if it.label.startswith(rivals)])
    best = {score.candidate: score for score in reversed(search.scores(null))}
    found = [it for score in best.values() if (it := search.with_added(null, score)) is not None]
    pair = [next(it for it in found if it.explanation.label.startswith(name)) for name in rivals]
    sensors = other_sensors(model, observations, null, compared((tuple(pair), 1.0)), (), data.chain_names)
    tests = [item.test for item in sensors]
    assert would in tests
    if "added" in truth:
        assert tests == [would]


@pytest.mark.parametrize("masses", [3, 1])
def test_a_body_that_nothing_holds_is_asked_for_at_its_elastic_modes(masses: int) -> None:
    """Its rigid-body mode is at 0 Hz; a single free mass swings in no mode, and nothing of it is foretold."""
    links = {"springs_n_m": [15000.0, 20000.0][: masses - 1], "dampers_ns_m": [5.0, 5.0][: masses - 1]}
    structure = {"kind": "chain", "masses_kg": [0.5, 0.3, 0.2][:masses], **links}
    values = {**chain().model_dump(), "structure": structure, "local_elements": []}
    values["sensors"] = [it for it in values["sensors"] if it["point"] in ("drive", *range(1, masses + 1))]
    free = validate_rig(RigDocument("free", values, {}))
    measured = observations_of_model(chain(), random=False, drives=DRIVES[:2])
    found = proposals(free, measured)
    assert bool(found) == (masses > 1)
    for proposal in found:
        frequency = proposal.observations.rows.frequency_hz
        assert frequency.min() > 1.0
        assert np.all(np.isfinite(frequency))


def test_other_kinds_are_proposed_where_they_are_asked_for() -> None:
    """At the highest level at hand, each with rows that the model has a solution for."""
    model = chain()
    measured = observations_of_model(model, drives=DRIVES[:2])
    usual, more = proposals(model, measured), proposals(model, measured, further=True)
    assert [it.request for it in more[: len(usual)]] == [it.request for it in usual]
    other = more[len(usual) :]
    assert [it.request.kind.label() for it in other] == ["ring_down", "response_curve", "random"]
    for proposal in other:
        assert proposal.request.top > 0.0
        assert proposal.seconds > 0.0
        rows = proposal.observations
        assert np.all(np.isfinite(Forward(rows.tests, rows.rows).predict(model).values))
