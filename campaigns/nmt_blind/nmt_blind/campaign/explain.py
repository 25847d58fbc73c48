"""Why a diagnosis came to what it said: the true parameters under the same noise as the winner's.

A miss is judged before anything is changed. The case is diagnosed with measured noise, then the truth is fitted to the
same rows from its true parameters. Costs of model alone, winner and truth, the strength that the truth has there, and
the learnt scales tell whether the search, the priors, the physics or the information failed.
"""

from __future__ import annotations

import itertools
import json
import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from nmt_blind.campaign.foreign_case import read_cases
from nmt_blind.campaign.foreign_run import child
from nmt_blind.campaign.frozen import diagnosis_digest
from nmt_blind.campaign.run import read_public
from nmt_blind.campaign.score import opened_truth
from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_json
from nmt_core.files.whole_file import write_whole
from nmt_core.numerics.arrays import FloatArray
from nmt_core.processes.workers import worked
from nmt_diagnose.diagnose import observed
from nmt_diagnose.diagnosis_settings import DiagnosisSettings
from nmt_diagnose.effects.effect import Candidate
from nmt_diagnose.effects.library import candidates
from nmt_diagnose.effects.parametrisation import Parametrisation
from nmt_diagnose.fit.best_fit import StartName, likelihood
from nmt_diagnose.fit.candidate_starts import starts_of
from nmt_diagnose.fit.explanations import FittedExplanation
from nmt_diagnose.fit.fitting import Start
from nmt_diagnose.fit.low_level_modes import LowLevelModes
from nmt_diagnose.fit.model_alone import about, free_parameters, model_alone
from nmt_diagnose.measurements.measurement import Observations
from nmt_diagnose.prediction.operating_range import operating_range
from nmt_diagnose.search.findings import find
from nmt_diagnose.search.search import Search
from nmt_rig.rig import Rig, load_rig

_MEASURED_FILE = "measured.json"
_SAME = 2.0  # difference of costs that is none
_SEEN = 5.0  # standard deviations from which recordings show an effect
_MOST_PLACES = 16  # combinations of places at which a truth is fitted
_OFF = 1.5  # learnt scale from which a group of rows is predicted wrongly


@dataclass(frozen=True)
class Account:
    """What is known of one case.

    Attributes:
        case: its number.
        truth: labels of the true effects; empty for a healthy case.
        winner: label of the most probable explanation; ``none`` for the model alone.
        costs: of null, winner and truth; NaN where the truth has no fit.
        evidence: ln evidence of winner and truth over null.
        sigma: strength of the truth under the learnt noise, standard deviations.
        scales: learnt scale of each group of rows under null, winner and truth.
        follows: found, search, priors, physics, information (too little of it in the recordings), or healthy.
    """

    case: str
    truth: str
    winner: str
    costs: tuple[float, float, float]
    evidence: tuple[float, float]
    sigma: float
    scales: Mapping[str, tuple[float, float, float]]
    follows: str


def explain_case(folder: Path, case: str) -> Account:
    """Account of a case of a campaign whose truth may be known.

    Args:
        folder: the campaign's folder.
        case: its number.

    Raises:
        BenchError: there is no such case, it has no bags, or its seal has not been opened.
    """
    truth = {str(entry["case"]): entry for entry in opened_truth(folder)["cases"]}
    case = case.zfill(len(min(truth)))
    if case not in truth:
        raise BenchError(f"The campaign {folder} has no case {case}; it has {min(truth)} to {max(truth)}.")
    withheld = tuple(word for word in str(truth[case]["withheld"]).split(",") if word)
    settings = DiagnosisSettings(withheld=withheld, look_ahead=False, matters={})
    rig, observations = _recorded(folder, case, settings)
    return account(rig, observations, settings, truth[case])


