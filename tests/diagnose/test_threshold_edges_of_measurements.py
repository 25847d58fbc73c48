"""What thresholds of measurements and of the search decide, on either side of each; see test_threshold_edges."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.vocabulary import TestKind
from nmt_diagnose.ahead.hidden_effects import Growth
from nmt_diagnose.chain.chain_columns import ChainBuilder
from nmt_diagnose.chain.shape_errors import ShapeErrors
from nmt_diagnose.effects.location import Cause, Explanation, Location
from nmt_diagnose.fit.explanations import Score
from nmt_diagnose.fit.low_level_modes import LowLevelModes, Modes, paired
from nmt_diagnose.fit.misfit import Whitening
from nmt_diagnose.fit.noise import sigma_of
from nmt_diagnose.ledger.comparison import Comparison, EquivalentClass
from nmt_diagnose.ledger.held_out import splits
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.driven_record import (
    head_of,
    independent_values,
    record_observations,
    start_of,
    white_noise,
)
from nmt_diagnose.measurements.locked_reading import Cell, UsedWindows, add_rows_of_channels, moderate
from nmt_diagnose.measurements.measurement import LevelSeries
from nmt_diagnose.measurements.random_reading import lines_of, response_table_observations
from nmt_diagnose.measurements.recorded_decay import add_nodes, notes_of
from nmt_diagnose.measurements.stepped_reading import noise_of_lines
from nmt_diagnose.measurements.stepped_responses import whitened_difference
from nmt_diagnose.observations.bag_windows import BagWindows
from nmt_diagnose.observations.observables import Part, Place
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.prediction.operating_range import as_measured, joined_points
from nmt_diagnose.search.search import Search
from nmt_record.exchange.reduced.observables import TableKind
from nmt_signals.channel_faults.mains_lines import MAINS_HZ
from nmt_signals.decays.decay_nodes import Node

MOTION = MeasuredChannel("x1", Quantity.DISPLACEMENT, 1)
WAVE = np.sin(0.3 * np.arange(2000) + 0.1)


class ReachedError(Exception):
    """Something has been asked for that comes behind a threshold."""


def reaches(work: Callable[[], Any]) -> bool:
    try:
        work()
    except ReachedError:
        return True
    return False


# -- rows of channels -------------------------------------------------------------------------------------------------


def channel_rows(
    part: Part, samples: np.ndarray = WAVE, *, hum: float = 0.0, noise: float = 0.0, clip: float | None = None
) -> list[tuple[float, float]]:
    """Value and floor of the rows that one window of one channel gives.

    Args:
        part: of the rows.
        samples: of the window.
        hum: amplitude of the line of the less common mains over its noise.
        noise: standard deviation of the samples; 0 = not known.
        clip: level at which the model's sensor is clipped.
    """
    found: list[tuple[float, float]] = []

    def add(kind: Part, value: float, std: float, floor: float, place: Place, channel: int) -> None:
        if kind is part:
            found.append((value, floor))

    line = SimpleNamespace(amplitudes=np.array([hum]), std=np.ones(1))
    window = SimpleNamespace(
        mains={MAINS_HZ[1]: line} if hum else {}, moved=(), rows={"x1"}, row=lambda name: 0,
        amplitudes=np.zeros((1, 2)), stretch=SimpleNamespace(row=lambda name: samples, samples=samples.size),
    )  # fmt: skip
    level = SimpleNamespace(drive=1.0, force_n=1.0, start_s=0.0, stop_s=1.0, frequency_hz=10.0)
    run: Any = UsedWindows("run", [window], [level], [MOTION], {"x1": "x1"}, "voltage")  # type: ignore[list-item]
    cells = [Cell(0, "x1", 2, Part.PHASE, 0.0, 1.0, 2.0 * noise**2 / samples.size, 0.0, 5)] if noise else []
    sensor = SimpleNamespace(bits=None, range=None, clip=clip)
    view: Any = SimpleNamespace(rig=SimpleNamespace(sensors=[sensor], sensor_channel=lambda sensor: "x1"))
    add_rows_of_channels(run, cells, view, SimpleNamespace(harmonic=0.0), SimpleNamespace(add=add))  # type: ignore[arg-type]
    return found


def clipped_rows(clip: float | None = None) -> list[tuple[float, float]]:
    """Rows of a channel that is clipped at 2."""
    return channel_rows(Part.LIMIT, np.clip(4.0 * WAVE, -2.0, 2.0), clip=clip)


def repeats_share() -> float:
    """Floor over value of the share of repeated samples."""
    samples = WAVE.copy()
    steep = np.flatnonzero(np.abs(samples[5:-5]) < 0.05)[:40] + 5
    samples[steep] = samples[steep - 1]
    ((value, floor),) = channel_rows(Part.REPEATS, samples)
    return floor / value


def drifting(sigmas: float) -> bool:
    """Whether a drift of so many standard deviations adds to the variance of a cell."""

    def cells() -> list[Any]:
        return [
            SimpleNamespace(name="x1", part=Part.PHASE, harmonic=1, degrees_of_freedom=9, variance=1.0, drift=0.0)
            for _ in range(10)
        ]

    steady, moved = cells(), cells()
    moderate(steady)
    moved[0].drift = sigmas * math.sqrt(12.0 * steady[0].variance)
    moderate(moved)
    return bool(moved[0].variance > steady[0].variance)


# -- bags, records and tables -----------------------------------------------------------------------------------------


def few_levels(levels: int) -> int:
    """Notes on a test of so many levels."""
    bag: Any = SimpleNamespace(notes=[])
    BagWindows.note_few_levels(bag, "run", levels)
    return len(bag.notes)


def swept(windows: int) -> bool:
    """Whether so many imported windows of stepped sine are a frequency response."""
    window = SimpleNamespace(stretch=SimpleNamespace(find=lambda quantity: MOTION))
    bag: Any = SimpleNamespace(of_kind=lambda kind: [window] * windows, imported=True)
    return BagWindows.is_swept(bag, TestKind.STEPPED_SINE)


def record_is_read(samples: int) -> bool:
    """Whether a record of so many samples is looked into."""

    def row(name: str) -> None:
        raise ReachedError

    force = MeasuredChannel("f1", Quantity.FORCE, 1)
    stretch: Any = SimpleNamespace(
        faults={}, samples=samples, channels=(force, MOTION), row=row, sample_rate=1.0,
        find=lambda quantity: force if quantity is Quantity.FORCE else None,
    )  # fmt: skip
    settings = SimpleNamespace(record_rows=100)
    bag: Any = SimpleNamespace(view=None, channels={"x1": MOTION}, settings=settings, hold_rate_hz=math.nan)
    return reaches(lambda: record_observations("record", [stretch], bag))


def slow_wave(samples: int) -> np.ndarray:
    return np.asarray(np.sin(2.0 * np.pi * 2.0 * np.arange(samples) / samples))


def rising_noise() -> float:
    """White noise that a spectrum of 4 sin² (ω/2) is taken to hold."""
    return white_noise(np.diff(np.random.default_rng(1).standard_normal(2**17)), 2.0)


class Wanted:
    """Settings of a reading up to those of its lines."""

    def __init__(self, largest_std: float) -> None:
        self.largest_std = largest_std

    @property
    def lines(self) -> int:
        raise ReachedError


def table_is_used(largest_std: float) -> bool:
    """Whether a table without uncertainties is as certain as that."""
    line = np.arange(1.0, 4.0)
    table = SimpleNamespace(
        kind=TableKind.FRF, columns={"frequency_hz": line, "coherence": line}, responses=line + 0j, phase_known=False,
        noise=0.0, column=lambda name: np.full(3, math.nan), level=math.nan, reference="force",
    )  # fmt: skip
    together: Any = SimpleNamespace(name="table", tables=[table], settings=Wanted(largest_std))
    return reaches(lambda: response_table_observations(together))


def noise_of_few_lines() -> float:
    table: Any = SimpleNamespace(columns={}, noise=0.0, phase_known=True)
    line = np.arange(1.0, 4.0)
    return float(noise_of_lines("table", table, np.arange(3), line + 0j, line)[0][0])


# -- decays -----------------------------------------------------------------------------------------------------------


def node(amplitude: float = 1.0, omega: float = 100.0, rate_std: float = 0.0) -> Node:
    """A node of a damping ratio of 1 %."""
    return Node(0, 0.0, amplitude, 0.0, omega, 0.0, 0.01 * omega, rate_std, 0, 10)


def damping_rows(good: list[Node]) -> list[tuple[float, float]]:
    """Damping and its uncertainty of the nodes that show one."""
    found: list[tuple[float, float]] = []

    def add(part: Part, value: float, std: float, *_: Any) -> None:
        if part is Part.DAMPING:
            found.append((value, std))

    floors = SimpleNamespace(decay_log_frequency=0.0, decay_damping=0.0)
    table: Any = SimpleNamespace(add=add)
    stretch: Any = SimpleNamespace(start_s=0.0)
    add_nodes(table, good, stretch, SimpleNamespace(floors=floors), np.zeros(len(good)))  # type: ignore[arg-type]
    return found


def decay_notes(nodes: int = 9, other: float = 0.0) -> int:
    """Notes on a decay of so many amplitudes, in which other modes ring with a share of its motion."""
    good = [node()] * nodes
    decay: Any = SimpleNamespace(good=good, nodes=good, others=np.full(nodes, other**2), hum=())
    return len(notes_of("decay", decay, {}))


# -- predictions ------------------------------------------------------------------------------------------------------


def scaled(ratio: float) -> float:
    """Factor by which a motion is taken to be larger than the model has it, by how much larger it was measured."""
    test: Any = SimpleNamespace(measured_sizes=lambda observations, number, drive: {"x1": ratio})
    observations: Any = object()
    motions: Any = [(None, 1.0, 1.0, np.ones(1, complex), np.ones(1, complex))]
    return float(as_measured(motions, (MOTION,), test, 0, observations)[0][3][0].real)


def pairs_of_points(points: int) -> int:
    rig: Any = SimpleNamespace(structure=None)
    system: Any = SimpleNamespace(point_numbers=range(points), structure_size=10)
    return len(joined_points(rig, system))


def corrected() -> float:
    """By how much a response is corrected for an error of the first one's magnitude that is far beyond its noise."""
    log_ratio = np.array([[10.0 + 0j, 0j]])
    return float(whitened_difference(log_ratio, np.array([2.0 + 0j]), np.array([0.01]))[0, 1].real)


