"""What a run gave, as one sentence and its tone: the same words on the console, in the report and on the live page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from nmt_core.vocabulary import PointStatus
from nmt_extract.curves.response_curve import is_of_curve
from nmt_extract.modal.mode_identity import other_mode

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
