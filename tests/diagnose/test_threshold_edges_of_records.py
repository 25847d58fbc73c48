"""What thresholds of recordings, searches and warnings decide, on either side of each; see test_threshold_edges."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from diagnose.predicted_tests import chain
from diagnose.test_residuals import run_observations
from diagnose.test_warnings import GAP, best

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_diagnose.ahead.apart import competing
from nmt_diagnose.effects.sensor_effects import late_channels
from nmt_diagnose.fit import model_alone as model_alone_module
from nmt_diagnose.fit.explanations import Score
from nmt_diagnose.fit.low_level_modes import Modes, disorder, modes_that_lack
from nmt_diagnose.fit.misfit import misfit_of
from nmt_diagnose.ledger.comparison import Comparison, EquivalentClass, _source
from nmt_diagnose.ledger.diagnosis import Verdict
from nmt_diagnose.ledger.held_out import splits
from nmt_diagnose.ledger.judgement import _alone
from nmt_diagnose.ledger.warnings import warned
from nmt_diagnose.measurements.backbone_table import scatter_about_a_course
from nmt_diagnose.measurements.driven_record import refinement
from nmt_diagnose.measurements.stepped_reading import force_groups, jumps_of, scatter_of_lines
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.noise.settling import settling
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.search.search import Search
from nmt_rig.rig import Rig
from nmt_signals.decays.decay_reading import _pays
from nmt_signals.decays.decay_signal import _clear, ridges, slow_amplitude
from nmt_signals.decays.half_cycles import half_cycle_nodes
from nmt_signals.frequency_responses import averaged_spectra

MODEL: Rig = chain()


def refused(work: Callable[[], Any]) -> bool:
    try:
        work()
    except BenchError:
        return True
    return False


def decay(samples: float, period: float, fall: float = 0.05) -> np.ndarray:
    """A sine of so many samples a period that falls by ``fall`` in each."""
    n = np.arange(int(samples))
    return np.asarray(np.exp(-fall * n / period) * np.cos(2.0 * np.pi * n / period + 0.3))


def too_short(periods: float, per_period: float) -> bool:
    """Whether a decay has too few periods, or samples in each, to be followed."""
    samples = decay(periods * per_period, per_period)
    found = ridges(samples, per_period, Quantity.VELOCITY)
    return refused(lambda: slow_amplitude(samples, per_period, found[0], 1))


def nodes(periods: float, per_period: float = 40.0, fall: float = 0.05) -> int:
    """Nodes of the turning points of a decay; 0 where there are too few."""
    try:
        return len(half_cycle_nodes(decay(periods * per_period, per_period, fall), per_period, 1.0))
    except BenchError:
        return 0


def averages(segments: int) -> bool:
    signals = {"x": np.random.default_rng(1).standard_normal(64 * segments)}
    return refused(lambda: averaged_spectra(signals, 64.0, 64, overlap=0.0))


def transient(windows: int) -> bool:
    """Whether an exact exponential shows in so many sub-windows."""
    time = (np.arange(windows) + 0.5) / windows
    logs = 0.1 * np.exp(-2.0 * time)[:, None] * np.ones((1, 2))
    return bool(np.any(settling(logs, np.ones(2, dtype=bool)).sizes))


def groups(step: float) -> int:
    return len(force_groups(np.array([1.0, 1.0 + step]), np.ones(2, dtype=bool)))


def jumps(step: float, beside: float) -> int:
    """Jumps of a magnitude that changes by one step between smaller ones."""
    logs = np.cumsum([0.0, beside, -beside, step, beside, -beside])
    return len(jumps_of(np.exp(logs).astype(np.complex128)))


def lines(count: int) -> float:
    frequency = np.linspace(1.0, 2.0, count)
    return scatter_of_lines(frequency, (1.0 + 0.1 * frequency).astype(np.complex128))[0]


def points(count: int) -> float:
    return scatter_about_a_course(np.arange(float(count)), np.random.default_rng(1).standard_normal(count))


def finer(share: float) -> int:
    """Steps between samples of a drive whose response has its power at a share of the sampling rate."""
    return refinement(np.cos(2.0 * np.pi * share * np.arange(8192)), 1.0)


def lacking(frequency_hz: float) -> int:
    """Modes that a model lacks, of one at a frequency, in responses from 10 to 100 Hz."""
    omega = 2.0 * np.pi * frequency_hz
    modes = Modes(np.array([omega * (-0.01 + 1j)]), np.ones((1, 1), dtype=np.complex128))
    return len(modes_that_lack("test", (10.0, 100.0), modes, np.array([-1])))


def crossed(likeness: float) -> int:
    """Whether two modes in the other order are told, by how much they are like the model's."""
    poles = 2.0 * np.pi * np.array([20.0, 30.0]) * (-0.01 + 1j)
    modes = Modes(poles, np.ones((2, 1), dtype=np.complex128))
    return len(disorder("test", modes, np.array([1, 0]), np.full((2, 2), likeness)))


