"""What a run and its levels gave, in words: the same on the console, in the report and on the live page."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from nmt_core.messages.modal_point import ModalPoint
from nmt_core.text.number_words import level_list
from nmt_core.vocabulary import PointStatus
from nmt_extract.curves.response_curve import is_of_curve
from nmt_extract.modal.mode_identity import other_mode
from nmt_report.columns import status_text, unit_text
from nmt_report.quantity_format import significant

if TYPE_CHECKING:
    from nmt_core.messages.linear_description import LinearDescription
    from nmt_core.messages.modal_point import ModalPoint

GOOD, PARTLY, BAD = "good", "partly", "bad"


class RunVerdict(NamedTuple):
    """What a run gave.

    Attributes:
        sentence: without a full stop.
        tone: ``good`` = every level is in the table; ``partly`` = some are missing, or belong to another mode;
            ``bad`` = none is there.
    """

    sentence: str
    tone: str


def run_verdict(points: Sequence[ModalPoint], planned: int = 0, linear: LinearDescription | None = None) -> RunVerdict:
    """The verdict on a run.

    Args:
        points: one a level, also of levels without values.
        planned: levels of the plan; 0 = as many as there are points.
        linear: linear modes that they were extracted with; None = which mode a level is, is not looked at.
    """
    total = max(len(points), planned)
    measured = [point for point in points if point.status is PointStatus.OK]
    good = len(measured)
    not_locked = sum(point.status is PointStatus.NOT_LOCKED for point in points)
    counts = {
        "not locked": not_locked,
        "rejected": len(points) - good - not_locked,
        "not reached": total - len(points),
        "another mode": sum(
            linear is not None and other_mode(p.normalised_shape, linear) is not None for p in measured
        ),
    }
    parts = [f"{good} of {total} {'points' if is_of_curve(points) else 'levels'} locked and extracted"]
    parts += [f"{count} {words}" for words, count in counts.items() if count]
    tone = BAD if not good else GOOD if len(parts) == 1 else PARTLY
    return RunVerdict("; ".join(parts), tone)


_NUMBER = re.compile(r"[−-]?\d+(?:\.\d+)?(?:e[−-]?\d+)?")


def level_sentences(points: Sequence[ModalPoint]) -> list[str]:
    """What became of levels, and why: one sentence for all whose reasons differ in nothing but their numbers."""
    groups: dict[tuple[int, str], list[ModalPoint]] = {}
    for point in points:
        groups.setdefault((int(point.status), _NUMBER.sub("#", point.reason)), []).append(point)
    return [_sentence(group) for group in groups.values()]


def _sentence(group: Sequence[ModalPoint]) -> str:
    first = group[0]
    outcome = f"{status_text(first.status)}{f': {first.reason}' if first.reason else ''}"
    if len(group) == 1:
        return f"Level {first.level_index + 1} ({significant(first.level)} {unit_text(first.level_unit)}) {outcome}"
    numbers = level_list([point.level_index for point in group])
    return f"{len(group)} levels alike ({numbers.removeprefix('levels ')}), the first of them {outcome}"
