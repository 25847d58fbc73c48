"""What devices take of a test: its exciters."""

from __future__ import annotations

from nmt_core.messages.driven_test import DrivenTest

_SHAKING_TABLE, _LOOPBACK = "shaking_table", "loopback"


def covers(test: DrivenTest, device: str = "") -> str:
    """What a device does not take of a test, and what to use instead; empty = it takes it.

    Args:
        test: the test.
        device: kind of device as in rig files; empty = the simulated rig.
    """
    if not test.has_several_exciters:
        return ""
    if _SHAKING_TABLE in test.exciters:
        return "A shaking table moves all supports at once and takes no exciter next to it; give the rig one exciter."
    if device == _LOOPBACK:
        return (
            f"A loopback wires one output to all inputs, and this rig has {len(test.exciters)} exciters; choose one by "
            "its point with --exciter N, or another --device."
        )
    return ""