def neighbours(over_frequency: bool, log_ratio: float) -> float:
    """Correlation of the misfits of two rows that lie so far apart in ln frequency or ln level."""
    values = np.array([1.0, math.exp(log_ratio)])
    zero = np.zeros(2, dtype=np.int64)
    rows = SimpleNamespace(test=zero, part=zero, channel=zero, harmonic=zero, frequency_hz=values, amplitude=values)
    observations: Any = SimpleNamespace(rows=rows, tests=[SimpleNamespace(lines=over_frequency or None)])
    whitened = Whitening(observations, np.ones(2), np.ones(2, dtype=bool))(np.ones(2))
    return float(1.0 / whitened[0] ** 2 - 1.0)


def held_phase_std() -> float:
    """Standard deviation of the phase that a loop held, which its recording knows exactly, degrees."""
    rows = SimpleNamespace(test=np.zeros(1), part=np.array([Part.PHASE_ERROR]), channel=np.zeros(1))
    observations: Any = SimpleNamespace(rows=rows, sigma=np.zeros(1), chains=(object(),))
    return math.degrees(float(sigma_of(observations)[0]))


def hum_of_model(share: float) -> float:
    """Amplitude of hum at a line that lies beside that of the model by a share."""
    sensor = SimpleNamespace(hum_amplitude=3.0, hum_hz=50.0, clip=None, range=None, bits=None)
    rig: Any = SimpleNamespace(sensors=[sensor], sensor_channel=lambda sensor: "x1", clock_error=0.0)
    rows = SimpleNamespace(frequency_hz=np.array([50.0 * (1.0 + share)]))
    forward: Any = SimpleNamespace(rows=rows, _steps=(), _limits=(), _repeats=(), _lines=[(0, "x1")])
    values = np.zeros(1)
    Forward.add_unexcited(forward, rig, values)
    return float(values[0])


