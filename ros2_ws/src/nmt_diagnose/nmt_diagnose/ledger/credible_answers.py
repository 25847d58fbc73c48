"""The fewest answers that hold most of the probability together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from nmt_diagnose.ledger.diagnosis import NULL, TOO_WEAK, UNKNOWN, Answer, Ranked, Verdict
from nmt_diagnose.thresholds import THRESHOLDS


def credible_answers(
    verdict: Verdict, adequate: bool, ranking: Sequence[Ranked], probabilities: Mapping[str, float]
) -> tuple[Answer, ...]:
    """The fewest answers that hold ``comparison.credible_probability`` together, the most probable first.

    Where no gap is claimed, what is not ``none`` is too weak to see, whatever its name. Of a partial explanation
    experience says how often the library has the truth; its probability is divided as the ranking is.

    Args:
        verdict: of the diagnosis.
        adequate: whether the first explanation leaves noise.
        ranking: classes of explanations.
        probabilities: by hypothesis.
    """
    classes = [tuple(sorted({_sorted(item.effect), *map(_sorted, item.equivalents)})) for item in ranking]
    found: dict[tuple[str, tuple[str, ...]], float] = {}

    def add(kind: str, effects: tuple[str, ...], p: float) -> None:
        found[kind, effects] = found.get((kind, effects), 0.0) + p

    if not verdict.gap:
        none = probabilities.get(NULL, 0.0)
        add(NULL, (), none)
        add(TOO_WEAK, (), 1.0 - none)
    elif verdict is Verdict.EFFECT and not adequate:
        named = THRESHOLDS.comparison.partial_named_share
        add(UNKNOWN, (), 1.0 - named)
        for item, effects in zip(ranking, classes, strict=True):
            add("effect", effects, named * item.probability)
    else:
        for label, p in probabilities.items():
            if label in (NULL, UNKNOWN):
                add(label, (), p)
                continue
            names = _sorted(label)
            add("effect", next((equivalent for equivalent in classes if names in equivalent), (names,)), p)
    answers, total = [], 0.0
    for (kind, effects), p in sorted(found.items(), key=lambda item: -item[1]):
        if total >= THRESHOLDS.comparison.credible_probability:
            break
        answers.append(Answer(kind, effects, p))
        total += p
    return tuple(answers)


def _sorted(effects: str) -> str:
    """Names of effects joined by ``+``, in one order."""
    return " + ".join(sorted(part.split("@")[0].strip() for part in effects.split(" + ")))
