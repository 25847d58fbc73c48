"""Why a diagnosis states an explanation or not: its row of the ledger in sentences.

The ledger is read as ``diagnosis.json`` has it, so that a diagnosis which was written is asked as a new one is.
"""

from __future__ import annotations

import difflib
import operator
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.text.number_words import percent, significant
from nmt_diagnose.ledger.rules import GAP, rule_named

_NEAREST = 4  # names that are offered for a wrong one
_GROUPS = 5  # groups of rows, parameters and errors of the chain that are listed, the largest first
_WIDTH = 22


def why(ledger: Mapping[str, Any], word: str) -> tuple[str, ...]:
    """What a ledger says of an explanation, line by line.

    Args:
        ledger: as ``diagnosis.json`` has it.
        word: effects at their places, joined by ``+``; ``none`` for the model alone.

    Raises:
        BenchError: the ledger has nothing of that name; the sentence has the nearest names.
    """
    rows, promises = ledger["rows"], ledger["promises"]
    wanted = _causes(word)
    for row in sorted(rows, key=lambda row: not row["stated"]):
        if _causes(row["label"]) == wanted:
            return (*_decision(row), *_row(row), *_combined(rows, wanted))
    for promise in promises:
        if _causes(promise["label"]) == wanted:
            return (*_promise(promise), *_combined(rows, wanted))
    known = [row["label"] for row in (*rows, *promises)]
    name = " + ".join(sorted(wanted))
    near = difflib.get_close_matches(name, known, _NEAREST, 0.0)
    if any(label.split("@")[0] == name.split("@")[0] for label in known):
        places = [label for label in known if label.split("@")[0] == name.split("@")[0] and " + " not in label]
        near = places[:_NEAREST] or near
    raise BenchError(f"Nothing called {name} was looked at; the nearest are {', '.join(near) or 'none'}.")


def _causes(label: str) -> frozenset[str]:
    """Effects at their places of a label, in the spelling of the library."""
    causes = []
    for part in label.split(" + ") if " + " in label else label.split("+"):
        effect, at, place = part.strip().partition("@")
        causes.append(effect.strip().replace("-", "_").replace(" ", "_") + at + place.strip())
    return frozenset(causes)


def _decision(row: Mapping[str, Any]) -> list[str]:
    if row["stated"]:
        return [f"{row['label']}: stated"]
    for_effects = [ruling for rulings in row["effects"].values() for ruling in rulings]
    asked = [ruling for ruling in (*for_effects, *row["rulings"]) if ruling["rule"] == row["failed"]]
    failed = [ruling for ruling in asked if not ruling["passed"]] or asked
    if not failed:
        return [f"{row['label']}: not stated: rule {row['failed']}", f"  {rule_named(row['failed']).sentence}"]
    return [f"{row['label']}: not stated: {_ruling(failed[0])}", f"  {_sentence(failed[0])}"]


def _promise(promise: Mapping[str, Any]) -> list[str]:
    ruling, label = promise["ruling"], promise["label"]
    promised = f"The score test promises a fall of the cost by {significant(promise['promised'], 3)}."
    if promise["lost"]:
        return [
            f"{label}: not stated: its fit was begun and came to nothing",
            f"  {promised} The model has no solution with it, or one that is worse than without it.",
        ]
    return [f"{label}: not stated, never fitted: {_ruling(ruling)}", f"  {_sentence(ruling)} {promised}"]


def _ruling(ruling: Mapping[str, Any]) -> str:
    unit = rule_named(ruling["rule"]).unit
    unit = "" if unit == "1" else f" {unit}"
    number = _number(ruling["number"])
    if ruling["number"] is None and not ruling["passed"] and rule_named(ruling["rule"]).holds is operator.ge:
        number = "nothing"
    return f"rule {ruling['rule']}, {number} of {_number(ruling['limit'])}{unit}"


def _sentence(ruling: Mapping[str, Any]) -> str:
    if ruling["rule"] == GAP.name and ruling["passed"]:
        return "Something is missing, so that the model alone is not the answer."
    return rule_named(ruling["rule"]).sentence


def _number(value: float | None) -> str:
    # What is not finite is null in JSON.
    return "beyond all" if value is None else significant(value, 3)


def _row(row: Mapping[str, Any]) -> Iterable[str]:
    if row["start"]:
        yield _line("start", row["start"])
    largest = sorted(row["left"], key=lambda it: -it["share"])
    left = [
        f"{group['group']} {significant(group['rms'], 3)} σ ({percent(group['share'], 0)})"
        for group in largest[:_GROUPS]
    ]
    yield _line("leaves", ", ".join(left) + _more(largest))
    asked = sorted(row["parameters"].items(), key=lambda it: -abs(it[1]))
    yield _line("asks of the model", _sigmas(asked) or "nothing")
    yield _line("of the chain", _sigmas(list(row["chain"].items())) or "nothing beyond 1 σ")
    changes = ", ".join(f"{kind} {significant(value, 3)}" for kind, value in row["change"].items())
    yield _line("changes", f"{changes} of the limit that matters" if changes else "nothing that has a size")
    yield _line("differs", ", ".join(f"{_number(sigmas)} σ from {name}" for name, sigmas in row["apart"].items()))
    held = row["predicted"]
    if held is not None and held["closed"] is not None:
        interval = ""
        if held["low"] is not None and held["high"] is not None:
            interval = f" ({percent(held['low'], 0)} to {percent(held['high'], 0)})"
        yield _line(
            "held out",
            f"{_number(held['before'])} to {_number(held['after'])} σ, closes {percent(held['closed'], 1)}{interval}",
        )
    else:
        yield _line("held out", "not judged")
    yield _line("ln prior, evidence", f"{_number(row['prior'])}, {_number(row['evidence'])}")
    yield _line("probability", significant(row["probability"], 3))
    for label, rulings in row["effects"].items():
        yield from _rulings(rulings, f" ({label})" if len(row["effects"]) > 1 else "")
    yield from _rulings(row["rulings"], "")


def _more(items: Sequence[object]) -> str:
    """How many items are not listed."""
    return f" and {len(items) - _GROUPS} more" if len(items) > _GROUPS else ""


def _rulings(rulings: Sequence[Mapping[str, Any]], of: str) -> Iterable[str]:
    for ruling in rulings:
        if ruling["number"] is not None or not ruling["passed"]:
            part = ", as a part" if ruling["part"] else ""
            yield _line("passes" if ruling["passed"] else "fails", f"{_ruling(ruling)}{part}{of}")


def _sigmas(items: Sequence[tuple[str, float]]) -> str:
    return ", ".join(f"{name} {value:+.1f} σ" for name, value in items[:_GROUPS]) + _more(items)


def _combined(rows: Sequence[Mapping[str, Any]], wanted: frozenset[str]) -> Iterable[str]:
    """Explanations that combine it with another effect."""
    for row in rows:
        if wanted < _causes(row["label"]):
            yield _line("together", "; ".join(line.strip() for line in _decision(row)[:1]))


def _line(head: str, text: str) -> str:
    return f"  {head:<{_WIDTH}}{text}"