def explain_foreign(folder: Path, case: str, command: Sequence[str]) -> Account:
    """Account of a case of a laboratory that shares no code, see :mod:`nmt_blind.campaign.foreign_case`.

    The truth is the first of its true sets of effects. What its parameters do not say starts as the library does, and a
    place that may be one of several is the one where the truth fits best.

    Args:
        folder: of the laboratory.
        case: name of the case.
        command: words that start the program, to which ``import`` and its options are added.

    Raises:
        BenchError: there is no such case, or it cannot be imported or compared.
    """
    known = {foreign_case.name: foreign_case for foreign_case in read_cases(folder)}
    if case not in known:
        raise BenchError(f"There is no case {case} in {folder}; it has {', '.join(known)}.")
    foreign_case, settings = known[case], DiagnosisSettings(look_ahead=False)
    rig = load_rig(str(foreign_case.model))
    with tempfile.TemporaryDirectory() as work:
        bags = []
        for sidecar in foreign_case.sidecars:
            bags.append(Path(work) / sidecar.stem)
            _, trouble = child([*command, "import", str(sidecar.absolute()), "--out", str(bags[-1])], math.inf)
            if trouble:
                raise BenchError(f"Case {case} cannot be imported: {trouble}")
        observations = observed(rig, bags, (), settings)
    effects = (
        foreign_case.truth.effects[0] if foreign_case.truth.kind == "effect" and foreign_case.truth.effects else ()
    )
    truth = {
        "case": case,
        "effects": [
            {
                "name": name,
                "detail": list(foreign_case.truth.place),
                "figures": _figures(name, foreign_case.truth.parameters),
            }
            for name in sorted(effects)
        ],
        "edits": [],
    }
    if foreign_case.truth.kind == "unknown":
        truth["effects"] = [{"name": foreign_case.truth.remark or "not in the library", "detail": "", "figures": {}}]
    return account(rig, observations, settings, truth)


def _figures(effect: str, parameters: Mapping[str, float]) -> dict[str, float]:
    """True parameters of one effect: ``k``, ``cubic_stiffness.k`` or ``cubic_stiffness@4.k``."""
    result = {}
    for key, value in parameters.items():
        owner, _, name = key.rpartition(".")
        if not owner or owner.partition("@")[0] == effect:
            result[name] = value
    return result


def _recorded(folder: Path, case: str, settings: DiagnosisSettings) -> tuple[Rig, Observations]:
    """Model and observations of a case.

    Raises:
        BenchError: it has no bags.
    """
    case_folder = folder / "cases" / case
    if not (case_folder / "bags.json").is_file():
        raise BenchError(f"Case {case} of {folder} has no bags; go on with './nmt blind make'.")
    rig = load_rig(str(case_folder / "model.yaml"))
    return rig, observed(rig, [case_folder / test for test in read_public(folder)["tests"]], (), settings)


def measured_strength(folder: Path, truth: Mapping[str, Any]) -> float:
    """How far the weakest true effect of a case lies beyond the noise that its recordings have, standard deviations.

    The truth is fitted from its true parameters, with and without each effect, chain and scales free. Effects that the
    diagnosis went without count.

    Args:
        folder: the campaign's folder.
        truth: the case's entry in the sealed file.

    Returns:
        NaN where the library lacks an effect, or the model has no solution with it.

    Raises:
        BenchError: the case has no bags, or they cannot be used.
    """
    rig, observations = _recorded(folder, str(truth["case"]), DiagnosisSettings(matters={}))
    parameters = free_parameters(rig, observations)
    everything = np.ones(len(observations.rows), dtype=bool)
    modes = LowLevelModes(observations, rig)
    _, _, null, data = model_alone(rig, observations, parameters, everything, modes)
    library = candidates(rig, operating_range(rig, observations.tests, observations=observations))
    true = _fitted(Search(data, rig, parameters, library), null, rig, truth)
    if true is None:
        return math.nan
    search = Search(about(rig, data.observations, true.fit, data.used), rig, parameters, library)
    true = search.refit(true)
    without = [search.refit(explanation) for explanation in _each_left_out(search, true)]
    return (
        math.sqrt(max(0.0, min(explanation.fit.cost for explanation in without) - true.fit.cost))
        if without
        else math.nan
    )


