"""Runs what owners of real recordings would type, and compares what is known with what is said.

A case is a folder with a model, recordings, a ``plan`` (the commands that a user tries, one a line) and ``truth.yaml``:
``known`` in words, the answers that are ``right`` and those that are ``hedged`` (effects joined by ``+``, or a
verdict), and the share of the gap that has to be closed at least.
"""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nmt_blind.campaign.foreign_case import SURE, TRUTH_FILE, contradictions
from nmt_blind.campaign.foreign_run import child
from nmt_blind.campaign.scored_case import EffectSet, effect_set
from nmt_core.errors import BenchError
from nmt_core.files.hardened import read_json, read_text, yaml_value
from nmt_core.files.whole_file import csv_text, write_result, write_whole
from nmt_core.text.number_words import percent

PLAN_FILE = "plan"
OUTCOMES = ("right", "hedged", "by eye", "missed", "confidently wrong", "no answer")
_SENTENCES = 2


@dataclass(frozen=True)
class KnownTruth:
    """What is known of a recording.

    Attributes:
        known: in words.
        right, hedged: sets of effects, or verdicts as sets of one word.
        closed_at_least: share of the gap on held-out data below which a right answer is hedged.
        by_eye: whether no set of names says what is right.
    """

    known: str
    right: tuple[EffectSet, ...]
    hedged: tuple[EffectSet, ...]
    closed_at_least: float
    by_eye: bool


@dataclass(frozen=True)
class Said:
    """An answer to one command of a plan.

    Attributes:
        case: of the recording.
        command: its words.
        outcome: one of ``OUTCOMES``.
        answer: verdict and effects, or why there is none.
        closed: share of the gap on held-out data; NaN without one.
        seconds: processor time, s.
        sentences: the first of the diagnosis.
        contradictions: where its parts say different things.
    """

    case: str
    command: str
    outcome: str
    answer: str
    closed: float
    seconds: float
    sentences: tuple[str, ...] = ()
    contradictions: tuple[str, ...] = ()


def has_plans(folder: Path) -> bool:
    """Whether the cases of a folder are recordings with a plan."""
    return folder.is_dir() and any((case / PLAN_FILE).is_file() for case in folder.iterdir())


def read_known(path: Path) -> KnownTruth:
    """What a file ``truth.yaml`` of a recording says.

    Raises:
        BenchError: it cannot be read, or does not say what is right.
    """
    name = f"The truth {path}"
    values = yaml_value(read_text(path, "truth"), name)
    if not isinstance(values, dict) or not isinstance(values.get("right"), list) or not values["right"]:
        raise BenchError(f"{name} must have the key right, a list of effects or verdicts.")
    sets = {key: [str(text) for text in values.get(key) or ()] for key in ("right", "hedged")}
    named = {key: tuple(_names(text) for text in texts if _is_name(text)) for key, texts in sets.items()}
    least = values.get("closed_at_least", 0.0)
    if not isinstance(least, int | float) or not 0.0 <= least <= 1.0:
        raise BenchError(f"{name}: closed_at_least must be a share between 0 and 1; got {least}.")
    return KnownTruth(str(values.get("known", "")), named["right"], named["hedged"], float(least), not named["right"])


def _is_name(text: str) -> bool:
    return all(part.strip().isidentifier() for part in text.split("+"))


def _names(text: str) -> EffectSet:
    return frozenset(part.strip() for part in text.split("+"))


def outcome_of(truth: KnownTruth, diagnosis: Mapping[str, Any]) -> str:
    """What an answer is worth; one of ``OUTCOMES``.

    * ``right``: the verdict, or the first explanation or one that is not told from it, is right, and closes enough.
    * ``hedged``: it is among the hedged; or a right one has another effect added; or of ``unknown``, or of what
      leaves something, one of the first three is right.
    * ``confidently wrong``: another effect, adequate and with a probability of 0.9 or more. ``missed``: all else.
    """
    if truth.by_eye:
        return "by eye"
    verdict = str(diagnosis["verdict"])
    ranking = [entry for entry in diagnosis.get("ranking", ()) if isinstance(entry, dict)]
    sets = [{effect_set(str(text)) for text in (row.get("effect", ""), *row.get("equivalents", ()))} for row in ranking]
    near = {found for alternatives in sets[:3] for found in alternatives}
    if verdict != "effect":
        if frozenset((verdict,)) in truth.right:
            return "right"
        alike = verdict == "unknown" and bool(near & set(truth.right))
        return "hedged" if alike or frozenset((verdict,)) in truth.hedged else "missed"
    head = sets[0] if sets else set()
    if head & set(truth.right):
        closed = (diagnosis.get("gap") or {}).get("closed")
        return "right" if truth.closed_at_least <= (closed if isinstance(closed, int | float) else 0.0) else "hedged"
    more = any(right <= found for right in truth.right for found in head)
    adequate = bool(diagnosis.get("adequate", True))
    if more or head & set(truth.hedged) or (not adequate and near & set(truth.right)):
        return "hedged"
    sure = bool(ranking) and float(ranking[0].get("probability") or 0.0) >= SURE
    return "confidently wrong" if adequate and sure else "missed"


