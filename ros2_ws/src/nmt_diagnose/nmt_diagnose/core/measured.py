"""The diagnosis with measured noise: from observations to a verdict."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from nmt_core.arrays import BoolArray, FloatArray
from nmt_core.errors import BenchError
from nmt_diagnose.core.chain import SharedDelay, shared_delays
from nmt_diagnose.core.compare import Comparison, Equivalents, Hypotheses, source_places, sources
from nmt_diagnose.core.fitting import Data, FitError, Fitted, best_errors, data_about, fit
from nmt_diagnose.core.search import Found, Search
from nmt_diagnose.core.size import Size, matters, measured_size
from nmt_diagnose.core.tuned import (
    ALARM,
    CHAIN_ROUNDS,
    EXPLAINED,
    FEWEST_LINES_LOST,
    OPEN,
    RANDOM_LINES,
    RECALIBRATION,
    REFIT_REFRESHES,
    REFIT_STEPS,
    SOLVER,
)
from nmt_diagnose.core.words import calibration_rows, candidate_row, place_rows, ranked_rows
from nmt_diagnose.effects.calibration import CalibrationParameter, calibration_parameters
from nmt_diagnose.effects.library import candidates as library_candidates
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.inference.diagnose import DiagnosisOutcome
from nmt_diagnose.inference.diagnosis import Diagnosis, Gap, Verdict
from nmt_diagnose.inference.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.inference.gap import Closed, closed, rms
from nmt_diagnose.inference.held_out import Split, splits
from nmt_diagnose.inference.remainder import remainder
from nmt_diagnose.inference.residual_map import per_observable, residual_map
from nmt_diagnose.inference.residual_tests import residual_tests
from nmt_diagnose.inference.result_tables import inputs
from nmt_diagnose.inference.sentences import sentences
from nmt_diagnose.observations.observables import Observations
from nmt_diagnose.observations.observation_settings import ObservationSettings
from nmt_diagnose.observations.read_observations import read_observations
from nmt_diagnose.twin.forward import Forward, Prediction, traced
from nmt_diagnose.twin.operating_range import operating_range
from nmt_rig.rig import Rig

Told = Callable[[str], None]


@dataclass(frozen=True)
class Findings:
    """What the comparison of explanations rests on.

    Attributes:
        data: rows, noise and chain, about the best explanation.
        search: fits explanations to them.
        given: prediction of the model as given.
        null: the model alone.
        named: explanations by one and two effects, the best first.
        comparison: probabilities.
        sources: what something unnamed at each place would explain beside the model alone.
    """

    data: Data
    search: Search
    given: Prediction
    null: Found
    named: tuple[Found, ...]
    comparison: Comparison
    sources: dict[str, float]


def diagnose_measured(
    rig: Rig,
    bags: Sequence[Path | str],
    floor_bags: Sequence[Path | str],
    settings: DiagnosisSettings,
    progress: Told,
) -> DiagnosisOutcome:
    """Diagnose the gap between a rig and bags of the real side.

    Args:
        rig: the model.
        bags: runs or imports of the real side.
        floor_bags: repeats of tests among them.
        settings: what is asked.
        progress: called with a sentence as the work goes on.

    Raises:
        BenchError: bags or rig cannot be used.
    """
    return judged(rig, observed(rig, bags, floor_bags, settings, progress), settings, progress)


def observed(
    rig: Rig,
    bags: Sequence[Path | str],
    floor_bags: Sequence[Path | str],
    settings: DiagnosisSettings,
    progress: Told,
) -> Observations:
    """Rows of the bags with the noise that they show; arguments as for :func:`diagnose_measured`."""
    reading = ObservationSettings(calibration=settings.calibration, floors=SOLVER, lines=RANDOM_LINES)
    return read_observations(bags, rig, floor_bags, reading, progress, settings.allow_own_model)


def find(rig: Rig, observations: Observations, settings: DiagnosisSettings, tell: Told = lambda _: None) -> Findings:
    """Fit and compare all explanations.

    Raises:
        BenchError: the model has no solution for any of the observations.
    """
    parameters: tuple[CalibrationParameter, ...] = (
        *calibration_parameters(rig),
        *shared_delays(observations, rig),
    )
    tell("re-fitting the model's own parameters")
    observations, given, null, data = _null(rig, observations, parameters)
    candidates = library_candidates(
        rig, operating_range(rig, observations.tests, observations=observations), settings.withheld
    )
    search = Search(data, rig, parameters, candidates, tell)
    tell(f"scanning {len(candidates)} candidates")
    scores = search.scores(null)
    singles = search.singles(null, scores)
    tell("looking for second effects")
    named = sorted([*singles, *search.pairs(singles)], key=lambda own: -own.fit.log_evidence)
    if named and named[0].fit.log_evidence > null.fit.log_evidence:
        # Errors of the chain act about the best explanation; every other competes under the same noise.
        data = _about(rig, observations, named[0].fit, data.used)
        search = Search(data, rig, parameters, candidates, tell)
        null, named = search.again(null), search.all_again(named)
    found = source_places(data, rig, null)
    alone = sources(data, null, found, len(parameters))
    first = Hypotheses(null, named, candidates, alone, [])
    behind = sources(data, first.best, found, len(parameters)) if first.best is not None else []
    comparison = Hypotheses(null, named, candidates, alone, behind).compared()
    explained: dict[str, float] = {}
    for source in alone:
        explained[source.placement.kind] = max(explained.get(source.placement.kind, 0.0), source.explained)
    return Findings(data, search, given, null, tuple(named), comparison, explained)


def _null(
    rig: Rig, observations: Observations, parameters: Sequence[CalibrationParameter]
) -> tuple[Observations, Prediction, Found, Data]:
    """The model alone: first by logarithms, then with its chain about where it stands."""
    try:
        given = Forward(observations.tests, observations.rows).predict(rig)
        observations = replace(observations, tests=traced(observations.tests, given))
        given = Forward(observations.tests, observations.rows).predict(rig, given)
        used = np.isfinite(given.values)
        if used.sum() < FEWEST_LINES_LOST * used.size:
            raise FitError("it has no solution for most of the observables")
        own = Parametrisation(rig, tuple(parameters))
        data = data_about(observations, rig, given, used, logarithms=True)
        found = fit(data, own, own.zero, given)
        for _ in range(CHAIN_ROUNDS):
            data = _about(rig, observations, found, used)
            found = fit(data, own, found.theta, found.prediction)
    except (FitError, ArithmeticError, np.linalg.LinAlgError) as error:
        raise BenchError(f"The model cannot be compared with the observations: {error}.") from error
    return data.observations, given, Found((), found), data


def _about(rig: Rig, observations: Observations, near: Fitted, used: BoolArray) -> Data:
    """What fits work on, noise of measured amplitudes and errors of the chain about a fit."""
    observations = replace(observations, tests=traced(observations.tests, near.prediction))
    own = near.parametrisation.rig(near.theta)
    prediction = Forward(observations.tests, observations.rows).predict(own, near.prediction)
    return data_about(observations, own, prediction, used & np.isfinite(prediction.values))


def judged(
    rig: Rig, observations: Observations, settings: DiagnosisSettings, tell: Told = lambda _: None
) -> DiagnosisOutcome:
    """The whole diagnosis of observations that have been read."""
    held = splits(observations, settings.hold_out)
    findings = find(rig, observations, settings, tell)
    data, null, comparison = findings.data, findings.null, findings.comparison
    tell("predicting what was held out")
    leader = comparison.classes[0] if comparison.classes else None
    given = best_errors(data, findings.given.values)
    shares = {} if leader is None else {leader.head.explanation: _closed(findings, leader.head, held, settings.seed)}
    share = None if leader is None else shares[leader.head.explanation]
    size = None if leader is None else measured_size(data, null, leader.head)
    verdict = _verdict(comparison, leader, share, size, settings, given.cost - null.fit.cost)
    best = leader.head if verdict is Verdict.EFFECT and leader is not None else null
    scale = np.sqrt(best.fit.errors.weights)
    as_given, before, after = (own.left * scale for own in (given, null.fit.errors, best.fit.errors))
    seen = replace(data.observations, std=data.sigma / scale, floor=np.zeros_like(data.sigma))
    rows = data.used
    gap = Gap(
        before=share.before if share is not None and verdict is not Verdict.CALIBRATION else rms(before[rows]),
        after=share.after if share is not None and best is not null else rms(after[rows]),
        floor=1.0,
        as_given=rms(as_given[rows]),
        closed=share.value if share is not None and best is not null else math.nan,
        low=share.low if share is not None and best is not null else math.nan,
        high=share.high if share is not None and best is not null else math.nan,
        per_observable=per_observable(seen, before, after, rows),
        held_out=tuple(split.name for split in held),
    )
    rest = remainder(seen, gap, after, rows) if verdict is Verdict.EFFECT else None
    where = place_rows(comparison, findings.sources) if verdict in (Verdict.EFFECT, Verdict.UNKNOWN) else ()
    ranking = ranked_rows(comparison, shares)
    calibration = calibration_rows(best)
    said = sentences(
        verdict, where, ranking, leader.head.explanation if leader is not None else None, gap, (), calibration, rest
    )
    if size is not None and verdict in (Verdict.NONE, Verdict.CALIBRATION) and comparison.log_odds > ALARM:
        said = (*said, size.sentence)
    diagnosis = Diagnosis(
        verdict=verdict,
        sentences=said,
        where=where,
        ranking=ranking,
        probabilities=dict(comparison.by_label),
        gap=gap,
        next_test=(),
        calibration=calibration,
        inputs=inputs(observations, rig, held, settings),
        notes=observations.notes + tuple(findings.given.reasons),
        residual_map=residual_map(seen, as_given, before, after),
        residual_tests=tuple(test.to_mapping() for test in residual_tests(seen, after, rows)),
        candidates=tuple(candidate_row(own, null, data) for own in (null, *findings.named)),
        features={
            "feature:log_odds": comparison.log_odds,
            "cost_given": given.cost,
            "cost_null": null.fit.cost,
            "cost_best": best.fit.cost,
            **{f"rms:{name}": value for name, value in _group_rms(data, best).items()},
        },
        remainder=rest,
    )
    model = rig if verdict is Verdict.NONE else _rig_of(best, len(calibration))
    return DiagnosisOutcome(diagnosis, seen, rig, model, given.values, null.fit.errors.values, best.fit.errors.values)


def _group_rms(data: Data, found: Found) -> dict[str, float]:
    """Learnt scale of each group of rows: its rms in the stated noise."""
    values = np.sqrt(found.fit.errors.squares / np.maximum(data.counts, 1.0))
    return dict(zip(data.groups.names, map(float, values), strict=True))


def _rig_of(found: Found, own: int) -> Rig:
    """The rig of an explanation; what belongs to the measuring chain stays as given."""
    theta = found.fit.theta.copy()
    parameters = found.fit.parametrisation.calibration
    for k, parameter in enumerate(parameters):
        if k >= own:
            assert isinstance(parameter, SharedDelay)
            theta[k] = 0.0
    return found.fit.parametrisation.rig(theta)


def _verdict(
    comparison: Comparison,
    leader: Equivalents | None,
    share: Closed | None,
    size: Size | None,
    settings: DiagnosisSettings,
    recalibrated: float,
) -> Verdict:
    quiet = Verdict.CALIBRATION if recalibrated > RECALIBRATION else Verdict.NONE
    if comparison.log_odds < ALARM:
        return quiet
    if leader is None:
        return Verdict.UNKNOWN
    if size is not None and not matters(size, settings.matters) and leader.probability > comparison.unknown:
        return quiet
    if leader.probability >= comparison.unknown:
        return Verdict.EFFECT
    # Something unnamed may lie behind; what closes most of the gap all the same is what it is made of.
    most = share is not None and math.isfinite(share.value) and share.value >= EXPLAINED
    return Verdict.EFFECT if most else Verdict.UNKNOWN


def _closed(findings: Findings, best: Found, held: Sequence[Split], seed: int) -> Closed:
    """How much of the gap an explanation closes on rows that its fit did not see.

    A split whose fit leaves open what the explanation does to the rows held out says nothing of it.
    """
    data, null = findings.data, findings.null
    change = (best.fit.errors.left - null.fit.errors.left) * np.sqrt(best.fit.errors.weights)
    pairs = []
    for split in held:
        rows = split.held_out & data.used
        before, after = (_unseen(data, own, split, best) for own in (null, best))
        if before is not None and after is not None and rows.any():
            if rms(after[1][rows]) <= OPEN * rms(change[rows]):
                pairs.append((before[0], after[0] / np.hypot(1.0, after[1]), rows))
    return closed(data.observations, pairs, seed)


def _unseen(data: Data, found: Found, split: Split, best: Found) -> tuple[FloatArray, FloatArray] | None:
    """Residual of all rows by a fit to some and uncertainty of its prediction, over the noise that the best fit leaves.

    What is predicted is the rig; how the measuring chain was when the rest was measured, those rows tell themselves.
    """
    part = replace(data, used=data.used & split.fitted)
    own, scale = found.fit, np.sqrt(best.fit.errors.weights)
    try:
        refit = fit(
            part, own.parametrisation, own.theta, own.prediction, own.jacobian, REFIT_STEPS, False, REFIT_REFRESHES
        )
    except FitError:
        return None
    left = best_errors(data, refit.prediction.values, own.errors).left
    open_of_it = np.sqrt(np.einsum("mi,ij,mj->m", own.jacobian, refit.covariance, own.jacobian))
    return left * scale, open_of_it * scale
