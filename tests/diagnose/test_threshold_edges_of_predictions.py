"""What thresholds of predictions, decays and proposed tests decide, on either side; see test_threshold_edges."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnose.predicted_tests import chain, noise_test, rows_of
from diagnose.test_modes_left_out import LINES, receptance, without_level
from diagnose.test_ring_down_estimator import observations_of as decay_observations
from diagnose.test_ring_down_estimator import rig as modes_of_decay
from diagnose.test_stepped_sine import HZ, OMEGA, observations_of, oscillator, swept
from diagnose.test_threshold_edges_of_measurements import ReachedError, reaches

from nmt_core.errors import BenchError
from nmt_core.kinds import RandomTest, SteppedSineTest
from nmt_core.kinds.request import TestRequest
from nmt_core.vocabulary import ControlKind, Quantity
from nmt_diagnose.ahead import frequency_sweep as sweeps
from nmt_diagnose.ahead import next_tests as looking
from nmt_diagnose.ahead.expected_rows import expected
from nmt_diagnose.ahead.proposals import Proposal
from nmt_diagnose.chain.chain_columns import linear_chain
from nmt_diagnose.effects.effect import Candidate, Site
from nmt_diagnose.effects.library import effect_named
from nmt_diagnose.effects.location import Explanation, Location
from nmt_diagnose.fit.low_level_modes import LowLevelModes
from nmt_diagnose.ledger import held_out
from nmt_diagnose.measurements import recorded_decay as decays
from nmt_diagnose.measurements.measurement import RowTable, empty, joined
from nmt_diagnose.observations import bag_windows
from nmt_diagnose.observations.channels.measuring_chain import table_chain
from nmt_diagnose.observations.observables import Part
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.prediction.influence import Source
from nmt_diagnose.search import search as searches
from nmt_signals.decays import decay_reading
from nmt_signals.decays.decay_nodes import Node, nodes
from nmt_signals.decays.decay_signal import SlowAmplitude
from nmt_signals.thresholds import DECAYS


def in_place_of(module: Any, name: str, other: Any, work: Callable[[], Any]) -> Any:
    """What work gives while a function of a module is another."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, name, other)
        return work()


def reached(*_: Any) -> None:
    raise ReachedError


# -- the model --------------------------------------------------------------------------------------------------------


def modes_left_out() -> list[float]:
    """What modes above the band and one below it add to ln |H| of the last line, over the static flexibility there.

    The model is the measured oscillator itself: Re (X / H) of a constant flexibility X.
    """
    test = swept(LINES, 1.0, receptance(False))
    observations = replace(observations_of([test]), tests=(without_level(test),), chains=(table_chain(),))
    rig = oscillator()
    found = linear_chain(observations, rig, Forward(observations.tests, observations.rows).predict(rig))
    of_modes = [k for k, name in enumerate(found.names) if name.startswith("ModesLeftOut")]
    flexible = (1.0 / receptance(False)[-1]).real / OMEGA**2
    return [float(found.columns[LINES.size - 1, k] / flexible) for k in of_modes]


def modes_of(damping_ratio: float) -> int:
    """Modes of a model with one of such a damping."""
    model = chain(
        structure={
            "kind": "chain", "masses_kg": [1.0], "springs_n_m": [], "dampers_ns_m": [], "ground_springs_n_m": [1e4],
            "ground_dampers_ns_m": [2.0 * damping_ratio * 100.0],
        },
        local_elements=[], exciter={"kind": "force", "point": 1},
        sensors=[{"quantity": "force", "point": "drive"}, {"quantity": "displacement", "point": 1}],
    )  # fmt: skip
    test, _ = noise_test(model, 5.0, 60.0, 60, window="none")
    found = LowLevelModes(joined([RowTable().observations(test)]), model).modes(model, test)
    assert found is not None
    return int(found.poles.size)


def unit_source() -> float:
    """Largest change of ln |F| by a unit error of the force sensor, in a random test over the voltage."""
    model = chain(local_elements=[])
    test, table = noise_test(model, 5.0, 60.0, 10, window="none")
    rows = replace(rows_of(table), frequency_hz=test.lines_hz[[line for _, line, *_ in table]])
    forward = Forward((test,), rows)
    columns, _ = forward.influence(model, forward.predict(model), Source("force_sensor"))
    return float(np.abs(columns[rows.part == Part.LOG_MAGNITUDE]).max())


def jumps(log_step: float) -> int:
    """Jumps of a sweep whose amplitude changes by such a step from one line to the next."""
    test = swept(np.array([50.0, 51.0]), 1.0, np.ones(2))
    sizes = iter((1.0, math.exp(log_step)))
    return int(
        in_place_of(
            sweeps, "_stable_states", lambda *_: [(next(sizes), 1.0 + 0j)],
            lambda: len(sweeps.frequency_sweep(oscillator(), test, 10.0).jumps),
        )
    )  # fmt: skip