def measured_strengths(
    folder: Path,
    truth: Mapping[str, Any],
    jobs: int = 1,
    scheduler: str = "",
    progress: Callable[[int, int, str], None] = lambda done, total, case: None,
) -> dict[str, float]:
    """Strengths of all cases with effects by the noise that their recordings have, by case, standard deviations.

    They are kept in ``measured.json`` in the campaign's folder with the SHA-256 of the diagnosis, so that the next call
    goes on; those of another version of the program are measured again. Cases without bags or without a fit of the
    truth are left out.

    Args:
        folder: the campaign's folder.
        truth: its opened truth.
        jobs: worker processes on this machine.
        scheduler: address of a Dask scheduler in place of them.
        progress: called with cases done, cases in all and the newest case.
    """
    path, program = folder / _MEASURED_FILE, diagnosis_digest()
    kept = read_json(path, "list of strengths") if path.is_file() else {}
    known: dict[str, float | None] = kept["strengths"] if kept.get("sha256") == program else {}
    cases = [entry for entry in truth["cases"] if entry["effects"]]
    todo = [(folder.absolute(), entry) for entry in cases if str(entry["case"]) not in known]
    for case, value in worked(_named_strength, todo, jobs, scheduler):
        known[case] = value if math.isfinite(value) else None
        kept = {"sha256": program, "strengths": dict(sorted(known.items()))}
        write_whole(path, json.dumps(kept, indent=1) + "\n")
        progress(len(known), len(cases), case)
    return {case: value for case, value in known.items() if value is not None}


def _named_strength(folder: Path, entry: Mapping[str, Any]) -> tuple[str, float]:
    case = str(entry["case"])
    try:
        return case, measured_strength(folder, entry)
    except BenchError:
        return case, math.nan


def _each_left_out(search: Search, true: FittedExplanation) -> list[FittedExplanation]:
    """Fits with one effect less, one for each; those that have no solution are left out."""
    true_fit, count = true.fit, len(search.parameters)
    result = []
    for missing in range(len(true.candidates)):
        kept = [k for k in range(len(true.candidates)) if k != missing]
        parametrisation = search.parametrisation(
            [true.candidates[k] for k in kept], [true_fit.parametrisation.spread(k) for k in kept]
        )
        theta = np.concatenate(
            [true_fit.theta[:count], *[true_fit.theta[true_fit.parametrisation.index_of(k)] for k in kept]]
        )
        result.append(search.best(parametrisation, [Start(StartName.ALONE, theta, coarse=True)]))
    return [explanation for explanation in result if explanation is not None]


def account(rig: Rig, observations: Observations, settings: DiagnosisSettings, truth: Mapping[str, Any]) -> Account:
    """Account of observations whose truth is known.

    Args:
        rig: the model.
        observations: the real side.
        settings: of the diagnosis.
        truth: the case's entry in the sealed file.
    """
    findings = find(rig, observations, settings)
    null = findings.null
    leading = findings.comparison.classes[0] if findings.comparison.classes else None
    raised = leading is not None and findings.comparison.none < leading.probability
    winner = leading.head if leading is not None and raised else null
    true = _fitted(findings.search, findings.null, rig, truth)
    fits = [null, winner, true or null]
    costs = null.fit.cost, winner.fit.cost, true.fit.cost if true is not None else math.nan
    evidence = tuple(explanation.fit.log_evidence - null.fit.log_evidence for explanation in fits[1:])
    scales = {
        name: tuple(float(np.sqrt(explanation.fit.errors.squares[k] / findings.data.counts[k])) for explanation in fits)
        for k, name in enumerate(findings.data.groups.names)
        if findings.data.counts[k]
    }
    sigma = math.sqrt(max(0.0, costs[0] - costs[2])) if true is not None else math.nan
    named = frozenset(str(effect["name"]) for effect in truth["effects"])
    members = leading.members if leading is not None and raised else (null,)
    found = any(frozenset(member.effects) == named for member in members)
    return Account(
        str(truth["case"]),
        true.explanation.label
        if true is not None and true.candidates
        else " + ".join(f"{effect['name']}@{effect['detail']}" for effect in truth["effects"]),
        winner.explanation.label,
        costs,
        (evidence[0], evidence[1]),
        sigma,
        {name: (of_three[0], of_three[1], of_three[2]) for name, of_three in scales.items()},
        follows(
            found,
            bool(truth["effects"]),
            costs,
            evidence,
            sigma,
            [of_three[2] for of_three in scales.values()],
        ),
    )


