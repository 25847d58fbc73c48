"""Which test would decide: every test that the rig allows is computed ahead under the explanations that are left.

For two explanations a and b, fitted to what has been measured, the predictions of a new test differ by Δ. What b can
still adapt within its posterior covariance C (sensitivities J_b of the new test) does not count:

    d² = Δᵀ Σ^(-½) (1 + J_b C J_bᵀ)⁻¹ Σ^(-½) Δ,

with uncertainties Σ as they were in the tests at hand. Errors of the measuring chain count among what b adapts by. d is
the expected number of standard deviations by which the test tells a from b, a being true.
"""

from __future__ import annotations

import itertools
import math
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import eigh
from scipy.special import entr

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.numerics.arrays import BoolArray, FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_diagnose.effects.location import joined
from nmt_diagnose.effects.rig_edit import with_value
from nmt_diagnose.effects.sensor_effects import RESPONSES
from nmt_diagnose.inference.ahead import Ahead
from nmt_diagnose.inference.comparison import Comparison
from nmt_diagnose.inference.diagnosis import HIDDEN, NULL, NextTest
from nmt_diagnose.inference.explanations import FittedExplanation, Score
from nmt_diagnose.inference.hidden_effects import Growth, Hidden, hidden_effects
from nmt_diagnose.inference.search import Search
from nmt_diagnose.measurements.channel import MeasuredChannel
from nmt_diagnose.measurements.locked_windows.locked_windows import LockedLevel, LockedWindows
from nmt_diagnose.measurements.measurement import Measurement
from nmt_diagnose.measurements.random_responses.random_responses import RandomResponses
from nmt_diagnose.observations.channels.measuring_chain import MeasuringChain
from nmt_diagnose.observations.observables import Observations, Part, Place, RowTable
from nmt_diagnose.prediction.forward import Forward
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig
from nmt_rig.rig_model import build_elements, build_structure

# Uncertainties of a kind of observable of which the tests at hand hold none.
_TYPICAL = {
    Part.LOG_FREQUENCY: 3e-5,
    Part.PHASE_ERROR: 3e-3,
    Part.LOG_MAGNITUDE: 1e-3,
    Part.PHASE: 1e-3,
    Part.REAL: 1e-3,
    Part.IMAG: 1e-3,
}


@dataclass(frozen=True)
class Proposal:
    """A test that could be made.

    Attributes:
        text: what to do.
        command: the command that does it; empty where nothing here can: the rig is not simulated, or its rig file is
            not known.
        observations: its observables with expected uncertainties; values are not set.
        seconds: bench time that it takes, as the tests at hand took it.
    """

    text: str
    command: str
    observations: Observations
    seconds: float = math.nan


def next_tests(
    rig: Rig,
    observations: Observations,
    null: FittedExplanation,
    comparison: Comparison,
    with_plan: bool = False,
    chain_names: Sequence[str] = (),
    most: int = 3,
) -> tuple[NextTest, ...]:
    """Tests that would tell the explanations that are left apart, best first.

    Args:
        rig: the model.
        observations: what has been measured, with the noise that was learnt.
        null: the model with its parameters re-fitted; what competes where there is only one explanation.
        comparison: explanations.
        with_plan: levels go on by the real rig's plan, see `next_levels`; else up to twice those measured.
        chain_names: of the errors of the measuring chain in the fits.
        most: tests to name; with a plan all of them, among which an investigation chooses by their time.
    """
    competing = _competing(comparison, null)
    if len(competing) < 2:
        return ()
    names = tuple(joined(competitor.effects) or NULL for competitor in competing)
    p = [comparison.by_label.get(it.explanation.label, 0.0) for it in competing]
    found = []
    least = THRESHOLDS.next_test.least_asked_sigmas if with_plan else THRESHOLDS.next_test.least_sigmas
    for proposal in proposals(rig, observations, with_plan):
        proposal = replace(proposal, observations=noise_over_motion(proposal.observations, observations, competing[0]))
        sigma, of_first = Apart(proposal.observations, competing, chain_names).sigmas()
        if sigma >= least:
            information = expected_information(p[0], p[1], of_first)
            sigma = min(sigma, THRESHOLDS.next_test.most_sigmas)
            found.append(NextTest(proposal.text, proposal.command, names, sigma, proposal.seconds, information))
    return tuple(sorted(found, key=lambda item: -item.expected_sigma)[: None if with_plan else most])