def even_effect_is_solved(sigmas: float) -> bool:
    """Whether an even effect that changes the rows by so much at a strength of one scale is looked at by a solution."""
    candidate = Candidate(
        effect_named("quadratic_stiffness"), Site(Location.at("structure", 2), {"k": 1.0, "k2": 1.0}, 2)
    )
    search = searches.Search(SimpleNamespace(), None, (), [candidate])  # type: ignore[arg-type]
    search._slopes = lambda base, pieces: [np.array([sigmas])]  # type: ignore[method-assign, assignment]
    fit: Any = SimpleNamespace(
        theta=np.zeros(0), prediction=None, parametrisation=SimpleNamespace(spreads=()),
        errors=SimpleNamespace(chain=np.zeros(0)),
    )  # fmt: skip
    base: Any = SimpleNamespace(explanation=Explanation(()), candidates=(), fit=fit)

    def solved() -> bool:
        try:
            return reaches(lambda: search.scores(base))
        except AttributeError:  # the score of what goes with the strength itself needs the slopes of the model
            return False

    return bool(in_place_of(searches, "predicted", reached, solved))


# -- held-out rows and proposed tests ---------------------------------------------------------------------------------


def judged_splits(share: float) -> int:
    """Splits that judge an explanation of which they leave a share of its change open."""
    one = np.ones(4)
    refits = {"null": SimpleNamespace(std=0.0 * one, residual=one), "best": SimpleNamespace(std=share * one)}
    refits["best"].residual = 0.0 * one
    fitted = {
        name: SimpleNamespace(
            name=name, scale=lambda: 1.0,
            fit=SimpleNamespace(prediction=SimpleNamespace(values=name), errors=None),
        )
        for name in refits
    }  # fmt: skip
    split = SimpleNamespace(held_out=np.ones(4, dtype=bool))
    data = SimpleNamespace(used=np.ones(4, dtype=bool), observations=None, sigma=one)
    looked: Any = SimpleNamespace(
        null=fitted["null"], everything=data, splits=(split,), refitted=lambda found, _: refits[found.name]
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            held_out, "best_chain_errors", lambda data, values, *_: SimpleNamespace(residual=refits[values].residual)
        )
        patch.setattr(held_out, "no_worse_than_silence", lambda observations, residual, sigma: residual)
        return len(held_out.HeldOut.pairs(looked, fitted["best"]))  # type: ignore[arg-type]


def asked(sigmas: float) -> int:
    """Tests that are proposed to a person, of one that sets two explanations so far apart."""
    rivals: Any = SimpleNamespace(
        apart=lambda left: SimpleNamespace(sigmas=lambda: (sigmas, sigmas)), names=("a", "b"), information=lambda _: 1.0
    )
    one = Proposal("a test", TestRequest(), empty())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(looking, "proposals", lambda *_: [one])
        patch.setattr(looking, "_Rivals", SimpleNamespace(of=lambda *_: rivals))
        return len(looking.next_tests(None, None, None, None))  # type: ignore[arg-type]


def random_std() -> float:
    """Uncertainty that is reckoned with of a line of a random test, where nothing has been measured."""
    request = TestRequest(kind=RandomTest(band_low_hz=5.0, band_high_hz=60.0, duration=30.0), levels=(0.15,))
    return float(np.max(expected(request, chain(local_elements=[]), empty()).std))


def stepped_levels(phase_rad: float) -> int:
    """Levels that a sine at such a phase from the resonance of a mode is, driven by a force."""
    # tan φ = 2ζ r / (1 − r²) of the displacement, a quarter turn before it of the velocity.
    slope = 2.0 * 0.01 * math.tan(phase_rad)
    ratio = 0.5 * (slope + math.sqrt(slope**2 + 4.0))
    request = TestRequest(
        kind=SteppedSineTest(), levels=(0.5,), frequencies_hz=(HZ * ratio,), control=ControlKind.FORCE
    )
    try:
        found = expected(request, oscillator(), empty())
    except BenchError:
        return 0
    return len(found.tests[0].levels)


# -- decays and windows -----------------------------------------------------------------------------------------------


def node(omega_std: float = 0.0) -> Node:
    return Node(0, 0.0, 1.0, 0.0, 100.0, 100.0 * omega_std, 1.0, 0.0, 0, 10)


def known(omega_std: float) -> int:
    """Amplitudes of a decay that are used, whose frequencies have such an uncertainty."""
    time = np.arange(4000) / 400.0
    samples = np.exp(-0.5 * time) * np.cos(2.0 * math.pi * 20.0 * time)

    def read() -> int:
        try:
            found = decay_reading.read_decay(samples, 400.0, Quantity.VELOCITY, lambda found: found[0], 12, 1e-4)
        except BenchError:
            return 0
        return len(found.good)

    return int(in_place_of(decay_reading, "nodes", lambda *_: [node(omega_std)], read))


def first_part(ratio: float, log_fall: float = 0.28) -> int:
    """Periods of the first part of a decay of which something else rings over the first ten periods.

    Args:
        ratio: of the scatter there to that later on.
        log_fall: by which the decay falls over 14 periods.
    """
    period = np.arange(160.0)
    scatter = 1e-3 * np.where(period < 10, ratio, 1.0) * np.random.default_rng(3).choice([-1.0, 1.0], period.size)
    values = np.exp(-log_fall / 14.0 * period) * (1.0 + scatter)
    first = nodes(SlowAmplitude(np.arange(period.size + 4.0), 1, period, values.astype(np.complex128)), 8, 0)[0]
    return first.stop - first.first