def competitors(second: float = 0.0, none: float = 0.0) -> int:
    first = EquivalentClass((best(),), 0.9)
    classes = (first, EquivalentClass((best(),), second)) if second else (first,)
    return len(competing(Comparison(none, 0.0, classes, {}, 0.0, {}), best()))


def chosen(cosine: float) -> int:
    """How many of two effects are fitted where one is wanted, by how much they change the rows alike."""
    columns = (np.array([1.0, 0.0]), np.array([cosine, math.sqrt(1.0 - cosine**2)]))
    search = SimpleNamespace(candidates=[SimpleNamespace(effect=SimpleNamespace(name=name)) for name in "ab"])
    base = SimpleNamespace(fit=SimpleNamespace(errors=SimpleNamespace(weights=np.ones(2))))
    scores = [Score(k, np.zeros(1), 100.0 - k, 1.0, column) for k, column in enumerate(columns)]
    return len(Search.chosen(search, base, scores, 1, 1, 6.0))  # type: ignore[arg-type]


def exceeds(scale: float) -> bool:
    """Whether a fit with a learnt scale leaves so much that it is tried from the model as given."""
    found = SimpleNamespace(errors=SimpleNamespace(squares=np.array([10.0 * scale**2])))
    data = SimpleNamespace(counts=np.array([10.0]), groups=SimpleNamespace(degrees=np.array([6.0])))
    return Search.exceeds_noise(SimpleNamespace(data=data), found)  # type: ignore[arg-type]


def misfit(name: str) -> float:
    """Misfit of a frequency of which 0.05 % matters."""
    observations = run_observations()
    observations = replace(observations, matters={"frequency": 5e-4}, chains=(MeasuringChain(),))
    row = int(np.flatnonzero(observations.rows.part == Part.LOG_FREQUENCY)[0])
    return float(getattr(misfit_of(observations), name)[row])


def warnings(closed: float, after: float) -> int:
    return len(warned(Verdict.EFFECT, best(), (), replace(GAP, closed=closed, after=after)))


def moved(theta: float) -> int:
    return len(warned(Verdict.EFFECT, best(theta), (SimpleNamespace(name="k", start=1.0, to=2.0, unit="N/m"),), GAP))  # type: ignore[arg-type]


def held_out(levels: int) -> bool:
    return any(split.name == "every second level" for split in splits(run_observations(levels=levels)))


def late(delay_s: float) -> int:
    return len(late_channels(SimpleNamespace(delays={"a": delay_s}, omega=100.0), ["a"]))  # type: ignore[arg-type]


def stands_out(ratio: float) -> bool:
    """Whether a peak of a power over that around it is one."""
    power = np.ones(41)
    power[20] = ratio
    return _clear(power, 20)


def narrower_pays(ratio: float) -> bool:
    """Whether a narrower band is taken by the uncertainty of its frequency over that of a wider one."""
    log = np.linspace(0.0, -1.0, 10)
    wider, narrower = (
        SimpleNamespace(
            slow=SimpleNamespace(log=log),
            good=[SimpleNamespace(first=0, stop=10, omega=1.0, omega_std=std, amplitude=1.0)],
        )
        for std in (1e-3, ratio * 1e-3)
    )
    return _pays(narrower, wider, 0.0)  # type: ignore[arg-type]


