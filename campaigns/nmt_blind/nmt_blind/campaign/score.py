"""Opens the seal of a blind check once and compares every diagnosis with the truth."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from nmt_blind.campaign.baselines import PLAIN_METHODS, FeatureClassifier, Method
from nmt_blind.campaign.frozen import frozen_digest
from nmt_blind.campaign.run import read_public, read_result
from nmt_blind.campaign.scored_case import Answer, ScoredCase, scored_case
from nmt_blind.campaign.statistics import (
    Proportion,
    ReliabilityDiagram,
    area_under_roc,
    reliability,
    roc_curve,
    threshold_for,
)
from nmt_core.errors import BenchError
from nmt_core.files.hardened import json_value, read_json
from nmt_core.files.whole_file import write_whole

SCORE_FORMAT = "nmt blind score 1"
STRONG = 8.0
"""Standard deviations from which an effect must be found."""
STRONGEST = 16.0
"""Up to here effects are of the strengths that the published figures are about; beyond, anyone sees them."""
BANDS = ((0.0, 2.0), (2.0, 8.0), (8.0, 32.0), (32.0, 128.0), (128.0, 1024.0), (1024.0, 1e9))
"""Effects that are counted together, from the first number on to below the second, standard deviations."""
FALSE_ALARMS = 0.01
WRONGLY_UNKNOWN = 0.05
_OPENED_FILE = "opened.json"


@dataclass(frozen=True)
class MethodScore:
    """Figures that every method has.

    Attributes:
        name: of the method.
        detected: of effects from 8 σ, at its own threshold; false_alarms: of null cases, at the same.
        detected_at_rate: of the same effects, at the threshold with 1 % false alarms on these cases.
        first, first_three: the right effect first and among the first three, single effects from 8 σ.
        roc_area: of gap or no gap, over all effects.
        unknown_area: of unnamed against named effects; NaN if the method cannot say.
    """

    name: str
    detected: Proportion
    false_alarms: Proportion
    detected_at_rate: Proportion
    first: Proportion
    first_three: Proportion
    roc_area: float
    unknown_area: float


@dataclass(frozen=True)
class BandScore:
    """Figures of the effects of a band of strengths.

    Attributes:
        low, high: the band, standard deviations.
        detected: named and unnamed effects; first: the right effect first, single effects; place: their place.
        covered: effects named rightly with the truth within 3 standard uncertainties in all their parameters.
        unknown: unnamed effects that were called unknown.
        pairs: both of two effects among the first three; by the weaker one.
    """

    low: float
    high: float
    detected: Proportion
    first: Proportion
    place: Proportion
    covered: Proportion
    unknown: Proportion
    pairs: Proportion


@dataclass(frozen=True)
class Scores:
    """All figures of a campaign.

    Attributes:
        rig, purpose: of the campaign.
        cases: scored; missing: names of those without a result; failed: with a result but no verdict.
        seal, trail: sha256 of the truth and of the list of bag hashes.
        openings: how often the seal has been opened, this time included.
        method: the diagnosis; baselines: other methods.
        place, by place of effects from 8 σ; compound: both effects among the first three.
        unknown_recall: at 5 % wrongly unknown; verdict_unknown: share of unnamed effects called unknown;
            wrongly_unknown: share of named ones called so.
        calibrated: share of null cases with shifted parameters called calibration; plain_none: of those without shift
            called none.
        width, count: reliability over bins of equal width and of equal count, of null cases and effects from 8 σ.
        closed: median share of the held-out gap that was closed where an effect was accepted; harm: share of
            such cases whose held-out gap grew.
        by_strength: power of 2 next to the strength -> (detected, right first) of single effects.
        confusion: truth -> answer -> number of cases.
        roc: false alarms and detections of effects from 8 σ.
        seconds: median computing time of a diagnosis, s.
        training: campaign that the classifier learned from; empty = none.
        frozen: sha256 of the program that diagnosed; empty = not noted.
        within: the diagnosis on cases up to 16 σ only.
        unnamed: by strength, how often an unnamed effect was called unknown.
        covered: share of rightly named effects from 8 σ with the truth within 3 standard uncertainties in all their
            parameters; bands: figures by strength.
        stalled: cases of which fewer than half of the levels locked.
    """

    rig: str
    purpose: str
    cases: tuple[ScoredCase, ...]
    missing: tuple[str, ...]
    failed: tuple[str, ...]
    seal: str
    trail: str
    openings: int
    method: MethodScore
    baselines: tuple[MethodScore, ...]
    place: Proportion
    compound: Proportion
    unknown_recall: Proportion
    verdict_unknown: Proportion
    wrongly_unknown: Proportion
    calibrated: Proportion
    plain_none: Proportion
    width: ReliabilityDiagram
    count: ReliabilityDiagram
    closed: float
    closed_cases: int
    harm: Proportion
    by_strength: dict[float, tuple[Proportion, Proportion]]
    confusion: dict[str, dict[str, int]]
    roc: tuple[tuple[float, ...], tuple[float, ...]]
    seconds: float
    within: MethodScore
    unnamed: dict[float, Proportion]
    covered: Proportion
    bands: tuple[BandScore, ...]
    training: str = ""
    frozen: str = ""
    stalled: tuple[str, ...] = ()
    by_kind: dict[str, dict[str, int]] = field(default_factory=dict)

    def to_mapping(self) -> dict[str, Any]:
        """Plain values for JSON; of the cases only what they came to."""
        result = {"format": SCORE_FORMAT, **_plain(replace(self, cases=()))}
        result["cases"] = [
            {
                "case": case.name,
                "kind": case.kind,
                "truth": sorted(case.truth),
                "sigma": case.sigma,
                "shifted": case.shifted,
                "withheld": case.withheld,
                "verdict": case.verdict,
                "answer": first_answer(case),
                "place": case.place,
                "estimates": [{**_plain(asdict(e)), "deviation": _plain(e.deviation)} for e in case.estimates],
                "confidence": _plain(case.confidence),
            }
            for case in self.cases
        ]
        return result


def score_campaign(
    folder: Path,
    results: Path | None = None,
    again: bool = False,
    train: Path | None = None,
    measured: Callable[[dict[str, Any]], Mapping[str, float]] | None = None,
) -> Scores:
    """Open the seal and compute all figures.

    Args:
        folder: the campaign's folder.
        results: folder of the results; None = ``results`` in it.
        again: score although the seal has been opened before.
        train: diagnosed development campaign for the generic classifier.
        measured: gives for the opened truth the strength of each case by the noise that its recordings have, standard
            deviations. Those left out, and all of them without it, have no known strength.

    Raises:
        BenchError: the truth or the bags' hashes are not those that were sealed, the seal has been opened before,
            nothing was diagnosed, or the training campaign is not a development campaign.
    """
    results = results or folder / "results"
    public = read_public(folder)
    seal = _read(folder / "seal.json")
    if not any(read_result(results, str(case["case"])) for case in public["cases"]):
        raise BenchError(f"There are no results in {results}; diagnose the cases with './nmt blind run' first.")
    classifier, training = _trained(train, folder)
    truth = _opened(folder, seal)
    trail = _checked_trail(folder, seal, truth, results)
    openings = _note_opening(folder, seal, again)
    cases, missing = read_cases(truth, results)
    if measured is not None:
        strengths = measured(truth)
        cases = tuple(replace(case, sigma=strengths.get(case.name, case.sigma)) for case in cases)
    failed = tuple(case.name for case in cases if case.verdict == "failed")
    return compute_scores(
        cases, {"rig": str(public["rig"]), "purpose": str(seal["purpose"]), "missing": missing, "failed": failed,
                "seal": str(seal["sha256"]), "trail": trail, "openings": openings, "training": training,
                "frozen": frozen_digest(results),
                "stalled": _stalled(folder, [case.name for case in cases])},
        classifier,
    )  # fmt: skip


def _stalled(folder: Path, names: Sequence[str]) -> tuple[str, ...]:
    """Cases of which some test locked on fewer than half of its levels: the truth was too strong for the loop."""
    found = []
    for name in names:
        path = folder / "cases" / name / "bags.json"
        tests = _read(path).values() if path.is_file() else ()
        if any(2 * int(test["locked"]) < int(test["levels"]) for test in tests):
            found.append(name)
    return tuple(found)


def read_cases(truth: dict[str, Any], results: Path) -> tuple[tuple[ScoredCase, ...], tuple[str, ...]]:
    """Cases with a result, and names of those without."""
    cases, missing = [], []
    for entry in truth["cases"]:
        result = read_result(results, str(entry["case"]))
        if result is None:
            missing.append(str(entry["case"]))
        else:
            cases.append(scored_case(entry, result))
    return tuple(cases), tuple(missing)


def compute_scores(cases: Sequence[ScoredCase], about: dict[str, Any], classifier: Method | None = None) -> Scores:
    """All figures of cases.

    Args:
        cases: with truth and answers.
        about: fields of `Scores` that do not follow from them.
        classifier: the generic classifier; None = none was trained.
    """
    methods = dict(PLAIN_METHODS)
    if classifier is not None:
        methods["classifier"] = classifier
    null = [case for case in cases if case.kind == "null"]
    single = [case for case in cases if case.single]
    strong = [case for case in cases if case.kind != "null" and case.sigma >= STRONG]
    named = [case for case in cases if case.known and case.sigma >= STRONG]
    unnamed = [case for case in cases if case.unknown and case.sigma >= STRONG]
    compound = [case for case in cases if case.kind == "compound"]
    limit = threshold_for([_unknown(case) for case in named], WRONGLY_UNKNOWN)
    accepted = [case for case in cases if case.verdict == "effect" and case.known and math.isfinite(case.closed)]
    judged = [
        case for case in cases if case.verdict == "effect" and math.isfinite(case.before) and math.isfinite(case.after)
    ]
    settled = [case for case in cases if case.verdict != "failed"]
    # Of an effect that the recordings do not show, "none" is not a wrong answer.
    strong_or_null = [case for case in settled if case.kind == "null" or case.sigma >= STRONG]
    stated = [case.confidence for case in strong_or_null]
    right = [case.settled_rightly for case in strong_or_null]
    false, true = roc_curve([c.answer.gap_score for c in strong], [c.answer.gap_score for c in null])
    return Scores(
        **about,
        cases=tuple(cases),
        method=_method("diagnosis", cases, lambda case: case.answer),
        baselines=tuple(_method(name, cases, method) for name, method in methods.items()),
        place=Proportion.count([case.place in case.places for case in single if case.sigma >= STRONG]),
        compound=Proportion.count([case.answer.among(case.truth) for case in compound]),
        unknown_recall=Proportion.count([_unknown(case) > limit for case in unnamed]),
        verdict_unknown=Proportion.count([case.verdict == "unknown" for case in unnamed]),
        wrongly_unknown=Proportion.count([case.verdict == "unknown" for case in named]),
        calibrated=Proportion.count([case.verdict == "calibration" for case in null if case.shifted]),
        plain_none=Proportion.count([case.verdict == "none" for case in null if not case.shifted]),
        width=reliability(stated, right),
        count=reliability(stated, right, equal=True),
        closed=float(np.median([case.closed for case in accepted])) if accepted else math.nan,
        closed_cases=len(accepted),
        harm=Proportion.count([case.after > 1.001 * case.before for case in judged]),
        by_strength={
            sigma: (
                Proportion.count([case.answer.alarm for case in cases_there]),
                Proportion.count([case.answer.first(case.truth) for case in cases_there]),
            )
            for sigma, cases_there in _by_octave(single).items()
        },
        confusion=_confusion(
            [case for case in cases if case.kind != "compound" and (case.sigma == 0.0 or case.sigma >= STRONG)]
        ),
        roc=(tuple(map(float, false)), tuple(map(float, true))),
        seconds=float(np.nanmedian([case.seconds for case in cases])) if cases else math.nan,
        by_kind=_by_kind(cases),
        within=_method("diagnosis", [case for case in cases if case.sigma <= STRONGEST], lambda case: case.answer),
        unnamed={
            sigma: Proportion.count([case.verdict == "unknown" for case in cases_there])
            for sigma, cases_there in _by_octave([case for case in cases if case.unknown]).items()
        },
        covered=Proportion.count([within for case in strong for within in case.covered]),
        bands=tuple(
            _band(low, high, [case for case in cases if case.kind != "null" and low <= case.sigma < high])
            for low, high in BANDS
        ),
    )


def _by_octave(cases: Sequence[ScoredCase]) -> dict[float, list[ScoredCase]]:
    """Cases by the power of 2 next to their strength, 1 at least; those of unknown strength are left out."""
    found: dict[float, list[ScoredCase]] = {}
    for case in cases:
        if math.isfinite(case.sigma):
            found.setdefault(2.0 ** round(math.log2(max(case.sigma, 1.0))), []).append(case)
    return dict(sorted(found.items()))


def _band(low: float, high: float, cases: Sequence[ScoredCase]) -> BandScore:
    single = [case for case in cases if case.single]
    return BandScore(
        low,
        high,
        detected=Proportion.count([case.answer.alarm for case in cases]),
        first=Proportion.count([case.answer.first(case.truth) for case in single]),
        place=Proportion.count([case.place in case.places for case in single]),
        covered=Proportion.count([within for case in cases for within in case.covered]),
        unknown=Proportion.count([case.verdict == "unknown" for case in cases if case.unknown]),
        pairs=Proportion.count([case.answer.among(case.truth) for case in cases if case.kind == "compound"]),
    )


def _method(name: str, cases: Sequence[ScoredCase], method: Method) -> MethodScore:
    answers: list[tuple[ScoredCase, Answer]] = [(case, method(case)) for case in cases]
    null = [answer for case, answer in answers if case.kind == "null"]
    gaps = [answer for case, answer in answers if case.kind != "null"]
    strong = [answer for case, answer in answers if case.kind != "null" and case.sigma >= STRONG]
    single = [(case, answer) for case, answer in answers if case.single and case.sigma >= STRONG]
    limit = threshold_for([answer.gap_score for answer in null], FALSE_ALARMS)
    unknown = [
        [a.unknown_score for c, a in answers if getattr(c, kind) and c.sigma >= STRONG and a.unknown_score is not None]
        for kind in ("unknown", "known")
    ]
    return MethodScore(
        name=name,
        detected=Proportion.count([answer.alarm for answer in strong]),
        false_alarms=Proportion.count([answer.alarm for answer in null]),
        detected_at_rate=Proportion.count([answer.gap_score > limit for answer in strong]),
        first=Proportion.count([answer.first(case.truth) for case, answer in single]),
        first_three=Proportion.count([answer.among(case.truth) for case, answer in single]),
        roc_area=area_under_roc([a.gap_score for a in gaps], [a.gap_score for a in null]),
        unknown_area=area_under_roc(*unknown),
    )


def first_answer(case: ScoredCase) -> str:
    """What the diagnosis settled on, in a word; the truth's own name if it is among the first's equivalents."""
    if case.verdict in ("none", "calibration"):
        return "none"
    if case.verdict != "effect":
        return case.verdict
    if case.answer.first(case.truth):
        return " + ".join(sorted(case.truth))
    head = case.details.get("ranking", [{}])[0].get("effect", "failed")
    return str(head)


def _confusion(cases: Sequence[ScoredCase]) -> dict[str, dict[str, int]]:
    table: dict[str, dict[str, int]] = {}
    for case in cases:
        row = "none" if case.kind == "null" else " + ".join(sorted(case.truth))
        row = f"{row} (withheld)" if case.kind == "withheld" else f"{row} (open)" if case.kind == "open" else row
        answer = first_answer(case)
        table.setdefault(row, {})
        table[row][answer] = table[row].get(answer, 0) + 1
    return {row: table[row] for row in sorted(table, key=lambda name: (name != "none", name))}


def _by_kind(cases: Sequence[ScoredCase]) -> dict[str, dict[str, int]]:
    table: dict[str, dict[str, int]] = {}
    for case in cases:
        row = table.setdefault(case.kind, {})
        row[case.verdict] = row.get(case.verdict, 0) + 1
    return table


def _unknown(case: ScoredCase) -> float:
    score = case.answer.unknown_score
    return -math.inf if score is None else score


# The seal --------------------------------------------------------------------------------------------------------


def _opened(folder: Path, seal: dict[str, Any]) -> dict[str, Any]:
    path = folder / "truth.sealed"
    try:
        text = path.read_bytes()
    except OSError as error:
        raise BenchError(f"The sealed file {path} is not there; without it nothing can be scored.") from error
    digest = hashlib.sha256(text).hexdigest()
    if digest != seal.get("sha256"):
        raise BenchError(
            f"The seal is broken: {path} has sha256 {digest}, sealed was {seal.get('sha256')}; these cases cannot be "
            "scored."
        )
    values = json_value(text.decode("utf-8", "replace"), f"The sealed file {path}")
    if not isinstance(values, dict):
        raise BenchError(f"The sealed file {path} is not what a campaign holds.")
    return values


def _checked_trail(folder: Path, seal: dict[str, Any], truth: dict[str, Any], results: Path) -> str:
    """Hash of the list of bag hashes, after every diagnosed bag was found to be the one that was made."""
    path = folder / "hashes.json"
    if not path.is_file():
        raise BenchError(
            f"Not all cases of {folder} have been made; go on with './nmt blind make' and './nmt blind run'."
        )
    trail = _read(path)
    if trail.get("truth") != seal["sha256"]:
        raise BenchError(f"The list of bags {path} belongs to another truth; make the campaign again.")
    for entry in truth["cases"]:
        name = str(entry["case"])
        result = read_result(results, name)
        if result is not None and result.get("bags") != trail["bags"].get(name):
            raise BenchError(
                f"Case {name} was diagnosed on other bags than those that were made (sha256 differs); "
                "diagnose it again with './nmt blind run --again'."
            )
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _note_opening(folder: Path, seal: dict[str, Any], again: bool) -> int:
    """Count the openings of a sealed campaign; development campaigns may be looked at freely."""
    if seal.get("purpose") != "sealed":
        return 0
    path = folder / _OPENED_FILE
    openings = int(_read(path)["openings"]) if path.is_file() else 0
    if openings and not again:
        raise BenchError(
            f"The seal of {folder} has been opened before; a second score is not a blind check any more: add --again "
            "if it is wanted all the same, the score sheet will say so."
        )
    write_whole(path, json.dumps({"openings": openings + 1}) + "\n")
    return openings + 1


def _trained(train: Path | None, folder: Path) -> tuple[Method | None, str]:
    if train is None:
        return None, ""
    if train.resolve() == folder.resolve():
        raise BenchError(f"The classifier may learn from other cases only than it is scored on, not from {train}.")
    usable = [case for case in development_cases(train) if case.details.get("features")]
    if len(usable) < 2:
        raise BenchError(f"The training campaign {train} has no diagnosed cases; run './nmt blind run' on it first.")
    return FeatureClassifier(usable), str(train)


def opened_truth(folder: Path) -> dict[str, Any]:
    """What is true of the cases of a campaign of development, or of a sealed one that was opened.

    Raises:
        BenchError: its seal has not been opened, or it is not a campaign.
    """
    seal = _read(folder / "seal.json")
    if seal.get("purpose") != "development" and not (folder / _OPENED_FILE).is_file():
        raise BenchError(f"The seal of {folder} has not been opened; './nmt blind score' opens it.")
    return _opened(folder, seal)


def development_cases(folder: Path) -> tuple[ScoredCase, ...]:
    """Diagnosed cases of a campaign from which anything may be learned: of development, or sealed and opened since.

    Raises:
        BenchError: its seal has not been opened, or it is not a campaign.
    """
    seal = _read(folder / "seal.json")
    if seal.get("purpose") != "development" and not (folder / _OPENED_FILE).is_file():
        raise BenchError(f"Only development cases may be learned from; {folder} is sealed, and was not opened yet.")
    return read_cases(_opened(folder, seal), folder / "results")[0]


def _read(path: Path) -> dict[str, Any]:
    try:
        return read_json(path, "file")
    except BenchError as error:
        raise BenchError(f"The file {path} cannot be read; is {path.parent} the folder of a campaign?") from error


def _plain(value: Any) -> Any:
    if isinstance(value, Proportion):
        return value.to_mapping()
    if is_dataclass(value):
        return {entry.name: _plain(getattr(value, entry.name)) for entry in fields(value)}
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
