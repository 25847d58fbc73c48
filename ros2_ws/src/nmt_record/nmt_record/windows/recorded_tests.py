"""What drove the windows of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from nmt_core.errors import BenchError
from nmt_core.files.hardened import yaml_value
from nmt_core.messages.driven_test import DrivenTest
from nmt_record.bag.bag_reader import Bag
from nmt_record.windows.segments import Segment, segments


def recorded_tests(bag: Bag, windows: Sequence[Segment] | None = None) -> tuple[DrivenTest, ...]:
    """The tests of a recording, one of each kind, in the order of their first windows; of a run without a window the
    one that it was asked for.

    Args:
        bag: the recording.
        windows: its windows, where they have been read already.

    Raises:
        BenchError: the bag is damaged, or holds a kind of test that this release does not know.
    """
    rig = None
    if bag.rig_yaml:
        try:
            rig = yaml_value(bag.rig_yaml, f"The rig file in {bag.path}")
        except BenchError:
            rig = None
    asked = DrivenTest.of_run(bag.run_start, rig if isinstance(rig, dict) else None)
    kinds = dict.fromkeys(segment.kind for segment in (segments(bag) if windows is None else windows))
    return tuple(replace(asked, kind=kind) for kind in kinds) or (asked,)
