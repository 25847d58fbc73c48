"""What the readers of modes and matrices raise; who knows the place in the rig file makes a sentence of it."""

from __future__ import annotations


class BadFileError(ValueError):
    """What is wrong with a file that a structure is read from, and how to fix it."""