def next_levels(
    rig: Rig,
    observations: Observations,
    null: FittedExplanation,
    comparison: Comparison,
    plan: Sequence[float],
    search: Search,
    scores: Callable[[], Sequence[Score]],
    gap: bool,
) -> NextTest | None:
    """The next levels of a plan and what is expected of them, however little; None above its highest level.

    Where there is a gap they are to tell apart what is left of explanations. Where there is none they are to show what
    these recordings are too weak to show.

    Args:
        rig, observations, null, comparison: as for `next_tests`.
        plan: levels of the real rig's plan, which no test goes beyond.
        search: has the candidates.
        scores: computes those of the candidates on top of the model alone.
        gap: whether the recordings show one.

    Raises:
        BenchError: the model has no solution for a level that is left.
    """
    runs = [test for test in observations.tests if isinstance(test, LockedWindows) and test.held == "voltage"]
    high = max((level.drive for test in runs for level in test.levels if math.isfinite(level.drive)), default=math.nan)
    levels = sorted(level for level in plan if level > 1.001 * high)
    if not levels:
        return None
    third = math.ceil(len(plan) / 3)
    frequency, point = _frequencies(rig)[rig.test.mode - 1], runs[0].drive_point
    each, command = _seconds_of_a_level(runs), _commands(observations)[1]

    def test(count: int, separates: tuple[str, ...], sigma: float = math.nan, **more: Any) -> NextTest:
        chosen = levels[:count]
        words = f"--levels {','.join(f'{level:.4g}' for level in chosen)} --out high"
        text = f"the next levels of the plan, up to {chosen[-1]:.3g} V"
        return NextTest(
            text, command(words), separates, sigma, each * len(chosen), levels=tuple(chosen), **more
        )  # fmt: skip

    left = _run(rig, observations, point, levels, frequency)
    if not gap:
        left, small, count, grows = noise_over_motion(left, observations, null), comparison.small, third, ""
        alone, growth = Ahead(null.fit, search.data.chain_names, left), None
        if small is not None:
            growth = Growth(small, comparison.small_probability, left, alone, observations.matters)
            count = growth.levels(third)
        of_next = left.rows.level < count
        hidden = hidden_effects(search, null, scores(), alone, of_next)
        if growth is not None and small is not None:
            beside = Hidden(growth.matters(left.rows.level >= 0), growth.matters(of_next))
            grows = joined(small.fitted.effects) if beside.probability > hidden.probability else ""
            hidden = hidden.beside(beside)
        return test(
            count, (NULL, HIDDEN), information=hidden.information, hidden=hidden.probability, grows=grows
        )  # fmt: skip
    competing = _competing(comparison, null)
    if len(competing) < 2:
        return test(third, ())
    names = tuple(joined(competitor.effects) or NULL for competitor in competing)
    p = [comparison.by_label.get(it.explanation.label, 0.0) for it in competing]
    left = noise_over_motion(left, observations, competing[0])
    apart = Apart(left, competing, search.data.chain_names)
    found = []
    for count in sorted({min(third, len(levels)), len(levels)}):
        sigma, of_first = apart.sigmas(left.rows.level < count)
        found.append((expected_information(p[0], p[1], of_first) / count, count, sigma, of_first))
    # Levels that tell more for their time come in one test, however many they are.
    _, count, sigma, of_first = max(found, key=lambda item: (item[0], -item[1]))
    most = THRESHOLDS.next_test.most_sigmas
    return test(
        count, names, min(sigma, most), information=expected_information(p[0], p[1], of_first),
        plan_sigma=min(found[-1][2], most),
    )  # fmt: skip


