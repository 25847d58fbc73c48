"""Cases that another laboratory has made: their folders, what is true of them, and how an answer is classed.

A case is a folder with ``model.yaml`` (the rig file that its owner believes), ``sidecar.yaml`` or several
``sidecar*.yaml`` with their data, and ``truth.yaml``, which no diagnosis sees.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from nmt_blind.campaign.scored_case import ALARMS, EffectSet, effect_set
from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_text, yaml_value
from nmt_diagnose.effects.location import effect_words

MODEL_FILE, TRUTH_FILE = "model.yaml", "truth.yaml"
KINDS = ("healthy", "effect", "unknown")
VERDICTS = ("none", "calibration", "effect", "unknown")
CLASSES = ("right", "hedged right", "honest unknown", "hedged wrong", "confidently wrong", "refused")
SURE = 0.9
"""Probability from which a wrong answer is a confident one."""
NAMED = 0.5
"""Probability from which an explanation is named without a hedge."""
_FIRST = 3
_SETS = ("effects", "partly")


@dataclass(frozen=True)
class ForeignTruth:
    """What is true of a case.

    Attributes:
        kind: healthy, effect (the library has it) or unknown (it has not).
        verdicts: those that are right.
        effects: sets of effects of which the first explanation has to be one.
        partly: sets that are a part of the truth, or what in the library resembles it.
        place: words (point, channel, name) of which the stated place has to hold one; empty = any place.
        parameters: true values; of one effect by the name that a diagnosis gives them (``k``), of two as
            ``cubic_stiffness.k``, at one point only as ``cubic_stiffness@4.k`` (elsewhere another value does the
            same), of the model by key (``local_elements.joint.slip_force_n``).
        remark: for people.
    """

    kind: str
    verdicts: tuple[str, ...]
    effects: tuple[EffectSet, ...] = ()
    partly: tuple[EffectSet, ...] = ()
    place: tuple[str, ...] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)
    remark: str = ""


@dataclass(frozen=True)
class ForeignCase:
    """A case's folder.

    Attributes:
        folder: where it lies.
        model: the rig file.
        sidecars: one for each recording.
        truth: what is true of it.
    """

    folder: Path
    model: Path
    sidecars: tuple[Path, ...]
    truth: ForeignTruth

    @property
    def name(self) -> str:
        """That of the folder."""
        return self.folder.name


@dataclass(frozen=True)
class ForeignAnswer:
    """What the diagnosis says of a case, and what that is worth.

    Attributes:
        outcome: one of ``CLASSES``.
        verdict, effect, place, probability: as stated; of the verdicts none, calibration and unknown the probability
            of that verdict. Empty and NaN where there is no diagnosis.
        adequate: what the explanation leaves is noise.
        parameter: of those that are known, the one furthest from the truth; empty without.
        deviation: its distance from the truth in stated standard uncertainties, with its sign; NaN without.
        closed: share of the gap on data kept out of the fits; NaN if not stated.
        credible: how many answers are stated together at 95 %; 0 without a diagnosis.
        held: the truth is one of them.
    """

    outcome: str
    verdict: str = ""
    effect: str = ""
    place: str = ""
    probability: float = math.nan
    adequate: bool = True
    parameter: str = ""
    deviation: float = math.nan
    closed: float = math.nan
    credible: int = 0
    held: bool = False


def read_cases(folder: Path) -> list[ForeignCase]:
    """The cases of a laboratory, by name.

    Args:
        folder: holds a folder for each case; what has no ``truth.yaml`` is not a case.

    Raises:
        BenchError: there is none, a file is missing, or a truth has a mistake.
    """
    found = sorted(path.parent for path in folder.glob(f"*/{TRUTH_FILE}"))
    if not found:
        raise BenchError(
            f"The folder {folder} holds no cases of a laboratory; each is a folder with {MODEL_FILE}, sidecar.yaml and "
            f"{TRUTH_FILE}."
        )
    return [_case(path) for path in found]


def read_truth(path: Path) -> ForeignTruth:
    """What a file ``truth.yaml`` says.

    Raises:
        BenchError: it cannot be read, or a key is missing, unknown or of the wrong kind.
    """
    name = f"The truth {path}"
    values = yaml_value(read_text(path, "truth"), name)
    known = ForeignTruth.__dataclass_fields__
    if not isinstance(values, dict) or not set(values) <= set(known) or not {"kind", "verdicts"} <= set(values):
        raise BenchError(f"{name} must have the keys kind and verdicts, and may have {', '.join(list(known)[2:])}.")
    if values["kind"] not in KINDS:
        raise BenchError(f"{name}: kind must be one of {', '.join(KINDS)}; got {values['kind']}.")
    verdicts = _words(values, "verdicts", name)
    if not verdicts or not set(verdicts) <= set(VERDICTS):
        raise BenchError(f"{name}: verdicts must be a list of {', '.join(VERDICTS)}; got {values['verdicts']}.")
    parameters = values.get("parameters") or {}
    if not isinstance(parameters, dict) or not all(_is_number(value) for value in parameters.values()):
        raise BenchError(f"{name}: parameters must be numbers by name, such as 'k: 1.0e6'; got {parameters}.")
    sets = {key: tuple(effect_set(text) for text in _words(values, key, name)) for key in _SETS}
    if values["kind"] == "effect" and "effect" in verdicts and not sets["effects"]:
        raise BenchError(f"{name}: an effect needs its name in 'effects', such as [cubic_stiffness].")
    return ForeignTruth(
        kind=str(values["kind"]),
        verdicts=verdicts,
        effects=sets["effects"],
        partly=sets["partly"],
        place=_words(values, "place", name),
        parameters={str(key): float(value) for key, value in parameters.items()},
        remark=str(values.get("remark", "")),
    )


def contradictions(diagnosis: Mapping[str, Any]) -> tuple[str, ...]:
    """Where verdict, sentences, ranking and probabilities of a ``diagnosis.json`` say different things; sentences."""
    verdict, text = str(diagnosis["verdict"]), " ".join(diagnosis.get("sentences", ()))
    ranking, unnamed = diagnosis["ranking"], float(diagnosis["probabilities"].get("unknown", 0.0))
    adequate, head = bool(diagnosis.get("adequate", True)), ranking[0] if ranking else None
    named = "The cause is" in text or "The most probable cause is" in text
    partial = "of the gap acts like" in text
    found = []
    if named != (verdict == "effect" and adequate):
        found.append(f"the sentences {'name' if named else 'do not name'} a cause where the verdict is {verdict}")
    if partial != (verdict == "effect" and not adequate):
        found.append("sentences and verdict differ on whether the explanation is a partial one")
    if verdict == "unknown" and adequate:
        found.append("the verdict is unknown, and the explanation adequate")
    if verdict == "effect" and head is None:
        found.append("an effect without an explanation")
    if head is not None:
        sure = float(head["probability"])
        if verdict == "effect" and bool(head.get("adequate", True)) != adequate:
            found.append("table and verdict differ on whether the explanation is adequate")
        if verdict == "effect" and bool(head.get("given_library", False)) == adequate:
            found.append("the probability of the table is of other alternatives than that of the sentences")
        if verdict == "effect" and adequate and sure < unnamed:
            found.append(f"a cause at {sure:.2f} with something unnamed at {unnamed:.2f}")
        name = effect_words(str(head["effect"]))
        if (named or partial) and name not in text:
            found.append(f"the sentences name something else than the first explanation, {name}")
    return tuple(found)


def judge(truth: ForeignTruth, diagnosis: Mapping[str, Any] | None) -> ForeignAnswer:
    """Class an answer.

    The rules, of which the first that holds counts:

    * refused: there is no diagnosis.
    * A verdict that is not ``effect`` and that the truth allows is right; ``unknown`` at another place than the true
      one is hedged right.
    * ``effect`` with one of the true sets (or an equivalent of the first explanation), at the true place: right where
      the explanation is adequate and has a probability of at least ``NAMED``, else hedged right.
    * ``effect`` with a true set and more, or with one of ``partly`` that belongs to a true set (the main one of two),
      at the true place: hedged right; with another one of ``partly``, which only resembles the truth, hedged right
      where it is not adequate.
    * ``unknown``, or ``effect`` whose first explanation is not adequate, of an effect of the library: hedged right
      where one of the first three explanations is the truth at its place.
    * ``unknown`` of an effect of the library: honest unknown.
    * All else is wrong. It is confidently wrong where its probability is at least ``SURE`` and it is adequate, or it
      is an alarm (``effect``, ``unknown``) on a healthy rig with a probability of at least ``SURE``; else hedged wrong.

    Args:
        truth: of the case.
        diagnosis: what ``diagnosis.json`` holds; None where there is none. ``adequate`` counts as true where it is
            not stated, of the diagnosis and of each explanation.
    """
    verdict = str((diagnosis or {}).get("verdict", ""))
    if diagnosis is None or verdict not in VERDICTS:
        return ForeignAnswer("refused")
    ranking = [entry for entry in diagnosis.get("ranking", ()) if isinstance(entry, dict)]
    head = ranking[0] if ranking else {}
    stated = _stated_place(diagnosis, head)
    probability = _probability(diagnosis, verdict, head)
    adequate = bool(diagnosis.get("adequate", True)) and (verdict != "effect" or bool(head.get("adequate", True)))
    parameter, deviation = _furthest(truth, diagnosis, head, _holds(stated, truth.place))
    return ForeignAnswer(
        outcome=_outcome(truth, verdict, ranking, stated, probability, adequate),
        verdict=verdict,
        effect=str(head.get("effect", "")) if verdict == "effect" else "",
        place=stated,
        probability=probability,
        adequate=adequate,
        parameter=parameter,
        deviation=deviation,
        closed=_number((diagnosis.get("gap") or {}).get("closed")),
        credible=len(answers := _answers(diagnosis)),
        held=any(_is_answer(truth, answer) for answer in answers),
    )


def _answers(diagnosis: Mapping[str, Any]) -> list[set[EffectSet]]:
    """What the diagnosis states together at 95 %; ``too_weak`` is any effect that the tests do not show."""
    return [
        {effect_set(effects) for effects in answer["effects"]} or {effect_set(answer["kind"])}
        for answer in diagnosis.get("answers", ())
    ]


def _is_answer(truth: ForeignTruth, answer: set[EffectSet]) -> bool:
    right = set(truth.effects)
    right |= {effect_set(verdict) for verdict in truth.verdicts if verdict != "effect"}
    if "calibration" in truth.verdicts:
        right.add(effect_set("none"))
    if truth.kind != "healthy":
        right.add(effect_set("too_weak"))
    return bool(right & answer)


def _outcome(
    truth: ForeignTruth,
    verdict: str,
    ranking: list[dict[str, Any]],
    stated: str,
    probability: float,
    adequate: bool,
) -> str:
    placed = _holds(stated, truth.place)
    if verdict != "effect" and verdict in truth.verdicts:
        return "right" if verdict != "unknown" or placed else "hedged right"
    if verdict == "effect" and ranking and placed:
        named = _alternatives(ranking[0])
        if "effect" in truth.verdicts and any(effects in named for effects in truth.effects):
            return "right" if adequate and probability >= NAMED else "hedged right"
        more = any(effects < found for effects in truth.effects for found in named)
        # A part of a pair is true whatever it leaves; what only resembles the truth must not claim to leave nothing.
        part = any(
            effects in named and any(effects < true_set for true_set in truth.effects) for effects in truth.partly
        )
        near = any(effects in named for effects in truth.partly) and not adequate
        if truth.kind != "healthy" and (more or part or near):
            return "hedged right"
    if truth.kind == "effect" and (verdict == "unknown" or (verdict == "effect" and not adequate)):
        if any(_tells(truth, entry) for entry in ranking[:_FIRST]):
            return "hedged right"
        if verdict == "unknown":
            return "honest unknown"
    alarm = truth.kind == "healthy" and verdict in ALARMS
    return "confidently wrong" if probability >= SURE and (adequate or alarm) else "hedged wrong"


def _tells(truth: ForeignTruth, entry: Mapping[str, Any]) -> bool:
    """The explanation is the truth, at its place."""
    stated_place = f"{entry.get('place', '')} {entry.get('detail', '')}"
    return _holds(stated_place, truth.place) and any(effects in _alternatives(entry) for effects in truth.effects)


def _alternatives(entry: Mapping[str, Any]) -> set[EffectSet]:
    """The effects of an explanation, and of those that these tests do not tell from it."""
    return {effect_set(str(text)) for text in (entry.get("effect", ""), *entry.get("equivalents", ()))}


def _stated_place(diagnosis: Mapping[str, Any], head: Mapping[str, Any]) -> str:
    """Place and detail of the first explanation, or of the most probable place without one."""
    places = sorted(diagnosis.get("where", ()), key=lambda entry: -_number(entry.get("p"), 0.0))
    first = head if head and diagnosis["verdict"] == "effect" else places[0] if places else {}
    return f"{first.get('place', '')} {first.get('detail', '')}".strip()


def _holds(stated: str, words: tuple[str, ...]) -> bool:
    return not words or bool(set(re.split(r"[^\w]+", stated)) & set(words))


def _probability(diagnosis: Mapping[str, Any], verdict: str, head: Mapping[str, Any]) -> float:
    """Of what the verdict says."""
    if verdict == "effect":
        return _number(head.get("probability"), 0.0)
    probabilities = diagnosis.get("probabilities") or {}
    names = ("unknown",) if verdict == "unknown" else ("none", "calibration")
    return math.fsum(_number(probabilities.get(name), 0.0) for name in names)


def _furthest(
    truth: ForeignTruth, diagnosis: Mapping[str, Any], head: Mapping[str, Any], placed: bool
) -> tuple[str, float]:
    """Name of the known parameter that was stated furthest from its true value, and its deviation."""
    stated = {str(entry.get("name")): (entry.get("to"), entry.get("std")) for entry in diagnosis.get("calibration", ())}
    if placed and any(effects <= found for effects in truth.effects for found in _alternatives(head)):
        alone = f"{head.get('effect', '')}@{str(head.get('detail', '')).split(' at ')[0]}"
        for label, entry in (head.get("parameters") or {}).items():
            # Of two effects, parameters are named effect@detail.parameter.
            cause, _, name = str(label).rpartition(".")
            value = entry.get("value"), entry.get("std")
            names = (f"{cause}.{name}",) if cause else (f"{alone}.{name}", name)
            for known in (*names, f"{(cause or alone).partition('@')[0]}.{name}"):
                stated[known] = value
    found: list[tuple[str, float]] = []
    for key, true in truth.parameters.items():
        value, std = stated.get(key, (None, None))
        off = _number(value) - true
        if not math.isnan(off):
            spread = _number(std, 0.0)
            found.append((key, off / spread if spread > 0.0 else math.copysign(math.inf, off) if off else 0.0))
    return max(found, key=lambda item: abs(item[1]), default=("", math.nan))


def _case(folder: Path) -> ForeignCase:
    sidecars = tuple(sorted(folder.glob("sidecar*.yaml")))
    if not (folder / MODEL_FILE).is_file() or not sidecars:
        raise BenchError(f"The case {folder} lacks {MODEL_FILE} or sidecar.yaml; write them next to its {TRUTH_FILE}.")
    return ForeignCase(folder, folder / MODEL_FILE, sidecars, read_truth(folder / TRUTH_FILE))


def _words(values: Mapping[str, Any], key: str, name: str) -> tuple[str, ...]:
    found = values.get(key, [])
    if not isinstance(found, list) or not all(isinstance(item, str | int) for item in found):
        raise BenchError(f"{name}: {key} must be a list of words; got {found}.")
    return tuple(str(item) for item in found)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _number(value: Any, otherwise: float = math.nan) -> float:
    return float(value) if _is_number(value) else otherwise