def shape_modes(ratio: float) -> int:
    """Modes whose shapes may be wrong, of one below the rows and one above them by a ratio."""
    errors: Any = SimpleNamespace(chain=SimpleNamespace(frequencies_hz=np.array([10.0, 20.0])))
    modes = [SimpleNamespace(frequency_hz=10.0 / ratio), SimpleNamespace(frequency_hz=20.0 * ratio)]
    return len(ShapeErrors.modes_near(errors, SimpleNamespace(modes=modes)))  # type: ignore[arg-type]


def loop_phase() -> float:
    """Phase that a loop may hold beside its set value at all levels, degrees."""
    rows = SimpleNamespace(test=np.zeros(1), part=np.array([Part.PHASE_ERROR]))
    test = SimpleNamespace(name="run", locked=True)
    columns: Any = SimpleNamespace(tests=SimpleNamespace(tests=[test]), rows=rows, _image_size=np.zeros(1))
    return math.degrees(float(ChainBuilder.aims(columns)["aim run"][0]))


def random_is_read(samples: int) -> bool:
    """Whether a record of noise of so many samples is looked into."""

    class View:
        @property
        def rig(self) -> None:
            raise ReachedError

    signals: Any = SimpleNamespace(inputs=np.zeros((1, samples)))
    try:
        return reaches(lambda: lines_of(signals, 1.0, View(), None))  # type: ignore[arg-type]
    except BenchError:
        return False