def other_sensors(
    rig: Rig,
    observations: Observations,
    null: FittedExplanation,
    comparison: Comparison,
    plan: Sequence[float],
    chain_names: Sequence[str],
) -> tuple[NextTest, ...]:
    """Sensors that would tell apart what is left in a run of the same levels, the best first; none where none would.

    One more at each point, and one that an explanation names at another point that has none: a mass goes with it.

    Args:
        rig, observations, null, comparison, chain_names: as for `next_tests`.
        plan: levels of the run; empty = those measured.
    """
    competing = _competing(comparison, null)
    runs = [test for test in observations.tests if isinstance(test, LockedWindows) and test.held == "voltage"]
    if len(competing) < 2 or not runs:
        return ()
    drive = runs[0].drive_point
    drives = sorted(plan) or sorted({level.drive for level in runs[0].levels if math.isfinite(level.drive)})
    names = tuple(joined(competitor.effects) or NULL for competitor in competing)
    frequency = _frequencies(rig)[rig.test.mode - 1]
    channels = _channels(rig, drive)
    found = []

    def tried(text: str, channels: tuple[MeasuredChannel, ...], moved: Rig | None = None) -> None:
        fits = [it if moved is None else _on_other_rig(it, moved) for it in competing]
        left = _run(rig, observations, drive, drives, frequency, channels=channels)
        sigma, _ = Apart(noise_over_motion(left, observations, fits[0]), fits, chain_names).sigmas()
        if sigma >= THRESHOLDS.next_test.least_sigmas:
            found.append(NextTest(text, "", names, min(sigma, THRESHOLDS.next_test.most_sigmas)))

    sensed = {channel.point for channel in channels if channel.quantity in MOTIONS}
    for point in rig.structure.points:
        more = MeasuredChannel(f"another at {point}", Quantity.DISPLACEMENT, point, ideal=True)
        text = f"a second sensor at point {point}" if point in sensed else f"a sensor at point {point}"
        tried(text, (*channels, more))
    named = {location.channel for it in competing for location in it.explanation.locations if location.channel}
    for index, sensor in enumerate(rig.sensors):
        if rig.sensor_channel(sensor) not in named or sensor.quantity not in RESPONSES:
            continue
        for point in set(rig.structure.points) - sensed:
            moved = with_value(rig, ("sensors", index, "point"), point)
            text = f"the sensor of {rig.sensor_channel(sensor)} at point {point} in place of {rig.sensor_point(sensor)}"
            tried(text, _channels(moved, drive), moved)
    return tuple(sorted(found, key=lambda item: -item.expected_sigma))


def _on_other_rig(found: FittedExplanation, rig: Rig) -> FittedExplanation:
    """An explanation with what it adds on another rig."""
    parametrisation = replace(found.fit.parametrisation, base=rig)
    return replace(found, fit=replace(found.fit, parametrisation=parametrisation))


