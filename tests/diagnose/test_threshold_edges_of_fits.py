"""What thresholds of fits, modes, noise and verdicts decide, on either side of each; outcomes are known by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, Literal
from unittest.mock import patch

import numpy as np
import pytest
from diagnose.predicted_tests import chain
from diagnose.test_residuals import run_observations
from diagnose.test_threshold_edges import same_class
from diagnose.test_warnings import GAP
from scipy.special import ndtri

from nmt_diagnose.chain import form_errors
from nmt_diagnose.chain.modes_left_out import ModesLeftOut
from nmt_diagnose.effects.library import effect_named
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.effects.structure_effects import spots
from nmt_diagnose.fit.low_level_modes import LowLevelModes, measured_modes
from nmt_diagnose.fit.noise import groups_of, sigma_of
from nmt_diagnose.ledger.gap import closed
from nmt_diagnose.ledger.row import Facts
from nmt_diagnose.ledger.rules import IN_REACH, PROMISING, furthest_credible
from nmt_diagnose.ledger.size import size_of_change
from nmt_diagnose.ledger.sources import SourceColumn, _families, _smooth
from nmt_diagnose.measurements.backbone_table import scatter_about_a_course
from nmt_diagnose.measurements.stepped_reading import scatter_of_lines
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.noise.floors import repeatability
from nmt_diagnose.observations.noise.settling import settling
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.prediction import gaussian_motion
from nmt_diagnose.say.remainder import remainder
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import load_rig


def clip_depths(limit: float) -> list[tuple[float, float]]:
    """Depth at which the search for clipping begins, and its level over the largest value, of a channel of 2."""
    rig = chain()
    channels = [rig.sensor_channel(sensor) for sensor in rig.sensors]
    operating: Any = SimpleNamespace(
        channels=dict.fromkeys(channels, 2.0), limits=dict.fromkeys(channels, limit), unclipped=()
    )
    found = effect_named("clipping").sites(rig, operating)
    return [(site.scales["depth"], site.reference) for site in found]


def moving(share: float) -> int:
    """Points where an element to the ground may sit, of two that move, one by a share of the other."""
    operating: Any = SimpleNamespace(
        displacement={1: 1.0, 2: share}, pairs={}, omega=1.0, effective_stiffness=lambda point: 1.0
    )
    rig: Any = SimpleNamespace(structure=SimpleNamespace(points=(1, 2)))
    return len(list(spots(rig, operating)))


def shape_std() -> float:
    shape = SimpleNamespace(kind="shape", std=0.0)
    candidate = SimpleNamespace(effect=SimpleNamespace(parameters=(shape,)))
    return float(Parametrisation.prior_std.func(SimpleNamespace(calibration=(), candidates=(candidate,)))[0])  # type: ignore[attr-defined]


def lacking(left: float, away: float = 0.0, channels: int = 1, certain: bool = False, of: int = 11) -> int:
    """Modes that a fit lacks, which ``channels`` of some miss by so much at a distance in ln frequency."""
    line = np.full(of, 10.0 * math.exp(away))
    rows = SimpleNamespace(
        frequency_hz=line, part=np.full(of, Part.PHASE), harmonic=np.full(of, -1), channel=np.arange(of)
    )
    residual = np.where(np.arange(of) < channels, left, 0.0)
    data: Any = SimpleNamespace(
        observations=SimpleNamespace(rows=rows), used=np.ones(of, dtype=bool), residual=lambda values, errors: residual
    )
    found: Any = SimpleNamespace(prediction=SimpleNamespace(values=None), errors=SimpleNamespace(chain=None))
    modes: Any = SimpleNamespace(_lacking=[(10.0, "one")])
    return len(LowLevelModes.lacking(modes, data, found, certain))


def poles(damping: float, spacing_hz: float = 0.1, background: float = 0.0) -> int:
    """Modes that are seen in a response of one at 10 Hz; ``background``: what else there is at its frequency."""
    line = 10.03 + spacing_hz * np.arange(-60, 61)
    response = 1.0 / (100.0 - line**2 + 20.0j * damping * line)
    response = response + background / (20.0 * damping * 10.0)
    return len(measured_modes(line, response[np.newaxis], 1).poles)


def relative_scatter(estimate: Callable[[np.random.Generator], float], count: int) -> float:
    """Relative standard deviation of an estimate of ``count`` values, times the root of that."""
    found = [estimate(np.random.default_rng(seed)) for seed in range(300)]
    return float(np.std(found) / np.mean(found) * math.sqrt(count))


def scatter_of_responses(generator: np.random.Generator) -> float:
    noise = generator.standard_normal((2, 100))
    return scatter_of_lines(np.linspace(1.0, 2.0, 100), 1.0 + 0.01 * (noise[0] + 1j * noise[1]))[0]


def common_noise(share: float) -> bool:
    """Whether lines between 0.05 and 1 show a noise that all have beside a relative one of 1 %."""
    noise = np.random.default_rng(2).standard_normal((2, 100))
    line = np.geomspace(0.05, 1.0, 100)
    return (
        scatter_of_lines(np.linspace(1.0, 2.0, 100), line + np.hypot(0.01 * line, share) * (noise[0] + 1j * noise[1]))[
            1
        ]
        > 0.0
    )


def transients(size: float) -> bool:
    """Whether a transient shows in noise."""
    time = (np.arange(20) + 0.5) / 20
    noise = 0.01 * np.random.default_rng(1).standard_normal((20, 1))
    return bool(np.any(settling(size * np.exp(-4.0 * time)[:, None] + noise, np.array([True])).sizes))


def raised(pairs: int) -> bool:
    """Whether so many repeats of a frequency raise its floor."""
    first = run_observations(levels=pairs, harmonics=0)
    return bool(np.any(repeatability(first, replace(first, values=first.values + 1.0))[0] > first.floor))


def promising() -> float:
    return PROMISING.limit(Facts(promised_least=0.0))


def visible(sigmas: float) -> bool:
    observations = run_observations(levels=3)
    rows = replace(observations.rows, part=np.full(len(observations.rows), int(Part.LINE)))
    change = np.zeros(len(rows))
    change[0] = sigmas * observations.sigma[0]
    every = np.ones(len(rows), dtype=bool)
    return size_of_change(replace(observations, rows=rows), every, observations.sigma, change).other


def left(share: float) -> bool:
    observations = run_observations(levels=9)
    after = np.full(len(observations.rows), 3.0)
    return remainder(observations, replace(GAP, closed=1.0 - share), after) is not None


def third(levels: int, size: float) -> str:
    """Third of the levels where what is left is said to lie, where the highest level has so much of the squares."""
    observations = run_observations(levels=levels, harmonics=0)
    squares = np.full(levels, (1.0 - size) / (levels - 1))
    squares[-1] = size
    found = remainder(observations, replace(GAP, closed=0.5), 100.0 * np.sqrt(squares))
    assert found is not None
    return found.where[0].levels


def blocks(lines: int) -> float:
    """Gain over its scatter where every second line is closed: lines one by one scatter, tenths of them do not."""
    observations = run_observations(levels=lines, harmonics=0)
    before = np.where(np.arange(lines) % 2, 2.0, 1.0)
    every = np.ones(lines, dtype=bool)
    return closed(observations, [(before, np.zeros(lines), every)]).gain


def phase_sigma() -> float:
    observations = run_observations(levels=3, harmonics=0)
    rows = replace(observations.rows, part=np.full(3, int(Part.PHASE_ERROR)))
    return float(sigma_of(replace(observations, rows=rows, chains=(MeasuringChain(),)))[0])


def smooth_courses(distance: float) -> int:
    """Smooth courses over two levels that lie so many lengths apart."""
    return int(_smooth(np.eye(2), np.array([0.0, distance]), 1.0).shape[1])


def correlation_of_sources(per: Literal["level", "line"], distance: float) -> float:
    """Correlation of what an unnamed source does at two levels or lines, by their distance in ln."""
    x = np.array([1.0, math.exp(distance)])
    rows = SimpleNamespace(harmonic=np.zeros(2), level=np.arange(2), amplitude=x, frequency_hz=x)
    names = [SourceColumn("test", per, number) for number in (0, 1)]
    families = _families(np.eye(2), names, SimpleNamespace(rows=rows))  # type: ignore[arg-type]
    courses = families[0 if per == "level" else -1][1]
    covariance = courses @ courses.T
    return float(covariance[0, 1] / covariance[0, 0])


def nearest_poles(ratio: float) -> int:
    """Poles that are followed one by one, of one below the band of a test and one above it by a ratio."""
    model: Any = SimpleNamespace(
        poles=1j * np.array([10.0 / ratio, 20.0 * ratio]), displacement=np.ones((1, 2)), inputs=np.ones((2, 1))
    )
    followed: list[int] = []

    def settled(lines: Any, near: Any, *_: Any) -> tuple[Any, Any, bool]:
        followed.append(near[0].size)
        return None, None, False

    tables: Any = SimpleNamespace(elements=())
    at_rest = np.zeros(1), np.zeros(1)
    with patch.object(gaussian_motion, "_settled", settled):
        omega = np.array([10.0, 20.0])
        nothing: Any = ()
        driven = gaussian_motion.DrivenForces(
            model, tables, np.ones(1, bool), at_rest, nothing, omega, 1.0, np.ones(1), ("1",)
        )  # fmt: skip
        assert driven.found is None
    return followed[0]


def compared_with(log_ratio: float) -> float:
    """ln of the response that an addition is compared with, over the model's, by ln of the measured one over it."""
    part = np.array([int(Part.LOG_MAGNITUDE)])
    rows = SimpleNamespace(
        test=np.zeros(1, dtype=int), part=part, level=np.zeros(1, dtype=int), channel=np.zeros(1, dtype=int),
        frequency_hz=np.ones(1),
    )  # fmt: skip
    modes: Any = SimpleNamespace(
        rows=rows, observations=SimpleNamespace(values=np.array([log_ratio])), selected=np.zeros(1, dtype=int),
        forward=SimpleNamespace(difference=lambda left, right: left - right),
    )  # fmt: skip
    modes.logarithms = lambda *arguments: ModesLeftOut.logarithms(modes, *arguments)
    test: Any = SimpleNamespace(measured_responses=lambda level, channel: None)
    base: Any = SimpleNamespace(values=np.zeros(1))
    return float(np.log(ModesLeftOut._between(modes, test, 0, np.zeros(1, dtype=int), base))[0].real)


