"""What thresholds decide, on either side of each: small cases whose outcome is known by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnose.test_residuals import run_observations
from diagnose.test_warnings import GAP
from scipy.stats import f as fisher

from nmt_bench.commands import linear_command
from nmt_core.tolerances import TOLERANCES
from nmt_diagnose.effects.location import Cause, Explanation, Location
from nmt_diagnose.effects.structure_effects import excess_exponent, largest_air_drag
from nmt_diagnose.fit.best_fit import spread_of
from nmt_diagnose.fit.fitting import Data, FitResult
from nmt_diagnose.fit.noise import Groups, beyond_noise
from nmt_diagnose.law.reading import LawReading, LocalLaw
from nmt_diagnose.ledger.comparison import Comparison, EquivalentClass, Hypotheses, SourceEvidence
from nmt_diagnose.ledger.diagnosis import PlaceShare, Ranked, Share, Verdict
from nmt_diagnose.ledger.gap import ClosedShare, _share
from nmt_diagnose.ledger.row import Facts
from nmt_diagnose.ledger.rules import verdict_of
from nmt_diagnose.ledger.size import Objection, _band
from nmt_diagnose.ledger.warnings import beyond_physical_limits
from nmt_diagnose.observations.noise.scatter import moderated
from nmt_diagnose.prediction.converter import recorded_harmonics
from nmt_diagnose.prediction.lateness import delay_of
from nmt_diagnose.say.residual_tests import residual_tests
from nmt_diagnose.say.result_rows import is_located, place_rows
from nmt_diagnose.say.sentences import sentences, where_words
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.model.fourier_basis import FourierBasis
from nmt_rig.rig import load_rig
from nmt_signals.channel_faults.clipping import clipping_level
from nmt_signals.channel_faults.converter_faults import converter_step, repeated_share

SOURCE = Location("controller")


def clipped(runs: int, length: int, neighbour: int = 1, far: int = 1) -> float:
    """Level of samples with runs at 1; the value next to it ``neighbour`` times, the ninth below it ``far`` times."""
    below = [0.9 - 0.01 * k for k in range(60)]
    crowd = [0.9] * (neighbour - 1) + [0.82] * (far - 1)
    other = iter([*below, *crowd])
    samples = [value for _ in range(runs) for value in (next(other), *[1.0] * length)]
    return clipping_level(np.array([*samples, *other]))


def staircase(values: int, off: float = 0.0) -> float:
    samples = np.arange(float(values))
    samples[2] += off
    return converter_step(samples)


def repeats(count: int, samples: int = 2000) -> bool:
    """Whether so many samples of a sine that repeat the one before are noticed, at its zeros."""
    wave = np.sin(0.3 * np.arange(samples) + 0.1)
    steep = np.flatnonzero(np.abs(wave[5:-5]) < 0.05)[:: max(1, samples // 2000)][:count] + 5
    wave[steep] = wave[steep - 1]
    assert steep.size == count
    return repeated_share(wave) > 0.0


def recorded(amplitude: float, level: float = math.inf, step: float = 0.0, noise: float = 0.0) -> bool:
    """Whether a converter changes a sine."""
    basis = FourierBasis.up_to(1)
    before = np.array([[0.0, amplitude]], dtype=np.complex128)
    return bool(np.any(recorded_harmonics(before, np.array([[level, step, noise]]), basis) != before))


def verdict(
    log_odds: float,
    value: float = 0.99,
    gain: float = 9.0,
    adequate: bool = True,
    effects: int = 1,
    pulled: float = 0.0,
) -> Verdict:
    left = () if adequate else (Objection("levels: frequency", "frequency", 0.004), Objection("a_mass", "", pulled))
    leader = EquivalentClass((explanation(effects),), 0.9, 0.9, left)
    comparison = Comparison(0.05, 0.05, (leader,), {}, log_odds, {})
    share = ClosedShare(3.0, 1.0, 1.0, value, 0.9, 1.0, gain)
    alone = Facts(log_odds=log_odds, left_without=0.0)
    return verdict_of(alone, leader.facts(share, max(comparison.unknown, comparison.none)))


def fitted(theta: float = 0.0, chain: float = 0.0) -> Any:
    own = SimpleNamespace(prior_std=np.ones(1), calibration=(None,))
    fit = SimpleNamespace(
        theta=np.array([theta]), parametrisation=own, errors=SimpleNamespace(chain=np.array([chain])),
        log_evidence=0.0, promised=0.0,
    )  # fmt: skip
    return SimpleNamespace(fit=fit, candidates=())


def explanation(count: int) -> Any:
    """Effects without limits, each at the only place of the only effect of a library."""
    candidate = SimpleNamespace(effect=SimpleNamespace(name="a"), site=SimpleNamespace(location=SOURCE, limits={}))
    fit = SimpleNamespace(
        parametrisation=SimpleNamespace(values=lambda theta, index: {}, calibration=()), theta=np.zeros(0)
    )
    return SimpleNamespace(candidates=(candidate,) * count, stated=tuple(range(count)), fit=fit)


def prior(count: int) -> float:
    """Prior probability of an explanation by so many effects."""
    found = explanation(count)
    everything = Hypotheses(None, None, [], [found.candidates[0]], [], [])  # type: ignore[arg-type]
    return math.exp(everything.prior(found))


def compared() -> Comparison:
    """No gap against a source that explains nothing."""
    return Hypotheses(None, fitted(), [], [], [SourceEvidence(SOURCE, 0.0, 0.0)], []).compared()  # type: ignore[arg-type]


def place_odds(size: float) -> float:
    """Odds of a place whose fit leaves 16 more, of an effect of such a size over the noise."""
    one, other = (Explanation((Cause("a", Location.at("structure", point)),)) for point in (1, 2))
    own = SimpleNamespace(calibration=(), prior_std=np.zeros(0), values=lambda theta, index: {})

    def at(explained: Explanation, residual: float) -> Any:
        left = SimpleNamespace(residual=np.array([residual]), weights=np.ones(1), chain=np.zeros(0))
        fit = SimpleNamespace(errors=left, theta=np.zeros(0), parametrisation=own, log_evidence=0.0, promised=0.0)
        return SimpleNamespace(
            explanation=explained,
            effects=explained.effects,
            fit=fit,
            candidates=(),
            stated=(0,) * len(explained.causes),
        )

    here = at(one, 0.0)
    everything = Hypotheses(None, at(Explanation(), size), [here], [], [], [], [(at(other, 0.0), 16.0)])  # type: ignore[arg-type]
    everything.__dict__["prior"] = lambda found: 0.0
    (_, p), (_, q) = everything._placed(("a",))
    return q / p


def same_class(apart: float, size: float) -> bool:
    """Whether two laws whose fits lie so far apart are one class, for an effect of such a size over the noise."""

    def at(residual: float, effects: tuple[str, ...]) -> Any:
        left = SimpleNamespace(residual=np.array([residual]), weights=np.ones(1))
        return SimpleNamespace(fit=SimpleNamespace(errors=left), effects=effects, stated=(0,))

    data: Any = SimpleNamespace(observations=SimpleNamespace(matters={}))
    everything = Hypotheses(data, at(size, ()), [], [], [], [])
    return everything._alike(at(0.0, ("a",)), at(apart, ("b",)))


def excess(chance: float) -> bool:
    """Whether a scale that is by this chance as large counts as more than noise."""
    groups = Groups(np.zeros(10, dtype=np.int64), ("a",), np.array([6.0]), np.zeros(1))
    return bool(beyond_noise(groups.tails(np.array([10.0 * fisher.isf(chance, 10, 6)]), np.array([10.0])))[0])


def beyond(value: float) -> float:
    """By how many standard deviations a parameter is larger than a limit of 1."""
    found = explanation(1)
    found.candidates[0].site.limits["c2"] = 1.0
    found.fit.parametrisation.values = lambda theta, index: {"c2": value}
    return beyond_physical_limits(found)[0, "c2"]


def details(other: float) -> str:
    places = {Location.at("structure", 2): 0.6, Location.at("structure", 3): other}
    (row,) = place_rows(Comparison(0.0, 0.0, (), places, 0.0, {}), {})
    return row.detail


def listed(p: float) -> int:
    places = {Location.at("structure", 2): 0.9, Location("exciter"): p}
    return len(place_rows(Comparison(0.0, 0.0, (), places, 0.0, {}), {}))


def certainty(p: float) -> bool:
    """Whether a sentence says that something is the cause."""
    head = Ranked("cubic_stiffness", "structure", "2", p, (), {}, Share(0.9, 0.8, 1.0), 9.0)
    where = [PlaceShare("structure", "2", 1.0, p)]
    return any("The cause is" in text for text in sentences(Verdict.EFFECT, where, [head], None, GAP, (), ()))


def nearest(closed: float, after: float = 1.0) -> str:
    """How much of an unknown gap nothing explains, as it is said; of ten deviations the fit leaves ``after``."""
    gap = replace(GAP, closed=closed, before=10.0, after=after, floor=1.0)
    text = sentences(Verdict.UNKNOWN, (), (), None, gap, (), ())[1]
    return text.removeprefix("Nothing in the library explains ").partition(" of it")[0]


def located(closed: float, *refusals: str, law: bool = False) -> bool:
    """Whether the place of an unknown gap is told."""
    reading = LawReading("test", 8, (LocalLaw(2, 0, "", (), 1.0, (), ()),), 9.0, 1.0, 1.0, 1.0, refusals)
    return is_located(replace(GAP, closed=closed), reading if law else None)


def test_a_law_that_is_told_has_a_place_whatever_effects_close() -> None:
    assert located(0.1, law=True)
    assert not located(0.1, "levels that were left out are predicted no better", law=True)


def courses(levels: int) -> bool:
    observations = run_observations(levels=levels)
    every = np.ones(len(observations.rows), dtype=bool)
    tests = residual_tests(observations, np.zeros(len(observations.rows)), every)
    return any(test.name.startswith("smooth course") for test in tests)


def over_measured(difference: float) -> float:
    """Size of a predicted over a measured line that differ by so much in ln."""
    observations = SimpleNamespace(values=np.zeros(2))
    data = SimpleNamespace(lines=np.array([[0], [1]]), observations=observations)
    return float(abs(Data._over_measured(data, np.array([difference, 0.0]))[0]))  # type: ignore[arg-type]


def degrees(*variances: float) -> float:
    return float(moderated(np.array(variances), 4.0)[1][0])


def drag(rig: str) -> float:
    return largest_air_drag(load_rig(rig), SimpleNamespace(effective_mass={1: 0.54}, total_mass=2.7), 1)  # type: ignore[arg-type]


FREQUENCY = np.linspace(5.0, 200.0, 60)
STEP = 1.0 / 16.0 / 200.0

EDGES: dict[str, tuple[Callable[[], Any], Any]] = {
    "signals.channel_faults.clipped_fewest_samples": (lambda: (clipped(5, 1), clipped(6, 1)), (0.0, 1.0)),
    "signals.channel_faults.clipped_fewest_visits": (lambda: (clipped(2, 4), clipped(3, 4)), (0.0, 1.0)),
    "signals.channel_faults.clipped_crowding": (lambda: (clipped(9, 1, 2), clipped(10, 1, 2)), (0.0, 1.0)),
    "signals.channel_faults.clipped_neighbours": (lambda: clipped(7, 1, 1, 6), 1.0),
    "signals.channel_faults.step_fewest_values": (lambda: (staircase(7), staircase(8)), (0.0, 1.0)),
    "signals.channel_faults.step_rounding": (lambda: (staircase(9, 0.03), staircase(9, 0.015)), (0.0, 1.0)),
    "signals.channel_faults.finest_step": (
        lambda: converter_step(np.array([*range(10), 3.0 + 5e-7])), pytest.approx(1.0)
    ),
    "signals.channel_faults.step_samples": (
        lambda: converter_step(np.concatenate([np.arange(8192) % 90.0, np.sqrt(np.arange(8192.0))])), 1.0
    ),
    "signals.channel_faults.repeats_fewest": (lambda: (repeats(4), repeats(5)), (False, True)),
    "signals.channel_faults.repeats_least_share": (lambda: (repeats(5, 120_000), repeats(5, 50_000)), (False, True)),
    "noise.moderated_fewest": (lambda: (degrees(1.0, 40.0) > 4.0, degrees(1.0, 40.0, 9.0) > 4.0), (False, True)),
    "noise.most_degrees_of_freedom": (lambda: degrees(1.0, 1.0, 1.0), 10_004.0),
    "prediction.noise_reach_sigmas": (
        lambda: (recorded(0.5, 1.0, noise=0.12), recorded(0.5, 1.0, noise=0.13)), (False, True)
    ),
    "prediction.coarse_steps": (lambda: (recorded(1.0, step=1.0 / 65), recorded(1.0, step=1.0 / 63)), (False, True)),
    "prediction.latest_delay_s": (
        lambda: [abs(delay_of(FREQUENCY, 2.0 * np.pi * FREQUENCY * late) - late) < 2e-4 for late in (9e-3, 0.012)],
        [True, False],
    ),
    "prediction.delay_step_turns": (
        lambda: delay_of(FREQUENCY, 2.0 * np.pi * FREQUENCY * 5.4 * STEP), pytest.approx(5.0 * STEP)
    ),
    "verdict.alarm_log_odds": (lambda: (verdict(1.4), verdict(1.6)), (Verdict.NONE, Verdict.EFFECT)),
    "verdict.worse_prediction_sigmas": (
        lambda: (verdict(9.0, -0.1, -1.1), verdict(9.0, -0.1, -0.9)), (Verdict.UNKNOWN, Verdict.EFFECT)
    ),
    "verdict.partial_closed_share": (
        lambda: (verdict(9.0, 0.79, adequate=False), verdict(9.0, 0.81, adequate=False)),
        (Verdict.UNKNOWN, Verdict.EFFECT),
    ),
    "verdict.partial_closed_share_of_two": (
        lambda: [verdict(9.0, closed, adequate=False, effects=2) for closed in (0.94, 0.96)],
        [Verdict.UNKNOWN, Verdict.EFFECT],
    ),
    "verdict.partial_pulled_sigmas": (
        lambda: [verdict(9.0, 0.9, adequate=False, pulled=sigmas) for sigmas in (9.9, 10.1)],
        [Verdict.EFFECT, Verdict.UNKNOWN],
    ),
    "verdict.nearest_closed_share": (
        lambda: [
            (located(0.32), located(0.34)), nearest(0.32), nearest(0.34), nearest(math.nan, 7.1), nearest(math.nan, 6.9)
        ],
        [(False, True), "a third", "all", "a third", "all"],
    ),
    "verdict.as_likely_share": (lambda: (details(0.19), details(0.21)), ("2", "2 + 3")),
    "verdict.least_location_probability": (lambda: (listed(0.004), listed(0.006)), (1, 2)),
    "verdict.other_location_probability": (
        lambda: [
            "otherwise" in where_words([PlaceShare("joint", "", 1.0, 0.9), PlaceShare("exciter", "", 0.1, p)])
            for p in (0.04, 0.06)
        ],
        [False, True],
    ),
    "verdict.cause_probability": (lambda: (certainty(0.89), certainty(0.91)), (False, True)),
    "verdict.many_levels": (
        lambda: [int(_band(np.arange(n), np.zeros(n, dtype=int)).max()) for n in (20, 21)], [19, 9]
    ),
    "verdict.least_gap_ratio": (
        lambda: [bool(np.isfinite(_share(np.array([before]), np.array([1.0]), 1.0))[0]) for before in (1.015, 1.025)],
        [False, True],
    ),
    "verdict.course_fewest_levels": (lambda: (courses(4), courses(5)), (False, True)),
    "comparison.credible_sigmas": (lambda: Hypotheses._evidence(fitted(4.0)), -0.5),
    "comparison.limit_std": (lambda: beyond(2.0), 2.0),
    "comparison.place_form_std": (lambda: place_odds(50.0), pytest.approx(math.exp(-4.0))),
    "comparison.noise_probability": (lambda: (excess(0.06), excess(0.04)), (False, True)),
    "comparison.prior_one_effect": (lambda: prior(1), pytest.approx(0.25)),
    "comparison.prior_two_effects": (lambda: prior(2), pytest.approx(2.0 * 0.05)),
    "comparison.prior_none": (lambda: compared().none, pytest.approx(0.6 / 0.7)),
    "comparison.prior_unnamed": (lambda: compared().unknown, pytest.approx(0.1 / 0.7)),
    "fits.strength_std": (lambda: [spread_of(size) for size in (7.4, 7.6)], [1.0, 10.0]),
    "fits.strength_spreads": (lambda: [spread_of(size) for size in (7.0, 70.0, 700.0)], [1.0, 10.0, 100.0]),
    "search.wider_strength": (lambda: [spread_of(size) for size in (-7.4, -7.6)], [1.0, 10.0]),
    "fits.largest_log_ratio": (lambda: (over_measured(2.0), over_measured(5.0)), pytest.approx((math.e**2, math.e**3))),
    "fits.converged_cost_fall": (
        lambda: [FitResult.converged.fget(SimpleNamespace(promised=fall)) for fall in (0.21, 0.19)],  # type: ignore[attr-defined]
        [False, True],
    ),
    "candidates.largest_power_excess": (lambda: [excess_exponent({"excess": e}) for e in (8.0, 20.0)], [8.0, 9.0]),
    # ½ ρ C_d A of the beam's face, and of 0.2 m² of sheet.
    "candidates.air_density_kg_m3": (lambda: drag("beam"), pytest.approx(0.5 * 1.2 * 10.0 * 0.7 * 0.00527668)),
    "candidates.largest_drag_coefficient": (lambda: drag("joint_resonator"), pytest.approx(0.5 * 1.2 * 10.0 * 0.2)),
    "candidates.least_sheet_kg_m2": (lambda: drag("joint_resonator"), pytest.approx(0.5 * 1.2 * 10.0 * 0.2)),
    # The arithmetic of the reasons.
    "next_test.random_seconds": (
        lambda: 2.0 < THRESHOLDS.next_test.random_seconds / linear_command.DEFAULT_DURATION < 2.1, True
    ),
    "tolerances.phase_deg": (lambda: TOLERANCES.phase_deg, pytest.approx(math.degrees(math.atan(0.1 / 30)), rel=0.1)),
    "tolerances.delay_s": (lambda: TOLERANCES.delay_s, pytest.approx(1.0 / 100_000)),
    "tolerances.mains": (lambda: 20.0 * math.log10(TOLERANCES.mains), pytest.approx(-60.0)),
    "tolerances.clock": (lambda: 25e-6 <= TOLERANCES.clock <= 50e-6, True),
    "tolerances.gain": (lambda: 0.005 < TOLERANCES.gain < 0.015, True),
    "tolerances.resonance_shift": (lambda: TOLERANCES.resonance_shift, pytest.approx(0.5 * 3e-4 * 2.0)),
    "tolerances.image_share": (lambda: TOLERANCES.image_share, pytest.approx(1.0 / math.sqrt(3.0), rel=0.05)),
    "tolerances.amplitude_scale": (lambda: TOLERANCES.amplitude_scale, pytest.approx(TOLERANCES.gain)),
}  # fmt: skip


@pytest.mark.parametrize(
    ("apart", "size", "alike"), [(2.9, 10.0, True), (3.1, 10.0, False), (19.0, 1e3, True), (21.0, 1e3, False)]
)
def test_laws_part_where_errors_of_shapes_do_not(apart: float, size: float, alike: bool) -> None:
    # Two per cent of all that the effect does, or three standard deviations.
    assert same_class(apart, size) is alike


def test_what_predicts_worse_than_the_model_alone_is_not_the_nearest() -> None:
    head = Ranked("cubic_stiffness", "structure", "2", 0.9, (), {}, Share(-17.0, -20.0, -1.0), 9.0)
    text = sentences(Verdict.UNKNOWN, (), [head], None, replace(GAP, closed=-17.0), (), ())[1]
    assert "nearest" not in text
    assert text.endswith("better than the model alone.")


@pytest.mark.parametrize("path", EDGES)
def test_a_threshold_decides(path: str) -> None:
    outcome, expected = EDGES[path]
    assert outcome() == expected


def test_a_third_effect_is_as_rare_as_the_second() -> None:
    """Of three effects one is asked for in six orders."""
    assert prior(3) == pytest.approx(6.0 * 0.05**2 / 0.25)