def noise_over_motion(left: Observations, at_hand: Observations, found: FittedExplanation) -> Observations:
    """Expected uncertainties of a run of locked levels where its channels move less than in those at hand.

    Noise of a channel is the same at all motions: a window of as many periods is the shorter the higher its frequency,
    so that the noise in its mean goes with the root of that. Over a small motion it is large. It is never taken to be
    less than in the tests at hand, which lock and repeat no better over a large one.

    Args:
        left: the run; other tests stay as they are.
        at_hand: what has been measured.
        found: an explanation, which tells the motion.
    """
    test = left.tests[0]
    runs = [number for number, it in enumerate(at_hand.tests) if isinstance(it, LockedWindows)]
    if not isinstance(test, LockedWindows) or not runs:
        return left
    rows, std = left.rows, left.std.copy()
    try:
        values = Forward(left.tests, rows).predict(found.fit.parametrisation.rig(found.fit.theta)).values
    except (BenchError, ArithmeticError, np.linalg.LinAlgError):
        return left
    fundamental = (at_hand.rows.part == Part.LOG_MAGNITUDE) & (at_hand.rows.harmonic == 1)
    fundamental &= np.isin(at_hand.rows.test, runs) & np.isfinite(at_hand.values)
    names = [tuple(c.name for c in getattr(it, "channels", ())) for it in at_hand.tests]
    for number, channel in enumerate(test.channels):
        same = np.array([
            k >= 0 and names[t][k] == channel.name for t, k in zip(at_hand.rows.test, at_hand.rows.channel, strict=True)
        ])  # fmt: skip
        alike = fundamental & same
        if not alike.any():
            continue
        frequency = np.maximum(at_hand.rows.frequency_hz[alike], 1e-12)
        noise = float(np.median(at_hand.sigma[alike] * np.exp(at_hand.values[alike]) / np.sqrt(frequency)))
        of_drive = at_hand.sigma[alike][np.argsort(at_hand.rows.amplitude[alike], kind="stable")]
        places = np.linspace(0.0, 1.0, of_drive.size)
        for level in np.unique(rows.level):
            here = rows.level == level
            row = np.flatnonzero(here & (rows.channel == number) & (rows.part == Part.LOG_MAGNITUDE))[0]
            relative = noise * math.sqrt(rows.frequency_hz[row]) / math.exp(values[row])
            if not math.isfinite(relative):
                continue
            std[here & (rows.channel == number)] *= max(1.0, relative / left.std[row])
            if channel.name == test.response_channel:
                before = float(np.interp(level / max(1, len(test.levels) - 1), places, of_drive))
                std[here & (rows.channel < 0)] *= max(1.0, relative / before)
    return replace(left, std=std)


def expected_information(p: float, q: float, sigmas: float) -> float:
    """Expected fall of the entropy of two hypotheses by a test that sets them apart, nats.

    The ln of their odds moves by a normal variable of mean ±d²/2, as either is true, and variance d²; the mean over it
    is taken by Gauss and Hermite's rule.

    Args:
        p, q: probabilities of the two, whatever else there is.
        sigmas: by how many standard deviations d the test tells one from the other.
    """
    if not p + q > 0.0:
        return 0.0
    p, q = p / (p + q), q / (p + q)
    if not min(p, q) > 0.0:
        return 0.0
    nodes, weights = np.polynomial.hermite_e.hermegauss(61)
    weights = weights / weights.sum()
    log_odds, left = math.log(p / q), 0.0
    for share, sign in ((p, 1.0), (q, -1.0)):
        after = 1.0 / (1.0 + np.exp(-np.clip(log_odds + sign * 0.5 * sigmas**2 + sigmas * nodes, -700.0, 700.0)))
        left += share * float(weights @ _entropy(after))
    return max(0.0, float(_entropy(np.array(p))) - left)


def _entropy(p: FloatArray) -> FloatArray:
    """Entropy of two alternatives, nats."""
    return np.asarray(entr(p) + entr(1.0 - p), dtype=np.float64)


def _competing(comparison: Comparison, null: FittedExplanation) -> list[FittedExplanation]:
    """The two explanations that most need distinguishing: of one class, or the heads of the first two."""
    classes = comparison.classes
    if not classes:
        return []
    if len(classes[0].members) > 1:
        return list(classes[0].members[:3])
    if len(classes) > 1 and classes[1].probability > THRESHOLDS.next_test.second_class_share * classes[0].probability:
        return [classes[0].head, classes[1].head]
    # One explanation stands alone: nothing is left to settle, unless it hardly beats having none.
    return [classes[0].head, null] if comparison.none > THRESHOLDS.next_test.doubtful_probability else []