def change_by_a_finer_mesh(change: float) -> float:
    """What a finer mesh counts for where it changes a row by so much."""
    tests: Any = SimpleNamespace(
        rig=load_rig("beam"), tests=(), rows=SimpleNamespace(part=np.array([Part.PHASE])),
        forward=SimpleNamespace(difference=np.subtract),
    )  # fmt: skip
    finer = SimpleNamespace(predict=lambda rig: SimpleNamespace(values=np.array([change])))
    with patch.object(form_errors, "Forward", lambda *_: finer):
        return float(form_errors.mesh(tests, SimpleNamespace(values=np.zeros(1)))["mesh"][0])  # type: ignore[arg-type]


EDGES: dict[str, tuple[Callable[[], Any], Any]] = {
    "candidates.clip_depth": (lambda: clip_depths(0.0)[0], pytest.approx((0.1, 2.0))),
    "candidates.clip_depth_at_level": (lambda: clip_depths(1.0)[0], pytest.approx((0.5, math.exp(0.5)))),
    "candidates.least_motion_share": (lambda: (moving(0.9e-3), moving(1.1e-3)), (1, 2)),
    "comparison.equivalent_sigmas": (lambda: (same_class(2.9, 10.0), same_class(3.1, 10.0)), (True, False)),
    "comparison.incredible_probability": (lambda: furthest_credible(1), pytest.approx(-ndtri(0.005))),
    # The smaller eigenvalue of two courses over the larger is (1 - c) / (1 + c), c = exp(-d² / 2).
    "comparison.source_least_eigenvalue": (lambda: (smooth_courses(0.195), smooth_courses(0.205)), (1, 2)),
    "comparison.source_level_length": (
        lambda: correlation_of_sources("level", 1.5), pytest.approx(math.exp(-0.5))
    ),
    "comparison.source_line_length": (lambda: correlation_of_sources("line", 0.7), pytest.approx(math.exp(-0.5))),
    "prediction.far_pole_ratio": (lambda: (nearest_poles(2.9), nearest_poles(3.1)), (2, 0)),
    "misfit.large_log_ratio": (
        lambda: (compared_with(0.9), compared_with(1.1)), (pytest.approx(0.45), pytest.approx(1.1))
    ),
    "misfit.largest_mesh_change": (
        lambda: [change_by_a_finer_mesh(change) for change in (-0.3, 0.19, 0.3)], pytest.approx([-0.2, 0.19, 0.2])
    ),
    "fits.scale_degrees_of_freedom": (
        lambda: groups_of(run_observations(levels=3), np.zeros(51)).degrees[0], pytest.approx(6.0)
    ),
    "fits.shape_std": (shape_std, pytest.approx(1.0)),
    "modes.around_log_frequency": (lambda: (lacking(9.0, 0.11, 11), lacking(9.0, 0.09, 11)), (0, 1)),
    "modes.missed_sigmas": (lambda: (lacking(2.9, 0.0, 11), lacking(3.1, 0.0, 11)), (0, 1)),
    "modes.mode_share": (lambda: (lacking(9.0, 0.0, 5), lacking(9.0, 0.0, 6)), (0, 1)),
    "modes.certain_sigmas": (lambda: [lacking(sigmas, 0.0, 11, True) for sigmas in (9.9, 10.1)], [0, 1]),
    "modes.certain_channel_share": (lambda: [lacking(99.0, 0.0, some, True, 20) for some in (15, 16)], [0, 1]),
    "modes.highest_measured_damping": (lambda: (poles(0.055), poles(0.045)), (0, 1)),
    "modes.least_width_lines": (lambda: (poles(0.00125), poles(0.00175)), (0, 1)),
    "noise.stepped_floor_log_likelihood": (lambda: (common_noise(0.0003), common_noise(0.003)), (False, True)),
    "noise.median_relative_std": (
        lambda: relative_scatter(scatter_of_responses, 200) / THRESHOLDS.noise.median_relative_std,
        pytest.approx(1.0, abs=0.3),
    ),
    "noise.cubic_relative_std": (
        lambda: relative_scatter(
            lambda generator: scatter_about_a_course(np.arange(40.0), generator.standard_normal(40)), 40
        ) / THRESHOLDS.noise.cubic_relative_std,
        pytest.approx(1.0, abs=0.3),
    ),
    "noise.settling_sigmas": (lambda: (transients(0.012), transients(0.018)), (False, True)),
    "noise.floor_fewest_pairs": (lambda: (raised(5), raised(6)), (False, True)),
    "search.least_cost_fall": (promising, pytest.approx(6.0)),
    "search.far_behind_log_evidence": (lambda: IN_REACH.limit(Facts(behind_most=math.inf)), pytest.approx(40.0)),
    "verdict.visible_sigmas": (lambda: (visible(4.9), visible(5.1)), (False, True)),
    "verdict.least_remainder": (lambda: (left(0.009), left(0.011)), (False, True)),
    "verdict.remainder_fewest_levels": (lambda: (third(2, 0.9), third(3, 0.9)), ("", "highest levels")),
    "verdict.remainder_third_share": (lambda: (third(3, 0.45), third(3, 0.55)), ("", "highest levels")),
    "verdict.many_lines": (lambda: [blocks(lines) > 20.0 for lines in (60, 62)], [False, True]),
    "tolerances.lock_phase_deg": (phase_sigma, pytest.approx(math.hypot(0.01, math.radians(0.5)))),
    "tolerances.shared_delay_s": (lambda: MeasuringChain().shared_delay_s, pytest.approx(1e-4)),
}  # fmt: skip


@pytest.mark.parametrize("path", EDGES)
def test_a_threshold_decides(path: str) -> None:
    outcome, expected = EDGES[path]
    assert outcome() == expected
