"""What became of levels, and why, in words: one sentence for those that failed alike."""

from __future__ import annotations

import re
from collections.abc import Sequence

from nmt_core.messages.modal_point import ModalPoint
from nmt_core.text.number_words import level_list
from nmt_report.columns import status_text, unit_text
from nmt_report.quantity_format import significant

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
