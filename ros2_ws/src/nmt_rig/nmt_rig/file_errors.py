"""What the readers of modes and matrices raise; who knows the place in the rig file makes a sentence of it."""

from __future__ import annotations


class BadFileError(ValueError):
    """What is wrong with a file that a structure is read from, and how to fix it."""


class KeyOfRigError(BadFileError):
    """What is wrong with the value of a key of the rig file, next to what its files hold.

    Attributes:
        path: of the key.
    """

    def __init__(self, path: tuple[str | int, ...], why: object) -> None:
        super().__init__(str(why))
        self.path = path
