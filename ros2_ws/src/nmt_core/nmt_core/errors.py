"""The error type for everything a user can fix."""

from __future__ import annotations


class BenchError(Exception):
    """A mistake or a state that the user can fix.

    The message is one sentence that says what is wrong, where, and how to fix it. The command line prints it
    and exits with code 2; nodes log it and refuse to start.
    """


class FailedError(BenchError):
    """Something that was asked for rightly did not succeed, such as a test that ended early; exit code 1."""
