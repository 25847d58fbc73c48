"""What the live page takes: every test, while it runs and from its recording."""

from __future__ import annotations

from nmt_core.messages.driven_test import DrivenTest


def covers(test: DrivenTest) -> str:
    """Empty: signals, levels and the loop's state are shown of any test, modal points of those that give some."""
    del test
    return ""