class Apart:
    """How far a test that has not been made sets competing hypotheses apart.

    Args:
        left: its observables with expected uncertainties; values are not set.
        competing: the hypotheses, fitted to the recordings at hand.
        chain_names: of the errors of the measuring chain in the fits.
    """

    def __init__(self, left: Observations, competing: Sequence[FittedExplanation], chain_names: Sequence[str]) -> None:
        self._sigma, self._ahead = left.sigma, list[Ahead]()
        try:
            for competitor in competing:
                chain = self._ahead[0].chain if self._ahead else None
                self._ahead.append(Ahead(competitor.fit, chain_names, left, chain))
        except (BenchError, ArithmeticError, np.linalg.LinAlgError):
            self._ahead = []

    def sigmas(self, rows: BoolArray | None = None) -> tuple[float, float]:
        """Least expected distance over all ordered pairs of hypotheses and over those of the first two, in σ.

        0 where one has no solution.

        Args:
            rows: those that count, (m,); None = all.
        """
        if not self._ahead:
            return 0.0, 0.0
        distances: dict[tuple[int, int], float] = {}
        for one, other in itertools.permutations(range(len(self._ahead)), 2):
            a, b = self._ahead[one], self._ahead[other]
            difference = a.forward.difference(a.base.values, b.base.values)
            good = np.isfinite(difference) & np.isfinite(b.base.values)
            good &= True if rows is None else rows
            distances[one, other] = b.apart(difference / self._sigma, good) if good.any() else 0.0
        return min(distances.values()), min(distances[0, 1], distances[1, 0])


def proposals(rig: Rig, observations: Observations, with_plan: bool = False) -> list[Proposal]:
    """Tests that the rig allows and that have not been made.

    Their commands run the rig that was recorded, as it was recorded; the model is not what is to be measured.

    Args:
        rig: the model.
        observations: what has been measured.
        with_plan: levels go on by a plan, see `next_levels`; else up to twice those measured.
    """
    result = []
    linear, run = _commands(observations)
    frequencies = _frequencies(rig)
    runs = [test for test in observations.tests if isinstance(test, LockedWindows) and test.held == "voltage"]
    made = {test.drive_point for test in runs}
    # Of a further mode or drive point the same levels are those of the first.
    like_first = [test for test in runs if test.drive_point == runs[0].drive_point]
    like_first = [it for it in like_first if _modes_of([it], frequencies) == _modes_of(runs[:1], frequencies)]
    drives = sorted({level.drive for test in like_first for level in test.levels if math.isfinite(level.drive)})
    if not any(isinstance(test, RandomResponses) for test in observations.tests):
        text = f"a random test at low level, driven at point {rig.drive_point}"
        seconds = THRESHOLDS.next_test.random_seconds
        result.append(Proposal(text, linear("--out random"), _random(rig, observations, drives), seconds))
    if not runs:
        return result
    each = _seconds_of_a_level(runs)
    first = runs[0]
    low, high = drives[0], drives[-1]
    plan = f"{low:.3g}:{high:.3g}:{len(drives)}"
    mode = rig.test.mode
    for point in rig.structure.points:
        if point in made:
            continue
        text = f"the same levels with the exciter at point {point}"
        command = run(f"--exciter {point} --levels {plan} --out point{point}")
        found = _run(rig, observations, point, drives, frequencies[mode - 1])
        result.append(Proposal(text, command, found, each * len(drives)))
    higher = _modes_of(runs, frequencies)
    other = next((number for number in range(mode + 1, frequencies.size + 1) if number not in higher), 0)
    if other:
        text = f"the same levels on mode {other}"
        command = run(f"--set test.mode={other} --levels {plan} --out mode{other}")
        found = _run(rig, observations, first.drive_point, drives, frequencies[other - 1])
        result.append(Proposal(text, command, found, each * len(drives)))
    if all(level.direction >= 0 for test in runs for level in test.levels):
        text = "the same levels downwards, after going up"
        command = run(f"--direction both --levels {plan} --out both")
        found = _run(rig, observations, first.drive_point, drives[::-1], frequencies[mode - 1], _end(runs))
        result.append(Proposal(text, command, found, 2.0 * each * len(drives)))
    limit = rig.limits.voltage_v
    if not with_plan and (limit is None or 2.0 * high <= limit):
        text = f"higher levels, up to {2.0 * high:.3g} V (mind what the specimen bears)"
        more = list(map(float, np.geomspace(high, 2.0 * high, 6)))
        levels = ",".join(f"{level:.4g}" for level in more)
        found = _run(rig, observations, first.drive_point, more, frequencies[mode - 1])
        result.append(Proposal(text, run(f"--levels {levels} --out high"), found, each * len(more)))
    return result


