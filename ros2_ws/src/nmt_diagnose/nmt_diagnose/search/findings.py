"""From observations to all explanations, fitted and compared."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial

from nmt_core.numerics.arrays import BoolArray
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.effects.library import candidates as library_candidates
from nmt_diagnose.effects.location import Explanation
from nmt_diagnose.effects.structure_effects import MISSING_MODE
from nmt_diagnose.fit.explanations import FittedExplanation, LeftOut, Score, best_of
from nmt_diagnose.fit.fitting import ChainErrors, Data, best_chain_errors
from nmt_diagnose.fit.low_level_modes import LowLevelModes
from nmt_diagnose.fit.model_alone import about, free_parameters, model_alone
from nmt_diagnose.fit.own_chain import OwnChains
from nmt_diagnose.law.reading import LawReading
from nmt_diagnose.ledger.comparison import Comparison, Hypotheses, misfit, sources
from nmt_diagnose.ledger.held_out import named_tests
from nmt_diagnose.ledger.plain_look import Factor, factors, share_left
from nmt_diagnose.ledger.size import Objection, contradiction, leaves_something, needed
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.prediction.forward import Prediction
from nmt_diagnose.prediction.operating_range import operating_range
from nmt_diagnose.search.law_starts import law_of, with_laws
from nmt_diagnose.search.memory import Memory
from nmt_diagnose.search.search import Progress, Search, promise_evidence
from nmt_diagnose.thresholds import THRESHOLDS
from nmt_rig.rig import Rig


@dataclass(frozen=True)
class SearchState:
    """How far the search has come.

    Attributes:
        search: fits explanations, under the noise and the errors of the chain about the best of them.
        null: the model alone.
        named: explanations that compete, the best first.
        left_out: explanations that were fitted and do not compete.
        elsewhere: of these, those with effects of a competitor, with how much more each leaves.
        leader: the explanation that the errors of the chain are about.
    """

    search: Search
    null: FittedExplanation
    named: tuple[FittedExplanation, ...]
    left_out: tuple[LeftOut, ...] = ()
    elsewhere: tuple[tuple[FittedExplanation, float], ...] = ()
    leader: Explanation = Explanation(())


@dataclass(frozen=True)
class Findings:
    """What the comparison of explanations rests on.

    Attributes:
        data: rows, noise and chain, about the best explanation.
        search: fits explanations to them.
        as_given: prediction of the model as given.
        null: the model alone.
        named: explanations by one and two effects, the best first.
        hypotheses: the competition.
        comparison: probabilities.
        sources: what an unnamed cause at each place would explain in addition to the model alone.
        inadequate: what the model has to be corrected for before effects can be named.
        factors: channels that were recorded at another scale or sign.
        left_out: explanations that were fitted and do not compete.
        law: of the local force that the model lacks, read from held levels; None without such a reading.
        scanned: scores of all candidates on top of the model alone; empty without a search.
        scored: the best explanation; the model alone without a gap.
        scores: computes those of the candidates on top of it.
    """

    data: Data
    search: Search
    as_given: Prediction
    null: FittedExplanation
    named: tuple[FittedExplanation, ...]
    hypotheses: Hypotheses
    comparison: Comparison
    sources: dict[str, float]
    scored: FittedExplanation
    inadequate: tuple[str, ...] = ()
    factors: tuple[Factor, ...] = ()
    left_out: tuple[LeftOut, ...] = ()
    law: LawReading | None = None
    scanned: tuple[Score, ...] = ()
    scores: Callable[[], tuple[Score, ...]] = tuple

    @property
    def unexplained(self) -> tuple[float, str]:
        """Largest unexplained share of a channel's signal or a test's damping under the model alone; and its name."""
        return share_left(self.data.observations, self.null.fit.errors.values, self.data.used)

    @cached_property
    def contradiction(self) -> Objection | None:
        """Residual of the model alone that forbids the verdict "no gap"; or None."""
        law = self.law
        noise = law.after if law is not None and law.of_record and law.is_stated else math.inf
        return contradiction(self.data, self.null, self.data.observations.matters, noise)

    @cached_property
    def as_given_errors(self) -> ChainErrors:
        """Best errors of the chain for the model as given."""
        return best_chain_errors(self.data, self.as_given.values)


def find(
    rig: Rig,
    observations: Observations,
    settings: DiagnosisSettings,
    tell: Progress = lambda _: None,
    compared: BoolArray | None = None,
    memory: Memory | None = None,
) -> Findings:
    """Fit and compare all explanations.

    Args:
        rig: the model.
        observations: the real side.
        settings: of the diagnosis.
        tell: called with a sentence as the work goes on.
        compared: rows that take part, (m,); None = all.
        memory: of earlier diagnoses; takes what this one leaves.

    Raises:
        BenchError: the model has no solution for any of the observations.
    """
    parameters = free_parameters(rig, observations)
    tell("re-fitting the model's own parameters")
    fitted = ~named_tests(observations, settings.hold_out)
    if compared is not None:
        fitted &= compared
    modes = LowLevelModes(observations, rig)
    observations, as_given, null, data = model_alone(rig, observations, parameters, fitted, modes)
    operating = replace(operating_range(rig, observations.tests, observations=observations), lacking=modes.missing)
    certain = modes.lacking(data, null.fit, certain=True)
    beyond_effects = modes.disordered or certain
    scales = factors(observations, as_given.values, null.fit.prediction.values, fitted)
    candidates = () if modes.disordered or scales else library_candidates(rig, operating, settings.withheld)
    if certain and modes.missing:
        # No other effect makes a resonance; without one in excess, what moves a mode may explain it.
        candidates = tuple(candidate for candidate in candidates if candidate.effect.name == MISSING_MODE)
    search = Search(data, rig, parameters, candidates, tell)
    scores = cache(partial(search.scores, null))
    law: LawReading | None = None
    state = SearchState(search, null, ())

    gap = leaves_something(data, null, settings.matters, loop=True) or promise_evidence(scores())
    settled = False
    if gap:
        begun, passed = list[FittedExplanation](), frozenset[Explanation]()
        if memory is not None:
            begun = memory.begun(search, null, lambda it: about(rig, observations, it, search.data.used))
        if begun and memory is not None:
            passed = memory.far | {explanation.fitted for explanation in begun}
        else:
            law = None if beyond_effects or scales else law_of(rig, observations.take(fitted))
            begun = with_laws(search, null, law)
        if passed and memory is not None and memory.searched:
            # What leaves noise only of a large gap needs no candidate that was not fitted when it was found.
            far = THRESHOLDS.search.far_behind_log_evidence
            settled = begun[0].fit.log_evidence - null.fit.log_evidence > 2.0 * far
        singles = begun if settled else _singles(search, null, scores(), begun, modes, rig, passed)
        state = _about_best(state, rig, observations, singles)
        pairs = _pairs(state, modes)
        if pairs and pairs[0].fit.log_evidence > state.named[0].fit.log_evidence:
            state = _about_best(state, rig, observations, [*state.named, *pairs])
        else:
            state = _competing(state, [*state.named, *pairs])
    else:  # one fit tells what a difference that does not matter looks like
        state = _about_best(state, rig, observations, search.fitted(null, scores()[:1]))
    first_null, search, null, named = null, state.search, state.null, list(state.named)
    data = search.data
    own_chain = OwnChains(rig, observations, data, state.leader)
    named = [needed(data, explanation, [null, *named], settings.matters, own_chain) for explanation in named]
    leading = Hypotheses(data, null, named, candidates, [], []).leading
    if leading is not None and leading.small:
        # An effect that is small in the leading explanation is small in every other: rivals get it, too.
        more = search.with_small_effects(leading, named)
        named += [needed(data, explanation, [null, *named], settings.matters, own_chain) for explanation in more]
    unnamed = sources(data, null, len(parameters))
    best_named = Hypotheses(data, null, named, candidates, unnamed, []).best
    behind = sources(data, best_named, len(parameters)) if best_named is not None else []
    hypotheses = Hypotheses(data, null, named, candidates, unnamed, behind, state.elsewhere)
    comparison = hypotheses.compared()
    explained: dict[str, float] = {}
    for source in unnamed:
        explained[source.location.kind] = max(explained.get(source.location.kind, 0.0), source.explained)
    best = best_named if best_named is not None and comparison.log_odds > THRESHOLDS.verdict.alarm_log_odds else null
    for location in best.explanation.locations:
        explained[location.kind] = max(explained.get(location.kind, 0.0), null.fit.cost - best.fit.cost)
    unmoved = best is first_null  # since the scan

    @cache
    def with_best() -> tuple[Score, ...]:
        return tuple(scores() if unmoved else search.scores(best, scores()))

    if memory is not None:
        memory.keep(named, [each.found for each in state.left_out], gap)
    lacking = modes.lacking(data, best.fit)
    return Findings(
        data, search, as_given, null, tuple(named), hypotheses, comparison, explained, best,
        (*modes.disordered, *lacking), scales,
        state.left_out, law,
        () if settled else tuple(scores()), with_best,
    )  # fmt: skip


def _singles(
    search: Search,
    null: FittedExplanation,
    scores: Sequence[Score],
    begun: Sequence[FittedExplanation],
    modes: LowLevelModes,
    rig: Rig,
    passed: Collection[Explanation] = (),
) -> list[FittedExplanation]:
    """Explanations by one effect and those that were begun, the best first; those that are passed need no fit."""
    singles = best_of([*begun, *search.singles(null, scores, passed)])
    if (
        not search.of_missing_modes
        and modes.far_from(rig)
        and modes.exceed_priors(null.fit.parametrisation, null.fit.theta)
    ):
        search.tell("matching modes of explanations to the measured modes")
        singles = best_of([*singles, *search.from_modes(modes)])
    return singles


def _pairs(state: SearchState, modes: LowLevelModes) -> list[FittedExplanation]:
    """Explanations by two effects, and by one that a pair led to its optimum; the best first."""
    search, singles = state.search, state.named
    search.tell("looking for second effects")
    # What one of them has not reached yet would decide which of them are left out.
    found = search.pairs(singles)
    if singles and not search.leaves_noise_only(singles[0]):
        # What is far behind alone may be one of two that leave noise only.
        every = best_of([*singles, *(each.found for each in state.left_out)])
        found += search.side_by_side(every, modes if modes.far_from(search.rig) else None)
    pairs = best_of([search.refit(pair) for pair in found])
    reached = search.pruned(pairs)
    if reached and reached[0].fit.log_evidence > singles[0].fit.log_evidence:
        before = {explanation.explanation for explanation in pairs}
        pairs += [pair for pair in search.pairs(reached, singles) if pair.explanation not in before]
    return best_of([*reached, *pairs])


def _about_best(
    state: SearchState, rig: Rig, observations: Observations, found: Sequence[FittedExplanation]
) -> SearchState:
    """Explanations that compete, fitted under the noise and the errors of the chain about the best of them."""
    named = best_of(found)
    if not named or named[0].fit.log_evidence <= state.null.fit.log_evidence:
        return replace(state, named=tuple(named))
    before, leader = state.search, named[0].fitted
    data = about(rig, observations, named[0].fit, before.data.used)
    search = Search(data, rig, before.parameters, before.candidates, before.tell)
    search.lost |= before.lost
    near, far = search.in_reach(named)
    elsewhere = _lags(near, far)
    # The evidence of two effects together is compared with that of one of them alone.
    members = [explanation for explanation in far if set(explanation.fitted.causes) < set(named[0].fitted.causes)][:1]
    near, far = search.refit_all([*near, *members]), [explanation for explanation in far if explanation not in members]
    # An effect that does nothing may have led the model's own parameters on to their optimum.
    null = search.from_parameters_of(near[0], search.refit(state.null))
    more, far = search.other_laws(near[0], far)
    left_out = _left_out(state.null, far, named, near)
    named = [*near, *more]
    # A second effect that says nothing may have led the first on to its optimum.
    named = best_of([*named, *search.pruned(named)])
    left_out, elsewhere = [*state.left_out, *left_out], [*state.elsewhere, *elsewhere]
    return SearchState(search, null, tuple(named), tuple(left_out), tuple(elsewhere), leader)


def _competing(state: SearchState, found: Sequence[FittedExplanation]) -> SearchState:
    """Explanations that are not far behind the best, fitted to the end."""
    search, named = state.search, best_of(found)
    if not named:
        return state
    near, far = search.in_reach(named)
    done = set(map(id, state.named))
    near = [explanation if id(explanation) in done else search.refit(explanation) for explanation in near]
    left_out = _left_out(state.null, far, named, near)
    return replace(
        state,
        named=tuple(best_of([*near, *search.pruned(near)])),
        left_out=(*state.left_out, *left_out),
        elsewhere=(*state.elsewhere, *_lags(near, far)),
    )


def _left_out(
    null: FittedExplanation,
    far: Sequence[FittedExplanation],
    found: Sequence[FittedExplanation],
    kept: Sequence[object],
) -> list[LeftOut]:
    """Explanations that do not compete, with how far they lie behind the best of those that were found."""
    first, most = found[0].fit.log_evidence, math.inf
    if len(kept) >= THRESHOLDS.search.finalists:
        most = first - found[THRESHOLDS.search.finalists - 1].fit.log_evidence
    return [LeftOut(explanation, null, first - explanation.fit.log_evidence, most) for explanation in far]


def _lags(near: Sequence[FittedExplanation], far: Sequence[FittedExplanation]) -> list[tuple[FittedExplanation, float]]:
    """Explanations that are far behind, with how much more each leaves than the best of its effects."""
    best = {found.effects: found for found in reversed(near)}
    result = []
    for found in far:
        if found.effects in best:
            weights = best[found.effects].fit.errors.weights
            result.append((found, misfit(found, weights) - misfit(best[found.effects], weights)))
    return result