def run_recordings(
    folder: Path,
    out: Path,
    command: Sequence[str],
    only: Sequence[str] = (),
    limit: float = 1800.0,
    progress: Callable[[int, int, str], None] = lambda done, total, case: None,
) -> list[Said]:
    """Run the plan of each case in a copy of its folder; the answers of its diagnoses, and what gave none.

    Args:
        folder: of the cases.
        out: gets a folder for each case.
        command: words that start the program.
        only: names of cases; empty = all.
        limit: processor time of a command, s.
        progress: called with cases done, cases in all and a line on the newest answer.

    Raises:
        BenchError: there is no such case, or a truth has a mistake.
    """
    cases = sorted(path for path in folder.iterdir() if (path / PLAN_FILE).is_file())
    unknown = sorted(set(only) - {case.name for case in cases})
    if unknown:
        raise BenchError(f"There is no case {unknown[0]} in {folder}; it has {', '.join(case.name for case in cases)}.")
    cases = [case for case in cases if not only or case.name in only]
    truths = {case.name: read_known(case / TRUTH_FILE) for case in cases}
    found: list[Said] = []
    for number, case in enumerate(cases):
        progress(number, len(cases), "")
        for answer in _of_case(case, truths[case.name], out.absolute() / case.name, command, limit):
            found.append(answer)
            progress(number, len(cases), f"{case.name}: {answer.outcome} ({answer.answer}), {answer.seconds:.1f} s")
    progress(len(cases), len(cases), "")
    return found


def _of_case(case: Path, truth: KnownTruth, work: Path, command: Sequence[str], limit: float) -> list[Said]:
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(case, work, ignore=shutil.ignore_patterns(TRUTH_FILE, PLAN_FILE))
    found, lost = [], set[str]()
    lines = [line.split() for line in read_text(case / PLAN_FILE, "plan").splitlines()]
    for words in lines:
        if not words or words[0].startswith("#") or lost & set(words[1:]):
            continue
        seconds, trouble = child([*command, *words], limit, folder=work)
        out = words[words.index("--out") + 1] if "--out" in words else ""
        said = " ".join(words)
        if trouble:
            lost.add(out)
            found.append(Said(case.name, said, "no answer", trouble, math.nan, seconds))
        elif words[0] == "diagnose":
            found.append(_answer(case.name, said, truth, work / out, seconds))
    return found


def _answer(case: str, command: str, truth: KnownTruth, folder: Path, seconds: float) -> Said:
    diagnosis = read_json(folder / "diagnosis.json", "diagnosis")
    verdict, ranking = str(diagnosis["verdict"]), diagnosis.get("ranking") or [{}]
    answer = f"{verdict} {ranking[0].get('effect', '')}".strip() if verdict in ("effect", "unknown") else verdict
    closed = (diagnosis.get("gap") or {}).get("closed")
    return Said(
        case,
        command,
        outcome_of(truth, diagnosis),
        answer,
        float(closed) if isinstance(closed, int | float) else math.nan,
        seconds,
        tuple(str(text) for text in diagnosis.get("sentences", ())[:_SENTENCES]),
        contradictions(diagnosis),
    )


def summary_words(found: Sequence[Said]) -> str:
    """How many cases have which best answer."""
    best: dict[str, str] = {}
    for answer in found:
        known = best.get(answer.case)
        if known is None or OUTCOMES.index(answer.outcome) < OUTCOMES.index(known):
            best[answer.case] = answer.outcome
    counts = ", ".join(f"{name} {sum(label == name for label in best.values())}" for name in OUTCOMES)
    wrong = sum(answer.outcome == "confidently wrong" for answer in found)
    return f"{len(best)} recordings by their best answer: {counts}; answers that are confidently wrong: {wrong}"


def write_recordings(found: Sequence[Said], folder: Path, out: Path) -> tuple[Path, ...]:
    """Write ``recordings.csv``, ``recordings.json`` and the page ``recordings.md``.

    Raises:
        BenchError: one cannot be written.
    """
    entries = [
        {"case": answer.case, "command": answer.command, "outcome": answer.outcome, "answer": answer.answer,
         "closed": None if math.isnan(answer.closed) else answer.closed, "seconds": round(answer.seconds, 1)}
        for answer in found
    ]  # fmt: skip
    files = out / "recordings.csv", out / "recordings.json", out / "recordings.md"
    write_result(files[0], csv_text([list(entries[0]), *(list(entry.values()) for entry in entries)]))
    write_result(files[1], json.dumps({"format": "nmt recordings 1", "answers": entries}, indent=1) + "\n")
    write_whole(files[2], "\n".join(_page(found, folder)) + "\n")
    return files


def _page(found: Sequence[Said], folder: Path) -> list[str]:
    text = ["# Real recordings", "", summary_words(found) + "."]
    for case in dict.fromkeys(answer.case for answer in found):
        text += ["", f"## {case}", "", f"Known: {read_known(folder / case / TRUTH_FILE).known}.", ""]
        text += ["| command | worth | what is said | gap closed | processor time |", "|---|---|---|---|---|"]
        for item in (answer for answer in found if answer.case == case):
            words = " ".join(item.sentences) or item.answer
            closed = "–" if math.isnan(item.closed) else percent(item.closed, 1)
            text.append(f"| `{item.command}` | {item.outcome} | {words} | {closed} | {item.seconds:.0f} s |")
    return text