def excess(sigmas: float) -> float:
    """How much stronger an effect is than what leaves more than noise, by the excess of its squares over noise."""
    one = np.zeros(8, dtype=np.int64)
    rows = SimpleNamespace(channel=one, part=one, harmonic=one)
    residual = np.full(8, math.sqrt(sigmas * math.sqrt(2.0 * 8.0) / 8.0))
    ahead = SimpleNamespace(beyond=lambda change, known: residual)
    effect: Any = SimpleNamespace(_left=SimpleNamespace(rows=rows, sigma=np.ones(8)), _change=np.ones(8), _ahead=ahead)
    return Growth.beyond_noise(effect, np.ones(8, dtype=bool))


def judged(classes: int) -> int:
    """Explanations of so many whose predictions are judged."""
    found: Any = tuple(
        EquivalentClass((fitted("a", (point,)),), 1.0 / classes)
        for point in range(classes)  # type: ignore[arg-type]
    )
    return len(Comparison(0.0, 0.0, found, {}, 0.0, {}).to_judge())


class Paired(LowLevelModes):
    """Modes of a test against those of a model that is known."""

    def __init__(self, model: Modes) -> None:
        self.rig: Any = None
        self.tests, self.disordered, self.model = [], (), model
        self._lacking: list[tuple[float, str]] = []
        self._looked = {}

    def modes(self, rig: Any, test: Any) -> Modes:
        return self.model

    def see(self, frequency_hz: float = 10.0, lines: int = 121) -> None:
        """Take a test of two channels that move alike in a mode."""
        line = np.linspace(4.0, 16.0, lines)
        response = 1.0 / (frequency_hz**2 - line**2 + 0.02j * frequency_hz * line)
        level, channel, part = (
            grid.ravel() for grid in np.meshgrid(np.arange(lines), [0, 1], [Part.LOG_MAGNITUDE, Part.PHASE])
        )
        rows = SimpleNamespace(
            test=np.zeros(level.size), level=level, channel=channel, part=part, frequency_hz=line[level]
        )
        values = np.where(part == Part.PHASE, np.angle(response)[level], np.log(np.abs(response))[level])
        test: Any = SimpleNamespace(
            name="test", channels=(MOTION, MOTION), drive_point=1, reference="", span_s=None
        )  # fmt: skip
        self._looked.clear()
        self._add(0, test, line, SimpleNamespace(rows=rows, values=values, std=0.0 * values), {})  # type: ignore[arg-type]
        self.compare()


def modelled(log_ratio: float, likeness: float) -> Paired:
    """A model with one mode beside one at 10 Hz, by ln of their frequencies and by how alike their shapes are."""
    pole = 2.0 * np.pi * 10.0 * math.exp(log_ratio) * (-0.01 + 1j)
    angle = math.acos(math.sqrt(likeness)) + 0.25 * math.pi
    shape = np.array([[math.cos(angle), math.sin(angle)]])
    return Paired(Modes(np.array([pole]), shape.astype(np.complex128)))


def is_paired(log_ratio: float, likeness: float, lines: int = 121) -> bool:
    found = modelled(log_ratio, likeness)
    found.see(lines=lines)
    return bool(found.tests)


def is_near(log_ratio: float) -> bool:
    """Whether a mode of 10 Hz is that of a model with the same shape."""
    shape = np.ones((1, 1), dtype=np.complex128)
    found, model = (Modes(np.array([20.0j * np.pi * math.exp(at)]), shape) for at in (0.0, log_ratio))
    return bool(paired(found, model, found.likeness(model))[0] == 0)