def by_turning_points(periods: float) -> bool:
    """Whether a decay of so many periods that spectra do not show is read by its turning points."""
    stretch: Any = SimpleNamespace(
        channels=[SimpleNamespace(name="x1", quantity=Quantity.DISPLACEMENT)], faults={},
        samples=round(100.0 * periods), sample_rate=1000.0, row=lambda name: np.zeros(3),
    )  # fmt: skip
    view: Any = SimpleNamespace(rig=SimpleNamespace(drive_point=1), frequencies_hz=(10.0,))
    channels: Any = {"x1": SimpleNamespace(point=1)}

    def unseen(*_: Any) -> None:
        raise BenchError("nothing")

    def read() -> bool:
        settings = ObservationSettings()
        return reaches(lambda: decays.ring_down_observations("decay", stretch, 10.0, view, channels, settings))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(decays, "read_decay", unseen)
        patch.setattr(decays, "half_cycle_nodes", reached)
        return read()


def second_channel(std: float) -> int:
    """Rows of a second channel of a decay whose ratio to the first is known so well."""
    rate = 2000.0
    time = np.arange(8000) / rate
    samples = np.exp(-1.0 * time) * np.cos(2.0 * math.pi * 50.0 * time)
    found = in_place_of(
        decays, "ratio_at", lambda *_: (1.0 + 0j, std),
        lambda: decay_observations(samples, rate, modes_of_decay(), a2=samples),
    )  # fmt: skip
    return int(np.sum(found.rows.part == Part.PHASE))


def window_is_used(samples: int) -> bool:
    """Whether a window of so many samples is looked into."""

    class Stretch:
        @property
        def channels(self) -> Sequence[Any]:
            raise ReachedError

    stretch = Stretch()
    stretch.samples = samples  # type: ignore[attr-defined]
    segment: Any = SimpleNamespace(level_index=0)
    bag: Any = SimpleNamespace(run_start={})

    def read() -> bool:
        return reaches(lambda: bag_windows.BagWindows.of(bag, "run", [segment], None, None, True, []))  # type: ignore[arg-type]

    return bool(in_place_of(bag_windows, "read_windows", lambda *_: [stretch], read))


SPECTRAL = 3.0 * DECAYS.fewest_periods
AT_TENTH = 1.0 / (1.0 - 0.1**2)
"""Displacement of an oscillator at a tenth of its frequency over the static one."""
EDGES: dict[str, tuple[Callable[[], Any], Any]] = {
    "misfit.static_share_above": (lambda: modes_left_out()[0], pytest.approx(0.2 * AT_TENTH, rel=1e-3)),
    "misfit.static_share_below": (
        lambda: modes_left_out()[3], pytest.approx(0.05 * AT_TENTH * (HZ / LINES[-1]) ** 2, rel=1e-3)
    ),
    "misfit.static_frequency_ratio": (lambda: modes_left_out()[0], pytest.approx(0.2 * AT_TENTH, rel=1e-3)),
    "modes.highest_model_damping": (lambda: (modes_of(0.29), modes_of(0.31)), (1, 0)),
    "prediction.continued_log_step": (lambda: (jumps(0.49), jumps(0.51)), (0, 1)),
    "prediction.unit_source_share": (unit_source, pytest.approx(0.01)),
    "search.first_order_sigmas": (lambda: [even_effect_is_solved(it) for it in (0.9, 1.1)], [True, False]),
    "verdict.open_prediction_share": (lambda: (judged_splits(0.29), judged_splits(0.31)), (1, 0)),
    "next_test.least_sigmas": (lambda: (asked(2.9), asked(3.1)), (0, 1)),
    "next_test.typical_response_std": (random_std, pytest.approx(0.005)),
    "reading.furthest_phase_rad": (lambda: [stepped_levels(math.radians(it)) for it in (59.0, 61.0)], [1, 0]),
    "reading.decay_few_spectral_periods": (
        lambda: [by_turning_points(periods) for periods in (SPECTRAL - 1.0, SPECTRAL + 1.0)], [True, False]
    ),
    "reading.decay_largest_ratio_std": (lambda: [second_channel(std) > 0 for std in (0.09, 0.11)], [True, False]),
    "reading.stretch_fewest_samples": (lambda: (window_is_used(15), window_is_used(16)), (False, True)),
    "signals.decays.unsettled_ratio": (lambda: [first_part(ratio) < 9 for ratio in (3.6, 4.2)], [False, True]),
    "signals.decays.fast_log_fall": (lambda: [first_part(5.0, fall) < 9 for fall in (1.95, 2.05)], [True, False]),
    "signals.decays.largest_log_std": (lambda: (known(0.029), known(0.031)), (1, 0)),
}  # fmt: skip


@pytest.mark.parametrize("path", EDGES)
def test_a_threshold_decides(path: str) -> None:
    outcome, expected = EDGES[path]
    assert outcome() == expected