def follows(
    found: bool,
    has_effect: bool,
    costs: Sequence[float],
    evidence: Sequence[float],
    sigma: float,
    scales: Sequence[float],
) -> str:
    """What a miss comes from.

    Args:
        found: the winner is the truth.
        has_effect: an effect was drawn.
        costs: of null, winner and truth.
        evidence: of winner and truth over null.
        sigma: strength of the truth under the learnt noise.
        scales: learnt scale of each group of rows at the truth.
    """
    if found:
        return "found" if has_effect else "healthy"
    if math.isnan(sigma):
        return "physics"  # the library has no fit of the truth
    if costs[2] < costs[1] - _SAME and sigma >= _SEEN:
        return "search" if evidence[1] > evidence[0] else "priors"
    if max(scales, default=1.0) > _OFF:
        return "physics"
    return "information" if sigma < _SEEN else "priors"


def _fitted(search: Search, null: FittedExplanation, rig: Rig, truth: Mapping[str, Any]) -> FittedExplanation | None:
    """The truth fitted from its true parameters; None where the library lacks it or the model has no solution.

    Where the truth may be at one of several places, the one where it fits best.
    """
    chosen = [_candidates(search.candidates, str(effect["name"]), effect["detail"]) for effect in truth["effects"]]
    fits = [
        _fitted_at(search, null, rig, truth, places)
        for places in itertools.islice(itertools.product(*chosen), _MOST_PLACES)
    ]
    found = [explanation for explanation in fits if explanation is not None]
    return min(found, key=lambda explanation: explanation.fit.cost, default=None)


def _fitted_at(
    search: Search, null: FittedExplanation, rig: Rig, truth: Mapping[str, Any], chosen: Sequence[Candidate]
) -> FittedExplanation | None:
    """The truth at its places, fitted from its true parameters and those of the model alone or as it was given."""
    starts = [
        parameters_of(candidate, rig, effect.get("figures", {}))
        for candidate, effect in zip(chosen, truth["effects"], strict=True)
    ]
    edits = {tuple(edit["path"]): edit["value"] for edit in truth["edits"] if edit["kind"] == "set"}
    table = []
    for base in (null.fit.theta, np.zeros_like(null.fit.theta)):
        start = base.copy()
        for k, parameter in enumerate(search.parameters):
            if parameter.path in edits:
                value = float(edits[parameter.path])
                start[k] = math.log((value + parameter.offset) / (parameter.value + parameter.offset)) / parameter.std
        table.append(Start("truth", np.concatenate([start, *starts])))
    return search.best(search.parametrisation(chosen), table, widen=True, value=likelihood)


def _candidates(candidates: Sequence[Candidate], name: str, detail: str | Sequence[str]) -> list[Candidate]:
    """The library's candidates of a true effect: at its place, or at the places that may be true."""
    of_effect = [candidate for candidate in candidates if candidate.effect.name == name]
    if isinstance(detail, str):
        spot = detail.split(" at ")[0].split(" with ")[0]
        return [candidate for candidate in of_effect if candidate.site.location.detail == spot][:1] or of_effect[:1]
    here = [
        candidate
        for candidate in of_effect
        for place in (candidate.site.location,)
        if {place.kind, place.detail, place.channel, *map(str, place.points)} & set(detail)
    ]
    return here or of_effect


def parameters_of(candidate: Candidate, rig: Rig, figures: Mapping[str, float]) -> FloatArray:
    """Dimensionless parameters of a candidate that are reported as some figures, (parameters,)."""
    parametrisation = Parametrisation(rig, (), (candidate,))

    def off(theta: FloatArray) -> FloatArray:
        reported = parametrisation.reported(theta, 0)
        return np.array([
            (min(max(reported[name][0], -1e12), 1e12) - value) / (abs(value) or 1.0)
            for name, value in figures.items()
            if name in reported
        ])  # fmt: skip

    best = None
    for begin in starts_of(candidate):
        begin = np.where(begin == 0.0, 1.0, begin)
        if not off(begin).size:
            return begin
        for sign in (1.0, -1.0):
            found = least_squares(off, sign * begin, xtol=1e-12, ftol=1e-12)
            best = found if best is None or found.cost < best.cost else best
    assert best is not None
    return np.asarray(best.x, dtype=np.float64)