def told_modes(log_ratio: float) -> int:
    """Modes that a model lacks, of two tests with one each, whose frequencies are so far apart."""
    found = modelled(1.5, 0.0)
    found.see(10.0)
    found.see(10.0 * math.exp(log_ratio))
    return len(found._lacking)


# -- held-out levels --------------------------------------------------------------------------------------------------


class Rows(SimpleNamespace):
    """Rows of responses at some levels, one each."""

    def __len__(self) -> int:
        return len(self.test)


def swept_splits(levels: int) -> dict[str, int]:
    """Rows that each split of frequency responses at some levels holds out."""
    number = np.arange(levels)
    rows = Rows(test=number, level=0 * number, part=np.full(levels, Part.PHASE), amplitude=1.0 + number)
    lines = SimpleNamespace(sweep_key="sine")
    tests = [SimpleNamespace(series=LevelSeries(), lines=lines, name=str(k)) for k in number]
    observations: Any = SimpleNamespace(rows=rows, tests=tests)
    return {split.name: int(split.held_out.sum()) for split in splits(observations)}


def top_levels(levels: int) -> int:
    return swept_splits(levels)["the highest levels"]


# -- search -----------------------------------------------------------------------------------------------------------


class Searched(SimpleNamespace):
    """A search whose fits are noted and not made."""

    def chosen(self, *arguments: Any) -> list[Score]:
        self.wanted = Search.chosen(self, *arguments)  # type: ignore[arg-type]
        return self.wanted

    def __init__(self, effects: int, places: int, found: Sequence[Any] = ()) -> None:
        self.candidates = [
            SimpleNamespace(effect=SimpleNamespace(name=f"effect {k}"), cause=Cause(f"effect {k}", place(point)))
            for k in range(effects)
            for point in range(places)
        ]
        noted: list[Any] = []
        super().__init__(
            tell=lambda sentence: None, exchanged=noted, leaves_noise_only=lambda single: False, parameters=(),
            _from_other_starts=lambda base, found, scores: found, missing_modes=lambda null: [],
            _adds_a_mode=lambda number: False,
            _added=lambda base, wanted: list(found), _exchanged=lambda best, other, likely: noted.append(other),
        )  # fmt: skip


def place(point: int) -> Location:
    return Location.at("structure", point)


def fitted(effect: str, points: Sequence[int] = (0,), evidence: float = 0.0) -> Any:
    """An explanation by an effect at some places."""
    causes = tuple(Cause(effect, place(point)) for point in points)
    fit = SimpleNamespace(
        errors=SimpleNamespace(weights=np.ones(20)), log_evidence=evidence, converged=True, theta=np.zeros(2),
        parametrisation=SimpleNamespace(spread=lambda k: 1.0, index_of=lambda k: slice(k, k + 1)),
    )  # fmt: skip
    explanation = Explanation(causes)
    return SimpleNamespace(
        fit=fit, explanation=explanation, effects=(effect,) * len(points), candidates=(None,) * len(points)
    )