def diverged(rise: float) -> bool:
    """Whether a fit with an effect has diverged, by the rise of its cost over that without."""
    search: Any = SimpleNamespace(
        candidates=[SimpleNamespace(cause="a")], lost=set(), parametrisation=lambda *_: None,
        best=lambda *_, **__: SimpleNamespace(fit=SimpleNamespace(cost=rise)),
    )  # fmt: skip
    fit = SimpleNamespace(parametrisation=None, cost=0.0, theta=np.zeros(1))
    base: Any = SimpleNamespace(fit=fit, candidates=())
    score: Any = SimpleNamespace(candidate=0, start=np.ones(1))
    with (
        patch("nmt_diagnose.search.search.spread_at", lambda *_: 1.0),
        patch("nmt_diagnose.search.search.strength_position", lambda candidate: 0),
        patch("nmt_diagnose.search.search.at_strength", lambda candidate, start, strength: start),
    ):
        return Search.with_added(search, base, score) is None


def recalibrates(fall: float) -> float:
    """How far the fall of the cost by the model's own parameters is a calibration."""
    findings: Any = SimpleNamespace(
        data=None, null=SimpleNamespace(fit=SimpleNamespace(cost=0.0)), as_given_errors=SimpleNamespace(cost=fall),
        comparison=SimpleNamespace(log_odds=0.0), inadequate=(), factors=(), unexplained=(0.0,), contradiction=None,
    )  # fmt: skip
    return float(_alone(findings, None).left_without)  # type: ignore[arg-type]


def sizes_of_a_source() -> list[float]:
    """Sizes that are tried of a source whose column is a unit vector: from the prior of each that is added."""
    tried: list[float] = []

    def slogdet(matrix: np.ndarray) -> tuple[float, float]:
        tried.append(math.sqrt(float(matrix[0, 0]) - 1.0))  # (1 + 1/s²) s² - 1
        return 1.0, 0.0

    errors = SimpleNamespace(chain=np.zeros(0), squares=np.zeros(1), weights=np.ones(2), residual=np.zeros(2))
    groups = SimpleNamespace(
        cost=lambda squares, counts: 0.0, sums=lambda squares: np.zeros(1), of=np.zeros(2, dtype=int),
        weights=lambda squares, counts: np.ones(1),
    )  # fmt: skip
    data: Any = SimpleNamespace(groups=groups, counts=np.ones(1))
    base: Any = SimpleNamespace(fit=SimpleNamespace(errors=errors, theta=np.zeros(1)))
    metric: Any = SimpleNamespace(project=lambda block: (block, np.zeros((1, 1))))
    with patch("numpy.linalg.slogdet", slogdet):
        _source(data, base, metric, np.ones(1), np.array([[1.0], [0.0]]))
    return sorted({round(size, 9) for size in tried})


def is_compared(solved: int) -> bool:
    """Whether a model is compared that has a solution for so many of a hundred rows."""
    values = np.where(np.arange(100) < solved, 0.0, np.nan)
    forward = SimpleNamespace(predict=lambda *_: SimpleNamespace(values=values))
    observations: Any = SimpleNamespace(tests=(), rows=None)

    def reached(*_: Any) -> Any:
        raise ArithmeticError("reached")

    with (
        patch.object(model_alone_module, "Forward", lambda *_: forward),
        patch.object(model_alone_module, "traced", lambda tests, prediction: tests),
        patch.object(model_alone_module, "replace", lambda observations, **_: observations),
        patch.object(model_alone_module, "_with_solver_error", reached),
    ):
        try:
            model_alone_module.model_alone(MODEL, observations, (), np.ones(100, dtype=bool), None)  # type: ignore[arg-type]
        except BenchError as error:
            return "reached" in str(error)
    return False


