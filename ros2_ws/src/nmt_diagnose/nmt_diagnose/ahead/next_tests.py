"""Which test would decide: every test that the rig allows is computed ahead under the explanations that are left."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.kinds.request import PlacedSensor, TestRequest
from nmt_core.vocabulary import MOTIONS
from nmt_diagnose.ahead.ahead import Ahead
from nmt_diagnose.ahead.apart import Apart, competing, expected_information
from nmt_diagnose.ahead.expected_rows import channels_of, expected, rig_of
from nmt_diagnose.ahead.hidden_effects import Growth, Hidden, hidden_effects
from nmt_diagnose.ahead.motion_noise import noise_over_motion
from nmt_diagnose.ahead.proposals import Proposals, compared, proposals
from nmt_diagnose.effects.location import joined
from nmt_diagnose.effects.sensor_effects import RESPONSES
from nmt_diagnose.fit.explanations import FittedExplanation, Score
from nmt_diagnose.ledger.comparison import Comparison
from nmt_diagnose.ledger.diagnosis import HIDDEN, NULL, NextTest
from nmt_diagnose.measurements.measurement import Observations, locked_levels
from nmt_diagnose.search.search import Search
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig

# A larger number adds no information.
_MOST_SIGMAS = 99.0

CommandOf = Callable[[TestRequest], str]
"""Writes the command that carries a test out; empty where none does."""


@dataclass(frozen=True)
class _Rivals:
    """What a test is to set apart.

    Attributes:
        fits: the explanations.
        names: of their effects.
        p: their probabilities.
        at_hand: what has been measured.
        chain_names: of the errors of the measuring chain in the fits.
    """

    fits: Sequence[FittedExplanation]
    names: tuple[str, ...]
    p: tuple[float, ...]
    at_hand: Observations
    chain_names: Sequence[str]

    @classmethod
    def of(
        cls, comparison: Comparison, null: FittedExplanation, at_hand: Observations, chain_names: Sequence[str]
    ) -> _Rivals | None:
        """Those that most need distinguishing; None where nothing is left to settle."""
        fits = competing(comparison, null)
        if len(fits) < 2:
            return None
        names = tuple(joined(explanation.effects) or NULL for explanation in fits)
        p = tuple(comparison.by_label.get(explanation.explanation.label, 0.0) for explanation in fits)
        return cls(fits, names, p, at_hand, chain_names)

    def apart(self, left: Observations, moved: Rig | None = None) -> Apart:
        """How far a test sets them apart; on another rig than the model where one is given."""
        fits = self.fits if moved is None else [_on_other_rig(explanation, moved) for explanation in self.fits]
        return Apart(noise_over_motion(left, self.at_hand, fits[0]), fits, self.chain_names)

    def information(self, of_first: float) -> float:
        """Expected fall of the entropy of the first two, which a test sets apart by so many σ, nats."""
        return expected_information(self.p[0], self.p[1], of_first)


def next_tests(
    rig: Rig,
    observations: Observations,
    null: FittedExplanation,
    comparison: Comparison,
    with_plan: bool = False,
    chain_names: Sequence[str] = (),
    command: CommandOf = lambda _: "",
    most: int = 3,
    further: bool = False,
) -> tuple[NextTest, ...]:
    """Tests that would separate the remaining explanations, best first.

    Args:
        rig: the model.
        observations: what has been measured, with the noise that was learnt.
        null: the model with its parameters re-fitted; what competes where there is only one explanation.
        comparison: explanations.
        with_plan: levels go on by the real rig's plan, see `next_levels`; else up to twice those measured.
        chain_names: of the errors of the measuring chain in the fits.
        command: writes the command of each.
        most: tests to name; with a plan all of them, among which an investigation chooses by their time.
        further: other kinds of test too, at the highest level at hand.
    """
    rivals = _Rivals.of(comparison, null, observations, chain_names)
    if rivals is None:
        return ()
    found = []
    least = THRESHOLDS.next_test.least_asked_sigmas if with_plan else THRESHOLDS.next_test.least_sigmas
    for proposal in proposals(rig, observations, with_plan, further):
        sigma, of_first = rivals.apart(proposal.observations).sigmas()
        if sigma >= least:
            found.append(
                NextTest(
                    proposal.text,
                    command(proposal.request),
                    rivals.names,
                    min(sigma, _MOST_SIGMAS),
                    proposal.seconds,
                    rivals.information(of_first),
                    request=proposal.request,
                )
            )
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
    command: CommandOf = lambda _: "",
) -> NextTest | None:
    """The next levels of a plan and their expected benefit, however little; None above its highest level.

    With a gap they are to separate the remaining explanations. Without one they are to show what these recordings are
    too weak to show.

    Args:
        rig, observations, null, comparison, command: as for `next_tests`.
        plan: levels of the real rig's plan, which no test goes beyond.
        search: has the candidates.
        scores: computes those of the candidates on top of the model alone.
        gap: whether the recordings show one.

    Of levels that the model has no solution for, as where it has no mode that swings, nothing is expected.
    """
    asked = Proposals(rig, observations)
    high = max(
        (level.drive for level in locked_levels(asked.runs) if math.isfinite(level.drive)),
        default=math.nan,
    )
    levels = sorted(level for level in plan if level > 1.001 * high)
    if not levels:
        return None
    third = math.ceil(len(plan) / 3)

    def request(count: int) -> TestRequest:
        return asked.request("high", levels=tuple(levels[:count]))

    def test(count: int, separates: tuple[str, ...], sigma: float = math.nan, **more: Any) -> NextTest:
        chosen = request(count)
        text = f"the next levels of the plan, up to {chosen.top:.3g} V"
        seconds = asked.seconds_of_a_level * len(chosen.levels)
        return NextTest(
            text, command(chosen), separates, sigma, seconds, levels=chosen.levels, request=chosen, **more
        )  # fmt: skip

    every = request(len(levels))
    try:
        left = compared(expected(every, rig, observations), every)
        if not gap:
            left = noise_over_motion(left, observations, null)
            hidden, count, grows = _hidden(left, observations, search, null, comparison, scores, third)
    except BenchError:
        return test(min(third, len(levels)), ())
    if not gap:
        return test(
            count, (NULL, HIDDEN), information=hidden.information, hidden=hidden.probability, grows=grows
        )  # fmt: skip
    rivals = _Rivals.of(comparison, null, observations, search.data.chain_names)
    if rivals is None:
        return test(third, ())
    apart = rivals.apart(left)
    found = []
    for count in sorted({min(third, len(levels)), len(levels)}):
        sigma, of_first = apart.sigmas(left.rows.level < count)
        found.append((rivals.information(of_first) / count, count, sigma, of_first))
    # Levels that give more information for their time come in one test, however many they are.
    _, count, sigma, of_first = max(found, key=lambda item: (item[0], -item[1]))
    most = _MOST_SIGMAS
    return test(
        count, rivals.names, min(sigma, most), information=rivals.information(of_first),
        plan_sigma=min(found[-1][2], most),
    )  # fmt: skip


def _hidden(
    left: Observations,
    observations: Observations,
    search: Search,
    null: FittedExplanation,
    comparison: Comparison,
    scores: Callable[[], Sequence[Score]],
    third: int,
) -> tuple[Hidden, int, str]:
    """What the levels that are left would show, how many of them come next, and what grows to what matters there."""
    small, count, grows = comparison.small, third, ""
    alone, growth = Ahead(null.fit, search.data.chain_names, left), None
    if small is not None:
        growth = Growth(small, comparison.small_probability, left, alone, observations.matters)
        count = growth.levels(third)
    of_next = left.rows.level < count
    hidden = hidden_effects(search, null, scores(), alone, of_next)
    if growth is not None and small is not None:
        growing = Hidden(growth.matters(left.rows.level >= 0), growth.matters(of_next))
        grows = joined(small.fitted.effects) if growing.probability > hidden.probability else ""
        hidden = hidden.combined_with(growing)
    return hidden, count, grows


def other_sensors(
    rig: Rig,
    observations: Observations,
    null: FittedExplanation,
    comparison: Comparison,
    plan: Sequence[float],
    chain_names: Sequence[str],
) -> tuple[NextTest, ...]:
    """Sensors that would separate the remaining explanations in a run of the same levels, the best first; may be none.

    One more at each point, and one that an explanation names at another point that has none: a mass goes with it.

    Args:
        rig, observations, null, comparison, chain_names: as for `next_tests`.
        plan: levels of the run; empty = those measured.
    """
    rivals = _Rivals.of(comparison, null, observations, chain_names)
    asked = Proposals(rig, observations)
    if rivals is None or not asked.runs:
        return ()
    drives = {level.drive for level in asked.runs[0].levels if math.isfinite(level.drive)}
    base = asked.request("sensor", levels=tuple(sorted(plan) or sorted(drives)))
    channels = channels_of(base, rig, observations)
    sensed = {channel.point for channel in channels if channel.quantity in MOTIONS}
    found = []
    for text, sensor in _placements(rig, rivals, sensed):
        request = replace(base, sensors=(sensor,))
        left = compared(expected(request, rig, observations), request)
        sigma, _ = rivals.apart(left, rig_of(request, rig) if sensor.channel else None).sigmas()
        if sigma >= THRESHOLDS.next_test.least_sigmas:
            sigma = min(sigma, _MOST_SIGMAS)
            found.append(NextTest(text, "", rivals.names, sigma, request=request))
    return tuple(sorted(found, key=lambda item: -item.expected_sigma))


def _placements(rig: Rig, rivals: _Rivals, sensed: set[int]) -> Iterator[tuple[str, PlacedSensor]]:
    """Sensors that a rig has not, in words and as values; ``sensed``: points at which a motion is measured."""
    for point in rig.structure.points:
        text = f"a second sensor at point {point}" if point in sensed else f"a sensor at point {point}"
        yield text, PlacedSensor("displacement", point)
    named = {
        location.channel
        for explanation in rivals.fits
        for location in explanation.explanation.locations
        if location.channel
    }
    for sensor in rig.sensors:
        channel = rig.sensor_channel(sensor)
        if channel not in named or sensor.quantity not in RESPONSES:
            continue
        for point in set(rig.structure.points) - sensed:
            text = f"the sensor of {channel} at point {point} in place of {rig.sensor_point(sensor)}"
            yield text, PlacedSensor(sensor.quantity, point, channel)


def _on_other_rig(found: FittedExplanation, rig: Rig) -> FittedExplanation:
    """An explanation with what it adds on another rig."""
    parametrisation = replace(found.fit.parametrisation, base=rig)
    return replace(found, fit=replace(found.fit, parametrisation=parametrisation))
