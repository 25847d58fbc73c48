"""What a diagnosis tells while it goes on: sentences that may carry counts and the ranking as it stands."""

from __future__ import annotations

from collections.abc import Callable, Iterable


class ProgressSentence(str):
    """A sentence of progress.

    Attributes:
        done: pieces of the present work that had begun or ended before; 0 where they are not counted.
        total: how many there are; 0 where they are not counted.
        ranking: explanations so far and by how much the logarithm of their evidence lies behind the best; empty where
            nothing new is known of them.
    """

    __slots__ = ("done", "ranking", "total")

    done: int
    total: int
    ranking: tuple[tuple[str, float], ...]

    def __new__(
        cls, sentence: str, done: int = 0, total: int = 0, ranking: Iterable[tuple[str, float]] = ()
    ) -> ProgressSentence:
        """Make a sentence that carries more."""
        result = super().__new__(cls, sentence)
        result.done, result.total, result.ranking = done, total, tuple(ranking)
        return result


Progress = Callable[[str], None]
"""Told what is being done, as a sentence; see :class:`ProgressSentence`."""