def _modes_of(runs: Sequence[LockedWindows], frequencies: FloatArray) -> set[int]:
    """Numbers of the modes of the model that are nearest to the locked frequencies of some runs."""
    locked = [level.frequency_hz for test in runs for level in test.levels if level.frequency_hz > 0.0]
    return {int(np.argmin(np.abs(np.log(frequencies / frequency)))) + 1 for frequency in locked}


def _seconds_of_a_level(runs: Sequence[LockedWindows]) -> float:
    """Bench time from level to level in the tests at hand, s."""
    steps = [
        abs(later.stop_s - before.stop_s)
        for test in runs
        for before, later in itertools.pairwise(sorted(test.levels, key=lambda level: level.stop_s))
    ]
    first = [level.stop_s - level.start_s for test in runs for level in test.levels]
    return float(np.median(steps or first or [math.nan]))


def _commands(observations: Observations) -> tuple[Callable[[str], str], Callable[[str], str]]:
    """What makes commands of ``./nmt linear`` and ``./nmt run`` for the recorded rig, from their options."""
    origins = observations.origins
    files = [origin.rig_file for origin in origins]
    if not origins or not all(files):
        return (lambda _: ""), (lambda _: "")
    periods = next((f" --periods {origin.periods}" for origin in origins if origin.periods), "")
    file = shlex.quote(files[0])
    return (
        lambda options: f"./nmt linear {file} {options}",
        lambda options: f"./nmt run {file} {options}{periods}",
    )


def _frequencies(rig: Rig) -> FloatArray:
    """Frequencies of the model's modes with friction sticking, Hz."""
    structure = build_structure(rig)
    stiffness = structure.stiffness.copy()
    for element in build_elements(rig, structure):
        stiffness += element.linear_stiffness * np.outer(element.direction, element.direction)
    squares = eigh(stiffness, structure.mass, eigvals_only=True)
    result: FloatArray = np.sqrt(np.maximum(squares, 0.0)) / (2.0 * np.pi)
    return result


def _end(runs: Sequence[LockedWindows]) -> LockedLevel:
    return max((level for test in runs for level in test.levels), key=lambda level: level.stop_s)


def _channels(rig: Rig, point: int) -> tuple[MeasuredChannel, ...]:
    """Channels of the rig with its exciter at a point."""
    result = []
    for sensor in rig.sensors:
        quantity = Quantity[sensor.quantity.upper()]
        if quantity in (Quantity.VOLTAGE, Quantity.CURRENT):
            continue
        where = sensor.point if isinstance(sensor.point, int) else point
        result.append(MeasuredChannel(sensor.channel or f"{quantity.letter}{where}", quantity, where))
    return tuple(result)


