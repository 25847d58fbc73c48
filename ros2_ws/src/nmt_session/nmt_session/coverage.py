"""What the bench takes of a test, before a node starts: what its kind, its loop and its device say together."""

from __future__ import annotations

from nmt_core.kinds import kind_class
from nmt_core.messages.driven_test import DrivenTest
from nmt_plant.coverage import covers as devices_cover
from nmt_pll.coverage import ADAPTIVE
from nmt_pll.coverage import covers as loops_cover


def covers(test: DrivenTest, loop: str = ADAPTIVE, ramps: bool = False, device: str = "") -> str:
    """What cannot be done of a test, and what to use instead; empty = it can be done.

    Args:
        test: the test.
        loop, ramps: as of :func:`nmt_pll.coverage.covers`.
        device: as of :func:`nmt_plant.coverage.covers`.
    """
    kind = kind_class(test.kind)
    if test.controlled_harmonics and "harmonics_control" not in kind.FROM_RIG:
        return f"The harmonics of the force are not controlled in a {kind.words()} test; leave out --harmonics-control."
    return loops_cover(test, loop, ramps) or devices_cover(test, device)