def scores(search: Searched, places: int, gains: Sequence[float] | None = None) -> list[Score]:
    """Scores of all candidates of a search; different effects change different rows."""
    units = np.eye(20)
    return [
        Score(k, np.zeros(1), 100.0 - k if gains is None else gains[k], 1.0, units[k // places])
        for k in range(len(search.candidates))
    ]


def first_effects() -> tuple[int, int]:
    """Effects that are fitted of nine, and places of each of four."""
    search = Searched(9, 4)
    Search.singles(search, fitted("none"), scores(search, 4))  # type: ignore[arg-type]
    effects = [score.candidate // 4 for score in search.wanted]
    return len(set(effects)), effects.count(0)


def second_effects(gain: float = 100.0) -> tuple[int, int]:
    """Explanations of four that second effects are added to, and effects of nine that are."""
    search = Searched(9, 1)
    search.scores = lambda single, scores_before: scores(search, 1, [gain] * 9)
    heads: list[int] = []
    search._added = lambda base, wanted: heads.append(len(wanted)) or []  # type: ignore[func-returns-value]
    Search.pairs(search, [fitted(name) for name in "abcd"])  # type: ignore[arg-type]
    return len(heads), heads[0]


@pytest.mark.parametrize(("noisy", "tried"), [(True, [1, 3]), (False, [])])
def test_where_the_best_second_effect_leaves_more_than_noise_its_other_starts_are_tried(
    noisy: bool, tried: list[int]
) -> None:
    search = Searched(2, 1)
    search.refit, search.exceeds_noise = lambda explanation: explanation, lambda fit: noisy
    wanted: list[float] = []
    search._added = lambda base, starts: wanted.extend(score.gain for score in starts) or [fitted("other start")]
    first = fitted("effect 0")
    first.candidates = (search.candidates[1], search.candidates[0])
    starts = [Score(number, np.zeros(1), gain, 1.0, np.zeros(1)) for number, gain in ((0, 5), (1, 4), (0, 1), (0, 3))]
    found = Search._from_other_starts(search, fitted("base"), [first, fitted("second")], starts)  # type: ignore[arg-type]
    assert wanted == tried
    assert found[0] is first
    assert Search._from_other_starts(search, fitted("base"), [], starts) == []  # type: ignore[arg-type]


def asked_beside_noise(gain: float, of_records: bool = True) -> int:
    """Explanations that second effects are added to where the first leaves noise only, by what a second promises."""
    search = Searched(9, 1)
    search.leaves_noise_only, search.of_records = lambda single: True, of_records
    search.scores = lambda single, scores_before: scores(search, 1, [gain] * 9)
    heads: list[int] = []
    search._added = lambda base, wanted: heads.append(len(wanted)) or []  # type: ignore[func-returns-value]
    Search.pairs(search, [fitted("a")])  # type: ignore[arg-type]
    return len(heads)


def exchanged(share: float) -> int:
    """Other places of the best effect that are fitted, by what one promises of the best."""
    search = Searched(1, 2, [fitted("effect 0")])
    Search.singles(search, fitted("none"), scores(search, 2, [100.0, 100.0 * share]))  # type: ignore[arg-type]
    return len(search.exchanged)


def without_weak_member(strength: float) -> int:
    """Explanations that are left of a pair one of whose members has such a strength."""
    pair = fitted("a", (0, 1))
    pair.strength = lambda k: (5.0, strength)[k]
    search: Any = SimpleNamespace(
        parametrisation=lambda candidates, spreads: None, parameters=(), best=lambda *_: fitted("a", (0,), 1.0)
    )
    return len(Search.pruned(search, [pair]))


def finalists() -> int:
    """Explanations of twenty as good as the best that are fitted to the end."""
    return len(Search.in_reach(None, [fitted("a", (k,)) for k in range(20)])[0])  # type: ignore[arg-type]


EDGES: dict[str, tuple[Callable[[], Any], Any]] = {
    "reading.hum_sigmas": (lambda: [len(channel_rows(Part.LINE, hum=hum)) for hum in (5.9, 6.1)], [0, 1]),
    "reading.hidden_step_share": (
        lambda: [len(channel_rows(Part.STEP, np.arange(200.0), noise=noise)) for noise in (3.2, 3.5)], [1, 0]
    ),
    "reading.step_std_share": (
        lambda: channel_rows(Part.STEP, np.arange(200.0), noise=math.sqrt(1.0 + 1.0 / 12.0))[0][1], pytest.approx(0.25)
    ),
    "reading.limit_std_share": (lambda: clipped_rows()[0][1], pytest.approx(0.1 / 2.0)),
    "reading.same_limit_share": (lambda: [len(clipped_rows(clip)) for clip in (2.018, 2.022)], [0, 1]),
    "reading.repeats_std_share": (repeats_share, pytest.approx(0.1)),
    "reading.few_levels": (lambda: (few_levels(2), few_levels(3)), (1, 0)),
    "reading.stepped_fewest_lines": (lambda: (swept(4), swept(5)), (False, True)),
    "reading.record_fewest_samples": (lambda: (record_is_read(199), record_is_read(200)), (False, True)),
    "reading.record_longest_start": (lambda: head_of(slow_wave(1000)[None], 1.0), 100),
    "reading.record_decay_constants": (
        lambda: start_of(2.0, SimpleNamespace(samples=10**6, sample_rate=1000.0)), 2500  # type: ignore[arg-type]
    ),
    "reading.record_fewest_rows": (lambda: independent_values(slow_wave(1000), 1.0), 50),
    # 2 sin (0.05 · π/2)
    "reading.record_noise_quantile": (rising_noise, pytest.approx(2.0 * math.sin(0.025 * math.pi), rel=0.15)),
    "reading.decay_few_nodes": (lambda: (decay_notes(2), decay_notes(3)), (1, 0)),
    "reading.decay_other_mode_share": (lambda: (decay_notes(other=0.19), decay_notes(other=0.21)), (0, 1)),
    "reading.decay_worst_damping_std": (
        lambda: [len(damping_rows([node(rate_std=share)])) for share in (0.29, 0.31)], [1, 0]
    ),
    # ω goes with the amplitude.
    "reading.decay_slow_share": (
        lambda: damping_rows([node(), node(math.e, 100.0 * math.e)])[0][1], pytest.approx(0.01 * 0.01)
    ),
    "noise.drift_sigmas": (lambda: (drifting(3.9), drifting(4.1)), (False, True)),
    "noise.stepped_default_std": (noise_of_few_lines, 0.02),
    "noise.table_default_std": (lambda: (table_is_used(0.019), table_is_used(0.021)), (False, True)),
    "prediction.far_off_ratio": (lambda: (scaled(1.9), scaled(2.1)), (1.0, 2.1)),
    "prediction.most_joined_points": (lambda: (pairs_of_points(4), pairs_of_points(5)), (6, 0)),
    "prediction.largest_magnitude_sigmas": (corrected, pytest.approx(-0.04)),
    "misfit.level_length": (lambda: neighbours(False, 1.0), pytest.approx(math.exp(-0.5))),
    "misfit.line_length": (lambda: neighbours(True, 0.3), pytest.approx(math.exp(-0.5))),
    "tolerances.lock_phase_deg": (held_phase_std, pytest.approx(0.5)),
    "tolerances.loop_phase_deg": (loop_phase, pytest.approx(1.0)),
    "prediction.line_width": (lambda: (hum_of_model(0.009), hum_of_model(0.011)), (3.0, 0.0)),
    "misfit.shape_reach": (lambda: (shape_modes(1.9), shape_modes(2.1)), (2, 0)),
    "reading.random_fewest_lines": (lambda: (random_is_read(399), random_is_read(400)), (False, True)),
    "modes.near_log_frequency": (lambda: (is_paired(0.09, 0.0), is_paired(0.11, 0.0)), (True, False)),
    "modes.apart_log_frequency": (lambda: (is_near(0.49), is_near(0.51)), (True, False)),
    "modes.unlike_mac": (lambda: (is_paired(0.3, 0.31), is_paired(0.3, 0.29)), (True, False)),
    "modes.same_log_frequency": (lambda: (told_modes(0.018), told_modes(0.022)), (1, 2)),
    "modes.fewest_lines": (lambda: (is_paired(0.0, 1.0, 19), is_paired(0.0, 1.0, 20)), (False, True)),
    "verdict.excess_sigmas": (lambda: excess(3.0), pytest.approx(1.0)),
    "verdict.judged_explanations": (lambda: judged(6), 3),
    "verdict.held_out_fewest_responses": (
        lambda: ["the highest levels" in swept_splits(n) for n in (2, 3)], [False, True]
    ),
    "verdict.held_out_fewest_for_two": (lambda: (top_levels(4), top_levels(5)), (1, 2)),
    "search.first_effects": (lambda: first_effects()[0], 5),
    "search.first_locations": (lambda: first_effects()[1], 2),
    "search.pair_heads": (lambda: second_effects()[0], 2),
    "search.second_effects": (lambda: second_effects()[1], 3),
    "search.second_cost_fall": (lambda: (second_effects(15.9)[1], second_effects(16.1)[1]), (0, 3)),
    "search.other_locations_share": (lambda: (exchanged(0.09), exchanged(0.11)), (0, 1)),
    "search.weak_sigmas": (lambda: (without_weak_member(2.9), without_weak_member(3.1)), (1, 0)),
    "search.finalists": (finalists, 8),
}  # fmt: skip


def test_a_second_effect_that_the_evidence_demands_is_fitted_where_the_first_leaves_noise_only() -> None:
    assert (asked_beside_noise(59.0), asked_beside_noise(61.0), asked_beside_noise(61.0, False)) == (0, 1, 0)


@pytest.mark.parametrize("path", EDGES)
def test_a_threshold_decides(path: str) -> None:
    outcome, expected = EDGES[path]
    assert outcome() == expected
