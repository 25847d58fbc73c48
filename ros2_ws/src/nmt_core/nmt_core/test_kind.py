"""What the loop does at a level: the kinds of test, by the name that most modules import them from."""

from nmt_core.vocabulary import TestKind

__all__ = ["TestKind"]