EDGES: dict[str, tuple[Callable[[], Any], Any]] = {
    "signals.decays.fewest_periods": (lambda: (too_short(6.0, 20.0), too_short(14.0, 20.0)), (True, False)),
    "signals.decays.fewest_samples_per_period": (lambda: (too_short(40.0, 2.7), too_short(40.0, 3.4)), (True, False)),
    "signals.decays.frame_fewest_samples": (
        lambda: [refused(lambda n=n: ridges(decay(n, 8.0), 8.0, Quantity.VELOCITY)) for n in (63, 64)], [True, False]
    ),
    "signals.decays.turning_fewest_samples": (lambda: (nodes(8.0, 9.5) > 0, nodes(8.0, 10.5) > 0), (False, True)),
    "signals.decays.turning_fewest_swings": (lambda: (nodes(2.2), nodes(2.7)), (0, 1)),
    # 0.98^k of the swing falls below a fiftieth of the largest.
    "signals.decays.turning_smallest_share": (
        lambda: abs(nodes(40.0, fall=0.4) - math.log(50.0) / 0.4) <= 1.5, True
    ),
    "signals.decays.ridge_peak_ratio": (lambda: (stands_out(19.0), stands_out(21.0)), (False, True)),
    "signals.decays.narrower_gain": (lambda: (narrower_pays(0.51), narrower_pays(0.49)), (False, True)),
    "search.lost_cost_rise": (lambda: (diverged(19.0), diverged(21.0)), (False, True)),
    "verdict.recalibration_cost_fall": (lambda: recalibrates(20.0), pytest.approx(0.8)),
    "comparison.source_sizes": (sizes_of_a_source, pytest.approx([0.003, 0.03, 0.3, 3.0])),
    "fits.least_solved_share": (lambda: (is_compared(29), is_compared(31)), (False, True)),
    "signals.fits.fewest_averages": (lambda: (averages(2), averages(3)), (True, False)),
    "noise.settling_fewest": (lambda: (transient(5), transient(6)), (False, True)),
    "noise.stepped_fewest_for_scatter": (lambda: (math.isnan(lines(11)), math.isnan(lines(12))), (True, False)),
    "noise.table_fewest_for_scatter": (lambda: (points(6) > 0.0, points(7) > 0.0), (False, True)),
    "reading.stepped_same_level": (lambda: (groups(0.8e-3), groups(1.2e-3)), (1, 2)),
    "reading.stepped_jump": (lambda: (jumps(0.45, 0.01), jumps(0.55, 0.01)), (0, 1)),
    "reading.stepped_jump_ratio": (lambda: (jumps(1.0, 0.27), jumps(1.0, 0.23)), (0, 1)),
    # π f / √(3 · 0.003) of the sampling rate, to the next power of two.
    "reading.record_hold_error": (lambda: (finer(0.025), finer(0.1)), (1, 4)),
    "reading.record_finest_steps": (lambda: finer(0.495), 32),
    "modes.edge_ratio": (lambda: [lacking(f) for f in (12.9, 13.1, 76.8, 77.0)], [0, 1, 1, 0]),
    "modes.alike_mac": (lambda: (crossed(0.49), crossed(0.51)), (1, 0)),
    "next_test.second_class_share": (lambda: (competitors(0.017), competitors(0.019)), (0, 2)),
    "next_test.doubtful_probability": (lambda: (competitors(none=0.04), competitors(none=0.06)), (0, 2)),
    "search.alike_cosine": (lambda: (chosen(0.97), chosen(0.985)), (1, 2)),
    "search.noise_scale": (lambda: (exceeds(1.9), exceeds(2.1)), (False, True)),
    "misfit.shared_share": (lambda: misfit("common"), pytest.approx(0.2 * 5e-4)),
    "misfit.independent_share": (lambda: misfit("independent"), pytest.approx(0.02 * 5e-4)),
    "verdict.left_over_scale": (lambda: (warnings(0.5, 1.9), warnings(0.5, 2.1)), (0, 1)),
    "verdict.small_left_share": (lambda: (warnings(0.86, 3.0), warnings(0.84, 3.0)), (0, 1)),
    "verdict.held_out_fewest_levels": (lambda: (held_out(3), held_out(4)), (False, True)),
    "candidates.large_delay_phase_rad": (lambda: (late(0.0029), late(-0.0031)), (0, 1)),
}  # fmt: skip


@pytest.mark.parametrize("path", EDGES)
def test_a_threshold_decides(path: str) -> None:
    outcome, expected = EDGES[path]
    assert outcome() == expected