def _typical(
    observations: Observations, kind: type[Measurement] | tuple[type, ...], part: Part, harmonic: int, fraction: float
) -> float:
    """Median uncertainty of a kind of observable in the tests at hand, near a level given as a fraction of all."""
    selected = np.zeros(len(observations.rows), dtype=bool)
    for number, test in enumerate(observations.tests):
        if isinstance(test, kind):
            selected |= observations.rows.test == number
    selected &= (observations.rows.part == part) & (observations.rows.harmonic == harmonic)
    if not selected.any():
        return THRESHOLDS.next_test.typical_response_std if kind is RandomResponses else _TYPICAL[part]
    amplitude = observations.rows.amplitude[selected]
    order = np.argsort(amplitude, kind="stable")
    sigma = observations.sigma[selected][order]
    middle = round(fraction * (sigma.size - 1))
    reach = max(1, sigma.size // 6)
    return float(np.median(sigma[max(0, middle - reach) : middle + reach + 1]))


def _run(
    rig: Rig,
    observations: Observations,
    point: int,
    drives: Sequence[float],
    frequency_hz: float,
    after: LockedLevel | None = None,
    channels: tuple[MeasuredChannel, ...] | None = None,
) -> Observations:
    """Observables of a run of locked levels that has not been made; ``channels`` None = those of the rig."""
    channels = channels or _channels(rig, point)
    ideal = MeasuredChannel(f"x{point}", Quantity.DISPLACEMENT, point)
    response = next((c for c in channels if c.quantity in MOTIONS and c.point == point), ideal)
    harmonics = max((t.harmonics for t in observations.tests if isinstance(t, LockedWindows)), default=3)
    start = after.stop_s if after else 0.0
    cycles = after.cycles_before if after else 0.0
    length = 6.0
    if after is not None:
        length = max(after.stop_s - after.start_s, 1.0) * 1.5
    levels = tuple(
        LockedLevel(
            k, drive, 0.0, 1e-3, frequency_hz, start + k * length, start + (k + 0.7) * length,
            cycles + (k + 0.5) * length * frequency_hz, -1 if after else 1,
        )
        for k, drive in enumerate(drives)
    )  # fmt: skip
    table = RowTable()
    for level in levels:
        middle = 0.5 * (level.start_s + level.stop_s)
        place = Place(level.index, middle, frequency_hz, level.drive)
        fraction = level.index / max(1, len(levels) - 1)

        def sigma(part: Part, harmonic: int = -1, fraction: float = fraction) -> float:
            return _typical(observations, LockedWindows, part, harmonic, fraction)

        table.add(Part.LOG_FREQUENCY, 0.0, sigma(Part.LOG_FREQUENCY), 0.0, place)
        table.add(Part.PHASE_ERROR, 0.0, sigma(Part.PHASE_ERROR), 0.0, place)
        for number in range(len(channels)):
            table.add(Part.LOG_MAGNITUDE, 0.0, sigma(Part.LOG_MAGNITUDE, 1), 0.0, place, number, 1)
            table.add(Part.PHASE, 0.0, sigma(Part.PHASE, 1), 0.0, place, number, 1)
            for harmonic in range(2, harmonics + 1):
                table.add(Part.REAL, 0.0, sigma(Part.REAL, harmonic), 0.0, place, number, harmonic)
                table.add(Part.IMAG, 0.0, sigma(Part.IMAG, harmonic), 0.0, place, number, harmonic)
    test = LockedWindows("proposed", (point,), response.name, channels, harmonics, "voltage", levels)
    return replace(table.observations(test), chains=_chains(observations, LockedWindows))


def _chains(observations: Observations, kind: type[Measurement]) -> tuple[MeasuringChain | None, ...]:
    """Tolerances of a test that has not been made: those of the first of its kind, else of the first test."""
    found = list(zip(observations.tests, observations.chains, strict=False))
    return tuple([chain for test, chain in found if isinstance(test, kind)] or [chain for _, chain in found])[:1]


def _random(rig: Rig, observations: Observations, drives: Sequence[float]) -> Observations:
    """Observables of a random test that has not been made."""
    channels = _channels(rig, rig.drive_point)
    frequencies = _frequencies(rig)
    mode = max(1, rig.test.mode)
    top = min(0.35 * rig.sample_rate_hz, 3.0 * frequencies[min(frequencies.size - 1, mode + 1)])
    lines = np.geomspace(0.4 * frequencies[mode - 1], top, THRESHOLDS.next_test.random_lines)
    table = RowTable()
    rms = drives[0] if drives else 0.05
    for number, line in enumerate(lines):
        place = Place(number, 0.0, float(line), rms)
        for channel in range(len(channels)):
            for part in (Part.LOG_MAGNITUDE, Part.PHASE):
                table.add(part, 0.0, THRESHOLDS.next_test.typical_response_std, 0.0, place, channel, 1)
    test = RandomResponses("proposed", rig.drive_point, channels, "voltage", lines, 0.1, "none", rms, 0.0, 60.0)
    return replace(table.observations(test), chains=_chains(observations, RandomResponses))
